"""What the side-by-side tables (`*_peers.py`) share: a clock, medians of several runs, versions, Markdown rows.

The peers are in the dependency group `peers` of pyproject.toml and no dependency of the product (docs/performance.md, "Side by
side"). A peer that is not installed has a row that says so.
"""

import argparse
import os
import platform
import resource
import time
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TypeVar

import numpy as np

Answer = TypeVar("Answer")


class NotInstalled(Exception):
    """A peer that this Python does not have; the message is the row's note."""


def named(package: str) -> str:
    """A distribution's name and version; NotInstalled where there is none."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        raise NotInstalled(f"{package} is not installed") from None


def used() -> np.ndarray:
    """Wall and processor seconds (2,) so far, all threads, processes that have ended among them."""
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return np.array([time.perf_counter(), sum(u.ru_utime + u.ru_stime for u in spent)])


def measured(call: Callable[[], Answer], runs: int) -> tuple[Answer, float, float]:
    """What the last of `runs` calls gives, and medians of wall and processor seconds of a call."""
    seconds = []
    for _ in range(runs):
        began = used()
        answer = call()
        seconds.append(used() - began)
    wall, processor = np.median(seconds, axis=0)
    return answer, float(wall), float(processor)


def arguments(doc: str | None, **sizes: int) -> argparse.Namespace:
    """Command line with one whole-number option a size."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, size in sizes.items():
        parser.add_argument(f"--{name}", type=int, default=size, help=f"default {size}")
    return parser.parse_args()


def head(columns: Sequence[str]) -> None:
    """Where this runs, and the table's head."""
    print(f"Python {platform.python_version()}, numpy {np.__version__}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|", flush=True)


def row(*cells: object) -> None:
    """A row; floats with four significant figures."""
    print(f"| {' | '.join(f'{c:.4g}' if isinstance(c, float) else str(c) for c in cells)} |", flush=True)
