"""The unknowns of a calibration as one vector: geometry, springs, payloads, reflector nests, tracker stations."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from robots.calibration.parameters import MDH_NAMES
from robots.calibration.reading_model import ARM_NAMES, PAYLOAD_NAMES
from robots.compliance import compliance_from_stiffness
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Hanging, Instrument, Readings

STEP = {"station": 1e-2, "nest": 1e-3}  # scale of unknowns without a prior, m and rad; for conditioning only

IS_LENGTH = np.array([name[0] == "d" or (name[0] == "a" and name[1] != "l") for name in MDH_NAMES])  # (30,)


@dataclass(frozen=True)
class Priors:
    """One sigma before any reading: MD-H lengths m and angles rad, springs relative to their believed compliance, payload
    mass kg and centre m. Nests have the instrument's; stations have none."""

    length: float = 1e-3
    angle: float = 1e-3
    compliance: float = 1.0
    payload_mass: float = 1.0
    payload_com: float = 10e-3


@dataclass(frozen=True)
class Choice:
    """Which terms a model has: the MD-H geometry, joints that bend (1..6), payloads (names) whose mass and centre are fitted."""

    geometry: bool = True
    joints: tuple[int, ...] = (2, 3)
    payloads: tuple[str, ...] = ()


@dataclass(frozen=True)
class State:
    """Values of everything: arm (36,), payloads (k, 4), nests (m, 3) m with their turns (m, 3, 3), stations (s, 4, 4) tracker
    from base; links (w,): what the links' weights differ by from the catalogue, of fits that have such unknowns."""

    arm: Array
    payloads: Array
    nests: Array
    turns: Array
    stations: Array
    links: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Layout:
    """Names of the unknowns (p,), one sigma of each prior (p,) (inf: none), scale (p,), and the columns of each block."""

    names: tuple[str, ...]
    prior_sd: Array
    scale: Array
    arm: Array = field(repr=False)  # columns of ARM_NAMES in the vector, -1 where fixed
    payload: Array = field(repr=False)  # (k, 4)
    nest: Array = field(repr=False)  # (m, 6) place and turn
    station: Array = field(repr=False)  # (s, 6) shift and turn
    links: Array = field(default_factory=lambda: np.zeros(0, int), repr=False)  # (w,), of whoever adds them

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.names)

    @property
    def geometry(self) -> tuple[Array, Array]:
        """Columns of the MD-H lengths and of the MD-H angles that are unknowns."""
        columns = self.arm[:30]
        return columns[IS_LENGTH & (columns >= 0)], columns[~IS_LENGTH & (columns >= 0)]

    @property
    def bending(self) -> list[int]:
        """Joints 1..6 whose springs are unknowns; all others are rigid under weight."""
        return [j for j in range(1, 7) if self.arm[29 + j] >= 0]

    @property
    def precision(self) -> Array:
        """Of the priors (p,) in units of the scale: 0 where there is none."""
        return np.where(np.isfinite(self.prior_sd), (self.scale / self.prior_sd) ** 2, 0.0)

    def index(self, name: str) -> int:
        """Column of a name."""
        return self.names.index(name)


def believed_compliance(robot: Robot) -> Array:
    """Joint compliances (6,) rad/(N m) of the catalogue or cell; 0 = rigid."""
    return np.asarray(compliance_from_stiffness(robot.stiffness))


