"""The force log as a channel of the diagnosis, on logs of the verification's route with effects planted by plain formulas."""

import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from ocp.calibrate.force.fit import BIAS, FIT_NAMES, covariance_left
from ocp.calibrate.force.log import ForceLog, read_force_log
from ocp.calibrate.force.model import ForceModel
from ocp.calibrate.force.noise import Whitener
from ocp.calibrate.force.rows import ForceSetup, log_conditions, prepare_force
from ocp.diagnose import answering
from ocp.diagnose.answering import _shown
from ocp.diagnose.dataset import DataSet
from ocp.diagnose.engine.channel_system import Fold
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.kernels import kernels
from ocp.diagnose.force import prediction
from ocp.diagnose.force.channel import ForceChannel, force_channel, problem_of
from ocp.diagnose.force.fit import ForceProblem, fit_effects
from ocp.diagnose.force.held_out import predict_sealed_force
from ocp.diagnose.force.logged_contact import PLACE
from ocp.diagnose.force.prediction import acts_by_force, effect_derivatives, nuisance_derivatives, predict_forces
from ocp.diagnose.force.prior import contact_prior, with_setpoints_read_off
from ocp.diagnose.foresee.anticipated import signal_gap
from ocp.diagnose.foresee.patched import beside_unknown, patched, unnamed, with_patch
from ocp.diagnose.report.verdict_sentence import _promise
from ocp.diagnose.verdict.answer import Patched
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.diagnose.verdict.patching import as_patch
from ocp.diagnose.verdict.shrinkage import ANOTHER_DAY, Shrinkage
from ocp.effects.catalogue import library
from ocp.effects.cell_effects import effect_of
from ocp.effects.effect import Active, Effect
from ocp.effects.engine.evaluate import contact_columns
from ocp.model.theta import NAMES
from robots.calibration.carried import FORCE
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from tests.support.diagnosis_force_world import HEADER, Base, Planted, log_of, moved_joints
from tests.support.force_world import arm_posterior, write_log

EFFECTS = library()


@dataclass(frozen=True)
class Made:
    base: Base
    channel: ForceChannel
    truth: np.ndarray


@pytest.fixture(scope="module")
def made(tmp_path_factory, solved_once, force_campaign_once) -> Made:
    log, truth = _log(force_campaign_once, (), tmp_path_factory.mktemp("world"))
    return Made(force_campaign_once, _channel(force_campaign_once, log), truth)


def _log(
    base: Base, planted: tuple[Planted, ...], folder: Path, seed: int = 3, outliers: float = 0.0
) -> tuple[ForceLog, np.ndarray]:
    base.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
    rows, truth = log_of(base, planted, outliers)
    return read_force_log(write_log(folder / f"force{seed}.csv", rows, HEADER)), truth


def _channel(base: Base, log: ForceLog) -> ForceChannel:
    return force_channel(base.world.cell, log, arm=arm_posterior(base.world.cell))


def _again(made: Made, log: ForceLog) -> ForceChannel:
    """The channel of the same rows with other readings: the model is prepared already."""
    problem = replace(made.channel.problem, log=log)
    return ForceChannel(problem, fit_effects(problem, (), made.channel.fit), made.channel.effects)


def _part(problem: ForceProblem, rows: np.ndarray) -> ForceProblem:
    """Some rows of a problem, prepared already (not for effects of the arm)."""
    scene = problem.scene
    scene = replace(scene, rows=scene.rows.take(rows), conditions=scene.conditions.take(rows), pressed=scene.pressed[rows])
    return ForceProblem(problem.log.take(rows), scene, problem.believed)


def _active(name: str, joint: int = 0, scanned: dict | None = None) -> Active:
    effect = EFFECTS[name]
    return Active(effect, joint, np.zeros(effect.size), scanned or {}, np.zeros((effect.size, effect.size)))


def _gap(channel: ForceChannel, truth: np.ndarray) -> float:
    at = channel.log.contact
    return float(np.sqrt(np.mean((channel.fit.at.fn - truth)[at] ** 2)))


def test_without_effects_the_believed_contact_meets_the_second_route(made):
    assert _gap(made.channel, made.truth) < 0.05
    assert np.mean(made.channel.fit.residual**2) == pytest.approx(1.0, abs=0.06)
    assert made.channel.noise_floor == pytest.approx(0.2, rel=0.1)


def test_rows_have_unit_noise_under_the_noise_they_were_made_for(made):
    # Readings drawn from the covariance itself, not through the filter: its Cholesky factor run by run.
    whitener = made.channel.fit.whiteners[0]
    rng, n = np.random.default_rng(1), len(made.channel.log)
    drawn = np.zeros((n, 400))
    for kind in whitener.noise.kinds.values():
        log, noise = made.channel.log, kind.noise
        for run in np.unique(log.run[kind.rows]):
            at = kind.rows[log.run[kind.rows] == run]
            lag = np.abs(np.subtract.outer(log.time[at], log.time[at]))
            C = noise.sigma**2 * noise.share * np.exp(-lag / noise.tau)
            C[np.diag_indices(len(at))] = noise.sigma**2
            drawn[at] = np.linalg.cholesky(C) @ rng.normal(size=(len(at), 400))
    plain = Whitener.of(replace(whitener.noise, weight=np.ones(n)), whitener.blocks)
    short = plain.short(drawn)
    covariance = short @ short.T / 400
    assert np.abs(np.diag(covariance).mean() - 1.0) < 0.01
    assert np.sqrt(np.mean((covariance - np.diag(np.diag(covariance))) ** 2)) < 1.1 / np.sqrt(400)


WARM = {"joint_thermal", "link_thermal"}  # this log has no column of the temperature
SHOWN = sorted({n for n, e in EFFECTS.items() if e.on_arm or e.on_contact} - WARM)


def test_a_report_is_handed_little_of_a_channel(made):
    shown = _shown(made.channel)
    assert np.array_equal(shown.gap(), made.channel.gap()) and shown.noise_floor == made.channel.noise_floor
    assert len(pickle.dumps(shown)) < 0.05 * len(pickle.dumps(made.channel))


