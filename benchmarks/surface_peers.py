"""Nearest point of a blade's surface: ours against trimesh's rtree, Open3D's RaycastingScene and libigl.

`python benchmarks/surface_peers.py [--points 2000] [--runs 3]`; full table: `--points 50000 --runs 7`.

The points lie off the convex flank of the bundled blade by 0.1 mm (sd). The peers answer on the facets of the STL. Ours is the
smooth spline through them that normals and curvatures are taken from (`trajectories.path_points.foot_parameters`: a tree of
60 x 60 points, then Gauss-Newton); trimesh is what the product uses where there is no spline, at the blade's edges. libigl
runs in one thread a query array, Open3D in as many as there are cores: hence processor seconds too.

Agreement: largest difference of the distances, micrometres, to trimesh's in millimetres; ours differs by what the spline
differs from flat facets. In metres trimesh takes facets for equally near whose squared distances differ by less than 1e-8, and
of those the one that faces the point: up to 0.1 mm too far.

Preparing (tree, scene; ours: the spline of both flanks) is timed apart from asking; medians of `runs`.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import trimesh
from peers import NotInstalled, arguments, head, measured, named, row

from ocp.data import BLADE
from robots.pose import Array
from trajectories.blade import Blade, find_shape, read_blade
from trajectories.path_points import foot_parameters

OFF = 1e-4  # m
Ask = Callable[[Array], Array]  # points (n, 3) m to distances (n,) m


def ours(blade: Blade) -> Ask:
    """Foot points on the spline of the convex flank."""
    shape = find_shape(blade)
    side = shape.sides["convex"]
    return lambda p: np.linalg.norm(side.surface(*foot_parameters(side, shape, p)) - p, axis=1)


def rtree(blade: Blade, unit: float = 1e-3) -> Ask:
    """trimesh.proximity on lengths in `unit` m, its rtree built beforehand."""
    mesh = trimesh.Trimesh(blade.vertices / unit, blade.faces, process=False)
    _ = mesh.triangles_tree
    return lambda p: unit * trimesh.proximity.closest_point(mesh, p / unit)[1]


def open3d(blade: Blade) -> Ask:
    """Single precision, in millimetres."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(1e3 * blade.vertices.astype(np.float32), blade.faces.astype(np.uint32))
    return lambda p: 1e-3 * scene.compute_distance(1e3 * p.astype(np.float32)).numpy()


def libigl(blade: Blade) -> Ask:
    """Its axis-aligned bounding box tree."""
    import igl

    tree = igl.AABB()
    tree.init(blade.vertices, blade.faces)
    return lambda p: np.sqrt(tree.squared_distance(blade.vertices, blade.faces, p)[0])


WAYS = {
    "ours, spline": (ours, ()),
    "trimesh's rtree, in mm": (rtree, ("trimesh", "rtree")),
    "trimesh's rtree, in m": (partial(rtree, unit=1.0), ("trimesh", "rtree")),
    "Open3D's RaycastingScene": (open3d, ("open3d-cpu",)),
    "libigl's AABB": (libigl, ("libigl",)),
}


def main() -> None:
    options = arguments(__doc__, points=2000, runs=3)
    blade = read_blade(BLADE)
    shape = find_shape(blade)
    side, rng = shape.sides["convex"], np.random.default_rng(0)
    u, v = rng.uniform(0.05, 0.95, options.points), rng.uniform(*(shape.v @ [[0.95, 0.05], [0.05, 0.95]]), options.points)
    points = side.surface(u, v) + rng.normal(0.0, OFF, options.points)[:, None] * side.normal(u, v)
    print(f"{options.points} points at the convex flank of {BLADE.name}, {len(blade.faces)} facets; medians of {options.runs}")
    head(("way", "version", "preparing, wall s", "processor s", "asking, wall s", "processor s", "wall us a point", "differs um"))
    reference = rtree(blade)(points)
    for label, (prepare, packages) in WAYS.items():
        try:
            told = ", ".join(map(named, packages))
        except NotInstalled as reason:
            row(label, reason)
            continue
        ask, *prepared = measured(lambda prepare=prepare: prepare(blade), options.runs)
        distance, wall, processor = measured(lambda ask=ask: ask(points), options.runs)
        off = 1e6 * float(np.abs(distance - reference).max())
        row(label, told, *prepared, wall, processor, 1e6 * wall / options.points, off)


if __name__ == "__main__":
    main()