def build_layout(robot: Robot, readings: Readings, instrument: Instrument, choice: Choice, priors: Priors) -> Layout:
    """Unknowns for `readings`: only nests and stations that occur in them; 6D nests have three more."""
    names: list[str] = []
    prior: list[float] = []
    scale: list[float] = []

    def add(name: str, sd: float, step: float) -> int:
        names.append(name)
        prior.append(sd)
        scale.append(sd if np.isfinite(sd) else step)
        return len(names) - 1

    arm = np.full(len(ARM_NAMES), -1)
    if choice.geometry:
        for i, name in enumerate(MDH_NAMES):
            arm[i] = add(name, priors.length if name[0] in "d" or (name[0] == "a" and name[1] != "l") else priors.angle, 1e-3)
    for j in choice.joints:
        arm[29 + j] = add(f"c{j}", priors.compliance * typical_compliance(robot)[j - 1], 1e-6)
    payload = np.full((len(readings.payloads), 4), -1)
    for k, known in enumerate(readings.payloads):
        if known in choice.payloads:
            sds = (priors.payload_mass, *[priors.payload_com] * 3)
            payload[k] = [add(f"{known}:{n}", sd, sd) for n, sd in zip(PAYLOAD_NAMES, sds, strict=True)]
    nest = np.full((len(readings.targets), 6), -1)
    for k in np.unique(readings.target):
        known = readings.targets[k]
        given = (instrument.nests or {}).get(known)
        sd = instrument.nest_sd if given is not None and given.place is not None else np.inf
        parts = ["x", "y", "z"] + (["u", "v", "w"] if readings.turned[readings.target == k].any() else [])
        for i, part in enumerate(parts):
            nest[k, i] = add(f"nest_{known}_{part}" if known else f"nest_{part}", sd if i < 3 else np.inf, STEP["nest"])
    station = np.full((len(readings.stations), 6), -1)
    for k in np.unique(readings.station):
        label = f"_{readings.stations[k]}" if len(readings.stations) > 1 else ""
        for i, part in enumerate(("x", "y", "z", "u", "v", "w")):
            station[k, i] = add(f"station{label}_{part}", np.inf, STEP["station"])
    return Layout(tuple(names), np.array(prior), np.array(scale), arm, payload, nest, station)


def typical_compliance(robot: Robot) -> Array:
    """Scale (6,) of the joints' compliances, rad/(N m): believed, else that of the stiffest listed joint, else 1e-6."""
    c = believed_compliance(robot)
    known = c[c > 0]
    return np.where(c > 0, c, known.min() if len(known) else 1e-6)


def nominal_state(
    robot: Robot, readings: Readings, payloads: dict[str, Hanging], instrument: Instrument, choice: Choice
) -> State:
    """What is believed before any reading; stations at the origin. Joints outside `choice` are rigid."""
    bends = np.array([float(j in choice.joints) for j in range(1, 7)])
    arm = np.concatenate([robot.mdh.ravel(), bends * believed_compliance(robot)])
    hung = [payloads.get(name, Hanging()) for name in readings.payloads]
    nests = [(instrument.nests or {}).get(name) for name in readings.targets]
    places = [np.zeros(3) if n is None or n.place is None else n.place for n in nests]
    turns = [np.eye(3) if n is None or n.turn is None else n.turn for n in nests]
    return State(
        arm=arm,
        payloads=np.array([[h.mass, *h.com] for h in hung]),
        nests=np.array(places),
        turns=np.array(turns),
        stations=np.tile(np.eye(4), (len(readings.stations), 1, 1)),
    )


def offset_between(layout: Layout, start: State, state: State) -> Array:
    """Offset (p,) from `start` to `state` in the unknowns that are plain numbers; turns and stations begin at zero."""
    offset = np.zeros(layout.size)
    for columns, change in (
        (layout.arm, state.arm - start.arm),
        (layout.payload, state.payloads - start.payloads),
        (layout.nest[:, :3], state.nests - start.nests),
        (layout.links, state.links - start.links),
    ):
        offset[columns[columns >= 0]] = change[columns >= 0]
    return offset


def moved(layout: Layout, state: State, dx: Array) -> State:
    """`state` after a step dx (p,); turns are composed from the left."""

    def part(columns: Array) -> Array:
        return np.where(columns >= 0, dx[columns], 0.0)

    nest, station = part(layout.nest), part(layout.station)
    stations = state.stations.copy()
    stations[:, :3, :3] = Rotation.from_rotvec(station[:, 3:]).as_matrix() @ stations[:, :3, :3]
    stations[:, :3, 3] += station[:, :3]
    return replace(
        state,
        arm=state.arm + part(layout.arm),
        payloads=state.payloads + part(layout.payload),
        nests=state.nests + nest[:, :3],
        turns=state.turns @ Rotation.from_rotvec(nest[:, 3:]).as_matrix(),
        stations=stations,
        links=state.links + part(layout.links),
    )
