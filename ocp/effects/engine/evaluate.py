"""Effects in numbers: rows of arm, readings and contact samples, what hooks see of a row, and what every variant does there.

    displaced nest = d_joints (joint + c torque) + sum of twists at the links up to the nest's,                     (1)

d_joints the derivative of the nest in the commanded joints, which already bends the arm at the displaced posture
(`robots.calibration.reading_model`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ocp.effects.context import SETTLING, ArmContext, ContactContext, TrackerContext
from ocp.effects.effect import Active, Effect, Scanned
from ocp.effects.engine.compiled import Hook, RowLayout, evaluated, evaluated_sparsely
from robots.calibration.reading_model import RowInputs
from robots.compliance import deflected_joints
from robots.gravity import GRAVITY, gravity_torques
from robots.kinematics import chain, evaluate_rows
from robots.pose import Array
from robots.robot import Robot

# Blocks of a row, matrices row by row; see ArmContext.
ARM_LAYOUT = RowLayout.of(
    "q 6, q_real 6, tau 6, c 6, approach 6, speed 6, warm 1, time 1, payload 4, hung 1, settling 3, frames 84"
)
# Blocks of a row, matrices row by row; see ContactContext.
CONTACT_LAYOUT = RowLayout.of(
    "F 1, parts 4, slopes 4, curvature 3, lateral 1, tilt 2, arc 1, turn 1, p 3, n 3, t 3, e 3, belt_direction 3, n_base 3, "
    "axis 3, R_flange 9, R_blade 9, s 1, setpoint 1, feed 1, belt 1, time 1, clock 1, ground_before 1, warm 1, wheel_warm 1, "
    "travel 1, normal_stiffness 1, friction_deflection 1, lever 1, push_axis 3, clamp_deflection 1, line 1, "
    "joint_lever 6, joint_push 6, tau 6, q 6"
)
_GIVES = [k for name in ("parts", "slopes") for k in range(CONTACT_LAYOUT.size)[CONTACT_LAYOUT.places[name]]]
SMALL = 1e-4  # share of a parameter over which what effects add is differenced


@dataclass(frozen=True)
class ArmPlace:
    """What is the same in all rows: a robot's sign (6), gear_ratio (6), link_mass (7), link_com (7, 3) and gravity_direction (3)
    as bytes, one after the other, and the names of payloads."""

    constants: bytes
    payloads: tuple[str, ...]

    @staticmethod
    def of(robot: Robot, payloads: tuple[str, ...]) -> "ArmPlace":
        """Of a robot."""
        constants = (robot.sign, robot.gear_ratio, robot.link_mass, np.ravel(robot.link_com), robot.gravity_direction)
        return ArmPlace(np.concatenate(constants).astype(float).tobytes(), payloads)

    def context(self, row: ca.SX) -> ArmContext:
        """What hooks see of a symbolic row."""
        x = ARM_LAYOUT.split(row)
        numbers = x.pop("frames")
        frames = [_frame(numbers[12 * i : 12 * i + 12]) for i in range(7)]
        sign, ratio, mass, com, down = _constants(self.constants)
        return arm_context(frames, sign, mass, com, ratio, down, self.payloads, **x)


def _constants(packed: bytes) -> tuple[Array, Array, Array, Array, Array]:
    """sign, gear_ratio, link_mass, link_com and gravity_direction of an `ArmPlace`."""
    sign, ratio, mass, com, down = np.split(np.frombuffer(packed), (6, 12, 19, 40))
    return sign, ratio, mass, com.reshape(7, 3), down


def arm_context(
    frames: list[ca.SX],
    sign: Array,
    link_mass: Array,
    link_com: Array,
    gear_ratio: Array,
    down: Array,
    payloads: tuple[str, ...],
    **x: Any,
) -> ArmContext:
    """The context of an instant with link frames (4, 4) and the symbols of `ARM_LAYOUT` by name."""

    def weight_torque(mass: Any, com: Any) -> ca.SX:
        p = frames[6][:3, 3] + frames[6][:3, :3] @ com
        torques = []
        for j in range(6):
            z, lever = frames[j][:3, 2], p - frames[j][:3, 3]
            torques.append(sign[j] * mass * GRAVITY * ca.dot(z, ca.cross(lever, ca.SX(down))))
        return ca.vertcat(*torques)

    x |= {"frames": frames, "sign": sign, "link_mass": link_mass, "link_com": link_com, "gear_ratio": gear_ratio}
    return ArmContext(payloads=payloads, down=down, weight_torque=weight_torque, **x)


def _frame(numbers: ca.SX) -> ca.SX:
    """(4, 4) of twelve numbers, rows of [R p]."""
    return ca.vertcat(ca.reshape(numbers, 4, 3).T, ca.DM([[0, 0, 0, 1]]))


@dataclass(frozen=True)
class ArmRows:
    """n instants: place, and state (n, k) in the order of `ARM_LAYOUT`; columns that are unknown are nan."""

    place: ArmPlace
    state: Array

    def __len__(self) -> int:
        return len(self.state)

    def block(self, name: str) -> Array:
        """Columns of `ARM_LAYOUT` by name."""
        return ARM_LAYOUT.block(self.state, name)

    @property
    def origins(self) -> Array:
        """Origins (n, 7, 3) m of the link frames in the base frame."""
        return self.block("frames").reshape(-1, 7, 3, 4)[..., 3]


def arm_rows(
    robot: Robot,
    arm: Array,
    inputs: RowInputs,
    payloads: tuple[str, ...] = (),
    hung: Array | None = None,
    approach: Array | None = None,
    warm: Array | None = None,
    time: Array | None = None,
    speed: Array | None = None,
    waited: Array | None = None,
) -> ArmRows:
    """Rows of readings `inputs` of `robot` with parameters arm (36,) (`reading_model.ARM_NAMES`).

    hung (n,): index of each row's payload in `payloads`; approach (n, 6); warm (n,) K above the cell's reference; time (n,) s
    on the campaign's clock; speed (n, 6) rad/s; waited (n,) s: how long ago the motion to each row began (None: long).
    What else is None is unknown: effects that need it come out as nan (as zero where only an instant is asked of it).
    """
    n = len(inputs.q)
    place = ArmPlace.of(robot, payloads)
    whole = np.broadcast_to(arm, (n, 36))
    given = inputs.q, whole, inputs.payload, inputs.load, inputs.load_place
    state = evaluate_rows(_state(inputs.load_link, place.constants), *given)
    blocks: dict[str, Any] = {"q": inputs.q, "q_real": state[:, :6], "tau": state[:, 6:12], "frames": state[:, 12:]}
    blocks |= {"approach": approach, "speed": speed, "warm": warm, "time": time, "payload": inputs.payload, "c": arm[30:]}
    blocks |= {"hung": 0.0 if hung is None else hung, "settling": np.zeros(3) if waited is None else left_of_motion(waited)}
    return ArmRows(place, ARM_LAYOUT.stack(n, blocks))


def left_of_motion(waited: Array) -> Array:
    """What is left (n, 3) of motions that began `waited` (n,) s ago, settling as fast as each of `SETTLING`."""
    return np.asarray(np.exp(-waited[:, None] / np.array(SETTLING)))


@lru_cache(maxsize=32)
def _state(load_link: int, constants: bytes) -> ca.Function:
    """(q, arm, payload, load, place) -> q_real (6), tau (6), frames (7 x 12)."""
    q, arm, payload = ca.SX.sym("q", 6), ca.SX.sym("arm", 36), ca.SX.sym("payload", 4)
    load, place = ca.SX.sym("load", 6), ca.SX.sym("place", 3)
    sign, _, mass, com, down = _constants(constants)
    mdh = ca.reshape(arm[:30], 5, 6).T

    def torque(joints: ca.SX) -> ca.SX:
        weight = gravity_torques(joints, mdh, sign, mass, com, payload[0], payload[1:], down)
        frames = chain(joints, mdh, sign)
        at = frames[load_link][:3, 3] + frames[load_link][:3, :3] @ place
        pull = [
            sign[j] * ca.dot(frames[j][:3, 2], ca.cross(at - frames[j][:3, 3], load[:3]) + load[3:]) if j < load_link else 0
            for j in range(6)
        ]
        return weight + ca.vertcat(*pull)

    real = deflected_joints(q, torque, arm[30:])
    frames = ca.vertcat(*(ca.vec(frame[:3, :].T) for frame in chain(real, mdh, sign)))
    out = ca.vertcat(real, torque(real), frames)
    return ca.Function("arm_state", [q, arm, payload, load, place], [ca.cse(ca.densify(out))])


@dataclass(frozen=True)
class ContactPlace:
    """What is the same in all rows: the wheel's radius m, the cell's friction, gravity's unit direction in the base frame."""

    radius: float
    friction: float
    down: tuple[float, ...]

    def context(self, row: ca.SX) -> ContactContext:
        """What hooks see of a symbolic row."""
        x = CONTACT_LAYOUT.split(row)
        for name in ("R_flange", "R_blade"):
            x[name] = ca.reshape(x[name], 3, 3).T
        return ContactContext(radius=self.radius, friction=self.friction, down=np.array(self.down), **x)


