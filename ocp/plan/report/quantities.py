"""What can be shown along the passes: label, unit, factor from SI and the range its colours span.

Page and print take names, units and ranges from here, so the same colour means the same value in both.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ocp.plan.report.plan_report import PlanReport
from ocp.report.style import SIDE_COLOURS
from robots.pose import Array


@dataclass(frozen=True)
class Quantity:
    """A value along the passes; `span`: smallest colour range (display units) about `centre`."""

    key: str
    label: str
    unit: str
    factor: float
    decimals: int
    span: float
    centre: str = ""


QUANTITIES = (
    Quantity("force", "Predicted force", "N", 1.0, 2, 0.4, "target"),
    Quantity("force_sd", "Standard deviation of the force", "N", 1.0, 2, 0.1, "zero"),
    Quantity("compliance_nn", "Blade compliance", "µm/N", 1e6, 2, 0.1, "zero"),
    Quantity("removal", "Removal, relative to intended", "", 1.0, 3, 0.04, "one"),
    Quantity("limit_ratio", "Largest use of an axis limit", "", 1.0, 2, 1.0, "zero"),
    Quantity("interference", "Interference of blade and wheel", "mm", 1e3, 3, 0.02),
    Quantity("feed", "Feed", "mm/s", 1e3, 1, 5.0, "zero"),
    Quantity("arc", "Arc angle on the wheel", "deg", 180 / np.pi, 2, 1.0),
    Quantity("lateral", "Lateral position on the wheel", "mm", 1e3, 2, 1.0),
    Quantity("turn", "Turn about the normal", "deg", 180 / np.pi, 2, 1.0),
)
"""What the page offers, in this order; PHYSICS.md 3.1 and docs/architecture.md define the terms."""


def quantity(key: str) -> Quantity:
    """The quantity of that name; KeyError where there is none."""
    return {item.key: item for item in QUANTITIES}[key]


def values_along(report: PlanReport, item: Quantity) -> Array:
    """The quantity at every waypoint of all passes in order, display units, (n,)."""
    return item.factor * np.concatenate([np.asarray(getattr(one, item.key), float) for one in report.passes])


def colour_range(report: PlanReport, item: Quantity) -> tuple[float, float]:
    """Display values of the first and the last colour.

    Around a centre the range is symmetric, so that the middle colour is "as wanted"; it never gets so
    narrow that differences without meaning (solver tolerance) show as colour.
    """
    known = values_along(report, item)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    if item.centre in ("target", "one"):
        middle = report.target_force if item.centre == "target" else 1.0
        half = max(abs(low - middle), abs(high - middle), item.span / 2)
        return middle - half, middle + half
    if item.centre == "zero":
        return min(0.0, low), max(high, item.span)
    if high - low < item.span:
        return (low + high - item.span) / 2, (low + high + item.span) / 2
    return low, high


def nice_ticks(low: float, high: float, wanted: int = 4) -> NDArray[np.float64]:
    """Round numbers inside [low, high], about `wanted` of them: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / max(wanted, 1)
    if not np.isfinite(raw) or raw <= 0:
        return np.array([low])
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(m * power - raw))
    return np.round(step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1), 12) + 0.0


def sides_of(report: PlanReport) -> dict[str, str]:
    """Sides in order of appearance with their colours."""
    names = list(dict.fromkeys(item.side for item in report.passes))
    return {name: SIDE_COLOURS[i % len(SIDE_COLOURS)] for i, name in enumerate(names)}
