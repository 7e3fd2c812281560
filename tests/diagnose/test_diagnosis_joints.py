"""Link-side encoders: the log's reader, its noise, delays and springs; shrinkage and experiments on numbers alone."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.stats import multivariate_normal

from ocp.diagnose import rules
from ocp.diagnose.answering import answer_of, columns_predicted, predict_sealed, write_predictions
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.engine.channel_system import SCALE, Fold, HeldOut
from ocp.diagnose.engine.findings import Name
from ocp.diagnose.joints.channel import joint_channel
from ocp.diagnose.joints.log import read_joint_log
from ocp.diagnose.joints.signals import BLOCK, EncoderNoise, covariance, factors, unlikely, whiten_blocks
from ocp.diagnose.report.verdict_sentence import verdict_sentence
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.diagnose.verdict.shrinkage import from_folds, realised
from ocp.effects.catalogue import library
from ocp.effects.effect import Active
from ocp.shell.progress import Phases
from robots.errors import BadInput
from robots.rigid_body import inverse_dynamics
from robots.robot import load_robot
from tests.support.diagnosis_folder import joint_columns, write_csv, write_joint_folder
from tests.support.published_campaigns import write_recordings
from tests.support.simulated_campaign import EXTRA, PAYLOADS


def fresh(name: str, joint: int) -> Active:
    effect = library()[name]
    return Active(effect, joint, np.zeros(effect.size), {}, np.zeros((effect.size, effect.size)))


def channel_of(folder: Path, **options):
    write_csv(folder / "joints.csv", joint_columns(**options))
    return joint_channel(read_joint_log(folder / "joints.csv"), EXTRA, PAYLOADS["grinder"])


def test_the_likelihood_of_an_encoder_s_noise_is_a_normal_s_and_so_is_its_slope():
    rng, t = np.random.default_rng(3), np.sort(np.random.default_rng(4).uniform(0.0, 0.2, 30))
    lags = np.abs(t[:, None] - t)
    parts, logs = [(1e-5 * rng.normal(size=30), lags) for _ in range(2)], np.log([1e-5, 6e-6, 0.03])
    white, wander, memory = np.exp(logs)
    spread = wander**2 * np.exp(-lags / memory) + (white**2 + rules.LEAST_ENCODER_NOISE**2) * np.eye(30)
    exact = -sum(multivariate_normal.logpdf(left, cov=spread) for left, _ in parts)
    assert unlikely(logs, parts)[0] + 30 * np.log(2 * np.pi) == pytest.approx(exact)
    steps = 1e-5 * np.eye(3)
    apart = [(unlikely(logs + h, parts)[0] - unlikely(logs - h, parts)[0]) / 2e-5 for h in steps]
    assert unlikely(logs, parts)[1] == pytest.approx(apart, rel=1e-5)


def test_a_delay_is_found_to_a_hundredth_of_a_step(tmp_path):
    channel = channel_of(tmp_path, seed=2, delay=7.3e-3)
    found = channel.with_active((fresh("channel_delay", 0),))
    (one,) = found.active
    assert abs(one.a[0] - 7.3e-3) < 1e-4  # recorded every 10 ms
    assert found.gap().std() * SCALE["arcsec"] < 1.3  # 1.03 arcsec were added
    assert channel.gap().std() * SCALE["arcsec"] > 100


def test_springs_of_a_catalogue_are_held_to_half_of_what_they_give_and_large_arms_to_what_joints_give(tmp_path):
    write_csv(tmp_path / "joints.csv", joint_columns(seed=3))
    log = read_joint_log(tmp_path / "joints.csv")
    for softer, stated, wanted in ((1.0, False, 2e-6), (50.0, False, 25.0 / 3.3e6), (50.0, True, 15.0 / 3.3e6)):
        robot = replace(EXTRA, stiffness=EXTRA.stiffness / softer)
        springs = joint_channel(log, robot, PAYLOADS["grinder"], stated).problem.springs
        assert springs[2] == pytest.approx((softer / 3.3e6, wanted))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_either_sign_of_the_torques_gives_the_same_springs(tmp_path, sign):
    channel = channel_of(tmp_path, seed=3, compliance=5e-7, sign=sign)
    springs = channel.with_active((fresh("channel_delay", 0),)).theta[-3:]
    assert np.allclose(springs[1:], [1 / 3.3e6 + 5e-7, 1 / 2.46e6], rtol=0.03)


def test_the_noise_is_what_was_added(tmp_path):
    channel = channel_of(tmp_path, seed=4, delay=3e-3, compliance=4e-7)
    assert abs(channel.noise_floor / (5e-6 * SCALE["arcsec"]) - 1) < 0.1
    whole = channel.with_active((fresh("channel_delay", 0),)).system.residual
    assert 0.8 < np.mean(whole**2) < 1.2


def test_whitened_wander_is_white():
    time = np.arange(BLOCK) * 0.02
    rng = np.random.default_rng(0)

    noise = EncoderNoise(3e-6, 1e-5, 0.1, 4e-5, 1.5, 3e-6, np.ones(BLOCK, bool))
    C = covariance(time, noise)
    drawn = np.linalg.cholesky(C) @ rng.normal(size=(BLOCK, 300))
    white = whiten_blocks(factors(time, [np.arange(BLOCK)], noise), drawn)
    assert abs(np.var(white) - 1) < 0.02
    assert abs(np.mean(white[1:] * white[:-1])) < 0.02
    assert C[0, 0] == pytest.approx(3e-6**2 + 1e-5**2 + 4e-5**2, rel=1e-3)


def test_held_out_time_blocks_judge_the_delay(tmp_path):
    channel = channel_of(tmp_path, seed=2, delay=5e-3)
    found = channel.with_active((fresh("channel_delay", 0),))
    judged = [found.held_out(f, found.active) for f in found.folds() if f.kind == "block"]
    assert len(judged) == 5 and all(h is not None and h.means[1] < 0.01 * h.means[0] for h in judged)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda c: {k: v for k, v in c.items() if not k.startswith("link")}, "link1_deg .. link6_deg"),
        (lambda c: c | {"time_s": c["time_s"][::-1]}, "times must grow"),
        (lambda c: c | {"link2_deg": -np.asarray(c["link2_deg"])}, "counts the other way"),
        (lambda c: c | {"link2_deg": np.radians(c["link2_deg"])}, "give both in degrees"),
        (lambda c: {k: v[:20] for k, v in c.items()}, "record a motion"),
    ],
)
def test_a_log_that_is_a_mistake_is_refused(tmp_path, spoil, words):
    write_csv(tmp_path / "joints.csv", spoil(joint_columns(1)))
    with pytest.raises(BadInput, match=words.replace("..", "[.][.]")):
        read_joint_log(tmp_path / "joints.csv")


def test_the_real_kuka_has_a_lag_behind_its_springs(tmp_path, shared_data):
    write_recordings([shared_data / "real" / "kr300_secondary_encoder" / "FF_A.mat"], tmp_path)
    log = read_joint_log(tmp_path / "joints.csv")
    assert log.joints == (1, 2, 3) and len(log) == 2501
    channel = joint_channel(log, load_robot("kr210_r2700_extra"), PAYLOADS["bare"])
    alone = channel.gap().std() * SCALE["arcsec"]  # springs refitted
    found = channel.with_active((fresh("channel_delay", 0),))
    assert 50 < alone < 130 and found.gap().std() * SCALE["arcsec"] < 25
    assert 2e-3 < found.active[0].a[0] < 4e-3
    blocks = [found.held_out(f, found.active) for f in found.folds() if f.kind == "block"]
    assert realised(*np.mean([h.means for h in blocks], axis=0)) > 0.7


def held(before: float, after: float, kind: str = "random", n: int = 400, seed: int = 0) -> HeldOut:
    rng = np.random.default_rng(seed)
    rows = [m * rng.chisquare(3, n) / 3 for m in (before + 1.0, after + 1.0)]
    return HeldOut(Fold("x", kind, np.ones(n, bool)), np.stack([*rows, np.ones(n)]))


def test_shrinkage_is_predicted_with_its_chance():
    fold = held(25.0, 1.0)
    found = from_folds([fold], 0.01)
    assert found.predicted == pytest.approx(realised(*fold.means), abs=0.01)
    assert found.low < found.predicted < found.high and 0.02 < found.high - found.low < 0.1
    # Nothing is left to see, yet the parameters' own errors remain.
    assert from_folds([held(25.0, 0.0, seed=1)], 0.25).high < 0.91


def test_a_condition_that_is_new_widens_the_promise():
    inside = [held(25.0, 1.0)]
    wide = from_folds([*inside, held(25.0, 16.0, "payload", seed=2)], 0.01)
    assert wide.low < 0.3 < from_folds(inside, 0.01).low


def test_no_gap_has_no_shrinkage():
    assert from_folds([held(0.0, 0.0)], 0.0) is None
    assert realised(1.03, 1.0, 1.0) is None and realised(2.0, 1.0, 1.0) == 1.0


def test_two_recordings_with_a_zero_set_anew_give_the_lag_that_each_alone_gives(shared_data):
    data = read_data_set(shared_data / "real" / "kr300_two_recordings")
    assert data.joints.runs == ("FF_A", "FF_C")  # the link encoder of joint 1 is 512 arcsec apart
    channel = joint_channel(data.joints, data.setup.robot, data.setup.hanging)
    best = diagnose_channels([channel], library()).ranking[0]
    assert best.name == Name("channel_delay", 0) and best.probability > 0.99
    # Companions that these recordings leave open (a coupled or rippled joint 1) move it by a quarter of its sd at most.
    assert 2.835e-3 < best.active.a[0] < 2.895e-3


def test_sealed_recordings_of_link_sides_are_predicted_blind(tmp_path):
    """Every row of another motion, with the delay and the load's sign that were learnt; what lies outside is flagged."""
    write_joint_folder(tmp_path / "run", 3, delay=4e-3, sign=-1.0)
    other = joint_columns(8, delay=4e-3, sign=-1.0)
    truth = {name: other.pop(name) for name in ("link1_deg", "link2_deg", "link3_deg")}
    other["q1_deg"] += 80.0 * np.clip((other["time_s"] - 9.0) / 3.0, 0.0, 1.0) ** 2
    write_csv(tmp_path / "run" / "sealed_joints.csv", other)
    answer = answer_of(tmp_path / "run", Phases())
    file = tmp_path / "predictions_joints.csv"
    write_predictions(file, columns_predicted(answer, "joint"), predict_sealed(answer)["joint"])
    with file.open() as lines:
        rows = list(csv.DictReader(lines))
    kinds = ("baseline", "corrected", "sigma", "patched", "patched_sigma")
    assert list(rows[0]) == [*(f"{kind}_link{j}_deg" for kind in kinds for j in (1, 2, 3)), "inside"]
    told = {k: np.array([[float(r[f"{k}_{name}"]) for name in truth] for r in rows]) for k in kinds}
    off = {k: (told[k] - np.stack(list(truth.values()), axis=1))[10:890] for k in ("baseline", "corrected")}
    off = {k: v - v.mean(axis=0) for k, v in off.items()}  # a new recording's zeros are free
    assert np.sqrt(np.mean(off["corrected"] ** 2)) < 0.1 * np.sqrt(np.mean(off["baseline"] ** 2))
    inside = np.array([r["inside"] == "1" for r in rows])
    assert inside[:900].mean() > 0.6 and inside[-50:].mean() < 0.5
    assert told["sigma"][~inside, 0].mean() > 3.0 * told["sigma"][inside, 0].mean()


