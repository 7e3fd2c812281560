"""What a plan's report shows: frozen arrays in SI units. `build_report` arranges what the plan holds, the sections draw it.

Nothing is computed here that the plan does not hold, and nothing is formatted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ocp.model.cell import Cell, Wheel
from ocp.plan.grades import Grades
from ocp.plan.motion import PlannedMotion
from ocp.plan.passes.stretches import LeftOut
from ocp.plan.planning import Plan
from ocp.plan.programming import Timeline
from ocp.plan.removal.result import Removal
from ocp.shell.cache import sha256
from robots.kinematics import link_frames
from robots.pose import Array
from robots.rigid_body import inverse_dynamics
from robots.robot import Robot

FRAMES = 500  # of the animation
LEFT_OUT_STEP = 1e-3  # m between points of a piece that is left out
SAMPLE = 0.02  # s between samples of the drawn motion


@dataclass(frozen=True)
class GroundPass:
    """Where the blade is ground: points `p` (n, 3) m with outward normals `n` (n, 3), way `s` (n,) m, side of the blade."""

    side: str
    p: Array
    n: Array
    s: Array


@dataclass(frozen=True)
class PassReport(GroundPass):
    """One planned pass; n waypoints in the blade frame.

    `p`, `n`, `t` (n, 3): contact point m, outward normal, feed direction; `s` (n,) m along the pass.
    `force`, `force_sd` (n,) N: predicted normal force and its standard deviation. `interference` (n,) m.
    `compliance_nn` (n,) m/N: blade along its own normal. `removal` (n,): depth of all passes over the wanted
    one. `limit_ratio` (n,): largest use of any axis limit, 1 = at the limit. `arc` rad, `lateral`
    m, `turn` rad, `tilt` (n, 2) rad: where and how the blade touches the wheel. `feed` (n,) m/s. nan = not
    known, drawn as a gap.
    """

    line: int
    t: Array
    force: Array
    force_sd: Array
    interference: Array
    compliance_nn: Array
    removal: Array
    limit_ratio: Array
    arc: Array
    lateral: Array
    turn: Array
    tilt: Array
    feed: Array


@dataclass(frozen=True)
class LeftOutReport(GroundPass):
    """A piece of a line that is not ground, `lost`; its points, none where it was never laid."""

    lost: LeftOut


@dataclass(frozen=True)
class MotionReport:
    """The timed program, air moves included; m samples.

    `time` (m,) s rising; `q`, `qd`, `qdd` (m, 6) rad, rad/s, rad/s^2; `torque` (m, 6) N m at the link side;
    `contact` (m,) bool; `line` (m,) int, 0 between passes; `feed` (m,) m/s; `force`, `force_sd` (m,) N, nan
    in the air.
    """

    time: Array
    q: Array
    qd: Array
    qdd: Array
    torque: Array
    contact: NDArray[Any]
    line: NDArray[Any]
    feed: Array
    force: Array
    force_sd: Array


@dataclass(frozen=True)
class CellAnimation:
    """Where everything stands at k times (at most 600 are worth their bytes).

    `time` (k,) s rising; `T_base_link` (k, 7, 4, 4): base and links 1..6 in their MD-H frames; `T_flange_blade` (4, 4).
    """

    time: Array
    T_base_link: Array
    T_flange_blade: Array


@dataclass(frozen=True)
class PlanReport:
    """Everything the report of one plan says.

    `verdict` is two sentences, `headline` a few words; `safe` says whether the program may be run. `summary`: what it is and its
    value, ready to print; `left_out`: what of the lines is not ground.
    `inputs`: SHA-256 of the files that the plan was made from, by their part ("blade", "cell", ...) and name. `vertices` (nv, 3)
    m and `faces` (nf, 3) are the blade, `robot` and `wheel` what the plan was made for. `target_force` N. `pass_spacing` m
    between neighbouring passes (0 = take it from the passes). `removal`: the map of what is taken off, all passes summed.
    """

    title: str
    verdict: str
    safe: bool
    summary: Sequence[tuple[str, str]]
    inputs: Mapping[str, str]
    notices: tuple[str, ...]
    target_force: float
    vertices: Array
    faces: NDArray[Any]
    passes: tuple[PassReport, ...]
    motion: MotionReport
    animation: CellAnimation
    robot: Robot
    wheel: Wheel
    pass_spacing: float = 0.0
    removal: Removal | None = None
    headline: str = "Safe to use."
    left_out: tuple[LeftOutReport, ...] = ()

    def contact_spans(self) -> tuple[tuple[int, float, float], ...]:
        """(line, start s, end s) of every stretch of contact."""
        motion = self.motion
        key = np.where(np.asarray(motion.contact, bool), np.asarray(motion.line, int), 0)
        edges = np.flatnonzero(np.diff(key)) + 1
        starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(key)]]) - 1
        time = motion.time
        return tuple((int(key[a]), float(time[a]), float(time[b])) for a, b in zip(starts, ends, strict=True) if key[a])


def build_report(plan: Plan, timeline: Timeline, grades: Grades, summary: Sequence[tuple[str, str]]) -> PlanReport:
    """Everything the pages show of a plan that was found safe."""
    cell, motion = plan.cell, plan.motion
    return PlanReport(
        title=f"Grinding plan for {plan.blade.name}",
        verdict=grades.sentences(),
        headline=grades.headline,
        safe=True,
        summary=summary,
        inputs={f"{role}: {path.name}": sha256(path) for role, path in plan.inputs},
        notices=plan.notices,
        target_force=cell.process.force,
        vertices=plan.blade.vertices,
        faces=plan.blade.faces,
        passes=tuple(_pass(plan, place) for place in range(len(motion.passes))),
        motion=_motion(cell, motion, timeline),
        animation=_animation(cell, motion),
        robot=cell.robot,
        wheel=cell.wheel,
        pass_spacing=cell.process.pass_spacing,
        removal=plan.removal,
        left_out=tuple(_left_out(plan, one) for one in plan.left_out),
    )


def _pass(plan: Plan, place: int) -> PassReport:
    whole, trajectory = plan.motion.passes[place], plan.motion.way(place).trajectory
    solved = whole.touching()
    path, seen, way, feed = solved.problem.path, solved.evaluation, solved.problem.way, float(whole.problem.path.feed.mean())
    times = np.interp(way.at * feed, trajectory.stations, trajectory.times)
    return PassReport(
        **{name: getattr(path, name) for name in ("line", "side", "p", "n", "t", "s")},
        **{name: getattr(seen, name) for name in ("force_sd", "arc", "lateral", "turn")},
        force=solved.solution.force,
        interference=seen.delta,
        compliance_nn=solved.problem.compliance[:, 0],
        removal=plan.removal.at(path.p),
        limit_ratio=trajectory.limit_ratio(times),
        tilt=np.arctan(seen.tilt),
        feed=way.speed * trajectory.feed(times) / feed,
    )


def _left_out(plan: Plan, lost: LeftOut) -> LeftOutReport:
    """With points every millimetre along the laid line, and straight on where it was cut back."""
    path = next(one for one in plan.lines if one.line == lost.line)
    s = np.linspace(lost.start, lost.end, max(int(np.ceil(lost.length / LEFT_OUT_STEP)), 1) + 1)
    beyond = s - np.clip(s, path.s[0], path.s[-1])
    p, n, t = (np.column_stack([np.interp(s, path.s, column) for column in getattr(path, name).T]) for name in "pnt")
    return LeftOutReport(path.side, p + beyond[:, None] * t, n, s - s[0], lost)


def _motion(cell: Cell, motion: PlannedMotion, timeline: Timeline) -> MotionReport:
    """The timeline thinned to about one sample every SAMPLE seconds."""
    keep = np.concatenate([[True], np.diff(np.floor(timeline.time / SAMPLE)) > 0])
    keep &= np.concatenate([[True], np.diff(timeline.time) > 1e-9])
    payload = cell.workpiece.payload
    names = ("time", "q", "qd", "qdd", "contact", "line", "feed", "force", "force_sd")
    kept = {name: getattr(timeline, name)[keep] for name in names}
    kept["feed"] = np.nan_to_num(kept["feed"])
    torque = inverse_dynamics(cell.robot, payload.mass, payload.com, kept["q"], kept["qd"], kept["qdd"])
    return MotionReport(torque=torque, **kept)


def _animation(cell: Cell, motion: PlannedMotion) -> CellAnimation:
    time = np.linspace(0.0, motion.duration, FRAMES)
    q = np.empty((FRAMES, 6))
    for segment in motion.segments:
        inside = (time >= segment.start) & (time <= segment.end + 1e-9)
        q[inside] = segment.trajectory.q(time[inside] - segment.start)
    return CellAnimation(time, link_frames(cell.robot, q), cell.workpiece.T_flange_blade)
