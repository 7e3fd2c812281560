"""Passes from the air to the air: the contact's curve in time, windows and their figures, what is taken off the blade."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from ocp.simulate.twin.contact.flange_motion import MovedLane
from ocp.simulate.twin.contact.grinder import ContactPatches
from ocp.simulate.twin.controller import Track
from ocp.simulate.twin.plan_knowledge import AWAY, GRINDING, NEAR, Matched
from ocp.simulate.twin.rehearsal import ground_depth
from ocp.simulate.twin.touching import Touching, TouchWindows, in_balance, in_time, touch, touch_figures, touch_windows
from tests.support.twin_grinding import FEED, HERTZ_RATE, Bench, believed, moments
from trajectories.blade import Blade

Array = np.ndarray
DT = 1 / HERTZ_RATE


def matched(run: Array, phase: Array, line: Array, force: float = 20.0, **changes) -> Matched:
    n = len(run)
    s = np.where(run >= 0, FEED * DT * np.arange(n), np.nan)
    p = np.column_stack([np.zeros(n), np.zeros(n), s])
    inside = run >= 0
    of = {name: np.where(inside[:, None], row, np.nan) for name, row in (("n", [0.0, 1, 0]), ("t", [0.0, 0, 1]))}
    made = {"phase": phase, "line": line, "run": run, "p": p, **of, "s": s, "feed": np.where(inside, FEED, np.nan)}
    made |= {
        "force": np.where(inside, force, np.nan),
        "interference": np.zeros(n),
        "planned": inside,
        "setpoint": np.full(n, np.nan),
    }
    return Matched(**made | changes)


def windows(n: int, planned: slice) -> TouchWindows:
    """One pass over n samples, planned on a part of them."""
    run = np.full(n, -1)
    run[planned] = 0
    plan = matched(run, np.where(run < 0, NEAR, GRINDING), np.ones(n, int))
    return TouchWindows(np.arange(n), np.zeros(n, int), run == 0, replace(plan, force=np.full(n, 20.0)))


@pytest.fixture(scope="module")
def bench() -> Bench:
    made = Bench()
    made.cell = replace(made.cell, flange=replace(made.cell.flange, friction=1e-3, carried_mass=1.0))
    return made


@pytest.mark.parametrize(
    "effects",
    [
        (),
        ("wheel_relaxation=0.2,tau=0.5", "flange_stiffness=0.2", "wheel_law=0.05", "belt_tension=2"),
        ("belt_splice=0.6,hz=10",),
    ],
)
def test_a_slow_touch_is_the_one_in_balance(bench, effects):
    """The same curves by two solvers: halved intervals at every instant, steps in time from the air on."""
    n = 400
    way = np.clip(np.arange(n) / 300, 0, 1)
    c = moments(bench.cell, np.linspace(0, 0.01, n), -4.8e-3 + 5.4e-3 * way**2 * (3 - 2 * way))
    grinder = bench.grinder(believed(bench.cell, *effects))
    found, result = touch(grinder, c, windows(n, slice(200, n)), np.zeros((n, 3)))
    still = grinder.force(grinder.in_reach(c))
    assert (found.force == 0).any() and found.force.max() > 15 and (found.still == still.force).all()
    assert found.force == pytest.approx(still.force, abs=0.7)  # the blow of the touch
    assert found.force[-40:] == pytest.approx(still.force[-40:], abs=0.05)
    assert result.stroke[-40:] == pytest.approx(still.stroke[-40:], abs=2e-5)
    assert result.tangential == pytest.approx(grinder.cell.wheel.friction * found.force)


def test_a_cell_that_says_nothing_of_its_flange_is_in_balance(bench):
    c = moments(bench.cell, np.linspace(0, 0.01, 60), np.linspace(-5e-3, 5e-4, 60))
    quiet = replace(bench.grinder(), cell=Bench().cell)
    found, result = touch(quiet, c, windows(60, slice(40, 60)), np.zeros((60, 3)))
    assert (found.force == result.force).all() and (found.most == found.still).all()


def test_windows_reach_from_the_air_to_the_air():
    """Travel, approach, pass, retreat, travel, and the next line: each pass with what is its own, and the ends held."""
    kinds = [(AWAY, -1, 0, 500), (NEAR, -1, 3, 100), (GRINDING, 0, 3, 200), (NEAR, -1, 3, 50), (AWAY, -1, 0, 30)]
    kinds += [(NEAR, -1, 4, 100), (GRINDING, 1, 4, 200), (NEAR, -1, 4, 50)]
    phase, run, line = (np.repeat([k[i] for k in kinds], [k[3] for k in kinds]) for i in range(3))
    n = len(run)
    time = DT * np.arange(n)
    track = Track(time, np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6)), *(np.zeros(n, int),) * 2, (("", 0),), ())
    plan = matched(run, phase, line)
    found = touch_windows(track, plan, np.array([0, 1]))
    first, second = (found.index[found.run == k] for k in (0, 1))
    assert (first[0], first[-1]) == (500 - 250, 850 + 30 - 1) and (second[0], second[-1]) == (850, n - 1)
    assert found.planned.sum() == 400 and (np.diff(first) == 1).all()
    held = found.plan.s[found.run == 0]
    assert held[0] == held[300] == plan.s[600] and held[-1] == plan.s[799]
    assert (found.plan.line[found.run == 1] == 4).all()


def test_stretches_of_one_line_share_what_lies_between_them():
    run = np.repeat([-1, 0, -1, 1, -1], [40, 100, 61, 100, 40])
    n = len(run)
    track = Track(DT * np.arange(n), *(np.zeros((n, 6)),) * 3, *(np.zeros(n, int),) * 2, (("", 0),), ())
    found = touch_windows(track, matched(run, np.where(run < 0, NEAR, GRINDING), np.full(n, 3)), np.array([0, 1]))
    assert (found.index == np.arange(n)).all() and np.sum(found.run == 0) == 40 + 100 + 30


def lane(force: Array, losses: Array) -> MovedLane:
    return MovedLane(force, 0 * force, force, 1.1 * force, (force > 0).astype(float), losses)


def test_figures_tell_contact_outside_bounces_and_overshoot():
    force = np.concatenate([np.zeros(50), np.full(25, 8.0), np.zeros(5), np.full(20, 12.0), np.full(100, 20.0), np.zeros(50)])
    force[110], force[150] = 26.0, 17.0
    losses = np.zeros(250, int)
    losses[[75, 200]] = 1
    of = windows(250, slice(100, 200))
    c = moments(Bench().cell, np.zeros(250), 0.0)
    still = Bench().force(moments(Bench().cell, np.zeros(250), -0.02))
    figures = touch_figures(in_time(of, c, still, [lane(force, losses)]))[0]
    assert figures.outside == pytest.approx(45 * DT) and (figures.losses, figures.line) == (1, 1)
    assert figures.lost == pytest.approx(5 * DT)
    assert (figures.peak, figures.over, figures.under) == pytest.approx((1.1 * 26.0, 6.0, 3.0))
    balanced = touch_figures(in_balance(of, c, replace(still, force=force)))[0]
    assert (balanced.losses, balanced.lost) == pytest.approx((1, 5 * DT)) and balanced.peak == 26.0


def slab() -> Blade:
    """2 mm thin, its upper side at y = 10 mm."""
    box = trimesh.creation.box((0.06, 0.002, 0.12))
    box.apply_translation([0, 0.009, 0])
    return Blade("slab", "slab", box.vertices, box.faces)


def line_of(n: int, x: float = 0.0, force: float = 20.0, twice: float = 1.0) -> tuple[ContactPatches, Touching]:
    """A line along z on the slab's side y = 10 mm, 60 mm long, ellipses 5 mm along and 4 mm across."""
    z = np.linspace(-0.03, 0.03, n)
    ones = np.ones((n, 1))
    p = np.column_stack([x * ones[:, 0], 0.01 * ones[:, 0], z])
    x, y = 2.5e-4 * np.arange(-24, 25), 2.5e-4 * np.arange(-20, 21)
    share = np.sqrt(np.maximum(1 - (x[:, None] / 5e-3) ** 2 - (y / 4e-3) ** 2, 0.0))[None]
    frame = (ones * [0.0, 1, 0], ones * [0.0, 0, 1], ones * [1.0, 0, 0])
    patches = ContactPatches(p, *frame, np.zeros((n, 2)), (share / share.sum()).astype(np.float32), np.zeros(n, int), x, y)
    of = windows(n, slice(0, n))
    plan = replace(of.plan, p=p, s=z - z[0], force=np.full(n, force))
    pressed = np.full(n, force * twice)
    c = moments(Bench().cell, np.zeros(n), 0.0)
    parts = (DT * np.arange(n), pressed, pressed, pressed, np.ones(n), np.zeros(n, int), pressed, 0 * pressed)
    return patches, Touching(replace(of, plan=plan), c, *parts, DT)


