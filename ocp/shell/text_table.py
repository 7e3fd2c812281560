"""Tables for a terminal."""

import textwrap
from collections.abc import Sequence
from functools import partial
from itertools import zip_longest

NARROWEST = 12  # characters of a column


def table_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of rows, the head first: columns as wide as the rows below it need, the head over as many lines as it needs then."""
    widths = [max(*(len(row[k]) for row in rows[1:]), NARROWEST) for k in range(len(rows[0]))]
    wrap = partial(textwrap.wrap, break_long_words=False, break_on_hyphens=False)
    head = zip_longest(*map(wrap, rows[0], widths), fillvalue="")
    return ["  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in (*head, *rows[1:])]
