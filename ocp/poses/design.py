"""Candidate readings as rows of a design, and the error to expect in the grinding zone after fitting the chosen ones."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.model.measuring_setup import TrackerSetup
from ocp.poses.candidates import Candidates
from ocp.poses.zone import Zone
from robots.calibration.layout import Choice, Layout, Priors, State, build_layout, nominal_state
from robots.calibration.noise import Noise
from robots.calibration.observability import Sensitivity, carried_point, expected_error, sensitivity
from robots.calibration.pose_choice import Pool
from robots.kinematics import link_frames
from robots.pose import Array, apply
from robots.tracker_readings import Index, Readings

READINGS = 2  # of every pose: approached from either side
LEAST_SHARE = 0.5  # of an equal share is what every payload gets at least: springs show in the difference
MOST_READINGS = 8000  # candidates; more choose no better and take longer
# The criterion "zone" looks at readings in the grinding zone and, with less weight, at this many all over the workspace: a
# calibration that holds at the wheel alone explains nothing, and the next wheel may stand elsewhere.
WORKSPACE, WORKSPACE_WEIGHT = 20, 0.3


@dataclass(frozen=True)
class Design:
    """m candidate readings: `posture` (m,) indices into the candidates, `target` and `payload` (m,) into the names; the
    pool to choose from; readings, layout and state they were made with; J (k, 3, p) and own scatter (k,) m of points in the
    grinding zone."""

    readings: Readings
    posture: Index
    pool: Pool
    layout: Layout
    state: State
    zone_J: Array
    zone_scatter: Array

    @property
    def target(self) -> Index:
        """Which nest, as an index into `readings.targets`."""
        return self.readings.target

    @property
    def payload(self) -> Index:
        """Which payload, as an index into `readings.payloads`."""
        return self.readings.payload

    def error(self, chosen: Index) -> float:
        """Rms over the zone of one sigma (m, 3D) of the blade's place after a fit to the chosen candidates."""
        return float(np.sqrt((expected_error(self.pool.rows[chosen], self.pool.prior, self.zone_J) ** 2).mean()))

    @property
    def repeatability(self) -> float:
        """Rms over the zone (m, 3D) of what the robot itself scatters, whatever the calibration."""
        return float(np.sqrt((self.zone_scatter**2).mean()))


def build_design(
    setup: TrackerSetup, candidates: Candidates, zone: Zone, targets: list[str], payloads: list[str], grinding: str | None,
    tracker: Array, priors: Priors, noise: Noise, count: int, rng: np.random.Generator,
) -> Design:  # fmt: skip
    """Every seen (posture, nest) with every payload. `grinding`: the payload while grinding; tracker (3,) m in the base;
    `count` poses will be chosen."""
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
    J, scatter = _zone(setup, zone, layout, state, readings, grinding, noise)
    elsewhere = seen.J[rng.choice(len(hung), WORKSPACE)]
    weight = WORKSPACE_WEIGHT * np.sqrt(len(J) / WORKSPACE)
    aim = np.concatenate([J, weight * elsewhere]) / np.sqrt((scatter**2).mean() / 3)
    # Both approaches of a pose count; their noise is independent.
    rows, least = np.sqrt(READINGS) * seen.rows, int(LEAST_SHARE * count / len(payloads))
    return Design(readings, posture, Pool(rows, seen.prior, posture, hung, least, aim), layout, state, J, scatter)


def planned_readings(q: Array, target: Index, targets: tuple[str, ...], payload: Index, payloads: tuple[str, ...]) -> Readings:
    """Readings (n,) that are yet to be taken: joints q (n, 6) rad, indices of nests and payloads; one station."""
    n = len(q)
    zero = np.zeros(n, np.int64)
    return Readings(
        path=Path("poses.csv"), q=q, point=np.full((n, 3), np.nan), target=target, targets=targets, payload=payload,
        payloads=payloads, station=zero, stations=("",), session=zero, sessions=("",), load=np.zeros((n, 6)),
        load_link=np.full(n, 6), load_place=np.zeros((n, 3)), approach=None, time=None, temperature=None, sigma=None,
        turn=None, sigma_turn=None, line=np.arange(n) + 2,
    )  # fmt: skip


def _zone(
    setup: TrackerSetup, zone: Zone, layout: Layout, state: State, like: Readings, grinding: str | None, noise: Noise
) -> tuple[Array, Array]:
    """J (k, 3, p) of points in the zone and their scatter (k,) m from joint noise alone.

    With three nests or more on the flange, not in line, the point is the blade's contact, carried by them; with fewer, the
    nests themselves: where the blade is against fewer than three nests no calibration with them can tell.
    """
    flange = [i for i, name in enumerate(like.targets) if setup.instrument.nests and setup.instrument.nests[name].link == 6]
    chosen = flange or list(range(len(like.targets)))
    payload = like.payloads.index(grinding) if grinding in like.payloads else 0
    seen = [_nest_in_zone(setup, zone, layout, state, like, i, payload, noise) for i in chosen]
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


def _nest_in_zone(
    setup: TrackerSetup, zone: Zone, layout: Layout, state: State, like: Readings, nest: int, payload: int, noise: Noise
) -> Sensitivity:
    n = len(zone.q)
    rows = planned_readings(zone.q, np.full(n, nest), like.targets, np.full(n, payload), like.payloads)
    return sensitivity(setup.robot, rows, setup.instrument, layout, state, noise)
