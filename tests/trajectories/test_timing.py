"""Timing: limits hold everywhere, the analytic fastest move is met, the feed is constant where it can be."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from robots.errors import BadInput, Infeasible
from trajectories.joint_trajectory import Limits, TimingStatus, ramps, sample_times
from trajectories.timing import time_contact_path, time_joint_move
from trajectories.toppra_law import squared_speeds, stretched, time_law, times_at

INERTIA = np.array([800.0, 900, 400, 30, 20, 5])
WEIGHT = np.array([0.0, 3700, 990, 50, 40, 2])


def torque(q, qd, qdd):
    """A rigid-body law in form: inertia that depends on q, a term quadratic in the speeds, weight."""
    next_axis = np.roll(np.cos(q), 1, axis=1)
    return INERTIA * (1 + 0.3 * next_axis) * qdd + WEIGHT * np.cos(q) + 200 * qd * np.roll(qd, 1, axis=1)


ARM = Limits(
    qd=np.radians([123.0, 115, 112, 179, 172, 219]),
    qdd=np.array([2.0, 2, 2, 5, 5, 5]),
    q_min=np.full(6, -6.0),
    q_max=np.full(6, 6.0),
    torque_max=np.array([7290.0, 8100, 5291, 2182, 1282, 825]),
    torque=torque,
    margin=0.9,
)


def smooth_pass(n=200, length=0.1, seed=0, knots=6, size=0.05):
    rng = np.random.default_rng(seed)
    knots = CubicSpline(np.linspace(0, length, knots), np.cumsum(rng.normal(size=(knots, 6)) * size, axis=0))
    s = np.linspace(0, length, n)
    return knots(s), s


def worst_by_differences(trajectory, period=0.37e-3):
    """Ratios from positions alone: central differences, not the code's derivatives."""
    t = np.arange(0, trajectory.duration + period, period)
    h = 2e-5
    q0, q1, q2 = (trajectory.q(t + d) for d in (-h, 0.0, h))
    inner = (t > 2 * h) & (t < trajectory.duration - 2 * h)
    qd, qdd = ((q2 - q0) / (2 * h))[inner], ((q2 - 2 * q1 + q0) / h**2)[inner]
    limits = trajectory.limits
    feed = (trajectory.s(t + h) - trajectory.s(t - h))[inner] / (2 * h)
    return (
        np.abs(qd / limits.qd).max(),
        np.abs(qdd / limits.qdd).max(),
        np.abs(limits.torque(q1[inner], qd, qdd) / limits.torque_max).max() if limits.torque else 0.0,
        feed,
    )


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(2, 40),
    size=st.floats(0.002, 0.3),
    feed=st.one_of(st.none(), st.floats(0.03, 0.5)),
    margin=st.floats(0.5, 1.0),
)
def test_no_limit_is_ever_exceeded_on_random_paths(seed, n, size, feed, margin):
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.normal(size=(n, 6)) * size, axis=0)
    limits = replace(ARM, margin=margin, q_min=np.full(6, -60.0), q_max=np.full(6, 60.0))
    s = np.cumsum(rng.uniform(0.002, 0.02, n))
    trajectory = time_contact_path(q, s, feed, limits)
    velocity, acceleration, tau, speed = worst_by_differences(trajectory)
    assert max(velocity, acceleration, tau) <= margin * 1.001 <= 1.001
    assert feed is None or speed.max() <= feed * (1 + 1e-6)
    worst = trajectory.worst
    assert max(worst.velocity, worst.acceleration, worst.torque) <= margin + 1e-12
    assert worst.feed <= 1.0
    assert np.allclose(trajectory.q(0.0), q[0], atol=1e-12) and np.allclose(trajectory.q(trajectory.duration), q[-1], atol=1e-12)
    assert np.allclose(trajectory.qd([0.0, trajectory.duration]), 0, atol=1e-6)
    assert np.allclose(trajectory.q(trajectory.times), q[trajectory.kept], atol=1e-9)