def test_what_is_taken_off_is_force_over_time_in_the_patch():
    """A line at F and v takes off F / v an unit of length, as a parabola 3/4 F / (v b) (1 - y^2/b^2) across."""
    patches, touched = line_of(400)
    found = ground_depth(slab(), patches, touched, Bench().cell.process, 20.0)
    asked = replace(Bench().cell.process, removal=2e-5, preston=1e-11)  # what a cell asks for is what depth is told over
    other = ground_depth(slab(), patches, touched, asked, -20.0)
    assert other.unit == pytest.approx(2e-5 / 1e-11 / 20.0)
    np.testing.assert_allclose(other.made * other.unit, found.made * found.unit)
    profile = np.maximum(1 - (found.p[:, 0] / 4e-3) ** 2, 0) * (found.n[:, 1] > 0.9)
    core = np.abs(found.p[:, 2]) < 0.02
    top = np.sum(found.planned[core] * profile[core]) / np.sum(profile[core] ** 2)
    # Over F0 / (v0 h0): 3/4 of the spacing over b, times v0 / v.
    assert top == pytest.approx(0.75 * 6.0 / 4.0 * FEED / (0.06 / 399 / DT), rel=0.02)
    assert found.planned[core] == pytest.approx(top * profile[core], abs=0.04 * top)
    assert (found.planned[found.n[:, 1] < 0.9] == 0).all()  # the other side is as near as the patch is wide
    assert np.abs(found.p[found.asked, 2]).max() <= 0.03 and found.asked.any() and not found.core.any()
    # Twice the force: twice the volume, on a patch that is 2^(1/3) times as wide.
    hard = ground_depth(slab(), *line_of(400, twice=2.0), Bench().cell.process, 20.0)
    assert hard.made @ hard.area == pytest.approx(2 * (hard.planned @ hard.area), rel=0.02)
    assert hard.made.max() == pytest.approx(2 ** (2 / 3) * hard.planned.max(), rel=0.05)


def test_a_wheel_that_stands_still_grinds_deeper_and_lost_contact_less():
    patches, touched = line_of(400)
    mean = touched.mean.copy()
    mean[:5] *= 20.0
    mean[190:210] = 0.0
    found = ground_depth(slab(), patches, replace(touched, mean=mean), Bench().cell.process, 20.0)
    middle = (np.abs(found.p[:, 0]) < 1e-3) & (found.n[:, 1] > 0.9)
    end, gap = middle & (np.abs(found.p[:, 2] + 0.0285) < 1e-3), middle & (np.abs(found.p[:, 2]) < 1e-3)
    change = found.made / np.maximum(found.planned, 1e-9)
    assert change[end].min() > 1.2 and change[gap].max() < 0.7
    figures = found.figures(found.made)
    assert figures["most"] == found.made[found.asked].max() and figures["most_beside"] == found.made[~found.asked].max()
    assert figures["core_within_5"] is None
    place = np.array([[0.0, 0.01, -0.029]])
    assert found.at(place, np.array([[0.0, 1, 0]]))[0] > 0.9 > found.at(place - [0, 0.002, 0], np.array([[0.0, -1, 0]]))[0] == 0
