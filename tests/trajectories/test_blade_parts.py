"""Odd blades made for the purpose: the aerofoil is found as it was built, or the part is refused for the true reason.

All thirty: `python benchmarks/blade_parts.py`.
"""

import numpy as np
import pytest
import trimesh

from robots.errors import BadInput
from tests.support.blade_parts import RECIPES, build, outcome
from trajectories.blade import Blade, NamedAerofoil, find_shape, read_blade

SHORT = (2, 6, 9, 14, 15, 16, 18, 20, 21, 22, 25, 27, 28, 29, 30)  # of every kind of root, tip and cut, with few facets


@pytest.mark.parametrize("number", SHORT)
def test_the_aerofoil_of_an_odd_blade(tmp_path, number):
    recipe = RECIPES[number - 1]
    part = build(recipe)
    found = outcome(part, part.write(tmp_path))
    assert found.wrong(recipe) == "", found
    assert any("holes or slots" in notice for notice in found.notices) == (recipe.cuts in ("trailing slots", "film holes"))


def test_the_table_holds_what_it_promises():
    assert [recipe.seed for recipe in RECIPES] == list(range(1, 31))
    lengths, twists, edges = (np.array([getattr(recipe, name) for recipe in RECIPES]) for name in ("length", "twist", "edge"))
    assert lengths.min() <= 20 and lengths.max() >= 400 and twists.min() == 0 and twists.max() >= 60
    assert edges.min() <= 0.2 and edges.max() >= 2.0 and {recipe.fine for recipe in RECIPES} == {0, 1, 2, 3}


def test_a_named_range_takes_the_other_side_of_a_clapper(tmp_path):
    part = build(RECIPES[24])
    blade = read_blade(part.write(tmp_path))
    foot = 1e-3 * float(part.axis @ part.shift)
    shape = find_shape(blade, NamedAerofoil(part.axis, foot + 0.134, foot + 0.175))
    heights = part.back(shape.sides["convex"].surface(np.array([0.5, 0.5]), shape.v))[:, 2]
    assert 133.0 < heights.min() < 138.0 and 170.0 < heights.max() < 176.0


def test_a_named_range_without_an_aerofoil_is_refused_with_what_stands_there(tmp_path):
    part = build(RECIPES[0])
    blade = read_blade(part.write(tmp_path))
    foot = 1e-3 * float(part.axis @ part.shift)
    with pytest.raises(BadInput, match="a block or a flat plate|nowhere slender"):
        find_shape(blade, NamedAerofoil(part.axis, foot - 0.029, foot - 0.002))
    with pytest.raises(BadInput, match="nothing lies between aerofoil_from_mm and aerofoil_to_mm, it reaches from"):
        find_shape(blade, NamedAerofoil(part.axis, foot + 0.5))
    with pytest.raises(BadInput, match="this is no blade"):
        find_shape(blade, NamedAerofoil(part.turn[:, 0]))


def test_a_plate_with_round_edges_is_an_aerofoil_where_the_cell_says_so():
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 12)
    right = np.column_stack([20.0 + 2.0 * np.cos(angle), 2.0 * np.sin(angle)])
    outline = np.concatenate([right, -right])
    heights = np.linspace(0.0, 80.0, 40)
    n, rings = len(outline), len(heights)
    vertices = np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in heights] + [[[0, 0, 0], [0, 0, 80.0]]])
    i, k = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(rings - 1)))
    a, b = k * n + i, k * n + (i + 1) % n
    ring = np.arange(n)
    caps = [
        (np.full(n, n * rings), np.roll(ring, -1), ring),
        (np.full(n, n * rings + 1), ring + n * (rings - 1), np.roll(ring, -1) + n * (rings - 1)),
    ]
    faces = np.concatenate([np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1), *(np.stack(cap, 1) for cap in caps)])
    assert trimesh.Trimesh(vertices, faces, process=False).is_volume
    plate = Blade("plate", "", 1e-3 * vertices, faces)
    with pytest.raises(BadInput, match="flat plate"):
        find_shape(plate)
    shape = find_shape(plate, NamedAerofoil(np.array([0.0, 0.0, 1.0]), 0.01, 0.07))
    np.testing.assert_allclose(np.sort(shape.frame.coordinate(np.array([[0, 0, 0.0], [0, 0, 0.08]]))), [0.0, 0.08], atol=1e-3)
    assert 0.05 < np.ptp(shape.v) < 0.061
