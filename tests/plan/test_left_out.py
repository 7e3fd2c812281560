"""What cannot be ground is cut out of its line, named and left out; the rest is planned."""

import pickle
import re
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.contact.wheel.law_fit import Domain, remembered_law
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.prepare import wheel_cover
from ocp.plan.clearance import CollisionScene
from ocp.plan.files import _verified
from ocp.plan.passes.course import lengthened
from ocp.plan.passes.optimise import (
    GroundLines,
    PassesNear,
    PassWorker,
    TouchesElsewhere,
    refuse_ends,
    refuse_uneven_leads,
    rises_between,
)
from ocp.plan.passes.posture import contact_poses, impossible, seeds_of_stretches
from ocp.plan.passes.stretches import (
    HALVINGS,
    MOST_CUTS,
    SHOWN,
    CannotGrind,
    LeftOut,
    LineStretch,
    as_driven,
    cut_out,
    ground_share,
    joined,
    runs,
    ungrindable_notices,
    whole_lines,
)
from ocp.plan.planning import left_out_too, reachable_motion, softer_notices
from ocp.plan.readback import force_error
from ocp.plan.removal.footprint import CELL, LinePatches
from ocp.plan.rules import FLANGE_FORCE_TOLERANCE, LEAST_STRETCH, SEED_INDENTATION, STRETCH_ROOM
from ocp.plan.second_route import VerifiedPass
from robots.errors import Infeasible
from tests.support.example_pass import LineLaw, bar_pass, bundled_cell
from trajectories.passes import reversed_path, stretch_of

N = 40
# Corners of the round bar, as the collision scene takes them.
BAR = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.04, 0.04) for z in (0.0, 0.1)])


def line(length=0.078, number=1, shift=0.0):
    """A line of 40 waypoints, 2 mm apart by default, `shift` m beside the first."""
    path = bar_pass()
    at = path.p[0] + np.linspace(0.0, length, N)[:, None] * path.t[0] + shift * np.cross(path.n[0], path.t[0])
    return replace(path, line=number, p=at, s=np.linspace(0.0, length, N))


def stretch(cuts=0, **asked):
    return LineStretch(line(**asked), np.arange(3.0 * N).reshape(N, 3), cuts)


def error(path, *nodes):
    return CannotGrind.of(path, np.isin(np.arange(len(path.s)), nodes), "it is hollow", "use a wheel at most 12 mm wide")


# -- where it cannot be ground -------------------------------------------------------------------------------------


def test_the_sentence_names_line_waypoint_reason_and_remedy_and_survives_another_process():
    one = error(line(), 7, 8)
    assert str(one) == "line 1 (convex), waypoint 8: it is hollow; use a wheel at most 12 mm wide"
    back = pickle.loads(pickle.dumps(one))
    assert str(back) == str(one) and isinstance(back, Infeasible) and back.whose == (1, 0.0) and back.waypoint == 7
    np.testing.assert_allclose(back.at, [0.014, 0.016])


def test_a_path_run_backwards_is_cut_at_the_same_place_of_the_line():
    path = line()
    for tried, k in ((reversed_path(path), 3), (lengthened(reversed_path(path), 0.006, 0.010), 3 + 3)):  # led in to and out of
        back = error(tried, k).turned_round(float(path.s[-1]))
        assert np.flatnonzero(back.nodes(path.s)).tolist() == [N - 1 - 3]


def test_what_lies_beyond_the_ends_of_a_line_counts_for_its_ends():
    """A way from air to air has arc lengths before the line's start and behind its end."""
    path = line()
    assert np.flatnonzero(CannotGrind("", at=np.array([-0.01, 0.09])).nodes(path.s)).tolist() == [0, N - 1]


# -- cutting -------------------------------------------------------------------------------------------------------


def test_a_place_in_the_middle_is_cut_out_with_room_and_both_ends_stay():
    one = stretch()
    pieces, (lost,) = cut_out(one, error(one.path, 20, 21))
    assert [(p.path.start, len(p.path.s)) for p in pieces] == [(0.0, 20), (pytest.approx(0.044), 18)]
    assert (lost.start, lost.end) == (pytest.approx(0.038), pytest.approx(0.044))
    assert lost.start <= 0.040 - STRETCH_ROOM and lost.end >= 0.042 + STRETCH_ROOM
    second = pieces[1]
    np.testing.assert_array_equal(second.path.p, one.path.p[22:])
    np.testing.assert_array_equal(second.compliance, one.compliance[22:])
    assert second.path.s[0] == 0.0 and second.path.line == 1 and second.cuts == 1


