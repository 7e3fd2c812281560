"""Mistakes with readings are named, each for what it is; sound readings pass."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robots.calibration.fit import fit_campaign
from robots.calibration.mistakes import misfit, refuse_loads, refuse_mistakes
from robots.calibration.solver import Campaign, OpenDirection
from robots.errors import BadInput
from robots.pose import ROTATION_ORDERS, rotations_in_order
from robots.reference_kinematics import elementary_forward
from robots.robot import load_robot
from robots.tracker_readings import ROTATION
from tests.support.simulated_campaign import EXTRA, INSTRUMENT, PAYLOADS, campaign_readings, measured, random_truth


@cache
def campaign() -> Campaign:
    rng = np.random.default_rng(4)
    return Campaign(EXTRA, measured(random_truth(rng), campaign_readings(rng, 60), rng, 0.02), PAYLOADS, INSTRUMENT)


def exchanged(rows: np.ndarray, i: int, j: int) -> np.ndarray:
    rows = rows.copy()
    rows[:, [i, j]] = rows[:, [j, i]]
    return rows


def of(**change):
    return lambda c: replace(c, readings=replace(c.readings, **{k: f(getattr(c.readings, k)) for k, f in change.items()}))


def with_table(written):
    """A robot file whose geometry was written otherwise than it is meant."""
    return lambda c: replace(c, robot=replace(c.robot, mdh=written(c.robot.mdh)))


def craig(mdh: np.ndarray) -> np.ndarray:
    """a and alpha as Craig's convention lists them: of the link before the joint."""
    rows = mdh.copy()
    rows[1:, 2:4], rows[0, 2:4] = mdh[:5, 2:4], 0.0
    return rows


