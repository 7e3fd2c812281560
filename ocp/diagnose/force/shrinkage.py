"""How far the gap of a force log shrinks: what the named effects change in grinding that comes after it.

Where conditions are asked for, there: they hold no readings. Else the log's recordings are ground once more, later on the same
clock. What wears, is ground away or drifts
is larger there than in any part of the log that could be left out, and the baseline, registered on the log, does not follow. New
readings are taken to come soon after the log's end or as much later as the log itself took, or, less probably, between its
recordings. Where warmth counts the hall is as warm as at the log's end or goes on warming as it did, and the wheel is warm or has
cooled down. Beside what the effects change stand the errors of the unknowns (docs/diagnose.md, eq. 2). What recordings differ by
is noise, which is no part of a gap.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ocp.calibrate.force.rows import LogConditions
from ocp.diagnose.engine.channel_system import HeldOut
from ocp.diagnose.engine.findings import Alternative
from ocp.diagnose.force.channel import ForceChannel
from ocp.diagnose.force.fit import linear_normal
from ocp.diagnose.force.held_out import Asked
from ocp.diagnose.force.prediction import LogScene, predict_forces
from ocp.diagnose.rules import BETWEEN_RUNS, LATER_FORCE, NEW_RECORDINGS, NO_GAP
from ocp.diagnose.verdict.shrinkage import DRAWS, Shrinkage, drawn_errors, interval, unexplained
from ocp.effects.effect import Active
from robots.errors import Infeasible
from robots.pose import Array, Index

ROWS = 600  # of the log, evenly taken


@dataclass(frozen=True)
class LaterGrinding:
    """n rows in contact under c conditions: moved (c, a, n) N, what each of a alternatives adds to the baseline's normal reading;
    errors (c, n, p) N per unit of the accepted fit's unknowns, their covariance (p, p); probability (a,) of the alternatives, the
    accepted one first; share (c,): probability of the conditions; run (n,): which recording (0, 1, ..) a row is of; whole: of
    these very rows, all of them."""

    moved: Array
    errors: Array
    covariance: Array
    probability: Array
    share: Array
    run: Index
    whole: bool = False


def anticipated_grinding(
    before: ForceChannel, after: ForceChannel, others: Sequence[Alternative] = (), asked: Asked | None = None
) -> LaterGrinding | None:
    """The log's recordings under later conditions, or what is `asked` for; others: alternatives, the accepted one (which `after`
    is) first; those under which the contact cannot be computed there are left out. None where that is the accepted one."""
    followed = [(m, o.probability) for o in others if (m := _with(before, after, o.active)) is not None] or [(after, 1.0)]
    models, p = [m for m, _ in followed], np.array([one for _, one in followed])
    rows = np.unique(np.linspace(0, len(after.log) - 1, min(len(after.log), ROWS)).astype(np.int64))
    known = after.problem.scene.conditions
    moved, errors = [], []
    active = [a for m in models for a in m.fit.active]
    warmths = (False, True) if any("temperature" in column for a in active for column in a.effect.needs) else (False,)
    later = [after_log(known, share, changing) for share in LATER_FORCE for changing in warmths]
    scenes = (_scene(after, conditions, rows) for conditions in (known, *later)) if asked is None else (asked.there,)
    for there in scenes:
        touching = there.touching
        old = predict_forces(there, before.fit.at.x, before.fit.active).fn
        found = [predict_forces(there, m.fit.at.x, m.fit.active) for m in models]
        moved.append(np.stack([(made.fn - old)[touching] for made in found]))
        errors.append(linear_normal(models[0].problem, there, found[0])[touching])
    there_too = np.array([all(np.isfinite(one[k]).all() for one in moved) for k in range(len(models))])
    if not there_too[0] or not np.isfinite(np.stack(errors)).all():
        return None
    moved, p = [one[there_too] for one in moved], p[there_too]
    share = np.array([BETWEEN_RUNS, *((1.0 - BETWEEN_RUNS) / len(later) for _ in later)]) if asked is None else np.ones(1)
    run = np.unique(there.conditions.run[touching], return_inverse=True)[1].astype(np.int64)
    # Of the unknowns that go on: the nuisance and the effects' coefficients, not what single recordings were off by.
    fit, (r, o) = models[0].fit, models[0].problem.sizes
    keep = np.r_[np.arange(r), np.arange(r + o, len(fit.z))]
    covariance = np.linalg.inv(fit.information)[np.ix_(keep, keep)]
    return LaterGrinding(np.stack(moved), np.stack(errors), covariance, p / p.sum(), share, run, asked is not None)


def after_log(known: LogConditions, share: float, changing: bool = False) -> LogConditions:
    """The same recordings `share` of the log's span after its end; the lines were ground on as often as before, in proportion. As
    warm as at its end; changing: the hall went on warming at the log's mean rate, and the wheel cooled to where it began."""
    first, last = int(np.argmin(known.clock)), int(np.argmax(known.clock))
    clock = known.clock + share * float(np.ptp(known.clock)) + float(known.clock.max()) - _start(known)
    ground = known.ground_before.copy()
    for line in np.unique(known.line):
        at = known.line == line
        times = len(np.unique(known.run[at & known.contact]))
        if times and not np.isnan(ground[at]).all():
            ground[at] = np.nanmax(ground[at & known.contact]) + 1.0 + np.round(share * times)
    hall = known.warm[last] + changing * share * (known.warm[last] - known.warm[first])
    wheel = known.wheel_warm[first if changing else last]
    n = len(clock)
    return replace(known, clock=clock, ground_before=ground, warm=np.full(n, hall), wheel_warm=np.full(n, wheel))


