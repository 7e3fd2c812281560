"""The job of `ocp.poses` as a function: cell in, chosen poses with their order and what accuracy to expect of them."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell, TrackerSetup, floor_notices, read_cell, read_tracker_setup
from ocp.plan.clearance import CollisionScene
from ocp.poses.candidates import (
    CandidatePoses,
    Mask,
    MeasuringScene,
    Sight,
    Zone,
    blade_rod,
    choose_stand,
    find_zone,
    free_postures,
    ground_blade,
    visible_nests,
)
from ocp.poses.design import Curve, Design, build_design, error_curve, refuse_too_few
from ocp.poses.program import MeasurementCampaign, MeasuringPose, find_tour
from ocp.shell.progress import Phases
from robots.calibration.layout import Priors
from robots.calibration.noise import Noise
from robots.calibration.pose_choice import choose
from robots.errors import BadInput, Infeasible
from robots.payload import refuse_overload
from robots.pose import Array, invert, transform_from_xyzabc
from robots.robot import left_out_notices
from robots.tracker_readings import Index, Nest
from trajectories.program.program import Wait

MOST_POSES = 400
FEWEST_SEEN = 3  # times the poses asked for: as many postures must be seen for a choice to be one
GROUPS = 2  # payloads that are hung on if the user names none
BASE = ("base_x", "base_y", "base_z", "base_a", "base_b", "base_c")


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
    pausing: Wait = field(default_factory=Wait)
    speed: int = 20
    acceptance: float | None = None
    priors: Priors = field(default_factory=Priors)
    noise: Noise = field(default_factory=Noise)


@dataclass(frozen=True)
class PosePlan:
    """The chosen poses: one campaign a payload in driving order; `chosen` (n,) indices into the design."""

    cell: Cell
    setup: TrackerSetup
    scene: CollisionScene
    options: PoseOptions
    tracker: Array
    tracker_from: str
    candidates: CandidatePoses
    design: Design
    zone: Zone
    chosen: Index
    campaigns: tuple[MeasurementCampaign, ...]
    curve: Curve
    notices: tuple[str, ...]


def make_poses(cell_file: Path, options: PoseOptions, phases: Phases) -> PosePlan:
    """Choose poses for a cell. Raises BadInput and Infeasible, one sentence each."""
    cell, setup = read_cell(cell_file), read_tracker_setup(cell_file)
    nests = chosen_targets(setup, options.targets)
    payloads, notices = chosen_payloads(setup, options.payloads)
    if not 1 <= options.count <= MOST_POSES:
        raise BadInput(f"-n {options.count}: choose between 1 and {MOST_POSES} poses")
    notices += refuse_overload(str(cell_file), cell.robot, {name: setup.payloads[name] for name in payloads})
    notices += floor_notices(cell) + left_out_notices(cell.robot)
    tracker, tracker_from = stated_tracker(cell, options.tracker)
    rng = np.random.default_rng(options.seed)
    with phases.phase("candidates"):
        blade = ground_blade(cell)
        scene = MeasuringScene(cell, blade.vertices, setup.instrument.nests or {})
        zone = find_zone(cell, scene, blade)
        hanging = [setup.payloads[p] for p in payloads]
        q, sign, near = free_postures(cell, scene, blade, hanging, options.approach, rng)
        sight = Sight(acceptance=options.acceptance, rods=(blade_rod(cell.workpiece.T_flange_blade, blade.vertices),))
        if tracker is None:
            tracker = choose_stand(cell, sight, list(nests.values()), q, rng)
        seen = visible_nests(cell, sight, list(nests.values()), tracker, q)
        _refuse_blind(cell, options, tracker, tracker_from, np.asarray(seen.any(axis=1)))
        candidates = CandidatePoses(q, sign, near, seen)
    with phases.phase("design"):
        design = build_design(
            setup, candidates, zone, list(nests), payloads, tracker, options.priors, options.noise, options.count, rng
        )
        refuse_too_few(design, options.count)
    with phases.phase("choice"):
        chosen = choose(design.pool, options.count, options.criterion)
    with phases.phase("curve"):
        curve = error_curve(design, options.count, options.criterion, chosen)
    with phases.phase("order", len(payloads)) as advance:
        campaigns = []
        for k, name in enumerate(payloads):
            mine = chosen[design.readings.payload[chosen] == k]
            if len(mine):
                rows = design.posture[mine]
                # What is driven is what is printed: five decimals of a degree.
                q = np.radians(np.round(np.degrees(candidates.q[rows]), 5))
                stops = [MeasuringPose(*pose) for pose in zip(q, candidates.sign[rows], strict=True)]
                tour = find_tour(cell.robot, scene, stops, options.approach, options.seed)
                targets = [design.readings.targets[i] for i in design.readings.target[mine[tour.order]]]
                driven = [stops[i] for i in tour.order]
                campaigns.append(MeasurementCampaign(name, setup.payloads[name], driven, targets, tour))
            advance()
    told = (*blade.notices, *notices)
    return PosePlan(
        cell, setup, scene, options, tracker, tracker_from, candidates, design, zone, chosen, tuple(campaigns), curve, told
    )


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


def chosen_targets(setup: TrackerSetup, names: tuple[str, ...]) -> dict[str, Nest]:
    """The nests to be read, all of the cell unless `names` says which. Raises BadInput: none, or an unknown one."""
    nests = setup.instrument.nests or {}
    file = setup.path.name
    if not nests:
        raise BadInput(f"{file}: table [tracker.targets] is missing or empty; say where the nests are, T1 = [x, y, z] in mm")
    for name in names:
        if name not in nests:
            raise BadInput(f"--targets {name} is not in [tracker.targets] of {file} ({', '.join(nests)})")
    return {name: nests[name] for name in nests if name in names or not names}


def chosen_payloads(setup: TrackerSetup, names: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Payloads in the order of mounting, the lightest first, and notices.

    Unless `names` says which: that of the workpiece and the one whose mass is farthest from it. Raises BadInput: none, or an
    unknown one.
    """
    known, file = setup.payloads, setup.path.name
    if not known:
        raise BadInput(f"{file}: table [payloads] is missing; add what hangs on the flange as [payloads.NAME]")
    for name in names:
        if name not in known:
            raise BadInput(f"--payload {name} is not in [payloads] of {file} ({', '.join(known)})")
    chosen = list(dict.fromkeys(names))
    if not chosen:
        mounted = setup.tables.workpiece.payload if setup.tables.workpiece else None
        first = mounted or next(iter(known))
        others = sorted((n for n in known if n != first), key=lambda n: -abs(known[n].mass - known[first].mass))
        chosen = [first, *others[: GROUPS - 1]]
    notices = []
    if np.ptp([known[name].mass for name in chosen]) < 1.0:
        notices.append(
            "all readings carry the same mass: springs show only in how the weight pulls from posture to posture; give a second "
            "payload, or none at all as [payloads.bare] with mass_kg = 0, to tell them apart from the geometry"
        )
    return sorted(chosen, key=lambda n: known[n].mass), notices


def stated_tracker(cell: Cell, given: Array | None) -> tuple[Array | None, str]:
    """The tracker head (3,) m in the base frame from the command line, else from the cell's calibration, else None; and which."""
    if given is not None:
        if not np.isfinite(given).all() or np.abs(given).max() > 100.0:
            raise BadInput("--tracker must be x,y,z in mm in the base frame, at most 100 m away")
        return given, "from --tracker"
    calibration = cell.calibration
    if calibration is not None and set(BASE) <= set(calibration.names):
        values = np.array([calibration.values[calibration.names.index(name)] for name in BASE])
        return invert(transform_from_xyzabc(values[:3], values[3:]))[:3, 3], "as in the cell's calibration"
    return None, "assumed, 3.5 m from axis 1 at 1.5 m height where most readings are seen"
