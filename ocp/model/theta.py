"""The parameters theta of the model: order, believed values, how well they are known, and calibrations folded into the cell."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell, Wheel
from robots.calibration.parameters import SYMBOLS
from robots.pose import Array, make_transform

# Blocks in the order of the vector, each with the parameter names of robots/calibration/parameters.py.
BLOCKS: dict[str, tuple[str, ...]] = {
    "mdh": tuple(f"{s}{i}" for i in range(1, 7) for s in ("th", "d", "a", "al", "be")),
    "c": tuple(f"c{i}" for i in range(1, 7)),
    "payload_mass": ("payload_mass",),
    "payload_com": ("payload_com_x", "payload_com_y", "payload_com_z"),
    "wheel_centre": ("wheel_x", "wheel_y", "wheel_z"),
    "wheel_axis": ("wheel_axis_u", "wheel_axis_v"),
    "wheel_radius": ("wheel_radius",),
    "blade_shift": ("blade_x", "blade_y", "blade_z"),
    "blade_rotation": ("blade_c", "blade_b", "blade_a"),
    "cover_stiffness_scale": ("cover_stiffness_scale",),
    "blade_stiffness_scale": ("blade_stiffness_scale",),
    "flange_stiffness": ("flange_stiffness",),
    "flange_setpoint_offset": ("flange_setpoint_offset",),
}
NAMES: tuple[str, ...] = tuple(name for names in BLOCKS.values() for name in names)
assert set(NAMES) <= set(SYMBOLS), "every parameter of the model is in the product's list"

# One sigma of what a cell file does not say (our judgement; docs/model.md lists what most of them contribute to the force).
UNCALIBRATED_LENGTH_SD = 3e-4  # m; with the next line about 1.2 mm at the tool, PHYSICS 2.6
UNCALIBRATED_ANGLE_SD = 3e-4  # rad
UNMODELLED_JOINTS = 2e-5  # rad; 0.04 mm at 2 m, what gears leave after a calibration (PHYSICS 2.6)
UNCALIBRATED_MDH_SD = [UNCALIBRATED_ANGLE_SD, *[UNCALIBRATED_LENGTH_SD] * 2, *[UNCALIBRATED_ANGLE_SD] * 2]  # th, d, a, al, be
COMPLIANCE_SD = 0.2  # relative, PHYSICS 2.5
PAYLOAD_MASS_SD = 0.5  # kg
PAYLOAD_COM_SD = 5e-3  # m
COVER_STIFFNESS_SD = 0.15  # relative; five points of Shore A are 30 %
BLADE_STIFFNESS_SD = 0.05  # relative
FLANGE_STIFFNESS_SD = 0.05  # relative
FLANGE_SETPOINT_SD = 0.2  # N
# Blocks that `registered` folds into the cell.
WHEEL: tuple[str, ...] = ("wheel_centre", "wheel_axis", "wheel_radius", "cover_stiffness_scale")
FOLDED = (*WHEEL, "blade_shift", "blade_rotation", "flange_setpoint_offset", "blade_stiffness_scale")
RANK = 1e-12  # of the largest eigenvalue of a correlation; less is rounding, no freedom


@dataclass(frozen=True)
class Theta:
    """Values (m,) and covariance (m, m) of the parameters, in the order of `NAMES`, then coefficients of the cell's effects where
    `with_effects` put them; joint_noise rad: one sigma of what moves a joint without being a parameter (gear errors,
    repeatability), the same for all axes."""

    values: Array
    covariance: Array
    joint_noise: float = 0.0

    size = len(NAMES)

    @staticmethod
    def split(theta: ca.SX) -> dict[str, ca.SX]:
        """The blocks of a symbolic theta (without effects) by name."""
        edges = np.cumsum([0, *(len(names) for names in BLOCKS.values())]).tolist()
        return dict(zip(BLOCKS, ca.vertsplit(theta, edges), strict=True))


def covariance_root(covariance: Array) -> Array:
    """Root L (m, r) of a covariance (m, m): L L^T, so that x = mean + L z with z standard normal.

    Parameters of all sizes stand side by side (rad, N/m): the eigenvalues are those of the correlations. What has no spread
    drops out, and so do directions below RANK times the largest eigenvalue: nothing ill-conditioned is inverted.
    """
    sd = np.sqrt(np.diag(covariance))
    scale = np.where(sd > 0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    keep = values > RANK * values.max()
    return np.asarray(scale[:, None] * vectors[:, keep] * np.sqrt(values[keep]))


def believed_theta(cell: Cell) -> Theta:
    """The cell's values and, where a calibration gives them, its estimates with their full covariance."""
    wheel, piece, flange = cell.wheel, cell.workpiece, cell.flange
    compliance = np.divide(1.0, cell.robot.stiffness, out=np.zeros(6), where=cell.robot.stiffness > 0)
    loaded, stiffness = float(piece.payload.mass > 0), flange.stiffness if flange else 1.0
    # Values, and one sigma where no calibration speaks.
    believed: dict[str, tuple[Array | float, Array | float]] = {
        "mdh": (cell.robot.mdh.ravel(), np.tile(UNCALIBRATED_MDH_SD, 6)),
        "c": (compliance, COMPLIANCE_SD * np.abs(compliance)),
        "payload_mass": (piece.payload.mass, PAYLOAD_MASS_SD * loaded),
        "payload_com": (piece.payload.com, PAYLOAD_COM_SD * loaded),
        "wheel_centre": (0.0, wheel.centre_sd),
        "wheel_axis": (0.0, wheel.axis_sd),
        "wheel_radius": (0.0, 0.0),  # the centre's doubt has it in; what wears is ocp.update's
        "blade_shift": (0.0, piece.xyz_sd),
        "blade_rotation": (0.0, piece.abc_sd),
        "cover_stiffness_scale": (0.0, COVER_STIFFNESS_SD),
        "blade_stiffness_scale": (0.0, BLADE_STIFFNESS_SD),
        "flange_stiffness": (stiffness, FLANGE_STIFFNESS_SD * stiffness if flange else 0.0),
        "flange_setpoint_offset": (0.0, FLANGE_SETPOINT_SD if flange else 0.0),
    }
    values, sd = (
        np.concatenate([np.broadcast_to(np.asarray(believed[block][k], float), len(names)) for block, names in BLOCKS.items()])
        for k in (0, 1)
    )
    covariance = np.diag(sd**2)
    calibration = cell.calibration
    if calibration is not None:
        inside = [i for i, name in enumerate(calibration.names) if name in NAMES]
        at = np.array([NAMES.index(calibration.names[i]) for i in inside], dtype=int)
        values[at] = calibration.values[inside]
        covariance[at, :] = 0.0
        covariance[:, at] = 0.0
        covariance[np.ix_(at, at)] = calibration.covariance[np.ix_(inside, inside)]
    return Theta(values, covariance, _joint_noise(cell))


