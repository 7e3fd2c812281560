"""The channel of link-side encoders: link angle less motor angle as a fit of offsets, believed springs, effects and delays.

    link_j(t) = q_j(t - s_j) + offset_(j, run) + c_j tau_j - v_j dq_j/dt - k_j sign(dq_j/dt) - m_j d2q_j/dt2
                + sum over effects of columns_j(t) a                                                                    (1)

with q the motor side and tau the load. The believed springs c are nuisance, as everywhere: as good as `SPRING_SHARE` where the
cell states them, hardly known where they come from a catalogue; joints without a spring are rigid. v, k and m are what a
recorded motor torque holds of the drive's own viscous and dry friction and of its rotor, which load no spring; m also what the
believed inertia lacks where no torque was recorded. The evidence allows for them, the fit leaves them at zero, so that they
cannot pass a delay off as friction. Only the delay s is not linear; Gauss-Newton steps about it.

A link-side encoder sees what lies between motor and link: effects' hooks `joint`, and `torque` through the joint's spring where
the load was not recorded (a recorded load holds every weight already). The delay is the encoder's own: the motor's angle of a
moment ago is what the link shows now, column -speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ocp.diagnose.engine.channel_system import SCALE, UNSEEN, Fold, HeldOut, ReadingConditions, Sealed, System, Variants
from ocp.diagnose.joints.log import JointLog
from ocp.diagnose.joints.signals import EncoderNoise, Signals, blocks, factors, noise_of, signals_of, whiten_blocks
from ocp.diagnose.rules import CATALOGUE_SPRING_SD, CATALOGUE_SPRING_SHARE, DRIVE_SD, SPRING_SHARE
from ocp.effects.effect import Active, Effect, Scanned, Surroundings, coefficients, prior_sds, with_coefficients
from ocp.effects.engine.compiled import Hook, evaluated
from ocp.effects.engine.evaluate import ARM_LAYOUT, ArmRows, arm_rows
from ocp.effects.motor_harmonic import ratios_of
from robots.calibration.reading_model import RowInputs
from robots.compliance import compliance_from_stiffness
from robots.gauss_newton import Rule, linear_step, minimise
from robots.pose import Array, Index, Mask
from robots.robot import Robot
from robots.tracker_readings import Hanging

STEPS = 4
RANK = 1e-12  # of the largest singular value; what the readings say less of stays where it is
DELAY = "channel_delay"


def seen_by_encoder(effect: Effect) -> bool:
    """Whether a link-side encoder can see the effect at all."""
    return effect.joint is not None or effect.torque is not None


def encoder_rows(signals: Signals, robot: Robot, payload: Hanging) -> ArmRows:
    """The arm at the instants of a log: the believed arm with the recorded loads in place of its own."""
    n = len(signals.log)
    none = np.zeros((n, 3))
    hung = np.broadcast_to([payload.mass, *payload.com], (n, 4))
    arm = np.concatenate([robot.mdh.ravel(), compliance_from_stiffness(robot.stiffness)])
    inputs = RowInputs(signals.log.q, hung, np.zeros((n, 6)), none, none)
    rows = arm_rows(
        robot, arm, inputs, ("",), approach=signals.direction, warm=np.zeros(n), time=signals.log.time, speed=signals.qd
    )
    rows.state[:, ARM_LAYOUT.places["tau"]] = signals.tau
    return rows


@dataclass(frozen=True)
class EncoderNuisance:
    """Unknowns that are no effects: names, prior mean and sd (p,) (sd infinite: free), sensitivities (readings, p) of the gap."""

    names: tuple[str, ...]
    mean: Array
    sd: Array
    columns: Array


def offset_of(joint: int, run: str) -> str:
    """Name of the offset of a joint in a run."""
    return f"offset {joint} run {run}"


@dataclass(frozen=True)
class EncoderProblem:
    """What the log is, apart from what is fitted: signals, arm at its instants, robot, payload, noise by joint, the readings as
    pairs (row of the signals, joint 1..6), and springs by joint: compliance rad/(N m) and its one sigma; effects
    that the cell believes."""

    signals: Signals
    arm: ArmRows
    robot: Robot
    payload: Hanging
    noise: dict[int, EncoderNoise]
    row: Index
    joint: Index
    springs: dict[int, tuple[float, float]]
    notices: tuple[str, ...] = ()
    believed: tuple[Active, ...] = ()

    @property
    def measured(self) -> Array:
        """Link less motor angle (n,) rad of the readings."""
        log = self.signals.log
        return np.asarray((log.link - log.q)[self.row, self.joint - 1])

    @property
    def scatter(self) -> Array:
        """Noise (n,) rad from instant to instant."""
        return np.array([self.noise[j].floor for j in self.joint])

    def delay_column(self, joint: int, delays: Array) -> Array:
        """Gap (readings, 1) rad per s of delay of one joint's link side (0: of all), about the delays (6,) s."""
        out = np.zeros((len(self.row), 1))
        for j in self.signals.log.joints:
            if joint in (0, j):
                at = self.joint == j
                out[at, 0] = -self.signals.motor(j, float(delays[j - 1]), 1)[self.row[at]]
        return out

    def columns(self, effect: Effect, joint: int, scans: Sequence[Scanned], delays: Array) -> Array:
        """Sensitivities (variants, readings, m) rad of the gap in an effect's coefficients, about the delays (6,) s; a recorded
        load holds all torques."""
        if effect.name == DELAY:
            return np.stack([self.delay_column(joint, delays)] * len(scans))
        arm, total = self.arm, np.zeros((len(scans), len(self.arm), 6, effect.size))
        shares = {"joint": np.ones((len(arm), 6)), "torque": arm.block("c") * np.where(self.signals.measured, 0.0, 1.0)}
        for kind, share in shares.items():
            if getattr(effect, kind) is not None:
                made = evaluated(Hook(effect, kind, joint, ARM_LAYOUT, arm.place), arm.state, scans)[-1]
                total += share[None, :, :, None] * made
        return np.asarray(total[:, self.row, self.joint - 1])

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
            out[at] = whiten_blocks(roots, columns[at])
        return out

    @cached_property
    def nuisance(self) -> EncoderNuisance:
        """An offset a joint and run, free: an encoder may be set to zero anew before any recording, which is no gap; friction
        and rotors in recorded torques; springs."""
        s, log = self.signals, self.signals.log
        mine = {j: self.joint == j for j in self.noise}
        runs = [(name, log.run[self.row] == k) for k, name in enumerate(log.runs)]
        found = [(offset_of(j, name), 0.0, np.inf, (at & run).astype(float)) for j, at in mine.items() for name, run in runs]
        loaded = {j: at for j, at in mine.items() if s.measured[j - 1]}
        for kind, motion, those in (("viscous", s.viscous, loaded), ("dry", s.dry, loaded), ("inertia", s.qdd, mine)):
            for j, at in those.items():
                found.append((f"{kind} {j}", 0.0, DRIVE_SD[kind], np.where(at, -motion[self.row, j - 1], 0.0)))
        for j, (compliance, sd) in self.springs.items():
            found.append((f"spring {j}", compliance, sd, np.where(mine[j], s.tau[self.row, j - 1], 0.0)))
        names, mean, sds, columns = zip(*found, strict=True)
        return EncoderNuisance(names, np.array(mean), np.array(sds), np.stack(columns, axis=1))

    def places_in(self, names: Sequence[str]) -> Array:
        """Values (p,) of this log's nuisance as a linear map (p, len(names)) of another log's: by name, and a run that the other
        log does not have takes the mean of the runs that it has."""
        found = np.zeros((len(self.nuisance.names), len(names)))
        for k, name in enumerate(self.nuisance.names):
            head = name.partition(" run ")[0]
            like = [i for i, other in enumerate(names) if other == name] or [
                i for i, other in enumerate(names) if " run " in name and other.partition(" run ")[0] == head
            ]
            found[k, like] = 1.0 / max(len(like), 1)
        return found

    def without_new_zeros(self, gap: Array, known: Mask) -> Array:
        """Gap (n,) rad with the mean taken out of every joint and run that has none of the readings `known` (n,): its zero is
        free, and what was fitted to those says nothing of it."""
        group = self.joint * len(self.signals.log.runs) + self.signals.log.run[self.row]
        out = gap.copy()
        for one in np.setdiff1d(group, group[known]):
            out[group == one] -= gap[group == one].mean()
        return out

    def part(self, rows: Mask) -> "EncoderProblem":
        """The readings of a mask."""
        return replace(self, row=self.row[rows], joint=self.joint[rows])


