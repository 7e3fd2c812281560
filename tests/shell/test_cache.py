"""Kept results: keys tell contents apart, damaged entries are computed anew, processes do not disturb each other."""

import io
import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from ocp.shell import cache


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    return tmp_path


@given(hnp.arrays(np.float64, hnp.array_shapes(max_dims=3), elements=st.floats(-1e3, 1e3)))
def test_key_depends_on_content_only(array):
    key = cache.content_key("x", array)
    assert key == cache.content_key("x", np.asfortranarray(array.copy()))
    changed = array.copy()
    changed.flat[-1] = np.nextafter(changed.flat[-1], np.inf)
    assert key != cache.content_key("x", changed)
    assert key != cache.content_key("x", array[None])


def test_key_tells_parts_and_types_apart():
    one, two = np.array([1.0, 2.0]), np.array([3.0])
    keys = [
        cache.content_key(*parts)
        for parts in (
            (one, two),
            (np.array([1.0]), np.array([2.0, 3.0])),
            (two, one),
            ("ab", "c"),
            ("a", "bc"),
            (1,),
            (1.0,),
            (True,),
            ("1",),
            (None,),
            (np.array([1], np.int64),),
            (np.array([1], np.int32),),
            (),
        )
    ]
    assert len(set(keys)) == len(keys)
    assert cache.content_key(np.float64(0.1)) == cache.content_key(0.1)


def test_second_call_reads(folder):
    calls = []

    def compute():
        calls.append(1)
        return {"a": np.arange(6.0).reshape(2, 3), "name": np.array("netgen")}

    first, second = cache.remember("kind", "key", compute), cache.remember("kind", "key", compute)
    assert len(calls) == 1 and str(second["name"]) == "netgen"
    np.testing.assert_array_equal(first["a"], second["a"])
    assert [f.name for f in folder.iterdir()] == ["kind-key.kept"]


def test_no_byte_of_an_entry_may_change(folder):
    """Every byte of a small entry changed, one at a time: computed anew, never taken for good."""
    cache.remember("kind", "key", lambda: {"a": np.arange(3.0)})
    path = folder / "kind-key.kept"
    content = path.read_bytes()
    for i in range(len(content)):
        path.write_bytes(content[:i] + bytes([content[i] ^ 0x20]) + content[i + 1 :])
        assert cache.recall("kind", "key") is None, i
    path.write_bytes(content + b"x")
    assert cache.recall("kind", "key") is None


@pytest.mark.parametrize("damage", ["cut", "bit", "empty", "text", "pickle"])
def test_damaged_entry_is_computed_anew(folder, damage):
    cache.remember("kind", "key", lambda: {"a": np.arange(1000.0)})
    path = folder / "kind-key.kept"
    content = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "bit":
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "text":
        path.write_text("not an archive")
    else:
        archive = io.BytesIO()
        np.savez(archive, a=np.array([{"code": 1}], dtype=object))
        path.write_bytes(sha256(archive.getvalue()).digest() + archive.getvalue())
    np.testing.assert_array_equal(cache.remember("kind", "key", lambda: {"a": np.arange(3.0)})["a"], np.arange(3.0))
    np.testing.assert_array_equal(cache.remember("kind", "key", dict)["a"], np.arange(3.0))


def test_errors_pass_and_leave_nothing(folder):
    with pytest.raises(ZeroDivisionError):
        cache.remember("kind", "key", lambda: {"a": np.array(1 / 0)})
    assert not list(folder.iterdir())


def test_unwritable_folder_and_no_folder_still_compute(folder, monkeypatch):
    (folder / "file").write_text("in the way")
    monkeypatch.setenv(cache.VARIABLE, str(folder / "file" / "below"))
    assert cache.remember("kind", "key", lambda: {"a": np.ones(2)})["a"].sum() == 2.0
    monkeypatch.setenv(cache.VARIABLE, "")
    assert cache.cache_folder() is None
    assert cache.remember("kind", "key", lambda: {"a": np.ones(3)})["a"].sum() == 3.0


def test_parallel_writers_leave_one_whole_entry(folder):
    code = (
        "import numpy as np; from ocp.shell.cache import remember\n"
        "for i in range(60): assert remember('kind', str(i), lambda: {'a': np.full(20000, float(i))})['a'][-1] == i"
    )
    root = Path(__file__).parents[2]
    running = [subprocess.Popen([sys.executable, "-c", code], cwd=root) for _ in range(3)]
    assert [process.wait(timeout=60) for process in running] == [0, 0, 0]
    assert sorted(f.suffix for f in folder.iterdir()) == [".kept"] * 60


@pytest.mark.parametrize("other", ["pipe", "device", "folder", "loop", "endless"])
def test_an_entry_that_is_no_file_of_some_size_is_computed_anew(folder, other):
    """A pipe would be waited for, a device read without end."""
    value = {"a": np.arange(3.0)}
    cache.remember("kind", "key", lambda: value)
    (entry,) = folder.iterdir()
    entry.unlink()
    if other == "pipe":
        os.mkfifo(entry)
    elif other == "folder":
        entry.mkdir()
    elif other == "endless":
        with entry.open("wb") as file:
            file.truncate(1 << 40)
    else:
        entry.symlink_to("/dev/zero" if other == "device" else entry)
    code = "from ocp.shell import cache; import numpy as np; print(cache.remember('kind', 'key', lambda: {'a': np.ones(1)})['a'])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert told.stdout == "[1.]\n", told.stderr
