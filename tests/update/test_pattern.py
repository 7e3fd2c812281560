"""What a log ground at a point, how that moves with the state, and the state that comes back from measured depths."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ocp.update.pattern as pattern_module
from ocp.calibrate.force.fit import BIAS, force_prior
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.prepare import wheel_cover
from ocp.model.theta import NAMES
from ocp.plan.removal.footprint import CELL, LinePatches
from ocp.update.drift import last_state
from ocp.update.pattern import GroundLog, fit_pattern
from ocp.update.removal import MeasuredDepths
from robots.errors import Infeasible
from tests.support.wearing_cell import wearing_cell

A, B, LENGTH = 5e-3, 3.5e-3, 0.04  # m
FEED, CURVATURE = 0.04, 4.0  # m/s; 1/m across the line: as flat as a pressure side
THETA = force_prior(wearing_cell().cell).mean[:BIAS]


def round_back(p, n, t) -> SurfaceCloud:
    """The blade about a point of the wearing cell: straight along t, round across it."""
    along, across = (v.ravel() for v in np.meshgrid(np.arange(-0.03, 0.03, 4e-4), np.arange(-0.02, 0.02, 4e-4), indexing="ij"))
    b, fall = np.cross(n, t), 0.5 * CURVATURE * across**2
    normals = n + CURVATURE * across[:, None] * b
    return SurfaceCloud(
        p + along[:, None] * t + across[:, None] * b - fall[:, None] * n, normals / np.linalg.norm(normals, axis=1)[:, None]
    )


def straight_line(force: float = 20.0) -> GroundLog:
    """A log of one straight pass along z at 40 mm/s; all its rows stand as the first of the wearing cell does."""
    world, count = wearing_cell(), 9
    s, still = np.linspace(0.0, LENGTH, count), np.zeros(count, np.int64)
    frame = {"n": np.tile([0.0, 1.0, 0.0], (count, 1)), "t": np.tile([0.0, 0.0, 1.0], (count, 1))}
    place = {"time": s / FEED, "p": np.column_stack([0 * s, 0 * s + 0.03, s]), "run": still}
    log, rows = replace(world.log.take(still), **frame, **place), world.rows.take(still)
    rows.waypoint[:, 9:12] = [0.0, CURVATURE, 0.0]
    cell = replace(world.cell, calibration=None)
    cloud = round_back(rows.waypoint[0, :3], rows.waypoint[0, 3:6], rows.waypoint[0, 6:9])
    return GroundLog(world.model, rows, log, np.full(count, force), wheel_cover(cell, 1.5), cloud)


def places(across, along) -> tuple[np.ndarray, np.ndarray]:
    """Points on the plane that the log's line lies on, and their normals."""
    x, z = (v.ravel() for v in np.meshgrid(across, along, indexing="ij"))
    return np.column_stack([x, 0 * x + 0.03, z]), np.tile([0.0, 1.0, 0.0], (len(x), 1))


def ellipsoids(at, contacts, headings) -> LinePatches:
    x = CELL * np.arange(-20, 21)
    share = np.sqrt(np.maximum(1 - (x[:, None] / A) ** 2 - (x[None, :] / B) ** 2, 0.0))
    return LinePatches(
        at, x, np.array([share / (share.sum() * CELL**2)] * len(at)), np.full(len(at), 20.0), np.full(len(at), 3e-4)
    )


def test_the_work_under_a_line_is_prestons_integral(monkeypatch):
    """h = F V / v times the profile across; a parabola of half-width B under Hertz's pressure (docs/process.md). The log's rows
    lie as far apart as the patch is long."""
    monkeypatch.setattr(pattern_module, "line_patches", ellipsoids)
    ground, across = straight_line(), np.linspace(-1.2 * B, 1.2 * B, 25)
    p, n = places(across, [0.02])
    p, n = np.vstack([p, [0.0, 0.03, -0.02], [0.0, 0.028, 0.02]]), np.vstack([n, n[0], -n[0]])  # past the end; the other side
    h = ground.work(THETA, p, n)
    speed = ground.model.cell.wheel.belt_speed - FEED  # the blade runs with the belt
    wanted = 20.0 * speed / FEED * 0.75 / B * np.maximum(1 - (across / B) ** 2, 0.0)
    assert h[:25] == pytest.approx(wanted, abs=0.05 * wanted.max())
    assert h[25] == 0 and h[26] == 0


def test_the_work_of_a_real_contact_adds_up():
    """Without any stand-in: over the blade the work is force times sliding way, whatever the patch's shape."""
    ground, across, along = straight_line(), np.linspace(-0.012, 0.012, 61), np.linspace(-0.01, 0.05, 31)
    h = ground.work(THETA, *places(across, along))
    cell = (across[1] - across[0]) * (along[1] - along[0])
    assert h.sum() * cell == pytest.approx(20.0 * (ground.model.cell.wheel.belt_speed - FEED) * LENGTH / FEED, rel=0.02)


