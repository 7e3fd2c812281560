"""The limits of a plan: for every rule of ocp/plan/rules.py that refuses, one case just inside and one just outside.

Each is put to the function that decides. Rules that refuse nothing themselves have no such pair: they shape what is planned, and
others judge the result.
- DIRECT_TOLERANCE ends the corrections; FLANGE_FORCE_TOLERANCE judges what is left.
- SINGULARITY_SHARE on wrist and elbow, and AXIS_MARGIN beyond the seeds, are bounds that the optimiser cannot leave.
- LIMIT_SHARE on speed and acceleration is what the timed motion uses; FEED_TOLERANCE judges what is left of the feed.
- HOLDER_RADIUS, HOLDER_SHARE, FLOOR_BELOW_WHEEL, WHEEL_ROOM are shapes; the margins judge them.
- UPRIGHT says which planes are there (tests/plan/test_safe_to_move.py).
- COLLISION_STEP says how densely moves are looked at; LIFT_OFF, HOME_LIFT and APPROACH_SPEED say how moves are laid.
- TOUCH_SPEED, CREEP, LEAST_RAMP and CARRIED_FORCE say how a pass begins and ends.
- EMITTED_FORCE_SHARE, EMITTED_TOLERANCE and EMITTED_AIR_TOLERANCE say how points are thinned out; the text is read back.
"""

import ast
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ocp.data import CELL
from ocp.model.blade_gap import SurfaceCloud
from ocp.plan import readback, rules
from ocp.plan.clearance import Clearance, CollisionScene
from ocp.plan.grades import CALIBRATED, NOT_TO_GRIND, Grade, Grades, grade_force, grade_move, stop_preload
from ocp.plan.motion import _timed as _timed_pass
from ocp.plan.motion import is_free
from ocp.plan.passes import posture
from ocp.plan.passes.course import steady
from ocp.plan.passes.optimise import PassesNear, TouchesElsewhere, refuse_ends, refuse_near, refuse_unsound
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.smoothness import axis_use
from ocp.plan.passes.solve import PassSolver, refuse_violated
from ocp.plan.passes.stage import N_PLAIN_ROWS, N_ROWS, ROWS
from ocp.plan.passes.stretches import CannotGrind, LeftOut, LineStretch, cut_out, refuse_mostly_left_out, whole_lines
from ocp.plan.passes.transcription import N_DYNAMIC
from ocp.plan.paths import PlanOptions, refuse_flange
from ocp.plan.planning import make_plan
from ocp.plan.programming import force_allowed
from ocp.plan.readback import BlendError, Readback, _timed, force_error
from ocp.plan.removal.dwell import beyond_reach
from ocp.plan.removal.wanted import Wanted
from ocp.plan.second_route import VerifiedPass
from ocp.shell.progress import Phases
from robots.calibration.store import Calibration
from robots.errors import BadInput, Infeasible
from robots.gravity import GRAVITY
from robots.kinematics import link_frames
from robots.pose import make_transform
from robots.rigid_body import inverse_dynamics
from tests.support import invented_motion
from tests.support.block_blade import BLOCK, blade_before_wheel, joints_of
from tests.support.example_pass import bar_pass, bundled_cell
from tests.support.house import ROOT
from tests.support.round_bar import CONTACT, RADIUS, buried, on_wheel
from trajectories.blade.window import GAP
from trajectories.joint_trajectory import Limits
from trajectories.program.driven import reinterpolate
from trajectories.timing import RESERVE, time_joint_move

NAMES = [name for name in vars(rules) if name.isupper()]
READY = np.radians([3.0, -80.0, 95.0, 10.0, 50.0, 20.0])
HOME = np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0])


@pytest.fixture(scope="module")
def cell():
    return bundled_cell()


# -- the file itself -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_rule_says_its_unit_what_it_guards_and_why_and_is_used(name):
    body = ast.parse(Path(str(rules.__file__)).read_text()).body
    at = next(i for i, node in enumerate(body) if isinstance(node, ast.Assign) and node.targets[0].id == name)
    text = body[at + 1].value.value
    assert text.startswith("[") and "Guards:" in text and "Reason:" in text
    users = [p for p in (ROOT / "ocp").rglob("*.py") if p.name != "rules.py" and name in p.read_text()]
    assert users, f"nobody uses {name}"
    assert name in Path(__file__).read_text(), f"{name}: no case just inside and outside, and no word why"


def test_margins_are_written_nowhere_else():
    for path in (ROOT / "ocp" / "plan").rglob("*.py"):
        if path.name != "rules.py":
            for node in ast.parse(path.read_text()).body:
                targets = node.targets if isinstance(node, ast.Assign) else []
                names = {t.id for t in targets if isinstance(t, ast.Name)}
                assert not names & set(NAMES) and not any(word in name for name in names for word in ("MARGIN", "RESERVE")), path


# -- postures ------------------------------------------------------------------------------------------------------


def seeds(cell, q, feed_share=0.0):
    """Seeds that stand at q (6,) at all stations, axis 1 turning at a share of its limit; and why there are none."""
    path = bar_pass()
    index = np.unique(np.linspace(0, len(path.s) - 1, posture.STATIONS).round().astype(int))
    seconds = (path.s[index] - path.s[0]) / path.feed.mean()
    along = np.tile(q, (1, 8, len(index), 1))
    along[..., 0] += feed_share * cell.robot.qd_max[0] * seconds
    reasons: list[tuple[float, str]] = []
    only = np.arange(8)[None] == 0
    ways = posture._Ways(np.zeros(along.shape[:3]), np.zeros(1), along, only)
    found = posture._families(cell, path, index, 1, ways, reasons)
    return found, " ".join(text for _, text in reasons)


def with_axis(j, value, q=READY):
    q = q.copy()
    q[j] = value
    return q


