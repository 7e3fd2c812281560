"""The exact signatures of the whole catalogue on a given machine: what an oracle knows, written a second time from DIAGNOSIS.md.

What turns a joint, displaces a frame or deepens the contact follows from the machine's own Jacobian, slopes, torques and
conditions; what is built into the machine (a spring between links, a soft link, weights, growth, the cover's law) is the
difference of two runs of the virtual cell. Columns are per unit coefficient: (n, 3, V, m) m of a tracker's points, (2, n, V, m) N
of a log's two forces, V variants of m coefficients each.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ocp.blindtest.oracle.force import WAVES, ForceSlopes
from ocp.blindtest.oracle.tracker import TrackerScene
from ocp.blindtest.worlds.machines import GrindingMachine, TrackerMachine
from ocp.blindtest.worlds.recipes import is_wave, kind_of, upper_end
from ocp.simulate.twin.arm import gear_ratios
from ocp.simulate.twin.contact.wheel_and_blade import SPLICE_SHARE, belt_travel
from ocp.simulate.twin.planting import BENDING, Planted, Value
from robots.pose import Array, skew
from robots.robot import Robot
from robots.tracker_readings import Index

ORDERS = np.arange(3, 301)
LEVERS = ((0.1, 0.1), (0.1, 0.3), (0.3, 0.1), (0.2, 0.2), (0.15, 0.6), (0.6, 0.15), (0.4, 0.4), (0.25, 0.4), (0.6, 0.6))  # m
RATES = np.linspace(5.0, 15.0, 200)  # 1/s of a belt's splice
ROUNDS = np.arange(1, 13)  # orders of a tracker's azimuth circle
TAKEN_UP = np.geomspace(0.003, 0.1, 6)  # of a joint's rated torque: loads that take up its play
TAUS = np.geomspace(0.05, 30.0, 8)  # s of a cover that relaxes
# Small sizes for differences of the virtual cell, in units of the first key.
STEPS = {
    "wheel_stiffness": 0.01,
    "wheel_law": 0.02,
    "wheel_wear": 1e-8,
    "belt_tension": 0.3,
    "time_delay": 2e-3,
    "path_lag": 5e-5,
    "material_removal": 1e-6,
    "blade_stiffness": 0.02,
    "clamp_compliance": 5e-8,
    "flange_stiffness": 0.01,
    "flange_friction": 0.2,
    "flange_gravity": 0.05,
    "link_thermal": 1e-6,
    "payload_mass": 0.5,
    "tool_flex": 1e-8,
}


@dataclass(frozen=True, eq=False)
class ExactFamily:
    """An effect at a joint (0: none) with its variants: columns (..., V, m) per unit coefficient, upper ends (m,) of the usual
    range, whether physics holds all coefficients positive."""

    effect: str
    joint: int
    columns: Array
    upper: Array
    positive: bool

    @property
    def name(self) -> tuple[str, int]:
        """Effect and joint."""
        return self.effect, self.joint


def _family(effect: str, columns: Array, joint: int = 0, keys: int = 1, repeat: int = 1) -> ExactFamily:
    """Upper ends of the effect's first `keys` keys, each for `repeat` coefficients."""
    chosen = kind_of(effect).keys[:keys]
    upper = [upper_end(key, joint) for key in chosen]
    signed = is_wave(effect) or any(key.signed or key.low < 0 for key in chosen) or len(chosen) > 1
    return ExactFamily(effect, joint, columns, np.repeat(upper, repeat), not signed)


def _seen(found: Iterable[ExactFamily]) -> list[ExactFamily]:
    """Those that the readings show."""
    return [f for f in found if np.abs(f.columns * f.upper).max() > 1e-9]


def _steps(columns: Array, later: Sequence[Array]) -> Array:
    """Columns (k, n, V, m) of what happens from some time on: `later` holds for each time which rows come after it, shaped to
    multiply columns (k, n, m)."""
    return np.stack([columns * on for on in later], axis=2)


