"""The blade's real surface under the wheel: departure from the local quadratic, edges, and contact elsewhere."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ocp.contact.wheel.signorini import LocalShape
from ocp.model.blade_gap import FACING, REACH, SurfaceCloud, surface_shape
from ocp.plan.clearance import enclosed, find_secondary_contact
from ocp.plan.paths import surface_cloud
from ocp.plan.rules import SECONDARY_CONTACT_TOLERANCE
from tests.support.blade_parts import RECIPES, build, section
from tests.support.example_pass import bundled_cell
from tests.support.round_bar import CONTACT, RADIUS, bar, buried, on_wheel
from trajectories.blade import find_shape, read_blade


@pytest.fixture(scope="module")
def cell():
    return bundled_cell()


def exact_gap(x, wheel_radius, delta, radius=RADIUS):
    """Distance along the wheel's radius from the bar to where its nearest point lies, at arc x = R angle of the wheel."""
    angle = x / wheel_radius
    d = wheel_radius - delta + radius
    # Ray from the wheel's centre to the bar, whose centre is d away: the near crossing.
    return d * np.cos(angle) - np.sqrt(radius**2 - (d * np.sin(angle)) ** 2) - (wheel_radius - delta)


@pytest.mark.parametrize("delta", [0.0, 2e-4])
def test_two_parallel_cylinders_have_the_gap_of_the_textbook(cell, delta):
    """The departure makes the gap exact where the quadratic has left it."""
    R = cell.wheel.radius
    base = LocalShape(kxx=1 / RADIUS + 1 / R, kyy=0.0)
    shape = surface_shape(cell.wheel, bar(), base, on_wheel(cell, delta=delta), CONTACT)
    x = np.linspace(-0.015, 0.015, 61)
    expected = exact_gap(x, R, delta)
    assert np.abs(expected - base.gap(x, 0 * x)).max() > 5e-5, "the quadratic alone would do; the test tells nothing"
    for y in (-0.005, 0.0, 0.0061):
        off = np.abs(shape.gap(x, np.full_like(x, y)) - expected)
        assert off.max() < 2e-6  # linear between points: 1/8 k h^2


def test_a_turned_bar_has_the_turned_gap(cell):
    R, turn = cell.wheel.radius, np.radians(25.0)
    c, s = np.cos(turn), np.sin(turn)
    # The curved direction of the bar is across its axis; docs/architecture.md: relative curvature, 1/R in kxx.
    base = LocalShape(kxx=c**2 / RADIUS + 1 / R, kyy=s**2 / RADIUS, kxy=-c * s / RADIUS)
    other = LocalShape(kxx=base.kxx, kyy=base.kyy, kxy=-base.kxy)
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(-2e-3, 2e-3, 9), np.linspace(-2e-3, 2e-3, 9)))
    errors = []
    for one in (base, other):
        shape = surface_shape(cell.wheel, bar(), one, on_wheel(cell, turn), CONTACT)
        errors.append(np.abs(shape.departure.at(x, y)).max())
    assert errors[0] < 2e-6 < 10e-6 < errors[1]


def test_the_gap_does_not_depend_on_the_quadratic_it_is_told_from(cell):
    x = np.linspace(-0.008, 0.008, 33)
    T = on_wheel(cell)
    gaps = [
        surface_shape(cell.wheel, bar(), LocalShape(kxx, 0.0, tilt_x=tilt), T, CONTACT).gap(x, 0.3 * x)
        for kxx, tilt in ((37.5, 0.0), (30.0, 0.01), (60.0, -0.02))
    ]
    # The departure is linear between points 0.4 mm apart: 1/8 k h^2 each way.
    np.testing.assert_allclose(gaps[1], gaps[0], atol=2e-6)
    np.testing.assert_allclose(gaps[2], gaps[0], atol=2e-6)


def test_beyond_an_edge_there_is_no_blade(cell):
    base = LocalShape(kxx=1 / RADIUS + 1 / cell.wheel.radius, kyy=0.0)
    shape = surface_shape(cell.wheel, bar(upto=0.003), base, on_wheel(cell), CONTACT)
    x = np.zeros(4)
    gap = shape.gap(x, np.array([-0.004, 0.0025, 0.0035, 0.006]))
    assert np.isfinite(gap[:2]).all() and np.isinf(gap[2:]).all() and (gap[2:] > 0).all()


