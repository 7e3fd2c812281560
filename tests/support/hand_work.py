"""Tasks for other processes: they must be found by name there."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ocp.shell.processes import cores
from robots.errors import BadInput


def added(given: int, number: int, seconds: float = 0.0) -> tuple[int, int, int]:
    """The sum of what all tasks are given and a number of this one's; the process' cores and its own number."""
    time.sleep(seconds)
    return number + given, cores(), os.getpid()


def doubled(folder: Path, name: str) -> int:
    """Writes the file `name` twice over into another one."""
    if not (folder / name).exists():
        raise BadInput(f"{folder / name}: is not there")
    text = (folder / name).read_text()
    (folder / "out").mkdir()
    (folder / "out" / "twice.txt").write_text(2 * text)
    return len(text)


def killed_once(trace: str) -> str:
    """Leaves its process number in a file; ended by the system the first time, done the second."""
    if waited(trace, 0.0) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def waited(trace: str, seconds: float) -> int:
    """Leaves its process number in a file; returns how many have done so, the first after a while."""
    with Path(trace).open("a") as file:
        file.write(f"{os.getpid()}\n")
    count = len(Path(trace).read_text().split())
    time.sleep(seconds if count == 1 else 0.0)
    return count


def killed() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def called(work: Callable[..., Any], *task: Any) -> Any:
    return work(*task)


def added_or_called(given: int, *task: Any) -> Any:
    """A number is added to what all tasks are given, anything else is called."""
    return added(given, *task) if isinstance(task[0], int) else called(*task)
