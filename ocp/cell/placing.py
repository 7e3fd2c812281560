"""Where the wheel may stand: from how much of the blade the arm reaches it, its axis and direction kept."""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import Cell
from ocp.plan.clearance import flange_pose
from ocp.plan.passes.posture import contact_poses, keeps_ranges, posture_grid
from robots.inverse import ArmFamily, inverse_branches
from robots.pose import Array
from trajectories.passes import BladePath

PROBED = 16  # contacts of the blade that every place is tried with
ACROSS, UP = 25, 21  # places of the wheel along its direction and along the vertical
SPAN = 0.5  # of the arm's length, to either side of where the wheel stands
EVERY_ARC, EVERY_TURN = 2, 4  # of the planner's grid of places on the arc and of turns


@dataclass(frozen=True)
class WheelRegion:
    """Places (n, 3) m of the wheel's centre in the base frame, in a plane that holds its direction and the vertical, and the
    share (n,) of the blade's contacts that the arm reaches there within its ranges, collisions aside; across (n,) and up (n,) m:
    the places in that plane, from the base."""

    centre: Array
    share: Array
    across: Array
    up: Array


def arm_length(family: ArmFamily) -> float:
    """From axis 1 to the wrist, stretched, m."""
    return abs(family.a1) + family.a2 + family.l3


def wheel_region(cell: Cell, paths: list[BladePath], length: float) -> WheelRegion:
    """The share of probed contacts that can be reached with the wheel in each place of a grid about its own, up to SPAN of the
    arm's `length`. Raises BadInput: the arm has no closed inverse."""
    flange = _flanges(cell, paths)
    away = -cell.wheel.contact_direction
    away = away - cell.up * (away @ cell.up)
    sideways = np.linalg.norm(away) > 1e-6
    away = away / np.linalg.norm(away) if sideways else np.cross(cell.wheel.axis, cell.up)
    x, z = np.meshgrid(np.linspace(-SPAN, SPAN, ACROSS) * length, np.linspace(-SPAN, SPAN, UP) * length, indexing="ij")
    shift = x.ravel()[:, None] * away + z.ravel()[:, None] * cell.up
    share = np.array([reached_share(cell, flange, d) for d in shift])
    centre = cell.wheel.centre + shift
    return WheelRegion(centre, share, centre @ away, centre @ cell.up)


def nearest_whole(region: WheelRegion, wanted: Array) -> Array:
    """Of the places from which most is reached, the one farthest inside of them, of several the nearest to `wanted` (3,)."""
    most = region.share > region.share.max() - 1e-9
    inside = np.array([np.linalg.norm(region.centre[~most] - c, axis=1).min() if (~most).any() else 0.0 for c in region.centre])
    room = min(0.1 * float(np.ptp(region.across)), float(inside[most].max()))
    good = np.flatnonzero(most & (inside >= room - 1e-9))
    return np.asarray(region.centre[good[np.argmin(np.linalg.norm(region.centre[good] - wanted, axis=1))]])


def _flanges(cell: Cell, paths: list[BladePath]) -> Array:
    """Flange poses (probes, options, 4, 4) that lay contacts spread over all paths on the wheel."""
    arcs, turns = posture_grid(cell)
    arc, turn = (grid.ravel() for grid in np.meshgrid(arcs[::EVERY_ARC], turns[::EVERY_TURN], indexing="ij"))
    contacts = [(path, k) for path in paths for k in range(len(path.s))]
    found = []
    for i in np.linspace(0, len(contacts) - 1, PROBED).round().astype(int):
        path, k = contacts[i]
        ways = [contact_poses(cell, path, np.array([k]), arc, turn, direction, cell.process.sigma) for direction in (1, -1)]
        found.append(np.concatenate(ways)[:, 0])
    return flange_pose(cell, np.stack(found))


def reached_share(cell: Cell, flange: Array, shift: Array) -> float:
    """Share of probes, flange poses (probes, options, 4, 4), that some posture within the ranges reaches once all are moved."""
    T = flange.copy()
    T[..., :3, 3] += shift
    q, reachable = inverse_branches(cell.robot, T.reshape(-1, 4, 4))
    sound = reachable & keeps_ranges(cell, np.where(reachable[..., None], q, 0.0))
    return float(sound.reshape(len(flange), -1).any(axis=1).mean())
