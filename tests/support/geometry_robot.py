"""A robot file that gives the arm's geometry and ranges alone."""

import re
from pathlib import Path

from robots.robot import CATALOGUE


def write_geometry_robot(file: Path, name: str) -> None:
    """The catalogue's robot `name` without accelerations, torques, stiffness, links and payload."""
    text = re.sub(r"\n(acceleration_deg_s2|torque_Nm) = .*", "", (CATALOGUE / f"{name}.toml").read_text())
    start, end = text.index("[stiffness]"), text.find("[[shape]]")
    file.write_text(text[:start] + (text[end:] if end > 0 else ""))
