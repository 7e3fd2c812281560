"""What the named effects change in grinding that comes after the log: its recordings once more, later on the same clock.

Nothing sealed is read. What wears, is ground away or drifts is larger there than in any part of the log that could be left out,
and the baseline, registered on the log, does not follow. New readings are taken to come soon after the log's end or as much later
as the log itself took, or, less probably, between its recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.diagnosis.findings import Alternative
from ocp.diagnosis.force.arm import arm_of
from ocp.diagnosis.force.channel import ForceChannel
from ocp.diagnosis.force.conditions import LogConditions
from ocp.diagnosis.force.fit import ForceFit, linear_normal
from ocp.diagnosis.force.prediction import Predicted, Scene, predict
from ocp.diagnosis.system import scan_key
from ocp.effects.effect import Active
from robots.measurements import Index
from robots.pose import Array

# How far after the log's end, in its own spans of time: the middles of three equal parts of one span, drawn alike.
LATER = (1.0 / 6.0, 0.5, 5.0 / 6.0)
AMID = 0.25  # probability that new readings come between the log's own
ROWS = 400  # in contact, evenly taken


@dataclass(frozen=True)
class Grinding:
    """n rows in contact under c conditions: moved (c, a, n) N, what each of a alternatives adds to the baseline's normal reading;
    errors (c, n, p) N per unit of the accepted fit's unknowns, their covariance (p, p); probability (a,) of the alternatives, the
    accepted one first; told (a,): their weight in the correction; share (c,): probability of the conditions; run (n,): which
    recording (0, 1, ..) a row is of."""

    moved: Array
    errors: Array
    covariance: Array
    probability: Array
    told: Array
    share: Array
    run: Index


def anticipated_grinding(
    before: ForceChannel, after: ForceChannel, others: Sequence[Alternative] = (), least: float = 0.0
) -> Grinding:
    """The log's recordings under later conditions; others: alternatives, the accepted one (which `after` is) first; those below
    the probability `least` may be true, but no correction follows them."""
    models = [_with(before, after, o.active) for o in others] or [after]
    touching = after.problem.scene.touching
    rows = touching[np.unique(np.linspace(0, len(touching) - 1, min(len(touching), ROWS)).astype(np.int64))]
    told = after.problem.scene.conditions
    moved, errors = [], []
    for conditions in (told, *(after_log(told, share) for share in LATER)):
        old = _predicted(before, conditions)[1].fn[rows]
        found = [_predicted(m, conditions) for m in models]
        moved.append(np.stack([made.fn[rows] - old for _, made in found]))
        errors.append(linear_normal(models[0].problem, *found[0])[rows])
    p = np.array([o.probability for o in others] or [1.0])
    kept = np.where((p >= least) | (np.arange(len(p)) == 0), p, 0.0)
    share = np.array([AMID, *((1.0 - AMID) / len(LATER) for _ in LATER)])
    run = np.unique(told.run[rows], return_inverse=True)[1].astype(np.int64)
    return Grinding(np.stack(moved), np.stack(errors), _covariance(models[0]), p / p.sum(), kept / kept.sum(), share, run)


def after_log(told: LogConditions, share: float) -> LogConditions:
    """The same recordings `share` of the log's span after its end, as warm as at its end; the lines were ground on as often as
    before, in proportion."""
    last = int(np.argmax(told.clock))
    clock = told.clock + share * float(np.ptp(told.clock)) + float(told.clock.max()) - _start(told)
    ground = told.ground_before.copy()
    for line in np.unique(told.line):
        at = told.line == line
        times = len(np.unique(told.run[at & told.contact]))
        if times and not np.isnan(ground[at]).all():
            ground[at] = np.nanmax(ground[at & told.contact]) + 1.0 + np.round(share * times)
    warm, wheel_warm = (np.full(len(clock), values[last]) for values in (told.warm, told.wheel_warm))
    return replace(told, clock=clock, ground_before=ground, warm=warm, wheel_warm=wheel_warm)


def _start(told: LogConditions) -> Array:
    """Clock s at the start of every row's recording (n,)."""
    run = np.unique(told.run, return_inverse=True)[1]
    first = np.full(int(run.max()) + 1, np.inf)
    np.minimum.at(first, run, told.clock)
    return first[run]


def _with(before: ForceChannel, after: ForceChannel, active: tuple[Active, ...]) -> ForceChannel:
    """The channel with these effects; one of those given where it is that already."""
    kinds = [{(a.effect.name, a.joint, scan_key(a.scanned)) for a in one} for one in (active, after.active)]
    if not active:
        return before
    return after if kinds[0] == kinds[1] else after.with_active(active)


def _predicted(channel: ForceChannel, conditions: LogConditions) -> tuple[Scene, Predicted]:
    """The log's rows under other conditions at the channel's fit."""
    problem, fit = channel.problem, channel.fit
    scene = problem.scene
    if conditions is scene.conditions:
        return scene, fit.at
    there = replace(scene, conditions=conditions, arm=arm_of(scene.cell, scene.theta, problem.log.q, conditions))
    # Cached properties belong to the object that `replace` was called on, so air and touching are found anew.
    at = predict(there, fit.at.x, fit.active, fit.at)
    return there, predict(there, fit.at.x, fit.active, at)


def _covariance(channel: ForceChannel) -> Array:
    """Of the unknowns that go on: the nuisance and the effects' coefficients, not what single recordings were off by."""
    fit: ForceFit = channel.fit
    r, o = channel.problem.sizes
    keep = np.r_[np.arange(r), np.arange(r + o, len(fit.z))]
    return np.asarray(np.linalg.inv(fit.information)[np.ix_(keep, keep)])
