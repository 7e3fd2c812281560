"""The tracker as a channel: believed cell refitted, effects' columns, refits with effects inside."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ocp.diagnose.engine.channel_system import UNSEEN, Fold, HeldOut, ReadingConditions, Sealed, System, Variants
from ocp.diagnose.engine.kernels import measured_ranges
from ocp.diagnose.rules import BACKGROUND_SIZES, LEAST_CHANGES, LEAST_GROUP, OFF_AS_CALIBRATED, PLACE_SURE, UNEVEN
from ocp.diagnose.tracker.background import Background, background
from ocp.diagnose.tracker.held_out import held_out_readings, predict_sealed_readings, tracker_folds
from ocp.diagnose.tracker.refit import Task, TrackerFit, gap_noise, is_restless, refit, relearned, settled
from ocp.effects.effect import Active, Effect, Scanned, Surroundings, effects_key, scan_key
from ocp.effects.engine.readings import COLUMNS, PlacedReadings, by_readings, displaced, motion, without_effects
from ocp.effects.motor_harmonic import ratios_of
from ocp.effects.patch import is_patch, within
from robots.calibration.methods import errors_as_calibrated
from robots.calibration.noise import reading_covariance, whitener
from robots.calibration.store import Calibration
from robots.calibration.student_t import GROSS
from robots.calibration.uneven import GroupScatter, scatter_by_group, scatter_by_joint
from robots.gravity import weight_torques
from robots.pose import Array
from robots.tracker_readings import Readings

OF_READINGS = ("q", "approach", "payload", "payloads", "target", "time", "waited", "moved", "temperature")
OF_SEEN = ("moments", "sight", "hang")
ANY = {"target", "payload"}  # one of them is as good as many
LEVERAGE = 0.9  # of a reading on its fit, at most


@dataclass(frozen=True)
class TrackerChannel:
    """Readings of reflectors with the fit of the believed arm and of the active effects.

    Displacements of screened effects are kept over refits (`store`): they move by a thousandth when the geometry does. So is
    what this channel was refitted to already (`refits`): what is anticipated and what is predicted ask for the same.
    known: the calibration that the cell has.
    """

    task: Task
    fit: TrackerFit
    store: dict[tuple[str, int], tuple[tuple[Scanned, ...], Array]] = field(default_factory=dict, repr=False)
    known: Calibration | None = field(default=None, repr=False)
    name: str = "tracker"
    unit: str = "mm"
    refits: dict[tuple[object, ...], "TrackerChannel"] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def readings(self) -> Readings:
        """As measured."""
        return self.task.campaign.readings

    @cached_property
    def seen(self) -> PlacedReadings:
        """Readings as effects see them."""
        return self.task.placed(self.fit.state, (*self.task.believed, *self.fit.active), self.fit.linear.point)

    @property
    def active(self) -> tuple[Active, ...]:
        """Effects in the prediction."""
        return self.fit.active

    @cached_property
    def system(self) -> System:
        """Whitened about the current fit."""
        n = len(self.readings)
        layout, linear = self.task.layout, self.fit.linear
        return System(
            residual=np.einsum("nij,nj->ni", self.fit.W, linear.residual).ravel(),
            nuisance=(self.fit.W @ linear.J).reshape(3 * n, -1),
            prior_sd=layout.prior_sd,
            offset=np.where(np.isfinite(layout.prior_sd), self.fit.offset, 0.0),
            reading=np.repeat(np.arange(n), 3),
            tailed=True,
        )

    @cached_property
    def background(self) -> Background:
        """What of the joint noise comes back, play and ripple too small to name."""
        return background(self.task, self.fit)

    @property
    def ripples(self) -> tuple[Array, Array]:
        """Sizes (s,) rad of a gear's ripple, and what of them (6, s) the other joints show of each."""
        return BACKGROUND_SIZES, self.background.others

    @property
    def noise_floor(self) -> float:
        """Rms of a reading's noise in mm (3D)."""
        c = self.task.campaign
        S = reading_covariance(self.readings, c.instrument, gap_noise(self.fit.noise), self.fit.linear.d_joints)
        return float(1e3 * np.sqrt(np.trace(S, axis1=1, axis2=2).mean()))

    @property
    def scatters(self) -> str:
        """Far more than joints do, as the noise that the residual asks for says."""
        return "far more than joints of such robots do" if self.restless(1.0) else ""

    @cached_property
    def uneven(self) -> GroupScatter | None:
        """The nest, payload, session, stand or joint that scatters more than the others, where one surely does."""
        fit, c = self.fit, self.task.campaign
        columns = fit.W @ np.concatenate([fit.linear.J, fit.extra], axis=2)
        leverage = np.einsum("nij,jk,nik->n", columns, fit.covariance, columns) / 3.0
        off = fit.linear.residual / np.sqrt(1.0 - np.minimum(leverage, LEVERAGE))[:, None]
        seen = off, c.readings, c.instrument, fit.noise, fit.linear.d_joints
        groups = [*scatter_by_group(*seen, LEAST_GROUP), *(one for one in scatter_by_joint(*seen) if is_restless(one.joints))]
        sure = [one for one in groups if one.ratio > UNEVEN and one.p_value < PLACE_SURE]
        return min(sure, key=lambda one: one.p_value, default=None)

    @cached_property
    def one_arm(self) -> bool | None:
        """Whether, but for the effects in the prediction, the arm may be that of the cell's calibration: mean error of the
        readings by it, outliers apart, over what it told of readings left out of its own campaign; None where it told nothing."""
        task, told, good = self.task, None if self.known is None else self.known.held_out_error, self.fit.weight > GROSS
        if self.known is None or told is None or not good.any():
            return None
        bare = without_effects(task.campaign, self.fit.state, (*task.believed, *self.active), task.reference)
        return float(errors_as_calibrated(bare, self.known)[good].mean()) < OFF_AS_CALIBRATED * told

    def restless(self, scale: float) -> bool:
        """Whether `scale` times the joint noise that the residual asks for is far above what such joints usually scatter."""
        return is_restless(scale * self.fit.noise.joints)

    @property
    def surroundings(self) -> Surroundings:
        """For the scans."""
        r, c = self.readings, self.task.campaign
        payloads = tuple(r.payloads[k] for k in np.unique(r.payload))
        return Surroundings.of(c.robot, r.q, r.time, [r.targets[k] for k in r.target], payloads=payloads)

    @property
    def conditions(self) -> ReadingConditions:
        """What is known of the readings."""
        r, c = self.readings, self.task.campaign
        hung = self.fit.state.payloads[r.payload]
        same: dict[str, Any] = {name: getattr(r, name) for name in OF_READINGS}
        same |= {name: getattr(self.seen, name) for name in OF_SEEN}
        return ReadingConditions(
            signal=self.name,
            clock=r.time,
            session=r.session if len(r.sessions) > 1 else None,
            tau=weight_torques(c.robot, r.q, hung[:, 0], hung[:, 1:]),
            d_joints=self.fit.linear.d_joints,
            d_tilts=self.seen.tilts,
            gear_ratio=ratios_of(self.surroundings),
            point=self.fit.linear.point,
            carrier=self.seen.tracker_rows.R,
            reference=self.task.reference,
            **same,
        )

    def blind(self, effect: Effect) -> str:
        """Why it cannot be seen."""
        if not (effect.on_arm or effect.reading is not None):
            return f"{effect.name} does not move the arm or the tracker's readings"
        for column in effect.needs:
            value = getattr(self.readings, COLUMNS[column], None) if column in COLUMNS else None
            if value is None:
                return f"tracker.csv has no column {column}: {effect.name} cannot be seen"
            if column not in ANY and np.ptp(value) < LEAST_CHANGES.get(column, 0.5):
                return f"{column} hardly changes in tracker.csv: {effect.name} cannot be seen"
        return ""

    def variants(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None = None) -> Variants:
        """Whitened columns about the current fit."""
        if self.blind(effect):
            return UNSEEN
        chosen, moves = self._displaced(effect, joint, scans)
        V, n, _, m = moves.shape
        return chosen, by_readings(self.fit.W, moves).transpose(1, 2, 0, 3).reshape(3 * n, V, m)

    def _displaced(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None) -> tuple[tuple[Scanned, ...], Array]:
        """Displacements (V, n, 3, m) m per unit coefficient and their scanned values."""
        key = (effect.name, joint)
        if key in self.store and (scans is None or [*map(scan_key, scans)] == [*map(scan_key, self.store[key][0])]):
            return self.store[key]
        chosen = tuple(effect.scan(joint, self.surroundings) if scans is None else scans)
        if not chosen:
            return (), np.zeros((0, len(self.readings), 3, effect.size))
        found = chosen, displaced(motion(effect, joint, chosen, self.seen), self.fit.linear.d_joints)
        if scans is None and effect.torque is None:  # torques act through the springs, which a refit may move a lot
            self.store[key] = found
        return found

    def with_active(self, active: tuple[Active, ...]) -> "TrackerChannel":
        """Refitted with these effects, the geometry's learned prior with them."""
        visible = tuple(a for a in active if not self.blind(a.effect))
        key = tuple((effects_key([a]), a.a.tobytes()) for a in visible)
        if key not in self.refits:
            fit = refit(self.task, self.fit.state, self.fit.offset, visible, self.fit.noise)
            task = relearned(self.task, fit)
            self.refits[key] = replace(self, task=task, fit=fit if task is self.task else settled(task, fit))
        return self.refits[key]

    def fitted_with(self, active: tuple[Active, ...]) -> "TrackerChannel":
        """The channel with these effects, whatever values they come with; itself where it has them."""
        return self if effects_key(active) == effects_key(self.active) else self.with_active(active)

    def thinned(self, most: int) -> "TrackerChannel":
        """Fitted to at most so many readings, evenly taken."""
        if len(self.readings) <= most:
            return self
        task = replace(self.task, campaign=replace(self.task.campaign, readings=self.readings.thinned(most)))
        return replace(self, task=task, fit=refit(task, self.fit.state, self.fit.offset, (), self.fit.noise), store={})

    def opened(self) -> "TrackerChannel":
        """About the same fit with no reading set aside as gross."""
        c = self.task.campaign
        W = whitener(reading_covariance(c.readings, c.instrument, self.fit.noise, self.fit.linear.d_joints))
        return replace(self, fit=replace(self.fit, W=W, weight=np.ones_like(self.fit.weight)))

    def gap(self) -> Array:
        """Residuals (n, 3) m."""
        return self.fit.linear.residual

    def whiten(self, changes: Array) -> Array:
        """Whitened rows of changes (n, 3, m) m."""
        return np.asarray((self.fit.W @ changes).reshape(3 * len(changes), -1))

    def folds(self) -> list[Fold]:
        """Blocked and extrapolation folds."""
        return tracker_folds(self.readings)

    def held_out(self, fold: Fold, active: tuple[Active, ...]) -> HeldOut | None:
        """Judge `active` on a fold; what the held readings alone measured is beyond a patch's range."""
        c, rest, shown = self.conditions, ~np.asarray(fold.held, bool), [a for a in active if not self.blind(a.effect)]
        shown = [within(a, lambda middle: measured_ranges(c, middle, rest)) if is_patch(a.effect) else a for a in shown]
        return held_out_readings(self.task, self.fit, fold, shown, self.seen, self._bare)

    @cached_property
    def _bare(self) -> Array:
        """Derivatives (n, 3, p) in the arm's unknowns without what the active effects let give."""
        return self.task.linearised(self.fit.state, ())[0].J if self.active else self.fit.linear.J

    def predict(self, sealed: Readings, active: tuple[Active, ...]) -> Sealed:
        """Baseline and corrected predictions (n, 3) m in the tracker's frame, one sigma of each coordinate."""
        before, after = self.fitted_with(()), self.fitted_with(active)
        lasting = after.background.draws.mean(axis=0)
        told = predict_sealed_readings((before.task, before.fit), (after.task, after.fit), lasting, sealed)
        more = 0.0 if after.uneven is None else after.uneven.holds(sealed)[:, None] * after.uneven.rms**2 / 3.0
        return replace(told, sigma=np.sqrt(told.sigma**2 + more))
