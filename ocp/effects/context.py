"""What effects may depend on: symbols of one instant of the arm, of a tracker reading, of a contact; rows of a log."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from robots.pose import Array

SETTLING = (20.0, 60.0, 200.0)  # s: how fast an axis may come to rest after its stop
LOADED = "loaded"  # in place of a payload's name: whatever has a mass


@dataclass(frozen=True)
class ArmContext:
    """Symbols (CasADi SX) of an instant: q (6) commanded and q_real (6) bent joints rad; tau (6) load torque N m about the
    axes, positive along +q, at the bent posture; c (6) compliances rad/(N m); approach (6) signs of the last motion; warm K
    above the cell's reference temperature; time s on the campaign's clock; speed (6) rad/s of the commanded joints; frames:
    link frames 0..6 (4, 4) in the base frame; gear_ratio (6,) numbers, those of a sister machine or nan where the robot's are
    unknown; payload (4): mass kg, centre m in the flange frame; hung: index of the payload in `payloads`; sign (6,) of KUKA's
    axes; settling (3): what is left of the motion to where the arm stands, after settling as fast as each of `SETTLING` (0: it
    stands for long, or moves on); down (3,): unit direction of gravity in the base frame; weight_torque(mass, com): load torque
    (6) N m of an added mass kg at com (3) m in the flange frame."""

    q: ca.SX
    q_real: ca.SX
    tau: ca.SX
    c: ca.SX
    approach: ca.SX
    warm: ca.SX
    time: ca.SX
    frames: list[ca.SX]
    gear_ratio: Array
    payload: ca.SX
    sign: Array
    weight_torque: Any
    link_mass: Array
    link_com: Array
    speed: ca.SX
    hung: ca.SX
    settling: ca.SX
    payloads: tuple[str, ...]
    down: Array

    def is_payload(self, name: str) -> ca.SX:
        """1 where the payload of that name hangs, 0 elsewhere; "loaded": any with a mass."""
        if name == LOADED:
            return self.payload[0] > 0
        return self.hung == self.payloads.index(name) if name in self.payloads else ca.SX(0)


@dataclass(frozen=True)
class TrackerContext:
    """Symbols of a tracker reading: point (3) m predicted in the tracker's frame; R (3, 3) of the nest's link in the
    tracker's frame; time s, warm K; target: index of the nest in `targets`."""

    point: ca.SX
    R: ca.SX
    time: ca.SX
    warm: ca.SX
    target: ca.SX
    targets: tuple[str, ...]

    def is_target(self, name: str) -> ca.SX:
        """1 where the nest of that name was read, 0 elsewhere."""
        return self.target == self.targets.index(name) if name in self.targets else ca.SX(0)


@dataclass(frozen=True)
class ContactContext:
    """Symbols of a contact sample at the believed model's equilibrium.

    q (6) rad commanded; F N normal force; parts m: flange, wheel, blade, robot (`ocp.model.force_balance.Model.parts`) with
    slopes m/N: their derivatives in F (flange, wheel, blade, robot); curvature (3) relative 1/m, lateral m, tilt (2), arc rad,
    turn rad; p, n, t (3): contact point, normal and feed in the blade frame; e, belt_direction, n_base, axis (3): base frame;
    R_flange (3, 3), R_blade (3, 3): in the base frame; s m; setpoint N, feed m/s, belt m/s; time s in the run, clock s in the
    campaign; ground_before; warm, wheel_warm K above the reference; travel: sign of the motion along the pass (+1 with increasing
    s); radius m, friction of the cell; normal_stiffness N/m: dF per m of overlap; friction_deflection m: by how much more the
    parts give way per unit of the friction coefficient; lever m: height of the contact over the clamp's plane; joint_lever (6)
    m/rad: by how far each joint moves the contact out of the wheel; joint_push (6) N m: the contact's torques about the axes,
    beside tau (6) N m of the weight, all positive along +q; push_axis (3): direction in which the flange pushes the blade, base
    frame; clamp_deflection m: how much of the parts is the clamp's stiffness; line of the blade; down (3,): unit direction of
    gravity in the base frame.
    """

    q: ca.SX
    F: ca.SX
    parts: ca.SX
    slopes: ca.SX
    curvature: ca.SX
    lateral: ca.SX
    tilt: ca.SX
    arc: ca.SX
    turn: ca.SX
    p: ca.SX
    n: ca.SX
    t: ca.SX
    e: ca.SX
    belt_direction: ca.SX
    n_base: ca.SX
    axis: ca.SX
    R_flange: ca.SX
    R_blade: ca.SX
    s: ca.SX
    setpoint: ca.SX
    feed: ca.SX
    belt: ca.SX
    time: ca.SX
    clock: ca.SX
    ground_before: ca.SX
    warm: ca.SX
    wheel_warm: ca.SX
    travel: ca.SX
    radius: float
    friction: float
    normal_stiffness: ca.SX
    friction_deflection: ca.SX
    lever: ca.SX
    joint_lever: ca.SX
    joint_push: ca.SX
    tau: ca.SX
    push_axis: ca.SX
    clamp_deflection: ca.SX
    line: ca.SX
    down: Array


@dataclass(frozen=True)
class LogRows:
    """A log in time order for effects that remember: run (n,), time s, s m, F N, d_wheel and d_flange m of the model, stiffness
    N/m (dF per m of overlap), wheel_share and flange_share (shares of that compliance that are theirs), fn and ft as predicted N,
    contact (n,), travel (n,), feed m/s, clock s or None; stroke m: d_flange.

    A hook gives what F, fn, ft and stroke make of it, or, where these are columns (n, k) of small changes, what they change."""

    run: Array
    time: Array
    s: Array
    F: Array
    d_wheel: Array
    d_flange: Array
    stiffness: Array
    wheel_share: Array
    flange_share: Array
    fn: Array
    ft: Array
    contact: Array
    travel: Array
    feed: Array
    clock: Array | None
    stroke: Array
