"""What a KRL program tells a controller to do, read from the .src and .dat files alone.

Motions and pauses in order, each with its frames, speeds and place in the text.

The virtual controller's own reader: line by line, following calls, keeping frames, speeds and interpolation mode as they are
assigned. It knows what ocp.plan and ocp.poses write and what stands in such programs without moving anything; whatever else
could move the robot, or change how it moves, is refused with file and line, because a guess would be a motion nobody checked.
"""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from robots.bounds import MEGABYTE, read_whole
from robots.errors import BadInput, shown
from robots.pose import Array, transform_from_xyzabc


@dataclass(frozen=True)
class ProgramFrames:
    """What stands in $TOOL (T_flange_tool), $BASE (T_world_base) and $IPO_MODE (`held`: #TCP, the robot holds the part);
    `load`: mass kg, centre m (3,) and inertia kg m^2 (3,) of $LOAD as (7,), None until the program sets it."""

    tool: Array
    base: Array
    held: bool = False
    load: Array | None = None


@dataclass(frozen=True)
class Target:
    """Where a motion goes: axes `q` (6,) rad, or pose (4, 4) with status and turn where they are given; file and line."""

    q: Array | None
    pose: Array | None
    status: int | None
    turn: int | None
    blend: bool
    line: int


@dataclass(frozen=True)
class DrivenMotion:
    """One motion: PTP, LIN, a SPLINE of poses or a TIMED spline of axes through `targets`.

    times (m,) s of the targets of a timed block, a SPLINE or TIMED; path: speed m/s, acceleration m/s^2, and of turns rad/s and
    rad/s^2, which bound a motion along poses; axis_speed, axis_acceleration (6,) shares of the axes' own; `file`, `line` where it
    begins.
    """

    kind: str
    targets: tuple[Target, ...]
    frames: ProgramFrames
    path: tuple[float, float, float, float]
    axis_speed: Array
    axis_acceleration: Array
    file: str
    line: int
    times: Array | None = None

    @property
    def speed(self) -> float:
        """m/s along poses."""
        return self.path[0]


@dataclass(frozen=True)
class ProgramPause:
    """The robot stands: `seconds` where they are told (WAIT SEC), None for HALT and WAIT FOR."""

    seconds: float | None


@dataclass(frozen=True)
class KrlProgram:
    """Motions and pauses in the order in which the controller meets them; `planned`: that it must be as ocp.plan writes
    it, where nothing is left to the controller's goodwill."""

    main: Path
    steps: tuple[DrivenMotion | ProgramPause, ...]
    planned: bool = False

    @property
    def timed(self) -> bool:
        """Whether it is planned, and in time: every motion but the first of a file is a block with its times."""
        return self.planned and any(step.times is not None for step in self.motions)

    @property
    def motions(self) -> list[DrivenMotion]:
        """The motions alone."""
        return [step for step in self.steps if isinstance(step, DrivenMotion)]


AXIS_LETTERS = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE_LETTERS = ("X", "Y", "Z", "A", "B", "C")
_ALLOWED = {*AXIS_LETTERS, *POSE_LETTERS, "S", "T", *(f"E{i}" for i in range(1, 7))}
LARGEST = 1e9  # of mm, deg, s, kg: beyond is a lost decimal point
_NUMBER = re.compile(r"^[-+]?(\d+(\.\d*)?|\.\d+)(E[-+]?\d+)?$")


def krl_number(where: str, text: str) -> float:
    """A number as KRL knows it; `where` names file and line. Raises BadInput."""
    if not _NUMBER.match(text.strip()):
        raise BadInput(f"{where}: '{shown(text.strip())}' is no number; the virtual controller works nothing out")
    if not abs(number := float(text)) <= LARGEST:
        raise BadInput(f"{where}: {shown(text.strip())} is beyond {LARGEST:.0f}; no quantity of a program is that large")
    return number


def aggregate(where: str, text: str) -> dict[str, float]:
    """`{X 1.0,Y 2.0,..}` as numbers by component. Raises BadInput: malformed, a component twice or unknown."""
    inner = re.match(r"^\{\s*(?:[A-Z0-9_]+\s*:)?(.*)\}$", text.strip())
    if not inner or "{" in inner.group(1):
        raise BadInput(f"{where}: '{shown(text, 60)}' is no aggregate like {{X 1.0,Y 2.0}}")
    values: dict[str, float] = {}
    for part in inner.group(1).split(","):
        words = part.split()
        if len(words) != 2 or words[0] not in _ALLOWED or words[0] in values:
            raise BadInput(
                f"{where}: '{shown(part.strip())}' in a position is not understood; each component stands once with a number"
            )
        values[words[0]] = krl_number(where, words[1])
    return values


