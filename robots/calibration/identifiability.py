"""Which parameters the readings determine, which only in company, in words.

The posterior's sd over the prior's says whether the readings saw a parameter. For one they did not, the company it hides
in is found by holding others still, one by one, until it would be known: these cannot be told from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robots.calibration.fit import Fit
from robots.calibration.parameters import SYMBOLS
from robots.pose import Array

UNSEEN = 0.3  # posterior sd over prior sd above which a parameter is not determined by the readings
KNOWN = 0.1  # of the prior sd; what a parameter's sd falls to when its company is held still
COMPANY = 4  # parameters looked for
SEPARATED = 0.3  # a singular value this small or smaller, in prior sds per noise sd, is a direction not seen


@dataclass(frozen=True)
class Hidden:
    """A parameter that the readings do not determine, and the names of those it cannot be told from (none: no effect
    on any reading)."""

    name: str
    company: tuple[str, ...]
    ratio: float

    def sentence(self) -> str:
        """In words."""
        if not self.company:
            return "no reading depends on it enough; its value is the believed one"
        company = list(dict.fromkeys(described(n) for n in self.company))
        return f"cannot be told from {listed(company)}; the believed values share it out"


@dataclass(frozen=True)
class Identifiability:
    """Singular values (p,) of the readings' Jacobian, scaled by noise and priors, largest first; rank: how many directions of
    the robot's parameters the readings determine, of how many; hidden parameters."""

    singular_values: Array
    rank: int
    parameters: int
    hidden: tuple[Hidden, ...]

    def not_identified(self) -> dict[str, str]:
        """Reasons by parameter names, as `robots.calibration.store.Calibration` keeps them."""
        return {h.name: h.sentence() for h in self.hidden if h.name in SYMBOLS}


def identify(fit: Fit) -> Identifiability:
    """What the readings of `fit` determine. Nests and stations are unknown too: what hides in them is hidden."""
    layout = fit.layout
    robot = np.array([i for i, name in enumerate(layout.names) if name in SYMBOLS], dtype=int)
    values = np.linalg.svd(_reduced(fit, robot), compute_uv=False)
    rank = int((values > 1.0 / SEPARATED).sum())
    sd = fit.sd
    hidden = []
    for i in robot:
        prior = layout.prior_sd[i]
        if np.isfinite(prior) and sd[i] > UNSEEN * prior:
            hidden.append(Hidden(layout.names[i], _company(fit, int(i)), float(sd[i] / prior)))
    return Identifiability(np.asarray(values, float), rank, len(robot), tuple(hidden))


def _reduced(fit: Fit, robot: Array) -> Array:
    """Whitened Jacobian in the robot's parameters, scaled by their priors, what nests and stations can imitate removed."""
    J = (fit.W @ fit.J).reshape(-1, fit.layout.size) * fit.layout.scale / fit.spread
    others = np.setdiff1d(np.arange(fit.layout.size), robot)
    prior = np.where(np.isfinite(fit.layout.prior_sd[others]), fit.layout.scale[others] / fit.layout.prior_sd[others], 0.0)
    A = np.vstack([J[:, others], np.diag(prior)])
    B = np.vstack([J[:, robot], np.zeros((len(others), len(robot)))])
    return np.asarray(B - A @ np.linalg.lstsq(A, B, rcond=None)[0])


def _company(fit: Fit, i: int) -> tuple[str, ...]:
    """Names whose being known would make parameter i known, fewest first; empty where COMPANY do not suffice."""
    covariance, prior = fit.covariance, fit.layout.prior_sd[i]
    scale = np.sqrt(np.diag(covariance))
    C = covariance / np.outer(scale, scale)
    held: list[int] = []
    for _ in range(COMPANY):
        variance = np.diag(C).copy()
        gain = np.where(variance > 1e-9, C[i] ** 2 / np.maximum(variance, 1e-9), 0.0)
        gain[[i, *held]] = 0.0
        best = int(np.argmax(gain))
        if gain[best] < 0.02 * C[i, i]:
            break
        held.append(best)
        C = C - np.outer(C[:, best], C[best]) / C[best, best]
        if np.sqrt(max(C[i, i], 0.0)) * scale[i] < KNOWN * prior:
            return tuple(fit.layout.names[j] for j in held)
    return tuple(fit.layout.names[j] for j in held)


def described(name: str) -> str:
    """A parameter in words."""
    if name.startswith("station"):
        what, station = "turn" if name[-1] in "uvw" else "place", name.removeprefix("station").strip("_")[:-2]
        return f"the tracker's {what} against the base" + (f" at station '{station}'" if station else "")
    if name.startswith("nest"):
        return "the places of the reflector nests on the flange"
    if ":" in name:
        payload, part = name.split(":")
        return f"{part.replace('_', ' ')} of '{payload}'"
    return f"{name} ({SYMBOLS[name].meaning})"


def listed(words: Sequence[str]) -> str:
    """'a', 'a and b', 'a, b and c'."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
