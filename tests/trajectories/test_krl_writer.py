"""The written text: golden files, number formats, determinism, refusals; and the reader gets back what was planned."""

import re
from dataclasses import replace

import numpy as np
import pytest

from robots.errors import BadInput, Infeasible
from robots.kinematics import forward
from robots.pose import invert
from tests.support.krl_example import GOLDEN, LIMITS, ROBOT, Leg, elementary_forward, example, legs, setup, write
from trajectories.krl.checks import check_program, check_status_turn
from trajectories.krl.dialect import KRL
from trajectories.krl.interpreter import execute
from trajectories.krl.status_turn import status_of, turn_of
from trajectories.krl.values import FILE_LIMITS, fixed
from trajectories.krl.writer import program_files, refuse_unwritable, time_block
from trajectories.program.build import LINE_TIME, LINE_WAY, build_program
from trajectories.program.execution import PathBounds
from trajectories.program.program import (
    Comment,
    PointMotion,
    PoseLines,
    PoseSpline,
    Program,
    SubProgram,
    TimedSpline,
    split_blocks,
)
from trajectories.timing import time_contact_path


def short(kind):
    """A program of few points for the golden text; no solver, no spline: numbers anyone can check by hand."""
    q = np.radians([[0, -90, 90, 0, 10, 0], [1, -89.5, 90.25, 0, 11, -1e-9], [2, -89, 90.5, 0, 12, 3.5]])
    P = np.array([np.eye(4)] * 3)
    P[:, 0, 3] = [0.0, 0.001, 0.002]
    t, bounds = np.array([0.0, 1 / 30, 2 / 30]), PathBounds(0.04, 1.0, np.radians(30.0), np.radians(200.0))
    lines = PoseLines(P, q, np.array([0.03, 0.04]), bounds)
    made = {"axis": TimedSpline(q, t), "cartesian": PoseSpline(P, q, t, bounds), "lin": lines}
    blocks = (PointMotion(q[0]), Comment("contact; $OV_PRO=100\r\nHALT"), made[kind])
    return Program("GOLD", setup(kind), (SubProgram("GOLD_01", blocks, "line 1"),), ("made by a test",))


@pytest.mark.parametrize("kind", ["axis", "cartesian", "lin"])
def test_the_text_is_the_golden_text(kind):
    for name, data in program_files(short(kind)).items():
        assert data == (GOLDEN / f"{kind}_{name}").read_bytes(), name


def test_times_of_a_block_are_told_from_its_own_first():
    points, t = ["{A}", "{B}", "{C}"], np.array([0.0, 0.5, 1.25])
    assert time_block("PTP_SPLINE", "SPTP", points, t + 3.0) == time_block("PTP_SPLINE", "SPTP", points, t)


def test_a_file_takes_as_many_points_as_the_controller_does():
    def program(count):
        spline = TimedSpline(np.zeros((count - 1, 6)), np.arange(count - 1.0))
        return Program("GOLD", setup("axis"), (SubProgram("GOLD_01", (PointMotion(np.zeros(6)), spline), "line 1"),))

    most = FILE_LIMITS.file_points
    assert program(most).subs[0].points == most
    refuse_unwritable(program(most))
    with pytest.raises(BadInput, match=f"{most + 1} points and a file takes {most}"):
        refuse_unwritable(program(most + 1))


@pytest.mark.parametrize("feed, least", [(0.04, 1e-3), (1e-3, 5e-5)])
def test_lines_are_long_enough_to_be_planned_and_printed(feed, least):
    """At a working feed 25 ms each, at the slowest as long as what printing rounds needs; to the last, which may not be short."""
    program = build_program(KRL, "slow", setup("lin"), [[legs(feed)[2]]], ["line 1"], elementary_forward)
    (lines,) = [b for sub in program.subs for b in sub.blocks if isinstance(b, PoseLines)]
    way = np.linalg.norm(np.diff(lines.poses[:, :3, 3], axis=0), axis=1)
    t = way / lines.speeds
    assert way.min() > 0.9 * LINE_WAY and t.min() > LINE_TIME - 1e-6 and np.median(way) > 0.9 * least
    assert t.sum() == pytest.approx(legs(feed)[2].trajectory.duration, rel=1e-6)


def test_the_same_program_is_the_same_bytes():
    assert program_files(example(passes=2)) == program_files(example(passes=2))


def test_numbers_have_no_sign_of_zero_and_no_exponent():
    assert fixed(-1e-9, 5) == "0.00000"
    assert fixed(-0.0, 4) == "0.0000"
    assert fixed(1e-12, 5) == "0.00000"
    assert fixed(-12.345678, 5) == "-12.34568"
    text = b"".join(program_files(example()).values()).decode()
    assert not re.search(r"-0\.0+\b(?!\d)", text) and not re.search(r"\d[eE][-+]?\d", text)


