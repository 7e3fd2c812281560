"""Many tasks on many cores: processes of this machine, or the workers of a Dask cluster; and work whose files travel with it.

`carried_out` is the one way in which a command spreads tasks that know nothing of each other. An `errand` is a task with files:
what it reads comes with it and what it writes goes back, so that it may be done on a machine that shares no disk with this one.
"""

import os
import pickle
import platform
import re
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

from ocp.shell.cache import code_hash
from ocp.shell.processes import cores, hold, interrupts_held_back, keep_to, with_held, workers
from robots.errors import BadInput, Infeasible, shown

RENEWED = 10  # tasks of a process, then a new one takes its place: a plan leaves 5 to 20 MB behind in its process
CONNECT = 10  # s, for a scheduler to answer and to have a worker
ADDRESS = re.compile(r"(\w+://)?([^\s/:]+|\[[\da-fA-F:.]+(%\w+)?\]):\d+/?")  # of a Dask scheduler; without a protocol it is tcp
AHEAD = 2  # tasks a thread of the cluster that are on their way
OTHER_VERSION = "{} runs another version of this software, or has none; install there what runs here, and start it again"
Files = dict[str, bytes]
"""Contents of files by their names relative to a folder."""


@dataclass(frozen=True)
class Hands:
    """Who works on tasks: `jobs` processes of this machine, or the workers of a Dask `scheduler` (its address)."""

    jobs: int
    scheduler: str | None = None

    def __post_init__(self) -> None:
        """Raises BadInput: no address, which is told before the work begins, not when somebody is to be called."""
        if self.scheduler is not None and not ADDRESS.fullmatch(self.scheduler):
            raise BadInput(f"--scheduler '{shown(self.scheduler)}' is no address like tcp://host:8786; give one or leave it out")


class WorkerEnded(Infeasible):
    """The process that worked on a task was ended by the system, each time."""


class _Crew(Protocol):
    """Where tasks are worked on; `tries` of one whose process is lost."""

    tries: int

    def room(self, flying: int) -> bool:
        """Whether one more than `flying` tasks can be taken."""

    def submit(self, work: Callable[..., Any], task: tuple[Any, ...]) -> "Future[Any]":
        """Have a task worked on."""

    def done(self, future: "Future[Any]") -> bool:
        """Told of a task that has ended; whether its process was lost. Raises Infeasible where all processes are."""


def carried_out(
    work: Callable[..., Any], tasks: Iterable[tuple[Any, ...]], hands: Hands, shared: tuple[Any, ...] = (), apart: bool = False
) -> Iterator[tuple[int, "Future[Any]"]]:
    """`work(*shared, *task)` of every task: its place and its future, finished, as they end.

    Only as many tasks are taken as can be worked on, so that the inputs of a thousand need no more memory than those of ten. A
    process that the system ends takes its own task with it and no other; the task is tried once more, then its future raises
    WorkerEnded.

    Args:
        work: a function of this software's, found by its name where the task is done.
        tasks: its last arguments.
        hands: where it is done; one job is done in this process itself unless it is to be `apart`.
        shared: its first arguments, which travel once to every process.

    Raises BadInput: no scheduler answers there.
    """
    with _crew(hands, shared, apart) as crew:
        waiting, again = iter(enumerate(tasks)), deque[tuple[int, tuple[Any, ...], int]]()
        flying: dict[Future[Any], tuple[int, tuple[Any, ...], int]] = {}
        while True:
            while crew.room(len(flying)):
                one = again.popleft() if again else next(((*found, 1) for found in waiting), None)
                if one is None:
                    break
                flying[crew.submit(work, one[1])] = one
            if not flying:
                return
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                place, task, tries = flying.pop(future)
                if not crew.done(future):
                    yield place, future
                elif tries < crew.tries:
                    again.append((place, task, tries + 1))
                else:
                    yield place, _given_up()


def _given_up() -> "Future[Any]":
    future: Future[Any] = Future()
    future.set_exception(WorkerEnded("the system ended the process that worked on it, again and again, often for want of memory"))
    return future


