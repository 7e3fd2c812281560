"""TOML files: reading one against a schema, every fault reported in one sentence with its line; and writing one."""

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robots.errors import BadInput

Schema = TypeVar("Schema", bound=BaseModel)
Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Vector = tuple[Number, Number, Number]


class TomlTable(BaseModel):
    """A table of a schema: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def read_toml(path: Path, schema: type[Schema], what: str = "cell") -> Schema:
    """Read `path` and validate it as `schema`; what: the kind of file that a path should have led to.

    Raises BadInput: as `parse_toml`, unknown or missing key, wrong type, value out of bounds.
    """
    text, data = parse_toml(path, what)
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise BadInput(_sentence(path, text, error, schema)) from None


def parse_toml(path: Path, what: str) -> tuple[str, dict[str, Any]]:
    """Text and content of a file. Raises BadInput: missing or unreadable, TOML syntax."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give the path of an existing {what} file") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8 text") from None
    try:
        return text, tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{path}: not valid TOML: {error}; correct that line") from None


def _sentence(path: Path, text: str, error: ValidationError, schema: type[BaseModel]) -> str:
    """The first fault as one sentence: file, line, key, value, what was expected."""
    fault = error.errors()[0]
    keys = [str(k) for k in fault["loc"] if not isinstance(k, int) and not _is_union_label(str(k))]
    index = next((k for k in fault["loc"] if isinstance(k, int)), None)
    parts = [f"[{k}]" if isinstance(k, int) else f".{k}" for k in fault["loc"] if not _is_union_label(str(k))]
    name = "".join(parts).lstrip(".")
    where = f"{path}, line {_line_of(text, keys, index)}"
    given = fault.get("input")
    if fault["type"] == "extra_forbidden":
        known = _known_keys(schema, keys[:-1])
        return f"{where}: unknown key '{name}'; known here: {known}"
    if fault["type"] == "missing":
        short = " has too few numbers, one" if index is not None and fault["loc"][-1] == index else ""
        return f"{where}: key '{name}'{short} is missing; add it"
    if fault["type"] == "too_long" and isinstance(given, list | tuple):
        return f"{where}: {name} has {len(given)} entries, expected {fault['ctx']['max_length']}; remove what is too much"
    if isinstance(given, float) and not math.isfinite(given):
        return f"{where}: {name} = {given}: not a finite number; write a number"
    message = fault["msg"].removeprefix("Value error, ")
    if fault["type"] == "value_error":
        named = re.match(r"[a-z_]+(\.[a-zA-Z_]+)+", message)
        if named and not keys:
            where = f"{path}, line {_line_of(text, named.group().split('.'))}"
        return f"{where}: {name + ': ' if name else ''}{message}"
    shown = repr(given)
    shown = shown if len(shown) < 80 else f"{shown[:60]}.."
    return f"{where}: {name} = {shown}: {message[0].lower() + message[1:]}"


def _is_union_label(key: str) -> bool:
    return key == "LinkTarget" or key.startswith(("tuple[", "constrained-"))


def _line_of(text: str, keys: list[str], index: int | None = None) -> int:
    """Line (from 1) of a key, of its table where the key is absent, else 1; of the table number `index` (from 0) in a list."""
    table: list[str] = []
    found, in_list = 1, -1
    for number, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*\[{1,2}\s*([^\[\]]+?)\s*\]", line)
        if header:
            table = [part.strip().strip('"') for part in header.group(1).split(".")]
            if line.lstrip().startswith("[[") and table == keys[: len(table)]:
                in_list += 1
                table = table if index in (None, in_list) else [""]  # another one of the list
            if table == keys[: len(table)]:
                found = number
            continue
        assigned = re.match(r'\s*"?([\w.-]+)"?\s*=', line)
        if assigned and [*table, *assigned.group(1).split(".")] == keys[: len(table) + 1]:
            found = number
            if len(table) + 1 == len(keys):
                return number
    return found


def _known_keys(schema: type[BaseModel], keys: list[str]) -> str:
    """Names that the table at `keys` accepts."""
    for key in keys:
        field = schema.model_fields.get(key)
        if field is None:
            continue
        for option in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(option, type) and issubclass(option, BaseModel):
                schema = option
    return ", ".join(schema.model_fields)


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
