"""One minimisation of the robust misfit by reweighted Gauss-Newton steps.

The spread starts at what the data show and is lowered to the noise model's as the fit settles, so that outliers of any
size lose their weight before they can do harm. docs/calibration.md, eqs. 2 and 3.
"""

from dataclasses import dataclass, replace

import numpy as np

from robots.calibration.layout import Layout, State, moved
from robots.calibration.noise import TURN_SD, Noise, joint_noise, reading_covariance, whitener
from robots.calibration.residuals import Linearised, linearise, residuals
from robots.calibration.student_t import spread_of, weights
from robots.gauss_newton import Rule, Valley, minimise
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Hanging, Index, Instrument, Readings

# Where residuals are large, the path to the minimum is a curved valley along which steps of a hundredth of a standard deviation
# creep for dozens of turns: the weights stand once they have settled, and a fit that no longer lowers its misfit is done.
VALLEY = Valley(over=3, still=0.01, close=0.01, tries=200, lost=5)
FOLLOWED = 8  # steps that begin with new weights and derivatives
RULE = Rule(steps=40, rest=1e-4, halvings=10, reweighted=FOLLOWED, valley=VALLEY)
OPEN_SHARE = 0.2  # of the largest part in an open direction; unknowns with less are not named
JITTER = 1e-12  # precision of every unknown, lest a campaign that says nothing of one be singular
RELINEARISE = 1e-5  # m or rad: smaller steps leave the Jacobian as it is (its change is below 1e-5 of itself)
JOINT_NOISE_SD = 1.0  # of its logarithm about what is usual: a factor of three either way, which few readings cannot correct
LEAST_SPREAD = 0.5  # of the noise model: few readings can be met too well, no instrument is that much better than it says


class OpenDirection(np.linalg.LinAlgError):
    """The readings and priors leave a direction of the unknowns open; names: those that take part in it, most first."""

    def __init__(self, names: tuple[str, ...]) -> None:
        super().__init__(", ".join(names))
        self.names = names


@dataclass(frozen=True)
class Campaign:
    """What a fit starts from: robot, readings, what hung on the flange, the instrument.

    pairs (m, 2): where given, differences of these readings are fitted instead of the readings (the relative model); both
    of a pair are of one station.
    """

    robot: Robot
    readings: Readings
    payloads: dict[str, Hanging]
    instrument: Instrument
    pairs: Index | None = None


@dataclass(frozen=True)
class Solution:
    """A point of the search and where it ends: state and its offset (p,) from the prior's mean, residuals with derivatives,
    whitener, squared distances (n,), weights (n,), spread, steps taken. stale: the derivatives are those of an earlier point;
    ahead: those of this point, where the next step will need them, and its whitener."""

    campaign: Campaign
    layout: Layout
    noise: Noise
    state: State
    offset: Array
    linear: Linearised
    W: Array
    squared: Array
    weight: Array
    spread: float
    steps: int
    stale: bool
    ahead: tuple[Linearised, Array] | None = None

    @staticmethod
    def at(campaign: Campaign, layout: Layout, state: State, offset: Array, noise: Noise) -> "Solution":
        """The point of a state."""
        linear, W = _linearised(campaign, layout, state, noise)
        squared = _squared(W, linear.residual)
        return Solution(campaign, layout, noise, state, offset, linear, W, squared, np.ones(len(squared)), 1.0, 0, False)

    @property
    def z(self) -> Array:
        """Offset in units of the layout's scale."""
        return self.offset / self.layout.scale

    def reweighted(self) -> "Solution":
        """With the spread that the residuals show and the weights that follow; derivatives at this point."""
        linear, W, squared = self.linear, self.W, self.squared
        if self.stale:
            linear, W = self.ahead or _linearised(self.campaign, self.layout, self.state, self.noise)
            squared = _squared(W, linear.residual)
        k = linear.residual.shape[1]
        spread = max(spread_of(squared, k), LEAST_SPREAD)
        weight = weights(squared / spread**2, k)
        return replace(self, linear=linear, W=W, squared=squared, weight=weight, spread=spread, stale=False, ahead=None)

    def residual(self) -> Array:
        """Whitened and weighted (n k,)."""
        return np.asarray((_whitened(self.W, self.linear.residual) * self._root[:, None]).ravel())

    def linearised(self) -> tuple[Array, Array]:
        """With the sensitivities (n k, p) to z."""
        columns = (self.W @ self.linear.J) * self.layout.scale * self._root[:, None, None]
        return self.residual(), columns.reshape(-1, self.layout.size)

    def moved(self, change: Array) -> "Solution":
        """The point after a step; after a small one the derivatives stay, as they do where the weights stand.

        Else they are worked out together with the residuals: most of the work is common to both.
        """
        c, step = self.campaign, self.layout.scale * change
        state, steps, stale = moved(self.layout, self.state, step), self.steps + 1, bool(np.abs(step).max() > RELINEARISE)
        ahead = _linearised(c, self.layout, state, self.noise) if stale and steps < FOLLOWED else None
        residual = ahead[0].residual if ahead else _paired(c, residuals(c.robot, c.readings, c.instrument, state))
        linear, squared = replace(self.linear, residual=residual), _squared(self.W, residual)
        there = replace(self, state=state, offset=self.offset + step, linear=linear, squared=squared)
        return replace(there, steps=steps, stale=stale, ahead=ahead)

    def joint_noise(self) -> Noise:
        """The joint noise that explains the residuals best."""
        c, off = self.campaign, self.linear.residual[:, :3]
        usual = Noise().joints
        return joint_noise(off, c.readings, c.instrument, self.linear.d_joints, self.layout.size, usual, JOINT_NOISE_SD, c.pairs)

    @property
    def _root(self) -> Array:
        return np.sqrt(self.weight) / self.spread


