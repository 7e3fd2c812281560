"""The scorer: opens a world's label once all answers are written, and says what was right: names within declared classes, sets,
values, and how far the gap shrank at conditions that nobody had measured, against what could have been reached.

A row holds everything that the figures need, so that they can be made again without opening anything.

The truth is free of noise, as in the sealed truths of FORMATS' worlds: noise^2 = 0 in G^2 = max(0, mean square - noise^2) and G
is the rms itself. Repeatability is noise; ripple and play, the same whenever an axis comes back, are not, nor are the small drift
and wear of a background, which go on.
"""

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.oracle import oracle
from ocp.blindtest.oracle.oracle import Name, name_of
from ocp.blindtest.worlds.machines import BlindMachine, GrindingMachine, TrackerMachine
from ocp.blindtest.worlds.recipes import OUTSIDE, Recipe, of_arm
from ocp.blindtest.worlds.sealing import Check, Label, machine_of, read_label, read_seal, write_world
from ocp.diagnose.answering import channels_of
from ocp.diagnose.dataset import read_data_set, read_sealed
from ocp.shell.progress import Phases
from ocp.simulate.twin.planting import Planted
from robots.pose import Array

SURE = 1.6449  # standard deviations of a 90 % interval
KAB = ("stiffness_N_m", "lever_link1_m", "lever_arm_m")  # readings hold the product of a balancer's spring and levers


def declared_classes(document: dict[str, Any]) -> list[set[Name]]:
    """Declared classes of names that cannot be told apart, `gear_1x:3` or `payload_mass`."""
    split = [[text.partition(":") for text in group] for group in document["indistinguishable"]]
    return [{(effect, int(joint or 0)) for effect, _, joint in group} for group in split]


def alike(a: Name, b: Name, groups: Sequence[set[Name]]) -> bool:
    """Whether a name stands for another: the same, or of one class."""
    return a == b or any(a in g and b in g for g in groups)


def decided_names(document: dict[str, Any]) -> list[Name]:
    """What the answer decides for: the effects of its best explanation, none where having no effect is more probable."""
    best = max(document["explanations"], key=lambda e: e["probability"], default=None)
    if best is None or document["p_none"] >= best["probability"]:
        return []
    return [(e["effect"], e["joint"] or 0) for e in best["effects"]]


def matched(planted: Sequence[Name], said: Sequence[Name], groups: Sequence[set[Name]]) -> int:
    """How many of the planted are named, each name used once: the same ones first, then those of one class."""
    left, count, missing = list(said), 0, []
    for one in planted:
        if one in left:
            left.remove(one)
            count += 1
        else:
            missing.append(one)
    for one in missing:
        twin = next((s for s in left if alike(one, s, groups)), None)
        if twin is not None:
            left.remove(twin)
            count += 1
    return count


def first_right(planted: Sequence[Name], names: Sequence[Name], groups: Sequence[set[Name]], within: int) -> bool:
    """Whether one of the first `within` names is one of the planted."""
    return any(alike(p, s, groups) for p in planted for s in names[:within])


def value_errors(planted: Planted, parameters: dict[str, Any]) -> tuple[float | None, list[float]]:
    """Relative error of the size (None where the answer has no such key), and deviations in standard errors of everything that
    has one."""
    error, z = None, []
    for k, (key, true) in enumerate(planted.values.items()):
        given = parameters.get(key)
        if given is None or isinstance(true, str):
            continue
        # Mean and standard deviation; of a balancer's product with its levers.
        factor = _levers(key, {k: p["value"] for k, p in parameters.items()})
        mean = np.atleast_1d(np.asarray(given["value"], float) * factor)
        sd = None if given["sd"] is None else np.atleast_1d(np.asarray(given["sd"], float) * factor)
        real = np.atleast_1d(np.asarray(true, float)) * _levers(key, planted.values)
        off = mean - real
        if key == "phase_rad":
            off = (off + np.pi) % (2 * np.pi) - np.pi
        if k == 0:
            error = float(np.linalg.norm(off) / np.linalg.norm(real))
        if sd is not None and np.all(sd > 0):
            z += [float(v) for v in off / sd]
    return error, z


