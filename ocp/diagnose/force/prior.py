"""What is believed before a log is fitted: nuisance with its prior, the arm, and setpoints that were changed and not written
down.

Registration (wheel, blade) and the arm are open as the cell and the tracker say: the force channel refits them without
calling it an effect. Stiffnesses, sensor and friction are believed: what they are off by is an effect of the catalogue
(wheel_stiffness, blade_stiffness, flange_stiffness, sensor_bias, tangential_force), and a nuisance with the freedom of a
calibration would take it away unseen. They keep the small freedom that the believed values' own making leaves.
docs/diagnosis_force.md, "Nuisance or effect".

Without a column setpoint_N the cell's setpoint stands for every row. Where a run presses by a fifth more or less than another
over the same points of the blade, that is rather an operator's force ladder than an error of the cell. Such a run's setpoint
is read off its readings and open in the fit, so an error that is one force over the whole run is not seen there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ocp.calibrate.force.fit import BIAS, FIT_NAMES, force_prior
from ocp.calibrate.force.log import AIR_SHARE, ForceLog
from ocp.calibrate.tracker import as_calibration
from ocp.diagnose import rules
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import TrackerFit
from ocp.effects.effect import Active
from ocp.model.cell import Cell
from ocp.model.theta import covariance_root
from robots.calibration.carried import carried_over
from robots.calibration.fit import Fit
from robots.calibration.layout import Layout
from robots.calibration.store import BENDING, Calibration
from robots.pose import Array, Mask

SCALES = ("cover_stiffness_scale", "blade_stiffness_scale")
EXTRA = ("shear_gain", "shear_bias")  # after FIT_NAMES
NUISANCE = (*FIT_NAMES, *EXTRA)
SHEAR_GAIN, SHEAR_BIAS = len(FIT_NAMES), len(FIT_NAMES) + 1


@dataclass(frozen=True)
class NuisancePrior:
    """Prior of the nuisance in the order of NUISANCE: mean (m,), root (m, r): x = mean + root z, z standard normal; joint
    noise rad of the arm beside its parameters, None where no calibration tells it."""

    mean: Array
    root: Array
    joint_noise: float | None


def contact_prior(cell: Cell, arm: Calibration | None = None) -> NuisancePrior:
    """Prior of the cell, its arm as `arm` says where given: what the cell's calibration knows besides goes with it."""
    calibration = cell.calibration if arm is None else carried_over(arm, cell.calibration)
    prior = force_prior(replace(cell, calibration=calibration))
    known = () if calibration is None else calibration.names
    covariance = prior.covariance.copy()
    small = {name: rules.STIFFNESS_SD for name in SCALES} | {"sensor_bias": rules.SENSOR_BIAS_SD}
    if cell.flange is not None:
        small["flange_stiffness"] = rules.STIFFNESS_SD * cell.flange.stiffness
    for name, sd in small.items():
        i = FIT_NAMES.index(name)
        covariance[i, i] = sd**2 + (covariance[i, i] if name in known else 0.0)
    whole = np.zeros((len(NUISANCE), len(NUISANCE)))
    whole[: BIAS + 1, : BIAS + 1] = covariance
    whole[SHEAR_GAIN, SHEAR_GAIN], whole[SHEAR_BIAS, SHEAR_BIAS] = rules.SHEAR_GAIN_SD**2, rules.SHEAR_BIAS_SD**2
    noise = None if calibration is None else calibration.joint_noise
    return NuisancePrior(np.concatenate([prior.mean, np.zeros(len(EXTRA))]), covariance_root(whole), noise)


def arm_with_effects(tracker: TrackerChannel, active: Sequence[Active]) -> Calibration:
    """The arm's posterior when effects of the arm are in the tracker's prediction: what they explain there, geometry does not.
    What the cell's calibration knows besides goes with it."""
    made = tracker.with_active(tuple(a for a in active if a.effect.on_arm))
    found = posterior_of(made.task.campaign.robot.name, made.task.layout, made.fit)
    return carried_over(found, tracker.known, made.one_arm)


def posterior_of(
    robot: str, layout: Layout, fit: Fit | TrackerFit, station: int | None = None, told: Mapping[str, Any] | None = None
) -> Calibration:
    """Geometry and springs of a tracker fit, and the base in a station's frame (None: without), with their covariance. It says
    which joints bent, the noise of the joints, and what else is `told`."""
    provenance = {**(told or {}), "noise": {"joints_rad": float(fit.noise.joints)}, BENDING: layout.bending}
    return as_calibration(robot, layout, fit.state, fit.covariance, station, provenance=provenance)


def with_setpoints_read_off(log: ForceLog, own: float) -> tuple[ForceLog, str] | None:
    """The log with its runs' setpoints where the readings say that some were changed, and a sentence about it; own N: the cell's
    setpoint. None: the log tells them, or nothing speaks against one for all."""
    if log.setpoint is not None or not own > 0:
        return None
    touching = {int(r): (log.run == r) & log.contact for r in np.unique(log.run)}
    told = {r: float(np.median(log.fn[rows])) for r, rows in touching.items() if np.count_nonzero(rows) >= rules.SETPOINT_ROWS}
    force = {r: one for r, one in told.items() if one > AIR_SHARE * own}  # what hardly touches has no setpoint
    changed: dict[int, float] = {}
    for group in _over_the_same_points(log, {r: touching[r] for r in force}):
        # Most runs of a log are at the cell's setpoint, whatever the cell makes of it.
        usual = _usual([force[r] for r in group], _usual(list(force.values()), own))
        changed |= {r: own + force[r] - usual for r in group if abs(force[r] - usual) > rules.SETPOINT_CHANGED * usual}
    if not changed:
        return None
    setpoint, sd = np.full(len(log), own), np.zeros(len(log))
    for r, value in changed.items():
        setpoint[log.run == r], sd[log.run == r] = max(value, 0.0), rules.SETPOINT_SD * own
    return replace(log, setpoint=setpoint, setpoint_sd=sd), _sentence(log, changed, own)


def _usual(forces: list[float], likely: float) -> float:
    """The one of some forces N that most of them are like, of several such the one nearest to `likely`."""
    return max(forces, key=lambda u: (sum(abs(f - u) <= rules.SETPOINT_ALIKE * u for f in forces), -abs(u - likely)))


def _sentence(log: ForceLog, changed: dict[int, float], own: float) -> str:
    runs = ", ".join(f"{log.runs[r]} ({value:.0f} N)" for r, value in changed.items())
    return (
        f"{log.path.name}: no column setpoint_N, and other forces than over the same points at the cell's {own:g} N: run {runs}; "
        "taken for setpoints that were changed, what is off by one force over such a run cannot be seen; add the column"
    )


def _over_the_same_points(log: ForceLog, pressed: dict[int, Mask]) -> list[list[int]]:
    """Runs of one session whose contact points have the same middle, on the same side of the blade."""
    groups: list[tuple[Array, Array, int, list[int]]] = []
    for r, rows in pressed.items():
        p, n, session = log.p[rows].mean(axis=0), log.n[rows].mean(axis=0), int(log.session[np.argmax(rows)])
        for middle, normal, at, members in groups:
            if at == session and np.linalg.norm(p - middle) < rules.SAME_POINTS and n @ normal > 0:
                members.append(r)
                break
        else:
            groups.append((p, n, session, [r]))
    return [members for *_, members in groups]
