"""Worker processes that share a large read-only state and leave interrupts to their parent."""

import os
import pickle
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from types import ModuleType
from typing import Any


@contextmanager
def workers(jobs: int, start: Callable[..., None], *state: Any) -> Iterator[Executor]:
    """A pool of `jobs` processes, each of which has called `start(*state)`.

    The state travels by file: a worker that dies while starting would otherwise block its parent on a full pipe. Where
    the block ends with an error or an interrupt, the workers are ended at once.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state.pickle"
        file.write_bytes(pickle.dumps((start, state)))
        pool = ProcessPoolExecutor(jobs, get_context("spawn"), _start, (str(file),))
        try:
            yield pool
        except BaseException:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _start(file: str) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    start, state = pickle.loads(Path(file).read_bytes())
    start(*state)
    # Ended early, a worker still removes the temporary files of what it was doing.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))


def _end_with_parent() -> None:
    """End this process when its parent's end of their pipe closes, however that ended: work for nobody is no work."""
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(143)


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """While work is handed out (that is when workers are spawned) new processes learn to ignore Ctrl-C.

    The disposition is inherited; the parent's own is put back at the end of the block. Nor do new processes import the script
    that called: it may have no guard against being run again, or no file at all, and no work of ours is defined there.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
    finally:
        sys.modules["__main__"] = script


def cores() -> int:
    """Processes worth starting: cores that this process may use, at most eight."""
    return min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


def nothing() -> None:
    """The `start` of workers that need no state."""
