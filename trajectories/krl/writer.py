"""KRL text of a program: deterministic bytes, CRLF, ASCII (KRL.md, "Files" and "Motion")."""

from collections.abc import Sequence

import numpy as np

from robots.errors import BadInput
from robots.pose import Array
from trajectories.krl.names import is_legal
from trajectories.krl.status_turn import status_of, turn_of
from trajectories.krl.values import FILE_LIMITS, axes_text, comment_text, fixed, frame_text
from trajectories.program.execution import PathBounds
from trajectories.program.program import (
    KINDS,
    Block,
    Comment,
    PointMotion,
    PoseLines,
    PoseSpline,
    Program,
    Setup,
    SubProgram,
    TimedSpline,
    Wait,
    is_level,
    refuse_poses,
)

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
ADVANCE = 3  # motions that the controller plans ahead: without any it approximates nothing, KRL.md
EXTERNALS = (
    ";FOLD EXTERNAL DECLARATIONS",
    "  ;FOLD BASISTECH EXT",
    "  EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )",
    "  DECL INT SUCCESS",
    "  ;ENDFOLD (BASISTECH EXT)",
    ";ENDFOLD (EXTERNAL DECLARATIONS)",
)


def program_files(program: Program) -> dict[str, bytes]:
    """File name -> bytes of every .src and .dat, main program first.

    Raises BadInput for a program that must not be written (see `refuse_unwritable`).
    """
    refuse_unwritable(program)
    files = _pair(program.name, program.setup, _main(program), "grindplan main program")
    for sub in program.subs:
        files |= _pair(sub.name, program.setup, _sub(sub, program.setup), sub.comment or "grindplan pass")
    return files


def refuse_unwritable(program: Program) -> None:
    """Refuse (BadInput) what must not be written: illegal or double names, an unknown kind, double compensation."""
    setup = program.setup
    names = [program.name, *(s.name for s in program.subs)]
    wrong = [n for n in names if not is_legal(n)]
    if wrong:
        raise BadInput(f"'{wrong[0]}' is no program name: letters, digits and _, at most 24 characters, no keyword")
    if len({n.upper() for n in names}) < len(names):
        raise BadInput(f"two programs share a name in {', '.join(names)}; names are compared without case")
    if setup.kind not in KINDS:
        raise BadInput(f"kind '{setup.kind}' is not one of {', '.join(KINDS)}")
    refuse_poses(setup)
    for sub in program.subs:
        if sub.points > FILE_LIMITS.file_points:
            raise BadInput(f"{sub.name} has {sub.points} points and a file takes {FILE_LIMITS.file_points}; split the pass")
        first = next((b for b in sub.blocks if not isinstance(b, Comment)), None)
        if not isinstance(first, PointMotion):
            raise BadInput(f"{sub.name} must begin with a PTP to full axes")


def _pair(name: str, setup: Setup, body: list[str], comment: str) -> dict[str, bytes]:
    head = [*HEADER, f"&COMMENT {comment_text(comment, 60)}"]
    src = [*head, f"DEF {name}( )", *INI, *_frames(setup), *body, "END"]
    dat = [*head, f"DEFDAT {name}", *EXTERNALS, "ENDDAT"]
    return {f"{name}.src": _bytes(src), f"{name}.dat": _bytes(dat)}


def _bytes(lines: list[str]) -> bytes:
    return ("\r\n".join(lines) + "\r\n").encode("ascii")


def _frames(setup: Setup) -> list[str]:
    """Frames and load with what they are, after BAS(#INITMOV,0), which resets them."""
    from_data = setup.base_on_controller and setup.kind != "axis"
    told = f"in world, as in BASE_DATA[{setup.base_no}]"
    if not is_level(setup.robot) and not from_data:
        told = "in the robot's base, which $ROBROOT turns against the world: axes alone move here, do not jog in $BASE"
    return [
        f"; blade frame on the flange, as in TOOL_DATA[{setup.tool_no}]",
        f"; wheel frame {told}" + (f": {frame_text(setup.T_base_wheel)}" if from_data else ""),
        *_setting(setup),
    ]