def frame_of(where: str, text: str) -> Array:
    """T (4, 4) of an aggregate with X, Y, Z in mm and A, B, C in degrees, `R = Rz(A) Ry(B) Rx(C)`. Raises BadInput."""
    values = aggregate(where, text)
    if not set(POSE_LETTERS) <= set(values):
        raise BadInput(f"{where}: the frame is incomplete, X, Y, Z, A, B, C are expected; write all of them")
    xyz, abc = np.array([values[k] for k in "XYZ"]) * 1e-3, np.radians([values[k] for k in "ABC"])
    return transform_from_xyzabc(xyz, abc)


DEEPEST = 10  # calls inside calls; deeper ones are taken for a program that calls itself
MOST_STEPS = 2_000_000  # motions and points of a whole program; a controller's memory holds far fewer
MOST_FILE_BYTES = 5 * MEGABYTE
LONGEST_LINE = 5000  # characters
LONGEST_BLOCK = 3600.0  # s of a timed block, and of a pause
PARTS_MISS = 2e-5  # s that printed parts of a planned block may miss its END by
_NAME = r"[A-Z_$][A-Z0-9_$]*"
_CALL = re.compile(rf"^({_NAME})\s*\(\s*\)$")
_POINT = re.compile(r"^(S?PTP|S?LIN|SPL)\s+(\{.*\}|" + _NAME + r")\s*(C_PTP|C_VEL|C_DIS|C_ORI|C_SPL)?$")
_ASSIGNMENT = re.compile(rf"^({_NAME}(?:\.{_NAME})?)\s*(?:\[\s*(\d{{1,6}})\s*\])?\s*=\s*(.+)$")
_DECLARED = re.compile(rf"^(?:GLOBAL\s+)?(?:DECL\s+)?(?:GLOBAL\s+)?(E6POS|POS|E6AXIS|AXIS|FRAME)\s+({_NAME})\s*=\s*(\{{.*\}})$")
_TIME_BLOCK = re.compile(r"^TIME_BLOCK\s+(START|(?:PART|END)\s*=\s*(\S+))$")
# Lines that neither move the robot nor change how it moves. Of interrupts only the one of the INI fold: any other may call what
# nobody has read.
_IDLE = re.compile(
    r"^(&.*|(GLOBAL\s+)?INTERRUPT\s+DECL\s+3\s+WHEN\s+\$STOPMESS\s*==\s*TRUE\s+DO\s+IR_STOPM\s*\(\s*\)|INTERRUPT\s+ON\s+3|"
    r"EXT(FCT)?\s.*|(DECL\s+)?(INT|REAL|BOOL|CHAR)\s.*|SIGNAL\s.*|\$OUT\s*\[.*)$"
)
_START_UP = re.compile(r"^BAS\s*\(\s*#INITMOV\s*,\s*0\s*\)$")
_LOAD = re.compile(r"^\{\s*M\s+(\S+?)\s*,\s*CM\s*(\{[^{}]*\})\s*,\s*J\s*\{([^{}]*)\}\s*\}$")


# What bounds a motion along poses until a program sets it, m/s, m/s^2, deg/s, deg/s^2: as it usually is (M).
AS_USUAL = {"$VEL.CP": 2.0, "$ACC.CP": 2.0, "$VEL.ORI1": 200.0, "$VEL.ORI2": 200.0, "$ACC.ORI1": 100.0, "$ACC.ORI2": 100.0}


