"""The part of one side that may be ground: inside the margins from clamp, block, tip and edges, and where the wheel has room."""

from dataclasses import dataclass

import numpy as np
import trimesh

from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade.axis import longest_run
from trajectories.blade.fit import SideSurface
from trajectories.blade.mesh import Blade
from trajectories.blade.shape import AerofoilShape

_GRID = 201
ACROSS = 0.7  # least share of the span along the clamp plane's normal where nothing of the blade is left to grind
GAP = 0.5e-3  # m: room that must stay between the wheel and whatever is not aerofoil
_SAMPLING = 2e-3  # m: distance of the points that stand for block and platform
_STATIONS = 121  # places along a pass that are looked at
_AT_ONCE = 8  # of them, as many as fit the processor's cache with ten thousand points


@dataclass(frozen=True)
class Margins:
    """Clamp plane and distances, m: held is where normal . x <= offset; normal (3,) unit, towards the free part."""

    normal: Array
    offset: float
    root: float
    tip: float
    edge: float


@dataclass(frozen=True)
class Window:
    """Bounds of the ground region of one side: u_lo, u_hi over grid v; v_lo, v_hi over grid u; all (m,).

    `flip`: the clamp holds the end that the shape calls the tip, so passes run towards falling v. cut (2,): whether
    the flank's own ends, not the edge margin, limit u at the leading and at the trailing edge.
    """

    u: Array
    v: Array
    u_lo: Array
    u_hi: Array
    v_lo: Array
    v_hi: Array
    flip: bool
    cut: tuple[bool, bool]


def ground_window(name: str, shape: AerofoilShape, side: SideSurface, margins: Margins) -> Window:
    """Where passes may lie on `side`. Raises: BadInput when the margins leave nothing."""
    v = np.linspace(shape.v[0], shape.v[1], _GRID)
    u = np.linspace(0.0, 1.0, _GRID)
    lead, trail, width = (np.interp(v, side.levels, x) for x in (side.lead, side.trail, side.width))
    u_lo, u_hi = (margins.edge - lead) / width, 1.0 - (margins.edge - trail) / width
    cut = (bool(u_lo.min() < 0.0), bool(u_hi.max() > 1.0))
    u_lo, u_hi = np.maximum(u_lo, 0.0), np.minimum(u_hi, 1.0)
    whole = float((lead + width + trail).max())
    if (u_hi <= u_lo).any():
        raise BadInput(
            f"{name}: edge_margin_mm = {1e3 * margins.edge:g} from both edges leaves nothing of the {side.name} side, "
            f"which is {1e3 * float((lead + width + trail).min()):.1f} to {1e3 * whole:.1f} mm wide; make it smaller."
        )
    flip = bool(_clamp_distance(shape, side, margins, 1.0) < _clamp_distance(shape, side, margins, 0.0))
    uu, vv = np.meshgrid(u, v, indexing="ij")
    points = side.surface(uu, vv)
    free = points @ margins.normal - margins.offset - margins.root
    tip_end, tip_block = (0.0, shape.frame.block[0]) if flip else (shape.frame.length, shape.frame.block[1])
    tip_end = (float(shape.v[0]) if flip else float(shape.v[1])) if tip_block else tip_end
    stretch = np.linalg.norm(side.surface(uu, vv, 0, 1), axis=-1)
    to_tip = np.abs(tip_end - vv) * stretch - margins.tip
    first = _crossing(v, free, from_end=flip)
    last = _crossing(v, to_tip, from_end=not flip)
    v_lo, v_hi = (last, first) if flip else (first, last)
    inside = (u >= u_lo.min()) & (u <= u_hi.max())
    if np.isnan(v_lo + v_hi)[inside].any() or (v_hi <= v_lo)[inside].any():
        along = float(margins.normal @ shape.frame.axis)
        if abs(along) < ACROSS:
            raise BadInput(
                f"{name}: the clamp plane stands along the blade, not across it: its normal is {_direction(margins.normal)} "
                f"and the span runs along {_direction(shape.frame.axis)}; correct workpiece.clamp_axis or clamp_normal"
            )
        raise BadInput(
            f"{name}: the clamp plane with root_margin_mm = {1e3 * margins.root:g} and tip_margin_mm = "
            f"{1e3 * margins.tip:g} leave nothing of the {1e3 * float(np.ptp(shape.v)):.1f} mm of aerofoil on the "
            f"{side.name} side; make the margins smaller or move the clamp."
        )
    return Window(u, v, u_lo, u_hi, v_lo, v_hi, flip, cut)


