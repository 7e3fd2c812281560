"""A plan for a holder without a force flange: the arm's own error is force, and the plan says so."""

import csv
import json

import numpy as np

from ocp.data import CELL
from ocp.plan.__main__ import app
from tests.support.small_plan import STEP, called, small_cell, undrawn

FLANGE = CELL.read_text().split("[force_flange]")[1].split("\n[")[0]


def test_a_rigid_mount_holds_the_force_on_paper_and_tells_what_the_arm_makes_of_it(tmp_path):
    cell = small_cell(tmp_path, {f"[force_flange]{FLANGE}": ""})
    # The contact's own push turns it on: model and independent route have to say the same of that.
    cell.write_text(
        cell.read_text() + '\n[[effects]]\neffect = "load_backlash"\njoint = 5\nhalf_width_rad = 8e-4\ntorque_Nm = 60.0\n'
    )
    with undrawn():
        told = called(app, tmp_path, "--cell", str(cell), *STEP)
    assert told.code == 0, told
    content = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert content["grades"]["move"]["grade"] == "green" and content["grades"]["force"]["grade"] != "green"
    with (tmp_path / "plan" / "plan.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["phase"] == "pass"]
    force, sd = (np.array([float(row[name]) for row in rows]) for name in ("fn_N", "fn_sd_N"))
    assert np.abs(force - 20.0).max() < 0.5
    # An uncalibrated arm is off by about a millimetre, and nothing but cover and blade gives way.
    assert sd.min() > 10.0 and content["force_sd_max_N"] >= 0.99 * sd.max()
    assert {row["setpoint_N"] for row in rows} == {""}
