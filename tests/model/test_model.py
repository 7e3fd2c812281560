"""The symbolic model against a second route that shares nothing with it, and its derivatives against differences."""

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest

from ocp.model.cell import ForceFlange
from ocp.model.force_balance import STOP_SOFTNESS, build_model
from ocp.model.theta import NAMES, UNMODELLED_JOINTS, believed_theta
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import N_ROWS, ObjectiveWeights, build_stage
from ocp.plan.second_route import _jacobian, _linear_compliance, _local_shape, believed_robot, bent
from robots.calibration.store import Calibration
from robots.pose import apply
from robots.reference_kinematics import elementary_forward
from tests.support.example_pass import LineLaw, bar_pass, bundled_cell

GIVE = np.array([2e-6, 3e-7, -4e-7])
Q = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0])


def problem(cell=None):
    path = bar_pass()
    seed = Seed(1, 0, np.zeros(4), 0.0, np.tile(Q, (4, 1)), np.linspace(0, 1, 4), 0.0)
    return PassProblem.start(path, seed, np.tile(GIVE, (len(path.s), 1)))


@lru_cache
def solver(flange=True, friction=None):
    cell = bundled_cell()
    if not flange:
        cell = replace(cell, flange=None)
    return PassSolver(cell, LineLaw(), believed_theta(cell), ObjectiveWeights())


def evaluated(flange=True):
    pass_problem = problem()
    q = Q + np.zeros((40, 6)) + 1e-3 * np.sin(np.arange(240).reshape(40, 6))
    return pass_problem, q, solver(flange).evaluate(pass_problem, q, np.full(40, 21.0))


def test_overlap_and_place_on_the_wheel_equal_the_numpy_route():
    pass_problem, q, seen = evaluated()
    s = solver()
    cell, theta = s.cell, dict(zip(NAMES, s.theta.values, strict=True))
    believed = believed_robot(cell, cell.robot.mdh, s.theta.values[30:36], theta["payload_mass"], s.theta.values[37:40])
    q_real = bent(cell, believed, q)
    T = elementary_forward(cell.robot, q_real) @ cell.workpiece.T_flange_blade
    p = apply(T, pass_problem.path.p)
    from_centre = p - cell.wheel.centre
    lateral = from_centre @ cell.wheel.axis
    rho = np.linalg.norm(from_centre - lateral[:, None] * cell.wheel.axis, axis=1)
    # two fixed-point steps in the model against the converged posture here: below a micrometre (PHYSICS 2.5)
    assert seen.delta == pytest.approx(cell.wheel.radius - rho, abs=1e-6)
    assert seen.lateral == pytest.approx(lateral, abs=1e-6)
    assert seen.T_base_blade == pytest.approx(T, abs=2e-6)


def test_the_parts_of_the_chain_are_what_they_say():
    pass_problem, q, seen = evaluated()
    s = solver()
    assert seen.residual == pytest.approx(seen.delta - seen.parts.sum(axis=1), abs=1e-15)
    assert seen.parts[:, 0] == pytest.approx((21.0 - 20.0) / 5600.0)
    assert (seen.parts[:, 3] > 0).all() and seen.parts[:, 3].max() < 1e-4  # PHYSICS 2.5: about 0.03 mm under 20 N
    stiff = solver(flange=False)
    rigid = stiff.evaluate(pass_problem, q, np.full(40, 21.0))
    assert (rigid.parts[:, 0] == 0).all()
    assert (rigid.stiffness > 5 * seen.stiffness).all()
    assert s.cell.flange is not None and (seen.stiffness < s.cell.flange.stiffness).all()


def test_robot_compliance_under_contact_equals_finite_differences():
    pass_problem, q, seen = evaluated()
    s = solver()
    cell = s.cell
    nominal = believed_robot(cell, cell.robot.mdh, s.theta.values[30:36], 25.0, cell.workpiece.payload.com)
    k = 7
    q_real = bent(cell, nominal, q[k : k + 1])[0]
    step = 1e-6
    points = [
        apply(elementary_forward(cell.robot, (q_real + d)[None]) @ cell.workpiece.T_flange_blade, pass_problem.path.p[k])[0]
        for d in step * np.vstack([np.eye(6), -np.eye(6)])
    ]
    J = (np.array(points[:6]) - np.array(points[6:])).T / (2 * step)
    e = np.cos(seen.arc[k]) * cell.wheel.contact_direction + np.sin(seen.arc[k]) * np.cross(
        cell.wheel.axis, cell.wheel.contact_direction
    )
    f = e + cell.wheel.friction * np.cross(cell.wheel.axis, e)
    expected = 21.0 * e @ J @ np.diag(1 / cell.robot.stiffness) @ J.T @ f
    assert seen.parts[k, 3] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("belt", [1.0, -1.0])
