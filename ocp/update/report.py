"""The report of `python -m ocp.update`: what moved since the last blade, what the next ones will see, how deep it ground."""

import numpy as np
from matplotlib.ticker import MaxNLocator

from ocp.calibrate.report.pages import SHOWN, contact_sections
from ocp.report.parts import Plot, Points, Table, made_from, table
from ocp.report.plotting import Canvas, Draw, dots, dressed, keys, panels
from ocp.report.report import Report
from ocp.report.section import Headline, Section
from ocp.report.style import CURVE, SIDE_COLOURS, SOFT, TARGET
from ocp.update.drift import SURPRISE, WALKS
from ocp.update.interface import Updated
from ocp.update.removal import DEPTH_MODEL, HOURLY, UNIT
from robots.calibration.parameters import SYMBOLS
from robots.calibration.reading_model import ARM_NAMES, PAYLOAD_NAMES

UNITS = SHOWN | {"m/s": (3.6e9, "um/h")}
AHEAD = SIDE_COLOURS[3]
CLOSE = 0.5  # N between the force found and the one expected from which the page is not green: what a blade may be off by


def update_report(made: Updated, hashes: dict[str, str]) -> Report:
    """The whole page; hashes: SHA-256 by name of what it was made from."""
    title = f"{made.cell.name} after {made.log.path.name}"
    sections = [_ahead(made), _moved(made), *_removal(made), *contact_sections(made.fit), _process(), made_from(hashes)]
    return Report("Update of a cell", title, update_headline(made), (*made.notices, *made.fit.notices), sections)


def update_headline(made: Updated) -> Headline:
    """Whether the blade was ground as forecast, and what the next one needs."""
    latest, (_, ahead, sd) = made.latest, made.forecast[0]
    off = latest["found_N"] - latest["expected_N"]
    good = abs(off) < CLOSE
    sentence = (
        f"The blade was pressed with {latest['found_N']:.2f} +- {latest['found_sd_N']:.2f} N on average, {off:+.2f} N from what "
        f"was forecast ({latest['expected_sd_N']:.2f} N one sigma); with the same program the next one would get {ahead:.2f} +- "
        f"{sd:.2f} N."
    )
    v = made.verdict
    facts = [
        (
            "Can it have come from the last state",
            f"yes: chance {v.chance:.2g}, {v.directions} directions seen (below {SURPRISE:g}: no)",
        ),
        ("Said to be changed", ", ".join(made.parts) or "nothing"),
        ("Updates so far", str(len(made.history))),
    ]
    if made.preston is not None:
        facts.append(("Preston's coefficient", f"{made.preston.value / UNIT:.3g} +- {made.preston.sd / UNIT:.2g} um mm2/(N m)"))
    return Headline(good, "As forecast." if good else "Drifted further than forecast.", sentence, tuple(facts))


def _moved(made: Updated) -> Section:
    expected, found = made.states[1], made.states[2]
    rows: list[tuple[str, ...]] = []
    strong: list[int] = []
    for name, value, sd in zip(found.names, found.values, found.standard_deviation, strict=True):
        unit = SYMBOLS[name].unit
        if unit not in UNITS or name in ARM_NAMES or name in PAYLOAD_NAMES or name.startswith("base_"):
            continue
        factor, shown = UNITS[unit]
        at = expected.names.index(name)
        change, gained = made.change_since(name)
        if gained > 0 and abs(change) > 2.0 * gained:
            strong.append(len(rows))
        was = f"{factor * expected.values[at]:.3f}", f"{factor * expected.standard_deviation[at]:.3f}"
        rows.append(
            (SYMBOLS[name].meaning, *was, f"{factor * value:.3f}", f"{factor * sd:.3f}", f"{factor * change:+.3f}", shown)
        )
    words = (
        "Expected is the last state carried on to this blade by the process model below; found is that state with this log. "
        "Bold: moved by more than two standard deviations of what the log could move it by. The arm's own parameters follow by "
        "their correlation and are in calibration.toml."
    )
    columns = ("parameter", "expected", "one sigma", "found", "one sigma", "change", "unit")
    return Section("What moved", (words, table(columns, rows, text=(0, 6), strong=strong)))


