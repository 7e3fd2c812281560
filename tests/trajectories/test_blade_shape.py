from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from robots.errors import BadInput
from robots.pose import rotation_from_abc
from tests.support import blade_samples
from trajectories.blade import Blade, find_shape, read_blade
from trajectories.blade.sections import level_loops, slicer
from trajectories.blade.spline import clamped_knots, curvature_in_frame, fit_surface, nearest_parameters

ROOT = Path(__file__).parents[2]
BLADES = ROOT.parent / "shared" / "data" / "blades"
needs_data = pytest.mark.skipif(not BLADES.is_dir(), reason="the shared data folder is not beside this repository")


def blade_of(vertices, faces, name="sample"):
    return Blade(name, "", np.asarray(vertices, float), np.asarray(faces, np.int64))


@pytest.fixture(scope="module")
def sample():
    return find_shape(blade_of(*blade_samples.blade_mesh(120, 40)))


def unit(x):
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def fit_analytic(surface, pieces, n=60):
    """A fitted spline of a known surface over the unit square, and a grid of parameters inside."""
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij"))
    knots = clamped_knots(np.linspace(0, 1, pieces + 1))
    fitted = fit_surface(u, v, surface(u, v), np.ones(len(u)), (knots, knots), (0.05, 0.1), 0.05)
    inner = [x.ravel() for x in np.meshgrid(np.linspace(0.1, 0.9, 15), np.linspace(0.1, 0.9, 15))]
    return fitted, *inner


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.3])
def test_curvature_of_a_cylinder_in_a_turned_frame(turn):
    radius = 0.03

    def cylinder(u, v):
        return np.stack([radius * np.cos(1.5 * u), radius * np.sin(1.5 * u), 0.1 * v], axis=-1)

    fitted, u, v = fit_analytic(cylinder, 12)
    n = unit(cylinder(u, v) * [1, 1, 0])
    around = np.cross([0.0, 0.0, 1.0], n)
    t = np.cos(turn) * around + np.sin(turn) * np.array([0.0, 0.0, 1.0])
    k = curvature_in_frame(fitted, u, v, n, t)
    c, s = np.cos(turn), np.sin(turn)
    # Only the component along the circle bends: z = -1/2 (x t_around + y b_around)^2 / R.
    b_around = np.einsum("ni,ni->n", np.cross(n, t), around)
    np.testing.assert_allclose(np.abs(b_around), abs(s), atol=1e-12)
    expected = np.stack([c * c / radius + 0 * u, s * s / radius + 0 * u, c * b_around / radius], axis=1)
    np.testing.assert_allclose(k, expected, atol=0.02 / radius)


def test_gauss_and_mean_curvature_of_an_ellipsoid():
    a, b, c = 0.05, 0.03, 0.02

    def ellipsoid(u, v):
        p, q = 0.3 + 0.9 * u, 0.4 + 0.9 * v
        return np.stack([a * np.cos(p) * np.sin(q), b * np.sin(p) * np.sin(q), c * np.cos(q)], axis=-1)

    fitted, u, v = fit_analytic(ellipsoid, 14)
    x = ellipsoid(u, v)
    n = unit(x / np.array([a**2, b**2, c**2]))
    t = unit(np.cross(n, [0.3, 1.0, 0.2]))
    k = curvature_in_frame(fitted, u, v, n, t)
    h2 = np.sum(x**2 / np.array([a, b, c]) ** 4, axis=1)
    gauss = 1.0 / (a * b * c * h2) ** 2
    mean = (a * a + b * b + c * c - np.sum(x**2, axis=1)) / (2.0 * (a * b * c) ** 2 * h2**1.5)
    np.testing.assert_allclose(k[:, 0] * k[:, 1] - k[:, 2] ** 2, gauss, rtol=0.02)
    np.testing.assert_allclose(0.5 * (k[:, 0] + k[:, 1]), mean, rtol=0.01)


def test_the_fit_converges_with_fourth_order():
    def wave(u, v):
        return np.stack([0.05 * u, 0.1 * v, 0.002 * np.sin(5 * u) * np.cos(4 * v)], axis=-1)

    errors = []
    for pieces in (4, 8, 16):
        fitted, u, v = fit_analytic(wave, pieces, 120)
        pu, pv = nearest_parameters(fitted, wave(u, v), u, v)
        errors.append(np.linalg.norm(fitted(pu, pv) - wave(u, v), axis=1).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 3.5).all(), (errors, orders)