MISTAKES = {
    "metres": (of(point=lambda p: p / 1e3), " times as close together as the arm moved: x, y, z are in metres, not millimetres"),
    "micrometres": (of(point=lambda p: p * 1e3), "times as far apart as the arm moved: x, y, z are in micrometres"),
    "centimetres": (of(point=lambda p: p / 10), "10 times as close together as the arm moved: x, y, z are in centimetres"),
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
    "two signs": (of(q=lambda q: q * [1, -1, 1, 1, -1, 1]), "axes 2 and 5 both have the opposite sign"),
    "a wrist's sign": (of(q=lambda q: q * [1, 1, 1, 1, 1, -1]), "axis 6 has the opposite sign"),
    "the base's sign": (of(q=lambda q: q * [-1, 1, 1, 1, 1, 1]), "axis 1 has the opposite sign"),
    "exchanged nests": (of(target=lambda t: np.where(t == 2, 2, 1 - t)), "the nests 'T1' and 'T2' are exchanged"),
    "nests all round": (of(target=lambda t: (t + 1) % 3), "the nests 'T1' and 'T2' and 'T3' are exchanged"),
    "DH in Craig's convention": (with_table(craig), "Craig's (modified) convention"),
    "DH in metres": (with_table(lambda m: m * [1, 1e-3, 1e-3, 1, 1]), "d_mm and a_mm in metres"),
    "DH in radians": (with_table(lambda m: m * [np.pi / 180, 1, 1, np.pi / 180, 1]), "angles in radians"),
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


@cache
def sixfold() -> tuple[Campaign, np.ndarray]:
    """A sound campaign of one 6D target, and its orientations (n, 3, 3)."""
    rng = np.random.default_rng(3)
    truth = random_truth(rng)
    readings = measured(truth, replace(campaign_readings(rng, 40), target=np.zeros(40, np.int64)), rng)
    # The flange as elementary motions have it, the target mounted askew.
    flange = elementary_forward(truth.robot, readings.q)[:, :3, :3]
    turn = truth.T_tracker_base[:3, :3] @ flange @ Rotation.from_euler("xyz", [20, -10, 35], degrees=True).as_matrix()
    return Campaign(EXTRA, replace(readings, turn=turn), PAYLOADS, INSTRUMENT), turn


def test_sound_orientations_pass():
    refuse_mistakes(sixfold()[0])


@pytest.mark.parametrize("order", ROTATION_ORDERS)
def test_orientations_in_another_convention_are_told(order):
    sound, turn = sixfold()
    letters, kind = order.split("_")
    turned = Rotation.from_matrix(turn).as_euler(letters.upper() if kind == "intrinsic" else letters)
    angles = turned[:, np.argsort(["xyz".index(c) for c in letters])] if len({*letters}) == 3 else turned
    assert np.allclose(rotations_in_order(angles, order), turn)
    given = rotations_in_order(angles, ROTATION)
    if np.allclose(given, turn):
        return
    with pytest.raises(BadInput, match="orientations scatter .* while the points fit") as error:
        refuse_mistakes(replace(sound, readings=replace(sound.readings, turn=given, angles=angles)))
    named = str(error.value).split("rotation = '")[1].split("'")[0]
    assert np.allclose(rotations_in_order(angles, named), turn)


def test_quaternions_with_the_scalar_last_are_told():
    sound, turn = sixfold()
    given = np.roll(Rotation.from_matrix(turn).as_quat(), -1, axis=1)  # x, y, z, w in the columns qw, qx, qy, qz
    with pytest.raises(BadInput, match="the columns read as x, y, z and the scalar last"):
        refuse_mistakes(replace(sound, readings=replace(sound.readings, turn=Rotation.from_quat(given).as_matrix())))


def test_poor_orientations_pass_where_they_are_stated_to_be():
    sound, turn = sixfold()
    off = Rotation.from_rotvec(np.random.default_rng(0).normal(0, np.radians(1.0), (40, 3))).as_matrix()
    poor = replace(sound.readings, turn=turn @ off)
    with pytest.raises(BadInput, match="qw, qx, qy, qz scatter by 1.5 deg.* or state sigma_rot_deg"):
        refuse_mistakes(replace(sound, readings=poor))
    refuse_mistakes(replace(sound, readings=replace(poor, sigma_turn=np.full(40, np.radians(1.0)))))


def test_one_orientation_alone_is_compared_with_nothing():
    sound, turn = sixfold()
    refuse_mistakes(
        replace(sound, readings=replace(sound.readings, turn=np.where(np.arange(40)[:, None, None] > 0, np.nan, turn)))
    )


def test_orientations_turned_about_or_of_no_order_are_told():
    sound, turn = sixfold()
    with pytest.raises(BadInput, match="not the tracker in the target's"):
        refuse_mistakes(replace(sound, readings=replace(sound.readings, turn=np.swapaxes(turn, 1, 2))))
    with pytest.raises(BadInput, match="qw, qx, qy, qz scatter by"):
        refuse_mistakes(replace(sound, readings=replace(sound.readings, turn=turn[::-1])))


@cache
def loaded() -> Campaign:
    """A sound campaign, a third of its postures pulled at with about 1 kN at the flange."""
    rng = np.random.default_rng(6)
    truth, readings = random_truth(rng), campaign_readings(rng, 60)
    load = np.zeros((60, 6))
    load[::3, :3] = rng.normal(0, 400, (20, 3)) + [0, 0, -900]

    def flange(q: np.ndarray) -> np.ndarray:
        return elementary_forward(truth.robot, q)[:, :3, 3]

    steps = [1e-6 * np.eye(6)[j] for j in range(6)]
    torque = np.column_stack([np.sum((flange(readings.q + h) - flange(readings.q - h)) * load[:, :3], 1) / 2e-6 for h in steps])
    bent = measured(truth, replace(readings, q=readings.q + truth.compliance * torque), rng)
    return Campaign(EXTRA, replace(bent, q=readings.q, load=load), PAYLOADS, INSTRUMENT)


def by_name(one: int, other: int):
    return of(payload=lambda p: np.where(p == one, other, np.where(p == other, one, p)))


LOAD_MISTAKES = {
    "kilonewtons": (of(load=lambda f: f / 1e3), "the loads are in kilonewtons and kN m"),
    "pounds": (of(load=lambda f: f / ([4.44822] * 3 + [1.35582] * 3)), "pounds-force and lbf ft"),
    "reaction": (of(load=lambda f: -f), "the loads point the other way"),
    "payloads": (by_name(0, 2), "the payloads 'bare' and 'weight' are exchanged"),
}


def test_sound_loads_pass():
    refuse_loads(fit_campaign(loaded()))


@pytest.mark.parametrize("name", LOAD_MISTAKES)
def test_loads_of_another_unit_or_sign_are_told(name):
    change, said = LOAD_MISTAKES[name]
    with pytest.raises(BadInput, match=r"tracker.csv, from line \d+ on: .* met within 0.0\d+ mm instead") as error:
        refuse_loads(fit_campaign(change(loaded())))
    assert said in str(error.value)


def test_a_reading_of_loads_that_leaves_an_unknown_open_refuses_nothing(monkeypatch):
    fit = fit_campaign(LOAD_MISTAKES["reaction"][0](loaded()))

    def left_open(*given, **more):
        raise OpenDirection(("c2",))

    monkeypatch.setattr("robots.calibration.mistakes.fit_campaign", left_open)
    refuse_loads(fit)
