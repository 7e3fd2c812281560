"""`ocp.api.simulate`: a plan in; the force that a virtual cell would show, and the logs that a day on it would give, out.

From files to a folder: read, check, drive, grind, measure, write; whole or not at all.
"""

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ocp.effects.catalogue import key_range
from ocp.model.cell import Cell, files_of, floor_notices, payloads_of, read_cell
from ocp.report.report import Report
from ocp.shell.output import Output, reserved
from ocp.shell.progress import Phases, Progress
from ocp.simulate.input import (
    MACHINES,
    AskedRun,
    believed_effects,
    blade_file,
    campaign_plan,
    cell_file,
    check_numbers,
    check_rate,
    in_words,
    plan_folder,
    planted_effects,
)
from ocp.simulate.report import (
    KIND,
    WholePasses,
    contact_figures,
    flange_in_words,
    missed_parts_figures,
    rehearsal_headline,
    rehearsal_sections,
)
from ocp.simulate.twin.arm import make_arm
from ocp.simulate.twin.controller import MissedParts, Track, drive, missed_parts
from ocp.simulate.twin.dataset import copy_cell, joint_log, write_force, write_joint_log, write_labels, write_removal
from ocp.simulate.twin.krl_text import KrlProgram, read_program
from ocp.simulate.twin.plan_knowledge import GRINDING, match, read_plan_table, read_summary, refuse_other_times, refuse_stranger
from ocp.simulate.twin.planting import EFFECT_KINDS, Planted
from ocp.simulate.twin.rehearsal import INSTRUMENT, GroundDepth, Rehearsal, ground_depth, measured_depth, rehearse, statistics
from ocp.simulate.twin.run import GrindingCampaign, VirtualMachine, arm_conditions, make_machine, refuse_crash, run_campaign
from ocp.simulate.twin.tracker import TrackerLog, tracker_log, write_tracker, write_tracker_truth
from ocp.simulate.twin.truth import Truth, draw_truth
from robots.errors import BadInput
from robots.payload import refuse_overload
from robots.robot import refuse_left_out
from trajectories.blade import read_blade


@dataclass(frozen=True)
class _Ground:
    """What became of the plan."""

    folder: Path
    program: KrlProgram
    track: Track
    machine: VirtualMachine
    campaign: GrindingCampaign
    rehearsal: Rehearsal
    missed: MissedParts | None
    travel: float  # s in which blade and wheel may touch in travel
    depth: GroundDepth

    @property
    def whole(self) -> WholePasses:
        """What the page shows of the passes from the air to the air."""
        return WholePasses(self.campaign.touched, self.depth, self.travel, flange_in_words(self.machine.cell))


def plantable_effects() -> str:
    """What can be planted: name, joints, keys with their typical range and unit."""
    lines = [f"{'effect':<22}{'joints':<9}keys: typical range, unit (a bare size goes to the first; +- either sign)"]
    for name, kind in sorted(EFFECT_KINDS.items()):
        joints = "".join(str(j) for j in kind.joints) or "-"
        keys = [
            "target of a nest" if k.unit == "name" else key_range(k.name, k.low, k.high, k.signed, k.length, k.unit)
            for k in kind.keys
        ]
        lines.append(f"{name:<22}{joints:<9}{'; '.join(keys)}")
    return "\n".join(lines)


@dataclass(frozen=True)
class SimulationResult:
    """A run of the virtual cell that was written: its folder; the rehearsal of the program (None without a plan); what was
    planted; rows of force.csv, readings of tracker.csv; and the one line that says what force was seen."""

    folder: Path
    rehearsal: Rehearsal | None
    planted: tuple[Planted, ...]
    rows: int
    readings: int
    notices: tuple[str, ...]
    line: str


