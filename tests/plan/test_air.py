"""Moves off contact and the search for a way around, and the order of the passes."""

import itertools
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ocp.plan import motion
from ocp.plan.clearance import Clearance, CollisionScene
from ocp.plan.motion import FAR, build_motion, connect, dense, is_free, lifted, travel
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.rules import COLLISION_STEP, HOME_LIFT, LIMIT_SHARE
from robots.errors import Infeasible
from robots.kinematics import forward
from tests.support import invented_motion
from tests.support.example_pass import bundled_cell

READY = np.radians([3.0, -80.0, 95.0, 10.0, 50.0, 20.0])
BLOCK = np.array(list(itertools.product((-0.02, 0.02), (-0.003, 0.003), (0.0, 0.1))))


@pytest.fixture(scope="module")
def cell():
    return bundled_cell()


@dataclass
class Boxes:
    """A scene of boxes in joint space: distances are exact, and every posture that was asked for is kept."""

    low: np.ndarray
    high: np.ndarray

    def __post_init__(self):
        self.asked = 0

    def clearances(self, q, in_contact):
        assert not in_contact
        self.asked += len(q)
        away = np.maximum(self.low[:, None] - q, q - self.high[:, None]).max(axis=-1)  # (boxes, n), inside negative
        return away.min(axis=0), [("box", "arm")] * len(q)

    def clearance(self, q, in_contact):
        values, names = self.clearances(q, in_contact)
        k = int(np.argmin(values))
        return Clearance(float(values[k]), k, names[k])


def wall(low, high):
    """One box over axes 1 and 2 in degrees, all of the others."""
    free = np.full(4, 400.0)
    return Boxes(np.radians([[*low, *-free]]), np.radians([[*high, *free]]))


# -- straight off the wheel ----------------------------------------------------------------------------------------


