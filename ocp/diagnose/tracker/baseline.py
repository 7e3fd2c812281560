"""The believed cell refitted: what a good calibration yields, and the start of every diagnosis of tracker readings.

It holds the geometry, the frames, the nests and the springs of the believed joints (within 35 % of what is believed: a spring
that is far off is an effect, joint_compliance). Springs that the cell lists for other joints are for contact forces; whether they
bend under weight as well the readings tell, for all such joints together: then they belong to the baseline at their listed
values, else those joints are rigid. Payloads are as the cell says: a wrong one is an effect.
"""

from dataclasses import replace

import numpy as np

from ocp.diagnose.rules import BELIEVED_SPRING_SD, RELEARNED_WIDTH, STRAY_COMPLIANCE, STRAY_SPRINGS
from ocp.diagnose.tracker.refit import Task, TrackerFit, refit
from robots.calibration.fit import Fit, fit_campaign, learned_priors, learned_width
from robots.calibration.layout import Choice, Priors, believed_compliance, build_layout, nominal_state, offset_between
from robots.calibration.noise import Noise, repeat_scatter
from robots.calibration.residuals import linearise
from robots.calibration.solver import Campaign
from robots.calibration.validation import GROSS


def believed_baseline(
    campaign: Campaign, compliant: tuple[int, ...], reference: float, stated: bool = True
) -> tuple[Task, TrackerFit]:
    """Task and fit of the believed cell; `compliant` joints of the cell, reference temperature deg C; stated: whether the cell
    lists the springs itself. Springs that only the robot's catalogue knows belong to `compliant` joints alone."""
    points = replace(campaign, readings=replace(campaign.readings, turn=None, sigma_turn=None))
    listed = believed_compliance(campaign.robot) > 0
    believed = tuple(j for j in compliant if listed[j - 1])
    others = tuple(j for j in range(2, 7) if stated and listed[j - 1] and j not in believed)
    first = fit_campaign(points, Choice(joints=(*believed, *others)), Priors())
    if others and not _bend(first, others):
        first = fit_campaign(points, Choice(joints=believed), Priors(), begin=_rigid(first, others).state)
        others = ()
    priors = replace(learned_priors(first), compliance=BELIEVED_SPRING_SD)
    choice = Choice(joints=(*believed, *others))
    c = points
    layout = build_layout(c.robot, c.readings, c.instrument, choice, priors)
    nominal = nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice)
    d_joints = linearise(c.robot, c.readings, c.instrument, layout, first.state).d_joints
    good = first.weight > GROSS  # an outlier among few repeats would pass for their drift
    repeats = repeat_scatter(c.readings.take(good), c.instrument, d_joints[good])
    start = replace(nominal, stations=first.state.stations)
    task = Task(points, layout, start, reference, repeats)
    return task, refit(task, first.state, offset_between(layout, start, first.state), (), Noise(first.noise.joints))


def _bend(fit: Fit, others: tuple[int, ...]) -> bool:
    """Whether the joints that the cell does not believe to bend do so as their listed springs say, all together."""
    listed = believed_compliance(fit.campaign.robot)
    odds = 0.0
    for j in others:
        c, sd = float(fit.state.arm[29 + j]), float(fit.sd[fit.layout.arm[29 + j]])
        stray = STRAY_SPRINGS * _normal(c, float(np.hypot(STRAY_COMPLIANCE, sd)))
        agree = _normal(c - listed[j - 1], float(np.hypot(BELIEVED_SPRING_SD * listed[j - 1], sd)))
        rigid = _normal(c, float(np.hypot(0.05 * listed[j - 1], sd)))
        odds += float(np.log((1 - STRAY_SPRINGS) * agree + stray) - np.log((1 - STRAY_SPRINGS) * rigid + stray))
    return odds > 0.0


def _normal(off: float, sd: float) -> float:
    """Density of a normal law `off` its mean."""
    return float(np.exp(-0.5 * (off / sd) ** 2) / (np.sqrt(2.0 * np.pi) * sd))


def _rigid(fit: Fit, others: tuple[int, ...]) -> Fit:
    """The fit's state with these joints rigid, to begin from."""
    arm = fit.state.arm.copy()
    arm[[29 + j for j in others]] = 0.0
    return replace(fit, state=replace(fit.state, arm=arm))


def relearned(task: Task, fit: TrackerFit) -> Task:
    """The task with the geometry's prior as wide as the deviations now found (MacKay 1992, eq. 2.20): an effect that is named
    has left the geometry. The same task where the widths hardly change."""
    layout = task.layout
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    prior, scale = layout.prior_sd.copy(), layout.scale.copy()
    changed = False
    for columns in layout.geometry:
        if not len(columns):
            continue
        before = float(prior[columns[0]])
        width = learned_width(fit.offset[columns], sd[columns], before)
        if abs(np.log(width / before)) > RELEARNED_WIDTH:
            prior[columns] = scale[columns] = width
            changed = True
    return replace(task, layout=replace(layout, prior_sd=prior, scale=scale)) if changed else task
