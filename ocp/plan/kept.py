"""A plan asked for again with nothing changed: the folder as it was planned, written and read back then, byte for byte.

The same inputs give the same bytes, whatever the machine (tests/plan), so that planning anew would tell nothing more. A kept
folder is not read back again: it lies where only this user can write, or nowhere.
"""

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, Self

import numpy as np

from ocp.shell.cache import code_hash, content_key, keep, recall
from ocp.shell.output import MARKER, whole_folder
from robots.bounds import MEGABYTE

SECTION = "plan"  # of the cache
MOST_READ = 1000 * MEGABYTE  # of all files together; what is larger is for the readers of a plan to refuse


def line_of(folder: Path, written: str) -> str:
    """What was written, and where, in one line."""
    return f"{folder}: {written} Look at {folder / 'report.html'} before anything moves."


@dataclass(frozen=True)
class KeptPlan:
    """A folder that was written again from what is kept; what was written, and the notices of then."""

    folder: Path
    written: str
    notices: tuple[str, ...]

    @property
    def line(self) -> str:
        """As of the plan itself."""
        return line_of(self.folder, self.written)


@dataclass(frozen=True)
class PlanKey:
    """What a plan depends on: `files` as named, with their content; the other arguments; this software and all that is installed
    beside it."""

    files: tuple[Path, ...]
    key: str

    @classmethod
    def of(cls, files: Sequence[Path], arguments: Mapping[str, Any]) -> Self | None:
        """Of the files that are there and of arguments that print as what they are; None where a file cannot be read: planning
        tells why."""
        there = tuple(file for file in files if file.is_file())
        try:
            if sum(file.stat().st_size for file in there) > MOST_READ:
                return None
            read = [part for file in there for part in (str(file), np.frombuffer(file.read_bytes(), np.uint8))]
            installed = sorted(f"{one.name} {one.version}" for one in distributions())
            machine = (platform.platform(), platform.python_version(), *installed)
            return cls(there, content_key(code_hash(), *machine, repr(sorted(arguments.items())), *read))
        except OSError:
            return None

    def written_again(self, out: Path, overwrite: bool) -> KeptPlan | None:
        """The kept folder in `out`, None where none is kept. Raises BadInput where `out` cannot be written."""
        entry = recall(SECTION, self.key, alone=True)
        if entry is None:
            return None
        with whole_folder(out, overwrite, self.files) as folder:
            for name in (name for name in entry if name.startswith("file.")):
                (folder / name.removeprefix("file.")).write_bytes(entry[name].tobytes())
        again = f"{out}: nothing that it depends on has changed; it is written as it was planned and read back then."
        return KeptPlan(out, str(entry["written"]), (*entry["notices"].tolist(), again))

    def keep(self, folder: Path, written: str, notices: Sequence[str], inputs: Sequence[Path]) -> None:
        """Keep a folder under this key, if its plan read no other file than the key's."""
        known = {os.path.realpath(file) for file in self.files}
        if any(os.path.realpath(file) not in known for file in inputs):
            return
        files = [file for file in sorted(folder.iterdir()) if file.name != MARKER]
        entry = {f"file.{file.name}": np.frombuffer(file.read_bytes(), np.uint8) for file in files}
        keep(SECTION, self.key, entry | {"written": np.array(written), "notices": np.array(list(notices), dtype=str)}, alone=True)
