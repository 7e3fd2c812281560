"""The limits of a measurement: for every rule of ocp/poses/rules.py one case just inside and one just outside.

WRIST_RANGE refuses nothing: it says how far postures are drawn.
"""

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ocp.poses.program as measuring
from ocp.plan.rules import ARM_MARGIN
from ocp.poses import candidates, rules
from ocp.poses.candidates import MeasuringScene, free_postures
from robots.errors import Infeasible
from robots.gravity import weight_torques
from robots.kinematics import forward
from robots.tracker_readings import Hanging, Nest
from tests.poses.test_measuring_program import ANGLE, campaign
from tests.support.block_blade import BLOCK
from tests.support.example_pass import bundled_cell
from tests.support.house import ROOT
from trajectories.program.program import Wait

APPROACH = np.radians(2.0)
READY = np.radians([3.0, -80.0, 95.0, 10.0, 50.0, 20.0])
HOME = np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0])


@pytest.fixture(scope="module")
def cell():
    return bundled_cell()


@pytest.mark.parametrize("name", [name for name in vars(rules) if name.isupper()])
def test_a_rule_says_its_unit_what_it_guards_and_why_and_is_used(name):
    body = ast.parse(Path(str(rules.__file__)).read_text()).body
    at = next(i for i, node in enumerate(body) if isinstance(node, ast.Assign) and node.targets[0].id == name)
    text = body[at + 1].value.value
    assert text.startswith("[") and "Guards:" in text and "Reason:" in text
    assert any(name in p.read_text() for p in (ROOT / "ocp" / "poses").rglob("*.py") if p.name != "rules.py")
    assert name in Path(__file__).read_text(), f"{name}: no case just inside and outside, and no word why"


# -- postures ------------------------------------------------------------------------------------------------------


@pytest.fixture
def kept(monkeypatch):
    """Which of postures q (k, 6), given as those near the zone, could be read; and all that were drawn at random."""

    def judged(cell, q, payloads=()):
        monkeypatch.setattr(candidates, "near_zone", lambda *_: q)
        scene: Any = SimpleNamespace(clearances=lambda q, in_contact: (np.ones(len(q)), []))
        found, _, near = free_postures(cell, scene, None, list(payloads), APPROACH, np.random.default_rng(0))
        return [bool((found[near] == one).all(axis=1).any()) for one in q], found[~near]

    return judged


@pytest.mark.parametrize("axis", range(6))
def test_a_posture_too_near_the_end_of_an_axis_is_none(cell, kept, axis):
    room = rules.AXIS_MARGIN + APPROACH
    ends = [(cell.robot.q_min[axis] + room, 1.0), (cell.robot.q_max[axis] - room, -1.0)]
    q = np.tile(READY, (4, 1))
    q[:, axis] = [end + inward * more for end, inward in ends for more in (1e-9, -1e-9)]
    assert kept(cell, q)[0] == [True, False, True, False]


@pytest.mark.parametrize("axis", [1, 2])
def test_a_posture_that_weight_nearly_takes_an_axis_from_is_none(cell, kept, axis):
    load = Hanging(150.0, np.array([0.0, 0.1, 0.2]))
    held = np.abs(weight_torques(cell.robot, READY, load.mass, load.com)[0, axis])
    for more, sound in ((-1e-6, True), (1e-6, False)):
        torque_max = np.where(np.arange(6) == axis, held / (rules.HOLDING_SHARE + more), cell.robot.torque_max)
        weak = replace(cell, robot=replace(cell.robot, torque_max=torque_max))
        assert kept(weak, READY[None], [load])[0] == [sound]
        assert kept(weak, READY[None])[0] == [True]


def test_axes_4_and_6_are_drawn_within_their_range(cell, kept):
    wrist = kept(cell, READY[None])[1][:, [3, 5]]
    assert (cell.robot.q_max[[3, 5]] > rules.WRIST_RANGE + 0.1).all()
    assert (np.abs(wrist) <= rules.WRIST_RANGE).all() and (np.abs(wrist).max(axis=0) > 0.99 * rules.WRIST_RANGE).all()


def test_a_bracket_too_near_the_wheel_is_not_free(cell):
    """The wheel stands square before the end of the bracket."""
    out, length = np.array([1.0, 0.0, 0.0]), 0.4
    flange = forward(cell.robot, HOME[None])[0]
    for more in (1e-5, -1e-5):
        away = length + rules.BRACKET_RADIUS + ARM_MARGIN + more + 0.5 * cell.wheel.width
        wheel = replace(cell.wheel, centre=flange[:3, 3] + away * flange[:3, :3] @ out, axis=flange[:3, :3] @ out)
        scene = MeasuringScene(replace(cell, wheel=wheel), BLOCK, {"T1": Nest(6, length * out)})
        found = scene.clearance(HOME[None], in_contact=False)
        assert set(found.names) == {"reflector T1", "wheel"} and (found.value > 0) == (more > 0)


# -- the program read back -----------------------------------------------------------------------------------------


@pytest.fixture
def read_back(cell, tmp_path, monkeypatch):
    """A program of one pose, approached from ANGLE, is held against another campaign and another angle."""
    monkeypatch.setattr(measuring, "is_free", lambda scene, points: True)
    program = measuring.measuring_program(cell, campaign(), ANGLE, Wait(), "poses", 20, set())
    no_scene: Any = None

    def judged(angle=ANGLE, **changes):
        stop = replace(campaign().stops[0], **changes)
        measuring.write_and_check(cell, no_scene, program, replace(campaign(), stops=[stop]), angle, tmp_path)

    return judged


def test_an_approach_that_is_too_short_is_refused(read_back):
    read_back(angle=ANGLE / (rules.APPROACH_SHARE + 1e-5))
    with pytest.raises(Infeasible, match="reading 1 was planned, or comes from another side"):
        read_back(angle=ANGLE / (rules.APPROACH_SHARE - 1e-5))


@pytest.mark.parametrize("axis", range(6))
def test_an_axis_that_comes_from_another_side_is_refused(read_back, axis):
    sign = campaign().stops[0].sign * np.where(np.arange(6) == axis, -1, 1)
    with pytest.raises(Infeasible, match="reading 1 was planned, or comes from another side"):
        read_back(sign=sign)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_robot_that_stands_elsewhere_is_refused(read_back, side):
    one, q = np.eye(6)[4], campaign().stops[0].q
    read_back(q=q + side * 0.999 * rules.READ_BACK_TOLERANCE * one)
    with pytest.raises(Infeasible, match="is not where reading 1 was planned"):
        read_back(q=q + side * 1.001 * rules.READ_BACK_TOLERANCE * one)
