"""What a program read from files does: its motions in order, with frames and times."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from robots.pose import Array

MotionKind = Literal["point", "axis spline", "pose spline", "line"]


@dataclass(frozen=True)
class Frames:
    """Tool and base in force: transforms (4, 4) where the text gives them, else None, with their numbers or None.

    `external_tcp`: the robot holds the workpiece, so that poses are those of the base frame seen from the tool frame.
    """

    tool: Array | None = None
    base: Array | None = None
    tool_no: int | None = None
    base_no: int | None = None
    external_tcp: bool = False


@dataclass(frozen=True)
class ProgramSegment:
    """One motion, or one spline block with all its points; SI units.

    `kind`: point (to a posture, untimed), axis spline, pose spline, or line (a straight path to a pose); `word` is what
    the text calls it; `lines` (n,) of the points in `file`; `q` (n, 6) rad or None, `poses` (n, 4, 4) or None (one of the
    two); `times` (n,) s since the block began, or None for motions the text does not time; `speed` along the path m/s or
    None.
    """

    kind: MotionKind
    word: str
    file: str
    lines: Array
    q: Array | None
    poses: Array | None
    times: Array | None
    frames: Frames
    speed: float | None

    def place(self, point: int = 0) -> str:
        """File and line of a point, for messages."""
        return f"{self.file}, line {self.lines[point]}"


@dataclass(frozen=True)
class Execution:
    """What runs when `source` is started: segments in their order, and what was passed over, in sentences.

    `stops`: for every wait of the robot, the index of the segment at whose end it stands (-1: before the first).
    """

    source: Path
    segments: tuple[ProgramSegment, ...]
    stops: tuple[int, ...] = ()
    notices: tuple[str, ...] = ()
