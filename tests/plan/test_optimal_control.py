"""The nonlinear program of a pass: derivatives, solution, and the reason when there is none."""

from copy import copy
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.effects.cell_effects import effect_of
from ocp.model.blade_gap import SurfaceCloud, contact_stations
from ocp.model.prepare import wheel_cover
from ocp.model.theta import Theta, believed_theta
from ocp.plan.clearance import CollisionScene
from ocp.plan.passes import posture
from ocp.plan.passes.coarse import start_on_coarse_grid
from ocp.plan.passes.course import steady
from ocp.plan.passes.optimise import STATION_SPACING, Ground, PassWorker, solve_directly
from ocp.plan.passes.posture import find_seeds
from ocp.plan.passes.problem import PassProblem, with_direction
from ocp.plan.passes.smoothness import axis_rows, axis_use, between_bends, derivative_weights, quadratic_form
from ocp.plan.passes.solve import LEAST_TURN, TURN_KEPT, PassSolver
from ocp.plan.passes.stage import N_PARAMETERS, N_ROWS, N_Z, ObjectiveWeights
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.passes.transcription import AROUND, N_DYNAMIC, N_MOTION, REACH, transcribe
from ocp.plan.removal.footprint import CELL, Pressing, contacts_along, line_patches, planned_patches
from ocp.plan.rules import JERK_TIME, SPEED_SHARE
from robots.errors import Infeasible
from robots.kinematics import link_frames
from tests.support.example_pass import LineLaw, bar_pass, bundled_cell
from trajectories.passes import reversed_path

BAR = np.array([[x, y, z] for x in (-0.04, 0.04) for y in (-0.04, 0.04) for z in (0.0, 0.1)])


@lru_cache
def setting(force_sd=0.0):
    """A cell and its solver, whose programs are built once for all tests."""
    cell = bundled_cell()
    return cell, PassSolver(cell, LineLaw(), believed_theta(cell), ObjectiveWeights(force_sd=force_sd))


def ready(path=None):
    cell, solver = setting()
    path = path or bar_pass()
    seed = find_seeds(cell, CollisionScene(cell, BAR), LineLaw(), [path])[0][0]
    problem = PassProblem.start(path, seed, np.tile([2e-6, 0, 0], (len(path.s), 1)))
    if seed.direction < 0:
        problem = with_direction(problem, reversed_path(path))
    return cell, solver, problem


@pytest.mark.parametrize("force_sd", [0.0, 3.0])
@pytest.mark.parametrize("full", [False, True])
def test_assembled_derivatives_equal_casadis_own(full, force_sd):
    cell, _, problem = ready(bar_pass(n=12))
    solver = setting(force_sd)[1]
    n = 12
    program = transcribe(solver.stage, n, full)
    wave = 1 + 0.1 * np.cos(np.arange(2 * n)).reshape(n, 2)
    x = np.column_stack([problem.seed.q[0] + 1e-3 * np.arange(6 * n).reshape(n, 6), wave]).ravel()
    motion = axis_rows(cell, problem.way, x.reshape(n, 8)[:, :6], n) if full else None
    p = program.pack(
        solver._parameters(problem, n), solver.theta.values, *quadratic_form(cell, problem, solver.weights, n), motion
    )
    nlp = program.solver.get_function("nlp_f"), program.solver.get_function("nlp_g")
    X, P = ca.MX.sym("x", 8 * n), ca.MX.sym("p", len(p))
    f, g = nlp[0](X, P), nlp[1](X, P)
    lam = ca.MX.sym("lam", g.shape[0])
    own = ca.Function("own", [X, P, lam], [ca.gradient(f, X), ca.jacobian(g, X), ca.hessian(f + ca.dot(lam, g), X)[0]])
    multipliers = np.cos(np.arange(g.shape[0]))
    gradient, jacobian, hessian = (np.asarray(ca.DM(v)) for v in own(x, p, multipliers))
    assert np.asarray(program.solver.get_function("nlp_grad_f")(x, p)[1]).ravel() == pytest.approx(gradient.ravel(), rel=1e-9)
    assert np.asarray(ca.DM(program.solver.get_function("nlp_jac_g")(x, p)[1])) == pytest.approx(jacobian, rel=1e-9, abs=1e-9)
    assembled = np.asarray(ca.DM(program.solver.get_function("nlp_hess_l")(x, p, 1.0, multipliers)))
    scale = np.abs(hessian).max()
    assert np.triu(assembled) == pytest.approx(np.triu(hessian), rel=1e-8, abs=1e-9 * scale)


