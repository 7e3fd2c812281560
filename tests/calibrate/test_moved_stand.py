"""A tracker that was moved while it read, unsaid: told by the line, on readings of an arm that shares no code with the model."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.calibrate.moved_stand import moved_stands
from robots.calibration.fit import fit_campaign
from robots.calibration.layout import Priors
from robots.calibration.solver import Campaign
from tests.support.simulated_campaign import EXTRA, INSTRUMENT, PAYLOADS, campaign_readings, measured, random_truth


@pytest.mark.parametrize("station", [0, 1])
def test_a_tracker_that_was_moved_is_told_by_its_line(station):
    """By a tenth of a millimetre, one of two stations read in turn; nothing is told where both stood still."""
    rng = np.random.default_rng(34)
    readings = measured(random_truth(rng, background=2e-5), campaign_readings(rng, 120), rng)
    readings = replace(readings, station=np.arange(120) % 2, stations=("left", "right"))

    def told(point):
        return moved_stands(
            fit_campaign(Campaign(EXTRA, replace(readings, point=point), PAYLOADS, INSTRUMENT), priors=Priors(3e-4, 3e-4))
        )

    later = (np.arange(120) >= 70) & (readings.station == station)
    assert told(readings.point) == []
    (found,) = told(readings.point + np.where(later[:, None], [0.0, 1e-4, 0.0], 0.0))
    assert found.station == ("left", "right")[station] and abs(found.line - 72) <= 2
    assert found.distance == pytest.approx(1e-4, rel=0.2) and f"From about line {found.line} on" in found.words


def test_how_far_readings_lie_off_is_told_at_their_middle():
    """A tracker that turned: what was read near it hardly moved, what was read far off did."""
    rng = np.random.default_rng(35)
    readings = measured(random_truth(rng, background=1e-5), campaign_readings(rng, 120), rng)
    readings = readings.take(np.argsort(readings.point[:, 0]))
    later, turn = np.arange(120) >= 70, np.array([0.0, 0.0, 4e-4])
    point = readings.point + np.where(later[:, None], np.cross(turn, readings.point), 0.0)
    (found,) = moved_stands(fit_campaign(Campaign(EXTRA, replace(readings, point=point), PAYLOADS, INSTRUMENT)))
    wanted = np.linalg.norm(np.cross(turn, readings.point[later].mean(axis=0)))
    assert found.distance == pytest.approx(wanted, rel=0.08)
