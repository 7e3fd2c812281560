"""A calibration's corrections folded into the cell, so that every part works with the same wheel, blade and flange."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.model.force_balance import axis_directions
from ocp.model.theta import BLOCKS, NAMES, Theta, believed_theta, with_effects
from robots.pose import Array, make_transform

FOLDED = (
    "wheel_centre", "wheel_axis", "blade_shift", "blade_rotation", "cover_stiffness_scale", "blade_stiffness_scale",
    "flange_setpoint_offset",
)  # fmt: skip


def registered(cell: Cell) -> tuple[Cell, Theta]:
    """The cell with its registration, stiffnesses and flange as calibrated, and theta with these corrections at zero.

    The covariance stays as it is: the corrections are as uncertain as before, about their new place. Coefficients of the cell's
    effects follow theta's own parameters.
    """
    theta = believed_theta(cell)
    value = {block: theta.values[[NAMES.index(name) for name in names]] for block, names in BLOCKS.items()}
    wheel, piece = cell.wheel, cell.workpiece
    u, v = axis_directions(wheel.axis)
    axis = _unit(wheel.axis - value["wheel_axis"][0] * v + value["wheel_axis"][1] * u)
    toward = _unit(wheel.contact_direction - axis * (axis @ wheel.contact_direction))
    wheel = replace(
        wheel,
        centre=wheel.centre + value["wheel_centre"],
        axis=axis,
        contact_direction=toward,
        cover_modulus=wheel.cover_modulus * (1 + float(value["cover_stiffness_scale"][0])),
    )
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


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
