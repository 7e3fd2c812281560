"""The exact signatures of the whole catalogue on a given machine: what an oracle knows, written a second time from DIAGNOSIS.md.

Angles' effects follow from the machine's own Jacobian, torques and conditions; what is built into the machine (a spring between
links, a soft link, weights, growth) is the difference of two runs of the virtual cell. Columns are per unit coefficient.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.blindtest.oracle.detectability import cross_matrices
from ocp.blindtest.worlds.machines import Machine
from ocp.blindtest.worlds.scene import Scene
from ocp.simulate.twin.arm.joint_errors import gear_ratios
from ocp.simulate.twin.truth.kinds_arm import BENDING
from ocp.simulate.twin.truth.planting import Kind, Planted, Value, kinds
from robots.pose import Array

ORDERS = np.arange(3, 301)
LEVERS = ((0.1, 0.1), (0.1, 0.3), (0.3, 0.1), (0.2, 0.2), (0.15, 0.6), (0.6, 0.15), (0.4, 0.4), (0.25, 0.4), (0.6, 0.6))  # m


@dataclass(frozen=True, eq=False)
class Family:
    """An effect at a joint (0: none) with its variants: columns (n, 3, V, m) m per unit coefficient, upper ends (m,) of the usual
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


def families(machine: Machine, scene: Scene) -> list[Family]:
    """Every effect of the catalogue that a tracker sees, at every joint."""
    found = [*_of_joints(scene), *_of_torques(machine), *_of_frames(scene)]
    return [f for f in found if np.abs(f.columns * f.upper).max() > 1e-9]


def _family(effect: str, joint: int, columns: Array, keys: int = 1, repeat: int = 1) -> Family:
    """Upper ends of the effect's first `keys` keys, each for `repeat` coefficients."""
    kind: Kind = kinds()[effect]
    upper = [k.high * (k.scale[joint - 1] if k.scale and joint else 1.0) for k in kind.keys[:keys]]
    waves = any(k.name == "phase_rad" for k in kind.keys)
    signed = waves or any(k.signed for k in kind.keys[:keys])
    return Family(effect, joint, columns, np.repeat(upper, repeat), not signed)


def _of_joints(scene: Scene) -> Iterator[Family]:
    """What adds to a joint's angle."""
    m, tau = scene.campaign.moments, scene.tau
    ratio = gear_ratios(scene.cell.robot)

    def at(j: int, *f: Array) -> Array:
        """Columns (n, 3, 1, m) of angles f (n,) of joint j."""
        return np.stack([scene.D[:, :, j] * g[:, None] for g in f], axis=2)[:, :, None]

    for j in range(6):
        q, s = m.q[:, j], m.approach[:, j]
        if np.abs(tau[:, j]).max() > 1e-6:
            yield _family("joint_compliance", j + 1, at(j, tau[:, j]))
            if j + 1 in BENDING:
                yield _family("joint_stiffening", j + 1, at(j, -(tau[:, j] ** 3)))
        for effect, orders in (
            ("gear_1x", [1.0]), ("gear_2x", [2.0]), ("gear_harmonic", ORDERS), ("motor_harmonic", ratio[j] * np.array([1, 2])),
        ):  # fmt: skip
            waves = [at(j, np.cos(k * q), np.sin(k * q)) for k in orders]
            yield _family(effect, j + 1, np.concatenate(waves, axis=2), 1, 2)
        yield _family("backlash", j + 1, at(j, s))
        yield _family("friction_windup", j + 1, at(j, s, np.abs(tau[:, j]) * s), 2)
        yield _family("encoder_scale", j + 1, at(j, q))
        yield _family("joint_thermal", j + 1, at(j, scene.warmth))
        if j >= 3:
            others = [i for i in (3, 4, 5) if i != j]
            yield _family("wrist_coupling", j + 1, np.concatenate([at(j, m.q[:, i]) for i in others], axis=2))


def _of_torques(machine: Machine) -> Iterator[Family]:
    """What is built into the machine: small amounts of it, run and compared."""
    bare = machine.points(())

    def change(effect: str, joint: int | None, size: float, **values: Value) -> Array:
        """Columns (n, 3) per unit of the first key."""
        key = kinds()[effect].keys[0].name
        one = values.pop(key, size)
        return (machine.points([Planted(effect, joint, {key: one, **values})]) - bare) / size

    for joint in (2, 3):
        yield _family("link_bending", joint, change("link_bending", joint, 1e-8)[:, :, None, None])
    springs = [change("gravity_compensator", 2, 1e4, lever_link1_m=a, lever_arm_m=b) for a, b in LEVERS]
    yield _family("gravity_compensator", 2, np.stack(springs, axis=2)[..., None])
    yield _family("payload_mass", 0, change("payload_mass", None, 0.5)[:, :, None, None])
    shifts = [change("payload_com", None, 0.01, shift_m=tuple(0.01 * np.eye(3)[i])) for i in range(3)]
    yield _family("payload_com", 0, np.stack(shifts, axis=2)[:, :, None], 1, 3)
    yield _family("link_thermal", 0, change("link_thermal", None, 1e-5)[:, :, None, None])


def _of_frames(scene: Scene) -> Iterator[Family]:
    """What happens to the base, the tracker and the nests."""
    n, time = len(scene), scene.campaign.moments.time_s
    motion = np.zeros((n, 6, 3))
    motion[:, 3:] = np.eye(3)
    tilt = scene.moved(0, motion)
    later = [time >= t for t in time[1:]]
    yield _family("base_tilt", 0, np.stack([tilt * on[:, None, None] for on in later], axis=2), 1, 3)
    hours = time[:, None, None] / 3600.0
    drift = hours * np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), -cross_matrices(scene.point)], axis=2)
    yield _family("tracker_drift", 0, drift[:, :, None], 2, 3)
    yield _family("tracker_scale", 0, scene.point[:, :, None, None])
    turned = scene.turn @ scene.links[np.arange(n), scene.carrier, :3, :3]
    label = np.array(scene.campaign.targets)
    moved = []
    for name in dict.fromkeys(scene.campaign.targets):
        own = label == name
        moved += [turned * (own & on)[:, None, None] for k, on in enumerate(later) if own[k + 1] and own[: k + 1].any()]
    if moved:
        yield _family("target_shift", 0, np.stack(moved, axis=2), 1, 3)
