"""What every command line shares: progress, the plain last line, exit codes, and the three options that say how to tell."""

import functools
import inspect
import io
import json
import logging
import sys
import time
import webbrowser
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Protocol

import typer
from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from ocp.shell.processes import INTERRUPTED, collect_seldom, sentence_is_told, supervised, was_told, what_stands
from ocp.shell.progress import Progress
from robots.errors import BadInput, Infeasible, shown

OK, NOT_SOLVED, BAD_INPUT = 0, 1, 2
# What a written folder may have to look at.
PAGES = ("report.html", "rehearsal.html", "cell.html", "index.html", "report.pdf")


@dataclass
class _Telling:
    """How this run of a command tells what it made, as its options ask, and what there is to tell."""

    opened: bool = False
    as_json: bool = False
    verbose: bool = False
    folder: Path | None = None
    code: int = OK
    notices: list[str] = field(default_factory=list)

    @property
    def page(self) -> Path | None:
        """The page of the written folder, None where there is none."""
        pages = [] if self.folder is None else [self.folder / name for name in PAGES]
        return next((page for page in pages if page.is_file()), None)


_telling = _Telling()
_OPTIONS: dict[str, Any] = {
    "opened": Annotated[bool, typer.Option("--open", help="open the page that was written")],
    "as_json": Annotated[bool, typer.Option("--json", help="the last line as JSON: exit code, line, folder, page, notices")],
    "verbose": Annotated[bool, typer.Option("--verbose", "-v", help="tell every phase with its seconds")],
}


def command_line(help: str | None = None, completion: bool = False, example: str | None = None) -> typer.Typer:
    """A command line without commands: plain help, a line an option where the terminal is wide enough; completion: with the
    options that install it in a shell; example: of several commands, a line of the shell shown below their help."""
    return typer.Typer(
        add_completion=completion,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        help=help,
        epilog=example and f"Example: {example}",
        context_settings={"max_content_width": 120},
    )


def command(
    app: typer.Typer, *example: str, name: str | None = None, failed: str = "no safe plan"
) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Decorator that makes a function a command of `app`: its own options, then those that all commands have. The function does
    the command's job and returns the plain last line; it imports what is heavy itself, once the arguments stand. example: a line
    of the shell, or several, shown below the help; failed: what is told where no result was found."""

    def decorated(function: Callable[..., str]) -> Callable[..., str]:
        signature = inspect.signature(function, eval_str=True)
        for key, parameter in signature.parameters.items():
            for option in getattr(parameter.annotation, "__metadata__", ()):
                if parameter.default is False and not option.param_decls:
                    option.param_decls = (f"--{key.replace('_', '-')}",)  # no --no-overwrite
        kind = inspect.Parameter.KEYWORD_ONLY
        more = [inspect.Parameter(key, kind, default=False, annotation=hint) for key, hint in _OPTIONS.items()]

        @functools.wraps(function)
        def called(**given: Any) -> None:
            global _telling
            _telling = _Telling(**{key: given.pop(key) for key in _OPTIONS})
            sys.exit(run(lambda: function(**given), failed))

        parameters = [p.replace(kind=kind) for p in signature.parameters.values()] + more
        called.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        called.__annotations__ = {p.name: p.annotation for p in parameters}
        app.command(name, epilog="Example: " + "; ".join(example))(called)
        return function

    return decorated


@contextmanager
def shown_progress() -> Iterator[Progress]:
    """Draws bars of phases on stderr when that is a terminal, nothing otherwise; with --verbose a line a phase."""
    console = Console(stderr=True)
    if _telling.verbose:
        yield _phase_lines()
        return
    columns = (SpinnerColumn(), TextColumn("{task.description:<14}"), BarColumn(), TimeElapsedColumn())
    with Bars(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def show(name: str, done: int, total: int | None) -> None:
            if done == 0:
                tasks[name] = bars.add_task(name, total=total)
            bars.update(tasks[name], completed=done, total=total)

        yield show


def _phase_lines() -> Progress:
    """Tells a phase at its beginning, with what it has to do, and the seconds since the first one."""
    began = time.monotonic()

    def show(name: str, done: int, total: int | None) -> None:
        if done == 0:
            steps = "" if total is None else f", {total} steps"
            print(f"{time.monotonic() - began:8.1f} s  {name}{steps}", file=sys.stderr)  # noqa: T201

    return show


def numbers(
    option: str, text: str | None, form: str = "numbers between commas, as 12,20,28", count: int | None = None
) -> tuple[float, ...] | None:
    """Numbers between commas, the text of an option; None without one. Raises BadInput: no numbers, or not `count`; it names the
    form."""
    try:
        values = None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if values == () or (values is not None and count not in (None, len(values))):
        raise BadInput(f"{option} '{shown(text)}' must be {form}")
    return values


def main(app: typer.Typer, name: str | None = None) -> None:
    """Run a command line; what is wrong with the arguments is one sentence too, and an interrupt ends it at once. name: as which
    its help names it."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a console of another code page is no reason to fail when all is done
    sys.exit(supervised(lambda: _called(app, name), lambda sentence: print(sentence, file=sys.stderr)))  # noqa: T201


