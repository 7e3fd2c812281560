"""A patch of what has no name: the features of the kernels as one formula, what comes of it on new postures, where it holds."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from ocp.diagnose.engine.beam import Search
from ocp.diagnose.engine.channel_system import Fold, Sealed
from ocp.diagnose.engine.findings import Alternative, Name, Options
from ocp.diagnose.engine.kernels import conditions_by_name, kernels, measured_ranges
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.foresee.patched import beside_unknown, patched, unnamed, with_patch
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import believed_baseline
from ocp.diagnose.verdict.answer import Patched, Remaining
from ocp.diagnose.verdict.diagnosis import diagnose_channels, errors_of_folds
from ocp.diagnose.verdict.patching import as_patch, patches_of, seen_by
from ocp.diagnose.verdict.shrinkage import ANOTHER_DAY, Shrinkage, estimation_variance, from_folds
from ocp.effects.cell_effects import patch_effect_of
from ocp.effects.engine.readings import displaced, motion
from ocp.effects.engine.symbolic import planned_arm_context
from ocp.effects.patch import feature_factors, lengths_outside, make_patch, patch_of, patch_table, within
from robots.calibration.noise import Noise
from robots.calibration.solver import Campaign
from robots.kinematics import chain
from tests.diagnose.test_diagnosis_kernels import JOINTS, findings_of
from tests.diagnose.test_diagnosis_tracker import LIBRARY, ROBOT, channel, world
from tests.support.simulated_campaign import INSTRUMENT, PAYLOADS, campaign_readings


@pytest.fixture(scope="module")
def clean():
    return channel(world(11)[0])


def test_a_patch_is_its_kernel(clean):
    """Every kernel of joint 2, of beam and frame that a patch can hold moves the readings as the patch's columns do."""
    seen = set()
    for kernel in kernels(clean.conditions):
        if kernel.joint not in (0, 2) or (kernel.where, kernel.source) in seen or "payload" in kernel.where:
            continue
        seen.add((kernel.where, kernel.source))
        variant = kernel.changes.shape[2] - 1
        one = as_patch(Name(f"?tracker/{kernel.where}/{kernel.source}", kernel.joint), variant, 1e-4, clean)
        if one is None:
            continue
        columns = displaced(motion(one.effect, one.joint, [one.scanned], clean.seen), clean.fit.linear.d_joints)[0]
        scale = np.linalg.norm(kernel.changes[:, :, variant], axis=(0, 1)) / np.linalg.norm(columns, axis=(0, 1))
        # Torques are the fit's at the bent posture here, the believed arm's there; a moment's two components have a scale each.
        np.testing.assert_allclose(columns * scale, kernel.changes[:, :, variant], atol=0.02 * np.abs(kernel.changes).max())
        assert kernel.source == "axis" or np.allclose(scale, 1.0, rtol=0.02)
    assert len(seen) > 25


def new_readings(seed, points):
    """Conditions on new postures within the campaign's hours, and where their reflectors are."""
    rng = np.random.default_rng(seed)
    new = campaign_readings(rng, 100)
    time = 500.0 + np.cumsum(rng.uniform(20.0, 70.0, 100))
    new = replace(new.timed(time), temperature=22.0 + 6.0 * (1 - np.exp(-time / 3000.0)))
    return new, points(new)


def rms(off):
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


