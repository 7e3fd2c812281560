"""The promise of shrinkage: on numbers alone, and against arms in NumPy that know none of the diagnosis' models."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ocp.diagnose import answering, rules
from ocp.diagnose.answering import _at_rest, beside_others
from ocp.diagnose.engine.beam import Weighed
from ocp.diagnose.engine.channel_system import Fold, HeldOut, Sealed
from ocp.diagnose.engine.evidence import project
from ocp.diagnose.engine.findings import Alternative, Diagnosis, Explanation, Name, Options
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.engine.pool import Member, make_pool
from ocp.diagnose.foresee.anticipated import _beyond_measured, anticipated, kinds_beyond, remaining, signal_gap
from ocp.diagnose.rules import BACKGROUND_SIZES, NO_BACKGROUND, NO_OTHER_RIPPLE
from ocp.diagnose.tracker.background import DRAWS, _line, _Waves, _weights, _with_further, background
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import _width_of_weights, usual_noise
from ocp.diagnose.verdict.answer import Remaining, SignalGap, promised
from ocp.diagnose.verdict.diagnosis import leader, screened
from ocp.diagnose.verdict.probabilities import alternatives, gathered, posterior
from ocp.diagnose.verdict.shrinkage import (
    ANOTHER_DAY,
    NONE,
    Anticipated,
    NewReadings,
    Shrinkage,
    drawn_errors,
    from_model,
    promised_by_kind,
    promised_later,
    unexplained,
)
from ocp.effects.effect import Active
from ocp.effects.patch import make_patch
from robots.errors import Infeasible
from robots.gravity import GRAVITY
from tests.diagnose.test_diagnosis_engine import problem_of
from tests.diagnose.test_diagnosis_tracker import LIBRARY, channel, column, diagnosed, world
from tests.support.reference_arm import elementary_weight_torques
from tests.support.simulated_campaign import EXTRA, PAYLOADS, campaign_readings, random_truth


def held(before: float, after: float, n: int = 400, seed: int = 0) -> HeldOut:
    """A fold of n readings with these mean squares beyond a noise of 1."""
    rng = np.random.default_rng(seed)
    rows = [m * rng.chisquare(3, n) / 3 for m in (before + 1.0, after + 1.0)]
    return HeldOut(Fold("x", "random", np.ones(n, bool)), np.stack([*rows, np.ones(n)]))


def new(*moved: float, errors: float = 1.0, lasting: float = 0.0, p: int = 60, doubt: float = 0.0) -> Anticipated:
    """One payload for every mean square that the effects move; parameters' errors and lasting errors in mean squares; doubt: the
    probability that nothing is moved."""
    rng = np.random.default_rng(0)
    n = 400
    errors_of = rng.normal(size=(n, 3, p)) / np.sqrt(3 * p)
    groups = [
        NewReadings(str(k), np.stack([np.full((n, 3), np.sqrt(m / 3)), np.zeros((n, 3))]), errors_of, np.ones((n, 6)) / 6)
        for k, m in enumerate(moved)
    ]
    return Anticipated(tuple(groups), ("0",), np.array([1 - doubt, doubt]), errors * np.eye(p), np.full((50, 6), lasting))


def test_what_the_effects_move_and_what_remains_make_the_promise():
    # Nothing lasts but errors of estimation: 1 - sqrt(E / (E + D)).
    found = from_model(new(24.0), [], 1.0)
    assert found.predicted == pytest.approx(0.8, abs=0.01) and found.high - found.low < 0.12
    lasting = from_model(new(24.0, lasting=5.0), [], 1.0)
    assert lasting.predicted == pytest.approx(1 - np.sqrt(6.0 / 30.0), abs=0.02)
    # Payloads that behave differently widen it, an unexplained rest lowers it, and a hair of a gap has none.
    assert from_model(new(99.0, 0.0), [], 1.0).low < 0.7
    assert from_model(new(24.0), [held(25.0, 9.0)], 1.0).high < 0.6
    assert from_model(new(1e-3, errors=1e-3), [], 1.0) is None
    # What is there again only in part: (rest^2 + (1 - g)^2 D^2) / (rest^2 + g^2 D^2), here with D^2 = 24 rest^2.
    carried = from_model(new(24.0), [], 1.0, (0.8, 0.0))
    assert carried.predicted == pytest.approx(1 - np.sqrt((1 + 24 * 0.04) / (1 + 24 * 0.64)), abs=0.01)
    unsure = from_model(new(24.0), [], 1.0, (1.0, 0.2))
    assert unsure.low < found.low - 0.1 and unsure.predicted < found.predicted


def test_draws_of_errors_have_their_covariance_and_hang_on_no_last_digit():
    rng = np.random.default_rng(2)
    size = 10.0 ** rng.uniform(-6, 3, 8)
    alike = np.eye(8) + 1e-16 * rng.normal(size=(8, 8))  # eigenvalues next to each other: their vectors may be any
    alike[6, 7] = alike[7, 6] = 0.9
    alike[0], alike[:, 0] = 0.0, 0.0  # known
    C = alike * np.outer(size, size)
    drawn = drawn_errors(C, np.random.default_rng(0))
    again = drawn_errors(C * (1 + 1e-15 * rng.normal(size=C.shape)), np.random.default_rng(0))
    assert drawn / size == pytest.approx(again / size, abs=1e-12) and not drawn[:, 0].any()
    assert np.cov((drawn / size).T) == pytest.approx(alike, abs=0.15)


def test_doubt_about_the_name_is_in_the_promise():
    sure, unsure = from_model(new(24.0), [], 1.0), from_model(new(24.0, doubt=0.3), [], 1.0)
    # What is written is the name: right it does all it can, wrong it hurts, and the interval knows.
    assert unsure.predicted < sure.predicted + 0.01 and unsure.low == -1.0


@pytest.mark.parametrize("stands_in, kept", [(0, 1), (1, 0)])
def test_an_effect_that_stands_in_the_background_is_there_all_the_same(stands_in, kept):
    """Two sets as likely: the name, and a line of the background, with the same columns (0) or others (1)."""
    toy, found = problem_of(planted=((0, 1.0),))
    problem = linearised([toy], found, Options())
    told, every, _ = of_name_or(replace(problem.pool.families[stands_in], name=Name("~e"), effect=None, background=True), problem)
    assert [len(one.active) for one in told] == [1, kept] and (every.p_none, every.beside.get((), 0.0)) == (
        pytest.approx(0.5),
        0.0,
    )


def of_name_or(other, problem, patches=(), beside=()):
    """Alternatives and probabilities of two sets as likely, the name and another family, families `beside` in both, and the names
    with their values."""
    problem = replace(problem, pool=make_pool(problem.pool.y, problem.pool.freedom, [*problem.pool.families, other]))
    families = problem.pool.families
    name, nameless = (Weighed(5.0, tuple(Member(k, 0, 1.0) for k in (f, *beside))) for f in (0, len(families) - 1))
    search = SimpleNamespace(
        sets={frozenset({m.family for m in one.members}): one for one in (name, nameless)},
        kernel=np.array([f.effect is None and not f.background for f in families]),
        background=np.array([f.background for f in families]),
    )
    active, every = problem.values(name), posterior(problem, search)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ocp.diagnose.verdict.probabilities.patches_of", lambda *_: patches)
        names = tuple(sorted(families[m.family].name for m in name.members))
        return alternatives(problem, search, every, (name, names), active), every, active


def test_what_has_no_name_is_followed_as_what_stands_for_it():
    """A gap that a kernel explains as well as the name is there under it too; where no patch can hold it, it counts as none."""
    toy, found = problem_of(planted=((0, 1.0),))
    problem = linearised([toy], found, Options())
    kernel = replace(problem.pool.families[0], name=Name("?e"), effect=None)
    patch, beside = (Active(effect, 0, np.zeros(1), {}, np.eye(1)) for effect in list(found.values())[1:3])
    told, every, named = of_name_or(kernel, problem, (Alternative(0.3, (patch,)), Alternative(0.1, (beside,))))
    assert (every.p_none, every.beside.get((), 0.0), every.p_unknown) == (pytest.approx(0.5),) * 3
    assert [one.active for one in told] == [named, (patch,), (beside,)]
    assert [one.probability for one in told] == pytest.approx([0.5, 0.375, 0.125])
    told, _, named = of_name_or(kernel, problem)
    assert [one.active for one in told] == [named, ()]


def test_what_stands_for_one_of_two_names_is_followed_beside_the_other():
    """Of the two names one may be a kernel: then the gap is there all the same, and the other name with it."""
    toy, found = problem_of(planted=((0, 1.0), (1, 1.0)))
    problem = linearised([toy], found, Options())
    kernel = replace(problem.pool.families[0], name=Name("?e"), effect=None)
    patch = Active(found["e2"], 0, np.zeros(1), {}, np.eye(1))
    told, every, _ = of_name_or(kernel, problem, (Alternative(0.3, (patch,)),), beside=(1,))
    assert every.beside == {(Name("e1", 0),): pytest.approx(0.5)} and (every.p_none, every.beside.get((), 0.0)) == (0.0, 0.0)
    assert [[a.effect.name for a in one.active] for one in told] == [["e0", "e1"], ["e1", "e2"]]
    assert [one.probability for one in told] == pytest.approx([0.5, 0.5])
    told, _, _ = of_name_or(kernel, problem, beside=(1,))
    assert [[a.effect.name for a in one.active] for one in told] == [["e0", "e1"], ["e1"]]


def test_three_words_for_one_cause_are_no_three_causes(monkeypatch):
    """Of explanations as e0, e1 (one class) and e2, the likeliest alone is e2, the likeliest cause the class."""
    toy, found = problem_of(planted=((0, 1.0),))
    problem = linearised([toy], found, Options())
    sets = {frozenset({f}): Weighed(log, (Member(f, 0, 1.0),)) for f, log in ((0, 5.1), (1, 5.0), (2, 5.3))}
    families = len(problem.pool.families)
    search = SimpleNamespace(sets=sets, kernel=np.zeros(families, bool), background=np.zeros(families, bool))
    one_class = ((Name("e0", 0), Name("e1", 0)),)
    told = posterior(problem, search)
    assert leader(problem, told)[1] == (Name("e2", 0),)
    monkeypatch.setattr("ocp.diagnose.verdict.diagnosis.classes_of", lambda *_: one_class)
    assert leader(problem, told) == (sets[frozenset({0})], (Name("e0", 0),))
    # None is weighed against the cause; a name that all others imitate does not gather what is theirs.
    assert leader(problem, replace(told, p_none=told.probability[Name("e2", 0),] + 0.01))[1] == (Name("e0", 0),)
    assert leader(problem, replace(told, p_none=0.7)) == (Weighed(0.0, ()), ())
    every = {"e1": ((Name("e0", 0), Name("e1", 0), Name("e2", 0)),)}

    def of_each(_problem, weighed, _active):
        return every.get(found_name(problem, weighed), ())

    monkeypatch.setattr("ocp.diagnose.verdict.diagnosis.classes_of", of_each)
    assert leader(problem, told)[1] == (Name("e2", 0),)


def found_name(problem, weighed):
    return problem.pool.families[weighed.members[0].family].name.effect


def test_patches_too_unlikely_to_be_followed_are_followed_together():
    one, other = (make_patch("joint", where, 3, ["cos 1 q4"], {"q4": (0.0, 1.0)}, 1e-4) for where in ("q4", "again q4"))
    name = Active(LIBRARY["backlash"], 1, np.zeros(1), {}, np.eye(1))
    listed = [Alternative(0.02, (other,)), Alternative(0.5, (name,)), Alternative(0.02, (name, name)), Alternative(0.02, (one,))]
    assert [(a.probability, a.active) for a in gathered(listed, 0.03)] == [(0.5, (name,)), (0.04, (other,)), (0.02, (name, name))]
    assert gathered(listed, 0.01) == sorted(listed, key=lambda a: -a.probability)


def test_what_springs_take_back_is_no_error_of_an_effect():
    readings, _ = world(4)
    bends = LIBRARY["link_bending"]
    c = channel(readings).with_active((Active(bends, 2, np.zeros(1), {"root_share": 0.5}, np.eye(1)),))
    fold = next(f for f in c.folds() if f.kind == "payload")
    alone = np.einsum("nim,mk,nik->n", c.fit.extra, c.active[0].covariance, c.fit.extra)[fold.held].mean()
    assert 0.0 <= c.held_out(fold, c.active).estimation < 0.2 * alone


@pytest.mark.parametrize("weights, low, high", [(True, 0.7, 1.0), (False, 0.0, 0.45)])
def test_weights_are_believed_as_widely_as_the_readings_ask(weights, low, high):
    layout = channel(world(4, weights=weights)[0]).task.layout
    assert low <= (layout.prior_sd / layout.scale)[layout.links[0]] <= high
    # What a maker knows of links says nothing of what a shop knows of its payloads.
    assert np.all((layout.prior_sd / layout.scale)[layout.payload[layout.payload >= 0]] == 1.0)


def test_folds_that_are_no_worse_than_chance_take_nothing_away():
    bare = from_model(new(24.0), [], 1.0)
    told = from_model(new(24.0), [held(25.0, 1.25)], 1.0)  # the errors of estimation, a fifth more on four fifths of the data
    assert told.predicted == pytest.approx(bare.predicted, abs=0.05)
    # Gross readings make folds so unsure that only the prior says what is unexplained: a normal law far out in its tail.
    before, _, noise = held(25.0, 0.0).rows
    gross = np.where(np.arange(400) == 7, 1e6, 1.0)
    for unsure in (replace(held(25.0, 0.0), rows=np.stack([before, after, noise])) for after in (gross, -gross)):
        size = unexplained([unsure], 0.0, np.random.default_rng(0))
        assert np.isfinite(size).all() and (size >= 0).all() and size.max() < 5.0


def lasting_truth(seed: int, size: float):
    """Readings of an arm with background errors up to `size` rad, and what of them comes back: mean square rad^2 (6,)."""
    readings, _ = world(seed, background=size)
    truth = random_truth(np.random.default_rng(seed), size, 2.5e-4)
    return readings, truth.backlash**2 + 0.5 * truth.ripple[:, 0] ** 2


@pytest.mark.parametrize("size", [0.0, 1.5e-5])
def test_what_of_the_joint_noise_comes_back(size):
    told, real = [], []
    for seed in range(40, 44):
        readings, mean_square = lasting_truth(seed, size)
        c = channel(readings)
        levers = np.sum(c.fit.linear.d_joints**2, axis=(0, 1)) / len(readings)
        told.append(np.sqrt(background(c.task, c.fit).draws.mean(axis=0) @ levers))
        real.append(np.sqrt(mean_square @ levers))
    if size:
        ratio = np.array(told) / real
        assert 0.8 < np.median(ratio) < 1.25 and ratio.min() > 0.6 and ratio.max() < 1.6
    else:  # repeatability alone, 1e-5 rad: 30 um at the reflector
        assert np.median(told) < 1.2e-5


def test_few_readings_do_not_make_gears_smooth():
    """Of ninety readings nobody can tell several small lines a gear from repeatability: what real gears have is believed."""
    ratio = []
    for seed in range(50, 56):
        rng = np.random.default_rng(seed)
        orders, phases = rng.integers(3, 150, (6, 4)), rng.uniform(0.0, 2.0 * np.pi, (6, 4))
        rough = lambda r, k=orders, p=phases: 8e-6 * np.cos(k * r.q[:, :, None] + p).sum(axis=2)  # noqa: E731
        c = channel(world(seed, rough, n=90)[0])
        levers = np.sum(c.fit.linear.d_joints**2, axis=(0, 1))
        ratio.append(np.sqrt(c.background.draws.mean(axis=0) @ levers / (2.0 * 8e-6**2 * levers.sum())))
    assert 0.6 < np.median(ratio) < 1.2, ratio


def test_waves_put_together_before_their_orders_are_those_of_every_row():
    rng, n = np.random.default_rng(2), 30
    q, column = rng.uniform(-2, 2, n), rng.normal(size=3 * n)
    projection = project(rng.normal(size=(3 * n, 9)), np.r_[np.full(6, 2.0), np.full(3, np.inf)])
    line = _line(q, column, projection, 0.7)
    X = projection.apply(column[:, None] * np.repeat(line.waves, 3, axis=0)) / 0.7
    c, s = np.hsplit(X, 2)
    np.testing.assert_allclose(line.G, [(c * c).sum(axis=0), (s * s).sum(axis=0), (c * s).sum(axis=0)], atol=1e-9)
    y = rng.normal(size=(4, 3 * n))
    np.testing.assert_allclose(line.met(y).reshape(4, -1), y @ X, atol=1e-9)
    weight, mean = rng.uniform(size=(4, c.shape[1])), rng.normal(size=(4, 2, c.shape[1]))
    told = line.explained(_Waves(np.zeros(4), weight, mean, np.zeros((4, 3, c.shape[1]))))
    np.testing.assert_allclose(told, (weight[:, None] * mean).reshape(4, -1) @ X.T, atol=1e-9)


def test_what_is_beside_a_name_is_told_from_what_takes_its_place():
    """A kernel beside names in 0.4 and without in 0.2, nothing at all in 0.1: of the 0.7 with a name it is in 0.4."""
    at = dict.fromkeys(Diagnosis.__dataclass_fields__, ()) | {"p_none": 0.3, "p_unknown": 0.6, "p_alone": 0.2}
    assert Diagnosis(**at).p_beside == pytest.approx(4 / 7)
    assert Diagnosis(**(at | {"p_none": 1.0, "p_unknown": 0.2})).p_beside == 0.0


def test_sizes_of_the_background_are_evenly_likely_before_any_reading():
    """A grid that is finer where sizes are small does not make small ones likelier."""
    weight = _weights(np.zeros(len(BACKGROUND_SIZES)))
    assert weight[0] == pytest.approx(NO_BACKGROUND) and weight.sum() == pytest.approx(1.0)
    end = BACKGROUND_SIZES[-1] + 0.5 * np.diff(BACKGROUND_SIZES)[-1]  # of the last size's share
    assert weight @ BACKGROUND_SIZES == pytest.approx((1.0 - NO_BACKGROUND) * end / 2.0, rel=0.05)


def test_where_a_name_is_at_stake_large_ripple_is_no_likelier_before_any_reading(monkeypatch):
    """It would take an effect's place; so other gears that tell nothing leave all sizes alike."""
    c = channel(world(40, n=40)[0])
    monkeypatch.setattr("ocp.diagnose.tracker.background._evidence", lambda *told: np.zeros((len(BACKGROUND_SIZES) - 1, 6)))
    _, others = c.ripples
    np.testing.assert_allclose(others[:, 0], NO_OTHER_RIPPLE)
    np.testing.assert_allclose(others[:, 1:], (1.0 - NO_OTHER_RIPPLE) / (len(BACKGROUND_SIZES) - 1))


