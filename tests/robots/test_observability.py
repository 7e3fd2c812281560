"""Observability indices and expected errors against definitions worked out in other ways."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robots.calibration.layout import Choice, Priors, build_layout, nominal_state
from robots.calibration.noise import Noise
from robots.calibration.observability import (
    CRITERIA,
    carried_point,
    expected_error,
    identifiable_basis,
    observability,
    posterior_sd,
    sensitivity,
    singular_values,
)
from robots.pose import apply, rotation_from_abc
from robots.robot import load_robot
from robots.tracker_readings import Hanging, Instrument, Nest, planned_readings

NESTS = {
    "T1": Nest(6, np.array([0.15, -0.05, 0.25])),
    "T2": Nest(6, np.array([-0.16, 0.04, 0.21])),
    "T3": Nest(6, np.array([0.02, 0.17, 0.33])),
}
HUNG = {"bare": Hanging(), "grinder": Hanging(25.0, np.array([0.01, 0.0, 0.16]))}


def random_rows(seed: int, m: int = 30, p: int = 8):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(m, 3, p)), rng.uniform(0.1, 2.0, p), rng


def designed(n: int = 120, targets=("T1", "T2", "T3"), joints=(2, 3), seed: int = 0):
    """Random readings of a KR 210 with their sensitivity and layout."""
    robot, rng = load_robot("kr210_r2700_extra"), np.random.default_rng(seed)
    q = rng.uniform(0.8 * robot.q_min, 0.8 * robot.q_max, (n, 6))
    names = tuple(targets)
    readings = planned_readings(q, rng.integers(0, len(names), n), names, rng.integers(0, 2, n), tuple(HUNG))
    instrument = Instrument(nests={name: NESTS[name] for name in names})
    choice = Choice(joints=joints)
    layout = build_layout(robot, readings, instrument, choice, Priors())
    state = nominal_state(robot, readings, HUNG, instrument, choice)
    state.stations[:, :3, 3] = -np.array([3.0, 1.5, 1.5])
    return robot, readings, instrument, layout, state, sensitivity(robot, readings, instrument, layout, state, Noise())


def test_indices_of_a_diagonal_design_by_hand():
    s = np.array([4.0, 2.0, 1.0])
    wanted = {"O1": 2.0 / np.sqrt(9), "O2": 0.25, "O3": 1.0, "O4": 0.25, "O5": 1 / (1 / 16 + 1 / 4 + 1)}
    assert set(wanted) == set(CRITERIA)
    for name, value in wanted.items():
        assert observability(s, 9, name) == pytest.approx(value)


@given(st.integers(0, 10**6), st.sampled_from(["O1", "O3", "O5"]))
def test_more_information_never_lowers_an_index_of_the_same_count(seed, criterion):
    rows, prior, _ = random_rows(seed)
    less = singular_values(rows[:10], prior, np.eye(8))
    more = singular_values(rows[:20], prior, np.eye(8))
    assert observability(more, 10, criterion) >= observability(less, 10, criterion) * (1 - 1e-12)


def test_the_determinant_index_does_not_depend_on_units():
    """D-optimality ranks sets alike whatever the unit of an unknown."""
    rows, prior, rng = random_rows(3)
    scale = np.exp(rng.normal(0, 2, 8))
    ratio = []
    for factor in (np.ones(8), scale):
        sets = [singular_values(rows[a : a + 12] * factor, prior * factor, np.eye(8)) for a in (0, 12)]
        ratio.append(observability(sets[0], 12, "O1") / observability(sets[1], 12, "O1"))
    assert ratio[0] == pytest.approx(ratio[1], rel=1e-9)


@given(st.integers(0, 10**6))
def test_expected_error_and_posterior_are_those_of_the_inverse_information(seed):
    rows, prior, rng = random_rows(seed)
    J = rng.normal(size=(5, 3, 8))
    C = np.linalg.inv(np.einsum("mij,mik->jk", rows, rows) + np.diag(prior**2))
    wanted = np.sqrt(np.einsum("kij,jl,kil->k", J, C, J))
    np.testing.assert_allclose(expected_error(rows, prior, J), wanted, rtol=1e-9)
    np.testing.assert_allclose(posterior_sd(rows, prior), np.sqrt(np.diag(C)) * prior, rtol=1e-9)


def test_expected_error_is_the_scatter_of_simulated_fits():
    rows, prior, rng = random_rows(11, m=6, p=4)
    J = rng.normal(size=(1, 3, 4))
    A = np.vstack([rows.reshape(-1, 4), np.diag(prior)])
    found = []
    for _ in range(4000):
        truth = rng.normal(0, 1 / prior)
        data = np.concatenate([rows.reshape(-1, 4) @ truth + rng.normal(size=18), np.zeros(4)])
        estimate = np.linalg.lstsq(A, data, rcond=None)[0]
        found.append(np.sum((J[0] @ (estimate - truth)) ** 2))
    assert np.sqrt(np.mean(found)) == pytest.approx(expected_error(rows, prior, J)[0], rel=0.04)


def test_an_unknown_that_nothing_speaks_of_is_refused():
    rows, _, rng = random_rows(5)
    rows[..., 2] = 0.0
    prior = np.array([1, 1, 0, 1, 1, 1, 1, 1.0])
    with pytest.raises(np.linalg.LinAlgError):
        expected_error(rows, prior, rng.normal(size=(1, 3, 8)))


@pytest.mark.parametrize("targets, rank", [(("T1",), 27), (("T1", "T2", "T3"), 33)])
def test_directions_told_apart_are_those_of_the_physics_page(targets, rank):
    """PHYSICS 2.3: 27 with one nest; with three nests the full pose, 30, and the 3 shape numbers of the nests' triangle."""
    *_, seen = designed(400, targets, joints=())
    assert identifiable_basis(seen.rows, seen.prior, 400).shape[1] == rank


