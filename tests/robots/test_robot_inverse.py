"""Inverse kinematics: every branch and turn leads back to the pose, the posture that made it is among them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robots.errors import BadInput
from robots.inverse import arm_family, inverse_branches, inverse_refined, pose_error, reach_excess, status, wrap
from robots.kinematics import forward
from robots.robot import catalogue, load_robot
from tests.support.all_postures import Status, inverse_all, turns

# The arms with a closed inverse; the UR ones have no spherical wrist.
ROBOTS = {name: load_robot(name) for name in catalogue() if name.startswith("kr")}
EXTRA = ROBOTS["kr210_r2700_extra"]
names = st.sampled_from(sorted(ROBOTS))
unit = st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6).map(np.array)


def within_limits(robot, u):
    return robot.q_min + u * (robot.q_max - robot.q_min)


def calibrated(seed, size=1e-3):
    """The extra with all 30 numbers off by about 1 mm and 1 mrad: no spherical wrist, no parallel axes."""
    return dataclasses.replace(EXTRA, mdh=EXTRA.mdh + np.random.default_rng(seed).normal(0.0, size, (6, 5)))


def other_arm():
    """Another member of the family: opposite twists and signs, a lateral offset, an odd flange."""
    mdh = np.array(
        [
            [0.3, 0.5, 0.1, np.pi / 2, 0.0],
            [1.2, 0.05, 0.7, 0.0, 0.0],
            [-0.4, 0.03, 0.06, np.pi / 2, 0.0],
            [0.2, 0.65, 0.0, -np.pi / 2, 0.0],
            [0.1, 0.0, 0.0, np.pi / 2, 0.0],
            [0.7, 0.11, 0.02, 0.4, -0.3],
        ]
    )
    limit = np.full(6, np.pi)
    return dataclasses.replace(EXTRA, mdh=mdh, sign=np.array([1.0, -1, -1, 1, -1, 1]), q_min=-limit, q_max=limit, name="other")


def krl_status(q, a1, a2, a3, d4):
    """S as KRL.md writes it, in degrees of KUKA's axes."""
    A2, A3, A5 = np.radians(q[1]), np.radians(q[2]), q[4]
    bit0 = a1 + a2 * np.cos(A2) + d4 * np.cos(A2 + A3) + a3 * np.sin(A2 + A3) < 0
    bit1 = A3 >= np.arctan2(a3, d4)
    bit2 = -180 <= A5 < 0 or A5 >= 180
    return bit0 + 2 * bit1 + 4 * bit2


@settings(max_examples=150, deadline=None)
@given(unit, names)
def test_all_branches_lead_back_to_the_pose_and_one_is_the_posture(u, name):
    robot = ROBOTS[name]
    q = within_limits(robot, u)
    T = forward(robot, q)
    branches, reachable = inverse_branches(robot, T)
    rows = branches[0, reachable[0]]
    assert np.abs(forward(robot, rows) - T).max() < 1e-12
    assert (rows > -np.pi).all() and (rows <= np.pi).all()
    assert np.isnan(branches[0, ~reachable[0]]).all()
    s = int(status(robot, q))
    # On a singularity the posture is one of infinitely many, or two branches meet and rounding decides.
    radius = np.hypot(*((T @ arm_family(robot).T_flange_link6)[0, :2, 3]))
    stretch = q[2] - np.arctan2(robot.mdh[2, 2], robot.mdh[3, 1])
    assume(abs(np.sin(q[4])) > 1e-6 and radius > 1e-6 and abs(stretch) > 1e-6)
    assert reachable[0, s]
    assert np.abs(wrap(branches[0, s] - q)).max() < 1e-7
    found = inverse_all(robot, T[0])
    assert found.status is Status.FOUND
    assert np.abs(found.q - q).max(axis=1).min() < 1e-7