def test_speed_acceleration_and_jerk_are_those_of_the_motion_in_time():
    """Along a cubic in a time that runs unevenly against the path parameter: derivatives by parabolas, to the order of a step."""
    cell, _, problem = ready(bar_pass(n=200))
    at, robot = problem.way.at, cell.robot
    time = at + 0.05 * at**2 / at[-1]  # rate = d at / d time
    rate, q = 1 / (1 + 0.1 * at / at[-1]), problem.seed.q[0] + np.outer(time - 1.0, 1e-2 * np.arange(1, 7)) ** 3
    use = axis_use(cell, problem.way, q, rate)
    slope, inner = 1e-2 * np.arange(1, 7), slice(3, -3)
    for part, known, limit in (
        (0, np.outer((time - 1.0) ** 2, 3 * slope**3), robot.qd_max),
        (1, np.outer(time - 1.0, 6 * slope**3), robot.qdd_max),
        (3, np.outer(np.ones(200), 6 * slope**3), robot.qdd_max / JERK_TIME),
    ):
        assert use[inner, 6 * part : 6 * part + 6] == pytest.approx(np.abs(known / limit)[inner], rel=0.02, abs=1e-8)


def test_the_jerk_of_a_cubic_is_that_of_a_cubic_where_nodes_stand_ten_times_closer():
    at = np.concatenate([np.arange(0.0, 0.7, 0.07), 0.7 + 0.007 * np.arange(20), 0.9 + 0.02 * np.arange(20)])
    _, D2 = derivative_weights(at)
    bend = D2 @ (at - 0.3) ** 3
    assert (np.diff(bend) / between_bends(at))[1:-1] == pytest.approx(6.0)


def test_a_jolt_of_the_seed_is_driven_within_the_limit_of_jerk(monkeypatch):
    """With a limit that the way without it breaks, the rows of axis limits keep it."""
    monkeypatch.setattr("ocp.plan.passes.solve.JERK_TIME", 1.0)
    monkeypatch.setattr("ocp.plan.passes.smoothness.JERK_TIME", 1.0)
    cell, solver, problem = ready()
    free = solver._solve(problem, None, full=False)
    jerk = axis_use(cell, problem.way, free.q, free.rate)[:, 18:].max()
    for module in ("solve", "smoothness"):
        monkeypatch.setattr(f"ocp.plan.passes.{module}.JERK_TIME", SPEED_SHARE / (0.9 * jerk))  # nine tenths of what it takes
    kept = solver.solve(problem)
    assert axis_use(cell, problem.way, free.q, free.rate)[:, 18:].max() > SPEED_SHARE
    assert axis_use(cell, problem.way, kept.q, kept.rate)[:, 18:].max() <= SPEED_SHARE + 1e-5
    # A problem close by needs the rows too: it is not solved without them first.
    plain, asked = solver._solve, []
    monkeypatch.setattr(solver, "_solve", lambda *args, full: asked.append(full) or plain(*args, full=full))
    again = solver.solve(replace(problem, indentation_correction=problem.indentation_correction + 1e-6), kept)
    assert kept.limited and again.limited and all(asked) and len(asked) < 4
    assert axis_use(cell, problem.way, again.q, again.rate)[:, 18:].max() <= SPEED_SHARE + 1e-5


