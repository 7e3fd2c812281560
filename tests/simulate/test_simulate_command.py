"""`python -m ocp.simulate` as a user starts it: a small plan on virtual cells, what it writes, what it refuses."""

import csv
import errno
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.calibrate.force.log import read_force_log
from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.plan.planning import Job
from ocp.shell.cache import sha256
from ocp.shell.output import MARKER, whole_folder
from ocp.simulate.__main__ import app
from ocp.simulate.twin.dataset import copy_cell
from ocp.simulate.twin.truth import draw_truth
from ocp.update.removal import on_blade, read_removal
from robots.errors import BadInput
from robots.kinematics import forward
from robots.robot import CATALOGUE
from tests.support.browser import NEEDED, looked_at
from tests.support.formats import told_keys
from tests.support.geometry_robot import write_geometry_robot
from tests.support.small_plan import Told, called, environment, small_cell, tree

pytestmark = pytest.mark.usefixtures("unprinted")

COLUMNS = {
    "s_mm",
    "setpoint_N",
    "feed_mm_s",
    "belt_m_s",
    "line",
    "ground_before",
    "contact",
    "ft_N",
    "clock_s",
    "session",
    "temperature_C",
    "wheel_temperature_C",
}


def simulated(*arguments: str) -> Told:
    """The command in this process: meshes and wheels that one run solved serve the next."""
    return called(app, Path.cwd(), *arguments)


def one_sentence(told: Told, code: int, says: str) -> None:
    assert told.code == code and told.out == ""
    assert says in told.err and "Traceback" not in told.err
    assert len(told.err.strip().splitlines()) == 1


@pytest.fixture(scope="module")
def plan(small_plan_copy, solved_once) -> Path:
    """A plan of a few passes, with its cell beside it."""
    folder, told = small_plan_copy
    assert told.code == 0, told.err
    return folder / "plan"


@pytest.fixture(scope="module")
def run(plan, tmp_path_factory) -> tuple[Path, Told]:
    out = tmp_path_factory.mktemp("runs") / "run"
    told = simulated(plan, "--out", out, "--poses", "8", "--belt", "0,-20", "--joints")
    assert told.code == 0, told.err
    return out, told


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@NEEDED
def test_its_page_stands_in_a_browser(run):
    looked_at(run[0] / "rehearsal.html")


def test_a_run_writes_a_data_set_that_the_product_reads(run):
    out, told = run
    assert told.out.count("\n") == 1 and "nothing planted" in told.out and "rehearsal.html" in told.out
    assert {p.name for p in out.iterdir()} == {
        MARKER,
        "cell.toml",
        "blade.stl",
        "tracker.csv",
        "force.csv",
        "joints.csv",
        "removal.csv",
        "plan.csv",
        "rehearsal.html",
        "rehearsal.json",
        "labels",
    }
    log = read_force_log(out / "force.csv")
    assert not log.notices
    assert set(rows(out / "force.csv")[0]) >= COLUMNS
    assert sorted(set(log.setpoint)) == [12.0, 20.0, 28.0] and sorted(set(log.belt)) == [-20.0, 0.0, 20.0]
    assert (~log.contact).any() and np.abs(log.fn[~log.contact]).max() < 3.0
    assert np.abs(log.ft[log.belt == 0]).mean() < 0.5 and log.ft[(log.belt == -20) & log.contact].mean() < -3
    assert log.ground_before.max() >= 3 and np.all(np.diff(log.clock) > 0)
    level = [np.median(log.fn[(log.setpoint == s) & log.contact]) for s in (12.0, 20.0, 28.0)]
    assert 5.0 < level[1] - level[0] < 9.0 and 5.0 < level[2] - level[1] < 9.0
    assert len(rows(out / "tracker.csv")) == 24
    assert json.loads((out / "labels" / "labels.json").read_text())["labels"] == []
    removal = read_removal(out / "removal.csv")
    cell = read_cell(out / "cell.toml")
    on_blade(cell, removal)  # refuses what lies beside the surface
    process, speed = cell.process, cell.wheel.belt_speed
    even = draw_truth(cell, 0).preston * speed * process.force / (process.feed * process.pass_spacing)
    told = json.loads((out / "rehearsal.json").read_text())
    assert set(told) == told_keys("rehearsal.json")
    made = told["removal"]["machine"]
    assert len(removal.depth) > 100 and (removal.sd == 1e-6).all()
    assert removal.depth.max() < even * made["most"] + 5e-6 and removal.depth.min() > even * made["least"] - 5e-6
    joints = rows(out / "joints.csv")
    assert {"q1_deg", "link6_deg", "tau2_Nm"} <= set(joints[0])


