"""A cell that believes something already is calibrated again: its effects leave the readings, its wheel and blade stay; and what
bends in the fit bends in the plan."""

import csv
import shutil
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from ocp.calibrate import interface
from ocp.calibrate.interface import calibrate, tracker_calibration
from ocp.calibrate.tracker import calibrate_tracker
from ocp.diagnose.answering import tracker_channel
from ocp.diagnose.corrected import calibration_of
from ocp.diagnose.dataset import read_data_set
from ocp.model.cell import with_calibration
from ocp.model.force_balance import build_model
from ocp.model.theta import believed_theta
from ocp.shell.progress import Phases
from robots.calibration.store import Calibration, read_calibration, write_calibration
from robots.errors import BadInput, Infeasible
from robots.gravity import weight_torques
from tests.support.calibration_example import write_campaign
from tests.support.example_pass import LineLaw, bundled_cell

pytestmark = pytest.mark.usefixtures("unprinted")

SCALE = 4e-4


def scaled(path, scale):
    """The readings of an arm whose encoder of joint 3 counts too little, by a tracker that measures too far."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["q3_deg"] = f"{float(row['q3_deg']) / (1 + scale):.9f}"
        row |= {key: f"{float(row[key]) * (1 + scale):.6f}" for key in ("x_mm", "y_mm", "z_mm")}
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def test_a_believed_effect_leaves_the_readings(tmp_path):
    readings, cell = write_campaign(tmp_path), tmp_path / "cell.toml"
    sound = calibrate_tracker(readings, cell, "full", Phases())
    scaled(readings, SCALE)
    shutil.copyfile(readings, tmp_path / "sealed_tracker.csv")
    wrong = calibrate_tracker(readings, cell, "full", Phases())
    with cell.open("a") as file:
        file.write(f'[[effects]]\neffect = "encoder_scale"\njoint = 3\nscale = {SCALE}\n')
        file.write(f'[[effects]]\neffect = "tracker_scale"\nscale = {SCALE}\n')
    made = calibrate_tracker(readings, cell, "full", Phases())
    assert np.abs(made.fit.state.arm - sound.fit.state.arm)[:30].max() < 2e-6
    assert np.abs(wrong.fit.state.arm - sound.fit.state.arm)[:30].max() > 1e-4
    with readings.open(newline="") as file:
        measured = np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in csv.DictReader(file)])
    off = np.linalg.norm(1e3 * made.sealed_points - measured, axis=1)
    assert np.median(off) < 0.06 and any("encoder_scale of joint 3" in n for n in made.notices)


def test_without_a_log_wheel_and_blade_stay_as_they_were(unprinted, tmp_path):
    readings, cell = write_campaign(tmp_path), tmp_path / "cell.toml"
    known = Calibration("kr210_r2700_extra", ("th2", "wheel_x"), np.array([0.0, 2e-3]), np.diag([1e-8, 1e-8]))
    write_calibration(tmp_path / "before.toml", known)
    cell.write_text(cell.read_text().replace("[robot]", '[robot]\ncalibration = "before.toml"', 1))
    made = calibrate(readings, cell=cell, out=tmp_path / "out")
    again = read_calibration(tmp_path / "out" / "calibration.toml")
    assert again.values[again.names.index("wheel_x")] == pytest.approx(2e-3)
    assert any("wheel_x" in notice for notice in made.notices)


@pytest.mark.parametrize("others", [0.0, 1.0])
def test_a_corrected_arm_says_what_bends_and_keeps_the_wheel(tmp_path, others):
    """Readings alone, diagnosed: the arm that bends as the readings say, the wheel as it was found before."""
    listed = np.array([2.0e6, 3.3e6, 2.46e6, 0.5e6, 0.35e6, 0.30e6])
    write_campaign(tmp_path, springs=np.array([0, 1.1, 0.9, others, others, others]) / listed)
    known = Calibration("kr210_r2700_extra", ("th2", "wheel_x"), np.array([0.0, 2e-3]), np.diag([1e-8, 1e-8]))
    write_calibration(tmp_path / "before.toml", known)
    cell = tmp_path / "cell.toml"
    cell.write_text(cell.read_text().replace("[robot]", '[robot]\ncalibration = "before.toml"', 1))
    data = read_data_set(tmp_path)
    made = calibration_of({"tracker": tracker_channel(data)}, data)
    assert made.bending_joints == ((2, 3, 4, 5, 6) if others else (2, 3))
    assert made.values[made.names.index("wheel_x")] == pytest.approx(2e-3)


def test_what_bends_in_the_fit_bends_in_the_plan(tmp_path):
    """A calibration that found joint 5 bending holds with that spring only: planned without, the flange would lie elsewhere."""
    listed = tracker_calibration(calibrate_tracker(write_campaign(tmp_path), tmp_path / "cell.toml", "full", Phases()), [])
    assert listed.bending_joints == (2, 3)
    cell, c5 = bundled_cell(), 4e-6
    found = Calibration(cell.robot.name, ("c5",), np.array([c5]), np.eye(1), {"bending_joints": [2, 3, 5]})
    bent = with_calibration(cell, found)
    assert bent.compliant_joints == (2, 3, 5) and with_calibration(cell, None).compliant_joints == (2, 3)
    q = np.radians([10.0, -80.0, 95.0, 20.0, 40.0, -30.0])
    real = []
    for one in (bent, replace(bent, compliant_joints=(2, 3))):
        model, theta = build_model(one, LineLaw()), believed_theta(one).values
        real.append(np.array(ca.Function("q", [model.q, model.theta], [model.q_real])(q, theta)).ravel())
    piece = cell.workpiece.payload
    tau = weight_torques(cell.robot, real[0][None], piece.mass, piece.com)[0, 4]
    assert real[0][4] - q[4] == pytest.approx(c5 * tau, rel=1e-3) and abs(c5 * tau) > 5e-5
    assert real[1][4] == q[4]


@pytest.mark.parametrize("joints", ["[2, 7]", '"2, 3"', "[2.0]", "[true]"])
def test_joints_that_are_none_are_refused(tmp_path, joints):
    path = tmp_path / "c.toml"
    write_calibration(path, Calibration("r", ("d1",), np.zeros(1), np.eye(1)))
    path.write_text(path.read_text().rstrip() + f"\nbending_joints = {joints}\n")
    with pytest.raises(BadInput, match="bending_joints must be a list of joints 1 to 6"):
        read_calibration(path)


def test_a_calibration_that_is_worse_than_the_cells_own_is_not_written(tmp_path, monkeypatch):
    readings, cell = write_campaign(tmp_path), tmp_path / "cell.toml"
    first = calibrate(readings, cell=cell, out=tmp_path / "first")
    assert "doubts" not in first.line
    again = tmp_path / "first" / "cell.toml"
    assert calibrate(readings, cell=again, out=tmp_path / "again").folder.is_dir()
    with readings.open(newline="") as file:
        rows = list(csv.DictReader(file))[::2]
    noise = np.random.default_rng(1).normal(0.0, 0.2, (len(rows), 3))
    for row, off in zip(rows, noise, strict=True):
        row |= {f"{c}_mm": f"{float(row[f'{c}_mm']) + v:.6f}" for c, v in zip("xyz", off, strict=True)}
    with (tmp_path / "poor.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    with pytest.raises(Infeasible, match="by the calibration that the cell has already within"):
        calibrate(tmp_path / "poor.csv", cell=again, out=tmp_path / "worse")
    assert not (tmp_path / "worse").exists()
    monkeypatch.setattr(interface, "doubts_about", lambda _: ["It is odd."])
    line = calibrate(tmp_path / "poor.csv", cell=cell, out=tmp_path / "poor").line
    assert f"With doubts: It is odd. {tmp_path / 'poor' / 'cell.toml'} is the cell with it" in line
