"""Time along a given joint path, rest to rest: ours against toppra and Drake's Toppra; limits kept, duration, seconds.

`python benchmarks/timing_peers.py [--paths 5]`; full table: `--paths 100`.

Random joint paths of 20 waypoints, the same cubic spline for all, of the KR 210; limits on axis speed and axis acceleration, all
of which may be used (margin 1; the plan uses less). Ours with the running mean of the time law that the plan takes (no jumps of
acceleration, and so 0.05 s longer) and without, its default grid. toppra and Drake with the grid that they propose themselves
and with 2001 even points; of toppra both ways to make a trajectory of the speeds, its default spline and constant acceleration.

Agreement: the fastest law is unique, so durations over ours without the running mean are near 1 (median); shorter is a limit
broken. Worst: largest ratio of speed or acceleration to its limit over all paths, sampled at 1 ms. Seconds a path, processor
seconds too, are medians over the paths, each timed once.
"""

import warnings
from collections.abc import Callable

import numpy as np
from peers import NotInstalled, arguments, head, measured, named, row
from scipy.interpolate import CubicSpline

from robots.errors import Infeasible
from robots.pose import Array
from robots.robot import load_robot
from trajectories.joint_trajectory import SAMPLE, Limits
from trajectories.timing import WINDOW, time_contact_path

START = np.radians([5.0, -70, 100, 10, -40, 20])
LIMITS = Limits.of(load_robot("kr210_r2700_extra"), margin=1.0)
Law = Callable[[Array], tuple[Array, Array]]  # times (m,) s to axis speeds rad/s and accelerations rad/s^2, each (m, 6)
Timed = tuple[float, Law]  # duration s
EVEN = np.linspace(0.0, 1.0, 2001)


def ours(q: CubicSpline, window: float) -> Timed | None:
    try:
        timed = time_contact_path(q(q.x), q.x, None, LIMITS, window)
    except Infeasible:
        return None
    return timed.duration, lambda t: (timed.qd(t), timed.qdd(t))


def by_toppra(q: CubicSpline, parametrizer: str, grid: Array | None) -> Timed | None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from toppra import SplineInterpolator, algorithm, constraint

        limits = [constraint.JointVelocityConstraint(LIMITS.qd), constraint.JointAccelerationConstraint(LIMITS.qdd)]
        path = SplineInterpolator(q.x, q(q.x))
        found = algorithm.TOPPRA(limits, path, gridpoints=grid, parametrizer=parametrizer).compute_trajectory()
    return None if found is None else (float(found.duration), lambda t: (found(t, 1), found(t, 2)))


def drake_plant() -> object:
    """Six turning axes; where they stand does not matter to limits of speed and acceleration."""
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import RevoluteJoint, SpatialInertia

    plant = MultibodyPlant(0.0)
    frame = plant.world_frame()
    for i in range(6):
        body = plant.AddRigidBody(f"link_{i}", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.AddJoint(RevoluteJoint(f"joint_{i}", frame, body.body_frame(), [0, 0, 1]))
        frame = body.body_frame()
    plant.Finalize()
    return plant


def by_drake(q: CubicSpline, plant: object, grid: Array | None) -> Timed | None:
    from pydrake.multibody.optimization import CalcGridPointsOptions, Toppra
    from pydrake.trajectories import PiecewisePolynomial

    path = PiecewisePolynomial.CubicHermite(q.x, q(q.x).T, q(q.x, 1).T)
    points = Toppra.CalcGridPoints(path, CalcGridPointsOptions()) if grid is None else grid
    job = Toppra(path, plant, points)
    job.AddJointVelocityLimit(-LIMITS.qd, LIMITS.qd)
    job.AddJointAccelerationLimit(-LIMITS.qdd, LIMITS.qdd)
    law = job.SolvePathParameterization()
    if law is None:
        return None
    orders = [law, law.derivative(1), law.derivative(2)]

    def motion(t: Array) -> tuple[Array, Array]:
        s, v, u = (order.vector_values(t).T for order in orders)
        return q(s[:, 0], 1) * v, q(s[:, 0], 2) * v**2 + q(s[:, 0], 1) * u

    return law.end_time(), motion


def ways() -> dict[str, tuple[str, Callable[[CubicSpline], Timed | None]]]:
    found: dict[str, tuple[str, Callable[[CubicSpline], Timed | None]]] = {
        "ours, no running mean": ("", lambda q: ours(q, 0.0)),
        "ours, as in a plan": ("", lambda q: ours(q, WINDOW)),
    }
    for name, grid in (("its own grid", None), ("2001 points", EVEN)):
        for kind in ("ParametrizeSpline", "ParametrizeConstAccel"):
            found[f"toppra, {kind}, {name}"] = "toppra", lambda q, kind=kind, grid=grid: by_toppra(q, kind, grid)
    try:
        named("drake")
        plant = drake_plant()
    except NotInstalled:
        plant = None
    for name, grid in (("its own grid", None), ("2001 points", EVEN)):
        found[f"Drake, {name}"] = "drake", lambda q, grid=grid: by_drake(q, plant, grid)
    return found


def main() -> None:
    options = arguments(__doc__, paths=5)
    rng = np.random.default_rng(0)
    joints = START + np.cumsum(rng.normal(size=(options.paths, 20, 6)) * 0.03, axis=1)
    paths = [CubicSpline(np.linspace(0.0, 1.0, 20), q) for q in joints]
    head(("way", "version", "no answer", "worst ratio at 1 ms", "duration over ours", "wall s a path", "processor s a path"))
    reference = np.full(len(paths), np.nan)
    for label, (package, solve) in ways().items():
        try:
            told = named(package) if package else ""
        except NotInstalled as reason:
            row(label, reason)
            continue
        solve(paths[0])  # imports
        durations, worst, seconds = np.full(len(paths), np.nan), 0.0, []
        for i, q in enumerate(paths):
            answer, *spent = measured(lambda q=q, solve=solve: solve(q), 1)
            seconds.append(spent)
            if answer is not None:
                durations[i], law = answer
                qd, qdd = law(np.append(np.arange(0.0, durations[i], SAMPLE), durations[i]))
                worst = max(worst, np.abs(qd / LIMITS.qd).max(), np.abs(qdd / LIMITS.qdd).max())
        if label.startswith("ours, no"):
            reference = durations
        failed, longer = f"{np.isnan(durations).sum()} of {len(paths)}", np.nanmedian(durations / reference)
        row(label, told, failed, f"{worst:.4f}", f"{longer:.4f}", *map(float, np.median(seconds, axis=0)))


if __name__ == "__main__":
    main()
