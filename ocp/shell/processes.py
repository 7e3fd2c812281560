"""Processes that end when they should: a command's own at Ctrl-C, at once and without a trace, its workers with their parent.

A command's work runs in a child process. Its parent does nothing but wait, so that an interrupt is never swallowed by a library
that is busy or in a callback: the child is asked to end and given a moment for it, then it is ended, and what it left
unfinished is removed. Where a process cannot be forked the work runs in place, with Python's own Ctrl-C. Worker processes share
a large read-only state and leave interrupts to their parent.
"""

import gc
import os
import pickle
import select
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import import_module
from multiprocessing import current_process, forkserver, get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, NoReturn

INTERRUPTED = 130
# Objects made since the last look for circles of them, 700 by default: a command makes millions that live to its end, and looked
# for a tenth of its time.
COLLECTED_FROM = 50_000
MOMENT = 1.2  # s, for a child that was asked to end
CLEARED = 0.5  # s, for what a worker that is ended does on its way out
_temporary: str | None = None
_told = threading.Event()
_to_parent: int | None = None
_cores: int | None = None  # that this process was given, where it is one of several
_grows = False
_lent = threading.RLock()  # the environment and `__main__` while something stands in their place: they are all threads'
_crew: "ContextVar[_Crew | None]" = ContextVar("crew", default=None)  # the processes of the block that is open in this thread
_given: dict[Callable[..., None], str] = {}  # in one of them: the file of the state that each start was last given
_GROWS, _SAID = b"\1", b"\2"  # among the folders that a child tells of


def collect_seldom() -> None:
    """For a process that ends when its work does: look for unreachable circles of objects seldom."""
    gc.set_threshold(COLLECTED_FROM, 20, 20)


def was_told() -> bool:
    """Whether an interrupt has come, even if something in between has swallowed it."""
    return _told.is_set()


def raise_if_told() -> None:
    """Raise KeyboardInterrupt where an interrupt has come."""
    if was_told():
        raise KeyboardInterrupt


def temporary() -> Path:
    """The system's folder of temporary files, also where a command's own lie in a folder that is removed with it."""
    return Path(_temporary or tempfile.gettempdir())


def clear_if_killed(folder: Path) -> None:
    """Have `folder` removed if this command is killed before it ends."""
    if _to_parent is not None:
        os.write(_to_parent, os.fsencode(folder) + b"\0")


def finish_undisturbed() -> None:
    """From here on this command ends by itself: the result is being put in its place, an interrupt comes too late.

    If it is killed all the same, its parent removes nothing: what `clear_if_killed` named may by then be what stood there before.
    """
    if _to_parent is not None:
        os.write(_to_parent, b"\0\0")
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def keeps_what_is_done() -> None:
    """Say that what this command has written so far stays when it is interrupted, and the next run goes on from there."""
    global _grows
    _grows = True
    if _to_parent is not None:
        os.write(_to_parent, _GROWS + b"\0")


def sentence_is_told() -> None:
    """Say that the user has this command's last sentence: if it is killed on its way out, its parent does not tell it again."""
    if _to_parent is not None:
        os.write(_to_parent, _SAID + b"\0")


def what_stands(grows: bool | None = None) -> str:
    """What an interrupted command leaves, in words for its last sentence; `grows`: as its process told."""
    kept = "what is done is kept, the same command goes on from there"
    return kept if (_grows if grows is None else grows) else "nothing written"


def supervised(work: Callable[[], int], told: Callable[[str], None]) -> int:
    """Run `work` so that SIGINT and SIGTERM end it within two seconds, a second one at once.

    Args:
        work: returns the exit code; called in a child process where the system can fork.
        told: is given the sentence for the user where the child could not say it itself.

    Returns:
        The exit code of `work`; 130 where it was interrupted; 1 where its process was ended by the system.
    """
    if not hasattr(os, "fork"):
        return work()
    _occupy_streams()
    global _temporary
    try:
        _temporary = tempfile.gettempdir()
        scratch = tempfile.mkdtemp(prefix="grindplan-")
    except OSError as error:
        told(f"refused: temporary files cannot be written ({error.strerror}); free some space there, or set TMPDIR")
        return 2
    try:
        status, unfinished, asked = _watched(work, scratch)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:
        return code
    grows, said = (os.fsdecode(mark) in unfinished for mark in (_GROWS, _SAID))
    stands = what_stands(grows)
    for folder in unfinished:
        if folder not in (os.fsdecode(_GROWS), os.fsdecode(_SAID)):
            shutil.rmtree(folder, ignore_errors=True)
    if asked:
        if not said:
            told(f"interrupted, {stands}")
        return INTERRUPTED
    told(f"ended by the system (signal {-code}, often want of memory), {stands}; try again, or with a smaller input")
    return 1


