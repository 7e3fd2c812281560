"""The contact side of a calibration: a force log in, registrations and stiffnesses with their joint covariance out."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ocp.calibrate.force.assessment import HeldOutForce, directions_seen, held_out_blocks, not_identified
from ocp.calibrate.force.fit import BIAS, FIT_NAMES, ForceSolution, force_prior, reading_of, solve_force_log
from ocp.calibrate.force.log import Flags, ForceLog, log_mark, refuse_few_rows
from ocp.calibrate.force.noise import GROSS
from ocp.calibrate.force.rows import ForceSetup, prepare_force
from ocp.model.cell import Cell
from ocp.model.theta import believed_theta
from robots.calibration.carried import FORCE, UPDATE, carried_over
from robots.calibration.parameters import MDH_NAMES
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.pose import Array

RECORDINGS = "recordings"  # key of a calibration's provenance.force: the log's mark
SIGMAS = 5.0  # an innovation beyond this many is told to the user

MISSED = 0.5  # of the force that presses: at two sigma wheel and blade would part
PLACED, SAME_PLACE = 3, 0.05  # fits, and N within which the contact solved where one ended is the one that it was made with
RUNS_APART = 0.1  # of the force asked for; 0.05 mm of an arm on a flange of 6 N/mm are 0.3 N


@dataclass(frozen=True)
class ForceFigures:
    """Of the rows in contact, N: rms and mean of measured minus predicted, before (at the prior's mean) and after; sigma of
    a reading, what the fit left beyond it, standard deviation of the runs' offsets; rows, independent readings they are worth,
    rows in the air, outliers."""

    rms_before: float
    mean_before: float
    rms_after: float
    mean_after: float
    max_after: float
    sigma: float
    gap_before: float
    gap_after: float
    run_offset: float
    rows: int
    independent: float
    air_rows: int
    outliers: int


@dataclass(frozen=True)
class ForceFit:
    """A fitted force log: solution, figures, held-out errors by way of cutting the log, what cannot be told, notices."""

    log: ForceLog
    setup: ForceSetup
    solution: ForceSolution
    figures: ForceFigures
    held_out: dict[str, list[HeldOutForce]]
    not_identified: dict[str, str]
    notices: tuple[str, ...]
    known: tuple[str, ...] = field(repr=False, default=())

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameters of the joint posterior: the robot's as handed in and all of the contact that the cell leaves open."""
        sd = np.sqrt(np.diag(self.solution.prior.covariance))
        return tuple(n for n, s in zip(FIT_NAMES, sd, strict=True) if n in self.known or s > 0)

    @property
    def values(self) -> Array:
        """Estimates in the order of `names`, SI."""
        return self.solution.x[self._at]

    @property
    def covariance(self) -> Array:
        """Joint covariance in the order of `names`, robot and contact with their cross-covariances."""
        return self.solution.covariance[np.ix_(self._at, self._at)]

    @property
    def _at(self) -> list[int]:
        return [FIT_NAMES.index(name) for name in self.names]

    @cached_property
    def predicted(self) -> tuple[Array, Array]:
        """Reading (n,) N and one sigma (n,) N of its noise-free value for the log's own rows."""
        return self.solution.reading, self.sd(self.solution.jacobian, self.log.contact)

    def sd(self, J: Array, contact: Flags) -> Array:
        """One sigma (n,) N of noise-free readings whose derivatives are J (n, m); offsets of runs count where in contact."""
        variance = np.einsum("ni,ij,nj->n", J, self.solution.covariance, J) + contact * self.solution.allowed**2
        return np.sqrt(np.maximum(variance, 0.0))

    def calibration(self, robot: Calibration | None = None) -> Calibration:
        """`robot`'s calibration with the contact in it: joint values and covariance; parameters that the force log knows
        nothing of (the measuring frame) stay as they were, uncorrelated with the rest only where they were so."""
        cell = self.setup.model.cell
        reasons = self.not_identified if robot is None else robot.not_identified | self.not_identified
        provenance = {} if robot is None else dict(robot.provenance)
        known = provenance.get(FORCE, {})  # an update's log is in its history: what the first was made from stays
        kept = known.get(RECORDINGS) if isinstance(known, dict) else None
        provenance[FORCE] = {**vars(self.figures), **told_of(self.log)} | ({RECORDINGS: kept} if kept else {})
        own = Calibration(cell.robot.name, self.names, self.values, self.covariance, provenance, reasons, self.notices)
        return carried_over(own, robot)


def told_of(log: ForceLog, known: Calibration | None = None) -> dict[str, Any]:
    """What a calibration remembers of its log: how its recordings are told again, and those of the logs that a calibration
    `known`, from which it goes on, was found by; the log's last clock s."""
    marks = " ".join([*({} if known is None else dict.fromkeys(marks_of(known))), log_mark(log)])
    return {RECORDINGS: marks} | ({} if log.clock is None else {"clock_s": float(log.clock.max())})


def marks_of(calibration: Calibration) -> list[str]:
    """Marks of the logs that a calibration, and the updates since, were made from; an edited one may have none."""
    first, since = (calibration.provenance.get(key) for key in (FORCE, UPDATE))
    found = [first.get(RECORDINGS)] if isinstance(first, dict) else []
    logs = since.get("logs") if isinstance(since, dict) else None
    return [mark for mark in [*found, *(logs if isinstance(logs, list) else [])] if isinstance(mark, str)]


def fit_force(cell: Cell, log: ForceLog, robot: Calibration | None = None, setup: ForceSetup | None = None) -> ForceFit:
    """Fit a force log of `cell`, jointly with the posterior `robot` of its arm (default: the cell's own calibration).

    `setup` from `prepare_force(cell, [log, ...])` saves preparing again; the log must be its first. Raises BadInput: as
    `refuse_few_rows`; it and Infeasible: as `prepare_force` and `solve_force_log`.
    """
    refuse_few_rows(log)
    if setup is None:
        setup = prepare_force(cell, [log])
    calibration = cell.calibration if robot is None else robot
    prior = force_prior(cell, robot)
    joints, theta = believed_theta(replace(cell, calibration=calibration)).joint_noise, prior.mean[:BIAS]
    for _ in range(PLACED):  # where the blade departs from the wheel's law goes with where it is
        setup = setup.at(theta)
        solution, rows = solve_force_log(setup.model, setup.rows[0], log, prior, joints), setup.rows[0]
        theta = solution.x[:BIAS]
        anew = reading_of(setup.model, setup.at(theta).rows[0], solution.x, solution.reading - solution.x[BIAS])[1]
        off = float(np.abs(anew - solution.reading)[log.contact].max(initial=0.0))
        if off < SAME_PLACE:
            break
    else:
        told = f"{log.path.name}: the force near the blade's edges is known to {off:.2f} N: the fit moves it as it is solved anew"
        setup = replace(setup, notices=(*setup.notices, told))
    figures = _figures(solution, log)
    known = () if calibration is None else calibration.names
    notices = (*log.notices, *setup.notices, *_notices(cell, log, solution, figures, calibration))
    return ForceFit(log, setup, solution, figures, held_out_blocks(solution, log, rows), not_identified(solution), notices, known)


def refuse_other_force(cell: Cell, fit: ForceFit) -> None:
    """Raises Infeasible: readings that the fit misses by as much as a contact that holds cannot scatter; on a force flange, runs
    that differ by more than its springs and an arm's repeatability can make."""
    log, differ, pressed = fit.log, fit.figures.run_offset, float(np.median(fit.log.fn[fit.log.contact]))
    if (missed := fit.figures.sigma) > MISSED * pressed:
        raise Infeasible(
            f"{log.path}: the best fit misses the readings by {missed:.3g} N (one standard deviation) where {pressed:.3g} N "
            "press: they are not of this cell; compare its wheel, blade and force flange with those that were used, and fn_N "
            "with the axes of its rows"
        )
    if cell.flange is None:
        return
    asked = cell.flange.setpoint if log.setpoint is None else float(np.median(log.setpoint[log.contact]))
    # A setting ten times too large excuses no difference: what was pressed with counts too.
    if asked > 0 and differ > RUNS_APART * min(asked, max(pressed, cell.flange.setpoint)):
        raise Infeasible(
            f"{log.path}: runs differ by {differ:.3g} N (one standard deviation) where {asked:.3g} N were asked for, which no "
            "flange cell does; compare fn_N with setpoint_N: both in newtons, of the same runs, of this cell"
        )


def _figures(solution: ForceSolution, log: ForceLog) -> ForceFigures:
    at = log.contact
    before, after = log.fn[at] - solution.before[at], log.fn[at] - solution.reading[at]
    kept = solution.channel.weight[at] > GROSS
    noise = float(np.mean(solution.channel.sigma()[at] ** 2))

    def rms(x: Array) -> float:
        return float(np.sqrt(np.mean(x**2)))

    def gap(x: Array) -> float:
        return float(np.sqrt(max(rms(x[kept]) ** 2 - noise, 0.0)))

    nominal = np.abs(solution.whitened.residual) / np.sqrt(solution.channel.weight)
    sizes = rms(before), float(before.mean()), rms(after), float(after.mean()), float(np.abs(after).max())
    beyond = float(np.sqrt(noise)), gap(before), gap(after), solution.offset
    counts = int(at.sum()), solution.channel.independent(), int((~at).sum()), int((nominal > SIGMAS).sum())
    return ForceFigures(*sizes, *beyond, *counts)


def _notices(
    cell: Cell, log: ForceLog, solution: ForceSolution, figures: ForceFigures, calibration: Calibration | None
) -> Sequence[str]:
    notices = []
    name = log.path.name
    if calibration is None or not set(MDH_NAMES) & set(calibration.names):
        notices.append(f"{name}: no calibration of the arm beside the force log: the cell's arm with wide doubts is taken")
    if not figures.air_rows:
        notices.append(f"{name}: no air run: the sensor's bias cannot be told from the flange's setpoint and the wheel's place")
    if figures.run_offset > 0:
        notices.append(
            f"{name}: runs differ by {figures.run_offset:.2f} N (one standard deviation) beyond noise and model; the fit allows "
            "for it and is less sure; something differs between the runs that the model does not have"
        )
    if figures.outliers:
        notices.append(f"{name}: {figures.outliers} readings lie more than {SIGMAS:g} sigma off and count little")
    count, gain = directions_seen(solution)
    notices.append(
        f"{name}: the log narrows {count} of {len(gain)} directions of what is unknown to less than half, the best "
        f"{gain[0]:.0f}-fold"
    )
    if cell.flange is None:
        return notices
    setpoint = cell.flange.setpoint if log.setpoint is None else log.setpoint
    force = solution.reading - solution.x[BIAS]
    stroke = float(np.abs((force - setpoint)[log.contact]).max() / cell.flange.stiffness)
    if stroke > 0.5 * cell.flange.stroke:
        notices.append(
            f"{name}: the flange's stroke reaches {1e3 * stroke:.1f} mm from its middle, it has {5e2 * cell.flange.stroke:.1f}; "
            "beyond it the model is wrong"
        )
    return notices
