"""The channel of link-side encoders: link angle less motor angle, offsets refitted, noise that remembers."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ocp.diagnose.engine.channel_system import Fold, HeldOut, ReadingConditions, Sealed, System, Variant
from ocp.diagnose.joints.log import JointLog
from ocp.diagnose.joints.noise import noise_of
from ocp.diagnose.joints.problem import (
    DELAY,
    EncoderProblem,
    column_of,
    delay_columns,
    delays_of,
    encoder_rows,
    fit_encoders,
    nuisance_names,
    nuisance_prior,
    nuisance_sensitivities,
    seen_by_encoder,
    shift_of,
)
from ocp.diagnose.joints.signals import signals_of
from ocp.diagnose.rules import CATALOGUE_SPRING_SD, SPRING_SHARE
from ocp.effects.effect import Active, Effect, Scanned, Surroundings
from ocp.effects.motor_harmonic import ratios_of
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Hanging

ARCSEC = float(np.degrees(1.0) * 3600.0)
LEAST_TRAIN, LEAST_TEST = 60, 20  # readings on each side of a fold
_HAVE = frozenset({"approach", "time_s", "tau", "speed"})  # what a motion log brings by itself
BLOCKS = 5


def joint_folds(problem: EncoderProblem) -> list[Fold]:
    """Blocks of time in each run (kind "block"); runs; half of a joint's range, one direction, the fast half of a joint."""
    signals, log = problem.signals, problem.signals.log
    block = np.empty(len(log), int)
    for k in np.unique(log.run):
        rows = np.flatnonzero(log.run == k)
        time = log.time[rows] - log.time[rows[0]]
        block[rows] = np.minimum((BLOCKS * time / max(time[-1], 1e-9)).astype(int), BLOCKS - 1)
    found = [Fold(f"time block {k + 1} of {BLOCKS}", "block", block[problem.row] == k) for k in range(BLOCKS)]
    if len(log.runs) > 1:
        found += [Fold(f"run={name}", "run", log.run[problem.row] == k) for k, name in enumerate(log.runs)]
    for j in problem.noise:
        found += _of_joint(problem, j, log.q[:, j - 1], signals.qd[:, j - 1], signals.direction[:, j - 1])
    return found


def _of_joint(problem: EncoderProblem, j: int, q: Array, qd: Array, direction: Array) -> list[Fold]:
    mine = problem.joint == j
    row = problem.row
    middle, fast = float(np.median(q[row[mine]])), float(np.median(np.abs(qd[row[mine]])))
    found = [Fold(f"q{j}>{np.degrees(middle):.0f}deg", "joint range", mine & (q > middle)[row])]
    if (direction < 0).any() and (direction > 0).any():
        found.append(Fold(f"direction{j}=-", "approach", mine & (direction < 0)[row]))
    found.append(Fold(f"speed{j}>{np.degrees(fast):.0f}deg/s", "speed", mine & (np.abs(qd) > fast)[row]))
    return found