def rubbed(seed: int, **options) -> dict:
    """joints.csv of an arm that is as believed, whose motors' torques hold the drives' dry friction."""
    columns = joint_columns(seed, **options)
    for j, friction in ((1, 100.0), (2, 300.0), (3, 150.0)):
        columns[f"tau{j}_Nm"] = columns[f"tau{j}_Nm"] + friction * np.sign(np.gradient(columns[f"q{j}_deg"]))
    return columns


def test_friction_in_torques_turns_round_as_smoothly_as_these(tmp_path):
    """Torques are smoothed, over a reversal too: a sharper friction would leave arcseconds there, which names then explain."""
    write_csv(tmp_path / "joints.csv", rubbed(6))
    system = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"]).system
    left = system.residual - system.nuisance @ np.linalg.lstsq(system.nuisance, system.residual, rcond=1e-12)[0]
    assert 0.85 < np.mean(left**2) < 1.2


def test_friction_in_recorded_torques_is_in_the_sigma(tmp_path):
    """The fit leaves it at zero, the spring takes it along: what is predicted misses by it anew."""
    write_joint_folder(tmp_path, 3)
    write_csv(tmp_path / "joints.csv", rubbed(3))
    other = rubbed(8)
    truth = np.stack([np.asarray(other.pop(name)) for name in ("link1_deg", "link2_deg", "link3_deg")], axis=1)
    write_csv(tmp_path / "sealed_joints.csv", other)
    answer = answer_of(tmp_path, Phases())
    assert "arcsec (noise" in verdict_sentence(answer) and "recorded torques hold friction" in verdict_sentence(answer)
    told = predict_sealed(answer)["joint"]
    z = ((np.radians(truth) - told.corrected) / np.hypot(told.sigma, 5e-6))[told.inside]
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.5


