"""Calibrate from readings: a tracker campaign of a virtual robot, the arm fitted to it, and how good it is where it was not
fitted."""

from pathlib import Path

import numpy as np

from ocp.api import CalibrationResult, calibrate, simulate


def main(out: Path, poses: int = 40) -> CalibrationResult:
    """Measure virtual robot 2 in `poses` postures and calibrate it."""
    run = simulate(out=out / "run", seed=2, poses=poses)
    result = calibrate(run.folder / "tracker.csv", cell=run.folder / "cell.toml", out=out / "calibration")
    print(result.line)
    left_out = result.tracker.methods
    print(f"readings left out: {1e3 * left_out.before.mean():.3f} mm before, {1e3 * left_out.error['full'].mean():.3f} mm after")
    sd = np.sqrt(np.diag(result.calibration.covariance))
    for name, value, one_sigma in zip(result.calibration.names, result.calibration.values, sd, strict=True):
        print(f"{name:>6} {value: .6f} +- {one_sigma:.6f}")  # SI: metres, radians, rad/(N m)
    return result


if __name__ == "__main__":
    main(Path("example_2"))