def test_a_piece_of_a_piece_knows_where_on_the_line_it_lies():
    path = stretch_of(stretch_of(line(), 10, 39), 5, 20)
    assert path.start == pytest.approx(0.030) and path.s[-1] == pytest.approx(0.030)
    assert path.rest == pytest.approx(0.078 - 0.060) and reversed_path(path).start == path.rest


def test_an_end_too_short_for_a_pass_goes_with_the_cut():
    one = stretch()
    pieces, (lost,) = cut_out(one, error(one.path, 2))  # 2 mm of pass would be left before it
    assert len(pieces) == 1 and lost.start == 0.0 and lost.end == pytest.approx(0.006)
    assert 0.002 < LEAST_STRETCH


def test_a_line_that_cannot_be_ground_anywhere_is_left_out_whole():
    one = stretch()
    pieces, (lost,) = cut_out(one, error(one.path, *range(N)))
    assert not pieces and (lost.start, lost.end) == (0.0, pytest.approx(0.078))


def test_without_a_place_the_line_is_halved_and_nothing_lost_until_that_has_an_end():
    halves, lost = cut_out(stretch(), Infeasible("the optimiser stopped"))
    assert not lost and len(halves) == 2
    assert halves[1].path.start == pytest.approx(halves[0].path.s[-1] + 0.002), "a waypoint belongs to one half"
    for cuts, length in ((HALVINGS, 0.078), (0, 1.9 * LEAST_STRETCH)):
        pieces, (lost,) = cut_out(stretch(cuts, length=length), Infeasible("the optimiser stopped"))
        assert not pieces and lost.reason == "the optimiser stopped" and lost.length == pytest.approx(length)


def test_a_line_of_few_points_is_not_halved_into_less_than_a_pass():
    path = line(length=0.012)
    few = replace(path, **{name: getattr(path, name)[[0, 13, 26, 39]] for name in ("p", "n", "t", "s", "curvature", "extent")})
    few = replace(few, feed=path.feed[:4], force=path.force[:4])
    pieces, (lost,) = cut_out(LineStretch(few, np.zeros((4, 3)), 0), Infeasible("the optimiser stopped"))
    assert not pieces and lost.length == pytest.approx(0.012)


def test_an_uneven_surface_beside_the_line_is_not_led_in_over():
    """A step of the surface between two nodes, before the line or on it."""
    cell, path = bundled_cell(), lengthened(line(), 0.010, 0.0)
    s = path.s

    def refused(at, step, **flange):
        off = np.where(s < at, step, 0.0)
        problem = SimpleNamespace(path=path, indentation_correction=off)
        one = SimpleNamespace(problem=problem, evaluation=SimpleNamespace(stiffness=np.full(len(s), 5000.0)))
        try:
            refuse_uneven_leads(replace(cell, **flange), one, 0.078)
        except CannotGrind as error:
            return bool(error.at.size)
        return False

    limit = 2.0 * FLANGE_FORCE_TOLERANCE / 5000.0
    assert refused(-0.004, 1.01 * limit) and not refused(-0.004, 0.99 * limit)
    assert not refused(0.030, 10.0 * limit)  # the verification judges that
    assert not refused(-0.004, 5.0 * limit, flange=None)


def test_cutting_has_an_end_where_every_cut_shows_another_place():
    one = stretch(MOST_CUTS)
    pieces, (lost,) = cut_out(one, error(one.path, 20))
    assert not pieces and lost.length == pytest.approx(0.078)


def test_runs_of_a_mask():
    assert runs(np.array([True, True, False, True, False, False, True])) == [(0, 1), (3, 3), (6, 6)]
    assert runs(np.zeros(3, bool)) == [] and runs(np.ones(3, bool)) == [(0, 2)]


def lost_at(number, start, end, reason="it is hollow"):
    return LeftOut(number, "concave", start, end, reason, "use a wheel at most 12 mm wide")