def _watched(work: Callable[[], int], scratch: str) -> tuple[int, list[str], bool]:
    """Run `work` in a child; its status, the folders to remove if it was killed, and whether an interrupt came."""
    from_child, to_parent = os.pipe()
    alive, ours = os.pipe()  # its end tells the child that its parent is gone
    asked: list[float] = []
    child = 0

    def ask(_signal: int, _frame: FrameType | None) -> None:
        asked.append(time.monotonic())
        if child:
            _send(child, signal.SIGTERM if len(asked) == 1 else signal.SIGKILL)

    def pause(_signal: int, _frame: FrameType | None) -> None:
        _send(child, signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)
        _send(child, signal.SIGCONT)

    handlers = {signal.SIGINT: ask, signal.SIGTERM: ask, signal.SIGTSTP: pause}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    _flush()
    child = os.fork()
    if child == 0:
        os.close(from_child)
        os.close(ours)
        _child(work, to_parent, alive, scratch, bool(asked))
    os.close(to_parent)
    os.close(alive)
    try:
        os.setpgid(child, child)  # as the child does itself, whoever comes first
    except OSError:
        pass
    if asked:
        _send(child, signal.SIGTERM)
    try:
        status, said = _ended(child, from_child, asked)
    finally:
        _send(child, signal.SIGKILL)  # what the child may have left running
        for number, old in before.items():
            signal.signal(number, signal.SIG_IGN if asked else old)  # a further Ctrl-C must not change the exit code
        os.close(from_child)
        os.close(ours)
    return status, [os.fsdecode(f) for f in said.rpartition(b"\0\0")[2].split(b"\0") if f], bool(asked)


def _child(work: Callable[[], int], to_parent: int, alive: int, scratch: str, asked: bool) -> NoReturn:
    global _to_parent
    _to_parent = to_parent
    tempfile.tempdir = scratch
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal tells all processes, the parent decides
    signal.signal(signal.SIGTERM, _tell)
    signal.signal(signal.SIGTSTP, signal.SIG_DFL)
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # a terminal set to stop what writes from the background stops no command
    threading.Thread(target=_end_with_parent, args=(alive, scratch), daemon=True).start()
    code = 1
    try:
        if asked:
            raise KeyboardInterrupt
        code = work()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        _flush()
        os._exit(code)


