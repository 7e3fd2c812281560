"""From the motion to the files and back: emitted points, table, and the text read as the only truth."""

import csv
import itertools
import re
from dataclasses import replace

import numpy as np
import pytest

from ocp.plan import readback
from ocp.plan.motion import PlannedMotion
from ocp.plan.programming import build_timeline, emitted_times, grinding_program, wheel_frame, write_plan_csv, write_program
from ocp.plan.readback import _apart, _chained, _timed
from ocp.plan.second_route import VerifiedPass
from ocp.simulate.twin.controller import drive
from ocp.simulate.twin.krl_text import read_program
from robots.errors import BadInput, Infeasible
from robots.kinematics import forward
from robots.pose import apply
from tests.support.example_pass import bar_pass
from tests.support.invented_motion import cell, checked, motion, written
from tests.support.toy_dialect import TOY
from trajectories.dialects import DIALECTS
from trajectories.krl.interpreter import execute
from trajectories.program.driven import axes_along, path_peaks, pose_curve, reinterpolate


def test_segments_follow_one_another_without_a_gap():
    segments = motion().segments
    for a, b in itertools.pairwise(segments):
        assert a.end == pytest.approx(b.start)
        np.testing.assert_allclose(a.trajectory.q(a.trajectory.duration), b.trajectory.q(0.0), atol=1e-9)
    assert motion().duration == pytest.approx(sum(s.trajectory.duration for s in segments))
    assert motion().way(1).kind == "pass" and motion().way(1).place == 1


def test_the_wheel_frame_stands_at_the_contact_with_x_along_the_belt():
    T, wheel = wheel_frame(cell()), cell().wheel
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
    v = T[:3, 3] - wheel.centre
    assert np.linalg.norm(v) == pytest.approx(wheel.radius) and abs(v @ wheel.axis) < 1e-12
    np.testing.assert_allclose(T[:3, 0], np.cross(wheel.axis, v / wheel.radius), atol=1e-12)


# -- timeline and table --------------------------------------------------------------------------------------------


def test_every_emitted_point_is_a_row(tmp_path):
    program, _ = written(tmp_path)
    times = emitted_times(motion(), program)
    rows = build_timeline(motion(), times)
    assert len(rows.time) == sum(len(t) for t in times)
    for segment, t in zip(motion().segments, times, strict=True):
        assert t[0] == 0.0 and t[-1] == pytest.approx(segment.trajectory.duration, abs=2e-3)
        assert (np.diff(t) > 0).all()
    for index, segment in enumerate(motion().segments):
        mine = rows.segment == index
        at = rows.time[mine] - segment.start
        np.testing.assert_allclose(rows.q[mine], segment.trajectory.q(at), atol=1e-9)
        np.testing.assert_allclose(rows.qd[mine], segment.trajectory.qd(at), atol=1e-7)
        np.testing.assert_allclose(rows.qdd[mine], segment.trajectory.qdd(at), atol=1e-4)
        edges = motion().passes[min(segment.place, 1)].problem.way.edges
        nominal = segment.trajectory.s(at) / 0.04
        touching = (segment.kind == "pass") & (nominal > edges[1]) & (nominal < edges[4])
        assert (rows.contact[mine] != touching).sum() <= 2  # but for rounding at touch and lift
        np.testing.assert_array_equal(rows.contact[mine], rows.phase[mine] > 0)
        assert set(rows.line[mine]) == ({0} if segment.kind == "travel" else {3 + segment.place})


def test_what_has_no_meaning_off_contact_is_no_number():
    times = [np.linspace(0, s.trajectory.duration, 30) for s in motion().segments]
    rows = build_timeline(motion(), times)
    path = bar_pass(n=26, length=0.05)
    for name in ("p", "n", "t", "s", "feed", "force", "force_sd", "interference"):
        values = getattr(rows, name).reshape(len(rows.time), -1)
        assert np.isnan(values[~rows.contact]).all() and np.isfinite(values[rows.contact]).all(), name
    on = rows.contact
    np.testing.assert_allclose(rows.p[on][:, 2], 0.03 + rows.s[on], atol=1e-9)
    np.testing.assert_allclose(rows.force[rows.phase == 2], path.force[0], atol=1e-9)
    ramps = on & (rows.phase != 2)
    assert (rows.force[ramps] < path.force[0] + 1e-9).all() and (rows.force[ramps] >= 0.0).all()
    np.testing.assert_allclose(rows.force[on] / path.force[0], rows.feed[on] / path.feed[0], atol=2e-3)  # force with feed
    np.testing.assert_allclose(rows.force_sd[on], 2.0 + 10 * rows.s[on], atol=1e-9)
    np.testing.assert_allclose(rows.interference[on], 1e-4 + 1e-3 * rows.s[on], atol=1e-12)
    assert (np.diff(rows.time) >= -1e-12).all() and rows.limit_ratio.max() <= 1.0


