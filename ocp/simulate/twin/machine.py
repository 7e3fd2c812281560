"""The arm as a MuJoCo model, bodies with masses, each joint a driven hinge in series with a spring hinge; and its static
equilibrium, posture by posture, from the engine's torques and each spring's law.

Body i carries joint i. Its frame is link frame i - 1 turned by the theta offset, so that both hinges turn about its z axis and
the driven hinge's coordinate is q in the controller's sign. Link frame i stands in it as a site, at
Tz(d) Tx(a) Rx(alpha) Ry(beta) and the link's placement error. The body `base` under all of it can be tilted; spring
hinges inside a link bend it; a spatial tendon can pull between link 1 and the upper arm.

At rest the engine's generalised force on a spring hinge is r = passive - bias + applied, `passive` holding the spring's own
-k x and the tendon's pull, `bias` gravity. The torque that loads the spring is tau = r + k x, and its law gives the next x:

    x <- c tau - c3 tau^3 + h |tau| s + b tanh(tau / tau0)                                                                (1)

with hardening c3, windup h in the direction s of approach, and play b that the load takes up over tau0. A step gains the factor
|c dtau/dx|, 2e-3 for this arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robots.errors import Infeasible
from robots.pose import Array, invert, make_transform, rot_x, rot_y, rot_z
from robots.robot import Robot

Index = NDArray[np.int64]

GRAVITY = 9.81  # m/s^2, the value that reproduces the own-weight torques of PHYSICS 2.5
# Links without mass of their own (lumped into others): the least that the engine takes, kg and kg m^2; 1e-8 N m of weight.
LEAST = 1e-9
ROTOR = 1.0  # kg m^2 of rotor at the link side; no part in statics, keeps the engine's mass matrix regular
RIGID = 1e12  # N m/rad written for a hinge that does not give
GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))  # shares of a link's length at which it bends
_GROWN = 1e-3  # growth at which the growing places are found; they are linear in it


@dataclass(frozen=True)
class Bending:
    """Link `joint` (2 or 3) is a beam that bends about lines parallel to that joint's axis: turn of its end in rad per N m of
    mean moment, L / EI. Two spring hinges of half of it, where Gauss's rule has its points: exact for moments that change
    linearly along the beam, turn and sag."""

    joint: int
    compliance: float


@dataclass(frozen=True)
class Balancer:
    """A spring (N/m) from link 1, `levers[0]` m above axis 2, to the upper arm, `levers[1]` m from axis 2 toward the elbow.

    Its free length is the distance of its ends when the upper arm stands upright.
    """

    stiffness: float
    levers: tuple[float, float]


@dataclass(frozen=True)
class ArmDesign:
    """What an arm is built of: robot (signs, mounting), mdh (6, 5), placement (6, 6) m and rad, masses: kg (7,) and centres
    (7, 3) m of base and links, compliance (6,) rad/(N m) of the joints' springs (0 rigid), bending links, balancer; growth of the
    lengths d and a; whether they will grow while the machine is used."""

    robot: Robot
    mdh: Array
    placement: Array
    masses: tuple[Array, Array]
    compliance: Array
    bendings: tuple[Bending, ...] = ()
    balancer: Balancer | None = None
    growth: float = 0.0
    grows: bool = False


@dataclass(frozen=True)
class ArmModel:
    """A compiled arm with its working data, and where its parts are.

    drives (6,), springs (6, then two for each bending link) are indices of coordinates; compliance of each spring rad/(N m);
    sites (6,) of link frames 1..6; bodies (7,) that carry link frames 0..6; body_growth (nbody, 3) and site_growth (nsite, 3)
    m: change of places for growth 1.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    drives: Index
    springs: Index
    compliance: Array
    sites: Index
    bodies: Index
    body_growth: Array
    site_growth: Array


