"""`python -m ocp.poses` as a user meets it: what it writes, what it refuses."""

import contextlib
import csv
import io
import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from ocp.data import CELL
from ocp.model.cell import read_cell, read_tracker_setup
from ocp.plan.clearance import CollisionScene
from ocp.plan.motion import dense
from ocp.plan.paths import refuse_flange
from ocp.poses.__main__ import app
from ocp.poses.candidates import Sight, ground_blade, visible
from robots.errors import BadInput
from robots.robot import CATALOGUE
from robots.tracker_readings import read_readings
from tests.support.browser import CHROMIUM, looked_at
from tests.support.formats import told_keys
from trajectories.krl.checks import check_program

pytestmark = pytest.mark.usefixtures("unprinted")

TRACKER = "[tracker.targets]\nT1 = [150, -50, 250]\nT2 = [-160, 40, 210]\nT3 = [20, 170, 330]\n"
HEAVY = "[payloads.heavy]\nmass_kg = 120.0\ncom_mm = [0, 20, 200]\n"
COUNT = 14


def written_cell(folder: Path, tracker: str = TRACKER, payloads: str = HEAVY, **changes: str) -> Path:
    """The bundled cell without its STL (a slab stands for the blade, which is quick), with nests and payloads."""
    text = (CELL).read_text()
    # Its own tracker and payloads give way to those of the test.
    text = re.sub(r"(?ms)^\[(payloads\.(?!grinder)\w+|tracker[^\]]*)\]$.*?(?=^\[|\Z)", "", text)
    text = text.replace("[controller]", f"{payloads}\n[controller]")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cell.toml").write_text(f"{text}\n{tracker}")
    return folder / "cell.toml"


