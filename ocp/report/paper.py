"""A report on paper: A4 sheets as PDF, set by typst from paper.typ.

The report goes there as data, so that no word of a user's is read as markup; pictures are those of the page. The font is the one
that comes with matplotlib: equal reports give equal bytes on every machine.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typst
from matplotlib.font_manager import FontProperties, findfont

from ocp.report.style import BAD, INK, RULE, SHADE, SIDE_COLOURS, SOFT, printable

TEMPLATE = Path(__file__).parent / "paper.typ"
_COLOURS = {"ink": INK, "soft": SOFT, "rule": RULE, "shade": SHADE, "share": SIDE_COLOURS[0], "over": BAD}
_WORD = re.compile(r"\S+")
_STEP = 16  # characters after which a long word may be broken: longer than a hash, in one of several columns than
_LONGEST, _LONGEST_IN_COLUMN = 64, 32
_MAY_BREAK = "\u200b"


def sheets(report: Mapping[str, Any], tone: str, ground: str) -> bytes:
    """The PDF of a report as data: title, kind, foot, verdict, sentence, facts as pairs, sections of a title and parts as
    `Part.on_paper` gives them. `tone`, `ground`: colours of the verdict's box. No date, no place."""
    made = compiler(report, tone, ground).compile(format="pdf")
    assert isinstance(made, bytes)
    return made


def compiler(report: Mapping[str, Any], tone: str, ground: str) -> typst.Compiler:
    """What makes the sheets of it, in any format of typst's. Raises ValueError: matplotlib's font is not there."""
    colours = _COLOURS | {"tone": tone, "ground": ground}
    named = (FontProperties(family="DejaVu Sans", weight=weight) for weight in ("normal", "bold"))
    fonts = sorted({str(Path(findfont(font, fallback_to_default=False)).parent) for font in named})
    return typst.Compiler(
        TEMPLATE.read_bytes(),
        root=TEMPLATE.parent,
        font_paths=typst.Fonts(include_system_fonts=False, include_embedded_fonts=False, font_paths=list(fonts)),
        ignore_system_fonts=True,
        sys_inputs={"report": json.dumps({**_shown(report), "colours": colours}, allow_nan=False)},
    )


def picture(svg: str) -> dict[str, str]:
    """A picture of a part: a whole SVG file of an `<svg>` element of the page."""
    spaces = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" font-family="DejaVu Sans"'
    svg = re.sub(r"<[^>]+>", lambda tag: tag.group(0).replace(' href="', ' xlink:href="'), svg)
    return {"picture": svg.replace("<svg", f"<svg {spaces}", 1)}


def _shown(value: Any, longest: int = _LONGEST) -> Any:
    """The same with words that the font can show, long ones with places to break at; pictures as they are."""
    if isinstance(value, str):
        return _WORD.sub(lambda word: _breakable(word.group(0), longest), printable(value))
    if isinstance(value, Mapping):
        longest = _LONGEST_IN_COLUMN if len(value.get("columns", ())) > 2 else longest
        return {key: item if key == "picture" else _shown(item, longest) for key, item in value.items()}
    return [_shown(item, longest) for item in value] if isinstance(value, (list, tuple)) else value


def _breakable(word: str, longest: int) -> str:
    return word if len(word) <= longest else _MAY_BREAK.join(word[k : k + _STEP] for k in range(0, len(word), _STEP))
