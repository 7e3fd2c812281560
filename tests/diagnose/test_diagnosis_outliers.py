"""Gross readings that an effect takes back."""

import csv
from dataclasses import replace

import numpy as np

from ocp.diagnose.answering import answer_of, predict_sealed
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.engine.search import outliers_rechecked
from ocp.diagnose.rules import OUTLIERS_OF_ONE_CAUSE
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.forms import INSTANTS
from ocp.shell.progress import Phases
from tests.diagnose.test_diagnosis_tracker import LIBRARY, channel, world
from tests.support.diagnosis_folder import write_csv, write_tracker_folder
from tests.support.simulated_campaign import campaign_readings, random_truth

SHIFT = np.array([4e-4, -2e-4, 3e-4])
OPTIONS = Options(folds=False)


def late_shift(readings):
    """One nest moves before its last seven readings."""
    last = np.flatnonzero(readings.target == 1)[-7:]
    scanned = {"target": readings.targets[1], "at_s": float(readings.time[last[0]] - 1.0)}
    moves = channel(readings)._displaced(LIBRARY["target_shift"], 0, [scanned])[1][0] @ SHIFT
    return replace(readings, point=readings.point + moves)


def test_a_late_step_is_rather_a_step_than_gross_readings():
    believed = channel(late_shift(world(6)[0]))
    assert (believed.fit.weight < 0.5).sum() >= OUTLIERS_OF_ONE_CAUSE
    (found,) = outliers_rechecked(linearised([believed], LIBRARY, OPTIONS), LIBRARY, OPTIONS)
    assert [a.effect.name for a in found.active] == ["target_shift"] and (found.fit.weight < 0.5).sum() < OUTLIERS_OF_ONE_CAUSE
    assert np.abs(found.active[0].a - SHIFT).max() < 1e-4
    d = diagnose_channels([believed], LIBRARY, OPTIONS)
    assert d.verdict == "explained" and d.explanations[0].names == (Name("target_shift", 0),)


def test_gross_readings_without_a_cause_in_common_stay_so():
    readings = world(6, outliers=0.08)[0]
    believed = channel(readings)
    assert (believed.fit.weight < 0.5).sum() >= OUTLIERS_OF_ONE_CAUSE
    assert outliers_rechecked(linearised([believed], LIBRARY, OPTIONS), LIBRARY, OPTIONS) is None
    assert diagnose_channels([believed], LIBRARY, OPTIONS).verdict == "no_gap"


def test_readings_of_moving_air_have_tails_and_others_none():
    """Noise of Student's law on whole readings counts as such in every set; readings of a normal law leave evidence as it was."""
    rng, readings = np.random.default_rng(4), world(6)[0]
    n = len(readings)
    moved = 6e-5 * rng.normal(size=(n, 3)) * np.sqrt(3.0 / rng.chisquare(3.0, (n, 1)))
    gains = []
    for one in (readings, replace(readings, point=readings.point + moved)):
        pool = linearised([channel(one)], LIBRARY, OPTIONS).pool
        (tails,) = pool.tails
        assert tails.rows == slice(0, 3 * n) and len(tails.starts) == n
        gains.append(pool.plain)
    assert gains[0] == 0.0 and gains[1] > 5.0


def test_what_is_predicted_is_the_cell_that_is_written(tmp_path):
    """A nest was moved early: the baseline sets the readings before it aside and is right; fitted anew with them it is not."""
    truth = write_tracker_folder(tmp_path, 3)
    rows, asked = (
        list(csv.DictReader((tmp_path / name).read_text().splitlines())) for name in ("tracker.csv", "sealed_tracker.csv")
    )
    rng = np.random.default_rng(3)
    arm, readings = random_truth(rng, joint_noise=4e-6), campaign_readings(rng, len(rows))
    before = replace(arm, nests=arm.nests | {"T2": arm.nests["T2"] + SHIFT})
    changed = 1e3 * (before.points(readings) - arm.points(readings))
    for i, row in enumerate(rows):
        row["time_s"] = 60 * i
        for k, column in enumerate(("x_mm", "y_mm", "z_mm")):
            row[column] = float(row[column]) + changed[i, k] * (i < 25)
    write_csv(tmp_path / "tracker.csv", {c: [r[c] for r in rows] for c in rows[0]})
    asked = [row | {"time_s": 60 * (len(rows) + i)} for i, row in enumerate(asked)]
    write_csv(tmp_path / "sealed_tracker.csv", {c: [r[c] for r in asked] for c in asked[0]})
    answer = answer_of(tmp_path, Phases())
    assert [a.effect.name for a in answer.diagnosis.active] == ["target_shift"] and not answer.written
    told = predict_sealed(answer)["tracker"]
    assert np.array_equal(told.corrected, told.baseline)
    assert np.abs(told.corrected - truth).max() < 1e-4


def test_a_nest_that_moves_is_sought_between_its_own_readings():
    """Among the readings of all nests half a pause of the campaign can lie between two instants that are tried."""
    readings = world(6)[0]
    scans = LIBRARY["target_shift"].scan(0, channel(readings).surroundings)
    for k, name in enumerate(readings.targets):
        own = np.sort(readings.time[readings.target == k])
        tried = np.sort([s["at_s"] for s in scans if s["target"] == name])
        between = np.searchsorted(own, tried)
        assert between[0] == 1 and between[-1] == len(own) - 1
        assert np.diff(between).max() <= -(-len(own) // INSTANTS) and np.diff(between).min() >= 1
