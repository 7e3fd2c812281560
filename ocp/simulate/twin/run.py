"""A program on the virtual machine: what the arm does, what the wheel presses, what the sensor shows."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.arm.arm import Moments, VirtualArm, arm_moments, make_arm
from ocp.simulate.twin.arm.collide import HZ, SLOW_HZ, WheelBody, refuse_hits, true_wheel
from ocp.simulate.twin.contact import ContactMoments, ContactResult, Grinder, make_grinder, read_sensor
from ocp.simulate.twin.controller.controller import Index, Track
from ocp.simulate.twin.plan_knowledge import AWAY, GRINDING, Matched
from ocp.simulate.twin.truth.truth import Truth
from robots.errors import Infeasible
from robots.pose import Array, make_transform
from trajectories.blade import Blade

UNSAFE = 10.0  # times the process force, beyond which a run ends: nobody would let it go on
WARM, WARMING = 12.0, 900.0  # K and s: how the wheel heats while it runs
SLICE = 4000  # instants worked on at once


@dataclass(frozen=True)
class VirtualMachine:
    """The virtual machine: believed cell, truth, arm and grinder as they are, the blade, random numbers."""

    cell: Cell
    truth: Truth
    blade: Blade
    arm: VirtualArm
    grinder: Grinder
    rng: np.random.Generator

    @property
    def temperature(self) -> float:
        """Of the hall, deg C."""
        return float(self.cell.tables.reference_temperature_C)


@dataclass(frozen=True)
class GrindingConditions:
    """How a program is run: setpoint N, belt m/s with sign, in contact or with the flange drawn back, seconds since the
    campaign began, how often each line was ground before, label of the session."""

    setpoint: float
    belt: float
    contact: bool = True
    clock: float = 0.0
    ground: dict[int, int] | None = None
    session: str = "1"


@dataclass(frozen=True)
class GroundPasses:
    """n samples of the passes of a run, in time order: `index` into the track, q (n, 6) rad commanded, time s since the pass
    began, clock s, moments of the contact, the true force N, tangential N, overlap m, and the readings fn, ft N."""

    conditions: GrindingConditions
    index: Index
    q: Array
    moments: ContactMoments
    result: ContactResult
    fn: Array
    ft: Array


def make_machine(cell: Cell, truth: Truth, blade: Blade, seed: int) -> VirtualMachine:
    """Build arm and grinder; `seed` draws noise of joints and sensor, from a stream that is not the machine's."""
    return VirtualMachine(
        cell, truth, blade, make_arm(cell, truth), make_grinder(cell, truth, blade), np.random.default_rng([seed, 0xF0])
    )


def refuse_crash(machine: VirtualMachine, track: Track, plan: Matched) -> None:
    """Raises Infeasible where the arm, the blade or its holder hits the wheel or the arm on the way."""
    rate = 1.0 / max(float(np.median(np.diff(track.time))), 1e-9)
    n = np.arange(len(track.time))
    slow = plan.phase != AWAY
    index = np.flatnonzero((n % max(1, round(rate / HZ)) == 0) & ~slow | (n % max(1, round(rate / SLOW_HZ)) == 0) & slow)
    links = _links(machine, track, index)
    where = [f"{track.places[track.motion[k]][0]}, line {int(track.row[k])}, {track.time[k]:.2f} s" for k in index]
    T = true_blade(machine.cell, machine.truth)
    refuse_hits(machine.cell, machine.blade, wheel_of(machine), T, links, plan.phase[index], plan.interference[index], where)


