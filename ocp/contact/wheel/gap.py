"""Gap of the quadratic blade over the wheel, and the contact solved for it (docs/architecture.md, wheel contact frame)."""

from dataclasses import dataclass, replace

import numpy as np

from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.signorini import Contact, solve_contact
from robots.errors import Infeasible
from robots.pose import Array


@dataclass(frozen=True)
class LocalShape:
    """Quadratic gap g = tx x + ty y + 1/2 (kxx x^2 + 2 kxy x y + kyy y^2) at the planned point, and where it is.

    Relative curvatures 1/m, tilts as slopes, lateral m (the wheel occupies -w/2 - lateral <= y <= w/2 - lateral).
    extent (4,): the blade goes on over that many metres along +t, -t, +b, -b; heading (2,): t in (x, y).
    """

    kxx: float
    kyy: float
    kxy: float = 0.0
    lateral: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    extent: Array | None = None
    heading: tuple[float, float] = (1.0, 0.0)

    def gap(self, x: Array, y: Array) -> Array:
        """Height of the undeformed blade over the undeformed wheel at x, y (m), inf beyond the blade's edges."""
        g = self.tilt_x * x + self.tilt_y * y + 0.5 * (self.kxx * x**2 + 2 * self.kxy * x * y + self.kyy * y**2)
        if self.extent is not None:
            # b = n x t with n = -z: a quarter turn clockwise in (x, y).
            along = self.heading[0] * x + self.heading[1] * y
            across = self.heading[1] * x - self.heading[0] * y
            ahead, behind, left, right = self.extent
            g = np.where((along <= ahead) & (along >= -behind) & (across <= left) & (across >= -right), g, np.inf)
        return g


def solve_force(cover: Cover, force: float, shape: LocalShape) -> Contact:
    """Indentation that gives `force` N, at the planned point of `shape`.

    Raises Infeasible where the blade is hollow along the belt (kxx <= 0): it then touches elsewhere.
    """
    return _solve(cover, shape, force=force)


def solve_indentation(cover: Cover, indentation: float, shape: LocalShape) -> Contact:
    """Force under `indentation` m at the planned point of `shape`; as `solve_force`."""
    return _solve(cover, shape, indentation=indentation)


def _solve(cover: Cover, shape: LocalShape, **given: float) -> Contact:
    if shape.kxx <= 0:
        raise Infeasible(
            f"the blade is hollow along the belt (relative curvature {shape.kxx:.3g} 1/m, must be positive): the wheel "
            "touches it elsewhere; turn the blade or use a smaller wheel"
        )
    y = cover.y - shape.lateral
    origin = _window_origin(shape, y)
    x = cover.x + origin
    gap = shape.gap(x[None, :], y[:, None])
    gap = gap + (shape.kxx * cover.dx**2 + shape.kyy * cover.dy[:, None] ** 2) / 24  # cell mean of the quadratic part
    contact = solve_contact(cover, gap, **given)
    centroid = contact.centroid + np.array([origin, -shape.lateral]) if contact.force > 0 else contact.centroid
    return replace(contact, centroid=centroid, x=x, y=y)


def _window_origin(shape: LocalShape, y: Array) -> float:
    """x (m) at the middle of the window: where the blade comes lowest, the mean over the width of near-lowest places."""
    ridge = -(shape.tilt_x + shape.kxy * y) / shape.kxx
    height = shape.gap(ridge, y)
    if not np.isfinite(height).any():
        return 0.0
    weight = np.exp(-(height - height.min()) / 1e-4)
    return float((weight * ridge).sum() / weight.sum())
