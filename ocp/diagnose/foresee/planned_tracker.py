"""Tracker readings that nobody has taken yet: planned measurements, default postures, the channel and the arm they make."""

from dataclasses import dataclass, replace

import numpy as np

from ocp.diagnose.force.prior import posterior_of
from ocp.diagnose.foresee.separation import ProposedMeasurement
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import RANK, Task, TrackerFit, with_weights
from ocp.model.cell import TrackerSetup
from robots.calibration.layout import Choice, Priors, build_layout, nominal_state
from robots.calibration.noise import Noise, reading_covariance, whitener
from robots.calibration.solver import Campaign
from robots.calibration.store import Calibration
from robots.errors import BadInput
from robots.gauss_newton import linear_step
from robots.kinematics import link_frames
from robots.pose import Array
from robots.tracker_readings import Readings, planned_readings

PER_READING, SETTLING = 0.7, 3.0  # minutes: move, settle and measure one reading; to begin
POSTURES, SWEEP = 15, 31  # postures of a check; steps of a sweep
PULL = 300.0  # N; what a person with a load cell and a strap can hold
WARM = 8.0  # K that an hour of fast motion warms an arm by (DIAGNOSIS, catalogue: 5 to 20 K)
WARMED = 8.0  # K over the full campaign
DURATION = 3.0 * 3600.0  # s of it
TRACKER_AT = np.array([2.5, 2.5, 1.5])  # m in the base frame
LOW = 0.2  # m above the floor of a flange that can be measured


@dataclass(frozen=True)
class PlannedReadings(ProposedMeasurement):
    """A measurement with the readings it gives."""

    readings: Readings


def channel_about(channel: TrackerChannel, readings: Readings) -> TrackerChannel:
    """The channel that planned readings would make about the present fit: sensitivities, columns, noise. Its residual is zero:
    nobody has measured."""
    task = replace(channel.task, campaign=replace(channel.task.campaign, readings=readings))
    linear, extra = task.linearised(channel.fit.state, channel.fit.active)
    readings = replace(readings, point=linear.point)
    task = replace(task, campaign=replace(task.campaign, readings=readings))
    W = whitener(reading_covariance(readings, task.campaign.instrument, channel.fit.noise, linear.d_joints))
    linear = replace(linear, residual=np.zeros_like(linear.residual))
    fit = replace(channel.fit, linear=linear, extra=extra, W=W, weight=np.ones(len(readings)))
    return replace(channel, task=task, fit=fit, store={})


def planned_measurements(channel: TrackerChannel, joints: tuple[int, ...]) -> list[PlannedReadings]:
    """Measurements on the arm: payload swap, both directions, warm-up, pull test, sweeps of `joints`, wrist flipped."""
    like = _spread(channel.readings)
    found = [_directions(like), *_swaps(channel, like), _warmed(like), _pulls(like), _flipped(channel, like)]
    return [c for c in (*found, *(_sweep(channel, like, j) for j in joints)) if c is not None]


def _spread(r: Readings) -> Readings:
    """Some of the readings, spread over the arm, with all conditions filled in: those that were never recorded as they are at
    rest."""
    rows = np.unique(np.linspace(0, len(r) - 1, min(POSTURES, len(r))).round().astype(int))
    like = r.take(rows)
    n = len(like)
    last = 0.0 if r.time is None else float(r.time.max())
    return replace(
        like,
        approach=np.where(np.arange(6) % 2 == 0, 1.0, -1.0) * np.ones((n, 1)) if like.approach is None else like.approach,
        time=np.asarray(last + 600.0 + 60.0 * PER_READING * np.arange(n)),
        temperature=np.full(n, 20.0 if like.temperature is None else float(np.median(like.temperature))),
        turn=None,
        sigma_turn=None,
        load=np.zeros((n, 6)),
    )


def before_and_after(readings: Readings) -> Readings:
    """The same few postures at the start of a campaign like the one made, then at its end."""
    like = _spread(readings)
    length = 7200.0 if readings.time is None else max(float(np.ptp(readings.time)), 3600.0)
    return _again_warm(like, np.repeat([0.0, length], len(like)))


def _planned(do: str, readings: Readings, more: float = 0.0) -> PlannedReadings:
    return PlannedReadings(do, SETTLING + more + PER_READING * len(readings), readings)


