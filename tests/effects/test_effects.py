"""The library of effects: what it holds, and every arm and tracker effect against an arm of elementary motions."""

import pickle
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ocp.effects
from ocp.effects.catalogue import effect_list, effects_table, forget_library, library
from ocp.effects.cell_effects import effect_of, table_of
from ocp.effects.effect import SUBSYSTEMS, Active, Surroundings, amplitude_and_phase, cosine_and_sine, deviations_among
from ocp.effects.engine.evaluate import TrackerRows, arm_columns, arm_rows, arm_shift, tracker_columns
from ocp.effects.forms import odds_of_instants
from ocp.shell.cache import OWN_EFFECTS
from robots.calibration.reading_model import RowInputs, predict
from robots.errors import BadInput
from tests.support.dropped_effect import dropped_effect
from tests.support.effect_arm import AT, COMPLIANCE, T_TRACKER, Poses, reflectors
from tests.support.simulated_campaign import EXTRA, NESTS, PAYLOADS

CATALOGUE = {
    "joint_compliance": "rad_per_Nm",
    "joint_stiffening": "rad_per_Nm3",
    "link_bending": "rad_per_Nm",
    "gravity_compensator": "stiffness_N_m",
    "payload_mass": "kg",
    "payload_com": "shift_m",
    "gear_1x": "amplitude_rad phase_rad",
    "gear_2x": "amplitude_rad phase_rad",
    "gear_harmonic": "order amplitude_rad phase_rad",
    "motor_harmonic": "order amplitude_rad phase_rad",
    "backlash": "half_width_rad",
    "friction_windup": "base_rad per_Nm",
    "encoder_scale": "scale",
    "wrist_coupling": "ratio source_joint",
    "joint_coupling": "ratio_rad source_joint",
    "load_backlash": "half_width_rad torque_Nm",
    "tool_flex": "m_per_N",
    "air_scale": "per_K",
    "azimuth_harmonic": "order rad phase_rad",
    "link_thermal": "per_K",
    "joint_thermal": "rad_per_K",
    "base_tilt": "rad at_s",
    "tracker_drift": "m_per_h rad_per_h",
    "tracker_scale": "scale",
    "target_shift": "target shift_m at_s",
    "channel_delay": "s",
    "wheel_stiffness": "scale",
    "wheel_law": "exponent",
    "wheel_relaxation": "g tau",
    "wheel_wear": "m_per_s",
    "wheel_temperature": "per_K radius_per_K",
    "wheel_runout": "m phase_rad",
    "belt_splice": "N hz",
    "belt_tension": "N",
    "time_delay": "s",
    "path_lag": "m",
    "tangential_force": "dmu leak",
    "material_removal": "m_per_pass",
    "stock_profile": "m",
    "blade_stiffness": "scale",
    "clamp_compliance": "m_per_N",
    "clamp_slip": "m at_s",
    "tool_frame_shift": "m at_s",
    "wheel_frame_shift": "m at_s",
    "sensor_bias": "N",
    "sensor_drift": "N_per_h",
    "sensor_gain": "scale",
    "sensor_crosstalk": "share",
    "flange_stiffness": "scale",
    "flange_friction": "N",
    "flange_gravity": "kg",
}
POSES = Poses.random(12)
SEEN = Surroundings(
    EXTRA.gear_ratio,
    np.zeros((6, 2)),
    POSES.time,
    tuple(NESTS),
    payloads=tuple(PAYLOADS),
    robot=EXTRA.name,
    span=(0.0, 0.1),
    lines=(1, 2, 3),
)
PLACES = [(name, joint) for name, effect in library().items() for joint in effect.places]
ON_ARM = [(name, joint) for name, joint in PLACES if library()[name].on_arm or library()[name].reading is not None]


def some(name, joint, size=0.2, at=0.7):
    """An effect with coefficients of `size` of their prior, of a variant in the middle of the scan."""
    effect = library()[name]
    scans = effect.scan(joint, SEEN)
    a = size * np.array(effect.prior_sd) * np.linspace(1.0, 0.6, effect.size)
    return Active(effect, joint, a, scans[int(at * (len(scans) - 1))], np.diag((0.1 * np.array(effect.prior_sd)) ** 2))


