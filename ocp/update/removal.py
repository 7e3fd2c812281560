"""Depths measured on a ground blade, Preston's coefficient from them, and how it is less sure where none are measured.

depth = k_p h, with h of what ground (ocp.update.pattern). What h leaves open (a footprint is right to some per cent) is
DEPTH_MODEL.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ocp.calibrate.force.log import Flags, ForceLog
from ocp.calibrate.force.rows import measured_blade
from ocp.model.cell import Cell
from robots.csv_table import read_csv_table
from robots.errors import BadInput, Infeasible
from robots.pose import Array, Stacked
from trajectories.path_points import feet_on_blade

PLACES, DEPTH, OPTIONAL = ("px_mm", "py_mm", "pz_mm"), ("removal_um", "sd_um"), ("clock_s",)
UNIT = 1e-12  # 1/Pa: one um mm^2 / (N m)
DEPTH_MODEL = 0.05  # of a depth, one sigma: what the footprint's shape is off by where points lie on its flank
GROUND = 0.1  # of the largest expected depth: below it a point counts as not ground by this log
LEAST_DEPTHS = 3  # that were ground: fewer do not show how far they scatter
GROWN = 5.0  # sigmas by which no depth may be negative: grinding adds nothing
HOURLY = 0.2  # of the coefficient, one sigma per root of an hour in contact: a belt lasts about one and cuts less and less
COPIES = 0.2  # of the depths, from which a table of copies tells more than was measured
USUAL = 1e-13, 1e-9  # 1/Pa; a coefficient of depths in another unit lies outside
CERTAIN = 3.0  # sigmas from zero below which no coefficient is written
APART = 4.0  # sigmas from which two coefficients are not the same
NEW_BELT = 0.5  # of the coefficient, one sigma, after another belt was put on


@dataclass(frozen=True)
class MeasuredDepths(Stacked):
    """n depths measured on a blade: p (n, 3) m blade frame, depth (n,) m, sd (n,) m; line (n,) in the file; clock s: when, on the
    wheel's clock, None where that is not told: after all that the log holds."""

    path: Path
    p: Array
    depth: Array
    sd: Array
    line: NDArray[np.int64]
    clock: float | None = None


@dataclass(frozen=True)
class Preston:
    """Preston's coefficient 1/Pa and its one sigma; of a measurement: points used, points that were not ground, the scatter of
    one depth over what was stated, and depths as expected (l,) m beside those measured; which of all n points these are (n,)."""

    value: float
    sd: float
    points: int = 0
    left_out: int = 0
    scatter: float = 1.0
    expected: Array | None = None
    measured: Array | None = None
    used: Flags = field(default_factory=lambda: np.zeros(0, bool))


def read_removal(path: str | Path) -> MeasuredDepths:
    """The rows of a removal.csv (FORMATS).

    Raises BadInput: as `read_csv_table`, a sigma that is not above zero, a depth below zero by more than GROWN sigmas, more than
    one clock.
    """
    table = read_csv_table(path, (*PLACES, *DEPTH), OPTIONAL)
    if not len(table):
        raise BadInput(f"{table.path}: no row; give at least one measured depth")
    sd = table.column("sd_um", 1e-6, lambda v: v <= 0, "above 0")
    depth = table.numbers["removal_um"] * 1e-6
    assert sd is not None
    if (bad := depth < -GROWN * sd).any():
        raise table.refuse(int(np.argmax(bad)), "removal_um", "is negative by more than its error; depths taken off are positive")
    rows = np.column_stack([table.stack(PLACES), depth, sd])
    _, first, count = np.unique(rows, axis=0, return_index=True, return_counts=True)
    if len(rows) - len(first) > COPIES * len(rows):
        raise table.refuse(
            int(first[np.argmax(count)]), "removal_um", f"is one of {count.max()} copies of a row; give each depth once"
        )
    clock = table.column("clock_s", 1.0, lambda v: (v < 0) | (v != v[0]), "zero or above and the same in all rows: when measured")
    when = None if clock is None else float(clock[0])
    return MeasuredDepths(table.path, 1e-3 * table.stack(PLACES), depth, sd, np.array(table.line), when)


def ground_by_then(removal: MeasuredDepths, log: ForceLog) -> Flags:
    """Rows (n,) of a log that were over when the depths were measured. Raises BadInput: the log has no clock to tell, or begins
    later."""
    if removal.clock is None:
        return np.ones(len(log), bool)
    if log.clock is None:
        raise BadInput(f"{log.path}: no column clock_s, by which {removal.path} tells when it was measured; leave it out of both")
    over: Flags = log.clock <= removal.clock
    if not (over & log.contact).any():
        raise BadInput(
            f"{removal.path}, column clock_s: measured at {removal.clock:g} s, before {log.path.name} grinds; give the wheel's "
            "clock after grinding"
        )
    return over


