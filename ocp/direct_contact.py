"""The wheel contact solved directly at solved waypoints: what the table missed goes back into the program as a defect."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from ocp.blade_gap import SurfaceCloud, surface_shape
from ocp.cell import Wheel
from ocp.contact.cover import Cover
from ocp.contact.gap import LocalShape, solve_force
from ocp.solve import Evaluation, PassProblem
from robots.errors import Infeasible
from robots.pose import Array

STATION_SPACING = 6e-3  # m between waypoints solved directly; the defect varies over the wheel's width, not over less


@dataclass(frozen=True)
class DirectContact:
    """Directly solved contact at some waypoints of a pass: index (k,), patch semi-axes (k, 2) m.

    departure (k,) m: indentation on the real surface minus that on its local quadratic, both on the same grid.
    """

    index: Array
    departure: Array
    semi_axes: Array


def stations(s: Array, spacing: float = STATION_SPACING) -> Array:
    """Indices of waypoints about `spacing` apart, both ends among them."""
    count = max(4, int(np.ceil((s[-1] - s[0]) / spacing)) + 1)
    return np.unique(np.abs(s[:, None] - np.linspace(s[0], s[-1], count)).argmin(axis=0))


def solve_directly(
    wheel: Wheel, cover: Cover, cloud: SurfaceCloud, problem: PassProblem, solved: Evaluation, sigma_travel: float
) -> DirectContact:
    """What the real surface adds to the indentation at the programmed force, at the postures of `solved`.

    `sigma_travel` is +1 where the blade moves with the belt at zero turn, else -1 (docs/architecture.md). Raises
    Infeasible of the contact solver, with the waypoint.
    """
    index = stations(problem.path.s)
    departure, axes = [], []
    for k in index:
        base = LocalShape(
            *solved.curvature[k],
            lateral=solved.lateral[k],
            tilt_x=solved.tilt[k, 0],
            tilt_y=solved.tilt[k, 1],
            heading=(-sigma_travel * np.cos(solved.turn[k]), -sigma_travel * np.sin(solved.turn[k])),
        )
        shape = surface_shape(wheel, cloud, base, solved.T_base_blade[k], problem.path.p[k])
        try:
            force = float(problem.path.force[k])
            contact, smooth = solve_force(cover, force, shape), solve_force(cover, force, base)
        except Infeasible as error:
            path = problem.path
            raise Infeasible(f"line {path.line} ({path.side}), waypoint {k + 1}: {error}") from None
        departure.append(contact.indentation - smooth.indentation)
        axes.append(contact.semi_axes)
    return DirectContact(index, np.array(departure), np.array(axes))


def defect(problem: PassProblem, direct: DirectContact) -> Array:
    """Departure from the table's quadratic at every waypoint, (n,) m."""
    s = problem.path.s
    return np.asarray(PchipInterpolator(s[direct.index], direct.departure)(s))
