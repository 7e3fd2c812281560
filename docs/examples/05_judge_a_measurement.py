"""Judge a measurement before making it: choose poses, then list the smallest size of every effect that they would show."""

from pathlib import Path

from ocp.api import choose_poses, judge_measurement
from ocp.data import CELL


def main(out: Path, cell: Path = CELL, count: int = 30) -> str:
    """The table for `count` poses in `cell`."""
    chosen = choose_poses(cell, out=out / "poses", count=count)
    print(chosen.line)
    table = judge_measurement(cell, poses=chosen.folder / "poses.csv")
    print(table)
    return table


if __name__ == "__main__":
    main(Path("example_5"))