@dataclass
class _Controller:
    """Registers of the controller while it goes through the program."""

    frames: ProgramFrames = field(default_factory=lambda: ProgramFrames(np.eye(4), np.eye(4)))
    tools: dict[int, Array] = field(default_factory=dict)
    bases: dict[int, Array] = field(default_factory=dict)
    named: dict[str, str] = field(default_factory=dict)
    path: dict[str, float] = field(default_factory=lambda: dict(AS_USUAL))
    axis_speed: Array = field(default_factory=lambda: np.ones(6))
    axis_acceleration: Array = field(default_factory=lambda: np.ones(6))
    steps: list[DrivenMotion | ProgramPause] = field(default_factory=list)
    planned: bool = False
    points: int = 0
    calls: int = 0
    untimed: str = ""  # file and line of a PTP that is not the first motion of a file
    same: dict[str, str] = field(default_factory=dict)  # of a planned program: what every file and block sets alike
    apart: bool = True  # whether anything but a path's speed was set since the last motion
    since: set[str] = field(default_factory=set)  # what this file has done: START-UP, frames and load set after it, MOVED


WHOLE = {"$ACT_TOOL": 128, "$ACT_BASE": 128, "$ADVANCE": 5}  # whole numbers, their largest
SHARES = tuple(f"${what}_AXIS[{i}]" for what in ("VEL", "ACC") for i in range(1, 7))
STOP = ("INTERRUPT DECL 3", "INTERRUPT ON 3")
# Before the first motion of every planned file.
SETUP = ("BAS(#INITMOV,0)", *STOP, "$TOOL", "$BASE", "$IPO_MODE", "$LOAD", *SHARES)
MOST_AT_FIRST = 0.3  # of an axis' speed and acceleration, of a motion that may begin anywhere


def read_program(place: Path, planned: bool = False) -> KrlProgram:
    """The program in a folder, or the one whose main .src file is given.

    `planned`: it must be as ocp.plan writes it: files in pairs with CR LF, time blocks with START and parts that sum to END, no
    pauses, a load. Raises BadInput, one sentence with file and line: no program, several main programs, a file that is called but
    absent, a statement that is not understood.
    """
    main = main_program(place, planned)
    files = {p.stem.upper(): p for p in main.parent.iterdir() if p.suffix.lower() == ".src"}
    c = _Controller(planned=planned)
    _run(c, main, files, 0)
    program = KrlProgram(main, tuple(c.steps), planned)
    if program.timed and c.untimed:
        raise BadInput(f"{c.untimed}: this motion leaves the way that is planned in time; write the program anew")
    if not program.motions:
        raise BadInput(f"{main}: moves nothing; give a folder that ocp.plan wrote")
    return program


def main_program(place: Path, planned: bool = False) -> Path:
    """The .src that no other calls. Raises BadInput where there is none or more than one."""
    if place.is_file() and place.suffix.lower() == ".src":
        return place
    if not place.is_dir():
        raise BadInput(f"{place}: is no folder; give the folder that ocp.plan wrote")
    sources = sorted(p for p in place.iterdir() if p.suffix.lower() == ".src")
    if not sources:
        raise BadInput(f"{place}: holds no KRL program (.src); give the folder that ocp.plan wrote")
    called = set()
    for source in sources:
        called |= {found.group(1) for _, text in _statements(source, planned) if (found := _CALL.match(text))}
    mains = [p for p in sources if p.stem.upper() not in called]
    if len(mains) != 1:
        named = ", ".join(p.name for p in mains) or "none"
        raise BadInput(f"{place}: main programs: {named}; give the one .src file to run instead of the folder")
    return mains[0]


def _statements(path: Path, planned: bool) -> list[tuple[int, str]]:
    """Lines with their numbers, upper case, without comments; empty ones left out."""
    data = read_whole(path, MOST_FILE_BYTES, "a readable .src or .dat file")
    lines = data.split(b"\n")
    if planned and lines[-1]:
        raise BadInput(f"{path}, line {len(lines)}: does not end with CR LF; the file is cut off, write the program anew")
    found = []
    for i, raw in enumerate(lines, 1):
        # Only CR LF ends a line: what else some editors and languages take for an end would let a comment execute.
        if planned and i < len(lines) and not raw.endswith(b"\r"):
            raise BadInput(f"{path}, line {i}: ends with LF alone; a controller's file has CR LF, write the program anew")
        body = raw.removesuffix(b"\r")
        odd = next((b for b in body if not (32 <= b < 127 or (b == 9 and not planned))), None)
        if odd is not None:
            raise BadInput(f"{path}, line {i}: byte {odd} is no printable ASCII; a controller would stop there, take it out")
        if len(body) > LONGEST_LINE:
            raise BadInput(f"{path}, line {i}: {len(body)} characters, the limit is {LONGEST_LINE}; give a KRL program")
        if statement := body.decode("ascii").split(";")[0].strip().upper():
            found.append((i, statement))
    return found


