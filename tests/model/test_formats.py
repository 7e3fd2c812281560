"""docs/formats.md and docs/schema say what the readers read."""

import json
import re
import tomllib
from typing import Annotated

import pytest
from pydantic import TypeAdapter

from ocp.calibrate.force import log as force
from ocp.data import CELL
from ocp.diagnose.document import Document
from ocp.diagnose.joints import log as joints
from ocp.model.cell import read_cell
from ocp.model.cell_schema import CellTables, EffectTable, PatchTable
from ocp.model.columns import TABLES
from ocp.plan.removal import wanted
from ocp.update import removal
from robots import tracker_readings as tracker
from robots.errors import BadInput
from tests.support.formats import KINDS, PAGE, SCHEMAS, filled, inner_tables, schemas, told_keys
from trajectories import path_points

READERS = {
    "tracker.csv": ((*tracker.AXES, *tracker.POINT), (*tracker.OPTIONAL,)),
    "force.csv": (("run", "time_s", *force.AXES, *force.POINT, *force.NORMAL, *force.FEED, "fn_N"), force.OPTIONAL),
    "joints.csv": (("run", "time_s", *joints.AXES), (*joints.LINK, *joints.TORQUE, *joints.SPEED)),
    "path.csv": (path_points.NEEDED, path_points.OPTIONAL),
    "removal.csv": ((*removal.PLACES, *removal.DEPTH), removal.OPTIONAL),
    "stock.csv": (wanted.COLUMNS, ()),
}


@pytest.mark.parametrize("file", READERS)
def test_the_columns_are_those_that_the_reader_takes(file):
    must, may = READERS[file]
    named = {must: {name for group in TABLES[file] if group.needed == must for name in group.names} for must in (True, False)}
    assert named == {True: set(must), False: set(may) - set(must)}


def test_every_column_stands_once_in_its_file():
    for groups in TABLES.values():
        names = [name for group in groups for name in group.names]
        assert len(names) == len(set(names))


def test_the_page_has_the_tables_as_the_code_has_them():
    page = PAGE.read_text()
    assert page == filled(page), "run python -m tests.support.formats"


def test_the_schemas_are_those_of_the_code_and_every_key_says_what_it_means():
    for name, text in schemas().items():
        assert (SCHEMAS / name).read_text() == text, "run python -m tests.support.formats"
        whole = json.loads(text)
        for table in [whole, *whole["$defs"].values()]:
            for key, field in table["properties"].items():
                assert field.get("description"), key


def test_every_key_has_a_default_or_an_example_that_the_reader_takes():
    for root, _ in KINDS.values():
        tables = [root]
        for table in tables:
            for one in table.model_fields.values():
                tables += [inner for inner in inner_tables(one.annotation) if inner not in tables]
                for example in one.examples or []:
                    TypeAdapter(Annotated[one.annotation, one]).validate_python(example)
    items = [
        line for line in PAGE.read_text().split("<!-- end of robot.toml -->")[0].splitlines() if re.match(r"\* `\w+`.* \(", line)
    ]
    empty = [line for line in items if re.match(r"[^(]*\([^;]*\):|.*; needed\):", line)]
    assert len(items) > 100
    assert not empty
    believed = {
        name: [{key: one.examples[0] for key, one in table.model_fields.items() if one.examples and key != "about"}]
        for name, table in (("effects", EffectTable), ("patches", PatchTable))
    }
    believed["effects"][0]["half_width_rad"] = 1e-4  # a key of its own
    assert len(CellTables.model_validate(tomllib.loads(CELL.read_text()) | believed).believed) == 2


@pytest.mark.parametrize(
    ("version", "told"),
    [("2", "2 is of a later release, this one reads 1"), ("0", "should be 1"), ('"1"', "should be 1"), ("true", "write 1")],
)
def test_a_file_of_another_version_is_refused_with_its_line(tmp_path, version, told):
    (tmp_path / "cell.toml").write_text(f"# a cell\nschema = {version}\n" + CELL.read_text())
    with pytest.raises(BadInput, match="cell.toml, line 2: schema") as error:
        read_cell(tmp_path / "cell.toml")
    assert told in str(error.value)


def test_a_file_of_this_version_is_read_with_the_version_or_without(tmp_path):
    (tmp_path / "cell.toml").write_text("schema = 1\n" + CELL.read_text())
    assert read_cell(tmp_path / "cell.toml").tables == read_cell(CELL).tables


def test_the_keys_of_an_answer_are_those_that_are_written():
    assert told_keys("diagnosis.json") == {one.alias or name for name, one in Document.model_fields.items()}
