"""Machine code gives the virtual machine's bits, is compiled once for functions of one form, and is never a reason to fail."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from ocp.shell import native
from ocp.shell.native import ColumnFunction, compile_together, evaluated_by

X = np.random.default_rng(3).uniform(0.1, 1.0, (2, 75))
HAS_CC = pytest.mark.skipif(shutil.which("cc") is None, reason="no cc on this machine")


@pytest.fixture(autouse=True)
def fresh(tmp_path, monkeypatch):
    """A cache of its own, nothing told yet, no compiler looked for."""
    monkeypatch.setenv("GRINDPLAN_CACHE", str(tmp_path / "kept"))
    monkeypatch.setattr(native, "_told", {})
    native.c_compiler.cache_clear()
    yield
    native.c_compiler.cache_clear()


def wave(length: float = 0.3701, name: str = "wave") -> ColumnFunction:
    """y = exp(sin(x0) x1 / length), length as a number in it."""
    x = ca.SX.sym("x", 2)
    return ColumnFunction(ca.Function(name, [x], [ca.exp(ca.sin(x[0]) * x[1] / length), ca.vertcat(x, 1.7 * x)]))


def compiled(**changed) -> ColumnFunction:
    compile_together([wave(**changed)])
    return wave(**changed)


def same_bits(one: ColumnFunction, n: int = 75) -> bool:
    ours, theirs = (f(X[:, :n]) for f in (one.map(n), one.function.map(n)))
    return all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in zip(ours, theirs, strict=True))


def fake_cc(tmp_path: Path, monkeypatch, script: str) -> None:
    """A `cc` that does what `script` says; the real one is $CC."""
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "cc").write_text(
        f'#!/bin/sh\n[ "$1" = --version ] && echo strange 1.0 && exit 0\nCC={shutil.which("cc")}\n{script}\n'
    )
    (folder / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")


def libraries() -> list[Path]:
    return sorted((Path(os.environ["GRINDPLAN_CACHE"]) / "native").glob("*.so"))


@HAS_CC
@pytest.mark.parametrize("n", [1, 32, 75])
def test_machine_code_gives_the_bits_of_the_virtual_machine(n):
    one = compiled()
    assert one.library is not None and "machine code" in evaluated_by()
    assert same_bits(one, n)


@HAS_CC
def test_functions_that_differ_in_their_numbers_share_a_library():
    one = compiled()
    other = wave(length=0.2213)
    assert other.library is not None and libraries() == [other.place()]
    assert same_bits(one) and same_bits(other) and np.any(np.asarray(one.map(75)(X)[0]) != np.asarray(other.map(75)(X)[0]))


@HAS_CC
def test_no_c_is_written_to_tell_that_nothing_is_kept():
    """Nor for the name of another function whose library is."""
    compiled(name="other")
    one = wave()
    assert one.library is None and "source" not in vars(one) and "not compiled yet" in evaluated_by()


@HAS_CC
def test_two_that_compile_at_once_leave_one_whole_library():
    code = "from tests.shell.test_native import *; compile_together([wave()]); raise SystemExit(wave().library is None)"
    both = [subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parents[2]) for _ in range(2)]
    assert [one.wait() for one in both] == [0, 0]
    assert len(libraries()) == 1 and not list(libraries()[0].parent.glob("*.part"))


def test_without_a_compiler_the_virtual_machine_does_it(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(native.importlib.util, "find_spec", lambda _: None)
    assert compiled().library is None
    assert "no C compiler" in evaluated_by() and "[fast]" in evaluated_by()
    assert same_bits(wave())


@HAS_CC
@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("echo 'out of order' >&2; exit 1", "strange 1.0 failed: out of order"),
        ('while [ "$1" != -o ]; do shift; done; echo no library > "$2"', "no library can be loaded"),
        ("sed -i 's/exp(/1e-16+exp(/' function.c; exec $CC \"$@\"", "differs in"),
    ],
    ids=["fails", "makes no library", "adds a bit"],
)
def test_what_a_strange_compiler_makes_is_not_used(tmp_path, monkeypatch, script, told):
    fake_cc(tmp_path, monkeypatch, script)
    assert compiled().library is None
    assert "virtual machine" in evaluated_by() and told in evaluated_by()
    assert same_bits(wave())


@HAS_CC
def test_a_compiler_that_fails_is_asked_once_not_for_each_function(tmp_path, monkeypatch):
    fake_cc(tmp_path, monkeypatch, f"echo asked >> {tmp_path / 'asked'}; exit 1")
    compile_together([wave(name=name) for name in ("first", "second", "third")])
    assert (tmp_path / "asked").read_text() == "asked\n"
    assert "strange 1.0 failed: exit code 1" in evaluated_by() and "in part" not in evaluated_by()


@HAS_CC
def test_a_library_that_is_not_as_it_was_written_is_compiled_anew():
    """As a compiled function of an earlier run, one byte of which has changed."""
    compiled(name="whole")
    path = wave(name="whole").place()
    content = bytearray(path.read_bytes())
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert wave(name="whole").library is None and "not compiled yet" in evaluated_by()
    compile_together([wave(name="whole")])
    assert path.read_bytes() == content and "machine code" in evaluated_by()


@HAS_CC
@pytest.mark.parametrize(("place", "mode"), [("kept/native", 0o755), ("kept", 0o777)])
def test_libraries_in_a_folder_that_is_open_to_others_are_not_loaded(tmp_path, place, mode):
    compiled()
    (tmp_path / place).chmod(mode)
    assert wave().library is None
    assert f"mode {mode:04o}" in evaluated_by() and "chmod" in evaluated_by()


@HAS_CC
def test_a_folder_of_somebody_else_is_not_used(monkeypatch):
    compiled()
    monkeypatch.setattr(native.os, "geteuid", lambda: os.getuid() + 1)
    assert wave().library is None and "not a folder of this user" in evaluated_by()


def test_where_nothing_is_kept_nothing_is_compiled(monkeypatch):
    monkeypatch.setenv("GRINDPLAN_CACHE", "")
    assert compiled().library is None and "GRINDPLAN_CACHE" in evaluated_by()
