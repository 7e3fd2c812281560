"""Sections on A4: paragraphs, lists, tables and plots one below the other, over as many sheets as they need.

Text is measured with the font it is printed in, so that nothing runs over an edge and equal words break at equal places.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import LoadFlags

from ocp.report.section import WIDTH, Canvas, Part, Plot, Points, Section, Table
from ocp.report.style import A4_HEIGHT, INK, RULE, SOFT, Sheet, new_sheet, printable

LEFT = 0.7  # inch
TOP, FOOT = 0.95, A4_HEIGHT - 0.75  # inch from the top
LINE = 0.165  # inch between lines of text
TEXT, SMALL = 8.0, 7.0  # points
GAP = 0.13  # inch between the columns of a table
WIDEST = 900  # characters of one paragraph or cell that are printed


@dataclass
class Flow:
    """Sheets that are being filled; `y` inch from the top is where the next part begins."""

    sheets: list[Sheet]
    y: float
    heading: str = field(default="")

    def room(self, height: float) -> None:
        """Begin a new sheet where less than `height` inch is left."""
        if self.y + height > FOOT:
            self.sheets.append(new_sheet(""))
            self.y = TOP

    def sections(self, sections: Iterable[Section]) -> None:
        """Set sections."""
        for section in sections:
            self.y += 0.22
            self.room(0.3 + _least(section.parts))
            self.sheets[-1].text(LEFT, self.y, section.title, fontsize=11, fontweight="bold")
            self.sheets[-1].rule(self.y + 0.08)
            self.y += 0.3
            for part in section.parts:
                self.part(part)

    def part(self, part: Part) -> None:
        """Set one part."""
        if isinstance(part, str):
            self.lines(part)
        elif isinstance(part, Points):
            for k, item in enumerate(part.items):
                self.lines(item, mark=f"{k + 1}." if part.numbered else "•", gap=0.04)
            self.y += 0.06
        elif isinstance(part, Table):
            self.table(part)
        else:
            self.plot(part)

    def lines(self, words: str, mark: str = "", gap: float = 0.1, **style: Any) -> None:
        """A paragraph; `mark` hangs before its first line."""
        indent = 0.2 if mark else 0.0
        for k, line in enumerate(wrapped(words, WIDTH - indent, style.get("fontsize", TEXT))):
            self.room(LINE)
            if mark and k == 0:
                self.sheets[-1].text(LEFT, self.y, mark, color=SOFT)
            self.sheets[-1].text(LEFT + indent, self.y, line, **style)
            self.y += LINE
        self.y += gap

    def plot(self, plot: Plot) -> None:
        """A plot with its caption above, on one sheet."""
        caption = wrapped(plot.caption, WIDTH, SMALL + 0.5)
        self.room(plot.height + 0.15 * len(caption) + 0.1)
        for line in caption:
            self.sheets[-1].text(LEFT, self.y, line, fontsize=SMALL + 0.5, color=SOFT)
            self.y += 0.15
        bottom = A4_HEIGHT - (self.y - 0.06 + plot.height)
        plot.draw(Canvas(self.sheets[-1].figure, plot.height, LEFT, bottom))
        self.y += plot.height + 0.12

    def table(self, table: Table) -> None:
        """A table; its head is repeated on every sheet, no row is broken."""
        widths = column_widths(table)
        head = [wrapped(name, w, SMALL) for name, w in zip(table.columns, widths, strict=True)]
        rows = [[wrapped(cell, w, SMALL) for cell, w in zip(row, widths, strict=True)] for row in table.rows]
        head_height = 0.14 * max(len(cell) for cell in head) + 0.07
        self.room(head_height + (0.2 if table.title else 0) + sum(_row_height(row) for row in rows[:3]))
        if table.title:
            self.sheets[-1].text(LEFT, self.y, table.title, fontsize=TEXT, fontweight="bold")
            self.y += 0.19
        self._row(table, head, widths, color=SOFT, fontweight="bold")
        for k, row in enumerate(rows):
            if self.y + _row_height(row) > FOOT:
                self.room(FOOT)
                self._row(table, head, widths, color=SOFT, fontweight="bold")
            weight = "bold" if k in table.strong else "normal"
            self._row(table, row, widths, color=SOFT if k in table.quiet else INK, fontweight=weight)
        self.y += 0.12

    def _row(self, table: Table, cells: list[list[str]], widths: list[float], **style: Any) -> None:
        x = LEFT
        for k, (cell, width) in enumerate(zip(cells, widths, strict=True)):
            for i, line in enumerate(cell):
                flush = {"ha": "right"} if k in table.numbers else {}
                at = x + width if k in table.numbers else x
                self.sheets[-1].text(at, self.y + 0.14 * i, line, fontsize=SMALL, **flush, **style)
            x += width + GAP
        self.y += _row_height(cells)
        self.sheets[-1].rule(self.y - 0.115, LEFT, x - GAP, RULE)


def _row_height(cells: list[list[str]]) -> float:
    return 0.14 * max(len(cell) for cell in cells) + 0.045


def _least(parts: tuple[Part, ...]) -> float:
    """Height inch that a heading wants below itself: its words and, where a plot or table comes next, that or its beginning."""
    if not parts:
        return 0.0
    first = parts[0]
    if isinstance(first, str):
        return LINE * len(wrapped(first, WIDTH, TEXT)) + 0.1 + _least(parts[1:2])
    return first.height + 0.5 if isinstance(first, Plot) else 0.9 if isinstance(first, Table) else 0.4


def column_widths(table: Table) -> list[float]:
    """Width inch of each column: what its longest entry takes; the widest columns of words give way until all fit."""
    natural = []
    for k, name in enumerate(table.columns):
        cells = max((width_of(row[k], SMALL, k_row in table.strong) for k_row, row in enumerate(table.rows)), default=0.0)
        longest_word = max((width_of(word, SMALL, True) for word in name.split()), default=0.0)
        natural.append(max(cells, min(width_of(name, SMALL, True), max(longest_word, 0.75))) + 0.01)
    widths = np.array(natural)
    room = WIDTH - GAP * (len(widths) - 1)
    words = [k for k in range(len(widths)) if k not in table.numbers] or list(range(len(widths)))
    while widths.sum() > room + 1e-9:
        widest = max(words, key=lambda k: widths[k])
        if widths[widest] <= 0.4:
            widths *= room / widths.sum()
            break
        widths[widest] = max(0.4, widths[widest] - min(0.05, widths.sum() - room))
    return [float(w) for w in widths]


@cache
def width_of(words: str, size: float, bold: bool = False) -> float:
    """Width inch of a line of text at `size` points."""
    font = get_font(findfont(FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")))
    font.set_size(20 * size, 72)  # large and without hinting: widths are not rounded to pixels
    font.set_text(printable(words), 0.0, flags=LoadFlags.NO_HINTING)
    return float(font.get_width_height()[0]) / 64 / 72 / 20


def wrapped(words: str, width: float, size: float) -> list[str]:
    """Lines of at most `width` inch; a word that is longer is cut."""
    lines, line = [], ""
    for word in printable(words[:WIDEST]).split():
        while width_of(word, size) > width and len(word) > 1:
            cut = max(1, sum(width_of(word[: k + 1], size) <= width for k in range(len(word))))
            lines += ([line] if line else []) + [word[:cut]]
            line, word = "", word[cut:]
        joined = f"{line} {word}" if line else word
        if width_of(joined, size) > width:
            lines.append(line)
            joined = word
        line = joined
    return [*lines, line]
