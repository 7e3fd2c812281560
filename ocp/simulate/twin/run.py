"""A program on the virtual machine: what the arm does, what the wheel presses, what the sensor shows; and a grinding campaign:
the program as it is, then a ladder of setpoints, an air run, belts that stand or run backwards.

A blade that slips in its clamp does so once in a campaign, though its recordings are worked on one after the other. The wheel
pushes it against the normal that is ground at that instant (`ocp.simulate.twin.contact.wheel_and_blade`). In every later
recording it stands where it slipped to, whatever side is ground then: that is a shift of the blade in its grip like any other.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.arm import Moments, VirtualArm, arm_moments, make_arm
from ocp.simulate.twin.collide import HZ, SLOW_HZ, refuse_hits, true_wheel
from ocp.simulate.twin.contact import ContactMoments, ContactResult
from ocp.simulate.twin.contact.grinder import ContactPatches, Grinder, make_grinder
from ocp.simulate.twin.contact.sensor import read_sensor
from ocp.simulate.twin.controller import Index, Track
from ocp.simulate.twin.machine import Settled
from ocp.simulate.twin.path_motion import flange, solve_posture
from ocp.simulate.twin.plan_knowledge import AWAY, GRINDING, Matched
from ocp.simulate.twin.touching import Touching, carried_acceleration, touch, touch_windows
from ocp.simulate.twin.truth import Truth
from robots.errors import Infeasible
from robots.pose import Array, Stacked, make_transform
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
    campaign began, how often each line was ground before."""

    setpoint: float
    belt: float
    contact: bool = True
    clock: float = 0.0
    ground: dict[int, int] | None = None


@dataclass(frozen=True)
class GroundPasses(Stacked):
    """n samples of the passes of a run, in time order: `index` into the track, q (n, 6) rad commanded, time s since the pass
    began, clock s, moments of the contact, the true force N, tangential N, overlap m, and the readings fn, ft N; touched: the
    passes from the air to the air, where a flange that moves in time has them."""

    index: Index
    q: Array
    moments: ContactMoments
    result: ContactResult
    fn: Array
    ft: Array
    touched: Touching | None = None


def make_machine(cell: Cell, truth: Truth, blade: Blade, seed: int) -> VirtualMachine:
    """Build arm and grinder; `seed` draws noise of joints and sensor, from a stream that is not the machine's."""
    return VirtualMachine(
        cell, truth, blade, make_arm(cell, truth), make_grinder(cell, truth, blade), np.random.default_rng([seed, 0xF0])
    )


