"""An arm under a ceiling, on a wall, on a tilted base: weight, springs, effects, flange and the virtual cell fall the same way.

The independent judge is Pinocchio with gravity set here, or with the whole arm turned over and gravity left as it is.
"""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from ocp.data import CELL
from ocp.effects.catalogue import library
from ocp.effects.engine.evaluate import CONTACT_LAYOUT, ContactPlace, arm_columns, arm_rows, contact_columns
from ocp.model.cell import read_cell, read_tracker_setup
from ocp.model.force_balance import _flange_stroke
from ocp.plan.second_route import _flange
from ocp.simulate.twin.arm import arm_moments, make_arm
from ocp.simulate.twin.contact.grinder import make_mount
from ocp.simulate.twin.truth import draw_truth
from robots.calibration.fit import fit_campaign
from robots.calibration.layout import Choice
from robots.calibration.reading_model import ARM_NAMES, RowInputs, predict
from robots.calibration.solver import Campaign
from robots.compliance import compliance_from_stiffness
from robots.errors import BadInput
from robots.gravity import GRAVITY, weight_torques
from robots.kinematics import forward
from robots.pose import rot_x
from robots.reference_kinematics import elementary_frames
from robots.rigid_body import inverse_dynamics, rigid_body_model
from robots.robot import load_robot
from robots.tracker_readings import read_readings
from tests.support.twin_world import random_world

UPRIGHT = load_robot("kr210_r2700_extra")
COM = np.array([0.05, -0.02, 0.22])
MOUNTINGS = {"ceiling": (0.0, 0.0, 1.0), "wall": (1.0, 0.0, 0.0), "tilted": (0.3, -0.5, -0.8)}


def unit(direction):
    return np.array(direction) / np.linalg.norm(direction)


def mounted(direction, robot=UPRIGHT):
    return replace(robot, gravity_direction=unit(direction))


def postures(n, seed=0):
    return np.random.default_rng(seed).uniform(UPRIGHT.q_min, UPRIGHT.q_max, (n, 6))


def mounted_cell(folder, direction, *changes):
    """The bundled cell with another mounting, read from a file."""
    text = CELL.read_text().replace("[robot]\n", f"[robot]\ngravity_direction = {list(direction)}\n", 1)
    for a, b in changes:
        assert a in text
        text = text.replace(a, b, 1)
    path = folder / "cell.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("direction", MOUNTINGS.values(), ids=MOUNTINGS)
def test_weight_follows_the_mounting_as_pinocchio_says(direction):
    robot, q = mounted(direction), postures(20)
    model = rigid_body_model(UPRIGHT, 120.0, COM)
    model.gravity.linear = GRAVITY * unit(direction)
    expected = np.array([pin.computeGeneralizedGravity(model, model.createData(), row) for row in q])
    np.testing.assert_allclose(weight_torques(robot, q, 120.0, COM), -expected, atol=1e-7)
    still = np.zeros_like(q)
    np.testing.assert_allclose(inverse_dynamics(robot, 120.0, COM, q, still, still), expected, atol=1e-7)
    assert np.abs(weight_torques(robot, q, 120.0, COM) - weight_torques(UPRIGHT, q, 120.0, COM)).max() > 1e3


def test_gravity_upside_down_is_the_arm_turned_over():
    """Nothing of ours knows of the turned arm: its first joint is placed under a ceiling, gravity points down."""
    q = postures(20, 1)
    model = rigid_body_model(UPRIGHT, 120.0, COM)
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    model.jointPlacements[1] = pin.SE3(rot_x(np.pi), np.zeros(3)) * model.jointPlacements[1]
    flipped = np.array([pin.rnea(model, model.createData(), row, 0 * row, 0 * row) for row in q])
    np.testing.assert_allclose(weight_torques(mounted(MOUNTINGS["ceiling"]), q, 120.0, COM), -flipped, atol=1e-7)


@pytest.mark.parametrize("direction", MOUNTINGS.values(), ids=MOUNTINGS)
def test_derivatives_of_a_reading_follow_the_mounting(direction):
    robot, q, h = mounted(direction), postures(4, 2), 1e-5
    arm = np.concatenate([robot.mdh.ravel(), compliance_from_stiffness(robot.stiffness)])
    payload = np.tile([120.0, *COM], (4, 1))
    rows = RowInputs(q, payload, np.zeros((4, 6)), np.zeros((4, 3)), np.full((4, 3), 0.1))
    found = predict(robot, arm, rows)
    for k in (0, 4, 6, 13, 31, 32):
        step = h * np.eye(36)[k] * (1e-3 if k >= 30 else 1.0)
        slope = (predict(robot, arm + step, rows).point - predict(robot, arm - step, rows).point) / (2 * step[k])
        np.testing.assert_allclose(found.d_arm[:, :, k], slope, rtol=1e-3, atol=2e-4 * np.abs(slope).max(), err_msg=ARM_NAMES[k])


@pytest.mark.parametrize("direction", MOUNTINGS.values(), ids=MOUNTINGS)
def test_the_virtual_arm_bends_as_the_believed_one(direction, tmp_path):
    cell = read_cell(mounted_cell(tmp_path, direction))
    truth, q = draw_truth(cell, 1, mode="believed"), postures(10, 3)
    settled = make_arm(cell, truth).settled(arm_moments(q, "grinder", cell.tables.reference_temperature_C))
    mass, com = truth.payloads["grinder"]
    real = q + settled.bent[:, :6]
    np.testing.assert_allclose(settled.load_torque[:, :6], weight_torques(cell.robot, real, mass, com), atol=1e-4)
    assert np.abs(settled.bent).max() > 1e-4


