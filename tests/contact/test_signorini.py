"""The contact solver against Hertz, thin layers, a plane solver, NNLS, and the conditions a contact must meet."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, nnls
from scipy.special import ellipe, ellipk, iv

from ocp.contact.wheel import signorini
from ocp.contact.wheel.cover import WheelGeometry, build_cover, default_cell
from ocp.contact.wheel.signorini import LocalShape, solve_contact, solve_force, solve_forces
from robots.errors import Infeasible

WHEEL = WheelGeometry(radius=0.150, width=0.040, cover_thickness=0.015, modulus=12e6, poisson=0.47)
SHAPES = {
    "convex": LocalShape(6.67, 16.0),
    "flat": LocalShape(6.67, 0.0),
    "tilted": LocalShape(6.67, 0.0, tilt_y=0.01),
    "hollow": LocalShape(6.67, -4.0),
    "skew": LocalShape(8.0, 10.0, 5.0, lateral=0.004, tilt_x=0.02, tilt_y=-0.01),
    "edge": LocalShape(6.67, 16.0, lateral=0.018),
}


@pytest.fixture(scope="module")
def cover():
    return build_cover(WHEEL, default_cell(WHEEL, 20.0))


@pytest.fixture(scope="module")
def finer(cover):
    """Three covers of falling cell size; the middle one is the default."""
    return [build_cover(WHEEL, 1.5 * cover.dx), cover, build_cover(WHEEL, cover.dx / 1.5)]


@pytest.fixture(scope="module")
def small():
    return build_cover(WHEEL, 3e-3)


def hertz(force, kx, ky, modulus):
    """Approach and semi-axes (along x, along y) of Hertz's elliptic contact (Johnson 1985, eq. 4.26), kx != ky."""
    low, high = min(kx, ky), max(kx, ky)

    def ratio(m):
        return (ellipe(m) / (1 - m) - ellipk(m)) / (ellipk(m) - ellipe(m)) - high / low

    m = brentq(ratio, 1e-9, 1 - 1e-12)
    a = np.cbrt(3 * force / (np.pi * modulus * low * m) * (ellipk(m) - ellipe(m)))
    b = a * np.sqrt(1 - m)
    approach = 3 * force / (2 * np.pi * a * modulus) * ellipk(m)
    return approach, (a, b) if kx < ky else (b, a)


def at_indentation(cover, d, shape, about):
    """The contact whose indentation is d, by a search for its force between a third and three times `about`."""
    force = brentq(lambda F: solve_force(cover, F, shape).indentation - d, about / 3, 3 * about, rtol=1e-3)
    return solve_force(cover, force, shape)


def test_few_and_small_sets_of_cells_are_tried(cover, monkeypatch):
    """Work goes with the cube of the cells tried; beside that of the last set it is 8 (35 from a bed under all of the force)."""
    tried, work = [], []

    def counted(*arguments):
        tried.append(float(arguments[2].sum()))
        return equilibrium(*arguments)

    equilibrium = signorini._equilibrium
    monkeypatch.setattr(signorini, "_equilibrium", counted)
    for shape in SHAPES.values():
        for force in (5.0, 20.0, 50.0):
            tried.clear()
            solve_force(cover, force, shape)
            work.append(np.sum((np.array(tried) / tried[-1]) ** 3))
    assert np.mean(work) < 12


def test_thick_cover_is_hertz():
    """Cover 80 mm, patch 3.5 to 9 mm: within 3 %, and the difference falls with patch over thickness."""
    wheel = WheelGeometry(radius=0.25, width=0.06, cover_thickness=0.08, modulus=10e6, poisson=0.47)
    thick = build_cover(wheel, 1e-3, period=1.5)
    plane = wheel.modulus / (1 - wheel.poisson**2)
    for kx, ky in ((15.0, 30.0), (30.0, 15.0), (20.0, 20.0001)):
        misses = []
        for size in (6e-3, 4e-3):
            force = 4 / 3 * plane * size**3 * np.sqrt(kx * ky)
            approach, axes = hertz(force, kx, ky, plane)
            contact = solve_force(thick, force, LocalShape(kx, ky))
            misses.append(contact.indentation / approach - 1)
            assert contact.semi_axes == pytest.approx(axes, rel=0.05)
            assert contact.pressure.max() == pytest.approx(1.5 * force / (np.pi * axes[0] * axes[1]), rel=0.05)
        assert np.abs(misses).max() < 0.03
        assert abs(misses[1]) < abs(misses[0])


