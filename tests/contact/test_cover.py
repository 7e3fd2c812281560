"""The cover's compliance against closed forms, an independent finite element code, and its own symmetries."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.contact.wheel.cover import WheelGeometry, build_cover, default_cell, ring_element_stiffness, ring_section, width_cells
from robots.errors import BadInput

WHEEL = WheelGeometry(radius=0.150, width=0.040, cover_thickness=0.015, modulus=12e6, poisson=0.47)


@pytest.fixture(scope="module")
def cover():
    return build_cover(WHEEL, 1.5e-3)


@pytest.mark.parametrize(
    ("n", "motion"),
    [
        (0, lambda r, z: (0 * r, 0 * r, 1 + 0 * r)),  # along the axis
        (0, lambda r, z: (0 * r, r, 0 * r)),  # turning about the axis
        (1, lambda r, z: (1 + 0 * r, -1 + 0 * r, 0 * r)),  # across the axis
        (1, lambda r, z: (-z, z, r)),  # turning about a diameter
    ],
)
def test_rigid_motions_cost_no_energy(n, motion):
    r0, r1, width = 0.03, 0.05, 0.01
    K = ring_element_stiffness(r0, r1, width, 1.0, 5.0)
    r, z = np.meshgrid(np.linspace(r0, r1, 3), np.linspace(-width / 2, width / 2, 3), indexing="ij")
    u = np.column_stack([np.ravel(c) for c in motion(r, z)]).ravel()
    stiffness = K[0] + n * K[1] + n * n * K[2]
    assert np.abs(stiffness @ u).max() < 1e-12 * np.abs(stiffness).max() * np.abs(u).max()


def test_pressurised_tube():
    """Lame: a ring element under uniform radial stretch u = a r + b / r has strain energy integral of the closed form."""
    r0, r1, width, mu, lam = 0.10, 0.101, 0.01, 1.0, 2.0
    K = ring_element_stiffness(r0, r1, width, mu, lam)[0]
    r = np.repeat(np.linspace(r0, r1, 3), 3)
    u = np.zeros((9, 3))
    a, b = 1.0, 0.004
    u[:, 0] = a * r + b / r
    # Strains a - b/r^2, a + b/r^2, 0 integrated over r dr dz.
    energy = width * ((4 * mu + 4 * lam) * a**2 * (r1**2 - r0**2) / 2 + 4 * mu * b**2 * (r0**-2 - r1**-2) / 2)
    assert u.ravel() @ K @ u.ravel() == pytest.approx(energy, rel=1e-6)


def bonded_layer(kh, poisson):
    """Surface displacement over h under a unit pressure wave on a bonded layer, plane strain, unit modulus (Airy stress)."""
    q = 3 - 4 * poisson
    top = q * np.sinh(2 * kh) - 2 * kh
    bottom = q * np.cosh(2 * kh) + 2 * kh**2 + 5 - 12 * poisson + 8 * poisson**2
    return 2 * (1 - poisson**2) / kh * top / bottom


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.47, 0.499])
@pytest.mark.parametrize("kh", [0.5, 1.0, 2.0, 4.0])
def test_wide_flat_ring_is_a_bonded_layer(kh, poisson):
    h = 0.015
    section = ring_section(20.0, h, np.linspace(-0.15, 0.15, 41), poisson, 3e-3)
    middle = section.compliance(kh / h * 20.0).sum(axis=1)[20]
    assert middle / h == pytest.approx(bonded_layer(kh, poisson), rel=3e-3)


def test_short_waves_see_a_half_space():
    section = ring_section(WHEEL.radius, WHEEL.cover_thickness, width_cells(0.04, 0.7e-3), 0.47, 0.7e-3)
    n = 300.0
    middle = section.compliance(n).sum(axis=1)[29]
    assert middle == pytest.approx(2 * (1 - 0.47**2) / (n / WHEEL.radius), rel=1e-2)


def test_near_incompressible_cover_does_not_lock():
    """Ten elements across the width give what forty do: locking would make the coarse ring far too stiff."""
    coarse, fine = (
        ring_section(0.15, 0.015, np.linspace(-0.02, 0.02, m + 1), 0.499, 0.04 / m).compliance(30.0).sum(axis=1).mean()
        for m in (10, 40)
    )
    assert coarse == pytest.approx(fine, rel=5e-3)


def test_compliance_is_reciprocal_and_positive(cover):
    assert np.allclose(cover.spectrum, cover.spectrum.transpose(0, 2, 1), rtol=0, atol=1e-12 * cover.spectrum.max())
    assert np.linalg.eigvalsh(cover.spectrum).min() > 0


def test_the_two_sides_of_the_wheel_are_alike(cover):
    assert np.allclose(cover.spectrum, cover.spectrum[:, ::-1, ::-1], rtol=0, atol=1e-9 * cover.spectrum.max())


def test_displacement_agrees_with_the_kernel(cover):
    rng = np.random.default_rng(3)
    force = rng.random((len(cover.y), len(cover.x)))
    i, m = 4, 7
    lags = np.abs(m - np.arange(len(cover.x)))
    direct = sum(cover.kernel[i, j, lags] @ force[j] for j in range(len(cover.y)))
    assert cover.displace(force)[i, m] == pytest.approx(direct, rel=1e-10)


def test_neighbouring_periods_do_not_matter(cover):
    """The deformation of the periodic sector against the whole circumference."""
    whole = build_cover(WHEEL, 1.5e-3, period=1e3 * 0.06)
    assert len(whole.x) > 5 * len(cover.x)
    near = [_under_gaussian(c) for c in (cover, whole)]
    assert near[0] == pytest.approx(near[1], rel=2e-3)


def _under_gaussian(cover):
    pressure = np.exp(-(cover.x[None] ** 2 + cover.y[:, None] ** 2) / 4e-3**2)
    moved = cover.displace(pressure * cover.area)
    return (pressure * cover.area * moved).sum() / (pressure * cover.area).sum() ** 2


def test_an_independent_three_dimensional_code_agrees():
    """NGSolve, cubic tetrahedra on the real ring sector, Hertz pressure of radius 6 mm centred 5 mm from the side face."""
    radius, centre = 6.0, 15.0
    ngs = _ngsolve_mean_displacement(radius, centre)
    ours = []
    for cell in (1.4e-3, 0.7e-3):
        cover = build_cover(replace(WHEEL, modulus=1e6), cell)
        fine = (np.arange(6) - 2.5) / 6
        x = 1e3 * (cover.x[None, :, None, None] + cover.dx * fine[None, None, :, None])
        y = 1e3 * (cover.y[:, None, None, None] + cover.dy[:, None, None, None] * fine[None, None, None, :])
        pressure = np.sqrt(np.maximum(1 - (x**2 + (y - centre) ** 2) / radius**2, 0)).mean(axis=(2, 3))
        force = 1e6 * pressure * cover.area
        ours.append(1e3 * (force * cover.displace(force)).sum() / force.sum())
    extrapolated = ours[1] + (ours[1] - ours[0]) / 3
    assert ours[1] == pytest.approx(ngs, rel=0.02)
    assert extrapolated == pytest.approx(ngs, rel=0.01)


def _ngsolve_mean_displacement(radius, centre):
    """Mean radial displacement (mm, weighted by the pressure) for unit modulus; lengths in mm."""
    ngsolve = pytest.importorskip("ngsolve")
    occ = pytest.importorskip("netgen.occ")
    ring = occ.Cylinder(occ.Pnt(0, 0, -20), occ.Z, 150, 40) - occ.Cylinder(occ.Pnt(0, 0, -20), occ.Z, 135, 40)
    sector = ring * occ.Box(occ.Pnt(100, -45, -20), occ.Pnt(160, 45, 20))
    for face in sector.faces:
        c = face.center
        flat = abs(abs(c.z) - 20) < 1e-6 or abs(abs(c.y) - 45) < 1e-6
        face.name = "side" if flat else ("top" if np.hypot(c.x, c.y) > 143 else "core")
    import netgen.meshing

    sizes = netgen.meshing.MeshingParameters(maxh=8.0)
    for y in np.linspace(-7, 7, 7):
        for z in np.linspace(centre - 7, 20, 7):
            sizes.RestrictH(x=np.sqrt(150**2 - y**2), y=y, z=z, h=2.5)
    mesh = ngsolve.Mesh(occ.OCCGeometry(sector).GenerateMesh(sizes))
    mesh.Curve(3)
    nu = WHEEL.poisson
    mu, lam = 0.5 / (1 + nu), nu / ((1 + nu) * (1 - 2 * nu))
    space = ngsolve.VectorH1(mesh, order=3, dirichlet="core")
    u, v = space.TnT()
    eps_u, eps_v = ngsolve.Sym(ngsolve.Grad(u)), ngsolve.Sym(ngsolve.Grad(v))
    a = ngsolve.BilinearForm(space, symmetric=True)
    a += (2 * mu * ngsolve.InnerProduct(eps_u, eps_v) + lam * ngsolve.div(u) * ngsolve.div(v)) * ngsolve.dx
    normal = ngsolve.specialcf.normal(3)
    rest = 1 - ((150 * ngsolve.atan2(ngsolve.y, ngsolve.x)) ** 2 + (ngsolve.z - centre) ** 2) / radius**2
    pressure = ngsolve.IfPos(rest, ngsolve.sqrt(ngsolve.IfPos(rest, rest, 0)), 0)
    load = ngsolve.LinearForm(space)
    load += -pressure * ngsolve.InnerProduct(v, normal) * ngsolve.ds("top")
    a.Assemble()
    load.Assemble()
    moved = ngsolve.GridFunction(space)
    moved.vec.data = a.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky") * load.vec
    work = ngsolve.Integrate(-pressure * ngsolve.InnerProduct(moved, normal) * ngsolve.ds("top"), mesh)
    return work / ngsolve.Integrate(pressure * ngsolve.ds("top"), mesh)


def test_compliance_goes_as_one_over_the_modulus(cover):
    assert np.allclose(cover.softer(6e6).spectrum, 2 * cover.spectrum)
    assert cover.softer(6e6).geometry.modulus == 6e6


def test_what_is_kept_spares_the_finite_elements(cover, monkeypatch, tmp_path):
    monkeypatch.setenv("GRINDPLAN_CACHE", str(tmp_path))
    first = build_cover(WHEEL, 2e-3)
    monkeypatch.setattr("ocp.contact.wheel.cover.ring_section", None)
    again = build_cover(replace(WHEEL, modulus=24e6), 2e-3)
    assert np.allclose(2 * again.spectrum, first.spectrum)


@pytest.mark.parametrize(
    ("field", "value"), [("cover_thickness", 0.15), ("cover_thickness", 0.0), ("poisson", 0.5), ("width", 0.0), ("modulus", -1.0)]
)
def test_impossible_wheels_are_refused(field, value):
    with pytest.raises(BadInput):
        replace(WHEEL, **{field: value})


def test_default_cell_is_bounded():
    assert default_cell(WHEEL, 1e-6) == pytest.approx(WHEEL.width / 64)
    assert default_cell(WHEEL, 1e4) == pytest.approx(WHEEL.cover_thickness / 4)
