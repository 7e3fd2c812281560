"""What every arm and tracker effect does, by elementary motions in NumPy: formulas of their own, nothing of the library."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from robots.gravity import GRAVITY
from robots.reference_kinematics import elementary_frames
from tests.support.reference_arm import elementary_weight_torques
from tests.support.simulated_campaign import EXTRA, NESTS, PAYLOADS

COMPLIANCE = np.array([3e-7, 3e-7, 4e-7, 1e-6, 1e-6, 1e-6])
T_TRACKER = Rotation.from_euler("xyz", [0.2, -0.4, 1.1]).as_matrix()
AT = np.array([1.0, -4.0, 0.5])


@dataclass(frozen=True)
class Poses:
    """n readings: q, approach, payload index, nest index, warm K, time s, speed rad/s."""

    q: np.ndarray
    approach: np.ndarray
    payload: np.ndarray
    nest: np.ndarray
    warm: np.ndarray
    time: np.ndarray
    speed: np.ndarray

    @staticmethod
    def random(n: int, seed: int = 0) -> "Poses":
        rng = np.random.default_rng(seed)
        low, high = np.radians([-90, -120, -20, -170, -115, -170]), np.radians([90, -20, 140, 170, 115, 170])
        return Poses(
            rng.uniform(low, high, (n, 6)),
            rng.choice([-1.0, 1.0], (n, 6)),
            np.arange(n) % 3,
            rng.integers(3, size=n),
            rng.uniform(-2, 8, n),
            np.sort(rng.uniform(0, 3600, n)),
            0.02 * rng.normal(size=(n, 6)),
        )


def reflectors(poses: Poses, effect: str = "", joint: int = 0, v: dict | None = None) -> np.ndarray:
    """Points (n, 3) m in the tracker's frame of an arm with one effect of values `v`."""
    v = v or {}
    out = np.empty((len(poses.q), 3))
    names, nests = tuple(PAYLOADS), tuple(NESTS)
    for i in range(len(out)):
        out[i] = _reflector(poses, i, effect, joint - 1, v, names[poses.payload[i]], nests[poses.nest[i]])
    return out


def settled(start, carried, centre, torque=None):
    """Where the joints (6,) come to rest."""
    real = start
    for _ in range(5):
        weight = elementary_weight_torques(EXTRA, real, GRAVITY, carried, centre)[0]
        real = start + COMPLIANCE * (weight + (0.0 if torque is None else torque(real)))
    return real


@cache
def loaded(q: bytes, mass: float, com: bytes):
    """Joints (6,) at rest and their load (6,) N m, without an effect: the same for all of them."""
    bent = settled(np.frombuffer(q), mass, np.frombuffer(com))
    return bent, elementary_weight_torques(EXTRA, bent, GRAVITY, mass, np.frombuffer(com))[0]


def _reflector(poses, i, effect, j, v, payload, nest):
    hung, robot, q = PAYLOADS[payload], EXTRA, poses.q[i].copy()
    mass, com = hung.mass, np.asarray(hung.com, float)
    if effect.startswith("payload") and v["payload"] in (payload, "loaded") and (mass > 0 or v["payload"] != "loaded"):
        mass, com = mass + v.get("kg", 0.0), com + np.asarray(v.get("shift_m", 0.0))

    # The believed posture, from which effects take the load.
    bent, tau = loaded(q.tobytes(), hung.mass, np.asarray(hung.com, float).tobytes())
    shift = _joint_shift(poses, i, effect, j, v, tau)
    if shift is not None and effect in ("channel_delay",) and j < 0:
        q = q + shift
    elif shift is not None:
        q[j] += shift
    torque = None if effect != "gravity_compensator" else (lambda real: extra_torque(real, v))
    if effect == "link_thermal":  # a warm robot is longer; its believed load stays
        mdh = EXTRA.mdh.copy()
        mdh[:, 1:3] *= 1 + v["per_K"] * poses.warm[i]
        robot = replace(EXTRA, mdh=mdh)
    still = torque is None and (q == poses.q[i]).all() and mass == hung.mass and (com == hung.com).all()
    frames = elementary_frames(robot, bent if still else settled(q, mass, com, torque))[0]
    p = frames[6, :3, :3] @ NESTS[nest].place + frames[6, :3, 3]
    if effect == "tool_flex":  # in the tool's own axes: x and y give, z does not
        pull = frames[6, :3, :3].T @ [0, 0, -hung.mass * GRAVITY]
        p = p + frames[6, :3, :3] @ (v["m_per_N"] * pull * [1, 1, 0])
    if effect == "link_bending":
        p = _bent_link(bent, tau, frames, p, j, v, hung)
    if effect == "base_tilt":
        share = np.clip((poses.time[i] - v["at_s"]) / max(v["until_s"] - v["at_s"], 1e-9), 0, 1)
        p = Rotation.from_rotvec(share * np.asarray(v["rad"])).as_matrix() @ p
    if effect == "target_shift" and nest == v["target"] and poses.time[i] >= v["at_s"]:
        p = p + frames[6, :3, :3] @ v["shift_m"]
    seen = T_TRACKER @ p + AT
    if effect == "tracker_scale":
        seen = seen * (1 + v["scale"])
    if effect == "air_scale":
        seen = seen * (1 + v["per_K"] * poses.warm[i])
    if effect == "azimuth_harmonic":
        turn = v["rad"] * np.cos(v["order"] * np.arctan2(seen[1], seen[0]) + v["phase_rad"])
        seen = Rotation.from_rotvec([0, 0, turn]).as_matrix() @ seen
    if effect == "tracker_drift":
        hours = poses.time[i] / 3600
        seen = seen + hours * np.asarray(v["m_per_h"]) + np.cross(hours * np.asarray(v["rad_per_h"]), seen)
    return seen