@pytest.mark.parametrize("size", [0.01, 1.0])
def test_speeds_accelerations_and_feed_are_what_the_joints_do(size):
    """Of a short move too, whose speed is above its length, in numbers."""
    start = np.radians([5.0, -70, 100, 10, -40, 20])
    move = time_joint_move(start, start + size * np.array([0.2, -1.0, 0.5, 0.1, 0.7, -0.3]), ARM, window=0.02)
    t, h = np.linspace(0.0, move.duration, 200)[1:-1], 1e-6
    before, here, after = (move.q(t + d) for d in (-h, 0.0, h))
    assert np.allclose(move.qd(t), (after - before) / (2 * h), atol=1e-6)
    assert np.allclose(move.qdd(t), (move.qd(t + h) - move.qd(t - h)) / (2 * h), atol=1e-3)
    assert np.allclose(move.feed(t), np.abs(move.qd(t)).max(axis=1), atol=1e-9) and np.allclose(
        move.motion(t)[0], here, atol=1e-12
    )


@pytest.mark.parametrize("distance, v, a", [(1.0, 1.0, 2.0), (1.0, 10.0, 2.0), (0.01, 2.0, 3.0), (2.5, 0.3, 5.0)])
def test_a_single_axis_move_takes_the_bang_bang_time(distance, v, a):
    limits = Limits(np.full(6, v), np.full(6, a), np.full(6, -9.0), np.full(6, 9.0), margin=1.0)
    goal = np.zeros(6)
    goal[2] = distance
    analytic = distance / v + v / a if distance > v**2 / a else 2 * np.sqrt(distance / a)
    sharp = time_joint_move(np.zeros(6), goal, limits, window=0.0)
    assert analytic <= sharp.duration <= 1.004 * analytic
    smooth = time_joint_move(np.zeros(6), goal, limits, window=0.05)
    assert smooth.duration == pytest.approx(sharp.duration + 0.05, rel=1e-3)


def test_a_joint_move_goes_straight_from_its_start_to_its_goal():
    start, goal = np.radians([[5.0, -70, 100, 10, -40, 20], [25.0, -80, 95, 10, -10, 50]])
    move = time_joint_move(start, goal, ARM)
    q = move.q(np.linspace(0.0, move.duration, 101))
    assert np.allclose(q[[0, -1]], [start, goal], atol=1e-12)
    share = (q[:, 4] - start[4]) / (goal[4] - start[4])
    assert np.allclose(q, start + share[:, None] * (goal - start), atol=1e-9) and (np.diff(share) > -1e-12).all()


def test_the_feed_is_constant_in_the_middle_of_a_pass_and_never_above_its_bound():
    q, s = smooth_pass()
    trajectory = time_contact_path(q, s, 0.04, ARM)
    start, end = ramps(trajectory)
    t = sample_times(trajectory)
    middle = (trajectory.s(t) > start) & (trajectory.s(t) < s[-1] - end)
    assert start < 0.008 and end < 0.008
    assert np.all(np.abs(trajectory.feed(t[middle]) / 0.04 - 1) < 0.011)
    assert np.median(trajectory.feed(t)) == pytest.approx(0.04, rel=2e-4)
    assert trajectory.feed(t).max() <= 0.04


def test_a_feed_that_varies_along_the_pass_is_followed():
    q, s = smooth_pass()
    bound = np.where(s < 0.05, 0.04, 0.02)
    trajectory = time_contact_path(q, s, bound, ARM)
    t = np.linspace(0, trajectory.duration, 5001)
    assert np.all(trajectory.feed(t) <= np.interp(trajectory.s(t), s, bound) * (1 + 1e-9))
    assert trajectory.feed(trajectory.times[50]) == pytest.approx(0.04, rel=1e-3)
    assert trajectory.feed(trajectory.times[150]) == pytest.approx(0.02, rel=1e-3)
    assert max(ramps(trajectory)) < 0.008  # of its own feed at either end


