"""Small faults of a triangle soup put right, one function a fault; each says what it did."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from robots.errors import BadInput
from trajectories.blade.mesh import Array, IntArray, area_vectors, directed_edges, edge_keys, facet_normals, place_mm, volume

_STRAY_SHARE = 0.05  # area of a body against the largest one, below which it is a stray part
_SLIVER = 1e-5  # height of a facet against its longest edge, below which rounding alone gives it its direction
_LARGEST_HOLE = 0.05  # size of a hole against the blade's size up to which it is closed
_MOST_HOLE_EDGES = 60
_FLAT, _MOST_FLAT_EDGES = (
    1e-3,
    600,
)  # of a scan's opening: how far off a plane its border may be; edges that are closed in seconds


def merge_corners(corners: Array) -> tuple[Array, IntArray]:
    """Shared vertices (nv, 3) and faces (nf, 3) from facet corners (nf, 3, 3); exactly equal points become one."""
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, np.asarray(index, np.int64).reshape(-1, 3)


def merge_close(vertices: Array, faces: IntArray, notices: list[str]) -> tuple[Array, IntArray]:
    """Join vertices that rounding has torn apart, when there are open edges and joining closes some.

    The reach is 1e-6 of the blade's size (0.1 um on 100 mm), the resolution of the numbers in an STL file.
    """
    before = len(_open_edges(faces, len(vertices)))
    if not before:
        return vertices, faces
    reach = 2e-6 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    _, first, index = np.unique(np.round(vertices / reach), axis=0, return_index=True, return_inverse=True)
    joined = np.asarray(index, np.int64).ravel()[faces]
    joined = joined[_distinct(joined)]
    if len(_open_edges(joined, len(first))) >= before:
        return vertices, faces
    notices.append(f"{len(vertices) - len(first)} vertices closer than {1e6 * reach:.2g} um to another were joined.")
    return vertices[first], joined


def _distinct(faces: IntArray) -> np.ndarray:
    return (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])


def _open_edges(faces: IntArray, n_vertices: int) -> IntArray:
    """Directed edges (n, 2) that have no partner."""
    edges = directed_edges(faces)
    keys = edge_keys(edges, n_vertices)
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return edges[counts[inverse] == 1]


def drop_useless(vertices: Array, faces: IntArray, notices: list[str]) -> IntArray:
    """Remove facets with two equal corners and repeated facets; turn slivers without area into their neighbours."""
    keep = _distinct(faces)
    if not keep.all():
        notices.append(f"{int((~keep).sum())} facets without area were removed.")
    faces = faces[keep]
    # A facet and its copies count once; a facet and its mirror image enclose nothing and both go.
    order = np.argsort(faces, axis=1)
    winding = np.where((order[:, 1] - order[:, 0]) % 3 == 1, 1, -1)
    same = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True)[1].ravel()
    left = np.flatnonzero(winding * np.bincount(same, weights=winding, minlength=1)[same] > 0)
    chosen = np.sort(left[np.unique(same[left], return_index=True)[1]])
    if len(chosen) < len(faces):
        notices.append(f"{len(faces) - len(chosen)} repeated facets were removed.")
        faces = faces[chosen]
    return _flip_slivers(vertices, faces, notices)


def _flip_slivers(vertices: Array, faces: IntArray, notices: list[str]) -> IntArray:
    """Facets whose corners lie on a line: swap the long edge with the neighbour's diagonal, which keeps it closed."""
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    flat = np.flatnonzero(2.0 * np.linalg.norm(area_vectors(vertices, faces), axis=1) <= _SLIVER * longest**2)
    if not len(flat):
        return faces
    faces = faces.copy()
    done = 0
    for k in flat:
        lengths = np.linalg.norm(vertices[faces[k]] - vertices[np.roll(faces[k], -1)], axis=1)
        i = int(np.argmax(lengths))
        a, b, c = (int(faces[k, (i + j) % 3]) for j in range(3))
        has_edge = ((faces == b) & (np.roll(faces, -1, axis=1) == a)).any(axis=1)
        if not has_edge.any():
            continue
        m = int(np.argmax(has_edge))
        d = next(int(x) for x in faces[m] if x not in (a, b))
        if d == c:
            continue
        faces[k], faces[m] = (a, d, c), (d, b, c)
        done += 1
    notices.append(f"{done} of {len(flat)} facets without area were merged into their neighbours.")
    return faces


