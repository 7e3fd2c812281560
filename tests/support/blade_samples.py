"""Analytic blades, meshed: an independent statement of what the geometry code has to find."""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

Array = NDArray[np.float64]


def blade_point(
    phi: Array,
    z: Array,
    chord: float = 0.05,
    span: float = 0.1,
    thick: float = 0.12,
    camber: float = 0.06,
    taper: float = 0.25,
    twist: float = 0.4,
) -> Array:
    """Points (..., 3) m of a cambered, tapered, twisted aerofoil; phi = pi is the round leading edge, 0 the trailing.

    0 < phi < pi is the convex side. Every formula is entire, so derivatives come from complex steps or differences.
    """
    w = z / span
    c = chord * (1.0 - taper * w)
    x = 0.5 * np.cos(phi)
    y = 0.5 * thick * np.sin(phi) * (1.0 - 0.6 * np.cos(phi)) + camber * np.sin(phi) ** 2
    a = twist * (w - 0.3) + 0.1 * w**2
    return np.stack([c * (x * np.cos(a) - y * np.sin(a)), c * (x * np.sin(a) + y * np.cos(a)), z + 0.0 * x], axis=-1)


def exact_geometry(phi: Array, z: Array, **shape: float) -> tuple[Array, Array, Array, Array]:
    """Outward normal (n, 3), and x_phi, x_z and the second fundamental form (n, 2, 2), by central differences."""
    h, l = 1e-4, 1e-5

    def x(i: float, j: float) -> Array:
        return blade_point(phi + i * h, z + j * l, **shape)

    xp, xz = (x(1, 0) - x(-1, 0)) / (2 * h), (x(0, 1) - x(0, -1)) / (2 * l)
    n = np.cross(xp, xz)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    second = np.empty((*phi.shape, 2, 2))
    second[..., 0, 0] = np.sum(n * (x(1, 0) - 2 * x(0, 0) + x(-1, 0)), -1) / h**2
    second[..., 1, 1] = np.sum(n * (x(0, 1) - 2 * x(0, 0) + x(0, -1)), -1) / l**2
    second[..., 0, 1] = second[..., 1, 0] = np.sum(n * (x(1, 1) - x(1, -1) - x(-1, 1) + x(-1, -1)), -1) / (4 * h * l)
    return n, xp, xz, second


def blade_mesh(n_phi: int = 160, n_z: int = 60, span: float = 0.1, **shape: float) -> tuple[Array, NDArray[np.int64]]:
    """Closed mesh: vertices (nv, 3) m on the analytic surface, faces (nf, 3) outward, flat caps at both ends."""
    q = np.linspace(0.0, 2 * np.pi, n_phi, endpoint=False)
    z = np.linspace(0.0, span, n_z)
    grid = blade_point(*np.meshgrid(q, z), span=span, **shape)
    vertices = grid.reshape(-1, 3)
    i, k = np.meshgrid(np.arange(n_phi), np.arange(n_z - 1))
    a, b = (k * n_phi + i).ravel(), (k * n_phi + (i + 1) % n_phi).ravel()
    faces = [np.stack([a, b, b + n_phi], 1), np.stack([a, b + n_phi, a + n_phi], 1)]
    for row, turn in ((0, -1), (n_z - 1, 1)):
        faces.append((row * n_phi + _strip(n_phi))[:, ::turn])
    return vertices, np.concatenate(faces)


def _strip(n: int) -> NDArray[np.int64]:
    """Triangles (m, 3) between the two walls of a section of n points: point j lies opposite n - j."""
    quads = [(j % n, (j + 1) % n, (n - j - 1) % n, (n - j) % n) for j in range(n // 2)]
    return np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d)) if len(set(f)) == 3])


def write_stl(path: Path, vertices: Array, faces: NDArray[np.int64], unit: float = 1e-3) -> Path:
    """Binary STL of a mesh in m, written in `unit` m."""
    record = np.zeros(len(faces), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    record["v"] = vertices[faces] / unit
    path.write_bytes(b"sample".ljust(80, b" ") + np.uint32(len(faces)).tobytes() + record.tobytes())
    return path


def bundled_with_shroud() -> tuple[Array, NDArray[np.int64]]:
    """The bundled blade's formulas with a second block on the tip: vertices (nv, 3) m, faces (nf, 3)."""
    import make_bundled_blade as made

    stack = made.rows()
    foot = made.section(made.TIP, made.FILLET)
    around = made.AROUND
    top = []
    for angle in np.deg2rad([82.0, 72.0, 57.0, 40.0, 20.0]):
        z = made.TIP + made.FILLET * np.cos(angle)
        top.append(np.column_stack([made.section(made.TIP, made.FILLET * (1.0 - np.sin(angle))), np.full(around, z)]))
    top.append(np.column_stack([foot, np.full(around, made.TIP + made.FILLET)]))
    middle = foot.mean(axis=0)
    for z in (0.0, 6.0):
        top.append(np.column_stack([middle + 1.15 * (foot - middle), np.full(around, made.TIP + made.FILLET + z)]))
    stack = stack + top
    vertices = np.vstack(stack)
    i, k = np.meshgrid(np.arange(around), np.arange(len(stack) - 1))
    a, b = (k * around + i).ravel(), (k * around + (i + 1) % around).ravel()
    ring = np.arange(around)
    faces = [
        np.stack([a, b, b + around], 1),
        np.stack([a, b + around, a + around], 1),
        _strip(around) + (len(stack) - 1) * around,
        np.stack([np.roll(ring, -1), ring, np.full(around, len(vertices))], 1),
    ]
    return 1e-3 * np.vstack([vertices, [[0.0, 0.5, 0.0]]]), np.concatenate(faces)