def delays_of(problem: EncoderProblem, active: Sequence[Active]) -> Array:
    """Delay (6,) s of each link side, believed ones in."""
    out = np.zeros(6)
    for one in (*problem.believed, *active):
        if one.effect.name == DELAY:
            out[slice(None) if one.joint == 0 else one.joint - 1] += one.a[0]
    return out


def shift_of(problem: EncoderProblem, active: Sequence[Active]) -> Array:
    """Link less motor angle (n,) rad that the effects explain, believed ones in."""
    signals = problem.signals
    total = np.zeros(len(problem.row))
    delays = delays_of(problem, active)
    for j in np.flatnonzero(delays) + 1:
        at = problem.joint == j
        total[at] += (signals.motor(int(j), float(delays[j - 1])) - signals.log.q[:, j - 1])[problem.row[at]]
    for one in (*problem.believed, *active):
        if one.effect.name != DELAY:
            total += column_of(problem, one, delays) @ one.a
    return total


def column_of(problem: EncoderProblem, one: Active, delays: Array) -> Array:
    """Columns (n, m) of an active effect about the present delays."""
    return np.asarray(problem.columns(one.effect, one.joint, [one.scanned], delays)[0])


@dataclass(frozen=True)
class _Point:
    """A point of the search (`robots.gauss_newton`): nuisance theta (p,), effects, mean and scale of all unknowns, columns (n, p)
    of the nuisance, and the same whitened."""

    problem: EncoderProblem
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
        delays = delays_of(self.problem, self.active)
        effects = [self.problem.whitened(column_of(self.problem, one, delays)) for one in self.active]
        return self.residual(), np.column_stack([self.white, *effects]) * self.scale

    def moved(self, change: Array) -> "_Point":
        step, p = self.scale * change, len(self.theta)
        return replace(
            self, theta=self.theta + step[:p], active=with_coefficients(self.active, coefficients(self.active) + step[p:])
        )


