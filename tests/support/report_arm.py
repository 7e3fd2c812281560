"""The arm of the made-up plan: KR 210 as elementary motions (PHYSICS.md 2.2), its joints, its timed motion.

Joints come from a small Newton iteration with a difference Jacobian, air moves from a smooth interpolation: enough
to look right in a picture, no planner.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.plan.report.plan_report import MotionReport, PassReport
from robots.pose import Array, apply, invert, make_transform, rot_x, rot_y, rot_z
from robots.robot import load_robot

ROBOT = replace(
    load_robot("kr210_r2700_extra"),
    q_min=np.radians([-185, -140, -120, -350, -125, -350]),
    q_max=np.radians([185, -5, 155, 350, 125, 350]),
    qd_max=np.radians([123, 115, 112, 179, 172, 219]),
    qdd_max=np.array([2.0, 2.0, 2.5, 4.0, 4.0, 5.0]),
    torque_max=np.array([7290.0, 8100, 5291, 2182, 1282, 825]),
)
WHEEL = replace(
    read_cell(CELL).wheel,
    centre=np.array([1.7, 0, 1.0]),
    axis=np.array([0.0, 1, 0]),
    radius=0.15,
    width=0.04,
    contact_direction=np.array([-1.0, 0, 0]),
)
T_FLANGE_BLADE = make_transform(np.eye(3), [0, 0, 0.2])


def elementary_arm(q: Array) -> Array:
    """Frames of base and links 1..6 in the base (..., 7, 4, 4), KR 210 R2700 extra, q (..., 6) rad."""
    q = np.asarray(q, float)
    eye = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))

    def move(R: Array, p: tuple[float, float, float]) -> Array:
        return make_transform(R, np.broadcast_to(np.array(p), (*R.shape[:-2], 3)))

    frames, T = [eye], eye
    steps = (
        (rot_z(-q[..., 0]), (0, 0, 0.675), (0.35, 0, 0)),
        (rot_y(q[..., 1]), (0, 0, 0), (1.15, 0, 0)),
        (rot_y(q[..., 2]), (0, 0, 0), (1.2, 0, -0.041)),
        (rot_x(-q[..., 3]), (0, 0, 0), (0, 0, 0)),
        (rot_y(q[..., 4]), (0, 0, 0), (0, 0, 0)),
        (rot_x(-q[..., 5]), (0, 0, 0), (0.215, 0, 0)),
    )
    for R, before, after in steps:
        T = T @ move(np.eye(3), before) @ move(R, (0, 0, 0)) @ move(np.eye(3), after)
        frames.append(T)
    frames[-1] = T @ move(rot_y(np.pi / 2), (0, 0, 0))
    return np.stack([np.broadcast_to(f, (*q.shape[:-1], 4, 4)) for f in frames], axis=-3)


def capsules() -> tuple[tuple[int, Array, Array, float], ...]:
    """Capsules of the links, placed on the stretched arm and carried into the link frames."""
    shapes = (
        (0, (0, 0, 0.26), (0, 0, 0.4), 0.26),
        (1, (0.02, 0, 0.62), (0.35, 0, 0.675), 0.24),
        (2, (0.35, 0, 0.675), (1.5, 0, 0.675), 0.15),
        (3, (1.32, 0, 0.66), (2.1, 0, 0.634), 0.15),
        (4, (2.1, 0, 0.634), (2.6, 0, 0.634), 0.1),
        (5, (2.68, 0, 0.634), (2.74, 0, 0.634), 0.09),
        (6, (2.84, 0, 0.634), (2.88, 0, 0.634), 0.075),
    )
    into = invert(elementary_arm(np.zeros(6)))
    return tuple((i, apply(into[i], a), apply(into[i], b), r) for i, a, b, r in shapes)


def _flange_poses(item: PassReport, every: Array) -> Array:
    """Flange poses (k, 4, 4) that hold waypoints `every` of a pass against the wheel."""
    e = WHEEL.contact_direction
    e = np.cos(item.arc[every])[:, None] * e + np.sin(item.arc[every])[:, None] * np.cross(WHEEL.axis, e)
    belt = np.cross(WHEEL.axis, e)
    T_base_contact = make_transform(
        np.stack([-belt, np.cross(-e, -belt), -e], axis=-1),
        WHEEL.centre + WHEEL.radius * e + item.lateral[every, None] * WHEEL.axis,
    )
    n, t = item.n[every], item.t[every]
    T_blade_contact = make_transform(np.stack([t, np.cross(n, t), n], axis=-1), item.p[every])
    return T_base_contact @ invert(T_blade_contact) @ invert(T_FLANGE_BLADE)


def _joints(poses: Array, q: Array) -> Array:
    """Newton iteration from one seed for every pose (k, 4, 4), with a difference Jacobian; (k, 6) rad."""
    q = np.broadcast_to(q, (len(poses), 6)).copy()

    def error(q: Array) -> Array:
        flange = elementary_arm(q)[..., 6, :, :]
        R, p = (poses @ invert(flange))[..., :3, :3], poses[..., :3, 3] - flange[..., :3, 3]
        turn = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
        return np.concatenate([p, turn / 2], axis=-1)

    for _ in range(30):
        base = error(q)
        jacobian = np.stack([(error(q + h) - base) / 1e-6 for h in 1e-6 * np.eye(6)], axis=-1)
        damped = np.swapaxes(jacobian, -1, -2) @ jacobian + 1e-5 * np.eye(6)
        step = np.linalg.solve(damped, (np.swapaxes(jacobian, -1, -2) @ base[..., None]))[..., 0]
        q -= np.clip(step, -0.2, 0.2)
        if np.abs(step).max() < 1e-9:
            break
    return q


def timed_motion(passes: list[PassReport], rate: float) -> MotionReport:
    """Passes in order with short air moves between them, sampled at `rate` Hz."""
    times, joints, start, spans = [], [], 0.0, []
    seed = np.radians([0.0, -75, 110, 0, 55, 0])
    for before, item in zip([passes[0], *passes], passes, strict=False):
        if item.side != before.side:
            start, seed = (start + 2.0, seed + np.pi * np.eye(6)[5])  # the other side faces the wheel after half a turn
        knots = np.linspace(0, len(item.s) - 1, 14).astype(int)
        clock = np.concatenate([[0], np.cumsum(np.diff(item.s) / (0.5 * (item.feed[1:] + item.feed[:-1])))])
        q = _joints(_flange_poses(item, knots), seed)
        seed = q[-1]
        lift = q[[0, -1]] + np.radians([0, -4.0, 1, 0, 0, 0])
        times += [start + 1.2 + np.concatenate([[-0.7], clock[knots], [clock[-1] + 0.7]])]
        joints += [np.concatenate([lift[:1], q, lift[1:]])]
        spans.append((start + 1.2, clock, item))
        start += 3.6 + clock[-1]
    path = PchipInterpolator(np.concatenate(times), np.concatenate(joints))
    time = np.arange(times[0][0], times[-1][-1], 1 / rate)
    q, count = path(time), len(time)
    qd = np.gradient(q, time, axis=0)
    line, contact = np.zeros(count, int), np.zeros(count, bool)
    feed, force, force_sd = np.zeros(count), np.full(count, np.nan), np.full(count, np.nan)
    for begin, clock, item in spans:
        on = (time >= begin) & (time <= begin + clock[-1])
        line[on], contact[on] = item.line, True
        for out, values in ((feed, item.feed), (force, item.force), (force_sd, item.force_sd)):
            out[on] = np.interp(time[on] - begin, clock, values)
    static = np.c_[0 * time, 3700 * np.cos(q[:, 1]), 1000 * np.cos(q[:, 1] + q[:, 2]), 0 * time, 30 + 0 * time, 0 * time]
    kernel = np.ones(15) / 15
    qdd = np.stack([np.convolve(a, kernel, "same") for a in np.gradient(qd, time, axis=0).T], axis=1)
    torque = static + np.array([900, 700, 250, 40, 25, 6]) * np.clip(qdd, -5, 5)
    return MotionReport(time, q, qd, np.clip(qdd, -1.9, 1.9), torque, contact, line, feed, force, force_sd)