def contact_columns(effect: Effect, kind: str, joint: int, scans: Sequence[Scanned], place: ContactPlace, rows: Array) -> Array:
    """The hook `kind` (overlap, push, sensor, shear) at rows (n, k) of CONTACT_LAYOUT per unit coefficient: (v, n, m)."""
    if getattr(effect, kind) is None or not scans:
        return np.zeros((len(scans), len(rows), effect.size))
    return evaluated(Hook(effect, kind, joint, CONTACT_LAYOUT, place), rows, scans)[-1][:, :, 0]


def overlap_columns(effect: Effect, joint: int, scans: Sequence[Scanned], place: ContactPlace, rows: Array, rigid: bool) -> Array:
    """Overlap (v, n, m) m per unit coefficient at rows (n, k) of CONTACT_LAYOUT: a push counts as the stroke of the flange that
    it takes, in a rigid cell as the overlap that brings as much force."""
    out = contact_columns(effect, "overlap", joint, scans, place, rows)
    if effect.push is not None:
        slopes = CONTACT_LAYOUT.block(rows, "slopes")
        give = slopes.sum(axis=1) if rigid else slopes[:, 0]
        out = out + give[:, None] * contact_columns(effect, "push", joint, scans, place, rows)
    return out


def added_overlap(active: Sequence[Active], place: ContactPlace, rows: Array, rigid: bool) -> Array:
    """Overlap (n,) m that active effects add at rows (n, k) of CONTACT_LAYOUT."""
    total = np.zeros(len(rows))
    for one in active:
        total += overlap_columns(one.effect, one.joint, (one.scanned,), place, rows, rigid)[0] @ one.a
    return total


