"""The scorer: opens a world's label once all answers are written, and says what was right.

A row holds everything that the figures need, so that they can be made again without opening anything.
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.answers import answer_path
from ocp.blindtest.oracle import oracle
from ocp.blindtest.oracle.ceiling import classes_among, declared, estimated, size_error
from ocp.blindtest.oracle.detectability import nuisance, price, reading_covariance, whitener
from ocp.blindtest.oracle.signatures import families
from ocp.blindtest.scoring.force_scoring import ForceView
from ocp.blindtest.scoring.judging import Name, classes, first_right, matched, name_of, named, ranking, values
from ocp.blindtest.scoring.realised import Realised, realised
from ocp.blindtest.worlds.force_machines import draw_grinding
from ocp.blindtest.worlds.force_outside import KINDS as STRANGE
from ocp.blindtest.worlds.machines import Machine, background, draw_machine
from ocp.blindtest.worlds.outside_late import EVERY as OUTSIDE
from ocp.blindtest.worlds.recipes import Recipe
from ocp.blindtest.worlds.scene import Scene
from ocp.blindtest.worlds.sealing import WORLDS, Check, Label, read_label
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array

SCORES = "scores"
GROSS = 40.0  # squared white distance of three coordinates: a gross reading, which the oracle leaves out
UNSURE = 2.0  # factor about the threshold within which two effects are neither surely told apart nor surely not
_ORACLE = 7  # stream of the oracle's machine


def score_path(check: Check, name: str) -> Path:
    """Where the score of a world lies."""
    return check.folder / SCORES / f"{name}.json"


def make_score(check: Check, recipe: Recipe, seal: dict[str, str]) -> dict[str, Any]:
    """Score a world whose answer is newer than its score, or that has none."""
    path, answer = score_path(check, recipe.name), answer_path(check, recipe.name)
    if not path.is_file() or path.stat().st_mtime < answer.stat().st_mtime:
        label = read_label(check, recipe, seal)
        row = scored(check, label, json.loads(answer.read_text(encoding="utf-8")))
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text(json.dumps(row) + "\n", encoding="utf-8")
        part.replace(path)
    return dict(json.loads(path.read_text(encoding="utf-8")))


def scored(check: Check, label: Label, answer: dict[str, Any]) -> dict[str, Any]:
    """The row of a world."""
    row = {
        "world": label.recipe.name, "kind": label.recipe.kind, "background": background(label.recipe),
        "planted": [[*name_of(p), p.values] for p in label.effects], "lam": list(label.lam),
        "outside": [p.effect in OUTSIDE or p.effect in STRANGE or p.effect in label.withheld for p in label.effects],
        "error": answer["error"],
    }  # fmt: skip
    view = view_of(check, label)
    row |= _of_oracle(label, view.seen())
    if answer["error"] is None:
        groups = [set(map(tuple, group)) for group in row["true_classes"]]
        row |= _of_answer(label, answer, view.signal)
        row["rivals"] = {m: _judged(label, _names(r["ranking"]), _names(r["named"]), groups) for m, r in answer["rivals"].items()}
        row |= {name: asdict(found) for name, found in view.realised(answer).items()}
    return row


@dataclass(frozen=True, eq=False)
class TrackerView:
    """The scorer's side of a tracker world."""

    check: Check
    label: Label
    signal: str = "tracker"

    @cached_property
    def machine(self) -> Machine:
        """Drawn again."""
        check = self.check
        return draw_machine(check.cell, check.seed, self.label.recipe, check.readings, check.blind)

    def seen(self) -> oracle.Seen:
        """As the oracle sees it."""
        return _seen(self.check, self.machine, self.label)

    def realised(self, answer: dict[str, Any]) -> dict[str, Realised]:
        """Shrinkage at the sealed conditions."""
        told = answer["predictions"]
        return {} if told is None else {"realised": realised(self.check.cell, self.machine, self.label.effects, told)}


def view_of(check: Check, label: Label) -> "TrackerView | ForceView":
    """The scorer's side of a world."""
    if check.signals == "tracker":
        return TrackerView(check, label)
    machine = draw_grinding(check.cell, check.seed, label.recipe, check.readings, check.blind, check.signals == "both")
    folder = check.folder / WORLDS / label.recipe.name
    return ForceView(machine, folder, label.effects, label.withheld, (check.seed, label.recipe.index, _ORACLE))