def unify_winding(name: str, vertices: Array, faces: IntArray, notices: list[str]) -> IntArray:
    """Turn facets so that neighbours agree on inside and outside.

    Raises: BadInput at an edge with more than two facets, or where no agreement exists (a one-sided surface).
    """
    edges = directed_edges(faces)
    keys = edge_keys(edges, len(vertices))
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    start = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    counts = np.diff(np.append(start, len(ordered)))
    if (counts > 2).any():
        edge = edges[order[start[np.argmax(counts > 2)]]]
        raise BadInput(
            f"{name}: {int(counts.max())} facets meet at the edge near {place_mm(vertices[edge].mean(axis=0))}, a closed "
            f"surface has 2; export one solid body without inner faces."
        )
    pairs = start[counts == 2]
    first, second = order[pairs], order[pairs + 1]
    clash = edges[first, 0] == edges[second, 0]
    if not clash.any():
        return faces
    n = len(faces)
    i, j = first % n, second % n
    # A shortest-path tree over the facets carries "turned or not" from one seed to a whole body.
    weight = np.where(clash, 2, 1)
    graph = coo_array((np.concatenate([weight, weight]), (np.concatenate([i, j]), np.concatenate([j, i]))), (n, n)).tocsr()
    turned = np.zeros(n, bool)
    count, body = connected_components(graph, directed=False)
    for b in range(count):
        nodes, parent = breadth_first_order(graph, int(np.argmax(body == b)), directed=False)
        for node in nodes[1:]:
            turned[node] = turned[parent[node]] ^ (graph[parent[node], node] == 2)
        mine = body == b
        if turned[mine].sum() > 0.5 * mine.sum():
            turned[mine] = ~turned[mine]
    if ((turned[i] ^ turned[j]) != clash).any():
        raise BadInput(f"{name}: the surface has no inside and outside (it is one-sided); export one solid body.")
    notices.append(f"{int(turned.sum())} facets were wound the other way round than their neighbours and were turned.")
    return np.where(turned[:, None], faces[:, ::-1], faces)


def keep_main_body(name: str, vertices: Array, faces: IntArray, notices: list[str]) -> IntArray:
    """The one large connected body; stray small parts are dropped with a notice.

    Raises: BadInput when two bodies are of comparable size, or no facet has an area.
    """
    edges = directed_edges(faces)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (len(vertices), len(vertices)))
    count, label = connected_components(graph, directed=False)
    body = label[faces[:, 0]]
    area = np.bincount(body, facet_normals(vertices, faces)[1], minlength=count)
    order = np.argsort(-area)
    order = order[area[order] > 0]
    if len(order) == 0:
        raise BadInput(f"{name}: no facet has an area, their corners lie on lines; export a closed solid.")
    if len(order) == 1:
        return faces
    main = order[0]
    if area[order[1]] > _STRAY_SHARE * area[main]:
        place = vertices[faces[body == order[1]]].mean(axis=(0, 1))
        raise BadInput(
            f"{name}: holds {len(order)} separate bodies; the second, round {place_mm(place)}, has "
            f"{100 * area[order[1]] / area[main]:.0f} % of the first one's area: export one solid blade alone."
        )
    notices.append(
        f"{len(order) - 1} stray parts ({100 * area[order[1:]].sum() / area[main]:.2g} % of the blade's area) were dropped."
    )
    return faces[body == main]


def face_outward(vertices: Array, faces: IntArray, notices: list[str]) -> IntArray:
    """Turn the whole surface where it is inside-out."""
    if volume(vertices, faces) >= 0.0:
        return faces
    notices.append("The surface was inside-out; all facets were turned.")
    return faces[:, ::-1].copy()