def with_small(planted: Planted, small: Sequence[Planted]) -> Planted:
    """The planted values plus the background's own of the same effect, which is what was measured."""
    added = {one.effect: {key: one.number(key) for key in one.values} for one in small}.get(planted.effect, {})
    return replace(planted, values=planted.values | {key: planted.number(key) + more for key, more in added.items()})


def _levers(key: str, known: dict[str, Any]) -> float:
    if key != KAB[0] or not all(k in known for k in KAB):
        return 1.0
    return float(known[KAB[1]]) * float(known[KAB[2]])


def counted_signal(machine: BlindMachine, effects: tuple[Planted, ...]) -> str:
    """The signal whose shrinkage counts: the tracker's where it sees everything that was planted, else the force."""
    if isinstance(machine, TrackerMachine):
        return "tracker"
    return "tracker" if machine.arm is not None and effects and of_arm(effects) == effects else "force"


def realised_shrinkage(machine: BlindMachine, effects: tuple[Planted, ...], answer: dict[str, Any]) -> dict[str, Any]:
    """Blind predictions of the sealed conditions judged, by signal: under "realised" the one that counts."""
    found = {}
    arm, on_arm = (machine, effects) if isinstance(machine, TrackerMachine) else (machine.arm, of_arm(effects))
    if isinstance(machine, GrindingMachine):
        if answer.get("predictions_force") is not None:
            truth = machine.log((*effects, *machine.small), sealed=True).fn[:, None]
            found["force"] = _realised(answer["predictions_force"], truth, lambda: _floor(machine) if effects else None)
    if arm is not None and answer["predictions"] is not None:
        truth = arm.points(on_arm, sealed=True)
        found["tracker"] = _realised(answer["predictions"], truth, lambda: _floor(arm) if on_arm else None)
    counted = counted_signal(machine, effects)
    return {"realised" if signal == counted else f"realised_{signal}": one for signal, one in found.items()}


def _realised(predictions: dict[str, Any], truth: Array, floor: Callable[[], float | None]) -> dict[str, float]:
    """Rms errors (m of points, N of forces) of predictions at the sealed conditions, of which `truth` (n, k) are the readings
    without noise: before (the believed cell), after (the corrected one), named (all names, whether the corrected cell holds
    them or not: theirs is the promise), floor: what is left where nothing was planted on the same machine (None: nothing was);
    covered: share of values within 1.645 predicted standard deviations."""
    baseline, corrected, named, sigma = (
        np.asarray(predictions[k]).reshape(len(truth), -1)[:, : truth.shape[1]]
        for k in ("baseline", "corrected", "named", "sigma")
    )
    before, left = rms(baseline - truth), floor()
    within = np.abs(corrected - truth) <= 1.6449 * np.maximum(sigma, 1e-9)
    least = before if left is None else left
    after, by_names = rms(corrected - truth), rms(named - truth)
    return {"before": before, "after": after, "named": by_names, "floor": least, "covered": float(within.mean())}


def _floor(machine: BlindMachine) -> float:
    """Rms error, m of points or N of a log, of the believed cell, refitted to what the machine without effects would have
    measured, noise and all."""
    if isinstance(machine, TrackerMachine):
        signal, truth = "tracker", machine.points((), sealed=True)
    else:
        signal, truth = "force", machine.log(machine.small, sealed=True).fn[:, None]
    with tempfile.TemporaryDirectory() as folder:
        write_world(Path(folder), machine, ())
        data = read_data_set(folder)
        channel = next(c for c in channels_of(data, Phases()) if c.name == signal)
        predicted = channel.predict(read_sealed(data, signal), ())
    return rms(predicted.baseline - truth)


def rms(off: Array) -> float:
    """Of errors (n, k), k coordinates each."""
    return float(np.sqrt((off**2).sum(axis=1).mean()))


SCORES = "scores"
UNSURE = 2.0  # factor about the threshold within which two effects are neither surely told apart nor surely not
_ORACLE = 7  # stream of the oracle's machine


def score_path(check: Check, name: str) -> Path:
    """Where the score of a world lies."""
    return check.folder / SCORES / f"{name}.json"


