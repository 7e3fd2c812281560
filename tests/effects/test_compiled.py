"""Hooks as compiled functions: which variants share one."""

from dataclasses import dataclass, replace

import numpy as np

from ocp.effects.catalogue import library
from ocp.effects.engine.compiled import Hook, RowLayout, evaluated


@dataclass(frozen=True)
class WholeRow:
    """Hooks see the row itself."""

    def context(self, row):
        return row


def test_scanned_values_are_told_apart_to_the_last_digit():
    twice = replace(library()["encoder_scale"], joint=lambda row, joint, scanned: row * scanned["times"][0], symbolic=())
    values = [1 / 3, np.nextafter(1 / 3, 1.0)]
    hook = Hook(twice, "joint", 1, RowLayout.of("q 1"), WholeRow())
    found = evaluated(hook, np.ones((1, 1)), [{"times": np.array([value])} for value in values])
    assert found[-1].ravel().tolist() == values
