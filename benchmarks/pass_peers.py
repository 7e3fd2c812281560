"""One pass with the wheel's angle free: ours against Opti with Ipopt and Fatrop, Drake, mink and SciPy pose by pose.

`python benchmarks/pass_peers.py [--nodes 24] [--runs 1]`; full table: `--nodes 60 --runs 3`.

The middle line of the bundled blade's convex side at nominal rate, about `nodes` waypoints, one model (compliant arm,
wheel's law, blade), one start. In three groups:

* the same nonlinear program: ours (`PassSolver`, in CasADi's virtual machine and as machine code), and the same objective and
  rows typed in with CasADi's Opti, states (q, dq) and inputs a stage so that Fatrop sees its structure, by Ipopt and Fatrop,
  their options plain but for the tolerance 1e-6. They must agree: largest difference of the joints, and the objective over ours.
* pose by pose with the same model: SciPy's SLSQP with exact derivatives on each node's rows, near the pose before.
* what has no such model: mink (frame tasks, QP steps pose by pose) and Drake's KinematicTrajectoryOptimization (a B-spline of as
  many control points as waypoints, at which place and normal are held, squared speeds as cost, SNOPT). They get the poses of the
  start, whose overlap and aim already take the sagging arm into account; the turn about the normal is free, the place on the
  wheel not.

All are judged by the same model: largest miss of the contact force, and the objective over ours (smoothness, and the middles of
the freedoms). Building the program is timed apart from solving; medians of `runs`.
Ours pads a program to a multiple of 32 waypoints.
"""

import os
import tempfile
from collections.abc import Callable

import numpy as np
from pass_peer_runs import Joints, Pass, drake_spline, mink_steps, opti, slsqp
from peers import NotInstalled, arguments, head, measured, named, row

from ocp.plan.passes.solve import PassSolver


def main() -> None:
    options = arguments(__doc__, nodes=24, runs=1)
    with tempfile.TemporaryDirectory(prefix="pass_peers_") as folder:
        os.environ["GRINDPLAN_CACHE"] = folder  # without the machine code of earlier runs
        table(Pass(options.nodes), options.runs)


def table(job: Pass, runs: int) -> None:
    """All ways on one problem."""

    def ours() -> Callable[[], Joints]:
        solver = PassSolver(job.cell, job.solver.law, job.solver.theta, job.weights)
        solver.program(job.n)
        return lambda: solver.solve(job.problem).q

    def compiled() -> Callable[[], Joints]:
        job.solver.compile()
        return ours()

    ways: dict[str, tuple[str, Callable[[], Callable[[], Joints]]]] = {
        "ours, virtual machine": ("casadi", ours),
        "Opti, Ipopt": ("casadi", lambda: opti(job, "ipopt")),
        "Opti, Fatrop": ("casadi", lambda: opti(job, "fatrop")),
        "SciPy's SLSQP pose by pose": ("scipy", lambda: slsqp(job)),
        "mink pose by pose": ("mink", lambda: mink_steps(job)),
        "Drake, B-spline": ("drake", lambda: drake_spline(job)),
        "ours, machine code": ("casadi", compiled),
    }
    step = 1e3 * float(np.diff(job.problem.path.s).mean())
    print(f"line {job.problem.path.line}, {job.n} waypoints {step:.2f} mm apart, medians of {runs}")
    columns = ("way", "version", "building, processor s", "solving, wall s", "processor s", "force off by N")
    head((*columns, "objective over ours", "joints differ by, mrad"))
    first: tuple[Joints, float] | None = None
    for label, (package, build) in ways.items():
        try:
            told = named(package)
            solve, _, built = measured(build, 1)
            q, wall, processor = measured(solve, runs)
        except (NotInstalled, RuntimeError) as reason:
            row(label, str(reason).splitlines()[0])
            continue
        miss, objective = job.judged(q)
        first = first or (q, objective)
        row(label, told, built, wall, processor, miss, f"{objective / first[1]:.6f}", 1e3 * float(np.abs(q - first[0]).max()))


if __name__ == "__main__":
    main()
