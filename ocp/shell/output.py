"""Output folders that appear whole or not at all, and never take anything of the user's with them.

A folder is written beside its place and put there by one rename. A marker in it lists every file with its hash, so that a later
`--overwrite` replaces only what this software wrote and nobody changed since. One run at a time holds a folder; what a killed run
left beside it is put back or cleared away by the next one.
"""

import ctypes
import errno
import json
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

from filelock import FileLock, Timeout

from ocp.shell import processes
from robots.errors import BadInput, shown

LONGEST_NAME = 200  # bytes; file systems take 255, the temporary neighbour needs some
MARKER = ".written.json"
"""Name of the list of files, with their SHA-256, that a written folder holds."""
DIGITS = 64  # of a hash: of what is no regular file there is none, and no list can have it
# Of names: they stand in what is written, where a line break would begin a line of its own and what is no UTF-8 cannot stand.
UNTOLD = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EFBIG)  # a file's name seldom comes with these
OLD, NEW = "replaced", "unfinished"  # what stands beside a folder while it is written


class Output:
    """A folder that this run alone will write."""

    def __init__(self, named: Path, overwrite: bool, grows: bool) -> None:
        self.named, self.overwrite, self.grows = named, overwrite, grows
        self.folder = _resolved(named)
        self._inputs: set[Path] = set()
        self._seen: tuple[bool, bytes | None] = True, None

    def reads(self, files: Iterable[Path]) -> None:
        """Tell that the run reads these files or folders. Raises BadInput where one lies in the folder or is the folder."""
        for file in files:
            self._inputs |= {_resolved(file), _resolved(file.parent) / file.name}  # what a link leads to, and the link itself
        for file in sorted(self._inputs):
            if self.folder == file or self.folder in file.parents:
                what = "is itself" if self.folder == file else f"holds {file.relative_to(self.folder)},"
                raise BadInput(f"{self.named}: {what} an input of this run, which writing would delete; give another --out")

    def check(self) -> None:
        """Refuse what could not be written when the work is done. Raises BadInput with the reason."""
        if len(self.folder.name.encode()) > LONGEST_NAME:
            text = str(self.named)[:40]
            raise BadInput(f"--out {text}..: the name has {len(self.folder.name)} characters; give a shorter one")
        try:
            if self.folder.exists() and not self.folder.is_dir():
                raise BadInput(f"{self.named}: is a file, not a folder; give another --out")
            parent = self.folder.parent
            while not parent.exists():
                parent = parent.parent
        except OSError as error:
            do = "a shorter name" if error.errno == errno.ENAMETOOLONG else "another --out"
            raise BadInput(f"--out {str(self.named)[:40]}..: {error.strerror}; give {do}") from None
        if not parent.is_dir():
            raise BadInput(f"{self.named}: cannot be made, {parent} is a file; give another --out")
        for place in (parent, self.folder):
            if place.exists() and not os.access(place, os.W_OK | os.X_OK):
                raise BadInput(f"{self.named}: cannot be written, no permission in {place}; give another --out")
        self._refuse_no_place(parent)
        if not _empty(self.folder):
            if self.overwrite:
                self._refuse_losses()
            elif not self.grows:
                raise BadInput(f"{self.named}: exists and is not empty; give another --out, or --overwrite to replace it")
        self._seen = _state(self.folder)

    def _refuse_no_place(self, parent: Path) -> None:
        """Permissions do not tell all (/proc, a network's folder): whether a folder can be made there shows by making one."""
        try:
            tried = Path(tempfile.mkdtemp(prefix=_prefix(self.folder, NEW), dir=parent))
            with suppress(FileNotFoundError):  # another run that begins here clears away what has no owner
                tried.rmdir()
        except OSError as error:
            raise BadInput(f"{self.named}: cannot be written ({error.strerror}) in {parent}; give another --out") from None

    def _refuse_losses(self) -> None:
        for place in (Path.cwd(), Path.home()):
            if self.folder == place.resolve() or self.folder in place.resolve().parents:
                raise BadInput(f"{self.named}: holds the folder {place}, which --overwrite would delete; give another --out")
        self.reads(())
        users = users_file(self.folder)
        if users is not None:
            raise BadInput(f"{self.named}: --overwrite would delete {users}; give another --out, or move what is yours")

    @contextmanager
    def whole(self) -> Iterator[Path]:
        """A temporary folder beside the place that takes it when the block ends without an error.

        Whatever ends the block otherwise, the place is as it was. Raises BadInput where nothing can be written, and where what
        stands there has changed since the run began.
        """
        parent = self.folder.parent
        missing = [p for p in (parent, *parent.parents) if not p.exists()]
        try:
            parent.mkdir(parents=True, exist_ok=True)
            partial = Path(tempfile.mkdtemp(prefix=f"{_prefix(self.folder, NEW)}", dir=parent))
        except OSError as error:
            _remove_empty(missing)
            raise BadInput(f"{self.named}: cannot be written ({error.strerror}); give another --out") from None
        processes.clear_if_killed(partial)
        try:
            yield partial
            write_marker(partial)
            partial.chmod(0o755)
            processes.raise_if_told()
            processes.finish_undisturbed()
            self._put(partial)
        except OSError as error:
            if error.errno in NO_ROOM:
                raise BadInput(f"{self.named}: cannot be written ({error.strerror}), nothing is; give another --out") from None
            raise
        finally:
            if partial.exists() and (not (partial / MARKER).exists() or users_file(partial) is None):
                shutil.rmtree(partial, ignore_errors=True)
            _remove_empty(missing)

    @contextmanager
    def grown(self) -> Iterator[Path]:
        """The folder itself, emptied first where it is to be overwritten, for work that a later run goes on with; what is written
        there goes through `files_added`, so that a run killed at any moment leaves every file listed. One that fails before any
        is there leaves no folder."""
        if self.overwrite and not _empty(self.folder):
            self._refuse_losses()
            self._empty_out()
        missing = [p for p in (self.folder, *self.folder.parents) if not p.exists()]
        self.folder.mkdir(parents=True, exist_ok=True)
        processes.keeps_what_is_done()
        try:
            yield self.folder
        except BaseException:  # an interrupt too
            _remove_empty(missing)
            raise

    def _empty_out(self) -> None:
        """Take the folder away under the name of an unfinished one: killed while it is removed, the next run removes the rest."""
        aside = Path(tempfile.mkdtemp(prefix=_prefix(self.folder, NEW), dir=self.folder.parent))
        try:
            os.replace(self.folder, aside)
        except OSError:  # a mount point
            aside.rmdir()
            raise
        users = users_file(aside)  # written to between the last look and the renaming
        if users is not None:
            os.rename(aside, self.folder)
            raise BadInput(f"{self.named}: --overwrite would delete {users}; give another --out, or move what is yours")
        shutil.rmtree(aside)

    def _put(self, partial: Path) -> None:
        meanwhile = f"{self.named}: somebody else wrote there while this run worked, and that stays; give another --out"
        if _state(self.folder) != self._seen:
            raise BadInput(meanwhile)
        if _empty(self.folder):
            try:
                os.replace(partial, self.folder)  # takes the place of an empty folder, fails on one with files
            except OSError as error:
                raise BadInput(meanwhile) if error.errno in (errno.ENOTEMPTY, errno.EEXIST) else error from None
            return
        self.check()
        if _exchanged(partial, self.folder):
            users = users_file(partial)  # written to between the last look and the exchange
            if users is not None:
                _exchanged(partial, self.folder)
                raise BadInput(f"{self.named}: --overwrite would delete {users}; give another --out, or move what is yours")
            return
        old = Path(tempfile.mkdtemp(prefix=_prefix(self.folder, OLD), dir=self.folder.parent))
        try:
            os.rename(self.folder, old / "folder")
            os.rename(partial, self.folder)
        finally:
            _recover(self.folder)


