"""A plan's numbers arranged for the report: nothing is computed here that the plan does not hold."""

import numpy as np

from ocp.model.cell import Cell
from ocp.plan.motion.motion import PlannedMotion
from ocp.plan.motion.timeline import Timeline
from ocp.plan.report.data import (
    AxisLimits,
    CellAnimation,
    InputFile,
    MotionReport,
    PassReport,
    PlanReport,
    SummaryRow,
    WheelShape,
)
from robots.kinematics import link_frames
from robots.pose import Array
from robots.rigid_body import inverse_dynamics
from trajectories.blade import Blade
from trajectories.removal import removal_of

FRAMES = 500  # of the animation
SAMPLE = 0.02  # s between samples of the drawn motion


def build_report(
    cell: Cell, blade: Blade, motion: PlannedMotion, timeline: Timeline, verdict: str, summary: tuple[SummaryRow, ...],
    inputs: tuple[InputFile, ...], notices: tuple[str, ...], versions: tuple[tuple[str, str], ...],
) -> PlanReport:  # fmt: skip
    """Everything the pages show of a plan that was found safe."""
    robot = cell.robot
    return PlanReport(
        title=f"Grinding plan for {blade.name}",
        verdict=verdict,
        safe=True,
        summary=summary,
        inputs=inputs,
        notices=notices,
        versions=versions,
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
