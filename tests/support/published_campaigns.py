"""`python -m tests.support.published_campaigns`: a published campaign of a real robot as a data set folder.

    python -m tests.support.published_campaigns ur FILE.csv --out DIR          the UR5's or the UR10's
    python -m tests.support.published_campaigns kr300 FF_A.mat --out DIR       recordings of a KUKA KR 300 R2500

* UR5: Jacobi (github.com/pauljac7700/serial_robots_datasets, MIT licence), 1000 postures, GTS3800 tracker, one reflector. Points
  are given in the robot's base frame, so where the tracker stood is unknown: `sigma_um` is the same in all directions. Its
  authors leave open whether `x_dif` is target less achieved or the reverse; only as achieved less target does the arm sag
  under its weight (docs/diagnosis_real.md), which is the default.
* UR10: Landgraf (github.com/christianlandgraf/ipa-robot-accuracy, MIT licence), 11 911 postures, Leica tracker with a T-Mac,
  points in the tracker's frame, air temperature, times. The diagnosis has no use for the T-Mac's turns, they are left out.
* KR 300: Weigand, Goetz, Ulmer and Ruskowski (github.com/JonasWeigand/Robot_Identification, MIT licence, MATLAB v5): secondary,
  link-side encoders on axes 1 to 3, motor encoders through the gear, motor torques, 4 ms.

Both UR campaigns say in which order the postures were driven to. The way there is not recorded: approach signs are those of a
straight motion of each axis from the posture before, 0 where that is missing or an axis moved less than 0.01 deg. What is found
in all of them: docs/diagnosis_real.md.
"""

import csv
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TextIO

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.io import loadmat

from ocp.shell.command import main, run
from ocp.shell.output import whole_folder
from robots.errors import BadInput
from robots.pose import Array
from robots.toml_files import toml_text
from robots.tracker_readings import APPROACH, AXES, POINT, Index

UR5_COLUMNS = ["x_t", "y_t", "z_t", "x_dif", "y_dif", "z_dif", *(f"joint_{i}" for i in range(1, 7)), "step_order"]
UR10_JOINTS = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
UR10_COLUMNS = [*(f"{n}_joint" for n in UR10_JOINTS), *(f"measurement_{a}" for a in ("x", "y", "z", "temperature")), "Timestamp"]
UR5_SIGMA = 30.0  # um: GTS3800, 15 um + 6 um/m (ur5_tracker/SOURCE.txt), about 2.5 m away
UR5_REFLECTOR = [0.0, 0.0, 31.0]  # mm in the flange frame (the same)
UR10_REFLECTOR = [0.0, 0.0, 109.0]  # mm, T-Mac on the flange (Trafo_TM_F_init.txt)
ACHIEVED, TARGET = "achieved-target", "target-achieved"  # what x_dif of the UR5 may be
MOVED = 0.01  # deg: less is no motion of an axis
MEASURED = {*POINT, "sigma_um"}
LINK_SIDE = 3  # axes 1..3 of the KR 300 have a secondary encoder
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@dataclass(frozen=True)
class PublishedCampaign:
    """Columns of a tracker.csv by name, in the units of their names, and the tables of its cell.toml."""

    columns: dict[str, Array]
    cell: dict[str, Any]

    def __len__(self) -> int:
        return len(self.columns[AXES[0]])


def read_campaign(path: Path, difference: str = ACHIEVED) -> PublishedCampaign:
    """The campaign of a file, told apart by its columns. `difference`: what `x_dif` of the UR5 is.

    Raises BadInput: no such file, or none of the two campaigns.
    """
    if difference not in (ACHIEVED, TARGET):
        raise BadInput(f"--difference {difference}: is not known; give {ACHIEVED} or {TARGET}")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}); give a campaign's .csv") from None
    head = lines[0] if lines else ""
    if set(UR10_COLUMNS) <= set(head.split(";")):
        return _ur10(_table(path, lines, ";"))
    if set(UR5_COLUMNS) <= set(head.split(",")):
        return _ur5(_table(path, lines, ","), 1.0 if difference == ACHIEVED else -1.0)
    raise BadInput(f"{path}, line 1: is neither the UR5's nor the UR10's campaign; give one of their .csv files")