def build_machine(design: ArmDesign, payload: tuple[float, Array]) -> ArmModel:
    """Compile the arm with a payload: mass kg and centre (3,) m in the flange frame."""
    model = _model(design, payload)
    grown = _model(replace(design, growth=design.growth + _GROWN), payload) if design.grows else model
    names = [f"spring{i}" for i in range(1, 7)] + [f"bend{b.joint}_{k}" for b in design.bendings for k in range(2)]
    tips = {b.joint: f"part{b.joint}_1" for b in design.bendings}
    carriers = ["base"] + [tips.get(i, f"link{i}") for i in range(1, 7)]
    kind = mujoco.mjtObj
    drives = _ids(model, kind.mjOBJ_JOINT, [f"drive{i}" for i in range(1, 7)])
    springs, bodies = _ids(model, kind.mjOBJ_JOINT, names), _ids(model, kind.mjOBJ_BODY, carriers)
    sites = _ids(model, kind.mjOBJ_SITE, [f"frame{i}" for i in range(1, 7)])
    compliance = np.array([*design.compliance, *(0.5 * b.compliance for b in design.bendings for _ in range(2))])
    growth = (grown.body_pos - model.body_pos) / _GROWN, (grown.site_pos - model.site_pos) / _GROWN
    return ArmModel(model, mujoco.MjData(model), drives, springs, compliance, sites, bodies, *growth)


def _ids(model: mujoco.MjModel, kind: mujoco.mjtObj, names: Sequence[str]) -> Index:
    return np.array([mujoco.mj_name2id(model, kind, name) for name in names], np.int64)


def _model(design: ArmDesign, payload: tuple[float, Array]) -> mujoco.MjModel:
    """All joints are hinges: coordinate, velocity and joint share one index."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.boundmass, spec.compiler.boundinertia, spec.compiler.balanceinertia = LEAST, LEAST, True
    spec.option.gravity = (GRAVITY * design.robot.gravity_direction).tolist()
    parent, before = spec.worldbody.add_body(name="base"), np.eye(4)
    for i in range(6):
        parent, before = _link(parent, before, design, i)
    _weight(_body(parent, "payload", before), payload[0], np.eye(4), payload[1])
    if design.balancer is not None:
        _tendon(spec, design.balancer)
    return spec.compile()


def _link(parent: mujoco.MjsBody, before: Array, design: ArmDesign, i: int) -> tuple[mujoco.MjsBody, Array]:
    """Link i + 1 after the link frame `before` of `parent`: the body that carries its frame, and the frame in it."""
    robot, (offset, d, a, alpha, beta) = design.robot, design.mdh[i]
    mass, centre = design.masses[0][i + 1], design.masses[1][i + 1]
    body = _body(parent, f"link{i + 1}", before @ make_transform(rot_z(offset), np.zeros(3)))
    _hinge(body, f"drive{i + 1}", robot.sign[i], None)
    _hinge(body, f"spring{i + 1}", robot.sign[i], design.compliance[i])
    place = make_transform(rot_x(alpha) @ rot_y(beta), np.array([a, 0.0, d]) * (1 + design.growth))
    shift, turn = design.placement[i, :3], design.placement[i, 3:]
    frame = place @ make_transform(Rotation.from_rotvec(turn).as_matrix(), shift)
    holder, at = body, frame
    for bend in design.bendings:
        if bend.joint != i + 1:
            continue
        # From the joint's axis to the next: link 3 reaches along its frame's z to the wrist.
        end = frame[:3, 3] if i == 1 else frame[:3, 3] + frame[:3, 2] * design.mdh[i + 1, 1]
        com, passed = frame[:3, :3] @ centre + frame[:3, 3], 0.0
        for k, share in enumerate(GAUSS):
            step = make_transform(np.eye(3), (share - passed) * end)
            body, frame, passed = _body(body, f"part{i + 1}_{k}", step), invert(step) @ frame, share
            _hinge(body, f"bend{i + 1}_{k}", robot.sign[i], 0.5 * bend.compliance)
            if com @ end > share * end @ end:
                holder, at = body, frame
    _weight(holder, mass, at, centre)
    body.add_site(name=f"frame{i + 1}", pos=frame[:3, 3], quat=_quaternion(frame[:3, :3]))
    return body, frame


def _body(parent: mujoco.MjsBody, name: str, T: Array) -> mujoco.MjsBody:
    return parent.add_body(name=name, pos=T[:3, 3], quat=_quaternion(T[:3, :3]))


def _hinge(body: mujoco.MjsBody, name: str, sign: float, compliance: float | None) -> None:
    """A hinge about z of its body: driven (compliance None), or a spring."""
    joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, sign])
    if compliance is None:
        joint.armature = ROTOR
    else:
        joint.armature = LEAST
        joint.stiffness = [1.0 / compliance if compliance > 0 else RIGID, 0.0, 0.0]


def _weight(body: mujoco.MjsBody, mass: float, frame: Array, com: Array) -> None:
    """Mass kg with its centre (3,) m in the axes of `frame`, which stands in the body; its spread has no part in statics."""
    body.explicitinertial = True
    body.mass = max(mass, LEAST)
    body.ipos = frame[:3, :3] @ com + frame[:3, 3]
    body.inertia = [LEAST] * 3


def _tendon(spec: mujoco.MjSpec, balancer: Balancer) -> None:
    """Anchors in the plane across axis 2 through its origin: above it on link 1, toward the elbow on the upper arm.

    Body 1 turns about the upright, so that what is above axis 2 stays above it.
    """
    column, upper = spec.body("link1"), spec.body("link2")
    axis = Rotation.from_quat(upper.quat, scalar_first=True).as_matrix()[:, 2]
    up = np.array([0.0, 0.0, 1.0]) - axis * axis[2]
    elbow = spec.site("frame2").pos * [1.0, 1.0, 0.0]
    high, far = balancer.levers
    column.add_site(name="anchor1", pos=upper.pos + high * up / np.linalg.norm(up))
    upper.add_site(name="anchor2", pos=far * elbow / np.linalg.norm(elbow))
    tendon = spec.add_tendon(name="balancer")
    tendon.stiffness = [balancer.stiffness, 0.0, 0.0]
    tendon.springlength = [abs(high - far)] * 2
    tendon.wrap_site("anchor1")
    tendon.wrap_site("anchor2")


def _quaternion(R: Array) -> Array:
    """Unit quaternion (4,) w x y z of a rotation (3, 3)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
    return quaternion


