"""Frictionless contact of the wheel's cover with a rigid blade: a linear complementarity problem on pressure cells.

With cell forces f, compliance C, gap g and interference d:  0 <= f  perp  C f + g - d >= 0,  sum f = F, which are the
optimality conditions of min 1/2 f^T C f + g^T f, f >= 0, sum f = F, with d the multiplier. docs/wheel.md, eq. 4. Below it the
gap of the quadratic blade over the wheel (docs/architecture.md, wheel contact frame), and the contact solved for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from ocp.contact.wheel.cover import Cover
from robots.errors import Infeasible
from robots.pose import Array

Mask = NDArray[np.bool_]
MAX_PIVOTS = 300
PATIENCE = 6  # block exchanges without progress before single exchanges take over (Judice and Pires 1994)
GUESS_SHARE = 0.35  # of the force, see `_first_guess`
FORCE_ROUNDING = 1e-12  # of the mean cell force; what counts as pull or overlap
MOMENT_TO_AXIS = 5.0  # mean x^2 = a^2 / 5 under Hertz's ellipsoid of pressure (Johnson 1985, section 4.2)


@dataclass(frozen=True)
class Contact:
    """Solution of one contact; lengths m, forces N, pressures Pa, frame of docs/architecture.md at the planned point.

    indentation: interference at the planned point, may be negative; force; stiffness dF/dd N/m of this set of cells,
    within some per cent (it jumps where a cell joins); centroid (2,) x, y; semi_axes (2,) along x, y of the ellipse with
    the same second moments, y at most half the width; pressure (n_y, n_x) on x (n_x,), y (n_y,); response (n_y, n_x):
    share of each cell in a small rise of the force, sum 1; residual: largest violation of the contact conditions,
    relative to the largest displacement and the mean force; touches_border: the patch reaches the end of the window
    along x, so the answer is not trustworthy.
    """

    indentation: float
    force: float
    stiffness: float
    centroid: Array
    semi_axes: Array
    pressure: Array
    response: Array
    x: Array
    y: Array
    residual: float
    touches_border: bool


def solve_contact(cover: Cover, gap: Array, force: float, beside: Contact | None = None) -> Contact:
    """Contact under `force` N for a gap (n_y, n_x) m given as cell means, inf where there is no blade; `beside`: one like it, the
    cells of which are tried first.

    Raises Infeasible where no blade lies over the wheel.
    """
    return solve_contacts(cover, gap[None], np.array([force]), beside)[0]


def solve_contacts(cover: Cover, gaps: Array, forces: Array, beside: Contact | None = None) -> list[Contact]:
    """`solve_contact` for many gaps (k, n_y, n_x) and forces (k,), their displacements together."""
    found: list[Contact | None] = [None] * len(gaps)
    active = np.zeros(gaps.shape, bool)
    for k, (gap, force) in enumerate(zip(gaps, forces, strict=True)):
        there = np.isfinite(gap)
        if not there.any():
            raise Infeasible("no part of the blade lies over the wheel at this contact point; move the contact on the wheel")
        if force <= 0:
            zero = np.zeros((len(cover.y), len(cover.x)))
            found[k] = Contact(float(gap.min()), 0.0, 0.0, np.zeros(2), np.zeros(2), zero, zero, cover.x, cover.y, 0.0, False)
            continue
        tried = None if beside is None else there & (beside.pressure > 0)
        active[k] = _first_guess(cover, gap, force) if tried is None or not tried.any() else tried
    open_ = np.flatnonzero([one is None for one in found])
    best, patience = np.full(len(gaps), gaps[0].size + 1), np.full(len(gaps), PATIENCE)
    for _ in range(MAX_PIVOTS):
        if not len(open_):
            break
        own = [_equilibrium(cover, gaps[k], active[k], forces[k]) for k in open_]
        field = np.zeros((len(open_), *gaps.shape[1:]))
        field[active[open_]] = np.concatenate([f for f, _, _ in own])
        moved = cover.displace(field)
        opening = moved + gaps[open_] - np.array([d for _, _, d in own])[:, None, None]
        scale = np.array([np.abs(f).mean() for f, _, _ in own])[:, None, None]
        pull = field < -FORCE_ROUNDING * scale
        wrong = pull | (~active[open_] & (opening < -FORCE_ROUNDING * abs(cover.kernel[0, 0, 0]) * scale))
        counts = np.count_nonzero(wrong, axis=(1, 2))
        for at in np.flatnonzero(counts == 0):
            k, (_, rise, d) = open_[at], own[at]
            found[k] = _summary(cover, field[at], rise, active[k], opening[at], moved[at], d)
        better = counts < best[open_]
        patience[open_] = np.where(better, PATIENCE, patience[open_] - 1)
        best[open_] = np.where(better, counts, best[open_])
        for at in np.flatnonzero(patience[open_] < 0):
            last = np.flatnonzero(wrong[at])[-1:]
            wrong[at] = False
            wrong[at].flat[last] = True
        active[open_] ^= wrong
        for k in open_[~active[open_].any(axis=(1, 2))]:
            active[k] = gaps[k] == gaps[k].min()
        open_ = open_[counts > 0]
    if not len(open_):
        return [one for one in found if one is not None]
    raise Infeasible(f"the wheel contact did not settle in {MAX_PIVOTS} active sets; the blade's surface is too rough there")


def _first_guess(cover: Cover, gap: Array, force: float) -> Mask:
    """Cells below the level at which a Winkler bed of the cover's stiffness carries `GUESS_SHARE` of the force.

    A cover gives beside its load too, so it is touched less wide than a bed: on half the area on a half-space (Hertz). With all
    of the force the guess has 1.8 times the cells of the solution; a third of it takes the fewest exchanges, and small ones.
    """
    g = np.sort(gap[np.isfinite(gap)])
    geometry = cover.geometry
    bed = geometry.modulus / geometry.cover_thickness * cover.dx * cover.dy.mean()
    carried = bed * (g * np.arange(1, len(g) + 1) - np.cumsum(g))
    count = max(int(np.searchsorted(carried, GUESS_SHARE * force)), 1)
    return gap <= g[count - 1]


def _equilibrium(cover: Cover, gap: Array, active: Mask, force: float) -> tuple[Array, Array, float]:
    """Forces on the active cells that close the gap there, their rise per metre of indentation, and the indentation."""
    i, m = np.nonzero(active)
    rows, _, lags = cover.lagged.shape
    places = (rows * lags * i + m)[:, None] + (lags * i - m + lags // 2)[None, :]
    C = cover.lagged.ravel().take(places)  # lagged[i, j, m - m'], in half the time of three indices
    _, solution, failed = dposv(C, np.column_stack([gap[active], np.ones(len(i))]), lower=True, overwrite_a=True)
    if failed:
        raise np.linalg.LinAlgError("the cover's compliance is not positive definite")
    resting, rise = solution.T
    d = (force + resting.sum()) / rise.sum()
    return d * rise - resting, rise, float(d)


def _summary(cover: Cover, field: Array, rise: Array, active: Mask, opening: Array, moved: Array, d: float) -> Contact:
    """The solution's figures."""
    force = float(field.sum())
    x, y = cover.x[None, :], cover.y[:, None]
    centroid = np.array([(field * x).sum(), (field * y).sum()]) / force
    moments = np.array([(field * (x - centroid[0]) ** 2).sum(), (field * (y - centroid[1]) ** 2).sum()]) / force
    own = np.array([cover.dx**2, np.mean(cover.dy) ** 2]) / 12
    response = np.zeros_like(field)
    response[active] = rise / rise.sum()
    axes = np.sqrt(MOMENT_TO_AXIS * (moments + own))
    axes[1] = min(axes[1], 0.5 * cover.geometry.width)
    columns = np.flatnonzero(active.any(axis=0))
    residual = max(
        float(np.abs(opening[active]).max()) / float(np.abs(moved).max()), float(-field.min() / field[active].mean()), 0.0
    )
    at_border = bool(columns[0] == 0 or columns[-1] == len(cover.x) - 1)
    fields = field / cover.area, response, cover.x, cover.y
    return Contact(d, force, float(rise.sum()), centroid, axes, *fields, residual, at_border)


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


