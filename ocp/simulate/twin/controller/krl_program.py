"""A program as a virtual controller holds it: motions and pauses in order, each with its frames, speeds and place in the text."""

from dataclasses import dataclass
from pathlib import Path

from robots.pose import Array


@dataclass(frozen=True)
class Frames:
    """What stands in $TOOL (T_flange_tool), $BASE (T_world_base) and $IPO_MODE (`held`: #TCP, the robot holds the part)."""

    tool: Array
    base: Array
    held: bool = False


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
class Motion:
    """One motion: PTP, LIN, a SPLINE of poses or a TIMED spline of axes through `targets`.

    times (m,) s of the targets of a timed block; speed m/s, acceleration m/s^2 of path motions; axis_speed, axis_acceleration
    (6,) shares of the axes' own; `file`, `line` where it begins.
    """

    kind: str
    targets: tuple[Target, ...]
    frames: Frames
    speed: float
    acceleration: float
    axis_speed: Array
    axis_acceleration: Array
    file: str
    line: int
    times: Array | None = None


@dataclass(frozen=True)
class Pause:
    """The robot stands: `seconds` where they are told (WAIT SEC), None for HALT and WAIT FOR."""

    seconds: float | None
    file: str
    line: int


@dataclass(frozen=True)
class KrlProgram:
    """Motions and pauses in the order in which the controller meets them; `files` that were read."""

    main: Path
    steps: tuple[Motion | Pause, ...]
    files: tuple[str, ...]

    @property
    def motions(self) -> list[Motion]:
        """The motions alone."""
        return [step for step in self.steps if isinstance(step, Motion)]
