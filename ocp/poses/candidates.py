"""Postures in which a reading could be taken: inside the limits, free of collisions, strong enough, seen by the tracker."""

from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray

from ocp.model.cell import Cell
from ocp.plan.clearance.collision import Body, BodyPair, CollisionScene, _between
from ocp.plan.rules import ARM_MARGIN
from ocp.poses.line_of_sight import Sight, visible
from ocp.poses.rules import AXIS_MARGIN, BRACKET_RADIUS, HOLDING_SHARE, WRIST_RANGE
from ocp.poses.zone import GroundBlade, near_zone
from robots.errors import Infeasible
from robots.gravity import weight_torques
from robots.pose import Array
from robots.tracker_readings import Hanging, Nest

Mask = NDArray[np.bool_]

RANDOM, NEAR = 2000, 1000  # postures tried: anywhere, and with the blade near the wheel
STAND = (3.5, 1.5)  # m from axis 1 and above the floor of the base: where the tracker is taken to stand
AZIMUTHS = 24
SAMPLE = 600  # postures on which stands are compared


@dataclass(frozen=True)
class CandidatePoses:
    """Postures q (m, 6) rad with the signs (m, 6) of their first approach, `near` (m,) those close to the wheel, `seen` (m, k)
    which of the k nests the tracker sees."""

    q: Array
    sign: Array
    near: Mask
    seen: Mask


def free_postures(
    cell: Cell, scene: CollisionScene, blade: GroundBlade, payloads: list[Hanging], approach: float, rng: np.random.Generator
) -> tuple[Array, Array, Mask]:
    """Postures (m, 6) rad, the signs (m, 6) of their first approach, and which are near the wheel.

    They are free from `approach` rad before to as much behind on every axis. The signs are drawn at random, so that what
    backlash does in one axis is not mistaken for another's. Raises Infeasible: hardly any posture is free.
    """
    robot = cell.robot
    margin = AXIS_MARGIN + approach
    low, high = robot.q_min + margin, robot.q_max - margin
    wrist = np.array([np.inf, np.inf, np.inf, WRIST_RANGE, np.inf, WRIST_RANGE])
    anywhere = rng.uniform(np.maximum(low, -wrist), np.minimum(high, wrist), (RANDOM, 6))
    close = near_zone(cell, blade, NEAR, rng)
    q, near = np.vstack([anywhere, close]), np.arange(RANDOM + len(close)) >= RANDOM
    ok = ((q >= low) & (q <= high)).all(axis=1)
    for load in payloads:
        torque = weight_torques(robot, q, load.mass, load.com)
        ok &= (np.abs(torque) <= HOLDING_SHARE * robot.torque_max).all(axis=1)
    q, near = q[ok], near[ok]
    sign = rng.choice([-1.0, 1.0], q.shape)
    free = np.ones(len(q), bool)
    for part in (0.0, -1.0, 1.0, -0.5, 0.5):
        rows = np.flatnonzero(free)
        free[rows] = scene.clearances(q[rows] + part * approach * sign[rows], in_contact=False)[0] >= 0
    if free.sum() < 10:
        raise Infeasible(
            f"only {int(free.sum())} of {len(q)} postures tried are free of collisions; check wheel, workpiece and targets "
            f"of {cell.path.name}"
        )
    return q[free], sign[free], near[free]


def visible_nests(cell: Cell, sight: Sight, nests: list[Nest], tracker: Array, q: Array) -> Mask:
    """Which nests (n, k) a tracker at (3,) m sees at postures q (n, 6)."""
    return np.stack([visible(cell.robot, cell.wheel, sight, nest, tracker, q) for nest in nests], axis=1)


def choose_stand(cell: Cell, sight: Sight, nests: list[Nest], q: Array, rng: np.random.Generator) -> Array:
    """The tracker's place (3,) m around the robot, `STAND` away, from which most readings of postures q (n, 6) are seen."""
    sample = q if len(q) <= SAMPLE else q[rng.choice(len(q), SAMPLE, replace=False)]
    angle = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    stands = np.stack([STAND[0] * np.cos(angle), STAND[0] * np.sin(angle), np.full(AZIMUTHS, STAND[1])], axis=1)
    counts = [int(visible_nests(cell, sight, nests, stand, sample).sum()) for stand in stands]
    return np.asarray(stands[int(np.argmax(counts))])


class MeasuringScene(CollisionScene):
    """A `CollisionScene` with a rod from the flange to every nest it carries; rods may meet column, arm, wheel and floor.

    Nests on other links are taken to sit close to them.
    """

    def __init__(self, cell: Cell, blade_vertices: Array, nests: dict[str, Nest]) -> None:
        """`blade_vertices` (n, 3) m in the blade frame; `nests` by name."""
        super().__init__(cell, blade_vertices)
        fixed = list(range(len(self._bodies)))
        for name, nest in nests.items():
            if nest.link != 6 or nest.place is None:
                continue
            placement, length = _between(np.zeros(3), nest.place)
            self._bodies.append(Body(f"reflector {name}", 6, coal.Capsule(BRACKET_RADIUS, max(length, 1e-3)), placement))
            mine = len(self._bodies) - 1
            for i in fixed:
                if self._bodies[i].frame <= 3 or self._bodies[i].frame == 7:
                    self._pairs.append(BodyPair(i, mine, ARM_MARGIN))