def test_a_path_that_rests_at_its_ends_is_driven_at_its_feed_from_the_start():
    """Joints that move with the cube of the way to either end: the path's parameter need not rest there."""
    k = np.linspace(0.0, 1.0, 200)
    q = (10 * k**3 - 15 * k**4 + 6 * k**5)[:, None] * np.radians([3.0, -2, 4, 1, -3, 2])
    trajectory = time_contact_path(q, 0.1 * k, 0.04, ARM, window=0.01, at_rest=True)
    assert trajectory.duration == pytest.approx(0.1 / 0.04 + 0.01, rel=1e-3)
    assert np.all(trajectory.feed(np.linspace(0.011, trajectory.duration - 0.011, 500)) > 0.0399)
    assert np.allclose(trajectory.qd([0.0, trajectory.duration]), 0, atol=1e-9)


def test_the_path_acceleration_has_no_jumps_and_without_the_running_mean_it_has():
    q, s = smooth_pass()
    for window, jumps in ((0.05, False), (0.0, True)):
        law = time_contact_path(q, s, 0.04, ARM, window=window).law
        inner = law.x[1:-1]
        jump = np.abs(law(inner + 1e-9, 2) - law(inner - 1e-9, 2)).max()
        assert (jump > 0.05) == jumps, jump


def test_torque_that_holds_no_posture_at_rest_is_refused_with_axis_station_and_ratio():
    q, s = smooth_pass(size=0.0)
    limits = replace(ARM, torque_max=np.array([7290.0, 3800, 5291, 2182, 1282, 825]))
    with pytest.raises(Infeasible, match=r"pass 3: axis 2 needs 0\.97\d of its torque limit .* at station .* mm"):
        time_contact_path(q, s, 0.04, limits, label="pass 3")


def test_an_axis_outside_its_range_is_refused():
    q, s = smooth_pass()
    with pytest.raises(Infeasible, match=r"axis \d is .* outside its range"):
        time_contact_path(q + 6.0, s, 0.04, ARM)


def test_an_axis_that_leaves_its_range_between_two_waypoints_is_refused():
    """Four waypoints of a parabola, within the range themselves: it is 0.125 rad higher in the middle."""
    q = np.array([0.0, 1.0, 1.0, 0.0])[:, None] * np.eye(6)[2]
    for most, sign in ((1.13, 1.0), (1.12, 1.0), (1.13, -1.0), (1.12, -1.0)):
        limits = replace(ARM, torque=None, q_min=np.full(6, -most), q_max=np.full(6, most))
        if most > 1.125:
            time_contact_path(sign * q, np.linspace(0.0, 0.09, 4), 0.04, limits)
        else:
            with pytest.raises(Infeasible, match=r"axis 3 is 0\.286 deg outside its range at station 45\.0 mm"):
                time_contact_path(sign * q, np.linspace(0.0, 0.09, 4), 0.04, limits)


def test_paths_that_are_none_are_refused():
    q, s = smooth_pass(20)
    with pytest.raises(BadInput, match="no number"):
        time_contact_path(np.where(np.arange(20)[:, None] == 7, np.nan, q), s, 0.04, ARM)
    with pytest.raises(BadInput, match="waypoint 8 holds a value that is no number"):  # of one axis alone
        time_contact_path(np.where((np.arange(20)[:, None] == 7) & (np.arange(6) == 2), np.nan, q), s, 0.04, ARM)
    with pytest.raises(BadInput, match=r"waypoint 5 to 6 the arc length grows by -24\.73\d+ mm"):
        time_contact_path(q, np.where(np.arange(20) >= 5, s - 0.03, s), 0.04, ARM)
    with pytest.raises(BadInput, match="feed must be above 0"):
        time_contact_path(q, s, 0.0, ARM)
    with pytest.raises(BadInput, match="same posture"):
        time_joint_move(q[0], q[0], ARM)
    jump = np.insert(q, 10, q[9] + 0.1, axis=0)
    with pytest.raises(BadInput, match="waypoint 10 to 11"):
        time_contact_path(jump, np.insert(s, 10, s[9]), 0.04, ARM)