def test_pieces_that_touch_are_told_as_one_with_the_reason_of_the_longest():
    parts = [
        lost_at(2, 0.008, 0.02),
        lost_at(2, 0.0, 0.008, "short"),
        lost_at(2, 0.02, 0.022, "b"),
        lost_at(2, 0.03, 0.04),
        lost_at(3, 0.04, 0.05),
    ]
    assert joined(parts) == [lost_at(2, 0.0, 0.022), lost_at(2, 0.03, 0.04), lost_at(3, 0.04, 0.05)]


# -- what is told --------------------------------------------------------------------------------------------------


def test_the_share_of_a_line_goes_by_the_strip_it_stands_for():
    """Three lines 4 mm and 8 mm apart: strips 2, 6 and 4 mm wide."""
    paths = [line(number=1), line(number=2, shift=0.004), line(number=3, shift=0.012)]
    assert ground_share(paths, []) == 1.0
    for number, strip in ((1, 2.0), (2, 6.0), (3, 4.0)):
        assert ground_share(paths, [lost_at(number, 0.0, 0.039)]) == pytest.approx(1 - 0.5 * strip / 12.0, abs=1e-6)
    assert ground_share([line(number=4)], [lost_at(4, 0.0, 0.0195)]) == pytest.approx(0.75)


def test_what_a_line_was_cut_back_by_is_left_out_too():
    """20 mm before a line of 78 mm where the wheel has no room beside the root."""
    path = replace(line(), before=0.02)
    (one,), (lost,) = whole_lines([path], [np.zeros((N, 3))])
    assert one.path is path and (lost.start, lost.end) == (-0.02, 0.0) and "block" in lost.reason
    assert ground_share([path], [lost]) == pytest.approx(78.0 / 98.0)
    assert one.piece(3, 20).path.before == 0.0


def test_left_out_as_a_user_reads_it():
    one = lost_at(7, 0.012, 0.0345)
    assert one.sentence() == ("Line 7 (concave), 12.0 to 34.5 mm, is left out: it is hollow; use a wheel at most 12 mm wide.")
    assert one.document() == {
        "line": 7, "side": "concave", "from_mm": 12.0, "to_mm": 34.5, "reason": "it is hollow",
        "would_do": "use a wheel at most 12 mm wide",
    }  # fmt: skip
    (turned,) = as_driven([one], [line(number=7)], {7})
    assert (turned.document()["from_mm"], turned.document()["to_mm"]) == (
        78.0 - 34.5,
        78.0 - 12.0,
    ) and "43.5 to 66.0 mm" in turned.clause()
    told = ungrindable_notices([lost_at(k, 0.0, 0.01 * k) for k in range(1, SHOWN + 3)])
    assert len(told) == SHOWN + 1 and told[-1].startswith("2 more stretches, 30 mm in all") and told[0].startswith("Line 3 ")


# -- postures and ends ---------------------------------------------------------------------------------------------


def hollow_path(middle):
    """A pass on the round bar whose middle waypoints are as hollow as can be for the wheel of the tests."""
    path = bar_pass()
    curvature = path.curvature.copy()
    curvature[middle, 1] = -1500.0
    return replace(path, curvature=curvature)


def test_a_line_that_is_too_hollow_in_its_middle_is_ground_on_both_sides_of_it():
    cell = bundled_cell()
    path, scene = hollow_path(slice(15, 25)), CollisionScene(cell, BAR)
    whole = [LineStretch(path, np.zeros((N, 3)))]
    pieces, seeds, (lost,) = seeds_of_stretches(cell, scene, LineLaw(), whole, False)
    assert len(pieces) == len(seeds) == 2 and all(seeds)
    step = path.s[1]
    assert pieces[0].path.s[-1] == pytest.approx(14 * step, abs=2 * step) and lost.start == pieces[0].path.s[-1]
    assert pieces[1].path.start == pytest.approx(25 * step, abs=2 * step) and lost.end == pytest.approx(pieces[1].path.start)
    assert lost.start < 15 * step < 24 * step < lost.end
    assert lost.reason.startswith("the blade is too hollow for a wheel 15 mm wide with 40 mm radius")
    assert re.search(r"use a wheel at most \d+ mm wide", lost.would_do)
    with pytest.raises(CannotGrind, match="too hollow for this wheel"):
        seeds_of_stretches(cell, scene, LineLaw(), whole, True)


