"""The two ways in which a command can say no, and that nothing else is said beside its sentence."""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class BadInput(Exception):
    """What was handed in cannot be used; the message is one sentence that names file, place, value and remedy.

    Commands print it and exit with code 2.
    """


class Infeasible(Exception):
    """The input is sound but no safe result exists; the message names pass, waypoint, constraint and amount.

    Commands print it and exit with code 1.
    """


LONGEST_SHOWN = 40


def shown(value: object, most: int = LONGEST_SHOWN) -> str:
    """A value as a message echoes it: on one line, without what a terminal would obey, cut to `most` characters."""
    try:
        text = value if isinstance(value, str) else str(value)
    except ValueError:  # an integer of more digits than Python writes out
        text = f"a {type(value).__name__} too long to print"
    head = "".join(c if c.isprintable() else "?" for c in text[: most + 1])
    return head if len(text) <= most else f"{head[: most - 2]}.."


@contextmanager
def words_kept_back() -> Iterator[Callable[[], str]]:
    """Keeps back what a library writes to this process's stdout and stderr beside Python; gives what reads it."""
    sys.stdout.flush()
    sys.stderr.flush()
    with tempfile.TemporaryFile() as kept:
        before = [os.dup(stream) for stream in (1, 2)]
        for stream in (1, 2):
            os.dup2(kept.fileno(), stream)

        def said() -> str:
            kept.seek(0)
            return kept.read().decode("utf-8", "replace")

        try:
            yield said
        finally:
            for stream, own in zip((1, 2), before, strict=True):
                os.dup2(own, stream)
                os.close(own)
