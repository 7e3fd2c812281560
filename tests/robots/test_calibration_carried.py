"""What a new calibration takes over from an earlier one, against conditioning of the normal law done otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc

from robots.calibration.carried import carried_over, chance_of_one_arm
from robots.calibration.store import Calibration


def test_what_was_found_by_an_arm_moves_with_it():
    """The law of wheel given arm stays; only the arm's own law is another: both by sampling."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3)) * 1e-4
    old = Calibration("r", ("theta_offset1", "wheel_x", "d1"), np.array([1e-3, 0.5, 0.6]), root @ root.T)
    part = rng.normal(size=(2, 2)) * 4e-5
    new = Calibration("r", ("d1", "theta_offset1"), np.array([0.6002, 0.9e-3]), part @ part.T)
    both = carried_over(new, old)
    assert both.names == ("d1", "theta_offset1", "wheel_x")
    arm = new.values + rng.normal(size=(200_000, 2)) @ part.T
    C = old.covariance
    K = np.linalg.solve(C[np.ix_([2, 0], [2, 0])], C[[2, 0], 1])
    rest = C[1, 1] - C[[2, 0], 1] @ K
    wheel = old.values[1] + (arm - old.values[[2, 0]]) @ K + np.sqrt(rest) * rng.normal(size=len(arm))
    sample = np.column_stack([arm, wheel])
    assert np.allclose(both.values, sample.mean(axis=0), atol=4 * sample.std(axis=0).max() / np.sqrt(len(arm)))
    assert np.allclose(both.covariance, np.cov(sample.T), atol=0.02 * np.abs(both.covariance).max())


def test_a_wheel_stays_less_sure_where_the_arm_itself_is_another():
    """The zero of an axis 0.4 mrad off what it was, known to 0.02 mrad by both: a wheel 1 m away would move by 0.4 mm."""
    root = np.array([[2e-5, 0.0, 0.0], [0.0, 3e-5, 0.0], [2e-5, 0.0, 1e-5]])  # theta_offset3, d1, wheel_x
    old = Calibration("r", ("theta_offset3", "d1", "wheel_x"), np.array([1e-3, 0.6, 1.7]), root @ root.T)
    new = Calibration("r", ("theta_offset3", "d1"), np.array([1.4e-3, 0.6]), root[:2] @ root[:2].T)
    near = replace(new, values=np.array([1.05e-3, 0.6]))
    assert chance_of_one_arm(new, old) < 1e-30 and 0.05 < chance_of_one_arm(near, old) < 0.5
    both, moved = carried_over(new, old), carried_over(near, old)
    assert both.values[2] == old.values[2] and both.standard_deviation[2] == pytest.approx(
        np.hypot(old.standard_deviation[2], 4e-4)
    )
    assert not both.covariance[2, :2].any() and moved.values[2] - old.values[2] == pytest.approx(5e-5)
    told, held = carried_over(new, old, one_arm=True), carried_over(near, old, one_arm=False)  # who knows it says so
    assert told.values[2] - old.values[2] == pytest.approx(4e-4) and told.standard_deviation[2] < 3e-5
    assert held.values[2] == old.values[2] and not held.covariance[2, :2].any()
    rng, count = np.random.default_rng(1), 4000  # of one arm every chance is as likely
    chances = np.array([chance_of_one_arm(replace(new, values=d), old) for d in _drawn(rng, old, new, count)])
    assert np.mean(chances < 0.1) == pytest.approx(0.1, abs=0.02)


def test_a_tracker_set_up_elsewhere_is_no_other_arm():
    """Where the measuring frame stands is no part of it, nor does a wheel go with that; another method's parameters mean
    something else."""
    root = np.array([[2e-5, 0.0, 0.0], [1e-5, 1e-5, 0.0], [2e-5, 0.0, 1e-5]])  # theta_offset3, base_x, wheel_x
    old = Calibration("r", ("theta_offset3", "base_x", "wheel_x"), np.array([1e-3, 3.0, 1.7]), root @ root.T, {"method": "full"})
    arm = np.diag([4e-10, 1e-10])
    new = Calibration("r", ("theta_offset3", "base_x"), np.array([1.02e-3, -2.0]), arm, {"method": "full"})
    assert chance_of_one_arm(new, old) == pytest.approx(chdtrc(1, 0.5))  # 20 urad beside 20 and 20
    assert carried_over(new, old).values[2] == pytest.approx(1.7 + 2e-5)
    off = replace(new, values=np.array([2e-3, 3.0]))
    assert chance_of_one_arm(off, old) < 1e-100 and chance_of_one_arm(replace(off, provenance={"method": "geometry"}), old) == 1.0
    bare = Calibration("r", ("d1",), np.zeros(1), np.zeros((1, 1)))
    assert chance_of_one_arm(bare, replace(bare, values=np.ones(1))) == 1.0  # what both take as given


def _drawn(rng, old, new, count):
    spread = np.linalg.cholesky(old.covariance[:2, :2] + new.covariance)
    return old.values[:2] + rng.normal(size=(count, 2)) @ spread.T


def test_the_logs_that_the_rest_was_found_by_go_with_it():
    """Without them the next update took a log a second time, and forgot how long the wheel had run."""
    logs = {"force": {"recordings": "a"}, "update": {"logs": ["b"]}}
    old = Calibration("r", ("d1", "wheel_x"), np.zeros(2), np.eye(2), {"method": "full"} | logs)
    new = Calibration("r", ("d1",), np.zeros(1), np.eye(1), {"method": "geometry"})
    assert carried_over(new, old).provenance == {"method": "geometry"} | logs
    own = Calibration("r", ("d1",), np.zeros(1), np.eye(1), {"force": {"recordings": "c"}})
    assert carried_over(own, old).provenance == own.provenance


def test_nothing_is_taken_over_where_nothing_is_missing():
    new = Calibration("r", ("d1",), np.zeros(1), np.eye(1))
    assert carried_over(new, None) is new and carried_over(new, Calibration("r", ("d1",), np.ones(1), np.eye(1))) is new
