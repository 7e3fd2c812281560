"""A path taken from an existing program: where each of its poses lets the blade touch the wheel."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ocp.model.blade_gap import FACING, SurfaceCloud
from ocp.model.cell import Cell, wheel_frame
from robots.errors import BadInput
from robots.kinematics import forward
from robots.pose import Array, apply
from trajectories.blade import AerofoilShape, Blade
from trajectories.dialects import dialect_named
from trajectories.passes import BladePath
from trajectories.path_points import paths_from_points
from trajectories.program.old_program import contact_frames_from_program

APART = 3e-3  # m between nominal blade and wheel: poses farther off are approach, not contact
STRIP = 2.5e-3  # m about the wheel's middle plane and the deepest point that the local fit uses
LEAST_SPACING = 9e-4  # m between contact points that are kept: programs crowd points where they start and stop


def paths_from_program(
    cell: Cell, blade: Blade, shape: AerofoilShape, cloud: SurfaceCloud, source: Path, step: float
) -> tuple[list[BladePath], list[str]]:
    """Passes of an old program on the blade, through the nominal kinematics as its author meant it, and notices.

    The contact point of a pose is the blade's deepest point toward the wheel's axis in the wheel's middle plane.
    Raises BadInput: unreadable program, or none of its poses brings the blade to the wheel.
    """
    execution = dialect_named(cell.controller.dialect).read(source)
    old, notes = contact_frames_from_program(
        execution, lambda q: forward(cell.robot, q), cell.workpiece.T_flange_blade, wheel_frame(cell)
    )
    notices = list(notes)
    p, n, line, places, feed = [], [], [], [], []
    for number, one in enumerate(old, 1):
        touched = [_contact(cell, cloud, T) for T in one.flange @ cell.workpiece.T_flange_blade]
        last: Array | None = None
        for found, place in zip(touched, one.lines, strict=True):
            if found is None or (last is not None and np.linalg.norm(found[0] - last) < LEAST_SPACING):
                continue
            last = found[0]
            p.append(found[0])
            n.append(found[1])
            line.append(number)
            places.append(f"{one.file}, line {place}")
            feed.append(one.feed or cell.process.feed)
    counts = np.bincount(line, minlength=len(old) + 1) if line else np.zeros(1, int)
    keep = np.array([counts[k] >= 3 for k in line], bool)
    if not keep.any():
        raise BadInput(
            f"{source}: none of its {len(old)} path motions brings the blade within {APART * 1e3:g} mm of the wheel; "
            "is it a program of this cell, blade and tool frame?"
        )
    passes, points = len(set(np.array(line)[keep])), int(keep.sum())
    notices.append(f"{source.name}: {passes} of {len(old)} path motions touch the wheel, {points} contact points are taken.")
    index = np.flatnonzero(keep)
    rows = [
        _resampled(np.array(p), np.array(n), index[np.array(line)[index] == k], step) for k in np.unique(np.array(line)[keep])
    ]
    at, normal, of = np.vstack([r[0] for r in rows]), np.vstack([r[1] for r in rows]), np.concatenate([r[2] for r in rows])
    of_line = np.array(line)[of]
    paths, more = paths_from_points(
        blade,
        shape,
        of_line,
        at,
        normal,
        _feed_directions(at, normal, of_line),
        np.array(feed)[of],
        np.full(len(at), cell.process.force),
        source.name,
        [places[k] for k in of],
    )
    return paths, notices + more


def _resampled(p: Array, n: Array, rows: NDArray[np.int64], step: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Points and normals of one pass every `step` m along the curve through them, and which point of the program is next."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p[rows], axis=0), axis=1))])
    even = np.linspace(0.0, s[-1], max(int(np.ceil(s[-1] / step)) + 1, 8))
    normal = CubicSpline(s, n[rows])(even)
    nearest = rows[np.abs(even[:, None] - s).argmin(axis=1)]
    return CubicSpline(s, p[rows])(even), normal / np.linalg.norm(normal, axis=1, keepdims=True), nearest


def _contact(cell: Cell, cloud: SurfaceCloud, T: Array) -> tuple[Array, Array] | None:
    """Contact point and outward normal (blade frame) of a blade pose (4, 4), or None off the wheel."""
    wheel = cell.wheel
    v = apply(T, cloud.points) - wheel.centre
    lateral = v @ wheel.axis
    radial = v - lateral[:, None] * wheel.axis
    rho = np.linalg.norm(radial, axis=1)
    facing = np.sum((cloud.normals @ T[:3, :3].T) * radial, axis=1) < -FACING * rho
    strip = np.flatnonzero(facing & (np.abs(lateral) < STRIP))
    if len(strip) < 8:
        return None
    deepest = strip[np.argmin(rho[strip])]
    if rho[deepest] > wheel.radius + APART:
        return None
    near = strip[np.linalg.norm(cloud.points[strip] - cloud.points[deepest], axis=1) < 1.5 * STRIP]
    e = radial[deepest] / rho[deepest]
    x = wheel.radius * np.arctan2(radial[near] @ np.cross(wheel.axis, e), radial[near] @ e)
    y = lateral[near]
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    fit = np.linalg.lstsq(terms, np.column_stack([rho[near], cloud.points[near], cloud.normals[near]]), rcond=None)[0]
    # Deepest along the belt in the middle plane y = 0: d rho / dx = 0.
    at = -0.5 * fit[1, 0] / fit[3, 0] if fit[3, 0] > 0 else 0.0
    at = float(np.clip(at, -STRIP, STRIP))
    value = np.array([1.0, at, 0.0, at * at, 0.0, 0.0]) @ fit
    return value[1:4], value[4:7] / np.linalg.norm(value[4:7])


def _feed_directions(p: Array, n: Array, line: Array) -> Array:
    """Unit directions (m, 3) of travel along the contact points of each pass, freed of their part along n."""
    t = np.empty_like(p)
    for number in np.unique(line):
        rows = np.flatnonzero(line == number)
        t[rows] = np.gradient(p[rows], axis=0)
    t -= n * np.sum(t * n, axis=1, keepdims=True)
    return np.asarray(t / np.linalg.norm(t, axis=1, keepdims=True))
