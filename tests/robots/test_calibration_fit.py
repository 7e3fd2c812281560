"""The calibration recovers what was injected by an arm that shares no code with its model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robots.calibration.fit import fit_campaign, learned_priors, predict_readings, with_turn_sd
from robots.calibration.identifiability import identify
from robots.calibration.layout import Choice, Priors
from robots.calibration.load_tests import load_pairs, load_test
from robots.calibration.methods import METHODS, calibrate_by, equal_torque_pairs
from robots.calibration.noise import repeat_scatter
from robots.calibration.reading_model import RowInputs, predict, predict_points
from robots.calibration.residuals import linearise
from robots.calibration.solver import Campaign
from robots.calibration.validation import by_kind, folds, validate
from robots.gravity import GRAVITY
from robots.reference_kinematics import elementary_frames
from robots.tracker_readings import Hanging, Nest
from tests.support.reference_arm import elementary_weight_torques
from tests.support.simulated_campaign import EXTRA, INSTRUMENT, NESTS, PAYLOADS, campaign_readings, measured, random_truth

PRIORS = Priors(3e-4, 3e-4)


def campaign(seed=0, n=60, outliers=0.0, **truth_options):
    rng = np.random.default_rng(seed)
    truth = random_truth(rng, **truth_options)
    return truth, Campaign(EXTRA, measured(truth, campaign_readings(rng, n), rng, outliers), PAYLOADS, INSTRUMENT), rng


def held_out_error(fit, truth, rng, n=80):
    fresh = campaign_readings(rng, n)
    points, covariance = predict_readings(fit, fresh)
    return points - truth.points(fresh), covariance


# -- the model of a reading ------------------------------------------------------------------------------------------


def random_rows(rng, n=20, load=0.0, load_link=6, nest_link=6):
    return RowInputs(
        q=rng.uniform(np.radians([-90, -120, -20, -170, -115, -170]), np.radians([90, -20, 140, 170, 115, 170]), (n, 6)),
        payload=np.tile([90.0, 0.0, 0.02, 0.2], (n, 1)),
        load=rng.normal(size=(n, 6)) * load,
        load_place=rng.normal(size=(n, 3)) * 0.1,
        nest=np.tile([0.15, -0.05, 0.25], (n, 1)),
        nest_link=nest_link,
        load_link=load_link,
    )


@pytest.mark.parametrize(("nest_link", "load_link", "load"), [(6, 6, 0.0), (6, 3, 300.0), (3, 6, 200.0), (0, 2, 100.0)])
def test_derivatives_are_those_of_the_prediction(nest_link, load_link, load):
    rng = np.random.default_rng(1)
    arm = np.concatenate([(EXTRA.mdh + rng.normal(size=(6, 5)) * 1e-3).ravel(), 1 / EXTRA.stiffness])
    rows = random_rows(rng, load=load, load_link=load_link, nest_link=nest_link)
    p = predict(EXTRA, arm, rows)
    scale = np.where(np.arange(36) < 30, 1e-6, 1e-9)
    d = rng.normal(size=36) * scale
    plus, minus = (predict_points(EXTRA, arm + s * d, rows) for s in (1, -1))
    wanted = p.d_arm @ d
    # One fixed-point step less than infinite leaves 1e-5 of the derivative.
    assert np.abs((plus[0] - minus[0]) / 2 - wanted).max() <= 1e-4 * np.abs(wanted).max() + 1e-13
    spin = ((plus[1] - minus[1]) / 2) @ np.swapaxes(p.R, 1, 2)
    turned = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    assert np.abs(turned - p.spin_arm @ d).max() <= 1e-4 * np.abs(turned).max() + 1e-13
    for change, derivative in (("q", p.d_joints), ("payload", p.d_payload), ("nest", p.d_nest)):
        step = rng.normal(size=getattr(rows, change).shape[1]) * 1e-6
        plus, minus = (predict_points(EXTRA, arm, replace(rows, **{change: getattr(rows, change) + s * step})) for s in (1, -1))
        assert np.abs((plus[0] - minus[0]) / 2 - derivative @ step).max() <= 1e-4 * np.abs(derivative @ step).max() + 1e-13


def test_a_pull_bends_the_arm_as_elementary_statics_say():
    rng = np.random.default_rng(2)
    rows = random_rows(rng, load=0.0)
    load = np.tile([0.0, 0.0, -500.0, 0.0, 0.0, 0.0], (20, 1))
    arm = np.concatenate([EXTRA.mdh.ravel(), 1 / EXTRA.stiffness])
    got = predict_points(EXTRA, arm, replace(rows, load=load, load_place=np.zeros((20, 3))))[0]
    # The same weight hung on the flange is a payload of the same mass.
    heavier = replace(rows, payload=np.zeros((20, 4)))
    only_load = predict_points(EXTRA, arm, replace(heavier, load=load, load_place=np.zeros((20, 3))))[0]
    as_mass = predict_points(EXTRA, arm, replace(heavier, payload=np.tile([500.0 / GRAVITY, 0, 0, 0], (20, 1))))[0]
    assert only_load == pytest.approx(as_mass, abs=1e-12)
    assert np.linalg.norm(got - predict_points(EXTRA, arm, rows)[0], axis=1).min() > 1e-5
    # And by elementary motions: q + c tau to the end, then the frames.
    q = rows.q
    for _ in range(10):
        q = rows.q + elementary_weight_torques(EXTRA, q, GRAVITY, 500.0 / GRAVITY) / EXTRA.stiffness
    T = elementary_frames(EXTRA, q)[:, 6]
    assert only_load == pytest.approx(T[:, :3, :3] @ [0.15, -0.05, 0.25] + T[:, :3, 3], abs=2e-8)


# -- recovery --------------------------------------------------------------------------------------------------------


def test_an_exact_campaign_is_reproduced_exactly():
    truth, _, rng = campaign(3)
    truth = replace(truth, joint_noise=0.0)
    readings = campaign_readings(rng, 60)
    exact = replace(readings, point=truth.points(readings))
    fit = fit_campaign(Campaign(EXTRA, exact, PAYLOADS, INSTRUMENT), priors=PRIORS)
    assert np.linalg.norm(fit.residual, axis=1).max() < 2e-6
    error, _ = held_out_error(fit, truth, rng)
    assert np.linalg.norm(error, axis=1).max() < 5e-6
    assert fit.state.arm[31:33] == pytest.approx(truth.compliance[1:3], rel=2e-3)


def test_noise_is_found_and_errors_are_what_is_predicted():
    inside, squares = [], []
    for seed in range(6):
        truth, c, rng = campaign(seed, 60)
        fit = fit_campaign(c, priors=PRIORS)
        assert 0.6e-5 < fit.noise.joints < 1.5e-5 and 0.8 < fit.spread < 1.2
        error, covariance = held_out_error(fit, truth, rng)
        sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        inside.append(np.mean(np.abs(error) < 1.645 * sd))
        squares.append(np.mean((error / sd) ** 2))
    assert 0.78 < np.mean(inside) < 0.96 and 0.6 < np.mean(squares) < 1.7  # benchmarks/calibration_campaigns.py: 100 campaigns


def test_gross_outliers_hardly_move_the_parameters():
    moves = []
    for seed in range(4):
        _, c, rng = campaign(seed, 60)
        clean = fit_campaign(c, priors=PRIORS)
        gross = np.zeros(60, bool)
        gross[rng.choice(60, 3, replace=False)] = True
        off = np.where(gross[:, None], rng.normal(size=(60, 3)) * [[3e-3], [0.1], [5.0]][seed % 3], 0.0)
        dirty = fit_campaign(replace(c, readings=replace(c.readings, point=c.readings.point + off)), priors=PRIORS)
        assert dirty.weight[gross].max() < 0.2 < np.median(dirty.weight[~gross])
        moves.append((dirty.offset - clean.offset)[:32] / clean.sd[:32])
    assert np.sqrt(np.mean(np.square(moves))) < 0.5


def test_a_fifth_of_gross_readings_does_not_blur_the_rest():
    truth, c, rng = campaign(33, 60)
    point = c.readings.point.copy()
    point[::5] += rng.normal(size=(12, 3)) * 0.3
    fit = fit_campaign(replace(c, readings=replace(c.readings, point=point)), priors=PRIORS)
    assert fit.spread < 1.3
    error, covariance = held_out_error(fit, truth, rng)
    assert 0.4 < np.sqrt(np.mean(error**2 / np.diagonal(covariance, axis1=1, axis2=2))) < 1.6


def test_a_tracker_anywhere_and_two_stations_are_found():
    _, c, _ = campaign(5, 80)
    other = np.eye(4)
    other[:3, :3], other[:3, 3] = Rotation.from_euler("xyz", [170, -40, 80], degrees=True).as_matrix(), [-5.0, 3.0, 2.0]
    second = np.arange(80) >= 40
    point = np.where(second[:, None], c.readings.point @ other[:3, :3].T + other[:3, 3], c.readings.point)
    readings = replace(c.readings, point=point, station=second.astype(np.int64), stations=("A", "B"))
    fit = fit_campaign(replace(c, readings=readings), priors=PRIORS)
    assert np.linalg.norm(fit.residual, axis=1).max() < 2e-4
    assert fit.state.stations[1] == pytest.approx(other @ fit.state.stations[0], abs=1e-3)
    assert "station_B_x" in fit.layout.names


def test_nests_that_the_cell_does_not_place_are_found():
    truth, c, rng = campaign(6, 70)
    unknown = replace(INSTRUMENT, nests={name: Nest(6, None) for name in NESTS})
    fit = fit_campaign(replace(c, instrument=unknown), priors=PRIORS)
    error, _ = held_out_error(fit, truth, rng)
    assert np.linalg.norm(error, axis=1).mean() < 6e-5


def test_six_dimensional_targets_give_the_whole_pose():
    truth, c, rng = campaign(7, 50)
    readings = c.readings
    hung = np.array([[PAYLOADS[name].mass, *PAYLOADS[name].com] for name in readings.payloads])
    still = predict_points(
        truth.robot,
        np.concatenate([truth.robot.mdh.ravel(), truth.compliance]),
        RowInputs(readings.q, hung[readings.payload], np.zeros((50, 6)), np.zeros((50, 3)), np.zeros((50, 3))),
    )[1]
    mounted = Rotation.from_euler("xyz", [20, -10, 35], degrees=True).as_matrix()
    noise = Rotation.from_rotvec(rng.normal(size=(50, 3)) * 5e-5).as_matrix()
    turn = noise @ truth.T_tracker_base[:3, :3] @ still @ mounted
    readings = replace(readings, turn=turn, sigma_turn=np.full(50, 5e-5), target=np.zeros(50, np.int64))
    points = measured(truth, readings, rng).point
    fit = fit_campaign(replace(c, readings=replace(readings, point=points)), priors=PRIORS)
    assert fit.residual.shape == (50, 6) and np.abs(fit.residual[:, 3:]).max() < 5e-4
    assert identify(fit).rank == 20  # 30 with a base and a tool of six each (PHYSICS 2.3)
    assert fit.state.turns[0] == pytest.approx(mounted, abs=3e-3)  # but for the turns of the flange that hide in it
    stated = replace(c, readings=replace(readings, point=points))
    assert with_turn_sd(stated) is stated
    some = replace(stated.readings, sigma_turn=np.where(np.arange(50) % 2, 5e-5, np.nan))  # the others as the file's usual one
    np.testing.assert_array_equal(fit_campaign(replace(c, readings=some), priors=PRIORS).residual, fit.residual)
    for times in (1 / 57, 57):  # far too small it held the arm to what orientations scatter, far too large it shrank all others
        wrong = with_turn_sd(replace(stated, readings=replace(stated.readings, sigma_turn=np.full(50, times * 5e-5))))
        assert wrong.readings.sigma_turn == pytest.approx(5e-5, rel=0.25)
    for sd in (5e-5, 2e-3):  # what the file does not state is told by the scatter
        scattered = (
            Rotation.from_rotvec(rng.normal(size=(50, 3)) * sd).as_matrix() @ truth.T_tracker_base[:3, :3] @ still @ mounted
        )
        silent = replace(c, readings=replace(readings, point=points, turn=scattered, sigma_turn=None))
        assert with_turn_sd(silent).readings.sigma_turn == pytest.approx(sd, rel=0.25)


# -- what is seen ----------------------------------------------------------------------------------------------------


def test_the_rank_is_the_known_one_and_the_hidden_are_named():
    _, c, _ = campaign(8, 80)
    found = identify(fit_campaign(c))
    # 27 for positions with a base of 6 and a tool of 3 (PHYSICS 2.3): 18 of the arm, and the two springs.
    assert found.rank == 20
    hidden = {h.name: h for h in found.hidden}
    assert {"th1", "d1", "d2", "d3", "th6", "d6"} <= set(hidden)
    assert "d3" in hidden["d2"].company and "d2" in hidden["d3"].company
    assert any(name.startswith("station") for name in hidden["d1"].company)
    assert "tracker" in found.not_identified()["th1"] and "nests" in found.not_identified()["d6"]
    assert not {"a2", "d4", "al2", "c2", "c3"} & set(hidden)


def test_learned_priors_are_as_wide_as_the_arm_is_off():
    sizes = []
    for size in (1e-4, 6e-4):
        _, c, _ = campaign(9, 80, size=size)
        priors = learned_priors(fit_campaign(c))
        sizes.append((priors.length, priors.angle))
        assert 0.5 * size < priors.angle < 2.0 * size
    assert sizes[1][0] > 2 * sizes[0][0]


# -- methods, load tests, held-out figures ---------------------------------------------------------------------------


def test_springs_inside_beat_geometry_alone_and_the_literal_recipe():
    truth, c, _ = campaign(10, 80)
    mean = {}
    for method in METHODS:
        error, _ = held_out_error(calibrate_by(method, c, priors=PRIORS), truth, np.random.default_rng(1))
        mean[method] = np.linalg.norm(error, axis=1).mean()
    assert mean["full"] < 4e-5 and mean["relative"] < 6e-5
    assert mean["geometry"] > 4 * mean["full"] and mean["relative-literal"] > 4 * mean["full"]


def test_equal_torque_pairs_have_equal_torques():
    _, c, _ = campaign(11, 80)
    pairs = equal_torque_pairs(EXTRA, c.readings)
    torque = elementary_weight_torques(EXTRA, c.readings.q, GRAVITY)[:, 1:3]
    apart = np.abs(torque[pairs[:, 0]] - torque[pairs[:, 1]]).max(axis=1)
    assert np.median(apart) < 0.2 * np.ptp(torque, axis=0).max()
    assert np.array_equal(c.readings.payload[pairs[:, 0]], c.readings.payload[pairs[:, 1]])


def test_load_tests_give_the_springs_on_their_own():
    truth, c, rng = campaign(12, 60)
    posture = campaign_readings(rng, 8)
    rows = np.repeat(np.arange(8), 3)
    tests = replace(posture.take(rows), payload=np.tile([0, 1, 2], 8), target=np.repeat(posture.target, 3))
    tests = replace(tests, approach=None)
    tests = measured(truth, tests, rng)
    both = replace(c.readings, approach=None)
    arrays = {
        name: np.concatenate([getattr(both, name), getattr(tests, name)])
        for name in ("q", "point", "target", "payload", "station", "session", "load", "load_link", "load_place", "line")
    }
    readings = replace(both, **arrays)
    fit = fit_campaign(replace(c, readings=readings), priors=PRIORS)
    assert len(load_pairs(readings)[0]) == 16
    found = load_test(fit)
    assert found is not None and {2, 3} <= set(found.joints) and found.after < 0.3 * found.before
    at = [found.joints.index(j) for j in (2, 3)]
    assert np.all(np.abs(found.compliance[at] - truth.compliance[1:3]) < 4 * found.sd[at] + 0.05 * truth.compliance[1:3])


def test_repeats_tell_the_joint_noise():
    truth, c, rng = campaign(13, 30, joint_noise=4e-5)
    readings = c.readings.take(np.repeat(np.arange(30), 6))
    readings = measured(truth, replace(readings, time=np.arange(180.0)), rng)
    fit = fit_campaign(replace(c, readings=readings), priors=PRIORS)
    linear = linearise(EXTRA, readings, INSTRUMENT, fit.layout, fit.state)
    found = repeat_scatter(readings, INSTRUMENT, linear.d_joints)
    assert found is not None and found.groups == 30 and found.joints == pytest.approx(4e-5, rel=0.25)
    assert repeat_scatter(c.readings, INSTRUMENT, linear.d_joints[:30]) is None


def test_held_out_figures_are_larger_than_residuals_and_honest():
    _, c, _ = campaign(14, 90)
    fit = fit_campaign(c, priors=PRIORS)
    table = by_kind(validate(fit))
    assert {"random", "region", "payload", "joint range"} <= set(table)
    inside = np.sqrt(np.mean(np.sum(fit.residual**2, axis=1)))
    assert table["region"]["rms"] > inside and 0.7 < table["random"]["over_predicted"] < 1.4


@pytest.mark.parametrize("count", [60, 30])
def test_a_posture_read_four_times_is_no_four_postures(count):
    """Gears err alike in all four, so that they tell hardly more than one: of the arm, and of how far it scatters."""
    rng = np.random.default_rng(35)
    truth = replace(random_truth(rng, background=4e-5, joint_noise=0.0), backlash=np.zeros(6))
    once = campaign_readings(rng, count)
    one, four = (
        fit_campaign(Campaign(EXTRA, measured(truth, r, rng), PAYLOADS, INSTRUMENT), priors=PRIORS)
        for r in (once, once.take(np.repeat(np.arange(count), 4)))
    )
    springs = one.layout.arm[[31, 32]]
    assert 0.7 < (four.sd[springs] / one.sd[springs]).min() < 1.0  # half of it, were they independent
    assert four.noise.joints == pytest.approx(one.noise.joints, rel=0.15)


def test_what_is_left_out_is_a_posture_with_all_that_was_read_in_it():
    """From either side, with another nest or load: what the model lacks is the same there, and would be known from the other."""
    _, c, _ = campaign(14, 60)
    one, twice = c.readings.take(np.arange(30)), c.readings.take(np.tile(np.arange(30), 2))
    other = {"approach": -one.approach, "target": (one.target + 1) % 3, "load": one.load + 300.0}
    both = replace(c, readings=replace(twice, **{k: np.concatenate([getattr(one, k), v]) for k, v in other.items()}))
    for fold in folds(both):
        assert fold.kind == "payload" or set(fold.held[fold.held < 30]) == set(fold.held[fold.held >= 30] - 30)
    random = [fold.held for fold in folds(both) if fold.kind == "random"]
    assert [len(held) for held in random] == [12] * 5 and sorted(np.concatenate(random)) == list(range(60))


def test_a_payload_that_is_not_as_believed_is_corrected_when_asked():
    _, c, _ = campaign(15, 80)
    wrong = {**PAYLOADS, "weight": Hanging(80.0, PAYLOADS["weight"].com)}
    fit = fit_campaign(replace(c, payloads=wrong), Choice(payloads=("weight",)), replace(PRIORS, payload_mass=10.0))
    assert fit.state.payloads[2, 0] == pytest.approx(90.0, abs=6.0)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_tells_of_readings_and_takes_six_dimensional_targets(method):
    truth, c, rng = campaign(16, 40)
    turned = replace(c.readings, turn=np.tile(np.eye(3), (40, 1, 1)), sigma_turn=np.full(40, 10.0))
    fit = calibrate_by(method, replace(c, readings=turned), priors=PRIORS)
    assert len(fit.weight) == len(fit.residual) == 40 and 0 < fit.weight.max() <= 1
    assert fit.layout.size == len(fit.offset) == len(fit.covariance)
    assert np.isfinite(predict_readings(fit, campaign_readings(rng, 5))[0]).all()
    assert truth.robot.name == EXTRA.name


def test_few_readings_are_not_taken_for_better_than_the_instrument():
    truth, c, rng = campaign(17, 12)
    fit = fit_campaign(c, priors=PRIORS)
    assert fit.spread >= 0.5
    error, covariance = held_out_error(fit, truth, rng)
    assert np.mean(error**2 / np.diagonal(covariance, axis1=1, axis2=2)) < 3.0


def test_a_target_with_and_one_without_orientation_share_a_file():
    truth, c, _ = campaign(18, 40)
    turn = np.full((40, 3, 3), np.nan)
    turn[:20] = truth.T_tracker_base[:3, :3] @ elementary_frames(truth.robot, c.readings.q[:20])[:, 6, :3, :3]
    mixed = replace(c.readings, turn=turn, sigma_turn=np.full(40, 1e-4), target=np.repeat([0, 1], 20))
    points = truth.points(mixed)
    fit = fit_campaign(replace(c, readings=replace(mixed, point=points)), priors=PRIORS)
    assert not fit.residual[20:, 3:].any() and not fit.J[20:, 3:].any()
    assert 0 < np.abs(fit.residual[:20, 3:]).max() < 5e-3
