"""force.csv as FORMATS has it: columns in any order, what is absent is told, what is wrong is refused with its place."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.calibrate.force.log import (
    BLIND,
    LEAST_ROWS,
    STILL,
    UNITS_APART,
    is_known,
    log_mark,
    read_force_log,
    refuse_few_rows,
    refuse_force_unit,
    refuse_saturated,
    saturation,
    without_ramps,
)
from robots.errors import BadInput

NEEDED = ["run", "time_s", *(f"q{i}_deg" for i in range(1, 7)), "px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz"]
ROW = {
    "run": "a",
    "time_s": 0.0,
    **{f"q{i}_deg": 10.0 * i for i in range(1, 7)},
    "px_mm": 1.0,
    "py_mm": 2.0,
    "pz_mm": 3.0,
    "nx": 0.0,
    "ny": 1.0,
    "nz": 0.0,
    "tx": 0.0,
    "ty": 0.0,
    "tz": 1.0,
    "fn_N": 20.0,
}
EVERY = {
    "s_mm": 1.0,
    "ft_N": 7.0,
    "sigma_fn_N": 0.2,
    "sigma_ft_N": 0.3,
    "setpoint_N": 20.0,
    "feed_mm_s": 40.0,
    "belt_m_s": -20.0,
    "line": 2,
    "ground_before": 1,
    "contact": 1,
    "session": "monday",
    "temperature_C": 22.0,
    "wheel_temperature_C": 25.0,
    "clock_s": 5.0,
}


def rows(count=6, **more):
    return [{**ROW, "time_s": 0.01 * k, **more} for k in range(count)]


def write(folder, table, header=None):
    path = folder / "force.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, header or list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    return path


def read(folder, table, sealed=False):
    return read_force_log(write(folder, table), sealed)


def test_every_column_is_read_in_si(tmp_path):
    header = [*NEEDED, "fn_N", *EVERY]
    order = np.random.default_rng(1).permutation(len(header))
    log = read_force_log(write(tmp_path, rows(**EVERY), [header[k] for k in order]))
    assert len(log) == 6 and log.notices == () and log.runs == ("a",) and log.sessions == ("monday",)
    np.testing.assert_allclose(log.q[0], np.radians([10, 20, 30, 40, 50, 60]))
    np.testing.assert_allclose(log.p[0], [1e-3, 2e-3, 3e-3])
    assert (log.s[0], log.feed[0], log.belt[0], log.line[0], log.ground_before[0]) == (1e-3, 0.04, -20.0, 2, 1)
    assert log.contact.all() and log.row.tolist() == [2, 3, 4, 5, 6, 7]


def test_what_is_absent_is_told_and_what_is_more_is_ignored(tmp_path):
    log = read(tmp_path, rows(remark="x"))
    assert log.notices[0] == "force.csv: columns remark were ignored"
    told = " ".join(log.notices[1:])
    assert all(f"no column {name}: {text}" in told for name, text in BLIND.items())
    assert log.setpoint is None and log.sigma_fn is None


def test_what_is_sealed_is_no_condition(tmp_path):
    """Readings beside sealed conditions, given or left empty, are passed over and said to be."""
    for value in ("", 19.5):
        log = read(tmp_path, [{**row, "fn_N": value, "ft_N": value} for row in rows()], sealed=True)
        assert np.isnan(log.fn).all() and log.ft is None and log.notices[0] == "force.csv: columns fn_N, ft_N were ignored"


def test_readings_that_are_exchanged_or_a_setpoint_of_nothing_are_refused(tmp_path):
    flange = SimpleNamespace(flange=SimpleNamespace(setpoint=20.0), process=SimpleNamespace(force=20.0))
    flange.wheel = SimpleNamespace(belt_speed=20.0)
    for friction in (0.35, 0.6):
        swapped = rows(fn_N=20.0 * friction, ft_N=20.0, contact=1, setpoint_N=20.0)
        with pytest.raises(BadInput, match="look exchanged"):
            refuse_force_unit(read(tmp_path, swapped), flange)
        refuse_force_unit(read(tmp_path, rows(fn_N=20.0, ft_N=20.0 * friction, contact=1, setpoint_N=20.0)), flange)
    refuse_force_unit(read(tmp_path, rows(fn_N=19.0, ft_N=22.0, contact=1, setpoint_N=20.0)), flange)  # a coarse belt
    for against in (rows(fn_N=20.0, ft_N=-7.0, contact=1), rows(fn_N=20.0, ft_N=7.0, belt_m_s=-20.0, contact=1)):
        with pytest.raises(BadInput, match="line 2, column ft_N: -?7 at a belt speed of -?20 m/s is a pull against the belt"):
            refuse_force_unit(read(tmp_path, against), flange)
    for along in (rows(fn_N=20.0, ft_N=-7.0, belt_m_s=-20.0, contact=1), rows(fn_N=20.0, ft_N=-0.5, contact=1)):
        refuse_force_unit(read(tmp_path, along), flange)
    idle = [{**row, "setpoint_N": 0.0 if k else 20.0} for k, row in enumerate(rows(fn_N=20.0, contact=1))]
    with pytest.raises(BadInput, match="line 3, column setpoint_N: 0 in contact"):
        refuse_force_unit(read(tmp_path, idle), flange)


def test_rows_given_twice_and_times_of_another_unit_are_refused(tmp_path):
    moving = [{**row, "pz_mm": 0.4 * k, "fn_N": 20.0 + 0.01 * k} for k, row in enumerate(rows(40, contact=1, feed_mm_s=40.0))]
    assert len(read(tmp_path, moving)) == 40
    with pytest.raises(BadInput, match="line 3, column time_s: .* repeats line 2, as 40 rows do; remove the copies"):
        read(tmp_path, [row for row in moving for _ in range(2)])
    with pytest.raises(BadInput, match="time_s: .* makes the points move at 0.04 mm/s .* where feed_mm_s says 40; give seconds"):
        read(tmp_path, [{**row, "time_s": 1e3 * row["time_s"]} for row in moving])
    minutes = read(tmp_path, [{**row, "time_s": row["time_s"] / 60} for row in moving])
    assert any("while the points move at 2.4e+03 mm/s" in notice for notice in minutes.notices)


def test_without_the_flag_a_run_near_zero_is_air_and_said_so(tmp_path):
    table = rows(30) + [{**row, "run": "b", "fn_N": 0.3 * (-1) ** k} for k, row in enumerate(rows(30))]
    log = read(tmp_path, table)
    assert log.contact[:30].all() and not log.contact[30:].any()
    assert any("taken as air runs" in notice for notice in log.notices)


def test_a_single_dropout_is_no_air_run(tmp_path):
    table = rows(30)
    table[10]["fn_N"] = 0.0
    assert read(tmp_path, table).contact.all()


def test_sealed_files_have_no_reading(tmp_path):
    table = [{name: value for name, value in row.items() if name != "fn_N"} for row in rows()]
    log = read(tmp_path, table, sealed=True)
    assert np.isnan(log.fn).all() and log.contact.all()
    with pytest.raises(BadInput, match="column fn_N missing"):
        read(tmp_path, table)


def test_taking_rows_keeps_names(tmp_path):
    log = read(tmp_path, rows(3) + [{**row, "run": "b"} for row in rows(3)])
    part = log.take(log.run == 1)
    assert len(part) == 3 and part.runs == ("a", "b") and set(part.run) == {1}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ny": 1.2}, r"line 4, column nx: 0 makes the vector nx, ny, nz 1.2 long; a unit vector is expected"),
        ({"tz": 0.5}, r"line 4, column tx: .* 0.5 long"),
        ({"ty": 0.3, "tz": 0.9539}, r"line 4, column tx: 0 makes n . t = 0.300; the feed direction must lie in the surface"),
        ({"time_s": -1.0}, r"line 4, column time_s: -1 comes after 0.01 in run a; the rows of a run must be in time order"),
        ({"fn_N": "abc"}, r"line 4, column fn_N: 'abc' is not a number"),
        ({"fn_N": "nan"}, r"line 4, column fn_N: 'nan' is not a finite number"),
        ({"q3_deg": "inf"}, r"line 4, column q3_deg: 'inf' is not a finite number"),
        ({"run": ""}, r"line 4, column run: .* a label is expected"),
        ({"contact": 2}, r"line 4, column contact: 2 must be 1 in contact or 0 in an air run"),
        ({"sigma_fn_N": 0.0}, r"line 4, column sigma_fn_N: 0.* is not between"),
        ({"sigma_ft_N": -1.0}, r"line 4, column sigma_ft_N: -1.* is not between"),
        ({"setpoint_N": -5.0}, r"line 4, column setpoint_N: -5 must be zero or above"),
        ({"feed_mm_s": -5.0}, r"line 4, column feed_mm_s: -5 must be zero or above"),
        ({"line": 1.5}, r"line 4, column line: 1.5 must be a whole number"),
        ({"clock_s": -1.0}, r"line 4, column clock_s: -1 comes after 5 in run a; the rows of a run must be in time order"),
        ({"ground_before": -1}, r"line 4, column ground_before: -1 must be a whole number"),
        ({"session": "tuesday"}, r"line 4, column session: tuesday is another than at the beginning of run a .monday.; .* own"),
    ],
)
def test_what_is_wrong_is_refused_with_its_place(tmp_path, change, message):
    table = rows(**EVERY)
    table[2] |= change
    with pytest.raises(BadInput, match=r"force\.csv, " + message):
        read(tmp_path, table)


def test_a_belt_and_a_feed_that_stand_still_are_told(tmp_path):
    moving = [row | {"px_mm": 0.4 * k} for k, row in enumerate(rows(belt_m_s=0.0, feed_mm_s=0.0, contact=1))]
    told = [one for one in read(tmp_path, moving).notices if "no column" not in one]
    assert len(told) == 2 and "belt_m_s: 0 in every row" in told[0] and "the points move at 40 mm/s" in told[1]
    still = rows(belt_m_s=-20.0, feed_mm_s=0.0, contact=1)
    assert all("no column" in one for one in read(tmp_path, still).notices)


def test_clocks_run_and_recordings_are_given_once(tmp_path):
    with pytest.raises(BadInput, match="line 2, column clock_s: -5 must be zero or above"):
        read(tmp_path, rows(clock_s=-5.0))
    noise = np.random.default_rng(0).normal(size=STILL + 1)
    table = [row | {"fn_N": 20.0 + v} for row, v in zip(rows(STILL + 1), noise, strict=True)]
    assert len(read(tmp_path, table)) == STILL + 1
    for column in ("clock_s", "time_s"):
        with pytest.raises(BadInput, match=rf"column {column}: 3 stands still throughout"):
            read(tmp_path, [row | {column: 3.0} for row in table])
    again = [row | {"run": "b"} for row in table]
    late = [row | {"run": "b", "clock_s": 60.0, "fn_N": row["fn_N"] + 0.1} for row in table]
    stamped = [row | {"clock_s": 0.0} for row in table] + late
    assert len(read(tmp_path, stamped)) == 2 * (STILL + 1)
    air = [row | {"run": run, "fn_N": 0.0, "contact": 0} for run in "cd" for row in table[:10]]
    assert len(read(tmp_path, [row | {"contact": 1} for row in table] + air)) == STILL + 21
    with pytest.raises(BadInput, match=rf"line {STILL + 3}, column run: b holds the readings of run a again"):
        read(tmp_path, table + again)
    again[7]["fn_N"] += 1e-3
    assert len(read(tmp_path, table + again)) == 2 * (STILL + 1)


def test_sessions_that_each_began_at_zero_are_told(tmp_path):
    day = [
        row | {"run": run, "session": run, "clock_s": at, "fn_N": 20.0 + at}
        for run, at in (("a", 0.0), ("a", 9.0))
        for row in rows(1)
    ]
    for begins, told in ((3.0, 1), (9.0, 0)):
        again = [row | {"run": "b", "session": "b", "clock_s": begins + row["clock_s"]} for row in day]
        found = [n for n in read(tmp_path, day + again).notices if "session b begins at 3 s, before session a ends at 9 s" in n]
        assert len(found) == told


def test_too_few_rows_in_a_row_tell_no_noise(tmp_path):
    refuse_few_rows(read(tmp_path, rows(LEAST_ROWS + 1)))
    refuse_few_rows(read(tmp_path, [row | {"run": str(k // 2)} for k, row in enumerate(rows(2 * LEAST_ROWS))]))
    for few in (rows(LEAST_ROWS), [row | {"run": str(k)} for k, row in enumerate(rows(200))]):
        with pytest.raises(BadInput, match=r"\d+ rows in contact follow another one .*; at least 20 are needed"):
            refuse_few_rows(read(tmp_path, few))


def test_without_its_column_ramps_are_no_air(tmp_path):
    """A wheel that meets the blade presses with next to nothing: what it reads is no zero of the sensor."""
    table = rows(600)
    for k, row in enumerate(table):
        row.pop("contact", None)
        row |= {"time_s": 0.01 * k, "fn_N": float(np.clip(0.2 * (k - 300), -0.3, 20.0))}
    log = read(tmp_path, table)
    air, force = log.time[~log.contact], log.fn
    assert air.max() < log.time[log.contact].min() - 0.99 and len(air) > 150
    assert force[~log.contact].max() < 0 and force[log.contact].min() > 2.0
    assert any("rows of low force within 1 s of a touch are left out" in told for told in log.notices)
    told = read(tmp_path, [row | {"contact": int(row["fn_N"] > 3.0)} for row in table])
    assert len(told) == 600 and not any("left out" in one for one in told.notices)


def test_a_log_without_contact_or_with_the_wrong_sign_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no row is in contact"):
        read(tmp_path, rows(contact=0))
    with pytest.raises(BadInput, match=r"line 2, column fn_N: -20 is negative as most of the log is"):
        read(tmp_path, rows(fn_N=-20.0, contact=1))


@pytest.mark.parametrize(
    "count, long, refused",
    [
        (102, 10, False),
        (104, 10, True),
        (150, 1, False),
    ],  # 102 rows but the first of two recordings are 100; one row each tells nothing
)
def test_a_setpoint_in_the_place_of_a_reading_is_refused(tmp_path, count, long, refused):
    table = rows(count, fn_N=20.0, contact=1)
    for k, row in enumerate(table):
        run = k if long == 1 else int(k >= long)
        row |= {"time_s": 0.01 * k, "fn_N": 20.0 + 9.0 * (run % 2), "run": run}
    if refused:
        with pytest.raises(BadInput, match="line 2, column fn_N: 20 stays the same through every recording, as a setpoint does"):
            read(tmp_path, table)
    else:
        assert len(read(tmp_path, table)) == count


@pytest.mark.parametrize("setpoint", [20.0, None])
def test_a_log_in_another_unit_than_the_cell_is_refused(tmp_path, setpoint):
    """The flange's setpoint is what the cell asks for; without a flange it is the process force."""
    flange = None if setpoint is None else SimpleNamespace(setpoint=setpoint)
    cell = SimpleNamespace(flange=flange, process=SimpleNamespace(force=20.0 if flange is None else 1e6))
    for inside, outside in ((0.99 * UNITS_APART, 1.01 * UNITS_APART), (1.01 / UNITS_APART, 0.99 / UNITS_APART)):
        refuse_force_unit(read(tmp_path, rows(fn_N=20.0 * inside, contact=1)), cell)
        with pytest.raises(BadInput, match="force.csv, column fn_N: .* where the cell asks for 20 N; give newtons"):
            refuse_force_unit(read(tmp_path, rows(fn_N=20.0 * outside, contact=1)), cell)
    for unit, factor in (("kilograms", 9.80665), ("pounds", 4.44822), ("kilonewtons", 1000.0)):
        for near in (0.93, 1.07):  # a pull in newtons beside it is no normal force
            with pytest.raises(BadInput, match=f"as a force in {unit}"):
                refuse_force_unit(read(tmp_path, rows(fn_N=20.0 * near / factor, ft_N=6.4, contact=1)), cell)
        if unit == "kilonewtons":
            continue
        for apart in (0.91, 1.09):
            refuse_force_unit(read(tmp_path, rows(fn_N=20.0 * apart / factor, contact=1)), cell)
        # A column says what was asked for; but for a unit that both are in, and one row of it for nothing.
        refuse_force_unit(read(tmp_path, rows(fn_N=20.3 / factor, setpoint_N=20.1 / factor, contact=1)), cell)
        for told, words in (
            (0.013, "where the cell asks for 20 N"),
            (20.0 / factor, f"is the cell's setpoint of 20 N in {unit}"),
        ):
            with pytest.raises(BadInput, match=words):
                refuse_force_unit(read(tmp_path, rows(fn_N=told, setpoint_N=told, contact=1)), cell)
        idle = [row | {"setpoint_N": 20.0 * (k > 0)} for k, row in enumerate(rows(fn_N=20.0 / factor, contact=1))]
        with pytest.raises(BadInput, match=f"as a force in {unit}"):
            refuse_force_unit(read(tmp_path, idle), cell)
    with pytest.raises(BadInput, match="is the cell's setpoint of 20 N in kilonewtons"):
        refuse_force_unit(read(tmp_path, rows(fn_N=0.02, setpoint_N=0.02, contact=1)), cell)
    for more, words in (({"setpoint_N": 0.02}, "fn_N is 1e.03 times"), ({"ft_N": 700.0}, "ft_N: 700 in contact")):
        with pytest.raises(BadInput, match=words):
            refuse_force_unit(read(tmp_path, rows(fn_N=20.0, contact=1, **more)), cell)


