"""Slips that a cell file may hold are found by kind and key; the bundled cell has none."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from ocp.cell import interface
from ocp.cell.examination import DOUBT, KNOWN, MISTAKE, UNMEASURED, findings_of_frames, findings_of_tables
from ocp.cell.interface import check_cell, new_cell
from ocp.data import CELL
from ocp.model.cell import read_cell, read_tracker_setup
from trajectories.blade import read_blade


def changed(tmp_path, *changes):
    text = CELL.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    file = tmp_path / "cell.toml"
    file.write_text(text.replace('stl = "blade.stl"', f'stl = "{CELL.parent / "blade.stl"}"'))
    return file


@cache
def blade():
    return read_blade(CELL.parent / "blade.stl")


def found(file):
    setup, cell = read_tracker_setup(file), read_cell(file)
    return [*findings_of_tables(setup.tables, setup.robot), *findings_of_frames(cell, blade())]


def test_the_bundled_cell_has_neither_mistakes_nor_doubts():
    assert {f.kind for f in found(CELL)} == {UNMEASURED, KNOWN}


def test_how_large_the_wheel_is_stands_where_a_diameter_given_for_the_radius_is_seen():
    assert [(f.key, "80 mm across" in f.text) for f in found(CELL) if f.kind == KNOWN] == [("wheel.radius_mm", True)]


BACKLASH = '[[effects]]\neffect = "backlash"\njoint = 5\nhalf_width_rad = {}\n'
SLIPS = {
    "metres": (("[1700, 0, 900]", "[1.7, 0, 0.9]"), DOUBT, "wheel.centre_mm", "metres?"),
    "a contact aside": (
        ("contact_direction = [-1, 0, 0]", "contact_direction = [-1, 0.5, 0]"),
        DOUBT,
        "wheel.contact_direction",
        "leans 27 deg along the wheel's axis",
    ),
    "holder in metres": (("xyz_mm = [0, 0, 200]", "xyz_mm = [0, 0, 0.2]"), DOUBT, "workpiece.xyz_mm", "metres?"),
    "load in metres": (("com_mm = [10, 0, 160]", "com_mm = [0.01, 0, 0.16]"), DOUBT, "payloads.grinder.com_mm", "metres?"),
    "flange in N/m": (("_N_per_mm = 5.6", "_N_per_mm = 5600.0"), DOUBT, "force_flange.stiffness_N_per_mm", "N/m?"),
    "flange in N/um": (("_N_per_mm = 5.6", "_N_per_mm = 0.0056"), DOUBT, "force_flange.stiffness_N_per_mm", "N/um?"),
    "flange set elsewhere": (("setpoint_N = 20.0", "setpoint_N = 200.0"), DOUBT, "force_flange.setpoint_N", "out of its reach"),
    "flange heavier than all": (
        ("carried_mass_kg = 5.0", "carried_mass_kg = 50.0"),
        DOUBT,
        "force_flange.carried_mass_kg",
        "25 kg",
    ),
    "no payload named": (('payload = "grinder"', "# nothing named"), DOUBT, "workpiece.payload", "the first of [payloads]"),
    "floor in metres": (("[robot]", "[floor]\nz_mm = -0.4\n[robot]"), DOUBT, "floor.z_mm", "metres?"),
    "clamp in metres": (("clamp_to_mm = 10.0", "clamp_to_mm = 0.01"), DOUBT, "workpiece.clamp_to_mm", "metres?"),
    "nest in metres": (("T3 = [20, 170, 330]", "T3 = [0.02, 0.17, 0.33]"), DOUBT, "tracker.targets.T3", "metres?"),
    "nests at one place": (
        ("T2 = [-160, 40, 210]\nT3 = [20, 170, 330]", "T2 = [150, -50, 250]\nT3 = [150, -50, 250]"),
        DOUBT,
        "tracker.targets",
        "one line or place",
    ),
    "a nest twice": (
        ("T3 = [20, 170, 330]", "T3 = [20, 170, 330]\nT4 = [20, 170, 330]"),
        DOUBT,
        "tracker.targets.T4",
        "typed twice",
    ),
    "nests in one line": (("T3 = [20, 170, 330]", "T3 = [-5, -5, 230]"), DOUBT, "tracker.targets", "one line or place"),
    "inertia in kg mm2": (
        ("mass_kg = 25.0", "mass_kg = 25.0\ninertia_kg_m2 = [9e5, 9e5, 1.0]"),
        DOUBT,
        "payloads.grinder.inertia_kg_m2",
        "mm^2",
    ),
    "blade in MPa": (("[wheel]", "youngs_modulus_GPa = 0.114\n[wheel]"), DOUBT, "workpiece.youngs_modulus_GPa", "GPa"),
    "belt stands": (("belt_speed_m_s = 20.0", "belt_speed_m_s = 0.0"), DOUBT, "wheel.belt_speed_m_s", "nothing is ground"),
    "floor upside down": (("[robot]", "[floor]\nz_mm = 400.0\n[robot]"), DOUBT, "floor.z_mm", "negative"),
    "radians": (("abc_deg = [0, 0, 0]", "abc_deg = [1.5708, 0, 0]"), DOUBT, "workpiece.abc_deg", "radians"),
    "too heavy": (("mass_kg = 90.0", "mass_kg = 300.0"), MISTAKE, "payloads.weight", "above the 210 kg"),
    "no centre": (("com_mm = [0, 20, 200]", ""), UNMEASURED, "payloads.weight.com_mm", "drawing"),
    "blade not weighed": (("mass_kg = 25.0", "mass_kg = 0.01"), DOUBT, "payloads.grinder", "weigh holder and blade"),
    "load elsewhere": (("com_mm = [10, 0, 160]", "com_mm = [900, 0, 160]"), DOUBT, "payloads.grinder.com_mm", "another frame"),
    "two nests": (("T3 = [20, 170, 330]", ""), DOUBT, "tracker.targets", "2 nests"),
    "nest in the base": (("T3 = [20, 170, 330]", "T3 = [2020, 170, 330]"), DOUBT, "tracker.targets.T3", "base frame"),
    "wheel in the column": (("[1700, 0, 900]", "[200, 0, 400]"), DOUBT, "wheel.centre_mm", "robot's column"),
    "wheel's place for the blade's": (
        ("xyz_mm = [0, 0, 200]", "xyz_mm = [1700, 0, 900]"),
        DOUBT,
        "workpiece.xyz_mm",
        "1.9 m from",
    ),
    "arc in radians": (("arc_deg = [-30, 30]", "arc_deg = [-0.52, 0.52]"), DOUBT, "wheel.contact_arc_deg", "radians?"),
    "turn in radians": (
        ("turn_tolerance_deg = 30.0", "turn_tolerance_deg = 0.52"),
        DOUBT,
        "process.turn_tolerance_deg",
        "radians?",
    ),
    "kelvin": (("_temperature_C = 22.0", "_temperature_C = 295.0"), DOUBT, "reference_temperature_C", "kelvin?"),
    "springs in MN m": (("[2.0e6, 3.3e6,", "[2.0, 3.3,"), DOUBT, "robot.stiffness_Nm_per_rad", "MN m/rad?"),
    "a drum": (("width_mm = 15.0", "width_mm = 500.0"), DOUBT, "wheel.width_mm", "drum"),
    "away": (("contact_direction = [-1, 0, 0]", "contact_direction = [1, 0, 0]"), DOUBT, "wheel.contact_direction", "away"),
    "inverse": (("xyz_mm = [0, 0, 200]", "xyz_mm = [0, 0, -200]"), DOUBT, "workpiece.xyz_mm", "inverse lies before it"),
    "clamp holds nothing": (("clamp_to_mm = 10.0", "clamp_to_mm = -10.0"), MISTAKE, "workpiece.clamp_to_mm", "holds nothing"),
    "clamp holds all": (("clamp_to_mm = 10.0", "clamp_to_mm = 500.0"), MISTAKE, "workpiece.clamp_to_mm", "holds all"),
    "a huge effect": (("[robot]", BACKLASH.format(7.0) + "[robot]"), DOUBT, "effects[0].backlash", "over 10 times"),
    "a negative play": (("[robot]", BACKLASH.format(-1e-4) + "[robot]"), DOUBT, "effects[0].backlash", "never is"),
    "an effect twice": (("[robot]", 2 * BACKLASH.format(1e-4) + "[robot]"), DOUBT, "effects[1].backlash", "twice"),
    "clamp at the tip": (('clamp_side = "below"', 'clamp_side = "above"'), DOUBT, "workpiece.clamp_side", "turned?"),
}


@pytest.mark.parametrize("name", SLIPS)
def test_a_slip_is_found_where_it_stands(tmp_path, name):
    change, kind, key, words = SLIPS[name]
    before = {(f.kind, f.key) for f in found(CELL)}
    new = [f for f in found(changed(tmp_path, change)) if (f.kind, f.key) not in before]
    (told,) = [f for f in new if f.key == key]
    assert told.kind == kind and words in told.text
    # A blade behind the flange has its free end nearer too; what weighs nothing carries no flange; a load stays by the flange.
    assert len(new) == (2 if name in ("inverse", "blade not weighed", "wheel's place for the blade's") else 1)


def test_nests_at_one_place_of_different_links_are_none_typed_twice(tmp_path):
    before = {(f.kind, f.key) for f in found(CELL)}
    file = changed(tmp_path, ("T3 = [20, 170, 330]", "T3 = [20, 170, 330]\nT4 = { link = 3, xyz_mm = [20, 170, 330] }"))
    assert {(f.kind, f.key) for f in found(file)} == before


def test_what_is_measured_is_asked_for_no_longer(tmp_path):
    file = changed(tmp_path, ("friction = 0.35", "friction = 0.35\ncentre_sd_mm = 0.1"))
    keys = {f.key for f in findings_of_tables(read_tracker_setup(file).tables, read_cell(file).robot)}
    assert np.all([k not in keys for k in ("wheel.centre_mm",)])


def test_what_was_done_to_a_blade_and_a_load_of_unknown_inertia_are_told(tmp_path, monkeypatch):
    open_blade, solid = trimesh.load_mesh(CELL.parent / "blade.stl"), tmp_path / "scan.ply"
    keep = np.ones(len(open_blade.faces), bool)
    keep[np.argsort(open_blade.triangles_center[:, 2])[-30:]] = False
    open_blade.update_faces(keep)
    open_blade.export(solid)
    monkeypatch.setattr(interface, "placed_wheel", lambda *_: np.array([1.7, 0.0, 0.9]))  # 6 s
    made = new_cell("kr210_r2700_extra", blade=solid, out=tmp_path / "cell")
    assert any("closed" in notice for notice in made.notices)
    file = made.folder / "cell.toml"
    file.write_text(
        re.sub(r"clamp_offset_mm = [-\d.]+", "clamp_offset_mm = -9000.0", file.read_text())
    )  # holds nothing: nothing is laid
    told = check_cell(file)
    assert any(one.startswith("to know: workpiece.stl") and "closed" in one for one in told.notices)
    assert any("payloads.grinder.inertia_kg_m2" in one for one in told.notices)
    assert not told.sound and "1 mistake" in told.line and any("holds nothing" in one for one in told.notices)


def test_an_arm_that_plan_refuses_is_a_mistake_where_a_plan_is_meant():
    setup = read_tracker_setup(CELL)
    bare = replace(setup.robot, left_out=("shape", "stiffness"))
    told = [f for f in findings_of_tables(setup.tables, bare) if f.key == "robot.model"]
    assert [(f.kind, "no shape" in f.text) for f in told] == [(MISTAKE, True), (UNMEASURED, False)]
    alone = setup.tables.model_copy(update={"workpiece": None})
    assert [f.kind for f in findings_of_tables(alone, bare) if f.key == "robot.model"] == [DOUBT, UNMEASURED]


def test_an_arm_without_a_list_of_postures_is_a_mistake_beside_blade_and_wheel(tmp_path):
    told = check_cell(changed(tmp_path, ("kr210_r2700_extra", "ur10")))
    assert not told.sound and any(one.startswith("mistake: robot.model: axes 2 and 3") for one in told.notices)


def test_a_clamp_is_told_in_the_numbers_of_the_file(tmp_path):
    """The blade reaches from 0 to 120 mm along z; held above 1000 mm nothing of it is."""
    above = changed(tmp_path, ('clamp_side = "below"', 'clamp_side = "above"'), ("clamp_to_mm = 10.0", "clamp_to_mm = 1000.0"))
    (told,) = [f for f in found(above) if f.kind == MISTAKE]
    assert told.key == "workpiece.clamp_to_mm"
    assert "above 1000 mm, holds nothing" in told.text and "from 0.0 to 120.0 mm" in told.text


def test_what_no_line_can_be_laid_with_is_a_mistake(tmp_path):
    told = check_cell(changed(tmp_path, ('clamp_side = "below"', 'clamp_side = "above"')))
    assert not told.sound and any("mistake: workpiece: " in one and "leave" in one for one in told.notices)
    assert any("clamp_side" in one for one in told.notices)


def test_a_flange_that_no_line_can_be_ground_with_is_a_mistake_of_its_own_table(tmp_path):
    told = check_cell(changed(tmp_path, ("setpoint_N = 20.0", "setpoint_N = 1.0")))
    assert not told.sound and any(one.startswith("mistake: force_flange: ") and "usable" in one for one in told.notices)
