"""The whole answer to a data set, as the command writes it and the report shows it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ocp.diagnose.dataset import DataSet
from ocp.diagnose.engine.channel_system import Channel
from ocp.diagnose.engine.findings import Alternative, Diagnosis, Experiment
from ocp.diagnose.verdict.shrinkage import ANOTHER_DAY, Shrinkage
from ocp.effects.effect import Active
from ocp.effects.patch import is_patch
from robots.pose import Array


def there_of(asked: bool) -> str:
    """Of what is promised: the conditions asked for, or new data like those that there are."""
    return "under the conditions asked for" if asked else "on new data"


@dataclass(frozen=True)
class Remaining:
    """Rms (SI, of the reading's size) that stays above the instrument's noise, 0 where noise may well be all (`PLACE_SURE`);
    probability that noise alone leaves as much."""

    above_noise: float
    p_value: float


@dataclass(frozen=True)
class SignalGap:
    """The gap of one signal: channel before and after, sizes (n,) of the readings' errors in `unit`, outliers apart, noise
    floor; shrinkage to expect, promise by what is new in them, and by what was withheld (None: no gap there to
    speak of); remaining: rms in `unit` above the instrument's noise after the effects, and the probability that noise alone
    leaves as much; asked: whether the shrinkage is that under the conditions that are to be predicted; beyond: kinds of
    condition in which most of these lie outside of what was measured; shown: keys of the named effects
    that the signal shows; elsewhere: whether its fit leaves what cell and calibration allow, so that it is to be calibrated anew
    before anything rests on it."""

    name: str
    unit: str
    noise_floor: float
    before: Array
    after: Array
    shrinkage: Shrinkage | None
    promise: Mapping[str, Shrinkage]
    extrapolation: tuple[tuple[str, float | None], ...]
    remaining: Remaining
    baseline: Channel
    corrected: Channel
    asked: bool = False
    beyond: tuple[str, ...] = ()
    shown: tuple[tuple[str, int], ...] = ()
    elsewhere: bool = False

    @property
    def there(self) -> str:
        """Of what the shrinkage is promised."""
        return there_of(self.asked)

    @property
    def harmed(self) -> tuple[str, ...]:
        """Kinds of condition that say, left out, that the gap grows: surely, or, asked for beyond what was measured, rather."""
        return tuple(k for k, one in self.promise.items() if one.high < 0.0 or (k in self.beyond and one.predicted < 0.0))

    def helps(self, least: float) -> bool:
        """Whether a correction with this promise may be written; least: above which it has to be beyond what was measured. Where
        a condition left out takes what an effect is told by, nothing changes there: that says neither that it helps nor that it
        harms."""
        assert self.shrinkage is not None
        low = min(self.shrinkage.low, self.promise.get(ANOTHER_DAY, self.shrinkage).low)
        safe = not self.harmed and not self.elsewhere
        return low > 0.0 and safe and all(p.predicted > least for k, p in self.promise.items() if k in self.beyond)


@dataclass(frozen=True)
class Followed:
    """A channel before anything and with the effects that something is to be promised of; others: what may be true, with
    probabilities, these effects first."""

    before: Channel
    after: Channel
    others: tuple[Alternative, ...]


@dataclass(frozen=True)
class Patched:
    """The channel with the written names and the patches; shrinkage that both promise together; others: what may stand in the
    patches' place, with probabilities; asked: whether it is promised under the conditions that are to be predicted; promise: by
    what is new in new data."""

    channel: Channel
    shrinkage: Shrinkage
    others: tuple[Alternative, ...]
    asked: bool = False
    promise: Mapping[str, Shrinkage] = field(default_factory=dict)

    @property
    def patches(self) -> tuple[Active, ...]:
        """With values and covariance."""
        return tuple(a for a in self.channel.active if is_patch(a.effect))


@dataclass(frozen=True)
class Answer:
    """Diagnosis of a data set with the gap of every signal, what to measure next, what cannot be seen, seconds by phase; asked:
    conditions to predict, by signal; written: named effects that the corrected cell holds; fitted: the channels with them and no
    others; unknown: what is there under no name, before and after, what the patches say first; patch: of it, where it is written
    too."""

    data: DataSet
    diagnosis: Diagnosis
    gaps: tuple[SignalGap, ...]
    next: tuple[Experiment, ...]
    blind: tuple[str, ...]
    notices: tuple[str, ...]
    seconds: dict[str, float]
    asked: Mapping[str, Any]
    written: tuple[Active, ...] = ()
    fitted: tuple[Channel, ...] = ()
    unknown: Followed | None = None
    patch: Patched | None = None

    @property
    def corrections(self) -> tuple[Active, ...]:
        """All that the corrected cell holds: names, and the patch."""
        return self.written if self.patch is None else (*self.written, *self.patch.patches)

    @property
    def channels(self) -> dict[str, Channel]:
        """By signal, as the corrected cell has them."""
        patched = {} if self.patch is None else {self.patch.channel.name: self.patch.channel}
        return {c.name: c for c in self.fitted} | patched


def known_beside(signal: str, channels: Iterable[Channel], written: Sequence[Active]) -> tuple[Active, ...]:
    """Of what is written what other signals than this show too: one alone leaves its size open."""
    others = {a.key for c in channels if c.name != signal for a in c.active}
    return tuple(a for a in written if a.key in others)


def promised(diagnosis: Diagnosis, gaps: Sequence[SignalGap]) -> tuple[Active, ...]:
    """Named effects that do no harm: every signal which shows one, and has a gap to speak of, promises with the low end of its
    interval above zero that the gap shrinks, on another day too, and no kind of condition that was left out says that it grows;
    one signal at least does. Beside something of no name, which they may stand for in part, what is asked for beyond what was
    measured must, where it was left out, say so too: else two of 190 force logs, a belt that wanders named a shift of the wheel,
    come out worse by a third and by 93 %."""
    least = 0.0 if diagnosis.verdict == "partly" else -np.inf
    told = [[g.helps(least) for g in gaps if one.key in g.shown and g.shrinkage is not None] for one in diagnosis.active]
    return tuple(one for one, helps in zip(diagnosis.active, told, strict=True) if helps and all(helps))


def figures(sizes: Array) -> dict[str, float]:
    """rms, mean and maximum of sizes (n,)."""
    return {"rms": float(np.sqrt(np.mean(sizes**2))), "mean": float(sizes.mean()), "max": float(sizes.max())}
