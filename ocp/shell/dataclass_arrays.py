"""Dataclasses of arrays and numbers as flat dictionaries of arrays and back: what the disk cache can keep without pickles."""

from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

Entry = dict[str, NDArray[np.generic]]
Kind = TypeVar("Kind")


def flattened(value: Any, prefix: str = "") -> Entry:
    """Arrays of everything inside `value` under dotted names: nested dataclasses, lists, arrays, numbers, text, paths.

    None leaves no entry. Raises TypeError for any other content, so that nothing is left out of a key by oversight.
    """
    if value is None:
        return {}
    if is_dataclass(value):
        parts = [(f.name, getattr(value, f.name)) for f in fields(value)]
    elif isinstance(value, list | tuple):
        parts = [(str(i), item) for i, item in enumerate(value)]
    elif isinstance(value, dict):
        parts = [(str(name), item) for name, item in value.items()]
    elif isinstance(value, BaseModel):
        return {prefix: np.array(value.model_dump_json())}
    elif isinstance(value, Path):
        return {prefix: np.array(str(value))}
    elif isinstance(value, np.ndarray | np.generic | int | float | str):
        return {prefix: np.asarray(value)}
    else:
        raise TypeError(f"{prefix}: {type(value).__name__} cannot be kept as arrays")
    return {name: array for key, item in parts for name, array in flattened(item, f"{prefix}.{key}").items()}


def rebuilt(kind: type[Kind], entry: Entry, prefix: str = "") -> Kind:
    """The dataclass `kind` of which `flattened` made `entry`: fields are dataclasses, arrays, numbers or text.

    Raises KeyError where a field without a default is missing.
    """
    hints = get_type_hints(kind)
    values: dict[str, Any] = {}
    for f in fields(kind):  # type: ignore[arg-type]
        name, hint = f"{prefix}.{f.name}", hints[f.name]
        if is_dataclass(hint):
            values[f.name] = rebuilt(hint, entry, name)  # type: ignore[arg-type]
        elif name in entry or (f.default is MISSING and f.default_factory is MISSING):
            array = entry[name]
            values[f.name] = hint(array.item()) if hint in (int, float, str, bool) else array
    return kind(**values)
