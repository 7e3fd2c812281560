import gc
import json
import os
import pickle
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import asdict
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import distributions
from pathlib import Path
from types import SimpleNamespace

import pytest
from filelock import FileLock

import ocp  # noqa: F401  one BLAS thread, before NumPy is first imported: two would fight on the core of each process

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # a hundred commands that tests start would compile all sources anew
sys.dont_write_bytecode = False  # and each worker all tests with their asserts rewritten, a third of what collecting takes
gc.set_threshold(50_000, 20, 20)  # as in a command: a tenth of the suite's time went by looking through what lives to the end
# The longest files, longest first: two processes then end together, with short ones. Beside the first, which solves the bundled
# blade and wheel for all, one that needs neither.
LONGEST = (
    "plan/test_calibrated_plan.py",
    "diagnose/test_diagnosis_tracker.py",
    "diagnose/test_diagnosis_force.py",
    "test_hostile_inputs.py",
    "simulate/test_simulate_command.py",
    "calibrate/test_force_fit.py",
    "diagnose/test_diagnosis_force_waves.py",
    "plan/test_report.py",
    "trajectories/test_blade_parts.py",
    "api/test_examples.py",
    "plan/test_effects_plan.py",
    "plan/test_plan_command.py",
    "plan/test_optimal_control.py",
    "poses/test_poses_command.py",
    "calibrate/test_calibration_report.py",
    "update/test_update_command.py",
    "experiments/test_experiments.py",
    "calibrate/test_calibrate_command.py",
    "diagnose/test_diagnosis_kernels.py",
    "diagnose/test_shrinkage.py",
    "cell/test_cell_command.py",
    "blindtest/test_blindtest.py",
    "plan/test_wanted.py",
    "plan/test_night.py",
    "diagnose/test_diagnosis_force_worlds.py",
    "contact/test_signorini.py",
    "diagnose/test_patch.py",
    "plan/test_secondary_contact.py",
    "diagnose/test_planned_force.py",
    "shell/test_executor.py",
    "simulate/test_twin_flange_motion.py",
    "diagnose/test_both_signals.py",
    "diagnose/test_planted_in_the_twin.py",
    "robots/test_calibration_mistakes.py",
    "diagnose/test_diagnose_command.py",
    "plan/test_dwell.py",
    "simulate/test_program_mutations.py",
)
TESTS = Path(__file__).resolve().parent
SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"


def pytest_configure(config: pytest.Config) -> None:
    config.option.loadscopereorder = False  # xdist would put the files with the fewest tests last, and those are the longest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    places = {TESTS / name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real blades, robots and worlds that stands beside the checkout."""
    if not SHARED.is_dir():
        pytest.skip(f"no folder {SHARED}: the real blades and worlds are not beside this checkout")
    return SHARED


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests never read what an earlier run left in the user's cache; those of one run share theirs, whichever process they are
    in: the same blades and wheels are solved once."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    os.environ["GRINDPLAN_CACHE"] = str(base / "own-cache")
    yield
    for file in base.glob("solid-*.pickle"):  # tests/support/one_solid.py: 300 MB each, which no later run reads
        file.unlink(missing_ok=True)


@pytest.fixture(autouse=True, scope="session")
def plans_made_anew(own_cache: None) -> Iterator[None]:
    """Commands in this process take no whole plan from the cache: tests change what a plan is made by without its key knowing."""
    from ocp.plan.kept import PlanKey

    listed = [SimpleNamespace(name=one.name, version=one.version) for one in distributions()]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ocp.plan.kept.distributions", lambda: listed)  # each is read from its file
        patch.setattr(PlanKey, "written_again", lambda *_: None)
        patch.setattr(PlanKey, "keep", lambda *_: None)
        yield


