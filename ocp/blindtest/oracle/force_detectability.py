"""The detectability index of an effect in a force log: how far its exact signature stands out of noise and what is refitted.

    lambda = d^T (Sigma + A P A^T)^-1 d                                                       (DIAGNOSIS, "How it is judged")

d: readings with the effect less those without it, same machine. Sigma: the sensor's noise with its memory, exact for every run.
A, P: everything that a machine is drawn with. Where a tracker measured the arm too, its readings and the force log share
placement, springs and masses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ocp.blindtest.oracle import detectability as tracker
from ocp.blindtest.oracle.detectability import GEAR_ORDERS, MOTOR_ORDERS, given_others
from ocp.blindtest.oracle.slopes import Slopes, nuisance, slopes_of
from ocp.blindtest.worlds.force_machines import GrindingMachine
from ocp.blindtest.worlds.runs import Rows
from ocp.blindtest.worlds.scene import Scene
from ocp.simulate.twin.contact.sensor import SLOW_SHARE, SLOW_TIME
from ocp.simulate.twin.truth.machine import SENSOR_SIGMA
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array

SPLICES, RELAXATIONS = 200, 8  # rates of a belt's splice and time constants that a log tells apart
# What each further coefficient of a form costs, of which one is drawn: waves of a profile on every line, harmonics of a knock.
COEFFICIENT, WAVES, HARMONICS = 1.3, 6, 3
ARM = 36 + 6 + 7  # columns that both signals share
FRAME = 6  # columns of the tracker's place, before them


@dataclass(frozen=True, eq=False)
class Whitener:
    """The symmetric root of (Sigma + A P A^T)^-1 of a force log, and of a tracker's readings before it where there are any."""

    roots: tuple[Array, ...]
    rows: Rows
    U: Array
    take: Array
    W: Array | None = None

    def raw(self, force: Array, points: Array | None = None) -> Array:
        """White noise rows (N, ...) of changes (2, n, ...) N and (m, 3, ...) m, nothing projected out."""
        parts = []
        if self.W is not None:
            assert points is not None
            parts.append((self.W @ points.reshape(len(points), 3, -1)).reshape(3 * len(points), -1))
        for signal in force:
            flat = signal.reshape(len(signal), -1)
            parts += [root @ flat[self.rows.run == k] for k, root in enumerate(self.roots)]
        found = np.concatenate(parts)
        return np.asarray(found.reshape(len(found), *force.shape[2:]))

    def apply(self, force: Array, points: Array | None = None) -> Array:
        """White rows (N, ...) of changes."""
        rows = self.raw(force, points)
        flat = rows.reshape(len(rows), -1)
        flat = flat - self.U @ (self.take[:, None] * (self.U.T @ flat))
        return np.asarray(flat.reshape(rows.shape))


@dataclass(frozen=True, eq=False)
class Sight:
    """A force world as an oracle sees it: machine, slopes, whitener, the tracker's scene where there is one."""

    machine: GrindingMachine
    slopes: Slopes
    white: Whitener
    scene: Scene | None

    def signature(self, effects: Sequence[Planted], without: Sequence[Planted] = ()) -> Array:
        """White change (N,) of all readings from `without` to `effects`."""
        machine = self.machine
        force = machine.log(effects).both - machine.log(without).both
        if machine.arm is None:
            return self.white.apply(force)
        arms = [[p for p in some if on_arm(p)] for some in (effects, without)]
        return self.white.apply(force, machine.arm.points(arms[0]) - machine.arm.points(arms[1]))

    def price(self, effect: str, joint: int | None = None) -> float:
        """2 ln(variants), and the freedom of forms with many coefficients."""
        lines = len({r.line for r in self.machine.rows.runs})
        more = {"stock_profile": WAVES * lines - 1, "belt_splice": 2 * HARMONICS - 1}.get(effect, 0)
        return float(2.0 * np.log(self.variants(effect, joint)) + COEFFICIENT * more)

    def variants(self, effect: str, joint: int | None) -> int:
        """How many members of a scanned family are looked at."""
        if self.scene is not None and effect not in ("base_tilt",):
            there = tracker.variants(effect, self.scene)
            if there > 1:
                return there
        runs = sum(r.contact for r in self.machine.rows.runs)
        span = float(np.ptp(self.machine.bare.q[:, (joint or 1) - 1]))
        orders = max(2, min(GEAR_ORDERS, round(GEAR_ORDERS * span)))
        counts = {
            "gear_harmonic": orders, "motor_harmonic": MOTOR_ORDERS, "belt_splice": SPLICES, "wheel_relaxation": RELAXATIONS,
            "clamp_slip": 2 * runs, "tool_frame_shift": runs, "wheel_frame_shift": runs, "base_tilt": runs,
        }  # fmt: skip
        return counts.get(effect, 1)


