"""`python -m ocp.plan` and bad input: exit code 2, one sentence, nothing written."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from ocp.data import BLADE
from robots.calibration.store import Calibration, write_calibration
from robots.errors import BadInput
from tests.support import blade_samples
from tests.support.small_plan import STEP, planned, refused, small_cell, tree
from trajectories.blade import read_blade

STL = BLADE.read_bytes()
RECORD = np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])


def facets(data: bytes = STL) -> np.ndarray:
    """Corners (n, 3, 3) in the file's unit."""
    return np.frombuffer(data, RECORD, offset=84)["v"].copy()


def stl(corners: np.ndarray) -> bytes:
    record = np.zeros(len(corners), RECORD)
    record["v"] = corners
    return b"sample".ljust(80) + np.uint32(len(corners)).tobytes() + record.tobytes()


def cube() -> bytes:
    x = np.array([[i, j, k] for i in (0, 60) for j in (0, 60) for k in (0, 60)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return stl(np.array([x[list(f)] for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]))


def with_hole() -> bytes:
    corners = facets()
    centres = corners.mean(axis=1)
    return stl(corners[np.linalg.norm(centres - centres[np.argmax(centres[:, 1])], axis=1) > 8.0])


def not_a_number() -> bytes:
    corners = facets()
    corners[100, 1, 2] = np.nan
    return stl(corners)


BLADES = {
    "empty": (b"", "empty"),
    "cut short": (STL[: len(STL) // 2 + 7], "facet"),
    "no facet": (STL[:80] + bytes(4), "no facet"),
    "some text": (b"Dear colleague,\nthe blade is attached.\n", "STL"),
    "a program": (b"DEF X()\nPTP {A1 0}\nEND\n", "STL"),
    "nan": (not_a_number(), "facet 101"),
    "an open surface": (with_hole(), "open"),
    "two bodies": (stl(np.concatenate([facets(), facets() + [300, 0, 0]])), "2 separate bodies"),
    "metres": (stl(facets() * 1e-3), 'stl_unit = "m"'),
    "inches": (stl(facets() / 25.4), 'stl_unit = "in"'),
    "a cube": (cube(), "blade.stl"),
}


def said_no(told, place: Path, before: dict[str, bytes], code: int = 2) -> str:
    """Exit code, one sentence without a trace, nothing on stdout, nothing written."""
    assert told.code == code, told
    text = told.err.strip()
    assert told.out == "" and text and "\n" not in text and "Traceback" not in text
    assert tree(place) == before and not list(place.glob(".*")) and not (place / "plan").exists()
    return text


@pytest.mark.parametrize("name", BLADES)
def test_a_blade_that_is_none_is_refused(tmp_path, monkeypatch, name):
    data, said = BLADES[name]
    cell = small_cell(tmp_path, blade=False)
    (tmp_path / "blade.stl").write_bytes(data)
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    text = said_no(refused("--cell", str(cell), *STEP), tmp_path, before)
    assert said in text and "blade.stl" in text


def test_faults_of_a_blade_that_can_be_mended_are_mended(tmp_path):
    whole = read_blade(BLADE)
    corners = facets()
    flat = np.concatenate([corners, np.repeat(corners[:3, :1], 3, axis=1)])
    for name, bad, said in (("inside", corners[:, ::-1], "inside-out"), ("flat", flat, "without area")):
        path = tmp_path / f"{name}.stl"
        path.write_bytes(stl(bad))
        blade = read_blade(path)
        assert any(said in notice for notice in blade.notices)
        np.testing.assert_allclose(volume(blade), volume(whole), rtol=1e-9)


def volume(blade) -> float:
    """Sum of the signed tetrahedra to the origin: positive where the facets look outward."""
    a, b, c = np.moveaxis(blade.vertices[blade.faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6)


def test_blades_of_the_data_folder(shared_data):
    twisted = read_blade(shared_data / "blades" / "twisted.stl")
    assert twisted.notices == ()
    mended = read_blade(shared_data / "blades" / "holes.stl")
    assert any("hole" in notice for notice in mended.notices)
    assert volume(mended) == pytest.approx(volume(twisted), rel=1e-5)
    with pytest.raises(BadInput) as refusal:
        read_blade(shared_data / "blades" / "self_intersecting.stl")
    assert "\n" not in str(refusal.value) and "self_intersecting.stl" in str(refusal.value)


MODEL = 'model = "kr210_r2700_extra"'
CELLS = {
    "an unknown key": ("radius_mm = 40.0", "radius_mm = 40.0\nspeed = 3", "wheel.speed"),
    "a missing key": ("width_mm = 15.0\n", "", "wheel.width_mm"),
    "a wrong type": ("width_mm = 15.0", 'width_mm = "wide"', "wheel.width_mm"),
    "a negative radius": ("radius_mm = 40.0", "radius_mm = -40.0", "-40"),
    "a number that is none": ("force_N = 20.0", "force_N = nan", "process.force_N"),
    "no force at all": ("force_N = 20.0", "force_N = 0.0", "process.force_N"),
    "an unknown robot": ("kr210_r2700_extra", "kr9000", "kr9000"),
    "an arm without a list of postures": ("kr210_r2700_extra", "ur10", "ocp.calibrate and ocp.diagnose alone"),
    "no TOML": ("[wheel]", "[wheel", "cell.toml"),
    "a clamp that holds nothing": ("clamp_to_mm = 10.0", "clamp_to_mm = -500.0", "nothing"),
    "a clamp that holds everything": ("clamp_to_mm = 10.0", "clamp_to_mm = 500.0", "the clamp"),
    "a blade that is not there": ('stl = "blade.stl"', 'stl = "shovel.stl"', "shovel.stl"),
    "no blade": ('stl = "blade.stl"\n', "", "no blade"),
    "two compensations": ("absolute_accuracy = false", "absolute_accuracy = true", "absolute_accuracy"),
    "poses under a ceiling": (f"{MODEL}\n", f"{MODEL}\ngravity_direction = [0.0, 0.0, 1.0]\n", "robot.gravity_direction says"),
    "poses on a wall": (f"{MODEL}\n", f"{MODEL}\ngravity_direction = [1.0, 0.0, 0.0]\n", "choose the axis program"),
}


@pytest.mark.parametrize("name", CELLS)
def test_a_faulty_cell_is_refused(tmp_path, monkeypatch, name):
    old, new, said = CELLS[name]
    cell = small_cell(tmp_path, {old: new})
    monkeypatch.chdir(tmp_path)
    kind = ["--kind", "cartesian"] if "compensations" in name or "poses" in name else []
    text = said_no(refused("--cell", str(cell), *STEP, *kind), tmp_path, tree(tmp_path))
    assert said in text


def test_a_calibration_of_another_robot_is_refused(tmp_path, monkeypatch):
    write_calibration(
        tmp_path / "calibration.toml", Calibration("kr210_r2700_prime", ("th1",), np.array([1e-4]), np.array([[1e-10]]))
    )
    old = 'model = "kr210_r2700_extra"'
    cell = small_cell(tmp_path, {old: f'{old}\ncalibration = "calibration.toml"'})
    monkeypatch.chdir(tmp_path)
    text = said_no(refused("--cell", str(cell), *STEP), tmp_path, tree(tmp_path))
    assert "kr210_r2700_prime" in text and "kr210_r2700_extra" in text


ARGUMENTS = {
    "a cell that is not there": (["--cell", "none.toml"], "none.toml"),
    "a folder as cell": (["--cell", "."], "."),
    "a blade that is not there": (["none.stl", "--cell", "cell.toml"], "none.stl"),
    "a folder as blade": (["empty", "--cell", "cell.toml"], "empty"),
    "an unknown kind": (["--cell", "cell.toml", "--kind", "circles"], "circles"),
    "a step of zero": (["--cell", "cell.toml", "--step", "0"], "step"),
    "a step backward": (["--cell", "cell.toml", "--step", "-1"], "step"),
    "a step that is no number": (["--cell", "cell.toml", "--step", "nan"], "step"),
    "a step below all sense": (["--cell", "cell.toml", "--step", "1e-9"], "0.05 and 5 mm"),
    "two sources of the path": (["--cell", "cell.toml", "--path", "a.csv", "--program", "b.src"], "--program"),
    "a path that is not there": (["--cell", "cell.toml", "--path", "none.csv"], "none.csv"),
    "a program that is not there": (["--cell", "cell.toml", "--program", "none.src"], "none.src"),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_faulty_arguments_are_refused(tmp_path, monkeypatch, name):
    arguments, said = ARGUMENTS[name]
    small_cell(tmp_path)
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    text = said_no(refused(*arguments), tmp_path, tree(tmp_path))
    assert said in text


def test_usage_errors_are_one_sentence_too(tmp_path):
    for told in (planned(tmp_path, "--step", "abc"), planned(tmp_path, "--bogus"), refused("a.stl", "b.stl")):
        assert told.code == 2 and told.err.count("\n") == 1 and told.err.startswith("refused: "), told


def test_the_blade_sample_of_the_tests_is_no_accident(tmp_path):
    """The facet helper of this file writes what the reader reads."""
    path = blade_samples.write_stl(tmp_path / "a.stl", *blade_samples.blade_mesh(60, 20))
    shutil.copy(path, tmp_path / "b.stl")
    (tmp_path / "b.stl").write_bytes(stl(facets(path.read_bytes())))
    np.testing.assert_array_equal(read_blade(path).faces, read_blade(tmp_path / "b.stl").faces)