PLANTED = {
    "backlash": (5, lambda r: column(5, 1.5e-4 * r.approach[:, 4])),
    "gear_2x": (3, lambda r: column(3, 8e-5 * np.cos(2 * r.q[:, 2] + 1.0))),
    "joint_thermal": (4, lambda r: column(4, 2e-5 * (r.temperature - 22.0))),
    "encoder_scale": (1, lambda r: column(1, 6e-5 * r.q[:, 0])),
}


@cache
def fitted(name: str, seed: int, size: float):
    """The believed arm and the one with the name, 200 new postures, and the shrinkage that comes there."""
    joint, shift = PLANTED[name]
    readings, points = world(seed, shift, background=size)
    before = channel(readings)
    effect = LIBRARY[name]
    after = before.with_active((Active(effect, joint, np.zeros(effect.size), {}, np.zeros((effect.size, effect.size))),))
    fresh = campaign_readings(np.random.default_rng(seed + 500), 200)
    fresh = replace(fresh, time=np.linspace(9000, 11000, 200), temperature=np.full(200, 26.0))
    there, told = points(fresh), after.predict(fresh, after.active)
    e, f = (np.sqrt(np.mean(np.sum((p - there) ** 2, axis=1))) for p in (told.baseline, told.corrected))
    return before, after, fresh, 1 - f / e


