"""The table of DIAGNOSIS.md, "How it is judged", from the rows of scored worlds: each figure with its confidence interval and its
worlds; what chance would reach; the worst answers in words.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit

from ocp.blindtest.scoring import SURE, first_right
from ocp.blindtest.worlds.recipes import BEYOND, BINS, bin_of, bin_words, share_of_range
from ocp.simulate.twin.planting import Planted
from robots.pose import Array

Z95 = 1.959964
DRAWS = 2000
SCORINGS = 200  # at most; ten do, but where nothing is seen
HALVINGS = 20


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval and how many worlds it rests on; nan without any."""

    value: float
    low: float
    high: float
    count: int


NOTHING = Estimate(float("nan"), float("nan"), float("nan"), 0)


def share_of_hits(hits: Sequence[bool]) -> Estimate:
    """Share of hits (Wilson 1927, eq. 6)."""
    n = len(hits)
    if n == 0:
        return NOTHING
    p, z2 = sum(map(bool, hits)) / n, Z95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = Z95 / (1 + z2 / n) * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    # Rounding must not leave the share outside its interval.
    return Estimate(p, float(min(max(middle - half, 0.0), p)), float(max(min(middle + half, 1.0), p)), n)


def bootstrap(rows: Sequence[Sequence[float]], figure: Callable[[Array], Array], seed: int = 0) -> Estimate:
    """A figure of rows (n, k) with the interval of `DRAWS` draws of whole rows; figure: of tables (d, n, k), one each (d,)."""
    table = np.asarray(rows, float)
    n = len(table)
    if n == 0:
        return NOTHING
    drawn = figure(table[np.random.default_rng(seed).integers(n, size=(DRAWS, n))])
    low, high = np.nanquantile(drawn, [0.025, 0.975])
    return Estimate(float(figure(table[None])[0]), float(low), float(high), n)


def median(values: Sequence[float]) -> Estimate:
    """Median of values."""
    return bootstrap([[v] for v in values], lambda t: np.median(t[..., 0], axis=1))


def share_in_groups(groups: Sequence[Sequence[bool]]) -> Estimate:
    """Share of hits in all groups together, groups drawn as wholes: hits of one world are not independent."""
    rows = [[sum(map(bool, g)), len(g)] for g in groups if len(g)]
    return bootstrap(rows, lambda t: t[..., 0].sum(axis=1) / t[..., 1].sum(axis=1))


def f1(counts: Sequence[tuple[int, int, int]]) -> Estimate:
    """F1 of rows (found, named, planted), summed over worlds."""
    return bootstrap(counts, lambda t: 2 * t[..., 0].sum(axis=1) / np.maximum(t[..., 1:].sum(axis=(1, 2)), 1))


Row = dict[str, Any]
USUAL = ("single", "pair", "triple", "none", "none_background")  # kinds of which the catalogue holds all
STRANGE = 25.0  # lambda that the best two effects of the library leave of one it cannot imitate
CONFIDENT, HARM, EXPLAINABLE = 0.8, -0.02, 0.1
FALSE_POSITIVES = 0.05
POWER = 0.9  # the size that is reported (`ocp.diagnose.engine.evidence`) is named nine times of ten
LEAST = 30  # worlds without which a curve is not fitted
SHOWN, DEALS = 20, 200  # worst answers; how often labels are dealt anew


@dataclass(frozen=True)
class Figure:
    """A line of the table: what, the target and its sense (">=", "<=", "in"), the estimate; percent: written as such; oracle: the
    same of one who knows all signatures and the noise, where that is something to know."""

    what: str
    target: tuple[float, ...]
    sense: str
    estimate: Estimate
    percent: bool = True
    oracle: Estimate = NOTHING

    @property
    def met(self) -> bool | None:
        """Whether the value reaches the target; None without worlds or without a target."""
        value = self.estimate.value
        if not self.estimate.count or not self.target or not np.isfinite(value):
            return None
        if self.sense == "in":
            return self.target[0] <= value <= self.target[1]
        return value >= self.target[0] if self.sense == ">=" else value <= self.target[0]


def of_kinds(rows: Iterable[Row], *kinds: str) -> list[Row]:
    """Worlds of these kinds; without any: all."""
    return [r for r in rows if not kinds or r["kind"] in kinds]


