"""Write ocp/data/blade.stl: a twisted, tapered, cambered aerofoil with fillet and root block, all from formulas.

    python benchmarks/make_bundled_blade.py [OUT.stl]

Millimetres; z is the span: block from 0 to 20, fillet of 3 mm radius, aerofoil to 120, chord along x at the root.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AROUND = 112  # points of a section, a multiple of 4
BLOCK_TOP, TIP, FILLET = 20.0, 120.0, 3.0  # mm
CHORD = (46.0, 36.0)  # mm at block top and tip
THICKNESS = (0.115, 0.065)  # of the chord, before the edges are rounded
CAMBER = (0.050, 0.035)  # of the chord
TWIST = np.deg2rad(20.0)
EDGE_RADIUS = 0.25  # mm added all round, so that the trailing edge is a radius and not a knife
BLOCK = (-27.5, 27.5, -6.5, 8.0)  # mm: x and y of the root block


def section(z: float, offset: float = 0.0) -> Array:
    """Closed section (AROUND, 2) mm, counter-clockwise from the trailing edge, moved outward by `offset` mm."""
    w = (z - BLOCK_TOP) / (TIP - BLOCK_TOP)
    chord, thick, camber = (a + (b - a) * w for a, b in (CHORD, THICKNESS, CAMBER))
    q = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)

    def curve(p: Array) -> Array:
        x = 0.5 * np.cos(p)
        y = 0.5 * thick * np.sin(p) * (1.0 - 0.25 * np.cos(p)) + camber * np.sin(p) ** 2 - 0.5 * camber
        return chord * np.stack([x, y], axis=1)

    tangent = (curve(q + 1e-5) - curve(q - 1e-5)) / 2e-5
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    points = curve(q) + (EDGE_RADIUS + offset) * normal
    a = TWIST * w
    return points @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])


def block_outline(inner: Array) -> Array:
    """Points (AROUND, 2) mm on the block's rectangle, counter-clockwise, its corners among them, matched to `inner`."""
    x0, x1, y0, y1 = BLOCK
    corners = np.array([[x1, y1], [x0, y1], [x0, y0], [x1, y0]])
    at = [int(np.argmin(np.linalg.norm(inner - corner, axis=1))) for corner in corners]
    out = np.empty((AROUND, 2))
    for k in range(4):
        first, last = at[k], at[(k + 1) % 4] + (AROUND if at[(k + 1) % 4] <= at[k] else 0)
        share = np.linspace(0.0, 1.0, last - first + 1)[:, None]
        out[np.arange(first, last + 1) % AROUND] = (1.0 - share) * corners[k] + share * corners[(k + 1) % 4]
    return out


def rows() -> list[Array]:
    """Closed rows (AROUND, 3) mm from the bottom of the block to the tip."""
    foot = section(BLOCK_TOP, FILLET)
    rim = block_outline(foot)
    result = [(rim, 0.0), (rim, 0.5 * BLOCK_TOP), (rim, BLOCK_TOP), (foot, BLOCK_TOP)]
    for angle in np.deg2rad([20.0, 40.0, 57.0, 72.0, 82.0]):
        z = BLOCK_TOP + FILLET * (1.0 - np.cos(angle))
        result.append((section(z, FILLET * (1.0 - np.sin(angle))), z))
    result += [(section(z), z) for z in np.linspace(BLOCK_TOP + FILLET, TIP, 25)]
    return [np.column_stack([points, np.full(AROUND, z)]) for points, z in result]


def mesh() -> tuple[Array, NDArray[np.int64]]:
    """Vertices (nv, 3) mm and outward faces (nf, 3) of the closed blade."""
    stack = rows()
    vertices = np.vstack(stack)
    i, k = np.meshgrid(np.arange(AROUND), np.arange(len(stack) - 1))
    a, b = (k * AROUND + i).ravel(), (k * AROUND + (i + 1) % AROUND).ravel()
    faces = [np.stack([a, b, b + AROUND], 1), np.stack([a, b + AROUND, a + AROUND], 1)]
    faces.append(_strip() + (len(stack) - 1) * AROUND)
    ring = np.arange(AROUND)
    faces.append(np.stack([np.roll(ring, -1), ring, np.full(AROUND, len(vertices))], 1))
    return np.vstack([vertices, [[0.5 * (BLOCK[0] + BLOCK[1]), 0.5 * (BLOCK[2] + BLOCK[3]), 0.0]]]), np.concatenate(faces)


def _strip() -> NDArray[np.int64]:
    """The tip cap, a strip between the two walls: point j lies opposite AROUND - j, seen from either edge."""
    faces = []
    for j in range(AROUND // 2):
        a, b, c, d = j % AROUND, (j + 1) % AROUND, (AROUND - j - 1) % AROUND, (AROUND - j) % AROUND
        faces += [f for f in ((a, b, c), (a, c, d)) if len(set(f)) == 3]
    return np.array(faces)


def main(out: Path) -> None:
    vertices, faces = mesh()
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    record = np.zeros(len(faces), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    record["n"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    record["v"] = corners
    out.write_bytes(b"bundled blade, mm, z is the span".ljust(80) + np.uint32(len(faces)).tobytes() + record.tobytes())
    print(f"{out}: {len(faces)} facets, {out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here / "ocp" / "data" / "blade.stl")
