"""Noise of the force channel: what was put in is found, and the filter whitens what a dense covariance would."""

import numpy as np
import pytest

from ocp.calibrate.force.noise import (
    FILTERED,
    CorrelatedNoise,
    NoiseGroup,
    ReadingNoise,
    Runs,
    Whitener,
    estimate_noise,
    student_weights,
    whiten,
)
from tests.support.force_world import correlated


def runs_of(rng, count, length, **kind):
    run = np.repeat(np.arange(count), length)
    time = np.tile(0.01 * np.arange(length), count)
    return run, time, np.concatenate([correlated(rng, length, **kind) for _ in range(count)])


def test_filter_is_the_cholesky_factor_of_the_covariance():
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.002, 0.05, 60))
    run = np.repeat([0, 1], 30)
    noise = CorrelatedNoise(0.3, 0.6, 0.04)
    apart = np.abs(time[:, None] - time)
    same = run[:, None] == run
    V = 0.09 * (0.4 * np.eye(60) + 0.6 * np.exp(-apart / 0.04) * same)
    columns = rng.normal(size=(60, 3))
    white, scale = whiten(Runs.of(run, time), noise, np.ones(60), columns)
    L = np.linalg.cholesky(V)
    np.testing.assert_allclose(white, np.linalg.solve(L, columns), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(scale, np.diag(L), rtol=1e-9)


def test_rows_of_runs_may_be_mixed():
    rng = np.random.default_rng(2)
    run, time, y = runs_of(rng, 3, 40)
    order = np.argsort(time, kind="stable")
    noise, ones = CorrelatedNoise(0.3, 0.6, 0.04), np.ones(len(y))
    plain, _ = whiten(Runs.of(run, time), noise, ones, y[:, None])
    mixed, _ = whiten(Runs.of(run[order], time[order]), noise, ones, y[order][:, None])
    np.testing.assert_allclose(mixed, plain[order])


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_what_was_put_in_is_found(share):
    run, time, y = runs_of(np.random.default_rng(3), 14, 210, sigma=0.25, share=share)
    noise = estimate_noise(run, time, y + np.sin(1.5 * time + run))
    wanted = CorrelatedNoise(0.25, share, 0.04)
    assert noise.sigma == pytest.approx(0.25, rel=0.08)
    # What counts for a covariance: the variance of a long mean.
    assert noise.sigma**2 * noise.samples_each(0.01) == pytest.approx(0.0625 * wanted.samples_each(0.01), rel=0.3)
    assert noise.freedom >= 20


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_short_runs_are_not_given_a_slow_noise_that_they_do_not_have(share):
    """Passes of half a second: what is slower than one is not noise, whatever the weights of Student's t are."""
    run, time, y = runs_of(np.random.default_rng(8), 60, 40, sigma=0.25, share=share)
    noise = estimate_noise(run, time, y)
    assert noise.sigma * np.sqrt(noise.usual) == pytest.approx(0.25, rel=0.1)
    assert noise.sigma**2 * noise.samples_each(0.01) < 0.0625 * 4.0


def test_outliers_leave_the_scale_alone_and_count_little():
    rng = np.random.default_rng(4)
    run, time, y = runs_of(rng, 14, 210, sigma=0.25)
    wild = rng.random(len(y)) < 0.02
    y[wild] += 4.0 * rng.choice([-1.0, 1.0], wild.sum())
    noise = estimate_noise(run, time, y)
    assert noise.sigma == pytest.approx(0.25, rel=0.25) and noise.freedom <= 10
    weight = np.ones(len(y))
    for _ in range(3):
        weight = student_weights(Runs.of(run, time), noise, y, weight)
    assert np.median(weight[wild]) < 0.1 < 0.9 < np.median(weight[~wild])


# 0.01: two standard errors of the mean of five.
@pytest.mark.parametrize(("share", "within"), [(0.0, 0.01), (0.02, 0.05)])
def test_beside_gross_readings_the_others_are_as_noisy_as_they_are(share, within):
    found = []
    for seed in range(40, 45):
        rng = np.random.default_rng(seed)
        run, time, clean = runs_of(rng, 14, 210, sigma=0.25)
        wild = rng.random(len(clean)) < share
        noise = estimate_noise(run, time, clean + wild * rng.uniform(2.0, 8.0, len(clean)) * rng.choice([-1.0, 1.0], len(clean)))
        found.append(noise.sigma * np.sqrt(noise.usual) / clean[~wild].std())
    assert np.mean(found) == pytest.approx(1.0, abs=within), found


@pytest.mark.parametrize("freedom", [4.0, 60.0])
def test_of_noise_with_tails_the_deviation_is_told_beside_the_scale(freedom):
    rng = np.random.default_rng(6)
    run, time = np.repeat(np.arange(14), 210), np.tile(0.01 * np.arange(210), 14)
    y = 0.2 * rng.standard_t(freedom, len(run))
    noise = estimate_noise(run, time, y)
    assert noise.sigma == pytest.approx(0.2, rel=0.15)
    kept = np.abs(y) < 0.2 * np.sqrt((freedom + 1.0) / 0.1 - freedom)
    assert noise.sigma * np.sqrt(noise.usual) == pytest.approx(y[kept].std(), rel=0.08)


def test_one_short_run_still_gives_a_sound_noise():
    noise = estimate_noise(np.zeros(30, int), 0.01 * np.arange(30), correlated(np.random.default_rng(5), 30, sigma=0.2))
    assert 0.1 < noise.sigma < 0.4 and 1.0 <= noise.samples_each(0.01) < 15


def test_few_columns_have_the_bits_of_many():
    """Sample by sample, or stretches side by side: one filter, whatever its weights, runs of all lengths."""
    rng = np.random.default_rng(4)
    run = np.repeat(np.arange(4), [1, 3, 40, 700])
    time = np.concatenate([0.01 * np.arange(n) for n in (1, 3, 40, 700)])
    runs, noise, weight = Runs.of(run, time), CorrelatedNoise(0.3, 0.6, 0.04), rng.uniform(0.1, 1.25, len(run))
    columns = rng.normal(size=(len(run), FILTERED + 1))
    many, scale = whiten(runs, noise, weight, columns)
    few, same = whiten(runs, noise, weight, columns[:, :3])
    assert (few == many[:, :3]).all() and (same == scale).all()


@pytest.mark.parametrize(("size", "least", "most"), [(0.5, 0.97, 1.08), (1.0, 0.97, 1.06), (5.0, 0.95, 1.06), (20.0, 0.85, 1.1)])
def test_scores_change_as_even_rows_do_by_what_is_added(size, least, most):
    """A knock of some sigmas every twelve readings, among gross ones: with the weights that noise and knock have together rows
    show less of a small one; of a large one they must not show less the larger it is."""
    found, weighed, squares = [], [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        run, time, y = runs_of(rng, 14, 210, sigma=0.3, share=0.4)
        wild = rng.random(len(y)) < 0.01
        y[wild] += rng.uniform(1.5, 8.0, wild.sum()) * rng.choice([-1.0, 1.0], wild.sum())
        noise, runs, weight = estimate_noise(run, time, y), Runs.of(run, time), np.ones(len(y))
        assert noise.freedom <= 6
        knock, scores = size * noise.sigma * (np.arange(len(y)) % 12 < 2), []
        for read in (y, y + knock):  # the same noise with and without it: only what is added counts
            for _ in range(6):
                weight = student_weights(runs, noise, read, weight)
            own = Whitener.of(ReadingNoise(np.ones(len(y)), weight, {True: NoiseGroup(np.arange(len(y)), runs, noise)}), 300)
            even, (rows, columns) = own.even(), own.whole(np.column_stack([read, knock])).T
            scores.append(rows * np.sqrt(weight / even.noise.weight))
        score, column = scores[1], even.whole(knock[:, None])[:, 0]
        found.append((score - scores[0]) @ column / (column @ column))
        weighed.append(rows @ columns / (columns @ columns))
        squares.append(np.mean(score**2))
    assert least < np.mean(found) < most
    if size <= 1.0:
        assert np.mean(weighed) < 0.85 and np.mean(squares) == pytest.approx(1.0, abs=0.2)
