"""The virtual controller against the product's own reader and interpolation, which it does not share a line with."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.simulate.twin.collide import WheelBody, refuse_hits
from ocp.simulate.twin.controller import drive, missed_parts
from ocp.simulate.twin.krl_text import ProgramPause, read_program
from ocp.simulate.twin.path_motion import (
    flange,
    flange_poses,
    frames,
    inverse_by_status,
    nominal_jacobian,
    solve_posture,
    status_turn,
)
from ocp.simulate.twin.plan_knowledge import refuse_other_times
from robots.errors import BadInput, Infeasible
from robots.pose import invert
from tests.support.krl_example import (
    GOLDEN,
    LIMITS,
    ROBOT,
    T_BASE_WHEEL,
    T_FLANGE_BLADE,
    elementary_forward,
    example,
    legs,
    write,
)
from trajectories.blade import read_blade
from trajectories.krl.interpreter import execute
from trajectories.krl.status_turn import status_of, turn_of
from trajectories.program import program as krl
from trajectories.program.driven import reinterpolate

MICROMETRE = 1e-6


def golden(kind: str, folder: Path) -> Path:
    for file in GOLDEN.glob(f"{kind}_*"):
        shutil.copy(file, folder / file.name.removeprefix(f"{kind}_"))
    return folder


def written(kind: str, folder: Path, passes: int = 1) -> Path:
    write(example(kind, passes), folder)
    return folder


def changed(folder: Path, name: str, old: str, new: str) -> Path:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    return folder


@pytest.mark.parametrize("kind", ["axis", "cartesian"])
def test_the_golden_programs_read_as_the_products_reader_reads_them(kind, tmp_path):
    same_as_the_product(golden(kind, tmp_path), tmp_path / "GOLD.src")


@pytest.mark.parametrize("kind", ["axis", "cartesian", "lin"])
def test_programs_of_every_kind_read_as_the_products_reader_reads_them(kind, tmp_path):
    folder = written(kind, tmp_path, 2)
    same_as_the_product(folder, folder / "BLADE_1.src")


def same_as_the_product(folder: Path, main: Path) -> None:
    mine, theirs = read_program(folder), execute(main)
    flat = [(m, k) for m in mine.motions for k in range(len(m.targets))]
    points = [(s, k) for s in theirs.segments for k in range(len(s.lines))]
    assert len(flat) == len(points)
    for (motion, i), (segment, k) in zip(flat, points, strict=True):
        target = motion.targets[i]
        assert (motion.file, target.line) == (segment.file, int(segment.lines[k]))
        if segment.q is not None:
            assert np.allclose(target.q, segment.q[k], atol=1e-12)
        else:
            assert np.allclose(target.pose, segment.poses[k], atol=1e-12)
            assert motion.speed == pytest.approx(segment.speed)
        if segment.times is not None:
            assert motion.times[i] == pytest.approx(segment.times[k], abs=1e-9)
        assert np.allclose(motion.frames.tool, segment.frames.tool) and np.allclose(motion.frames.base, segment.frames.base)
        assert motion.frames.held == (segment.frames.external_tcp)


def test_timed_programs_are_driven_within_a_micrometre_of_the_products_interpolation(tmp_path):
    folder = written("axis", tmp_path, 2)
    track = drive(read_program(folder), ROBOT, 250.0)
    motion = reinterpolate(execute(folder / "BLADE_1.src"), ROBOT)
    blocks = [m for m in read_program(folder).motions if m.kind == "TIMED"]
    # Only the way back to the start of the second pass is not timed by the program, so the first pass is compared.
    first = sum(float(m.times[-1]) for m in blocks[: len(blocks) // 2])
    inside = track.time < first
    T, expected = flange(ROBOT, track.q[inside]), elementary_forward(motion.q(track.time[inside]))
    assert inside.sum() > 500
    assert np.abs(T[:, :3, 3] - expected[:, :3, 3]).max() < MICROMETRE
    assert np.abs(track.qd[inside] - motion.qd(track.time[inside])).max() < 1e-5


@pytest.mark.parametrize("kind", ["cartesian", "lin"])
def test_programs_of_poses_pass_through_their_points_and_keep_the_speed(kind, tmp_path):
    folder = written(kind, tmp_path)
    program = read_program(folder)
    track = drive(program, ROBOT, 1000.0)
    assert track.notices == ()
    contact = legs()[2].trajectory
    planned = elementary_forward(contact.q(np.linspace(0, contact.duration, 60)))
    driven = elementary_forward(track.q)
    # Poses stand a millimetre apart: what the two curves make between them may differ by micrometres.
    assert distance_to_polygon(planned[:, :3, 3], driven[:, :3, 3]).max() < (2e-6 if kind == "cartesian" else 6e-6)
    P = invert(driven @ T_FLANGE_BLADE) @ T_BASE_WHEEL
    speed = np.linalg.norm(np.diff(P[:, :3, 3], axis=0), axis=1) * 1000.0
    asked = max(m.speed for m in program.motions if m.kind in ("SPLINE", "LIN"))
    grinding = np.isin(track.motion[:-1], [k for k, p in enumerate(track.places) if p[0] == "BLADE_1_01.src"])
    assert np.percentile(speed[grinding], 60) < asked * 1.001
    assert np.abs(track.qd).max(axis=0).max() <= 1.02 * ROBOT.qd_max.max()


def distance_to_polygon(points, corners):
    """Smallest distance (n,) of each point to the sides of a polygon."""
    a, side = corners[:-1], np.diff(corners, axis=0)
    length = np.maximum((side**2).sum(axis=1), 1e-30)
    best = np.full(len(points), np.inf)
    for k, p in enumerate(points):
        share = np.clip(((p - a) * side).sum(axis=1) / length, 0, 1)
        best[k] = np.linalg.norm(a + share[:, None] * side - p, axis=1).min()
    return best


def test_the_nominal_arm_is_the_arm_of_elementary_motions():
    rng = np.random.default_rng(1)
    q = rng.uniform(ROBOT.q_min, ROBOT.q_max, (50, 6))
    assert np.allclose(flange(ROBOT, q), elementary_forward(q), atol=1e-12)
    J, step = nominal_jacobian(ROBOT, frames(ROBOT, q)), 1e-6
    for j in range(6):
        d = step * np.eye(6)[j]
        slope = (elementary_forward(q + d)[:, :3, 3] - elementary_forward(q - d)[:, :3, 3]) / (2 * step)
        assert np.allclose(J[:, :3, j], slope, atol=1e-8)


def test_the_inverse_comes_back_to_the_joints_and_finds_the_branch():
    rng = np.random.default_rng(2)
    q = rng.uniform(np.radians([-80, -110, 40, -90, 20, -90]), np.radians([80, -60, 130, 90, 80, 90]), (20, 6))
    goal = elementary_forward(q)
    found, left = solve_posture(ROBOT, goal, q + rng.uniform(-0.1, 0.1, q.shape))
    assert left.max() < 1e-9 and np.allclose(found, q, atol=1e-8)
    for k in range(5):
        status, turn = status_turn(ROBOT, q[k])
        assert (status, turn) == (int(status_of(q[k : k + 1], ROBOT.mdh)[0]), int(turn_of(q[k : k + 1])[0]))
        assert np.allclose(inverse_by_status(ROBOT, goal[k], status, turn), q[k], atol=1e-7)


def test_a_first_motion_to_a_pose_takes_the_posture_of_its_status(tmp_path):
    folder = written("cartesian", tmp_path)
    name = "BLADE_1_01.src"
    lines = (folder / name).read_text().splitlines()
    k = next(i for i, line in enumerate(lines) if line.startswith("PTP {"))
    first = read_program(folder).motions[0]
    q = first.targets[0].q
    T = flange(ROBOT, q[None])
    P = (invert(T @ first.frames.tool) @ first.frames.base)[0]
    assert np.allclose(flange_poses(first.frames, P[None]), T, atol=1e-12)
    from robots.pose import abc_from_rotation

    values = [*(1e3 * P[:3, 3]), *np.degrees(abc_from_rotation(P[:3, :3]))]
    status, turn = status_turn(ROBOT, q)
    text = ",".join(f"{n} {v:.6f}" for n, v in zip("XYZABC", values, strict=True))
    lines[k] = f"PTP {{{text},S {status},T {turn}}}"
    (folder / name).write_text("\r\n".join(lines) + "\r\n")
    assert np.abs(drive(read_program(folder), ROBOT).q[0] - q).max() < 1e-6


def test_pauses_and_approach_signs(tmp_path):
    q = np.radians([[0.0, -80, 90, 0, 10, 0], [5.0, -80, 90, 0, 10, 0], [2.0, -80, 90, 0, 10, 0]])
    blocks = [krl.PointMotion(q[0]), krl.PointMotion(q[1]), krl.Wait(0.5, None), krl.PointMotion(q[2]), krl.Wait(None, None)]
    base = example()
    program = krl.Program("STOPS", base.setup, (krl.SubProgram("STOPS_01", tuple(blocks), "stops"),), ())
    write(program, tmp_path)
    steps = read_program(tmp_path).steps
    assert [s.seconds for s in steps if isinstance(s, ProgramPause)] == [0.5, None]
    track = drive(read_program(tmp_path), ROBOT)
    there = np.flatnonzero(np.abs(track.q - q[1]).max(axis=1) < 1e-7)
    still = there[1:-1]
    assert track.time[there[-1]] - track.time[there[0]] == pytest.approx(0.5, abs=0.05)
    assert np.allclose(track.q[still], q[1]) and np.all(track.approach[still, 0] == 1)
    assert track.approach[-1, 0] == -1 and np.all(track.approach[:, 1] == 0)


REFUSED = [
    ("$VEL.CP=0.04000", "$OV_PRO=50", "line 52: '$OV_PRO=50' is not understood"),
    ("$VEL.CP=0.04000", "CIRC {X 1,Y 2,Z 3,A 0,B 0,C 0},{X 1,Y 2,Z 3,A 0,B 0,C 0}", "line 52"),
    ("$VEL.CP=0.04000", "IF $IN[1] THEN", "line 52"),
    ("$VEL.CP=0.04000", "LIN_REL {Z 10}", "line 52"),
    ("$VEL.CP=0.04000", "$VEL.CP=FAST", "'FAST' is no number"),
    ("$VEL.CP=0.04000", "$VEL.CP=-1", "must be above 0"),
    ("$VEL.CP=0.04000", "$BASE=BASE_DATA[3]", "set nowhere"),
    ("$VEL.CP=0.04000", "MISSING ( )", "line 52"),
    ("$VEL.CP=0.04000", "LIN XP7", "XP7 is declared nowhere"),
    ("  SPL {X 1.0000", "  SPTP {X 1.0000", "line 61"),
    ("ENDSPLINE", "; gone", "has no ENDSPLINE"),
    (
        "Y 0.0000,Z 0.0000,A 0.00000,B 0.00000,C 0.00000,S 2,T 2}\r\n  TIME_BLOCK START",
        "S 2,T 2}\r\n  TIME_BLOCK START",
        "incomplete",
    ),
    ("DEF GOLD_01( )", "DEF GOLD_02( )", "line 4"),
    ("\r\nEND", "\r\n", "without END"),
]


@pytest.mark.parametrize(("old", "new", "says"), REFUSED)
def test_what_is_not_understood_is_refused_with_its_line(old, new, says, tmp_path):
    folder = golden("cartesian", tmp_path)
    path = folder / "GOLD_01.src"
    text = path.read_bytes().decode()
    assert old in text, old
    path.write_bytes((text.replace(old, new, 1) if old != "\r\nEND" else text.rstrip()[:-3]).encode())
    with pytest.raises(BadInput) as refused:
        read_program(folder)
    assert says in str(refused.value) and "GOLD_01.src" in str(refused.value)


def test_a_timed_block_out_of_order_is_refused(tmp_path):
    folder = changed(golden("axis", tmp_path), "GOLD_01.src", "  TIME_BLOCK START", "  ; no start")
    read_program(folder)  # START alone says nothing new: the block stays as it was
    folder = changed(folder, "GOLD_01.src", "  TIME_BLOCK END=", "  ; TIME_BLOCK END=")
    with pytest.raises(BadInput, match="no complete TIME_BLOCK"):
        read_program(folder)


def test_a_folder_without_a_program_and_a_folder_with_two(tmp_path):
    with pytest.raises(BadInput, match="holds no KRL program"):
        read_program(tmp_path)
    golden("axis", tmp_path)
    (tmp_path / "OTHER.src").write_text("DEF OTHER( )\nEND\n")
    with pytest.raises(BadInput, match="GOLD.src, OTHER.src"):
        read_program(tmp_path)


@pytest.mark.parametrize("first", [True, False])
def test_an_axis_beyond_its_limit_is_infeasible(first, tmp_path):
    folder = golden("cartesian", tmp_path)
    if first:
        changed(folder, "GOLD_01.src", "PTP {A1 0.00000", "PTP {A1 186.00000")
    else:
        changed(folder, "GOLD_01.src", "; contact", "PTP {A1 186,A2 -90,A3 90,A4 0,A5 10,A6 0}\r\n; contact")
    with pytest.raises(Infeasible, match=rf"GOLD_01.src, line {32 if first else 33}: A1 goes to 186\.00 deg"):
        drive(read_program(folder), ROBOT)


def obstacle(at: np.ndarray, radius: float = 0.05) -> WheelBody:
    return WheelBody(at, np.array([0.0, 1.0, 0.0]), radius, 0.04)


def hit(q: np.ndarray, wheel: WheelBody) -> None:
    """Drive joints q (n, 6) past a wheel with the bundled blade."""
    cell = read_cell(CELL)
    blade = read_blade(cell.workpiece.stl)
    n = len(q)
    refuse_hits(
        cell,
        blade,
        wheel,
        cell.workpiece.T_flange_blade,
        frames(ROBOT, q),
        np.zeros(n, np.int64),
        np.full(n, np.nan),
        [f"sample {k}" for k in range(n)],
    )


def test_a_wheel_in_the_way_of_the_forearm_or_the_blade_is_named_with_the_first_sample():
    way = np.linspace(0, 1, 200)[:, None]
    q = np.radians([-40.0, -80, 90, 0, 10, 0]) + way * np.radians([80.0, 0, 0, 0, 0, 0])
    hit(q, obstacle(np.array([0.0, 0.0, 4.0])))
    T = frames(ROBOT, q[100:101])[0]
    elbow = T[3, :3, 3] + 0.6 * (T[5, :3, 3] - T[3, :3, 3])
    with pytest.raises(Infeasible, match=r"sample (\d+): (the forearm|forearm|wrist) and the wheel overlap") as told:
        hit(q, obstacle(elbow))
    first = int(str(told.value).split()[1].rstrip(":"))
    assert 40 < first < 100
    with pytest.raises(Infeasible):
        hit(q[first : first + 1], obstacle(elbow))
    hit(q[: first - 1], obstacle(elbow))
    tip = T[6] @ np.array([0.0, 0.0, 0.3, 1.0])
    with pytest.raises(Infeasible, match="the blade is .* mm inside the wheel"):
        hit(q, obstacle(tip[:3]))


def test_an_arm_that_folds_into_itself_is_refused():
    q = np.radians(np.linspace([0.0, -80, 90, 0, 30, 0], [0.0, -135, 154, 0, 110, 0], 120))
    with pytest.raises(Infeasible, match="overlap by"):
        hit(q, obstacle(np.array([9.0, 0.0, 0.0])))


def test_blocks_that_ask_for_too_much_are_told(tmp_path):
    folder = written("axis", tmp_path)
    path = folder / "BLADE_1_01.src"
    text = path.read_text()
    ends = [line for line in text.splitlines() if "END=" in line]
    for line in ends:
        value = float(line.split("=")[1])
        text = text.replace(line, f"  TIME_BLOCK END={value / 3:.5f}")
    path.write_text(text)
    track = drive(read_program(folder), ROBOT)
    assert any("would stretch the time" in note for note in track.notices)
    assert LIMITS is not None


def test_parts_that_are_missed_leave_the_end_and_the_way(tmp_path):
    """Points are met at other times: the feed varies by about what the parts do, the way by hardly anything."""
    program = read_program(written("axis", tmp_path))
    blocks = [m for m in program.motions if m.times is not None]
    missed = missed_parts(program, ROBOT, {(m.file, m.line) for m in blocks[2:3]})
    assert 0.03 < missed.speed < 0.12 and 0 < missed.axes < np.radians(0.5)
    assert 0 < missed.along < 1e-3 and missed.aside < 0.1 * missed.along
    assert missed_parts(program, ROBOT, set()) is None


def test_what_the_printed_ends_of_many_blocks_add_up_to_is_no_other_time(tmp_path):
    """A hundred blocks end up to 10 us late each: 0.5 ms at 200 deg/s are a tenth of a degree; ten times that is another plan."""
    time = np.arange(0.0, 100.0, 0.025)
    way = np.radians(100.0) * (1 - np.cos(2.0 * time))[:, None] * np.ones(6)  # 200 deg/s at most
    plan = SimpleNamespace(path=tmp_path / "plan.csv", time=time, q=way, segment=np.arange(len(time)) // 40)
    fine = np.arange(0.0, 100.0, 0.001)
    for late, refused in ((5e-4, False), (5e-3, True)):
        driven = np.radians(100.0) * (1 - np.cos(2.0 * (fine - late * fine / 100.0)))[:, None] * np.ones(6)
        track = SimpleNamespace(time=fine, q=driven)
        if refused:
            with pytest.raises(BadInput, match="from where the plan has them"):
                refuse_other_times(track, plan)
        else:
            refuse_other_times(track, plan)
