"""Lines on the blade that every force world grinds, and the joints that a machine was taught for them.

All worlds of a check share the lines, so that the contact is solved once and kept. The joints of a machine bring its own blade
to its own wheel, as somebody who taught the program on it would have them, to TAUGHT of a millimetre.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.arm.arm import Arm, Moments, moments
from ocp.simulate.twin.controller.nominal import follow, frames, jacobian, pose_error
from ocp.simulate.twin.truth.machine import Truth
from robots.errors import Infeasible
from robots.pose import Array, invert, make_transform
from trajectories.blade import Blade, find_shape, read_blade
from trajectories.passes import BladePath, PassOptions, passes

STEP = 0.5e-3  # m between points of a line
UNIT = 2.4e-3  # m: lines are whole multiples, so that runs of all feeds begin and end at the same places
PLACES = (0.3, 0.65, 1.3)  # of a side's lines: two on the first side, one (less 1) on the other
DEPTH = 5.2e-4  # m of overlap that is taught: about what 20 N take
TAUGHT = 5e-5  # m, one sigma of a line's place as taught
KNOTS = 2.4e-3  # m between the points of a line that are taught
# A posture over the table with the blade hanging down, from which the inverse kinematics begins, deg.
BEGIN = np.radians([0.12, -85.6, 107.8, 179.0, -66.0, 96.2])
LEFT = 1e-6  # m, rad that may be left


@dataclass(frozen=True, eq=False)
class Line:
    """A line on the blade: number, length m, contacts p m, n, t (blade frame) as splines in s."""

    number: int
    length: float
    p: CubicSpline
    n: CubicSpline
    t: CubicSpline

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """p, n, t (k, 3) at s (k,) m, n and t unit and square to each other."""
        n = self.n(s) / np.linalg.norm(self.n(s), axis=1, keepdims=True)
        t = self.t(s) - n * (self.t(s) * n).sum(axis=1, keepdims=True)
        return self.p(s), n, t / np.linalg.norm(t, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Course:
    """Blade and lines of a check."""

    blade: Blade
    lines: tuple[Line, ...]


@cache
def course_of(stl: Path, unit: str, cell_path: Path) -> Course:
    """Lines spread over both sides of a blade. Raises BadInput as the blade's readers, Infeasible: a blade too short."""
    from ocp.model.cell import read_cell

    cell = read_cell(cell_path)
    blade = read_blade(stl, unit)
    piece, wheel = cell.workpiece, cell.wheel
    options = PassOptions(
        clamp_normal=tuple(piece.clamp_normal), clamp_offset=piece.clamp_offset, direction="spanwise", step=STEP,
        wheel_radius=wheel.radius, wheel_width=wheel.width,
    )  # fmt: skip
    laid, _ = passes(blade, find_shape(blade), options)
    sides = [[p for p in laid if p.side == side] for side in dict.fromkeys(p.side for p in laid)]
    chosen = [sides[min(int(place), len(sides) - 1)] for place in PLACES]
    picked = [side[int(place % 1.0 * len(side))] for side, place in zip(chosen, PLACES, strict=True)]
    length = UNIT * np.floor(min(p.s[-1] for p in picked) / UNIT - 1e-9)
    if length < 10 * UNIT:
        raise Infeasible(f"{stl}: its lines are {1e3 * length:.0f} mm long, too short for a force world")
    return Course(blade, tuple(_line(k + 1, p, float(length)) for k, p in enumerate(picked)))


def _line(number: int, path: BladePath, length: float) -> Line:
    return Line(number, length, CubicSpline(path.s, path.p), CubicSpline(path.s, path.n), CubicSpline(path.s, path.t))


def taught(course: Course, cell: Cell, truth: Truth, arm: Arm, rng: np.random.Generator) -> tuple[CubicSpline, ...]:
    """Joints (6,) over s of every line. Raises Infeasible: out of reach."""
    found = []
    for line in course.lines:
        s = np.linspace(0.0, line.length, round(line.length / KNOTS) + 1)
        goal = _goal(cell, truth, line, s, TAUGHT * rng.normal())
        q = _reached(cell, goal, line)
        for _ in range(4):
            error = pose_error(goal, arm.flange(_still(cell, q)))
            q = q + np.linalg.solve(jacobian(cell.robot, frames(cell.robot, q)), error[..., None])[..., 0]
        if np.abs(error).max() > 1e2 * LEFT:
            raise Infeasible(f"line {line.number} of the blade is out of reach of the robot")
        found.append(CubicSpline(s, q))
    return tuple(found)


def _still(cell: Cell, q: Array) -> Moments:
    piece = cell.workpiece.payload
    return moments(q, "" if piece is None else piece.name, cell.tables.reference_temperature_C)


def _reached(cell: Cell, goal: Array, line: Line) -> Array:
    """Joints (k, 6) of the nominal arm along poses; the flange turned about its axis to the side that is ground."""
    robot = cell.robot
    guess = BEGIN.copy()
    first = np.asarray(line.n(0.0))
    guess[5] += np.arctan2(first[0], first[1]) * -robot.sign[5] if first[1] > 0 else -np.pi
    found, left = follow(robot, goal, guess)
    inside = np.all((found > robot.q_min) & (found < robot.q_max))
    if left.max() > LEFT or not inside:
        raise Infeasible(f"line {line.number} of the blade is out of reach of the robot")
    return found


def _goal(cell: Cell, truth: Truth, line: Line, s: Array, off: float) -> Array:
    """Poses (k, 4, 4) of the flange that bring this machine's contacts to its wheel, `off` m too deep, the feed downward."""
    out = -cell.wheel.contact_direction
    axis = Rotation.from_rotvec(truth.wheel_axis_turn).apply(cell.wheel.axis)
    down = np.cross(axis, out)
    p, n, t = line.at(s)
    own = np.stack([n, t, np.cross(n, t)], axis=2)
    wanted = np.stack([out, down, np.cross(out, down)], axis=1)
    R = wanted @ np.swapaxes(own, 1, 2)
    centre = cell.wheel.centre + truth.wheel_shift
    place = centre - (cell.wheel.radius - DEPTH - off) * out
    T = make_transform(R, place - np.einsum("kij,kj->ki", R, p))
    held = cell.workpiece.T_flange_blade
    turn = Rotation.from_rotvec(truth.blade_turn).as_matrix()
    blade = make_transform(turn @ held[:3, :3], held[:3, 3] + truth.blade_shift)
    return np.asarray(T @ invert(blade))
