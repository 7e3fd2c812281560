"""The readings of a calibration as its report looks at them: in the base frame, along each joint's motion, whitened."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ocp.calibrate.tracker import TrackerCalibration
from robots.calibration.fit import predict_readings
from robots.calibration.noise import reading_covariance, whitener
from robots.calibration.residuals import linearise, residuals
from robots.calibration.student_t import GROSS, NU, consistency
from robots.pose import Array
from robots.tracker_readings import Readings

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ReadingsView:
    """n readings seen from the fitted arm.

    point, residual, before (n, 3) m in the base frame: predicted reflector, measured less predicted of the fitted and of the
    believed arm. along (n, 6) m: the residual along the way on which each joint carries the reflector. whitened (n, 3): over
    the noise model and the spread. weight (n,) in the fit; outlier (n,). stated (n,) m: one sigma (3D) of the
    predicted point from the parameters alone; joint_scatter m: what the joint noise moves the reflector (3D, median).
    """

    readings: Readings
    point: Array
    residual: Array
    before: Array
    along: Array
    whitened: Array
    weight: Array
    outlier: Mask
    stated: Array
    joint_scatter: float

    @property
    def error(self) -> Array:
        """Distance (n,) m of each reading from the fitted arm."""
        return np.asarray(np.linalg.norm(self.residual, axis=1))


def look_at(c: TrackerCalibration) -> ReadingsView:
    """All of it, at the state of the calibration's own method."""
    fit, campaign = c.fit, c.fit.campaign
    readings, robot, instrument = replace(campaign.readings, turn=None), campaign.robot, campaign.instrument
    linear = linearise(robot, readings, instrument, fit.layout, fit.state)
    W = whitener(reading_covariance(readings, instrument, fit.noise, linear.d_joints))
    whitened = (W @ linear.residual[:, :3, None])[..., 0] / fit.spread
    squared = (whitened**2).sum(axis=1)
    a = consistency(3)
    # A fit of differences has weights of pairs, not of readings: they are made anew from the residuals.
    weight = fit.weight if len(fit.weight) == len(readings) else NU * a / (NU * a + squared)
    S = fit.state.stations[readings.station]
    believed = residuals(robot, readings, instrument, c.believed)[:, :3]
    way = np.linalg.norm(linear.d_joints, axis=1)
    along = np.einsum("ni,nij->nj", linear.residual[:, :3], linear.d_joints) / np.maximum(way, 1e-9)
    _, covariance = predict_readings(fit, readings)
    return ReadingsView(
        readings=campaign.readings,
        point=in_base(linear.point - S[:, :3, 3], S),
        residual=in_base(linear.residual[:, :3], S),
        before=in_base(believed, c.believed.stations[readings.station]),
        along=along,
        whitened=whitened,
        weight=weight,
        outlier=weight < GROSS,
        stated=np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0.0)),
        joint_scatter=float(np.median(np.sqrt((way**2).sum(axis=1))) * fit.noise.joints),
    )


def in_base(vectors: Array, stations: Array) -> Array:
    """Vectors (n, 3) of the trackers' frames in the base frame; stations (n, 4, 4) tracker from base."""
    return np.asarray(np.einsum("nji,nj->ni", stations[:, :3, :3], vectors))


def held_out_in_base(c: TrackerCalibration, off: Array) -> Array:
    """Errors (m, 3) m of `c.methods` in the base frame."""
    rows = np.asarray(c.methods.rows, np.int64)
    return in_base(off, c.fit.state.stations[c.fit.campaign.readings.station[rows]])


def present(index: NDArray[np.integer[Any]]) -> list[int]:
    """Values that occur."""
    return [int(k) for k in np.unique(index)]


def named(name: str, kind: str) -> str:
    """A payload, nest, station or session in words; files without the column have one without a name."""
    return name if name else f"the {kind} without a name"


def mm(value: float) -> str:
    """A length m in mm, to 1 um."""
    return f"{1e3 * float(value):.3f}"


def count_of(count: int, what: str) -> str:
    """'1 outlier', '2 outliers'."""
    return f"{count} {what}{'' if count == 1 else 's'}"