def on_blade(cell: Cell, removal: MeasuredDepths) -> tuple[Array, Array]:
    """Feet and outward normals (n, 3) of the points on the blade. Raises BadInput: one is off the surface."""
    assert cell.workpiece.stl is not None
    blade, shape, _ = measured_blade(cell.workpiece.stl, cell.workpiece)
    where = f"{removal.path}, line {{}}, columns px_mm, py_mm, pz_mm"
    return feet_on_blade(blade, shape, removal.p, lambda k: where.format(removal.line[k]))[3:5]


def preston_from(removal: MeasuredDepths, h: Array) -> Preston:
    """The coefficient by weighted least squares of depth on h (n,), points that were not ground left out.

    Raises Infeasible: fewer than LEAST_DEPTHS points were ground, or the depths do not differ from zero.
    """
    used: Flags = h > GROUND * h.max()
    count = int(used.sum()) if h.max() > 0 else 0
    if count < LEAST_DEPTHS:
        raise Infeasible(
            f"{removal.path}: {count or 'no'} point{'s lie' if count > 1 else ' lies'} where the force log ground, at least "
            f"{LEAST_DEPTHS} are needed; measure where it did, or give the log of all lines"
        )
    y, x, sd = removal.depth[used], h[used], removal.sd[used]
    k = float(np.sum(y * x / sd**2) / np.sum(x**2 / sd**2))
    for _ in range(5):  # the model's share of the error is of the fitted depth
        sigma = np.hypot(sd, DEPTH_MODEL * abs(k) * x)
        k = float(np.sum(y * x / sigma**2) / np.sum(x**2 / sigma**2))
    scatter = float(np.sqrt(np.sum(((y - k * x) / sigma) ** 2) / max(len(y) - 1, 1)))
    sd_k = max(scatter, 1.0) / float(np.sqrt(np.sum(x**2 / sigma**2)))
    if k < CERTAIN * sd_k:
        raise Infeasible(
            f"{removal.path}: depths do not differ from zero (coefficient {k / UNIT:.3g} +- {sd_k / UNIT:.2g} um mm2/(N m)); "
            "measure more points or deeper cuts"
        )
    return Preston(k, sd_k, int(used.sum()), int((~used).sum()), scatter, k * x, y, used)


def with_shared_errors(removal: MeasuredDepths, found: Preston, lines: int, force: float) -> Preston:
    """With what is the same error for many depths: the footprint's along each of `lines`, that of the pressing force, a share, of
    all. Raises Infeasible: a coefficient that no belt has."""
    if not USUAL[0] < found.value < USUAL[1]:
        raise Infeasible(
            f"{removal.path}: Preston's coefficient would be {found.value / UNIT:.3g} um mm2/(N m); belts have "
            f"{USUAL[0] / UNIT:g} to {USUAL[1] / UNIT:g}: give removal_um and sd_um in micrometres, of what this log ground"
        )
    return replace(found, sd=float(np.linalg.norm([found.sd, found.value * DEPTH_MODEL / np.sqrt(lines), found.value * force])))


def less_sure(known: Preston, contact_seconds: float, new_belt: bool) -> Preston:
    """What is known of the coefficient after so much contact without a measurement; `new_belt`: another one was put on."""
    more = HOURLY * np.sqrt(contact_seconds / 3600.0)
    return Preston(known.value, float(known.value * np.linalg.norm([known.sd / known.value, more, NEW_BELT * new_belt])))


def joined_preston(known: Preston | None, found: Preston) -> Preston:
    """The measurement with what was known before it. Raises Infeasible: they exclude each other."""
    if known is None:
        return found
    spread = float(np.hypot(known.sd, found.sd))
    if abs(found.value - known.value) > APART * spread:
        raise Infeasible(
            f"Preston's coefficient is {found.value / UNIT:.3g} by the measured removal, which cannot come from the last, "
            f"{known.value / UNIT:.3g} +- {spread / UNIT:.2g} um mm2/(N m); say --changed belt where the belt is another, else "
            "measure the removal again"
        )
    weight = known.sd**2 / spread**2
    value = known.value + weight * (found.value - known.value)
    sd = known.sd * found.sd / spread
    return replace(found, value=value, sd=sd)
