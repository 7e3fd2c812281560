"""The usual parts of a section: paragraph, list, facts, table, plot; each draws itself on the page and on paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup

from ocp.report.plotting import WIDTH, Canvas, Draw, inline_svg
from ocp.report.section import Part, Section
from ocp.report.sheets import A4_HEIGHT, FOOT, LEFT, LINE, TEXT, Sheets, width_of, wrapped
from ocp.report.style import BAD, INK, SHADE, SIDE_COLOURS, SOFT

SMALL = 7.0  # points, of tables and captions
GAP = 0.13  # inch between the columns of a table
BAR = 0.5  # inch on paper


def as_part(part: Part | str) -> Part:
    """A string stands for a paragraph."""
    return Paragraph(part) if isinstance(part, str) else part


@dataclass(frozen=True)
class Paragraph(Part):
    """Words."""

    words: str

    def on_page(self) -> Markup:
        """A `<p>`."""
        return Markup('<p class="words">{}</p>').format(self.words)

    def on_sheets(self, sheets: Sheets) -> None:
        """Lines that are as long as the sheet is wide."""
        sheets.paragraph(self.words)

    def beginning(self) -> float:
        """All of it."""
        return LINE * len(wrapped(self.words, WIDTH, TEXT)) + 0.1


@dataclass(frozen=True)
class Points(Part):
    """A list with a mark before each item; `numbered`: in the order in which they should be done."""

    items: tuple[str, ...]
    numbered: bool = False

    def on_page(self) -> Markup:
        """An `<ol>` or `<ul>`."""
        tag = Markup("ol" if self.numbered else "ul")
        return Markup('<{} class="notices">{}</{}>').format(
            tag, Markup("").join(map(Markup("<li>{}</li>").format, self.items)), tag
        )

    def on_sheets(self, sheets: Sheets) -> None:
        """One item after the other, the first line of each with its mark."""
        for k, item in enumerate(self.items):
            sheets.paragraph(item, mark=f"{k + 1}." if self.numbered else "•", gap=0.04)
        sheets.y += 0.06


@dataclass(frozen=True)
class Facts(Part):
    """Pairs of a question and its answer, below each other."""

    pairs: tuple[tuple[str, str], ...]

    def on_page(self) -> Markup:
        """A table without a head."""
        rows = (Markup('<tr><th scope="row">{}</th><td>{}</td></tr>').format(*pair) for pair in self.pairs)
        return Markup('<table class="facts">{}</table>').format(Markup("").join(rows))

    def on_sheets(self, sheets: Sheets) -> None:
        """Questions at the left, bold; answers beside them."""
        indent = min(max([1.1, *(width_of(question, TEXT, True) + 0.2 for question, _ in self.pairs)]), 0.5 * WIDTH)
        for question, answer in self.pairs:
            asked, said = wrapped(question, indent - 0.1, TEXT), wrapped(answer, WIDTH - indent, TEXT)
            sheets.need(LINE * max(len(asked), min(len(said), 3)))
            for k in range(max(len(asked), len(said))):
                sheets.need(LINE)
                if k < len(asked):
                    sheets.last.text(LEFT, sheets.y, asked[k], fontweight="bold")
                if k < len(said):
                    sheets.last.text(LEFT + indent, sheets.y, said[k])
                sheets.y += LINE
            sheets.y += 0.06


@dataclass(frozen=True)
class Table(Part):
    """Rows of text under `columns`; columns in `numbers` are set flush right, rows in `quiet` in grey, in `strong` bold.

    `bars`: for a column, a share of one for each row, drawn as a bar before the words; none where it is not a number.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: frozenset[int] = frozenset()
    quiet: frozenset[int] = frozenset()
    strong: frozenset[int] = frozenset()
    title: str = ""
    bars: Mapping[int, Sequence[float]] = field(default_factory=dict)

    def on_page(self) -> Markup:
        """A `<table>` that can be scrolled sideways where the window is narrow."""
        head = Markup("").join(
            Markup('<th scope="col"{}>{}</th>').format(self._flush(k), name) for k, name in enumerate(self.columns)
        )
        return Markup(
            '{}\n<div class="scroll">\n<table>\n<thead><tr>{}</tr></thead>\n<tbody>\n{}\n</tbody>\n</table>\n</div>'
        ).format(
            Markup("<h3>{}</h3>").format(self.title) if self.title else "",
            head,
            Markup("\n").join(self._row_on_page(k, row) for k, row in enumerate(self.rows)),
        )

    def _row_on_page(self, k: int, row: tuple[str, ...]) -> Markup:
        weight = ' class="quiet"' if k in self.quiet else ' class="strong"' if k in self.strong else ""
        cells = (Markup("<td{}>{}{}</td>").format(self._flush(i), self._bar_on_page(k, i), cell) for i, cell in enumerate(row))
        return Markup("<tr{}>{}</tr>").format(Markup(weight), Markup("").join(cells))

    def _flush(self, column: int) -> Markup:
        return Markup(' class="share"' if column in self.bars else ' class="number"' if column in self.numbers else "")

    def _bar_on_page(self, row: int, column: int) -> Markup:
        share = self._share(row, column)
        if share is None:
            return Markup("")
        return Markup(
            '<svg viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true"><rect width="100" height="8" class="whole"/>'
            '<rect width="{:.1f}" height="8" class="{}"/></svg>'
        ).format(100 * min(share, 1.0), "full" if share > 1 else "part")

    def _share(self, row: int, column: int) -> float | None:
        share = self.bars[column][row] if column in self.bars else np.nan
        return float(share) if np.isfinite(share) else None

    def on_sheets(self, sheets: Sheets) -> None:
        """The head is repeated on every sheet, no row is broken."""
        widths = column_widths(self)
        head = [wrapped(name, w, SMALL) for name, w in zip(self.columns, widths, strict=True)]
        room = [w - (BAR + 0.1 if k in self.bars else 0.0) for k, w in enumerate(widths)]
        rows = [[wrapped(cell, w, SMALL) for cell, w in zip(row, room, strict=True)] for row in self.rows]
        head_height = 0.14 * max(len(cell) for cell in head) + 0.07
        sheets.need(head_height + (0.2 if self.title else 0) + sum(_row_height(row) for row in rows[:3]))
        if self.title:
            sheets.last.text(LEFT, sheets.y, self.title, fontsize=TEXT, fontweight="bold")
            sheets.y += 0.19
        self._row_on_sheet(sheets, head, widths, None, color=SOFT, fontweight="bold")
        for k, row in enumerate(rows):
            if sheets.y + _row_height(row) > FOOT:
                sheets.need(FOOT)
                self._row_on_sheet(sheets, head, widths, None, color=SOFT, fontweight="bold")
            weight = "bold" if k in self.strong else "normal"
            self._row_on_sheet(sheets, row, widths, k, color=SOFT if k in self.quiet else INK, fontweight=weight)
        sheets.y += 0.12

    def _row_on_sheet(self, sheets: Sheets, cells: list[list[str]], widths: list[float], row: int | None, **style: Any) -> None:
        x = LEFT
        for k, (cell, width) in enumerate(zip(cells, widths, strict=True)):
            share = None if row is None else self._share(row, k)
            if share is not None:
                sheets.last.box(x, sheets.y, BAR, 0.06, SHADE)
                sheets.last.box(x, sheets.y, BAR * min(share, 1.0), 0.06, BAD if share > 1 else SIDE_COLOURS[0])
            for i, line in enumerate(cell):
                flush = {"ha": "right"} if k in self.numbers else {}
                at = x + width if k in self.numbers else x + (BAR + 0.1 if share is not None else 0.0)
                sheets.last.text(at, sheets.y + 0.14 * i, line, fontsize=SMALL, **flush, **style)
            x += width + GAP
        sheets.y += _row_height(cells)
        sheets.last.rule(sheets.y - 0.115, LEFT, x - GAP)

    def beginning(self) -> float:
        """Head and a few rows."""
        return 0.9


