"""`grindplan plan|poses|calibrate|..`: one entry point beside `python -m ocp.plan` and its sisters."""

import sys
from importlib import import_module
from importlib.metadata import version

import typer

from ocp.shell.command import command_line, main

NAME, EXAMPLE = "grindplan", "grindplan plan blade.stl --cell cell/cell.toml"
COMMANDS = {
    "cell": "a new cell file, what is wrong or unmeasured in it, its page",
    "robot": "a robot file from a data sheet or a URDF",
    "plan": "a verified robot program that holds the force on a blade",
    "simulate": "a plan rehearsed on a virtual cell",
    "poses": "the poses of a laser-tracker campaign",
    "calibrate": "the arm from readings, the contact from a force log",
    "diagnose": "where model and cell differ, which effect it is, how far it goes",
    "update": "the cell after one more blade",
    "experiments": "virtual robots calibrated and ground with, by four methods",
    "blindtest": "the diagnosis judged on sealed worlds",
}
"""Each is the room of its name, in the order of a first day."""


def start() -> None:
    """Call the command that the first word names with the words that follow; help and completion where none is named."""
    words = sys.argv[1:] or ["--help"]
    if words == ["--version"]:
        typer.echo(f"{NAME} {version(NAME)}")
        sys.exit(0)
    if words[0] in COMMANDS:
        sys.argv = [NAME, *words[1:]]
        main(_app(words[0]), f"{NAME} {words[0]}")
    sys.argv = [NAME, *words]
    main(whole(), NAME)


def whole() -> typer.Typer:
    """All commands in one tree."""
    app = command_line("Offline compensation for robotic belt grinding: a blade in, a verified robot program out.", True, EXAMPLE)
    for name, what in COMMANDS.items():
        one = _app(name)
        if len(one.registered_commands) == 1:
            told = one.registered_commands[0]
            assert told.callback is not None
            app.command(name, epilog=told.epilog, short_help=what)(told.callback)
        else:
            app.add_typer(one, name=name, short_help=what)
    return app


def _app(name: str) -> typer.Typer:
    app: typer.Typer = import_module(f"ocp.{name}.__main__").app
    return app


if __name__ == "__main__":
    start()
