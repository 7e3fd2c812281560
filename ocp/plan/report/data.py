"""What a plan's report shows: frozen arrays in SI units, filled by the planner, read by page and print.

Nothing here computes physics and nothing here formats: the two writers take the same `PlanReport`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.pose import Array


@dataclass(frozen=True)
class SummaryRow:
    """One line of the summary table, ready to print: what it is, its value, its unit ("" where it has
    none).
    """

    label: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class InputFile:
    """A file the plan was made from: its part ("blade", "cell", ...), its name and the SHA-256 of its
    bytes.
    """

    role: str
    name: str
    sha256: str


@dataclass(frozen=True)
class PassReport:
    """One planned pass; n waypoints in the blade frame.

    `p`, `n`, `t` (n, 3): contact point m, outward normal, feed direction; `s` (n,) m along the pass.
    `force`, `force_sd` (n,) N: predicted normal force and its standard deviation. `interference` (n,) m.
    `compliance_nn` (n,) m/N: blade along its own normal. `removal` (n,): relative to the intended depth, 1
    = as intended. `limit_ratio` (n,): largest use of any axis limit, 1 = at the limit. `arc` rad, `lateral`
    m, `turn` rad, `tilt` (n, 2) rad: where and how the blade touches the wheel. `feed` (n,) m/s. nan = not
    known, drawn as a gap.
    """

    line: int
    side: str
    p: Array
    n: Array
    t: Array
    s: Array
    force: Array
    force_sd: Array
    interference: Array
    compliance_nn: Array
    removal: Array
    limit_ratio: Array
    arc: Array
    lateral: Array
    turn: Array
    tilt: Array
    feed: Array

    def __post_init__(self) -> None:
        count = len(self.s)
        for name in ("p", "n", "t"):
            _require(f"pass {self.line}: {name}", getattr(self, name), (count, 3))
        _require(f"pass {self.line}: tilt", self.tilt, (count, 2))
        for name in "force force_sd interference compliance_nn removal limit_ratio arc lateral turn feed".split():
            _require(f"pass {self.line}: {name}", getattr(self, name), (count,))


@dataclass(frozen=True)
class MotionReport:
    """The timed program, air moves included; m samples.

    `time` (m,) s rising; `q`, `qd`, `qdd` (m, 6) rad, rad/s, rad/s^2; `torque` (m, 6) N m at the link side;
    `contact` (m,) bool; `line` (m,) int, 0 between passes; `feed` (m,) m/s; `force`, `force_sd` (m,) N, nan
    in the air.
    """

    time: Array
    q: Array
    qd: Array
    qdd: Array
    torque: Array
    contact: NDArray[Any]
    line: NDArray[Any]
    feed: Array
    force: Array
    force_sd: Array

    def __post_init__(self) -> None:
        count = len(self.time)
        for name in ("q", "qd", "qdd", "torque"):
            _require(f"motion: {name}", getattr(self, name), (count, 6))
        for name in ("contact", "line", "feed", "force", "force_sd"):
            _require(f"motion: {name}", getattr(self, name), (count,))


@dataclass(frozen=True)
class AxisLimits:
    """What each axis may do, (6,) each: rad, rad/s, rad/s^2, N m at the link side; inf or nan = free."""

    q_min: Array
    q_max: Array
    qd_max: Array
    qdd_max: Array
    torque_max: Array


@dataclass(frozen=True)
class WheelShape:
    """The wheel in the base frame: middle m, unit axis, radius m, width m, unit direction of arc zero."""

    centre: Array
    axis: Array
    radius: float
    width: float
    contact_direction: Array


@dataclass(frozen=True)
class CellAnimation:
    """Where everything stands at k times (at most 600 are worth their bytes).

    `time` (k,) s rising; `T_base_link` (k, 7, 4, 4): base and links 1..6 in their MD-H frames; `T_base_blade`
    (k, 4, 4): the blade as the model believes it really is; `T_flange_blade` (4, 4); `capsules`: (link
    index 0..6, p0 (3,), p1 (3,) m in that link's frame, radius m) as in `Robot.link_shapes`.
    """

    time: Array
    T_base_link: Array
    T_base_blade: Array
    T_flange_blade: Array
    capsules: tuple[tuple[int, Array, Array, float], ...]
    wheel: WheelShape

    def __post_init__(self) -> None:
        count = len(self.time)
        _require("animation: T_base_link", self.T_base_link, (count, 7, 4, 4))
        _require("animation: T_base_blade", self.T_base_blade, (count, 4, 4))
        _require("animation: T_flange_blade", self.T_flange_blade, (4, 4))


@dataclass(frozen=True)
class PlanReport:
    """Everything the report of one plan says.

    `verdict` is one sentence; `safe` says whether the program may be run. `vertices` (nv, 3) m and `faces`
    (nf, 3) are the blade. `target_force` N. `pass_spacing` m between neighbouring passes (0 = take it from
    the passes). `versions`: name and version of what made the plan. `phases`: (name, seconds) of the run;
    give them only where equal bytes out of equal inputs do not matter. Raises ValueError where array shapes
    do not agree.
    """

    title: str
    verdict: str
    safe: bool
    summary: tuple[SummaryRow, ...]
    inputs: tuple[InputFile, ...]
    notices: tuple[str, ...]
    versions: tuple[tuple[str, str], ...]
    target_force: float
    vertices: Array
    faces: NDArray[Any]
    passes: tuple[PassReport, ...]
    motion: MotionReport
    limits: AxisLimits
    animation: CellAnimation
    pass_spacing: float = 0.0
    phases: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        _require("vertices", self.vertices, (len(self.vertices), 3))
        _require("faces", self.faces, (len(self.faces), 3))
        if not self.passes or len(self.motion.time) < 2 or len(self.animation.time) < 2:
            raise ValueError("a report needs at least one pass, two motion samples and two animation frames")


def _require(name: str, value: NDArray[Any], shape: tuple[int, ...]) -> None:
    if np.shape(value) != shape:
        raise ValueError(f"{name} has shape {np.shape(value)}, expected {shape}")