def test_the_far_side_of_the_blade_is_not_seen(cell):
    base = LocalShape(kxx=1 / RADIUS + 1 / cell.wheel.radius, kyy=0.0)
    near = bar()
    back = SurfaceCloud(near.points - [0.0, 0.002, 0.0], -near.normals)
    both = SurfaceCloud(np.vstack([near.points, back.points]), np.vstack([near.normals, back.normals]))
    T = on_wheel(cell)
    x = np.linspace(-0.006, 0.006, 25)
    one = surface_shape(cell.wheel, near, base, T, CONTACT).gap(x, 0 * x)
    two = surface_shape(cell.wheel, both, base, T, CONTACT).gap(x, 0 * x)
    np.testing.assert_allclose(two, one, atol=2e-6)
    assert 0 < FACING < 1


def test_walls_as_steep_as_the_wheel_s_radius_are_not_touched(cell):
    """A rod of two millimetres, all round: what looks away by more than acos(FACING) is no surface that the wheel bears on."""
    radius, edge = 1e-3, np.sqrt(1 - FACING**2)
    around, along = (v.ravel() for v in np.meshgrid(np.arange(-np.pi, np.pi, 0.02), np.arange(-4e-3, 4e-3, 1e-4)))
    normals = np.column_stack([0 * around, np.cos(around), np.sin(around)])
    rod = SurfaceCloud(CONTACT + radius * (normals - [0.0, 1.0, 0.0]) + along[:, None] * [1.0, 0.0, 0.0], normals)
    shape = surface_shape(cell.wheel, rod, LocalShape(1 / radius, 0.0), on_wheel(cell), CONTACT)
    gap = shape.gap(radius * np.array([0.0, 0.5, edge - 0.06, edge - 0.01, edge]), np.zeros(5))
    np.testing.assert_allclose(gap[:2], radius * np.array([0.0, 1 - np.sqrt(0.75)]), atol=6e-6)
    assert np.isfinite(gap[2]) and np.isinf(gap[3:]).all()


def test_triangles_cover_the_surface_and_hardly_twice():
    """Where pieces meet, the diagonals of some squares lie both ways."""
    cloud = bar(0.02)
    parts = cloud.surface.pieces
    assert len(parts) > 8
    x, angle = np.ptp(cloud.points[:, 0]), np.ptp(np.arctan2(cloud.points[:, 2], cloud.points[:, 1]))
    area = 0.5 * sum(one.double_area.sum() for one in parts)
    assert 0.9999 < area / (x * angle * RADIUS) < 1.1
    for one, facing in zip(parts, cloud.surface.facing, strict=True):
        a, b, c = one.points[one.corners]
        assert (np.cross(b - a, c - a) @ facing > 0).all()  # counter-clockwise seen from outside


def test_a_grid_has_no_holes_and_the_gap_of_its_points(cell):
    """Lines through the points themselves and between them."""
    shape = surface_shape(cell.wheel, bar(), LocalShape(37.5, 0.0), on_wheel(cell, turn=0.1), CONTACT)
    x, y = np.linspace(-0.012, 0.012, 61)[None], np.sort(np.append(np.linspace(-6e-3, 6e-3, 31), 1e-9))[:, None]
    gap = shape.gap(x, y)
    assert np.isfinite(gap).all()
    np.testing.assert_allclose(shape.gap(*np.broadcast_arrays(x, y)), gap, atol=1e-12)


def test_points_on_a_line_are_no_surface(cell):
    flat = bar()
    stray = np.column_stack([np.linspace(0, 2e-3, 6), np.full((6, 1), 0.5), np.zeros(6)])
    cloud = SurfaceCloud(np.vstack([flat.points, stray]), np.vstack([flat.normals, np.tile([0.0, 1.0, 0.0], (6, 1))]))
    assert len(cloud.surface.pieces) == len(flat.surface.pieces)
    nothing = surface_shape(cell.wheel, cloud, LocalShape(37.5, 0.0), on_wheel(cell), CONTACT + [0.0, 1.0, 0.0])
    assert np.isinf(nothing.gap(np.zeros(2), np.zeros(2))).all()


def test_without_a_cloud_the_shape_is_its_quadratic():
    from ocp.model.blade_gap import SurfaceShape

    x = np.linspace(-0.01, 0.01, 5)
    plain, real = LocalShape(30.0, 5.0, 2.0, 0.0, 0.01, -0.02), SurfaceShape(30.0, 5.0, 2.0, 0.0, 0.01, -0.02)
    np.testing.assert_array_equal(real.gap(x, 2 * x), plain.gap(x, 2 * x))


# -- contact elsewhere ---------------------------------------------------------------------------------------------


def deepest(cell, points, delta=2e-4, poses=None):
    T = np.stack([on_wheel(cell, delta=delta)] * 2) if poses is None else poses
    n = len(T)
    curvature = np.tile([1 / RADIUS + 1 / cell.wheel.radius, 0.0, 0.0], (n, 1))
    return find_secondary_contact(cell, points, T, np.tile(CONTACT, (n, 1)), curvature, np.zeros((n, 2)), np.full(n, delta))


