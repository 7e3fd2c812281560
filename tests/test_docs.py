"""Pages that are named exist, and every page of docs/ stands once in the index, which the site is made from."""

import re

from tests.support.house import ROOT, with_table

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
SOURCES = [file for wing in ("ocp", "robots", "trajectories", "tests", "benchmarks") for file in (ROOT / wing).rglob("*.py")]


def test_pages_that_are_named_exist():
    pages = {page: page.read_text(encoding="utf-8") for page in [*PAGES, ROOT / "README.md"]}
    linked = [(page, page.parent / to) for page, text in pages.items() for to in re.findall(r"\]\((?!http)([^)#]+)", text)]
    named = [
        (file, ROOT / name)
        for file in [*SOURCES, *pages]
        for name in re.findall(r"(?<![\w/.])docs/[\w/]+\.(?:md|toml|png)", file.read_text(encoding="utf-8"))
    ]
    assert not [f"{file.relative_to(ROOT)}: {to.name}" for file, to in linked + named if not to.exists()]


def test_every_page_stands_in_the_index():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = [line for toc in re.findall(r"```\{toctree\}\n(.*?)```", index, re.DOTALL) for line in toc.split() if line[0] != ":"]
    names = [str(page.relative_to(DOCS).with_suffix("")) for page in PAGES]
    assert sorted(name for name in listed if name in names) == sorted(set(names) - {"index"})


def test_the_table_of_rooms_is_the_sources():
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert with_table(page) == page, "run: python -m tests.support.house docs/architecture.md"