@cache
def still():
    return reflectors(POSES)


@cache
def believed():
    n = len(POSES.q)
    nests, hung = [NESTS[k].place for k in NESTS], [[p.mass, *p.com] for p in PAYLOADS.values()]
    inputs = RowInputs(POSES.q, np.array(hung)[POSES.payload], np.zeros((n, 6)), np.zeros((n, 3)), np.array(nests)[POSES.nest])
    arm = np.concatenate([EXTRA.mdh.ravel(), COMPLIANCE])
    rows = arm_rows(EXTRA, arm, inputs, tuple(PAYLOADS), POSES.payload, POSES.approach, POSES.warm, POSES.time, POSES.speed)
    return arm, inputs, rows, predict(EXTRA, arm, inputs)


def test_the_library_is_the_catalogue():
    found = library()
    assert set(found) == set(CATALOGUE)
    for name, effect in found.items():
        keys = [p.key for p in effect.parameters]
        assert set(CATALOGUE[name].split()) <= set(keys), name
        assert effect.subsystem in SUBSYSTEMS and effect.physics.strip() and effect.size == len(effect.prior_sd)
        assert all(p.low <= p.high for p in effect.parameters)
        assert effect.on_arm or effect.on_contact or effect.reading is not None


@pytest.mark.parametrize("name,joint", ON_ARM)
def test_arm_effects_move_reflectors_as_an_elementary_arm_does(name, joint):
    # Payloads load the hand little: only a huge cubic term moves it visibly.
    size = 200.0 if name == "joint_stiffening" and joint > 3 else 0.2
    one = some(name, joint, size, at=0.0 if name == "link_bending" else 0.7)  # an even beam
    v = one.parameters
    moved = reflectors(POSES, name, joint, v) - still()
    _, _, rows, p = believed()
    seen = p.point @ T_TRACKER.T + AT
    columns = arm_columns(one.effect, joint, [one.scanned], rows).at(rows, p.point, p.d_joints)[0] @ one.a @ T_TRACKER.T
    where = TrackerRows(seen, T_TRACKER @ p.R, POSES.nest, tuple(NESTS), POSES.time, POSES.warm)
    columns = columns + tracker_columns(one.effect, joint, [one.scanned], where)[0] @ one.a
    size = np.abs(moved).max()
    assert size > 3e-8 or (
        joint == 1 and name in ("joint_compliance", "joint_stiffening", "load_backlash")
    )  # nothing loads joint 1
    # First order in the effect; tilted or grown arms also carry their weight a little elsewhere.
    assert np.abs(columns - moved).max() < 0.01 * size + 2e-9, name


@pytest.mark.parametrize("name", ["backlash", "gravity_compensator", "payload_com", "link_bending", "base_tilt", "tool_flex"])
def test_a_large_effect_is_predicted_by_shifting_the_joints(name):
    one = some(name, library()[name].places[0], size=0.1 if name == "gravity_compensator" else 1.0)
    arm, inputs, rows, p = believed()
    shift = arm_shift([one], rows)
    there = predict(EXTRA, arm, RowInputs(inputs.q + shift.joints[0, :, :, 0], *list(vars(inputs).values())[1:]))
    point = there.point + shift.at(rows, there.point, np.zeros_like(p.d_joints))[0, ..., 0]
    expected = (reflectors(POSES, name, one.joint, one.parameters) - AT) @ T_TRACKER
    linear = p.point + shift.at(rows, p.point, p.d_joints)[0, ..., 0]
    assert np.abs(point - expected).max() < 2e-3 * np.abs(expected - p.point).max() + 1e-7
    assert np.isfinite(linear).all()