LEAST_TRAIN, LEAST_TEST = 60, 20  # readings on each side of a fold
HAVE = frozenset({"approach", "time_s", "tau", "speed"})  # what a motion log brings by itself
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
    """Every joint's readings there: of one joint's own, what is named of another takes nothing, and promises nothing."""
    row = problem.row
    mine = row[problem.joint == j]
    middle, fast = float(np.median(q[mine])), float(np.median(np.abs(qd[mine])))
    found = [Fold(f"q{j}>{np.degrees(middle):.0f}deg", "joint range", (q > middle)[row])]
    if (direction < 0).any() and (direction > 0).any():
        found.append(Fold(f"direction{j}=-", "approach", (direction < 0)[row]))
    found.append(Fold(f"speed{j}>{np.degrees(fast):.0f}deg/s", "speed", (np.abs(qd) > fast)[row]))
    return found


@dataclass(frozen=True)
class JointChannel:
    """Link-side encoders fitted: nuisance theta (p,) (offsets rad, believed springs rad/(N m)), active effects."""

    problem: EncoderProblem
    theta: Array
    active: tuple[Active, ...] = ()
    name: str = "joint"
    unit: str = "arcsec"

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
        return SCALE[self.unit] * float(np.sqrt(np.mean(self.problem.scatter**2)))

    @property
    def surroundings(self) -> Surroundings:
        """Ranges of the joints, times, the arm's own size."""
        log = self.problem.signals.log
        return Surroundings.of(self.problem.robot, log.q, log.time)

    @cached_property
    def system(self) -> System:
        """Whitened about the current fit."""
        nuisance = self.problem.nuisance
        white = self.problem.whitened(np.column_stack([self.gap()[:, 0], nuisance.columns]))
        offset = self.theta - nuisance.mean
        return System(white[:, 0], white[:, 1:], nuisance.sd, offset, np.arange(len(white), dtype=np.int64))

    def blind(self, effect: Effect) -> str:
        """Why the channel cannot see an effect; empty where it can."""
        if not seen_by_encoder(effect):
            return f"{effect.name}: no link-side encoder sees it"
        lacking = [need for need in effect.needs if need not in HAVE]
        return f"joints.csv has no column {lacking[0]}: {effect.name} cannot be seen" if lacking else ""

    def variants(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None = None) -> Variants:
        """Whitened columns of an effect; none at a joint without a link side."""
        if self.blind(effect):
            return UNSEEN
        p = self.problem
        if effect.name == DELAY and joint and (joint not in p.noise or len(p.noise) == 1):
            return UNSEEN  # the delay of an only joint is the common one
        chosen = tuple(effect.scan(joint, self.surroundings) if scans is None else scans)
        raw = p.columns(effect, joint, chosen, delays_of(p, self.active)) if chosen else np.zeros(0)
        if not raw.any():
            return UNSEEN
        return chosen, p.whitened(np.hstack(list(raw))).reshape(len(p.row), len(chosen), effect.size)

    def with_active(self, active: tuple[Active, ...]) -> "JointChannel":
        """Offsets and coefficients refitted jointly. The noise stays: it was not taken from the gap."""
        return fitted(self.problem, active, np.ones(len(self.problem.row), bool))

    def gap(self) -> Array:
        """Link angle less predicted, (n, 1) rad."""
        p = self.problem
        return (p.measured - p.nuisance.columns @ self.theta - shift_of(p, self.active))[:, None]

    def whiten(self, changes: Array) -> Array:
        """Whitened rows of changes (n, 1, m) rad."""
        return self.problem.whitened(np.asarray(changes)[:, 0])

    def folds(self) -> list[Fold]:
        """Time blocks, runs, halves of a joint's range, directions, speeds."""
        return joint_folds(self.problem)

    def held_out(self, fold: Fold, active: tuple[Active, ...]) -> HeldOut | None:
        """Judge `active` on a fold; None where too little is left."""
        held: Mask = np.asarray(fold.held, bool)
        p = self.problem
        least = min((int(np.sum(~held & (p.joint == j))) for j in np.unique(p.joint[held])), default=0)
        if held.sum() < LEAST_TEST or least < LEAST_TRAIN:
            return None
        bare, whole = (fitted(p, a, ~held) for a in ((), active))
        before, after = (p.without_new_zeros(c.gap()[:, 0], ~held)[held] ** 2 for c in (bare, whole))
        there = p.part(held)
        columns = there.nuisance.columns
        less, more = (float(_unsure_of(c, p.part(~held), there, columns, rubs=False)[0].mean()) for c in (bare, whole))
        return HeldOut(fold, np.stack([before, after, p.scatter[held] ** 2]), max(more - less, 0.0))

    def predict(self, sealed: JointLog, active: tuple[Active, ...]) -> Sealed:
        """Link angles (r, m) rad of the m joints of this channel at the instants of a log without link side; inside: where the
        angle and the speed of each of them lie in the range of this channel's log."""
        bare, other = self.with_active(()), self.with_active(active)
        joints, order = np.array(list(self.problem.noise)), np.argsort(sealed.run, kind="stable")
        asked = replace(sealed.take(order), link=np.full_like(sealed.link, np.nan))  # of a measured log too every row
        signals = signals_of(asked, self.problem.robot, self.problem.payload, self.problem.signals)
        arm, n = encoder_rows(signals, self.problem.robot, self.problem.payload), len(order)
        row, joint = np.repeat(np.arange(n), len(joints)), np.tile(joints, n)
        there = replace(self.problem, signals=signals, arm=arm, row=row, joint=joint)
        columns, place = there.nuisance.columns, there.places_in(self.problem.nuisance.names)
        told = [columns @ (place @ c.theta) + shift_of(there, c.active) for c in (bare, other)]
        baseline, corrected = (signals.log.q[:, joints - 1] + shift.reshape(n, -1) for shift in told)
        noise = np.array([np.linalg.norm([one.quick, one.slow, one.fast]) for one in self.problem.noise.values()])
        variance, change = _unsure_of(other, self.problem, there, columns @ place, rubs=True)
        fitted_to = (variance + change**2).reshape(n, -1)
        # Where nobody measured, what the effects change is not known better than by its own size.
        inside = self._inside(joints, signals)
        unsure = np.where(inside[:, None], 0.0, np.abs(corrected - baseline))
        sigma = np.sqrt(noise**2 + self._anew(joints, signals.log) ** 2 + unsure**2 + fitted_to)
        back = np.argsort(order)  # as the file has them
        return Sealed(baseline[back], corrected[back], sigma[back], inside=inside[back])

    def _inside(self, joints: Index, signals: Signals) -> Mask:
        """Rows (n,) in which angle and speed of all joints lie where this channel's log has them."""
        there, here = (np.hstack([s.log.q[:, joints - 1], s.qd[:, joints - 1]]) for s in (signals, self.problem.signals))
        return np.asarray(((there >= here.min(axis=0)) & (there <= here.max(axis=0))).all(axis=1))

    def _anew(self, joints: Index, log: JointLog) -> Array:
        """One sigma (n, m) rad of the zeros of `joints` in a log: what known runs differ by, where a run is none of them."""
        runs = self.problem.signals.log.runs
        zero = [self.theta[[self.problem.nuisance.names.index(offset_of(int(j), name)) for name in runs]] for j in joints]
        spread = np.array([z.std(ddof=1) if len(z) > 1 else 0.0 for z in zero])
        return np.asarray(np.array([name not in runs for name in log.runs])[log.run][:, None] * spread)