def table(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    text: Sequence[int] = (0,),
    quiet: Sequence[int] = (),
    strong: Sequence[int] = (),
    title: str = "",
    bars: Mapping[int, Sequence[float]] | None = None,
) -> Table:
    """A table whose columns are numbers but for those in `text`. Raises ValueError for a row of another length."""
    for row in rows:
        if len(row) != len(columns):
            raise ValueError(f"row {row} has {len(row)} entries for {len(columns)} columns")
    numbers = frozenset(range(len(columns))) - frozenset(text)
    return Table(tuple(columns), tuple(tuple(r) for r in rows), numbers, frozenset(quiet), frozenset(strong), title, bars or {})


def column_widths(table: Table) -> list[float]:
    """Width inch of each column: what its longest entry takes; the widest columns of words give way until all fit."""
    natural = []
    for k, name in enumerate(table.columns):
        cells = max((width_of(row[k], SMALL, k_row in table.strong) for k_row, row in enumerate(table.rows)), default=0.0)
        cells += BAR + 0.1 if k in table.bars else 0.0
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


def _row_height(cells: list[list[str]]) -> float:
    return 0.14 * max(len(cell) for cell in cells) + 0.045


@dataclass(frozen=True)
class Plot(Part):
    """A picture: `key` (letters and dashes, one in the report), caption, height inch, and the function that draws it."""

    key: str
    caption: str
    height: float
    draw: Draw

    def on_page(self) -> Markup:
        """A `<figure>` with the plot as SVG."""
        svg = Markup(inline_svg(self.key, self.caption, self.height, self.draw))
        return Markup('<figure class="plot">\n<figcaption>{}</figcaption>\n{}\n</figure>').format(self.caption, svg)

    def on_sheets(self, sheets: Sheets) -> None:
        """The caption above the plot, both on one sheet."""
        caption = wrapped(self.caption, WIDTH, SMALL + 0.5)
        sheets.need(self.height + 0.15 * len(caption) + 0.1)
        for line in caption:
            sheets.last.text(LEFT, sheets.y, line, fontsize=SMALL + 0.5, color=SOFT)
            sheets.y += 0.15
        bottom = A4_HEIGHT - (sheets.y - 0.06 + self.height)
        self.draw(Canvas(sheets.last.figure, self.height, LEFT, bottom))
        sheets.y += self.height + 0.12

    def beginning(self) -> float:
        """Caption and plot."""
        return self.height + 0.5


def made_from(hashes: Mapping[str, str]) -> Section:
    """The last section of a report: SHA-256 by name of the files that it was made from."""
    rows = table(("file", "SHA-256"), list(hashes.items()), text=(0, 1))
    return Section("Made from", (rows,) if hashes else ("No file was named.",))
