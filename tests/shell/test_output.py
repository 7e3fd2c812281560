"""Output folders appear whole or not at all, whatever happens in between."""

import json
import os
import re
import shutil
import signal
from hashlib import sha256
from pathlib import Path

import pytest

from ocp.shell import output as shell_output
from ocp.shell.output import MARKER, add_text_file, as_written, files_added, remove_written, reserved, whole_folder, write_marker
from robots.errors import BadInput, Infeasible


def check_output(folder, overwrite, inputs=()):
    with reserved(folder, overwrite, inputs):
        pass


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def old_folder(parent):
    """A folder as an earlier run wrote it."""
    folder = parent / "plan"
    (folder / "deep").mkdir(parents=True)
    (folder / "a.txt").write_text("old")
    (folder / "deep" / "b.txt").write_text("old too")
    write_marker(folder)
    return folder


def is_untouched(folder):
    return (
        names(folder) == [MARKER, "a.txt", "deep"]
        and (folder / "a.txt").read_text() == "old"
        and (folder / "deep" / "b.txt").read_text() == "old too"
    )


def test_a_new_folder_appears_when_it_is_whole(tmp_path):
    out = tmp_path / "far" / "away" / "plan"
    with whole_folder(out, overwrite=False) as partial:
        (partial / "x.txt").write_text("new")
        assert not out.exists() and partial.parent == out.parent
    assert names(out) == [MARKER, "x.txt"] and names(out.parent) == ["plan"]
    assert out.stat().st_mode & 0o777 == 0o755


def test_a_place_where_no_folder_can_be_made_is_refused_before_the_work():
    with pytest.raises(BadInput, match=r"^/proc/plan: cannot be written"):  # root may write there, says access
        check_output(Path("/proc/plan"), overwrite=False)


def test_an_empty_folder_is_as_good_as_none(tmp_path):
    out = tmp_path / "plan"
    out.mkdir()
    with whole_folder(out, overwrite=False) as partial:
        (partial / "x.txt").write_text("new")
    assert names(out) == [MARKER, "x.txt"] and names(tmp_path) == ["plan"]


def test_a_full_folder_is_refused_and_replaced_only_on_request(tmp_path):
    out = old_folder(tmp_path)
    for attempt in (lambda: check_output(out, False), lambda: whole_folder(out, False).__enter__()):
        with pytest.raises(BadInput, match="not empty.*--overwrite"):
            attempt()
    assert is_untouched(out) and names(tmp_path) == ["plan"]
    with whole_folder(out, overwrite=True) as partial:
        (partial / "x.txt").write_text("new")
        assert is_untouched(out)
    assert names(out) == [MARKER, "x.txt"] and names(tmp_path) == ["plan"]


@pytest.mark.parametrize("error", [Infeasible("no"), BadInput("no"), KeyboardInterrupt(), ValueError("a fault"), SystemExit(3)])
def test_whatever_ends_the_block_leaves_the_old_folder(tmp_path, error):
    out = old_folder(tmp_path)
    with pytest.raises(type(error)), whole_folder(out, overwrite=True) as partial:
        (partial / "x.txt").write_text("half")
        raise error
    assert is_untouched(out) and names(tmp_path) == ["plan"]
    with pytest.raises(type(error)), whole_folder(tmp_path / "fresh", overwrite=False) as partial:
        (partial / "x.txt").write_text("half")
        raise error
    assert names(tmp_path) == ["plan"]


