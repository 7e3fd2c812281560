"""Safe to move: rated payload, floor and mounting, each just inside and just outside; plan, poses, simulate, virtual cell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ocp.data import CELL
from ocp.model.cell import floor_notices, load_notices, read_cell
from ocp.plan.clearance import BASE_PLANE, CollisionScene
from ocp.plan.paths import PlanOptions
from ocp.plan.planning import make_plan
from ocp.plan.rules import ARM_MARGIN, UPRIGHT
from ocp.poses.candidates import STAND, Sight, choose_stand
from ocp.poses.planning import PoseOptions, make_poses
from ocp.shell.progress import Phases
from ocp.simulate.interface import simulate
from ocp.simulate.twin import tracker
from ocp.simulate.twin.arm import arm_moments, make_arm
from ocp.simulate.twin.collide import WheelBody, height_over_floor, refuse_hits
from ocp.simulate.twin.truth import draw_truth
from robots.errors import BadInput, Infeasible
from robots.kinematics import link_frames
from robots.payload import overload, refuse_overload
from robots.pose import apply
from robots.robot import CATALOGUE, RatedPayload, catalogue, load_robot
from robots.tracker_readings import Hanging, Nest
from tests.support.block_blade import BLOCK
from tests.support.example_pass import bundled_cell, with_floor
from trajectories.blade import read_blade

EXTRA = load_robot("kr210_r2700_extra")
LOW = np.radians([0.0, -25.0, 95.0, 0.0, 30.0, 0.0])  # stretched down beside the base
STRETCHED = np.radians([20.0, -5.0, 5.0, 0.0, 5.0, 0.0])
ABOVE = {"upright": (0.0, 0.0, -1.0), "ceiling": (0.0, 0.0, 1.0), "wall": (1.0, 0.0, 0.0), "tilted": (0.2, 0.3, -0.9)}


def rated(com=None, inertia=None, diagram=None, mass=210.0):
    """The robot with a rating drawn here: no maker's."""
    arrays = [None if v is None else np.array(v, float) for v in (com, inertia, diagram)]
    return replace(EXTRA, payload=RatedPayload(mass, *arrays))


def hanging(mass, com=(0.0, 0.0, 0.1), inertia=(0.0, 0.0, 0.0)):
    return Hanging(mass, np.array(com, float), np.array(inertia, float))


def changed_cell(folder: Path, *changes):
    text = CELL.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "cell.toml").write_text(text)
    return folder / "cell.toml"


# -- payload -------------------------------------------------------------------------------------------------------

LINE = [[0.1, 200.0], [0.3, 100.0]]
CENTRE = (0.2, 0.0, 0.1)  # of a rated load of 210 kg: 0.2 m from axis 6, hypot(0.2, 0.215 + 0.1) from axes 4 and 5
FAR = float(np.hypot(0.2, 0.315))
EDGE = {
    "mass": (rated(), lambda e: hanging(210.0 * (1 + e)), "above the 210 kg that"),
    "diagram": (
        rated(diagram=LINE),
        lambda e: hanging(150.0 * (1 + e), (0, 0.12, 0.16)),
        "200 mm from the flange: .* 150.0 kg there",
    ),
    "diagram's end": (rated(diagram=LINE), lambda e: hanging(5.0, (0, 0, 0.3 * (1 + e))), "carries 0.0 kg there"),
    "moment of axis 6": (rated(CENTRE), lambda e: hanging(42.0, (0, 1.0 + e, -0.2)), "axis 6, 412 N m are what the rated 210 kg"),
    "moment of axis 5": (
        rated(CENTRE),
        lambda e: hanging(42.0, (0, 0, 5 * FAR * (1 + e) - 0.215)),
        "of axis 4, .* the rated 210 kg",
    ),
    "inertia": (
        rated(CENTRE, (3.0, 4.0, 5.0)),
        lambda e: hanging(25.0, (0, 0, np.sqrt((210 * FAR**2 + 5 - 1) / 25) * (1 + e) - 0.215), (0, 1, 0)),
        "moment of inertia about axis 4",
    ),
    "torque": (
        rated(),
        lambda e: hanging(30.0, (0, 0, 1282.0 / 30 / 9.81 * (1 + e) - 0.215)),
        "axis 5, 1282 N m are what the axis",
    ),
}