def _links(machine: VirtualMachine, track: Track, index: Index) -> Array:
    parts = [
        machine.arm.links(arm_conditions(machine, track, part, 0.0)) for part in np.array_split(index, len(index) // SLICE + 1)
    ]
    return np.concatenate(parts)


def arm_conditions(machine: VirtualMachine, track: Track, index: Index, clock: float, visit: Index | None = None) -> Moments:
    """Conditions of samples of the track."""
    piece = machine.cell.tables.workpiece
    payload = piece.payload if piece is not None and piece.payload is not None else next(iter(machine.truth.payloads), "")
    return arm_moments(
        track.q[index], payload, machine.temperature, track.approach[index], clock + track.time[index], visit=visit
    )


def wheel_of(machine: VirtualMachine) -> WheelBody:
    """The wheel as it stands."""
    return true_wheel(machine.cell, machine.truth.wheel_shift, machine.truth.wheel_axis_turn)


def true_blade(cell: Cell, truth: Truth) -> Array:
    """T_flange_blade as the blade is really held."""
    T = cell.workpiece.T_flange_blade
    turn = Rotation.from_rotvec(truth.blade_turn).as_matrix()
    return make_transform(turn @ T[:3, :3], T[:3, 3] + truth.blade_shift)


def grind(
    machine: VirtualMachine, track: Track, plan: Matched, conditions: GrindingConditions, runs: list[int] | None = None
) -> GroundPasses:
    """Run the passes (all, or `runs`) under conditions. Raises Infeasible: a force beyond what is safe."""
    rows = plan.phase == GRINDING
    if runs is not None:
        rows &= np.isin(plan.run, runs)
    index = np.concatenate([np.flatnonzero(rows & (plan.run == k)) for k in np.unique(plan.run[rows])])
    m = arm_conditions(machine, track, index, conditions.clock, plan.run[index])
    flange, compliance = machine.arm.flange(m, machine.rng), machine.arm.compliance(m)
    asked = _contact(machine, track, plan, conditions, index, flange, compliance)
    result = machine.grinder.force(asked)
    if conditions.contact:
        _refuse_force(machine, track, plan, index, result)
    fn, ft = read_sensor(machine.truth, result, asked, machine.rng)
    return GroundPasses(conditions, index, m.q, asked, result, fn, ft)


def _contact(
    machine: VirtualMachine, track: Track, plan: Matched, c: GrindingConditions, index: Index, flange: Array, compliance: Array
) -> ContactMoments:
    """The contact's conditions at samples of the track."""
    n, run, line = len(index), plan.run[index], plan.line[index]
    clock = c.clock + track.time[index]
    begin = {int(k): float(track.time[index[run == k][0]]) for k in np.unique(run)}
    ground = c.ground or {}
    return ContactMoments(
        T_base_flange=flange,
        arm_compliance=compliance,
        p=plan.p[index],
        n=plan.n[index],
        t=plan.t[index],
        s=plan.s[index],
        line=line,
        setpoint=np.full(n, c.setpoint),
        feed=plan.feed[index],
        belt=np.full(n, c.belt),
        contact=np.full(n, c.contact),
        clock_s=clock,
        time_s=track.time[index] - np.array([begin[int(k)] for k in run]),
        run=run,
        ground_before=np.array([ground.get(int(k), 0) for k in line]),
        wheel_temperature_C=machine.temperature + WARM * (1 - np.exp(-clock / WARMING)),
        temperature_C=np.full(n, machine.temperature),
    )


def _refuse_force(machine: VirtualMachine, track: Track, plan: Matched, index: Index, result: ContactResult) -> None:
    k = int(np.argmax(result.force))
    most = UNSAFE * machine.cell.process.force
    if result.force[k] > most or not np.isfinite(result.force).all():
        at = index[k]
        file, row = track.places[track.motion[at]][0], int(track.row[at])
        raise Infeasible(
            f"{file}, line {row}: on the virtual cell line {int(plan.line[at])} of the blade is pressed with "
            f"{result.force[k]:.0f} N at s = {1e3 * plan.s[at]:.1f} mm, beyond {most:.0f} N (ten times the process force); "
            "calibrate before this program runs"
        )


def pushed_by(grinding: GroundPasses, shift: Array) -> ContactMoments:
    """The same instants with the flange moved by `shift` (n, 3) m, base axes."""
    T = grinding.moments.T_base_flange.copy()
    T[:, :3, 3] += shift
    return replace(grinding.moments, T_base_flange=T)
