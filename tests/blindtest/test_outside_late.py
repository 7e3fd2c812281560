"""The second list outside the catalogue: formulas by another hand, zero at size zero, detectability, where it is asked for."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ocp.blindtest.interface import draw_effects
from ocp.blindtest.oracle.oracle import detectabilities
from ocp.blindtest.oracle.tracker import scene_of, tracker_view
from ocp.blindtest.worlds import outside_lists, recipes
from ocp.blindtest.worlds.machines import arm_with_outside, draw_tracker_machine
from ocp.blindtest.worlds.outside import moved_by
from ocp.blindtest.worlds.outside_lists import LATE
from ocp.blindtest.worlds.recipes import OUTSIDE, Recipe, pool_of, scaled, within_range
from ocp.blindtest.worlds.sealing import write_cell
from ocp.simulate.twin.planting import ARM_KINDS as CATALOGUE
from ocp.simulate.twin.planting import Planted, draw_effect
from robots.errors import BadInput

ROOT = Path(__file__).resolve().parents[2]
KINDS = {name: one.kind for name, one in LATE.items()}
NAMES = sorted(KINDS)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cell") / "cell.toml"
    write_cell(ROOT / "ocp" / "data" / "cell.toml", path)
    return path


@pytest.fixture(scope="module")
def machine(cell):
    return draw_tracker_machine(cell, 4, Recipe(1, "none_background", 0, None), 60, 20)


@pytest.fixture(scope="module")
def scene(machine):
    return scene_of(machine)


@pytest.fixture(scope="module")
def bare(machine):
    return machine.points(())


def test_ten_that_are_in_no_other_list():
    assert len(KINDS) == 10 and len(outside_lists.ON_ARM) == 10
    assert len(OUTSIDE) == len(LATE) + len(outside_lists.ON_ARM) + len(outside_lists.ON_GRINDING)
    assert not set(OUTSIDE) & {kind.name for kind in CATALOGUE}
    assert len({one.form for one in LATE.values()}) == 10  # each has a form of its own
    assert {one.moves for one in LATE.values()} == {"angle", "link", "frame", "nest"}


@pytest.mark.parametrize("name", NAMES)
def test_each_moves_the_reflector_in_proportion_and_not_at_zero(machine, bare, name):
    rng = np.random.default_rng(2)
    for joint in KINDS[name].joints or (None,):
        effect = draw_effect(rng, KINDS[name], joint)
        d = machine.points([effect]) - bare
        assert within_range(effect)
        assert 2e-6 < np.linalg.norm(d, axis=1).max() < 3e-3
        assert np.allclose(machine.points([scaled(effect, 0.0)]), bare, rtol=0.0, atol=1e-13)
        twice = machine.points([scaled(effect, 2.0)]) - bare
        assert np.allclose(twice, 2 * d, atol=0.02 * np.abs(d).max())
        assert not within_range(scaled(effect, 100.0))


def _angle(scene, joint: int, dq):
    """Change (n, 3) m of the readings when a joint turns by dq (n,) rad."""
    return scene.D[:, :, joint - 1] * np.asarray(dq)[:, None]


def _by_hand(name, joint, scene, phase=0.7):
    """Shifts of an axis (n,) rad for size 1, written again from what each effect is said to be."""
    m = scene.campaign.moments
    q, t = m.q[:, joint - 1], m.time_s
    if name == "mesh_error_under_load":
        return scene.tau[:, joint - 1] / scene.cell.robot.torque_max[joint - 1] * np.cos(30 * q + phase)
    if name == "zero_jump":
        return np.array([1.0 if s >= 5000.0 else 0.0 for s in t])
    if name == "oil_warm_up":
        return 1 / np.e ** (t / 1500.0)
    if name == "cable_twist":
        both = m.q[:, 3] + m.q[:, 5]
        return np.select([both > 2.0, both < -2.0], [2.0 - both, -2.0 - both], 0.0)
    return None


@pytest.mark.parametrize(
    "name, joint, size",
    [("mesh_error_under_load", 3, 2e-4), ("zero_jump", 2, 1e-4), ("oil_warm_up", 1, 1e-4), ("cable_twist", 6, 1e-4)],
)
def test_shifts_of_an_axis_are_what_is_written_of_them(machine, scene, bare, name, joint, size):
    shapes = {"order": 30.0, "phase_rad": 0.7, "at_s": 5000.0}
    keys = KINDS[name].keys
    effect = Planted(name, joint, {k.name: size if k is keys[0] else shapes[k.name] for k in keys})
    d = machine.points([effect]) - bare
    expected = _angle(scene, joint, size * _by_hand(name, joint, scene))
    assert np.abs(expected).max() > 5e-6 and np.allclose(d, expected, atol=0.02 * np.abs(expected).max())


def test_a_resolver_turns_several_times_with_the_motor(machine, scene, bare):
    effect = Planted("resolver_error", 3, {"rad": 1e-4, "order": 4.0, "phase_rad": 0.0})
    d = machine.points([effect]) - bare
    axis = np.einsum("ni,ni->n", d, scene.D[:, :, 2]) / np.einsum("ni,ni->n", scene.D[:, :, 2], scene.D[:, :, 2])
    q = scene.campaign.moments.q[:, 2]
    ratios = np.linspace(150.0, 320.0, 17001)
    waves = np.cos(4 * ratios[:, None] * q)
    fit = np.abs(waves @ axis) / np.linalg.norm(axis) / np.linalg.norm(waves, axis=1)
    # One ratio among those that gears of this size have explains all of it.
    assert max(fit) > 0.99 and np.abs(axis).max() == pytest.approx(1e-4, rel=0.03)


def test_memory_is_of_the_postures_before_and_how_far_they_lay_apart(machine, scene, bare):
    effect = Planted("slip_memory", 2, {"rad": 1e-4})
    whole = scene.campaign.moments.q
    q = whole[:, 1]
    # Closed form of a stop operator for a motion without return: the travel since the start, no more than the half width.
    order = np.argsort(q)
    arm = arm_with_outside(machine.cell, machine.with_effects([effect]), machine.campaign.targets)
    every = arm._instants(scene.campaign.moments)
    instants = replace(every, q=every.q[order])
    ((_, up),) = moved_by(LATE, [effect], "angle", instants)
    assert np.allclose(up, -1e-4 * np.minimum(q[order] - q[order][0], 0.8) / 0.8)
    # A small way back takes a small part of it away: a sign of the last motion alone would turn it round.
    there = np.zeros((4, 6))
    there[:, 1] = [-2.0, -0.5, -0.6, -2.2]
    ((_, back),) = moved_by(LATE, [effect], "angle", replace(instants, q=there))
    assert np.allclose(back, [0.0, -1e-4, -1e-4 * 0.7 / 0.8, 1e-4])
    # On the machine the same posture, nest and approach read otherwise after other ways: a function of both alone cannot do it.
    d = machine.points([effect]) - bare
    axis = np.einsum("ni,ni->n", d, scene.D[:, :, 1]) / np.einsum("ni,ni->n", scene.D[:, :, 1], scene.D[:, :, 1])
    pairs = [(a, b) for b in range(len(q)) for a in range(b) if np.array_equal(whole[a], whole[b])]
    assert pairs and max(abs(axis[a] - axis[b]) for a, b in pairs) > 2e-5


def _weights(machine, scene, first: int):
    """Masses kg and centres (n, 3) m, base axes, of all links after `first` and of the payload."""
    robot, truth, n = machine.cell.robot, machine.truth, len(scene)
    mass, place = robot.link_mass * truth.mass_scale, robot.link_com + truth.mass_shift
    masses = [np.full(n, mass[k]) for k in range(first + 1, 7)]
    centres = [scene.links[:, k, :3, 3] + scene.links[:, k, :3, :3] @ place[k] for k in range(first + 1, 7)]
    hung = [machine.truth.payloads[name] for name in scene.campaign.moments.payload]
    masses.append(np.array([mass for mass, _ in hung]))
    places = np.array([place for _, place in hung])
    centres.append(scene.links[:, 6, :3, 3] + np.einsum("nij,nj->ni", scene.links[:, 6, :3, :3], places))
    return np.array(masses), np.array(centres)


def _turned(scene, origin, turn):
    """Change (n, 3) m of the readings when what carries the reflector turns by `turn` (n, 3) rad, base axes, about `origin`."""
    return np.cross(turn, scene.inner - origin) @ scene.turn.T


def test_a_loose_anchor_yields_to_one_side(machine, scene, bare):
    phase, size = 0.4, 5e-8
    masses, centres = _weights(machine, scene, 0)
    # Weights mg at horizontal places x, y: the moment about e is mg (y e_x - x e_y) with its sign by the right hand.
    lifted = -9.81 * (masses * (centres[..., 1] * np.cos(phase) - centres[..., 0] * np.sin(phase))).sum(axis=0)
    edge = np.array([np.cos(phase), np.sin(phase), 0.0])
    expected = _turned(scene, np.zeros(3), size * np.where(lifted > 0, lifted, 0.0)[:, None] * edge)
    d = machine.points([Planted("loose_anchor", None, {"rad_per_Nm": size, "phase_rad": phase})]) - bare
    assert 0.1 < (lifted > 0).mean() < 0.9 and np.abs(expected).max() > 5e-5
    assert np.allclose(d, expected, atol=0.01 * np.abs(expected).max())
    assert np.array_equal(d[lifted < -1.0], 0 * d[lifted < -1.0])


def test_a_worn_bearing_is_stiff_then_gives_way_then_stops(machine, scene, bare):
    size, joint = 3e-4, 4
    masses, centres = _weights(machine, scene, joint - 1)
    origin, axis = scene.links[:, joint - 1, :3, 3], scene.links[:, joint - 1, :3, 2]
    moment = np.cross(centres - origin, np.array([0.0, 0.0, -9.81]) * masses[..., None]).sum(axis=0)
    across = np.cross(axis, np.cross(moment, axis))
    strength = np.linalg.norm(across, axis=1)
    held = 0.15 * machine.cell.robot.torque_max[joint - 1]
    tilt = np.interp(strength, [0.0, held, 2 * held], [0.0, 0.0, size])
    expected = _turned(scene, origin, tilt[:, None] * across / strength[:, None])
    d = machine.points([Planted("bearing_slack", joint, {"rad": size})]) - bare
    assert (tilt == size).any() and (tilt == 0).any()
    assert np.allclose(d, expected, atol=0.01 * np.abs(expected).max())


def test_a_trunnion_shears_azimuths_with_elevation(machine, bare):
    size = 5e-5
    read = machine.points([Planted("trunnion_tilt", None, {"rad": size})])
    azimuth, before = np.arctan2(read[:, 1], read[:, 0]), np.arctan2(bare[:, 1], bare[:, 0])
    elevation = np.arcsin(bare[:, 2] / np.linalg.norm(bare, axis=1))
    off = (azimuth - before + np.pi) % (2 * np.pi) - np.pi
    assert np.allclose(off, size * np.tan(elevation), atol=1e-9)
    assert np.allclose(read[:, 2], bare[:, 2], atol=1e-9)


def test_a_ball_rises_from_its_nest_with_the_angle_it_is_seen_under(machine, scene, bare):
    size = 1e-4
    d = machine.points([Planted("ball_out_of_round", None, {"m": size})]) - bare
    nest = scene.links[:, 6, :3, 2] @ scene.turn.T
    angle = np.arccos(np.clip((nest * bare).sum(axis=1) / np.linalg.norm(bare, axis=1), -1, 1))
    expected = size * (0.25 + 0.75 * np.cos(2 * angle))[:, None] * nest
    assert np.allclose(d, expected, atol=1e-9)


def test_the_tracker_s_own_error_alone_leaves_lengths(machine, bare):
    lengths = np.linalg.norm(bare, axis=1)
    for name in NAMES:
        effect = draw_effect(np.random.default_rng(5), KINDS[name])
        change = np.abs(np.linalg.norm(machine.points([effect]), axis=1) - lengths).max()
        assert (change < 1e-9) == (name == "trunnion_tilt"), name


@pytest.mark.parametrize("turn", range(10))
def test_lambda_is_reached(cell, turn):
    recipe = Recipe(turn + 1, "outside_late", turn, recipes.STRANGE)
    machine = draw_tracker_machine(cell, 6, recipe, 150, 20)
    view = tracker_view(machine)
    effects, lam = draw_effects(6, recipe, view, "tracker")
    low, high = recipes.STRANGE
    assert len(effects) == 1 and effects[0].effect in KINDS
    assert 0.75 * low < lam[0] < 1.25 * high and within_range(effects[0])
    assert detectabilities(view, effects)[0] == pytest.approx(lam[0], rel=1e-6)


def test_the_second_list_comes_only_where_it_is_asked_for():
    assert "outside_late" not in recipes.KINDS and {r.kind for r in recipes.recipes(190)} == set(recipes.KINDS)
    mixed = recipes.recipes(60, recipes.check_kinds("outside_late,none"))
    assert sum(r.kind == "outside_late" for r in mixed) == 40 and mixed[0].target in (None, recipes.STRANGE)
    assert {k.name for k in pool_of(Recipe(1, "outside", 0, None), "tracker")} == set(outside_lists.ON_ARM)
    with pytest.raises(BadInput, match="has no effects of the force log"):
        recipes.check_kinds("outside_late", "force")


def test_it_uses_nothing_of_the_diagnosis():
    tree = ast.parse((ROOT / "ocp" / "blindtest" / "worlds" / "outside_lists.py").read_text())
    imported = {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert not {i for i in imported if i.startswith(("ocp.diagnose", "ocp.effects", "ocp.model", "robots.calibration"))}
