"""Readings and a force log of one machine: what an effect explains in the readings leaves the arm that the log is fitted with."""

import csv
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.calibrate.force.fit import FIT_NAMES
from ocp.calibrate.force.log import is_known, log_mark
from ocp.calibrate.force.registration import told_of
from ocp.diagnose.answering import channels_of, tracker_channel
from ocp.diagnose.corrected import calibration_of
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.force.channel import ForceChannel, force_channel
from ocp.diagnose.force.held_out import at_known_sizes
from ocp.diagnose.force.prior import arm_with_effects, contact_prior
from ocp.diagnose.verdict.answer import known_beside
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import library
from ocp.effects.effect import Active
from ocp.shell.progress import Phases
from robots.errors import BadInput, Infeasible
from tests.support.house import ROOT

WORLDS = ROOT.parent / "shared" / "data" / "worlds"
SCALE = 3e-4


def folder_with(folder, scale):
    """A force world with the readings of a tracker world, whose encoder of joint 3 counts `scale` too little."""
    folder.mkdir()
    for name in ("cell.toml", "blade.stl"):
        shutil.copyfile(WORLDS / "force_no_effect" / name, folder / name)
    with (WORLDS / "force_no_effect" / "force.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    with (folder / "force.csv").open("w", newline="") as file:
        csv.writer(file).writerows([rows[0], *rows[1::15]])
    with (WORLDS / "tracker_no_effect" / "tracker.csv").open(newline="") as file:
        readings = list(csv.DictReader(file))
    for row in readings:
        row["q3_deg"] = f"{float(row['q3_deg']) / (1 + scale):.9f}"
    with (folder / "tracker.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(readings[0]))
        writer.writeheader()
        writer.writerows(readings)
    return folder


@pytest.fixture(scope="module")
def channels(solved_once, tmp_path_factory):
    if not WORLDS.is_dir():
        pytest.skip("no ../shared/data/worlds")
    return channels_of(read_data_set(folder_with(tmp_path_factory.mktemp("both") / "off", SCALE)), Phases())


def test_what_an_encoder_explains_is_not_in_the_arm_twice(channels, tmp_path):
    """Else a corrected cell holds it in geometry and as an effect: 3.5 N too much where 2.4 N were wrong."""
    readings, off = channels
    assert off.tracker is readings
    made = off.with_active((Active(library()["encoder_scale"], 3, np.array([SCALE]), {}, np.zeros((1, 1))),))
    sound = read_data_set(folder_with(tmp_path / "sound", 0.0))
    known = contact_prior(sound.cell, arm_with_effects(tracker_channel(sound), ()))
    geometry, wrong, right = (prior.mean[:30] for prior in (known, off.problem.believed, made.problem.believed))
    assert FIT_NAMES[29] == "be6" and np.abs(wrong - geometry).max() > 1e-4
    assert np.abs(right - geometry).max() < 0.2 * np.abs(wrong - geometry).max()
    # A force acts on an arm that bends where its readings say so.
    arm = arm_with_effects(tracker_channel(sound), ())
    bent = replace(arm, provenance=arm.provenance | {"bending_joints": [2, 3, 5]})
    assert force_channel(sound.cell, sound.log, arm=bent).problem.scene.cell.compliant_joints == (2, 3, 5)


def test_wheel_and_blade_are_those_beside_the_effects_that_are_written(channels):
    """A wave of the arm has any size for a log of few postures: wheel and arm were written beside the log's, the wave as readings
    tell it, and a plan pressed 0.8 N too little where the log was met within 0.04 N."""
    readings, off = (c.with_active((Active(library()["gear_2x"], 3, np.zeros(2), {}, np.zeros((2, 2))),)) for c in channels)
    data = read_data_set(off.log.path.parent)
    alone, beside = (calibration_of({"tracker": readings, "force": off}, data, w) for w in ((), readings.active))
    i = [alone.names.index(name) for name in ("wheel_x", "blade_x", "blade_y")]
    assert np.diag(beside.covariance)[i].sum() < 0.7 * np.diag(alone.covariance)[i].sum()
    assert np.abs(off.active[0].a - readings.active[0].a).max() > 1e-5 < np.abs(beside.values - alone.values)[i].max()


def test_a_corrected_cell_remembers_the_log_that_it_was_made_from(channels):
    """An update took it a second time, and was twice as sure."""
    readings, off = channels
    data = read_data_set(off.log.path.parent)
    made = calibration_of({"tracker": readings, "force": off}, data)
    told = made.provenance["force"]
    assert is_known(log_mark(data.log), [told["recordings"]]) and told["clock_s"] == data.log.clock.max()
    known = replace(made, provenance={"force": {"recordings": "a b"}, "update": {"logs": ["c d", "e"]}})
    began = replace(data, setup=replace(data.setup, calibration=known))
    told = calibration_of({"force": off}, began).provenance["force"]["recordings"]
    assert told == f"a b c d e {log_mark(data.log)}" and is_known("c d", [told]) and is_known("e", [told])
    edited = replace(known, provenance={"force": 3, "update": {"logs": "x"}})
    assert told_of(data.log, edited)["recordings"] == log_mark(data.log)


def test_what_the_readings_tell_is_told_beside_a_log_that_no_name_fits(channels, monkeypatch):
    original = ForceChannel.with_active

    def restless(self, active):
        if any(not self.blind(a.effect) for a in active):
            raise Infeasible("no rest")
        return original(self, active)

    monkeypatch.setattr(ForceChannel, "with_active", restless)
    names = ("encoder_scale", "joint_compliance", "geometry", "sensor_bias", "sensor_gain", "wheel_wear")
    found = diagnose_channels(channels, {n: e for n, e in library().items() if n in names})
    assert [a.key for a in found.active] == [("encoder_scale", 3)] and found.verdict == "partly"
    assert [c.name for c in found.channels] == ["tracker", "force"] and not found.channels[1].active
    assert any(why.startswith("force: 3 fits in a row") for why in found.unknown_reasons)


def test_a_log_of_single_rows_is_refused_in_one_sentence(tmp_path):
    for name in ("cell.toml", "blade.stl"):
        shutil.copy(WORLDS / "force_no_effect" / name, tmp_path / name)
    with (WORLDS / "force_no_effect" / "force.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    run = head.index("run")
    with (tmp_path / "force.csv").open("w", newline="") as file:
        csv.writer(file).writerows([head, *([*row[:run], str(k), *row[run + 1 :]] for k, row in enumerate(rows[:300]))])
    with pytest.raises(BadInput, match="0 rows in contact follow another one of their recording; at least 20 are needed"):
        read_data_set(tmp_path)


def test_known_beside_a_signal_is_what_others_show_too():
    one, two, alone = (SimpleNamespace(key=(name, 0)) for name in ("one", "two", "alone"))
    channels = [SimpleNamespace(name="tracker", active=(one, two)), SimpleNamespace(name="force", active=(one, alone))]
    assert known_beside("force", channels, (one, alone)) == (one,)
    assert known_beside("tracker", channels, (one, two, alone)) == (one, alone)


def test_predicted_forces_take_the_sizes_that_are_written():
    """Against the posterior of log and another signal's reading of the size together."""
    rng, sd = np.random.default_rng(3), 2e-4
    J, y, root = rng.normal(size=(40, 6)), rng.normal(size=40), rng.normal(size=(4, 3))
    wave, scale = library()["gear_2x"], replace(library()["encoder_scale"], prior_sd=(sd,))
    units = np.array([sd, *wave.prior_sd])  # unknowns: three of the nuisance, the scale's size, the wave's two
    z, other, precise = np.linalg.solve(np.eye(6) + J.T @ J, J.T @ y), 0.6, 50.0
    active = (
        Active(scale, 2, units[:1] * z[3:4], {}, np.zeros((1, 1))),
        Active(wave, 3, units[1:] * z[4:], {}, np.zeros((2, 2))),
    )
    told = np.eye(6) + J.T @ J
    at = SimpleNamespace(x=root @ z[:3], active=active)
    fit = SimpleNamespace(information=told, active=active, at=at)
    problem = SimpleNamespace(sizes=(3, 0), believed=SimpleNamespace(root=root))
    both = told + np.diag([0, 0, 0, precise, 0, 0])
    expected, covariance = np.linalg.solve(both, J.T @ y + np.eye(6)[3] * precise * other), np.linalg.inv(both)
    known = replace(active[0], a=units[:1] * expected[3], covariance=covariance[3:4, 3:4] * sd**2)
    x, moved, found = at_known_sizes(problem, fit, (known,))
    assert x == pytest.approx(root @ expected[:3], abs=1e-12) and found == pytest.approx(covariance, abs=1e-12)
    assert np.concatenate([a.a for a in moved]) == pytest.approx(units * expected[3:], rel=1e-9)
    x, moved, found = at_known_sizes(problem, fit, ())
    assert (x == at.x).all() and (found == np.linalg.inv(told)).all()
    assert all((one.a == other.a).all() for one, other in zip(moved, active, strict=True))