def rubbing(nuisance: EncoderNuisance) -> Mask:
    """Which (p,) are the drive's own, or inertia: the evidence allows for them, the fit leaves them at zero."""
    return np.array([name.split()[0] in DRIVE_SD for name in nuisance.names])


def _unsure_of(at: JointChannel, known: EncoderProblem, new: EncoderProblem, nuisance: Array, rubs: bool) -> tuple[Array, Array]:
    """Of what a fit to the readings `known` predicts of `new` ones, with sensitivities nuisance (n, p) to its own: variance (n,)
    rad^2 of the unknowns, all together, and change (n,) rad to come; `rubs`: if friction were as the readings have it."""
    own, delays, active = known.nuisance, delays_of(known, at.active), at.active
    there_is = np.where(rubbing(own), float(rubs), 1.0)
    sd = np.append(own.sd, prior_sds(active))
    offset = np.append(at.theta - own.mean, coefficients(active))
    held = np.isfinite(sd)
    scale = np.where(held, sd, 1.0)
    left = known.measured - own.columns @ at.theta - shift_of(known, active)
    here = np.column_stack([left, own.columns * there_is, *(column_of(known, one, delays) for one in active)])
    white = known.whitened(here)
    far = np.column_stack([nuisance * there_is, *(column_of(new, one, delays) for one in active)]) * scale
    step = linear_step(white[:, 0], white[:, 1:] * scale, offset / scale, held.astype(float), RANK)
    return np.einsum("np,pq,nq->n", far, step.covariance, far, optimize=True), far @ step.change


