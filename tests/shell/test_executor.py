"""Tasks on many cores: in this process, in processes that the system ends, and on a Dask cluster that loses a worker."""

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path

import pytest

from ocp.plan.night import plan_night
from ocp.shell import executor
from ocp.shell.executor import Hands, WorkerEnded, carried_out, errand, files_under
from robots.errors import BadInput
from tests.support.hand_work import added, added_or_called, called, doubled, killed, killed_once, waited
from tests.support.house import ROOT


def test_one_job_works_in_this_process_and_two_in_others_with_what_they_were_given(every_core):
    here = {place: f.result() for place, f in carried_out(added, [(k,) for k in range(3)], Hands(1), (10,))}
    assert [here[k][0] for k in range(3)] == [10, 11, 12] and {one[2] for one in here.values()} == {os.getpid()}
    apart = {place: f.result() for place, f in carried_out(added, [(k,) for k in range(5)], Hands(2), (10,))}
    assert [apart[k][0] for k in range(5)] == [10, 11, 12, 13, 14]
    assert os.getpid() not in {one[2] for one in apart.values()} and {one[1] for one in apart.values()} == {os.cpu_count() // 2}


def test_a_process_is_renewed_after_some_tasks(monkeypatch):
    """What a library leaves behind in one does not add up over a thousand tasks."""
    monkeypatch.setattr(executor, "RENEWED", 2)
    done = {place: f.result() for place, f in carried_out(added, [(k,) for k in range(5)], Hands(1), (10,), apart=True)}
    assert [done[k][0] for k in range(5)] == [10, 11, 12, 13, 14]
    pids = [done[k][2] for k in range(5)]
    assert pids[0] == pids[1] != pids[2] == pids[3] != pids[4] and os.getpid() not in pids


def test_no_more_tasks_are_taken_than_are_worked_on():
    taken = []
    done = carried_out(added, ((taken.append(k) or k,) for k in range(100)), Hands(1), (0,))
    for _ in range(3):
        next(done)
    assert len(taken) == 3


def test_a_process_that_is_ended_takes_its_own_task_with_it_once(tmp_path):
    trace = str(tmp_path / "trace")
    tasks = [(killed_once, trace), (killed,), *[(added, 0, k, 0.05) for k in range(4)]]
    found = {place: f for place, f in carried_out(called, tasks, Hands(2))}
    assert found[0].result() == "done" and [found[k].result()[0] for k in range(2, 6)] == [0, 1, 2, 3]
    with pytest.raises(WorkerEnded, match="want of memory"):
        found[1].result()


@pytest.mark.parametrize("jobs", [1, 2])
def test_files_of_an_errand_come_with_it_and_go_back(tmp_path, jobs):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.txt").write_text("abc")
    (tmp_path / "other.txt").write_text("stays")
    tasks = [(doubled, files_under(tmp_path, "in", "nowhere"), name) for name in ("in/a.txt", "in/b.txt")]
    found = {place: f for place, f in carried_out(errand, tasks, Hands(jobs))}
    assert found[0].result() == (3, {"out/twice.txt": b"abcabc"})
    with pytest.raises(BadInput, match=r"^in/b\.txt: is not there"):
        found[1].result()


def test_a_cluster_plans_blades_of_a_cell_whose_files_lie_elsewhere(cluster, tmp_path, monkeypatch):
    """Here, beside the others that need a cluster: starting one takes as long as all of these tests."""
    monkeypatch.chdir(tmp_path)
    for name in ("cells", "robots", "far/blades"):
        Path(name).mkdir(parents=True)
    shutil.copy(ROOT / "robots" / "catalogue" / "kr210_r2700_extra.toml", "robots/arm.toml")
    text = (ROOT / "ocp" / "data" / "cell.toml").read_text().replace('"kr210_r2700_extra"', '"../robots/arm.toml"')
    Path("cells/cell.toml").write_text(text)
    blades = [Path(f"far/blades/{name}.stl") for name in "ab"]
    for blade in blades:
        blade.write_text("solid nothing\nendsolid\n")
    made = plan_night(blades, out="night", cell="cells/cell.toml", scheduler=cluster)
    assert [row["reason"] for row in made.rows] == [
        f"refused: {b}: holds no facet; export the blade as STL again." for b in blades
    ]
    asked = json.loads(Path("night/night.json").read_text())["asked"]
    assert set(asked["inputs"]) == {"cell/cells/cell.toml", "cell/robots/arm.toml"}
    Path("cells/cell.toml").write_text(text.replace("../robots/arm.toml", str(tmp_path / "robots" / "arm.toml")))
    with pytest.raises(BadInput, match="which other machines do not have"):
        plan_night(blades, out="away", cell="cells/cell.toml", scheduler=cluster)


def test_a_cluster_that_loses_a_worker_does_every_task(cluster, tmp_path):
    trace = tmp_path / "trace"
    tasks = [(waited, str(trace), 60.0), *[(k,) for k in range(6)], (len, bytes(12_000_000))]
    found = {}
    for place, future in carried_out(added_or_called, tasks, Hands(1, cluster), (10,)):
        found[place] = future.result()
        if len(found) == 1:
            while not trace.exists():
                time.sleep(0.02)
            lost = int(trace.read_text().split()[0])
            os.kill(lost, signal.SIGKILL)
    assert (
        found.pop(7) == 12_000_000
        and found.pop(0) == 2
        and [found[k + 1][:2] for k in range(6)] == [(10 + k, 1) for k in range(6)]
    )
    first, second = map(int, trace.read_text().split())
    assert first == lost and second != lost and second in {one[2] for one in found.values()}


def test_a_worker_of_another_version_does_no_task(cluster, monkeypatch):
    monkeypatch.setattr(executor, "code_hash", lambda: "another")
    ((_, future),) = carried_out(added, [(0, 1)], Hands(1, cluster))
    with pytest.raises(BadInput, match=r"^the worker on .* runs another version of this software"):
        future.result()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x:1"])
def test_a_scheduler_that_does_not_answer_is_one_sentence(monkeypatch, address):
    pytest.importorskip("distributed", reason="pip install '.[cluster]'")
    monkeypatch.setattr(executor, "CONNECT", 1)
    with pytest.raises(BadInput, match=rf"^--scheduler {address}: no Dask scheduler with a worker answers"):
        next(carried_out(added, [(1,)], Hands(1, address)))


@pytest.mark.parametrize("address", ["", "foo", "tcp://host", "a b:1"])
def test_what_is_no_address_is_refused_before_the_work_begins(address):
    with pytest.raises(BadInput, match=rf"^--scheduler '{address}' is no address"):
        Hands(1, address)


@pytest.mark.parametrize("address", ["tcp://host:8786", "10.0.0.2:8786", "tls://[fe80::1%eth0]:8786/"])
def test_an_address_is_one_with_or_without_a_protocol(address):
    assert Hands(1, address).scheduler == address


def test_a_missing_package_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match="needs the package distributed: pip install"):
        next(carried_out(added, [(1,)], Hands(1, "tcp://127.0.0.1:9")))
