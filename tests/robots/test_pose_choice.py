"""The exchange algorithm against brute force, against formulas without updates, and its rules."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from robots.calibration import pose_choice
from robots.calibration.observability import expected_error, observability, singular_values
from robots.calibration.pose_choice import Pool, choose


def pool_of(seed: int, m: int, p: int, groups: int = 1) -> Pool:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(m, 3, p)) * np.exp(rng.normal(size=(m, 1, 1)))
    return Pool(rows, np.full(p, 0.1), np.arange(m), rng.integers(0, groups, m))


def log_det(pool: Pool, chosen) -> float:
    A = pool.rows[list(chosen)].reshape(-1, pool.rows.shape[2])
    return np.linalg.slogdet(A.T @ A + np.diag(pool.prior**2))[1]


def zone_value(pool: Pool, chosen) -> float:
    A = pool.rows[list(chosen)].reshape(-1, pool.rows.shape[2])
    J = pool.J.reshape(-1, pool.rows.shape[2])
    return np.linalg.slogdet(np.eye(len(J)) + J @ np.linalg.inv(A.T @ A + np.diag(pool.prior**2)) @ J.T)[1]


@pytest.mark.parametrize("seed", range(6))
def test_no_set_of_a_small_pool_is_much_better_by_determinant(seed):
    pool = pool_of(seed, 12, 6)
    found = log_det(pool, choose(pool, 4))
    best = max(log_det(pool, c) for c in itertools.combinations(range(12), 4))
    middle = np.median([log_det(pool, c) for c in itertools.combinations(range(12), 4)])
    assert found >= best - 0.02 * (best - middle)


@pytest.mark.parametrize("criterion", ["O1", "O5", "zone"])
def test_no_single_exchange_improves_what_was_found(criterion):
    pool = pool_of(7, 60, 8)
    pool = replace(pool, J=np.random.default_rng(1).normal(size=(4, 3, 8)))
    chosen = choose(pool, 7, criterion, passes=20)

    def value(c) -> float:
        if criterion == "O1":
            return log_det(pool, c)
        if criterion == "O5":
            return -np.sum(singular_values(pool.rows[list(c)], pool.prior, np.eye(8)) ** -2.0)
        return -zone_value(pool, c)

    base = value(chosen)
    for place, new in itertools.product(range(7), range(60)):
        if new not in chosen:
            trial = chosen.copy()
            trial[place] = new
            assert value(trial) <= base + 1e-5 * abs(base)


@pytest.mark.parametrize("criterion", ["O2", "O3", "O4", "O5", "zone"])
def test_a_criterion_is_served_better_by_its_own_choice_than_by_chance(criterion):
    pool = pool_of(4, 150, 9)
    J = np.random.default_rng(2).normal(size=(3, 3, 9)) * np.array([3.0] * 3 + [0.0] * 6)
    pool = replace(pool, J=J)

    def value(c) -> float:
        if criterion == "zone":
            return -float((expected_error(pool.rows[c], pool.prior, J) ** 2).mean())
        return float(observability(singular_values(pool.rows[c], pool.prior, np.eye(9)), 8, criterion))

    mine = value(choose(pool, 8, criterion))
    rng = np.random.default_rng(0)
    assert mine > max(value(rng.choice(150, 8, replace=False)) for _ in range(200))
    if criterion != "O5":
        assert mine > value(choose(pool, 8, "O1"))


def test_running_covariances_stay_those_of_the_information_matrix():
    """Rank-three updates, added and taken back many times, against inversion."""
    pool = pool_of(9, 80, 10)
    state = pose_choice._State(pool, 12, "O1")
    rng = np.random.default_rng(3)
    for k in rng.choice(80, 12, replace=False):
        state.add(int(k))
    for place in range(12):
        state.exchange(place)
    S = np.linalg.inv(state.information(state.chosen))
    np.testing.assert_allclose(state.S, S, rtol=0, atol=1e-6 * np.abs(S).max())
    np.testing.assert_allclose(state.V, state.A @ S @ np.swapaxes(state.A, 1, 2), rtol=0, atol=1e-6 * np.abs(state.V).max())
    now = np.linalg.det(state.information(state.chosen))
    grown = np.array([np.linalg.det(state.information([*state.chosen, k])) for k in range(80)])
    np.testing.assert_allclose(state.determinant_gain(), grown / now, rtol=1e-5)


def test_conditions_as_bad_as_a_tracker_frames_do_no_harm():
    """Unknowns with information from 1 to 1e13; between a tracker's place and a spring it is 1e11."""
    pool = pool_of(5, 200, 12)
    scale = np.logspace(0, 6.5, 12)
    chosen = choose(replace(pool, rows=pool.rows * scale, prior=np.ones(12)), 9)
    plain = choose(replace(pool, prior=1 / scale), 9)  # the same problem in other units
    assert set(chosen.tolist()) == set(plain.tolist())


def test_a_posture_is_chosen_once_and_every_group_gets_its_share():
    pool = pool_of(6, 90, 6, groups=3)
    pool = replace(pool, posture=np.arange(90) // 3, least=3)
    dull = pool.rows.copy()
    dull[pool.group == 2] *= 1e-3  # nothing but the rule speaks for this group
    chosen = choose(replace(pool, rows=dull), 12)
    assert len(set(pool.posture[chosen].tolist())) == 12
    assert (np.bincount(pool.group[chosen], minlength=3) >= 3).all()
    without = choose(replace(pool, rows=dull, least=0), 12)
    assert (pool.group[without] == 2).sum() == 0


def test_the_same_pool_gives_the_same_choice_and_too_small_a_pool_is_refused():
    pool = pool_of(8, 40, 6)
    assert (choose(pool, 10, "O4") == choose(pool, 10, "O4")).all()
    with pytest.raises(ValueError):
        choose(replace(pool, posture=np.arange(40) // 5), 10)