def _simulated(
    wanted: AskedRun,
    cell: Cell,
    program: KrlProgram | None,
    folder: Path | None,
    summary: dict[str, Any],
    output: Output,
    phases: Phases,
) -> SimulationResult:
    out = output.named
    own, notices = believed_effects(wanted, cell)
    planted = planted_effects(wanted, cell, own)
    truth = draw_truth(cell, wanted.seed, planted, wanted.machine, wanted.size)  # type: ignore[arg-type]
    with phases.phase("tracker"):  # first: what is wrong with it is known at once
        log = _track(wanted, cell)
    ground = None
    if program is not None and folder is not None:
        hung = {cell.workpiece.payload_name: cell.workpiece.payload}
        notices += refuse_overload(str(cell.path), cell.robot, hung) + floor_notices(cell)
        notices += refuse_stranger(program, cell, summary, folder)
        ground = _grind(wanted, cell, truth, program, folder, phases)
        notices += ground.track.notices
    notices += [n for n in _campaign_notices(cell, log) if n not in notices]
    with output.whole() as partial, phases.phase("writing"):
        rows = _write(wanted, cell, truth, ground, log, partial, notices)
    rehearsal, readings = None if ground is None else ground.rehearsal, 0 if log is None else len(log.design)
    line = _last_line(wanted, out, truth, ground, log, rows)
    return SimulationResult(out, rehearsal, truth.effects, rows, readings, tuple(notices), line)


def _grind(wanted: AskedRun, cell: Cell, truth: Truth, program: KrlProgram, folder: Path, phases: Phases) -> _Ground:
    """Drive the program, refuse what would crash, run the campaign, judge its first run."""
    plan = campaign_plan(wanted, cell)
    if cell.workpiece.stl is None:
        raise BadInput(f"{cell.path}: names no blade; give it with --blade")
    with phases.phase("controller"):
        track = drive(program, cell.robot, wanted.hz)
        table = read_plan_table(folder)
        matched = match(track, table)
    with phases.phase("machine"):
        blade = read_blade(cell.workpiece.stl, cell.workpiece.stl_unit)
        machine = make_machine(cell, truth, blade, wanted.seed)
    with phases.phase("collisions"):
        travel = refuse_crash(machine, track, matched)
        if program.timed:
            refuse_other_times(track, table)
    with phases.phase("grinding"):
        campaign = run_campaign(machine, track, matched, plan, wanted.hz)
    with phases.phase("judging"):
        frames = program.motions[-1].frames
        rehearsal = rehearse(machine, matched, campaign.first, frames.tool, frames.base)
        grinding = {track.places[k] for k in np.unique(track.motion[matched.phase == GRINDING])}
        missed = missed_parts(program, cell.robot, grinding)
        depth = ground_depth(blade, campaign.patches, campaign.touched, cell.process, cell.wheel.belt_speed)
    return _Ground(folder, program, track, machine, campaign, rehearsal, missed, travel, depth)


def _track(wanted: AskedRun, cell: Cell) -> TrackerLog | None:
    """The tracker campaign; None where there is nothing to measure with or nothing is asked."""
    if wanted.poses == "0":
        nothing = "--poses 0 without a plan leaves nothing to do; name a plan's folder or ask for postures"
    elif cell.tables.tracker is None or not cell.tables.tracker.targets:
        nothing = f"{cell.path}: no nests in [tracker.targets], and no plan to grind; add one of them"
    else:
        return tracker_log(wanted.poses, cell, wanted.seed, wanted.sealed)
    if wanted.plan is None:
        raise BadInput(nothing)
    return None


def _campaign_notices(cell: Cell, log: TrackerLog | None) -> list[str]:
    """What could not be checked of a campaign's payloads. Raises BadInput: one is more than the robot carries."""
    campaigns = () if log is None else (log.design, log.sealed)
    names = {name for campaign in campaigns if campaign is not None for name in campaign.moments.payload}
    loads = {name: load for name, load in payloads_of(cell.tables).items() if name in names}
    return refuse_overload(str(cell.path), cell.robot, loads)


