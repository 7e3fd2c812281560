"""cell.toml: conversion at the boundary, and one clear sentence for each way to get it wrong."""

import re
from pathlib import Path

import numpy as np
import pytest

from ocp.data import CELL
from ocp.model.cell import read_cell
from robots.errors import BadInput
from robots.robot import CATALOGUE

TEXT = (CELL).read_text()


def write(folder: Path, old: str = "", new: str = "") -> Path:
    assert old in TEXT
    path = folder / "cell.toml"
    path.write_text(TEXT.replace(old, new, 1) if old else TEXT)
    return path


def test_units_are_si_and_radians_inside():
    cell = read_cell(CELL)
    assert cell.wheel.radius == pytest.approx(0.040)
    assert cell.wheel.cover_modulus == pytest.approx(10 ** (0.0235 * 45 - 0.6403) * 1e6)
    assert cell.wheel.arc == pytest.approx((-np.pi / 6, np.pi / 6))
    assert cell.flange is not None and cell.flange.stiffness == pytest.approx(5600)
    assert cell.process.feed == pytest.approx(0.04)
    assert cell.process.turn_tolerance == pytest.approx(np.radians(30))
    assert cell.workpiece.T_flange_blade[:3, 3] == pytest.approx([0, 0, 0.2])
    assert cell.workpiece.payload.mass == 25.0
    assert cell.workpiece.clamp_normal @ np.array([0, 0, 0.02]) > cell.workpiece.clamp_offset


def test_what_a_flange_does_in_time_is_si_and_absent_where_nothing_is_said(tmp_path):
    still = read_cell(CELL).flange
    assert still is not None and not still.moves_in_time
    keys = 'bandwidth_hz = 10.0\ndelay_ms = 10.0\nfriction_N = 0.3\nsetpoint_output = "ANOUT[2]"\nsetpoint_scale = 0.02'
    flange = read_cell(write(tmp_path, "stroke_mm = 8.0", STROKE + keys)).flange
    assert flange is not None and flange.moves_in_time
    assert (flange.bandwidth, flange.delay, flange.friction) == pytest.approx((10.0, 0.01, 0.3))
    assert (flange.setpoint_output, flange.setpoint_scale) == ("ANOUT[2]", 0.02)
    assert read_cell(CELL).process.edge_force == 5.0


def test_prestons_coefficient_is_per_pascal(tmp_path):
    keys = "force_N = 20.0\npreston_um_mm2_per_N_m = 9.5\npreston_sd_um_mm2_per_N_m = 0.5\nfeed"
    process = read_cell(write(tmp_path, "force_N = 20.0\nfeed", keys)).process
    assert (process.preston, process.preston_sd) == pytest.approx((9.5e-12, 0.5e-12))
    assert read_cell(CELL).process.preston is None


