"""Fit the wheel's law to direct contact solutions over what one blade and one cell ask for."""

import json
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from ocp.contact.wheel.cover import Cover, WheelGeometry
from ocp.contact.wheel.law import WheelLaw, all_features, chebyshev_products, exponents, force_scale, reduce_shape, strip_count
from ocp.contact.wheel.signorini import LocalShape, solve_forces
from ocp.shell.cache import content_key, remember
from robots.errors import Infeasible
from robots.pose import Array

FORCE_RANGE = (0.2, 3.0)  # of the process force
MIN_KXX = 0.5  # of the wheel's own curvature: below it the blade is nearly hollow along the belt and contact wanders
N_KINDS = 96  # different blade curvatures that training samples are spread over
DEGREES = (2, 3, 4)
EARNED = 0.85  # factor on the cross-validated error that one degree more must bring
FOLDS = 4
OVERSIZE = 1.15  # the training box over the domain: a polynomial is worst at its corners
TOGETHER = 64  # contacts solved at once; of more the arrays no longer fit the processor's cache
RIDGE = 1e-2  # of the columns' mean square; keeps extrapolation tame
DECAYS: Array = np.geomspace(0.2, 2.0, 10)
VERSION = "wheel law 3"  # raise it when the fit changes


@dataclass(frozen=True)
class Domain:
    """What the law must cover: curvature (m, 3) k_tt, k_bb, k_tb 1/m of the blade's waypoints; turn rad, lateral m and
    tilt (slope, both directions) each up to the given size either way; process force N."""

    curvature: Array
    turn: float
    lateral: float
    tilt: float
    force: float


@dataclass(frozen=True)
class LawSamples:
    """Direct solutions: inputs (n, 7) F, kxx, kyy, kxy, lateral, tilt_x, tilt_y; indentation (n,) m; dropped:
    combinations outside the limits."""

    inputs: Array
    indentation: Array
    dropped: int


def fit_wheel_law(cover: Cover, domain: Domain, samples: int = 2000, held_out: int = 300, seed: int = 1) -> WheelLaw:
    """Law for `cover` over `domain` from `samples` direct solutions, judged on `held_out` others.

    Chosen by cross-validation among those that rise with the force; deterministic for a given seed. Raises Infeasible
    where the blade is too hollow along the belt nearly everywhere, or no such law rises with the force.
    """
    train = draw(cover, domain, samples, seed, True, FORCE_RANGE)
    test = draw(cover, domain, held_out, seed + 1, False, (1.0, 1.0))
    limits = {
        "force": (FORCE_RANGE[0] * domain.force, FORCE_RANGE[1] * domain.force),
        "kxx": (MIN_KXX / cover.geometry.radius, float(1.05 * train.inputs[:, 1].max())),
        "lateral": (-domain.lateral, domain.lateral),
        "tilt_x": (-domain.tilt, domain.tilt),
        "tilt_y": (-domain.tilt, domain.tilt),
    }
    candidates = [(*_fit(cover, domain, train, degree, d, limits), degree) for degree in DEGREES for d in DECAYS]
    # Each degree more doubles the terms, so it must earn them.
    candidates.sort(key=lambda c: c[0] * EARNED ** -c[2])
    for _, law, _ in candidates:
        if least_stiffness(law, train.inputs[:, 1:]) > 0:
            miss = law.evaluate(*test.inputs.T) - test.indentation
            return replace(law, error=float(np.abs(miss).max()))
    raise Infeasible(
        f"no smooth law of the wheel rises with the force over {limits['force'][0]:.1f} to {limits['force'][1]:.1f} N for this "
        "blade; allow less tilt, turn and lateral offset"
    )


