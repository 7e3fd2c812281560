"""Output folders that appear whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robots.errors import BadInput


def check_output(folder: Path, overwrite: bool) -> None:
    """Refuse early what `whole_folder` would refuse after the work is done.

    Raises BadInput: the folder holds files and `overwrite` is false, is a file, or cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder}: is a file, not a folder; give another --out")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise BadInput(f"{folder}: exists and is not empty; give another --out, or --overwrite to replace it")
    parent = folder.resolve().parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise BadInput(f"{folder}: cannot be written, no permission in {parent}; give another --out")
    if folder.is_dir() and not os.access(folder, os.W_OK):
        raise BadInput(f"{folder}: cannot be written, no permission; give another --out")


@contextmanager
def whole_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder beside `folder` that takes its place when the block ends without an error.

    Whatever interrupts the block, `folder` is as it was before.
    """
    check_output(folder, overwrite)
    parent = folder.resolve().parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=parent))
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written ({error.strerror}); give another --out") from None
    try:
        yield partial
        partial.chmod(0o755)
        old = None
        if folder.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old.", dir=parent))
            folder.rename(old / folder.name)
        partial.rename(parent / folder.name)
        if old is not None:
            shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
