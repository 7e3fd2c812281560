"""Nearest points of facets that lie closer together than a tenth of a millimetre."""

import numpy as np

from trajectories.blade.mesh import Blade
from trajectories.blade.nearest import nearest_on_facets

STEP = 5e-5  # m, as high as what a mended edge leaves


def test_the_rim_of_a_sheet_is_nearer_than_the_sheet_below():
    square = np.array([[-0.02, 0.0, 0.0], [0.02, 0.0, 0.0], [0.02, 0.02, 0.0], [-0.02, 0.02, 0.0]])
    above = np.where(square == -0.02, 0.0, square) + [0, 0, STEP]  # from x = 0 on
    facets = np.array([[0, 1, 2], [0, 2, 3]])
    blade = Blade("sheets", "", np.vstack([square, above]), np.vstack([facets, facets + 4]))
    rng = np.random.default_rng(3)
    x, z = rng.uniform(-2.0 * STEP, -1.0 * STEP, 200), rng.uniform(3.0 * STEP, 3.5 * STEP, 200)
    points = np.column_stack([x, rng.uniform(0.001, 0.019, 200), z])
    rim = np.hypot(x, z - STEP)
    assert (rim < z).all()
    closest, distance, facet = nearest_on_facets(blade, points)
    assert np.abs(distance - rim).max() < 1e-10 and (facet >= 2).all()
    assert np.allclose(closest, np.column_stack([0 * x, points[:, 1], 0 * x + STEP]), atol=1e-10)