def _called(app: typer.Typer, name: str | None) -> int:
    collect_seldom()
    # Without a home to write to, Matplotlib tells twice that it keeps its fonts elsewhere, which nobody asked.
    logging.getLogger("matplotlib").addFilter(lambda record: record.levelno >= logging.ERROR)
    try:
        # An interrupt during the imports comes back as a number, as an error or as itself, depending on the release.
        if app(standalone_mode=False, prog_name=name) == INTERRUPTED:
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
            return _refuse(f"interrupted, {what_stands()}", INTERRUPTED)
        refused = refusal(error, not_solved)
        if refused is None:
            raise
        return _refuse(*refused)


def refusal(error: Exception, not_solved: str = "no safe plan") -> tuple[str, int] | None:
    """The sentence that tells of an error, and the exit code; None where the error is this software's own."""
    if isinstance(error, BadInput):
        return f"refused: {error}", BAD_INPUT
    if isinstance(error, Infeasible):
        return f"{not_solved}, nothing written: {error}", NOT_SOLVED
    if isinstance(error, OSError):
        # Without a name it was a file already open, or one of those that pass between processes.
        where = f"{error.filename or 'a temporary file (TMPDIR) or a result'}: "
        return f"refused: {where}{error.strerror or error}; free space or permission is wanting there", BAD_INPUT
    if isinstance(error, MemoryError):
        return f"{not_solved}, nothing written: memory does not suffice; take a smaller input", NOT_SOLVED
    if isinstance(error, BrokenProcessPool):
        why = "the system ended a process of this command, often for want of memory; try again, or with a smaller input"
        return f"{not_solved}, {what_stands()}: {why}", NOT_SOLVED
    return None


def _told(line: str) -> int:
    """Print the plain last line, the command's answer. The work is done, whether or not anybody can read of it."""
    try:
        print(_as_json(_telling.code, line) if _telling.as_json else line, flush=True)  # noqa: T201
    except BrokenPipeError:  # nobody wants to
        pass
    except OSError as error:
        tell_notices([f"all is written, but this line could not be ({error.strerror}): {line}"])
    if _telling.opened and _telling.page is None:
        tell_notices(["this command writes no page, so there is none to open"])
    elif _telling.opened and _telling.page is not None:
        webbrowser.open(_telling.page.resolve().as_uri())
    return _telling.code


def _as_json(code: int, line: str) -> str:
    """What a program that called the command wants to know, on one line."""
    told = {"exit": code, "line": line, "folder": _telling.folder, "page": _telling.page, "notices": _telling.notices}
    return json.dumps(told, default=str)


class Result(Protocol):
    """What a command's function returns: its folder, the one line that says what was written, and what the user should know."""

    @property
    def folder(self) -> Path:
        """Where it was written."""

    @property
    def line(self) -> str:
        """What was written, and whether it is safe to use."""

    @property
    def notices(self) -> tuple[str, ...]:
        """One sentence each."""


def answer(result: Result, code: int = OK) -> str:
    """The last line of a command, which ends with `code`; its notices go to stderr."""
    _telling.folder, _telling.code = result.folder, code
    _telling.notices += map(_plain, result.notices)
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
    if _telling.as_json:
        print(_as_json(code, _plain(sentence)))  # noqa: T201
    if code == INTERRUPTED:
        sentence_is_told()
    return code
