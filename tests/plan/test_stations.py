"""Contacts along a pass are solved where their neighbours do not tell them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from ocp.model.blade_gap import FIRST, solved_where_needed

S = np.linspace(0.0, 0.12, 41)  # m: stations 3 mm apart


def solved(values, tolerance):
    """Stations solved of a curve (n,), and by how much what lies between them is missed."""
    asked = []

    def solve(index):
        asked.extend(index)
        return np.column_stack([values[index], np.ones(len(index))])

    def off(index, expected, found):
        assert (found[:, 1] == 1.0).all()
        return np.abs(expected - found)[:, 0]

    index, found = solved_where_needed(S, solve, off, tolerance)
    assert sorted(asked) == list(index) and len(set(asked)) == len(asked)  # none twice
    assert (np.diff(index) > 0).all() and (found[:, 0] == values[index]).all()
    assert index[0] == 0 and index[-1] == len(S) - 1
    return index, np.abs(PchipInterpolator(S[index], found[:, 0])(S) - values).max()


def test_smooth_between_its_neighbours_half_are_left_out():
    index, missed = solved(np.sin(20.0 * S), 0.01)
    assert len(index) <= len(S) // 2 + 1
    assert missed < 0.01


def test_a_bump_as_wide_as_the_first_step_is_found_and_followed():
    """So are the stretches beside it, whose own middles are as expected by chance."""
    for width in (3e-3, 6e-3):  # 12 and 24 mm from foot to foot
        for at in np.linspace(0.02, 0.1, 161):
            index, missed = solved(np.exp(-(((S - at) / width) ** 2)) + 1e-3 * S, 0.02)
            assert missed < 0.01, (width, at)
            assert len(index) < 0.8 * len(S)


def test_beside_a_jump_every_station_is_solved():
    index, _ = solved((S > 0.0512).astype(float), 0.1)
    jump = np.searchsorted(S, 0.0512)
    assert {jump - 1, jump} <= set(index)
    assert len(index) < 0.7 * len(S)


@given(st.integers(1, 12), st.floats(1e-6, 1.0))
@settings(max_examples=30, deadline=None)
def test_any_number_of_stations(count, tolerance):
    s, rng = np.arange(1.0, count + 1.0), np.random.default_rng(count)
    values = rng.standard_normal(count)

    def solve(index):
        return values[index, None]

    index, found = solved_where_needed(s, solve, lambda k, a, b: np.abs(a - b)[:, 0], tolerance)
    assert (found[:, 0] == values[index]).all()
    assert index[0] == 0 and index[-1] == count - 1 and (np.diff(index) <= FIRST).all()
