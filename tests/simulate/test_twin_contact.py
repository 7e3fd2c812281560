"""Contact of the virtual wheel: limits known in closed form, the planner's direct solution, the real surface, the tables."""

import pickle
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ellipe, ellipk

from ocp.contact.blade.elasticity import Material
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.cell import read_cell
from ocp.model.prepare import wheel_cover
from ocp.simulate.twin.contact.grinder import FAR_APART
from ocp.simulate.twin.contact.rubber import cover_section, make_rubber, press
from ocp.simulate.twin.contact.surface import facets, gap, near, postures, wheel_on_blade
from ocp.simulate.twin.contact.table import LATTICE, LEVELS, PlannedLines, SolvedStations, depth_curves, place_stations
from ocp.simulate.twin.contact.wheel_and_blade import solid_compliance
from tests.support.small_plan import small_cell
from tests.support.twin_grinding import BAR, FEED, HERTZ_RATE, Bench, moments
from trajectories.blade import Blade

Array = np.ndarray


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.47])
@pytest.mark.parametrize("kh", [0.5, 1.0, 3.0, 8.0])
def test_a_wide_flat_cover_is_the_bonded_layer_in_closed_form(poisson, kh):
    h, radius = 0.012, 100.0
    response = cover_section(radius, 0.24, h, poisson, 80).response(kh / h * radius).sum(axis=1)[40]
    mu, kappa = 0.5 / (1 + poisson), 3 - 4 * poisson
    layer = (1 - poisson) * h / (mu * kh) * (kappa * np.sinh(2 * kh) - 2 * kh)
    layer /= kappa * np.cosh(2 * kh) + 2 * kh**2 + 0.5 * (kappa**2 + 1)
    assert response == pytest.approx(layer, rel=3e-3)


def paraboloid(rubber, kxx: float, kyy: float) -> Array:
    grid = rubber.grid
    mean = grid.dx**2 / 12, grid.dy**2 / 12  # of x^2 over a cell
    return 0.5 * (kxx * (grid.x[:, None] ** 2 + mean[0]) + kyy * (grid.y[None, :] ** 2 + mean[1]))


def tessellated(size: float) -> Blade:
    """A cap of a ball of 60 mm about -z, looking up, in triangles of about `size` m."""
    at = np.arange(-0.02, 0.02 + size / 2, size)
    x, y = (v.ravel() for v in np.meshgrid(at, at, indexing="ij"))
    k = np.arange(len(x)).reshape(len(at), len(at))
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    return Blade(
        "cap",
        "",
        np.column_stack([x, y, np.sqrt(0.06**2 - x**2 - y**2)]),
        np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])]),
    )


def test_triangles_are_chords_of_a_smooth_blade():
    """A wheel on a ball: closed form; plain triangles would lie 2 mm * 2 mm / (8 R) = 8 um low between corners."""
    cells, radius = np.arange(-0.006, 0.0061, 4e-4), 0.04
    frame = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])  # rows x, axis, e: the wheel stands over the ball
    found = gap(facets(tessellated(2e-3)), frame, np.array([0, 0, 0.06 + radius]), radius, cells, cells, 4e-4, 4e-4)
    sine, cosine = np.sin(cells / radius)[:, None], np.cos(cells / radius)[:, None]
    far = 0.06 + radius  # middle of the ball from the wheel's axis; the ray's first meeting with it
    true = far * cosine - np.sqrt(0.06**2 - cells[None] ** 2 - (far * sine) ** 2) - radius
    assert np.abs(found - true).max() < 1e-6
    corner = facets(replace(tessellated(2e-3), vertices=tessellated(2e-3).vertices * [1, 1, 0] + [0, 0, 0.06]))
    assert not corner.bulge.any()  # a plane stays one