def _directions(like: Readings) -> PlannedReadings:
    n = len(like)
    both = replace(_twice(like), approach=np.repeat([[1.0], [-1.0]], n, axis=0) * np.ones(6))
    do = f"measure {n} of the postures twice, every axis coming once from below and once from above (approach1..6 = 1, then -1)"
    return _planned(do, both)


def _swaps(channel: TrackerChannel, like: Readings) -> list[PlannedReadings]:
    found = []
    hung = channel.task.campaign.payloads
    for k, name in enumerate(like.payloads):
        if name in hung and name and np.mean(channel.readings.payload == k) < 0.2:
            swapped = replace(like, payload=np.full(len(like), k, np.int64))
            do = f"payload swap: measure {len(like)} of the postures with payload '{name}' ({hung[name].mass:g} kg)"
            found.append(_planned(do, swapped, 10.0))
    return found


def _warmed(like: Readings) -> PlannedReadings:
    assert like.time is not None
    n, later = len(like), _again_warm(like, np.concatenate([like.time, like.time + 4500.0]))
    do = (
        f"warm-up: measure {n} postures cold, let the arm run fast for an hour (about {WARM:.0f} K), measure them again; record "
        "time_s and temperature_C, and three fixed reflectors on the floor before and after"
    )
    return _planned(do, later, 65.0)


def _pulls(like: Readings) -> PlannedReadings:
    n = min(4, len(like))
    pulled = like.take(np.repeat(np.arange(n), 6))
    load = np.zeros((6 * n, 6))
    load[np.arange(6 * n), np.tile([0, 1, 2, 0, 1, 2], n)] = np.tile([PULL, PULL, PULL, -PULL, -PULL, -PULL], n)
    do = (
        f"pull test: in {n} postures pull at the flange with {PULL:.0f} N along +x, +y, +z and back (load cell, strap), read the "
        "reflector each time; fill fx_N, fy_N, fz_N"
    )
    return _planned(do, replace(pulled, load=load, load_place=np.zeros((6 * n, 3))), 15.0)


def _flipped(channel: TrackerChannel, like: Readings) -> PlannedReadings | None:
    robot = channel.task.campaign.robot
    q = like.q.copy()
    q[:, [3, 5]] -= np.where(q[:, [3, 5]] > 0, np.pi, -np.pi)
    q[:, 4] = -q[:, 4]
    inside = np.flatnonzero(((q >= robot.q_min) & (q <= robot.q_max)).all(axis=1))
    if len(inside) < POSTURES // 2:
        return None
    flipped = replace(like, q=q).take(inside)
    do = f"posture flip: measure {len(inside)} of the postures with the wrist flipped (A4, A6 by 180 deg, A5 with the other sign)"
    return _planned(do, flipped)


