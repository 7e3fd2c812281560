"""What a grinding program consists of, before it is text: a main program and one sub-program or more per pass."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from robots.errors import BadInput
from robots.pose import Array
from trajectories.krl.names import is_legal
from trajectories.krl.status_turn import ArmLengths

MOST_POINTS = 2000  # points of a sub-program, KRL.md
KINDS = ("axis", "cartesian", "lin")


@dataclass(frozen=True)
class Comment:
    """A line for the reader of the program."""

    text: str


@dataclass(frozen=True)
class PointMotion:
    """PTP to full axes q (6,) rad at a part of the axis speeds and accelerations, in percent."""

    q: Array
    speed_percent: int = 10
    acceleration_percent: int = 30


@dataclass(frozen=True)
class TimedSpline:
    """PTP_SPLINE through axes q (n, 6) rad, where the robot stands first, at times t (n,) s from 0."""

    q: Array
    t: Array


@dataclass(frozen=True)
class PoseSpline:
    """SPLINE under #TCP through poses P (n, 4, 4) of $BASE in $TOOL; the first is where the robot stands.

    q (n, 6) rad are the axes behind the poses (for S and T), `feed` m/s is $VEL.CP, `acceleration` m/s^2 $ACC.CP.
    """

    poses: Array
    q: Array
    feed: float
    acceleration: float = 1.0


@dataclass(frozen=True)
class PoseLines:
    """Classic LIN motions, approximated by C_VEL except the last; fields as `PoseSpline`."""

    poses: Array
    q: Array
    feed: float
    acceleration: float = 1.0


@dataclass(frozen=True)
class Stop:
    """The robot stands still, for `seconds` (WAIT SEC), until an `input` is on (WAIT FOR $IN), or with neither until a person
    starts it again (HALT)."""

    seconds: float | None = None
    input: int | None = None


Block = Comment | Stop | PointMotion | TimedSpline | PoseSpline | PoseLines


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
    """What the controller must know: frames, load, numbers of tool and base, kind of output.

    `T_flange_blade` goes into TOOL, `T_base_wheel` into BASE (4, 4); load: mass kg, centre of mass (3,) m in the flange
    frame, inertia (3,) kg m^2 about it. `base_from_data`: poses programs take $BASE from BASE_DATA[base_no], which may
    be taught again when the wheel wears, instead of from the text.
    """

    T_flange_blade: Array
    T_base_wheel: Array
    arm: ArmLengths
    tool_no: int = 1
    base_no: int = 1
    kind: str = "axis"
    absolute_accuracy: bool = False
    load_mass: float = 0.0
    load_com: Array = field(default_factory=lambda: np.zeros(3))
    load_inertia: Array = field(default_factory=lambda: np.zeros(3))
    base_from_data: bool = False


@dataclass(frozen=True)
class Program:
    """Main program `name` that calls `subs` in order, with the comments of its head."""

    name: str
    setup: Setup
    subs: tuple[SubProgram, ...]
    comments: tuple[str, ...] = ()


def points_of(block: Block) -> int:
    """Number of positions a block writes."""
    if isinstance(block, Comment | Stop):
        return 0
    return 1 if isinstance(block, PointMotion) else len(block.q)


def split_blocks(blocks: Sequence[Block], most: int = MOST_POINTS) -> list[list[Block]]:
    """Blocks in groups of at most `most` points, cut between blocks, where the robot stands still.

    Every further group starts with a PTP to where it stands, so that each file can be selected by itself. A cut inside a
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
            last = next(b for b in reversed(groups[-1]) if not isinstance(b, Comment | Stop))
            q = last.q if isinstance(last, PointMotion) else last.q[-1]
            groups.append([PointMotion(q)])
            count = 1
        groups[-1].append(block)
        count += n
    return groups


def validate(program: Program) -> None:
    """Refuse (BadInput) what must not be written: illegal or double names, an unknown kind, double compensation."""
    setup = program.setup
    names = [program.name, *(s.name for s in program.subs)]
    wrong = [n for n in names if not is_legal(n)]
    if wrong:
        raise BadInput(f"'{wrong[0]}' is no program name: letters, digits and _, at most 24 characters, no keyword")
    if len({n.upper() for n in names}) < len(names):
        raise BadInput(f"two programs share a name in {', '.join(names)}; names are compared without case")
    if setup.kind not in KINDS:
        raise BadInput(f"kind '{setup.kind}' is not one of {', '.join(KINDS)}")
    if setup.absolute_accuracy and setup.kind != "axis":
        raise BadInput(
            f"controller.absolute_accuracy is true and the output is '{setup.kind}': the controller would correct the "
            "poses a second time; choose the axis program, or a controller without absolute accuracy"
        )
    for sub in program.subs:
        if sub.points > MOST_POINTS:
            raise BadInput(f"{sub.name} has {sub.points} points and a file takes {MOST_POINTS}; split the pass")
        first = next((b for b in sub.blocks if not isinstance(b, Comment)), None)
        if not isinstance(first, PointMotion):
            raise BadInput(f"{sub.name} must begin with a PTP to full axes")
