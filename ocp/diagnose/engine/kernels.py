"""Library-free features: what an effect nobody catalogued would look like, by where it enters and what it varies with.

Each kernel is a handful of smooth functions of one condition (or two) that enter the readings at one joint's angle, as a tilt
of its axis, as a displacement of the instrument's frame, along or across the instrument's beam, or as the reading itself. They
are tested like effects (same projection, same evidence); a condition that wins although the library was offered speaks for an
effect outside it.

Kernels of a force log act at the contact, with its friction and not in the air, or on the normal reading alone: how a sensor's
second axis reads is its own affair. Of waves of time and path, which are of the reading, only those that the log speaks for most
take part (`ocp.diagnose.force.waves`); those with a phase for each run may come by the contact as well.

Features are told in the words of patches (`ocp.effects.patch`) wherever one can hold them: what stands for an unknown effect and
what corrects it are the same functions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.channel_system import ReadingConditions
from ocp.diagnose.rules import FORCE_KERNEL, FRAME_KERNEL, JOINT_KERNEL, LEAST_TORQUE, LEAST_TURN, ORDERS_APART, TILT_KERNEL
from ocp.effects.context import SETTLING
from ocp.effects.engine.evaluate import left_of_motion
from ocp.effects.patch import dense_ends
from robots.pose import Array, Index, Mask

TILTED = 5  # cosines for each direction of a tilting axis
ORDERS_OF_TWO = ((1, 1), (1, 2), (2, 1), (2, 2), (1, 3), (2, 3))  # waves per turn of a joint and of another one
INSTANTS = 7  # at which a nest may move
MOTOR_WAVES = 8  # per turn of a motor: resolvers err up to there
LOADED = np.arange(1.0, 81.0)  # orders per turn of ripples that grow with the load
RIPPLES = np.arange(2.5, 121.0)  # half-integer orders per turn: integers are the library's
SIDES = 5  # cosines of how a nest hangs
BEAM = ("range", "azimuth", "elevation")
SMOOTH = 7  # cosines over a condition's range
SOFT = 4.0  # wave number at which their prior has fallen to half
MOST_GROUPS = 12
BY_RUN = " x run"  # waves whose phase each run has for itself
CLOCK_WAVES = 12  # of the campaign's clock at most, half waves
_SCALAR = "s, feed, setpoint, travel, belt, clock, time, temperature, wheel_temperature, run, line, session".split(", ")
_TWO = "travel s, travel feed, setpoint s, setpoint clock, setpoint belt, setpoint feed, clock s, belt time, feed s"
# What a patch calls conditions of a reading; none: it has no such.
_IN_WORDS = {"clock": "time", "temperature": "warm", "wheel_temperature": "wheel", "time": "", "run": "", "session": ""}

Words = Sequence[str]
"""Features of one variant, as a patch has them."""
Conditions = dict[str, Array]
"""Of n readings (n,), by their names in words, with factors of features that were asked for."""


@dataclass(frozen=True)
class Kernel:
    """What varies with the condition `where`; source: joint, axis, frame, beam or reading; joint (0: none); ways (n, k, d) in
    which it enters k components of a gap: variants of it, as are its features of unit size, in words or as numbers (n, V, m);
    typical low and high of its size, SI; x: conditions; among: of how many variants these are the most telling, 0: they are all
    there are; told: numbers in words."""

    where: str
    source: str
    joint: int
    ways: Sequence[Array]
    features: Sequence[Words] | Array
    low: float
    high: float
    x: Conditions
    among: int = 0
    told: Sequence[Words] = ()

    def words(self, variant: int) -> Words:
        """Features of a variant as a patch has them; none where it cannot hold them."""
        every = self.told if isinstance(self.features, np.ndarray) else self.features
        return every[variant if len(every) > 1 else 0] if len(every) else ()

    @property
    def changes(self) -> Array:
        """Of the gap (n, k, variants, m) SI: every direction of a way with every feature."""
        f = self.features
        if not isinstance(f, np.ndarray):
            f = np.stack([in_numbers(words, self.x) for words in f], axis=1)
        n, V, _ = f.shape
        each = [(way[:, :, None, :, None] * f[:, None, :, None]).reshape(n, way.shape[1], V, -1) for way in self.ways]
        return np.concatenate(each, axis=2)


def is_periodic(where: str) -> bool:
    """Whether a kernel is of waves or periods, of which the most telling are taken."""
    return any(word in where for word in ("wave", "period", "knocks"))


def kernels(c: ReadingConditions) -> Iterator[Kernel]:
    """All kernels that the conditions allow."""
    x = _conditions(c)
    if c.d_joints is not None:
        for j in range(6):
            if np.ptp(c.q[:, j]) > LEAST_TURN or c.signal != "tracker":
                for where, features in _of_joint(c, j):
                    yield Kernel(where, "joint", j + 1, [c.d_joints[:, :, j, None]], features, *JOINT_KERNEL, x)
                if c.d_tilts is not None:
                    yield from _of_axis(c, x, c.d_tilts[:, :, j], j)
    n, k = c.q.shape[0], 3 if c.d_joints is None else c.d_joints.shape[1]
    if c.signal == "tracker":
        still = np.broadcast_to(np.eye(3), (n, 3, 3))
        for where, word in reversed(_slow(c)):
            yield Kernel(where, "frame", 0, [still], [half_waves(word, 3)], *FRAME_KERNEL, x)
            if c.point is not None:
                # What grows about a point, wherever that is: the arm, the air's index, the floor.
                grown = np.concatenate([still, unit(c.point)[:, :, None]], axis=2)
                yield Kernel(f"range x {where}", "frame", 0, [grown], smooth(x[word], 2)[:, None], *FRAME_KERNEL, x)
        for where, index in (("payload", c.payload), ("session", c.session)):
            indicator = groups(index)
            if indicator is not None:
                yield Kernel(where, "frame", 0, [still], indicator[:, None], *FRAME_KERNEL, x)
        time, nests = _time(c), np.unique(c.target if c.target is not None else ())
        if time is not None and len(nests) > 1 and np.ptp(time) > 0:  # one nest moves, sooner or later
            instants = np.quantile(time, np.arange(1, INSTANTS + 1) / (INSTANTS + 1))
            moved = np.stack([(c.target == k) * 1.0 * (time > at) for k in nests for at in instants], axis=1)
            yield Kernel("target x time", "frame", 0, [still], moved[:, :, None], *FRAME_KERNEL, x)
        if c.hang is not None and c.carrier is not None:  # what is loose falls to one side, of all nests or of one
            which = [np.ones(n), *(1.0 * (c.target == k) for k in nests if len(nests) > 1)]
            sides = [smooth(side, SIDES) for side in c.hang.T if np.ptp(side) > LEAST_TURN]
            if sides:
                hung = np.stack([side * one[:, None] for side in sides for one in which], axis=1)
                yield Kernel("hang", "frame", 0, [c.carrier], hung, *FRAME_KERNEL, x)
        if c.point is not None:
            yield from _of_beam(c, x, c.point)
    elif c.signal == "force":
        alone = np.broadcast_to(np.eye(k)[:, :1], (n, k, 1))
        for where, features, told, among in _of_reading(c):
            # What comes by the contact: nothing in the air, and with its friction. By session a blade gripped anew does, by name.
            by_contact = (not among or where.endswith(BY_RUN)) and where != "session"
            ways = [c.pressed[:, :, None], alone] if by_contact and c.pressed is not None else [alone]
            yield Kernel(where, "reading", 0, ways, features, *FORCE_KERNEL, x, among, told)


def _of_joint(c: ReadingConditions, j: int) -> Iterator[tuple[str, Sequence[Words] | Array]]:
    """Features of joint j (0..5), by what they vary with."""
    name, tracker = j + 1, c.signal == "tracker"
    q, tau, sign = f"q{name}", f"tau{name}", f"approach{name}"
    loaded = c.tau is not None and np.ptp(c.tau[:, j]) > LEAST_TORQUE
    yield q, [half_waves(q, SMOOTH)]
    if 0.5 * np.ptp(c.q[:, j]) > ORDERS_APART:  # else a half order looks as whole ones, which the library and the background have
        yield f"ripple{name}", [turns(q, order) for order in RIPPLES]
    if c.approach is not None and np.ptp(c.approach[:, j]) > 0:
        yield sign, [[sign, *turns(q, k, sign)] for k in (1, 2)]
        if loaded:
            yield f"{sign} x {tau}", [times([sign], powers(tau, 3))]
        if tracker and c.waited is not None:
            yield f"{sign} x wait", [times([sign], [f"settling{seconds:.0f}" for seconds in SETTLING])]
        if tracker and c.moved is not None:
            yield f"step{name}", smooth(c.moved[:, j], 5)[:, None]
    ratios = c.gear_ratio[j] if c.gear_ratio is not None else ()
    if len(ratios):
        yield f"motor{name}", [turns(q, k * ratio) for ratio in ratios for k in range(1, MOTOR_WAVES + 1)]
    if loaded:
        yield tau, [half_waves(tau, 3)]
        if tracker:
            yield f"{tau} x ripple{name}", [turns(q, order, *powers(tau, 1)) for order in LOADED]
    for i in range(6):
        if i != j and np.ptp(c.q[:, i]) > LEAST_TURN:
            other = f"q{i + 1}"
            yield f"{q} x {other}", [times(turns(q, a), turns(other, b)) for a, b in ORDERS_OF_TWO]
            if tracker:
                yield other, [half_waves(other, 3)]
    for where, word in _slow(c):
        yield f"{where}{name}", [half_waves(word, 3)]
        if tracker:
            yield f"{where} x {q}", [times(half_waves(word, 2), turns(q, 1))]
            if loaded:
                yield f"{where} x {tau}", [times(half_waves(word, 2), powers(tau, 2))]
    if hung := payload_words(c):
        yield f"payload{name}", [hung]
        if tracker:
            yield f"payload x {q}", [times(hung, turns(q, 1))]


def _of_axis(c: ReadingConditions, x: Conditions, d_tilt: Array, j: int) -> Iterator[Kernel]:
    """Tilts of the axis of joint j about the two directions across it, d_tilt (n, k, 4): as it turns (bearings, a base plate that
    is not flat; directions that stand still in the link before), with the weight's moment across it, with warmth, time and
    payload (directions that stand still, or turn with the joint)."""
    name = j + 1
    still, turning = d_tilt[:, :, :2], d_tilt[:, :, 2:]
    yield Kernel(f"q{name}", "axis", name, [still], [half_waves(f"q{name}", TILTED)], *JOINT_KERNEL, x)
    if c.moments is not None and np.ptp(c.moments[:, j]) > LEAST_TORQUE:
        both, told = unit(c.moments[:, j])[:, None], [[*powers(f"mx{name}", 1), *powers(f"my{name}", 1)]]
        yield Kernel(f"moment{name}", "axis", name, [still], both, *TILT_KERNEL, x, told=told)
    for where, words in [*((where, half_waves(word, 2)) for where, word in _slow(c)), ("payload", payload_words(c))]:
        if words:
            yield Kernel(f"{where}{name}", "axis", name, [still, turning], [words], *TILT_KERNEL, x)


def _of_beam(c: ReadingConditions, x: Conditions, point: Array) -> Iterator[Kernel]:
    """The instrument's own errors at points (n, 3) m in its frame: along the beam or across it, each a function of range,
    azimuth or elevation, or of one of these and of temperature or time; angles show with the distance, here over its mean.

    And reflectors that are no perfect balls: errors along the beam that vary with the direction from which a reflector is seen,
    in the axes of the link that carries it, to second order."""
    flat, distance = np.linalg.norm(point[:, :2], axis=1), np.linalg.norm(point, axis=1)
    along = point / distance[:, None]
    aside = np.column_stack([-point[:, 1], point[:, 0], np.zeros(len(point))]) / flat[:, None]
    upward = np.cross(along, aside)
    directions = along, aside * (flat / flat.mean())[:, None], upward * (distance / distance.mean())[:, None]
    ways = [d[:, :, None] for d in directions]
    for where in BEAM:
        yield Kernel(where, "beam", 0, ways, [half_waves(where, 4)], *FRAME_KERNEL, x)
        for slow, word in _slow(c):
            words = times(powers(where, 1), half_waves(word, 2))
            yield Kernel(f"{where} x {slow}", "beam", 0, ways, [words], *FRAME_KERNEL, x)
    if c.sight is not None:
        a, b, z = c.sight.T
        seen = np.column_stack([c.sight, a * b, b * z, z * a, a * a - b * b, 3 * z * z - 1.0])
        yield Kernel("sight", "beam", 0, ways[:1], seen[:, None], *FRAME_KERNEL, x)


def _of_reading(c: ReadingConditions) -> Iterator[tuple[str, Array, Sequence[Words], int]]:
    """Features (n, V, m) of the normal reading by their condition, all that the conditions of a force log allow, and in words;
    among how many variants these are the most telling, 0: they are all there are."""
    for where in _SCALAR:
        if one := _of_one(c, where):
            yield where, one[0][:, None], [one[1]], 0
    for first, second in map(str.split, _TWO.split(", ")):
        a, b = _of_one(c, first, 2), _of_one(c, second, 3)
        if a and b:
            yield f"{first} x {second}", products(a[0], b[0])[:, None], [times(a[1], b[1])], 0
    for j in range(6):
        if np.ptp(c.q[:, j]) > LEAST_TURN:
            yield f"q{j + 1}", smooth(c.q[:, j], 4)[:, None], [half_waves(f"q{j + 1}", 4)], 0
    if c.clock is not None and c.run is not None and len(np.unique(c.run)) > 4:
        phase = np.pi * (c.clock - c.clock.min()) / max(float(np.ptp(c.clock)), 1e-9)
        yield "clock wave", np.stack([waves(k * phase) for k in range(3, 3 + CLOCK_WAVES)], axis=1), (), 0
    for where in dict.fromkeys(w.where for w in c.waves):
        picked = [w for w in c.waves if w.where == where]
        by, told = "travel" if where.endswith("travel") else "", list[Words]()
        for w in picked if where.startswith("s ") else ():
            tones = np.arange(1, w.columns.shape[1] // 2 + 1)
            told.append([word for tone in tones for word in turns("s", 2.0 * np.pi * tone * w.number, by)])
        yield where, np.stack([w.columns for w in picked], axis=1), told, picked[0].among


def _of_one(c: ReadingConditions, where: str, count: int = 3) -> tuple[Array, Words] | None:
    """Features (n, m) of one condition, and in words, None where it is not known or does not vary."""
    values, word = getattr(c, where), _IN_WORDS.get(where, where)
    if values is None or np.ptp(values) == 0:
        return None
    if where in ("run", "line", "travel", "session"):
        indicator = groups(values)
        told = [f"line {k}" for k in lesser(values)] if where == "line" else [word] if word else []
        return None if indicator is None or indicator.shape[1] > MOST_GROUPS else (indicator, told)
    count = SMOOTH if where == "s" and count == 3 else count
    return smooth(values, count), half_waves(word, count) if word else []


def _slow(c: ReadingConditions) -> list[tuple[str, str]]:
    """Temperature and time, where they vary, by their names and in words."""
    courses = ("temperature", "warm", c.temperature), ("time", "time", _time(c))
    return [(where, word) for where, word, values in courses if values is not None and np.ptp(values) > 0]


def _time(c: ReadingConditions) -> Array | None:
    return c.clock if c.clock is not None else c.time


def payload_words(c: ReadingConditions) -> list[str]:
    """Indicators of all payloads that were measured but the commonest; a star in a name would part it as a product."""
    return [] if c.payload is None else [f"is {c.payloads[k].replace('*', 'x')}" for k in lesser(c.payload)]


def half_waves(name: str, count: int) -> list[str]:
    """Smooth features over a condition's range."""
    return [f"wave {k} {name}" for k in range(1, count + 1)]