def with_shoulder(cell, radius):
    """A posture, leaning back, with the wrist's centre `radius` m from axis 1."""
    leaning = lambda a3: np.array([READY[0], np.radians(-120.0), a3, *READY[3:]])  # noqa: E731
    off = lambda a3: float(posture.wrist_radius(cell, leaning(a3))) - radius  # noqa: E731
    return leaning(brentq(off, np.radians(30.0), np.radians(70.0)))


def stretched(cell, more):
    return with_axis(2, float(np.arctan2(cell.robot.mdh[2, 2], cell.robot.mdh[3, 1])) + more)


POSTURES = {
    "AXIS_MARGIN": (lambda c, e: with_axis(4, c.robot.q_max[4] - rules.AXIS_MARGIN - e), "beyond its limit"),
    "AXIS_MARGIN, lower end": (lambda c, e: with_axis(4, c.robot.q_min[4] + rules.AXIS_MARGIN + e), "beyond its limit"),
    "AXIS_MARGIN, axis 2": (lambda c, e: with_axis(1, c.robot.q_max[1] - rules.AXIS_MARGIN - e), "beyond its limit"),
    "AXIS_MARGIN, axis 3": (lambda c, e: with_axis(2, c.robot.q_min[2] + rules.AXIS_MARGIN + e), "beyond its limit"),
    "WRIST_MARGIN": (lambda c, e: with_axis(4, rules.WRIST_MARGIN + e), "wrist singularity"),
    "WRIST_MARGIN, other side": (lambda c, e: with_axis(4, -rules.WRIST_MARGIN - e), "wrist singularity"),
    "SHOULDER_MARGIN": (lambda c, e: with_shoulder(c, rules.SHOULDER_MARGIN + e), "overhead singularity"),
    "ELBOW_MARGIN": (lambda c, e: stretched(c, rules.ELBOW_MARGIN + e), "near a singularity"),
    "ELBOW_MARGIN, other side": (lambda c, e: stretched(c, -rules.ELBOW_MARGIN - e), "near a singularity"),
}


@pytest.mark.parametrize("name", POSTURES)
def test_a_posture_just_inside_is_a_seed_just_outside_none(cell, name):
    make, sentence = POSTURES[name]
    assert seeds(cell, make(cell, 1e-6))[0]
    found, reason = seeds(cell, make(cell, -1e-6))
    assert not found and sentence in reason


def test_a_feed_that_needs_nearly_an_axis_limit_is_no_seed(cell):
    assert seeds(cell, READY, rules.SEED_SPEED_SHARE - 1e-6)[0]
    found, reason = seeds(cell, READY, rules.SEED_SPEED_SHARE + 1e-6)
    assert not found and "speed limit at the programmed feed" in reason


def test_a_wheel_that_hardly_bears_is_refused(cell):
    def bears(indentation):
        law = SimpleNamespace(limits={"kxx": (1.0, 1e4)}, evaluate=lambda force, *shape: np.full(len(force), indentation))
        reasons: list[tuple[float, str]] = []
        good = posture._bears(cell, law, bar_pass(), np.array([0, 20, 39]), np.zeros(1), reasons)  # type: ignore[arg-type]
        return bool(good.all()), reasons

    assert bears(rules.SEED_INDENTATION + 1e-9) == (True, [])
    good, reasons = bears(rules.SEED_INDENTATION - 1e-9)
    assert not good and "too hollow" in reasons[0][1]


# -- the optimiser's rows ------------------------------------------------------------------------------------------


def bare(cell, **limits):
    """What of a solver knows the bounds, with other limits of the robot; no model is compiled."""
    one = object.__new__(PassSolver)
    one.cell, one.limits = replace(cell, robot=replace(cell.robot, **limits)), {}
    return one


@pytest.fixture(scope="module")
def solver(cell):
    return bare(cell)


def problem(q=READY):
    seed = Seed(1, 0, np.zeros(7), 0.0, np.tile(q, (7, 1)), np.linspace(0, 1, 7), 0.0)
    return PassProblem.start(bar_pass(), seed, np.zeros((40, 3)))


def judge(solver, value, row=None, axis=None):
    """Put a pass to the test whose rows are all met but for `row` (or the speed of `axis`) of waypoint 18, which is `value`."""
    one, full = problem(), axis is not None
    low, high = solver._row_bounds(one, 40, full)
    g = np.clip(0.0, low, high)
    rows = N_ROWS if full else N_PLAIN_ROWS
    g[17 * rows + row if axis is None else rows * 40 + N_DYNAMIC * 17 + axis] = value
    refuse_violated(one.path, np.maximum(low - g, g - high), full, "Solve_Succeeded")


ROW = {name.split(" (")[0]: i for i, (name, _, _) in enumerate(ROWS)}


def test_the_wrist_is_kept_off_axis_1(solver):
    least, row = rules.SINGULARITY_SHARE * rules.SHOULDER_MARGIN, ROW["distance of the wrist from axis 1"]
    judge(solver, least + 1e-4, row)
    with pytest.raises(Infeasible, match=r"waypoint 18 of 40: distance of the wrist from axis 1 .* 0\.1 mm are missing"):
        judge(solver, least - 1e-4, row)


def test_the_wheel_has_to_bear_at_the_planned_point(solver):
    row = ROW["overlap of the wheel at the planned point"]
    judge(solver, 1e3 * (rules.LEAST_INDENTATION + 1e-6), row)
    with pytest.raises(Infeasible, match="overlap of the wheel at the planned point .* cannot be met"):
        judge(solver, 1e3 * (rules.LEAST_INDENTATION - 1e-6), row)


def test_the_force_may_not_peak(solver):
    most, row = 1.25 * bar_pass().force[0], ROW["contact force"]
    judge(solver, most - 1e-4, row)
    with pytest.raises(Infeasible, match="waypoint 18 of 40: contact force cannot be met, 0.0001 N are missing"):
        judge(solver, most + 1e-4, row)
    assert rules.PEAK_FORCE == 1.25


