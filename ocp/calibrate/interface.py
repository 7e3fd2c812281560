"""`ocp.api.calibrate`: tracker readings, with a force log or without; a calibrated cell with its covariance out.

The folder: calibration.toml with its covariance, residuals, blind predictions, report; whole or not at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ocp.calibrate.force.log import ForceLog, read_force_log, refuse_force_unit, refuse_saturated, without_ramps
from ocp.calibrate.force.registration import fit_force, refuse_other_force
from ocp.calibrate.report.pages import contact_sections, write_calibration_report
from ocp.calibrate.tracker import CLEARLY, TrackerCalibration, as_calibration, calibrate_tracker, doubts_about
from ocp.model.calibrated_for import made_for
from ocp.model.cell import Cell, cell_tables_for, files_of, read_cell, with_calibration
from ocp.model.columns import TABLES
from ocp.report.section import Section
from ocp.shell.cache import sha256
from ocp.shell.output import Output, reserved
from ocp.shell.progress import Phases, Progress
from robots.calibration.carried import CHANGED, FORCE, carried_over, chance_of_one_arm
from robots.calibration.parameters import SYMBOLS
from robots.calibration.store import BENDING, Calibration, write_calibration
from robots.calibration.student_t import GROSS
from robots.calibration.validation import by_kind
from robots.column_mapping import ColumnMapping, read_column_mapping
from robots.csv_table import OURS
from robots.errors import BadInput, Infeasible
from robots.inverse import planned_family
from robots.pose import Array, abc_from_rotation
from robots.toml_files import toml_text


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration that was written: its folder, the fit with its judgement, the named parameters with their covariance (with a
    force log: of wheel, blade and flange too), and the one line that says how good it is."""

    folder: Path
    tracker: TrackerCalibration
    calibration: Calibration
    line: str

    @property
    def notices(self) -> tuple[str, ...]:
        """What the user should know of readings and fit."""
        return (*self.tracker.notices, *self.calibration.notices)