def test_effects_see_the_setpoint_that_is_commanded():
    """Not what the calibrated flange then sets: logs have the commanded one."""
    cell, _, problem = ready()
    told = replace(cell, flange=replace(cell.flange, setpoint=20.7), effects=(effect_of({"effect": "sensor_bias", "N": 0.4}),))
    assert set(problem.named_conditions(told)["setpoint"].ravel()) == {20.0}


def test_machine_code_is_made_once_what_few_waypoints_take_would_pay_it(monkeypatch):
    _, solver, problem = ready()
    first, made = solver.solve(problem), []
    monkeypatch.setattr(solver, "compile", lambda quietly: made.append(len(solver._programs)))
    monkeypatch.setattr(solver._evaluate, "library", None)  # as if nothing were compiled
    monkeypatch.setattr("ocp.plan.passes.solve.LONG_TRIED", solver._iterated + 1)
    assert solver._iterated > first.iterations
    again = solver.solve(problem)
    assert len(made) == 1 and made[0] > 0 and not solver._programs and again.objective == first.objective
    assert solver.solve(problem).objective == first.objective and len(made) == 1 and solver._programs


def test_hessian_and_jacobian_stay_banded():
    _, solver, _ = ready()
    program = transcribe(solver.stage, 64, True)
    rows = program.solver.get_function("nlp_jac_g").sparsity_out(1)
    assert rows.nnz() <= 64 * (N_ROWS * N_Z + N_DYNAMIC * len(AROUND) * N_Z)
    assert program.solver.get_function("nlp_hess_l").sparsity_out(0).bw_upper() <= N_Z * REACH
    assert N_PARAMETERS * 64 + Theta.size + program.pattern.nnz + 64 * (N_Z + N_MOTION) == program.solver.size1_in("p")


def test_a_pass_holds_its_force_inside_every_tolerance():
    cell, solver, problem = ready()
    solution = solver.solve(problem)
    seen = solver.evaluate(problem, solution.q, solution.force)
    assert np.abs(seen.residual).max() < 1e-9
    assert solution.force == pytest.approx(np.full(40, 20.0))
    process = cell.process
    assert np.abs(seen.turn).max() <= process.turn_tolerance + 1e-6
    assert np.abs(seen.lateral).max() <= process.lateral_tolerance + 1e-8
    assert np.abs(np.arctan(seen.tilt)).max() <= process.tilt_tolerance + 1e-6
    assert (seen.arc >= cell.wheel.arc[0] - 1e-6).all() and (seen.arc <= cell.wheel.arc[1] + 1e-6).all()
    assert (solution.q > cell.robot.q_min).all() and (solution.q < cell.robot.q_max).all()
    assert (np.abs(np.diff(solution.q, axis=0)) <= SPEED_SHARE * problem.seconds[:, None] * cell.robot.qd_max + 1e-9).all()


def test_at_a_turn_tolerance_of_zero_axes_need_not_follow_the_scatter_of_feed_directions():
    cell, solver, problem = ready()
    zero, path = copy(solver), problem.path
    zero.cell = replace(cell, process=replace(cell.process, turn_tolerance=0.0))
    scatter = (0.4 * LEAST_TURN * (-1.0) ** np.arange(len(path.s)))[:, None]
    problem = replace(problem, path=replace(path, t=path.t * np.cos(scatter) + np.cross(path.n, path.t) * np.sin(scatter)))
    solution = zero.solve(problem)
    assert np.abs(zero.evaluate(problem, solution.q, solution.force).turn).max() <= LEAST_TURN + 1e-6
    assert axis_use(cell, problem.way, solution.q, solution.rate).max() < 0.5 * SPEED_SHARE


