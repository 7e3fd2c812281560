"""Output folders appear whole or not at all, whatever happens in between."""

import os

import pytest

from ocp.shell.output import check_output, whole_folder
from robots.errors import BadInput, Infeasible


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def old_folder(parent):
    folder = parent / "plan"
    (folder / "deep").mkdir(parents=True)
    (folder / "a.txt").write_text("old")
    (folder / "deep" / "b.txt").write_text("old too")
    return folder


def is_untouched(folder):
    return (
        names(folder) == ["a.txt", "deep"]
        and (folder / "a.txt").read_text() == "old"
        and (folder / "deep" / "b.txt").read_text() == "old too"
    )


def test_a_new_folder_appears_when_it_is_whole(tmp_path):
    out = tmp_path / "far" / "away" / "plan"
    with whole_folder(out, overwrite=False) as partial:
        (partial / "x.txt").write_text("new")
        assert not out.exists() and partial.parent == out.parent
    assert names(out) == ["x.txt"] and names(out.parent) == ["plan"]
    assert out.stat().st_mode & 0o777 == 0o755


def test_an_empty_folder_is_as_good_as_none(tmp_path):
    out = tmp_path / "plan"
    out.mkdir()
    with whole_folder(out, overwrite=False) as partial:
        (partial / "x.txt").write_text("new")
    assert names(out) == ["x.txt"] and names(tmp_path) == ["plan"]


def test_a_full_folder_is_refused_and_replaced_only_on_request(tmp_path):
    out = old_folder(tmp_path)
    for attempt in (lambda: check_output(out, False), lambda: whole_folder(out, False).__enter__()):
        with pytest.raises(BadInput, match="not empty.*--overwrite"):
            attempt()
    assert is_untouched(out) and names(tmp_path) == ["plan"]
    with whole_folder(out, overwrite=True) as partial:
        (partial / "x.txt").write_text("new")
        assert is_untouched(out)
    assert names(out) == ["x.txt"] and names(tmp_path) == ["plan"]


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


def test_a_rename_that_fails_brings_the_old_folder_back(tmp_path):
    out = old_folder(tmp_path)
    with pytest.raises(OSError), whole_folder(out, overwrite=True) as partial:
        # Somebody takes the new folder away before it can be put in its place.
        partial.rename(tmp_path / "elsewhere")
    assert out.exists() and is_untouched(out)


def test_a_folder_in_the_working_directory_by_its_bare_name(tmp_path, monkeypatch):
    from pathlib import Path

    monkeypatch.chdir(tmp_path)
    with whole_folder(Path("plan"), overwrite=False) as partial:
        (partial / "x.txt").write_text("new")
    assert names(tmp_path / "plan") == ["x.txt"]


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
    assert link.is_symlink() and names(out) == ["x.txt"]