def moving(seed: int, rotor: float = 0.0, torque: bool = True) -> dict:
    """joints.csv of an arm that is as believed and moves fast: its springs bear weight and inertia; `rotor` kg m^2 turn on the
    motor's side of each gear, whose torque `torque` records."""
    columns = joint_columns(seed)
    time, hung = np.asarray(columns["time_s"]), PAYLOADS["grinder"]
    splines = [CubicSpline(time, np.radians(columns[f"q{j}_deg"])) for j in range(1, 7)]
    q, qd, qdd = (np.stack([s(time, order) for s in splines], axis=1) for order in range(3))
    held = inverse_dynamics(EXTRA, hung.mass, hung.com, q, qd, qdd)
    rng = np.random.default_rng(seed)
    for j in range(3):
        link = q[:, j] - held[:, j] / EXTRA.stiffness[j] + rng.normal(size=len(q)) * 5e-6
        columns[f"link{j + 1}_deg"] = np.round(np.degrees(link), 7)
        columns[f"tau{j + 1}_Nm"] = np.round(held[:, j] + rotor * qdd[:, j] + rng.normal(size=len(q)) * 3.0, 3)
    return columns if torque else {k: v for k, v in columns.items() if not k.startswith("tau")}


def test_an_arm_whose_torques_are_not_recorded_bends_under_its_inertia_too(tmp_path):
    """Of the weight alone joint 1 has nothing: its motion was taken for a scale of its encoder."""
    write_csv(tmp_path / "joints.csv", moving(4, torque=False))
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])
    assert channel.gap().std() * SCALE["arcsec"] < 1.1  # 1.03 arcsec were added; without the inertia 10


