"""Refusals about the order of statements: declarations, start-up, spline blocks and their time blocks."""

import re
from pathlib import Path

from robots.errors import BadInput
from trajectories.krl import syntax
from trajectories.krl.interpreter import PATH

MOST_POINTS = 2000  # of a file, KRL.md
FRAMES = ("$TOOL", "$BASE", "$IPO_MODE", "$LOAD")
NUMBERS = {"$ACT_TOOL": (1, 128), "$ACT_BASE": (1, 128), "$ADVANCE": (1, 5)}  # whole, least and most
AXIS_SHARES = tuple(f"${k}_AXIS[{i}]" for k in ("VEL", "ACC") for i in range(1, 7))
# What a speed is at most: percent, or m/s, m/s^2, deg/s and deg/s^2 of the machine data (M).
SPEEDS = dict.fromkeys(("$APO.CVEL", *AXIS_SHARES), 100.0) | dict(
    zip(PATH, (3.0, 10.0, 400.0, 400.0, 1000.0, 1000.0), strict=True)
)
ALLOWED = {"PTP_SPLINE": ("SPTP",), "SPLINE": ("SPL",), "": ("PTP", "LIN")}
AXES = frozenset(f"A{i}" for i in range(1, 7))
POSE = frozenset("X Y Z A B C S T".split())
LONGEST_WAIT = 3600.0  # s
MOST_INPUTS = 8192  # of KSS 8
ROUNDING = 1e-5  # s, what the printed parts of a block may miss its end by
STOPS = 2  # declared and switched on
STOP_INTERRUPT = re.compile(r"(GLOBAL)?INTERRUPTDECL3WHEN\$STOPMESS==TRUEDOIR_STOPM\(\)|INTERRUPTON3")
SLOW = 30.0  # percent of an axis' speed and acceleration for the first motion of a file, which may begin anywhere
MOVING = (syntax.MotionStatement, syntax.BlockStart, syntax.Call)
ACTING = (*MOVING, syntax.Assignment, syntax.Interrupt, syntax.PauseStatement)  # declarations come before these

Inside = list[syntax.MotionStatement | syntax.TimeBlock]


def check_module(module: syntax.Module, pauses: bool = False) -> None:
    """Refuse (BadInput, file and line) a .src or .dat that a controller would reject or run in another way.

    `pauses`: HALT and WAIT may stand in it (measuring); a grinding program would stop with its blade on the wheel.
    """
    definition = next(s for s in module.statements if isinstance(s, syntax.Definition))
    if definition.name.upper() != module.path.stem.upper():
        raise _bad(module, definition, f"{definition.kind} {definition.name} stands in a file of another name")
    if (definition.kind == "DEFDAT") != (module.path.suffix.lower() == ".dat"):
        raise _bad(module, definition, f"{definition.kind} does not belong into a {module.path.suffix} file")
    _check_headers(module, definition)
    if definition.kind == "DEFDAT":
        _check_data(module)
    else:
        _check_order(module)
        _check_blocks(module)
        _check_speeds(module, pauses)
        _check_chains(module)
        _check_pauses(module, pauses)


def check_pair(source: syntax.Module, data: syntax.Module) -> None:
    """Refuse a .dat whose DEFDAT has another name than the DEF of its .src."""
    if source.name.upper() != data.name.upper():
        definition = next(s for s in data.statements if isinstance(s, syntax.Definition))
        raise _bad(data, definition, f"DEFDAT {data.name} does not belong to DEF {source.name}")


def _bad(module: syntax.Module, statement: syntax.Statement, message: str) -> BadInput:
    return BadInput(f"{Path(module.path).name}, line {statement.line}: {message}")


def _check_headers(module: syntax.Module, definition: syntax.Definition) -> None:
    headers = [s for s in module.statements if isinstance(s, syntax.Header)]
    if not headers or headers[0].line != 1 or not headers[0].text.upper().startswith("&ACCESS"):
        raise _bad(module, module.statements[0], "the file must begin with &ACCESS RVP")
    for h in headers:
        if h.line > definition.line:
            raise _bad(module, h, f"{h.text[:20]} stands after {definition.kind}; header lines come first")


def _check_data(module: syntax.Module) -> None:
    harmless = (syntax.Header, syntax.Remark, syntax.Definition, syntax.Declaration)
    for s in module.statements[:-1]:
        if not isinstance(s, harmless):
            raise _bad(module, s, "only declarations belong into a .dat file")
    _check_names(module)