def test_the_joints_logged_are_those_of_the_program(plan, run):
    planned_rows = [r for r in rows(plan / "plan.csv") if r["contact"] == "1"]
    q = np.array([[float(r[f"q{i}_deg"]) for i in range(1, 7)] for r in planned_rows])
    line = np.array([int(float(r["line"])) for r in planned_rows])
    start, step = (values[line[1:] == line[:-1]] for values in (q[:-1], np.diff(q, axis=0)))
    log = read_force_log(run[0] / "force.csv")
    for k in range(0, len(log), 37):  # against the straight pieces between waypoints
        away = np.degrees(log.q[k]) - start
        share = np.clip(np.sum(away * step, axis=1) / np.sum(step**2, axis=1), 0, 1)
        assert np.abs(away - share[:, None] * step).max(axis=1).min() < 0.05


def test_the_figures_told_are_those_of_the_force(run):
    out, told = run
    content = json.loads((out / "rehearsal.json").read_text())
    force = content["force"]
    assert f"{force['mean_N']:.2f} N on average" in told.out
    assert force["min_N"] < force["mean_N"] < force["max_N"]
    assert f"grinds for up to {content['contact']['outside_s']:.2f} s each" in told.out
    assert f"its deepest place has {content['removal']['machine']['most']:.2g} times that depth" in told.out
    log = read_force_log(out / "force.csv")
    first = (log.setpoint == 20.0) & (log.ground_before == 0) & log.contact
    first &= log.feed > 0.95 * log.feed[first].max()  # not on the ramps
    assert abs(np.median(log.fn[first]) - force["mean_N"]) < 0.5
    worst = content["worst"][0]
    parts = worst["parts_N"]
    assert sum(parts.values()) == pytest.approx(worst["force_N"] - force["goal_N"], abs=0.05)
    assert worst["mostly"] == max(parts, key=lambda name: parts[name] * sum(parts.values()))
    page = (out / "rehearsal.html").read_text()
    assert "<script" not in page and "http" not in page.replace("http-equiv", "")


def test_a_flange_that_moves_in_time_is_rehearsed(plan, run, tmp_path):
    """The same plan on the same machine, its flange in balance and in time: entries, exits and removal beside each other."""
    keys = "gravity_compensated = true\nbandwidth_hz = 10.0\ndelay_ms = 10.0\nfriction_N = 0.3"
    small_cell(tmp_path, {"gravity_compensated = true": keys})
    told = simulated(
        plan, "--cell", tmp_path / "cell.toml", "--out", tmp_path / "run", "--poses", 0, "--ladder", "none", "--no-air"
    )
    assert told.code == 0, told.err
    still, moving = (json.loads((out / "rehearsal.json").read_text()) for out in (run[0], tmp_path / "run"))
    for found in (still, moving):
        assert [p["line"] for p in found["contact"]["passes"]] == [p["line"] for p in found["lines"]]
        assert found["contact"]["peak_N"] == max(p["peak_N"] for p in found["contact"]["passes"]) < 60
        assert found["contact"]["contact_in_travel_s"] == 0.0
        assert found["removal"]["machine"]["ground_share"] > 0.5 and found["removal"]["plan"]["most"] < 3
    assert still["contact"]["losses"] == 0
    assert abs(moving["contact"]["peak_N"] - still["contact"]["peak_N"]) > 0.05
    assert moving["force"]["sd_N"] > 0.01 and moving["force"]["mean_N"] == pytest.approx(still["force"]["mean_N"], abs=0.5)
    pages = [(out / "rehearsal.html").read_text() for out in (run[0], tmp_path / "run")]
    assert all("Entry and exit" in page and "Removal" in page for page in pages)
    assert "in balance at every instant" in pages[0] and "carries 5 kg" in pages[1] and "10 ms late" in pages[1]


