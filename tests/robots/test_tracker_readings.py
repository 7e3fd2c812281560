"""tracker.csv: columns in any order, absent ones told, malformed ones refused with line, column and value."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ocp.calibrate.tracker import as_in
from robots.errors import BadInput
from robots.tracker_readings import read_readings
from tests.support.simulated_campaign import INSTRUMENT, PAYLOADS

HEADER = "payload,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,target,x_mm,y_mm,z_mm"
ROW = "weight,10,-90,90,0,20,30,T2,1500,-20,900"


BARE = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm"
SIGNS = ",approach1,approach2,approach3,approach4,approach5,approach6"


def read(tmp_path, header=HEADER, *rows, instrument=INSTRUMENT, **options):
    file = tmp_path / "tracker.csv"
    file.write_text("\n".join([header, *(rows or (ROW,))]) + "\n")
    return read_readings(file, PAYLOADS, instrument, **options)


def test_units_words_and_notices(tmp_path):
    r = read(tmp_path, HEADER + ",operator,,", ROW + ",Ann,,", ROW.replace("T2", "T3").replace("weight", "bare") + ",Bob,,")
    assert np.degrees(r.q[0]) == pytest.approx([10, -90, 90, 0, 20, 30])
    assert r.point[0] == pytest.approx([1.5, -0.02, 0.9])
    assert [r.targets[k] for k in r.target] == ["T2", "T3"] and [r.payloads[k] for k in r.payload] == ["weight", "bare"]
    assert "tracker.csv: columns operator, (no name) were ignored" in r.notices
    assert any("backlash cannot be tested" in n for n in r.notices)
    assert list(r.line) == [2, 3] and r.turn is None and r.sigma is None and not r.load.any()


def test_what_was_waited_counts_from_the_last_reading_elsewhere(tmp_path):
    """In time, not in the file's order; more readings of one posture wait for one motion; thinning leaves what was waited."""
    times = {
        "40": ROW.replace(",10,", ",12,"),
        "5": ROW,
        "9": ROW.replace("T2", "T3"),
        "52": ROW,
        "47": ROW.replace(",10,", ",12,"),
    }
    rows = [f"{row.replace('1500', str(1500 + k))},{at}" for k, (at, row) in enumerate(times.items())]
    r = read(tmp_path, HEADER + ",time_s", *rows)
    np.testing.assert_allclose(r.waited, [31.0, 31.0, 31.0, 5.0, 38.0])  # before the first nobody knows: their median
    np.testing.assert_allclose(np.degrees(r.moved[:, 0]), [2.0, 0.0, 0.0, -2.0, 2.0], atol=1e-12)
    thinned = r.take(np.array([3, 4]))
    np.testing.assert_allclose(thinned.waited, [5.0, 38.0])
    np.testing.assert_allclose(np.degrees(thinned.moved[:, 0]), [-2.0, 2.0])
    assert read(tmp_path).waited is read(tmp_path).moved is None


def test_a_clock_that_begins_anew_in_a_session_is_told(tmp_path):
    rows = [
        f"{ROW.replace('1500', str(1500 + k))},{at},{day}" for k, (at, day) in enumerate(zip([5, 9, 2, 7], "aabb", strict=True))
    ]
    clock = HEADER + ",time_s,session"
    assert not any("goes back" in n for n in read(tmp_path, clock, *rows).notices)
    one = [row[:-1] + "a" for row in rows]
    told = [n for n in read(tmp_path, clock, *one).notices if "goes back" in n]
    assert len(told) == 1 and told[0].startswith("tracker.csv, line 4: time_s goes back from 9 to 2 s")
    many = [f"{ROW.replace('1500', str(1500 + k))},{k % 2},a" for k in range(20)]  # sorted by something else
    assert not any("goes back" in n for n in read(tmp_path, clock, *many).notices)


def test_another_side_is_another_motion_and_another_session_another_clock(tmp_path):
    up, down = (f",{','.join(6 * [sign])}" for sign in ("1", "-1"))
    rows = [(up, 0, "a"), (down, 50, "a"), (up, 80, "a"), (up, 1, "b"), (down, 61, "b")]
    r = read(
        tmp_path, HEADER + SIGNS + ",time_s,session", *[f"{ROW.replace('1500', str(1500 + t))}{s},{t},{k}" for s, t, k in rows]
    )
    np.testing.assert_allclose(r.waited, [50.0, 50.0, 30.0, 50.0, 60.0])
    np.testing.assert_array_equal(r.moved, 0.0)  # nor does an axis move from the end of one session to the start of the next


