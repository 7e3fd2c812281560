"""Robot files: the catalogue's numbers, and every way a file can be wrong."""

import re
import tomllib

import numpy as np
import pytest

from robots.errors import BadInput
from robots.robot import CATALOGUE, LEAVES, catalogue, left_out_notices, load_robot, refuse_left_out
from tests.support.geometry_robot import write_geometry_robot

EXTRA = CATALOGUE / "kr210_r2700_extra.toml"


def test_catalogue_lists_the_machines():
    assert catalogue() == ["kr210_r2700_2", "kr210_r2700_extra", "kr210_r2700_prime", "ur10", "ur5"]


# PHYSICS 2.1: d1 a1 a2 a3 d4 d6 mm, upper limit of axis 3, of axis 5, torque of axis 2, speed of axis 1.
@pytest.mark.parametrize(
    ("name", "lengths", "q3", "q5", "torque", "speed"),
    [
        ("kr210_r2700_extra", (675, 350, 1150, -41, 1200, 215), 155, 125, 8100, 123),
        ("kr210_r2700_prime", (675, 350, 1150, -41, 1200, 240), 155, 122.5, 9600, 123),
        ("kr210_r2700_2", (645, 330, 1150, 115, 1220, 215), 168, 125, 8910, 116.8),
    ],
)
def test_numbers_are_those_of_the_table(name, lengths, q3, q5, torque, speed):
    robot = load_robot(name)
    d, a = robot.mdh[:, 1], robot.mdh[:, 2]
    assert np.allclose([d[0], a[0], a[1], a[2], d[3], d[5]], np.array(lengths) * 1e-3, atol=1e-15)
    assert np.allclose(np.degrees(robot.q_max[[2, 4]]), [q3, q5])
    assert np.allclose(np.degrees(robot.q_min[[1, 4]]), [-140, -q5])
    assert robot.torque_max[1] == torque
    assert np.isclose(np.degrees(robot.qd_max[0]), speed)
    assert np.isclose(robot.link_mass.sum(), 1068, atol=0.5)
    assert np.isnan(robot.gear_ratio).all() == (name == "kr210_r2700_extra")
    assert {shape[0] for shape in robot.link_shapes} == set(range(7))


def test_a_file_path_gives_the_same_robot_as_the_name(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(EXTRA.read_text().replace('name = "kr210_r2700_extra"', 'name = "mine"'))
    mine, catalogued = load_robot(path), load_robot("kr210_r2700_extra")
    assert mine.name == "mine"
    assert np.array_equal(mine.mdh, catalogued.mdh)
    with pytest.raises(ValueError, match="read-only"):
        mine.mdh[0, 0] = 1.0


def test_unknown_name_lists_the_known():
    with pytest.raises(BadInput, match=r"kr16.*kr210_r2700_extra"):
        load_robot("kr16")


def test_missing_file_is_told():
    with pytest.raises(BadInput, match=r"nowhere\.toml"):
        load_robot("nowhere.toml")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("sign = [-1, 1, 1, -1, 1, -1]", "sign = [-1, 1, 1, -1, 1, 2]", r"geometry\.sign\[5\].*2"),
        ("sign = [-1, 1, 1, -1, 1, -1]", "", r"geometry\.sign' is missing"),
        ("theta_deg = [0.0, ", "theta_deg = [", r"geometry\.theta_deg\[5\]' has too few"),
        ("theta_deg = [0.0, ", "theta_deg = [0.0, 0.0, ", r"geometry\.theta_deg has 7 entries, expected 6"),
        ("d_mm = [675.0", "d_mm = [nan", r"geometry\.d_mm\[0\] = nan"),
        ("d_mm = [675.0", "d_mm = [inf", r"geometry\.d_mm\[0\] = inf"),
        ("d_mm = [675.0", 'd_mm = ["675"', r"geometry\.d_mm\[0\] = '675'"),
        ("d_mm = [675.0", "d_mm = [true", r"geometry\.d_mm\[0\] = True"),
        ("q_min_deg = [-185.0", "q_min_deg = [185.0", r"q_min_deg\[0\] = 185 must be below.*axis 1"),
        ("mass_kg = 377.29", "mass_kg = -1.0", r"links\.link1\.mass_kg = -1\.0"),
        ("mass_kg = 377.29", "mass = 377.29", r"link1\.mass"),
        ("radius_mm = 300.0", "radius_mm = 0.0", r"shape\[1\]\.radius_mm = 0\.0"),
        ("link = 6", "link = 7", r"shape\[8\]\.link = 7"),
        ("[limits]", "[limit]", r"limits"),
        ("[limits]", "[limits", r"not valid TOML.*line"),
        ("speed_deg_s = [123.0", "speed_deg_s = [0.0", r"speed_deg_s\[0\] = 0\.0"),
        ("inertia_kg_m2 = [5.59, 55.66, 55.23, 0.0", "inertia_kg_m2 = [5.59, 55.66, 55.23, 20.0", r"link2.*semidefinite"),
    ],
)
def test_a_wrong_file_is_refused_with_key_and_value(tmp_path, old, new, told):
    text = EXTRA.read_text()
    assert text.count(old) == 1
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(BadInput, match=told) as refusal:
        load_robot(path)
    assert re.search(r"wrong\.toml(, line \d+)?:", str(refusal.value))
    assert "\n" not in str(refusal.value)


def test_bytes_that_are_not_text_are_refused(tmp_path):
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="UTF-8"):
        load_robot(path)


def test_every_block_of_the_catalogue_names_its_source():
    for name in catalogue():
        tables = tomllib.loads((CATALOGUE / f"{name}.toml").read_text())
        assert all(len(tables[key]["source"]) > 20 for key in ("geometry", "limits", "stiffness", "links"))
        assert load_robot(name).sources.count("\n") >= 3


def test_an_arm_without_shapes_does_not_move(tmp_path):
    """Nothing would keep it off wheel, blade and floor."""
    text = (CATALOGUE / "kr210_r2700_extra.toml").read_text()
    (tmp_path / "arm.toml").write_text(text[: text.index("[[shape]]")])
    robot = load_robot(tmp_path / "arm.toml")
    assert robot.left_out == ("shape",)
    with pytest.raises(BadInput, match="leaves out shape, and a plan needs it"):
        refuse_left_out(tmp_path / "c.toml", robot, "a plan")


def test_a_robot_file_for_geometry_alone(tmp_path):
    write_geometry_robot(tmp_path / "arm.toml", "ur5")
    bare, whole = load_robot(tmp_path / "arm.toml"), load_robot("ur5")
    assert (bare.mdh == whole.mdh).all() and (bare.q_max == whole.q_max).all()
    assert not bare.link_mass.any() and not bare.stiffness.any() and np.isinf(bare.torque_max).all()
    assert {*bare.left_out} == {*LEAVES} - {"links.inertia_kg_m2", "shape"} and len(left_out_notices(bare)) == 4
    with pytest.raises(
        BadInput, match="c.toml, robot.model: .* leaves out limits.acceleration_deg_s2, limits.torque_Nm, links, and"
    ):
        refuse_left_out(tmp_path / "c.toml", bare, "a plan")
    refuse_left_out(tmp_path / "c.toml", whole, "a plan")
    without = re.sub(r"\ninertia_kg_m2 = .*", "", (CATALOGUE / "ur5.toml").read_text())
    (tmp_path / "arm.toml").write_text(without)
    assert load_robot(tmp_path / "arm.toml").left_out == ("links.inertia_kg_m2",)
    assert (load_robot(tmp_path / "arm.toml").link_mass == whole.link_mass).all()
