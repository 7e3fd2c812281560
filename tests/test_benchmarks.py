"""The tables that stand side by side with other programs start, whether those are installed or not."""

import subprocess
import sys

import pytest

from tests.support.house import ROOT

TABLES = sorted((ROOT / "benchmarks").glob("*_peers.py"))


def test_there_are_tables():
    assert len(TABLES) >= 6


@pytest.mark.parametrize("script", TABLES, ids=lambda path: path.stem)
def test_a_table_starts(script):
    done = subprocess.run(
        [sys.executable, str(script), "--help"], cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert done.returncode == 0 and "usage" in done.stdout, done.stderr
