"""`python -m ocp.plan` as a user meets it: what it writes, what it refuses, what it leaves behind."""

import csv
import json
import math
import os
import re
import shutil
import signal
import time
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

from ocp.data import BLADE
from ocp.plan.__main__ import _plan as command
from ocp.plan.__main__ import app
from ocp.plan.files import _renamed
from ocp.plan.interface import plan
from ocp.plan.night import plan_night
from ocp.plan.paths import PlanOptions
from ocp.shell.output import MARKER, write_marker
from robots.robot import load_robot
from tests.support import small_plan
from tests.support.formats import told_keys
from tests.support.small_plan import STEP, called, refused, small_cell, tree, undrawn
from trajectories.krl.checks import check_program
from trajectories.passes import PassOptions

COLUMNS = (
    "time_s line contact q1_deg q2_deg q3_deg q4_deg q5_deg q6_deg qd1_deg_s qd2_deg_s qd3_deg_s qd4_deg_s qd5_deg_s "
    "qd6_deg_s qdd1_deg_s2 qdd2_deg_s2 qdd3_deg_s2 qdd4_deg_s2 qdd5_deg_s2 qdd6_deg_s2 px_mm py_mm pz_mm nx ny nz tx ty tz "
    "s_mm feed_mm_s fn_N fn_sd_N interference_mm limit_ratio"
).split()
INJECTED = "x(); $OV_PRO=100 ;.stl"


@pytest.fixture(scope="module")
def small(small_plan_copy):
    """Folder in which the small plan was made, and what the command said."""
    return small_plan_copy


