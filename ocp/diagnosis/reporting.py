"""The report, drawn by a second process that gets ready while this one diagnoses.

matplotlib takes a second to import and a second to draw: on a second core neither is waited for. With one core the page is made
here, after the rest.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module

from ocp.diagnosis.answer import Answer
from ocp.workers import cores, interrupts_held_back, nothing, workers

Page = Callable[[], bytes]
"""Gives the page's bytes, and waits for them where it must."""


@contextmanager
def drawn_beside() -> Iterator[Callable[[Answer, dict[str, str]], Page]]:
    """What begins to draw the page of an answer (hashes: SHA-256 by file name of what was read); where the block ends early the
    second process is ended."""
    if cores() < 2:
        yield lambda answer, hashes: lambda: _page(answer, hashes)
        return
    with workers(1, _ready) as pool:
        with interrupts_held_back():
            pool.submit(nothing)  # a pool starts its process at the first task
        yield lambda answer, hashes: pool.submit(_page, answer, hashes).result


def _ready() -> None:
    import_module("ocp.report.diagnosis_report").warm_up()
    gc.freeze()  # what was imported stays: looking through it for garbage again and again takes a tenth of the drawing


def _page(answer: Answer, hashes: dict[str, str]) -> bytes:
    from ocp.report.diagnosis_report import diagnosis_page

    return diagnosis_page(answer, hashes)