def powers(name: str, count: int) -> list[str]:
    """First and further powers of a condition over its largest size."""
    return [f"power {k} {name}" for k in range(1, count + 1)]


def turns(name: str, order: float, by: str = "") -> list[str]:
    """Cosine and sine of an angle, times a factor."""
    return [f"{by} * {form} {order:.10g} {name}" if by else f"{form} {order:.10g} {name}" for form in ("cos", "sin")]


def times(first: Words, second: Words) -> list[str]:
    """Each of the first times each of the second."""
    return [f"{a} * {b}" for a in first for b in second]


def in_numbers(words: Words, x: Conditions) -> Array:
    """Features (n, m) of conditions; factors stay in x, as other kernels have the same."""
    parts = [word.split(" * ") for word in words]
    for text in {text for texts in parts for text in texts if text not in x}:
        x[text] = _factor(text, x)
    return np.column_stack([reduce(np.multiply, [x[text] for text in texts]) for texts in parts])


def _factor(text: str, x: Conditions) -> Array:
    """One factor (n,) of a feature."""
    form, number, name = text.split(" ")
    k, values = float(number), x[name]
    if form == "wave":
        return smooth_wave(values, k)
    return np.asarray(unit(values) ** k if form == "power" else getattr(np, form)(k * values))


def _conditions(c: ReadingConditions) -> dict[str, Array]:
    """Conditions as kernels vary with them: of patches, signs of approach, payloads about their means."""
    found = conditions_by_name(c, middle=0.0 if c.point is None else middle_of(c.point))
    found |= {} if c.approach is None else {f"approach{j + 1}": c.approach[:, j] for j in range(6)}
    time, indicator = _time(c), groups(c.payload)
    found |= {} if time is None else {"time": time}
    return found if indicator is None else found | dict(zip(payload_words(c), indicator.T, strict=True))


