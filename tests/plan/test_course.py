"""One way from air to air: rises, touch without a jump, arc length, force over feed, gap and phases; lines made longer and their
room; what a tilt does to a patch; the speed at touch on the real kinematics."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from ocp.contact.wheel.cover import WheelGeometry, build_cover
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.plan.passes.coarse import SPACING, coarse_grid, prolonged, restricted
from ocp.plan.passes.course import LEAST_PEAK, Engagement, air_to_air, entry_of, lengthened, path_at, rise, steady
from ocp.plan.passes.optimise import LEAST_DIRECT
from ocp.plan.passes.problem import PassProblem, air_to_air_problem, lead_room
from ocp.plan.passes.smoothness import node_times
from ocp.plan.passes.solve import PassSolution
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.removal.footprint import CELL, LinePatches, line_patches
from ocp.plan.rules import APPROACH_SPEED, CARRIED_FORCE, CREEP, LEAST_RAMP, LIFT_OFF, TOUCH_SPEED
from robots.errors import Infeasible
from tests.plan.test_footprint import A, B, ellipsoid
from tests.support.example_pass import bar_pass, bundled_cell
from tests.support.invented_motion import SEED

STEP = 0.02  # s between nodes of the pass
SLOPES = st.floats(0.0, 1.0)


def entries() -> st.SearchStrategy[Engagement]:
    """Engagements on chains from very soft to very stiff."""
    ramp, stiffness, force = st.floats(0.2, 0.6), st.floats(2e3, 2e5), st.floats(5.0, 60.0)
    return st.builds(Engagement, ramp, st.just(TOUCH_SPEED), st.just(LIFT_OFF), st.just(0.88), stiffness, force)


# -- rise and entry ------------------------------------------------------------------------------------------------


@given(SLOPES)
def test_a_rise_ends_level_and_its_derivatives_and_integral_belong_together(slope):
    ends = np.array([0.0, 1.0])
    assert rise(ends, slope) == pytest.approx([0.0, 1.0], abs=1e-12)
    assert rise(ends, slope, 1) == pytest.approx([slope, 0.0], abs=1e-11)
    assert rise(ends, slope, 2) == pytest.approx([0.0, 0.0], abs=1e-10)
    x, h = np.linspace(0.01, 0.99, 50), 1e-5
    for order in (-1, 0, 1):
        change = (rise(x + h, slope, order) - rise(x - h, slope, order)) / (2 * h)
        assert change == pytest.approx(rise(x, slope, order + 1), abs=1e-7)
    assert rise(np.array(0.7), slope, -1) == pytest.approx(quad(lambda v: float(rise(np.array(v), slope)), 0.0, 0.7)[0], abs=1e-9)
    fine = np.linspace(0.0, 1.0, 400)
    assert (np.diff(rise(fine, slope)) >= 0.0).all() and rise(fine, slope).max() <= 1.0 + 1e-12  # nothing overshoots
    assert rise(np.array([-3.0, 7.0]), slope) == pytest.approx([0.0, 1.0], abs=1e-12)


@given(entries())
def test_the_blade_closes_into_the_wheel_as_fast_as_it_came(entry):
    """Before touch the gap falls, after it the chain gives way under the rising force: the same speed, never above the rule's."""
    h = 1e-6 * entry.ramp
    after = entry.force * float(rise(np.array(h / entry.ramp), entry.slope)) / entry.stiffness / h
    assert entry.closing == pytest.approx(after, rel=1e-6)
    assert entry.closing <= TOUCH_SPEED * (1 + 1e-12) and entry.slope <= 1.0
    if entry.slope < 1.0:
        assert entry.closing == pytest.approx(TOUCH_SPEED)


