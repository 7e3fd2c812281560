"""Plots in the report's manner, on page and paper alike: axes with margins in inches, quiet frames, titles at the left.

In a page a plot stands as SVG without style attributes, addresses, or names that another plot uses. matplotlib writes style="..."
attributes, a style sheet of its own and the address of the SVG name space: the page's content security policy forbids the first
two, and an HTML page needs none of them. Every property becomes an attribute of its own, and letters stay letters, so that they
can be searched and read aloud.
"""

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from ocp.report.style import INK, SOFT, STYLE, printable
from robots.pose import Array

WIDTH = 6.87
"""inch: A4 less its margins. On the page a plot is scaled to the column."""
DOTS: dict[str, Any] = {"linestyle": "none", "marker": "o", "markeredgewidth": 0}
MANY = 1500  # points of a panel from which they are drawn as pixels: a page of 100 000 marks opens slowly


@dataclass(frozen=True)
class Canvas:
    """A matplotlib figure to draw in, `WIDTH` by `height` inch."""

    figure: Figure
    height: float

    def subplots(
        self,
        rows: int = 1,
        columns: int = 1,
        left: float = 0.5,
        right: float = 0.05,
        top: float = 0.22,
        bottom: float = 0.4,
        across: float = 0.45,
        down: float = 0.5,
        widths: Sequence[float] | None = None,
        **options: Any,
    ) -> Any:
        """Axes that fill the canvas, as `Figure.subplots` gives them; margins and gaps in inch, `widths` of the columns relative
        to each other."""
        panel_width = (WIDTH - left - right - across * (columns - 1)) / columns
        panel_height = (self.height - top - bottom - down * (rows - 1)) / rows
        edges = {"left": left / WIDTH, "right": 1 - right / WIDTH, "bottom": bottom / self.height, "top": 1 - top / self.height}
        gaps = {"wspace": across / panel_width, "hspace": down / panel_height}
        return self.figure.add_gridspec(rows, columns, width_ratios=widths, **edges, **gaps).subplots(**options)


def finished(figure: Figure) -> Figure:
    """A figure that nothing is added to: no room is looked for where an axis has no label, a tenth of the drawing."""
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            if not axis.get_label_text():
                axis.set_label_coords(0.0, 0.0)
    return figure


Draw = Callable[[Canvas], None]
"""Draws a plot; labels that come from a user go through `printable`."""


def panels(canvas: Canvas, rows: int, columns: int, **options: Any) -> list[list[Axes]]:
    """Rows of axes that fill a canvas; options as `Canvas.subplots`."""
    return [list(row) for row in canvas.subplots(rows, columns, squeeze=False, **options)]


def dressed(ax: Axes, title: str = "", x: str = "", y: str = "", grid: Literal["", "x", "y", "both"] = "y") -> Axes:
    """Title, labels and grid in the report's manner."""
    if title:
        ax.set_title(printable(title), fontsize=7.5, color=INK, loc="left", pad=3)
    if x:
        ax.set_xlabel(printable(x), fontsize=7, labelpad=2)
    if y:
        ax.set_ylabel(printable(y), fontsize=7, labelpad=2)
    ax.set_axisbelow(True)
    if grid:
        ax.grid(True, axis=grid)  # else a second call would take it away
    return ax


def dots(ax: Axes, x: Any, y: Any, colour: str, size: float = 2.2, **options: Any) -> None:
    """Points without lines; as pixels where they are many."""
    ax.plot(x, y, color=colour, markersize=size, rasterized=len(np.atleast_1d(x)) > MANY, **(DOTS | options))


def keys(ax: Axes, entries: list[tuple[str, str]], top: float = 1.0, **options: Any) -> None:
    """A legend in one line above the right end of the axes: (label, colour)."""
    handles = [ax.plot([], [], color=colour, markersize=3.5, **DOTS)[0] for _, colour in entries]
    settings: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, top), "ncols": len(entries), "frameon": False}
    settings |= {"fontsize": 6.5, "handletextpad": 0.1, "columnspacing": 1.2, "borderaxespad": 0.1, "labelcolor": SOFT}
    ax.legend(handles, [printable(label) for label, _ in entries], **(settings | options))


