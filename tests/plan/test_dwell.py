"""Distances and feeds of lines: from the patch's width, and so that the sum of all lines is even; on the bundled blade."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.model.prepare import wheel_cover
from ocp.plan.passes.course import Engagement, air_to_air, lengthened
from ocp.plan.passes.optimise import _at_feeds
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.stretches import LineStretch
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.plan.removal.dwell import (
    EVEN,
    KEPT,
    LEAST_EVEN,
    RANGE,
    SMOOTH,
    UNEVEN,
    DrivenLine,
    _Line,
    _solved,
    askew,
    even_feeds,
    even_spacing,
    feeds_told,
    probed_lines,
    programmable,
)
from ocp.plan.removal.footprint import Pressing, planned_patches
from ocp.plan.removal.result import SideRemoval, figures_of
from ocp.plan.removal.surface import ContactRows, SideCells, core_cells, work_done
from ocp.plan.removal.wanted import Wanted, programmed_work
from ocp.plan.rules import FEEDS, LEAST_RAMP
from tests.plan.test_footprint import A, B, ellipsoid
from tests.support.example_pass import bar_pass, bundled_cell
from trajectories.blade import find_shape, read_blade
from trajectories.passes import BladePath, PassOptions, passes

OPTIONS = PlanOptions(step=1e-3)


@pytest.fixture(scope="module")
def cell():
    cell = read_cell(CELL)
    return replace(cell, process=replace(cell.process, side="convex", root_margin=0.025))  # where the wheel has room


@pytest.fixture(scope="module")
def laid(cell):
    """Lines and feeds of the cell as it is."""
    return lay_paths(cell, cell.workpiece.stl, OPTIONS)


def driven(cell, paths: list[BladePath], patches) -> ContactRows:
    """Every path at its feed and force, leading in and out straight on for a patch's half-length."""
    parts = []
    for k, path in enumerate(paths):
        beyond = patches[k].half_axes[:, 0].max()
        s = np.arange(-beyond, path.s[-1] + beyond, 5e-4)
        at = np.clip(s, 0.0, path.s[-1])
        p, n, t = (np.column_stack([np.interp(at, path.s, of[:, i]) for i in range(3)]) for of in (path.p, path.n, path.t))
        slide = 5e-4 / np.interp(at, path.s, path.feed) * cell.wheel.belt_speed
        parts.append((np.full(len(s), k), p + (s - at)[:, None] * t, n, t, at, np.interp(at, path.s, path.force), slide))
    return ContactRows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def judged(cell, laid):
    cover = wheel_cover(cell)
    patches = [planned_patches(Pressing.of(cell), cover, path) for path in laid.paths]
    rows, sides = driven(cell, laid.paths, patches), []
    half = [float(one.half_axes[:, 0].max()) for one in patches]
    for one in laid.flanks:
        work = work_done(one.points.reshape(-1, 3), one.normals.reshape(-1, 3), rows, patches).reshape(one.area.shape)
        asked = laid.wanted.at(one.points.reshape(-1, 3), one.normals.reshape(-1, 3)).reshape(one.area.shape)
        sides.append(SideRemoval(one, core_cells(one, laid.paths, half), work / programmed_work(cell) / asked))
    return figures_of(sides), patches


def test_lines_and_feeds_make_the_surface_even(cell, laid):
    figures, patches = judged(cell, laid)
    assert figures.core_within_5 > 0.93 and figures.core_within_10 > 0.99
    assert figures.all_within_10 > 0.91 and figures.most < 1.1 and figures.ground_share > 0.96
    for one, other, patch in zip(laid.paths, laid.paths[1:], patches, strict=False):
        apart = cKDTree(other.p).query(one.p)[0].max()
        assert apart < 1.08 * EVEN * max(patch.half_axes[:, 1].min(), planned_next(cell, other))
    steps = [np.abs(np.diff(path.feed)).max() for path in laid.paths]  # m/s from waypoint to waypoint
    assert max(steps) < 8e-3 and np.median(steps) < 2e-3
    assert all((path.force == cell.process.force).all() for path in laid.paths)


def planned_next(cell, path) -> float:
    return float(planned_patches(Pressing.of(cell), wheel_cover(cell), path).half_axes[:, 1].min())


