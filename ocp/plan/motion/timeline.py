"""The timed program as a table: one row per emitted point, air moves included, with what the model says of each."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.plan.motion.motion import MotionSegment, PlannedMotion
from robots.pose import Array

CONTACT_COLUMNS = ("p", "n", "t")


@dataclass(frozen=True)
class Timeline:
    """Rows of plan.csv in SI; m points. nan where there is no contact.

    time (m,) s; segment (m,) index into PlannedMotion.segments; line (m,) of the blade, 0 on the way between passes; contact
    (m,) bool; q, qd, qdd (m, 6); p, n, t (m, 3) blade frame; s (m,) m; feed (m,) m/s; force, force_sd (m,) N;
    interference (m,) m; limit_ratio (m,).
    """

    time: Array
    segment: Array
    line: Array
    contact: Array
    q: Array
    qd: Array
    qdd: Array
    p: Array
    n: Array
    t: Array
    s: Array
    feed: Array
    force: Array
    force_sd: Array
    interference: Array
    limit_ratio: Array


def build_timeline(motion: PlannedMotion, times: list[Array]) -> Timeline:
    """The rows at `times` (one array of seconds since the segment's start for each segment, ends included)."""
    parts = [_rows(motion, i, segment, t) for i, (segment, t) in enumerate(zip(motion.segments, times, strict=True))]
    return Timeline(*(np.concatenate([getattr(part, name) for part in parts]) for name in Timeline.__dataclass_fields__))


def _rows(motion: PlannedMotion, index: int, segment: MotionSegment, t: Array) -> Timeline:
    trajectory = segment.trajectory
    m = len(t)
    contact = segment.kind == "contact"
    vector, number = np.full((m, 3), np.nan), np.full(m, np.nan)
    values: dict[str, Array] = dict.fromkeys(("p", "n", "t"), vector)
    values |= dict.fromkeys(("s", "feed", "force", "force_sd", "interference"), number)
    line = 0
    if segment.kind != "travel":
        solved = motion.passes[segment.place]
        line = solved.problem.path.line
    if contact:
        path, s = solved.problem.path, trajectory.s(t)
        stations = path.s
        for name in CONTACT_COLUMNS:
            values[name] = np.asarray(CubicSpline(stations, getattr(path, name))(s))
        for name in ("n", "t"):
            values[name] = values[name] / np.linalg.norm(values[name], axis=1, keepdims=True)
        curves = np.column_stack([solved.solution.force, solved.evaluation.force_sd, solved.evaluation.delta])
        force, sd, delta = CubicSpline(stations, curves)(s).T
        values |= {"s": s, "feed": trajectory.feed(t), "force": force, "force_sd": sd, "interference": delta}
    return Timeline(
        time=segment.start + t,
        segment=np.full(m, index),
        line=np.full(m, line),
        contact=np.full(m, contact),
        q=trajectory.q(t),
        qd=trajectory.qd(t),
        qdd=trajectory.qdd(t),
        limit_ratio=trajectory.limit_ratio(t),
        **values,
    )


def write_plan_csv(timeline: Timeline, path: Path) -> None:
    """Write plan.csv as FORMATS.md asks; cells without meaning off contact stay empty."""
    degrees = 180 / np.pi
    columns: list[tuple[str, Array, int]] = [
        ("time_s", timeline.time, 6),
        ("line", timeline.line, 0),
        ("contact", timeline.contact.astype(int), 0),
        *((f"q{i + 1}_deg", timeline.q[:, i] * degrees, 6) for i in range(6)),
        *((f"qd{i + 1}_deg_s", timeline.qd[:, i] * degrees, 5) for i in range(6)),
        *((f"qdd{i + 1}_deg_s2", timeline.qdd[:, i] * degrees, 4) for i in range(6)),
        *((f"p{a}_mm", timeline.p[:, i] * 1e3, 5) for i, a in enumerate("xyz")),
        *((f"n{a}", timeline.n[:, i], 8) for i, a in enumerate("xyz")),
        *((f"t{a}", timeline.t[:, i], 8) for i, a in enumerate("xyz")),
        ("s_mm", timeline.s * 1e3, 4),
        ("feed_mm_s", timeline.feed * 1e3, 4),
        ("fn_N", timeline.force, 5),
        ("fn_sd_N", timeline.force_sd, 5),
        ("interference_mm", timeline.interference * 1e3, 6),
        ("limit_ratio", timeline.limit_ratio, 6),
    ]
    texts = [[_cell(v, digits) for v in values] for _, values, digits in columns]
    lines = [",".join(name for name, _, _ in columns), *(",".join(row) for row in zip(*texts, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def _cell(value: float, digits: int) -> str:
    if not np.isfinite(value):
        return ""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text
