"""Gross readings that an effect takes back."""

from dataclasses import replace

import numpy as np

from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.engine.search import outliers_rechecked
from ocp.diagnose.rules import OUTLIERS_OF_ONE_CAUSE
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from tests.diagnose.test_diagnosis_tracker import LIBRARY, channel, world

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
    (found,) = outliers_rechecked(linearised([believed], LIBRARY, OPTIONS), (), LIBRARY, OPTIONS)
    assert [a.effect.name for a in found.active] == ["target_shift"] and (found.fit.weight < 0.5).sum() < OUTLIERS_OF_ONE_CAUSE
    assert np.abs(found.active[0].a - SHIFT).max() < 1e-4
    d = diagnose_channels([believed], LIBRARY, OPTIONS)
    assert d.verdict == "explained" and d.explanations[0].names == (Name("target_shift", 0),)


def test_gross_readings_without_a_cause_in_common_stay_so():
    readings = world(6, outliers=0.08)[0]
    believed = channel(readings)
    assert (believed.fit.weight < 0.5).sum() >= OUTLIERS_OF_ONE_CAUSE
    assert outliers_rechecked(linearised([believed], LIBRARY, OPTIONS), (), LIBRARY, OPTIONS) is None
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
