"""`ocp.api.choose_poses`: a cell in; where to put the robot before a calibration, as a table and programs, out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ocp.data import CELL
from ocp.model.cell import files_of
from ocp.poses.files import PosesResult, write_poses
from ocp.poses.planning import PoseOptions, make_poses
from ocp.poses.program import base_name
from ocp.shell.output import reserved
from ocp.shell.progress import Phases, Progress
from robots.calibration.layout import Priors
from robots.calibration.noise import Noise
from robots.errors import BadInput
from robots.pose import Array
from trajectories.program.program import Wait

CRITERIA = ("zone", "O1", "O2", "O3", "O4", "O5")


def choose_poses(
    cell: str | Path = CELL,
    *,
    out: str | Path,
    count: int = 40,
    criterion: str = "zone",
    payloads: Sequence[str] = (),
    targets: Sequence[str] = (),
    tracker: Sequence[float] | None = None,
    seed: int = 0,
    name: str = "POSES",
    approach: float = np.radians(2.0),
    wait: float | None = None,
    wait_input: int | None = None,
    speed: int = 20,
    acceptance: float | None = None,
    length_sd: float = 1e-3,
    angle_sd: float = 1e-3,
    joint_noise: float = 1e-5,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> PosesResult:
    """Choose the `count` poses of a laser-tracker campaign that tell most, and write poses.csv, KRL programs and a report into
    the folder `out`.

    criterion: zone (accuracy at the wheel), or O1 to O5 of the literature; payloads, targets: names of the cell's (none: the
    one it grinds with, all nests); tracker (3,) m: its head in the base frame (None: chosen); approach rad: how far before
    every axis an approach begins; wait s at a reading, or for the controller's input `wait_input` (neither: the program halts);
    speed: percent of the axis speeds; acceptance rad: of a reflector about away from its link's z axis; length_sd m, angle_sd
    rad: one sigma before the calibration; joint_noise rad: repeatability of an axis, one sigma. Raises BadInput: an argument or
    the cell is not what it should be; Infeasible: too few postures are free and seen.
    """
    asked = count, criterion, tuple(payloads), tuple(targets), None if tracker is None else _place(tracker), seed
    driven = base_name(name), float(approach), Wait(wait, wait_input), speed, acceptance
    options = PoseOptions(*asked, *driven, Priors(length=length_sd, angle=angle_sd), Noise(joint_noise))
    _refuse_options(options)
    phases, inputs = Phases(progress), [Path(cell)]
    with reserved(Path(out), overwrite, files_of(Path(cell))) as output:
        return write_poses(make_poses(Path(cell), options, phases), output, phases, inputs)


def _refuse_options(options: PoseOptions) -> None:
    """Refuse (BadInput) what nobody can want, by the name that it has on the command line."""
    if options.criterion not in CRITERIA:
        raise BadInput(f"--criterion '{options.criterion}' is not one of {', '.join(CRITERIA)}")
    wait, number, turned = options.pausing.seconds, options.pausing.input, options.acceptance
    _refuse_outside(
        ("--approach", float(np.degrees(options.approach)), 0.1, 20.0, "deg"),
        ("--speed", options.speed, 1, 100, "percent"),
        ("--wait", wait, 0.1, 3600.0, "s"),
        ("--input", number, 1, 8192, ""),
        ("--acceptance", None if turned is None else float(np.degrees(turned)), 1.0, 180.0, "deg"),
        ("--prior-mm", 1e3 * options.priors.length, 1e-3, 100.0, "mm"),
        ("--prior-mrad", 1e3 * options.priors.angle, 1e-3, 100.0, "mrad"),
        ("--joint-noise", 1e6 * options.noise.joints, 0.1, 1000.0, "urad"),
        ("--seed", options.seed, 0, 2**32, ""),
    )
    if wait is not None and number is not None:
        raise BadInput("--wait and --input exclude each other; give one of them")


def _refuse_outside(*limits: tuple[str, float | None, float, float, str]) -> None:
    """Refuse an option whose value lies outside its least and most; each with its unit."""
    for option, value, low, high, unit in limits:
        if value is not None and not low * (1 - 1e-12) <= value <= high * (1 + 1e-12):
            raise BadInput(f"{option} {value:g} must lie between {low:g} and {high:g} {unit}".rstrip())


def _place(tracker: Sequence[float]) -> Array:
    if np.shape(tracker) != (3,):
        raise BadInput(f"--tracker has {np.size(tracker)} numbers; give x, y and z")
    return np.asarray(tracker, float)
