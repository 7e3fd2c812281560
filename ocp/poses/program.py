"""The KRL programs of a measurement, one a payload, and their reading back: what stops where, come from which side."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell, wheel_frame
from ocp.plan.motion.air import is_free
from ocp.plan.motion.collision import Scene
from ocp.poses.order import Stop, Tour, approaches
from robots.errors import Infeasible
from robots.pose import Array
from robots.tracker_readings import Hanging
from trajectories.krl import program as krl
from trajectories.krl.checks import check_program
from trajectories.krl.names import program_names
from trajectories.krl.status_turn import ArmLengths
from trajectories.krl.syntax import Call, Module, Motion, Number, Pause
from trajectories.krl.writer import program_files

MOST = 300  # poses of one sub-program; six points each at most without detours
PRINTED = np.radians(1e-5)  # rad, what printing may round


@dataclass(frozen=True)
class Pausing:
    """How the robot waits for a reading: `seconds`, an `input` of the controller, or with neither a HALT."""

    seconds: float | None = None
    input: int | None = None


@dataclass(frozen=True)
class Campaign:
    """What is measured with one payload: its name and mass, stops in the order of the tour, their nests, the tour."""

    payload: str
    hanging: Hanging
    stops: list[Stop]
    targets: list[str]
    tour: Tour


def measuring_program(
    cell: Cell, campaign: Campaign, angle: float, pausing: Pausing, name: str, speed: int, taken: set[str]
) -> krl.Program:
    """The program of a campaign; `speed` percent of the axis speeds, `taken` names already used in the folder."""
    stop = krl.Stop(pausing.seconds, pausing.input)
    blocks: list[krl.Block] = [krl.PointMotion(campaign.tour.home, speed)]
    groups: list[list[krl.Block]] = []
    for k, (pose, target, way) in enumerate(zip(campaign.stops, campaign.targets, campaign.tour.ways, strict=False)):
        blocks += [krl.PointMotion(q, speed) for q in way[1:]]
        for reading, start in zip((1, 2), approaches(pose, angle), strict=True):
            if reading == 2:
                blocks.append(krl.PointMotion(start, speed))
            blocks += [krl.Comment(f"pose {k + 1} of {len(campaign.stops)}, reading {reading}, target {target}"),
                       krl.PointMotion(pose.q, speed), stop]  # fmt: skip
        if (k + 1) % MOST == 0:
            groups.append(blocks)
            blocks = [krl.PointMotion(pose.q, speed)]
    blocks += [krl.PointMotion(q, speed) for q in campaign.tour.ways[-1][1:]]
    groups.append(blocks)
    main, names = program_names(f"{name}_{campaign.payload}", len(groups), taken=taken)
    label = f"readings with payload {campaign.payload}"
    subs = tuple(krl.SubProgram(n[0], tuple(b), label) for n, b in zip(names, groups, strict=True))
    setup = krl.Setup(
        T_flange_blade=cell.workpiece.T_flange_blade,
        T_base_wheel=wheel_frame(cell),
        arm=ArmLengths.of(cell.robot.mdh),
        tool_no=cell.controller.tool_no,
        base_no=cell.controller.base_no,
        load_mass=campaign.hanging.mass,
        load_com=campaign.hanging.com,
    )
    comments = (
        f"mount payload {campaign.payload}, {campaign.hanging.mass:g} kg, before this program starts",
        f"{len(campaign.stops)} poses, each read twice: after its axes came from either side",
        "the first move, to the home posture, starts where the robot stands: drive it in T1",
    )
    return krl.Program(main, setup, subs, comments)


def write_and_check(cell: Cell, scene: Scene, program: krl.Program, campaign: Campaign, angle: float, folder: Path) -> list[str]:
    """Write a program into `folder`, read it back and compare. Names of its files.

    Raises BadInput as the independent checks do, Infeasible where the text does not stop where it should, comes from another
    side, or passes through something.
    """
    files = program_files(program)
    for file, data in files.items():
        (folder / file).write_bytes(data)
    robot = cell.robot
    main = folder / next(iter(files))
    execution = check_program(
        main, (robot.q_min, robot.q_max), ArmLengths.of(robot.mdh), cell.controller.absolute_accuracy, pauses=True
    )
    points, stopped = _driven({m.path.stem.upper(): m for m in execution.modules if m.path.suffix == ".src"}, main.stem.upper())
    wanted = [(pose.q, sign) for pose in campaign.stops for sign in (pose.sign, -pose.sign)]
    if len(stopped) != len(wanted):
        raise Infeasible(f"{main.name} read back stops {len(stopped)} times, {len(wanted)} readings were planned")
    for k, (at, (q, sign)) in enumerate(zip(stopped, wanted, strict=True)):
        last = points[at] - points[at - 1]
        if np.abs(points[at] - q).max() > PRINTED or (np.sign(last) != sign).any() or np.abs(last).min() < 0.9 * angle:
            raise Infeasible(f"{main.name} read back is not where reading {k + 1} was planned, or comes from another side")
    if not is_free(scene, np.array(points)):
        raise Infeasible(f"{main.name} read back touches something between its points")
    return list(files)


def _driven(modules: dict[str, Module], main: str) -> tuple[list[Array], list[int]]:
    """Axes (6,) rad of all points in the order driven, and at which of them the program pauses."""
    points: list[Array] = []
    stopped: list[int] = []
    for call in modules[main].statements:
        if not isinstance(call, Call) or call.name.upper() not in modules:
            continue
        for s in modules[call.name.upper()].statements:
            if isinstance(s, Motion):
                points.append(_axes(s))
            elif isinstance(s, Pause):
                stopped.append(len(points) - 1)
    return points, stopped


def _axes(motion: Motion) -> Array:
    values = [motion.target.get(f"A{i}") for i in range(1, 7)] if hasattr(motion.target, "get") else []
    return np.radians([v.value for v in values if isinstance(v, Number)])


def base_name(text: str) -> str:
    """What a program is called before the payload's name is added: at most 8 letters and digits."""
    return re.sub(r"[^A-Za-z0-9]", "", text)[:8] or "POSES"
