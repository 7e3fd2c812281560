"""The programs of a measurement, one a payload, and their reading back: what stops where, come from which side."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell
from ocp.plan.clearance.collision import CollisionScene
from ocp.plan.motion.air import is_free
from ocp.plan.programming import program_setup, write_program
from ocp.poses.order import MeasuringPose, Tour, approaches
from ocp.poses.rules import APPROACH_SHARE, READ_BACK_TOLERANCE
from robots.errors import Infeasible
from robots.tracker_readings import Hanging
from trajectories.dialects import dialect_named
from trajectories.program import program as written

MOST = 300  # poses of one sub-program; six points each at most without detours


@dataclass(frozen=True)
class MeasurementCampaign:
    """What is measured with one payload: its name and mass, stops in the order of the tour, their nests, the tour."""

    payload: str
    hanging: Hanging
    stops: list[MeasuringPose]
    targets: list[str]
    tour: Tour


def measuring_program(
    cell: Cell, campaign: MeasurementCampaign, angle: float, wait: written.Wait, name: str, speed: int, taken: set[str]
) -> written.Program:
    """The program of a campaign, which waits at every reading; `speed` percent of the axis speeds, `taken` names already used
    in the folder."""
    blocks: list[written.Block] = [written.PointMotion(campaign.tour.home, speed)]
    groups: list[list[written.Block]] = []
    for k, (pose, target, way) in enumerate(zip(campaign.stops, campaign.targets, campaign.tour.ways, strict=False)):
        blocks += [written.PointMotion(q, speed) for q in way[1:]]
        for reading, start in zip((1, 2), approaches(pose, angle), strict=True):
            if reading == 2:
                blocks.append(written.PointMotion(start, speed))
            text = f"pose {k + 1} of {len(campaign.stops)}, reading {reading}, target {target}"
            blocks += [written.Comment(text), written.PointMotion(pose.q, speed), wait]
        if (k + 1) % MOST == 0:
            groups.append(blocks)
            blocks = [written.PointMotion(pose.q, speed)]
    blocks += [written.PointMotion(q, speed) for q in campaign.tour.ways[-1][1:]]
    groups.append(blocks)
    dialect = dialect_named(cell.controller.dialect)
    main, names = dialect.program_names(f"{name}_{campaign.payload}", len(groups), taken=taken)
    label = f"readings with payload {campaign.payload}"
    subs = tuple(written.SubProgram(n[0], tuple(b), label) for n, b in zip(names, groups, strict=True))
    setup = program_setup(cell, campaign.hanging.mass, campaign.hanging.com)
    comments = (
        f"mount payload {campaign.payload}, {campaign.hanging.mass:g} kg, before this program starts",
        f"{len(campaign.stops)} poses, each read twice: after its axes came from either side",
        "the first move, to the home posture, starts where the robot stands: drive it in T1",
    )
    return written.Program(main, setup, subs, comments)


def write_and_check(
    cell: Cell, scene: CollisionScene, program: written.Program, campaign: MeasurementCampaign, angle: float, folder: Path
) -> list[str]:
    """Write a program into `folder`, read it back and compare. Names of its files.

    Raises BadInput as the independent checks do, Infeasible where the text does not stop where it should, comes from another
    side, or passes through something.
    """
    files = write_program(cell, program, folder)
    main, controller = files[0], cell.controller
    execution = dialect_named(controller.dialect).check(main, cell.robot, controller.absolute_accuracy, pauses=True)
    points = [s.q[-1] for s in execution.segments if s.q is not None]
    stopped = execution.stops
    wanted = [(pose.q, sign) for pose in campaign.stops for sign in (pose.sign, -pose.sign)]
    if len(stopped) != len(wanted):
        raise Infeasible(f"{main.name} read back stops {len(stopped)} times, {len(wanted)} readings were planned")
    for k, (at, (q, sign)) in enumerate(zip(stopped, wanted, strict=True)):
        last = points[at] - points[at - 1]
        wrong_side = (np.sign(last) != sign).any() or np.abs(last).min() < APPROACH_SHARE * angle
        if np.abs(points[at] - q).max() > READ_BACK_TOLERANCE or wrong_side:
            raise Infeasible(f"{main.name} read back is not where reading {k + 1} was planned, or comes from another side")
    if not is_free(scene, np.array(points)):
        raise Infeasible(f"{main.name} read back touches something between its points")
    return [file.name for file in files]


def base_name(text: str) -> str:
    """What a program is called before the payload's name is added: at most 8 letters and digits."""
    return re.sub(r"[^A-Za-z0-9]", "", text)[:8] or "POSES"
