"""The job of `ocp.poses` as a function: cell in, chosen poses with their order and what accuracy to expect of them.

Candidate readings are rows of a design; from it follows the error to expect in the grinding zone after fitting the chosen ones.
"""

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
from ocp.poses.program import MeasurementCampaign, MeasuringPose, find_tour
from ocp.shell.progress import Phases
from robots.calibration.layout import Choice, Layout, Priors, State, build_layout, nominal_state
from robots.calibration.noise import Noise
from robots.calibration.observability import carried_point, expected_error, identifiable_basis, sensitivity
from robots.calibration.parameters import BASE_NAMES
from robots.calibration.pose_choice import Pool, choose
from robots.errors import BadInput, Infeasible
from robots.inverse import refuse_other_arm
from robots.kinematics import link_frames
from robots.payload import refuse_overload
from robots.pose import Array, apply, invert, transform_from_xyzabc
from robots.robot import left_out_notices, refuse_left_out
from robots.tracker_readings import Index, Nest, Readings, planned_readings
from trajectories.program.program import Wait

READINGS = 2  # of every pose: approached from either side
LEAST_SHARE = 0.5  # of an equal share is what every payload gets at least: springs show in the difference
MOST_READINGS = 8000  # candidates; more choose no better and take longer
# The criterion "zone" looks at readings in the grinding zone and, with less weight, at this many all over the workspace: a
# calibration that holds at the wheel alone explains nothing, and the next wheel may stand elsewhere.
WORKSPACE, WORKSPACE_WEIGHT = 20, 0.3
COUNTS = (10, 12, 14, 16, 18, 20, 25, 30, 35, 40, 50, 60, 80, 100)
MORE, LITTLE = 10, 0.05  # so many more poses that improve the accuracy by less than this part buy little
PASSES = 2  # of exchanges for a point of the curve


@dataclass(frozen=True)
class Design:
    """m candidate readings: `posture` (m,) indices into the candidates, `target` and `payload` (m,) into the names; the
    pool to choose from; readings and layout they were made with; J (k, 3, p) and own scatter (k,) m of points in the
    grinding zone."""

    readings: Readings
    posture: Index
    pool: Pool
    layout: Layout
    zone_J: Array
    zone_scatter: Array

    def error(self, chosen: Index) -> float:
        """Rms over the zone of one sigma (m, 3D) of the blade's place after a fit to the chosen candidates."""
        return float(np.sqrt((expected_error(self.pool.rows[chosen], self.pool.prior, self.zone_J) ** 2).mean()))

    @property
    def repeatability(self) -> float:
        """Rms over the zone (m, 3D) of what the robot itself scatters, whatever the calibration."""
        return float(np.sqrt((self.zone_scatter**2).mean()))


def build_design(
    setup: TrackerSetup,
    candidates: CandidatePoses,
    zone: Zone,
    targets: list[str],
    payloads: list[str],
    tracker: Array,
    priors: Priors,
    noise: Noise,
    count: int,
    rng: np.random.Generator,
) -> Design:
    """Every seen (posture, nest) with every payload. tracker (3,) m in the base; `count` poses will be chosen."""
    posture, nest = np.nonzero(candidates.seen)
    hung = np.repeat(np.arange(len(payloads)), len(posture))
    posture, nest = np.tile(posture, len(payloads)), np.tile(nest, len(payloads))
    if len(hung) > MOST_READINGS:
        keep = np.sort(rng.choice(len(hung), MOST_READINGS, replace=False))
        posture, nest, hung = posture[keep], nest[keep], hung[keep]
    readings = planned_readings(candidates.q[posture], nest, tuple(targets), hung, tuple(payloads))
    choice = Choice(joints=setup.compliant_joints)
    layout = build_layout(setup.robot, readings, setup.instrument, choice, priors)
    state = nominal_state(setup.robot, readings, setup.payloads, setup.instrument, choice)
    state.stations[:, :3, 3] = -tracker
    seen = sensitivity(setup.robot, readings, setup.instrument, layout, state, noise)
    J, scatter = _zone(setup, zone, layout, state, readings, noise)
    elsewhere = seen.J[rng.choice(len(hung), WORKSPACE)]
    weight = WORKSPACE_WEIGHT * np.sqrt(len(J) / WORKSPACE)
    aim = np.concatenate([J, weight * elsewhere]) / np.sqrt((scatter**2).mean() / 3)
    # Both approaches of a pose count; their noise is independent.
    rows, least = np.sqrt(READINGS) * seen.rows, int(LEAST_SHARE * count / len(payloads))
    return Design(readings, posture, Pool(rows, seen.prior, posture, hung, least, aim), layout, J, scatter)


