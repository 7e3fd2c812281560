"""Diagnosis of machines by another hand: names, false names, promises and what came, before and after a change of the engine.

    PYTHONPATH=. python benchmarks/other_hand.py OUT [--worlds 80] [--seed 1] [--rows NAME] [--before OUT/NAME.json]

Answered are the labelled tracker worlds of ../shared/data/worlds and fresh worlds of a seed (1 to 99: for development). A fresh
machine has what DIAGNOSIS.md ("Second method") and FORMATS.md say of other hands and the catalogue of a maker does not: masses of
links off by 4 %, their centres by 1 cm, payloads by 1 %, springs by 20 %, every gear's ripple of three to five orders (10 to 30
urad together) and up to 10 urad of play, readings whose noise has Student's tails (4 degrees of freedom) beside 1 % gross ones.
Of every third machine the last third of the readings, and all sealed ones, come from a second stand of the tracker.
Worlds stay in OUT and are drawn once; a row for each answer is written to OUT/NAME.json. `--before`: the same figures of an
earlier run beside, with the 95 % interval of the difference over the same worlds (bootstrap).
"""

import argparse
import csv
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ocp.blindtest.answers import FAULTS
from ocp.blindtest.interface import draw_effects
from ocp.blindtest.oracle.tracker import TrackerView, exact_whitener, scene_of, tracker_nuisance, tracker_root, white_points
from ocp.blindtest.scoring import decided_names, declared_classes, first_right, matched
from ocp.blindtest.worlds.machines import PAYLOAD_MASS, TrackerMachine, arm_with_outside
from ocp.blindtest.worlds.recipes import BINS, SEVERAL, STRANGE, Recipe
from ocp.blindtest.worlds.sealing import write_cell
from ocp.data import CELL
from ocp.diagnose.answering import answer_of, predict_sealed, tracker_channel
from ocp.diagnose.dataset import read_sealed
from ocp.diagnose.document import document_of
from ocp.diagnose.engine.channel_system import Sealed
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.answer import Answer
from ocp.effects.catalogue import library
from ocp.model.cell import read_cell
from ocp.shell.progress import Phases
from ocp.simulate.twin.planting import Planted, labels
from ocp.simulate.twin.tracker import TrackerLog, instrument, random_design, sealed_design, tracker_world, true_points
from ocp.simulate.twin.truth import Truth, draw_truth
from robots.errors import BadInput, Infeasible
from robots.pose import Array, apply, invert

SHARED = Path(__file__).parents[1].parent / "shared" / "data" / "worlds"
MASS, CENTRE, PAYLOAD, SPRING = 0.04, 0.01, 0.01, 0.2  # relative, m, relative, relative: one sigma
RIPPLE, LINES, ORDERS, PLAY = (1e-5, 3e-5), (3, 5), (3, 150), 1e-5  # rad of all lines together, how many, waves a turn, rad
TAILS = 4  # degrees of freedom of the readings' noise
READINGS = (90, 150, 250)
MIXTURE = ("none", "single", "single", "none", "pair", "outside", "single", "none", "single", "outside")
WORSE = 0.02
LEAST_EXACT = 0.02  # of a gap: what less than that is shrunk by says nothing


def drawn_machine(path: Path, seed: int, index: int) -> TrackerMachine:
    """The machine of world `index`."""
    rng = np.random.default_rng([seed, index, 1])
    cell = read_cell(path)
    truth = draw_truth(cell, int(rng.integers(2**31)), weight_bends="believed")
    ripple = np.zeros((6, LINES[1], 3))
    for gear in ripple:
        count = int(rng.integers(LINES[0], LINES[1] + 1))
        gear[:count, 0] = rng.uniform(*RIPPLE) * np.sqrt(rng.dirichlet(np.ones(count)))
        gear[:count, 1] = rng.choice(np.arange(*ORDERS), count, replace=False)
        gear[:count, 2] = [rng.uniform(0, 2 * np.pi) for _ in range(count)]
    truth = replace(
        truth,
        mass_scale=1 + MASS * np.clip(rng.normal(size=7), -2.5, 2.5),
        stiffness=cell.robot.stiffness / (1 + SPRING * np.clip(rng.normal(size=6), -2.5, 2.5)),
        payloads={name: (mass * (1 + PAYLOAD * rng.normal()), com) for name, (mass, com) in truth.payloads.items()},
        ripple=ripple,
        play=rng.uniform(0, PLAY, 6),
        mass_shift=CENTRE * rng.normal(size=(7, 3)),
    )
    campaign = random_design(cell, rng, READINGS[index % len(READINGS)], warm_up=float(rng.uniform(2.0, 12.0)))
    return TrackerMachine(cell, truth, campaign, sealed_design(cell, rng, 90), PLAY)


