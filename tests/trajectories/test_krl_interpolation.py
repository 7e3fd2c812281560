"""Points of a program and the curve a controller lays through them."""

import numpy as np
import pytest

from robots.errors import BadInput
from robots.pose import transform_from_xyzabc
from tests.support.krl_example import ROBOT, contact_poses, elementary_forward, example, legs, write
from trajectories.krl.checks import check_program
from trajectories.krl.interpreter import execute
from trajectories.krl.values import FILE_LIMITS
from trajectories.program.driven import drive_lines, pose_curve, reinterpolate, rest_to_rest_spline
from trajectories.program.execution import Frames, PathBounds, ProgramSegment
from trajectories.program.interpolation import emit


def everywhere(most):
    return lambda t: np.full(len(t), most)


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
    deviations = [emit(contact, FILE_LIMITS, everywhere(1.0), step=h).deviation for h in (0.1, 0.05, 0.025)]
    assert deviations[0] > 3 * deviations[1] > 9 * deviations[2]
    coarse = emit(contact, FILE_LIMITS, everywhere(2e-5), step=0.1)
    assert coarse.deviation <= 2e-5
    assert np.diff(coarse.times).min() >= 0.012
    t = np.arange(0, contact.duration, 0.37e-3)
    driven = rest_to_rest_spline(coarse.points, coarse.times)(t)
    assert np.abs(driven - contact.q(t)).max() <= 2.1e-5


def test_a_measure_of_the_caller_is_bounded():
    contact = legs()[2].trajectory

    def millimetres(planned, driven):
        return 1e3 * np.linalg.norm((contact_poses(planned) - contact_poses(driven))[:, :3, 3], axis=1)

    assert emit(contact, FILE_LIMITS, everywhere(0.02), millimetres, step=0.05).deviation <= 0.02


def test_the_program_read_back_drives_the_plan(tmp_path):
    plan = legs()
    motion = reinterpolate(check_program(write(example(), tmp_path)), ROBOT)
    assert motion.duration == pytest.approx(sum(leg.trajectory.duration for leg in plan), abs=4e-5)
    for start, leg in zip(motion.starts, plan, strict=True):
        t = np.arange(0, leg.trajectory.duration, 1e-3)
        assert np.abs(motion.q(start + t) - leg.trajectory.q(t)).max() < 2e-5
    t = np.append(np.arange(0.0, motion.duration, 1e-3), motion.duration)
    assert np.abs(motion.qd(t) / ROBOT.qd_max).max() <= 1.0
    assert np.abs(motion.qdd(t) / ROBOT.qdd_max).max() <= 1.0
    assert np.allclose(np.gradient(motion.q(t), t, axis=0)[1:-2], motion.qd(t)[1:-2], atol=2e-3)


def test_a_ptp_between_blocks_takes_its_time(tmp_path):
    source = write(example(passes=2), tmp_path)
    motion = reinterpolate(check_program(source), ROBOT)
    assert len(motion.pieces) == 4 + 1 + 4
    t = np.append(np.arange(0.0, motion.duration, 1e-3), motion.duration)
    assert np.abs(motion.qd(t) / ROBOT.qd_max).max() <= 1.0
    assert np.abs(np.diff(motion.q(t), axis=0)).max() < 2e-3


def test_the_poses_read_back_drive_what_the_axes_drive(tmp_path):
    """The same plan as axes and as poses: the same times, the same posture at every millisecond."""
    motions = [reinterpolate(check_program(write(example(kind), tmp_path), ROBOT), ROBOT) for kind in ("axis", "cartesian")]
    t = np.arange(0.0, motions[0].duration, 1e-3)
    assert motions[1].duration == pytest.approx(motions[0].duration, abs=1e-9)
    np.testing.assert_allclose(motions[1].starts, motions[0].starts, atol=1e-9)
    one, two = (elementary_forward(motion.q(t)) for motion in motions)
    assert np.linalg.norm(one[:, :3, 3] - two[:, :3, 3], axis=1).max() < 2e-5  # each is within the tolerance of the plan
    assert np.abs(motions[0].q(t) - motions[1].q(t)).max() < 2.5e-5
    assert np.abs(motions[1].qdd(t) / ROBOT.qdd_max).max() <= 1.0


def test_motions_without_times_are_not_replayed(tmp_path):
    with pytest.raises(BadInput, match="LIN has no times"):
        reinterpolate(execute(write(example("lin"), tmp_path)), ROBOT)


