"""The tables of the report as rows of text: axes against their limits, and one row a pass."""

from dataclasses import dataclass

import numpy as np

from ocp.plan.report.data import PlanReport
from robots.pose import Array


@dataclass(frozen=True)
class LimitRow:
    """Use of one kind of limit by one axis: "A1", kind, the extreme value, the limit, their ratio (1 = at
    the limit).
    """

    axis: str
    kind: str
    value: str
    limit: str
    ratio: float
    time: float


def limit_rows(report: PlanReport) -> tuple[LimitRow, ...]:
    """Six axes times position, speed, acceleration and torque over the whole motion, air moves included."""
    motion, limits = report.motion, report.limits
    rows = []
    for axis in range(6):
        rows.append(_position_row(axis, motion.time, motion.q[:, axis], limits.q_min[axis], limits.q_max[axis]))
        for kind, unit, factor, sampled, limit in (
            ("speed", "deg/s", 180 / np.pi, motion.qd, limits.qd_max),
            ("acceleration", "rad/s²", 1.0, motion.qdd, limits.qdd_max),
            ("torque", "N m", 1.0, motion.torque, limits.torque_max),
        ):
            rows.append(_peak_row(f"A{axis + 1}", kind, unit, factor, motion.time, sampled[:, axis], limit[axis]))
    return tuple(rows)


def _position_row(axis: int, time: Array, q: Array, low: float, high: float) -> LimitRow:
    # Ratio 1 at either end and 0 in the middle of the range.
    use = np.abs(2 * q - (low + high)) / (high - low)
    worst = int(np.argmax(np.nan_to_num(use)))
    value = f"{np.degrees(q.min()):.1f} .. {np.degrees(q.max()):.1f} deg"
    limit = f"{np.degrees(low):.1f} .. {np.degrees(high):.1f} deg"
    return LimitRow(f"A{axis + 1}", "position", value, limit, float(use[worst]), float(time[worst]))


def _peak_row(axis: str, kind: str, unit: str, factor: float, time: Array, sampled: Array, limit: float) -> LimitRow:
    size = np.abs(np.nan_to_num(sampled))
    worst = int(np.argmax(size))
    if not np.isfinite(limit) or limit <= 0:
        return LimitRow(axis, kind, f"{size[worst] * factor:.3g} {unit}", "none", float("nan"), float(time[worst]))
    text = f"{size[worst] * factor:.{0 if kind == 'torque' else 2}f} {unit}"
    bound = f"{limit * factor:.{0 if kind == 'torque' else 2}f} {unit}"
    return LimitRow(axis, kind, text, bound, float(size[worst] / limit), float(time[worst]))


@dataclass(frozen=True)
class PassRow:
    """One pass in text: length mm, force from .. to N, largest sd N, feed mm/s, largest use of a limit."""

    line: str
    side: str
    length: str
    waypoints: str
    force: str
    force_sd: str
    feed: str
    limit_ratio: str


def pass_rows(report: PlanReport) -> tuple[PassRow, ...]:
    """One row a pass, in the order of the program."""
    return tuple(
        PassRow(
            line=str(item.line),
            side=item.side,
            length=f"{1e3 * item.s[-1]:.1f}",
            waypoints=str(len(item.s)),
            force=_span(item.force, 2),
            force_sd=_largest(item.force_sd, 2),
            feed=_span(1e3 * np.asarray(item.feed), 1),
            limit_ratio=_largest(item.limit_ratio, 2),
        )
        for item in report.passes
    )


def _span(sampled: Array, decimals: int) -> str:
    known = sampled[np.isfinite(sampled)]
    if len(known) == 0:
        return "not known"
    low, high = f"{known.min():.{decimals}f}", f"{known.max():.{decimals}f}"
    return low if low == high else f"{low} .. {high}"


def _largest(sampled: Array, decimals: int) -> str:
    known = sampled[np.isfinite(sampled)]
    return f"{known.max():.{decimals}f}" if len(known) else "not known"
