"""The TIME_BLOCK writer: a spline through axes at given times (KRL.md, "Motion")."""

import numpy as np

from trajectories.krl.values import FILE_LIMITS, axes_text, fixed
from trajectories.program.program import TimedSpline


def timed_spline(block: TimedSpline) -> list[str]:
    """PTP_SPLINE with one time block: a point, START, then point and PART in turns, and END with the sum of the parts."""
    unit = FILE_LIMITS.time_unit
    lines = ["PTP_SPLINE", f"  SPTP {axes_text(block.q[0])}", "  TIME_BLOCK START"]
    # Times are rounded, not steps, so that the parts add up to the end in the printed decimals.
    ticks = np.rint((np.asarray(block.t) - block.t[0]) / unit).astype(int)
    for q, part in zip(block.q[1:], np.diff(ticks), strict=True):
        lines += [f"  SPTP {axes_text(q)}", f"  TIME_BLOCK PART={fixed(part * unit, 5)}"]
    return [*lines, f"  TIME_BLOCK END={fixed(ticks[-1] * unit, 5)}", "ENDSPLINE"]