def added_by_giving(active: Sequence[Active], place: ContactPlace, rows: Array, rigid: bool, moves: Array, given: Array) -> Array:
    """Derivatives (n, k) of what active effects add in `given` parameters (n, k) that parts and slopes go with; moves (n, 8 k):
    these two blocks' derivatives in each. What effects add is smooth in both: a small difference is the derivative."""
    out, here = np.zeros_like(given), added_overlap(active, place, rows, rigid)
    for k, move in enumerate(np.split(moves, given.shape[1], axis=1)):
        moved, step = rows.copy(), SMALL * np.maximum(np.abs(given[:, k]), 1.0)
        moved[:, _GIVES] += step[:, None] * move
        out[:, k] = (added_overlap(active, place, moved, rigid) - here) / step
    return out


TRACKER_LAYOUT = RowLayout.of("point 3, R 9, time 1, warm 1, target 1")


@dataclass(frozen=True)
class ArmColumns:
    """Per unit coefficient, v variants, n rows, m coefficients: shift (v, n, k, m) rad of the commanded joints `moving` (k,)
    (0..5), twists {link: (v, n, 6, m)} m and rad in base axes at the origin of the link's frame."""

    moving: NDArray[np.int64]
    shift: Array
    twists: dict[int, Array]

    @property
    def joints(self) -> Array:
        """Of all six joints (v, n, 6, m) rad."""
        v, n, _, m = self.shift.shape
        out = np.zeros((v, n, 6, m))
        out[:, :, self.moving] = self.shift
        return out

    def at(self, rows: ArmRows, point: Array, d_joints: Array, link: int = 6) -> Array:
        """Displacement (v, n, 3, m) m, base axes, of points (n, 3) m (base frame) of `link`; d_joints (n, 3, 6) m/rad in the
        commanded joints, base axes (eq. 1)."""
        v, n, _, m = self.shift.shape
        out = np.zeros((v, n, 3, m))
        for k, j in enumerate(self.moving):
            out += d_joints[None, :, :, j, None] * self.shift[:, :, None, k]
        for i, twist in self.twists.items():
            if i <= link:
                lever = point - rows.origins[:, i]
                out += twist[:, :, :3] + np.cross(twist[:, :, 3:], lever[None, :, :, None], axis=2)
        return out


def arm_columns(effect: Effect, joint: int, scans: Sequence[Scanned], rows: ArmRows) -> ArmColumns:
    """What an effect at `joint` (0: none) does to the arm, for every variant."""
    moving, shift = np.empty(0, np.int64), np.zeros((len(scans), len(rows), 0, effect.size))
    twists: dict[int, Array] = {}
    if not scans:
        return ArmColumns(moving, shift, twists)
    if effect.joint is not None:
        moving, shift = evaluated_sparsely(Hook(effect, "joint", joint, ARM_LAYOUT, rows.place), rows.state, scans)
    if effect.torque is not None:
        under, torque = evaluated_sparsely(Hook(effect, "torque", joint, ARM_LAYOUT, rows.place), rows.state, scans)
        both = np.union1d(moving, under)
        whole = np.zeros((*shift.shape[:2], len(both), effect.size))
        whole[:, :, np.searchsorted(both, moving)] = shift
        whole[:, :, np.searchsorted(both, under)] += rows.block("c")[:, under, None] * torque
        moving, shift = both, whole
    if effect.twist is not None:
        twists = evaluated(Hook(effect, "twist", joint, ARM_LAYOUT, rows.place), rows.state, scans)
    return ArmColumns(moving, shift, twists)