def hit(row: Row, key: str, method: str = "diagnosis") -> bool:
    """top1 or top3 of a method; an answer that failed is wrong."""
    part = row if method in ("diagnosis", "oracle", "strict") else row.get("rivals", {})
    return bool(part.get(method, {}).get(key, False))


def by_bin(rows: Sequence[Row], key: str, method: str = "diagnosis") -> list[Estimate]:
    """Shares of hits over single effects in every bin of the detectability."""
    singles = [(bin_of(r["lam"][0]), hit(r, key, method)) for r in of_kinds(rows, "single")]
    return [share_of_hits([right for at, right in singles if at == k]) for k in range(len(BINS))]


def all_figures(rows: Sequence[Row]) -> list[Figure]:
    """All figures."""
    return [*_names(rows), *_silence(rows), *_sets(rows), *_values(rows), *_unknown(rows), *_shrinkage(rows), *_rest(rows)]


TARGETS = {3: (0.97, None), 2: (0.95, None), 1: (0.85, 0.97), 0: (0.70, 0.85)}  # top-1 and top-3 by bin


def _names(rows: Sequence[Row]) -> list[Figure]:
    found = []
    first, three, best_first, best_three = (by_bin(rows, k, m) for m in ("diagnosis", "oracle") for k in ("top1", "top3"))
    for k, (one, other) in TARGETS.items():
        found.append(Figure(f"top-1 effect and joint, lambda {bin_words(k)}", (one,), ">=", first[k], oracle=best_first[k]))
        found.append(Figure(f"top-3, lambda {bin_words(k)}", (other,) if other else (), ">=", three[k], oracle=best_three[k]))
    singles = of_kinds(rows, "single")
    likeliest = share_of_hits([_likeliest(r) for r in singles])
    found.append(Figure("top-1, all single effects, ranked by probability alone", (), ">=", likeliest))
    heard = share_of_hits([hit(r, "top1") and r.get("verdict") != "no_gap" for r in singles if r["lam"][0] >= 30])
    found.append(Figure("named and not called 'no gap', lambda >= 30", (), ">=", heard))
    return found


def _likeliest(row: Row) -> bool:
    """Whether the name with the largest probability is right, whatever the order of the ranking."""
    return bool(max(row.get("reliability", ()), key=lambda pair: pair[0], default=(0.0, False))[1])


def _silence(rows: Sequence[Row]) -> list[Figure]:
    found = []
    for words, limit, kind in (("clean", 0.01, "none"), ("a machine as real ones", 0.02, "none_background")):
        worlds = of_kinds(rows, kind)
        alarms, best = [r.get("verdict") != "no_gap" for r in worlds], [r["oracle"]["set"][1] > 0 for r in worlds]
        what = f"false alarms, no effect, {words}"
        found.append(Figure(what, (limit,), "<=", share_of_hits(alarms), oracle=share_of_hits(best)))
    return found


def _sets(rows: Sequence[Row]) -> list[Figure]:
    def of(kind: str, method: str) -> Estimate:
        return f1([tuple(r[method]["set"]) if method in r else (0, 0, len(r["planted"])) for r in of_kinds(rows, kind)])

    return [
        Figure(f"{many} effects, each lambda >= 50, F1", (target,), ">=", of(kind, "diagnosis"), False, of(kind, "oracle"))
        for many, target, kind in (("two", 0.95, "pair"), ("three", 0.92, "triple"))
    ]


def _values(rows: Sequence[Row]) -> list[Figure]:
    strong, best, all_z = [], [], []
    for r in of_kinds(rows, "single"):
        value = r.get("values", [None])[0]
        if not hit(r, "top1", "strict") or value is None:
            continue
        error, z = value
        if r["lam"][0] >= BINS[-1][0] and error is not None:
            strong.append(error)
            best += [r["oracle_error"]] if r["oracle_error"] is not None else []
        all_z.append([abs(v) <= SURE for v in z])
    return [
        Figure("effect value, median error, lambda >= 100", (0.05,), "<=", median(strong), oracle=median(best)),
        Figure("effect value, coverage of the 90 % interval", (0.88, 0.92), "in", share_in_groups(all_z)),
    ]


def strange(row: Row) -> bool:
    """Whether the library lacks the planted effect and cannot imitate it."""
    return row["kind"] in BEYOND and row["left"] is not None and row["left"] >= STRANGE


