"""`ocp.api.update`: the cell of the last posterior and one blade's force log in; the cell for the next blade out.

The folder of an update: cell, calibration with its covariance, report; and the line that says what moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ocp.calibrate.force.fit import BIAS, unmodelled_force
from ocp.calibrate.force.log import ForceLog, is_known, log_mark, steady_rows, without_ramps
from ocp.calibrate.force.registration import RECORDINGS, ForceFit, fit_force, refuse_other_force
from ocp.calibrate.force.rows import ForceSetup, prepare_force
from ocp.calibrate.interface import logged_cell
from ocp.model.calibrated_for import made_for
from ocp.model.cell import Cell, cell_tables_for, files_of
from ocp.model.theta import believed_theta
from ocp.shell.cache import sha256
from ocp.shell.output import Output, reserved
from ocp.shell.progress import Phases, Progress
from ocp.update.drift import (
    PARTS,
    RADIUS,
    UNUSUAL,
    WEAR,
    Verdict,
    carried_on,
    changed_state,
    force_spread,
    last_state,
    mean_slope,
    verdict_on,
)
from ocp.update.history import History, history_of, is_number, running_time, usual_way
from ocp.update.pattern import PatternFit, fit_pattern, ground_log
from ocp.update.removal import (
    UNIT,
    MeasuredDepths,
    Preston,
    ground_by_then,
    joined_preston,
    less_sure,
    on_blade,
    read_removal,
    with_shared_errors,
)
from robots.calibration.carried import FORCE, UPDATE
from robots.calibration.store import Calibration, write_calibration
from robots.errors import BadInput, Infeasible, shown
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
            write_calibration(folder / "calibration.toml", made_for(made.states[3], made.cell.tables, made.cell.robot))
            _write_updated_cell(made, folder / "cell.toml", output.named)
        with phases.phase("report"):
            update_report(made, {path.name: sha256(path) for path in inputs}).write_page(folder / "report.html")
    notices = (*made.states[0].notices, *made.notices, *made.fit.notices, *_removal_notices(made))
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


PRESTON_SD = 0.3  # of a coefficient whose sigma the cell does not tell
GROWN = 3.0  # standard deviations below none, from which a wear rate is told as no wear
SAME_WEAR = 5e-6  # m over a log, by which another wear rate is worth another fit


def update(
    force: str | Path,
    *,
    cell: str | Path,
    blade: str | Path | None = None,
    out: str | Path = "update",
    removal: str | Path | None = None,
    changed: Sequence[str] = (),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> UpdateResult:
    """Bring `cell` up to date from the force log `force` (force.csv) of the blade that was last ground with it, and from depths
    measured on that blade, `removal` (removal.csv): where it sits, the cover, Preston's coefficient. Write cell, calibration and
    report into `out`.

    blade: the file of the blade that was ground, where it is not the cell's own.
    changed: what was changed since the last update, of wheel, blade (its holder), flange, belt, sensor: known as at first again.
    Raises BadInput: an argument or a file is not what it should be; Infeasible: the log cannot be of this cell as it was last
    known. Nothing is written then.
    """
    log_file, cell_file, phases = Path(force), Path(cell), Phases(progress)
    depths = None if removal is None else Path(removal)
    parts = _known_parts(changed)
    ground = None if blade is None else Path(blade)
    inputs = [log_file, *(file for file in (ground, depths) if file is not None), *files_of(cell_file)]
    with reserved(Path(out), overwrite, inputs) as output:
        measured = None if depths is None else read_removal(depths)
        believed, log = logged_cell(cell_file, log_file, blade=ground)
        if "flange" in parts and believed.flange is None:
            raise BadInput(f"--changed flange: {cell_file} has no [force_flange]; leave it out")
        history = history_of(believed.calibration, cell_file)
        if history.holds is None:
            history = replace(history, stated=(believed.process.preston or 0.0, believed.process.preston_sd or 0.0))
        mark = log_mark(without_ramps(log, believed.flange is not None))
        if is_known(mark, history.logs) or sha256(log_file) in history.logs:
            raise BadInput(f"{log_file}: an earlier update used recordings of this log; give the log of the blade ground since")
        if is_known(mark, [_force_told(believed.calibration).get(RECORDINGS, "")]) or _made_from(believed.calibration, log_file):
            raise BadInput(
                f"{log_file}: the cell was calibrated with recordings of this log; give the log of the blade ground since"
            )
        with phases.phase("contact"):
            setup = prepare_force(replace(believed, calibration=None), [log])
        with phases.phase("fit"):
            made = updated(believed, log, setup, history, mark, parts, measured)
        return write_update(made, output, phases, inputs)


def _known_parts(changed: Sequence[str]) -> tuple[str, ...]:
    for part in changed:
        if part not in PARTS:
            raise BadInput(f"--changed {shown(part)}: is none of {', '.join(PARTS)}; give one of them")
    return tuple(dict.fromkeys(changed))


def updated(
    cell: Cell,
    log: ForceLog,
    setup: ForceSetup,
    history: History,
    mark: str,
    parts: tuple[str, ...] = (),
    removal: MeasuredDepths | None = None,
) -> Updated:
    """One step of the filter; setup: of the log alone, of the cell without its calibration; mark: `log_mark` of the log.

    Raises Infeasible: the fit does not come to rest, log or removal cannot have come from the cell as last known.
    """
    holds = _state_holds(cell, log, history)
    wheel = running_time(cell, log, history, holds)
    clock, now = wheel.time, float(wheel.time[log.contact].mean())
    before = changed_state(last_state(cell), cell, parts)
    since = now - (float(clock.min()) if holds is None else holds)
    expected = carried_on(before, since, int(history.holds is None), wheel.stood)
    flange = cell.flange is not None
    kept = steady_rows(log, flange)
    still = setup.take(kept)
    fit, *verdicts = _fitted(cell, without_ramps(log, flange), still, expected, (now - clock)[kept])
    verdict = verdicts[-1]
    if not verdict.possible:
        raise Infeasible(_impossible(log, fit, verdicts, parts))
    refuse_other_force(cell, fit)
    found = fit.calibration(expected)
    preston, told = _known_preston(cell, wheel.contact, "belt" in parts), None
    if removal is not None:
        over = ground_by_then(removal, log)
        ground = ground_log(cell, setup.model, setup.rows[0], log, kept, fit.solution, over)
        told = fit_pattern(ground, found, fit.solution.x[:BIAS], removal, *on_blade(cell, removal))
        pressed = over & log.contact
        force, sd = fit.solution.reading - fit.solution.x[BIAS], fit.predicted[1]
        unsure = float(np.median(sd[fit.log.contact]) / np.median(force[fit.log.contact]))
        told = replace(told, preston=with_shared_errors(removal, told.preston, len(np.unique(log.run[pressed])), unsure))
        found, preston = told.calibration, joined_preston(preston, told.preston)
    # The first one as if the next blade followed at once.
    ahead = now + (usual_way((*history.columns["clock_s"], now)) or float(clock.max() + 0.5 * np.ptp(clock) - now))
    coming = carried_on(found, ahead - now, grips=1)
    entry = _entry(fit, clock[kept], expected, found, preston)
    grown_history = history.grown((float(clock.max()), ahead, wheel.offset), mark, entry)
    coming = replace(coming, provenance=coming.provenance | {UPDATE: grown_history.table()})
    moments, states = (now, ahead), (before, expected, found, coming)
    notices = (*wheel.notices, *_older(cell, log, history), *_unusual(log, fit, verdict, parts), *grown(log, found))
    return Updated(cell, fit.log, fit, verdict, parts, moments, states, grown_history, preston, told, notices)


def _state_holds(cell: Cell, log: ForceLog, history: History) -> float | None:
    """Running time s that the state in the cell is for: as the last update forecast it, else the end of the calibration's force
    log where this log's clock begins after it; None where nothing tells."""
    if history.holds is not None:
        return history.holds
    told = _force_figures(cell.calibration).get("clock_s")
    return told if told is not None and log.clock is not None and told <= log.clock.min() else None


