"""Planning with effects: tables of the cell, the model and its second route, a plan that takes an effect out."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ocp.calibrate.force.model import ForceModel, ForceRows
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.data import BLADE, CELL
from ocp.effects.cell_effects import effect_of, patch_effect_of
from ocp.effects.engine.symbolic import CONDITIONS
from ocp.model.cell import Cell, RunConditions, held_by_friction, history_notices, read_cell
from ocp.model.force_balance import build_model
from ocp.model.prepare import wheel_cover
from ocp.model.theta import NAMES, believed_theta, with_effects
from ocp.plan.__main__ import app
from ocp.plan.clearance import CollisionScene
from ocp.plan.passes.posture import find_seeds
from ocp.plan.passes.problem import WINDOW, PassProblem, approach_signs, with_direction
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.paths import PlanOptions
from ocp.plan.planning import cell_to_plan, corrected_for, patch_notices
from ocp.plan.second_route import BelievedRobot, _equilibrium, moved_arm
from robots.errors import BadInput
from robots.reference_kinematics import elementary_forward
from tests.plan.test_optimal_control import BAR
from tests.support.example_pass import LineLaw, bar_pass, bundled_cell
from tests.support.small_plan import STEP, called, refused, small_cell, undrawn
from trajectories.passes import reversed_path

pytestmark = pytest.mark.usefixtures("unprinted")

ARM = (
    {"effect": "backlash", "joint": 5, "half_width_rad": 2e-4},
    {"effect": "joint_compliance", "joint": 5, "rad_per_Nm": 3e-6},
    {
        "effect": "gravity_compensator",
        "stiffness_N_m": 5e4,
        "lever_link1_m": 0.2,
        "lever_arm_m": 0.4,
        "free_length": 1.0,
        "rest_rad": 0.1,
    },
    {"effect": "payload_mass", "kg": 8.0, "payload": "grinder"},
    {"effect": "link_bending", "joint": 2, "rad_per_Nm": 5e-8},
    {"effect": "link_thermal", "per_K": 1e-5},
    {"effect": "load_backlash", "joint": 3, "half_width_rad": 1e-4, "torque_Nm": 40.0},
    {"effect": "joint_coupling", "joint": 3, "ratio_rad": 1e-4, "source_joint": 2},
    {"effect": "tool_flex", "m_per_N": 2e-7},
    {"effect": "base_tilt", "rad": [1e-4, -5e-5, 8e-5], "at_s": 100.0},
    {"effect": "gear_harmonic", "joint": 2, "order": 40, "amplitude_rad": 1e-4, "phase_rad": 0.4},
    {
        "signal": "tracker",
        "kernel": "joint",
        "where": "q3 x q2",
        "joint": 3,
        "features": ["cos 2 q3 * sin 1 q2", "approach3"],
        "weights": [2e-4, 5e-5],
        "covariance": [[1e-12, 0.0], [0.0, 1e-12]],
        "range": {"q2": [-3.0, 1.0], "q3": [-1.0, 3.0]},
    },
    {
        "signal": "tracker",
        "kernel": "axis still",
        "where": "moment1",
        "joint": 1,
        "features": ["power 1 mx1"],
        "weights": [5e-5, -8e-5],
        "covariance": [[1e-12, 0.0], [0.0, 1e-12]],
        "range": {"mx1": [-9e3, 9e3]},
    },
)
FORCE_PATCH = {
    "signal": "force",
    "kernel": "force",
    "where": "q6 x s",
    "features": ["cos 2 q6", "travel * wave 1 s"],
    "weights": [0.8, 0.5],
    "covariance": [[1e-4, 0.0], [0.0, 1e-4]],
    "range": {"q6": [-6.3, 6.3], "s": [0.0, 0.4]},
}
WEAR = {"effect": "wheel_wear", "m_per_s": 1e-7, "sd": {"m_per_s": 1e-8}}


def cell_with(*tables: dict, **conditions: float) -> Cell:
    made = tuple(patch_effect_of(t) if "kernel" in t else effect_of(t) for t in tables)
    return replace(bundled_cell(), effects=made, conditions=RunConditions(**conditions))


def solver_of(cell: Cell) -> PassSolver:
    return PassSolver(cell, LineLaw(), with_effects(cell, believed_theta(cell)), ObjectiveWeights())


@cache
def plain() -> tuple[PassSolver, np.ndarray]:
    """A solver of the cell without effects, and its joints of the pass."""
    solver = solver_of(bundled_cell())
    return solver, solver.solve(problem()).q


@cache
def problem(force: float = 20.0) -> PassProblem:
    cell, path = bundled_cell(), bar_pass(n=24, force=force)
    seed = find_seeds(cell, CollisionScene(cell, BAR), LineLaw(), [path])[0][0]
    found = PassProblem.start(path, seed, np.tile([2e-6, 0, 0], (len(path.s), 1)))
    return with_direction(found, reversed_path(path)) if seed.direction < 0 else found


def off(solver: PassSolver, at: PassProblem, q: np.ndarray) -> np.ndarray:
    """Force error N that `solver`'s cell makes of joints q."""
    seen = solver.evaluate(at, q, at.path.force)
    return seen.residual * seen.stiffness