def close_holes(name: str, vertices: Array, faces: IntArray, notices: list[str], scanned: bool = False) -> IntArray:
    """Faces with small holes closed by the triangulation of least area; (nf + new, 3). scanned: flat openings of any size too, as
    the end has on which a blade stood or was held.

    Raises: BadInput naming place and size of a hole too large to guess what was there.
    """
    edges = directed_edges(faces)
    if set((edges @ (len(vertices), 1)).tolist()) == set((edges @ (1, len(vertices))).tolist()):
        return faces
    forward = set(map(tuple, edges.tolist()))
    border = [(j, i) for i, j in forward if (j, i) not in forward]
    size = float(np.linalg.norm(np.ptp(vertices[np.unique(faces)], axis=0)))
    added: list[tuple[int, int, int]] = []
    described = []
    for loop in _loops(name, vertices, border):
        points = vertices[loop]
        across = float(np.linalg.norm(np.ptp(points, axis=0)))
        middle = place_mm(points.mean(axis=0))
        flat = scanned and len(loop) <= _MOST_FLAT_EDGES and _is_flat(points, size)
        if not flat and (across > _LARGEST_HOLE * size or len(loop) > _MOST_HOLE_EDGES):
            remedy = "scan that side too, or close it in the scanner's software" if scanned else "export a closed solid"
            raise BadInput(
                f"{name}: the surface is open: a hole {1e3 * across:.1f} mm across with {len(loop)} edges round {middle} "
                f"(holes up to {1e3 * _LARGEST_HOLE * size:.1f} mm are closed); {remedy}."
            )
        added += _least_area(points, loop)
        described.append(f"{1e3 * across:.2f} mm at {middle}")
    shown = ", ".join(described[:3]) + (", .." if len(described) > 3 else "")
    notices.append(f"{len(described)} holes were closed with {len(added)} facets: {shown}.")
    return np.concatenate([faces, np.array(added, np.int64)])


def _is_flat(points: Array, size: float) -> bool:
    """Whether points lie within a thousandth of the blade's size of a plane."""
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    return bool(np.abs(centred @ normal).max() < _FLAT * size)


def _loops(name: str, vertices: Array, border: list[tuple[int, int]]) -> list[list[int]]:
    """Closed vertex loops along the border, in the direction that new facets need."""
    following: dict[int, list[int]] = {}
    for i, j in border:
        following.setdefault(i, []).append(j)
    loops = []
    while following:
        start = next(iter(following))
        loop = [start]
        while True:
            options = following.get(loop[-1])
            if not options:
                raise BadInput(f"{name}: the border of a hole at {place_mm(vertices[loop[-1]])} does not close; export it again.")
            step = options.pop()
            if not options:
                del following[loop[-1]]
            if step == start:
                break
            if step in loop:  # two holes touch in a vertex: cut the smaller loop off
                k = loop.index(step)
                loops.append(loop[k:])
                loop = loop[: k + 1]
            else:
                loop.append(step)
        loops.append(loop)
    return [loop for loop in loops if len(loop) > 2]


def _least_area(points: Array, loop: list[int]) -> list[tuple[int, int, int]]:
    """Triangulation of a closed polygon in space with least total area (Barequet and Sharir 1995, section 3)."""
    n = len(loop)
    cost = np.zeros((n, n))
    split = np.zeros((n, n), int)
    for gap in range(2, n):
        for i in range(n - gap):
            k = i + gap
            m = np.arange(i + 1, k)
            area = 0.5 * np.linalg.norm(np.cross(points[m] - points[i], points[k] - points[i]), axis=1)
            total = cost[i, m] + cost[m, k] + area
            best = int(np.argmin(total))
            cost[i, k], split[i, k] = total[best], m[best]
    triangles = []
    stack = [(0, n - 1)]
    while stack:
        i, k = stack.pop()
        if k - i < 2:
            continue
        middle = int(split[i, k])
        triangles.append((loop[i], loop[middle], loop[k]))
        stack += [(i, middle), (middle, k)]
    return triangles