def test_the_curve_through_poses_stays_on_the_contact_path():
    contact = legs()[2].trajectory
    t = np.linspace(0, contact.duration, 80)
    fine = np.linspace(0, contact.duration, 700)
    driven, planned = pose_curve(contact_poses(contact.q(t)), t)(fine), contact_poses(contact.q(fine))
    assert np.abs(driven[:, :3, 3] - planned[:, :3, 3]).max() < 2e-6 and np.abs(driven - planned).max() < 1e-5


def test_a_turn_beyond_half_a_circle_is_no_jump():
    """Quaternions of one pose come with two signs; the curve goes on with that of the pose before."""
    angle = np.linspace(-3.0, 3.0, 41)
    poses = np.array([transform_from_xyzabc([0.0, 0.0, 0.1 * a], [a, 0.4, 0.0]) for a in angle])
    t = np.linspace(0, 2, 41)
    found = pose_curve(poses, t)(np.linspace(0.1, 1.9, 181))
    steps = np.linalg.norm(np.diff(found[:, :3, :3], axis=0), axis=(1, 2))
    assert steps.max() < 1.6 * np.median(steps)


def lines(poses, speeds, acceleration=1.0):
    bounds = [PathBounds(v, acceleration) for v in speeds]
    rows = zip(poses[1:], bounds, strict=True)
    return [ProgramSegment("line", "LIN", "x", np.ones(1), None, P[None], None, Frames(), bounds=b) for P, b in rows]


def test_blended_lines_keep_the_speed_of_each_side_and_never_rest():
    """Ten sides of 4 mm round a corner: 20, then 40, then 20 mm/s with 1 m/s^2. Each lasts as long as its way over its speed,
    and a change by dv on the faster side, of v, takes dv^2 / (2 a v) more."""
    way = np.array([[0, 0]] + [[k, 0] for k in range(1, 6)] + [[5, k] for k in range(1, 6)]) * 4e-3
    poses = np.tile(np.eye(4), (11, 1, 1))
    poses[:, :2, 3] = way
    speeds = np.array([0.02] * 3 + [0.04] * 4 + [0.02] * 3)
    found = drive_lines(lines(poses, speeds), poses[0])
    changes = [(v - w) ** 2 / 2 / max(v, w) for v, w in ((0.0, 0.02), (0.02, 0.04))]  # s, with 1 m/s^2
    expected = (4e-3 / speeds).sum() + 2 * sum(changes)
    assert found.times[-1] == pytest.approx(expected, rel=1e-3)
    speed = np.linalg.norm(np.diff(found.poses[:, :3, 3], axis=0), axis=1) / np.diff(found.times)
    assert speed.max() < 0.0401 and speed[30:-30].min() > 0.013  # a corner is cut: its way is shorter than its two sides
    corner = np.linalg.norm(found.poses[:, :2, 3] - way[5], axis=1).min()
    assert corner == pytest.approx(np.hypot(1, 1) * 2e-3 / 4, rel=0.01)
    assert len(found.corners) == 11 and (np.diff(found.corners) > 0).all()


def test_a_line_by_itself_is_sped_up_along_driven_and_stopped():
    """10 mm at 40 mm/s with 1 m/s^2, straight: its way over its speed, and a speed over an acceleration more."""
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 0.01
    found = drive_lines(lines(poses, [0.04]), poses[0])
    assert found.times[-1] == pytest.approx(0.01 / 0.04 + 0.04, abs=1e-9) and np.allclose(found.corners, [0.0, found.times[-1]])
    assert np.allclose(found.poses[[0, -1]], poses) and np.abs(found.poses[:, 1:3, 3]).max() < 1e-12
    assert (np.diff(found.poses[:, 0, 3]) >= 0).all()


def test_points_of_straight_motions_are_as_far_apart_as_a_controller_needs(tmp_path):
    contact = legs()[2].trajectory
    execution = check_program(write(example("lin"), tmp_path), ROBOT)
    on = [s for s in execution.segments if s.poses is not None]
    ends = [k for k, s in enumerate(on) if not s.blended]
    chain = on[ends[0] + 1 : ends[1] + 1]
    P = np.concatenate([contact_poses(contact.q(np.zeros(1))), *(s.poses for s in chain)])
    ways = np.linalg.norm(np.diff(P[:, :3, 3], axis=0), axis=1)
    seconds = ways / np.array([s.speed for s in chain])
    assert ways.min() > 5e-5 and seconds.min() > 0.0249 and seconds.sum() == pytest.approx(contact.duration, rel=2e-3)