@pytest.mark.parametrize("mass", [0.0, 5.0, 40.0])
@pytest.mark.parametrize("stiffness", [1500.0, 4900.0, 6e4])
def test_moving_what_the_flange_carries_takes_little_force(mass, stiffness):
    cell, force = bundled_cell(), 20.0
    entry = entry_of(replace(cell, flange=replace(cell.flange, carried_mass=mass)), force, stiffness)
    t = np.linspace(0.0, entry.ramp, 4001)

    def inertia(slope: float) -> float:
        stroke = force / stiffness * rise(t / entry.ramp, slope)
        return mass * np.abs(np.diff(stroke, 2)).max() / (t[1] - t[0]) ** 2

    assert inertia(entry.slope) <= CARRIED_FORCE * (1 + 1e-3)
    assert entry.ramp >= LEAST_RAMP
    if entry.ramp > LEAST_RAMP:
        assert inertia(0.0) == pytest.approx(CARRIED_FORCE, rel=1e-3)  # no longer than it has to be
    if mass == 0.0:
        assert entry.ramp == LEAST_RAMP


def test_heavier_is_slower_and_a_rigid_mount_carries_nothing():
    cell = bundled_cell()
    ramps = [entry_of(replace(cell, flange=replace(cell.flange, carried_mass=m)), 20.0, 4900.0).ramp for m in (0, 5, 10, 20)]
    assert ramps[0] == LEAST_RAMP and (np.diff(ramps) > 0).all() and ramps[3] == pytest.approx(2 * ramps[1])
    assert entry_of(replace(cell, flange=None), 20.0, 6e4).ramp == LEAST_RAMP


# -- the course ----------------------------------------------------------------------------------------------------


def uneven_feed(length: float):
    """A line whose feed varies smoothly by a quarter."""
    path = bar_pass(n=241, length=length)
    return replace(path, feed=path.feed * (1 + 0.25 * np.sin(2 * np.pi * path.s / length)))


@settings(max_examples=25, deadline=None)
@given(entries(), st.floats(0.018, 0.2), st.booleans())
def test_force_and_feed_rise_from_a_point_that_stands_still(entry, length, even):
    path = bar_pass(n=241, length=length) if even else uneven_feed(length)
    course = air_to_air(path, entry, STEP)
    touch, lift = course.edges[1], course.edges[4]
    assert course.at[[0, -1]] == pytest.approx(course.edges[[0, -1]]) and (np.diff(course.at) > 0).all()
    assert course.arc_at(np.array([touch, lift])) == pytest.approx([0.0, length], abs=1e-9)
    assert (np.diff(course.s) >= -1e-15).all()
    air = (course.at <= touch + 1e-12) | (course.at >= lift - 1e-12)
    assert (course.speed[air] == 0).all() and (course.share[air] == 0).all() and np.ptp(course.s[course.at <= touch]) == 0
    # d s / dt over the feed is the share, from the nodes' arc lengths as between them.
    t, h = np.linspace(touch + 1e-3, lift - 1e-3, 400), 1e-5
    feed = np.interp(course.arc_at(t), path.s, path.feed)
    assert (course.arc_at(t + h) - course.arc_at(t - h)) / (2 * h) / feed == pytest.approx(course.share_at(t), abs=4e-3)
    crude = np.diff(course.s) / np.diff(course.at)
    on = course.share[1:] + course.share[:-1] > 0
    middle = 0.5 * (course.at[1:] + course.at[:-1])[on]
    slope = course.share_at(middle) * np.interp(course.arc_at(middle), path.s, path.feed)
    assert crude[on] == pytest.approx(slope, abs=0.02 * path.feed.max())
    # Force over feed is that of the line, all the way.
    press = course.touching
    force = course.share[press] * path.force[0]
    assert force / course.speed[press] == pytest.approx(path.force[0] / np.interp(course.s[press], path.s, path.feed))
    assert course.share.max() == pytest.approx(course.peak) and 0.25 <= course.peak <= 1.0


