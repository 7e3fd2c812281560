"""What a contact patch finds around a waypoint: where the surface ends."""

import numpy as np

from robots.pose import Array
from trajectories.blade.fit import SideSurface
from trajectories.blade.shape import AerofoilShape

MAX_TURN = np.deg2rad(60.0)  # the surface counts as ended where it has turned this far from the waypoint's normal
_RAIL_POINTS = 160


def extents(shape: AerofoilShape, side: SideSurface, u: Array, v: Array, p: Array, n: Array, t: Array) -> Array:
    """Distances (m, 4) in m along +t, -t, +b, -b over which the wall goes on, by normal sections of the surface.

    u, v (m,) parameters of p (m, 3) m on `side`; n, t (m, 3) unit, b = n x t. The wall ends at the rim of a free
    end, where a fillet or a block begins, or where it has turned by MAX_TURN around an edge.
    """
    rail = _boundary(shape, side)
    out = np.empty((len(p), 4))
    for k, d in enumerate((t, -t, np.cross(n, t), -np.cross(n, t))):
        out[:, k] = _distance_along(side, rail, u, v, p, n, d)
    return out


def _boundary(shape: AerofoilShape, side: SideSurface) -> dict[str, Array]:
    """The closed outline of the flank: parameters, points, outward normals, and what lies beyond each point.

    beyond (m, 3): from the outline to the nose of the edge; nose_normal (m, 3): outward there; zero at the ends.
    """
    low = 0.0 if not shape.frame.block[0] else float(shape.v[0])
    high = shape.frame.length if not shape.frame.block[1] else float(shape.v[1])
    along_v, along_u = np.linspace(low, high, _RAIL_POINTS), np.linspace(0.0, 1.0, _RAIL_POINTS)
    u = np.concatenate([0 * along_v, along_u, 0 * along_v + 1.0, along_u[::-1]])
    v = np.concatenate([along_v, 0 * along_u + high, along_v[::-1], 0 * along_u + low])
    kind = np.repeat([1, 0, 2, 0], _RAIL_POINTS)
    other = shape.sides["concave" if side.name == "convex" else "convex"]
    points = side.surface(u, v)
    nose = points.copy()
    for k, edge in ((1, shape.leading), (2, shape.trailing)):
        nose[kind == k] = np.stack([np.interp(v[kind == k], shape.v_edges, edge[:, i]) for i in range(3)], axis=1)
    across = 0.5 * (points + other.surface(u, v))
    forward = np.where((kind > 0)[:, None], nose - across, 0.0)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    return {"u": u, "v": v, "p": points, "n": side.normal(u, v), "beyond": nose - points, "nose_normal": forward}


def _distance_along(side: SideSurface, rail: dict[str, Array], u: Array, v: Array, p: Array, n: Array, d: Array) -> Array:
    """Arc length (m,) from p in direction d, in the plane of n and d, to the outline or to the limit of turning."""
    normal = np.cross(n, d)
    across = normal @ rail["p"].T - np.einsum("ni,ni->n", normal, p)[:, None]
    a, b = across, np.roll(across, -1, axis=1)
    weight = np.where(a != b, a / np.where(a == b, 1.0, a - b), 0.5)
    ahead_a = d @ rail["p"].T - np.einsum("ni,ni->n", d, p)[:, None]
    ahead = (1.0 - weight) * ahead_a + weight * np.roll(ahead_a, -1, axis=1)
    hit = (a * b <= 0.0) & (ahead > -1e-6)
    k = np.argmin(np.where(hit, ahead, np.inf), axis=1)
    rows = np.arange(len(p))
    w = weight[rows, k][:, None]
    found = hit[rows, k]

    def at(name: str) -> Array:
        x = rail[name] if rail[name].ndim == 2 else rail[name][:, None]
        return np.asarray((1.0 - w) * x[k] + w * x[(k + 1) % len(x)])

    end, end_normal = at("p"), at("n")
    angle = _angle(end_normal, n)
    arc = np.linalg.norm(end - p, axis=1) * (1.0 + angle**2 / 24.0)  # chord to arc of a circle, to second order
    nose_angle = _angle(at("nose_normal"), n)
    more = np.clip((MAX_TURN - angle) / np.maximum(nose_angle - angle, 1e-3), 0.0, 1.0)
    arc = arc + more * np.linalg.norm(at("beyond"), axis=1)
    early = np.flatnonzero(found & (angle > MAX_TURN))
    if len(early):
        arc[early] *= _share_before_turn(side, u[early], v[early], at("u")[early, 0], at("v")[early, 0], n[early])
    return np.where(found, arc, 0.0)


def _angle(a: Array, b: Array) -> Array:
    """Angle (n,) rad between unit vectors; a right angle where one of them is zero."""
    return np.asarray(np.arccos(np.clip(np.einsum("ni,ni->n", a, b), -1.0, 1.0)))


def _share_before_turn(side: SideSurface, u: Array, v: Array, u_end: Array, v_end: Array, n: Array) -> Array:
    """Share (n,) of the way to (u_end, v_end) after which the normal has turned by MAX_TURN."""
    share = np.linspace(0.0, 1.0, 33)
    uu = u[:, None] + (u_end - u)[:, None] * share
    vv = v[:, None] + (v_end - v)[:, None] * share
    normal = side.normal(uu.ravel(), vv.ravel()).reshape(*uu.shape, 3)
    cosine = np.einsum("nki,ni->nk", normal, n)
    return np.asarray(share[np.maximum(np.argmax(cosine < np.cos(MAX_TURN), axis=1) - 1, 0)])