def test_an_arm_that_starts_briskly_bends_at_once(tmp_path):
    """Ramps of 0.3 s: a load smoothed as recorded torques are was too low by 10 arcsec of joint 1."""
    columns = {name: np.array(values) for name, values in moving(4, torque=False).items()}
    time, hung = columns["time_s"].astype(float), PAYLOADS["grinder"]
    pulse = (
        np.sin(np.pi * np.mod(time, 0.75) / 0.3)
        * (np.mod(time, 0.75) < 0.3)
        * np.array([1, -1, -1, 1])[(time / 0.75).astype(int) % 4]
    )
    way = np.cumsum(np.cumsum(pulse)) * 1e-4
    q = np.radians([[0.0, -70.0, 60.0, 0.0, 30.0, 0.0]]) + np.outer(way / np.ptp(way), np.radians([20.0, 15.0, 10.0, 0, 0, 0]))
    splines = CubicSpline(time, q)
    held = inverse_dynamics(EXTRA, hung.mass, hung.com, q, splines(time, 1), splines(time, 2))
    link = q[:, :3] - held[:, :3] / EXTRA.stiffness[:3] + np.random.default_rng(0).normal(size=(len(q), 3)) * 5e-6
    columns |= {f"q{j + 1}_deg": np.round(np.degrees(q[:, j]), 7) for j in range(6)}
    columns |= {f"link{j + 1}_deg": np.round(np.degrees(link[:, j]), 7) for j in range(3)}
    write_csv(tmp_path / "joints.csv", columns)
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, hung, stated=True)
    assert channel.gap().std() * SCALE["arcsec"] < 1.2
    springs = {n: c for n, c in zip(channel.problem.nuisance.names, channel.theta, strict=True) if n.startswith("spring")}
    assert [springs[f"spring {j}"] * EXTRA.stiffness[j - 1] for j in (1, 2, 3)] == pytest.approx([1.0] * 3, rel=0.05)
    assert all(noise.fast < 0.4 * noise.white for noise in channel.problem.noise.values())


