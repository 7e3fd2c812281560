"""What force a program would be seen to make: figures, the worst places, and which part of the cell brings them there."""

from dataclasses import dataclass, replace

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.collide import WheelBody, true_wheel
from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.controller import Index
from ocp.simulate.twin.plan_knowledge import Matched
from ocp.simulate.twin.run import GroundPasses, VirtualMachine, true_blade
from robots.pose import Array, apply

WITHIN = 1.0  # N
WORST, APART, ALIKE = 8, 0.02, 2  # places that are told; m between two of one line; most of one line
NUDGE = 2e-5  # m, for the stiffness of the whole chain
SOFTEST = 100.0  # N/m; below it there is no contact to speak of
PARTS = ("arm", "wheel", "blade", "contact")


@dataclass(frozen=True)
class Place:
    """A bad place: line of the blade, s m, blade coordinates (3,) m, force N, what each of PARTS brings N."""

    line: int
    s: float
    p: Array
    force: float
    parts: dict[str, float]

    @property
    def cause(self) -> str:
        """The part that brings most of the error, in its direction."""
        total = sum(self.parts.values())
        return max(self.parts, key=lambda name: total * self.parts[name])


@dataclass(frozen=True)
class Rehearsal:
    """A run in figures. n samples: run, line, s m, p, n (n, 3), force N, goal N as planned, parts (n, 4) N of the error by
    PARTS; `lost` share of samples without contact."""

    run: Index
    line: Index
    s: Array
    p: Array
    n: Array
    force: Array
    goal: Array
    parts: Array
    worst: tuple[Place, ...]

    @property
    def figures(self) -> dict[str, float]:
        """mean, sd, min, max N, shares within 1 N and without contact, rms of the error and of each part of it, N."""
        error = self.force - self.goal
        within, lost = np.mean(np.abs(error) <= WITHIN), np.mean(self.force <= 0)
        found = statistics(self.force) | {"within_1_N": within, "lost": lost}
        found |= {"goal_N": self.goal.mean(), "rms_error_N": np.sqrt(np.mean(error**2))}
        found |= {f"rms_{name}_N": np.sqrt(np.mean(self.parts[:, k] ** 2)) for k, name in enumerate(PARTS)}
        return {name: float(value) for name, value in found.items()}


def statistics(force: Array) -> dict[str, float]:
    """Mean, standard deviation, least and most of forces N."""
    figures = {"mean_N": force.mean(), "sd_N": force.std(), "min_N": force.min(), "max_N": force.max()}
    return {name: float(value) for name, value in figures.items()}


def rehearse(machine: VirtualMachine, plan: Matched, grinding: GroundPasses, tool: Array, base: Array) -> Rehearsal:
    """Judge the run of a program. tool (4, 4) T_flange_blade and base (4, 4) T_base_wheel: the frames in the program, which
    the plan believed in.

    The error of the overlap is followed through the chain: the flange stands elsewhere (arm), then the wheel, then the blade;
    newtons by the stiffness of the whole chain at the place. What is left of the error of the force is the contact's: cover,
    blade, flange and their stiffnesses, friction, effects.
    """
    grinding = _planned(grinding, plan)
    m, force = grinding.moments, grinding.result.force
    cell, truth, i = machine.cell, machine.truth, grinding.index
    believed = programmed_wheel(cell, base)
    really = true_wheel(cell, truth)
    T, held = m.T_base_flange @ tool, m.T_base_flange @ true_blade(cell, truth)
    steps = [plan.interference[i], overlap(believed, T, m.p), overlap(really, T, m.p), overlap(really, held, m.p)]
    stiffness = chain_stiffness(machine, grinding, really)
    parts = np.diff(np.array(steps), axis=0).T * stiffness[:, None]
    goal = plan.force[i]
    parts = np.column_stack([parts, force - goal - parts.sum(axis=1)])
    return Rehearsal(m.run, m.line, m.s, m.p, m.n, force, goal, parts, _worst(m, force, goal, parts))


def _planned(grinding: GroundPasses, plan: Matched) -> GroundPasses:
    """The samples of the passes themselves, without what leads in and out."""
    kept = np.flatnonzero(plan.planned[grinding.index])
    arrays = {name: getattr(grinding, name)[kept] for name in ("index", "q", "fn", "ft")}
    return replace(grinding, moments=grinding.moments.take(kept), result=grinding.result.take(kept), **arrays)


def programmed_wheel(cell: Cell, base: Array) -> WheelBody:
    """The wheel that the plan believed in: base (4, 4) touches it at arc zero, its radius is as the cell was updated."""
    known = cell.calibration
    worn = {} if known is None else dict(zip(known.names, known.values.tolist(), strict=True))
    radius = cell.wheel.radius + worn.get("wheel_radius", 0.0)
    return WheelBody(base[:3, 3] - radius * base[:3, 2], base[:3, 1], radius, cell.wheel.width)


def overlap(wheel: WheelBody, T_base_blade: Array, p: Array) -> Array:
    """Interference (n,) m of the undeformed contact points p (n, 3) of a blade at T_base_blade (n, 4, 4)."""
    v = apply(T_base_blade, p) - wheel.centre
    radial = v - (v @ wheel.axis)[:, None] * wheel.axis
    return np.asarray(wheel.radius - np.linalg.norm(radial, axis=1))


def chain_stiffness(machine: VirtualMachine, grinding: GroundPasses, wheel: WheelBody) -> Array:
    """Newtons per metre (n,) of the chain of arm, flange, blade and wheel in balance, by moving the flange a little toward the
    wheel."""
    m = grinding.moments
    v = apply(m.T_base_flange @ true_blade(machine.cell, machine.truth), m.p) - wheel.centre
    radial = v - (v @ wheel.axis)[:, None] * wheel.axis
    inward = -radial / np.linalg.norm(radial, axis=1, keepdims=True)
    T = m.T_base_flange.copy()
    T[:, :3, 3] += NUDGE * inward
    pushed = machine.grinder.force(replace(m, T_base_flange=T)).force
    before = grinding.result.force if grinding.touched is None else machine.grinder.force(m).force
    return np.asarray(np.maximum((pushed - before) / NUDGE, SOFTEST))


def _worst(m: ContactMoments, force: Array, goal: Array, parts: Array) -> tuple[Place, ...]:
    """The largest errors, not all on one line and not twice in one place."""
    found: list[Place] = []
    for k in np.argsort(-np.abs(force - goal), kind="stable"):
        same = [p for p in found if p.line == int(m.line[k])]
        if len(same) < ALIKE and all(abs(p.s - m.s[k]) >= APART for p in same):
            named = {name: float(value) for name, value in zip(PARTS, parts[k], strict=True)}
            found.append(Place(int(m.line[k]), float(m.s[k]), m.p[k], float(force[k]), named))
        if len(found) == WORST:
            break
    return tuple(found)
