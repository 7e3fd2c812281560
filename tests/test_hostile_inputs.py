"""Every reader gives a value or one sentence, whatever stands in its file: 500 inputs each, ten thousand each by
`python -m benchmarks.hostile_inputs`."""

import ast
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.support.hostile_inputs import ELSEWHERE, READERS, HostileReader, lay, mutant, outcome, texts
from tests.support.house import sources

MUTANTS, TEXTS, SEED = 470, 30, 1


@pytest.fixture
def at_hand(tmp_path) -> Iterator[Path]:
    """A folder in memory where the machine has one: twenty thousand files are written and removed."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.kind)
def test_five_hundred_inputs_are_read_or_refused_in_a_sentence(reader: HostileReader, at_hand):
    lay(reader, at_hand)
    found: dict[str, list[object]] = {}
    for number in range(MUTANTS):
        found.setdefault(outcome(reader, at_hand, mutant(reader, SEED, number)), []).append(number)
    texts(reader, at_hand, TEXTS, SEED, lambda came, data: found.setdefault(came, []).append(data[-200:]))
    assert 0 in found["worked"], "the valid file itself is refused"
    wrong = {came: inputs[:3] for came, inputs in found.items() if came not in ("worked", "refused")}
    assert not wrong, f"seed {SEED}: {wrong}"


def readers_of_the_tree() -> set[str]:
    """Functions named read_* that take a path."""
    found = set()
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("read_"):
                kinds = [ast.unparse(a.annotation) for a in node.args.args if a.annotation is not None]
                if any("Path" in kind or kind == "DataSet" for kind in kinds):
                    found.add(node.name)
    return found


def test_every_reader_of_the_tree_is_tried():
    tried = {name for reader in READERS for name in reader.names}
    assert readers_of_the_tree() == tried | set(ELSEWHERE)
    assert not tried & set(ELSEWHERE)


def test_inputs_are_made_again_from_seed_and_number():
    reader = READERS[0]
    again = [mutant(reader, 7, number) for number in range(20)]
    assert again == [mutant(reader, 7, number) for number in range(20)]
    assert Counter(again).most_common(1)[0][1] < 5 and again[1:] != [mutant(reader, 8, number) for number in range(1, 20)]
