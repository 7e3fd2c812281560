"""The virtual arm: where its links and its flange really are, how much it gives, what its motors hold; and what hidden errors and
planted effects do to it, to the angles behind its gears and to the machine that is built.

The output of an axis is q + dq (rad, the controller's signs) before its spring bends; what depends on the load's torque is a
spring's law (`ocp.simulate.twin.machine`). Parts of the machine are springs, hinges inside links, a tendon, masses, growth,
a base that tilts.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin import machine
from ocp.simulate.twin.machine import ArmModel, Index, Settled
from ocp.simulate.twin.planting import Planted
from ocp.simulate.twin.truth import Truth
from robots.errors import BadInput
from robots.pose import Array
from robots.robot import Robot, load_robot


@dataclass(frozen=True)
class AxisState:
    """What dq depends on: q (n, 6) rad commanded, sign (n, 6) of the last motion, warmth (n,) K over the reference, robot."""

    q: Array
    sign: Array
    warmth: Array
    robot: Robot


def motor_side(truth: Truth, state: AxisState) -> Array:
    """Axis angles (n, 6) rad behind the gears: background ripple and play, then every planted effect of the joints."""
    q, (size, order, phase) = state.q, np.moveaxis(truth.ripple, 2, 0)
    real = q + (size * np.cos(order * q[:, :, None] + phase)).sum(axis=2) + truth.play * state.sign
    for planted in truth.effects:
        law = _LAWS.get(planted.effect)
        if law is not None and planted.joint is not None:
            real[:, planted.joint - 1] += law(planted, planted.joint - 1, state)
    return np.asarray(real)


def gear_ratios(robot: Robot) -> Array:
    """Motor turns per turn of each axis (6,).

    The extra's are not published: it takes those of the prime, its sister with the same limits and speeds (PHYSICS 2.1).
    Raises BadInput: a robot of which none are known.
    """
    ratio = robot.gear_ratio
    if np.isfinite(ratio).all():
        return ratio
    if robot.name.startswith("kr210"):
        return load_robot("kr210_r2700_prime").gear_ratio
    raise BadInput(f"robot '{robot.name}' has no gear ratios, which motor_harmonic needs; add [gears] to its file")


def _harmonic(planted: Planted, order: Array | float, q: Array) -> Array:
    wave = np.cos(order * q + planted.number("phase_rad"))
    return np.asarray(planted.number("amplitude_rad") * wave)


_LAWS: dict[str, Callable[[Planted, int, AxisState], Array]] = {
    "gear_1x": lambda p, j, s: _harmonic(p, 1.0, s.q[:, j]),
    "gear_2x": lambda p, j, s: _harmonic(p, 2.0, s.q[:, j]),
    "gear_harmonic": lambda p, j, s: _harmonic(p, p.number("order"), s.q[:, j]),
    "motor_harmonic": lambda p, j, s: _harmonic(p, p.number("order") * gear_ratios(s.robot)[j], s.q[:, j]),
    # The catalogue's sign: the axis rests on the side it came from, b ahead of the middle of its slack.
    "backlash": lambda p, j, s: p.number("half_width_rad") * s.sign[:, j],
    # The part without load; the part with it is a spring's law.
    "friction_windup": lambda p, j, s: p.number("base_rad") * s.sign[:, j],
    "encoder_scale": lambda p, j, s: p.number("scale") * s.q[:, j],
    "wrist_coupling": lambda p, j, s: p.number("ratio") * s.q[:, int(p.number("source_joint")) - 1],
    "joint_coupling": lambda p, j, s: p.number("ratio_rad") * s.q[:, int(p.number("source_joint")) - 1],
    "joint_thermal": lambda p, j, s: p.number("rad_per_K") * s.warmth,
}


@dataclass(frozen=True)
class Hardware:
    """The machine with its planted parts: design, laws of the springs, compliance (ns,) rad/(N m) of every spring under
    contact, and its cubic part in `laws`."""

    design: machine.ArmDesign
    laws: machine.Laws
    contact_compliance: Array


def hardware(robot: Robot, truth: Truth) -> Hardware:
    """What to build: the truth's springs, in series with those that are planted."""
    own = np.divide(1.0, truth.stiffness, out=np.zeros(6), where=truth.stiffness > 0)
    extra, bent = _by_joint(truth, "joint_compliance", "rad_per_Nm"), _by_joint(truth, "link_bending", "rad_per_Nm")
    cubic, windup = _by_joint(truth, "joint_stiffening", "rad_per_Nm3"), _by_joint(truth, "friction_windup", "per_Nm")
    bendings = tuple(machine.Bending(int(j) + 1, float(bent[j])) for j in np.flatnonzero(bent))
    springs = np.array([planted.number("stiffness_N_m") for planted in truth.planted("gravity_compensator")])
    levers = [(p.number("lever_link1_m"), p.number("lever_arm_m")) for p in truth.planted("gravity_compensator")]
    balancer = machine.Balancer(float(springs.sum()), levers[0]) if levers else None
    grows, bending = bool(truth.planted("link_thermal")), own * truth.bends + extra
    weights = link_weights(robot, truth)
    design = machine.ArmDesign(robot, truth.mdh, truth.placement, weights, bending, bendings, balancer, grows=grows)
    play, taken = _by_joint(truth, "load_backlash", "half_width_rad"), _by_joint(truth, "load_backlash", "torque_Nm")
    none = np.zeros(2 * len(bendings))  # two hinges a link
    contact = np.array([*(own + extra), *(0.5 * b.compliance for b in bendings for _ in range(2))])
    return Hardware(design, machine.Laws(np.array([*cubic, *none]), np.array([*windup, *none]), play, taken), contact)


