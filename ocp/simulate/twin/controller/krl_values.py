"""Numbers, aggregates and frames as KRL writes them."""

import re

import numpy as np

from robots.errors import BadInput
from robots.pose import Array, transform_from_xyzabc

AXIS_LETTERS = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE_LETTERS = ("X", "Y", "Z", "A", "B", "C")
_ALLOWED = {*AXIS_LETTERS, *POSE_LETTERS, "S", "T", *(f"E{i}" for i in range(1, 7))}
_NUMBER = re.compile(r"^[-+]?(\d+(\.\d*)?|\.\d+)(E[-+]?\d+)?$")


def number(where: str, text: str) -> float:
    """A number as KRL knows it; `where` names file and line. Raises BadInput."""
    if not _NUMBER.match(text.strip()):
        raise BadInput(f"{where}: '{text.strip()[:40]}' is no number; the virtual controller works nothing out")
    return float(text)


def aggregate(where: str, text: str) -> dict[str, float]:
    """`{X 1.0,Y 2.0,..}` as numbers by component. Raises BadInput: malformed, a component twice or unknown."""
    inner = re.match(r"^\{\s*(?:[A-Z0-9_]+\s*:)?(.*)\}$", text.strip())
    if not inner or "{" in inner.group(1):
        raise BadInput(f"{where}: '{text[:60]}' is no aggregate like {{X 1.0,Y 2.0}}")
    values: dict[str, float] = {}
    for part in inner.group(1).split(","):
        words = part.split()
        if len(words) != 2 or words[0] not in _ALLOWED or words[0] in values:
            raise BadInput(
                f"{where}: '{part.strip()[:40]}' in a position is not understood; each component stands once with a number"
            )
        values[words[0]] = number(where, words[1])
    return values


def frame_of(where: str, text: str) -> Array:
    """T (4, 4) of an aggregate with X, Y, Z in mm and A, B, C in degrees, `R = Rz(A) Ry(B) Rx(C)`. Raises BadInput."""
    values = aggregate(where, text)
    if not set(POSE_LETTERS) <= set(values):
        raise BadInput(f"{where}: the frame is incomplete, X, Y, Z, A, B, C are expected; write all of them")
    xyz, abc = np.array([values[k] for k in "XYZ"]) * 1e-3, np.radians([values[k] for k in "ABC"])
    return transform_from_xyzabc(xyz, abc)
