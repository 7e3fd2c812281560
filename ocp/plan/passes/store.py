"""Solved passes kept on disk under everything they depend on: cell, parameters, wheel, blade, paths and this code itself."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import ocp
import robots
import trajectories
from ocp.plan.passes.optimise import Ground, SolvedPass
from ocp.shell.cache import content_key, remember
from ocp.shell.dataclass_arrays import flattened, rebuilt
from robots.pose import Array
from trajectories.passes import BladePath

FILES = (".path", ".stl")  # where a file lies does not matter, what it says is in the key by value


def remembered_passes(
    ground: Ground, paths: list[BladePath], compliance: list[Array], solve: Callable[[], list[SolvedPass]]
) -> list[SolvedPass]:
    """The solved passes of `paths` on `ground` with the blade's compliance: kept ones, else those of `solve`."""
    content = flattened((ground, paths, compliance))
    parts = [part for name, array in sorted(content.items()) if not name.endswith(FILES) for part in (name, array)]
    entry = remember("passes", content_key(code_hash(), *parts), lambda: flattened(solve()))
    return [rebuilt(SolvedPass, entry, f".{i}") for i in range(len(paths))]


@cache
def code_hash() -> str:
    """Hash of the sources and the data of the three packages: so many of them shape a pass that any change counts."""
    digest = hashlib.sha256()
    for package in (ocp, robots, trajectories):
        for file in sorted(Path(str(package.__file__)).parent.rglob("*")):
            if file.suffix in (".py", ".toml"):
                digest.update(file.read_bytes())
    return digest.hexdigest()