def told(*arguments: str) -> tuple[int, str, str]:
    err = io.StringIO()
    with contextlib.redirect_stderr(err):
        result = CliRunner().invoke(app, [*arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr or err.getvalue()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder, cell file and last line of one choice."""
    folder = tmp_path_factory.mktemp("poses")
    cell = written_cell(folder)
    code, out, err = told("--cell", str(cell), "-n", str(COUNT), "--out", str(folder / "poses"), "--tracker", "2500,2000,1500")
    assert code == 0, err
    return folder / "poses", cell, out


def rows_of(poses: Path) -> list[dict[str, str]]:
    with (poses / "poses.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def mains(poses: Path) -> list[Path]:
    return [p for p in sorted(poses.glob("*.src")) if not re.search(r"_\d\d$", p.stem)]


def test_the_last_line_tells_accuracy_and_what_more_poses_buy(made):
    poses, _, out = made
    assert out.count("\n") == 1 and f"{COUNT} poses, {2 * COUNT} readings" in out
    summary = json.loads((poses / "poses.json").read_text())
    assert set(summary) == told_keys("poses.json")
    assert f"{summary['expected_mm']['grinding_zone']:.3f} mm" in out
    assert "ten more improve" in out or "still help" in out


def test_the_report_is_a_page_and_sheets(made):
    poses, _, _ = made
    if CHROMIUM:
        looked_at(poses / "report.html")
    page = (poses / "report.html").read_text(encoding="utf-8")
    summary = json.loads((poses / "poses.json").read_text())
    assert f"{summary['expected_mm']['grinding_zone']:.3f} mm (one sigma, 3D)" in page
    assert all(notice.partition("'")[0] in page for notice in summary["notices"]) and page.count("<figure") == 2
    assert "grinder (8 poses), then heavy (6 poses)" in page and "reflector, heavy" in page
    assert (poses / "report.pdf").read_bytes().startswith(b"%PDF-")


def test_the_table_is_a_tracker_file_without_the_measured_columns(made):
    poses, cell, _ = made
    setup = read_tracker_setup(cell)
    readings = read_readings(poses / "poses.csv", setup.payloads, setup.instrument, sealed=True)
    assert len(readings) == 2 * COUNT and not [n for n in readings.notices if "ignored" in n]
    first, second = slice(0, None, 2), slice(1, None, 2)
    np.testing.assert_array_equal(readings.q[first], readings.q[second])
    np.testing.assert_array_equal(readings.approach[first], -readings.approach[second])
    assert (np.abs(readings.approach) == 1).all()
    assert len(np.unique(readings.approach[first], axis=0)) > COUNT / 2, "the axes' signs are mixed"
    assert len(np.unique(readings.q, axis=0)) == COUNT
    payload = [row["payload"] for row in rows_of(poses)]
    changes = [b for a, b in itertools.pairwise(payload) if a != b]
    assert payload[0] == "grinder" and changes == ["heavy"], "each payload is mounted once, the lightest first"
    # The same file with three columns filled in is a campaign that can be calibrated.
    filled = poses.parent / "tracker.csv"
    lines = (poses / "poses.csv").read_text().splitlines()
    filled.write_text("\n".join([lines[0] + ",x_mm,y_mm,z_mm", *(line + ",1,2,3" for line in lines[1:])]) + "\n")
    assert len(read_readings(filled, setup.payloads, setup.instrument)) == 2 * COUNT


def test_a_flange_set_for_another_force_keeps_nobody_from_measuring():
    """It is the plan that is refused for it."""
    cell = read_cell(CELL)
    assert cell.flange is not None
    with pytest.raises(BadInput, match="the force flange, set to 1 N, would stand"):
        refuse_flange(held := replace(cell, flange=replace(cell.flange, setpoint=1.0, stroke=3e-3)), ground_blade(cell).paths)
    assert len(ground_blade(held).paths) == len(ground_blade(cell).paths)


def test_every_reading_is_reachable_free_and_seen(made):
    poses, cell_file, _ = made
    cell, setup = read_cell(cell_file), read_tracker_setup(cell_file)
    readings = read_readings(poses / "poses.csv", setup.payloads, setup.instrument, sealed=True)
    assert ((readings.q > cell.robot.q_min) & (readings.q < cell.robot.q_max)).all()
    scene = CollisionScene(cell, ground_blade(cell).vertices)
    assert scene.clearance(readings.q, in_contact=False).value >= 0
    for i, name in enumerate(readings.targets):
        q = readings.q[readings.target == i]
        assert visible(cell.robot, cell.wheel, Sight(), setup.instrument.nests[name], np.array([2.5, 2.0, 1.5]), q).all()


def test_the_programs_stand_the_checks_and_stop_at_the_readings_from_both_sides(made):
    poses, cell_file, _ = made
    robot = read_cell(cell_file).robot
    wanted = {}
    for row in rows_of(poses):
        q = tuple(float(row[f"q{i}_deg"]) for i in range(1, 7))
        wanted.setdefault(row["payload"], []).append((q, tuple(int(row[f"approach{i}"]) for i in range(1, 7))))
    assert [m.stem for m in mains(poses)] == ["POSES_GRINDER", "POSES_HEAVY"]
    scene = CollisionScene(read_cell(cell_file), ground_blade(read_cell(cell_file)).vertices)
    for main, payload in zip(mains(poses), wanted, strict=True):
        execution = check_program(main, robot, pauses=True)
        points = np.array([s.q[0] for s in execution.segments])
        assert {s.word for s in execution.segments} == {"PTP"}
        assert scene.clearance(dense(points), in_contact=False).value >= 0
        np.testing.assert_allclose(points[0], points[-1])
        # The text itself, read by hand: what stands before every HALT and the point before that.
        text = "".join(p.read_text() for p in sorted(poses.glob(f"{main.stem}_*.src")))
        lines = [line for line in text.splitlines() if line[:4] in ("PTP ", "HALT")]
        stops = [i for i, line in enumerate(lines) if line == "HALT"]
        assert len(stops) == len(wanted[payload])
        for i, (q, sign) in zip(stops, wanted[payload], strict=True):
            at, before = (np.array([float(v) for v in re.findall(r"A\d (-?[\d.]+)", lines[i - k])]) for k in (1, 2))
            np.testing.assert_allclose(at, q, atol=1e-9)
            np.testing.assert_allclose(at - before, 2.0 * np.array(sign), atol=2e-5)
        text = "".join(p.read_text() for p in poses.glob(f"{main.stem}*.src"))
        assert ("$LOAD={M 120.000" in text) == (payload == "heavy")


def test_a_measuring_program_is_no_grinding_program(made):
    poses, _, _ = made
    with pytest.raises(BadInput, match="HALT and WAIT may not stand in a grinding program"):
        check_program(mains(poses)[0])


@pytest.mark.parametrize(
    "line, message",
    [
        ("HALT 5", "too much"),
        ("WAIT", "expected 'FOR'"),
        ("WAIT SEC", "expected a number"),
        ("WAIT SEC -1.0", "above 0"),
        ("WAIT SEC 3601", "at most"),
        ("WAIT FOR $IN[0]", "does not exist"),
        ("WAIT FOR $IN[8193]", "does not exist"),
        ("WAIT FOR $IN[1.5]", "does not exist"),
        ("WAIT FOR $IN[3] AND $IN[4]", "too much"),
        ("WAIT FOR $OUT[3]", "expected '$IN'"),
        ("WAIT FOR TRUE", "expected '$IN'"),
    ],
)
def test_the_checks_name_the_line_of_a_pause_they_do_not_know(made, tmp_path, line, message):
    for file in made[0].glob("POSES_GRINDER*"):
        text = file.read_bytes().decode()
        if file.name == "POSES_GRINDER_01.src":
            text = text.replace("HALT", line, 1)
            number = text.split("\r\n").index(line) + 1
        (tmp_path / file.name).write_bytes(text.encode())
    with pytest.raises(BadInput, match=re.escape(message)) as refused:
        check_program(tmp_path / "POSES_GRINDER.src", pauses=True)
    assert f"POSES_GRINDER_01.src, line {number}" in str(refused.value)


def test_an_arm_without_a_list_of_postures_is_refused_by_its_file(tmp_path):
    cell = written_cell(tmp_path, kr210_r2700_extra="ur10")
    code, _, said = told("--cell", str(cell), "--out", str(tmp_path / "poses"))
    assert code == 2 and f"{cell}, robot.model: Universal Robots UR10" in said and "ocp.diagnose alone" in said


def test_the_summary_says_what_it_rests_on(made):
    poses = made[0]
    summary = json.loads((poses / "poses.json").read_text())
    assert summary["criterion"] == "zone" and summary["tracker_mm"] == [2500.0, 2000.0, 1500.0]
    assert summary["identifiable_directions"] == 35  # 30 of a full pose, 3 of the nests' triangle, 2 springs
    errors = [p["calibration_mm"] for p in summary["curve"]]
    counts = [p["poses"] for p in summary["curve"]]
    assert counts == sorted(counts) and COUNT in counts and errors == sorted(errors, reverse=True)
    assert set(summary["observability"]) == {"O1", "O2", "O3", "O4", "O5"}
    assert any("slab" in notice for notice in summary["notices"])
    assert {p["payload"] for p in summary["programs"]} == {"grinder", "heavy"}
    assert sum(p["poses"] for p in summary["programs"]) == COUNT
    assert all((poses / f).is_file() for p in summary["programs"] for f in p["files"])


@pytest.mark.drawn
def test_a_second_run_writes_the_same_bytes_and_needs_permission(made):
    poses, cell, _ = made
    arguments = ("--cell", str(cell), "-n", str(COUNT), "--tracker", "2500,2000,1500")
    code, _, err = told(*arguments, "--out", str(poses))
    assert code == 2 and "--overwrite" in err
    code, _, err = told(*arguments, "--out", str(poses.parent / "again"))
    assert code == 0, err
    one, two = ({p.name: p.read_bytes() for p in f.iterdir()} for f in (poses, poses.parent / "again"))
    assert one.keys() == two.keys() and [n for n in one if one[n] != two[n]] == []


def test_options_reach_the_program(made, tmp_path):
    _, cell, _ = made
    chosen = ("--criterion", "O1", "--payload", "heavy", "--targets", "T2", "--targets", "T1")
    driven = ("--input", "7", "--approach", "1", "--speed", "30", "--name", "x(); HALT")
    code, _, err = told("--cell", str(cell), "-n", "12", *chosen, *driven, "--out", str(tmp_path / "p"))
    assert code == 0, err
    summary = json.loads((tmp_path / "p" / "poses.json").read_text())
    assert summary["targets"] == ["T1", "T2"] and [p["payload"] for p in summary["programs"]] == ["heavy"]
    assert summary["tracker"].startswith("assumed") and any("same mass" in n for n in summary["notices"])
    sub = (tmp_path / "p" / "XHALT_HEAVY_01.src").read_text()
    assert sub.count("WAIT FOR $IN[7]") == 24 and "HALT\r\n" not in sub and "$VEL_AXIS[1]=30" in sub


REFUSED = {
    "too few poses": (("-n", "8"), 2, "at least"),
    "no poses": (("-n", "0"), 2, "between 1 and"),
    "unknown payload": (("--payload", "brick"), 2, "brick"),
    "unknown target": (("--targets", "T9"), 2, "T9"),
    "unknown criterion": (("--criterion", "O6"), 2, "O6"),
    "half a tracker": (("--tracker", "1,2"), 2, "x,y,z in mm"),
    "no number": (("--tracker", "1,2,x"), 2, "x,y,z in mm"),
    "tracker nowhere": (("--tracker", "1,2,nan"), 2, "100 m"),
    "tracker out of range": (("--tracker", "90000,0,0"), 2, "no reflector is seen"),
    "two ways to wait": (("--wait", "3", "--input", "4"), 2, "exclude"),
    "approach of nothing": (("--approach", "0"), 2, "--approach"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals_are_one_sentence_and_nothing_is_written(made, tmp_path, name):
    arguments, code, part = REFUSED[name]
    found, out, err = told("--cell", str(made[1]), *arguments, "--out", str(tmp_path / "p"))
    assert (found, out) == (code, "") and part in err and err.strip().count("\n") == 0, err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "changes, code, part",
    [
        ({"tracker": ""}, 2, "[tracker.targets] is missing"),
        ({"tracker": "[tracker]\nrange_noise_um = 5.0\n"}, 2, "[tracker.targets] is missing"),
        ({"centre_mm = [1700, 0, 900]": "centre_mm = [9000, 0, 900]"}, 1, "no grinding zone"),
    ],
)
def test_cells_in_which_nothing_can_be_measured_are_refused(tmp_path, changes, code, part):
    cell = written_cell(tmp_path / "cell", **changes)
    found, out, err = told("--cell", str(cell), "--out", str(tmp_path / "p"))
    assert (found, out) == (code, "") and part in err, err
    assert not (tmp_path / "p").exists()


def test_no_program_moves_an_arm_whose_shape_is_not_known(tmp_path):
    """An arm of a URDF got programs of wide moves with a note that nothing is planned."""
    arm = (CATALOGUE / "kr210_r2700_extra.toml").read_text(encoding="utf-8").split("[[shape]]")[0]
    cell = written_cell(tmp_path / "cell", **{'"kr210_r2700_extra"': '"arm.toml"'})
    (tmp_path / "cell" / "arm.toml").write_text(arm, encoding="utf-8")
    found, out, err = told("--cell", str(cell), "--out", str(tmp_path / "p"))
    assert (found, out) == (2, "") and "leaves out shape, and a program of poses, which is to touch nothing, needs it" in err, err
    assert not (tmp_path / "p").exists()