def _zone(setup: TrackerSetup, zone: Zone, layout: Layout, state: State, like: Readings, noise: Noise) -> tuple[Array, Array]:
    """J (k, 3, p) of points in the zone and their scatter (k,) m from joint noise alone.

    With three nests or more on the flange, not in line, the point is the blade's contact, carried by them; with fewer, the
    nests themselves: where the blade is against fewer than three nests no calibration with them can tell.
    """
    flange = [i for i, name in enumerate(like.targets) if setup.instrument.nests and setup.instrument.nests[name].link == 6]
    chosen = flange or list(range(len(like.targets)))
    grinding = setup.tables.workpiece.payload if setup.tables.workpiece else None
    payload, n = like.payloads.index(grinding) if grinding in like.payloads else 0, len(zone.q)
    seen = []
    for nest in chosen:
        rows = planned_readings(zone.q, np.full(n, nest), like.targets, np.full(n, payload), like.payloads)
        seen.append(sensitivity(setup.robot, rows, setup.instrument, layout, state, noise))
    places = state.nests[chosen]
    flat = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if len(flange) >= 3 and flat[1] > 0.01:
        frames = link_frames(setup.robot, zone.q)[:, 6]
        K = np.stack([carried_point(apply(T, places), apply(T, p)) for T, p in zip(frames, zone.point, strict=True)])
        J = K @ np.concatenate([s.J for s in seen], axis=1)
        joints = K @ np.concatenate([s.d_joints for s in seen], axis=1)
    else:
        J, joints = np.concatenate([s.J for s in seen]), np.concatenate([s.d_joints for s in seen])
    return J, noise.joints * np.linalg.norm(joints, axis=(1, 2))


@dataclass(frozen=True)
class Curve:
    """Poses n (k,) and one sigma (k,) m of the blade's place in the zone: of the calibration alone, and with what the robot
    scatters by itself; `enough`: the least n from which ten more improve the latter by less than 5 %, None if beyond the curve;
    `chosen` the calibration's at the number asked for."""

    count: Array
    calibration: Array
    total: Array
    enough: int | None
    chosen: float
    chosen_total: float


def least_poses(design: Design) -> int:
    """Fewest poses whose coordinates are as many as the directions that readings can tell apart."""
    rank = identifiable_basis(design.pool.rows, design.pool.prior, 1000).shape[1]
    return -(-rank // 3)


def refuse_too_few(design: Design, count: int) -> None:
    """Raises BadInput where `count` poses cannot fix what a calibration looks for."""
    least = least_poses(design)
    if count < least:
        raise BadInput(
            f"-n {count}: {count} poses give {3 * count} coordinates, and robot, springs, nests and tracker have at least "
            f"{3 * least - 2} combinations to be told apart; choose at least {least} poses"
        )


def error_curve(design: Design, count: int, criterion: str, chosen: Index) -> Curve:
    """The curve from the fewest poses to well beyond `count`; its point at `count` is the choice itself."""
    postures = len(np.unique(design.posture))
    counts = [n for n in COUNTS if least_poses(design) <= n <= min(max(2 * count, 40), postures)]
    error = {n: design.error(choose(design.pool, n, criterion, PASSES)) for n in counts if n != count}
    error[count] = design.error(chosen)
    n = np.array(sorted(error))
    calibration = np.array([error[k] for k in n.tolist()])
    total = np.hypot(calibration, design.repeatability)
    at = float(error[count])
    return Curve(n, calibration, total, enough(n, total), at, float(np.hypot(at, design.repeatability)))


def enough(count: Array, total: Array) -> int | None:
    """Least whole n of a curve from which `MORE` poses improve `total` by less than `LITTLE`; between points log-log."""
    for n in range(int(count[0]), int(count[-1]) - MORE + 1):
        now, later = np.exp(np.interp(np.log([n, n + MORE]), np.log(count), np.log(total)))
        if later > (1 - LITTLE) * now:
            return n
    return None


MOST_POSES = 400
FEWEST_SEEN = 3  # times the poses asked for: as many postures must be seen for a choice to be one
GROUPS = 2  # payloads that are hung on if the user names none


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
    refuse_left_out(cell_file, cell.robot, "a program of poses, which is to touch nothing,", ("shape",))
    refuse_other_arm(cell_file, cell.robot, "a choice of poses")
    nests = chosen_targets(setup, options.targets)
    payloads, notices = chosen_payloads(setup, options.payloads)
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
    if calibration is not None and set(BASE_NAMES) <= set(calibration.names):
        values = np.array([calibration.values[calibration.names.index(name)] for name in BASE_NAMES])
        return invert(transform_from_xyzabc(values[:3], values[3:]))[:3, 3], "as in the cell's calibration"
    return None, "assumed, 3.5 m from axis 1 at 1.5 m height where most readings are seen"
