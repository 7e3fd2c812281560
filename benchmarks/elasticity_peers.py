"""How far a held blade gives under many loads: ours against CalculiX on the same mesh with the same nodal forces.

`python benchmarks/elasticity_peers.py [--size 10000] [--loads 20] [--theirs 3] [--runs 1]`; full table: `--size 4000 --loads 200
--runs 3`. `size` is the element's, micrometres. CalculiX is Debian's package calculix-ccx (`apt-get install`).

The bundled blade in its clamp, ten-node tetrahedra, a unit force spread over a contact patch at each of `loads` places of its
passes. Ours factorises once and then substitutes forward along the parts above the patch. CalculiX gets every load as a step of
one job, in one thread, its default solver (SPOOLES), prints the displacements of the loaded nodes, and factorises in every step;
so it solves only the first `theirs` loads, and its time for all is its first load's and `loads` - 1 further ones'.

Agreement: largest relative difference of the compliance f.u over the loads that both solved. The mesh is not timed; medians
of `runs`, processor seconds with those of the child process.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from peers import arguments, head, measured, row
from scipy.sparse import csr_matrix

from ocp.contact.blade.elasticity import Material, QuadraticMesh, patch_weights, quadratic_mesh
from ocp.contact.blade.nested_dissection import Factorisation, factorise
from ocp.contact.blade.volume_mesh import clamp_cut, volume_mesh
from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.plan.paths import PlanOptions, lay_paths
from robots.pose import Array

PATCH = 3e-3, 6e-3  # m


def problem(size: float, count: int) -> tuple[QuadraticMesh, Material, Array, csr_matrix]:
    """Mesh with elements of `size` m, material, held nodes, nodal forces (3 nn, count) N."""
    cell = read_cell(CELL)
    piece = cell.workpiece
    laid = lay_paths(cell, piece.stl, PlanOptions(step=1e-3, even=False))
    normal, offset = np.asarray(piece.clamp_normal, float), float(piece.clamp_offset)
    solid = volume_mesh(laid.blade.vertices, laid.blade.faces, size, (normal, offset))
    corners = solid.mesh.elements[:, :4]
    mesh = quadratic_mesh(*clamp_cut(solid.mesh.nodes[: corners.max() + 1], corners, normal, offset))
    p, n, t = (np.concatenate([getattr(path, name) for path in laid.paths]) for name in ("p", "n", "t"))
    chosen = np.linspace(0, len(p) - 1, count).round().astype(int)
    weights = patch_weights(mesh, p[chosen], n[chosen], t[chosen], PATCH).tocoo()
    rows = (3 * weights.col[:, None] + np.arange(3)).ravel()
    forces = -(weights.data[:, None] * n[chosen][weights.row]).ravel()
    loads = csr_matrix((forces, (rows, np.repeat(weights.row, 3))), shape=(3 * len(mesh.nodes), count))
    return mesh, Material(piece.youngs_modulus, piece.poisson, piece.density), mesh.nodes @ normal - offset < 1e-9, loads


def lines(rows: list[tuple[object, ...]]) -> list[str]:
    return [", ".join(map(str, row)) for row in rows]


def calculix(mesh: QuadraticMesh, material: Material, held: Array, loads: csr_matrix) -> Array:
    """Compliance (count,) m/N by one job of as many steps as `loads` has columns."""
    columns = loads.tocsc()
    text = ["*NODE, NSET=all", *lines([(i + 1, *(f"{x:.11e}" for x in at)) for i, at in enumerate(mesh.nodes)])]
    text += ["*ELEMENT, TYPE=C3D10, ELSET=solid", *lines([(i + 1, *(e + 1)) for i, e in enumerate(mesh.elements)])]
    text += ["*NSET, NSET=held", *lines([(i + 1,) for i in np.flatnonzero(held)]), "*MATERIAL, NAME=m", "*ELASTIC"]
    text += [f"{material.youngs_modulus}, {material.poisson_ratio}", "*SOLID SECTION, ELSET=solid, MATERIAL=m"]
    touched = [np.unique(columns[:, k].indices // 3) for k in range(columns.shape[1])]
    for k, nodes in enumerate(touched):
        text += [f"*NSET, NSET=patch{k}", *lines([(i + 1,) for i in nodes])]
    text += ["*BOUNDARY", "held, 1, 3"]
    for k in range(columns.shape[1]):
        one = columns[:, k]
        force = [(i // 3 + 1, i % 3 + 1, f"{f:.11e}") for i, f in zip(one.indices, one.data, strict=True)]
        text += ["*STEP", "*STATIC", "*CLOAD, OP=NEW", *lines(force), f"*NODE PRINT, NSET=patch{k}", "U", "*END STEP"]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "job.inp").write_text("\n".join([*text, ""]))
        environment = {"OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"}
        subprocess.run([str(shutil.which("ccx")), "job"], cwd=folder, check=True, capture_output=True, env=environment)
        printed = (Path(folder) / "job.dat").read_text().split("displacements")[1:]
    moved = np.zeros((loads.shape[0], len(printed)))
    for k, block in enumerate(printed):
        for words in map(str.split, block.splitlines()):
            if len(words) == 4 and words[0].isdigit():
                moved[3 * int(words[0]) - 3 + np.arange(3), k] = [float(word) for word in words[1:]]
    return np.asarray(columns.multiply(moved).sum(axis=0)).ravel()


def main() -> None:
    options = arguments(__doc__, size=10000, loads=20, theirs=3, runs=1)
    mesh, material, held, loads = problem(1e-6 * options.size, options.loads)

    def ours(columns: csr_matrix, factor: Factorisation | None = None) -> Array:
        return (factor or factorise(mesh, material, held)).compliance(columns, 1)[:, 0, 0]

    print(f"{len(mesh.elements)} elements, {3 * int((~held).sum())} unknowns, {options.loads} loads")
    head(("way", "version", "first load, wall s", "processor s", "a further load, wall ms", "processor ms", "all loads, wall s"))
    _, *first = measured(lambda: ours(loads[:, :1]), options.runs)
    factor = factorise(mesh, material, held)
    c, *rest = measured(lambda: ours(loads, factor), options.runs)
    row("ours", "", *first, *(1e3 * s / options.loads for s in rest), first[0] + rest[0])
    if shutil.which("ccx") is None:
        row("CalculiX", "ccx is not installed (Debian: calculix-ccx)")
        return
    version = subprocess.run(["ccx", "-v"], capture_output=True, text=True).stdout.split()[-1]
    _, *first = measured(lambda: calculix(mesh, material, held, loads[:, :1]), options.runs)
    theirs, *some = measured(lambda: calculix(mesh, material, held, loads[:, : options.theirs]), options.runs)
    each = [(s - f) / (options.theirs - 1) for s, f in zip(some, first, strict=True)]
    row("CalculiX", f"ccx {version}", *first, *(1e3 * s for s in each), first[0] + (options.loads - 1) * each[0])
    off = np.abs(theirs / c[: options.theirs] - 1).max()
    print(f"\nCompliance {1e9 * c.min():.3g} to {1e9 * c.max():.3g} nm/N; largest relative difference {off:.2g}")


if __name__ == "__main__":
    main()