def test_a_unit_is_told_by_the_force_that_is_held(tmp_path):
    """Short lines are touch and lift for the most part, and there the force is any share of the setpoint."""
    cell = SimpleNamespace(flange=SimpleNamespace(setpoint=20.0), process=SimpleNamespace(force=20.0))
    feeds = [2.0, 4.0, 8.0, 12.0, 16.0, 24.0, *[40.0] * 7, 24.0, 16.0, 12.0, 8.0, 4.0, 2.0]
    held = [row | {"fn_N": 12.0 if row["feed_mm_s"] == 40.0 else 20.0 / 4.44822} for row in ramped(feeds)]
    refuse_force_unit(read(tmp_path, held), cell)
    with pytest.raises(BadInput, match="as a force in pounds-force"):
        refuse_force_unit(read(tmp_path, [row | {"fn_N": row["fn_N"] / 2.7} for row in held]), cell)


def test_files_that_are_no_table_are_refused(tmp_path):
    path = tmp_path / "force.csv"
    with pytest.raises(BadInput, match=r"force\.csv: cannot be read"):
        read_force_log(path)
    path.write_text("run;time_s\n1;2\n")
    with pytest.raises(BadInput, match="separate them by commas"):
        read_force_log(path)
    path.write_text(",".join([*NEEDED, "fn_N"]) + "\n")
    with pytest.raises(BadInput, match="holds no row"):
        read_force_log(path)
    path.write_text(",".join([*NEEDED, "fn_N"]) + "\n1,2,3\n")
    with pytest.raises(BadInput, match="line 2: 3 values where the header names 18 columns"):
        read_force_log(path)


