"""Processes that several pieces of work share: each finds its own state, errors come back, nothing is left behind."""

import os
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context

import pytest

from ocp.shell import processes
from ocp.shell.processes import crew, interrupts_held_back, side_by_side, workers

state = ""


def become(name: str) -> None:
    global state
    state = name


def who(*more: int) -> tuple[str, int]:
    return state, os.getpid()


def divided(whole: float, part: float) -> float:
    return whole / part


def slow(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(processes, "_cores", 2)
    yield
    assert processes._crew.get() is None


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_every_piece_of_work_has_its_own_state_in_the_same_processes() -> None:
    with crew():
        found = []
        for name in ("first", "second", "first"):
            with workers(2, become, name) as pool:
                with interrupts_held_back():
                    found.append([pool.submit(who).result() for _ in range(4)])
        pids = {pid for one in found for _, pid in one}
        assert [{name for name, _ in one} for one in found] == [{"first"}, {"second"}, {"first"}]
        assert len(pids) <= 2 and os.getpid() not in pids
    assert not any(alive(pid) for pid in pids)


def test_one_inside_another_has_its_own_state_and_the_outer_one_goes_on() -> None:
    with crew(), workers(2, become, "outer") as outer, interrupts_held_back():
        assert outer.submit(who).result()[0] == "outer"
        with workers(2, become, "inner") as inner:
            assert inner.submit(who).result()[0] == "inner"
        assert outer.submit(who).result()[0] == "outer"


def test_results_come_in_order_with_a_crew_and_without() -> None:
    tasks = [(float(k),) for k in range(1, 9)]
    wanted = [12.0 / k for (k,) in tasks]
    with side_by_side(divided, tasks, 12.0) as here:
        assert list(here) == wanted
    with crew(), side_by_side(divided, tasks, 12.0) as there:
        assert list(there) == wanted


def test_an_error_is_raised_where_its_result_is_asked_for_and_the_crew_goes_on() -> None:
    with crew():
        with pytest.raises(ZeroDivisionError), side_by_side(divided, [(1.0,), (0.0,), (2.0,)], 12.0) as found:
            assert next(found) == 12.0
            next(found)
        with side_by_side(divided, [(1.0,), (2.0,)], 12.0) as found:
            assert list(found) == [12.0, 6.0]


def test_what_is_not_begun_when_a_block_fails_is_never_done() -> None:
    with crew():
        with pytest.raises(RuntimeError), workers(2, become, "late") as pool, interrupts_held_back():
            waiting = [pool.submit(slow, 0.2) for _ in range(40)]
            raise RuntimeError
        assert all(one.done() for one in waiting) and sum(one.cancelled() for one in waiting) > 30


def test_an_error_outside_a_block_ends_the_processes() -> None:
    with pytest.raises(RuntimeError), crew():
        with workers(2, become, "gone") as pool, interrupts_held_back():
            pid = pool.submit(slow, 0.0).result()
        raise RuntimeError
    assert not alive(pid)


def test_what_is_handed_out_is_done_when_its_block_ends() -> None:
    with crew():
        with workers(2, become, "asked") as pool, interrupts_held_back():
            waiting = [pool.submit(slow, 0.1) for _ in range(4)]
        assert all(one.done() for one in waiting)


def test_a_crew_inside_a_crew_is_the_same_one() -> None:
    def pids() -> set[int]:
        with workers(2, become, "") as pool, interrupts_held_back():
            return {one.result() for one in [pool.submit(slow, 0.2) for _ in range(4)]}

    with crew():
        outer = pids()
        with crew():
            assert pids() == outer
        assert pids() == outer


def test_threads_do_not_share_a_crew_or_its_state() -> None:
    """Two plans of the Python interface at once: each worked with the other's state where the crew was one for the process."""
    begun, meet = threading.Event(), threading.Barrier(2, timeout=60.0)

    def own(name: str) -> set[tuple[str, int]]:
        assert name == "one" or begun.wait(60.0)
        with crew():
            begun.set()
            with workers(2, become, name) as pool:
                meet.wait()
                with interrupts_held_back():
                    waiting = [pool.submit(who) for _ in range(6)]
                return {one.result() for one in waiting}

    with ThreadPoolExecutor(2) as threads:
        one, other = threads.map(own, ("one", "other"))
    assert {name for name, _ in one} == {"one"} and {name for name, _ in other} == {"other"}
    assert not {pid for _, pid in one} & {pid for _, pid in other}


def test_one_core_has_no_crew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_cores", 1)
    with crew(), side_by_side(who, [(1,), (2,)]) as found:
        assert {pid for _, pid in found} == {os.getpid()}


def test_crews_of_several_threads_leave_environment_and_script_as_they_were() -> None:
    def go() -> None:
        with crew("json"), side_by_side(divided, [(1.0,), (2.0,)], 2.0) as found:
            list(found)

    before, script = dict(os.environ), sys.modules["__main__"]
    for _ in range(3):
        threads = [threading.Thread(target=go) for _ in range(3)]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
        assert dict(os.environ) == before and sys.modules["__main__"] is script


def test_processes_that_are_ended_begin_nothing_else() -> None:
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), crew(), workers(2, become, "long") as pool:
        with interrupts_held_back():
            for _ in range(4):
                pool.submit(slow, 60.0)
        time.sleep(1.0)
        raise KeyboardInterrupt
    assert time.monotonic() - began < 30.0


def test_a_process_that_may_have_no_children_works_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_cores", None)
    with interrupts_held_back(), get_context("spawn").Pool(1) as pool:
        assert pool.apply(processes.cores) == 1