@settings(max_examples=150, deadline=None)
@given(unit, names)
def test_status_is_the_controllers_and_the_index_of_the_branch(u, name):
    robot = ROBOTS[name]
    q = within_limits(robot, u)
    lengths = (robot.mdh[0, 2], robot.mdh[1, 2], robot.mdh[2, 2], robot.mdh[3, 1])
    assert int(status(robot, q)) == krl_status(np.degrees(q), *lengths)
    branches, reachable = inverse_branches(robot, forward(robot, q))
    index = np.flatnonzero(reachable[0])
    clear = np.abs(np.sin(branches[0, index, 4])) > 1e-6
    clear &= np.abs(branches[0, index, 2] - np.arctan2(lengths[2], lengths[3])) > 1e-6
    assert np.array_equal(status(robot, branches[0, index])[clear], index[clear])


def test_generic_postures_have_eight_branches():
    T = forward(EXTRA, np.radians([20, -90, 100, 40, 50, 60]))
    branches, reachable = inverse_branches(EXTRA, T)
    assert reachable.all()
    assert len(np.unique(branches[0].round(6), axis=0)) == 8


def test_another_member_of_the_family_with_lateral_offset():
    robot = other_arm()
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (500, 6))
    T = forward(robot, q)
    branches, reachable = inverse_branches(robot, T)
    rows, which = np.nonzero(reachable)
    assert np.abs(forward(robot, branches[rows, which]) - T[rows]).max() < 1e-11
    own = branches[np.arange(500), status(robot, q)]
    assert np.abs(wrap(own - q)).max() < 1e-7
    assert np.array_equal(status(robot, branches[rows, which]), which)


def test_wrist_singularity_keeps_the_pose_and_sets_axis_4_to_zero():
    T = forward(EXTRA, np.radians([20, -90, 100, 40, 0, 60]))
    branches, reachable = inverse_branches(EXTRA, T)
    assert reachable.all()
    assert np.abs(forward(EXTRA, branches[0]) - T).max() < 1e-12
    assert np.abs(branches[0, status(EXTRA, np.radians([20, -90, 100, 40, 0, 60])), 3]) < 1e-12


@settings(max_examples=60, deadline=None)
@given(unit)
def test_turns_are_all_equivalents_within_limits(u):
    q = within_limits(EXTRA, u)
    rows = turns(EXTRA, wrap(q))
    assert np.abs(rows - q).max(axis=1).min() < 1e-12
    assert (rows >= EXTRA.q_min).all() and (rows <= EXTRA.q_max).all()
    assert len(np.unique(rows.round(9), axis=0)) == len(rows)
    expected = 1
    for low, high, value in zip(EXTRA.q_min, EXTRA.q_max, q, strict=True):
        expected *= sum(low - 1e-11 <= value + 2 * np.pi * k <= high + 1e-11 for k in range(-3, 4))
    assert len(rows) == expected


def test_wrapped_angles_are_above_minus_pi_whatever_rounding_does():
    just_above = np.nextafter(np.pi, 4.0)
    angles = np.array([np.pi, -np.pi, just_above, -just_above, 3 * np.pi, 0.0, -1e-17, 7.0])
    wrapped = wrap(angles)
    assert (wrapped > -np.pi).all() and (wrapped <= np.pi).all()
    assert np.abs(np.exp(1j * wrapped) - np.exp(1j * angles)).max() < 1e-14


def test_out_of_reach_tells_by_how_much():
    stretched = np.array([0.3, -0.4, np.arctan2(-0.041, 1.2), 0.5, 0.6, 0.7])
    T = forward(EXTRA, stretched)
    axis_two = np.array([0.35 * np.cos(-0.3), 0.35 * np.sin(-0.3), 0.675])
    centre = T[0, :3, 3] - 0.215 * T[0, :3, 2]
    T[0, :3, 3] += 0.1234 * (centre - axis_two) / np.linalg.norm(centre - axis_two)
    assert reach_excess(EXTRA, T)[0] == pytest.approx(0.1234, abs=1e-9)
    result = inverse_all(EXTRA, T[0])
    assert result.status is Status.OUT_OF_REACH
    assert "123.4 mm" in result.reason()
    assert result.q.shape == (0, 6)
    assert not inverse_branches(EXTRA, T)[1].any()


