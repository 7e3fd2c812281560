"""Distances between the bodies of a cell: against closed forms, differences, and postures that must fail."""

import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest

from ocp.plan.clearance import BASE_PLANE, Clearance, CollisionScene
from ocp.plan.rules import ARM_MARGIN, BLADE_MARGIN, FLOOR_BELOW_WHEEL, HOLDER_RADIUS, HOLDER_SHARE
from robots.errors import BadInput
from robots.inverse import inverse_branches
from robots.kinematics import forward
from robots.pose import apply, rotation_from_abc
from tests.support.block_blade import BLOCK, blade_before_wheel, joints_of
from tests.support.example_pass import bundled_cell, with_floor

HOME = np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0])


@pytest.fixture(scope="module")
def cell():
    return bundled_cell()


@pytest.fixture(scope="module")
def scene(cell):
    return CollisionScene(cell, BLOCK)


@pytest.mark.parametrize(
    "flat", [np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 1.0, 0.0]), np.array([[1, 0, 0], [0, 1, 0], [1, -2, 0]])]
)
def test_a_blade_without_a_volume_is_refused_before_a_library_ends_the_process(cell, flat):
    with pytest.raises(BadInput, match="the blade's points lie in a plane; give a solid"):
        CollisionScene(cell, BLOCK @ flat + [0.1, 0.2, 0.3])


def test_a_sheet_as_rough_as_the_numbers_of_a_file_is_no_blade(cell):
    """A slanted one in single precision is some nanometres thick."""
    rng = np.random.default_rng(3)
    sheet = rng.uniform(-0.5, 0.5, (3000, 3)) * [0.2, 0.06, 0.0] @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    with pytest.raises(BadInput, match="lie in a plane"):
        CollisionScene(cell, sheet.astype(np.float32).astype(float))


def test_flange_pose_turns_the_holder_back(cell):
    T = blade_before_wheel(cell, 0.05)
    q = joints_of(cell, T)
    assert len(q) > 0
    np.testing.assert_allclose(forward(cell.robot, q) @ cell.workpiece.T_flange_blade, np.tile(T, (len(q), 1, 1)), atol=1e-9)


@pytest.mark.parametrize("gap", [0.001, 0.004, 0.010])
def test_blade_to_wheel_is_the_gap_of_the_pose(cell, scene, gap):
    """A plane 40 mm wide before a cylinder: the distance is the gap at the contact direction, whatever the posture."""
    for q in joints_of(cell, blade_before_wheel(cell, gap)):
        values, names = scene.clearances(q[None], in_contact=False)
        if names[0] == ("blade", "wheel"):
            assert values[0] == pytest.approx(gap - BLADE_MARGIN, abs=1e-6)
            break
    else:
        pytest.fail("no posture in which blade and wheel are the closest pair")


def test_a_scene_in_another_process_has_the_same_distances(cell, scene):
    q = joints_of(cell, blade_before_wheel(cell, 0.004))
    values, names = pickle.loads(pickle.dumps(scene)).clearances(q, in_contact=False)
    here, named = scene.clearances(q, in_contact=False)
    assert (values == here).all() and names == named


def test_contact_leaves_the_pair_to_the_contact_model(cell, scene):
    q = joints_of(cell, blade_before_wheel(cell, -0.0005))
    off, off_names = scene.clearances(q, in_contact=False)
    on, on_names = scene.clearances(q, in_contact=True)
    free = on > 0.01
    assert free.any()
    assert all(off_names[k] == ("blade", "wheel") and off[k] < 0 for k in np.flatnonzero(free))
    assert all(set(pair) != {"blade", "wheel"} for pair in on_names)
    assert (on >= off - 1e-12).all()


def test_the_plane_of_the_base_is_as_far_as_the_lowest_point_of_a_capsule(cell, scene):
    """The arm stretched down beside the base: the lowest capsule over that plane, from link frames alone."""
    from robots.kinematics import link_frames

    found = 0
    for a2, a3, a5 in itertools.product(range(-60, 0, 5), range(20, 140, 10), (-90, -45, 0, 45, 90)):
        q = np.radians([0.0, a2, a3, 0.0, a5, 0.0])
        if (q < cell.robot.q_min).any() or (q > cell.robot.q_max).any():
            continue
        values, names = scene.clearances(q[None], in_contact=False)
        if names[0][1] != BASE_PLANE or names[0][0] in ("blade", "holder") or values[0] < 0:
            continue
        frames = link_frames(cell.robot, q[None])[0]
        lowest = min(
            (frames[link] @ [*end, 1.0])[2] - radius
            for link, p0, p1, radius in cell.robot.link_shapes
            if link >= 2
            for end in (p0, p1)
        )
        assert values[0] == pytest.approx(lowest - ARM_MARGIN, abs=1e-5)
        found += 1
    assert found > 3


