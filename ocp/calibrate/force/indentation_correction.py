"""What the blade's real surface adds to the quadratic wheel law along a log: direct contact solutions at a few stations."""

from dataclasses import asdict, replace

import numpy as np
from scipy.interpolate import RBFInterpolator

from ocp.calibrate.force.compliance import NORMAL_LENGTH, spread_stations
from ocp.calibrate.force.model import STATE, ForceModel, ForceRows, PlacedRows
from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.gap import LocalShape, solve_force
from ocp.model.blade_gap import SurfaceCloud, surface_shape
from ocp.model.force_balance import N_WAYPOINT
from ocp.model.theta import believed_theta
from ocp.shell.cache import Entry, content_key, remember
from robots.errors import Infeasible
from robots.pose import Array

VERSION = "indentation correction 1"  # part of the cache key: raise it when results change
SPACING = 16e-3  # m between stations; the departure from the quadratic varies slowly along a pass
FORCE_LENGTH = 1e-3  # m that one newton counts for in distances between stations
LATERAL_WEIGHT = 2.0  # a shift across the wheel counts this much more than one along the blade: its edges matter
NEIGHBOURS = 12
CORRECTION = N_WAYPOINT - 1  # its column of a waypoint


def with_indentation_correction(model: ForceModel, cover: Cover, cloud: SurfaceCloud, rows: ForceRows, force: Array) -> ForceRows:
    """`rows` with the correction (m) of each in its waypoint: indentation under `force` (n,) N on the real surface less that on
    the local quadratic, both solved on `cover`, at the cell's nominal postures. Its cells are to be fine: where the blade
    ends under the wheel, coarse ones put the edge in the wrong place (docs/force_registration.md).

    Where the real surface cannot be solved (the wheel bears far from the point) the quadratic is left alone.
    """
    touching = np.flatnonzero(rows.contact)
    if not len(touching):
        return rows
    part = rows.take(touching)
    theta = believed_theta(replace(model.cell, calibration=None)).values
    state = model.evaluate("state", PlacedRows.of(model.cell, part, theta), force[touching])
    lateral = LATERAL_WEIGHT * state[:, STATE["lateral"]]
    p, n = part.waypoint[:, :3], part.waypoint[:, 3:6]
    place = np.hstack([p, NORMAL_LENGTH * n, FORCE_LENGTH * force[touching, None], lateral])
    at = spread_stations(p, place[:, 3:] / NORMAL_LENGTH, SPACING)
    rows_key = (part.q[at], part.waypoint[at, :12], force[touching][at])
    cell_key = (model.cell.wheel.centre, model.cell.wheel.axis, model.cell.workpiece.T_flange_blade)
    key = content_key(VERSION, repr(asdict(cover.geometry)), cover.dx, cloud.points, *rows_key, *cell_key)

    def compute() -> Entry:
        chosen, newton = part.take(at), force[touching][at]
        solved = [_departure(model, cover, cloud, chosen, state[at], float(F), k) for k, F in enumerate(newton)]
        return {"correction": np.array(solved)}

    known = np.asarray(remember("force-correction", key, compute)["correction"], float)
    sound = np.isfinite(known)
    waypoint = rows.waypoint.copy()
    if sound.sum() >= 3:
        smooth = RBFInterpolator(
            1e3 * place[at][sound], known[sound], min(NEIGHBOURS, int(sound.sum())), kernel="linear", degree=0
        )
        waypoint[touching, CORRECTION] = smooth(1e3 * place)
    elif sound.any():
        waypoint[touching, CORRECTION] = known[sound].mean()
    return replace(rows, waypoint=waypoint)


def _departure(
    model: ForceModel, cover: Cover, cloud: SurfaceCloud, rows: ForceRows, state: Array, force: float, k: int
) -> float:
    """Correction m of row k; nan where there is no solution."""
    lateral, tilt_x, tilt_y, kxx, kyy, kxy = (
        float(v) for name in ("lateral", "tilt", "curvature") for v in state[k, STATE[name]]
    )
    T = state[k, STATE["T"]].reshape(4, 4)
    wheel = model.cell.wheel
    t, v = T[:3, :3] @ rows.waypoint[k, 6:9], T[:3, :3] @ rows.waypoint[k, :3] + T[:3, 3] - wheel.centre
    e = v - wheel.axis * (v @ wheel.axis)
    belt = np.cross(wheel.axis, e / np.linalg.norm(e))
    flat = LocalShape(kxx, kyy, kxy, lateral, tilt_x, tilt_y, heading=(float(t @ belt), float(t @ wheel.axis)))
    real = surface_shape(wheel, cloud, flat, T, rows.waypoint[k, :3])
    try:
        return solve_force(cover, force, real).indentation - solve_force(cover, force, flat).indentation
    except Infeasible:
        return float("nan")
