"""A cell that was edited after its calibration keeps of it what does not rest on the edited numbers, and says so."""

import re

import numpy as np
import pytest

from ocp.cell.examination import UNMEASURED, Finding, examine
from ocp.data import CELL
from ocp.model.calibrated_for import RESTS_ON, made_for
from ocp.model.cell import read_cell, read_tracker_setup
from ocp.model.theta import BLOCKS, NAMES, believed_theta
from ocp.shell.progress import Phases
from robots.calibration.store import Calibration, read_calibration, write_calibration
from robots.errors import BadInput
from robots.robot import CATALOGUE

EDITED = {
    "wheel": ("radius_mm = 40.0", "radius_mm = 45.0", "wheel.radius_mm is 45, the calibration was made with 40"),
    "workpiece": (
        "xyz_mm = [0, 0, 200]",
        "xyz_mm = [0, 0, 230]",
        r"workpiece.xyz_mm is \[0, 0, 230\], .* made with \[0, 0, 200\]",
    ),
    "force_flange": ("stiffness_N_per_mm = 5.6", "stiffness_N_per_mm = 9.0", "force_flange.stiffness_N_per_mm is 9, .* with 5.6"),
    "payload": ("mass_kg = 25.0", "mass_kg = 60.0", "payloads.grinder.mass_kg is 60, the calibration was made with 25"),
}


def calibrated(folder, told=True):
    """The bundled cell's text beside a calibration of everything, which was made for it."""
    text = re.sub(r"^\[robot\]$", '[robot]\ncalibration = "calibration.toml"', CELL.read_text(), flags=re.MULTILINE)
    cell, names = read_cell(CELL), (*NAMES, "wheel_wear")
    values = np.append(believed_theta(cell).values, 1e-7)
    everything = Calibration(cell.robot.name, names, values, np.diag((1e-6 + 1e-3 * np.abs(values)) ** 2))
    write_calibration(folder / "calibration.toml", made_for(everything, cell.tables, cell.robot) if told else everything)
    return text, everything


@pytest.mark.parametrize("table", EDITED)
def test_what_rests_on_an_edited_number_is_as_doubtful_as_the_cell_says(table, tmp_path):
    """A new wheel is not known as the old one was, and another load does not weigh what the last one did."""
    text, everything = calibrated(tmp_path)
    (tmp_path / "cell.toml").write_text(text)
    same = read_cell(tmp_path / "cell.toml")
    assert same.calibration.names == everything.names and not same.calibration.notices
    before, after, said = EDITED[table]
    assert text.count(before) == 1
    (tmp_path / "cell.toml").write_text(text.replace(before, after))
    cell = read_cell(tmp_path / "cell.toml")
    gone = set(RESTS_ON[table][1])
    assert set(everything.names) - set(cell.calibration.names) == gone
    (told,) = cell.calibration.notices
    assert re.search(said, told) and all(name in told for name in gone) and told.startswith("cell.toml: ")
    assert read_tracker_setup(tmp_path / "cell.toml").calibration.names == cell.calibration.names
    (tmp_path / "cell.toml").write_text(text.replace(before, after).replace('stl = "blade.stl"\n', ""))
    assert Finding(UNMEASURED, "robot.calibration", told) in examine(tmp_path / "cell.toml", Phases(None)).findings
    own = believed_theta(read_cell_without(tmp_path, text.replace(before, after)))
    theta, at = believed_theta(cell), [NAMES.index(name) for name in gone if name in NAMES]
    assert np.array_equal(theta.values[at], own.values[at]) and np.array_equal(theta.covariance[at], own.covariance[at])
    kept = [k for k, name in enumerate(NAMES) if name not in gone]
    assert np.array_equal(theta.covariance[np.ix_(kept, kept)], np.diag(np.diag(everything.covariance)[kept]))


def test_what_rests_on_a_table_that_is_gone_is_not_used(tmp_path):
    """Without its flange a holder is screwed on rigidly."""
    text, everything = calibrated(tmp_path)
    (tmp_path / "cell.toml").write_text(re.sub(r"\[force_flange\]\n(.+\n)+", "", text))
    cell = read_cell(tmp_path / "cell.toml")
    assert cell.flange is None
    assert set(everything.names) - set(cell.calibration.names) == set(RESTS_ON["force_flange"][1])
    assert "there is no force_flange, the calibration was made with one" in cell.calibration.notices[0]


