"""What passes take off a surface: conservation, linearity, sums over lines, shares; on plane and bar with closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ocp.plan.removal.footprint import CELL
from ocp.plan.removal.result import Removal, SideRemoval, figures_of, sliding_speed
from ocp.plan.removal.surface import ContactRows, SideCells, core_cells, flank_cells, row_times, shares_of_time, work_done
from ocp.plan.removal.wanted import Wanted
from robots.kinematics import forward
from tests.plan.test_footprint import A, B, ellipsoid
from tests.support import blade_samples
from tests.support.example_pass import bar_pass, bundled_cell
from trajectories.blade import Blade, find_shape
from trajectories.passes import PassOptions, passes

FORCE, BELT, FEED, LENGTH = 20.0, 25.0, 0.04, 0.06


def plane(step: float = 5e-4, wide: float = 0.02) -> tuple[SideCells, np.ndarray, np.ndarray]:
    """Cells of the plane z = 0 about lines along x from 0 to LENGTH; points and normals flat."""
    y, x = np.meshgrid(np.arange(-wide, wide + LENGTH / 2, step), np.arange(-0.01, LENGTH + 0.01, step), indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1)
    normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    cells = SideCells("convex", points, normals, np.full(x.shape, step**2), (x >= 0) & (x <= LENGTH), x, y)
    return cells, points.reshape(-1, 3), normals.reshape(-1, 3)


def line_rows(y: float, place: int = 0, force: float = FORCE, feed: float = FEED) -> ContactRows:
    """Rows of a straight pass along x at constant force and feed."""
    time = row_times(LENGTH / feed, feed)
    n = len(time)
    p = np.column_stack([feed * time, np.full(n, y), np.zeros(n)])
    up, ahead = np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([1.0, 0.0, 0.0], (n, 1))
    slide = BELT * shares_of_time(time)
    return ContactRows(np.full(n, place), p, up, ahead, feed * time, np.full(n, force), slide)


def together(*rows: ContactRows) -> ContactRows:
    return ContactRows(*(np.concatenate([getattr(one, name) for one in rows]) for name in ContactRows.__dataclass_fields__))


def test_the_volume_is_prestons_force_times_slid_length():
    cells, points, normals = plane()
    work = work_done(points, normals, line_rows(0.0), [ellipsoid()])
    assert (work * cells.area.ravel()).sum() == pytest.approx(FORCE * BELT * LENGTH / FEED, rel=3e-3)


def test_the_depth_is_linear_in_force_over_feed():
    _, points, normals = plane()
    once = work_done(points, normals, line_rows(0.0), [ellipsoid()])
    slow = work_done(points, normals, line_rows(0.0, feed=FEED / 3), [ellipsoid()])
    assert slow == pytest.approx(3 * once, rel=2e-3, abs=2e-3 * once.max())
    rows = line_rows(0.0)
    twice = work_done(points, normals, replace(rows, slide=2 * rows.slide), [ellipsoid()])
    assert twice == pytest.approx(2 * once)


def test_depth_across_a_line_and_in_its_middle():
    """A parabola of half-width B: 3 F V / (4 b v) in the middle of the line."""
    cells, points, normals = plane()
    work = work_done(points, normals, line_rows(0.0), [ellipsoid()]).reshape(cells.area.shape)
    across, y = work[:, work.shape[1] // 2], cells.points[:, 0, 1]
    parabola = 0.75 * FORCE * BELT / (B * FEED) * np.maximum(1 - (y / B) ** 2, 0.0)
    assert np.abs(across - parabola).max() < 0.05 * parabola.max()


def test_lines_are_summed_and_judged():
    """Lines 0.58 b apart: the core is even within 5 %, half of the depth is there at the ends, what lies beyond is not core."""
    h, cells, lines = 0.58 * B, plane()[0], 12
    paths = []
    for k in range(lines):
        x = np.linspace(0.0, LENGTH, 121)
        p = np.column_stack([x, np.full(121, k * h), 0 * x])
        one = bar_pass(121)
        frame = {"n": np.tile([0.0, 0.0, 1.0], (121, 1)), "t": np.tile([1.0, 0, 0], (121, 1))}
        paths.append(replace(one, line=k + 1, p=p, s=x, **frame))
    rows = together(*(line_rows(k * h, k) for k in range(lines)))
    points, normals = cells.points.reshape(-1, 3), cells.normals.reshape(-1, 3)
    work = work_done(points, normals, rows, [ellipsoid()] * lines).reshape(cells.area.shape)
    relative = work * FEED * h / (FORCE * BELT)
    core = core_cells(cells, paths, [A] * lines)
    y = cells.points[..., 1]
    assert np.ptp(y[core]) == pytest.approx((lines - 1) * h, abs=1.2e-3)
    asked = cells.asked & (y > 0) & (y < (lines - 1) * h)
    figures = figures_of([SideRemoval(replace(cells, asked=asked), core & asked, relative)])
    inner = core & (y > h) & (y < (lines - 2) * h)
    assert np.abs(relative[inner] - 1).max() < 0.05
    assert figures.core_within_10 is not None and figures.core_within_10 > 0.85
    assert figures.all_within_10 < figures.core_within_10
    assert figures.least == pytest.approx(0.5 * 0.75 * 0.58 * (1 + (1 - 0.58**2)), abs=0.03)  # the corner
    assert figures.ground_share > 0.97


def test_the_other_wall_is_not_ground():
    _, points, normals = plane(2e-3)
    both, looks = np.vstack([points, points - [0, 0, 1e-3]]), np.vstack([normals, -normals])
    work = work_done(both, looks, line_rows(0.0), [ellipsoid()])
    assert work[: len(points)].max() > 0 and (work[len(points) :] == 0).all()


def test_no_core_without_neighbours_and_no_share_of_nothing():
    cells = plane(2e-3)[0]
    assert not core_cells(cells, [bar_pass()], [A]).any()
    relative = np.ones(cells.area.shape)
    figures = figures_of([SideRemoval(cells, np.zeros(relative.shape, bool), relative)])
    assert figures.core_within_5 is None and figures.all_within_10 == 1.0
    assert figures.most == figures.most_beside == 1.0
    deep = figures_of([SideRemoval(cells, np.zeros(relative.shape, bool), np.where(cells.asked, 1.0, 1.6))])
    assert deep.most == 1.0 and deep.most_beside == 1.6
    nothing = np.zeros((0, 3))
    told = [Removal((), one, Wanted(), nothing, nothing, nothing).beside_told() for one in (figures, deep)]
    assert told[0] == [] and "1.60 times" in told[1][0] and "edge_margin_mm" in told[1][0]
    assert figures.document()["core_within_10"] is None
    assert CELL < 5e-4


def test_pieces_of_the_outermost_line_are_all_outermost():
    """A line cut in two counts once: neither beyond the one nor beyond the other piece is core."""
    h, cells = 0.58 * B, plane()[0]
    paths = []
    for line, (start, end) in enumerate([(0.0, 0.02), (0.03, LENGTH), (0.0, LENGTH), (0.0, LENGTH)]):
        x = np.linspace(start, end, 121)
        number = max(line - 1, 0)
        p = np.column_stack([x, np.full(121, number * h), 0 * x])
        frame = {"n": np.tile([0.0, 0.0, 1.0], (121, 1)), "t": np.tile([1.0, 0, 0], (121, 1))}
        paths.append(replace(bar_pass(121), line=number + 1, p=p, s=x - start, **frame))
    core = core_cells(cells, paths, [A] * 4)
    x, y = cells.points[..., 0], cells.points[..., 1]
    beside = core & ((x < 0.018) | (x > 0.032))
    assert beside.any() and y[beside].min() > -5e-4 and y[beside].max() < 2 * h + 5e-4


def test_a_path_off_the_flanks_has_no_shares():
    """Round an edge nothing is mapped: the figures are empty, and none is made up."""
    assert all(value is None for value in figures_of([]).document().values())


def test_what_is_asked_beside_a_path_made_elsewhere():
    """A strip to both sides of the path, on the wall that it grinds alone."""
    blade = Blade("sample", "", *blade_samples.blade_mesh(60, 20))
    shape = find_shape(blade)
    path = passes(blade, shape, PassOptions(side="convex", step=2e-3))[0][3]
    flanks = flank_cells(shape, {}, [path], 3e-3)
    assert [one.side for one in flanks] == ["convex"]
    apart = cKDTree(path.p).query(flanks[0].points[flanks[0].asked])[0]
    assert 2.5e-3 < apart.max() <= 3e-3
    strip = flanks[0].area[flanks[0].asked].sum()
    assert strip == pytest.approx(2 * 3e-3 * path.s[-1] + np.pi * 3e-3**2, rel=0.1)
    assert flank_cells(shape, {}, [replace(path, n=-path.n)], 1e-3) == []


def test_the_belt_slides_against_the_moving_blade():
    """Axis 1 alone turns: the blade's point moves with -qd z x p (KUKA counts axis 1 against z)."""
    cell = bundled_cell()
    q, qd = np.radians([3.0, -80.0, 95.0, 10.0, 50.0, 20.0]), np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    p = np.array([0.01, 0.02, 0.05])
    line = SimpleNamespace(q=q[None], qd=qd[None], p=p[None])
    at = (forward(cell.robot, q[None])[0] @ cell.workpiece.T_flange_blade @ np.append(p, 1.0))[:3]
    _, radial, rho = cell.wheel.cylindrical(at[None])
    belt = cell.wheel.belt_speed * np.cross(cell.wheel.axis, radial[0] / rho[0])
    blade = -0.5 * np.cross([0.0, 0.0, 1.0], at)
    found = sliding_speed(cell, line, np.array([True]))[0]
    assert found == pytest.approx(np.linalg.norm(belt - blade), rel=1e-6)
    assert abs(found - np.linalg.norm(belt + blade)) > 0.05