def promised_and_realised(name: str, seed: int, size: float, asked: bool = False):
    """Shrinkage predicted from the campaign, for any new postures or for those `asked` for, and what came at 200 of them."""
    before, after, fresh, realised = fitted(name, seed, size)
    sealed = replace(fresh, point=np.full((200, 3), np.nan)) if asked else None
    return from_model(anticipated(before, after, (), sealed), [], (1e-3 * after.noise_floor) ** 2), realised


def test_promises_are_kept():
    found = [promised_and_realised(n, 70 + i, 1.5e-5 * (i % 2)) for i, n in enumerate(PLANTED)]
    off = [abs(p.predicted - r) for p, r in found]
    inside = [p.low <= r <= p.high for p, r in found]
    assert np.median(off) < 0.08
    assert sum(inside) >= 3  # of 4; 90 % intervals
    assert np.median([p.high - p.low for p, _ in found]) < 0.45


def test_a_promise_for_the_postures_asked_for_is_nearer():
    told = [promised_and_realised(n, 70 + i, 1.5e-5 * (i % 2), asked=True) for i, n in enumerate(PLANTED)]
    assert np.median([abs(p.predicted - r) for p, r in told]) < 0.04
    assert sum(p.low <= r <= p.high for p, r in told) >= 3  # of 4; 90 % intervals
    # The same posture many times over is one posture: which ones come is not drawn.
    before = channel(world(3, PLANTED["backlash"][1])[0])
    after = before.with_active((Active(LIBRARY["backlash"], 5, np.zeros(1), {}, np.zeros((1, 1))),))
    once, often = (from_model(anticipated(before, after, (), after.readings.take(rows)), [], 0.0) for rows in ([5], [5] * 40))
    assert once.draws == pytest.approx(often.draws, rel=1e-9)


