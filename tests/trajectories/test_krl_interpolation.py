"""Points of a program and the curve a controller lays through them."""

import numpy as np
import pytest

from robots.errors import BadInput
from tests.support.krl_example import ROBOT, contact_poses, example, legs, write
from trajectories.krl.checks import check_program
from trajectories.krl.interpreter import execute
from trajectories.krl.values import FILE_LIMITS
from trajectories.program.interpolation import emit, pose_spline, reinterpolate, rest_to_rest_spline


def test_the_spline_meets_points_rests_at_the_ends_and_is_exact_for_a_quintic():
    t = np.linspace(0, 2, 9)
    x = t / 2
    q = (10 * x**3 - 15 * x**4 + 6 * x**5)[:, None] * np.arange(1, 7)
    spline = rest_to_rest_spline(q, t)
    fine = np.linspace(0, 2, 101)
    y = fine / 2
    assert np.allclose(spline(fine), (10 * y**3 - 15 * y**4 + 6 * y**5)[:, None] * np.arange(1, 7), atol=1e-12)
    assert np.allclose(spline([0, 2], nu=1), 0, atol=1e-10) and np.allclose(spline([0, 2], nu=2), 0, atol=1e-9)


def test_deviation_falls_with_the_step_and_emission_keeps_the_tolerance():
    contact = legs()[2].trajectory
    deviations = [emit(contact, FILE_LIMITS, 1.0, step=h).deviation for h in (0.1, 0.05, 0.025)]
    assert deviations[0] > 3 * deviations[1] > 9 * deviations[2]
    coarse = emit(contact, FILE_LIMITS, 2e-5, step=0.1)
    assert coarse.deviation <= 2e-5
    assert np.diff(coarse.times).min() >= 0.012
    t = np.arange(0, contact.duration, 0.37e-3)
    driven = rest_to_rest_spline(coarse.q, coarse.times)(t)
    assert np.abs(driven - contact.q(t)).max() <= 2.1e-5


def test_a_measure_of_the_caller_is_bounded():
    contact = legs()[2].trajectory

    def millimetres(planned, driven):
        return 1e3 * np.linalg.norm((contact_poses(planned) - contact_poses(driven))[:, :3, 3], axis=1)

    assert emit(contact, FILE_LIMITS, 0.02, millimetres, step=0.05).deviation <= 0.02


def test_the_program_read_back_drives_the_plan(tmp_path):
    plan = legs()
    motion = reinterpolate(check_program(write(example(), tmp_path)), ROBOT.qd_max, ROBOT.qdd_max)
    assert motion.duration == pytest.approx(sum(leg.trajectory.duration for leg in plan), abs=4e-5)
    for start, leg in zip(motion.starts, plan, strict=True):
        t = np.arange(0, leg.trajectory.duration, 1e-3)
        assert np.abs(motion.q(start + t) - leg.trajectory.q(t)).max() < 2e-5
    t = motion.sample_times()
    assert np.abs(motion.qd(t) / ROBOT.qd_max).max() <= 1.0
    assert np.abs(motion.qdd(t) / ROBOT.qdd_max).max() <= 1.0
    assert np.allclose(np.gradient(motion.q(t), t, axis=0)[1:-2], motion.qd(t)[1:-2], atol=2e-3)


def test_a_ptp_between_blocks_takes_its_time(tmp_path):
    source = write(example(passes=2), tmp_path)
    motion = reinterpolate(check_program(source), ROBOT.qd_max, ROBOT.qdd_max)
    assert len(motion.pieces) == 4 + 1 + 4
    t = motion.sample_times()
    assert np.abs(motion.qd(t) / ROBOT.qd_max).max() <= 1.0
    assert np.abs(np.diff(motion.q(t), axis=0)).max() < 2e-3


def test_programs_of_poses_are_not_replayed_as_axes(tmp_path):
    with pytest.raises(BadInput, match="SPLINE is not an axis motion"):
        reinterpolate(execute(write(example("cartesian"), tmp_path)), ROBOT.qd_max, ROBOT.qdd_max)


def test_the_curve_through_poses_stays_on_the_contact_path():
    contact = legs()[2].trajectory
    t = np.linspace(0, contact.duration, 60)[5:-5]
    curve, length = pose_spline(contact_poses(contact.q(t)))
    dense = curve(np.linspace(0, length, 400))
    true = contact_poses(contact.q(np.linspace(t[0], t[-1], 4000)))
    for T in dense[::20]:
        i = int(np.argmin(np.linalg.norm(true[:, :3, 3] - T[:3, 3], axis=1)))
        assert np.linalg.norm(true[i, :3, 3] - T[:3, 3]) < 2e-5
        assert np.abs(true[i, :3, :3] - T[:3, :3]).max() < 1e-4