def test_the_solution_does_not_depend_on_padding():
    _, solver, problem = ready()
    a = solver.solve(problem)
    exact = copy(solver)
    exact._programs = {(solver.program(40).n, False): transcribe(solver.stage, 40, False)}
    b = exact.solve(problem)
    assert exact.program(40).n == 40 < solver.program(40).n
    assert a.q == pytest.approx(b.q, abs=1e-4)  # where the freedoms are held by their boxes the optimum is flat
    # Where a row is active at every node it is at the padded ones too: begun close by, that costs no iteration.
    again = []
    for turn in (0.0, 0.3):
        line = ready(replace(bar_pass(n=110), turn=turn))[2]
        close = replace(line, indentation_correction=np.full(110, 1e-6))
        again.append(solver.solve(close, solver.solve(line)).iterations)
    assert again[1] <= again[0]


def test_begun_on_a_coarse_grid_a_pass_ends_where_one_from_its_seed_does():
    _, solver, problem = ready(bar_pass(n=120))
    plain, start = solver.solve(problem), start_on_coarse_grid(solver, problem)
    found = solver.solve(problem, start)
    assert found.iterations < 0.7 * plain.iterations
    away = np.abs(solver.seed_joints(problem) - plain.q).max()
    assert np.abs(start.q - plain.q).max() < 0.1 * away > 1e-3
    assert np.abs(found.q - plain.q).max() < 2e-4 and found.objective < plain.objective + 1e-4
    assert len(ready(bar_pass(n=6))[2].at_nodes(np.arange(3)).way.edges) == 6
    # On few nodes nothing is gained, nor with the force's variance or at axis limits; without a solution the seed is the start.
    assert start_on_coarse_grid(setting(3.0)[1], problem) is None
    lazy = SimpleNamespace(weights=solver.weights, seed_joints=solver.seed_joints)
    lazy.solve = lambda few: replace(start, q=solver.seed_joints(few), multipliers=None)
    assert start_on_coarse_grid(lazy, problem) is None
    assert start_on_coarse_grid(solver, ready(bar_pass(n=7))[2]) is None
    problem.clearances[:, 0] = [1.0, 0, 0, 0, 0, 0, 3.0]  # axis 1 above 3 rad: impossible
    assert start_on_coarse_grid(solver, problem) is None


def test_what_fails_from_a_start_is_solved_from_its_seed(monkeypatch):
    """Whatever the optimiser stopped with: what is told then is of the seed too."""
    _, solver, problem = ready()
    plain, solve, starts = solver.solve(problem), solver._solve, []

    def failing(problem, start, full):
        starts.append(start)
        if start is not None:
            raise Infeasible("the optimiser stopped with Search_Direction_Becomes_Too_Small")
        return solve(problem, start, full)

    monkeypatch.setattr(solver, "_solve", failing)
    assert solver.solve(problem, plain).objective == plain.objective and starts[0] is plain and starts[1] is None


def test_a_force_programmed_per_waypoint_is_met():
    force = np.linspace(15.0, 25.0, 40)
    _, solver, problem = ready(replace(bar_pass(), force=force))
    solution = solver.solve(problem)
    seen = solver.evaluate(problem, solution.q, solution.force)
    assert solution.force == pytest.approx(problem.path.force)
    assert np.abs(seen.residual).max() < 1e-9
    assert np.ptp(seen.parts[:, 0]) == pytest.approx(10.0 / 5600.0)


def test_weight_on_the_standard_deviation_lowers_it():
    _, solver, problem = ready()
    _, careful = setting(3.0)
    plain = solver.solve(problem)
    safe = careful.solve(problem)
    before = solver.evaluate(problem, plain.q, plain.force).force_sd.mean()
    after = solver.evaluate(problem, safe.q, safe.force).force_sd.mean()
    assert after < 0.995 * before


def test_a_hidden_constraint_is_named_with_its_amount():
    cell, solver, problem = ready()
    tight = replace(cell, wheel=replace(cell.wheel, arc=(1.2, 1.3)), process=replace(cell.process, tilt_tolerance=1e-3))
    walled = PassSolver(tight, LineLaw(), solver.theta, ObjectiveWeights())
    clearances = problem.clearances.copy()
    clearances[17, 0] = [1.0, 0, 0, 0, 0, 0, 3.0]  # axis 1 above 3 rad there: impossible
    with pytest.raises(Infeasible, match=r"line 1 \(convex\), waypoint \d+ of 40: .*(clearance|arc|axis \d)"):
        walled.solve(replace(problem, clearances=clearances))


