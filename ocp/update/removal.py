"""Preston's coefficient from depths measured on a ground blade, and how it is less_sure where none are measured.

    depth(x) = k_p h(x),   h(x) = sum over rows in contact of  F V phi(x - p) dt                                          (1)

with phi the pressure per newton of the contact solution at a row (ocp.plan.removal.footprint), V the belt's speed against the
moving blade and dt the row's time (Preston 1927). What h leaves open (a footprint is right to some per cent) is DEPTH_MODEL.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.calibrate.force.fit import BIAS, ForceSolution
from ocp.calibrate.force.log import Flags, ForceLog
from ocp.calibrate.force.model import STATE, ForceModel, ForceRows, PlacedRows
from ocp.calibrate.force.rows import measured_blade
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.cell import Cell
from ocp.model.prepare import wheel_cover
from ocp.plan.removal.footprint import LinePatches, line_patches
from ocp.plan.removal.surface import ContactRows, shares_of_time, work_done
from robots.csv_table import read_csv_table
from robots.errors import BadInput, Infeasible
from robots.pose import Array
from trajectories.path_points import OFF_SURFACE, locate, place_on_mesh

PLACES, DEPTH = ("px_mm", "py_mm", "pz_mm"), ("removal_um", "sd_um")
UNIT = 1e-12  # 1/Pa: one um mm^2 / (N m)
DEPTH_MODEL = 0.05  # of a depth, one sigma: what the footprint's shape is off by where points lie on its flank
GROUND = 0.1  # of the largest expected depth: below it a point counts as not ground by this log
GROWN = 5.0  # sigmas by which no depth may be negative: grinding adds nothing
HOURLY = 0.2  # of the coefficient, one sigma per root of an hour in contact: a belt lasts about one and cuts less and less
CERTAIN = 3.0  # sigmas from zero below which no coefficient is written
APART = 4.0  # sigmas from which two coefficients are not the same
NEW_BELT = 0.5  # of the coefficient, one sigma, after another belt was put on
STATION = 12e-3  # m between contacts that are solved along a run


@dataclass(frozen=True)
class MeasuredDepths:
    """n depths measured on a blade: p (n, 3) m blade frame, depth (n,) m, sd (n,) m; line (n,) in the file."""

    path: Path
    p: Array
    depth: Array
    sd: Array
    line: tuple[int, ...]


@dataclass(frozen=True)
class Preston:
    """Preston's coefficient 1/Pa and its one sigma; of a measurement: points used, points that were not ground, the scatter of
    one depth over what was stated, and depths as expected (n,) m beside those measured."""

    value: float
    sd: float
    points: int = 0
    left_out: int = 0
    scatter: float = 1.0
    expected: Array | None = None
    measured: Array | None = None


def read_removal(path: str | Path) -> MeasuredDepths:
    """The rows of a removal.csv (FORMATS).

    Raises BadInput: as `read_csv_table`, a sigma that is not above zero, a depth below zero by more than GROWN sigmas.
    """
    table = read_csv_table(path, (*PLACES, *DEPTH))
    if not len(table):
        raise BadInput(f"{table.path}: no row; give at least one measured depth")
    sd = table.column("sd_um", 1e-6, lambda v: v <= 0, "above 0")
    depth = table.numbers["removal_um"] * 1e-6
    assert sd is not None
    if (bad := depth < -GROWN * sd).any():
        raise table.refuse(int(np.argmax(bad)), "removal_um", "is negative by more than its error; depths taken off are positive")
    return MeasuredDepths(table.path, 1e-3 * table.stack(PLACES), depth, sd, tuple(table.line))


def on_blade(cell: Cell, removal: MeasuredDepths) -> tuple[Array, Array]:
    """Feet and outward normals (n, 3) of the points on the blade. Raises BadInput: one is off the surface."""
    assert cell.workpiece.stl is not None
    blade, shape, _ = measured_blade(cell.workpiece.stl, cell.workpiece)
    name, _, _, foot, normal = locate(shape, removal.p)
    place_on_mesh(blade, name, foot, normal, removal.p)
    gap = np.linalg.norm(foot - removal.p, axis=1)
    if (gap > OFF_SURFACE).any():
        k = int(np.argmax(gap > OFF_SURFACE))
        raise BadInput(
            f"{removal.path}, line {removal.line[k]}, columns px_mm, py_mm, pz_mm: the point is {1e3 * gap[k]:.3f} mm off the "
            f"surface of {blade.name}, the limit is {1e3 * OFF_SURFACE:g} mm; give points of this blade in its own frame"
        )
    return foot, normal


def work_at(cell: Cell, model: ForceModel, rows: ForceRows, log: ForceLog, solution: ForceSolution, p: Array, n: Array) -> Array:
    """h (m,) Pa m of eq. 1 at points p (m, 3) m with normals n (m, 3): depth over Preston's coefficient.

    Raises Infeasible of the contact solver.
    """
    belt = np.full(len(log), cell.wheel.belt_speed) if log.belt is None else log.belt
    force = np.maximum(solution.reading - solution.x[BIAS], 0.0)
    parts, patches = [], list[LinePatches]()
    for run in np.unique(log.run[log.contact]):
        at = np.flatnonzero((log.run == run) & log.contact & (force > 0))
        if len(at) < 2:
            continue
        time, way = log.time[at], np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(log.p[at], axis=0), axis=1))])
        feed = np.gradient(way, time) if np.all(np.diff(time) > 0) else np.zeros(len(at))
        # At zero turn the blade runs with the belt, or against it.
        slide = np.abs(np.abs(belt[at]) - cell.process.sigma * feed) * shares_of_time(time)
        place = np.full(len(at), len(patches), np.int64)
        parts.append(ContactRows(place, log.p[at], log.n[at], log.t[at], way, force[at], slide))
        patches.append(_patches(cell, model, rows.take(at), way, force[at], solution.x[:BIAS]))
    if not parts:
        return np.zeros(len(p))
    whole = ContactRows(*(np.concatenate([getattr(part, name) for part in parts]) for name in ContactRows.__dataclass_fields__))
    return work_done(p, n, whole, patches)


def _patches(cell: Cell, model: ForceModel, rows: ForceRows, way: Array, force: Array, theta: Array) -> LinePatches:
    """Footprints along a run, at stations STATION apart, under the force there."""
    chosen = np.unique(np.abs(way[:, None] - np.arange(0.0, way[-1] + STATION, STATION)).argmin(axis=0))
    part, F = rows.take(chosen), np.maximum(force[chosen], model.least_force)
    state = model.evaluate("state", PlacedRows.of(model.cell, part, theta), F)
    cover, wheel = wheel_cover(cell), cell.wheel
    contacts, headings = [], []
    for k in range(len(chosen)):
        lateral, tilt_x, tilt_y, kxx, kyy, kxy = (
            float(v) for name in ("lateral", "tilt", "curvature") for v in state[k, STATE[name]]
        )
        T = state[k, STATE["T"]].reshape(4, 4)
        t, v = T[:3, :3] @ part.waypoint[k, 6:9], T[:3, :3] @ part.waypoint[k, :3] + T[:3, 3] - wheel.centre
        e = v - wheel.axis * (v @ wheel.axis)
        along = np.cross(wheel.axis, e / np.linalg.norm(e))
        headings.append((float(t @ along), float(t @ wheel.axis)))
        contacts.append(solve_force(cover, float(F[k]), LocalShape(kxx, kyy, kxy, lateral, tilt_x, tilt_y, heading=headings[-1])))
    return line_patches(way[chosen], contacts, headings)


def preston_from(removal: MeasuredDepths, h: Array) -> Preston:
    """The coefficient by weighted least squares of depth on h (n,), points that were not ground left out.

    Raises Infeasible: no point was ground, or the depths do not differ from zero.
    """
    used: Flags = h > GROUND * h.max()
    if not h.max() > 0 or not used.any():
        raise Infeasible(
            f"{removal.path}: no point lies where the force log ground; measure where it did, or give the log of all lines"
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
    return Preston(k, sd_k, int(used.sum()), int((~used).sum()), scatter, k * x, y)


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
    return Preston(value, sd, found.points, found.left_out, found.scatter, found.expected, found.measured)