def test_what_else_may_be_true_is_in_the_sigma_of_what_is_written():
    parts = [
        (p, Sealed(np.zeros((2, 3)), np.full((2, 3), x), np.full((2, 3), s))) for p, x, s in ((0.6, 1.0, 0.1), (0.2, 0.0, 0.3))
    ]
    told = beside_others(parts[0][1], parts)
    assert np.allclose(told.corrected, 1.0)
    assert np.allclose(told.sigma**2, 0.75 * 0.01 + 0.25 * (0.09 + 1.0))


def test_a_force_that_one_alternative_in_ten_predicts_is_in_sigma(monkeypatch):
    """A mean follows one in ten by a tenth of what they differ by, a sigma by a third: promises and predictions follow alike."""
    bias = Active(LIBRARY["sensor_bias"], 0, np.ones(1), {}, np.eye(1))

    def predict(sealed, active):
        return Sealed(np.zeros((2, 1)), np.full((2, 1), float(len(active))), np.full((2, 1), 0.1))

    force, may_be = SimpleNamespace(name="force", predict=predict), (Alternative(0.9, (bias,)), Alternative(0.1, ()))
    found = SimpleNamespace(alternatives=may_be, active=(bias,), channels=(force,), baseline=(force,), p_unknown=0.0)
    monkeypatch.setattr(answering, "told_beyond", lambda *_: ())
    shared = {"data": None, "unknown": None, "patch": None, "fitted": (force,), "written": (bias,), "gaps": ()}
    told = answering.predict_sealed(SimpleNamespace(diagnosis=found, asked={"force": None}, **shared))["force"]
    assert np.allclose(told.sigma**2, 0.01 + 0.1 * 1.0)