def table(plan: Path) -> dict[str, list[str]]:
    with (plan / "plan.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in rows[0]}


def numbers(column: list[str]) -> np.ndarray:
    return np.array([float(v) if v else math.nan for v in column])


def checked(plan: Path, absolute: bool = False):
    """The program in a plan folder through the independent checks."""
    robot = load_robot("kr210_r2700_extra")
    mains = [p for p in sorted(plan.glob("*.src")) if not re.search(r"_\d\d(_[A-Z])?$", p.stem)]
    assert len(mains) == 1
    return check_program(mains[0], robot, absolute)


def one_sentence(told, code: int) -> str:
    assert told.code == code, told
    assert told.out == ""
    text = told.err.strip()
    assert text and "\n" not in text and "Traceback" not in text, told.err
    return text


# -- a plan --------------------------------------------------------------------------------------------------------


def test_the_last_line_says_what_was_written_and_whether_it_is_safe(small):
    folder, told = small
    assert told.code == 0, told.err
    assert told.out.count("\n") == 1 and told.out.startswith("plan: ")
    assert "safe to" in told.out and "plan/report.html" in told.out and "\x1b" not in told.out
    assert all(line.startswith("note: ") for line in told.err.splitlines())
    assert sorted(p.name for p in folder.iterdir()) == ["blade.stl", "cell.toml", "plan"]


def test_the_folder_holds_programs_in_pairs_table_summary_and_reports(small):
    plan = small[0] / "plan"
    sources = sorted(p.stem for p in plan.glob("*.src"))
    assert sources == sorted(p.stem for p in plan.glob("*.dat")) and len(sources) >= 3
    others = {p.name for p in plan.iterdir() if p.suffix not in (".src", ".dat") and p.name != MARKER}
    assert others == {"plan.csv", "plan.json", "report.html", "report.pdf"}
    assert (plan / "report.pdf").read_bytes().startswith(b"%PDF-")
    assert "</html>" in (plan / "report.html").read_text(encoding="utf-8")
    content = json.loads((plan / "plan.json").read_text())
    assert set(content) <= told_keys("plan.json")
    assert content["status"] == "safe" and content["force_error_N"] <= 0.2
    assert {entry["role"] for entry in content["inputs"]} == {"cell", "blade"}
    assert sorted(content["files"]) == sorted(f"{s}{end}" for s in sources for end in (".src", ".dat"))


def test_the_summary_tells_what_it_promises_and_what_is_left_out(small):
    """The bundled cell is not calibrated: moving is safe, the force amber."""
    content = json.loads((small[0] / "plan" / "plan.json").read_text())
    move, force = (content["grades"][name] for name in ("move", "force"))
    assert move["grade"] == "green" and force["grade"] == "amber" and "calibrate: ocp.poses" in force["why"]
    assert content["verdict"].startswith("It is safe to move (green): ") and "It may miss 20 N (amber): " in content["verdict"]
    assert content["left_out"] == []
    page = (small[0] / "plan" / "report.html").read_text(encoding="utf-8")
    assert "How the force was verified" in page and "verdict doubtful" in page and ">Left out<" not in page


def test_every_row_of_the_table_holds_force_and_limits(small):
    rows = table(small[0] / "plan")
    assert set(COLUMNS) <= set(rows)
    contact = np.array([v == "1" for v in rows["contact"]])
    force = numbers(rows["fn_N"])
    assert contact.any() and not contact.all()
    grinding = np.array([v == "pass" for v in rows["phase"]])
    assert np.abs(force[grinding] - 20.0).max() <= 0.2 and force[contact].max() <= 25.0
    assert np.isnan(force[~contact]).all()
    assert 0.0 < numbers(rows["limit_ratio"]).max() <= 1.0
    assert {"removal_rel", "d_normal_mm", "d_feed_mm", "d_lateral_mm"} <= set(rows) and "removal_um" not in rows
    assert np.isfinite(numbers(rows["removal_rel"])[contact]).all() and np.isnan(numbers(rows["removal_rel"])[~contact]).all()
    d = np.column_stack([numbers(rows[f"d_{axis}_mm"])[contact] for axis in ("normal", "feed", "lateral")])
    assert 0.05 < np.linalg.norm(d, axis=1).mean() < 3.0  # weight bends the arm, and nobody told the controller
    told = re.search(
        r"feeds are \d+ to (\d+) mm/s", " ".join(json.loads((small[0] / "plan" / "plan.json").read_text())["notices"])
    )
    assert told is not None and numbers(rows["feed_mm_s"])[contact].max() <= float(told[1]) + 0.5
    seconds = numbers(rows["time_s"])
    assert seconds[0] == 0.0 and (np.diff(seconds) >= 0).all()
    n = np.column_stack([numbers(rows[c])[contact] for c in ("nx", "ny", "nz")])
    t = np.column_stack([numbers(rows[c])[contact] for c in ("tx", "ty", "tz")])
    assert np.abs(np.linalg.norm(n, axis=1) - 1).max() < 1e-6
    assert np.abs((n * t).sum(axis=1)).max() < 1e-2


def test_speeds_in_the_table_are_the_derivative_of_its_joints(small):
    rows = table(small[0] / "plan")
    seconds = numbers(rows["time_s"])
    for axis in range(1, 7):
        q, qd, qdd = (numbers(rows[f"{name}{axis}_deg{unit}"]) for name, unit in (("q", ""), ("qd", "_s"), ("qdd", "_s2")))
        dt = np.diff(seconds)
        short = (dt > 1e-3) & (dt < 0.2)
        # Hermite's rule: the step of a smooth curve from speeds and accelerations at both ends, error of order dt^5.
        step = 0.5 * dt * (qd[1:] + qd[:-1]) + dt**2 / 12 * (qdd[:-1] - qdd[1:])
        assert np.abs(np.diff(q) - step)[short].max() < 0.02
        assert np.abs(np.diff(q))[dt <= 1e-6].max(initial=0.0) < 1e-5


def test_the_program_stands_the_independent_checks_and_ends_where_it_began(small):
    execution = checked(small[0] / "plan")
    q = [s.q for s in execution.segments if s.q is not None]
    np.testing.assert_allclose(q[0][0], q[-1][-1], atol=1e-6)


# -- kinds, names, folders -----------------------------------------------------------------------------------------


def test_a_blade_named_like_a_statement_gives_a_harmless_cartesian_program(small, unprinted, tmp_path):
    cell = small_cell(tmp_path, blade=False)
    shutil.copy(BLADE, tmp_path / INJECTED)
    told = called(app, tmp_path, INJECTED, "--cell", cell.name, *STEP, "--kind", "cartesian")
    assert told.code == 0, told.err
    checked(tmp_path / "plan")
    programs = [p for p in (tmp_path / "plan").iterdir() if p.suffix in (".src", ".dat")]
    for file in programs:
        assert re.fullmatch(r"[A-Z][A-Z0-9_]{0,23}\.(src|dat)", file.name)
        for line in file.read_text(encoding="ascii").splitlines():
            own = re.fullmatch(r"\$(VEL|ACC)_AXIS\[\d\]=100", line)
            assert "$OV_PRO" not in line and ("=100" not in line or own) and "x()" not in line.lower()
    passes = [text for p in programs if "; pass" in (text := p.read_text())]
    assert passes and all(len(re.findall(r"(?m)^SPLINE$", text)) == 1 and "#TCP" in text for text in passes)
    assert not re.search(r"(?m)^PTP (?!\{A1)|^LIN ", "".join(passes)) and "It is safe to move (green)" in told.out
    assert "<script>x" not in (tmp_path / "plan" / "report.html").read_text(encoding="utf-8")


def test_a_program_of_another_name_than_asked_for_is_told():
    """Blades whose long names begin alike would have one program on the controller."""
    for name, program in (("blade.stl", "BLADE"), ("rotor 3-a.stl", "ROTOR_3_A"), ("V2.1", "V2_1"), ("V2.1.stl", "V2_1")):
        assert _renamed(name, program) == ()
    for name, program in (("1abc", "P1ABC"), ("stage_3_of_the_turbine_left.stl", "STAGE_3_OF_THE_TURBINE"), ("Ω.stl", "PROGRAM")):
        assert f"called {program};" in _renamed(name, program)[0]


def test_classic_lines_replace_an_old_folder_only_when_asked(small, tmp_path):
    cell = small_cell(tmp_path)
    (tmp_path / "plan").mkdir()
    (tmp_path / "plan" / "old.txt").write_text("of an earlier run")
    write_marker(tmp_path / "plan")
    before = tree(tmp_path)
    text = one_sentence(refused("--cell", str(cell), "--out", str(tmp_path / "plan")), 2)
    assert "not empty" in text and "--overwrite" in text
    assert tree(tmp_path) == before
    (tmp_path / "plan" / "notes.txt").write_text("mine")
    assert "notes.txt" in one_sentence(refused("--cell", str(cell), "--out", str(tmp_path / "plan"), "--overwrite"), 2)
    (tmp_path / "plan" / "notes.txt").unlink()
    with undrawn():
        told = called(app, tmp_path, "--cell", cell.name, *STEP, "--kind", "lin", "--overwrite")
    assert told.code == 0, told.err
    checked(tmp_path / "plan")
    assert not (tmp_path / "plan" / "old.txt").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["blade.stl", "cell.toml", "plan"]
    text = "".join(p.read_text() for p in (tmp_path / "plan").glob("*_0*.src"))
    assert re.search(r"(?m)^ *LIN ", text) and "C_VEL" in text and "SPLINE" not in text
    rests = len(re.findall(r"(?m)^LIN (?!.*C_VEL)", text))
    assert rests == len(re.findall("(?m)^; pass$", text)) > 0 and "rests" not in told.out
    summary = json.loads((tmp_path / "plan" / "plan.json").read_text())["summary"]
    assert summary["Duration, of it in contact"].endswith(
        "of the planned motion: the program travels by slow PTP and takes longer"
    )
    off = re.search(
        r"blend are off by up to ([\d.]+) N on the ramps of a pass and by up to ([\d.]+) % in force over feed", told.out
    )
    assert off is None or (float(off[1]) < 0.2 and float(off[2]) < 8.0)  # measured, here about where green ends


def test_a_folder_that_cannot_be_written_is_refused_before_any_work(tmp_path):
    cell = small_cell(tmp_path)
    (tmp_path / "file").write_text("no folder")
    for out in ("file", "file/plan"):
        before = tree(tmp_path)
        assert str(tmp_path / out) in one_sentence(refused("--cell", str(cell), "--out", str(tmp_path / out)), 2)
        assert tree(tmp_path) == before


def test_a_wheel_out_of_reach_is_no_bad_input_but_no_plan_either(small, tmp_path, monkeypatch):
    cell = small_cell(tmp_path, {"centre_mm = [1700, 0, 900]": "centre_mm = [9000, 0, 900]"})
    monkeypatch.chdir(tmp_path)
    text = one_sentence(refused("--cell", str(cell), *STEP), 1)
    assert "line " in text and "nothing written" in text
    assert sorted(p.name for p in tmp_path.iterdir()) == ["blade.stl", "cell.toml"]


def workers(session: int) -> list[str]:
    """Command lines of the living processes of a session (Linux)."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
            if int(fields[3]) == session and fields[0] != "Z":
                found.append((stat.parent / "cmdline").read_text().replace("\0", " "))
        except OSError:
            continue
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes through /proc")
@pytest.mark.parametrize("moment", ["while workers are at it", "while the folder is written"])
def test_an_interrupt_leaves_nothing_behind(small, tmp_path, moment, every_core):
    cell = small_cell(tmp_path)
    process = small_plan.started(tmp_path, "--cell", cell.name, *STEP, "--name", "other")  # not kept whole: the work is done
    end = time.monotonic() + 120
    while process.poll() is None and time.monotonic() < end:
        written = list(tmp_path.glob(".plan.*"))
        forked = sum("forkserver" in line for line in workers(process.pid))  # with what they are forked off
        if written if "folder" in moment else forked > 1:
            break
        time.sleep(0.02)
    assert process.poll() is None, "the command was over before it could be interrupted"
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert out == "" and err.strip() == "interrupted, nothing written"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["blade.stl", "cell.toml"]
    assert not any(workers(process.pid))  # an empty line is a process that is just ending


def test_every_way_to_a_plan_lays_waypoints_as_far_apart():
    asked = (plan, plan_night, PlanOptions, PassOptions)
    assert {signature(one).parameters["step"].default for one in asked} == {1e-3}
    assert signature(command).parameters["step"].default == 1.0  # mm