def _table(path: Path, lines: list[str], separator: str) -> dict[str, Array]:
    """Numbers (n,) by column; decimal commas where the separator is none."""
    rows = list(csv.reader(lines, delimiter=separator))
    try:
        numbers = np.array([[float(cell.replace(",", ".")) for cell in row] for row in rows[1:] if row])
        return dict(zip(rows[0], numbers.T, strict=True))
    except ValueError as error:
        raise BadInput(f"{path}: holds a row that is not all numbers ({error}); give the file as it was published") from None


def _ur5(table: dict[str, Array], sign: float) -> PublishedCampaign:
    """Points in the base frame, mm; postures in the order of `step_order`, in which some are missing."""
    q = np.stack([table[f"joint_{i}"] for i in range(1, 7)], axis=1)
    point = np.stack([table[f"{a}_t"] + sign * table[f"{a}_dif"] for a in "xyz"], axis=1)
    follows = np.diff(table["step_order"], prepend=np.nan) == 1
    columns = _columns(q, point, follows) | {"sigma_um": np.full(len(q), UR5_SIGMA)}
    return PublishedCampaign(columns, cell_tables("UR5 of Jacobi 2025", "ur5", UR5_REFLECTOR))


def _ur10(table: dict[str, Array]) -> PublishedCampaign:
    """Points in the tracker's frame, mm; times to the second, temperature of the air."""
    q = np.degrees(np.stack([table[f"{name}_joint"] for name in UR10_JOINTS], axis=1))
    point = np.stack([table[f"measurement_{a}"] for a in "xyz"], axis=1)
    stamps = [datetime.strptime(f"{stamp:.0f}", "%Y%m%d%H%M%S") for stamp in table["Timestamp"]]
    time = np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps])
    follows = np.concatenate([[False], np.diff(time) >= 0])
    columns = _columns(q, point, follows) | {"time_s": time, "temperature_C": table["measurement_temperature"]}
    cell = cell_tables("UR10 of Landgraf 2021", "ur10", UR10_REFLECTOR)
    return PublishedCampaign(columns, cell | {"reference_temperature_C": round(float(np.median(columns["temperature_C"])), 1)})


def _columns(q: Array, point: Array, follows: NDArray[np.bool_]) -> dict[str, Array]:
    """Axes deg (n, 6), points mm (n, 3) and signs of the last motion, 0 where a row does not follow (n,) the one before."""
    step = np.diff(q, axis=0, prepend=q[:1])
    sign = np.where((np.abs(step) > MOVED) & follows[:, None], np.sign(step), 0.0)
    columns = dict(zip(AXES, q.T, strict=True)) | dict(zip(POINT, point.T, strict=True))
    return columns | dict(zip(APPROACH, sign.T, strict=True))


def cell_tables(name: str, model: str, reflector: list[float]) -> dict[str, Any]:
    """The believed cell: the maker's geometry, joints rigid as its controller takes them, nothing hung on but the reflector.
    A spring is then an effect (joint_compliance); with `compliant_joints` it is part of the believed cell."""
    return {
        "name": name,
        "robot": {"model": model, "compliant_joints": []},
        "payloads": {"bare": {"mass_kg": 0.0, "com_mm": [0.0, 0.0, 0.0]}},
        "tracker": {"range_noise_um": 15.0, "transverse_noise_um_per_m": 6.0, "targets": {"reflector": reflector}},
    }


def held_rows(n: int, share: float, seed: int) -> Index:
    """Sorted rows (m,) of a random part: the splits of benchmarks/calibration_real.py where share is a fifth."""
    return np.sort(np.random.default_rng(seed).permutation(n)[: int(n * share)])