def _older(cell: Cell, log: ForceLog, history: History) -> tuple[str, ...]:
    """A sentence where a first log's clock begins before the calibration's log ended."""
    told = _force_figures(cell.calibration).get("clock_s")
    if history.holds is not None or told is None or log.clock is None or told <= log.clock.min():
        return ()
    return (
        f"{log.path.name}: clock_s begins at {log.clock.min():.0f} s, before the calibration's force log ended ({told:.0f} s): "
        "an older log does not say how the cell is now; a clock started anew does not say how old the calibration is",
    )


def _made_from(calibration: Calibration | None, file: Path) -> bool:
    """Whether a calibration was made from these very bytes: those of before logs were known by content tell no more."""
    hashes = {} if calibration is None else calibration.provenance.get("data_sha256", {})
    return isinstance(hashes, dict) and sha256(file) in hashes.values()


def _force_told(calibration: Calibration | None) -> dict[str, Any]:
    """What a calibration tells of its force log; nothing where it was edited into something else."""
    told = None if calibration is None else calibration.provenance.get(FORCE)
    return told if isinstance(told, dict) else {}


def _force_figures(calibration: Calibration | None) -> dict[str, float]:
    """The numbers of it."""
    return {k: float(v) for k, v in _force_told(calibration).items() if is_number(v)}


def _fitted(
    cell: Cell, log: ForceLog, setup: ForceSetup, expected: Calibration, earlier: np.ndarray
) -> tuple[ForceFit, Verdict, Verdict]:
    """The fit with the wheel worn inside the log by its rate; what is said of the log by the rate that was forecast, and by the
    one that it gave. `earlier` (n,) s: how long before the state's moment a row was."""
    noise = believed_theta(replace(cell, calibration=expected)).joint_noise
    before = abs(_force_figures(expected).get("run_offset", 0.0))
    rate, verdicts = expected.values[expected.names.index(WEAR)], list[Verdict]()
    for _ in range(2):
        worn = setup.with_larger(rate * earlier * setup.rows[0].contact)  # before that moment there was more wheel
        fit = fit_force(replace(cell, calibration=None), log, expected, worn)
        found, force = fit.solution, fit.solution.reading - fit.solution.x[BIAS]
        usual = max(unmodelled_force(setup.model, fit.setup.rows[0], found.x, force, noise), before)
        verdicts.append(verdict_on(fit.solution, log, usual))
        state = fit.calibration(expected)
        change, rate = state.values[state.names.index(WEAR)] - rate, state.values[state.names.index(WEAR)]
        if not verdicts[-1].possible or abs(change) * np.ptp(earlier) < SAME_WEAR:
            break
    return fit, verdicts[0], verdicts[-1]


