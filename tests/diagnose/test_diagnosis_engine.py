"""The engine on numbers alone: evidence against integration, projection, search, classes, honest p-values."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as f_law
from scipy.stats import gamma, kstest, multivariate_t, norm

from ocp.diagnose.engine import search as engine_search
from ocp.diagnose.engine import selection
from ocp.diagnose.engine.beam import Search, Weighed, weigh
from ocp.diagnose.engine.channel_system import UNSEEN, ReadingConditions
from ocp.diagnose.engine.evidence import Tails, log_evidence, project, size_grid
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.engine.pool import Member, given, scan, scan_one
from ocp.diagnose.engine.search import Circles, Flattered, _with_lines, outliers, search_and_refit
from ocp.diagnose.rules import NOISE_TRUST, TAILS, TAILS_TOLD, WRONG_SIGN
from ocp.diagnose.verdict.diagnosis import diagnose_channels, refitted
from ocp.diagnose.verdict.location import kernel_tests
from ocp.effects.catalogue import library
from ocp.effects.effect import Active
from ocp.effects.forms import odds_of_instants
from robots.gauss_newton import linear_step
from tests.support.linear_channel import LinearChannel, effect

FEW = Options(where=False, prior_effects=0.2)  # a library of six
RNG = np.random.default_rng(7)
N = 60


def brute_force(C, y, sd, positive=False, points=61):
    """log p(y) over log p(y without C) by summing over a grid of coefficients and noise scales; one or two columns."""
    precision = np.geomspace(0.02, 3.0, 80)  # of the noise's inverse variance
    density = gamma(NOISE_TRUST / 2, scale=2 / NOISE_TRUST).logpdf(precision) + np.log(precision)
    m = C.shape[1]
    with_, without = np.zeros(80), np.zeros(80)
    for i, h in enumerate(precision):
        # In the closed form the prior of the coefficients scales with the noise.
        width = sd / np.sqrt(h)
        centre = np.linalg.solve(C.T @ C + np.eye(m) / sd**2, C.T @ y)
        spread = 8 / np.sqrt(h * np.diag(C.T @ C + np.eye(m) / sd**2))
        axes = [np.linspace(c - s, c + s, points) for c, s in zip(centre, spread, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, m)
        prior = norm.logpdf(grid, 0, width).sum(axis=1)
        if positive:
            prior = np.where((grid >= 0).all(axis=1), prior + m * np.log(2), -np.inf)
        rest = ((y[None] - grid @ C.T) ** 2).sum(axis=1)
        cell = np.prod([a[1] - a[0] for a in axes])
        log = -0.5 * h * rest + prior + 0.5 * len(y) * np.log(h)
        with_[i] = np.logaddexp.reduce(log) + np.log(cell) + density[i]
        without[i] = -0.5 * h * (y @ y) + 0.5 * len(y) * np.log(h) + density[i]
    return np.logaddexp.reduce(with_) - np.logaddexp.reduce(without)


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("size", [0.0, 0.4, 1.5])
def test_evidence_is_the_integral(m, size):
    C = RNG.normal(size=(N, m))
    y = RNG.normal(size=N) + C @ np.full(m, size)
    sizes = np.array([[0.3, 2.0]])
    found = log_evidence((C.T @ C)[None], (C.T @ y)[None], sizes, np.zeros((1, m), bool), float(y @ y), N)
    for t, value in zip(sizes[0], found[0], strict=True):
        assert value == pytest.approx(brute_force(C, y, t), abs=0.02 + 0.01 * abs(value))


def test_three_coefficients_by_eigenvalues_as_two_by_hand():
    C = RNG.normal(size=(N, 3))
    y = RNG.normal(size=N) + C[:, 0]
    padded = C.copy()
    padded[:, 2] = 0.0  # a column of nothing changes nothing
    args = (size_grid(0.1)[None], np.zeros((1, 3), bool), float(y @ y), N)
    three = log_evidence((padded.T @ padded)[None], (padded.T @ y)[None], *args)
    D = C[:, :2]
    two = log_evidence((D.T @ D)[None], (D.T @ y)[None], args[0], np.zeros((1, 2), bool), args[2], N)
    np.testing.assert_allclose(three, two, atol=1e-9)


@pytest.mark.parametrize("size", [-0.3, 0.1, 1.0])
def test_positive_coefficients_have_half_a_prior(size):
    C = RNG.normal(size=(N, 1))
    y = RNG.normal(size=N) + size * C[:, 0]
    found = log_evidence((C.T @ C)[None], (C.T @ y)[None], np.array([[0.8]]), np.ones((1, 1), bool), float(y @ y), N)[0, 0]
    either, right = brute_force(C, y, 0.8), brute_force(C, y, 0.8, positive=True, points=2001)
    assert found == pytest.approx(np.logaddexp(np.log(WRONG_SIGN) + either, np.log1p(-WRONG_SIGN) + right), abs=0.08)


def test_projection_whitens_the_nuisance_and_takes_out_free_unknowns():
    A, sd = RNG.normal(size=(N, 5)), np.array([0.1, 3.0, 1.0, np.inf, np.inf])
    M = project(A, sd).apply(np.eye(N))
    Sigma = np.eye(N) + (A[:, :3] * sd[:3] ** 2) @ A[:, :3].T
    F, _ = np.linalg.qr(A[:, 3:])
    P = np.eye(N) - F @ F.T
    np.testing.assert_allclose(M @ A[:, 3:], 0, atol=1e-9)
    # lambda = c^T Sigma^-1 c with the free unknowns' covariance without bound
    big = Sigma + 1e9 * A[:, 3:] @ A[:, 3:].T
    c = RNG.normal(size=N)
    assert np.sum((M @ c) ** 2) == pytest.approx(c @ np.linalg.solve(big, c), rel=1e-4)
    np.testing.assert_allclose(M @ Sigma @ M.T, P, atol=1e-8)


def test_projection_does_not_care_for_units_or_for_where_the_fit_stands():
    A, sd = RNG.normal(size=(N, 4)), np.array([1.0, 0.5, np.inf, 2.0])
    y, scale = RNG.normal(size=N), np.array([1e-3, 1e4, 7.0, 1e-6])
    e = effect("e")
    base = LinearChannel(y, A, sd, {("e", 0): RNG.normal(size=(1, N, 1))})
    other = LinearChannel(y, A * scale, sd / scale, base.columns)
    moved = LinearChannel(y, A, sd, base.columns, offset=RNG.normal(size=4))
    free = LinearChannel(y + 1e3 * A[:, 2], A, sd, base.columns)
    reference = linearised([base], {"e": e}, Options()).pool
    for channel in (other, moved, free):
        pool = linearised([channel], {"e": e}, Options()).pool
        np.testing.assert_allclose(pool.y, reference.y, atol=1e-7)
        np.testing.assert_allclose(pool.families[0].columns, reference.families[0].columns, atol=1e-9)


def problem_of(count=6, rows=200, planted=((0, 1.0),), noise=1.0, scans=None, seed=3):
    """A problem with `count` effects of random columns, some planted."""
    rng = np.random.default_rng(seed)
    library = {f"e{i}": effect(f"e{i}", scans=scans) for i in range(count)}
    variants = 1 if scans is None else len(scans)
    columns = {(f"e{i}", 0): rng.normal(size=(variants, rows, 1)) for i in range(count)}
    y = noise * rng.normal(size=rows)
    for i, a in planted:
        y = y + a * columns[(f"e{i}", 0)][0, :, 0]
    channel = LinearChannel(y, rng.normal(size=(rows, 3)), np.full(3, np.inf), columns)
    return channel, library


def test_chain_rule_of_sets():
    channel, library = problem_of(planted=((0, 1.0), (1, -0.5)))
    pool = linearised([channel], library, Options()).pool
    a, b = Member(0, 0, 1.0), Member(1, 0, 1.0)
    both, one = given(pool, [a, b]), given(pool, [a])
    every, sizes = scan_one(pool, one, 1)
    assert both.log - one.log == pytest.approx(every[0, list(sizes).index(1.0)], abs=1e-8)
    assert scan(pool, one).log[1] == pytest.approx(np.logaddexp.reduce(every, axis=None) - np.log(every.size), abs=1e-8)
    single = weigh(pool, [0])
    assert single.log == pytest.approx(scan(pool, given(pool, [])).log[0] + pool.families[0].log_odds, abs=1e-8)


def test_look_elsewhere_costs_the_logarithm_of_the_variants():
    few, library = problem_of(planted=((0, 1.0),), scans=[{"k": 0}])
    many, wide = problem_of(planted=((0, 1.0),), scans=[{"k": i} for i in range(50)])
    one = weigh(linearised([few], library, Options()).pool, [0]).log
    fifty = weigh(linearised([many], wide, Options()).pool, [0]).log
    exact, _ = scan_one(linearised([many], wide, Options()).pool, given(linearised([many], wide, Options()).pool, []), 0)
    assert fifty == pytest.approx(
        np.logaddexp.reduce(exact[0]) - np.log(exact.shape[1] * 50) + np.log(Options().prior_effects / 6), abs=0.05
    )
    assert one > fifty - 20  # other columns, the same planted size


def test_finds_what_was_planted_and_nothing_else():
    channel, library = problem_of(planted=((0, 0.6), (4, -0.5)))
    d = diagnose_channels([channel], library, FEW)
    assert [str(n) for n in d.explanations[0].names] == ["e0", "e4"]
    assert d.verdict == "explained"
    values = {a.effect.name: (a.a[0], np.sqrt(a.covariance[0, 0])) for a in d.active}
    assert abs(values["e0"][0] - 0.6) < 4 * values["e0"][1]
    assert abs(values["e4"][0] + 0.5) < 4 * values["e4"][1]
    assert sum(e.probability for e in d.explanations) + d.p_none == pytest.approx(1.0)


def test_a_search_by_the_best_alone_is_made_good_where_names_explain_what_was_missed(monkeypatch):
    """As long as an arm misses far more than noise only the best sets grow; what is told is weighed against all the same."""
    channel, library = problem_of(planted=((0, 0.6), (4, -0.5)))
    told = diagnose_channels([channel], library, FEW)
    asked = []
    monkeypatch.setattr("ocp.diagnose.engine.search.misses_far_more_than_noise", lambda *_: not asked.append(1))
    again = diagnose_channels([channel], library, FEW)
    assert len(asked) > 2 and again.explanations == told.explanations and again.ranking == told.ranking


def test_two_channels_share_the_coefficient():
    one, library = problem_of(planted=((0, 0.25),), rows=80, seed=5)
    two, _ = problem_of(planted=((0, 0.25),), rows=80, seed=6)
    alone = weigh(linearised([one], library, Options()).pool, [0]).log
    together = weigh(linearised([one, two], library, Options()).pool, [0]).log
    other = weigh(linearised([two], library, Options()).pool, [0]).log
    assert together > max(alone, other)
    d = diagnose_channels([one, two], library, FEW)
    assert d.ranking[0].name == Name("e0")


def test_noise_alone_is_none():
    false = 0
    for seed in range(60):
        channel, library = problem_of(planted=(), seed=100 + seed)
        false += diagnose_channels([channel], library, FEW).p_none < 0.5
    assert false <= 3


def test_a_misjudged_noise_level_names_nothing():
    channel, library = problem_of(planted=(), noise=1.4)
    assert diagnose_channels([channel], library, FEW).p_none > 0.5


def students(rng, readings, freedom):
    """Readings (n, 3) of Student's t as a whole."""
    return rng.normal(size=(readings, 3)) * np.sqrt(freedom / rng.chisquare(freedom, (readings, 1)))


