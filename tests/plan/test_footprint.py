"""Footprints against Hertz's ellipsoid, evenness of lines and ends against closed forms (PHYSICS 6), linearity, conservation."""

import numpy as np
import pytest

from ocp.contact.wheel.cover import WheelGeometry, build_cover
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.plan.removal.footprint import CELL, LinePatches, line_footprint, line_patches

A, B = 5e-3, 3.5e-3  # m, half axes along t and b


def ellipsoid(a: float = A, b: float = B) -> LinePatches:
    """Hertz's pressure of one newton, exactly, on the footprint's grid."""
    x = CELL * np.arange(-20, 21)
    fine = (x[:, None] + CELL * (np.arange(8) - 3.5) / 8).ravel()
    share = np.sqrt(np.maximum(1 - (fine[:, None] / a) ** 2 - (fine[None, :] / b) ** 2, 0.0))
    share = share.reshape(len(x), 8, len(x), 8).mean(axis=(1, 3))
    return LinePatches(np.array([0.0]), x, share[None] / (share.sum() * CELL**2), np.array([20.0]), np.array([3e-4]))


@pytest.fixture(scope="module")
def thick():
    """A cover so thick that Hertz holds."""
    return build_cover(WheelGeometry(radius=0.25, width=0.06, cover_thickness=0.08, modulus=10e6, poisson=0.47), 1e-3, period=1.5)


@pytest.mark.parametrize("heading", [(1.0, 0.0), (-1.0, 0.0), (np.cos(0.5), np.sin(0.5))])
def test_the_footprint_is_hertz_turned_into_the_feed(thick, heading):
    contact = solve_force(thick, 100.0, LocalShape(30.0, 15.0))
    patches = line_patches(np.array([0.0]), [contact], [heading])
    x, share = patches.x, patches.share[0]
    assert share.sum() * CELL**2 == pytest.approx(1.0)
    t, b = np.meshgrid(x, x, indexing="ij")
    belt, axis = heading[0] * t + heading[1] * b, heading[1] * t - heading[0] * b  # a mirror: n = -z
    a, c = contact.semi_axes
    hertz = 1.5 / (np.pi * a * c) * np.sqrt(np.maximum(1 - (belt / a) ** 2 - (axis / c) ** 2, 0.0))
    assert np.abs(share - hertz)[hertz > 0.5 * hertz.max()].max() < 0.09 * hertz.max()
    assert np.abs(share - hertz).sum() * CELL**2 < 0.07  # the rim is steep, a cell of the cover is a sixth of its half axis


def test_the_depth_across_a_line_is_a_parabola(thick):
    contact = solve_force(thick, 100.0, LocalShape(15.0, 30.0))
    patches = line_patches(np.array([0.0]), [contact], [(1.0, 0.0)])
    across = patches.share[0].sum(axis=0) * CELL
    b = patches.half_axes[0, 1]
    assert b == pytest.approx(contact.semi_axes[1], rel=0.03)
    parabola = 0.75 / b * np.maximum(1 - (patches.x / b) ** 2, 0.0)
    assert np.abs(across - parabola).max() < 0.04 * parabola.max()


@pytest.mark.parametrize(
    ("ratio", "five", "ten"),
    [(0.55, 1.0, 1.0), (0.6, 1.0, 1.0), (0.65, 0.80, 1.0), (0.7, 0.72, 1.0), (0.9, 0.61, 0.89), (1.6, 0.38, 0.47)],
)
def test_lines_are_as_even_as_the_physics_page_says(ratio, five, ten):
    """PHYSICS 6: shares of the surface within 5 % and 10 % of the level that most of it has, parabolic profiles at h/b."""
    patches, h = ellipsoid(), ratio * B
    y = np.linspace(0.0, h, 801)
    depth = np.zeros_like(y)
    along = patches.x
    for k in range(-5, 6):
        for t in along:
            depth += patches.pressure(np.zeros(801), np.full(801, t), y - k * h, np.full(801, 20.0)) * CELL
    depth *= h
    level = max(np.linspace(depth.min(), depth.max(), 200), key=lambda one: (np.abs(depth / one - 1) < 0.05).mean())
    off = np.abs(depth / level - 1)
    assert [(off < 0.05).mean(), (off < 0.10).mean()] == pytest.approx([five, ten], abs=0.12)
    assert depth.mean() == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("spacing", [0.3 * B, 0.55 * B])
def test_ends_are_as_long_as_the_physics_page_says(spacing):
    """95 % of the depth 0.73 half-lengths inside the last full-force point, 90 % at 0.61, half of it at the point itself."""
    s = np.linspace(0.0, 0.04, 801)
    depth = line_footprint(s, ellipsoid(), spacing) @ np.ones(801)
    assert np.interp(0.73 * A, s, depth) == pytest.approx(0.95, abs=0.006)
    assert np.interp(0.61 * A, s, depth) == pytest.approx(0.90, abs=0.006)
    assert depth[0] == pytest.approx(0.5, abs=0.01)


def test_rows_sum_to_one_inside_however_the_nodes_are_graded():
    graded = 0.05 * (1 - np.cos(np.pi * np.linspace(0, 1, 150))) / 2
    M = line_footprint(graded, ellipsoid())
    inside = (graded > 1.01 * A) & (graded < graded[-1] - 1.01 * A)
    assert np.asarray(M.sum(axis=1)).ravel()[inside] == pytest.approx(1.0, abs=2e-3)
    assert M.min() > -1e-12
    assert M.nnz < 0.5 * M.shape[0] ** 2
    steps = np.r_[1.0, 1.0 + 0.1 * np.sin(300 * graded[1:])]
    assert M @ (2 * steps) == pytest.approx(2 * (M @ steps))


def test_a_patch_grows_with_the_cube_root_of_its_force():
    patches = ellipsoid()
    x = np.linspace(-2 * A, 2 * A, 400)
    for force in (5.0, 20.0, 40.0):
        along = patches.pressure(np.zeros(400), x, np.zeros(400), np.full(400, force))
        size = np.cbrt(force / 20.0)
        assert along.max() == pytest.approx(1.5 / (np.pi * A * B) / size**2, rel=0.01)
        assert x[along > 0].max() == pytest.approx(size * A, abs=1.5 * CELL)


def test_footprints_between_stations_are_blended():
    one, other = ellipsoid(), ellipsoid(3e-3, 2e-3)
    patches = LinePatches(
        np.array([0.0, 0.01]), one.x, np.concatenate([one.share, other.share]), np.array([20.0, 20.0]), np.full(2, 3e-4)
    )
    zero, at = np.zeros(3), np.array([0.0, 0.005, 0.01])
    middle = patches.pressure(at, zero, zero, np.full(3, 20.0))
    assert middle[1] == pytest.approx(0.5 * (middle[0] + middle[2]))
    assert patches.half_axes[:, 1] == pytest.approx([B, 2e-3], rel=0.01)
