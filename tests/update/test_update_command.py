"""`python -m ocp.update` as a user meets it: what it writes, that other commands read it, what it refuses."""

import csv
import hashlib
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from ocp.api import UpdateResult, update
from ocp.calibrate.force.fit import FIT_NAMES
from ocp.model.cell import read_cell
from ocp.model.theta import believed_theta, registered
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.update.__main__ import app
from robots.calibration.store import read_calibration, write_calibration
from robots.errors import BadInput
from robots.pose import make_transform
from tests.support.all_postures import inverse_all
from tests.support.browser import NEEDED, looked_at
from tests.support.force_world import HEADER, arm_posterior, correlated, write_log
from tests.support.small_plan import called, environment, small_cell, tree

OVERLAP = 0.55e-3  # m that brings about 20 N on this wheel
STATED = ("[robot]\n", '[robot]\ncalibration = "calibration.toml"\n')


def taught(cell, path):
    """Joints (n, 6) of the believed, unbent arm that bring each waypoint to the wheel."""
    wheel = cell.wheel
    e = wheel.contact_direction
    frame = np.stack([-np.cross(wheel.axis, e), np.cross(-e, -np.cross(wheel.axis, e)), -e], axis=1)
    R = frame @ np.stack([path.t, np.cross(path.n, path.t), path.n], axis=2).transpose(0, 2, 1)
    at = wheel.centre + (wheel.radius - OVERLAP) * e - np.einsum("kij,kj->ki", R, path.p)
    usual = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0])
    near = [inverse_all(cell.robot, T).q for T in make_transform(R, at) @ np.linalg.inv(cell.workpiece.T_flange_blade)]
    return np.array([q[int(np.argmin(np.abs(q - usual).max(axis=1)))] for q in near])


def write_blade_log(path: Path, cell, pass_, force: float, begin: float, rng) -> Path:
    """A pass under `force` N from clock `begin` s on, and the same pass in the air."""
    q, n = taught(cell, pass_), len(pass_.s)
    rows = []
    for contact, k in ((c, k) for c in (1, 0) for k in range(n)):
        if k == 0:
            fn = contact * force + correlated(rng, n)
        place = [*(1e3 * pass_.p[k]), *pass_.n[k], *pass_.t[k]]
        joints = [f"{a:.6f}" for a in np.degrees(q[k])]
        given = [20.0, 40.0, 20.0, pass_.line, contact, f"{fn[k]:.4f}", f"{begin + 0.05 * k + 60 * (1 - contact):.3f}"]
        rows.append([1 - contact, f"{0.05 * k:.3f}", *joints, *(f"{x:.6f}" for x in place), *given])
    return write_log(path, rows, [*HEADER, "clock_s"])


@pytest.fixture(scope="module")
def done(solved_once, tmp_path_factory):
    """A cell with a calibrated arm, its first two updates through the interface, the first with measured depths."""
    folder = tmp_path_factory.mktemp("update")
    file = small_cell(folder, dict([STATED]))
    write_calibration(folder / "calibration.toml", arm_posterior(read_cell(small_cell(folder / "plain"))))
    cell = read_cell(file)
    line = lay_paths(cell, cell.workpiece.stl, PlanOptions(step=2e-3)).paths[0]
    rng = np.random.default_rng(4)
    write_blade_log(folder / "force.csv", cell, line, 20.4, 100.0, rng)
    write_blade_log(folder / "next.csv", cell, line, 20.3, 700.0, rng)
    middle = range(4, len(line.s) - 4, 3)
    with (folder / "removal.csv").open("w", newline="") as out:
        depths = [[*(1e3 * line.p[k]).round(5), 21.0 + 0.3 * rng.normal(), 1.0] for k in middle]
        csv.writer(out).writerows([["px_mm", "py_mm", "pz_mm", "removal_um", "sd_um"], *depths])
    first = update(folder / "force.csv", cell=file, removal=folder / "removal.csv", out=folder / "first")
    second = update(folder / "next.csv", cell=folder / "first" / "cell.toml", out=folder / "second")
    return SimpleNamespace(folder=folder, first=first, second=second)


def test_the_command_itself_starts_and_refuses(tmp_path):
    command = [sys.executable, "-m", "ocp.update", "none.csv", "--cell", "none.toml"]
    told = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=280)
    assert told.returncode == 2 and "none.toml" in told.stderr and told.stderr.count("\n") == 1 and not told.stdout


