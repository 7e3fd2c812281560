"""Worker processes: started from scripts without a guard, and from a program that has no file."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from ocp.shell.processes import nothing, warmed, workers
from tests.support.house import ROOT

SCRIPT = """
from ocp.shell.processes import cores, interrupts_held_back, nothing, workers
with workers(1, nothing) as pool:
    with interrupts_held_back():
        waiting = pool.submit(cores)
    print("cores", waiting.result() > 0)
"""

TOGETHER = """
from ocp.shell.processes import crew, keep_to, side_by_side
keep_to(2)
with crew("ocp.model.cell"), side_by_side(pow, [(2,), (3,)], 2) as found:
    print(list(found))
"""


def test_a_script_without_a_guard_and_one_without_a_file_start_workers(tmp_path: Path) -> None:
    file = tmp_path / "script.py"
    file.write_text(SCRIPT)
    for arguments, text in (([str(file)], None), (["-"], SCRIPT)):
        told = subprocess.run(
            [sys.executable, *arguments], input=text, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True
        )
        assert told.stdout == "cores True\n", told.stderr


def test_modules_of_the_working_folder_are_not_taken_for_those_that_are_imported(tmp_path: Path) -> None:
    (tmp_path / "aside").mkdir()
    (tmp_path / "casadi.py").write_text("raise SystemExit('not this one')")
    file = tmp_path / "aside" / "script.py"
    file.write_text(f"import sys; sys.path.append({str(ROOT)!r})\n" + TOGETHER)
    for flags in ([], ["-E"], ["-I"]):
        told = subprocess.run([sys.executable, *flags, str(file)], cwd=tmp_path, capture_output=True, text=True)
        assert told.stdout == "[4, 8]\n", told.stderr


def test_a_worker_that_is_ended_while_it_warms_up_hears_of_nothing(tmp_path, monkeypatch):
    """An exception within an import would be told as a broken library, beside the sentence of a refusal."""
    body = "import time, pathlib\ndef warm_up():\n    pathlib.Path(r'{0}/began').touch()\n    try:\n        time.sleep(20)\n"
    body += "    except BaseException:\n        pathlib.Path(r'{0}/heard').touch()\n        raise\n"
    (tmp_path / "slow_to_warm.py").write_text(body.format(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(RuntimeError), workers(1, warmed, "slow_to_warm") as pool:
        pool.submit(nothing)
        for _ in range(100):
            if (tmp_path / "began").exists():
                break
            time.sleep(0.1)
        raise RuntimeError
    assert (tmp_path / "began").exists() and not (tmp_path / "heard").exists()
