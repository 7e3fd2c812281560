"""Chance, and the worst cases: what was planted, what was said, how wrong that is."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ocp.blindtest.scoring.figures import CONFIDENT, HARM, answered, hit, shrinkage, strange
from ocp.blindtest.scoring.intervals import NOTHING, Estimate
from ocp.blindtest.scoring.judging import first_right
from ocp.blindtest.worlds.recipes import BEYOND

Row = dict[str, Any]
SHOWN = 20
DRAWS = 200


def chance(rows: Sequence[Row], key: str = "top1", seed: int = 0) -> Estimate:
    """Share of hits when the labels of the single effects are dealt out anew among the same answers; the interval is that of the
    deals."""
    singles = [r for r in answered(rows, "single") if "said" in r]
    if len(singles) < 2:
        return NOTHING
    rng, within = np.random.default_rng(seed), 3 if key == "top3" else 1
    labels = [(r["planted"][0][0], int(r["planted"][0][1])) for r in singles]
    names = [[(str(n), int(j)) for n, j, _ in r["said"]] for r in singles]
    groups = [[{(str(n), int(j)) for n, j in g} for g in r["classes"]] for r in singles]
    shares = []
    for _ in range(DRAWS):
        dealt = rng.permutation(len(labels))
        hits = [first_right([labels[k]], n, g, within) for k, n, g in zip(dealt, names, groups, strict=True)]
        shares.append(np.mean(hits))
    low, high = np.quantile(shares, [0.025, 0.975])
    return Estimate(float(np.mean(shares)), float(low), float(high), len(singles))


def badness(row: Row) -> float:
    """How wrong an answer is: failures first, then false alarms and wrong names by how sure and how avoidable; 0: right."""
    if row["error"] is not None:
        return 1e6
    score = 0.0
    wrong = max((p for p, right in row["reliability"] if not right), default=0.0)
    if row["kind"] in ("none", "none_background"):
        score += 500.0 * (row["verdict"] != "no_gap")
    elif strange(row):
        score += 0.0 if row["p_unknown"] > 0.5 else row["left"]
    elif row["kind"] not in BEYOND:
        found, said, planted = row["diagnosis"]["set"]
        if row["kind"] == "single":
            score += 0.0 if hit(row, "top1") else row["lam"][0]
        else:
            score += 50.0 * (planted - found) + 50.0 * (said - found)
    if wrong > CONFIDENT and not (row["kind"] in BEYOND and not strange(row)):
        score += 300.0 * wrong
    if row.get("realised") and shrinkage(row) < HARM:
        score += 200.0 * min(-shrinkage(row), 5.0)
    return score


def worst(rows: Sequence[Row], count: int = SHOWN) -> list[Row]:
    """The worst answers, worst first; right ones are never among them."""
    bad = [(badness(r), r) for r in rows]
    return [r for b, r in sorted(bad, key=lambda x: -x[0])[:count] if b > 0]


def planted_words(row: Row) -> str:
    """What was planted, with detectability."""
    if not row["planted"]:
        return "nothing"
    told = zip(row["planted"], row["lam"], strict=True)
    return ", ".join(f"{n}{f':{j}' if j else ''} ({lam:.0f})" for (n, j, _), lam in told)


def said_words(row: Row) -> str:
    """What was said."""
    if row["error"] is not None:
        return row["error"][:90]
    head = {"no_gap": "no gap", "unexplained": "none of these"}.get(row["verdict"], row["verdict"])
    names = ", ".join(f"{n}{f':{j}' if j else ''} {p:.2f}" for n, j, p in row["said"][:3])
    return f"{head} (none {row['p_none']:.2f}, unknown {row['p_unknown']:.2f}): {names}"


def why_words(row: Row) -> str:
    """Kind of the fault."""
    parts = []
    if row["error"] is not None:
        return "failed"
    if row["kind"] in ("none", "none_background") and row["verdict"] != "no_gap":
        parts.append("false alarm")
    if strange(row) and row["p_unknown"] <= 0.5:
        parts.append(f"not in the library, {row['left']:.0f} left")
    if row["kind"] == "single" and not hit(row, "top1"):
        parts.append("wrong name" + (", oracle too" if not hit(row, "top1", "oracle") else ""))
    if row["kind"] in ("pair", "triple") and row["diagnosis"]["set"] != [len(row["planted"])] * 3:
        found, said, planted = row["diagnosis"]["set"]
        parts.append(f"{found} of {planted} found, {said} named")
    if any(p > CONFIDENT and not right for p, right in row["reliability"]):
        parts.append("sure of a wrong name")
    if row.get("realised") and shrinkage(row) < HARM:
        parts.append(f"corrected for the worse ({shrinkage(row):.2f})")
    return "; ".join(parts) + ("; background" if row["background"] else "")
