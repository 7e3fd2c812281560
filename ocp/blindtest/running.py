"""The steps of a blind check in worker processes: make and seal all worlds, answer them, open the labels and score."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from typing import Any

from ocp.blindtest.answers import make_answer
from ocp.blindtest.drawing import Drawn, draw_effects
from ocp.blindtest.oracle.oracle import exact_view
from ocp.blindtest.scoring.scoring import make_score
from ocp.blindtest.worlds.files import write_world
from ocp.blindtest.worlds.recipes import Recipe
from ocp.blindtest.worlds.sealing import WITHHELD, Check, Label, label_path, machine_of, read_seal, write_label, write_seal
from ocp.shell.cache import sha256
from ocp.shell.progress import Phases
from ocp.shell.workers import interrupts_held_back, nothing, workers
from robots.errors import BadInput

PLAN = "plan.json"


def resume(check: Check, overwrite: bool) -> None:
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
    elif check.folder.is_dir() and any(check.folder.iterdir()):
        raise BadInput(f"{check.folder}: is not empty and holds no blind check; give another --out")
    else:
        check.folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(check.fixed()) + "\n", encoding="utf-8")


def make_world(check: Check, recipe: Recipe) -> str:
    """Draw, write and seal a world that is not there yet; the hash of its label. Raises Infeasible of the drawing."""
    folder, label = check.world(recipe.name), label_path(check, recipe)
    if not label.is_file():
        machine = machine_of(check, recipe)
        drawn = Drawn((), ())
        if recipe.target is not None:
            drawn = draw_effects(check.seed, recipe, exact_view(machine), check.signals)
        write_world(folder, machine, drawn.effects)
        withheld = tuple(p.effect for p in drawn.effects) if recipe.kind == "left_out" else ()
        if withheld:
            (folder / WITHHELD).write_text("\n".join(withheld) + "\n", encoding="utf-8")
        write_label(label, Label(recipe, drawn.effects, drawn.lam, withheld))
    return sha256(label)


def make_all(check: Check, recipes: Sequence[Recipe], jobs: int, phases: Phases) -> None:
    """Draw, write and seal every world; hashes of labels that were sealed before must not have changed."""
    with phases.phase("worlds", len(recipes)) as advance:
        hashes = {r.name: h for r, h in _each(jobs, make_world, [(check, r) for r in recipes], advance)}
    before = read_seal(check)
    broken = [name for name, h in before.items() if hashes.get(name, h) != h]
    if broken:
        raise BadInput(f"{check.folder}: the label of world {broken[0]} is not what was sealed; begin anew with --overwrite")
    write_seal(check, dict(sorted({**before, **hashes}.items())))


def answer_all(check: Check, recipes: Sequence[Recipe], jobs: int, phases: Phases) -> None:
    """Answer every world that has no answer yet."""
    with phases.phase("answers", len(recipes)) as advance:
        for _ in _each(jobs, _answer, [(check, r) for r in recipes], advance):
            pass


def _answer(check: Check, recipe: Recipe) -> str:
    return make_answer(check, recipe.name)


def score_all(check: Check, recipes: Sequence[Recipe], jobs: int, phases: Phases) -> list[dict[str, Any]]:
    """Rows of all worlds. Raises BadInput: an answer is missing, or a label is not the sealed one."""
    missing = [r.name for r in recipes if not check.answer(r.name).is_file()]
    if missing:
        raise BadInput(f"{check.folder}: world {missing[0]} has no answer yet; labels stay closed until all are written")
    seal = read_seal(check)
    with phases.phase("scores", len(recipes)) as advance:
        rows = {r.index: row for r, row in _each(jobs, make_score, [(check, r, seal) for r in recipes], advance)}
    return [rows[r.index] for r in recipes]


def _each(
    jobs: int, work: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], advance: Callable[[], None]
) -> Iterator[tuple[Recipe, Any]]:
    """Recipe and result of every call as they come."""
    if jobs == 1:
        for one in arguments:
            yield one[1], work(*one)
            advance()
        return
    with workers(jobs, nothing) as pool:
        with interrupts_held_back():
            waiting = {pool.submit(work, *one): one[1] for one in arguments}
        for done in as_completed(waiting):
            yield waiting[done], done.result()
            advance()


def forget_answers(check: Check) -> None:
    """Remove all answers and scores: they are of an older diagnosis."""
    for folder in ("answers", "scores"):
        for path in (check.folder / folder).glob("*.json"):
            path.unlink()
