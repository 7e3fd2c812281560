"""Many robots side by side in worker processes; each that is done is kept, so that a broken run goes on where it stopped."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict

import numpy as np

from ocp.experiments.course import Course, compensated, lay_course
from ocp.experiments.trial import Trial, run_trial
from ocp.model.cell import Cell
from ocp.plan.passes.optimise import FILES, SolvedPass, code_hash
from ocp.shell.cache import content_key, flattened, keep, recall
from ocp.shell.progress import Phases
from ocp.shell.workers import interrupts_held_back, workers

Nominal = dict[str, list[SolvedPass]]


def run_trials(cell: Cell, mounts: Sequence[str], seeds: Sequence[int], poses: int, jobs: int, phases: Phases) -> list[Trial]:
    """The trials of `seeds`, in their order; those kept from before are not run again.

    Raises BadInput and Infeasible where the cell cannot be ground at all.
    """
    courses = {mount: lay_course(cell, mount, phases) for mount in mounts}
    nominal = {mount: compensated(course, None, course.tested) for mount, course in courses.items()}
    content = {name: a for name, a in sorted(flattened(list(courses.values())).items()) if not name.endswith(FILES)}
    ground = content_key(code_hash(), poses, *(part for name, array in content.items() for part in (name, array)))
    keys = {seed: content_key(ground, seed) for seed in seeds}
    done = {seed: trial for seed, key in keys.items() if (trial := _recalled(key)) is not None}
    missing = [seed for seed in seeds if seed not in done]
    with phases.phase("robots", len(seeds)) as advance:
        for _ in done:
            advance()

        def finish(trial: Trial) -> None:
            done[trial.seed] = trial
            keep("experiment", keys[trial.seed], {"trial": np.array(_as_json(trial))})
            advance()

        _run(courses, nominal, missing, poses, jobs, finish)
    return [done[seed] for seed in seeds]


_state: tuple[dict[str, Course], Nominal, int] | None = None


def _start_worker(courses: dict[str, Course], nominal: Nominal, poses: int) -> None:
    global _state
    _state = courses, nominal, poses


def _trial_in_worker(seed: int) -> Trial:
    assert _state is not None
    courses, nominal, poses = _state
    return run_trial(courses, nominal, seed, poses)


def _run(
    courses: dict[str, Course], nominal: Nominal, seeds: Sequence[int], poses: int, jobs: int, finish: Callable[[Trial], None]
) -> None:
    if jobs <= 1 or len(seeds) <= 1:
        for seed in seeds:
            finish(run_trial(courses, nominal, seed, poses))
        return
    with workers(min(jobs, len(seeds)), _start_worker, courses, nominal, poses) as pool:
        with interrupts_held_back():
            futures = [pool.submit(_trial_in_worker, seed) for seed in seeds]
        for future in futures:
            finish(future.result())


def _as_json(trial: Trial) -> str:
    return json.dumps(asdict(trial), default=lambda value: np.asarray(value).tolist())


def _recalled(key: str) -> Trial | None:
    entry = recall("experiment", key)
    if entry is None:
        return None
    data = json.loads(str(entry["trial"]))
    for part in ("positions", "force", "read"):
        data[part] = {name: np.array(values) for name, values in data[part].items()}
    return Trial(**data)


def trials_json(trials: Sequence[Trial], options: dict[str, object]) -> str:
    """All numbers, for other programs."""
    return json.dumps({"options": options, "robots": [json.loads(_as_json(t)) for t in trials]}, indent=1) + "\n"
