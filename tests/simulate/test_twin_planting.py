"""Effects as users write them and as they are drawn; machines of a seed, calibrated and sampled ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ocp.model.cell import read_cell, wheel_frame
from ocp.model.theta import registered
from ocp.simulate.twin.arm import arm_moments, make_arm
from ocp.simulate.twin.collide import true_wheel
from ocp.simulate.twin.planting import EFFECT_KINDS, Planted, draw_effect, labels, parse_effect
from ocp.simulate.twin.rehearsal import programmed_wheel
from ocp.simulate.twin.truth import draw_truth
from robots.calibration.store import Calibration
from robots.errors import BadInput

CELL = read_cell(Path(__file__).parents[2] / "ocp" / "data" / "cell.toml")
ROBOT = CELL.robot
T0 = CELL.tables.reference_temperature_C
LOW, HIGH = np.radians([-90, -120, -20, -170, -115, -170]), np.radians([90, -20, 140, 170, 115, 170])


def postures(n, seed=0):
    return np.random.default_rng(seed).uniform(LOW, HIGH, (n, 6))


# -- machines and their errors ---------------------------------------------------------------------------------------


def test_an_uncalibrated_machine_is_off_by_about_a_millimetre():
    m = arm_moments(postures(40), "grinder", T0)
    right = make_arm(CELL, draw_truth(CELL, 1, mode="believed")).flange(m)[:, :3, 3]
    mean = [np.linalg.norm(make_arm(CELL, draw_truth(CELL, s)).flange(m)[:, :3, 3] - right, axis=1).mean() for s in range(25)]
    assert 0.9e-3 < np.mean(mean) < 1.5e-3 and max(mean) < 3e-3


def test_the_same_seed_is_the_same_machine_whatever_is_planted():
    a, b = draw_truth(CELL, 7), draw_truth(CELL, 7, [parse_effect("backlash:5"), parse_effect("payload_mass")])
    for name, value in vars(a).items():
        if name == "effects":
            continue
        if isinstance(value, dict):
            assert all(np.array_equal(v, getattr(b, name)[k]) for k, v in value.items() if isinstance(v, np.ndarray))
        else:
            assert np.array_equal(value, getattr(b, name))
    other = draw_truth(CELL, 8)
    assert not np.allclose(a.placement, other.placement) and not np.allclose(a.T_tracker_base, other.T_tracker_base)


def test_a_machine_of_size_zero_is_the_believed_one_but_for_its_springs():
    zero, exact = draw_truth(CELL, 3, size=0.0, weight_bends="believed"), draw_truth(CELL, 3, mode="believed")
    m = arm_moments(postures(5), "grinder", T0)
    assert make_arm(CELL, zero).flange(m) == pytest.approx(make_arm(CELL, exact).flange(m), abs=1e-14)
    assert zero.cover_scale == 1.0 and zero.wheel_shift == pytest.approx(np.zeros(3))


class Estimates:
    """A calibration's part that the virtual cell reads."""

    names = ("th2", "a2", "c3", "wheel_x", "wheel_axis_u", "payload_mass", "blade_c", "flange_stiffness", "cover_stiffness_scale")
    names = (*names, "wheel_radius")
    values = np.array([1e-3, 1.151, 5e-7, 2e-4, 1e-4, 26.0, 3e-4, 6000.0, 0.1, -3e-4])
    covariance = np.diag(np.array([1e-5, 2e-5, 1e-8, 1e-5, 1e-5, 0.1, 1e-5, 50.0, 0.01, 1e-5]) ** 2)
    standard_deviation = np.sqrt(np.diag(covariance))


def test_the_wheel_of_a_program_is_the_one_that_the_updated_cell_has():
    names, values = ("wheel_x", "wheel_z", "wheel_radius"), np.array([2e-4, -1e-4, -9e-4])
    cell = replace(CELL, calibration=Calibration(ROBOT.name, names, values, np.diag(np.full(3, 1e-10))))
    wheel, really = (
        programmed_wheel(cell, wheel_frame(registered(cell)[0])),
        true_wheel(cell, draw_truth(cell, 1, mode="believed")),
    )
    assert wheel.radius == pytest.approx(really.radius) and wheel.radius == pytest.approx(CELL.wheel.radius - 9e-4)
    assert wheel.centre == pytest.approx(really.centre)


def test_believed_means_as_calibrated_and_sampled_scatters_about_it():
    cell = replace(CELL, calibration=Estimates())
    truth = draw_truth(cell, 1, mode="believed")
    assert truth.mdh[1, 0] == 1e-3 and truth.mdh[1, 2] == 1.151 and truth.stiffness[2] == pytest.approx(2e6)
    assert truth.payloads["grinder"][0] == 26.0 and truth.payloads["weight"][0] == 90.0
    assert truth.wheel_shift == pytest.approx([2e-4, 0, 0]) and truth.blade_turn == pytest.approx([3e-4, 0, 0])
    assert truth.wheel_radius == -3e-4 and true_wheel(cell, truth).radius == pytest.approx(CELL.wheel.radius - 3e-4)
    assert truth.wheel_axis_turn @ CELL.wheel.axis == pytest.approx(0.0) and np.linalg.norm(truth.wheel_axis_turn) > 9e-5
    assert truth.flange_scale == pytest.approx(6000 / 5600) and truth.cover_scale == pytest.approx(1.1)
    assert draw_truth(cell, 1).mdh == pytest.approx(ROBOT.mdh)  # the virtual machine does not know of the calibration
    drawn = np.array([draw_truth(cell, s, mode="sampled").mdh[1, 2] for s in range(200)])
    assert drawn.mean() == pytest.approx(1.151, abs=6e-6) and drawn.std() == pytest.approx(2e-5, rel=0.2)
    with pytest.raises(BadInput, match="no calibration"):
        draw_truth(CELL, 1, mode="sampled")


