"""The exact signatures of the catalogue on a grinding machine: what an oracle knows, from DIAGNOSIS.md and the virtual cell.

What deepens the contact, displaces wheel or blade or turns a joint follows from the machine's own slopes; the rest is the
difference of two runs of the virtual cell. Columns are per unit coefficient.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.blindtest.oracle.force_detectability import WAVES
from ocp.blindtest.oracle.signatures import ORDERS
from ocp.blindtest.oracle.slopes import Slopes
from ocp.blindtest.worlds.force_drawing import kind_of
from ocp.blindtest.worlds.force_machines import GrindingMachine
from ocp.simulate.twin.arm.joint_errors import gear_ratios
from ocp.simulate.twin.contact.wheel import SPLICE_SHARE, belt_travel
from ocp.simulate.twin.truth.planting import Planted, Value
from robots.pose import Array

RATES = np.linspace(5.0, 15.0, 200)  # 1/s of a belt's splice
TAUS = np.geomspace(0.05, 30.0, 8)  # s of a cover that relaxes
# Small sizes for differences of the virtual cell, in units of the first key.
STEPS = {
    "wheel_stiffness": 0.01, "wheel_law": 0.02, "wheel_wear": 1e-8, "belt_tension": 0.3, "time_delay": 2e-3, "path_lag": 5e-5,
    "material_removal": 1e-6, "blade_stiffness": 0.02, "clamp_compliance": 5e-8, "flange_stiffness": 0.01,
    "flange_friction": 0.2, "flange_gravity": 0.05, "link_thermal": 1e-6, "payload_mass": 0.5,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class ForceFamily:
    """An effect at a joint (0: none) with its variants: columns (2, n, V, m) N per unit coefficient, upper ends (m,) of the usual
    range, whether physics holds all coefficients positive; times (V,) s where its variants are steps in time."""

    effect: str
    joint: int
    columns: Array
    upper: Array
    positive: bool
    times: Array | None = None

    @property
    def name(self) -> tuple[str, int]:
        """Effect and joint."""
        return self.effect, self.joint


def force_families(machine: GrindingMachine, s: Slopes, orders_too: bool) -> list[ForceFamily]:
    """Every effect of the catalogue that a force log sees; orders_too: all orders of ripples, else those that the short ranges of
    the axes tell apart."""
    found = [*_of_wheel(machine, s), *_of_frames(machine, s), *_of_sensor(machine), *_differences(machine)]
    found += _of_joints(machine, s, orders_too)
    return [f for f in found if np.abs(f.columns * f.upper).max() > 1e-9]


def _family(
    effect: str, columns: Array, joint: int = 0, keys: int = 1, repeat: int = 1, times: Array | None = None
) -> ForceFamily:
    kind = kind_of(effect)
    chosen = kind.keys[:keys]
    upper = [max(abs(k.low), abs(k.high)) * (k.scale[joint - 1] if k.scale and joint else 1.0) for k in chosen]
    waves = any(k.name == "phase_rad" for k in kind.keys)
    signed = waves or any(k.signed or k.low < 0 for k in chosen) or (len(chosen) > 1)
    return ForceFamily(effect, joint, columns, np.repeat(upper, repeat), not signed, times)


def _change(machine: GrindingMachine, effect: str, size: float, joint: int | None = None, **values: Value) -> Array:
    """Readings (2, n, 1, 1) per unit of the effect's first key."""
    key = kind_of(effect).keys[0].name
    log = machine.log([Planted(effect, joint, {key: size, **values})])
    return np.asarray((log.both - machine.bare.both) / size)[:, :, None, None]


def _differences(machine: GrindingMachine) -> Iterator[ForceFamily]:
    for effect, size in STEPS.items():
        yield _family(effect, _change(machine, effect, size))
    for joint in (2, 3):
        yield _family("link_bending", _change(machine, "link_bending", 1e-8, joint), joint)
    relaxed = [_change(machine, "wheel_relaxation", 0.02, tau=float(tau)) for tau in TAUS]
    yield _family("wheel_relaxation", np.concatenate(relaxed, axis=2))
    soft = _change(machine, "wheel_temperature", -5e-4, radius_per_K=0.0)
    grown = machine.log([Planted("wheel_temperature", None, {"per_K": 0.0, "radius_per_K": 1e-6})]).both - machine.bare.both
    yield _family("wheel_temperature", np.concatenate([soft, grown[:, :, None, None] / 1e-6], axis=3), keys=2)
    rubbed = _change(machine, "tangential_force", 0.02, leak=0.0)
    leaked = np.stack([machine.bare.result.tangential, np.zeros(len(machine.rows.s))])[:, :, None, None]
    yield _family("tangential_force", np.concatenate([rubbed, leaked], axis=3), keys=2)


