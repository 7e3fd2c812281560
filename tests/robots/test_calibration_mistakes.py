"""Mistakes with readings are named, each for what it is; sound readings pass."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robots.calibration.mistakes import misfit, refuse_mistakes
from robots.calibration.solver import Campaign
from robots.errors import BadInput
from robots.reference_kinematics import elementary_forward
from robots.robot import load_robot
from tests.support.simulated_campaign import EXTRA, INSTRUMENT, PAYLOADS, campaign_readings, measured, random_truth


def campaign() -> Campaign:
    rng = np.random.default_rng(4)
    return Campaign(EXTRA, measured(random_truth(rng), campaign_readings(rng, 60), rng, 0.02), PAYLOADS, INSTRUMENT)


def exchanged(rows: np.ndarray, i: int, j: int) -> np.ndarray:
    rows = rows.copy()
    rows[:, [i, j]] = rows[:, [j, i]]
    return rows


def of(**change):
    return lambda c: replace(c, readings=replace(c.readings, **{k: f(getattr(c.readings, k)) for k, f in change.items()}))


MISTAKES = {
    "metres": (of(point=lambda p: p / 1e3), "in metres, not millimetres"),
    "inches": (of(point=lambda p: p / 25.4), "in inches, not millimetres"),
    "radians": (of(q=np.radians), "in radians, not degrees"),
    "a flipped axis": (of(point=lambda p: p * [1, 1, -1]), "left-handed frame"),
    "exchanged axes": (of(point=lambda p: exchanged(p, 0, 1)), "left-handed frame"),
    "exchanged joints": (of(q=lambda q: exchanged(q, 1, 2)), "columns q2_deg and q3_deg are exchanged"),
    "a joint's sign": (of(q=lambda q: q * [1, 1, 1, -1, 1, 1]), "axis 4 has the opposite sign"),
    "mathematical signs": (of(q=lambda q: q * EXTRA.sign), "mathematical signs instead of KUKA's"),
    "another zero": (of(q=lambda q: q + np.radians([0, 0, 90, 0, 0, 0])), "axis 3 counts from a zero 90 deg away"),
    "points one row late": (of(point=lambda p: np.roll(p, 1, axis=0)), "1 row too late"),
    "rows of another file": (of(point=lambda p: np.random.default_rng(0).permutation(p)), "rows belong together"),
    "robot -2": (lambda c: replace(c, robot=load_robot("kr210_r2700_2")), "the robot is a 'kr210_r2700_extra'"),
    "robot prime": (lambda c: replace(c, robot=load_robot("kr210_r2700_prime")), "kr210_r2700_prime'"),
}


def test_sound_readings_pass():
    sound = campaign()
    refuse_mistakes(sound)
    assert misfit(sound)[0] < 5e-3  # far from where anything would be suspected


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(name):
    change, said = MISTAKES[name]
    with pytest.raises(BadInput, match="tracker.csv") as error:
        refuse_mistakes(change(campaign()))
    assert said in str(error.value) and "\n" not in str(error.value)


def test_many_readings_far_off_are_not_called_outliers():
    c = campaign()
    off = np.arange(60) < 14
    point = c.readings.point + off[:, None] * np.random.default_rng(2).normal(size=(60, 3))
    with pytest.raises(BadInput, match="lie far from where the arm can be"):
        refuse_mistakes(replace(c, readings=replace(c.readings, point=point)))


def test_orientations_in_another_convention_are_told_and_sound_ones_pass():
    rng = np.random.default_rng(3)
    truth = random_truth(rng)
    readings = measured(truth, replace(campaign_readings(rng, 40), target=np.zeros(40, np.int64)), rng)
    # The flange as elementary motions have it, the target mounted askew.
    flange = elementary_forward(truth.robot, readings.q)[:, :3, :3]
    mounted = Rotation.from_euler("xyz", [20, -10, 35], degrees=True).as_matrix()
    turn = truth.T_tracker_base[:3, :3] @ flange @ mounted
    sound = Campaign(EXTRA, replace(readings, turn=turn), PAYLOADS, INSTRUMENT)
    refuse_mistakes(sound)
    other = Rotation.from_euler("XYZ", Rotation.from_matrix(turn).as_euler("xyz")).as_matrix()
    with pytest.raises(BadInput, match="orientations rx, ry, rz"):
        refuse_mistakes(replace(sound, readings=replace(sound.readings, turn=other)))