def test_near_duplicate_waypoints_are_dropped():
    q, s = smooth_pass(50)
    doubled = np.insert(q, [0, 20, 49], q[[0, 20, 49]] + 1e-9, axis=0)
    stations = np.insert(s, [0, 20, 49], s[[0, 20, 49]] - [0, 1e-12, 1e-12])
    order = np.argsort(stations, kind="stable")
    trajectory = time_contact_path(doubled[order], stations[order], 0.04, ARM)
    assert len(trajectory.stations) == 50
    assert trajectory.duration == pytest.approx(time_contact_path(q, s, 0.04, ARM).duration, rel=2e-3)


def test_slowing_down_divides_speeds_and_accelerations():
    law = time_law(np.linspace(0, 1, 11), np.array([0, *np.linspace(1, 2, 9), 0]), 0.1)
    slow = stretched(law, 3.0)
    t = np.linspace(0.01, law.x[-1] - 0.01, 50)
    assert np.allclose(slow(3 * t), law(t), atol=1e-12)
    assert np.allclose(3 * slow(3 * t, 1), law(t, 1), atol=1e-12)
    assert np.allclose(9 * slow(3 * t, 2), law(t, 2), atol=1e-9)


def test_the_running_mean_is_the_mean_of_the_law():
    sharp = time_law(np.linspace(0, 1, 11), np.array([0, *np.linspace(1, 2, 9), 0]), 0.0)
    smooth = time_law(np.linspace(0, 1, 11), np.array([0, *np.linspace(1, 2, 9), 0]), 0.1)
    for t in np.linspace(0, smooth.x[-1], 37):
        window = np.linspace(t - 0.1, t, 4001)
        expected = np.trapezoid(sharp(np.clip(window, 0, sharp.x[-1])), window) / 0.1
        assert smooth(t) == pytest.approx(expected, abs=1e-6)
    for law in (smooth, sharp):
        assert np.allclose(law(times_at(law, np.linspace(0, 1, 23))), np.linspace(0, 1, 23), atol=1e-12)


def test_toppra_alone_breaks_limits_and_the_check_mends_it():
    """The reason for the refinement: rows that hold at grid points are exceeded in between."""
    rng = np.random.default_rng(5)
    q = np.cumsum(rng.normal(size=(20, 6)) * 0.1, axis=0)
    s, limits = np.linspace(0, 0.2, 20), replace(ARM, margin=1.0)
    from trajectories import timing

    path = timing._cleaned(q, s, None, limits, "pass")
    nothing = timing._Tightening(s, np.ones(20), np.ones(20))
    rows = timing._rows(path, np.linspace(0, 0.2, 101), nothing)
    raw = timing._trajectory(path, time_law(rows.grid, squared_speeds(rows, 0.05), 0.0))
    assert raw.ratios(sample_times(raw)).max() > 1.03
    mended = time_contact_path(q, s, None, limits, window=0.0)
    assert mended.status is TimingStatus.HELD  # by slowing it down where it needs that, not all along
    assert mended.ratios(np.linspace(0, mended.duration, 20001)).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("binds", ["acceleration", "speed", "torque"])
def test_slow_motion_as_the_last_resort_holds_the_limits(binds, monkeypatch):
    from trajectories import timing

    monkeypatch.setattr(timing, "ROUNDS", 1)
    monkeypatch.setattr(timing, "RESERVE", 1.2)
    q, s = smooth_pass(seed=3, size=0.2)
    free = {"qd": 100.0 * ARM.qd, "qdd": 100.0 * ARM.qdd, "torque": None}
    free.pop({"acceleration": "qdd", "speed": "qd", "torque": "torque"}[binds])
    trajectory = timing.time_contact_path(q, s, 0.5, replace(ARM, margin=0.8, **free))
    assert trajectory.status is TimingStatus.SLOWED
    assert 0.75 < trajectory.limit_ratio(sample_times(trajectory)).max() <= 0.8
    assert getattr(trajectory.worst, {"speed": "velocity"}.get(binds, binds)) > 0.75


def test_a_blade_of_3000_waypoints_is_timed_within_seconds():
    q, s = smooth_pass()
    time_contact_path(q, s, 0.04, ARM)  # toppra's import
    clock = time.process_time()
    for seed in range(15):
        time_contact_path(*smooth_pass(seed=seed), 0.04, ARM)
    assert time.process_time() - clock < 6.0
