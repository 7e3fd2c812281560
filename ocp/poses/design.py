"""Candidate readings as rows of a design, and the error to expect in the grinding zone after fitting the chosen ones."""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import TrackerSetup
from ocp.poses.candidates import CandidatePoses, Zone
from robots.calibration.layout import Choice, Layout, Priors, State, build_layout, nominal_state
from robots.calibration.noise import Noise
from robots.calibration.observability import carried_point, expected_error, identifiable_basis, sensitivity
from robots.calibration.pose_choice import Pool, choose
from robots.errors import BadInput
from robots.kinematics import link_frames
from robots.pose import Array, apply
from robots.tracker_readings import Index, Readings, planned_readings

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
