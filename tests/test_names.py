"""One word names one thing: public names stand once, but for the verbs that a protocol asks of each of its parts."""

import ast
from collections import defaultdict
from pathlib import Path

from tests.support.house import ROOT, sources

VERBS = {"last_line": "a command: the one line that says what was written and whether it is safe to use"}
MARK = "# fmt" + ": "  # not itself one of them


def public_names(kind: type[ast.AST]) -> dict[str, list[Path]]:
    """Files by public name of the classes or functions at their top."""
    found = defaultdict(list)
    for path in sources():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, kind) and not node.name.startswith("_"):  # type: ignore[attr-defined]
                found[node.name].append(path.relative_to(ROOT))  # type: ignore[attr-defined]
    return found


def test_no_public_class_name_stands_twice():
    twice = {name: places for name, places in public_names(ast.ClassDef).items() if len(places) > 1}
    assert not twice


def test_no_public_function_name_stands_twice_but_for_the_verbs_of_a_protocol():
    twice = {name: places for name, places in public_names(ast.FunctionDef).items() if len(places) > 1 and name not in VERBS}
    assert not twice


def test_every_verb_is_asked_of_several():
    functions = public_names(ast.FunctionDef)
    assert [verb for verb in VERBS if len(functions[verb]) < 2] == []


def test_the_formatter_is_overruled_in_few_places():
    marked = [path for path in (*sources(), *(ROOT / "tests").rglob("*.py")) if MARK in path.read_text(encoding="utf-8")]
    assert sum(path.read_text(encoding="utf-8").count(MARK) for path in marked) <= 10, marked
