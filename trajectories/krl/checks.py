"""The refusals before a program leaves the house: everything a controller would reject or run in another way."""

from pathlib import Path

import numpy as np

from robots.errors import BadInput
from robots.pose import Array
from trajectories.krl.checks_structure import check_module, check_pair
from trajectories.krl.checks_text import check_files, program_files_of
from trajectories.krl.execution import Execution, Segment, execute
from trajectories.krl.reader import read_module
from trajectories.krl.status_turn import ArmLengths, status_of, turn_of

SAME = np.radians(1e-4)  # rad: two printed postures closer than this are one


def check_program(
    source: Path,
    axis_range: tuple[Array, Array] | None = None,
    arm: ArmLengths | None = None,
    absolute_accuracy: bool = False,
    pauses: bool = False,
) -> Execution:
    """What runs when `source` (the main .src) is started, after every check on all .src and .dat of its folder.

    `axis_range` (q_min, q_max) (6,) rad and `arm` bring the checks that need the machine; `absolute_accuracy` refuses
    poses; `pauses` lets a measuring program stand still (HALT, WAIT). Raises BadInput, which names file and line.
    """
    source = Path(source)
    check_files(source.parent)
    modules = {path: read_module(path) for path in program_files_of(source.parent)}
    for module in modules.values():
        check_module(module, pauses)
    stems = {(m.path.stem.upper(), m.path.suffix.lower()): m for m in modules.values()}
    for (stem, suffix), module in stems.items():
        if suffix == ".src":
            check_pair(module, stems[stem, ".dat"])
    execution = execute(source)
    _check_segments(execution.segments, axis_range, arm, absolute_accuracy)
    return execution


def _check_segments(
    segments: tuple[Segment, ...], axis_range: tuple[Array, Array] | None, arm: ArmLengths | None, absolute_accuracy: bool
) -> None:
    if not segments:
        raise BadInput("the program moves nothing; it calls no pass")
    where: Array | None = None
    for segment in segments:
        if segment.q is not None:
            if axis_range is not None:
                _check_range(segment, *axis_range)
            if segment.kind == "PTP_SPLINE" and where is not None and np.abs(segment.q[0] - where).max() > SAME:
                off = np.degrees(np.abs(segment.q[0] - where).max())
                raise BadInput(
                    f"{segment.file}, line {segment.lines[0]}: the block begins {off:.4f} deg off where the robot stands; "
                    "that way is not timed"
                )
            where = segment.q[-1]
            continue
        if absolute_accuracy:
            raise BadInput(
                f"{segment.file}, line {segment.lines[0]}: poses on an absolutely accurate controller compensate twice"
            )
        if segment.frames.ipo_mode != "#TCP":
            raise BadInput(f"{segment.file}, line {segment.lines[0]}: poses need $IPO_MODE=#TCP, the blade is on the robot")
        if segment.speed is None:
            raise BadInput(f"{segment.file}, line {segment.lines[0]}: $VEL.CP is not set before the path motion")
        if arm is not None and where is not None and segment.kind == "SPLINE":
            check_status_turn(segment, where[None], arm)
        changes = np.flatnonzero(np.diff(segment.status))
        if len(changes):
            raise BadInput(
                f"{segment.file}, line {segment.lines[changes[0] + 1]}: S changes inside a block; the branch would jump"
            )
        where = None


def _check_range(segment: Segment, low: Array, high: Array) -> None:
    assert segment.q is not None
    outside = np.maximum(segment.q - high, low - segment.q)
    if outside.max() > 1e-9:
        i, j = np.unravel_index(np.argmax(outside), outside.shape)
        raise BadInput(
            f"{segment.file}, line {segment.lines[i]}: axis {j + 1} at {np.degrees(segment.q[i, j]):.3f} deg is outside "
            f"{np.degrees(low[j]):.1f}..{np.degrees(high[j]):.1f} deg"
        )


def check_status_turn(segment: Segment, q: Array, arm: ArmLengths) -> None:
    """Refuse S or T of the first points of a segment that do not belong to the axes q (m, 6) rad, m <= n."""
    for name, given, right in (
        ("S", segment.status, status_of(q, arm)),
        ("T", segment.turn, turn_of(q)),
    ):
        wrong = np.flatnonzero(given[: len(q)] != right)
        if len(wrong):
            i = int(wrong[0])
            raise BadInput(f"{segment.file}, line {segment.lines[i]}: {name} is {given[i]} and the axes there have {right[i]}")