def ramped(feeds, **columns):
    return [{**ROW, "time_s": 0.05 * k, "feed_mm_s": v, "contact": int(v > 0), **columns} for k, v in enumerate(feeds)]


def test_rows_of_touch_and_lift_are_left_out_and_told(tmp_path):
    """From either end until three quarters of the usual largest feed, and 0.08 s more; a pause inside a pass is a finding."""
    feeds = [0.0, 5.0, 20.0, 31.0, 40.0, 40.0, 40.0, 10.0, 40.0, 40.0, 40.0, 40.0, 28.0, 9.0, 0.0]
    kept = without_ramps(read(tmp_path, ramped(feeds)), True)
    assert [round(t / 0.05) for t in kept.time] == [0, 5, 6, 7, 8, 9, 14]
    assert kept.notices[-1].startswith("force.csv: 8 rows in which blade and wheel meet and part were left out")
    slow = read(tmp_path, ramped([5.0] * 8))  # as slow throughout, or already in full feed at its ends: nothing to leave out
    assert without_ramps(slow, True) is slow
    rigid = read(tmp_path, ramped(feeds))  # no flange that moves: what is pressed while the feed rises is pressed at rest too
    assert without_ramps(rigid, False) is rigid


def test_without_a_feed_the_points_tell_it(tmp_path):
    way = np.cumsum([0.0, 0.1, 0.4, 0.7, 1.6, 1.6, 1.6, 1.6, 1.6, 1.6, 1.6, 0.6, 0.1])
    table = [{**ROW, "time_s": 0.05 * k, "pz_mm": s} for k, s in enumerate(way)]
    assert [round(t / 0.05) for t in without_ramps(read(tmp_path, table), True).time] == [6, 7]
    still = [{**row, "time_s": 0.0} for row in table]
    assert len(without_ramps(read(tmp_path, still), True)) == len(still)


