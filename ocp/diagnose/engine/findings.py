"""What the diagnosis finds: names with probabilities, where the gap lies, what cannot be told apart.

`ocp.diagnose.verdict.diagnosis.diagnose_channels(channels, library, options) -> Diagnosis` makes it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from ocp.diagnose.engine.channel_system import Channel, HeldOut
from ocp.diagnose.rules import EXPLAINED, LEADS, PRIOR_EFFECTS
from ocp.effects.effect import Active
from robots.pose import Array


@dataclass(frozen=True, order=True)
class Name:
    """An effect and its joint (0: none)."""

    effect: str
    joint: int = 0

    def __str__(self) -> str:
        return f"{self.effect}:{self.joint}" if self.joint else self.effect


@dataclass(frozen=True)
class Options:
    """How to search.

    most: effects of an explanation at most; beam: explanations kept while growing;
    prior_effects: effects expected in a data set before it is seen; barred: effects and joints that were shown to be impostors;
    where, folds: whether to compute those parts.
    """

    most: int = 4
    beam: int = 6
    prior_effects: float = PRIOR_EFFECTS
    barred: tuple[Name, ...] = ()
    where: bool = True
    folds: bool = True


@dataclass(frozen=True)
class Explanation:
    """A set of effects with its posterior probability and its log evidence over the empty set; the classes of its members
    are taken together."""

    names: tuple[Name, ...]
    probability: float
    log_evidence: float


@dataclass(frozen=True)
class Alternative:
    """Effects with their values that may be the truth, and the probability that they are; none: the baseline stands."""

    probability: float
    active: tuple[Active, ...]


def summing_to(whole: float, listed: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """The same with probabilities in the same proportion that sum to `whole`."""
    total = sum(one.probability for one in listed) or 1.0
    return tuple(Alternative(whole * one.probability / total, one.active) for one in listed)


@dataclass(frozen=True)
class Ranked:
    """An effect and joint: marginal probability, log evidence (best explanation with it over best without), values with
    covariance (given the best explanation with it), detectability lambda = score of its value under the projection, standard
    deviations of the values by key, over variants too."""

    name: Name
    probability: float
    log_evidence: float
    active: Active
    detectability: float
    deviations: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Screened:
    """What the score test says of an effect before anything is accepted: lambda gained, degrees of freedom, variants tried,
    p-value with the look-elsewhere price; smallest value (share of the typical upper end) that would be seen; share of its
    signature's lambda that the nuisance leaves."""

    name: Name
    gained: float
    freedom: int
    variants: int
    p_value: float
    smallest: float
    left: float


@dataclass(frozen=True)
class BudgetLine:
    """Share (0..1) of the gap's mean square beyond noise that a grouping or a smooth dependence explains; p-value."""

    channel: str
    where: str
    share: float
    p_value: float


@dataclass(frozen=True)
class KernelTest:
    """Library-free score test: does the gap vary with `where` (q3, approach5, motor2, q2 x q4, time, temperature, payload)?
    joint 0 where none; source: how it enters (a joint's angle, the tracker's frame, ...)."""

    channel: str
    where: str
    source: str
    joint: int
    gained: float
    p_value: float


@dataclass(frozen=True)
class SpectrumPeak:
    """Largest ripple of a joint's angle in a signal: order per turn, amplitude rad, p-value over all orders (circular shifts);
    `power` (m,) over `orders` (m,)."""

    joint: int
    order: float
    amplitude: float
    p_value: float
    orders: Array
    power: Array
    signal: str = ""


@dataclass(frozen=True)
class Location:
    """Where the gap lies: signal, subsystem, joint (0: none), the conditions it depends on, segments of the path, or which
    nest, payload, session or stand."""

    signal: str
    subsystem: str
    joint: int
    depends_on: tuple[str, ...]
    segments: tuple[str, ...] = ()


@dataclass(frozen=True)
class Experiment:
    """What to do, minutes, the names it tells apart, and the probability that the true one is expected to have afterwards."""

    do: str
    minutes: float
    tells_apart: tuple[str, ...]
    expected: float


@dataclass(frozen=True)
class Diagnosis:
    """All findings.

    explanations by probability; these and p_none sum to 1; p_unknown: something outside the catalogue is there, beside names or
    without, p_alone: without. ranking by marginal probability. active: the accepted effects with values and covariance (of the
    best explanation; empty for none). location: of the named effects, else of what is unknown; remainder: of what the names
    leave. classes: names that these data cannot tell apart. kernels, spectrum: of the baseline's gap; left_over: kernel tests
    after the accepted effects. impostors: accepted terms that hurt where the data are extrapolated, with the fold that says so.
    unknown_reasons: what speaks against names. baseline, channels: before and after the accepted effects. held_out: by channel
    name. alternatives: what may be true, with probabilities, `active` first; empty: `active` alone. patches: what may stand for
    something outside the catalogue, not yet fitted, with its share of p_unknown, the likeliest first; instead: what is
    true where no such thing is there, with probabilities that sum to one.
    """

    explanations: tuple[Explanation, ...]
    ranking: tuple[Ranked, ...]
    active: tuple[Active, ...]
    p_none: float
    p_unknown: float
    classes: tuple[tuple[Name, ...], ...]
    location: Location | None
    remainder: Location | None
    budget: tuple[BudgetLine, ...]
    kernels: tuple[KernelTest, ...]
    left_over: tuple[KernelTest, ...]
    spectrum: tuple[SpectrumPeak, ...]
    screened: tuple[Screened, ...]
    impostors: tuple[tuple[Name, str], ...]
    unknown_reasons: tuple[str, ...]
    blind: tuple[str, ...]
    baseline: tuple[Channel, ...]
    channels: tuple[Channel, ...]
    held_out: dict[str, tuple[HeldOut, ...]] = field(default_factory=dict)
    alternatives: tuple[Alternative, ...] = ()
    patches: tuple[Alternative, ...] = ()
    instead: tuple[Alternative, ...] = ()
    p_alone: float = 0.0

    @property
    def p_beside(self) -> float:
        """Something outside the catalogue is there, given that a name is."""
        there = max(self.p_unknown - self.p_alone, 0.0)
        return there / max(1.0 - self.p_none, there, 1e-9)

    @property
    def verdict(self) -> str:
        """explained, partly, ambiguous, unexplained or no_gap, as FORMATS.md defines it."""
        if self.p_unknown > LEADS:
            return "unexplained" if self.p_none > LEADS else "partly"
        if self.p_none > LEADS:
            return "no_gap"
        return "explained" if self.explanations and self.explanations[0].probability >= EXPLAINED else "ambiguous"