def test_a_joint_that_gives_more_bends_under_a_payload_that_weighs_more():
    """A softer spring and a heavier payload, effects both, are an arm with that spring that carries that payload."""
    spring, heavier = 1e-6, 9.0
    arm, inputs, rows, p = believed()
    soft, loads = arm.copy(), inputs.payload.copy()
    soft[31] += spring
    loads[POSES.payload == 2, 0] += heavier
    both = [
        Active(library()["joint_compliance"], 2, np.array([spring]), {"unit": 1.0}, np.eye(1)),
        Active(library()["payload_mass"], 0, np.array([heavier]), {"payload": list(PAYLOADS)[2]}, np.eye(1)),
    ]
    shift = arm_shift(both, rows)
    found = predict(EXTRA, arm, RowInputs(inputs.q + shift.joints[0, :, :, 0], *list(vars(inputs).values())[1:])).point
    expected = predict(EXTRA, soft, replace(inputs, payload=loads)).point
    alone = sum(np.abs(arm_shift([one], rows).joints[0, :, :, 0]) for one in both)
    assert np.abs(found - expected).max() < 0.01 * np.abs(expected - p.point).max()
    assert np.abs(np.abs(shift.joints[0, :, :, 0]) - alone).max() > 5e-5  # rad: what each does alone is not the whole


def test_many_variants_at_once_are_the_variants_one_by_one():
    _, _, rows, p = believed()
    for name in ("gear_harmonic", "wrist_coupling", "payload_mass", "target_shift"):
        effect = library()[name]
        joint = effect.places[-1]
        scans = effect.scan(joint, SEEN)[::7] if name == "gear_harmonic" else effect.scan(joint, SEEN)
        if effect.on_arm:
            whole = arm_columns(effect, joint, scans, rows).at(rows, p.point, p.d_joints)
            single = [arm_columns(effect, joint, [s], rows).at(rows, p.point, p.d_joints)[0] for s in scans]
        else:
            where = TrackerRows(p.point, p.R, POSES.nest, tuple(NESTS), POSES.time)
            whole = tracker_columns(effect, joint, scans, where)
            single = [tracker_columns(effect, joint, [s], where)[0] for s in scans]
        assert whole == pytest.approx(np.array(single), abs=1e-15), name


def test_what_a_data_set_does_not_say_comes_out_as_nan_and_nothing_else_does():
    _, inputs, _, p = believed()
    arm = np.concatenate([EXTRA.mdh.ravel(), COMPLIANCE])
    rows = arm_rows(EXTRA, arm, inputs)
    for name, joint in ON_ARM:
        effect = library()[name]
        if effect.on_arm and not name.startswith("payload"):
            columns = arm_columns(effect, joint, effect.scan(joint, SEEN)[:1], rows).at(rows, p.point, p.d_joints)
            unknown = {"approach", "temperature_C", "speed"} & set(effect.needs)
            assert np.isfinite(columns).all() != bool(unknown), name


def test_unknown_ratios_are_those_of_the_sister_machines_and_of_no_other_robot():
    effect = library()["motor_harmonic"]
    assert {s["gear_ratio"] for s in effect.scan(2, SEEN)} == {252.909, 269.176}
    other = Surroundings(np.full(6, np.nan), np.zeros((6, 2)), np.zeros(0), robot="ur5")
    assert list(effect.scan(2, other)) == []
    _, _, rows, _ = believed()
    assert arm_columns(effect, 2, [], rows).joints.shape == (0, 12, 6, 2)
    known = Surroundings(np.full(6, 100.0), np.zeros((6, 2)), np.zeros(0), robot="ur5")
    assert [s["gear_ratio"] for s in effect.scan(2, known)] == [100.0, 100.0]


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(PLACES), st.integers(0, 2**31), st.floats(0.0, 1.0))
def test_values_and_coefficients_are_inverse_and_survive_a_cell_file(place, seed, at):
    name, joint = place
    effect, rng = library()[name], np.random.default_rng(seed)
    scans = effect.scan(joint, SEEN)
    a = rng.normal(size=effect.size) * np.array(effect.prior_sd) * 0.5
    one = Active(effect, joint, a, scans[int(at * (len(scans) - 1))], np.diag((0.01 * np.array(effect.prior_sd)) ** 2))
    assert set(one.parameters) == {p.key for p in effect.parameters}
    back, scanned = effect.coefficients_of(one.parameters)
    told = effect.values(back, scanned)
    for key, value in one.parameters.items():
        assert told[key] == pytest.approx(value, rel=1e-9, abs=1e-18) if not isinstance(value, str) else told[key] == value
    from_file = effect_of(table_of(one)).active
    assert from_file.joint == joint and from_file.effect is effect
    same = {k: v for k, v in scanned.items() if k not in ("unit", "size")}
    assert effect.values(from_file.a, from_file.scanned | same) == told
    assert pickle.loads(pickle.dumps(one)).effect is effect


