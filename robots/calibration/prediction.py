"""How sure a prediction of a noise-free reading is: the fit's parameters, and what moves joints without being modelled."""

from dataclasses import replace

import numpy as np

from robots.calibration.fit import Fit, predict_readings
from robots.calibration.residuals import linearise
from robots.measurements import Readings
from robots.pose import Array


def predictive_covariance(fit: Fit, readings: Readings, repeatability: float = 0.0) -> Array:
    """Covariance (n, 3, 3) m^2 of where reflectors will be less where `predict_readings` puts them, tracker's frame.

    The joint noise of the fit is more than the joints' repeatability (rad, from repeats; 0 where nothing was repeated):
    gear errors and the like, which are the same whenever an axis comes back, and so are in a noise-free reading too.
    """
    c = fit.campaign
    seen = replace(readings, turn=None, point=np.nan_to_num(readings.point))
    d_joints = linearise(c.robot, seen, c.instrument, fit.layout, fit.state).d_joints
    unmodelled = fit.spread**2 * max(fit.noise.joints**2 - repeatability**2, 0.0)
    return np.asarray(predict_readings(fit, readings)[1] + unmodelled * d_joints @ np.swapaxes(d_joints, 1, 2))
