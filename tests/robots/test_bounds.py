"""Work is bounded by what stands in a file: what would not end or not fit is refused with its number, before it begins."""

import io
import json
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.simulate.twin.krl_text import read_program
from ocp.simulate.twin.plan_knowledge import read_plan_table, read_summary
from robots.bounds import COLUMNS, are_radians, column_bounds, read_whole, refuse_outside
from robots.calibration.store import read_calibration
from robots.column_mapping import read_column_mapping
from robots.csv_table import read_csv_table
from robots.errors import BadInput, shown
from robots.robot import load_robot
from tests.support import blade_samples
from tests.support.hostile_inputs import READERS, lay, plan_table, stl_bytes
from trajectories.blade import Blade, find_shape
from trajectories.blade.stl import read_facets
from trajectories.krl.dialect import KRL
from trajectories.passes import PassOptions, passes


def cell(tmp_path: Path, old: str, new: str) -> Path:
    path = tmp_path / "cell.toml"
    text = CELL.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


TOML = {
    "nested": ("abc_deg = [0, 0, 0]", "abc_deg = " + "[" * 1000 + "]" * 1000, "more than 20 deep"),
    "nested a little": ("abc_deg = [0, 0, 0]", "abc_deg = " + "[" * 50 + "]" * 50, "more than 20 deep"),
    "digits": ("radius_mm = 40.0", "radius_mm = " + "9" * 4300, "wheel.radius_mm = 99999999999999999999999999999999999999..: "),
    "more digits": ("radius_mm = 40.0", "radius_mm = " + "9" * 5000, "not valid TOML"),
    "a long name": ("[wheel]", "[" + "a." * 200_000 + "wheel]", "a name of more than 20 parts"),
    "spacing": ("pass_spacing_mm = 6.0", "pass_spacing_mm = 1e-6", "pass_spacing_mm = 1e-06: input should be greater than"),
    "nan": ("friction = 0.35", "friction = nan", "not a finite number"),
    "nearly nothing": ("range_noise_um = 8.0", "range_noise_um = 1e-300", "must be 0 or at least 0.0001"),
    "a file's name": ('stl = "blade.stl"', f'stl = "{"x" * 300}"', "longer than a file's name may be"),
    "a terminal's orders": ('name = "bundled belt cell"', r'name = "\u001b[2J"', "cannot be printed"),
    "an effect": ("[wheel]", '[[effects]]\neffect = "sensor_bias"\nN = 1e300\n[wheel]', "N = 1e+300 is beyond 20000"),
}


@pytest.mark.parametrize("case", TOML)
def test_a_cell_beyond_bounds_is_refused(case, tmp_path):
    old, new, said = TOML[case]
    with pytest.raises(BadInput) as error:
        read_cell(cell(tmp_path, old, new))
    text = str(error.value).replace(str(tmp_path), "")
    assert said in text and len(text) < 250 and text.isprintable()


def test_lines_and_waypoints_are_counted_before_they_are_laid():
    blade = Blade("sample", "", *blade_samples.blade_mesh(60, 20))
    shape = find_shape(blade)
    tracemalloc.start()
    for asked, said in (({"spacing": 1e-9}, "lines on a width"), ({"step": 1e-9}, "waypoints on")):
        with pytest.raises(BadInput, match=said):
            passes(blade, shape, PassOptions(**asked))
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


def test_a_number_of_200_000_digits_does_not_widen_the_whole_mesh(tmp_path):
    path = tmp_path / "blade.stl"
    path.write_bytes(stl_bytes(False).replace(b"vertex 60", b"vertex " + b"1" * 200_000, 1))
    tracemalloc.start()
    with pytest.raises(BadInput, match="has more than 60 characters"):
        read_facets(path)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


def test_the_name_of_a_solid_may_be_long(tmp_path):
    path = tmp_path / "blade.stl"
    path.write_bytes(stl_bytes(False).replace(b"solid wedge", b"solid " + b"/home/a" * 40))
    assert len(read_facets(path)[0]) == 8


@pytest.mark.parametrize("content", ['{"inputs": 3}', '{"inputs": [3]}', "[]", "[" * 100_000, '{"a":' + "9" * 5000 + "}", '"x"'])
def test_a_summary_of_another_shape_is_refused(content, tmp_path):
    (tmp_path / "plan.json").write_text(content)
    with pytest.raises(BadInput, match="plan anew"):
        read_summary(tmp_path)


