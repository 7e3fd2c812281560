"""What an effect is: its name, its parameters with priors, and where it enters the one symbolic model.

An effect is linear in its coefficients a (m,), once its scanned values (an order, an instant, a lever) are fixed; zero
coefficients are the believed cell. Each hook gives the model's change per unit coefficient as a CasADi expression, so that
screening, fitting and planning use the same formula with exact derivatives. Names and parameter keys are those of
DIAGNOSIS.md (the data contract); signs and units of every key are stated in the effect's own file.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import ArmContext, ContactContext, LogRows, TrackerContext
from robots.pose import Array
from robots.robot import Robot

Scanned = Mapping[str, Any]  # values of the scanned parameters of one variant
ArmHook = Callable[[ArmContext, int, Scanned], ca.SX]
TwistHook = Callable[[ArmContext, int, Scanned], dict[int, ca.SX]]
TrackerHook = Callable[[TrackerContext, int, Scanned], ca.SX]
ContactHook = Callable[[ContactContext, int, Scanned], ca.SX]
AlongHook = Callable[[LogRows, int, Scanned], Array]
SUBSYSTEMS = ("joint", "link", "base", "payload", "tool", "tracker", "target", "wheel", "blade", "flange", "sensor", "timing")


@dataclass(frozen=True)
class Parameter:
    """A key of the catalogue: SI unit ("1": none, "name": a text), typical range low..high of its magnitude (high is the
    prior's scale, not a bound), whether either sign is physical, and how many numbers it holds (0: any)."""

    key: str
    unit: str
    low: float
    high: float
    signed: bool = True
    length: int = 1


@dataclass(frozen=True)
class Surroundings:
    """What a data set offers to the scans; all empty where absent.

    gear_ratio (6,) (nan unknown); q_range (6, 2) rad covered; time: sorted instants s of the readings on the campaign's clock;
    targets, payloads: names; read_at: by target, instants s of its own readings, where they are known; breaks: instants s on that
    clock between runs or sessions; span m: where s begins in contact and how far it goes; lines: numbers of the lines ground;
    sides: mean outward normals (3,), blade frame, of the sides ground; friction of the cell; robot: its catalogue name;
    torque_max (6,) N m, stiffness (6,) N m/rad of the believed robot (None, 0: those of a KR 210 set the scale of priors);
    splice_trains: of a belt, that a force log speaks for; among: by effect, of how many variants its scan offers the best.
    """

    gear_ratio: Array
    q_range: Array
    time: Array
    targets: tuple[str, ...] = ()
    payloads: tuple[str, ...] = ()
    read_at: Mapping[str, Array] = field(default_factory=dict)
    breaks: Array = field(default_factory=lambda: np.empty(0))
    span: tuple[float, float] = (0.0, 0.0)
    robot: str = ""
    torque_max: Array | None = None
    stiffness: Array | None = None
    lines: tuple[float, ...] = ()
    sides: tuple[tuple[float, float, float], ...] = ()
    friction: float = 0.35
    splice_trains: tuple[Scanned, ...] = ()
    among: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def of(robot: Robot, q: Array, time: Array | None, targets: Sequence[str] = (), **more: Any) -> "Surroundings":
        """Of readings of an arm at joints q (n, 6) rad, times s and nests, a name for each, and what else they offer."""
        span, instants = np.stack([q.min(axis=0), q.max(axis=0)], axis=1), np.empty(0) if time is None else np.sort(time)
        names = np.array(targets)
        more |= {"targets": tuple(dict.fromkeys(targets))}
        more |= {"read_at": {} if time is None else {n: np.sort(time[names == n]) for n in more["targets"]}}
        own: dict[str, Any] = {"robot": robot.name, "torque_max": robot.torque_max, "stiffness": robot.stiffness}
        return Surroundings(robot.gear_ratio, span, instants, **own, **more)


def scan_key(scanned: Scanned, digits: int = 9) -> tuple[Any, ...]:
    """Hashable form of scanned values (floats to so many digits, 17: exactly; arrays as tuples)."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray | list | tuple):
            return tuple(plain(v) for v in value)
        return float(f"{value:.{digits}g}") if isinstance(value, float | np.floating) else value

    return tuple((k, plain(scanned[k])) for k in sorted(scanned))


def one_variant(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """No scanned values: a single variant."""
    return ({},)


@dataclass(frozen=True)
class Effect:
    """An effect of the catalogue.

    physics: what it is and where that is written; without it the docstring of its file, of which all counts that stands below the
    first line.
    joints: where it may sit (1..6), empty for effects of no joint (hooks then get joint 0). coefficients: their names;
    prior_sd (m,) of the coefficients: the upper end of the typical range. scan(joint, surroundings): variants of the scanned
    values; symbolic: those of them that hooks take as CasADi symbols, so that one function serves all their values.
    values(a, scanned): parameters by key from coefficients; coefficients_of(values): the inverse, (a, scanned).
    needs: columns without which it cannot be seen ("approach", "temperature_C", "time_s", "wheel_temperature_C", ...).

    Hooks, all None by default, each per unit coefficient:
    joint (6, m) rad added to the commanded joint angles; torque (6, m) N m added to the load torque (bends the joints through
    their compliance); twist {link: (6, m)} small motion (m at that link's origin, rad; base axes) of link 0..6 and of all that
    follows it; reading (3, m) m added to a tracker reading in the tracker's frame; overlap (1, m) m added to the interference;
    push (1, m) N added to the flange's force along the contact normal (rigid cells: to the force); sensor (1, m) N added to the
    normal force reading alone; shear (1, m) N added to the tangential reading alone; along (n, m) N of the normal reading,
    along_shear (n, m) N of the tangential one, for what depends on the log before (delays, relaxation), in NumPy.

    own_size(a): scanned values with which an effect that is linear only at a given size acts as large as its coefficients are.
    doubt(a, sd, scanned): why fitted coefficients a (m,) with standard deviations sd (m,) cannot be this effect although each is
    within its range, in words; empty where they can.
    """

    name: str
    title: str
    subsystem: str
    parameters: tuple[Parameter, ...]
    coefficients: tuple[str, ...]
    prior_sd: tuple[float, ...]
    values: Callable[[Array, Scanned], dict[str, Any]]
    coefficients_of: Callable[[Mapping[str, Any]], tuple[Array, dict[str, Any]]]
    physics: str = ""
    joints: tuple[int, ...] = ()
    needs: tuple[str, ...] = ()
    scan: Callable[[int, Surroundings], Sequence[Scanned]] = one_variant
    joint: ArmHook | None = None
    torque: ArmHook | None = None
    twist: TwistHook | None = None
    reading: TrackerHook | None = None
    overlap: ContactHook | None = None
    push: ContactHook | None = None
    sensor: ContactHook | None = None
    shear: ContactHook | None = None
    along: AlongHook | None = None
    along_shear: AlongHook | None = None
    symbolic: tuple[str, ...] = ()
    own_size: Callable[[Array], Scanned] | None = None
    doubt: Callable[[Array, Array, Scanned], str] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Effects travel between processes by name: their hooks are no data."""
        return effect_named, (self.name,)

    def __post_init__(self) -> None:
        assert len(self.prior_sd) == len(self.coefficients), f"{self.name}: one prior_sd a coefficient"
        assert self.subsystem in SUBSYSTEMS, f"{self.name}: {self.subsystem}"

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.coefficients)

    @property
    def on_arm(self) -> bool:
        """Whether it moves the arm, and so is seen by tracker, force and joint readings alike."""
        return any(hook is not None for hook in (self.joint, self.torque, self.twist))

    @property
    def on_contact(self) -> bool:
        """Whether it changes force readings beside what a moved arm changes."""
        hooks = (self.overlap, self.push, self.sensor, self.shear, self.along, self.along_shear)
        return any(hook is not None for hook in hooks)

    @property
    def places(self) -> tuple[int, ...]:
        """Joints to try; (0,) for effects of no joint."""
        return self.joints or (0,)

    @property
    def positive(self) -> Array:
        """Coefficients (m,) that may not be negative: those that are an unsigned parameter, and the share of the only one."""
        unsigned = {p.key for p in self.parameters if not p.signed and p.length == 1}
        if self.coefficients == ("share",) and len(self.parameters) == 1:
            return np.array([bool(unsigned)])
        return np.array([c in unsigned for c in self.coefficients])

    @property
    def sized_by(self) -> Parameter:
        """The key that says how large it is."""
        return next(p for p in self.parameters if p.unit != "name" and p.high > 0 and p.key not in ("order", "phase_rad"))

    def lower_end(self, scans: Sequence[Scanned]) -> float:
        """Lower over upper end of the typical range, the least over the parameters that are sizes, not scanned."""
        sizes = [p.low / p.high for p in self.parameters if p.low > 0 and p.key not in scans[0]]
        return float(np.clip(min(sizes, default=0.03), 0.01, 0.5))


def effect_named(name: str) -> Effect:
    """An effect of the library, or a patch, by its name."""
    from ocp.effects.catalogue import library  # not at the top: the library imports the effects, and they this module
    from ocp.effects.patch import PATCH, patch_effect

    return patch_effect(name) if name.startswith(PATCH) else library()[name]


@dataclass(frozen=True)
class Active:
    """An effect with values: which joint (0: none), coefficients a (m,), scanned values; covariance (m, m) of a."""

    effect: Effect
    joint: int
    a: Array
    scanned: Scanned
    covariance: Array

    @property
    def key(self) -> tuple[str, int]:
        """Name of the effect and its joint: what tells it from others."""
        return self.effect.name, self.joint

    @property
    def falls_out_of_step(self) -> bool:
        """Whether it is a train of knocks on the campaign's clock: long after its log nobody knows where they are."""
        return "hz" in self.scanned and bool(self.scanned.get("clocked"))

    @property
    def parameters(self) -> dict[str, Any]:
        """Values by key of the catalogue."""
        return self.effect.values(self.a, self.scanned)

    @property
    def deviations(self) -> dict[str, Any]:
        """Standard deviations by key, to first order; keys that are scanned or texts have none."""
        known = {p.key: p for p in self.effect.parameters}
        values = {k: v for k, v in self.parameters.items() if k in known and known[k].unit != "name" and k not in self.scanned}
        sd = np.sqrt(np.maximum(np.diag(np.atleast_2d(self.covariance)), 0.0))
        steps = np.where(sd > 0, 1e-3 * sd, 1e-6 * np.asarray(self.effect.prior_sd))
        slopes = [_slope(self.effect, np.asarray(self.a, float), self.scanned, i, steps[i], values) for i in range(len(sd))]
        out: dict[str, Any] = {}
        for key, value in values.items():
            J = np.stack([slope[key] for slope in slopes], axis=-1)
            found = np.sqrt(np.maximum(np.einsum("...i,ij,...j->...", J, np.atleast_2d(self.covariance), J), 0.0))
            out[key] = float(found) if np.ndim(value) == 0 else found.tolist()
        return out


def deviations_among(one: Active, likely: Sequence[tuple[float, Active]]) -> dict[str, Any]:
    """Standard deviations by key of an effect that may as well have other scanned values: `likely` are effects with their
    probabilities, itself among them. Mean squares about its own values; of an order too, which is scanned."""
    squares: dict[str, Array] = {}
    for share, other in likely:
        within, values = other.deviations, other.parameters
        for key in [*within, *({"order"} & other.scanned.keys())]:
            off = np.asarray(values[key], float) - np.asarray(one.parameters[key], float)
            off = _short_way(off) if key == "phase_rad" else off
            squares[key] = squares.get(key, 0.0) + share * (off**2 + np.asarray(within.get(key, 0.0)) ** 2)
    return {key: np.sqrt(square).tolist() for key, square in squares.items() if np.any(square > 0)}


def effects_key(active: Sequence[Active], digits: int = 9) -> tuple[Any, ...]:
    """Effects, joints and scanned values, what a refit does not change, whatever their order; digits: of scanned numbers, two
    where finer ones are no other effect."""
    return tuple(sorted((*a.key, repr(scan_key(a.scanned, digits))) for a in active))


def prior_sds(active: Sequence[Active]) -> Array:
    """Prior standard deviations (m,) of the coefficients of several effects, one after the other."""
    return np.concatenate([np.zeros(0), *(np.asarray(one.effect.prior_sd, float) for one in active)])


def coefficients(active: Sequence[Active]) -> Array:
    """Coefficients (m,) of several effects, one after the other."""
    return np.concatenate([np.zeros(0), *(one.a for one in active)])


def with_coefficients(active: Sequence[Active], a: Array, covariance: Array | None = None) -> tuple[Active, ...]:
    """The effects with coefficients a (m,) and, where it is given, their own blocks of a covariance (m, m)."""
    found, start = [], 0
    for one in active:
        block = slice(start, start + one.effect.size)
        own = one.covariance if covariance is None else covariance[block, block]
        found.append(replace(one, a=a[block], covariance=own))
        start = block.stop
    return tuple(found)


def _slope(effect: Effect, a: Array, scanned: Scanned, i: int, step: float, keys: Mapping[str, Any]) -> dict[str, Array]:
    """Derivative of the parameters in coefficient i by central differences; phases the short way round."""
    up, down = (effect.values(a + sign * step * np.eye(len(a))[i], scanned) for sign in (1.0, -1.0))
    change = {key: np.asarray(up[key], float) - np.asarray(down[key], float) for key in keys}
    return {key: (_short_way(d) if key == "phase_rad" else d) / (2 * step) for key, d in change.items()}


def _short_way(turn: Array) -> Array:
    """Angles rad as they are turned the short way round."""
    return (turn + np.pi) % (2 * np.pi) - np.pi


def amplitude_and_phase(a: Array) -> tuple[float, float]:
    """A and phase of A cos(x + phase) = a0 cos x + a1 sin x."""
    return float(np.hypot(a[0], a[1])), float(np.arctan2(-a[1], a[0]))


def cosine_and_sine(amplitude: float, phase: float) -> Array:
    """The inverse of `amplitude_and_phase`."""
    return np.array([amplitude * np.cos(phase), -amplitude * np.sin(phase)])
