"""The site: `python -m sphinx -W -q -b html docs build/site` (extra group `docs`).

Pages are the .md files; commands come from the command line itself, the Python interface from its docstrings,
effects from their files.
"""

from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx
from typer.main import get_command

from ocp.effects.catalogue import effects_table
from ocp.grindplan.__main__ import whole

project = "grindplan"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
html_theme = "furo"
html_title = project
html_static_path, html_css_files = ["_static"], ["site.css"]
html_show_copyright = False
highlight_language = "none"
smartquotes = False  # two hyphens are an option
autodoc_typehints = "description"
autodoc_preserve_defaults = True
autodoc_class_signature = "separated"  # fields of a result, not how it is made
toc_object_entries = False

EVERYWHERE = ("opened", "as_json", "verbose")  # told once on the page


def _row(option: Any) -> nodes.row:
    """How an argument or option is written, and what it means with its default."""
    default = option.show_default if isinstance(option.show_default, str) else option.default
    shown = "" if default in (None, False, ()) or callable(default) else f" [{default}]"
    cells = nodes.literal(text=", ".join([*option.opts, *option.secondary_opts])), nodes.Text((option.help or "") + shown)
    return nodes.row("", *(nodes.entry("", nodes.paragraph("", "", cell)) for cell in cells))


def _sections(command: Any, name: str) -> list[nodes.section]:
    """A section for a command, or one for each that a group holds."""
    if hasattr(command, "commands"):
        return [part for key, one in command.commands.items() for part in _sections(one, f"{name} {key}")]
    columns = [nodes.colspec(colwidth=width) for width in (25, 75)]
    body = nodes.tbody("", *(_row(one) for one in command.params if one.name not in EVERYWHERE))
    section = nodes.section("", nodes.title(text=name), nodes.paragraph(text=command.help), ids=[nodes.make_id(name)])
    section += nodes.table("", nodes.tgroup("", *columns, body, cols=2))
    section += nodes.paragraph(text=command.epilog)
    return [section]


class Commands(Directive):
    """`{commands}`: every command with what it does, its options and an example, as `--help` has them."""

    def run(self) -> list[nodes.Node]:
        """The sections, in the order of `grindplan --help`."""
        return list(_sections(get_command(whole()), project))


def _with_catalogue(app: Sphinx, name: str, text: list[str]) -> None:
    """`{effects}`: the catalogue's table in its place."""
    text[0] = text[0].replace("```{effects}\n```", effects_table())


def setup(app: Sphinx) -> None:
    """Adds the directive and the hook."""
    app.add_directive("commands", Commands)
    app.connect("source-read", _with_catalogue)