def _direction(v: Array) -> str:
    return f"({', '.join(f'{c:.2f}' for c in v + 0.0)})"


def _clamp_distance(shape: AerofoilShape, side: SideSurface, margins: Margins, end: float) -> float:
    """Distance in m of the middle of an end of the aerofoil from the clamp plane, positive on the free side."""
    v = shape.v[0] + end * (shape.v[1] - shape.v[0])
    return float(side.surface(np.array([0.5]), np.array([v]))[0] @ margins.normal - margins.offset)


def _crossing(v: Array, values: Array, from_end: bool) -> Array:
    """For each row the v nearest to one end of the grid from which on `values` (nu, nv) stays positive; nan if none."""
    if from_end:
        return _crossing(v[::-1], values[:, ::-1], from_end=False)
    bad = values < 0.0
    last = np.where(bad.any(axis=1), bad.shape[1] - 1 - np.argmax(bad[:, ::-1], axis=1), -1)
    out = np.full(len(values), v[0])
    rows = np.flatnonzero((last >= 0) & (last < len(v) - 1))
    i = last[rows]
    a, b = values[rows, i], values[rows, i + 1]
    out[rows] = v[i] + (v[i + 1] - v[i]) * (-a) / np.where(b > a, b - a, 1.0)
    out[last == len(v) - 1] = np.nan
    return out


def obstacles(blade: Blade, shape: AerofoilShape) -> Array:
    """Points (m, 3), m, on everything that follows the aerofoil's ends: fillet, platform, block, shroud."""
    v = shape.frame.coordinate(blade.vertices)
    outside = np.zeros(len(blade.faces), bool)
    for end, beyond in ((0, v < shape.v[0]), (1, v > shape.v[1])):
        if shape.frame.block[end]:
            outside |= beyond[blade.faces].all(axis=1)
    if not outside.any():
        return np.zeros((0, 3))
    used, faces = np.unique(blade.faces[outside], return_inverse=True)
    points, _ = trimesh.remesh.subdivide_to_size(blade.vertices[used], faces.reshape(-1, 3), _SAMPLING, max_iter=12)
    return np.unique(np.round(points, 7), axis=0)


def free_stretch(side: SideSurface, points: Array, u: Array, v: Array, radius: float, width: float) -> tuple[Array, Array] | None:
    """The longest stretch of the polyline (u, v) on which the wheel keeps GAP from `points`, or None.

    The wheel stands on the surface without tilt or turn: its axis is b = n x t, its centre p + radius n.
    """
    if not len(points):
        return u, v
    at = np.linspace(0, len(u) - 1, _STATIONS)
    us, vs = (np.interp(at, np.arange(len(u)), x) for x in (u, v))
    p, n = side.surface(us, vs), side.normal(us, vs)
    t = np.gradient(p, axis=0)
    b = np.cross(n, t)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    centre = p + radius * n
    size, free = np.sum(points**2, axis=1), np.ones(len(p), bool)
    for k in range(0, len(p), _AT_ONCE):
        part, axis = centre[k : k + _AT_ONCE], b[k : k + _AT_ONCE]
        lateral = axis @ points.T - np.sum(part * axis, axis=1)[:, None]
        off = -2.0 * part @ points.T + size + np.sum(part**2, axis=1)[:, None] - lateral**2
        free[k : k + _AT_ONCE] = ~((np.abs(lateral) < 0.5 * width + GAP) & (off < (radius + GAP) ** 2)).any(axis=1)
    first, end = longest_run(free)
    last = end - 1
    if last <= first:
        return None
    if first == 0 and last == len(p) - 1:
        return u, v
    keep = np.linspace(at[first], at[last], len(u))
    return np.interp(keep, np.arange(len(u)), u), np.interp(keep, np.arange(len(u)), v)
