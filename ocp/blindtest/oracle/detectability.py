"""The detectability index of a planted effect: how far its true signature stands out of noise and of all that is refitted.

    lambda = d^T (Sigma + A P A^T)^-1 d                                                       (DIAGNOSIS, "How it is judged")

d is the readings with the effect less those without it on the same virtual cell, Sigma the covariance of the readings' noise, A
the derivatives in everything a machine is drawn with, P the variances it is drawn with: the right covariance, not one that was
fitted. Scanned families pay 2 ln(variants), the price of looking at all of them. What readings are is a signal's own matter
(`ocp.blindtest.oracle.tracker`, `ocp.blindtest.oracle.force`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from ocp.simulate.twin.planting import Planted
from robots.pose import Array

# Instants that can be told apart, orders, nests: how many members of a scanned family are looked at.
GEAR_ORDERS, MOTOR_ORDERS = 298, 2


@dataclass(frozen=True, eq=False)
class ExactWhitener:
    """The symmetric root of (Sigma + A P A^T)^-1: `raw` makes changes of the readings white as to Sigma (N, ...), then U (N, r)
    and what it takes of each direction (r,)."""

    raw: Callable[..., Array]
    U: Array
    take: Array

    def apply(self, *changes: Array) -> Array:
        """White rows (N, ...) of changes of the readings, one array for each signal."""
        rows = self.raw(*changes)
        flat = rows.reshape(len(rows), -1)
        flat = flat - self.U @ (self.take[:, None] * (self.U.T @ flat))
        return np.asarray(flat.reshape(rows.shape))


def exact_whitener(raw: Callable[..., Array], columns: Array) -> ExactWhitener:
    """`columns` (N, p): white derivatives per one sigma of what machines are drawn with."""
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    keep = s > 1e-9
    return ExactWhitener(raw, U[:, keep], 1.0 - 1.0 / np.sqrt(1.0 + s[keep] ** 2))


class ExactView(Protocol):
    """A machine of one signal as somebody sees it who knows its numbers."""

    @property
    def white(self) -> ExactWhitener:
        """Of its readings."""

    @property
    def targets(self) -> tuple[str, ...]:
        """Nests of a campaign."""

    def signature(self, effects: Sequence[Planted], without: Sequence[Planted] = ()) -> Array:
        """White change (N,) of all readings from `without` to `effects`."""

    def price(self, effect: str, joint: int | None = None) -> float:
        """What the effect's family pays for having many members."""

    def instant(self, planted: Planted, rng: np.random.Generator) -> float | None:
        """Clock s at which a drawn effect that begins at some time may begin; None: as it was drawn."""

    def readings(self, folder: Path, effects: Sequence[Planted], rng: np.random.Generator) -> Array:
        """White readings (N,) of a world: the effects, its own noise less gross readings, a machine drawn anew with `rng`."""


def detectabilities(view: ExactView, effects: Sequence[Planted]) -> Array:
    """Lambda (k,) of every effect given the others, less the price of its family."""
    found = given_others([view.signature(effects, [p for p in effects if p is not one]) for one in effects])
    return np.asarray(found - [view.price(p.effect, p.joint) for p in effects])


def given_others(white: Sequence[Array]) -> Array:
    """Lambda (k,) of each of k white signatures (N,), the directions of the others being free."""
    S = np.stack(white, axis=1)
    found = np.empty(S.shape[1])
    for i in range(len(found)):
        rest = np.delete(S, i, axis=1)
        left = S[:, i]
        if rest.shape[1]:
            Q, _ = np.linalg.qr(rest)
            left = left - Q @ (Q.T @ left)
        found[i] = left @ left
    return found
