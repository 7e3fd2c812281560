"""What the page's script gets: one JSON object with the large arrays as base64 of little-endian numbers.

The text is made safe to stand inside a <script> element whatever a user's file is called.
"""

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.plan.report.charts import LEFT, RIGHT, WIDTH
from ocp.plan.report.data import CellAnimation, PlanReport
from ocp.plan.report.quantities import QUANTITIES, colour_range, values
from ocp.plan.report.surface import paint_blade, pass_spacing
from ocp.report.colours import NOT_GROUND, VIRIDIS

MAX_FRAMES = 600
"""Frames of the animation that are shipped; between them the page interpolates."""
MAX_SAMPLES = 2000
"""Motion samples shipped for the readout: one per pixel of a wide screen."""


def encode(array: ArrayLike, dtype: str = "<f4") -> dict[str, Any]:
    """Array as {"dtype", "shape", "data"}: numbers little-endian in row order, base64."""
    packed = np.ascontiguousarray(array, dtype=dtype)
    return {
        "dtype": dtype,
        "shape": list(packed.shape),
        "data": base64.b64encode(packed.tobytes()).decode("ascii"),
    }


def script_json(payload: Any) -> str:
    """JSON that cannot end the <script> element or open a comment in it: < > & are escaped.

    Infinities and nan are not JSON: ValueError. In arrays they travel as bits.
    """
    text = json.dumps(payload, ensure_ascii=True, allow_nan=False, sort_keys=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def page_payload(report: PlanReport) -> dict[str, Any]:
    """Everything the page's script draws and reads out, see scene.js and viewer.js for its use."""
    return {
        "target": float(report.target_force),
        "colours": VIRIDIS,
        "notGround": NOT_GROUND,
        "quantities": [
            {
                "key": item.key,
                "label": item.label,
                "unit": item.unit,
                "decimals": item.decimals,
                "range": [float(bound) for bound in colour_range(report, item)],
                "values": encode(values(report, item)),
            }
            for item in QUANTITIES
        ],
        "blade": _blade(report),
        "passes": _passes(report),
        "motion": _motion(report),
        "cell": _cell(report.animation),
        "panel": {
            "width": WIDTH,
            "left": LEFT,
            "span": WIDTH - LEFT - RIGHT,
            "longest": max(float(item.s[-1]) for item in report.passes) or 1e-3,
        },
    }


def _blade(report: PlanReport) -> dict[str, Any]:
    painted = paint_blade(report.vertices, report.faces, report.passes, report.pass_spacing)
    index = "<u2" if max(len(painted.vertices), int(painted.waypoint.max()) + 1) < 2**16 else "<u4"
    return {
        "vertices": encode(painted.vertices),
        "faces": encode(painted.faces, index),
        "waypoint": encode(painted.waypoint, index),
        "weight": encode(np.round(255 * painted.weight), "<u1"),
    }


def _passes(report: PlanReport) -> dict[str, Any]:
    def joined(name: str) -> dict[str, Any]:
        return encode(np.concatenate([getattr(item, name) for item in report.passes]))

    counts = [len(item.s) for item in report.passes]
    return {
        "line": [int(item.line) for item in report.passes],
        "side": [item.side for item in report.passes],
        "first": [int(start) for start in np.concatenate([[0], np.cumsum(counts)])],
        "spacing": report.pass_spacing if report.pass_spacing > 0 else pass_spacing(report.passes),
        "p": joined("p"),
        "n": joined("n"),
        "t": joined("t"),
        "s": joined("s"),
    }


def _motion(report: PlanReport) -> dict[str, Any]:
    motion = report.motion
    pick = _spread(len(motion.time), MAX_SAMPLES)
    return {
        "time": encode(motion.time[pick]),
        "q_deg": encode(np.degrees(motion.q[pick])),
        "contact": encode(np.asarray(motion.contact)[pick].astype(bool), "<u1"),
        "line": encode(np.asarray(motion.line)[pick], "<u2"),
        "feed_mm_s": encode(1e3 * np.asarray(motion.feed)[pick]),
        "force": encode(motion.force[pick]),
        "force_sd": encode(motion.force_sd[pick]),
    }


def _cell(animation: CellAnimation) -> dict[str, Any]:
    pick = _spread(len(animation.time), MAX_FRAMES)
    wheel = animation.wheel
    return {
        "time": encode(animation.time[pick]),
        "links": encode(animation.T_base_link[pick][:, :, :3, :]),
        "blade": encode(animation.T_base_blade[pick][:, :3, :]),
        "bladeInFlange": encode(animation.T_flange_blade[:3]),
        "capsules": [
            {
                "link": int(link),
                "p0": [float(x) for x in p0],
                "p1": [float(x) for x in p1],
                "radius": float(radius),
            }
            for link, p0, p1, radius in animation.capsules
        ],
        "wheel": {
            "centre": [float(x) for x in wheel.centre],
            "axis": [float(x) for x in wheel.axis],
            "direction": [float(x) for x in wheel.contact_direction],
            "radius": float(wheel.radius),
            "width": float(wheel.width),
        },
    }


def _spread(count: int, most: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    """At most `most` indices from first to last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