def test_readings_that_were_sealed_or_saw_nothing_were_waited_for(tmp_path):
    """What is left out of a campaign, or was taken between its readings, moved the arm all the same."""
    axes = [ROW.replace(",10,", f",{10 + k},") for k in range(5)]
    blind = axes[1].replace("1500,-20,900", ",,")
    r = read(tmp_path, HEADER + ",time_s", f"{axes[0]},0", f"{blind},40", f"{axes[2]},60", f"{axes[4]},190")
    np.testing.assert_allclose(r.waited, [40.0, 20.0, 130.0])
    assert read(tmp_path, HEADER + ",time_s", f"{axes[3]},100").waited == np.inf
    sealed = as_in(read(tmp_path, HEADER + ",time_s", f"{axes[3]},100"), r)
    np.testing.assert_allclose(sealed.waited, [40.0])
    np.testing.assert_allclose(np.degrees(sealed.moved[:, 0]), [1.0])
    assert as_in(read(tmp_path), r).waited is None
    signed = read(tmp_path, HEADER + SIGNS + ",time_s", *[f"{axes[k]},1,1,1,1,1,1,{60 * k}" for k in (0, 2)])
    unsigned = as_in(read(tmp_path, HEADER + ",time_s", f"{axes[1]},70"), signed)
    np.testing.assert_allclose(unsigned.waited, [70.0])  # of rows whose signs nobody tells, axes alone tell motions apart


def test_columns_that_sealed_conditions_lack_are_told(tmp_path):
    """Nothing hanging where the readings had a weight, they would be predicted millimetres off."""
    r = read(tmp_path, HEADER + SIGNS + ",temperature_C", ROW + ",1,1,1,1,1,1,20")
    payload, rest = as_in(read(tmp_path, "target," + BARE, "T2,0,-90,90,0,20,30,1,2,3"), r).notices
    assert payload == "tracker.csv: no column payload: 'bare' is taken to hang on the flange throughout"
    assert "without approach1 .. approach6, temperature_C, which tracker.csv has" in rest
    assert as_in(r, r).notices == ()


def test_absent_words_mean_the_first(tmp_path):
    r = read(tmp_path, BARE, "0,-90,90,0,20,30,1,2,3")
    assert r.payloads[r.payload[0]] == "bare" and r.stations == r.sessions == ("",)


def test_orientation_is_rz_ry_rx(tmp_path):
    r = read(tmp_path, HEADER + ",rx_deg,ry_deg,rz_deg", ROW + ",10,20,30")
    c, s = np.cos(np.radians([10, 20, 30])), np.sin(np.radians([10, 20, 30]))
    Rx = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    Ry = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    Rz = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    assert r.turn[0] == pytest.approx(Rz @ Ry @ Rx)


def test_repeats_are_the_same_posture_nest_payload_load_and_approach(tmp_path):
    header = HEADER + SIGNS
    up, down = ",1,1,1,1,1,1", ",1,1,1,1,1,-1"
    near, far = ROW.replace(",10,", ",10.00002,"), ROW.replace(",10,", ",10.01,")
    r = read(tmp_path, header, ROW + up, near + up, far + up, ROW + down, ROW.replace("T2", "T1") + up)
    g = r.repeats()
    assert g[0] == g[1] and len(set(g[1:])) == 4


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        (HEADER.replace(",z_mm", ""), ROW.rsplit(",", 1)[0], "column z_mm missing"),
        (HEADER, ROW.replace("900", "nine"), "line 2, column z_mm: 'nine' is not a number"),
        (HEADER, ROW.replace("900", "nan"), "line 2, column z_mm: 'nan' is not a finite number"),
        (HEADER, ROW.replace("T2", "T9"), "column target: T9 is not in the cell's"),
        (HEADER, ROW.replace("weight", "anvil"), "column payload: anvil is not in the cell's"),
        (HEADER, ROW.replace("weight", ""), "column payload: (empty) is not in the cell's"),
        (HEADER, ROW + ",1", "12 values where the header names 11 columns"),
        (HEADER.replace(",", ";"), ROW.replace(",", ";"), "separate them by commas"),
        (HEADER + ",sigma_um", ROW + ",-3", "column sigma_um: -3 is not between"),
        (HEADER + SIGNS, ROW + ",1,1,2,1,1,1", "approach3: 2 must be -1, 0 or 1"),
        (HEADER + ",load_link", ROW + ",7", "load_link: 7 must be a link"),
        (HEADER + ",x_mm", ROW + ",1", "x_mm stands there twice"),
        (HEADER, ROW.replace("1500,-20,900", "0,0,0"), "line 2: the reading is 0, 0, 0"),
    ],
)
def test_malformed_files_are_refused_with_the_place(tmp_path, header, row, said):
    with pytest.raises(BadInput, match="tracker.csv") as error:
        read(tmp_path, header, row)
    assert said in str(error.value)


