import os
from collections.abc import Iterator
from pathlib import Path

import pytest

import ocp  # noqa: F401  one BLAS thread, before NumPy is first imported: two would fight on the core of each process

SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real blades, robots and worlds that stands beside the checkout."""
    if not SHARED.is_dir():
        pytest.skip(f"no folder {SHARED}: the real blades and worlds are not beside this checkout")
    return SHARED


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Tests never read what an earlier run left in the user's cache; those of one run share theirs, whichever process they are
    in: the same blades and wheels are solved once."""
    base = tmp_path_factory.getbasetemp()
    os.environ["GRINDPLAN_CACHE"] = str((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "own-cache")


@pytest.fixture(autouse=True, scope="session")
def one_core_each(own_cache: None) -> Iterator[None]:
    """Each process of a parallel run keeps to one core, and so do the commands it starts: passes, contacts and pages are worked
    on in the process itself instead of in helpers that import everything once more and fight for the other's core."""
    worker, free = os.environ.get("PYTEST_XDIST_WORKER", ""), sorted(os.sched_getaffinity(0))
    if worker and len(free) > 1:
        os.sched_setaffinity(0, {free[int(worker.removeprefix("gw")) % len(free)]})
    yield
    os.sched_setaffinity(0, free)


@pytest.fixture(scope="module")
def every_core() -> Iterator[None]:
    """Two cores at least for what a module starts: work is handed to helpers, as on a user's machine."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    yield
    os.sched_setaffinity(0, before)