@settings(max_examples=25, deadline=None)
@given(entries(), st.floats(0.012, 0.1))
def test_the_gap_closes_slowly_and_without_a_jump(entry, length):
    """Also where a short line is pressed less: the force rises more slowly there, so the blade has to come more slowly."""
    try:
        course = air_to_air(bar_pass(n=61, length=length), entry, STEP)
    except Infeasible:
        return
    touch, lift, h = course.edges[1], course.edges[4], 1e-6
    for edge, outward in ((touch, -1.0), (lift, 1.0)):
        near = course.gap_at(np.array([edge, edge + outward * h, edge - outward * h]))
        assert near[0] == pytest.approx(0.0, abs=1e-12) and near[2] == 0.0
        into = course.share_at(np.array([edge - outward * h]))[0] * entry.force / entry.stiffness / h
        assert near[1] / h == pytest.approx(into, rel=1e-4)
        assert near[1] / h <= TOUCH_SPEED * (1 + 1e-4)
    assert course.gap_at(course.edges[[0, -1]]) == pytest.approx([LIFT_OFF, LIFT_OFF])
    t = np.linspace(course.at[0], course.at[-1], 20001)
    gap = course.gap_at(t)
    speed = np.gradient(gap, t)
    assert np.abs(speed).max() < APPROACH_SPEED and np.abs(speed[[0, -1]]).max() < 1e-4  # begins and ends at rest
    assert np.abs(np.diff(speed)).max() < 1.1 * max(TOUCH_SPEED, 2e-4)  # the one step is touch itself
    early = (t > touch - CREEP) & (t < lift + CREEP)  # a blade that is met early is met as slowly
    assert np.abs(speed[early]).max() < 1.001 * TOUCH_SPEED
    assert (gap[(t > touch) & (t < lift)] == 0).all()
    assert course.gap == pytest.approx(course.gap_at(course.at))


def test_phases_follow_one_another_at_the_edges():
    course = air_to_air(bar_pass(), Engagement(0.3, 0.004, 0.02, 0.76, 4900.0, 20.0), STEP)
    assert course.phase_at(0.5 * (course.edges[1:] + course.edges[:-1])).tolist() == [0, 1, 2, 3, 4]
    assert course.phase_at(course.edges[1:5]).tolist() == [1, 2, 3, 4]
    full = course.share_at(course.at) >= 1.0 - 1e-9
    assert (full == (course.grinding > 0)).all()
    phase = course.phase_at(course.at + 1e-9)
    assert set(phase[course.grinding > 0]) == {2, 3} and course.at[course.grinding > 0][-1] == pytest.approx(course.edges[3])


def test_short_lines_are_pressed_less_and_still_shorter_ones_are_refused():
    entry, feed = Engagement(0.3, 0.004, 0.02, 0.76, 4900.0, 20.0), 0.04
    ways = np.array([0.06, 0.03, 0.014, 0.01, 0.006, 0.003])
    courses = [air_to_air(bar_pass(length=length), entry, STEP) for length in ways[:5]]
    peaks = np.array([course.peak for course in courses])
    assert peaks[:2].tolist() == [1.0, 1.0] and (np.diff(peaks[2:]) < 0).all() and peaks[4] < 1.0
    assert peaks[3:5] / peaks[3] == pytest.approx(ways[3:5] / ways[3])  # both ramps are one share of the way
    for course, length in zip(courses, ways, strict=False):
        assert course.share.max() == pytest.approx(course.peak)
        assert np.trapezoid(course.speed, course.at) == pytest.approx(length, rel=2e-3)
    assert courses[0].edges[-1] == pytest.approx(
        2 * (0.76 + 0.3) + (0.06 - 2 * feed * 0.3 * rise(np.array(1.0), entry.slope, -1)) / feed
    )
    # What is driven fast needs more of a line, and so does what is seen coarsely; what would do is told, and does.
    slow, coarse = "lower the feed there to ", "use a --step of at most "
    for length, feed, step, ways in (
        (0.003, 0.04, 0.5 * STEP, [slow]),
        (0.01, 0.15, STEP, [slow]),
        (0.01, 0.04, 4 * STEP, [coarse]),
        (0.003, 0.04, 4 * STEP, [slow, coarse]),
        (0.003, 0.04, 1.6 * STEP, [slow, coarse]),  # the step would do at this feed, and not at a slower one
    ):
        path = bar_pass(length=length, feed=feed)
        with pytest.raises(CannotGrind) as error:
            air_to_air(path, entry, step)
        words = (
            f"line 1 (convex): {1e3 * length:.1f} mm are too short to engage and to lift off at {1e3 * feed:g} mm/s; {ways[0]}"
        )
        assert str(error.value).startswith(words)
        assert error.value.nodes(path.s).all()  # no piece of it is longer
        told, would_do = {way: way in error.value.would_do for way in (slow, coarse)}, error.value.would_do
        assert told == {way: way in ways for way in (slow, coarse)}
        eased = 1e-3 * float(would_do.split(slow)[1].split()[0]) if told[slow] else feed
        nearer = 1e-3 * float(would_do.split(coarse)[1].split()[0]) if told[coarse] else step * feed
        assert air_to_air(bar_pass(length=length, feed=eased), entry, nearer / eased).peak > LEAST_PEAK
    uneven = replace(bar_pass(length=0.01), feed=np.linspace(0.02, 0.08, 40))
    with pytest.raises(CannotGrind) as error:  # where it is driven faster a piece of it would do
        air_to_air(uneven, entry, 5 * STEP)
    assert not error.value.nodes(uneven.s).any()