def test_tails_are_as_likely_as_students_law_says():
    rng, readings = np.random.default_rng(2), 200
    tails = Tails(slice(5, 5 + 3 * readings), 3 * np.arange(readings))
    for freedom in (3.0, 4.0, 8.0):
        rows = students(rng, readings, freedom)
        told = [
            max(multivariate_t(np.zeros(3), s * np.eye(3), df=v).logpdf(rows).sum() for s in np.geomspace(0.3, 3.0, 200))
            for v in TAILS
        ]
        normal = norm(0.0, np.sqrt(np.mean(rows**2))).logpdf(rows).sum()
        put = np.concatenate([np.full(5, 99.0), rows.ravel()])
        assert tails.gain(put) == pytest.approx(max(told) - normal - TAILS_TOLD, abs=0.02)
    assert tails.gain(rng.normal(size=5 + 3 * readings)) == 0.0


@pytest.mark.parametrize("tailed", [False, True])
def test_wild_readings_among_tails_are_no_name(tailed):
    """Of two neighbours moved, whichever, the wildest of many wild ones say little; what all readings show is named."""
    readings, false = 70, 0
    scans = [{"at": float(k)} for k in range(readings)]
    two = np.eye(readings) + np.roll(np.eye(readings), 1, axis=0)
    moved = np.stack([np.kron(two[:, k : k + 1], np.eye(3)) for k in range(readings)])
    library = {"moved": effect("moved", prior_sd=(8.0, 8.0, 8.0), scans=scans), "all": effect("all")}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        shown = rng.normal(size=(1, 3 * readings, 1))
        noise = students(rng, readings, 3.0).ravel()
        columns = {("moved", 0): moved, ("all", 0): shown}
        made = LinearChannel(noise, np.zeros((3 * readings, 0)), np.zeros(0), columns, each=3, tailed=tailed)
        false += diagnose_channels([made], library, FEW).p_none < 0.5
        if seed < 3:
            d = diagnose_channels([replace(made, y=noise + 0.8 * shown[0, :, 0])], library, FEW)
            assert "all" in [n.effect for n in d.explanations[0].names]
    assert false <= 1 if tailed else false > 7