def draw(cover: Cover, domain: Domain, count: int, seed: int, spread: bool, forces: tuple[float, float]) -> LawSamples:
    """Direct solutions at `count` combinations of waypoint, turn, lateral, tilts and force.

    spread: waypoints by the variety of their curvature (training) instead of as they come (judging).
    """
    rng = np.random.default_rng(seed)
    from scipy.stats import qmc  # half a second, which a law from the store need not pay

    u = qmc.LatinHypercube(d=6, rng=rng).random(count)
    if spread:
        domain = replace(domain, turn=OVERSIZE * domain.turn, lateral=OVERSIZE * domain.lateral, tilt=OVERSIZE * domain.tilt)
        forces = (forces[0] / OVERSIZE, forces[1] * OVERSIZE)
    kinds = _various(domain.curvature, N_KINDS) if spread else domain.curvature
    k_tt, k_bb, k_tb = kinds[(u[:, 0] * len(kinds)).astype(int)].T
    c, s = np.cos(domain.turn * (2 * u[:, 1] - 1)), np.sin(domain.turn * (2 * u[:, 1] - 1))
    kxx = c * c * k_tt + s * s * k_bb - 2 * s * c * k_tb + 1 / cover.geometry.radius
    kyy = s * s * k_tt + c * c * k_bb + 2 * s * c * k_tb
    kxy = s * c * (k_tt - k_bb) + (c * c - s * s) * k_tb
    force = domain.force * np.exp(np.log(forces[0]) + u[:, 5] * np.log(forces[1] / forces[0]))
    sides = (2 * u[:, 2:5] - 1) * [domain.lateral, domain.tilt, domain.tilt]
    inputs = np.column_stack([force, kxx, kyy, kxy, sides])
    inputs = inputs[kxx >= MIN_KXX / cover.geometry.radius]
    if len(inputs) < 0.05 * count:
        raise Infeasible(
            f"the blade is hollow along the belt for a wheel of radius {cover.geometry.radius * 1e3:.0f} mm in "
            f"{1 - len(inputs) / count:.0%} of all postures allowed; use a smaller wheel or another direction of the passes"
        )
    solved, indentation = [], []
    for part in np.array_split(inputs, -(-len(inputs) // TOGETHER)):
        for row, contact in zip(part, solve_forces(cover, part[:, 0], [LocalShape(*r[1:]) for r in part]), strict=True):
            if not contact.touches_border:
                solved.append(row)
                indentation.append(contact.indentation)
    if len(solved) < 0.5 * len(inputs):
        raise Infeasible(
            f"under {domain.force:g} N the blade would press the wheel's cover round more than the wheel in "
            f"{1 - len(solved) / len(inputs):.0%} of all postures; ask for less force or use a harder cover"
        )
    return LawSamples(np.array(solved), np.array(indentation), count - len(solved))


def _various(curvature: Array, count: int) -> Array:
    """Up to `count` rows as different from each other as can be (farthest point first)."""
    scaled = curvature / np.maximum(np.ptp(curvature, axis=0), 1e-6)
    chosen = [int(np.argmax(scaled[:, 1]))]
    distance = np.linalg.norm(scaled - scaled[chosen[0]], axis=1)
    while len(chosen) < min(count, len(curvature)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(scaled - scaled[chosen[-1]], axis=1))
    return curvature[chosen]


def _fit(
    cover: Cover, domain: Domain, train: LawSamples, degree: int, decay: float, limits: dict[str, tuple[float, float]]
) -> tuple[float, WheelLaw]:
    """Ridge regression of the correction; the score is the rms of the cross-validated errors."""
    g = cover.geometry
    force = train.inputs[:, 0]
    reduced = reduce_shape(*train.inputs[:, 1:].T)
    scale = force_scale(force, reduced.across, g.modulus)
    p = decay * scale
    count = strip_count(domain.force, float(np.median(reduced.across)), g.modulus, g.width)
    base, features = all_features(force, reduced, p, g.modulus, g.width, count)
    low, high = features.min(axis=0), features.max(axis=0)
    high = np.maximum(high, low + 1e-6)
    u = (2 * features - low - high) / (high - low)
    terms = exponents(degree)
    target = train.indentation - reduced.offset - base
    # Error in m to error in N on a rigid cell, F / (1.5 d) being the stiffness, less above the process force.
    weight = force / scale / np.maximum(force / domain.force, 1.0)
    A = chebyshev_products(u, terms) * (p * weight)[:, None]
    b = target * weight
    fold = np.arange(len(b)) % FOLDS
    held = [A[fold == k] @ _ridge(A[fold != k], b[fold != k]) - b[fold == k] for k in range(FOLDS)]
    law = WheelLaw(g, domain.force, float(decay), count, low, high, terms, _ridge(A, b), limits, np.nan)
    return float(np.sqrt(np.mean(np.concatenate(held) ** 2))), law


def _ridge(A: Array, b: Array) -> Array:
    """Least squares with a penalty of RIDGE times the mean square of the columns."""
    H = A.T @ A
    return np.asarray(np.linalg.solve(H + RIDGE**2 * np.mean(np.diag(H)) * np.eye(len(H)), A.T @ b), float)


def least_stiffness(law: WheelLaw, shapes: Array) -> float:
    """Smallest dF/dd N/m over shapes (n, 6) and the force range; negative where d falls with rising F anywhere."""
    forces = np.geomspace(*law.limits["force"], 12)
    curves = law.evaluate(np.repeat(forces, len(shapes)), *np.tile(shapes, (len(forces), 1)).T)
    rise = np.diff(curves.reshape(len(forces), -1), axis=0) / np.diff(forces)[:, None]
    return float(1 / rise.max()) if rise.min() > 0 else float(1 / rise.min())


def remembered_law(cover: Cover, domain: Domain, samples: int = 2000, held_out: int = 300) -> WheelLaw:
    """The law of `fit_wheel_law`: kept under everything it depends on, else fitted."""
    asked = domain.curvature, domain.turn, domain.lateral, domain.tilt, domain.force
    key = content_key(VERSION, json.dumps(asdict(cover.geometry)), cover.spectrum, *asked, samples, held_out)
    return _unpacked(remember("law", key, lambda: _packed(fit_wheel_law(cover, domain, samples, held_out))))


def _packed(law: WheelLaw) -> dict[str, np.ndarray]:
    arrays = {f.name: getattr(law, f.name) for f in fields(law) if isinstance(getattr(law, f.name), np.ndarray)}
    numbers = {f.name: getattr(law, f.name) for f in fields(law) if f.name not in arrays}
    numbers["geometry"] = asdict(law.geometry)
    return arrays | {"numbers": np.array(json.dumps(numbers, default=float))}


def _unpacked(entry: dict[str, np.ndarray]) -> WheelLaw:
    numbers: dict[str, Any] = json.loads(str(entry["numbers"]))
    numbers["geometry"] = WheelGeometry(**numbers["geometry"])
    numbers["limits"] = {name: (float(low), float(high)) for name, (low, high) in numbers["limits"].items()}
    arrays: dict[str, Any] = {name: value for name, value in entry.items() if name != "numbers"}
    return WheelLaw(**numbers, **arrays)
