"""Results kept on disk under the hash of everything they depend on, and dataclasses as arrays for it.

An entry is one `.npz` archive without pickles behind a checksum of its own (NumPy does not check the archive's). It appears by a
rename, so that processes working side by side see a whole entry or none; an entry that is not as it was written is computed anew.
Nothing in here ever makes a run fail: where the folder cannot be written the result is simply not kept.
"""

import hashlib
import io
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from itertools import repeat
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from robots.bounds import MEGABYTE, read_whole

Part = NDArray[np.generic] | str | int | float | bool | None
Entry = dict[str, NDArray[np.generic]]

SUFFIX = ".kept"
MOST_ENTRY = 1000 * MEGABYTE  # a plan's largest has some MB
DIGEST = 32  # bytes of SHA-256 before the archive
VARIABLE = "GRINDPLAN_CACHE"  # environment: another folder; empty = keep nothing
OWN_EFFECTS = "GRINDPLAN_EFFECTS"  # environment: a folder with further effects, one a file; worker processes inherit it


def content_key(*parts: Part) -> str:
    """Return a hexadecimal name that differs when any array (values, shape, type) or scalar in `parts` differs.

    Callers put the name and the version of their code first, so that a changed method finds no old results.
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            array = np.ascontiguousarray(part)
            header = f"array {array.dtype.str} {array.shape} "
            payload = array.tobytes()
        else:
            value = part.item() if isinstance(part, np.generic) else part
            header, payload = f"{type(value).__name__} ", repr(value).encode()
        digest.update(f"{header}{len(payload)} ".encode())
        digest.update(payload)
    return digest.hexdigest()[:40]


def cache_folder() -> Path | None:
    """Return the folder of kept results: $GRINDPLAN_CACHE, else the platform's; None when nothing is to be kept."""
    chosen = os.environ.get(VARIABLE)
    if chosen is not None:
        return Path(chosen).expanduser() if chosen.strip() else None
    try:
        home = Path.home()
    except RuntimeError:  # no home folder, as in some containers
        return None
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "grindplan"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local")) / "grindplan" / "cache"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "grindplan"


def remember(kind: str, key: str, compute: Callable[[], Entry]) -> Entry:
    """Return the arrays kept under `kind` and `key`, or compute and keep them.

    Args:
        kind: short name of what is kept, part of the file name.
        key: what `content_key` gave for everything the result depends on.
        compute: called without arguments when there is no readable entry; its errors pass through.
    """
    entry = recall(kind, key)
    if entry is None:
        entry = compute()
        keep(kind, key, entry)
    return entry


