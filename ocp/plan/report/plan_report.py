"""What a plan's report shows: frozen arrays in SI units. `build_report` arranges what the plan holds, the sections draw it.

Nothing is computed here that the plan does not hold, and nothing is formatted.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ocp.model.cell import Cell
from ocp.plan.motion import PlannedMotion
from ocp.plan.programming import Timeline
from ocp.plan.report.surface import GroundPass
from robots.kinematics import link_frames
from robots.pose import Array
from robots.rigid_body import inverse_dynamics
from trajectories.blade import Blade
from trajectories.removal import removal_of

FRAMES = 500  # of the animation
SAMPLE = 0.02  # s between samples of the drawn motion


@dataclass(frozen=True)
class SummaryRow:
    """One line of the summary table, ready to print: what it is, its value, its unit ("" where it has
    none).
    """

    label: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class InputFile:
    """A file the plan was made from: its part ("blade", "cell", ...), its name and the SHA-256 of its
    bytes.
    """

    role: str
    name: str
    sha256: str


@dataclass(frozen=True)
class PassReport(GroundPass):
    """One planned pass; n waypoints in the blade frame.

    `p`, `n`, `t` (n, 3): contact point m, outward normal, feed direction; `s` (n,) m along the pass.
    `force`, `force_sd` (n,) N: predicted normal force and its standard deviation. `interference` (n,) m.
    `compliance_nn` (n,) m/N: blade along its own normal. `removal` (n,): relative to the intended depth, 1
    = as intended. `limit_ratio` (n,): largest use of any axis limit, 1 = at the limit. `arc` rad, `lateral`
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

    def __post_init__(self) -> None:
        count = len(self.s)
        for name in ("p", "n", "t"):
            _require(f"pass {self.line}: {name}", getattr(self, name), (count, 3))
        _require(f"pass {self.line}: tilt", self.tilt, (count, 2))
        for name in "force force_sd interference compliance_nn removal limit_ratio arc lateral turn feed".split():
            _require(f"pass {self.line}: {name}", getattr(self, name), (count,))


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

    def __post_init__(self) -> None:
        count = len(self.time)
        for name in ("q", "qd", "qdd", "torque"):
            _require(f"motion: {name}", getattr(self, name), (count, 6))
        for name in ("contact", "line", "feed", "force", "force_sd"):
            _require(f"motion: {name}", getattr(self, name), (count,))


@dataclass(frozen=True)
class AxisLimits:
    """What each axis may do, (6,) each: rad, rad/s, rad/s^2, N m at the link side; inf or nan = free."""

    q_min: Array
    q_max: Array
    qd_max: Array
    qdd_max: Array
    torque_max: Array


@dataclass(frozen=True)
class WheelShape:
    """The wheel in the base frame: middle m, unit axis, radius m, width m, unit direction of arc zero."""

    centre: Array
    axis: Array
    radius: float
    width: float
    contact_direction: Array


@dataclass(frozen=True)
class CellAnimation:
    """Where everything stands at k times (at most 600 are worth their bytes).

    `time` (k,) s rising; `T_base_link` (k, 7, 4, 4): base and links 1..6 in their MD-H frames; `T_base_blade`
    (k, 4, 4): the blade as the model believes it really is; `T_flange_blade` (4, 4); `capsules`: (link
    index 0..6, p0 (3,), p1 (3,) m in that link's frame, radius m) as in `Robot.link_shapes`.
    """

    time: Array
    T_base_link: Array
    T_base_blade: Array
    T_flange_blade: Array
    capsules: tuple[tuple[int, Array, Array, float], ...]
    wheel: WheelShape

    def __post_init__(self) -> None:
        count = len(self.time)
        _require("animation: T_base_link", self.T_base_link, (count, 7, 4, 4))
        _require("animation: T_base_blade", self.T_base_blade, (count, 4, 4))
        _require("animation: T_flange_blade", self.T_flange_blade, (4, 4))


@dataclass(frozen=True)
class PlanReport:
    """Everything the report of one plan says.

    `verdict` is one sentence; `safe` says whether the program may be run. `vertices` (nv, 3) m and `faces`
    (nf, 3) are the blade. `target_force` N. `pass_spacing` m between neighbouring passes (0 = take it from
    the passes). Raises ValueError where array shapes do not agree.
    """

    title: str
    verdict: str
    safe: bool
    summary: tuple[SummaryRow, ...]
    inputs: tuple[InputFile, ...]
    notices: tuple[str, ...]
    target_force: float
    vertices: Array
    faces: NDArray[Any]
    passes: tuple[PassReport, ...]
    motion: MotionReport
    limits: AxisLimits
    animation: CellAnimation
    pass_spacing: float = 0.0

    def __post_init__(self) -> None:
        _require("vertices", self.vertices, (len(self.vertices), 3))
        _require("faces", self.faces, (len(self.faces), 3))
        if not self.passes or len(self.motion.time) < 2 or len(self.animation.time) < 2:
            raise ValueError("a report needs at least one pass, two motion samples and two animation frames")

    def contact_spans(self) -> tuple[tuple[int, float, float], ...]:
        """(line, start s, end s) of every stretch of contact."""
        motion = self.motion
        key = np.where(np.asarray(motion.contact, bool), np.asarray(motion.line, int), 0)
        edges = np.flatnonzero(np.diff(key)) + 1
        starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(key)]]) - 1
        time = motion.time
        return tuple((int(key[a]), float(time[a]), float(time[b])) for a, b in zip(starts, ends, strict=True) if key[a])


