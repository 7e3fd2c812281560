"""The force at which wheel, blade, arm and mount together give way by the overlap: one monotone equation at every instant.

    depth = stroke(F) (n.a) + indentation(F) + F give                                              (4)

The unknown is v = (load / process load)^(2/3), in which the cover's curve is nearly straight; halving the interval finds it
for all instants at once and cannot fail.
"""

from dataclasses import dataclass, replace

import numpy as np

from ocp.simulate.twin.contact.flange import Mount
from ocp.simulate.twin.contact.table import LEVELS
from robots.pose import Array

V = LEVELS ** (2 / 3)
HIGHEST = 14.0  # v of the highest force looked for, 52 process forces; the curve goes on straight beyond the last level
HALVINGS = 46  # the interval is then rounding


@dataclass(frozen=True)
class CoverForce:
    """Force of the cover at a load: unit (n,) N at the process load; F = centre (unit v^1.5 / centre)^power, centre in N;
    `push` (n,) N acts beside it wherever there is contact; `slack` (n,) N has relaxed."""

    unit: Array
    centre: float
    power: float
    push: Array
    slack: Array

    def elastic(self, v: Array) -> Array:
        """Force (n,) N without push and relaxation."""
        return np.asarray(self.centre * (self.unit * v**1.5 / self.centre) ** self.power)

    def __call__(self, v: Array) -> Array:
        """Force (n,) N."""
        return np.asarray(np.maximum(self.elastic(v) - self.slack, 0.0) + self.push)


@dataclass(frozen=True)
class Chain:
    """Everything at n instants: depth m of the undeformed bodies, indentation (n, levels) m, give (n,) m/N, cover, mount."""

    depth: Array
    indentation: Array
    give: Array
    cover: CoverForce
    mount: Mount


@dataclass(frozen=True)
class Equilibrium:
    """Force N, elastic force of the cover N, stroke m, indentation m at n instants."""

    force: Array
    elastic: Array
    stroke: Array
    indentation: Array


def solve(chain: Chain) -> Equilibrium:
    """Force at every instant; 0 where the bodies do not meet."""
    slopes = _slopes(chain.indentation)

    def excess(v: Array, force: Array) -> Array:
        closed = chain.mount.stroke(force) * chain.mount.along + _curve(chain.indentation, slopes, v) + force * chain.give
        return np.asarray(chain.depth - closed)

    zero = np.zeros_like(chain.depth)
    at_touch = chain.cover(zero)
    meets = excess(zero, zero) > 0
    loaded = excess(zero, at_touch) > 0
    low, high = zero.copy(), np.full_like(zero, HIGHEST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        more = excess(middle, chain.cover(middle)) > 0
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    v = np.where(loaded, 0.5 * (low + high), 0.0)
    force = chain.cover(v)
    only_push = meets & ~loaded & (at_touch > 0)
    if only_push.any():
        low, high = zero.copy(), at_touch.copy()
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            more = excess(zero, middle) > 0
            low, high = np.where(more, middle, low), np.where(more, high, middle)
        force = np.where(only_push, 0.5 * (low + high), force)
    force = np.where(meets, force, 0.0)
    indentation = np.where(meets, _curve(chain.indentation, slopes, v), np.nan)
    return Equilibrium(force, np.where(meets, chain.cover.elastic(v), 0.0), chain.mount.stroke(force), indentation)


def solve_sticking(chain: Chain, restart: Array) -> Equilibrium:
    """Force with Coulomb friction in the mount: the stroke stays where it is as long as friction can hold it there.

    restart (n,): True where the memory begins, with the stroke having last given way to the wheel.
    """
    mount = chain.mount
    if mount.stiffness == 0.0 or not np.any(mount.friction):
        return solve(chain)
    least = solve(chain).stroke
    most = solve(replace(chain, mount=replace(mount, friction=-mount.friction))).stroke
    least, most = np.minimum(least, most), np.maximum(least, most)
    held = np.empty_like(least)
    last = 0.0
    for k in range(len(held)):
        last = least[k] if restart[k] else min(max(last, least[k]), most[k])
        held[k] = last
    return solve(replace(chain, mount=replace(mount, held=held)))


def _slopes(depth: Array) -> Array:
    """Slopes (n, levels) of monotone cubics through the levels (Fritsch and Butland 1984, as in PCHIP), one-sided at the ends."""
    h = np.diff(V)
    rise = np.diff(depth, axis=1) / h
    left, right = rise[:, :-1], rise[:, 1:]
    w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    same = left * right > 0
    inner = np.where(same, (w1 + w2) / (w1 / np.where(same, left, 1.0) + w2 / np.where(same, right, 1.0)), 0.0)
    return np.concatenate([rise[:, :1], inner, rise[:, -1:]], axis=1)


def _curve(depth: Array, slopes: Array, v: Array) -> Array:
    """Depth (n,) at v (n,): cubics between the levels, straight beyond the last."""
    i = np.clip(np.searchsorted(V, v, side="right") - 1, 0, len(V) - 2)
    row = np.arange(len(v))
    h = V[i + 1] - V[i]
    u = (np.minimum(v, V[-1]) - V[i]) / h
    a, b = depth[row, i], depth[row, i + 1]
    da, db = slopes[row, i] * h, slopes[row, i + 1] * h
    value = a + u * (da + u * (3 * (b - a) - 2 * da - db + u * (2 * (a - b) + da + db)))
    return np.asarray(value + np.maximum(v - V[-1], 0.0) * slopes[:, -1])