def test_one_wild_angle_leaves_the_torques_their_unit(tmp_path):
    columns = {name: np.array(values) for name, values in joint_columns(4).items()}
    for name in ("q2_deg", "link2_deg"):
        columns[name][500] += 60.0
    write_csv(tmp_path / "joints.csv", columns)
    assert joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"]).problem.signals.measured[1]


def test_of_many_short_recordings_the_rows_kept_are_few_of_each(tmp_path):
    """Four of sixty: the joints are those of all rows, and a delay shows."""
    each = [{k: np.asarray(v)[37 * n : 37 * n + 60] for k, v in joint_columns(n, delay=4e-3).items()} for n in range(30)] * 4
    columns = {k: np.concatenate([one[k] for one in each]) for k in each[0]} | {
        "run": np.repeat([f"r{n}" for n in range(120)], 60)
    }
    write_csv(tmp_path / "joints.csv", columns)
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])
    assert channel.problem.signals.log.joints == (1, 2, 3)
    assert np.linalg.norm(channel.variants(library()["channel_delay"], 0)[1]) > 1e5


@pytest.mark.parametrize("in_turn", [False, True])
def test_times_in_milliseconds_are_told_by_the_speeds_in_any_order_of_rows(tmp_path, in_turn):
    made = []
    for seed, run in ((1, "a"), (2, "b")):
        columns = {k: np.array(v, object) for k, v in joint_columns(seed).items()}
        time, n = columns["time_s"].astype(float), len(columns["time_s"])
        columns |= {f"qd{j}_deg_s": np.gradient(columns[f"q{j}_deg"].astype(float), time) for j in (1, 2, 3)}
        made.append(columns | {"time_s": 1000.0 * time, "run": np.array([run] * n, object)})
    order = np.argsort(np.tile(np.arange(n), 2), kind="stable") if in_turn else np.arange(2 * n)
    write_csv(tmp_path / "joints.csv", {k: np.concatenate([one[k] for one in made])[order] for k in made[0]})
    with pytest.raises(BadInput, match="times in seconds"):
        read_joint_log(tmp_path / "joints.csv")


def test_rotors_in_recorded_torques_are_no_scale_of_an_encoder(tmp_path):
    """A motor turns its own rotor too, which loads no spring."""
    write_joint_folder(tmp_path, 4)
    write_csv(tmp_path / "joints.csv", moving(4, rotor=300.0))
    answer = answer_of(tmp_path, Phases())
    assert answer.diagnosis.p_none > 0.5


def test_ripple_faster_than_the_rows_kept_is_in_the_sigma(tmp_path):
    """Every third row is kept; among these a ripple of 20 Hz is as white as an encoder's noise, which no link side has."""
    for name, seed in (("joints.csv", 4), ("sealed.csv", 5)):
        columns = moving(seed)
        columns["link1_deg"] += np.degrees(3e-5 * np.cos(250 * np.radians(columns["q1_deg"])))
        write_csv(tmp_path / name, columns)
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])
    told = channel.predict(read_joint_log(tmp_path / "sealed.csv", sealed=True), ())
    z = ((read_joint_log(tmp_path / "sealed.csv").link[:, :3] - told.corrected) / np.hypot(told.sigma, 5e-6))[told.inside, 0]
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.5


def test_a_hole_in_a_recording_is_no_motion(tmp_path):
    """A spline over seconds without rows overshoots into speeds that no axis had; friction and ripples explained them."""
    columns = joint_columns(2, delay=4e-3)
    time = np.asarray(columns["time_s"])
    kept = (time < 3.0) | (time > 6.0)
    write_csv(tmp_path / "joints.csv", {k: np.asarray(v)[kept] for k, v in columns.items()})
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])
    assert np.degrees(np.abs(channel.problem.signals.qd).max()) < 45.0  # 30 deg at 0.23 Hz: 43 deg/s
    assert channel.with_active((fresh("channel_delay", 0),)).gap().std() * SCALE["arcsec"] < 1.3