def middle_of(point: Array) -> float:
    """Mean azimuth rad of points (n, 3)."""
    turned = np.arctan2(point[:, 1], point[:, 0])
    return float(np.arctan2(np.sin(turned).mean(), np.cos(turned).mean()))


def conditions_by_name(c: ReadingConditions, reference: float = 0.0, middle: float = 0.0) -> dict[str, Array]:
    """Conditions (n,) of readings as patches call them; reference temperature deg C, middle azimuth rad."""
    found = {f"q{j + 1}": c.q[:, j] for j in range(6)}
    found |= {name: v for name in ("s", "feed", "setpoint", "belt") if (v := getattr(c, name)) is not None}
    found |= {} if c.wheel_temperature is None else {"wheel": c.wheel_temperature - reference}
    found |= {} if c.line is None else {"line": c.line.astype(float)}
    if c.tau is not None:
        found |= {f"tau{j + 1}": c.tau[:, j] for j in range(6)}
    if c.moments is not None:
        found |= {f"m{axis}{j + 1}": c.moments[:, j, k] for j in range(6) for k, axis in enumerate("xy")}
    found |= {} if c.temperature is None else {"warm": c.temperature - reference}
    found |= {} if c.clock is None else {"time": c.clock}
    if c.waited is not None:
        found |= {f"settling{s:.0f}": left for s, left in zip(SETTLING, left_of_motion(c.waited).T, strict=True)}
    if c.point is not None:
        turned = np.arctan2(c.point[:, 1], c.point[:, 0]) - middle
        found |= {"range": np.linalg.norm(c.point, axis=1), "azimuth": np.arctan2(np.sin(turned), np.cos(turned))}
        found |= {"elevation": np.arctan2(c.point[:, 2], np.linalg.norm(c.point[:, :2], axis=1))}
    return found


