"""Force readings that nobody has taken yet: the channel they would make about the believed contact, or about the fit of a log.

The readings are those predicted, so nothing is left of them; sensitivities, columns and whitening are those of a measured log.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ocp.calibrate.force.log import ForceLog, Index
from ocp.calibrate.force.model import ForceModel, ForceRows
from ocp.calibrate.force.noise import CorrelatedNoise, NoiseGroup, ReadingNoise, Runs
from ocp.calibrate.force.rows import log_conditions, prepare_force
from ocp.diagnose.engine.channel_system import System, Variant
from ocp.diagnose.engine.projection import Projection, project
from ocp.diagnose.force.arm import logged_arm
from ocp.diagnose.force.channel import ForceChannel
from ocp.diagnose.force.fit import EffectFit, ForceProblem, linear, reading_information, scale_of, signals
from ocp.diagnose.force.prediction import LogScene, M, nuisance_derivatives, predict_forces
from ocp.diagnose.force.prior import contact_prior
from ocp.diagnose.force.whitening import BLOCKS, Whitener
from ocp.effects.effect import Active, Effect, Scanned
from ocp.model.cell import Cell
from robots.calibration.store import Calibration
from robots.pose import Array

MOST = 2000  # rows of a plan that are looked at
SIGMA = 0.3  # N, one sigma of a reading where the plan does not say
SHARE, LASTS = 0.5, 0.05  # of its variance that lasts, s for how long: between the virtual cell's sensor and that of others' logs


def planned_force_channel(cell: Cell, log: ForceLog, effects: Iterable[Effect], arm: Calibration | None = None) -> ForceChannel:
    """The channel that the believed contact would make of planned rows; arm: its posterior where readings will place it
    (default: the cell's own).

    A plan with a column ft_N logs the tangential force too. Of more than `MOST` rows every k-th is taken, in the place of k of
    them. Raises BadInput, as `prepare_force`.
    """
    given, cell = tuple(e.active for e in cell.effects), replace(cell, effects=())
    setup = prepare_force(cell, [log])
    every = int(np.ceil(len(log) / MOST))
    rows = np.flatnonzero(_place(log) % every == 0)
    log, model_rows = log.take(rows), setup.rows[0].take(rows)
    believed = contact_prior(cell, arm)
    known, theta = log_conditions(cell, log), believed.mean[:M]
    own = logged_arm(cell, theta, log.q, known)
    scene = LogScene(cell, ForceModel(cell, setup.model.law), model_rows, known, own, theta, given, log.contact)
    noise = noise_of_means(CorrelatedNoise(1.0, SHARE, LASTS), every)
    whiteners = tuple(
        _whitener(one, np.full(len(log), SIGMA) if one.sigma_fn is None else one.sigma_fn, {True: noise, False: noise}, blocks)
        for one, blocks in zip(signals(log), BLOCKS, strict=False)
    )
    problem = ForceProblem.of(log, scene, believed, setup.notices)
    return ForceChannel(*_unmeasured(problem, np.zeros(believed.root.shape[1]), (), whiteners), tuple(effects))


def foreseen_force(channel: ForceChannel, log: ForceLog, rows: ForceRows, effects: Iterable[Effect]) -> ForceChannel:
    """The channel that more rows of `log` would make about the fit of a measured one, with its noise."""
    old, fit = channel.problem, channel.fit
    known = log_conditions(old.scene.cell, log, float(old.scene.conditions.clock.max()))
    arm = logged_arm(old.scene.cell, old.scene.theta, log.q, known)
    problem = ForceProblem.of(log, replace(old.scene, rows=rows, conditions=known, arm=arm, pressed=log.contact), old.believed)
    whiteners = tuple(
        _whitener(one, np.full(len(log), np.median(w.noise.base)), _noises(w), blocks)
        for one, w, blocks in zip(signals(log), fit.whiteners, BLOCKS, strict=False)
    )
    return ForceChannel(*_unmeasured(problem, fit.z[: old.sizes[0]], fit.active, whiteners), tuple(effects))


@dataclass(frozen=True)
class Shared:
    """A force channel whose nuisance is that of other recordings of the same cell too: columns of `believed.NUISANCE`'s standard
    normal unknowns, what single recordings are off by projected out."""

    channel: ForceChannel

    @cached_property
    def _own(self) -> Projection:
        """Of the recordings' offsets."""
        own = self.channel.problem.offsets
        return project(self._rows(own.normal, own.shear), np.ones(own.count))

    @cached_property
    def system(self) -> System:
        """Whitened rows without a residual; the nuisance of all recordings."""
        problem, fit = self.channel.problem, self.channel.fit
        normal, shear = nuisance_derivatives(problem.scene, fit.at, fit.slopes[0])
        columns = self._own.apply(self._rows(normal @ problem.believed.root, shear @ problem.believed.root))
        n, p = columns.shape
        none = np.zeros(n, np.int64)
        return System(np.zeros(n), columns, tuple(f"contact {k + 1}" for k in range(p)), np.ones(p), np.zeros(p), none, none)

    def variants(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None = None) -> list[Variant]:
        """As the channel's, in these rows."""
        made = self.channel.variants(effect, joint, scans)
        return [replace(v, columns=self._own.apply(v.columns)) for v in made]

    def _rows(self, normal: Array, shear: Array) -> Array:
        averages = self.channel.averages
        return averages.rows((normal, shear)[: len(averages.whiteners)])


def _unmeasured(
    problem: ForceProblem, z: Array, active: tuple[Active, ...], whiteners: tuple[Whitener, ...]
) -> tuple[ForceProblem, EffectFit]:
    """The problem with readings as predicted at nuisance z and these effects, and the fit that stands there."""
    x = problem.believed.mean + problem.believed.root @ z
    at = predict_forces(
        problem.scene, x, active, predict_forces(problem.scene, x, active)
    )  # the stroke's sign comes from a first prediction
    log = replace(problem.log, fn=at.fn, ft=None if problem.log.ft is None else at.ft)
    problem, scale = replace(problem, log=log), scale_of(active)
    values = np.concatenate([one.a for one in active] or [np.zeros(0)]) / np.where(scale > 0, scale, 1.0)
    whole = np.concatenate([z, np.zeros(problem.sizes[1]), values])
    made = linear(problem, whole, at, whiteners)
    information = np.eye(len(whole)) + reading_information(whiteners, made.sensitivity)
    return problem, EffectFit(**vars(made), z=whole, at=at, whiteners=whiteners, information=information, steps=0)


def noise_of_means(noise: CorrelatedNoise, count: int) -> CorrelatedNoise:
    """The noise of means of `count` rows that stand close together: what is white shrinks, what lasts stays."""
    white = (1.0 - noise.share) / count
    whole = noise.share + white
    return replace(noise, sigma=noise.sigma * np.sqrt(whole), share=noise.share / whole)


def _place(log: ForceLog) -> Index:
    """Number (n,) of each row within its recording."""
    out = np.zeros(len(log), np.int64)
    for run in np.unique(log.run):
        at = np.flatnonzero(log.run == run)
        out[at] = np.arange(len(at))
    return out


def _noises(whitener: Whitener) -> dict[bool, CorrelatedNoise]:
    """Noise in contact and in the air; one stands for the other where a log has one of them."""
    known = {contact: kind.noise for contact, kind in whitener.noise.kinds.items()}
    return {contact: known.get(contact, known.get(not contact, CorrelatedNoise(1.0, SHARE, LASTS))) for contact in (True, False)}


def _whitener(log: ForceLog, base: Array, noise: dict[bool, CorrelatedNoise], blocks: int) -> Whitener:
    """The filter of a signal of planned rows; base (n,) N times a noise's sigma is one sigma of a reading."""
    kinds = {}
    for contact, law in noise.items():
        rows = np.flatnonzero(log.contact == contact)
        if len(rows):
            kinds[contact] = NoiseGroup(rows, Runs.of(log.run[rows], log.time[rows]), law)
    return Whitener.of(ReadingNoise(base, np.ones(len(log)), kinds), blocks)
