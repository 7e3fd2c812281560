"""What every command line shares: progress, the plain last line, exit codes."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from robots.errors import BadInput, Infeasible

OK, NOT_SOLVED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class Phases:
    """Named phases of a long job with a progress bar on stderr; `seconds` keeps what each took."""

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str, total: int | None = None) -> Iterator[Callable[[], None]]:
        """Time a phase; the value yielded advances its bar by one of `total`."""
        task = self._progress.add_task(name, total=total) if self._progress else None
        start = time.perf_counter()

        def advance() -> None:
            if self._progress and task is not None:
                self._progress.advance(task)

        yield advance
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
        if self._progress and task is not None:
            self._progress.update(task, total=total or 1, completed=total or 1)


@contextmanager
def shown_phases() -> Iterator[Phases]:
    """Phases with bars on stderr when that is a terminal, silent otherwise."""
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description:<14}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        yield Phases(progress)


def main(app: typer.Typer) -> None:
    """Run a command line; what is wrong with the arguments is one sentence too."""
    try:
        # An interrupt during the imports comes back as a number, as an error or as itself, depending on the release.
        if app(standalone_mode=False) == INTERRUPTED:
            sys.exit(_refuse("interrupted, nothing written", INTERRUPTED))
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(_refuse("interrupted, nothing written", INTERRUPTED))
    except Exception as error:
        # Usage errors have this method in every release of typer; where their class lives changes.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        sys.exit(_refuse(f"refused: {message().rstrip('.')}; --help lists what there is", BAD_INPUT))


def run(job: Callable[[], str], not_solved: str = "no safe plan") -> int:
    """Run a command's job; print its last line, or the one sentence why not. Returns the exit code."""
    try:
        print(job())  # noqa: T201  the plain last line is the command's answer
        return OK
    except BadInput as error:
        return _refuse(f"refused: {error}", BAD_INPUT)
    except Infeasible as error:
        return _refuse(f"{not_solved}, nothing written: {error}", NOT_SOLVED)
    except KeyboardInterrupt:
        return _refuse("interrupted, nothing written", INTERRUPTED)


def tell_notices(notices: Iterable[str]) -> None:
    """What the user should know of a result that stands, on stderr, one line each."""
    for notice in notices:
        print(f"note: {_plain(notice)}", file=sys.stderr)  # noqa: T201


def _plain(text: str) -> str:
    """The text on one line, without control characters that a broken file may have put into it."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def _refuse(sentence: str, code: int) -> int:
    print(_plain(sentence), file=sys.stderr)  # noqa: T201  one sentence, DESIGN "Manners"
    return code