ACCURACY = 1e-12  # rad, 2 pm at 2 m
MOST_STEPS = 60


@dataclass(frozen=True)
class Laws:
    """What springs do beyond their stiffness: hardening c3 (ns,) rad/(N m)^3, windup h (ns,) rad/(N m); of the joints' springs
    play b (6,) rad that the load takes up over tau0 (6,) N m."""

    cubic: Array
    windup: Array
    play: Array
    taken_up: Array

    @cached_property
    def plain(self) -> bool:
        """Whether all springs are linear; every posture asks."""
        return not (self.cubic.any() or self.windup.any() or self.play.any())

    def beyond(self, tau: Array, sign: Array) -> Array:
        """Turn (ns,) rad beside c tau at torques tau (ns,) N m, approached along sign (6,)."""
        turn = -self.cubic * tau**3
        turn[:6] += self.windup[:6] * np.abs(tau[:6]) * sign + self.play * np.tanh(self._filled(tau[:6]))
        return np.asarray(turn)

    @property
    def bends_on(self) -> bool:
        """Whether a spring gives by another measure under more load."""
        return bool(self.cubic.any() or self.play.any())

    def beside(self, tau: Array, more: Array) -> Array:
        """Compliance (n, ns) rad/(N m) beside c: turn over load of what comes on top, `more` N m (n, ns), of torques tau (n, ns);
        windup holds."""
        found = -self.cubic * (3 * tau**2 + 3 * tau * more + more**2)
        at, step = self._filled(tau[:, :6]), self._filled(more[:, :6])
        # tanh(a + b) - tanh(a) = tanh(b) (1 - tanh(a) tanh(a + b)); over b without a difference of near ones
        share = np.divide(np.tanh(step), step, out=np.ones_like(step), where=step != 0)
        per = np.divide(self.play, self.taken_up, out=np.zeros(6), where=self.taken_up > 0)
        found[:, :6] += per * share * (1 - np.tanh(at) * np.tanh(at + step))
        return np.asarray(found)

    def _filled(self, tau: Array) -> Array:
        return np.divide(tau, self.taken_up, out=np.zeros_like(tau), where=self.taken_up > 0)