def _impossible(log: ForceLog, fit: ForceFit, verdicts: Sequence[Verdict], parts: tuple[str, ...]) -> str:
    """Why a log is not of the state that was handed in, and what to do. As wear, it may look possible until that wear is looked
    for inside the log."""
    f, left, verdict = fit.figures, [part for part in PARTS if part not in parts], verdicts[-1]
    if verdicts[0].possible:
        return (
            f"{log.path}: cannot have come from the cell as last known: only a wheel that wore or grew much faster reads so far "
            f"off, and inside the log there is none of it (chance {verdict.chance:.1g}); the wheel, the blade or the sensor was "
            f"moved: say so (--changed, of {', '.join(left) or 'nothing more'}), else calibrate "
            "anew with a force ladder"
        )
    return (
        f"{log.path}: cannot have come from the cell as last known: it reads {f.mean_before:+.2f} N ({f.rms_before:.2f} N "
        f"rms) off what was forecast (chance {verdict.chance:.1g}), {verdict.sentence()}; if something was changed say so "
        f"(--changed, of {', '.join(left) or 'nothing more'}), else calibrate anew with a force ladder"
    )


def _unusual(log: ForceLog, fit: ForceFit, verdict: Verdict, parts: tuple[str, ...]) -> tuple[str, ...]:
    """A sentence where a log that is used is hardly of the state that was handed in: a wheel that was moved a little looks like
    one that wore or grew; and where it is too rough to tell."""
    if not verdict.directions:
        return (
            f"{log.path.name}: tells nothing that was not known: its readings lie {fit.figures.rms_after:.2f} N rms off the fit, "
            "so the state stays as forecast; compare fn_N with the axes: late, of other rows, or of a sensor that shakes?",
        )
    if verdict.chance >= UNUSUAL:
        return ()
    left = [part for part in PARTS if part not in parts]
    return (
        f"{log.path.name}: is unlike what was forecast ({fit.figures.mean_before:+.2f} N off, chance {verdict.chance:.1g}), and "
        f"{verdict.sentence()}: without --changed this counts as wear and drift; if something was changed update again, from "
        f"the same cell, and say so (--changed, of {', '.join(left) or 'nothing more'})",
    )


def grown(log: ForceLog, found: Calibration) -> tuple[str, ...]:
    """A sentence where the wear rate that was found is surely below none."""
    at = found.names.index(WEAR)
    rate, sd = float(found.values[at]), float(found.standard_deviation[at])
    if rate + GROWN * sd >= 0.0:
        return ()
    return (
        f"{log.path.name}: the wheel would grow by {-3.6e9 * rate:.0f} +- {3.6e9 * sd:.0f} um an hour, which no wheel does: "
        "something else changed with the force or during the log (the sensor's gain, warmth, a wheel or blade that gave way); "
        "look for it before the next blade",
    )


def _known_preston(cell: Cell, spent: float, new_belt: bool) -> Preston | None:
    """The coefficient as it was known before this blade, less sure since; None where it never was."""
    process = cell.process
    if process.preston is None:
        return None
    sd = PRESTON_SD * process.preston if process.preston_sd is None else process.preston_sd
    return less_sure(Preston(process.preston, sd), spent, new_belt)


def _entry(
    fit: ForceFit, clock: np.ndarray, expected: Calibration, found: Calibration, preston: Preston | None
) -> dict[str, float]:
    """This update's row of the history."""
    solution, log = fit.solution, fit.log
    full = log.contact
    at = found.names.index(RADIUS), found.names.index(WEAR)
    sd = found.standard_deviation
    told = (np.nan, np.nan) if preston is None else (preston.value / UNIT, preston.sd / UNIT)
    return {
        "clock_s": float(clock[log.contact].mean()),
        "measured_N": float(log.fn[full].mean() - solution.x[BIAS]),
        "expected_N": float(solution.before[full].mean() - solution.prior.mean[BIAS]),
        "expected_sd_N": force_spread(solution, log, expected),
        "found_N": float(solution.reading[full].mean() - solution.x[BIAS]),
        "found_sd_N": force_spread(solution, log, found),
        "radius_um": 1e6 * float(found.values[at[0]]),
        "radius_sd_um": 1e6 * float(sd[at[0]]),
        "wear_um_per_h": 3.6e9 * float(found.values[at[1]]),
        "wear_sd_um_per_h": 3.6e9 * float(sd[at[1]]),
        "preston": told[0],
        "preston_sd": told[1],
    }
