"""Lists of docs/formats.md and the JSON Schemas of docs/schema, made from what the readers use.
`python -m tests.support.formats` writes them."""

import json
import re
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from itertools import groupby
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel

from ocp.data import CELL
from ocp.diagnose.document import Document
from ocp.model.cell_schema import CellTables
from ocp.model.columns import TABLES, Columns
from robots.bounds import column_bounds
from robots.robot import CATALOGUE, RobotTables
from robots.toml_files import json_schema
from tests.support.house import ROOT

PAGE, SCHEMAS = ROOT / "docs" / "formats.md", ROOT / "docs" / "schema"
KINDS: dict[str, tuple[type[BaseModel], Any]] = {
    "cell.toml": (CellTables, CELL),
    "robot.toml": (RobotTables, CATALOGUE / "kr210_r2700_extra.toml"),
}
UNITS = {
    "um_mm2_per_N_m": "um mm^2/(N m)",
    "N_per_mm": "N/mm",
    "um_per_m": "um/m",
    "kg_m3": "kg/m^3",
    "kg_m2": "kg m^2",
    "Nm_per_rad": "N m/rad",
    "mm_s": "mm/s",
    "m_s": "m/s",
    "deg_s2": "deg/s^2",
    "deg_s": "deg/s",
    "Nm": "N m",
    "hz": "1/s",
    "mm_at_rated": "mm",
    **{name: name for name in ("mm", "um", "deg", "GPa", "MPa", "ms", "kg", "N", "C", "s")},
}
OURS = ("plan.csv", "predictions_tracker.csv", "residuals.csv")  # files that nobody writes but the commands
ENDLESS = 1e6  # a bound from here on is against slips alone


def unit(key: str) -> str:
    """A key's unit where its name does not end with it letter for letter: of `feed_mm_s`, not of `force_N`."""
    name, told = next(((name, told) for name, told in UNITS.items() if key.endswith("_" + name)), ("", ""))
    return "" if name == told else told


def inner_tables(annotation: Any) -> list[type[BaseModel]]:
    """Schemas that stand in a key's type."""
    found = [annotation] if isinstance(annotation, type) and issubclass(annotation, BaseModel) else []
    return found + [table for argument in get_args(annotation) for table in inner_tables(argument)]


def kind(annotation: Any, schema: dict[str, Any]) -> str:
    """A key's type and range in words, from its JSON schema."""
    options = [s for s in schema.get("anyOf", [schema]) if s.get("type") != "null"]
    told = []
    for one in options:
        if "const" in one or "enum" in one:
            told.append(_choice(one.get("enum", [one.get("const")])))
        elif one.get("type") == "array":
            told.append(_array(one))
        elif one.get("type") in ("number", "integer"):
            told.append(_range(one))
        else:
            told.append({"string": "text", "boolean": "true, false"}.get(one.get("type", ""), "table"))
    return "; ".join(dict.fromkeys(told))


def _choice(values: list[Any]) -> str:
    names = [json.dumps(v) for v in values]
    return ", ".join(names) if len(names) < 7 else f"{len(names)} names, {names[0]} .. {names[-1]}"


def _range(one: dict[str, Any]) -> str:
    low, high = (one.get(k, one.get(f"exclusive{k.capitalize()}")) for k in ("minimum", "maximum"))
    return bounds(low, high) or ("whole number" if one["type"] == "integer" else "number")


def bounds(low: float | None, high: float | None) -> str:
    """Least and most as 0..20 or +-20, those that are meant; one of them alone as >= 0 or <= 20."""
    least, most = (v if v is not None and abs(v) < ENDLESS else None for v in (low, high))
    if least is None or most is None:
        return f">= {least:g}" if least is not None else f"<= {most:g}" if most is not None else ""
    return f"+-{most:g}" if least == -most else f"{least:g}..{most:g}"


def _array(one: dict[str, Any]) -> str:
    items = one.get("prefixItems")
    inside = kind(None, (items or [one.get("items", {})])[0])
    if not items:
        return f"list of {inside}"
    return f"[{len(items)}] {inside}"


@dataclass(frozen=True)
class Key:
    """A key of a table: its range with its unit, its default, an example where it has none, its meaning."""

    name: str
    range: str
    default: str
    example: str = field(compare=False)
    meaning: str


def keys(table: type[BaseModel], example: dict[str, Any]) -> list[Key]:
    """What a table holds beside tables of its own."""
    schema = table.model_json_schema(by_alias=True)
    found = []
    for name, one in table.model_fields.items():
        key = one.alias or name
        if inner_tables(one.annotation) and "targets" not in key:
            continue
        told = " ".join(filter(None, (kind(one.annotation, schema["properties"][key]), unit(key))))
        known = None if one.is_required() else one.get_default(call_default_factory=True)
        default = "needed" if one.is_required() else "" if known is None or known == {} else _shown(known)
        value = example.get(key, (one.examples or [None])[0])
        shown = "" if value is None or default not in ("", "needed") else f"`{_shown(value)}`"
        found.append(Key(key, told, default, shown, " ".join((one.description or "").split()).rstrip(".")))
    return found


def _shown(value: Any) -> str:
    """A value as TOML has it, whole numbers without a point; of more than three numbers the first two, of a table one key."""
    if isinstance(value, list | tuple):
        told = [_shown(v) for v in value]
        return f"[{', '.join(told if len(told) < 4 else [*told[:2], '..'])}]"
    if isinstance(value, dict):
        told = [f"{key} = {_shown(v)}" for key, v in value.items()]
        return f"{{ {', '.join([*told[:1], *(['..'] if len(told) > 1 else [])])} }}"
    whole = isinstance(value, float) and value.is_integer()
    return json.dumps(int(value) if whole else value).replace("Infinity", "infinite")


