"""Blade after blade on a wheel that wears: force logs made by the model itself, with a law in closed form; nothing is solved."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.calibrate.force.fit import BIAS, FIT_NAMES
from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.model import STATE, ForceModel, ForceRows, PlacedRows
from ocp.calibrate.force.rows import ForceSetup
from ocp.model.cell import Cell
from ocp.model.theta import believed_theta
from robots.calibration.store import Calibration
from tests.support.example_pass import LineLaw, bundled_cell

Array = np.ndarray
ROWS, RUNS, STEP = 40, 4, 0.25  # rows of a run, runs of a blade, s between rows
NOISE = 0.3  # N


@dataclass(frozen=True)
class PowerLaw(LineLaw):
    limits: dict = field(default_factory=lambda: {"force": (2.0, 60.0)})
    process_force: float = 20.0


@dataclass(frozen=True)
class WearingCell:
    """Believed cell, the model's rows and the log (without readings) of one blade."""

    cell: Cell
    model: ForceModel
    rows: ForceRows
    log: ForceLog

    @property
    def setup(self) -> ForceSetup:
        return ForceSetup(self.model, (self.rows,), ())

    def ground(self, truth: Array, begin: float, wear: float, rng: np.random.Generator) -> ForceLog:
        """What the sensor reads of a blade from clock `begin` s on; truth: parameters (FIT_NAMES) at that moment, wear m/s."""
        clock = begin + STEP * np.arange(len(self.log))
        x = np.tile(truth[:BIAS], (len(self.log), 1))
        x[:, FIT_NAMES.index("wheel_radius")] -= wear * (clock - begin)
        force = self.model.solve(PlacedRows.of(self.cell, self.rows, x), np.full(len(self.log), 20.0))[0]
        return replace(self.log, fn=force + truth[BIAS] + NOISE * rng.normal(size=len(force)), clock=clock)


def posterior(cell: Cell, sd: float = 2e-5) -> Calibration:
    """A calibration of arm, wheel, blade and flange that left little open."""
    x = believed_theta(cell).values
    names = ("th2", "a2", "wheel_x", "wheel_z", "blade_y", "sensor_bias", "flange_stiffness", "flange_setpoint_offset")
    spread = np.array([sd, sd, sd, sd, sd, 0.05, 50.0, 0.05])
    if cell.flange is None:
        names, spread = names[:-2], spread[:-2]
    values = np.array([x[FIT_NAMES.index(n)] if n != "sensor_bias" else 0.0 for n in names])
    return Calibration(cell.robot.name, names, values, np.diag(spread**2), {"method": "full"})


def wearing_cell(calibration: bool = True, flange: bool = True) -> WearingCell:
    """The bundled cell with a blade whose points are where the axes bring the wheel's surface."""
    cell = bundled_cell() if flange else replace(bundled_cell(), flange=None)
    if calibration:
        cell = replace(cell, calibration=posterior(cell))
    model = ForceModel(replace(cell, calibration=None), PowerLaw())
    n = ROWS * RUNS
    run = np.repeat(np.arange(RUNS), ROWS)
    share = np.tile(np.linspace(-1, 1, ROWS), RUNS)
    q = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0]) + 0.05 * np.outer(share, [0.2, 0.4, -0.3, 0.1, 0.5, 0.2])
    q += 0.1 * (run[:, None] - 1.5) * np.array([0.0, 0.3, -0.3, 0.2, -0.5, 0.3])
    e = Rotation.from_rotvec(np.outer(0.2 * (run - 1.5) + 0.05 * share, cell.wheel.axis)).apply(cell.wheel.contact_direction)
    rows = ForceRows(q, np.zeros((n, 16)), np.full(n, 20.0), np.ones(n), np.ones(n, bool))
    x = believed_theta(cell).values
    T = model.evaluate("state", PlacedRows.of(cell, rows, x), np.full(n, 20.0))[:, STATE["T"]].reshape(n, 4, 4)
    R = T[:, :3, :3].transpose(0, 2, 1)
    belt = np.cross(cell.wheel.axis, e)
    at = cell.wheel.centre + (cell.wheel.radius - 6e-4) * e - T[:, :3, 3]
    p, normal, t = (np.einsum("kij,kj->ki", R, v) for v in (at, -e, -belt))
    bend = np.tile([0.0, 20.0, 0.0, 4e-6, 0.0, 0.0, 0.0], (n, 1))
    rows = replace(rows, waypoint=np.hstack([p, normal, t, bend]))
    still = np.zeros(n, np.int64)
    time = STEP * np.tile(np.arange(ROWS), RUNS)
    log = ForceLog(
        path=Path("force.csv"),
        run=run,
        runs=tuple("abcd"),
        time=time,
        q=q,
        p=p,
        n=normal,
        t=t,
        fn=np.full(n, 20.0),
        contact=np.ones(n, bool),
        session=still,
        sessions=("",),
        row=np.arange(2, n + 2),
    )
    return WearingCell(cell, model, rows, log)
