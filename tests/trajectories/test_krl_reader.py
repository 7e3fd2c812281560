"""The reader on programs of other hands: inline forms, named points, other frames; and what it refuses to guess."""

import numpy as np
import pytest

from robots.errors import BadInput
from robots.pose import abc_from_rotation, invert, transform_from_xyzabc
from tests.support.krl_example import T_BASE_WHEEL, T_FLANGE_BLADE, contact_poses, elementary_forward, example, legs, write
from trajectories.krl.dialect import KRL
from trajectories.krl.interpreter import execute
from trajectories.krl.reader import parse_text, read_module
from trajectories.krl.syntax import Aggregate, Assignment, BlockStart, Call, Declaration, MotionStatement, Number, Word
from trajectories.program.old_program import contact_frames_from_program

Q = np.radians([[5.0, -70, 100, 10, -40, 20], [6.0, -71, 101, 9, -41, 22], [7.0, -72, 102, 8, -42, 24]])


def frame(T):
    values = [*(T[:3, 3] * 1e3), *np.degrees(abc_from_rotation(T[:3, :3]))]
    return "{" + ",".join(f"{n} {v:.6f}" for n, v in zip("XYZABC", values, strict=True)) + "}"


def e6pos(T):
    return frame(T)[:-1] + ",S 2,T 35,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}"


def old_passes(source):
    return contact_frames_from_program(KRL.read(source), elementary_forward, T_FLANGE_BLADE, T_BASE_WHEEL)


OLD_SRC = """&ACCESS RVO
&REL 17
&PARAM EDITMASK = *
DEF old( )
  DECL INT i
;FOLD INI
  GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
  INTERRUPT ON 3
  BAS (#INITMOV,0 )
;ENDFOLD (INI)
;FOLD PTP HOME  Vel= 100 % DEFAULT;%{PE}%MKUKATPBASIS
$BWDSTART = FALSE
PDAT_ACT=PDEFAULT
FDAT_ACT=FHOME
BAS (#PTP_PARAMS,100 )
$H_POS=XHOME
PTP  XHOME
;ENDFOLD
WAIT SEC 0.5
$OUT[3]=TRUE
;FOLD LIN P1 Vel=0.1 m/s
FDAT_ACT=FP1
BAS(#CP_PARAMS,0.1)
PTP XP1
LIN xp2 C_DIS C_DIS
LIN XP3
;ENDFOLD
TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[4]=TRUE
END

DEF local( )
END
"""


def old_files(folder, mode, poses, src=OLD_SRC):
    points = "\n".join(f"DECL E6POS XP{i + 1}={e6pos(P)}" for i, P in enumerate(poses))
    (folder / "old.src").write_text(src, encoding="latin-1")
    (folder / "old.dat").write_text(
        "DEFDAT  OLD PUBLIC\n;FOLD EXTERNAL DECLARATIONS\nEXT  BAS (BAS_COMMAND  :IN,REAL  :IN )\nDECL INT SUCCESS\n"
        'DECL BASIS_SUGG_T LAST_BASIS={POINT1[] "P2     ",CP_PARAMS[] "CPDAT0",DEEP {A 1,B #YES}}\n'
        f'{points}\nDECL FDAT FP1={{TOOL_NO 3,BASE_NO 5,IPO_FRAME {mode},POINT2[] " "}}\n'
        "DECL LDAT LCPDAT1={VEL 2.0,ACC 1E2,APO_DIST 100.0}\nDECL PDAT PPDAT1={VEL 100.0}\nENDDAT\n",
        encoding="latin-1",
    )
    return folder / "old.src"


def test_an_old_program_under_tcp_gives_its_contact_frames(tmp_path):
    P = contact_poses(Q)
    passes, notices = old_passes(old_files(tmp_path, "#TCP", P))
    assert len(passes) == 1
    assert np.allclose(passes[0].frames, P[1:], atol=1e-8)
    assert np.allclose(passes[0].flange, elementary_forward(Q)[1:], atol=1e-8)
    assert [OLD_SRC.split("\n")[i - 1] for i in passes[0].lines] == ["LIN xp2 C_DIS C_DIS", "LIN XP3"]
    assert any("XHOME" in n for n in notices) and any("tool 3 and base 5" in n for n in notices)


def test_an_old_program_in_base_coordinates_gives_the_same(tmp_path):
    tool_in_base = invert(T_BASE_WHEEL) @ elementary_forward(Q) @ T_FLANGE_BLADE
    passes, _ = old_passes(old_files(tmp_path, "#BASE", tool_in_base))
    assert np.allclose(passes[0].frames, contact_poses(Q)[1:], atol=1e-8)


