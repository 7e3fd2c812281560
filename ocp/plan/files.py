"""The plan folder: programs first, read back and judged, then table, summary and reports; whole or not at all."""

import json
import platform
import re
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ocp.plan.accuracy import accuracy_columns, accuracy_rows
from ocp.plan.grades import Grades, grade_force, grade_move
from ocp.plan.kept import line_of
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.planning import Plan
from ocp.plan.programming import Timeline, build_timeline, emitted_times, grinding_program, write_plan_csv, write_program
from ocp.plan.readback import Readback, read_back
from ocp.plan.report.plan_report import PlanReport, build_report
from ocp.plan.second_route import believed_robot
from ocp.shell.cache import sha256
from ocp.shell.output import Output
from ocp.shell.processes import cores, side_by_side
from ocp.shell.progress import Phases
from trajectories.dialects import dialect_named

PACKAGES = ("casadi", "pin", "numpy", "scipy", "toppra", "matplotlib", "trimesh", "netgen-mesher", "pytetwild", "typst")


@dataclass(frozen=True)
class PlanResult:
    """A plan whose written program was read back and found safe: the folder, the plan, what it promises, and what was written."""

    folder: Path
    plan: Plan
    readback: Readback
    grades: Grades
    written: str

    @property
    def line(self) -> str:
        """What was written, and where, in one line."""
        return line_of(self.folder, self.written)

    @property
    def verdict(self) -> str:
        """What it promises in two sentences."""
        return self.grades.sentences()

    @property
    def notices(self) -> tuple[str, ...]:
        """What the user should know of a plan that stands."""
        return self.plan.notices


@dataclass(frozen=True)
class _Written:
    """What of the written plan the summary tells."""

    main: str
    files: list[str]
    timeline: Timeline
    readback: Readback


def write_plan(plan: Plan, output: Output, phases: Phases) -> PlanResult:
    """Write the folder of a plan. Raises BadInput and Infeasible of every part; then the folder is as it was."""
    output.reads(file for _, file in plan.inputs)
    with output.whole() as folder:
        plan, written = _verified(plan, folder, phases)
        plan = replace(plan, notices=(*plan.notices, *_renamed(plan.name, written.main)))
        with phases.phase("report"):
            summary = _summary(plan, written)
            grades = grades_of(plan, written.readback)
            report = build_report(plan, written.timeline, grades, summary)
            write_plan_report(report, folder)
        with phases.phase("writing"):
            _write_json(plan, written, summary, grades, folder / "plan.json")
    dialect = dialect_named(plan.cell.controller.dialect)
    told = (
        f"{len(plan.motion.passes)} passes, {plan.waypoints} waypoints, {len(written.files)} {dialect.title} files, "
        f"{grades.headline[0].lower()}{grades.headline[1:]} {grades.sentences()}"
    )
    return PlanResult(output.named, plan, written.readback, grades, told)


def _verified(plan: Plan, folder: Path, phases: Phases) -> tuple[Plan, _Written]:
    """The programs of the passes whose force reads back as planned; the others are left out. Raises as `write_plan`."""
    while True:
        try:
            return plan, _write_programs(plan, folder, phases)
        except CannotGrind as error:
            if plan.whole:
                raise
            plan = plan.without(error)
            for file in folder.iterdir():
                file.unlink()


def _renamed(name: str, program: str) -> tuple[str, ...]:
    """A notice where a program's name has other letters than what it was to be called: two of them may then be one."""
    asked, called = ({re.sub(r"[\W_]", "", one).upper() for one in some} for some in ((name, Path(name).stem), (program,)))
    if asked & called:
        return ()
    return (f"'{name}' is no name for a program on the controller: it is called {program}; --name gives it another",)


def _write_programs(plan: Plan, folder: Path, phases: Phases) -> _Written:
    cell = plan.cell

    def table() -> None:
        flange = cell.tables.force_flange  # as commanded: what it sets beyond that is in the cell's own
        setpoint = flange.setpoint_N if flange is not None else np.nan
        more = [*plan.removal.columns(timeline), *accuracy_columns(plan.accuracy, plan.motion, timeline)]
        write_plan_csv(timeline, folder / "plan.csv", setpoint, more)

    with phases.phase("writing"):
        program = grinding_program(cell, plan.motion, plan.kind, plan.name)
        files = write_program(cell, program, folder)
        timeline = build_timeline(plan.motion, emitted_times(plan.motion, program))
    with phases.phase("reading back"):
        values = plan.theta.values
        believed = believed_robot(cell, values[:30].reshape(6, 5), values[30:36], float(values[36]), values[37:40])
        readback = read_back(cell, believed, plan.cover, plan.cloud, plan.motion, files[0], table)
    return _Written(files[0].stem, sorted(file.name for file in files), timeline, readback)


def grades_of(plan: Plan, readback: Readback) -> Grades:
    """The two grades of a written plan."""
    goal, asked = _asked(plan)
    stopped = max(float(one.stopped.max()) for one in readback.passes)
    force = grade_force(plan.cell, goal, plan.force_sd, readback.force_error, readback.blends, stopped)
    return Grades(grade_move(readback), force, asked)


def _asked(plan: Plan) -> tuple[float, str]:
    """Largest force that the paths ask for, N, and all of them in words."""
    force = np.concatenate([p.problem.path.force * p.problem.way.peak for p in plan.motion.passes])
    low, high = float(force.min()), float(force.max())
    return high, f"{high:g} N" if high - low < 1e-9 else f"the {low:.3g} to {high:.3g} N planned"