def test_a_feed_beyond_the_axes_is_refused_with_the_axis():
    _, solver, problem = ready(bar_pass(n=20))
    path = replace(problem.path, feed=np.full(20, 40.0))
    fast = replace(problem, path=path, course=steady(path))
    with pytest.raises(Infeasible, match=r"the (speed|acceleration|torque) of axis \d cannot be kept|cannot be met"):
        solver.solve(fast)


def test_seeds_choose_the_direction_in_which_the_blade_moves_with_the_belt():
    cell, _, problem = ready()
    assert problem.seed.direction in (1, -1)
    path = bar_pass()
    forward = find_seeds(cell, CollisionScene(cell, BAR), LineLaw(), [path])[0][0]
    backward = find_seeds(cell, CollisionScene(cell, BAR), LineLaw(), [reversed_path(path)])[0][0]
    assert forward.direction == -backward.direction
    assert forward.cost == pytest.approx(backward.cost, rel=1e-3)


def reaches_over(cell, q):
    """Whether the wrist ever lies behind axis 1, seen along the arm's own direction."""
    wrist = link_frames(cell.robot, q)[:, 4, :3, 3]
    ahead = q[:, 0] * cell.robot.sign[0]
    return bool((wrist[:, 0] * np.cos(ahead) + wrist[:, 1] * np.sin(ahead) < 0).any())


def test_seeds_of_all_windings_lie_inside_the_ranges_and_cost_what_their_axes_do(monkeypatch):
    cell, found = setting()[0], []
    families = posture._families

    def kept(*arguments):
        found.extend(seeds := families(*arguments))
        return seeds

    monkeypatch.setattr(posture, "_families", kept)
    find_seeds(cell, CollisionScene(cell, BAR), LineLaw(), [bar_pass()])
    low, high = cell.robot.q_min, cell.robot.q_max
    assert all((seed.q > low).all() and (seed.q < high).all() for seed in found)
    by_place: dict[bytes, list[float]] = {}
    over: list[float] = []
    for seed in found:
        own = 0.02 * np.max(np.abs(seed.q[:, [3, 5]]) / np.pi) ** 2
        own += 0.5 * np.max(np.abs(seed.q - 0.5 * (low + high)) / (0.5 * (high - low))) ** 4
        place = np.round(np.hstack([np.cos(seed.q), np.sin(seed.q)]), 9) + 0.0
        by_place.setdefault(place.tobytes() + bytes([seed.direction % 3]), []).append(seed.cost - own)
        if reaches_over(cell, seed.q):
            over.append(seed.cost - own)
    assert over and min(over) >= 0.5
    assert max(map(len, by_place.values())) >= 3
    for same in map(np.array, by_place.values()):
        assert same == pytest.approx(same[0], rel=1e-9)


def girth_pass(feed, n=40, radius=0.04, half=0.45):
    """Round the bar: over its +y side, half rad to either side."""
    angle = np.linspace(-half, half, n)
    n_, t = (
        np.column_stack([np.sin(angle), np.cos(angle), 0 * angle]),
        np.column_stack([np.cos(angle), -np.sin(angle), 0 * angle]),
    )
    path = replace(bar_pass(n), p=radius * n_ + [0, 0, 0.06], n=n_, t=t, s=radius * (angle + half), feed=np.full(n, feed))
    return replace(path, curvature=np.tile([1 / radius, 0.0, 0.0], (n, 1)))