def measured_ranges(c: ReadingConditions, middle: float, rows: Mask | slice = slice(None)) -> dict[str, tuple[float, float]]:
    """Ranges of conditions in some rows of readings, as patches call them, far ends of a joint's that few readings lie near left
    out; middle azimuth rad. What settles is gone after a wait longer than any that was measured."""
    named = conditions_by_name(c, c.reference or 0.0, middle).items()
    found = {n: dense_ends(v[rows], rules.NEAR, rules.NEAR_SHARE * n[-1].isdigit()) for n, v in named}
    return {n: (0.0 if n.startswith("settling") else low, high) for n, (low, high) in found.items()}


def smooth(values: Array, count: int) -> Array:
    """Cosines (n, count) over the range of values, falling with their wave number; the constant is left out."""
    return smooth_wave(values[:, None], np.arange(1.0, count + 1.0))


def smooth_wave(values: Array, k: Array | float) -> Array:
    """Cosines of k half waves over the range of values."""
    x = (values - values.min()) / (float(np.ptp(values)) or 1.0)
    return np.asarray(np.cos(np.pi * k * x) / (1.0 + (k / SOFT) ** 2))


def waves(angle: Array) -> Array:
    """Once a turn (n, 2)."""
    return np.column_stack([np.cos(angle), np.sin(angle)])


def unit(values: Array) -> Array:
    """Values over their largest size."""
    return np.asarray(values / (np.abs(values).max() or 1.0))


def products(one: Array, other: Array) -> Array:
    """Each of (n, a) times each of (n, b): (n, a b)."""
    return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(one), -1))


def lesser(index: Array | Index) -> Array:
    """All groups but the largest."""
    kinds, counts = np.unique(index, return_counts=True)
    return np.asarray(np.delete(kinds, np.argmax(counts)))


def groups(index: Array | Index | None) -> Array | None:
    """Indicators (n, g - 1) of all groups but the largest about their means; None where there is one."""
    if index is None or not len(lesser(index)):
        return None
    indicator = (np.asarray(index)[:, None] == lesser(index)).astype(float)
    return np.asarray(indicator - indicator.mean(axis=0))
