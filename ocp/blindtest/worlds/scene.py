"""Where every reflector of a campaign stands on a virtual cell, and how readings move when the machine does.

Everything comes from the virtual cell's own frames and torques (`ocp.simulate.twin`); nothing of the diagnosis' model is used, so
that signatures and detectabilities of the blind check are an independent measure. SI and radians; points in the tracker's axes.
"""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.arm.arm import Arm, make_arm
from ocp.simulate.twin.designs import Campaign
from ocp.simulate.twin.tracker import nest_links
from ocp.simulate.twin.truth.machine import Truth
from robots.pose import Array, apply


@dataclass(frozen=True, eq=False)
class Scene:
    """A campaign on a machine without planted effects.

    links (n, 7, 4, 4) base axes; point (n, 3) m reflectors in the tracker's frame; inner (n, 3) m the same in base axes; carrier
    (n,) link that bears the nest; turn (3, 3) rotation from base to tracker axes; D (n, 3, 6) m/rad derivative of the points in
    the joints' angles (robot's signs); tau (n, 6) N m load torques; warmth (n,) K.
    """

    cell: Cell
    truth: Truth
    campaign: Campaign
    arm: Arm
    links: Array
    point: Array
    inner: Array
    carrier: Array
    turn: Array
    D: Array
    tau: Array
    warmth: Array

    def __len__(self) -> int:
        return len(self.campaign)

    def moved(self, link: int, motion: Array) -> Array:
        """Change (n, 3, m) of the points when link `link` and all that follows it make small motions (n, 6, m): m at that link's
        origin and rad, base axes."""
        arms = self.inner - self.links[:, link, :3, 3]
        shift = motion[:, :3] + np.cross(motion[:, 3:], arms[:, :, None], axisa=1, axisb=1, axisc=1)
        return np.einsum("ij,njm->nim", self.turn, shift) * (self.carrier >= link)[:, None, None]


def scene_of(cell: Cell, truth: Truth, campaign: Campaign) -> Scene:
    """The scene of a campaign; `truth` without planted effects."""
    arm = make_arm(cell, truth)
    m = campaign.moments
    settled = arm.settled(m)
    links, n = settled.links, len(campaign)
    carrier = nest_links(cell, campaign.targets)
    nests = np.array([truth.nests[name] for name in campaign.targets]).reshape(-1, 3)
    inner = apply(links[np.arange(n), carrier], nests)
    turn = truth.T_tracker_base[:3, :3]
    D = np.empty((n, 3, 6))
    for j in range(6):
        # Joint j + 1 turns about the z axis of the frame before it (docs/architecture.md, MD-H), in the robot's sign.
        axis = cell.robot.sign[j] * links[:, j, :3, 2]
        D[:, :, j] = np.cross(axis, inner - links[:, j, :3, 3]) @ turn.T * (carrier > j)[:, None]
    warmth = m.temperature_C - cell.tables.reference_temperature_C
    return Scene(
        cell, truth, campaign, arm, links, apply(truth.T_tracker_base, inner), inner, carrier, turn, D,
        settled.load_torque[:, :6], warmth,
    )  # fmt: skip