@pytest.mark.parametrize("content", [b"", b"\n\n", HEADER.encode(), b"\xff\xfe\x00q1"])
def test_empty_files_and_foreign_bytes_are_refused(tmp_path, content):
    (tmp_path / "tracker.csv").write_bytes(content)
    with pytest.raises(BadInput, match="tracker.csv"):
        read_readings(tmp_path / "tracker.csv", PAYLOADS, INSTRUMENT)


def test_sealed_files_need_no_points(tmp_path):
    header, row = HEADER.removesuffix(",x_mm,y_mm,z_mm"), ROW.removesuffix(",1500,-20,900")
    assert np.isnan(read(tmp_path, header, row, sealed=True).point).all()
    with pytest.raises(BadInput, match="x_mm, y_mm, z_mm missing"):
        read(tmp_path, header, row)


def test_gaps_are_passed_over_and_half_points_refused(tmp_path):
    gap = ROW.replace("1500,-20,900", ",,")
    r = read(tmp_path, HEADER, ROW, gap, ROW.replace("1500", "1501"))
    assert list(r.line) == [2, 4] and any("1 rows without a point" in n for n in r.notices)
    with pytest.raises(BadInput, match="line 3, column y_mm: the cell is empty"):
        read(tmp_path, HEADER, ROW, ROW.replace("-20", ""))
    with pytest.raises(BadInput, match="no row has a point"):
        read(tmp_path, HEADER, gap)
    with pytest.raises(BadInput, match="column q1_deg: the cell is empty"):
        read(tmp_path, HEADER, ROW.replace("weight,10,", "weight,,"))


def test_a_part_of_an_orientation_is_refused(tmp_path):
    with pytest.raises(BadInput, match="line 3, column ry_deg: the cell is empty; fill in the whole turn"):
        read(tmp_path, HEADER + ",rx_deg,ry_deg,rz_deg", ROW + ",10,20,30", ROW + ",10,,30")


def test_rows_without_an_orientation_are_points(tmp_path):
    r = read(tmp_path, HEADER + ",rx_deg,ry_deg,rz_deg,sigma_rot_deg", ROW + ",10,20,30,0.01", ROW + ",,,,")
    assert np.isfinite(r.turn[0]).all() and np.isnan(r.turn[1]).all()
    part = read(tmp_path, HEADER + ",rx_deg,ry_deg", ROW + ",10,20")
    assert part.turn is None and any("only rx_deg, ry_deg are given" in n for n in part.notices)


def test_without_a_target_column_the_nest_is_unknown_and_the_payload_is_told(tmp_path):
    r = read(tmp_path, BARE, "0,-90,90,0,20,30,1,2,3")
    assert r.targets == ("",) and any("'bare' is taken to hang" in n for n in r.notices)


def test_orientations_come_as_quaternions_too(tmp_path):
    quaternion = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True).as_quat(scalar_first=True)
    row = ",".join(f"{v:.9f}" for v in quaternion)
    r = read(tmp_path, HEADER + ",qw,qx,qy,qz", ROW + "," + row, ROW.replace("1500", "1400") + ",,,,")
    angles = read(tmp_path, HEADER + ",rx_deg,ry_deg,rz_deg", ROW + ",10,20,30")
    assert r.turn[0] == pytest.approx(angles.turn[0], abs=1e-8) and list(r.turned) == [True, False]
    with pytest.raises(BadInput, match="line 2, column qw: 2 .* length 2, not 1"):
        read(tmp_path, HEADER + ",qw,qx,qy,qz", ROW + ",2,0,0,0")
    with pytest.raises(BadInput, match="remove one"):
        read(tmp_path, HEADER + ",qw,qx,qy,qz,rx_deg,ry_deg,rz_deg", ROW + ",1,0,0,0,0,0,0")


def test_the_cell_states_the_order_of_turns(tmp_path):
    stated = replace(INSTRUMENT, rotation="xyz_intrinsic")
    turn = read(tmp_path, HEADER + ",rx_deg,ry_deg,rz_deg", ROW + ",10,20,30", instrument=stated).turn[0]
    assert turn == pytest.approx(Rotation.from_euler("XYZ", [10, 20, 30], degrees=True).as_matrix())


def test_a_seventh_axis_is_refused(tmp_path):
    with pytest.raises(BadInput, match="q7_deg: an arm of seven axes"):
        read(tmp_path, HEADER + ",q7_deg", ROW + ",0")


FINE = [ROW.replace("1500", f"{1400 + k}.{k}23") for k in range(8)]