def test_files_are_ascii_with_crlf_and_a_pair_each():
    files = program_files(example(passes=2))
    assert set(files) == {f"BLADE_1{s}.{e}" for s in ("", "_01", "_02") for e in ("src", "dat")}
    for data in files.values():
        assert data.count(b"\n") == data.count(b"\r\n") and data.endswith(b"\r\n") and data.isascii()


def test_what_is_read_back_is_what_was_planned(tmp_path):
    plan = legs()
    execution = check_program(write(example(), tmp_path), ROBOT)
    assert [s.word for s in execution.segments] == ["PTP"] + ["PTP_SPLINE"] * 4
    for segment, leg in zip(execution.segments[1:], plan, strict=True):
        assert segment.times[-1] == pytest.approx(leg.trajectory.duration, abs=1e-3)
        assert np.abs(segment.q - leg.trajectory.q(segment.times)).max() < np.radians(0.6e-5)


def test_frames_are_read_back(tmp_path):
    frames = execute(write(example(), tmp_path)).segments[1].frames
    assert frames.external_tcp
    assert np.allclose(frames.tool, setup().T_flange_blade, atol=1e-6)
    assert np.allclose(frames.base, setup().T_base_wheel, atol=1e-6)


@pytest.mark.parametrize("kind", ["cartesian", "lin"])
def test_poses_lead_back_to_the_planned_axes_through_the_nominal_arm(kind, tmp_path):
    """FLANGE = BASE P^-1 TOOL^-1 for every printed P, against the arm written as elementary motions."""
    contact = legs()[2].trajectory
    execution = check_program(write(example(kind), tmp_path), ROBOT)
    planned = contact.q(np.linspace(0.0, contact.duration, 20001))
    blocks = [s.poses for s in execution.segments if s.poses is not None]
    if kind == "cartesian":
        assert [s.word for s in execution.segments] == ["PTP", "PTP_SPLINE", "SPLINE", "SPLINE", "SPLINE"]
        segment = execution.segments[3]
        poses, planned = segment.poses, contact.q(segment.times)
        assert segment.times[-1] == pytest.approx(contact.duration, abs=1e-5)
    else:
        poses = np.concatenate(blocks)
        last = [k for k, s in enumerate(s for s in execution.segments if s.poses is not None) if not s.blended]
        assert len(last) == 3 and last[-1] == len(poses) - 1  # engage, contact, retreat: one chain each
        poses = poses[last[0] + 1 : last[1] + 1]
    flange = setup().T_base_wheel @ invert(poses) @ invert(setup().T_flange_blade)
    there = elementary_forward(planned)
    for k, T in enumerate(flange):
        nearest = k if kind == "cartesian" else int(np.argmin(np.linalg.norm(there[:, :3, 3] - T[:3, 3], axis=1)))
        assert np.linalg.norm(there[nearest, :3, 3] - T[:3, 3]) < (1e-6 if kind == "cartesian" else 3e-6)
        assert np.abs(there[nearest, :3, :3] - T[:3, :3]).max() < (1e-6 if kind == "cartesian" else 1e-5)


def test_status_and_turn_follow_the_axes(tmp_path):
    execution = execute(write(example("cartesian"), tmp_path))
    contact = legs()[2].trajectory
    segment = max((s for s in execution.segments if s.poses is not None), key=lambda s: len(s.lines))
    assert np.all(segment.status == 6) and np.all(segment.turn == 0b010010)
    check_status_turn(segment, contact.q(np.linspace(0, contact.duration, len(segment.lines))), ROBOT.mdh)


def test_status_bits_against_the_geometry_of_the_arm():
    """Bit 0 from the wrist's position in front of or behind axis 1, bit 1 from the forearm's direction."""
    rng = np.random.default_rng(4)
    q = rng.uniform(ROBOT.q_min, ROBOT.q_max, (500, 6))
    wrist = forward(ROBOT, q) @ np.array([0, 0, -0.215, 1.0])
    ahead = np.cos(-q[:, 0]) * wrist[:, 0] + np.sin(-q[:, 0]) * wrist[:, 1]
    S = status_of(q, ROBOT.mdh)
    assert np.array_equal(S & 1, (ahead < 0).astype(int))
    # the elbow is stretched where the wrist lies on the line of the upper arm: there the bit changes
    straight = np.arctan2(-0.041, 1.2)
    for d, bit in ((-0.01, 0), (0.01, 1)):
        assert (status_of(np.array([[0, 0, straight + d, 0, 0, 0]]), ROBOT.mdh)[0] >> 1) & 1 == bit
    assert turn_of(np.radians([[-1, 2, -3, 4, 5, -6.0]]))[0] == 0b100101
    for a5, bit in ((-10, 1), (10, 0), (0, 0), (181, 1), (-181, 0)):
        assert (status_of(np.radians([[0, 0, 90, 0, a5, 0.0]]), ROBOT.mdh)[0] >> 2) == bit