@given(st.floats(-0.9, 0.9), st.floats(0.0, 3.1))
@settings(max_examples=20, deadline=None)
def test_slices_of_a_sphere_are_circles_with_the_body_on_the_left(height, angle):
    ball = trimesh.creation.icosphere(5, 1.0)
    direction = np.array([np.sin(angle), 0.0, np.cos(angle)])
    loops = level_loops(slicer(ball.vertices, ball.faces), ball.vertices @ direction, height)
    assert len(loops) == 1
    p = loops[0].points
    np.testing.assert_allclose(p @ direction, height, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(p - height * direction, axis=1), np.sqrt(1 - height**2), atol=0.02)
    area = 0.5 * np.cross(p, np.roll(p, -1, axis=0)).sum(axis=0) @ direction
    assert area == pytest.approx(np.pi * (1 - height**2), rel=0.02)


@pytest.mark.parametrize("kind", [{}, {"thick": 0.08, "camber": 0.1, "twist": 0.7}, {"twist": 0.0, "taper": 0.0}])
def test_normals_and_curvatures_of_an_analytic_blade(kind):
    shape = find_shape(blade_of(*blade_samples.blade_mesh(160, 60, **kind)))
    for name, side in shape.sides.items():
        u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.08, 0.92, 15), np.linspace(shape.v[0] + 3e-3, shape.v[1] - 3e-3, 9)))
        p, n = side.surface(u, v), side.normal(u, v)
        phi = np.full(len(u), np.pi * (0.5 if name == "convex" else 1.5))
        z = p[:, 2].copy()
        for _ in range(40):
            normal, xp, xz, second = blade_samples.exact_geometry(phi, z, **kind)
            gap = p - blade_samples.blade_point(phi, z, **kind)
            step = np.linalg.solve(np.stack([xp, xz, normal], axis=2), gap[:, :, None])[:, :, 0]
            phi, z = phi + np.clip(step[:, 0], -0.1, 0.1), z + np.clip(step[:, 1], -2e-3, 2e-3)
        assert np.abs(step[:, :2]).max() < 1e-9
        assert np.abs(step[:, 2]).max() < 1e-6  # within 1 um of the true surface
        assert np.rad2deg(np.arccos(np.clip(np.sum(n * normal, axis=1), -1, 1))).max() < 0.1
        t = unit(np.cross(n, [0.2, 0.1, 1.0]))
        frame = np.linalg.pinv(np.stack([xp, xz], axis=2)) @ np.stack([t, np.cross(n, t)], axis=2)
        exact = -np.swapaxes(frame, 1, 2) @ second @ frame
        k = curvature_in_frame(side.surface, u, v, n, t)
        error = np.abs(k - np.stack([exact[:, 0, 0], exact[:, 1, 1], exact[:, 0, 1]], axis=1))
        # 2 % of the curvature, or 0.25 1/m (a radius of 4 m) where the wall is nearly flat.
        assert (error.max(axis=1) < np.maximum(0.02 * np.linalg.norm(exact, axis=(1, 2)), 0.25)).all()


def test_edges_and_sides_of_the_analytic_blade(sample):
    assert sample.notices == ()
    z = sample.leading[:, 2]
    np.testing.assert_allclose(sample.leading, blade_samples.blade_point(np.full(len(z), np.pi), z), atol=0.3e-3)
    np.testing.assert_allclose(sample.trailing, blade_samples.blade_point(np.zeros(len(z)), z), atol=0.3e-3)
    middle = blade_samples.blade_point(np.array([0.5, 1.5]) * np.pi, np.array([0.05, 0.05]))
    for name, exact in zip(("convex", "concave"), middle, strict=True):
        side = sample.sides[name]
        p = side.surface(np.linspace(0, 1, 200), np.full(200, 0.05))
        assert np.linalg.norm(p - exact, axis=1).min() < 0.3e-3
    assert sample.frame.axis @ [0, 0, 1] > 0.9999  # root is the larger end
    assert sample.frame.block == (False, False)