@NEEDED
def test_its_page_stands_in_a_browser(done):
    looked_at(done.folder / "second" / "report.html")


def test_the_folder_holds_cell_calibration_and_report(done):
    assert isinstance(done.first, UpdateResult)
    names = {p.name for p in (done.folder / "first").iterdir()}
    assert names == {".written.json", "cell.toml", "calibration.toml", "calibration.npz", "report.html"}
    assert "is the cell for it, for ocp.plan" in done.first.line and "\n" not in done.first.line
    page = (done.folder / "first" / "report.html").read_text()
    for heading in ("What moved", "Forecast", "Depth", "Process model", "Made from"):
        assert heading in page
    assert "zero-point clamps repeat" in page


def test_the_planner_reads_wheel_blade_and_flange_from_it(done):
    cell = read_cell(done.folder / "first" / "cell.toml")
    written = read_calibration(done.folder / "first" / "calibration.toml")
    assert set(written.names) == {*FIT_NAMES, "wheel_wear"}
    theta = believed_theta(cell)
    np.testing.assert_allclose(theta.values, [written.values[written.names.index(n)] for n in FIT_NAMES[:-1]])
    assert registered(cell)[0].wheel.radius != cell.wheel.radius
    assert cell.process.preston == pytest.approx(done.first.made.preston.value, rel=1e-5)
    assert 0 < cell.process.preston_sd < 0.1 * cell.process.preston


def test_the_force_is_known_after_it(done):
    latest = done.first.made.latest
    assert latest["expected_sd_N"] > 1.5 and latest["found_sd_N"] < 0.25
    assert latest["found_N"] == pytest.approx(latest["measured_N"], abs=0.1)


def test_the_second_update_begins_where_the_first_ended(done):
    history = done.second.made.history
    assert len(history) == 2 and history.ends > 700 and len(history.logs) == 2
    first, second = (one.calibration.provenance["force"]["recordings"] for one in (done.first, done.second))
    assert first and first == second != history.logs[1]  # what a calibration was made from is known however often it is updated
    assert done.second.made.latest["expected_sd_N"] < 1.2 < done.first.made.latest["expected_sd_N"]
    before, now = done.first.made.preston, done.second.made.preston
    assert now.value == pytest.approx(before.value, rel=1e-5) and now.sd > 1.02 * before.sd and now.points == 0


def test_a_log_is_used_once(done):
    with pytest.raises(BadInput, match="an earlier update used recordings of this log"):
        update(done.folder / "next.csv", cell=done.folder / "second" / "cell.toml", out=done.folder / "third")
    lines = (done.folder / "next.csv").read_bytes().replace(b"\r\n", b"\n")
    (done.folder / "unix.csv").write_bytes(lines)
    assert lines != (done.folder / "next.csv").read_bytes()
    with pytest.raises(BadInput, match="an earlier update used recordings of this log"):
        update(done.folder / "unix.csv", cell=done.folder / "second" / "cell.toml", out=done.folder / "third")
    # A calibration says by what files it was made.
    other, known = done.folder / "other.csv", done.folder / "known"
    other.write_bytes(lines.replace(b"20.", b"19."))
    shutil.copytree(done.folder / "second", known)
    calibration = read_calibration(known / "calibration.toml")
    told = calibration.provenance | {"data_sha256": {"force.csv": hashlib.sha256(other.read_bytes()).hexdigest()}}
    write_calibration(known / "calibration.toml", replace(calibration, provenance=told))
    with pytest.raises(BadInput, match="the cell was calibrated with recordings of this log"):
        update(other, cell=known / "cell.toml", out=done.folder / "third")
    assert not (done.folder / "third").exists()


def test_a_second_run_writes_the_same_bytes(done):
    again = update(
        done.folder / "force.csv", cell=done.folder / "cell.toml", removal=done.folder / "removal.csv", out=done.folder / "first2"
    )
    assert tree(again.folder) == tree(done.folder / "first")


def spoilt(folder: Path, done, name: str, old: str, new: str, count: int = 1) -> Path:
    text = (done.folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, count))
    return folder / name


