"""The report of `python -m ocp.experiments`, and its last line: the paper's Table 2 and Figures 11 to 13 on many robots."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.ticker import MultipleLocator

from ocp.experiments.trial import STEPS, Trial
from ocp.report.parts import Plot, Points, Table, table
from ocp.report.plotting import Canvas, dots, dressed, keys, log_scale, panels
from ocp.report.report import Report
from ocp.report.section import Headline, Section
from ocp.report.style import AFTER, BAD, BEFORE, INK, SOFT

PAPER_POSITIONS = {"before": 1.186, "after": 0.154}  # mm, mean of Table 2
PAPER_FORCES = {"nothing calibrated": "11.4 .. 25.8", "robot only": "17.9 .. 20.8", "everything": "mean 20.4"}  # N


METHOD_WORDS = {
    "before": "before, in the base of the robot",
    "placed": "before, tracker and nests fitted",
    "full": "geometry and springs together (ours)",
    "geometry": "geometry alone",
    "relative": "differences of positions, springs inside",
    "relative-literal": "the paper's order, taken literally",
    "oracle": "oracle: 400 readings, no outliers",
}


@dataclass(frozen=True)
class PositionRow:
    """Absolute error of fresh poses by one method, mm: mean over all, median, 90 % and largest of the robots' means, largest
    single error."""

    method: str
    mean: float
    median: float
    p90: float
    worst: float
    max: float


@dataclass(frozen=True)
class ForceRow:
    """True force at the working points after one step, N: smallest and largest over all robots, mean over all; robots whose
    mean lies within 0.4 N of the process force (share), median and 90 % of the standard deviation within a robot; robots that
    lost contact somewhere; robots planned."""

    mount: str
    step: str
    low: float
    high: float
    mean: float
    near: float
    sd: float
    sd90: float
    off: int
    robots: int


def position_rows(trials: Sequence[Trial]) -> list[PositionRow]:
    """One row a method, "before" first."""
    rows = []
    for method in METHOD_WORDS:
        errors = [trial.positions[method] for trial in trials if method in trial.positions]
        if errors:
            means = np.array([e.mean() for e in errors])
            figures = means.mean(), np.median(means), np.quantile(means, 0.9), means.max(), max(e.max() for e in errors)
            rows.append(PositionRow(method, *map(float, figures)))
    return rows


def force_rows(trials: Sequence[Trial], wanted: float) -> list[ForceRow]:
    """One row a mount and step; `wanted` N is the process force."""
    rows = []
    for mount in dict.fromkeys(key.split("/")[0] for trial in trials for key in trial.force):
        for step in STEPS:
            forces = [trial.force[f"{mount}/{step}"] for trial in trials if f"{mount}/{step}" in trial.force]
            if not forces:
                continue
            means, sds = np.array([f.mean() for f in forces]), np.array([f.std() for f in forces])
            reached = min(f.min() for f in forces), max(f.max() for f in forces), means.mean()
            figures = *reached, np.mean(np.abs(means - wanted) <= 0.4), np.median(sds), np.quantile(sds, 0.9)
            low, high, mean, near, sd, sd90 = map(float, figures)
            lost = sum(bool((f <= 0).any()) for f in forces)
            rows.append(ForceRow(mount, step, low, high, mean, near, sd, sd90, lost, len(forces)))
    return rows


def last_line(trials: Sequence[Trial], wanted: float) -> str:
    """The result in a sentence."""
    position = {row.method: row for row in position_rows(trials)}
    words = (
        f"{len(trials)} virtual robots; fresh poses off by {position['before'].mean:.3f} mm before and "
        f"{position['full'].mean:.3f} mm after calibration (oracle {position['oracle'].mean:.3f}; paper 1.186 and 0.154)"
    )
    for row in force_rows(trials, wanted):
        if row.step == "everything":
            words += (
                f"; {row.mount}: force {row.low:.1f} .. {row.high:.1f} N, mean {row.mean:.2f}, {100 * row.near:.0f} % of robots "
                f"within 0.4 N, {row.sd:.2f} N standard deviation within a robot"
            )
    failed = sum(len(trial.failed) for trial in trials)
    return words + (f"; {failed} plans refused" if failed else "")


def write_experiments(trials: Sequence[Trial], wanted: float, folder: Path) -> None:
    """report.html and report.pdf in `folder`; `wanted` N is the process force."""
    title = f"{len(trials)} robots, {wanted:g} N"
    report = Report("Experiments on virtual robots", title, _headline(trials, wanted), (), experiment_sections(trials, wanted))
    report.write(folder)


def experiment_sections(trials: Sequence[Trial], wanted: float) -> list[Section]:
    """Positions, then forces by mount, then what the robots are."""
    words = (
        "Absolute error of fresh poses, mm: where the reflector is against where the model says, readings of other poses fitted. "
        f"The paper: {PAPER_POSITIONS['before']} before, {PAPER_POSITIONS['after']} after."
    )
    caption = "Mean error of each robot's fresh poses, log scale; in order of their error before."
    plot = Plot("positions", caption, 2.8, lambda canvas: _draw_positions(canvas, trials))
    found = [Section("Position (the paper's Table 2)", (words, position_table(trials), plot))]
    mounts = list(dict.fromkeys(row.mount for row in force_rows(trials, wanted)))
    for mount in mounts:
        words = "Force-setting flange" if mount == "flange" else "Rigid mount"
        caption = "True force at 20 working points of each robot (dots), its mean (line), after each step."
        draw = partial(_draw_forces, trials=trials, mount=mount, wanted=wanted)
        parts = (force_table(trials, wanted, mount), Plot(f"force-{mount}", caption, 3.6, draw))
        found.append(Section(f"{words} (Figures 11 to 13)", parts))
    failed = [f"robot {t.seed}, {key}: {reason}" for t in trials for key, reason in t.failed.items()]
    if failed:
        found.append(Section("Refused plans", (Points(tuple(failed)),)))
    found.append(Section("What was done", (Points(_PROCEDURE),)))
    return found


_PROCEDURE = (
    "Each robot is an arm of its own on a physics engine: six-component placement errors of every link, springs off by 20 %, "
    "masses by 1 %, gear ripple, play and repeatability that no model holds (docs/virtual_arm.md).",
    "It is measured by a laser tracker, calibrated by the method named, and judged on poses that were not measured.",
    "Working points lie on passes that the force ladder did not touch. Wheel, blade and mount are off by what the cell states as "
    "known, and registered by the ladder; force is the true one, without the sensor's noise.",
    "The oracle is the same model, all springs in it, fitted to 400 readings and to a ladder with a tenth of the noise: what is "
    "left is what no model holds.",
)


def position_table(trials: Sequence[Trial]) -> Table:
    """Table 2."""
    rows = [
        (METHOD_WORDS[r.method], *(f"{v:.3f}" for v in (r.mean, r.median, r.p90, r.worst, r.max))) for r in position_rows(trials)
    ]
    return table(("method", "mean", "median", "90 % of robots", "worst robot", "worst pose"), rows, strong=(2,))


def force_table(trials: Sequence[Trial], wanted: float, mount: str) -> Table:
    """Forces of one mount beside the paper's."""
    rows = []
    for r in force_rows(trials, wanted):
        if r.mount == mount:
            figures = (f"{r.mean:.2f}", f"{100 * r.near:.0f} %", f"{r.sd:.2f}", f"{r.sd90:.2f}", str(r.off))
            paper = PAPER_FORCES.get(r.step, "") if mount == "flange" else ""
            rows.append((r.step, f"{r.low:.1f} .. {r.high:.1f}", *figures, paper))
    figures_head = ("mean N", "robots within 0.4 N", "sd in a robot N", "90 % of robots", "robots that lost contact")
    return table(("calibrated", "least .. largest N", *figures_head, "the paper N"), rows, text=(0, 7))


