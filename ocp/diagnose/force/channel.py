"""The grinding-force log as a channel: believed contact refitted, effects' columns, refits with effects inside."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ocp.calibrate.force.fit import of_another_cell, pressed_rows
from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.noise import Whitener
from ocp.calibrate.force.rows import ForceSetup, LogConditions, log_conditions, prepare_force
from ocp.diagnose.engine.channel_system import UNSEEN, Fold, HeldOut, ReadingConditions, Sealed, System, Variants, Wave
from ocp.diagnose.force.fit import EffectFit, ForceProblem, fit_effects, linear
from ocp.diagnose.force.held_out import Asked, force_fold_errors, force_folds, predict_sealed_force
from ocp.diagnose.force.log_averages import LogAverages, log_averages
from ocp.diagnose.force.logged_contact import logged_arm
from ocp.diagnose.force.prediction import LogScene, M, acts_by_force, effect_derivatives, force_changes
from ocp.diagnose.force.prior import arm_with_effects, contact_prior, with_setpoints_read_off
from ocp.diagnose.force.waves import SpliceTrains, likely_trains, picked_squares, telling_waves
from ocp.diagnose.rules import LEAST_DIRECTION, LOOSE, ORDERS_APART, RAN_OFF
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.effects.belt_splice import EFFECT as SPLICE
from ocp.effects.catalogue import library
from ocp.effects.cell_effects import effect_of
from ocp.effects.effect import Active, Effect, Scanned, Surroundings, effects_key
from ocp.effects.flange_friction import EFFECT as FRICTION
from ocp.effects.motor_harmonic import ratios_of
from ocp.model.cell import Cell, with_calibration
from robots.calibration.carried import FORCE
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.gravity import weight_torques
from robots.pose import Array, Mask

TOGETHER = 48  # variants evaluated at once
# What columns a need of an effect stands for, where they are not called alike.
NEEDED = dict.fromkeys(("approach", "speed"), "q1_deg to q6_deg with time_s")
# Columns that the library-free tests see as the log has them, and as its conditions have them.
OF_LOG = ("q", "temperature", "wheel_temperature", "run", "line", "feed", "setpoint", "belt")
OF_CONDITIONS = ("approach", "time", "s", "travel")


@dataclass(frozen=True)
class ForceChannel:
    """A force log with the fit of the believed contact and of the active effects. `found` keeps the trains of a
    belt's splice that were found at first, `made` the conditions that are to be predicted; known: effects at sizes that other
    signals show too, for what is predicted."""

    problem: ForceProblem
    fit: EffectFit
    effects: tuple[Effect, ...] = field(repr=False, default=())
    before: "ForceChannel | None" = field(default=None, repr=False)
    judged: dict[tuple[object, ...], "ForceChannel"] = field(default_factory=dict, repr=False)
    found: dict[str, SpliceTrains] = field(default_factory=dict, repr=False)
    made: dict[str, Asked] = field(default_factory=dict, repr=False)
    known: tuple[Active, ...] = ()
    tracker: TrackerChannel | None = field(default=None, repr=False)
    name: str = "force"
    unit: str = "N"

    @property
    def log(self) -> ForceLog:
        """As recorded."""
        return self.problem.log

    @property
    def active(self) -> tuple[Active, ...]:
        """Effects in the prediction."""
        return self.fit.active

    @property
    def baseline(self) -> "ForceChannel":
        """The channel without effects."""
        return self if self.before is None else self.before

    @cached_property
    def surroundings(self) -> Surroundings:
        """For the scans."""
        return replace(surroundings(self.problem), splice_trains=self.trains.found, among={SPLICE.name: self.trains.among})

    @cached_property
    def scored(self) -> EffectFit:
        """The fit in rows of even weights, residuals as scores: linear in what is not yet fitted too."""
        fit, even = self.fit, tuple(w.even() for w in self.fit.whiteners)
        share = np.concatenate([w.noise.weight / e.noise.weight for w, e in zip(fit.whiteners, even, strict=True)])
        scores = {"residual": fit.residual * np.sqrt(share)}
        return replace(fit, **vars(linear(self.problem, fit.z, fit.at, even)) | scores, whiteners=even)

    @property
    def trains(self) -> SpliceTrains:
        """Trains of a belt's splice that the readings speak for."""
        if "first" not in self.found:  # what else is fitted later hardly moves them
            self.found["first"] = likely_trains(self.problem, self.scored)
        return self.found["first"]

    @cached_property
    def conditions(self) -> ReadingConditions:
        """What is known of the rows."""
        log, fit = self.log, self.fit
        reads = np.stack(list(fit.at.slope[: len(fit.whiteners)]), axis=1)
        known = replace(logged_conditions(self.problem, log, self.problem.scene.conditions), waves=self.waves)
        ratios, joints = ratios_of(self.surroundings), reads[:, :, None] * fit.slopes[1][:, None]
        return replace(known, d_joints=joints, pressed=reads * log.contact[:, None], gear_ratio=ratios)

    @cached_property
    def waves(self) -> tuple[Wave, ...]:
        """Waves that the readings speak for."""
        return telling_waves(self.problem, self.scored)

    @cached_property
    def averages(self) -> LogAverages:
        """Which rows the system has."""
        return log_averages(self.problem, self.scored, self.effects, self.surroundings, self.waves)

    @cached_property
    def system(self) -> System:
        """Whitened about the current fit; directions of the nuisance turned so that they are independent."""
        averages, fit, (r, o), n = self.averages, self.scored, self.problem.sizes, len(self.log)
        white = np.column_stack([fit.residual, fit.sensitivity[:, : r + o]]).reshape(len(averages.whiteners), n, -1)
        rows = averages.of_whitened(white)
        U, s, Vt = np.linalg.svd(rows[:, 1:], full_matrices=False)
        keep = s > LEAST_DIRECTION
        place = [w.place for w in averages.whiteners]
        return System(
            residual=rows[:, 0],
            nuisance=U[:, keep] * s[keep],
            prior_sd=np.ones(int(keep.sum())),
            offset=(Vt @ fit.z[: r + o])[keep],
            reading=np.concatenate([*place, np.full(averages.patterns.shape[2], place[0][-1])]),
            picked=picked_squares(self.waves) + self.trains.picked,
        )

    @property
    def surprises(self) -> tuple[str, ...]:
        """What of the cell the fit has moved farther than cell and calibration allow, in words."""
        return of_another_cell(self.log, self.fit.information, self.fit.z, self.problem.sizes[0]) if self.fit.rested else ()

    @property
    def noise_floor(self) -> float:
        """Rms of the normal reading's noise, gross readings apart, N."""
        return float(np.sqrt(np.mean(self.fit.whiteners[0].noise.sigma()[self.log.contact] ** 2)))

    @property
    def scatters(self) -> str:
        """So far that the contact would not hold, or that no believed contact comes near."""
        if not self.baseline.fit.rested:
            return "so that the fit of the believed contact finds no rest"
        loose = self.noise_floor > LOOSE * float(np.median(self.log.fn[self.log.contact]))
        return "by more than a contact that holds can" if loose else ""

    @property
    def rests(self) -> bool:
        """Whether the believed contact's fit came to rest."""
        return self.baseline.fit.rested

    def blind(self, effect: Effect) -> str:
        """Why it cannot be seen."""
        if not (effect.on_arm or effect.on_contact):
            return f"{effect.name} does not change the contact or the force readings"
        if self.problem.scene.cell.flange is None and effect.subsystem == "flange":
            return f"{effect.name}: the cell has no force flange"
        lacking = ", ".join(NEEDED.get(c, c) for c in effect.needs if c not in self.problem.scene.conditions.given)
        return f"force.csv has no column {lacking}: {effect.name} cannot be seen" if lacking else ""

    def variants(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None = None) -> Variants:
        """Whitened columns about the current fit."""
        if self.blind(effect):
            return UNSEEN
        chosen, found = self.scan(effect, joint) if scans is None else tuple(scans), list[Array]()
        for start in range(0, len(chosen), TOGETHER):
            some, about = chosen[start : start + TOGETHER], (self.problem.scene, self.fit.at)
            if acts_by_force(*about, effect):
                force = force_changes(*about, self.fit.slopes, effect, joint, some)
                if not np.isfinite(force).all():
                    return UNSEEN
                found.append(self.averages.by_force(force))
            else:
                made = effect_derivatives(*about, self.fit.slopes, effect, joint, some)
                if made is None:
                    return UNSEEN
                found.append(self.averages.variants([*made][: len(self.averages.whiteners)]))
        return (chosen, np.concatenate(found, axis=1)) if found else UNSEEN

    def scan(self, effect: Effect, joint: int) -> tuple[Scanned, ...]:
        """The effect's own scan; orders of ripples that the log's short ranges cannot tell apart are thinned."""
        scans = tuple(effect.scan(joint, self.surroundings))
        if joint and scans and set(scans[0]) == {"order"}:
            return scans[:: max(1, int(ORDERS_APART / max(np.ptp(self.surroundings.q_range[joint - 1]), 1e-3)))]
        return scans

    def with_active(self, active: tuple[Active, ...]) -> "ForceChannel":
        """Refitted with these effects; those that the log cannot show are left out."""
        visible = tuple(a for a in active if not self.blind(a.effect))
        if not visible and self.before is not None:
            return self.before
        moved = [a for a in visible if a.effect.on_arm]
        if self.tracker is not None and (moved or any(a.effect.on_arm for a in self.active)):
            # What bends the readings of the tracker bends what is believed of the arm.
            believed = contact_prior(self.problem.scene.cell, arm_with_effects(self.tracker, moved))
            problem, near = replace(self.problem, believed=believed), None
        else:
            problem, near = self.problem, self.fit
        fit, before = fit_effects(problem, visible, near), self.baseline if visible else None
        found = replace(self, problem=problem, fit=fit, before=before, judged={})
        if found.squares(white := self.baseline.fit.whiteners) > RAN_OFF * self.baseline.squares(white):
            raise Infeasible(
                f"{self.log.path}: with {', '.join(a.effect.name for a in visible)} the fit of the force log runs off"
            )
        return found

    def gap(self) -> Array:
        """Measured less predicted normal reading (n, 1) N."""
        return self.problem.gap(self.fit.at, self.fit.z)[:, None]

    def squares(self, whiteners: Sequence[Whitener]) -> float:
        """Sum of both signals' squared residuals of the fit, whitened by these."""
        left = self.problem.residuals(self.fit.at, self.fit.z)
        return sum(float(np.sum(w.whole(r[:, None]) ** 2)) for w, r in zip(whiteners, left, strict=True))

    def whiten(self, changes: Array) -> Array:
        """Whitened rows (N, m) of changes (n, k, m) N of the readings, fn first, then ft where there is one."""
        own, none = changes.shape[1], np.zeros_like(changes[:, 0])
        return self.averages.rows([changes[:, i] if i < own else none for i in range(len(self.averages.whiteners))])

    def folds(self) -> list[Fold]:
        """Blocked and extrapolation folds."""
        return force_folds(self.log, self.problem.scene)

    def held_out(self, fold: Fold, active: tuple[Active, ...]) -> HeldOut | None:
        """Judge `active` on a fold."""
        after, own = self.fitted_with(active), self.fit.whiteners[0].noise
        return force_fold_errors((self.baseline.problem, self.baseline.fit), (after.problem, after.fit), fold, own)

    def fitted_with(self, active: tuple[Active, ...]) -> "ForceChannel":
        """The channel fitted with these effects, whatever values they come with; kept: promises and predictions ask alike."""
        wanted = effects_key([a for a in active if not self.blind(a.effect)])
        if wanted == effects_key(self.active):
            return self
        if wanted not in self.judged:
            self.judged[wanted] = self.with_active(active)
        return self.judged[wanted]

    def predict(self, sealed: ForceLog, active: tuple[Active, ...]) -> Sealed:
        """Baseline and corrected normal reading (n, 1) N of conditions nobody has seen, one sigma of the corrected one."""
        base, after = self.baseline, self.fitted_with(active)
        return predict_sealed_force((base.problem, base.fit), (after.problem, after.fit), self.asked(sealed), self.known)

    def asked(self, sealed: ForceLog) -> Asked:
        """Conditions made ready, once for all that asks of them. Raises BadInput: points off the blade."""
        kept = self.made.get("asked")
        if kept is None or kept.sealed is not sealed:
            kept = self.made["asked"] = Asked.of(self.log, self.problem.scene, sealed)
        return kept