def test_without_it_lines_are_as_far_apart_as_asked_and_not_even(cell):
    laid = lay_paths(cell, cell.workpiece.stl, replace(OPTIONS, even=False))
    figures, _ = judged(cell, laid)
    assert all((path.feed == cell.process.feed).all() for path in laid.paths)
    assert figures.core_within_10 < 0.5


def test_the_depth_per_area_stays_when_more_lines_are_asked_for(cell, laid):
    """Half the spacing at twice the feed asks for the same depth: the same lines at the same feeds."""
    process = replace(cell.process, pass_spacing=0.5 * cell.process.pass_spacing, feed=2 * cell.process.feed)
    other = lay_paths(replace(cell, process=process), cell.workpiece.stl, OPTIONS)
    assert len(other.paths) >= len(laid.paths)
    speed = [np.mean([1 / path.feed.mean() for path in one.paths]) * len(one.paths) for one in (laid, other)]
    assert speed[1] == pytest.approx(speed[0], rel=0.03)


def test_a_flat_profile_asks_for_nearer_lines_than_a_parabola():
    """Boxes of the wheel's width sum up to a line more or less between them; parabolas 0.6 half-widths apart are even."""
    parabola = ellipsoid()
    assert even_spacing(parabola) == pytest.approx(0.5 * parabola.half_axes[0, 1])
    assert parabola.unevenness(0.58 * B).max() < 0.05 < parabola.unevenness(1.2 * B).max()
    box = replace(parabola, share=np.where(np.abs(parabola.x) < 6e-3, parabola.share.max(axis=2, keepdims=True), 0.0))
    assert box.half_axes[0, 1] == pytest.approx(6e-3, abs=4e-4)
    assert box.unevenness(12e-3 / 3.5).max() == pytest.approx(0.5 / 3.5, rel=0.2)
    assert even_spacing(box) == pytest.approx(LEAST_EVEN * box.half_axes[0, 1])


def test_a_wheel_that_stands_askew_makes_flat_lines_even(cell):
    """Straight, a flat blade gets steps however near its lines lie; turned, the edges run out over the patch's length."""
    cover, flat = wheel_cover(cell), on_a_plane(0)
    straight = planned_patches(Pressing.of(cell), cover, flat)
    spread, looked = probed_lines(Pressing.of(cell), cover, [flat, replace(on_a_plane(1), side="concave")])
    assert [one.side for one in looked] == ["convex", "concave"] and 0.2 < abs(looked[0].turn) <= cell.process.turn_tolerance
    asked = spread["convex"][1][0]
    assert asked > 1.5 * even_spacing(straight)
    assert (
        planned_patches(Pressing.of(cell), cover, looked[0]).unevenness(asked).max() <= UNEVEN < straight.unevenness(asked).max()
    )


def test_a_line_that_begins_on_the_outline_of_its_wall_is_judged_by_the_rest(cell):
    """Right on the outline the wall ends to all sides, and a contact there is one cell of the grid or none."""
    wheel = replace(cell.wheel, radius=40.0313355e-3, cover_modulus=2.5391418e6)
    worn, flat = replace(cell, wheel=wheel), on_a_plane(0)
    extent = flat.extent.copy()
    extent[0] = 1.4e-7
    patches = planned_patches(Pressing.of(worn), wheel_cover(worn), replace(flat, extent=extent))
    assert patches.at[0] > flat.s[0] and patches.half_axes[:, 1].min() > 3e-3


def test_round_lines_are_not_turned_and_those_of_a_side_all_alike(cell, laid):
    look = PassOptions(spacing=6e-3, step=6e-3, clamp_normal=(0.0, 0.0, 1.0), clamp_offset=0.01)
    blade = read_blade(cell.workpiece.stl)
    shape = find_shape(blade, cell.workpiece.aerofoil)
    _, looked = probed_lines(Pressing.of(cell), wheel_cover(cell), passes(blade, shape, look)[0])
    assert {one.turn for one in looked if one.side == "convex"} == {0.0}
    (hollow,) = {one.turn for one in looked if one.side == "concave"}
    assert abs(hollow) > 0.6 * cell.process.turn_tolerance
    again = askew([replace(path, turn=0.0) for path in laid.paths], looked)
    assert all(path.turn in {one.turn for one in looked if one.side == path.side} for path in again)
    round_ = replace(bar_pass(radius=0.012), side="convex")
    assert [one.turn for one in probed_lines(Pressing.of(cell), wheel_cover(cell), [round_])[1]] == [0.0]


