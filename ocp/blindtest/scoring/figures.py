"""The table of DIAGNOSIS.md, "How it is judged", from the rows of scored worlds: each figure with its interval and its worlds."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ocp.blindtest.scoring.intervals import NOTHING, Estimate, bootstrap, f1, median, pooled, share
from ocp.blindtest.scoring.judging import SURE
from ocp.blindtest.scoring.rivals import METHODS
from ocp.blindtest.scoring.smallest import found_over_predicted
from ocp.blindtest.worlds.recipes import BEYOND, BINS, bin_of, bin_words

Row = dict[str, Any]
OTHERS = ("oracle", *METHODS)
STRANGE = 25.0  # lambda that the best two effects of the library leave of one it cannot imitate
CONFIDENT, HARM, EXPLAINABLE = 0.8, -0.02, 0.1
FALSE_POSITIVES = 0.05


@dataclass(frozen=True)
class Figure:
    """A line of the table: what, the target and its sense (">=", "<=", "in"), the estimate; percent: told as such; oracle: the
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


def answered(rows: Iterable[Row], *kinds: str) -> list[Row]:
    """Worlds of these kinds; without any: all."""
    return [r for r in rows if not kinds or r["kind"] in kinds]


def hit(row: Row, key: str, method: str = "diagnosis") -> bool:
    """top1 or top3 of a method; an answer that failed is wrong."""
    part = row if method in ("diagnosis", "oracle", "strict") else row.get("rivals", {})
    return bool(part.get(method, {}).get(key, False))


def by_bin(rows: Sequence[Row], key: str, method: str = "diagnosis") -> list[Estimate]:
    """Shares of hits over single effects in every bin of the detectability."""
    found: list[list[bool]] = [[] for _ in BINS]
    for r in answered(rows, "single"):
        k = bin_of(r["lam"][0])
        if k is not None:
            found[k].append(hit(r, key, method))
    return [share(hits) for hits in found]


def table(rows: Sequence[Row]) -> list[Figure]:
    """All figures."""
    return [*_names(rows), *_silence(rows), *_sets(rows), *_values(rows), *_unknown(rows), *_shrinkage(rows), *_rest(rows)]


TARGETS = {3: (0.97, None), 2: (0.95, None), 1: (0.85, 0.97), 0: (0.70, 0.85)}  # top-1 and top-3 by bin


def _names(rows: Sequence[Row]) -> list[Figure]:
    found = []
    first, three, best_first, best_three = (by_bin(rows, k, m) for m in ("diagnosis", "oracle") for k in ("top1", "top3"))
    for k in sorted(TARGETS, reverse=True):
        one, other = TARGETS[k]
        found.append(Figure(f"top-1 effect and joint, lambda {bin_words(k)}", (one,), ">=", first[k], oracle=best_first[k]))
        found.append(Figure(f"top-3, lambda {bin_words(k)}", (other,) if other else (), ">=", three[k], oracle=best_three[k]))
    singles = answered(rows, "single")
    for words, there in (("noise alone", False), ("outliers, ripple and play", True)):
        hits = share([hit(r, "top1") for r in singles if r["background"] == there])
        found.append(Figure(f"top-1, all single effects, machines with {words}", (), ">=", hits))
    likeliest = share([_likeliest(r) for r in singles])
    found.append(Figure("top-1, all single effects, ranked by probability alone", (), ">=", likeliest))
    told = share([hit(r, "top1") and r.get("verdict") != "no_gap" for r in singles if r["lam"][0] >= 30])
    found.append(Figure("named and not called 'no gap', lambda >= 30", (), ">=", told))
    return found


def _likeliest(row: Row) -> bool:
    """Whether the name with the largest told probability is right, whatever the order of the ranking."""
    return bool(max(row.get("reliability", ()), key=lambda pair: pair[0], default=(0.0, False))[1])


def _silence(rows: Sequence[Row]) -> list[Figure]:
    def alarms(kind: str) -> Estimate:
        return share([r.get("verdict") != "no_gap" for r in answered(rows, kind)])

    def best(kind: str) -> Estimate:
        return share([r["oracle"]["set"][1] > 0 for r in answered(rows, kind)])

    return [
        Figure(f"false alarms, no effect, {words}", (limit,), "<=", alarms(kind), oracle=best(kind))
        for words, limit, kind in (("clean", 0.01, "none"), ("outliers and background", 0.02, "none_background"))
    ]


def _sets(rows: Sequence[Row]) -> list[Figure]:
    def of(kind: str, method: str) -> Estimate:
        return f1([tuple(r[method]["set"]) if method in r else (0, 0, len(r["planted"])) for r in answered(rows, kind)])

    return [
        Figure(f"{many} effects, each lambda >= 50, F1", (target,), ">=", of(kind, "diagnosis"), False, of(kind, "oracle"))
        for many, target, kind in (("two", 0.95, "pair"), ("three", 0.92, "triple"))
    ]


def _values(rows: Sequence[Row]) -> list[Figure]:
    strong, best, all_z = [], [], []
    for r in answered(rows, "single"):
        told = r.get("values", [None])[0]
        if not hit(r, "top1", "strict") or told is None:
            continue
        error, z = told
        if r["lam"][0] >= BINS[-1][0] and error is not None:
            strong.append(error)
            best += [r["oracle_error"]] if r["oracle_error"] is not None else []
        all_z.append([abs(v) <= SURE for v in z])
    return [
        Figure("effect value, median error, lambda >= 100", (0.05,), "<=", median(strong), oracle=median(best)),
        Figure("effect value, coverage of the 90 % interval", (0.88, 0.92), "in", pooled(all_z)),
    ]


def strange(row: Row) -> bool:
    """Whether the library lacks the planted effect and cannot imitate it."""
    return row["kind"] in BEYOND and row["left"] is not None and row["left"] >= STRANGE


