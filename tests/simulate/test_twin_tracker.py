"""The virtual tracker and its data sets: noise, planted faults, formats, and a calibration that ends where real ones do."""

import csv
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import f, kstest, norm, t

from ocp.calibrate.tracker import as_in
from ocp.model.cell import read_cell, read_tracker_setup
from ocp.simulate.twin.arm import arm_moments, make_arm
from ocp.simulate.twin.planting import parse_effect
from ocp.simulate.twin.tracker import (
    TrackerCampaign,
    TrackerLog,
    design_from_poses,
    instrument,
    measure,
    nest_links,
    random_design,
    sealed_design,
    tracker_world,
    true_points,
)
from ocp.simulate.twin.truth import draw_truth
from robots.calibration.fit import fit_campaign, learned_priors, predict_readings
from robots.calibration.layout import Choice
from robots.calibration.solver import Campaign as Readings
from robots.errors import BadInput
from robots.tracker_readings import read_readings
from tests.support.twin_world import random_world

BUNDLED = Path(__file__).parents[2] / "ocp" / "data" / "cell.toml"
HEAVY = "[payloads.weight]"


@pytest.fixture(scope="module")
def cell_path(tmp_path_factory):
    """The bundled cell with a fourth payload and nests on a link, one of them a 6D target."""
    text = BUNDLED.read_text(encoding="utf-8")
    text = text.replace(HEAVY, "[payloads.heavy]\nmass_kg = 150.0\ncom_mm = [10, -10, 220]\n" + HEAVY)
    path = tmp_path_factory.mktemp("cell") / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def cell(cell_path):
    return read_cell(cell_path)


def campaign(cell, n=40, seed=0, **options):
    return random_design(cell, np.random.default_rng(seed), n, **options)


# -- the instrument --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [2.0, 8.0])
def test_noise_along_and_across_the_beam_is_the_instruments(cell, distance):
    rng = np.random.default_rng(3)
    direction = np.array([0.5, -0.7, 0.4])
    direction /= np.linalg.norm(direction)
    points = np.tile(distance * direction, (20000, 1))
    off = instrument(cell, 0.0, points, rng) - points
    along = off @ direction
    across = off - along[:, None] * direction
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    wanted = 8e-6 + 3e-6 * distance
    assert along.std() == pytest.approx(8e-6, rel=0.03)
    for way in (side, np.cross(direction, side)):
        assert (across @ way).std() == pytest.approx(wanted, rel=0.03)
    assert abs(off.mean(axis=0)).max() < 4 * wanted / np.sqrt(20000)


def test_noise_with_tails_is_students(cell):
    """Cell's noise times Student's factor, one for all three coordinates of a reading."""
    points = np.tile([3.0, 0.0, 0.0], (20000, 1))
    off = instrument(cell, 0.0, points, np.random.default_rng(2), tails=4.0) - points
    white = off / [8e-6, 8e-6 + 9e-6, 8e-6 + 9e-6]
    for way in white.T:
        assert kstest(way, t(4).cdf).pvalue > 1e-3 > kstest(way, norm.cdf).pvalue
    # A squared distance of three is 3 F(3, 4); three factors of their own would make long ones rarer.
    assert kstest((white**2).sum(axis=1) / 3.0, f(3, 4).cdf).pvalue > 1e-3


def test_gross_readings_are_as_many_as_said(cell):
    points = np.tile([2.0, 1.0, 0.5], (20000, 1))
    off = np.linalg.norm(instrument(cell, 0.05, points, np.random.default_rng(1)) - points, axis=1)
    assert np.mean(off > 2e-4) == pytest.approx(0.05, rel=0.1) and 5e-3 < off.max() < 1.1e-2


def test_the_head_stands_in_front_and_nests_are_about_a_millimetre_off(cell):
    nests, heads = [], []
    for seed in range(60):
        truth = draw_truth(cell, seed)
        heads.append(-truth.T_tracker_base[:3, :3].T @ truth.T_tracker_base[:3, 3])
        nests.append([truth.nests[name] - 1e-3 * np.array(cell.tables.tracker.targets[name]) for name in truth.nests])
    distance = np.linalg.norm(np.array(heads)[:, :2], axis=1)
    assert 2.5 <= distance.min() and distance.max() <= 5.0 and np.array(heads)[:, 0].min() > 1.0
    assert np.std(nests) == pytest.approx(1e-3, rel=0.15)


# -- planted in the tracker ------------------------------------------------------------------------------------------


def points_with(cell, design, *effects):
    truth = draw_truth(cell, 2, [parse_effect(e) for e in effects])
    return truth, true_points(truth, cell, make_arm(cell, truth), design.moments, design.targets)