@pytest.mark.parametrize("exchange", [True, False])
def test_the_new_folder_taken_away_leaves_the_old_one(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(shell_output, "_exchanged", lambda one, other: False)
    out = old_folder(tmp_path)
    with pytest.raises(OSError), whole_folder(out, overwrite=True) as partial:
        shutil.rmtree(partial)
    assert is_untouched(out) and names(tmp_path) == ["plan"]


def test_without_an_exchange_the_old_folder_is_moved_aside_first(tmp_path, monkeypatch):
    monkeypatch.setattr(shell_output, "_exchanged", lambda one, other: False)
    out = old_folder(tmp_path)
    with whole_folder(out, overwrite=True) as partial:
        (partial / "x.txt").write_text("new")
    assert names(out) == [MARKER, "x.txt"] and names(tmp_path) == ["plan"]


@pytest.mark.parametrize("step", ["write_text", "replace", "rename1", "rename2", "exchange", "after exchange", "rmtree"])
def test_a_run_killed_at_any_step_loses_nothing(tmp_path, monkeypatch, step):
    """What stands is the old folder or the new one, now or after the next run has put it back; nothing is left beside it."""
    out = old_folder(tmp_path) if step != "replace" else tmp_path / "plan"
    child = os.fork()
    if child == 0:
        kill_at(step)
        with whole_folder(out, overwrite=True) as partial:
            (partial / "x.txt").write_text("new")
            if step == "write_text":
                os.kill(os.getpid(), signal.SIGKILL)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    with pytest.raises(Infeasible), reserved(out, overwrite=True):
        raise Infeasible("the next run finds no plan")
    assert names(tmp_path) == (["plan"] if out.exists() else [])
    if step in ("after exchange", "rmtree"):
        assert names(out) == [MARKER, "x.txt"]
    elif step != "replace":
        assert is_untouched(out)


def kill_at(step):
    """This process is killed just before, or after, a step of the replacement."""
    count = [0]

    def killing(call, at=1, after=False):
        def step_of(*arguments, **options):
            count[0] += 1
            if count[0] == at and not after:
                os.kill(os.getpid(), signal.SIGKILL)
            value = call(*arguments, **options)
            if count[0] == at:
                os.kill(os.getpid(), signal.SIGKILL)
            return value

        return step_of

    if step.endswith("replace"):
        os.replace = killing(os.replace, after=step.startswith("after"))
    elif step.startswith("rename"):
        shell_output._exchanged = lambda one, other: False
        os.rename = killing(os.rename, int(step[-1]))
    elif step == "rmtree":
        shutil.rmtree = killing(shutil.rmtree)
    elif "exchange" in step:
        shell_output._exchanged = killing(shell_output._exchanged, after=step.startswith("after"))


HASHES = {name: sha256(text).hexdigest() for name, text in (("a.txt", b"old"), ("deep/b.txt", b"old too"))}
FORGED = json.dumps({"sha256": HASHES | {"deep/link": "no regular file"}})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda out: (out / "deep" / "notes.txt").write_text("mine"), "deep/notes.txt, which this software did not write"),
        (lambda out: (out / "deep" / "b.txt").write_text("an afternoon of readings"), "deep/b.txt, which was changed"),
        (lambda out: (out / "deep" / "link").symlink_to(out), "deep/link, which this software did not write"),
        (
            lambda out: ((out / "deep" / "link").symlink_to(out), (out / MARKER).write_text(FORGED)),
            "deep/link, which this software did not write",
        ),
        (lambda out: (out / MARKER).unlink(), "a.txt, and no .written.json tells"),
        (lambda out: (out / MARKER).write_text('{"sha256": {"a.txt": 1}}'), "a.txt, which this software did not write"),
        (lambda out: (out / MARKER).write_text('{"sha256": 3}'), "a.txt, which this software did not write"),
        (lambda out: (out / MARKER).write_text("\0"), "a.txt, which this software did not write"),
    ],
)
def test_what_is_the_users_is_never_replaced(tmp_path, change, named):
    out = old_folder(tmp_path)
    change(out)
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    for attempt in (lambda: check_output(out, True), lambda: whole_folder(out, True).__enter__()):
        with pytest.raises(BadInput, match=re.escape(named)):
            attempt()
    assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before and names(tmp_path) == ["plan"]


def test_what_the_user_changes_while_a_run_works_is_never_replaced(tmp_path):
    out = old_folder(tmp_path)
    with pytest.raises(BadInput, match=r"a\.txt, which was changed"), whole_folder(out, True) as partial:
        (partial / "x.txt").write_text("new")
        (out / "a.txt").write_text("mine")
    assert (out / "a.txt").read_text() == "mine" and names(tmp_path) == ["plan"]


