"""CasADi functions as machine code: compiled once, kept, loaded from then on; without a compiler the same bits, more slowly.

CasADi's virtual machine goes through a function instruction by instruction; the same instructions as C take a tenth of the time.
The numbers in a function (dimensions of a robot, coefficients of a table) become an argument, so that functions of one form share
a library: it is compiled once for a kind of cell. A library is taken only if at `COMPARED` points it gives the virtual machine's
very bits.

Loading a library is running it. The folder of libraries is this user's alone and nobody else can put another in its place; each
library is as its checksum says. Otherwise none is loaded.
"""

import hashlib
import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ocp.shell.cache import NotPrivate, content_key, own_folder, put_whole
from ocp.shell.processes import cores
from robots.bounds import MEGABYTE, read_whole
from robots.pose import Array

FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared", "-w")  # as fast as -O3 here; a*b+c in two roundings
COLUMNS = 32  # evaluated in one call of a library
COMPARED = 100  # points at which a library gives the bits of the virtual machine
MOST_SECONDS = 300  # for one function; the largest takes 6
MOST_LIBRARY = 100 * MEGABYTE
# Of the C that CasADi writes: something put into a variable, that it is a number, a result, a variable.
ASSIGNED = re.compile(r"^  (a\d+)=(.*);$")
LITERAL = re.compile(r"-?\d+\.\d*(e[+-]\d+)?$")
RESULT = re.compile(r"^  if \(res\[")
VARIABLE = re.compile(r"\ba\d+\b")
_UNCOMPILED = "all functions"
_told: dict[str, str] = {}  # function -> why the virtual machine evaluates it, empty where machine code does


class _Unusable(Exception):
    """Why a function is not taken as machine code."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler's command, and what tells it from others."""

    command: tuple[str, ...]
    version: str