@pytest.mark.parametrize("limit", EDGE)
def test_a_payload_just_inside_is_carried_just_outside_refused(limit):
    robot, load, sentence = EDGE[limit]
    assert overload(robot, load(-2e-3)) == ""
    assert refuse_overload("cell.toml", robot, {"tool": load(-2e-3)}) is not None
    with pytest.raises(BadInput, match=rf"cell\.toml, payloads\.tool: .*{sentence}"):
        refuse_overload("cell.toml", robot, {"bare": Hanging(), "tool": load(2e-3)})


def test_25_kg_at_3_m_are_too_much_for_any_rated_centre_of_a_compact_load():
    for com in ((0, 0, 3), (3, 0, 0)):
        assert overload(rated(CENTRE, (20.0, 20.0, 20.0)), hanging(25.0, com))


def test_what_nothing_known_could_judge_is_said():
    diagram, own = refuse_overload("c", EXTRA, {"tool": hanging(25.0, (0, 0, 3))})
    assert diagram.startswith("payload 'tool' (25 kg, 3000 mm from the flange) was not checked against a load diagram: ")
    assert own == "payload 'tool' was taken as a point: its own inertia, payloads.tool.inertia_kg_m2, is not given"
    assert "has no [payload]" in " ".join(refuse_overload("c", replace(EXTRA, payload=None), {"tool": hanging(25.0)}))
    assert refuse_overload("c", rated(diagram=LINE), {"tool": hanging(25.0, inertia=(1, 1, 1))}) == []
    assert refuse_overload("c", EXTRA, {"bare": Hanging()}) == []


def test_the_catalogue_says_where_its_payloads_come_from_and_invents_none():
    for name in catalogue():
        robot = load_robot(name)
        assert robot.payload is not None and "payload: " in robot.sources
        assert robot.payload.com is None and robot.payload.diagram is None and "none\n# is invented" in _joined(name)


def _joined(name):
    return (
        (CATALOGUE / f"{name}.toml")
        .read_text()
        .replace("; none is invented", "; none\n# is invented")
        .replace("none is invented", "none\n# is invented")
    )


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("rated_kg = 0.0", "rated_kg"),
        ("rated_kg = 5.0\ndiagram = [[100, 5.0], [50, 4.0]]", "distances must grow"),
        ("rated_kg = 5.0\ndiagram = [[100, 5.0], [150, 6.0]]", "masses never"),
        ("rated_kg = 5.0\ninertia_kg_m2 = [1.0, 1.0, 1.0]", "com_mm_at_rated"),
    ],
)
def test_an_unsound_rating_is_refused_with_its_file(lines, said, tmp_path):
    text = (CATALOGUE / "ur5.toml").read_text().replace("rated_kg = 5.0", lines)
    (tmp_path / "arm.toml").write_text(text)
    with pytest.raises(BadInput, match=rf"arm\.toml.*{said}"):
        load_robot(tmp_path / "arm.toml")


def test_plan_poses_and_simulate_refuse_280_kg(tmp_path):
    cell = changed_cell(tmp_path, ("mass_kg = 25.0", "mass_kg = 280.0"))
    said = r"cell\.toml, payloads\.grinder: mass_kg = 280 is above the 210 kg that KUKA KR 210 R2700 extra carries"
    with pytest.raises(BadInput, match=said):
        make_plan(cell, CELL.parent / "blade.stl", PlanOptions(), Phases(None))
    with pytest.raises(BadInput, match=said):
        make_poses(cell, PoseOptions(), Phases(None))
    with pytest.raises(BadInput, match=said):
        simulate(out=tmp_path / "run", cell=cell, poses=4)
    assert not (tmp_path / "run").exists()


# -- floor ---------------------------------------------------------------------------------------------------------


def lowest_of(cell, q, body):
    """Height m of the lowest point of a body of the arm at q (6,), in plain NumPy."""
    frames, names = link_frames(cell.robot, q[None])[0], ("base", "column", "upper arm", "forearm", "wrist", "hand", "flange")
    if body == "blade":
        return float((apply(frames[6] @ cell.workpiece.T_flange_blade, BLOCK) @ cell.up).min())
    shapes = [s for s in cell.robot.link_shapes if names[s[0]] == body]
    return min(float(apply(frames[link], end[None])[0] @ cell.up) - r for link, p0, p1, r in shapes for end in (p0, p1))


