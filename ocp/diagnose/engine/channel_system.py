"""What a channel of readings hands to the engine, and what the engine asks of it; `findings` beside it is what comes out.

A channel is one signal of a data set (tracker, force, joint). It knows its own model; the engine sees whitened linear systems
only, and does not care which channel a row comes from. About the current fit (nuisance theta, coefficients a of the active
effects), to first order,

    residual = nuisance @ d_theta + sum over variants of columns @ d_a + unit noise,
    prior:  (offset + d_theta) / prior_sd ~ N(0, 1)   where prior_sd is finite,

so that offset is the estimate less its prior mean. Columns of an active effect are about its fitted values: the residual
without it is residual + columns @ a.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ocp.diagnose.rules import OUTLIER_WEIGHT
from ocp.effects.effect import Active, Effect, Scanned, Surroundings
from robots.pose import Array, Index, Mask

SCALE = {"mm": 1e3, "N": 1.0, "arcsec": float(np.degrees(1.0) * 3600.0)}
"""Units in which a gap is told, per SI unit."""


@dataclass(frozen=True)
class Wave:
    """A wave that readings speak for: what of (turn, time wave, s wave, ..; a period has overtones), its number (per turn, per s,
    per m), columns (n, 2 k) of the cosines and sines of its k tones, and among how many it was found."""

    where: str
    number: float
    columns: Array
    among: int


@dataclass(frozen=True)
class ReadingConditions:
    """What is known of n readings of one signal; None where the data set does not say.

    q (n, 6) rad commanded; approach (n, 6) signs of the last motions; payload (n,) index into `payloads`; target (n,) index; time
    (n,) s of the run, clock (n,) s of the campaign; waited (n,) s since the last reading before the motion to each, moved (n, 6)
    rad by it; temperature (n,) deg C; wheel_temperature (n,); run, line, session (n,) integers; s (n,) m along the pass; feed
    m/s, setpoint N, belt m/s; contact (n,) bool; pressed (n, k): what a newton more at the contact reads, nothing in the air; tau
    (n, 6) N m load torque; travel (n,) sign of the motion along the pass; d_joints (n, k, 6): derivative of the prediction in the
    six joint angles, SI per rad (k components of a reading), for kernels and spectra in joint angles; d_tilts (n, k, 6, 4): in
    tilts of the six axes about the two directions across them that stand still in the link before, and the two that turn with the
    joint; moments (n, 6, 2) N m of the weight beyond an axis about the two that stand still; point (n, 3) m in the instrument's
    frame; sight, hang (n, 3): unit vectors from reflectors to the instrument, and down, in axes of the links that carry them;
    carrier (n, 3, 3): these axes in the instrument's frame; gear_ratio: those that each of six joints may have; reference: deg C
    of the cell that patches tell warmth above, None of a signal that no patch corrects; waves: of the wheel's turn, and of time
    and path those that the readings speak for.
    """

    signal: str
    q: Array
    approach: Array | None = None
    payload: Index | None = None
    payloads: tuple[str, ...] = ()
    target: Index | None = None
    time: Array | None = None
    clock: Array | None = None
    waited: Array | None = None
    moved: Array | None = None
    temperature: Array | None = None
    wheel_temperature: Array | None = None
    run: Index | None = None
    line: Index | None = None
    session: Index | None = None
    s: Array | None = None
    feed: Array | None = None
    setpoint: Array | None = None
    belt: Array | None = None
    contact: Array | None = None
    pressed: Array | None = None
    tau: Array | None = None
    travel: Array | None = None
    d_joints: Array | None = None
    d_tilts: Array | None = None
    moments: Array | None = None
    point: Array | None = None
    sight: Array | None = None
    hang: Array | None = None
    carrier: Array | None = None
    gear_ratio: tuple[tuple[float, ...], ...] | None = None
    reference: float | None = None
    waves: tuple["Wave", ...] = ()


@dataclass(frozen=True)
class System:
    """Whitened linear system of a channel, unit noise: residual (N,), nuisance (N, p), prior_sd (p,) (inf:
    free) and offset (p,) in the nuisance's own units; reading (N,): which of the channel's readings a row belongs to;
    picked: squares beyond their number that rows which were picked for what they show have where nothing is there; tailed:
    whether the errors of a reading as a whole may follow Student's t, which no weight has taken from the rows yet."""

    residual: Array
    nuisance: Array
    prior_sd: Array
    offset: Array
    reading: Index
    picked: float = 0.0
    tailed: bool = False


Variants = tuple[tuple[Scanned, ...], Array]
"""Of an effect at one joint (0: none): scanned values of V variants, whitened columns (N, V, m) per unit coefficient of the
prediction (a positive coefficient raises what is predicted)."""
UNSEEN: Variants = (), np.zeros((0, 0, 0))


def needs_motion(reason: str) -> bool:
    """Whether the reason why an effect cannot be seen, without its name, is a column that readings at rest never have."""
    return reason.rpartition("column ")[2] == "speed"


def is_outlier(weight: Array) -> Mask:
    """Readings (n,) that are set aside as gross, by their weight (n,) in a fit of the diagnosis."""
    return np.asarray(weight <= OUTLIER_WEIGHT)


@dataclass(frozen=True)
class Fold:
    """Readings to leave out: held (n,) bool. kind: "random" and "block" are interpolation, every other kind (payload,
    temperature, joint range, approach, feed, setpoint, line, run, session) extrapolates. name: e.g. "payload=heavy"."""

    name: str
    kind: str
    held: Mask

    @property
    def extrapolates(self) -> bool:
        """Whether the held readings lie outside the conditions of the rest."""
        return self.kind not in ("random", "block")


