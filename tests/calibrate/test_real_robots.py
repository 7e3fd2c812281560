"""What real campaigns brought up: names that come in another order, a station of few readings, directions left open."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.calibrate.tracker import as_in
from robots.calibration.fit import fit_campaign, predict_readings
from robots.calibration.layout import Choice
from robots.calibration.reading_model import RowInputs, predict_points
from robots.calibration.solver import Campaign, OpenDirection
from robots.calibration.validation import LEAST_PLACED, folds, hold_out
from robots.errors import BadInput
from robots.pose import make_transform, rotation_from_abc
from robots.robot import load_robot
from robots.tracker_readings import Readings
from tests.support.simulated_campaign import EXTRA, INSTRUMENT, NESTS, PAYLOADS, campaign_readings, measured, random_truth

WORDS = ("target", "payload", "station", "session")


def in_other_order(readings: Readings) -> Readings:
    """The same rows as a file gives them in which every name appears in the reverse order."""
    turned = {k: len(getattr(readings, f"{k}s")) - 1 - getattr(readings, k) for k in WORDS}
    return replace(readings, **turned, **{f"{k}s": getattr(readings, f"{k}s")[::-1] for k in WORDS})


def test_names_not_positions_tell_what_is_predicted():
    rng = np.random.default_rng(8)
    unplaced = replace(INSTRUMENT, nests=None)  # the names come from the files alone
    truth = random_truth(rng)
    readings = replace(measured(truth, campaign_readings(rng, 50), rng), sessions=("a", "b"), stations=("A", "B"))
    readings = replace(readings, station=np.arange(50) // 25)
    fit = fit_campaign(Campaign(EXTRA, readings, PAYLOADS, unplaced))
    asked = as_in(in_other_order(readings), readings)
    for kind in ("target", "payload", "station"):
        assert getattr(asked, f"{kind}s") == getattr(readings, f"{kind}s")
    assert np.linalg.norm(predict_readings(fit, asked)[0] - readings.point, axis=1).max() < 1e-3
    new = replace(readings, sessions=("c",), session=np.zeros(50, np.int64))
    assert as_in(new, readings).sessions == ("a", "b", "c") and set(as_in(new, readings).session) == {2}


@pytest.mark.parametrize("kind", ["target", "station", "payload"])
def test_a_name_that_was_not_measured_is_refused(kind):
    readings = campaign_readings(np.random.default_rng(0), 10)
    other = replace(readings, **{kind: np.zeros(10, np.int64), f"{kind}s": ("nowhere",)})
    with pytest.raises(BadInput, match=f"line 2, column {kind}: 'nowhere' was not measured"):
        as_in(other, readings)


def few_at_the_end(n: int = 400, few: int = 12) -> Readings:
    """The last `few` of n readings, near one place, are of station D."""
    rng = np.random.default_rng(3)
    readings = measured(random_truth(rng), campaign_readings(rng, n), rng)
    q = readings.q.copy()
    q[-few:] = q[-1] + rng.normal(size=(few, 6)) * 0.05
    return replace(readings, q=q, station=np.asarray(np.arange(n) >= n - few, np.int64), stations=("C", "D"))


def test_no_fold_takes_all_that_places_a_station():
    readings = few_at_the_end()
    held = {"random": [], "region": [], "joint range": []}
    for fold in folds(Campaign(EXTRA, readings, PAYLOADS, INSTRUMENT)):
        if fold.kind in held:
            left = np.setdiff1d(np.flatnonzero(readings.station == 1), fold.held)
            held[fold.kind].append(12 - len(left))
            assert len(left) >= LEAST_PLACED
    assert max(held["random"]) - min(held["random"]) <= 3 and sum(held["random"]) == 12
    assert (readings.thinned(100).station == 1).sum() == 12


def test_a_station_that_only_the_fold_has_is_passed_over():
    rng = np.random.default_rng(4)
    readings = measured(random_truth(rng), campaign_readings(rng, 60), rng)
    readings = replace(readings, station=np.asarray(np.arange(60) >= 50, np.int64), stations=("C", "D"))
    readings = replace(readings, session=readings.station, sessions=("c", "d"))
    fit = fit_campaign(Campaign(EXTRA, readings, PAYLOADS, INSTRUMENT))
    campaign_c, _ = (hold_out(fit, f) for f in folds(fit.campaign) if f.kind == "campaign")
    assert campaign_c is None
    almost = replace(next(f for f in folds(fit.campaign) if f.kind == "random"), held=np.arange(45, 59))
    assert set(hold_out(fit, almost).rows) <= {45, 46, 47, 48, 49}  # one reading left of D places nothing


def test_the_open_direction_is_told_by_name():
    rng = np.random.default_rng(5)
    readings = campaign_readings(rng, 40)
    q = readings.q.copy()
    q[30:] = q[30]
    readings = replace(readings, q=q, payload=np.zeros(40, np.int64), target=np.where(np.arange(40) >= 30, 0, readings.target))
    seen = measured(random_truth(rng), readings, rng)
    seen = replace(seen, station=np.asarray(np.arange(40) >= 30, np.int64), stations=("C", "D"))
    with pytest.raises(OpenDirection) as error:
        fit_campaign(Campaign(EXTRA, seen, PAYLOADS, INSTRUMENT))
    assert all(name.startswith("station_D_") for name in error.value.names)


def odd_arm(seed: int, n: int, noise: float) -> Campaign:
    """n readings of a UR5 of other proportions and masses that is off by 2 mm and 2 mrad, soft joints unbelieved."""
    rng = np.random.default_rng(seed)
    robot = load_robot("ur5")
    mdh = robot.mdh * np.column_stack([np.ones(6), rng.uniform(0.2, 2.0, (6, 2)), np.ones((6, 2))])
    robot = replace(robot, mdh=mdh, link_mass=10 * robot.link_mass, stiffness=np.zeros(6))
    none = np.zeros(n, np.int64)
    readings = replace(campaign_readings(rng, n), q=rng.uniform(-2.5, 2.5, (n, 6)), target=none, targets=("T1",), payload=none)
    inputs = RowInputs(readings.q, np.zeros((n, 4)), np.zeros((n, 6)), np.zeros((n, 3)), np.tile(NESTS["T1"].place, (n, 1)))
    real = (mdh + rng.normal(0, 2e-3, mdh.shape)).ravel()
    base = predict_points(robot, np.concatenate([real, 1e-5 * np.array([0.9, 3, 3, 6, 9, 9])]), inputs)[0]
    T = make_transform(rotation_from_abc([0.3, -0.1, 0.2]), [4.0, -2.0, 1.0])
    seen = base @ T[:3, :3].T + T[:3, 3] + rng.normal(0, noise, (n, 3))
    return Campaign(robot, replace(readings, point=seen), PAYLOADS, INSTRUMENT)


@pytest.mark.parametrize("noise", [1e-5, 3e-4])
def test_a_fit_does_not_creep_along_a_valley(noise):
    for seed in range(3):
        rough = fit_campaign(odd_arm(seed, 300, noise), Choice(joints=()))
        assert rough.steps <= 15  # 40 without the rule for valleys
        longer = fit_campaign(rough.campaign, rough.choice, rough.priors, rough.noise, begin=rough.state)
        at = predict_readings(longer, rough.campaign.readings)[0] - predict_readings(rough, rough.campaign.readings)[0]
        assert np.linalg.norm(at, axis=1).max() < 0.1 * rough.spread * noise * 3
