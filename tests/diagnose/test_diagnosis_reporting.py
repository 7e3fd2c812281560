import subprocess
import sys

from ocp.diagnose import answering
from ocp.diagnose.answering import grouped, write_diagnosis
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


def test_what_only_the_report_or_a_force_log_needs_is_imported_late():
    code = f"import sys, ocp.diagnose.answering; print([m for m in {LATE} if m in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


def test_effects_hidden_for_one_reason_are_told_together_but_not_those_that_readings_at_rest_never_show():
    told = [
        f"tracker.csv has no column {c}: {name} cannot be seen" for c, name in (("time_s", "a"), ("speed", "b"), ("time_s", "c"))
    ]
    assert grouped(told) == ["tracker.csv has no column time_s: a, c cannot be seen"]