def _ahead(made: Updated) -> Section:
    rows = [(f"{blades}", f"{force:.2f}", f"{sd:.2f}") for blades, force, sd in made.forecast]
    words = (
        "Mean force of the program just run on blades to come, if nothing is planned anew; 0: contact is lost. A plan with "
        f"the cell of this update is for the next blade, {made.clocks[1] - made.clocks[0]:.0f} s on the wheel's clock after the "
        "middle of this one."
    )
    caption = (
        "All updates: force on average as expected before the log and as found, and as forecast for blades to come with the same "
        "program; change of the wheel's radius; one sigma each, which for blades far ahead may leave the picture."
    )
    picture = Plot("update-history", caption, 2.4, _history(made))
    return Section("Forecast", (picture, words, table(("blades ahead", "force N", "one sigma N"), rows, text=(0,))))


def _history(made: Updated) -> Draw:
    h = {name: np.array(values) for name, values in made.history.columns.items()}

    def draw(canvas: Canvas) -> None:
        left, right = panels(canvas, 1, 2)[0]
        x = np.arange(1, len(made.history) + 1)
        left.errorbar(x - 0.1, h["expected_N"], h["expected_sd_N"], fmt="none", ecolor=SOFT, lw=0.8)
        dots(left, x - 0.1, h["expected_N"], SOFT)
        dots(left, x, h["found_N"], CURVE)
        ahead, force, sd = np.array(made.forecast).T
        left.errorbar(x[-1] + ahead, force, sd, fmt="none", ecolor=SOFT, lw=0.8)
        dots(left, x[-1] + ahead, force, AHEAD)
        wanted = made.cell.process.force if made.cell.flange is None else made.cell.flange.setpoint
        left.axhline(wanted, color=TARGET, lw=0.6)
        keys(left, [("expected", SOFT), ("found", CURVE), ("forecast", AHEAD)])
        right.errorbar(x, h["radius_um"], h["radius_sd_um"], fmt="none", ecolor=SOFT, lw=0.8)
        dots(right, x, h["radius_um"], CURVE)
        for axes in (left, right):
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        right.set_xlim(0.5, len(made.history) + 0.5)
        # The next blade and all before it; bars of blades far ahead may leave the picture.
        near = 3.0 * max(float(h["expected_sd_N"].max()), float(sd[0]))
        level = np.concatenate([h["expected_N"], h["found_N"], force, [wanted]])
        left.set_ylim(float(level.min()) - near, float(level.max()) + near)
        dressed(left, x="update", y="force N")
        dressed(right, x="update", y="change of radius um")

    return draw


def _removal(made: Updated) -> list[Section]:
    p = made.preston
    if p is None:
        return []
    words = (
        f"Preston's coefficient {p.value / UNIT:.3g} +- {p.sd / UNIT:.2g} um mm2/(N m): a depth that is planned with it is known "
        f"to {100 * p.sd / p.value:.0f} %."
    )
    if p.expected is None or p.measured is None:
        words += f" It was not measured this time; its doubt grows by {100 * HOURLY:.0f} % per root of an hour in contact."
        return [Section("Depth", (words,))]
    words += (
        f" {p.points} depths of this blade, {p.left_out} more lay where the log did not grind. They scatter {p.scatter:.2f} "
        f"times as far as stated (with {100 * DEPTH_MODEL:.0f} % for the footprint's shape)."
    )
    if made.pattern is not None:
        words += f" With the blade where the force log has it, {made.pattern.scatter[0]:.2f} times: they say where it sits."
    expected, measured = p.expected, p.measured

    def draw(canvas: Canvas) -> None:
        ax = panels(canvas, 1, 1)[0][0]
        dots(ax, 1e6 * expected, 1e6 * measured, CURVE)
        top = 1.05e6 * float(max(expected.max(), measured.max()))
        ax.plot([0, top], [0, top], color=TARGET, lw=0.6)
        dressed(ax, x="expected with the coefficient, um", y="measured um", grid="both")

    return [Section("Depth", (words, Plot("update-depth", "Depth measured against depth expected, a dot a point.", 2.4, draw)))]


def _process() -> Section:
    rows = []
    for walk in WALKS:
        factor, unit = (100.0, "%") if walk.relative else UNITS[SYMBOLS[walk.names[0]].unit]
        sizes = (f"{factor * size:.3g}" if size else "" for size in (walk.hourly, walk.grip))
        rows.append((", ".join(walk.names), *sizes, unit, walk.source))
    words = "How much each part may have moved since the last state without anybody's doing; one sigma."
    notes = Points(
        (
            "The radius falls by its wear rate times the wheel's clock; the rate follows from how the radius moved, log by log.",
            "All else stays where it was, but for the figures of this table. What moved more is said, not followed.",
        )
    )
    columns = ("parameters", "per root of an hour", "per blade gripped", "unit", "where it comes from")
    return Section("Process model", (words, Table(columns, tuple(rows), frozenset({1, 2})), notes))
