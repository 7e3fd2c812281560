"""The usual parts of a section: paragraph, list, facts, table, plot; each is itself on the page and on paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup

from ocp.report.paper import picture
from ocp.report.plotting import Draw, inline_svg
from ocp.report.section import Part, Section


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

    def on_paper(self) -> dict[str, Any]:
        """The words."""
        return {"is": "paragraph", "words": self.words}


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

    def on_paper(self) -> dict[str, Any]:
        """The items."""
        return {"is": "points", "items": self.items, "numbered": self.numbered}


@dataclass(frozen=True)
class Facts(Part):
    """Pairs of a question and its answer, below each other."""

    pairs: tuple[tuple[str, str], ...]

    def on_page(self) -> Markup:
        """A table without a head."""
        rows = (Markup('<tr><th scope="row">{}</th><td>{}</td></tr>').format(*pair) for pair in self.pairs)
        return Markup('<table class="facts">{}</table>').format(Markup("").join(rows))

    def on_paper(self) -> dict[str, Any]:
        """The pairs."""
        return {"is": "facts", "pairs": self.pairs}


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

    def on_paper(self) -> dict[str, Any]:
        """Its head, which is repeated on every sheet, and its rows."""
        sets = {name: sorted(getattr(self, name)) for name in ("numbers", "quiet", "strong")}
        bars = {str(k): [self._share(row, k) for row in range(len(self.rows))] for k in self.bars}
        return {"is": "table", "columns": self.columns, "rows": self.rows, "title": self.title, "bars": bars, **sets}


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


@dataclass(frozen=True)
class Plot(Part):
    """A picture: `key` (letters and dashes, one in the report), caption, height inch, and the function that draws it; `svg`: the
    picture where it is drawn already."""

    key: str
    caption: str
    height: float
    draw: Draw
    svg: str = field(default="", kw_only=True)

    def drawn(self) -> str:
        """The `<svg>` element, for page and paper."""
        return self.svg or inline_svg(self.key, self.caption, self.height, self.draw)

    def on_page(self) -> Markup:
        """A `<figure>` with the plot as SVG."""
        figure = Markup('<figure class="plot">\n<figcaption>{}</figcaption>\n{}\n</figure>')
        return figure.format(self.caption, Markup(self.drawn()))

    def on_paper(self) -> dict[str, Any]:
        """Caption and picture."""
        return {"is": "plot", "caption": self.caption, **picture(self.drawn())}


def made_from(hashes: Mapping[str, str]) -> Section:
    """The last section of a report: SHA-256 by name of the files that it was made from."""
    rows = table(("file", "SHA-256"), list(hashes.items()), text=(0, 1))
    return Section("Made from", (rows,) if hashes else ("No file was named.",))