def gap_of(low: float | None, shows: tuple[str, ...], **kinds: Shrinkage) -> SignalGap:
    """A gap with this low end of its promise, and of that for some kinds of new data; its signal shows some effects."""
    promise = None if low is None else Shrinkage(low + 0.3, low, low + 0.6)
    made = SignalGap("x", "mm", 1.0, np.ones(3), np.ones(3), promise, kinds, (), Remaining(0.0, 1.0), None, None)
    return replace(made, shown=tuple((name, 0) for name in shows))


def test_only_what_is_promised_above_zero_is_written():
    backlash, drift = (Active(LIBRARY[n], 0, np.ones(1), {}, np.eye(1)) for n in ("backlash", "sensor_drift"))
    found = SimpleNamespace(active=(backlash, drift), verdict="explained")
    assert promised(found, [gap_of(0.1, ("backlash",)), gap_of(-0.1, ("sensor_drift",))]) == (backlash,)
    assert promised(found, [gap_of(0.1, ("backlash", "sensor_drift")), gap_of(-0.1, ("sensor_drift",))]) == (backlash,)
    assert promised(found, [gap_of(None, ("backlash", "sensor_drift"))]) == ()
    elsewhere = replace(gap_of(0.1, ("sensor_drift",)), elsewhere=True)  # what its log shows waits for a calibration, no more
    assert promised(found, [gap_of(0.1, ("backlash",)), elsewhere]) == (backlash,)
    assert promised(found, [replace(gap_of(0.1, ("backlash", "sensor_drift")), elsewhere=True)]) == ()
    day = {ANOTHER_DAY: Shrinkage(0.1, -0.01, 0.2)}
    assert promised(found, [gap_of(0.1, ("backlash",), **day)]) == ()
    for low, high, written in (
        (-0.9, -0.1, ()),
        (-0.9, 0.1, (backlash,)),
        (0.0, 0.0, (backlash,)),
    ):  # a left-out condition that says surely no
        assert promised(found, [gap_of(0.1, ("backlash",), later=Shrinkage(-0.5, low, high))]) == written
    doubtful = gap_of(0.1, ("backlash",), later=Shrinkage(-0.1, -0.3, 0.1))
    assert promised(found, [doubtful]) == (backlash,) and doubtful.harmed == ()
    assert promised(found, [replace(doubtful, beyond=("later",))]) == ()  # what is asked for is later
    assert replace(doubtful, beyond=("later",)).harmed == ("later",)
    # What is left out takes what the effect is told by. Beside something of no name that is not enough beyond what was measured.
    partly = SimpleNamespace(active=(backlash,), verdict="partly")
    for kinds, beside in (((), (backlash,)), (("later",), ()), (("another temperature",), (backlash,))):
        silent = replace(gap_of(0.1, ("backlash",), later=Shrinkage(0.0, 0.0, 0.0)), beyond=kinds)
        assert promised(found, [silent]) == (backlash,) and promised(partly, [silent]) == beside