def test_twins_are_declared_and_share_an_explanation():
    channel, library = problem_of(planted=((0, 0.5),))
    twin = channel.columns[("e0", 0)] * 1.01 + 0.02 * np.random.default_rng(1).normal(size=(1, 200, 1))
    channel.columns[("e1", 0)] = twin
    d = diagnose_channels([channel], library, FEW)
    assert (Name("e0"), Name("e1")) in d.classes
    assert d.explanations[0].probability > 0.8
    assert not any(Name("e3") in c for c in d.classes)


def test_instants_are_weighed_on_the_clock_of_the_signal_that_sees_the_effect():
    time = np.append(np.arange(20.0), np.arange(100.0, 120.0))
    scans = [{"at_s": t} for t in (4.5, 60.0, 110.5)]
    columns = {("moved", 0): np.stack([(time > s["at_s"])[:, None] * 9.0 for s in scans])}
    seeing = LinearChannel(np.zeros(40), np.zeros((40, 0)), np.zeros(0), columns, time=time)
    other = LinearChannel(np.zeros(9), np.zeros((9, 0)), np.zeros(0), {}, name="force", time=np.linspace(30.0, 90.0, 9))
    families = linearised([seeing, other], {"moved": effect("moved", scans=scans)}, FEW).pool.families
    own = next(f for f in families if f.name.effect == "moved")
    assert own.within == pytest.approx(odds_of_instants(scans, time)) and own.within[1] > 0.6