def _summary(plan: Plan, written: _Written) -> list[tuple[str, str]]:
    """What it is, and its value with its unit."""
    motion, back, goal = plan.motion, written.readback, _asked(plan)[0]
    ways, passes = [s for s in motion.segments if s.kind == "pass"], [p.grinding() for p in motion.passes]
    force = np.concatenate(
        [
            found.force[(found.s >= one.problem.path.s[0]) & (found.s <= one.problem.path.s[-1])]
            for found, one in zip(back.passes, passes, strict=True)
        ]
    )
    sd = np.concatenate([p.evaluation.force_sd for p in passes])
    stiffness = np.concatenate([p.evaluation.stiffness for p in passes])
    compliance = np.concatenate([p.problem.compliance[:, 0] for p in passes])
    contact = sum(
        float(np.ptp(written.timeline.time[written.timeline.contact & (written.timeline.segment == i)]))
        for i, s in enumerate(motion.segments)
        if s.kind == "pass"
    )
    deflection = " to ".join(f"{c * goal * 1e3:.4f}" for c in (compliance.min(), compliance.max()))
    worst = [max(getattr(s.trajectory.worst, name) for s in motion.segments) for name in ("velocity", "acceleration", "torque")]
    feed = max(s.trajectory.worst.feed for s in ways)
    said = " of the planned motion: the program travels by slow PTP and takes longer" if plan.kind == "lin" else ""
    rows = [
        ("Passes, waypoints", f"{len(motion.passes)}, {plan.waypoints}", ""),
        ("Force asked for", _asked(plan)[1], ""),
        ("Force by the independent route", f"{force.min():.3f} to {force.max():.3f}", "N"),
        ("Largest difference to the force asked for", f"{back.force_error:.4f}", "N"),
        ("Contact in the air by the independent route", f"{back.touching_in_air:.3f}", "s"),
        ("Standard deviation of the force", f"{sd.min():.2f} to {sd.max():.2f}", "N"),
        ("Stiffness of the contact chain", f"{stiffness.min() / 1e3:.2f} to {stiffness.max() / 1e3:.2f}", "N/mm"),
        ("Blade deflection under the force", deflection, "mm"),
        ("Axes read back against the plan", f"{np.degrees(back.axis_error):.6f}", "deg"),
        ("Duration, of it in contact", f"{motion.duration:.1f}, {contact:.1f}", f"s{said}"),
        ("Largest use of speed, acceleration, torque limits", ", ".join(f"{w:.3f}" for w in worst), ""),
        ("Largest feed over the one asked for", f"{feed:.3f}", ""),
        ("Table of the wheel, largest held-out error", f"{plan.wheel_error * 1e6:.1f}", "um"),
        ("Blade compliance, estimated error", f"{100 * plan.compliance_error:.2f}", "%"),
    ]
    if back.blends is not None:
        off = f"{back.blends.force:.2f} N, {100 * back.blends.dose:.1f}"
        rows.append(("Lines that blend: force off on ramps, force over feed off along 5 mm", off, "%"))
    rows += accuracy_rows(plan.accuracy, motion.passes)
    return [(label, f"{value} {unit}".strip()) for label, value, unit in rows]


def _write_json(plan: Plan, written: _Written, summary: list[tuple[str, str]], grades: Grades, path: Path) -> None:
    """plan.json: status, summary, inputs and their hashes, versions; the only file that tells of this machine."""
    content = {
        "schema": 1,
        "status": grades.status,
        "verdict": grades.sentences(),
        "grades": grades.document(),
        "summary": dict(summary) | {"Functions of the model": plan.evaluated_by},
        "force_error_N": written.readback.force_error,
        "force_sd_max_N": plan.force_sd,
        "duration_s": plan.motion.duration,
        "passes": [
            {"line": path.line, "side": path.side, "waypoints": len(path.s), "iterations": p.solution.iterations}
            for p in plan.motion.passes
            for path in [p.problem.path]
        ],
        "process": plan.removal.figures.document() | {"contact_in_travel_s": round(written.readback.touching_in_air, 4)},
        "left_out": [one.document() for one in plan.left_out],
        "files": written.files,
        "inputs": [{"role": role, "name": p.name, "sha256": sha256(p)} for role, p in plan.inputs],
        "notices": list(plan.notices),
        "versions": {"python": platform.python_version()} | {name: version(name) for name in PACKAGES},
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def write_plan_report(report: PlanReport, folder: Path) -> None:
    """Write report.html and report.pdf into `folder`; equal reports give equal bytes. Raises OSError."""
    count = min(cores(), 4)  # of some eight pictures: who draws one or two puts all the pages together for them
    shares = [(k, count) for k in range(count)]
    with side_by_side(_drawn, shares, report) as parts:
        drawn = {key: svg for part in parts for key, svg in part.items()}
    with side_by_side(_write_as, [("html",), ("pdf",)], report, folder, drawn) as written:
        list(written)


def _drawn(report: PlanReport, share: int, of: int) -> dict[str, str]:
    """The pictures of one share of the report."""
    from ocp.plan.report.pages import plan_pages  # brings what draws, which a plan's own process does without

    return {plot.key: plot.drawn() for plot in plan_pages(report).plots()[share::of]}


def _write_as(report: PlanReport, folder: Path, drawn: dict[str, str], kind: str) -> None:
    from ocp.plan.report.pages import plan_pages

    pages = plan_pages(report).with_plots(drawn)
    write = {"html": pages.write_page, "pdf": pages.write_pdf}[kind]
    write(folder / f"report.{kind}")