@contextmanager
def reserved(folder: Path, overwrite: bool, inputs: Iterable[Path] = (), grows: bool = False) -> Iterator[Output]:
    """`folder` for this run alone: checked now, written later by `Output.whole`.

    Args:
        folder: where to write; a link is followed.
        overwrite: replace a folder that this software wrote and nobody changed since.
        inputs: files and folders that the run reads; more may be told by `Output.reads` before anything is written.
        grows: the folder may hold what an earlier run of the same kind began (`Output.grown`).

    Raises BadInput: another run writes there; the folder holds files and `overwrite` is false, or holds a file that is not this
    software's, an input, or the working folder; it is a file, has a name that is empty or too long, or cannot be written.
    """
    if str(folder) in ("", "."):
        raise BadInput("--out is empty or the working folder itself; give the name of a folder to write")
    output = Output(folder, overwrite, grows)
    name = sha256(os.fsencode(output.folder)).hexdigest()[:24]
    file = processes.temporary() / f"grindplan-{name}.lock"
    try:
        lock = _locked(file)
    except Timeout:
        raise BadInput(f"{folder}: another run is writing there; wait for it, or give another --out") from None
    except OSError as error:
        raise BadInput(f"temporary files cannot be written ({error.strerror}); free some space there, or set TMPDIR") from None
    try:
        _recover(output.folder)
        output.reads(inputs)
        output.check()
        yield output
    finally:
        _unlocked(lock, file)