@pytest.mark.parametrize("name", ["coupled", "settling"])
def test_a_patch_brings_most_of_what_the_exact_signature_would(clean, name):
    """Joint 3 follows joint 2 by a formula of the test's own, or joint 2 comes to rest after its stop: with the patch new
    postures are met nearly as well as by the same arm without the effect."""
    d, readings, points = findings_of(name)
    unknown = unnamed(d, ())
    assert unknown is not None
    found = patched(unknown, None)
    assert found is not None and found.shrinkage.low > 0.0
    new, truth = new_readings(5, points)
    told = with_patch(found.channel.predict(new, ()), found, new)
    before = rms(told.baseline - truth)
    exact = rms(clean.predict(new, ()).baseline - world(11)[1](new)) / before
    came = 1.0 - rms(told.patched - truth) / before
    assert came > 0.75 * (1.0 - exact) and exact < 0.6
    assert found.shrinkage.low - 0.05 < came < found.shrinkage.high + 0.1
    z = (told.patched - truth)[told.inside] / told.patched_sigma[told.inside]
    assert told.inside.mean() > 0.8 and 0.5 < float(np.sqrt(np.mean(z**2))) < 1.6
    plain = found.channel.predict(new, ())
    wide = beside_unknown(plain, unknown, new, d.alternatives).sigma  # without the patch it is in sigma
    assert rms(np.sqrt(wide**2 - plain.sigma**2)) == pytest.approx(rms(told.patched - plain.corrected), rel=0.05)
    assert 0.5 < float(np.sqrt(np.mean(((told.baseline - truth) / wide) ** 2))) < 1.4
    alone, beside = (with_patch(plain, replace(found, others=o), new) for o in ((), (Alternative(0.5, ()),)))
    np.testing.assert_allclose(beside.patched_sigma**2 - alone.patched_sigma**2, 0.5 * (told.patched - plain.baseline) ** 2)
    half = replace(unknown, others=tuple(replace(one, probability=one.probability / 4) for one in unknown.others))
    less = beside_unknown(plain, half, new, d.alternatives).sigma
    np.testing.assert_allclose(less**2 - plain.sigma**2, (wide**2 - plain.sigma**2) / 4)
    campaign = Campaign(ROBOT, readings, PAYLOADS, INSTRUMENT)
    believed = TrackerChannel(*believed_baseline(campaign, (2, 3), 22.0, believed_effects=found.patches))
    assert diagnose_channels([believed], LIBRARY, Options(folds=False)).verdict == "no_gap"


