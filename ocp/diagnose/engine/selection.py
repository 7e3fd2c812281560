"""Names selected on held-out error, for arms whose believed model misses far more than noise.

Evidence takes what a set of effects leaves for white noise. On a real arm it is not: ripples of every gear remain, and with a
thousand readings the form that happens to follow them nearby wins by any number of log units over the form that physics has.
Where the scatter of the residual is many times what joints of such robots usually show, every candidate is therefore fitted,
with the geometry, without a block of the workspace, half of a joint's range, a payload, the latest third, and judged on what
was left out. Accepted is what lowers the mean of the folds' log mean squares most. A candidate that leaves a fold worse than
the believed cell alone does is refused; it is tried again when another effect stands (a ripple looks harmful as long as the
springs are missing). One effect at two joints is tried together: springs that carry the same weight mask each other. Those that
gain more than what is accepted and that a fold refuses are the impostors. The kernel that is needed beside the accepted names
tells where the rest lies.

Everything is linear about the channel's fit, in whitened readings, nuisance within its priors (docs/diagnosis_real.md).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import NOTHING, Search
from ocp.diagnose.engine.channel_system import Channel, Fold, System, WeighedReadings
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.linearisation import Candidate, Linearisation, candidates, linearised, put_back
from ocp.diagnose.engine.pool import squares
from ocp.effects.effect import Active, Effect, Scanned
from robots.pose import Array, Mask


@dataclass(frozen=True)
class Refused:
    """An effect that gains `gain` (whitened sum of squares) on all readings and that `fold` refuses: its mean square is `ratio`
    times that of the believed cell alone; beside: effects accepted by then."""

    name: Name
    gain: float
    fold: str
    ratio: float
    beside: int


@dataclass(frozen=True)
class SelectedEffects:
    """Accepted effects in order, with their coefficients with all others on all readings, to begin a fit from; scores: mean log
    mean square of the folds with each and all before it, over that of the believed cell; refused ones that gained more than the
    ones accepted in their round and never were."""

    active: tuple[Active, ...]
    scores: tuple[float, ...]
    refused: tuple[Refused, ...]


@dataclass(frozen=True)
class Entry:
    """A candidate at its best variant: columns (N, m) in units of the usual upper ends `scale` (m,), gain on all readings;
    turned: its value has a sign that no machine has."""

    effect: Effect
    name: Name
    scanned: Scanned
    columns: Array
    scale: Array
    gain: float
    turned: bool


def select_on_held_out(system: System, candidates: Sequence[Candidate], folds: Sequence[Fold], most: int = 8) -> SelectedEffects:
    """Effects that hold in left-out conditions, at most `most`. system: about the believed cell's fit without effects;
    candidates: their whitened columns about the same fit; folds of kind "random" do not count."""
    apart = [f for f in folds if f.kind != "random"]
    parts = [_Fitted(system, ~np.asarray(f.held, bool)[system.reading]) for f in apart]
    whole = _Fitted(system, np.ones(len(system.residual), bool))
    believed = np.array([held[0, 0] for _, held in (p.squares(system.residual[:, None]) for p in parts)])
    pool = [_freed(c, whole) for c in candidates]
    chosen: list[Entry] = []
    scores: list[float] = []
    refused: dict[Name, Refused] = {}
    while len(chosen) < most:
        short = _shortlist(whole, system, pool, candidates, chosen)
        # Each alone, and one effect at two joints: springs that carry the same weight mask each other, and neither holds alone.
        pairs = [[a, b] for a, b in combinations(short, 2) if a.name.effect == b.name.effect]
        choices = [[e] for e in short] + (pairs if len(chosen) < most - 1 else [])
        ratios = _ratios(system, parts, chosen, short, choices) / believed
        errors = [float(np.mean(np.log(r))) for r in ratios]
        bar = scores[-1] if scores else 0.0
        price = [rules.WRONG_SIGN_GAIN * sum(e.turned for e in choice) for choice in choices]
        wanted = [bar - rules.HELD_OUT_GAIN * len(choice) - p for choice, p in zip(choices, price, strict=True)]
        fine = [k for k, r in enumerate(ratios) if r.max() < rules.HELD_OUT_WORSE and errors[k] < wanted[k]]
        best = min(fine, key=lambda k: errors[k] + price[k], default=-1)
        gain = max(e.gain for e in choices[best]) if fine else 0.0
        for entry, r in zip(short, ratios, strict=False):  # singles come first among the choices
            if entry.gain > gain and r.max() >= rules.HELD_OUT_WORSE:
                refused[entry.name] = Refused(entry.name, entry.gain, apart[int(np.argmax(r))].name, float(r.max()), len(chosen))
        if not fine:
            break
        chosen += choices[best]
        scores += [errors[best]] * len(choices[best])
    never = tuple(r for n, r in refused.items() if n not in {e.name for e in chosen})
    return SelectedEffects(_with_values(whole, system, chosen), tuple(scores), never)


class _Fitted:
    """The nuisance fitted to `rows` (N,) of a system within its priors, factored once for all columns."""

    def __init__(self, system: System, rows: Mask) -> None:
        known = np.isfinite(system.prior_sd)
        scale = np.where(known, system.prior_sd, 1.0)
        A = system.nuisance * scale
        self.rows = rows
        self.mean = -(system.offset / scale)[known]
        self.Q, R = np.linalg.qr(np.vstack([A[rows], np.eye(A.shape[1])[known]]))
        self.others = A[~rows] @ np.linalg.pinv(R, rcond=1e-10)

    def without(self, B: Array, readings: bool = True) -> tuple[Array, Array]:
        """Columns B (N, k) less the nuisance: rows of the fit with the priors' below, and all other rows; readings: whether the
        first column is the readings, whose priors have a mean."""
        n, fitted = len(self.Q) - len(self.mean), np.zeros((len(self.Q), B.shape[1]))
        np.compress(self.rows, B, axis=0, out=fitted[:n])
        if readings:
            fitted[n:, 0] = self.mean
        turned = self.Q.T @ fitted
        fitted -= self.Q @ turned
        return fitted, B[~self.rows] - self.others @ turned

    def squares(self, B: Array) -> tuple[Array, Array]:
        """Products (k, k) of columns B (N, k), the readings first, less the nuisance: in the fit, and over other rows, a mean."""
        train, held = self.without(B)
        return train.T @ train, held.T @ held / max(len(held), 1)


Freed = tuple[Array, Array]
"""A candidate less the nuisance of all readings: columns (N + p, V m) over their priors, their products (V, m, m)."""


def _freed(c: Candidate, whole: _Fitted) -> Freed:
    n, V, m = c.columns.shape
    flat, _ = whole.without((c.columns * _scale(c)).reshape(n, V * m), readings=False)
    return flat, squares(flat.reshape(-1, V, m))


def _ratios(
    system: System, parts: Sequence[_Fitted], chosen: Sequence[Entry], short: Sequence[Entry], choices: Sequence[Sequence[Entry]]
) -> Array:
    """Mean squares (c, f) of the folds with what is chosen and each of the choices, made of entries of `short`, fitted."""
    B = np.hstack([system.residual[:, None], *(e.columns for e in (*chosen, *short))])
    ends = np.cumsum([1, *(len(e.scale) for e in (*chosen, *short))])
    place = {id(e): range(i, j) for e, i, j in zip((*chosen, *short), ends[:-1], ends[1:], strict=True)}
    columns = [[k for e in (*chosen, *choice) for k in place[id(e)]] for choice in choices]
    found = np.empty((len(choices), len(parts)))
    for f, (train, held) in enumerate(part.squares(B) for part in parts):
        for c, own in enumerate(columns):
            a = np.append(1.0, -_solved(train[np.ix_(own, own)], train[own, 0]))
            found[c, f] = a @ held[np.ix_([0, *own], [0, *own])] @ a
    return found


def _solved(G: Array, b: Array) -> Array:
    """Coefficients (m,) over their wide priors of columns with products G (m, m) and b (m,) with the readings."""
    return np.asarray(np.linalg.solve(G + np.eye(len(b)) / rules.WIDE_PRIOR**2, b))


def _shortlist(
    whole: _Fitted, system: System, pool: Sequence[Freed], candidates: Sequence[Candidate], chosen: Sequence[Entry]
) -> list[Entry]:
    """What gains most on all readings beside what is chosen, the largest first; no values over three times what is usual."""
    fitted = _fitted(whole, system, chosen)
    Q = np.linalg.qr(fitted[:, 1:])[0]
    left = fitted[:, 0] - Q @ (Q.T @ fitted[:, 0])
    taken = {e.name for e in chosen}
    found = []
    for (flat, products), c in zip(pool, candidates, strict=True):
        name = Name(c.effect.name, c.joint)
        if name in taken:
            continue
        _, V, m = c.columns.shape
        G = products - squares((Q.T @ flat).reshape(-1, V, m)) + np.eye(m) / rules.WIDE_PRIOR**2
        b = (left @ flat).reshape(V, m)
        a = np.linalg.solve(G, b[..., None])[..., 0]
        gain = np.where((np.abs(a) > rules.IMPLAUSIBLE).any(axis=1), 0.0, np.einsum("vi,vi->v", a, b))
        v = int(np.argmax(gain))
        turned = bool((a[v] < 0)[c.effect.positive].any())
        if gain[v] > 0:
            found.append(Entry(c.effect, name, c.scans[v], c.columns[:, v] * _scale(c), _scale(c), float(gain[v]), turned))
    return sorted(found, key=lambda e: -e.gain)[: rules.SHORTLIST]


def _fitted(whole: _Fitted, system: System, entries: Sequence[Entry]) -> Array:
    """Readings and entries' columns with the nuisance fitted to all readings taken out, the priors' rows below."""
    return whole.without(np.hstack([system.residual[:, None], *(e.columns for e in entries)]))[0]


def _with_values(whole: _Fitted, system: System, chosen: Sequence[Entry]) -> tuple[Active, ...]:
    """The entries with their coefficients, all fitted together to all readings."""
    fitted = _fitted(whole, system, chosen)
    a = _solved(fitted[:, 1:].T @ fitted[:, 1:], fitted[:, 1:].T @ fitted[:, 0])
    blocks = np.split(a, np.cumsum([len(e.scale) for e in chosen], dtype=int))
    values = [block * e.scale for block, e in zip(blocks, chosen, strict=False)]
    return tuple(Active(e.effect, e.name.joint, v, e.scanned, np.eye(len(v))) for e, v in zip(chosen, values, strict=True))


def _scale(c: Candidate) -> Array:
    return np.asarray(c.effect.prior_sd, float)


def misses_far_more_than_noise(problem: Linearisation, search: Search) -> bool:
    """Whether names must be selected on held-out error: the only channel says that noise is far above the usual, even with all
    that the best set of names and kernels explains."""
    channels = problem.channels
    if len(channels) != 1 or not isinstance(channels[0], WeighedReadings):
        return False
    return channels[0].restless(float(np.sqrt(problem.taken(search.sets[search.best()[0]]).left / problem.pool.freedom)))


def select_effects(
    channel: Channel, library: Mapping[str, Effect], options: Options
) -> tuple[Linearisation, Search, tuple[tuple[Name, str], ...]]:
    """Names of a channel fitted without effects, by held-out errors; refused ones are barred from the library. The linearisation
    about the selected names, their sets weighed, and what was refused with the fold that did.

    Twice: what is found first (springs, mostly) leaves the geometry, whose prior is as wide as what it had to follow, narrower.
    """
    offered = candidates([channel], library, options)
    first = select_on_held_out(channel.system, offered, channel.folds(), most=rules.SELECTED_FIRST)
    about = channel.with_active(first.active)
    system = replace(about.system, residual=about.system.residual + put_back([about], about.active))
    found = select_on_held_out(system, candidates([about], library, options), channel.folds())
    refused = tuple((r.name, r.fold) for r in found.refused)
    barred = replace(options, barred=(*options.barred, *(n for n, _ in refused)))
    problem = linearised([channel.with_active(found.active)], library, barred)
    search = Search(problem.pool, max(options.most, len(found.active)) + 1, options.beam)
    names = frozenset(problem.index[Name(*a.key)] for a in found.active)
    search.add(names)
    there = search.sets.get(names, NOTHING)
    gain = np.where(search.kernel, search.scan(there).log + search.odds, -np.inf)
    kernels = [int(k) for k in np.argsort(-gain)[: rules.KERNELS_BESIDE] if np.isfinite(gain[k])]
    for key in [names, *(names | {k} for k in kernels)]:
        search.add(key, there.members)
        for family in names:  # what each is worth beside the others
            search.add(key - {family}, there.members)
    count = 0
    while count < len(search.sets):  # beside a kernel what followed it in part is often worth nothing, one after another
        count, best = len(search.sets), search.best()[0]
        for family in names & best:
            search.add(best - {family}, there.members)
    return problem, search, refused