def test_lead_ins_and_setpoints_of_a_plan_are_followed(plan, run, tmp_path):
    """A plan that calls the first half of every pass a lead-in and sets 19 N: outside of the pass, and 1 N less on the spring, of
    which cover and arm give a tenth back."""
    folder = tmp_path / "plan"
    shutil.copytree(plan, folder)
    shutil.copy(plan.parent / "cell.toml", tmp_path)
    shutil.copy(plan.parent / "blade.stl", tmp_path)
    table, times = rows(folder / "plan.csv"), {}
    for row in table:
        if row["phase"] == "pass":
            times.setdefault(row["line"], []).append(float(row["time_s"]))
    middle = {line: np.mean([of[0], of[-1]]) for line, of in times.items()}
    for row in table:
        if row["phase"] == "pass" and float(row["time_s"]) < middle[row["line"]]:
            row["phase"] = "lead_in"
        row["setpoint_N"] = "19.0"
    with (folder / "plan.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, table[0])
        writer.writeheader()
        writer.writerows(table)
    told = simulated(folder, "--out", tmp_path / "run", "--poses", 0, "--ladder", "none", "--no-air")
    assert told.code == 0, told.err
    before, now = (json.loads((out / "rehearsal.json").read_text()) for out in (run[0], tmp_path / "run"))
    assert now["force"]["mean_N"] == pytest.approx(before["force"]["mean_N"] - 0.91, abs=0.08)
    more = max(now["contact"]["passes"][i]["outside_s"] - before["contact"]["passes"][i]["outside_s"] for i in range(len(times)))
    assert more == pytest.approx(max(0.5 * (of[-1] - of[0]) for of in times.values()), abs=0.1)
    assert {row["setpoint_N"] for row in rows(tmp_path / "run" / "force.csv")} == {"19"}


def test_the_believed_machine_grinds_as_planned(plan, tmp_path):
    """What the planner holds to 20 N gives 20 N on a machine of the same numbers that shares no code with it."""
    told = simulated(plan, "--out", tmp_path / "run", "--machine", "believed", "--poses", "0", "--ladder", "none", "--no-air")
    assert told.code == 0, told.err
    force = json.loads((tmp_path / "run" / "rehearsal.json").read_text())["force"]
    assert abs(force["mean_N"] - 20.0) < 0.4 and force["sd_N"] < 0.4 and force["within_1_N"] > 0.95
    assert not (tmp_path / "run" / "tracker.csv").exists()


def test_a_machine_as_believed_has_the_cells_own_effects_and_others_are_told(tmp_path):
    shown = '[[effects]]\neffect = "backlash"\njoint = 5\nhalf_width_rad = 4e-4\n'
    other = '[[effects]]\neffect = "payload_mass"\nkg = 1.5\npayload = "*"\n'
    for name, text in (("own", shown + other), ("none", "")):
        (tmp_path / f"{name}.toml").write_text(CELL.read_text() + text)
    shutil.copy(CELL.parent / "blade.stl", tmp_path)
    told = {}
    for name, more in (("own", ()), ("none", ("--effect", "backlash:5=4e-4"))):
        arguments = ("--machine", "believed", "--poses", "6", *more)
        told[name] = simulated("--cell", tmp_path / f"{name}.toml", "--out", tmp_path / name, *arguments)
        assert told[name].code == 0, told[name].err
    assert (tmp_path / "own" / "tracker.csv").read_bytes() == (tmp_path / "none" / "tracker.csv").read_bytes()
    assert "planted backlash:5 (half_width_rad=0.0004)" in told["own"].out
    assert "believes in payload_mass, and the virtual cell has nothing of it" in told["own"].err
    assert "believes in" not in told["none"].err
    # Two lines of one gear are two effects, and what is asked for comes on top.
    lines = "".join(
        f'[[effects]]\neffect = "gear_harmonic"\njoint = 4\norder = {k}\namplitude_rad = 5e-5\nphase_rad = 0.1\n'
        for k in (19, 38)
    )
    (tmp_path / "lines.toml").write_text(CELL.read_text() + lines)
    more = ("--machine", "believed", "--poses", "6", "--effect", "gear_harmonic:4=4e-5,order=7")
    both = simulated("--cell", tmp_path / "lines.toml", "--out", tmp_path / "lines", *more)
    assert both.code == 0 and all(f"order={k}" in both.out for k in (19, 38, 7)), both.err
    drawn = simulated("--cell", tmp_path / "own.toml", "--out", tmp_path / "drawn", "--poses", "6")
    assert "believes in backlash, payload_mass, and" in drawn.err and "nothing planted" in drawn.out


def test_the_same_seed_is_the_same_machine_and_an_effect_changes_nothing_else(plan, run, tmp_path):
    arguments = ("--poses", "8", "--ladder", "none", "--no-air")
    for name, more in (("a", ()), ("b", ("--seed", "1")), ("c", ("--effect", "sensor_bias=1.5"))):
        assert simulated(plan, "--out", tmp_path / name, *arguments, *more).code == 0
    assert (tmp_path / "a" / "tracker.csv").read_bytes() == (run[0] / "tracker.csv").read_bytes()
    assert (tmp_path / "b" / "tracker.csv").read_bytes() != (run[0] / "tracker.csv").read_bytes()
    a, c = (np.array([float(r["fn_N"]) for r in rows(tmp_path / name / "force.csv")]) for name in "ac")
    assert np.allclose(c - a, 1.5, atol=1e-3)


@pytest.mark.drawn
def test_two_runs_write_the_same_bytes(tmp_path):
    for name in "ab":
        assert simulated("--out", tmp_path / name, "--poses", "6", "--seed", "3").code == 0
    assert tree(tmp_path / "a") == tree(tmp_path / "b")


def test_what_is_sealed_is_not_told(plan, tmp_path):
    out = tmp_path / "run"
    told = simulated(plan, "--out", out, "--effects", "random:2", "--seed", "7", "--sealed", "--poses", "6", "--ladder", "20,26")
    assert told.code == 0, told.err
    labels = json.loads((out / "labels" / "labels.json").read_text())["labels"]
    assert len(labels) == 2
    openly = [p for p in out.rglob("*") if p.is_file() and "labels" not in p.parts]
    for label in labels:
        assert label["effect"] not in told.out + told.err
        assert not any(label["effect"].encode() in p.read_bytes() for p in openly)
    assert "fn_N" not in rows(out / "sealed_force.csv")[0] and "x_mm" not in rows(out / "sealed_tracker.csv")[0]
    truth = rows(out / "labels" / "sealed_force_truth.csv")
    assert len(truth) == len(rows(out / "sealed_force.csv")) and float(truth[12]["fn_N"]) > 10
    assert len(rows(out / "labels" / "sealed_tracker_truth.csv")) == len(rows(out / "sealed_tracker.csv"))
    assert len(read_force_log(out / "sealed_force.csv", sealed=True)) == len(truth)


def test_the_cell_of_the_plan_is_found_by_its_hash_and_never_replaced(plan, tmp_path):
    alone = tmp_path / "elsewhere" / "plan"
    shutil.copytree(plan, alone)
    one_sentence(simulated(alone, "--out", tmp_path / "run"), 2, "give that file with --cell")
    told = simulated(alone, "--cell", CELL, "--out", tmp_path / "run", "--poses", "0", "--ladder", "none", "--no-air")
    assert told.code == 0 and "another version of cell.toml" in told.err and "pressed and limited need not" in told.err


STRANGERS = [
    ({"xyz_mm = [0, 0, 200]": "xyz_mm = [0, 0, 201]"}, "$TOOL lies 1.000 mm"),
    ({"centre_mm = [1700, 0, 900]": "centre_mm = [1700, 0, 902]"}, "$BASE lies 2.000 mm"),
    ({"axis = [0, 1, 0]": "axis = [0, 1, 0.01]"}, "$BASE lies"),
]


@pytest.mark.parametrize(("changes", "says"), STRANGERS)
def test_a_program_of_another_cell_is_refused(plan, tmp_path, changes, says):
    cell = small_cell(tmp_path / "other", changes)
    told = simulated(plan, "--cell", cell, "--out", tmp_path / "run")
    one_sentence(told, 2, says)
    assert "BLADE_01.src, line" in told.err and not (tmp_path / "run").exists()


def test_another_blade_is_refused(plan, tmp_path):
    cell = small_cell(tmp_path / "other")
    blade = cell.parent / "blade.stl"
    blade.write_bytes(blade.read_bytes() + b" ")
    one_sentence(simulated(plan, "--cell", cell, "--out", tmp_path / "run"), 2, "planned for another blade")


def test_a_robot_that_cannot_go_there_is_refused(plan, tmp_path):
    cell = small_cell(tmp_path / "other", {'model = "kr210_r2700_extra"': 'model = "narrow.toml"'})
    text = (Path(__file__).parents[2] / "robots" / "catalogue" / "kr210_r2700_extra.toml").read_text()
    narrow = text.replace("q_min_deg = [-185", "q_min_deg = [-1").replace("q_max_deg = [185", "q_max_deg = [1")
    assert narrow != text
    (tmp_path / "other" / "narrow.toml").write_text(narrow)
    told = simulated(plan, "--cell", cell, "--out", tmp_path / "run")
    one_sentence(told, 1, "beyond -1 to 1")


def test_a_robot_file_edited_since_the_plan_is_refused(plan, tmp_path):
    """It was rehearsed with the edited arm, and a crash was laid to the registration."""
    copy = tmp_path / "cell" / "plan"
    shutil.copytree(plan.parent, tmp_path / "cell")
    text = (copy.parent / "cell.toml").read_text()
    (copy.parent / "cell.toml").write_text(text.replace('"kr210_r2700_extra"', '"arm.toml"'))
    shutil.copyfile(CATALOGUE / "kr210_r2700_extra.toml", copy.parent / "arm.toml")
    cell = read_cell(copy.parent / "cell.toml")
    nothing = SimpleNamespace(path=None, program=None, stock=None)
    inputs = dict(Job.inputs(SimpleNamespace(believed=cell, options=nothing)))  # type: ignore[arg-type]
    assert inputs["robot"] == copy.parent / "arm.toml"
    told = json.loads((copy / "plan.json").read_text())
    told["inputs"] += [{"role": "robot", "name": "arm.toml", "sha256": sha256(inputs["robot"])}]
    (copy / "plan.json").write_text(json.dumps(told))
    arguments = copy, "--cell", cell.path, "--poses", "0", "--ladder", "none", "--no-air"
    assert simulated(*arguments, "--out", tmp_path / "same").code == 0
    arm = inputs["robot"].read_text()
    inputs["robot"].write_text(arm.replace("1200.0, 0.0, 215.0", "1210.0, 0.0, 215.0"))
    one_sentence(simulated(*arguments, "--out", tmp_path / "run"), 2, "another version of the robot file 'arm.toml'")


def changed_program(plan: Path, folder: Path, old: str, new: str) -> Path:
    copy = folder / "cell" / "plan"
    shutil.copytree(plan.parent, folder / "cell")
    path = copy / "BLADE_01.src"
    text = path.read_bytes().decode()
    assert old in text
    path.write_bytes(text.replace(old, new, 1).encode())
    return copy


def test_a_program_that_drives_into_the_wheel_is_infeasible(plan, tmp_path):
    """The axis that brings the blade nearest to the wheel goes on from 20 mm off it until it is 20 mm inside."""
    text = (plan / "BLADE_01.src").read_bytes().decode()
    line = next(row for row in text.splitlines() if row.startswith("; pass"))
    into = changed_program(plan, tmp_path, line, "; into the wheel\r\nLIN_AT\r\n" + line)
    copy = into / "BLADE_01.src"
    before = [row for row in text[: text.index(line)].splitlines() if "SPTP" in row][-1]
    values = np.array([float(part.split()[1]) for part in before[before.index("{") + 1 : before.index("}")].split(",")])
    touch, cell = next(row for row in rows(plan / "plan.csv") if row["contact"] == "1"), read_cell(plan.parent / "cell.toml")
    nudged = np.radians(values + np.vstack([np.zeros(6), np.eye(6)]))
    p = np.append([1e-3 * float(touch[f"p{a}_mm"]) for a in "xyz"], 1.0)
    away = cell.wheel.cylindrical((forward(cell.robot, nudged) @ cell.workpiece.T_flange_blade @ p)[:, :3])[2]
    slope = away[1:] - away[0]
    axis = int(np.argmax(np.abs(slope)))
    values[axis] -= 0.04 / slope[axis]
    aggregate = "{" + ",".join(f"A{i + 1} {v:.5f}" for i, v in enumerate(values)) + "}"
    block = [
        before,
        "  TIME_BLOCK START",
        f"  SPTP {aggregate}",
        "  TIME_BLOCK PART=0.50000",
        before,
        "  TIME_BLOCK PART=0.50000",
    ]
    there_and_back = "\r\n".join(["PTP_SPLINE", *block, "  TIME_BLOCK END=1.00000", "ENDSPLINE"])
    copy.write_bytes(copy.read_bytes().replace(b"LIN_AT", there_and_back.encode()))
    told = simulated(into, "--out", tmp_path / "run")
    one_sentence(told, 1, "on the virtual cell")
    assert "wheel" in told.err and "mm" in told.err and "BLADE_01.src" in told.err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--effect", "backlsh:5=1"), "the nearest is 'backlash'"),
        (("--effect", "wheel_wear"), "shows only while grinding"),
        (("--effects", "some"), "random:N"),
        (("--effect", "backlash:5", "--effect", "backlash:5"), "planted twice"),
        (("--machine", "real"), "not one of drawn, believed, sampled"),
        (("--machine", "sampled"), "no calibration"),
        (("--poses", "3"), "give 4 to 2000"),
        (("--poses", "nowhere"), "neither a number nor a folder"),
        (("--poses", "0"), "nothing to do"),
        (("--ladder", "12,20"), "need a plan"),
        (("--seed", "-1"), "--seed -1"),
        (("--size", "9"), "--size 9"),
        (("--log-hz", "nan"), "--log-hz nan"),
        (("--hz", "20", "--poses", "3"), "give 4 to 2000"),  # not of the rows of a log that nobody asked for
        (("--size", "3", "--machine", "believed"), "--machine believed has none; leave it out"),
        (("--effect", "backlash:5=-2e-4"), "is negative, which it never is"),
        (("--cell", "absent.toml"), "absent.toml"),
    ],
)
def test_refusals_are_one_sentence(arguments, says, tmp_path):
    one_sentence(simulated(*arguments, "--out", tmp_path / "run"), 2, says)
    assert not (tmp_path / "run").exists()


