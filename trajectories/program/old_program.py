"""A path taken from an existing program, through the nominal kinematics."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from robots.errors import BadInput
from robots.pose import Array, invert
from trajectories.program.execution import Execution, ProgramSegment


@dataclass(frozen=True)
class OldPass:
    """Points of one uninterrupted path motion of an old program.

    `frames` (n, 4, 4): pose of the wheel frame in the blade frame, P = (FLANGE TOOL)^-1 BASE with the cell's frames;
    `flange` (n, 4, 4) nominal poses in the base; `q` (n, 6) rad where the program gives axes; `feed` (n,) m/s toward each point,
    nan where the program does not tell (a block with times has bounds, not a feed); `times` (n,) s of such a block, else None;
    `file` and `lines` (n,) where they stand.
    """

    frames: Array
    flange: Array
    q: Array | None
    feed: Array
    file: str
    lines: Array
    times: Array | None = None


def contact_frames_from_program(
    execution: Execution, forward: Callable[[Array], Array], T_flange_blade: Array, T_base_wheel: Array
) -> tuple[tuple[OldPass, ...], tuple[str, ...]]:
    """Passes of an old program, as its dialect reads it, and notices about what was passed over.

    A pass is a spline block, or straight motions in a row; moves to a point separate passes. Poses become flange poses
    with the frames the program itself sets; where it names only their numbers, `T_flange_blade` and
    `T_base_wheel` stand in and a notice says so. What the contact point is follows from `frames`: its origin, where
    `T_base_wheel` lies on the wheel's surface; else project it. Raises BadInput where there is no path in it.
    """
    notices = list(execution.notices)
    passes: list[OldPass] = []
    group: list[ProgramSegment] = []

    def close() -> None:
        if sum(len(s.lines) for s in group) > 1:
            passes.append(_pass(group, forward, T_flange_blade, T_base_wheel, notices))
        group.clear()

    for segment in execution.segments:
        single = segment.kind == "line"
        if not single or (group and group[0].file != segment.file):
            close()
        if segment.kind != "point":
            group.append(segment)
        if not single:
            close()
    close()
    if not passes:
        raise BadInput(f"{execution.source}: no path of two or more straight or spline points was found in the program")
    return tuple(passes), tuple(dict.fromkeys(notices))


def _pass(
    group: list[ProgramSegment], forward: Callable[[Array], Array], tool: Array, base: Array, notices: list[str]
) -> OldPass:
    flange = np.concatenate([_flange(s, forward, tool, base, notices) for s in group])
    q = np.concatenate([s.q for s in group if s.q is not None]) if all(s.q is not None for s in group) else None
    frames = invert(flange @ tool) @ base
    lines = np.concatenate([s.lines for s in group])
    told = [s.speed if s.times is None and s.speed is not None else np.nan for s in group]
    feed = np.repeat(np.array(told, float), [len(s.lines) for s in group])
    return OldPass(frames, flange, q, feed, group[0].file, lines, group[0].times)


def _flange(segment: ProgramSegment, forward: Callable[[Array], Array], tool: Array, base: Array, notices: list[str]) -> Array:
    if segment.q is not None:
        return forward(segment.q)
    assert segment.poses is not None
    own = segment.frames
    if own.tool is None or own.base is None:
        lacking = [("tool", own.tool_no, "blade")] if own.tool is None else []
        lacking += [("base", own.base_no, "wheel")] if own.base is None else []
        names = " and ".join(f"{name} {number}" if number is not None else f"the {name}" for name, number, _ in lacking)
        frames = " and ".join(f"{cells} frame" for *_, cells in lacking)
        are = "are" if len(lacking) > 1 else "is"
        notices.append(f"{segment.file}: {names} {are} not in the program; the cell's {frames} {are} taken")
    known = replace(own, tool=tool if own.tool is None else own.tool, base=base if own.base is None else own.base)
    return known.flange(segment.poses)
