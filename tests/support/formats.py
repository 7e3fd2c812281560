"""Tables of docs/formats.md and the JSON Schemas of docs/schema, made from what the readers use.
`python -m tests.support.formats` writes them."""

import json
import tomllib
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel

from ocp.data import CELL
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
    **{name: name for name in ("mm", "um", "deg", "GPa", "MPa", "ms", "kg", "N", "C", "s")},
}
ENDLESS = 1e6  # a bound from here on is against slips alone


def unit(key: str) -> str:
    return next((told for name, told in UNITS.items() if key.endswith("_" + name)), "")


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
            told.append(" or ".join(json.dumps(v) for v in one.get("enum", [one.get("const")])))
        elif one.get("type") == "array":
            told.append(_array(one))
        elif one.get("type") in ("number", "integer"):
            told.append(_range(one))
        else:
            told.append({"string": "text", "boolean": "true, false"}.get(one.get("type", ""), "a table"))
    return "; ".join(dict.fromkeys(told))


def _range(one: dict[str, Any]) -> str:
    low, high = (one.get(k, one.get(f"exclusive{k.capitalize()}")) for k in ("minimum", "maximum"))
    words = "whole number" if one["type"] == "integer" else "number"
    return bounds(low, high) or words


def bounds(low: float | None, high: float | None) -> str:
    """Least and most in words, those that are meant."""
    told = [v if v is not None and abs(v) < ENDLESS else None for v in (low, high)]
    if told == [None, None]:
        return ""
    return f"from {told[0]:g}" if told[1] is None else f"to {told[1]:g}" if told[0] is None else f"{told[0]:g} to {told[1]:g}"


def _array(one: dict[str, Any]) -> str:
    items = one.get("prefixItems") or [one.get("items", {})]
    inside = kind(None, items[0])
    many = f"{len(items)} of " if "prefixItems" in one else "list of "
    return f"{many}{inside}"


def key_rows(table: type[BaseModel], example: dict[str, Any]) -> list[str]:
    schema = table.model_json_schema(by_alias=True)
    rows = []
    for name, field in table.model_fields.items():
        key = field.alias or name
        inside = inner_tables(field.annotation)
        told = "a table, below" if inside and "targets" not in key else kind(field.annotation, schema["properties"][key])
        default = (
            "needed"
            if field.is_required()
            else "none"
            if field.default is None
            else _shown(field.get_default(call_default_factory=True))
        )
        default = "none" if inside and default != "needed" else default
        value = example.get(key)
        shown = "" if value is None or isinstance(value, dict) or inside else f"`{_shown(value)}`"
        rows.append(f"| `{key}` | {unit(key)} | {told} | {default} | {shown} | {' '.join((field.description or '').split())} |")
    return rows


def _shown(value: Any) -> str:
    if isinstance(value, BaseModel | dict):
        return "none"
    return json.dumps(value.model_dump() if isinstance(value, BaseModel) else value).replace("Infinity", "infinite")


def schema_tables(file: str) -> str:
    """Every table of a TOML file with its keys."""
    root, path = KINDS[file]
    example = tomllib.loads(path.read_text())
    text, left = [], [(root, "", example)]
    while left:
        table, name, values = left.pop(0)
        text += [
            " ".join(filter(None, (f"**`{name}`**" if name else "", _first(table)))),
            "",
            "| key | unit | range | default | example | meaning |",
            "|---|---|---|---|---|---|",
        ]
        text += [*key_rows(table, values), ""]
        for key, field in table.model_fields.items():
            for inner in dict.fromkeys(inner_tables(field.annotation)):
                if any(inner is other for other, _, _ in left) or f"[{key}" in "".join(text[-1:]):
                    continue
                value = values.get(key, {})
                many = get_origin(_plain(field.annotation)) is tuple
                named = get_origin(_plain(field.annotation)) is dict
                value = next(iter(value), {}) if many else next(iter(value.values()), {}) if named and value else value
                full = ".".join(filter(None, (name.strip("[]"), key))) + (".NAME" if named else "")
                left.append((inner, f"[[{full}]]" if many else f"[{full}]", value if isinstance(value, dict) else {}))
    return "\n".join(text).rstrip()


def _plain(annotation: Any) -> Any:
    if get_origin(annotation) in (Union, UnionType):
        return next(a for a in get_args(annotation) if a is not NoneType)
    return annotation


def _first(table: type[BaseModel]) -> str:
    """What a table's docstring says of it beside its name."""
    words = " ".join((table.__doc__ or "").split())
    words = words.split("`", 2)[2].lstrip(".:, ") if words.startswith("`[") else words
    return words[:1].upper() + words[1:]


def column_table(file: str) -> str:
    """Every column of a CSV file."""
    rows = ["| column | unit | range | needed | example | meaning |", "|---|---|---|---|---|---|"]
    for group in TABLES[file]:
        low, high, _ = column_bounds(group.names[0])
        words = not group.example.replace(".", "").lstrip("-").isdigit()
        cells = (
            unit(group.names[0]),
            "text" if words else bounds(low, high),
            "yes" if group.needed else "no",
            f"`{group.example}`",
        )
        rows.append(f"| {' | '.join((_names(group), *cells, group.meaning))} |")
    return "\n".join(rows)


def _names(group: Columns) -> str:
    names = group.names
    return f"`{names[0]}` .. `{names[-1]}`" if len(names) > 4 else ", ".join(f"`{n}`" for n in names)


def filled(page: str) -> str:
    """The page with every table made anew. Raises ValueError where a table's marks are missing."""
    for file in (*KINDS, *TABLES):
        begin, end = f"<!-- {file}: python -m tests.support.formats -->", f"<!-- end of {file} -->"
        before, rest = page.split(begin)
        table = schema_tables(file) if file in KINDS else column_table(file)
        page = f"{before}{begin}\n{table}\n{end}{rest.split(end)[1]}"
    return page


def schemas() -> dict[str, str]:
    """Text of the JSON Schema by file name."""
    return {f"{file.removesuffix('.toml')}.schema.json": json_schema(table, file) for file, (table, _) in KINDS.items()}


if __name__ == "__main__":
    SCHEMAS.mkdir(exist_ok=True)
    for name, text in schemas().items():
        (SCHEMAS / name).write_text(text)
    PAGE.write_text(filled(PAGE.read_text()))