@pytest.mark.parametrize("direction", ABOVE.values(), ids=ABOVE)
@pytest.mark.parametrize("body", ["column", "upper arm", "forearm", "hand", "flange", "blade"])
def test_every_body_of_the_arm_keeps_its_margin_from_the_floor(body, direction):
    """The floor put just so deep under the body that its margin is kept, and just less, the body alone over it."""
    down = np.array(direction) / np.linalg.norm(direction)
    cell = bundled_cell()
    cell = replace(cell, robot=replace(cell.robot, gravity_direction=down))
    margin = 0.0 if body == "column" else ARM_MARGIN
    height = lowest_of(cell, STRETCHED, body) - margin
    for off, free in ((-1e-5, True), (1e-5, False)):
        scene = CollisionScene(with_floor(cell, 1e3 * (height + off)), BLOCK)
        floor = next(i for i, b in enumerate(scene._bodies) if b.name == "floor")
        scene._pairs = [
            p for p in scene._pairs if floor in (p.a, p.b) and body in (scene._bodies[p.a].name, scene._bodies[p.b].name)
        ]
        assert scene._pairs
        clearance = scene.clearance(STRETCHED[None], in_contact=True)
        assert (clearance.value >= 0) == free and set(clearance.names) == {body, "floor"}
        assert abs(clearance.value) == pytest.approx(1e-5, abs=2e-6)


def test_the_holder_is_kept_off_the_floor():
    scene = CollisionScene(with_floor(bundled_cell(), 0.0), BLOCK)
    assert ("floor" in {b.name for b in scene._bodies}) and any(
        {scene._bodies[p.a].name, scene._bodies[p.b].name} == {"holder", "floor"} for p in scene._pairs
    )


def test_the_plane_of_the_base_stays_where_no_floor_is_given_and_on_walls():
    cell = bundled_cell()
    for lean, planes in ((0.0, {"floor"}), (44.0, {"floor"}), (46.0, {"floor", BASE_PLANE}), (180.0, {"floor", BASE_PLANE})):
        a = np.radians(lean)
        tilted = replace(cell, robot=replace(cell.robot, gravity_direction=-np.array([np.sin(a), 0.0, np.cos(a)])))
        assert (np.cos(a) >= UPRIGHT) == (planes == {"floor"})
        names = {b.name for b in CollisionScene(with_floor(tilted, -3000.0), BLOCK)._bodies}
        assert names & {"floor", BASE_PLANE} == planes
        assert {b.name for b in CollisionScene(tilted, BLOCK)._bodies} & {"floor", BASE_PLANE} == {BASE_PLANE}


@pytest.mark.parametrize("direction", ABOVE.values(), ids=ABOVE)
def test_the_virtual_cell_finds_the_floor_by_itself(direction):
    """MuJoCo's plane just under the lowest point of arm and blade, and just over it."""
    cell = bundled_cell()
    cell = replace(cell, robot=replace(cell.robot, gravity_direction=np.array(direction) / np.linalg.norm(direction)))
    blade = read_blade(cell.workpiece.stl)
    links = link_frames(cell.robot, STRETCHED[None])
    bodies = ["column", "upper arm", "forearm", "wrist", "hand", "flange"]
    lowest = min(lowest_of(cell, STRETCHED, body) for body in bodies)
    tip = apply(links[0, 6] @ cell.workpiece.T_flange_blade, blade.vertices) @ cell.up
    assert float(height_over_floor(with_floor(cell, 100.0), links)[0]) == pytest.approx(lowest - 0.1, abs=1e-9)
    wheel = WheelBody(np.array([0.0, 0.0, 9.0]), np.array([0.0, 1.0, 0.0]), 0.05, 0.04)
    lowest = min(lowest, float(tip.min()))

    def drive(height):
        T = cell.workpiece.T_flange_blade
        refuse_hits(with_floor(cell, 1e3 * height), blade, wheel, T, links, np.zeros(1, np.int64), np.full(1, np.nan), ["here"])

    drive(lowest - 1e-3)
    with pytest.raises(Infeasible, match=r"here: .* and the floor overlap by 1\.\d mm"):
        drive(lowest + 1.2e-3)


