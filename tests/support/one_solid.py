"""The blade's finite elements solved once for a world and its fits, in this process: their accuracy is tested elsewhere."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from ocp.contact.blade.compliance import ClampedBlade, clamped_blade

COARSER = 1.7  # than the product's elements: a fifth of the time, and worlds and fits have the same blade
SOLIDS: dict[tuple[object, ...], ClampedBlade] = {}  # of this process, whatever module asks


@contextmanager
def one_solid() -> Iterator[None]:
    def known(held, size):
        key = (len(held.vertices), round(size, 9), held.material)
        if key not in SOLIDS:
            SOLIDS[key] = clamped_blade(held, COARSER * size)
        return SOLIDS[key]

    with pytest.MonkeyPatch.context() as patch:
        for module in ("ocp.contact.blade.compliance", "ocp.calibrate.force.blade"):
            patch.setattr(f"{module}.clamped_blade", known)
        patch.setattr("ocp.calibrate.force.blade.StationsTask.known", True)
        yield