def test_an_axis_may_not_use_all_of_its_speed(cell, solver):
    speed = rules.SPEED_SHARE * cell.robot.qd_max[3]
    judge(solver, speed - 1e-4, axis=3)
    with pytest.raises(Infeasible, match=r"the speed of axis 4 cannot be kept within its limit"):
        judge(solver, speed + 1e-4, axis=3)
    at = problem().way.at[:, None]
    for more, broken in ((-1e-4, False), (1e-4, True)):
        turning = READY + at * np.array([0.0, 0.0, 0.0, speed + more, 0.0, 0.0])
        assert solver._breaks_lazy_rows(problem(), SimpleNamespace(q=turning, rate=np.ones(40))) is broken


@pytest.mark.parametrize(("what", "feed", "row"), [("acceleration", 0.04, 7), ("jerk", 0.4, 19)])
def test_an_axis_keeps_a_share_of_its_acceleration_and_builds_it_up_in_its_time(cell, solver, what, feed, row):
    limit = rules.SPEED_SHARE * cell.robot.qdd_max[1] / (rules.JERK_TIME if what == "jerk" else 1.0)
    judge(solver, limit - 1e-3, axis=row)
    with pytest.raises(Infeasible, match=rf"the {what} of axis 2 cannot be kept within its limit"):
        judge(solver, limit + 1e-3, axis=row)
    path = bar_pass(feed=feed)
    one = replace(problem(), path=path, course=steady(path))
    swing = np.outer(np.sin(4 * np.pi * one.way.at / one.way.at[-1]) ** 4, np.eye(6)[1])  # no acceleration at its ends
    most = axis_use(cell, one.way, READY + 1e-3 * swing, np.ones(40))[:, row].max()
    for share, broken in ((rules.SPEED_SHARE - 1e-4, False), (rules.SPEED_SHARE + 1e-4, True)):
        there = READY + 1e-3 * share / most * swing
        assert solver._breaks_lazy_rows(one, SimpleNamespace(q=there, rate=np.ones(40))) is broken


def test_an_axis_may_not_use_all_of_its_torque(cell, solver):
    judge(solver, rules.SPEED_SHARE - 1e-4, axis=13)
    with pytest.raises(Infeasible, match=r"the torque of axis 2 cannot be kept within its limit"):
        judge(solver, rules.SPEED_SHARE + 1e-4, axis=13)
    payload, still = cell.workpiece.payload, np.zeros((1, 6))
    held = np.abs(inverse_dynamics(cell.robot, payload.mass, payload.com, READY[None], still, still)[0, 1])
    for share, broken in ((rules.SPEED_SHARE - 1e-4, False), (rules.SPEED_SHARE + 1e-4, True)):
        weak = bare(cell, torque_max=np.where(np.arange(6) == 1, held / share, cell.robot.torque_max))
        assert weak._breaks_lazy_rows(problem(), SimpleNamespace(q=np.tile(READY, (40, 1)), rate=np.ones(40))) is broken