def test_what_is_asked_for_is_held_to_the_same_readings_under_another_name(monkeypatch):
    """A campaign that warms as it goes: its last third is its warmest too, and what that says is told once, of the warmth."""
    left_out = (("temperature", 270), ("time", 270), ("payload", 300))
    every = [replace(held(4.0, 5.0), fold=Fold(kind, kind, np.arange(400) >= n)) for kind, n in left_out]
    assert set(promised_by_kind(every)) == {"another temperature", "another payload"}
    for beyond, kinds in ((("later",), ("later", "another temperature")), ((), ())):
        monkeypatch.setattr("ocp.diagnose.foresee.anticipated._beyond_measured", lambda *_, beyond=beyond: beyond)
        assert kinds_beyond(None, every, None) == kinds


def test_conditions_are_later_or_warmer_where_most_of_them_are():
    known = SimpleNamespace(time=np.linspace(0.0, 100.0, 9), temperature=np.linspace(20.0, 25.0, 9))

    def kinds(time, temperature):
        return _beyond_measured(SimpleNamespace(readings=known), SimpleNamespace(time=time, temperature=temperature))

    later, warm = np.array([90.0, 150.0, 200.0]), np.array([24.0, 26.0, 27.0])
    assert kinds(later, warm) == ("later", "another temperature") and kinds(None, None) == ()
    assert kinds(later - 80.0, warm - 10.0) == ("another temperature",)
    assert kinds(later - 400.0, warm - 3.0) == ()  # before the campaign is not after it
    # A log's folds are of the wheel's temperature.
    log = SimpleNamespace(clock=known.time, time=np.zeros(9), temperature=known.temperature, wheel_temperature=known.temperature)
    asked = SimpleNamespace(clock=later, temperature=warm, wheel_temperature=warm - 4.0)
    assert _beyond_measured(SimpleNamespace(log=log), asked) == ("later",)
    asked = SimpleNamespace(clock=None, temperature=None, wheel_temperature=warm)
    assert _beyond_measured(SimpleNamespace(log=log), asked) == ("another temperature",)


def test_a_condition_that_the_believed_cell_hardly_knows_says_no_harm():
    """What the cell is off by there meets both errors, one larger and the other smaller."""
    worse = replace(held(2.0, 2.2), fold=Fold("line=1", "line", np.ones(400, bool)))
    (surely,), (perhaps,) = (promised_by_kind([replace(worse, shared=s)]).values() for s in (0.0, 0.8))
    assert surely.high < 0.0 < perhaps.high and perhaps.predicted == pytest.approx(surely.predicted, abs=0.1)


def test_a_promise_for_another_day_is_what_is_carried_there():
    told = Shrinkage(0.24, 0.2, 0.28, np.full(4000, 0.24))
    sure, chosen = promised_later(told, False), promised_later(told, True)
    assert abs(sure.predicted - 0.24) < 0.01 and 0.1 < sure.low < 0.22 and sure.high > 0.26
    assert chosen.low < sure.low and chosen.predicted < sure.predicted
    # Of the UR10's series C 28 % of what the names explain is there on D: 0.426 -> 0.477 mm came, from 24 % on C.
    rest, share = 0.76**2, 0.28
    came = 1 - np.sqrt((rest + (1 - share) ** 2 * (1 - rest)) / (rest + share**2 * (1 - rest)))
    assert came == pytest.approx(1 - 0.477 / 0.426, abs=0.03)
    harm = Shrinkage(-0.1, -0.1, -0.1, np.full(10, -0.1))
    assert promised_later(harm, True).predicted == pytest.approx(-0.1)


