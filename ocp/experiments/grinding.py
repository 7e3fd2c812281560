"""Grinding by virtual robots: what they share, what planned joints bring about, the ladder that registers wheel and blade.

All share the cell with one kind of mount, passes for the ladder and for the test, what gives way. The ladder's passes register
wheel and blade, the test's hold the working points: no force is judged where it was fitted. The robot, its mount and the contact
are `ocp.simulate.twin`'s; the fit of the ladder is that of `ocp.calibrate --force`.
"""

from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.model import ForceModel, ForceRows
from ocp.calibrate.force.registration import fit_force
from ocp.calibrate.force.rows import ForceSetup
from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.law import WheelLaw
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell, with_calibration
from ocp.model.prepare import prepare_contact
from ocp.model.theta import believed_theta, registered, with_effects
from ocp.plan.clearance import CollisionScene
from ocp.plan.passes.optimise import Ground, PassWorker, SolvedPass
from ocp.plan.passes.posture import Seed, find_seeds
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.shell.progress import Phases
from ocp.simulate.twin.arm import VirtualArm, arm_moments
from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.contact.grinder import Grinder
from ocp.simulate.twin.contact.sensor import read_sensor
from ocp.simulate.twin.contact.table import PlannedLines, Tables, make_tables, place_stations
from ocp.simulate.twin.contact.wheel_and_blade import solid_compliance
from ocp.simulate.twin.truth import Truth
from robots.calibration.store import Calibration
from robots.errors import BadInput
from robots.kinematics import jacobian
from robots.pose import Array
from trajectories.blade import Blade
from trajectories.passes import BladePath

STEP = 4e-3  # m between waypoints: forces vary slowly along a pass
FINE_STEP = 1e-3  # m: dense enough for the virtual contact to place its own stations
POINTS = 20  # working points, PHYSICS 5
MOUNTS = ("flange", "rigid")


@dataclass(frozen=True, eq=False)
class Course:
    """A cell with one mount and its passes: those of the ladder first (`ladder` of them), then those of the test.

    seeds and compliance (n, 3) m/N of every pass; law and cover of the wheel as believed; `compiled`: its passes are solved by
    machine code that is made for it, which pays from a second robot on.
    """

    cell: Cell
    blade: Blade
    cloud: SurfaceCloud
    beside: Array
    law: WheelLaw
    cover: Cover
    paths: list[BladePath]
    seeds: list[list[Seed]]
    compliance: list[Array]
    ladder: int
    compiled: bool = False

    @property
    def tested(self) -> list[int]:
        """Passes that hold the working points."""
        return list(range(self.ladder, len(self.paths)))


def lay_course(cell: Cell, mount: str, phases: Phases) -> Course:
    """Passes of `cell` on its flange ("flange") or without one ("rigid"), the calibration of the cell left out.

    Raises BadInput: no blade, no flange for the flange's course; Infeasible: passes out of reach.
    """
    stl = cell.workpiece.stl
    if stl is None:
        raise BadInput(f"{cell.path}: no blade; name it as workpiece.stl")
    if mount == "flange" and cell.flange is None:
        raise BadInput(f"{cell.path}: no [force_flange]; the flange's experiment needs it, or run with --mount rigid")
    cell = replace(cell, calibration=None, flange=cell.flange if mount == "flange" else None)
    cell, _ = registered(cell)
    laid = lay_paths(cell, stl, PlanOptions(step=STEP, even=False))
    contact = prepare_contact(cell, laid.blade, laid.paths, phases)
    chosen = _spread(laid.paths)
    paths = [laid.paths[k] for k in chosen]
    with phases.phase(f"postures, {mount}"):
        seeds = find_seeds(cell, CollisionScene(cell, laid.blade.vertices), contact.law, paths)
    compliance = [np.asarray(contact.compliance.per_pass[k]) for k in chosen]
    return Course(
        cell, laid.blade, laid.cloud, laid.beside, contact.law, contact.cover, paths, seeds, compliance, len(chosen) // 2
    )


