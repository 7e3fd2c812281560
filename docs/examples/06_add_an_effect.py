"""Add an effect of your own: a file in a folder, named by GRINDPLAN_EFFECTS; planted in readings and found again.

An effect is one file that defines EFFECT: in ocp/effects it belongs to the catalogue, in a folder of yours every command finds it
beside the catalogue. own_effects/bent_scale.py is an encoder whose error grows with the square of the angle.
"""

import csv
import os
from pathlib import Path

import numpy as np

from ocp.api import DiagnosisResult, diagnose, simulate

SIZE = 2e-4  # 1/rad
OWN = Path(__file__).with_name("own_effects")


def plant(file: Path, joint: int) -> None:
    """Commanded angles c as if the scale of `joint` were bent: the robot that was measured stood at q = c + SIZE c^2."""
    with file.open(newline="") as source:
        rows = list(csv.DictReader(source))
    for row in rows:
        q = np.radians(float(row[f"q{joint}_deg"]))
        row[f"q{joint}_deg"] = f"{np.degrees((np.sqrt(1 + 4 * SIZE * q) - 1) / (2 * SIZE)):.6f}"
    with file.open("w", newline="") as target:
        table = csv.DictWriter(target, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def main(out: Path, poses: int = 60) -> DiagnosisResult:
    """Readings of a virtual robot, changed as a bent scale of joint 3 would, diagnosed with the new effect."""
    os.environ["GRINDPLAN_EFFECTS"] = str(OWN)
    run = simulate(out=out / "run", poses=poses, seed=5)
    plant(run.folder / "tracker.csv", joint=3)
    result = diagnose(run.folder, out=out / "diagnosis")
    print(result.line)
    return result


if __name__ == "__main__":
    main(Path("example_6"))
