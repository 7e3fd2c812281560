"""TOML files: reading one against a schema, every fault reported in one sentence with its line; and writing one."""

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from robots.bounds import MEGABYTE, read_whole
from robots.errors import BadInput, shown

Schema = TypeVar("Schema", bound=BaseModel)

MOST_BYTES = 2 * MEGABYTE  # a cell with every effect, patch and covariance has 0.1 MB
DEEPEST = 20  # tables and lists inside each other; a diagnosis writes five
LONGEST_KEY = 300  # characters; a direction that nothing tells apart is named by its parameters' names
LONGEST_TEXT = 20_000  # characters of one string
LARGEST_INTEGER = 2**53  # beyond it a float does not hold an integer
# A dotted name of more parts than DEEPEST: the parser's time grows with their square.
_DOTTED = re.compile(r"(?<![\w\-\"'])(?:[\w\-\"']++[ \t]*+\.[ \t]*+){20}")


class TomlTable(BaseModel):
    """A table of a schema: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


def _this_schema(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(f"{str(value).lower()} is no number; write {SCHEMA}")
    if isinstance(value, int) and value > SCHEMA:
        raise ValueError(f"{value} is of a later release, this one reads {SCHEMA}; install that release, or write {SCHEMA}")
    return value


SCHEMA = 1  # of cell and robot files; an older one, once there is one, is read or refused with what to change
SchemaVersion = Annotated[Literal[1], BeforeValidator(_this_schema), Field(alias="schema")]


def json_schema(table: type[BaseModel], title: str) -> str:
    """The JSON Schema of a file, by which an editor completes and checks it: name it in the first line, `#:schema FILE`."""
    schema = table.model_json_schema(by_alias=True)
    return json.dumps(schema | {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title}, indent=1) + "\n"


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
    """Text and content of a file. Raises BadInput: missing or unreadable, TOML syntax, nested too deep, an integer or a text
    that is too long."""
    try:
        text = read_whole(path, MOST_BYTES, f"an existing {what} file").decode("utf-8-sig")
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8 text") from None
    if found := _DOTTED.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise BadInput(f"{path}, line {line}: {shown(found.group())}: a name of more than {DEEPEST} parts; shorten it")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise BadInput(f"{path}: lists or tables stand more than {DEEPEST} deep in each other; write them flat") from None
    except ValueError as error:  # syntax, and integers that Python does not read
        raise BadInput(f"{path}: not valid TOML: {shown(error, 120)}; {_remedy(text, str(error))}") from None
    _check_values(path, text, data)
    return text, data


def _remedy(text: str, error: str) -> str:
    """What to do about a line that is no TOML: most often a decimal comma."""
    at = re.search(r"at line (\d+)", error)
    line = text.split("\n")[int(at.group(1)) - 1] if at else ""
    comma = re.match(r"[^#\"'\[]*=\s*(-?\d+),(\d+)", line)
    return f"write {comma.group(1)}.{comma.group(2)} with a point" if comma else "correct that line"


def _check_values(path: Path, text: str, data: dict[str, Any]) -> None:
    """Refuse what no file of ours holds, whatever its keys: depth, endless texts, integers beyond floats."""
    left: list[tuple[list[str], Any]] = [([], data)]
    while left:
        keys, value = left.pop()
        fault = _fault(value, len(keys))
        if fault:
            names = [key for key in keys if key]
            raise BadInput(f"{path}, line {_line_of(text, names)}: {shown('.'.join(names), 80)}{fault}")
        if isinstance(value, dict):
            left += [([*keys, key], inner) for key, inner in value.items()]
        elif isinstance(value, list):
            left += [([*keys, ""], inner) for inner in value]


def _fault(value: Any, depth: int) -> str:
    """Why a value can be in no file; empty where it can."""
    if depth > DEEPEST:
        return f": lists or tables stand more than {DEEPEST} deep in each other; write them flat"
    if isinstance(value, dict) and (wrong := [key for key in value if len(key) > LONGEST_KEY]):
        return f": the name {shown(wrong[0])} has more than {LONGEST_KEY} characters; shorten it"
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f": a text of {len(value)} characters, the limit is {LONGEST_TEXT}; shorten it"
    if isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        return f" = {shown(value)}: an integer beyond {LARGEST_INTEGER}; correct it"
    return ""


def _sentence(path: Path, text: str, error: ValidationError, schema: type[BaseModel]) -> str:
    """The first fault as one sentence: file, line, key, value, what was expected. Where a key is missing and its table has one
    that is unknown, the unknown one is told: it is the missing one misspelt."""
    fault, *others = error.errors()
    if fault["type"] == "missing":
        misspelt = (f for f in others if f["type"] == "extra_forbidden" and f["loc"][:-1] == fault["loc"][:-1])
        fault = next(misspelt, fault)
    keys = [str(k) for k in fault["loc"] if not isinstance(k, int) and not _is_union_label(str(k))]
    index = next((k for k in fault["loc"] if isinstance(k, int)), None)
    parts = [f"[{k}]" if isinstance(k, int) else f".{k}" for k in fault["loc"] if not _is_union_label(str(k))]
    name = shown("".join(parts).lstrip("."), 80)
    where = f"{path}, line {_line_of(text, keys, index)}"
    given = fault.get("input")
    if fault["type"] == "extra_forbidden":
        known = _known_keys(schema, keys[:-1])
        return f"{where}: unknown key '{name}'; known here: {known}"
    if fault["type"] == "missing":
        short = " has too few numbers, one" if index is not None and fault["loc"][-1] == index else ""
        return f"{where}: key '{name}'{short} is missing; add it"
    if fault["type"] == "too_long" and isinstance(given, list | tuple):
        point = "write decimals with a point, or " if all(isinstance(one, int | float) for one in given) else ""
        return f"{where}: {name} has {len(given)} entries, expected {fault['ctx']['max_length']}; {point}remove what is too much"
    if isinstance(given, float) and not math.isfinite(given):
        return f"{where}: {name} = {given}: not a finite number; write a number"
    if fault["type"] == "tuple_type" and isinstance(given, dict):
        return f"{where}: [{name}] is a list of tables; write [[{name}]], once for each"
    message = fault["msg"].removeprefix("Value error, ")
    if fault["type"] == "value_error":
        named = re.match(r"[a-z_]+(\.[a-zA-Z_]+)+", message)
        if named and not keys:
            where = f"{path}, line {_line_of(text, named.group().split('.'))}"
        return f"{where}: {name + ': ' if name else ''}{message}"
    return f"{where}: {name} = {shown(repr(given))}: {message[0].lower() + message[1:]}"


def _is_union_label(key: str) -> bool:
    return key == "LinkTarget" or key.startswith(("tuple[", "constrained-"))


def _line_of(text: str, keys: list[str], index: int | None = None) -> int:
    """Line (from 1) of a key, of its table where the key is absent, else 1; of the table number `index` (from 0) in a list."""
    table: list[str] = []
    found, in_list = 1, -1
    for number, whole in enumerate(text.splitlines(), 1):
        line = whole[:300]  # a name ends before
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
    return ", ".join(field.alias or key for key, field in schema.model_fields.items())


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
