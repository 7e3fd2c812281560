"""What the virtual cell makes of plan.csv: every instant of the driven program finds its place in the plan."""

import numpy as np

from ocp.plan.programming import build_timeline, emitted_times, write_plan_csv
from ocp.simulate.twin.controller import drive
from ocp.simulate.twin.krl_text import read_program
from ocp.simulate.twin.plan_knowledge import FINE, GRINDING, NEAR, _dense, match, read_plan_table
from tests.support.invented_motion import cell, motion, written


def test_the_plan_has_no_gaps_between_its_legs(tmp_path):
    """A sample between the last row of an approach and the first in contact found nothing near and was taken for the touch of
    another line, whose postures come close there: plans of crosswise lines were refused as driven out of turn."""
    program, _ = written(tmp_path)
    write_plan_csv(build_timeline(motion(), emitted_times(motion(), program)), tmp_path / "plan.csv", 20.0)
    plan = read_plan_table(tmp_path)
    fine = _dense(plan)
    assert np.diff(np.unique(fine.time)).max() < 1.01 * FINE
    edges = [k for k in range(1, len(plan.time)) if (plan.phase[k] == GRINDING) != (plan.phase[k - 1] == GRINDING)]
    assert len(edges) == 4
    for k in edges:
        between = (fine.time > plan.time[k - 1] + 1e-6) & (fine.time < plan.time[k] - 1e-6)
        assert between.any() and (fine.phase[between] == NEAR).all()
    track = drive(read_program(tmp_path, planned=True), cell().robot)
    seen = match(track, plan)
    assert [int(k) for k in np.unique(seen.run)] == [-1, 0, 1]
    expected = np.interp(track.time, plan.time, plan.q[:, 0])
    off = np.abs(track.q[:, None] - fine.q[None, ::1]).max(axis=2).min(axis=1)
    assert off.max() < np.radians(0.06) and np.abs(track.q[:, 0] - expected).max() < np.radians(0.1)