def test_a_round_bar_touches_nowhere_else(cell):
    assert deepest(cell, bar(0.06).points).depth == 0.0


@pytest.mark.parametrize("angle", [-1.2, 1.0, 2.5])
def test_a_platform_in_the_wheel_is_found_with_depth_place_and_waypoint(cell, angle):
    free, deep = on_wheel(cell, delta=-0.5), on_wheel(cell, delta=2e-4)
    p = buried(cell, deep, 7e-4, angle)
    assert np.linalg.norm(p - CONTACT) > REACH
    found = deepest(cell, np.vstack([bar().points, p]), poses=np.stack([free, deep, free]))
    assert found.index == 1 and found.depth == pytest.approx(7e-4, abs=1e-9)
    assert found.distance == pytest.approx(cell.wheel.radius * abs(np.sin(angle)), rel=0.02)


def test_where_the_blade_s_frame_lies_does_not_matter(cell):
    """Its origin halfway between the contact and what is touched: products of the two are then as negative as they get."""
    T = on_wheel(cell, delta=2e-4)
    p = buried(cell, T, 7e-4, 1.0)
    origin, moved = 0.5 * (p + CONTACT), T.copy()
    moved[:3, 3] += T[:3, :3] @ origin
    curvature = np.array([[1 / RADIUS + 1 / cell.wheel.radius, 0.0, 0.0]])
    here = (p - origin)[None], moved[None], (CONTACT - origin)[None]
    found = find_secondary_contact(cell, *here, curvature, np.zeros((1, 2)), np.array([2e-4]))
    assert found.depth == pytest.approx(7e-4, abs=1e-9)


def test_beside_the_wheel_is_not_in_it_and_a_scratch_is_no_deepest(cell):
    T = on_wheel(cell, delta=2e-4)
    half = 0.5 * cell.wheel.width
    assert deepest(cell, buried(cell, T, 2e-3, 1.0, lateral=1.01 * half)[None]).depth == 0.0
    assert deepest(cell, buried(cell, T, 2e-3, 1.0, lateral=0.99 * half)[None]).depth == pytest.approx(2e-3, abs=1e-9)
    assert deepest(cell, buried(cell, T, 0.9 * SECONDARY_CONTACT_TOLERANCE, 1.0)[None]).depth == 0.0


def test_what_the_direct_contact_sees_is_left_to_it(cell):
    T = on_wheel(cell, delta=2e-4)
    p = buried(cell, T, 5e-4, 0.3)
    assert np.linalg.norm(p - CONTACT) < 0.9 * REACH
    assert deepest(cell, p[None]).depth == 0.0


def test_the_planned_overlap_is_taken_off_along_the_width_too(cell):
    """2 mm deep, of which the quadratic itself plans 3 - 1/2 100/m (6 mm)^2 = 1.2 mm."""
    T = on_wheel(cell, delta=3e-3)
    p = buried(cell, T, 2e-3, 1.0, lateral=6e-3)
    found = find_secondary_contact(
        cell, p[None], T[None], CONTACT[None], np.array([[0.0, 100.0, 0.0]]), np.zeros((1, 2)), np.array([3e-3])
    )
    assert found.depth == pytest.approx(0.8e-3, abs=1e-9)


@pytest.mark.parametrize(("angle", "lateral"), [(1.0, 6e-3), (-1.0, 6e-3), (1.0, -5e-3)])
def test_the_planned_overlap_is_that_of_the_tilted_and_twisted_quadratic_there(cell, angle, lateral):
    """2 mm deep, beside a contact 2 mm off the wheel's middle; on either side of it along the belt and along the axis."""
    wheel, T = cell.wheel, on_wheel(cell, delta=3e-3)
    T[:3, 3] += 2e-3 * wheel.axis
    p = buried(cell, T, 2e-3, angle, lateral)
    (kxx, kyy, kxy), (tx, ty) = (0.5, 30.0, 2.0), (4e-3, -0.03)
    x, y = (wheel.radius - 2e-3) * np.sin(angle), lateral - 2e-3
    planned = 1.5e-3 - tx * x - ty * y - 0.5 * (kxx * x**2 + 2 * kxy * x * y + kyy * y**2)
    shape = np.array([[kxx, kyy, kxy]]), np.array([[tx, ty]])
    found = find_secondary_contact(cell, p[None], T[None], CONTACT[None], *shape, np.array([1.5e-3]))
    assert planned > 3e-4 and found.depth == pytest.approx(2e-3 - planned, abs=1e-8) and found.depth > 3e-4
    assert (found.distance, found.lateral) == pytest.approx((np.hypot(x, y), lateral))


