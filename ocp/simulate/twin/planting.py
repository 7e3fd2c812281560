"""Effects that can be planted in the virtual cell: their kinds with names, keys and typical ranges of the catalogue (project
DIAGNOSIS); one of them with its values, reading and drawing it.

Names and keys are part of the data contract: labels of data sets and diagnoses use the same. What each of contact, sensor and
timing does to the virtual cell stands in contact/ and arm.py; `at_s` counts on the campaign's clock.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from robots.errors import BadInput, shown


@dataclass(frozen=True)
class Key:
    """A parameter of an effect: unit, what a real cell typically shows (low, high), whether its sign is free, the value where
    none is given (None: the middle of the range).

    length 3 is a vector in space; uniform: drawn evenly, else log-uniformly; integer: a whole number;
    scale: the range's factor for joints 1..6. Keys of unit "name" hold a word.
    """

    name: str
    unit: str
    low: float
    high: float
    signed: bool = False
    default: float | None = None
    length: int = 1
    uniform: bool = False
    integer: bool = False
    scale: tuple[float, ...] = ()


@dataclass(frozen=True)
class EffectKind:
    """An effect: the joints (1..6) that may carry it (empty: none), its keys, size first, and the part of the cell.

    part is "arm", "tracker", "contact", "sensor" or "timing"; common: the joint may be left out.
    """

    name: str
    joints: tuple[int, ...]
    keys: tuple[Key, ...]
    part: str
    common: bool = False


ALL = (1, 2, 3, 4, 5, 6)
BENDING = (2, 3, 4, 5, 6)  # joint 1 stands upright: nothing hangs on its spring
# c3 tau^2 / c is the share at the joint's rated torque; 1 / (k tau^2) of a KR 210 is the unit of c3 (PHYSICS 2.1, 2.5).
_CUBIC = (9.4e-15, 4.6e-15, 1.45e-14, 4.2e-13, 1.74e-12, 4.9e-12)
_RATED = (7290.0, 8100.0, 5291.0, 2182.0, 1282.0, 825.0)  # N m at the link side, KR 210 (PHYSICS 2.1)
# While a step of a campaign happens, s: inside a campaign of three hours, away from its ends.
LATE_STEP = Key("at_s", "s", 1000.0, 8000.0, uniform=True)
# While a step of a grinding campaign happens, s on its clock: inside a campaign of twenty minutes, away from its ends.
_DURING = Key("at_s", "s", 120.0, 1000.0, uniform=True)
_MOTOR_ORDER = Key("order", "1", 1, 2, default=1.0, uniform=True, integer=True)
PHASE = Key("phase_rad", "rad", 0.0, 6.283185307179586, default=0.0, uniform=True)


def _arm(name: str, joints: tuple[int, ...], *keys: Key) -> EffectKind:
    return EffectKind(name, joints, keys, "arm")


def _kind(name: str, part: str, *keys: Key) -> EffectKind:
    return EffectKind(name, (), keys, part)


ARM_KINDS: tuple[EffectKind, ...] = (
    # dq = c tau, in series with the joint's own spring
    _arm("joint_compliance", ALL, Key("rad_per_Nm", "rad/(N m)", 0.3e-6, 5e-6)),
    # dq = -c3 tau^3
    _arm("joint_stiffening", BENDING, Key("rad_per_Nm3", "rad/(N m)^3", 0.05, 0.3, scale=_CUBIC)),
    # a beam: its end turns by k M, M the mean bending moment along it
    _arm("link_bending", (2, 3), Key("rad_per_Nm", "rad/(N m)", 1e-8, 2e-7)),
    # a spring between link 1 (above axis 2) and the upper arm, both anchors so far from axis 2
    _arm(
        "gravity_compensator",
        (2,),
        Key("stiffness_N_m", "N/m", 2e4, 3e5),
        Key("lever_link1_m", "m", 0.1, 0.6, default=0.2),
        Key("lever_arm_m", "m", 0.1, 0.6, default=0.2),
    ),
    # of every payload that weighs something
    _arm("payload_mass", (), Key("kg", "kg", 0.5, 25.0)),
    _arm("payload_com", (), Key("shift_m", "m", 0.005, 0.12, True, length=3)),
    # A cos(k q + phase)
    _arm("gear_1x", ALL, Key("amplitude_rad", "rad", 2e-5, 6e-4), PHASE),
    _arm("gear_2x", ALL, Key("amplitude_rad", "rad", 2e-5, 6e-4), PHASE),
    _arm("gear_harmonic", ALL, Key("amplitude_rad", "rad", 3e-5, 2e-4), Key("order", "1", 3, 300, integer=True), PHASE),
    # A cos(k R q + phase), R the gear's ratio
    _arm("motor_harmonic", ALL, Key("amplitude_rad", "rad", 2e-5, 2e-4), _MOTOR_ORDER, PHASE),
    # b s, s the approach's sign
    _arm("backlash", ALL, Key("half_width_rad", "rad", 2e-5, 8e-4)),
    # b tanh(tau / tau0)
    _arm("load_backlash", BENDING, Key("half_width_rad", "rad", 2e-5, 8e-4), Key("torque_Nm", "N m", 0.003, 0.1, scale=_RATED)),
    # (b0 + h |tau|) s
    _arm("friction_windup", ALL, Key("base_rad", "rad", 2e-5, 2e-4), Key("per_Nm", "rad/(N m)", 2e-8, 1e-7)),
    # e q
    _arm("encoder_scale", ALL, Key("scale", "1", 1e-5, 4e-4, True)),
    # dq_j = k q_i
    _arm(
        "wrist_coupling",
        (4, 5, 6),
        Key("ratio", "1", 1e-4, 3e-3, True),
        Key("source_joint", "1", 4, 6, default=4.0, integer=True),
    ),
    _arm(
        "joint_coupling", ALL, Key("ratio_rad", "1", 1e-5, 4e-4, True), Key("source_joint", "1", 1, 6, default=2.0, integer=True)
    ),
    # what is on the flange gives across the flange's axis, under the payload's weight and the contact
    _arm("tool_flex", (), Key("m_per_N", "m/N", 1e-8, 1e-6)),
    # lengths of all links times 1 + alpha (T - T0)
    _arm("link_thermal", (), Key("per_K", "1/K", 4e-6, 2.5e-5)),
    # g (T - T0)
    _arm("joint_thermal", ALL, Key("rad_per_K", "rad/K", 1e-6, 2e-5, True)),
    # the base turns by this rotation vector, at a time
    _arm("base_tilt", (), Key("rad", "rad", 5e-6, 2e-4, True, length=3), LATE_STEP),
    # readings move and turn about the head, proportional to time
    _kind(
        "tracker_drift",
        "tracker",
        Key("m_per_h", "m/h", 5e-6, 8e-5, True, length=3),
        Key("rad_per_h", "rad/h", 1e-6, 2e-5, True, length=3),
    ),
    # readings times 1 + scale
    _kind("tracker_scale", "tracker", Key("scale", "1", 1e-6, 1e-5, True)),
    # readings times 1 + per_K (T - T0)
    _kind("air_scale", "tracker", Key("per_K", "1/K", 1e-7, 2e-6, True)),
    # readings turn about the head's z axis by rad cos(order azimuth + phase)
    _kind("azimuth_harmonic", "tracker", Key("rad", "rad", 3e-6, 5e-5), Key("order", "1", 1, 12, integer=True), PHASE),
    # one nest moves, in its link's frame, at a time
    _kind("target_shift", "tracker", Key("shift_m", "m", 5e-5, 4e-4, True, length=3), Key("target", "name", 0, 0), LATE_STEP),
    # one recorded channel behind the others (joints.csv, force.csv)
    EffectKind("channel_delay", ALL, (Key("s", "s", 1e-3, 5e-2),), "timing", common=True),
)


CONTACT_KINDS: tuple[EffectKind, ...] = (
    # force of the cover times 1 + scale
    _kind("wheel_stiffness", "contact", Key("scale", "1", 0.03, 0.3, True)),
    # F = 20 N (F_believed(overlap) / 20 N)^(1 + exponent)
    _kind("wheel_law", "contact", Key("exponent", "1", 0.05, 0.6)),
    # standard linear solid: the force falls by the share g at constant overlap, with the time constant tau
    _kind("wheel_relaxation", "contact", Key("g", "1", 0.05, 0.25), Key("tau", "s", 0.05, 30.0)),
    # radius falls with the clock, in contact only where there is no clock
    _kind("wheel_wear", "contact", Key("m_per_s", "m/s", 2e-8, 1e-6)),
    # modulus times 1 + per_K dT, radius plus radius_per_K dT
    _kind(
        "wheel_temperature",
        "contact",
        Key("per_K", "1/K", -0.01, -0.003, default=-0.0055, uniform=True),
        Key("radius_per_K", "m/K", 2e-6, 1e-5),
    ),
    # radius plus m cos(angle turned + phase)
    _kind("wheel_runout", "contact", Key("m", "m", 1e-5, 1e-4), PHASE),
    # a push of N at its top, hz times a second
    _kind("belt_splice", "contact", Key("N", "N", 1.0, 10.0), Key("hz", "1/s", 5.0, 15.0, default=10.0, uniform=True)),
    # N times a share that is 1 at an edge and rises with the blade's curvature
    _kind("belt_tension", "contact", Key("N", "N", 1.0, 10.0)),
    # the logger is behind the motion
    _kind("time_delay", "timing", Key("s", "s", 0.002, 0.06)),
    # the arm is behind on its path by a length, whatever its speed
    _kind("path_lag", "timing", Key("m", "m", 5e-5, 6e-4)),
    # friction plus dmu; the share `leak` of the tangential force stands in the normal reading
    _kind(
        "tangential_force", "contact", Key("dmu", "1", 0.05, 0.35, True), Key("leak", "1", 0.0, 0.1, default=0.03, uniform=True)
    ),
    # every grinding before took so much, times 40 mm/s over the feed
    _kind("material_removal", "contact", Key("m_per_pass", "m", 5e-6, 1e-4)),
    # the surface stands out by a smooth random profile of this rms
    _kind("stock_profile", "contact", Key("m", "m", 5e-5, 2e-4)),
    # stiffness of the blade's solid times 1 + scale
    _kind("blade_stiffness", "contact", Key("scale", "1", 0.05, 0.4, True)),
    # compliance of the clamp at 60 mm from its plane, with the distance squared
    _kind("clamp_compliance", "contact", Key("m_per_N", "m/N", 1e-7, 2e-6)),
    # the blade slips away from the wheel, along the normal that is ground then
    _kind("clamp_slip", "contact", Key("m", "m", 2e-5, 3e-4), _DURING),
    # the blade's frame moves (flange axes), the wheel moves (base axes), between two runs
    _kind("tool_frame_shift", "contact", Key("m", "m", 5e-5, 5e-4, True, length=3), _DURING),
    _kind("wheel_frame_shift", "contact", Key("m", "m", 5e-5, 5e-4, True, length=3), _DURING),
    # on the normal reading: plus N, plus N_per_h times the clock, times 1 + scale, plus share of the tangential force
    _kind("sensor_bias", "sensor", Key("N", "N", 0.1, 2.0, True)),
    _kind("sensor_drift", "sensor", Key("N_per_h", "N/h", 0.1, 3.0, True)),
    _kind("sensor_gain", "sensor", Key("scale", "1", 0.005, 0.06, True)),
    _kind("sensor_crosstalk", "sensor", Key("share", "1", 0.01, 0.1, True)),
    # spring of the flange times 1 + scale
    _kind("flange_stiffness", "contact", Key("scale", "1", 0.05, 0.4, True)),
    # Coulomb friction beside the flange's spring
    _kind("flange_friction", "contact", Key("N", "N", 0.3, 1.5)),
    # mass whose weight is not compensated
    _kind("flange_gravity", "contact", Key("kg", "kg", 0.05, 1.0)),
)

EFFECT_KINDS: dict[str, EffectKind] = {kind.name: kind for kind in (*ARM_KINDS, *CONTACT_KINDS)}
"""Every effect by name, the arm's and the contact's."""


Value = float | tuple[float, ...] | str
LISTED = "`python -m ocp.simulate --list-effects` lists all"

LONGEST_EFFECT = 200  # characters of an effect as it is written
UNUSUAL = 1e4  # times the usual size: beyond, a unit is wrong


@dataclass(frozen=True)
class Planted:
    """One effect with its joint, or None, and the values of all its keys."""

    effect: str
    joint: int | None
    values: dict[str, Value]

    def number(self, key: str) -> float:
        """The value of a key that is one number."""
        value = self.values[key]
        if isinstance(value, str | tuple):
            raise TypeError(f"{self.effect}.{key} is no number")
        return float(value)

    def vector(self, key: str) -> "np.ndarray[Any, np.dtype[np.float64]]":
        """The value of a key as an array (length,)."""
        return np.atleast_1d(np.asarray(self.values[key], float))

    def word(self, key: str) -> str:
        """The value of a key that is a name."""
        return str(self.values[key])


def parse_effect(text: str) -> Planted:
    """An effect as a user writes it: `backlash:5=2e-4`, `gear_harmonic:4=8e-5,order=19`, `payload_com=0.01/0/0.02`.

    The number behind the first `=` is the size, other keys follow by name, vectors stand with `/`. Keys left out take their
    default or the middle of their range. Raises BadInput in one sentence.
    """
    if len(text) > LONGEST_EFFECT:
        raise BadInput(f"effect '{shown(text)}': has {len(text)} characters, the limit is {LONGEST_EFFECT}; shorten it")
    head, _, tail = text.strip().partition("=")
    name, colon, number = head.partition(":")
    kind = _named_kind(text, name.strip())
    joint = _joint(text, kind, number.strip() if colon else None)
    given = _given(text, kind, tail)
    values = {key.name: _read(text, key, given[key.name]) if key.name in given else middle(key, joint) for key in kind.keys}
    if "source_joint" in values:
        values["source_joint"] = _source(text, kind, joint, values["source_joint"], "source_joint" in given)
    return Planted(kind.name, joint, values)


def _named_kind(text: str, name: str) -> EffectKind:
    if name not in EFFECT_KINDS:
        near = get_close_matches(name, EFFECT_KINDS, 1, 0.4)
        hint = f"the nearest is '{near[0]}'; " if near else ""
        raise BadInput(f"effect '{text}': there is no effect '{name}'; {hint}{LISTED}")
    return EFFECT_KINDS[name]


def _joint(text: str, kind: EffectKind, number: str | None) -> int | None:
    if not kind.joints:
        if number is not None:
            raise BadInput(f"effect '{text}': {kind.name} belongs to no joint; write {kind.name}=SIZE")
        return None
    allowed = ", ".join(map(str, kind.joints))
    if number is None:
        if kind.common:
            return None
        if len(kind.joints) == 1:
            return kind.joints[0]
        raise BadInput(f"effect '{text}': {kind.name} needs a joint ({allowed}); write {kind.name}:{kind.joints[0]}=SIZE")
    if not re.fullmatch(r"\d{1,3}", number, re.ASCII) or int(number) not in kind.joints:
        raise BadInput(f"effect '{text}': {kind.name} is not of joint '{number}'; choose from {allowed}")
    return int(number)


def _source(text: str, kind: EffectKind, joint: int | None, source: Value, given: bool) -> float:
    """The joint that another one follows; one that is not given is not the joint itself."""
    others = [float(i) for i in kind.joints if i != joint]
    if given and source not in others:
        own = "the joint itself" if source == joint else "no such joint"
        raise BadInput(f"effect '{text}': source_joint {source:g} is {own}; give another of {', '.join(map(str, kind.joints))}")
    return float(source) if isinstance(source, float) and source in others else others[0]


def _given(text: str, kind: EffectKind, tail: str) -> dict[str, str]:
    """Texts of the keys that are given."""
    found: dict[str, str] = {}
    for i, part in enumerate(p.strip() for p in tail.split(",")) if tail.strip() else ():
        name, equals, value = (p.strip() for p in part.partition("="))
        if not equals:
            if i > 0:
                raise BadInput(f"effect '{text}': '{part}' names no key; write key=value after the first number")
            name, value = kind.keys[0].name, name
        names = [key.name for key in kind.keys]
        if name not in names:
            raise BadInput(f"effect '{text}': {kind.name} has no key '{name}'; its keys are {', '.join(names)}")
        if name in found:
            raise BadInput(f"effect '{text}': key '{name}' is given twice; remove one")
        found[name] = value
    return found


def _read(text: str, key: Key, value: str) -> Value:
    if key.unit == "name":
        if not value:
            raise BadInput(f"effect '{text}': {key.name} is empty; give a name")
        return value
    try:
        numbers = [float(part) for part in value.split("/")]
    except ValueError:
        raise BadInput(f"effect '{text}': {key.name} = '{value}' is not a number, as in 2e-4; correct it") from None
    if not np.isfinite(numbers).all():
        raise BadInput(f"effect '{text}': {key.name} = '{value}' is not finite; correct it")
    most = UNUSUAL * max(abs(key.low), abs(key.high), abs(key.default or 0.0))
    if max(map(abs, numbers)) > most:
        raise BadInput(f"effect '{text}': {key.name} = '{shown(value)}' is beyond {most:g}; is it in SI units?")
    if min(numbers) < 0 < key.low and not key.signed:
        raise BadInput(f"effect '{text}': {key.name} = '{value}' is negative, which it never is; correct it")
    if len(numbers) != key.length:
        form = "/".join(["1e-4", "0", "0"][: key.length])
        raise BadInput(
            f"effect '{text}': {key.name} = '{value}' has {len(numbers)} numbers, {key.length} are needed; write it as {form}"
        )
    if key.integer and numbers[0] != round(numbers[0]):
        raise BadInput(f"effect '{text}': {key.name} = '{value}' must be a whole number; round it")
    return numbers[0] if key.length == 1 else tuple(numbers)


def middle(key: Key, joint: int | None) -> Value:
    """What a key takes that is not given: its default, else the middle of its range (geometric unless drawn evenly)."""
    if key.unit == "name":
        return "T1"
    even = key.uniform or key.low <= 0
    size = 0.5 * (key.low + key.high) if even else float(np.sqrt(key.low * key.high))
    size = (size if key.default is None else key.default) * _scale(key, joint)
    if key.length == 3:
        return (size, 0.0, 0.0)
    return float(round(size)) if key.integer else size


def _scale(key: Key, joint: int | None) -> float:
    return key.scale[joint - 1] if key.scale and joint is not None else 1.0


def draw_effect(
    rng: np.random.Generator, kind: EffectKind, joint: int | None = None, targets: Sequence[str] = ("T1",)
) -> Planted:
    """An effect of a kind at random: joint, sizes inside their typical range, signs and directions; `targets` are the nests."""
    if joint is None and kind.joints and not kind.common:
        joint = int(rng.choice(kind.joints))
    values: dict[str, Value] = {}
    for key in kind.keys:
        values[key.name] = str(rng.choice(list(targets))) if key.unit == "name" else _drawn(rng, key, joint)
    if "source_joint" in values:
        values["source_joint"] = float(rng.choice([i for i in kind.joints if i != joint]))
    planted = Planted(kind.name, joint, values)
    if "lever_arm_m" in values:
        values["lever_link1_m"], values["lever_arm_m"] = _levers(rng, planted.number("stiffness_N_m"))
    return planted


def _drawn(rng: np.random.Generator, key: Key, joint: int | None) -> Value:
    even = key.uniform or key.low <= 0
    size = rng.uniform(key.low, key.high) if even else np.exp(rng.uniform(np.log(key.low), np.log(key.high)))
    size = float(size) * _scale(key, joint)
    if key.length == 3:
        direction = rng.normal(size=3)
        return tuple((size * direction / np.linalg.norm(direction)).tolist())
    if key.signed:
        size *= float(rng.choice([-1.0, 1.0]))
    return float(round(size)) if key.integer else size


# Torque k a b of a balancer, N m: below, it balances nothing; above, it would lift the arm (own weight 4.7 kN m, PHYSICS 2.5).
BALANCER_TORQUE = (300.0, 4500.0)


def _levers(rng: np.random.Generator, stiffness: float) -> tuple[float, float]:
    """Levers a, b m in 0.1..0.6 with which a spring is a balancer."""
    while True:
        a, b = np.exp(rng.uniform(np.log(0.1), np.log(0.6), 2))
        if BALANCER_TORQUE[0] <= stiffness * a * b <= BALANCER_TORQUE[1]:
            return float(a), float(b)


def labels(planted: Sequence[Planted]) -> list[dict[str, Any]]:
    """What was planted, in the form of a data set's labels.json: effect, joint (None: of no joint), then every key."""
    found = []
    for one in planted:
        label: dict[str, Any] = {"effect": one.effect, "joint": one.joint}
        kind = EFFECT_KINDS.get(one.effect)
        whole = {key.name for key in kind.keys if key.integer} if kind is not None else set()
        for name, value in one.values.items():
            label[name] = list(value) if isinstance(value, tuple) else int(value) if name in whole else value
        found.append(label)
    return found