def test_every_pass_that_is_accepted_has_contacts_that_are_solved_directly():
    """Force over LEAST_DIRECT of the programmed one somewhere, however short the line is."""
    entry = Engagement(0.3, 0.004, 0.02, 0.76, 4900.0, 20.0)
    for length in np.geomspace(0.001, 0.1, 60):
        try:
            course = air_to_air(bar_pass(length=float(length), feed=0.12), entry, 0.005)
        except Infeasible:
            assert length < 0.015
            continue
        assert len(np.unique(course.s[course.share >= 1.2 * LEAST_DIRECT])) >= 5


def test_a_pass_alone_bears_all_along():
    path = uneven_feed(0.06)
    course = steady(path)
    assert course.touching == slice(0, 241) and (course.share_at(course.at) == 1).all() and (course.gap_at(course.at) == 0).all()
    assert course.arc_at(course.at) == pytest.approx(path.s) and (course.phase_at(course.at[1:-1]) == 2).all()


# -- lines made longer ---------------------------------------------------------------------------------------------


def on_a_ring(radius: float, n: int = 61, length: float = 0.06):
    """A line along the outside of a ring about y."""
    path, turn = bar_pass(n=n, length=length), np.linspace(0.0, length, n) / radius
    n_, t_ = (np.column_stack([a, 0 * turn, b]) for a, b in ((np.sin(turn), np.cos(turn)), (np.cos(turn), -np.sin(turn))))
    return replace(path, p=radius * n_, n=n_, t=t_)


def test_a_line_goes_on_as_the_surface_does():
    flat = bar_pass(n=61)
    longer = lengthened(flat, 0.0045, 0.0032)
    assert longer.s[[0, -1]] == pytest.approx([-0.004, 0.063]) and np.diff(longer.s) == pytest.approx(np.full(67, 1e-3))
    assert longer.p == pytest.approx(np.column_stack([0 * longer.s, 0.04 + 0 * longer.s, 0.03 + longer.s]))
    assert longer.n == pytest.approx(np.tile([0.0, 1.0, 0.0], (68, 1))) and longer.t == pytest.approx(
        np.tile([0, 0, 1.0], (68, 1))
    )
    inner = slice(4, 65)
    for name in ("p", "n", "t", "curvature", "extent", "feed", "force"):
        assert (getattr(longer, name)[inner] == getattr(flat, name)).all()
    short = lengthened(flat, 0.0, 0.0)
    assert short.s == pytest.approx(flat.s) and short.p == pytest.approx(flat.p)
    ring = lengthened(on_a_ring(0.08), 0.0041, 0.0041)
    turn = ring.s / 0.08
    there = np.column_stack([np.sin(turn), 0 * turn, np.cos(turn)])
    assert np.abs(ring.p - 0.08 * there).max() < 5e-7 and np.abs(ring.n - there).max() < 2e-5
    assert np.abs(np.sum(ring.n * ring.t, axis=1)).max() < 3e-5
    assert np.linalg.norm(ring.n, axis=1) == pytest.approx(np.ones(len(ring.s)))


@given(st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9))
def test_a_cubic_goes_on_exactly(c):
    """To rounding: what a cubic does inside the last stretch it does beyond it."""
    path = bar_pass(n=61)
    coefficients = np.array(c).reshape(3, 3)

    def place(s):
        return np.polynomial.polynomial.polyval(s / 0.06, np.vstack([path.p[0], 0.01 * coefficients.T])).T

    longer = lengthened(replace(path, p=place(path.s)), 0.0041, 0.0041)
    assert longer.p == pytest.approx(place(longer.s), abs=1e-10)