def schema_tables(file: str) -> str:
    """Every key of a TOML file, a line for each of its tables before them; a key that is alike in more than two tables is told
    once, at the end."""
    root, path = KINDS[file]
    found, left = [], [(root, "", "", "", tomllib.loads(path.read_text()))]
    while left:
        table, name, needed, words, values = left.pop(0)
        found.append((name, needed, words, keys(table, values)))
        for key, one in table.model_fields.items():
            for inner in dict.fromkeys(inner_tables(one.annotation)):
                if any(inner is other for other, *_ in left):
                    continue
                value = values.get(key, {})
                many = get_origin(_plain(one.annotation)) is tuple
                named = get_origin(_plain(one.annotation)) is dict
                value = next(iter(value), {}) if many else next(iter(value.values()), {}) if named and value else value
                alike = [k for k, other in table.model_fields.items() if inner in inner_tables(other.annotation)]
                full = [".".join(filter(None, (name.strip("[]"), k))) + (".NAME" if named else "") for k in alike]
                ends = dict.fromkeys(f"[[{k}]]" if many else f"[{k}]" for k in (full[0], full[-1]))
                told = _docstring(inner) if len(alike) > 1 or "targets" in key else (one.description or "")
                needed = "needed" if one.is_required() else ""
                left.append((inner, "` .. `".join(ends), needed, told.rstrip("."), value if isinstance(value, dict) else {}))
    often = [key for key, n in Counter(key for *_, held in found for key in held).items() if n > 2]
    text = []
    for name, needed, words, held in found:
        text += ["", f"**`{name}`**{needed and f' ({needed})'}: {words}.", ""] if name else []
        text += _rows([key for key in held if key not in often])
    text += [""] if often else []
    for told in often:
        where = ", ".join(f"`{name}`" for name, *_, held in found if told in held)
        text += [f"{where} have `{told.name}` too ({told.range}, {told.default}): {told.meaning}."]
    return "\n".join(text).strip()


def _rows(held: list[Key]) -> list[str]:
    """An item a key; keys that follow each other and differ by name and example alone share one."""
    rows = []
    for (told, default, meaning), run in groupby(held, key=lambda k: (k.range, k.default, k.meaning)):
        alike = list(run)
        names = ", ".join(f"`{k.name}`" for k in alike)
        held = "; ".join(filter(None, (told, default, alike[0].example)))
        rows.append(f"* {names} ({held}): {meaning}")
    return rows


def _plain(annotation: Any) -> Any:
    if get_origin(annotation) in (Union, UnionType):
        return next(a for a in get_args(annotation) if a is not NoneType)
    return annotation


def _docstring(table: type[BaseModel]) -> str:
    """What a table's docstring says of it beside its name."""
    words = " ".join((table.__doc__ or "").split())
    words = words.split("`", 2)[2].lstrip(".:, ") if words.startswith("`[") else words
    return words[:1].upper() + words[1:]


def column_table(file: str) -> str:
    """Every column of a CSV file; whether it is needed and its range, of a file that somebody else writes."""
    rows = []
    for group in TABLES[file]:
        low, high, _ = column_bounds(group.names[0])
        words = not group.example.replace(".", "").lstrip("-").isdigit()
        held = "text" if words else " ".join(filter(None, (bounds(low, high), unit(group.names[0]))))
        asked = [] if file in OURS else [held, "needed" if group.needed else ""]
        rows.append(f"* {_names(group)} ({'; '.join(filter(None, (*asked, f'`{group.example}`')))}): {group.meaning}")
    return "\n".join(rows)


def _names(group: Columns) -> str:
    names = group.names
    row = len(names) > 3 or [re.sub("_[a-z]{2,}$", "", name)[-1] for name in names] == ["x", "y", "z"]
    return f"`{names[0]}` .. `{names[-1]}`" if row else ", ".join(f"`{n}`" for n in names)


def filled(page: str) -> str:
    """The page with every table made anew. Raises ValueError where a table's marks are missing."""
    for file in (*KINDS, *TABLES):
        begin, end = f"<!-- {file}: python -m tests.support.formats -->", f"<!-- end of {file} -->"
        before, rest = page.split(begin)
        table = schema_tables(file) if file in KINDS else column_table(file)
        page = f"{before}{begin}\n\n{table}\n\n{end}{rest.split(end)[1]}"
    return page


def told_keys(file: str) -> set[str]:
    """Keys of the list under the page's **file**: what stands before an item's colon."""
    table = PAGE.read_text().split(f"**{file}**")[1].split("\n\n")[1]
    return {name for row in table.splitlines() if row[0] == "*" for name in re.findall("`([^`]+)`", row.split(": ")[0])}


def schemas() -> dict[str, str]:
    """Text of the JSON Schema by file name."""
    tables = {**{file: table for file, (table, _) in KINDS.items()}, "diagnosis.json": Document}
    return {f"{file.partition('.')[0]}.schema.json": json_schema(table, file) for file, table in tables.items()}


if __name__ == "__main__":
    SCHEMAS.mkdir(exist_ok=True)
    for name, text in schemas().items():
        (SCHEMAS / name).write_text(text)
    PAGE.write_text(filled(PAGE.read_text()))
