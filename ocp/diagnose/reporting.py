"""The report, drawn by a second process that gets ready while this one diagnoses.

matplotlib takes a second to import and a second to draw: on a second core neither is waited for. With one core the page is made
here, after the rest.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from typing import cast

from ocp.diagnose.engine.channel_system import Channel, ReadingConditions
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.answer import Answer, SignalGap
from ocp.shell.workers import cores, interrupts_held_back, nothing, workers
from robots.pose import Array

Page = Callable[[], bytes]
"""Gives the page's bytes, and waits for them where it must."""


@dataclass(frozen=True)
class Shown:
    """What a report shows of a force channel. The channel itself holds blade and contact of every row, 300 MB of a long log, and
    would be handed over for seconds."""

    name: str
    unit: str
    conditions: ReadingConditions
    noise_floor: float
    residual: Array

    def gap(self) -> Array:
        """Residuals (n, k) SI."""
        return self.residual


def lean(answer: Answer) -> Answer:
    """An answer with no more of its channels than the report shows."""
    gaps = tuple(_lean(gap) for gap in answer.gaps)
    before, after = tuple(g.baseline for g in gaps), tuple(g.corrected for g in gaps)
    return replace(answer, gaps=gaps, diagnosis=replace(answer.diagnosis, baseline=before, channels=after))


def _lean(gap: SignalGap) -> SignalGap:
    return replace(gap, baseline=_shown(gap.baseline), corrected=_shown(gap.corrected))


def _shown(channel: Channel) -> Channel:
    if isinstance(channel, TrackerChannel):
        return replace(channel, store={})
    if channel.name != "force":
        return channel
    return cast(Channel, Shown(channel.name, channel.unit, channel.conditions, channel.noise_floor, channel.gap()))


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
        yield lambda answer, hashes: pool.submit(_page, lean(answer), hashes).result


def _ready() -> None:
    import_module("ocp.diagnose.report.page").warm_up()
    gc.freeze()  # what was imported stays: looking through it for garbage again and again takes a tenth of the drawing


def _page(answer: Answer, hashes: dict[str, str]) -> bytes:
    from ocp.diagnose.report.page import diagnosis_page

    return diagnosis_page(answer, hashes)
