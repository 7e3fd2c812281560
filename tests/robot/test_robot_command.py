"""`ocp.robot`: files that are read again as they were written, and nothing where something is wrong."""

import re

import pytest
from typer.testing import CliRunner

from ocp.robot.__main__ import app
from robots.robot import load_robot
from tests.support.house import ROOT


def call(*words):
    return CliRunner().invoke(app, [str(w) for w in words])


def test_a_new_robot_is_read_and_says_what_it_leaves_out(tmp_path):
    told = call("new", "my_arm", "--out", tmp_path / "robot")
    assert told.exit_code == 0 and "example numbers" in told.stdout and "gives no links" in told.stderr
    robot = load_robot(tmp_path / "robot" / "my_arm.toml")
    assert robot.name == "my_arm" and set(robot.left_out) >= {"links", "stiffness"}


def test_every_table_that_the_template_comments_out_is_read_once_it_stands(tmp_path):
    call("new", "my_arm", "--out", tmp_path / "robot")
    file = tmp_path / "robot" / "my_arm.toml"
    table = re.compile(r"# (\[{1,2}\w|(com|mass|rated|source|joint|acc|torque|link|from|to|radius)\w* = )")
    lines = [line[2:] if table.match(line) else line for line in file.read_text().splitlines()]
    links = "".join(f"[links.link{i}]\nmass_kg = 10.0\ncom_mm = [0, 0, 0]\n" for i in range(1, 7))
    file.write_text("\n".join(lines).replace("[[shape]]", links + "[[shape]]"))
    robot = load_robot(file)
    assert robot.left_out == ("links.inertia_kg_m2",)
    assert robot.payload is not None and len(robot.link_shapes) == 1


def test_an_imported_robot_keeps_its_name_or_takes_the_one_given(tmp_path):
    urdf = ROOT / "docs" / "examples" / "arm.urdf"
    assert call("import", urdf, "--out", tmp_path / "a").exit_code == 0
    assert load_robot(tmp_path / "a" / "arm_2700.toml").torque_max[0] == 7290
    assert call("import", urdf, "--name", "left", "--out", tmp_path / "b").exit_code == 0
    assert load_robot(tmp_path / "b" / "left.toml").name == "left"


@pytest.mark.parametrize(
    "words", [("new", "a b"), ("new", ".."), ("import", "nix.urdf"), ("import", "nix.urdf", "--name", "a/b")]
)
def test_what_is_refused_writes_nothing(tmp_path, words):
    told = call(*words, "--out", tmp_path / "robot")
    assert told.exit_code == 2 and told.stderr.count("\n") == 1
    assert not (tmp_path / "robot").exists()


def test_an_inertia_that_no_body_has_is_refused_without_a_line_that_the_urdf_does_not_have(tmp_path):
    file = tmp_path / "arm.urdf"
    text = (ROOT / "docs" / "examples" / "arm.urdf").read_text()
    file.write_text(text.replace('ixx="0.7" iyy="1.9" izz="2.0" ixy="0"', 'ixx="0.7" iyy="1.9" izz="2.0" ixy="5"'))
    told = call("import", file, "--out", tmp_path / "out")
    assert told.exit_code == 2 and "refused: arm.urdf: links.link4: " in told.stderr