def test_cells_beyond_the_outermost_lines_are_not_made_good_before_them(cell):
    """Chordwise lines start where the wheel has room: the feed of the first is that of its neighbours."""
    asked = replace(cell, process=replace(cell.process, passes="chordwise", root_margin=0.005, tip_margin=0.03))
    feed = np.array([path.feed.mean() for path in lay_paths(asked, cell.workpiece.stl, replace(OPTIONS, step=3e-3)).paths])
    assert feed[0] > 0.6 * np.median(feed) and feed[1] < 1.6 * np.median(feed)


# -- feeds of lines whose force rises and falls at their ends ------------------------------------------------------

APART, LINES, LENGTH = 0.55 * B, 15, 0.06


def on_a_plane(k: int, feed: float = 0.04, length: float = LENGTH) -> BladePath:
    """One of parallel lines along x, APART in y, on a plane that looks up."""
    path, n = bar_pass(n=61, length=length, feed=feed), 61
    p = np.column_stack([path.s, np.full(n, APART * k), np.zeros(n)])
    up, ahead = np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([1.0, 0.0, 0.0], (n, 1))
    return replace(path, line=k + 1, p=p, n=up, t=ahead, curvature=np.zeros((n, 3)), room_before=A, room_after=A)


def plane_cells() -> SideCells:
    x, y = np.meshgrid(np.arange(0.0, LENGTH, 7e-4), np.arange(0.0, APART * (LINES - 1), 7e-4), indexing="ij")
    points, up = np.stack([x, y, 0 * x], axis=-1), np.tile([0.0, 0.0, 1.0], (*x.shape, 1))
    return SideCells("convex", points, up, np.full(x.shape, 7e-4**2), np.ones(x.shape, bool), x, y)


def led(path: BladePath, room: float = 0.003) -> DrivenLine:
    """With ramps of 0.3 s, in which 6 mm are driven: more than a patch's half-length."""
    patches = ellipsoid()
    return DrivenLine(path, patches, np.zeros(len(patches.at)), Engagement(0.3, 4e-3, 0.02, 0.76, 4900.0, 20.0), (room, room))


def ground_by(lines: list[DrivenLine], points: np.ndarray) -> np.ndarray:
    """Preston's integral in time, step by step, with Hertz's ellipsoids in closed form: N/m^2 s at points (m, 3)."""
    total, dt = np.zeros(len(points)), 2e-3
    for line in lines:
        longer = lengthened(line.path, *line.room)
        course = air_to_air(longer, line.entry, 0.02)
        for t in np.arange(course.edges[1] + 0.5 * dt, course.edges[4], dt):
            force = 20.0 * float(course.share_at(np.array(t)))
            a, b = np.array([A, B]) * np.cbrt(force / 20.0)
            off = points[:, :2] - [float(course.arc_at(np.array(t))), line.path.p[0, 1]]
            round_ = np.maximum(1 - (off[:, 0] / a) ** 2 - (off[:, 1] / b) ** 2, 0.0)
            total += force * 1.5 / (np.pi * a * b) * np.sqrt(round_) * dt
    return total


def inside_the_lines() -> np.ndarray:
    """Places (k, 26, 3) on lines and between, a patch's half-axes inside the outermost and inside their ends."""
    x, y = np.meshgrid(np.linspace(A, LENGTH - A, 26), APART * np.arange(2.0, LINES - 2.9, 0.25))
    return np.stack([x, y, 0 * x], axis=-1)


def test_feeds_make_lines_with_ramps_even_in_the_core():
    """Lines 0.55 half-widths apart that are ground alike are even within 2 %; what the fit adds inside is for the rim."""
    cell, at = bundled_cell(), inside_the_lines()
    lines = [led(on_a_plane(k), 0.0) for k in range(LINES)]  # their margins have no room
    process = cell.process
    wanted = process.force / (process.feed * process.pass_spacing)  # of the programmed pass, N s/m^2

    def depth(feeds):
        made = [replace(line, path=replace(line.path, feed=feed)) for line, feed in zip(lines, feeds, strict=True)]
        return ground_by(made, at.reshape(-1, 3)).reshape(at.shape[:2]) / wanted

    alike = depth([np.full(61, process.feed * process.pass_spacing / APART)] * LINES).mean(axis=0)
    assert (
        alike[[0, -1]].max() < 0.98 * alike[13] and np.ptp(alike) > 0.02
    )  # as they are, lines are shallow where the patch is small
    feeds = even_feeds(cell, [plane_cells()], Wanted(), lines)
    made = depth(feeds)
    assert np.abs(made - 1).max() < 0.08 and np.std(made) < 0.025 and np.mean(np.abs(made - 1) < 0.05) > 0.98
    assert np.abs(made.mean(axis=0) - 1).max() < 0.025 and np.ptp(made.mean(axis=0)) < 0.04
    slowness = np.mean([1 / feed for feed in feeds], axis=0)
    assert slowness[[0, -1]].min() > 1.2 * slowness[30]