def test_a_line_at_other_places_is_the_same_line():
    ring = on_a_ring(0.08)
    same = path_at(ring, ring.s)
    for name in ("p", "n", "t", "curvature", "feed", "force"):
        assert getattr(same, name) == pytest.approx(getattr(ring, name), abs=1e-12)
    s = np.array([0.0313, 0.0007, 0.0001, 0.0001, 0.0599])  # in any order
    other = path_at(replace(ring, feed=np.where(ring.s < 0.03, 0.02, 0.05)), s)
    turn = s / 0.08
    assert (other.s == s).all() and other.line == ring.line
    assert np.abs(other.p - 0.08 * np.column_stack([np.sin(turn), 0 * turn, np.cos(turn)])).max() < 1e-9
    assert np.abs(other.n - other.p / 0.08).max() < 1e-7 and np.linalg.norm(other.t, axis=1) == pytest.approx(np.ones(5))
    assert other.feed == pytest.approx([0.05, 0.02, 0.02, 0.02, 0.05])  # a step stays a step


def test_each_bound_of_the_room_before_and_behind_a_line_binds():
    half, line = ellipsoid().half_axes[0, 0], bar_pass()  # 20 N on 5 mm, 50 mm of surface around
    wide = replace(line, room_before=0.02, room_after=0.02)
    assert lead_room(wide, ellipsoid(), 5.0) == pytest.approx((half, half)) and half == pytest.approx(A, rel=0.01)
    assert lead_room(replace(wide, room_before=0.002, room_after=0.0), ellipsoid(), 5.0) == pytest.approx((0.002, 0.0))
    near = np.full((40, 4), 0.05)
    near[0, 1], near[-1, 0] = 0.006, 0.001  # to the surface's ends: behind the start, ahead of the end
    close = replace(wide, extent=near)
    small = half * (5.0 / 20.0) ** (1 / 3)  # the patch under 5 N
    assert lead_room(close, ellipsoid(), 5.0) == pytest.approx((0.006 - small, 0.0))
    assert lead_room(close, ellipsoid(), 1.0) == pytest.approx((0.006 - half * 0.05 ** (1 / 3), 0.0))
    assert lead_room(close, ellipsoid(), 40.0) == pytest.approx((0.006 - half, 0.0))  # never larger than under the full force
    ends = replace(ellipsoid(), at=np.array([0.0, 0.06]), share=np.concatenate([ellipsoid().share, ellipsoid(3e-3).share]))
    two = replace(ends, force=np.full(2, 20.0), indentation=np.full(2, 3e-4))
    assert lead_room(wide, two, 5.0) == pytest.approx((A, 3e-3), rel=0.02)  # each end has its own patch


# -- a tilted patch ------------------------------------------------------------------------------------------------


def box() -> LinePatches:
    """A flat blade under a narrow wheel: evenly pressed over 2 A along and 2 B across."""
    one = ellipsoid()
    inside = (np.abs(one.x)[:, None] <= A) & (np.abs(one.x)[None, :] <= B)
    return replace(one, share=inside[None] / (inside.sum() * CELL**2))


def uneven(patches: LinePatches, tilt: float, axis: int) -> float:
    """Root mean square over the patch, over the pressure at its middle, of what a bed of springs adds and takes away when it is
    tilted: pressed in by d at the middle, by d + tilt y at y."""
    along, across = np.meshgrid(patches.x, patches.x, indexing="ij")
    pressed = patches.share[0] > 1e-2 * patches.share[0].max()
    square = (along, across)[axis][pressed] ** 2 + CELL**2 / 12  # of a whole cell
    return float(tilt * np.sqrt(square.mean()) / patches.indentation[0])


def leaning(patches: LinePatches, missed: float = 0.0) -> PassProblem:
    line = PassProblem.start(bar_pass(), SEED, np.zeros((40, 3)))
    entry = Engagement(0.3, 0.004, 0.02, 0.76, 4900.0, 20.0)
    return air_to_air_problem(line, entry, patches, np.full(len(patches.at), missed), 1e-3, (0.003, 0.0))


