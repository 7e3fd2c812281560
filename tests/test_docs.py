"""Pages that are named exist, and every page of docs/ stands once in the index, which the site is made from."""

import re
from collections.abc import Iterator
from typing import Any

from typer.main import get_command

from ocp.grindplan.__main__ import whole
from tests.support.house import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
MOST_WORDS = 25_000  # the owner's limit
SOURCES = [file for wing in ("ocp", "robots", "trajectories", "tests", "benchmarks") for file in (ROOT / wing).rglob("*.py")]


def _leaves(commands: dict[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, one in commands.items():
        if hasattr(one, "commands"):
            yield from _leaves(one.commands, (*above, name))
        else:
            yield (*above, name), one


def test_pages_that_are_named_exist():
    pages = {page: page.read_text(encoding="utf-8") for page in [*PAGES, ROOT / "README.md"]}
    linked = [(page, page.parent / to) for page, text in pages.items() for to in re.findall(r"\]\((?!http)([^)#]+)", text)]
    named = [
        (file, ROOT / name)
        for file in [*SOURCES, *pages]
        for name in re.findall(r"(?<![\w/.])docs/[\w/]+\.(?:md|toml|png)", file.read_text(encoding="utf-8"))
    ]
    assert not [f"{file.relative_to(ROOT)}: {to.name}" for file, to in linked + named if not to.exists()]


def test_every_page_stands_in_the_index_and_begins_with_what_it_is_good_for():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = [line for toc in re.findall(r"```\{toctree\}\n(.*?)```", index, re.DOTALL) for line in toc.split() if line[0] != ":"]
    names = [str(page.relative_to(DOCS).with_suffix("")) for page in PAGES]
    assert sorted(name for name in listed if name in names) == sorted(set(names) - {"index"})
    begins = {page.name: page.read_text(encoding="utf-8").split("\n\n")[1] for page in PAGES}
    assert not [f"{name} begins with: {text[:60]}" for name, text in begins.items() if not text[0].isalpha()]


def test_commands_in_the_pages_have_the_options_they_are_given():
    commands = get_command(whole()).commands
    known = {
        " ".join(words): {name for option in one.params for name in [*option.opts, *option.secondary_opts]} | {"--help"}
        for words, one in _leaves(commands)
    }
    asked = re.compile(r"(?:python -m ocp\.|grindplan )([a-z]+(?: (?:new|check|show|import))?)\b([^`\n#|]*)")
    wrong = []
    for page in [*PAGES, ROOT / "README.md"]:
        for name, rest in asked.findall(re.sub(r"\[([^\]\n]*)\]\(", "(", page.read_text(encoding="utf-8"))):
            if name in known:
                wrong += [
                    f"{page.name}: {name} {o}" for o in re.findall(r"(?<!\S)\[?(--?[a-z][a-z-]*)", rest) if o not in known[name]
                ]
    assert not wrong


def test_files_in_the_pages_exist():
    paths = re.compile(
        r"(?<![\w/.*])((?:ocp|robots|trajectories|tests|benchmarks)/[\w./]+\.(?:py|toml|stl)|-m (?:benchmarks|tests)\.[\w.]+)"
    )
    missing = []
    for page in PAGES:
        for name in paths.findall(page.read_text(encoding="utf-8")):
            file = name[3:].rstrip(".").replace(".", "/") + ".py" if name.startswith("-m ") else name
            missing += [] if (ROOT / file).exists() else [f"{page.name}: {name}"]
    assert not missing


def test_the_documentation_stays_as_long_as_it_is_read():
    """At most MOST_WORDS in all pages as `wc -w` counts: everything between blanks, signs and bars of tables too."""
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in PAGES}
    assert 20_000 < sum(words.values()) <= MOST_WORDS, sorted(words.items(), key=lambda item: -item[1])
