"""Forces on a virtual robot: what planned joints bring about, and the force ladder that registers wheel and blade.

The robot, its mount and the contact are `ocp.simulate.twin`'s; the fit of the ladder is that of `ocp.calibrate --force`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.model import ForceModel, ForceRows
from ocp.calibrate.force.registration import fit_force
from ocp.calibrate.force.rows import ForceSetup
from ocp.experiments.shared_setup import Course, compensated, working_points
from ocp.plan.passes.optimise import SolvedPass
from ocp.simulate.twin.arm.arm import VirtualArm, arm_moments
from ocp.simulate.twin.contact import ContactMoments, ContactResult, Grinder, read_sensor
from ocp.simulate.twin.truth.truth import Truth
from robots.calibration.store import Calibration
from robots.kinematics import jacobian
from robots.pose import Array

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
        asked = contact_moments(course, machine, one, course.cell.process.force)
        result = machine.grinder.force(asked)
        reading, _ = read_sensor(machine.truth, result, asked, rng)
        true.append(result.force[points])
        read.append(reading[points])
    return np.concatenate(true), np.concatenate(read)


def contact_moments(
    course: Course,
    machine: VirtualRobot,
    solved: SolvedPass,
    setpoint: float,
    contact: bool = True,
    run: int = 0,
    scale: float = 1.0,
) -> ContactMoments:
    """The waypoints of a pass as instants of the virtual machine; `setpoint` N of the flange, belt as the cell's times scale."""
    path, q = solved.problem.path, solved.solution.q
    n = len(q)
    time = np.concatenate([[0.0], np.cumsum(solved.problem.seconds)])
    payload = course.cell.tables.workpiece.payload if course.cell.tables.workpiece else None
    approach = np.sign(np.gradient(q, axis=0))
    cold = np.full(n, course.cell.tables.reference_temperature_C)
    still = arm_moments(
        q, payload or next(iter(course.cell.tables.payloads), ""), cold, approach, time, visit=np.zeros(n, np.int64)
    )
    return ContactMoments(
        T_base_flange=machine.arm.flange(still),
        arm_compliance=machine.arm.compliance(still),
        p=path.p,
        n=path.n,
        t=path.t,
        s=path.s,
        line=np.full(n, path.line),
        setpoint=np.full(n, setpoint),
        feed=path.feed,
        belt=np.full(n, scale * course.cell.wheel.belt_speed),
        contact=np.full(n, contact),
        clock_s=time,
        time_s=time,
        run=np.full(n, run),
        ground_before=np.zeros(n),
        wheel_temperature_C=cold,
        temperature_C=cold,
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
    model = ForceModel(replace(course.cell, calibration=None), course.law)
    return fit_force(model.cell, log, arm, ForceSetup(model, (rows,), course.cover, ())).calibration(arm)


@dataclass(frozen=True)
class _Rung:
    """A recorded pass: its joints and points, setpoint N, in contact or not, belt over the cell's."""

    solved: SolvedPass
    setpoint: float
    contact: bool = True
    belt: float = 1.0


def _ladder(course: Course, machine: VirtualRobot, calibration: Calibration, mount: str) -> list[_Rung]:
    """Recordings: each pass at each force, one of them in the air, one with the belt running back."""
    force = course.cell.process.force
    level = compensated(course, calibration, list(range(course.ladder)))
    if mount == "flange":
        rungs = [_Rung(s, share * force) for share in LADDER for s in level]
    else:
        rungs = [_Rung(_led(course, machine, s, share * force), force) for share in LADDER for s in level]
    again = rungs[len(level) : 2 * len(level)]
    return [*rungs, replace(again[0], contact=False), replace(again[-1], belt=-1.0)]


def _led(course: Course, machine: VirtualRobot, solved: SolvedPass, wanted: float) -> SolvedPass:
    """The pass with its joints led along the contact normal until every waypoint shows `wanted` N, in nominal coordinates."""
    model = solved.evaluation
    n = np.einsum("kij,kj->ki", model.T_base_blade[:, :3, :3], solved.problem.path.n)
    shown = solved
    for _ in range(LEADS):
        force = machine.grinder.force(contact_moments(course, machine, shown, course.cell.process.force)).force
        step = np.clip((wanted - force) / model.stiffness, -LEAD, LEAD)
        q = shown.solution.q
        twist = np.concatenate([step[:, None] * n, np.zeros((len(q), 3))], axis=1)
        moved = np.linalg.solve(jacobian(course.cell.robot, q), twist[..., None])[..., 0]
        shown = replace(shown, solution=replace(shown.solution, q=q + moved))
    return shown


def _log(
    course: Course, machine: VirtualRobot, rungs: list[_Rung], rng: np.random.Generator, noise: bool
) -> tuple[ForceLog, ForceRows]:
    """What a logger records of the rungs, and the model's rows for it."""
    fn, ft, parts = [], [], []
    for k, rung in enumerate(rungs):
        asked = contact_moments(course, machine, rung.solved, rung.setpoint, rung.contact, k, rung.belt)
        result = machine.grinder.force(asked)
        readings = _recorded(machine.truth, result, asked, rng, noise)
        fn.append(readings[0])
        ft.append(readings[1])
        parts.append(asked)

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
        p=joined("p"),
        n=joined("n"),
        t=joined("t"),
        fn=np.concatenate(fn),
        contact=contact,
        session=np.zeros(n, np.int64),
        sessions=("",),
        s=joined("s"),
        ft=np.concatenate(ft),
        sigma_fn=None,
        sigma_ft=None,
        setpoint=joined("setpoint"),
        feed=joined("feed"),
        belt=joined("belt"),
        line=joined("line").astype(np.int64),
        ground_before=np.zeros(n, np.int64),
        temperature=None,
        wheel_temperature=None,
        clock=None,
        row=np.arange(2, n + 2),
    )
    waypoint = np.vstack([rung.solved.problem.waypoints for rung in rungs])
    return log, ForceRows(q, waypoint, joined("setpoint"), np.sign(joined("belt")), contact)


def _recorded(
    truth: Truth, result: ContactResult, asked: ContactMoments, rng: np.random.Generator, noise: bool
) -> tuple[Array, Array]:
    """Readings (n,) N of normal and tangential force; without noise a hundred recordings' mean would be read."""
    if noise:
        return read_sensor(truth, result, asked, rng)
    return read_sensor(replace(truth, sensor_sigma=0.1 * truth.sensor_sigma), result, asked, rng)