def test_the_table_is_in_millimetres_and_degrees_and_reads_back(tmp_path):
    times = [np.linspace(0, s.trajectory.duration, 20) for s in motion().segments]
    rows = build_timeline(motion(), times)
    write_plan_csv(rows, tmp_path / "plan.csv")
    text = (tmp_path / "plan.csv").read_bytes().decode("ascii")
    assert "\r" not in text and text.endswith("\n") and "nan" not in text and "inf" not in text
    assert not re.search(r"(^|,)-0(\.0*)?(,|$)", text, re.MULTILINE), "a minus before nothing"
    table = list(csv.DictReader(text.splitlines()))
    assert len(table) == len(rows.time)
    off = [row for row in table if row["contact"] == "0"]
    empty = ("px_mm", "nx", "ty", "s_mm", "feed_mm_s", "fn_N", "fn_sd_N", "interference_mm")
    assert off and all(row[name] == "" for row in off for name in empty)
    for i in range(6):
        read = np.array([float(row[f"q{i + 1}_deg"]) for row in table])
        np.testing.assert_allclose(np.radians(read), rows.q[:, i], atol=1e-8)
        read = np.array([float(row[f"qdd{i + 1}_deg_s2"]) for row in table])
        np.testing.assert_allclose(np.radians(read), rows.qdd[:, i], atol=1e-5)
    on = [row for row in table if row["contact"] == "1"]
    np.testing.assert_allclose([float(r["pz_mm"]) for r in on], 1e3 * rows.p[rows.contact, 2], atol=1e-5)
    np.testing.assert_allclose([float(r["interference_mm"]) for r in on], 1e3 * rows.interference[rows.contact], atol=1e-6)
    assert {row["line"] for row in table} == {"0", "3", "4"}


