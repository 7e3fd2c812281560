"""The wheel contact solved directly at solved waypoints: what the table missed goes back into the program as a defect."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from ocp.contact.cover import Cover
from ocp.contact.gap import LocalShape, solve_force
from ocp.solve import Evaluation, PassProblem
from robots.pose import Array

STATION_SPACING = 6e-3  # m between waypoints solved directly; the defect varies over the wheel's width, not over less


@dataclass(frozen=True)
class DirectContact:
    """Directly solved contact at some waypoints of a pass: index (k,), indentation (k,) m, patch semi-axes (k, 2) m."""

    index: Array
    indentation: Array
    semi_axes: Array


def stations(s: Array, spacing: float = STATION_SPACING) -> Array:
    """Indices of waypoints about `spacing` apart, both ends among them."""
    count = max(4, int(np.ceil((s[-1] - s[0]) / spacing)) + 1)
    return np.unique(np.abs(s[:, None] - np.linspace(s[0], s[-1], count)).argmin(axis=0))


def solve_directly(cover: Cover, problem: PassProblem, solved: Evaluation, sigma_travel: float) -> DirectContact:
    """Indentation at the programmed force, from the Signorini problem at the postures of `solved`.

    `sigma_travel` is +1 where the blade moves with the belt at zero turn, else -1 times it (docs/architecture.md).
    """
    index = stations(problem.path.s)
    indentation, axes = [], []
    for k in index:
        shape = LocalShape(
            *solved.curvature[k], lateral=solved.lateral[k], tilt_x=solved.tilt[k, 0], tilt_y=solved.tilt[k, 1],
            extent=problem.path.extent[k],
            heading=(-sigma_travel * np.cos(solved.turn[k]), -sigma_travel * np.sin(solved.turn[k])),
        )  # fmt: skip
        contact = solve_force(cover, float(problem.path.force[k]), shape)
        indentation.append(contact.indentation)
        axes.append(contact.semi_axes)
    return DirectContact(index, np.array(indentation), np.array(axes))


def corrected_defect(problem: PassProblem, solved: Evaluation, direct: DirectContact) -> Array:
    """Defect (n,) m that makes the model's wheel indentation equal the direct one at these postures."""
    missing = direct.indentation - solved.parts[direct.index, 1]
    s = problem.path.s
    return np.asarray(problem.defect + PchipInterpolator(s[direct.index], missing)(s))