@pytest.mark.parametrize(("wrist", "elbow"), [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
def test_the_optimiser_stays_off_the_ends_of_axes_and_singularities(cell, solver, wrist, elbow):
    """On either side of wrist and elbow: the singularity bounds the axis to one side, the end of its range to the other."""
    seed = with_axis(4, wrist * READY[4], stretched(cell, elbow * np.radians(20.0)))
    low, high = (bound.reshape(40, 8)[:, :6] for bound in solver._bounds(problem(seed), 40))
    least, most = cell.robot.q_min + rules.AXIS_MARGIN, cell.robot.q_max - rules.AXIS_MARGIN
    for axis, side, margin, at in ((4, wrist, rules.WRIST_MARGIN, 0.0), (2, elbow, rules.ELBOW_MARGIN, stretched(cell, 0.0)[2])):
        (least if side > 0 else most)[axis] = at + side * rules.SINGULARITY_SHARE * margin
    np.testing.assert_allclose(low, np.tile(least, (40, 1)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(high, np.tile(most, (40, 1)), rtol=0, atol=1e-12)


# -- solved passes -------------------------------------------------------------------------------------------------


def solved(T=None, stroke=0.0, curvature=(0.0, 0.0, 0.0), turn=0.0):
    T = np.eye(4) if T is None else T
    numbers = {"curvature": np.array([curvature]), "tilt": np.zeros((1, 2)), "delta": np.full(1, 2e-4), "turn": np.full(1, turn)}
    return SimpleNamespace(T_base_blade=T[None], parts=np.array([[stroke, 0.0, 0.0, 0.0]]), **numbers)


def put_to_test(cell, scene=None, points=None, q=HOME, **evaluation):
    free = SimpleNamespace(clearance=lambda q, in_contact: Clearance(0.0, 0, ("hand", "wheel")))
    path = SimpleNamespace(line=3, side="convex", p=CONTACT[None], n=CONTACT[None] / RADIUS, s=np.zeros(1), start=0.0)
    far = np.full((1, 3), 50.0) if points is None else points
    whole: Any = SimpleNamespace(q=q[None]), solved(**evaluation)
    refuse_unsound(cell, scene or free, SurfaceCloud(far, far), path, *whole)  # type: ignore[arg-type]


def test_an_arm_too_near_the_wheel_is_refused(cell):
    """The wheel is moved toward the forearm until ARM_MARGIN is left."""
    frames = link_frames(cell.robot, HOME[None])[0]
    goal = frames[3][:3, 3]

    def moved(t):
        away = (goal - cell.wheel.centre) / np.linalg.norm(goal - cell.wheel.centre)
        there = replace(cell, wheel=replace(cell.wheel, centre=cell.wheel.centre + t * away))
        return there, CollisionScene(there, BLOCK)

    value = lambda t: moved(t)[1].clearance(HOME[None], in_contact=True).value  # noqa: E731
    at = brentq(value, 0.0, 0.9 * np.linalg.norm(goal - cell.wheel.centre), xtol=1e-7)
    pair = moved(at)[1].clearance(HOME[None], in_contact=True).names
    assert "wheel" in pair and "holder" not in pair, "the margin that is met is not ARM_MARGIN"
    put_to_test(*moved(at - 1e-5))
    with pytest.raises(Infeasible, match=r"line 3 \(convex\), waypoint 1: .*wheel overlap by .* against the margin"):
        put_to_test(*moved(at + 1e-3))


def test_a_blade_too_near_the_wheel_off_contact_is_not_free(cell):
    scene = CollisionScene(cell, BLOCK)
    judged = 0
    inside, outside = (joints_of(cell, blade_before_wheel(cell, rules.BLADE_MARGIN + e)) for e in (1e-5, -1e-5))
    for q_in, q_out in zip(inside, outside, strict=True):
        if scene.clearance(q_in[None], in_contact=False).names == ("blade", "wheel"):
            assert is_free(scene, q_in[None]) and not is_free(scene, q_out[None])
            assert scene.clearance(q_out[None], in_contact=False).sentence().startswith("blade and wheel overlap")
            judged += 1
    assert judged


def test_contact_beside_the_planned_one_is_refused(cell):
    T, curvature = on_wheel(cell, delta=2e-4), (1 / RADIUS + 1 / cell.wheel.radius, 0.0, 0.0)
    for more in (-1e-6, 1e-6):
        point = buried(cell, T, rules.SECONDARY_CONTACT_TOLERANCE + more, 1.0)[None]
        if more < 0:
            put_to_test(cell, points=point, T=T, curvature=curvature)
        else:
            deeper = r"beside the contact, 0\.10 mm deeper than planned \(at most 0\.10\)"
            with pytest.raises(TouchesElsewhere, match=deeper) as refused:
                put_to_test(cell, points=point, T=T, curvature=curvature, turn=-0.03)
            assert refused.value.turn == 0.03


@pytest.mark.parametrize("where", ["before its rim", "beside its flank", "off its edge"])
def test_a_wheel_too_near_to_the_platform_is_refused(cell, where):
    """A point of the platform, GAP from the wheel once flange, blade and arm have given way by 0.3 mm of the 0.5 mm overlap."""
    wheel, arc, given = cell.wheel, 0.2, 3e-4
    out, along = wheel.outward(np.array(arc)), wheel.axis
    for more in (1e-7, -1e-7):
        far = GAP + more
        beyond, beside = {
            "before its rim": (far, -0.01),
            "beside its flank": (-0.01, far),
            "off its edge": (0.6 * far, 0.8 * far),
        }[where]
        point = wheel.centre + (wheel.radius + beyond - given) * out + (0.5 * wheel.width + beside) * along
        parts, numbers = np.array([[given, 2e-4, 0.0, 0.0]]), {"delta": np.array([5e-4]), "arc": np.array([arc])}
        seen: Any = SimpleNamespace(T_base_blade=np.eye(4)[None], parts=parts, **numbers)
        path: Any = SimpleNamespace(line=3, side="convex", s=np.zeros(1), start=0.0)
        if more > 0:
            refuse_near(cell, point[None], path, seen)
        else:
            with pytest.raises(
                PassesNear, match=r"line 3 \(convex\), waypoint 1: the wheel would touch block, platform or shroud"
            ):
                refuse_near(cell, point[None], path, seen)
    refuse_near(cell, np.zeros((0, 3)), path, seen)  # nothing beside the aerofoil


@pytest.mark.parametrize("leant", [0.0, 0.5])
def test_a_flange_near_its_pressed_stop_is_refused(cell, leant):
    """Its axis `leant` rad off the normal: then less of the stroke is seen along the normal. At its other stop passes begin, and
    grades judge it (below)."""
    away = np.array([0.0, np.cos(leant), np.sin(leant)])  # blade frame; the normal is y
    piece = replace(
        cell.workpiece, T_flange_blade=make_transform(Rotation.from_rotvec([0.4, -0.3, 0.7]).as_matrix(), np.zeros(3))
    )
    axis = piece.T_flange_blade[:3, :3] @ away if leant else None
    one = replace(cell, workpiece=piece, flange=replace(cell.flange, axis=axis))
    end = 0.5 * cell.flange.stroke - rules.STROKE_RESERVE
    put_to_test(one, stroke=np.cos(leant) * (end - 1e-9))
    put_to_test(one, stroke=np.cos(leant) * -0.5 * cell.flange.stroke)
    with pytest.raises(Infeasible, match=f"the force flange would stand {end * 1e3:.2f} mm from its middle, .* mm are usable"):
        put_to_test(one, stroke=np.cos(leant) * (end + 1e-9))


def test_ends_at_which_the_blade_can_hardly_be_lifted_off_are_refused(cell):
    solved = SimpleNamespace(T_base_blade=np.tile(np.eye(4), (40, 1, 1)), arc=np.zeros(40))
    one: Any = SimpleNamespace(problem=SimpleNamespace(path=bar_pass()), evaluation=solved)
    one.touching = lambda: one
    for more in (1e-9, -1e-6):
        scene: Any = SimpleNamespace(off_wheel=lambda poses, more=more: np.full(len(poses), rules.LIFT_RESERVE + more))
        if more > 0:
            refuse_ends(cell, scene, one)
        else:
            with pytest.raises(CannotGrind, match="lifted 20 mm off the wheel the blade would still be 0.0 mm too near"):
                refuse_ends(cell, scene, one)


# -- what is left out ----------------------------------------------------------------------------------------------


def test_a_line_shorter_than_a_pass_needs_is_left_out():
    def left(length):
        path = bar_pass()
        return whole_lines([replace(path, s=path.s * length / path.s[-1])], [np.zeros((40, 3))])[1]

    assert not left(rules.LEAST_STRETCH + 1e-9)
    (one,) = left(rules.LEAST_STRETCH - 1e-5)
    assert "a pass needs 5 mm and here are 5.0" in one.reason and one.end == pytest.approx(rules.LEAST_STRETCH - 1e-5)


def test_a_pass_begins_off_what_cannot_be_ground():
    """Waypoint 5 cannot be ground, waypoint 6 begins the rest where it is just farther off than STRETCH_ROOM."""
    for more, first in ((1e-9, 6), (-1e-9, 7)):
        step = rules.STRETCH_ROOM + more
        path = replace(bar_pass(), s=step * np.arange(40))
        error = CannotGrind.of(path, np.arange(40) == 5, "it is hollow", "use another wheel")
        pieces, _ = cut_out(LineStretch(path, np.zeros((40, 3))), error)
        assert pieces[-1].path.start == pytest.approx(first * step) and len(pieces[-1].path.s) == 40 - first


def test_less_than_half_of_the_surface_is_refused():
    path = bar_pass()

    def judged(share):
        lost = LeftOut(path.line, path.side, 0.0, float((1 - share) * path.s[-1]), "it is hollow", "use another wheel")
        return refuse_mostly_left_out([path], [lost])

    assert judged(rules.LEAST_GROUND_SHARE + 1e-6) == pytest.approx(rules.LEAST_GROUND_SHARE, abs=1e-5)
    with pytest.raises(
        Infeasible, match="only 50.0 % of the asked surface can be ground, 50 % are asked at least; .*it is hollow"
    ):
        judged(rules.LEAST_GROUND_SHARE - 1e-6)


def test_a_pass_may_fall_short_of_its_feed_by_a_little():
    """The axis that turns fastest in contact is allowed just so much speed."""
    motion = invented_motion.motion()
    one, trajectory = motion.passes[0], motion.way(0).trajectory
    t = np.linspace(0.0, trajectory.duration, 2000)
    nominal = trajectory.s(t) / float(one.problem.path.feed.mean())
    on = (nominal > one.problem.way.edges[2]) & (nominal < one.problem.way.edges[3])
    for more in (0.004, -0.004):
        qd = np.abs(trajectory.qd(t[on])).max(axis=0) * (1 - rules.FEED_TOLERANCE + more) / (rules.LIMIT_SHARE * RESERVE)
        robot = invented_motion.cell().robot
        limits = replace(trajectory.limits, qd=np.where(np.arange(6) == 5, qd, robot.qd_max), margin=rules.LIMIT_SHARE)
        if more > 0:
            assert _timed_pass(limits, one, "line 3").duration > trajectory.duration
        else:
            with pytest.raises(CannotGrind, match=r"the arm reaches 98\.\d % of the planned feed \(at least 99\)"):
                _timed_pass(limits, one, "line 3")


@pytest.mark.parametrize(("swing", "held"), [(0.04, True), (0.2, False)])
def test_on_a_ramp_a_pass_may_fall_short_of_its_feed_by_more(swing, held):
    """RAMP_FEED_TOLERANCE: the planned rate swings from node to node of a ramp, faster than the time law follows."""
    motion = invented_motion.motion()
    one, limits = motion.passes[0], motion.way(0).trajectory.limits
    way, rate = one.problem.way, one.solution.rate.copy()
    rate[np.flatnonzero((way.at > way.edges[1]) & (way.at < way.edges[2]))[6:13:2]] -= swing
    one = replace(one, solution=replace(one.solution, rate=rate))
    if held:
        _timed_pass(limits, one, "line 3")
    else:
        with pytest.raises(CannotGrind, match=r"of the planned feed \(at least 95\)"):
            _timed_pass(limits, one, "line 3")


# -- timing and the program read back ------------------------------------------------------------------------------


def test_a_posture_that_weight_alone_nearly_stalls_is_refused(cell):
    robot = cell.robot

    def move(share):
        limits = Limits.of(robot, lambda q, qd, qdd: share * robot.torque_max + 0.0 * q, rules.LIMIT_SHARE)
        return time_joint_move(READY, READY + 0.1, limits)

    usable = (RESERVE - 1e-3) * rules.LIMIT_SHARE
    assert move(usable - 1e-6).worst.torque <= rules.LIMIT_SHARE
    with pytest.raises(Infeasible, match="of its torque limit to hold the posture"):
        move(usable + 1e-6)


@pytest.mark.parametrize("binding", ["qd", "qdd", "torque_max"])
def test_a_timed_motion_uses_its_share_of_the_limit_that_binds_and_no_more(cell, binding):
    robot, payload = cell.robot, cell.workpiece.payload
    limits = Limits.of(robot, partial(inverse_dynamics, robot, payload.mass, payload.com), rules.LIMIT_SHARE)
    free = {name: getattr(limits, name) * (1.0 if name == binding else 20.0) for name in ("qd", "qdd", "torque_max")}
    worst = time_joint_move(READY, READY + np.radians(30.0), replace(limits, **free)).worst
    used = dict(zip(free, (worst.velocity, worst.acceleration, worst.torque), strict=True))
    assert max(used.values()) <= rules.LIMIT_SHARE and used[binding] == pytest.approx(rules.LIMIT_SHARE, rel=0.02)


def test_a_touch_where_a_gap_is_planned_is_refused(cell, monkeypatch):
    """By the independent route, at a planned gap just below and just above the one from which on it has to see one too."""
    one = invented_motion.motion().passes[0]
    way, clock = one.problem.way, np.array([0.0, 1e-3])
    monkeypatch.setattr(readback, "gaps", lambda cell, believed, path, end, give, q, seen: np.zeros(len(q)))
    for first, last in ((0.0, way.edges[1]), (way.edges[4], way.edges[-1])):
        for more in (-1e-7, 1e-7):
            at = brentq(lambda t, more=more: float(way.gap_at(np.array([t]))[0]) - rules.GAP_TOLERANCE - more, first, last)
            rows = (clock, np.zeros((2, 6)), np.full(2, at))
            if more < 0:
                assert readback._touching_in_air(cell, None, one, *rows) == 0.0
            else:
                with pytest.raises(CannotGrind, match="blade and wheel would touch in the air, .* by the independent route"):
                    readback._touching_in_air(cell, None, one, *rows)


def test_straight_motions_that_leave_the_plan_are_refused(cell, tmp_path, monkeypatch):
    """Against a plan whose axis 4 is turned away all along; where on it a posture belongs is looked for from every 20 ms."""
    monkeypatch.setattr(readback, "SAMPLE", 0.02)
    motion = invented_motion.motion()
    execution = invented_motion.checked(invented_motion.written(tmp_path, "lin")[1])

    def off(turn, places=(0, 1, 2)):
        segments = []
        for segment in motion.segments:
            path = deepcopy(segment.trajectory.path)
            last = (np.arange(len(path.c)) == len(path.c) - 1)[:, None, None]
            path.c = path.c + turn * (segment.place in places) * last * np.eye(6)[3]
            segments.append(replace(segment, trajectory=replace(segment.trajectory, path=path)))
        return readback._chained(cell, replace(motion, segments=segments), execution)[1]

    first = off(0.9 * rules.STRAY)
    assert [off(0.9 * rules.STRAY, (place,)) for place in (0, 1)] == pytest.approx([first, first], rel=0.02)
    turn = 0.9 * rules.STRAY + (rules.STRAY - first)
    assert off(turn - 0.03 * rules.STRAY) == pytest.approx(0.97 * rules.STRAY, rel=0.02)
    with pytest.raises(Infeasible, match="the straight motions read back leave the plan; nothing is written"):
        off(turn + 0.03 * rules.STRAY)


@pytest.mark.parametrize("flange", [True, False])
def test_a_force_that_is_off_is_refused(cell, flange):
    one = cell if flange else replace(cell, flange=None)
    tolerance = rules.FLANGE_FORCE_TOLERANCE if flange else rules.RIGID_FORCE_TOLERANCE
    path = bar_pass()

    def read(off):
        force = path.force + np.where(np.arange(40) == 11, off, 0.0)
        return force_error(one, path, VerifiedPass(path.s / path.feed, path.s, force, 0.0 * path.s, path.force, 0.0 * path.s))

    for sign in (-1.0, 1.0):
        assert read(sign * (tolerance - 1e-9)) == pytest.approx(tolerance)
        with pytest.raises(Infeasible, match=rf"the force read back .* \(at most {tolerance:g}\); nothing is written"):
            read(sign * (tolerance + 1e-9))


def test_the_row_is_judged_that_is_farthest_off_for_its_mount_and_told_where_it_is(cell):
    """On the ramp 0.9 N off, which its stop allows; along the line 0.3 N, which the flange does not."""
    path = bar_pass()
    full = float(path.force[0])
    planned = np.minimum(np.linspace(0.2, 1.2, 40), 1.0) * full
    found = planned + np.where(np.arange(40) == 11, 0.9, 0.0) + np.where(np.arange(40) == 30, 0.3, 0.0)
    seen = VerifiedPass(path.s / path.feed, path.s, found, 0.0 * path.s, planned, np.full(40, 0.6 * full))
    with pytest.raises(CannotGrind, match=rf"{1e3 * path.s[30]:.1f} mm along it: .* 0\.30 N off \(at most 0\.2\)") as refused:
        force_error(cell, path, seen)
    assert refused.value.at == pytest.approx(path.s[[30]])


def test_a_ramp_is_judged_as_on_a_stop_until_the_force_is_a_little_beyond_it(cell):
    path = bar_pass()
    for beyond, held in ((rules.LEAVING - 1e-6, True), (rules.LEAVING + 1e-6, False)):
        planned = np.full(40, 12.0 + beyond)
        seen = VerifiedPass(path.s / path.feed, path.s, planned + 0.9, 0.0 * path.s, planned, np.full(40, 12.0))
        if held:
            assert force_error(cell, path, seen) == pytest.approx(0.9)
        else:
            with pytest.raises(CannotGrind, match=r"0\.90 N off \(at most 0\.2\)"):
                force_error(cell, path, seen)


def test_on_its_stop_a_flange_is_as_stiff_as_none_until_the_force_has_risen(cell):
    """Preload 12 N: on a ramp below it 0.9 N off pass, 2.1 N are refused with what would do; nothing of it on the line."""
    path = bar_pass()
    full = float(path.force[0])
    planned = np.minimum(np.linspace(0.2, 1.2, 40), 1.0) * full

    def read(row, off, preload=0.6):
        seen = VerifiedPass(
            path.s / path.feed,
            path.s,
            planned + np.where(np.arange(40) == row, off, 0.0),
            0.0 * path.s,
            planned,
            preload * full * np.ones(40),
        )
        return force_error(cell, path, seen)

    assert read(11, 0.9) == pytest.approx(0.9)
    for row, off, preload in ((11, 2.1, 0.6), (11, 0.9, 0.0), (24, 0.3, 0.6), (38, 0.3, 0.99)):
        with pytest.raises(Infeasible, match="the force read back") as refused:
            read(row, off, preload)
        assert ("bears on its stop, up to 12.0 N" in str(refused.value)) == (off > 2.0)


def test_points_are_emitted_as_for_a_rigid_mount_where_the_flange_leaves_its_stop(cell):
    """Up to 12 N at its stop: on the ramp up to LEAVING more; not where it gives, nor from RAMP_SHARE of the full force on."""
    force = np.array([4.0, 11.0, 12.0, 12.0 + rules.LEAVING - 0.1, 12.0 + rules.LEAVING + 0.1, 19.0, 20.0])
    stiffness = np.where(force < 12.5, 6e4, 5.2e3)
    soft, hard = rules.FLANGE_FORCE_TOLERANCE, rules.RIGID_FORCE_TOLERANCE
    full = np.full(7, 20.0)
    assert force_allowed(cell, stiffness, force, full).tolist() == [hard] * 4 + [soft] * 3
    assert force_allowed(cell, np.full(7, 5.2e3), force, full).tolist() == [soft] * 7
    ramp = (rules.RAMP_SHARE - 1e-6) * np.array([1.0, 1.0]), (rules.RAMP_SHARE + 1e-6) * np.array([1.0, 1.0])
    assert [force_allowed(cell, np.full(2, 6e4), 20.0 * part, np.full(2, 20.0))[0] for part in ramp] == [hard, soft]


@pytest.fixture(scope="module")
def execution(tmp_path_factory):
    return invented_motion.checked(invented_motion.written(tmp_path_factory.mktemp("program"))[1])


def test_a_text_that_uses_more_than_an_axis_has_is_refused(cell, execution):
    motion, robot = invented_motion.motion(), cell.robot
    ratio = _timed(cell, motion, execution)[3]

    def weaker(part):
        weak = replace(robot, qd_max=ratio * part * robot.qd_max, qdd_max=ratio * part * robot.qdd_max)
        return _timed(replace(cell, robot=weak), motion, execution)[3]

    assert weaker(1 + 1e-6) == pytest.approx(rules.READ_BACK_LIMIT)
    with pytest.raises(Infeasible, match="of an axis limit between its points; nothing is written"):
        weaker(1 - 1e-6)


@pytest.mark.parametrize("block", range(5))
def test_the_worst_of_all_blocks_is_what_is_judged(cell, execution, block, monkeypatch):
    """One block of the text that turns faster, speeds up harder or goes elsewhere than it does."""
    real = reinterpolate(execution, cell.robot)
    begin, end = np.append(real.starts, real.duration)[[block, block + 1]] + [1e-3, -1e-3]

    def read(name, change):
        def altered(t):
            values = getattr(real, name)(t)
            return np.where(((t > begin) & (t < end))[:, None], change(values), values)

        program = SimpleNamespace(**vars(real), **{one: getattr(real, one) for one in ("q", "qd", "qdd")} | {name: altered})
        monkeypatch.setattr(readback, "reinterpolate", lambda *_: program)
        return _timed(cell, invented_motion.motion(), execution)

    for name, most in (("qd", cell.robot.qd_max), ("qdd", cell.robot.qdd_max)):
        assert read(name, lambda _, most=most: -0.99 * most)[3] == pytest.approx(0.99)
        with pytest.raises(Infeasible, match=r"would use 1\.010 of an axis limit"):
            read(name, lambda _, most=most: -1.01 * most)
    assert read("q", lambda q: q - 1e-3)[1] == pytest.approx(1e-3, abs=3e-5)


@dataclass
class Longer:
    """A trajectory that says it lasts `duration`."""

    trajectory: Any
    duration: float

    def __getattr__(self, name):
        return getattr(self.trajectory, name)


def test_a_block_that_lasts_longer_than_planned_is_refused(cell, execution):
    motion = invented_motion.motion()
    written = reinterpolate(execution, cell.robot).starts[1]

    def planned(off):
        first = replace(motion.segments[0], trajectory=Longer(motion.segments[0].trajectory, written + off))
        return _timed(cell, replace(motion, segments=[first, *motion.segments[1:]]), execution)

    for sign in (-1.0, 1.0):
        planned(sign * (rules.BLOCK_TIME_TOLERANCE - 1e-7))
        with pytest.raises(Infeasible, match="ms longer or shorter than planned"):
            planned(sign * (rules.BLOCK_TIME_TOLERANCE + 1e-7))


# -- what is asked for, and what is said ---------------------------------------------------------------------------


@pytest.mark.parametrize("inside, outside", [(rules.LEAST_STEP, 1 - 1e-9), (rules.MOST_STEP, 1 + 1e-9)])
def test_waypoints_neither_too_dense_nor_too_far_apart(monkeypatch, inside, outside):
    def reached(*_):
        raise NotImplementedError("the blade is read")

    monkeypatch.setattr("ocp.plan.planning.lay_paths", reached)
    with pytest.raises(NotImplementedError):
        make_plan(CELL, None, PlanOptions(step=inside), Phases())
    with pytest.raises(BadInput, match="is not between 0.05 and 5 mm"):
        make_plan(CELL, None, PlanOptions(step=inside * outside), Phases())


def test_a_force_that_may_be_double_or_none_is_not_called_ready(cell):
    for more, grade in ((-1e-6, "amber"), (1e-6, "red")):
        found = grade_force(cell, 20.0, 20.0 / rules.UNCERTAIN_FORCE + more, 0.02)
        assert found.grade == grade
        assert ("calibrate the cell before the blade touches the wheel" in found.why) == (grade == "red")
        assert Grades(found, found, "20 N").status == ("safe_to_move" if grade == "red" else "safe")


def test_feeds_that_a_wanted_depth_may_ask_for(cell):
    path = bar_pass()
    for feed, inside in ((rules.FEEDS[0], 1.001), (rules.FEEDS[1], 0.999)):
        for factor, named in ((inside, False), (1 / inside, True)):
            asked = replace(path, feed=np.where(np.arange(len(path.s)) < 5, feed * factor, path.feed))
            error = beyond_reach(cell, asked, Wanted())
            assert (error is not None) == named
    assert error is not None and len(error.at) == 5
    for feed, told in ((0.49975 * rules.FEEDS[0], 80.04), (1.999 * rules.FEEDS[1], 20.01)):  # of a process at 40 mm/s
        asked = replace(path, feed=np.where(np.arange(len(path.s)) < 5, feed, path.feed))
        off = beyond_reach(cell, asked, Wanted())
        assert off is not None
        kept = float(off.would_do.split("feed_mm_s to ")[1].split(",")[0])
        assert kept == pytest.approx(told, rel=0.03)
        again = replace(asked, feed=np.where(np.arange(len(path.s)) < 5, feed * kept / 40.0, path.feed))
        assert beyond_reach(cell, again, Wanted()) is None  # rounded as it is told
    known = beyond_reach(cell, asked, Wanted(programmed_um=10.0))
    assert known is not None and "ask for more depth" in known.would_do and "feed_mm_s" not in known.would_do


def test_a_flange_that_stands_across_the_blade_is_refused(cell):
    normal = cell.workpiece.T_flange_blade[:3, :3] @ bar_pass().n[0]
    beside = np.cross(normal, [0.0, 0.0, 1.0] if abs(normal[2]) < 0.9 else [1.0, 0.0, 0.0])
    beside /= np.linalg.norm(beside)
    for share, refused in ((rules.FLANGE_SHARE + 1e-3, False), (rules.FLANGE_SHARE - 1e-3, True)):
        axis = share * normal + np.sqrt(1 - share**2) * beside
        held = replace(cell, flange=replace(cell.flange, axis=axis))
        if refused:
            with pytest.raises(BadInput, match="force_flange.axis stands 60 deg to the normal"):
                refuse_flange(held, [bar_pass()])
        else:
            refuse_flange(held, [bar_pass()])
    refuse_flange(replace(cell, flange=None), [bar_pass()])


@pytest.mark.parametrize("carried", [0.0, 1.5])
def test_a_force_that_the_flange_bears_nowhere_is_refused_before_anything_is_solved(cell, carried):
    flange = replace(cell.flange, axis=None, carried_mass=carried, gravity_compensated=False)
    most = flange.setpoint + carried * 9.81 + flange.stiffness * (0.5 * flange.stroke - rules.STROKE_RESERVE)
    for more in (-1e-3, 1e-3):
        path = replace(bar_pass(), force=np.full(len(bar_pass().s), most + more))
        held = replace(cell, flange=flange)
        if more < 0:
            refuse_flange(held, [path])
        else:
            with pytest.raises(BadInput, match="would stand .* mm or more from its middle under the .* N asked for"):
                refuse_flange(held, [path])
            refuse_flange(held, [path, replace(path, force=path.force - 0.01)])  # elsewhere it does


def test_a_force_that_is_not_known_to_a_twentieth_is_amber(cell):
    limit = 20.0 * rules.FORCE_SHARE
    for sd, off in ((limit, 0.02), (0.1, limit)):
        assert grade_force(cell, 20.0, sd - 1e-9, off - 1e-9).grade == "green"
    assert grade_force(cell, 20.0, limit + 1e-9, 0.02).grade == "amber"
    assert grade_force(cell, 20.0, 0.1, limit + 1e-9).grade == "amber"


@pytest.mark.parametrize(
    ("move", "force", "headline", "status", "holds"),
    [
        ("green", "green", "Safe to use.", "safe", "It holds"),
        ("amber", "green", "Safe to use, with care.", "safe", "It holds"),
        ("green", "amber", "Safe to use, with care.", "safe", "It may miss"),
        ("green", "red", NOT_TO_GRIND, "safe_to_move", "It is not known to hold"),
        ("amber", "red", NOT_TO_GRIND, "safe_to_move", "It is not known to hold"),
    ],
)
def test_the_verdict_is_no_better_than_the_worse_of_its_grades(move, force, headline, status, holds):
    grades = Grades(Grade(move, "it moves"), Grade(force, "as measured"), "20 N")
    assert (grades.headline, grades.status) == (headline, status)
    assert grades.sentences() == f"It is safe to move ({move}): it moves. {holds} 20 N ({force}): as measured."


def test_a_motion_whose_speeds_were_not_checked_is_amber():
    timed, chained = (grade_move(Readback([], 0.1, np.radians(0.002), 0.0, ratio, 0.0)) for ratio in (0.873, np.nan))
    assert timed.grade == "green" and "within 0.002 deg and uses at most 87 % of an axis' speed" in timed.why
    assert chained.grade == "amber" and "within 0.002 deg" in chained.why and "were not checked" in chained.why


def test_what_would_tell_the_force_better_is_what_was_not_measured(cell):
    def advice(*names):
        known = Calibration(cell.robot.name, names, np.zeros(len(names)), np.eye(len(names)), {}) if names else None
        return grade_force(replace(cell, calibration=known), 20.0, 3.0, 0.02).why

    assert CALIBRATED in advice()
    assert "wheel and blade are not registered" in advice("a2", "sensor_bias")
    assert "the cell has drifted or was little measured" in advice("a2", "wheel_y")


def test_straight_motions_that_blend_are_amber_beyond_the_limits_of_force_and_depth(cell):
    force, dose = rules.FLANGE_FORCE_TOLERANCE, rules.FORCE_SHARE
    assert grade_force(cell, 20.0, 0.1, 0.02, BlendError(force, dose)).grade == "green"
    for more in (BlendError(force + 1e-6, dose), BlendError(force, dose + 1e-6)):
        found = grade_force(cell, 20.0, 0.1, 0.02, more)
        assert found.grade == "amber" and "up to 0.2 N on the ramps of a pass and by up to 5 % in force over feed" in found.why


def test_a_flange_that_bears_on_its_stop_is_amber(cell):
    free = 0.5 * cell.flange.stiffness * cell.flange.stroke
    for more, grade in ((-1e-6, "green"), (1e-6, "amber")):
        flange = replace(cell.flange, setpoint=free + rules.STOP_PRELOAD + more)
        assert grade_force(replace(cell, flange=flange), 20.0, 0.1, 0.02).grade == grade
    # Weight that is not compensated presses it against the stop: 5 kg are 49 N.
    heavy = replace(cell.flange, setpoint=1.0, carried_mass=5.0, gravity_compensated=False)
    assert stop_preload(heavy) == pytest.approx(1.0 + 5.0 * GRAVITY - free)
    # Where it hangs across the flange's axis it does not.
    hung = replace(cell, flange=replace(heavy, setpoint=20.0))
    assert [grade_force(hung, 20.0, 0.1, 0.02, None, stopped).grade for stopped in (0.0, 12.0)] == ["green", "amber"]
    assert "until 12.0 N" in grade_force(hung, 20.0, 0.1, 0.02, None, 12.0).why
    # An output that the program does not drive changes nothing.
    output = replace(flange, setpoint_output="ANOUT[1]")
    assert grade_force(replace(cell, flange=output), 20.0, 0.1, 0.02).grade == "amber"