def test_a_folder_without_a_program_and_levels_out_of_range(plan, tmp_path):
    one_sentence(simulated(tmp_path, "--out", tmp_path / "run"), 2, "holds no KRL program")
    one_sentence(simulated(plan, "--ladder", "12,9000", "--out", tmp_path / "run"), 2, "--ladder 9000")
    one_sentence(simulated(plan, "--log-hz", "900", "--out", tmp_path / "run"), 2, "--log-hz 900")
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("keep")
    one_sentence(simulated(plan, "--out", full), 2, "not empty")
    one_sentence(simulated(plan, "--out", plan.parent, "--overwrite"), 2, "an input of this run")


def test_a_program_that_takes_other_times_than_its_plan_is_refused(plan, tmp_path):
    """Every block 2 % slower, its parts still summing to its end: a controller would drive it, and nobody planned it."""

    def slowed(block: re.Match[str]) -> str:
        parts = [round(1.02 * float(part), 5) for part in re.findall(r"PART=([\d.]+)", block[0])]
        left = iter(parts)
        text = re.sub(r"PART=[\d.]+", lambda _: f"PART={next(left):.5f}", block[0])
        return re.sub(r"END=[\d.]+", f"END={sum(parts):.5f}", text)

    shutil.copytree(plan.parent, tmp_path / "cell")
    folder = tmp_path / "cell" / "plan"
    for file in folder.glob("*.src"):
        file.write_bytes(re.sub(r"PTP_SPLINE(?:.|\n)*?ENDSPLINE", slowed, file.read_bytes().decode()).encode())
    told = simulated(folder, "--poses", "0", "--out", tmp_path / "run")
    one_sentence(told, 2, "deg from where the plan has them; plan anew")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("what", ["plan", "tracker alone"])