@contextmanager
def files_added(folder: Path, last: str = "") -> Iterator[Path]:
    """A temporary folder whose files go into `folder` when the block ends without an error, by one rename each.

    The marker names them with their hashes before the first is renamed: whenever the run is killed, no file of its own stands
    there unlisted, and none that is listed is anybody else's. Several processes may add to one folder.

    Args:
        folder: that of `Output.grown`, or one made here.
        last: the file that says that the others are whole.

    Raises BadInput where a file that this software did not write, or that was changed since, stands in the way of one, and where
    no room is left.
    """
    folder = _resolved(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=_prefix(folder, NEW), dir=folder.parent))
    processes.clear_if_killed(part)
    try:
        yield part
        names = sorted(_names(part), key=lambda name: (name == last, name))
        with _marker_held(folder):
            listed = _listed(folder)
            _refuse_changed(folder, listed, names)
            _write_list(part, listed, {name: _hash(part / name) for name in names})
            folder.mkdir(exist_ok=True)
            for name in (MARKER, *names):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(part / name, folder / name)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise BadInput(f"{folder}: cannot be written ({error.strerror}); free some space there and call again") from None
        raise
    finally:
        shutil.rmtree(part, ignore_errors=True)


def add_text_file(folder: Path, name: str, text: str) -> None:
    """One file of text by `files_added`."""
    with files_added(folder) as part:
        (part / name).parent.mkdir(parents=True, exist_ok=True)
        (part / name).write_text(text, encoding="utf-8")


def remove_written(folder: Path, names: Iterable[str]) -> None:
    """Remove files of a folder that grows. Raises BadInput before any is removed where one is not as this software wrote it."""
    names = sorted(names)
    _refuse_changed(folder, _listed(folder), names)
    for name in names:
        (folder / name).unlink()


def as_written(file: Path, folder: Path) -> bool:
    """Whether a file of `folder` stands there and is as this software wrote it."""
    return file.is_file() and _listed(folder).get(file.relative_to(folder).as_posix()) == _hash(file)


def not_as_written(folder: Path, below: str) -> Path | None:
    """The first file of the folder `below` in `folder` that is gone, or not as this software wrote it; None where all stand."""
    listed = _listed(folder)
    return next((folder / n for n in listed if n.startswith(f"{below}/") and listed[n] != _hash(folder / n)), None)


def _refuse_changed(folder: Path, listed: dict[str, str], names: Iterable[str]) -> None:
    for name in names:
        file = folder / name
        if (file.exists() or file.is_symlink()) and listed.get(name) != _hash(file):
            raise BadInput(f"{file}: stands where this run writes and is not as this software wrote it; move it away")


@contextmanager
def _marker_held(folder: Path) -> Iterator[None]:
    """The marker of a folder for this process alone; waits for others."""
    file = processes.temporary() / f"grindplan-{sha256(os.fsencode(_resolved(folder))).hexdigest()[:24]}.marker.lock"
    lock = _locked(file, wait=-1)
    try:
        yield
    finally:
        _unlocked(lock, file)


def _locked(file: Path, wait: float = 0) -> FileLock:
    """A lock on `file`, waited for so many seconds (-1: for ever). Raises Timeout where another process or this one holds it.

    Whoever held it last may have removed the file after it was opened here: such a lock holds a file without a name, which the
    next process does not see, and is taken anew.
    """
    while True:
        lock = FileLock(file, timeout=wait)
        lock.acquire()
        if not hasattr(os, "fork"):  # files in use cannot be removed there
            return lock
        held = lock._context.lock_file_fd
        assert held is not None
        try:
            if os.path.samestat(os.fstat(held), file.stat()):
                return lock
        except FileNotFoundError:
            pass
        lock.release()


def _unlocked(lock: FileLock, file: Path) -> None:
    """Remove the locked file while it is still held, so that nobody else's is removed; then let go."""
    if hasattr(os, "fork"):
        file.unlink(missing_ok=True)
    lock.release()


def write_marker(folder: Path) -> None:
    """List a folder's files with their hashes in its marker. Raises OSError where it cannot be written."""
    _write_list(folder, {name: _hash(folder / name) for name in _names(folder)})


