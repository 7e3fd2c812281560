"""What a force log offers to scans of effects and to the library-free tests: its conditions, in the engine's form."""

import numpy as np

from ocp.calibrate.force.log import Index
from ocp.diagnose.engine.system import Conditions, Wave
from ocp.diagnose.force.fit import ForceFit, Problem
from ocp.effects.effect import Surroundings
from ocp.effects.motor_harmonic import ratios_of
from robots.gravity import weight_torques
from robots.pose import Array

# What columns a need of an effect stands for, where they are not called alike.
NEEDED = {"approach": "q1_deg to q6_deg with time_s", "speed": "q1_deg to q6_deg with time_s"}


def surroundings(problem: Problem) -> Surroundings:
    """For the scans of effects."""
    log, c, cell = problem.log, problem.scene.conditions, problem.scene.cell
    clocked = "clock_s" in c.given
    first, last = _ends(c.run, c.clock)
    breaks = 0.5 * (last[:-1] + first[1:]) if clocked and len(first) > 1 else np.empty(0)
    spans = [np.ptp(c.time[c.run == r]) for r in np.unique(c.run)]
    lengths = [np.ptp(c.s[(c.line == k) & log.contact]) for k in np.unique(c.line[log.contact])]
    steps = np.diff(log.time)[np.diff(log.run) == 0]
    names = tuple(cell.tables.payloads)
    own = cell.tables.workpiece.payload if cell.tables.workpiece is not None else None
    return Surroundings(
        gear_ratio=cell.robot.gear_ratio, q_range=np.stack([log.q.min(axis=0), log.q.max(axis=0)], axis=1),
        time=np.sort(c.clock) if clocked else np.empty(0), step=float(np.median(steps)) if len(steps) else 0.0,
        payloads=(own,) if own in names else (), breaks=np.sort(breaks), run_length=float(max(spans)),
        length=float(max(lengths, default=0.0)), robot=cell.robot.name, torque_max=cell.robot.torque_max,
        stiffness=cell.robot.stiffness, lines=tuple(float(k) for k in np.unique(c.line[log.contact])),
        sides=_sides(log.n[log.contact]), friction=cell.wheel.friction,
    )  # fmt: skip


def conditions(problem: Problem, fit: ForceFit, waves: tuple[Wave, ...] = ()) -> Conditions:
    """Of the log's rows, for what is tested without the library."""
    log, c, scene = problem.log, problem.scene.conditions, problem.scene
    payload = scene.cell.workpiece.payload
    joints = [fit.at.fn_slope[:, None] * fit.slopes[1]]
    if log.ft is not None:
        joints.append(fit.at.ft_slope[:, None] * fit.slopes[1])
    known = c.given
    return Conditions(
        signal="force", q=log.q, approach=c.approach, time=c.time, clock=c.clock if "clock_s" in known else None,
        temperature=log.temperature, wheel_temperature=log.wheel_temperature, run=log.run,
        line=log.line, session=log.session if len(log.sessions) > 1 else None, s=c.s,
        feed=log.feed, setpoint=log.setpoint, belt=log.belt, contact=log.contact.astype(float), travel=c.travel,
        tau=weight_torques(scene.cell.robot, log.q, payload.mass, payload.com), d_joints=np.stack(joints, axis=1),
        gear_ratio=ratios_of(surroundings(problem)), waves=waves,
    )  # fmt: skip


def _sides(n: Array) -> tuple[tuple[float, float, float], ...]:
    """Mean normals of the sides of the blade that normals (n, 3) belong to: that of the first row, and the one behind it."""
    groups = [n[n @ n[0] > 0], n[n @ n[0] <= 0]] if len(n) else []
    means = [part.mean(axis=0) / np.linalg.norm(part.mean(axis=0)) for part in groups if len(part)]
    return tuple((float(m[0]), float(m[1]), float(m[2])) for m in means)


def _ends(run: Index, clock: Array) -> tuple[Array, Array]:
    """First and last instants of the runs, in the order of the clock."""
    runs = np.unique(run)
    first = np.array([clock[run == r].min() for r in runs])
    last = np.array([clock[run == r].max() for r in runs])
    order = np.argsort(first)
    return first[order], last[order]
