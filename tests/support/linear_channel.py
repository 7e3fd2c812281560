"""A channel that is nothing but numbers: rows, nuisance and effects with given columns, for tests of the engine alone."""

from dataclasses import dataclass, field, replace

import numpy as np

from ocp.diagnose.engine.channel_system import UNSEEN, Fold, HeldOut, ReadingConditions, Sealed, System
from ocp.effects.effect import Active, Effect, Parameter, Surroundings


def effect(name, prior_sd=(1.0,), joints=(), signed=True, scans=None, low=0.05):
    """An effect whose coefficients are its parameters, of prior `prior_sd`."""
    keys = tuple(f"a{i}" for i in range(len(prior_sd)))
    return Effect(
        name=name,
        title=name,
        subsystem="joint",
        physics="numbers",
        parameters=tuple(Parameter(k, "1", low * s, s, signed=signed) for k, s in zip(keys, prior_sd, strict=True)),
        coefficients=keys,
        prior_sd=tuple(prior_sd),
        values=lambda a, scanned: {k: float(v) for k, v in zip(keys, a, strict=True)} | dict(scanned),
        coefficients_of=lambda values: (np.array([values[k] for k in keys]), {}),
        joints=joints,
        scan=(lambda j, seen: ({},)) if scans is None else (lambda j, seen: scans),
    )


@dataclass(frozen=True)
class LinearChannel:
    """Unit noise; nuisance A with prior sd; columns by (effect, joint): (V, N, m)."""

    y: np.ndarray
    A: np.ndarray
    prior_sd: np.ndarray
    columns: dict
    offset: np.ndarray | None = None
    active: tuple[Active, ...] = ()
    name: str = "joint"
    unit: str = "arcsec"
    noise_floor: float = 1.0
    conditions_given: ReadingConditions | None = None
    each: int = 1  # rows of a reading
    tailed: bool = False
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def conditions(self):
        """As given, else a plain log."""
        return self.conditions_given or ReadingConditions(self.name, q=np.zeros((len(self.y), 6)))

    @property
    def system(self):
        """About the active effects' values; the nuisance at its prior's mean unless an offset is given."""
        residual = self.y - sum((self._of(a)[0] @ a.a for a in self.active), np.zeros(len(self.y)))
        offset = np.zeros(len(self.prior_sd)) if self.offset is None else self.offset
        n = len(self.y)
        reading = np.arange(n) // self.each
        return System(residual - self.A @ offset, self.A, self.prior_sd, offset, reading, tailed=self.tailed)

    @property
    def surroundings(self):
        """Its clock alone."""
        return Surroundings(np.full(6, np.nan), np.zeros((6, 2)), self.time)

    def blind(self, e):
        """Effects without columns."""
        return "" if any(k[0] == e.name for k in self.columns) else f"{e.name} has no columns"

    def _of(self, a):
        scans = list(a.effect.scan(a.joint, self.surroundings))
        return self.columns[(a.effect.name, a.joint)][scans.index(a.scanned)][None]

    def variants(self, e, joint, scans=None):
        """Columns as given."""
        if (e.name, joint) not in self.columns:
            return UNSEEN
        every = list(e.scan(joint, self.surroundings))
        chosen = every if scans is None else list(scans)
        made = self.columns[(e.name, joint)]
        return tuple(chosen), np.stack([made[every.index(s)] for s in chosen], axis=1)

    def with_active(self, active):
        """Linear: the values given are as good as refitted ones."""
        return replace(self, active=tuple(active))

    def gap(self):
        """Residual (n, 1)."""
        return self.system.residual[:, None]

    def whiten(self, changes):
        """Unit noise already."""
        return changes[:, 0]

    def folds(self):
        """Two halves."""
        n = len(self.y)
        return [Fold("first", "block", np.arange(n) < n // 2)]

    def held_out(self, fold: Fold, active) -> HeldOut | None:
        """Not judged."""
        return None

    def predict(self, sealed, active) -> Sealed:
        """Not asked."""
        raise AssertionError