def test_a_seed_rolls_over_the_arc_where_a_held_one_would_be_too_fast(monkeypatch):
    cell, solver = setting()
    path, scene = girth_pass(0.16), CollisionScene(cell, BAR)
    seed = find_seeds(cell, scene, LineLaw(), [path])[0][0]
    low, high = cell.wheel.arc
    assert np.ptp(seed.arc) > 0.6 * (high - low) and low < seed.arc.min() and seed.arc.max() < high
    speed = np.abs(np.diff(seed.q, axis=0)) / (np.diff(seed.at) * path.s[-1] / 0.16)[:, None] / cell.robot.qd_max
    assert speed.max() < 0.5
    problem = PassProblem.start(path, seed, np.tile([2e-6, 0, 0], (40, 1)))
    problem = with_direction(problem, reversed_path(path)) if seed.direction < 0 else problem
    q = solver.seed_joints(problem)
    seen = solver.evaluate(problem, q, path.force)
    assert np.interp(seed.at, path.s / path.s[-1], seen.arc) == pytest.approx(seed.arc, abs=2e-3)
    assert np.abs(np.vstack([seen.turn - seed.turn, 1e2 * seen.lateral, seen.tilt.T])).max() < 2e-3
    assert np.abs(solver.solve(problem).force - path.force).max() < 1e-3
    nothing = posture._Ways(np.zeros((0, 8, 7)), np.zeros(0), np.zeros((0, 8, 7, 6)), np.zeros((0, 8), bool))
    monkeypatch.setattr(posture, "_rolled", lambda *_: nothing)
    with pytest.raises(Infeasible, match=r"an axis would need 1\d\d % of its speed"):
        find_seeds(cell, scene, LineLaw(), [path])


def test_an_unreachable_wheel_is_refused_with_the_reason():
    cell, _, _ = ready()
    away = replace(cell, wheel=replace(cell.wheel, centre=np.array([4.0, 0.0, 0.9])))
    with pytest.raises(Infeasible, match="reach"):
        find_seeds(away, CollisionScene(away, BAR), LineLaw(), [bar_pass()])


# -- a wheel that stands askew -------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [0.3, -0.3])
def test_a_line_that_asks_for_a_turn_is_ground_with_it(turn):
    _, solver, straight = ready()
    _, _, problem = ready(replace(bar_pass(), turn=turn))
    assert np.sign(problem.seed.turn) == np.sign(turn) and abs(problem.seed.turn) > 0.2
    for one, asked in ((problem, True), (straight, False)):
        solution = solver.solve(one)
        seen = solver.evaluate(one, solution.q, solution.force)
        least = TURN_KEPT * min(abs(turn), abs(problem.seed.turn))
        assert ((np.sign(turn) * seen.turn).min() >= least - 1e-6) == asked


def test_a_turn_that_its_seed_has_not_is_not_asked_for():
    cell, solver, problem = ready()
    rows = lambda one: tuple(bound.reshape(40, -1)[0, 3] for bound in solver._row_bounds(one, 40, False))  # noqa: E731
    tolerance = cell.process.turn_tolerance
    askew = replace(problem, path=replace(problem.path, turn=0.3))
    for seed, limit, low, high in (
        (0.4, np.inf, TURN_KEPT * 0.3, tolerance),
        (0.2, np.inf, TURN_KEPT * 0.2, tolerance),
        (-0.2, np.inf, -tolerance, tolerance),
        (0.4, 0.1, -0.1, 0.1),  # where a turned wheel touches the blade elsewhere
    ):
        one = replace(askew, seed=replace(problem.seed, turn=seed), turn_limit=limit)
        assert rows(one) == pytest.approx((low, high))
        turned = replace(one, path=replace(one.path, turn=-0.3), seed=replace(one.seed, turn=-seed))
        assert rows(turned) == pytest.approx((-high, -low))