def _check_pauses(module: syntax.Module, allowed: bool) -> None:
    for s in module.statements:
        if not isinstance(s, syntax.PauseStatement):
            continue
        if not allowed:
            raise _bad(module, s, "HALT and WAIT may not stand in a grinding program; the blade would rest on the wheel")
        if s.seconds is not None and not 0 < s.seconds.value <= LONGEST_WAIT:
            raise _bad(module, s, f"WAIT SEC {s.seconds.text} must be above 0 and at most {LONGEST_WAIT:g}")
        if s.input is not None and not (s.input.text.isdigit() and 1 <= s.input.value <= MOST_INPUTS):
            raise _bad(module, s, f"$IN[{s.input.text}] does not exist; inputs are 1 to {MOST_INPUTS}")


def _check_names(module: syntax.Module) -> None:
    seen: dict[str, int] = {}
    for s in module.statements:
        if isinstance(s, syntax.Declaration) and s.type != "EXT":
            first = seen.setdefault(s.name.upper(), s.line)
            if first != s.line:
                raise _bad(module, s, f"{s.name} is declared in line {first} already (case does not count)")


def _check_order(module: syntax.Module) -> None:
    """Declarations, then BAS(#INITMOV,0), then frames, then motion."""
    _check_names(module)
    started, ready, stops = False, False, 0
    frames: set[str] = set()
    for s in module.statements:
        if isinstance(s, syntax.Declaration):
            if started:
                raise _bad(module, s, f"{s.name} is declared after the first statement; declarations come first")
            continue
        started |= isinstance(s, ACTING)
        if isinstance(s, syntax.Interrupt) and not STOP_INTERRUPT.fullmatch(s.text.upper().replace(" ", "")):
            raise _bad(module, s, "only the INI fold's interrupt 3 with IR_STOPM may stand here; another may call anything")
        stops += isinstance(s, syntax.Interrupt)
        if isinstance(s, syntax.Other):
            raise _bad(module, s, f"{s.text[:30]} may not be used here")
        if isinstance(s, syntax.Call) and s.name.upper() == "BAS":
            if tuple(a.upper() for a in s.arguments) != ("#INITMOV", "0"):
                raise _bad(module, s, "only BAS (#INITMOV,0 ) may be called")
            if ready:
                raise _bad(module, s, "a second BAS (#INITMOV,0 ) sets frames and speeds back on the way; it stands once a file")
            ready = True
        elif isinstance(s, syntax.Call) and s.arguments:
            raise _bad(module, s, f"{s.name} is called with arguments; passes take none")
        elif isinstance(s, syntax.Assignment):
            _check_assignment(module, s)
            if s.target in FRAMES and not ready:
                raise _bad(module, s, f"{s.target} is set before BAS (#INITMOV,0 ), which would set it back")
            frames.add(s.target)
        elif isinstance(s, MOVING):
            missing = [f for f in FRAMES if f not in frames]
            if not ready or missing or stops != STOPS:
                what = "BAS (#INITMOV,0 )" if not ready else "the INI fold's interrupt" if stops != STOPS else missing[0]
                raise _bad(module, s, f"the robot moves before {what} was set")


def _check_speeds(module: syntax.Module, pauses: bool) -> None:
    """The first motion is slow (of a measuring program as fast as its user asks for), timed blocks are bounded by the machine
    alone and nothing between them goes untimed: what a program leaves open the controller takes from whatever ran before."""
    known: dict[str, float] = {}
    first, timed = True, any(isinstance(s, syntax.BlockStart) for s in module.statements)
    for s in module.statements:
        if isinstance(s, syntax.Assignment) and s.target in (*AXIS_SHARES, *PATH) and isinstance(s.value, syntax.Number):
            known[s.target] = s.value.value
        elif isinstance(s, syntax.MotionStatement | syntax.BlockStart):
            needed = AXIS_SHARES + (PATH if s.kind in ("LIN", "SPLINE") else ())
            missing = [name for name in needed if name not in known]
            if missing:
                raise _bad(module, s, f"the robot moves before {missing[0]} was set; it would keep the speed of what ran before")
            fastest = max(AXIS_SHARES, key=lambda name: known[name])
            if first and not pauses and known[fastest] > SLOW:
                raise _bad(module, s, f"the first motion may begin anywhere, {fastest} = {known[fastest]:g} is above {SLOW:g} %")
            if not first and timed and isinstance(s, syntax.MotionStatement) and s.kind in ("PTP", "LIN"):
                raise _bad(module, s, f"{s.kind} leaves the timed way; only the first motion of a file goes untimed")
            slowest = min(AXIS_SHARES, key=lambda name: known[name])
            if isinstance(s, syntax.BlockStart) and known[slowest] < 100.0:
                raise _bad(module, s, f"{slowest} = {known[slowest]:g} bounds a timed block; 100 % leaves it its times")
            first = False