@pytest.mark.parametrize("name", ["../cell.toml", "**", "a\0b", "x" * 300, 3])
def test_a_summary_names_files_of_its_own_folder_alone(name, tmp_path):
    item = {"role": "cell", "name": name, "sha256": "ab" * 32}
    (tmp_path / "plan.json").write_text(json.dumps({"inputs": [item]}))
    if name == "**":  # a legal name of a file, not a pattern
        assert read_summary(tmp_path)["inputs"] == [item]
    else:
        with pytest.raises(BadInput, match="is no file's name"):
            read_summary(tmp_path)


def test_a_plan_over_years_is_not_laid_out_in_samples(tmp_path):
    (tmp_path / "plan.csv").write_bytes(plan_table().replace(b"\n1.18,", b"\n1e9,"))
    with pytest.raises(BadInput, match="reaches over 1e.09 s, the limit is 14400 s"):
        read_plan_table(tmp_path)


@pytest.mark.parametrize(
    ("column", "value"), [("px_mm", "1e300"), ("q1_deg", "-1e9"), ("sigma_um", "1e-300"), ("remark_N", "1e8")]
)
def test_a_number_outside_its_column_is_refused_with_the_reason(column, value, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"{column}\n0.5\n{value}\n")
    with pytest.raises(BadInput, match=rf"line 3, column {column}: {value} is not between .* \(.+\); correct it"):
        read_csv_table(path, (column,))


def test_digits_of_other_scripts_and_endless_ones_are_echoed_short(tmp_path):
    path = tmp_path / "a.csv"
    for value in ("１２", "1_0", "x" * 400):
        path.write_text(f"px_mm\n{value}\n")
        with pytest.raises(BadInput, match="is not a number") as error:
            read_csv_table(path, ("px_mm",))
        assert len(str(error.value)) - len(str(path)) < 120


def test_every_column_has_bounds_with_a_reason():
    for name in ("q1_deg", "nx", "qd1_deg_s", "tau1_Nm", "fn_N", "time_s", "anything"):
        least, most, reason = column_bounds(name)
        assert least < most and reason
    assert all(np.isfinite(bounds[:2]).all() for bounds in COLUMNS.values())


def test_a_device_or_a_file_that_is_too_large_is_not_read(tmp_path):
    with pytest.raises(BadInput, match="is a device or a pipe"):
        read_whole(Path("/dev/zero"), 10, "a file")
    large = tmp_path / "large"
    with large.open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(BadInput, match="has 1000000.0 MB, the limit is 5 MB"):
        read_whole(large, 5_000_000, "a file")
    for path in (tmp_path, tmp_path / "x\0y", tmp_path / ("x" * 5000)):
        with pytest.raises(BadInput, match="cannot be read"):
            read_whole(path, 10, "a file")


def test_an_archive_that_unpacks_to_more_than_it_may_is_not_unpacked(tmp_path):
    reader = next(r for r in READERS if r.kind == "calibration.npz")
    lay(reader, tmp_path)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("covariance.npy", bytes(100_000_000))
    (tmp_path / "calibration.npz").write_bytes(packed.getvalue())
    toml = tmp_path / "calibration.toml"
    toml.write_text("\n".join(line for line in toml.read_text().splitlines() if "sha256" not in line))
    tracemalloc.start()
    with pytest.raises(BadInput, match="100000000 bytes unpacked"):
        read_calibration(toml)
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()


@pytest.mark.parametrize("number", ["1E999", "1e300", "9" * 400, "-1E10"])
def test_a_number_beyond_a_controllers_is_refused_by_both_readers(number, tmp_path):
    reader = next(r for r in READERS if r.kind.startswith("old.src"))
    lay(reader, tmp_path)
    path = tmp_path / "OLD.src"
    path.write_bytes(path.read_bytes().replace(b"A5 10.0", b"A5 " + number.encode()))
    for read in (KRL.read, read_program):
        with pytest.raises(BadInput, match="line 11") as error:
            read(path)
        assert len(str(error.value).replace(str(tmp_path), "")) < 200


def test_braces_in_braces_end(tmp_path):
    path = tmp_path / "OLD.src"
    path.write_text("DEF OLD( )\nPTP " + "{A " * 2000 + "\nEND\n")
    with pytest.raises(BadInput, match="more than 5 deep"):
        KRL.read(path)