def test_feeds_are_those_of_another_solver_and_stay_in_their_range():
    """SciPy's bounded-variable least squares on the rows of docs/process.md, eq. 7, written out densely."""
    rng = np.random.default_rng(3)
    depth = [np.abs(rng.normal(size=(30, 7))) for _ in range(2)]
    weight, wanted = rng.uniform(0.5, 2.0, 30), np.exp(rng.normal(size=30))
    found = np.concatenate(_solved([_Line(csr_matrix(one), np.arange(7.0)) for one in depth], weight, wanted))
    D, bend = np.hstack(depth), np.diff(np.eye(7), 2, axis=0)
    usual = (D.T @ (weight**2 * wanted)) / (D.T @ (weight**2 * D.sum(axis=1)))
    rows = np.vstack([weight[:, None] * D * usual, np.sqrt(KEPT) * np.eye(14), np.sqrt(SMOOTH) * block_diag(bend, bend)])
    goal = np.concatenate([weight * wanted, np.full(14, np.sqrt(KEPT)), np.zeros(10)])
    alone = lsq_linear(rows, goal, RANGE, method="bvls", tol=1e-12).x
    assert np.isclose(alone, RANGE[0]).any() and not np.isclose(alone, RANGE[0]).all()
    np.testing.assert_allclose(found / usual, alone, atol=1e-4)  # of a feed: less than a controller is told


def test_lines_that_cannot_be_looked_at_are_kept_as_they_are():
    cell, lines = bundled_cell(), [led(on_a_plane(k)) for k in range(LINES)]
    holed = [None if k == 4 else line for k, line in enumerate(lines)]
    feeds = even_feeds(cell, [plane_cells()], Wanted(), holed)
    assert feeds[4] is None and all(feed is not None for k, feed in enumerate(feeds) if k != 4)
    whole = even_feeds(cell, [plane_cells()], Wanted(), lines)
    assert feeds[3][30] < 0.9 * whole[3][30]  # its neighbours make good what it does not take
    assert even_feeds(cell, [plane_cells()], Wanted(), [None, None]) == [None, None]
    assert even_feeds(cell, [], Wanted(), lines) == [None] * LINES


@pytest.mark.parametrize(("length", "room"), [(0.06, 0.0), (0.06, 0.003), (0.012, 0.004)])
def test_rows_of_a_line_add_up_to_the_way_that_is_driven(length, room):
    line = led(on_a_plane(3, length=length), room)
    rows = line.rows()
    reach = room  # whole waypoints
    assert rows.slide.sum() == pytest.approx(length + 2 * reach, rel=1e-3) and (rows.slide > 0).all()
    assert (rows.force > 0).all() and rows.force.max() <= 20.0 * (1 + 1e-12)
    assert (rows.s > -reach).all() and (rows.s < length + reach).all()
    assert rows.p == pytest.approx(np.column_stack([rows.s, np.full(len(rows.s), 3 * APART), 0 * rows.s]), abs=1e-9)
    # Force over feed is one number, so that work over way is that of a line pressed in full all along.
    seconds = (rows.force * rows.slide).sum() / (20.0 * rows.slide.sum())
    share = air_to_air(lengthened(line.path, room, room), line.entry, 0.02)
    assert seconds == pytest.approx(np.trapezoid(share.share**2, share.at) / np.trapezoid(share.share, share.at), rel=2e-3)


def test_a_line_too_short_for_its_ramps_is_driven_alone():
    rows = led(on_a_plane(0, length=0.004), 0.0)
    rows = replace(rows, entry=replace(rows.entry, ramp=0.1)).rows()  # 2 mm of it: nothing is left between ramps
    assert rows.slide.sum() == pytest.approx(0.004) and (rows.force == 20.0).all()