def test_the_frame_drifts_and_scales_as_the_catalogue_says(cell):
    design = campaign(cell)
    hours = design.moments.time_s[:, None] / 3600
    _, plain = points_with(cell, design)
    shift, turn = np.array([3e-5, -5e-5, 1e-5]), np.array([1e-5, 0.0, -2e-5])
    _, drifted = points_with(cell, design, "tracker_drift=3e-5/-5e-5/1e-5,rad_per_h=1e-5/0/-2e-5")
    assert drifted - plain == pytest.approx(hours * (shift + np.cross(turn, plain)), abs=3e-8)
    _, scaled = points_with(cell, design, "tracker_scale=-7e-6")
    assert scaled - plain == pytest.approx(-7e-6 * plain, abs=1e-12)
    warm = design.moments.temperature_C[:, None] - cell.tables.reference_temperature_C
    assert points_with(cell, design, "air_scale=9e-7")[1] - plain == pytest.approx(9e-7 * warm * plain, abs=1e-12)
    _, turned = points_with(cell, design, "azimuth_harmonic=2e-5,order=3,phase_rad=0.5")
    azimuth = np.arctan2(plain[:, 1], plain[:, 0])
    found = (np.arctan2(turned[:, 1], turned[:, 0]) - azimuth + np.pi) % (2 * np.pi) - np.pi
    assert found == pytest.approx(2e-5 * np.cos(3 * azimuth + 0.5), abs=1e-12) and np.ptp(found) > 2e-5
    assert turned[:, 2] == pytest.approx(plain[:, 2]) and np.hypot(*turned.T[:2]) == pytest.approx(np.hypot(*plain.T[:2]))


def test_one_nest_moves_from_its_time_on(cell):
    design = campaign(cell)
    _, plain = points_with(cell, design)
    truth, moved = points_with(cell, design, "target_shift=1e-4/2e-4/-5e-5,target=T2,at_s=5000")
    links = make_arm(cell, truth).links(design.moments)[:, 6, :3, :3]
    wanted = (truth.T_tracker_base[:3, :3] @ links) @ [1e-4, 2e-4, -5e-5]
    late = np.array([n == "T2" for n in design.targets]) & (design.moments.time_s >= 5000)
    assert 3 < late.sum() < 30
    assert moved - plain == pytest.approx(np.where(late[:, None], wanted, 0.0), abs=1e-12)


def test_repeats_scatter_by_instrument_and_joints_alone(cell):
    truth = replace(draw_truth(cell, 4), outliers=0.0)
    one = campaign(cell, 2)
    first = one.moments
    m = arm_moments(np.tile(first.q[0], (400, 1)), (first.payload[0],) * 400, first.temperature_C[0], first.approach[0])
    arm, names = make_arm(cell, truth), (one.targets[0],) * 400
    off = measure(truth, cell, arm, m, names, np.random.default_rng(5)) - true_points(truth, cell, arm, m, names)
    assert np.abs(off.mean(axis=0)).max() < 6e-6 and 1.2e-5 < np.sqrt(np.mean(np.sum(off**2, axis=1))) < 8e-5


# -- designs and files -----------------------------------------------------------------------------------------------


def test_campaigns_are_within_limits_mixed_and_repeat_some_readings(cell):
    design, sealed = campaign(cell, 150), sealed_design(cell, np.random.default_rng(1))
    m, robot = design.moments, cell.robot
    assert len(design) == 150 and len(np.unique(m.q, axis=0)) < 150 and np.all(np.diff(m.time_s) >= 0)
    assert ((m.q > robot.q_min) & (m.q < robot.q_max)).all() and np.abs(m.q[:, 0]).max() <= np.radians(92)
    assert set(m.payload) == {"grinder", "bare", "weight"} and "heavy" in sealed.moments.payload
    assert sum(a != b for a, b in zip(m.payload, m.payload[1:], strict=False)) == 2
    assert set(np.unique(m.approach)) == {-1.0, 1.0} and np.ptp(m.temperature_C) > 5
    frames = make_arm(cell, draw_truth(cell, 0, mode="believed")).links(m)[:, 4:, :3, 3]
    assert frames[..., 2].min() > 0.1 and np.hypot(frames[..., 0], frames[..., 1]).min() > 0.5
    assert sealed.moments.time_s.min() > m.time_s.max() and np.ptp(sealed.moments.temperature_C) == 0