@given(st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3), st.lists(st.floats(-1, 1), min_size=3, max_size=3))
@settings(max_examples=5, deadline=None, phases=[Phase.explicit, Phase.generate])  # shrinking would take minutes
def test_the_shape_moves_with_the_blade(angles, shift):
    vertices, faces = blade_samples.blade_mesh(80, 24)
    still = find_shape(blade_of(vertices, faces))
    R = rotation_from_abc(angles)
    moved = find_shape(blade_of(vertices @ R.T + shift, faces))
    np.testing.assert_allclose(moved.leading, still.leading @ R.T + shift, atol=1e-9)
    for name, side in still.sides.items():
        u, v = np.linspace(0.05, 0.95, 9), np.linspace(*still.v, 9)
        np.testing.assert_allclose(moved.sides[name].surface(u, v), side.surface(u, v) @ R.T + shift, atol=1e-7)
        np.testing.assert_allclose(moved.sides[name].normal(u, v), side.normal(u, v) @ R.T, atol=1e-5)


def test_block_and_shroud_are_left_out():
    import make_bundled_blade as made

    vertices, faces = made.mesh()
    for mesh, block, top in (
        ((1e-3 * vertices, faces), (True, False), 120.0),
        (blade_samples.bundled_with_shroud(), (True, True), 120.0),
    ):
        shape = find_shape(blade_of(*mesh))
        assert shape.frame.block == block
        side = shape.sides["convex"]
        ends = 1e3 * side.surface(np.array([0.5, 0.5]), shape.v)[:, 2]
        assert made.BLOCK_TOP + 0.8 * made.FILLET < ends[0] < made.BLOCK_TOP + made.FILLET + 2.5
        assert top - 2.5 < ends[1] < top + 0.3
        assert side.deviation[1] < 5e-6


def test_the_bundled_blade_is_what_its_script_makes_and_needs_no_mending():
    import make_bundled_blade as made

    blade = read_blade(ROOT / "ocp" / "data" / "blade.stl")
    assert blade.notices == () and (ROOT / "ocp" / "data" / "blade.stl").stat().st_size < 400_000
    vertices, faces = made.mesh()
    assert len(blade.faces) == len(faces)
    np.testing.assert_allclose(np.sort(blade.vertices, axis=0), np.sort(1e-3 * vertices, axis=0), atol=1e-8)
    concave = find_shape(blade).sides["concave"]
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.05, 0.95, 30), np.linspace(0.0, 0.09, 30)))
    n = concave.normal(u, v)
    k = curvature_in_frame(concave.surface, u, v, n, unit(np.cross(n, [0.0, 0.0, 1.0])))
    assert k[:, 0].min() > -1.0 / 0.090  # chordwise radius of at least 90 mm: a wheel of 50 mm fits


@pytest.mark.parametrize(
    ("solid", "reason"),
    [
        (trimesh.creation.box((0.1, 0.1, 0.1)), "nowhere slender"),
        (trimesh.creation.icosphere(3, 0.05), "nowhere slender"),
        (trimesh.creation.box((0.1, 0.05, 0.004)), "flat plate"),
        (trimesh.creation.torus(0.05, 0.01), "aerofoil sections reach"),
    ],
)
def test_what_is_no_blade_is_refused_with_the_reason(solid, reason):
    with pytest.raises(BadInput, match=reason):
        find_shape(blade_of(solid.vertices, solid.faces, "thing"))


@needs_data
def test_a_real_compressor_blade_with_conical_ends():
    blade = read_blade(BLADES / "rotor37.stl")
    shape = find_shape(blade)
    assert np.ptp(shape.v) > 0.95 * 0.070  # ragged ends cost little: the section planes follow them
    for side in shape.sides.values():
        assert side.deviation[0] < 1e-6 and side.deviation[1] < 10e-6
        u, v = np.full(5, 0.5), np.linspace(0.01, 0.06, 5)
        other = next(x for x in shape.sides.values() if x is not side)
        outward = side.surface(u, v) - other.surface(u, v)
        assert (np.sum(side.normal(u, v) * outward, axis=1) > 0.8 * np.linalg.norm(outward, axis=1)).all()