@pytest.fixture(autouse=True, scope="session")
def compiled_once(own_cache: None) -> Iterator[None]:
    """The force model is compiled by the first test that uses it, however few its rows: the others then have it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ocp.calibrate.force.model.WORTH_COMPILING", 1)
        yield


@pytest.fixture(autouse=True, scope="session")
def arm_compiled_once(own_cache: None) -> Iterator[None]:
    """The arm by which calibrations and diagnoses predict readings, as machine code: the same bits, or it is not taken, in a
    seventh of the time, and a hundred tests fit it thousands of times. A robot of other masses has the same library."""
    from ocp.shell import native
    from robots.calibration import reading_model

    def compiled(build):
        def made(*given):
            told, one = dict(native._told), native.ColumnFunction(build(*given))
            native.compile_together([one])
            native._told.clear()
            native._told.update(told)  # what a plan says of its own functions
            return one

        return lru_cache(maxsize=32)(made)

    with pytest.MonkeyPatch.context() as patch:
        for name in ("_place", "_with_derivatives"):
            patch.setattr(reading_model, name, compiled(getattr(reading_model, name)))
        yield


@pytest.fixture(autouse=True, scope="session")
def crossings_looked_for_once() -> Iterator[None]:
    """A surface that was found free of facets that cut each other is so again: the same few blades are read a hundred times."""
    import numpy as np

    from trajectories.blade import reading

    free, original = set[bytes](), reading.self_intersections

    def looked_for_once(vertices, faces):
        key = sha256(vertices.tobytes() + faces.tobytes()).digest()
        if key in free:
            return np.zeros((0, 2), np.int64)
        found = original(vertices, faces)
        if not len(found):
            free.add(key)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, "self_intersections", looked_for_once)
        yield


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


@pytest.fixture(scope="session")
def small_plan_once(own_cache: None):
    """Folder with cell, blade and plan of the small cell, and what the command said: made once for all processes of a run, with
    helpers as on a user's machine. Nobody writes in it."""
    from tests.support.small_plan import STEP, Told, planned, small_cell

    base = Path(os.environ["GRINDPLAN_CACHE"]).parent
    base.mkdir(parents=True, exist_ok=True)
    folder, said = base / "small-plan", base / "small-plan.json"
    with FileLock(base / "small-plan.lock"):
        if not said.exists():
            small_cell(folder)
            before = os.sched_getaffinity(0)
            os.sched_setaffinity(0, range(os.cpu_count() or 1))
            said.write_text(json.dumps(asdict(planned(folder, "--cell", "cell.toml", *STEP))))
            os.sched_setaffinity(0, before)
    return folder, Told(**json.loads(said.read_text()))


@pytest.fixture
def unprinted(request: pytest.FixtureRequest) -> Iterator[None]:
    """Commands in this process draw no figures for pages and sheets, which take as long as all else; but for tests
    marked `drawn`, and what is made for a whole module."""
    from tests.support.small_plan import without_figures

    with nullcontext() if request.node.get_closest_marker("drawn") else without_figures():
        yield


@pytest.fixture(scope="module")
def solved_once(own_cache: None) -> Iterator[None]:
    """The blades of a module's worlds, plans and fits are one solid of larger elements."""
    from tests.support.one_solid import one_solid

    with one_solid():
        yield


@pytest.fixture(scope="session")
def force_campaign_once(own_cache: None):
    """A grinding campaign of the virtual machine without any effect: recorded once for all processes of a run."""
    from numpy.random import default_rng

    from tests.support.diagnosis_force_world import PLAN, believed_world, record
    from tests.support.one_solid import one_solid

    base = Path(os.environ["GRINDPLAN_CACHE"]).parent
    base.mkdir(parents=True, exist_ok=True)
    kept = base / "force-campaign.pickle"
    with FileLock(base / "force-campaign.lock"):
        if not kept.exists():
            rng = default_rng(5)
            with one_solid():
                made = record(believed_world(base / "force-campaign", rng, every=4), PLAN, rng)
            kept.write_bytes(pickle.dumps(made))
    return pickle.loads(kept.read_bytes())


@pytest.fixture(scope="module")
def small_plan_copy(small_plan_once, tmp_path_factory: pytest.TempPathFactory):
    """A copy of the small plan's folder, for one file of tests, and what the command said."""
    folder = tmp_path_factory.mktemp("small") / "cell"
    shutil.copytree(small_plan_once[0], folder)
    return folder, small_plan_once[1]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a Dask scheduler of this machine with two workers, processes of their own in folders of their own."""
    pytest.importorskip("distributed", reason="pip install '.[cluster]'")
    folder = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    common = ("--scheduler-file", str(file), "--no-dashboard")
    place = {"cwd": folder, "env": os.environ | {"PYTHONPATH": str(TESTS.parent)}, "stderr": subprocess.DEVNULL}
    scheduler = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0")
    worker = ("distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1", "--local-directory", str(folder))
    running = [subprocess.Popen([sys.executable, "-m", *command, *common], **place) for command in (scheduler, worker, worker)]
    try:
        until = time.monotonic() + 60
        while not file.exists() and time.monotonic() < until:
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in running:
            process.kill()
            process.wait()