def _of_joints(
    robot: Robot,
    turned: Callable[[int, Array], Array],
    q: Array,
    sign: Array,
    tau: Array,
    loaded: Array,
    warmth: Array,
    orders: Sequence[Index],
) -> Iterator[ExactFamily]:
    """What adds to a joint's angle: `turned(j, f)` changes the readings by angles f (n,) rad of joint j (0..5); q, approach sign,
    torque (n, 6) of the weight and of all that loads the joints, warmth (n,), orders of the ripples looked at, by joint."""
    ratio = gear_ratios(robot)

    def at(j: int, *f: Array) -> Array:
        return np.stack([turned(j, g) for g in f], axis=2)[:, :, None]

    for j in range(6):
        x, s, t = q[:, j], sign[:, j], tau[:, j]
        yield _family("joint_compliance", at(j, t), j + 1)
        if j + 1 in BENDING:
            yield _family("joint_stiffening", at(j, -(t**3)), j + 1)
        ripples = {"gear_1x": [1.0], "gear_2x": [2.0], "gear_harmonic": orders[j], "motor_harmonic": ratio[j] * np.array([1, 2])}
        for effect, ks in ripples.items():
            waves = [at(j, np.cos(k * x), np.sin(k * x)) for k in ks]
            yield _family(effect, np.concatenate(waves, axis=2), j + 1, repeat=2)
        yield _family("backlash", at(j, s), j + 1)
        if j + 1 in BENDING:
            taken = [at(j, np.tanh(loaded[:, j] / (share * robot.torque_max[j]))) for share in TAKEN_UP]
            yield _family("load_backlash", np.concatenate(taken, axis=2), j + 1)
        yield _family("friction_windup", at(j, s, np.abs(t) * s), j + 1, keys=2)
        yield _family("encoder_scale", at(j, x), j + 1)
        yield _family("joint_thermal", at(j, warmth), j + 1)
        for effect, among in (("joint_coupling", range(6)), ("wrist_coupling", range(3, 6))):
            others = [at(j, q[:, i]) for i in among if i != j]
            if j in among:
                yield _family(effect, np.concatenate(others, axis=2), j + 1)


def tracker_families(machine: TrackerMachine, scene: TrackerScene) -> list[ExactFamily]:
    """Every effect of the catalogue that a tracker sees, at every joint."""
    m = scene.campaign.moments
    loads, orders = (scene.tau, scene.tau), [ORDERS] * 6
    joints = _of_joints(
        scene.cell.robot, lambda j, f: scene.D[:, :, j] * f[:, None], m.q, m.approach, *loads, scene.warmth, orders
    )
    return _seen([*joints, *_of_torques(machine), *_of_places(scene)])


def _of_torques(machine: TrackerMachine) -> Iterator[ExactFamily]:
    """What is built into the machine: small amounts of it, run and compared."""
    change = partial(_change, machine.points, machine.points(()))
    for joint in (2, 3):
        yield _family("link_bending", change("link_bending", 1e-8, joint), joint)
    springs = [change("gravity_compensator", 1e4, 2, lever_link1_m=a, lever_arm_m=b) for a, b in LEVERS]
    yield _family("gravity_compensator", np.concatenate(springs, axis=2), 2)
    yield _family("payload_mass", change("payload_mass", 0.5))
    shifts = [change("payload_com", 0.01, shift_m=tuple(0.01 * np.eye(3)[i])) for i in range(3)]
    yield _family("payload_com", np.concatenate(shifts, axis=3), repeat=3)
    yield _family("link_thermal", change("link_thermal", 1e-5))
    yield _family("tool_flex", change("tool_flex", 1e-8))