def _unknown(rows: Sequence[Row]) -> list[Figure]:
    usual = of_kinds(rows, *USUAL)
    known = [r.get("p_unknown", 0.0) for r in usual]
    limit = float(np.quantile(known, 1 - FALSE_POSITIVES)) if known else 0.5
    odd = [r for r in rows if strange(r)]
    judged = [r for r in rows if r["kind"] not in BEYOND or strange(r)]
    seated = [r for r in of_kinds(rows, "single") if r["planted"][0][1] and r["lam"][0] >= 30]
    odd_seated = [r for r in odd if r["planted"][0][1]]
    at_limit = share_of_hits([r.get("p_unknown", 0.0) > limit or r.get("p_unknown", 0.0) > 0.5 >= limit for r in odd])
    named, best = (share_of_hits([_joint(r, method) for r in seated]) for method in ("diagnosis", "oracle"))
    odd_named = share_of_hits([r.get("location") == r["planted"][0][1] for r in odd_seated])
    return [
        Figure("none of these, effect the library cannot imitate", (0.90,), ">=", share_of_hits([_says_unknown(r) for r in odd])),
        Figure("the same at 5 % false positives", (0.90,), ">=", at_limit),
        Figure("none of these where the catalogue holds all", (0.05,), "<=", share_of_hits([_says_unknown(r) for r in usual])),
        Figure("confident wrong name (p > 0.8)", (0.05,), "<=", share_of_hits([_confident(r) for r in judged])),
        Figure("joint named right, lambda >= 30", (0.97,), ">=", named, oracle=best),
        Figure("joint named right, effect outside the library", (0.85,), ">=", odd_named),
    ]


def _says_unknown(row: Row) -> bool:
    return bool(row.get("p_unknown", 0.0) > 0.5)


def _confident(row: Row) -> bool:
    return any(p > CONFIDENT and not right for p, right in row.get("reliability", ()))


def _joint(row: Row, method: str = "diagnosis") -> bool:
    first = row.get(method, {}).get("first")
    return first is not None and (first[1] == row["planted"][0][1] or hit(row, "top1", method))


def explainable(row: Row) -> bool:
    """Whether there is a gap at the sealed conditions that knowing the effects would shrink."""
    at = row.get("realised")
    return bool(at and row["planted"] and 1 - at["floor"] / at["before"] > EXPLAINABLE)


def shrinkage(row: Row, by: str = "after") -> float:
    """Realised at the sealed conditions, by what is written or ("named") by all names."""
    return 1.0 - float(row["realised"][by]) / float(row["realised"]["before"])


def _shrinkage(rows: Sequence[Row]) -> list[Figure]:
    named = [r for r in rows if explainable(r) and "diagnosis" in r and r["diagnosis"]["set"][0] == len(r["planted"])]
    parts = [[shrinkage(r), 1 - r["realised"]["floor"] / r["realised"]["before"]] for r in named]
    corrected = [r for r in rows if r.get("realised")]
    said = [(r["shrinkage"], shrinkage(r, "named")) for r in rows if explainable(r) and r.get("shrinkage")]
    named_said = [(s, x) for s, x in said if s["predicted"] != 0.0]
    explained = bootstrap(parts, lambda t: np.median(t[..., 0] / t[..., 1], axis=1))
    off = median([abs(s["predicted"] - x) for s, x in named_said])
    inside = share_of_hits([s["low"] <= x <= s["high"] for s, x in named_said])
    covered = bootstrap([[r["realised"]["covered"]] for r in corrected], lambda t: t[..., 0].mean(axis=1))
    return [
        Figure("shrinkage at new conditions, named right, of what can be explained", (0.90,), ">=", explained),
        Figure("harmful corrections", (0.01,), "<=", share_of_hits([shrinkage(r) < HARM for r in corrected])),
        Figure("predicted against realised shrinkage, median difference", (0.05,), "<=", off, False),
        Figure("interval of the predicted shrinkage covers", (0.85, 0.95), "in", inside),
        Figure("90 % band of blind predictions covers", (), "in", covered),
    ]