def test_a_wheel_as_wide_as_is_told_does_bear():
    """The remedy is put to the test on a direct contact: just as wide it bears, as wide as it was it does not."""
    cell = bundled_cell()
    wide = replace(cell, wheel=replace(cell.wheel, width=0.040))
    domain = Domain(np.array([[0.0, -k, 0.0] for k in (0.0, 4.0, 8.0)]), 0.01, 1e-3, 0.01, 20.0)
    law = remembered_law(wheel_cover(wide), domain, samples=400, held_out=50)
    path = replace(bar_pass(), curvature=np.tile([0.0, -8.0, 0.0], (N, 1)))
    where, reason, would_do = impossible(wide, CollisionScene(wide, BAR), law, path)
    assert where.all() and "40 mm wide" in reason
    width = 1e-3 * float(re.search(r"at most (\d+) mm wide", would_do)[1])
    for wheel_width, bears in ((width, True), (0.040, False)):
        cover = wheel_cover(replace(cell, wheel=replace(cell.wheel, width=wheel_width)))
        turn = np.cos(0.95 * cell.process.turn_tolerance) ** 2
        found = solve_force(cover, 20.0, LocalShape(1 / cell.wheel.radius, -8.0 * turn))
        assert (found.indentation > SEED_INDENTATION) == bears


def test_a_cover_that_hardly_gives_way_is_not_told_as_a_hollow_blade():
    """A wheel of steel touches the bar at the planned points, as it is or turned: it is the cover."""
    cell = bundled_cell()
    hard = SimpleNamespace(limits=LineLaw().limits, evaluate=lambda force, *shape: np.full(len(force), 0.9 * SEED_INDENTATION))
    path = bar_pass()
    path.curvature[:, 0] = 3.0 - 1.0 / cell.wheel.radius  # hollow along the line: steel would touch untilted, not at every turn
    where, reason, would_do = impossible(cell, CollisionScene(cell, BAR), hard, path)
    assert where.all() and reason.startswith("the wheel's cover gives way by less than 0.05 mm under 20 N")
    assert would_do == "use a softer cover, or more force"


def test_a_place_out_of_reach_says_by_how_much():
    cell = bundled_cell()
    far = replace(cell, wheel=replace(cell.wheel, centre=cell.wheel.centre + [2.0, 0.0, 0.0]))
    where, reason, would_do = impossible(far, CollisionScene(far, BAR), LineLaw(), bar_pass())
    assert where.all() and "mm beyond the robot's reach" in reason and "nearer" in would_do


def test_ends_from_which_the_blade_cannot_be_lifted_are_cut_off():
    """A plate stands up behind the last waypoints, in the hull of the blade: lifted off, it would still be in the wheel."""
    cell, path = bundled_cell(), bar_pass()
    poses = contact_poses(cell, path, np.arange(N), np.array(0.0), np.array(0.0), 1, cell.process.sigma)
    solved = SimpleNamespace(T_base_blade=poses, arc=np.zeros(N))
    one = SimpleNamespace(problem=SimpleNamespace(path=path), evaluation=solved)
    one.touching = lambda: one
    refuse_ends(cell, CollisionScene(cell, BAR), one)
    plate = np.array([[x, 0.075, 0.11] for x in (-0.01, 0.01)])
    with pytest.raises(
        CannotGrind, match=r"waypoint 40: lifted 20 mm off the wheel the blade would still be .* mm too near"
    ) as told:
        refuse_ends(cell, CollisionScene(cell, np.vstack([BAR, plate])), one)
    bad = told.value.nodes(path.s)
    assert bad[-1] and not bad[0] and (np.diff(bad.astype(int)) >= 0).all()


def test_a_worker_cuts_solves_and_names_until_nothing_is_left_to_try(monkeypatch):
    """The optimiser fails between 50 and 56 mm of every path that holds them."""
    tried = []

    def solve(self, path, seeds, compliance, looked):
        tried.append((path.start, path.start + path.s[-1]))
        s = path.start + path.s
        bad = (s > 0.050) & (s < 0.056)
        if bad.any():
            raise CannotGrind.of(path, bad, "it is hollow", "use another wheel")
        return SimpleNamespace(problem=SimpleNamespace(path=path))

    monkeypatch.setattr(PassWorker, "solve", solve)
    monkeypatch.setattr("ocp.plan.passes.optimise.find_seeds", lambda *_: [[SimpleNamespace(direction=1)]])
    worker = object.__new__(PassWorker)
    worker.ground, worker.scene = SimpleNamespace(cell=None, law=None), None
    seed = SimpleNamespace(direction=1)
    found = worker.solve_stretch(stretch(), [seed], whole=False)
    assert [(p.problem.path.start, p.problem.path.start + p.problem.path.s[-1]) for p in found.passes] == tried[1:]
    (lost,) = found.left_out
    assert lost.start == tried[1][1] <= 0.050 and lost.end == tried[2][0] >= 0.056
    with pytest.raises(CannotGrind, match="it is hollow"):
        worker.solve_stretch(stretch(), [seed], whole=True)
    # All pieces of a line are driven one way, or are left out.
    assert worker.solve_stretch(stretch(), [SimpleNamespace(direction=-1)], whole=False).passes == []