def test_a_hanging_arm_is_calibrated_to_its_own_springs(tmp_path):
    """The virtual cell hangs under a ceiling; believed upright it would look as if the springs pushed."""
    path = mounted_cell(tmp_path, MOUNTINGS["ceiling"])
    truth = random_world(path, tmp_path / "world", 5, readings=120, blind=2)
    found = {}
    for name, robot in (("hanging", None), ("upright", UPRIGHT)):
        setup = read_tracker_setup(tmp_path / "world" / "cell.toml")
        readings = read_readings(tmp_path / "world" / "tracker.csv", setup.payloads, setup.instrument)
        arm = setup.robot if robot is None else replace(setup.robot, gravity_direction=robot.gravity_direction)
        fit = fit_campaign(Campaign(arm, readings, setup.payloads, setup.instrument), Choice(joints=(2, 3)))
        found[name] = fit.state.arm[31:33]
    planted = compliance_from_stiffness(truth.stiffness)[1:3]
    np.testing.assert_allclose(found["hanging"], planted, rtol=0.1)
    assert np.abs(found["upright"] / planted - 1).max() > 1.0


@pytest.mark.parametrize("direction", MOUNTINGS.values(), ids=MOUNTINGS)
def test_effects_of_weight_follow_the_mounting(direction):
    """All of it turned with the base is what the upright arm feels: link bending, an added payload, weight on the flange."""
    robot, q = mounted(direction), postures(6, 4)
    arm = np.concatenate([robot.mdh.ravel(), compliance_from_stiffness(robot.stiffness)])
    n = len(q)
    inputs = RowInputs(q, np.tile([80.0, *COM], (n, 1)), np.zeros((n, 6)), np.zeros((n, 3)), np.zeros((n, 3)))
    rows = arm_rows(robot, arm, inputs, ("grinder",))
    np.testing.assert_allclose(rows.block("tau"), weight_torques(robot, rows.block("q_real"), 80.0, COM), atol=1e-6)
    payload = library()["payload_mass"]
    joints = arm_columns(payload, 0, ({"payload": "loaded"},), rows).joints[0, :, :, 0]
    weightless = replace(robot, link_mass=np.zeros(7))
    np.testing.assert_allclose(joints, arm[30:] * weight_torques(weightless, rows.block("q_real"), 1.0, COM), atol=1e-12)
    # The tip of link 3 bears what hangs beyond the wrist centre, here the payload alone (links 5 and 6 weigh nothing).
    twist = arm_columns(library()["link_bending"], 3, ({"root_share": 0.0},), rows).twists[4][0, :, :, 0]
    frames = elementary_frames(robot, rows.block("q_real"))
    lever = frames[:, 6, :3, :3] @ COM + frames[:, 6, :3, 3] - frames[:, 4, :3, 3]
    moment = np.cross(lever, 80.0 * GRAVITY * unit(direction))
    axis = frames[:, 2, :3, 2]
    np.testing.assert_allclose(twist[:, 3:], (axis * moment).sum(axis=1, keepdims=True) * axis, atol=1e-6)


def test_weight_on_the_flange_falls_where_gravity_points(tmp_path):
    """Weight the flange does not compensate: the product's stroke, the second route's, the virtual cell's and the effect's."""
    flange = ("gravity_compensated = true", "gravity_compensated = false")
    cell = read_cell(mounted_cell(tmp_path, MOUNTINGS["tilted"], flange))
    assert cell.flange is not None and not cell.flange.gravity_compensated
    down, T = unit(MOUNTINGS["tilted"]), forward(cell.robot, postures(1, 5))[0]
    n = T[:3, :3] @ unit([0.9, 0.2, -0.3])
    push = n if cell.flange.axis is None else T[:3, :3] @ cell.flange.axis
    push = push * np.sign(push @ n)
    weight = cell.flange.carried_mass * GRAVITY * down @ push
    assert abs(weight) > 1.0
    share, (preload, *_) = _flange(cell, T @ cell.workpiece.T_flange_blade, n)
    assert share == pytest.approx(push @ n) and preload == pytest.approx(cell.flange.setpoint + weight)
    par = {"flange_setpoint_offset": ca.SX(0), "flange_stiffness": ca.SX(cell.flange.stiffness)}
    for reach in (0.1, cell.flange.stroke):  # the longer one keeps off its stops under that weight
        held = replace(cell, flange=replace(cell.flange, stroke=reach))
        stroke = ca.evalf(_flange_stroke(held, ca.SX(30.0), ca.SX(n), ca.SX(T), par))
        free = (30.0 * share - preload) / cell.flange.stiffness
        assert float(stroke) == pytest.approx(np.clip(free, -0.5 * reach, 0.5 * reach) * share, rel=1e-9)
    seen = SimpleNamespace(T_base_flange=T[None], setpoint=np.array([np.nan]))
    mount = make_mount(draw_truth(cell, 1, mode="believed"), cell, seen, np.array([0]), n[None])
    assert mount.preload[0] == pytest.approx(preload, rel=1e-3)
    row = CONTACT_LAYOUT.stack(1, {"push_axis": push[None], "n_base": n[None]})
    kg = contact_columns(library()["flange_gravity"], "push", 0, ({},), ContactPlace(0.15, 0.35, tuple(down)), row)[0, 0, 0]
    assert kg == pytest.approx(GRAVITY * (down @ push) / (push @ n))


def test_a_mounting_without_a_direction_is_refused(tmp_path):
    with pytest.raises(BadInput, match=r"cell\.toml.*gravity_direction has length zero"):
        read_cell(mounted_cell(tmp_path, (0.0, 0.0, 0.0)))
    assert (read_cell(mounted_cell(tmp_path, (0, 0, 20))).robot.gravity_direction == [0, 0, 1]).all()
