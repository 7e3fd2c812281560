"""`ocp.cell`: a new cell is sound and reaches its blade, an examination ends as it found, a page holds what it says."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from ocp.cell.__main__ import app
from ocp.cell.new import held_upright, nearest_whole, wheel_region
from ocp.data import CELL
from ocp.model.cell import read_cell, read_tracker_setup
from ocp.plan.paths import PlanOptions, lay_paths
from robots.inverse import planned_family
from robots.pose import apply, make_transform
from robots.robot import catalogue, load_robot
from tests.support.browser import CHROMIUM, browser
from trajectories.blade import find_shape, read_blade


def call(*words):
    return CliRunner().invoke(app, [str(w) for w in words])


@pytest.fixture(scope="module")
def new(tmp_path_factory):
    """A cell for the KR 210, with the bundled blade."""
    folder = tmp_path_factory.mktemp("new") / "cell"
    told = call("new", "--robot", "kr210_r2700_extra", "--out", folder)
    assert told.exit_code == 0 and told.stderr == ""
    return folder


@pytest.fixture(scope="module")
def shown(new, tmp_path_factory):
    """What the command said, and its page."""
    folder = tmp_path_factory.mktemp("shown") / "page"
    answer = call("show", new / "cell.toml", "--out", folder, "--json")
    assert answer.exit_code == 0
    return json.loads(answer.stdout), folder / "cell.html"


def test_a_new_cell_has_no_doubt_and_its_page_says_so(shown):
    told, file = shown
    assert "no mistakes, no doubts" in told["line"] and told["notices"] == [] and told["page"] == str(file)
    page = file.read_text()
    row = re.search(r"<tr[^>]*>\s*<t[hd][^>]*>grinder.*?</tr>", page, re.DOTALL)
    assert row is not None and re.findall(r">([^<>\n]+)</t[hd]>", row[0])[-3:] == ["-"] * 3  # nobody gave its inertia
    assert "TOOL_DATA[1]" in page and "1660.000" in page and "-90.000" in page and "centre_sd_mm" in page


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt install chromium)")
def test_the_page_turns_its_arm_and_shows_its_frames(shown):
    picture = "document.getElementById('canvas').toDataURL()"
    with browser() as page:
        page.open(shown[1], 1280)
        names = "[...document.querySelectorAll('#labels span')].map(s => s.textContent)"
        assert "blade = TOOL" in page.run(names) and "wheel = BASE" in page.run(names)
        seen = [page.run(picture)]
        for change in (
            "(() => { const p = document.getElementById('posture'); p.value = 30; p.dispatchEvent(new Event('input')); })()",
            "document.getElementById('region').click()",
            "document.getElementById('frames').click()",
            "document.querySelector('[name=view][value=flange]').click()",
        ):
            page.run(change)
            page.drawn()
            seen.append(page.run(picture))
        assert len(set(seen)) == 5 and page.run(names) == [] and page.faults == []


def test_a_new_cell_is_the_bundled_one_but_for_its_measurements(new):
    """The bundled cell is planned by other tests: what plans it plans this one."""
    cell, known = read_cell(new / "cell.toml"), read_cell(CELL)
    assert cell.wheel.centre == pytest.approx(known.wheel.centre) and cell.wheel.arc == pytest.approx(known.wheel.arc)
    assert cell.process == known.process and cell.flange == known.flange
    assert cell.workpiece.T_flange_blade == pytest.approx(known.workpiece.T_flange_blade)
    assert cell.robot.stiffness == pytest.approx(known.robot.stiffness)


@pytest.mark.parametrize("robot", [name for name in catalogue() if planned_family(load_robot(name)) is None])
def test_an_arm_that_cannot_be_planned_gets_a_cell_for_its_tracker(tmp_path, robot):
    told = call("new", "--robot", robot, "--out", tmp_path / "cell")
    assert told.exit_code == 0 and "nothing can be planned" in told.stderr
    setup = read_tracker_setup(tmp_path / "cell" / "cell.toml")
    assert "grindplan poses" not in (tmp_path / "cell" / "cell.toml").read_text()  # it refuses such an arm
    assert max(p.mass for p in setup.payloads.values()) <= setup.robot.payload.mass
    assert call("check", tmp_path / "cell" / "cell.toml").exit_code == 0


def test_every_number_that_the_template_comments_out_is_read_once_it_stands(new, tmp_path):
    shutil.copytree(new, tmp_path / "cell")
    file = tmp_path / "cell" / "cell.toml"
    lines = file.read_text().splitlines()
    standing = [line[2:] if re.match(r'# (\[\w|\w+ = [\["\d-])', line) else line for line in lines]
    file.write_text("\n".join(line for line in standing if not line.startswith("calibration =")))
    assert sum(a != b for a, b in zip(lines, standing, strict=True)) >= 13
    cell = read_cell(file)
    assert cell.floor == pytest.approx(-0.4) and cell.flange.bandwidth == 10.0 and cell.process.removal == pytest.approx(2e-5)


@pytest.mark.parametrize("turn", [np.eye(3), np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), np.diag([1.0, -1, -1])])
def test_a_blade_is_held_by_its_root_wherever_its_file_has_it(turn):
    blade = read_blade(CELL.parent / "blade.stl")
    moved = type(blade)(blade.name, blade.sha256, blade.vertices @ turn.T + [0.1, -0.2, 0.3], blade.faces)
    shape = find_shape(moved)
    held = held_upright(moved, shape)
    placed = apply(make_transform(held.R, held.xyz), moved.vertices)
    assert placed[:, 2].min() == pytest.approx(0.2, abs=6e-4) and np.abs(placed[:, :2].mean(axis=0)).max() < 0.02
    root = apply(make_transform(held.R, held.xyz), shape.frame.c0)
    assert root[2] < apply(make_transform(held.R, held.xyz), shape.frame.c1)[2]
    inside = moved.vertices @ held.clamp_normal < held.clamp_offset
    assert 0 < inside.mean() < 0.5 and placed[inside, 2].max() < root[2]


def moved_wheel(cell, centre):
    return replace(cell, wheel=replace(cell.wheel, centre=np.asarray(centre, float)))


def test_the_wheel_goes_where_the_arm_reaches_it():
    cell = read_cell(CELL)
    laid = lay_paths(cell, cell.workpiece.stl, PlanOptions(even=False, step=5e-3))
    far = moved_wheel(cell, [2.9, 0.0, 0.9])
    region = wheel_region(far, laid.paths, 2.7)
    middle = len(region.share) // 2
    assert region.share[middle] < 0.5 and region.centre[middle] == pytest.approx([2.9, 0, 0.9])
    chosen = nearest_whole(region, far.wheel.centre)
    again = wheel_region(moved_wheel(cell, chosen), laid.paths, 2.7)
    assert again.share[middle] == 1.0


def test_a_wheel_beyond_reach_is_a_mistake_and_exit_1(new, tmp_path):
    shutil.copytree(new, tmp_path / "cell")
    file = tmp_path / "cell" / "cell.toml"
    file.write_text(file.read_text().replace("centre_mm = [1700, 0, 900]", "centre_mm = [3500, 0, 900]"))
    told = call("check", file)
    assert told.exit_code == 1 and "note: mistake: wheel.centre_mm: 100.0 % of the asked surface is left out" in told.stderr


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("new", "--robot", "kr99"), "not in the catalogue"),
        (("new", "--robot", "kr210_r2700_extra", "--blade", "nix.stl"), "nix.stl"),
        (("new", "--robot", "ur5", "--blade", "nix.stl"), "nix.stl"),
        (("new",), "--robot"),
        (("check", "nix.toml"), "nix.toml"),
        (("show", "nix.toml"), "nix.toml"),
    ],
)
def test_what_is_refused_writes_nothing(tmp_path, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    answer = call(*words)
    assert answer.exit_code == 2 and told in answer.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_blade_far_from_its_origin_is_told_by_its_own_name(tmp_path):
    blade = read_blade(CELL.parent / "blade.stl")
    far = tmp_path / "far.stl"
    trimesh.Trimesh(1e3 * (blade.vertices + [9.0, 0.0, 0.0]), blade.faces, process=False).export(far)
    answer = call("new", "--robot", "kr210_r2700_extra", "--blade", str(far), "--out", str(tmp_path / "cell"))
    assert answer.exit_code == 2 and f"{far}: lies 9 m" in answer.stderr and not (tmp_path / "cell").exists()


def test_a_calibration_that_is_a_folder_is_refused_in_one_sentence(tmp_path):
    text = (CELL.parent / "cell.toml").read_text()
    (tmp_path / "cell.toml").write_text(text.replace("[robot]", '[robot]\ncalibration = "."', 1))
    answer = call("show", str(tmp_path / "cell.toml"), "--out", str(tmp_path / "page"))
    assert answer.exit_code == 2 and "Is a directory" in answer.stderr and answer.stderr.count("\n") == 1