@pytest.mark.parametrize(("effects", "first"), [((), "looked at"), (("one",), "anew")])
def test_a_line_looked_at_for_its_feed_is_looked_at_anew_for_other_seeds_and_effects_alone(monkeypatch, effects, first):
    @dataclass(frozen=True)
    class Whole:
        turn_limit: float = 0.0

    def refused(*_):
        raise Infeasible("no way")

    tried = []
    monkeypatch.setattr("ocp.plan.passes.optimise._from_seed", lambda path, seed, compliance: seed)
    monkeypatch.setattr(PassWorker, "_driven", lambda self, seed: "anew")
    monkeypatch.setattr(PassWorker, "_whole_way", lambda self, seed, line, led: tried.append((seed.turn, line)) or Whole())
    monkeypatch.setattr(PassWorker, "_solve", refused)
    worker = object.__new__(PassWorker)
    worker.ground = SimpleNamespace(cell=SimpleNamespace(effects=effects, process=SimpleNamespace(turn_tolerance=0.1)))
    seeds = [SimpleNamespace(turn=turn, direction=1) for turn in (0.0, 0.1)]
    with pytest.raises(Infeasible, match="no way"):
        worker.solve(stretch().path, seeds, None, "looked at")
    assert set(tried) == {(0.0, first), (0.1, "anew")}


def bare_worker(monkeypatch, solve):
    """A worker whose passes `solve` solves, and which makes nothing ready for it but whether it is led in."""
    monkeypatch.setattr("ocp.plan.passes.optimise._from_seed", lambda path, seed, compliance: seed)
    monkeypatch.setattr(PassWorker, "_driven", lambda self, seed: "driven")
    monkeypatch.setattr(PassWorker, "_whole_way", lambda self, seed, line, led: led)
    monkeypatch.setattr(PassWorker, "_solve", solve)
    worker, process = object.__new__(PassWorker), SimpleNamespace(turn_tolerance=0.1)
    worker.ground, worker.scene = SimpleNamespace(cell=SimpleNamespace(effects=(), process=process), law=None), None
    return worker


@pytest.mark.parametrize("direction", [1, -1])
def test_a_line_too_near_to_the_platform_is_tried_with_one_seed_and_cut_though_the_whole_is_asked_for(monkeypatch, direction):
    """Without and with what leads in, no more: no posture changes where the turned wheel passes."""
    tried, one = [], stretch()

    def solved(self, problem):
        path, room = one.path, one.path.s > 0.005
        tried.append(problem)
        if len(tried) < 3:
            raise PassesNear.of(path, ~room, "too near", "use another wheel")
        return SimpleNamespace(problem=SimpleNamespace(path=path))

    monkeypatch.setattr("ocp.plan.passes.optimise.find_seeds", lambda *_: [[SimpleNamespace(direction=direction)]])
    for name in ("refuse_ends", "refuse_uneven_leads"):
        monkeypatch.setattr(f"ocp.plan.passes.optimise.{name}", lambda *_: None)
    monkeypatch.setattr("ocp.plan.passes.optimise.replace", lambda whole, turn_limit: whole)
    worker = bare_worker(monkeypatch, solved)
    led = replace(one, path=replace(one.path, room_before=0.01))
    found = worker.solve_stretch(led, 3 * [SimpleNamespace(direction=direction)], whole=True)
    assert len(tried) == 3 and tried[:2] == [True, False] and len(found.passes) == len(found.left_out) == 1


