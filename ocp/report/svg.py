"""A plot as SVG that stands inside a page: no style attributes, no addresses, names that no other plot uses.

matplotlib writes style="..." attributes, a style sheet of its own and the address of the SVG name space. The page's
content security policy forbids the first two, and an HTML page needs none of them: every property becomes an attribute of its
own, and letters stay letters, so that they can be searched and read aloud.
"""

import io
import re
from html import escape

import matplotlib
from matplotlib.figure import Figure

from ocp.report.plotting import WIDTH, Canvas, Draw
from ocp.report.style import STYLE

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
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
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
        f'<svg viewBox="{box.group(1)}" role="img" aria-label="{escape(caption, quote=True)}" '
        'stroke-linejoin="round" stroke-linecap="butt">'
    )
    return head + text[text.index(">") + 1 :]
