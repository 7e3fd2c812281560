"""Thirty blades in a row on one virtual cell that wears: `python -m benchmarks.next_blades [--blades 30] [--seed 0]`.

Tracker campaign and force ladder once, as in ocp.experiments; then each blade is planned (joints that hold 20 N, the feed that
takes off DEPTH by Preston's coefficient as known), ground on the virtual cell, logged, and the step of `ocp.update` gives the
cell for the next. On every tenth blade depths are measured. Beside it the same blades, wear and drift with the first plan
throughout. True force and true depth of every blade are judged on all its passes; the virtual cell shares no code with the
planner, and its footprint is that of its own rubber. What it does to the cell from blade to blade (`drifted`) is not the
update's process model.

Prints every blade, then the figures of docs/process.md.
"""

import argparse
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from ocp.calibrate.force.fit import BIAS
from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.model import ForceModel, ForceRows
from ocp.calibrate.force.rows import ForceSetup
from ocp.data import CELL
from ocp.experiments.grinding import Course, Rung, VirtualRobot, compensated, contact_moments, lay_course, registered_by_ladder
from ocp.experiments.trial import measured_positions
from ocp.model.cell import Cell, read_cell
from ocp.model.prepare import wheel_cover
from ocp.plan.passes.optimise import SolvedPass
from ocp.plan.paths import surface_cloud
from ocp.shell.progress import Phases
from ocp.simulate.twin.arm import make_arm
from ocp.simulate.twin.contact.grinder import ContactPatches, make_grinder
from ocp.simulate.twin.contact.sensor import read_sensor
from ocp.simulate.twin.planting import Planted
from ocp.simulate.twin.truth import Truth, draw_truth
from ocp.update.history import History, history_of
from ocp.update.interface import updated
from ocp.update.pattern import GroundLog
from ocp.update.removal import UNIT, MeasuredDepths
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.blade import find_shape

PERIOD, CONTACT = 240.0, 70.0  # s of a blade on the wheel's clock, s of it in contact (thirty lines)
WEAR = 1.5e-7  # m/s of the wheel's clock, the middle of the catalogue's range; a fresh belt loses half as much again
PRESTON, DULLING = 10e-12, 0.25  # 1/Pa of the new belt; share that an hour in contact takes of it
DEPTH, DEPTH_SD = 20e-6, 0.7e-6  # m wanted under the lines, m of the instrument
CLOSE, DEEP = 0.5, 0.10  # N and share of the depth that issue 16 asks for


@dataclass(frozen=True)
class Blade:
    """One ground blade, updated or not: true mean, least and largest force N, mean and largest error of the depth as a share."""

    mean: float
    least: float
    most: float
    depth: float
    worst_depth: float


@dataclass(frozen=True)
class Pressed:
    """True force (n,) N of a pass, and its pressure per newton under the planned point along the feed (n,) 1/m."""

    force: Array
    under: Array


def drifted(truth: Truth, k: int, rng: np.random.Generator) -> tuple[Truth, float]:
    """The machine at the beginning of blade k, and Preston's coefficient 1/Pa then: the wheel is worn, the hall warms and cools,
    the blade sits in its holder twice as loosely as the update believes, pressure and sensor wander, the belt dulls."""
    begin = k * PERIOD
    early = 0.5 * WEAR * 1800.0 * (1 - np.exp(-begin / 1800.0))
    warm = np.array([4e-5, 0.0, 2e-5]) * np.sin(2 * np.pi * begin / 9000.0)
    hour = np.sqrt(PERIOD / 3600.0)
    moved = replace(
        truth,
        wheel_radius=-(WEAR * begin + early),
        wheel_shift=truth.wheel_shift + warm,
        blade_shift=truth.blade_shift + 2e-5 * rng.normal(size=3),
        blade_turn=truth.blade_turn + 1e-4 * rng.normal(size=3),
        flange_offset=truth.flange_offset + 0.05 * hour * np.sqrt(k) * rng.normal(),
        sensor_bias=truth.sensor_bias + 0.1 * hour * np.sqrt(k) * rng.normal(),
        effects=(Planted("wheel_wear", None, {"m_per_s": WEAR}),),
    )
    return moved, PRESTON * float(np.exp(-DULLING * k * CONTACT / 3600.0) * (1 + 0.01 * rng.normal()))


