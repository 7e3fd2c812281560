"""Worker processes: started from scripts without a guard, and from a program that has no file."""

import subprocess
import sys
from pathlib import Path

from tests.support.house import ROOT

SCRIPT = """
from ocp.shell.processes import cores, interrupts_held_back, nothing, workers
with workers(1, nothing) as pool:
    with interrupts_held_back():
        waiting = pool.submit(cores)
    print("cores", waiting.result() > 0)
"""


def test_a_script_without_a_guard_and_one_without_a_file_start_workers(tmp_path: Path) -> None:
    file = tmp_path / "script.py"
    file.write_text(SCRIPT)
    for arguments, text in (([str(file)], None), (["-"], SCRIPT)):
        told = subprocess.run(
            [sys.executable, *arguments], input=text, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True
        )
        assert told.stdout == "cores True\n", told.stderr
