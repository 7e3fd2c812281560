"""Where the gap lies: tests without a library, the spectrum in each joint's angle, subsystem, joint and conditions.

Kernel tests are exact F tests under the engine's projection. With unit noise of unknown scale, Q an orthonormal basis of a
kernel's projected features (m of them),

    F = (|Q^T y|^2 / m) / ((|y|^2 - |Q^T y|^2) / (nu - m))      is F(m, nu - m) distributed when nothing varies.   (docs, eq. 6)

The spectrum is weighted by the Jacobian: every reading tells the error of joint j as e_i = a_i / g_i with weight g_i (a_i, g_i:
whitened residual times the derivative along the joint's direction, and the derivative's square). A wave of k per turn is fitted
by weighted least squares. Its null: errors shifted in the order of measuring, against the angles, keep what they have in common
over time and lose what they owe to the angle (circular shifts, Good 2005, chapter 3).
"""

import numpy as np
from scipy.special import fdtrc

from ocp.diagnose.engine.findings import BudgetLine, KernelTest, Location, SpectrumPeak
from ocp.diagnose.engine.kernels import is_periodic
from ocp.diagnose.engine.linearisation import Linearisation
from ocp.diagnose.engine.pool import Given
from ocp.diagnose.rules import BUDGET_SD, LEAST_TURN, PLACE_SURE, SEEN_DIRECTION, SHARE_PER_FEATURE
from ocp.effects.effect import Effect
from robots.calibration.uneven import GroupScatter
from robots.pose import Array

SUBSYSTEM = {"target x time": "target", "hang": "target", "payload": "payload"}  # of frame and beam; others: the tracker
_READS = {
    "blade": "s, line, s wave, s period, clock x s, setpoint x s",
    "wheel": "wheel_temperature, belt, turn, clock wave, time wave, time period, time knocks, belt x time, setpoint x clock, "
    "setpoint x belt, turn wave x run, time wave x run, time period x run",
    "tool": "run",
    "flange": "setpoint, s wave x travel, s period x travel, travel x s",
    "timing": "travel, feed, travel x feed",
}
READING = {where: subsystem for subsystem, every in _READS.items() for where in every.split(", ")}


def of_effect(problem: Linearisation, effect: Effect, joint: int, signature: Array) -> Location:
    """Of a named effect with its signature (N,): the condition of its joint (or of none) that goes with it best."""
    best, chosen = -np.inf, ""
    size = float(signature @ signature)
    for family in problem.pool.families:
        elsewhere = family.name.joint != joint and family.name.joint and joint
        if not family.where or elsewhere or is_periodic(family.where) or any(word in family.where for word in (" x q", "ripple")):
            continue
        basis = orthonormal(family.columns[:, 0])
        share = float(np.sum((basis.T @ signature) ** 2)) / max(size, 1e-12) - SHARE_PER_FEATURE * basis.shape[1]
        if share > best:
            best, chosen = share, family.where
    lengths = {c.name: float(signature[b] @ signature[b]) for c, b in zip(problem.channels, problem.stack.blocks, strict=True)}
    return Location(max(lengths, key=lambda k: lengths[k]), effect.subsystem, joint, depends_on(chosen))


def of_kernel(signal: str, where: str, source: str, joint: int) -> Location:
    """Of a kernel that stands for an effect nobody catalogued."""
    of_tracker, of_reading = SUBSYSTEM.get(where, "tracker"), READING.get(where, "sensor")
    subsystem = {"frame": of_tracker, "beam": of_tracker, "reading": of_reading}.get(source, "joint")
    return Location(signal, subsystem, joint, depends_on(where))


def of_group(signal: str, one: GroupScatter) -> Location:
    """Of readings, or a joint, that scatter more than the others, which readings among the segments."""
    if one.kind == "joint":
        return Location(signal, one.kind, int(one.name), ())
    return Location(signal, one.kind if one.kind in ("target", "payload") else "tracker", 0, (one.kind,), (one.name,))


def of_tests(tests: list[KernelTest]) -> Location | None:
    """Of the most telling kernel, the number of kernels allowed for; None where none is sure."""
    if not tests or tests[0].p_value * len(tests) > PLACE_SURE:
        return None
    return of_kernel(tests[0].channel, tests[0].where, tests[0].source, tests[0].joint)


def depends_on(where: str) -> tuple[str, ...]:
    """What a kernel's name says it depends on: joints' angles q3, approaches approach5, loads tau2, temperature, time, ..."""
    found = (f"q{p.removeprefix('ripple')}" if p.startswith("ripple") else p for p in where.split(" x ") if p)
    found = (p.removesuffix(" wave").removesuffix(" period").removesuffix(" knocks") for p in found)
    return tuple(p.rstrip("123456") if p[:4] in ("temp", "time", "payl") else p for p in found)