@dataclass(frozen=True)
class HeldOut:
    """Squares (3, r) of the gap of each of the held readings (SI^2: m^2 for 3D errors, N^2, rad^2): before and after the effects,
    everything refitted on the rest, and what noise alone gives. estimation: mean square that the effects' own errors of
    estimation add after them; shared: one sd of the means before less after that comes from what the believed cell is off by in
    all of the held readings."""

    fold: Fold
    rows: Array
    estimation: float = 0.0
    shared: float = 0.0

    @property
    def means(self) -> tuple[float, ...]:
        """Mean squares before the effects, with them, and of noise alone."""
        return tuple(float(row.mean()) for row in self.rows)


@dataclass(frozen=True)
class Sealed:
    """Predictions (r, k) SI for readings nobody has seen: believed cell refitted, corrected by the named effects that are
    written, and one sigma of the corrected one for the noise-free value; named: corrected by all names, written or not. lacking:
    named effects that are left out of the correction, because the conditions do not say what they depend on; their usual size is
    in sigma. patched, patched_sigma: the same with a patch (None: there is none); inside (r,): whether all it varies with lies in
    its measured range; beyond: sentences on conditions that lie outside what was measured."""

    baseline: Array
    corrected: Array
    sigma: Array
    lacking: tuple[str, ...] = ()
    named: Array | None = None
    patched: Array | None = None
    patched_sigma: Array | None = None
    inside: Mask | None = None
    beyond: tuple[str, ...] = ()


class ReadingRows(Protocol):
    """Rows, taken or planned, about a fit."""

    @property
    def system(self) -> System:
        """Whitened about the current fit."""

    def variants(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None = None) -> Variants:
        """About the current fit; `UNSEEN` where these rows cannot show the effect. `scans`: these scanned values in this order
        instead of the effect's own scan of the channel's surroundings."""


def shows(seen: ReadingRows, one: Active) -> bool:
    """Whether rows can show an effect."""
    return len(seen.variants(one.effect, one.joint, [one.scanned])[0]) > 0


class Channel(ReadingRows, Protocol):
    """One signal of a data set, fitted."""

    @property
    def name(self) -> str:
        """tracker, force or joint."""

    @property
    def unit(self) -> str:
        """Unit in which its gap is told: mm, N, arcsec."""

    @property
    def conditions(self) -> ReadingConditions:
        """Of its readings."""

    @property
    def active(self) -> tuple[Active, ...]:
        """Effects in its nonlinear prediction, with fitted values and covariance."""

    @property
    def noise_floor(self) -> float:
        """Rms of a reading's noise in `unit` (3D for points)."""

    @property
    def surroundings(self) -> Surroundings:
        """What its readings offer to the scans of effects."""

    def blind(self, effect: Effect) -> str:
        """Why the channel cannot see an effect (a missing column), a sentence; empty where it can."""

    def with_active(self, active: tuple[Active, ...]) -> "Channel":
        """Nuisance and coefficients refitted jointly, nonlinearly, noise re-estimated; values given are where to start."""

    def gap(self) -> Array:
        """Residuals (n, k) SI of the current fit."""

    def whiten(self, changes: Array) -> Array:
        """Whitened rows (N, m) of changes (n, k, m) SI of the predictions, as `system` has them: tests without a library
        make their own columns."""

    def folds(self) -> list[Fold]:
        """Blocked and extrapolation folds of its readings."""

    def held_out(self, fold: Fold, active: tuple[Active, ...]) -> HeldOut | None:
        """Judge `active` on a fold; None where too little is left."""

    def predict(self, sealed: Any, active: tuple[Active, ...]) -> Sealed:
        """Predictions for readings in the channel's own form, with the fit of all readings."""


@runtime_checkable
class WeighedReadings(Protocol):
    """A channel that weighs its readings one by one, so that some may be left out, or all counted."""

    def thinned(self, most: int) -> Channel:
        """The channel with at most so many of its readings, evenly taken; itself where it has no more."""

    def opened(self) -> Channel:
        """The channel about the same fit with no reading set aside."""

    def restless(self, scale: float) -> bool:
        """Whether `scale` times the noise that its residual asks for is many times the usual."""


@runtime_checkable
class Scattering(Protocol):
    """A channel that knows how much its readings may scatter."""

    @property
    def scatters(self) -> str:
        """In words, how much more they do; empty where they do not."""


@runtime_checkable
class Resting(Protocol):
    """A channel whose believed cell's fit may find no minimum."""

    @property
    def rests(self) -> bool:
        """Whether it found one."""


@dataclass(frozen=True)
class Predictable:
    """Effects that can be predicted, and those for which a column is missing; kept (k,): places of the known ones' coefficients
    among those of all."""

    known: tuple[Active, ...]
    unknown: tuple[Active, ...]
    kept: Index

    @property
    def lacking(self) -> tuple[str, ...]:
        """Names of the unknown ones."""
        return tuple(a.effect.name for a in self.unknown)


def predictable(active: Sequence[Active], says: Callable[[Effect], bool]) -> Predictable:
    """Effects parted by whether the conditions have what each needs (`says`)."""
    inside = [says(a.effect) for a in active]
    known, unknown = (tuple(a for a, k in zip(active, inside, strict=True) if k is wanted) for wanted in (True, False))
    kept = np.flatnonzero(np.repeat(inside, [a.effect.size for a in active])) if active else np.zeros(0, np.int64)
    return Predictable(known, unknown, kept)
