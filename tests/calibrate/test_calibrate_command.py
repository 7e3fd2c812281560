"""`python -m ocp.calibrate` as a user meets it: what it writes, what it refuses, and that the planner takes it."""

import csv
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.calibrate.__main__ import app
from ocp.calibrate.interface import _use
from ocp.model.cell import read_cell
from ocp.model.theta import NAMES, believed_theta
from robots.calibration.store import read_calibration
from robots.robot import load_robot
from robots.tracker_readings import Readings
from tests.support.formats import PAGE, told_keys
from tests.support.simulated_campaign import campaign_readings, measured, random_truth
from tests.support.small_plan import TEXT, Told, called, environment, tree


def write_readings(path: Path, readings: Readings, sealed: bool = False) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        points = [] if sealed else ["x_mm", "y_mm", "z_mm"]
        axes = [f"{stem}{i}{unit}" for stem, unit in (("q", "_deg"), ("approach", "")) for i in range(1, 7)]
        writer.writerow(["target", "payload", *axes, *points])
        for k in range(len(readings)):
            xyz = [] if sealed else [f"{1e3 * x:.4f}" for x in readings.point[k]]
            names = readings.targets[readings.target[k]], readings.payloads[readings.payload[k]]
            assert readings.approach is not None
            q, approach = (f"{np.degrees(x):.6f}" for x in readings.q[k]), (int(a) for a in readings.approach[k])
            writer.writerow([*names, *q, *approach, *xyz])


def folder_with_campaign(folder: Path, n: int = 45) -> Path:
    rng = np.random.default_rng(21)
    truth = random_truth(rng)
    readings, fresh = measured(truth, campaign_readings(rng, n), rng), campaign_readings(rng, 10)
    write_readings(folder / "tracker.csv", readings)
    write_readings(folder / "sealed_tracker.csv", fresh, sealed=True)
    np.save(folder / "truth.npy", truth.points(fresh))
    (folder / "cell.toml").write_text(TEXT)
    return folder


def run(folder: Path, *arguments: str) -> Told:
    return called(app, folder, *arguments)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = folder_with_campaign(tmp_path_factory.mktemp("campaign"))
    command = [sys.executable, "-m", "ocp.calibrate", "tracker.csv", "--cell", "cell.toml"]
    told = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, timeout=280)
    return folder, Told(told.returncode, told.stdout, told.stderr)


def test_the_last_line_says_what_came_out(done):
    folder, told = done
    assert told.code == 0, told.err
    assert told.out.count("\n") == 1 and told.out.startswith("calibration: 45 readings by method full")
    assert all(line.startswith("note: ") for line in told.err.splitlines())
    names = {p.name for p in (folder / "calibration").iterdir()}
    assert names == {
        ".written.json",
        "calibration.toml",
        "calibration.npz",
        "cell.toml",
        "residuals.csv",
        "predictions_tracker.csv",
        "report.html",
        "report.pdf",
    }


def test_the_planner_takes_the_calibration_with_all_of_its_covariance(done):
    folder = done[0]
    calibration = read_calibration(folder / "calibration" / "calibration.toml")
    assert {"th1", "a2", "be6", "c2", "c3", "base_x", "base_a"} <= set(calibration.names)
    document = tomllib.loads((folder / "calibration" / "calibration.toml").read_text())
    assert set(document) == {name.strip("[]").split(".")[0] for name in told_keys("calibration.toml")}
    assert set(calibration.provenance) <= set(re.findall("`(\\w+)`", PAGE.read_text().split("`[provenance]`")[1].splitlines()[0]))
    assert "th1" in calibration.not_identified and calibration.provenance["method"] == "full"
    before, after = (believed_theta(read_cell(folder / f, "b.stl")) for f in ("cell.toml", "calibration/cell.toml"))
    a2 = NAMES.index("a2")
    assert after.values[a2] != before.values[a2] and after.covariance[a2, a2] < 0.1 * before.covariance[a2, a2]


def test_residuals_stand_in_the_columns_that_are_told(done):
    with (done[0] / "calibration" / "residuals.csv").open(newline="") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert [row["line"] for row in rows] == list(range(2, 47))
    for row in rows:
        assert np.hypot(np.hypot(row["dx_mm"], row["dy_mm"]), row["dz_mm"]) == pytest.approx(row["after_mm"], abs=2e-5)
    assert np.mean([row["before_mm"] for row in rows]) > 5 * np.mean([row["after_mm"] for row in rows])
    assert all(0 < row["weight"] <= 1.5 for row in rows)