def _check_chains(module: syntax.Module) -> None:
    """A motion that blends goes over into another straight one, with nothing but its speed between: all else would stop the
    robot there, or lets the advance run out. One that does not blend ends its chain."""
    before: syntax.MotionStatement | None = None
    ended: syntax.MotionStatement | None = None
    for s in module.statements:
        line = s if isinstance(s, syntax.MotionStatement) and s.kind == "LIN" else None
        speed = isinstance(s, syntax.Assignment) and s.target == "$VEL.CP"
        if before and not (line or speed or isinstance(s, syntax.Remark)):
            raise _bad(
                module, s, f"this stands where the LIN of line {before.line} blends into the next; the robot would stop there"
            )
        if line and ended:
            raise _bad(module, s, f"the LIN of line {ended.line} does not blend into this one; the robot would stop on the blade")
        if isinstance(s, syntax.MotionStatement):
            before = line if line and line.approximation else None
            ended = line if line and not line.approximation else None
        elif not (speed or isinstance(s, syntax.Remark)):
            ended = None


def _check_assignment(module: syntax.Module, s: syntax.Assignment) -> None:
    if s.target == "$LOAD":
        _check_load(module, s)
    if s.target == "$IPO_MODE" and getattr(s.value, "text", "").upper() not in ("#TCP", "#BASE"):
        raise _bad(module, s, "$IPO_MODE is #TCP (the robot holds the part) or #BASE")
    if s.target in NUMBERS:
        low, high = NUMBERS[s.target]
        if not isinstance(s.value, syntax.Number) or not s.value.text.isdigit() or not low <= s.value.value <= high:
            raise _bad(module, s, f"{s.target} must be a whole number from {low} to {high}")
    if s.target in FRAMES or s.target in NUMBERS:
        return
    if s.target not in SPEEDS:
        raise _bad(module, s, f"{s.target} may not be assigned by a grinding program")
    value = s.value.value if isinstance(s.value, syntax.Number) else -1.0
    top = SPEEDS[s.target]
    if not 0 < value <= top:
        raise _bad(module, s, f"{s.target} must be a number above 0 and at most {top:g}")


def _check_load(module: syntax.Module, s: syntax.Assignment) -> None:
    try:
        load = load_of(s.value)
    except KeyError:
        raise _bad(module, s, "$LOAD must be {M .., CM {X ..,Y ..,Z ..,A ..,B ..,C ..},J {X ..,Y ..,Z ..}} in numbers") from None
    if load[0] < 0 or min(load[4:]) < 0:
        raise _bad(module, s, "$LOAD has a negative mass or inertia")


def load_of(value: syntax.Value) -> tuple[float, ...]:
    """Mass kg, centre of mass mm (3), inertia kg m^2 (3) of $LOAD. Raises KeyError where one is missing or no number."""
    whole = _components(value)
    centre, inertia = _components(whole["CM"]), _components(whole["J"])
    numbers = [whole["M"], *(centre[c] for c in "XYZ"), *(inertia[c] for c in "XYZ")]
    if not all(isinstance(n, syntax.Number) for n in numbers):
        raise KeyError("a component is no number")
    return tuple(n.value for n in numbers if isinstance(n, syntax.Number))


def _components(value: syntax.Value) -> dict[str, syntax.Value]:
    return dict(value.items) if isinstance(value, syntax.Aggregate) else {}