@pytest.mark.parametrize("axis", [(0, 1, 0), (0, 0.6, 0.8)])
def test_a_wheel_below_the_floor_is_refused(axis, tmp_path):
    """Radius 40 mm, width 15 mm, centre 900 mm high."""
    lean = axis[2]
    lowest = 900.0 - 40.0 * np.sqrt(1 - lean**2) - 7.5 * lean

    def cell(z):
        return changed_cell(
            tmp_path, ("axis = [0, 1, 0]", f"axis = {list(axis)}"), ("[process]", f"[floor]\nz_mm = {z}\n\n[process]")
        )

    assert read_cell(cell(lowest - 0.01)).floor == pytest.approx(1e-3 * (lowest - 0.01))
    with pytest.raises(BadInput, match=r"cell\.toml: the wheel reaches 300 mm below the floor; correct wheel\.centre_mm"):
        read_cell(cell(lowest + 300.0))
    assert floor_notices(read_cell(cell(0))) == [] and "no floor was checked" in floor_notices(bundled_cell())[0]


def test_measuring_postures_of_the_virtual_cell_stay_over_the_floor(tmp_path):
    cell = bundled_cell()
    wall = replace(cell, robot=replace(cell.robot, gravity_direction=np.array([1.0, 0.0, 0.0])))
    cell = with_floor(wall, -2000.0)
    arm, T0 = make_arm(cell, draw_truth(cell, 0, mode="believed")), cell.tables.reference_temperature_C
    found = {}
    for name, one in (("floor", cell), ("none", wall)):
        q = tracker._postures(one, np.random.default_rng(0), 60)
        found[name] = height_over_floor(cell, arm.links(arm_moments(q, "", T0))).min()
    assert found["floor"] > 0 > found["none"]
    with pytest.raises(Infeasible, match="of 2200 postures drawn 0 keep off"):
        tracker._postures(with_floor(cell, 1000.0), np.random.default_rng(0), 5)
    rows = ["q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg", "0,-90,90,0,0,0", "0,-10,60,0,0,0"]
    (tmp_path / "poses.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(BadInput, match=r"poses\.csv, line 3, column q2_deg: -10 puts the arm \d+ mm into the floor"):
        tracker.design_from_poses(cell, tmp_path / "poses.csv")
    assert len(tracker.design_from_poses(bundled_cell(), tmp_path / "poses.csv")) == 2


def test_the_tracker_stands_on_the_floor_whatever_the_mounting():
    nests = [Nest(6, np.array([0.15, -0.05, 0.25]))]
    q = np.tile(LOW, (3, 1))
    for direction, floor, height in (
        ((0, 0, -1), None, 1.5),
        ((0, 0, 1), None, -1.5),
        ((0, 0, 1), -3000.0, -1.5),
        ((1, 0, 0), -2000.0, -0.5),
    ):
        cell = bundled_cell()
        cell = replace(cell, robot=replace(cell.robot, gravity_direction=np.array(direction, float)))
        cell = cell if floor is None else with_floor(cell, floor)
        stand = choose_stand(cell, Sight(), nests, q, np.random.default_rng(0))
        assert stand @ cell.up == pytest.approx(height) and np.hypot(STAND[0], height) == pytest.approx(np.linalg.norm(stand))


def test_what_hangs_on_the_flange_is_told_where_nobody_named_it(tmp_path):
    assert load_notices(bundled_cell()) == []
    light = ('payload = "grinder"\n', ""), ("[payloads.grinder]\nmass_kg = 25.0", "[payloads.grinder]\nmass_kg = 1.0")
    nobody, heavier = load_notices(read_cell(changed_cell(tmp_path, *light)))
    assert "'grinder', the first of [payloads], is taken to hang on the flange, 1 kg in the programs' $LOAD" in nobody
    assert "the force flange alone carries 5 kg, all that hangs on the robot is given 1 kg" in heavier