def link_weights(robot: Robot, truth: Truth) -> tuple[Array, Array]:
    """Masses (7,) kg of base and links, and their centres (7, 3) m in the links' frames."""
    return truth.mass_scale * robot.link_mass, robot.link_com + truth.mass_shift


def _by_joint(truth: Truth, effect: str, key: str) -> Array:
    """Sizes (6,) of an effect that is planted at joints."""
    found = np.zeros(6)
    for planted in truth.planted(effect):
        found[(planted.joint or 1) - 1] += planted.number(key)
    return found


def hung(truth: Truth, name: str) -> tuple[float, Array]:
    """Mass kg and centre (3,) m of a payload as it is: planted errors are of every payload that weighs something."""
    mass, com = truth.payloads[name] if name else (0.0, np.zeros(3))
    more = truth.total("payload_mass", "kg") if mass > 0 else 0.0
    shift = sum((planted.vector("shift_m") for planted in truth.planted("payload_com")), np.zeros(3))
    return max(mass + more, 0.0), com + shift


def tool_give(truth: Truth, links: Array) -> Array:
    """Shift m per newton (n, 3, 3) of what is on the flange: a beam along the flange's axis gives across it."""
    axis = links[:, 6, :3, 2]
    return truth.total("tool_flex", "m_per_N") * (np.eye(3) - axis[:, :, None] * axis[:, None])


def growth(truth: Truth, warmth: Array) -> Array:
    """Relative growth (n,) of all lengths at `warmth` (n,) K above the reference temperature."""
    return truth.total("link_thermal", "per_K") * warmth


def base_tilt(truth: Truth, time_s: Array) -> Array | None:
    """Quaternions (n, 4), w first, of the base at times (n,) s; None where it never tilts."""
    steps = truth.planted("base_tilt")
    if not steps:
        return None
    turn = np.zeros((len(time_s), 3))
    for planted in steps:
        turn += np.where(time_s[:, None] >= planted.number("at_s"), planted.vector("rad"), 0.0)
    return np.asarray(Rotation.from_rotvec(turn).as_quat(scalar_first=True))


@dataclass(frozen=True, eq=False)
class Moments:
    """Conditions of n instants, in time order where they are a path.

    q (n, 6) rad commanded; approach (n, 6) sign of each axis' last motion (0: not known, no play); payload (n,): name of what
    hangs then; time_s (n,) s; temperature_C (n,); load (n, 6) N, N m in base axes on load_link (n,) (0..6) at load_place (n, 3) m
    of its link frame. visit (n,): instants of one visit repeat alike (a run of a program); None: each is its own.
    """

    q: Array
    approach: Array
    payload: tuple[str, ...]
    time_s: Array
    temperature_C: Array
    load: Array
    load_link: Index
    load_place: Array
    visit: Index | None = None

    def __len__(self) -> int:
        return len(self.q)


def arm_moments(
    q: ArrayLike,
    payload: str | tuple[str, ...],
    temperature_C: ArrayLike,
    approach: ArrayLike = 0.0,
    time_s: ArrayLike = 0.0,
    load: ArrayLike = 0.0,
    load_link: ArrayLike = 6,
    load_place: ArrayLike = 0.0,
    visit: Index | None = None,
) -> Moments:
    """`Moments` from what is not the default; numbers are spread over all instants."""
    rows = np.asarray(q, float).reshape(-1, 6)
    n = len(rows)

    def spread(value: ArrayLike, *shape: int) -> Array:
        return np.broadcast_to(np.asarray(value, float), (n, *shape)).copy()

    hangs = (payload,) * n if isinstance(payload, str) else payload
    loaded = spread(load, 6), spread(load_link).astype(np.int64), spread(load_place, 3)
    return Moments(rows, spread(approach, 6), hangs, spread(time_s), spread(temperature_C), *loaded, visit)


