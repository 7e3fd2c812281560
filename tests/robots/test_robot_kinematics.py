"""The MD-H chain against elementary motions, the literal KR 210, Pinocchio, and finite differences."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.kinematics import chain, forward, geometric_jacobian, jacobian, link_frames
from robots.pose import invert, make_transform, rot_x, rot_y, rot_z
from robots.reference_kinematics import elementary_frames
from robots.robot import catalogue, load_robot
from tests.support.reference_arm import body_frames

ROBOTS = {name: load_robot(name) for name in catalogue()}
EXTRA = ROBOTS["kr210_r2700_extra"]
angles = st.lists(st.floats(-6.2, 6.2), min_size=6, max_size=6).map(np.array)


def bent(robot, seed, size=0.1):
    """A robot with every one of its 30 geometric numbers off."""
    noise = np.random.default_rng(seed).normal(0.0, size, (6, 5))
    return dataclasses.replace(robot, mdh=robot.mdh + noise)


def move(x=0.0, y=0.0, z=0.0):
    return make_transform(np.eye(3), [x, y, z])


def turn(R):
    return make_transform(R, [0, 0, 0])


def literal_kr210(q, d1, a1, a2, a3, d4, d6):
    """PHYSICS 2.2: Tz(d1) Rz(-A1) Tx(a1) Ry(A2) Tx(a2) Ry(A3) T(d4,0,a3) Rx(-A4) Ry(A5) Rx(-A6) Tx(d6) Ry(90 deg)."""
    T = move(z=d1) @ turn(rot_z(-q[0])) @ move(x=a1) @ turn(rot_y(q[1])) @ move(x=a2) @ turn(rot_y(q[2]))
    T = T @ move(d4, 0, a3) @ turn(rot_x(-q[3])) @ turn(rot_y(q[4])) @ turn(rot_x(-q[5])) @ move(x=d6)
    return T @ turn(rot_y(np.pi / 2))


@settings(max_examples=60, deadline=None)
@given(angles, st.sampled_from(sorted(name for name in ROBOTS if name.startswith("kr"))))
def test_the_table_is_the_literal_machine(q, name):
    lengths = {
        "kr210_r2700_extra": (0.675, 0.350, 1.150, -0.041, 1.200, 0.215),
        "kr210_r2700_prime": (0.675, 0.350, 1.150, -0.041, 1.200, 0.240),
        "kr210_r2700_2": (0.645, 0.330, 1.150, 0.115, 1.220, 0.215),
    }[name]
    assert np.abs(forward(ROBOTS[name], q)[0] - literal_kr210(q, *lengths)).max() < 1e-14


@settings(max_examples=40, deadline=None)
@given(angles, st.integers(0, 5))
def test_casadi_elementary_and_pinocchio_agree_on_any_arm(q, seed):
    robot = bent(EXTRA, seed)
    frames = link_frames(robot, q)
    assert np.abs(frames - elementary_frames(robot, q)).max() < 1e-13
    assert np.abs(frames[:, 1:] - body_frames(robot, q)).max() < 1e-12


@settings(max_examples=40, deadline=None)
@given(angles, st.sampled_from(["ur5", "ur10"]))
def test_the_ur_arms_are_the_makers_standard_dh(q, name):
    d1, a2, a3, d4, d5, d6 = {
        "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
        "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    }[name]
    quarter = np.pi / 2
    T = move(z=d1) @ turn(rot_z(q[0])) @ turn(rot_x(quarter)) @ turn(rot_z(q[1])) @ move(x=a2)
    T = T @ turn(rot_z(q[2])) @ move(x=a3) @ turn(rot_z(q[3])) @ move(z=d4) @ turn(rot_x(quarter))
    T = T @ turn(rot_z(q[4])) @ move(z=d5) @ turn(rot_x(-quarter)) @ turn(rot_z(q[5])) @ move(z=d6)
    assert np.abs(forward(ROBOTS[name], q)[0] - T).max() < 1e-14


def test_known_postures():
    stretched = forward(EXTRA, np.zeros(6))[0]
    assert np.allclose(stretched[:3, 3], [0.35 + 1.15 + 1.2 + 0.215, 0, 0.675 - 0.041], atol=1e-14)
    assert np.allclose(stretched[:3, 2], [1, 0, 0], atol=1e-14)  # the flange's z points out of the arm
    cannon = forward(EXTRA, np.radians([0, -90, 90, 0, 0, 0]))[0]
    assert np.allclose(cannon[:3, 3], [0.35 + 1.2 + 0.215, 0, 0.675 + 1.15 - 0.041], atol=1e-14)
    left = forward(EXTRA, np.radians([-90, -90, 90, 0, 0, 0]))[0]  # KUKA's axis 1 turns clockwise
    assert left[1, 3] > 1.7


@settings(max_examples=30, deadline=None)
@given(angles, st.integers(0, 5))
def test_jacobian_is_the_derivative_of_the_pose(q, seed):
    robot, h = bent(EXTRA, seed), 1e-5
    plus, minus = (forward(robot, q + s * h * np.eye(6)) for s in (1, -1))
    J = jacobian(robot, q)[0]
    assert np.abs((plus - minus)[:, :3, 3].T / (2 * h) - J[:3]).max() < 1e-8
    R = plus[:, :3, :3] @ np.swapaxes(minus[:, :3, :3], 1, 2)
    odd = 0.5 * (R - np.swapaxes(R, 1, 2))
    omega = np.stack([odd[:, 2, 1], odd[:, 0, 2], odd[:, 1, 0]]) / (2 * h)
    assert np.abs(omega - J[3:]).max() < 1e-8


def test_builders_serve_symbolic_geometry_and_an_arbitrary_point():
    q, mdh, local = ca.SX.sym("q", 6), ca.SX.sym("mdh", 6, 5), ca.SX.sym("p", 3)
    frames = chain(q, mdh, EXTRA.sign)
    point = frames[6][:3, :3] @ local + frames[6][:3, 3]
    by_casadi = ca.jacobian(point, q)
    both = ca.Function("both", [q, mdh, local], [geometric_jacobian(frames, EXTRA.sign, point)[:3, :], by_casadi])
    a, b = both(np.linspace(-1, 1, 6), bent(EXTRA, 3).mdh, [0.1, -0.2, 0.3])
    assert len(frames) == 7
    assert float(ca.norm_inf(ca.vec(a - b))) < 1e-13


def test_builders_serve_mx_as_well():
    q = ca.MX.sym("q", 6)
    pose = ca.Function("pose", [q], [chain(q, EXTRA.mdh, EXTRA.sign)[-1]])
    posture = np.linspace(-1, 1, 6)
    assert np.abs(pose(posture).full() - forward(EXTRA, posture)[0]).max() < 1e-14


def test_stacks_equal_single_postures_across_the_chunk_edge():
    q = np.random.default_rng(1).uniform(-3, 3, (5000, 6))
    T = forward(EXTRA, q)
    assert T.shape == (5000, 4, 4)
    for k in (0, 2047, 2048, 4999):
        assert np.array_equal(T[k], forward(EXTRA, q[k])[0])
    assert forward(EXTRA, np.empty((0, 6))).shape == (0, 4, 4)
    assert np.abs(invert(T) @ T - np.eye(4)).max() < 1e-13


def test_two_arms_of_one_name_do_not_share_a_cache():
    other = dataclasses.replace(EXTRA, mdh=bent(EXTRA, 0).mdh)
    q = np.linspace(-1, 1, 6)
    before = forward(EXTRA, q)
    assert np.abs(forward(other, q) - before).max() > 0.01
    assert np.array_equal(forward(EXTRA, q), before)


def shape_gap(robot, frames, i, j):
    """Smallest distance between the capsules of links i and j, by 41 points along each."""

    def points(link):
        for at, p0, p1, radius in robot.link_shapes:
            if at == link:
                line = p0 + (p1 - p0) * np.linspace(0, 1, 41)[:, None]
                yield line @ frames[link][:3, :3].T + frames[link][:3, 3], radius

    pairs = [(a, ra, b, rb) for a, ra in points(i) for b, rb in points(j)]
    return min(np.linalg.norm(a[:, None] - b[None], axis=-1).min() - ra - rb for a, ra, b, rb in pairs)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_capsules_leave_no_gap_at_a_joint_and_seldom_meet_elsewhere(name):
    robot = ROBOTS[name]
    q = np.random.default_rng(4).uniform(robot.q_min, robot.q_max, (20, 6))
    for frames in link_frames(robot, q):
        assert all(shape_gap(robot, frames, i, i + 1) < 0 for i in range(6))
        # Forearm and flange are joined by the wrist alone: its limits keep them apart in every posture. A UR's do not.
        assert shape_gap(robot, frames, 3, 6) > 0.05 or name.startswith("ur")
    pairs = [(i, j) for i in range(7) for j in range(i + 3, 7)]
    cannon = link_frames(robot, np.radians([0, -90, 90, 0, 0, 0]))[0]
    assert all(shape_gap(robot, cannon, i, j) > 0.02 for i, j in pairs)
    # The last capsule ends at the flange's face, not beyond it.
    _, p0, p1, radius = next(shape for shape in robot.link_shapes if shape[0] == 6)
    assert max(p0[2], p1[2]) + radius == pytest.approx(0.0, abs=1e-12)
