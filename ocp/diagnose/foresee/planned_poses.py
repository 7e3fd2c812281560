"""Tracker readings as they would be before any campaign: default postures, the channel they make, the arm they leave."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ocp.diagnose.force.believed import posterior_of
from ocp.diagnose.foresee.planned import foreseen
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import Held, Task, looked
from ocp.model.measuring_setup import TrackerSetup
from robots.calibration.layout import Choice, Priors, build_layout, nominal_state
from robots.calibration.noise import Noise
from robots.calibration.solver import Campaign
from robots.calibration.store import Calibration
from robots.kinematics import forward
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Readings

WARMED = 8.0  # K over the full campaign
DURATION = 3.0 * 3600.0  # s of it
TRACKER_AT = np.array([2.5, 2.5, 1.5])  # m in the base frame
LOW = 0.2  # m above the floor of a flange that can be measured


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
    from scipy.stats import qmc  # takes half a second, which a diagnosis that proposes no poses need not pay

    unit = qmc.Halton(6, seed=seed).random(4 * count)
    q = middle + (unit - 0.5) * width
    return q[forward(robot, q)[:, 2, 3] > LOW][:count]


def arm_expected(channel: TrackerChannel) -> Calibration:
    """The believed arm with the covariance that planned readings leave: prior of a force log that comes with them."""
    task, fit = channel.task, channel.fit
    p = task.layout.size
    J = (fit.W @ fit.linear.J).reshape(-1, p)
    sd = task.layout.prior_sd
    known = np.isfinite(sd)
    whole = np.vstack([J, np.diag(np.where(known, 1.0 / np.where(known, sd, 1.0), 0.0))])
    size = np.linalg.norm(whole, axis=0)
    _, s, Vt = np.linalg.svd(whole / size, full_matrices=False)
    keep = s > 1e-12 * s[0]
    root = (Vt[keep].T / s[keep]) / size[:, None]
    return posterior_of(task.campaign.robot.name, task.layout, fit.state, root @ root.T, fit.noise.joints)
