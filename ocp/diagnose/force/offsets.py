"""What recordings add to both readings beyond the model: an offset of each run, and setpoints that were read off it."""

from dataclasses import dataclass, field

import numpy as np

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.offsets import offset_columns
from ocp.diagnose.force.prior import RUN_SD
from robots.pose import Array


@dataclass(frozen=True)
class Offsets:
    """Columns (n, o) N of the normal and of the tangential reading per standard normal unknown; the first `runs` are single
    runs' own offsets, which no other run shares; behind them what setpoints are off by that the readings gave."""

    normal: Array = field(repr=False)
    shear: Array = field(repr=False)
    runs: int

    @staticmethod
    def of(log: ForceLog, friction: Array) -> "Offsets":
        """Of a log; friction (n,): tangential force per newton of the normal one."""
        runs = offset_columns(log.run, log.contact)
        open_rows = log.contact if log.setpoint_sd is None else log.contact & (log.setpoint_sd > 0)
        levels = np.zeros((len(log), 0))
        if log.setpoint_sd is not None:
            levels = log.setpoint_sd[:, None] * offset_columns(log.run, open_rows)
        return Offsets(
            np.hstack([RUN_SD * runs, levels]), np.hstack([np.zeros_like(runs), friction[:, None] * levels]), runs.shape[1]
        )

    @property
    def count(self) -> int:
        """Unknowns."""
        return self.normal.shape[1]

    def none(self, rows: int) -> "Offsets":
        """Of other rows, which share none of them."""
        return Offsets(np.zeros((rows, 0)), np.zeros((rows, 0)), 0)