@pytest.mark.parametrize(("later", "written"), [(-0.4, False), (0.0, False), (0.3, True), (None, True)])
def test_beyond_what_was_measured_a_patch_is_written_where_left_out_readings_say_that_it_helps(later, written, monkeypatch):
    """What settles anew in every session has no more at the edge of the measured hours what it has beyond: of four such machines
    three were made worse, by up to twice the gap, at promises of 0.66 to 0.78."""
    good = Shrinkage(0.7, 0.3, 0.8)
    told = {} if later is None else {"later": Shrinkage(later, later, later)}
    fakes = {
        "errors_of_folds": lambda *_: {"tracker": ()},
        "promise_by_kind": lambda *_: told,
        "kinds_beyond": lambda *_: ("later",),
        "told_by_readings": lambda _: False,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(f"ocp.diagnose.foresee.patched.{name}", fake)
    found = SimpleNamespace(after=SimpleNamespace(name="tracker", active=()), others=((), ()))
    for asked in (True, False):
        monkeypatch.setattr("ocp.diagnose.foresee.patched.anticipated_shrinkage", lambda *_, asked=asked: (good, asked))
        assert (patched(found, None, object()) is not None) == (written or not asked)


@pytest.mark.parametrize(
    ("day", "region", "written"), [((0.3, 0.1), 0.2, True), ((0.3, 0.1), -0.1, False), ((0.3, -0.1), 0.2, False)]
)
def test_where_left_out_readings_promise_every_kind_of_them_has_to(day, region, written, monkeypatch):
    """On an arm that misses far more than noise: evidence, which chose the kernels, is worth little there."""
    good = Shrinkage(0.7, 0.3, 0.8)
    kinds = {ANOTHER_DAY: Shrinkage(day[0], day[1], 0.5), "another region": Shrinkage(region, -0.5, 0.5)}
    fakes = {
        "errors_of_folds": lambda *_: {"tracker": ()},
        "promise_by_kind": lambda *_: kinds,
        "told_by_readings": lambda _: True,
        "anticipated_shrinkage": lambda *_: (good, False),
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(f"ocp.diagnose.foresee.patched.{name}", fake)
    found = SimpleNamespace(after=SimpleNamespace(name="tracker", active=()), others=((), ()))
    assert (patched(found, None) is not None) == written


def test_left_out_readings_promise_what_comes_too(monkeypatch):
    """Joint 3 follows joint 2: what left-out readings promise, as they do of an arm that misses far more than noise, comes on new
    postures."""
    d, _, points = findings_of("coupled")
    unknown = unnamed(d, ())
    by_model = patched(unknown, None)
    monkeypatch.setattr("ocp.diagnose.foresee.anticipated.TrackerChannel.restless", lambda *_: True)
    found = patched(unknown, None)
    assert found is not None and not found.asked and ANOTHER_DAY in found.promise
    held = errors_of_folds([unknown.after], unknown.after.active)["tracker"]
    assert found.shrinkage == from_folds(held, estimation_variance(unknown.after)) != by_model.shrinkage
    new, truth = new_readings(5, points)
    told = with_patch(found.channel.predict(new, ()), found, new)
    came = 1.0 - rms(told.patched - truth) / rms(told.baseline - truth)
    assert found.shrinkage.low - 0.1 < came < found.shrinkage.high + 0.1


def test_a_patch_ends_where_few_readings_lie(clean):
    """A few readings of another session lie elsewhere in a joint's range."""
    c = clean.conditions
    n = len(c.q)
    far = replace(c, q=c.q.copy())
    far.q[:, 0] = np.linspace(-5.0, -3.0, n)
    far.q[0, 0] = 5.0
    whole = measured_ranges(far, 0.0)
    assert whole["q1"] == pytest.approx((far.q[1, 0], -3.0)) and whole["q2"] == (c.q[:, 1].min(), c.q[:, 1].max())
    far.q[0, 0] = -2.84
    assert measured_ranges(far, 0.0)["q1"][1] == -2.84  # one reading somewhat farther than the others is an end like any
    hot = replace(c, temperature=np.where(np.arange(n) == 0, 90.0, c.temperature))
    assert measured_ranges(hot, 0.0)["warm"][1] == 90.0 - c.reference  # few readings at another level are a level
    far.q[0, 0] = -5.0
    assert measured_ranges(far, 0.0, np.arange(n) < n // 2)["q1"][1] == pytest.approx(far.q[n // 2 - 1, 0])


def test_a_fold_is_predicted_by_a_patch_of_what_was_left(clean, monkeypatch):
    """What the held readings alone measured is beyond its range there: that is what new data beyond it will have."""
    c, seen = clean.conditions, []
    one = make_patch("joint", "q2", 3, ["wave 1 q2"], {"q2": (float(c.q[:, 1].min()), float(c.q[:, 1].max()))}, 1e-4)
    monkeypatch.setattr("ocp.diagnose.tracker.channel.held_out_readings", lambda *args: seen.append(args[3]))
    low = c.q[:, 1] < np.median(c.q[:, 1])
    clean.held_out(Fold("joint 2 above", "joint range", ~low), (one,))
    ((narrow,),) = seen
    assert narrow.scanned["range"][0][2] == pytest.approx(c.q[low, 1].max()) and narrow.key == one.key
    assert within(one, lambda _: {"q2": (-9.0, 9.0)}).scanned["range"] == one.scanned["range"]  # never wider


@pytest.mark.parametrize(("joints", "sigma", "square"), [(1e-3, 2e-5, 8e-5**2 / 3), (1e-3, 6e-5, 6e-5**2), (1e-6, 2e-5, 2e-5**2)])
def test_what_a_patch_surely_leaves_above_the_noise_is_in_its_sigma(clean, joints, sigma, square, monkeypatch):
    """A play that fades along its axis is followed to 0.08 mm, and noise of joints stands for the rest, once: what lasts of it is
    in sigma already. An instrument worse than stated leaves as much, and nothing of it lasts."""
    monkeypatch.setattr("ocp.diagnose.foresee.patched.beyond", lambda *_: (np.zeros((4, 1)), np.ones(4, bool)))
    monkeypatch.setattr("ocp.diagnose.foresee.patched.remaining", lambda *_: Remaining(8e-5, 1e-9))
    told = Sealed(np.zeros((4, 3)), np.zeros((4, 3)), np.full((4, 3), sigma))
    monkeypatch.setattr(TrackerChannel, "predict", lambda *_: told)
    after = replace(clean, fit=replace(clean.fit, noise=Noise(joints)))
    found = with_patch(told, Patched(after, Shrinkage(0.5, 0.4, 0.6), ()), None).patched_sigma ** 2
    np.testing.assert_allclose(found, square)


def test_a_program_has_nothing_of_what_settles(clean):
    """Nobody knows what an arm that moves on has left of its motions: a patch of them is in readings alone."""
    one = replace(
        make_patch("joint", "approach2 x wait", 2, ["approach2 * settling20"], {"settling20": (0.0, 0.9)}, 1e-4), a=np.ones(1)
    )
    r, waits = clean.readings, np.exp(-clean.readings.waited / 20.0)
    shift, _ = motion(one.effect, 2, [one.scanned], clean.seen)
    np.testing.assert_allclose(shift[0, :, 1, 0], r.approach[:, 1] * waits, rtol=1e-12)
    frames = chain(ca.SX(r.q[0]), ROBOT.mdh, ROBOT.sign)
    state = {"q": ca.SX(r.q[0]), "q_real": ca.SX(r.q[0]), "tau": ca.SX.zeros(6), "c": ca.SX.zeros(6), "payload": ca.SX.zeros(4)}
    conditions = {name: ca.SX.ones(6) for name in ("approach", "speed")} | {name: ca.SX(1.0) for name in ("warm", "time")}
    planned = planned_arm_context(ROBOT, "bare", frames, conditions, **state)
    assert not ca.DM(one.effect.joint(planned, 2, one.scanned)).full().any()
    unasked = replace(r, waited=None)
    about = replace(clean, task=replace(clean.task, campaign=replace(clean.task.campaign, readings=unasked)))
    assert not np.any(motion(one.effect, 2, [one.scanned], about.seen)[0])


def test_conditions_that_say_nothing_of_what_settles():
    """Without a time they are predicted all the same, sigma as wide as what is there; after a wait longer than any measured
    nothing is left of it, and that is known."""
    d, _, points = findings_of("settling")
    unknown = unnamed(d, ())
    found = patched(unknown, None)
    new, truth = new_readings(6, points)
    for untimed in (replace(new, time=None), replace(new, time=None, waited=None)):
        plain = found.channel.predict(untimed, ())
        told = with_patch(beside_unknown(plain, unknown, untimed, d.alternatives), found, untimed)
        assert not told.inside.any() and told.lacking == ("patch over approach2 x wait",)
        for sigma in (told.sigma, told.patched_sigma):
            assert 0.8 < rms(told.baseline - truth) / rms(sigma) < 1.15
    assert np.array_equal(beside_unknown(plain, unknown, untimed, unknown.others).sigma, plain.sigma)
    late = campaign_readings(np.random.default_rng(6), 40).timed(500.0 * np.arange(1.0, 41.0))
    rested = with_patch(found.channel.predict(late, ()), found, late)
    assert rested.inside.all() and rms(rested.patched - found.channel.predict(late, ()).corrected) < 3e-5


def test_patches_come_with_the_likeliest_first(clean):
    """One that shares what it has with another course may stand behind one that does not."""
    kernels_by_size = {"temperature x q4": 0.5, "q4 x q3": 0.4, "q4": 0.1}
    problem = linearised([clean], LIBRARY, Options())
    search = Search(problem.pool, 2, 4)
    names = {Name(f"?tracker/{where}/joint", 4): p for where, p in kernels_by_size.items()}
    for name in names:
        search.add(frozenset([problem.index[name]]))
    found = [(a.active[0].effect.name.split("|")[1], round(a.probability, 3)) for a in patches_of(problem, search, names)]
    assert found == [("q4 x q3", 0.4), ("temperature x q4", 0.25), ("time x q4", 0.25), ("q4", 0.1)]


@pytest.mark.parametrize("cooled", [False, True])
def test_what_warms_up_may_as_well_come_with_time(cooled):
    """A gear that gives with the temperature, in a hall that warms up all the time: no reading tells which of the two it is, a
    later day would, and nothing is promised. Where it cools again it is the temperature."""
    give = JOINTS["warm gear"][0]
    readings, points = world(11)
    if cooled:
        readings = replace(readings, temperature=22.0 + 6.0 * np.sin(np.pi * readings.time / readings.time[-1]))
    moved = points(replace(readings, q=readings.q + 4.0 * give(readings))) - points(readings)
    d = diagnose_channels([channel(replace(readings, point=readings.point + moved))], LIBRARY, Options(folds=False))
    shares = {a.active[0].effect.name.split("|")[1]: a.probability for a in d.patches}
    if cooled:
        assert shares["temperature x q4"] > 0.9 and patched(unnamed(d, ()), None) is not None
    else:
        assert shares["temperature x q4"] == shares["time x q4"] > 0.4 and patched(unnamed(d, ()), None) is None


@pytest.mark.parametrize(("name", "instead"), [("settling", ("backlash", 2)), ("resolver", None)])
def test_what_is_true_without_a_kernel(name, instead):
    """Names where some stand for it badly, play for what settles; nothing where none does."""
    d = findings_of(name)[0]
    assert sum(a.probability for a in d.instead) == pytest.approx(1.0)
    keys = {one.key for one in max(d.instead, key=lambda a: a.probability).active}
    assert keys == ({instead} if instead else set())


def test_nothing_planted_no_patch(clean):
    d = diagnose_channels([clean], LIBRARY, Options(folds=False))
    assert d.verdict == "no_gap" and not d.patches and not d.instead and unnamed(d, ()) is None


def example():
    one = make_patch("joint", "q2 x q4", 3, ["cos 2 q2 * sin 1 q4", "wave 3 q4"], {"q2": (-1.0, 0.5), "q4": (-2.0, 2.0)}, 1e-4)
    return replace(one, a=np.array([3e-5, -1e-5]), covariance=np.diag([1e-12, 4e-12]))


def test_a_patch_fades_where_nothing_was_measured(clean):
    """Inside it is there whole; a length of its finest feature beyond, e^-1/2 of it is left; far out nothing."""
    one = example()
    q = {"q2": np.array([0.2, 1.0, 9.0]), "q4": np.array([0.0, 0.0, 0.0])}
    np.testing.assert_allclose(lengths_outside(one, q), [0.0, 1.0, 17.0])
    far = replace(clean.readings, q=np.where(np.arange(6) == 1, clean.readings.q + 9.0, clean.readings.q))
    about = replace(clean, task=replace(clean.task, campaign=replace(clean.task.campaign, readings=far)))
    shift, _ = motion(one.effect, one.joint, [one.scanned], about.seen)
    assert np.abs(shift).max() < 1e-4
    inside = conditions_by_name(clean.conditions, 22.0)
    assert (lengths_outside(one, inside) == 0).any()


def test_a_patch_survives_a_cell_and_a_process():
    one = example()
    table = patch_table(one, "20 %")
    back, effect = patch_of(table), patch_effect_of(table)
    np.testing.assert_allclose(back.a, one.a)
    np.testing.assert_allclose(effect.active.covariance, one.covariance)
    assert back.scanned == one.scanned
    assert pickle.loads(pickle.dumps(one)).effect is one.effect


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"features": ["cos q2"]}, "feature 'cos q2'"),
        ({"features": ["tan 1 q2"]}, "feature 'tan 1 q2'"),
        ({"range": {"q2": [0.0, 1.0]}}, "range.q4"),
        ({"kernel": "hinge"}, "kernel 'hinge'"),
        ({"joint": None}, "needs a joint"),
        ({"weights": [1e-4]}, "as many rows and columns"),
        ({"weights": [1e-4], "covariance": [[0.0]]}, "needs 2 weights"),
        ({"weights": [30.0, 10.0]}, "SI units"),
        ({"covariance": [[float("nan"), 0.0], [0.0, 0.0]]}, "finite numbers"),
        ({"range": {"q2": [float("nan"), 1.0], "q4": [0.0, 1.0]}}, "range.q2"),
        ({"features": ["wave 1 range", "wave 2 range"]}, "where the tracker stands"),
        ({"where": "q2|q4"}, "holds a bar"),
        ({"kernel": "frame", "joint": None, "features": ["approach1"]}, "alone"),
        ({"kernel": "force", "joint": None, "features": ["approach1"]}, "alone"),
        ({"kernel": "force", "joint": None, "features": ["is heavy"]}, "alone"),
        ({"kernel": "frame", "joint": None, "features": ["line 3"]}, "alone"),
        ({"kernel": "force", "joint": None, "features": ["travel", "wave 1 q2"], "weights": [2e3, 0.0]}, "at most 1000 N"),
        ({"covariance": [[1e-11, 9e-12], [0.0, 1e-11]]}, "is symmetric"),
        ({"covariance": [[1e-11, 9e-11], [9e-11, 1e-11]]}, "no sum of its weights has a negative variance"),
        ({"weights": [float("nan"), 0.0]}, "are finite numbers"),
        ({"features": ["travel * cos 1 q2"]}, "what is ground"),
        ({"features": ["line 3", "wave 1 q2"]}, "what is ground"),
        ({"features": ["line x", "wave 1 q2"]}, "feature 'line x'"),
        ({"kernel": "force", "joint": None, "features": ["wave 2 travel"]}, "feature 'wave 2 travel'"),
        ({"features": ["power 2 approach3", "wave 1 q2"]}, "feature 'power 2 approach3'"),
        ({"kernel": "force", "joint": None, "features": ["line 2", "line 3"]}, "range.line"),
    ],
)
def test_a_table_that_is_no_patch_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        patch_of(patch_table(example(), "") | change)


