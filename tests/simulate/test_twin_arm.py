"""The virtual arm against closed forms, the believed model, and the catalogue's formulas written a second time."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest

from ocp.model.cell import read_cell
from ocp.simulate.twin.arm import AxisState, arm_moments, gear_ratios, make_arm, motor_side
from ocp.simulate.twin.dataset import delayed, joint_log
from ocp.simulate.twin.planting import ARM_KINDS, parse_effect
from ocp.simulate.twin.truth import draw_truth
from robots.calibration.reading_model import RowInputs, predict_points
from robots.errors import BadInput, Infeasible
from robots.gravity import GRAVITY, weight_torques
from robots.reference_kinematics import elementary_forward, elementary_frames
from robots.rigid_body import inverse_dynamics
from robots.robot import load_robot
from tests.support.reference_arm import elementary_weight_torques, point_compliance

CELL = read_cell(Path(__file__).parents[2] / "ocp" / "data" / "cell.toml")
ROBOT = CELL.robot
T0 = CELL.tables.reference_temperature_C
LOW, HIGH = np.radians([-90, -120, -20, -170, -115, -170]), np.radians([90, -20, 140, 170, 115, 170])


def postures(n, seed=0):
    return np.random.default_rng(seed).uniform(LOW, HIGH, (n, 6))


def believed(*effects, **changes):
    return replace(draw_truth(CELL, 1, [parse_effect(e) if isinstance(e, str) else e for e in effects], "believed"), **changes)


# -- statics ---------------------------------------------------------------------------------------------------------


def test_lines_of_ripple_add_up():
    q = postures(5)
    lines = np.array([[[2e-5, 7.0, 0.3], [1e-5, 31.0, 1.1], [0.0, 0.0, 0.0]]] * 6)
    wanted = q + 2e-5 * np.cos(7 * q + 0.3) + 1e-5 * np.cos(31 * q + 1.1)
    state = AxisState(q, np.zeros((5, 6)), np.zeros((5, 6)), ROBOT)
    np.testing.assert_allclose(motor_side(believed(ripple=lines), state), wanted, atol=1e-15)


def test_links_weigh_where_their_centres_are():
    """Against the torques of Newton and Euler of a robot that is told where they are."""
    shift = np.random.default_rng(2).normal(size=(7, 3)) * 0.05
    truth, q = believed(mass_shift=shift, mass_scale=1.1 * np.ones(7), stiffness=np.zeros(6)), postures(4)
    robot = replace(ROBOT, link_com=ROBOT.link_com + shift, link_mass=1.1 * ROBOT.link_mass)
    got = make_arm(CELL, truth).settled(arm_moments(q, "bare", T0)).load_torque[:, :6]
    np.testing.assert_allclose(got, weight_torques(robot, q), rtol=1e-6, atol=0.05)
    assert np.abs(weight_torques(ROBOT, q) - got).max() > 50.0


def test_one_joint_under_a_hanging_weight_bends_as_the_closed_form_says():
    """Arm stretched forward, massless, joint 2 alone gives: x = c m g (horizontal lever turned by x)."""
    c, mass, com = 4e-6, 120.0, np.array([0.03, -0.02, 0.25])
    truth = believed(
        stiffness=np.array([0, 1 / c, 0, 0, 0, 0]), mass_scale=np.zeros(7), payloads={"w": (mass, com)}, bends=np.ones(6)
    )
    q = np.zeros((1, 6))
    settled = make_arm(CELL, truth).settled(arm_moments(q, "w", T0))
    T = elementary_frames(ROBOT, q)[0]
    lever = T[6, :3, :3] @ com + T[6, :3, 3] - T[1, :3, 3]
    length, angle = np.hypot(lever[0], lever[2]), np.arctan2(lever[2], lever[0])
    x = 0.0
    for _ in range(50):
        x = c * mass * GRAVITY * length * np.cos(angle - x)
    assert x > 5e-3
    assert settled.bent[0, 1] == pytest.approx(x, abs=1e-11)
    drop = T[1, :3, 3] + [length * np.cos(angle - x), 0, length * np.sin(angle - x)]
    got = settled.links[0, 6]
    hanging = (got[:3, :3] @ com + got[:3, 3])[[0, 2]]
    assert hanging == pytest.approx(drop[[0, 2]], abs=1e-10)


@pytest.mark.parametrize("mass", [0.0, 25.0, 150.0])
@pytest.mark.parametrize("load_link", [6, 3])
def test_without_errors_it_is_the_believed_arm_within_a_micrometre(mass, load_link):
    rng = np.random.default_rng(4)
    n, com = 60, np.array([0.01, -0.02, 0.22])
    truth = believed(payloads={"w": (mass, com)})
    q, load, place = postures(n), rng.normal(size=(n, 6)) * [400, 400, 400, 100, 100, 100], rng.normal(size=(n, 3)) * 0.2
    arm = np.concatenate([ROBOT.mdh.ravel(), truth.bends / ROBOT.stiffness])
    nest = np.tile([0.15, -0.05, 0.25], (n, 1))
    rows = RowInputs(q, np.tile([mass, *com], (n, 1)), load, place, nest, load_link=load_link)
    points, R = predict_points(ROBOT, arm, rows)
    T = make_arm(CELL, truth).flange(arm_moments(q, "w", T0, load=load, load_link=load_link, load_place=place))
    assert np.abs(T[:, :3, :3] @ nest[0] + T[:, :3, 3] - points).max() < 1e-6  # mostly the two steps of the planner's model
    assert np.abs(T[:, :3, :3] - R).max() < 1e-6


def test_the_engine_itself_finds_the_arm_at_rest():
    """Forward dynamics of a settled, drawn machine with a tendon and bending links: no spring accelerates."""
    effects = [parse_effect(e) for e in ("gravity_compensator=5e4", "link_bending:2", "link_bending:3")]
    arm = make_arm(CELL, draw_truth(CELL, 3, effects))
    settled = arm.settled(arm_moments(postures(1), "weight", T0))
    machine = arm.machines["weight"]
    mujoco.mj_forward(machine.model, machine.data)
    springs, force = machine.springs, machine.data.qfrc_passive - machine.data.qfrc_bias
    assert len(springs) == 10 and np.abs(settled.load_torque).max() > 1000
    assert np.abs(force[springs]).max() < 1e-4


def test_order_payloads_and_warm_starts_do_not_matter():
    arm = make_arm(CELL, draw_truth(CELL, 5))
    q = postures(12)
    names = tuple(["weight", "bare", "grinder"][i % 3] for i in range(12))
    together = arm.links(arm_moments(q, names, T0))
    alone = [arm.links(arm_moments(q[i], names[i], T0))[0] for i in (11, 4, 0)]
    assert together[[11, 4, 0]] == pytest.approx(np.array(alone), abs=1e-11)


def test_the_give_is_that_of_small_forces_on_the_true_arm():
    arm = make_arm(CELL, draw_truth(CELL, 6, [parse_effect("joint_stiffening:3"), parse_effect("link_bending:2=2e-7")]))
    q = postures(8)
    rest = arm_moments(q, "weight", T0)
    C = arm.compliance(rest)
    for k in range(6):
        wrench = np.zeros(6)
        wrench[k] = 10.0
        moved = arm.flange(replace(rest, load=np.tile(wrench, (8, 1))))
        still = arm.flange(rest)
        spin = moved[:, :3, :3] @ np.swapaxes(still[:, :3, :3], 1, 2)
        turn = 0.5 * np.stack(
            [spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]], axis=1
        )
        twist = np.hstack([moved[:, :3, 3] - still[:, :3, 3], turn])
        assert twist == pytest.approx(10.0 * C[:, :, k], abs=0.02 * np.abs(10 * C[:, :, k]).max())
    assert np.swapaxes(C, 1, 2) == pytest.approx(C, abs=1e-18) and np.linalg.eigvalsh(C).min() > 0


def test_under_contact_all_listed_springs_give_where_weight_bends_but_two():
    q = postures(10)
    arm = make_arm(CELL, believed(payloads={"w": (0.0, np.zeros(3))}, mass_scale=np.zeros(7)))
    T = elementary_forward(ROBOT, q)
    wanted = point_compliance(ROBOT, q, T[:, :3, 3])
    assert arm.compliance(arm_moments(q, "w", T0))[:, :3, :3] == pytest.approx(wanted, rel=1e-9, abs=1e-15)
    assert arm.settled(arm_moments(q, "w", T0, load=[0, 0, -300, 0, 0, 0])).bent[:, [0, 3, 4, 5]] == pytest.approx(
        np.zeros((10, 4))
    )


def test_motors_hold_what_a_rigid_body_library_says():
    mass, com = CELL.tables.payloads["grinder"].mass_kg, np.array(CELL.tables.payloads["grinder"].com_mm) * 1e-3
    q = postures(10)
    arm = make_arm(CELL, believed(stiffness=np.zeros(6)))
    held = arm.settled(arm_moments(q, "grinder", T0)).motor_torque
    assert held == pytest.approx(-elementary_weight_torques(ROBOT, q, GRAVITY, mass, com), abs=1e-4)
    still = np.zeros_like(q)
    assert held == pytest.approx(inverse_dynamics(ROBOT, mass, com, q, still, still), abs=1e-4)


def test_an_arm_too_soft_to_stand_is_refused():
    arm = make_arm(CELL, believed(stiffness=np.full(6, 500.0)))
    with pytest.raises(Infeasible, match="posture 1"):
        arm.flange(arm_moments(np.zeros((1, 6)), "weight", T0))


# -- effects, by their formulas to first order -----------------------------------------------------------------------

AMOUNT = np.random.default_rng(11)
Q, SIGN, WARM = postures(40, 2), AMOUNT.choice([-1.0, 1.0], (40, 6)), AMOUNT.uniform(0, 9, 40)
MASS, COM = 90.0, np.array([0.0, 0.02, 0.2])
weight = partial(elementary_weight_torques, ROBOT, Q, GRAVITY)
TAU = weight(MASS, COM)
GIVE = np.where([j in CELL.compliant_joints for j in range(1, 7)], 1 / ROBOT.stiffness, 0.0)


def one(j, values):
    out = np.zeros((40, 6))
    out[:, j - 1] = values
    return out


def wave(j, amplitude, order, phase):
    return one(j, amplitude * np.cos(order * Q[:, j - 1] + phase))


def balancer(k, a, b):
    """Torque of the spring about axis 2, positive along +q2, by its potential energy."""

    def energy(q2):
        up = np.array([0.0, 1.0]) * a
        arm = b * np.stack([np.cos(q2), -np.sin(q2)], axis=-1)
        return 0.5 * k * (np.linalg.norm(arm - up, axis=-1) - abs(a - b)) ** 2

    return -(energy(Q[:, 1] + 1e-6) - energy(Q[:, 1] - 1e-6)) / 2e-6


JOINT_EFFECTS = {
    "joint_compliance:5=1e-6": lambda: one(5, 1e-6 * TAU[:, 4]),
    "joint_compliance:2=5e-7": lambda: one(2, 5e-7 * TAU[:, 1]),
    "joint_stiffening:2=1e-15": lambda: one(2, -1e-15 * TAU[:, 1] ** 3),
    "gravity_compensator:2=2e4,lever_link1_m=0.3,lever_arm_m=0.2": lambda: one(2, GIVE[1] * balancer(2e4, 0.3, 0.2)),
    "gravity_compensator=4e4": lambda: one(2, GIVE[1] * balancer(4e4, 0.2, 0.2)),
    "payload_mass=5": lambda: GIVE * (weight(MASS + 5, COM) - TAU),
    "payload_com=0.05/0.02/-0.03": lambda: GIVE * (weight(MASS, COM + [0.05, 0.02, -0.03]) - TAU),
    "gear_1x:2=1e-4,phase_rad=1": lambda: wave(2, 1e-4, 1, 1.0),
    "gear_2x:4=1e-4,phase_rad=2": lambda: wave(4, 1e-4, 2, 2.0),
    "gear_harmonic:3=1e-4,order=37,phase_rad=0.5": lambda: wave(3, 1e-4, 37, 0.5),
    "motor_harmonic:5=1e-4,order=2,phase_rad=0.3": lambda: wave(5, 1e-4, 2 * 209.667, 0.3),
    "backlash:1=2e-4": lambda: one(1, 2e-4 * SIGN[:, 0]),
    "load_backlash:3=2e-4,torque_Nm=50": lambda: one(3, 2e-4 * np.tanh(TAU[:, 2] / 50.0)),
    "joint_coupling:3=2e-4,source_joint=2": lambda: one(3, 2e-4 * Q[:, 1]),
    "friction_windup:3=5e-5,per_Nm=1e-7": lambda: one(3, (5e-5 + 1e-7 * np.abs(TAU[:, 2])) * SIGN[:, 2]),
    "encoder_scale:4=-2e-4": lambda: one(4, -2e-4 * Q[:, 3]),
    "wrist_coupling:6=1e-4,source_joint=5": lambda: one(6, 1e-4 * Q[:, 4]),
    "joint_thermal:2=1e-5": lambda: one(2, 1e-5 * WARM),
}


def flange_shift(*effects, **changes):
    """Change (40, 3) m of a flange point under `effects`, on a believed machine with `changes`."""
    m = arm_moments(Q, "weight", T0 + WARM, SIGN, 5000.0)
    nest = np.array([0.15, -0.05, 0.25])
    with_it, without = (make_arm(CELL, believed(*e, **changes)).flange(m) for e in (effects, ()))
    return (with_it[:, :3, :3] - without[:, :3, :3]) @ nest + with_it[:, :3, 3] - without[:, :3, 3]


def point(q, robot=ROBOT):
    T = elementary_forward(robot, q)
    return T[:, :3, :3] @ [0.15, -0.05, 0.25] + T[:, :3, 3]


@pytest.mark.parametrize("effect", JOINT_EFFECTS)
def test_an_effect_of_a_joint_moves_the_flange_as_its_formula_says(effect):
    dq = JOINT_EFFECTS[effect]()
    bent = Q + GIVE * TAU
    wanted = point(bent + 0.5 * dq) - point(bent - 0.5 * dq)
    got = flange_shift(effect)
    assert np.abs(wanted).max() > 2e-5
    # What is left is of second order: the sag changes the torque by 1e-2 of itself.
    assert np.abs(got - wanted).max() < 0.012 * np.abs(wanted).max()


@pytest.mark.parametrize("joint", [2, 3])
def test_a_bending_link_is_a_beam(joint):
    """Every slice of the link, massless here, turns what is beyond it by k M ds / L, M the moment there."""
    k, light = 1e-7, np.where(np.arange(7) == joint, 0.0, 1.0)
    robot = replace(ROBOT, link_mass=ROBOT.link_mass * light)
    bent = Q + GIVE * elementary_weight_torques(robot, Q, GRAVITY, MASS, COM)
    frames = elementary_frames(robot, bent)
    axis = frames[:, joint - 1, :3, 2] * ROBOT.sign[joint - 1]
    start, end = frames[:, joint - 1, :3, 3], frames[:, 2 if joint == 2 else 4, :3, 3]
    wanted = np.zeros((40, 3))
    for s in (np.arange(200) + 0.5) / 200:
        place, moment = start + s * (end - start), np.zeros(40)
        for i, mass, com in [*((i, robot.link_mass[i], robot.link_com[i]) for i in range(joint + 1, 7)), (6, MASS, COM)]:
            lever = frames[:, i, :3, :3] @ com + frames[:, i, :3, 3] - place
            moment += np.einsum("ni,ni->n", axis, np.cross(lever, [0, 0, -mass * GRAVITY]))
        wanted += k / 200 * moment[:, None] * np.cross(axis, point(bent) - place)
    got = flange_shift(f"link_bending:{joint}={k}", mass_scale=light)
    assert np.abs(wanted).max() > 5e-5 and np.abs(got - wanted).max() < 0.012 * np.abs(wanted).max()


def test_a_robot_without_payload_is_not_wrong_about_it():
    truth = believed("payload_mass=5", "payload_com=0.1/0/0")
    bare, right = (make_arm(CELL, t).flange(arm_moments(Q, "bare", T0)) for t in (truth, believed()))
    assert bare == pytest.approx(right, abs=1e-12)


def test_warm_links_are_longer_and_a_tilted_base_turns_everything():
    mdh = ROBOT.mdh.copy()
    wanted = np.empty((40, 3))
    for i in range(40):
        grown = mdh.copy()
        grown[:, 1:3] *= 1 + 1e-5 * WARM[i]
        wanted[i] = (point(Q[i : i + 1], replace(ROBOT, mdh=grown)) - point(Q[i : i + 1]))[0]
    assert flange_shift("link_thermal=1e-5") == pytest.approx(wanted, abs=2e-6)
    assert np.abs(wanted).max() > 1e-4
    turned = np.cross([1e-4, -2e-4, 5e-5], point(Q + GIVE * TAU))
    assert flange_shift("base_tilt=1e-4/-2e-4/5e-5,at_s=4000") == pytest.approx(turned, abs=2e-6)
    assert np.abs(flange_shift("base_tilt=1e-4/-2e-4/5e-5,at_s=6000")).max() == 0.0


def test_a_tool_flexes_across_the_flange_under_weight_and_contact():
    give, T = 1e-7, elementary_forward(ROBOT, Q + GIVE * TAU)
    across = T[:, :3, :3] * [1.0, 1.0, 0.0] @ np.swapaxes(T[:, :3, :3], 1, 2)
    assert flange_shift(f"tool_flex={give}") == pytest.approx(give * across @ [0, 0, -MASS * GRAVITY], abs=2e-7)
    m = arm_moments(Q, "weight", T0, load=[0, 30.0, 0, 0, 0, 0])
    arm, stiff = (make_arm(CELL, believed(*e)) for e in ((f"tool_flex={give}",), ()))
    pulled = arm.links(m)[:, 6, :3, 3] - stiff.links(m)[:, 6, :3, 3]
    assert pulled == pytest.approx(give * across @ [0, 30.0, -MASS * GRAVITY], abs=2e-7)
    soft = arm.compliance(m)[:, :3, :3] - stiff.compliance(m)[:, :3, :3]
    assert soft == pytest.approx(give * across, abs=1e-3 * give)


def test_play_that_the_load_takes_up_gives_under_a_further_load():
    """The slope of the law is the compliance, also where the torque is within tau0."""
    arms = [make_arm(CELL, believed(*e)) for e in (("load_backlash:5=2e-4,torque_Nm=400",), ())]
    m = arm_moments(Q[:8], "weight", T0)
    pushed = replace(m, load=np.tile([2.0, 0, 0, 0, 0, 0], (8, 1)))
    moved = [arm.flange(pushed)[:, :3, 3] - arm.flange(m)[:, :3, 3] for arm in arms]
    give = [arm.compliance(m)[:, :3, 0] for arm in arms]
    assert moved[0] - moved[1] == pytest.approx(2.0 * (give[0] - give[1]), abs=0.02 * np.abs(moved[0] - moved[1]).max())
    assert np.abs(give[0] - give[1]).max() > 1e-8


@pytest.mark.parametrize("text", ["load_backlash:5=4e-4,torque_Nm=60", "joint_stiffening:5=2e-11"])
def test_under_a_push_as_large_as_its_weight_a_joint_turns_by_what_its_law_says_of_both(text):
    """Statics of the whole machine under the wrench against the compliance that the contact is told for it."""
    soft, stiff = (make_arm(CELL, believed(*e)) for e in ((text,), ()))
    m, wrench = arm_moments(Q[:8], "weight", T0), np.tile([100.0, -160.0, 60.0, 24.0, 36.0, -28.0], (8, 1))
    pushed = replace(m, load=wrench)
    moved = [arm.flange(pushed)[:, :3, 3] - arm.flange(m)[:, :3, 3] for arm in (soft, stiff)]
    found = [np.einsum("kij,kj->ki", arm.compliance_at(arm.settled(m), wrench), wrench)[:, :3] for arm in (soft, stiff)]
    slope = [np.einsum("kij,kj->ki", arm.compliance(m), wrench)[:, :3] for arm in (soft, stiff)]
    more, told, straight = (of[0] - of[1] for of in (moved, found, slope))
    size = np.abs(more).max()
    assert told == pytest.approx(more, abs=0.02 * size)
    assert np.abs(straight - more).max() > 0.1 * size  # the slope at the weight alone is another one
    assert soft.bends_on and not stiff.bends_on


def test_every_effect_of_the_arm_is_tested_here():
    tested = {name.split(":")[0].split("=")[0] for name in JOINT_EFFECTS} | {
        "link_bending",
        "link_thermal",
        "base_tilt",
        "tool_flex",
    }
    assert tested == {kind.name for kind in ARM_KINDS if kind.part == "arm"}


def test_gear_ratios_of_the_extra_are_its_sisters():
    assert gear_ratios(ROBOT) == pytest.approx([256.857, 252.909, 236.368, 198.9, 209.667, 131.151])
    with pytest.raises(BadInput, match="gear ratios"):
        gear_ratios(load_robot("ur5"))


# -- repeats and payloads ---------------------------------------------------------------------------------------------


def test_an_unknown_payload_is_named():
    with pytest.raises(BadInput, match=r"payload 'anvil' .* \(grinder, bare, weight\)"):
        make_arm(CELL, believed()).flange(arm_moments(np.zeros((1, 6)), "anvil", T0))


# -- joints.csv ------------------------------------------------------------------------------------------------------


def test_link_side_encoders_see_what_the_motor_does_not():
    time = np.arange(400) * 0.004
    q = postures(1) + np.sin(3 * time)[:, None] * 0.2
    m = arm_moments(q, "grinder", T0, approach=np.sign(np.cos(3 * time))[:, None])
    run = np.zeros(400)
    logs = []
    for effects in ((), ("channel_delay:3=0.02",), ("joint_compliance:2=5e-7",)):
        truth = believed(*effects)
        logs.append(joint_log(make_arm(CELL, truth), truth, m, run, time, np.random.default_rng(1)))
    plain, late, soft = logs
    assert list(plain)[:3] == ["run", "time_s", "q1_deg"] and plain["q3_deg"] == pytest.approx(np.degrees(q[:, 2]))
    shift = np.radians(late["link3_deg"] - plain["link3_deg"])[10:]
    assert shift == pytest.approx(-0.02 * 0.2 * 3 * np.cos(3 * time[10:] - 0.03), abs=2e-5)
    assert late["link2_deg"] == pytest.approx(plain["link2_deg"])
    more = np.radians(soft["link2_deg"] - plain["link2_deg"])
    assert more == pytest.approx(-5e-7 * plain["tau2_Nm"], abs=3e-5) and np.abs(more).max() > 3e-4
    assert delayed(np.arange(4.0), np.array([0, 0, 1, 1]), np.array([0.0, 1, 0, 1]), 0.5) == pytest.approx([0, 0.5, 2, 2.5])
