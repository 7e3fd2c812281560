"""Weight, springs and dynamics against PHYSICS 2.5, Pinocchio, plain NumPy and closed forms."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.compliance import compliance_from_stiffness, deflect, deflected_joints
from robots.gravity import GRAVITY, gravity_torques, link_torques, weighed_links, weight_torques
from robots.kinematics import forward, jacobian
from robots.rigid_body import inverse_dynamics
from robots.robot import load_robot
from tests.support.reference_arm import elementary_weight_torques, generalised_gravity, point_compliance

EXTRA = load_robot("kr210_r2700_extra")
COM = np.array([0.01, -0.02, 0.22])
angles = st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6).map(np.array)


def bent(seed):
    noise = np.random.default_rng(seed).normal(0.0, 0.05, (6, 5))
    return dataclasses.replace(EXTRA, mdh=EXTRA.mdh + noise)


@settings(max_examples=40, deadline=None)
@given(angles)
def test_own_weight_is_the_printed_formula(q):
    """PHYSICS 2.5, printed to 0.1 N m; links 5 and 6 weigh nothing, so the wrist does not matter."""
    tau = weight_torques(EXTRA, q)[0]
    q23 = q[1] + q[2]
    tau3 = 990.9 * np.cos(q23) - 23.1 * np.sin(q23)
    assert abs(tau[2] - tau3) < 0.1
    assert abs(tau[1] - (3728.1 * np.cos(q[1]) + tau3)) < 0.15
    assert abs(tau[0]) < 1e-9


@settings(max_examples=40, deadline=None)
@given(angles, st.floats(0, 210), st.integers(0, 5))
def test_weight_is_minus_the_generalised_gravity(q, mass, seed):
    robot = bent(seed)
    tau = weight_torques(robot, q, mass, COM)
    scale = np.abs(tau).max()
    assert np.abs(tau + generalised_gravity(robot, q, mass, COM)).max() < 1e-9 * scale
    assert np.abs(tau - elementary_weight_torques(robot, q, GRAVITY, mass, COM)).max() < 1e-12 * max(scale, 1)


def test_weight_is_the_gradient_of_the_potential_energy():
    """tau_j = -dU/dq_j with U of the payload alone, by central differences."""
    light = dataclasses.replace(EXTRA, link_mass=np.zeros(7))
    q, h = np.array([0.3, -1.2, 1.4, 0.5, -0.7, 2.0]), 1e-5

    def energy(rows):
        T = forward(light, rows)
        return 150.0 * GRAVITY * (T[:, 2, :3] @ COM + T[:, 2, 3])

    gradient = (energy(q + h * np.eye(6)) - energy(q - h * np.eye(6))) / (2 * h)
    assert np.abs(weight_torques(light, q, 150.0, COM)[0] + gradient).max() < 1e-5


def test_inverse_dynamics_is_consistent_with_energy():
    """The power of the motors is the change of kinetic and potential energy along any motion."""

    def state(t):
        w = np.array([0.7, 1.1, 0.9, 1.7, 1.3, 2.1])
        A = np.array([0.5, 0.3, 0.4, 0.8, 0.6, 0.9])
        q = np.array([0.1, -1.3, 1.5, 0.2, 0.4, -0.3]) + A * np.sin(w * t)
        return q, A * w * np.cos(w * t), -A * w**2 * np.sin(w * t)

    def energy(t):
        q, qd, _ = state(t)
        still = np.zeros(6)
        columns = [inverse_dynamics(EXTRA, 150.0, COM, q, still, e)[0] for e in np.eye(6)]
        M = np.array(columns) - inverse_dynamics(EXTRA, 150.0, COM, q, still, still)
        frames = forward(EXTRA, q)[0]
        # The links' own potential by their torques is checked above; here a quadrature-free difference
        # suffices.
        return 0.5 * qd @ M @ qd, 150.0 * GRAVITY * (frames[2, :3] @ COM + frames[2, 3])

    t, h = 0.37, 1e-4
    q, qd, qdd = state(t)
    power = inverse_dynamics(EXTRA, 150.0, COM, q, qd, qdd)[0] @ qd
    kinetic = (energy(t + h)[0] - energy(t - h)[0]) / (2 * h)
    payload = (energy(t + h)[1] - energy(t - h)[1]) / (2 * h)
    links = -weight_torques(EXTRA, q)[0] @ qd
    assert abs(power - (kinetic + payload + links)) < 1e-4 * abs(power)


def test_holding_torque_opposes_the_weight():
    q = np.radians([0, -30, 30, 0, 0, 0])
    still = np.zeros(6)
    assert np.allclose(inverse_dynamics(EXTRA, 90.0, COM, q, still, still), -weight_torques(EXTRA, q, 90.0, COM))
    assert weight_torques(EXTRA, q)[0, 1] > 0  # a stretched arm sinks toward +A2


def test_two_steps_leave_less_than_a_tenth_of_a_micrometre():
    q = np.random.default_rng(2).uniform(EXTRA.q_min, EXTRA.q_max, (300, 6))
    c = 1 / EXTRA.stiffness

    def position(steps):
        return forward(EXTRA, deflect(EXTRA, q, c, 150.0, COM, steps=steps))[:, :3, 3]

    converged = position(40)
    assert np.abs(position(1) - converged).max() > 1e-6
    assert np.abs(position(2) - converged).max() < 1e-7


def test_deflection_of_one_joint_in_closed_form():
    """A pendulum of stiffness k: q_real solves k (q_real - q) = m g l cos q_real; its series to c^2 is two steps."""
    q, torque, c = ca.SX.sym("q"), 5000.0, 1e-6
    real = ca.Function("real", [q], [deflected_joints(q, lambda x: torque * ca.cos(x), c)])
    s = c * torque
    second_order = 0.4 + s * np.cos(0.4) - s**2 * np.sin(0.4) * np.cos(0.4)
    assert abs(float(real(0.4)) - second_order) < s**3
    assert abs(float(real(0.4)) - second_order) > 0


def test_symbolic_deflection_is_the_numeric_one():
    q = ca.SX.sym("q", 6)
    c = compliance_from_stiffness(EXTRA.stiffness) * np.array([0, 1, 1, 0, 0, 0])

    def torque(x):
        return gravity_torques(x, EXTRA.mdh, EXTRA.sign, EXTRA.link_mass, EXTRA.link_com, 150.0, COM, EXTRA.gravity_direction)

    function = ca.Function("f", [q], [deflected_joints(q, torque, c)])
    posture = np.array([0.3, -1.2, 1.4, 0.5, -0.7, 2.0])
    numeric = deflect(EXTRA, posture, c, 150.0, COM)[0]
    assert np.abs(function(posture).full()[:, 0] - numeric).max() < 1e-15
    assert np.abs(numeric - posture)[1:3].min() > 1e-4
    assert np.array_equal(numeric[[0, 3, 4, 5]], posture[[0, 3, 4, 5]])


def test_rigid_joints_do_not_give_and_do_not_break_derivatives():
    k = ca.SX.sym("k", 6)
    J = jacobian(EXTRA, np.array([0.3, -1.2, 1.4, 0.5, -0.7, 2.0]))[0, :3]
    C = ca.SX(J) @ ca.diag(compliance_from_stiffness(k)) @ ca.SX(J).T
    value = ca.Function("value", [k], [C, ca.jacobian(C, k)])
    stiffness = np.array([2e6, 0, 2.46e6, 0, 0.35e6, 0.0])
    numeric, slope = (x.full() for x in value(stiffness))
    springs = stiffness > 0
    expected = J[:, springs] @ np.diag(1 / stiffness[springs]) @ J[:, springs].T
    assert np.allclose(numeric, expected, rtol=1e-13, atol=0)
    assert np.isfinite(slope).all()
    assert np.array_equal(compliance_from_stiffness(stiffness)[~springs], np.zeros(3))


def test_twenty_newton_bend_the_arm_by_hundredths_of_a_millimetre():
    """PHYSICS 2.5: about 0.03 mm; and the give at a point is what the joints do under its moment."""
    q = np.radians([0, -70, 110, 0, 40, 0])
    point = forward(EXTRA, q)[0, :3, 3] + [0.05, 0.1, 0.2]
    C = point_compliance(EXTRA, q, point)[0]
    assert 0.005e-3 < np.linalg.norm(C @ [0, 0, 20.0]) < 0.1e-3
    J = jacobian(EXTRA, q)[0]
    lever = point - forward(EXTRA, q)[0, :3, 3]
    force = np.array([3.0, -5.0, 7.0])
    joint_torque = J[:3].T @ force + J[3:].T @ np.cross(lever, force)
    dq = joint_torque / EXTRA.stiffness
    moved = J[:3] @ dq + np.cross(J[3:] @ dq, lever)
    assert np.allclose(C @ force, moved, rtol=1e-12)


@pytest.mark.parametrize("name", ["kr210_r2700_prime", "kr210_r2700_2"])
def test_the_other_variants_carry_the_same_masses_at_their_own_axes(name):
    """The wrist block sits on axis 4 of each variant: its weight never turns axis 4."""
    robot = load_robot(name)
    q = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (50, 6))
    tau = weight_torques(robot, q)
    assert np.abs(tau[:, 3:]).max() < 1e-9
    straight = weight_torques(robot, np.zeros(6))[0]
    assert abs(straight[2] - GRAVITY * (173.31 * 0.19737 + 57.53 * (robot.mdh[3, 1] - 0.03883))) < 1e-9


def test_torques_of_weights_are_those_of_other_links():
    robot = load_robot("kr210_r2700_extra")
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (7, 6))
    found, step = link_torques(robot, q), 1e-3
    for at, (_, link, axis) in enumerate(weighed_links(robot)):
        mass, com = robot.link_mass.copy(), robot.link_com.copy()
        if axis < 0:
            mass[link] *= 1.0 + step
        else:
            com[link, axis] += step
        changed = weight_torques(dataclasses.replace(robot, link_mass=mass, link_com=com), q) - weight_torques(robot, q)
        np.testing.assert_allclose(found[:, :, at], changed / step, atol=1e-6)
