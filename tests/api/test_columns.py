"""`columns`: a table made by others, by its mapping file, in calibrate and diagnose; sealed conditions by the same file."""

import numpy as np
import pytest

from ocp.api import calibrate, diagnose
from ocp.diagnose.dataset import read_data_set, read_sealed
from robots.errors import BadInput
from tests.support.diagnosis_folder import write_tracker_folder

RENAMED = {f"q{k}_deg": f"A{k}" for k in range(1, 7)} | {"x_mm": "X", "y_mm": "Y", "z_mm": "Z"}


def made_by_others(folder, rows=None):
    """The folder's tables with other names, semicolons and decimal commas; the mapping file."""
    for name in ("tracker.csv", "sealed_tracker.csv"):
        head, *lines = (folder / name).read_text().splitlines()
        head = ";".join(RENAMED.get(c, c) for c in head.split(","))
        body = [line.replace(",", ";").replace(".", ",") for line in lines[:rows]]
        (folder / name).write_text("\n".join([head, *body]) + "\n")
    mapping = folder.parent / "mapping.toml"
    columns = [f'{ours} = {{ from = "{theirs}" }}' for ours, theirs in RENAMED.items()]
    mapping.write_text("\n".join(['separator = ";"', 'decimal = ","', *columns]) + "\n")
    return mapping


def test_a_data_set_by_a_mapping_is_the_same_data_set(tmp_path):
    write_tracker_folder(tmp_path / "set", seed=1)
    before = read_data_set(tmp_path / "set")
    sealed = read_sealed(before, "tracker")
    mapping = made_by_others(tmp_path / "set")
    after = read_data_set(tmp_path / "set", mapping)
    assert mapping in after.inputs and after.notices == before.notices
    assert np.array_equal(after.readings.point, before.readings.point)
    assert np.array_equal(read_sealed(after, "tracker").q, sealed.q)


def test_both_commands_read_by_a_mapping(tmp_path):
    write_tracker_folder(tmp_path / "set", seed=1)
    mapping, out = made_by_others(tmp_path / "set", rows=12), tmp_path / "out"
    with pytest.raises(BadInput, match="12 readings are too few to calibrate"):
        calibrate(tmp_path / "set" / "tracker.csv", cell=tmp_path / "set" / "cell.toml", out=out, columns=mapping)
    with pytest.raises(BadInput, match="12 readings are too few to diagnose"):
        diagnose(tmp_path / "set", out=out, columns=mapping)
    with pytest.raises(BadInput, match="separated by semicolons"):
        diagnose(tmp_path / "set", out=out)


def test_no_folder_that_holds_the_mapping_is_written(tmp_path):
    write_tracker_folder(tmp_path / "set", seed=1)
    mapping = made_by_others(tmp_path / "set")
    (tmp_path / "out").mkdir()
    moved = mapping.rename(tmp_path / "out" / mapping.name)
    for run in (
        lambda: calibrate(
            tmp_path / "set" / "tracker.csv",
            cell=tmp_path / "set" / "cell.toml",
            out=tmp_path / "out",
            columns=moved,
            overwrite=True,
        ),
        lambda: diagnose(tmp_path / "set", out=tmp_path / "out", columns=moved, overwrite=True),
    ):
        with pytest.raises(BadInput, match="mapping.toml"):
            run()
    assert moved.is_file()