def test_left_out_conditions_say_what_is_new_in_new_data():
    rng = np.random.default_rng(0)

    def left_out(name: str, kind: str, after: float) -> HeldOut:
        rows, held = rng.uniform(0.9, 1.1, 200), np.arange(800) // 200 == "abcd".index(name)
        return HeldOut(Fold(name, kind, held), np.stack([4 * rows, after * rows, np.ones(200)]))

    asked = (("a", "payload", 1.3), ("b", "time", 9.0), ("c", "joint range", 2.0), ("d", "random", 1.0))
    kinds = promised_by_kind([left_out(*one) for one in asked])
    assert list(kinds) == ["another payload", "later", "another region"]
    assert kinds["another payload"].low > 0.4 and kinds["later"].high < 0 < kinds["another region"].low
    # A payload that was carried last, and warm: the same readings, no word of its own on warmth.
    twice = promised_by_kind([left_out(*one) for one in (*asked, ("a", "temperature", 9.0))])
    assert list(twice) == list(kinds)


def test_what_remains_is_told_from_noise():
    """After the names: noise alone is noise; a wave that nobody named is not, and its size is told."""

    def left(shift):
        d = diagnosed(world(3, shift)[0], where=True)
        return remaining(d.channels[0], d.left_over)

    assert left(None).p_value > 0.01 and left(None).above_noise == 0.0
    wave = left(lambda r: column(3, 6e-5 * np.cos(1.5 * r.q[:, 1])))
    assert wave.p_value < 1e-3 and wave.above_noise > 1e-5


def test_a_payload_that_may_be_all_payloads_is_not_staked_on_one():
    def shift(r):
        """The weight hangs 60 mm off: joints 2 and 3 give way to its moment."""
        rows = np.array([name == "weight" for name in r.payloads])[r.payload]
        hung = PAYLOADS["weight"]
        there, here = (
            elementary_weight_torques(EXTRA, r.q, GRAVITY, hung.mass, hung.com + off) for off in ([0.04, 0.0, 0.045], np.zeros(3))
        )
        return rows[:, None] * (there - here) / EXTRA.stiffness * [0, 1, 1, 0, 0, 0]

    d = diagnosed(world(31, shift)[0])
    told = d.alternatives
    assert d.active and told[0].active and sum(a.probability for a in told) == pytest.approx(1.0)
    assert all(a.probability >= 0.03 for a in told[1:])
    hung = {one.scanned["payload"]: a.probability for a in told for one in a.active if "payload" in one.scanned}
    assert "loaded" in hung and len(hung) >= 2 and max(hung.values()) < 0.95


def test_what_the_nuisance_leaves_of_a_signature():
    c = channel(world(5)[0])
    library = {n: LIBRARY[n] for n in ("encoder_scale", "backlash")}
    left = {s.name: s.left for s in screened(linearised([c], library, Options()))}
    s = c.system
    known = np.isfinite(s.prior_sd)
    A = s.nuisance * np.where(known, s.prior_sd, 1e6 / np.maximum(np.linalg.norm(s.nuisance, axis=0), 1e-12))
    covariance = np.eye(len(A)) + A @ A.T
    for name in (Name("encoder_scale", 3), Name("backlash", 5)):
        C = c.variants(library[name.effect], name.joint)[1][:, 0, 0]
        assert left[name] == pytest.approx(C @ np.linalg.solve(covariance, C) / (C @ C), rel=1e-3)
    assert left[Name("backlash", 5)] > 0.8 > 0.5 > left[Name("encoder_scale", 3)]


def test_the_class_of_a_name_too_weak_to_be_accepted():
    readings, _ = world(9, lambda r: column(1, 1.5e-5 * r.approach[:, 0]))
    d = diagnosed(readings)
    names = {n for group in d.classes for n in group}
    assert {Name("backlash", 1), Name("friction_windup", 1)} <= names


@pytest.mark.parametrize(
    "none, unknown, best, verdict",
    [
        (0.9, 0.1, 0.1, "no_gap"),
        (0.9, 0.9, 0.1, "unexplained"),
        (0.1, 0.9, 0.9, "partly"),
        (0.1, 0.1, 0.9, "explained"),
        (0.1, 0.1, 0.7, "ambiguous"),
    ],
)
def test_the_verdict_follows_from_two_questions(none, unknown, best, verdict):
    told = SimpleNamespace(p_none=none, p_unknown=unknown, explanations=(Explanation((Name("x"),), best, 1.0),))
    assert Diagnosis.verdict.fget(told) == verdict


@pytest.mark.parametrize("before", [1.0, 0.25])
def test_the_width_of_weights_is_that_of_the_readings_whatever_prior_they_were_fitted_with(before):
    """Beside the marginal likelihood of the readings themselves, of a normal distribution with covariance w^2 J J' + 1."""
    rng = np.random.default_rng(8)
    J = rng.normal(size=(40, 5))
    y = J @ rng.normal(0.0, 0.3, 5) + rng.normal(size=40)
    log = np.array([multivariate_normal(cov=w**2 * J @ J.T + np.eye(40)).logpdf(y) for w in rules.WEIGHT_WIDTHS])
    weight = np.exp(log - log.max())
    wanted = np.sqrt(weight @ rules.WEIGHT_WIDTHS**2 / weight.sum())
    covariance = np.linalg.inv(J.T @ J + np.eye(5) / before**2)
    assert _width_of_weights(covariance @ J.T @ y, covariance, before) == pytest.approx(wanted, rel=1e-9)