def test_thin_compressible_cover_is_a_winkler_bed():
    """p = E (1 - nu) / ((1 + nu)(1 - 2 nu)) (d - g) / h for patches many thicknesses wide."""
    h, nu, k, d = 2e-3, 0.3, 5.0, 2e-3
    wheel = WheelGeometry(radius=0.5, width=0.1, cover_thickness=h, modulus=1e7, poisson=nu)
    thin = build_cover(wheel, 1.5e-3, period=60)
    bed = wheel.modulus * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / h
    force = bed * np.pi * d**2 / k
    assert at_indentation(thin, d, LocalShape(k, k), force).force == pytest.approx(force, rel=0.03)


def test_thin_incompressible_cover():
    """(h/M) p - h^3 / (3 mu) lap p = d - k r^2 / 2, p = p' = 0 at the rim: the thin layer near nu = 1/2."""
    h, nu, k, d = 1.2e-3, 0.495, 5.0, 2.5e-3
    wheel = WheelGeometry(radius=0.5, width=0.1, cover_thickness=h, modulus=1e7, poisson=nu)
    thin = build_cover(wheel, 2e-3, period=75)
    alpha = h * (1 + nu) * (1 - 2 * nu) / (wheel.modulus * (1 - nu))
    beta = h**3 * 2 * (1 + nu) / (3 * wheel.modulus)
    reach = np.sqrt(beta / alpha)

    def rim(a):
        amplitude = k * a / alpha * reach / iv(1, a / reach)
        return (d - k * a**2 / 2) / alpha - 2 * k * beta / alpha**2 + amplitude * iv(0, a / reach)

    a = brentq(rim, np.sqrt(d / k), 3 * np.sqrt(d / k))
    amplitude = k * a / alpha * reach / iv(1, a / reach)
    force = np.pi * a**2 * (d / alpha - 2 * k * beta / alpha**2 - k * a**2 / (4 * alpha))
    force += 2 * np.pi * a * reach * amplitude * iv(1, a / reach)
    assert at_indentation(thin, d, LocalShape(k, k), force).force == pytest.approx(force, rel=0.015)


