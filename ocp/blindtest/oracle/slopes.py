"""How the readings of a force world move with everything that a machine is drawn with: differences of the virtual cell.

A small twist of the flange tells most of it: wheel and blade displaced, links placed otherwise and joints turned are all twists
of the flange at its instant, by the machine's own frames.
"""

from dataclasses import dataclass, replace

import numpy as np

from ocp.blindtest.worlds.force_machines import (
    DRIFT,
    PLAY,
    SETPOINT_SD,
    SHEAR_GAIN_SD,
    SHEAR_ZERO_SD,
    STIFF_SD,
    WEAR,
    ZERO_SD,
    GrindingMachine,
)
from ocp.simulate.twin.arm.arm import make_arm
from ocp.simulate.twin.truth.planting import Planted
from ocp.simulate.twin.truth.truth import MASS_SD, PLACEMENT, STIFFNESS
from robots.pose import Array

NUDGE, TURN = 2e-5, 4e-5  # m, rad: steps of the differences; the contact is solved to far less
SCALE = 0.01  # relative, of stiffnesses and masses
PUSH = 0.1  # N


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the readings without noise (2, n, 6): flange per m and rad of its twist about its origin, base axes; joint
    per rad of a joint's angle, robot's sign. frames (n, 7, 4, 4) of the links; torque (n, 6) N m; give (6,) rad/(N m) of the
    joints that weight bends; approach (n, 6)."""

    flange: Array
    joint: Array
    frames: Array
    torque: Array
    give: Array
    approach: Array

    def of_twists(self, twist: Array) -> Array:
        """Readings (2, n, m) of twists (n, 6, m)."""
        return np.einsum("snk,nkm->snm", self.flange, twist)


def slopes_of(machine: GrindingMachine) -> Slopes:
    """Seven runs of the virtual cell."""
    bare = machine.bare.both
    flange = np.empty((*bare.shape, 6))
    for i in range(6):
        step = NUDGE if i < 3 else TURN
        flange[..., i] = (machine.log((), moved=step * np.eye(6)[i]).both - bare) / step
    still = machine.bench.still(machine.rows, machine.hall(machine.rows))
    settled = make_arm(machine.bench.cell, machine.truth).settled(still)
    frames, sign = settled.links, machine.bench.cell.robot.sign
    axis = sign[:, None] * frames[:, :6, :3, 2]
    arm = frames[:, 6:7, :3, 3] - frames[:, :6, :3, 3]
    turned = np.concatenate([np.cross(axis, arm), axis], axis=2).transpose(0, 2, 1)
    k = machine.truth.stiffness
    give = np.divide(1.0, k, out=np.zeros(6), where=k > 0) * machine.truth.bends
    joint = np.einsum("snk,nkm->snm", flange, turned)
    return Slopes(flange, joint, frames, settled.load_torque[:, :6], give, still.approach)


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Columns (2, n, p) per one sigma: of placement, springs and masses of the arm (36 + 6 + 7), which a tracker sees too, and of
    all the rest."""

    arm: Array
    rest: Array


def nuisance(machine: GrindingMachine, s: Slopes) -> Nuisance:
    """Everything that a machine is drawn with."""
    return Nuisance(_of_arm(machine, s), np.concatenate([*_of_frames(machine, s), *_of_contact(machine, s)], axis=2))


def _of_arm(machine: GrindingMachine, s: Slopes) -> Array:
    n = s.frames.shape[0]
    columns = []
    for link in range(1, 7):
        R = s.frames[:, link, :3, :3]
        lever = s.frames[:, 6, :3, 3] - s.frames[:, link, :3, 3]
        twist = np.zeros((n, 6, 6))
        twist[:, :3, :3] = twist[:, 3:, 3:] = R
        twist[:, :3, 3:] = np.cross(R, lever[:, :, None], axisa=1, axisb=1, axisc=1)
        columns.append(s.of_twists(twist) * np.repeat(PLACEMENT, 3))
    columns.append(s.joint * (s.torque * s.give) * STIFFNESS / np.sqrt(3.0))
    masses = np.zeros((2, n, 7))
    still = machine.bench.still(machine.rows, machine.hall(machine.rows))
    for link in range(1, 7):
        scale = machine.truth.mass_scale + SCALE * np.eye(7)[link]
        changed = make_arm(machine.bench.cell, replace(machine.truth, mass_scale=scale)).settled(still)
        torque = (changed.load_torque[:, :6] - s.torque) / SCALE
        masses[..., link] = np.einsum("snj,nj->sn", s.joint, torque * s.give) * MASS_SD
    return np.concatenate([*columns, masses], axis=2)


def _of_frames(machine: GrindingMachine, s: Slopes) -> list[Array]:
    """Wheel and blade displaced and turned."""
    cell = machine.bench.cell
    piece, wheel, n = cell.workpiece, cell.wheel, len(s.frames)
    flange = s.frames[:, 6]
    centre = wheel.centre + machine.truth.wheel_shift
    square = np.eye(3) - np.outer(wheel.axis, wheel.axis)
    lever = flange[:, :3, 3] - centre
    turned = np.concatenate([np.cross(square[None], lever[:, :, None], axisa=1, axisb=1, axisc=1),
                             np.broadcast_to(square, (n, 3, 3))], axis=1)  # fmt: skip
    R = flange[:, :3, :3]
    grip = np.einsum("nij,j->ni", R, piece.T_flange_blade[:3, 3])
    held = np.concatenate([-np.cross(R, grip[:, :, None], axisa=1, axisb=1, axisc=1), R], axis=1)
    return [
        -s.flange[..., :3] * wheel.centre_sd, -s.of_twists(turned) * wheel.axis_sd,
        s.of_twists(np.concatenate([R, np.zeros((n, 3, 3))], axis=1)) * piece.xyz_sd, s.of_twists(held) * piece.abc_sd,
    ]  # fmt: skip


def _of_contact(machine: GrindingMachine, s: Slopes) -> list[Array]:
    """Stiffnesses, setpoint, sensor; how the arm comes back in each run; drift, wear and play of a background."""
    truth, bare, rows = machine.truth, machine.bare, machine.rows
    columns = []
    for name in ("cover_scale", "blade_scale", "flange_scale"):
        changed = replace(truth, **{name: getattr(truth, name) + SCALE})
        columns.append((machine.log((), truth=changed).both - bare.both) / SCALE * STIFF_SD)
    changed = replace(truth, flange_offset=truth.flange_offset + PUSH)
    columns.append((machine.log((), truth=changed).both - bare.both) / PUSH * SETPOINT_SD)
    one, none = np.ones(len(rows.s)), np.zeros(len(rows.s))
    columns += [np.stack([one * ZERO_SD, none]), np.stack([none, bare.ft * SHEAR_GAIN_SD]), np.stack([none, one * SHEAR_ZERO_SD])]
    if machine.background:
        worn = machine.log([Planted("wheel_wear", None, {"m_per_s": WEAR})]).both - bare.both
        columns += [np.stack([rows.clock / 3600.0 * DRIFT, none]) / np.sqrt(3.0), worn / np.sqrt(3.0)]
    blocks = [np.stack(columns, axis=2)]
    if machine.background:
        blocks.append(s.joint * s.approach * PLAY / np.sqrt(3.0))
    repeats = np.zeros((*bare.both.shape, 6 * len(rows.runs)))
    for k in range(len(rows.runs)):
        repeats[:, rows.run == k, 6 * k : 6 * k + 6] = s.joint[:, rows.run == k] * truth.repeatability
    return [*blocks, repeats]