def test_a_robot_file_for_geometry_alone_is_refused(what, plan, tmp_path):
    """Its masses, torques and accelerations are what the virtual cell moves by."""
    shutil.copytree(plan.parent, tmp_path / "cell")
    cell = tmp_path / "cell" / "cell.toml"
    write_geometry_robot(tmp_path / "cell" / "arm.toml", "kr210_r2700_extra")
    cell.write_text(cell.read_text().replace('model = "kr210_r2700_extra"', 'model = "arm.toml"'))
    before = tree(tmp_path)
    asked = (tmp_path / "cell" / "plan",) if what == "plan" else ("--poses", "8")
    told = simulated(*asked, "--cell", cell, "--out", tmp_path / "run")
    missing = "limits.acceleration_deg_s2, limits.torque_Nm, links"
    one_sentence(told, 2, f"leaves out {missing}, and the virtual cell needs them; add them there")
    assert f"{cell}, robot.model: the file of robot 'kr210_r2700_extra'" in told.err and tree(tmp_path) == before


CALLS = {
    "leaves out": lambda calls: calls[:-1],
    "drives a pass twice": lambda calls: [calls[0], *calls],
    "out of turn": lambda calls: [calls[1], calls[0], *calls[2:]],
}


@pytest.mark.parametrize("what", CALLS)
def test_passes_left_out_driven_twice_or_out_of_turn_are_refused(what, plan, tmp_path):
    shutil.copytree(plan.parent, tmp_path / "cell")
    folder = tmp_path / "cell" / "plan"
    main = next(p for p in folder.glob("*.src") if not re.search(r"_\d\d(_\w)?$", p.stem))
    lines = main.read_bytes().decode().split("\r\n")
    calls = [line for line in lines if re.match(r"\w+_\d\d(_\w)? \( \)$", line)]
    first = lines.index(calls[0])
    kept = [line for line in lines if line not in calls]
    main.write_bytes("\r\n".join([*kept[:first], *CALLS[what](calls), *kept[first:]]).encode())
    told = simulated(main, "--poses", "0", "--out", tmp_path / "run")
    one_sentence(told, 2, "the program beside it")
    assert not (tmp_path / "run").exists()


