"""Gross readings that an effect takes back."""

from dataclasses import replace

import numpy as np
from test_diagnosis_tracker import LIBRARY, channel, world

from ocp.diagnosis.freed import FREED, freed
from ocp.effects.effect import Active

SHIFT = np.array([4e-4, -2e-4, 3e-4])


def late_shift():
    """A campaign in which one nest moves before its last seven readings; the step as an effect."""
    readings, _ = world(6)
    last = np.flatnonzero(readings.target == 1)[-7:]
    scanned = {"target": readings.targets[1], "at_s": float(readings.time[last[0]] - 1.0)}
    effect = LIBRARY["target_shift"]
    moves = channel(readings)._displaced(effect, 0, [scanned])[1][0] @ SHIFT
    moved = replace(readings, point=readings.point + moves)
    return moved, Active(effect, 0, 0.8 * SHIFT, scanned, np.eye(3))  # as an earlier linearisation would promise it


def test_a_late_step_is_rather_a_step_than_gross_readings():
    readings, step = late_shift()
    believed = channel(readings)
    assert (believed.fit.weight < 0.5).sum() >= FREED
    (found,) = freed([believed], (step,))
    assert (found.fit.weight < 0.5).sum() < FREED
    assert np.abs(found.active[0].a - SHIFT).max() < 1e-4
    play = Active(LIBRARY["backlash"], 5, np.zeros(1), {}, np.eye(1))
    assert freed([believed], (play,)) is None

