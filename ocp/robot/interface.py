"""A robot file of one's own, written into a folder: from the template, or from a URDF."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ocp.shell.output import whole_folder
from robots.errors import BadInput, shown
from robots.robot import Robot, RobotTables, left_out_notices, load_robot
from robots.toml_files import json_schema, toml_text
from robots.urdf import read_urdf

SCHEMA_FILE = "robot.schema.json"
_TEMPLATE = Path(__file__).parent / "template.toml"
_HEAD = "# Made from {name} by python -m ocp.robot import. Millimetres, degrees, kilograms; frames: docs/robot.md.\n\n"


@dataclass(frozen=True)
class RobotResult:
    """A robot file that was written: its folder, the robot as it reads, and the one line about it."""

    folder: Path
    robot: Robot
    line: str
    notices: tuple[str, ...]


def new_robot(name: str, *, out: str | Path = "robot", overwrite: bool = False) -> RobotResult:
    """Write the template of a robot file called `name` into `out`. Raises BadInput: a name that no file may have."""
    _refuse_name(name)
    text = _TEMPLATE.read_text(encoding="utf-8").replace("{name}", name)
    robot = _written(name, text, Path(out), overwrite, [])
    file = Path(out) / f"{name}.toml"
    line = (
        f"{file}: a geometry of example numbers; replace them by your data sheet's, then name the file as robot.model in a cell"
    )
    return RobotResult(Path(out), robot, line, tuple(left_out_notices(robot)))


def import_robot(
    urdf: str | Path, *, out: str | Path = "robot", flange: str | None = None, name: str | None = None, overwrite: bool = False
) -> RobotResult:
    """Write the robot file of a URDF into `out`; flange: link that the tool is screwed to; name: the robot's.

    Raises BadInput as `read_urdf`, and a name that no file may have.
    """
    arm = read_urdf(Path(urdf), flange)
    tables: dict[str, Any] = arm.tables if name is None else arm.tables | {"name": name, "title": name}
    _refuse_name(tables["name"])
    text = _HEAD.format(name=Path(urdf).name) + toml_text(tables)
    robot = _written(tables["name"], text, Path(out), overwrite, [Path(urdf)])
    line = f"{Path(out) / tables['name']}.toml: six axes in MD-H form, the same flange as the URDF's at 100 postures"
    return RobotResult(Path(out), robot, line, (*arm.notices, *left_out_notices(robot)))


def _written(name: str, text: str, out: Path, overwrite: bool, inputs: list[Path]) -> Robot:
    """The robot of a file that was written into `out`, and read before it stood there."""
    with whole_folder(out, overwrite, inputs) as folder:
        file = folder / f"{name}.toml"
        file.write_text(f"#:schema {SCHEMA_FILE}\n{text}", encoding="utf-8")
        (folder / SCHEMA_FILE).write_text(json_schema(RobotTables, "robot.toml"), encoding="utf-8")
        try:
            return load_robot(file)
        except BadInput as error:  # the temporary file is gone when this is read, and a line of it is none of the input's
            place = re.compile(re.escape(str(file)) + r"(, line \d+)?")
            raise BadInput(place.sub(lambda _: inputs[0].name if inputs else file.name, str(error))) from None


def _refuse_name(name: str) -> None:
    sound = name.isascii() and 0 < len(name) <= 100 and all(c.isalnum() or c in "_.-" for c in name) and name.strip(".") != ""
    if not sound:
        raise BadInput(f"robot '{shown(name)}': give a name of letters, digits, _ . -")
