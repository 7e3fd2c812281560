"""What page and paper share: colours, matplotlib's settings, words that the font can show."""

from functools import cache
from typing import Any

from matplotlib.colors import LinearSegmentedColormap
from matplotlib.font_manager import FontProperties, findfont, get_font

INK, SOFT, RULE = "#17212b", "#52606d", "#d9dee4"
CURVE, TARGET, LIMIT, SHADE = "#123e5c", "#b3540a", "#9c2f0a", "#e6edf3"
BEFORE = "#8a94a0"  # grey of everything before calibration
AFTER = CURVE
BAD = LIMIT  # outliers
SIDE_COLOURS = ("#1f5f8b", "#c8702a", "#4f4f4f", "#7a5195")
"""Blue and orange differ in lightness too, so a grey copy still tells the sides apart."""
NOT_GROUND = "#c9ced4"
"""Grey of surface that no pass touches; it has no hue, so it is not mistaken for a value."""
LEFT_OUT = "#d1300f"
"""Of surface that was asked for and cannot be ground: no colour of a value."""
VIRIDIS = (
    "#440154 #48186a #472d7b #424086 #3b528b #33638d #2c728e #26828e #21918c "
    "#1fa088 #28ae80 #3fbc73 #5ec962 #84d44b #addc30 #d8e219 #fde725"
).split()
"""Every sixteenth colour of viridis (Smith and van der Walt 2015, CC0): even steps, colour-blind safe."""
COLOUR_MAP = LinearSegmentedColormap.from_list("report", list(VIRIDIS))
STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib: the same glyphs on every machine
    "font.size": 8,
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
    "xtick.major.size": 2,
    "ytick.major.size": 2,
    "xtick.major.pad": 2,
    "ytick.major.pad": 2,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "axes.titley": 1.0,  # a fixed place: looking for a free one takes a sixth of the time
}
"""matplotlib settings in force while plots are drawn."""


@cache
def _known_characters() -> frozenset[int]:
    return frozenset(get_font(findfont(FontProperties(family="DejaVu Sans"))).get_charmap())


def printable(words: str) -> str:
    """The words with a box for every character that the font lacks, a space for characters that control or turn what follows."""
    known = _known_characters()
    return "".join(" " if not c.isprintable() else c if ord(c) in known else "\u25a1" for c in words)


def shorten(words: str, most: int) -> str:
    """At most `most` characters, the middle replaced by an ellipsis."""
    return words if len(words) <= most else f"{words[: most // 2]}…{words[len(words) - (most - 1) // 2 :]}"