def test_a_plan_takes_effects_out_that_a_plain_one_suffers():
    known = solver_of(cell_with(*ARM, WEAR, warm=5.0, time=200.0, clock=1000.0))
    solver, naive = plain()
    at = known.with_approach(problem(), naive)
    assert at.approach is not None and np.abs(at.approach).max() == pytest.approx(1.0)
    suffered = off(known, at, naive)
    assert np.abs(suffered).min() > 0.5  # N: the plain plan is off all along
    solved = known.solve(at)
    assert np.abs(off(known, at, solved.q)).max() < 1e-3
    assert np.abs(off(solver, at, solved.q)).max() > 0.5


def test_the_arm_with_effects_equals_the_elementary_route():
    soft = {"effect": "joint_compliance", "joint": 2, "rad_per_Nm": 1e-6}  # bends under a heavier payload, too
    cell = cell_with(*ARM, soft, warm=5.0, time=200.0)
    solver, q = solver_of(cell), problem().seed.q[0] + 0.05 * np.sin(np.arange(24 * 6).reshape(24, 6))
    at = solver.with_approach(problem(), q)
    values = solver.theta.values
    bends = values[30:36] * np.array([float(j in cell.compliant_joints) for j in range(1, 7)])
    arm = BelievedRobot(cell.robot, bends, float(values[36]), values[37:40])
    still = q
    for _ in range(4):
        still = q + bends * arm.torque(still)
    _real, T, _weight = moved_arm(cell, arm, q, still, at.named_conditions(cell))
    seen = solver.evaluate(at, q, at.path.force)
    moved = T @ cell.workpiece.T_flange_blade
    believed = elementary_forward(cell.robot, still) @ cell.workpiece.T_flange_blade
    shift = np.abs(moved - believed)[:, :3, 3].max()
    assert shift > 1e-4
    # The model takes two fixed-point steps of the sag, this route four.
    assert np.abs(seen.T_base_blade - moved)[:, :3, 3].max() < 5e-3 * shift


