"""`[[effects]]` of the cell are believed: in the baseline of every channel, named again only for what they are off by."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from ocp.diagnose import answering
from ocp.diagnose.answering import answer_of, of_another_arm, tracker_channel
from ocp.diagnose.corrected import calibration_of, summed
from ocp.diagnose.dataset import read_data_set, read_sealed
from ocp.diagnose.force.prior import arm_with_effects, posterior_of
from ocp.diagnose.interface import diagnose
from ocp.diagnose.joints.channel import joint_channel
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.answer import Followed
from ocp.effects.catalogue import library
from ocp.effects.cell_effects import effect_of
from ocp.effects.effect import Active
from ocp.shell.progress import Phases
from tests.support.diagnosis_folder import write_joint_folder, write_tracker_folder

PLAY = 3e-4  # rad, of joint 3


def believe(folder, **table):
    text = "".join(f"{key} = {value!r}\n".replace("'", '"') for key, value in table.items())
    with (folder / "cell.toml").open("a") as file:
        file.write(f"\n[[effects]]\n{text}")


def play_of(size):
    return {"effect": "backlash", "joint": 3, "half_width_rad": size}


def rms(channel):
    return 1e3 * float(np.sqrt(np.mean(np.sum(channel.gap() ** 2, axis=1))))


def test_a_believed_effect_is_in_the_baseline_of_readings_and_predictions(tmp_path):
    truth = write_tracker_folder(tmp_path / "a", seed=4, backlash=PLAY)
    ignorant = tracker_channel(read_data_set(tmp_path / "a"))
    believe(tmp_path / "a", **play_of(PLAY))
    data = read_data_set(tmp_path / "a")
    channel = tracker_channel(data)
    assert rms(channel) < 0.04 < 0.1 < rms(ignorant)
    sealed = read_sealed(data, "tracker")
    off = [1e3 * np.linalg.norm(c.predict(sealed, ()).baseline - truth, axis=1).mean() for c in (channel, ignorant)]
    assert off[0] < 0.04 < 0.1 < off[1]
    assert any("believes backlash of joint 3" in notice for notice in data.notices)


@pytest.mark.parametrize("turned", [0.0, 3e-4])
def test_readings_that_the_cells_own_calibration_misses_are_said_to_be_so(tmp_path, turned):
    """Of a calibration that believed what the cell believes: the play is in the cell, an axis was mastered anew or not."""
    write_tracker_folder(tmp_path / "a", seed=4, backlash=PLAY)
    believe(tmp_path / "a", **play_of(PLAY))
    data = read_data_set(tmp_path / "a")
    channel = tracker_channel(data)
    fit = posterior_of(data.setup.robot.name, channel.task.layout, channel.fit)
    values = fit.values + turned * (np.array(fit.names) == "th3")
    known = replace(fit, values=values, provenance=fit.provenance | {"held_out": {"random": {"mean_mm": 0.06}}})
    assert channel.one_arm is replace(channel, known=fit).one_arm is None  # nothing to compare with
    asked = replace(channel, known=known)
    assert asked.one_arm is (turned == 0.0)
    assert not turned or replace(asked, fit=replace(channel.fit, weight=np.zeros(len(channel.readings)))).one_arm is None
    told = list(of_another_arm([asked]))
    assert len(told) == (turned > 0)
    assert not told or told[0].startswith("tracker.csv: the cell's calibration misses these readings by over 2 times")


def test_what_is_named_is_no_other_arm(tmp_path):
    """Play that came since the calibration makes its arm miss the readings; once it has its name the wheel goes with the arm."""
    write_tracker_folder(tmp_path / "a", seed=4, backlash=PLAY)
    channel = tracker_channel(read_data_set(tmp_path / "a"))
    played = channel.with_active((effect_of(play_of(PLAY)).active,))
    fit = posterior_of("kr210_r2700_extra", played.task.layout, played.fit)
    known = replace(fit, provenance=fit.provenance | {"held_out": {"random": {"mean_mm": 0.06}}})
    assert replace(channel, known=known).one_arm is False and replace(played, known=known).one_arm is True


@pytest.mark.parametrize(("turned", "held_out"), [(0.0, 0.06), (3e-4, 0.06), (3e-3, None)])
def test_a_wheel_stays_where_the_arm_was_mastered_anew(tmp_path, turned, held_out):
    """Where the calibration tells no errors to compare with, by the chance."""
    write_tracker_folder(tmp_path / "a", seed=4)
    data = read_data_set(tmp_path / "a")
    channel = tracker_channel(data)
    fit = posterior_of(data.setup.robot.name, channel.task.layout, channel.fit)
    at, places = fit.names.index("th3"), range(len(fit.names))
    cross = fit.covariance[at] * 1.5  # the wheel was touched by this arm, 1.5 m away
    whole = np.block([[fit.covariance, cross[:, None]], [cross, np.array([[1.5**2 * fit.covariance[at, at] + 1e-10]])]])
    values = np.append(fit.values + turned * (np.arange(len(places)) == at), 1.7)
    told = fit.provenance | ({} if held_out is None else {"method": "full", "held_out": {"random": {"mean_mm": held_out}}})
    known = replace(fit, names=(*fit.names, "wheel_x"), values=values, covariance=whole, provenance=told)
    asked = replace(channel, known=known)
    written = calibration_of({"tracker": asked}, replace(data, setup=replace(data.setup, calibration=known)))
    for made in (written, arm_with_effects(asked, ())):  # in the corrected cell, and as a force log is told
        wheel = made.names.index("wheel_x")
        assert made.values[wheel] == pytest.approx(1.7, abs=1e-6)
        assert made.standard_deviation[wheel] > (4e-4 if turned else 0.0)
        assert bool(made.covariance[wheel, :wheel].any()) is (turned == 0.0)


def test_what_a_belief_is_off_by_is_named_and_the_corrected_cell_has_the_sum(tmp_path):
    believed = 1.8 * PLAY  # too much: what comes on top is negative, which no play is
    write_tracker_folder(tmp_path / "a", seed=4, backlash=PLAY)
    believe(tmp_path / "a", **play_of(believed))
    found = diagnose(tmp_path / "a", out=tmp_path / "out").answer.diagnosis
    (one,) = [a for a in found.active if a.key == ("backlash", 3)]
    assert abs(one.a[0] - (PLAY - believed)) < 0.15 * PLAY
    written = tomllib.loads((tmp_path / "out" / "corrected_cell.toml").read_text())["effects"]
    (table,) = [t for t in written if t["effect"] == "backlash" and t["joint"] == 3]
    assert abs(table["half_width_rad"] - PLAY) < 0.15 * PLAY


def test_a_believed_delay_is_in_the_baseline_of_link_encoders(tmp_path):
    write_joint_folder(tmp_path, seed=2, delay=6e-3)
    believe(tmp_path, effect="channel_delay", s=4e-3)
    data = read_data_set(tmp_path)
    channel = joint_channel(data.joints, data.setup.robot, data.setup.hanging, True, data.believed_by("joint"))
    delay = library()["channel_delay"]
    found = channel.with_active((Active(delay, 0, np.zeros(1), {}, np.zeros((1, 1))),))
    assert abs(found.active[0].a[0] - 2e-3) < 1e-4 and found.gap().std() < 0.1 * channel.gap().std()


def test_effects_add_up_where_they_are_the_same_and_stand_side_by_side_else():
    made = [effect_of(play_of(2e-4)).active, effect_of({"effect": "backlash", "joint": 5, "half_width_rad": 1e-4}).active]
    ripple = [
        effect_of({"effect": "gear_harmonic", "joint": 2, "order": k, "amplitude_rad": 1e-4, "phase_rad": 0.3}).active
        for k in (17.0, 18.0)
    ]
    total = {(a.key, a.scanned.get("order")): a.parameters for a in summed([made[0], ripple[0]], [made[0], *made[1:], *ripple])}
    assert total[("backlash", 3), None]["half_width_rad"] == pytest.approx(4e-4)
    assert total[("backlash", 5), None]["half_width_rad"] == pytest.approx(1e-4)
    assert total[("gear_harmonic", 2), 17.0]["amplitude_rad"] == pytest.approx(2e-4)
    assert total[("gear_harmonic", 2), 18.0]["amplitude_rad"] == pytest.approx(1e-4)
    # What acts at its own size is one effect of the whole size.
    sticks = [effect_of({"effect": "flange_friction", "N": n, "turn_N": turn}).active for n, turn in ((0.3, 0.3), (0.4, 1.5))]
    late = [effect_of({"effect": "time_delay", "s": s}).active for s in (0.01, 0.005)]
    (stick, delay) = summed([sticks[0], late[0]], [sticks[1], late[1]])
    assert stick.parameters == pytest.approx({"N": 0.7, "turn_N": 0.7})
    assert delay.parameters["s"] == pytest.approx(0.015) and delay.scanned["size"] == pytest.approx(0.015)
    # Not covers of other times, which both relax.
    pairs = (0.1, 18.0), (0.2, 0.15), (0.05, 0.15)
    slow, fast, more = (effect_of({"effect": "wheel_relaxation", "g": g, "tau": tau}).active for g, tau in pairs)
    both = [(*a.parameters.values(), a.scanned["acts_g"]) for a in summed([fast], [slow, more])]
    assert both == [pytest.approx((0.25, 0.15, 0.25)), pytest.approx((0.1, 18.0, 0.1))]


def test_what_a_channel_says_of_its_cell_is_in_the_answer(tmp_path, monkeypatch):
    write_tracker_folder(tmp_path / "a", seed=4)
    monkeypatch.setattr(TrackerChannel, "surprises", ("force.csv: of another cell",), raising=False)
    answer = answer_of(tmp_path / "a", Phases(), {"backlash": library()["backlash"]})
    assert "force.csv: of another cell" in answer.notices


def test_nothing_of_a_log_of_another_cell_is_patched(tmp_path, monkeypatch):
    write_tracker_folder(tmp_path / "a", seed=4)
    monkeypatch.setattr(answering, "unnamed", lambda found, _: Followed(found.baseline[0], found.channels[0], ()))
    monkeypatch.setattr(answering, "patched", lambda *_: "patch")
    for surprises, patch in (((), "patch"), (("force.csv: of another cell",), None)):
        monkeypatch.setattr(TrackerChannel, "surprises", surprises, raising=False)
        assert answer_of(tmp_path / "a", Phases(), {"backlash": library()["backlash"]}).patch == patch