def test_a_pair_that_neither_shows_alone():
    rng = np.random.default_rng(11)
    a = rng.normal(size=300)
    b = a + 0.15 * rng.normal(size=300)
    library = {n: effect(n, low=0.3) for n in ("e0", "e1", "e2")}
    columns = {("e0", 0): a[None, :, None], ("e1", 0): b[None, :, None], ("e2", 0): rng.normal(size=(1, 300, 1))}
    channel = LinearChannel(2.5 * (a - b) + rng.normal(size=300), np.ones((300, 1)), np.full(1, np.inf), columns)
    pool = linearised([channel], library, Options(prior_effects=0.3)).pool
    search = Search(pool, 3, 6)
    search.begin()
    search.grow()
    assert {pool.families[f].name.effect for f in search.best()[0]} == {"e0", "e1"}
    begun = [weigh(pool, [0, 1], search.sets[frozenset(key)].members).log for key in ([], [0], [1])]  # from either of them alike
    assert begun == pytest.approx([search.sets[frozenset([0, 1])].log] * 3, abs=0.01)


def wave_channel(seed, amplitude=0.0):
    """A joint channel of six angles whose joint 3 swings with q3 times q1, which no library here holds."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, (120, 6))
    rows = np.repeat(np.arange(120), 6)
    y = rng.normal(size=720)
    y.reshape(120, 6)[:, 2] += amplitude * np.cos(2 * q[:, 2]) * np.sin(2 * q[:, 0])
    d = np.tile(np.eye(6)[None] * 1e5, (120, 1, 1))  # 1e-5 rad of noise
    c = ReadingConditions("tracker", q=q, d_joints=d)
    columns = {("e0", 0): rng.normal(size=(1, 720, 1))}
    return SixRows(y, np.ones((720, 1)), np.full(1, np.inf), columns, conditions_given=c, name="tracker"), rows


class SixRows(LinearChannel):
    """Six rows a reading."""

    @property
    def system(self):
        """Readings of six rows."""
        from dataclasses import replace

        return replace(super().system, reading=np.repeat(np.arange(120), 6))

    def whiten(self, changes):
        """Rows of all six components."""
        return changes.reshape(720, -1)


def test_kernels_speak_for_what_nobody_catalogued():
    channel, _ = wave_channel(2, amplitude=8.0)
    d = diagnose_channels([channel], {"e0": effect("e0")}, Options())
    assert d.p_unknown > 0.9
    assert d.verdict == "unexplained"
    assert d.location is not None and d.location.joint == 3
    assert set(d.location.depends_on) == {"q3", "q1"}
    assert d.budget[0].share > 0.5


def test_names_selected_for_what_a_kernel_follows_are_dropped_beside_it(monkeypatch):
    channel, _ = wave_channel(2, amplitude=8.0)
    q, rng = channel.conditions.q, np.random.default_rng(1)
    shape = np.zeros((120, 6))
    shape[:, 2] = np.cos(2 * q[:, 2]) * np.sin(2 * q[:, 0])
    names = {f"e{k}": effect(f"e{k}", prior_sd=(4.0,)) for k in range(4)}
    columns = {(n, 0): (shape.ravel() + 0.5 * rng.normal(size=720))[None, :, None] for n in names}
    partly = tuple(Active(e, 0, np.array([2.0]), {}, np.eye(1)) for e in names.values())
    monkeypatch.setattr(selection, "select_on_held_out", lambda *_, **__: selection.SelectedEffects(partly, (), ()))
    problem, search, _ = selection.select_effects(replace(channel, columns=columns), names, Options())
    best = [str(problem.pool.families[f].name) for f in search.best()[0]]
    assert len(best) == 1 and best[0].startswith("?tracker/"), best

    # What is there beside it stays, though the kernel follows one of them in part.
    own = {"own": rng.normal(size=720), "alike": 0.6 * shape.ravel() + rng.normal(size=720)}
    names |= {n: effect(n, prior_sd=(4.0,)) for n in own}
    columns |= {(n, 0): c[None, :, None] for n, c in own.items()}
    partly += tuple(Active(names[n], 0, np.array([0.5]), {}, np.eye(1)) for n in own)
    both = replace(channel, columns=columns, y=channel.y + 0.5 * sum(own.values()))
    problem, search, _ = selection.select_effects(both, names, Options())
    best = {problem.pool.families[f].name.effect for f in search.best()[0]}
    assert {*own} < best and len(best) == 3, best


def test_kernel_p_values_are_uniform():
    p = []
    for seed in range(12):
        channel, _ = wave_channel(300 + seed)
        problem = linearised([channel], {"e0": effect("e0")}, Options())
        p += [t.p_value for t in kernel_tests(problem, given(problem.pool, []))]
    # kernels of one data set share some of their features: every second one is enough to be nearly independent
    assert kstest(p[::3], "uniform").pvalue > 1e-3
    assert 0.02 < np.mean(np.array(p) < 0.05) < 0.09


def test_kernel_tests_are_f_tests_of_least_squares():
    channel, _ = wave_channel(77)
    problem = linearised([channel], {"e0": effect("e0")}, Options())
    pool = problem.pool
    found = {(t.where, t.source, t.joint): t for t in kernel_tests(problem, given(pool, []))}
    family = next(x for x in pool.families if x.where == "q3 x q1")
    left = np.linalg.lstsq(family.columns.reshape(720, -1), pool.y, rcond=None)[1][0]
    m = np.linalg.matrix_rank(family.columns.reshape(720, -1))
    ratio = (pool.y @ pool.y - left) / m / (left / (pool.freedom - m))
    told = found[("q3 x q1", "joint", 3)]
    assert told.p_value == pytest.approx(f_law.sf(ratio, m, pool.freedom - m), rel=1e-6)


def test_a_kernel_that_follows_whatever_few_readings_say_tests_nothing():
    channel, _ = wave_channel(77)
    problem = linearised([channel], {"e0": effect("e0")}, Options())
    told = {t.where: t for t in kernel_tests(problem, given(problem.pool, []))}
    taken = np.linalg.matrix_rank(next(x for x in problem.pool.families if x.where == "q3 x q1").columns.reshape(720, -1))
    few = kernel_tests(replace(problem, pool=replace(problem.pool, freedom=int(taken))), given(problem.pool, []))
    assert "q3 x q1" in told and "q3 x q1" not in {t.where for t in few} and all(0.0 <= t.p_value <= 1.0 for t in few)


def test_posterior_covers():
    inside = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        C, a = rng.normal(size=(40, 2)), rng.normal(size=2)
        step = linear_step(C @ a + rng.normal(size=40), C, np.zeros(2), np.ones(2))
        inside += abs(step.change[0] - a[0]) < 1.645 * np.sqrt(step.covariance[0, 0])
    assert 0.86 < inside / 400 < 0.94


def test_a_value_is_as_unsure_as_the_order_of_its_wave():
    """Far from angle zero a wave of the next order fits nearly as well, at another phase."""
    orders, q = (3, 4, 5, 6, 7), np.linspace(2.0, 2.5, 80)
    waves = np.stack([np.column_stack([np.cos(n * q), np.sin(n * q)]) for n in orders])
    library = {"wave": effect("wave", prior_sd=(1.0, 1.0), scans=tuple({"order": n} for n in orders), low=0.9)}
    inside, alone = 0, 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        a = rng.normal(size=2)
        y = waves[rng.integers(5)] @ a + rng.normal(size=80)
        whole = linearised([LinearChannel(y, np.zeros((80, 1)), np.ones(1), {("wave", 0): waves})], library, Options())
        best = weigh(whole.pool, [0])
        (one,) = whole.values(best)
        off, sd = abs(one.parameters["a0"] - a[0]), whole.deviations({frozenset([0]): best}, one)
        inside, alone = inside + (off < 1.645 * sd["a0"]), alone + (off < 1.645 * one.deviations["a0"])
    assert 38 <= inside <= 49 and alone < 28, (inside, alone)
    assert 0.0 < sd["order"] < 2.0


class Decay(LinearChannel):
    """An effect that falls with x at a rate that is scanned and may be any."""

    def variants(self, e, joint, scans=None):
        chosen = tuple(e.scan(joint, self.surroundings) if scans is None else scans)
        x = np.linspace(0.0, 1.0, len(self.y))
        return chosen, np.stack([60.0 * np.exp(-s["rate"] * x) for s in chosen], axis=1)[:, :, None]

    def _of(self, a):
        return self.variants(a.effect, a.joint, [a.scanned])[1][:, 0][None]


@pytest.mark.parametrize(("scanned", "open_"), [(5, True), (29, True), (5, False)])
def test_a_value_is_as_unsure_as_a_number_that_was_moved(scanned, open_, monkeypatch):
    """A fast decay that begins high looks like a slow one that begins low, however finely rates were tried before the likeliest
    was moved to where it fits best."""
    if not open_:
        monkeypatch.setattr("ocp.diagnose.engine.linearisation.movable", lambda family: ())
    rates = tuple({"rate": float(r)} for r in np.linspace(0.5, 4.0, scanned))
    library = {"decay": replace(effect("decay", scans=rates, low=0.9), symbolic=("rate",))}
    off, x = [], np.linspace(0.0, 1.0, 60)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        a, rate = rng.normal(), rng.uniform(1.0, 3.5)
        channel = Decay(60.0 * a * np.exp(-rate * x) + rng.normal(size=60), np.zeros((60, 1)), np.ones(1), {("decay", 0): None})
        for _ in range(3):
            whole = linearised([channel], library, Options())
            best = weigh(whole.pool, [0])
            channel = channel.with_active(engine_search.refined(whole, best, whole.values(best)))
        (one,) = whole.values(best)
        sd = whole.deviations({frozenset([0]): best}, one)["a0"]
        off.append((one.parameters["a0"] - a) / sd)
    inside = int(np.sum(np.abs(off) < 1.645))
    assert 51 <= inside <= 58 if open_ else inside < 47, inside


def test_a_value_is_as_unsure_as_what_stands_beside_it():
    """Of two companions that the readings tell apart with odds of ten, one turns the value by half of itself."""
    rng = np.random.default_rng(1)
    u, v, w = np.linalg.qr(rng.normal(size=(80, 3)))[0].T * 30.0
    columns = {(n, 0): c[None, :, None] for n, c in (("own", u), ("across", v), ("along", (v - 0.5 * u + 0.04 * w)))}
    channel = LinearChannel(u + v, np.zeros((80, 1)), np.ones(1), columns)
    whole = linearised([channel], {n: effect(n, low=0.9) for n, _ in columns}, Options())
    sets = {frozenset([0, i]): replace(weigh(whole.pool, [0, i]), log=log) for i, log in ((1, 0.0), (2, np.log(0.1)))}
    (one,) = (a for a in whole.values(sets[frozenset([0, 1])]) if a.effect.name == "own")
    assert whole.deviations({frozenset([0, 1]): sets[frozenset([0, 1])]}, one) == pytest.approx(one.deviations)
    assert one.deviations["a0"] < 0.04
    assert whole.deviations(sets, one)["a0"] == pytest.approx(0.5 * np.sqrt(1 / 11), rel=0.05)


def test_a_share_with_a_sign_beside_it_may_be_negative():
    assert not library()["sensor_crosstalk"].positive.any()
    assert library()["wheel_wear"].positive.all() and library()["joint_compliance"].positive.all()


@dataclass(frozen=True)
class Waves(LinearChannel):
    """A wave of a scanned number of turns; the noise is thought thirty times too large as long as no effect is in."""

    def _of(self, a):
        t = np.linspace(0.0, 1.0, len(self.y))
        wave = np.cos(2 * np.pi * a.scanned["turns"] * t) if a.scanned else -t * np.sin(2 * np.pi * t)
        return wave[None, :, None]

    @property
    def _whitened(self):
        return 1.0 if self.active else 1 / 30

    @property
    def system(self):
        """Whitened by the noise that it is thought to have."""
        plain = super().system
        return replace(plain, residual=self._whitened * plain.residual)

    def variants(self, e, joint, scans=None):
        """Of any number of turns."""
        chosen = tuple(e.scan(joint, self.surroundings) if scans is None else scans)
        made = [self._of(SimpleNamespace(scanned=s))[0] for s in chosen]
        return chosen, self._whitened * np.stack(made, axis=1)


def test_a_scanned_number_is_sharpened_again_at_the_noise_that_its_effect_leaves():
    """At thirty times the noise 1.000 turns fit as well as 1.025, and what they miss of them has another name's shape."""
    wave = effect("wave", prior_sd=(10.0,), scans=tuple({"turns": n} for n in (0.8, 0.9, 1.0, 1.1, 1.2)))
    known = {"wave": replace(wave, symbolic=("turns",)), "other": effect("other", prior_sd=(3.0,))}
    y = 10.0 * np.cos(2 * np.pi * 1.025 * np.linspace(0.0, 1.0, 200)) + np.random.default_rng(4).normal(size=200)
    found = diagnose_channels([Waves(y, np.zeros((200, 1)), np.ones(1), {})], known, FEW)
    assert [a.effect.name for a in found.active] == ["wave"], found.ranking
    assert found.active[0].scanned["turns"] == pytest.approx(1.025, abs=0.005)


