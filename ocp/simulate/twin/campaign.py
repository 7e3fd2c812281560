"""A grinding campaign: the program as it is, then a ladder of setpoints, an air run, belts that stand or run backwards.

A blade that slips in its clamp does so once in a campaign, though its recordings are worked on one after the other. The wheel
pushes it against the normal that is ground at that instant (`ocp.simulate.twin.contact.workpiece`). In every later recording it
stands where it slipped to, whatever side is ground then: that is a shift of the blade in its grip like any other.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.controller.controller import Track
from ocp.simulate.twin.controller.nominal import flange, solve_posture
from ocp.simulate.twin.plan_knowledge import Matched
from ocp.simulate.twin.run import GrindingConditions, GroundPasses, VirtualMachine, grind
from robots.errors import BadInput
from robots.pose import Array

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
    R = Rotation.from_rotvec(truth.blade_turn).as_matrix() @ machine.cell.workpiece.T_flange_blade[:3, :3]
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
    """What was run: the program as it is (`first`, every sample), the logged recordings in order, the sealed ones."""

    first: GroundPasses
    recorded: tuple[GroundPasses, ...]
    sealed: tuple[GroundPasses, ...]


def default_ladder(force: float, rigid: bool) -> tuple[float, ...]:
    """Setpoints N that tell stiffness from place: 60, 100 and 140 % of the process force (75 to 125 % of a rigid mount)."""
    shares = (0.75, 1.0, 1.25) if rigid else (0.6, 1.0, 1.4)
    return tuple(round(force * share, 3) for share in shares)


def check_plan(plan: CampaignPlan, hz: float, force: float) -> None:
    """Raises BadInput: levels, rates or belts out of range."""
    for level in plan.ladder:
        if not 0.1 * force <= level <= 3 * force:
            raise BadInput(f"--ladder {level:g}: must lie between {0.1 * force:g} and {3 * force:g} N, about the process force")
    if not 1.0 <= plan.log_hz <= hz:
        raise BadInput(f"--log-hz {plan.log_hz:g}: must lie between 1 and the control rate of {hz:g}")
    for belt in plan.belts:
        if not abs(belt) <= 60.0:
            raise BadInput(f"--belt {belt:g}: must lie between -60 and 60 m/s")


def run_campaign(machine: VirtualMachine, track: Track, plan: Matched, wanted: CampaignPlan, hz: float) -> GrindingCampaign:
    """Run it all, one after the other on one clock, every sample of it; only the log is thinned. Raises Infeasible as `grind`."""
    cell, every = machine.cell, max(1, round(hz / wanted.log_hz))
    own, belt = _own_force(machine), cell.wheel.belt_speed
    passes = [int(k) for k in np.unique(plan.run[plan.run >= 0])]
    first = grind(machine, track, plan, GrindingConditions(own, belt, clock=wanted.clock))
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

    for level in wanted.ladder:
        if abs(level - own) > 1e-9:
            recorded.append(another(level, belt, passes))
    if wanted.air:
        recorded.append(another(own, belt, passes[:AIR_PASSES], contact=False))
    recorded += [another(own, speed, spread(passes, BELT_PASSES)) for speed in wanted.belts]
    sealed: list[GroundPasses] = []
    if wanted.sealed:
        level = 0.5 * (own + max((*wanted.ladder, own)))
        sealed.append(another(level, belt, spread(passes, SEALED_PASSES)))
    return GrindingCampaign(first, tuple(recorded), tuple(sealed))


def _own_force(machine: VirtualMachine) -> float:
    """What the program runs with: the flange's setpoint, without a flange the process force."""
    flange_ = machine.cell.flange
    return machine.cell.process.force if flange_ is None else flange_.setpoint


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
    arrays = {name: getattr(grinding, name)[keep] for name in ("index", "q", "fn", "ft")}
    return replace(grinding, moments=grinding.moments.take(keep), result=grinding.result.take(keep), **arrays)


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
