"""Every number of docs/performance.md: `python benchmarks/plan.py [phases|scaling] [--quick]`, default both.

phases: one plan with an empty cache and once more with a full one. scaling: the nonlinear program from 1000 to 30 000
waypoints on the same passes, at rest under force at both ends (no lead-ins). The machine need not be quiet: compare rows of one
run. Other ways to make a pass: `control_table.py`.
"""

import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy.interpolate import CubicSpline

from ocp.contact.blade import compliance as blade
from ocp.contact.blade.elasticity import Material
from ocp.model.cell import read_cell
from ocp.model.prepare import prepare_contact, typical_patch, wheel_cover
from ocp.model.theta import believed_theta
from ocp.plan.clearance import CollisionScene
from ocp.plan.files import write_plan
from ocp.plan.passes import optimise
from ocp.plan.passes.optimise import Ground, PassWorker
from ocp.plan.passes.posture import Seed, find_seeds
from ocp.plan.passes.problem import PassProblem, with_direction
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.plan.planning import make_plan
from ocp.shell.native import evaluated_by
from ocp.shell.output import reserved
from ocp.shell.progress import Phases
from robots.pose import Array
from trajectories.passes import BladePath, reversed_path

ROOT = Path(__file__).resolve().parents[1]
CELL, BLADE = ROOT / "ocp" / "data" / "cell.toml", ROOT.parent / "shared" / "data" / "blades" / "twisted.stl"
STEP = 1e-3  # m, the command's default distance of waypoints
STEPS = (1.8e-3, STEP, 5e-4, 1.5e-4, 6e-5)  # m: 1000 to 30 000 waypoints on 20 passes of 91 mm


@dataclass(frozen=True)
class Job:
    """What all passes share, the passes, their seeds, and the blade's compliance at their waypoints."""

    ground: Ground
    paths: list[BladePath]
    seeds: list[list[Seed]]
    compliance: list[Array]


def prepared(cell_file: Path, stl: Path) -> Job:
    """Everything up to the optimiser, as `ocp.plan.planning.make_plan` does it."""
    cell = read_cell(cell_file, stl)
    laid = lay_paths(cell, stl, PlanOptions(step=STEP))
    contact = prepare_contact(cell, laid.blade, laid.paths, Phases())
    seeds = find_seeds(cell, CollisionScene(cell, laid.blade.vertices), contact.law, laid.paths)
    ground = Ground(
        cell, believed_theta(cell), ObjectiveWeights(), contact.law, contact.cover, laid.blade.vertices, laid.cloud, laid.beside
    )
    return Job(ground, laid.paths, seeds, [np.asarray(c) for c in contact.compliance.per_pass])


def apart(call: Callable[..., Any], *arguments: Any) -> Any:
    """Run `call` in a process of its own, so that its peak memory is its own."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(call, *arguments).result()


def measured(call: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """What `call` gives and this process's peak memory in MB."""
    return call(*arguments), peak_MB()[0]


@contextmanager
def timed(seconds: dict[str, float], label: str, owner: Any, name: str) -> Iterator[None]:
    """Add what every call of `owner.name` takes to `seconds[label]`."""
    original = getattr(owner, name)

    def watched(*arguments: Any, **named: Any) -> Any:
        start = time.perf_counter()
        try:
            return original(*arguments, **named)
        finally:
            seconds[label] = seconds.get(label, 0.0) + time.perf_counter() - start

    setattr(owner, name, watched)
    try:
        yield
    finally:
        setattr(owner, name, original)


