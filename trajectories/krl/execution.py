"""What a robot does when a program read from files runs: its motions in order, with frames and times."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robots.errors import BadInput
from robots.pose import Array, transform_from_xyzabc
from trajectories.krl.reader import read_module
from trajectories.krl.syntax import (
    Aggregate,
    Assignment,
    BlockEnd,
    BlockStart,
    Call,
    Declaration,
    Module,
    Motion,
    Number,
    TimeBlock,
    Value,
    Word,
)

AXES = tuple(f"A{i}" for i in range(1, 7))
POSE = ("X", "Y", "Z", "A", "B", "C")
CONTROLLER = frozenset({"BAS", "IR_STOPM", "USERSPOT", "USER_GRP", "SPOT", "GRIPPER"})  # modules on every controller


@dataclass(frozen=True)
class Frames:
    """Tool and base in force: transforms (4, 4) where the text gives them, else None, with their numbers or None."""

    tool: Array | None = None
    base: Array | None = None
    tool_no: int | None = None
    base_no: int | None = None
    ipo_mode: str = "#BASE"


@dataclass(frozen=True)
class Segment:
    """One motion, or one spline block with all its points; SI units.

    `kind` as in the text; `lines` (n,) of the points in `file`; `q` (n, 6) rad or None, `poses` (n, 4, 4) or None (one
    of the two); `status`, `turn` (n,) with -1 where the text gives none; `times` (n,) s since the block began, or None
    for motions the text does not time; `speed` $VEL.CP m/s or None.
    """

    kind: str
    file: str
    lines: Array
    q: Array | None
    poses: Array | None
    status: Array
    turn: Array
    times: Array | None
    frames: Frames
    speed: float | None


@dataclass(frozen=True)
class Execution:
    """Segments in the order in which they run, the modules they came from, and what was passed over, in sentences."""

    segments: tuple[Segment, ...]
    modules: tuple[Module, ...]
    notices: tuple[str, ...]


def find_file(folder: Path, name: str, suffix: str) -> Path | None:
    """The file of a program name in a folder, without regard to case; None if there is none."""
    wanted = f"{name}{suffix}".upper()
    return next((p for p in sorted(folder.iterdir()) if p.name.upper() == wanted), None)


def execute(source: Path, strict: bool = True) -> Execution:
    """Run the program of `source` (a .src) with the sub-programs of its folder.

    Raises BadInput, naming file and line: unreadable text, a program that is not there or calls itself, a position that
    is unknown.
    """
    source = Path(source)
    if not source.is_file():
        raise BadInput(f"{source}: there is no such program; give the path of a .src file")
    runner = _Runner(source.parent, strict)
    runner.run(source, ())
    return Execution(tuple(runner.segments), tuple(runner.modules.values()), tuple(runner.notices))


class _Runner:
    """Walks statements; its state (frames, speed, collected segments) lives for one `execute` only."""

    def __init__(self, folder: Path, strict: bool) -> None:
        self.folder, self.strict = folder, strict
        self.segments: list[Segment] = []
        self.notices: list[str] = []
        self.modules: dict[Path, Module] = {}
        self.frames = Frames()
        self.speed: float | None = None
        self.stored: dict[str, Value] = {}

    def run(self, path: Path, callers: tuple[str, ...]) -> None:
        module = self._module(path)
        if module.name.upper() in callers:
            raise BadInput(f"{path.name}, line 1: {module.name} calls itself through {' and '.join(callers)}")
        data = find_file(self.folder, path.stem, ".dat")
        if data is None and self.strict:
            raise BadInput(f"{path.with_suffix('.dat').name}: the file is missing; a program is a pair of .src and .dat")
        names = self._module(data).declared() if data else {}
        block: list[tuple[Motion, Number | None]] | None = None
        kind, end = "", None
        for s in module.statements:
            where = f"{path.name}, line {s.line}"
            if isinstance(s, BlockStart):
                block, kind, end = [], s.kind, None
            elif isinstance(s, BlockEnd):
                if block:
                    self.segments.append(self._segment(kind, block, end, path.name, names))
                block = None
            elif isinstance(s, Motion):
                if block is not None:
                    block.append((s, None))
                elif self._known(s, names, where):
                    self.segments.append(self._segment(s.kind, [(s, None)], None, path.name, names))
            elif isinstance(s, TimeBlock) and block:
                if s.what == "PART":
                    block[-1] = (block[-1][0], s.value)
                elif s.what == "END":
                    end = s.value
            elif isinstance(s, Assignment):
                self._assign(s.target, s.value, names)
            elif isinstance(s, Call):
                self._call(s, where, (*callers, module.name.upper()))

    def _module(self, path: Path) -> Module:
        if path not in self.modules:
            self.modules[path] = read_module(path, self.strict)
        return self.modules[path]

    def _known(self, s: Motion, names: dict[str, Declaration], where: str) -> bool:
        if not isinstance(s.target, Word) or s.target.text in names or s.target.text in self.stored:
            return True
        if s.kind in ("PTP", "SPTP"):
            self.notices.append(f"{where}: the position {s.target.text} is not in the program's files; the move is left out")
            return False
        raise BadInput(f"{where}: the position {s.target.text} is not declared in the program's .dat file")

    def _call(self, s: Call, where: str, callers: tuple[str, ...]) -> None:
        name = s.name.upper()
        if name == "BAS" and s.arguments:
            self._bas(s.arguments)
        elif name not in CONTROLLER:
            path = find_file(self.folder, s.name, ".src")
            if path is not None:
                self.run(path, callers)
            elif self.strict or name.startswith(callers[0]):
                raise BadInput(f"{where}: the program {s.name} is called and is not in {self.folder}; put it beside the others")
            else:
                self.notices.append(f"{where}: {s.name} is called and is not in {self.folder}; it is passed over")

    def _bas(self, arguments: tuple[str, ...]) -> None:
        what, number = arguments[0].replace(" ", "").upper(), arguments[-1]
        if what == "#INITMOV":
            self.frames = Frames(tool_no=1, base_no=0)
        elif what == "#TOOL" and number.isdigit():
            self.frames = replace(self.frames, tool=self._data("TOOL_DATA", int(number)), tool_no=int(number))
        elif what == "#BASE" and number.isdigit():
            self.frames = replace(self.frames, base=self._data("BASE_DATA", int(number)), base_no=int(number))

    def _data(self, table: str, number: int) -> Array | None:
        value = self.stored.get(f"{table}[{number}]")
        return pose_of(value) if isinstance(value, Aggregate) else None

    def _assign(self, target: str, value: Value, names: dict[str, Declaration]) -> None:
        if target in ("$TOOL", "$BASE"):
            which = target[1:].lower()
            T, number = None, None
            if isinstance(value, Aggregate):
                T = pose_of(value)
            elif isinstance(value, Word) and value.text.upper().startswith(f"{target[1:]}_DATA["):
                number = int(value.text[10:-1])
                T = self._data(f"{target[1:]}_DATA", number)
            self.frames = replace(self.frames, **{which: T, f"{which}_no": number})  # type: ignore[arg-type]
        elif target == "$IPO_MODE" and isinstance(value, Word):
            self.frames = replace(self.frames, ipo_mode=value.text.upper())
        elif target == "$VEL.CP" and isinstance(value, Number):
            self.speed = value.value
        elif target == "FDAT_ACT" and isinstance(value, Word) and value.text.upper() in names:
            self._inline_frames(names[value.text.upper()].value)
        elif target.startswith(("TOOL_DATA[", "BASE_DATA[")) or isinstance(value, Aggregate):
            self.stored[target] = value

    def _inline_frames(self, value: Value | None) -> None:
        """Frames of an old inline form: FDAT {TOOL_NO 1,BASE_NO 2,IPO_FRAME #TCP}."""
        if not isinstance(value, Aggregate):
            return
        tool, base, mode = (value.get(n) for n in ("TOOL_NO", "BASE_NO", "IPO_FRAME"))
        if isinstance(tool, Number) and isinstance(base, Number):
            t, b = int(tool.value), int(base.value)
            self.frames = Frames(self._data("TOOL_DATA", t), self._data("BASE_DATA", b), t, b, self.frames.ipo_mode)
        if isinstance(mode, Word):
            self.frames = replace(self.frames, ipo_mode=mode.text.upper())

    def _segment(
        self,
        kind: str,
        points: list[tuple[Motion, Number | None]],
        end: Number | None,
        file: str,
        names: dict[str, Declaration],
    ) -> Segment:
        targets = [self._position(m, names, f"{file}, line {m.line}") for m, _ in points]
        axial = axes_of(targets[0]) is not None
        values = [axes_of(t) if axial else pose_of(t) for t in targets]
        if any(v is None for v in values):
            line = points[next(i for i, v in enumerate(values) if v is None)][0].line
            wanted = "A1..A6" if axial else "A1..A6 or X, Y, Z, A, B, C"
            raise BadInput(f"{file}, line {line}: the position is not complete; expected {wanted}")
        times = None
        if end is not None:
            parts = np.array([p.value if p else 0.0 for _, p in points])
            times = np.cumsum(parts) * (end.value / parts.sum() if parts.sum() > 0 else 0.0)
        status, turn = (np.array([_integer(t.get(n)) for t in targets]) for n in ("S", "T"))
        lines = np.array([m.line for m, _ in points])
        numbers = np.array([v for v in values if v is not None])
        q, poses = (numbers, None) if axial else (None, numbers)
        return Segment(kind, file, lines, q, poses, status, turn, times, self.frames, self.speed)

    def _position(self, motion: Motion, names: dict[str, Declaration], where: str) -> Aggregate:
        target: Value | None = motion.target
        if isinstance(target, Word):
            target = self.stored.get(target.text) or (names[target.text].value if target.text in names else None)
        if not isinstance(target, Aggregate):
            raise BadInput(f"{where}: the position {getattr(motion.target, 'text', '')} is not declared in the .dat file")
        return target


def axes_of(value: Aggregate) -> Array | None:
    """Axes (6,) rad of {A1 .., A6 ..}, None if not all six stand there."""
    found = [value.get(n) for n in AXES]
    return np.radians([v.value for v in found if isinstance(v, Number)]) if all(isinstance(v, Number) for v in found) else None


def pose_of(value: Aggregate) -> Array | None:
    """Transform (4, 4) of {X .. mm, .., C .. deg}, None if not all six stand there."""
    found = [value.get(n) for n in POSE]
    if not all(isinstance(v, Number) for v in found):
        return None
    numbers = np.array([v.value for v in found if isinstance(v, Number)])
    return transform_from_xyzabc(numbers[:3] * 1e-3, np.radians(numbers[3:]))


def _integer(value: Value | None) -> int:
    if isinstance(value, Number):
        return int(value.value)
    if isinstance(value, Word) and value.text[:2].upper() == "'B":
        return int(value.text[2:-1], 2)
    return -1
