"""`python -m ocp.diagnose.published.kr300 FF_A.mat --out DIR`: a recording of a KUKA KR 300 R2500 as a data set folder.

The recordings are those of Weigand, Goetz, Ulmer and Ruskowski (github.com/JonasWeigand/Robot_Identification, MIT licence,
MATLAB v5): secondary, link-side encoders on axes 1 to 3, motor encoders through the gear, motor torques, 4 ms.
"""

import csv
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy.io import loadmat

from ocp.shell.command import main, run
from ocp.shell.output import check_output, whole_folder
from robots.errors import BadInput
from robots.pose import Array
from robots.toml_files import toml_text

LINK_SIDE = 3  # axes 1..3 have a secondary encoder
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def read_recording(path: Path) -> dict[str, Array]:
    """Columns of a joints.csv by name from a recording: degrees, N m at the link side.

    Raises BadInput: not such a file.
    """
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
        rec, para = content["rec"], content["para"]
        motor, link = np.atleast_2d(rec.act_pos_mot_deg), np.atleast_2d(rec.act_pos_se_deg)
        torque = np.atleast_2d(rec.act_torque_abs_nm) * np.abs(np.asarray(para.u, float))[:, None]
        speed, time = np.atleast_2d(rec.act_vel_mot_deg_per_s), np.asarray(rec.time_cont, float)
    except FileNotFoundError:
        raise BadInput(f"{path}: cannot be read (no such file); give the path of a .mat recording") from None
    except Exception as error:  # scipy raises many kinds for a file that is not MATLAB's or lacks a variable
        raise BadInput(f"{path}: is no recording of the KR 300 campaign ({error}); give one of its .mat files") from None
    columns: dict[str, Array] = {"time_s": time}
    columns |= {f"q{j + 1}_deg": motor[j] for j in range(6)}
    columns |= {f"link{j + 1}_deg": link[j] for j in range(LINK_SIDE)}
    columns |= {f"tau{j + 1}_Nm": torque[j] for j in range(6)}
    columns |= {f"qd{j + 1}_deg_s": speed[j] for j in range(6)}
    return columns


def recording_cell() -> dict[str, Any]:
    """A cell for the recording: no catalogue robot is a KR 300 R2500; the nearest relative serves, its weight is not used
    because all torques were recorded."""
    return {"name": "KR 300 R2500 with link-side encoders", "robot": {"model": "kr210_r2700_extra"}}


def write_recordings(recordings: list[Path], folder: Path) -> int:
    """Write cell.toml and joints.csv, one run a recording; the number of rows."""
    rows = 0
    with (folder / "joints.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for path in recordings:
            columns = read_recording(path)
            if rows == 0:
                writer.writerow(["run", *columns])
            digits = [3 if name == "time_s" else 6 for name in columns]
            for values in zip(*columns.values(), strict=True):
                writer.writerow([path.stem, *(f"{v:.{d}f}" for v, d in zip(values, digits, strict=True))])
                rows += 1
    (folder / "cell.toml").write_text(toml_text(recording_cell()), encoding="utf-8")
    return rows


@app.command()
def load_recordings(
    recordings: Annotated[list[Path], typer.Argument(help="recordings of the campaign, .mat, one run each")],
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("run"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> None:
    """Write recordings of the KR 300 campaign as a data set that `python -m ocp.diagnose` reads."""

    def job() -> str:
        check_output(out, overwrite, recordings)
        with whole_folder(out, overwrite) as folder:
            rows = write_recordings(recordings, folder)
        return f"{out}: {rows} rows of joints.csv with cell.toml; `python -m ocp.diagnose {out}` looks at them."

    sys.exit(run(job, "not loaded"))


if __name__ == "__main__":
    main(app)