@cache
def c_compiler() -> Compiler | None:
    """The machine's own `cc`, else the one of the wheel `ziglang`, else None."""
    own = shutil.which("cc")
    if own is not None:
        asked = subprocess.run([own, "--version"], capture_output=True, text=True, check=False)
        if asked.returncode == 0 and asked.stdout.strip():
            return Compiler((own,), asked.stdout.splitlines()[0])
    if importlib.util.find_spec("ziglang") is not None:
        # Its own default is this very processor.
        return Compiler((sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"), f"ziglang {version('ziglang')}")
    return None


def evaluated_by() -> str:
    """In words, what evaluates the model's functions in this process."""
    reasons = sorted({reason for reason in _told.values() if reason})
    compiler = c_compiler()
    if _UNCOMPILED in _told:
        return f"CasADi's virtual machine: {_told[_UNCOMPILED]}"
    if reasons or compiler is None:
        return f"{'in part ' * ('' in _told.values())}CasADi's virtual machine: {'; '.join(reasons)}"
    return f"machine code ({compiler.version}, {' '.join(FLAGS[:2])})"


def left_uncompiled(reason: str) -> None:
    """Tell why nothing is compiled."""
    _told[_UNCOMPILED] = reason


class ColumnFunction:
    """A CasADi function of vectors, evaluated for many columns at once: by machine code where there is some."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._maps: dict[int, ca.Function] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """For another process, which loads the library itself, but need not write its C again."""
        return ColumnFunction, (self.function,), {name: value for name, value in vars(self).items() if name == "source"}

    def name(self) -> str:
        """As CasADi's functions tell theirs."""
        return str(self.function.name())

    def size1_in(self, k: int) -> int:
        """Numbers of an argument."""
        return int(self.function.size1_in(k))

    def size1_out(self, k: int) -> int:
        """Rows of a result."""
        return int(self.function.size1_out(k))

    def __call__(self, *arguments: ca.MX) -> ca.MX:
        """One column, by the virtual machine."""
        return self.function(*arguments)

    def n_instructions(self) -> int:
        """Instructions for one column."""
        return int(self.function.n_instructions())

    def map(self, n: int) -> ca.Function:
        """The function of n columns, with the outputs of all of them side by side; the same bits either way. Those asked for are
        at hand: a pass asks several times."""
        if n not in self._maps:
            self._maps[n] = self.function.map(n) if self.library is None else self.mapped(self.library, n)
        return self._maps[n]

    def mapped(self, library: ca.Function, n: int) -> ca.Function:
        """`map` by a library, in calls of COLUMNS columns each; the last is filled up with copies of the last column."""
        blocks = -(-n // COLUMNS)
        given = [ca.MX.sym(f"i{k}", self.function.size1_in(k), n) for k in range(self.function.n_in())]
        filled = [ca.horzcat(one, ca.repmat(one[:, -1], 1, blocks * COLUMNS - n)) for one in given]
        many = library if blocks == 1 else library.map(self.name(), "serial", blocks, [len(given)], [], {})
        out = many.call([*filled, ca.MX(ca.DM(self.source[1]))])
        cut = [one[:, : n * self.function.size2_out(k)] for k, one in enumerate(out)]
        return ca.Function(f"{self.name()}_{n}", given, cut)

    @cached_property
    def source(self) -> tuple[str, Array]:
        """C of COLUMNS columns with an argument more, the numbers; and these numbers in the order of their uses."""
        generator = ca.CodeGenerator(f"{self.name()}.c")
        generator.add(ca.Function("column", self.function.sx_in(), self.function.call(self.function.sx_in())))
        lines, numbers = _lifted(generator.dump().splitlines())
        f = self.function
        given, results = [f.size_in(k) for k in range(f.n_in())], [f.size_out(k) for k in range(f.n_out())]
        return "\n".join([*lines, _looped(self.name(), given, results, len(numbers))]), np.array(numbers)

    @cached_property
    def library(self) -> ca.Function | None:
        """The machine code as a function of COLUMNS columns and the numbers; None where there is none or it must not be used."""
        try:
            # Writing a function's C only to find that no plan of this machine was worth compiling takes longer than a short pass.
            if c_compiler() is not None and not any(private_folder().glob(f"{self.name()}-*.so")):
                raise _Unusable(_told.get(self.name()) or "not compiled yet")
            path = self.place()
            refused = _verdict(path)
            if refused is None:
                raise _Unusable(_told.get(self.name()) or "not compiled yet")
            if refused:
                raise _Unusable(refused)
            found = self.opened(path)
        except _Unusable as error:
            _told[self.name()] = str(error)
            return None
        _told[self.name()] = ""
        return found

    def place(self) -> Path:
        """Where the library is kept, or would be. Raises _Unusable where none can be."""
        compiler = c_compiler()
        if compiler is None:
            raise _Unusable("there is no C compiler; install cc, or pip install '.[fast]'")
        made = (*compiler.command, compiler.version, *FLAGS, platform.machine(), sys.platform, version("casadi"))
        return private_folder() / f"{self.name()}-{content_key('native 1', self.source[0], *made)}.so"

    def absent(self) -> bool:
        """Whether the library could be there and is not."""
        try:
            return _verdict(self.place()) is None
        except _Unusable:
            return False

    def opened(self, path: Path) -> ca.Function:
        """The function in a library. Raises _Unusable where it cannot be loaded."""
        try:
            return ca.external(self.name(), str(path))
        except RuntimeError:
            raise _Unusable(f"no library can be loaded from {path.parent}; is it mounted noexec?") from None

    def keep(self, content: bytes) -> None:
        """Keep a compiled library, with whether it gives the virtual machine's bits. Raises _Unusable."""
        path = self.place()
        try:
            put_whole(path, content)
            record = {"sha256": hashlib.sha256(content).hexdigest(), "refused": self.difference(self.opened(path))}
            put_whole(_record(path), json.dumps(record).encode())
        except OSError as error:
            raise _Unusable(f"{path.parent} cannot be written ({error.strerror})") from None

    def difference(self, library: ca.Function) -> str:
        """What tells a library's numbers from the virtual machine's at COMPARED points; empty where nothing does."""
        rng = np.random.default_rng(0)
        low = np.where(np.arange(COMPARED) % 2, -1.0, 0.05)  # half of the points where every number is positive
        points = [rng.uniform(low, 1.0, (self.function.size1_in(k), COMPARED)) for k in range(self.function.n_in())]
        ours, theirs = (
            np.concatenate([np.asarray(one).ravel() for one in f.call(points)])
            for f in (self.mapped(library, COMPARED), self.function.map(COMPARED))
        )
        if np.isfinite(theirs).mean() < 0.5:
            return f"{self.name()} has no value at most points of the comparison"
        same = (ours.view(np.int64) == theirs.view(np.int64)) | (np.isnan(ours) & np.isnan(theirs))
        return "" if same.all() else f"{self.name()} as machine code differs in {np.sum(~same)} of {len(same)} numbers"


def compile_together(functions: Sequence[ColumnFunction], quietly: bool = False) -> None:
    """Compile what is not kept yet, side by side; what cannot be compiled the virtual machine does. quietly: what is told of it
    stays, where that must not depend on which process compiled.

    The smallest goes first: where that cannot be compiled or loaded, the large ones are not tried.
    """
    if not quietly:
        _told.pop(_UNCOMPILED, None)
    missing = sorted((one for one in functions if one.library is None and one.absent()), key=ColumnFunction.n_instructions)
    for together in (missing[:1], missing[:0:-1]):
        with ThreadPoolExecutor(cores()) as pool:  # threads only wait: CasADi's own objects are for one at a time
            waiting = [(one, pool.submit(_compiled, one.source[0])) for one in together]
        for one, content in waiting:
            try:
                one.keep(content.result())
                del one.library
                one._maps.clear()
                one.library  # noqa: B018  loaded now
            except _Unusable as error:
                _told.update((other.name(), str(error)) for other in (missing if one is missing[0] else [one]))
        if waiting and missing[0].library is None:
            return


def _lifted(lines: list[str]) -> tuple[list[str], list[float]]:
    """CasADi's C of a function `column` with its numbers taken from `number[]`, one for each use, and these numbers.

    CasADi keeps a number that occurs twice in one variable, and uses variables again. Each result gets a variable of its own, so
    that the text does not depend on which numbers happen to be equal. Raises _Unusable where CasADi writes otherwise.
    """
    out: list[str] = []
    numbers: list[float] = []
    held: dict[str, str | float] = {}
    count = 0

    def operand(found: re.Match[str]) -> str:
        value = held.get(found[0], "unknown")
        if isinstance(value, str):
            return value
        numbers.append(value)
        return f"number[{len(numbers) - 1}]"

    for line in lines:
        assigned = ASSIGNED.match(line)
        if assigned is None:
            if not line.startswith("  casadi_real a"):  # what declares them
                out.append(VARIABLE.sub(operand, line) if RESULT.match(line) else line)
        elif LITERAL.match(assigned[2]):
            held[assigned[1]] = float(assigned[2])
        else:
            count += 1
            out.append(f"  const casadi_real v{count}={VARIABLE.sub(operand, assigned[2])};")
            held[assigned[1]] = f"v{count}"
    out = [
        line.replace("int mem) {", "const casadi_real* number) {") if line.startswith("static int casadi_f0(") else line
        for line in out
    ]
    ends = [k for k, line in enumerate(out) if line.startswith("CASADI_SYMBOL_EXPORT int column(")]
    if not ends:
        raise _Unusable("this CasADi writes C of another form")
    return out[: ends[0]], numbers


def _looped(name: str, given: list[tuple[int, int]], results: list[tuple[int, int]], numbers: int) -> str:
    """C of `name`, which CasADi loads: `column` for COLUMNS columns; arguments and results are dense and side by side."""

    def patterns(of: str, sizes: list[tuple[int, int]]) -> str:
        dense = ", ".join(f"{{{rows}, {columns}, 1}}" for rows, columns in sizes)
        return (
            f"CASADI_SYMBOL_EXPORT casadi_int {name}_n_{of}(void) {{ return {len(sizes)}; }}\n"
            f"CASADI_SYMBOL_EXPORT const casadi_int* {name}_sparsity_{of}(casadi_int i) {{\n"
            f"  static const casadi_int dense[{len(sizes)}][3] = {{{dense}}};\n  return dense[i];\n}}"
        )

    def step(pointer: str, whole: str, k: int, size: tuple[int, int]) -> str:
        return f"    {pointer}[{k}] = {whole}[{k}] ? {whole}[{k}] + {size[0] * size[1]} * i : 0;"

    wide = [[(rows, COLUMNS * columns) for rows, columns in sizes] for sizes in (given, results)]
    return "\n".join(
        [
            patterns("in", [*wide[0], (numbers, 1)]),
            patterns("out", wide[1]),
            f"CASADI_SYMBOL_EXPORT int {name}",
            "(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {",
            f"  const casadi_real* from[{len(given)}];",
            f"  casadi_real* to[{len(results)}];",
            f"  for (casadi_int i = 0; i < {COLUMNS}; ++i) {{",
            *(step("from", "arg", k, size) for k, size in enumerate(given)),
            *(step("to", "res", k, size) for k, size in enumerate(results)),
            f"    if (casadi_f0(from, to, iw, w, arg[{len(given)}])) return 1;",
            "  }",
            "  return 0;",
            "}",
            "",
        ]
    )


def private_folder() -> Path:
    """The folder of libraries. Raises _Unusable where it is not this user's alone, or cannot be made."""
    try:
        return own_folder("native")
    except NotPrivate as error:
        raise _Unusable(str(error)) from None


def _compiled(source: str) -> bytes:
    """A library of C. Raises _Unusable with the compiler's first word."""
    compiler = c_compiler()
    assert compiler is not None
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        (work / "function.c").write_text(source, encoding="utf-8")
        command = [*compiler.command, *FLAGS, "function.c", "-o", "function.so", "-lm"]
        environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": str(private_folder() / "zig"), "ZIG_LOCAL_CACHE_DIR": scratch}
        try:
            done = subprocess.run(
                command, cwd=work, env=environment, capture_output=True, text=True, timeout=MOST_SECONDS, check=False
            )
            if done.returncode == 0:
                return (work / "function.so").read_bytes()
            said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[0]
        except (OSError, subprocess.TimeoutExpired) as error:
            said = str(error)
    raise _Unusable(f"{compiler.version} failed: {said}")


def _record(library: Path) -> Path:
    return library.with_suffix(".json")


def _verdict(library: Path) -> str | None:
    """Why a kept library must not be used, empty where it may; None where there is none, or not as it was written."""
    try:
        record = json.loads(read_whole(_record(library), MEGABYTE, "a record of a library"))
        content = read_whole(library, MOST_LIBRARY, "a library")
        return str(record["refused"]) if record["sha256"] == hashlib.sha256(content).hexdigest() else None
    except Exception:  # whatever is wrong with either file: it is made anew
        return None