def write_data_set(campaign: PublishedCampaign, folder: Path, held: Index | None = None) -> None:
    """Write cell.toml and tracker.csv; `held` rows (m,) go to sealed_tracker.csv without what was measured, and with it to
    withheld_tracker.csv, which no command of the product opens."""
    (folder / "cell.toml").write_text(toml_text(campaign.cell), encoding="utf-8")
    sealed = np.zeros(len(campaign), bool)
    sealed[held if held is not None else []] = True
    _write_readings(folder / "tracker.csv", campaign.columns, ~sealed)
    if sealed.any():
        hidden = {name: values for name, values in campaign.columns.items() if name not in MEASURED}
        _write_readings(folder / "sealed_tracker.csv", hidden, sealed)
        _write_readings(folder / "withheld_tracker.csv", campaign.columns, sealed)


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
        for path in recordings:
            columns = read_recording(path)
            digits = [3 if name == "time_s" else 6 for name in columns]
            if rows == 0:
                file.write(",".join(["run", *columns]) + "\n")
            rows += _write_rows(file, columns.values(), digits, [path.stem])
    (folder / "cell.toml").write_text(toml_text(recording_cell()), encoding="utf-8")
    return rows


def _write_readings(path: Path, columns: dict[str, Array], rows: NDArray[np.bool_]) -> None:
    """Rows of a tracker.csv."""
    digits = [6 if n in AXES else 5 if n in POINT else 0 if n in APPROACH or n in ("time_s", "sigma_um") else 2 for n in columns]
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        _write_rows(file, [v[rows] for v in columns.values()], digits)


def _write_rows(file: TextIO, columns: Iterable[Array], digits: Sequence[int], first: Sequence[str] = ()) -> int:
    """Columns row by row with so many digits each behind the cells `first`; the number of rows."""
    rows = [[*first, *(f"{v:.{d}f}" for v, d in zip(row, digits, strict=True))] for row in zip(*columns, strict=True)]
    csv.writer(file, lineterminator="\n").writerows(rows)
    return len(rows)


@app.command("ur")
def load_campaign(
    recording: Annotated[Path, typer.Argument(help="the campaign's .csv as published, of the UR5 or the UR10")],
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("run"),
    sealed: Annotated[float, typer.Option(min=0.0, max=0.9, help="share of the readings to hold out, at random")] = 0.0,
    seed: Annotated[int, typer.Option(help="of the random split")] = 0,
    difference: Annotated[str, typer.Option(help=f"what x_dif of the UR5 is: {ACHIEVED} or {TARGET}")] = ACHIEVED,
    springs: Annotated[bool, typer.Option(help="believe that joints 2 and 3 bend, instead of finding it out")] = False,
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> None:
    """Write a published tracker campaign as a data set that `python -m ocp.diagnose` reads."""

    def job() -> str:
        campaign = read_campaign(recording, difference)
        if springs:
            campaign.cell["robot"]["compliant_joints"] = [2, 3]
        held = held_rows(len(campaign), sealed, seed) if sealed else None
        with whole_folder(out, overwrite, [recording]) as folder:
            write_data_set(campaign, folder, held)
        kept = "" if held is None else f", {len(held)} of them sealed"
        return f"{out}: {len(campaign)} readings{kept}, with cell.toml; `python -m ocp.diagnose {out}` looks at them."

    sys.exit(run(job, "not loaded"))


@app.command("kr300")
def load_recordings(
    recordings: Annotated[list[Path], typer.Argument(help="recordings of the campaign, .mat, one run each")],
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("run"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> None:
    """Write recordings of the KR 300 campaign as a data set that `python -m ocp.diagnose` reads."""

    def job() -> str:
        with whole_folder(out, overwrite, recordings) as folder:
            rows = write_recordings(recordings, folder)
        return f"{out}: {rows} rows of joints.csv with cell.toml; `python -m ocp.diagnose {out}` looks at them."

    sys.exit(run(job, "not loaded"))


if __name__ == "__main__":
    main(app)
