"""The refusals before a program leaves the house: everything a controller would reject or run in another way.

First what needs only the files (pairs, names, line ends, characters, the way numbers are printed), then the order of
statements (checks_structure.py), then what the program does, held against the machine.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from robots.errors import BadInput
from robots.pose import Array
from robots.robot import Robot
from trajectories.krl import syntax
from trajectories.krl.checks_structure import FRAMES, check_module, check_pair
from trajectories.krl.interpreter import KrlExecution, KrlSegment, execute
from trajectories.krl.names import LONGEST, is_legal
from trajectories.krl.reader import read_module
from trajectories.krl.status_turn import status_of, turn_of
from trajectories.program.driven import block_axes, path_peaks, programmed_poses

EXPONENT = re.compile(r"(?<![\w.$])\d+\.?\d*[eE][+-]?\d+")
NEGATIVE_ZERO = re.compile(r"-\s*0+(?:\.0*)?(?![\d.])")
BEYOND = 1.02  # share of an axis' speed or acceleration: the curve between printed points is the controller's own
LONG_LINE = 140  # characters, what the controller's editor takes (M)
SAME = np.radians(1e-4)  # rad: two printed postures closer than this are one
SAME_POSED = np.radians(1e-3)  # rad: the same where one of them comes from a printed pose, near a wrist singularity
FINE = 1e-3  # s between the poses at which the bounds of a path are looked at


def check_program(
    source: Path, robot: Robot | None = None, absolute_accuracy: bool = False, pauses: bool = False
) -> KrlExecution:
    """What runs when `source` (the main .src) is started, after every check on all .src and .dat of its folder.

    `robot` brings the checks of axis ranges, status and turn; `absolute_accuracy` refuses poses; `pauses` lets a measuring
    program stand still (HALT, WAIT). Raises BadInput, which names file and line.
    """
    source = Path(source)
    check_files(source.parent)
    modules = {path: read_module(path) for path in program_files_of(source.parent)}
    for module in modules.values():
        check_module(module, pauses)
    stems = {(m.path.stem.upper(), m.path.suffix.lower()): m for m in modules.values()}
    for (stem, suffix), module in stems.items():
        if suffix == ".src":
            check_pair(module, stems[stem, ".dat"])
    execution = execute(source, modules=modules)
    runs = {source.name.upper(), *(segment.file.upper() for segment in execution.segments)}
    _check_one_setup([m for m in modules.values() if m.path.name.upper() in runs])
    _check_segments(execution.segments, robot, absolute_accuracy)
    return execution


def _check_one_setup(modules: list[syntax.Module]) -> None:
    """Tool, base and load are the same wherever they are set: every file and block may be selected alone, one blade is held."""
    first: dict[str, tuple[str, syntax.Value]] = {}
    for module in modules:
        for s in module.statements:
            if isinstance(s, syntax.Assignment) and s.target in (*FRAMES, "$ACT_TOOL", "$ACT_BASE"):
                place, value = first.setdefault(s.target, (f"{module.path.name}, line {s.line}", s.value))
                if s.value != value:
                    raise BadInput(f"{module.path.name}, line {s.line}: {s.target} differs from that of {place}; one is wrong")


def _check_segments(segments: tuple[KrlSegment, ...], robot: Robot | None, absolute_accuracy: bool) -> None:
    if not segments:
        raise BadInput("the program moves nothing; it calls no pass")
    where: Array | None = None
    same = SAME
    for segment in segments:
        if segment.poses is not None:
            _check_poses(segment, robot, absolute_accuracy, where)
        if segment.q is not None and robot is not None:
            _check_range(segment, segment.q, robot, np.arange(len(segment.lines)))
        begin, end = (None, None) if segment.q is None else (segment.q[0], segment.q[-1])
        known = segment.frames.tool is not None and segment.frames.base is not None
        curve: BSpline | None = None
        if segment.times is not None and robot is not None and (segment.q is not None or known):
            curve = block_axes(segment, robot, where)
            begin, end = np.asarray(curve(0.0)), np.asarray(curve(segment.times[-1]))
        if segment.times is not None and begin is not None and where is not None:
            off, most = float(np.abs(begin - where).max()), same if segment.poses is None else SAME_POSED
            if off > most:
                raise BadInput(
                    f"{segment.place()}: the block begins {np.degrees(off):.4f} deg off where the robot stands; that way is not "
                    "timed"
                )
        if curve is not None and robot is not None:
            _check_times(segment, curve, robot)
        where, same = end, SAME if segment.poses is None else SAME_POSED


def _check_poses(segment: KrlSegment, robot: Robot | None, absolute_accuracy: bool, where: Array | None) -> None:
    """Refuse poses that the controller would correct, that are not those of the held blade, of another branch than where the
    robot stands, out of reach or of two branches."""
    if absolute_accuracy:
        raise BadInput(f"{segment.place()}: poses on an absolutely accurate controller compensate twice")
    if not segment.frames.external_tcp:
        raise BadInput(f"{segment.place()}: poses need $IPO_MODE=#TCP, the blade is on the robot")
    if robot is not None and where is not None and segment.word == "SPLINE":
        check_status_turn(segment, where[None], robot.mdh)
    if robot is not None:
        _check_reach(segment, robot)
    changes = np.flatnonzero(np.diff(segment.status))
    if len(changes):
        raise BadInput(f"{segment.place(changes[0] + 1)}: S changes inside a block; the branch would jump")


def _check_times(segment: KrlSegment, curve: BSpline, robot: Robot) -> None:
    """Refuse a timed block that asks for more than the axes do, or its own bounds let: the controller would take its own time."""
    assert segment.times is not None
    at = np.linspace(0.0, segment.times[-1], 8 * len(segment.times))
    for order, what, most in ((1, "speed", robot.qd_max), (2, "acceleration", robot.qdd_max)):
        share = np.abs(curve(at, nu=order)) / most
        k, j = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[k, j] > BEYOND:
            i = int(np.searchsorted(segment.times, at[k], side="right")) - 1
            raise BadInput(
                f"{segment.place(i)}: axis {j + 1} needs {100 * share[k, j]:.0f} % of its {what}; the controller would "
                "stretch the time of the block"
            )
    if segment.poses is None:
        return
    _check_range(segment, curve(at), robot, np.searchsorted(segment.times, at, side="right") - 1)
    fine = np.arange(0.0, segment.times[-1], FINE)
    peaks = path_peaks(programmed_poses(segment.frames, robot, curve(fine)), FINE)
    for name, given in vars(segment.bounds).items():
        if (peak := getattr(peaks, name)) > given:
            raise BadInput(
                f"{segment.place()}: the {name.replace('_', ' ')} of the path is up to {peak:.4g} (SI) and is bounded to "
                f"{given:.4g}; the controller would stretch the time of the block"
            )


def _check_reach(segment: KrlSegment, robot: Robot) -> None:
    """Refuse poses farther from the robot than its lengths together."""
    assert segment.poses is not None
    if segment.frames.tool is None or segment.frames.base is None:
        return
    flange = segment.frames.flange(segment.poses)
    far, reach = np.linalg.norm(flange[:, :3, 3], axis=1), float(np.abs(robot.mdh[:, 1:3]).sum())
    if far.max() > reach:
        i = int(np.argmax(far))
        raise BadInput(
            f"{segment.place(i)}: the flange would be {far[i]:.3f} m from the robot's base, which reaches {reach:.3f} m"
        )


def _check_range(segment: KrlSegment, q: Array, robot: Robot, points: NDArray[np.intp]) -> None:
    """Refuse axes q (m, 6) outside their range; `points` (m,): where in the text each stands."""
    outside = np.maximum(q - robot.q_max, robot.q_min - q)
    if outside.max() > 1e-9:
        i, j = np.unravel_index(np.argmax(outside), outside.shape)
        raise BadInput(
            f"{segment.place(points[i])}: axis {j + 1} at {np.degrees(q[i, j]):.3f} deg is outside "
            f"{np.degrees(robot.q_min[j]):.1f}..{np.degrees(robot.q_max[j]):.1f} deg"
        )


def check_status_turn(segment: KrlSegment, q: Array, mdh: Array) -> None:
    """Refuse S or T of the first points of a segment that do not belong to the axes q (m, 6) rad of an arm, m <= n."""
    for name, given, right in (("S", segment.status, status_of(q, mdh)), ("T", segment.turn, turn_of(q))):
        wrong = np.flatnonzero(given[: len(q)] != right)
        if len(wrong):
            i = int(wrong[0])
            raise BadInput(f"{segment.place(i)}: {name} is {given[i]} and the axes there have {right[i]}")


def program_files_of(folder: Path) -> list[Path]:
    """Every .src and .dat of a folder, sorted."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in (".src", ".dat"))