def _write_list(folder: Path, listed: dict[str, str], coming: dict[str, str] | None = None) -> None:
    """coming: hashes of files about to be put in their place; what stands there till then may be listed with another."""
    content = {"by": "grindplan", "sha256": listed} | ({"coming": coming} if coming else {})
    (folder / MARKER).write_text(json.dumps(content, indent=1), encoding="utf-8")


def users_file(folder: Path) -> str | None:
    """A file in `folder` that is not as this software wrote it, with the reason; None where all are."""
    listed, told = _listed(folder), (folder / MARKER).exists()
    if not listed:
        first = next(iter(_names(folder)), None)
        why = "which this software did not write" if told else f"and no {MARKER} tells that this software wrote it"
        return None if first is None else f"{first}, {why}"
    for name in _names(folder):
        if name not in listed:
            return f"{name}, which this software did not write"
        if _hash(folder / name) != listed[name]:
            return f"{name}, which was changed since it was written"
    return None


def _listed(folder: Path) -> dict[str, str]:
    """Files of a folder's marker with their hashes; of a coming one that of before where that still stands there."""
    try:
        told = json.loads((folder / MARKER).read_text(encoding="utf-8"))
        listed, coming = _hashes(told["sha256"]), _hashes(told.get("coming", {}))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    return listed | {name: new for name, new in coming.items() if name not in listed or _hash(folder / name) != listed[name]}


def _hashes(listed: dict[str, object]) -> dict[str, str]:
    return {name: value for name, value in listed.items() if isinstance(value, str) and len(value) == DIGITS}


def _names(folder: Path) -> list[str]:
    found = (Path(root) / name for root, _, names in os.walk(folder) for name in names)
    links = (Path(root) / name for root, names, _ in os.walk(folder) for name in names if (Path(root) / name).is_symlink())
    return sorted(p.relative_to(folder).as_posix() for p in (*found, *links) if p != folder / MARKER)


def _hash(file: Path) -> str:
    """SHA-256 of a regular file; of anything else its kind, which no list has."""
    if file.is_symlink() or not file.is_file():
        return "no regular file"
    try:
        return sha256(file.read_bytes()).hexdigest()
    except OSError:
        return "cannot be read"


def _state(folder: Path) -> tuple[bool, bytes | None]:
    """Whether a folder is empty, and its marker: another after every run that wrote there."""
    try:
        return _empty(folder), (folder / MARKER).read_bytes()
    except OSError:
        return _empty(folder), None


def _empty(folder: Path) -> bool:
    return not folder.exists() or not any(folder.iterdir())


def _resolved(path: Path) -> Path:
    if UNTOLD.search(str(path.absolute())):
        raise BadInput(f"{shown(path, 400)}: the name has a line break or another sign that files cannot tell; rename it")
    try:
        found = path.resolve()
        looped = any(os.path.islink(one) for one in (found, *found.parents))  # Python 3.13 leaves a link to itself as it is
    except (OSError, RuntimeError):  # which error depends on the release
        looped = True
    if looped:
        raise BadInput(f"{str(path)[:80]}: is a link that leads nowhere or to itself; give another path")
    return found


def _prefix(folder: Path, what: str) -> str:
    return f".{folder.name}.{what}."


def _recover(folder: Path) -> None:
    """Put back what a killed run had moved aside, and clear away what it had not finished."""
    if not folder.parent.is_dir():
        return
    for old in sorted(folder.parent.glob(f"{_glob(_prefix(folder, OLD))}*")):
        if not folder.exists() and (old / "folder").exists():
            os.rename(old / "folder", folder)
        if not (old / "folder").exists() or users_file(old / "folder") is None:
            shutil.rmtree(old, ignore_errors=True)
    for new in folder.parent.glob(f"{_glob(_prefix(folder, NEW))}*"):
        if not (new / MARKER).exists() or users_file(new) is None:
            shutil.rmtree(new, ignore_errors=True)


def _glob(text: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in text)


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders made on the way, innermost first, that hold nothing."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two folders in one step where the system can (Linux); else do nothing and return False."""
    if not sys.platform.startswith("linux"):
        return False
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    return rename is not None and rename(-100, os.fsencode(one), -100, os.fsencode(other), 2) == 0  # AT_FDCWD, RENAME_EXCHANGE


@contextmanager
def whole_folder(folder: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """`reserved` and `Output.whole` in one, for what is written at once."""
    with reserved(folder, overwrite, inputs) as output, output.whole() as partial:
        yield partial
