"""Every benchmark finds what it imports; tables side by side with other programs start, whether those are installed or not."""

import json
import os
import subprocess
import sys

import pytest

from tests.support.house import ROOT

TABLES = sorted((ROOT / "benchmarks").glob("*_peers.py"))
ONE_AFTER_THE_OTHER = """
import contextlib, io, json, runpy, sys
told = {}
for script in sys.argv[1:]:
    out, sys.argv = io.StringIO(), [script, "--help"]
    try:
        with contextlib.redirect_stdout(out):
            runpy.run_path(script, run_name="__main__")
        told[script] = ["did not end by itself", ""]
    except SystemExit as end:
        told[script] = [end.code, out.getvalue()]
    except Exception as error:
        told[script] = [repr(error), out.getvalue()]
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def told() -> dict[str, tuple[object, str]]:
    """Exit code and what is printed by every table's --help, in one process: what they import is most of their time."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "benchmarks")])
    call = [sys.executable, "-c", ONE_AFTER_THE_OTHER, *map(str, TABLES)]
    done = subprocess.run(call, cwd=ROOT, env={"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_there_are_tables():
    assert len(TABLES) >= 6


@pytest.mark.parametrize("script", TABLES, ids=lambda path: path.stem)
def test_a_table_starts(told, script):
    code, words = told[str(script)]
    assert code == 0 and "usage" in words, code


def test_every_other_benchmark_finds_what_it_imports():
    names = [path.stem for path in sorted((ROOT / "benchmarks").glob("*.py")) if "peer" not in path.stem]
    code = "import importlib, sys\nfor name in sys.argv[1:]: importlib.import_module(f'benchmarks.{name}')"
    done = subprocess.run([sys.executable, "-c", code, *names], cwd=ROOT, capture_output=True, text=True)
    assert len(names) > 30 and done.returncode == 0, done.stderr