def _run(c: _Controller, source: Path, files: dict[str, Path], depth: int) -> None:
    """Go through one file."""
    if depth > DEEPEST:
        raise BadInput(f"{source}: is called from itself; such a program never ends")
    c.calls += 1
    if c.calls > MOST_STEPS:
        raise BadInput(f"{source}: programs call each other more than {MOST_STEPS} times; such a program never ends")
    data = next((d for d in (source.with_suffix(".dat"), source.with_suffix(".DAT")) if d.exists()), None)
    if data is not None:
        _data(c, data)
    elif c.planned:
        raise BadInput(f"{source.with_suffix('.dat')}: the file is missing; a program is a pair of .src and .dat, write it anew")
    statements = _statements(source, c.planned)
    body = [(i, s) for i, s in statements if not s.startswith("&")]
    stem = source.stem.upper()
    if c.planned and not (statements and statements[0][1].startswith("&ACCESS")):
        raise BadInput(f"{source}, line 1: a controller's file begins with &ACCESS; write the program anew")
    scope = "" if c.planned else r"(GLOBAL\s+)?"
    if not body or not re.match(rf"^{scope}DEF\s+{re.escape(stem)}\s*\(\s*\)$", body[0][1]):
        at = body[0][0] if body else 1
        raise BadInput(
            f"{source}, line {at}: does not begin with DEF {stem}( ); the controller takes module and file by one name"
        )
    if body[-1][1] != "END":
        raise BadInput(f"{source}, line {body[-1][0]}: the file ends without END; it was cut off or holds more than one program")
    rest, outer, c.since = iter(body[1:-1]), c.since, set()
    for line, text in rest:
        _refuse_stop(c, f"{source}, line {line}", text)
        if text in ("SPLINE", "PTP_SPLINE"):
            block: list[tuple[int, str]] = []
            for at, inner in rest:
                if inner == "ENDSPLINE":
                    break
                block.append((at, inner))
            else:
                raise BadInput(f"{source}, line {line}: {text} has no ENDSPLINE; the block must end")
            c.steps.append(_block(c, source, line, text, block))
        elif (found := _CALL.match(text)) and found.group(1) in files:
            _run(c, files[found.group(1)], files, depth + 1)
        elif text == "RETURN" and not c.planned:
            break
        else:
            _statement(c, source, line, text)
    _refuse_stop(c, f"{source}, line {body[-1][0]}", "END")
    c.since = outer


def _refuse_stop(c: _Controller, where: str, text: str) -> None:
    """Refuse what a planned motion cannot blend into: only a LIN and the speed of it go on without a stop."""
    last = c.steps[-1] if c.steps else None
    if c.planned and isinstance(last, DrivenMotion) and last.targets[-1].blend and not re.match(r"(LIN\s|\$VEL\.CP\s*=)", text):
        raise BadInput(f"{where}: '{shown(text, 60)}' stands where a motion blends into the next; the robot would stop there")


def _data(c: _Controller, path: Path) -> None:
    """Named positions of a .dat file."""
    statements = _statements(path, c.planned)
    code = [s for s in statements if not s[1].startswith("&")]
    if c.planned and (not code or code[0][1] != f"DEFDAT {path.stem.upper()}" or code[-1][1] != "ENDDAT"):
        at = code[-1][0] if code else 1
        raise BadInput(f"{path}, line {at}: is not DEFDAT {path.stem.upper()} to ENDDAT; the file was cut off or is another's")
    for line, text in statements:
        if found := _DECLARED.match(text):
            c.named[found.group(2)] = found.group(3)
        elif not (_IDLE.match(text) or re.match(r"^(DEFDAT\s.*|ENDDAT|DECL\s.*)$", text)):
            raise BadInput(f"{path}, line {line}: '{shown(text, 60)}' is not understood by the virtual controller; take it out")