def view_of(machine: TrackerMachine) -> TrackerView:
    """What an oracle sees who knows what machines of this kind are drawn with."""
    scene = scene_of(machine)
    A, sd = tracker_nuisance(scene)
    springs = 42 + 3 * len(dict.fromkeys(scene.campaign.targets))
    sd[springs : springs + 6] = SPRING
    payloads = springs + 6 + 7 + 18  # after springs, masses and centres of the links
    sd[payloads : payloads + len(machine.truth.payloads)] = PAYLOAD / (PAYLOAD_MASS / np.sqrt(3.0))
    W = tracker_root(scene)
    return TrackerView(machine, scene, exact_whitener(partial(white_points, W), white_points(W, A) * sd))


def written(out: Path, seed: int, index: int) -> Path:
    """Folder of fresh world `index`, drawn where it is not there."""
    folder = out / "worlds" / f"{seed:02d}_{index:03d}"
    if (folder / "labels" / "labels.json").is_file():
        return folder
    machine = drawn_machine(out / "cell.toml", seed, index)
    kind = MIXTURE[index % len(MIXTURE)]
    turn = sum(MIXTURE[k % len(MIXTURE)] == kind for k in range(index))
    target = {"pair": SEVERAL, "outside": STRANGE}.get(kind, BINS[1 + turn % 3])
    effects: tuple[Planted, ...] = ()
    lam: tuple[float, ...] = ()
    if kind != "none":
        effects, lam = draw_effects(seed, Recipe(index, kind, turn, target), view_of(machine), "tracker")
    truth = machine.with_effects(effects)
    arm = arm_with_outside(machine.cell, truth, machine.campaign.targets)
    tracker_world(folder, machine.cell, truth, TrackerLog(machine.campaign, machine.sealed), arm)
    rng = np.random.default_rng([seed, index, 2])
    exact = true_points(truth, machine.cell, arm, machine.campaign.moments, machine.campaign.targets, rng)
    truths = machine.points(effects, sealed=True)
    late, after, moved = stands(out / "cell.toml", seed, index, truth, len(exact), len(truths))
    exact, truths = np.where(late[:, None], apply(moved, exact), exact), np.where(after[:, None], apply(moved, truths), truths)
    noise = instrument(machine.cell, 0.0, exact, rng) - exact
    gross = instrument(machine.cell, truth.outliers, exact, np.random.default_rng([seed, index, 3])) - exact
    wild = np.linalg.norm(gross, axis=1) > 3e-4
    read = exact + np.where(wild[:, None], gross, noise * np.sqrt(TAILS / rng.chisquare(TAILS, (len(exact), 1))))
    (folder / "labels").mkdir(exist_ok=True)
    sealed = folder / "sealed_tracker.csv"
    _rewritten(folder / "tracker.csv", folder / "tracker.csv", read, late)
    _rewritten(sealed, folder / "labels" / "sealed_tracker_truth.csv", truths, after)
    _rewritten(sealed, sealed, None, after)
    told = {"seed": seed, "labels": labels(effects), "detectability": [{"lam": v} for v in lam]}
    (folder / "labels" / "labels.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return folder


def stands(cell: Path, seed: int, index: int, truth: Truth, n: int, sealed: int) -> tuple[Array, Array, Array]:
    """Which of n readings and of the sealed ones the tracker takes from its second stand, and how points seen from its first are
    seen from there: where it is not carried elsewhere, as before."""
    if index % 3 != 2:
        return np.zeros(n, bool), np.zeros(sealed, bool), np.eye(4)
    other = drawn_machine(cell, seed + 500, index).truth.T_tracker_base
    return np.arange(n) >= 2 * n // 3, np.ones(sealed, bool), np.asarray(other @ invert(truth.T_tracker_base))


def with_exact_signature(folder: Path, answer: Answer, told: Sequence[dict[str, Any]]) -> Array:
    """Sealed points m, predicted by who knows what was planted to the last digit and takes it out of the readings."""
    seed, index = (int(part) for part in folder.name.split("_"))
    cell, channel = folder.parents[1] / "cell.toml", answer.diagnosis.baseline[0]
    machine = drawn_machine(cell, seed, index)
    planted = [
        Planted(one["effect"], one["joint"], {k: v for k, v in one.items() if k not in ("effect", "joint")}) for one in told
    ]
    adds = [machine.points(planted, sealed) - machine.points((), sealed) for sealed in (False, True)]
    late, after, moved = stands(cell, seed, index, machine.truth, *map(len, adds))
    adds = [np.where(there[:, None], a @ moved[:3, :3].T, a) for a, there in zip(adds, (late, after), strict=True)]
    assert isinstance(channel, TrackerChannel) and answer.data.readings is not None
    rows = channel.readings.line - 2
    bare = replace(answer.data, readings=replace(answer.data.readings, point=answer.data.readings.point - adds[0][rows]))
    return np.asarray(tracker_channel(bare).predict(read_sealed(bare, "tracker"), ()).baseline + adds[1])


def _rewritten(source: Path, path: Path, points: Array | None, late: Array) -> None:
    """A table again with these points m (None: none) and stands of the tracker."""
    with source.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for k, row in enumerate(rows):
        row |= {"station": "S2" if late[k] else "S1"}
        row |= {} if points is None else {f"{c}_mm": f"{1e3 * v:.4f}" for c, v in zip("xyz", points[k], strict=True)}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


@threadpool_limits.wrap(limits=1, user_api="blas")  # as the command does: threads only fight over matrices as small as these
def judged(folder: Path) -> dict[str, Any]:
    """The row of a world: what was planted, said, promised and came."""
    told = json.loads((folder / "labels" / "labels.json").read_text(encoding="utf-8"))
    planted = [(one["effect"], one.get("joint") or 0) for one in told["labels"]]
    lam = [d["lam"] for d in told["detectability"]][: len(planted)]
    row: dict[str, Any] = {"world": folder.name, "planted": planted, "lam": lam}
    row["outside"] = any(n not in library() for n, _ in planted)
    begin = time.process_time()
    try:
        answer = answer_of(folder, Phases())
        sealed = predict_sealed(answer)["tracker"]
    except FAULTS as error:
        return row | {"error": str(error)}
    document = document_of(answer).model_dump(mode="json", by_alias=True)
    with (folder / "labels" / "sealed_tracker_truth.csv").open(encoding="utf-8") as file:
        truth = 1e-3 * np.array([[float(r[f"{c}_mm"]) for c in "xyz"] for r in csv.DictReader(file)])
    before, after = (float(np.sqrt(np.mean(np.sum((p - truth) ** 2, axis=1)))) for p in (sealed.baseline, sealed.corrected))
    z = (sealed.corrected - truth) / sealed.sigma
    seconds = time.process_time() - begin
    exact = with_exact_signature(folder, answer, told["labels"]) if row["outside"] and folder.name[0].isdigit() else None
    groups, named = declared_classes(document), decided_names(document)
    said = [(r["effect"], r["joint"] or 0) for r in document["ranking"]]
    return row | {
        "error": None,
        "verdict": document["verdict"],
        "p_none": document["p_none"],
        "p_unknown": document["p_unknown"],
        "said": [[*n, r["probability"]] for n, r in zip(said, document["ranking"], strict=True)][:4],
        "named": named,
        "first": first_right(planted, said, groups, 1),
        "set": [matched(planted, named, groups), len(named), len(planted)],
        "promised": document["gap"]["tracker"]["shrinkage"],
        "before": before,
        "after": after,
        "came": 1.0 - after / before,
        "exact": None if exact is None else 1.0 - float(np.sqrt(np.mean(np.sum((exact - truth) ** 2, axis=1)))) / before,
        "z2": float(np.mean(z**2)),
        "patch": _patch(document, sealed, truth, before),
        "because": list(answer.diagnosis.unknown_reasons),
        "seconds": seconds,
    }


def _patch(document: dict[str, Any], sealed: Sealed, truth: Array, before: float) -> dict[str, Any] | None:
    """What a patch is, promised, and came with it; its rms z."""
    if document["patch"] is None or sealed.patched is None or sealed.patched_sigma is None:
        return None
    off = sealed.patched - truth
    after = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    told: dict[str, Any] = document["patch"]["tracker"]
    z2, inside = float(np.mean((off / sealed.patched_sigma) ** 2)), None if sealed.inside is None else float(sealed.inside.mean())
    return {"promised": told["shrinkage"], "formula": told["formula"], "came": 1.0 - after / before, "z2": z2, "inside": inside}


Rows = list[dict[str, Any]]


def _share(rows: Rows, what: Any) -> float:
    return float(np.mean([float(what(r)) for r in rows])) if rows else float("nan")


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def _f1(rows: Rows, effects: int) -> float:
    sets = np.array([r["set"] for r in rows if len(r["planted"]) == effects and min(r["lam"]) >= 50])
    return float(2 * sets[:, 0].sum() / max(sets[:, 1:].sum(), 1)) if len(sets) else float("nan")


def _of_exact(row: dict[str, Any]) -> float:
    """Of the shrinkage that the exact signature brings, what came with names and patch together."""
    came = row["came"] if row["patch"] is None else row["patch"]["came"]
    return float(came / row["exact"])


def unexplained(row: dict[str, Any]) -> bool:
    """Whether the answer says that something else is there."""
    return row["verdict"] in ("unexplained", "partly")


def figures(every: Rows) -> dict[str, float]:
    """All figures of rows; an answer that failed is no name."""
    fine = [r for r in every if r["error"] is None]
    known = [r for r in fine if r["planted"] and not r["outside"]]
    strong, weak = ([r for r in known if low <= max(r["lam"]) < high] for low, high in ((50, np.inf), (30, 50)))
    patches = [r["patch"] for r in fine if r.get("patch") is not None]
    strange = [r for r in fine if (r.get("exact") or 0.0) > LEAST_EXACT]
    told = [r for r in fine if r["promised"] is not None and abs(r["came"]) > 1e-6]
    return {
        "first name right, lambda >= 50": _share(strong, lambda r: r["first"]),
        "first name right, 30 to 50": _share(weak, lambda r: r["first"]),
        "singles F1, lambda >= 50": _f1(known, 1),
        "pairs F1, each >= 50": _f1(known, 2),
        "accused, nothing planted": _share([r for r in fine if not r["planted"]], lambda r: bool(r["named"])),
        "told, outside the catalogue": _share([r for r in fine if r["outside"]], unexplained),
        "told, in the catalogue": _share([r for r in fine if not r["outside"]], unexplained),
        "shrinkage that came, lambda >= 50": _median([r["came"] for r in strong]),
        "promised less came, median": _median([r["promised"]["predicted"] - r["came"] for r in told]),
        "promised interval covers": _share(
            told, lambda r: r["promised"]["low"] <= r["came"] + 5e-3 <= r["promised"]["high"] + 1e-2
        ),
        "made worse by over 2 %": _share(fine, lambda r: r["came"] < -WORSE),
        "worst": min((r["came"] for r in fine), default=float("nan")),
        "patched, outside the catalogue": _share([r for r in fine if r["outside"]], lambda r: r.get("patch") is not None),
        "patched, in the catalogue": _share([r for r in fine if not r["outside"]], lambda r: r.get("patch") is not None),
        "of the exact signature's, lambda >= 50": _median([_of_exact(r) for r in strange if max(r["lam"]) >= 50]),
        "share with half of it, lambda >= 100": _share(
            [r for r in strange if max(r["lam"]) >= 100], lambda r: _of_exact(r) >= 0.5
        ),
        "shrinkage that came with it, median": _median([p["came"] for p in patches]),
        "promised with it less came, median": _median([p["promised"]["predicted"] - p["came"] for p in patches]),
        "its interval covers": _share(patches, lambda p: p["promised"]["low"] <= p["came"] <= p["promised"]["high"]),
        "made worse by it by over 2 %": _share(patches, lambda p: p["came"] < -WORSE),
        "rms z of predictions": float(np.sqrt(_median([r["z2"] for r in fine]))),
        "failed": 1.0 - len(fine) / max(len(every), 1),
        "seconds of processor, median": _median([r["seconds"] for r in fine]),
    }


def report(rows: Rows, before: Rows | None) -> None:
    """The table, with the difference over the same worlds where there are earlier rows."""
    if before is None:
        for name, value in figures(rows).items():
            print(f"{name:36s} {value:8.3f}")
        return
    earlier = {r["world"]: r for r in before}
    rows = [r for r in rows if r["world"] in earlier]
    old = [earlier[r["world"]] for r in rows]
    picks = np.random.default_rng(0).integers(len(rows), size=(400, len(rows)))
    drawn = [(figures([rows[k] for k in p]), figures([old[k] for k in p])) for p in picks]
    for name, value in figures(rows).items():
        low, high = np.nanquantile([new[name] - was[name] for new, was in drawn], [0.025, 0.975])
        print(f"{name:36s} {figures(old)[name]:8.3f} -> {value:8.3f}   ({low:+.3f} .. {high:+.3f})")


def line_of(r: dict[str, Any]) -> str:
    """What is printed of a world."""
    head = f"{r['world']:16s} " + " ".join(f"{n}:{j}({v:.0f})" for (n, j), v in zip(r["planted"], r["lam"], strict=True))
    if r["error"] is not None:
        return f"{head} | FAILED {r['error']}"
    said = " ".join(f"{n}:{j} {p:.2f}" for n, j, p in r["said"][:3] if p > 0.1)
    promised = "-" if r["promised"] is None else f"{r['promised']['predicted']:.2f} [{r['promised']['low']:.2f}]"
    came = f"{promised} came {r['came']:.2f} of {1e6 * r['before']:.0f} um, z {r['z2'] ** 0.5:.1f}"
    if r["patch"] is not None:
        p = r["patch"]
        came += (
            f" | patch {p['promised']['predicted']:.2f} [{p['promised']['low']:.2f}] came {p['came']:.2f}, z {p['z2'] ** 0.5:.1f}"
        )
    return f"{head} | {r['verdict']} u {r['p_unknown']:.2f} {said} | {came}"


def main() -> None:
    """Draw what is missing, answer, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--worlds", type=int, default=80)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", default="rows")
    parser.add_argument("--before", type=Path)
    parser.add_argument("--only", choices=("shared", "fresh", "outside"), help="outside: fresh ones that hold what has no name")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    if not (asked.out / "cell.toml").is_file():
        write_cell(Path(CELL), asked.out / "cell.toml")
    folders = (
        [] if asked.only in ("fresh", "outside") else sorted(p for p in SHARED.iterdir() if (p / "sealed_tracker.csv").is_file())
    )
    for index in range(asked.worlds if asked.only != "shared" else 0):
        if asked.only == "outside" and MIXTURE[index % len(MIXTURE)] != "outside":
            continue
        try:
            folders.append(written(asked.out, asked.seed, index))
        except (Infeasible, BadInput) as error:
            print(f"world {index}: {error}")
    rows = []
    for folder in folders:
        rows.append(judged(folder))
        print(line_of(rows[-1]), flush=True)
    (asked.out / f"{asked.rows}.json").write_text(json.dumps(rows), encoding="utf-8")
    for title, fresh in (("labelled worlds", False), ("fresh worlds", True)):
        part = [r for r in rows if r["world"][0].isdigit() is fresh]
        if part:
            print(f"\n{title} ({len(part)})")
            report(part, json.loads(asked.before.read_text(encoding="utf-8")) if asked.before else None)


if __name__ == "__main__":
    main()