def test_what_comes_meanwhile_is_never_replaced(tmp_path):
    for overwrite in (False, True):
        out = tmp_path / f"plan{overwrite}"
        with pytest.raises(BadInput, match="somebody else wrote there"), whole_folder(out, overwrite) as partial:
            (partial / "x.txt").write_text("new")
            out.mkdir()
            (out / "theirs.txt").write_text("theirs")
            if overwrite:
                write_marker(out)
        assert (out / "theirs.txt").read_text() == "theirs"
    assert names(tmp_path) == ["planFalse", "planTrue"]


def test_a_second_run_into_the_same_folder_is_refused_and_the_lock_dies_with_its_process(tmp_path):
    out = tmp_path / "plan"
    link = tmp_path / "link"
    link.symlink_to(out)
    with reserved(out, False):
        for name in (out, link, tmp_path / "x" / ".." / "plan"):
            with pytest.raises(BadInput, match="another run is writing there"), reserved(name, True):
                pass
    ready, told = os.pipe()
    child = os.fork()
    if child == 0:
        with reserved(out, False):
            os.write(told, b"x")
            signal.pause()
    os.read(ready, 1)
    with pytest.raises(BadInput, match="another run is writing there"), reserved(out, True):
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with reserved(out, True):
        pass
    os.close(ready)
    os.close(told)


def test_a_run_leaves_no_lock_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(shell_output.processes, "temporary", lambda: tmp_path)
    with whole_folder(tmp_path / "plan", overwrite=False):
        assert len(list(tmp_path.glob("grindplan-*.lock"))) == 1
    assert names(tmp_path) == ["plan"]


def test_a_lock_whose_file_was_removed_meanwhile_is_taken_anew(tmp_path, monkeypatch):
    """Another process removes its lock between our opening of the file and our lock on it: what we then hold nobody else sees."""
    file, acquire, times = tmp_path / "x.lock", shell_output.FileLock.acquire, []

    def late(lock, *arguments, **options):
        taken = acquire(lock, *arguments, **options)
        times.append(1)
        if len(times) == 1:
            file.unlink()
        return taken

    monkeypatch.setattr(shell_output.FileLock, "acquire", late)
    lock = shell_output._locked(file)
    assert len(times) == 2 and file.exists()
    with pytest.raises(shell_output.Timeout):
        shell_output._locked(file)
    shell_output._unlocked(lock, file)
    assert names(tmp_path) == []


def test_of_two_processes_that_take_and_leave_a_folder_only_one_has_it(tmp_path, monkeypatch):
    """400 times each: whoever is in makes a file that must not be there and removes it."""
    monkeypatch.setattr(shell_output.processes, "temporary", lambda: tmp_path)

    def turns():
        had = 0
        while had < 400:
            try:
                with reserved(tmp_path / "plan", False):
                    os.close(os.open(tmp_path / "inside", os.O_CREAT | os.O_EXCL))
                    os.unlink(tmp_path / "inside")
                    had += 1
            except BadInput:
                continue

    child = os.fork()
    if child == 0:
        try:
            turns()
        except BaseException:
            os._exit(1)
        os._exit(0)
    try:
        turns()
    finally:
        status = os.waitpid(child, 0)[1]
    assert status == 0 and names(tmp_path) == []


def test_a_full_disk_is_one_sentence_and_leaves_nothing(tmp_path):
    out = old_folder(tmp_path)
    with pytest.raises(BadInput, match="No space left on device"), whole_folder(out, True) as partial:
        (partial / "x.txt").write_text("new")
        with open("/dev/full", "w") as full:
            full.write("x" * 100000)
    assert is_untouched(out) and names(tmp_path) == ["plan"]


def test_a_disk_that_fills_while_a_night_grows_is_named(tmp_path):
    """It said that space is wanting "there", and nothing of where."""
    night = tmp_path / "night"
    add_text_file(night, "night.json", "done")
    with pytest.raises(BadInput, match=f"^{night}: cannot be written .No space left on device.; free some"), files_added(night):
        with open("/dev/full", "w") as full:
            full.write("x" * 100000)
    assert names(tmp_path) == ["night"] and as_written(night / "night.json", night)


