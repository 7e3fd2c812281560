import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.diagnose import answering
from ocp.diagnose.answering import grouped, write_diagnosis
from ocp.diagnose.report import verdict_sentence
from ocp.shell.progress import Phases
from tests.support.diagnosis_folder import write_tracker_folder

LATE = ("matplotlib", "jinja2", "trimesh", "networkx")  # seconds of imports that a tracker's diagnosis does not wait for


def test_one_core_draws_the_same_page_as_two(tmp_path, monkeypatch):
    write_tracker_folder(tmp_path / "set", 3, 1e-4, n=40, sealed=3)
    pages = []
    for cores in (1, 2):
        monkeypatch.setattr(answering, "cores", lambda cores=cores: cores)
        write_diagnosis(tmp_path / "set", tmp_path / f"out{cores}", False, Phases())
        pages.append((tmp_path / f"out{cores}" / "report.html").read_bytes())
    assert pages[0] == pages[1] and b"<svg" in pages[0]


@pytest.mark.parametrize(("unknown", "words"), [(0.02, "too small beside it"), (0.98, "what has no name is in that noise")])
def test_a_gap_in_the_noise_is_told_apart_from_one_without_a_name(unknown, words):
    readings = np.full(9, 0.1)
    gap = SimpleNamespace(name="tracker", unit="mm", noise_floor=0.11, before=readings, after=readings, shrinkage=None)
    told = verdict_sentence._better(SimpleNamespace(gaps=(gap,), diagnosis=SimpleNamespace(p_unknown=unknown)))
    assert words in told and "noise 0.11" in told


def test_what_only_the_report_or_a_force_log_needs_is_imported_late():
    code = f"import sys, ocp.diagnose.answering; print([m for m in {LATE} if m in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


def test_effects_hidden_for_one_reason_are_told_together_but_not_those_that_readings_at_rest_never_show():
    told = [
        f"tracker.csv has no column {c}: {name} cannot be seen" for c, name in (("time_s", "a"), ("speed", "b"), ("time_s", "c"))
    ]
    assert grouped(told) == ["tracker.csv has no column time_s: a, c cannot be seen"]
