"""rehearsal.html: what force a program would be seen to make on the virtual cell, as one page that loads nothing."""

from collections.abc import Sequence
from pathlib import Path

from ocp.report.page import render_page
from ocp.report.section import Headline, Section, Table, table
from ocp.simulate.report.rehearsal_plots import blade_plot, lines_plot, parts_plot
from ocp.simulate.twin.rehearsal import PARTS, Rehearsal
from trajectories.blade import Blade

KIND = "Rehearsal on a virtual cell"
GOOD = 0.95  # share of samples within 1 N from which the page is green
WORDS = {
    "arm": "the arm stands elsewhere",
    "wheel": "the wheel stands elsewhere",
    "blade": "the blade is held elsewhere",
    "contact": "stiffness, friction, planted effects",
}


def verdict(rehearsal: Rehearsal, machine: str) -> Headline:
    """Whether the program would grind as planned, in figures. `machine`: what it was run on, in words."""
    f = rehearsal.figures
    good = f["within_1_N"] >= GOOD
    sentence = (
        f"On {machine} the force would be {f['mean_N']:.2f} N on average with a standard deviation of {f['sd_N']:.2f} N, from "
        f"{f['min_N']:.1f} to {f['max_N']:.1f} N, where {f['goal_N']:.3g} N were planned; "
        f"{100 * f['within_1_N']:.0f} % of the time within 1 N."
    )
    if f["lost"] > 0:
        sentence += f" For {100 * f['lost']:.1f} % of the time the blade does not touch the wheel."
    return Headline(good, "As planned." if good else "Not as planned.", sentence)


def write_rehearsal_page(
    rehearsal: Rehearsal, blade: Blade, title: str, machine: str, notices: Sequence[str], path: Path
) -> None:
    """Write the page; equal rehearsals give equal bytes. Raises OSError where the file cannot be written."""
    text = render_page(title, verdict(rehearsal, machine), notices, _sections(rehearsal, blade), KIND)
    path.write_bytes(text.encode("utf-8", "replace"))


def _sections(rehearsal: Rehearsal, blade: Blade) -> tuple[Section, ...]:
    intro = (
        "The programs were read from their files and driven on a virtual cell that shares no code with the planner's model. The "
        "force shown is the true one between blade and wheel, not what the sensor reads."
    )
    parts = (
        "The error of the force is followed along the chain: the flange stands where the plan did not expect it (arm), then the "
        "wheel and the blade stand elsewhere than the frames of the program say; each by its share of the overlap times the "
        "stiffness of the whole chain. What is left is of the contact: cover, blade and flange, friction, what was planted."
    )
    return (
        Section("Force on the blade", (intro, blade_plot(rehearsal, blade))),
        Section("Force along each line", (lines_plot(rehearsal),)),
        Section("Where the errors come from", (parts, parts_plot(rehearsal), _parts_table(rehearsal))),
        Section("Worst places", (_worst_table(rehearsal),)),
    )


def _parts_table(rehearsal: Rehearsal) -> Table:
    figures = rehearsal.figures
    mean = rehearsal.parts.mean(axis=0)
    rows = [(name, WORDS[name], f"{mean[k]:+.2f}", f"{figures[f'rms_{name}_N']:.2f}") for k, name in enumerate(PARTS)]
    error = rehearsal.force - rehearsal.goal
    rows.append(("together", "", f"{error.mean():+.2f}", f"{figures['rms_error_N']:.2f}"))
    return table(("part", "what it means", "mean, N", "rms, N"), rows, text=(0, 1))


def _worst_table(rehearsal: Rehearsal) -> Table:
    rows = [
        (str(p.line), f"{1e3 * p.s:.1f}", "{:.1f}, {:.1f}, {:.1f}".format(*(1e3 * p.p)), f"{p.force:.1f}",
         *(f"{p.parts[name]:+.1f}" for name in PARTS), p.cause)
        for p in rehearsal.worst
    ]  # fmt: skip
    columns = ("line", "s, mm", "x, y, z of the blade, mm", "force, N", *(f"{name}, N" for name in PARTS), "mostly")
    return table(columns, rows, text=(2, 4 + len(PARTS)))