def _crew(hands: Hands, shared: tuple[Any, ...], apart: bool) -> AbstractContextManager[_Crew]:
    if hands.scheduler is not None:
        return _cluster(hands.scheduler, shared)
    if not apart and hands.jobs <= 1:
        return nullcontext(_Here(shared))
    share = max(1, cores() // hands.jobs)
    return _Processes(hands.jobs, lambda: workers(1, hold, *shared, share=share))


class _Here:
    """This process itself."""

    tries = 1

    def __init__(self, shared: tuple[Any, ...]) -> None:
        self._shared = shared

    def room(self, flying: int) -> bool:
        return flying == 0

    def submit(self, work: Callable[..., Any], task: tuple[Any, ...]) -> "Future[Any]":
        future: Future[Any] = Future()
        try:
            future.set_result(work(*self._shared, *task))
        except Exception as error:
            future.set_exception(error)
        return future

    def done(self, _future: "Future[Any]") -> bool:
        return False


class _Processes:
    """Pools of one process each: one that is ended breaks its own pool only, and it is known what it was working on."""

    tries = 2

    def __init__(self, jobs: int, make: Callable[[], AbstractContextManager[Executor]]) -> None:
        self._jobs, self._make = jobs, make
        self._idle: list[tuple[ExitStack, Executor, int]] = []
        self.busy: dict[Future[Any], tuple[ExitStack, Executor, int]] = {}

    def room(self, flying: int) -> bool:
        return flying < self._jobs

    def submit(self, work: Callable[..., Any], task: tuple[Any, ...]) -> "Future[Any]":
        if not self._idle:
            stack = ExitStack()
            self._idle.append((stack, stack.enter_context(self._make()), 0))
        stack, pool, tasks = self._idle.pop()
        with interrupts_held_back():
            future = pool.submit(with_held, work, *task)
        self.busy[future] = stack, pool, tasks + 1
        return future

    def done(self, future: "Future[Any]") -> bool:
        stack, pool, tasks = self.busy.pop(future)
        lost = isinstance(future.exception(), BrokenProcessPool)
        if lost or tasks >= RENEWED:
            stack.close()
        else:
            self._idle.append((stack, pool, tasks))
        return lost

    def __enter__(self) -> "_Processes":
        return self

    def __exit__(self, *error: Any) -> None:
        for stack, _, _ in (*self._idle, *self.busy.values()):
            stack.__exit__(*error)


class _Cluster:
    """The workers of a Dask scheduler. What they need beside the task itself travels once to each; a task whose worker is lost is
    given to another one by the scheduler, thrice as it comes."""

    tries = 1

    def __init__(self, client: Any, shared: tuple[Any, ...]) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)
        bundle = pickle.dumps(shared)
        # As a task's result it comes into being anew where the worker that held it is lost.
        self._bundle = client.submit(bytes, bundle, pure=False)
        self._name, self._code = sha256(bundle).hexdigest(), code_hash()

    def room(self, flying: int) -> bool:
        return flying < AHEAD * max(sum(self._client.nthreads().values()), 1)

    def submit(self, work: Callable[..., Any], task: tuple[Any, ...]) -> "Future[Any]":
        future: Future[Any] = self._executor.submit(_on_worker, self._code, self._name, self._bundle, work, task)
        return future

    def done(self, future: "Future[Any]") -> bool:
        from distributed import KilledWorker

        try:
            error = future.exception()
        except CancelledError:
            raise Infeasible("the Dask scheduler is gone; what is done is kept, the same command goes on from there") from None
        if isinstance(error, ImportError) or (isinstance(error, RuntimeError) and "deserialization" in str(error)):
            raise BadInput(OTHER_VERSION.format("the Dask scheduler or a worker of it"))
        return isinstance(error, KilledWorker)


@contextmanager
def _cluster(address: str, shared: tuple[Any, ...]) -> Iterator[_Crew]:
    try:
        import dask
        from distributed import Client
    except ImportError:
        raise BadInput("--scheduler needs the package distributed: pip install 'grindplan[cluster]'") from None
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"}))  # a blade has megabytes
        try:
            client = stack.enter_context(Client(address, timeout=CONNECT, set_as_default=False))
            client.wait_for_workers(1, timeout=CONNECT)
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())[:120] or "no answer"
            raise BadInput(
                f"--scheduler {address}: no Dask scheduler with a worker answers there within {CONNECT} s ({reason}); start dask "
                "scheduler, and dask worker where this software is installed"
            ) from None
        yield _Cluster(client, shared)


_one_at_a_time = threading.Lock()  # a worker of several threads: what this software keeps in a process is for one task
_started = ""


def _on_worker(code: str, name: str, bundle: bytes, work: Callable[..., Any], task: tuple[Any, ...]) -> Any:
    """A task on a Dask worker; `name` of what it shares with others, held there already but for the first."""
    global _started
    if code != code_hash():
        raise BadInput(OTHER_VERSION.format(f"the worker on {platform.node()}"))
    with _one_at_a_time:
        keep_to(1)
        if _started != name:
            hold(*pickle.loads(bundle))
            _started = name
        return with_held(work, *task)


def files_under(folder: Path, *names: str) -> Files:
    """The files of those names in a folder, or in folders of those names below it; without names all of it. A name that is not
    there is left out."""
    found: Files = {}
    for place in [folder / name for name in names] or [folder]:
        for file in [place] if place.is_file() else sorted(place.rglob("*")):
            if file.is_file():
                found[file.relative_to(folder).as_posix()] = file.read_bytes()
    return found


def lay(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files into a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def named_below(folder: Path, sentence: str) -> str:
    """A sentence with the files below `folder` named relative to it."""
    return sentence.replace(f"{folder}{os.sep}", "")


def errand(work: Callable[..., Any], files: Files, *arguments: Any) -> tuple[Any, Files]:
    """What `work(folder, *arguments)` returns and the files that it adds, in a temporary folder that holds `files`.

    Raises what `work` does; sentences for the user name files relative to that folder.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lay(files, folder)
        try:
            result = work(folder, *arguments)
        except (BadInput, Infeasible) as error:
            error.args = tuple(named_below(folder, str(part)) for part in error.args)
            raise
        return result, {name: content for name, content in files_under(folder).items() if files.get(name) != content}