def test_a_robot_file_is_looked_for_beside_the_cell_alone(tmp_path, monkeypatch):
    """One of the folder that the command was called in was taken in its place, another arm perhaps."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "arm.toml").write_text((CATALOGUE / "kr210_r2700_extra.toml").read_text())
    monkeypatch.chdir(tmp_path / "elsewhere")
    path = write(tmp_path, '"kr210_r2700_extra"', '"arm.toml"')
    with pytest.raises(BadInput, match="robot.model: .*arm.toml: cannot be read"):
        read_cell(path)


def test_every_cell_of_the_worlds_is_read(shared_data):
    cells = sorted((shared_data / "worlds").glob("*/cell.toml"))
    assert cells
    for path in cells:
        assert read_cell(path).wheel.radius == pytest.approx(0.15)


def test_a_clamp_above_turns_the_half_space(tmp_path):
    below = read_cell(write(tmp_path)).workpiece
    above = read_cell(write(tmp_path, 'clamp_side = "below"', 'clamp_side = "above"')).workpiece
    x = np.array([0.0, 0.0, 0.05])
    assert (below.clamp_normal @ x < below.clamp_offset) != (above.clamp_normal @ x < above.clamp_offset)


def test_a_clamp_plane_is_scaled_with_its_normal(tmp_path):
    new = "clamp_normal = [0, 3, 4]\nclamp_offset_mm = 50.0"
    piece = read_cell(write(tmp_path, 'clamp_axis = "z"\nclamp_to_mm = 10.0', new)).workpiece
    assert piece.clamp_normal == pytest.approx([0, 0.6, 0.8])
    assert piece.clamp_offset == pytest.approx(0.01)


def test_a_named_aerofoil_is_a_unit_direction_and_metres(tmp_path):
    assert read_cell(CELL).workpiece.aerofoil is None
    axis = "clamp_to_mm = 10.0\naerofoil_axis = [0, 3, 4]"
    named = read_cell(write(tmp_path, "clamp_to_mm = 10.0", f"{axis}\naerofoil_from_mm = -20\naerofoil_to_mm = 50.0")).workpiece
    assert named.aerofoil is not None and named.aerofoil.axis == pytest.approx([0, 0.6, 0.8])
    assert (named.aerofoil.low, named.aerofoil.high) == pytest.approx((-0.02, 0.05))
    whole = read_cell(write(tmp_path, "clamp_to_mm = 10.0", axis)).workpiece.aerofoil
    assert whole is not None and (whole.low, whole.high) == (-np.inf, np.inf)


STROKE = "stroke_mm = 8.0\n"
AXIS = "clamp_to_mm = 10.0\naerofoil_axis = "


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("clamp_to_mm = 10.0", AXIS + "[0, 0, 0]", "aerofoil_axis has length zero"),
        ("clamp_to_mm = 10.0", AXIS + "[0, 1]", r"workpiece.aerofoil_axis"),
        ("clamp_to_mm = 10.0", AXIS + "[0, inf, 1]", r"workpiece.aerofoil_axis\[1\] = inf"),
        ("clamp_to_mm = 10.0", AXIS + '"z"', "workpiece.aerofoil_axis = 'z'"),
        (
            "clamp_to_mm = 10.0",
            "clamp_to_mm = 10.0\naerofoil_from_mm = 5.0",
            "count along aerofoil_axis; give that direction too",
        ),
        (
            "clamp_to_mm = 10.0",
            AXIS + "[0, 0, 1]\naerofoil_from_mm = 60.0\naerofoil_to_mm = 60.0",
            "aerofoil_from_mm 60 must be below aerofoil_to_mm 60",
        ),
        (
            "clamp_to_mm = 10.0",
            AXIS + "[0, 0, 1]\naerofoil_to_mm = 1e7",
            "aerofoil_to_mm = 10000000.0: .*less than or equal to 1",
        ),
        ("clamp_to_mm = 10.0", AXIS + '[0, 0, 1]\naerofoil_to_mm = "60 mm"', "aerofoil_to_mm = '60 mm': .*number"),
        (
            "radius_mm = 40.0",
            "radius_mm = 40.0\nradios_mm = 3",
            r"line \d+: unknown key 'wheel.radios_mm'; known here: centre_mm",
        ),
        ("radius_mm = 40.0\n", "", r"key 'wheel.radius_mm' is missing"),
        ("radius_mm = 40.0", "wheel_radius_mm = 40.0", "unknown key 'wheel.wheel_radius_mm'; known here: centre_mm"),
        ("mass_kg = 90.0", "mass_kg = 90.0\ninertia_kg_m2 = [1.0, 1.0, 9.0]", "line 15: payloads.weight: .*no body has"),
        ("mass_kg = 90.0", "mass_kg = 90,5", "line 16, .*write 90.5 with a point"),
        ("radius_mm = 40.0", "radius_mm = -40.0", r"line 37: wheel.radius_mm = -40.0: .*greater than or equal to 1"),
        ("radius_mm = 40.0", 'radius_mm = "big"', r"wheel.radius_mm = 'big': .*number"),
        ("centre_mm = [1700, 0, 900]", "centre_mm = [1700, 0]", r"wheel.centre_mm\[2\]|wheel.centre_mm"),
        ("shore_A = 45", "shore_A = 45\ncover_modulus_MPa = 3.0", "exactly one of cover_modulus_MPa and shore_A"),
        ("compliant_joints = [2, 3]", "compliant_joints = [2, 3, 3]", "names a joint twice"),
        ("[1700, 0, 900]", "[1700, 0, nan]", r"wheel.centre_mm\[2\] = nan"),
        ('payload = "grinder"', 'payload = "drill"', "line 25: workpiece.payload 'drill' is not among .payloads. .bare, grinder"),
        ('model = "kr210_r2700_extra"', 'model = "kr2100"', "kr2100"),
        ('name = "bundled belt cell"', "name = ", "not valid TOML"),
        ("axis = [0, 1, 0]", "axis = [0, 0, 0]", "axis has length zero"),
        ("contact_direction = [-1, 0, 0]", "contact_direction = [0, 1, 0]", "across axis"),
        ("cover_thickness_mm = 12.0", "cover_thickness_mm = 80.0", "must be below radius_mm"),
        ('clamp_axis = "z"', 'clamp_axis = "w"', "workpiece.clamp_axis = 'w'"),
        ("stroke_mm = 8.0", STROKE + "bandwidth_hz = 0.0", "force_flange.bandwidth_hz = 0.0: .*greater than or equal to 0.1"),
        ("stroke_mm = 8.0", STROKE + "delay_ms = -1.0", "force_flange.delay_ms = -1.0"),
        ("stroke_mm = 8.0", STROKE + "friction_N = 1e9", "force_flange.friction_N = 1000000000.0"),
        ("stroke_mm = 8.0", STROKE + 'setpoint_output = "ANOUT[33]"\nsetpoint_scale = 0.01', "'ANOUT.33.' is no analogue output"),
        ("stroke_mm = 8.0", STROKE + 'setpoint_output = "ANOUT[1]"', "belong together"),
        ("stroke_mm = 8.0", STROKE + "setpoint_scale = 0.01", "belong together"),
        ("stroke_mm = 8.0", STROKE + 'setpoint_output = "ANOUT[1]"\nsetpoint_scale = 0.1', "times setpoint_scale is 2"),
        ("force_N = 20.0\nfeed", "force_N = 20.0\nedge_force_N = -5.0\nfeed", "process.edge_force_N = -5.0"),
        ("force_N = 20.0\nfeed", "force_N = 20.0\npreston_um_mm2_per_N_m = 0.0\nfeed", "process.preston_um_mm2_per_N_m = 0.0"),
        ("force_N = 20.0\nfeed", "force_N = 20.0\npreston_sd_um_mm2_per_N_m = 1.0\nfeed", "which is missing"),
    ],
)
def test_a_faulty_cell_is_refused_in_one_sentence(tmp_path, old, new, said):
    with pytest.raises(BadInput) as refusal:
        read_cell(write(tmp_path, old, new))
    message = str(refusal.value)
    assert "cell.toml" in message or "kr2100" in message
    assert "\n" not in message
    assert re.search(said, message), message


def test_a_missing_cell_and_a_missing_table_are_refused(tmp_path):
    with pytest.raises(BadInput, match="cannot be read"):
        read_cell(tmp_path / "none.toml")
    path = tmp_path / "cell.toml"
    path.write_text('[robot]\nmodel = "kr210_r2700_extra"\n')
    with pytest.raises(BadInput, match=r"table \[workpiece\] is missing"):
        read_cell(path)


@pytest.mark.parametrize(("key", "value"), [("radius_mm", '"40"'), ("feed_mm_s", "true"), ("force_N", "1e6"), ("tool_no", "1.0")])
def test_numbers_are_numbers_of_a_sound_size(tmp_path, key, value):
    text = re.sub(rf"(?m)^{key} = [^#\n]*", f"{key} = {value} ", TEXT)
    assert text != TEXT
    (tmp_path / "cell.toml").write_text(text)
    with pytest.raises(BadInput, match=key):
        read_cell(tmp_path / "cell.toml")