def _require(name: str, value: NDArray[Any], shape: tuple[int, ...]) -> None:
    if np.shape(value) != shape:
        raise ValueError(f"{name} has shape {np.shape(value)}, expected {shape}")


def build_report(
    cell: Cell,
    blade: Blade,
    motion: PlannedMotion,
    timeline: Timeline,
    verdict: str,
    summary: tuple[SummaryRow, ...],
    inputs: tuple[InputFile, ...],
    notices: tuple[str, ...],
) -> PlanReport:
    """Everything the pages show of a plan that was found safe."""
    robot = cell.robot
    return PlanReport(
        title=f"Grinding plan for {blade.name}",
        verdict=verdict,
        safe=True,
        summary=summary,
        inputs=inputs,
        notices=notices,
        target_force=cell.process.force,
        vertices=blade.vertices,
        faces=blade.faces,
        passes=tuple(_pass(cell, motion, place) for place in range(len(motion.passes))),
        motion=_motion(cell, motion, timeline),
        limits=AxisLimits(robot.q_min, robot.q_max, robot.qd_max, robot.qdd_max, robot.torque_max),
        animation=_animation(cell, motion),
        pass_spacing=cell.process.pass_spacing,
    )


def _pass(cell: Cell, motion: PlannedMotion, place: int) -> PassReport:
    solved, trajectory = motion.passes[place], motion.contact(place).trajectory
    path, seen = solved.problem.path, solved.evaluation
    feed = trajectory.feed(trajectory.times)
    ratio = trajectory.limit_ratio(trajectory.times)
    removal = removal_of(trajectory, solved.solution.force[trajectory.kept], cell.process.force, cell.process.feed)

    def at_waypoints(values: Array) -> Array:
        return np.interp(path.s, trajectory.stations, values)

    return PassReport(
        line=path.line,
        side=path.side,
        p=path.p,
        n=path.n,
        t=path.t,
        s=path.s,
        force=solved.solution.force,
        force_sd=seen.force_sd,
        interference=seen.delta,
        compliance_nn=solved.problem.compliance[:, 0],
        removal=at_waypoints(removal),
        limit_ratio=at_waypoints(ratio),
        arc=seen.arc,
        lateral=seen.lateral,
        turn=seen.turn,
        tilt=np.arctan(seen.tilt),
        feed=at_waypoints(feed),
    )


def _motion(cell: Cell, motion: PlannedMotion, timeline: Timeline) -> MotionReport:
    """The timeline thinned to about one sample every SAMPLE seconds."""
    keep = np.concatenate([[True], np.diff(np.floor(timeline.time / SAMPLE)) > 0])
    keep &= np.concatenate([[True], np.diff(timeline.time) > 1e-9])
    payload = cell.workpiece.payload
    q, qd, qdd = timeline.q[keep], timeline.qd[keep], timeline.qdd[keep]
    return MotionReport(
        time=timeline.time[keep],
        q=q,
        qd=qd,
        qdd=qdd,
        torque=inverse_dynamics(cell.robot, payload.mass, payload.com, q, qd, qdd),
        contact=timeline.contact[keep],
        line=timeline.line[keep],
        feed=np.nan_to_num(timeline.feed[keep]),
        force=timeline.force[keep],
        force_sd=timeline.force_sd[keep],
    )


def _animation(cell: Cell, motion: PlannedMotion) -> CellAnimation:
    time = np.linspace(0.0, motion.duration, FRAMES)
    q = np.empty((FRAMES, 6))
    for segment in motion.segments:
        inside = (time >= segment.start) & (time <= segment.end + 1e-9)
        q[inside] = segment.trajectory.q(time[inside] - segment.start)
    frames = link_frames(cell.robot, q)
    wheel = cell.wheel
    return CellAnimation(
        time=time,
        T_base_link=frames,
        T_base_blade=frames[:, -1] @ cell.workpiece.T_flange_blade,
        T_flange_blade=cell.workpiece.T_flange_blade,
        capsules=cell.robot.link_shapes,
        wheel=WheelShape(wheel.centre, wheel.axis, wheel.radius, wheel.width, wheel.contact_direction),
    )