class Driving(LinearChannel):
    """Numbers of which effect e1 has e0's shape, and more of it, while e0 is active: a run-out drives what rubs."""

    driven = ("e1",)

    def variants(self, e, joint, scans=None):
        """As e0 and what it leaves where that is active."""
        found, columns = super().variants(e, joint, scans)
        if e.name not in self.driven or not any(a.effect.name == "e0" for a in self.active):
            return found, columns
        return found, (0.6 * self.columns[("e0", 0)][0] + 0.008 * self.system.residual[:, None])[:, None]


class DrivingTwo(Driving):
    """Numbers of which two effects do: once either is found worse the search must not go back to the other."""

    driven = ("e1", "e2")


class Nested(LinearChannel):
    """Numbers of which effect e1 shows little about a fit that holds it."""

    def variants(self, e, joint, scans=None):
        """As given, else a twentieth."""
        found, columns = super().variants(e, joint, scans)
        return found, 0.05 * columns if e.name == "e1" and any(a.effect.name == "e1" for a in self.active) else columns


class Unseen(Driving):
    """Numbers of which effect e1 cannot be computed about its own fit."""

    def variants(self, e, joint, scans=None):
        """As given, else none."""
        held = e.name == "e1" and any(a.effect.name == "e1" for a in self.active)
        return UNSEEN if held else super().variants(e, joint, scans)