def test_just_beyond_what_the_direct_contact_sees_and_at_the_wheel_s_flank_a_touch_is_found(cell):
    T, half = on_wheel(cell, delta=2e-4), 0.5 * cell.wheel.width
    for seen in (0.89, 0.91):
        p = buried(cell, T, 5e-4, 2 * np.arcsin(0.5 * seen * REACH / (cell.wheel.radius - 3.5e-4)))
        assert np.linalg.norm(p - CONTACT) == pytest.approx(seen * REACH, rel=1e-3)
        assert deepest(cell, p[None]).depth == pytest.approx(0.0 if seen < 0.9 else 5e-4, abs=1e-9)
    assert deepest(cell, buried(cell, T, 1.5e-4, 1.0, lateral=0.95 * half)[None]).depth == pytest.approx(1.5e-4, abs=1e-9)


def test_of_several_waypoints_the_deepest_is_told_and_each_has_its_own(cell):
    deep = on_wheel(cell, delta=2e-4)
    poses = [deep.copy() for _ in range(3)]
    p = buried(cell, deep, 7e-4, 1.0)
    out = (cell.wheel.centre - deep[:3, :3] @ p - deep[:3, 3]) / (cell.wheel.radius - 7e-4)
    for pose, less in zip(poses, (3e-4, 0.0, 5e-4), strict=True):
        pose[:3, 3] -= less * out
    found = deepest(cell, p[None], poses=np.stack(poses))
    assert found.index == 1 and found.depth == pytest.approx(7e-4, abs=1e-8)
    assert found.depths == pytest.approx([4e-4, 7e-4, 2e-4], abs=1e-6)


def test_there_is_no_blade_in_the_bay_of_a_hollow_edge(cell):
    """Long triangles close the outline of the cloud; taken for surface they were false contact beside a blade's corner."""
    whole = bar()
    edge = 3e-3 + 40.0 * whole.points[:, 2] ** 2
    kept = whole.points[:, 0] <= edge
    cloud = SurfaceCloud(whole.points[kept], whole.normals[kept])
    base = LocalShape(kxx=1 / RADIUS + 1 / cell.wheel.radius, kyy=0.0)
    shape = surface_shape(cell.wheel, cloud, base, on_wheel(cell), CONTACT)
    across = np.array([-7e-3, -2e-3, 0.0, 2e-3, 7e-3])  # the blade's x lies along the wheel's axis, one way or the other
    gap = shape.gap(np.zeros(5), across)
    assert np.isfinite(gap[1:4]).all()
    assert sorted(np.isinf(gap[[0, 4]])) == [False, True]


def tube(outer=0.01, inner=0.006, length=0.1):
    """A square tube along z, open at both ends: corners (16, 3) m, facets (32, 3), which of them are walls of its bore."""
    ring = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    flat = np.vstack([outer * ring, inner * ring])
    corners = np.vstack([np.column_stack([flat, np.full(8, z)]) for z in (-0.5 * length, 0.5 * length)])
    quads, bore = [], []
    for k in range(4):
        m = (k + 1) % 4
        # Counter-clockwise seen from outside: outer wall, wall of the bore, upper and lower end.
        quads += [(k, m, m + 8, k + 8), (m + 4, k + 4, k + 12, m + 12), (k + 8, m + 8, m + 12, k + 12), (m, k, k + 4, m + 4)]
        bore += [False, True, False, False]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    return corners, faces, np.repeat(bore, 2)


def test_walls_of_a_bore_are_no_surface_that_a_wheel_touches():
    """They look at the wheel from below the wall that it bears on; taken for surface they were pits in it, 0.5 N of force."""
    corners, faces, bore = tube()
    np.testing.assert_array_equal(enclosed(corners, faces, np.arange(len(faces))), bore)
    short, faces, _ = tube(length=0.004)  # a frame rather than a tube: its inner walls are seen from both ends
    assert not enclosed(short, faces, np.arange(len(faces))).any()


def test_the_surface_of_a_cored_blade_is_its_outside(tmp_path):
    part = build(next(recipe for recipe in RECIPES if recipe.cuts == "cavity"))
    blade = read_blade(part.write(tmp_path), "mm")
    cloud = surface_cloud(find_shape(blade), blade)
    built = part.back(cloud.points)
    slab = built[np.abs(built[:, 2] - 25.0) < 2.0]
    # Over 2 mm of span the walls move by less than 0.3 mm; the cavity's stand 2 mm and more inside of them.
    off = cKDTree(section(part.recipe, 25.0, 400)[:, :2]).query(slab[:, :2])[0]
    assert len(slab) > 500 and off.max() < 0.5