def _of_answer(label: Label, answer: dict[str, Any], signal: str = "tracker") -> dict[str, Any]:
    """What the diagnosis said, and how right that is."""
    document = answer["document"]
    groups, planted = classes(document), [name_of(p) for p in label.effects]
    names = [name for name, _ in ranking(document)]
    gap = document["gap"][signal]
    row: dict[str, Any] = {
        "diagnosis": _judged(label, names, named(document), groups),
        "strict": _judged(label, names, named(document), []),
        "verdict": document["verdict"], "p_none": document["p_none"], "p_unknown": document["p_unknown"],
        "said": [[*n, p] for n, p in ranking(document)[:6]], "named": named(document),
        "classes": [sorted(g) for g in groups],
        "reliability": [[p, first_right(planted, [n], groups, 1)] for n, p in ranking(document)],
        "location": document["location"]["joint"], "subsystem": document["location"]["subsystem"],
        "shrinkage": gap["shrinkage"], "noise": gap["noise_floor"], "seconds": answer["seconds"], "because": answer["because"],
    }  # fmt: skip
    told = {(r["effect"], r["joint"] or 0): r["parameters"] for r in document["ranking"]}
    row["values"] = [values(p, told[name_of(p)]) if name_of(p) in told else None for p in label.effects]
    smallest = {(e, j): s for e, j, s, _ in answer["screened"]}
    row["smallest"] = [smallest.get(name_of(p)) for p in label.effects]
    return row


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


def _of_oracle(label: Label, seen: oracle.Seen) -> dict[str, Any]:
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
        found = estimated(library, seen.y, own)
        if found is not None:
            row |= {"oracle_error": size_error(found, first), "oracle_class": sorted(declared(library, found, own))}
    elif label.effects:
        groups = classes_among(library, label.effects, alone)
    names, said = oracle.ranked(library, seen.y), oracle.chosen(library, seen.y)
    return row | {
        "oracle": _judged(label, names, said, groups),
        "true_classes": [sorted(g) for g in groups],
        "exact_smallest": list(seen.smallest),
    }


def _seen(check: Check, machine: Machine, label: Label) -> oracle.Seen:
    """A tracker world as the oracle sees it."""
    scene = machine.scene()
    noise, kept = _noise(check, machine, scene, label)
    white = whitener(scene, kept)
    library = oracle.whitened(families(machine, scene), white).without(label.withheld)
    whole, bare = machine.points(label.effects), machine.points(())
    A, sd = nuisance(scene)
    drawn = np.random.default_rng((check.seed, label.recipe.index, _ORACLE)).normal(size=len(sd)) * sd
    y = white.apply(whole - bare + noise + A @ drawn)
    alone = tuple(white.apply(whole - machine.points([p for p in label.effects if p is not one])) for one in label.effects)
    return oracle.Seen(library, y, alone, tuple(_smallest(scene, p, s) for p, s in zip(label.effects, alone, strict=True)))


def _noise(check: Check, machine: Machine, scene: Scene, label: Label) -> tuple[Array, Array]:
    """What the readings of a world are off (n, 3) m, repeatability and instrument, and which (n,) are not grossly wrong."""
    with (check.folder / WORLDS / label.recipe.name / "tracker.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    read = 1e-3 * np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in rows])
    noise = read - machine.points(label.effects)
    squared = np.einsum("ni,ni->n", noise, np.linalg.solve(reading_covariance(scene), noise[..., None])[..., 0])
    kept = squared < GROSS
    return noise * kept[:, None], kept


def _smallest(scene: Scene, planted: Planted, white: Array) -> float | None:
    """Share of the usual upper end at which the effect would just be told from noise, its family's price paid."""
    if planted.effect in OUTSIDE or planted.effect in ("friction_windup", "tracker_drift", "gravity_compensator"):
        return None  # two sizes, one that means nothing without its levers, or none that anybody predicted
    upper = oracle.upper_end(planted)
    m = oracle.parameters_of(planted.effect)
    size = float(np.linalg.norm(planted.vector(next(iter(planted.values))))) / upper
    lam = float(white @ white)
    return size * float(np.sqrt((oracle.needed(m) + price(planted.effect, scene)) / lam)) if lam > 0 else None
