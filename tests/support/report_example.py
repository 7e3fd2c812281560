"""A made-up but plausible plan for looking at reports: right shapes and magnitudes, no planner behind it.

Forces and deviations are smooth invented functions of the place on the blade. From the root, to look:
`python -m tests.support.report_example DIR [blade.stl]`
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.interpolate import CubicSpline

from ocp.plan.report.plan_report import CellAnimation, PassReport, PlanReport
from robots.pose import Array
from tests.support.report_arm import ROBOT, T_FLANGE_BLADE, WHEEL, capsules, elementary_arm, timed_motion

FEED = 0.04  # m/s


def synthetic_blade(levels: int = 45, around: int = 60) -> tuple[Array, Array]:
    """A closed twisted blade of 110 x 55 x 6 mm: vertices (nv, 3) m, faces (nf, 3), outward."""
    z, angle = np.linspace(0, 0.11, levels), 2 * np.pi * np.arange(around) / around
    x = 0.0275 * np.cos(angle)[None, :] * np.ones((levels, 1))
    y = 0.003 * np.sin(angle)[None, :] + 0.006 * (1 - (x / 0.0275) ** 2)
    twist = np.radians(25) * z[:, None] / 0.11
    ring = np.stack([x * np.cos(twist) - y * np.sin(twist), x * np.sin(twist) + y * np.cos(twist)], axis=-1)
    vertices = np.concatenate([ring, np.broadcast_to(z[:, None, None], (levels, around, 1))], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(levels - 1), np.arange(around), indexing="ij")
    a, b = (i * around + j).ravel(), (i * around + (j + 1) % around).ravel()
    sides = np.concatenate([np.c_[a, b, b + around], np.c_[a, b + around, a + around]])
    ends, fan = [len(vertices), len(vertices) + 1], np.arange(around)
    top = (levels - 1) * around
    caps = [np.c_[np.full(around, ends[0]), (fan + 1) % around, fan]]
    caps.append(np.c_[np.full(around, ends[1]), top + fan, top + (fan + 1) % around])
    middles = [vertices[:around].mean(0), vertices[top:].mean(0)]
    return np.concatenate([vertices, middles]), np.concatenate([sides, *caps])


def lay_lines(vertices: Array, faces: Array, lines: int, count: int) -> list[tuple[str, Array]]:
    """Spanwise lines on both sides by slicing across z: (side, points (count, 3)) each, root to tip."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    heights = np.linspace(low + 0.015, high - 0.005, 40)
    fractions = np.linspace(0.1, 0.9, lines)
    points = np.zeros((2, lines, len(heights), 3))
    chord = None
    for k, z in enumerate(heights):
        segments = np.asarray(trimesh.intersections.mesh_plane(mesh, [0, 0, 1], [0, 0, z]))[..., :2]
        flat = segments.reshape(-1, 2)
        direction = np.linalg.svd(flat - flat.mean(0), full_matrices=False)[2][0]
        direction = direction if chord is None or direction @ chord > 0 else -direction
        chord = direction
        across = np.array([-direction[1], direction[0]])
        u, v = segments @ direction, segments @ across
        for j, at in enumerate(u.min() + fractions * (u.max() - u.min())):
            hit = (u.min(1) <= at) & (u.max(1) >= at) & (np.abs(u[:, 1] - u[:, 0]) > 1e-9)
            share = (at - u[hit, 0]) / (u[hit, 1] - u[hit, 0])
            height = v[hit, 0] + share * (v[hit, 1] - v[hit, 0])
            for side, value in enumerate((height.max(), height.min())):
                points[side, j, k] = [*(at * direction + value * across), z]
    fine = np.linspace(heights[0], heights[-1], count)
    return [
        ("convex" if side == 0 else "concave", CubicSpline(heights[::6], points[side, j, ::6])(fine))
        for side in range(2)
        for j in range(lines)
    ]