@pytest.mark.parametrize(("name", "key"), [("sensor_crosstalk", "share"), ("tangential_force", "leak")])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_share_of_the_tangential_force_has_its_sign_in_itself(name, key, sign):
    effect = library()[name]
    a, scanned = effect.coefficients_of({"dmu": 0.1, "friction": 0.35, key: 0.05 * sign})
    assert np.sign(a[-1]) == sign and effect.values(a, {"friction": 0.35} | scanned)[key] == pytest.approx(0.05 * sign)


@given(st.floats(1e-6, 1.0), st.floats(-3.1, 3.1))
def test_amplitude_and_phase_are_those_of_the_wave(amplitude, phase):
    a = cosine_and_sine(amplitude, phase)
    x = np.linspace(0, 7, 50)
    assert a[0] * np.cos(x) + a[1] * np.sin(x) == pytest.approx(amplitude * np.cos(x + phase), abs=1e-12)
    assert amplitude_and_phase(a) == pytest.approx((amplitude, phase))


def test_deviations_follow_from_the_coefficients_covariance():
    rng = np.random.default_rng(3)
    for name in ("gear_harmonic", "wheel_stiffness", "friction_windup", "tracker_drift", "tangential_force"):
        one = some(name, library()[name].places[0], size=0.5)
        draws = rng.multivariate_normal(one.a, 1e-4 * one.covariance, 4000)
        told = [one.effect.values(a, one.scanned) for a in draws]
        for key, sd in one.deviations.items():
            spread = np.std([t[key] for t in told], axis=0)
            assert np.asarray(sd) * 1e-2 == pytest.approx(spread, rel=0.08, abs=1e-12), (name, key)


def test_a_dropped_file_is_a_new_effect(tmp_path, monkeypatch):
    with dropped_effect(tmp_path, monkeypatch, "(1, 2)", "1e-4", "x.q[j - 1] ** 2"):
        effect = library()["brand_new"]
        _, _, rows, p = believed()
        columns = arm_columns(effect, 2, [{}], rows).at(rows, p.point, p.d_joints)
        assert columns[0, :, :, 0] == pytest.approx(p.d_joints[:, :, 1] * POSES.q[:, [1]] ** 2)
        planned = effect_of({"effect": "brand_new", "joint": 2, "k": 3e-5, "sd": {"k": 1e-6}})
        assert planned.a == pytest.approx([3e-5]) and planned.covariance == pytest.approx(np.array([[1e-12]]))
        sys.modules.pop("ocp.effects.brand_new", None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("EFFECT = Effect(", r"own_one.py, line 1: '\(' was never closed; correct it"),
        ("import math\nEFFECT = math.sinn", "own_one.py, line 2: AttributeError: .*sinn.*; correct it"),
        ("import math", "own_one.py: defines no EFFECT"),
        ("from ocp.effects.backlash import EFFECT", "own_one.py: there is an effect 'backlash' already"),
    ],
)
def test_a_dropped_file_that_is_no_effect_is_told(tmp_path, monkeypatch, text, words):
    (tmp_path / "own_one.py").write_text(text)
    monkeypatch.setattr(ocp.effects, "__path__", [*ocp.effects.__path__])
    monkeypatch.setenv(OWN_EFFECTS, str(tmp_path))
    forget_library()
    with pytest.raises(BadInput, match=words):
        library()
    sys.modules.pop("ocp.effects.own_one", None)
    forget_library()