def _rest(rows: Sequence[Row]) -> list[Figure]:
    (precision, recall), (best_precision, best_recall) = classes_judged(rows), classes_judged(rows, "oracle")
    singles = of_kinds(rows, "single")
    sizes = [pair for r in singles for pair in zip(r.get("smallest", ()), r.get("exact_smallest", ()), strict=False)]
    ratio, seconds = median([a / b for a, b in sizes if a and b]), median([r["seconds"]["cpu"] for r in rows if "seconds" in r])
    return [
        Figure("declared 'cannot tell apart', precision", (0.95,), ">=", precision, oracle=best_precision),
        Figure("declared 'cannot tell apart', recall", (0.95,), ">=", recall, oracle=best_recall),
        Figure("smallest size told, over that of a 5 % test with exact signatures", (), "in", ratio, False),
        Figure("smallest detectable size, found over predicted", (0.85, 1.15), "in", found_over_predicted(rows), False),
        Figure("seconds of processor a world (median), everything", (5.0,), "<=", seconds, False),
        Figure("answers that failed", (0.0,), "<=", share_of_hits([r["error"] is not None for r in rows])),
    ]


def classes_judged(rows: Sequence[Row], method: str = "diagnosis") -> tuple[Estimate, Estimate]:
    """Precision and recall of declared classes, over single effects that the diagnosis named right: a name is in the class or
    not, by exact signatures; pairs within a factor of the threshold count either way."""
    said, true = [], []
    for r in of_kinds(rows, "single"):
        if not hit(r, "top1") or r["lam"][0] < BINS[0][0]:
            continue
        own = tuple(r["planted"][0][:2])
        groups = r["classes"] if method == "diagnosis" else [[own, *(r["oracle_class"] or ())]]
        declared = {tuple(n) for g in groups for n in g if own in {tuple(m) for m in g}} - {own}
        sure, possible = ({tuple(n) for n in r[key]} - {own} for key in ("sure_class", "possible_class"))
        if declared:
            said.append([n in possible for n in declared])
        if sure:
            true.append([n in declared for n in sure])
    return share_in_groups(said), share_in_groups(true)


def found_over_predicted(rows: Sequence[dict[str, Any]]) -> Estimate:
    """Size at which nine of ten single effects are seen over the predicted one; seen: p_none below one half."""
    pairs = []
    for r in rows:
        told = r["kind"] == "single" and r.get("smallest") and r["smallest"][0] and r["exact_smallest"][0]
        if not told or not np.isfinite(r["smallest"][0]):  # inf: none of its size is seen
            continue
        effect, joint, values = r["planted"][0]
        size = share_of_range(Planted(effect, joint or None, values))
        pairs.append([np.log(size / r["smallest"][0]), float(r["p_none"] < 0.5)])
    return bootstrap(pairs, _at_power) if len(pairs) >= LEAST else NOTHING


def _at_power(tables: Array) -> Array:
    """Ratios (d,) at which logistic curves of log size reach the power; a weak prior holds their slope where all are seen.
    Fisher's scoring, steps halved until the fit is no worse (McCullagh, Nelder 1989, 2.5)."""
    x, hit = tables[..., 0], tables[..., 1]
    believed = np.array([0.0, 1.5])

    def levels(p: Array) -> Array:
        return np.asarray(np.exp(p[:, 1:]) * (x - p[:, :1]))

    def unlikely(p: Array) -> Array:
        level = levels(p)
        return np.asarray((np.logaddexp(0.0, level) - hit * level).sum(axis=1) + 0.5 * ((p - believed) ** 2).sum(axis=1))

    p = np.tile(believed, (len(tables), 1))
    now = unlikely(p)
    for _ in range(SCORINGS):
        level = levels(p)
        seen = expit(level)
        J = np.stack([np.broadcast_to(-np.exp(p[:, 1:]), level.shape), level], axis=2)
        slope = np.einsum("dni,dn->di", J, seen - hit) + p - believed
        curvature = np.einsum("dni,dn,dnj->dij", J, seen * (1 - seen), J) + np.eye(2)
        step, share = np.linalg.solve(curvature, slope[..., None])[..., 0], np.ones((len(p), 1))
        for _ in range(HALVINGS):
            there = unlikely(p - share * step)
            if (there <= now).all():
                break
            share = np.where((there > now)[:, None], 0.5 * share, share)
        gained = np.maximum(now - there, 0.0)
        p, now = np.where((there <= now)[:, None], p - share * step, p), np.minimum(there, now)
        if gained.max() < 1e-7:
            break
    return np.asarray(np.exp(p[:, 0] + np.log(POWER / (1 - POWER)) / np.exp(p[:, 1])))


