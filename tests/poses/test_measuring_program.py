"""The program of a measurement in any dialect: written, read back, and refused where it is not what was planned."""

from dataclasses import replace

import numpy as np
import pytest

import ocp.poses.program as measuring
from ocp.poses.program import MeasuringPose, Tour, approaches
from robots.errors import Infeasible
from robots.tracker_readings import Hanging
from tests.support.example_pass import bundled_cell
from tests.support.toy_dialect import TOY
from trajectories.dialects import DIALECTS
from trajectories.program.program import Wait

ANGLE = np.radians(2.0)


def campaign() -> measuring.MeasurementCampaign:
    home, q = np.radians([[0.0, -90, 90, 0, 10, 0], [20.0, -80, 95, 5, 30, 10]])
    stop = MeasuringPose(q, np.array([1, 1, -1, 1, -1, 1]))
    ways = [np.array([home, approaches(stop, ANGLE)[0]]), np.array([q, home])]
    tour = Tour(np.array([0]), home, ways, 1.0)
    return measuring.MeasurementCampaign("HEAVY", Hanging(40.0, np.array([0.0, 0.0, 0.2])), [stop], ["flange"], tour)


@pytest.mark.parametrize("name", ["krl", "toy"])
def test_every_dialect_goes_the_same_way(name, tmp_path, monkeypatch):
    monkeypatch.setitem(DIALECTS, "toy", TOY)
    monkeypatch.setattr(measuring, "is_free", lambda scene, points: True)
    cell = replace(bundled_cell(), controller=replace(bundled_cell().controller, dialect=name))
    program = measuring.measuring_program(cell, campaign(), ANGLE, Wait(), "poses", 20, set())
    files = measuring.write_and_check(cell, None, program, campaign(), ANGLE, tmp_path)
    assert sorted(files) == sorted(file.name for file in tmp_path.iterdir())
    elsewhere = replace(campaign(), stops=[replace(campaign().stops[0], q=campaign().stops[0].q + 0.01)])
    with pytest.raises(Infeasible, match="is not where reading 1 was planned"):
        measuring.write_and_check(cell, None, program, elsewhere, ANGLE, tmp_path)
    with pytest.raises(Infeasible, match="stops 2 times, 0 readings"):
        measuring.write_and_check(cell, None, program, replace(campaign(), stops=[]), ANGLE, tmp_path)
