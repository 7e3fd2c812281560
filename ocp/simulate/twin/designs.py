"""Conditions of a tracker campaign: postures, payloads, nests, approaches, times and temperatures of every reading."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.arm.arm import Moments, arm_moments, make_arm
from ocp.simulate.twin.truth.truth import draw_truth
from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import Array

AXES = tuple(f"q{i}_deg" for i in range(1, 7))
APPROACH = tuple(f"approach{i}" for i in range(1, 7))
HEAVY = "heavy"  # by convention the payload that only sealed conditions carry
# Box of postures, deg: in front of the robot, wrist turns that spare the cables.
_FRONT, _WRIST = 92.0, 175.0
_MARGIN = np.radians(0.5)  # from the axes' limits
# Where the flange may be, m per metre of the arm's reach: off the column, above the floor.
_COLUMN, _FLOOR = 0.22, 0.06
WARM_UP, WARM_TIME = 9.0, 4000.0  # K that a day's work heats the structure, s to reach 63 % of it
CAMPAIGN, SEALED_AFTER, SEALED_SPAN, SEALED_WARMTH = 10800.0, 500.0, 3700.0, 4.0  # s, s, s, K


@dataclass(frozen=True)
class TrackerCampaign:
    """Readings to take: their conditions, and the nest of each."""

    moments: Moments
    targets: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.targets)


def random_design(
    cell: Cell,
    rng: np.random.Generator,
    n: int = 150,
    repeats: int = 6,
    payloads: Sequence[str] | None = None,
    targets: Sequence[str] | None = None,
    warm_up: float = WARM_UP,
    duration: float = CAMPAIGN,
) -> TrackerCampaign:
    """n readings as campaigns have them: the payloads one after another (three of the cell's, without "heavy"), nests and
    approaches at random, `repeats` of them a second time, while the structure warms up by `warm_up` K.

    Raises BadInput: the cell has no nests, or a payload is unknown.
    """
    hung = _payloads(cell, payloads)
    q = _postures(cell, rng, n)
    approach = rng.choice([-1.0, 1.0], (n, 6))
    blocks = np.sort(np.arange(n) % len(hung))
    label = rng.permutation(len(hung))[blocks]
    names = _targets(cell, targets)
    nest = rng.integers(len(names), size=n)
    for k in rng.choice(np.arange(1, n), min(repeats, n - 1), replace=False) if n > 1 else ():
        before = np.flatnonzero(label[:k] == label[k])
        if len(before):
            first = int(rng.choice(before))
            q[k], approach[k], nest[k] = q[first], approach[first], nest[first]
    time = np.sort(rng.uniform(0, duration, n)).round(1)
    temperature = cell.tables.reference_temperature_C + warm_up * (1 - np.exp(-time / WARM_TIME))
    m = arm_moments(q, tuple(hung[i] for i in label), temperature.round(2), approach, time)
    return TrackerCampaign(m, tuple(names[i] for i in nest))


def sealed_design(
    cell: Cell,
    rng: np.random.Generator,
    n: int = 120,
    payloads: Sequence[str] | None = None,
    targets: Sequence[str] | None = None,
) -> TrackerCampaign:
    """n conditions to predict blind, after the campaign: half with the workpiece's payload, half with one that was not measured
    ("heavy", else the heaviest), at another temperature."""
    known = list(cell.tables.payloads)
    if payloads is None and known:
        mass = [cell.tables.payloads[name].mass_kg for name in known]
        table = cell.tables.workpiece
        own = table.payload if table is not None and table.payload is not None else known[0]
        payloads = list(dict.fromkeys([own, HEAVY if HEAVY in known else known[int(np.argmax(mass))]]))
    hung, names = _payloads(cell, payloads), _targets(cell, targets)
    q = _postures(cell, rng, n)
    label = rng.permutation(len(hung))[np.sort(np.arange(n) % len(hung))]
    start = CAMPAIGN + SEALED_AFTER
    time = np.sort(rng.uniform(start, start + SEALED_SPAN, n)).round(1)
    temperature = cell.tables.reference_temperature_C + SEALED_WARMTH
    m = arm_moments(q, tuple(hung[i] for i in label), round(temperature, 2), rng.choice([-1.0, 1.0], (n, 6)), time)
    return TrackerCampaign(m, tuple(names[i] for i in rng.integers(len(names), size=n)))


def design_from_poses(cell: Cell, path: str | Path, seconds: float = 40.0, warm_up: float = 0.0) -> TrackerCampaign:
    """The readings of a poses.csv (columns q1_deg..q6_deg; target, payload, approach1..6 where known), `seconds` apart.

    Raises BadInput: as `read_csv_table`, a value that the cell does not know.
    """
    table = read_csv_table(path, AXES, ("target", "payload", *APPROACH), words=("target", "payload"))
    n = len(table)
    targets, payloads = _targets(cell, None), list(cell.tables.payloads)
    for column, known in (("target", targets), ("payload", payloads)):
        for row, name in enumerate(table.words.get(column, ())):
            if name not in known:
                raise table.refuse(row, column, f"is not in {cell.path.name} ({', '.join(known) or 'none'})")
    approach = table.stack(APPROACH) if all(c in table.numbers for c in APPROACH) else np.zeros((n, 6))
    time = seconds * np.arange(1, n + 1)
    temperature = cell.tables.reference_temperature_C + warm_up * (1 - np.exp(-time / WARM_TIME))
    hung = tuple(table.words.get("payload", [payloads[0] if payloads else ""] * n))
    m = arm_moments(np.radians(table.stack(AXES)), hung, temperature.round(2), approach, time)
    return TrackerCampaign(m, tuple(table.words.get("target", [targets[0]] * n)))


def _payloads(cell: Cell, asked: Sequence[str] | None) -> list[str]:
    known = list(cell.tables.payloads)
    unknown = [name for name in asked or () if name not in known]
    if unknown:
        raise BadInput(f"{cell.path}: payload '{unknown[0]}' is not among [payloads] ({', '.join(known) or 'none'})")
    return list(asked) if asked else [name for name in known if name != HEAVY][:3] or known[:1] or [""]


def _targets(cell: Cell, asked: Sequence[str] | None) -> list[str]:
    table = cell.tables.tracker
    known = list(table.targets) if table is not None else []
    if not known:
        raise BadInput(f"{cell.path}: the cell has no [tracker.targets]; name at least one reflector nest")
    return list(asked) if asked else known


def _postures(cell: Cell, rng: np.random.Generator, n: int) -> Array:
    """Axes (n, 6) rad in front of the robot with the flange off the column and the floor, rounded as files hold them."""
    robot = cell.robot
    box = np.radians([_FRONT, np.inf, np.inf, _WRIST, np.inf, _WRIST])
    low, high = np.maximum(robot.q_min + _MARGIN, -box), np.minimum(robot.q_max - _MARGIN, box)
    arm = make_arm(cell, draw_truth(cell, 0, mode="believed"))
    reach = float(np.abs(robot.mdh[:, 1:3]).sum())
    found, count = [np.empty((0, 6))], 0
    while count < n:
        q = rng.uniform(low, high, (n + 50, 6))
        links = arm.links(arm_moments(q, "", cell.tables.reference_temperature_C))[:, 4:, :3, 3]
        free = (np.hypot(links[..., 0], links[..., 1]) > _COLUMN * reach) & (links[..., 2] > _FLOOR * reach)
        kept = q[free.all(axis=1)]
        count += len(kept)
        found.append(kept)
    return np.asarray(np.radians(np.degrees(np.concatenate(found)[:n]).round(6)))
