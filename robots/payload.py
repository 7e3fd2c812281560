"""May a robot carry what hangs on its flange? Rated mass, load diagram, and what the wrist's axes have to hold and to turn.

Where the maker's diagram is known it decides: the mass allowed falls along straight lines between its points, nothing is allowed
beyond its last one. Where only the rated load and its centre are known, a payload may ask no more of axes 4, 5 and 6 than that
load: its static moment m g l, l the longest lever about the axis that any posture of the wrist gives it, and (where the rated
inertia is known) its moment of inertia m l^2 + I. Where the mass alone is known, the axes' own torques limit the static moment.
"""

from collections.abc import Mapping

import numpy as np

from robots.errors import BadInput
from robots.gravity import GRAVITY
from robots.kinematics import link_frames
from robots.pose import Array
from robots.robot import RatedPayload, Robot
from robots.tracker_readings import Hanging

WRIST = (4, 5, 6)
STEP = np.radians(5.0)  # of axes 5 and 6 in search of the longest lever, which it misses by at most 0.1 % (1 - cos 2.5 deg)
ROUNDING = 1.001


def refuse_overload(file: str, robot: Robot, loads: Mapping[str, Hanging]) -> list[str]:
    """Notices of what could not be checked about payloads, by name. Raises BadInput, with the cell's `file`: one is too much."""
    told = set[str]()
    for name, load in loads.items():
        if load.mass > 0.0:
            if reason := overload(robot, load):
                raise BadInput(f"{file}, payloads.{name}: {reason}; hang less on the flange or choose a stronger robot")
            told |= _unchecked(robot, name, load)
    return sorted(told)


def overload(robot: Robot, load: Hanging) -> str:
    """Why a payload is too much for the robot, with figures; empty where nothing that is known speaks against it."""
    rated = robot.payload
    if rated is not None and load.mass > rated.mass:
        return f"mass_kg = {load.mass:.10g} is above the {rated.mass:g} kg that {robot.title} carries"
    if rated is not None and rated.diagram is not None:
        return _beyond_diagram(robot, rated.diagram, load)
    lever = longest_levers(robot, load.com)
    asked = load.mass * GRAVITY * lever
    if rated is None or rated.com is None:
        limit, whose = robot.torque_max[3:], "the axis has"
    else:
        at_rated = longest_levers(robot, rated.com)
        limit, whose = rated.mass * GRAVITY * at_rated, f"the rated {rated.mass:g} kg ask at their centre"
    for axis, torque, most in zip(WRIST, asked, limit, strict=True):
        if torque > ROUNDING * most:
            place = _millimetres(load.com)
            return f"{load.mass:g} kg at {place} mm ask up to {torque:.0f} N m of axis {axis}, {most:.0f} N m are what {whose}"
    if rated is not None and rated.com is not None and rated.inertia is not None:
        return _too_sluggish(rated.mass * at_rated**2 + rated.inertia.max(), load, lever)
    return ""


def _beyond_diagram(robot: Robot, diagram: Array, load: Hanging) -> str:
    away = float(np.linalg.norm(load.com))
    allowed = float(np.interp(away, diagram[:, 0], diagram[:, 1], right=0.0))
    if load.mass <= allowed:
        return ""
    return f"{load.mass:g} kg with their centre {1e3 * away:.0f} mm from the flange: {robot.title} carries {allowed:.1f} kg there"


def _too_sluggish(limit: Array, load: Hanging, lever: Array) -> str:
    for axis, inertia, most in zip(WRIST, load.mass * lever**2 + load.inertia.max(), limit, strict=True):
        if inertia > ROUNDING * most:
            return (
                f"its moment of inertia about axis {axis} is up to {inertia:.1f} kg m^2, that of the rated load {most:.1f} kg m^2"
            )
    return ""


def _millimetres(place: Array) -> str:
    return "(" + ", ".join(f"{1e3 * v:.0f}" for v in place) + ")"


def longest_levers(robot: Robot, com: Array) -> Array:
    """Longest distances (3,) m of a point (3,) m of the flange from axes 4, 5 and 6 over all postures of the wrist.

    The distance from an axis is the same wherever that axis has turned to: from axis 6 it is one number, from axis 5 it varies
    with joint 6 alone, from axis 4 with joints 5 and 6."""
    turn = np.arange(0.0, 2 * np.pi, STEP)
    q = np.zeros((len(turn), 6))
    q[:, 5] = turn
    frames = link_frames(robot, q)
    point = frames[:, 6, :3, :3] @ com + frames[:, 6, :3, 3]
    of_6, of_5 = (np.einsum("nji,nj->ni", frames[:, j, :3, :3], point - frames[:, j, :3, 3]) for j in (5, 4))
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y, z = of_5.T
    turned = np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, (len(turn), len(z)))], axis=2)
    R, o = frames[0, 3, :3, :3], frames[0, 3, :3, 3]
    of_4 = (turned @ frames[0, 4, :3, :3].T + frames[0, 4, :3, 3] - o) @ R
    return np.array([np.hypot(p[..., 0], p[..., 1]).max() for p in (of_4, of_5, of_6)])


def _unchecked(robot: Robot, name: str, load: Hanging) -> set[str]:
    """What about a payload nothing known could judge, a sentence each."""
    rated: RatedPayload | None = robot.payload
    found = set()
    if rated is None:
        found.add(f"no payload was checked against a rated mass: the robot file of {robot.title} has no [payload]")
    elif rated.diagram is None:
        known = "mass and the torques of axes 4 to 6" if rated.com is None else "load and its centre"
        at = f"{load.mass:g} kg, {1e3 * np.linalg.norm(load.com):.0f} mm from the flange"
        what = f"payload '{name}' ({at}) was not checked against a load diagram"
        found.add(f"{what}: of {robot.title} only the rated {known} are known, ask its maker")
    if rated is not None and rated.diagram is None and rated.com is not None and rated.inertia is None:
        found.add(f"no payload was checked against a rated inertia: that of {robot.title} is unknown")
    if (rated is None or (rated.diagram is None and rated.com is None)) and not np.isfinite(robot.torque_max[3:]).all():
        found.add(f"no payload was checked against the torques of axes 4 to 6: those of {robot.title} are unknown")
    if not load.inertia.any():
        found.add(f"payload '{name}' was taken as a point: its own inertia, payloads.{name}.inertia_kg_m2, is not given")
    return found
