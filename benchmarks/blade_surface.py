"""How near the smooth surface comes to analytic blades, and how long reading, analysis and passes take.

python benchmarks/blade_surface.py [STL ..]
"""

import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.support import blade_samples  # noqa: E402
from trajectories.blade import Blade, find_shape, read_blade  # noqa: E402
from trajectories.passes import PassOptions, passes  # noqa: E402


def against_formula(n_phi: int, n_z: int) -> str:
    vertices, faces = blade_samples.blade_mesh(n_phi, n_z)
    blade = Blade("analytic", "", vertices, faces)
    paths, _ = passes(blade, find_shape(blade), PassOptions(step=2e-3))
    p, n, t, k = (np.concatenate([getattr(path, name) for path in paths]) for name in ("p", "n", "t", "curvature"))
    side = np.concatenate([np.full(len(path.p), path.side == "convex") for path in paths])
    phi, z = np.where(side, 0.5, 1.5) * np.pi, p[:, 2].copy()
    for _ in range(60):
        normal, xp, xz, second = blade_samples.exact_geometry(phi, z)
        gap = p - blade_samples.blade_point(phi, z)
        step = np.linalg.solve(np.stack([xp, xz, normal], axis=2), gap[:, :, None])[:, :, 0]
        phi, z = phi + np.clip(step[:, 0], -0.1, 0.1), z + np.clip(step[:, 1], -2e-3, 2e-3)
    angle = np.rad2deg(np.arcsin(np.clip(np.linalg.norm(np.cross(n, normal), axis=1), 0.0, 1.0)))
    frame = np.linalg.pinv(np.stack([xp, xz], axis=2)) @ np.stack([t, np.cross(n, t)], axis=2)
    exact = -np.swapaxes(frame, 1, 2) @ second @ frame
    error = np.abs(k - np.stack([exact[:, 0, 0], exact[:, 1, 1], exact[:, 0, 1]], axis=1)).max(axis=1)
    share = 100 * error / np.maximum(np.linalg.norm(exact, axis=(1, 2)), 3.0)
    off = 1e6 * np.abs(step[:, 2])
    return (
        f"| {n_phi} x {n_z} | {np.median(off):.2f} / {off.max():.2f} | {np.median(angle):.4f} / {angle.max():.3f} | "
        f"{np.median(share):.2f} / {np.quantile(share, 0.95):.1f} / {share.max():.1f} |"
    )


def main(files: list[Path]) -> None:
    print("| mesh | distance um, median / worst | normal deg | curvature %, median / 95 % / worst |\n|---|---|---|---|")
    for n_phi, n_z in ((80, 20), (160, 60), (300, 120)):
        print(against_formula(n_phi, n_z))
    print("\n| blade | facets | reading s | shape s | passes s | passes, waypoints | mesh to surface um, median / worst |")
    print("|---|---|---|---|---|---|---|")
    for file in files:
        clock = [time.process_time()]
        blade = read_blade(file)
        clock.append(time.process_time())
        shape = find_shape(blade)
        clock.append(time.process_time())
        paths, _ = passes(blade, shape, PassOptions())
        clock.append(time.process_time())
        reading, analysis, laying = np.diff(clock)
        worst = 1e6 * np.max([side.deviation for side in shape.sides.values()], axis=0)
        print(
            f"| {file.stem} | {len(blade.faces)} | {reading:.2f} | {analysis:.2f} | {laying:.2f} | {len(paths)}, "
            f"{sum(len(path.p) for path in paths)} | {worst[0]:.2f} / {worst[1]:.2f} |"
        )


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]] or [ROOT / "ocp" / "data" / "blade.stl"])