@pytest.mark.parametrize("held", [True, False])
def test_the_holder_is_a_rod_half_way_from_the_flange_to_the_middle_of_what_is_clamped(cell, held):
    """Of all of the blade, where nothing of it is clamped."""
    n, offset, T = cell.workpiece.clamp_normal, cell.workpiece.clamp_offset, cell.workpiece.T_flange_blade
    cube = 0.004 * (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5)
    aside = np.linalg.svd(n[None])[2][1]
    free, clamped = cube + (offset + 0.08) * n + 0.1 * aside, cube + (offset - 0.005) * n - 0.03 * aside
    root = apply(T, clamped if held else free).mean(axis=0)
    whole = np.vstack([free, clamped]) if held else free
    (rod,) = (body for body in CollisionScene(cell, whole)._bodies if body.name == "holder")
    length = HOLDER_SHARE * np.linalg.norm(root)
    np.testing.assert_allclose(rod.placement[:3, 3], 0.5 * HOLDER_SHARE * root, atol=1e-12)
    np.testing.assert_allclose(length * rod.placement[:3, 2], HOLDER_SHARE * root, atol=1e-12)
    assert rod.frame == 6 and rod.shape.radius == HOLDER_RADIUS
    assert 2 * rod.shape.halfLength == pytest.approx(length - HOLDER_RADIUS)


@pytest.mark.parametrize("height", [1.0, 0.05])
def test_below_a_wheel_that_hangs_lower_than_the_base_the_plane_kept_free_is_lower_too(cell, height):
    low = replace(cell, wheel=replace(cell.wheel, centre=np.array([1.5, 0.0, height])))
    (plane,) = (body for body in CollisionScene(low, BLOCK)._bodies if body.name == BASE_PLANE)
    assert plane.shape.d == pytest.approx(min(0.0, height - low.wheel.radius - FLOOR_BELOW_WHEEL))
    assert (plane.shape.d < -0.03) == (height < 0.5)


def test_who_is_kept_apart_from_whom_and_by_how_much(cell):
    """Bodies next to each other on the arm meet at their joint; nothing of the arm is let near the wheel, in contact or off it,
    and in contact the blade alone touches it."""
    arm, carried = ["column", "upper arm", "forearm", "wrist", "hand", "flange"], ["holder", "blade"]
    wanted = {(one, "wheel"): (ARM_MARGIN, False) for one in arm}
    wanted |= {("holder", "wheel"): (BLADE_MARGIN, False), ("blade", "wheel"): (BLADE_MARGIN, True)}
    folded = [("base", one) for one in arm[3:]] + [("column", "hand"), ("column", "flange"), ("upper arm", "flange")]
    folded += [(one, other) for one in ("base", *arm[:3]) for other in carried]
    wanted |= dict.fromkeys(folded, (ARM_MARGIN, False))
    below = {(one, BASE_PLANE): (ARM_MARGIN, False) for one in arm[1:] + carried}
    floor = {(one, "floor"): (ARM_MARGIN, False) for one in arm[1:] + carried} | {("column", "floor"): (0.0, False)}
    for one, ground in ((cell, below), (with_floor(cell, -500.0), floor)):
        scene = CollisionScene(one, BLOCK)
        found = {tuple(scene._bodies[i].name for i in (p.a, p.b)): (p.margin, p.off_contact) for p in scene._pairs}
        shaped = {body.name for body in scene._bodies}
        assert found == {pair: told for pair, told in (wanted | ground).items() if shaped >= set(pair)}
        assert shaped >= {"base", "column", "upper arm", "forearm", "hand", "wheel", *carried}


