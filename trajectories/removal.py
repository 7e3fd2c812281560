"""Material removal along a pass by Preston's law, relative to the nominal process.

Preston (1927, J. Soc. Glass Technol. 11, 214): removal rate = k * pressure * speed. Integrated over the time
the contact stays at a station, the depth taken off is k F v_belt dwell / (width * length of path), so
relative to the nominal force, belt speed and feed the factor k drops out.
"""

import numpy as np

from robots.pose import Array
from trajectories.joint_trajectory import JointTrajectory
from trajectories.toppra_law import times_at


def _cell_edges(trajectory: JointTrajectory) -> Array:
    s = trajectory.stations
    return np.concatenate([[0.0], 0.5 * (s[:-1] + s[1:]), [s[-1]]])


def dwell_times(trajectory: JointTrajectory) -> Array:
    """Seconds (n,) the contact spends in the cell of each waypoint; cells meet halfway between stations."""
    return np.asarray(np.diff(times_at(trajectory.law, _cell_edges(trajectory))))


def relative_removal(
    force: Array, dwell: Array, spacing: Array, nominal_force: float, nominal_feed: float, belt_ratio: Array | float = 1.0
) -> Array:
    """Depth taken off at each waypoint over the nominal depth, (n,): (F/F0) (dwell feed0 / spacing)
    (v_belt/v_belt0).

    force (n,) N, dwell (n,) s, spacing (n,) m of path that the dwell covers, nominal force N and feed m/s. At
    constant feed this is (F/F0) (feed0/feed); next to rest it stays finite, because the contact covers a
    finite cell.
    """
    force, dwell, spacing = (np.asarray(x, float) for x in (force, dwell, spacing))
    return np.asarray(force / nominal_force * dwell * nominal_feed / spacing * belt_ratio)


def removal_of(trajectory: JointTrajectory, force: Array, nominal_force: float, nominal_feed: float) -> Array:
    """`relative_removal` at the waypoints of a timed pass; force (n,) N at its stations."""
    spacing = np.diff(_cell_edges(trajectory))
    return relative_removal(force, dwell_times(trajectory), spacing, nominal_force, nominal_feed)