WEIGHT_OFF = 0.05  # of the rms load torque: about what a catalogue's weights are off by


def loaded(active: Sequence[Active], rows: ArmRows) -> ArmRows:
    """The rows with the load torques that active effects add."""
    added = _summed(active, "torque", rows, rows.state)
    return rows if added is None else _with(rows, tau=rows.block("tau") + added)


def softened(active: Sequence[Active], rows: ArmRows) -> ArmRows:
    """The rows with springs that give as much more as active effects turn the joints with their load torques: a secant over
    `WEIGHT_OFF`, as play turns over at once."""
    tau = rows.block("tau")
    step = WEIGHT_OFF * np.sqrt(np.mean(tau**2, axis=0)) + 1.0  # N m
    ends = [_summed(active, "joint", rows, _with(rows, tau=tau + side * step).state) for side in (1.0, -1.0)]
    return rows if ends[0] is None or ends[1] is None else _with(rows, c=rows.block("c") + (ends[0] - ends[1]) / (2.0 * step))


def _summed(active: Sequence[Active], kind: str, rows: ArmRows, state: Array) -> Array | None:
    """What hooks of a kind, joint or torque, do at their values at `state` (n, 6); None where no effect has one."""
    found = None
    for one in active:
        if getattr(one.effect, kind) is not None:
            where, value = evaluated_sparsely(Hook(one.effect, kind, one.joint, ARM_LAYOUT, rows.place), state, (one.scanned,))
            found = np.zeros((len(state), 6)) if found is None else found
            found[:, where] += value[0] @ one.a
    return found


def _with(rows: ArmRows, **blocks: Array) -> ArmRows:
    """The rows with other columns of `ARM_LAYOUT`."""
    state = rows.state.copy()
    for name, values in blocks.items():
        state[:, ARM_LAYOUT.places[name]] = values
    return ArmRows(rows.place, state)


def arm_shift(active: Sequence[Active], rows: ArmRows) -> ArmColumns:
    """The joint shifts and twists of effects with values, summed: one variant, one coefficient of one. What turns with the load
    turns with the torques that other effects add.

    For a nonlinear prediction predict at q + joints[0, :, :, 0] and add `at` with d_joints of zeros for the twists.
    """
    joints = np.zeros((1, len(rows), 6, 1))
    twists: dict[int, Array] = {}
    rows = loaded(active, rows)
    for item in active:
        if not item.effect.on_arm:
            continue
        columns = arm_columns(item.effect, item.joint, (item.scanned,), rows)
        joints[..., 0] += columns.joints @ item.a
        for link, twist in columns.twists.items():
            twists[link] = twists.get(link, np.zeros(1)) + (twist @ item.a)[..., None]
    return ArmColumns(np.arange(6), joints, twists)


@dataclass(frozen=True)
class TrackerPlace:
    """Names of the reflector nests."""

    targets: tuple[str, ...]

    def context(self, row: ca.SX) -> TrackerContext:
        """What hooks see of a symbolic row."""
        x = TRACKER_LAYOUT.split(row)
        return TrackerContext(x["point"], ca.reshape(x["R"], 3, 3).T, x["time"], x["warm"], x["target"], self.targets)


@dataclass(frozen=True)
class TrackerRows:
    """n readings: point (n, 3) m predicted in the tracker's frame, R (n, 3, 3) of the nest's link in that frame, time (n,) s,
    warm (n,) K, target (n,) index in `targets`."""

    point: Array
    R: Array
    target: Array
    targets: tuple[str, ...]
    time: Array | None = None
    warm: Array | None = None


def tracker_columns(effect: Effect, joint: int, scans: Sequence[Scanned], rows: TrackerRows) -> Array:
    """What an effect adds to readings, per unit coefficient: (v, n, 3, m) m in the tracker's frame."""
    n = len(rows.point)
    if effect.reading is None or not scans:
        return np.zeros((len(scans), n, 3, effect.size))
    blocks = {"point": rows.point, "R": rows.R.reshape(n, 9), "time": rows.time, "warm": rows.warm, "target": rows.target}
    hook = Hook(effect, "reading", joint, TRACKER_LAYOUT, TrackerPlace(rows.targets))
    return evaluated(hook, TRACKER_LAYOUT.stack(n, blocks), scans)[-1]