def calibrate(
    tracker: str | Path,
    *,
    cell: str | Path,
    out: str | Path,
    force: str | Path | None = None,
    method: str = "full",
    columns: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate the robot of `cell` from the readings `tracker` (tracker.csv) and, with the log `force` of a force ladder
    (force.csv), the contact of wheel and blade; write calibration, cell and report into the folder `out`.

    method: full, geometry, relative or relative-literal; columns: a mapping file, for tables made by others (docs/formats.md).
    Raises BadInput: an argument or a file is not what it should be;
    Infeasible: the readings cannot be judged. Nothing is written then.
    """
    readings, cell_file, folder, phases = Path(tracker), Path(cell), Path(out), Phases(progress)
    inputs = [readings, *(Path(file) for file in (force, columns) if file is not None), *files_of(cell_file)]
    sealed = [file for given in inputs[:2] for file in given.parent.glob("sealed_*.csv")]
    with reserved(folder, overwrite, [*inputs, *sealed]) as output:
        for file in inputs:
            if file.is_dir():
                raise BadInput(f"{file}: is a folder; give the file in it, as {file / 'tracker.csv'}")
            if not file.is_file():
                raise BadInput(f"{file}: cannot be read (no such file); give the path of an existing file")
        mapping = OURS if columns is None else read_column_mapping(columns)
        ground = None
        if force is not None:
            believed, log = logged_cell(cell_file, Path(force), mapping)
            ground = replace(believed, calibration=None), log
        made = calibrate_tracker(readings, cell_file, method, phases, mapping)
        return _calibrated(made, ground, inputs, output, phases)


def _calibrated(
    made: TrackerCalibration, ground: tuple[Cell, ForceLog] | None, inputs: list[Path], output: Output, phases: Phases
) -> CalibrationResult:
    if not len(made.methods.before):
        path = made.fit.campaign.readings.path
        raise Infeasible(f"{path}: too few readings, outliers apart, to leave any out and judge the rest; measure more poses")
    methods, path = made.methods, made.fit.campaign.readings.path
    gain, half = methods.gained(made.method)
    if gain < -half:
        raise Infeasible(
            f"{path}: by method {made.method} left-out readings are met within {1e3 * methods.error[made.method].mean():.3f} mm "
            f"on average, {-1e3 * gain:.3f} +- {1e3 * half:.3f} mm worse than by the arm as believed "
            f"({1e3 * methods.before.mean():.3f} mm), so nothing is to be gained by it; {_remedy(made)}"
        )
    after = float(methods.error[made.method].mean())
    if methods.earlier is not None and methods.earlier < CLEARLY * after:
        raise Infeasible(
            f"{path}: left-out readings are met within {1e3 * after:.3f} mm on average, by the calibration that the cell has "
            f"already within {1e3 * methods.earlier:.3f} mm, so nothing is to be gained by it; measure more postures, or take "
            "robot.calibration out of the cell to begin anew"
        )
    calibration, extra = tracker_calibration(made, inputs), list[Section]()
    if ground is None and (kept := carried_over(calibration, made.setup.calibration)) is not calibration:
        besides = ", ".join(name for name in kept.names if name not in calibration.names)
        assert made.setup.calibration is not None
        told = (
            f"the arm is not the one that these were registered with (chance below {CHANGED:g}), so they stay where they were, "
            "less sure; log a force ladder (--force)"
            if chance_of_one_arm(calibration, made.setup.calibration) < CHANGED
            else "these are the earlier calibration's, and moved with the arm by what it was found otherwise"
        )
        calibration, made = kept, replace(made, notices=(*made.notices, f"no force log was given: {told}: {besides}"))
    if ground is not None:
        with phases.phase("contact"):
            # Registered by the arm as it will be planned with, which bends where the readings say.
            bending = replace(with_calibration(ground[0], calibration), calibration=None)
            fit = fit_force(bending, without_ramps(ground[1], bending.flange is not None), calibration)
            refuse_other_force(bending, fit)
        calibration, extra = fit.calibration(calibration), contact_sections(fit)
    return write_tracker_calibration(made, calibration, extra, output, phases, inputs)


def _remedy(made: TrackerCalibration) -> str:
    """What to do about a calibration that makes things worse."""
    full = made.methods.gained("full")[0]
    if made.method != "full" and full > 0:
        return f"method full gains {1e3 * full:.3f} mm: use that one"
    return "measure more postures, and check that units, orientations and names are as docs/formats.md has them"


def logged_cell(cell_file: Path, force: Path, mapping: ColumnMapping = OURS, blade: Path | None = None) -> tuple[Cell, ForceLog]:
    """The cell, and the log of what was ground in it; `blade`: the file of that blade, where it is not the cell's own.

    Raises BadInput: the cell has no blade or wheel, the log is malformed, is not of this cell, or its sensor saturates.
    """
    log = read_force_log(force, mapping=mapping)
    cell = read_cell(cell_file, blade)
    if cell.workpiece.stl is None:
        raise BadInput(f"{cell_file}: workpiece.stl is missing; a force log needs the blade that was ground")
    refuse_force_unit(log, cell)
    refuse_saturated(log)
    return cell, log


def write_tracker_calibration(
    made: TrackerCalibration,
    calibration: Calibration,
    extra: Sequence[Section],
    output: Output,
    phases: Phases,
    inputs: Sequence[Path],
) -> CalibrationResult:
    """Write the folder of a calibration; `extra` sections of the report are what a force log adds."""
    out = output.named
    with output.whole() as folder:
        with phases.phase("writing"):
            write_calibration(folder / "calibration.toml", made_for(calibration, made.setup.tables, made.setup.robot))
            _write_cell(made, folder / "cell.toml", out)
            _write_residuals(made, folder / "residuals.csv")
            if made.sealed is not None:
                _write_predictions(made, folder / "predictions_tracker.csv")
        with phases.phase("report"):
            write_calibration_report(made, folder, {path.name: sha256(path) for path in inputs}, extra)
    return CalibrationResult(out, made, calibration, last_line(made, out, _contact(calibration) if extra else ""))


def last_line(made: TrackerCalibration, out: Path, contact: str) -> str:
    """What was written, how good it is, whether it is safe to use; contact: what a force log brought."""
    n, found = len(made.fit.campaign.readings), made.identifiability
    errors, before = made.methods.error[made.method], made.methods.before
    return (
        f"{out}: {n} readings by method {made.method}, {found.rank} of the robot's {found.parameters} parameters seen; left-out "
        f"readings are met within {1e3 * errors.mean():.3f} mm on average, {1e3 * errors.max():.3f} mm at most (before: "
        f"{1e3 * before.mean():.3f} and {1e3 * before.max():.3f}). {contact}{_use(made, out)}; "
        f"{out / 'report.html'} says what was not seen."
    )


def _contact(calibration: Calibration) -> str:
    """What the force log brought."""
    figures = calibration.provenance[FORCE]
    return f"The force log is met within {figures['rms_after']:.2f} N rms (before: {figures['rms_before']:.2f}). "


def _use(made: TrackerCalibration, out: Path) -> str:
    """Whether to use it. One that makes things worse is not written at all."""
    errors = made.methods.error[made.method]
    full = made.methods.error.get("full", errors)
    gain, half = made.methods.gained(made.method)
    doubts = doubts_about(made)
    if gain <= half:
        nothing = f"Nothing gained: it meets left-out readings as the arm as believed does, within {1e3 * half:.3f} mm."
        return " ".join([nothing, *doubts]).removesuffix(".")
    if errors.mean() > 1.5 * full.mean():
        return f"Method full meets the same readings within {1e3 * full.mean():.3f} mm: use that one"
    planned = made.setup.tables.workpiece is not None and planned_family(made.setup.robot) is not None
    told = f"{out / 'cell.toml'} is the cell with it, for {'ocp.plan' if planned else 'diagnosing the arm'}"
    return f"With doubts: {' '.join(doubts)} {told}" if doubts else told


def tracker_calibration(made: TrackerCalibration, inputs: Sequence[Path]) -> Calibration:
    """The fit as named parameters with their covariance: geometry, springs, the mounted payload, the base in the tracker."""
    fit, readings = made.fit, made.fit.campaign.readings
    mounted = made.setup.tables.workpiece.payload if made.setup.tables.workpiece else None
    corrected = mounted is not None and mounted in fit.choice.payloads and mounted in readings.payloads
    return as_calibration(
        made.setup.robot.name,
        fit.layout,
        fit.state,
        fit.covariance,
        int(np.unique(readings.station)[0]),
        rigid=made.setup.compliant_joints if made.method == "geometry" else (),  # fitted without springs it holds without only
        payload=readings.payloads.index(mounted) if mounted is not None and corrected else None,
        provenance=_provenance(made, inputs),
        not_identified={k: v for k, v in made.identifiability.not_identified().items() if k in SYMBOLS},
    )


def _provenance(made: TrackerCalibration, inputs: Sequence[Path]) -> dict[str, Any]:
    fit, readings = made.fit, made.fit.campaign.readings
    figures = {
        kind.replace(" ", "_"): {f"{name}_mm": round(1e3 * row[name], 6) for name in ("mean", "rms", "max")}
        | {"error_over_predicted": round(row["over_predicted"], 4), "readings": int(row["readings"])}
        for kind, row in by_kind(made.held_out).items()
    }
    conditions: dict[str, Any] = {
        "readings": len(readings),
        "payloads": [readings.payloads[k] for k in np.unique(readings.payload)],
        "targets": [readings.targets[k] for k in np.unique(readings.target)],
        "stations": {readings.stations[k] or "tracker": _station(made, int(k)) for k in np.unique(readings.station)},
        "reference_temperature_C": made.setup.tables.reference_temperature_C,
    }
    if readings.temperature is not None:
        conditions["temperature_C"] = [float(readings.temperature.min()), float(readings.temperature.max())]
    return {
        "method": made.method,
        "data_sha256": {path.name: sha256(path) for path in inputs},
        "conditions": conditions,
        "held_out": figures,
        "noise": {
            "joints_rad": float(fit.noise.joints),
            "spread": float(fit.spread),
            "outliers": int((fit.weight < GROSS).sum()),
        },
        "priors": {"length_m": float(fit.priors.length), "angle_rad": float(fit.priors.angle)},
        BENDING: list(fit.choice.joints),
        "corrected_payloads": list(fit.choice.payloads),
    }


def _station(made: TrackerCalibration, k: int) -> dict[str, Any]:
    """Where the base is in a station's frame, with one sigma of place and turn, and how many readings say so."""
    T, sd = made.fit.state.stations[k], made.fit.sd[made.fit.layout.station[k]]
    return {
        "readings": int((made.fit.campaign.readings.station == k).sum()),
        "base_xyz_mm": (1e3 * T[:3, 3]).round(6).tolist(),
        "base_abc_deg": np.degrees(abc_from_rotation(T[:3, :3])).round(8).tolist(),
        "xyz_sd_mm": (1e3 * sd[:3]).round(6).tolist(),
        "turn_sd_deg": np.degrees(sd[3:]).round(8).tolist(),
    }


def _write_cell(made: TrackerCalibration, path: Path, out: Path) -> None:
    """The cell that names this calibration, ready for `ocp.plan`; `out` is where its folder will stand."""
    source = made.setup.path
    tables = cell_tables_for(source, out)
    tables["robot"]["calibration"] = "calibration.toml"
    path.write_text(f"# {source.name} with its calibration\n" + toml_text(tables), encoding="utf-8")


def _write_residuals(made: TrackerCalibration, path: Path) -> None:
    """One row a reading: its line, what is left of it before and after, its weight."""
    fit = made.fit
    errors = 1e3 * fit.residual[:, :3], 1e3 * made.error_before, 1e3 * made.error_after, fit.weight
    names = ",".join(name for group in TABLES["residuals.csv"] for name in group.names)
    _write_csv(path, names, np.column_stack([fit.campaign.readings.line, *errors]), "%d")


def _write_predictions(made: TrackerCalibration, path: Path) -> None:
    """Blind predictions of sealed_tracker.csv, its rows in order: the calibrated model and its one sigma."""
    assert made.sealed_points is not None and made.sealed_covariance is not None
    sd = np.sqrt(np.diagonal(made.sealed_covariance, axis1=1, axis2=2))
    header = ",".join(f"baseline_{what}{c}_mm" for what in ("", "sigma_") for c in "xyz")
    _write_csv(path, header, 1e3 * np.hstack([made.sealed_points, sd]))


def _write_csv(path: Path, header: str, rows: Array, first: str = "%.5f") -> None:
    """Five decimals in every column but the first, if that has a format of its own."""
    np.savetxt(path, rows, [first, *["%.5f"] * (rows.shape[1] - 1)], ",", header=header, comments="", encoding="utf-8")
