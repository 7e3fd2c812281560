"""Hooks as compiled functions: which variants share one; rows evaluated in blocks."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

from ocp.effects.catalogue import library
from ocp.effects.engine.compiled import Hook, RowLayout, evaluated
from robots.kinematics import calls_at_once, evaluate_rows


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


@pytest.mark.parametrize("count", [1, 3, 127, 128, 129, 2047, 2048, 2049, 2300])
def test_rows_are_evaluated_one_by_one_whatever_their_number(count):
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    rows, more = np.random.default_rng(1).normal(size=(count, 2)), np.arange(float(count))[:, None]
    found = evaluate_rows(ca.Function("one", [x, y], [ca.vertcat(x[0] * y, x[1])]), rows, more)
    assert np.array_equal(found, np.column_stack([rows[:, 0] * more[:, 0], rows[:, 1]]))


def test_numbers_that_are_always_zero_are_among_the_results():
    x = ca.SX.sym("x", 2)
    sparse = ca.jacobian(ca.vertcat(x[0] ** 2, 3.0, x[1]), x)
    found = evaluate_rows(ca.Function("slopes", [x], [ca.vec(sparse)]), np.array([[1.0, 2.0], [5.0, 7.0]]))
    assert np.array_equal(found, [[2, 0, 0, 0, 0, 1], [10, 0, 0, 0, 0, 1]])


def test_arguments_of_other_shapes_are_refused():
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    function = ca.Function("one", [x, y], [x[0] * y])
    for rows, more in ((np.ones((4, 3)), np.ones((4, 1))), (np.ones((4, 2)), np.ones((5, 1)))):
        with pytest.raises(ValueError, match="one at 4 rows was given"):
            evaluate_rows(function, rows, more)


def test_few_mapped_functions_serve_rows_of_any_number():
    counts = {calls_at_once(n) for n in range(1, 5000)}
    assert len(counts) <= 24 and max(counts) == 2048
    assert all(calls_at_once(n) <= n if n >= 128 else n <= calls_at_once(n) < 2 * n for n in range(1, 5000))
