"""How far a long job is: named phases, told to whoever asks, and what each took."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[str, int, int | None], None]
"""What is told of a job's progress: name of the phase, steps done, steps in all (None: not known beforehand). A phase begins with
no step done and ends with all of them."""


class Phases:
    """Named phases of a long job; `progress` is told of each, `seconds` keeps what each took."""

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str, total: int | None = None) -> Iterator[Callable[[], None]]:
        """Time a phase; the function yielded counts one of `total` steps."""
        tell, done, start = self._progress or _nobody, 0, time.perf_counter()

        def advance() -> None:
            nonlocal done
            done += 1
            tell(name, done, total)

        tell(name, 0, total)
        yield advance
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
        tell(name, total or 1, total or 1)


def _nobody(_name: str, _done: int, _total: int | None) -> None:
    """Tells nobody."""