def test_further_lines_of_gears_have_the_room_that_the_joint_noise_leaves():
    """Lines of thrice the usual repeatability: none where the noise is that alone, some where it has room for one."""
    usual, _ = usual_noise(None)
    size = np.full(DRAWS, 3.0 * usual)

    def share(noise: float, found: float = 0.0) -> float:
        fit, each = SimpleNamespace(noise=SimpleNamespace(joints=noise)), np.full(DRAWS, found**2)
        drawn = _with_further(SimpleNamespace(repeats=None), fit, np.zeros((DRAWS, 6)), each, size, np.random.default_rng(0))
        return float((drawn[:, 0] > 0).mean())

    room = float(np.hypot(usual, size[0]))
    assert share(usual) < 0.05 and share(room) > 0.5
    assert share(room, found=size[0]) < 0.05  # what was found fills it


def test_a_promise_says_whether_it_is_for_the_conditions_asked_for(monkeypatch):
    """Not where these do not say what a name depends on, nor where the arm is judged by left-out readings."""
    before = channel(world(70, PLANTED["backlash"][1])[0])
    after = before.with_active((Active(LIBRARY["backlash"], 5, np.zeros(1), {}, np.zeros((1, 1))),))
    asked = before.readings.take(np.arange(0, len(before.readings), 3))
    warm = Active(LIBRARY["joint_thermal"], 4, np.zeros(1), {}, np.zeros((1, 1)))
    lacking = replace(asked, temperature=None)
    found = SimpleNamespace(active=after.active, held_out={}, left_over=(), patches=(), p_beside=0.0)

    def told(others, sealed):
        found.alternatives = others
        return signal_gap(found, before, after, sealed)

    sure = (Alternative(1.0, after.active),)
    doubt = (Alternative(0.9, after.active), Alternative(0.1, (warm,)))
    assert told(sure, asked).asked and told(sure, lacking).asked and told(doubt, asked).asked
    general = told(sure, None)
    assert not general.asked and not told(doubt, lacking).asked and told(doubt, lacking).shrinkage is not None
    assert told(sure, asked).shrinkage != general.shrinkage
    assert told(sure, asked).asked and not general.asked
    later = replace(asked, time=asked.time + 2.0 * np.ptp(before.readings.time))
    assert told(sure, later).beyond == ("later",) and told(sure, asked).beyond == () == general.beyond
    # An effect that no reading of this signal shows asks for nothing here.
    shift = LIBRARY["tool_frame_shift"]
    moved = Active(shift, 0, np.zeros(shift.size), {"at_s": 0.0}, np.zeros((shift.size, shift.size)))
    assert told((Alternative(0.9, after.active), Alternative(0.1, (*after.active, moved))), replace(asked, time=None)).asked
    with monkeypatch.context() as patch:  # no gap there to speak of
        patch.setattr("ocp.diagnose.foresee.anticipated.from_model", lambda new, *rest: None if new.whole else NONE)
        assert told(sure, asked).shrinkage == NONE and not told(sure, asked).asked
    monkeypatch.setattr(TrackerChannel, "restless", lambda self, level: True)
    assert not told(sure, asked).asked


def test_of_postures_that_are_asked_for_none_is_drawn():
    """Postures at which the effect moves ten times as much as at the others, and an error that is the same at all."""
    made = new(24.0, lasting=5.0)
    far = np.where(np.arange(made.groups[0].moved.shape[1]) % 4, 0.1, 1.0)[:, None]
    group = replace(made.groups[0], moved=made.groups[0].moved * far, errors=1e-6 * made.groups[0].errors)
    asked, drawn = (from_model(replace(made, groups=(group,), whole=whole), [], 1.0) for whole in (True, False))
    assert asked.high - asked.low < 1e-3 < 0.05 < drawn.high - drawn.low


def test_names_that_no_fit_takes_without_the_others_are_not_written():
    def fails(active):
        raise Infeasible("no rest")

    play, drift = SimpleNamespace(key=("backlash", 1), scanned={}), SimpleNamespace(key=("tracker_drift", 0), scanned={})
    arm = SimpleNamespace(name="tracker", active=(play,))
    taking = SimpleNamespace(active=(play, drift), baseline=(SimpleNamespace(with_active=lambda active: arm),))
    refusing = SimpleNamespace(active=(play, drift), channels=(), baseline=(SimpleNamespace(with_active=fails),))
    assert _at_rest(taking, (play,))[0] == (play,) and _at_rest(refusing, (play,)) == ((), refusing.baseline)
    assert _at_rest(refusing, (play, drift)) == ((play, drift), ())  # they stand as they were fitted