def solve(campaign: Campaign, layout: Layout, begin: State, offset: Array, noise: Noise) -> Solution:
    """The most probable state near `begin`, which is `offset` (p,) from the prior's mean. Raises OpenDirection."""
    start = Solution.at(campaign, layout, begin, offset, noise)
    if campaign.pairs is None:  # differences say nothing of a station's place, and are not asked for it
        _, columns = start.linearised()
        check_open(columns.T @ columns + np.diag(layout.precision), layout)
    return minimise(start, layout.precision + JITTER, RULE).at.reweighted()


def check_open(information: Array, layout: Layout) -> None:
    """Raises OpenDirection where an information matrix (p, p), in units of the layout's scale, has no inverse."""
    # Scaled to a unit diagonal, so that only what is really open, and not what is merely coarse, is called so.
    size = np.sqrt(np.maximum(np.diag(information), JITTER))
    values, directions = np.linalg.eigh(information / np.outer(size, size))
    if values[0] < layout.size * np.finfo(float).eps:
        part = np.abs(directions[:, 0])
        most = np.argsort(-part)
        raise OpenDirection(tuple(layout.names[i] for i in most if part[i] > OPEN_SHARE * part[most[0]]))


def _linearised(campaign: Campaign, layout: Layout, state: State, noise: Noise) -> tuple[Linearised, Array]:
    """Residuals with derivatives and their whitener, of readings or of pairs of them."""
    c = campaign
    linear = linearise(c.robot, c.readings, c.instrument, layout, state)
    if c.pairs is None:
        return linear, _whitener(c, linear, noise)
    covariance = reading_covariance(c.readings, c.instrument, noise, linear.d_joints)
    W = whitener(covariance[c.pairs[:, 0]] + covariance[c.pairs[:, 1]])
    return replace(linear, residual=_paired(c, linear.residual), J=_paired(c, linear.J)), W


def _paired(campaign: Campaign, rows: Array) -> Array:
    """Rows (n, 3, ..) as they are, or their differences over the pairs (m, 3, ..)."""
    return rows if campaign.pairs is None else rows[campaign.pairs[:, 1]] - rows[campaign.pairs[:, 0]]


def _whitener(campaign: Campaign, linear: Linearised, noise: Noise) -> Array:
    readings = campaign.readings
    points = whitener(reading_covariance(readings, campaign.instrument, noise, linear.d_joints))
    if readings.turn is None:
        return points
    W = np.zeros((len(readings), 6, 6))
    W[:, :3, :3] = points
    stated = readings.sigma_turn
    told = np.zeros(0) if stated is None else stated[np.isfinite(stated)]
    usual = float(np.median(told)) if len(told) else TURN_SD
    sd = np.full(len(readings), usual) if stated is None else np.nan_to_num(stated, nan=usual)
    W[:, 3:, 3:] = np.eye(3) / sd[:, None, None]
    return W


def _whitened(W: Array, residual: Array) -> Array:
    return np.asarray((W @ residual[..., None])[..., 0])


def _squared(W: Array, residual: Array) -> Array:
    return np.asarray((_whitened(W, residual) ** 2).sum(axis=1))