def ground(course: Course, truth: Truth, arm, solved: list[SolvedPass], begin: float, rng) -> tuple[list, list[Pressed]]:
    """The blade's passes: moments of contact with readings, and what truly presses, pass by pass; then one in the air."""
    machine = VirtualRobot(truth, arm, make_grinder(course.cell, truth, course.blade))
    rungs = [*(Rung(one, course.cell.process.force) for one in solved), Rung(solved[0], course.cell.process.force, contact=False)]
    parts, true = [], []
    for k, rung in enumerate(rungs):
        asked = contact_moments(course, machine, rung, k)
        at = asked.time_s + k * PERIOD / len(rungs)
        result = machine.grinder.force(replace(asked, clock_s=at))
        reading, _ = read_sensor(truth, result, asked, rng)
        parts.append((rung, replace(asked, clock_s=begin + at), reading))
        if rung.contact:
            true.append(Pressed(result.force, under_the_point(machine.grinder.patches(asked), asked.t)))
    return parts, true


def logged(course: Course, parts: list) -> tuple[ForceLog, ForceRows]:
    """What a logger records of it, and the model's rows."""

    def joined(name: str) -> Array:
        return np.concatenate([getattr(moments, name) for _, moments, _ in parts])

    q = np.concatenate([rung.solved.solution.q for rung, _, _ in parts])
    n, contact = len(q), joined("contact").astype(bool)
    log = ForceLog(
        path=Path("force.csv"),
        run=joined("run").astype(np.int64),
        runs=tuple(map(str, range(len(parts)))),
        time=joined("time_s"),
        q=q,
        fn=np.concatenate([reading for _, _, reading in parts]),
        contact=contact,
        session=np.zeros(n, np.int64),
        sessions=("",),
        row=np.arange(2, n + 2),
        clock=joined("clock_s"),
        **{name: joined(name) for name in ("p", "n", "t", "s", "setpoint", "feed", "belt")},
    )
    waypoint = np.vstack([rung.solved.problem.waypoints for rung, _, _ in parts])
    return log, ForceRows(q, waypoint, joined("setpoint"), np.sign(joined("belt")), contact)


def under_the_point(patches: ContactPatches, t: Array) -> Array:
    """The pressure per newton under the planned points (n,), integrated along the feed directions t (n, 3): 1/m."""
    cell = np.array([patches.x[1] - patches.x[0], patches.y[1] - patches.y[0]])
    way = np.arange(-patches.reach, patches.reach, 0.25 * cell.min())
    heading = np.stack([np.sum(t * axis, axis=1) for axis in (patches.along, patches.across)], axis=1)
    place = (patches.planned[:, None] + way[:, None] * heading[:, None] - [patches.x[0], patches.y[0]]) / cell
    which = np.broadcast_to(patches.which[:, None], place.shape[:2])
    share = map_coordinates(patches.share, [which, place[..., 0], place[..., 1]], order=1, mode="grid-constant")
    return np.asarray(share.sum(axis=1) * (way[1] - way[0]) / cell.prod())


def made_depth(course: Course, solved: list[SolvedPass], pressed: list[Pressed], preston: float, faster: float) -> Array:
    """True depth (n,) m under the waypoints, ends left out, at feeds `faster` times the paths': Preston's law on the pressure of
    the virtual cell's own contact."""
    parts = zip(solved, pressed, strict=True)
    depth = [preston * course.cell.wheel.belt_speed / (faster * a.problem.path.feed) * b.force * b.under for a, b in parts]
    return np.concatenate([one[2:-2] for one in depth])


def judged(pressed: list[Pressed], depth: Array, wanted: Array) -> Blade:
    force, off = np.concatenate([one.force[2:-2] for one in pressed]), depth / wanted - 1.0
    return Blade(float(force.mean()), float(force.min()), float(force.max()), float(off.mean()), float(np.abs(off).max()))


def start(course: Course, seed: int) -> tuple[Truth, object, Calibration, np.random.Generator]:
    """Truth, arm, the calibration by tracker campaign and force ladder."""
    rng = np.random.default_rng([seed, 16])
    truth = draw_truth(course.cell, seed)
    arm = make_arm(course.cell, truth)
    with tempfile.TemporaryDirectory() as folder:
        _, calibration, _ = measured_positions(course.cell, truth, arm, 40, Path(folder))
    machine = VirtualRobot(truth, arm, make_grinder(course.cell, truth, course.blade))
    return truth, arm, registered_by_ladder(course, machine, calibration, "flange", rng), rng