def test_features_are_read_as_written():
    assert feature_factors("approach3 * cos 2.5 q3") == [("itself", 1.0, "approach3"), ("cos", 2.5, "q3")]
    assert feature_factors("is heavy load") == [("is", 1.0, "heavy load")]
    assert feature_factors("travel * line 12") == [("itself", 1.0, "travel"), ("line", 12.0, "line")]


def test_a_patch_needs_what_its_features_vary_with_whatever_it_is_called():
    features = ["approach3 * settling20", "wave 1 warm", "power 1 time", "is heavy", "cos 1 q2"]
    limits = {"settling20": (0.0, 1.0), "warm": (0.0, 5.0), "time": (0.0, 9.0), "q2": (0.0, 1.0)}
    on_arm = make_patch("joint", "whatever", 3, features, limits, 1e-4)
    assert on_arm.effect.needs == ("approach", "clock_s", "payload", "temperature_C", "time_s")
    limits |= {name: (1.0, 3.0) for name in ("line", "feed", "belt", "setpoint", "wheel", "s")}
    features = ["travel * line 2", "wave 1 feed * wave 1 s", "power 1 belt", "wave 1 setpoint", "wave 2 wheel"]
    at_contact = make_patch("force", "whatever", 0, features, limits, 1.0, "force")
    assert at_contact.effect.needs == ("belt_m_s", "feed_mm_s", "line", "setpoint_N", "wheel_temperature_C")
    assert pickle.loads(pickle.dumps(at_contact.effect)) is at_contact.effect
    seen = {name: np.full(3, 2.0) for name in limits} | {"line": np.array([2.0, 4.0, 7.0])}
    assert (lengths_outside(at_contact, seen) > 0).tolist() == [False, True, True]
    # A signal sees its own alone: what another's reads is none of its conditions.
    both = (Alternative(0.7, (at_contact, on_arm)), Alternative(0.3, (on_arm,)))
    assert [one.active for one in seen_by("force", both)] == [(at_contact,), ()]
    (alike,) = seen_by("tracker", both)
    assert alike.active == (on_arm,) and alike.probability == pytest.approx(sum(one.probability for one in both))