def test_what_is_shown_is_short_and_harmless():
    assert shown("a" * 41) == "a" * 38 + ".." and shown("a" * 40) == "a" * 40
    assert shown("\x1b[2J\n") == "?[2J?" and len(shown(10**5000)) <= 40


def test_a_robot_of_a_thousand_shapes_is_refused(tmp_path):
    path = tmp_path / "robot.toml"
    text = (Path(CELL).parents[2] / "robots" / "catalogue" / "ur5.toml").read_text()
    path.write_text(text + "\n[[shape]]\nlink = 1\nfrom_mm = [0, 0, 0]\nto_mm = [0, 0, 1]\nradius_mm = 1\n" * 1000)
    with pytest.raises(BadInput, match="remove what is too much"):
        load_robot(path)


def test_a_decimal_comma_in_a_list_is_told_as_one(tmp_path):
    """675,0 makes seven numbers of six; with the last taken away, as was asked for, the arm is another one."""
    text = (Path(CELL).parents[2] / "robots" / "catalogue" / "kr210_r2700_extra.toml").read_text()
    (tmp_path / "robot.toml").write_text(text.replace("675.0", "675,0"))
    with pytest.raises(BadInput, match="d_mm has 7 entries, expected 6; write decimals with a point, or remove"):
        load_robot(tmp_path / "robot.toml")


def test_a_signalling_nan_in_a_mesh_is_refused(tmp_path):
    data = bytearray(stl_bytes(True))
    data[84 + 12 : 84 + 16] = (0x7F800001).to_bytes(4, "little")
    (tmp_path / "blade.stl").write_bytes(data)
    with pytest.raises(BadInput, match="a vertex coordinate is nan"):
        read_facets(tmp_path / "blade.stl")


@pytest.mark.parametrize("form", ["%m%m", "%Y%q", "%", "%Y" + "x" * 100, "100%"])
def test_a_form_of_dates_that_reads_nothing_is_refused(form, tmp_path):
    path = tmp_path / "mapping.toml"
    path.write_text(f'time_s = {{ from = "stamp", unit = "{form}" }}\n')
    with pytest.raises(BadInput, match="is no unit of time_s") as error:
        read_column_mapping(path)
    assert len(str(error.value)) - len(str(path)) < 200


def test_a_load_with_an_empty_component_is_refused(tmp_path):
    reader = next(r for r in READERS if r.kind == "planned .src, virtual controller")
    lay(reader, tmp_path)
    for path in tmp_path.glob("*.src"):  # everywhere, else it is another load than the one before
        path.write_bytes(path.read_bytes().replace(b"J {X 0.0000,", b"J {X 0.0000,,"))
    with pytest.raises(BadInput, match="the inertia J of .LOAD is not X, Y, Z"):
        read_program(tmp_path, planned=True)


def test_an_option_at_either_end_is_inside():
    for value in (-60.0, 0.0, 60.0, None):
        refuse_outside(("--belt", value, -60.0, 60.0, "m/s"))
    for value in (-60.001, 60.001, float("nan")):
        with pytest.raises(BadInput, match="must lie between -60 and 60 m/s"):
            refuse_outside(("--belt", value, -60.0, 60.0, "m/s"))


TURNED = np.array([[-100.0, 40.0], [100.0, 120.0]])  # deg, of two axes


@pytest.mark.parametrize(
    ("angles", "others", "said"),
    [
        (np.radians([[-90.0, 50.0], [90.0, 110.0]]), TURNED, True),
        ([[-90.0, 50.0]], TURNED, False),
        ([[0.5, 7.0]], [[-100.0, 40.0], [100.0, 500.0]], False),  # more than a turn of radians
        ([[0.5, 0.1]], TURNED, False),  # 6 deg as radians: the second axis never was there
        ([[0.2, 0.3]], [[0.1, 0.2], [0.4, 0.9]], False),  # all that was measured is as near to zero
        (np.empty((0, 2)), TURNED, False),
        ([[0.5, 1.0]], np.empty((0, 2)), False),
    ],
)
def test_angles_in_radians_are_told_from_small_ones(angles, others, said):
    assert are_radians(np.asarray(angles), np.asarray(others)) is said