def test_the_site_lists_the_whole_library():
    page = (Path(__file__).parents[2] / "docs" / "effects.md").read_text(encoding="utf-8")
    assert "```{effects}\n```" in page  # where docs/conf.py puts the table
    rows = effects_table().splitlines()[2:]
    assert [row.split()[1] for row in rows] == list(library())
    for row, line in zip(rows, effect_list().splitlines(), strict=True):  # a terminal has the same keys, ranges and units
        assert line.endswith(row.split(" | ")[1])
    assert "scale +-0..0.4" in effect_list() and "gear_ratio 50..300" in effect_list()
    assert "stiffness_N_m 20000..300000 N/m" in effect_list()


def test_deviations_over_variants_are_mean_squares_about_the_value_phases_the_short_way():
    wave, own = library()["gear_harmonic"], 1e-12 * np.eye(2)

    def of(order, amplitude, phase):
        return Active(wave, 1, cosine_and_sine(amplitude, phase), {"order": order}, own)

    found = deviations_among(of(8, 1e-4, 3.1), [(0.75, of(8, 1e-4, 3.1)), (0.25, of(9, 1.2e-4, -3.1))])
    assert found["order"] == pytest.approx(0.5)
    assert found["amplitude_rad"] == pytest.approx(np.sqrt(1e-12 + 0.25 * 4e-10), rel=1e-3)
    turned = 2 * np.pi - 6.2
    within = 0.75 * 1e-12 / 1e-8 + 0.25 * 1e-12 / 1.44e-8
    assert found["phase_rad"] == pytest.approx(np.sqrt(within + 0.25 * turned**2), rel=1e-3)
    assert "order" not in deviations_among(of(8, 1e-4, 3.1), [(1.0, of(8, 1e-4, 3.1))])


def test_a_frame_that_moved_may_have_done_so_before_the_first_row_or_inside_a_single_run():
    """A break at the first row takes no other instant away; where runs have breaks between them it is one of these."""
    for breaks, count in (([], 40), ([3.0], 41), ([3.0, 50.0], 2)):
        seen = replace(SEEN, time=np.linspace(3.0, 103.0, 500), breaks=np.array(breaks))
        for name in ("wheel_frame_shift", "clamp_slip"):
            at = [one["at_s"] for one in library()[name].scan(0, seen) if not any(one.get("side", ()))]
            assert len(at) == len(set(at)) == (count if name == "wheel_frame_shift" else 40 + len(breaks))
            assert (3.0 in at) == (3.0 in breaks)


def test_a_shift_is_as_likely_in_a_pause_as_the_pause_is_long():
    """Half evenly, half by time, of each nest for itself; slow growth as it was; before the first reading as long as all took."""
    time = np.array([0.0, 1.0, 2.0, 3.0, 97.0, 98.0, 99.0, 100.0])
    at = [0.0, 1.5, 50.0, 98.5]
    share = np.exp(odds_of_instants([{"at_s": t} for t in at], time)) / 4
    assert share == pytest.approx(0.5 / 4 + 0.5 * np.array([100.0, 1.0, 94.0, 1.0]) / 196.0)
    assert share.sum() == pytest.approx(1.0)
    scans = [{"target": name, "at_s": t} for name, last in (("a", 4), ("b", 2)) for t in at[:last][::-1]]
    other = 0.5 / 2 + 0.5 * np.array([1.0, 100.0]) / 101.0
    assert np.exp(odds_of_instants(scans, time)) == pytest.approx([*(4 * share[::-1]), *(2 * other)])
    slow = [{"at_s": 0.0, "until_s": 100.0}, *({"at_s": t, "until_s": t} for t in at)]
    assert np.exp(odds_of_instants(slow, time)) == pytest.approx([1.0, *(4 * share)])
    for none in ([{"order": 3.0}, {}], [{"at_s": 200.0}, {"at_s": 300.0}], [{"at_s": 1.5}]):
        assert not odds_of_instants(none, time).any()
    assert not odds_of_instants([{"at_s": 1.0}], np.full(2, np.nan)).any()