def test_line_contact_in_the_middle_of_a_wide_wheel():
    """Line load at mid-width against a plane-strain layer with its closed-form compliance, solved by NNLS."""
    h, nu, k, d = 0.01, 0.45, 8.0, 2e-4
    wheel = WheelGeometry(radius=5.0, width=0.12, cover_thickness=h, modulus=5e6, poisson=nu)
    wide = build_cover(wheel, 1.2e-3, period=16)
    expected = _plane_line_load(d, k, h, wheel.modulus, nu)
    contact = at_indentation(wide, d, LocalShape(k, 0.0), expected * wheel.width)
    assert contact.pressure[len(wide.y) // 2].sum() * wide.dx == pytest.approx(expected, rel=0.02)


def _plane_line_load(d, k, h, modulus, nu, n=512, length=0.2):
    """N/m of a rigid parabola pressed d into a bonded layer in plane strain."""
    dx = length / n
    wave = 2 * np.pi * np.fft.fftfreq(n, dx)
    kh = np.abs(wave[1:]) * h
    q = 3 - 4 * nu
    c = np.empty(n)
    decay = np.exp(-2 * kh)
    top = q * (1 - decay**2) / 2 - 2 * kh * decay
    bottom = q * (1 + decay**2) / 2 + (2 * kh**2 + 5 - 12 * nu + 8 * nu**2) * decay
    c[1:] = 2 * (1 - nu**2) / (modulus * np.abs(wave[1:])) * top / bottom
    c[0] = h * (1 + nu) * (1 - 2 * nu) / (modulus * (1 - nu))
    row = np.fft.ifft(c).real
    x = (np.arange(n) - n // 2) * dx
    near = np.flatnonzero(np.abs(x) < 0.015)
    C = row[np.abs(near[:, None] - near[None, :])]
    L = np.linalg.cholesky(C)
    # min 1/2 p C p - (d - g) p over p >= 0 is the least-squares problem |L^T p - L^-1 (d - g)|.
    p, _ = nnls(L.T, np.linalg.solve(L, d - 0.5 * k * x[near] ** 2))
    return p.sum() * dx


def test_nnls_finds_the_same_pressures(small):
    rng = np.random.default_rng(8)
    shape = (len(small.y), len(small.x))
    x, y = np.meshgrid(small.x, small.y)
    gap = 0.5 * (8 * x**2 - 3 * y**2) + 2e-5 * rng.standard_normal(shape)
    near = np.abs(x) < 0.02
    j, m = np.nonzero(near)
    C = small.kernel[j[:, None], j[None, :], np.abs(m[:, None] - m[None, :])]
    d = gap.min() + 3e-4
    L = np.linalg.cholesky(C)
    f, _ = nnls(L.T, np.linalg.solve(L, d - gap[near]))
    contact = solve_contact(small, gap, f.sum())
    assert contact.indentation == pytest.approx(d, rel=1e-8)
    assert (contact.pressure * small.area)[near] == pytest.approx(f, abs=1e-6 * f.max())


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    kx=st.floats(0.5, 40),
    ky=st.floats(-20, 40),
    roughness=st.floats(1e-7, 1e-3),
    force=st.floats(0.1, 100),
    edge=st.floats(-0.02, 0.02),
)
def test_contact_conditions_hold_for_any_gap(small, seed, kx, ky, roughness, force, edge):
    x, y = small.x[None], small.y[:, None]
    gap = 0.5 * (kx * x**2 + ky * y**2) + roughness * np.random.default_rng(seed).standard_normal((len(small.y), len(small.x)))
    gap = np.where(y > edge + 0.01, np.inf, gap)
    contact = solve_contact(small, gap, force)
    f = contact.pressure * small.area
    opening = small.displace(f) + gap - contact.indentation
    size = small.displace(f).max()
    assert f.sum() == pytest.approx(force, rel=1e-9)
    assert f.min() >= -1e-9 * force
    assert opening.min() >= -1e-9 * size
    assert np.abs(opening[f > 0]).max() <= 1e-9 * size
    assert contact.residual < 1e-9


@pytest.mark.parametrize("name", SHAPES)
def test_force_rises_with_indentation(small, name):
    forces = np.geomspace(0.5, 100, 25)
    d = [solve_force(small, F, SHAPES[name]).indentation for F in forces]
    assert (np.diff(d) > 0).all()


@pytest.mark.parametrize("name", SHAPES)
def test_indentation_settles_as_the_cells_shrink(finer, name):
    """The default cell is within 1 % of the local indentation of a finer one, one and a half times the cell within 2 %."""
    contacts = [solve_force(c, 20.0, SHAPES[name]) for c in finer]
    d = np.array([c.indentation for c in contacts])
    # Local indentation, F / (2/3 of the stiffness): tilts and hollows move the reference, not this.
    local = 1.5 * 20.0 / contacts[-1].stiffness
    assert abs(d[1] - d[2]) < 0.01 * local
    assert abs(d[0] - d[2]) < 0.02 * local


@pytest.mark.parametrize("beside", SHAPES)
def test_the_cells_that_are_tried_first_do_not_show(small, beside):
    """Cells of another blade, at another place of the wheel and partly where this one has no surface."""
    first = solve_force(small, 33.0, SHAPES[beside])
    cut = replace(SHAPES["flat"], extent=np.array([0.1, 0.1, 4e-3, 4e-3]))
    for shape in (*SHAPES.values(), cut):
        from_there, anew = solve_force(small, 20.0, shape, first), solve_force(small, 20.0, shape)
        assert from_there.indentation == anew.indentation
        np.testing.assert_array_equal(from_there.pressure, anew.pressure)


def test_contacts_solved_together_are_those_solved_alone(small):
    """Of other shapes, forces and numbers of sets that are tried, one that is apart among them."""
    shapes = [*SHAPES.values(), SHAPES["flat"]]
    forces = np.array([5.0, 20.0, 50.0, 33.0, 8.0, 20.0, 0.0])
    for force, shape, together in zip(forces, shapes, solve_forces(small, forces, shapes), strict=True):
        alone = solve_force(small, force, shape)
        assert together.indentation == alone.indentation and together.force == alone.force
        for name in ("pressure", "centroid", "x", "y"):
            np.testing.assert_array_equal(getattr(together, name), getattr(alone, name))


def test_cells_exchanged_one_by_one_lead_to_the_same_contact(small, monkeypatch):
    """What takes over where whole blocks go round in circles (Judice and Pires 1994)."""
    shapes, forces = list(SHAPES.values()), np.full(len(SHAPES), 20.0)
    blocks = solve_forces(small, forces, shapes)
    monkeypatch.setattr(signorini, "PATIENCE", -1)
    for one, other in zip(solve_forces(small, forces, shapes), blocks, strict=True):
        np.testing.assert_array_equal(one.pressure, other.pressure)


def test_order_of_convergence():
    """Fixed smooth pressure: the energy's error falls at least with the square of the cell."""
    energy = []
    for cell in (4e-3, 2e-3, 1e-3):
        cover = build_cover(WHEEL, cell)
        fine = (np.arange(8) - 3.5) / 8
        x = cover.x[None, :, None, None] + cover.dx * fine[None, None, :, None]
        y = cover.y[:, None, None, None] + cover.dy[:, None, None, None] * fine[None, None, None, :]
        f = np.exp(-(x**2 + y**2) / 6e-3**2).mean(axis=(2, 3)) * cover.area
        energy.append((f * cover.displace(f)).sum() / f.sum() ** 2)
    order = np.log2((energy[1] - energy[0]) / (energy[2] - energy[1]))
    assert order > 1.7


@pytest.mark.parametrize("name", ["skew", "edge", "tilted"])
def test_mirror_images_indent_alike(cover, name):
    s = SHAPES[name]
    d = solve_force(cover, 20.0, s).indentation
    along = replace(s, kxy=-s.kxy, tilt_x=-s.tilt_x)
    across = replace(s, kxy=-s.kxy, lateral=-s.lateral, tilt_y=-s.tilt_y)
    assert solve_force(cover, 20.0, along).indentation == pytest.approx(d, rel=1e-9, abs=1e-12)
    assert solve_force(cover, 20.0, across).indentation == pytest.approx(d, rel=1e-9, abs=1e-12)


def test_moving_the_origin_changes_nothing_but_the_reference(cover):
    """The same blade told from another planned point (dx, dy): d changes by the gap there, the force field does not."""
    s = SHAPES["skew"]
    first = solve_force(cover, 20.0, s)
    dx, dy = 0.003, -0.002
    moved = replace(
        s, lateral=s.lateral + dy, tilt_x=s.tilt_x + s.kxx * dx + s.kxy * dy, tilt_y=s.tilt_y + s.kxy * dx + s.kyy * dy
    )
    second = solve_force(cover, 20.0, moved)
    assert second.indentation == pytest.approx(first.indentation - s.gap(np.array(dx), np.array(dy)), abs=1e-12)
    assert second.centroid + np.array([dx, dy]) == pytest.approx(first.centroid, abs=1e-9)


def test_stiffness_and_response_are_derivatives(cover):
    s = SHAPES["convex"]
    first, more = solve_force(cover, 20.0, s), solve_force(cover, 20.0 + 1e-7, s)
    assert 1e-7 / (more.indentation - first.indentation) == pytest.approx(first.stiffness, rel=1e-3)
    assert first.response.sum() == pytest.approx(1.0)


def test_no_blade_beyond_its_edge(cover):
    """t along +x, b = n x t = -y: the blade ends 2 mm toward -y; losing support lets it in deeper."""
    whole, cut = (
        solve_force(cover, 20.0, replace(SHAPES["convex"], extent=np.array([0.1, 0.1, e, 0.1]), heading=(1.0, 0.0)))
        for e in (0.1, 0.002)
    )
    assert cut.pressure[cut.y < -0.002].max() == 0
    assert whole.pressure[whole.y < -0.002].max() > 0
    assert cut.indentation > whole.indentation
    turned = solve_force(cover, 20.0, replace(SHAPES["convex"], extent=np.array([0.1, 0.1, 0.002, 0.1]), heading=(0.0, 1.0)))
    assert turned.pressure[:, turned.x > 0.002].max() == 0


def test_hollow_blade_bears_on_both_edges_below_the_planned_point(cover):
    contact = solve_force(cover, 20.0, SHAPES["hollow"])
    assert contact.indentation < 0
    assert contact.pressure[len(contact.y) // 2].max() == 0
    assert contact.pressure[0].max() > 0 and contact.pressure[-1].max() > 0


def test_refusals(cover):
    with pytest.raises(Infeasible, match="hollow along the belt"):
        solve_force(cover, 20.0, LocalShape(-1.0, 3.0))
    with pytest.raises(Infeasible, match="no part of the blade"):
        solve_force(cover, 20.0, LocalShape(6.0, 3.0, lateral=0.1, extent=np.full(4, 0.01)))


def test_apart_means_no_force(cover):
    contact = solve_force(cover, 0.0, SHAPES["convex"])
    assert contact.force == 0.0 and not contact.pressure.any() and abs(contact.indentation) < 1e-4


def test_a_patch_at_the_end_of_the_window_says_so(small):
    assert solve_force(small, 1e4, LocalShape(1.0, 1.0)).touches_border
    assert not solve_force(small, 20.0, SHAPES["convex"]).touches_border


@pytest.mark.parametrize(("shore", "rough"), [(40, 0.54), (60, 0.33), (70, 0.25), (80, 0.17), (90, 0.10)])
def test_rough_numbers_of_the_physics_page(shore, rough):
    """PHYSICS 3.4, rigid blade rounded to 60 mm across the belt, wheel of 100 mm, 20 N: a cover of 15 mm comes within 20 %,
    and is stiffer than the half-space."""
    modulus = 1e6 * 10 ** (0.0235 * shore - 0.6403)
    wheel = WheelGeometry(radius=0.1, width=0.04, cover_thickness=0.015, modulus=modulus, poisson=0.47)
    d = solve_force(build_cover(wheel, 1.5e-3), 20.0, LocalShape(1 / 0.1, 1 / 0.06)).indentation
    assert d * 1e3 == pytest.approx(rough, rel=0.2)
    assert d < hertz(20.0, 1 / 0.1, 1 / 0.06, modulus / (1 - 0.47**2))[0]
