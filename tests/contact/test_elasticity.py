"""Finite elements against textbook results, properties, and CalculiX as an independent code."""

import shutil
import subprocess
from math import factorial

import numpy as np
import pytest
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import spsolve

from ocp.contact.blade import elasticity
from ocp.contact.blade.elasticity import Material, element_stiffness, quadratic_mesh, shape_gradients
from ocp.contact.blade.nested_dissection import factorise
from tests.support.solid_solution import displacements

STEEL = Material(210e9, 0.3)


def box(counts, lengths, skew=0.0):
    """A block of six tetrahedra a cell; `skew` moves inner vertices by that share of a cell."""
    axes = [np.linspace(0.0, length, count + 1) for count, length in zip(counts, lengths, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(points)).reshape([count + 1 for count in counts])
    low = [number[i : i + counts[0], j : j + counts[1], k : k + counts[2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    corner = np.stack([block.ravel() for block in low], 1)
    cells = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]]
    if skew:
        inner = np.all((points > 1e-12) & (points < np.array(lengths) - 1e-12), axis=1)
        shift = np.random.default_rng(1).uniform(-skew, skew, points.shape) * np.array(lengths) / counts
        points = points + inner[:, None] * shift
    return quadratic_mesh(points, corner[:, cells].reshape(-1, 4))


def global_stiffness(mesh, material):
    """Assembled the plain way, independent of the dissection."""
    unknown = (3 * mesh.elements[:, :, None] + np.arange(3)).reshape(-1, 30)
    blocks = element_stiffness(mesh.nodes[mesh.elements], material)
    rows, columns = np.repeat(unknown, 30, axis=1).ravel(), np.tile(unknown, (1, 30)).ravel()
    return coo_matrix((blocks.ravel(), (rows, columns)), shape=(mesh.nodes.size,) * 2).tocsr()


def body_load(mesh, density):
    """Consistent nodal forces (3 nn,) of a body force given at points (n, 3), degree-four quadrature by subdivision."""
    sub = np.array([(i, j, k) for i in range(6) for j in range(6 - i) for k in range(6 - i - j)])
    first = (sub + 0.25) / 6.25  # a lattice inside; the weights follow from being exact for degree four
    points = np.column_stack([1 - first.sum(1), first])
    powers = [(a, b, c) for a in range(5) for b in range(5 - a) for c in range(5 - a - b)]
    exact = [6 * factorial(a) * factorial(b) * factorial(c) / factorial(a + b + c + 3) for a, b, c in powers]
    system = np.array([points[:, 1] ** a * points[:, 2] ** b * points[:, 3] ** c for a, b, c in powers])
    weight = np.linalg.lstsq(system, np.array(exact), rcond=None)[0]
    shape = np.column_stack([points * (2 * points - 1)] + [4 * points[:, i] * points[:, j] for i, j in elasticity.EDGES])
    volume = elasticity.tetra_volumes(mesh.nodes, mesh.elements)
    at = np.einsum("qc,ecd->eqd", points, mesh.nodes[mesh.elements[:, :4]])
    force = np.einsum("q,qa,eqd,e->ead", weight, shape, density(at.reshape(-1, 3)).reshape(at.shape), volume)
    load = np.zeros(mesh.nodes.shape)
    np.add.at(load, mesh.elements, force)
    return load.ravel(), (points, weight, shape, volume, at)


def test_shape_gradients_are_those_of_the_shape_functions():
    rng = np.random.default_rng(0)
    L = rng.uniform(0.1, 0.9, (5, 4))

    def shape(L):
        return np.concatenate([L * (2 * L - 1), np.stack([4 * L[:, i] * L[:, j] for i, j in elasticity.EDGES], 1)], 1)

    for c in range(4):
        step = 1e-6 * np.eye(4)[c]
        np.testing.assert_allclose((shape(L + step) - shape(L - step)) / 2e-6, shape_gradients(L)[:, :, c], atol=1e-8)


def test_rigid_motions_cost_nothing_and_nothing_else_does():
    mesh = box((1, 1, 1), (0.01, 0.02, 0.03))
    stiffness = global_stiffness(mesh, STEEL).toarray()
    np.testing.assert_allclose(stiffness, stiffness.T, rtol=0, atol=1e-9 * abs(stiffness).max())
    x = mesh.nodes
    turns = [np.cross(axis, x) for axis in np.eye(3)]
    rigid = np.stack([np.tile(axis, (len(x), 1)).ravel() for axis in np.eye(3)] + [turn.ravel() for turn in turns], 1)
    assert np.abs(stiffness @ rigid).max() < 1e-10 * abs(stiffness).max() * abs(rigid).max()
    assert np.count_nonzero(np.linalg.eigvalsh(stiffness) < 1e-9 * np.linalg.eigvalsh(stiffness)[-1]) == 6


def test_patch_test_constant_strain_is_exact():
    mesh = box((2, 3, 2), (1.0, 1.2, 0.9), skew=0.2)
    gradient = np.array([[1.0, 0.3, -0.2], [0.5, -0.7, 0.4], [0.1, 0.2, 0.6]])
    exact = (mesh.nodes @ gradient.T).ravel()
    outside = np.zeros(len(mesh.nodes), bool)
    outside[mesh.surface] = True
    stiffness, fixed = global_stiffness(mesh, STEEL), np.repeat(outside, 3)
    load = -stiffness[:, fixed] @ exact[fixed]
    inner = displacements(factorise(mesh, STEEL, outside), csr_matrix(load[:, None]))[:, 0]
    np.testing.assert_allclose(inner[~fixed], exact[~fixed], atol=1e-12)


def test_dissection_equals_a_general_sparse_solver():
    mesh = box((6, 4, 3), (0.06, 0.04, 0.03), skew=0.2)
    held = mesh.nodes[:, 0] < 1e-9
    free = np.repeat(~held, 3)
    rng = np.random.default_rng(2)
    loads = rng.normal(size=(mesh.nodes.size, 6)) * (rng.random((mesh.nodes.size, 1)) < 0.02)
    stiffness = global_stiffness(mesh, STEEL)[free][:, free]
    factor = factorise(mesh, STEEL, held)
    assert factor.unknowns == free.sum() and len(factor.fronts) > 8
    expected = spsolve(stiffness.tocsc(), loads[free])
    solved = displacements(factor, csr_matrix(loads))
    np.testing.assert_allclose(solved[free], expected, rtol=1e-8, atol=1e-12 * abs(expected).max())
    assert not solved[~free].any()
    blocks = factor.compliance(csr_matrix(loads))
    for k in range(2):
        pick = slice(3 * k, 3 * k + 3)
        np.testing.assert_allclose(blocks[k], loads[free][:, pick].T @ expected[:, pick], rtol=1e-8, atol=1e-20)


def test_free_solid_is_refused():
    mesh = box((3, 2, 2), (0.03, 0.02, 0.02))
    held = np.zeros(len(mesh.nodes), bool)
    held[0] = True  # three rotations are left
    with pytest.raises(np.linalg.LinAlgError):
        factorise(mesh, STEEL, held)


def test_cantilever_is_timoshenkos():
    length, width, height, force = 0.2, 0.01, 0.02, 100.0
    soft = Material(100e9, 0.0)  # without lateral strain the clamped end is free of the disturbance beam theory ignores
    mesh = box((20, 1, 3), (length, width, height))
    held = mesh.nodes[:, 0] < 1e-9
    tip = mesh.surface[np.all(mesh.nodes[mesh.surface[:, :3], 0] > length - 1e-9, axis=1)]
    corner = mesh.nodes[tip[:, :3]]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    load = np.zeros(len(mesh.nodes))
    np.add.at(load, tip[:, 3:], np.repeat(area[:, None] / 3.0, 3, axis=1))  # constant traction: middles only
    load *= force / load.sum()
    forces = np.zeros((len(mesh.nodes), 3))
    forces[:, 2] = load
    u = displacements(factorise(mesh, soft, held), csr_matrix(forces.reshape(-1, 1))).reshape(-1, 3)
    inertia, section = width * height**3 / 12.0, width * height
    expected = force * length**3 / (3 * 100e9 * inertia) + force * length / (5.0 / 6.0 * section * 50e9)
    assert load @ u[:, 2] / force == pytest.approx(expected, rel=2e-3)


def manufactured_error(cells):
    """L2 error of the solution for u = sin(pi x) sin(pi y) sin(pi z) (1, 2, -1) on the unit cube, held all round."""
    lame, shear = STEEL.lame
    direction = np.array([1.0, 2.0, -1.0])

    def exact(x):
        return np.prod(np.sin(np.pi * x), axis=1)[:, None] * direction

    def force(x):
        s, c = np.sin(np.pi * x), np.cos(np.pi * x)
        hessian = np.empty((len(x), 3, 3))
        for i in range(3):
            for j in range(3):
                k = 3 - i - j
                hessian[:, i, j] = -np.prod(s, axis=1) if i == j else c[:, i] * c[:, j] * s[:, k]
        hessian *= np.pi**2
        trace = np.trace(hessian, axis1=1, axis2=2)
        return -((lame + shear) * hessian @ direction + shear * trace[:, None] * direction)

    mesh = box((cells,) * 3, (1.0,) * 3)
    load, (_, weight, shape, volume, at) = body_load(mesh, force)
    held = np.zeros(len(mesh.nodes), bool)
    held[mesh.surface] = True
    u = displacements(factorise(mesh, STEEL, held), csr_matrix(load[:, None])).reshape(-1, 3)
    difference = np.einsum("qa,ead->eqd", shape, u[mesh.elements]) - exact(at.reshape(-1, 3)).reshape(at.shape)
    return np.sqrt(np.einsum("q,eqd,e->", weight, difference**2, volume))


def test_manufactured_solution_converges_with_order_three():
    errors = np.array([manufactured_error(cells) for cells in (4, 6, 9)])
    order = np.log(errors[:-1] / errors[1:]) / np.log(1.5)
    assert order.min() > 2.7, (errors, order)


def write_ccx(path, mesh, material, held, load):
    """CalculiX input with C3D10 elements and nodal forces (nn, 3)."""

    def table(rows):
        return "\n".join(", ".join(str(x) for x in row) for row in rows)

    nodes = [(i + 1, *(f"{x:.11e}" for x in row)) for i, row in enumerate(mesh.nodes)]
    elements = [(i + 1, *(row + 1)) for i, row in enumerate(mesh.elements)]
    forces = [(i + 1, d + 1, f"{load[i, d]:.11e}") for i, d in zip(*np.nonzero(load), strict=True)]
    path.write_text(
        "\n".join(
            [
                "*NODE, NSET=all",
                table(nodes),
                "*ELEMENT, TYPE=C3D10, ELSET=solid",
                table(elements),
                "*NSET, NSET=held",
                table([(i + 1,) for i in np.flatnonzero(held)]),
                "*MATERIAL, NAME=m",
                "*ELASTIC",
                f"{material.youngs_modulus}, {material.poisson_ratio}",
                "*SOLID SECTION, ELSET=solid, MATERIAL=m",
                "*STEP",
                "*STATIC",
                "*BOUNDARY",
                "held, 1, 3",
                "*CLOAD",
                table(forces),
                "*NODE PRINT, NSET=all",
                "U",
                "*END STEP",
                "",
            ]
        )
    )


def run_ccx(folder, mesh, material, held, load):
    write_ccx(folder / "job.inp", mesh, material, held, load)
    subprocess.run(
        [shutil.which("ccx"), "job"],
        cwd=folder,
        check=True,
        capture_output=True,
        timeout=120,
        env={"OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"},
    )
    rows = [line.split() for line in (folder / "job.dat").read_text().splitlines()]
    u = np.zeros(mesh.nodes.shape)
    for row in rows:
        if len(row) == 4 and row[0].isdigit():
            u[int(row[0]) - 1] = [float(x) for x in row[1:]]
    return u


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
def test_calculix_gives_the_same_displacements(tmp_path):
    mesh = box((7, 4, 2), (0.07, 0.03, 0.006), skew=0.15)
    held = mesh.nodes[:, 0] < 1e-9
    load = np.zeros(mesh.nodes.shape)
    some = np.random.default_rng(4).choice(np.flatnonzero(~held), 15, replace=False)
    load[some] = np.random.default_rng(5).normal(size=(15, 3))
    titanium = Material()
    ours = displacements(factorise(mesh, titanium, held), csr_matrix(load.reshape(-1, 1))).reshape(-1, 3)
    theirs = run_ccx(tmp_path, mesh, titanium, held, load)
    assert np.abs(theirs).max() > 1e-9
    np.testing.assert_allclose(ours, theirs, atol=1e-5 * np.abs(theirs).max())