def test_columns_of_one_fit_may_flatter_what_another_finds_far_worse():
    channel, known = problem_of(planted=((0, 0.6),))
    driving = Driving(channel.y, channel.A, channel.prior_sd, channel.columns)
    begin = linearised([driving], known, FEW)
    about_e0 = linearised([driving.with_active(begin.values(weigh(begin.pool, [0])))], known, FEW)
    assert weigh(about_e0.pool, [1]).log > weigh(about_e0.pool, [0]).log
    problem, search = search_and_refit(begin, known, FEW)
    logs = {problem.names(k): s.log for k, s in search.sets.items()}
    assert logs[(Name("e0"),)] > logs[(Name("e1"),)] + 5.0
    # By the mean of what columns about either say.
    about_e1 = linearised([driving.with_active(about_e0.values(weigh(about_e0.pool, [1])))], known, FEW)
    each = [weigh(about.pool, [0]).log - weigh(about.pool, [1]).log for about in (about_e0, about_e1)]
    assert each[0] < 0 < each[1]
    assert logs[(Name("e0"),)] - logs[(Name("e1"),)] == pytest.approx(np.mean(each), abs=0.2)


def test_what_is_flattered_most_counts_once_and_names_go_with_their_lines():
    channel, known = problem_of(planted=((0, 0.6),))
    problem = linearised([channel], known, FEW)
    search, circles = Search(problem.pool, 2, 2), Circles()
    search.begin()
    key = frozenset([0, 1])
    search.add(key)
    before = {k: s.log for k, s in search.sets.items()}
    e0, e1, other = (frozenset([Name(n)]) for n in ("e0", "e1", "e2"))
    circles.flattered[frozenset()] += [Flattered(e1, other, 2.0), Flattered(e0 | e1, other, 3.0), Flattered(other, e1, 9.0)]
    for _ in range(2):  # a second time changes nothing
        circles.put_right(search, problem)
        assert {k: before[k] - s.log for k, s in search.sets.items() if k <= key} == pytest.approx(
            {frozenset(): 0.0, frozenset([0]): 0.0, frozenset([1]): 2.0, key: 3.0}
        )
    lines = SimpleNamespace(names=lambda k: tuple(sorted("abc"[f] for f in k)))
    sets = {frozenset(k): Weighed(log, ()) for k, log in (((0,), 1.0), ((0, 2), 3.0), ((0, 1, 2), 9.0))}
    seen = SimpleNamespace(sets=sets, background=np.array([False, False, True]))
    assert _with_lines(seen, lines, frozenset("a")) == frozenset("ac") and not _with_lines(seen, lines, frozenset("b"))