def test_a_growing_folder_that_gets_no_file_is_not_left_behind(tmp_path):
    out = tmp_path / "on" / "the" / "way"
    with pytest.raises(BadInput), reserved(out, False, grows=True) as output, output.grown() as folder:
        assert folder.is_dir()
        raise BadInput("no space")
    assert names(tmp_path) == []


def test_a_link_to_itself_is_refused(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name in ("loop", "loop/plan"):
        with pytest.raises(BadInput, match="leads nowhere or to itself"):
            check_output(tmp_path / name, True)


def test_a_folder_in_the_working_directory_by_its_bare_name(tmp_path, monkeypatch):
    from pathlib import Path

    monkeypatch.chdir(tmp_path)
    with whole_folder(Path("plan"), overwrite=False) as partial:
        (partial / "x.txt").write_text("new")
    assert names(tmp_path / "plan") == [MARKER, "x.txt"]


@pytest.mark.parametrize("name", ["file", "file/plan", "file/deep/plan"])
def test_a_file_in_the_way_is_refused_before_the_work(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(BadInput) as refusal:
        check_output(tmp_path / name, overwrite=True)
    assert str(tmp_path / name) in str(refusal.value) and "\n" not in str(refusal.value)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_parent_without_permission_is_refused_before_the_work(tmp_path):
    parent = tmp_path / "locked"
    parent.mkdir()
    parent.chmod(0o555)
    with pytest.raises(BadInput, match="permission"):
        check_output(parent / "plan", overwrite=False)
    parent.chmod(0o755)


def test_inputs_and_the_place_where_one_stands_are_never_replaced(tmp_path, monkeypatch):
    out = old_folder(tmp_path)
    with pytest.raises(BadInput, match=r"b\.txt, an input of this run"):
        check_output(out, True, [out / "deep" / "b.txt"])
    monkeypatch.chdir(out / "deep")
    with pytest.raises(BadInput, match="--overwrite would delete"):
        check_output(out, True)
    assert is_untouched(out)


@pytest.mark.parametrize("name", ["", ".", "x" * 300, "y" * 240])
def test_names_that_no_folder_can_have_are_told_before_the_work(name):
    from pathlib import Path

    with pytest.raises(BadInput, match="--out"):
        check_output(Path(name), False)


def test_a_link_stays_and_its_folder_is_replaced(tmp_path):
    out = old_folder(tmp_path)
    link = tmp_path / "link"
    link.symlink_to(out)
    with whole_folder(link, overwrite=True) as partial:
        (partial / "x.txt").write_text("new")
    assert link.is_symlink() and names(out) == [MARKER, "x.txt"]


def test_a_folder_that_grows_lists_what_was_written_and_nothing_else(tmp_path):
    out = tmp_path / "check"
    for name in ("a.txt", "b.txt"):
        with pytest.raises(KeyboardInterrupt), reserved(out, False, grows=True) as output, output.grown() as folder:
            add_text_file(folder, f"deep/{name}", "world")
            raise KeyboardInterrupt
    (out / "notes.txt").write_text("mine")
    with reserved(out, False, grows=True) as output, output.grown() as folder:
        add_text_file(folder, "c.txt", "world 3")
        (out / "meanwhile.txt").write_text("mine too")
    for name in ("meanwhile.txt", "notes.txt"):
        with pytest.raises(BadInput, match=rf"{name}, which this software did not write"), reserved(out, True, grows=True):
            pass
        (out / name).unlink()
    with reserved(out, True, grows=True) as output, output.grown() as folder:
        assert names(folder) == []
    assert names(tmp_path) == ["check"]


def test_what_a_growing_folder_would_replace_or_remove_is_this_software_s_and_unchanged(tmp_path):
    out = tmp_path / "check"
    add_text_file(out, "a.txt", "world 1")
    add_text_file(out, "a.txt", "world 1, anew")
    assert (out / "a.txt").read_text() == "world 1, anew" and as_written(out / "a.txt", out)
    (out / "b.txt").write_text("mine")
    (out / "link").symlink_to(out / "a.txt")
    for name in ("b.txt", "link"):
        for attempt in (
            lambda name=name: add_text_file(out, name, "world 2"),
            lambda name=name: remove_written(out, ["a.txt", name]),
        ):
            with pytest.raises(BadInput, match=rf"{name}: stands where this run writes"):
                attempt()
    (out / "a.txt").write_text("changed")
    with pytest.raises(BadInput, match=r"a\.txt: stands where this run writes"):
        remove_written(out, ["a.txt"])
    assert (out / "a.txt").read_text() == "changed" and not as_written(out / "a.txt", out) and names(tmp_path) == ["check"]


@pytest.mark.parametrize("step", range(8))
def test_a_growing_run_killed_at_any_step_leaves_every_file_listed(tmp_path, monkeypatch, step):
    """Before and after the renames of the marker and of three files, one of which replaces what an earlier run wrote."""
    out, killed = tmp_path / "check", os.fork()
    if killed == 0:
        add_text_file(out, "b.txt", "of an earlier run")
        call, count = os.replace, [0]

        def replace(*arguments):
            if 2 * count[0] == step:
                os.kill(os.getpid(), signal.SIGKILL)
            call(*arguments)
            if 2 * count[0] + 1 == step:
                os.kill(os.getpid(), signal.SIGKILL)
            count[0] += 1

        os.replace = replace
        with files_added(out, last="a.txt") as part:
            for name in ("a.txt", "b.txt", "c.txt"):
                (part / name).write_text("new")
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(killed, 0)[1]) == -signal.SIGKILL
    assert (out / "a.txt").exists() == (step == 7) and shell_output.users_file(out) is None
    with reserved(out, False, grows=True):
        assert names(tmp_path) == ["check"]
    add_text_file(out, "b.txt", "by the next run")
    assert shell_output.users_file(out) is None
    (out / "b.txt").write_text("mine")
    with pytest.raises(BadInput, match=r"b\.txt, which was changed since it was written"):
        check_output(out, True)


@pytest.mark.parametrize("step", ["replace", "after replace", "rmtree"])
def test_a_growing_folder_that_is_begun_anew_is_there_or_gone_when_the_run_is_killed(tmp_path, step):
    out, killed = old_folder(tmp_path), os.fork()
    if killed == 0:
        kill_at(step)
        with reserved(out, True, grows=True) as output, output.grown():
            pass
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(killed, 0)[1]) == -signal.SIGKILL
    assert is_untouched(out) if step == "replace" else not out.exists()
    check_output(out, True)
    assert names(tmp_path) == (["plan"] if step == "replace" else [])