@pytest.mark.parametrize(("turn", "limits"), [(0.001, [0.1]), (0.015, [0.1, 0.002]), (0.09, [0.1, 0.02, 0.002])])
def test_a_smaller_turn_is_tried_only_where_the_wheel_stood_askew(monkeypatch, turn, limits):
    """Else it is the same solution."""
    tried, one = [], stretch()

    def solved(self, problem):
        tried.append(problem)
        error = TouchesElsewhere.of(one.path, np.ones(len(one.path.s), bool), "touches", "use another wheel")
        error.turn = min(turn, problem)
        raise error

    monkeypatch.setattr("ocp.plan.passes.optimise.replace", lambda whole, turn_limit: turn_limit)
    worker = bare_worker(monkeypatch, solved)
    with pytest.raises(TouchesElsewhere):
        worker.solve(one.path, [SimpleNamespace(direction=1)], one.compliance)
    assert tried == pytest.approx(limits)


def test_no_solved_pass_leaves_the_worker_without_room_beside_the_platform(monkeypatch):
    """At the pose that was solved, the wheel's centre lies on a point of the platform."""
    cell, path = bundled_cell(), stretch().path
    n = len(path.s)
    zero = {"delta": np.zeros(n), "parts": np.zeros((n, 4)), "arc": np.zeros(n), "stiffness": np.ones(n)}
    seen = SimpleNamespace(T_base_blade=np.tile(np.eye(4), (n, 1, 1)), **zero)
    problem = SimpleNamespace(path=path, indentation_correction=np.zeros(n), approach=None)
    solution = SimpleNamespace(q=np.zeros((n, 6)), force=np.ones(n))
    for name, result in (("start_on_coarse_grid", None), ("solve_directly", np.zeros(n)), ("refuse_unsound", None)):
        monkeypatch.setattr(f"ocp.plan.passes.optimise.{name}", lambda *_, result=result: result)
    monkeypatch.setattr(PassWorker, "_with_clearances", lambda self, problem, q: None)
    worker = object.__new__(PassWorker)
    worker.solver = SimpleNamespace(
        with_approach=lambda problem, *_: problem, solve=lambda *_: solution, evaluate=lambda *_: seen
    )
    worker.scene, worker.ground = None, SimpleNamespace(cell=cell, cloud=None, beside=cell.wheel.centre[None])
    with pytest.raises(PassesNear, match="the wheel would touch block, platform or shroud"):
        worker._solve(problem)


def test_where_the_wheel_hangs_over_the_line_it_is_left_out(monkeypatch):
    """Beside a block a wide wheel bears on what lies beyond the contact's reach: pressed in by less than nothing on the line."""
    path = line()
    indentation = np.array([-3e-3, 1e-4, 3e-4])
    bad = beside_the_line(monkeypatch, path, SimpleNamespace(at=path.s[[0, 20, -1]], indentation=indentation, hollow=NOWHERE))
    assert bad[:19].all() and not bad[20:].any()


def test_where_the_wheel_bears_to_both_sides_of_a_hollow_line_it_is_left_out(monkeypatch):
    """What presses there says nothing of the depth on the line: its profile over its own integral is not a number."""
    path, x, share = line(), CELL * np.arange(-5, 6), np.ones((3, 11, 11))
    share[0, :, 3:8] = 0.0
    patches = LinePatches(path.s[[0, 20, -1]], x, share, np.full(3, 20.0), np.full(3, 1e-4))
    bad = beside_the_line(monkeypatch, path, patches)
    assert bad[:10].all() and not bad[11:].any()


NOWHERE = np.zeros(3, bool)


def beside_the_line(monkeypatch, path, patches):
    """The waypoints (n,) of a path that are left out under these footprints because the wheel bears beside them."""
    monkeypatch.setattr("ocp.plan.passes.optimise.contacts_along", lambda *_, **__: patches)
    seen = SimpleNamespace(stiffness=np.full(len(path.s), 5e3), parts=np.zeros((len(path.s), 4)))
    worker = object.__new__(PassWorker)
    worker.ground = SimpleNamespace(cell=None, cover=None, cloud=None)
    worker.solver = SimpleNamespace(seed_joints=lambda problem: None, evaluate=lambda *_: seen)
    monkeypatch.setattr("ocp.plan.passes.optimise.entry_of", lambda *_: None)
    with pytest.raises(CannotGrind, match="bears beside the line") as told:
        worker._driven(SimpleNamespace(path=path))
    return told.value.nodes(path.s)


# -- what does not read back ---------------------------------------------------------------------------------------


