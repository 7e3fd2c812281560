"""A fit's unknowns as named parameters: values and covariance, the base's angles among them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ocp.calibrate.tracker import as_calibration
from robots.calibration.layout import Layout, State, moved
from robots.pose import make_transform

ARM = np.full(36, -1)
ARM[[3, 7, 31]] = [0, 2, 1]


def test_covariance_follows_the_unknowns_as_a_fit_moves_them():
    """Against differences of the named values along every unknown; a base turned far, where angles are no turns."""
    size = 13
    layout = Layout(
        names=tuple(map(str, range(size))),
        prior_sd=np.ones(size),
        scale=np.ones(size),
        arm=ARM,
        payload=np.array([[3, 4, 5, 6]]),
        nest=np.full((1, 6), -1),
        station=np.arange(7, 13)[None],
    )
    base = make_transform(Rotation.from_euler("ZYX", [100, 35, -60], degrees=True).as_matrix(), np.array([1.0, -2.0, 0.5]))
    state = State(np.zeros(36), np.zeros((1, 4)), np.zeros((1, 3)), np.eye(3)[None], base[None])
    half = np.random.default_rng(4).normal(size=(size, size))

    def named(one, station):
        return as_calibration("kr210_r2700_extra", layout, one, half @ half.T, station, rigid=(6,), payload=0)

    for station in (0, None):
        found = named(state, station)
        steps = 1e-6 * np.eye(size)
        change = np.stack([named(moved(layout, state, s), station).values - found.values for s in steps], axis=1) / 1e-6
        assert found.names[3] == "c6" and len(found.names) == (14 if station == 0 else 8)
        assert found.covariance == pytest.approx(change @ half @ half.T @ change.T, rel=1e-4, abs=1e-4)