def test_a_load_that_is_not_the_cells_is_refused(plan, tmp_path):
    shutil.copytree(plan.parent, tmp_path / "cell")
    for file in (tmp_path / "cell" / "plan").glob("*.src"):
        file.write_bytes(re.sub(rb"(\$LOAD=\{M )[\d.]+", rb"\g<1>9.000", file.read_bytes()))
    one_sentence(simulated(tmp_path / "cell" / "plan", "--poses", "0", "--out", tmp_path / "run"), 2, "$LOAD has 9.000 kg")


def test_the_list_of_effects_names_the_catalogue():
    told = simulated("--list-effects")
    assert told.code == 0 and len(told.out.splitlines()) > 40
    assert "half_width_rad" in told.out and "wheel_runout" in told.out


def test_a_campaign_of_poses_chosen_by_ocp_poses(tmp_path):
    table = tmp_path / "poses" / "poses.csv"
    table.parent.mkdir()
    table.write_text(
        "target,payload,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n" + "T1,bare,10,-80,90,0,30,0\nT2,bare,20,-70,80,10,30,5\n"
    )
    told = simulated("--poses", table.parent, "--out", tmp_path / "run")
    assert told.code == 0, told.err
    read = rows(tmp_path / "run" / "tracker.csv")
    assert [(r["target"], float(r["q1_deg"])) for r in read] == [("T1", 10.0), ("T2", 20.0)]


