"""Before any data: what a planned measurement could see of every effect, and what it cannot (docs/diagnose.md, eq. 4).

The planned readings make the same linear system as measured ones would. An effect of relative size t (share of the usual upper
end, mean over its coefficients) has the detectability t^2 |M C|^2 / m; it is named nine times of ten above what
`ocp.diagnosis.visible` says, for this many variants and against the background of a good machine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from ocp.diagnosis.evidence import size_grid
from ocp.diagnosis.families import log_odds, positive_of, ratio_of, rival_of
from ocp.diagnosis.findings import Options
from ocp.diagnosis.planned import foreseen
from ocp.diagnosis.projection import project
from ocp.diagnosis.tracker.channel import TrackerChannel
from ocp.diagnosis.tracker.refit import Held, Task, looked
from ocp.diagnosis.visible import needed
from ocp.effects.effect import Effect, Parameter
from ocp.effects.library import library
from ocp.measuring.setup import TrackerSetup, read_tracker_setup
from robots.calibration.layout import Choice, Priors, build_layout, nominal_state
from robots.calibration.noise import Noise
from robots.calibration.solver import Campaign
from robots.errors import BadInput
from robots.kinematics import forward
from robots.measurements import Readings, read_readings
from robots.pose import Array
from robots.robot import Robot

USUAL = Options()
POSES, FULL = 50, 150  # the plan looked at where none is given; the campaign held against it
WARMED = 8.0  # K over the full campaign
DURATION = 3.0 * 3600.0  # s of it
MOST_SCANS = 24  # variants looked at; the median of them is told
TRACKER_AT = np.array([2.5, 2.5, 1.5])  # m in the base frame
NOT = "cannot be seen"
LOW = 0.2  # m above the floor of a flange that can be measured


@dataclass(frozen=True)
class Line:
    """What a plan sees of an effect at a joint: smallest share of the usual upper end that would be named (inf: none), or why
    it is blind."""

    effect: Effect
    joint: int
    smallest: float
    blind: str


def design_text(cell: Path, poses: Path | None) -> str:
    """The table as text. Raises BadInput: cell or poses malformed."""
    setup = read_tracker_setup(cell)
    if poses is None:
        planned, what = default_poses(setup, POSES, full=False), f"{POSES} unidirectional poses with one payload"
    else:
        planned = read_readings(poses, setup.payloads, setup.instrument, sealed=True)
        what = f"the {len(planned)} readings of {poses.name}"
        if len(planned) < 20:
            raise BadInput(f"{poses}: {len(planned)} readings tell nothing of an arm; plan at least 20")
    own = design_lines(setup, planned)
    full = design_lines(setup, default_poses(setup, FULL, full=True))
    return _told(what, own, full)


def design_lines(setup: TrackerSetup, readings: Readings) -> list[Line]:
    """What planned readings see of every effect that moves the arm or the tracker."""
    channel = planned_channel(setup, readings)
    system = channel.system
    projection = project(system.nuisance, system.prior_sd)
    known = [e for e in library().values() if e.on_arm or e.reading is not None]
    kinds = sum(not channel.blind(e) for e in known)
    found = []
    for effect in known:
        blind = channel.blind(effect)
        for joint in effect.places:
            if effect.joints and joint == 0:
                continue  # a delay of all joints is nothing that a reading at rest sees
            seen = np.inf if blind else _smallest(channel, projection.apply, effect, joint, kinds)
            found.append(Line(effect, joint, seen, blind))
    return found


def planned_channel(setup: TrackerSetup, readings: Readings) -> TrackerChannel:
    """The channel that the believed arm would make of planned readings."""
    campaign = Campaign(setup.robot, replace(readings, turn=None, sigma_turn=None), setup.payloads, setup.instrument)
    choice = Choice(joints=tuple(j for j in setup.compliant_joints if setup.robot.stiffness[j - 1] > 0))
    layout = build_layout(setup.robot, campaign.readings, setup.instrument, choice, Priors())
    start = nominal_state(setup.robot, campaign.readings, setup.payloads, setup.instrument, choice)
    stations = start.stations.copy()
    stations[:, :3, 3] = -TRACKER_AT
    start = replace(start, stations=stations)
    task = Task(campaign, layout, start, setup.tables.reference_temperature_C, None)
    linear, extra = looked(task, start, ())
    n = len(readings)
    W = np.broadcast_to(np.eye(3), (n, 3, 3))
    none = np.zeros((layout.size, layout.size))
    fit = Held(start, np.zeros(layout.size), (), linear, extra, W, np.ones(n), Noise(), none)
    return foreseen(TrackerChannel(task, fit), campaign.readings)


def default_poses(setup: TrackerSetup, count: int, full: bool, seed: int = 0) -> Readings:
    """Postures spread over the arm's ranges, flange above the floor. `full`: all payloads, nests and directions, a warm-up;
    else one payload and nest, every axis coming from below, at one temperature."""
    q = _postures(setup.robot, count, seed)
    rng = np.random.default_rng(seed)
    payloads, targets = tuple(setup.payloads) or ("",), tuple(setup.instrument.nests or {}) or ("",)
    n = len(q)
    each = np.arange(n)
    time = np.linspace(0.0, DURATION, n)
    return Readings(
        path=Path("planned"), q=q, point=np.full((n, 3), np.nan),
        target=(each % len(targets) if full else 0 * each).astype(np.int64), targets=targets,
        payload=(each * len(payloads) // n if full else 0 * each).astype(np.int64), payloads=payloads,
        station=np.zeros(n, np.int64), stations=("",), session=np.zeros(n, np.int64), sessions=("",),
        load=np.zeros((n, 6)), load_link=np.full(n, 6, np.int64), load_place=np.zeros((n, 3)),
        approach=rng.choice([-1.0, 1.0], (n, 6)) if full else np.ones((n, 6)),
        time=time if full else None,
        temperature=20.0 + WARMED * (1 - np.exp(-3 * time / DURATION)) if full else None,
        sigma=None, turn=None, sigma_turn=None, line=each.astype(np.int64) + 2,
    )  # fmt: skip


def _postures(robot: Robot, count: int, seed: int) -> Array:
    """Low-discrepancy postures in the middle of the ranges, flange above the floor."""
    width = np.minimum(0.75 * (robot.q_max - robot.q_min), np.radians([180, 140, 200, 340, 230, 340]))
    middle = 0.5 * (robot.q_max + robot.q_min)
    unit = qmc.Halton(6, seed=seed).random(4 * count)
    q = middle + (unit - 0.5) * width
    return q[forward(robot, q)[:, 2, 3] > LOW][:count]


def _smallest(channel: TrackerChannel, project_out: object, effect: Effect, joint: int, kinds: int) -> float:
    """Share of the usual upper end from which the effect is named."""
    scans = list(effect.scan(joint, channel.surroundings))
    if not scans:
        return np.inf
    pick = np.unique(np.linspace(0, len(scans) - 1, min(MOST_SCANS, len(scans))).round().astype(int))
    energies = []
    for variant in channel.variants(effect, joint, [scans[k] for k in pick]):
        columns = project_out(variant.columns * variant.prior_sd)  # type: ignore[operator]
        energies.append(float((columns**2).sum()) / effect.size)
    energy = float(np.median(energies)) if energies else 0.0
    if energy < 1e-9:
        return np.inf
    odds, positive = log_odds(effect, kinds, USUAL), int(positive_of(effect).sum())
    sizes, rival = size_grid(ratio_of(effect, scans)), rival_of(effect, joint, scans)
    return float(np.sqrt(needed(energy, effect.size, sizes, odds, len(scans), positive, rival) / energy))


def _told(what: str, own: Sequence[Line], full: Sequence[Line]) -> str:
    """One line an effect: usual range, smallest size either plan sees and at which joints; then what cannot be seen."""
    rows = [("effect", "usual range", f"{what} see it from", f"{FULL} poses, all payloads, both directions, warm-up: from")]
    for name in dict.fromkeys(line.effect.name for line in own):
        mine, others = ([x for x in lines if x.effect.name == name] for lines in (own, full))
        p = _size_parameter(mine[0].effect)
        rows.append((name, f"{p.key} {p.low:g}..{p.high:g}", _seen(mine, p.high), _seen(others, p.high)))
    widths = [max(*(len(row[k]) for row in rows[1:]), 12) for k in range(4)]
    lines = [*_wrapped_head(rows[0], widths), *(_row(row, widths) for row in rows[1:])]
    hidden = [row[0] for row in rows[1:] if row[2] == NOT]
    if hidden:
        lines.append(f"With {what} {', '.join(hidden)} cannot be seen.")
    reasons = dict.fromkeys(line.blind.split(":")[0] for line in own if line.blind)
    lines += [f"note: {reason.replace('tracker.csv', 'the plan')}" for reason in reasons]
    contact = [e.name for e in library().values() if not (e.on_arm or e.reading is not None)]
    return "\n".join([*lines, f"Only a force log shows {', '.join(contact)}."])


def _size_parameter(effect: Effect) -> Parameter:
    """The key that says how large an effect is."""
    return next(p for p in effect.parameters if p.unit != "name" and p.high > 0 and p.key not in ("order", "phase_rad"))


def _seen(lines: Sequence[Line], high: float) -> str:
    """Smallest sizes over the joints at which a usual size shows, and those joints."""
    seen = [line for line in lines if line.smallest <= 1.0]
    if not seen:
        return NOT
    sizes = sorted(line.smallest * high for line in seen)
    words = f"{sizes[0]:.2g}" if len(sizes) == 1 else f"{sizes[0]:.2g} to {sizes[-1]:.2g}"
    blind = [str(line.joint) for line in lines if line not in seen]
    return f"{words} (not at joint {', '.join(blind)})" if blind else words


def _wrapped_head(head: Sequence[str], widths: Sequence[int]) -> list[str]:
    """The head over as many lines as its cells need."""
    cells = []
    for words, width in zip(head, widths, strict=True):
        lines = [""]
        for word in words.split():
            joined = f"{lines[-1]} {word}".strip()
            if len(joined) <= width:
                lines[-1] = joined
            else:
                lines.append(word)
        cells.append(lines)
    height = max(len(c) for c in cells)
    return [_row([c[k] if k < len(c) else "" for c in cells], widths) for k in range(height)]


def _row(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(f"{cell:<{w}}" for cell, w in zip(cells, widths, strict=True)).rstrip()
