"""Plan a blade: programs, table and report in one call, then the numbers behind them."""

from pathlib import Path

from ocp.api import Infeasible, PlanResult, plan
from ocp.data import BLADE, CELL


def main(out: Path, blade: Path = BLADE, cell: Path = CELL, step: float = 1e-3) -> PlanResult:
    """Plan `blade` in `cell` with waypoints `step` m apart; the folder `out` gets the programs."""
    try:
        result = plan(blade, cell=cell, out=out, step=step, progress=lambda phase, done, total: print(phase, done, total or ""))
    except Infeasible as reason:  # nothing was written
        print(f"no safe plan: {reason}")
        raise
    print(result.line)
    for one in result.plan.motion.passes:
        force, sd = one.solution.force, one.evaluation.force_sd
        path = one.problem.path
        print(f"line {path.line} ({path.side}): {force.min():.2f} to {force.max():.2f} N, one sigma up to {sd.max():.2f} N")
    return result


if __name__ == "__main__":
    main(Path("plan"))
