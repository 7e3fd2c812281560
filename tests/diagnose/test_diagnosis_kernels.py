"""Effects that nobody catalogued, on an arm in NumPy: each is placed by what it varies with, and gets no name of the library."""

import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import ncx2

from ocp.diagnose.engine.evidence import Rival, size_grid, visible_lambda
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.kernels import groups, kernels, products, smooth
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import effect_list, effects_table, library
from robots.gravity import GRAVITY, weight_torques
from robots.kinematics import forward
from tests.diagnose.test_diagnosis_tracker import LIBRARY, ROBOT, channel, column, without, world
from tests.support.dropped_effect import dropped_effect
from tests.support.simulated_campaign import NESTS, PAYLOADS


def torque(r, j):
    """Load torque (n,) N m of joint j, payloads as believed."""
    tau = np.zeros(len(r))
    for k, name in enumerate(r.payloads):
        rows = r.payload == k
        tau[rows] = weight_torques(ROBOT, r.q[rows], PAYLOADS[name].mass, PAYLOADS[name].com)[:, j - 1]
    return tau


def about_head(points, turn):
    """Displacement (n, 3) of points in the tracker's frame turned by (n,) rad about its vertical."""
    return turn[:, None] * np.column_stack([-points[:, 1], points[:, 0], np.zeros(len(points))])


JOINTS = {
    "creep": (lambda r: column(2, 1.2e-7 * torque(r, 2) * np.log1p(r.time / 1800.0)), 2, {"tau2"}),
    "load hysteresis": (lambda r: column(5, 6e-7 * torque(r, 5) * r.approach[:, 4]), 5, {"approach5", "tau5"}),
    "coupled": (lambda r: column(3, 1.5e-4 * np.sin(1.5 * r.q[:, 1])), 3, {"q2"}),
    "resolver": (lambda r: column(3, 6e-5 * np.cos(5 * ROBOT.gear_ratio[2] * r.q[:, 2])), 3, {"motor3"}),
    "loaded mesh": (lambda r: column(2, 1.5e-4 * torque(r, 2) / 4000.0 * np.cos(23 * r.q[:, 1])), 2, {"tau2", "q2"}),
    "memory": (lambda r: column(4, 2e-4 * np.tanh(np.diff(r.q[:, 3], prepend=r.q[0, 3]))), 4, {"step4"}),
    "settling": (lambda r: column(2, -2e-4 * r.approach[:, 1] * np.exp(-r.waited / 45.0)), 2, {"approach2", "wait"}),
    "warm gear": (lambda r: column(4, 4e-5 * (r.temperature - 22.0) * np.cos(r.q[:, 3])), 4, {"temperature", "q4"}),
}


@cache
def findings_of(name):
    """What is said of an arm whose joint does so, its readings, and where reflectors of other readings would be."""
    readings, points = world(11, JOINTS[name][0])
    return diagnose_channels([channel(readings)], LIBRARY, Options(folds=False)), readings, points


@pytest.mark.parametrize("name", JOINTS)
def test_what_a_joint_does_outside_the_catalogue_is_placed(name):
    _, joint, conditions = JOINTS[name]
    d = findings_of(name)[0]
    at = d.location if d.verdict == "unexplained" else d.remainder  # a name may follow a part of it
    assert d.verdict in ("unexplained", "partly") and at is not None
    assert at.joint == joint
    slow = {"time": "temperature"}  # a warm-up in the course of time: the two go together
    told = {slow.get(c, c) for c in at.depends_on}
    assert conditions <= told


def test_a_step_of_a_nest_is_placed_when_its_name_is_withheld():
    def moved(r):
        late = (r.target == 1) & (r.time > np.quantile(r.time, 0.55))
        return late[:, None] * np.array([1.5e-4, -1e-4, 0.5e-4])

    readings, _ = world(12, None, moved)
    d = diagnose_channels([channel(readings)], without("target_shift"), Options(folds=False))
    assert d.verdict == "unexplained"
    assert d.location is not None and d.location.subsystem == "target" and d.location.joint == 0


def test_the_trackers_circle_is_told_from_the_arm():
    readings, points = world(13)
    at = points(readings)
    azimuth = np.arctan2(at[:, 1], at[:, 0])
    wave = about_head(at, 6e-5 * np.cos(6.0 * azimuth))
    turned = channel(replace(readings, point=readings.point + wave))
    d = diagnose_channels([turned], without("azimuth_harmonic"), Options(folds=False))
    assert d.verdict == "unexplained"
    assert d.location is not None and d.location.subsystem == "tracker" and d.location.depends_on == ("azimuth",)


