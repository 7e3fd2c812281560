"""The whole answer to a data set, as the command writes and the report shows it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ocp.diagnose.dataset import DataSet
from ocp.diagnose.engine.findings import Diagnosis
from ocp.diagnose.engine.system import Channel, HeldOut
from ocp.diagnose.foresee.anticipated import anticipated
from ocp.diagnose.foresee.next_experiment import Experiment
from ocp.diagnose.rules import OUTLIER_WEIGHT
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.remainder import estimation_variance
from ocp.diagnose.verdict.shrinkage import NONE, Shrinkage, from_folds, from_model, realised
from robots.pose import Array

SCALE = {"mm": 1e3, "N": 1.0, "arcsec": float(np.degrees(1.0) * 3600.0)}
"""Units in which a gap is told, per SI unit."""


@dataclass(frozen=True)
class SignalGap:
    """The gap of one signal: channel before and after, sizes (n,) of the readings' errors in `unit`, outliers apart, noise
    floor; shrinkage to expect on new data, and by what was withheld (None: no gap there to speak of)."""

    name: str
    unit: str
    noise_floor: float
    before: Array
    after: Array
    shrinkage: Shrinkage | None
    extrapolation: tuple[tuple[str, float | None], ...]
    baseline: Channel
    corrected: Channel


@dataclass(frozen=True)
class Answer:
    """Diagnosis of a data set with the gap of every signal, what to measure next, what cannot be seen, seconds by phase."""

    data: DataSet
    diagnosis: Diagnosis
    gaps: tuple[SignalGap, ...]
    next: tuple[Experiment, ...]
    blind: tuple[str, ...]
    notices: tuple[str, ...]
    seconds: dict[str, float]


def signal_gap(diagnosis: Diagnosis, before: Channel, after: Channel) -> SignalGap:
    """The gap of one channel; its shrinkage is predicted from what was fitted, before anything sealed is opened."""
    scale = SCALE[before.unit]
    kept = counted(after)
    sizes = [scale * np.linalg.norm(np.atleast_2d(c.gap()), axis=1)[kept] for c in (before, after)]
    held = diagnosis.held_out.get(before.name, ())
    told = tuple(
        (h.fold.name, realised(h.before, h.after, h.noise) if diagnosis.active else None) for h in held if h.fold.extrapolates
    )
    shrinkage = _shrinkage(diagnosis, before, after, held, float(np.mean(sizes[0] ** 2)))
    return SignalGap(before.name, before.unit, after.noise_floor, sizes[0], sizes[1], shrinkage, told, before, after)


def _shrinkage(diagnosis: Diagnosis, before: Channel, after: Channel, held: Sequence[HeldOut], square: float) -> Shrinkage | None:
    """What to expect on new data; square: mean square of the gap before in the channel's unit."""
    if not any(after.variants(a.effect, a.joint, [a.scanned]) for a in diagnosis.active):
        # Nothing is named that this signal shows, so nothing changes.
        return NONE if realised(square, 0.0, after.noise_floor**2) is not None else None
    if isinstance(before, TrackerChannel) and isinstance(after, TrackerChannel) and not after.restless(1.0):
        return from_model(anticipated(before, after, diagnosis.alternatives), held, (after.noise_floor / SCALE[after.unit]) ** 2)
    if before.name == "force":
        from ocp.diagnose.force.shrinkage import of_grinding  # blade and contact: only for those who measured force

        return of_grinding(before, after, diagnosis.alternatives)
    # Where noise is far above what is usual no model says what lasts of it: left-out readings do.
    return from_folds(held, estimation_variance(after, active_columns(after)))


def counted(channel: Channel) -> NDArray[np.bool_]:
    """Readings (n,) that are neither outliers, which are no gap of the model, nor air runs, in which nothing was ground."""
    weight = getattr(getattr(channel, "fit", None), "weight", None)
    n = len(channel.gap())
    good = np.ones(n, bool) if weight is None or np.shape(weight) != (n,) else np.asarray(weight > OUTLIER_WEIGHT)
    contact = channel.conditions.contact
    return good if contact is None or not np.any(contact) else good & np.asarray(contact, bool)


def active_columns(channel: Channel) -> Array:
    """Whitened columns (N, m) of a channel's active effects, each over its prior's sd."""
    parts = []
    for one in channel.active:
        for variant in channel.variants(one.effect, one.joint, [one.scanned]):
            parts.append(variant.columns * np.asarray(one.effect.prior_sd, float))
    return np.hstack(parts) if parts else np.zeros((len(channel.system.residual), 0))


def figures(sizes: Array) -> dict[str, float]:
    """rms, mean and maximum of sizes (n,)."""
    return {"rms": float(np.sqrt(np.mean(sizes**2))), "mean": float(sizes.mean()), "max": float(sizes.max())}
