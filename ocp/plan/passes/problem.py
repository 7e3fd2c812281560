"""A pass as the optimiser takes it: nodes with all they know, in the direction of travel."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ocp.effects.engine.symbolic import CONDITIONS
from ocp.model.cell import Cell
from ocp.plan.passes.course import Engagement, PassCourse, air_to_air, lengthened, path_at, steady
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.stage import N_CLEARANCE
from ocp.plan.removal.footprint import LinePatches, line_footprint
from robots.pose import Array
from trajectories.passes import BladePath

WINDOW = 3e-3  # m to either side over which the sign is averaged
STILL = 1e-3  # rad/m; an axis that turns less per metre of the pass keeps the sign it had


@dataclass(frozen=True)
class PassProblem:
    """A pass in its direction of travel with all that its n nodes know.

    path: the line there; compliance (n, 3) m/N of the blade in (n, t, b); indentation_correction (n,) m of the wheel's table;
    clearances (n, N_CLEARANCE, 7): rows a.q >= b; turn_limit rad narrows the cell's turn tolerance where a turned wheel would
    touch the blade elsewhere; approach (n, 6): signs of the axes' motion for effects that depend on them; course: the way over
    the line; where the removal is planned depth (m, m): what r at the m nodes in contact takes off at each of them, and lean
    (n, 2): `ocp.plan.passes.stage.STAGE`.
    """

    path: BladePath
    seed: Seed
    compliance: Array
    indentation_correction: Array
    clearances: Array
    turn_limit: float = np.inf
    approach: Array | None = None
    course: PassCourse | None = None
    depth: Array | None = None
    lean: Array | None = None

    @staticmethod
    def start(path: BladePath, seed: Seed, compliance: Array) -> "PassProblem":
        """Before any correction by direct contact solutions or collision checks."""
        n = len(path.s)
        clearances = np.zeros((n, N_CLEARANCE, 7))
        clearances[..., 6] = -1.0
        return PassProblem(path, seed, compliance, np.zeros(n), clearances, course=steady(path))

    def at_nodes(self, kept: NDArray[Any]) -> "PassProblem":
        """The problem at some of its n nodes alone, a mask (n,) or indices (k,); its removal is not known there."""
        n = len(self.path.s)
        path, course, own = (at_rows(one, kept, n) for one in (self.path, self.way, self))
        return replace(own, path=path, course=course, depth=None)

    @property
    def waypoints(self) -> Array:
        """Columns `ocp.model.force_balance.WAYPOINT`, (n, 16)."""
        p = self.path
        return np.column_stack([p.p, p.n, p.t, p.curvature, self.compliance, self.indentation_correction])

    def conditions(self, cell: Cell) -> Array:
        """Columns `ocp.effects.engine.symbolic.CONDITIONS` of a cell with effects, (n, 24); (n, 0) without.

        The flange holds its stroke and nothing is recorded: recorded speed is zero.
        """
        p, n, c = self.path, len(self.path.s), cell.conditions
        if not cell.effects:
            return np.zeros((n, 0))
        blocks: dict[str, Any] = {"s": p.start + p.s, "feed": p.feed, "line": float(p.line), "travel": float(self.seed.direction)}
        blocks |= {"approach": np.zeros((n, 6)) if self.approach is None else self.approach, "speed": np.zeros((n, 6))}
        blocks |= {name: float(getattr(c, name)) for name in ("ground_before", "time", "clock", "warm", "wheel_warm")}
        blocks |= {"belt": cell.wheel.belt_speed}
        flange = cell.tables.force_flange  # as commanded, as in logs
        blocks |= {"setpoint": cell.process.force if flange is None else flange.setpoint_N}
        return CONDITIONS.stack(n, blocks)

    def named_conditions(self, cell: Cell) -> dict[str, Array]:
        """The columns of `conditions` (n, k) by name; empty for a cell without effects."""
        rows = self.conditions(cell)
        return {name: CONDITIONS.block(rows, name) for name, _ in CONDITIONS.sizes} if rows.size else {}

    @property
    def seconds(self) -> Array:
        """Nominal time between neighbouring nodes, (n-1,) s."""
        return np.diff(self.way.at)

    @property
    def way(self) -> PassCourse:
        """The course over the line: `course`, or the pass alone at its programmed feed."""
        return self.course or steady(self.path)


def at_rows(thing: Any, kept: NDArray[Any], n: int) -> Any:
    """A dataclass whose arrays of n rows, one a node, are cut to those kept; the edges of a way are no nodes."""
    arrays = {f.name: getattr(thing, f.name) for f in fields(thing)}
    cut = {k: v[kept] for k, v in arrays.items() if isinstance(v, np.ndarray) and len(v) == n and k != "edges"}
    return replace(thing, **cut)


def air_to_air_problem(
    line: PassProblem, entry: Engagement, patches: LinePatches, missed: Array, step: float, room: tuple[float, float]
) -> PassProblem:
    """The whole way of a `line` whose nodes are its waypoints, `patches` its footprints and `missed` (k,) m at them, by how much
    farther the wheel is pressed in than its table has it; nodes about `step` m apart in the pass. It begins and ends `room` m
    beyond the line.

    Raises Infeasible where the line is too short.
    """
    path = lengthened(line.path, *room)
    course = air_to_air(path, entry, step / float(path.feed.mean()))
    compliance = CubicSpline(line.path.s, line.compliance)(np.clip(course.s, 0.0, line.path.s[-1]))
    start = PassProblem.start(path_at(path, course.s), line.seed, compliance)
    depth = line_footprint(course.s[course.touching], patches).toarray()
    # Tilted by a, a patch of half-axis b that is pressed in by d at its middle bears a b / d more at one end, less at the other.
    slope = patches.half_axes / patches.indentation[:, None] / 3**0.5
    lean = np.column_stack([np.interp(course.s, patches.at, one) * course.share for one in slope.T])
    correction = np.interp(course.s, patches.at, missed) * np.cbrt(course.share) ** 2  # as the indentation does (Hertz)
    known = {"indentation_correction": correction, "turn_limit": line.turn_limit}
    return replace(start, course=course, depth=depth, lean=lean, **known)


def lead_room(path: BladePath, patches: LinePatches, edge_force: float) -> tuple[float, float]:
    """How far (m) before and behind its ends a line is begun and ended: a patch's half-length, which makes its ends as deep as
    its middle, where the margin has that room, and no nearer to an end of the surface than a patch under `edge_force` N."""
    reach = patches.half_axes[:, 0]
    share = float(np.cbrt(min(edge_force / path.force.mean(), 1.0)))
    ends = ((path.room_before, path.extent[0, 1], reach[0]), (path.room_after, path.extent[-1, 0], reach[-1]))
    before, after = (max(min(half, room, extent - half * share), 0.0) for room, extent, half in ends)
    return before, after


def with_direction(problem: PassProblem, reversed_path: BladePath) -> PassProblem:
    """The same pass run the other way: compliance along t and b change sign with the contact frame."""
    flip = np.array([1.0, -1.0, -1.0])
    return replace(problem, path=reversed_path, compliance=problem.compliance[::-1] * flip, course=steady(reversed_path))


def approach_signs(q: Array, s: Array) -> Array:
    """Averaged signs (n, 6), -1 to 1, of the motion of axes q (n, 6) rad along the arc length s (n,) m."""
    rate = np.diff(q, axis=0) / np.maximum(np.diff(s), 1e-9)[:, None]
    sign = np.where(np.abs(rate) > STILL, np.sign(rate), 0.0)
    for j in range(sign.shape[1]):
        known = np.flatnonzero(sign[:, j])
        if len(known):
            last = np.maximum.accumulate(np.where(sign[:, j] != 0, np.arange(len(sign)), -1))
            sign[:, j] = np.where(last >= 0, sign[np.maximum(last, 0), j], sign[known[0], j])
    # The integral of the sign, straight on beyond both ends.
    far = 2 * WINDOW
    at = np.concatenate([[s[0] - far], s, [s[-1] + far]])
    steps = np.vstack([sign[:1], sign, sign[-1:]]) * np.diff(at)[:, None]
    whole = np.vstack([np.zeros((1, sign.shape[1])), np.cumsum(steps, axis=0)])
    out = np.empty_like(q, dtype=float)
    for j in range(out.shape[1]):
        out[:, j] = (np.interp(s + WINDOW, at, whole[:, j]) - np.interp(s - WINDOW, at, whole[:, j])) / (2 * WINDOW)
    return out
