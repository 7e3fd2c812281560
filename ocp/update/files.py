"""The folder of an update: cell, calibration with its covariance, report; and the line that says what moved."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.registration import ForceFit
from ocp.model.cell import Cell, cell_tables_for
from ocp.shell.cache import sha256
from ocp.shell.output import Output
from ocp.shell.progress import Phases
from ocp.update.drift import RADIUS, WEAR, Verdict, carried_on, force_spread, mean_slope
from ocp.update.history import History
from ocp.update.pattern import PatternFit
from ocp.update.removal import UNIT, Preston
from robots.calibration.store import Calibration, write_calibration
from robots.toml_files import toml_text


@dataclass(frozen=True)
class Updated:
    """One step: the fit of the log and the verdict on it; parts that the user said were changed; clocks s of the log's middle and
    of the next blade's; the state as handed in, as expected for the log, as found, as forecast for the next blade (what is
    written); history; Preston's coefficient for the next blade, None where unknown; what measured depths told, None without;
    notices."""

    cell: Cell
    log: ForceLog
    fit: ForceFit
    verdict: Verdict
    parts: tuple[str, ...]
    clocks: tuple[float, float]
    states: tuple[Calibration, Calibration, Calibration, Calibration]
    history: History
    preston: Preston | None
    pattern: PatternFit | None
    notices: tuple[str, ...]

    @property
    def latest(self) -> dict[str, float]:
        """This update's row of the history."""
        return {name: values[-1] for name, values in self.history.columns.items()}

    def change_since(self, name: str) -> tuple[float, float]:
        """By how much a parameter moved from what was expected, and one sigma of that."""
        expected, found = self.states[1], self.states[2]
        at, to = expected.names.index(name), found.names.index(name)
        gained = max(float(expected.covariance[at, at] - found.covariance[to, to]), 0.0)
        return float(found.values[to] - expected.values[at]), float(np.sqrt(gained))

    @cached_property
    def forecast(self) -> tuple[tuple[int, float, float], ...]:
        """The mean force N, with one sigma, that the program just run would press with on the next blades (1, 10, 30 ahead) if
        nothing were planned anew; 0 where it would lose contact."""
        found, solution = self.states[2], self.fit.solution
        period, slope = self.clocks[1] - self.clocks[0], mean_slope(solution, self.log, RADIUS)
        rows = []
        for blades in (1, 10, 30):
            later = carried_on(found, blades * period, grips=1)
            lost = later.values[later.names.index(RADIUS)] - found.values[found.names.index(RADIUS)]
            force = max(self.latest["found_N"] + slope * float(lost), 0.0)  # a wheel that is worn away does not pull
            rows.append((blades, force, force_spread(solution, self.log, later)))
        return tuple(rows)


@dataclass(frozen=True)
class UpdateResult:
    """An update that was written: its folder, what was found, the calibration for the next blade, and the one line about it."""

    folder: Path
    made: Updated
    calibration: Calibration
    notices: tuple[str, ...]
    line: str


def write_update(made: Updated, output: Output, phases: Phases, inputs: Sequence[Path]) -> UpdateResult:
    """Write the folder whole or not at all."""
    from ocp.update.report import update_report  # draws: heavier than the rest

    with output.whole() as folder:
        with phases.phase("writing"):
            write_calibration(folder / "calibration.toml", made.states[3])
            _write_updated_cell(made, folder / "cell.toml", output.named)
        with phases.phase("report"):
            update_report(made, {path.name: sha256(path) for path in inputs}).write_page(folder / "report.html")
    notices = (*made.notices, *made.fit.notices, *_removal_notices(made))
    return UpdateResult(output.named, made, made.states[3], notices, last_line(made, output.named))


def _write_updated_cell(made: Updated, path: Path, out: Path) -> None:
    """The cell that names the new calibration, with Preston's coefficient and the clock that it is for."""
    source = made.cell.path
    tables = cell_tables_for(source, out)
    tables["robot"]["calibration"] = "calibration.toml"
    if made.preston is not None:
        coefficient = {"preston_um_mm2_per_N_m": made.preston.value / UNIT, "preston_sd_um_mm2_per_N_m": made.preston.sd / UNIT}
        tables["process"] = tables.get("process", {}) | {k: float(f"{v:.6g}") for k, v in coefficient.items()}
    if made.cell.effects:
        tables["conditions"] = tables.get("conditions", {}) | {"clock_s": round(made.clocks[1], 1)}
    path.write_text(f"# {source.name} brought up to date with {made.log.path.name}\n" + toml_text(tables), encoding="utf-8")


def _removal_notices(made: Updated) -> tuple[str, ...]:
    p = made.preston
    if p is None:
        return ("Preston's coefficient is not known: depths are told relative; give --removal once to have micrometres",)
    if p.points and p.left_out:
        return (f"{p.left_out} of {p.points + p.left_out} depths lie where this log did not grind and were left out",)
    return ()


def last_line(made: Updated, out: Path) -> str:
    """What was found, what it means for the next blade, where it is."""
    latest, names = made.latest, made.states[2].names
    wear, radius = (made.states[2].standard_deviation[names.index(n)] for n in (WEAR, RADIUS))
    _, ahead, sd = made.forecast[0]
    preston = ""
    if made.preston is not None:
        how = f"from {made.preston.points} depths" if made.preston.points else "not measured this time"
        preston = f"Preston's coefficient {made.preston.value / UNIT:.3g} +- {made.preston.sd / UNIT:.2g} um mm2/(N m), {how}. "
    if made.pattern is not None:
        before, after = made.pattern.scatter
        preston += f"Depths are met {after:.2f} times as far as stated, {before:.2f} before they placed the blade. "
    return (
        f"{out}: {made.fit.figures.rows} readings of {made.log.path.name}, {latest['found_N']:.2f} +- "
        f"{latest['found_sd_N']:.2f} N on average where {latest['expected_N']:.2f} +- {latest['expected_sd_N']:.2f} N were "
        "expected; the wheel has changed by "
        f"{round(latest['radius_um']):+d} +- {1e6 * radius:.0f} um in radius and wears {round(latest['wear_um_per_h'])} +- "
        f"{3.6e9 * wear:.0f} um an hour; the same program would press {ahead:.2f} +- {sd:.2f} N on the next blade. {preston}"
        f"{out / 'cell.toml'} is the cell for it, for ocp.plan; {out / 'report.html'} says what moved."
    )
