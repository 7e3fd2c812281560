"""The blade's finite elements solved once for all worlds, plans and fits of this process: their accuracy is tested elsewhere."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ocp.contact.blade.compliance import ClampedBlade, HeldBlade, clamped_blade

COARSER = 1.7  # than the product's elements: half the time
STEP = 1.5  # sizes are rounded to powers of it: what differs by a world's softer cover or by other lines is the same solid
SOLIDS: dict[tuple[object, ...], tuple[float, ClampedBlade]] = {}  # with its modulus; of this process, whatever module asks


@dataclass(frozen=True)
class Softer:
    """The factorisation of a solid of another modulus: the compliance is inversely proportional to it."""

    solid: Any
    times: float

    @property
    def unknowns(self) -> int:
        return self.solid.unknowns

    def compliance(self, loads) -> np.ndarray:
        return self.times * self.solid.compliance(loads)


@contextmanager
def one_solid() -> Iterator[None]:
    def known(held: HeldBlade, size: float) -> ClampedBlade:
        even = STEP ** round(np.log(COARSER * size) / np.log(STEP))
        *shape, modulus, poisson = held.content
        key = (even, poisson, *(np.asarray(part).tobytes() for part in shape))
        if key not in SOLIDS:
            SOLIDS[key] = modulus, clamped_blade(held, even)
        made_of, solid = SOLIDS[key]
        return replace(solid, factorisation=Softer(solid.factorisation, made_of / modulus))

    with pytest.MonkeyPatch.context() as patch:
        for module in ("ocp.contact.blade.compliance", "ocp.calibrate.force.blade"):
            patch.setattr(f"{module}.clamped_blade", known)
        for version in ("contact.blade.compliance.VERSION", "calibrate.force.blade.STATIONS_VERSION"):
            patch.setattr(f"ocp.{version}", "one solid")  # nobody else reads what is kept of it
        patch.setattr("ocp.calibrate.force.blade.StationsTask.known", True)
        yield