def extra_torque(q, v):
    """Minus the slope of the spring's energy in joint 2."""

    def energy(angle):
        lift = angle + np.pi / 2 - v["rest_rad"]
        a, b = v["lever_link1_m"], v["lever_arm_m"]
        anchor, end = np.array([0.0, a]), b * np.array([np.sin(lift), np.cos(lift)])
        stretch = np.linalg.norm(end - anchor) - v["free_length"] * abs(b - a)
        return 0.5 * v["stiffness_N_m"] * stretch**2

    return np.array([0, -(energy(q[1] + 1e-6) - energy(q[1] - 1e-6)) / 2e-6, 0, 0, 0, 0])


def _joint_shift(poses, i, effect, j, v, tau):
    q, s, load = poses.q[i, j], poses.approach[i, j], tau[j]
    shifts = {
        "backlash": lambda: v["half_width_rad"] * s,
        "joint_compliance": lambda: v["rad_per_Nm"] * load,
        "joint_stiffening": lambda: -v["rad_per_Nm3"] * load**3,
        "friction_windup": lambda: (v["base_rad"] + v["per_Nm"] * abs(load)) * s,
        "encoder_scale": lambda: v["scale"] * q,
        "joint_thermal": lambda: v["rad_per_K"] * poses.warm[i],
        "gear_1x": lambda: v["amplitude_rad"] * np.cos(q + v["phase_rad"]),
        "gear_2x": lambda: v["amplitude_rad"] * np.cos(2 * q + v["phase_rad"]),
        "gear_harmonic": lambda: v["amplitude_rad"] * np.cos(v["order"] * q + v["phase_rad"]),
        "motor_harmonic": lambda: v["amplitude_rad"] * np.cos(v["order"] * v["gear_ratio"] * q + v["phase_rad"]),
        "joint_coupling": lambda: v["ratio_rad"] * poses.q[i, v["source_joint"] - 1],
        "load_backlash": lambda: v["half_width_rad"] * np.tanh(load / v["torque_Nm"]),
        "wrist_coupling": lambda: v["ratio"] * poses.q[i, v["source_joint"] - 1],
        "channel_delay": lambda: -v["s"] * (poses.speed[i] if j < 0 else poses.speed[i, j]),
    }
    return shifts[effect]() if effect in shifts else None


def _bent_link(q, tau, frames, p, j, v, hung, pieces=2000):
    """The beam as many small pieces, each turned by its own moment; the moment falls linearly from root to tip."""
    still = elementary_frames(EXTRA, q)[0]
    tip, axis = (2 if j == 1 else 4), still[j, :3, 2]
    root = EXTRA.sign[j] * tau[j]
    end = EXTRA.sign[2] * tau[2] if j == 1 else _moment_beyond_wrist(still, axis, hung)
    start, way = still[j, :3, 3], still[tip, :3, 3] - still[j, :3, 3]
    at, per_piece = (np.arange(pieces) + 0.5) / pieces, v["rad_per_Nm"] / pieces
    moment = {0.5: root + (end - root) * at, 1.0: np.full(pieces, root), 0.0: np.full(pieces, end)}[v["root_share"]]
    turn = per_piece * moment
    about = start + at[:, None] * way
    return (
        p
        + np.sum(turn[:, None] * np.cross(axis, frames[tip, :3, 3] - about), axis=0)
        + np.cross(turn.sum() * axis, p - frames[tip, :3, 3])
    )


def _moment_beyond_wrist(frames, axis, hung):
    total = 0.0
    for link, mass, com in [
        (5, EXTRA.link_mass[5], EXTRA.link_com[5]),
        (6, EXTRA.link_mass[6], EXTRA.link_com[6]),
        (6, hung.mass, hung.com),
    ]:
        lever = frames[link, :3, :3] @ np.asarray(com) + frames[link, :3, 3] - frames[4, :3, 3]
        total += axis @ np.cross(lever, [0, 0, -mass * GRAVITY])
    return total