def test_springs_add_as_many_directions_as_there_are_springs():
    *_, seen = designed(400, joints=(2, 3))
    assert identifiable_basis(seen.rows, seen.prior, 400).shape[1] == 35


def test_noise_grows_along_the_axes_far_from_the_tracker():
    """Range noise along the beam is not exceeded by what joints move there alone; across it both add up."""
    *_, seen = designed(50)
    beam = seen.point / np.linalg.norm(seen.point, axis=1)[:, None]
    moved = 1e-5 * seen.d_joints
    joints = np.einsum("ni,nij->nj", beam, moved)
    along = np.einsum("ni,nij,nj->n", beam, seen.covariance, beam)
    np.testing.assert_allclose(along, 8e-6**2 + (joints**2).sum(axis=1), rtol=1e-9)
    total = np.trace(seen.covariance, axis1=1, axis2=2)
    across = 8e-6 + 3e-6 * np.linalg.norm(seen.point, axis=1)
    np.testing.assert_allclose(total, 8e-6**2 + 2 * across**2 + (moved**2).sum(axis=(1, 2)), rtol=1e-9)


def test_without_readings_the_priors_say_how_wrong_a_prediction_is():
    """J in metres per scaled unknown and the prior over the scale give back metres, whatever the scale is."""
    *_, layout, _, seen = designed(5)
    known = np.where(np.isfinite(layout.prior_sd), layout.prior_sd, 1.0)
    wanted = np.sqrt((((seen.J / layout.scale) * known) ** 2).sum(axis=(1, 2)))
    np.testing.assert_allclose(expected_error(np.zeros((1, 3, layout.size)), seen.prior, seen.J), wanted, rtol=1e-9)


def test_a_carried_point_follows_any_small_rigid_motion():
    rng = np.random.default_rng(2)
    nests, point = rng.normal(size=(3, 3)), rng.normal(size=3)
    shift, turn = rng.normal(size=3), 1e-6 * rng.normal(size=3)
    R = rotation_from_abc(turn[::-1])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, shift
    moved = (apply(T, nests) - nests).ravel()
    np.testing.assert_allclose(carried_point(nests, point) @ moved, apply(T, point) - point, atol=1e-10)


def test_the_gauge_does_not_reach_a_carried_point():
    """Turning the flange frame against the nests changes no reading and no carried blade point."""
    robot, readings, instrument, layout, state, seen = designed(200)
    q = readings.q[:1].repeat(3, axis=0)
    rows = planned_readings(q, np.arange(3), readings.targets, np.zeros(3, np.int64), readings.payloads)
    J = sensitivity(robot, rows, instrument, layout, state, Noise()).J
    points = sensitivity(robot, rows, instrument, layout, state, Noise()).point
    carried = carried_point(points, points.mean(axis=0) + 0.1) @ J.reshape(9, -1)
    A = (seen.rows / seen.prior).reshape(-1, layout.size)
    value, vector = np.linalg.eigh(A.T @ A)
    gauge = vector[:, value < 1e-6 * value[30]]
    assert gauge.shape[1] == layout.size - 35
    inside = np.abs(carried / seen.prior @ gauge).max()
    assert inside < 1e-3 * np.abs(carried / seen.prior).max()
