"""Rehearse a plan: the force that a virtual cell with real errors would show, and where it is worst."""

from pathlib import Path

from ocp.api import SimulationResult, plan, simulate
from ocp.data import BLADE, CELL


def main(out: Path, made: Path | None = None, blade: Path = BLADE, cell: Path = CELL) -> SimulationResult:
    """Rehearse the plan in the folder `made` (None: one is made first) on virtual cell 3."""
    if made is None:
        made = plan(blade, cell=cell, out=out / "plan").folder
    result = simulate(made, cell=cell, out=out / "run", seed=3, poses=0, ladder=(), air=False)
    print(result.line)
    assert result.rehearsal is not None
    for place in result.rehearsal.worst:
        print(f"line {place.line}, {1e3 * place.s:.0f} mm along it: {place.force:.1f} N, mostly {place.cause}")
    return result


if __name__ == "__main__":
    main(Path("example_3"))
