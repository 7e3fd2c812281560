"""The wheel contact solved directly at solved waypoints: what the table missed goes back into the program as a correction."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.blade_gap import SurfaceCloud, contact_stations, surface_shape
from ocp.model.cell import Wheel
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import Evaluation
from robots.errors import Infeasible
from robots.pose import Array

STATION_SPACING = 3e-3  # m between waypoints solved directly


@dataclass(frozen=True)
class DirectContact:
    """Directly solved contact at some waypoints of a pass: index (k,), patch semi-axes (k, 2) m.

    indentation (k,) m under the programmed force on the real surface; it varies smoothly along a pass, other than the
    local curvature that the table goes by.
    """

    index: Array
    indentation: Array
    semi_axes: Array


def solve_directly(
    wheel: Wheel, cover: Cover, cloud: SurfaceCloud, problem: PassProblem, solved: Evaluation, sigma_travel: float
) -> DirectContact:
    """Indentation under the programmed force on the blade's real surface, at the postures of `solved`.

    `sigma_travel` is +1 where the blade moves with the belt at zero turn, else -1 (docs/architecture.md). Raises
    Infeasible of the contact solver, with the waypoint.
    """
    index = contact_stations(problem.path.s, STATION_SPACING)
    indentation, axes = [], []
    for k in index:
        kxx, kyy, kxy = (float(c) for c in solved.curvature[k])
        tilt_x, tilt_y = (float(c) for c in solved.tilt[k])
        heading = (-sigma_travel * float(np.cos(solved.turn[k])), -sigma_travel * float(np.sin(solved.turn[k])))
        base = LocalShape(kxx, kyy, kxy, float(solved.lateral[k]), tilt_x, tilt_y, heading=heading)
        shape = surface_shape(wheel, cloud, base, solved.T_base_blade[k], problem.path.p[k])
        try:
            contact = solve_force(cover, float(problem.path.force[k]), shape)
        except Infeasible as error:
            path = problem.path
            raise Infeasible(f"line {path.line} ({path.side}), waypoint {k + 1}: {error}") from None
        indentation.append(contact.indentation)
        axes.append(contact.semi_axes)
    return DirectContact(index, np.array(indentation), np.array(axes))


def corrected_indentation(problem: PassProblem, solved: Evaluation, direct: DirectContact) -> Array:
    """The indentation correction (n,) m that makes the model's wheel indentation the direct one at the postures of `solved`."""
    s = problem.path.s
    wanted = PchipInterpolator(s[direct.index], direct.indentation)(s)
    return np.asarray(problem.indentation_correction + wanted - solved.parts[:, 1])
