"""Patches against Hertz, beams and CalculiX; interpolation along passes; what is refused."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.contact.blade import compliance as module
from ocp.contact.blade.compliance import (
    NEGLIGIBLE,
    TOLERANCE,
    ClampedBlade,
    HeldBlade,
    blade_compliance,
    clamped_blade,
    contact_components,
    interpolate_passes,
)
from ocp.contact.blade.elasticity import Material, patch_loads, patch_weights
from ocp.contact.blade.nested_dissection import factorise
from ocp.shell import cache
from robots.errors import BadInput
from tests.contact.test_elasticity import box, run_ccx
from tests.support.solid_solution import displacements

TITANIUM = Material()
UP, ALONG = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def clamped(mesh, held, material=TITANIUM):
    return ClampedBlade(mesh, factorise(mesh, material, held), 0.0)


def plate():
    """A vane 60 x 30 x 3 mm held at x = 0."""
    mesh = box((20, 10, 1), (0.06, 0.03, 0.003))
    return clamped(mesh, mesh.nodes[:, 0] < 1e-9)


def rows(*vectors):
    return np.array(vectors, float)


def test_weights_are_those_of_a_hertz_pressure():
    mesh = plate().mesh
    a, b = 4e-3, 2.5e-3
    p = rows([0.031, 0.0147, 0.003])
    turned = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    w = patch_weights(mesh, p, rows(UP), rows(turned), (a, b))
    assert w.sum() == pytest.approx(1.0, rel=1e-12)
    local = (mesh.nodes - p[0]) @ np.stack([turned, np.cross(UP, turned), UP], 1)
    np.testing.assert_allclose(w @ local, 0.0, atol=3e-3 * a)
    # Quadratic fields are integrated exactly by the shape functions: second moments a^2/5, b^2/5 of the ellipsoid.
    np.testing.assert_allclose((w @ local**2)[0], [a**2 / 5, b**2 / 5, 0.0], rtol=5e-3, atol=1e-12)


def test_patch_over_an_edge_loads_only_the_blade():
    mesh = plate().mesh
    w = patch_weights(mesh, rows([0.03, 0.0, 0.003]), rows(UP), rows(ALONG), (3e-3, 6e-3))
    assert w.sum() == pytest.approx(1.0, rel=1e-12)
    used = mesh.nodes[w.indices]
    assert used[:, 2].min() == pytest.approx(0.003)  # neither the rim nor the far side
    # Half an ellipsoid: its centre of pressure is 3/8 of the semi-axis inside.
    assert (w @ mesh.nodes)[0, 1] == pytest.approx(3.0 / 8.0 * 6e-3, rel=5e-3)


def test_indentation_is_hertzs():
    # Pressure-weighted mean displacement of a half space under a Hertz disc: 0.6 (1 - nu^2) / (E a), from
    # u(r) = 3 (1 - nu^2) (2 a^2 - r^2) / (8 E a^3) (Johnson 1985, eq. 3.41a). What the finite block adds is the
    # same for two small discs and drops out of the difference.
    mesh = box((12, 12, 6), (0.07, 0.07, 0.035))
    block = clamped(mesh, mesh.nodes[:, 2] < 1e-9)
    at, n, t = rows([0.0351, 0.0352, 0.035]), rows(UP), rows(ALONG)
    small, large = 9e-3, 13.5e-3
    difference = block.compliance(at, n, t, (small, small))[0, 0] - block.compliance(at, n, t, (large, large))[0, 0]
    expected = 0.6 * (1 - TITANIUM.poisson_ratio**2) / TITANIUM.youngs_modulus * (1 / small - 1 / large)
    # Elements of 0.5 a are a little stiff: 6 % here; 4 % on 4.4 mm elements.
    assert 0.9 * expected < difference < 1.01 * expected


def test_spread_load_converges_and_a_point_load_does_not():
    def at(cells, axes):
        mesh = box((3 * cells, 3 * cells, cells), (0.03, 0.03, 0.01))
        block = clamped(mesh, mesh.nodes[:, 2] < 1e-9)
        return block.compliance(rows([0.0152, 0.0151, 0.01]), rows(UP), rows(ALONG), axes)[0, 0]

    spread = [at(cells, (3e-3, 6e-3)) for cells in (2, 4)]
    point = [at(cells, (0.1e-3, 0.1e-3)) for cells in (2, 4)]
    assert 1.0 < spread[1] / spread[0] < 1.12
    assert point[1] > 1.4 * point[0]


def test_vane_bends_like_a_beam_and_signs_are_as_documented():
    blade = plate()
    p, n, t = rows([0.05, 0.015, 0.003]), rows(UP), rows(ALONG)
    c = blade.compliance(p, n, t, (2e-3, 2e-3))[0]
    inertia = 0.03 * 0.003**3 / 12
    assert c[0] == pytest.approx(0.05**3 / (3 * TITANIUM.youngs_modulus * inertia), rel=0.06)
    # Pressed down (along -z), the upper face of the vane turns downward: its points move along +x by half the
    # thickness times the slope.
    slope = 0.05**2 / (2 * TITANIUM.youngs_modulus * inertia)
    assert c[1] == pytest.approx(0.0015 * slope, rel=0.06)
    assert abs(c[2]) < 0.01 * c[0]
    turned = blade.compliance(p, n, -t, (2e-3, 2e-3))[0]
    np.testing.assert_allclose(turned, c * [1, -1, -1], rtol=1e-9, atol=1e-14)
    offside = blade.compliance(rows([0.05, 0.026, 0.003]), n, t, (2e-3, 2e-3))[0]
    assert offside[0] > c[0] and offside[2] == pytest.approx(0.0, abs=0.05 * c[0])


def test_compliance_is_the_mean_displacement_and_reciprocal():
    blade = plate()
    p, n, t = rows([0.05, 0.022, 0.003], [0.02, 0.008, 0.003]), rows(UP, UP), rows(ALONG, ALONG)
    axes = (3e-3, 5e-3)
    weights = patch_weights(blade.mesh, p, n, t, axes)
    u = displacements(blade.factorisation, patch_loads(weights))
    tensor = blade.tensor(p, n, t, axes)
    for k in range(2):
        mean = weights[k] @ u[:, 3 * k : 3 * k + 3].reshape(-1, 9)
        np.testing.assert_allclose(mean.reshape(3, 3), tensor[k], rtol=1e-8, atol=1e-18)
    np.testing.assert_allclose(tensor, tensor.transpose(0, 2, 1), rtol=1e-12)
    assert np.linalg.eigvalsh(tensor).min() > 0.0
    # A friction force along +t moves the patch along -n by c_nt: the other column of the tensor.
    c = contact_components(tensor, n, t)
    np.testing.assert_allclose(-np.einsum("ki,kij,kj->k", n, tensor, t), c[:, 1], rtol=1e-9)
    # Force at one patch, displacement at the other, and the other way round.
    across = weights[0] @ u[2::3, 5] - weights[1] @ u[2::3, 2]
    assert abs(across[0]) < 1e-10 * u[2::3, 2].max()


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
def test_calculix_agrees_on_a_meshed_vane(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "cache"))
    vertices, faces = wedge()
    blade = clamped_blade(HeldBlade(vertices, faces, UP, 0.01, TITANIUM), 6e-3)
    p, n, t = contact_on_wedge()
    weights = patch_weights(blade.mesh, p, n, t, (3e-3, 6e-3))
    held = ~blade.factorisation.free
    theirs = np.stack(
        [(weights @ run_ccx(tmp_path, blade.mesh, TITANIUM, held, weights[[0]].toarray().T * axis))[0] for axis in -n]
    )
    c = blade.compliance(p, n, t, (3e-3, 6e-3))[0]
    np.testing.assert_allclose(
        [-theirs[0] @ n[0], theirs[0] @ t[0], theirs[0] @ np.cross(n[0], t[0])], c, rtol=1e-3, atol=1e-3 * c[0]
    )


def wedge():
    from tests.contact.test_volume_mesh import wedge as prism

    return prism()


def contact_on_wedge():
    n = np.array([1.9, 40.0, 0.0])
    n /= np.linalg.norm(n)
    return rows([0.02, 1.05e-3, 0.045]), rows(n), rows([0.0, 0.0, 1.0])


def test_passes_are_interpolated_and_kept(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    vertices, faces = wedge()
    x = np.linspace(0.002, 0.038, 120)
    z = 0.055
    slope = np.array([40.0, -1.9, 0.0]) / np.hypot(40.0, 1.9)
    n = np.array([1.9, 40.0, 0.0]) / np.hypot(40.0, 1.9)
    p = np.column_stack([x, 2e-3 - 1.9 / 40.0 * x, np.full(120, z)])
    path = SimpleNamespace(p=p, n=np.tile(n, (120, 1)), t=np.tile(slope, (120, 1)), s=(x - x[0]) * np.hypot(40, 1.9) / 40)
    arguments = (HeldBlade(vertices, faces, UP, 0.01, TITANIUM), [path], (3e-3, 6e-3), 6e-3)
    result = blade_compliance(*arguments)
    blade = clamped_blade(HeldBlade(vertices, faces, UP, 0.01, TITANIUM), 6e-3)
    direct = blade.compliance(path.p, path.n, path.t, (3e-3, 6e-3))
    off = np.abs(result.per_pass[0] - direct).max(axis=1) / (direct[:, 0] + NEGLIGIBLE)
    # The figure reported is that of the interval before its middle was put in, so it is on the safe side.
    assert off.max() < 2 * TOLERANCE and off.max() < result.interpolation_error[0] < 0.03
    assert result.control_points < 60 and result.unknowns == blade.factorisation.unknowns
    monkeypatch.setattr(module, "factorise", None)
    np.testing.assert_array_equal(blade_compliance(*arguments).per_pass[0], result.per_pass[0])


def test_the_same_solid_is_factorised_once(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    vertices, faces = wedge()
    stiffer = Material(2 * TITANIUM.youngs_modulus, TITANIUM.poisson_ratio, TITANIUM.density)
    held, moved = HeldBlade(vertices, faces, UP, 0.01, TITANIUM), HeldBlade(vertices, faces, UP, 0.015, TITANIUM)
    first = clamped_blade(held, 9e-3)
    with monkeypatch.context() as patch:
        patch.setattr(module, "factorise", None)
        assert clamped_blade(HeldBlade(vertices.copy(), faces, UP, 0.01, TITANIUM), 9e-3) is first
    others = [(moved, 9e-3), (HeldBlade(vertices, faces, UP, 0.01, stiffer), 9e-3), (held, 8e-3)]
    assert all(clamped_blade(*other) is not first for other in others) and len(module._latest) == 1


def test_interpolation_meets_its_tolerance_with_few_solves():
    s = [np.linspace(0.0, 0.08, 400), np.linspace(0.0, 0.05, 300), np.array([0.0]), np.array([0.0, 1e-3])]
    x = np.concatenate(s)
    every = np.stack([1e-6 * (1.1 + np.sin(60 * x)) * np.exp(40 * x), 1e-7 * np.cos(80 * x), 0 * x], 1)
    asked = []

    def solve(index):
        asked.append(index)
        return every[index]

    values, error, count = interpolate_passes(solve, s)
    asked = np.concatenate(asked)
    assert len(asked) == len(set(asked)) == count < 120
    got = np.concatenate(values)
    assert (np.abs(got - every).max(axis=1) / (every[:, 0] + NEGLIGIBLE)).max() < 1.5 * TOLERANCE
    assert error.shape == (4,) and error.max() < 3 * TOLERANCE and got[:, 0].min() > 0.0


def test_useless_clamps_and_contacts_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    vertices, faces = wedge()
    with pytest.raises(BadInput, match="holds nothing"):
        clamped_blade(HeldBlade(vertices, faces, UP, -0.01, TITANIUM), 8e-3)
    with pytest.raises(BadInput, match="holds all"):
        clamped_blade(HeldBlade(vertices, faces, UP, 0.1, TITANIUM), 8e-3)
    blade = clamped_blade(HeldBlade(vertices, faces, -UP, -0.05, TITANIUM), 8e-3)  # held above 50 mm
    p, n, t = contact_on_wedge()
    low = blade.compliance(p - rows([0, 0, 0.04]), n, t, (3e-3, 6e-3))[0, 0]
    assert low > blade.compliance(p, n, t, (3e-3, 6e-3))[0, 0] > 0.0
    inside = blade.compliance(p + rows([0, 0, 0.012]), n, t, (2e-3, 2e-3))[0]
    np.testing.assert_array_equal(inside, 0.0)
    with pytest.raises(BadInput, match="finds no blade surface"):
        blade.compliance(p + rows([0, 0.05, 0]), n, t, (3e-3, 6e-3))


def test_loose_part_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    vertices, faces = wedge()
    both = np.vstack([vertices, vertices + rows([0.0, 0.02, 0.02])])  # the second one starts above the clamp
    with pytest.raises(BadInput, match="loose parts"):
        clamped_blade(HeldBlade(both, np.vstack([faces, faces + len(vertices)]), UP, 0.01, TITANIUM), 8e-3)
