"""`ocp.api.choose_poses`: a cell in; where to put the robot before a calibration, as a table and programs, out.

The folder: programs first, read back, then table, summary and report; whole or not at all.
"""

import csv
import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ocp.data import CELL
from ocp.model.cell import files_of
from ocp.poses.candidates import Sight
from ocp.poses.planning import MOST_POSES, PoseOptions, PosePlan, make_poses
from ocp.poses.program import base_name, measuring_program, write_and_check
from ocp.poses.report import poses_report
from ocp.shell.cache import sha256
from ocp.shell.output import Output, reserved
from ocp.shell.progress import Phases, Progress
from robots.bounds import refuse_outside
from robots.calibration.layout import Priors
from robots.calibration.noise import Noise
from robots.calibration.observability import CRITERIA, identifiable_basis, observability, posterior_sd, singular_values
from robots.calibration.parameters import SYMBOLS
from robots.errors import BadInput
from robots.pose import Array
from robots.tracker_readings import APPROACH, AXES
from trajectories.dialects import dialect_named
from trajectories.program.program import Wait

COLUMNS = ("target", "payload", *AXES, *APPROACH)


@dataclass(frozen=True)
class PosesResult:
    """Poses that were chosen and written: the folder, the choice with what to expect of it, and the one line that says so."""

    folder: Path
    plan: PosePlan
    line: str

    @property
    def notices(self) -> tuple[str, ...]:
        """What the user should know of the choice."""
        return self.plan.notices


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
    known = ("zone", *CRITERIA)
    if options.criterion not in known:
        raise BadInput(f"--criterion '{options.criterion}' is not one of {', '.join(known)}")
    wait, number, turned = options.pausing.seconds, options.pausing.input, options.acceptance
    refuse_outside(
        ("-n", options.count, 1, MOST_POSES, "poses"),
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


def _place(tracker: Sequence[float]) -> Array:
    if np.shape(tracker) != (3,):
        raise BadInput(f"--tracker has {np.size(tracker)} numbers; give x, y and z")
    return np.asarray(tracker, float)


def write_poses(plan: PosePlan, output: Output, phases: Phases, inputs: Sequence[Path]) -> PosesResult:
    """Write the folder of a choice. Raises BadInput and Infeasible; then the folder is as it was."""
    out = output.named
    with output.whole() as folder:
        with phases.phase("writing"):
            programs = _write_programs(plan, folder)
            rows = write_poses_csv(plan, folder / "poses.csv")
            _write_json(plan, programs, inputs, folder / "poses.json")
        with phases.phase("report"):
            report = poses_report(plan)
            report.write(folder)
    return PosesResult(out, plan, last_line(plan, out, rows, len(programs)))


def last_line(plan: PosePlan, out: Path, rows: int, programs: int) -> str:
    """What was chosen, what to expect of it, whether more poses would help, and what to do next."""
    curve = plan.curve
    if curve.enough is None:
        more = f"more than {int(curve.count[-1]) - 10} poses still help"
    else:
        more = f"beyond {curve.enough} poses ten more improve that by less than 5 %"
    title = dialect_named(plan.cell.controller.dialect).title + " program"
    mounted = " then ".join(f"{c.payload} ({len(c.stops)})" for c in plan.campaigns)
    place = ", ".join(f"{1e3 * v:.0f}" for v in plan.tracker)
    total, own, scatter = (f"{1e3 * v:.3f}" for v in (curve.chosen_total, curve.chosen, plan.design.repeatability))
    return (
        f"{out}: {len(plan.chosen)} poses, {rows} readings, {programs} {title}{'s' if programs > 1 else ''} for {mounted}; "
        f"tracker at ({place}) mm, {plan.tracker_from}. Expected in the grinding zone after calibration: {total} mm (one sigma; "
        f"calibration {own}, robot's own scatter {scatter}); {more}. "
        f"Drive the programs in T1 first; x_mm, y_mm, z_mm of the readings go into {out / 'poses.csv'}."
    )


def write_poses_csv(plan: PosePlan, path: Path) -> int:
    """The readings in driving order in the columns of tracker.csv that are known beforehand; how many."""
    count = 0
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for campaign in plan.campaigns:
            for stop, target in zip(campaign.stops, campaign.targets, strict=True):
                axes = [f"{v:.5f}" for v in np.degrees(stop.q) + 0.0]
                for sign in (stop.sign, -stop.sign):
                    writer.writerow([target, campaign.payload, *axes, *(f"{s:.0f}" for s in sign)])
                    count += 1
    return count


def _write_programs(plan: PosePlan, folder: Path) -> list[dict[str, Any]]:
    """Programs of all campaigns, written and read back; what the summary tells of each."""
    taken: set[str] = set()
    told = []
    options = plan.options
    for campaign in plan.campaigns:
        program = measuring_program(plan.cell, campaign, options.approach, options.pausing, options.name, options.speed, taken)
        files = write_and_check(plan.cell, plan.scene, program, campaign, options.approach, folder)
        taken |= set(files)
        travel = round(campaign.tour.seconds / (0.01 * options.speed), 1)
        written = {"program": files[0], "files": files, "payload": campaign.payload, "poses": len(campaign.stops)}
        told.append(written | {"travel_s": travel})
    return told


def _write_json(plan: PosePlan, programs: list[dict[str, Any]], inputs: Sequence[Path], path: Path) -> None:
    """poses.json: the choice, what to expect of it, and what it rests on."""
    design, curve, chosen = plan.design, plan.curve, plan.chosen
    basis = identifiable_basis(design.pool.rows, design.pool.prior, len(chosen))
    singular = singular_values(design.pool.rows[chosen], design.pool.prior, basis)
    kept = posterior_sd(design.pool.rows[chosen], design.pool.prior)
    content = {
        "schema": 1,
        "poses": len(chosen),
        "readings": 2 * len(chosen),
        "criterion": plan.options.criterion,
        "expected_mm": {
            "grinding_zone": 1e3 * curve.chosen_total,
            "calibration": 1e3 * curve.chosen,
            "robot_scatter": 1e3 * design.repeatability,
        },
        "enough_poses": curve.enough,
        "curve": [
            {"poses": int(n), "calibration_mm": 1e3 * float(c), "grinding_zone_mm": 1e3 * float(t)}
            for n, c, t in zip(curve.count, curve.calibration, curve.total, strict=True)
        ],
        "identifiable_directions": basis.shape[1],
        "observability": {name: float(observability(singular, len(chosen), name)) for name in CRITERIA},
        "unknowns": {
            name: {"sd_over_prior": float(k), "unit": SYMBOLS[name].unit if name in SYMBOLS else ""}
            for name, k in zip(design.layout.names, kept, strict=True)
        },
        "tracker_mm": (1e3 * plan.tracker).round(1).tolist(),
        "tracker": plan.tracker_from,
        "targets": sorted({t for c in plan.campaigns for t in c.targets}),
        "programs": programs,
        "candidates": {
            "free": len(plan.candidates.q),
            "seen": int(plan.candidates.seen.any(axis=1).sum()),
            "near_the_wheel": int(plan.candidates.near.sum()),
        },
        "assumptions": _assumptions(plan),
        "notices": list(plan.notices),
        "seed": plan.options.seed,
        "inputs": [{"name": p.name, "sha256": sha256(p)} for p in inputs],
        "versions": {"python": platform.python_version()} | {n: version(n) for n in ("numpy", "scipy", "casadi")},
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _assumptions(plan: PosePlan) -> list[str]:
    options = plan.options
    found = [
        f"lengths are known to {1e3 * options.priors.length:g} mm and angles to {1e3 * options.priors.angle:g} mrad before",
        f"every axis comes back to the same place within {1e6 * options.noise.joints:g} urad (one sigma)",
        "the expected accuracy holds for a robot that the model describes: gears, backlash and heat come on top",
        "the payloads' own shapes are not in the cell: blade, holder and the reflectors' brackets stand for them",
        f"reflectors {Sight.reach[0]:g} to {Sight.reach[1]:g} m away are seen if no link, blade or wheel is in between",
    ]
    if options.acceptance is not None:
        angle = f"{np.degrees(options.acceptance):g} deg"
        found.append(f"reflectors look away from their link's z axis and are seen within {angle} to every side")
    return found