def _occupy_streams() -> None:
    """Where a command is started with its input, output or errors closed, nothing that it opens may take their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:  # closed from the start
                stream.flush()
        except OSError:  # nobody reads any more
            pass


def _tell(_signal: int, _frame: FrameType | None) -> None:
    _told.set()
    raise KeyboardInterrupt


def _end_with_parent(alive: int, scratch: str) -> None:
    """What a killed parent would have done: end every process, then remove the temporary files.

    In this order, and so by a process that is none of them: work that finds its files gone would tell that as an error.
    """
    select.select([alive], [], [])
    steps = 'kill -s KILL -- "-$1" 2>&-; rm -rf -- "$2" 2>&-'
    try:
        os.posix_spawn("/bin/sh", ["sh", "-c", steps, "sh", str(os.getpgrp()), scratch], os.environ, setpgroup=0)
    except OSError:  # no shell, no memory: rather a complaint than files that stay
        shutil.rmtree(scratch, ignore_errors=True)
    finally:
        os.killpg(0, signal.SIGKILL)


def _send(child: int, number: int) -> None:
    """To a child that ends itself in order, or to it and all its processes; none where it is gone."""
    try:
        if number == signal.SIGTERM:
            os.kill(child, number)
        else:
            os.killpg(child, number)
    except (ProcessLookupError, PermissionError):
        pass


def _ended(child: int, from_child: int, asked: list[float]) -> tuple[int, bytes]:
    """Wait for the child; once it was asked to end, no longer than a moment. Returns its status and what it has told."""
    told, listening = b"", True
    while True:
        if listening and select.select([from_child], [], [], 0.1)[0]:
            part = os.read(from_child, 65536)
            told, listening = told + part, bool(part)
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status, told
        if asked and time.monotonic() - asked[0] > MOMENT:
            _send(child, signal.SIGKILL)
        if not listening:
            time.sleep(0.005)


@contextmanager
def workers(jobs: int, start: Callable[..., None], *state: Any, share: int = 1) -> Iterator[Executor]:
    """A pool of `jobs` processes, each of which has called `start(*state)` before it works and may use `share` cores itself.

    The state travels by file: a worker that dies while starting would otherwise block its parent on a full pipe. Where
    the block ends with an error or an interrupt, the workers are ended at once; their temporary files go with the pool. Inside
    a `crew` its processes do the work, and go on to what comes after.
    """
    own = _crew.get()
    if own is not None and share == 1:
        with own.given(start, *state) as pool:
            yield pool
        return
    with _pool(jobs, (start.__module__,), start, *state, share=share) as pool:
        yield pool


@contextmanager
def crew(*modules: str) -> Iterator[None]:
    """One process for each core, which the `workers` of the block share; they import `modules` while this process begins alone.
    None where there is one core; each thread has its own."""
    if cores() < 2 or _crew.get() is not None:
        yield
        return
    with _pool(cores(), modules, _import, *modules) as pool:
        if not _forked(pool):  # they import now, not at their first task
            with interrupts_held_back():
                for _ in range(cores()):
                    pool.submit(nothing)  # a pool starts a process at a task that no idle one takes
        before = _crew.set(_Crew(pool))
        try:
            yield
        finally:
            _crew.reset(before)


@contextmanager
def _pool(
    jobs: int, modules: Sequence[str], start: Callable[..., None], *state: Any, share: int = 1
) -> Iterator[ProcessPoolExecutor]:
    context = _context(modules)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state.pickle"
        with file.open("wb") as open_file:
            with _lent:
                pickle.dump((dict(os.environ), str(temporary()), share), open_file)
            pickle.dump((start, state), open_file)
        pool = ProcessPoolExecutor(jobs, context, _start, (str(file),))
        try:
            yield pool
        except BaseException:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _context(modules: Sequence[str]) -> BaseContext:
    """How processes are made. On Linux they are forked off one that imports `modules` once, while this process goes on; it has
    one thread and ends with those that it served. Elsewhere, where its socket's name would be too long, or where it would not
    hear where to import from, each begins anew."""
    if sys.platform != "linux" or (sys.flags.ignore_environment and not sys.flags.safe_path):
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(list(modules))
    # It would look in the working folder first, this process may not: what is imported has to be the same.
    paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
    with _lent:
        before = {name: os.environ.get(name) for name in ("PYTHONPATH", "PYTHONSAFEPATH")}
        os.environ.update({"PYTHONPATH": paths, "PYTHONSAFEPATH": "1"})
        try:
            with interrupts_held_back():
                forkserver.ensure_running()
        except OSError:
            return get_context("spawn")
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
    return context


def _forked(pool: ProcessPoolExecutor) -> bool:
    """Whether one is forked, and waits until what they are forked off has imported."""
    return bool(pool._mp_context.get_start_method() == "forkserver")  # type: ignore[union-attr]


class _Crew(Executor):
    """A pool whose processes get another state for every piece of work that is given to them; what another `start` was given
    stays as it is meanwhile."""

    def __init__(self, pool: Executor) -> None:
        self._pool, self._state, self._start, self._open = pool, "", nothing, set[Future[Any]]()

    @contextmanager
    def given(self, start: Callable[..., None], *state: Any) -> Iterator[Executor]:
        """The pool with this state; what is still to be done of it when the block ends is not begun."""
        before = self._state, self._start, self._open
        with tempfile.TemporaryDirectory() as folder:
            self._state, self._start, self._open = str(Path(folder) / "state.pickle"), start, set()
            Path(self._state).write_bytes(pickle.dumps(state))
            try:
                yield self
                wait_for(self._open)
            except Exception:
                for future in self._open:
                    future.cancel()
                wait_for(self._open)
                raise
            finally:
                self._state, self._start, self._open = before

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        future = self._pool.submit(_in_state, self._state, self._start, work, *arguments, **named)
        self._open.add(future)
        return future


@contextmanager
def side_by_side(work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], *shared: Any) -> Iterator[Iterator[Any]]:
    """The results of `work(*shared, *task)` of every task, in their order: by the crew where there is one, from now on, else
    here, each when it is asked for. Raises what the work raises, there."""
    if _crew.get() is None or len(tasks) < 2:
        yield (work(*shared, *task) for task in tasks)
        return
    with workers(cores(), hold, *shared) as pool:
        with interrupts_held_back():
            futures = [pool.submit(with_held, work, *task) for task in tasks]
        yield (future.result() for future in futures)


_held: tuple[Any, ...] = ()


def hold(*shared: Any) -> None:
    """The `start` of workers whose tasks begin with the same arguments."""
    global _held
    _held = shared


def with_held(work: Callable[..., Any], *task: Any) -> Any:
    """`work` of what this process holds and the task's own arguments."""
    return work(*_held, *task)


