"""Contact samples as flat rows, and the overlap that effects add to them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import ContactContext
from ocp.effects.effect import Active, Effect, Scanned
from ocp.effects.engine.compiled import Hook, Layout, evaluated
from robots.pose import Array

# Blocks of a row, matrices row by row; see ContactContext.
LAYOUT = Layout(
    (
        ("F", 1), ("parts", 4), ("slopes", 4), ("curvature", 3), ("lateral", 1), ("tilt", 2), ("arc", 1), ("turn", 1), ("p", 3),
        ("n", 3), ("t", 3), ("e", 3), ("belt_direction", 3), ("n_base", 3), ("axis", 3), ("R_flange", 9), ("R_blade", 9),
        ("s", 1), ("setpoint", 1), ("feed", 1), ("belt", 1), ("time", 1), ("clock", 1), ("ground_before", 1), ("warm", 1),
        ("wheel_warm", 1), ("travel", 1), ("stroke_sign", 1), ("normal_stiffness", 1), ("friction_give", 1), ("lever", 1),
        ("push_axis", 3), ("clamp_give", 1), ("line", 1),
    )
)  # fmt: skip


@dataclass(frozen=True)
class ContactPlace:
    """What is the same in all rows: the wheel's radius m and the cell's friction."""

    radius: float
    friction: float

    def context(self, row: ca.SX) -> ContactContext:
        """What hooks see of a symbolic row."""
        x = LAYOUT.split(row)
        for name in ("R_flange", "R_blade"):
            x[name] = ca.reshape(x[name], 3, 3).T
        return ContactContext(radius=self.radius, friction=self.friction, **x)


def contact_columns(effect: Effect, kind: str, joint: int, scans: Sequence[Scanned], place: ContactPlace, rows: Array) -> Array:
    """The hook `kind` (overlap, push, sensor, shear) at rows (n, k) of LAYOUT per unit coefficient: (v, n, m)."""
    if getattr(effect, kind) is None or not scans:
        return np.zeros((len(scans), len(rows), effect.size))
    return evaluated(Hook(effect, kind, joint, LAYOUT, place), rows, scans)[-1][:, :, 0]


def added_overlap(active: Sequence[Active], place: ContactPlace, blocks: Mapping[str, Any], rigid: bool) -> float:
    """Overlap m that active effects add to one sample: a push counts as the stroke of the flange that it takes, in a rigid cell
    as the overlap that brings as much force."""
    row = LAYOUT.stack(1, blocks)
    slopes = LAYOUT.block(row, "slopes")[0]
    total = 0.0
    for one in active:
        for kind, give in (("overlap", 1.0), ("push", slopes.sum() if rigid else slopes[0])):
            if getattr(one.effect, kind) is not None:
                total += give * float(contact_columns(one.effect, kind, one.joint, (one.scanned,), place, row)[0, 0] @ one.a)
    return total