def peak_MB() -> tuple[float, float]:
    """Largest resident memory of this process, and of the largest process it started, MB."""
    factor = 1e-6 if sys.platform == "darwin" else 1e-3
    return tuple(factor * resource.getrusage(w).ru_maxrss for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


# -- phases ---------------------------------------------------------------------------------------------------------


def one_plan(cell_file: Path, stl: Path, out: Path) -> tuple[dict[str, float], float, int, tuple[float, float, float]]:
    """Seconds a phase, seconds in all, waypoints, processor seconds and memory of one plan written to `out`."""
    phases, start = Phases(), time.perf_counter()
    with reserved(out, True, [cell_file, stl]) as output:
        made = write_plan(make_plan(cell_file, stl, PlanOptions(step=STEP), phases), output, phases)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    processor = sum(u.ru_utime + u.ru_stime for u in used)
    return phases.seconds, time.perf_counter() - start, made.plan.waypoints, (processor, *peak_MB())


def phases(cell_file: Path, stl: Path, quick: bool) -> None:
    """A plan with an empty cache, the same with a full one; then what the coarse phases are made of."""
    folder = Path(tempfile.mkdtemp(prefix="plan_benchmark_"))
    kept = os.environ.get("GRINDPLAN_CACHE")
    os.environ["GRINDPLAN_CACHE"] = str(folder / "cache")
    try:
        runs = [apart(one_plan, cell_file, stl, folder / "out") for _ in range(2)]
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        print(f"{stl.name}: {runs[0][2]} waypoints, {cores} cores; seconds of wall clock")
        print(f"{'':18}{'cold':>8}{'warm':>8}")
        for name in runs[0][0]:
            print(f"{name:18}" + "".join(f"{seconds.get(name, 0.0):8.2f}" for seconds, *_ in runs))
        print(f"{'in all':18}" + "".join(f"{run[1]:8.2f}" for run in runs))
        print(f"{'waypoints/s':18}" + "".join(f"{run[2] / run[1]:8.1f}" for run in runs))
        for place, name in enumerate(("processor s", "MB, main process", "MB, largest other")):
            print(f"{name:18}" + "".join(f"{run[3][place]:8.0f}" for run in runs))
        if not quick:
            blade_parts(cell_file, stl)
        pass_parts(prepared(cell_file, stl), 2 if quick else 6)
    finally:
        os.environ.pop("GRINDPLAN_CACHE")
        if kept is not None:
            os.environ["GRINDPLAN_CACHE"] = kept
        shutil.rmtree(folder)


def blade_parts(cell_file: Path, stl: Path) -> None:
    """What the phase 'blade' is made of, alone on a core and without any cache."""
    cell = read_cell(cell_file, stl)
    laid, piece = lay_paths(cell, stl, PlanOptions(step=STEP)), cell.workpiece
    axes = typical_patch(cell, wheel_cover(cell), np.vstack([path.curvature for path in laid.paths]))
    material = Material(piece.youngs_modulus, piece.poisson, piece.density)
    seconds: dict[str, float] = {}
    kept, os.environ["GRINDPLAN_CACHE"] = os.environ["GRINDPLAN_CACHE"], ""
    start = time.perf_counter()
    with timed(seconds, "mesh", blade, "volume_mesh"), timed(seconds, "factorisation", blade, "factorise"):
        held = blade.HeldBlade(laid.blade.vertices, laid.blade.faces, piece.clamp_normal, piece.clamp_offset, material)
        made = blade.blade_compliance(held, laid.paths, axes)
    seconds["patches"] = time.perf_counter() - start - sum(seconds.values())
    os.environ["GRINDPLAN_CACHE"] = kept
    print(f"blade alone ({made.unknowns} unknowns): " + ", ".join(f"{name} {s:.2f} s" for name, s in seconds.items()))


def pass_parts(job: Job, count: int) -> None:
    """What 'optimal control' is made of: `count` passes one after another in this process."""
    seconds: dict[str, float] = {}
    start = time.perf_counter()
    worker = PassWorker(job.ground)
    worker.solver.compile()
    seconds["compiling or loading"] = time.perf_counter() - start
    print(f"the model's functions by {evaluated_by()}")
    chosen = np.unique(np.linspace(0, len(job.paths) - 1, count).round().astype(int))
    for length in {len(job.paths[i].s) for i in chosen}:
        worker.solver.program(length)
    seconds["NLP build"] = time.perf_counter() - start - sum(seconds.values())
    with (
        timed(seconds, "NLP solve", PassSolver, "solve"),
        timed(seconds, "direct contact", optimise, "solve_directly"),
        timed(seconds, "touching elsewhere", optimise, "find_secondary_contact"),
    ):
        for i in chosen:
            worker.solve(job.paths[i], job.seeds[i], job.compliance[i])
    seconds["the rest"] = time.perf_counter() - start - sum(seconds.values())
    print(f"{len(chosen)} passes one after another: " + ", ".join(f"{name} {s:.2f} s" for name, s in seconds.items()))
    iteration_parts(worker, job, int(chosen[0]))


def iteration_parts(worker: PassWorker, job: Job, i: int) -> None:
    """Where an iteration of Ipopt spends its time, milliseconds and calls, and instructions of a stage's functions."""
    problem = oriented(job, i, job.paths[i], job.compliance[i])
    start = time.perf_counter()
    iterations = worker.solver.solve(problem).iterations
    seconds, stats = time.perf_counter() - start, worker.solver.program(len(problem.path.s)).solver.stats()
    stage, inside = worker.solver.stage, 0.0
    print(f"one pass of {len(problem.path.s)} waypoints, {iterations} iterations of {1e3 * seconds / iterations:.1f} ms:")
    functions = ("nlp_f", stage.value), ("nlp_g", stage.value), ("nlp_grad_f", stage.gradient), ("nlp_jac_g", stage.jacobian)
    for name, function in (*functions, ("nlp_hess_l", stage.hessian)):
        share = stats[f"t_wall_{name}"] / iterations
        inside += share
        calls = stats[f"n_call_{name}"] / iterations
        print(f"  {name:12}{1e3 * share:8.2f} ms, {calls:.1f} calls, {function.n_instructions():6d} instructions a waypoint")
    print(f"  {'the rest':12}{1e3 * (seconds / iterations - inside):8.2f} ms (Ipopt, MUMPS, seed)")


# -- scaling --------------------------------------------------------------------------------------------------------


def oriented(job: Job, i: int, path: BladePath, compliance: Array) -> PassProblem:
    """The problem of pass `i` on its best seed, in its direction of travel."""
    seed = job.seeds[i][0]
    problem = PassProblem.start(path, seed, compliance)
    return with_direction(problem, reversed_path(path)) if seed.direction < 0 else problem


def resampled(job: Job, cell_file: Path, stl: Path, step: float) -> list[PassProblem]:
    """The problems of all passes with waypoints `step` m apart; the compliance is interpolated along each pass."""
    paths = lay_paths(read_cell(cell_file, stl), stl, PlanOptions(step=step)).paths
    problems = []
    for i, (path, old, give) in enumerate(zip(paths, job.paths, job.compliance, strict=True)):
        problems.append(oriented(job, i, path, CubicSpline(old.s / old.s[-1], give)(path.s / path.s[-1])))
    return problems


def scaling(cell_file: Path, stl: Path, quick: bool) -> None:
    """Cost a waypoint of building and solving the program from its seed, on four passes of every refinement."""
    job = prepared(cell_file, stl)
    count = len(job.paths)
    chosen = sorted({0, count // 2 - 1, count // 2, count - 1})
    print(
        f"{'step mm':>8}{'waypoints':>10}{'solved':>8}{'build s':>9}{'solve s':>9}{'iterations':>20}"
        f"{'ms/waypoint':>13}{'ms/(waypoint iteration)':>25}"
    )
    for step in STEPS[:2] if quick else STEPS:
        problems = resampled(job, cell_file, stl, step)
        total, solved = (sum(len(problems[i].path.s) for i in which) for which in (range(count), chosen))
        start = time.perf_counter()
        solver = PassSolver(job.ground.cell, job.ground.law, job.ground.theta, job.ground.weights)
        for i in chosen:
            solver.program(len(problems[i].path.s))
        build = time.perf_counter() - start
        iterations = [solver.solve(problems[i]).iterations for i in chosen]
        solve = time.perf_counter() - start - build
        work = sum(k * len(problems[i].path.s) for k, i in zip(iterations, chosen, strict=True))
        print(
            f"{1e3 * step:8.2f}{total:10d}{solved:8d}{build:9.2f}{solve:9.2f}{iterations!s:>20}"
            f"{1e3 * (build + solve) / solved:13.2f}{1e3 * solve / work:25.3f}"
        )


TABLES = {"phases": phases, "scaling": scaling}


def main(
    tables: Annotated[list[str] | None, typer.Argument(help="phases, scaling; default both")] = None,
    cell: Annotated[Path, typer.Option(help="cell file")] = CELL,
    stl: Annotated[Path, typer.Option("--blade", help="the blade's STL")] = BLADE,
    quick: Annotated[bool, typer.Option(help="fewer passes and refinements")] = False,
) -> None:
    """Print the tables."""
    for name in tables or TABLES:
        print(f"== {name}", flush=True)
        TABLES[name](cell, stl, quick)


if __name__ == "__main__":
    typer.run(main)
