"""The page of several blades: a row each, with what its plan promises and where its report is."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from ocp.plan.grades import NOT_TO_GRIND
from ocp.report.parts import table
from ocp.report.report import Report
from ocp.report.section import Headline, Section

Row = Mapping[str, Any]
COLUMNS = (
    "blade",
    "verdict",
    "force read back within N",
    "sd of the force N",
    "ground",
    "core within 5 %, 10 %",
    "program min",
    "planned in s",
    "page",
)


def night_page(rows: Sequence[Row], asked: int, cell: str) -> Report:
    """The page of the rows of night.json, of `asked` blades in a cell."""
    good = [row for row in rows if row["exit_code"] == 0]
    words = {row["headline"] for row in good}
    waiting = f" {asked - len(rows)} are still to be planned." if asked > len(rows) else ""
    verdict = "Not done yet." if waiting else "All have a plan." if len(good) == len(rows) else "Some have no plan."
    well = len(good) == len(rows) and not waiting and NOT_TO_GRIND not in words
    head = Headline(well, verdict, words_of(rows) + waiting, doubtful=words != {"Safe to use."})
    facts = [("Cell", cell)]
    if good:
        facts.append(("Programs together", f"{sum(row['duration_s'] for row in good) / 3600:.2f} h"))
    sections = [Section("Blades", (table(COLUMNS, [_cells(row) for row in rows], text=(0, 1, 8)),))]
    failed = [(row["name"], row["reason"]) for row in rows if row["exit_code"] != 0]
    if failed:
        sections.insert(0, Section("Without a plan", (table(("blade", "why"), failed, text=(0, 1)),)))
    return Report("Grinding plans", f"{asked} blades", replace(head, facts=tuple(facts)), (), sections)


def words_of(rows: Sequence[Row]) -> str:
    """How many blades are safe, in a sentence."""
    safe = sum(row["exit_code"] == 0 for row in rows)
    lost = len(rows) - safe
    failed = f", {lost} {'has' if lost == 1 else 'have'} no plan" if lost else ""
    return f"{safe} of {len(rows)} blades are safe to move{failed}."


def _cells(row: Row) -> tuple[str, ...]:
    seconds = "" if row["seconds"] is None else f"{row['seconds']:.0f}"
    if row["exit_code"] != 0:
        return row["name"], "no plan", "", "", "", "", "", seconds, ""
    process = row["process"]
    core = ", ".join(_share(process[f"core_within_{k}"]) for k in (5, 10))
    link = Markup('<a href="{}">report</a>').format(quote(row["link"]))
    force = f"{row['force_error_N']:.3f}", f"{row['force_sd_max_N']:.2f}"
    minutes = f"{row['duration_s'] / 60:.1f}"
    return row["name"], row["headline"], *force, _share(process["ground_share"]), core, minutes, seconds, link


def _share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.0f} %"
