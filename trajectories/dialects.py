"""The languages that programs can be written in. A new one is a folder like `krl/`, an entry here, and its name among the
choices of `dialect` in ocp/model/cell_schema.py (docs/krl.md)."""

from robots.errors import BadInput
from trajectories.krl.dialect import KRL
from trajectories.program.dialect import Dialect

DIALECTS: dict[str, Dialect] = {dialect.name: dialect for dialect in (KRL,)}


def dialect_named(name: str) -> Dialect:
    """The dialect of a name (`controller.dialect` of cell.toml). Raises BadInput for a name that is not listed."""
    if name not in DIALECTS:
        raise BadInput(f"controller.dialect = {name!r} is not one of {', '.join(DIALECTS)}")
    return DIALECTS[name]