def check_files(folder: Path) -> None:
    """Refuse (BadInput) file names and pairs that a controller does not take, and every fault of the plain text."""
    files = program_files_of(folder)
    seen: dict[str, Path] = {}
    for path in files:
        if not is_legal(path.stem):
            raise BadInput(
                f"{path.name}, line 1: '{path.stem}' is no program name; letters, digits and _, not a digit first, at most "
                f"{LONGEST} characters (it has {len(path.stem)}), no word of the language"
            )
        twin = seen.setdefault(path.name.upper(), path)
        if twin is not path:
            raise BadInput(f"{path.name}, line 1: {twin.name} has the same name on the controller, which ignores case")
    for path in files:
        other = ".DAT" if path.suffix.lower() == ".src" else ".SRC"
        if f"{path.stem}{other}".upper() not in seen:
            raise BadInput(f"{path.stem}{other.lower()}: the file is missing beside {path.name}; a program is a pair")
        check_text(path)


def check_text(path: Path) -> None:
    """Refuse (BadInput, with the line) what is not ASCII with CRLF, or a number in a form the controller misreads."""
    data = path.read_bytes()
    if not data.endswith(b"\r\n"):
        last = len(data.split(b"\n"))
        raise BadInput(f"{path.name}, line {last}: the last line does not end with CR LF; the file is cut off")
    for number, raw in enumerate(data.split(b"\n")[:-1], start=1):
        where = f"{path.name}, line {number}"
        if not raw.endswith(b"\r"):
            raise BadInput(f"{where}: the line ends with LF alone; a controller file ends its lines with CR LF")
        body = raw[:-1]
        if any(b > 126 or b < 32 for b in body):
            raise BadInput(f"{where}: a character outside printable ASCII; write A-Z, digits and signs only")
        text = body.decode("ascii")
        if len(text) > LONG_LINE:
            raise BadInput(f"{where}: {len(text)} characters, and a line takes {LONG_LINE}")
        code = re.sub(r'"[^"]*"', "", text).split(";", 1)[0]
        if code.startswith("&"):
            continue
        if found := EXPONENT.search(code):
            raise BadInput(f"{where}: the number {found.group()} has an exponent; write it with decimals")
        if found := NEGATIVE_ZERO.search(code):
            raise BadInput(f"{where}: {found.group()} is a negative zero; write 0 without a sign")