def log_scale(ax: Axes) -> None:
    """A logarithmic y axis with plain numbers at the powers of ten."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))


def reach(values: Array, least: float = 1e-6) -> float:
    """Half a symmetric range that holds all but the wildest values: 1.25 times the 98th percentile of their sizes."""
    sizes = np.abs(values[np.isfinite(values)])
    return max(1.25 * float(np.percentile(sizes, 98)), least) if len(sizes) else least


def running_median(x: Array, y: Array, bins: int = 12, fewest: int = 5) -> tuple[Array, Array]:
    """Medians of y over bins of equally many points; nothing where there would be fewer than two bins."""
    bins = min(bins, len(x) // fewest)
    if bins < 2:
        return np.array([]), np.array([])
    parts = np.array_split(np.argsort(x, kind="stable"), bins)
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])


def envelope(x: Array, y: Array, bins: int = 500) -> tuple[Array, Array]:
    """A curve of at most 2 `bins` points that keeps every peak: least and largest known value of each bin, one that is not known
    where none is."""
    if len(x) <= 2 * bins:
        return np.asarray(x, float), np.asarray(y, float)
    edges, y = np.linspace(0, len(x), bins + 1).astype(int).tolist(), np.asarray(y, float)
    pick = []
    for a, b in pairwise(edges):
        low, high = (np.where(np.isfinite(y[a:b]), y[a:b], end) for end in (np.inf, -np.inf))
        pick += sorted({a + int(low.argmin()), a + int(high.argmax())})
    index = np.array(pick)
    return np.asarray(x, float)[index], np.asarray(y, float)[index]


_SVG_STYLE = STYLE | {"svg.fonttype": "none", "svg.hashsalt": "report"}
_STYLE = re.compile(r' style="([^"]*)"')
_FONT = re.compile(r"^(?:(italic|oblique) )?(?:(bold|\d+) )?([\d.]+px) (.+)$")
_LONG_NUMBER = re.compile(r"(-?\d+\.\d\d)\d+")  # a hundredth of a point is finer than any screen
_MARK = re.compile(r'<use (href="#[^"]+" x="[^"]+" y="[^"]+")((?: [\w-]+="[^"]*")*)/>')
_REFERENCE = re.compile(r'(?:href="#|url\(#)([^")]+)')


def inline_svg(key: str, caption: str, height: float, draw: Draw) -> str:
    """The `<svg>` element of a plot of `height` inch, `WIDTH` wide; `key` begins its names, `caption` is read aloud."""
    with matplotlib.rc_context(_SVG_STYLE):
        figure = Figure(figsize=(WIDTH, height))
        draw(Canvas(figure, height))
        buffer = io.StringIO()
        finished(figure).savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.S)
    text = _STYLE.sub(lambda found: _attributes(found.group(1)), text)
    text = text.replace("xlink:href=", "href=")
    text = re.sub(r"<[^>]+>", lambda tag: _LONG_NUMBER.sub(r"\1", tag.group(0)), text)
    text = re.sub(r">\s+<", "><", _gathered(_renamed(text, key)))
    return _headed(text, caption).strip()


def _attributes(style: str) -> str:
    """The declarations of a style attribute as attributes of their own."""
    found: dict[str, str] = {}
    for declaration in style.split(";"):
        name, _, value = declaration.partition(":")
        name, value = name.strip(), value.strip()
        if not name:
            continue
        font = _FONT.match(value) if name == "font" else None
        if font:
            found |= {"font-size": font.group(3)} | ({"font-weight": font.group(2)} if font.group(2) else {})
        elif name not in ("font", "font-family"):  # the page's own
            found[name] = value
    return "".join(f' {name}="{value}"' for name, value in found.items())


def _renamed(text: str, key: str) -> str:
    """Names that are referred to become the plot's key and a number, the others go."""
    short = {name: f"{key}-{k + 1}" for k, name in enumerate(dict.fromkeys(_REFERENCE.findall(text)))}

    def own(found: re.Match[str]) -> str:
        return f' id="{short[found.group(1)]}"' if found.group(1) in short else ""

    text = re.sub(r' id="([^"]*)"', own, text)
    return _REFERENCE.sub(lambda found: found.group(0).replace(found.group(1), short[found.group(1)]), text)


def _gathered(text: str) -> str:
    """What neighbouring marks share stands once, in a group around them: most of a scatter plot is that."""

    def group(found: re.Match[str]) -> str:
        marks = _MARK.findall(found.group(0))
        if len({shared for _, shared in marks}) > 1:
            return found.group(0)
        return f"<g{marks[0][1]}>" + "".join(f"<use {place}/>" for place, _ in marks) + "</g>"

    return re.sub(rf"(?:{_MARK.pattern}\s*){{2,}}", group, text)


def _headed(text: str, caption: str) -> str:
    """The element's own attributes: a view box to scale, a role and a name for those who listen."""
    box = re.search(r'viewBox="([^"]*)"', text)
    assert box is not None
    head = (
        f'<svg viewBox="{box.group(1)}" role="img" aria-label="{escape(printable(caption), quote=True)}" '
        'stroke-linejoin="round" stroke-linecap="butt">'
    )
    return head + text[text.index(">") + 1 :]