def _headline(trials: Sequence[Trial], wanted: float) -> Headline:
    position = {row.method: row for row in position_rows(trials)}
    everything = [row for row in force_rows(trials, wanted) if row.step == "everything"]
    good = all(abs(row.mean - wanted) <= 0.1 and row.near >= 0.9 and row.sd <= 0.3 for row in everything if row.mount == "flange")
    good = good and position["full"].mean <= 0.09
    sentence = (
        f"Fresh poses are off by {position['full'].mean:.3f} mm after calibration, {position['before'].mean:.3f} mm before "
        f"(the best possible with this model: {position['oracle'].mean:.3f} mm)."
    )
    for row in everything:
        sentence += f" On the {row.mount} mount the force comes out at {row.mean:.2f} N, {row.low:.1f} to {row.high:.1f} N."
    return Headline(good, "The aims are met." if good else "Not all aims are met.", sentence, ())


def _draw_positions(canvas: Canvas, trials: Sequence[Trial]) -> None:
    ax = panels(canvas, 1, 1)[0][0]
    order = np.argsort([t.positions["before"].mean() for t in trials])
    colours = {"before": BEFORE, "placed": "#c3c9d0", "geometry": "#b07a1e", "relative": "#7b5ea7"}
    colours |= {"relative-literal": "#2a8a7a", "oracle": INK, "full": AFTER}
    for method, colour in colours.items():
        dots(ax, np.arange(1, len(order) + 1), [trials[k].positions[method].mean() for k in order], colour, 3.2)
    log_scale(ax)
    dressed(ax, "mm", "robot")
    keys(ax, list(colours.items()))


def _draw_forces(canvas: Canvas, trials: Sequence[Trial], mount: str, wanted: float) -> None:
    axes = panels(canvas, len(STEPS), 1, sharex=True, down=0.24)
    for row, step in zip(axes, STEPS, strict=True):
        ax, key = row[0], f"{mount}/{step}"
        for k, trial in enumerate(trials):
            if key in trial.force:
                force = trial.force[key]
                dots(ax, np.full(len(force), k + 1), force, BAD if (force <= 0).any() else AFTER, 1.6)
                ax.plot([k + 0.6, k + 1.4], [force.mean()] * 2, color=INK, lw=0.9)
        ax.axhline(wanted, color=SOFT, lw=0.6)
        dressed(ax, f"{step}: force, N")
    axes[-1][0].set_xlabel("robot", fontsize=7, labelpad=2)
    axes[-1][0].xaxis.set_major_locator(MultipleLocator(5))
