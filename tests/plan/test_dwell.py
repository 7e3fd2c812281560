"""Distances and feeds of lines: from the patch's width, and so that the sum of all lines is even; on the bundled blade."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.model.prepare import wheel_cover
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.plan.removal.dwell import EVEN, LEAST_EVEN, even_spacing
from ocp.plan.removal.footprint import planned_patches
from ocp.plan.removal.result import SideRemoval, figures_of
from ocp.plan.removal.surface import ContactRows, core_cells, work_done
from ocp.plan.removal.wanted import programmed_work
from tests.plan.test_footprint import B, ellipsoid
from trajectories.passes import BladePath

OPTIONS = PlanOptions(step=1e-3)


@pytest.fixture(scope="module")
def cell():
    cell = read_cell(CELL)
    return replace(cell, process=replace(cell.process, side="convex", root_margin=0.025))  # where the wheel has room


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
    patches = [planned_patches(cell, cover, path) for path in laid.paths]
    rows, sides = driven(cell, laid.paths, patches), []
    half = [float(one.half_axes[:, 0].max()) for one in patches]
    for one in laid.flanks:
        work = work_done(one.points.reshape(-1, 3), one.normals.reshape(-1, 3), rows, patches).reshape(one.area.shape)
        asked = laid.wanted.at(one.points.reshape(-1, 3), one.normals.reshape(-1, 3)).reshape(one.area.shape)
        sides.append(SideRemoval(one, core_cells(one, laid.paths, half), work / programmed_work(cell) / asked))
    return figures_of(sides, 0.0), patches


def test_lines_and_feeds_make_the_surface_even(cell):
    laid = lay_paths(cell, cell.workpiece.stl, OPTIONS)
    figures, patches = judged(cell, laid)
    assert figures.core_within_5 > 0.88 and figures.core_within_10 > 0.985
    assert figures.all_within_10 > 0.9 and figures.most < 1.15 and figures.ground_share > 0.96
    for one, other, patch in zip(laid.paths, laid.paths[1:], patches, strict=False):
        apart = cKDTree(other.p).query(one.p)[0].max()
        assert apart < 1.08 * EVEN * max(patch.half_axes[:, 1].min(), planned_next(cell, other))
    assert all(np.abs(np.diff(path.feed)).max() < 2e-3 for path in laid.paths)  # m/s from waypoint to waypoint
    assert all((path.force == cell.process.force).all() for path in laid.paths)


def planned_next(cell, path) -> float:
    return float(planned_patches(cell, wheel_cover(cell), path).half_axes[:, 1].min())


def test_without_it_lines_are_as_far_apart_as_asked_and_not_even(cell):
    laid = lay_paths(cell, cell.workpiece.stl, replace(OPTIONS, even=False))
    figures, _ = judged(cell, laid)
    assert all((path.feed == cell.process.feed).all() for path in laid.paths)
    assert figures.core_within_10 < 0.5


def test_the_depth_per_area_stays_when_more_lines_are_asked_for(cell):
    """Half the spacing at twice the feed asks for the same depth: the same lines at the same feeds."""
    one = lay_paths(cell, cell.workpiece.stl, OPTIONS)
    process = replace(cell.process, pass_spacing=0.5 * cell.process.pass_spacing, feed=2 * cell.process.feed)
    other = lay_paths(replace(cell, process=process), cell.workpiece.stl, OPTIONS)
    assert len(other.paths) >= len(one.paths)
    speed = [np.mean([1 / path.feed.mean() for path in laid.paths]) * len(laid.paths) for laid in (one, other)]
    assert speed[1] == pytest.approx(speed[0], rel=0.03)


def test_a_flat_profile_asks_for_nearer_lines_than_a_parabola():
    """Boxes of the wheel's width sum up to a line more or less between them; parabolas 0.6 half-widths apart are even."""
    parabola = ellipsoid()
    assert even_spacing(parabola) == pytest.approx(EVEN * parabola.half_axes[0, 1])
    assert parabola.unevenness(0.58 * B).max() < 0.05 < parabola.unevenness(1.2 * B).max()
    box = replace(parabola, share=np.where(np.abs(parabola.x) < 6e-3, parabola.share.max(axis=2, keepdims=True), 0.0))
    assert box.half_axes[0, 1] == pytest.approx(6e-3, abs=4e-4)
    assert box.unevenness(12e-3 / 3.5).max() == pytest.approx(0.5 / 3.5, rel=0.2)
    assert even_spacing(box) == pytest.approx(LEAST_EVEN * box.half_axes[0, 1])


def test_cells_beyond_the_outermost_lines_are_not_made_good_before_them(cell):
    """Chordwise lines start where the wheel has room: the feed of the first is that of its neighbours."""
    asked = replace(cell, process=replace(cell.process, passes="chordwise", root_margin=0.005, tip_margin=0.03))
    feed = np.array([path.feed.mean() for path in lay_paths(asked, cell.workpiece.stl, replace(OPTIONS, step=3e-3)).paths])
    assert feed[0] > 0.6 * np.median(feed) and feed[1] < 1.6 * np.median(feed)
