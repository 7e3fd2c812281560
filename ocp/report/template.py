"""Pages are filled by one escaping template engine; their security policy names own scripts and styles by hash."""

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2


def fill(template: Path, **values: Any) -> str:
    """A template as text: values are escaped, a name without a value is an error, equal values give equal text."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template.parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template.name).render(**values)


def joined(files: Sequence[Path]) -> str:
    """Scripts or styles, one after the other."""
    return "\n".join(file.read_text(encoding="utf-8") for file in files)


def source_hash(source: str) -> str:
    """As a content security policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(source.encode()).digest()).decode("ascii")