def test_the_command_itself_starts_and_ends_in_time(tmp_path):
    """40 postures in at most 5 s on a quiet machine; here with room for a busy one."""
    import time

    start = time.perf_counter()
    process = subprocess.run(
        [sys.executable, "-m", "ocp.simulate", "--out", "run"],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert process.returncode == 0, process.stderr
    assert time.perf_counter() - start < 30
    assert "120 readings in tracker.csv" in process.stdout


def test_the_clock_of_a_campaign_goes_on(plan, tmp_path):
    def mean(out: str, *more: str) -> float:
        told = simulated(plan, "--out", tmp_path / out, "--ladder", "none", "--no-air", "--poses", "0", *more)
        assert told.code == 0, told.err
        return float(np.mean([float(row["fn_N"]) for row in rows(tmp_path / out / "force.csv")]))

    worn = ("--effect", "wheel_wear=3e-7")
    fresh, later = mean("fresh", *worn), mean("later", *worn, "--clock", "1000")
    # 0.3 mm of radius on a flange of 5.6 N/mm, the rest of the chain in series.
    assert later - fresh == pytest.approx(-0.3 * 5.6, rel=0.25)
    one_sentence(simulated(plan, "--clock", "-1", "--out", tmp_path / "x"), 2, "--clock -1 must lie between")


def test_a_full_disc_is_told_of_the_folder_that_is_written(tmp_path, monkeypatch):
    """The blade's file, which was read well, was said to be at fault."""

    def full(file, content):
        raise OSError(errno.ENOSPC, "No space left on device", str(file))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(BadInput, match="run: cannot be written .No space left on device., nothing is; give another --out"):
        with whole_folder(tmp_path / "run", False) as folder:
            copy_cell(read_cell(CELL), folder)
    assert list(tmp_path.iterdir()) == []
