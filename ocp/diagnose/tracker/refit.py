"""The believed arm and the active effects fitted together to tracker readings, effects inside the nonlinear prediction.

Joint shifts are added to the commanded joints before the arm is bent and placed; twists and displacements of readings, below a
millimetre, are added to first order (their second order is below a micrometre). Gauss-Newton from a fit nearby.

The joint noise comes from the residual itself (Student-t likelihood), from repeats where there are any, and from what is
usual. An effect that is not yet named hides in the residual, so the noise is estimated anew after every acceptance, and the
evidence integrates over its scale (docs/diagnosis.md, 'Noise').

The believed cell refitted is what a good calibration yields, and the start of every diagnosis of tracker readings: it holds
the geometry, the frames, the nests and the springs of the believed joints (within 35 % of what is believed: a spring that is
far off is an effect, joint_compliance). Springs that cell or catalogue list for other joints are for contact forces; whether
they bend under weight as well the readings tell, for all such joints together: then they belong to the baseline at their listed
values, else those joints are rigid. A cell that lets no joint bend means a rigid arm: every spring is then an effect. Payloads
are as the cell says: a wrong one is an effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import expit

from ocp.diagnose import rules
from ocp.effects.effect import Active, coefficients, prior_sds, with_coefficients
from ocp.effects.engine.readings import PlacedReadings, together, without_effects
from robots.calibration.fit import Fit, fit_campaign, learned_priors, learned_width
from robots.calibration.layout import (
    Choice,
    Layout,
    Priors,
    State,
    believed_compliance,
    build_layout,
    moved,
    nominal_state,
    offset_between,
)
from robots.calibration.noise import JOINT_NOISE, Noise, Repeats, joint_noise, reading_covariance, repeat_scatter, whitener
from robots.calibration.residuals import Linearised, linearise, points
from robots.calibration.solver import Campaign
from robots.calibration.student_t import GROSS
from robots.gauss_newton import Rule, minimise
from robots.gravity import link_torques, weighed_links, weight_torques
from robots.pose import Array
from robots.tracker_readings import Readings

STEPS = 8
SETTLED = 0.01  # of one posterior sd, of each unknown
RANK = 1e-9  # of the largest singular value; what the readings say less of stays where it is


def gap_noise(noise: Noise) -> Noise:
    """The joint noise that a gap is judged against: what the residual asks for unless that is far above the usual
    (`is_restless`), for then it is the gap itself."""
    return Noise(rules.USUAL_JOINT_NOISE) if is_restless(noise.joints) else noise


def is_restless(joints: float) -> bool:
    """Whether joint noise (rad) is far above what such joints usually scatter."""
    return joints > rules.RESTLESS * rules.USUAL_JOINT_NOISE


def reliability(squared: Array) -> Array:
    """Probability (n,) that a reading of whitened squared distance `squared` (three components) is none of the outliers: flat
    at one for good readings, so that Gaussian evidence stays exact, and zero for gross ones."""
    share, size = rules.OUTLIER_SHARE, rules.OUTLIER_SIZE
    return np.asarray(expit(np.log((1 - share) / share) + 3 * np.log(size) - 0.5 * squared * (1 - 1 / size**2)))


def usual_noise(repeats: Repeats | None) -> tuple[float, float]:
    """Joint noise rad before the residual is looked at, and one sigma of its logarithm: what repeats show where there are enough,
    else what is usual."""
    if repeats is None or repeats.freedom < rules.LEAST_REPEATED or repeats.joints <= 0:
        return rules.USUAL_JOINT_NOISE, rules.USUAL_JOINT_NOISE_SD
    return max(repeats.joints, JOINT_NOISE[0]), rules.REPEATED_NOISE_SD + 2.0 / np.sqrt(repeats.freedom)


@dataclass(frozen=True)
class TrackerFit:
    """A fit with active effects: state and its offset (p,) from the prior's mean, active effects with values and covariance,
    linear (residual about everything, derivatives in the layout's unknowns), extra (n, 3, m) m per unit coefficient of all
    active effects side by side, W (n, 3, 3) whitener with the readings' reliability in it, weight (n,), noise, covariance of
    all unknowns, coefficients last."""

    state: State
    offset: Array
    active: tuple[Active, ...]
    linear: Linearised
    extra: Array
    W: Array
    weight: Array
    noise: Noise
    covariance: Array


@dataclass(frozen=True)
class Task:
    """What is fitted: campaign (points only), layout with its priors, prior mean, reference temperature deg C,
    repeats; believed: effects of the cell, in every prediction at their values."""

    campaign: Campaign
    layout: Layout
    start: State
    reference: float
    repeats: Repeats | None = None
    believed: tuple[Active, ...] = ()

    @cached_property
    def link_torques(self) -> Array:
        """Of the links at the readings' postures (`link_torques`)."""
        return link_torques(self.campaign.robot, self.campaign.readings.q)

    def linearised(self, state: State, active: tuple[Active, ...]) -> tuple[Linearised, Array]:
        """Residuals about state and effects, and the effects' columns (n, 3, m)."""
        c = self.campaign
        parts, turned, displacement, sag, more = self._moved(state, active)
        linear = linearise(c.robot, turned, c.instrument, self.layout, state)
        linear.J[:, :3, self.layout.links] = linear.d_joints @ sag
        self._hang_heavier(state, more, linear)
        linear = replace(linear, residual=linear.residual - displacement, point=linear.point + displacement)
        columns = [linear.d_joints @ p[:, :6] + p[:, 6:] for p in parts[len(self.believed) :]]
        return linear, np.concatenate(columns, axis=2) if active else np.zeros((len(turned), 3, 0))

    def points(self, state: State, active: tuple[Active, ...]) -> Array:
        """Predicted reflectors (n, 3) m alone, as `linearised` gives them."""
        _, turned, displacement, *_ = self._moved(state, active)
        return points(self.campaign.robot, turned, self.campaign.instrument, state) + displacement

    def placed(self, state: State, active: Sequence[Active], point: Array | None = None) -> PlacedReadings:
        """The readings about a state and the effects that act there; point (n, 3) m: their reflectors, as measured by default."""
        c = self.campaign
        point = c.readings.point if point is None else point
        return PlacedReadings(c.robot, c.readings, c.instrument, state, point, self.reference, self.start.arm[30:], tuple(active))

    def _moved(self, state: State, active: tuple[Active, ...]) -> tuple[list[Array], Readings, Array, Array, Array]:
        """Of believed and active effects `together`: derivatives of each, the readings with joints turned by effects and by what
        the links' weights are off, displacement (n, 3) m; by how much the joints bend (n, 6, w) rad per unit of such a weight, to
        first order, through springs and effects; what the effects let joints give (n, 6) rad/(N m)."""
        readings, whole = self.campaign.readings, (*self.believed, *active)
        n, parts = len(readings), list[Array]()
        shift, displacement, more = np.zeros((n, 6)), np.zeros((n, 3)), np.zeros((n, 6))
        if whole:
            seen = self.placed(state, whole)
            (parts, shift, displacement), more = together(whole, seen), seen.more[1]
        sag = (np.clip(state.arm[30:], 0.0, None) + more)[:, :, None] * self.link_torques
        return parts, replace(readings, q=readings.q + shift + sag @ state.links), displacement, sag, more

    def _hang_heavier(self, state: State, more: Array, linear: Linearised) -> None:
        """Adds to the payloads' columns what their masses bend through effects (`more`): the arm's own derivative has the
        springs."""
        c = self.campaign
        for k, at in enumerate(self.layout.payload[:, 0]):
            rows = np.flatnonzero(c.readings.payload == k)
            if at >= 0 and len(rows):
                q, centre = c.readings.q[rows], state.payloads[k, 1:]
                each = weight_torques(c.robot, q, 1.0, centre) - weight_torques(c.robot, q)
                linear.J[rows, :3, at] += np.einsum("nij,nj->ni", linear.d_joints[rows], more[rows] * each)


def refit(task: Task, state: State, offset: Array, active: Sequence[Active], noise: Noise) -> TrackerFit:
    """Fit from `state` and the active effects' values, the joint noise with it."""
    begun, none = tuple(active), np.zeros(0)
    found = _rested(task, TrackerFit(state, offset, begun, *task.linearised(state, begun), none, none, noise, none))
    for _ in range(3):
        used = freedom_used(task.layout, found)
        off = found.linear.residual
        c = task.campaign
        after = joint_noise(off, c.readings, c.instrument, found.linear.d_joints, used, *usual_noise(task.repeats))
        small = abs(np.log(after.joints / noise.joints)) < 0.02
        noise = after
        found = _rested(task, replace(found, noise=noise))
        if small:
            break
    return found


def settled(task: Task, fit: TrackerFit) -> TrackerFit:
    """`fit` brought to rest with the priors and readings of `task`; its joint noise stays."""
    linear, extra = task.linearised(fit.state, fit.active)
    return _rested(task, replace(fit, linear=linear, extra=extra))


def _rested(task: Task, fit: TrackerFit) -> TrackerFit:
    """Gauss-Newton from a fit that is linear about these readings, until a step is small against the posterior."""
    start = _Point(task, fit)
    known = np.isfinite(start.prior_sd)
    found = minimise(start, known.astype(float), Rule(STEPS, SETTLED**2 * len(known), rank=RANK))
    at, scale, size = found.at.fit, start.scale, task.layout.size
    covariance = scale[:, None] * found.last.covariance * scale[None, :]
    named = with_coefficients(at.active, coefficients(at.active), covariance[size:, size:])
    return replace(at, active=named, covariance=covariance)


def freedom_used(layout: Layout, fit: TrackerFit) -> float:
    """Degrees of freedom that the readings, not the priors, take up."""
    return float(np.sum(1.0 - np.diag(fit.covariance) / np.concatenate([layout.prior_sd, prior_sds(fit.active)]) ** 2))


def with_weights(layout: Layout, campaign: Campaign) -> Layout:
    """The layout with what of the weights is known only so well (`rules`): masses and centres of the links, masses of the
    payloads, those that were never hung too."""
    robot, r = campaign.robot, campaign.readings
    listed = weighed_links(robot)
    sds = [rules.LINK_MASS_SD if axis < 0 else rules.LINK_CENTRE_SD for _, _, axis in listed]
    names = [name for name, _, _ in listed]
    payload = layout.payload.copy()
    for k, name in enumerate(r.payloads):
        hung = campaign.payloads.get(name)
        if hung is not None and hung.mass > 0:
            payload[k, 0] = layout.size + len(names)
            names.append(f"{name}:mass")
            sds.append(rules.PAYLOAD_MASS_SD * hung.mass)
    return replace(
        layout,
        names=(*layout.names, *names),
        prior_sd=np.append(layout.prior_sd, sds),
        scale=np.append(layout.scale, sds),
        payload=payload,
        links=np.asarray(layout.size + np.arange(len(listed)), int),
    )


@dataclass(frozen=True)
class _Point:
    """A point of the search (`robots.gauss_newton`): a fit before its covariance is known."""

    task: Task
    fit: TrackerFit

    @cached_property
    def prior_sd(self) -> Array:
        """Of all unknowns, coefficients last; inf: free."""
        return np.concatenate([self.task.layout.prior_sd, prior_sds(self.fit.active)])

    @cached_property
    def scale(self) -> Array:
        """Unit of all unknowns."""
        sd, layout = self.prior_sd, self.task.layout
        return np.where(np.isfinite(sd), sd, np.concatenate([layout.scale, np.ones(len(sd) - layout.size)]))

    @property
    def z(self) -> Array:
        return np.concatenate([self.fit.offset, coefficients(self.fit.active)]) / self.scale

    def reweighted(self) -> "_Point":
        c, linear = self.task.campaign, self.fit.linear
        W = whitener(reading_covariance(c.readings, c.instrument, self.fit.noise, linear.d_joints))
        squared = np.einsum("nij,nj->ni", W, linear.residual)
        weight = reliability((squared**2).sum(axis=1))
        return replace(self, fit=replace(self.fit, W=W * np.sqrt(weight)[:, None, None], weight=weight))

    def residual(self) -> Array:
        return np.einsum("nij,nj->ni", self.fit.W, self.fit.linear.residual).ravel()

    def linearised(self) -> tuple[Array, Array]:
        columns = self.fit.W @ np.concatenate([self.fit.linear.J, self.fit.extra], axis=2)
        return self.residual(), columns.reshape(-1, len(self.scale)) * self.scale

    def moved(self, change: Array) -> "_Point":
        step, size, fit = self.scale * change, self.task.layout.size, self.fit
        state = moved(self.task.layout, fit.state, step[:size])
        active = with_coefficients(fit.active, coefficients(fit.active) + step[size:])
        linear, extra = self.task.linearised(state, active)
        offset = fit.offset + step[:size]
        return replace(self, fit=replace(fit, state=state, offset=offset, active=active, linear=linear, extra=extra))


def believed_baseline(
    campaign: Campaign, compliant: tuple[int, ...], reference: float, believed_effects: tuple[Active, ...] = ()
) -> tuple[Task, TrackerFit]:
    """Task and fit of the believed cell; `compliant` joints of the cell, reference temperature deg C; effects that the cell
    believes."""
    real = replace(campaign, readings=replace(campaign.readings, turn=None, sigma_turn=None))
    listed = believed_compliance(campaign.robot) > 0
    believed = tuple(j for j in compliant if listed[j - 1])
    c = real
    if believed_effects:  # what the cell believes is not geometry
        c = without_effects(real, fit_campaign(real, Choice(joints=believed)).state, believed_effects, reference)
    others = tuple(j for j in range(2, 7) if compliant and listed[j - 1] and j not in believed)
    first = fit_campaign(c, Choice(joints=(*believed, *others)), Priors())
    if others and not _bend(first, others):
        rigid = first.state.arm.copy()
        rigid[[29 + j for j in others]] = 0.0
        first = fit_campaign(c, Choice(joints=believed), Priors(), begin=replace(first.state, arm=rigid))
        others = ()
    priors = replace(learned_priors(first), compliance=rules.BELIEVED_SPRING_SD)
    choice = Choice(joints=(*believed, *others))
    layout = with_weights(build_layout(c.robot, c.readings, c.instrument, choice, priors), c)
    none = np.zeros(len(layout.links))
    nominal = replace(nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice), links=none)
    first = replace(first, state=replace(first.state, links=none))
    d_joints = linearise(c.robot, c.readings, c.instrument, layout, first.state).d_joints
    good = first.weight > GROSS  # an outlier among few repeats would pass for their drift
    repeats = repeat_scatter(c.readings.take(good), c.instrument, d_joints[good])
    start = replace(nominal, stations=first.state.stations)
    task = Task(real, layout, start, reference, repeats, believed_effects)
    fit = refit(task, first.state, offset_between(layout, start, first.state), (), Noise(first.noise.joints))
    known = relearned(task, fit)
    return known, fit if known is task else refit(known, fit.state, fit.offset, (), fit.noise)


