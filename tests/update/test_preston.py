"""Preston's coefficient from measured depths: the work that a log did at a point, the fit, the doubt that grows without it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ocp.update.removal as removal_module
from ocp.calibrate.force.fit import force_prior, solve_force_log
from ocp.plan.removal.footprint import CELL, LinePatches
from ocp.update.removal import (
    DEPTH_MODEL,
    HOURLY,
    UNIT,
    MeasuredDepths,
    Preston,
    joined_preston,
    less_sure,
    preston_from,
    read_removal,
    work_at,
)
from robots.errors import BadInput, Infeasible
from tests.support.wearing_cell import NOISE, wearing_cell

A, B = 5e-3, 3.5e-3


def measured(depth: np.ndarray, sd: float = 1e-6) -> MeasuredDepths:
    n = len(depth)
    return MeasuredDepths(Path("removal.csv"), np.zeros((n, 3)), depth, np.full(n, sd), tuple(range(2, n + 2)))


def ellipsoid(*_) -> LinePatches:
    x = CELL * np.arange(-20, 21)
    share = np.sqrt(np.maximum(1 - (x[:, None] / A) ** 2 - (x[None, :] / B) ** 2, 0.0))
    return LinePatches(np.array([0.0]), x, share[None] / (share.sum() * CELL**2), np.array([20.0]), np.array([3e-4]))


def straight_line():
    """A log of one straight pass along z at 40 mm/s under 20 N, and a solution that reads it."""
    world = wearing_cell()
    n, feed = 121, 0.04
    s = np.linspace(0.0, 0.06, n)
    log = replace(
        world.log.take(np.zeros(n, np.int64)),
        run=np.zeros(n, np.int64),
        time=s / feed,
        p=np.column_stack([0 * s, 0 * s + 0.03, s]),
        n=np.tile([0.0, 1.0, 0.0], (n, 1)),
        t=np.tile([0.0, 0.0, 1.0], (n, 1)),
    )
    rows = world.rows.take(np.zeros(n, np.int64))
    read = 20.0 + NOISE * np.random.default_rng(1).normal(size=n)
    solution = solve_force_log(world.model, rows, replace(log, fn=read), force_prior(world.cell))
    flat = replace(solution, reading=np.full(n, 20.0), x=np.append(solution.x[:-1], 0.0))
    return world, rows, log, flat, feed


def test_the_work_under_a_line_is_prestons_integral(monkeypatch):
    """h = F V / v times the profile across; a parabola of half-width B under Hertz's pressure (docs/process.md)."""
    monkeypatch.setattr(removal_module, "_patches", ellipsoid)
    world, rows, log, solution, feed = straight_line()
    across = np.linspace(-1.2 * B, 1.2 * B, 25)
    p = np.column_stack([across, np.full(25, 0.03), np.full(25, 0.03)])
    p = np.vstack([p, [0.0, 0.03, -0.02], [0.0, 0.028, 0.03]])  # beyond the end; under the other side of a thin blade
    n = np.tile([0.0, 1.0, 0.0], (27, 1))
    n[-1] *= -1
    h = work_at(world.cell, world.model, rows, log, solution, p, n)
    speed = world.cell.wheel.belt_speed - feed  # the blade runs with the belt
    wanted = 20.0 * speed / feed * 0.75 / B * np.maximum(1 - (across / B) ** 2, 0.0)
    assert h[:25] == pytest.approx(wanted, abs=0.05 * wanted.max())
    assert h[25] == 0 and h[26] == 0


def test_the_work_of_a_real_contact_adds_up():
    """Without any stand-in: over the blade the work is force times sliding way, whatever the patch's shape."""
    world, rows, log, solution, feed = straight_line()
    across, along = np.linspace(-0.012, 0.012, 61), np.linspace(-0.01, 0.07, 41)
    grid = np.stack(np.meshgrid(across, along, indexing="ij"), axis=-1).reshape(-1, 2)
    p = np.column_stack([grid[:, 0], np.full(len(grid), 0.03), grid[:, 1]])
    n = np.tile([0.0, 1.0, 0.0], (len(grid), 1))
    h = work_at(world.cell, world.model, rows, log, solution, p, n)
    cell = (across[1] - across[0]) * (along[1] - along[0])
    assert h.sum() * cell == pytest.approx(20.0 * (world.cell.wheel.belt_speed - feed) * 0.06 / feed, rel=0.02)


def test_the_coefficient_comes_back_with_its_doubt():
    rng, off = np.random.default_rng(3), []
    h = rng.uniform(1e6, 3e6, 30)
    for _ in range(60):
        depth = 1e-11 * h * (1 + DEPTH_MODEL * rng.normal(size=30)) + 1e-6 * rng.normal(size=30)
        found = preston_from(measured(depth), h)
        off.append((found.value - 1e-11) / found.sd)
    assert np.std(off) == pytest.approx(1.0, abs=0.35) and abs(np.mean(off)) < 0.5
    assert found.points == 30 and found.sd < 0.02 * found.value


def test_points_beside_the_lines_are_left_out():
    h = np.array([2e6, 2e6, 1e5, 0.0])
    found = preston_from(measured(1e-11 * h + np.array([0, 0, 5e-6, 5e-6])), h)
    assert found.value == pytest.approx(1e-11) and (found.points, found.left_out) == (2, 2)


@pytest.mark.parametrize(("depth", "h", "said"), [(2e-5, 0.0, "no point lies where"), (1e-7, 1e6, "do not differ from zero")])
def test_what_tells_no_coefficient_is_said(depth, h, said):
    with pytest.raises(Infeasible, match=said):
        preston_from(measured(np.full(3, depth)), np.full(3, h))


def test_without_a_measurement_doubt_grows_with_contact():
    known = Preston(1e-11, 2e-13)
    assert less_sure(known, 0.0, False).sd == pytest.approx(known.sd)
    hour, four = (less_sure(known, s, False).sd / known.value for s in (3600.0, 4 * 3600.0))
    assert hour == pytest.approx(np.hypot(0.02, HOURLY)) and four == pytest.approx(np.hypot(0.02, 2 * HOURLY))
    assert less_sure(known, 0.0, True).sd > 0.4 * known.value


def test_measurements_are_weighed_and_contradictions_said():
    known = Preston(1.0e-11, 0.1e-11)
    both = joined_preston(known, Preston(1.1e-11, 0.1e-11, 12))
    assert both.value == pytest.approx(1.05e-11) and both.sd == pytest.approx(0.1e-11 / np.sqrt(2)) and both.points == 12
    assert joined_preston(None, known) == known
    with pytest.raises(Infeasible, match=r"16 by the measured removal, which cannot come from the last, 10 .*--changed belt"):
        joined_preston(known, Preston(16 * UNIT, 0.05e-11))


HEAD = "px_mm,py_mm,pz_mm,removal_um,sd_um\n"


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "no "),
        ("1,2,3,20,0\n", "line 2, column sd_um: 0 must be above 0"),
        ("1,2,3,20,1\n1,2,3,-20,1\n", "line 3, column removal_um: .*negative by more than its error"),
        ("1,2,3,deep,1\n", "line 2, column removal_um: 'deep'"),
        ("1,2,3,nan,1\n", "line 2, column removal_um"),
    ],
)
def test_faulty_depths_are_refused_in_one_sentence(tmp_path, rows, said):
    (tmp_path / "removal.csv").write_text(HEAD + rows)
    with pytest.raises(BadInput, match=said):
        read_removal(tmp_path / "removal.csv")
