"""A pass as the optimiser takes it: waypoints with all they know, in the direction of travel."""

from dataclasses import dataclass, replace

import numpy as np

from ocp.posture import Seed
from ocp.stage import N_CLEARANCE
from robots.pose import Array
from trajectories.passes import BladePath


@dataclass(frozen=True)
class PassProblem:
    """A pass in its direction of travel with all that its waypoints know: blade compliance (n, 3) m/N in (n, t, b),
    wheel defect (n,) m, clearances (n, N_CLEARANCE, 7): rows a.q >= b; turn_limit
    rad narrows the cell's turn tolerance where a turned wheel would touch the blade elsewhere."""

    path: BladePath
    seed: Seed
    compliance: Array
    defect: Array
    clearances: Array
    turn_limit: float = np.inf

    @staticmethod
    def start(path: BladePath, seed: Seed, compliance: Array) -> "PassProblem":
        """Before any correction by direct contact solutions or collision checks."""
        n = len(path.s)
        clearances = np.zeros((n, N_CLEARANCE, 7))
        clearances[..., 6] = -1.0
        return PassProblem(path, seed, compliance, np.zeros(n), clearances)

    @property
    def waypoints(self) -> Array:
        """Columns `ocp.model.WAYPOINT`, (n, 16)."""
        p = self.path
        return np.column_stack([p.p, p.n, p.t, p.curvature, self.compliance, self.defect])

    @property
    def seconds(self) -> Array:
        """Time between neighbouring waypoints at the programmed feed, (n-1,) s."""
        return np.asarray(np.diff(self.path.s) / (0.5 * (self.path.feed[1:] + self.path.feed[:-1])))


def with_direction(problem: PassProblem, reversed_path: BladePath) -> PassProblem:
    """The same pass run the other way: compliance along t and b change sign with the contact frame."""
    flip = np.array([1.0, -1.0, -1.0])
    return replace(problem, path=reversed_path, compliance=problem.compliance[::-1] * flip)