def chance(rows: Sequence[Row], key: str = "top1", seed: int = 0) -> Estimate:
    """Share of hits when the labels of the single effects are dealt out anew among the same answers; the interval is that of the
    deals."""
    singles = [r for r in of_kinds(rows, "single") if "said" in r]
    if len(singles) < 2:
        return NOTHING
    rng, within = np.random.default_rng(seed), 3 if key == "top3" else 1
    labels = [(r["planted"][0][0], int(r["planted"][0][1])) for r in singles]
    names = [[(str(n), int(j)) for n, j, _ in r["said"]] for r in singles]
    groups = [[{(str(n), int(j)) for n, j in g} for g in r["classes"]] for r in singles]
    shares = []
    for _ in range(DEALS):
        dealt = rng.permutation(len(labels))
        hits = [first_right([labels[k]], n, g, within) for k, n, g in zip(dealt, names, groups, strict=True)]
        shares.append(np.mean(hits))
    low, high = np.quantile(shares, [0.025, 0.975])
    return Estimate(float(np.mean(shares)), float(low), float(high), len(singles))


def badness(row: Row) -> float:
    """How wrong an answer is: failures first, then false alarms and wrong names by how sure and how avoidable; 0: right."""
    if row["error"] is not None:
        return 1e6
    score, wrong = 0.0, max((p for p, right in row["reliability"] if not right), default=0.0)
    if row["kind"] in ("none", "none_background"):
        score += 500.0 * (row["verdict"] != "no_gap")
    elif strange(row):
        score += 0.0 if _says_unknown(row) else row["left"]
    elif row["kind"] == "single":
        score += 0.0 if hit(row, "top1") else row["lam"][0]
    elif row["kind"] not in BEYOND:
        found, said, planted = row["diagnosis"]["set"]
        score += 50.0 * (planted - found) + 50.0 * (said - found)
    if wrong > CONFIDENT and not (row["kind"] in BEYOND and not strange(row)):
        score += 300.0 * wrong
    if row.get("realised") and shrinkage(row) < HARM:
        score += 200.0 * min(-shrinkage(row), 5.0)
    return score


def worst(rows: Sequence[Row], count: int = SHOWN) -> list[Row]:
    """The worst answers, worst first; right ones are never among them."""
    return [r for r in sorted(rows, key=lambda r: -badness(r))[:count] if badness(r) > 0]


def planted_words(row: Row) -> str:
    """What was planted, with detectability."""
    if not row["planted"]:
        return "nothing"
    pairs = zip(row["planted"], row["lam"], strict=True)
    return ", ".join(f"{n}{f':{j}' if j else ''} ({lam:.0f})" for (n, j, _), lam in pairs)


def said_words(row: Row) -> str:
    """What was said."""
    if row["error"] is not None:
        return row["error"][:90]
    head = {"no_gap": "no gap", "unexplained": "none of these"}.get(row["verdict"], row["verdict"])
    names = ", ".join(f"{n}{f':{j}' if j else ''} {p:.2f}" for n, j, p in row["said"][:3])
    return f"{head} (none {row['p_none']:.2f}, unknown {row['p_unknown']:.2f}): {names}"


def why_words(row: Row) -> str:
    """Kind of the fault."""
    if row["error"] is not None:
        return "failed"
    parts = []
    if row["kind"] in ("none", "none_background") and row["verdict"] != "no_gap":
        parts.append("false alarm")
    if strange(row) and row["p_unknown"] <= 0.5:
        parts.append(f"not in the library, {row['left']:.0f} left")
    if row["kind"] == "single" and not hit(row, "top1"):
        parts.append("wrong name" + (", oracle too" if not hit(row, "top1", "oracle") else ""))
    if row["kind"] in ("pair", "triple") and row["diagnosis"]["set"] != [len(row["planted"])] * 3:
        found, said, planted = row["diagnosis"]["set"]
        parts.append(f"{found} of {planted} found, {said} named")
    if _confident(row):
        parts.append("sure of a wrong name")
    if row.get("realised") and shrinkage(row) < HARM:
        parts.append(f"corrected for the worse ({shrinkage(row):.2f})")
    return "; ".join(parts)
