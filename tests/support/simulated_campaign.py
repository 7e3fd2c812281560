"""A laser-tracker campaign on an arm that is not the believed one, by the elementary motions in NumPy alone."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robots.gravity import GRAVITY
from robots.pose import make_transform
from robots.reference_kinematics import elementary_forward
from robots.robot import Robot, load_robot
from robots.tracker_readings import Hanging, Instrument, Nest, Readings
from tests.support.reference_arm import elementary_weight_torques

EXTRA = load_robot("kr210_r2700_extra")
PAYLOADS = {
    "bare": Hanging(),
    "grinder": Hanging(25.0, np.array([0.01, 0.0, 0.16])),
    "weight": Hanging(90.0, np.array([0.0, 0.02, 0.2])),
}
NESTS = {
    "T1": Nest(6, np.array([0.15, -0.05, 0.25])),
    "T2": Nest(6, np.array([-0.16, 0.04, 0.21])),
    "T3": Nest(6, np.array([0.02, 0.17, 0.33])),
}
INSTRUMENT = Instrument(nests=NESTS)


@dataclass(frozen=True)
class Truth:
    """What an arm really is: robot with its MD-H, compliance (6,), nests by name, T_tracker_base; ripple (6, 3) amplitude
    rad, order, phase and backlash half width (6,) rad as background that no model knows; joint noise rad."""

    robot: Robot
    compliance: np.ndarray
    nests: dict[str, np.ndarray]
    T_tracker_base: np.ndarray
    ripple: np.ndarray
    backlash: np.ndarray
    joint_noise: float = 1e-5

    def points(
        self, readings: Readings, noise: np.random.Generator | None = None, payloads: dict[str, Hanging] = PAYLOADS
    ) -> np.ndarray:
        """Reflectors (n, 3) m in the tracker's frame; with `noise` the joints repeat as well as they do."""
        out = np.empty((len(readings), 3))
        for k, name in enumerate(readings.payloads):
            rows = np.flatnonzero(readings.payload == k)
            if not len(rows):
                continue
            q = readings.q[rows]
            q = q + self.ripple[:, 0] * np.cos(self.ripple[:, 1] * q + self.ripple[:, 2])
            if readings.approach is not None:
                q = q + self.backlash * readings.approach[rows]
            if noise is not None:
                q = q + noise.normal(size=q.shape) * self.joint_noise
            hung, real = payloads[name], q
            for _ in range(8):
                torque = elementary_weight_torques(self.robot, real, GRAVITY, hung.mass, hung.com)
                real = q + self.compliance * torque
            T = elementary_forward(self.robot, real)
            nest = np.array([self.nests[readings.targets[t]] for t in readings.target[rows]])
            base = np.einsum("nij,nj->ni", T[:, :3, :3], nest) + T[:, :3, 3]
            out[rows] = base @ self.T_tracker_base[:3, :3].T + self.T_tracker_base[:3, 3]
        return out


def random_truth(rng: np.random.Generator, background: float = 0.0, size: float = 3e-4, joint_noise: float = 1e-5) -> Truth:
    """An arm off by `size` m and rad in every MD-H parameter, springs of joints 2 and 3 off by 20 %."""
    mdh = EXTRA.mdh + rng.normal(size=(6, 5)) * size
    compliance = np.zeros(6)
    compliance[1:3] = 1.0 / EXTRA.stiffness[1:3] * rng.uniform(0.8, 1.2, 2)
    nests = {name: nest.place + rng.normal(size=3) * 1e-3 for name, nest in NESTS.items()}
    T = make_transform(Rotation.random(random_state=int(rng.integers(2**31))).as_matrix(), rng.uniform(-1, 1, 3) + [0, 4.0, 0])
    ripple = np.column_stack([rng.uniform(0, background, 6), rng.integers(1, 40, 6), rng.uniform(0, 2 * np.pi, 6)])
    return Truth(replace(EXTRA, mdh=mdh), compliance, nests, T, ripple, rng.uniform(0, background, 6), joint_noise)


def campaign_readings(rng: np.random.Generator, n: int, file: Path = Path("tracker.csv")) -> Readings:
    """n postures in front of the robot, payloads, nests and approach directions mixed; points still to come."""
    low = np.radians([-90, -120, -20, -170, -115, -170])
    high = np.radians([90, -20, 140, 170, 115, 170])
    return Readings(
        path=file,
        q=rng.uniform(low, high, (n, 6)),
        point=np.full((n, 3), np.nan),
        target=np.asarray(rng.integers(3, size=n)),
        targets=tuple(NESTS),
        payload=np.asarray(np.arange(n) % 3),
        payloads=tuple(PAYLOADS),
        station=np.zeros(n, np.int64),
        stations=("",),
        session=np.zeros(n, np.int64),
        sessions=("",),
        load=np.zeros((n, 6)),
        load_link=np.full(n, 6),
        load_place=np.zeros((n, 3)),
        approach=np.asarray(rng.choice([-1.0, 1.0], (n, 6))),
        line=np.arange(2, n + 2),
    )


def measured(truth: Truth, readings: Readings, rng: np.random.Generator, outliers: float = 0.0) -> Readings:
    """The readings a tracker takes: 8 um along the beam, 8 um + 3 um/m across it; a share displaced by millimetres."""
    point = truth.points(readings, rng)
    distance = np.linalg.norm(point, axis=1, keepdims=True)
    beam = point / distance
    z = rng.normal(size=point.shape)
    along = np.sum(z * beam, axis=1, keepdims=True) * beam
    noisy = point + 8e-6 * along + (8e-6 + 3e-6 * distance) * (z - along)
    gross = rng.random(len(point)) < outliers
    noisy[gross] += rng.normal(size=(int(gross.sum()), 3)) * 3e-3
    return replace(readings, point=noisy)