def kernel_tests(problem: Linearisation, there: Given) -> list[KernelTest]:
    """All kernels but ripples (the spectrum's) and waves that were picked for what they tell, after what is given, most telling
    first."""
    y = there.after(problem.pool.y)
    total, freedom = float(y @ y), problem.pool.freedom
    found = []
    for family in problem.pool.families:
        if not family.where or "ripple" in family.where or is_periodic(family.where):
            continue
        basis = orthonormal(there.after(family.columns.reshape(len(y), -1)))
        m = basis.shape[1]
        if m >= freedom:  # few readings: it follows whatever they say, which tests nothing
            continue
        gained = float(np.sum((basis.T @ y) ** 2))
        ratio = (gained / max(m, 1)) / max((total - gained) / (freedom - m), 1e-12)
        channel, where, source = family.name.effect[1:].split("/")
        p = float(fdtrc(m, freedom - m, ratio)) if m else 1.0
        found.append(KernelTest(channel, where, source, family.name.joint, gained - m * (total - gained) / (freedom - m), p))
    return sorted(found, key=lambda t: t.p_value)


def orthonormal(columns: Array) -> Array:
    """Basis (N, r) of columns, directions that noise could not show left out."""
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, s > SEEN_DIRECTION])


def budget(problem: Linearisation, tests: list[KernelTest], explained: Given) -> list[BudgetLine]:
    """Shares of the gap beyond noise, the largest first, one condition before two that hardly take more. The noise's scale is
    what the best explanation leaves."""
    scale2 = explained.left / problem.pool.freedom
    excess = float(problem.pool.y @ problem.pool.y) - problem.pool.freedom * scale2
    least = BUDGET_SD * np.sqrt(2.0 * problem.pool.freedom) * scale2  # no gap to share out below what noise itself scatters
    whole = max(excess, least) or np.inf  # readings met exactly leave nothing to share out
    lines = []
    for t in tests:
        share = float(np.clip(t.gained / whole, 0.0, 1.0))
        elsewhere = t.joint and t.source in ("joint", "axis") and str(t.joint) not in t.where
        where = f"{t.where} at joint {t.joint}" if elsewhere else t.where
        lines.append(BudgetLine(t.channel, where, share, t.p_value))
    return sorted(lines, key=lambda b: SHARE_PER_FEATURE * b.where.count(" x ") - b.share)


ORDERS = np.arange(1.0, 121.0, 0.5)  # per turn
SHIFTS = 199


def spectra(problem: Linearisation, y: Array) -> list[SpectrumPeak]:
    """Of every channel that knows how joints move its readings: one a joint, most significant first; y (N,) projected."""
    found = []
    for channel, block in zip(problem.channels, problem.stack.blocks, strict=True):
        c = channel.conditions
        if c.d_joints is None:
            continue
        rows = channel.whiten(c.d_joints)
        reading = channel.system.reading
        n = len(c.q)
        for j in range(6):
            if np.ptp(c.q[:, j]) < LEAST_TURN:
                continue
            a = np.bincount(reading, rows[:, j] * y[block], n).astype(float)
            g = np.bincount(reading, rows[:, j] ** 2, n).astype(float)
            if g.max() > 0:
                found.append(_peak(channel.name, j + 1, c.q[:, j], a, g))
    return sorted(found, key=lambda p: p.p_value)


def _peak(signal: str, joint: int, q: Array, a: Array, g: Array) -> SpectrumPeak:
    shifts = np.random.default_rng([0, joint - 1]).integers(1, len(q), SHIFTS)
    pick = (np.arange(len(q)) + np.concatenate([[0], shifts])[:, None]) % len(q)
    # The error moves, the place's weight stays: a_i = e_i g_i.
    error = np.divide(a, np.sqrt(g), out=np.zeros_like(a), where=g > 0)[pick] * np.sqrt(g)
    waves = np.exp(1j * ORDERS[None, :] * q[:, None])
    power = np.abs(error @ waves) ** 2 / (0.5 * g.sum())
    best = power.max(axis=1)
    k = int(np.argmax(power[0]))
    amplitude = float(np.abs(error[0] @ waves[:, k]) / (0.5 * g.sum()))
    p = float((1 + np.sum(best[1:] >= best[0])) / (SHIFTS + 1))
    return SpectrumPeak(joint, float(ORDERS[k]), amplitude, p, ORDERS, power[0], signal)
