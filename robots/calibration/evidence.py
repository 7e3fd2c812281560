"""Terms selected on held-out error: a joint that bends, a payload that differs, each judged on readings it was not fitted to.

Not only near those it was fitted to: a payload, a campaign, half of a joint's range left out must not suffer.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from robots.calibration.fit import Fit, fit_campaign
from robots.calibration.layout import Choice
from robots.calibration.solver import Campaign
from robots.calibration.student_t import GROSS, NU, consistency
from robots.calibration.validation import FoldErrors, ReadingFold, again, folds, hold_out
from robots.robot import Robot

LEAST_GAIN = 4.0  # of log density over all held-out readings; below it a term is not worth its name
MORE = 1.5  # of log density for each parameter of a term beyond the first: more of them find more by chance
LEAST_SIGMA = 2.5  # gain over its own standard error, blocks of readings counted as one
ROUNDS = 4
READINGS = 1200  # of a longer campaign, evenly taken: evidence does not need more


@dataclass(frozen=True)
class Term:
    """A candidate: its name in words, gain of held-out log density, that over its standard error, and whether it entered."""

    name: str
    gain: float
    sigma: float
    accepted: bool


Known = dict[tuple[Choice, bool, bytes], list[FoldErrors | None]]


@dataclass(frozen=True)
class _Blocks:
    """Readings that are left out in turn, near those that stay (regions and random parts) and far from them."""

    near: list[ReadingFold]
    far: list[ReadingFold]
    known: Known = field(default_factory=dict)

    def scores(self, fit: Fit, other: Fit, far: bool = False) -> list[FoldErrors | None]:
        """The model of `other` on the readings of `fit`, each block predicted from the rest; the search begins where it stands.

        Each is worked out once: a term that enters is the model of the next round, and there are no two fits of one choice.
        """

        def refit(left: Campaign, near: Fit) -> Fit:
            return again(left, other)

        key = other.choice, far, (fit.weight > GROSS).tobytes()
        if key not in self.known:
            self.known[key] = [hold_out(fit, block, refit) for block in (self.far if far else self.near)]
        return self.known[key]


def choose_terms(fit: Fit) -> tuple[Choice, list[Term]]:
    """Add to the model of `fit` the joints and payloads that predict held-out blocks better; all candidates are reported."""
    campaign = fit.campaign
    if len(campaign.readings) > READINGS:
        campaign = replace(campaign, readings=campaign.readings.thinned(READINGS))
        fit = fit_campaign(campaign, fit.choice, fit.priors, fit.noise, begin=fit.state)
    every = list(folds(campaign))
    near = [f for f in every if f.kind == "region"] + [f for f in folds(campaign, 1) if f.kind == "random"]
    blocks = _Blocks(near, [f for f in every if f.kind in ("payload", "joint range", "campaign")])
    tried: list[Term] = []
    for _ in range(ROUNDS):
        accepted, terms = _next_term(fit, blocks)
        tried = [t for t in tried if t.accepted] + terms
        if accepted is None:
            break
        fit = accepted
    return fit.choice, sorted(tried, key=lambda t: (not t.accepted, -t.gain))


def _next_term(fit: Fit, blocks: _Blocks) -> tuple[Fit | None, list[Term]]:
    """The fit with one term more, or None, and every candidate. The one that helps most where it is fitted is judged first on
    what was held out, and the others wait for the next round if it stands."""
    found, accepted = list[Term](), None
    fits = [(name, fit_campaign(fit.campaign, c, fit.priors, fit.noise, begin=fit.state)) for name, c in _candidates(fit)]
    likely = [(_likelihood(other) - _likelihood(fit), name, other) for name, other in fits]
    for own, name, other in sorted(likely, key=lambda each: _wanted(fit.choice, each[2].choice) - each[0]):
        gain, sigma, good = min(own, 0.0), 0.0, False
        # What does not even help where it was fitted is not tried on what was held out.
        if own > LEAST_GAIN and accepted is None:
            gain, sigma = _gain(blocks.scores(fit, fit), blocks.scores(fit, other))
            good = bool(gain > _wanted(fit.choice, other.choice) and sigma > LEAST_SIGMA and _carries(fit, blocks, other))
        found.append(Term(name, gain, sigma, good))
        accepted = other if good else accepted
    return accepted, found


def _candidates(fit: Fit) -> Iterator[tuple[str, Choice]]:
    """Each term that the model does not have."""
    choice, campaign = fit.choice, fit.campaign
    for j in range(1, 7):
        if j not in choice.joints and _bends(campaign.robot, j):
            yield f"joint {j} bends", replace(choice, joints=tuple(sorted((*choice.joints, j))))
    readings = campaign.readings
    for k in np.unique(readings.payload):
        name = readings.payloads[k]
        hung = campaign.payloads.get(name)
        if name not in choice.payloads and hung is not None and hung.mass > 0:
            yield f"mass and centre of payload '{name}' differ", replace(choice, payloads=(*choice.payloads, name))


def _wanted(choice: Choice, more: Choice) -> float:
    """Gain that a term must bring: a spring has one parameter, a payload four."""
    parameters = len(more.joints) - len(choice.joints) + 4 * (len(more.payloads) - len(choice.payloads))
    return LEAST_GAIN + MORE * (parameters - 1)


def _carries(fit: Fit, blocks: _Blocks, other: Fit) -> bool:
    """Whether a term helps beyond where it was fitted too: a stand-in for something else does not (DIAGNOSIS, impostors)."""
    pairs = zip(blocks.scores(fit, fit, far=True), blocks.scores(fit, other, far=True), strict=True)
    gains = [after.score.sum() - before.score.sum() for before, after in pairs if after is not None and before is not None]
    return not gains or (sum(gains) > 0 and min(gains) > -LEAST_GAIN)


def _likelihood(fit: Fit) -> float:
    """Log density of the readings it was fitted to, but for a constant."""
    return float(-0.5 * (NU + 3) * np.log1p(fit.squared / (NU * consistency(3))).sum())


def _bends(robot: Robot, j: int) -> bool:
    """Whether the cell gives the joint a stiffness at all, or gives none to any."""
    return bool(robot.stiffness[j - 1] > 0 or not (robot.stiffness > 0).any())


def _gain(before: list[FoldErrors | None], after: list[FoldErrors | None]) -> tuple[float, float]:
    """Mean gain over the two ways of blocking, and over its standard error between blocks."""
    gains = np.array(
        [a.score.sum() - b.score.sum() for b, a in zip(before, after, strict=True) if a is not None and b is not None]
    )
    if len(gains) < 3:
        return 0.0, 0.0
    total = 0.5 * float(gains.sum())
    error = 0.5 * float(gains.std(ddof=1)) * np.sqrt(len(gains))
    return total, total / max(error, 1e-9)