def _write(
    wanted: AskedRun, cell: Cell, truth: Truth, ground: _Ground | None, log: TrackerLog | None, out: Path, notices: list[str]
) -> int:
    """All files; the number of rows in force.csv."""
    copy_cell(cell, out)
    write_labels(out, truth, wanted.machine)
    if log is not None:
        arm = make_arm(cell, truth) if ground is None else ground.machine.arm
        write_tracker(out, cell, truth, arm, log)
        if log.sealed is not None:
            write_tracker_truth(out, cell, truth, arm, log.sealed)
    if ground is None:
        return 0
    shutil.copyfile(ground.folder / "plan.csv", out / "plan.csv")
    rows = write_force(out, ground.campaign.recorded, ground.campaign.sealed)
    metres = truth.preston * abs(cell.wheel.belt_speed) * ground.depth.unit
    places, removal = measured_depth(ground.depth, metres, np.random.default_rng([wanted.seed, 0x31]))
    over = float(ground.campaign.first.moments.campaign_time().max()) + 1.0  # before the blade is ground again
    write_removal(out, places, removal, INSTRUMENT, over)
    if wanted.joints:
        _write_joints(out / "joints.csv", wanted, ground)
    words = MACHINES[wanted.machine].format(seed=wanted.seed)
    words = words if wanted.sealed or not truth.effects else f"{words}, {in_words(truth.effects)}"
    title = f"{ground.program.main.stem} on {cell.name}"
    headline = rehearsal_headline(ground.rehearsal, ground.whole, words)
    sections = rehearsal_sections(ground.rehearsal, ground.missed, ground.whole, ground.machine.blade)
    Report(KIND, title, headline, notices, sections).write_page(out / "rehearsal.html")
    (out / "rehearsal.json").write_text(json.dumps(_json(wanted, truth, ground), indent=1) + "\n", encoding="utf-8")
    return rows


def _write_joints(path: Path, wanted: AskedRun, ground: _Ground) -> None:
    """Encoders along the whole program, at the log's rate."""
    track, machine = ground.track, ground.machine
    index = np.arange(0, len(track.time), max(1, round(wanted.hz / wanted.log_hz)), dtype=np.int64)
    rng = np.random.default_rng([wanted.seed, 0x30])
    m = arm_conditions(machine, track, index, 0.0)
    write_joint_log(path, joint_log(machine.arm, machine.truth, m, np.zeros(len(index)), track.time[index], rng))


def _json(wanted: AskedRun, truth: Truth, ground: _Ground) -> dict[str, Any]:
    """rehearsal.json: the figures, also line by line, and the worst places."""
    r = ground.rehearsal
    passes = [r.run == k for k in dict.fromkeys(r.run.tolist())]
    return {
        "schema": 1,
        "program": ground.program.main.name,
        "machine": wanted.machine,
        "seed": wanted.seed,
        "planted": None if wanted.sealed else in_words(truth.effects),
        "duration_s": ground.track.duration,
        "force": r.figures,
        "parts_missed": None if ground.missed is None else missed_parts_figures(ground.missed),
        "contact": contact_figures(ground.campaign.touched, ground.travel),
        "removal": {"plan": ground.depth.figures(ground.depth.planned), "machine": ground.depth.figures(ground.depth.made)},
        "lines": [{"line": int(r.line[mine][0]), **statistics(r.force[mine])} for mine in passes],
        "worst": [
            {"line": p.line, "s_mm": 1e3 * p.s, "p_mm": (1e3 * p.p).tolist()}
            | {"force_N": p.force, "parts_N": p.parts, "mostly": p.cause}
            for p in r.worst
        ],
    }


