"""Tables made by others: columns, units, signs, zeros, separators, decimal commas, orders of rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robots.column_mapping import read_column_mapping
from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import ROTATION_ORDERS, rot_x, rot_y, rot_z, rotation_from_abc, rotations_in_order
from robots.tracker_readings import Instrument, read_readings

AXES = "".join(f'q{i}_deg = {{ from = "j{i}", unit = "rad" }}\n' for i in range(1, 7))
MAPPING = f"""separator = ";"
decimal = ","
rotation = "xyz_intrinsic"
{AXES.replace('"j2", unit = "rad"', '"j2", unit = "rad", sign = -1, offset = 90.0')}
x_mm = {{ from = ["goal", "error"], unit = "m", sign = [1, -1] }}
y_mm = {{ from = "py", unit = "in" }}
z_mm = {{ from = "pz" }}
target = {{ from = "Reflektor" }}
temperature_C = {{ from = "T", unit = "K" }}
time_s = {{ from = "Zeit", unit = "%Y%m%d%H%M%S" }}
approach1 = {{ from = "j1", unit = "step_rad" }}
sigma_um = {{ from = [], offset = 30 }}
rx_deg = {{ from = "a" }}
ry_deg = {{ from = "b" }}
rz_deg = {{ from = "c" }}
"""
HEAD = "Zeit;j1;j2;j3;j4;j5;j6;goal;error;py;pz;Reflektor;T;a;b;c;note"
ROWS = (
    "20200714235959;0,1;0,2;0,3;0;0;-1,5e0;1,25;0,25;2;3,5;SMR;295,15;10;20;30;x",
    "20200715000001;0,2;0,2;0,3;0;0;-1,5e0;1,25;0,25;2;3,5;SMR;295,15;10;20;30;x",
)


def readings(folder, mapping=MAPPING, head=HEAD, rows=ROWS):
    (folder / "m.toml").write_text(mapping)
    (folder / "t.csv").write_text("\n".join([head, *rows]) + "\n")
    return read_readings(folder / "t.csv", {}, Instrument(), mapping=read_column_mapping(folder / "m.toml"))


def test_a_table_made_by_others_is_read_as_ours(tmp_path):
    r = readings(tmp_path)
    assert np.allclose(r.q[0], [0.1, np.pi / 2 - 0.2, 0.3, 0, 0, -1.5])
    assert np.allclose(r.point[0], [1.0, 2 * 0.0254, 0.0035])
    assert r.targets == ("SMR",) and np.allclose(r.temperature, 22.0) and list(r.time) == [0.0, 2.0]
    assert np.allclose(r.sigma, 30e-6)
    a, b, c = np.radians([10, 20, 30])
    assert np.allclose(r.turn[0], rot_x(a) @ rot_y(b) @ rot_z(c))


@pytest.mark.parametrize("step", ['from = "q1_deg", unit = "step_deg"', 'from = ["q1_deg"], unit = "step_deg", sign = 1'])
def test_a_step_of_a_column_of_ours_has_its_sign_too(tmp_path, step):
    (tmp_path / "c.toml").write_text(f"q1_deg = {{ sign = -1 }}\napproach1 = {{ {step} }}\n")
    with pytest.raises(BadInput, match=r"approach1 is of the columns of q1_deg, but not in its unit \(deg\) and sign \(-1\)"):
        read_column_mapping(tmp_path / "c.toml")
    (tmp_path / "c.toml").write_text('q1_deg = { unit = "rad" }\napproach1 = { unit = "step_deg" }\n')
    assert len(read_column_mapping(tmp_path / "c.toml").columns) == 2


def test_the_sign_of_a_step_is_that_of_the_last_motion(tmp_path):
    more = "".join(f'approach{k} = {{ from = "j{k}", unit = "step_rad", sign = {-1 if k == 2 else 1} }}\n' for k in range(2, 7))
    signs = readings(tmp_path, MAPPING + more).approach
    assert signs.tolist() == [[0] * 6, [1, 0, 0, 0, 0, 0]]


@pytest.mark.parametrize("order", ROTATION_ORDERS)
def test_every_order_turns_about_its_letters(order):
    angles = np.array([0.3, -0.5, 0.8])
    letters, kind = order.split("_")
    about = {"x": rot_x, "y": rot_y, "z": rot_z}
    values = [angles["xyz".index(c)] for c in letters] if len({*letters}) == 3 else angles
    turns = [about[c](v) for c, v in zip(letters, values, strict=True)]
    first, second, third = turns if kind == "intrinsic" else turns[::-1]
    assert np.allclose(rotations_in_order(angles, order), first @ second @ third)


def test_the_default_order_is_that_of_the_contract():
    angles = np.array([[0.1, 0.2, 0.3]])
    assert np.allclose(rotations_in_order(angles, "zyx_intrinsic"), rotation_from_abc(angles[:, ::-1]))
    assert np.allclose(rotations_in_order(angles, "zyx_intrinsic"), Rotation.from_euler("xyz", angles).as_matrix())


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('unit = "in"', 'unit = "rad"', "y_mm.unit = 'rad' is no unit of y_mm; give one of mm, m, cm, um, in"),
        ("sign = [1, -1]", "sign = [1]", None),
        ("sign = [1, -1]", "sign = [1, -1, 1]", "x_mm.sign has 3 signs for 2 columns"),
        ("sign = -1", "sign = -2", "sign must be 1 or -1"),
        ('"step_rad"', '"step_deg"', r"approach1 is of the columns of q1_deg, but not in its unit \(rad\) and sign \(1\)"),
        ('"step_rad"', '"step_rad", sign = -1', "a motion has those of its axis: correct approach1"),
        ('decimal = ","', 'decimal = ";"', "decimal = ';' must be a point or a comma"),
        ('separator = ";"', 'separator = "#"', "separator = '#' is none of"),
        ('separator = ";"', "", "decimal = ',' must be a point or a comma, another sign than separator"),
        ('"xyz_intrinsic"', '"xyz"', "rotation = 'xyz' is none of xyz_intrinsic"),
        ("sigma_um =", "sigma_mu =", r"\[sigma_mu\] is no column"),
        ("sigma_um = {", "sigma_um = { form = 1,", "form.*is no key of a mapping; known here: from, unit, sign, offset"),
        ('from = "pz"', 'from = "p_z"', "column z_mm missing"),
        ('"error"]', '"err"]', "column err is missing, which .*m.toml makes x_mm of"),
        ('"%Y%m%d%H%M%S" }', '"%Y%m%d%H%M%S", offset = 5 }', "time_s is of dates, which have no sign and no offset"),
        ("%Y%m%d%H%M%S", "%Y-%m-%d", "line 2, column Zeit: '20200714235959' is no time of the form"),
        ('from = "py"', 'from = "note"', "column note: 'x' is not a number"),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused(tmp_path, old, new, said):
    assert old in MAPPING
    if said is None:
        readings(tmp_path, MAPPING.replace(old, new))
    else:
        with pytest.raises(BadInput, match=said):
            readings(tmp_path, MAPPING.replace(old, new))


@pytest.mark.parametrize("key", ["sign = -1", "offset = 5"])
def test_words_have_no_sign_and_no_offset(tmp_path, key):
    """They would have been left out without a word."""
    (tmp_path / "m.toml").write_text(f'payload = {{ from = "load", {key} }}\n')
    with pytest.raises(BadInput, match="payload is of words, which have no sign and no offset; leave these keys out"):
        read_column_mapping(tmp_path / "m.toml")


def test_a_file_of_ours_beside_theirs_keeps_its_columns(tmp_path):
    (tmp_path / "m.toml").write_text('q1_deg = { from = "j1", unit = "rad" }\nrun = { from = "pass" }\n')
    (tmp_path / "t.csv").write_text("run,q1_deg\nA,90\n")
    mapping = read_column_mapping(tmp_path / "m.toml")
    table = read_csv_table(tmp_path / "t.csv", ("run", "q1_deg"), words=("run",), mapping=mapping)
    assert list(table.numbers["q1_deg"]) == [90.0] and table.words["run"] == ["A"] and not table.ignored


def test_a_point_between_thousands_is_no_decimal_sign(tmp_path):
    with pytest.raises(BadInput, match=r"line 3, column pz: '3.500' has a point where .*m.toml says decimal = ','; take"):
        readings(tmp_path, rows=[ROWS[0], ROWS[1].replace(";3,5;", ";3.500;")])


def test_speeds_may_be_told_by_the_minute_and_a_belt_of_metres_a_minute_is_no_belt(tmp_path):
    units = {"belt_m_s": "m/min", "feed_mm_s": "m/min", "qd1_deg_s": "rev/min", "qd2_deg_s": "rpm"}
    (tmp_path / "m.toml").write_text(
        "".join(f'{name} = {{ from = "{name}", unit = "{unit}" }}\n' for name, unit in units.items())
    )
    (tmp_path / "t.csv").write_text(",".join(units) + "\n1200,2.4,2,2\n")
    table = read_csv_table(tmp_path / "t.csv", tuple(units), mapping=read_column_mapping(tmp_path / "m.toml"))
    assert [round(float(table.numbers[name][0]), 9) for name in units] == [20.0, 40.0, 12.0, 12.0]
    with pytest.raises(BadInput, match="line 2, column belt_m_s: 1200.* is not between -300 and 300"):
        read_csv_table(tmp_path / "t.csv", tuple(units))


def test_separators_are_told_where_the_mapping_lacks_them(tmp_path):
    (tmp_path / "m.toml").write_text(AXES)
    (tmp_path / "t.csv").write_text("a;b\n1;2\n")
    with pytest.raises(BadInput, match=r"separated by semicolons; say so in .*m\.toml"):
        read_csv_table(tmp_path / "t.csv", ("a",), mapping=read_column_mapping(tmp_path / "m.toml"))


def test_dates_of_two_files_have_one_clock_and_times_of_day_end_at_midnight(tmp_path):
    (tmp_path / "m.toml").write_text(MAPPING)
    mapping, heads = read_column_mapping(tmp_path / "m.toml"), []
    later = [row.replace("20200715000001", "20200715003001") for row in ROWS[1:]]
    for rows, sealed in ((ROWS, False), (later, True), (later, False), (later, True)):
        (tmp_path / "t.csv").write_text("\n".join([HEAD, *rows]) + "\n")
        heads.append(float(read_readings(tmp_path / "t.csv", {}, Instrument(), sealed, mapping).time[0]))
    assert heads == [0.0, 1802.0, 0.0, 0.0]  # another campaign has its own
    days = MAPPING.replace("%Y%m%d%H%M%S", "%H:%M:%S")
    times = [row.replace("20200714235959", "23:59:59").replace("20200715000001", "00:00:01") for row in ROWS]
    with pytest.raises(BadInput, match="line 3, column time_s: a time of the form %H:%M:%S that is earlier by 24 h"):
        readings(tmp_path, days, rows=times)
    assert list(readings(tmp_path, days, rows=times[1:] + times[:1]).time) == [0.0, 86398.0]
    unsorted = [times[0].replace("23:59:59", "10:30:00"), times[1].replace("00:00:01", "10:29:40")]
    assert list(readings(tmp_path, days, rows=unsorted).time) == [0.0, -20.0]
    with pytest.raises(BadInput, match="earlier by 9.6 h"):
        readings(tmp_path, days, rows=[times[0].replace("23:59:59", "17:10:00"), times[1].replace("00:00:01", "07:34:00")])


def test_a_row_that_begins_with_a_cross_is_a_note_or_refused(tmp_path):
    def read(text, words):
        (tmp_path / "t.csv").write_text(text)
        return read_csv_table(tmp_path / "t.csv", ("q1_deg",), ("target",), words)

    table = read("# ours\ntarget,q1_deg\nA,5\n# a note\n# padded,\nB,6\n", ("target",))
    assert table.words["target"] == ["A", "B"] and table.line == [3, 6]
    with pytest.raises(BadInput, match="line 3, column target: '#1' begins with #, and the row has a value for every column"):
        read("target,q1_deg\nA,5\n#1,6\n", ("target",))
    assert list(read("q1_deg,target\n#5,a\n6,b\n", ("target",)).numbers["q1_deg"]) == [6.0]


def test_a_table_that_no_file_has_columns_for_is_refused(tmp_path):
    lines = ("q1_deg = { from = 'j1' }", "q2_deg = {}", "fn_N = { from = 'F' }", "payload = { from = 'Lsat' }")
    (tmp_path / "m.toml").write_text("\n".join(lines) + "\n")
    mapping = read_column_mapping(tmp_path / "m.toml")
    (tmp_path / "t.csv").write_text("j1,q2_deg,Last\n1,2,weight\n")
    (tmp_path / "f.csv").write_text("q1_deg,Lsat\n1,weight\n")
    read_csv_table(tmp_path / "t.csv", ("q1_deg", "q2_deg"), ("payload",), ("payload",), mapping=mapping)
    with pytest.raises(BadInput, match="payload is made of Lsat, which no table read here has; correct from"):
        mapping.refuse_idle()  # fn_N is of a table that was not read
    read_csv_table(tmp_path / "f.csv", ("q1_deg",), ("payload",), ("payload",), mapping=mapping)
    mapping.refuse_idle()
    ours, mapping = tmp_path / "ours.csv", read_column_mapping(tmp_path / "m.toml")
    ours.write_text("q1_deg,q2_deg,payload\n1,2,weight\n")
    read_csv_table(ours, ("q1_deg", "q2_deg"), ("payload",), ("payload",), mapping=mapping)
    mapping.refuse_idle()  # a table that has our names already
