"""Writing TOML, which the standard library only reads: tables and lists of tables of text, numbers, booleans, lists of these."""

import json
import math
import re
from typing import Any

from robots.errors import BadInput


def toml_text(document: dict[str, Any]) -> str:
    """TOML text that `tomllib` reads back to `document` (numbers to the last bit).

    Raises BadInput: a value that has no TOML form.
    """
    return "\n".join(_lines(document, ())).strip() + "\n"


def _lines(table: dict[str, Any], at: tuple[str, ...]) -> list[str]:
    """Scalars first, because everything after a table's header belongs to that table."""
    plain = {k: v for k, v in table.items() if not isinstance(v, dict) and not _is_tables(v)}
    lines = [f"{_key(k)} = {_value(v, (*at, k))}" for k, v in plain.items()]
    for name, inner in table.items():
        if isinstance(inner, dict):
            path = (*at, name)
            body = _lines(inner, path)
            # A table that holds tables alone needs no header of its own.
            if not inner or any(not isinstance(v, dict) for v in inner.values()):
                body = ["", f"[{'.'.join(map(_key, path))}]", *body]
            lines += body
    for name, each in table.items():
        if _is_tables(each):
            path = (*at, name)
            for inner in each:
                lines += ["", f"[[{'.'.join(map(_key, path))}]]", *_lines(inner, path)]
    return lines


def _is_tables(value: Any) -> bool:
    """A list of tables."""
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(v, dict) for v in value)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _string(name)


def _string(text: str) -> str:
    """A basic string; JSON's escapes are a subset of TOML's, but for DEL, which TOML wants escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any, at: tuple[str, ...]) -> str:
    if hasattr(value, "item") and not isinstance(value, list | tuple) and getattr(value, "ndim", 0) == 0:
        value = value.item()
    elif hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if math.isnan(value):
            return "nan"
        return repr(value) if math.isfinite(value) else ("inf" if value > 0 else "-inf")
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v, at) for v in value) + "]"
    raise BadInput(f"'{'.'.join(at)}' = {value!r} cannot be written as TOML; use text, numbers or lists of these")
