import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from robots.errors import BadInput
from robots.pose import rotation_from_abc
from tests.support import blade_samples
from trajectories.blade import Blade, find_shape, read_blade
from trajectories.blade.window import GAP, free_stretch, obstacles
from trajectories.passes import FELT, MIN_WAYPOINTS, PassOptions, felt_along, passes, reversed_path

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def sample():
    blade = Blade("sample", "", *blade_samples.blade_mesh(100, 30))
    return blade, find_shape(blade)


@pytest.fixture(scope="module")
def bundled():
    blade = read_blade(ROOT / "ocp" / "data" / "blade.stl")
    return blade, find_shape(blade)


def length(x):
    return np.linalg.norm(x, axis=-1)


@pytest.mark.parametrize("direction", ["spanwise", "chordwise"])
def test_frames_margins_and_spacing(sample, direction):
    options = PassOptions(direction=direction, feed=0.03, force=15.0)
    paths, notices = passes(*sample, options)
    assert notices == [] and [path.line for path in paths] == list(range(1, len(paths) + 1))
    assert {path.side for path in paths} == {"convex", "concave"}
    for path in paths:
        assert len(path.p) >= MIN_WAYPOINTS
        np.testing.assert_allclose(length(path.n), 1.0, atol=1e-12)
        np.testing.assert_allclose(length(path.t), 1.0, atol=1e-12)
        np.testing.assert_allclose(np.sum(path.n * path.t, axis=1), 0.0, atol=1e-12)
        steps = length(np.diff(path.p, axis=0))
        assert steps.max() < 1e-3 * 1.001 and np.ptp(steps) < 0.02 * steps.mean()  # even
        np.testing.assert_allclose(np.diff(path.s), steps, rtol=0.01)
        along = np.diff(path.p, axis=0) / steps[:, None]
        assert np.sum(along * path.t[:-1], axis=1).min() > 0.999  # t is the way of travel
        assert (path.p[:, 2] > 0.0149).all() and (path.p[:, 2] < 0.0955).all()
        assert (path.feed == 0.03).all() and (path.force == 15.0).all()
    if direction == "spanwise":
        assert all(path.t[:, 2].min() > 0.9 for path in paths)  # root to tip
    for side in ("convex", "concave"):
        mine = [path for path in paths if path.side == side]
        gaps = [length(b.p[::5, None] - a.p[None]).min(axis=1) for a, b in pairwise(mine)]
        assert 0.5 * options.spacing < min(g.min() for g in gaps) and max(g.max() for g in gaps) < 1.01 * options.spacing


@pytest.mark.parametrize("direction", ["spanwise", "chordwise"])
@pytest.mark.parametrize("clamp", [{}, {"clamp_offset": 0.09, "clamp_side": "above"}])
def test_lines_lie_nearer_where_it_is_asked(sample, direction, clamp):
    """2 mm at the first line, 6 mm at the last, in the order of the lines whichever end is clamped."""
    spread = {"convex": (np.array([0.0, 1.0]), np.array([2e-3, 6e-3]))}
    options = PassOptions(direction=direction, side="convex", spread=spread, step=2e-3, **clamp)
    paths = passes(*sample, options)[0]
    gaps = [length(b.p[:, None] - a.p[None]).min(axis=1).max() for a, b in pairwise(paths)]
    assert (np.diff(gaps) > -2e-4).all()
    assert 1.5e-3 < gaps[0] < 2.6e-3 and 4.5e-3 < gaps[-1] < 6.05e-3
    assert len(passes(*sample, replace(options, spread={}))[0]) < len(paths)


def test_the_edge_margin_is_measured_on_the_surface(sample):
    blade, shape = sample
    for margin in (3e-3, 6e-3):
        paths, _ = passes(blade, shape, PassOptions(edge_margin=margin, side="convex"))
        for path, phi0 in ((paths[0], np.pi), (paths[-1], 0.0)):
            k = len(path.p) // 2
            z = path.p[k, 2]
            fine = np.linspace(phi0, 0.5 * np.pi, 4000)
            wall = blade_samples.blade_point(fine, np.full(len(fine), z))
            near = int(np.argmin(length(wall - path.p[k])))
            assert length(np.diff(wall[: near + 1], axis=0)).sum() == pytest.approx(margin, abs=0.3e-3)


