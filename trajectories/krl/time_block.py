"""The TIME_BLOCK writer: a spline through axes or poses at given times (KRL.md, "Motion")."""

from collections.abc import Sequence

import numpy as np

from robots.pose import Array
from trajectories.krl.values import FILE_LIMITS, fixed


def time_block(block: str, word: str, points: Sequence[str], t: Array) -> list[str]:
    """A `block` with one time block in it: a point `word`, START, then point and PART in turns, END with the sum of the parts."""
    unit = FILE_LIMITS.time_unit
    lines = [block, f"  {word} {points[0]}", "  TIME_BLOCK START"]
    # Times are rounded, not steps, so that the parts add up to the end in the printed decimals.
    ticks = np.rint((np.asarray(t) - t[0]) / unit).astype(int)
    for point, part in zip(points[1:], np.diff(ticks), strict=True):
        lines += [f"  {word} {point}", f"  TIME_BLOCK PART={fixed(part * unit, 5)}"]
    return [*lines, f"  TIME_BLOCK END={fixed(ticks[-1] * unit, 5)}", "ENDSPLINE"]