def _setting(setup: Setup) -> list[str]:
    """Frames, their numbers and the load: again before every block, where an operator may select it."""
    com, inertia = setup.load_com * 1e3, setup.load_inertia
    load = f"$LOAD={{M {fixed(setup.load_mass, 3)},CM {{"
    load += ",".join(f"{c} {fixed(v, 3)}" for c, v in zip("XYZ", com, strict=True))
    load += ",A 0.0,B 0.0,C 0.0},J {"
    load += ",".join(f"{c} {fixed(v, 4)}" for c, v in zip("XYZ", inertia, strict=True)) + "}}"
    tool, base = frame_text(setup.T_flange_blade), frame_text(setup.T_base_wheel)
    from_data = setup.base_on_controller and setup.kind != "axis"
    return [
        f"$TOOL={tool}",
        f"$ACT_TOOL={setup.tool_no}",
        f"$BASE=BASE_DATA[{setup.base_no}]" if from_data else f"$BASE={base}",
        f"$ACT_BASE={setup.base_no}",
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
        elif isinstance(block, Wait):
            lines.append(_stop(block))
        elif isinstance(block, PointMotion):
            lines.append(f"PTP {axes_text(block.q)}")
        else:
            lines += _setting(setup)
            lines += _timed(block, setup) if isinstance(block, TimedSpline | PoseSpline) else _lines(block, setup)
    return lines


def _stop(block: Wait) -> str:
    if block.seconds is not None:
        return f"WAIT SEC {fixed(block.seconds, 2)}"
    return "HALT" if block.input is None else f"WAIT FOR $IN[{block.input}]"


def _axis_speeds(block: Block) -> list[str]:
    if isinstance(block, PointMotion):
        speed, acceleration = block.speed_percent, block.acceleration_percent
    elif isinstance(block, TimedSpline | PoseSpline):
        # programmed axis speeds bound a timed block as well: full, so that only the machine's limits do; poses too
        speed, acceleration = 100, 100
    else:
        return []
    return [f"$VEL_AXIS[{i}]={speed:d}" for i in range(1, 7)] + [f"$ACC_AXIS[{i}]={acceleration:d}" for i in range(1, 7)]


def _timed(block: TimedSpline | PoseSpline, setup: Setup) -> list[str]:
    if isinstance(block, TimedSpline):
        return time_block("PTP_SPLINE", "SPTP", [axes_text(q) for q in block.q], block.t)
    speed = f"$VEL.CP={fixed(block.bounds.speed, 5)}"
    return [speed, *_bounds(block.bounds), *time_block("SPLINE", "SPL", _poses(block, setup), block.t)]


def _bounds(bounds: PathBounds) -> list[str]:
    """Acceleration along a path, speeds and accelerations of its turns: swivel and rotation alike."""
    turns = (("VEL", bounds.turn_speed), ("ACC", bounds.turn_acceleration))
    found = [f"${word}.ORI{i}={fixed(float(np.degrees(value)), 3)}" for word, value in turns for i in (1, 2)]
    return [f"$ACC.CP={fixed(bounds.acceleration, 3)}", *found]


def _poses(block: PoseSpline | PoseLines, setup: Setup) -> list[str]:
    q = np.radians(np.round(np.degrees(block.q), 5))  # a sign that is not printed decides no bit
    S, T = status_of(q, setup.robot.mdh), turn_of(q)
    return [f"{frame_text(P)[:-1]},S {s},T {t}}}" for P, s, t in zip(block.poses, S, T, strict=True)]


def _lines(block: PoseLines, setup: Setup) -> list[str]:
    """Straight motions with the speed of each before it, which stops no advance."""
    lines = [*_bounds(block.bounds), f"$ADVANCE={ADVANCE}", "$APO.CVEL=100"]
    points, before = _poses(block, setup)[1:], ""
    for k, (point, speed) in enumerate(zip(points, block.speeds, strict=True)):
        if (text := f"$VEL.CP={fixed(float(speed), 5)}") != before:
            lines.append(text)
        before = text
        lines.append(f"LIN {point}" + (" C_VEL" if k < len(points) - 1 else ""))
    return lines


def time_block(block: str, word: str, points: Sequence[str], t: Array) -> list[str]:
    """A `block` with one time block in it: a point `word`, START, then point and PART in turns, END with the sum of the parts."""
    unit = FILE_LIMITS.time_unit
    lines = [block, f"  {word} {points[0]}", "  TIME_BLOCK START"]
    # Times are rounded, not steps, so that the parts add up to the end in the printed decimals.
    ticks = np.rint((np.asarray(t) - t[0]) / unit).astype(int)
    for point, part in zip(points[1:], np.diff(ticks), strict=True):
        lines += [f"  {word} {point}", f"  TIME_BLOCK PART={fixed(part * unit, 5)}"]
    return [*lines, f"  TIME_BLOCK END={fixed(ticks[-1] * unit, 5)}", "ENDSPLINE"]