def on_arm(planted: Planted) -> bool:
    """Whether a tracker sees the effect."""
    from ocp.simulate.twin.truth.kinds_arm import KINDS

    return any(kind.name == planted.effect for kind in KINDS)


def sight_of(machine: GrindingMachine) -> Sight:
    """Everything that detectabilities on a machine need."""
    slopes = slopes_of(machine)
    scene = None if machine.arm is None else machine.arm.scene()
    found = nuisance(machine, slopes)
    roots = noise_roots(machine.rows)
    bare = Whitener(roots, machine.rows, np.zeros((0, 0)), np.zeros(0), None if scene is None else _tracker_root(scene))
    if scene is None:
        columns = bare.raw(np.concatenate([found.arm, found.rest], axis=2))
    else:
        points, force = _shared(scene, found.arm, found.rest)
        columns = bare.raw(force, points)
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    keep = s > 1e-9
    return Sight(machine, slopes, Whitener(roots, machine.rows, U[:, keep], 1 - 1 / np.sqrt(1 + s[keep] ** 2), bare.W), scene)


def noise_roots(rows: Rows) -> tuple[Array, ...]:
    """Inverse roots (k, k) of the covariance of each run's noise."""
    made: dict[int, Array] = {}
    found = []
    for k in range(len(rows.runs)):
        time = rows.time[rows.run == k]
        if len(time) not in made:
            lag = np.abs(time[:, None] - time[None])
            S = SENSOR_SIGMA**2 * ((1 - SLOW_SHARE) * np.eye(len(time)) + SLOW_SHARE * np.exp(-lag / SLOW_TIME))
            made[len(time)] = solve_triangular(np.linalg.cholesky(S), np.eye(len(time)), lower=True)
        found.append(made[len(time)])
    return tuple(found)


def _tracker_root(scene: Scene) -> Array:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(tracker.reading_covariance(scene))))


def _shared(scene: Scene, arm: Array, rest: Array) -> tuple[Array, Array]:
    """Columns of both signals per one sigma: what a tracker sees alone, what both see, what the log sees alone."""
    A, sd = tracker.nuisance(scene)
    A = A * sd
    nests = 3 * len(dict.fromkeys(scene.campaign.targets))
    both = [*range(FRAME, FRAME + 36), *range(FRAME + 36 + nests, FRAME + 36 + nests + 13)]
    alone = [i for i in range(A.shape[2]) if i not in both]
    n, m = arm.shape[1], len(A)
    points = np.concatenate([A[:, :, alone], A[:, :, both], np.zeros((m, 3, rest.shape[2]))], axis=2)
    return points, np.concatenate([np.zeros((2, n, len(alone))), arm, rest], axis=2)


def detectabilities(sight: Sight, effects: Sequence[Planted]) -> Array:
    """Lambda (k,) of every effect given the others, less the price of its family."""
    alone = [sight.signature(effects, [p for p in effects if p is not one]) for one in effects]
    return np.asarray(given_others(alone) - [sight.price(p.effect, p.joint) for p in effects])
