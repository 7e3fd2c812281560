"""Static equilibrium of the machine, posture by posture: the engine's torques, each spring's law, a fixed point of both.

At rest the engine's generalised force on a spring hinge is r = passive - bias + applied, `passive` holding the spring's own
-k x and the tendon's pull, `bias` gravity. The torque that loads the spring is tau = r + k x, and its law gives the next x:
    x <- c tau - c3 tau^3 + h |tau| s                                                                                     (1)
with hardening c3 and windup h in the direction s of approach. A step gains the factor |c dtau/dx|, 2e-3 for this arm.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from ocp.simulate.twin.arm.machine import ArmModel, Index
from robots.errors import Infeasible
from robots.pose import Array

ACCURACY = 1e-12  # rad, 2 pm at 2 m
MOST_STEPS = 60


@dataclass(frozen=True)
class Laws:
    """What springs do beyond their stiffness: hardening c3 (ns,) rad/(N m)^3, windup h (ns,) rad/(N m)."""

    cubic: Array
    windup: Array

    @property
    def plain(self) -> bool:
        """Whether all springs are linear."""
        return not (self.cubic.any() or self.windup.any())


@dataclass(frozen=True)
class Situations:
    """n postures: motor (n, 6) rad after the gears; sign (n, 6) of approach; growth (n,) of the lengths; base_quat (n, 4) of a
    tilted base, or None; load (n, 6) N, N m in base axes on load_link (n,) at load_place (n, 3) m, or None; qd, qdd (n, 6) of
    the motors where torques in motion are wanted, or None."""

    motor: Array
    sign: Array
    growth: Array
    base_quat: Array | None = None
    load: Array | None = None
    load_link: Index | None = None
    load_place: Array | None = None
    qd: Array | None = None
    qdd: Array | None = None


@dataclass(frozen=True)
class Settled:
    """Equilibria: links (n, 7, 4, 4) frames of base and links; bent (n, ns) rad; load_torque (n, ns) N m on the springs,
    positive along +q; motor_torque (n, 6) N m that the drives hold; jacobian (n, 6, ns) of the flange origin in the springs
    (m/rad, then rad/rad; base axes); steps: iterations in all."""

    links: Array
    bent: Array
    load_torque: Array
    motor_torque: Array
    jacobian: Array
    steps: int


def equilibria(machine: ArmModel, laws: Laws, at: Situations) -> Settled:
    """Equilibria of all situations in their order; each starts from the one before.

    Raises Infeasible: the springs are too soft for what hangs on the arm.
    """
    model, data = machine.model, machine.data
    n, ns, nv = len(at.motor), len(machine.springs), model.nv
    position, rotation = np.empty((n, 7, 3)), np.empty((n, 7, 9))
    bent, torque, motor = np.empty((n, ns)), np.empty((n, ns)), np.empty((n, 6))
    jacobian, jacp, jacr = np.empty((n, 6, ns)), np.zeros((3, nv)), np.zeros((3, nv))
    x, steps = np.zeros(ns), 0
    grows = bool(at.growth.any())
    places = model.body_pos.copy(), model.site_pos.copy(), model.body_quat.copy()
    base, tip = int(machine.bodies[0]), int(machine.sites[5])
    data.qvel[:] = 0.0
    data.qpos[:] = 0.0
    try:
        for k in range(n):
            if grows:
                model.body_pos[:] = places[0] + at.growth[k] * machine.body_growth
                model.site_pos[:] = places[1] + at.growth[k] * machine.site_growth
            if at.base_quat is not None:
                model.body_quat[base] = at.base_quat[k]
            data.qpos[machine.drives] = at.motor[k]
            x, tau, holding, used = _equilibrium(machine, laws, at, k, x)
            steps += used
            bent[k], torque[k], motor[k] = x, tau, holding
            data.qpos[machine.springs] = x
            mujoco.mj_kinematics(model, data)
            position[k, 0], rotation[k, 0] = data.xpos[base], data.xmat[base]
            position[k, 1:], rotation[k, 1:] = data.site_xpos[machine.sites], data.site_xmat[machine.sites]
            mujoco.mj_jacSite(model, data, jacp, jacr, tip)
            jacobian[k, :3], jacobian[k, 3:] = jacp[:, machine.springs], jacr[:, machine.springs]
            if at.qd is not None and at.qdd is not None:
                motor[k] += _in_motion(machine, at.qd[k], at.qdd[k])
    finally:
        model.body_pos[:], model.site_pos[:], model.body_quat[:] = places
    links = np.zeros((n, 7, 4, 4))
    links[..., :3, :3], links[..., :3, 3], links[..., 3, 3] = rotation.reshape(n, 7, 3, 3), position, 1.0
    return Settled(links, bent, torque, motor, jacobian, steps)


def _equilibrium(machine: ArmModel, laws: Laws, at: Situations, k: int, x: Array) -> tuple[Array, Array, Array, int]:
    """Spring angles from x on, their load torques, the drives' holding torques, and the steps taken."""
    model, data, springs, c = machine.model, machine.data, machine.springs, machine.compliance
    stiffness, bias, before = model.jnt_stiffness[springs], np.empty(model.nv), 0.0
    applied = None
    for step in range(1, MOST_STEPS + 1):
        data.qpos[springs] = x
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        if model.ntendon:
            mujoco.mj_tendon(model, data)
        mujoco.mj_passive(model, data)
        mujoco.mj_rne(model, data, 0, bias)
        force = data.qfrc_passive - bias
        applied = _applied(machine, at, k)
        if applied is not None:
            force += applied
        tau = force[springs] + stiffness * x
        new = c * tau
        if not laws.plain:
            new -= laws.cubic * tau**3
            new[:6] += laws.windup[:6] * np.abs(tau[:6]) * at.sign[k]
        off = float(np.abs(new - x).max())
        # The next step would be smaller by the same factor as this one was.
        if off < ACCURACY or off * off < ACCURACY * before:
            return new, tau, -force[machine.drives], step
        x, before = new, off
    raise Infeasible(
        f"posture {k + 1}: weight and springs of the arm find no equilibrium in {MOST_STEPS} steps; make the joints stiffer or "
        "the payload lighter"
    )


def _applied(machine: ArmModel, at: Situations, k: int) -> Array | None:
    """Generalised force (nv,) of the load, None without."""
    if at.load is None or at.load_link is None or at.load_place is None or not at.load[k].any():
        return None
    link = int(at.load_link[k])
    force = np.zeros(machine.model.nv)
    if link > 0:
        data, site = machine.data, int(machine.sites[link - 1])
        point = data.site_xpos[site] + data.site_xmat[site].reshape(3, 3) @ at.load_place[k]
        body = int(machine.bodies[link])
        mujoco.mj_applyFT(machine.model, data, at.load[k, :3], at.load[k, 3:], point, body, force)
    return force


def _in_motion(machine: ArmModel, qd: Array, qdd: Array) -> Array:
    """Torques (6,) N m that the drives need beyond holding, without friction and rotors."""
    model, data = machine.model, machine.data
    result = np.empty((2, model.nv))
    for row, moving in enumerate((0.0, 1.0)):
        data.qvel[machine.drives], data.qacc[:] = moving * qd, 0.0
        data.qacc[machine.drives] = moving * qdd
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, result[row])
    data.qvel[:], data.qacc[:] = 0.0, 0.0
    mujoco.mj_comVel(model, data)
    return np.asarray((result[1] - result[0])[machine.drives])