def test_blind_predictions_are_near_the_truth_in_the_order_of_the_file(done):
    folder = done[0]
    with (folder / "calibration" / "predictions_tracker.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    points = 1e-3 * np.array([[float(row[f"baseline_{c}_mm"]) for c in "xyz"] for row in rows])
    truth = np.load(folder / "truth.npy")
    assert points.shape == truth.shape and np.linalg.norm(points - truth, axis=1).mean() < 5e-5


def test_equal_inputs_give_equal_bytes(done):
    folder = done[0]
    told = run(folder, "tracker.csv", "--cell", "cell.toml", "--out", "again")
    assert told.code == 0, told.err
    assert tree(folder / "again") == tree(folder / "calibration")


def refused(folder: Path, *arguments: str) -> str:
    before = tree(folder)
    told = run(folder, *arguments)
    assert told.code == 2 and told.out == "" and tree(folder) == before, told
    assert told.err.count("\n") == 1 and told.err.startswith("refused: "), told.err
    return told.err


def test_a_log_of_another_force_calibrates_nothing(shared_data, tmp_path, monkeypatch):
    for name in ("cell.toml", "blade.stl", "tracker.csv", "force.csv"):
        shutil.copy(shared_data / "worlds" / "force_no_effect" / name, tmp_path)
    apart = SimpleNamespace(run_offset=4.3, sigma=0.3)  # as twice the force leaves it (test_force_fit.py)
    monkeypatch.setattr("ocp.calibrate.interface.fit_force", lambda cell, log, robot: SimpleNamespace(log=log, figures=apart))
    before = tree(tmp_path)
    told = run(tmp_path, "tracker.csv", "--cell", "cell.toml", "--force", "force.csv")
    assert told.code == 1 and "which no flange cell does" in told.err and tree(tmp_path) == before, told


def test_bad_input_is_one_sentence_and_nothing_is_written(tmp_path):
    folder = folder_with_campaign(tmp_path)
    text = (folder / "tracker.csv").read_text()
    assert "cannot be read" in refused(folder, "none.csv", "--cell", "cell.toml")
    assert "is a folder; give the file in it" in refused(folder, ".", "--cell", "cell.toml")
    assert "--method" in refused(folder, "tracker.csv", "--cell", "cell.toml", "--method", "best")
    assert "force.csv" in refused(folder, "tracker.csv", "--cell", "cell.toml", "--force", "force.csv")
    (folder / "few.csv").write_text("\n".join(text.splitlines()[:8]))
    assert "too few" in refused(folder, "few.csv", "--cell", "cell.toml")
    (folder / "sealed_tracker.csv").write_text((folder / "sealed_tracker.csv").read_text().replace("T1", "T7"))
    assert "T7" in refused(folder, "tracker.csv", "--cell", "cell.toml")
    (folder / "sealed_tracker.csv").unlink()
    (folder / "sealed_tracker.csv").symlink_to("lost.csv")
    assert "sealed_tracker.csv" in refused(folder, "tracker.csv", "--cell", "cell.toml")


def test_a_method_that_gains_nothing_is_written_and_says_so(unprinted, tmp_path):
    folder = folder_with_campaign(tmp_path)
    told = run(folder, "tracker.csv", "--cell", "cell.toml", "--method", "relative-literal")
    assert told.code == 0 and "Nothing gained" in told.out, told
    assert (folder / "calibration" / "predictions_tracker.csv").is_file()


def test_campaigns_that_cannot_tell_anything_are_refused(tmp_path):
    folder = folder_with_campaign(tmp_path)
    header, *rows = (folder / "tracker.csv").read_text().splitlines()
    (folder / "same.csv").write_text("\n".join([header, *[rows[0]] * 20]))
    assert "line 3 repeats line 2 in axes and point to the last digit" in refused(folder, "same.csv", "--cell", "cell.toml")
    first, swept = rows[0].split(","), [header]
    for k, row in enumerate(rows):
        cells = row.split(",")
        cells[2:8] = [str(4 * k - 80), *first[3:8]]
        swept.append(",".join(cells))
    (folder / "swept.csv").write_text("\n".join(swept))
    assert "axes 2, 3, 4, 5, 6 never moved" in refused(folder, "swept.csv", "--cell", "cell.toml")
    stood = [f"{row},{'' if k == 7 else 'hall'}" for k, row in enumerate(rows)]
    (folder / "stood.csv").write_text("\n".join([f"{header},station", *stood]))
    assert "line 9, column station: '' has few readings (1), 4 are" in refused(folder, "stood.csv", "--cell", "cell.toml")


@pytest.mark.parametrize(("arm", "use"), [("kr210_r2700_extra", "for ocp.plan"), ("ur10", "for diagnosing the arm")])
def test_a_cell_is_for_planning_where_its_arm_can_be_planned(monkeypatch, arm, use):
    monkeypatch.setattr("ocp.calibrate.interface.doubts_about", lambda made: ())
    methods = SimpleNamespace(error={"own": np.full(9, 1e-4)}, gained=lambda method: (1e-3, 1e-4))
    setup = SimpleNamespace(robot=load_robot(arm), tables=SimpleNamespace(workpiece=object()))
    assert _use(SimpleNamespace(method="own", methods=methods, setup=setup), Path("out")).endswith(use)
