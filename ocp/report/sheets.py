"""A4 sheets that are filled from top to bottom, as many as it takes.

Text is measured with the font it is printed in, so that nothing runs over an edge and equal words break at equal places.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import LoadFlags
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from ocp.report.plotting import WIDTH
from ocp.report.style import RULE, SOFT, printable, shorten

A4_WIDTH, A4_HEIGHT = 8.27, 11.69
"""inch; ISO 216."""
LEFT = 0.7  # inch
TOP, FOOT = 0.95, A4_HEIGHT - 0.75  # inch from the top
LINE = 0.165  # inch between lines of text
TEXT = 8.0  # points
LONGEST = 900  # characters of one paragraph or cell that are printed


@dataclass(frozen=True)
class Sheet:
    """One printed page: its figure, and what is placed in inches from the top left corner."""

    figure: Figure

    def text(self, x: float, y: float, words: str, **style: Any) -> None:
        """Write words with their base line `y` inch below the top edge, `x` inch from the left."""
        self.figure.text(x / A4_WIDTH, 1 - y / A4_HEIGHT, printable(words), **style)

    def rule(self, y: float, left: float = LEFT, right: float = A4_WIDTH - LEFT) -> None:
        """Thin line across the sheet, `y` inch below the top edge."""
        height = 1 - y / A4_HEIGHT
        self.figure.add_artist(Line2D([left / A4_WIDTH, right / A4_WIDTH], [height, height], color=RULE, lw=0.6))

    def box(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """A filled rectangle whose lower left corner is `x` inch from the left and `y` inch below the top edge."""
        corner, transform = (x / A4_WIDTH, 1 - y / A4_HEIGHT), self.figure.transFigure
        self.figure.add_artist(Rectangle(corner, width / A4_WIDTH, height / A4_HEIGHT, facecolor=colour, transform=transform))


def new_sheet(heading: str = "", note: str = "") -> Sheet:
    """An A4 sheet, upright, with a heading and a line of explanation below it."""
    sheet = Sheet(Figure(figsize=(A4_WIDTH, A4_HEIGHT)))
    sheet.text(LEFT, 0.75, heading, fontsize=13, fontweight="bold")
    if note:
        sheet.text(LEFT, 0.98, note, fontsize=TEXT, color=SOFT)
    return sheet


def number_sheets(sheets: Sequence[Sheet], title: str) -> None:
    """Write title and "page i of n" at the foot of every sheet."""
    for i, sheet in enumerate(sheets):
        sheet.text(LEFT, A4_HEIGHT - 0.4, shorten(title, 80), fontsize=7, color=SOFT)
        place = f"page {i + 1} of {len(sheets)}"
        sheet.text(A4_WIDTH - LEFT, A4_HEIGHT - 0.4, place, fontsize=7, color=SOFT, ha="right")


@dataclass
class Sheets:
    """Sheets that are being filled; `y` inch from the top is where the next part begins."""

    all: list[Sheet]
    y: float

    @property
    def last(self) -> Sheet:
        """The sheet that is being filled."""
        return self.all[-1]

    @property
    def room(self) -> float:
        """How much of the last sheet is left, inch."""
        return FOOT - self.y

    def need(self, height: float) -> None:
        """Begin a new sheet where less than `height` inch is left."""
        if self.y + height > FOOT:
            self.all.append(new_sheet())
            self.y = TOP

    def paragraph(self, words: str, mark: str = "", gap: float = 0.1) -> None:
        """Words in as many lines as they take; `mark` hangs before the first; `gap` inch stays free below."""
        indent = 0.2 if mark else 0.0
        for k, line in enumerate(wrapped(words, WIDTH - indent, TEXT)):
            self.need(LINE)
            if mark and k == 0:
                self.last.text(LEFT, self.y, mark, color=SOFT)
            self.last.text(LEFT + indent, self.y, line)
            self.y += LINE
        self.y += gap


@cache
def width_of(words: str, size: float, bold: bool = False) -> float:
    """Width inch of a line of text at `size` points."""
    font = get_font(findfont(FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")))
    font.set_size(20 * size, 72)  # large and without hinting: widths are not rounded to pixels
    font.set_text(printable(words), 0.0, flags=LoadFlags.NO_HINTING)
    return float(font.get_width_height()[0]) / 64 / 72 / 20


def wrapped(words: str, width: float, size: float) -> list[str]:
    """Lines of at most `width` inch; a word that is longer is cut."""
    lines, line, at, space = [], "", 0.0, width_of("a a", size) - width_of("aa", size)
    for word in printable(words[:LONGEST]).split():
        while width_of(word, size) > width and len(word) > 1:
            cut = max(1, sum(width_of(word[: k + 1], size) <= width for k in range(len(word))))
            lines += ([line] if line else []) + [word[:cut]]
            line, word = "", word[cut:]
        own = width_of(word, size)
        if line and at + space + own > width:
            lines.append(line)
            line = ""
        line, at = (f"{line} {word}", at + space + own) if line else (word, own)
    return [*lines, line]