@pytest.mark.parametrize("centre", [0.0, 1.3], ids=["the tracker", "another place"])
def test_what_grows_with_warmth_gets_no_two_other_names(centre):
    """Without a name for it, a drift of the frame and warm joints follow it together on the campaign, and on no other day."""
    readings, points = world(18)
    there = points(readings)
    grown = 6e-6 * (readings.temperature - 22.0)[:, None] * (there - centre * there.mean(axis=0))
    warm = channel(replace(readings, point=readings.point + grown))
    d = diagnose_channels([warm], without("air_scale", "link_thermal"), Options(folds=False))
    assert d.verdict == "unexplained" and not d.active
    assert d.location is not None and d.location.subsystem == "tracker" and {"range"} < set(d.location.depends_on)


def test_a_reflector_that_is_no_ball_is_told_from_the_arm():
    readings, _ = world(16)
    c = channel(readings)
    along = readings.point / np.linalg.norm(readings.point, axis=1, keepdims=True)
    seen = c.conditions.sight
    assert np.linalg.norm(seen, axis=1) == pytest.approx(np.ones(len(seen)))
    off = 1.2e-4 * (seen[:, 0] * seen[:, 1] + 0.5 * seen[:, 2])
    d = diagnose_channels(
        [channel(replace(readings, point=readings.point + off[:, None] * along))], LIBRARY, Options(folds=False)
    )
    assert d.verdict == "unexplained"
    assert d.location is not None and d.location.subsystem == "tracker" and d.location.depends_on == ("sight",)


def test_a_flange_that_always_hangs_alike_falls_to_no_side():
    """A sweep of joint 1 on a base that leans by a fraction of a degree: its angle drawn out to the whole range."""
    c = channel(world(13, n=60)[0]).conditions
    for hang, there in ((c.hang, True), (c.hang[0] + 1e-3 * c.hang, False)):
        assert any(one.where == "hang" for one in kernels(replace(c, hang=hang))) == there


@pytest.mark.parametrize("nest", [None, 2])
def test_what_falls_to_the_side_to_which_the_flange_hangs_is_told_from_the_arm(nest):
    """A loose holder, or one loose nest: 0.1 mm along the flange's own x, to one side or the other."""
    readings, _ = world(13, n=110)
    c = channel(readings).conditions
    down = np.einsum("nij,nj->ni", c.carrier, c.hang)
    assert np.ptp(down, axis=0).max() < 1e-12  # of the tracker's head, which stands still
    assert np.abs(c.hang + forward(ROBOT, readings.q)[:, 2, :3]).max() < 0.01
    loose = 1e-4 * np.tanh(c.hang[:, 0] / 0.15) * (True if nest is None else readings.target == nest)
    moved = replace(readings, point=readings.point + loose[:, None] * c.carrier[:, :, 0])
    d = diagnose_channels([channel(moved)], LIBRARY, Options(folds=False, where=False))
    assert d.verdict == "unexplained" and d.location is not None and d.location.subsystem == "target", d.ranking[:2]


def test_moments_across_an_axis_are_those_of_all_weight_beyond_it():
    readings, _ = world(14, n=40)
    c = channel(readings)
    moments = c.conditions.moments
    robot = replace(ROBOT, stiffness=np.zeros(6))
    for i in range(0, 40, 7):
        frames = _frames(robot, readings.q[i])
        mass, com = c.fit.state.payloads[readings.payload[i], 0], c.fit.state.payloads[readings.payload[i], 1:]
        for j in (0, 1, 3):
            weights = [(robot.link_mass[k], frames[k] @ np.append(robot.link_com[k], 1.0)) for k in range(j + 1, 7)]
            weights.append((mass, frames[6] @ np.append(com, 1.0)))
            moment = sum(np.cross(place[:3] - frames[j][:3, 3], [0.0, 0.0, -GRAVITY * m]) for m, place in weights)
            told = moments[i, j]
            assert told == pytest.approx([moment @ frames[j][:3, 0], moment @ frames[j][:3, 1]], rel=0.02, abs=8.0)


def _frames(robot, q):
    """Frames (7, 4, 4) of base and links by MD-H, written out."""
    T, found = np.eye(4), [np.eye(4)]
    for (offset, d, a, alpha, beta), sign, angle in zip(robot.mdh, robot.sign, q, strict=True):
        t = sign * angle + offset
        rz = np.array([[np.cos(t), -np.sin(t), 0, 0], [np.sin(t), np.cos(t), 0, 0], [0, 0, 1, d], [0, 0, 0, 1]])
        rx = np.array([[1, 0, 0, a], [0, np.cos(alpha), -np.sin(alpha), 0], [0, np.sin(alpha), np.cos(alpha), 0], [0, 0, 0, 1]])
        ry = np.array([[np.cos(beta), 0, np.sin(beta), 0], [0, 1, 0, 0], [-np.sin(beta), 0, np.cos(beta), 0], [0, 0, 0, 1]])
        T = T @ rz @ rx @ ry
        found.append(T)
    assert found[6] == pytest.approx(forward(robot, q[None])[0], abs=1e-9)
    return found


