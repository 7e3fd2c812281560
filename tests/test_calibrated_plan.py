"""A cell with a calibration, planned to the end: the written program holds its force on the calibrated cell."""

import json

import numpy as np
import pytest
from small_plan import STEP, planned, small_cell

from robots.calibration.store import Calibration, write_calibration
from robots.robot import load_robot

# About the size that a KR 210 and a hand-measured cell are off by (PHYSICS 2.6, FORMATS [wheel], [workpiece]).
OFF = {
    "th2": 5e-4, "th3": -6e-4, "a2": 4e-4, "al3": 5e-4, "d4": 3e-4, "wheel_x": 3e-4, "wheel_z": -3e-4,
    "wheel_axis_v": 8e-4, "blade_z": 3e-4, "blade_b": 8e-4, "cover_stiffness_scale": 0.1,
}  # fmt: skip


def calibration() -> Calibration:
    robot = load_robot("kr210_r2700_extra")
    nominal = dict(zip((f"{s}{i}" for i in range(1, 7) for s in ("th", "d", "a", "al", "be")), robot.mdh.ravel(), strict=True))
    values = np.array([nominal.get(name, 0.0) + off for name, off in OFF.items()])
    sd = np.array([2e-2 if "scale" in name else 3e-5 for name in OFF])
    return Calibration(robot.name, tuple(OFF), values, np.diag(sd**2), {})


def figures(folder) -> dict:
    return json.loads((folder / "plan" / "plan.json").read_text())


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    plain, calibrated = (tmp_path_factory.mktemp(name) for name in ("plain", "calibrated"))
    small_cell(plain)
    small_cell(calibrated, {'model = "kr210_r2700_extra"': 'model = "kr210_r2700_extra"\ncalibration = "calibration.toml"'})
    write_calibration(calibrated / "calibration.toml", calibration())
    for folder in (plain, calibrated):
        told = planned(folder, "--cell", "cell.toml", *STEP)
        assert told.code == 0, told.err
    return figures(plain), figures(calibrated)


def test_the_independent_route_sees_the_programmed_force_on_the_calibrated_cell(both):
    # Without the registration in the second route the force was 4 N off, and the plan was refused.
    assert both[1]["force_error_N"] < 0.1


def test_a_calibration_makes_the_force_surer(both):
    plain, calibrated = (b["force_sd_max_N"] for b in both)
    assert calibrated < 0.4 * plain
