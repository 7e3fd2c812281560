"""`ocp.api.blindtest`: worlds drawn and sealed, answered by the diagnosis without their labels, then judged, on many cores.

The effects of a world are drawn, then brought to the detectability that its recipe asks for, all before anything is sealed.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.answers import make_answer
from ocp.blindtest.figures import Figure, all_figures
from ocp.blindtest.oracle.oracle import ExactView, detectabilities, exact_view
from ocp.blindtest.record import Standing, entered, refuse_unrecorded
from ocp.blindtest.report import blindtest_last_line, write_blindtest_report
from ocp.blindtest.scoring import make_score, score_path
from ocp.blindtest.worlds import sealing
from ocp.blindtest.worlds.machines import EFFECTS, stream
from ocp.blindtest.worlds.recipes import BINS, KINDS, SIGNALS, Recipe, check_kinds, pool_of, recipes, scaled, within_range
from ocp.blindtest.worlds.sealing import CELL as CELL_FILE
from ocp.blindtest.worlds.sealing import Check, Label, write_cell
from ocp.data import CELL
from ocp.model.cell import files_of
from ocp.shell.cache import sha256
from ocp.shell.executor import Hands, carried_out, errand, files_under, lay
from ocp.shell.output import MARKER, add_text_file, files_added, remove_written, reserved
from ocp.shell.processes import cores
from ocp.shell.progress import Phases, Progress
from ocp.simulate.twin.planting import EffectKind, Planted, draw_effect
from robots.bounds import refuse_outside
from robots.errors import BadInput, Infeasible
from robots.pose import Array


@dataclass(frozen=True)
class BlindtestResult:
    """A blind check: its folder, one row of scores a world, the figures with their intervals and targets, what its answers are to
    its seed, and the one line that says how many figures are reached."""

    folder: Path
    rows: tuple[dict[str, Any], ...]
    figures: tuple[Figure, ...]
    standing: Standing
    line: str
    notices: tuple[str, ...] = ()


def blindtest(
    *,
    out: str | Path,
    worlds: int = 95,
    kinds: Sequence[str] = KINDS,
    signals: str = "tracker",
    seed: int = 1,
    jobs: int = 0,
    scheduler: str | None = None,
    cell: str | Path = CELL,
    readings: int = 150,
    again: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BlindtestResult:
    """Draw and seal worlds, let the diagnosis answer them blind, then open the labels and score; worlds, answers, scores and
    report stand in the folder `out`, where a later call with the same arguments goes on.

    worlds: how many; kinds of worlds; signals: tracker, force or both; seed: everything is drawn from it, 1 to 99 for
    development, the answers to any other are entered in the repository's record; jobs: processes (0:
    one for each core); scheduler: address of a Dask scheduler whose workers do it instead; cell: whose machines are drawn;
    readings of a campaign; again: answer all worlds anew; overwrite: begin anew, with new worlds. Raises BadInput: an argument
    is not what it should be, or `out` holds something else.
    """
    folder = Path(out)
    if signals not in SIGNALS:
        raise BadInput(f"--signals '{signals}' is not one of {', '.join(SIGNALS)}")
    refuse_outside(("--worlds", worlds, 1, 20000, ""), ("--readings", readings, 40, 2000, ""), ("--jobs", jobs, 0, 64, ""))
    check = Check(folder, seed, worlds, check_kinds(",".join(kinds), signals), readings, signals=signals)
    refuse_unrecorded(check)
    hands = Hands(jobs or cores(), scheduler)
    with reserved(folder, overwrite, files_of(cell), grows=True) as output, output.grown():
        return _judged(check, Path(cell), again, hands, Phases(progress))


def _judged(check: Check, cell: Path, again: bool, hands: Hands, phases: Phases) -> BlindtestResult:
    """The steps of a check."""
    resume(check)
    if not check.cell.is_file():
        with files_added(check.folder, last=CELL_FILE) as part:
            write_cell(cell, replace(check, folder=part).cell, check.signals)
    if again:
        forget_answers(check)
    planned = recipes(check.worlds, check.kinds)
    make_all(check, planned, hands, phases)
    answer_all(check, planned, hands, phases)
    standing = entered(check)
    rows = score_all(check, planned, hands, phases)
    with phases.phase("report"):
        write_blindtest_report(check, rows, standing)
    line = blindtest_last_line(check, rows, standing)
    return BlindtestResult(check.folder, tuple(rows), tuple(all_figures(rows)), standing, line)


TRIES = 60
IN_TURN = 3  # attempts of a tracker world with the kind whose turn it is, then kinds are drawn
SAME_KIND = 2  # attempts of a force world with a kind, then it is the turn of the next
CLOSE, ENOUGH = 0.25, 0.02  # relative: how near the target the true lambda must come, and where sizes are changed no further
STEPS = {"tracker": 3, "force": 4, "both": 4}  # how often sizes are changed: readings are linear in them to first order only
FAINT = {"tracker": 1e-3, "force": 1e-2, "both": 1e-2}  # lambda with its price below which readings do not show the effect


Drawn = tuple[tuple[Planted, ...], tuple[float, ...]]
"""Effects with the detectability of each given the others, less the price of scanned families."""


def draw_effects(seed: int, recipe: Recipe, view: ExactView, signals: str) -> Drawn:
    """Effects of a world of a `recipe` that plants some. Raises Infeasible: none reach the detectability within their usual
    range."""
    assert recipe.target is not None
    rng, pool = stream(seed, recipe, EFFECTS), pool_of(recipe, signals)
    for attempt in range(TRIES):
        effects = [_one(rng, kind, view) for kind in _kinds(seed, recipe, rng, attempt, pool, signals)]
        if len({(p.effect, p.joint) for p in effects}) < len(effects):
            continue
        low, high = np.log(recipe.target)
        found = _brought(view, effects, np.exp(rng.uniform(low, high, len(effects))), signals)
        if found is not None:
            return found
    raise Infeasible(f"world {recipe.index}: no effect reaches a detectability of {recipe.target[0]:g} within its usual range")


def _kinds(
    seed: int, recipe: Recipe, rng: np.random.Generator, attempt: int, pool: Sequence[EffectKind], signals: str
) -> list[EffectKind]:
    """Kinds to try. Of single effects all kinds take turns from world to world, of force worlds in every bin of its own; one that
    cannot be brought to its detectability leaves its place."""
    single, tracker = recipe.kind == "single", signals == "tracker"
    if recipe.effects > 1 or (tracker and attempt >= IN_TURN):
        return [pool[k] for k in rng.choice(len(pool), recipe.effects, replace=False)]
    key: tuple[int, ...]
    if tracker:
        key, turn, skipped = (0,), recipe.turn // 4 + (recipe.turn % 4) * 5 if single else recipe.turn, 0
    else:
        bin_, turn = (recipe.turn % len(BINS), recipe.turn // len(BINS)) if single else (9, recipe.turn)
        key, skipped = (1, bin_), attempt // SAME_KIND
    block, place = divmod(turn, len(pool))
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*key, block))).permutation(len(pool))
    return [pool[order[(place + skipped) % len(pool)]]]


def _one(rng: np.random.Generator, kind: EffectKind, view: ExactView) -> Planted:
    planted = draw_effect(rng, kind, targets=view.targets)
    at = view.instant(planted, rng) if "at_s" in planted.values else None
    return planted if at is None else replace(planted, values={**planted.values, "at_s": at})


def _brought(view: ExactView, effects: list[Planted], wanted: Array, signals: str) -> Drawn | None:
    """The effects at sizes that give the wanted detectabilities; None where a size would leave its usual range."""
    dues = np.array([view.price(p.effect, p.joint) for p in effects])
    for _ in range(STEPS[signals]):
        lam = detectabilities(view, effects)
        if (lam + dues <= FAINT[signals]).any():
            return None
        if (np.abs(lam / wanted - 1.0) < ENOUGH).all():
            break
        factors = np.sqrt((wanted + dues) / (lam + dues))
        effects = [scaled(p, float(f)) for p, f in zip(effects, factors, strict=True)]
        if not all(within_range(p) for p in effects):
            return None
    else:
        lam = detectabilities(view, effects)
    if (np.abs(lam / wanted - 1.0) > CLOSE).any():
        return None
    return tuple(effects), tuple(float(v) for v in lam)


PLAN = "plan.json"


def resume(check: Check) -> None:
    """Raises BadInput: the folder holds another check, or anything else."""
    path = check.folder / PLAN
    if path.is_file():
        before = json.loads(path.read_text(encoding="utf-8"))
        if before != check.fixed():
            changed = [k for k in check.fixed() if before.get(k) != check.fixed()[k]]
            raise BadInput(
                f"{check.folder}: holds a blind check with another {changed[0] if changed else 'plan'}; give the same options to "
                "go on with it, another --out, or --overwrite"
            )
    elif check.folder.is_dir() and any(p.name != MARKER for p in check.folder.iterdir()):
        raise BadInput(f"{check.folder}: is not empty and holds no blind check; give another --out")
    else:
        add_text_file(check.folder, PLAN, json.dumps(check.fixed()) + "\n")


def make_world(check: Check, recipe: Recipe) -> None:
    """Draw and write a world and its label. Raises Infeasible of the drawing."""
    machine = sealing.machine_of(check, recipe)
    view = None if recipe.target is None else exact_view(machine)
    effects, lam = ((), ()) if view is None else draw_effects(check.seed, recipe, view, check.signals)
    withheld = tuple(p.effect for p in effects) if recipe.kind == "left_out" else ()
    sealing.write_world(check.world(recipe.name), machine, effects)
    if withheld:
        (check.world(recipe.name) / sealing.WITHHELD).write_text("\n".join(withheld) + "\n", encoding="utf-8")
    sealing.write_label(sealing.label_path(check, recipe), Label(recipe, effects, lam, withheld))


def make_all(check: Check, recipes: Sequence[Recipe], hands: Hands, phases: Phases) -> None:
    """Draw, write and seal every world; hashes of labels that were sealed before must not have changed."""
    step = _Step(make_world, partial(sealing.label_path, check), lambda _: _cell_files(check))
    _each("worlds", check, step, recipes, _missing(step, recipes), hands, phases)
    hashes = {r.name: sha256(sealing.label_path(check, r)) for r in recipes}
    before = sealing.read_seal(check)
    broken = [name for name, h in before.items() if hashes.get(name, h) != h]
    if broken:
        raise BadInput(f"{check.folder}: the label of world {broken[0]} is not what was sealed; begin anew with --overwrite")
    whole = dict(sorted({**before, **hashes}.items()))
    add_text_file(check.folder, sealing.SEAL, json.dumps(whole, indent=1) + "\n")


def answer_all(check: Check, recipes: Sequence[Recipe], hands: Hands, phases: Phases) -> None:
    """Answer every world that has no answer yet, where its folder stands and nothing else of the check."""
    step = _Step(make_answer, lambda r: check.answer(r.name), lambda r: [check.world(r.name)])
    _each("answers", check, step, recipes, _missing(step, recipes), hands, phases)


def score_all(check: Check, recipes: Sequence[Recipe], hands: Hands, phases: Phases) -> list[dict[str, Any]]:
    """Rows of all worlds; those are scored whose answer is newer than their score, or that have none. Raises BadInput: an answer
    is missing, or a label is not the sealed one."""
    missing = [r.name for r in recipes if not check.answer(r.name).is_file()]
    if missing:
        raise BadInput(f"{check.folder}: world {missing[0]} has no answer yet; labels stay closed until all are written")

    def reads(r: Recipe) -> list[Path]:
        sealed = check.folder / sealing.SEAL, sealing.label_path(check, r)
        return [*_cell_files(check), *sealed, check.world(r.name), check.answer(r.name)]

    def stale(r: Recipe) -> bool:
        return step.result(r).stat().st_mtime < check.answer(r.name).stat().st_mtime

    step = _Step(make_score, lambda r: score_path(check, r.name), reads)
    absent = _missing(step, recipes)
    _each("scores", check, step, recipes, [r for r in recipes if r in absent or stale(r)], hands, phases)
    return [json.loads(step.result(r).read_text(encoding="utf-8")) for r in recipes]


@dataclass(frozen=True)
class _Step:
    """What is done of a world: `work(check, recipe)`, the file that says that it is done, and the files and folders that it
    reads; all of them lie in the check's folder, which is another one where the work is done."""

    work: Callable[[Check, Recipe], Any]
    result: Callable[[Recipe], Path]
    reads: Callable[[Recipe], Sequence[Path]]


