"""The planning command as a user starts it, on a cell cut down to a few short passes."""

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from ocp.data import BLADE, CELL
from ocp.plan import files
from ocp.plan.__main__ import app
from ocp.plan.report.pages import plan_pages

ROOT = Path(__file__).resolve().parents[2]
TEXT = (CELL).read_text()
SMALL = {  # three lines in the middle of one side
    'side = "both"': 'side = "convex"',
    "edge_margin_mm = 3.0": "edge_margin_mm = 18.7",
    "root_margin_mm = 5.0": "root_margin_mm = 40.0",
}
STEP = ("--step", "2")


@dataclass(frozen=True)
class Told:
    """Exit code and what the command wrote on both channels."""

    code: int
    out: str
    err: str


def small_cell(folder: Path, changes: dict[str, str] | None = None, blade: bool = True) -> Path:
    """A cell.toml in `folder` with the bundled blade beside it; `changes` are replacements that must take hold."""
    folder.mkdir(parents=True, exist_ok=True)
    text = TEXT
    for old, new in (SMALL | (changes or {})).items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "cell.toml").write_text(text)
    if blade:
        shutil.copy(BLADE, folder / "blade.stl")
    return folder / "cell.toml"


def environment() -> dict[str, str]:
    """The environment of a subprocess: this checkout, one thread, the session's own cache."""
    return os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}


def started(folder: Path, *arguments: str) -> "subprocess.Popen[str]":
    """The command in a process group of its own, as a shell starts it."""
    return subprocess.Popen(
        [sys.executable, "-m", "ocp.plan", *arguments],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Tests may themselves run as a background job, where interrupts are ignored and that is inherited.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def planned(folder: Path, *arguments: str) -> Told:
    """Run the command to its end in a process of its own, working folder `folder`."""
    process = started(folder, *arguments)
    out, err = process.communicate(timeout=300)
    return Told(process.returncode, out, err)


def called(app: typer.Typer, folder: Path, *arguments: object) -> Told:
    """Run a command in this process, in `folder`: nothing is imported anew, and what one run solved serves the next."""
    err = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stderr(err):
        result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Told(result.exit_code, result.stdout, result.stderr or err.getvalue())


@contextlib.contextmanager
def undrawn() -> Iterator[None]:
    """Plans in this process without the figures of their report, which take a third of their time; what they are drawn from is
    still put together."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "write_plan_report", lambda report, folder: plan_pages(report))
        yield


@contextlib.contextmanager
def without_figures() -> Iterator[None]:
    """Pages and sheets of any command in this process without their figures, which take as long as all else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ocp.report.parts.inline_svg", lambda *_: '<svg viewBox="0 0 9 1"></svg>')
        yield


def refused(*arguments: str) -> Told:
    """The planning command in this process and folder: for what is refused before any work is done."""
    return called(app, Path.cwd(), *arguments)


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below `folder` with its bytes, hidden ones included."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