def test_a_page_that_another_process_draws_tells_what_is_not_corrected(made):
    """It has no more of the channel than the report shows."""
    bias = _active("sensor_bias")
    after = made.channel.with_active((bias,))
    found = SimpleNamespace(active=(bias,), held_out={}, alternatives=(), left_over=(), p_beside=0.0)
    gap = replace(
        signal_gap(found, made.channel, after), shrinkage=(told := Shrinkage(0.6, 0.4, 0.7)), promise={ANOTHER_DAY: told}
    )
    gap = replace(gap, baseline=_shown(gap.baseline), corrected=_shown(gap.corrected))
    for written, words in (((), "would be gone if that were corrected"), ((bias,), "should be gone")):
        assert words in _promise(SimpleNamespace(gaps=(gap,), written=written))


def test_a_log_is_blind_to_what_moves_neither_arm_nor_contact_and_to_warmth_it_did_not_record(made):
    assert {n for n in EFFECTS if made.channel.blind(EFFECTS[n])} == set(EFFECTS) - set(SHOWN)


@pytest.mark.parametrize("name", SHOWN)
def test_columns_are_what_the_refitted_balance_does(made, name):
    channel, effect = made.channel, EFFECTS[name]
    scene, at = channel.problem.scene, channel.fit.at
    rows = scene.touching[:: max(1, len(scene.touching) // 400)]
    for joint in effect.places[:3]:
        scans = effect.scan(joint, channel.surroundings)
        if not len(scans):
            continue
        scanned = scans[len(scans) // 2]
        made_columns = effect_derivatives(scene, at, channel.fit.slopes, effect, joint, [scanned])
        if made_columns is None:
            continue
        for k in range(min(effect.size, 3)):
            a = np.zeros(effect.size)
            a[k] = 0.02 * effect.prior_sd[k]
            both = []
            for sign in (1.0, -1.0):
                one = replace(_active(name, joint, dict(scanned)), a=sign * a)
                there = predict_forces(scene, at.x, (one,), at)
                both.append(there.read[:, rows].ravel())
            difference = 0.5 * (both[0] - both[1])
            column = np.concatenate([c[0][rows, k] for c in made_columns]) * a[k]
            size = np.abs(difference).max()
            np.testing.assert_allclose(column, difference, atol=max(0.02 * size, 2e-5), err_msg=f"{name} {joint} {k}")


@pytest.mark.parametrize("held", [(), ("flange_stiffness", "wheel_law"), ("blade_stiffness", "wheel_stiffness")])
@pytest.mark.parametrize("stated", [False, True])
def test_slopes_are_those_of_the_force(made, held, stated):
    """With effects in the balance too, the cell's own or named: what they add goes with what gives way, and that with its own
    parameters."""
    channel, active = made.channel, tuple(replace(_active(name), a=np.array([0.3])) for name in held)
    scene = replace(channel.problem.scene, given=active if stated else ())
    active = () if stated else active
    at = predict_forces(scene, channel.fit.at.x, active, channel.fit.at)
    theta, joints = scene.slopes(at)
    rows = scene.touching[::50]
    sd = np.sqrt(np.sum(channel.problem.believed.root**2, axis=1))
    give = ("cover_stiffness_scale", "blade_stiffness_scale", "flange_stiffness", "flange_setpoint_offset")
    for i in sorted({*np.flatnonzero(sd[: theta.shape[1]] > 0)[:: 8 if held else 2], *map(NAMES.index, give)}):
        assert sd[i] > 0
        step = np.zeros_like(at.x)
        step[i] = 1e-2 * sd[i]
        high, low = (predict_forces(scene, at.x + s * step, active, at).F[rows] for s in (1.0, -1.0))
        np.testing.assert_allclose(theta[rows, i] * step[i], 0.5 * (high - low), rtol=5e-3, atol=1e-5)
    assert np.abs(joints[rows]).max() > 100.0


def _own_effect(**hooks) -> Effect:
    one = EFFECTS["sensor_bias"]
    return replace(one, name="own", sensor=None, **hooks)


def test_a_push_is_the_stroke_it_takes(made):
    # F (n.a) = setpoint + k stroke + push with the flange along the normal: the same force as an overlap of push / k more.
    channel, at = made.channel, made.channel.problem.scene.touching
    effect = _own_effect(push=lambda x, j, scanned: 10.0 * x.s)
    fn = effect_derivatives(channel.problem.scene, channel.fit.at, channel.fit.slopes, effect, 0, [{}])[0][0, :, 0]
    step = 0.05
    extra = step * 10.0 * channel.problem.scene.conditions.s / channel.problem.scene.cell.flange.stiffness
    force = made.base.force(extra) - made.base.force(-extra)
    np.testing.assert_allclose(fn[at] * 2 * step, force[at], rtol=0.03, atol=2e-4)


def test_a_turn_of_the_base_moves_the_blade_as_a_body(made):
    channel, turn = made.channel, np.array([1e-5, -3e-5, 2e-5])
    effect = _own_effect(twist=lambda x, j, scanned: {0: ca.vertcat(ca.SX.zeros(3, 1), ca.SX(turn))})
    scene, at = channel.problem.scene, channel.problem.scene.touching
    fn = effect_derivatives(scene, channel.fit.at, channel.fit.slopes, effect, 0, [{}])[0][0, :, 0]
    # Where the fit has the contact (a millimetre from where it is: bearing alone is an unknown of the arm), turned as a body.
    R = channel.fit.at.samples[:, PLACE["R_blade"]].reshape(-1, 3, 3)
    p = np.einsum("nij,nj->ni", R, made.base.columns["p"]) + scene.arm.origin
    overlap = -np.sum(channel.fit.at.samples[:, PLACE["e"]] * np.cross(turn, p), axis=1)
    force = channel.fit.at.stiffness * overlap
    np.testing.assert_allclose(fn[at], force[at], atol=0.01 * np.abs(force).max())


def stuck(b: Base, limit: float) -> np.ndarray:
    """Extra overlap m of a flange that friction holds: its stroke stays where it is as long as the limit lets it (play)."""
    k, c = b.world.cell.flange.stiffness, b.columns
    levels = np.linspace(-limit, limit, 9)
    strokes = np.stack([(b.force(np.full(len(b), f / k)) - c["setpoint"] - f) / k for f in levels], axis=1)  # falls with f
    held, out = 0.0, np.zeros(len(b))
    for i in np.flatnonzero(c["contact"] > 0):
        begins = i == 0 or c["run"][i] != c["run"][i - 1]
        held = strokes[i, -1] if begins else min(max(held, strokes[i, -1]), strokes[i, 0])
        out[i] = np.interp(-held, -strokes[i], levels) / k
    return out


# What is planted, which effect is to have which values within 4 sd, and how far off the believed contact is at least (N rms).
PLANTED = {
    "wheel_wear": (Planted(overlap=lambda b: -1.5e-7 * b.columns["clock"]), {}, {"m_per_s": 1.5e-7}, 0.2),
    "wheel_runout": (
        Planted(overlap=lambda b: 3e-5 * np.cos(b.columns["belt"] / b.world.truth.wheel.radius * b.columns["clock"] + 0.7)),
        {"clocked": 1.0},
        {"m": 3e-5, "phase_rad": 0.7},
        0.05,
    ),
    "flange_friction": (Planted(overlap=lambda b: stuck(b, 0.5)), {"turn_N": 1.5}, {"N": 0.5, "turn_N": 0.5}, 0.15),
    "sensor_bias": (Planted(reading=lambda c, F: 0.4 + 0.0 * F), {}, {"N": 0.4}, 0.0),
    "sensor_crosstalk": (Planted(reading=lambda c, F: 0.05 * 0.35 * F * np.sign(c["belt"])), {}, {"share": 0.05}, 0.1),
}


@pytest.mark.parametrize("name", sorted(PLANTED))
def test_a_planted_effect_comes_out_with_its_value(made, tmp_path, name):
    planted, scanned, values, least = PLANTED[name]
    log, truth = _log(made.base, (planted,), tmp_path)
    channel = _again(made, log)
    assert _gap(channel, truth) > least
    after = channel.with_active((_active(name, 0, scanned),))
    assert _gap(after, truth) < (0.06 if name == "flange_friction" else 0.04)  # play is stiffer than what is held softly
    found, sd = after.active[0].parameters, after.active[0].deviations
    for key, value in values.items():
        assert abs(found[key] - value) < 4 * sd.get(key, 0.1 * value) + 0.03 * abs(value), (key, found[key])


def test_a_blade_that_slipped_since_the_calibration_is_among_the_names(made, tmp_path):
    moved, problem, fit = 3e-4, made.channel.problem, made.channel.fit
    x = problem.believed.mean + problem.believed.root @ fit.z[: problem.sizes[0]]
    C = covariance_left(problem.believed.root, fit.information)
    at = np.flatnonzero(np.diag(C)[: BIAS + 1])
    registered = Calibration(
        problem.scene.cell.robot.name, tuple(FIT_NAMES[i] for i in at), x[at], C[np.ix_(at, at)], {FORCE: {}}
    )
    log, truth = _log(made.base, (Planted(overlap=lambda b: np.full(len(b), -moved)),), tmp_path, 5)
    scene = replace(problem.scene, cell=replace(problem.scene.cell, calibration=registered))
    moved_on = replace(problem, log=log, scene=scene, believed=contact_prior(scene.cell))
    channel = ForceChannel(moved_on, fit_effects(moved_on), made.channel.effects)
    began = float(log.clock.min())
    assert channel.surroundings.breaks[0] == began
    assert made.channel.surroundings.breaks[0] > began  # where nothing is registered it is registration
    found = diagnose_channels((channel,), {n: EFFECTS[n] for n in ("clamp_slip", "wheel_frame_shift", "backlash")})
    assert {("clamp_slip", began), ("wheel_frame_shift", began)} == {
        (r.name.effect, r.active.scanned["at_s"]) for r in found.ranking[:2]
    }
    assert found.p_none < 0.01
    after = channel.with_active((_active("clamp_slip", 0, {"at_s": began, "side": (0.0, 0.0, 0.0)}),))
    assert after.active[0].a[0] == pytest.approx(moved, abs=4 * float(np.sqrt(after.active[0].covariance[0, 0])))
    assert _gap(after, truth) < 0.06 < 0.5 * _gap(channel, truth)
    # Until it has its name the log is as of another cell; a fit without rest says nothing of it.
    assert channel.surprises and not after.surprises
    assert not replace(channel, fit=replace(channel.fit, rested=False)).surprises


def test_an_effect_of_the_arm_is_the_same_joint_motion(made, tmp_path):
    def reversal(b: Base) -> np.ndarray:
        sign = np.zeros(len(b))
        for r in np.unique(b.columns["run"]):
            at = np.flatnonzero(b.columns["run"] == r)
            sign[at] = np.sign(np.gradient(b.columns["q"][at, 2]))
        return moved_joints(b, 4e-5 * np.eye(6)[2] * sign[:, None])

    log, truth = _log(made.base, (Planted(overlap=reversal),), tmp_path)
    channel = _again(made, log)
    after = channel.with_active((_active("backlash", 3),))
    assert after.active[0].a[0] == pytest.approx(4e-5, abs=4 * np.sqrt(after.active[0].covariance[0, 0]))
    assert _gap(after, truth) < min(0.04, 0.7 * _gap(channel, truth))


def test_no_effect_is_no_gap_though_readings_are_wild(made, tmp_path):
    log, _ = _log(made.base, (), tmp_path, 12, 0.01)
    assert diagnose_channels([_again(made, log)], EFFECTS).verdict == "no_gap"


def test_gross_readings_are_no_gap_and_their_tails_are_no_noise(made):
    """One reading in a hundred off by newtons: gap, noise and left-out errors are those of the others."""
    log, rng = made.channel.log, np.random.default_rng(12)
    wild = log.contact & (rng.uniform(size=len(log)) < 0.01)
    off = wild * rng.uniform(2.0, 9.0, len(log)) * rng.choice([-1.0, 1.0], len(log))
    problem = replace(made.channel.problem, log=replace(log, fn=log.fn + off))
    channel = ForceChannel(problem, fit_effects(problem), made.channel.effects)
    found = diagnose_channels([made.channel], {})
    plain, gross = (signal_gap(found, c, c) for c in (made.channel, channel))
    assert np.abs(channel.gap()).max() > 5.0 > 1.0 > gross.before.max()
    for name in ("noise_floor", "rms"):
        one, other = (g.noise_floor if name == "noise_floor" else np.sqrt(np.mean(g.before**2)) for g in (plain, gross))
        assert other == pytest.approx(one, rel=0.06), name
    held = [channel.held_out(fold, ()) for fold in channel.folds()]
    assert np.median([h.means[0] / h.means[2] for h in held if h is not None]) == pytest.approx(1.0, abs=0.15)


def test_noise_that_held_what_has_a_name_now_is_estimated_anew(made, tmp_path):
    """Stock in waves shorter than a cubic in time is slow noise until it is named: the floor, predictions' sigma and the promise
    would keep that noise."""
    stock = Planted(overlap=lambda b: 1e-4 * np.cos(5 * np.pi * b.columns["s"] / np.ptp(b.columns["s"])))
    problem = replace(made.channel.problem, log=_log(made.base, (stock,), tmp_path)[0])
    channel = ForceChannel(problem, fit_effects(problem), made.channel.effects)
    assert channel.noise_floor > 1.2 * made.channel.noise_floor
    after = channel.with_active((_active("stock_profile", 0, channel.scan(EFFECTS["stock_profile"], 0)[0]),))
    assert after.noise_floor == pytest.approx(made.channel.noise_floor, rel=0.08)


@pytest.mark.parametrize("name", [None, "sensor_gain"])
def test_what_was_fitted_is_predicted_though_no_fit_on_both_laws_rests(made, monkeypatch, name):
    asked = []

    def restless(*_):
        asked.append(name)
        raise Infeasible("the fit of the force log does not come to rest")

    one = () if name is None else (_active(name, 0, {}),)
    sealed = replace(made.channel.log, fn=np.full(len(made.channel.log), np.nan), ft=None)
    told, fitted = made.channel.predict(sealed, one), made.channel.fitted_with(one)
    made.channel.made.clear()
    monkeypatch.setattr("ocp.diagnose.force.held_out.fit_effects", restless)
    again = made.channel.predict(sealed, one)
    assert fitted.fit.active is not None and len(asked) == (1 if name is None else 2)
    assert np.allclose(again.corrected, told.corrected, atol=0.02) and np.allclose(again.sigma, told.sigma, rtol=0.1)
    own, law = made.channel.problem.scene, made.channel.made["asked"]
    moved = replace(law.measured, q=law.measured.q + 1e-4)  # as if the law that both share differed as much
    off = replace(law, measured=moved, kept={})
    wider = predict_sealed_force(*((c.problem, c.fit) for c in (made.channel, fitted)), off).sigma
    at = fitted.fit.at
    rms = np.sqrt(np.mean((predict_forces(replace(own, rows=off.measured), at.x, at.active).fn - at.fn)[own.rows.contact] ** 2))
    assert rms > 0.2 and np.allclose(np.hypot(again.sigma, rms)[own.rows.contact], wider[own.rows.contact], rtol=0.05)
    made.channel.made.clear()  # what others ask for is fitted


def test_the_fit_without_effects_is_made_once_for_all_alternatives(made, monkeypatch):
    sealed, fits = replace(made.channel.log, fn=np.full(len(made.channel.log), np.nan), ft=None), []
    monkeypatch.setattr(
        "ocp.diagnose.force.held_out.fit_effects", lambda own, active, fit: fits.append(active) or fit_effects(own, active, fit)
    )
    for name in ("sensor_gain", "sensor_bias"):
        made.channel.predict(sealed, (_active(name, 0, {}),))
    assert [len(active) for active in fits] == [0, 1, 1]


def test_fast_patterns_are_kept_where_averages_lose_them(made):
    channel, scanned = made.channel, {"clocked": 1.0}
    whiteners, about = channel.scored.whiteners, (channel.problem.scene, channel.fit.at, channel.fit.slopes)
    fast = effect_derivatives(*about, EFFECTS["wheel_runout"], 0, [scanned])
    length = sum(float(np.sum(w.whole(c[0]) ** 2)) for w, c in zip(whiteners, fast, strict=True))
    assert sum(float(np.sum(w.short(c[0]) ** 2)) for w, c in zip(whiteners, fast, strict=True)) < 0.5 * length
    kept = channel.variants(EFFECTS["wheel_runout"], 0, [scanned])[1]
    assert np.sum(kept**2) == pytest.approx(length, rel=1e-3)
    # A slow effect loses nearly nothing.
    slow = effect_derivatives(*about, EFFECTS["wheel_wear"], 0, [{}])
    full = sum(float(np.sum(w.whole(c[0]) ** 2)) for w, c in zip(whiteners, slow, strict=True))
    assert np.sum(channel.variants(EFFECTS["wheel_wear"], 0, [{}])[1] ** 2) == pytest.approx(full, rel=0.03)


@pytest.mark.parametrize(
    ("name", "joint"), [("gear_harmonic", 2), ("link_bending", 3), ("wheel_wear", 0), ("flange_stiffness", 0)]
)
def test_what_acts_by_the_force_alone_has_the_rows_of_both_readings(made, name, joint):
    channel, effect = made.channel, EFFECTS[name]
    about = channel.problem.scene, channel.fit.at
    assert acts_by_force(*about, effect) and not acts_by_force(*about, EFFECTS["sensor_bias"])
    scans = channel.scan(effect, joint)[:5]
    both = effect_derivatives(*about, channel.fit.slopes, effect, joint, scans)
    wanted = channel.averages.variants(both[: len(channel.fit.whiteners)])
    found = channel.variants(effect, joint, scans)[1]
    assert np.abs(wanted).max() > 0
    np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10 * np.abs(wanted).max())


def test_a_splice_of_unknown_rate_is_found_among_hundreds(made, tmp_path):
    def knock(c, F):
        return 1.5 * (F > 0) * np.exp(-0.5 * (((c["time"] * 8.3) % 1.0 - 0.3) / 0.06) ** 2)

    log, _ = _log(made.base, (Planted(reading=knock),), tmp_path)
    found = diagnose_channels([_again(made, log)], EFFECTS)
    assert [str(n) for n in found.explanations[0].names] == ["belt_splice"]
    assert found.active[0].parameters["hz"] == pytest.approx(8.3, abs=0.1)
    # The value that is told and written is the one that the cell was fitted with.
    (fitted,) = found.channels[0].active
    assert found.active[0].a.tolist() == fitted.a.tolist() == found.ranking[0].active.a.tolist()


def test_evidence_sees_all_of_what_is_not_fitted_yet(made):
    """A knock of the noise's size, among gross readings: with the fit's weights rows show three quarters of it."""
    log, rng = made.channel.log, np.random.default_rng(0)
    knock = 0.2 * log.contact * (np.arange(len(log)) % 12 < 2)
    wild = (rng.random(len(log)) < 0.02) * rng.uniform(1.5, 8.0, len(log)) * rng.choice([-1.0, 1.0], len(log))
    channel = _again(made, replace(log, fn=log.fn + knock + wild))
    columns = [fit.whiteners[0].whole(knock[:, None])[:, 0] for fit in (channel.scored, channel.fit)]
    score, weighed = (fit.residual[: len(log)] @ c for fit, c in zip((channel.scored, channel.fit), columns, strict=True))
    assert score == pytest.approx(weighed, rel=0.05)  # the same slope of the likelihood, over what it changes by
    assert 0.88 < score / (columns[0] @ columns[0]) < 1.12 and weighed / (columns[1] @ columns[1]) < 0.8


def test_a_knock_of_thirty_sigmas_is_found_at_its_height(made, tmp_path):
    """So far off that the fit without it takes every reading of it for gross."""

    def knock(c, F):
        return 8.0 * (F > 0) * np.exp(-0.5 * (((c["time"] * 8.3 + 0.2) % 1.0 - 0.5) / 0.015) ** 2)

    log, _ = _log(made.base, (Planted(reading=knock),), tmp_path)
    (found,) = diagnose_channels([_again(made, log)], EFFECTS).active
    assert found.effect.name == "belt_splice" and found.scanned["clocked"] == 0.0
    assert found.parameters["N"] == pytest.approx(8.0, rel=0.05)


def test_held_out_errors_are_those_of_a_refit(made, tmp_path):
    log, _ = _log(made.base, (PLANTED["wheel_wear"][0],), tmp_path)
    channel = _again(made, log).with_active((_active("wheel_wear"),))
    late = channel.log.run >= 6
    judged = channel.held_out(Fold("late", "time", late), channel.active)
    problem, rest = channel.problem, _part(channel.problem, ~late)
    rows = late & log.contact
    before, after, noise = judged.means
    for active, mean_square in (((), before), ((_active("wheel_wear"),), after)):
        fit = fit_effects(rest, active)
        there = predict_forces(problem.scene, fit.at.x, fit.active)
        assert np.mean((log.fn - there.fn)[rows] ** 2) == pytest.approx(mean_square, rel=0.1, abs=0.004)
    assert before > 4 * noise and after < noise + 3 * judged.estimation
    assert 0 < judged.shared < 0.1 * (before - after)
    assert made.channel.held_out(Fold("late", "time", late), ()).shared == 0.0  # nothing differs
    # The nuisance takes back what the flange's stiffness may be off by: its value is known to 30 %, the readings to a hundredth.
    soft = _again(made, log).with_active((_active("flange_stiffness"),))
    for fold in (f for f in soft.folds() if f.kind == "random"):
        held = soft.held_out(fold, soft.active)
        assert 0 <= held.estimation < 0.02 * held.means[2]


def test_sealed_readings_are_met_within_their_sigma(made, tmp_path):
    planted = (PLANTED["wheel_wear"][0], PLANTED["sensor_bias"][0])
    log, truth = _log(made.base, planted, tmp_path)
    late = (log.run == 6) | (log.run == 7)  # another setpoint, and the belt reversed
    part = _part(replace(made.channel.problem, log=log), ~late)
    channel = ForceChannel(part, fit_effects(part), made.channel.effects)
    active = (_active("sensor_bias"), _active("wheel_wear"))
    sealed = replace(log.take(late), fn=np.full(int(late.sum()), np.nan), ft=None)
    found = channel.predict(sealed, active)
    before, after = (np.abs(x[:, 0] - truth[late]) for x in (found.baseline, found.corrected))
    assert np.sqrt(np.mean(after**2)) < 0.25 * np.sqrt(np.mean(before**2))
    assert np.all(after < 3 * found.sigma[:, 0] + 0.05) and found.sigma.max() < 0.2


def test_an_effect_that_sealed_conditions_say_nothing_of_is_in_the_sigma(made, tmp_path):
    def hot(b):
        return 4e-6 * (b.columns["wheel_temperature"] - 22.0)

    log, truth = _log(made.base, (Planted(overlap=hot),), tmp_path)
    channel = _again(made, log).with_active((_active("wheel_temperature"),))
    late = log.run >= 6
    sealed = replace(log.take(late), fn=np.full(int(late.sum()), np.nan), ft=None)
    told, untold = (channel.predict(s, channel.active) for s in (sealed, replace(sealed, wheel_temperature=None)))
    assert not told.lacking and untold.lacking == ("wheel_temperature",)
    at = sealed.contact
    errors = [np.sqrt(np.mean((p.corrected[:, 0] - truth[late])[at] ** 2)) for p in (told, untold)]
    assert errors[0] < 0.3 * errors[1] and untold.sigma[at].mean() > 1.8 * told.sigma[at].mean()  # what runs differ by is in both
    assert errors[1] < 3 * untold.sigma[at].mean() and np.isfinite(untold.corrected).all()
    # Without its clock the sealed log comes after the log.
    worn = _again(made, log).with_active((_active("wheel_wear"),))
    later = worn.predict(replace(sealed, clock=None), worn.active).corrected[at]
    early = worn.predict(replace(sealed, clock=0 * sealed.clock), worn.active).corrected[at]
    assert np.abs(later - early).mean() > 0.05


def test_missing_columns_blind_and_say_so(made):
    log = replace(made.channel.log, clock=None, ft=None, ground_before=None, wheel_temperature=None)
    scene = replace(made.channel.problem.scene, conditions=log_conditions(made.base.world.cell, log))
    problem = replace(made.channel.problem, log=log, scene=scene)
    channel = ForceChannel(problem, fit_effects(problem), made.channel.effects)
    assert "ground_before" in channel.blind(EFFECTS["material_removal"])
    assert "clock_s" in channel.blind(EFFECTS["sensor_drift"])
    assert "wheel_temperature_C" in channel.blind(EFFECTS["wheel_temperature"])
    assert channel.blind(EFFECTS["tracker_scale"]) and not channel.blind(EFFECTS["wheel_wear"])
    assert not channel.variants(EFFECTS["material_removal"], 0)[0] and channel.variants(EFFECTS["wheel_wear"], 0)[0]
    assert len(channel.fit.whiteners) == 1 and channel.conditions.clock is None
    assert {f.kind for f in channel.folds()} >= {"random", "block", "run", "line", "setpoint", "feed", "belt", "travel"}


def test_setpoints_that_nobody_wrote_down_are_read_off_and_open_in_the_fit(made, tmp_path):
    log, _ = _log(made.base, (PLANTED["wheel_wear"][0],), tmp_path)
    told = log.setpoint
    channel = force_channel(made.base.world.cell, replace(log, setpoint=None), arm=arm_posterior(made.base.world.cell))
    read_off, changed = channel.log, told != 20.0  # runs 5 and 6
    assert np.array_equal(read_off.setpoint_sd > 0, changed) and np.all(np.abs(read_off.setpoint - told) < 1.5)
    scene, offsets = channel.problem.scene, channel.problem.offsets
    for k, run in enumerate((5, 6)):  # its column is what another setpoint does to both readings
        more = replace(scene, rows=replace(scene.rows, setpoint=scene.rows.setpoint + 0.5 * (log.run == run)))
        ends = [predict_forces(s, channel.fit.at.x, (), channel.fit.at) for s in (scene, more)]
        for change, column in zip((ends[1].read - ends[0].read) / 0.5, (offsets.normal, offsets.shear), strict=True):
            wanted = column[:, offsets.runs + k] / read_off.setpoint_sd.max()
            # Wheel and blade give way to more force, so the flange's spring lets go of a seventh of it.
            np.testing.assert_allclose(change, 0.87 * wanted, atol=0.05 * np.abs(wanted).max())
    assert [n for n in channel.problem.notices if "no column setpoint_N" in n and "5 (1" in n and "6 (3" in n]
    assert "setpoint_N" not in channel.problem.scene.conditions.given
    assert not {f.kind for f in channel.folds()} & {"setpoint"}
    assert channel.held_out(Fold("run=6", "run", log.run == 6), ()) is None  # nothing is known of it without its readings
    after = channel.with_active((_active("wheel_wear"),))
    one = after.active[0]
    assert one.a[0] == pytest.approx(1.5e-7, abs=4 * np.sqrt(one.covariance[0, 0]) + 0.05e-7) and one.a[0] > 5e-8
    assert np.sqrt(np.mean(after.gap()[log.contact] ** 2)) < 1.1 * after.noise_floor < 0.25
    assert [str(n) for n in diagnose_channels([channel], EFFECTS).explanations[0].names] == ["wheel_wear"]
    sealed = replace(log.take(log.run == 7), fn=np.full(int((log.run == 7).sum()), np.nan), ft=None)
    known, unknown = (channel.predict(replace(sealed, setpoint=s), ()).sigma.min() for s in (sealed.setpoint, None))
    assert known < 1.0 and 2.5 < unknown < 6.0  # of ten runs one has 12 and one 30 N


def test_forces_that_no_operator_chose_are_no_setpoints(made):
    log, own = replace(made.channel.log, setpoint=None), made.base.world.cell.flange.setpoint
    steady = replace(log, fn=np.where(made.channel.log.setpoint == own, log.fn, log.fn * own / made.channel.log.setpoint))
    assert with_setpoints_read_off(made.channel.log, own) is None and with_setpoints_read_off(log, own) is not None
    for factor in (1.0, 1.15 ** (log.run % 2), np.where(log.line == 1, 1.4, 1.0), 1.4):  # by less, by line, everywhere
        assert with_setpoints_read_off(replace(steady, fn=steady.fn * factor), own) is None
    hardly = replace(steady, fn=np.where(np.isin(log.run, (0, 2)), -0.1, steady.fn))  # contact that is none
    assert with_setpoints_read_off(hardly, own) is None
    later = log.run >= 5  # a blade gripped anew, with the column that says so and without
    moved = replace(steady, fn=steady.fn * np.where(later, 0.6, 1.0))
    assert with_setpoints_read_off(replace(moved, session=later.astype(int), sessions=("a", "b")), own) is None
    assert with_setpoints_read_off(moved, own) is not None


def test_a_fit_goes_on_from_where_one_nearby_stands(made, monkeypatch):
    """The nuisance of a fit follows what it does not hold: beside it an effect at its size is far from the best of both."""
    gain, bias = (replace(_active(name), a=np.array([a])) for name, a in (("sensor_gain", 0.05), ("sensor_bias", 0.5)))
    near = fit_effects(made.channel.problem, (gain,), made.channel.fit)
    begun = []
    monkeypatch.setattr("ocp.diagnose.force.fit._settled", lambda start: begun.append(start) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        fit_effects(made.channel.problem, (bias, gain), near)
    k = len(near.z) - 1
    np.testing.assert_allclose(begun[0].z, [*near.z[:k], 0.0, near.z[k]])
    np.testing.assert_allclose(begun[0].at.fn, near.at.fn, atol=1e-5)


def test_a_fit_that_leaves_far_more_than_none_is_no_fit(made, monkeypatch):
    off = replace(made.channel.fit, at=replace(made.channel.fit.at, read=made.channel.fit.at.read + [[3.0], [0.0]]))
    monkeypatch.setattr("ocp.diagnose.force.channel.fit_effects", lambda *told: off)
    with pytest.raises(Infeasible, match="with sensor_bias the fit of the force log runs off"):
        made.channel.with_active((_active("sensor_bias"),))


def test_friction_follows_the_setpoint_and_the_stroke_follows_the_force(made, monkeypatch):
    scene, fit = made.channel.problem.scene, made.channel.fit
    held = (replace(_active("flange_friction", 0, {"turn_N": 0.4}), a=np.array([0.4])),)
    setpoint, h = NAMES.index("flange_setpoint_offset"), 0.02
    x = fit.at.x
    step = h * np.eye(len(x))[setpoint]
    at = predict_forces(scene, x, held, fit.at)
    ends = [predict_forces(scene, x + sign * step, held, at) for sign in (1.0, -1.0)]
    slopes = scene.slopes(at)
    told = nuisance_derivatives(scene, at, slopes[0])[0][:, setpoint]
    rows = scene.touching
    differences = (ends[0].fn - ends[1].fn)[rows] / (2 * h)
    assert told[rows] == pytest.approx(differences, abs=0.02)
    heard = []
    with monkeypatch.context() as patch:
        patch.setattr(prediction, "carried", lambda scene, at, past: heard.append(past) or 0.0)
        nuisance_derivatives(scene, at, slopes[0])
    strokes = [end.samples[:, PLACE["parts"]][rows, 0] for end in ends]
    assert heard[0][1][rows, setpoint] == pytest.approx((strokes[0] - strokes[1]) / (2 * h), rel=1e-3, abs=1e-8)
    # The parts are those of the force that is told, not of the step before it.
    give, force = at.samples[:, PLACE["slopes"]][rows, 0], at.F[rows]
    near = predict_forces(scene, x + 1e-3 * step, held, at)
    moved = near.samples[:, PLACE["parts"]][rows, 0] - at.samples[:, PLACE["parts"]][rows, 0]
    assert moved == pytest.approx(give * (near.F[rows] - force - 1e-3 * h), abs=1e-13)


def test_friction_that_a_cell_states_is_believed_and_what_no_fit_takes_out_is_told(made):
    cell = made.base.world.cell
    stated = replace(cell, flange=replace(cell.flange, friction=0.3))
    setup = ForceSetup(made.channel.problem.scene.model, (made.channel.problem.scene.rows,), ())
    problem = problem_of(setup, stated, made.channel.log, arm_posterior(cell), made.channel.problem.scene.pressed)
    (given,) = problem.scene.given
    assert given.key == ("flange_friction", 0) and given.parameters == {"N": 0.3, "turn_N": 0.3}
    assert problem_of(setup, cell, made.channel.log, arm_posterior(cell), problem.scene.pressed).scene.given == ()
    believing = replace(cell, effects=(effect_of({"effect": "flange_friction", "N": 0.3}),))
    told = [one for one in prepare_force(believing, [made.channel.log]).notices if "flange_friction" in one]
    assert len(told) == 1 and told[0].endswith("not taken out of the log")


def test_a_rigid_cell_is_a_channel_too(made):
    # The same postures without the flange; readings from the model, sensor_bias planted in them.
    scene = made.channel.problem.scene
    cell = replace(scene.cell, flange=None)
    believed, rng = contact_prior(cell, arm_posterior(cell)), np.random.default_rng(4)
    scene = replace(scene, cell=cell, model=ForceModel(cell, scene.model.law), pressed=None)
    truth = predict_forces(scene, believed.mean + 0.3 * believed.root @ rng.normal(size=believed.root.shape[1]))
    log = replace(made.channel.log, fn=truth.fn + 0.6 + 0.2 * rng.normal(size=len(truth.F)), ft=None)
    problem = ForceProblem(log, scene, believed)
    channel = ForceChannel(problem, fit_effects(problem), (EFFECTS["sensor_bias"],))
    assert channel.blind(EFFECTS["flange_stiffness"])
    assert np.abs(channel.variants(EFFECTS["belt_tension"], 0)[1]).max() > 0
    found = channel.with_active((_active("sensor_bias"),)).active[0]
    assert abs(found.a[0] - 0.6) < 4 * np.sqrt(found.covariance[0, 0]) + 0.02 < 0.2
    assert truth.stiffness[scene.touching].min() > 1.5e4  # N/m: a wheel without a flange


def test_an_effect_that_the_cell_believes_is_in_the_baseline(made):
    log, scene = made.channel.log, made.channel.problem.scene
    louder = replace(log, fn=1.04 * log.fn)
    problem = replace(made.channel.problem, log=louder)
    given = effect_of({"effect": "sensor_gain", "scale": 0.04}).active
    believing = replace(problem, scene=replace(scene, given=(given,)))
    residual = [np.mean(fit_effects(p, (), made.channel.fit).residual ** 2) for p in (problem, believing)]
    found = fit_effects(believing, (_active("sensor_gain"),), made.channel.fit).active[0]
    assert residual[1] == pytest.approx(1.0, abs=0.1) and residual[1] < residual[0]
    assert abs(found.a[0]) < 0.01  # nothing comes on top


def test_a_train_that_may_be_out_of_step_is_sought_anew_and_no_second_one_is_written(made):
    cell, log = made.base.world.cell, made.channel.log
    steady, clocked = (
        effect_of({"effect": "belt_splice", "N": 3.0, "hz": 9.3, "turn": 0.2, "length": 0.05, "clocked": c}) for c in (0.0, 1.0)
    )
    told = SimpleNamespace(believed=(steady, clocked))
    for measured, kept in ((log, [steady.active]), (None, [steady.active, clocked.active])):
        data = SimpleNamespace(setup=SimpleNamespace(tables=told), log=measured)
        assert [*DataSet.believed.fget(data)] == kept
    setup = prepare_force(cell, [log])
    problem = problem_of(setup, replace(cell, effects=(steady, clocked)), log, arm_posterior(cell))
    assert [a.scanned["clocked"] for a in problem.scene.given] == [0.0]


def test_a_force_patch_is_its_kernel(made):
    """Every kernel of the reading that a program knows the conditions of: the patch's columns and what is the same in all
    directions of travel span the kernel."""
    channel, held = made.channel, set()
    at, rows = made.channel.log.contact, len(made.channel.log)
    known = list(kernels(channel.conditions))
    free = [np.ones((rows, 1)), next(k.changes[:, 0, 0] for k in known if k.where == "s")]
    for kernel, variant in ((k, v) for k in known if k.source == "reading" for v in range(k.changes.shape[2])):
        one = as_patch(Name(f"?force/{kernel.where}/reading", 0), variant, 1.0, channel)
        if one is None:
            continue
        held.add(kernel.where)
        own = one.scanned["source"]
        assert own == ("sensor" if variant and kernel.among == 0 else "force")
        assert (np.abs(kernel.changes[~at, :, variant]).max() > 0) == (own == "sensor")
        hook = {"force": "push", "sensor": "sensor"}[own]
        columns = contact_columns(one.effect, hook, 0, [one.scanned], channel.problem.scene.contact, channel.fit.at.samples)[0]
        X, wanted = np.hstack([columns, *free])[at], kernel.changes[at, 0, variant]
        left = wanted - X @ np.linalg.lstsq(X, wanted, rcond=None)[0]
        assert np.abs(left).max() < 1e-6 * np.abs(wanted).max(), kernel.where
    assert held >= {"s", "feed", "setpoint", "belt", "travel", "line", "clock", "wheel_temperature", "s wave"}
    assert held >= {"travel x s", "setpoint x s", "feed x s", "clock x s"}
    turning = replace(channel.conditions, q=channel.conditions.q + np.linspace(0.0, 1.0, rows)[:, None])
    of_q6 = next(k for k in kernels(turning) if (k.where, k.source) == ("q6", "reading"))
    assert of_q6.words(0) == of_q6.words(1) == [f"wave {k} q6" for k in (1, 2, 3, 4)]
    assert not held & {"run", "time", "turn", "time wave", "clock wave", "belt x time"}
    # A further one is of the force or the reading as those are that are there.
    for own in (0, 1):
        there = as_patch(Name("?force/s/reading", 0), own, 1.0, channel)
        beside = channel.with_active((there,))
        further = [as_patch(Name("?force/setpoint/reading", 0), variant, 1.0, beside) for variant in (0, 1)]
        assert [one.scanned["source"] for one in further] == 2 * [("force", "sensor")[own]]


def _clinging(c):
    return np.where(c["run"] == 1, -1.0, 1.0) * np.cos(3 * np.pi * c["s"] / 0.07)


def _fading(c):
    return (c["setpoint"] - 20.0) / 10.0 * np.cos(2 * np.pi * c["s"] / 0.07)


def test_a_patch_of_an_arm_over_time_wants_the_campaigns_clock(made):
    """A sealed log without it is predicted without the patch, which is in its sigma."""
    one = as_patch(Name("?force/time2/joint", 2), 0, 1e-4, made.channel)
    assert one is not None and one.effect.needs == ("clock_s",)
    after = made.channel.with_active((replace(one, a=np.full(len(one.a), 1e-5)),))
    found = Patched(after, Shrinkage(0.5, 0.4, 0.6), ())
    sealed = replace(made.channel.log, fn=np.full(len(made.channel.log), np.nan), ft=None)
    for clock, inside in ((sealed.clock, True), (None, False)):
        asked = replace(sealed, clock=clock)
        told = with_patch(after.predict(asked, ()), found, asked)
        assert (told.inside == inside).all() and bool(told.lacking) != inside and np.isfinite(told.patched_sigma).all()


def test_a_zero_set_anew_goes_by_session_and_the_next_ones_may_be_as_far_off(made, tmp_path, monkeypatch):
    """No name and no patch is of it: it is told, and is in the sigma of what nobody has seen."""
    late = made.channel.log.run >= 4
    log, truth = _log(made.base, (Planted(reading=lambda c, F: 0.8 * (c["run"] >= 4)),), tmp_path)
    log = replace(log, session=late.astype(np.int64), sessions=("morning", "noon"))
    d = diagnose_channels([_again(made, log)], EFFECTS, Options(folds=False))
    assert d.p_unknown > 0.95 and d.remainder is not None and d.remainder.depends_on == ("session",)
    assert d.remainder.subsystem == "sensor"
    (kernel,) = (k for k in kernels(d.baseline[0].conditions) if k.where == "session")
    assert not kernel.changes[:, 1].any()  # of the gauge alone: a blade gripped anew rubs
    blade = replace(log, session=np.where(log.contact, log.session, 0))
    assert not any(k.where == "session" for k in kernels(_again(made, blade).conditions))  # in the air nothing says which
    assert {a.effect.name for a in d.active} <= {"sensor_bias"} and unnamed(d, ()) is None
    sealed = replace(log, fn=np.full(len(log), np.nan), ft=None)
    gaps = (signal_gap(d, d.baseline[0], d.channels[0]),)
    monkeypatch.setattr(answering, "told_beyond", lambda *_: ())
    shared = {"data": None, "unknown": None, "patch": None, "fitted": d.baseline, "written": (), "gaps": gaps}
    told = answering.predict_sealed(SimpleNamespace(diagnosis=d, asked={"force": sealed}, **shared))["force"]
    assert np.sqrt(np.mean(((told.corrected[:, 0] - truth) / told.sigma[:, 0])[log.contact] ** 2)) < 1.5


UNKNOWN = {
    "a blade that clings on its way back": ("force", Planted(overlap=lambda b: 1.3e-4 * _clinging(b.columns))),
    "a sensor that fades along the lines": ("sensor", Planted(reading=lambda c, F: 0.9 * _fading(c) * (F > 0))),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_a_force_without_a_name_is_patched(made, tmp_path, name):
    """By a formula of the test's own, which no effect of the catalogue has: most of it is gone, as promised, and where nothing
    was measured it is in sigma. Friction tells whether it is a force."""
    source, planted = UNKNOWN[name]
    log, truth = _log(made.base, (planted,), tmp_path)
    d = diagnose_channels([_again(made, log)], EFFECTS, Options(folds=False))
    assert d.p_unknown > 0.95
    unknown = unnamed(d, ())
    found = patched(unknown, None)
    assert found is not None and found.channel.name == "force" and found.shrinkage.low > 0.0
    assert {one.scanned["source"] for one in found.patches} == {source}
    assert as_patch(Name("?force/s/reading", 0), 0, 1.0, found.channel).scanned["source"] == source
    sealed = replace(log, fn=np.full(len(log), np.nan), ft=None)
    told = with_patch(found.channel.predict(sealed, ()), found, sealed)
    at = log.contact

    def rms(off):
        return float(np.sqrt(np.mean(off[at] ** 2)))

    came = 1.0 - rms(told.patched[:, 0] - truth) / rms(told.baseline[:, 0] - truth)
    assert came > 0.5 and found.shrinkage.low < came < found.shrinkage.high + 0.1
    assert told.inside.all() and rms((told.patched[:, 0] - truth) / told.patched_sigma[:, 0]) < 3.0
    plain = found.channel.predict(sealed, ())
    wide = beside_unknown(plain, unknown, sealed, ()).sigma[:, 0]
    assert rms((told.baseline[:, 0] - truth) / wide) < 1.5 < rms((told.baseline[:, 0] - truth) / plain.sigma[:, 0])
    if "setpoint" in found.patches[0].effect.name:
        harder = replace(sealed, setpoint=np.full(len(log), 60.0))
        away = with_patch(found.channel.predict(harder, ()), replace(found, others=()), harder)
        known = rms(found.channel.predict(harder, found.channel.active).sigma[:, 0])
        first = slice(sum(found.channel.problem.sizes), sum(found.channel.problem.sizes) + found.patches[0].effect.size)
        usual = np.sum(found.channel.fit.normal[at, first] ** 2) / at.sum()
        assert not away.inside[at].any()
        assert rms(away.patched_sigma[:, 0]) ** 2 - known**2 == pytest.approx(usual, rel=0.3)
        assert usual > 2.0 * rms(told.patched_sigma[:, 0]) ** 2
        assert (away.patched_sigma[~at, 0] ** 2 > 0.7 * usual).all()  # a sensor reads so in the air too