def expected_work(course: Course, cell: Cell, log: ForceLog, rows: ForceRows, solution) -> Array:
    """The planner's h under the waypoints (Pa m, ends left out) at 20 N and the paths' feeds."""
    inside = np.concatenate([np.flatnonzero(log.run == k)[2:-2] for k in range(len(course.paths))])
    shape = find_shape(course.blade, cell.workpiece.aerofoil)
    model, even = ForceModel(course.cell, course.law), np.full(len(log), cell.process.force)
    ground = GroundLog(model, rows, log, even, wheel_cover(course.cell), surface_cloud(shape, course.blade))
    return ground.work(solution.x[:BIAS], log.p[inside], log.n[inside])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blades", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=10, help="removal is measured on every so many blades")
    asked = parser.parse_args()
    course = lay_course(read_cell(CELL), "flange", Phases())
    every = list(range(len(course.paths)))
    truth, arm, calibration, rng = start(course, asked.seed)
    cell, model = replace(course.cell, calibration=calibration), ForceModel(replace(course.cell, calibration=None), course.law)
    first = solved = compensated(course, calibration, every)
    known, first_feed, kept, left = 0.7 * PRESTON, 1.0, [], []  # before the first measurement the coefficient is a guess
    said: list[str] = []
    for k in range(asked.blades):
        now, preston = drifted(truth, k, np.random.default_rng([asked.seed, 17, k]))
        parts, forces = ground(course, now, arm, solved, k * PERIOD, rng)
        _, old_forces = ground(course, now, arm, first, k * PERIOD, np.random.default_rng(k))
        log, rows = logged(course, parts)
        # The planner's footprints at the postures that are ground give the feed, with the coefficient as known.
        history = history_of(cell.calibration, CELL) if k else History()
        work = updated(cell, log, ForceSetup(model, (rows,), ()), history, f"footprints {k}")
        h = expected_work(course, cell, log, rows, work.fit.solution)
        feed = known * h.mean() / DEPTH
        if k == 0:
            first_h = h
        depth = made_depth(course, solved, forces, preston, feed)
        old_depth = made_depth(course, first, old_forces, preston, first_feed)
        if k:  # the first blade finds the coefficient, it does not use it
            kept.append(judged(forces, depth, DEPTH * h / h.mean()))
            left.append(judged(old_forces, old_depth, DEPTH * first_h / first_h.mean()))
        slower = replace(log, feed=None, time=log.time / feed)
        removal = None
        if k % asked.every == 0:
            inside = np.concatenate([np.flatnonzero(log.run == run)[2:-2] for run in every])[::3]
            reading = depth[::3] + DEPTH_SD * rng.normal(size=len(inside))
            removal = MeasuredDepths(
                Path("removal.csv"), log.p[inside], reading, np.full(len(inside), DEPTH_SD), tuple(range(len(inside)))
            )
        setup, history = ForceSetup(model, (rows,), ()), history_of(cell.calibration, CELL)
        try:
            made = updated(cell, slower, setup, history, f"log {k}", (), removal)
        except Infeasible as error:
            said.append(f"blade {k + 1}: {error}")
            continue
        assert made.preston is not None
        process = replace(cell.process, preston=made.preston.value, preston_sd=made.preston.sd)
        cell = replace(cell, calibration=made.states[3], process=process)
        known = made.preston.value
        first_feed = known * first_h.mean() / DEPTH if k == 0 else first_feed
        solved = compensated(course, cell.calibration, every)
        latest = made.latest
        print(
            f"{k + 1:3d} | R {latest['radius_um']:7.0f} ({1e6 * now.wheel_radius:7.0f}) um, {latest['wear_um_per_h']:5.0f} um/h",
            f"| k_p {latest['preston']:.2f} +- {latest['preston_sd']:.2f} ({preston / UNIT:.2f})",
            *(f"| {b.mean:.2f} N {b.least:.1f}..{b.most:.1f}, depth {b.depth:+.1%}" for b in kept[-1:] + left[-1:]),
            flush=True,
        )
    print(table(kept, left), *said, sep="\n")


def table(kept: list[Blade], left: list[Blade]) -> str:
    """The summary in Markdown."""
    rows = ["| blades 2 on | with updates | without |", "|---|---|---|"]

    def row(name: str, figure) -> None:
        rows.append(f"| {name} | {figure(kept)} | {figure(left)} |")

    row("mean force of a blade, least .. largest, N", lambda b: f"{min(x.mean for x in b):.2f} .. {max(x.mean for x in b):.2f}")
    row("force at any working point, N", lambda b: f"{min(x.least for x in b):.1f} .. {max(x.most for x in b):.1f}")
    row(f"blades within {CLOSE} N on average", lambda b: f"{np.mean([abs(x.mean - 20) < CLOSE for x in b]):.0%}")
    row("mean depth of a blade over wanted", lambda b: f"{min(x.depth for x in b):+.1%} .. {max(x.depth for x in b):+.1%}")
    row(f"blades within {DEEP:.0%} in depth on average", lambda b: f"{np.mean([abs(x.depth) < DEEP for x in b]):.0%}")
    row("largest error of depth at any point", lambda b: f"{max(x.worst_depth for x in b):.0%}")
    return "\n".join(rows)


if __name__ == "__main__":
    main()