def with_effects(cell: Cell, theta: Theta) -> Theta:
    """`theta` followed by the coefficients of the cell's effects, which are taken as independent of it."""
    if not cell.effects:
        return theta
    values = np.concatenate([theta.values, *(e.a for e in cell.effects)])
    return replace(theta, values=values, covariance=block_diag(theta.covariance, *(e.covariance for e in cell.effects)))


def _joint_noise(cell: Cell) -> float:
    """What the calibration found beside its parameters, else what such arms have."""
    told = None if cell.calibration is None else cell.calibration.joint_noise
    return UNMODELLED_JOINTS if told is None else told


def registered(cell: Cell) -> tuple[Cell, Theta]:
    """The cell with its registration, stiffnesses and flange as calibrated, and theta with these corrections at zero.

    The covariance stays as it is: the corrections are as uncertain as before, about their new place. Coefficients of the cell's
    effects follow theta's own parameters.
    """
    theta = believed_theta(cell)
    value = {block: theta.values[[NAMES.index(name) for name in names]] for block, names in BLOCKS.items()}
    wheel, piece = wheel_at(cell.wheel, theta.values), cell.workpiece
    R = Rotation.from_rotvec(value["blade_rotation"]).as_matrix() @ piece.T_flange_blade[:3, :3]
    piece = replace(
        piece,
        T_flange_blade=make_transform(R, piece.T_flange_blade[:3, 3] + value["blade_shift"]),
        youngs_modulus=piece.youngs_modulus * (1 + float(value["blade_stiffness_scale"][0])),
    )
    flange = cell.flange
    if flange is not None:
        flange = replace(
            flange,
            stiffness=float(value["flange_stiffness"][0]),
            setpoint=flange.setpoint + float(value["flange_setpoint_offset"][0]),
        )
    values = theta.values.copy()
    values[[NAMES.index(name) for block in FOLDED for name in BLOCKS[block]]] = 0.0
    return replace(cell, wheel=wheel, workpiece=piece, flange=flange), with_effects(cell, replace(theta, values=values))


def wheel_at(wheel: Wheel, values: Array) -> Wheel:
    """The wheel moved, turned, worn and softened by the parameters' values (m,), from where a cell has it."""
    value = {block: values[[NAMES.index(name) for name in BLOCKS[block]]] for block in WHEEL}
    u, v = axis_directions(wheel.axis)
    axis = _unit(wheel.axis - value["wheel_axis"][0] * v + value["wheel_axis"][1] * u)
    return replace(
        wheel,
        centre=wheel.centre + value["wheel_centre"],
        axis=axis,
        contact_direction=_unit(wheel.contact_direction - axis * (axis @ wheel.contact_direction)),
        radius=wheel.radius + float(value["wheel_radius"][0]),
        cover_modulus=wheel.cover_modulus * (1 + float(value["cover_stiffness_scale"][0])),
    )


def axis_directions(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors u, v (3) with u x v = axis; `wheel_axis_u` turns the axis about u, `wheel_axis_v` about v."""
    u = np.eye(3)[int(np.argmin(np.abs(axis)))]
    u = u - axis * (axis @ u)
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