def _statement(c: _Controller, source: Path, line: int, text: str) -> None:
    """One line outside spline blocks."""
    where = f"{source}, line {line}"
    if found := _POINT.match(text):
        word = found.group(1)
        if word == "SPL":
            raise BadInput(f"{where}: SPL stands outside a SPLINE block; the controller refuses that")
        target = _target(c, where, line, found.group(2), found.group(3) is not None)
        kind = "PTP" if word in ("PTP", "SPTP") else "LIN"
        if kind == "PTP" and target.blend:
            raise BadInput(f"{where}: a PTP that blends into the next motion is not driven here; let it come to rest")
        last = c.steps[-1] if c.steps else None
        rested = isinstance(last, DrivenMotion) and last.kind == "LIN" and not last.targets[-1].blend
        if c.planned and kind == "LIN" and rested and not c.apart:
            raise BadInput(f"{where}: the LIN before does not blend into this one; the robot would stop on the blade")
        c.steps.append(_motion(c, kind, (target,), source, line))
    elif found := _DECLARED.match(text):
        c.named[found.group(2)] = found.group(3)
    elif text == "HALT" or re.match(r"^WAIT\s", text):
        c.steps.append(_pause(c, where, text))
    elif _START_UP.match(text):
        c.frames, c.since = ProgramFrames(np.eye(4), np.eye(4)), {SETUP[0], *c.since.intersection(STOP)}
    elif c.planned and text.startswith("$OUT"):
        raise BadInput(f"{where}: '{shown(text, 60)}' switches something, which no planned program does; take it out")
    elif _IDLE.match(text):
        c.since |= {word for word in STOP if word in " ".join(text.split())}
    else:
        found = _ASSIGNMENT.match(text)
        if not found or not _assign(c, where, *found.groups()):
            raise BadInput(f"{where}: '{shown(text, 60)}' is not understood by the virtual controller; it might move the robot")


def _pause(c: _Controller, where: str, text: str) -> ProgramPause:
    if c.planned:
        raise BadInput(f"{where}: '{shown(text)}' stops a grinding program; the blade would rest on the wheel, take it out")
    if text == "HALT" or re.match(r"^WAIT\s+FOR\s+\S", text):
        return ProgramPause(None)
    found = re.match(r"^WAIT\s+SEC\s+(\S+)$", text)
    seconds = krl_number(where, found.group(1)) if found else np.nan
    if not 0.0 <= seconds <= LONGEST_BLOCK:
        raise BadInput(f"{where}: '{shown(text)}' is no pause between 0 and {LONGEST_BLOCK:g} s")
    return ProgramPause(seconds)


def _assign(c: _Controller, where: str, name: str, index: str | None, value: str) -> bool:
    """An assignment to what motion depends on; False where the name is none of it."""
    c.since.add(f"{name}[{index}]" if index else name)
    c.apart |= name != "$VEL.CP"
    if c.planned and name in (*SETUP, *WHOLE) and (before := c.same.setdefault(name, value)) != value:
        raise BadInput(
            f"{where}: {name} = {shown(value, 60)} was {shown(before, 60)} before; one blade and one wheel are planned"
        )
    tables = {"TOOL_DATA": c.tools, "BASE_DATA": c.bases}
    if name in tables and index:
        tables[name][int(index)] = frame_of(where, value)
    elif name in ("$TOOL", "$BASE") and not index:
        table, word = (c.tools, "TOOL_DATA") if name == "$TOOL" else (c.bases, "BASE_DATA")
        if found := re.match(rf"^{word}\s*\[\s*(\d{{1,6}})\s*\]$", value):
            if int(found.group(1)) not in table:
                raise BadInput(
                    f"{where}: {shown(value)} is set nowhere in the program; assign the frame so that it can be known here"
                )
            T = table[int(found.group(1))]
        else:
            T = frame_of(where, value)
        c.frames = replace(c.frames, tool=T) if name == "$TOOL" else replace(c.frames, base=T)
    elif name in WHOLE and not index:
        number, most = krl_number(where, value), WHOLE[name]
        if number != int(number) or not 0 <= number <= most or (c.planned and number == 0):
            raise BadInput(f"{where}: {name} = {number:g} is no number from 1 to {most}")
    elif name == "$LOAD" and not index:
        c.frames = replace(c.frames, load=_load(where, value))
    elif name == "$IPO_MODE" and value in ("#TCP", "#BASE"):
        c.frames = replace(c.frames, held=value == "#TCP")
    elif name in AS_USUAL and not index:
        c.path[name] = _positive(where, name, value, 1000.0 if "ORI" in name else 100.0)
    elif name in ("$VEL_AXIS", "$ACC_AXIS") and index and 1 <= int(index) <= 6:
        register = "axis_speed" if name == "$VEL_AXIS" else "axis_acceleration"
        shares = getattr(c, register).copy()  # motions before keep what they had
        shares[int(index) - 1] = _positive(where, name, value, 100.0) / 100.0
        setattr(c, register, shares)
    else:
        # Where blends begin is not modelled; without them nothing else of motion is left.
        return name.startswith("$APO.")
    return True


