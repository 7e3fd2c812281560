"""Readings less predictions, with their derivatives in all unknowns, for any mix of nests, loads and stations."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from robots.calibration.layout import Layout, State
from robots.calibration.reading_model import Prediction, RowInputs, predict, predict_points
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Index, Instrument, Readings


@dataclass(frozen=True)
class Linearised:
    """Residual (n, k) measured - predicted in the tracker's frame (k = 3 m; 6 with rad where readings have turns), point (n, 3)
    predicted, its derivative J (n, k, p) (of the prediction), and d_joints (n, 3, 6) m/rad in the tracker's frame."""

    residual: Array
    point: Array
    J: Array
    d_joints: Array


def residuals(robot: Robot, readings: Readings, instrument: Instrument, state: State) -> Array:
    """Residual (n, k) alone."""
    n = len(readings)
    k = 3 if readings.turn is None else 6
    out = np.empty((n, k))
    for rows, inputs in row_groups(readings, instrument, state):
        point, R = predict_points(robot, state.arm, inputs)
        out[rows] = _difference(readings, state, rows, point, R)
    return out


def points(robot: Robot, readings: Readings, instrument: Instrument, state: State) -> Array:
    """Predicted places (n, 3) m of the reflectors in their trackers' frames alone."""
    out = np.empty((len(readings), 3))
    for rows, inputs in row_groups(readings, instrument, state):
        point, _ = predict_points(robot, state.arm, inputs)
        S = state.stations[readings.station[rows]]
        out[rows] = (S[:, :3, :3] @ point[..., None])[..., 0] + S[:, :3, 3]
    return out


def linearise(robot: Robot, readings: Readings, instrument: Instrument, layout: Layout, state: State) -> Linearised:
    """Residuals with derivatives."""
    n = len(readings)
    k = 3 if readings.turn is None else 6
    residual, point = np.empty((n, k)), np.empty((n, 3))
    J, d_joints = np.zeros((n, k, layout.size)), np.empty((n, 3, 6))
    for rows, inputs in row_groups(readings, instrument, state):
        p = predict(robot, state.arm, inputs)
        residual[rows] = _difference(readings, state, rows, p.point, p.R)
        S = state.stations[readings.station[rows]]
        R = S[:, :3, :3]
        point[rows] = (R @ p.point[..., None])[..., 0] + S[:, :3, 3]
        d_joints[rows] = R @ p.d_joints
        J[rows] = _columns(readings, layout, state, rows, p, R, k)
    return Linearised(residual, point, J, d_joints)


def _columns(readings: Readings, layout: Layout, state: State, rows: Index, p: Prediction, R: Array, k: int) -> Array:
    """Derivative (r, k, p) of predictions `p` of the readings `rows`, R (r, 3, 3) of their stations."""
    r = len(rows)
    J = np.zeros((r, k, layout.size))
    active = np.flatnonzero(layout.arm >= 0)
    J[:, :3, layout.arm[active]] = R @ p.d_arm[..., active]
    turned = (R @ p.point[..., None])[..., 0]
    skew = np.zeros((r, 3, 3))
    for a, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):  # column a: unit vector a x point
        skew[:, i, j], skew[:, j, i] = turned[:, a], -turned[:, a]
    blocks = [
        (layout.payload[readings.payload[rows]], R @ p.d_payload),
        (layout.nest[readings.target[rows]][:, :3], R @ p.d_nest),
        (layout.station[readings.station[rows]], np.concatenate([np.tile(np.eye(3), (r, 1, 1)), skew], axis=2)),
    ]
    _scatter(J, blocks, slice(0, 3))
    if k == 6:
        J[:, 3:, layout.arm[active]] = R @ p.spin_arm[..., active]
        nest = R @ p.R @ state.turns[readings.target[rows]]
        identity = np.tile(np.eye(3), (r, 1, 1))
        spins = [
            (layout.payload[readings.payload[rows]], R @ p.spin_payload),
            (layout.nest[readings.target[rows]][:, 3:], nest),
            (layout.station[readings.station[rows]][:, 3:], identity),
        ]
        _scatter(J, spins, slice(3, 6))
        J[~readings.turned[rows], 3:] = 0.0
    return J


def _scatter(J: Array, blocks: list[tuple[Array, Array]], part: slice) -> None:
    """Put derivative blocks (r, 3, m) into the columns (r, m) of J[:, part], where those are unknowns."""
    for columns, block in blocks:
        for m in range(columns.shape[1]):
            here = np.flatnonzero(columns[:, m] >= 0)
            J[here[:, None], np.arange(part.start, part.stop)[None, :], columns[here, m][:, None]] = block[here, :, m]


def row_groups(readings: Readings, instrument: Instrument, state: State) -> list[tuple[Index, RowInputs]]:
    """Readings that share the link of their nest and of their load: rows and the inputs of their predictions.

    What is not pulled counts as pulled at the base, which no joint feels: a third less to work out.
    """
    nests = instrument.nests or {}
    link = np.array([nests[name].link if name in nests else 6 for name in readings.targets])[readings.target]
    loaded = np.where(np.abs(readings.load).max(axis=1) > 0, readings.load_link, 0)
    found = []
    for on, pulled in sorted({*zip(link.tolist(), loaded.tolist(), strict=True)}):
        rows = np.flatnonzero((link == on) & (loaded == pulled))
        inputs = RowInputs(
            q=readings.q[rows],
            payload=state.payloads[readings.payload[rows]],
            load=readings.load[rows],
            load_place=readings.load_place[rows],
            nest=state.nests[readings.target[rows]],
            nest_link=on,
            load_link=pulled,
        )
        found.append((rows, inputs))
    return found


def _difference(readings: Readings, state: State, rows: Index, point: Array, R: Array) -> Array:
    """Measured less predicted of `rows`, in their trackers' frames."""
    S = state.stations[readings.station[rows]]
    off = readings.point[rows] - (S[:, :3, :3] @ point[..., None])[..., 0] - S[:, :3, 3]
    if readings.turn is None:
        return off
    predicted = S[:, :3, :3] @ R @ state.turns[readings.target[rows]]
    turn = np.zeros((len(rows), 3))  # a row without an orientation says nothing of it
    known = readings.turned[rows]
    turn[known] = Rotation.from_matrix(readings.turn[rows][known] @ np.swapaxes(predicted[known], 1, 2)).as_rotvec()
    return np.hstack([off, turn])