def test_tilts_are_the_difference_of_a_turn_about_the_axis_origin():
    readings, _ = world(15, n=30)
    c = channel(readings)
    tilts, seen = c.conditions.d_tilts, c.seen
    for i in (0, 9, 21):
        frames = _frames(ROBOT, readings.q[i])
        for j in (0, 2, 4):
            turned = np.array([np.cos(ROBOT.sign[j] * readings.q[i, j] + ROBOT.mdh[j, 0]), 0.0])
            turned[1] = np.sin(ROBOT.sign[j] * readings.q[i, j] + ROBOT.mdh[j, 0])
            axes = frames[j][:3, :2]
            for k, about in enumerate((axes[:, 0], axes[:, 1], axes @ turned, axes @ np.array([-turned[1], turned[0]]))):
                moved = seen.turns[i] @ np.cross(about, seen.base_point[i] - frames[j][:3, 3])
                assert tilts[i, :, j, k] == pytest.approx(moved, rel=0.02, abs=0.02)


def test_an_effect_of_the_told_size_is_named_nine_times_of_ten():
    rng = np.random.default_rng(5)
    energy, sizes, odds = 4.0e4, size_grid(0.05), np.log(0.3 / 20)
    told = visible_lambda(energy, 2, sizes, odds - np.log(40))
    gains = rng.noncentral_chisquare(2, told, 4000)
    spread = sizes[:, None] ** 2 * energy
    log = np.logaddexp.reduce(-np.log1p(spread) + 0.5 * gains * spread / (1 + spread), axis=0) - np.log(len(sizes) * 40.0)
    assert np.mean(log + odds > 0) == pytest.approx(0.9, abs=0.02)
    assert told > ncx2.mean(2, 0) and visible_lambda(energy, 2, sizes, odds - np.log(400)) > told
    background = Rival(np.full(4, 0.01), np.log(0.04 / 40), 0)
    assert visible_lambda(energy, 2, sizes, odds - np.log(40), background) > told


def test_a_dropped_file_is_screened_named_planned_and_listed(tmp_path, monkeypatch):
    with dropped_effect(tmp_path, monkeypatch, "(1,)", "2e-4", "x.q[2] * x.q[4]"):
        readings, _ = world(17, lambda r: column(1, 1.5e-4 * r.q[:, 2] * r.q[:, 4]))
        d = diagnose_channels([channel(readings)], library(), Options(folds=False))
        assert Name("brand_new", 1) in {s.name for s in d.screened}
        assert d.verdict == "explained" and [a.effect.name for a in d.active] == ["brand_new"]
        assert d.active[0].parameters["k"] == pytest.approx(1.5e-4, rel=0.1)
        assert any(line.startswith("brand_new") for line in effect_list().splitlines())
        assert "brand_new" in effects_table()
        sys.modules.pop("ocp.effects.brand_new", None)


@pytest.mark.parametrize("degrees, there", [(100.0, False), (130.0, True)])
def test_half_an_order_more_is_another_ripple_only_over_a_wide_range(degrees, there):
    """Over 100 degrees whole orders make any half one, and every gear has ripples of whole orders."""
    c = channel(world(13, n=60)[0]).conditions
    q = c.q.copy()
    q[:, 1] = np.radians(degrees) * (np.argsort(np.argsort(q[:, 1])) / (len(q) - 1) - 0.5)
    assert any(one.where == "ripple2" for one in kernels(replace(c, q=q))) == there


def test_a_payload_may_be_named_as_its_owner_likes():
    conditions = channel(world(11)[0]).conditions
    starred = replace(conditions, payloads=tuple(f"{name} 2 * 3 *" for name in conditions.payloads))
    plain, told = ({k.where: k.changes for k in kernels(c) if "payload" in k.where} for c in (conditions, starred))
    assert plain.keys() == told.keys() >= {"payload2", "payload x q2"}
    assert all(np.array_equal(plain[where], told[where]) for where in plain)


def test_features_are_what_they_say():
    x = np.linspace(3.0, 9.0, 50)
    assert smooth(x, 1)[:, 0] == pytest.approx(np.cos(np.pi * (x - 3.0) / 6.0) / (1 + 1 / 16))
    assert products(x[:, None], smooth(x, 2)) == pytest.approx(x[:, None] * smooth(x, 2))
    assert groups(np.zeros(5, int)) is None
    indicator = groups(np.array([0, 0, 0, 1, 1, 2]))
    assert indicator.shape == (6, 2) and indicator.sum(axis=0) == pytest.approx([0.0, 0.0])
    assert len(NESTS) > 1