def test_what_the_wheels_table_misses_is_known_from_the_start_and_goes_as_the_indentation():
    way = leaning(box(), 5e-6)
    share = way.way.share
    assert share.min() == 0.0 and share.max() > 0.99
    np.testing.assert_allclose(way.indentation_correction, 5e-6 * share ** (2 / 3), atol=1e-12)


@pytest.mark.parametrize(("patches", "off"), [(box(), 0.07), (ellipsoid(), 0.2)])
def test_lean_is_how_uneven_a_tilt_makes_the_pressure(patches, off):
    """Exact of an evenly pressed box but for half a cell; an ellipse, narrow at its ends, has a half instead of 1 / sqrt 3."""
    problem = leaning(patches)
    full = problem.course.grinding > 0
    for axis in (0, 1):
        assert problem.lean[full, axis] * 0.01 == pytest.approx(np.full(full.sum(), uneven(patches, 0.01, axis)), rel=off)
    assert problem.lean == pytest.approx(np.outer(problem.course.share, problem.lean[full][0]))  # none in the air
    assert problem.course.s[0] == pytest.approx(-0.06 / 39) and problem.depth.shape == 2 * (len(problem.course.at) - 22,)


def test_multipliers_go_over_to_the_whole_grid_as_densities():
    way = leaning(ellipsoid()).way
    few = restricted(leaning(ellipsoid()), coarse_grid(way)).way
    known, whole = (np.outer(1.0 + 3.0 * one.at, [1.0, -2.0]) * node_times(one)[:, None] for one in (few, way))
    q, even = np.zeros((len(few.at), 6)), np.ones(len(few.at))
    start = prolonged(PassSolution(q, 0.5 * even, 1.0 + few.at, even, 7, 0.0, (known, known)), few, way)
    assert np.stack(start.multipliers) == pytest.approx(np.stack([whole, whole]), rel=1e-12)
    assert (start.rate == 0.5).all() and start.ratio == pytest.approx(1.0 + way.at)


def test_on_a_coarse_grid_a_way_keeps_its_edges_and_what_is_taken_off():
    problem = leaning(ellipsoid())
    way, kept = problem.way, coarse_grid(problem.way)
    few = restricted(problem, kept)
    for time in way.edges:
        assert np.abs(few.way.at - time).min() < 1e-9 and len(few.way.edges) == 6
    full = few.way.s[few.way.grinding > 0]
    assert 0.9 * SPACING < np.diff(full)[:-1].mean() <= SPACING and len(kept) < 0.45 * len(way.at)
    assert few.path.p == pytest.approx(problem.path.p[kept]) and few.lean == pytest.approx(problem.lean[kept])
    on, inside = way.touching, few.way.touching
    r = 1.0 + 5.0 * few.way.s[inside]  # linear in between
    taken = problem.depth @ np.interp(way.s[on], few.way.s[inside], r)
    assert few.depth @ r == pytest.approx(taken[np.isin(np.arange(len(way.at))[on], kept)], rel=1e-12)


@pytest.mark.parametrize(("k_bb", "share"), [(0.0, 1.0), (16.0, 0.5)])
def test_lean_is_of_the_size_of_what_the_contact_solver_finds(k_bb, share):
    """Across the feed, over the pressure at the middle: as much on a flat blade, half of it on a curved one, where rubber bears
    further than it is pressed in by the shape."""
    wheel = WheelGeometry(radius=0.075, width=0.025, cover_thickness=0.015, modulus=3.43e6, poisson=0.47)
    cover, tilt = build_cover(wheel, 8e-4), 2e-3
    left, even, right = (solve_force(cover, 20.0, LocalShape(14.0, k_bb, tilt_y=sign * tilt)) for sign in (-1, 0, 1))
    pressed = even.pressure > 1e-2 * even.pressure.max()
    found = np.sqrt(np.mean((0.5 * (right.pressure - left.pressure)[pressed]) ** 2)) / even.pressure.max()
    lean = leaning(line_patches(np.array([0.0]), [even], [(1.0, 0.0)])).lean[:, 1].max() * tilt
    assert lean / found == pytest.approx(share, rel=0.15)