def refuse_crash(machine: VirtualMachine, track: Track, plan: Matched) -> float:
    """Seconds of travel in which blade and wheel may touch with the flange as far out as it stands free.

    Raises Infeasible where the arm, the blade or its holder hits the wheel or the arm on the way.
    """
    rate = 1.0 / max(float(np.median(np.diff(track.time))), 1e-9)
    n = np.arange(len(track.time))
    slow = plan.phase != AWAY
    index = np.flatnonzero((n % max(1, round(rate / HZ)) == 0) & ~slow | (n % max(1, round(rate / SLOW_HZ)) == 0) & slow)
    parts = np.array_split(index, len(index) // SLICE + 1)
    links = np.concatenate([machine.arm.links(arm_conditions(machine, track, part, 0.0)) for part in parts])
    where = [f"{track.places[track.motion[k]][0]}, line {int(track.row[k])}, {track.time[k]:.2f} s" for k in index]
    T, wheel = true_blade(machine.cell, machine.truth), true_wheel(machine.cell, machine.truth)
    phase, own = plan.phase[index], machine.cell.flange
    inside = refuse_hits(machine.cell, machine.blade, wheel, T, links, phase, plan.interference[index], where)
    stands_out = 0.0 if own is None else min(0.5 * own.stroke, own.setpoint / own.stiffness)
    spent = np.minimum(np.diff(track.time[index], append=track.time[-1]), 1.0 / HZ)
    return float(spent[(phase == AWAY) & (inside > -stands_out)].sum())


def arm_conditions(machine: VirtualMachine, track: Track, index: Index, clock: float, visit: Index | None = None) -> Moments:
    """Conditions of samples of the track."""
    hanging = machine.cell.tables.hanging or ""
    return arm_moments(
        track.q[index], hanging, machine.temperature, track.approach[index], clock + track.time[index], visit=visit
    )


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
    own = machine.cell.flange
    if conditions.contact and own is not None and own.moves_in_time:
        touched, asked, result = approach(machine, track, plan, conditions, np.unique(plan.run[rows]))
        _refuse_force(machine, track, touched.windows.plan, touched.windows.index, replace(result, force=touched.most))
        mine = plan.run[touched.windows.index] == touched.windows.run
        asked, result, index = asked.take(mine), result.take(mine), touched.windows.index[mine]
        return GroundPasses(
            index, track.q[index], asked, result, *read_sensor(machine.truth, result, asked, machine.rng), touched
        )
    index = np.concatenate([np.flatnonzero(rows & (plan.run == k)) for k in np.unique(plan.run[rows])])
    m = arm_conditions(machine, track, index, conditions.clock, plan.run[index])
    flange, stands = machine.arm.flange(m, machine.rng), machine.arm.settled(m)
    asked = _contact(machine, track, plan.take(index), conditions, index, flange, stands)
    result = machine.grinder.force(asked)
    if conditions.contact:
        _refuse_force(machine, track, plan, index, result)
    fn, ft = read_sensor(machine.truth, result, asked, machine.rng)
    return GroundPasses(index, m.q, asked, result, fn, ft)


def approach(
    machine: VirtualMachine, track: Track, plan: Matched, conditions: GrindingConditions, runs: Index
) -> tuple[Touching, ContactMoments, ContactResult]:
    """The contact of the passes `runs` from the air to the air: what became of it, its moments and its result, at every sample of
    their windows."""
    windows = touch_windows(track, plan, runs)
    m = arm_conditions(machine, track, windows.index, conditions.clock, windows.run)
    settled = machine.arm.settled(m, machine.rng)
    of = replace(windows.plan, run=windows.run)
    asked = _contact(machine, track, of, conditions, windows.index, settled.links[:, 6], settled)
    touched, result = touch(machine.grinder, asked, windows, carried_acceleration(machine.cell, track, windows))
    return touched, asked, result


def _contact(
    machine: VirtualMachine, track: Track, plan: Matched, c: GrindingConditions, index: Index, flange: Array, stands: Settled
) -> ContactMoments:
    """The contact's conditions at samples `index` of the track; `plan`: what it says at these; `stands`: how the arm does."""
    n, run, line = len(index), plan.run, plan.line
    clock = c.clock + track.time[index]
    begin = {int(k): float(track.time[index[(run == k) & (plan.phase == GRINDING)][0]]) for k in np.unique(run)}
    ground = c.ground or {}
    asked = ContactMoments(
        T_base_flange=flange,
        arm_compliance=machine.arm.compliance_at(stands),
        setpoint=_setpoint(machine.cell, plan, c.setpoint),
        belt=np.full(n, c.belt),
        contact=np.full(n, c.contact),
        clock_s=clock,
        time_s=track.time[index] - np.array([begin[int(k)] for k in run]),
        run=run,
        ground_before=np.array([ground.get(int(k), 0) for k in line]),
        wheel_temperature_C=machine.temperature + WARM * (1 - np.exp(-clock / WARMING)),
        temperature_C=np.full(n, machine.temperature),
        **{name: getattr(plan, name) for name in ("p", "n", "t", "s", "line", "feed")},
    )
    return machine.grinder.borne(asked, partial(machine.arm.compliance_at, stands)) if machine.arm.bends_on else asked


def _setpoint(cell: Cell, plan: Matched, asked: float) -> Array:
    """Setpoints (n,) N of a run at `asked`: what the plan sets, in proportion; `asked` where it tells none."""
    own = asked if cell.flange is None else cell.flange.setpoint
    share = plan.setpoint / own if own > 0 else np.ones(len(plan.setpoint))
    return np.asarray(asked * np.where(np.isfinite(share), share, 1.0))


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


SLIP = "clamp_slip"


def ground_sides(machine: VirtualMachine, known: Mapping[int, Array], c: ContactMoments) -> dict[int, Array]:
    """For every planted slip (its place among the slips) the normal (3,), blade frame, of the last contact at or before its
    instant, else of the first contact of all; `known` before the recording `c`, which comes after those that made it."""
    found, touching = dict(known), np.flatnonzero(c.contact)
    if len(touching):
        clock = c.campaign_time()[touching]
        for k, effect in enumerate(machine.truth.planted(SLIP)):
            earlier = touching[clock <= effect.number("at_s")]
            if len(earlier):
                found[k] = c.n[earlier[-1]]
            elif k not in found:
                found[k] = c.n[touching[0]]
    return found


def already_slipped(machine: VirtualMachine, known: Mapping[int, Array], begin: float) -> VirtualMachine:
    """The machine for a recording whose first contact is at clock `begin` s: slips before it have happened, against the normals
    `known` of `ground_sides`; the same machine where none has."""
    truth, slips = machine.truth, machine.truth.planted(SLIP)
    done = [k for k, effect in enumerate(slips) if k in known and effect.number("at_s") < begin]
    if not done:
        return machine
    R = true_blade(machine.cell, truth)[:3, :3]
    shift = truth.blade_shift - sum(slips[k].number("m") * (R @ known[k]) for k in done)
    gone = {id(slips[k]) for k in done}
    left = tuple(effect for effect in truth.effects if id(effect) not in gone)
    truth = replace(truth, blade_shift=np.asarray(shift), effects=left)
    return replace(machine, truth=truth, grinder=replace(machine.grinder, truth=truth))


BETWEEN = 240.0  # s from the end of a run of the program to the start of the next: setpoint changed, blade wiped and looked at
AIR_PASSES, BELT_PASSES = 1, 3  # passes that are driven in the air, and with another belt speed
SEALED_PASSES = 3
# A rigid mount has no setpoint: the blade is brought nearer instead, force growing with overlap to about this power.
STIFFENING = 0.7


@dataclass(frozen=True)
class CampaignPlan:
    """What is to be run: setpoints N of the ladder, further belt speeds m/s, an air run or none, samples a second in the log, a
    sealed part or none; clock s at the start."""

    ladder: tuple[float, ...]
    belts: tuple[float, ...] = ()
    air: bool = True
    log_hz: float = 25.0
    sealed: bool = False
    clock: float = 0.0


@dataclass(frozen=True)
class GrindingCampaign:
    """What was run: the program as it is (`first`, every sample; `touched`, from the air to the air), the logged recordings in
    order, the sealed ones; patches: where the pressure of `touched` lies."""

    first: GroundPasses
    touched: Touching
    patches: ContactPatches
    recorded: tuple[GroundPasses, ...]
    sealed: tuple[GroundPasses, ...]


def run_campaign(machine: VirtualMachine, track: Track, plan: Matched, wanted: CampaignPlan, hz: float) -> GrindingCampaign:
    """Run it all, one after the other on one clock, every sample of it; only the log is thinned. Raises Infeasible as `grind`."""
    cell, every = machine.cell, max(1, round(hz / wanted.log_hz))
    # What the program runs with: the flange's setpoint, without a flange the process force.
    own, belt = cell.process.force if cell.flange is None else cell.flange.setpoint, cell.wheel.belt_speed
    passes = [int(k) for k in np.unique(plan.run[plan.run >= 0])]
    as_planned, again = GrindingConditions(own, belt, clock=wanted.clock), deepcopy(machine.rng)
    first = grind(machine, track, plan, as_planned)
    # The same joints, drawn again: of a flange in balance the passes are worked out without the rest of their windows.
    touched = first.touched or approach(replace(machine, rng=again), track, plan, as_planned, np.array(passes))[0]
    recorded, clock, ground = [decimated(first, every)], wanted.clock, _ground(plan, passes, {})
    sides = ground_sides(machine, {}, first.moments)

    def another(setpoint: float, speed: float, some: list[int], contact: bool = True) -> GroundPasses:
        nonlocal clock, ground, sides
        clock += track.duration + BETWEEN
        moved_track = track if cell.flange is not None or not contact else nearer(machine, track, plan, setpoint / own)
        there = already_slipped(machine, sides, clock + float(track.time[np.isin(plan.run, some)][0]))
        done = grind(there, moved_track, plan, GrindingConditions(setpoint, speed, contact, clock, dict(ground)), some)
        sides = ground_sides(machine, sides, done.moments)
        if contact:
            ground = _ground(plan, some, ground)
        return decimated(done, every)

    recorded += [another(level, belt, passes) for level in wanted.ladder if abs(level - own) > 1e-9]
    if wanted.air:
        recorded.append(another(own, belt, passes[:AIR_PASSES], contact=False))
    recorded += [another(own, speed, spread(passes, BELT_PASSES)) for speed in wanted.belts]
    level = 0.5 * (own + max((*wanted.ladder, own)))
    sealed = (another(level, belt, spread(passes, SEALED_PASSES)),) if wanted.sealed else ()
    return GrindingCampaign(first, touched, machine.grinder.patches(touched.moments), tuple(recorded), sealed)


def spread(passes: list[int], most: int) -> list[int]:
    """At most `most` passes from first to last."""
    return [passes[k] for k in np.unique(np.linspace(0, len(passes) - 1, min(most, len(passes))).round().astype(int))]


def _ground(plan: Matched, passes: list[int], before: dict[int, int]) -> dict[int, int]:
    """How often each line was ground, after these passes."""
    lines = np.unique(plan.line[np.isin(plan.run, passes)])
    return before | {int(k): before.get(int(k), 0) + 1 for k in lines}


def decimated(grinding: GroundPasses, every: int) -> GroundPasses:
    """Every so many samples of each pass."""
    run = grinding.moments.run
    keep = np.concatenate([np.flatnonzero(run == k)[::every] for k in np.unique(run)])
    return replace(grinding.take(keep), touched=None)


def nearer(machine: VirtualMachine, track: Track, plan: Matched, share: float) -> Track:
    """The track with the passes moved along the contact normal so that a rigid mount presses `share` times as hard, about."""
    rows = np.flatnonzero(plan.run >= 0)
    T = flange(machine.cell.robot, track.q[rows])
    blade = machine.cell.workpiece.T_flange_blade
    outward = np.einsum("nij,nj->ni", T[:, :3, :3] @ blade[:3, :3], plan.n[rows])
    depth = plan.interference[rows] * (share**STIFFENING - 1.0)
    goal = T.copy()
    goal[:, :3, 3] += depth[:, None] * outward
    q = track.q.copy()
    q[rows] = solve_posture(machine.cell.robot, goal, track.q[rows])[0]
    return replace(track, q=q)
