"""After a blade: what its force log says of wheel, blade and flange, and the cell for the next one."""

from pathlib import Path

from ocp.api import UpdateResult, plan, simulate, update
from ocp.data import BLADE, CELL


def main(out: Path, ground: Path | None = None) -> UpdateResult:
    """Update the cell in the folder `ground` with the log there (None: a plan is made and ground on virtual cell 3 first)."""
    if ground is None:
        made = plan(BLADE, cell=CELL, out=out / "plan")
        ground = simulate(made.folder, cell=CELL, out=out / "run", seed=3, poses=0, ladder=()).folder
    result = update(ground / "force.csv", cell=ground / "cell.toml", out=out / "update")
    print(result.line)
    for blades, force, sd in result.made.forecast:
        print(f"the same program {blades} blades on: {force:.2f} +- {sd:.2f} N")
    return result


if __name__ == "__main__":
    main(Path("example_7"))