def _load(where: str, text: str) -> Array:
    """{M kg,CM {X mm ..},J {X kg m^2 ..}} as (7,): kg, m, kg m^2."""
    found = _LOAD.match(text)
    if not found:
        raise BadInput(f"{where}: '{shown(text, 60)}' is no load like {{M 25.0,CM {{X 0.0,..}},J {{X 0.0,Y 0.0,Z 0.0}}}}")
    inertia = [part.split() for part in found.group(3).split(",")]
    if any(len(part) != 2 for part in inertia) or [part[0] for part in inertia] != ["X", "Y", "Z"]:
        raise BadInput(f"{where}: the inertia J of $LOAD is not X, Y, Z with a number each; write all of them")
    load = np.array([krl_number(where, found.group(1)), *frame_of(where, found.group(2))[:3, 3]])
    moments = np.array([krl_number(where, part[1]) for part in inertia])
    if load[0] < 0 or (moments < 0).any():
        raise BadInput(f"{where}: $LOAD has a negative mass or inertia; give what hangs on the flange")
    return np.concatenate([load, moments])


def _positive(where: str, name: str, value: str, most: float = LONGEST_BLOCK) -> float:
    size = krl_number(where, value)
    if not 0 < size <= most:
        raise BadInput(f"{where}: {name} = {size:g} must be above 0 and at most {most:g}")
    return size


def _target(c: _Controller, where: str, line: int, text: str, blend: bool) -> Target:
    if not text.startswith("{"):
        if text not in c.named:
            raise BadInput(f"{where}: position {shown(text)} is declared nowhere with values; write them out")
        text = c.named[text]
    values = aggregate(where, text)
    if c.planned and "A1" in values and len(values) > len(AXIS_LETTERS):
        odd = next(letter for letter in values if letter not in AXIS_LETTERS)
        raise BadInput(f"{where}: {odd} does not belong to six axes; none is planned, and none is driven here")
    if set(AXIS_LETTERS) <= set(values):
        return Target(np.radians([values[a] for a in AXIS_LETTERS]), None, None, None, blend, line)
    if set(POSE_LETTERS) <= set(values):
        given = [int(values[k]) if k in values else None for k in ("S", "T")]
        return Target(None, frame_of(where, text), given[0], given[1], blend, line)
    raise BadInput(f"{where}: the position is incomplete, A1 to A6 or X, Y, Z, A, B, C are expected; write all of them")


def _motion(
    c: _Controller, kind: str, targets: tuple[Target, ...], source: Path, line: int, times: Array | None = None
) -> DrivenMotion:
    c.points += len(targets)
    if c.points > MOST_STEPS:
        raise BadInput(f"{source}, line {line}: the program holds more than {MOST_STEPS} points; no controller takes that many")
    missing = [name for name in SETUP if name not in c.since]
    if c.planned and missing:
        raise BadInput(f"{source}, line {line}: the robot moves before {missing[0]} stands; write the program anew")
    if c.planned and "MOVED" not in c.since and (kind != "PTP" or targets[0].q is None):
        raise BadInput(f"{source}, line {line}: the first motion of a file must be a PTP to full axes, it may be selected alone")
    if c.planned and "MOVED" not in c.since and max(c.axis_speed.max(), c.axis_acceleration.max()) > MOST_AT_FIRST:
        raise BadInput(
            f"{source}, line {line}: the first motion may begin anywhere and is faster than {MOST_AT_FIRST:.0%}; slow it"
        )
    unset = [name for name in AS_USUAL if name not in c.since]
    if c.planned and kind in ("LIN", "SPLINE") and unset:
        raise BadInput(f"{source}, line {line}: {unset[0]} is not set before this motion; what ran before would bound it")
    if c.planned and times is not None and min(c.axis_speed.min(), c.axis_acceleration.min()) < 1.0:
        raise BadInput(f"{source}, line {line}: $VEL_AXIS or $ACC_AXIS below 100 bounds this timed block; write the program anew")
    if kind in ("PTP", "LIN") and "MOVED" in c.since:
        c.untimed = c.untimed or f"{source}, line {line}"
    c.since.add("MOVED")
    c.apart = False
    turn, spin = (float(np.radians(min(c.path[f"${word}.ORI{i}"] for i in (1, 2)))) for word in ("VEL", "ACC"))
    path = (c.path["$VEL.CP"], c.path["$ACC.CP"], turn, spin)
    return DrivenMotion(kind, targets, c.frames, path, c.axis_speed, c.axis_acceleration, source.name, line, times)