@dataclass(frozen=True)
class Situations:
    """n postures: motor (n, 6) rad after the gears; sign (n, 6) of approach; growth (n,) of the lengths; load (n, 6) N, N m in
    base axes on load_link (n,) at load_place (n, 3) m; base_quat (n, 4) of a tilted base, or None."""

    motor: Array
    sign: Array
    growth: Array
    load: Array
    load_link: Index
    load_place: Array
    base_quat: Array | None = None


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
    loaded = np.any(at.load != 0.0, axis=1).tolist()
    try:
        for k in range(n):
            if grows:
                model.body_pos[:] = places[0] + at.growth[k] * machine.body_growth
                model.site_pos[:] = places[1] + at.growth[k] * machine.site_growth
            if at.base_quat is not None:
                model.body_quat[base] = at.base_quat[k]
            data.qpos[machine.drives] = at.motor[k]
            x, tau, holding, used = _equilibrium(machine, laws, at, k, x, loaded[k])
            steps += used
            bent[k], torque[k], motor[k] = x, tau, holding
            data.qpos[machine.springs] = x
            mujoco.mj_kinematics(model, data)
            position[k, 0], rotation[k, 0] = data.xpos[base], data.xmat[base]
            position[k, 1:], rotation[k, 1:] = data.site_xpos[machine.sites], data.site_xmat[machine.sites]
            mujoco.mj_jacSite(model, data, jacp, jacr, tip)
            jacobian[k, :3], jacobian[k, 3:] = jacp[:, machine.springs], jacr[:, machine.springs]
    finally:
        model.body_pos[:], model.site_pos[:], model.body_quat[:] = places
    links = np.zeros((n, 7, 4, 4))
    links[..., :3, :3], links[..., :3, 3], links[..., 3, 3] = rotation.reshape(n, 7, 3, 3), position, 1.0
    return Settled(links, bent, torque, motor, jacobian, steps)


def _equilibrium(
    machine: ArmModel, laws: Laws, at: Situations, k: int, x: Array, loaded: bool
) -> tuple[Array, Array, Array, int]:
    """Spring angles from x on, their load torques, the drives' holding torques, and the steps taken."""
    model, data, springs, c = machine.model, machine.data, machine.springs, machine.compliance
    stiffness, bias, before = model.jnt_stiffness[springs], np.empty(model.nv), 0.0
    # A step takes microseconds, and looking anything up is one of them.
    qpos, passive, tendons, plain = data.qpos, data.qfrc_passive, model.ntendon > 0, laws.plain
    for step in range(1, MOST_STEPS + 1):
        qpos[springs] = x
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        if tendons:
            mujoco.mj_tendon(model, data)
        mujoco.mj_passive(model, data)
        mujoco.mj_rne(model, data, 0, bias)
        force = passive - bias
        if loaded:
            force += _applied(machine, at, k)
        tau = force[springs] + stiffness * x
        new = c * tau
        if not plain:
            new += laws.beyond(tau, at.sign[k])
        off = float(np.abs(new - x).max())
        # The next step would be smaller by the same factor as this one was.
        if off < ACCURACY or off * off < ACCURACY * before:
            return new, tau, -force[machine.drives], step
        x, before = new, off
    raise Infeasible(
        f"posture {k + 1}: weight and springs of the arm find no equilibrium in {MOST_STEPS} steps; make the joints stiffer or "
        "the payload lighter"
    )


def _applied(machine: ArmModel, at: Situations, k: int) -> Array:
    """Generalised force (nv,) of the load."""
    link = int(at.load_link[k])
    force = np.zeros(machine.model.nv)
    if link > 0:
        data, site = machine.data, int(machine.sites[link - 1])
        point = data.site_xpos[site] + data.site_xmat[site].reshape(3, 3) @ at.load_place[k]
        body = int(machine.bodies[link])
        mujoco.mj_applyFT(machine.model, data, at.load[k, :3], at.load[k, 3:], point, body, force)
    return force