def _fill_pass(line: int, side: str, p: Array, centre: Array, rng: np.random.Generator) -> PassReport:
    step = np.linalg.norm(np.diff(p, axis=0), axis=1)
    s = np.concatenate([[0], np.cumsum(step)])
    t = np.gradient(p, s, axis=0)
    t /= np.linalg.norm(t, axis=1)[:, None]
    outward = np.array([-centre[1], centre[0], 0]) * (1 if side == "convex" else -1)
    n = outward - t * (t @ outward)[:, None]
    n /= np.linalg.norm(n, axis=1)[:, None]
    span, chord = (p[:, 2] - 0.015) / 0.09, (line % 8 - 3.5) / 3.5
    wave = np.sin(5 * span + line) + 0.4 * np.sin(17 * span + 2 * line)
    force = 20 + 0.12 * wave * (0.4 + np.abs(chord)) + 0.02 * rng.standard_normal(len(s)).cumsum() / 6
    compliance = (0.3 + 2.6 * span**2 * (0.5 + chord**2)) * 1e-6
    return PassReport(
        line=line,
        side=side,
        p=p,
        n=n,
        t=t,
        s=s,
        force=force,
        force_sd=0.42 + 0.5 * span * np.abs(chord) + 0.05 * wave**2,
        interference=1.4e-4 + 3e-6 * wave + compliance * 20,
        compliance_nn=compliance,
        removal=(force / 20) ** 0.9,
        limit_ratio=0.45 + 0.3 * span + 0.1 * np.sin(3 * span + 0.7 * line),
        arc=np.radians(4 * np.sin(2 * span + 0.5 * line)),
        lateral=2e-3 * chord * np.cos(2 * span),
        turn=np.radians(9 * chord * np.sin(1.5 * span)),
        tilt=np.radians(np.c_[0.8 * np.sin(4 * span), 1.1 * chord * np.cos(3 * span)]),
        feed=np.full(len(s), FEED) * (1 - 0.35 * np.exp(-(((span - 0.6 - 0.2 * chord) / 0.08) ** 2))),
    )


def example_report(blade: Path | None = None, lines: int = 8, count: int = 188, frames: int = 600) -> PlanReport:
    """A whole report: `lines` passes a side, `count` waypoints each, analytic blade or STL in mm."""
    rng = np.random.default_rng(7)
    if blade is None:
        vertices, faces = synthetic_blade()
    else:
        mesh = trimesh.load(blade)
        vertices, faces = np.asarray(mesh.vertices) * 1e-3, np.asarray(mesh.faces)
    laid = lay_lines(vertices, faces, lines, count)
    chord = laid[lines - 1][1].mean(0) - laid[0][1].mean(0)
    passes = [_fill_pass(i + 1, side, p, chord, rng) for i, (side, p) in enumerate(laid)]
    motion = timed_motion(passes, 80.0)
    pick = np.linspace(0, len(motion.time) - 1, frames).astype(int)
    links = elementary_arm(motion.q[pick])
    animation = CellAnimation(motion.time[pick], links, T_FLANGE_BLADE)
    force = np.concatenate([item.force for item in passes])
    report = PlanReport(
        title="twisted",
        verdict=f"Every limit holds and the predicted force stays between {force.min():.2f} and "
        f"{force.max():.2f} N on all {len(passes)} passes; the target is 20 N.",
        safe=True,
        summary=(
            ("Blade", "twisted.stl, 110.0 x 55.3 x 23.5 mm"),
            ("Cell", "belt cell 1, kr210_r2700_extra with calibration"),
            ("Predicted force, mean", f"{force.mean():.2f} N"),
            ("Predicted force, smallest and largest", f"{force.min():.2f} .. {force.max():.2f} N"),
            ("Standard deviation of the force, largest", "1.07 N"),
            ("Duration", f"{motion.time[-1]:.1f} s"),
            ("Read back from the program, largest force difference", "0.003 N"),
        ),
        inputs={"blade: twisted.stl": "3b0c" * 16, "cell: cell.toml": "91fe" * 16, "calibration: calibration.toml": "07aa" * 16},
        notices=("12 duplicate vertices of twisted.stl were merged.", "No temperature is set: the cell's 22 C is taken."),
        target_force=20.0,
        vertices=vertices,
        faces=faces,
        passes=tuple(passes),
        motion=motion,
        animation=animation,
        robot=replace(ROBOT, link_shapes=capsules()),
        wheel=WHEEL,
    )
    return report


def main(folder: str, blade: str | None = None) -> None:
    """Write report.html, report.pdf and refused.html (a plan that must not be used) into the folder."""
    from ocp.plan.files import write_plan_report
    from ocp.plan.report.pages import plan_pages

    report = example_report(Path(blade) if blade else None)
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    write_plan_report(report, out)
    refused = replace(report, safe=False, verdict="Axis 5 passes its speed limit on line 3; no program was written.")
    plan_pages(refused).write_page(out / "refused.html")


if __name__ == "__main__":
    main(*sys.argv[1:])