@dataclass(frozen=True)
class JointChannel:
    """Link-side encoders fitted: nuisance theta (p,) (offsets rad, believed springs rad/(N m)), active effects."""

    problem: EncoderProblem
    theta: Array
    active: tuple[Active, ...] = ()
    name: str = "joint"
    unit: str = "arcsec"
    _kept: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @property
    def conditions(self) -> ReadingConditions:
        """Of its readings: pairs of an instant and a joint. What the other joints do is left out (zero): an encoder sees its own
        joint and the load, and along one motion any function of all joints is a function of time."""
        p = self.problem
        own = np.zeros((len(p.row), 6))
        own[np.arange(len(p.row)), p.joint - 1] = 1.0
        q, approach, tau = (own * a[p.row] for a in (p.signals.log.q, p.signals.direction, p.signals.tau))
        log = p.signals.log
        return ReadingConditions(
            signal="joint",
            q=q,
            approach=approach,
            time=log.time[p.row],
            run=log.run[p.row],
            tau=tau,
            d_joints=own[:, None],
            gear_ratio=ratios_of(self.surroundings),
        )

    @property
    def noise_floor(self) -> float:
        """Rms arcsec from instant to instant; what wanders slowly counts as gap."""
        return ARCSEC * float(np.sqrt(np.mean(self.problem.scatter**2)))

    @property
    def surroundings(self) -> Surroundings:
        """Ranges of the joints, times, sampling step."""
        log = self.problem.signals.log
        span = np.stack([log.q.min(axis=0), log.q.max(axis=0)], axis=1)
        step = float(np.median(np.diff(log.time[log.run == log.run[0]])))
        robot = self.problem.robot
        return Surroundings(robot.gear_ratio, span, np.sort(log.time), (), step, robot=robot.name)

    @property
    def system(self) -> System:
        """Whitened about the current fit."""
        if "system" not in self._kept:
            mean, sd = nuisance_prior(self.problem)
            white = self.problem.whitened(np.column_stack([self.gap()[:, 0], nuisance_sensitivities(self.problem)]))
            n = len(white)
            self._kept["system"] = System(
                white[:, 0],
                white[:, 1:],
                nuisance_names(self.problem),
                sd,
                self.theta - mean,
                np.arange(n, dtype=np.int64),
                np.zeros(n, np.int64),
            )
        system: System = self._kept["system"]
        return system

    def blind(self, effect: Effect) -> str:
        """Why the channel cannot see an effect; empty where it can."""
        if not seen_by_encoder(effect):
            return f"{effect.name}: no link-side encoder sees it"
        lacking = [need for need in effect.needs if need not in _HAVE]
        return f"joints.csv has no column {lacking[0]}: {effect.name} cannot be seen" if lacking else ""

    def variants(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None = None) -> list[Variant]:
        """Whitened columns of an effect; none at a joint without a link side."""
        if self.blind(effect):
            return []
        p = self.problem
        if effect.name == DELAY:
            if joint and (joint not in p.noise or len(p.noise) == 1):
                return []  # the delay of an only joint is the common one
            scans = scans if scans is not None else [{}]
            raw = [p.of_readings(delay_columns(p.signals, joint, delays_of(self.active))[:, :, None]) for _ in scans]
        else:
            scans = list(scans if scans is not None else effect.scan(joint, self.surroundings))
            raw = list(p.columns(effect, joint, scans)) if scans else []
        if not any(np.abs(c).max(initial=0.0) > 0 for c in raw):
            return []
        white = p.whitened(np.hstack(raw))
        m, sd = effect.size, np.array(effect.prior_sd, float)
        return [Variant(effect.name, joint, s, white[:, k * m : (k + 1) * m], sd) for k, s in enumerate(scans)]

    def with_active(self, active: tuple[Active, ...]) -> "JointChannel":
        """Offsets and coefficients refitted jointly. The noise stays: it was not taken from the gap."""
        return fitted(self.problem, active, np.ones(len(self.problem.row), bool))

    def gap(self) -> Array:
        """Link angle less predicted, (n, 1) rad."""
        p = self.problem
        return (p.measured - nuisance_sensitivities(p) @ self.theta - shift_of(p, self.active))[:, None]

    def whiten(self, changes: Array) -> Array:
        """Whitened rows of changes (n, 1, m) rad."""
        return self.problem.whitened(np.asarray(changes)[:, 0])

    def folds(self) -> list[Fold]:
        """Time blocks, runs, halves of a joint's range, directions, speeds."""
        return joint_folds(self.problem)

    def held_out(self, fold: Fold, active: tuple[Active, ...]) -> HeldOut | None:
        """Judge `active` on a fold; None where too little is left."""
        held: NDArray[np.bool_] = np.asarray(fold.held, bool)
        p = self.problem
        least = min((int(np.sum(~held & (p.joint == j))) for j in np.unique(p.joint[held])), default=0)
        if held.sum() < LEAST_TEST or least < LEAST_TRAIN:
            return None
        bare, whole = (fitted(p, a, ~held) for a in ((), active))
        before, after = (np.sum(c.gap()[held] ** 2, axis=1) for c in (bare, whole))
        noise, excused = p.scatter[held] ** 2, 0.0
        there, delays = p.part(held), delays_of(whole.active)
        for one in whole.active:
            columns = column_of(there, one, delays)
            excused += float(np.mean(np.einsum("ni,ij,nj->n", columns, one.covariance, columns)))
        return HeldOut(fold, float(before.mean()), float(after.mean()), float(noise.mean()), before, after, noise, excused)

    def predict(self, sealed: JointLog, active: tuple[Active, ...]) -> Sealed:
        """Link angles (r, m) rad of the m joints of this channel at the instants of a log without link side, thinned as all
        logs are."""
        bare, other = self.with_active(()), self.with_active(active)
        joints = np.array(list(self.problem.noise))
        signals = signals_of(replace(sealed, link=sealed.q), self.problem.robot, self.problem.payload)
        n = len(signals.log)
        arm = encoder_rows(signals, self.problem.robot, self.problem.payload)
        row, joint = np.repeat(np.arange(n), len(joints)), np.tile(joints, n)
        there = replace(self.problem, signals=signals, arm=arm, row=row, joint=joint)
        kept = [k for k, name in enumerate(nuisance_names(self.problem)) if " run " not in name]
        same = [k for k, name in enumerate(nuisance_names(there)) if " run " not in name]
        columns = nuisance_sensitivities(there)[:, same]
        motor = signals.log.q[:, joints - 1]
        baseline = motor + (columns @ bare.theta[kept]).reshape(n, -1)
        corrected = motor + (columns @ other.theta[kept] + shift_of(there, other.active)).reshape(n, -1)
        sigma = np.array([np.hypot(self.problem.noise[int(j)].quick, self.problem.noise[int(j)].slow) for j in joints])
        return Sealed(baseline, corrected, np.broadcast_to(sigma, baseline.shape))


def fitted(problem: EncoderProblem, active: tuple[Active, ...], rows: NDArray[np.bool_]) -> JointChannel:
    """The channel of all readings with what fits those of a mask best."""
    theta, active = fit_encoders(problem.part(rows), active)
    return JointChannel(problem, theta, active)


def joint_channel(log: JointLog, robot: Robot, payload: Hanging, stated: bool = False) -> JointChannel:
    """The channel of a log, without effects; `stated`: the robot's stiffness is the cell's own, not a catalogue's."""
    signals = signals_of(log, robot, payload)
    noise = {j: noise_of(signals, j) for j in log.joints}
    row = np.concatenate([np.flatnonzero(noise[j].good) for j in noise])
    joint = np.concatenate([np.full(int(noise[j].good.sum()), j) for j in noise])
    lost = sum(
        int(np.sum(np.isfinite(signals.log.link[:, j - 1]) & signals.moving(j) & signals.inside() & np.logical_not(n.good)))
        for j, n in noise.items()
    )
    notices = (f"{log.path.name}: {lost} readings are far off their neighbours and not counted",) if lost else ()
    compliance = {j: float(1.0 / robot.stiffness[j - 1]) for j in noise if robot.stiffness[j - 1] > 0}
    springs = {j: (c, SPRING_SHARE * c if stated else CATALOGUE_SPRING_SD) for j, c in compliance.items()}
    arm = encoder_rows(signals, robot, payload)
    problem = EncoderProblem(signals, arm, robot, payload, noise, row, joint, springs, notices)
    return fitted(problem, (), np.ones(len(row), bool))