def test_the_torque_at_the_contact_is_that_of_what_really_hangs():
    """Model and second route, with a payload 8 kg heavier than believed: the play that a contact turns on begins there."""
    cell = cell_with({"effect": "payload_mass", "kg": 8.0, "payload": "grinder"})
    model, w, q = build_model(cell, LineLaw()), problem().waypoints[:1], problem().seed.q[:1]
    at = problem().conditions(cell)[:1]
    values = believed_theta(cell).values
    tau = ca.Function("tau", [model.q, model.w, model.theta], [model.tau])(q[0], np.hstack([w, at])[0], values)
    bends = values[30:36] * np.array([float(j in cell.compliant_joints) for j in range(1, 7)])
    arm, heavy = (BelievedRobot(cell.robot, bends, float(values[36]) + more, values[37:40]) for more in (0.0, 8.0))
    named = {name: value[:1] for name, value in problem().named_conditions(cell).items()}
    seen = moved_arm(cell, arm, q, q + bends * arm.torque(q), named)[2]
    wanted = heavy.torque(q)
    assert np.abs(wanted - arm.torque(q)).max() > 50.0
    assert np.asarray(tau).ravel() == pytest.approx(wanted[0], abs=2.0)
    assert seen == pytest.approx(wanted, abs=2.0)


def test_the_second_route_finds_the_force_where_play_turns_over_under_the_push():
    """Plain Newton without the effect's own slope swings ever wider there."""
    cell, lever, play, torque, weight = read_cell(CELL), 0.4, 8e-4, 3.0, -8.0
    cell = replace(
        cell, flange=None, effects=(effect_of({"effect": "load_backlash", "joint": 5, "half_width_rad": play, "torque_Nm": 3.0}),)
    )
    cover, shape, chain = wheel_cover(cell), LocalShape(1 / cell.wheel.radius + 5.0, 0.5), 1e-6

    def added(F, parts, slopes, rubbed, pushed):
        return -lever * play * (np.tanh((weight + pushed[:, 4]) / torque) - np.tanh(weight / torque))

    push = np.array([0.0, 0.0, 0.0, 0.0, lever, 0.0])
    sample = SimpleNamespace(T=np.eye(4)[None], n=np.array([[1.0, 0.0, 0.0]]), overlap=added)
    linear = [np.array([chain, chain, *push])] * 3
    depth = solve_force(cover, 20.0, shape).indentation + 40.0 * chain - added(20.0, 0, 0, 0, 20.0 * push[None])[0]
    for begun in (17.0, 20.5, 24.0):
        F, rate, _ = _equilibrium(cell, cover, shape, sample, depth, begun, linear, None)
        assert F == pytest.approx(20.0, abs=0.02), begun
        plain = 1.0 / solve_force(cover, 20.0, shape).stiffness + 2.0 * chain
        assert rate == pytest.approx(plain + lever**2 * play / torque, rel=0.05)


def test_overlap_and_push_of_effects_shift_the_balance_by_what_they_are():
    at, (solver, q) = problem(), plain()
    before = solver.evaluate(at, q, at.path.force)
    worn = solver_of(cell_with(WEAR, clock=1000.0)).evaluate(at, q, at.path.force)
    assert worn.residual - before.residual == pytest.approx(np.full(24, -1e-4), abs=1e-9)
    assert worn.delta == pytest.approx(before.delta)
    heavy = solver_of(cell_with({"effect": "flange_gravity", "kg": 0.4})).evaluate(at, q, at.path.force)
    n_base = np.einsum("kij,kj->ki", before.T_base_blade[:, :3, :3], at.path.n)
    stroke = -0.4 * 9.81 * n_base[:, 2] / solver.cell.flange.stiffness
    assert heavy.residual - before.residual == pytest.approx(stroke, abs=1e-9)
    soft = solver_of(cell_with({"effect": "flange_stiffness", "scale": -0.2})).evaluate(at, q, at.path.force + 3.0)
    plain_up = solver.evaluate(at, q, at.path.force + 3.0)
    assert soft.residual - plain_up.residual == pytest.approx(plain_up.parts[:, 0] * (1 - 1 / 0.8), abs=1e-9)
    patched = solver_of(cell_with(FORCE_PATCH, clock=1000.0)).evaluate(at, q, at.path.force)
    turned, along = np.cos(2 * q[:, 5]), np.cos(np.pi * (at.path.start + at.path.s) / 0.4) / (1 + 1 / 16)
    stroke = (0.8 * turned + 0.5 * at.seed.direction * along) / solver.cell.flange.stiffness
    assert patched.residual - before.residual == pytest.approx(stroke, abs=1e-9)