@dataclass
class VirtualArm:
    """A built arm. Its machines, one for a payload, are compiled when they are first needed."""

    robot: Robot
    truth: Truth
    hardware: Hardware
    reference_C: float
    machines: dict[str, ArmModel] = field(default_factory=dict)
    _last: tuple[Moments, Settled] | None = None

    def settled(self, m: Moments, rng: np.random.Generator | None = None) -> Settled:
        """Equilibria of all instants: frames, spring torques, Jacobians, holding torques (`machine.Settled`).

        With rng the joints come back as well as they do, once for each visit. The last call without it is kept: asking the
        same `Moments` object for flange, links and compliance costs one solution. Raises BadInput: an unknown payload.
        """
        if rng is None and self._last is not None and self._last[0] is m:
            return self._last[1]
        warmth = m.temperature_C - self.reference_C
        motor = motor_side(self.truth, AxisState(m.q, m.approach, warmth, self.robot))
        if rng is not None:
            visit = np.arange(len(m)) if m.visit is None else np.unique(m.visit, return_inverse=True)[1]
            motor = motor + (rng.normal(size=(int(visit.max(initial=-1)) + 1, 6)) * self.truth.repeatability)[visit]
        grown, tilt = growth(self.truth, warmth), base_tilt(self.truth, m.time_s)
        at = machine.Situations(motor, m.approach, grown, m.load, m.load_link, m.load_place, tilt)
        result = self._by_payload(m.payload, at)
        if self.truth.planted("tool_flex"):
            result = replace(result, links=self._flexed(m, result.links))
        if rng is None:
            self._last = (m, result)
        return result

    def _flexed(self, m: Moments, links: Array) -> Array:
        """Links whose flange has moved as the tool does under the payload's weight and what pulls at the flange."""
        mass = {name: hung(self.truth, name)[0] for name in set(m.payload)}
        force = np.array([mass[name] for name in m.payload])[:, None] * (machine.GRAVITY * self.robot.gravity_direction)
        force = force + m.load[:, :3] * (m.load_link == 6)[:, None]
        moved = links.copy()
        moved[:, 6, :3, 3] += np.einsum("nij,nj->ni", tool_give(self.truth, links), force)
        return moved

    def flange(self, m: Moments, rng: np.random.Generator | None = None) -> Array:
        """T_base_flange (n, 4, 4), the true pose in static equilibrium; with rng repeatability is in it."""
        return self.settled(m, rng).links[:, 6]

    def links(self, m: Moments, rng: np.random.Generator | None = None) -> Array:
        """Frames (n, 7, 4, 4) of base and links 1..6 (6: flange) in the base frame that is believed."""
        return self.settled(m, rng).links

    def compliance(self, m: Moments) -> Array:
        """Twist of the flange for a small wrench at its origin, (n, 6, 6): translation m and rotation rad, by force N and moment
        N m, base axes. J C J^T with all true springs at the loads they carry."""
        return self.compliance_at(self.settled(m))

    def compliance_at(self, s: Settled, wrench: Array | None = None) -> Array:
        """`compliance` of equilibria that are at hand, those with repeatability too; under a wrench (n, 6) at the flange's
        origin twist over wrench of that one, whatever its size."""
        more = np.zeros_like(s.load_torque) if wrench is None else np.einsum("nij,ni->nj", s.jacobian, wrench)
        c = self.hardware.contact_compliance + self.hardware.laws.beside(s.load_torque, more)
        found = np.asarray((s.jacobian * c[:, None, :]) @ np.swapaxes(s.jacobian, 1, 2))
        found[:, :3, :3] += tool_give(self.truth, s.links)
        return found

    @property
    def bends_on(self) -> bool:
        """Whether it gives by another measure under more load, as under the contact's."""
        return self.hardware.laws.bends_on

    def _machine(self, payload: str) -> ArmModel:
        if payload not in self.machines:
            if payload and payload not in self.truth.payloads:
                known = ", ".join(self.truth.payloads) or "none"
                raise BadInput(f"payload '{payload}' is not among the cell's [payloads] ({known})")
            self.machines[payload] = machine.build_machine(self.hardware.design, hung(self.truth, payload))
        return self.machines[payload]

    def _by_payload(self, names: tuple[str, ...], at: machine.Situations) -> Settled:
        """All instants of one payload after another, put back into their order."""
        label = np.array(names)
        parts, order = [], []
        for name in dict.fromkeys(names):
            rows = np.flatnonzero(label == name)
            arrays = {key: value[rows] for key, value in vars(at).items() if value is not None}
            parts.append(machine.equilibria(self._machine(name), self.hardware.laws, machine.Situations(**arrays)))
            order.append(rows)
        back = np.argsort(np.concatenate(order), kind="stable")
        names_of = ("links", "bent", "load_torque", "motor_torque", "jacobian")
        joined = {key: np.concatenate([getattr(part, key) for part in parts])[back] for key in names_of}
        return Settled(**joined, steps=sum(part.steps for part in parts))


def make_arm(cell: Cell, truth: Truth) -> VirtualArm:
    """The arm of a cell as `truth` says it is."""
    return VirtualArm(cell.robot, truth, hardware(cell.robot, truth), cell.tables.reference_temperature_C)
