"""A command ends within two seconds of Ctrl-C whatever it is doing, with nothing half there and no process left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ocp.shell.output import MARKER
from ocp.shell.processes import _end_with_parent
from tests.support.house import ROOT

COMMAND = """
import sys, time
from pathlib import Path
import typer
from ocp.shell.command import main, run
from ocp.shell.output import reserved
from ocp.shell.processes import workers, nothing
app = typer.Typer()

def swallow():
    until = time.monotonic() + 60
    while time.monotonic() < until:
        try:
            print("busy", flush=True)
            time.sleep(60)
        except BaseException:  # as a library's callback does
            pass

def deaf():
    import ctypes
    print("busy", flush=True)
    ctypes.PyDLL(None).sleep(60)  # a foreign call that keeps the interpreter to itself

def spawned():
    with workers(2, nothing) as pool:
        waiting = [pool.submit(time.sleep, 60) for _ in range(2)]
        time.sleep(1.5)
        print("busy", flush=True)
        [w.result() for w in waiting]

def polite():
    print("busy", flush=True)
    time.sleep(60)

def writing():
    import tempfile  # numbers pass through temporary files all the time, as they do between the processes of a check
    for k in range(6000):
        Path(tempfile.gettempdir(), f"kept{k}").touch()
    print("busy", flush=True)
    while True:
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "numbers").write_text("1")
            Path(folder, "numbers").read_text()

def lingering():
    # A slow machine: the sentence is told, the way out takes longer than the parent waits.
    from ocp.shell import processes
    processes._flush = lambda: time.sleep(60)
    polite()

def masked():
    try:
        polite()
    except KeyboardInterrupt:
        raise ValueError("a writer's own error in its place") from None

def exchanged():
    # The user writes into the old folder just after it was exchanged for the new one; then the machine is slow.
    from ocp.shell import output
    real = output._exchanged
    def slow(one, other):
        done = real(one, other)
        (one / "notes.txt").write_text("an afternoon of readings")
        swallow()
        return done
    output._exchanged = slow

def late():
    # The interrupt comes when everything is in its place.
    from ocp.shell import output
    real = output.Output._put
    def put(self, partial):
        real(self, partial)
        print("busy", flush=True)
        time.sleep(0.5)
    output.Output._put = put

def crash():
    import ctypes
    ctypes.string_at(0)

def finish():
    pass

@app.command()
def command(what: str, out: Path):
    if what == "loaded":  # what a command imports before its job begins, and what the interrupt leaves half loaded
        masked()

    def job():
        if what.startswith("grown-"):
            with reserved(out, False, grows=True) as output, output.grown():
                globals()[what.removeprefix("grown-")]()
        with reserved(out, True) as output, output.whole() as folder:
            (folder / "a.txt").write_text("half")
            globals()[what]()
            (folder / "b.txt").write_text("whole")
        return "done"
    sys.exit(run(job))

if __name__ == "__main__":
    main(app)
"""


@pytest.fixture
def script(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """In a folder of a short name, as the socket of what others are forked off needs one, or of the name asked for."""
    file = tmp_path_factory.mktemp(getattr(request, "param", "command")) / "command.py"
    file.write_text(COMMAND)
    return file


def started(script: Path, what: str, out: Path, **kind: object) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(script.parent / "tmp")}
    (script.parent / "tmp").mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, str(script), what, str(out)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **kind,  # type: ignore[call-overload]
    )


def processes(session: int) -> list[int]:
    """Processes of a session, read from /proc."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[3]) == session and fields[0] != "Z":
                found.append(int(entry.name))
    return found


WAYS = [
    *((what, "parent") for what in ("polite", "swallow", "lingering", "masked", "loaded")),
    *((what, "group") for what in ("deaf", "spawned")),
]


@pytest.mark.parametrize(("what", "told"), WAYS)
def test_an_interrupt_ends_a_command_and_leaves_nothing(script, tmp_path, what, told):
    out = tmp_path / "far" / "out"
    process = started(script, what, out)
    assert process.stdout.readline() == "busy\n"
    begin = time.monotonic()
    (os.kill if told == "parent" else os.killpg)(process.pid, signal.SIGINT)
    text = process.communicate(timeout=20)[1]
    assert process.returncode == 130 and time.monotonic() - begin < 2.0
    assert text == "interrupted, nothing written\n"
    assert processes(process.pid) == []
    assert not out.exists() and list((script.parent / "tmp").glob("*/*")) == [] and not list(out.parent.glob(".*"))


@pytest.mark.parametrize("script", ["long" * 20], indirect=True)
def test_processes_that_begin_anew_end_as_those_that_are_forked(script, tmp_path):
    test_an_interrupt_ends_a_command_and_leaves_nothing(script, tmp_path, "spawned", "group")


@pytest.mark.parametrize("what", ["grown-polite", "grown-deaf"])
def test_an_interrupted_command_whose_folder_grows_says_that_what_is_done_is_kept(script, tmp_path, what):
    process = started(script, what, tmp_path / "out")
    assert process.stdout.readline() == "busy\n"
    os.kill(process.pid, signal.SIGINT)
    text = process.communicate(timeout=20)[1]
    assert process.returncode == 130 and text == "interrupted, what is done is kept, the same command goes on from there\n"