CIRCLES = [(Driving, {0: 0.6}), (Driving, {0: 0.6, 2: 0.35}), (DrivingTwo, {0: 0.6}), (Nested, {0: 0.6, 1: 0.6})]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("kind", "planted"), CIRCLES)
def test_a_search_that_goes_in_a_circle_ends_at_the_fit_of_what_is_told(kind, planted, seed):
    channel, known = problem_of(planted=tuple(planted.items()), seed=seed)
    made = kind(channel.y, channel.A, channel.prior_sd, channel.columns)
    problem, search = search_and_refit(linearised([made], known, FEW), known, FEW)
    assert search.sets[frozenset()].log == 0.0  # what all are weighed against
    told = [a.effect.name for a in diagnose_channels([made], known, FEW).active]
    assert told == [f"e{i}" for i in planted] == sorted(a.effect.name for a in problem.channels[0].active)


def test_an_effect_that_cannot_be_computed_about_its_own_fit_ends_no_search():
    channel, known = problem_of(planted=((0, 0.6),))
    made = Unseen(channel.y, channel.A, channel.prior_sd, channel.columns)
    assert diagnose_channels([made], known, FEW).p_none < 0.5


def test_without_names_nothing_is_corrected():
    """A fit that the search came back to may set other readings aside than the baseline's: two arms, no effect between them."""
    baseline, searched = (LinearChannel(np.zeros(4), np.zeros((4, 1)), np.ones(1), {}) for _ in range(2))
    (found,) = refitted((baseline,), SimpleNamespace(channels=(searched,)), ())
    assert found is baseline