def force_channel(
    cell: Cell, log: ForceLog, tracker: TrackerChannel | None = None, arm: Calibration | None = None
) -> ForceChannel:
    """The believed contact fitted to a log.

    The arm's prior is `arm`, else what the readings of `tracker` say of the believed arm, else the cell's. Raises BadInput,
    Infeasible: as `prepare_force` and the fit.
    """
    if arm is None and tracker is not None:
        arm = arm_with_effects(tracker, ())
    read_off = None if cell.flange is None else with_setpoints_read_off(log, cell.flange.setpoint)
    log, more = (log, ()) if read_off is None else (read_off[0], read_off[1:])
    if arm is not None:  # the force acts on an arm that bends where the readings say
        cell = replace(cell, compliant_joints=with_calibration(cell, arm).compliant_joints)
    setup = prepare_force(replace(cell, effects=()), [log])
    setup = replace(setup, notices=(*setup.notices, *more))
    problem = problem_of(setup.at(contact_prior(cell, arm).mean[:M]), cell, log, arm)
    fit = fit_effects(problem)
    if cell.flange is None:  # so stiff a contact feels where the fit puts it
        problem = replace(problem, scene=replace(problem.scene, rows=setup.at(fit.at.x[:M]).rows[0]))
        fit = fit_effects(problem, (), fit)
    return ForceChannel(problem, fit, tuple(library().values()), tracker=tracker)