def _spline(c: _Controller, source: Path, line: int, block: list[tuple[int, str]]) -> DrivenMotion:
    """SPLINE .. ENDSPLINE of poses."""
    targets = []
    for at, text in block:
        found = _POINT.match(text)
        if not found or found.group(1) not in ("SPL", "SLIN"):
            raise BadInput(
                f"{source}, line {at}: '{shown(text, 60)}' does not belong into a SPLINE block; only SPL with poses do"
            )
        target = _target(c, f"{source}, line {at}", at, found.group(2), False)
        if target.pose is None:
            raise BadInput(f"{source}, line {at}: SPL with axes; a SPLINE block goes through poses")
        targets.append(target)
    if not targets:
        raise BadInput(f"{source}, line {line}: the SPLINE block holds no point")
    return _motion(c, "SPLINE", tuple(targets), source, line)


def _block(c: _Controller, source: Path, line: int, kind: str, block: list[tuple[int, str]]) -> DrivenMotion:
    """A spline block: PTP_SPLINE of axes inside one time block, SPLINE of poses with one or, where it is not planned, without."""
    if kind == "SPLINE" and not c.planned and not any(text.startswith("TIME_BLOCK") for _, text in block):
        return _spline(c, source, line, block)
    targets, times = _timed(c, source, line, kind, block)
    axes = kind == "PTP_SPLINE"
    if any((target.q is None) == axes for target in targets):
        raise BadInput(f"{source}, line {line}: {kind} goes through {'axes' if axes else 'poses'} alone; this one does not")
    return _motion(c, "TIMED" if axes else kind, targets, source, line, times)


def _timed(c: _Controller, source: Path, line: int, kind: str, block: list[tuple[int, str]]) -> tuple[tuple[Target, ...], Array]:
    """Targets and times of what stands between PTP_SPLINE or SPLINE and ENDSPLINE; PARTs are proportions of END."""
    word = "SPTP" if kind == "PTP_SPLINE" else "SPL"
    targets: list[Target] = []
    parts: list[float] = []
    end: float | None = None
    started = False
    for at, text in block:
        where = f"{source}, line {at}"
        point, timing = _POINT.match(text), _TIME_BLOCK.match(text)
        ready = started or not (c.planned and targets)
        exact = point and not (c.planned and point.group(3))
        if point and exact and point.group(1) == word and ready and end is None and len(parts) == max(0, len(targets) - 1):
            targets.append(_target(c, where, at, point.group(2), False))
        elif timing and timing.group(1) == "START" and len(targets) == 1 and not (parts or started):
            started = True
        elif timing and timing.group(1).startswith("PART") and len(targets) == len(parts) + 2:
            parts.append(_positive(where, "PART", timing.group(2)))
        elif timing and timing.group(1).startswith("END") and len(parts) == len(targets) - 1 and parts:
            end = _positive(where, "END", timing.group(2))
            if c.planned and abs(end - sum(parts)) > PARTS_MISS:
                raise BadInput(f"{where}: END is {end:.5f} s and the parts sum to {sum(parts):.5f} s; write the program anew")
        else:
            raise BadInput(
                f"{where}: '{shown(text)}' is not understood here; a timed block is {word}, START, {word} and PART by turns, END"
            )
    if end is None:
        raise BadInput(f"{source}, line {line}: the {kind} has no complete TIME_BLOCK; only timed blocks can be driven here")
    return tuple(targets), np.concatenate([[0.0], np.cumsum(parts)]) * (end / sum(parts))