def test_the_patch_planned_at_a_turn_is_that_of_a_posture_with_it():
    """`planned_patches` knows no posture; here the same twisted blade at the turn and curvatures of joints."""
    cell, solver, _ = ready()
    cover = wheel_cover(cell)

    def moments(patches, k):
        t, b = np.meshgrid(patches.x, patches.x, indexing="ij")
        return [float((patches.share[k] * one).sum() * CELL**2) for one in (t * t, b * b, t * b)]

    for turn in (0.35, -0.35):
        _, _, problem = ready(replace(bar_pass(), turn=turn))
        path = replace(problem.path, curvature=np.tile([3.0, 25.0, 12.0], (40, 1)), turn=problem.seed.turn)
        there = replace(problem, path=path)
        seen = solver.evaluate(there, solver.seed_joints(there), path.force)
        along = -cell.wheel.travel * cell.process.sigma
        heading = (along * float(np.cos(seen.turn[20])), along * float(np.sin(seen.turn[20])))
        shape = LocalShape(*map(float, seen.curvature[20]), extent=path.extent[20], heading=heading)
        direct = line_patches(np.zeros(1), [solve_force(cover, 20.0, shape)], [heading])
        planned = planned_patches(Pressing.of(cell), cover, path)
        assert seen.turn[20] == pytest.approx(path.turn, abs=0.03)
        assert moments(planned, len(planned.at) // 2) == pytest.approx(moments(direct, 0), rel=0.05)


@pytest.mark.parametrize("toward", [1.0, -1.0])
def test_a_wheel_over_an_edge_presses_on_the_side_where_there_is_blade(toward):
    """The bar ends 2 mm beside the pass, along its binormal n x t or against it: in the blade's frame, no word of the wheel's."""
    cell, solver, problem = ready()
    path, k = problem.path, 20
    seen = solver.evaluate(problem, solver.seed_joints(problem), path.force)
    z, angle = (g.ravel() for g in np.meshgrid(path.p[k, 2] + np.arange(-0.024, 0.0241, 4e-4), np.arange(-0.6, 0.601, 0.01)))
    normal = np.column_stack([np.sin(angle), np.cos(angle), 0 * z])
    points = 0.04 * normal + np.column_stack([0 * z, 0 * z, z])
    there = toward * (points - path.p[k]) @ np.cross(path.n[k], path.t[k]) < 2e-3
    patches = contacts_along(cell, wheel_cover(cell), SurfaceCloud(points[there], normal[there]), path, seen, np.array([k]))
    across = patches.share[0].sum(axis=0) * CELL**2 @ patches.x
    assert -5e-3 < toward * across < -5e-4, across


def test_a_first_solve_is_pressed_in_as_the_contact_solved_directly_is():
    """What the law misses at a seed's postures is what the contact solved directly there has more, on a bar all round."""
    cell, solver, problem = ready()
    path = problem.path
    z, angle = (g.ravel() for g in np.meshgrid(np.arange(0.0, 0.1201, 4e-4), np.arange(-0.6, 0.601, 0.01)))
    normal = np.column_stack([np.sin(angle), np.cos(angle), 0 * z])
    cloud = SurfaceCloud(0.04 * normal + np.column_stack([0 * z, 0 * z, z]), normal)
    ground = Ground(cell, solver.theta, solver.weights, solver.law, wheel_cover(cell), BAR, cloud, np.zeros((0, 3)))  # type: ignore[arg-type]
    looked = PassWorker(ground, solver)._driven(problem)
    known = replace(problem, indentation_correction=np.interp(path.s, looked.patches.at, looked.missed))
    q = solver.seed_joints(problem)
    direct = solve_directly(ground, known, path.force, solver.evaluate(known, q, path.force))
    at = np.searchsorted(path.s, looked.patches.at)
    assert np.abs(looked.missed).max() > 5e-5
    assert direct[at] == pytest.approx(looked.missed, abs=2e-6)
    seen = solver.evaluate(known, q, path.force)
    between = contact_stations(path.s, STATION_SPACING)[1]  # one that its neighbours tell
    hollow = replace(seen, curvature=np.where((np.arange(len(path.s)) == between)[:, None], -seen.curvature, seen.curvature))
    with pytest.raises(CannotGrind, match="hollow along the belt"):
        solve_directly(ground, known, path.force, hollow)
