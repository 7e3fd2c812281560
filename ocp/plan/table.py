"""plan.csv: the timeline at the file boundary, millimetres and degrees."""

from pathlib import Path

import numpy as np

from ocp.plan.motion.timeline import Timeline
from robots.pose import Array


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
