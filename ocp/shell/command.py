"""What every command line shares: progress, the plain last line, exit codes."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol

import typer
from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from ocp.shell.processes import INTERRUPTED, collect_seldom, supervised, was_told
from ocp.shell.progress import Progress
from robots.errors import BadInput, Infeasible

OK, NOT_SOLVED, BAD_INPUT = 0, 1, 2


@contextmanager
def shown_progress() -> Iterator[Progress]:
    """Draws bars of phases on stderr when that is a terminal, nothing otherwise."""
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description:<14}"), BarColumn(), TimeElapsedColumn())
    with Bars(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def show(name: str, done: int, total: int | None) -> None:
            if done == 0:
                tasks[name] = bars.add_task(name, total=total)
            bars.update(tasks[name], completed=done, total=total)

        yield show


def main(app: typer.Typer) -> None:
    """Run a command line; what is wrong with the arguments is one sentence too, and an interrupt ends it at once."""
    sys.exit(supervised(lambda: _called(app), lambda sentence: print(sentence, file=sys.stderr)))  # noqa: T201


def _called(app: typer.Typer) -> int:
    collect_seldom()
    try:
        # An interrupt during the imports comes back as a number, as an error or as itself, depending on the release.
        if app(standalone_mode=False) == INTERRUPTED:
            return _refuse("interrupted, nothing written", INTERRUPTED)
    except (typer.Abort, KeyboardInterrupt):
        return _refuse("interrupted, nothing written", INTERRUPTED)
    except Exception as error:
        if was_told():  # a library that was being loaded put its own error in the interrupt's place
            return _refuse("interrupted, nothing written", INTERRUPTED)
        # Usage errors have this method in every release of typer; where their class lives changes.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        return _refuse(f"refused: {message().rstrip('.')}; --help lists what there is", BAD_INPUT)
    return OK


def run(job: Callable[[], str], not_solved: str = "no safe plan") -> int:
    """Run a command's job; print its last line, or the one sentence why not. Returns the exit code."""
    try:
        return _told(job())
    except (Exception, KeyboardInterrupt) as error:
        if was_told() or isinstance(error, KeyboardInterrupt):  # some library may have put its own error in the interrupt's place
            return _refuse("interrupted, nothing written", INTERRUPTED)
        if isinstance(error, BadInput):
            return _refuse(f"refused: {error}", BAD_INPUT)
        if isinstance(error, Infeasible):
            return _refuse(f"{not_solved}, nothing written: {error}", NOT_SOLVED)
        if isinstance(error, OSError):
            where = f"{error.filename}: " if error.filename else ""
            return _refuse(f"refused: {where}{error.strerror or error}; free space or permission is wanting there", BAD_INPUT)
        if isinstance(error, MemoryError):
            return _refuse(f"{not_solved}, nothing written: memory does not suffice; take a smaller input", NOT_SOLVED)
        raise


def _told(line: str) -> int:
    """Print the plain last line, the command's answer. The work is done, whether or not anybody can read of it."""
    try:
        print(line, flush=True)  # noqa: T201
    except BrokenPipeError:  # nobody wants to
        pass
    except OSError as error:
        tell_notices([f"all is written, but this line could not be ({error.strerror}): {line}"])
    return OK


class Result(Protocol):
    """What a command's function returns: the one line that says what was written, and what the user should know of it."""

    @property
    def line(self) -> str:
        """What was written, and whether it is safe to use."""

    @property
    def notices(self) -> tuple[str, ...]:
        """One sentence each."""


def answer(result: Result) -> str:
    """The last line of a command; its notices go to stderr."""
    tell_notices(result.notices)
    return result.line


def tell_notices(notices: Iterable[str]) -> None:
    """What the user should know of a result that stands, on stderr, one line each."""
    for notice in notices:
        try:
            print(f"note: {_plain(notice)}", file=sys.stderr)  # noqa: T201
        except OSError:  # a full disk takes no notice, and the result stands
            pass


def _plain(text: str) -> str:
    """The text on one line, without control characters that a broken file may have put into it."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def _refuse(sentence: str, code: int) -> int:
    print(_plain(sentence), file=sys.stderr)  # noqa: T201  one sentence, DESIGN "Manners"
    return code
