"""The section "Blade and cell": the scene that can be turned and played on the page, a still picture of the blade on paper."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ocp.model.cell import Wheel
from ocp.plan.report.force import PANEL
from ocp.plan.report.plan_report import PlanReport
from ocp.plan.report.quantities import QUANTITIES, colour_range, values_along
from ocp.plan.report.surface import PaintedBlade, draw_blade, paint_blade, pass_spacing
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas
from ocp.report.scene_kit import encode, encode_index, scene_script, scene_style, script_json
from ocp.report.section import Section
from ocp.report.style import COLOUR_MAP, LEFT_OUT, NOT_GROUND, VIRIDIS
from robots.robot import Robot

_VIEWER = Path(__file__).parent / "viewer"
LEFT_OUT_KEY = '<span class="swatch left"></span><span>left out</span>'
MAX_SAMPLES = 2000
"""Motion samples shipped for the readout: one per pixel of a wide screen."""


def scene_section(report: PlanReport) -> Section:
    """Blade, passes, arm and wheel in three dimensions."""
    lost = [one for one in report.left_out if len(one.s)]
    painted = paint_blade(report.vertices, report.faces, report.passes, report.pass_spacing, lost)
    item = QUANTITIES[0]
    grey = "grey is not ground, red was left out" if lost else "grey is not ground"
    caption = f"{item.label} in {item.unit}; {grey}. In report.html the blade can be turned and the cell moves."

    def still(canvas: Canvas) -> None:
        toward = report.passes[0].n.mean(axis=0)
        draw_blade(canvas, painted, values_along(report, item), colour_range(report, item), COLOUR_MAP, toward, item.unit)

    return Section(
        "Blade and cell",
        (SceneView("blade", caption, 2.6, still, report, painted),),
        style=scene_style(),
        script=scene_script([_VIEWER / "viewer.js", _VIEWER / "page.js"]),
    )


@dataclass(frozen=True)
class SceneView(Plot):
    """The plan to be looked at from all sides; on paper a still picture of its blade from both sides, coloured by the force.

    `painted`: the blade, ready for drawing.
    """

    report: PlanReport
    painted: PaintedBlade

    def on_page(self) -> Markup:
        """Canvas, controls and the script's data."""
        option = Markup('<option value="{}">{}</option>')
        options = (option.format(q.key, f"{q.label}, {q.unit}" if q.unit else q.label) for q in QUANTITIES)
        band = Markup('<rect x="{:.3f}" y="0" width="{:.3f}" height="6"><title>line {}</title></rect>')
        time = self.report.motion.time
        share = 100 / float(time[-1] - time[0])
        bands = (band.format(share * (a - float(time[0])), share * (b - a), line) for line, a, b in self.report.contact_spans())
        return Markup((_VIEWER / "scene.html").read_text(encoding="utf-8")).format(
            options=Markup("\n").join(options),
            bands=Markup("\n").join(bands),
            left_out=Markup(LEFT_OUT_KEY if self.painted.left.any() else ""),
            payload=Markup(script_json(page_payload(self.report, self.painted))),
        )


def page_payload(report: PlanReport, painted: PaintedBlade) -> dict[str, Any]:
    """Everything the page's script draws and reads out, see scene.js and viewer.js for its use."""
    return {
        "target": float(report.target_force),
        "colours": VIRIDIS,
        "notGround": NOT_GROUND,
        "leftOut": LEFT_OUT,
        "quantities": [
            {
                "key": item.key,
                "label": item.label,
                "unit": item.unit,
                "decimals": item.decimals,
                "range": [float(bound) for bound in colour_range(report, item)],
                "values": encode(values_along(report, item)),
            }
            for item in QUANTITIES
        ],
        "blade": _blade(painted),
        "passes": _passes(report),
        "motion": _motion(report),
        "cell": _cell(report),
        "panel": {
            "width": PANEL.width,
            "left": PANEL.left,
            "span": PANEL.width - PANEL.left - PANEL.right,
            "longest": max(float(item.s[-1]) for item in report.passes) or 1e-3,
        },
    }


def _blade(painted: PaintedBlade) -> dict[str, Any]:
    count = max(len(painted.vertices), int(painted.waypoint.max()) + 1)
    return {
        "vertices": encode(painted.vertices),
        "faces": encode_index(painted.faces[~painted.left], count),
        "left": encode_index(painted.faces[painted.left], count),
        "waypoint": encode_index(painted.waypoint, count),
        "weight": encode(np.round(255 * painted.weight), "<u1"),
    }


def _passes(report: PlanReport) -> dict[str, Any]:
    counts = [len(item.s) for item in report.passes]
    return {
        "line": [int(item.line) for item in report.passes],
        "side": [item.side for item in report.passes],
        "first": [int(start) for start in np.concatenate([[0], np.cumsum(counts)])],
        "spacing": report.pass_spacing if report.pass_spacing > 0 else pass_spacing(report.passes),
    } | {name: encode(np.concatenate([getattr(item, name) for item in report.passes])) for name in "pnts"}


def _motion(report: PlanReport) -> dict[str, Any]:
    motion = report.motion
    count = len(motion.time)
    pick = np.linspace(0, count - 1, min(count, MAX_SAMPLES)).round().astype(int)
    return {
        "time": encode(motion.time[pick]),
        "q_deg": encode(np.degrees(motion.q[pick])),
        "contact": encode(np.asarray(motion.contact)[pick].astype(bool), "<u1"),
        "line": encode(np.asarray(motion.line)[pick], "<u2"),
        "feed_mm_s": encode(1e3 * np.asarray(motion.feed)[pick]),
        "force": encode(motion.force[pick]),
        "force_sd": encode(motion.force_sd[pick]),
    }


def _cell(report: PlanReport) -> dict[str, Any]:
    animation, wheel = report.animation, report.wheel
    return {
        "time": encode(animation.time),
        "links": encode(animation.T_base_link[:, :, :3, :]),
        "blade": encode((animation.T_base_link[:, -1] @ animation.T_flange_blade)[:, :3, :]),
        "bladeInFlange": encode(animation.T_flange_blade[:3]),
        "capsules": arm_drawn(report.robot),
        "wheel": wheel_drawn(wheel),
    }


def arm_drawn(robot: Robot) -> list[dict[str, Any]]:
    """Capsules of an arm, each in its link's frame."""
    return [
        {"link": int(link), "p0": [float(x) for x in p0], "p1": [float(x) for x in p1], "radius": float(radius)}
        for link, p0, p1, radius in robot.link_shapes
    ]


def wheel_drawn(wheel: Wheel) -> dict[str, Any]:
    """A wheel in the base frame."""
    return {
        "centre": wheel.centre.tolist(),
        "axis": wheel.axis.tolist(),
        "direction": wheel.contact_direction.tolist(),
        "radius": wheel.radius,
        "width": wheel.width,
    }
