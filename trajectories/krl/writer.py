"""KRL text of a program: deterministic bytes, CRLF, ASCII (KRL.md, "Files" and "Motion")."""

import numpy as np

from robots.pose import Array, abc_from_rotation
from trajectories.krl.names import comment_text
from trajectories.krl.program import (
    Block,
    Comment,
    PointMotion,
    PoseLines,
    PoseSpline,
    Program,
    Setup,
    Stop,
    SubProgram,
    TimedSpline,
    validate,
)
from trajectories.krl.status_turn import status_of, turn_of

HEADER = ("&ACCESS RVP", "&REL 1")
INI = (
    ";FOLD INI",
    "  ;FOLD BASISTECH INI",
    "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "    INTERRUPT ON 3",
    "    BAS (#INITMOV,0 )",
    "  ;ENDFOLD (BASISTECH INI)",
    ";ENDFOLD (INI)",
)
EXTERNALS = (
    ";FOLD EXTERNAL DECLARATIONS",
    "  ;FOLD BASISTECH EXT",
    "  EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )",
    "  DECL INT SUCCESS",
    "  ;ENDFOLD (BASISTECH EXT)",
    ";ENDFOLD (EXTERNAL DECLARATIONS)",
)
TIME_UNIT = 1e-5  # s, the last decimal of a time part


def program_files(program: Program) -> dict[str, bytes]:
    """File name -> bytes of every .src and .dat, main program first.

    Raises BadInput for a program that must not be written (see `validate`).
    """
    validate(program)
    files = _pair(program.name, program.setup, _main(program), "grindplan main program")
    for sub in program.subs:
        files |= _pair(sub.name, program.setup, _sub(sub, program.setup), sub.comment or "grindplan pass")
    return files


def _pair(name: str, setup: Setup, body: list[str], comment: str) -> dict[str, bytes]:
    head = [*HEADER, f"&COMMENT {comment_text(comment, 60)}"]
    src = [*head, f"DEF {name}( )", *INI, *_frames(setup), *body, "END"]
    dat = [*head, f"DEFDAT {name}", *EXTERNALS, "ENDDAT"]
    return {f"{name}.src": _bytes(src), f"{name}.dat": _bytes(dat)}


def _bytes(lines: list[str]) -> bytes:
    return ("\r\n".join(lines) + "\r\n").encode("ascii")


def number(value: float, decimals: int) -> str:
    """Fixed decimals, no exponent, and 0 without a sign."""
    text = f"{value:.{decimals}f}"
    return text[1:] if float(text) == 0 and text.startswith("-") else text


def _frame(T: Array) -> str:
    xyz = T[:3, 3] * 1e3
    abc = np.degrees(abc_from_rotation(T[:3, :3]))
    parts = [f"{c} {number(v, 4)}" for c, v in zip("XYZ", xyz, strict=True)]
    return "{" + ",".join(parts + [f"{c} {number(v, 5)}" for c, v in zip("ABC", abc, strict=True)]) + "}"


def _axes(q: Array) -> str:
    return "{" + ",".join(f"A{i} {number(v, 5)}" for i, v in enumerate(np.degrees(q), 1)) + "}"


def _frames(setup: Setup) -> list[str]:
    """Frames and load, after BAS(#INITMOV,0), which resets them."""
    com, inertia = setup.load_com * 1e3, setup.load_inertia
    load = f"$LOAD={{M {number(setup.load_mass, 3)},CM {{"
    load += ",".join(f"{c} {number(v, 3)}" for c, v in zip("XYZ", com, strict=True))
    load += ",A 0.0,B 0.0,C 0.0},J {"
    load += ",".join(f"{c} {number(v, 4)}" for c, v in zip("XYZ", inertia, strict=True)) + "}}"
    tool, base = _frame(setup.T_flange_blade), _frame(setup.T_base_wheel)
    from_data = setup.base_from_data and setup.kind != "axis"
    return [
        f"; blade frame on the flange, as in TOOL_DATA[{setup.tool_no}]",
        f"$TOOL={tool}",
        f"; wheel frame in world, as in BASE_DATA[{setup.base_no}]" + (f": {base}" if from_data else ""),
        f"$BASE=BASE_DATA[{setup.base_no}]" if from_data else f"$BASE={base}",
        "$IPO_MODE=#TCP",
        load,
    ]


def _main(program: Program) -> list[str]:
    lines = [f"; {comment_text(text)}" for text in program.comments]
    return lines + [f"{sub.name} ( )" for sub in program.subs]


def _sub(sub: SubProgram, setup: Setup) -> list[str]:
    lines: list[str] = []
    speeds: list[str] = []
    for block in sub.blocks:
        wanted = _axis_speeds(block)
        lines += [line for line in wanted if line not in speeds]
        speeds = wanted or speeds
        if isinstance(block, Comment):
            lines.append(f"; {comment_text(block.text)}")
        elif isinstance(block, Stop):
            lines.append(_stop(block))
        elif isinstance(block, PointMotion):
            lines.append(f"PTP {_axes(block.q)}")
        elif isinstance(block, TimedSpline):
            lines += _timed_spline(block)
        else:
            lines += _poses(block, setup)
    return lines


def _stop(block: Stop) -> str:
    if block.seconds is not None:
        return f"WAIT SEC {number(block.seconds, 2)}"
    return "HALT" if block.input is None else f"WAIT FOR $IN[{block.input}]"


def _axis_speeds(block: Block) -> list[str]:
    if isinstance(block, PointMotion):
        speed, acceleration = block.speed_percent, block.acceleration_percent
    elif isinstance(block, TimedSpline):
        # programmed axis speeds bound a timed block as well: full, so that only the machine's limits do
        speed, acceleration = 100, 100
    else:
        return []
    return [f"$VEL_AXIS[{i}]={speed:d}" for i in range(1, 7)] + [f"$ACC_AXIS[{i}]={acceleration:d}" for i in range(1, 7)]


def _timed_spline(block: TimedSpline) -> list[str]:
    lines = ["PTP_SPLINE", f"  SPTP {_axes(block.q[0])}", "  TIME_BLOCK START"]
    # Times are rounded, not steps, so that the parts add up to the end in the printed decimals.
    ticks = np.rint((np.asarray(block.t) - block.t[0]) / TIME_UNIT).astype(int)
    for q, part in zip(block.q[1:], np.diff(ticks), strict=True):
        lines += [f"  SPTP {_axes(q)}", f"  TIME_BLOCK PART={number(part * TIME_UNIT, 5)}"]
    return [*lines, f"  TIME_BLOCK END={number(ticks[-1] * TIME_UNIT, 5)}", "ENDSPLINE"]


def _poses(block: PoseSpline | PoseLines, setup: Setup) -> list[str]:
    q = np.radians(np.round(np.degrees(block.q), 5))  # a sign that is not printed decides no bit
    S, T = status_of(q, setup.arm), turn_of(q)
    points = [f"{_frame(P)[:-1]},S {s},T {t}}}" for P, s, t in zip(block.poses, S, T, strict=True)]
    lines = [f"$VEL.CP={number(block.feed, 5)}", f"$ACC.CP={number(block.acceleration, 3)}"]
    if isinstance(block, PoseSpline):
        return [*lines, "SPLINE", *(f"  SPL {p}" for p in points), "ENDSPLINE"]
    return [*lines, "$APO.CVEL=100", *(f"LIN {p} C_VEL" for p in points[1:-1]), f"LIN {points[-1]}"]