@pytest.mark.parametrize("joint", [3, 5])
def test_the_contact_bends_a_joint_beside_its_load(joint):
    """By 3 N more as much as in a cell whose robot has that joint softer; what weight does there cancels."""
    at, (solver, q) = problem(), plain()
    theta = believed_theta(solver.cell)
    softer = replace(theta, values=theta.values + 1e-6 * (np.array(NAMES) == f"c{joint}"))
    soft = solver_of(cell_with({"effect": "joint_compliance", "joint": joint, "rad_per_Nm": 1e-6}))
    solvers = (solver, soft, PassSolver(solver.cell, LineLaw(), softer, ObjectiveWeights()))
    force = at.path.force
    plain_more, more, wanted = (s.evaluate(at, q, force + 3.0).residual - s.evaluate(at, q, force).residual for s in solvers)
    assert more - plain_more == pytest.approx(wanted - plain_more, rel=0.02)
    assert np.abs(more - plain_more).min() > 1e-7


def test_the_sd_of_an_effect_enters_that_of_the_force():
    sure, unsure = (cell_with(WEAR | {"sd": {"m_per_s": sd}}, clock=1000.0) for sd in (0.0, 4e-7))
    at, (_solver, q) = problem(), plain()
    less, more = (solver_of(c).evaluate(at, q, at.path.force) for c in (sure, unsure))
    added = np.sqrt(more.force_sd**2 - less.force_sd**2)
    assert added == pytest.approx(4e-4 * more.stiffness, rel=1e-6)


def test_friction_of_the_flange_is_doubt_of_the_force_and_no_more():
    at, (solver, q) = problem(), plain()
    sticky = cell_with({"effect": "flange_friction", "N": 0.6})
    rough = replace(sticky, flange=replace(sticky.flange, friction=0.2))
    before = solver.evaluate(at, q, at.path.force)
    for cell, held in ((sticky, 0.6), (rough, 0.8)):
        told = solver_of(cell).evaluate(at, q, at.path.force)
        assert told.residual == pytest.approx(before.residual, abs=1e-12)
        assert told.force_sd == pytest.approx(np.hypot(before.force_sd, held), rel=1e-9)
    assert held_by_friction(replace(rough, flange=None)) == 0.0
    assert history_notices(solver.cell, "x") == []
    (told,) = history_notices(rough, "no part of the plan")
    assert "flange_friction" in told and told.endswith("no part of the plan")


def test_a_plan_tells_what_it_does_not_act_on(tmp_path):
    (tmp_path / "blade.stl").write_bytes(BLADE.read_bytes())
    text = CELL.read_text() + '\n[[effects]]\neffect = "flange_friction"\nN = 0.6\n'
    (tmp_path / "cell.toml").write_text(text)
    _, told = cell_to_plan(tmp_path / "cell.toml", tmp_path / "blade.stl", PlanOptions())
    assert "decides of flange_friction in cell.toml: no part of the plan; friction of the flange is in" in told[0]


def test_a_force_log_of_a_cell_with_effects_sees_them():
    cell = cell_with(WEAR)
    at, (solver, q) = problem(), plain()
    n = len(q)

    class Law(LineLaw):
        process_force = 20.0

    rows = [
        ForceRows(q, np.hstack([at.waypoints, replace_clock(at, cell, clock)]), np.full(n, 20.0), np.ones(n), np.ones(n, bool))
        for clock in (0.0, 2000.0)
    ]
    model = ForceModel(cell, Law({"force": (2.0, 60.0), "kxx": (1.0, 1e4)}))  # type: ignore[arg-type]
    theta = believed_theta(cell).values
    F = [model.force(r, theta) for r in rows]
    assert np.abs(F[0] - 20.0).max() < 1e-2
    stiffness = solver.evaluate(at, q, at.path.force).stiffness
    assert F[1] - F[0] == pytest.approx(-2e-4 * stiffness, rel=0.02)


