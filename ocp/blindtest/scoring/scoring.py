"""The scorer: opens a world's label once all answers are written, and says what was right.

A row holds everything that the figures need, so that they can be made again without opening anything.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.oracle import oracle
from ocp.blindtest.oracle.oracle import Name, name_of
from ocp.blindtest.scoring.judging import (
    decided_names,
    declared_classes,
    first_right,
    matched,
    names_by_probability,
    value_errors,
)
from ocp.blindtest.scoring.realised import counted_signal, realised_shrinkage
from ocp.blindtest.worlds.machines import has_background
from ocp.blindtest.worlds.pools import OUTSIDE
from ocp.blindtest.worlds.recipes import Recipe
from ocp.blindtest.worlds.sealing import Check, Label, machine_of, read_label, write_whole

SCORES = "scores"
UNSURE = 2.0  # factor about the threshold within which two effects are neither surely told apart nor surely not
_ORACLE = 7  # stream of the oracle's machine


def score_path(check: Check, name: str) -> Path:
    """Where the score of a world lies."""
    return check.folder / SCORES / f"{name}.json"


def make_score(check: Check, recipe: Recipe, seal: dict[str, str]) -> dict[str, Any]:
    """Score a world whose answer is newer than its score, or that has none."""
    path, answer = score_path(check, recipe.name), check.answer(recipe.name)
    if not path.is_file() or path.stat().st_mtime < answer.stat().st_mtime:
        label = read_label(check, recipe, seal)
        row = scored(check, label, json.loads(answer.read_text(encoding="utf-8")))
        write_whole(path, json.dumps(row) + "\n")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def scored(check: Check, label: Label, answer: dict[str, Any]) -> dict[str, Any]:
    """The row of a world."""
    recipe, effects = label.recipe, label.effects
    row = {
        "world": recipe.name,
        "kind": recipe.kind,
        "background": has_background(recipe),
        "planted": [[*name_of(p), p.values] for p in effects],
        "lam": list(label.lam),
        "outside": [p.effect in OUTSIDE or p.effect in label.withheld for p in effects],
        "error": answer["error"],
    }
    machine, rng = machine_of(check, recipe), np.random.default_rng((check.seed, recipe.index, _ORACLE))
    row |= _of_oracle(label, oracle.observed(machine, check.world(recipe.name), effects, label.withheld, rng))
    if answer["error"] is None:
        groups = [set(map(tuple, group)) for group in row["true_classes"]]
        row |= _of_answer(label, answer, counted_signal(machine, effects))
        row["rivals"] = {m: _judged(label, _names(r["ranking"]), _names(r["named"]), groups) for m, r in answer["rivals"].items()}
        row |= {name: asdict(found) for name, found in realised_shrinkage(machine, effects, answer).items()}
    return row


def _of_answer(label: Label, answer: dict[str, Any], signal: str) -> dict[str, Any]:
    """What the diagnosis said, and how right that is."""
    document = answer["document"]
    groups, planted = declared_classes(document), [name_of(p) for p in label.effects]
    said, named, gap = names_by_probability(document), decided_names(document), document["gap"][signal]
    names = [name for name, _ in said]
    parameters = {(r["effect"], r["joint"] or 0): r["parameters"] for r in document["ranking"]}
    smallest = {(e, j): size for e, j, size, _ in answer["screened"]}
    return {
        "diagnosis": _judged(label, names, named, groups),
        "strict": _judged(label, names, named, []),
        "verdict": document["verdict"],
        "p_none": document["p_none"],
        "p_unknown": document["p_unknown"],
        "said": [[*n, p] for n, p in said[:6]],
        "named": named,
        "classes": [sorted(g) for g in groups],
        "reliability": [[p, first_right(planted, [n], groups, 1)] for n, p in said],
        "location": document["location"]["joint"],
        "subsystem": document["location"]["subsystem"],
        "shrinkage": gap["shrinkage"],
        "noise": gap["noise_floor"],
        "seconds": answer["seconds"],
        "because": answer["because"],
        "values": [value_errors(p, parameters[name_of(p)]) if name_of(p) in parameters else None for p in label.effects],
        "smallest": [smallest.get(name_of(p)) for p in label.effects],
    }


def _judged(label: Label, names: Sequence[Name], said: Sequence[Name], groups: Sequence[set[Name]]) -> dict[str, Any]:
    """First and first three names, the joint of the first, and counts of the set: found, named, planted."""
    planted = [name_of(p) for p in label.effects]
    return {
        "top1": first_right(planted, names, groups, 1),
        "top3": first_right(planted, names, groups, 3),
        "first": list(names[0]) if names else None,
        "set": [matched(planted, said, groups), len(said), len(planted)],
    }


def _names(rows: Sequence[Sequence[Any]]) -> list[Name]:
    return [(str(effect), int(joint)) for effect, joint in rows]


def _of_oracle(label: Label, seen: oracle.Observed) -> dict[str, Any]:
    """What one who knows all signatures and the true covariance says of the same noise; what these data cannot tell from the
    planted effect, what the library leaves of it, and the smallest size that would be seen."""
    library, alone = seen.library, seen.alone
    first = label.effects[0] if len(label.effects) == 1 else None
    row: dict[str, Any] = {"sure_class": [], "possible_class": [], "left": None, "oracle_error": None, "oracle_class": None}
    groups: list[set[Name]] = []
    if first is not None:
        own = name_of(first)
        twins, sure, possible = (oracle.not_told_apart(library, alone[0], own, f) for f in (1.0, 1 / UNSURE, UNSURE))
        groups = [twins | {own}] if twins else []
        row |= {"sure_class": sorted(sure), "possible_class": sorted(possible)}
        row["left"] = oracle.cannot_be_imitated(library, alone[0])
        found = oracle.estimated(library, seen.y, own)
        if found is not None:
            row["oracle_error"] = oracle.size_error(found, first)
            row["oracle_class"] = sorted(oracle.not_told_apart(library, found.signature, own))
    elif label.effects:
        groups = oracle.classes_among(library, label.effects, alone)
    names, said = oracle.ranked(library, seen.y), oracle.chosen(library, seen.y)
    return row | {
        "oracle": _judged(label, names, said, groups),
        "true_classes": [sorted(g) for g in groups],
        "exact_smallest": list(seen.smallest),
    }
