"""Link masses as nuisance: nobody knows a robot's links to better than a percent, and their weight bends the joints.

Springs are fitted to the sag under all weight together. Where the links are heavier than believed, a payload that is known well
bends the arm less than the springs so found say: it looks lighter, or a link looks as if it bent. To first order a link whose
mass is (1 + m) times the believed one moves joint j by m c_j tau_j, tau_j its own share of the load torque (PHYSICS 2.5).
"""

from dataclasses import replace

import numpy as np

from ocp.diagnose.tracker.motion import Seen
from robots.gravity import weight_torques
from robots.pose import Array

LINKS = (2, 3, 4, 5, 6)  # the base and link 1 turn about the vertical only
MASS_SD = 0.01  # relative (DIAGNOSIS: masses within 1 %)
NAMES = tuple(f"mass_link{i}" for i in LINKS)


def mass_columns(seen: Seen, d_joints: Array) -> Array:
    """Displacement (n, 3, 5) m per unit of relative mass of links 2 to 6; d_joints (n, 3, 6) m/rad."""
    springs = np.clip(seen.state.arm[30:], 0.0, None)
    found = []
    for link in LINKS:
        alone = np.zeros_like(seen.robot.link_mass)
        alone[link] = seen.robot.link_mass[link]
        tau = weight_torques(replace(seen.robot, link_mass=alone), seen.readings.q)
        found.append(np.einsum("nij,nj->ni", d_joints, springs * tau))
    return np.stack(found, axis=2)