def _sweep(channel: TrackerChannel, like: Readings, joint: int) -> PlannedReadings:
    robot = channel.task.campaign.robot
    low, high = (float(v[joint - 1]) for v in (channel.readings.q.min(axis=0), channel.readings.q.max(axis=0)))
    low, high = max(low, float(robot.q_min[joint - 1])), min(high, float(robot.q_max[joint - 1]))
    middle = like.take(np.full(2 * SWEEP, len(like) // 2))
    q = middle.q.copy()
    # Uneven steps, so that ripples of many orders do not look alike.
    steps = np.linspace(0.0, 1.0, SWEEP) + 0.35 / SWEEP * np.sin(np.arange(SWEEP) * 2.4)
    q[:, joint - 1] = low + (high - low) * np.clip(np.concatenate([steps, steps[::-1]]), 0.0, 1.0)
    assert middle.approach is not None
    approach = middle.approach.copy()
    approach[:, joint - 1] = np.repeat([1.0, -1.0], SWEEP)
    ends = f"{np.degrees(low):.0f} to {np.degrees(high):.0f} deg"
    do = f"one-axis sweep: only axis {joint} from {ends} and back in {SWEEP} uneven steps, the other axes at rest"
    return _planned(do, replace(middle, q=q, approach=approach))


def _again_warm(like: Readings, time: Array) -> Readings:
    """Readings, and the same on the warm arm, at times (2 n,) s."""
    assert like.temperature is not None
    return replace(_twice(like), time=time, temperature=np.concatenate([like.temperature, like.temperature + WARM]))


def _twice(like: Readings) -> Readings:
    return like.take(np.tile(np.arange(len(like)), 2))


def planned_channel(setup: TrackerSetup, readings: Readings) -> TrackerChannel:
    """The channel that the believed arm would make of planned readings."""
    campaign = Campaign(setup.robot, replace(readings, turn=None, sigma_turn=None), setup.payloads, setup.instrument)
    choice = Choice(joints=tuple(j for j in setup.compliant_joints if setup.robot.stiffness[j - 1] > 0))
    layout = with_weights(build_layout(setup.robot, campaign.readings, setup.instrument, choice, Priors()), campaign)
    start = nominal_state(setup.robot, campaign.readings, setup.payloads, setup.instrument, choice)
    stations = start.stations.copy()
    stations[:, :3, 3] = -TRACKER_AT
    start = replace(start, stations=stations, links=np.zeros(len(layout.links)))
    task = Task(campaign, layout, start, setup.tables.reference_temperature_C, None)
    none = np.zeros((layout.size, layout.size))  # what `channel_about` makes anew
    fit = TrackerFit(start, np.zeros(layout.size), (), *task.linearised(start, ()), none, none, Noise(), none)
    return channel_about(TrackerChannel(task, fit), campaign.readings)


def default_poses(setup: TrackerSetup, count: int, full: bool) -> Readings:
    """Postures spread over the arm's ranges, flange above the floor. `full`: all payloads, nests and directions, a warm-up;
    else one payload and nest, every axis coming from below, at one temperature."""
    q = _postures(setup, count)
    rng = np.random.default_rng(0)
    payloads, targets = tuple(setup.payloads) or ("",), tuple(setup.instrument.nests or {}) or ("",)
    each, time = np.arange(len(q)), np.linspace(0.0, DURATION, len(q))
    if not full:
        return replace(planned_readings(q, 0 * each, targets, 0 * each, payloads), approach=np.ones_like(q))
    new = planned_readings(q, each % len(targets), targets, each * len(payloads) // len(q), payloads)
    warmth = 20.0 + WARMED * (1 - np.exp(-3 * time / DURATION))
    return replace(new, approach=rng.choice([-1.0, 1.0], q.shape), time=time, temperature=warmth)


def _postures(setup: TrackerSetup, count: int) -> Array:
    """Low-discrepancy postures in the middle of the ranges, flange above the base's plane; where the cell has a floor, all
    joints from the third on above that. Raises BadInput: there are none."""
    robot, floor = setup.robot, setup.tables.floor
    width = np.minimum(0.75 * (robot.q_max - robot.q_min), np.radians([180, 140, 200, 340, 230, 340]))
    middle = 0.5 * (robot.q_max + robot.q_min)
    from scipy.stats import qmc  # takes half a second, which a diagnosis that proposes no poses need not pay

    unit = qmc.Halton(6, seed=0).random((4 if floor is None else 40) * count)
    q = middle + (unit - 0.5) * width
    places = link_frames(robot, q)[:, 2:, :3, 3]
    free = places[:, -1, 2] > LOW
    if floor is not None:
        free &= (places @ -robot.gravity_direction).min(axis=1) > 1e-3 * floor.z_mm + LOW
    if floor is not None and not free.any():
        raise BadInput(f"{setup.path}: no posture of the arm stands above floor.z_mm = {floor.z_mm:g}; correct it")
    return q[free][:count]


def arm_expected(channel: TrackerChannel) -> Calibration:
    """The believed arm with the covariance that planned readings leave: prior of a force log that comes with them."""
    task, fit = channel.task, channel.fit
    p = task.layout.size
    known = np.isfinite(task.layout.prior_sd)
    scale = np.where(known, task.layout.prior_sd, task.layout.scale)
    A = (fit.W @ fit.linear.J).reshape(-1, p) * scale
    found = linear_step(np.zeros(len(A)), A, np.zeros(p), known.astype(float), RANK)
    covariance = scale[:, None] * found.covariance * scale
    return posterior_of(task.campaign.robot.name, task.layout, replace(fit, covariance=covariance))