def test_the_second_route_has_the_model_s_local_shape_and_give(belt):
    """On a twisted surface that stands askew to the belt, with friction, whichever way the belt runs."""
    bundled = bundled_cell()
    cell = replace(bundled, wheel=replace(bundled.wheel, belt_speed=belt * bundled.wheel.belt_speed, friction=0.4))
    cell = replace(cell, workpiece=replace(cell.workpiece, clamp_stiffness=1e7))
    at = problem()
    at = replace(at, path=replace(at.path, curvature=np.tile([-3.0, 25.0, 4.0], (40, 1))))
    theta = believed_theta(cell)
    q = Q + 0.3 * np.eye(6)[3] + 1e-2 * np.sin(np.arange(240).reshape(40, 6))
    seen = PassSolver(cell, LineLaw(), theta, ObjectiveWeights()).evaluate(at, q, np.full(40, 21.0))
    believed = believed_robot(cell, cell.robot.mdh, theta.values[30:36], 25.0, cell.workpiece.payload.com)
    n, t = (np.einsum("kij,kj->ki", seen.T_base_blade[:, :3, :3], v) for v in (at.path.n, at.path.t))
    e, sense = cell.wheel.outward(seen.arc), -cell.process.sigma * cell.wheel.travel
    shapes = [_local_shape(cell, at.path, k, n[k], t[k], e[k], seen.lateral[k]) for k in range(40)]
    assert np.array([[s.kxx, s.kyy, s.kxy] for s in shapes]) == pytest.approx(seen.curvature, rel=1e-3, abs=1e-2)
    assert np.array([[s.tilt_x, s.tilt_y] for s in shapes]) == pytest.approx(seen.tilt, abs=1e-4)
    heading = sense * np.array([s.heading for s in shapes])
    assert np.arctan2(heading[:, 1], heading[:, 0]) == pytest.approx(seen.turn, abs=1e-4)
    assert np.abs(seen.turn).min() > 0.1 and np.abs(seen.tilt).max() > 0.05
    J = _jacobian(cell, believed, bent(cell, believed, q), at.path.p)
    give = _linear_compliance(cell, believed, J, e, n, t, np.tile(GIVE, (40, 1)), cell.wheel.friction)
    assert 21.0 * give[:, :2] == pytest.approx(seen.parts[:, 2:], rel=2e-3)


def test_turn_and_tilt_read_what_the_pose_was_given():
    from ocp.plan.clearance import flange_pose
    from ocp.plan.passes.posture import contact_poses, turned_curvature
    from robots.inverse import inverse_branches

    cell = replace(bundled_cell(), compliant_joints=())
    s = PassSolver(cell, LineLaw(), believed_theta(cell), ObjectiveWeights())
    pass_problem = problem()
    twisted = np.tile([-3.0, 25.0, 4.0], (40, 1))
    pass_problem = replace(pass_problem, path=replace(pass_problem.path, curvature=twisted))
    arc, turn = np.array([0.2]), np.array([-0.3])
    index = np.arange(0, 40)
    T = contact_poses(cell, pass_problem.path, index, arc, turn, 1, 1)[0]
    q, reachable = inverse_branches(cell.robot, flange_pose(cell, T))
    branch = int(np.flatnonzero(reachable.all(axis=0))[0])
    seen = s.evaluate(pass_problem, q[:, branch], np.full(40, 20.0))
    assert seen.arc == pytest.approx(np.full(40, 0.2), abs=1e-9)
    assert seen.turn == pytest.approx(np.full(40, -0.3), abs=1e-9)
    assert seen.delta == pytest.approx(np.zeros(40), abs=1e-12)
    assert seen.tilt == pytest.approx(np.zeros((40, 2)), abs=1e-9)
    assert seen.curvature == pytest.approx(np.stack(turned_curvature(twisted, -0.3, cell.wheel.radius), axis=1), rel=1e-9)


