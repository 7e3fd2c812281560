"""The numbered examples of docs/examples, run as they stand on small cells; each has one number that must come out."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import ocp.effects
from ocp.shell.cache import OWN_EFFECTS
from tests.support.house import ROOT
from tests.support.small_plan import small_cell, without_figures

pytestmark = pytest.mark.usefixtures("unprinted")  # figures are drawn by the tests of each command

EXAMPLES = ROOT / "docs" / "examples"


def example(number: int) -> ModuleType:
    (file,) = EXAMPLES.glob(f"{number:02d}_*.py")
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder of example 1's plan, and its cell."""
    folder = tmp_path_factory.mktemp("examples")
    cell = small_cell(folder / "cell")
    with without_figures():
        result = example(1).main(folder / "plan", blade=cell.parent / "blade.stl", cell=cell, step=2e-3)
    assert result.readback.force_error < 0.1
    assert (result.folder / "report.html").is_file() and "safe to use" in result.line
    return result.folder, cell


def test_a_plan_is_rehearsed(planned, solved_once, tmp_path):
    made, cell = planned
    result = example(3).main(tmp_path, made, cell=cell)
    assert 10 < result.rehearsal.figures["mean_N"] < 35 and len(result.rehearsal.worst) > 0
    after = example(7).main(tmp_path, result.folder).made.latest
    assert abs(after["found_N"] - result.rehearsal.figures["mean_N"]) < 4 * after["found_sd_N"] < 0.8 * after["expected_sd_N"] * 4


def test_readings_calibrate_an_arm(tmp_path):
    result = example(2).main(tmp_path, poses=30)
    table = result.tracker.methods
    assert table.error["full"].mean() < 0.2 * table.before.mean()


def test_a_planted_backlash_is_found(tmp_path):
    result = example(4).main(tmp_path, poses=50)
    first = result.answer.diagnosis.ranking[0]
    assert str(first.name) == "backlash:2" and first.probability > 0.9
    assert np.isclose(first.active.parameters["half_width_rad"], 3e-4, rtol=0.25)


def test_a_measurement_is_judged_before_it_is_made(tmp_path):
    assert "backlash" in example(5).main(tmp_path, count=15)


def test_an_effect_of_ones_own_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv(OWN_EFFECTS, "")  # put back afterwards, and the catalogue without the example's effect
    monkeypatch.setattr(ocp.effects, "__path__", list(ocp.effects.__path__))
    result = example(6).main(tmp_path, poses=50)
    assert str(result.answer.diagnosis.ranking[0].name) == "bent_scale:3"


def test_every_example_stands_in_the_list():
    page = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert [file.name for file in sorted(EXAMPLES.glob("0*.py")) if file.name not in page] == []