def test_repeatability_is_drawn_once_a_visit():
    arm, q = make_arm(CELL, draw_truth(CELL, 1)), np.tile(postures(1), (300, 1))
    loose = arm_moments(q, "grinder", T0)
    once = replace(loose, visit=np.zeros(300, np.int64))
    rng = np.random.default_rng(0)
    assert np.ptp(arm.flange(once, rng)[:, :3, 3], axis=0).max() < 1e-12
    scatter = arm.flange(loose, rng)[:, :3, 3].std(axis=0)
    assert 5e-6 < np.linalg.norm(scatter) < 6e-5


# -- planting --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("backlsh:5=2e-4", "the nearest is 'backlash'"),
        ("backlash=1e-4", "needs a joint"),
        ("backlash:7=1e-4", "not of joint '7'"),
        ("backlash:x=1e-4", "not of joint 'x'"),
        ("link_thermal:2=1e-5", "belongs to no joint"),
        ("backlash:5=wide", "not a number"),
        ("backlash:5=inf", "not finite"),
        ("backlash:5=1e-4,2e-4", "names no key"),
        ("backlash:5=1e-4,width=3", "its keys are half_width_rad"),
        ("backlash:5=1e-4,half_width_rad=3", "given twice"),
        ("base_tilt=1e-4", "3 are needed"),
        ("gear_harmonic:2=1e-4,order=2.5", "whole number"),
        ("wrist_coupling:4=1e-3,source_joint=4", "the joint itself"),
        ("wrist_coupling:4=1e-3,source_joint=2", "no such joint; give another of 4, 5, 6"),
        ("joint_coupling:4=1e-3,source_joint=7", "no such joint"),
    ],
)
def test_what_cannot_be_planted_is_told_in_one_sentence(text, said):
    with pytest.raises(BadInput) as error:
        parse_effect(text)
    assert said in str(error.value) and "\n" not in str(error.value) and text in str(error.value)


def test_effects_are_read_and_labelled_as_the_catalogue_has_them():
    assert labels([parse_effect("backlash:5=2e-4")]) == [{"effect": "backlash", "joint": 5, "half_width_rad": 2e-4}]
    assert labels([parse_effect("gear_harmonic:4=8e-5,order=19,phase_rad=1")]) == [
        {"effect": "gear_harmonic", "joint": 4, "amplitude_rad": 8e-5, "order": 19, "phase_rad": 1.0}
    ]
    assert labels([parse_effect("payload_com=0.01/0/0.02")]) == [
        {"effect": "payload_com", "joint": None, "shift_m": [0.01, 0, 0.02]}
    ]
    assert parse_effect("gravity_compensator").joint == 2 and parse_effect("channel_delay").joint is None
    with pytest.raises(BadInput, match="no target 'T9'"):
        draw_truth(CELL, 1, [parse_effect("target_shift=1e-4/0/0,target=T9")])


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(EFFECT_KINDS)), st.integers(0, 10_000))
def test_drawn_effects_lie_in_their_typical_range(name, seed):
    kind = EFFECT_KINDS[name]
    planted = draw_effect(np.random.default_rng(seed), kind)
    assert isinstance(planted, Planted) and list(planted.values) == [key.name for key in kind.keys]
    assert planted.joint in kind.joints if planted.joint is not None else not kind.joints or kind.common
    for key in kind.keys:
        if key.unit == "name":
            continue
        value = planted.vector(key.name)
        size = np.linalg.norm(value) if key.length == 3 else np.abs(value).max()
        scale = key.scale[planted.joint - 1] if key.scale else 1.0
        if key.low < 0:
            assert key.low <= value.min() and value.max() <= key.high
            continue
        assert key.low * scale * 0.999 <= size <= key.high * scale * 1.001
        assert key.signed or value.min() >= 0


@pytest.mark.parametrize("text", ["backlash:5=1e300", "backlash:" + "9" * 5000 + "=1e-4", "x" * 500, "backlash:５=1e-4"])
def test_an_effect_without_bounds_is_refused_in_a_short_sentence(text):
    with pytest.raises(BadInput) as error:
        parse_effect(text)
    assert len(str(error.value)) < 400


def test_an_update_does_not_change_what_the_belt_takes_off():
    """What it found of the belt stands in the cell, what the cell was written with in its history: that is the machine's."""
    nothing = Calibration(ROBOT.name, (), np.zeros(0), np.zeros((0, 0)), {}, {}, ())
    stated = replace(CELL, process=replace(CELL.process, preston=3e-11, preston_sd=None))
    for cell, told in ((stated, [3e-11, 0.0]), (replace(CELL, process=replace(CELL.process, preston=None)), [0.0, 0.0])):
        since = replace(nothing, provenance={"update": {"stated_preston": told}})
        found = replace(cell, calibration=since, process=replace(cell.process, preston=5e-12, preston_sd=1e-13))
        assert draw_truth(found, 4).preston == draw_truth(cell, 4).preston
    assert draw_truth(stated, 4).preston > 2.0 * draw_truth(CELL, 4).preston