def test_bad_input_is_one_sentence_and_nothing_is_written(done, tmp_path):
    cell, log = str(done.folder / "cell.toml"), str(done.folder / "force.csv")
    (tmp_path / "removal.csv").write_text("px_mm,py_mm,pz_mm,removal_um,sd_um\n0,0,900,20,1\n")
    cases = [
        ((log, "--cell", cell, "--changed", "belts"), "--changed belts: is none of wheel, blade, flange, belt, sensor"),
        ((str(tmp_path / "none.csv"), "--cell", cell), "none.csv: cannot be read"),
        ((log, "--cell", str(tmp_path / "none.toml")), "none.toml"),
        ((log, "--cell", cell, "--removal", str(tmp_path / "none.csv")), "none.csv: cannot be read"),
        ((log, "--cell", cell, "--removal", str(tmp_path / "removal.csv")), "removal.csv, line 2, columns px_mm, py_mm, pz_mm"),
        ((str(done.folder), "--cell", cell), "cannot be read"),
        ((str(spoilt(tmp_path, done, "force.csv", "fn_N", "fm_N")), "--cell", cell), "fn_N"),
    ]
    for arguments, said in cases:
        answer = called(app, tmp_path, *arguments)
        assert answer.code == 2 and answer.out == "", (arguments, answer.err)
        assert said in answer.err and answer.err.count("\n") == 1, answer.err
        assert not (tmp_path / "update").exists()


def test_a_night_of_blades_is_logged_in_one_cell(done, tmp_path):
    """The cell names the first blade, or none; the log is of another, whose file is handed in."""
    cell = done.folder / "first" / "cell.toml"
    named = next(line for line in cell.read_text().splitlines() if line.startswith("stl = "))
    turned = trimesh.load(read_cell(cell).workpiece.stl)
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [0, 0, 1]))
    turned.export(tmp_path / "other.stl")
    other = done.folder / "first" / "other.toml"
    other.write_text(cell.read_text().replace(named, f'stl = "{tmp_path}/other.stl"'))
    answer = called(app, tmp_path, done.folder / "next.csv", "--cell", other)
    assert answer.code == 2 and "is it the same blade" in answer.err, answer.err
    made = update(done.folder / "next.csv", cell=other, blade=read_cell(cell).workpiece.stl, out=tmp_path / "second")
    np.testing.assert_array_equal(made.calibration.values, done.second.calibration.values)
    assert read_cell(tmp_path / "second" / "cell.toml").workpiece.stl.name == "other.stl"


def test_a_log_that_cannot_be_of_this_cell_is_said(done, tmp_path):
    """The second cell knows the force to half a newton; a blade that reads 4.5 N more was ground by another state."""
    with (done.folder / "next.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["fn_N"] = f"{float(row['fn_N']) + 4.5 * int(row['contact']):.4f}"
        row["clock_s"] = f"{float(row['clock_s']) + 600.0:.3f}"
    with (tmp_path / "off.csv").open("w", newline="") as out:
        writer = csv.DictWriter(out, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    answer = called(app, tmp_path, "off.csv", "--cell", done.folder / "second" / "cell.toml")
    assert answer.code == 1 and answer.err.startswith("not updated, nothing written"), answer.err
    assert "cannot have come from the cell as last known" in answer.err and not (tmp_path / "update").exists()
    answer = called(app, tmp_path, "off.csv", "--cell", done.folder / "second" / "cell.toml", "--changed", "wheel")
    assert answer.code == 0, answer.err
    assert answer.out.startswith("update: ") and answer.out.count("\n") == 1


def test_runs_that_no_flange_cell_has_are_refused(done, tmp_path):
    """A force ladder without its setpoints: in the mean it is what a cell that hardly knows its wheel expects."""
    with (done.folder / "next.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["contact"] == "1"]
    with (tmp_path / "ladder.csv").open("w", newline="") as out:
        writer = csv.DictWriter(out, rows[0])
        writer.writeheader()
        for run, force in enumerate((16.5, 23.5, 16.5, 23.5)):
            read = force + correlated(np.random.default_rng(run), len(rows))
            clock = [float(row["clock_s"]) + 600.0 * run for row in rows]
            writer.writerows(r | {"run": run, "fn_N": f, "clock_s": c} for r, f, c in zip(rows, read, clock, strict=True))
    answer = called(app, tmp_path, "ladder.csv", "--cell", done.folder / "cell.toml")
    assert answer.code == 1 and "which no flange cell does" in answer.err and not (tmp_path / "update").exists(), answer.err