def test_a_scanned_number_is_not_sharpened_to_where_physics_has_none(monkeypatch):
    """A belt that spreads its force over a curvature of nothing divides by zero; all evidence here is for less of it."""
    belt, tried = library()["belt_tension"], []

    def evidence(problem, others, effect, joint, scans):
        tried.extend(s["half_per_m"] for s in scans)
        return np.array([-s["half_per_m"] for s in scans]), np.ones((len(scans), 1))

    monkeypatch.setattr(engine_search, "_evidence", evidence)
    monkeypatch.setattr(engine_search, "given", lambda pool, members: None)
    name = Name("belt_tension", 0)
    family = SimpleNamespace(effect=belt, scans=tuple({"half_per_m": h} for h in (10.0, 50.0, 250.0)))
    problem = SimpleNamespace(index={name: 0}, pool=SimpleNamespace(families=[family]))
    one = engine_search._sharper(problem, Weighed(0.0, ()), Active(belt, 0, np.ones(1), {"half_per_m": 50.0}, np.eye(1)))
    assert one.scanned["half_per_m"] == min(tried) == 10.0


@pytest.mark.parametrize(("weight", "gross"), [([1.0, 0.9, 0.01], 1), ([1.0, 0.01, 0.01], 0), (None, 0)])
def test_gross_readings_are_few_or_the_fit_is_far_off(weight, gross):
    channel = SimpleNamespace(
        gap=lambda: np.zeros((3, 1)), fit=SimpleNamespace(weight=None if weight is None else np.array(weight))
    )
    assert np.count_nonzero(outliers(channel)) == gross