def test_rounded_angles_are_no_speed(tmp_path):
    """At 1 kHz a digit of 0.01 deg is 10 deg/s; the delay came out too small by many of its sd."""
    columns = joint_columns(2, delay=4e-3)
    time = np.arange(0.0, 11.9, 1e-3)
    fine = {k: CubicSpline(columns["time_s"], v)(time) for k, v in columns.items() if k not in ("run", "time_s")}
    fine = {k: np.round(v, 2) if k.startswith("q") else v for k, v in fine.items()}
    write_csv(tmp_path / "joints.csv", {"run": ["a"] * len(time), "time_s": np.round(time, 4), **fine})
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])
    found = channel.with_active((fresh("channel_delay", 0),))
    assert abs(found.active[0].a[0] - 4e-3) < 1e-4


def test_recordings_that_lie_between_one_another_are_told_apart_by_run(tmp_path):
    """Rows are in time order inside a run, no more is asked of them: with those of two in turn every row was a recording."""
    one, other = moving(4), moving(5)
    other["run"] = ["b"] * len(other["time_s"])
    for kind, in_turn in (("turn", True), ("after", False)):
        mixed = {k: np.concatenate([np.asarray(one[k], object), np.asarray(other[k], object)]) for k in one}
        order = np.argsort(np.tile(np.arange(len(one["run"])), 2), kind="stable") if in_turn else slice(None)
        write_csv(tmp_path / f"{kind}.csv", {k: v[order] for k, v in mixed.items()})
    turn, after = (joint_channel(read_joint_log(tmp_path / f"{k}.csv"), EXTRA, PAYLOADS["grinder"]) for k in ("turn", "after"))
    assert np.array_equal(turn.theta, after.theta)
    told = [after.predict(read_joint_log(tmp_path / f"{k}.csv", sealed=True), ()) for k in ("turn", "after")]
    half = len(one["run"])
    assert np.array_equal(told[0].corrected[0::2], told[1].corrected[:half])
    assert np.array_equal(told[0].sigma[1::2], told[1].sigma[half:])


def test_a_run_a_row_is_no_recording(tmp_path):
    columns = moving(4)
    columns["run"] = list(range(len(columns["run"])))
    write_csv(tmp_path / "joints.csv", columns)
    with pytest.raises(BadInput, match="in runs of more than 4, .* record a motion, and name a run in all its rows alike"):
        read_joint_log(tmp_path / "joints.csv")


def test_a_log_in_radians_leaves_the_limits_of_the_robot(tmp_path):
    """All of it in one wrong unit agrees with itself: no gap, of an encoder of a hundredth of an arcsecond."""
    columns = moving(4)
    for side in ("q", "link"):
        columns |= {k: np.radians(np.asarray(v)) for k, v in columns.items() if k.startswith(side)}
    write_csv(tmp_path / "joints.csv", columns)
    with pytest.raises(BadInput, match="joints.csv: the axes leave the robot's limits, and would keep them in radians; give deg"):
        joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])


def test_whole_turns_are_taken_out(tmp_path):
    columns = joint_columns(2, delay=4e-3)
    write_csv(tmp_path / "joints.csv", columns)
    plain = read_joint_log(tmp_path / "joints.csv")
    columns |= {name: np.asarray(columns[name]) % 360.0 for name in ("q1_deg", "link1_deg")}
    write_csv(tmp_path / "joints.csv", columns)
    turned = read_joint_log(tmp_path / "joints.csv")
    assert any("q1_deg, link1_deg jump by whole turns" in n for n in turned.notices)
    for was, now in ((plain.q, turned.q), (plain.link, turned.link)):
        assert np.allclose(np.ptp(was[:, 0] - now[:, 0]), 0.0, atol=1e-9)


def test_a_spring_that_the_fit_takes_already_promises_nothing(tmp_path):
    """A named spring and the believed one share their sum: what each alone is unsure by leaves nothing of the held-out errors."""
    write_joint_folder(tmp_path, 3)
    write_csv(tmp_path / "joints.csv", rubbed(3, compliance=6e-7))
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"], stated=True)
    one = fresh("joint_compliance", 2)
    named = (replace(one, scanned=one.effect.scan(2, channel.surroundings)[0]),)
    judged = [channel.held_out(f, named) for f in channel.folds()]
    assert from_folds(judged, 0.0).high < 0.1