def problem_of(
    setup: ForceSetup, cell: Cell, log: ForceLog, arm: Calibration | None, pressed: Mask | None = None
) -> ForceProblem:
    """The problem of a log that is the first of a setup; pressed (n,): rows that only contact explains, as the readings say."""
    # What may be out of step by now is sought anew: beside a wrong train the true one is two.
    stated = [e.active for e in cell.effects if not e.active.falls_out_of_step]
    held = 0.0 if cell.flange is None else cell.flange.friction
    own_friction = [effect_of({"effect": FRICTION.name, "N": held}).active] if held else []
    effects, cell = [*stated, *own_friction], replace(cell, effects=())
    believed = contact_prior(cell, arm)
    known, theta = log_conditions(cell, log), believed.mean[:M]
    given, own = tuple(a for a in effects if known.given.issuperset(a.effect.needs)), logged_arm(cell, theta, log.q, known)
    pressed = pressed_rows(setup.model, log) if pressed is None else pressed
    scene = LogScene(cell, setup.model, setup.rows[0], known, own, theta, given, pressed)
    return ForceProblem(log, scene, believed, setup.notices)


def surroundings(problem: ForceProblem) -> Surroundings:
    """For the scans of effects."""
    log, c, cell = problem.log, problem.scene.conditions, problem.scene.cell
    clocked = "clock_s" in c.given
    first, last = np.array(sorted((c.clock[c.run == r].min(), c.clock[c.run == r].max()) for r in np.unique(c.run))).T
    breaks = 0.5 * (last[:-1] + first[1:]) if clocked and len(first) > 1 else np.empty(0)
    if clocked and cell.calibration is not None and FORCE in cell.calibration.provenance:
        breaks = np.append(breaks, first[0])  # moved since the calibration; without one it is registration
    ways = c.s[log.contact]
    own = None if cell.tables.workpiece is None else cell.tables.workpiece.payload
    return Surroundings.of(
        cell.robot,
        log.q,
        c.clock if clocked else None,
        payloads=(own,) if own in cell.tables.payloads else (),
        breaks=np.sort(breaks),
        span=(float(ways.min()), float(np.ptp(ways))) if len(ways) else (0.0, 0.0),
        lines=tuple(float(k) for k in np.unique(c.line[log.contact])),
        sides=_sides(log.n[log.contact]),
        friction=cell.wheel.friction,
    )