def test_several_processes_add_to_one_folder(tmp_path):
    out, children = tmp_path / "check", []
    for worker in range(3):
        children.append(os.fork())
        if children[-1] == 0:
            for k in range(20):
                add_text_file(out, f"worlds/{worker}{k}.txt", f"{k}")
            os._exit(0)
    assert [os.waitpid(child, 0)[1] for child in children] == [0, 0, 0]
    assert len(names(out / "worlds")) == 60 and shell_output.users_file(out) is None and names(tmp_path) == ["check"]


def test_a_place_that_may_not_be_looked_into_needs_no_shorter_name(tmp_path, monkeypatch):
    def denied(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.exists", denied)
    with pytest.raises(BadInput, match="Permission denied; give another --out"):
        shell_output.Output(tmp_path / "out", False, False).check()


@pytest.mark.parametrize("name", ["log\nradius_mm = 5.csv", "Gr\udcf6\udcdfe.csv", "tab\t.csv"])
def test_a_name_that_cannot_stand_in_a_file_is_refused(tmp_path, name):
    for out, inputs in ((tmp_path / "out", [tmp_path / name]), (tmp_path / name / "out", [])):
        with pytest.raises(BadInput, match="a line break or another sign") as refusal, reserved(out, False, inputs):
            pass
        assert "\n" not in str(refusal.value) and str(refusal.value).isprintable()