def test_few_wild_samples_are_no_wrong_unit(tmp_path):
    columns = joint_columns(2, delay=4e-3)
    columns["link2_deg"] = np.asarray(columns["link2_deg"]) + 20.0 * (np.arange(len(columns["time_s"])) % 150 == 6)
    write_csv(tmp_path / "joints.csv", columns)
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])
    assert any("far off their neighbours and not counted" in n for n in channel.problem.notices)
    assert channel.with_active((fresh("channel_delay", 0),)).gap().std() * SCALE["arcsec"] < 1.3


@pytest.mark.parametrize("share", [1e-3, 1 / 250, 1e3])
def test_torques_in_another_unit_are_refused(tmp_path, share):
    """In kN m springs were nothing, and play on the side of the load, certain and absurd, was named and written."""
    columns = joint_columns(2)
    columns |= {name: share * np.asarray(columns[name]) for name in ("tau1_Nm", "tau2_Nm", "tau3_Nm")}
    write_csv(tmp_path / "joints.csv", columns)
    with pytest.raises(BadInput, match="column tau2_Nm: .* where the arm's weight alone takes .* link side of the gear"):
        joint_channel(read_joint_log(tmp_path / "joints.csv"), EXTRA, PAYLOADS["grinder"])


def test_effects_are_as_large_as_the_arm(tmp_path):
    """What is usual of a spring or of play under load goes by the believed arm's torques, as for a tracker."""
    write_csv(tmp_path / "joints.csv", joint_columns(3))
    channel = joint_channel(read_joint_log(tmp_path / "joints.csv"), load_robot("ur10"), PAYLOADS["bare"])
    assert channel.surroundings.torque_max.max() == 330.0 and channel.surroundings.stiffness.max() == 1e5


def test_a_name_of_one_joint_is_written(tmp_path):
    """What is left out of a recording are all joints' readings under a condition: another joint's own cannot say that this one's
    ripple takes nothing."""
    write_joint_folder(tmp_path, 3)
    columns = joint_columns(3)
    columns["link3_deg"] = columns["link3_deg"] + np.degrees(8e-5 * np.cos(37 * np.radians(columns["q3_deg"])))
    write_csv(tmp_path / "joints.csv", columns)
    answer = answer_of(tmp_path, Phases())
    assert [(one.effect.name, one.joint) for one in answer.written] == [("gear_harmonic", 3)]
    assert answer.gaps[0].shrinkage.low > 0.3


def test_speeds_contradict_times_in_milliseconds(tmp_path):
    columns = joint_columns(seed=6)
    time, q = np.asarray(columns["time_s"], float), np.asarray(columns["q2_deg"], float)
    columns["qd2_deg_s"] = np.gradient(q, time)
    write_csv(tmp_path / "joints.csv", columns)
    assert not [n for n in read_joint_log(tmp_path / "joints.csv").notices if "apart" in n or "copy" in n]
    columns["time_s"] = 1e3 * time
    write_csv(tmp_path / "joints.csv", columns)
    with pytest.raises(BadInput, match="column qd2_deg_s: .* makes 1e.03 times the way by which q2_deg changes over time_s"):
        read_joint_log(tmp_path / "joints.csv")
    del columns["qd2_deg_s"]
    columns["link2_deg"] = columns["q2_deg"]
    write_csv(tmp_path / "joints.csv", columns)
    told = " ".join(read_joint_log(tmp_path / "joints.csv").notices)
    assert "rows stand 10 s apart" in told and "joint 2 is a copy of its motor's" in told


def test_speeds_of_an_arm_that_stands_contradict_nothing(tmp_path):
    rng = np.random.default_rng(7)
    columns = joint_columns(seed=6)
    time, q = np.asarray(columns["time_s"], float), np.asarray(columns["q2_deg"], float)
    for speed in (np.zeros(len(q)), rng.normal(0.0, 0.01, len(q)), rng.normal(0.0, 5.0, len(q)), 3.0 * np.gradient(q, time)):
        columns["qd2_deg_s"] = speed  # of an arm that came to rest at every row, with noise, by a slow filter
        write_csv(tmp_path / "joints.csv", columns)
        assert read_joint_log(tmp_path / "joints.csv").joints