def fitted(problem: EncoderProblem, active: tuple[Active, ...], rows: Mask) -> JointChannel:
    """The channel of all readings with the nuisance and the effects' values, with their covariance, that fit those of a mask
    best."""
    part = problem.part(rows)
    nuisance, p = part.nuisance, len(part.nuisance.names)
    mean = np.append(nuisance.mean, np.zeros(len(coefficients(active))))
    sd = np.append(nuisance.sd, prior_sds(active))
    known = np.isfinite(sd)
    scale = np.where(known, sd, 1.0)
    columns = np.where(rubbing(nuisance), 0.0, nuisance.columns)
    moving = any(one.effect.name == DELAY for one in active)
    start = _Point(part, mean[:p], active, mean, scale, columns, part.whitened(columns))
    found = minimise(start, known.astype(float), Rule(STEPS if moving else 1, rank=RANK))
    covariance = scale[:, None] * found.last.covariance * scale
    at = found.at
    return JointChannel(problem, at.theta, with_coefficients(at.active, coefficients(at.active), covariance[p:, p:]))


def joint_channel(
    log: JointLog, robot: Robot, payload: Hanging, stated: bool = False, believed: tuple[Active, ...] = ()
) -> JointChannel:
    """The channel of a log, without effects but those `believed`; `stated`: the robot's stiffness is the cell's own, not a
    catalogue's."""
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
    sd = {j: SPRING_SHARE * c if stated else max(CATALOGUE_SPRING_SD, CATALOGUE_SPRING_SHARE * c) for j, c in compliance.items()}
    springs = {j: (c, sd[j]) for j, c in compliance.items()}
    arm = encoder_rows(signals, robot, payload)
    problem = EncoderProblem(signals, arm, robot, payload, noise, row, joint, springs, notices, believed)
    return fitted(problem, (), np.ones(len(row), bool))
