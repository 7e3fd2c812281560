"""The timed program as a table: one row per emitted point, air moves included, with what the model says of each."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.plan.motion.motion import Motion, Segment
from robots.pose import Array

CONTACT_COLUMNS = ("p", "n", "t")


@dataclass(frozen=True)
class Timeline:
    """Rows of plan.csv in SI; m points. nan where there is no contact.

    time (m,) s; segment (m,) index into Motion.segments; line (m,) of the blade, 0 on the way between passes; contact
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


def build_timeline(motion: Motion, times: list[Array]) -> Timeline:
    """The rows at `times` (one array of seconds since the segment's start for each segment, ends included)."""
    parts = [_rows(motion, i, segment, t) for i, (segment, t) in enumerate(zip(motion.segments, times, strict=True))]
    return Timeline(*(np.concatenate([getattr(part, name) for part in parts]) for name in Timeline.__dataclass_fields__))


def _rows(motion: Motion, index: int, segment: Segment, t: Array) -> Timeline:
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