def test_a_negative_nothing_is_written_without_its_minus(tmp_path):
    times = [np.array([0.0, s.trajectory.duration]) for s in motion().segments]
    rows = build_timeline(motion(), times)
    write_plan_csv(replace(rows, qd=np.full_like(rows.qd, -1e-12), q=np.full_like(rows.q, -0.1)), tmp_path / "a.csv")
    row = next(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert row["qd1_deg_s"] == "0.00000" and row["q1_deg"].startswith("-5.72957")


# -- the program ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["axis", "cartesian", "lin"])
def test_every_kind_stands_the_checks_and_comes_out_the_same_twice(tmp_path, kind):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    _, main = written(tmp_path / "a", kind)
    written(tmp_path / "b", kind)
    assert main.name == "BLADE_1.src"
    execution = checked(main)
    assert execution.segments
    one, two = ({p.name: p.read_bytes() for p in (tmp_path / f).iterdir()} for f in "ab")
    assert one == two


def test_absolute_accuracy_and_poses_are_refused():
    accurate = replace(cell(), controller=replace(cell().controller, absolute_accuracy=True))
    with pytest.raises(BadInput, match="absolute_accuracy"):
        grinding_program(accurate, motion(), "cartesian", "x")


@pytest.mark.parametrize("name", ["x(); $OV_PRO=100 ;.stl", "a\nHALT\n.stl", "END", "ü ß.stl", "", "9" * 80, "..", ";FOLD"])
def test_no_name_of_a_file_reaches_the_text(tmp_path, name):
    _, main = written(tmp_path, name=name)
    assert re.fullmatch(r"[A-Z][A-Z0-9_]{0,23}\.src", main.name)
    checked(main)
    for file in tmp_path.iterdir():
        text = file.read_text(encoding="ascii")
        assert "$OV_PRO" not in text and not re.search(r"(?m)^\s*HALT", text)


# -- read back -----------------------------------------------------------------------------------------------------


def test_the_text_moves_the_axes_as_planned(tmp_path):
    _, main = written(tmp_path)
    driven, axis_error, time_error, ratio = _timed(cell(), motion(), checked(main))
    assert axis_error < np.radians(2e-3) and time_error < 1e-3 and 0 < ratio <= 1.0
    assert len(driven) == 2
    for t, q, s in driven:
        assert t[0] == 0.0 and (np.diff(t) > 0).all() and np.diff(t).max() <= 1e-3 + 1e-12
        assert s[0] == pytest.approx(0.0, abs=1e-9) and s[-1] == pytest.approx(motion().passes[0].problem.way.at[-1], rel=1e-4)
        assert q.shape == (len(t), 6)


def test_a_point_moved_in_the_text_is_noticed(tmp_path):
    _, main = written(tmp_path)
    _, sound, _, _ = _timed(cell(), motion(), checked(main))
    file = main.with_name(f"{main.stem}_01.src")
    points = list(re.finditer(r"SPTP \{A1 (-?[\d.]+)", file.read_bytes().decode("ascii")))
    middle = points[len(points) // 2]
    text = file.read_bytes().decode("ascii")
    a, b = middle.span(1)
    file.write_bytes((text[:a] + f"{float(middle[1]) + 0.05:.6f}" + text[b:]).encode("ascii"))
    try:
        _, error, _, _ = _timed(cell(), motion(), execute(main))  # the reader's checks would refuse such a kink already
    except Infeasible:
        return  # the kink alone may break a limit
    assert error > np.radians(0.04) > 10 * sound


def test_a_block_that_is_missing_is_noticed(tmp_path):
    _, main = written(tmp_path)
    shorter = PlannedMotion(motion().passes, motion().segments[:-1])
    with pytest.raises(Infeasible, match="timed blocks"):
        _timed(cell(), shorter, checked(main))


def test_a_program_timed_for_a_stronger_machine_is_refused(tmp_path):
    _, main = written(tmp_path)
    weak = replace(cell(), robot=replace(cell().robot, qdd_max=0.5 * cell().robot.qdd_max))
    with pytest.raises(Infeasible, match="of an axis limit"):
        _timed(weak, motion(), checked(main))


# -- programs of poses ----------------------------------------------------------------------------------------------


def ends(execution):
    """Posture (6,) at the end of every block of a program: a timed one, a chain of lines that blend, a move to a point."""
    found, where = [], None
    for k, s in enumerate(execution.segments):
        if s.q is not None:
            where = s.q[-1]
        elif s.blended:
            assert execution.segments[k + 1].kind == "line", "a chain goes on"
            continue
        else:
            where = axes_along(cell().robot, s.frames, s.poses[-1:], where)[0]
        found.append(where)
    return np.array(found)


@pytest.mark.parametrize("kind", ["axis", "cartesian", "lin"])
def test_no_block_ends_while_wheel_and_blade_touch(kind, tmp_path):
    """Where a block ends the robot rests: a dwell under force grinds a notch."""
    found = ends(checked(written(tmp_path, kind)[1]))
    rows = build_timeline(motion(), [np.linspace(0, s.trajectory.duration, 4000) for s in motion().segments])
    off = np.abs(found[:, None] - rows.q[None]).max(axis=2)
    nearest = off.argmin(axis=1)
    assert off[np.arange(len(found)), nearest].max() < np.radians(0.01)
    assert rows.contact.any() and not rows.contact[nearest].any()
    passes = [s for s in motion().segments if s.kind == "pass"]
    for one in passes:  # both ends of every pass are among them
        for t in (0.0, one.trajectory.duration):
            assert np.abs(found - one.trajectory.q(t)).max(axis=1).min() < np.radians(2e-3)


def test_poses_drive_what_axes_drive_by_both_readers(tmp_path):
    """In mm, N and ms: what is emitted may miss the plan by 0.05 N and 20 um, in time by what is printed."""
    point, stiffness = cell().workpiece.T_flange_blade[:3, 3], 5000.0
    seen, lasts, grid = {}, {}, np.arange(0.0, motion().duration, 2e-3)
    for kind in ("axis", "cartesian"):
        (tmp_path / kind).mkdir()
        main = written(tmp_path / kind, kind)[1]
        product = reinterpolate(checked(main), cell().robot)
        track = drive(read_program(tmp_path / kind, planned=True), cell().robot, 500.0)
        assert track.notices == ()
        lasts[kind] = (product.duration, track.duration)
        twin = np.stack([np.interp(grid, track.time, q) for q in track.q.T], axis=1)
        seen[kind] = [apply(forward(cell().robot, q), point) for q in (product.q(grid), twin)]
    planned = np.concatenate([s.trajectory.q(grid[(grid >= s.start) & (grid < s.end)] - s.start) for s in motion().segments])
    planned = apply(forward(cell().robot, planned), point)
    assert np.ptp([*lasts["axis"], *lasts["cartesian"], motion().duration]) < 1e-3
    on = np.concatenate([np.full(((grid >= s.start) & (grid < s.end)).sum(), s.kind == "pass") for s in motion().segments])
    for reader in (0, 1):
        apart = np.linalg.norm(seen["axis"][reader] - seen["cartesian"][reader], axis=1)
        assert apart[on].max() < 2e-5 and stiffness * apart[on].max() < 0.1
        assert np.linalg.norm(seen["cartesian"][reader] - planned, axis=1)[on].max() < 2e-5


def test_what_the_bounds_of_a_pose_block_leave(tmp_path):
    """Twice what its times ask for, so that they do not bind, and no more than that."""
    for segment in checked(written(tmp_path, "cartesian")[1]).segments:
        if segment.word == "SPLINE":
            t = np.arange(0.0, segment.times[-1], 1e-3)
            peaks = path_peaks(pose_curve(segment.poses, segment.times)(t))
            for name in ("speed", "acceleration", "turn_speed", "turn_acceleration"):
                assert getattr(segment.bounds, name) == pytest.approx(2 * getattr(peaks, name), rel=0.05), name


def resting_chain(main, between=b""):
    """One line of the first chain no longer blends; what may stand between it and the next."""
    file = main.with_name(f"{main.stem}_01.src")
    text = file.read_bytes()
    lines = [m.end() for m in re.finditer(rb"\} C_VEL\r\n", text)]
    k = lines[len(lines) // 2]
    file.write_bytes(text[: k - 8] + b"\r\n" + between + text[k:])


def test_a_line_that_rests_before_the_next_is_refused(tmp_path):
    _, main = written(tmp_path, "lin")
    resting_chain(main)
    with pytest.raises(BadInput, match="does not blend into this one; the robot would stop on the blade"):
        checked(main)


def test_a_chain_of_lines_that_something_parts_is_refused(tmp_path):
    _, main = written(tmp_path, "lin")
    assert len(_chained(cell(), motion(), checked(main))[0]) == 2
    resting_chain(main, b"$ACC.CP=1.0\r\n")
    with pytest.raises(Infeasible, match="3 chains of straight motions, 2 were planned: the robot would rest between"):
        _chained(cell(), motion(), checked(main))


@pytest.mark.parametrize("place", ["first", "middle", "last"])
def test_a_chain_to_a_pose_out_of_reach_is_refused_wherever_it_stands(place, tmp_path, monkeypatch):
    """Of the last line, which is some hundredths of a millimetre long, nothing was seen."""
    monkeypatch.setattr(readback, "SAMPLE", 0.02)
    execution = checked(written(tmp_path, "lin")[1])
    segments = list(execution.segments)
    chain = [k for k, s in enumerate(segments) if s.kind == "line"]
    chain = chain[: 1 + next(i for i, k in enumerate(chain) if not segments[k].blended)]
    k = {"first": chain[0], "middle": chain[20], "last": chain[-1]}[place]
    away = segments[k].poses + 3.0 * (np.arange(16) == 3).reshape(4, 4)
    segments[k] = replace(segments[k], poses=away)
    with pytest.raises(Infeasible, match=rf"line {segments[k].lines[0]}: the arm does not reach this pose; nothing is written"):
        _chained(cell(), motion(), replace(execution, segments=tuple(segments)))


@pytest.mark.parametrize("begins", [False, True])
def test_a_chain_that_is_on_the_pass_but_not_all_of_it_is_refused(begins, tmp_path, monkeypatch):
    """The last ten lines are gone, or the robot stands ten lines on where the first begins."""
    monkeypatch.setattr(readback, "SAMPLE", 0.02)
    execution = checked(written(tmp_path, "lin")[1])
    segments = list(execution.segments)
    last = next(k for k, s in enumerate(segments) if s.kind == "line" and not s.blended)
    first = next(k for k, s in enumerate(segments) if s.kind == "line")
    if begins:
        there = axes_along(cell().robot, segments[first].frames, segments[first + 9].poses, segments[first - 1].q[-1])
        segments[first - 1 : first + 10] = [replace(segments[first - 1], q=there)]
    else:
        segments[last - 10 : last + 1] = [replace(segments[last - 10], blended=False)]
    with pytest.raises(Infeasible, match="the straight motions read back leave the plan"):
        _chained(cell(), motion(), replace(execution, segments=tuple(segments)))


def verified(driven, place):
    """What a verification of the rows of a pass in contact would say if every force were the planned one."""
    one, (t, _, nominal) = motion().passes[place], driven[place]
    on = (nominal > one.problem.way.edges[1] + 0.02) & (nominal < one.problem.way.edges[4] - 0.02)
    planned = one.at(nominal[on])
    return VerifiedPass(t[on], planned["s"], planned["force"], planned["interference"], planned["force"], 0.0 * t[on])


def test_lines_that_blend_are_on_the_plan_and_their_depth_is_measured(tmp_path):
    """By the read-back's own model of blending; the virtual controller's takes as long. Half the speed is twice the depth."""
    _, main = written(tmp_path, "lin")
    driven, axis_error, time_error, _ = _chained(cell(), motion(), checked(main))
    assert axis_error < np.radians(5e-3) and time_error < 0.1
    track = drive(read_program(tmp_path, planned=True), cell().robot, 1000.0)
    lasting = [np.ptp(track.time[track.motion == k]) for k in range(len(track.places))]
    for t, _, _ in driven:
        assert any(abs(seconds / t[-1] - 1.0) < 5e-3 for seconds in lasting)
    held, blends = _apart(motion(), 0, driven[0], verified(driven, 0))
    assert blends.force == 0.0 and 0.0 < blends.dose < 0.04
    assert held.planned.min() == pytest.approx(20.0, abs=1e-6) and len(held.s) < len(verified(driven, 0).s)
    seen = verified(driven, 0)
    beside = seen.planned < 19.0
    for off, where, told in ((0.15, beside, 0.15), (-0.15, beside, 0.15), (0.15, ~beside & (seen.planned > 20.0 - 1e-6), 0.0)):
        held, blends = _apart(motion(), 0, driven[0], replace(seen, force=seen.force + off * where))
        assert blends.force == pytest.approx(told) and np.ptp(held.force) == pytest.approx(0.0, abs=1e-6)
        assert held.force[0] - 20.0 == pytest.approx(0.15 - told, abs=1e-6)
    file = main.with_name(f"{main.stem}_01.src")
    speeds = list(re.finditer(r"\$VEL\.CP=([\d.]+)", text := file.read_bytes().decode()))
    for found in reversed(speeds[len(speeds) // 2 : len(speeds) // 2 + 10]):
        text = f"{text[: found.start(1)]}{0.5 * float(found[1]):.5f}{text[found.end(1) :]}"
    file.write_bytes(text.encode())
    driven = _chained(cell(), motion(), checked(main))[0]
    assert _apart(motion(), 0, driven[0], verified(driven, 0))[1].dose == pytest.approx(1.0, abs=0.1)


# -- a second dialect ----------------------------------------------------------------------------------------------


def test_a_motion_goes_through_a_second_dialect_by_the_same_way(tmp_path, monkeypatch):
    monkeypatch.setitem(DIALECTS, "toy", TOY)
    toy = replace(cell(), controller=replace(cell().controller, dialect="toy"))
    program = grinding_program(toy, motion(), "axis", "blade 1.stl")
    files = write_program(toy, program, tmp_path)
    assert [file.name for file in files] == ["blade1stl.toy"]
    driven, axis_error, time_error, ratio = _timed(toy, motion(), TOY.check(files[0], toy.robot))
    assert len(driven) == 2 and axis_error < np.radians(2e-3) and time_error < 1e-3 and 0 < ratio <= 1.0
    assert len(emitted_times(motion(), program)) == len(motion().segments)
