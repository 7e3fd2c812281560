"""The virtual cell that is exactly what is believed: calibration folded in, no hidden errors, noise alone.

Names of the parameters are the product's list (robots/calibration/parameters.py); it is written out here a second time
because the virtual cell shares nothing with the model.
"""

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.truth.machine import SENSOR_SIGMA, Truth, believed_payloads
from ocp.simulate.twin.truth.planting import Planted
from robots.errors import BadInput
from robots.pose import Array

_MDH = ("th", "d", "a", "al", "be")


def believed_truth(
    cell: Cell,
    seed: int,
    effects: tuple[Planted, ...],
    sample: np.random.Generator | None,
    T_tracker_base: Array,
    nests: dict[str, Array],
    nest_turns: dict[str, Array],
) -> Truth:
    """The cell with its calibration's values, moved by one sample of the covariance where `sample` is given.

    Only the cell's compliant joints bend under weight, as the planner has it; under contact all listed springs give.
    Raises BadInput: a sample is asked of a cell without calibration.
    """
    known = _values(cell, sample)
    robot, flange, axis = cell.robot, cell.flange, cell.wheel.axis
    mdh = np.array([[known.get(f"{s}{i + 1}", robot.mdh[i, k]) for k, s in enumerate(_MDH)] for i in range(6)])
    own = np.divide(1.0, robot.stiffness, out=np.zeros(6), where=robot.stiffness > 0)
    compliance = np.maximum([known.get(f"c{i + 1}", own[i]) for i in range(6)], 0.0)
    u, v = _across(axis)
    stiffness = flange.stiffness if flange is not None else 1.0
    return Truth(
        seed=seed,
        mdh=mdh,
        placement=np.zeros((6, 6)),
        stiffness=np.divide(1.0, compliance, out=np.zeros(6), where=compliance > 0),
        bends=np.array([float(j in cell.compliant_joints) for j in range(1, 7)]),
        mass_scale=np.ones(7),
        payloads=_payloads(cell, known),
        ripple=np.zeros((6, 3)),
        play=np.zeros(6),
        repeatability=0.0,
        T_tracker_base=T_tracker_base,
        nests=nests,
        nest_turns=nest_turns,
        wheel_shift=_vector(known, "wheel_x", "wheel_y", "wheel_z"),
        wheel_axis_turn=known.get("wheel_axis_u", 0.0) * u + known.get("wheel_axis_v", 0.0) * v,
        blade_shift=_vector(known, "blade_x", "blade_y", "blade_z"),
        blade_turn=_vector(known, "blade_c", "blade_b", "blade_a"),
        cover_scale=1 + known.get("cover_stiffness_scale", 0.0),
        blade_scale=1 + known.get("blade_stiffness_scale", 0.0),
        flange_scale=known.get("flange_stiffness", stiffness) / stiffness,
        flange_offset=known.get("flange_setpoint_offset", 0.0),
        sensor_bias=known.get("sensor_bias", 0.0),
        sensor_sigma=SENSOR_SIGMA,
        outliers=0.0,
        effects=effects,
    )


def _values(cell: Cell, sample: np.random.Generator | None) -> dict[str, float]:
    """The calibration's values by name, sampled where asked."""
    calibration = cell.calibration
    if calibration is None:
        if sample is not None:
            raise BadInput(f"{cell.path}: the cell has no calibration to draw a sample from; name one in [robot].calibration")
        return {}
    values = np.asarray(calibration.values, float)
    if sample is not None:
        # Scaled to a correlation matrix first: lengths and compliances differ by orders of magnitude.
        sd = np.maximum(calibration.standard_deviation, 1e-300)
        w, V = np.linalg.eigh(calibration.covariance / np.outer(sd, sd))
        values = values + sd * (V @ (np.sqrt(np.maximum(w, 0.0)) * sample.normal(size=len(values))))
    return {name: float(value) for name, value in zip(calibration.names, values, strict=True)}


def _vector(known: dict[str, float], *names: str) -> Array:
    return np.array([known.get(name, 0.0) for name in names])


def _payloads(cell: Cell, known: dict[str, float]) -> dict[str, tuple[float, Array]]:
    """The cell's payloads; the one that grinds as calibrated."""
    payloads = believed_payloads(cell)
    table = cell.tables.workpiece
    name = (table.payload if table is not None else None) or next(iter(payloads), None)
    if name is not None:
        mass, com = payloads[name]
        centre = np.array([known.get(f"payload_com_{x}", com[k]) for k, x in enumerate("xyz")])
        payloads[name] = (max(known.get("payload_mass", mass), 0.0), centre)
    return payloads


def _across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors u, v across the wheel's axis with u x v = axis, u nearest to the first base axis most across it.

    What `wheel_axis_u` and `wheel_axis_v` of a calibration turn about (docs/architecture.md).
    """
    nearest = np.zeros(3)
    nearest[int(np.argmin(np.abs(axis)))] = 1.0
    u = nearest - (nearest @ axis) * axis
    u = u / np.sqrt(u @ u)
    return u, np.cross(axis, u)