@pytest.mark.parametrize("begins", ["", "BAS (#INITMOV,0 )\n"])
def test_a_program_that_does_not_name_the_mode_gives_poses_of_the_tool_in_the_base(begins, tmp_path):
    poses = invert(T_BASE_WHEEL) @ elementary_forward(Q) @ T_FLANGE_BLADE
    frames = f"$TOOL={frame(T_FLANGE_BLADE)}\n$BASE={frame(T_BASE_WHEEL)}\n"
    (tmp_path / "x.src").write_text(f"DEF x( )\n{begins}{frames}{''.join(f'LIN {frame(P)}' + chr(10) for P in poses)}END\n")
    passes, notices = old_passes(tmp_path / "x.src")
    assert np.allclose(passes[0].flange, elementary_forward(Q), atol=1e-7) and not notices


def test_frames_that_the_program_sets_count_for_its_own_poses(tmp_path):
    tool, base = transform_from_xyzabc([0.1, 0, 0.3], [0.2, 0, 0]), transform_from_xyzabc([1, 0.5, 0.8], [0, 0.3, 0])
    P = invert(elementary_forward(Q) @ tool) @ base
    text = (
        f"DEF x( )\nBAS (#INITMOV,0 )\nTOOL_DATA[2]={frame(tool)}\n$TOOL=TOOL_DATA[2]\n$BASE={frame(base)}\n$IPO_MODE=#TCP\n"
        f"$VEL.CP=0.05\nSPLINE\n" + "".join(f"SPL {frame(T)}\n" for T in P) + "ENDSPLINE\nEND\n"
    )
    (tmp_path / "x.src").write_text(text)
    passes, notices = old_passes(tmp_path / "x.src")
    assert np.allclose(passes[0].flange, elementary_forward(Q), atol=1e-7)
    assert np.allclose(passes[0].frames, contact_poses(Q), atol=1e-7)
    assert (passes[0].feed == 0.05).all() and not notices


@pytest.mark.parametrize("tool", ["BAS(#TOOL,12)", "$TOOL=TOOL_DATA[12]"])
def test_of_the_cell_only_the_frame_is_taken_that_the_program_lacks(tool, tmp_path):
    base = transform_from_xyzabc([1, 0.5, 0.8], [0, 0.3, 0])
    P = invert(elementary_forward(Q) @ T_FLANGE_BLADE) @ base
    body = "".join(f"LIN {frame(T)}\n" for T in P)
    (tmp_path / "x.src").write_text(f"DEF x( )\n{tool}\n$BASE={frame(base)}\n$IPO_MODE=#TCP\n{body}END\n")
    passes, notices = old_passes(tmp_path / "x.src")
    assert notices == ("x.src: tool 12 is not in the program; the cell's blade frame is taken",)
    assert np.allclose(passes[0].flange, elementary_forward(Q), atol=1e-7)
    assert np.allclose(passes[0].frames, contact_poses(Q), atol=1e-7)  # seen by the cell's wheel, wherever the base was


def test_a_path_through_axes_and_poses_has_a_pose_for_every_line_and_no_axes(tmp_path):
    axes = "{" + ",".join(f"A{k} {v:.9f}" for k, v in enumerate(np.degrees(Q[0]), 1)) + "}"
    body = "".join(f"LIN {target}\n" for target in (axes, *(frame(P) for P in contact_poses(Q[1:]))))
    (tmp_path / "x.src").write_text(f"DEF x( )\n$IPO_MODE=#TCP\n{body}END\n")
    (one,), _ = old_passes(tmp_path / "x.src")
    assert one.q is None and len(one.lines) == len(one.feed) == 3
    assert np.allclose(one.flange, elementary_forward(Q), atol=1e-7)


@pytest.mark.parametrize("kind", ["cartesian", "lin"])
def test_our_own_programs_of_poses_tell_the_speed_of_every_line_and_no_feed_of_blocks_with_times(kind, tmp_path):
    """$VEL.CP of a timed block is a bound, twice what is driven."""
    (tmp_path / kind).mkdir()
    passes, notices = old_passes(write(example(kind), tmp_path / kind))
    one = passes[-1] if kind == "lin" else passes[-2]
    assert not notices and len(one.feed) == len(one.lines) > 30
    if kind == "cartesian":
        assert np.isnan(one.feed).all()
    else:
        ways = np.linalg.norm(np.diff(one.frames[:, :3, 3], axis=0), axis=1)
        assert one.feed.max() > 5 * one.feed.min() and np.median(ways / one.feed[1:]) == pytest.approx(0.025, abs=1e-3)


