"""The options that every command has: the last line as JSON, the page opened, phases told."""

import json
import os
import subprocess
import sys
import webbrowser
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from ocp.shell.command import answer, command, command_line, refusal, shown_progress
from ocp.shell.progress import Phases
from robots.errors import BadInput


@dataclass(frozen=True)
class Made:
    folder: Path
    line: str = "made: all is well"
    notices: tuple[str, ...] = ("one tooth is worn",)


def app_writing(folder: Path, fault: str = "") -> typer.Typer:
    app = command_line()

    @command(app, "make it")
    def make(overwrite: bool = False) -> str:
        if fault:
            raise BadInput(fault)
        with shown_progress() as progress, Phases(progress).phase("milling", 3):
            return answer(Made(folder))

    return app


def test_without_options_a_command_says_its_line_and_its_notices(tmp_path):
    told = CliRunner().invoke(app_writing(tmp_path), [])
    assert (told.exit_code, told.stdout, told.stderr) == (0, "made: all is well\n", "note: one tooth is worn\n")


def test_json_tells_what_was_written_where(tmp_path):
    (tmp_path / "report.html").write_text("<p>well</p>")
    told = json.loads(CliRunner().invoke(app_writing(tmp_path), ["--json"]).stdout)
    page = str(tmp_path / "report.html")
    notices = ["one tooth is worn"]
    assert told == {"exit": 0, "line": "made: all is well", "folder": str(tmp_path), "page": page, "notices": notices}


def test_json_tells_a_refusal_too(tmp_path):
    told = CliRunner().invoke(app_writing(tmp_path, "cell.toml: no wheel; add it"), ["--json"])
    assert told.exit_code == 2 and told.stderr == "refused: cell.toml: no wheel; add it\n"
    assert json.loads(told.stdout)["exit"] == 2 and json.loads(told.stdout)["folder"] is None


def test_open_shows_the_page_and_nothing_where_there_is_none(tmp_path, monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    told = CliRunner().invoke(app_writing(tmp_path), ["--open"])
    assert opened == [] and "writes no page" in told.stderr
    (tmp_path / "rehearsal.html").write_text("<p>well</p>")
    CliRunner().invoke(app_writing(tmp_path), [])
    assert opened == []
    CliRunner().invoke(app_writing(tmp_path), ["--open"])
    assert opened == [(tmp_path / "rehearsal.html").as_uri()]


def test_matplotlib_tells_nothing_of_a_home_without_its_folder(tmp_path):
    code = "import typer; from ocp.shell.command import main, command_line, command; app = command_line(); "
    code += "command(app, 'draw')(lambda: str(__import__('matplotlib').get_configdir()[:0] or 'drawn')); main(app)"
    home = {"HOME": "/proc/nowhere", "XDG_CONFIG_HOME": "", "MPLCONFIGDIR": "", "PATH": os.environ["PATH"]}
    told = subprocess.run([sys.executable, "-c", code], env=home, capture_output=True, text=True)
    assert (told.stdout, told.stderr) == ("drawn\n", "")


def test_verbose_tells_a_phase_when_it_begins(tmp_path):
    told = CliRunner().invoke(app_writing(tmp_path), ["-v"])
    assert told.stderr.splitlines()[0].split() == ["0.0", "s", "milling,", "3", "steps"]


@pytest.mark.parametrize("grows, stands", [(False, "nothing written"), (True, "what is done is kept")])
def test_a_process_that_the_system_ended_is_one_sentence(monkeypatch, grows, stands):
    monkeypatch.setattr("ocp.shell.processes._grows", grows)
    sentence, code = refusal(BrokenProcessPool("a child died"))
    assert code == 1 and sentence.startswith(f"no safe plan, {stands}") and "memory" in sentence
    assert refusal(RuntimeError("ours")) is None


def test_a_console_of_another_code_page_ends_no_command():
    app = "app = typer.Typer()\n@app.command()\ndef told() -> None:\n    print('0.05 \\u2192 0.04')\n"
    code = f"import typer\nfrom ocp.shell.command import main\n{app}main(app)"
    page = os.environ | {"PYTHONIOENCODING": "cp1252"}
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, env=page, check=True)
    assert told.stdout.split() == [b"0.05", b"\\u2192", b"0.04"]


def test_a_full_disc_is_told_with_a_place_to_look_at():
    told = refusal(OSError(28, "No space left on device"))
    assert told is not None and told[1] == 2
    assert told[0].startswith("refused: a temporary file (TMPDIR) or a result: No space left on device; free space")