def _in_state(file: str, start: Callable[..., None], work: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    if _given.get(start) != file:
        start(*pickle.loads(Path(file).read_bytes()))
        _given[start] = file
    return work(*arguments, **named)


def _import(*modules: str) -> None:
    for name in modules:
        import_module(name)
    gc.freeze()  # what was imported stays


def warmed(module: str) -> None:
    """The `start` of a worker that imports `module` and calls its `warm_up`, for which nobody waits; ended meanwhile it ends at
    once: an import that is broken off by an exception tells of a broken library."""
    import_module(module).warm_up()
    gc.freeze()  # what was imported stays: looking through it for garbage again and again takes a tenth of the drawing


def _start(file: str) -> None:
    collect_seldom()
    threading.Thread(target=_end_with_spawner, daemon=True).start()
    global _temporary
    tempfile.tempdir = str(Path(file).parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with open(file, "rb") as open_file:
        environment, _temporary, share = pickle.load(open_file)
        os.environ.clear()
        os.environ.update(environment)
        keep_to(share)
        start, state = pickle.load(open_file)
    start(*state)
    signal.signal(signal.SIGTERM, _end_soon)


def _end_soon(_signal: int, _frame: FrameType | None) -> NoReturn:
    """Ended early, a worker still removes the temporary files of what it was doing, but begins nothing else."""
    end = threading.Timer(CLEARED, os._exit, (143,))
    end.daemon = True
    end.start()
    sys.exit(143)


def _end_with_spawner() -> None:
    """End this process when its parent's end of their pipe closes, however that ended: work for nobody is no work."""
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(143)


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """While work is handed out (that is when workers are spawned) new processes learn to ignore Ctrl-C.

    The disposition is inherited; the parent's own is put back at the end of the block. Nor do new processes import the script
    that called: it may have no guard against being run again, or no file at all, and no work of ours is defined there.
    """
    with _lent:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            if threading.current_thread() is not threading.main_thread():
                yield
                return
            before = signal.signal(signal.SIGINT, signal.SIG_IGN)
            try:
                yield
            finally:
                signal.signal(signal.SIGINT, before)
        finally:
            sys.modules["__main__"] = script


def keep_to(share: int) -> None:
    """Have `cores` return `share` in this process: it is one of several."""
    global _cores
    _cores = share


def cores() -> int:
    """Processes worth starting: cores that this process may use, at most eight; in a worker those that it was given; one where
    Python lets a process have no children (that of a `multiprocessing.Pool`)."""
    if _cores is not None or current_process().daemon:
        return _cores or 1
    return min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


def nothing() -> None:
    """The `start` of workers that need no state."""