def test_effects_that_come_on_top_of_an_edited_number_are_told(tmp_path):
    """A load that was found two kilograms heavier, and then weighed, was two kilograms heavier still, without a word."""
    text, _ = calibrated(tmp_path)
    text += '[[effects]]\neffect = "payload_mass"\nkg = 2.0\npayload = "grinder"\n'
    text += '[[effects]]\neffect = "backlash"\njoint = 2\nhalf_width_rad = 1e-4\n'
    (tmp_path / "cell.toml").write_text(text)
    assert not read_cell(tmp_path / "cell.toml").calibration.notices
    (tmp_path / "cell.toml").write_text(text.replace("mass_kg = 25.0", "mass_kg = 27.0"))
    _, told = read_cell(tmp_path / "cell.toml").calibration.notices
    assert "mass_kg is 27, the calibration was made with 25: still on top of that come the cell's effects payload_mass;" in told
    (tmp_path / "cell.toml").write_text(text.replace("radius_mm = 40.0", "radius_mm = 45.0"))
    assert len(read_cell(tmp_path / "cell.toml").calibration.notices) == 1
    text = text.replace("mass_kg = 25.0", "mass_kg = 27.0").replace('payload = "grinder"\n[', 'payload = "weight"\n[')
    (tmp_path / "cell.toml").write_text(text)  # what is found of another payload is not on top of this one
    assert not any("on top" in told for told in read_cell(tmp_path / "cell.toml").calibration.notices)


def test_what_was_calibrated_is_not_told_as_unmeasured(tmp_path):
    """It told the default spreads as believed beside a calibration that knows better."""
    text, _ = calibrated(tmp_path)
    (tmp_path / "cell.toml").write_text(text.replace('stl = "blade.stl"\n', ""))
    own = {"workpiece.xyz_mm", "workpiece.abc_deg", "wheel.centre_mm", "wheel.axis"}
    assert not own & {f.key for f in examine(tmp_path / "cell.toml", Phases(None)).of(UNMEASURED)}
    read_cell_without(tmp_path, text.replace('stl = "blade.stl"\n', ""))
    assert own <= {f.key for f in examine(tmp_path / "uncalibrated.toml", Phases(None)).of(UNMEASURED)}


def read_cell_without(folder, text):
    path = folder / "uncalibrated.toml"
    path.write_text(text.replace('calibration = "calibration.toml"\n', ""))
    return read_cell(path)


ARM = {
    "geometry": ("a_mm = [350.0, 1150.0,", "a_mm = [350.0, 1160.0,", "geometry.a_mm is [350, 1160, "),
    "weight": ("mass_kg = 231.49", "mass_kg = 331.49", "links.link2.mass_kg is 331.49, the calibration was made with 231.49"),
    "centre": ("com_mm = [41.0, 0.0, 197.37]", "com_mm = [41.0, 0.0, 207.37]", "links.link3.com_mm is [41, 0, 207.37]"),
}


@pytest.mark.parametrize("number", ARM)
def test_a_calibration_is_refused_beside_another_arm_of_that_name(number, tmp_path):
    """Its geometry would stand in that arm's place, without a word."""
    text, _ = calibrated(tmp_path)
    text = text.replace('"kr210_r2700_extra"', '"arm.toml"')
    (tmp_path / "cell.toml").write_text(text)
    arm = (CATALOGUE / "kr210_r2700_extra.toml").read_text()
    (tmp_path / "arm.toml").write_text(arm.replace("speed_deg_s = [123.0", "speed_deg_s = [100.0"))
    assert not read_cell(tmp_path / "cell.toml").calibration.notices
    before, after, said = ARM[number]
    assert arm.count(before) == 1
    (tmp_path / "arm.toml").write_text(arm.replace(before, after))
    for read in (read_cell, read_tracker_setup):
        with pytest.raises(BadInput, match=re.escape(said)):
            read(tmp_path / "cell.toml")
    (tmp_path / "arm.toml").write_text(arm)
    (tmp_path / "cell.toml").write_text(text.replace("[robot]", "[robot]\ngravity_direction = [1, 0, 0]"))
    with pytest.raises(BadInput, match=r"cell.toml, robot.model 'arm.toml': gravity_direction is \[1, 0, 0\]"):
        read_cell(tmp_path / "cell.toml")


def test_numbers_that_a_calibration_does_not_rest_on_may_change(tmp_path):
    text, everything = calibrated(tmp_path)
    text = text.replace("feed_mm_s = 40.0", "feed_mm_s = 60.0").replace("setpoint_N = 20.0", "setpoint_N = 25.0")
    (tmp_path / "cell.toml").write_text(
        text.replace("friction = 0.35", "friction = 0.3").replace("shore_A = 45", "shore_A = 45.0")
    )
    assert read_cell(tmp_path / "cell.toml").calibration.names == everything.names


def test_one_that_does_not_tell_its_cell_holds_whole(tmp_path):
    text, everything = calibrated(tmp_path, told=False)
    (tmp_path / "cell.toml").write_text(text.replace("radius_mm = 40.0", "radius_mm = 45.0"))
    assert read_cell(tmp_path / "cell.toml").calibration.names == everything.names
    assert "cell" not in read_calibration(tmp_path / "calibration.toml").provenance


def test_every_parameter_of_contact_and_load_rests_on_a_table():
    """But the blade's own stiffness, which is its material's, and the arm."""
    resting = {name for _, names in RESTS_ON.values() for name in names}
    assert set(NAMES) - resting == {*BLOCKS["mdh"], *BLOCKS["c"], "blade_stiffness_scale"}