def _of_wheel(machine: GrindingMachine, s: Slopes) -> Iterator[ForceFamily]:
    """What turns with the belt, and stock along the lines."""
    deeper = -s.flange[..., :3] @ machine.bench.cell.wheel.contact_direction
    angle = belt_travel(machine.bare.moments) / machine.bench.cell.wheel.radius
    s_line, line, length = machine.rows.s, machine.rows.each("line"), max(x.length for x in machine.bench.course.lines)
    stock = [deeper * np.cos(k * np.pi * s_line / length) * (line == own) for own in np.unique(line) for k in range(1, WAVES + 1)]
    yield _family("stock_profile", np.stack(stock, axis=2)[:, :, None], repeat=len(stock))
    waves = np.stack([deeper * np.cos(angle), deeper * np.sin(angle)], axis=2)
    yield _family("wheel_runout", waves[:, :, None], repeat=2)
    pushed = _change(machine, "belt_splice", 0.5, hz=1e-9)[:, :, 0, 0]
    turn = np.mod(RATES * machine.rows.time[:, None] + 0.5, 1.0) - 0.5
    bump = np.where(np.abs(turn) < 0.5 * SPLICE_SHARE, 0.5 + 0.5 * np.cos(2 * np.pi * turn / SPLICE_SHARE), 0.0)
    yield _family("belt_splice", (pushed[:, :, None] * bump)[..., None])


def _of_frames(machine: GrindingMachine, s: Slopes) -> Iterator[ForceFamily]:
    """What is displaced from some time on; frames change between runs, the clamp slips at any time, away from the wheel."""
    rows, moments = machine.rows, machine.bare.moments
    clock, starts = rows.clock, np.array([r.clock for r in rows.runs])
    middle = starts + 0.5 * np.array([rows.time[rows.run == k][-1] for k in range(len(starts))])
    held = machine.bench.cell.workpiece.T_flange_blade[:3, :3]
    R = s.frames[:, 6, :3, :3]
    moved = np.einsum("snk,nki->sni", s.flange[..., :3], R)
    later = [clock >= t for t in starts[1:]]
    yield _family(
        "tool_frame_shift", np.stack([moved * on[:, None] for on in later], axis=2), repeat=3, times=starts[1:]
    )  # fmt: skip
    wheel = -s.flange[..., :3]
    yield _family("wheel_frame_shift", np.stack([wheel * on[:, None] for on in later], axis=2), repeat=3, times=starts[1:])
    slips = []
    for t in (times := np.sort(np.concatenate([starts[1:], middle]))):
        before = np.flatnonzero(moments.contact & (clock <= t))
        if len(before):
            slips.append((moved @ -(held @ moments.n[before[-1]])) * (clock >= t))
    yield _family("clamp_slip", np.stack(slips, axis=2)[..., None], times=times)
    n = len(clock)
    twist = np.zeros((n, 6, 3))
    twist[:, 3:] = np.eye(3)
    twist[:, :3] = np.cross(np.eye(3)[None], s.frames[:, 6, None, :3, 3]).transpose(0, 2, 1)
    tilted = s.of_twists(twist)
    yield _family("base_tilt", np.stack([tilted * on[:, None] for on in later], axis=2), repeat=3, times=starts[1:])


def _of_sensor(machine: GrindingMachine) -> Iterator[ForceFamily]:
    """What the reading adds."""
    none = np.zeros(len(machine.rows.s))
    shown = {
        "sensor_bias": none + 1.0, "sensor_drift": machine.rows.clock / 3600.0, "sensor_gain": machine.bare.result.force,
        "sensor_crosstalk": machine.bare.result.tangential,
    }  # fmt: skip
    for effect, values in shown.items():
        yield _family(effect, np.stack([values, none])[:, :, None, None])


def _of_joints(machine: GrindingMachine, s: Slopes, orders_too: bool) -> Iterator[ForceFamily]:
    """What adds to a joint's angle."""
    q, tau, sign = machine.bare.q, s.torque, s.approach
    warmth = machine.hall(machine.rows) - machine.bench.cell.tables.reference_temperature_C
    ratio = gear_ratios(machine.bench.cell.robot)

    def at(j: int, *f: Array) -> Array:
        """Columns (2, n, 1, m) of angles f (n,) of joint j."""
        return np.stack([s.joint[..., j] * g for g in f], axis=2)[:, :, None]

    for j in range(6):
        x = q[:, j]
        thinned = ORDERS if orders_too else ORDERS[:: max(1, int(1.0 / max(np.ptp(x), 1e-3)))]
        yield _family("joint_compliance", at(j, tau[:, j]), j + 1)
        for effect, orders in (
            ("gear_1x", [1.0]), ("gear_2x", [2.0]), ("gear_harmonic", thinned), ("motor_harmonic", ratio[j] * np.array([1, 2])),
        ):  # fmt: skip
            waves = [at(j, np.cos(k * x), np.sin(k * x)) for k in orders]
            yield _family(effect, np.concatenate(waves, axis=2), j + 1, repeat=2)
        yield _family("backlash", at(j, sign[:, j]), j + 1)
        yield _family("friction_windup", at(j, sign[:, j], np.abs(tau[:, j]) * sign[:, j]), j + 1, keys=2)
        yield _family("encoder_scale", at(j, x), j + 1)
        yield _family("joint_thermal", at(j, warmth), j + 1)
        if j >= 3:
            others = [i for i in (3, 4, 5) if i != j]
            yield _family("wrist_coupling", np.concatenate([at(j, q[:, i]) for i in others], axis=2), j + 1)
