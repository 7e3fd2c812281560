"""By what an answer names the files it was made from."""

import hashlib
from pathlib import Path


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal. Raises OSError where it cannot be read."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
