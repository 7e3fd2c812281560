"""What a grinding program consists of, before it is text: a main program and one sub-program or more per pass."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from robots.errors import BadInput
from robots.pose import Array
from robots.robot import Robot
from trajectories.program.execution import UNBOUNDED, PathBounds

LEVEL = float(np.cos(np.radians(1.0)))  # a foundation is level to a fraction of a degree, and no controller is told of that
KINDS = ("axis", "cartesian", "lin")  # timed axis splines, splines of poses, straight motions between poses


@dataclass(frozen=True)
class FileLimits:
    """What the files of a language hold and how finely they are printed.

    Most points of a file and of one block (a margin below it); the controller's interpolation cycle s, below which points
    say nothing; the last printed digit of a time, s, and the decimals of an angle in degrees; of poses the decimals of a length
    in millimetres, and the largest bounds that a path may be given.
    """

    file_points: int
    block_points: int
    cycle: float
    time_unit: float
    angle_decimals: int
    length_decimals: int = 4
    path: PathBounds = UNBOUNDED


@dataclass(frozen=True)
class Comment:
    """A line for the reader of the program."""

    text: str


@dataclass(frozen=True)
class PointMotion:
    """A move to full axes q (6,) rad, not timed, at a part of the axis speeds and accelerations in percent."""

    q: Array
    speed_percent: int = 10
    acceleration_percent: int = 30


@dataclass(frozen=True)
class TimedSpline:
    """A spline through axes q (n, 6) rad, the first where the robot stands, at times t (n,) s from 0."""

    q: Array
    t: Array


@dataclass(frozen=True)
class PoseSpline:
    """A spline through poses P (n, 4, 4) of the base frame in the tool frame (the robot holds the workpiece) at times t (n,) s
    from 0.

    The first pose is where the robot stands; q (n, 6) rad are the axes behind the poses, which tell the arm's branch; `bounds`
    of the origin of the base frame are above what the times ask for, so that these alone rule.
    """

    poses: Array
    q: Array
    t: Array
    bounds: PathBounds


@dataclass(frozen=True)
class PoseLines:
    """Straight motions from pose to pose, blended into each other except at the last; poses and q as `PoseSpline`.

    `speeds` (n - 1,) m/s of the origin of the base frame on the way to each pose but the first; `bounds` of the rest.
    """

    poses: Array
    q: Array
    speeds: Array
    bounds: PathBounds


@dataclass(frozen=True)
class Wait:
    """The robot stands still: for `seconds`, until an `input` of the controller is on, or with neither until a person starts it
    again."""

    seconds: float | None = None
    input: int | None = None


Block = Comment | Wait | PointMotion | TimedSpline | PoseSpline | PoseLines


@dataclass(frozen=True)
class SubProgram:
    """One pass, or a part of it: name, blocks in order, one line that says what it does."""

    name: str
    blocks: tuple[Block, ...]
    comment: str = ""

    @property
    def points(self) -> int:
        """Number of positions in the text."""
        return sum(points_of(b) for b in self.blocks)


@dataclass(frozen=True)
class Setup:
    """What the controller must know: frames, robot, load, numbers of tool and base, kind of output.

    `T_flange_blade` is the tool frame, `T_base_wheel` the base frame (4, 4); `robot` the nominal arm, whose branch pose
    programs name; `kind` one of KINDS; load: mass kg, centre of mass (3,) m in the flange frame, inertia (3,) kg m^2 about it.
    `base_on_controller`: programs of poses take the base frame that the controller keeps under `base_no`, which may be taught
    again when the wheel wears, instead of one in the text.
    """

    T_flange_blade: Array
    T_base_wheel: Array
    robot: Robot
    tool_no: int = 1
    base_no: int = 1
    kind: str = "axis"
    absolute_accuracy: bool = False
    load_mass: float = 0.0
    load_com: Array = field(default_factory=lambda: np.zeros(3))
    load_inertia: Array = field(default_factory=lambda: np.zeros(3))
    base_on_controller: bool = False


@dataclass(frozen=True)
class Program:
    """Main program `name` that calls `subs` in order, with the comments of its head."""

    name: str
    setup: Setup
    subs: tuple[SubProgram, ...]
    comments: tuple[str, ...] = ()


def points_of(block: Block) -> int:
    """Number of positions a block writes."""
    if isinstance(block, Comment | Wait):
        return 0
    return 1 if isinstance(block, PointMotion) else len(block.q)


def split_blocks(blocks: Sequence[Block], most: int) -> list[list[Block]]:
    """Blocks in groups of at most `most` points, cut between blocks, where the robot stands still.

    Every further group starts with a move to where it stands, so that each file can be started by itself. A cut inside a
    block would stop the wheel on the blade; a block that is too long by itself is refused (BadInput).
    """
    groups: list[list[Block]] = [[]]
    count = 0
    for block in blocks:
        n = points_of(block)
        if n + 1 > most:
            raise BadInput(
                f"a block of the program has {n} points and a file takes {most}: emit fewer points (a larger tolerance or "
                "time step), or time the pass in two"
            )
        if count + n > most:
            last = next(b for b in reversed(groups[-1]) if not isinstance(b, Comment | Wait))
            q = last.q if isinstance(last, PointMotion) else last.q[-1]
            groups.append([PointMotion(q)])
            count = 1
        groups[-1].append(block)
        count += n
    return groups


def is_level(robot: Robot) -> bool:
    """Whether the base stands upright as far as anybody would tell a controller, so that its world may be the robot's base."""
    return bool(-robot.gravity_direction[2] > LEVEL)


def refuse_poses(setup: Setup, where: str = "") -> None:
    """Refuse (BadInput) programs of poses for a controller that corrects poses by itself, and for one whose world is not the
    robot's base. `where` begins the sentence."""
    if setup.kind == "axis":
        return
    if setup.absolute_accuracy:
        raise BadInput(
            f"{where}controller.absolute_accuracy is true and the output is '{setup.kind}': the controller would correct the "
            "poses a second time; choose the axis program, or a controller without absolute accuracy"
        )
    if not is_level(setup.robot) and not setup.base_on_controller:
        raise BadInput(
            f"{where}robot.gravity_direction says that the base is not upright and the output is '{setup.kind}': its base frame "
            "would be read in the controller's world, which is turned against such a base; choose the axis program"
        )