@pytest.mark.parametrize("axis", [None, (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("compensated", [True, False])
def test_flange_force_balance(axis, compensated):
    flange = ForceFlange(18.0, 5600.0, 8e-3, 5.0, compensated, None if axis is None else np.array(axis))
    cell = replace(bundled_cell(), flange=flange)
    s = PassSolver(cell, LineLaw(), believed_theta(cell), ObjectiveWeights())
    pass_problem = problem()
    q = Q + np.zeros((40, 6))
    seen = s.evaluate(pass_problem, q, np.full(40, 20.0))
    n = seen.T_base_blade[:, :3, :3] @ np.array([0.0, 1.0, 0.0])
    push = n
    if axis is not None:
        R_flange = seen.T_base_blade[:, :3, :3] @ cell.workpiece.T_flange_blade[:3, :3].T
        push = R_flange @ np.array(axis)
        push = push * np.sign(np.sum(push * n, axis=1))[:, None]
    along = np.sum(push * n, axis=1)
    weight = 0.0 if compensated else -5.0 * 9.81 * push[:, 2]
    stroke = seen.parts[:, 0] / along
    assert 20.0 * along == pytest.approx(18.0 + 5600.0 * stroke + weight, rel=1e-9)


def test_standard_deviation_equals_monte_carlo():
    pass_problem, q, seen = evaluated()
    s = solver()
    rng = np.random.default_rng(3)
    model = s.model
    f = ca.Function("r", [model.q, model.F, model.w, model.theta], [model.residual])
    draws = rng.multivariate_normal(s.theta.values, s.theta.covariance, 4000, method="eigh").T
    w = np.tile(pass_problem.waypoints[5][:, None], 4000)
    base = np.tile(q[5][:, None], 4000)
    F = np.full((1, 4000), 21.0)
    r0 = np.asarray(f.map(4000)(base, F, w, np.tile(s.theta.values[:, None], 4000)))
    slope = -1 / seen.stiffness[5]
    for _ in range(6):
        r = np.asarray(f.map(4000)(base, F, w, draws)) - r0
        F = np.maximum(F - r / slope, 0.5)
    assert seen.force_sd[5] == pytest.approx(np.std(F), rel=0.06)


def test_stage_derivatives_equal_differences():
    s = solver()
    stage = build_stage(s.cell, s.model, ObjectiveWeights(force_sd=1.0), s.theta)
    pass_problem = problem()
    par = np.concatenate([pass_problem.waypoints[3], 0.1 * np.arange(14), [20.0, 1e-4, 1.0, 8.0, 9.0, 1.0, 1.0]])
    z = np.concatenate([Q + 0.01, [0.9, 1.1]])
    theta, lam = s.theta.values, np.linspace(-1, 1, N_ROWS)
    h = 1e-6

    def both(z):
        f, g = stage.value(z, par, theta)
        return float(f), np.asarray(g).ravel()

    shifts = h * np.eye(8)
    f_z = np.array([(both(z + d)[0] - both(z - d)[0]) / (2 * h) for d in shifts])
    g_z = np.array([(both(z + d)[1] - both(z - d)[1]) / (2 * h) for d in shifts]).T
    assert np.asarray(stage.gradient(z, par, theta)).ravel() == pytest.approx(f_z, rel=1e-5, abs=1e-5)
    assert np.asarray(stage.jacobian(z, par, theta)) == pytest.approx(g_z, rel=1e-5, abs=1e-4)

    def lagrangian(z):
        gradient = np.asarray(stage.gradient(z, par, theta)).ravel()
        return 0.7 * gradient + lam @ np.asarray(stage.jacobian(z, par, theta))

    H = np.array([(lagrangian(z + d) - lagrangian(z - d)) / (2 * h) for d in shifts])
    exact = np.asarray(stage.hessian(z, par, theta, 0.7, lam))
    assert exact == pytest.approx(H, rel=1e-4, abs=1e-3 * np.abs(H).max())
    value, jacobian, hessian = stage.scatter_terms
    s_z = np.array([np.asarray(value(z + d, par, theta) - value(z - d, par, theta)).ravel() / (2 * h) for d in shifts]).T
    near = 1e-5 * np.abs(s_z).max()
    assert np.asarray(jacobian(z, par, theta)) == pytest.approx(s_z, rel=1e-4, abs=near)
    u = np.linspace(-1, 1, len(s_z))
    s_zz = np.array([u @ np.asarray(jacobian(z + d, par, theta) - jacobian(z - d, par, theta)) / (2 * h) for d in shifts])
    assert np.asarray(hessian(z, par, theta, u)) == pytest.approx(s_zz, rel=1e-3, abs=1e-4 * np.abs(s_zz).max())


def test_sigma_flips_the_heading():
    cell = bundled_cell()
    q, w, theta = Q, problem().waypoints[0], believed_theta(cell).values
    turns = []
    for sigma in (1, -1):
        model = build_model(cell, LineLaw(), sigma)
        turns.append(float(ca.Function("t", [model.q, model.w, model.theta], [model.turn])(q, w, theta)))
    assert abs(abs(turns[0] - turns[1]) - np.pi) < 1e-9


@pytest.mark.parametrize("sign", [1, -1, 0])
def test_friction_and_heading_go_with_the_belt_whose_speed_may_be_a_symbol(sign):
    """By hand: joint 1 turns about the base's z, the force is F (e + mu sign belt), the heading is against the belt's travel."""
    cell, speed, force = bundled_cell(), ca.SX.sym("belt"), 21.0
    own, one = (build_model(replace(cell, wheel=replace(cell.wheel, belt_speed=v)), LineLaw()) for v in (20.0 * sign, speed))
    w, theta = problem().waypoints[0], believed_theta(cell).values

    def seen(model, *more):
        give = model.joint_lever[0] * model.joint_push[0]
        told = ca.vertcat(give, model.turn, model.residual, model.parts, model.tilt, ca.vec(model.T_base_blade))
        return ca.Function("seen", [model.q, model.F, model.w, model.theta, *more], [told])

    found = np.asarray(seen(one, speed)(Q, force, w, theta, sign)).ravel()
    assert np.array_equal(found, np.asarray(seen(own)(Q, force, w, theta)).ravel())
    T = found[-16:].reshape(4, 4, order="F")
    p, t = T[:3, :3] @ w[:3] + T[:3, 3], T[:3, :3] @ w[6:9]
    v = p - cell.wheel.centre
    e = v - (v @ cell.wheel.axis) * cell.wheel.axis
    e /= np.linalg.norm(e)
    belt, lever, heading = np.cross(cell.wheel.axis, e), np.cross([0.0, 0.0, 1.0], p), -t if sign >= 0 else t
    assert found[0] == pytest.approx(force * (lever @ e) * (lever @ (e + cell.wheel.friction * sign * belt)), rel=1e-9)
    assert found[1] == pytest.approx(np.arctan2(heading @ cell.wheel.axis, heading @ belt), abs=1e-9)


def test_joint_noise_adds_to_the_forces_standard_deviation_as_finite_differences_say():
    cell = bundled_cell()
    one = problem()
    q = Q + np.zeros((len(one.path.s), 6))
    theta = believed_theta(cell)
    assert theta.joint_noise == UNMODELLED_JOINTS
    known = replace(theta, covariance=1e-18 * np.eye(len(theta.values)))

    def sd(joint_noise: float):
        judge = PassSolver(cell, LineLaw(), replace(known, joint_noise=joint_noise), ObjectiveWeights())
        return judge.evaluate(one, q, one.path.force).force_sd

    squares = np.zeros(len(q))
    for step in 1e-6 * np.eye(6):
        plus, minus = (solver().evaluate(one, q + sign * step, one.path.force).residual for sign in (1, -1))
        squares += ((plus - minus) / 2e-6) ** 2
    stiffness = solver().evaluate(one, q, one.path.force).stiffness
    assert sd(1e-4) == pytest.approx(1e-4 * np.sqrt(squares) * stiffness, rel=1e-3)
    assert sd(0.0).max() < 0.02 * sd(1e-4).min()


def test_a_calibration_brings_its_joint_noise():
    cell = bundled_cell()
    told = Calibration("kr210_r2700_extra", ("a2",), np.array([1.15]), np.array([[1e-10]]), {"noise": {"joints_rad": 7e-6}})
    assert believed_theta(replace(cell, calibration=told)).joint_noise == 7e-6
    silent = replace(told, provenance={})
    assert believed_theta(replace(cell, calibration=silent)).joint_noise == UNMODELLED_JOINTS


def test_a_calibration_replaces_what_it_names_and_nothing_else():
    cell = bundled_cell()
    names, values = ("a1", "th2", "c2"), np.array([0.3512, 0.001, 4e-7])
    nominal = believed_theta(replace(cell, calibration=None)).values
    theta = believed_theta(replace(cell, calibration=Calibration(cell.robot.name, names, values, np.eye(3)))).values
    at = [NAMES.index(name) for name in names]
    assert np.array_equal(theta[at], values)
    assert np.array_equal(np.delete(theta, at), np.delete(nominal, at))


@pytest.mark.parametrize(("stop", "sign"), [(45.0 + 5600.0 * 4e-3, 1.0), (45.0 - 5600.0 * 4e-3, -1.0)])
def test_the_flange_bends_over_smoothly_at_its_stops_and_is_exact_elsewhere(stop, sign):
    flange = ForceFlange(45.0, 5600.0, 8e-3, 5.0, True, None)
    cell = replace(bundled_cell(), flange=flange)
    model = build_model(cell, LineLaw())
    x = model.parts[0]
    known = [model.q, model.F, model.w, model.theta]
    f = ca.Function("stroke", known, [x, ca.jacobian(x, model.F), ca.hessian(x, model.F)[0]])
    w, theta = problem().waypoints[0], believed_theta(cell).values

    def at(force, order=0):
        return np.array([float(f(Q, v, w, theta)[order]) for v in np.atleast_1d(force)])

    away = np.concatenate([np.linspace(2.0, 90.0, 45), stop + STOP_SOFTNESS * np.array([-1.001, 1.001])])
    away = away[np.abs(away - stop) > STOP_SOFTNESS]
    away = away[np.abs(away - (90.0 - stop)) > STOP_SOFTNESS]  # the other stop
    assert at(away) == pytest.approx(np.clip((away - 45.0) / 5600.0, -4e-3, 4e-3), abs=1e-15)
    assert at(away, 1) == pytest.approx(np.where(np.abs(away - 45.0) < 22.4, 1 / 5600.0, 0.0), abs=1e-15)
    near, h = stop + STOP_SOFTNESS * np.linspace(-1.2, 1.2, 97), 1e-5
    assert at(near, 1) == pytest.approx((at(near + h) - at(near - h)) / (2 * h), abs=1e-8)
    assert at(near, 2) == pytest.approx((at(near + h, 1) - at(near - h, 1)) / (2 * h), abs=1e-6)
    for order, most in ((0, 0.1), (1, 0.1), (2, 0.2)):  # steps over the join of what varies over all of it: no jump
        values = at(near, order)
        assert np.abs(np.diff(values)).max() < most * max(np.ptp(values), 1e-12)
    assert (np.diff(at(near)) >= -1e-18).all()
    # A stop that has been reached is soft by what it lets pass: less than the softness times the compliance.
    hard = np.clip((near - 45.0) / 5600.0, -4e-3, 4e-3)
    assert np.abs(at(near) - hard).max() < 0.25 * STOP_SOFTNESS / 5600.0 and (sign * (hard - at(near)) >= -1e-15).all()


@pytest.mark.parametrize("moved", ["wheel", "blade", "calibration"])
def test_functions_of_a_moved_cell_have_the_source_that_is_compiled(moved):
    """Moved from a place that is not zero, or calibrated once more, the same machine code serves, also where numbers become equal
    that were not."""
    s, theta = solver(), believed_theta(solver().cell)
    theta = replace(theta, values=theta.values + 1e-5 * np.arange(1, len(theta.values) + 1))
    wheel, piece = s.cell.wheel, s.cell.workpiece
    cells, thetas = [s.cell, s.cell], [theta, theta]
    if moved == "wheel":
        cells[1] = replace(s.cell, wheel=replace(wheel, centre=wheel.centre[[0, 1, 0]]))
    elif moved == "blade":
        cells[1] = replace(
            s.cell, workpiece=replace(piece, T_flange_blade=piece.T_flange_blade + 1e-3 * np.outer([0, 0, 1, 0], [0, 0, 0, 1]))
        )
    else:
        thetas[1] = replace(theta, values=2 * theta.values)
    before, after = (
        build_stage(c, build_model(c, LineLaw()), ObjectiveWeights(), t).jacobian.source
        for c, t in zip(cells, thetas, strict=True)
    )
    assert before[0] == after[0]
    assert not np.array_equal(before[1], after[1])
