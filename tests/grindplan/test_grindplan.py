"""One entry point: its words are the rooms of the commands, their help fits a screen, completion completes."""

import os
import re
import subprocess
import sys
import tomllib

import pytest
import typer
from typer.testing import CliRunner

from ocp.grindplan.__main__ import COMMANDS, whole
from tests.support.house import ROOT


def test_every_room_that_has_a_command_is_a_word_of_it():
    rooms = {path.parent.name for path in (ROOT / "ocp").glob("*/__main__.py")} - {"grindplan"}
    assert set(COMMANDS) == rooms


def leaves():
    """Every command as its words: one, or a room's and one of its commands."""
    for name, command in typer.main.get_command(whole()).commands.items():
        yield from [(name, inner) for inner in getattr(command, "commands", ())] or [(name,)]


@pytest.mark.parametrize("words", list(leaves()), ids=" ".join)
def test_the_help_of_a_command_fits_a_screen_and_shows_an_example(words):
    told = CliRunner().invoke(whole(), [*words, "--help"], env={"COLUMNS": "80"})
    assert told.exit_code == 0 and len(told.output.splitlines()) <= 45
    assert re.search(rf"Example: python -m ocp\.{' '.join(words)} ", told.output)
    assert {"--open", "--json", "--verbose"} <= set(re.findall(r"--[\w-]+", told.output))
    assert len(re.findall(r"--no-\w+", told.output)) <= 1


@pytest.mark.parametrize("words", [[], ["cell"], ["robot"]])
def test_the_help_of_several_commands_has_an_example(words):
    told = CliRunner().invoke(whole(), [*words, "--help"], env={"COLUMNS": "80"})
    assert told.exit_code == 0 and "Example: " in told.output and len(told.output.splitlines()) <= 45


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_takes_a_cell_takes_it_as_an_option_of_that_name(name):
    command = typer.main.get_command(whole()).commands[name]
    for parameter in command.params:
        if parameter.param_type_name == "argument":
            assert "cell" not in parameter.name


def run(*words, **more):
    call = [sys.executable, "-m", "ocp.grindplan", *words]
    return subprocess.run(call, capture_output=True, text=True, cwd=ROOT, env=os.environ | more)


def test_the_shell_asks_for_the_end_of_a_word():
    told = run(_GRINDPLAN_COMPLETE="complete_bash", COMP_WORDS="grindplan ca", COMP_CWORD="1")
    assert told.stdout.split() == ["calibrate"]


def test_a_word_that_is_no_command_is_refused_with_the_nearest():
    told = run("plam")
    assert told.returncode == 2 and told.stderr.count("\n") == 1 and "plan" in told.stderr


def test_it_tells_its_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert run("--version").stdout.split() == ["grindplan", project["version"]]