def test_extent_against_the_outline(sample):
    paths, _ = passes(*sample, PassOptions(side="convex", edge_margin=5e-3))
    for path, to_edge in ((paths[0], 5e-3), (paths[-1], 5e-3)):
        k = len(path.p) // 2
        # Half of a round edge lies beyond 60 deg, so the extent is a little less than the way to the nose.
        assert 0.75 * to_edge < path.extent[k].min() < 1.02 * to_edge
        np.testing.assert_allclose(path.extent[k, 0], 0.1 - path.p[k, 2], rtol=0.05)
        np.testing.assert_allclose(path.extent[k, 1], path.p[k, 2], rtol=0.05)
        across = path.extent[:, 2] + path.extent[:, 3]
        assert 0.7 * 0.05 < across.min() and across.max() < 1.1 * 0.05


def test_reversing_twice_changes_nothing_and_once_keeps_it_right_handed(sample):
    path = passes(*sample, PassOptions(side="concave"))[0][2]
    back = reversed_path(path)
    np.testing.assert_allclose(back.curvature[::-1], path.curvature)
    np.testing.assert_allclose(back.extent[::-1][:, [1, 0, 3, 2]], path.extent)
    assert back.s[0] == 0.0 and (np.diff(back.s) > 0).all()
    assert (np.sum(np.diff(back.p, axis=0) * back.t[:-1], axis=1) > 0.0).all()  # t is the way of travel
    again = reversed_path(back)
    for name in ("p", "n", "t", "s", "curvature", "extent"):
        np.testing.assert_allclose(getattr(again, name), getattr(path, name), atol=1e-15)


def test_the_reversed_pass_has_the_curvature_of_its_own_frame(sample):
    from trajectories.blade.spline import curvature_in_frame
    from trajectories.path_points import foot_parameters

    _, shape = sample
    path = reversed_path(passes(*sample, PassOptions(side="convex"))[0][3])
    side = shape.sides["convex"]
    u, v = foot_parameters(side, shape, path.p)
    own = felt_along(path.s, curvature_in_frame(side.surface, u, v, path.n, path.t))
    np.testing.assert_allclose(own, path.curvature, rtol=1e-6, atol=1e-6)


@given(st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3))
@settings(max_examples=4, deadline=None, phases=[Phase.explicit, Phase.generate])
def test_passes_move_with_blade_and_clamp(angles):
    vertices, faces = blade_samples.blade_mesh(60, 20)
    options = PassOptions(spacing=15e-3, step=4e-3)
    R, shift = rotation_from_abc(angles), np.array([0.3, -0.2, 0.5])
    still = Blade("still", "", vertices, faces)
    moved = Blade("moved", "", vertices @ R.T + shift, faces)
    turned = replace(options, clamp_normal=tuple(R[:, 2]), clamp_offset=float(0.010 + R[:, 2] @ shift))
    first, _ = passes(still, find_shape(still), options)
    second, _ = passes(moved, find_shape(moved), turned)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(b.p, a.p @ R.T + shift, atol=1e-8)
        np.testing.assert_allclose(b.t, a.t @ R.T, atol=1e-5)
        np.testing.assert_allclose(b.curvature, a.curvature, atol=1e-3)


def test_a_blade_held_at_its_tip_is_ground_the_other_way(sample):
    options = PassOptions(clamp_offset=0.09, clamp_side="above")
    paths, _ = passes(*sample, options)
    for path in paths:
        assert path.t[:, 2].max() < -0.9
        assert path.p[0, 2] == pytest.approx(0.085, abs=1e-4) and path.p[-1, 2] == pytest.approx(0.005, abs=3e-4)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"clamp_offset": -0.001}, "holds nothing"),
        ({"clamp_offset": 0.2}, "holds everything"),
        ({"clamp_offset": 0.2, "clamp_side": "above"}, "holds nothing"),
        ({"root_margin": 0.09}, "leave nothing"),
        ({"tip_margin": 0.2}, "leave nothing"),
        ({"edge_margin": 0.026}, "edge_margin_mm = 26"),
        ({"side": "left"}, "'convex'"),
        ({"direction": "diagonal"}, "'spanwise' or 'chordwise'"),
        ({"spacing": 0.0}, "pass_spacing_mm = 0"),
        ({"clamp_normal": (1.0, 0.0, 0.0), "clamp_offset": 0.02}, "the clamp plane stands along the blade, not across it"),
        ({"clamp_normal": (0.0, 0.0, 0.0)}, "clamp_normal"),
    ],
)
def test_impossible_wishes_are_refused(sample, change, said):
    with pytest.raises(BadInput, match=said):
        passes(*sample, replace(PassOptions(), **change))


def test_only_the_aerofoil_is_ground(bundled):
    for direction in ("spanwise", "chordwise"):
        paths, _ = passes(*bundled, PassOptions(direction=direction, root_margin=0.0))
        assert min(path.p[:, 2].min() for path in paths) > 0.0225  # block to 20 mm, fillet to 23