def _spread(paths: list[BladePath]) -> list[int]:
    """Of each side a pass in the first half for the ladder and one in the second for the test; ladder passes first."""
    sides = list(dict.fromkeys(path.side for path in paths))
    ladder, test = [], []
    for side in sides:
        of_side = [k for k, path in enumerate(paths) if path.side == side]
        ladder.append(of_side[len(of_side) // 4])
        test.append(of_side[(3 * len(of_side)) // 4])
    return ladder + test


def compensated(course: Course, calibration: Calibration | None, which: list[int]) -> list[SolvedPass]:
    """Joints that hold the process force on passes `which`, as the planner finds them with this calibration, where the full force
    bears.

    The planner's preference for postures of less uncertain force is left out. A calibrated stiffness scales forces of the wheel's
    law and of the cover exactly, so that neither is made anew. Raises Infeasible where a pass has no sound solution.
    """
    calibrated = with_calibration(course.cell, calibration)
    cell, _ = registered(calibrated)
    theta = with_effects(calibrated, believed_theta(calibrated))  # what is registered stays in theta: one model serves all
    softer = course.cover.softer(cell.wheel.cover_modulus)
    law = replace(course.law, geometry=replace(course.law.geometry, modulus=cell.wheel.cover_modulus))
    ground = Ground(cell, theta, ObjectiveWeights(), law, softer, course.blade.vertices, course.cloud, course.beside)
    worker = PassWorker(ground, _solver(course).other(cell, law, theta))
    solved = (worker.solve(course.paths[k], course.seeds[k], course.compliance[k]) for k in which)
    return [one.grinding() for one in solved]


@cache
def _solver(course: Course) -> PassSolver:
    """The solver of a course's cell for whatever calibration."""
    theta = with_effects(course.cell, believed_theta(course.cell))
    solver = PassSolver(course.cell, course.law, theta, ObjectiveWeights(), folded=False)
    if course.compiled:
        solver.compile()
    return solver


@dataclass(frozen=True, eq=False)
class VirtualContact:
    """Of wheel and blade, as all robots have it: the lines that passes lie on, and what is solved of the contact there."""

    lines: PlannedLines
    tables: Tables


def virtual_contact(course: Course) -> VirtualContact:
    """The contact along the passes of a course, with the blade's compliance solved; of both mounts, which have the same lines."""
    stl = course.cell.workpiece.stl
    assert stl is not None
    fine = lay_paths(course.cell, stl, PlanOptions(step=FINE_STEP, even=False)).paths
    numbers = {path.line for path in course.paths}
    paths = [path for path in fine if path.line in numbers]
    line = np.concatenate([np.full(len(path.s), path.line, np.int64) for path in paths])
    lines = PlannedLines(line, *(np.concatenate([getattr(path, name) for path in paths]) for name in ("s", "p", "n", "t")))
    tables = make_tables(course.cell, course.blade)
    stations = place_stations(lines, np.arange(len(line)), lines.s)
    tables.compliance(stations, partial(solid_compliance, course.cell.workpiece, course.blade, stations))
    return VirtualContact(lines, tables)


def working_points(solved: list[SolvedPass]) -> list[Array]:
    """Waypoints (indices) of each pass: `POINTS` in all, evenly spread over the passes, their ends left out."""
    each = [len(part) for part in np.array_split(np.arange(POINTS), len(solved))]
    return [np.round(np.linspace(1, len(s.problem.path.s) - 2, n)).astype(int) for s, n in zip(solved, each, strict=True)]


LADDER = (0.7, 1.0, 1.3)  # of the process force
LEADS = 8  # steps in which a rigid mount is led to the wheel
LEAD = 1.5e-4  # m, the longest of them


@dataclass(frozen=True)
class VirtualRobot:
    """A virtual robot at work: what it is, its arm, its grinding contact."""

    truth: Truth
    arm: VirtualArm
    grinder: Grinder


def working_forces(
    course: Course, machine: VirtualRobot, solved: list[SolvedPass], rng: np.random.Generator
) -> tuple[Array, Array]:
    """True and read force N at the working points of the tested passes, one after the other."""
    true, read = [], []
    for one, points in zip(solved, working_points(solved), strict=True):
        asked = contact_moments(course, machine, Rung(one, course.cell.process.force))
        result = machine.grinder.force(asked)
        reading, _ = read_sensor(machine.truth, result, asked, rng)
        true.append(result.force[points])
        read.append(reading[points])
    return np.concatenate(true), np.concatenate(read)


@dataclass(frozen=True)
class Rung:
    """A pass that is driven: its joints and points, setpoint N of the flange, in contact or not, belt over the cell's."""

    solved: SolvedPass
    setpoint: float
    contact: bool = True
    belt: float = 1.0


def contact_moments(course: Course, machine: VirtualRobot, rung: Rung, run: int = 0) -> ContactMoments:
    """The waypoints of a pass as instants of the virtual machine."""
    path, q = rung.solved.problem.path, rung.solved.solution.q
    n = len(q)
    time = np.concatenate([[0.0], np.cumsum(rung.solved.problem.seconds)])
    approach = np.sign(np.gradient(q, axis=0))
    cold = np.full(n, course.cell.tables.reference_temperature_C)
    still = arm_moments(q, course.cell.tables.hanging or "", cold, approach, time, visit=np.zeros(n, np.int64))
    return ContactMoments(
        T_base_flange=machine.arm.flange(still),
        arm_compliance=machine.arm.compliance(still),
        line=np.full(n, path.line),
        setpoint=np.full(n, rung.setpoint),
        belt=np.full(n, rung.belt * course.cell.wheel.belt_speed),
        contact=np.full(n, rung.contact),
        clock_s=time,
        time_s=time,
        run=np.full(n, run),
        ground_before=np.zeros(n),
        wheel_temperature_C=cold,
        temperature_C=cold,
        **{name: getattr(path, name) for name in ("p", "n", "t", "s", "feed")},
    )


def registered_by_ladder(
    course: Course, machine: VirtualRobot, arm: Calibration, mount: str, rng: np.random.Generator, noise: bool = True
) -> Calibration:
    """The calibration `arm` joined with what a force ladder on the ladder's passes says of wheel, blade and mount.

    Three forces, an air run and a run with the belt reversed. The flange has its setpoint stepped; a rigid mount is led to
    the wheel at every waypoint until the sensor shows the force, as nobody would trust it to programmed overlaps before.
    """
    rungs = _ladder(course, machine, arm, mount)
    log, rows = _log(course, machine, rungs, rng, noise)
    model = ForceModel(replace(with_calibration(course.cell, arm), calibration=None), course.law)
    return fit_force(model.cell, log, arm, ForceSetup(model, (rows,), ())).calibration(arm)


def _ladder(course: Course, machine: VirtualRobot, calibration: Calibration, mount: str) -> list[Rung]:
    """Recordings: each pass at each force, one of them in the air, one with the belt running back."""
    force = course.cell.process.force
    level = compensated(course, calibration, list(range(course.ladder)))
    if mount == "flange":
        rungs = [Rung(s, share * force) for share in LADDER for s in level]
    else:
        rungs = [Rung(_led(course, machine, s, share * force), force) for share in LADDER for s in level]
    again = rungs[len(level) : 2 * len(level)]
    return [*rungs, replace(again[0], contact=False), replace(again[-1], belt=-1.0)]


def _led(course: Course, machine: VirtualRobot, solved: SolvedPass, wanted: float) -> SolvedPass:
    """The pass with its joints led along the contact normal until every waypoint shows `wanted` N, in nominal coordinates."""
    model = solved.evaluation
    n = np.einsum("kij,kj->ki", model.T_base_blade[:, :3, :3], solved.problem.path.n)
    shown = solved
    for _ in range(LEADS):
        force = machine.grinder.force(contact_moments(course, machine, Rung(shown, course.cell.process.force))).force
        step = np.clip((wanted - force) / model.stiffness, -LEAD, LEAD)
        q = shown.solution.q
        twist = np.concatenate([step[:, None] * n, np.zeros((len(q), 3))], axis=1)
        moved = np.linalg.solve(jacobian(course.cell.robot, q), twist[..., None])[..., 0]
        shown = replace(shown, solution=replace(shown.solution, q=q + moved))
    return shown


def _log(
    course: Course, machine: VirtualRobot, rungs: list[Rung], rng: np.random.Generator, noise: bool
) -> tuple[ForceLog, ForceRows]:
    """What a logger records of the rungs, and the model's rows for it."""
    # Without noise a hundred recordings' mean would be read.
    sensor = machine.truth if noise else replace(machine.truth, sensor_sigma=0.1 * machine.truth.sensor_sigma)
    parts = [contact_moments(course, machine, rung, k) for k, rung in enumerate(rungs)]
    read = [read_sensor(sensor, machine.grinder.force(asked), asked, rng) for asked in parts]
    fn, ft = (np.concatenate(values) for values in zip(*read, strict=True))

    def joined(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts])

    q = np.concatenate([rung.solved.solution.q for rung in rungs])
    n = len(q)
    run, contact = joined("run").astype(np.int64), joined("contact").astype(bool)
    log = ForceLog(
        path=Path("force ladder"),
        run=run,
        runs=tuple(str(k) for k in range(len(rungs))),
        time=joined("time_s"),
        q=q,
        fn=fn,
        contact=contact,
        session=np.zeros(n, np.int64),
        sessions=("",),
        ft=ft,
        line=joined("line").astype(np.int64),
        ground_before=np.zeros(n, np.int64),
        row=np.arange(2, n + 2),
        notices=(),
        **{name: joined(name) for name in ("p", "n", "t", "s", "setpoint", "feed", "belt")},
    )
    waypoint = np.vstack([rung.solved.problem.waypoints for rung in rungs])
    return log, ForceRows(q, waypoint, joined("setpoint"), np.sign(joined("belt")), contact)
