"""Runs KRL statements as a robot would: motions in order, with frames and times (trajectories.program.execution)."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
TELLS_FEED = {"#VEL_CP", "#CP_PARAMS"}  # of BAS: the speed of an inline form
CLAUSE_FEED = re.compile(r"(?:\$VEL \. CP = |\$VEL = \{ (?:CP |[^}]* , CP )|SVEL_CP \( )([0-9.]+)", re.IGNORECASE)
CLAUSE_FRAMES = re.compile(r"\bSTOOL2? \( (\w+)", re.IGNORECASE)
OUTER = tuple(f"E{i}" for i in range(1, 7))  # axes besides the robot's
STANDS = 1e-3  # mm or deg, within which these stand
ZERO = syntax.Aggregate(tuple((name, syntax.Number(0.0, "0")) for name in POSE))
CONSTANTS = {"$NULLFRAME": ZERO, "$WORLD": ZERO}
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
        self.computed: dict[str, str] = {}  # positions and frames that only the controller knows: where they were set
        self.outer: tuple[float, ...] | None = None

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
        kind, end, clause = "", None, ""
        for s in module.statements:
            where = f"{path.name}, line {s.line}"
            if isinstance(s, syntax.BlockStart):
                block, kind, end, clause = [], s.kind, None, s.clause
            elif isinstance(s, syntax.BlockEnd):
                if block:
                    with self._alone(clause, names):
                        self.segments.append(self._segment(kind, block, end, path.name, names))
                block = None
            elif isinstance(s, syntax.MotionStatement):
                if block is not None:
                    block.append((s, None))
                    if CLAUSE_FEED.search(s.clause):
                        self.notices.append(f"{where}: the speed of one point of a spline block is passed over")
                elif self._known(s, names, where):
                    with self._alone(s.clause, names):
                        self.segments.append(self._segment(s.kind, [(s, None)], None, path.name, names))
            elif isinstance(s, syntax.TimeBlock) and block:
                if s.what == "PART":
                    block[-1] = (block[-1][0], s.value)
                elif s.what == "END":
                    end = s.value
            elif isinstance(s, syntax.PauseStatement):
                self.stops.append(len(self.segments) - 1)
            elif isinstance(s, syntax.Assignment):
                self._assign(s.target, s.value, names, where)
            elif isinstance(s, syntax.Call):
                self._call(s, where, (*callers, module.name.upper()))

    def _module(self, path: Path) -> syntax.Module:
        if path not in self.modules:
            self.modules[path] = read_module(path, self.strict)
        return self.modules[path]

    def _known(self, s: syntax.MotionStatement, names: dict[str, syntax.Declaration], where: str) -> bool:
        if not isinstance(s.target, syntax.Word):
            return True
        name = s.target.text
        if name not in self.computed and (name in names or name in self.stored):
            return True
        if s.kind in ("PTP", "SPTP"):
            self.notices.append(f"{where}: the position {name} is not in the program's files; the move is left out")
            return False
        self._refuse_computed(name, where)
        raise BadInput(f"{where}: the position {name} is not declared in the program's .dat file")

    def _refuse_computed(self, name: str, where: str) -> None:
        """Raises BadInput: only the controller knows what a position or frame is here."""
        if name in self.computed:
            raise BadInput(
                f"{where}: {name} is computed when the program runs ({self.computed[name]}), so where the path lies is not "
                "known; write its numbers there"
            )

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
        what, number = arguments[0].replace(" ", "").upper(), arguments[-1].replace(" ", "")
        if what == "#INITMOV":
            self.frames = Frames(tool_no=1, base_no=0)
            self.computed = {name: where for name, where in self.computed.items() if name not in ("$TOOL", "$BASE")}
        elif what in ("#TOOL", "#BASE") and number.isdigit():
            self._numbered(f"${what[1:]}", int(number))
        elif what in TELLS_FEED and re.fullmatch(r"\d+\.?\d*|\.\d+", number):
            self.path["$VEL.CP"] = float(number)

    def _numbered(self, target: str, number: int) -> None:
        """Set $TOOL or $BASE to the TOOL_DATA or BASE_DATA of a number."""
        table = f"{target[1:]}_DATA[{number}]"
        value = self.stored.get(table)
        self._set_frame(target, pose_of(value) if isinstance(value, syntax.Aggregate) else None, number)
        if table in self.computed:
            self.computed[target] = self.computed[table]

    def _set_frame(self, target: str, T: Array | None, number: int | None) -> None:
        which = target[1:].lower()
        self.frames = replace(self.frames, **{which: T, f"{which}_no": number})  # type: ignore[arg-type]
        self.computed.pop(target, None)

    def _resolved(self, value: syntax.Value, names: dict[str, syntax.Declaration]) -> syntax.Value:
        """The numbers of a position or frame that a word names, where they are known."""
        if not isinstance(value, syntax.Word) or value.text.upper() in self.computed:
            return value
        name = value.text.upper()
        declared = names[name].value if name in names else None
        found = self.stored.get(name) or declared or CONSTANTS.get(name)
        return found if isinstance(found, syntax.Aggregate) else value

    def _assign(self, target: str, value: syntax.Value, names: dict[str, syntax.Declaration], where: str) -> None:
        known, (whole, _, part) = self._resolved(value, names), target.partition(".")
        if target in ("$TOOL", "$BASE"):
            self._assign_frame(target, value, known, where)
        elif target == "$IPO_MODE" and isinstance(value, syntax.Word):
            self.frames = replace(self.frames, external_tcp=value.text.upper() == "#TCP")
        elif target in PATH and isinstance(value, syntax.Number):
            self.path[target] = value.value
        elif target == "$OV_PRO" and getattr(value, "value", None) != 100:
            self.notices.append(f"{where}: the override is set; feeds are taken as $VEL.CP has them, not slower by it")
        elif target in ("$VEL", "$ACC") and isinstance(value, syntax.Aggregate):
            told = {f"{target}.{name}": number.value for name, number in value.items if isinstance(number, syntax.Number)}
            self.path |= {name: number for name, number in told.items() if name in PATH}
        elif target == "FDAT_ACT" and isinstance(value, syntax.Word) and value.text.upper() in names:
            self._inline_frames(names[value.text.upper()].value)
        elif part:
            self._assign_part(whole, part, value, names, where)
        elif isinstance(known, syntax.Aggregate):
            self.stored[target] = known
            self.computed.pop(target, None)
        elif target.startswith(("TOOL_DATA[", "BASE_DATA[")) or is_place(self._held(target, names)):
            self.computed[target] = where

    def _held(self, name: str, names: dict[str, syntax.Declaration]) -> syntax.Value | None:
        return self.stored.get(name) or (names[name].value if name in names else None)

    def _assign_frame(self, target: str, value: syntax.Value, known: syntax.Value, where: str) -> None:
        text = value.text.upper() if isinstance(value, syntax.Word) else ""
        index = text[10:-1] if text.startswith(f"{target[1:]}_DATA[") else ""
        if index.isdigit():
            self._numbered(target, int(index))
            return
        self._set_frame(target, pose_of(known) if isinstance(known, syntax.Aggregate) else None, None)
        if text in self.computed or text.startswith("EXPRESSION "):  # another variable is one of the controller: as its numbers
            self.computed[target] = self.computed.get(text, where)

    def _assign_part(self, whole: str, part: str, value: syntax.Value, names: dict[str, syntax.Declaration], where: str) -> None:
        """One component of a frame or position: P5.X = 3.0."""
        if whole in ("$TOOL", "$BASE"):
            T = self.frames.tool if whole == "$TOOL" else self.frames.base
            if T is None or part not in POSE[:3] or not isinstance(value, syntax.Number):  # A alone turns otherwise near B 90
                self.computed[whole] = where
                return
            T = T.copy()
            T[POSE.index(part), 3] = 1e-3 * value.value
            self.frames = replace(self.frames, **{whole[1:].lower(): T})  # type: ignore[arg-type]
            return
        held = self._held(whole, names)
        if whole.startswith(("TOOL_DATA[", "BASE_DATA[")) and held is None:
            self.computed[whole] = where
        elif isinstance(held, syntax.Aggregate) and is_place(held):
            if isinstance(value, syntax.Number):
                self.stored[whole] = syntax.Aggregate(tuple((dict(held.items) | {part: value}).items()))
            else:
                self.computed[whole] = where

    def _inline_frames(self, value: syntax.Value | None) -> None:
        """Frames of an old inline form: FDAT {TOOL_NO 1,BASE_NO 2,IPO_FRAME #TCP}."""
        if not isinstance(value, syntax.Aggregate):
            return
        tool, base, mode = (value.get(n) for n in ("TOOL_NO", "BASE_NO", "IPO_FRAME"))
        if isinstance(tool, syntax.Number) and isinstance(base, syntax.Number):
            self._numbered("$TOOL", int(tool.value))
            self._numbered("$BASE", int(base.value))
        if isinstance(mode, syntax.Word):
            self.frames = replace(self.frames, external_tcp=mode.text.upper() == "#TCP")

    @contextmanager
    def _alone(self, clause: str, names: dict[str, syntax.Declaration]) -> Iterator[None]:
        """The feed and frames that a WITH gives to its motion alone."""
        before = self.frames, dict(self.path), dict(self.computed)
        if feed := CLAUSE_FEED.search(clause):
            self.path["$VEL.CP"] = float(feed[1])
        if (form := CLAUSE_FRAMES.search(clause)) and form[1].upper() in names:
            self._inline_frames(names[form[1].upper()].value)
        yield
        self.frames, self.path, self.computed = before

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
        if KINDS[word] != "point":
            for (motion, _), target in zip(points, targets, strict=True):
                self._check_path(target, axial, f"{file}, line {motion.line}")
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

    def _check_path(self, target: syntax.Aggregate, axial: bool, where: str) -> None:
        """Raises BadInput: a point of a path that the text alone does not place on the blade."""
        if not axial:
            self._refuse_computed("$TOOL", where)
            self._refuse_computed("$BASE", where)
        stands = tuple(v.value if isinstance(v := target.get(name), syntax.Number) else 0.0 for name in OUTER)
        first = self.outer = self.outer or stands
        for name, before, now in zip(OUTER, first, stands, strict=True):
            if abs(now - before) > STANDS:
                raise BadInput(
                    f"{where}: the outer axis {name} goes from {before:g} to {now:g} along the path; only paths of a robot that "
                    "moves its own six axes alone can be read"
                )

    def _bounds(self) -> PathBounds:
        cp, turns = ([self.path.get(f"${word}.{part}", np.inf) for word in ("VEL", "ACC")] for part in ("CP", "ORI1"))
        other = [self.path.get(f"${word}.ORI2", np.inf) for word in ("VEL", "ACC")]
        return PathBounds(*cp, *(float(np.radians(min(pair))) for pair in zip(turns, other, strict=True)))

    def _position(self, motion: syntax.MotionStatement, names: dict[str, syntax.Declaration], where: str) -> syntax.Aggregate:
        target: syntax.Value | None = motion.target
        if isinstance(target, syntax.Word):
            self._refuse_computed(target.text, where)
            target = self._held(target.text, names)
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


def is_place(value: syntax.Value | None) -> bool:
    """Whether a value is a position or frame."""
    return isinstance(value, syntax.Aggregate) and (value.get("X") is not None or value.get("A1") is not None)


def _numbers(value: syntax.Aggregate, names: tuple[str, ...]) -> Array | None:
    found = [v.value for v in map(value.get, names) if isinstance(v, syntax.Number)]
    return np.array(found) if len(found) == len(names) else None


def _integer(value: syntax.Value | None) -> int:
    if isinstance(value, syntax.Number):
        return int(value.value)
    if isinstance(value, syntax.Word) and BITS.fullmatch(value.text):
        return int(value.text[2:-1], 2)
    return -1
