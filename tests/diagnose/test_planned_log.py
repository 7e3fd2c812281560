"""A planned force log is read from force.csv without readings or from a plan.csv, and what is wrong with it is said."""

from pathlib import Path

import numpy as np
import pytest

from ocp.diagnose.__main__ import app
from ocp.diagnose.foresee.design import read_planned_log
from robots.errors import BadInput
from tests.support.diagnosis_folder import CELL, SPRINGS
from tests.support.small_plan import called

PLACE = ["px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz"]
AXES = [f"q{i}_deg" for i in range(1, 7)]
PLAN = ["time_s", "line", "contact", *AXES, *PLACE, "s_mm", "feed_mm_s", "fn_N"]


def plan_rows() -> list[dict[str, object]]:
    """Line 4, line 7, line 7 again with moves between, one point each 20 ms."""
    rows: list[dict[str, object]] = []
    for line, contact in ((4, 0), (4, 1), (7, 0), (7, 1), (7, 0), (7, 1)):
        for k in range(15):
            row: dict[str, object] = {"time_s": round(0.02 * len(rows), 3), "line": line, "contact": contact, "fn_N": 20.0}
            row |= {name: 10.0 + k for name in AXES}
            here = dict(zip(PLACE, [1.0, 2.0, 3.0 + k, 1, 0, 0, 0, 0, 1], strict=True)) | {"s_mm": k, "feed_mm_s": 40}
            rows.append(row | (here if contact else dict.fromkeys([*PLACE, "s_mm", "feed_mm_s"], "")))
    return rows


def write(path: Path, rows: list[dict[str, object]], header: list[str] | None = None) -> Path:
    header = PLAN if header is None else header
    path.write_text("\n".join([",".join(header), *(",".join(str(row[k]) for k in header) for row in rows)]) + "\n")
    return path


def test_every_passage_of_a_plan_is_a_recording(tmp_path):
    log = read_planned_log(write(tmp_path / "plan.csv", plan_rows()))
    assert len(log) == 45 and log.contact.all() and np.isnan(log.fn).all() and log.ft is None
    assert [list(np.unique(log.line[log.run == k])) for k in range(3)] == [[4], [7], [7]]
    assert [log.ground_before[log.run == k].max() for k in range(3)] == [0, 0, 1]
    assert np.all(log.time[log.run == 2] == pytest.approx(0.02 * np.arange(15)))
    assert log.clock[log.run == 2][0] == pytest.approx(0.02 * 75) and log.clock[0] == pytest.approx(0.02 * 15)
    assert log.feed[0] == 0.04 and log.p[1, 2] == pytest.approx(0.004) and log.q[0, 0] == pytest.approx(np.radians(10))
    assert list(log.row[:2]) == [17, 18]


def test_lines_without_a_move_between_are_two_recordings(tmp_path):
    rows = [row for row in plan_rows() if row["contact"]][:30]
    log = read_planned_log(write(tmp_path / "plan.csv", rows))
    assert len(log.runs) == 2 and [float(np.unique(log.line[log.run == k])[0]) for k in range(2)] == [4.0, 7.0]
    assert log.time.max() == pytest.approx(0.02 * 14)


def test_a_log_without_readings_is_a_plan(tmp_path):
    rows = [row | {"run": row["line"]} for row in plan_rows() if row["contact"]]
    header = ["run", *(k for k in PLAN if k not in ("fn_N", "contact"))]
    log = read_planned_log(write(tmp_path / "force.csv", rows[:30], header))
    assert len(log) == 30 and log.runs == ("4", "7") and log.clock is None and log.contact.all() and np.isnan(log.fn).all()


def changed(k: int, **values: object) -> list[dict[str, object]]:
    rows = plan_rows()
    rows[k] |= values
    return rows


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (plan_rows()[:16], "column contact: 1 rows in contact"),
        (plan_rows()[:15], "column contact: 0 rows in contact"),
        (changed(20, px_mm=""), "line 22, column px_mm: the cell is empty"),
        (changed(20, nx=0.5), "line 22, column nx: 0.5 makes the vector nx, ny, nz 0.5 long"),
        (changed(20, contact=2), "line 22, column contact: 2 must be 1"),
        (changed(50, time_s=0.3), "line 52, column time_s: 0.3 comes after 0.98"),
        (changed(20, q3_deg="x"), "line 22, column q3_deg: 'x'"),
    ],
)
def test_what_is_wrong_with_a_plan_is_said_with_its_place(tmp_path, rows, words):
    with pytest.raises(BadInput) as refused:
        read_planned_log(write(tmp_path / "plan.csv", rows))
    assert words in str(refused.value) and "plan.csv" in str(refused.value) and "\n" not in str(refused.value)


def test_a_table_of_something_else_is_refused(tmp_path):
    with pytest.raises(BadInput, match="neither a column run"):
        read_planned_log(write(tmp_path / "poses.csv", plan_rows(), ["time_s", *AXES]))
    with pytest.raises(BadInput, match="cannot be read"):
        read_planned_log(tmp_path / "none.csv")


def test_the_command_refuses_a_log_without_a_cell_and_a_cell_without_a_wheel(tmp_path):
    plan = write(tmp_path / "plan.csv", plan_rows())
    (tmp_path / "cell.toml").write_text(CELL.format(stiffness=SPRINGS))
    asked = ((("--log", plan), "--log goes with --design"), (("--design", tmp_path / "cell.toml", "--log", plan), "workpiece"))
    for arguments, words in asked:
        found = called(app, tmp_path, *arguments)
        assert found.code == 2 and words in found.err and len(found.err.strip().splitlines()) == 1, found.err
        assert not found.out and "Traceback" not in found.err