def _bend(fit: Fit, others: tuple[int, ...]) -> bool:
    """Whether the joints that the cell does not believe to bend do so as their listed springs say, all together."""
    listed = believed_compliance(fit.campaign.robot)
    odds = 0.0
    for j in others:
        c, sd = float(fit.state.arm[29 + j]), float(fit.sd[fit.layout.arm[29 + j]])
        stray = rules.STRAY_SPRINGS * _normal(c, float(np.hypot(rules.STRAY_COMPLIANCE, sd)))
        agree = _normal(c - listed[j - 1], float(np.hypot(rules.BELIEVED_SPRING_SD * listed[j - 1], sd)))
        rigid = _normal(c, float(np.hypot(0.05 * listed[j - 1], sd)))
        odds += float(np.log((1 - rules.STRAY_SPRINGS) * agree + stray) - np.log((1 - rules.STRAY_SPRINGS) * rigid + stray))
    return odds > 0.0


def _normal(off: float, sd: float) -> float:
    """Density of a normal law `off` its mean."""
    return float(np.exp(-0.5 * (off / sd) ** 2) / (np.sqrt(2.0 * np.pi) * sd))


def relearned(task: Task, fit: TrackerFit) -> Task:
    """The task with the geometry's prior as wide as the deviations now found (MacKay 1992, eq. 2.20): an effect that is named
    has left the geometry; and weights believed the better the less the readings ask of them, at most as wide as `rules` says.
    The same task where the widths hardly change."""
    layout = task.layout
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    prior, scale = layout.prior_sd.copy(), layout.scale.copy()
    changed = False
    for columns in layout.geometry:
        if not len(columns):
            continue
        before = float(prior[columns[0]])
        width = learned_width(fit.offset[columns], sd[columns], before)
        if abs(np.log(width / before)) > rules.RELEARNED_WIDTH:
            prior[columns] = scale[columns] = width
            changed = True
    weights = layout.links
    if len(weights):
        before = float(prior[weights[0]] / scale[weights[0]])
        unit = np.outer(scale[weights], scale[weights])
        width = _width_of_weights(fit.offset[weights] / scale[weights], fit.covariance[np.ix_(weights, weights)] / unit, before)
        if abs(np.log(width / before)) > rules.RELEARNED_WIDTH:
            prior[weights] = width * scale[weights]
            changed = True
    return replace(task, layout=replace(layout, prior_sd=prior, scale=scale)) if changed else task


def _width_of_weights(offset: Array, covariance: Array, before: float) -> float:
    """Rms of the common width of weights over its posterior, by the evidence of what a fit with the prior width `before` made of
    them, offset (w,) and covariance (w, w), all in units of `rules`."""
    precision = np.linalg.inv(covariance)
    seen, turn = np.linalg.eigh(precision - np.eye(len(offset)) / before**2)  # what the readings say without the prior
    seen, pulled = np.maximum(seen, 0.0), turn.T @ (precision @ offset)
    squares = rules.WEIGHT_WIDTHS[:, None] ** 2
    log = 0.5 * (squares * pulled**2 / (1.0 + squares * seen) - np.log1p(squares * seen)).sum(axis=1)
    weight = np.exp(log - log.max())
    return float(np.sqrt(weight @ rules.WEIGHT_WIDTHS**2 / weight.sum()))
