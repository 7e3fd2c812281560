"""The way through the air by the independent route: how far the wheel is off, and what touches before its ramp begins."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.model.cell import ForceFlange
from ocp.plan import readback
from ocp.plan.passes.course import Engagement, air_to_air, path_at
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.readback import _touching_in_air
from ocp.plan.second_route import BelievedRobot, bent, gaps
from robots.gravity import GRAVITY
from robots.pose import apply, invert
from robots.reference_kinematics import elementary_forward
from tests.plan.test_effects_plan import cell_with
from tests.support import invented_motion
from tests.support.example_pass import bar_pass, bundled_cell
from tests.support.invented_motion import SEED

Q = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0])
OFF = 0.0123  # m
GIVE = np.array([2e-6, 0.0, 0.0])
SOFT = np.array([2e-6] * 6)


def arm(cell) -> BelievedRobot:
    return BelievedRobot(cell.robot, SOFT, 25.0, np.array([0.01, 0.0, 0.16]))


def facing(cell, leant: float = 0.0):
    """A line of which the first point is OFF beyond the wheel's surface at joints Q; its normal is turned about the wheel's axis
    by `leant` rad off the radius."""
    T = elementary_forward(cell.robot, bent(cell, arm(cell), Q[None]))[0] @ cell.workpiece.T_flange_blade
    e, axis = cell.wheel.outward(0.2), cell.wheel.axis
    there = cell.wheel.centre + (cell.wheel.radius + OFF) * e + 0.002 * axis
    back, line = invert(T), bar_pass()
    n = -np.cos(leant) * e + np.sin(leant) * np.cross(axis, e)
    p = apply(back[None], there[None])[0]
    n, t = (np.tile(back[:3, :3] @ v, (40, 1)) for v in (n, axis))
    return replace(line, p=p + line.s[:, None] * t, n=n, t=t)


def off(cell, line=None, q=Q, **conditions) -> np.ndarray:
    seen = {name: np.full((len(np.atleast_2d(q)), 1), value) for name, value in conditions.items()}
    return gaps(cell, arm(cell), line or facing(cell), 0, GIVE, np.atleast_2d(q), seen)


def test_a_rigid_mount_is_as_far_off_as_geometry_says():
    cell = replace(bundled_cell(), flange=None)
    assert off(cell) == pytest.approx([OFF], abs=1e-9)
    moved = replace(cell, wheel=replace(cell.wheel, centre=cell.wheel.centre - 0.001 * cell.wheel.outward(0.2)))
    assert off(moved, facing(cell)) == pytest.approx([OFF + 0.001], abs=1e-9)
    lateral = replace(cell, wheel=replace(cell.wheel, centre=cell.wheel.centre + 0.003 * cell.wheel.axis))
    assert off(lateral, facing(cell)) == pytest.approx([OFF], abs=1e-9)
    smaller = replace(cell, wheel=replace(cell.wheel, radius=cell.wheel.radius - 5e-4))
    assert off(smaller, facing(cell)) == pytest.approx([OFF + 5e-4], abs=1e-9)


def test_the_sag_of_the_arm_counts():
    cell = replace(bundled_cell(), flange=None)
    stiff = replace(arm(cell), compliance=np.zeros(6))
    line = facing(cell)
    unbent = gaps(cell, stiff, line, 0, GIVE, Q[None], {})
    T = elementary_forward(cell.robot, Q[None])[0] @ cell.workpiece.T_flange_blade
    v = apply(T[None], line.p[:1])[0] - cell.wheel.centre
    assert unbent == pytest.approx([np.linalg.norm(v - (v @ cell.wheel.axis) * cell.wheel.axis) - cell.wheel.radius], abs=1e-9)
    assert abs(unbent[0] - OFF) > 1e-4


@pytest.mark.parametrize(("setpoint", "stroke", "out"), [(20.0, 8e-3, 20 / 5600), (60.0, 8e-3, 4e-3), (3.0, 0.2e-3, 1e-4)])
def test_a_free_flange_stands_out_by_its_preload_up_to_its_stop(setpoint, stroke, out):
    cell = replace(bundled_cell(), flange=ForceFlange(setpoint, 5600.0, stroke, 5.0, True, None))
    assert off(cell) == pytest.approx([OFF - out], abs=1e-9)


@pytest.mark.parametrize("compensated", [True, False])
def test_a_flange_with_an_axis_stands_out_along_it(compensated):
    """Against the normal only by its share; the weight of what it carries pushes or holds it where nothing balances it."""
    cell = bundled_cell()
    line = facing(cell, 0.3)
    T = elementary_forward(cell.robot, bent(cell, arm(cell), Q[None]))[0]
    normal = T[:3, :3] @ cell.workpiece.T_flange_blade[:3, :3] @ line.n[0]
    along = normal + np.array([0.1, 0.2, 0.15])
    along /= np.linalg.norm(along)
    for sign in (1.0, -1.0):  # which way the axis is written does not count
        flange = ForceFlange(10.0, 5600.0, 20e-3, 2.0, compensated, sign * T[:3, :3].T @ along)
        weight = 0.0 if compensated else -2.0 * GRAVITY * along[2]
        out = (10.0 + weight) / 5600.0 * float(along @ normal)
        assert off(replace(cell, flange=flange), line) == pytest.approx([OFF - out], abs=1e-9)


def test_a_worn_wheel_is_farther_off_by_what_it_lost():
    table = {"effect": "wheel_wear", "m_per_s": 1e-7}
    for flange in (None, bundled_cell().flange):
        plain = replace(bundled_cell(), flange=flange)
        worn = replace(cell_with(table), flange=flange)
        line = facing(plain)
        named = PassProblem.start(line, SEED, np.tile(GIVE, (40, 1))).named_conditions(worn)
        seen = {name: value[:1] for name, value in named.items()}
        before = off(plain, line)
        for clock in (0.0, 600.0, 3600.0):
            seen["clock"] = np.full_like(seen["clock"], clock)
            now = gaps(worn, arm(worn), line, 0, GIVE, Q[None], seen)
            assert now - before == pytest.approx([1e-7 * clock], abs=1e-9)


# -- touching in the air -------------------------------------------------------------------------------------------


def on_the_way(cell, ahead: float):
    """A pass whose joints, at every millisecond, keep the blade `ahead` m nearer to the wheel than is planned in the air; with
    its times, joints and nominal times."""
    line = facing(cell)
    course = air_to_air(line, Engagement(0.3, 4e-3, 0.02, 0.76, 4900.0, 20.0), 0.02)
    path = replace(path_at(line, course.s), p=np.tile(line.p[0], (len(course.s), 1)))
    t = np.arange(0.0, course.at[-1], 1e-3)
    wanted = np.maximum(course.gap_at(t) - ahead, -1e-3)
    grid = np.linspace(-1.1e-3, 0.021, 60)
    q = np.empty((60, 6))
    here = Q.copy()
    for k, gap in enumerate(grid[::-1]):  # along the normal, from far to near
        for _ in range(8):
            now = gaps(cell, arm(cell), path, 0, GIVE, here + 1e-5 * np.vstack([np.zeros(6), np.eye(6)]), {})
            slope = (now[1:] - now[0]) / 1e-5
            here = here + slope * (gap - now[0]) / (slope @ slope)
        q[59 - k] = here
    joints = np.column_stack([np.interp(wanted, grid, column) for column in q.T])
    problem = replace(PassProblem.start(path, SEED, np.tile(GIVE, (len(path.s), 1))), course=course)
    return SimpleNamespace(problem=problem), t, joints, t


@pytest.fixture(scope="module")
def rigid():
    return replace(bundled_cell(), flange=None)


def test_the_planned_way_touches_where_it_should(rigid):
    assert _touching_in_air(rigid, arm(rigid), *on_the_way(rigid, -2e-6)) == 0.0


def test_seconds_of_an_early_touch_are_counted_at_both_ends(rigid):
    """40 um too near at 4 mm/s: 20 um deep 5 ms before touch and 5 ms after lift, less than a gap of GAP_TOLERANCE."""
    one, *rows = on_the_way(rigid, 40e-6)
    assert one.problem.way.entry.closing == pytest.approx(4e-3)
    seconds = _touching_in_air(rigid, arm(rigid), one, *rows)
    assert seconds == pytest.approx(0.010, abs=2.1e-3)


def test_a_blade_that_touches_early_is_refused_with_its_depth(rigid):
    one, *rows = on_the_way(rigid, 0.6e-3)
    with pytest.raises(
        CannotGrind, match=r"line 1 \(convex\).*would touch in the air, 0\.5[45] mm deep, by the independent route"
    ):
        _touching_in_air(rigid, arm(rigid), one, *rows)
    apart = replace(rigid, wheel=replace(rigid.wheel, radius=rigid.wheel.radius - 0.7e-3))
    assert _touching_in_air(apart, arm(apart), one, *rows) == 0.0


def test_on_the_way_in_the_first_point_is_looked_at_and_on_the_way_out_the_last(rigid, monkeypatch):
    one = invented_motion.motion().passes[0]
    n, edges = len(one.problem.path.s), one.problem.way.edges
    problem, seen = replace(one.problem, compliance=np.arange(n)[:, None] * np.ones(3)), []

    def far(cell, believed, path, at, give, q, conditions):
        seen.append((range(n)[at], give[0], q[:, 0].tolist()))
        return np.full(len(q), 1.0)

    monkeypatch.setattr(readback, "gaps", far)
    nominal = np.array([0.5 * edges[1], edges[1] + 1e-3, edges[4] - 1e-3, 0.5 * (edges[4] + edges[-1])])
    q = np.arange(4.0)[:, None] * np.ones(6)
    assert _touching_in_air(rigid, arm(rigid), SimpleNamespace(problem=problem), nominal, q, nominal) == 0.0
    assert seen == [(0, 0.0, [0.0]), (n - 1, n - 1.0, [3.0])]


def test_a_motion_without_a_way_through_the_air_has_nothing_to_touch(rigid):
    one, t, q, nominal = on_the_way(rigid, 5e-3)
    way = one.problem.way
    inside = (nominal >= way.edges[1]) & (nominal <= way.edges[4])
    assert _touching_in_air(rigid, arm(rigid), one, t[inside], q[inside], nominal[inside]) == 0.0