def test_an_edge_stays_an_edge():
    """The faces of a box meet at right angles: nothing bulges."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]) * 0.01
    sides = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    faces = np.array([part for a, b, c, d in sides for part in ((a, b, c), (a, c, d))])
    assert np.abs(facets(Blade("box", "", corners, faces)).bulge).max() < 1e-15


@pytest.mark.parametrize("ratio", [0.999, 0.5])
def test_a_thick_cover_is_hertz(ratio):
    """Semi-axes a, b = ratio a along and across the belt on a cover 16 a thick; Johnson 1985, section 4.2."""
    rubber = make_rubber(0.3, 0.064, 0.08, 0.3, 0.0016, 0.0105)
    a, b, plane, m = 0.005, ratio * 0.005, 1 / (1 - 0.3**2), 1 - ratio**2
    peak = 0.05  # of the modulus
    kxx = 2 * peak * b / (plane * a**2 * m) * (ellipk(m) - ellipe(m))
    kyy = 2 * peak * b / (plane * a**2 * m) * ((a / b) ** 2 * ellipe(m) - ellipk(m))
    load = 2 / 3 * np.pi * a * b * peak
    found = press(rubber, paraboloid(rubber, kxx, kyy)[:, :, None], np.array([load]))
    x, y = rubber.grid.x[:, None], rubber.grid.y[None, :]
    share = found.forces[:, :, 0] / found.forces.sum()
    own = np.array([rubber.grid.dx, rubber.grid.dy]) ** 2 / 12
    axes = np.sqrt(5 * (np.array([(share * x**2).sum(), (share * y**2).sum()]) + own))
    assert found.approach[0] == pytest.approx(peak * b / plane * ellipk(m), rel=0.035)
    assert axes == pytest.approx([a, b], rel=0.05)
    assert found.residual[0] < 1e-3


def test_a_thin_compressible_cover_is_a_bed_of_springs():
    h, poisson, k, d = 1e-3, 0.2, 20.0, 6.4e-4
    rubber = make_rubber(0.1, 0.024, h, poisson, 8e-4, 0.0104)
    bed = (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson)) / h
    load = np.pi * bed * d**2 / k
    assert press(rubber, paraboloid(rubber, k, k)[:, :, None], np.array([load])).approach[0] == pytest.approx(d, rel=0.03)


@pytest.mark.parametrize("kyy", [-8.0, 0.0, 20.0, 45.0])
def test_the_planners_direct_contact_is_met(kyy, bench):
    cell = bench.cell
    tables = bench.grinder().tables
    cover = wheel_cover(cell)
    force = np.array([5.0, 20.0, 60.0])
    gaps = np.repeat(paraboloid(tables.rubber, 27.0, kyy)[:, :, None], 3, axis=2)
    found = press(tables.rubber, gaps, force / cell.wheel.cover_modulus)
    planner = [solve_force(cover, F, LocalShape(27.0, kyy)).indentation for F in force]
    # The planner moves the wheel into the blade by the same depth everywhere, here the depth falls with the wheel's angle.
    assert found.approach[:2] == pytest.approx(planner[:2], rel=0.012)
    assert found.approach[2] == pytest.approx(planner[2], rel=0.025)
    assert (found.forces >= 0).all()
    assert found.forces.sum(axis=(0, 1)) == pytest.approx(force / cell.wheel.cover_modulus, rel=2e-6)


def test_the_contact_conditions_hold_from_any_start(bench):
    """A rough surface, begun from a single cell: no pressure pulls, nothing overlaps, the gap is closed where pressure is."""
    rubber = bench.grinder().tables.rubber
    rng = np.random.default_rng(8)
    rough = paraboloid(rubber, 27.0, 5.0) + 4e-5 * rng.normal(size=(len(rubber.grid.x), len(rubber.grid.y)))
    rough[:, -3:] = np.inf
    start = np.zeros((*rough.shape, 1))
    start[len(rough) // 2, 4] = 1.0
    load = np.array([20.0 / bench.cell.wheel.cover_modulus])
    found = press(rubber, rough[:, :, None], load, start)
    other = press(rubber, rough[:, :, None], load)
    cosine = rubber.cosine[:, None]
    d, f = found.approach[0], found.forces[:, :, 0]
    opening = rubber.displace(found.forces / cosine[:, :, None])[:, :, 0] / cosine + rough / cosine - d
    assert np.abs(opening[f > 0]).max() < 2e-3 * d and opening[f == 0].min() > -2e-3 * d
    assert (f[:, -3:] == 0).all() and (f > 0).sum() > 40
    assert d == pytest.approx(other.approach[0], rel=2e-4)


def test_an_endless_layer_would_not_do(bench):
    """Side faces are free: with a cover four times as wide the same contact is a fifth stiffer, 6 N on a rigid mount."""
    own = bench.grinder().tables.rubber
    wide = make_rubber(own.radius, 4 * own.width, own.thickness, bench.cell.wheel.cover_poisson, own.grid.dx, 0.0135)
    load = np.array([20.0 / bench.cell.wheel.cover_modulus])
    on_wide = np.where(np.abs(wide.grid.y) < 0.5 * own.width, paraboloid(wide, 27.0, 0.0), np.inf)
    narrow = press(own, paraboloid(own, 27.0, 0.0)[:, :, None], load).approach[0]
    assert press(wide, on_wide[:, :, None], load).approach[0] < 0.8 * narrow


def test_the_surface_over_the_wheel_is_the_bars(bench):
    surface = bench.grinder().tables.surface
    p, n, t = np.array([0.0, BAR, 0.05]), np.array([0.0, 1, 0]), np.array([0.0, 0, 1])
    x, y = np.linspace(-0.008, 0.008, 9), np.linspace(-0.006, 0.006, 7)
    frame, middle = wheel_on_blade(p, n, t, np.array([0.001, 0.002, 0.0, 0.3]), 0.04)
    got = gap(near(surface, p, 0.03), frame, middle, 0.04, x, y, 1e-6, 1e-6)
    # Points of the bar: one is found by walking out along each ray.
    for i, j in np.ndindex(got.shape):
        ray = np.cos(x[i] / 0.04) * frame[2] + np.sin(x[i] / 0.04) * frame[0]
        start = middle + y[j] * frame[1]
        a, b, c = ray[:2] @ ray[:2], start[:2] @ ray[:2], start[:2] @ start[:2] - BAR**2
        assert got[i, j] == pytest.approx((-b - np.sqrt(b**2 - a * c)) / a - 0.04, abs=3e-6)


def test_the_blade_ends_at_its_tip(bench):
    surface = bench.grinder().tables.surface
    p, n, t = np.array([0.0, BAR, 0.117]), np.array([0.0, 1, 0]), np.array([0.0, 0, 1])
    x, y = np.linspace(-0.009, 0.009, 19), np.array([0.0])
    frame, middle = wheel_on_blade(p, n, t, np.zeros(4), 0.04)
    there = np.isfinite(gap(near(surface, p, 0.03), frame, middle, 0.04, x, y, 1e-4, 1e-4)[:, 0])
    assert (there == (0.04 * np.tan(x / 0.04) < 0.003)).all()


def test_a_posture_is_told_and_built_alike():
    rng = np.random.default_rng(3)
    for _ in range(20):
        n = np.array([0.0, 0, 1])
        p, t = rng.normal(size=3), np.array([np.cos(0.4), np.sin(0.4), 0])
        shape = rng.normal(size=4) * [2e-3, 3e-3, 0.03, 1.0]
        frame, middle = wheel_on_blade(p, n, t, shape, 0.04)
        assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-12) and np.linalg.det(frame) == pytest.approx(1)
        sunk = middle + 5e-4 * frame[2]  # the wheel half a millimetre deeper in the blade
        found = postures(np.eye(4)[None], p[None], n[None], t[None], sunk[None], frame[1][None], np.array([0.04]))
        assert found.shape[0] == pytest.approx(shape, abs=1e-12)
        assert found.depth[0] == pytest.approx(5e-4, abs=1e-12)
        radial = p - sunk - frame[1] * ((p - sunk) @ frame[1])
        assert found.overlap[0] == pytest.approx(0.04 - np.linalg.norm(radial), abs=1e-12)


def test_stations_on_known_lines_do_not_depend_on_where_the_instants_lie(bench):
    fine = moments(bench.cell, np.arange(0, 0.03, 1e-3), 5e-4)
    lines = PlannedLines(fine.line, fine.s, fine.p, fine.n, fine.t)
    own = place_stations(fine, np.arange(len(fine.s)), fine.s)
    for places in (np.arange(1e-3, 0.029, 4e-3), np.array([2.2e-3, 0.0171])):
        few = moments(bench.cell, places, 5e-4)
        found = place_stations(few, np.arange(len(places)), places, lines)
        assert np.array_equal(found.p, own.p) and np.array_equal(found.s, own.s)
        between = (1.0 - found.share) * own.s[found.left] + found.share * own.s[found.right]
        assert between == pytest.approx(places, abs=1e-9)


def test_curves_off_the_lattice_are_the_direct_solution(bench):
    tables = bench.grinder().tables
    c = moments(bench.cell, np.arange(0, 0.03, 1e-4), 5e-4)
    rows, k = np.arange(len(c.s)), 120
    whole = np.array([0.8e-3, 0.4e-3, 4e-3, 8e-3])
    node = np.round(np.array([0.0, 1e-3, 0.01, 0.4]) / LATTICE) * LATTICE
    grid = tables.rubber.grid

    def both(off: Array) -> tuple[Array, Array]:
        depth, _ = depth_curves(tables, place_stations(c, rows, c.s), np.tile(node + off, (len(rows), 1)))
        frame, middle = wheel_on_blade(c.p[k], c.n[k], c.t[k], node + off, tables.rubber.radius)
        here = gap(near(tables.surface, c.p[k], 0.03), frame, middle, tables.rubber.radius, grid.x, grid.y, grid.dx, grid.dy)
        direct = press(tables.rubber, np.repeat(here[:, :, None], len(LEVELS) - 1, axis=2), LEVELS[1:] * tables.load).approach
        return depth[k, 2:7], direct[1:6]

    error = {}
    for name, mask in (("all", [1, 1, 1, 1]), ("along", [1, 0, 0, 0]), ("across", [0, 1, 0, 0]), ("both", [1, 1, 0, 0])):
        depth, direct = both(whole * mask)
        error[name] = depth - direct
        assert depth == pytest.approx(direct, abs=3e-6), name
    assert np.abs(both(whole)[1] - both(0 * whole)[1]).max() > 1e-5
    # What along and across do together, 1.6 um here, is known besides.
    assert error["both"] == pytest.approx(error["along"] + error["across"], abs=6e-7)


def test_a_store_filled_by_another_machine_changes_nothing(bench):
    c = moments(bench.cell, np.arange(0, 0.02, FEED / HERTZ_RATE), 5e-4)
    shifted = {"wheel_shift": np.array([1e-4, 4e-4, 3e-4]), "cover_scale": 1.1}
    alone = Bench().force(c, **shifted).force
    shared = Bench()
    shared.force(replace(c, p=c.p), wheel_shift=np.array([-1e-4, -2e-4, 0]))
    assert shared.force(c, **shifted).force == pytest.approx(alone, abs=1e-4)
    kept = pickle.loads(pickle.dumps(replace(shared.tables)))
    count = len(kept.nodes)
    fresh = Bench()
    fresh.tables = kept
    assert fresh.force(c, **shifted).force == pytest.approx(alone, abs=1e-4) and len(kept.nodes) == count


def test_a_second_machine_on_the_same_path_costs_little(bench):
    c = moments(bench.cell, np.arange(0, 0.08, FEED / HERTZ_RATE), 5e-4)
    bench.force(c)
    start = time.process_time()
    bench.force(c, cover_scale=0.9, flange_scale=1.1)
    assert len(c.s) / HERTZ_RATE > 20 * (time.process_time() - start)


def test_the_solid_gives_as_a_cantilever(tmp_path):
    """A square bar 10 x 10 x 80 mm held below 10 mm: L^3 / 3 E I, shear besides."""
    import trimesh

    box = trimesh.creation.box((0.01, 0.01, 0.08))
    box.apply_translation([0, 0, 0.04])
    piece = read_cell(small_cell(tmp_path, blade=True)).workpiece
    material = Material(piece.youngs_modulus, piece.poisson, piece.density)
    z = np.array([0.04, 0.06, 0.07])
    p = np.column_stack([np.zeros(3), np.full(3, 0.005), z])
    n, t = np.tile([0.0, 1, 0], (3, 1)), np.tile([0.0, 0, 1], (3, 1))
    none = np.zeros(3, int)
    stations = SolvedStations(np.ones(3, int), z, p, n, t, none, none, np.zeros(3))
    got = solid_compliance(piece, Blade("box", "box", box.vertices, box.faces), stations, (0.003, 0.003))
    lever, inertia = z - 0.01, 0.01**4 / 12
    beam = lever**3 / (3 * material.youngs_modulus * inertia)
    beam += lever * 2 * (1 + material.poisson_ratio) * 1.2 / (material.youngs_modulus * 1e-4)
    assert got[:, 0] == pytest.approx(beam, rel=0.05)


def test_bodies_apart_carry_nothing(bench):
    s = np.arange(0, 0.02, 4e-4)
    apart = bench.force(moments(bench.cell, s, -4.2e-3))
    assert (apart.force == 0).all() and (apart.tangential == 0).all()
    rigid = Bench(flange=False)
    assert (rigid.force(moments(rigid.cell, s, -1e-6)).force == 0).all()
    assert (rigid.force(moments(rigid.cell, s, 2e-5)).force > 0).all()
    lost = rigid.force(moments(rigid.cell, s, np.where(s > 0.01, -1e-4, 5e-4)))
    assert ((lost.force > 0) == (s <= 0.01)).all()


def test_a_place_that_is_not_before_the_wheel_is_far_apart(bench):
    """Through the wheel the place lies behind its axis, where "inside its radius" is no overlap; beside it nothing is pressed."""
    grinder = bench.grinder()
    overlap = grinder.depth(moments(bench.cell, np.arange(0, 0.02, 4e-4), 5e-4))
    assert overlap == pytest.approx(np.full(50, 5e-4), abs=2e-5)
    aside, through = moments(bench.cell, np.arange(0, 0.02, 4e-4), 5e-4), moments(bench.cell, np.arange(0, 0.02, 4e-4), 5e-4)
    wheel = bench.cell.wheel
    aside.T_base_flange[:, :3, 3] += 1.5 * wheel.width * wheel.axis
    through.T_base_flange[:, :3, 3] -= 1.5 * wheel.radius * wheel.contact_direction
    for moved in (aside, through):
        assert (grinder.depth(moved) == -FAR_APART).all()


def test_an_air_run_has_no_force(bench):
    c = moments(bench.cell, np.arange(0, 0.02, 4e-4), 5e-4)
    c = replace(c, contact=np.zeros(len(c.s), bool), p=np.full((len(c.s), 3), np.nan), s=np.full(len(c.s), np.nan))
    result = bench.force(c)
    assert (result.force == 0).all() and np.isnan(result.overlap).all()
