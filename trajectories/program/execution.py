"""What a program read from files does: its motions in order, with frames and times."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from robots.pose import Array, invert

MotionKind = Literal["point", "axis spline", "pose spline", "line"]


@dataclass(frozen=True)
class PathBounds:
    """What bounds a motion along a path of poses: speed m/s and acceleration m/s^2 of its origin, turn_speed rad/s and
    turn_acceleration rad/s^2 of its axes; inf where nothing does."""

    speed: float = np.inf
    acceleration: float = np.inf
    turn_speed: float = np.inf
    turn_acceleration: float = np.inf


UNBOUNDED = PathBounds()


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

    def flange(self, poses: Array) -> Array:
        """T_base_flange (n, 4, 4) of programmed poses (n, 4, 4); tool and base must be known."""
        assert self.tool is not None and self.base is not None
        return np.asarray(self.base @ (invert(poses) if self.external_tcp else poses) @ invert(self.tool))


@dataclass(frozen=True)
class ProgramSegment:
    """One motion, or one spline block with all its points; SI units.

    `kind`: point (to a posture, untimed), axis spline, pose spline, or line (a straight path to a pose); `word` is what
    the text calls it; `lines` (n,) of the points in `file`; `q` (n, 6) rad or None, `poses` (n, 4, 4) or None (one of the
    two); `times` (n,) s since the block began, or None for motions the text does not time; `bounds` of a path; `blended`: it
    goes over into the next one without coming to rest.
    """

    kind: MotionKind
    word: str
    file: str
    lines: Array
    q: Array | None
    poses: Array | None
    times: Array | None
    frames: Frames
    bounds: PathBounds = field(default=UNBOUNDED, kw_only=True)
    blended: bool = field(default=False, kw_only=True)

    @property
    def speed(self) -> float | None:
        """Along the path, m/s; None where the text sets none."""
        return self.bounds.speed if np.isfinite(self.bounds.speed) else None

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
