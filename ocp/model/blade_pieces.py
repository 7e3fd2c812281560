"""Triangles between the points of a blade's surface, laid once: piece by piece, each in the plane that touches its middle.

A piece is what lies within some millimetres of a point and faces as it does. Delaunay's triangles of it and of what is beside it
are kept where one of their corners belongs to the piece, so that the pieces join; where the surface ends, they end.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree

from ocp.shell.cache import Entry, content_key, remember
from robots.pose import Array

VERSION = "blade pieces 1"  # part of the cache key: raise it when results change
Numbers = NDArray[np.int64]
PIECE = 8e-3  # m, radius of a piece
# Longest side of a triangle. Longer ones close the outline of the points across a corner or along an edge of the blade: there is
# no surface in them.
LONGEST = 2.5e-3  # m
SLIVER = 1e-13  # m^2; a triangle of less area is seen from no side
SAME_WAY, BESIDE = 0.8, 0.3  # smallest cosines between the middle's normal and those of a piece, and of what is beside it


@dataclass(frozen=True)
class Triangles:
    """Points (m, 3) m; corners (3, k), counter-clockwise seen from outside; double_area (k,) m^2."""

    points: Array
    corners: Numbers
    double_area: Array


@dataclass(frozen=True)
class SurfacePieces:
    """Triangles of every piece, with points of its own; middle (p, 3) m and radius (p,) m of a ball about it, facing (p, 3): unit
    normal at its middle, spread (p,) rad: largest angle between it and the normal of a triangle."""

    pieces: list[Triangles]
    middle: Array
    radius: Array
    facing: Array
    spread: Array

    def joined(self, which: Numbers) -> Triangles:
        """Some of the pieces as one."""
        parts = [self.pieces[k] for k in which]
        points, areas = [one.points for one in parts], [one.double_area for one in parts]
        begin = np.cumsum([0, *(len(one) for one in points[:-1])])
        corners = np.concatenate([one.corners for one in parts], axis=1) + np.repeat(begin, [len(one) for one in areas])
        return Triangles(np.concatenate(points), corners, np.concatenate(areas))


def laid_pieces(tree: cKDTree, normals: Array) -> SurfacePieces:
    """The triangles between the points (m, 3) m of a tree, with outward unit normals (m, 3); kept on disk."""
    points = np.asarray(tree.data)
    entry = remember("surface", content_key(VERSION, points, normals), lambda: _laid(tree, normals))
    corners, owner, middle = (np.asarray(entry[name], np.int64) for name in ("corners", "owner", "middle"))
    parts = [_piece(points, part) for part in np.split(corners, np.flatnonzero(np.diff(owner)) + 1)]
    facing = normals[middle[np.unique(owner)]]
    balls = [_ball(one.points) for one in parts]
    spread = [_spread(one, n) for one, n in zip(parts, facing, strict=True)]
    return SurfacePieces(parts, np.array([at for at, _ in balls]), np.array([r for _, r in balls]), facing, np.array(spread))


def _laid(tree: cKDTree, normals: Array) -> Entry:
    """Corners (k, 3) of all triangles, the piece (k,) that each belongs to, rising, and the point (p,) in each one's middle."""
    points = np.asarray(tree.data)
    piece = np.full(len(points), -1)
    middles: list[int] = []
    found = []
    for k in range(len(points)):
        if piece[k] < 0:
            near = np.sort(np.asarray(tree.query_ball_point(points[k], PIECE + LONGEST), dtype=np.int64))
            near = near[normals[near] @ normals[k] > BESIDE]
            alike = (normals[near] @ normals[k] > SAME_WAY) & (np.linalg.norm(points[near] - points[k], axis=1) < PIECE)
            own = alike & (piece[near] < 0)
            piece[near[own]] = len(middles)
            middles.append(k)
            found.append(near[_flat_triangles(points[near], points[k], normals[k], own)])
    # A triangle of two pieces counts once, and begins at its smallest corner.
    corners = np.vstack(found)
    turned = (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3
    corners = np.unique(np.take_along_axis(corners, turned, axis=1), axis=0)
    owner = piece[corners[:, 0]]
    order = np.argsort(owner, kind="stable")
    small = {"corners": corners[order], "owner": owner[order], "middle": np.array(middles)}
    return {name: values.astype(np.int32) for name, values in small.items()}


def _flat_triangles(points: Array, middle: Array, normal: Array, own: NDArray[np.bool_]) -> Numbers:
    """Delaunay's triangles (k, 3) of points (m, 3) seen against the normal at their middle: those with a corner of one's own and
    no long side."""
    u = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    u /= np.linalg.norm(u)
    flat = (points - middle) @ np.stack([u, np.cross(normal, u)], axis=1)
    try:
        corners = Delaunay(flat).simplices.astype(np.int64)
    except QhullError:  # too few points, or all on a line
        return np.empty((0, 3), np.int64)
    corners = corners[own[corners].any(axis=1)]
    (ax, ay), (bx, by), (cx, cy) = (flat[c].T for c in corners.T)
    turn = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    corners[turn < 0] = corners[turn < 0, ::-1]
    at = points[corners]
    sides = np.linalg.norm(at - at[:, [1, 2, 0]], axis=2)
    return corners[(sides.max(axis=1) < LONGEST) & (np.abs(turn) > SLIVER)]


def _piece(points: Array, corners: Numbers) -> Triangles:
    used, inner = np.unique(corners, return_inverse=True)
    inner = np.ascontiguousarray(inner.reshape(corners.shape).T)
    return Triangles(points[used], inner, np.linalg.norm(_double_normals(points[used], inner), axis=1))


def _double_normals(points: Array, corners: Numbers) -> Array:
    a, b, c = points[corners]
    return np.cross(b - a, c - a)


def _ball(points: Array) -> tuple[Array, float]:
    middle = points.mean(axis=0)
    return middle, float(np.linalg.norm(points - middle, axis=1).max())


def _spread(one: Triangles, facing: Array) -> float:
    cosine = _double_normals(one.points, one.corners) @ facing / one.double_area
    return float(np.arccos(np.clip(cosine.min(), -1.0, 1.0)))
