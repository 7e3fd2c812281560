"""What the force channel refits without calling it an effect, and how well each is believed known.

Registration (wheel, blade) and the arm are open as the cell and the tracker say. Stiffnesses, sensor and friction are
believed: what they are off by is an effect of the catalogue (wheel_stiffness, blade_stiffness, flange_stiffness, sensor_bias,
tangential_force), and a nuisance with the freedom of a calibration would take it away unseen. They keep the small freedom
that the believed values' own making leaves. docs/diagnosis_force.md, "Nuisance or effect".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ocp.calibrate.force.fit import BIAS, FIT_NAMES, force_prior
from ocp.diagnose.rules import SENSOR_BIAS_SD, SHEAR_BIAS_SD, SHEAR_GAIN_SD, STIFFNESS_SD
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.effects.effect import Active
from ocp.model.cell import Cell, read_tracker_setup
from ocp.model.theta import NAMES, covariance_root
from robots.calibration.fit import fit_campaign, learned_priors
from robots.calibration.layout import Choice, Layout, State
from robots.calibration.reading_model import ARM_NAMES
from robots.calibration.solver import Campaign
from robots.calibration.store import Calibration
from robots.pose import Array
from robots.tracker_readings import read_readings

SCALES = ("cover_stiffness_scale", "blade_stiffness_scale")
EXTRA = ("shear_gain", "shear_bias")  # after FIT_NAMES
NUISANCE = (*FIT_NAMES, *EXTRA)
SHEAR_GAIN, SHEAR_BIAS = len(FIT_NAMES), len(FIT_NAMES) + 1


@dataclass(frozen=True)
class NuisancePrior:
    """Prior of the nuisance in the order of NUISANCE: mean (m,), root (m, r): x = mean + root z, z standard normal; joint
    noise rad of the arm beside its parameters."""

    mean: Array
    root: Array
    joint_noise: float

    @property
    def sd(self) -> Array:
        """One sigma (m,) of each."""
        return np.sqrt(np.sum(self.root**2, axis=1))


def contact_prior(cell: Cell, arm: Calibration | None = None) -> NuisancePrior:
    """Prior of the cell, its arm as `arm` says where given."""
    calibration = cell.calibration if arm is None else arm
    prior = force_prior(replace(cell, calibration=calibration))
    known = () if calibration is None else calibration.names
    covariance = prior.covariance.copy()
    small = {name: STIFFNESS_SD for name in SCALES} | {"sensor_bias": SENSOR_BIAS_SD}
    if cell.flange is not None:
        small["flange_stiffness"] = STIFFNESS_SD * cell.flange.stiffness
    for name, sd in small.items():
        i = FIT_NAMES.index(name)
        if name not in known:
            covariance[i, i] = sd**2
    whole = np.zeros((len(NUISANCE), len(NUISANCE)))
    whole[: BIAS + 1, : BIAS + 1] = covariance
    whole[SHEAR_GAIN, SHEAR_GAIN], whole[SHEAR_BIAS, SHEAR_BIAS] = SHEAR_GAIN_SD**2, SHEAR_BIAS_SD**2
    noise = calibration.provenance.get("noise") if calibration is not None else None
    joints = noise.get("joints_rad") if isinstance(noise, dict) else 0.0
    mean = np.concatenate([prior.mean, np.zeros(len(EXTRA))])
    return NuisancePrior(mean, covariance_root(whole), float(joints) if isinstance(joints, int | float) else 0.0)


def arm_from_tracker(tracker: Path, cell_file: Path) -> Calibration:
    """The arm's posterior from tracker readings with the believed springs: prior of the force channel.

    Raises BadInput: malformed readings.
    """
    setup = read_tracker_setup(cell_file)
    readings = read_readings(tracker, setup.payloads, setup.instrument)
    campaign = Campaign(setup.robot, readings, setup.payloads, setup.instrument)
    choice = Choice(joints=tuple(j for j in setup.compliant_joints if setup.robot.stiffness[j - 1] > 0))
    first = fit_campaign(campaign, choice)
    fit = fit_campaign(campaign, choice, learned_priors(first), begin=first.state)
    return posterior_of(setup.robot.name, fit.layout, fit.state, fit.covariance, fit.noise.joints)


def arm_with_effects(tracker: TrackerChannel, active: Sequence[Active]) -> Calibration:
    """The arm's posterior when effects of the arm are in the tracker's prediction: what they explain there, geometry does not."""
    made = tracker.with_active(tuple(a for a in active if a.effect.on_arm))
    p = made.task.layout.size
    name = made.task.campaign.robot.name
    return posterior_of(name, made.task.layout, made.fit.state, made.fit.covariance[:p, :p], made.fit.noise.joints)


def posterior_of(robot: str, layout: Layout, state: State, covariance: Array, joints: float) -> Calibration:
    """Geometry and springs of a tracker fit, with their covariance; joints rad: noise of the joints beside them."""
    inside = [i for i, name in enumerate(ARM_NAMES) if layout.arm[i] >= 0 and name in NAMES]
    columns = layout.arm[inside]
    block = covariance[np.ix_(columns, columns)]
    names = tuple(ARM_NAMES[i] for i in inside)
    return Calibration(robot, names, state.arm[inside], 0.5 * (block + block.T), {"noise": {"joints_rad": float(joints)}}, {})