def test_feeds_come_back_in_the_direction_of_the_line():
    """A seed that travels backward sees the line turned round, and tells its feeds so."""
    path = bar_pass()
    line, rising = LineStretch(path, np.zeros((len(path.s), 3))), np.linspace(0.03, 0.06, len(path.s))
    seeds = [Seed(d, 0, np.zeros(7), 0.0, np.zeros((7, 6)), np.linspace(0, 1, 7), 0.0) for d in (1, -1, 1)]
    onward, back, kept = _at_feeds([line] * 3, seeds, [rising, rising, None])
    assert (onward.path.feed == rising).all() and (back.path.feed == rising[::-1]).all() and kept is line


def test_the_feed_that_can_be_driven_is_that_between_the_ramps():
    """A short line never comes to its programmed feed: what it comes to is what is judged."""
    path = bar_pass()
    least, most = programmable(path)
    assert least == FEEDS[0] and most >= FEEDS[1]
    for feed in (0.35, 0.5, 0.9):
        fast = replace(path, feed=np.full(len(path.s), feed))
        entry = Engagement(LEAST_RAMP, 4e-3, 0.02, 0.5, 2e4, 20.0)  # the shortest ramp that a cell may have
        peak = air_to_air(fast, entry, 1e-3).peak if feed < 0.5 else 0.0
        assert programmable(fast)[1] > FEEDS[1] and peak * feed < FEEDS[1]


def test_lines_at_an_end_of_what_can_be_driven_are_named(cell):
    slow = replace(bar_pass(), feed=np.full(40, FEEDS[0]), line=7)
    told = feeds_told(cell, [bar_pass(), slow], Wanted(), laid=True)
    assert "2 lines lie at most" in told and "feeds of lines 7 are at an end" in told and "feeds are 2 to" in told
    assert "lie at most" not in feeds_told(cell, [bar_pass()], Wanted(), laid=False)


def test_laid_lines_are_kept_whatever_the_feed_and_the_place_of_wheel_and_blade(cell, laid, monkeypatch, tmp_path):
    monkeypatch.setenv("GRINDPLAN_CACHE", str(tmp_path))
    cell = replace(cell, process=replace(cell.process, preston=2e-13))  # the depth in um goes with the feed, lines do not
    first = lay_paths(cell, cell.workpiece.stl, OPTIONS)
    for one, other in zip(first.paths, laid.paths, strict=True):
        np.testing.assert_array_equal(one.p, other.p)
        np.testing.assert_array_equal(one.feed, other.feed)

    laying = []
    monkeypatch.setattr("ocp.plan.paths.even_lines", lambda *given: laying.append(given) or [None] * len(given[2]))
    moved = np.array(cell.workpiece.T_flange_blade)
    moved[:3, 3] += 1e-3
    elsewhere = replace(
        cell,
        process=replace(cell.process, feed=0.93 * cell.process.feed),
        wheel=replace(cell.wheel, centre=cell.wheel.centre + 1e-3),
        workpiece=replace(cell.workpiece, T_flange_blade=moved),
    )
    again = lay_paths(elsewhere, cell.workpiece.stl, OPTIONS)
    assert not laying
    assert again.notices == first.notices and len(again.flanks) == len(first.flanks)
    for one, other in zip(again.paths, first.paths, strict=True):
        np.testing.assert_array_equal(one.p, other.p)
        np.testing.assert_allclose(one.feed, 0.93 * other.feed, rtol=1e-12)

    others = {
        "force": replace(cell, process=replace(cell.process, force=21.0)),
        "spacing": replace(cell, process=replace(cell.process, pass_spacing=5e-3)),
        "margin": replace(cell, process=replace(cell.process, tip_margin=0.007)),
        "cover": replace(cell, wheel=replace(cell.wheel, cover_modulus=1.1 * cell.wheel.cover_modulus)),
        "belt": replace(cell, wheel=replace(cell.wheel, belt_speed=-cell.wheel.belt_speed)),
        "depth": replace(cell, process=replace(cell.process, removal=5e-6)),
        "clamp": replace(cell, workpiece=replace(cell.workpiece, clamp_offset=cell.workpiece.clamp_offset + 1e-3)),
    }
    for name, other in others.items():
        laying.clear()
        lay_paths(other, cell.workpiece.stl, OPTIONS)
        assert laying, name
