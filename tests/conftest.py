import os
from pathlib import Path

import pytest

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