def test_a_forearm_driven_into_the_wheel_is_told(cell, scene):
    """The wrist centre put at the wheel: on the way there something of the arm comes within the margin."""
    T = np.eye(4)
    T[:3, :3] = rotation_from_abc([0.0, np.pi / 2, 0.0])
    T[:3, 3] = cell.wheel.centre + np.array([0.5, 0.0, 0.3])
    q_goal, _ = inverse_branches(cell.robot, T[None])
    q_goal = q_goal[0][np.isfinite(q_goal[0]).all(axis=1)][0]
    path = HOME + (q_goal - HOME) * np.linspace(0.0, 1.0, 60)[:, None]
    clearance = scene.clearance(path, in_contact=True)
    assert clearance.value < -0.05
    values, names = scene.clearances(path, in_contact=True)
    assert clearance.index == int(np.argmin(values)) and names[clearance.index] == clearance.names
    assert any("wheel" in pair and pair[0] in ("forearm", "hand", "wrist", "flange", "upper arm") for pair in names)
    assert values[0] > 0
    assert "overlap" in clearance.sentence() and "mm" in clearance.sentence()


def test_a_free_home_is_free_and_says_so(scene):
    clearance = scene.clearance(HOME[None], in_contact=False)
    assert clearance.value > 0.02 and clearance.index == 0
    assert "stay free" in clearance.sentence()
    assert Clearance(-0.0123, 4, ("hand", "wheel")).sentence().startswith("hand and wheel overlap by 12.3 mm")


def test_the_gradient_is_the_slope_of_the_clearance(cell, scene):
    rng = np.random.default_rng(5)
    compared = 0
    for q in joints_of(cell, blade_before_wheel(cell, 0.012)):
        direction = rng.standard_normal(6)
        direction /= np.linalg.norm(direction)
        steps = np.array([-2e-3, -1e-3, 0.0, 1e-3, 2e-3])
        values, names = scene.clearances(q + steps[:, None] * direction, in_contact=False)
        if len(set(names)) > 1 or values.min() <= 0:
            continue  # the slope jumps where another pair takes over
        expected = (values[0] - 8 * values[1] + 8 * values[3] - values[4]) / (12 * 1e-3)
        assert scene.gradient(q, in_contact=False) @ direction == pytest.approx(expected, abs=2e-3)
        compared += 1
    assert compared > 0


def test_a_larger_blade_is_nowhere_farther(cell, scene):
    larger = CollisionScene(cell, 1.5 * BLOCK)
    q = joints_of(cell, blade_before_wheel(cell, 0.03))
    small, _ = scene.clearances(q, in_contact=False)
    large, _ = larger.clearances(q, in_contact=False)
    assert (large <= small + 1e-6).all() and (large < small - 1e-4).any()


def test_off_the_wheel_blade_and_holder_count_and_nothing_else(cell):
    """Against the distances of these two pairs alone, at postures of the arm."""
    scene, alone = CollisionScene(cell, BLOCK), CollisionScene(cell, BLOCK)
    both = [{"blade", "wheel"}, {"holder", "wheel"}]
    alone._pairs = [p for p in alone._pairs if {alone._bodies[p.a].name, alone._bodies[p.b].name} in both]
    q = np.random.default_rng(3).uniform(cell.robot.q_min, cell.robot.q_max, (60, 6))
    wanted, names = alone.clearances(q, in_contact=False)
    np.testing.assert_allclose(scene.off_wheel(forward(cell.robot, q) @ cell.workpiece.T_flange_blade), wanted, atol=1e-6)
    assert {one for one, _ in names} == {"blade", "holder"}


def test_axes_of_a_stack_are_judged_one_by_one(scene):
    q = HOME + np.radians(2.0) * np.arange(5)[:, None] * np.array([1, 0, 0, 1, 1, 0])
    whole, _ = scene.clearances(q, in_contact=False)
    single = [scene.clearance(one[None], in_contact=False).value for one in q]
    np.testing.assert_allclose(whole, single, atol=1e-12)


@pytest.mark.parametrize("in_contact", [False, True])
def test_what_is_not_measured_is_farther_than_the_closest_pair(scene, monkeypatch, in_contact):
    low, high = scene.cell.robot.q_min, scene.cell.robot.q_max
    q = np.random.default_rng(4).uniform(low, high, (400, 6))
    values, names = scene.clearances(q, in_contact)
    monkeypatch.setattr(CollisionScene, "_least", lambda _, frames, pairs: np.full((len(frames), len(pairs)), -np.inf))
    every, whose = scene._measured(q, in_contact)
    assert np.array_equal(values, every) and names == whose and len(set(names)) > 5


def test_clearances_that_are_kept_cannot_be_overwritten(cell, scene):
    q = np.zeros((3, 6))
    first, _ = scene.clearances(q, True)
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 99.0
    assert scene.clearances(q, True)[0] is first and scene.clearances(q + 0.1, True)[0][0] != first[0]
