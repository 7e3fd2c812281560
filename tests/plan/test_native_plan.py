"""A plan is the same to the last byte with machine code and without."""

import json
import os
import shutil

import pytest

from ocp.plan import files
from ocp.plan.__main__ import app
from ocp.plan.passes import optimise
from ocp.shell import native
from tests.support.small_plan import STEP, called, small_cell


@pytest.mark.skipif(shutil.which("cc") is None, reason="no cc on this machine")
def test_programs_and_table_are_byte_identical_with_machine_code_and_without(small_plan_once, tmp_path, monkeypatch):
    """Passes of another cache, blade and wheel as they are kept: only what is compiled differs. Compiled without optimisation,
    which takes 2 s instead of 9: the bits are the same."""
    kept = tmp_path / "kept"
    kept.mkdir()
    for file in os.scandir(os.environ["GRINDPLAN_CACHE"]):
        if file.is_file() and not file.name.startswith("passes"):
            os.link(file.path, kept / file.name)
    monkeypatch.setenv("GRINDPLAN_CACHE", str(kept))
    monkeypatch.setattr(optimise, "WORTH_COMPILING", 0)
    monkeypatch.setattr(optimise, "cores", lambda: 1)  # helpers would not know of the changes here
    monkeypatch.setattr(native, "FLAGS", ("-O0", *native.FLAGS[1:]))
    monkeypatch.setattr(native, "_told", {})
    monkeypatch.setattr(files, "write_plan_report", lambda *_: None)  # a third of the time, and not what is compared
    small_cell(tmp_path / "cell")
    told = called(app, tmp_path / "cell", "--cell", "cell.toml", *STEP)
    assert told.code == 0, told.err
    plain, ours = (next(folder.glob("**/plan.csv")).parent for folder in (small_plan_once[0], tmp_path / "cell"))
    by = [json.loads((folder / "plan.json").read_text())["summary"]["Functions of the model"] for folder in (plain, ours)]
    assert by[0].startswith("CasADi's virtual machine") and by[1].startswith("machine code")
    names = [file.name for file in sorted(plain.iterdir()) if file.suffix in (".src", ".dat", ".csv")]
    assert len(names) >= 3
    assert all((plain / name).read_bytes() == (ours / name).read_bytes() for name in names)
