"""What may hang on a flange."""

from itertools import product

import numpy as np
import pytest

from robots.payload import longest_levers
from robots.reference_kinematics import elementary_frames
from robots.robot import load_robot


@pytest.mark.parametrize("name", ["kr210_r2700_extra"])
def test_levers_are_the_longest_of_all_postures_of_the_wrist(name):
    """By elementary motions, over a grid of joints 4, 5 and 6; levers of other arms too, whose wrists have offsets."""
    robot, rng = load_robot(name), np.random.default_rng(2)
    turns = np.radians(np.arange(0.0, 360.0, 5.0))
    q = np.array([[0.3, -1.2, 1.5, *wrist] for wrist in product([0.0, 2.1], turns, turns)])
    for offset in (0.0, 0.3):
        arm = type(robot)(**{**vars(robot), "mdh": robot.mdh + offset * rng.normal(size=(6, 5)) * [0, 1, 1, 1, 0]})
        frames = elementary_frames(arm, q)
        for com in (np.array([0.05, 0.02, 0.2]), np.array([0.0, 0.0, 0.1])):
            point = frames[:, 6, :3, :3] @ com + frames[:, 6, :3, 3]
            off = [np.cross(frames[:, j, :3, 2], point - frames[:, j, :3, 3]) for j in (3, 4, 5)]
            longest = [np.linalg.norm(one, axis=1).max() for one in off]
            assert longest_levers(arm, com) == pytest.approx(longest, rel=2e-3, abs=1e-9)