def logged_conditions(problem: ForceProblem, log: ForceLog, c: LogConditions) -> ReadingConditions:
    """Of the rows of any log in the same cell."""
    scene = problem.scene
    payload = scene.cell.workpiece.payload
    columns: dict[str, Any] = {name: getattr(log, name) for name in OF_LOG} | {name: getattr(c, name) for name in OF_CONDITIONS}
    return ReadingConditions(
        signal="force",
        clock=c.clock if "clock_s" in c.given else None,
        # In the air a gauge's zero shows; else a blade gripped anew does the same.
        session=log.session if len(np.unique(log.session[~log.contact])) > 1 else None,
        contact=log.contact.astype(float),
        tau=weight_torques(scene.cell.robot, log.q, payload.mass, payload.com),
        reference=scene.cell.tables.reference_temperature_C,
        **columns,
    )


def _sides(n: Array) -> tuple[tuple[float, float, float], ...]:
    """Mean normals of the sides of the blade that normals (n, 3) belong to: that of the first row, and the one behind it."""
    groups = [n[n @ n[0] > 0], n[n @ n[0] <= 0]] if len(n) else []
    means = [part.mean(axis=0) / np.linalg.norm(part.mean(axis=0)) for part in groups if len(part)]
    return tuple((float(m[0]), float(m[1]), float(m[2])) for m in means)
