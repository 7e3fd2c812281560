"""The blade's finite elements solved once for all worlds, plans and fits of a run: their accuracy is tested elsewhere."""

import os
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filelock import FileLock

from ocp.contact.blade.compliance import ClampedBlade, HeldBlade, clamped_blade
from ocp.shell.cache import content_key

SIZE = 7.7e-3  # m, twice the product's elements on the bundled blade: half the time, compliances within 0.6 %
SOLIDS: dict[str, tuple[float, ClampedBlade]] = {}  # with its modulus; of this process, whatever module asks


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


def of_the_run(folder: Path, key: str, held: HeldBlade) -> tuple[float, ClampedBlade]:
    """Modulus and solid, made by the first process of a run that asks for it."""
    file = folder / f"solid-{key}.pickle"
    with FileLock(file.with_suffix(".lock")):
        try:
            return pickle.loads(file.read_bytes())
        except FileNotFoundError:  # nobody has made it, or who did is done with all its tests and has cleared it away
            made = held.material.youngs_modulus, clamped_blade(held, SIZE)
            file.write_bytes(pickle.dumps(made))
            return made


@contextmanager
def one_solid() -> Iterator[None]:
    """Whatever size of elements is asked for: a softer cover, other lines, a world and the fit to it share the solid."""
    folder = Path(os.environ["GRINDPLAN_CACHE"]).parent
    folder.mkdir(parents=True, exist_ok=True)

    def known(held: HeldBlade, size: float) -> ClampedBlade:
        *shape, modulus, poisson = held.content
        key = content_key(poisson, *shape)
        if key not in SOLIDS:
            SOLIDS[key] = of_the_run(folder, key, held)
        made_of, solid = SOLIDS[key]
        return replace(solid, factorisation=Softer(solid.factorisation, made_of / modulus))

    with pytest.MonkeyPatch.context() as patch:
        for module in ("ocp.contact.blade.compliance", "ocp.calibrate.force.blade"):
            patch.setattr(f"{module}.clamped_blade", known)
        for version in ("contact.blade.compliance.VERSION", "calibrate.force.blade.STATIONS_VERSION"):
            patch.setattr(f"ocp.{version}", "one solid")  # nobody else reads what is kept of it
        patch.setattr("ocp.calibrate.force.blade.StationsTask.known", True)
        yield