def test_a_log_of_nothing_but_touch_and_lift_is_refused(tmp_path):
    with pytest.raises(BadInput, match="column feed_mm_s: no run keeps its feed for longer than wheel and blade take"):
        without_ramps(read(tmp_path, ramped([5.0, 20.0, 40.0, 20.0, 5.0])), True)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1 / 60, "minutes"), (1 / 3600, "hours")])
def test_a_clock_in_another_unit_than_the_times_is_refused(tmp_path, factor, unit):
    def clocked(times, slow=1.0, gap=30.0):
        """Three recordings."""
        told = [rows(90, run=run, clock_s=gap * k) for k, run in enumerate("abc")]
        for k, row in enumerate(row for one in told for row in one):
            row |= {"time_s": slow * row["time_s"], "fn_N": 20.0 + 0.001 * k}
            row["clock_s"] += times * row["time_s"]
        return [row for one in told for row in one]

    with pytest.raises(BadInput, match=f"column clock_s: .* counts .* where time_s counts 0.89 s in this run: {unit}"):
        read(tmp_path, clocked(factor))
    with pytest.raises(BadInput, match=f"column time_s: .* where clock_s counts 0.89 s in this run: {unit}"):
        read(tmp_path, clocked(1.0 / factor, slow=factor))
    for times in (1.0, 0.5, 1.05):  # a wheel that stands for half of it, clocks that are not quite alike
        assert len(read(tmp_path, clocked(times))) == 270
    for second in (1.0, 60.0):  # clocks of whole seconds or minutes
        coarse = [row | {"clock_s": second * (row["clock_s"] // second)} for row in clocked(1.0, slow=3.0)]
        assert len(read(tmp_path, coarse)) == 270
    with pytest.raises(BadInput, match="counts 0.002 s from the first recording to the last, those before it take 17.8 s"):
        read(tmp_path, clocked(0.0, slow=10.0, gap=1e-3))


def test_recordings_are_known_again_by_how_they_begin(tmp_path):
    table = [row | {"run": run, "fn_N": 20.0 + k} for run in "abcdefghijkl" for k, row in enumerate(rows(30))]
    table = [row | {"fn_N": row["fn_N"] + 0.1 * ord(row["run"])} for row in table]
    mark = log_mark(read(tmp_path, table))
    assert len(mark.split()) == 11
    shorter = [row for k, row in enumerate(table) if k % 30 < 25]
    assert is_known(log_mark(read(tmp_path, shorter)), [mark]) and is_known(log_mark(read(tmp_path, table[240:])), ["", mark])
    for same in "abcdefghijkl":  # one recording may be the same by chance
        other = [row | {"fn_N": row["fn_N"] + 1e-2 * (row["run"] != same)} for row in table]
        assert not is_known(log_mark(read(tmp_path, other)), [mark])
    assert not is_known(log_mark(read(tmp_path, [row | {"fn_N": row["fn_N"] + 1e-2} for row in table])), [mark])


@pytest.mark.parametrize("runs", ["a", "abcde"])
def test_recordings_are_known_again_in_a_copy_with_rounded_numbers(tmp_path, runs):
    rng = np.random.default_rng(1)

    def noisy():
        return [row | {"run": run, "fn_N": 20.0 + rng.normal(0.0, 0.1)} for run in runs for row in rows(40)]

    table = noisy()
    mark = log_mark(read(tmp_path, table))
    for digits in (2, 3):
        rounded = [row | {k: round(x, digits) for k, x in row.items() if isinstance(x, float)} for row in table]
        assert is_known(log_mark(read(tmp_path, rounded)), ["", mark])
    assert not is_known(log_mark(read(tmp_path, noisy())), [mark])


def pressed(steps=0.0, top=np.inf, count=300):
    """Forces N about 20, as a sensor of these steps with this end of its range reads them; a ramp before."""
    fn = 20.0 + 0.3 * np.random.default_rng(3).normal(size=count)
    fn[:40] = np.linspace(1.0, 19.0, 40) + 0.01 * fn[:40]
    fn = np.round(np.round(fn / steps) * steps, 6) if steps else fn
    return [{**row, "fn_N": float(f), "contact": 1} for row, f in zip(rows(count), np.minimum(fn, top), strict=True)]


@pytest.mark.parametrize("steps", [0.0, 0.05])
@pytest.mark.parametrize("top", [19.5, 20.0, 20.3])
def test_a_sensor_at_the_end_of_its_range_is_refused(steps, top, tmp_path):
    """Its mean is too low, which would be taken for a wheel that wore."""
    log = read_force_log(write(tmp_path, pressed(steps, top)))
    first = next(k for k, row in enumerate(pressed(steps, top), 2) if row["fn_N"] == top)
    with pytest.raises(BadInput, match=rf"line {first}, column fn_N: \d+ of 300 rows in contact read {top:g} N, none more"):
        refuse_saturated(log)
    assert saturation(log)[0] == first


@pytest.mark.parametrize("steps", [0.0, 0.01, 0.1, 0.5, 1.0, 2.0])
def test_a_sensor_of_coarse_steps_is_not_one_at_its_end(steps, tmp_path):
    assert saturation(read_force_log(write(tmp_path, pressed(steps)))) is None
