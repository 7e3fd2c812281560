"""`ocp.api.diagnose`: a data set in; where the gap lies, which effect causes it, and the corrected cell out."""

from pathlib import Path

from ocp.diagnose.answering import DiagnosisResult, write_diagnosis
from ocp.shell.progress import Phases, Progress


def diagnose(
    folder: str | Path,
    *,
    out: str | Path,
    columns: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Diagnose the data set `folder` (cell.toml with any of tracker.csv, force.csv, joints.csv) and write diagnosis.json, the
    corrected cell, predictions of sealed conditions and the report into the folder `out`. columns: a mapping file, for tables
    made by others (docs/formats.md).

    Raises BadInput: a file is not what it should be; Infeasible: the believed cell cannot be fitted. Nothing is written then.
    """
    return write_diagnosis(Path(folder), Path(out), overwrite, Phases(progress), None if columns is None else Path(columns))


def judge_measurement(cell: str | Path, *, poses: str | Path | None = None, log: str | Path | None = None) -> str:
    """What a measurement that nobody has made yet would show of every effect of the catalogue: the smallest size that is named
    nine times of ten, as a table in words.

    poses: planned readings, as tracker.csv without x, y, z (poses.csv of `choose_poses`); log: a planned force log, as force.csv
    without fn_N, or plan.csv of `plan`; neither: fifty poses. Raises BadInput: a file is not what it should be.
    """
    from ocp.diagnose.foresee.design import design_text  # the contact's imports only with a log, none of the search's

    return design_text(Path(cell), None if poses is None else Path(poses), None if log is None else Path(log))