def _of_places(scene: TrackerScene) -> Iterator[ExactFamily]:
    """What happens to the base, the tracker and the nests."""
    n, time = len(scene), scene.campaign.moments.time_s
    motion = np.zeros((n, 6, 3))
    motion[:, 3:] = np.eye(3)
    tilt = scene.moved(0, motion)
    later = [(time >= t)[:, None, None] for t in time[1:]]
    yield _family("base_tilt", _steps(tilt, later), repeat=3)
    hours = time[:, None, None] / 3600.0
    drift = hours * np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), -skew(scene.point)], axis=2)
    yield _family("tracker_drift", drift[:, :, None], keys=2, repeat=3)
    yield _family("tracker_scale", scene.point[:, :, None, None])
    yield _family("air_scale", (scene.point * scene.warmth[:, None])[:, :, None, None])
    level = scene.point[:, [1, 0, 2]] * [-1.0, 1.0, 0.0]
    angle = ROUNDS[:, None, None] * np.arctan2(scene.point[:, 1], scene.point[:, 0])[:, None]
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * level[..., None]
    yield _family("azimuth_harmonic", np.moveaxis(waves, 0, 2), repeat=2)
    turned = scene.turn @ scene.links[np.arange(n), scene.carrier, :3, :3]
    label = np.array(scene.campaign.targets)
    moved = []
    for name in dict.fromkeys(scene.campaign.targets):
        own = label == name
        moved += [own[:, None, None] & on for k, on in enumerate(later) if own[k + 1] and own[: k + 1].any()]
    if moved:
        yield _family("target_shift", _steps(turned, moved), repeat=3)


def force_families(machine: GrindingMachine, s: ForceSlopes, orders_too: bool) -> list[ExactFamily]:
    """Every effect of the catalogue that a force log sees; orders_too: all orders of ripples, else those that the short ranges of
    the axes tell apart."""
    orders = [ORDERS if orders_too else ORDERS[:: max(1, int(1.0 / max(np.ptp(x), 1e-3)))] for x in machine.bare.q.T]
    warmth = machine.hall(machine.rows) - machine.bench.cell.tables.reference_temperature_C
    robot, q = machine.bench.cell.robot, machine.bare.q
    joints = _of_joints(robot, lambda j, f: s.joint[..., j] * f, q, s.approach, s.torque, s.loaded, warmth, orders)
    # Of what bends under the contact too differences tell; joint_stiffening is planted only where a tracker measures too.
    turned = (f for f in joints if f.effect not in ("joint_stiffening", "joint_compliance"))
    rest = [*_of_wheel(machine, s), *_of_frames(machine, s), *_of_sensor(machine), *_differences(machine), *_late(machine, s)]
    return _seen([*rest, *turned])


Read = Callable[[Sequence[Planted]], Array]


def _change(read: Read, bare: Array, effect: str, size: float, joint: int | None = None, **values: Value) -> Array:
    """Change of what is read from `bare`, (2, n, 1, 1) or (n, 3, 1, 1), per unit of the effect's first key."""
    planted = Planted(effect, joint, {kind_of(effect).keys[0].name: size, **values})
    return np.asarray((read([planted]) - bare) / size)[:, :, None, None]


def _differences(machine: GrindingMachine) -> Iterator[ExactFamily]:
    change = partial(_change, machine.forces, machine.bare.both)
    for effect, size in STEPS.items():
        yield _family(effect, change(effect, size))
    for effect, joints, size in (("link_bending", (2, 3), 1e-8), ("joint_compliance", range(1, 7), 1e-7)):
        yield from (_family(effect, change(effect, size, joint), joint) for joint in joints)
    relaxed = [change("wheel_relaxation", 0.02, tau=float(tau)) for tau in TAUS]
    yield _family("wheel_relaxation", np.concatenate(relaxed, axis=2))
    soft = change("wheel_temperature", -5e-4, radius_per_K=0.0)
    grown = machine.forces([Planted("wheel_temperature", None, {"per_K": 0.0, "radius_per_K": 1e-6})]) - machine.bare.both
    yield _family("wheel_temperature", np.concatenate([soft, grown[:, :, None, None] / 1e-6], axis=3), keys=2)
    rubbed = change("tangential_force", 0.02, leak=0.0)
    leaked = np.stack([machine.bare.result.tangential, np.zeros(len(machine.rows.s))])[:, :, None, None]
    yield _family("tangential_force", np.concatenate([rubbed, leaked], axis=3), keys=2)