def _missing(step: _Step, recipes: Sequence[Recipe]) -> list[Recipe]:
    return [r for r in recipes if not step.result(r).is_file()]


def _each(
    name: str, check: Check, step: _Step, recipes: Sequence[Recipe], todo: Sequence[Recipe], hands: Hands, phases: Phases
) -> None:
    """Do a step of the worlds `todo`; the others' is done."""

    def below(path: Path) -> str:
        return path.relative_to(check.folder).as_posix()

    with phases.phase(name, len(recipes)) as advance:
        for _ in range(len(recipes) - len(todo)):
            advance()
        tasks = ((_there, files_under(check.folder, *map(below, step.reads(r))), step.work, check, r) for r in todo)
        for place, done in carried_out(errand, tasks, hands):
            _, files = done.result()
            with files_added(check.folder, last=below(step.result(todo[place]))) as part:
                lay(files, part)
            advance()


def _there(folder: Path, work: Callable[[Check, Recipe], Any], check: Check, recipe: Recipe) -> None:
    work(replace(check, folder=folder), recipe)


def _cell_files(check: Check) -> list[Path]:
    return [file for file in files_of(check.cell) if check.folder in file.parents]


def forget_answers(check: Check) -> None:
    """Remove all answers and scores: they are of an older diagnosis. Raises BadInput: one was changed, or put there, by hand."""
    found = (*check.folder.glob("answers/*.json"), *check.folder.glob("scores/*.json"))
    remove_written(check.folder, [path.relative_to(check.folder).as_posix() for path in found])