def _unknown(rows: Sequence[Row]) -> list[Figure]:
    known = [r.get("p_unknown", 0.0) for r in answered(rows, "single", "pair", "triple", "none", "none_background")]
    limit = float(np.quantile(known, 1 - FALSE_POSITIVES)) if known else 0.5
    odd = [r for r in rows if strange(r)]
    usual = answered(rows, "single", "pair", "triple", "none", "none_background")
    judged = [r for r in rows if r["kind"] not in BEYOND or strange(r)]
    seated = [r for r in answered(rows, "single") if r["planted"][0][1] and r["lam"][0] >= 30]
    odd_seated = [r for r in odd if r["planted"][0][1]]
    return [
        Figure("none of these, effect the library cannot imitate", (0.90,), ">=", share([_says_unknown(r) for r in odd])),
        Figure("the same at 5 % false positives", (0.90,), ">=",
               share([r.get("p_unknown", 0.0) > limit or r.get("p_unknown", 0.0) > 0.5 >= limit for r in odd])),
        Figure("none of these where the catalogue holds all", (0.05,), "<=", share([_says_unknown(r) for r in usual])),
        Figure("confident wrong name (p > 0.8)", (0.05,), "<=", share([_confident(r) for r in judged])),
        Figure("joint named right, lambda >= 30", (0.97,), ">=", share([_joint(r) for r in seated]),
               oracle=share([_joint(r, "oracle") for r in seated])),
        Figure("joint named right, effect outside the library", (0.85,), ">=",
               share([r.get("location") == r["planted"][0][1] for r in odd_seated])),
    ]  # fmt: skip


def _says_unknown(row: Row) -> bool:
    return bool(row.get("p_unknown", 0.0) > 0.5)


def _confident(row: Row) -> bool:
    return any(p > CONFIDENT and not right for p, right in row.get("reliability", ()))


def _joint(row: Row, method: str = "diagnosis") -> bool:
    first = row.get(method, {}).get("first")
    return first is not None and (first[1] == row["planted"][0][1] or hit(row, "top1", method))


def seen(row: Row) -> bool:
    """Whether there is a gap at the sealed conditions that knowing the effects would shrink."""
    at = row.get("realised")
    return bool(at and row["planted"] and 1 - at["floor"] / at["before"] > EXPLAINABLE)


def shrinkage(row: Row) -> float:
    """Realised at the sealed conditions."""
    return 1.0 - float(row["realised"]["after"]) / float(row["realised"]["before"])


def _shrinkage(rows: Sequence[Row]) -> list[Figure]:
    named = [r for r in rows if seen(r) and "diagnosis" in r and r["diagnosis"]["set"][0] == len(r["planted"])]
    parts = [[shrinkage(r), 1 - r["realised"]["floor"] / r["realised"]["before"]] for r in named]
    corrected = [r for r in rows if r.get("realised")]
    said = [(r["shrinkage"], shrinkage(r)) for r in rows if seen(r) and r.get("shrinkage")]
    named_said = [(s, x) for s, x in said if s["predicted"] != 0.0]
    return [
        Figure("shrinkage at new conditions, named right, of what can be explained", (0.90,), ">=",
               bootstrap(parts, lambda t: float(np.median(t[:, 0] / t[:, 1])))),
        Figure("harmful corrections", (0.01,), "<=", share([shrinkage(r) < HARM for r in corrected])),
        Figure("predicted against realised shrinkage, median difference", (0.05,), "<=",
               median([abs(s["predicted"] - x) for s, x in named_said]), False),
        Figure("interval of the predicted shrinkage covers", (0.85, 0.95), "in",
               share([s["low"] <= x <= s["high"] for s, x in named_said])),
        Figure("90 % band of blind predictions covers", (), "in",
               bootstrap([[r["realised"]["covered"]] for r in corrected], lambda t: float(t.mean()))),
    ]  # fmt: skip


def _rest(rows: Sequence[Row]) -> list[Figure]:
    (precision, recall), (best_precision, best_recall) = told_apart(rows), told_apart(rows, "oracle")
    ratio = [
        [a / b] for r in answered(rows, "single")
        for a, b in zip(r.get("smallest", ()), r.get("exact_smallest", ()), strict=False) if a and b
    ]  # fmt: skip
    seconds: list[list[float]] = [[r["seconds"]["cpu"], r["seconds"]["wall"]] for r in rows if "seconds" in r]
    middle: Callable[[Any], float] = lambda t: float(np.median(t[:, 0]))  # noqa: E731
    return [
        Figure("declared 'cannot tell apart', precision", (0.95,), ">=", precision, oracle=best_precision),
        Figure("declared 'cannot tell apart', recall", (0.95,), ">=", recall, oracle=best_recall),
        Figure("smallest size told, over that of a 5 % test with exact signatures", (), "in", bootstrap(ratio, middle), False),
        Figure("smallest detectable size, found over predicted", (0.85, 1.15), "in", found_over_predicted(rows), False),
        Figure("seconds of processor a world (median), everything", (5.0,), "<=", bootstrap(seconds, middle), False),
        Figure("answers that failed", (0.0,), "<=", share([r["error"] is not None for r in rows])),
    ]


def told_apart(rows: Sequence[Row], method: str = "diagnosis") -> tuple[Estimate, Estimate]:
    """Precision and recall of declared classes, over single effects that the diagnosis named right: a name is in the class or
    not, by exact signatures; pairs within a factor of the threshold count either way."""
    said, true = [], []
    for r in answered(rows, "single"):
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
    return pooled(said), pooled(true)


__all__ = ["NOTHING", "Figure", "answered", "by_bin", "hit", "seen", "shrinkage", "strange", "table"]