def make_score(check: Check, recipe: Recipe) -> None:
    """Score a world that is answered. Raises BadInput: its label is not the sealed one."""
    label = read_label(check, recipe, read_seal(check))
    row = scored(check, label, json.loads(check.answer(recipe.name).read_text(encoding="utf-8")))
    path = score_path(check, recipe.name)
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(row) + "\n", encoding="utf-8")


def scored(check: Check, label: Label, answer: dict[str, Any]) -> dict[str, Any]:
    """The row of a world."""
    recipe, effects = label.recipe, label.effects
    row = {
        "world": recipe.name,
        "kind": recipe.kind,
        "planted": [[*name_of(p), p.values] for p in effects],
        "lam": list(label.lam),
        "outside": [p.effect in OUTSIDE or p.effect in label.withheld for p in effects],
        "error": answer["error"],
    }
    machine, rng = machine_of(check, recipe), np.random.default_rng((check.seed, recipe.index, _ORACLE))
    row |= _of_oracle(label, oracle.observed(machine, effects, label.withheld, rng))
    if isinstance(machine, GrindingMachine):  # the oracle's readings hold no background of their own
        label = replace(label, effects=tuple(with_small(p, machine.small) for p in effects))
    if answer["error"] is None:
        groups = [set(map(tuple, group)) for group in row["true_classes"]]
        row |= _of_answer(label, answer, counted_signal(machine, effects))
        row["rivals"] = {m: _judged(label, _names(r["ranking"]), _names(r["named"]), groups) for m, r in answer["rivals"].items()}
        row |= realised_shrinkage(machine, effects, answer)
    return row


def _of_answer(label: Label, answer: dict[str, Any], signal: str) -> dict[str, Any]:
    """What the diagnosis said, and how right that is."""
    document = answer["document"]
    groups, planted = declared_classes(document), [name_of(p) for p in label.effects]
    named, gap = decided_names(document), document["gap"][signal]
    said = [((r["effect"], r["joint"] or 0), float(r["probability"])) for r in document["ranking"]]  # most probable first
    names = [name for name, _ in said]
    parameters = {(r["effect"], r["joint"] or 0): r["parameters"] for r in document["ranking"]}
    smallest = {(e, j): size for e, j, size, _ in answer["screened"]}
    return {
        "diagnosis": _judged(label, names, named, groups),
        "strict": _judged(label, names, named, []),
        **{key: document[key] for key in ("verdict", "p_none", "p_unknown")},
        "said": [[*n, p] for n, p in said[:6]],
        "named": named,
        "classes": [sorted(g) for g in groups],
        "reliability": [[p, first_right(planted, [n], groups, 1)] for n, p in said],
        "location": document["location"]["joint"],
        "subsystem": document["location"]["subsystem"],
        "shrinkage": gap["shrinkage"],
        "noise": gap["noise_floor"],
        **{key: answer[key] for key in ("seconds", "because")},
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
    library, y, alone, smallest = seen
    first = label.effects[0] if len(label.effects) == 1 else None
    row: dict[str, Any] = {"sure_class": [], "possible_class": [], "left": None, "oracle_error": None, "oracle_class": None}
    groups: list[set[Name]] = []
    if first is not None:
        own = name_of(first)
        twins, sure, possible = (oracle.not_told_apart(library, alone[0], own, f) for f in (1.0, 1 / UNSURE, UNSURE))
        groups = [twins | {own}] if twins else []
        row |= {"sure_class": sorted(sure), "possible_class": sorted(possible)}
        row["left"] = oracle.cannot_be_imitated(library, alone[0])
        found = oracle.estimated(library, y, own)
        if found is not None:
            row["oracle_error"] = oracle.size_error(found[0], first)
            row["oracle_class"] = sorted(oracle.not_told_apart(library, found[1], own))
    elif label.effects:
        groups = oracle.classes_among(library, label.effects, alone)
    judged = _judged(label, oracle.ranked(library, y), oracle.chosen(library, y), groups)
    return row | {"oracle": judged, "true_classes": [sorted(g) for g in groups], "exact_smallest": list(smallest)}