def solve_force(cover: Cover, force: float, shape: LocalShape, beside: Contact | None = None) -> Contact:
    """Indentation that gives `force` N, at the planned point of `shape`; `beside` of `solve_contact`.

    Raises Infeasible where the blade is hollow along the belt (kxx <= 0): it then touches elsewhere.
    """
    return solve_forces(cover, np.array([force]), [shape], beside)[0]


def solve_forces(cover: Cover, forces: Array, shapes: Sequence[LocalShape], beside: Contact | None = None) -> list[Contact]:
    """`solve_force` for forces (k,) and as many shapes."""
    gaps, moves = [], []
    for shape in shapes:
        if shape.kxx <= 0:
            raise Infeasible(
                f"the blade is hollow along the belt (relative curvature {shape.kxx:.3g} 1/m, must be positive): the wheel "
                "touches it elsewhere; turn the blade or use a smaller wheel"
            )
        y = cover.y - shape.lateral
        origin = _window_origin(shape, y)
        gap = shape.gap((cover.x + origin)[None, :], y[:, None])
        gaps.append(gap + (shape.kxx * cover.dx**2 + shape.kyy * cover.dy[:, None] ** 2) / 24)  # cell mean of the quadratic part
        moves.append(np.array([origin, -shape.lateral]))
    return [
        replace(one, centroid=one.centroid + move if one.force > 0 else one.centroid, x=cover.x + move[0], y=cover.y + move[1])
        for one, move in zip(solve_contacts(cover, np.array(gaps), forces, beside), moves, strict=True)
    ]


def _window_origin(shape: LocalShape, y: Array) -> float:
    """x (m) at the middle of the window: where the blade comes lowest, the mean over the width of near-lowest places."""
    ridge = -(shape.tilt_x + shape.kxy * y) / shape.kxx
    height = shape.gap(ridge, y)
    if not np.isfinite(height).any():
        return 0.0
    weight = np.exp(-(height - height.min()) / 1e-4)
    return float((weight * ridge).sum() / weight.sum())
