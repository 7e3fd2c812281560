"""Output folders that appear whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from robots.errors import BadInput

LONGEST_NAME = 200  # bytes; file systems take 255, the temporary neighbour needs some


def check_output(folder: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse early what `whole_folder` would refuse after the work is done.

    Raises BadInput: the folder holds files and `overwrite` is false, holds one of `inputs` or the working folder, is a
    file, has a name that is empty or too long, or cannot be written.
    """
    if str(folder) in ("", "."):
        raise BadInput("--out is empty or the working folder itself; give the name of a folder to write")
    try:
        exists = folder.exists()
    except OSError as error:
        raise BadInput(f"--out {str(folder)[:40]}..: {error.strerror}; give a shorter name") from None
    if len(folder.name.encode()) > LONGEST_NAME:
        raise BadInput(f"--out {str(folder)[:40]}..: the name has {len(folder.name)} characters; give a shorter one")
    if exists and not folder.is_dir():
        raise BadInput(f"{folder}: is a file, not a folder; give another --out")
    if exists and any(folder.iterdir()):
        if not overwrite:
            raise BadInput(f"{folder}: exists and is not empty; give another --out, or --overwrite to replace it")
        _refuse_losses(folder, inputs)
    parent = folder.resolve().parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise BadInput(f"{folder}: cannot be made, {parent} is a file; give another --out")
    if not os.access(parent, os.W_OK) or (exists and not os.access(folder, os.W_OK)):
        raise BadInput(f"{folder}: cannot be written, no permission in {parent}; give another --out")


def _refuse_losses(folder: Path, inputs: Iterable[Path]) -> None:
    """Replacing a folder deletes what is in it: never an input of this very run, never where the user stands."""
    whole = folder.resolve()
    for file in inputs:
        if whole in file.resolve().parents:
            raise BadInput(f"{folder}: holds {file.name}, an input of this run; --overwrite would delete it, give another --out")
    for place in (Path.cwd(), Path.home()):
        if whole == place.resolve() or whole in place.resolve().parents:
            raise BadInput(f"{folder}: holds the folder {place}, which --overwrite would delete; give another --out")


@contextmanager
def whole_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder beside `folder` that takes its place when the block ends without an error.

    Whatever interrupts the block, `folder` is as it was before. A link is followed, the folder it points to is replaced.
    """
    check_output(folder, overwrite)
    folder = folder.resolve()
    parent = folder.parent
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