def test_our_own_axis_program_can_be_the_old_one(tmp_path):
    source = write(example(passes=2), tmp_path)
    passes, _ = old_passes(source)
    contact = legs()[2].trajectory
    assert len(passes) == 8
    assert np.abs(passes[2].q[0] - contact.q(0.0)).max() < 1e-7
    assert np.allclose(passes[2].frames, contact_poses(passes[2].q), atol=1e-12)


def test_positions_declared_in_the_dat(tmp_path):
    (tmp_path / "a.src").write_text(
        "DEF a( )\nPTP XA\nPTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nSLIN XB\nSLIN {X 1,Y 2,Z 3,A 0,B 0,C 90}\nEND\n"
    )
    (tmp_path / "a.dat").write_text(
        "DEFDAT a\nDECL E6AXIS XA={A1 10,A2 -90.5,A3 .5,A4 0,A5 +3,A6 - 4,E1 0}\n"
        "DECL GLOBAL FRAME XB={X 1,Y 2,Z 3.5,A 0,B 0,C 0}\nENDDAT\n"
    )
    first, second, third, fourth = execute(tmp_path / "a.src", strict=False).segments
    assert np.allclose(np.degrees(first.q[0]), [10, -90.5, 0.5, 0, 3, -4])
    assert np.allclose(np.degrees(second.q[0]), [1, 2, 3, 4, 5, 6])
    assert np.allclose(third.poses[0, :3, 3], [0.001, 0.002, 0.0035])
    assert np.allclose(fourth.poses[0, :3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)


def test_statements_and_their_lines():
    module = parse_text(
        "DEF x( )\n\nBAS (#INITMOV,0 )\n$VEL_AXIS[3]=20 ; slow\nPTP_SPLINE\nSPTP {A1 -1.5}\nENDSPLINE\nEND\n", read_path("x.src")
    )
    kinds = {type(s): s for s in module.statements}
    assert kinds[Call].arguments == ("#INITMOV", "0") and kinds[Call].line == 3
    assert kinds[Assignment].target == "$VEL_AXIS[3]" and kinds[Assignment].value == Number(20.0, "20")
    assert kinds[BlockStart].kind == "PTP_SPLINE"
    assert kinds[MotionStatement].target == Aggregate((("A1", Number(-1.5, "-1.5")),)) and kinds[MotionStatement].line == 6


def read_path(name):
    from pathlib import Path

    return Path(name)


def test_declarations_with_strings_and_nested_values():
    module = parse_text('DEFDAT x\nDECL LDAT L={VEL 2.0,NAME[] "a;{b"}\nINT I=-3\nENDDAT\n', read_path("x.dat"))
    found = [s for s in module.statements if isinstance(s, Declaration)]
    assert found[0].value.get("NAME[]") == Word('"a;{b"')
    assert (found[1].type, found[1].name, found[1].value.value) == ("INT", "I", -3.0)


@pytest.mark.parametrize(
    "line, words",
    [
        ("IF $IN[1] THEN", "decides at run time"),
        ("FOR I=1 TO 3", "decides at run time"),
        ("CIRC XP1, XP2", "not supported"),
        ("LIN_REL {X 1}", "not supported"),
        ("LIN XP1:XP2", "geometric operator"),
        ("LIN XP99", "not declared"),
        ("LIN {X 1,Y 2}", "not complete; expected A1..A6 or X, Y, Z, A, B, C"),
        ("LIN {A1 1,A2 2,A3 3,A4 4,A5 5}", "not complete; expected A1..A6 or X, Y, Z, A, B, C"),
    ],
)
def test_what_hides_the_path_is_refused_with_its_line(line, words, tmp_path):
    source = old_files(tmp_path, "#TCP", contact_poses(Q), OLD_SRC.replace("LIN XP3", line))
    with pytest.raises(BadInput, match=rf"old\.src, line 26: .*{words}"):
        old_passes(source)


def test_files_that_are_none(tmp_path):
    with pytest.raises(BadInput, match="there is no such program"):
        execute(tmp_path / "none.src")
    (tmp_path / "stl.src").write_bytes(bytes(range(256)))
    with pytest.raises(BadInput, match=r"stl\.src, line \d+"):
        read_module(tmp_path / "stl.src", strict=False)
    (tmp_path / "ptp.src").write_text("DEF ptp1( )\nPTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nEND\n")
    with pytest.raises(BadInput, match="no path of two or more"):
        old_passes(tmp_path / "ptp.src")
