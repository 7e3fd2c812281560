"""Tracker readings that nobody has taken yet: candidate measurements, and the channel they would make."""

from dataclasses import dataclass, replace

import numpy as np

from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import looked
from robots.calibration.noise import reading_covariance, whitener
from robots.pose import Array
from robots.tracker_readings import Readings

PER_READING, SETTLING = 0.7, 3.0  # minutes: move, settle and measure one reading; to begin
POSTURES, SWEEP = 15, 31  # postures of a check; steps of a sweep
PULL = 300.0  # N; what a person with a load cell and a strap can hold
WARM = 8.0  # K that an hour of fast motion warms an arm by (DIAGNOSIS, catalogue: 5 to 20 K)


@dataclass(frozen=True)
class Candidate:
    """A measurement that could be made: what to do, minutes, the readings it gives."""

    do: str
    minutes: float
    readings: Readings


def foreseen(channel: TrackerChannel, readings: Readings) -> TrackerChannel:
    """The channel that planned readings would make about the present fit: sensitivities, columns, noise. Its residual is zero:
    nobody has measured."""
    task = replace(channel.task, campaign=replace(channel.task.campaign, readings=readings))
    linear, extra = looked(task, channel.fit.state, channel.fit.active)
    readings = replace(readings, point=linear.point)
    task = replace(task, campaign=replace(task.campaign, readings=readings))
    W = whitener(reading_covariance(readings, task.campaign.instrument, channel.fit.noise, linear.d_joints))
    linear = replace(linear, residual=np.zeros_like(linear.residual))
    fit = replace(channel.fit, linear=linear, extra=extra, W=W, weight=np.ones(len(readings)))
    return replace(channel, task=task, fit=fit, store={})


def candidates(channel: TrackerChannel, joints: tuple[int, ...]) -> list[Candidate]:
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
        turn=None, sigma_turn=None, load=np.zeros((n, 6)),
    )  # fmt: skip


def before_and_after(readings: Readings) -> Readings:
    """The same few postures at the start of a campaign like the one made, then at its end."""
    like = _spread(readings)
    assert like.time is not None and like.temperature is not None
    n = len(like)
    length = 7200.0 if readings.time is None else max(float(np.ptp(readings.time)), 3600.0)
    both = replace(_twice(like), time=np.repeat([0.0, length], n))
    return replace(both, temperature=np.concatenate([like.temperature, like.temperature + WARM]))


def _minutes(n: int, more: float = 0.0) -> float:
    return SETTLING + more + PER_READING * n


def _directions(like: Readings) -> Candidate:
    both = _twice(like)
    n = len(like)
    both = replace(both, approach=np.repeat([[1.0], [-1.0]], n, axis=0) * np.ones(6))
    do = f"measure {n} of the postures twice, every axis coming once from below and once from above (approach1..6 = 1, then -1)"
    return Candidate(do, _minutes(2 * n), both)


def _swaps(channel: TrackerChannel, like: Readings) -> list[Candidate]:
    found = []
    hung = channel.task.campaign.payloads
    for k, name in enumerate(like.payloads):
        if name not in hung or not name:
            continue
        share = float(np.mean(channel.readings.payload == k))
        if share < 0.2:
            swapped = replace(like, payload=np.full(len(like), k, np.int64))
            do = f"payload swap: measure {len(like)} of the postures with payload '{name}' ({hung[name].mass:g} kg)"
            found.append(Candidate(do, _minutes(len(like), 10.0), swapped))
    return found


def _warmed(like: Readings) -> Candidate:
    assert like.temperature is not None and like.time is not None
    n = len(like)
    later = replace(_twice(like), temperature=np.concatenate([like.temperature, like.temperature + WARM]))
    later = replace(later, time=np.concatenate([like.time, like.time + 4500.0]))
    do = (
        f"warm-up: measure {n} postures cold, let the arm run fast for an hour (about {WARM:.0f} K), measure them again; record "
        "time_s and temperature_C, and three fixed reflectors on the floor before and after"
    )
    return Candidate(do, _minutes(2 * n, 65.0), later)


def _pulls(like: Readings) -> Candidate:
    n = min(4, len(like))
    pulled = like.take(np.repeat(np.arange(n), 6))
    load = np.zeros((6 * n, 6))
    load[np.arange(6 * n), np.tile([0, 1, 2, 0, 1, 2], n)] = np.tile([PULL, PULL, PULL, -PULL, -PULL, -PULL], n)
    do = (
        f"pull test: in {n} postures pull at the flange with {PULL:.0f} N along +x, +y, +z and back (load cell, strap), read the "
        "reflector each time; fill fx_N, fy_N, fz_N"
    )
    return Candidate(do, _minutes(6 * n, 15.0), replace(pulled, load=load, load_place=np.zeros((6 * n, 3))))


def _flipped(channel: TrackerChannel, like: Readings) -> Candidate | None:
    robot = channel.task.campaign.robot
    q = like.q.copy()
    q[:, 3] = np.where(q[:, 3] > 0, q[:, 3] - np.pi, q[:, 3] + np.pi)
    q[:, 4] = -q[:, 4]
    q[:, 5] = np.where(q[:, 5] > 0, q[:, 5] - np.pi, q[:, 5] + np.pi)
    inside = np.flatnonzero(((q >= robot.q_min) & (q <= robot.q_max)).all(axis=1))
    if len(inside) < POSTURES // 2:
        return None
    flipped = replace(like, q=q).take(inside)
    do = f"posture flip: measure {len(inside)} of the postures with the wrist flipped (A4, A6 by 180 deg, A5 with the other sign)"
    return Candidate(do, _minutes(len(inside)), flipped)


def _sweep(channel: TrackerChannel, like: Readings, joint: int) -> Candidate:
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
    return Candidate(do, _minutes(2 * SWEEP), replace(middle, q=q, approach=approach))


def _twice(like: Readings) -> Readings:
    return like.take(np.tile(np.arange(len(like)), 2))


def rows_of(channel: TrackerChannel) -> tuple[Array, Array]:
    """Whitened nuisance (N, p) over its priors' sd (free ones as they are) and which of it is free (p,)."""
    system = channel.system
    free = ~np.isfinite(system.prior_sd)
    return system.nuisance * np.where(free, 1.0, system.prior_sd), free
