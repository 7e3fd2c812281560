"""How much c_nn changes when the element size is halved: the tables of docs/blade_compliance.md.

    python benchmarks/blade_compliance_convergence.py ../shared/data/blades/twisted.stl 4.2 2.1 1.05

Set GRINDPLAN_CACHE= (empty) to time the meshing as well

Ti-6Al-4V, clamped below z = 10 mm, patch 3 mm along the span by 6 mm. `inner`: waypoints farther than 6 mm from the
tip, the clamp and both ends of the section; `edge`: the others above the clamp.
"""

import sys
import time

import numpy as np
import trimesh

from ocp.contact.blade import volume_mesh as meshing
from ocp.contact.blade.compliance import HeldBlade, clamped_blade
from ocp.contact.blade.elasticity import Material

NOTICEABLE = 5e-8  # m/N: 20 N move the blade by one micrometre
CLAMP, PATCH = 0.010, (3e-3, 6e-3)


def waypoints(blade: trimesh.Trimesh, lines: int = 8, heights: int = 14) -> tuple[np.ndarray, ...]:
    """Contacts on both sides of `heights` sections: p, n, t (m, 3) and the distance (m,) to an edge or the clamp."""
    top = blade.bounds[1, 2]
    p, n, apart = [], [], []
    for z in np.linspace(CLAMP + 1.5e-3, top - 0.5e-3, heights):
        segments, faces = trimesh.intersections.mesh_plane(blade, [0, 0, 1], [0, 0, z], return_faces=True)
        centre = segments.reshape(-1, 3).mean(axis=0)
        chord = np.linalg.svd(segments.reshape(-1, 3) - centre, full_matrices=False)[2][0]
        along = (segments - centre) @ chord
        for x in along.min() + (np.arange(lines) + 0.5) / lines * np.ptp(along):
            for i in np.flatnonzero((along.min(axis=1) <= x) & (along.max(axis=1) > x)):
                share = (x - along[i, 0]) / (along[i, 1] - along[i, 0])
                p.append(segments[i, 0] + share * (segments[i, 1] - segments[i, 0]))
                n.append(blade.face_normals[faces[i]])
                apart.append(min(x - along.min(), along.max() - x, top - z, z - CLAMP))
    n = np.array(n)
    t = np.array([0.0, 0.0, 1.0]) - n[:, 2:] * n
    return np.array(p), n, t / np.linalg.norm(t, axis=1)[:, None], np.array(apart)


def main(path: str, sizes: list[float]) -> None:
    """Print one row a size."""
    meshing.MAX_ELEMENTS = 200_000  # the finest mesh of the table is beyond what a plan may use
    blade = trimesh.load(path)
    blade.apply_scale(1e-3)
    vertices, faces = np.array(blade.vertices), np.array(blade.faces)
    p, n, t, apart = waypoints(blade)
    inner = apart > max(PATCH)
    print(f"{path}: {len(p)} waypoints, {inner.sum()} inner")
    print(
        "| size mm | elements | unknowns | volume error % | mesh s | rest s | inner max % | c > 50 nm/N max % | inner median % "
        "| edge max % | edge median % |\n|---|---|---|---|---|---|---|---|---|---|---|"
    )
    last = None
    for size in sizes:
        start = time.perf_counter()
        meshing.volume_mesh(vertices, faces, size * 1e-3, (np.array([0.0, 0.0, 1.0]), CLAMP))
        meshed = time.perf_counter()
        solid = clamped_blade(HeldBlade(vertices, faces, np.array([0.0, 0.0, 1.0]), CLAMP, Material()), size * 1e-3)
        c = solid.compliance(p, n, t, PATCH)[:, 0]
        row = (
            f"| {size} | {len(solid.mesh.elements)} | {solid.factorisation.unknowns} | {100 * solid.volume_error:.3f} "
            f"| {meshed - start:.1f} | {time.perf_counter() - meshed:.1f} "
        )
        if last is not None:
            change = 100.0 * np.abs(c / last - 1.0)
            row += f"| {change[inner].max():.2f} | {change[inner & (c > NOTICEABLE)].max():.2f} | {np.median(change[inner]):.2f} "
            row += f"| {change[~inner].max():.2f} | {np.median(change[~inner]):.2f} |"
        print(row, flush=True)
        last = c


if __name__ == "__main__":
    main(sys.argv[1], [float(size) for size in sys.argv[2:]])