def test_a_world_is_read_as_any_campaign_and_its_labels_tell_what_was_planted(cell_path, tmp_path):
    effects = [parse_effect("backlash:2=1e-4"), parse_effect("link_thermal")]
    start = time.perf_counter()
    truth = random_world(cell_path, tmp_path, 5, effects)
    assert time.perf_counter() - start < 5.0
    setup = read_tracker_setup(tmp_path / "cell.toml")
    readings = read_readings(tmp_path / "tracker.csv", setup.payloads, setup.instrument)
    sealed = read_readings(tmp_path / "sealed_tracker.csv", setup.payloads, setup.instrument, sealed=True)
    assert len(readings) == 150 and len(sealed) == 120 and not readings.notices
    told = json.loads((tmp_path / "labels" / "labels.json").read_text())
    assert told["seed"] == 5 and [label["effect"] for label in told["labels"]] == ["backlash", "link_thermal"]
    with (tmp_path / "labels" / "sealed_tracker_truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    cell = read_cell(tmp_path / "cell.toml")
    m = arm_moments(sealed.q, tuple(r["payload"] for r in rows), sealed.temperature, sealed.approach, sealed.time)
    exact = true_points(truth, cell, make_arm(cell, truth), m, [r["target"] for r in rows])
    assert 1e-3 * np.array([[float(r[f"{c}_mm"]) for c in "xyz"] for r in rows]) == pytest.approx(exact, abs=2e-7)
    again = tmp_path / "again"
    random_world(cell_path, again, 5, effects)
    for name in ("tracker.csv", "sealed_tracker.csv", "labels/labels.json"):
        assert (again / name).read_bytes() == (tmp_path / name).read_bytes()


def test_a_world_of_the_shared_cell_has_the_same_columns(shared_data, tmp_path):
    given = shared_data / "worlds" / "tracker_no_effect"
    random_world(given / "cell.toml", tmp_path, 1, readings=12, blind=6)
    for name in ("tracker.csv", "sealed_tracker.csv", "labels/sealed_tracker_truth.csv"):
        made, there = ((folder / name).read_text().splitlines()[0] for folder in (tmp_path, given))
        assert made == there


def test_links_and_six_dimensional_targets_are_written_as_the_format_has_them(cell_path, tmp_path):
    more = "T4 = { link = 3, xyz_mm = [0, 0, 300] }\nT5 = { xyz_mm = [0, 0, 250], abc_deg = [10, 20, -30] }\n"
    path = tmp_path / "cell.toml"
    path.write_text(cell_path.read_text(encoding="utf-8") + more, encoding="utf-8")
    cell = read_cell(path)
    truth = replace(draw_truth(cell, 3), outliers=0.0)
    q = campaign(cell, 10).moments.q
    m = arm_moments(q, "grinder", 22.0)
    names = ("T4", "T5") * 5
    assert nest_links(cell, names).tolist() == [3, 6] * 5
    tracker_world(tmp_path / "world", cell, truth, TrackerLog(TrackerCampaign(m, names), None))
    setup = read_tracker_setup(tmp_path / "world" / "cell.toml")
    readings = read_readings(tmp_path / "world" / "tracker.csv", setup.payloads, setup.instrument)
    assert readings.turned.tolist() == [False, True] * 5
    links = make_arm(cell, truth).links(m)[1::2, 6, :3, :3]
    mount = Rotation.from_euler("ZYX", [10, 20, -30], degrees=True).as_matrix()
    turn = np.swapaxes(truth.T_tracker_base[:3, :3] @ links @ mount, 1, 2) @ readings.turn[1::2]
    angle = np.linalg.norm(Rotation.from_matrix(turn).as_rotvec(), axis=1)
    assert 1e-4 < angle.max() < 1.2e-2  # the mount's own turn, and the instrument's noise


def test_poses_of_the_planner_become_a_campaign(cell, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(
        "target,payload,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,approach1,approach2,approach3,approach4,approach5,approach6\n"
        "T2,weight,10,-60,70,20,30,40,1,-1,1,1,-1,1\nT1,grinder,11,-61,71,21,31,41,-1,1,-1,-1,1,-1\n"
    )
    design = design_from_poses(cell, path)
    assert design.targets == ("T2", "T1") and design.moments.payload == ("weight", "grinder")
    assert np.degrees(design.moments.q[1]) == pytest.approx([11, -61, 71, 21, 31, 41])
    path.write_text(path.read_text().replace("T2", "T8"))
    with pytest.raises(BadInput, match=r"line 2, column target: T8 is not in cell.toml \(T1, T2, T3\)"):
        design_from_poses(cell, path)
    path.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n1,-60,70,4,5,6\n")
    assert design_from_poses(cell, path).targets == ("T1",)


# -- what a perfect calibration leaves -------------------------------------------------------------------------------


def test_a_calibration_ends_at_the_floor_of_a_real_robot(cell_path, tmp_path):
    means = []
    for seed in (21, 22, 23):
        folder = tmp_path / str(seed)
        random_world(cell_path, folder, seed)
        setup = read_tracker_setup(folder / "cell.toml")
        readings = read_readings(folder / "tracker.csv", setup.payloads, setup.instrument)
        sealed = as_in(read_readings(folder / "sealed_tracker.csv", setup.payloads, setup.instrument, sealed=True), readings)
        first = fit_campaign(Readings(setup.robot, readings, setup.payloads, setup.instrument), Choice(joints=(2, 3)))
        fit = fit_campaign(first.campaign, first.choice, learned_priors(first), begin=first.state)
        with (folder / "labels" / "sealed_tracker_truth.csv").open(newline="") as file:
            exact = 1e-3 * np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in csv.DictReader(file)])
        means.append(np.linalg.norm(predict_readings(fit, sealed)[0] - exact, axis=1).mean())
    assert 0.015e-3 < np.mean(means) < 0.05e-3