@pytest.mark.parametrize(("offset", "front"), [(0.02, False), (0.06, True)])
def test_a_wrist_too_near_axis_2_is_reached_from_behind_only(offset, front):
    """Forearm and upper arm differ by 50.7 mm in length: nearer than that to axis 2 no elbow folds."""
    T = np.eye(4)
    T[:3, 3] = [0.35 + offset, 0.0, 0.675 + 0.215]
    reachable = inverse_branches(EXTRA, T)[1][0]
    assert np.hypot(1.2, 0.041) - 1.15 == pytest.approx(0.0507, abs=1e-4)
    assert (reachable[[0, 2, 4, 6]] == front).all() and reachable[[1, 3, 5, 7]].all()
    assert reach_excess(EXTRA, T)[0] == 0.0


def test_outside_limits_names_the_axis():
    T = forward(EXTRA, np.radians([10, 20, 30, 20, 30, 40]))
    result = inverse_all(EXTRA, T[0])
    assert result.status is Status.OUTSIDE_LIMITS
    assert result.axis == 2
    assert "axis 2" in result.reason()


@settings(max_examples=40, deadline=None)
@given(unit, st.integers(0, 4))
def test_calibrated_arms_are_refined_to_their_own_geometry(u, seed):
    robot = calibrated(seed)
    q = within_limits(EXTRA, u)
    T = forward(robot, q)
    branches, reachable = inverse_branches(robot, T)
    rows = branches[0, reachable[0]]
    assert np.abs(forward(robot, rows) - T).max(initial=0.0) < 1e-9
    nominal = (T @ arm_family(robot).T_flange_link6)[0, :2, 3]
    stretch = abs(q[2] - np.arctan2(-0.041, 1.2))
    # A millimetre of error needs this much room to the three singularities.
    assume(abs(np.sin(q[4])) > 0.05 and np.hypot(*nominal) > 0.1 and stretch > 0.1)
    assert np.abs(wrap(rows - q)).max(axis=1).min() < 1e-7


def test_at_the_edge_of_reach_a_calibrated_arm_admits_only_what_its_own_geometry_reaches():
    robot = calibrated(0, 3e-3)
    q = np.random.default_rng(1).uniform(EXTRA.q_min, EXTRA.q_max, (300, 6))
    q[:, 2] = np.arctan2(-0.041, 1.2)
    T = forward(EXTRA, q)
    branches, reachable = inverse_branches(robot, T)
    rows, which = np.nonzero(reachable)
    assert np.abs(forward(robot, branches[rows, which]) - T[rows]).max() < 1e-9
    assert np.isnan(branches[~reachable]).all()
    rounded = robot.mdh.copy()
    rounded[:5, 3:] = np.round(rounded[:5, 3:] / (np.pi / 2)) * np.pi / 2
    rounded[[3, 4], 2] = rounded[4, 1] = 0.0
    member = dataclasses.replace(robot, mdh=rounded)
    assert arm_family(member).exact and not arm_family(robot).exact
    lost = inverse_branches(member, T)[1] & ~reachable
    assert lost.any()  # the nearest family member reaches these, the arm does not


def test_refinement_converges_quadratically_from_a_degree_away():
    q = np.radians([20, -90, 100, 40, 50, 60])
    robot = calibrated(0)
    T = forward(robot, q)
    result = inverse_refined(robot, T, q + np.radians(1.0))
    assert result.converged.all()
    assert np.abs(result.q - q).max() < 1e-11
    assert np.linalg.norm(pose_error(T, forward(robot, result.q))) < 1e-10


def test_refinement_that_cannot_arrive_says_by_how_much():
    T = np.eye(4)
    T[0, 3] = 5.0
    result = inverse_refined(EXTRA, T[None], np.radians([0, -90, 90, 0, 30, 0]))
    assert not result.converged[0]
    assert result.position_error[0] > 1.5


def test_an_arm_of_another_kind_is_refused_with_a_way_out():
    mdh = EXTRA.mdh.copy()
    mdh[3, 2] = 0.4  # axes 4 and 5 far apart: no spherical wrist
    with pytest.raises(BadInput, match="inverse_refined"):
        inverse_branches(dataclasses.replace(EXTRA, mdh=mdh), np.eye(4))
    mdh = EXTRA.mdh.copy()
    mdh[1, 3] = np.pi / 2
    with pytest.raises(BadInput, match="parallel"):
        status(dataclasses.replace(EXTRA, mdh=mdh), np.zeros(6))
