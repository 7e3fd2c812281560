"""The common search on a curved problem with residuals that stay large, against SciPy's general minimiser."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.optimize import minimize as general

from robots.gauss_newton import FURTHER, Rule, _curved, _learnt, linear_step, minimise

PRECISION = np.full(3, 0.1)
RNG = np.random.default_rng(5)
SLOPES, BENT = RNG.normal(size=(40, 3)), RNG.normal(size=(40, 3, 3))
READ = 3.0 + RNG.normal(size=40)  # what no z explains


@dataclass(frozen=True)
class Curved:
    """Readings with a prediction that is quadratic in z; share: of its curvature; weight (40,) follows the residuals."""

    z: np.ndarray
    share: float = 0.5
    weight: np.ndarray = field(default_factory=lambda: np.ones(40))

    def predicted(self) -> np.ndarray:
        return SLOPES @ self.z + self.share * np.einsum("nij,i,j->n", BENT, self.z, self.z)

    def reweighted(self):
        left = READ - self.predicted()
        return replace(self, weight=1.0 / np.sqrt(1.0 + left**2 / 25.0))

    def residual(self) -> np.ndarray:
        return self.weight * (READ - self.predicted())

    def linearised(self):
        both = BENT + BENT.transpose(0, 2, 1)
        return self.residual(), self.weight[:, None] * (SLOPES + self.share * both @ self.z)

    def moved(self, change):
        return replace(self, z=self.z + change)


def cost(at: Curved) -> float:
    left = at.residual()
    return float(left @ left + at.z @ (PRECISION * at.z))


@pytest.mark.parametrize(("reweighted", "share"), [(0, 0.5), (3, 0.7)])
def test_curvature_that_is_learnt_ends_a_search_that_creeps(reweighted, share):
    plain = Rule(steps=200, rest=1e-12, halvings=12, reweighted=reweighted)
    crept, found = (minimise(Curved(np.zeros(3)), PRECISION, rule) for rule in (plain, replace(plain, secant=True)))
    weight = found.at.weight
    best = general(lambda z: cost(Curved(z, weight=weight)), found.at.z, method="BFGS", options={"gtol": 1e-9})
    assert found.rested and cost(found.at) == pytest.approx(best.fun, abs=1e-8)
    assert found.steps < share * crept.steps


def test_a_straight_problem_is_solved_in_one_step_either_way():
    for secant in (False, True):
        found = minimise(Curved(np.zeros(3), 0.0), PRECISION, Rule(5, rest=1e-9, reweighted=0, halvings=5, secant=secant))
        assert found.rested and found.steps == 2


def test_a_step_teaches_what_gradients_say():
    """The least change (in the norm of what gradients turned by) that is symmetric and has the missing part of the turn."""
    before, after = Curved(np.zeros(3)), Curved(np.array([0.3, -0.2, 0.1]))
    (e0, A0), (e1, A1), took = before.linearised(), after.linearised(), after.z - before.z

    def slope(at: Curved) -> np.ndarray:
        return np.array([0.5 * (cost(at.moved(d)) - cost(at.moved(-d))) / 2e-5 for d in 1e-5 * np.eye(3)])

    found = _learnt(np.zeros((3, 3)), before.z, e0, A0, after.z, e1, A1, PRECISION)
    turned, missed = slope(after) - slope(before), (A0 - A1).T @ e1
    np.testing.assert_allclose(found @ took, missed, rtol=1e-9)
    plain = (np.outer(missed, turned) + np.outer(turned, missed)) / (took @ turned)
    plain -= (missed @ took) * np.outer(turned, turned) / (took @ turned) ** 2
    np.testing.assert_allclose(found, plain, rtol=1e-6)


@pytest.mark.parametrize(("share", "longer"), [(-0.3, 1.0 / 0.7), (-0.9, FURTHER), (-3.0, FURTHER), (3.0, 0.25)])
def test_a_step_with_curvature_goes_no_further_than_is_sound(share, longer):
    """Along what curves the other way than products of sensitivities do the minimum may be anywhere."""
    residual, sensitivity = Curved(np.zeros(3)).linearised()
    step = linear_step(residual, sensitivity, np.zeros(3), PRECISION)
    np.testing.assert_allclose(_curved(step, share * step.normal).change, longer * step.change, rtol=1e-9)
