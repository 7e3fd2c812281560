"""A calibration survives the disk to the last bit, and every damaged one is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.calibration.parameters import COMPLIANCE_NAMES, MDH_NAMES, SYMBOLS
from robots.calibration.store import Calibration, read_calibration, write_calibration
from robots.errors import BadInput
from robots.robot import load_robot

EXTRA = load_robot("kr210_r2700_extra")


def example(names=("a1", "th2", "c2", "c3", "wheel_x"), seed=0, **changes):
    rng = np.random.default_rng(seed)
    m = len(names)
    factor = rng.normal(size=(m, m)) * 10.0 ** rng.uniform(-8, 0, (m, 1))
    fields = {
        "robot": EXTRA.name,
        "names": tuple(names),
        "values": rng.normal(size=m),
        "covariance": factor @ factor.T,
        "provenance": {
            "residual_rms_mm": 0.0312,
            "rows": 150,
            "data_sha256": "ab" * 32,
            "outliers": [3, 17],
            "conditions": {"payloads": ["bare", "grinder"], "temperature_C": 22.5, "note": 'he said "ok"\n'},
        },
        "not_identified": {"th1": "hidden in the base frame", "d2 d3": "one direction"},
    }
    return Calibration(**(fields | changes))


def test_what_is_written_is_read_to_the_last_bit(tmp_path):
    before = example()
    write_calibration(tmp_path / "calibration.toml", before)
    after = read_calibration(tmp_path / "calibration.toml")
    assert after.robot == before.robot
    assert after.names == before.names
    assert np.array_equal(after.values, before.values)
    assert np.array_equal(after.covariance, before.covariance)
    assert after.provenance == before.provenance
    assert after.not_identified == before.not_identified
    assert after.units == ("m", "rad", "rad/(N m)", "rad/(N m)", "m")
    assert after.notices == ()


@pytest.mark.parametrize(
    ("noise", "told"), [({"joints_rad": 7e-6}, 7e-6), ({"joints_rad": 0.0}, None), ({"joints_rad": "low"}, None), (3.0, None)]
)
def test_the_noise_of_the_joints_is_told_or_not(noise, told):
    assert example(provenance={"noise": noise}).joint_noise == told
    assert example(provenance={}).joint_noise is None


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.sampled_from(sorted(SYMBOLS)), min_size=1, max_size=12, unique=True),
    st.integers(0, 1000),
    st.dictionaries(st.text(max_size=8), st.text(max_size=20) | st.floats(allow_nan=False) | st.booleans(), max_size=4),
)
def test_any_names_and_any_provenance_survive(tmp_path_factory, names, seed, provenance):
    before = example(names, seed, provenance=provenance, not_identified={})
    path = tmp_path_factory.mktemp("store") / "c.toml"
    write_calibration(path, before)
    after = read_calibration(path)
    assert (after.names, after.provenance) == (before.names, before.provenance)
    assert np.array_equal(after.covariance, before.covariance)


def test_tables_in_another_order_keep_their_own_rows_of_the_covariance(tmp_path):
    before = example()
    path = tmp_path / "calibration.toml"
    write_calibration(path, before)
    head, *tables = path.read_text().split("\n[parameters.")
    last, rest = tables[-1].split("\n[", 1)
    path.write_text("\n[parameters.".join([head, *reversed([*tables[:-1], last])]) + "\n[" + rest)
    after = read_calibration(path)
    assert after.names == before.names[::-1]
    assert np.array_equal(after.covariance, before.covariance[::-1, ::-1])


def test_without_the_archive_the_covariance_is_diagonal_and_said_so(tmp_path):
    before = example()
    write_calibration(tmp_path / "calibration.toml", before)
    (tmp_path / "calibration.npz").unlink()
    after = read_calibration(tmp_path / "calibration.toml")
    assert np.allclose(after.covariance, np.diag(np.diag(before.covariance)), rtol=1e-12, atol=0)
    assert len(after.notices) == 1 and "calibration.npz is missing" in after.notices[0]


def test_the_name_list_is_complete_and_in_the_order_of_the_table():
    assert MDH_NAMES[:5] == ("th1", "d1", "a1", "al1", "be1") and len(MDH_NAMES) == 30
    assert COMPLIANCE_NAMES == ("c1", "c2", "c3", "c4", "c5", "c6")
    assert {"base_x", "base_c", "payload_com_z", "wheel_axis_v", "blade_c", "sensor_bias"} <= set(SYMBOLS)
    assert len(SYMBOLS) == 30 + 6 + 6 + 4 + 5 + 2 + 6 + 5  # the 2: the wheel's radius and its wear


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("[parameters.a1]", "[parameters.a7]", "unknown parameter 'a7'"),
        ('unit = "m"', 'unit = "mm"', r"parameters\.a1\.unit = 'mm', expected 'm'"),
        ("value = ", 'value = "', "not valid TOML"),
        ("value = ", "value = true # ", r"parameters\.a1\.value = True"),
        ("sd = ", "sd = -", r"parameters\.a1\.sd = -"),
        ("value = ", "value = nan # ", r"parameters\.a1\.value = nan"),
        ("sd = ", "sd = 2 # ", r"parameters\.a1\.sd = 2,.*do not edit"),
        (
            "value = ",
            "value = -5 # ",
            r"parameters\.a1\.value = -5, calibration\.npz has .*do not edit one alone: restore the file",
        ),
        ("schema = 1", "schema = 2", "schema = 2"),
        ('robot = "kr210_r2700_extra"', "", "'robot' must name"),
        ('covariance_file = "calibration.npz"', 'covariance_file = "../x.npz"', "beside this file"),
        ("covariance_sha256 = ", "covariance_hash = ", "unknown key 'covariance_hash'"),
        ("th1 = ", "th9 = ", "not_identified 'th9'"),
    ],
)
def test_damaged_text_is_refused(tmp_path, old, new, told):
    path = tmp_path / "calibration.toml"
    write_calibration(path, example())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput, match=told):
        read_calibration(path)


def test_an_archive_of_before_values_stood_in_it_is_read(tmp_path):
    path, before = tmp_path / "calibration.toml", example()
    write_calibration(path, before)
    without_hash(path)
    np.savez(tmp_path / "calibration.npz", names=np.array(before.names), covariance=before.covariance)
    assert np.array_equal(read_calibration(path).values, before.values)


def test_an_archive_of_another_calibration_is_refused(tmp_path):
    write_calibration(tmp_path / "calibration.toml", example())
    write_calibration(tmp_path / "other.toml", example(seed=1))
    (tmp_path / "other.npz").replace(tmp_path / "calibration.npz")
    with pytest.raises(BadInput, match="sha256"):
        read_calibration(tmp_path / "calibration.toml")


def without_hash(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("covariance_sha256")]
    path.write_text("\n".join(lines))


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04broken"])
def test_an_archive_that_is_none_is_refused(tmp_path, content):
    path = tmp_path / "calibration.toml"
    write_calibration(path, example())
    without_hash(path)
    (tmp_path / "calibration.npz").write_bytes(content)
    with pytest.raises(BadInput, match="not a covariance archive"):
        read_calibration(path)


def test_pickled_objects_are_never_loaded(tmp_path):
    path = tmp_path / "calibration.toml"
    before = example()
    write_calibration(path, before)
    without_hash(path)
    np.savez(tmp_path / "calibration.npz", names=np.array(before.names, dtype=object), covariance=before.covariance)
    with pytest.raises(BadInput, match="not a covariance archive"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"covariance": np.array([[1.0, 2.0], [2.0, 1.0]])}, "positive semidefinite"),
        ({"covariance": np.array([[1.0, 0.5], [0.4, 1.0]])}, "symmetric"),
        ({"covariance": np.array([[0.0, 0.1], [0.1, 1.0]])}, "positive semidefinite"),
        ({"covariance": np.array([[1.0, np.nan], [np.nan, 1.0]])}, "not finite"),
        ({"covariance": np.eye(3)}, "2 names"),
        ({"values": np.array([1.0])}, "2 names"),
        ({"values": np.array([1.0, np.inf])}, "not finite"),
        ({"names": ("a1", "a9")}, "unknown parameter 'a9'"),
        ({"names": ("a1", "a1")}, "named twice"),
        ({"not_identified": {"a9": "why"}}, "not_identified 'a9'"),
        ({"provenance": {"x": object()}}, "cannot be written"),
    ],
)
def test_unsound_calibrations_are_not_written(tmp_path, changes, told):
    sound = {"names": ("a1", "a2"), "values": np.ones(2), "covariance": np.eye(2)}
    with pytest.raises(BadInput, match=told):
        write_calibration(tmp_path / "calibration.toml", example(**(sound | changes)))
    assert not (tmp_path / "calibration.toml").exists()


def test_semidefinite_covariances_are_sound(tmp_path):
    """A gauge held by another parameter gives correlation one, a fixed parameter gives a row of zeros."""
    covariance = np.array([[1e-8, 1e-12, 0.0], [1e-12, 1e-16, 0.0], [0.0, 0.0, 0.0]])
    before = example(names=("a1", "th2", "c2"), values=np.ones(3), covariance=covariance)
    write_calibration(tmp_path / "c.toml", before)
    assert np.array_equal(read_calibration(tmp_path / "c.toml").covariance, covariance)


def test_missing_and_misnamed_files(tmp_path):
    with pytest.raises(BadInput, match="cannot be read"):
        read_calibration(tmp_path / "none.toml")
    with pytest.raises(BadInput, match=r"must end in \.toml"):
        write_calibration(tmp_path / "calibration.json", example())
    (tmp_path / "empty.toml").write_text('robot = "x"\n')
    with pytest.raises(BadInput, match=r"no \[parameters"):
        read_calibration(tmp_path / "empty.toml")