@pytest.mark.parametrize("direction", ["spanwise", "chordwise"])
def test_the_wheel_keeps_off_the_block(bundled, direction):
    blade, shape = bundled
    radius, width = 0.05, 0.02
    options = PassOptions(direction=direction, wheel_radius=radius, wheel_width=width, step=3e-3)
    paths, notices = passes(blade, shape, options)
    assert len(notices) == 2 and "because the wheel would touch" in notices[0]
    assert all(0.0 not in map(float, re.findall(r"[\d.]+\d|\d", told)) for told in notices)  # what did not happen is not told
    for told, side in zip(notices, ("convex", "concave"), strict=True):
        laid, left = re.search(r"Of (\d+) passes", told), re.search(r"(\d+) were left out", told)
        assert laid and side in told
        assert int(laid[1]) - (int(left[1]) if left else 0) == sum(path.side == side for path in paths)
    x, y = (np.array(side) for side in ((-0.0275, 0.0275), (-0.0065, 0.008)))
    rim = np.concatenate([np.stack([np.linspace(*x, 200), np.full(200, edge), np.full(200, 0.02)], axis=1) for edge in y])
    for path in paths:
        for p, n, t in zip(path.p, path.n, path.t, strict=True):
            b = np.cross(n, t)
            r = rim - (p + radius * n)
            lateral = r @ b
            near = np.abs(lateral) < width / 2
            assert (length(r[near] - lateral[near, None] * b) > radius).all()
    close, _ = passes(blade, shape, PassOptions(direction=direction, step=3e-3))
    assert min(path.p[:, 2].min() for path in close) < min(path.p[:, 2].min() for path in paths) - 5e-3


def test_overhang_is_counted(sample):
    _, notices = passes(*sample, PassOptions(side="convex", pad_radius=4e-3))
    assert "waypoints lie closer than 4.0 mm" in notices[0]


def test_the_wheel_keeps_its_gap_from_the_root_where_there_is_room(bundled):
    """Distances from the wheel's axis by cross products, point by point."""
    blade, shape = bundled
    side, points, radius, width = shape.sides["convex"], obstacles(blade, shape), 0.15, 0.04
    u, v = np.full(200, 0.5), np.linspace(*shape.v, 200)

    def hit(us, vs):
        p, n = side.surface(us, vs), side.normal(us, vs)
        t = np.gradient(p, axis=0)
        for centre, axis in zip(p + radius * n, np.cross(n, t / length(t)[:, None]), strict=True):
            axis, off = axis / length(axis), points - centre
            yield bool(((np.abs(off @ axis) < width / 2 + GAP) & (length(np.cross(off, axis)) < radius + GAP)).any())

    _, vs = free_stretch(side, points, u, v, radius, width)
    assert len(points) > 1000 and shape.v[0] < vs[0] < vs[-1]  # the root takes some of it
    every = np.linspace(*shape.v, 121)
    blocked = np.array(list(hit(np.full(121, 0.5), every)))
    inside = (every > vs[0] - 1e-9) & (every < vs[-1] + 1e-9)
    assert not blocked[inside].any() and blocked[every < vs[0] - 1e-9].any()
    assert free_stretch(side, points, u, v, 1.0, 1.0) is None


def test_a_wheel_feels_the_mean_curvature_of_facets_and_a_smooth_one_as_it_is():
    s = np.sort(np.append(np.linspace(0.0, 0.09, 180), [0.0201, 0.0409]))
    smooth = np.column_stack([5.0 + 40.0 * s, -3.0 * s, np.full(len(s), 2.0)])
    assert felt_along(s, smooth) == pytest.approx(smooth, abs=1e-9)
    facets = np.where(np.arange(len(s)) % 3 == 0, 30.0, 0.0)[:, None] * [1.0, 0.5, -0.2]  # a crease every 1.5 mm
    felt = felt_along(s, smooth + facets)
    inside = (s > FELT) & (s < s[-1] - FELT)
    assert np.ptp((felt - smooth)[inside, 0]) < 0.35 * 30.0
    bowl = np.column_stack([1e5 * (s - 0.045) ** 2] * 3)
    assert (felt_along(s, bowl) - bowl)[inside] == pytest.approx(1e5 * FELT**2 / 3.0, rel=0.1)
    close = np.sort(np.append(s, s[90] + 2e-6))
    step = np.repeat(np.where(close > s[90], 10.0, 0.0)[:, None], 3, axis=1)
    assert -1e-9 <= felt_along(close, step).min() and felt_along(close, step).max() <= 10.0 + 1e-9
