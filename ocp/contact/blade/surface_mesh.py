"""Remeshing of a closed triangle surface so that a tetrahedral mesher gets triangles it can work with.

STL facets have the shapes that suit a CAD kernel: needles across flat caps, slivers along edges. Four local
operations (split, flip, collapse, smooth; Botsch and Kobbelt 2004) run here over independent sets of edges,
so each sweep is a handful of array operations. New vertices lie on old facets and old vertices never
leave them, so the surface moves only where a collapse or a flip is allowed to cut a corner, by at most
the tolerance. Edges get shorter than the target only where the shape needs it: a thin trailing edge keeps long,
narrow triangles instead of thousands of small round ones.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags

Array = NDArray[np.float64]
Index = NDArray[np.int64]
SizeLaw = Callable[[Array], Array]  # wished edge length (n,) in m at points (n, 3)

LONGEST = 4.0 / 3.0  # of the element size: longer edges are split, collapses must not make them
SHORTEST = 0.7  # of the element size: shorter edges are collapsed where the shape allows
CROWDED = 100_000  # facets: of more the shortest edges are collapsed before anything else; a scan has tens where one is wanted
NOISE = 3e-5  # m, of scans: by as much a crowded surface may be smoothed
SMALLEST_COSINE = 0.80  # between the normals of a facet before and after a flip or a collapse


class Edges(NamedTuple):
    """Edges of a closed triangle surface: `ends` (ne, 2), `face` (ne, 2) and `opposite` corner (ne, 2)."""

    ends: Index
    face: Index
    opposite: Index


def edges_of(faces: Index) -> Edges:
    """List the edges of a closed 2-manifold; `face[:, 0]` runs through the edge from ends[0] to ends[1].

    Raises:
        ValueError: an edge has not exactly two faces of opposite direction.
    """
    tail, head, tip = faces.ravel(), np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
    count = int(faces.max()) + 1
    order = np.lexsort((tail > head, np.minimum(tail, head) * count + np.maximum(tail, head)))
    first, second = order[0::2], order[1::2]
    if len(order) % 2 or np.any(tail[first] != head[second]) or np.any(head[first] != tail[second]):
        raise ValueError("the surface is not closed and manifold")
    return Edges(
        np.stack([tail[first], head[first]], 1), np.stack([first // 3, second // 3], 1), np.stack([tip[first], tip[second]], 1)
    )


def remesh(vertices: Array, faces: Index, size: SizeLaw, tolerance: float, sweeps: int = 5) -> tuple[Array, Index]:
    """Return a closed surface (nv, 3), (nf, 3) of edges near `size` that follows the given one.

    Args:
        vertices: (nv, 3) m.
        faces: (nf, 3), closed and manifold, outward.
        size: wished edge length (n,) in m at points (n, 3).
        tolerance: how far in m a removed vertex may end up from the new surface; a crowded one is followed no closer than
            three times its noise.
        sweeps: rounds of split, flip, collapse, flip, smooth.

    Raises:
        ValueError: the surface is not closed and manifold.
    """
    points, triangles = np.array(vertices, float), np.array(faces, np.int64)
    error = np.zeros(len(points))
    if len(triangles) > CROWDED:
        points, noise = _without_noise(points, triangles)
        tolerance = max(tolerance, 3.0 * noise)
        triangles, error = _collapse(points, triangles, error, size, tolerance)
    for _ in range(sweeps):
        points, triangles, error = _split(points, triangles, error, size)
        triangles = _flip(points, triangles, tolerance)
        triangles, error = _collapse(points, triangles, error, size, tolerance)
        triangles = _flip(points, triangles, tolerance)
        points = _smooth_flats(points, triangles)
    used, inverse = np.unique(triangles, return_inverse=True)
    return points[used], inverse.reshape(-1, 3)


def _without_noise(points: Array, faces: Index) -> tuple[Array, float]:
    """Vertices of a crowded surface moved along its normal, without what changes from one to the next (Taubin 1995: nothing
    shrinks), and the standard deviation m of that: of most vertices, so that sharp edges of a clean surface are no noise."""
    adjacency = _adjacency(edges_of(faces).ends, len(points))
    mean = diags(1.0 / np.maximum(adjacency.sum(axis=1).A1, 1.0)) @ adjacency
    smooth = points
    for _ in range(15):
        for share in (0.5, -0.53):
            smooth = smooth + share * (mean @ smooth - smooth)
    normal = np.zeros_like(points)
    np.add.at(normal, faces.ravel(), np.repeat(face_normals(points[faces]), 3, axis=0))
    normal /= np.sqrt(np.maximum(dot(normal, normal), 1e-300))[:, None]
    height = dot(smooth - points, normal)
    noise = min(1.4826 * float(np.median(np.abs(height))), NOISE)
    most = min(3.0 * noise, NOISE)
    return points + np.clip(height, -most, most)[:, None] * normal, noise


def _local_minima(priority: Array, stencil: Index, count: int) -> NDArray[np.bool_]:
    """Choose operations whose priority is the least on every vertex (columns of `stencil`) they touch."""
    least = np.full(count, np.inf)
    np.minimum.at(least, stencil.ravel(), np.repeat(priority, stencil.shape[1]))
    return np.asarray(np.all(least[stencil] == priority[:, None], axis=1))


def _rank(values: Array) -> Array:
    """Return distinct priorities in the order of the values, ties broken by position."""
    rank = np.empty(len(values))
    rank[np.argsort(values, kind="stable")] = np.arange(len(values))
    return rank


def _split(points: Array, faces: Index, error: Array, size: SizeLaw) -> tuple[Array, Index, Array]:
    """Halve edges that are too long, the longest of a face first."""
    for _ in range(60):
        edges = edges_of(faces)
        one, two = points[edges.ends[:, 0]], points[edges.ends[:, 1]]
        length = np.linalg.norm(one - two, axis=1) / size(0.5 * (one + two))
        long = np.flatnonzero(length > LONGEST)
        if not len(long):
            break
        chosen = long[_local_minima(_rank(-length[long]), edges.face[long], len(faces))]
        a, b = edges.ends[chosen].T
        middle = len(points) + np.arange(len(chosen))
        points = np.vstack([points, 0.5 * (points[a] + points[b])])
        error = np.concatenate([error, np.maximum(error[a], error[b])])
        c, d = edges.opposite[chosen].T
        faces[edges.face[chosen, 0]] = np.stack([a, middle, c], 1)
        faces[edges.face[chosen, 1]] = np.stack([b, middle, d], 1)
        faces = np.vstack([faces, np.stack([middle, b, c], 1), np.stack([middle, a, d], 1)])
    return points, faces, error


def _flip(points: Array, faces: Index, tolerance: float) -> Index:
    """Turn edges whose other diagonal gives better triangles, where the two diagonals nearly touch."""
    faces = faces.copy()
    for _ in range(12):
        edges = edges_of(faces)
        (a, b), (c, d) = edges.ends.T, edges.opposite.T
        one, two = points[np.stack([a, d, c], 1)], points[np.stack([d, b, c], 1)]
        before = np.minimum(shape_quality(points[faces[edges.face[:, 0]]]), shape_quality(points[faces[edges.face[:, 1]]]))
        gain = np.minimum(shape_quality(one), shape_quality(two)) / np.maximum(before, 1e-12)
        normal_old = face_normals(points[faces[edges.face[:, 0]]]) + face_normals(points[faces[edges.face[:, 1]]])
        normal_one, normal_two = face_normals(one), face_normals(two)
        across = cross(points[b] - points[a], points[d] - points[c])
        gap = np.abs(dot(points[c] - points[a], across)) / np.sqrt(np.maximum(dot(across, across), 1e-300))
        key = np.minimum(c, d) * len(points) + np.maximum(c, d)
        present = np.isin(key, np.minimum(a, b) * len(points) + np.maximum(a, b))
        good = np.flatnonzero(
            (gain > 1.05)
            & (gap < 0.5 * tolerance)
            & ~present
            & (c != d)
            & (cosine(normal_one, normal_old) > SMALLEST_COSINE)
            & (cosine(normal_two, normal_old) > SMALLEST_COSINE)
        )
        if not len(good):
            break
        stencil = np.stack([a, b, c, d], 1)[good]
        chosen = good[_local_minima(_rank(-gain[good]), stencil, len(points))]
        faces[edges.face[chosen, 0]] = np.stack([a, d, c], 1)[chosen]
        faces[edges.face[chosen, 1]] = np.stack([d, b, c], 1)[chosen]
    return faces


def _collapse(points: Array, faces: Index, error: Array, size: SizeLaw, tolerance: float) -> tuple[Index, Array]:
    """Draw vertices at the end of short edges onto the other end while the surface stays within tolerance."""
    error, count, wished = error.copy(), len(points), size(points)
    chance = np.random.default_rng(0)
    known, cost, dirty = np.empty(0, np.int64), np.empty(0), np.ones(count, bool)
    crowded = len(faces) > CROWDED
    for _ in range(60):
        edges = edges_of(faces)
        side = points[edges.ends[:, 0]] - points[edges.ends[:, 1]]
        square = dot(side, side)
        short = square < (SHORTEST * wished[edges.ends].mean(axis=1)) ** 2
        ends, square = edges.ends[short], square[short]
        if crowded and len(faces) > CROWDED:
            # Cheaper by far: two or three edges a vertex are weighed instead of six.
            least = np.full(count, np.inf)
            for i in (0, 1):
                np.minimum.at(least, ends[:, i], square)
            ends = ends[(square == least[ends].T).any(axis=0)]
        directed = np.concatenate([ends, ends[:, ::-1]])
        key = directed[:, 0] * count + directed[:, 1]
        order = np.argsort(key)
        directed, key = directed[order], key[order]
        # Only what lies around the last collapses is weighed again.
        found = np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))
        stale = dirty[directed[:, 0]] | (known[found] != key if len(known) else True)
        fresh = np.empty(len(key))
        fresh[~stale] = cost[found[~stale]]
        fresh[stale] = _collapse_cost(points, faces, directed[stale], LONGEST * wished)
        known, cost = key, fresh
        fit = error[directed[:, 0]] + cost < tolerance
        fit[fit] = _link_condition(edges.ends, directed[fit], count)
        if not fit.any():
            if not crowded:
                break
            crowded = False
            continue
        gone, kept = directed[fit].T
        priority = _rank(np.round(2.0 * np.log2(cost[fit] + 0.1 * tolerance)) + chance.random(len(gone)))
        least = np.full(count, np.inf)
        np.minimum.at(least, gone, priority)
        np.minimum.at(least, kept, priority)
        least = _neighbour_minimum(least, edges.ends)
        chosen = (least[gone] == priority) & (least[kept] == priority)
        gone, kept = gone[chosen], kept[chosen]
        error[kept] = np.maximum(error[kept], error[gone] + cost[fit][chosen])
        target = np.arange(count)
        target[gone] = kept
        changed = faces[np.any(target[faces] != faces, axis=1)]
        dirty = np.zeros(count, bool)
        dirty[changed] = True
        faces = target[faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    return faces, error


def _link_condition(ends: Index, directed: Index, count: int) -> NDArray[np.bool_]:
    """Tell for edges (m, 2) whether their ends share just two neighbours, so that a collapse keeps a manifold."""
    adjacency = _adjacency(ends, count)
    common = adjacency[directed[:, 0]].multiply(adjacency[directed[:, 1]])
    return np.asarray(np.diff(common.tocsr().indptr) == 2)


def _adjacency(ends: Index, count: int) -> csr_matrix:
    """Return the vertex adjacency matrix (count, count)."""
    rows, columns = np.concatenate([ends[:, 0], ends[:, 1]]), np.concatenate([ends[:, 1], ends[:, 0]])
    return csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))


def _neighbour_minimum(values: Array, ends: Index) -> Array:
    """Return for every vertex the least value on it and on its neighbours."""
    result = values.copy()
    np.minimum.at(result, ends[:, 0], values[ends[:, 1]])
    np.minimum.at(result, ends[:, 1], values[ends[:, 0]])
    return result


def _stars(faces: Index, centres: Index, count: int) -> tuple[Index, Index]:
    """Return (which centre, which face) pairs of the faces around each centre vertex."""
    order = np.argsort(faces.ravel(), kind="stable")
    start = np.searchsorted(faces.ravel()[order], np.arange(count + 1))
    number = start[centres + 1] - start[centres]
    which = np.repeat(np.arange(len(centres)), number)
    offset = np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number)
    return which, order[start[centres[which]] + offset] // 3


def _collapse_cost(points: Array, faces: Index, directed: Index, longest: Array) -> Array:
    """Return how far each vanishing vertex is from the surface left behind; inf where that surface is unfit."""
    gone, kept = directed.T
    which, face = _stars(faces, gone, len(points))
    triangle = faces[face]
    stays = ~np.any(triangle == kept[which, None], axis=1)
    which, triangle = which[stays], triangle[stays]
    old = points[triangle]
    new = points[np.where(triangle == gone[which, None], kept[which, None], triangle)]
    quality = shape_quality(new)
    bad = cosine(face_normals(old), face_normals(new)) < SMALLEST_COSINE
    bad |= (quality < 0.5 * shape_quality(old)) & (quality < 0.3)
    for i in range(3):
        side = new[:, i] - new[:, i - 1]
        bad |= dot(side, side) > longest[kept[which]] ** 2
    distance = np.full(len(gone), np.inf)
    good = np.bincount(which, bad, minlength=len(gone)) == 0
    which, new = which[good[which]], new[good[which]]
    np.minimum.at(distance, which, point_triangle_distance(points[gone[which]], new))
    return distance


def _smooth_flats(points: Array, faces: Index) -> Array:
    """Move vertices whose faces lie in one plane towards the mean of their neighbours, inside that plane."""
    normals = face_normals(points[faces])
    normals /= np.sqrt(np.maximum(dot(normals, normals), 1e-300))[:, None]
    total = np.zeros_like(points)
    number = np.bincount(faces.ravel(), minlength=len(points))
    np.add.at(total, faces.ravel(), np.repeat(normals, 3, axis=0))
    flat = np.linalg.norm(total, axis=1) > (1.0 - 1e-7) * np.maximum(number, 1)
    adjacency = _adjacency(edges_of(faces).ends, len(points))
    for _ in range(4):
        mean = adjacency @ points / np.maximum(adjacency.sum(axis=1).A1, 1.0)[:, None]
        moved = np.where(flat[:, None], 0.5 * (points + mean), points)
        worse = (shape_quality(moved[faces]) < 0.9 * shape_quality(points[faces])) & (shape_quality(moved[faces]) < 0.6)
        worse |= dot(face_normals(moved[faces]), normals) <= 0.0
        held = np.unique(faces[worse])
        moved[held] = points[held]
        still = dot(face_normals(moved[faces]), normals) <= 0.0
        if still.any():
            return points
        points = moved
    return points


def cross(one: Array, two: Array) -> Array:
    """Return the vector product of rows (n, 3)."""
    (a, b, c), (d, e, f) = one.T, two.T
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], axis=1)


def dot(one: Array, two: Array) -> Array:
    """Return the scalar product of rows (n, 3)."""
    return np.asarray(np.einsum("ij,ij->i", one, two))


def face_normals(corners: Array) -> Array:
    """Return normals (n, 3) of length twice the area, of triangles (n, 3, 3)."""
    return cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def shape_quality(corners: Array) -> Array:
    """Return 4 sqrt(3) area / sum of squared sides of triangles (n, 3, 3): 1 equilateral, 0 flat."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = cross(one, two)
    sides = dot(one, one) + dot(two, two) + dot(two - one, two - one)
    return 2.0 * np.sqrt(3.0 * dot(normal, normal)) / np.maximum(sides, 1e-300)


def cosine(one: Array, two: Array) -> Array:
    """Return the cosine between rows; -1 where a row is null."""
    norm = np.sqrt(dot(one, one) * dot(two, two))
    return np.where(norm > 0.0, dot(one, two) / np.maximum(norm, 1e-300), -1.0)


def point_triangle_distance(point: Array, corners: Array) -> Array:
    """Return the distance of points (n, 3) to triangles (n, 3, 3)."""
    normal = face_normals(corners)
    best = np.full(len(point), np.inf)
    inside = np.ones(len(point), bool)
    for i in range(3):
        start, side = corners[:, i], corners[:, (i + 1) % 3] - corners[:, i]
        along = dot(point - start, side) / np.maximum(dot(side, side), 1e-300)
        apart = point - start - np.clip(along, 0.0, 1.0)[:, None] * side
        best = np.minimum(best, dot(apart, apart))
        inside &= dot(cross(side, point - start), normal) >= 0.0
    height = np.abs(dot(point - corners[:, 0], normal)) / np.sqrt(np.maximum(dot(normal, normal), 1e-300))
    return np.where(inside, np.minimum(np.sqrt(best), height), np.sqrt(best))