@given(st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_a_lift_moves_the_flange_along_the_normal_and_turns_nothing(seed):
    cell = bundled_cell()
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal(3)
    normal /= np.linalg.norm(normal)
    distances = np.sort(rng.uniform(0.0, 0.1, 4))
    q = READY + rng.uniform(-0.1, 0.1, 6)
    T0 = forward(cell.robot, q[None])[0]
    T = forward(cell.robot, lifted(cell, q, normal, distances))
    np.testing.assert_allclose(T[:, :3, 3], T0[:3, 3] + distances[:, None] * normal, atol=1e-8)
    np.testing.assert_allclose(T[:, :3, :3], np.tile(T0[:3, :3], (4, 1, 1)), atol=1e-8)


def test_a_lift_stays_on_its_branch_and_changes_little(cell):
    q = lifted(cell, READY, np.array([-1.0, 0.0, 0.0]), np.linspace(0.0, 0.35, 36))
    np.testing.assert_allclose(q[0], READY, atol=1e-12)
    assert np.abs(np.diff(q, axis=0)).max() < np.radians(3.0)


def test_a_lift_out_of_reach_is_refused(cell):
    with pytest.raises(Infeasible, match=r"\d+ mm off the wheel"):
        lifted(cell, READY, np.array([1.0, 0.0, 0.0]), np.array([3.0]))


def test_a_lift_beyond_an_axis_limit_names_the_axis(cell):
    robot, away = cell.robot, np.array([-1.0, 0.0, 0.0])
    moved = np.degrees(lifted(cell, READY, away, np.array([0.3]))[0] - READY)
    for axis, name in ((2, "q_max"), (1, "q_min")):
        end = READY[axis] + np.sign(moved[axis]) * 1e-3
        tight = replace(robot, **{name: np.where(np.arange(6) == axis, end, getattr(robot, name))})
        beyond = abs(moved[axis]) - np.degrees(1e-3)
        with pytest.raises(Infeasible, match=rf"axis {axis + 1} {beyond:.1f} deg beyond its limit"):
            lifted(replace(cell, robot=tight), READY, away, np.array([0.3]))


# -- from pass to pass ---------------------------------------------------------------------------------------------


def test_a_dense_polyline_keeps_its_corners_and_its_step():
    points = np.radians([[0, 0, 0, 0, 0, 0], [10, -3, 0, 0, 0, 0.5], [10, -3, 0, 0, 0, 0.5], [10, -1.1, 0, 0, 0, 0.0]])
    fine = dense(points)
    assert np.abs(np.diff(fine, axis=0)).max() <= COLLISION_STEP * (1 + 1e-9)
    assert all(np.abs(fine - p).max(axis=1).min() < 1e-12 for p in points)
    np.testing.assert_allclose(fine[[0, -1]], points[[0, -1]], atol=1e-15)


def test_a_free_straight_move_is_taken_as_it_is(cell):
    scene = wall([100, 0], [110, 10])
    goal = READY + np.radians([5, 2, 0, 0, 0, 0])
    way = travel(cell, scene, (READY, np.array([-1.0, 0, 0])), (goal, np.array([-1.0, 0, 0])))
    np.testing.assert_array_equal(way, [READY, goal])


def test_a_wall_on_the_straight_move_is_passed_farther_out(cell):
    """Two places before the wheel, something between them; 10 to 35 cm off the wheel there is room."""
    normal, beside = np.array([-1.0, 0.0, 0.0]), np.array([-0.95, -np.sqrt(1 - 0.95**2), 0.0])
    goal = READY + np.radians([16, 0, 0, 0, 0, 0])
    out = [lifted(cell, q, n, np.array([FAR[0]]))[0] for q, n in ((READY, normal), (goal, beside))]
    middle = np.degrees(0.5 * (READY + goal))
    scene = wall([middle[0] - 2, middle[1] - 1.5], [middle[0] + 2, middle[1] + 1.5])
    assert abs(np.degrees(out[0][1]) - middle[1]) > 2.0, "the lift does not leave the wall; the test tells nothing"
    assert not is_free(scene, np.array([READY, goal]))
    way = travel(cell, scene, (READY, normal), (goal, beside))
    np.testing.assert_allclose(way, [READY, *out, goal], atol=1e-12)
    assert is_free(scene, way)


def test_a_way_is_searched_where_no_retreat_helps(cell):
    goal = READY + np.radians([24, 0, 0, 0, 0, 0])
    middle = np.degrees(0.5 * (READY + goal))
    scene = wall([middle[0] - 3, -140], [middle[0] + 3, middle[1] + 25])  # closed below: only over the top
    normal = np.array([-1.0, 0.0, 0.0])
    way = travel(cell, scene, (READY, normal), (goal, normal))
    np.testing.assert_array_equal(way[[0, -1]], [READY, goal])
    assert len(way) > 2 and is_free(scene, way)
    assert (way >= cell.robot.q_min).all() and (way <= cell.robot.q_max).all()


def test_no_way_is_told_with_what_is_in_it(cell):
    scene = wall([-400, -400], [400, 400])
    with pytest.raises(Infeasible, match="box and arm overlap by .* mm"):
        travel(cell, scene, (READY, np.array([-1.0, 0, 0])), (READY + 0.1, np.array([-1.0, 0, 0])))


def test_real_shapes_are_kept_clear_too(cell):
    """From one side of the wheel to the other with the real scene: every degree of the way keeps the margins."""
    scene = CollisionScene(cell, BLOCK)
    q = np.radians([[-25.0, -75.0, 95.0, 0.0, 50.0, 0.0], [25.0, -75.0, 95.0, 0.0, 50.0, 0.0]])
    normal = np.array([-1.0, 0.0, 0.0])
    if not (is_free(scene, q[:1]) and is_free(scene, q[1:])):
        pytest.fail("the ends are not free; choose others")
    way = travel(cell, scene, (q[0], normal), (q[1], normal))
    assert scene.clearance(dense(way, 0.3 * COLLISION_STEP), in_contact=False).value > -1e-3


def test_the_search_is_free_short_and_always_the_same():
    low, high = np.radians(np.full(6, -180.0)), np.radians(np.full(6, 180.0))
    start, goal = np.zeros(6), np.radians([60.0, 0, 0, 0, 0, 0])
    scene = wall([25, -170], [35, 20])
    one, two = (connect(scene, low, high, start, goal) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(one[[0, -1]], [start, goal])
    assert is_free(scene, one) and len(one) < 15
    other = connect(scene, low, high, start, goal, seed=1)
    assert other is not None and (other.shape != one.shape or np.abs(other - one).max() > 1e-6)


def test_the_search_gives_up_where_the_wall_has_no_gap(monkeypatch):
    monkeypatch.setattr("ocp.plan.motion.ATTEMPTS", 300)
    low, high = np.radians(np.full(6, -180.0)), np.radians(np.full(6, 180.0))
    scene = wall([25, -400], [35, 400])
    assert connect(scene, low, high, np.zeros(6), np.radians([60.0, 0, 0, 0, 0, 0])) is None


def test_the_search_stays_within_the_ranges_of_the_axes(monkeypatch):
    """The wall ends at 20 deg of axis 2: an axis that reaches 60 gets round it, one that reaches 19 does not."""
    monkeypatch.setattr("ocp.plan.motion.ATTEMPTS", 300)
    scene, goal = wall([25, -400], [35, 20]), np.radians([60.0, 0, 0, 0, 0, 0])
    for most in (60.0, 19.0):
        low, high = np.radians(np.full(6, -60.0)), np.radians([90.0, most, 60.0, 60.0, 60.0, 60.0])
        way = connect(scene, low, high, np.zeros(6), goal)
        assert (way is None) == (most < 20.0)
        assert way is None or ((way >= low).all() and (way <= high).all())


# -- the whole of it -----------------------------------------------------------------------------------------------


def invented_passes():
    """Two passes, each with its own place on the wheel at either end."""
    found = []
    for k, one in enumerate(invented_motion.motion().passes):
        arc = np.linspace(0.1, 0.2, len(one.solution.q)) + 0.2 * k
        found.append(replace(one, evaluation=SimpleNamespace(**vars(one.evaluation), arc=arc)))
    return found


def test_a_motion_goes_from_home_by_every_pass_and_back_within_its_share_of_the_limits(cell, monkeypatch):
    ends = []

    def straight(cell, scene, start, goal):
        ends.extend([start, goal])
        return np.array([start[0], goal[0]])

    monkeypatch.setattr(motion, "travel", straight)
    made = build_motion(cell, wall([100, 0], [110, 10]), invented_passes())
    segments = made.segments
    assert [(s.kind, s.place) for s in segments] == [("travel", 0), ("pass", 0), ("travel", 1), ("pass", 1), ("travel", 2)]
    for a, b in itertools.pairwise(segments):
        assert b.start == pytest.approx(a.end)
        np.testing.assert_allclose(a.trajectory.q(a.trajectory.duration), b.trajectory.q(0.0), atol=1e-9)
    home, first = segments[0].trajectory.q(0.0), segments[1].trajectory.q(0.0)
    np.testing.assert_allclose(segments[-1].trajectory.q(segments[-1].trajectory.duration), home, atol=1e-9)
    off = (forward(cell.robot, home[None]) - forward(cell.robot, first[None]))[0, :3, 3]
    arcs = [one.evaluation.arc for one in made.passes]
    np.testing.assert_allclose(off, HOME_LIFT * cell.wheel.outward(arcs[0][0]), atol=1e-8)
    outward = [arcs[0][0], arcs[0][0], arcs[0][-1], arcs[1][0], arcs[1][-1], arcs[0][0]]  # of home: of the first contact
    np.testing.assert_allclose([normal for _, normal in ends], [cell.wheel.outward(arc) for arc in outward], atol=1e-12)
    for s in segments:
        assert s.trajectory.limits.margin == LIMIT_SHARE and 0 < s.trajectory.worst.torque <= LIMIT_SHARE
        assert max(s.trajectory.worst.velocity, s.trajectory.worst.acceleration) <= LIMIT_SHARE


@pytest.mark.parametrize(
    ("blocked", "stands_free", "lost"), [(0, True, 0), (0, False, 0), (1, True, 1), (1, False, 0), (2, True, 1), (2, False, 1)]
)
def test_the_pass_is_left_out_that_the_arm_cannot_come_to_or_leave(cell, monkeypatch, blocked, stands_free, lost):
    """Where it stands amid something after a pass it is that pass, else the one ahead; on the way home the last."""
    ways = itertools.count()

    def stuck(cell, scene, start, goal):
        if next(ways) == blocked:
            raise Infeasible("no free way through the air: box and arm overlap; move the wheel")
        return np.array([start[0], goal[0]])

    monkeypatch.setattr(motion, "travel", stuck)
    monkeypatch.setattr(motion, "is_free", lambda scene, points: stands_free)
    passes = invented_passes()
    order = motion._order(cell, [(p.solution.q[0], p.solution.q[-1]) for p in passes])
    path = passes[order[lost]].problem.path
    with pytest.raises(CannotGrind, match="no free way through the air: box and arm overlap") as refused:
        build_motion(cell, wall([100, 0], [110, 10]), passes)
    assert refused.value.line == path.line and len(refused.value.at) == len(path.s)


# -- order of the passes -------------------------------------------------------------------------------------------


def seconds(cell, ends, order):
    return sum((np.abs(ends[a][1] - ends[b][0]) / cell.robot.qd_max).max() for a, b in itertools.pairwise(order))


@given(st.integers(1, 7), st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_the_order_is_a_permutation_never_longer_than_the_given_and_near_the_best(n, seed):
    cell = bundled_cell()
    rng = np.random.default_rng(seed)
    ends = [tuple(rng.uniform(-1.0, 1.0, (2, 6))) for _ in range(n)]
    order = motion._order(cell, ends)
    assert sorted(order) == list(range(n))
    found = seconds(cell, ends, order)
    assert found <= seconds(cell, ends, range(n)) + 1e-9
    if n <= 6:
        best = min(seconds(cell, ends, p) for p in itertools.permutations(range(n)))
        assert found <= 1.5 * best + 1e-9
    for i, j in itertools.product(range(n), repeat=2):  # no single pass is better off elsewhere
        moved = [*order[:i], *order[i + 1 :]]
        moved.insert(j, order[i])
        assert found <= seconds(cell, ends, moved) + 1e-6
