"""Runs KRL statements as a robot would: motions in order, with frames and times (trajectories.program.execution)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robots.errors import BadInput
from robots.pose import Array, transform_from_xyzabc
from trajectories.krl import syntax
from trajectories.krl.reader import read_module
from trajectories.program.execution import Execution, Frames, MotionKind, PathBounds, ProgramSegment

AXES = tuple(f"A{i}" for i in range(1, 7))
POSE = ("X", "Y", "Z", "A", "B", "C")
CONTROLLER = frozenset({"BAS", "IR_STOPM", "USERSPOT", "USER_GRP", "SPOT", "GRIPPER"})  # modules on every controller
KINDS: dict[str, MotionKind] = {
    **dict.fromkeys(("PTP", "SPTP"), "point"),
    **dict.fromkeys(("LIN", "SLIN", "SPL"), "line"),
    "PTP_SPLINE": "axis spline",
    "SPLINE": "pose spline",
}


PATH = ("$VEL.CP", "$ACC.CP", "$VEL.ORI1", "$VEL.ORI2", "$ACC.ORI1", "$ACC.ORI2")  # what bounds a motion along poses
BITS = re.compile(r"'[Bb][01]{1,31}'")
MOST_CALLS = 10_000  # a program of a whole blade calls some hundred


@dataclass(frozen=True)
class KrlSegment(ProgramSegment):
    """A segment with status S and turn T (n,) of its points, -1 where the text gives none."""

    status: Array
    turn: Array


@dataclass(frozen=True)
class KrlExecution(Execution):
    """What a KRL program does."""

    segments: tuple[KrlSegment, ...]


def find_file(folder: Path, name: str, suffix: str) -> Path | None:
    """The file of a program name in a folder, without regard to case; None if there is none."""
    wanted = f"{name}{suffix}".upper()
    return next((p for p in sorted(folder.iterdir()) if p.name.upper() == wanted), None)


def execute(source: Path, strict: bool = True, modules: Mapping[Path, syntax.Module] | None = None) -> KrlExecution:
    """Run the program of `source` (a .src) with the sub-programs of its folder; `modules` of it that are already read.

    Raises BadInput, naming file and line: unreadable text, a program that is not there or calls itself, a position that
    is unknown.
    """
    source = Path(source)
    if not source.is_file():
        raise BadInput(f"{source}: there is no such program; give the path of a .src file")
    runner = _Runner(source.parent, strict, dict(modules or {}))
    runner.run(source, ())
    return KrlExecution(source, tuple(runner.segments), tuple(runner.stops), tuple(runner.notices))


class _Runner:
    """Walks statements; its state (frames, speed, collected segments) lives for one `execute` only."""

    def __init__(self, folder: Path, strict: bool, modules: dict[Path, syntax.Module]) -> None:
        self.folder, self.strict, self.modules = folder, strict, modules
        self.segments: list[KrlSegment] = []
        self.stops: list[int] = []
        self.notices: list[str] = []
        self.calls = 0
        self.frames = Frames()
        self.path: dict[str, float] = {}
        self.stored: dict[str, syntax.Value] = {}

    def run(self, path: Path, callers: tuple[str, ...]) -> None:
        module = self._module(path)
        self.calls += 1
        if self.calls > MOST_CALLS:
            raise BadInput(
                f"{path.name}, line 1: programs call each other more than {MOST_CALLS} times; such a program never ends"
            )
        if module.name.upper() in callers:
            raise BadInput(f"{path.name}, line 1: {module.name} calls itself through {' and '.join(callers)}")
        data = find_file(self.folder, path.stem, ".dat")
        if data is None and self.strict:
            raise BadInput(f"{path.with_suffix('.dat').name}: the file is missing; a program is a pair of .src and .dat")
        names = self._module(data).declared() if data else {}
        block: list[tuple[syntax.MotionStatement, syntax.Number | None]] | None = None
        kind, end = "", None
        for s in module.statements:
            where = f"{path.name}, line {s.line}"
            if isinstance(s, syntax.BlockStart):
                block, kind, end = [], s.kind, None
            elif isinstance(s, syntax.BlockEnd):
                if block:
                    self.segments.append(self._segment(kind, block, end, path.name, names))
                block = None
            elif isinstance(s, syntax.MotionStatement):
                if block is not None:
                    block.append((s, None))
                elif self._known(s, names, where):
                    self.segments.append(self._segment(s.kind, [(s, None)], None, path.name, names))
            elif isinstance(s, syntax.TimeBlock) and block:
                if s.what == "PART":
                    block[-1] = (block[-1][0], s.value)
                elif s.what == "END":
                    end = s.value
            elif isinstance(s, syntax.PauseStatement):
                self.stops.append(len(self.segments) - 1)
            elif isinstance(s, syntax.Assignment):
                self._assign(s.target, s.value, names)
            elif isinstance(s, syntax.Call):
                self._call(s, where, (*callers, module.name.upper()))

    def _module(self, path: Path) -> syntax.Module:
        if path not in self.modules:
            self.modules[path] = read_module(path, self.strict)
        return self.modules[path]

    def _known(self, s: syntax.MotionStatement, names: dict[str, syntax.Declaration], where: str) -> bool:
        if not isinstance(s.target, syntax.Word) or s.target.text in names or s.target.text in self.stored:
            return True
        if s.kind in ("PTP", "SPTP"):
            self.notices.append(f"{where}: the position {s.target.text} is not in the program's files; the move is left out")
            return False
        raise BadInput(f"{where}: the position {s.target.text} is not declared in the program's .dat file")

    def _call(self, s: syntax.Call, where: str, callers: tuple[str, ...]) -> None:
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
        return pose_of(value) if isinstance(value, syntax.Aggregate) else None

    def _assign(self, target: str, value: syntax.Value, names: dict[str, syntax.Declaration]) -> None:
        if target in ("$TOOL", "$BASE"):
            which = target[1:].lower()
            T, number = None, None
            if isinstance(value, syntax.Aggregate):
                T = pose_of(value)
            elif isinstance(value, syntax.Word) and value.text.upper().startswith(f"{target[1:]}_DATA["):
                index = value.text[10:-1]
                number = int(index) if index.isdigit() else None  # a variable: known on the controller alone
                T = None if number is None else self._data(f"{target[1:]}_DATA", number)
            self.frames = replace(self.frames, **{which: T, f"{which}_no": number})  # type: ignore[arg-type]
        elif target == "$IPO_MODE" and isinstance(value, syntax.Word):
            self.frames = replace(self.frames, external_tcp=value.text.upper() == "#TCP")
        elif target in PATH and isinstance(value, syntax.Number):
            self.path[target] = value.value
        elif target == "FDAT_ACT" and isinstance(value, syntax.Word) and value.text.upper() in names:
            self._inline_frames(names[value.text.upper()].value)
        elif target.startswith(("TOOL_DATA[", "BASE_DATA[")) or isinstance(value, syntax.Aggregate):
            self.stored[target] = value

    def _inline_frames(self, value: syntax.Value | None) -> None:
        """Frames of an old inline form: FDAT {TOOL_NO 1,BASE_NO 2,IPO_FRAME #TCP}."""
        if not isinstance(value, syntax.Aggregate):
            return
        tool, base, mode = (value.get(n) for n in ("TOOL_NO", "BASE_NO", "IPO_FRAME"))
        if isinstance(tool, syntax.Number) and isinstance(base, syntax.Number):
            t, b = int(tool.value), int(base.value)
            self.frames = Frames(self._data("TOOL_DATA", t), self._data("BASE_DATA", b), t, b, self.frames.external_tcp)
        if isinstance(mode, syntax.Word):
            self.frames = replace(self.frames, external_tcp=mode.text.upper() == "#TCP")

    def _segment(
        self,
        word: str,
        points: list[tuple[syntax.MotionStatement, syntax.Number | None]],
        end: syntax.Number | None,
        file: str,
        names: dict[str, syntax.Declaration],
    ) -> KrlSegment:
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
        kept = (KINDS[word], word, file, lines, q, poses, times, self.frames, status, turn)
        return KrlSegment(*kept, bounds=self._bounds(), blended=bool(points[-1][0].approximation))

    def _bounds(self) -> PathBounds:
        cp, turns = ([self.path.get(f"${word}.{part}", np.inf) for word in ("VEL", "ACC")] for part in ("CP", "ORI1"))
        other = [self.path.get(f"${word}.ORI2", np.inf) for word in ("VEL", "ACC")]
        return PathBounds(*cp, *(float(np.radians(min(pair))) for pair in zip(turns, other, strict=True)))

    def _position(self, motion: syntax.MotionStatement, names: dict[str, syntax.Declaration], where: str) -> syntax.Aggregate:
        target: syntax.Value | None = motion.target
        if isinstance(target, syntax.Word):
            target = self.stored.get(target.text) or (names[target.text].value if target.text in names else None)
        if not isinstance(target, syntax.Aggregate):
            raise BadInput(f"{where}: the position {getattr(motion.target, 'text', '')} is not declared in the .dat file")
        return target


def axes_of(value: syntax.Aggregate) -> Array | None:
    """Axes (6,) rad of {A1 .., A6 ..}, None if not all six stand there."""
    found = _numbers(value, AXES)
    return None if found is None else np.radians(found)


def pose_of(value: syntax.Aggregate) -> Array | None:
    """Transform (4, 4) of {X .. mm, .., C .. deg}, None if not all six stand there."""
    found = _numbers(value, POSE)
    return None if found is None else transform_from_xyzabc(found[:3] * 1e-3, np.radians(found[3:]))


def _numbers(value: syntax.Aggregate, names: tuple[str, ...]) -> Array | None:
    found = [v.value for v in map(value.get, names) if isinstance(v, syntax.Number)]
    return np.array(found) if len(found) == len(names) else None


def _integer(value: syntax.Value | None) -> int:
    if isinstance(value, syntax.Number):
        return int(value.value)
    if isinstance(value, syntax.Word) and BITS.fullmatch(value.text):
        return int(value.text[2:-1], 2)
    return -1
