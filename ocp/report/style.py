"""What all printed sheets share: A4 figures, quiet axes, colours, text that the font can show.

Figures are made without pyplot: no display, no global list of figures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.lines import Line2D

from ocp.report.colours import VIRIDIS
from robots.pose import Array

A4_WIDTH, A4_HEIGHT = 8.27, 11.69
"""inch; ISO 216."""
INK, SOFT, RULE = "#17212b", "#52606d", "#d9dee4"
CURVE, TARGET, LIMIT, SHADE = "#123e5c", "#b3540a", "#9c2f0a", "#e6edf3"
COLOUR_MAP = LinearSegmentedColormap.from_list("report", list(VIRIDIS))
STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib: the same glyphs on every machine
    "font.size": 8,
    "pdf.fonttype": 42,
    "pdf.compression": 6,
    "axes.edgecolor": "#9aa5b1",
    "axes.linewidth": 0.6,
    "axes.labelcolor": SOFT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "text.color": INK,
    "text.parse_math": False,  # a dollar sign in a file name is a dollar sign
    "lines.linewidth": 0.9,
    "grid.color": RULE,
    "grid.linewidth": 0.5,
    "axes.titley": 1.0,  # a fixed place: looking for a free one takes a sixth of the time
}
"""matplotlib settings in force while the sheets are made and written."""


@dataclass(frozen=True)
class Sheet:
    """One printed page: its figure, and text and rules placed in inches from the top left corner."""

    figure: Figure

    def text(self, x: float, y: float, words: str, **style: Any) -> None:
        """Write words with their base line `y` inch below the top edge, `x` inch from the left."""
        self.figure.text(x / A4_WIDTH, 1 - y / A4_HEIGHT, printable(words), **style)

    def rule(self, y: float, left: float = 0.7, right: float = A4_WIDTH - 0.7, colour: str = RULE) -> None:
        """Thin line across the sheet, `y` inch below the top edge."""
        height = 1 - y / A4_HEIGHT
        self.figure.add_artist(Line2D([left / A4_WIDTH, right / A4_WIDTH], [height, height], color=colour, lw=0.6))


def new_sheet(heading: str, note: str = "") -> Sheet:
    """An A4 sheet, upright, with a heading and a line of explanation below it."""
    sheet = Sheet(Figure(figsize=(A4_WIDTH, A4_HEIGHT)))
    sheet.text(0.7, 0.75, heading, fontsize=13, fontweight="bold")
    if note:
        sheet.text(0.7, 0.98, note, fontsize=8, color=SOFT)
    return sheet


def grid_of_axes(sheet: Sheet, rows: int, columns: int, **options: Any) -> list[list[Axes]]:
    """Rows of axes that fill the sheet below its heading."""
    spacing = {"left": 0.1, "right": 0.93, "bottom": 0.07, "top": 0.885, "hspace": 0.5, "wspace": 0.22}
    spacing |= options.pop("spacing", {})
    axes = sheet.figure.subplots(rows, columns, squeeze=False, gridspec_kw=spacing, **options)
    return [list(row) for row in axes]


def number_sheets(sheets: Sequence[Sheet], title: str) -> None:
    """Write title and "page i of n" at the foot of every sheet."""
    for i, sheet in enumerate(sheets):
        sheet.text(0.7, A4_HEIGHT - 0.4, shorten(title, 80), fontsize=7, color=SOFT)
        place = f"page {i + 1} of {len(sheets)}"
        sheet.text(A4_WIDTH - 0.7, A4_HEIGHT - 0.4, place, fontsize=7, color=SOFT, ha="right")


def envelope(x: Array, y: Array, bins: int = 500) -> tuple[Array, Array]:
    """A curve of at most 2 `bins` points that keeps every peak: least and largest value of each bin."""
    if len(x) <= 2 * bins:
        return np.asarray(x, float), np.asarray(y, float)
    edges = np.linspace(0, len(x), bins + 1).astype(int)
    pick = []
    for a, b in pairwise(edges):
        part = np.nan_to_num(y[a:b])
        pick += sorted({a + int(part.argmin()), a + int(part.argmax())})
    index = np.array(pick)
    return np.asarray(x, float)[index], np.asarray(y, float)[index]


@cache
def _known_characters() -> frozenset[int]:
    return frozenset(get_font(findfont(FontProperties(family="DejaVu Sans"))).get_charmap())


def printable(words: str) -> str:
    """The words with a box for every character that the font lacks, a space for control characters."""
    known = _known_characters()
    return "".join(c if ord(c) in known else ("\u25a1" if c.isprintable() else " ") for c in words)


def shorten(words: str, most: int) -> str:
    """At most `most` characters, the middle replaced by an ellipsis."""
    return words if len(words) <= most else f"{words[: most // 2]}…{words[len(words) - (most - 1) // 2 :]}"