@pytest.mark.parametrize(
    ("added", "rest", "told"),
    [
        ("", ("",) * 3, r"line 10 repeats line 2 .*, as 3 of 18 rows .*\(line 11 repeats line 3, line 12 repeats line 4\)"),
        (
            ",time_s",
            (",100", ",200", ",300"),
            "as 3 of 18 rows",
        ),  # pasted with other times: no tracker reads the same digits again
        (SIGNS, (",0,0,0,0,0,0",) * 3, "as 3 of 18 rows"),  # as a mapping of steps has it where a row stands twice
    ],
)
def test_a_few_copies_are_used_once_and_told(tmp_path, added, rest, told):
    own = ",1,1,1,1,1,1" if added == SIGNS else ",{k}" if added else ""
    whole = [row + own.format(k=k) for k, row in enumerate(FINE)]
    more = [ROW.replace("1500", f"{1300 + k}.{k}51") + own.format(k=50 + k) for k in range(7)]
    r = read(tmp_path, HEADER + added, *whole, *(row + end for row, end in zip(FINE, rest, strict=False)), *more)
    assert len(r) == 15 and list(r.line) == [*range(2, 10), *range(13, 20)]
    assert any(re.search(told, n) and "each is used once" in n for n in r.notices), r.notices


def test_many_copies_are_refused_and_repeats_are_none(tmp_path):
    with pytest.raises(
        BadInput, match="line 10 repeats line 2 in axes and point to the last digit, as 8 of 16 rows.*remove the copies$"
    ):
        read(tmp_path, HEADER, *FINE, *FINE)
    anew = [row.replace("23,", "24,") for row in FINE]  # 1 um further: measured anew
    assert len(read(tmp_path, HEADER, *FINE, *anew)) == 16


def test_digits_coarser_than_the_noise_make_repeats_equal_and_only_times_tell(tmp_path):
    coarse = [ROW.replace("1500", f"{1400 + k}.{k}") for k in range(8)]
    with pytest.raises(BadInput, match=r"8 of 16 rows.*steps of 0\.1 mm: if poses were measured anew, add the column time_s"):
        read(tmp_path, HEADER, *coarse, *coarse)
    timed = [f"{row},{k}" for k, row in enumerate(coarse)]
    again = [f"{row},{100 + k}" for k, row in enumerate(coarse)]
    r = read(tmp_path, HEADER + ",time_s", *timed, *again)
    assert len(r) == 16 and not any("repeats" in n for n in r.notices)
    with pytest.raises(BadInput, match="8 of 16 rows repeat another; remove the copies$"):
        read(tmp_path, HEADER + ",time_s", *timed, *timed)
    poor = replace(
        INSTRUMENT, range_noise=1e-3
    )  # which reads the same 0.1 mm in all coordinates less than once in a thousand times
    with pytest.raises(BadInput, match="8 of 16 rows repeat another; remove the copies$"):
        read(tmp_path, HEADER + ",time_s", *timed, *again, instrument=poor)


@pytest.mark.parametrize(
    ("other", "told"),
    [(("T2", "T1"), "column target: T1 but line 2.* has T2"), (("weight", "bare"), "column payload: bare but line 2")],
)
def test_a_copy_that_tells_another_nest_or_load_is_refused(tmp_path, other, told):
    with pytest.raises(BadInput, match="line 10, " + told):
        read(tmp_path, HEADER, *FINE, FINE[0].replace(*other))


def test_a_temperature_in_kelvin_is_refused(tmp_path):
    """Growth from the cell's reference temperature would be 273 K too much, in all readings alike."""
    warm = read(tmp_path, HEADER + ",temperature_C", ROW + ",61")
    assert warm.temperature == [61.0] and "if these are degrees Fahrenheit" in " ".join(warm.notices)
    assert "Fahrenheit" not in " ".join(read(tmp_path, HEADER + ",temperature_C", ROW + ",31").notices)
    with pytest.raises(BadInput, match=r"tracker\.csv, line 3, column temperature_C: 295.3 .* kelvin"):
        read(tmp_path, HEADER + ",temperature_C", ROW + ",22", ROW.replace("1500", "1501") + ",295.3")


def test_milliseconds_in_place_of_seconds_are_told(tmp_path):
    rows = [ROW.replace("10", f"{10 + k}", 1) for k in range(5)]
    for unit, told in ((1.0, False), (1e3, True)):
        timed = "\n".join(f"{row},{unit * 21.0 * k * k}" for k, row in [*enumerate(rows)][::-1])
        assert ("milliseconds" in " ".join(read(tmp_path, HEADER + ",time_s", timed).notices)) == told
