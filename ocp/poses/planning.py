"""The job of `ocp.poses` as a function: cell in, chosen poses with their order and what accuracy to expect of them."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell, read_cell
from ocp.model.measuring_setup import TrackerSetup, read_tracker_setup
from ocp.plan.motion.collision import Scene
from ocp.poses.candidates import Candidates, Mask, choose_stand, free_postures, seen_by
from ocp.poses.checks import chosen_payloads, chosen_targets, stated_tracker
from ocp.poses.curve import Curve, error_curve, refuse_too_few
from ocp.poses.design import Design, build_design
from ocp.poses.line_of_sight import Sight, blade_rod
from ocp.poses.order import Stop, find_tour
from ocp.poses.program import Campaign, Pausing
from ocp.poses.scene import MeasuringScene
from ocp.poses.zone import Zone, find_zone, ground_blade
from ocp.shell.progress import Phases
from robots.calibration.layout import Priors
from robots.calibration.noise import Noise
from robots.calibration.pose_choice import choose
from robots.errors import BadInput, Infeasible
from robots.pose import Array
from robots.tracker_readings import Index

MOST_POSES = 400
FEWEST_SEEN = 3  # times the poses asked for: as many postures must be seen for a choice to be one


@dataclass(frozen=True)
class PoseOptions:
    """What the command line asks for. Angles rad, lengths m, `tracker` (3,) m in the base frame or None."""

    count: int = 40
    criterion: str = "zone"
    payloads: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    tracker: Array | None = None
    seed: int = 0
    name: str = "POSES"
    approach: float = np.radians(2.0)
    pausing: Pausing = field(default_factory=Pausing)
    speed: int = 20
    reach: tuple[float, float] = (1.0, 20.0)
    acceptance: float | None = None
    priors: Priors = field(default_factory=Priors)
    noise: Noise = field(default_factory=Noise)


@dataclass(frozen=True)
class PosePlan:
    """The chosen poses: one campaign a payload in driving order; `chosen` (n,) indices into the design."""

    cell: Cell
    setup: TrackerSetup
    scene: Scene
    options: PoseOptions
    tracker: Array
    tracker_from: str
    candidates: Candidates
    design: Design
    zone: Zone
    chosen: Index
    campaigns: tuple[Campaign, ...]
    curve: Curve
    notices: tuple[str, ...]


def make_poses(cell_file: Path, options: PoseOptions, phases: Phases) -> PosePlan:
    """Choose poses for a cell. Raises BadInput and Infeasible, one sentence each."""
    cell, setup = read_cell(cell_file), read_tracker_setup(cell_file)
    nests = chosen_targets(setup, options.targets)
    payloads, notices = chosen_payloads(setup, options.payloads)
    if not 1 <= options.count <= MOST_POSES:
        raise BadInput(f"-n {options.count}: choose between 1 and {MOST_POSES} poses")
    tracker, tracker_from = stated_tracker(cell, options.tracker)
    rng = np.random.default_rng(options.seed)
    with phases.phase("candidates"):
        blade = ground_blade(cell)
        scene = MeasuringScene(cell, blade.vertices, setup.instrument.nests or {})
        zone = find_zone(cell, scene, blade)
        hanging = [setup.payloads[p] for p in payloads]
        q, sign, near = free_postures(cell, scene, blade, hanging, options.approach, rng)
        sight = Sight(options.reach, options.acceptance, (blade_rod(cell.workpiece.T_flange_blade, blade.vertices),))
        if tracker is None:
            tracker = choose_stand(cell, sight, list(nests.values()), q, rng)
        seen = seen_by(cell, sight, list(nests.values()), tracker, q)
        _refuse_blind(cell, options, tracker, tracker_from, np.asarray(seen.any(axis=1)))
        candidates = Candidates(q, sign, near, seen)
    with phases.phase("design"):
        grinding = cell.tables.workpiece.payload if cell.tables.workpiece else None
        design = build_design(
            setup, candidates, zone, list(nests), payloads, grinding, tracker, options.priors, options.noise, options.count, rng
        )
        refuse_too_few(design, options.count)
    with phases.phase("choice"):
        chosen = choose(design.pool, options.count, options.criterion)
    with phases.phase("curve"):
        curve = error_curve(design, options.count, options.criterion, chosen)
    with phases.phase("order", len(payloads)) as advance:
        campaigns = []
        for k, name in enumerate(payloads):
            mine = chosen[design.payload[chosen] == k]
            if len(mine):
                campaigns.append(_campaign(cell, scene, setup, candidates, design, mine, name, options))
            advance()
    return PosePlan(
        cell, setup, scene, options, tracker, tracker_from, candidates, design, zone, chosen, tuple(campaigns), curve,
        (*blade.notices, *notices),
    )  # fmt: skip


def _campaign(
    cell: Cell, scene: Scene, setup: TrackerSetup, candidates: Candidates, design: Design, mine: Index, payload: str,
    options: PoseOptions,
) -> Campaign:  # fmt: skip
    """The poses of one payload in the order of a short tour."""
    rows = design.posture[mine]
    # What is driven is what is printed: five decimals of a degree.
    q = np.radians(np.round(np.degrees(candidates.q[rows]), 5))
    stops = [Stop(*pose) for pose in zip(q, candidates.sign[rows], strict=True)]
    tour = find_tour(cell.robot, scene, stops, options.approach, options.seed)
    targets = [design.readings.targets[i] for i in design.target[mine]]
    return Campaign(payload, setup.payloads[payload], [stops[i] for i in tour.order], [targets[i] for i in tour.order], tour)


def _refuse_blind(cell: Cell, options: PoseOptions, tracker: Array, source: str, seen: Mask) -> None:
    place = ", ".join(f"{1e3 * v:.0f}" for v in tracker)
    if not seen.any():
        raise BadInput(
            f"--tracker: from ({place}) mm ({source}) no reflector is seen in any of {len(seen)} free postures; it stands in the "
            "robot or the wheel, behind them, or too far off: give another place in mm, base frame"
        )
    if seen.sum() < FEWEST_SEEN * options.count:
        raise Infeasible(
            f"from a tracker at ({place}) mm ({source}) a reflector is seen in {int(seen.sum())} of {len(seen)} free postures, "
            f"too few to choose {options.count} from; give another --tracker, ask for fewer poses, or check [tracker.targets] of "
            f"{cell.path.name}"
        )
