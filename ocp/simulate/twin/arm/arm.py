"""The virtual arm: where its links and its flange really are, how much it gives, what its motors hold."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ocp.model.cell import Cell
from ocp.simulate.twin.arm.errors import AxisState, Hardware, base_tilt, growth, hardware, hung, motor_side
from ocp.simulate.twin.arm.machine import ArmModel, Index, build_machine
from ocp.simulate.twin.arm.statics import Settled, Situations, equilibria
from ocp.simulate.twin.truth.truth import Truth
from robots.errors import BadInput
from robots.pose import Array
from robots.robot import Robot


@dataclass(frozen=True, eq=False)
class Moments:
    """Conditions of n instants, in time order where they are a path.

    q (n, 6) rad commanded; approach (n, 6) sign of each axis' last motion (0: not known, no play); payload: one name, or one
    for each instant; time_s (n,) s; temperature_C (n,); load (n, 6) N, N m in base axes on load_link (n,) (0..6) at load_place
    (n, 3) m of its link frame. visit (n,): instants of one visit repeat alike (a run of a program); None: each is its own.
    """

    q: Array
    approach: Array
    payload: str | tuple[str, ...]
    time_s: Array
    temperature_C: Array
    load: Array
    load_link: Index
    load_place: Array
    visit: Index | None = None

    def __len__(self) -> int:
        return len(self.q)

    def take(self, rows: Index) -> "Moments":
        """The instants `rows`."""
        names = ("q", "approach", "time_s", "temperature_C", "load", "load_link", "load_place")
        arrays = {name: getattr(self, name)[rows] for name in names}
        payload = self.payload if isinstance(self.payload, str) else tuple(self.payload[i] for i in rows)
        return replace(self, payload=payload, visit=None if self.visit is None else self.visit[rows], **arrays)


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

    link = np.broadcast_to(np.asarray(load_link, np.int64), (n,)).copy()
    return Moments(
        rows,
        spread(approach, 6),
        payload,
        spread(time_s),
        spread(temperature_C),
        spread(load, 6),
        link,
        spread(load_place, 3),
        visit,
    )


@dataclass
class VirtualArm:
    """A built arm. Its machines, one for a payload, are compiled when they are first needed."""

    robot: Robot
    truth: Truth
    hardware: Hardware
    reference_C: float
    machines: dict[str, ArmModel] = field(default_factory=dict)
    _last: tuple[Moments, Settled] | None = None

    def settled(
        self, m: Moments, rng: np.random.Generator | None = None, qd: Array | None = None, qdd: Array | None = None
    ) -> Settled:
        """Equilibria of all instants: frames, spring torques, Jacobians, holding torques (`statics.Settled`).

        With rng the joints come back as well as they do, once for each visit. The last call without it is kept: asking the
        same `Moments` object for flange, links and compliance costs one solution. Raises BadInput: an unknown payload.
        """
        plain = rng is None and qd is None
        if plain and self._last is not None and self._last[0] is m:
            return self._last[1]
        warmth = m.temperature_C - self.reference_C
        motor = motor_side(self.truth, AxisState(m.q, m.approach, warmth, self.robot))
        if rng is not None:
            visit = np.arange(len(m)) if m.visit is None else np.unique(m.visit, return_inverse=True)[1]
            motor = motor + (rng.normal(size=(int(visit.max(initial=-1)) + 1, 6)) * self.truth.repeatability)[visit]
        grown, tilt, load = growth(self.truth, warmth), base_tilt(self.truth, m.time_s), m.load if m.load.any() else None
        at = Situations(motor, m.approach, grown, tilt, load, m.load_link, m.load_place, qd, qdd)
        if isinstance(m.payload, str):
            result = equilibria(self._machine(m.payload), self.hardware.laws, at)
        else:
            result = self._by_payload(m.payload, at)
        if plain:
            self._last = (m, result)
        return result

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

    def compliance_at(self, s: Settled) -> Array:
        """`compliance` of equilibria that are at hand, those with repeatability too."""
        c = self.hardware.contact_compliance - 3 * self.hardware.laws.cubic * s.load_torque**2
        return np.asarray((s.jacobian * c[:, None, :]) @ np.swapaxes(s.jacobian, 1, 2))

    def torques(self, m: Moments, qd: Array | None = None, qdd: Array | None = None) -> Array:
        """Motor torques (n, 6) N m on the link side, positive along +q: holding, and with qd, qdd (n, 6) rad/s, rad/s^2 those of
        the motion too; friction is not in them."""
        return self.settled(m, None, qd, qdd).motor_torque

    def _machine(self, payload: str) -> ArmModel:
        if payload not in self.machines:
            if payload and payload not in self.truth.payloads:
                known = ", ".join(self.truth.payloads) or "none"
                raise BadInput(f"payload '{payload}' is not among the cell's [payloads] ({known})")
            self.machines[payload] = build_machine(self.hardware.design, hung(self.truth, payload))
        return self.machines[payload]

    def _by_payload(self, names: tuple[str, ...], at: Situations) -> Settled:
        """All instants of one payload after another, put back into their order."""
        label = np.array(names)
        parts, order = [], []
        for name in dict.fromkeys(names):
            rows = np.flatnonzero(label == name)
            arrays = {key: value[rows] for key, value in vars(at).items() if value is not None}
            parts.append(equilibria(self._machine(name), self.hardware.laws, Situations(**arrays)))
            order.append(rows)
        back = np.argsort(np.concatenate(order), kind="stable")
        names_of = ("links", "bent", "load_torque", "motor_torque", "jacobian")
        joined = {key: np.concatenate([getattr(part, key) for part in parts])[back] for key in names_of}
        return Settled(**joined, steps=sum(part.steps for part in parts))


def make_arm(cell: Cell, truth: Truth) -> VirtualArm:
    """The arm of a cell as `truth` says it is."""
    return VirtualArm(cell.robot, truth, hardware(cell.robot, truth), cell.tables.reference_temperature_C)