@pytest.mark.parametrize(("name", "step"), [("blade_x", 2e-4), ("wheel_axis_v", 1e-3), ("cover_stiffness_scale", 0.2)])
def test_slopes_are_those_of_the_work(name, step):
    """Of what moves the patch along the wheel, tilts it, and makes it larger: against the work solved anew."""
    ground, k = straight_line(), NAMES.index(name)
    p, n = places(np.linspace(-0.009, 0.009, 19), [0.015, 0.025])
    sd = np.zeros(len(THETA))
    sd[k] = step
    h, slopes = ground.pattern(THETA, sd, p, n)
    assert h == pytest.approx(ground.work(THETA, p, n))
    there, back = THETA.copy(), THETA.copy()
    there[k] += step
    back[k] -= step
    wanted = (ground.work(there, p, n) - ground.work(back, p, n)) / (2 * step)
    assert np.abs(wanted).max() * step > 0.005 * h.max()
    # A patch grows by whole cells: single points are off by some, all together not.
    assert slopes[:, k] @ wanted == pytest.approx(wanted @ wanted, rel=0.2)
    assert np.corrcoef(slopes[:, k], wanted)[0, 1] > 0.6


def open_state():
    """What a force log leaves open of the blade's place, the wheel's axis and the cover."""
    state = last_state(wearing_cell(calibration=False).cell)
    wide = {"blade_x": 5e-4, "blade_a": 1e-3, "wheel_axis_v": 2e-3, "cover_stiffness_scale": 0.15}
    sd = np.array([wide.get(name, 1e-6) for name in state.names])
    return replace(state, covariance=np.diag(sd**2)), wide


def measured(ground: GroundLog, theta: np.ndarray, count: int = 150, seed: int = 3) -> MeasuredDepths:
    rng = np.random.default_rng(seed)
    p = np.column_stack([rng.uniform(-8e-3, 8e-3, count), np.full(count, 0.03), rng.uniform(0.0, LENGTH, count)])
    depth = 1e-11 * ground.work(theta, p, np.tile([0.0, 1.0, 0.0], (count, 1))) + 5e-7 * rng.normal(size=count)
    return MeasuredDepths(Path("removal.csv"), p, depth, np.full(count, 5e-7), tuple(range(2, count + 2)))


def test_a_blade_that_sits_aside_is_found_where_it_is():
    """Planted: 0.6 mm along the wheel's axis, the axis turned, a softer cover; the pattern is met, the state within its sigma."""
    state, wide = open_state()
    ground, true = straight_line(), THETA.copy()
    for name, size in (("blade_x", 6e-4), ("wheel_axis_v", -2.5e-3), ("cover_stiffness_scale", -0.15)):
        true[NAMES.index(name)] += size
    removal = measured(ground, true)
    n = np.tile([0.0, 1.0, 0.0], (len(removal.p), 1))
    fit = fit_pattern(ground, state, THETA, removal, removal.p, n)
    before, after = fit.scatter
    assert before > 1.5 * after and after < 1.0 and fit.preston.value == pytest.approx(1e-11, rel=0.03)
    found = dict(
        zip(fit.calibration.names, zip(fit.calibration.values, fit.calibration.standard_deviation, strict=True), strict=True)
    )
    for name in wide:
        value, sd = found[name]
        assert abs(value - true[NAMES.index(name)]) < 3.5 * sd and sd <= 1.01 * wide[name]
    assert found["cover_stiffness_scale"][1] < 0.5 * wide["cover_stiffness_scale"]
    there = THETA.copy()
    for name in wide:
        there[NAMES.index(name)] = found[name][0]
    n, p = n[:40], removal.p[:40]
    off = ground.work(there, p, n) / ground.work(true, p, n).max() - ground.work(true, p, n) / ground.work(true, p, n).max()
    assert np.sqrt(np.mean(off**2)) < 0.02


def test_depths_of_another_blade_are_refused():
    state, _ = open_state()
    ground = straight_line()
    removal = measured(ground, THETA)
    rng = np.random.default_rng(1)
    other = replace(removal, depth=removal.depth * rng.uniform(0.2, 3.0, len(removal.depth)))
    with pytest.raises(Infeasible, match=r"removal.csv: depths scatter .* give the depths of the blade that the log is of"):
        fit_pattern(ground, state, THETA, other, other.p, np.tile([0.0, 1.0, 0.0], (len(other.p), 1)))