def _start(known: LogConditions) -> Array:
    """Clock s at the start of every row's recording (n,)."""
    run = np.unique(known.run, return_inverse=True)[1]
    first = np.full(int(run.max()) + 1, np.inf)
    np.minimum.at(first, run, known.clock)
    return first[run]


def _with(before: ForceChannel, after: ForceChannel, active: tuple[Active, ...]) -> ForceChannel | None:
    """The channel with these effects; one of those given where it is that already, None where no fit with them comes to rest."""
    with suppress(Infeasible):
        return after.fitted_with(active) if active else before
    return None


def _scene(channel: ForceChannel, conditions: LogConditions, rows: Index) -> LogScene:
    """Some of the log's rows under other conditions. Effects that remember see time in coarser steps."""
    scene, known = channel.problem.scene, conditions.take(rows)
    pressed = None if scene.pressed is None else scene.pressed[rows]
    return scene.over(scene.rows.take(rows), known, pressed)


def from_grinding(
    new: LaterGrinding,
    noise: float,
    held: Sequence[HeldOut] = (),
    unknown: float = 0.0,
    carried: tuple[float, float] | None = None,
) -> Shrinkage | None:
    """Of force readings: what is anticipated; noise: mean square N^2. Drawn are which alternative is true, how late the readings
    come, of which recordings they are, the unknowns' errors, what is there under no name; `carried`: and which share (mean, sd)
    of what alternatives add to the last one is there again. Folds alone do not say whether
    something is: gross readings leave as much. None: no gap to speak of."""
    rng = np.random.default_rng(0)
    there = None if carried is None else np.random.default_rng(0).normal(*carried, DRAWS)[:, None]
    errors = drawn_errors(new.covariance, rng)
    true = rng.choice(len(new.probability), DRAWS, p=new.probability)
    when = rng.choice(len(new.share), DRAWS, p=new.share)
    runs = int(new.run.max()) + 1
    if new.whole:
        even = np.full(len(new.run), 1.0 / len(new.run))
        rows = np.broadcast_to(even, (DRAWS, len(even)))
    else:
        # A Dirichlet law of n weights a each is worth (n a + 1) / (a + 1) of them.
        weight = (NEW_RECORDINGS - 1.0) / (runs - NEW_RECORDINGS) if runs > NEW_RECORDINGS else 1e3
        even = 1.0 / (runs * np.bincount(new.run)[new.run])
        rows = rng.dirichlet(np.full(runs, weight), DRAWS)[:, new.run] / np.bincount(new.run)[new.run]
    before, after, usual = (np.zeros(DRAWS) for _ in range(3))
    for k, moved in enumerate(new.moved):
        at = when == k
        off, planted = errors[at] @ new.errors[k].T, moved[true[at]]
        planted = planted if there is None else moved[-1] + there[at] * (planted - moved[-1])
        after[at] = np.sum(rows[at] * (moved[0] - planted + off) ** 2, axis=1)
        gap = (off - planted) ** 2
        before[at], usual[at] = np.sum(rows[at] * gap, axis=1), gap @ even
    errors_of_effects = [h.estimation for h in held if h.fold.kind == "random"]
    rest = unexplained(held, float(np.mean(errors_of_effects or [0.0])), rng) * (rng.uniform(size=DRAWS) < unknown)
    if np.median(usual + rest) <= NO_GAP**2 * noise:  # of all recordings alike
        return None
    return interval(1.0 - np.sqrt((after + rest) / (before + rest)))
