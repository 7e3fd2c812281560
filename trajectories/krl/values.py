"""Numbers, frames, axes and comments as KRL text: fixed decimals, printable ASCII (KRL.md)."""

import re
import unicodedata

import numpy as np

from robots.pose import Array, abc_from_rotation
from trajectories.program.execution import PathBounds
from trajectories.program.program import FileLimits

# 2000 points of a file and 12 ms of the interpolation cycle: KRL.md, the latter (M); what is printed: 10 us, 1e-5 deg, 1e-4 mm;
# of paths what the machine data usually hold: $VEL_MA and $ACC_MA (M).
FILE_LIMITS = FileLimits(
    file_points=2000,
    block_points=1900,
    cycle=0.012,
    time_unit=1e-5,
    angle_decimals=5,
    length_decimals=4,
    path=PathBounds(3.0, 10.0, float(np.radians(400.0)), float(np.radians(1000.0))),
)


def fixed(value: float, decimals: int) -> str:
    """Fixed decimals, no exponent, and 0 without a sign."""
    text = f"{value:.{decimals}f}"
    return text[1:] if float(text) == 0 and text.startswith("-") else text


def frame_text(T: Array) -> str:
    """A transform (4, 4) as {X .. mm, .., C .. deg}."""
    xyz = T[:3, 3] * 1e3
    abc = np.degrees(abc_from_rotation(T[:3, :3]))
    parts = [f"{c} {fixed(v, FILE_LIMITS.length_decimals)}" for c, v in zip("XYZ", xyz, strict=True)]
    return "{" + ",".join(parts + [f"{c} {fixed(v, FILE_LIMITS.angle_decimals)}" for c, v in zip("ABC", abc, strict=True)]) + "}"


def axes_text(q: Array) -> str:
    """Axes (6,) rad as {A1 .., A6 .. deg}."""
    return "{" + ",".join(f"A{i} {fixed(v, FILE_LIMITS.angle_decimals)}" for i, v in enumerate(np.degrees(q), 1)) + "}"


def comment_text(text: str, longest: int = 100) -> str:
    """One line of printable ASCII for a KRL comment: whatever is handed in cannot end the line or open a fold."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "replace").decode()
    plain = re.sub(r"[^ -~]", " ", plain)
    return re.sub(r"(?i)(END)?FOLD", "F-LD", plain).strip()[:longest].rstrip()