def replace_clock(at: PassProblem, cell: Cell, clock: float) -> np.ndarray:
    conditions = at.conditions(replace(cell, conditions=RunConditions(clock=clock)))
    assert CONDITIONS.block(conditions, "clock") == pytest.approx(np.full((len(conditions), 1), clock))
    return conditions


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.02, 0.08), st.integers(20, 200), st.floats(0.5, 50.0))
def test_signs_of_motion_go_through_zero_where_an_axis_turns_back(turn, n, slope):
    s = np.linspace(0.0, 0.06, n)
    q = np.zeros((n, 6))
    q[:, 1] = slope * np.abs(s - turn)
    q[:, 2] = -slope * s
    signs = approach_signs(q, s)
    assert (signs[:, 2] == pytest.approx(-1.0)) and (signs[:, 0] == 0.0).all()
    clear = np.abs(s - turn) > WINDOW + 0.06 / (n - 1)
    assert signs[clear, 1] == pytest.approx(np.sign(s - turn)[clear])
    assert (np.diff(signs[:, 1]) >= -1e-12).all() and np.abs(signs).max() <= 1.0 + 1e-12


REFUSED = {
    "unknown": ('effect = "backlas"', "unknown effect 'backlas'; near it: backlash"),
    "own": ('effect = "zzz"', "one of your own is found in the folder that GRINDPLAN_EFFECTS names; known: air"),
    "joint": ('effect = "backlash"\nhalf_width_rad = 1e-4', "'backlash': joint is missing; give one of 1, 2, 3, 4, 5, 6"),
    "far": ('effect = "link_bending"\njoint = 5\nrad_per_Nm = 1e-8', "joint = 5 is not possible; give one of 2, 3"),
    "none": ('effect = "wheel_wear"\njoint = 2\nm_per_s = 1e-7', "'wheel_wear' belongs to no joint; remove joint"),
    "key": ('effect = "wheel_wear"\nm = 1e-7', "has no key 'm'; its keys are m_per_s"),
    "missing": ('effect = "friction_windup"\njoint = 2\nbase_rad = 1e-4', "needs the key 'per_Nm'; add it"),
    "text": ('effect = "wheel_wear"\nm_per_s = "fast"', "m_per_s = 'fast' is not a number"),
    "vector": ('effect = "base_tilt"\nrad = [1e-4, 0.0]\nat_s = 1.0', "rad = [0.0001, 0.0] is not a list of 3 numbers"),
    "nan": ('effect = "wheel_wear"\nm_per_s = nan', "has a value that is not a finite number"),
    "sd": ('effect = "wheel_wear"\nm_per_s = 1e-7\nsd = { m_per_s = -1.0 }', "sd.m_per_s = -1.0 is not zero or above"),
    "sd key": ('effect = "wheel_wear"\nm_per_s = 1e-7\nsd = { N = 1.0 }', "sd.N, which is no value of this table"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_faulty_table_is_refused_in_a_sentence(case, tmp_path):
    table, sentence = REFUSED[case]
    file = small_cell(tmp_path, blade=False)
    text = file.read_text().rstrip() + "\n"
    file.write_text(f"{text}[[effects]]\n{table}\n")
    told = refused("--cell", str(file), "--out", str(tmp_path / "plan"), *STEP)
    assert told.code == 2 and "Traceback" not in told.err
    assert not (tmp_path / "plan").exists()
    said = " ".join(told.err.split())
    assert sentence in said and f"line {text.count(chr(10)) + 1}: effects[0]" in said


def test_a_faulty_patch_is_refused_in_a_sentence(tmp_path):
    file = small_cell(tmp_path, blade=False)
    text = file.read_text().rstrip() + "\n"
    table = 'signal = "tracker"\nwhere = "q3"\nkernel = "joint"\nfeatures = ["wave 1 q3"]\nweights = [1e-4]\ncovariance = [[0.0]]'
    file.write_text(f"{text}[[patches]]\n{table}\n")
    with pytest.raises(BadInput, match=rf"line {text.count(chr(10)) + 1}: patches\[0\]: .*needs a joint"):
        read_cell(file)


def test_a_patch_says_where_passes_leave_what_it_was_fitted_to(tmp_path):
    file = small_cell(tmp_path)
    table = 'signal = "tracker"\nwhere = "q3"\nkernel = "joint"\njoint = 3\nfeatures = ["wave 1 q3"]\nweights = [1e-4]\n'
    file.write_text(f"{file.read_text()}\n[[patches]]\n{table}covariance = [[0.0]]\nrange = {{ q3 = [1.0, 1.5] }}\n")
    q = np.zeros((100, 6))
    q[:, 2] = np.linspace(1.0, 2.5, 100)  # its wave is half a radian long
    solved = SimpleNamespace(solution=SimpleNamespace(q=q))
    (told,) = patch_notices(read_cell(file), [solved])  # type: ignore[list-item]
    assert told.startswith("33 of 100 waypoints lie outside what a patch over q3 of cell.toml was fitted to (q3 57 to 86 deg)")
    q[:, 2] = 1.2
    assert patch_notices(read_cell(file), [solved]) == []  # type: ignore[list-item]


def test_the_command_plans_a_corrected_cell_and_its_text_holds_the_force(tmp_path):
    file = small_cell(tmp_path)
    text = file.read_text() + (
        '\n[[effects]]\neffect = "backlash"\njoint = 2\nhalf_width_rad = 1e-4\nsd = { half_width_rad = 2e-6 }\n'
        '[[effects]]\neffect = "wheel_wear"\nm_per_s = 2e-7\n'
        '[[patches]]\nsignal = "tracker"\nwhere = "q3"\nkernel = "joint"\njoint = 3\nfeatures = ["wave 1 q3", "wave 2 q3"]\n'
        "weights = [2e-4, -1e-4]\ncovariance = [[1e-11, 0.0], [0.0, 1e-11]]\nrange = { q3 = [-0.5, 2.5] }\n"
        '[[patches]]\nsignal = "force"\nwhere = "q6 x s"\nkernel = "force"\nfeatures = ["cos 2 q6", "travel * wave 1 s"]\n'
        "weights = [0.8, 0.5]\ncovariance = [[1e-4, 0.0], [0.0, 1e-4]]\nrange = { q6 = [-6.3, 6.3], s = [0.0, 0.4] }\n"
        "[conditions]\nclock_s = 900\ntemperature_C = 27.0\n"
    )
    file.write_text(text)
    with undrawn():
        told = called(app, tmp_path, "--cell", "cell.toml", *STEP)
    assert told.code == 0, told.err
    summary = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert summary["status"] == "safe" and summary["force_error_N"] < 0.1
    cell = read_cell(Path(file))
    assert [e.name for e in cell.effects] == [
        "backlash",
        "wheel_wear",
        "patch joint|q3|2|0.0002",
        "patch force|q6 x s|2|0.8",
    ] and cell.conditions.clock == 900.0


def test_a_plan_names_what_its_commands_are_corrected_for():
    """Not what only remembers, which no command can take out, nor the sensor's own."""
    told = [
        {"effect": "encoder_scale", "joint": 3, "scale": 3e-4},
        {"effect": "channel_delay", "s": 0.004},
        {"effect": "sensor_bias", "N": 0.5},
        {"effect": "wheel_wear", "m_per_s": 1e-9},
    ]
    cell: Any = SimpleNamespace(path=Path("cell.toml"), effects=[effect_of(one) for one in told])
    assert corrected_for(cell) == ["the commands are corrected for what cell.toml names: encoder_scale of joint 3, wheel_wear"]
    cell.effects = []
    assert corrected_for(cell) == []