def test_a_pass_whose_force_does_not_read_back_is_left_out_and_the_rest_written_anew(monkeypatch, tmp_path):
    def write(plan, folder, phases):
        assert not list(folder.iterdir()), "nothing of the first program stays"
        (folder / "program.src").write_text(plan.name)
        if plan.name == "all":
            raise error(line(), 0).with_others([error(line(number=2), 5)])
        return "written"

    monkeypatch.setattr("ocp.plan.files._write_programs", write)
    told = []
    rest = SimpleNamespace(name="rest", whole=False)
    plan = SimpleNamespace(name="all", whole=False, without=lambda one: told.append(one) or rest)
    assert _verified(plan, tmp_path, None) == (rest, "written")
    assert [one.line for one in (told[0], *told[0].others)] == [1, 2]
    (tmp_path / "program.src").unlink()
    with pytest.raises(CannotGrind, match="it is hollow"):
        _verified(SimpleNamespace(name="all", whole=True), tmp_path, None)


def test_passes_that_are_named_go_and_are_told_along_the_line_as_it_was_laid():
    piece = stretch_of(line(), 10, 39)
    passes = [
        SimpleNamespace(problem=SimpleNamespace(path=path, seed=SimpleNamespace(direction=way)))
        for path, way in ((line(number=2), 1), (reversed_path(piece), -1))
    ]
    left = left_out_too(GroundLines(passes, []), [error(reversed_path(piece), 3)])
    assert left.passes == passes[:1]
    assert [(one.line, one.start, one.end) for one in left.left_out] == [(1, pytest.approx(0.020), pytest.approx(0.078))]


def test_all_passes_that_do_not_read_back_are_named_at_once():
    """Two of three passes are 0.3 N off: both are in the error, the third is not."""
    cell, worst = bundled_cell(), []
    for number, off in ((1, 0.0), (2, 0.3), (3, -0.3)):
        path = replace(bar_pass(), line=number)
        seen = VerifiedPass(
            path.s / path.feed, path.s, path.force + np.where(np.arange(N) > 30, off, 0.0), 0 * path.s, path.force, 0 * path.s
        )
        try:
            force_error(cell, path, seen)
        except CannotGrind as one:
            worst.append(one)
    assert [one.whose for one in worst] == [(2, 0.0), (3, 0.0)]
    assert worst[0].nodes(bar_pass().s).sum() == 9 and "0.30 N off (at most 0.2); nothing is written" in str(worst[0])


def test_a_line_too_short_for_its_force_is_told_with_what_it_reaches():
    def solved(number, length, peak):
        return SimpleNamespace(problem=SimpleNamespace(path=line(length, number), way=SimpleNamespace(peak=peak)))

    lines = [solved(1, 0.078, 1.0), solved(2, 0.030, 0.9), solved(3, 0.007, 0.4)]
    (told,) = softer_notices(lines)
    feed = 1e3 * line().feed[0]
    assert told.startswith(f"line 3 (convex) is too short at {feed:.3g} mm/s for the force to rise and fall")
    assert "reaches 8.0 of 20 N" in told and "(less so lines 2)" in told and f"at most {0.4 * feed:.3g} mm/s" in told
    assert softer_notices(lines[:1]) == []


def test_a_rise_is_solved_closer_where_the_table_misses_unevenly():
    """At the nodes where the force passes another newton, between rough neighbours alone, none twice."""
    force = np.concatenate([np.linspace(4.3, 19.8, 32), np.full(8, 20.0)])
    index, rough = np.array([0, 10, 20, 39]), np.array([True, False, True])
    between = rises_between(force, index, rough)
    assert set(between) <= {*range(1, 10), *range(21, 39)} and len({*between}) == len(between)
    assert {int(force[k + 1]) for k in between} == {*range(5, 10), *range(15, 21)}
    assert len(rises_between(force, index, ~rough[[0, 0, 0]])) == 0


def test_where_nothing_can_be_ground_the_longest_piece_says_why():
    lost = [LeftOut(1, "convex", 0.0, 0.004, "the end", "ends"), LeftOut(2, "convex", 0.03, 0.12, "the middle", "middles")]
    with pytest.raises(Infeasible, match="nothing of the blade can be ground: line 2 .* 30.0 to 120.0 mm, .*: the middle"):
        reachable_motion(bundled_cell(), None, GroundLines([], lost), False, lambda: None)
