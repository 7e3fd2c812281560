"""The virtual cell's contact against the planner's second route: elementary kinematics, Signorini problems solved directly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ocp.model.cell import read_cell
from ocp.model.prepare import wheel_cover
from ocp.plan.paths import lay_paths
from ocp.plan.second_route import believed_robot, bent
from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.contact.grinder import make_grinder
from ocp.simulate.twin.contact.table import make_tables
from robots.reference_kinematics import elementary_forward
from tests.support import force_world
from tests.support.small_plan import small_cell
from tests.support.twin_grinding import FEED, believed
from trajectories.blade import read_blade

Array = np.ndarray


@pytest.fixture(scope="module")
def taught(tmp_path_factory) -> tuple[force_world.World, int, Array]:
    """The believed cell with its truth moved, without finite elements: every waypoint gives way alike; a line and its joints."""
    cell = read_cell(small_cell(tmp_path_factory.mktemp("cell")))
    laid = lay_paths(cell, cell.workpiece.stl, force_world.CHOICE)
    injected = {f"wheel_{a}": v for a, v in zip("xyz", (2e-4, -3e-4, 4e-4), strict=True)}
    injected |= {f"blade_{a}": v for a, v in zip("xyz", (-3e-4, 2e-4, 1e-4), strict=True)}
    injected |= dict(wheel_axis_u=8e-4, wheel_axis_v=-1e-3, blade_a=1e-3, blade_b=-7e-4, blade_c=5e-4)
    injected |= dict(cover_stiffness_scale=0.08, blade_stiffness_scale=0.0, flange_stiffness=5900.0, flange_setpoint_offset=0.15)
    payload = cell.workpiece.payload
    arm = believed_robot(cell, cell.robot.mdh, 1 / cell.robot.stiffness, payload.mass, payload.com)
    truth = force_world.true_cell(cell, injected)
    give = [np.tile([4e-6, 3e-7, -2e-7], (len(p.s), 1)) for p in laid.paths]
    w = force_world.World(cell, truth, arm, laid.paths, laid.cloud, wheel_cover(truth), give, injected)
    return w, 1, force_world.taught_joints(w, w.paths[1], 6e-4, turn=0.2, arc=0.1)


def dense(w: force_world.World, line: int, q: Array) -> ContactMoments:
    path = w.paths[line]
    s = np.arange(path.s[0], path.s[-1], 4e-4)
    q, p, n, t = (CubicSpline(path.s, v)(s) for v in (q, path.p, path.n, path.t))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    q = bent(w.cell, w.arm, q)
    T = elementary_forward(w.arm.robot, q)
    C = np.zeros((len(s), 6, 6))
    for j in range(6):
        step = np.zeros(6)
        step[j] = 1e-6
        a, b = elementary_forward(w.arm.robot, q + step), elementary_forward(w.arm.robot, q - step)
        turn = (a[:, :3, :3] - b[:, :3, :3]) @ T[:, :3, :3].transpose(0, 2, 1)
        J = np.hstack([a[:, :3, 3] - b[:, :3, 3], turn[:, 2, 1, None], turn[:, 0, 2, None], turn[:, 1, 0, None]]) / 2e-6
        C += w.arm.compliance[j] * J[:, :, None] * J[:, None, :]
    count, nan = len(s), np.full(len(s), np.nan)
    return ContactMoments(
        T,
        C,
        p,
        n,
        t,
        s,
        np.full(count, line),
        nan,
        np.full(count, FEED),
        np.full(count, 20.0),
        np.ones(count, bool),
        nan,
        s / FEED,
        np.zeros(count, int),
        np.zeros(count),
        nan,
        nan,
    )


@pytest.mark.parametrize(("flange", "limit", "spread"), [(True, 0.08, 0.02), (False, 0.6, 0.1)])
def test_the_planners_second_route_is_met_with_registration_errors(taught, flange, limit, spread):
    w, line, q = taught
    if not flange:
        w = replace(w, cell=replace(w.cell, flange=None), truth=replace(w.truth, flange=None))
    planner = force_world.true_force(w, line, q, 20.0, 20.0)
    truth = believed(
        w.cell,
        wheel_shift=np.array([2e-4, -3e-4, 4e-4]),
        blade_shift=np.array([-3e-4, 2e-4, 1e-4]),
        cover_scale=1.08,
        wheel_axis_turn=8e-4 * np.array([1.0, 0, 0]) + -1e-3 * np.cross(w.cell.wheel.axis, [1.0, 0, 0]),
        blade_turn=np.array([5e-4, -7e-4, 1e-3]),
        flange_scale=5900 / 5600,
        flange_offset=0.15,
    )
    blade = read_blade(w.cell.workpiece.stl, "mm")
    own = replace(make_tables(w.cell, blade))  # a store of its own: what is put into it stays here
    grinder = make_grinder(w.cell, truth, blade, own)
    grinder.tables.compliance = lambda at, solve: np.tile([4e-6, 3e-7, -2e-7], (len(at.s), 1))  # type: ignore[method-assign]
    c = dense(w, line, q)
    off = grinder.force(c).force - CubicSpline(w.paths[line].s, planner)(c.s)
    assert np.abs(off).max() < limit and off.std() < spread
    # The errors matter: without them the force is another one.
    without = make_grinder(w.cell, believed(w.cell), blade, grinder.tables).force(c).force
    assert np.abs(without - CubicSpline(w.paths[line].s, planner)(c.s)).max() > 3 * limit