def _check_blocks(module: syntax.Module) -> None:
    block: syntax.BlockStart | None = None
    points, first = 0, True
    inside: Inside = []
    for s in module.statements:
        if isinstance(s, syntax.BlockStart):
            if block:
                raise _bad(module, s, f"{s.kind} inside the block of line {block.line}; is ENDSPLINE missing?")
            block, inside = s, []
        elif isinstance(s, syntax.BlockEnd):
            if not block:
                raise _bad(module, s, "ENDSPLINE without a block")
            _check_times(module, block, inside, s)
            block = None
        elif isinstance(s, syntax.MotionStatement):
            points += 1
            _check_motion(module, s, block, first)
            first = False
            inside.append(s)
        elif isinstance(s, syntax.TimeBlock):
            if not block:
                raise _bad(module, s, "TIME_BLOCK outside a spline block")
            inside.append(s)
        elif block and not isinstance(s, syntax.Remark):
            raise _bad(module, s, f"inside the {block.kind} of line {block.line} only points, TIME_BLOCK and comments may stand")
        if points > MOST_POINTS:
            raise _bad(module, s, f"more than {MOST_POINTS} points in one file; split the pass")


def _check_motion(module: syntax.Module, s: syntax.MotionStatement, block: syntax.BlockStart | None, first: bool) -> None:
    kind = block.kind if block else ""
    if s.kind not in ALLOWED[kind]:
        place = f"the {kind} of line {block.line}" if block else "the open program"
        raise _bad(module, s, f"{s.kind} may not stand in {place}; expected {' or '.join(ALLOWED[kind])}")
    if not isinstance(s.target, syntax.Aggregate):
        raise _bad(module, s, "the position must stand in the line")
    names = {n for n, _ in s.target.items}
    wanted = AXES if s.kind in ("PTP", "SPTP") else POSE
    if first and (s.kind != "PTP" or names != AXES):
        raise _bad(module, s, "the first motion must be a PTP to all six axes, or the controller does not know its branch")
    if names != wanted:
        odd = sorted(wanted - names) or sorted(names - wanted)
        state = "is missing" if wanted - names else "does not belong there"
        raise _bad(module, s, f"the position is not complete: {odd[0]} {state}")
    if s.kind in ("SPTP", "SPL", "SLIN", "PTP") and s.approximation:
        raise _bad(module, s, f"{s.approximation} does not belong to {s.kind}")
    for name, value in s.target.items:
        if not isinstance(value, syntax.Number):
            raise _bad(module, s, f"{name} must be a number")
        if name in ("S", "T") and not (value.text.isdigit() and value.value <= (7 if name == "S" else 63)):
            raise _bad(module, s, f"{name} {value.text} is no whole number from 0 to {7 if name == 'S' else 63}")


def _check_times(module: syntax.Module, block: syntax.BlockStart, inside: Inside, end: syntax.BlockEnd) -> None:
    """A point, START, then pairs of point and PART, then END whose seconds are the sum of the parts."""
    times = [s for s in inside if isinstance(s, syntax.TimeBlock)]
    if not any(isinstance(s, syntax.MotionStatement) for s in inside):
        raise _bad(module, block, f"{block.kind} has no points")
    if not times:
        raise _bad(module, block, "the block has no TIME_BLOCK; its timing would be the controller's own")
    _check_sequence(module, inside, end)
    parts = [s for s in times if s.what == "PART" and s.value]
    for s in parts:
        if s.value and s.value.value <= 0:
            raise _bad(module, s, f"the time part {s.value.text} must be above 0")
    total, stated = sum(s.value.value for s in parts if s.value), times[-1].value
    if stated is None or abs(total - stated.value) > ROUNDING:
        raise _bad(module, times[-1], f"the parts add up to {total:.5f} s and the end says {stated.text if stated else '?'}")


def _check_sequence(module: syntax.Module, inside: Inside, end: syntax.BlockEnd) -> None:
    after = {"": "POINT", "POINT": "PART", "START": "POINT", "PART": "POINT"}
    before, started = "", False
    for s in inside:
        got = s.what if isinstance(s, syntax.TimeBlock) else "POINT"
        want = after.get(before, "")
        if before == "POINT" and not started:
            want = "START"
        if got == "START" and started:
            raise _bad(module, s, "a second TIME_BLOCK START; one time block a spline block")
        if before == "END":
            raise _bad(module, s, f"{_called(got)} stands after TIME_BLOCK END; the block ends there")
        if got != want and not (got == "END" and before == "PART"):
            raise _bad(module, s, f"expected {_called(want)} and found {_called(got)}")
        before, started = got, started or got == "START"
    if before != "END":
        raise _bad(module, end, "the time block is open: TIME_BLOCK END with its seconds is missing")


def _called(what: str) -> str:
    return "a point" if what == "POINT" else f"TIME_BLOCK {what}"
