"""The house as its sources have it: rooms, what each imports, floors. `python -m tests.support.house docs/architecture.md` writes
the table of rooms, without a page it prints the house's figures."""

import ast
import io
import re
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WINGS = ("robots", "trajectories", "ocp")  # each imports only from those before it
BEGIN, END = "<!-- rooms: python -m tests.support.house docs/architecture.md -->", "<!-- end of rooms -->"


@dataclass(frozen=True)
class Declared:
    """docs/rooms.toml: the order of the rooms, and the largest counts."""

    rooms: tuple[str, ...]
    most_rooms: int
    most_floors: int
    most_entries: int
    many: tuple[str, ...]


def declared() -> Declared:
    content = tomllib.loads((ROOT / "docs" / "rooms.toml").read_text(encoding="utf-8"))
    return Declared(**{key: tuple(value) if isinstance(value, list) else value for key, value in content.items()})


def sources(*wings: str) -> list[Path]:
    return [path for wing in wings or WINGS for path in sorted((ROOT / wing).rglob("*.py"))]


@cache
def is_module(name: str) -> bool:
    if not name or not all(part.isidentifier() for part in name.split(".")):
        return False
    place = ROOT.joinpath(*name.split("."))
    return place.with_suffix(".py").exists() or (place / "__init__.py").exists()


@cache
def imported(path: Path) -> tuple[tuple[int, str], ...]:
    """Line and name of every module that a file imports anywhere in it, functions included; for `from a import b` a.b where that
    is a module. A text that is a module's whole name counts too: it is what `import_module` is given."""
    return tuple(_imported(path))


def _imported(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{path}:{node.lineno}: relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield node.lineno, inner if is_module(inner) else node.module
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value and is_module(node.value):
            yield node.lineno, node.value


def room_of(path: Path) -> str:
    return path.relative_to(ROOT / "ocp").parts[0]


def uses() -> dict[str, set[str]]:
    """Rooms of ocp/ with the rooms that each imports."""
    rooms = [path.name for path in (ROOT / "ocp").iterdir() if (path / "__init__.py").exists()]
    found: dict[str, set[str]] = {room: set() for room in rooms}
    for path in sources("ocp"):
        if path.parent == ROOT / "ocp":
            continue
        names = {name.split(".")[1] for _, name in imported(path) if name.startswith("ocp.")}
        found[room_of(path)] |= names - {room_of(path)}
    return found


def floors() -> dict[str, int]:
    """A room stands one above the highest it imports; in the declared order, so that a circle is a room that is not there yet."""
    found: dict[str, int] = {}
    used = uses()
    for room in declared().rooms:
        found[room] = 1 + max((found[other] for other in used.get(room, ())), default=0)
    return found


def described(room: str) -> tuple[str, str]:
    """What lives in a room, by the docstring of its `__init__`: its first line, and the rest."""
    text = ast.get_docstring(ast.parse((ROOT / "ocp" / room / "__init__.py").read_text(encoding="utf-8"))) or ""
    first, _, rest = text.partition("\n")
    return first.strip(), " ".join(rest.split())


def table() -> str:
    """An item a room, the highest floor first: `room`, floor, what lives there."""
    floor, lines = floors(), []
    for room in sorted(declared().rooms, key=lambda r: -floor[r]):
        told = re.sub(r"^`python -m [^`]*`: ", "", described(room)[0])  # a room has its command's name
        lines.append(f"* `{room}` ({floor[room]}): {told[0].upper()}{told[1:]}")
    return "\n".join(lines)


def with_table(page: str) -> str:
    head, _, rest = page.partition(BEGIN)
    return f"{head}{BEGIN}\n\n{table()}\n\n{END}{rest.partition(END)[2]}"


def lines_of_code(path: Path) -> int:
    """Lines that hold code: no docstring, be it of a constant, no comment, no blank."""
    text = path.read_text(encoding="utf-8")
    told: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            told |= set(range(node.lineno, (node.end_lineno or 0) + 1))
    silent = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    tokens = [t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type not in silent]
    return len({line for t in tokens for line in range(t.start[0], t.end[0] + 1)} - told)


def figures() -> str:
    used = uses()
    lines = [f"rooms {len(used)}, floors {max(floors().values())}, imports between rooms {sum(map(len, used.values()))}"]
    lines += [
        f"{room} uses {', '.join(other for other in declared().rooms if other in used[room]) or 'none'}"
        for room in declared().rooms
    ]
    lines += [f"{wing}: {len(sources(wing))} files, {sum(map(lines_of_code, sources(wing)))} lines of code" for wing in WINGS]
    return "\n".join(lines)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        print(figures())  # noqa: T201
    else:
        page = Path(sys.argv[1])
        page.write_text(with_table(page.read_text(encoding="utf-8")), encoding="utf-8")
