"""A second robot language, made up: all that a dialect needs in one file, to show what it costs to add one.

A program is one file of lines `WORD numbers`; angles in deg, times in s, frames as matrices. It writes timed axis programs only.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robots.errors import BadInput
from robots.robot import Robot
from trajectories.program.execution import Execution, Frames, ProgramSegment
from trajectories.program.program import Block, Comment, FileLimits, PointMotion, Program, TimedSpline, Wait

FILE_LIMITS = FileLimits(file_points=100_000, block_points=5000, cycle=0.004, time_unit=1e-6, angle_decimals=7)


@dataclass(frozen=True)
class ToyDialect:
    name: str = "toy"
    title: str = "TOY"
    limits: FileLimits = FILE_LIMITS

    def program_names(
        self, text: str, passes: int, parts: Iterable[int] = (), taken: Iterable[str] = ()
    ) -> tuple[str, list[list[str]]]:
        word = "".join(c for c in text.lower() if c.isalnum()) or "program"
        while f"{word}.toy" in set(taken):
            word += "x"
        return word, [[f"{word}-{i}-{k}" for k in range(n)] for i, n in enumerate(list(parts) or [1] * passes)]

    def write(self, program: Program, folder: Path) -> list[Path]:
        file = folder / f"{program.name}.toy"
        lines = [f"TOOL {_numbers(program.setup.T_flange_blade.ravel())}", f"BASE {_numbers(program.setup.T_base_wheel.ravel())}"]
        for sub in program.subs:
            lines += [line for block in sub.blocks for line in _text(block)]
        file.write_text("\n".join([*lines, "DONE", ""]))
        return [file]

    def read(self, source: Path) -> Execution:
        return _run(source)

    def check(self, source: Path, robot: Robot, absolute_accuracy: bool = False, pauses: bool = False) -> Execution:
        execution = _run(source)
        for segment in execution.segments:
            outside = (segment.q < robot.q_min) | (segment.q > robot.q_max)
            if outside.any():
                raise BadInput(f"{segment.place(int(np.argmax(outside.any(axis=1))))}: an axis is outside its range")
        if execution.stops and not pauses:
            raise BadInput(f"{source.name}: a grinding program may not wait")
        return execution


TOY = ToyDialect()


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{v:.7f}" for v in values)


def _text(block: Block) -> list[str]:
    if isinstance(block, Comment):
        return []
    if isinstance(block, Wait):
        return ["WAIT"]
    if isinstance(block, PointMotion):
        return [f"GOTO {_numbers(np.degrees(block.q))}"]
    if isinstance(block, TimedSpline):
        return ["CURVE", *(f"AT {_numbers([t, *np.degrees(q)])}" for t, q in zip(block.t, block.q, strict=True)), "END"]
    raise BadInput("TOY knows no poses; choose the axis program")


def _run(source: Path) -> Execution:
    """The reader: of the text alone."""
    segments, stops, frames, curve = [], [], {}, None
    rows = [line.split() for line in source.read_text().splitlines()]
    if not rows or rows[-1] != ["DONE"]:
        raise BadInput(f"{source.name}, line {len(rows)}: the file is cut off")
    for number, (word, *texts) in enumerate(rows, 1):
        values = np.array([float(text) for text in texts])
        if word in ("TOOL", "BASE"):
            frames[word.lower()] = values.reshape(4, 4)
        elif word == "WAIT":
            stops.append(len(segments) - 1)
        elif word == "CURVE":
            curve = []
        elif word == "AT":
            curve.append((number, values))
        elif word in ("GOTO", "END"):
            points = curve if word == "END" else [(number, values)]
            lines, table = np.array([n for n, _ in points]), np.array([v for _, v in points])
            timed = word == "END"
            q, t = np.radians(table[:, -6:]), table[:, 0] if timed else None
            kind, name = ("axis spline", "CURVE") if timed else ("point", "GOTO")
            segments.append(ProgramSegment(kind, name, source.name, lines, q, None, t, Frames(**frames, external_tcp=True)))
        elif word != "DONE":
            raise BadInput(f"{source.name}, line {number}: '{word}' is no word of TOY")
    return Execution(source, tuple(segments), tuple(stops))
