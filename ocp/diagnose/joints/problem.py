"""The gap of link-side encoders as a fit: offsets of the encoders, believed springs, effects, delays inside the motion.

    link_j(t) = q_j(t - s_j) + offset_j + offset_(j, run) + c_j tau_j - v_j dq_j/dt - k_j sign(dq_j/dt)
                + sum over effects of columns_j(t) a                                                                    (1)

with q the motor side and tau the load. The believed springs c are nuisance, as everywhere: as good as `SPRING_SHARE` where the
cell states them, hardly known where they come from a catalogue; joints without a spring are rigid. v and k are what a recorded
motor torque holds of the drive's own viscous and dry friction, which loads no spring (c times that friction): the evidence allows
for them, the fit leaves them at zero, so that they cannot pass a delay off as friction. Only the delay s is not linear;
Gauss-Newton steps about it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ocp.diagnose.joints.columns import DELAY, delay_columns, effect_columns
from ocp.diagnose.joints.noise import Noise, blocks, factors, whiten
from ocp.diagnose.joints.signals import Signals
from ocp.effects.effect import Active, Effect, Scanned, coefficients, prior_sds, with_coefficients
from ocp.effects.engine.rows import ArmRows
from robots.gauss_newton import Rule, minimise
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Hanging, Index

RUN_SD = 1e-4  # rad (20 arcsec): how far a zero may move from recording to recording
SPRING_SHARE = 0.3  # one sigma of a spring that the cell states, of its compliance
SPRING_SD = 2e-6  # rad/(N m): one sigma of a catalogue's, the upper end of what joints give
FRICTION_SD = {"viscous": 2e-4, "dry": 3e-5}  # s, rad: 1e-7 rad/(N m) times 2000 N m s/rad and 300 N m, as large drives measure
STEPS = 4
RANK = 1e-12  # of the largest singular value; what the readings say less of stays where it is


@dataclass(frozen=True)
class Problem:
    """What the log is, apart from what is fitted: signals, arm at its instants, robot, payload, noise by joint, the readings as
    pairs (row of the signals, joint 1..6), and springs by joint: compliance rad/(N m) and its one sigma."""

    signals: Signals
    arm: ArmRows
    robot: Robot
    payload: Hanging
    noise: dict[int, Noise]
    row: Index
    joint: Index
    springs: dict[int, tuple[float, float]]
    notices: tuple[str, ...] = ()

    @property
    def measured(self) -> Array:
        """Link less motor angle (n,) rad of the readings."""
        log = self.signals.log
        return np.asarray((log.link - log.q)[self.row, self.joint - 1])

    @property
    def scatter(self) -> Array:
        """Noise (n,) rad from instant to instant."""
        return np.array([self.noise[j].floor for j in self.joint])

    def of_readings(self, links: Array) -> Array:
        """Values (rows, 6, m) by row and joint as (readings, m)."""
        return np.asarray(links[self.row, self.joint - 1])

    def columns(self, effect: Effect, joint: int, scans: Sequence[Scanned]) -> Array:
        """Sensitivities (variants, readings, m) rad of the gap in an effect's coefficients."""
        return np.asarray(effect_columns(effect, joint, scans, self.arm, self.signals.measured)[:, self.row, self.joint - 1])

    @cached_property
    def roots(self) -> dict[int, tuple[Index, list[tuple[Index, Array]]]]:
        """Of each joint: its readings, and their blocks with the roots of their covariance."""
        found = {}
        for j, noise in self.noise.items():
            at = np.flatnonzero(self.joint == j)
            row = self.row[at]
            found[j] = (at, factors(self.signals.log.time[row], blocks(self.signals, row), noise) if len(at) else [])
        return found

    def whitened(self, columns: Array) -> Array:
        """Columns (readings, m) rad as rows of unit noise."""
        out = np.empty_like(columns)
        for at, roots in self.roots.values():
            out[at] = whiten(roots, columns[at])
        return out

    def part(self, rows: NDArray[np.bool_]) -> "Problem":
        """The readings of a mask."""
        return replace(self, row=self.row[rows], joint=self.joint[rows])


def nuisance_names(problem: Problem) -> tuple[str, ...]:
    """One offset a joint, where there are several runs one a joint and run too, and the believed springs."""
    runs = problem.signals.log.runs
    names = [f"offset {j}" for j in problem.noise]
    if len(runs) > 1:
        names += [f"offset {j} run {name}" for j in problem.noise for name in runs]
    return (
        *names,
        *(f"{kind} {j}" for kind in FRICTION_SD for j in recorded(problem)),
        *(f"spring {j}" for j in problem.springs),
    )


def recorded(problem: Problem) -> list[int]:
    """Joints whose motor torque was recorded."""
    return [j for j in problem.noise if problem.signals.measured[j - 1]]