def test_nothing_of_the_users_goes_with_a_command_killed_while_folders_are_exchanged(script, tmp_path):
    out = tmp_path / "out"
    assert started(script, "finish", out).communicate(timeout=20)[0] == "done\n"
    process = started(script, "exchanged", out)
    assert process.stdout.readline() == "busy\n"
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130 and (out / "b.txt").read_text() == "whole"
    for _ in range(2):  # the next run neither
        assert [p.read_text() for p in tmp_path.glob(".out.*/notes.txt")] == ["an afternoon of readings"]
        started(script, "finish", out).communicate(timeout=20)


def test_an_interrupt_that_comes_when_all_is_written_does_not_say_that_nothing_is(script, tmp_path):
    process = started(script, "late", tmp_path / "out")
    assert process.stdout.readline() == "busy\n"
    os.kill(process.pid, signal.SIGINT)
    told, _ = process.communicate(timeout=20)
    assert process.returncode == 0 and told == "done\n" and (tmp_path / "out" / "b.txt").exists()


def test_a_second_interrupt_ends_at_once(script, tmp_path):
    process = started(script, "deaf", tmp_path / "out")
    assert process.stdout.readline() == "busy\n"
    begin = time.monotonic()
    os.kill(process.pid, signal.SIGINT)
    time.sleep(0.1)
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130 and time.monotonic() - begin < 0.8
    assert not (tmp_path / "out").exists() and not list(tmp_path.glob(".out*"))


@pytest.mark.parametrize("what", ["polite", "spawned", "writing"])
def test_no_process_outlives_a_killed_command_and_the_next_one_clears_away(script, tmp_path, what):
    out = tmp_path / "out"
    process = started(script, what, out)
    assert process.stdout.readline() == "busy\n"
    process.kill()
    assert process.communicate(timeout=20)[1] == ""  # what it was doing does not end with an error
    until = time.monotonic() + 5.0
    while processes(process.pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert processes(process.pid) == []
    assert [p for p in (script.parent / "tmp").iterdir() if p.suffix != ".lock"] == []
    assert list(tmp_path.glob(".out*")) and not out.exists()
    again = started(script, "finish", out)
    assert again.communicate(timeout=20)[0] == "done\n" and again.returncode == 0
    assert not list(tmp_path.glob(".out*")) and (out / "b.txt").exists()


@pytest.mark.parametrize("shell", [True, False])
def test_processes_end_before_their_temporary_files_go(tmp_path, monkeypatch, shell):
    """Whatever the scheduler does: the other way round what is at work tells its lost files as an error."""
    scratch, done = tmp_path / "scratch", []
    scratch.mkdir()

    def spawned(path, words, environment, setpgroup):
        if not shell:
            raise OSError("no shell")
        done.append((words[2].index("kill"), words[2].index("rm -rf"), *words[4:], setpgroup, scratch.exists()))

    monkeypatch.setattr("os.posix_spawn", spawned)
    monkeypatch.setattr("os.killpg", lambda *given: done.append(given))
    alive, ours = os.pipe()
    os.close(ours)
    _end_with_parent(alive, str(scratch))
    os.close(alive)
    assert done[-1] == (0, signal.SIGKILL) and scratch.exists() == shell
    if shell:
        ((killed, removed, *given), _) = done
        assert killed < removed and given == [str(os.getpgrp()), str(scratch), 0, True]


def test_a_crash_in_foreign_code_is_one_sentence(script, tmp_path):
    process = started(script, "crash", tmp_path / "out")
    text = process.communicate(timeout=20)[1]
    assert process.returncode == 1 and "signal 11" in text and text.count("\n") == 1
    assert not list(tmp_path.glob(".out*")) and not (tmp_path / "out").exists()


def test_nobody_listening_is_no_fault(script, tmp_path):
    process = started(script, "finish", tmp_path / "out")
    process.stdout.close()
    with process.stderr:
        assert process.stderr.read() == ""
    assert process.wait(timeout=20) == 0
    assert (tmp_path / "out" / "b.txt").exists()


@pytest.mark.parametrize("streams", ["<&- >&-", "2>&-", "<&- >&- 2>&-", ">/dev/full", ">/dev/full 2>/dev/full"])
def test_a_result_stands_whether_or_not_it_can_be_told(script, tmp_path, streams):
    """Closed from the start, as a service manager does, or full."""
    out = tmp_path / "out"
    line = f"exec '{sys.executable}' '{script}' finish '{out}' {streams}"
    told = subprocess.run(
        ["sh", "-c", line], env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=60
    )
    assert told.returncode == 0, told.stderr
    assert sorted(p.name for p in out.iterdir()) == [MARKER, "a.txt", "b.txt"]
    assert (out / "a.txt").read_text() == "half" and (out / "b.txt").read_text() == "whole"
    full = "note: all is written, but this line could not be (No space left on device): done\n"
    assert told.stderr == (full if streams == ">/dev/full" else "")


def test_no_place_for_temporary_files_is_one_sentence(script, tmp_path):
    """Every candidate of the system is looked at; here the one that counts is refused by the tempfile module itself."""
    script.write_text("import tempfile\ntempfile._candidate_tempdir_list = lambda: ['/nonexistent']\n" + script.read_text())
    process = started(script, "finish", tmp_path / "out")
    text = process.communicate(timeout=20)[1]
    assert process.returncode == 2 and "set TMPDIR" in text and text.count("\n") == 1


def test_the_python_interface_installs_no_handlers():
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
    import ocp.api  # noqa: F401

    assert {s: signal.getsignal(s) for s in before} == before
