"""The cache as the wheel's parts ask for it: `load` and `store` under a text key."""

from dataclasses import dataclass

import numpy as np

from ocp.shell.cache import content_key, keep, recall
from robots.pose import Array


@dataclass(frozen=True)
class DiskStore:
    """Arrays kept on disk under `kind` (part of the file name) and any text."""

    kind: str

    def load(self, key: str) -> dict[str, Array] | None:
        """Arrays stored under `key`, or None."""
        entry = recall(self.kind, content_key(key))
        return None if entry is None else {name: np.asarray(value) for name, value in entry.items()}

    def store(self, key: str, arrays: dict[str, Array]) -> None:
        """Keep `arrays` under `key`."""
        keep(self.kind, content_key(key), dict(arrays))
