"""How far blade, clamp and arm give way under the contact, per newton, along the wheel's direction into the blade."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ocp.contact.blade.compliance import blade_compliance, default_element_size
from ocp.contact.blade.elasticity import Material
from ocp.contact.blade.volume_mesh import surface_area
from ocp.model.cell import Workpiece
from ocp.simulate.twin.contact.moments import ContactMoments, Index
from ocp.simulate.twin.contact.posture import Postures
from ocp.simulate.twin.contact.stations import Stations
from robots.pose import Array
from trajectories.blade import Blade

# Elements larger than the planner's: 0.1 um under 20 N on the bundled blade, and three times faster (docs/virtual_grinding.md).
ELEMENT_FACTOR = 1.6
DIGITS_PLACE, DIGITS_DIRECTION = 7, 6  # of what the blade's finite elements are asked: the same line finds its answer on disk


@dataclass(frozen=True)
class SolidLine:
    """Places of one line at which the blade's finite elements are asked: p, n, t (k, 3), s (k,) m."""

    p: Array
    n: Array
    t: Array
    s: Array


def solid_give(piece: Workpiece, blade: Blade, stations: Stations, patch: tuple[float, float]) -> Array:
    """c_nn, c_nt, c_nb (stations, 3) m/N of the clamped solid under a patch of semi-axes (along the feed, across) m, as in
    `ocp.contact.blade.compliance`. Raises BadInput as that does."""
    lines = [np.flatnonzero(stations.line == k) for k in np.unique(stations.line)]
    asked = []
    for k in lines:
        p = np.round(stations.p[k], DIGITS_PLACE)
        n, t = np.round(stations.n[k], DIGITS_DIRECTION), np.round(stations.t[k], DIGITS_DIRECTION)
        asked.append(SolidLine(p, n, t, np.round(stations.s[k], DIGITS_PLACE)))
    material = Material(piece.youngs_modulus, piece.poisson, piece.density)
    size = ELEMENT_FACTOR * default_element_size(surface_area(blade.vertices, blade.faces), patch)
    answer = blade_compliance(
        blade.vertices, blade.faces, piece.clamp_normal, piece.clamp_offset, material, cast(Any, asked), patch, size
    )
    out = np.zeros((len(stations.s), 3))
    for k, values in zip(lines, answer.per_pass, strict=True):
        out[k] = values
    return out


def blade_give(solid: Array, stations: Stations, R: Array, n: Array, t: Array, at: Postures, friction: Array) -> Array:
    """Displacement (n,) of the contact along -n per newton under the force e + friction x, of the solid's c (stations, 3).

    R (n, 3, 3) turns the blade into the base; by reciprocity a unit force along t moves the contact along -n by c_nt.
    """
    c = (1 - stations.share)[:, None] * solid[stations.left] + stations.share[:, None] * solid[stations.right]
    force = at.e + friction[:, None] * at.x
    normal, feed = np.einsum("kij,kj->ki", R, n), np.einsum("kij,kj->ki", R, t)
    across = np.cross(normal, feed)
    return np.asarray(
        -c[:, 0] * np.sum(force * normal, axis=1)
        + c[:, 1] * np.sum(force * feed, axis=1)
        + c[:, 2] * np.sum(force * across, axis=1)
    )


def arm_give(c: ContactMoments, rows: Index, T_base_blade: Array, at: Postures, friction: Array) -> Array:
    """Displacement (n,) of the contact along e per newton, from the flange's compliance and the lever to the contact."""
    lever = np.einsum("kij,kj->ki", T_base_blade[:, :3, :3], c.p[rows]) + T_base_blade[:, :3, 3] - c.T_base_flange[rows, :3, 3]
    force = at.e + friction[:, None] * at.x
    twist = np.einsum("kij,kj->ki", c.arm_compliance[rows], np.concatenate([force, np.cross(lever, force)], axis=1))
    moved = twist[:, :3] + np.cross(twist[:, 3:], lever)
    return np.asarray(np.sum(moved * at.e, axis=1))