def nuisance_prior(problem: Problem) -> tuple[Array, Array]:
    """Prior mean and sd (p,) of the nuisance; sd infinite: free."""
    mean, sd = [], []
    for name in nuisance_names(problem):
        kind, joint = name.split()[:2]
        if kind == "spring":
            mean.append(problem.springs[int(joint)][0])
            sd.append(problem.springs[int(joint)][1])
        else:
            mean.append(0.0)
            sd.append(FRICTION_SD.get(kind, RUN_SD if " run " in name else np.inf))
    return np.array(mean), np.array(sd)


def nuisance_columns(problem: Problem) -> Array:
    """Sensitivities (readings, p) of the gap in the nuisance."""
    runs = problem.signals.log.runs
    columns = [(problem.joint == j).astype(float) for j in problem.noise]
    if len(runs) > 1:
        run = problem.signals.log.run[problem.row]
        columns += [((problem.joint == j) & (run == k)).astype(float) for j in problem.noise for k in range(len(runs))]
    tau = problem.signals.tau
    for friction in (problem.signals.qd, problem.signals.direction):
        columns += [np.where(problem.joint == j, -friction[problem.row, j - 1], 0.0) for j in recorded(problem)]
    columns += [np.where(problem.joint == j, tau[problem.row, j - 1], 0.0) for j in problem.springs]
    return np.stack(columns, axis=1)


def delays_of(active: Sequence[Active]) -> Array:
    """Delay (6,) s of each link side."""
    out = np.zeros(6)
    for one in active:
        if one.effect.name == DELAY:
            out[slice(None) if one.joint == 0 else one.joint - 1] += one.a[0]
    return out


def shift_of(problem: Problem, active: Sequence[Active]) -> Array:
    """Link less motor angle (n,) rad that the effects explain."""
    signals = problem.signals
    total = np.zeros(len(problem.row))
    delays = delays_of(active)
    for j in np.flatnonzero(delays) + 1:
        at = problem.joint == j
        total[at] += (signals.motor(int(j), float(delays[j - 1])) - signals.log.q[:, j - 1])[problem.row[at]]
    for one in active:
        if one.effect.name != DELAY:
            total += column_of(problem, one, delays) @ one.a
    return total


def column_of(problem: Problem, one: Active, delays: Array) -> Array:
    """Columns (n, m) of an active effect about the present delays."""
    if one.effect.name == DELAY:
        return problem.of_readings(delay_columns(problem.signals, one.joint, delays)[:, :, None])
    return problem.columns(one.effect, one.joint, [one.scanned])[0]


@dataclass(frozen=True)
class _Point:
    """A point of the search (`robots.gauss_newton`): nuisance theta (p,), effects, mean and scale of all unknowns, columns (n, p)
    of the nuisance, and the same whitened."""

    problem: Problem
    theta: Array
    active: tuple[Active, ...]
    mean: Array
    scale: Array
    columns: Array
    white: Array

    @property
    def z(self) -> Array:
        return (np.concatenate([self.theta, coefficients(self.active)]) - self.mean) / self.scale

    def reweighted(self) -> "_Point":
        return self

    def residual(self) -> Array:
        left = self.problem.measured - self.columns @ self.theta - shift_of(self.problem, self.active)
        return self.problem.whitened(left[:, None])[:, 0]

    def linearised(self) -> tuple[Array, Array]:
        delays = delays_of(self.active)
        effects = [self.problem.whitened(column_of(self.problem, one, delays)) for one in self.active]
        return self.residual(), np.column_stack([self.white, *effects]) * self.scale

    def moved(self, change: Array) -> "_Point":
        step, p = self.scale * change, len(self.theta)
        return replace(
            self, theta=self.theta + step[:p], active=with_coefficients(self.active, coefficients(self.active) + step[p:])
        )


def solve(problem: Problem, active: tuple[Active, ...]) -> tuple[Array, tuple[Active, ...]]:
    """Nuisance (p,) and effects with values and covariance that fit the readings best."""
    mean, sd = nuisance_prior(problem)
    p = len(mean)
    mean, sd = np.append(mean, np.zeros(len(coefficients(active)))), np.append(sd, prior_sds(active))
    known = np.isfinite(sd)
    scale = np.where(known, sd, RUN_SD)
    allowed = np.array([name.split()[0] in FRICTION_SD for name in nuisance_names(problem)])
    columns = np.where(allowed, 0.0, nuisance_columns(problem))
    moving = any(one.effect.name == DELAY for one in active)
    start = _Point(problem, mean[:p], active, mean, scale, columns, problem.whitened(columns))
    found = minimise(start, known.astype(float), Rule(STEPS if moving else 1, rank=RANK))
    covariance = scale[:, None] * found.last.covariance * scale
    at = found.at
    return at.theta, with_coefficients(at.active, coefficients(at.active), covariance[p:, p:])