def _read(path: Path) -> Entry | None:
    """Return an entry, or None where there is none or any byte of it is not as it was written."""
    try:
        content = read_whole(path, MOST_ENTRY, "a kept result")
        if hashlib.sha256(content[DIGEST:]).digest() != content[:DIGEST]:
            return None
        with np.load(io.BytesIO(content[DIGEST:]), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except Exception:  # whatever a broken file does to the reader: it is computed anew
        return None


def _write(path: Path, entry: Entry) -> None:
    """Write an entry behind its checksum, where the folder can be written."""
    archive = io.BytesIO()
    np.savez(archive, allow_pickle=False, **entry)
    content = archive.getvalue()
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        put_whole(path, hashlib.sha256(content).digest(), content)
    except OSError:
        pass


def put_whole(path: Path, *parts: bytes) -> None:
    """Write a file under a passing name beside its place, then rename it: others see a whole file or none. Raises OSError."""
    passing = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            passing = file.name
            file.writelines(parts)
        os.replace(passing, path)
        passing = None
    finally:
        if passing is not None:
            Path(passing).unlink(missing_ok=True)


class NotPrivate(Exception):
    """Why nothing is kept or taken where others could put it there."""


def own_folder(name: str) -> Path:
    """A folder of the cache that is this user's alone, in folders where nobody else can put another in its place.

    Raises NotPrivate where it is not, or cannot be made.
    """
    kept = cache_folder()
    if kept is None:
        raise NotPrivate("nothing is kept (GRINDPLAN_CACHE is empty)")
    if not hasattr(os, "geteuid"):
        raise NotPrivate("on this system nothing tells whose a folder is")
    folder = kept.resolve() / name
    try:
        kept.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        for one in (folder, *folder.parents):
            _refuse_shared(one, alone=one is folder)
    except OSError as error:
        raise NotPrivate(f"{error.filename}: {error.strerror}") from None
    return folder


def _refuse_shared(folder: Path, alone: bool) -> None:
    """Raises NotPrivate where others can put something into `folder`, or, `alone`, look into it. Raises OSError."""
    status, me = folder.lstat(), os.geteuid()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid not in ({me} if alone else {0, me}):
        raise NotPrivate(f"{folder} is not a folder of this user")
    mode = stat.S_IMODE(status.st_mode)
    sticky = bool(mode & stat.S_ISVTX)  # as /tmp: what is in it can be replaced by its owner only
    if mode & (0o077 if alone else 0o022) and (alone or not sticky):
        raise NotPrivate(f"{folder} is open to others (mode {mode:04o}); chmod {'700' if alone else 'go-w'} it")


def recall(kind: str, key: str, alone: bool = False) -> Entry | None:
    """Return the arrays kept under `kind` and `key`, or None; `alone`: as `keep` put them there."""
    folder = _place(kind, alone)
    return None if folder is None else _read(folder / f"{kind}-{key}{SUFFIX}")


def keep(kind: str, key: str, entry: Entry, alone: bool = False) -> None:
    """Keep arrays under `kind` and `key`; a folder that cannot be written is no error. `alone`: in a folder where only this user
    can, or not at all, for what is not looked at again before it is used."""
    folder = _place(kind, alone)
    if folder is not None:
        _write(folder / f"{kind}-{key}{SUFFIX}", entry)


def _place(kind: str, alone: bool) -> Path | None:
    try:
        return own_folder(kind) if alone else cache_folder()
    except NotPrivate:
        return None


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal. Raises OSError where it cannot be read."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def code_hash() -> str:
    """Hash of the sources and the data of the three packages and of the user's own effects: so many of them shape a plan that any
    change counts."""
    own = os.environ.get(OWN_EFFECTS, "")
    return _hash_of_packages() + (_hash_of(Path(own).glob("*")) if own else "")


@cache
def _hash_of_packages() -> str:
    root = Path(__file__).parents[2]
    return _hash_of(file for package in ("ocp", "robots", "trajectories") for file in (root / package).rglob("*"))


def _hash_of(files: Iterable[Path]) -> str:
    """Hash of the names and bytes of files; what Python compiles of them does not count."""
    digest = hashlib.sha256()
    for file in sorted(files):
        if "__pycache__" not in file.parts and file.is_file():
            digest.update(f"{file.name} {sha256(file)} ".encode())
    return digest.hexdigest()


def flattened(value: Any, prefix: str = "") -> Entry:
    """Arrays of everything inside `value` under dotted names: nested dataclasses, lists, arrays, numbers, text, paths.

    None leaves no entry. Raises TypeError for any other content, so that nothing is left out of a key by oversight.
    """
    if value is None:
        return {}
    if is_dataclass(value):
        parts = [(f.name, getattr(value, f.name)) for f in fields(value)]
    elif isinstance(value, list | tuple):
        parts = [(str(i), item) for i, item in enumerate(value)]
    elif isinstance(value, dict):
        parts = [(str(name), item) for name, item in value.items()]
    elif isinstance(value, BaseModel):
        return {prefix: np.array(value.model_dump_json())}
    elif isinstance(value, Path):
        return {prefix: np.array(str(value))}
    elif isinstance(value, np.ndarray | np.generic | int | float | str):
        return {prefix: np.asarray(value)}
    else:
        raise TypeError(f"{prefix}: {type(value).__name__} cannot be kept as arrays")
    return {name: array for key, item in parts for name, array in flattened(item, f"{prefix}.{key}").items()}


def rebuilt(kind: Any, entry: Entry, prefix: str = "") -> Any:
    """What `flattened` made `entry` of: a dataclass, or tuple, list or dictionary, of such, of arrays, numbers or text.

    Raises KeyError where a field without a default is missing.
    """
    origin, of = get_origin(kind), get_args(kind)
    if origin in (tuple, list, dict):
        names = dict.fromkeys(key[len(prefix) + 1 :].split(".")[0] for key in entry if key.startswith(f"{prefix}."))
        each = of if origin is tuple and Ellipsis not in of else repeat(of[origin is dict])
        made = {name: rebuilt(one, entry, f"{prefix}.{name}") for name, one in zip(names, each, strict=False)}
        return made if origin is dict else origin(made.values())
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        needed = {f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING}
        there = {key[len(prefix) + 1 :].split(".")[0] for key in entry if key.startswith(f"{prefix}.")}
        known = [f.name for f in fields(kind) if f.name in needed | there]
        return kind(**{name: rebuilt(hints[name], entry, f"{prefix}.{name}") for name in known})  # type: ignore[operator]
    either = next((one for one in of if is_dataclass(one)), None)
    if either is not None:
        return rebuilt(either, entry, prefix)
    return kind(entry[prefix].item()) if kind in (int, float, str, bool) else entry[prefix]