def _last_line(wanted: AskedRun, out: Path, truth: Truth, ground: _Ground | None, log: TrackerLog | None, rows: int) -> str:
    """What was seen, where it is written, what to do with it."""
    parts = []
    if ground is not None:
        driven = MACHINES[wanted.machine].format(seed=wanted.seed)
        parts.append(rehearsal_headline(ground.rehearsal, ground.whole, driven).sentence)
        worst = ground.rehearsal.worst[0]
        x, y, z = 1e3 * worst.p
        parts.append(
            f"Worst: {worst.force:.1f} N on line {worst.line} at s = {1e3 * worst.s:.0f} mm ({x:.0f}, {y:.0f}, {z:.0f}), mostly "
            f"{worst.cause}."
        )
    written = [f"{len(log.design)} readings in tracker.csv"] if log is not None else []
    written += [f"{rows} rows in force.csv"] if rows else []
    planted = "what was planted is sealed" if wanted.sealed else in_words(truth.effects)
    parts.append(f"{(' and '.join(written) or 'nothing logged').capitalize()}; {planted}.")
    if ground is not None:
        parts.append(f"Look at {out / 'rehearsal.html'}.")
    if log is not None:
        force = f" --force {out / 'force.csv'}" if rows else ""
        parts.append(f"Next: python -m ocp.calibrate {out / 'tracker.csv'}{force} --cell {out / 'cell.toml'}")
    return f"{out}: " + " ".join(parts)


def simulate(
    plan: str | Path | None = None,
    *,
    out: str | Path,
    cell: str | Path | None = None,
    blade: str | Path | None = None,
    effects: Sequence[str] = (),
    random: str | None = None,
    sealed: bool = False,
    machine: str = "drawn",
    seed: int = 0,
    size: float = 1.0,
    poses: str | Path | int = 40,
    ladder: Sequence[float] | None = None,
    belts: Sequence[float] = (),
    air: bool = True,
    joints: bool = False,
    hz: float = 250.0,
    log_hz: float = 25.0,
    clock: float = 0.0,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SimulationResult:
    """Rehearse the folder `plan` that `ocp.api.plan` wrote (None: a tracker campaign alone) on a virtual cell that shares no
    code with the planner, and write the data a real cell would give into the folder `out`.

    cell: None: the one the plan was made with; blade: where it is not the cell's own; effects: what to plant, each
    NAME[:JOINT][=SIZE] as backlash:5=2e-4; random: some more at random, as random:2; sealed: tell nothing of what was planted,
    and keep readings back; machine: drawn (real errors), believed (none) or sampled (of the calibration); seed: which machine;
    size: of its own errors, 1 as usual; poses: how many postures of the tracker campaign, or a folder of `choose_poses`;
    ladder: setpoints N of the force ladder (None: usual ones, empty: no ladder); belts: further belt speeds m/s; air: log a
    pass with the flange drawn back; joints: write joints.csv; hz: control rate 1/s; log_hz: rows of force.csv a second; clock:
    seconds that the campaign's clock shows at the start. Raises BadInput: an argument or a file is not what it should be;
    Infeasible: the program would crash or cannot be driven.
    """
    asked = dict(locals())  # by the names of `AskedRun`
    kept = {name: value for name, value in asked.items() if name not in ("out", "overwrite", "progress")}
    kept |= {name: None if kept[name] is None else Path(kept[name]) for name in ("plan", "cell", "blade")}
    kept |= {"effects": tuple(effects), "poses": str(poses), "belts": tuple(float(v) for v in belts)}
    wanted = AskedRun(**kept | {"ladder": None if ladder is None else tuple(float(v) for v in ladder)})
    check_numbers(wanted)
    folder = None if wanted.plan is None else plan_folder(wanted.plan)
    summary = {} if folder is None else read_summary(folder)
    program = None if wanted.plan is None else read_program(wanted.plan, planned=bool(summary))
    file = cell_file(wanted, summary)
    given = [Path(p) for p in (folder, wanted.blade, None if wanted.poses.isdigit() else wanted.poses) if p is not None]
    with reserved(Path(out), overwrite, [*files_of(file), *given]) as output:
        believed = read_cell(file, wanted.blade)
        refuse_left_out(file, believed.robot, "the virtual cell")
        check_rate(wanted, believed)
        if other := blade_file(wanted, summary, believed.workpiece.stl):
            output.reads([other])
            believed = read_cell(file, other)
        return _simulated(wanted, believed, program, folder, summary, output, Phases(progress))