def _of_wheel(machine: GrindingMachine, s: ForceSlopes) -> Iterator[ExactFamily]:
    """What turns with the belt, and stock along the lines."""
    deeper = -s.flange[..., :3] @ machine.bench.cell.wheel.contact_direction
    angle = belt_travel(machine.bare.moments) / machine.bench.cell.wheel.radius
    s_line, line, length = machine.rows.s, machine.rows.each("line"), max(x.length for x in machine.bench.lines)
    stock = [deeper * np.cos(k * np.pi * s_line / length) * (line == own) for own in np.unique(line) for k in range(1, WAVES + 1)]
    yield _family("stock_profile", np.stack(stock, axis=2)[:, :, None], repeat=len(stock))
    waves = np.stack([deeper * np.cos(angle), deeper * np.sin(angle)], axis=2)
    yield _family("wheel_runout", waves[:, :, None], repeat=2)
    pushed = _change(machine.forces, machine.bare.both, "belt_splice", 0.5, hz=1e-9)[:, :, 0, 0]
    turn = np.mod(RATES * machine.rows.time[:, None] + 0.5, 1.0) - 0.5
    bump = np.where(np.abs(turn) < 0.5 * SPLICE_SHARE, 0.5 + 0.5 * np.cos(2 * np.pi * turn / SPLICE_SHARE), 0.0)
    yield _family("belt_splice", (pushed[:, :, None] * bump)[..., None])


def _of_frames(machine: GrindingMachine, s: ForceSlopes) -> Iterator[ExactFamily]:
    """What is displaced from some time on; frames change between runs, the clamp slips at any time, away from the wheel: as a
    whole, or back on either side of the blade."""
    rows, moments = machine.rows, machine.bare.moments
    clock, starts = rows.clock, np.array([r.clock for r in rows.runs])
    middle = starts + 0.5 * np.array([rows.time[rows.run == k][-1] for k in range(len(starts))])
    held = machine.bench.cell.workpiece.T_flange_blade[:3, :3]
    R = s.frames[:, 6, :3, :3]
    moved = np.einsum("snk,nki->sni", s.flange[..., :3], R)
    later = [(clock >= t)[:, None] for t in starts[1:]]
    yield _family("tool_frame_shift", _steps(moved, later), repeat=3)
    yield _family("wheel_frame_shift", _steps(-s.flange[..., :3], later), repeat=3)
    back = -(np.where(moments.contact[:, None], moments.n, 0.0) @ held.T)
    slips, alike = [], np.einsum("sni,ni->sn", moved, back)
    for t in np.sort(np.concatenate([starts[1:], middle])):
        before = np.flatnonzero(moments.contact & (clock <= t))
        if len(before):
            slips += [(moved @ back[before[-1]]) * (clock >= t), alike * (clock >= t)]
    yield _family("clamp_slip", np.stack(slips, axis=2)[..., None])
    n = len(clock)
    twist = np.zeros((n, 6, 3))
    twist[:, 3:] = np.eye(3)
    twist[:, :3] = np.cross(np.eye(3)[None], s.frames[:, 6, None, :3, 3]).transpose(0, 2, 1)
    yield _family("base_tilt", _steps(s.of_twists(twist), later), repeat=3)


def _late(machine: GrindingMachine, s: ForceSlopes) -> Iterator[ExactFamily]:
    """Readings that belong to axes as they were before, of one joint or of all."""
    rows, q = machine.rows, machine.bare.q
    speed = np.zeros(q.shape)
    for k in range(len(rows.runs)):
        own = rows.run == k
        speed[own] = np.gradient(q[own], rows.time[own], axis=0)
    each = -s.joint * speed
    for joint, late in ((0, each.sum(axis=2)), *((j + 1, each[..., j]) for j in range(6))):
        yield _family("channel_delay", late[:, :, None, None], joint)


def _of_sensor(machine: GrindingMachine) -> Iterator[ExactFamily]:
    """What the reading adds."""
    none = np.zeros(len(machine.rows.s))
    pressed, hours = machine.bare.result, machine.rows.clock / 3600.0
    shown = {"bias": none + 1.0, "drift": hours, "gain": pressed.force, "crosstalk": pressed.tangential}
    for effect, values in shown.items():
        yield _family(f"sensor_{effect}", np.stack([values, none])[:, :, None, None])
