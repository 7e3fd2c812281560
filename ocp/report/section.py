"""What a report is made of, for page and paper alike: sections of paragraphs, lists, tables and plots.

A section holds no layout. `sections_page.html` and `flow.py` put the same sections on the screen and on A4.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # half a second to import, and sections are made without it

WIDTH = 6.87
"""inch: A4 less its margins. On the page a plot is scaled to the column."""


@dataclass(frozen=True)
class Headline:
    """The first thing to read: whether all is well (`good`), that in a few words, one sentence, and facts as (question,
    answer)."""

    good: bool
    verdict: str
    sentence: str
    facts: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Canvas:
    """A part of a matplotlib figure to draw in: `WIDTH` by `height` inch, its lower left corner at `left`, `bottom` inch of the
    figure."""

    figure: "Figure"
    height: float
    left: float = 0.0
    bottom: float = 0.0

    def subplots(
        self, rows: int = 1, columns: int = 1, left: float = 0.5, right: float = 0.05, top: float = 0.22, bottom: float = 0.4,
        across: float = 0.45, down: float = 0.5, widths: Sequence[float] | None = None, **options: Any,
    ) -> Any:  # fmt: skip
        """Axes that fill the canvas, as `Figure.subplots` gives them; margins and gaps in inch, `widths` of the columns relative
        to each other."""
        width, height = self.figure.get_size_inches()
        panel_width = (WIDTH - left - right - across * (columns - 1)) / columns
        panel_height = (self.height - top - bottom - down * (rows - 1)) / rows
        grid = self.figure.add_gridspec(
            rows, columns, width_ratios=widths,
            left=(self.left + left) / width, right=(self.left + WIDTH - right) / width,
            bottom=(self.bottom + bottom) / height, top=(self.bottom + self.height - top) / height,
            wspace=across / panel_width, hspace=down / panel_height,
        )  # fmt: skip
        return grid.subplots(**options)


Draw = Callable[[Canvas], None]
"""Draws a plot; labels that come from a user go through `printed_style.printable`."""


@dataclass(frozen=True)
class Points:
    """A list with a mark before each item; `numbered`: in the order in which they should be done."""

    items: tuple[str, ...]
    numbered: bool = False


@dataclass(frozen=True)
class Table:
    """Rows of text under `columns`; columns in `numbers` are set flush right, rows in `quiet` in grey, in `strong` bold."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: frozenset[int] = frozenset()
    quiet: frozenset[int] = frozenset()
    strong: frozenset[int] = frozenset()
    title: str = ""


@dataclass(frozen=True)
class Plot:
    """A picture: `key` (letters and dashes, one in the report), caption, height inch, and the function that draws it."""

    key: str
    caption: str
    height: float
    draw: Draw


Part = str | Points | Table | Plot
"""A string is a paragraph."""


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it, in order."""

    title: str
    parts: tuple[Part, ...]


def table(
    columns: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = (0,), quiet: Sequence[int] = (),
    strong: Sequence[int] = (), title: str = "",
) -> Table:  # fmt: skip
    """A table whose columns are numbers but for those in `text`. Raises ValueError for a row of another length."""
    for row in rows:
        if len(row) != len(columns):
            raise ValueError(f"row {row} has {len(row)} entries for {len(columns)} columns")
    numbers = frozenset(range(len(columns))) - frozenset(text)
    return Table(tuple(columns), tuple(tuple(r) for r in rows), numbers, frozenset(quiet), frozenset(strong), title)