def test_compensated_poses_on_an_absolutely_accurate_controller_are_refused():
    for kind in ("cartesian", "lin"):
        with pytest.raises(BadInput, match="a second time"):
            program_files(replace(short("axis"), setup=setup(kind, absolute_accuracy=True)))
    program_files(replace(short("axis"), setup=setup("axis", absolute_accuracy=True)))


@pytest.mark.parametrize("down", [(0, 0, 1), (1, 0, 0), (np.sin(0.02), 0, -np.cos(0.02))])
def test_poses_in_a_world_that_a_hanging_base_turns_are_refused(down):
    """BASE is read in the world; axes are not, and a base that the controller keeps was taught in its world."""
    hung = replace(ROBOT, gravity_direction=np.array(down, float))
    for kind in ("cartesian", "lin"):
        with pytest.raises(BadInput, match=f"gravity_direction says that the base is not upright and the output is '{kind}'"):
            program_files(replace(short("axis"), setup=replace(setup(kind), robot=hung)))
    program_files(replace(short("cartesian"), setup=replace(setup("cartesian", base_on_controller=True), robot=hung)))
    files = program_files(replace(short("axis"), setup=replace(setup("axis"), robot=hung)))
    plain = program_files(short("axis"))
    for name, data in files.items():
        changed = [new for new, old in zip(data.splitlines(), plain[name].splitlines(), strict=True) if new != old]
        assert len(changed) == name.endswith(".src") and all(b"do not jog in $BASE" in line for line in changed)


def test_a_foundation_that_is_level_as_built_may_take_poses():
    level = replace(ROBOT, gravity_direction=np.array([np.sin(0.01), 0.0, -np.cos(0.01)]))
    assert program_files(replace(short("cartesian"), setup=replace(setup("cartesian"), robot=level)))


def test_the_base_can_be_left_to_the_controller(tmp_path):
    program = example("cartesian", base_on_controller=True)
    text = program_files(program)["BLADE_1_01.src"].decode()
    assert "$BASE=BASE_DATA[1]" in text and "; wheel frame in world, as in BASE_DATA[1]: {X 1550.0000" in text
    assert execute(write(program, tmp_path)).segments[1].frames.base_no == 1


def test_names_that_collide_or_carry_statements_are_refused():
    gold = short("axis")
    for wrong in (replace(gold, name="A" * 25), replace(gold, name="gold_01"), replace(gold, name="X; HALT")):
        with pytest.raises(BadInput, match="name"):
            program_files(wrong)
    sub = replace(gold.subs[0], blocks=gold.subs[0].blocks[1:])
    with pytest.raises(BadInput, match="must begin with a PTP"):
        program_files(replace(gold, subs=(sub,)))


def test_long_passes_are_split_where_the_robot_stands(tmp_path):
    q = np.radians([0, -90, 90, 0, 10, 0]) + np.linspace(0, 0.1, 900)[:, None] * np.ones(6)
    blocks = [PointMotion(q[0])]
    for _ in range(3):
        blocks += [TimedSpline(q, np.arange(900) * 0.02), TimedSpline(q[::-1], np.arange(900) * 0.02)]
    groups = split_blocks(blocks, FILE_LIMITS.file_points)
    assert [sum(len(b.q) if isinstance(b, TimedSpline) else 1 for b in g) for g in groups] == [1801, 1801, 1801]
    subs = tuple(SubProgram(f"LONG_01_{c}", tuple(g)) for c, g in zip("ABC", groups, strict=True))
    execution = check_program(write(Program("LONG", setup(), subs), tmp_path))
    assert len(execution.segments) == 3 + 6
    with pytest.raises(BadInput, match="2001 points"):
        split_blocks([TimedSpline(np.zeros((2001, 6)), np.arange(2001.0))], FILE_LIMITS.file_points)


def test_a_pass_that_cannot_be_emitted_is_named():
    q = np.radians([5.0, -70, 100, 10, -40, 20]) + np.random.default_rng(0).normal(size=(300, 6)) * 1e-3
    rough = Leg("contact", time_contact_path(q, np.linspace(0, 0.3, 300), None, LIMITS, window=0.0))
    with pytest.raises(Infeasible, match="line 7: the emitted program leaves the plan by"):
        build_program(
            KRL, "x", setup(), [[rough]], ["line 7"], elementary_forward, tolerance=lambda leg, t: np.full(len(t), 1e-7)
        )
