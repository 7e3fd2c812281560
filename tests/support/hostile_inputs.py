"""Hostile files for every reader: a valid sample each, mutators of bytes, and what came of one input.

An input is told by reader, seed and number alone, so that each can be made again: `mutant(reader, seed, number)`.
"""

import random
import re
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as hypothesis_seed
from hypothesis import strategies as st

from ocp.calibrate.force.log import LEAST_ROWS, read_force_log
from ocp.data import BLADE, CELL
from ocp.diagnose.dataset import read_data_set, read_sealed
from ocp.diagnose.foresee.design import read_planned_log
from ocp.diagnose.joints.log import read_joint_log
from ocp.model.cell import cell_tables_for, files_of, read_cell, read_tracker_setup, wheel_frame
from ocp.plan.removal.wanted import read_stock
from ocp.simulate.twin.krl_text import read_program
from ocp.simulate.twin.plan_knowledge import cell_of_plan, read_plan_table, read_summary, recorded_input
from ocp.simulate.twin.tracker import design_from_poses
from ocp.update.history import ENTRIES, History, history_of
from ocp.update.removal import read_removal
from robots.calibration.store import Calibration, read_calibration, write_calibration
from robots.column_mapping import read_column_mapping
from robots.errors import BadInput, Infeasible
from robots.kinematics import forward
from robots.robot import CATALOGUE, load_robot, read_robot_tables
from robots.tracker_readings import read_readings
from robots.urdf import read_urdf
from tests.support import blade_samples
from tests.support.house import ROOT
from trajectories.blade import Blade, find_shape, read_blade
from trajectories.blade.stl import read_facets
from trajectories.krl.checks import check_program
from trajectories.krl.dialect import KRL
from trajectories.krl.reader import read_module
from trajectories.passes import PassOptions, passes
from trajectories.path_points import read_path_file
from trajectories.program.old_program import contact_frames_from_program

GOLDEN = Path(__file__).parents[1] / "golden"
ROBOT = load_robot("kr210_r2700_extra")
SECONDS, BYTES = 10.0, 1_000_000_000  # what one input may take
AXES = [f"q{i}_deg" for i in range(1, 7)]
CONTACT = {"px_mm": 1.0, "py_mm": 2.0, "pz_mm": 3.0, "nx": 0.0, "ny": 1.0, "nz": 0.0, "tx": 0.0, "ty": 0.0, "tz": 1.0}
# Readers of the tree that take a path and stand in no row below, with the reason.
ELSEWHERE = {
    "read_back": "reads what its own command has just written",
    "read_toml": "is how read_cell and read_robot_tables read",
    "read_whole": "is how every reader below opens a file",
    "read_csv_table": "is how every reader of a table reads",
}


@dataclass(frozen=True)
class HostileReader:
    """A kind of file: its valid folder (name: bytes), the file that is mutated, and everything that reads it, given the folder.

    names: the readers of the tree that are called."""

    kind: str
    file: str
    folder: Callable[[], dict[str, bytes]]
    read: Callable[[Path], Any]
    names: tuple[str, ...]


def _table(columns: dict[str, list[Any]]) -> bytes:
    rows = zip(*columns.values(), strict=True)
    return ("\n".join([",".join(columns), *(",".join(str(v) for v in row) for row in rows)]) + "\n").encode()


def _spread(n: int, **constant: Any) -> dict[str, list[Any]]:
    return {name: [value] * n for name, value in constant.items()}


@cache
def _axes(n: int) -> dict[str, list[Any]]:
    rng = np.random.default_rng(1)
    return {name: rng.uniform(-80, 80, n).round(4).tolist() for name in AXES}


@cache
def cell_text() -> bytes:
    more = """
[[effects]]
effect = "backlash"
joint = 5
half_width_rad = 2.1e-4
sd = { half_width_rad = 4e-6 }
[[effects]]
effect = "clamp_slip"
m = 1e-4
at_s = 300.0
normal = [0.0, 1.0, 0.0]
[conditions]
temperature_C = 24.0
clock_s = 100.0
ground_before = 2
"""
    text = CELL.read_text().replace('stl = "blade.stl"', 'stl = "blade.stl"\naerofoil_axis = [0, 0, 1]')
    return (text + more).encode()


def tracker_table(sealed: bool, n: int = 24) -> bytes:
    rng = np.random.default_rng(2)
    columns = {"payload": ["grinder", "bare"] * (n // 2), "target": ["T1", "T2", "T3"] * (n // 3)} | _axes(n)
    if not sealed:
        columns |= {c: rng.uniform(500, 3000, n).round(4).tolist() for c in ("x_mm", "y_mm", "z_mm")}
        columns |= _spread(n, rx_deg=10.0, ry_deg=-3.5, rz_deg=1e1, sigma_rot_deg=0.001)
    columns |= {f"approach{i}": [1, -1] * (n // 2) for i in range(1, 7)}
    columns |= {"time_s": list(range(n))} | _spread(n, temperature_C=22.5, session="a", station="A", sigma_um=12.0)
    columns |= _spread(n, fx_N=0.0, fy_N=0, fz_N=-100, mx_Nm=0, my_Nm=0, mz_Nm=0, load_link=6, lx_mm=0, ly_mm=0, lz_mm=10)
    return _table(columns)


def force_table(sealed: bool, n: int = 12) -> bytes:
    columns = {"run": ["a", "b"] * 0 + ["a"] * (n // 2) + ["b"] * (n // 2), "time_s": [0.01 * k for k in range(n)]} | _axes(n)
    columns |= _spread(n, **CONTACT)
    columns |= {} if sealed else _spread(n, fn_N=20.5, ft_N=-7.0, sigma_fn_N=0.2, sigma_ft_N=0.3)
    columns |= _spread(n, setpoint_N=20.0, feed_mm_s=40.0, belt_m_s=-20.0, line=2, ground_before=1, contact=1, session="monday")
    return _table(columns | _spread(n, s_mm=1.0, temperature_C=22.0, wheel_temperature_C=25.0, clock_s=5.0))


def removal_table(n: int = 12) -> bytes:
    places = {name: [round(3.0 + 0.7 * k, 3) for k in range(n)] for name in ("px_mm", "py_mm", "pz_mm")}
    return _table(places | {"removal_um": [round(20 + 0.1 * k, 2) for k in range(n)]} | _spread(n, sd_um=1.5))


def stock_table(n: int = 12) -> bytes:
    places = {name: [round(3.0 + 0.7 * k, 3) for k in range(n)] for name in ("px_mm", "py_mm", "pz_mm")}
    return _table(places | {"depth_um": [round(20 + 0.1 * k, 2) for k in range(n)]})


def stock_ply(binary: bool, n: int = 12) -> bytes:
    """Vertices with a depth, and faces of which nothing is read."""
    kind = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {kind} 1.0\nelement vertex {n}\n" + "".join(f"property float {c}\n" for c in ("x", "y", "z", "depth_um"))
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.array([[3 + k, 2.0, 0.5 * k, 20 + k] for k in range(n)], "<f4")
    if binary:
        return head.encode() + rows.tobytes() + b"\x03" + np.array([0, 1, 2], "<i4").tobytes()
    return (head + "".join(" ".join(f"{v:g}" for v in row) + "\n" for row in rows) + "3 0 1 2\n").encode()


def other_blade(name: str) -> bytes:
    """The blade of the STL readers in another kind of file."""
    import trimesh

    mesh = trimesh.load(BytesIO(stl_bytes(True)), file_type="stl")
    data = mesh.export(file_type=name.rpartition(".")[2])
    return data.encode() if isinstance(data, str) else bytes(data)


def joint_table(n: int = 36) -> bytes:
    columns = {"run": ["a"] * n, "time_s": [round(0.01 * k, 3) for k in range(n)]}
    columns |= {name: [round(10 * j + 0.2 * k, 4) for k in range(n)] for j, name in enumerate(AXES)}
    columns |= {f"link{j + 1}_deg": [round(10 * j + 0.2 * k + 0.001 * j, 4) for k in range(n)] for j in range(6)}
    columns |= {f"tau{j}_Nm": [100.0] * n for j in range(1, 7)} | {f"qd{j}_deg_s": [20.0] * n for j in range(1, 7)}
    return _table(columns)


def plan_table() -> bytes:
    rows: dict[str, list[Any]] = {
        name: [] for name in ("time_s", "line", "contact", *AXES, *CONTACT, "s_mm", "feed_mm_s", "fn_N")
    }
    for line, contact in ((4, 0), (4, 1), (7, 0), (7, 1)):
        for k in range(15):
            at = CONTACT | {"pz_mm": 3.0 + k, "s_mm": k, "feed_mm_s": 40.0, "fn_N": 20.0}
            row = {
                "time_s": round(0.02 * len(rows["line"]), 3),
                "line": line,
                "contact": contact,
                **dict.fromkeys(AXES, 10.0 + k),
            }
            for name, column in rows.items():
                column.append(row[name] if name in row else at[name] if contact else "")
    return _table(rows | {"interference_mm": [value and 0.5 for value in rows["fn_N"]]})


@cache
def _ground() -> tuple[Blade, Any]:
    blade = Blade("sample", "", *blade_samples.blade_mesh(60, 20))
    return blade, find_shape(blade)


def path_table() -> bytes:
    blade, shape = _ground()
    lines = passes(blade, shape, PassOptions(side="convex", spacing=40e-3, step=20e-3))[0]
    names = ["line", *CONTACT, "feed_mm_s", "force_N"]
    rows = [[p.line, *(1e3 * p.p[k]), *p.n[k], *p.t[k], 40.0, 20.0] for p in lines[:1] for k in range(len(p.p))]
    return _table(dict(zip(names, ([round(float(v), 9) for v in column] for column in zip(*rows, strict=True)), strict=True)))


def stl_bytes(binary: bool) -> bytes:
    """A wedge of 60 mm."""
    corner = np.array([[0, 0, 0], [60, 0, 0], [0, 20, 0], [0, 0, 40], [60, 0, 40], [0, 20, 40]], "<f4")
    faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
    if binary:
        body = b"".join(bytes(12) + corner[face].tobytes() + b"\0\0" for face in faces)
        return bytes(80) + len(faces).to_bytes(4, "little") + body
    facets = []
    for face in faces:
        vertices = "".join(f"      vertex {x:g} {y:g} {z:g}\n" for x, y, z in corner[face])
        facets.append(f"  facet normal 0 0 0\n    outer loop\n{vertices}    endloop\n  endfacet\n")
    return f"solid wedge\n{''.join(facets)}endsolid wedge\n".encode()


def _calibration() -> dict[str, bytes]:
    import tempfile

    names = ("a1", "th2", "c2", "c3", "wheel_x")
    factor = np.random.default_rng(3).normal(size=(5, 5)) * 1e-3
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.toml"
        reason = {"th1": "hidden in the base frame"}
        kept = {"residual_rms_mm": 0.0312, "rows": 150, "conditions": {"payloads": ["bare"], "temperature_C": 22.5}}
        kept["update"] = History().grown((600.0, 900.0, 0.0), "5f3a", dict.fromkeys(ENTRIES, 1.5)).table()
        write_calibration(path, Calibration(ROBOT.name, names, factor[0], factor @ factor.T, kept, reason))
        return {file.name: file.read_bytes() for file in Path(folder).iterdir()}


def _program() -> dict[str, bytes]:
    """The golden files, slow enough for the arm."""
    found = {}
    for name in ("axis_GOLD.src", "axis_GOLD.dat", "axis_GOLD_01.src", "axis_GOLD_01.dat"):
        data = (GOLDEN / name).read_bytes()
        for old, new in ((b"=0.03333", b"=1.00000"), (b"=0.03334", b"=1.00000"), (b"=0.06667", b"=2.00000")):
            data = data.replace(old, new)
        found[name.removeprefix("axis_")] = data
    return found


def _old_program() -> dict[str, bytes]:
    """As programs were taught years ago: named points, comments, waits, LIN with approximation."""
    point = "X 1550.0,Y {y},Z 1000.0,A 0.0,B 90.0,C 0.0,S 2,T 10"
    moves = "".join(f"LIN XP{k} C_DIS\n" for k in range(1, 6))
    frame = "{X 0.0,Y 0.0,Z 200.0,A 0.0,B 0.0,C 0.0}"
    source = (
        f"&ACCESS RVO1\nDEF OLD( )\n;FOLD INI\nBAS (#INITMOV,0 )\n;ENDFOLD\nTOOL_DATA[1]={frame}\n$TOOL=TOOL_DATA[1]\n"
        f"$BASE={frame}\n$VEL.CP=0.04\n$VEL_AXIS[1]=20\nPTP {{A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 10.0,A6 0.0}}\n; to the belt\n"
        f"WAIT SEC 0.5\n$OUT[1]=TRUE\nPTP XP1\n{moves}SPLINE\nSPL {{{point.format(y=70)}}}\nSPL {{{point.format(y=75)}}}\n"
        "ENDSPLINE\nHALT\nEND\n"
    )
    points = "".join(f"DECL E6POS XP{k}={{{point.format(y=10.0 * k)},E1 0.0}}\n" for k in range(1, 6))
    data = f"&ACCESS RVO1\nDEFDAT OLD PUBLIC\n{points}DECL FDAT FP1={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}}\nENDDAT\n"
    return {"OLD.src": source.encode(), "OLD.dat": data.encode()}


def _read_cell_files(folder: Path) -> None:
    path = folder / "cell.toml"
    read_tracker_setup(path)
    wheel_frame(read_cell(path))
    files_of(path)
    cell_tables_for(path, folder / "out")


def _read_calibration_files(folder: Path) -> None:
    history_of(read_calibration(folder / "calibration.toml"), folder / "cell.toml")


def _setup() -> Any:
    return _setup_of(CELL)


@cache
def _setup_of(path: Path) -> Any:
    return read_tracker_setup(path)


@cache
def _cell() -> Any:
    return read_cell(CELL)


def _read_plan(folder: Path) -> None:
    read_plan_table(folder)
    read_planned_log(folder / "plan.csv")


def _read_summary(folder: Path) -> None:
    found = read_summary(folder)
    recorded_input(found, "blade")
    cell_of_plan(found, folder, [folder], CELL)


def _read_data(folder: Path) -> None:
    data = read_data_set(folder)
    for signal in data.sealed:
        read_sealed(data, signal)


def _read_old(folder: Path) -> None:
    cell = _cell()
    contact_frames_from_program(
        KRL.read(folder / "OLD.src"), lambda q: forward(ROBOT, q), cell.workpiece.T_flange_blade, wheel_frame(cell)
    )


def _read_planned_program(folder: Path) -> None:
    read_module(folder / "GOLD_01.src")
    check_program(folder / "GOLD.src", ROBOT)


def _summary() -> bytes:
    import hashlib
    import json

    cell = {"role": "cell", "name": "cell.toml", "sha256": hashlib.sha256(cell_text()).hexdigest()}
    blade = {"role": "blade", "name": "blade.stl", "sha256": "ab" * 32}
    return json.dumps(
        {"schema": 1, "name": "GOLD", "kind": "axis", "inputs": [cell, blade], "passes": [{"line": 1}]}, indent=1
    ).encode()


def _mapped() -> dict[str, bytes]:
    """A table made by others: blanks of their units, semicolons, decimal commas, dates."""
    joints = ";".join(f"j{i}" for i in range(1, 7))
    turned = {i: f'from = "j{i}", sign = {-1 if i == 2 else 1}' for i in range(1, 7)}
    moves = "".join(f'q{i}_deg = {{ {theirs}, unit = "rad", offset = 0.5 }}\n' for i, theirs in turned.items())
    moves += "".join(f'approach{i} = {{ {theirs}, unit = "step_rad" }}\n' for i, theirs in turned.items())
    places = "".join(f'{axis}_mm = {{ from = ["m{axis}", "d{axis}"], unit = "m" }}\n' for axis in "xyz")
    when = 'time_s = { from = "stamp", unit = "%Y%m%d%H%M%S" }\ntemperature_C = { from = "air", unit = "K" }\n'
    rows = [
        ";".join(
            [
                *(f"{0.1 * j + 0.01 * k:.4f}" for j in range(6)),
                *"2.1 0.4 1.3 0.01 0.02 0.03".split(),
                f"202105031212{k:02d}",
                "295",
            ]
        )
        for k in range(12)
    ]
    table = "\n".join([f"{joints};mx;my;mz;dx;dy;dz;stamp;air", *rows]).replace(".", ",") + "\n"
    mapping = f'separator = ";"\ndecimal = ","\nrotation = "xyz_intrinsic"\n{moves}{places}{when}'
    return {"mapping.toml": mapping.encode(), "theirs.csv": table.encode()}


def _read_mapped(folder: Path) -> None:
    setup = _setup()
    read_readings(folder / "theirs.csv", setup.payloads, setup.instrument, mapping=read_column_mapping(folder / "mapping.toml"))


def _readings(name: str, sealed: bool) -> Callable[[Path], Any]:
    def read(folder: Path) -> Any:
        setup = _setup()
        return read_readings(folder / name, setup.payloads, setup.instrument, sealed)

    return read


READERS = (
    HostileReader(
        "cell.toml", "cell.toml", lambda: {"cell.toml": cell_text()}, _read_cell_files, ("read_cell", "read_tracker_setup")
    ),
    HostileReader(
        "robot.toml",
        "robot.toml",
        lambda: {"robot.toml": (CATALOGUE / "kr210_r2700_extra.toml").read_bytes()},
        lambda folder: (read_robot_tables(folder / "robot.toml"), load_robot(folder / "robot.toml")),
        ("read_robot_tables",),
    ),
    HostileReader("calibration.toml", "calibration.toml", _calibration, _read_calibration_files, ("read_calibration",)),
    HostileReader("calibration.npz", "calibration.npz", _calibration, _read_calibration_files, ("read_calibration",)),
    HostileReader("tracker.csv", "t.csv", lambda: {"t.csv": tracker_table(False)}, _readings("t.csv", False), ("read_readings",)),
    HostileReader(
        "sealed_tracker.csv", "t.csv", lambda: {"t.csv": tracker_table(True)}, _readings("t.csv", True), ("read_readings",)
    ),
    HostileReader("mapping.toml", "mapping.toml", _mapped, _read_mapped, ("read_column_mapping",)),
    HostileReader("a mapped table", "theirs.csv", _mapped, _read_mapped, ("read_column_mapping",)),
    HostileReader(
        "force.csv",
        "force.csv",
        lambda: {"force.csv": force_table(False)},
        lambda folder: read_force_log(folder / "force.csv"),
        ("read_force_log",),
    ),
    HostileReader(
        "sealed_force.csv",
        "force.csv",
        lambda: {"force.csv": force_table(True)},
        lambda folder: read_force_log(folder / "force.csv", sealed=True),
        ("read_force_log", "read_planned_log"),
    ),
    HostileReader(
        "removal.csv",
        "removal.csv",
        lambda: {"removal.csv": removal_table()},
        lambda folder: read_removal(folder / "removal.csv"),
        ("read_removal",),
    ),
    HostileReader(
        "stock.csv",
        "stock.csv",
        lambda: {"stock.csv": stock_table()},
        lambda folder: read_stock(folder / "stock.csv"),
        ("read_stock",),
    ),
    *(
        HostileReader(
            f"stock.ply {'binary' if binary else 'text'}",
            "stock.ply",
            lambda binary=binary: {"stock.ply": stock_ply(binary)},  # type: ignore[misc]
            lambda folder: read_stock(folder / "stock.ply"),
            ("read_stock",),
        )
        for binary in (False, True)
    ),
    HostileReader(
        "joints.csv",
        "joints.csv",
        lambda: {"joints.csv": joint_table()},
        lambda folder: read_joint_log(folder / "joints.csv"),
        ("read_joint_log",),
    ),
    HostileReader(
        "path.csv",
        "path.csv",
        lambda: {"path.csv": path_table()},
        lambda folder: read_path_file(folder / "path.csv", *_ground(), 0.04, 20.0, 5e-4),
        ("read_path_file",),
    ),
    HostileReader(
        "plan.csv", "plan.csv", lambda: {"plan.csv": plan_table()}, _read_plan, ("read_plan_table", "read_planned_log")
    ),
    HostileReader(
        "plan.json", "plan.json", lambda: {"plan.json": _summary(), "cell.toml": cell_text()}, _read_summary, ("read_summary",)
    ),
    HostileReader(
        "poses.csv",
        "poses.csv",
        lambda: {"poses.csv": tracker_table(True)},
        lambda folder: design_from_poses(_cell(), folder / "poses.csv"),
        (),
    ),
    HostileReader(
        "STL as text",
        "blade.stl",
        lambda: {"blade.stl": stl_bytes(False)},
        lambda folder: (read_facets(folder / "blade.stl"), read_blade(folder / "blade.stl")),
        ("read_facets", "read_blade"),
    ),
    HostileReader(
        "STL as bytes",
        "blade.stl",
        lambda: {"blade.stl": stl_bytes(True)},
        lambda folder: (read_facets(folder / "blade.stl"), read_blade(folder / "blade.stl")),
        ("read_facets", "read_blade"),
    ),
    *(
        HostileReader(
            f"a blade as {name.rpartition('.')[2].upper()}",
            name,
            lambda name=name: {name: other_blade(name)},  # type: ignore[misc]
            lambda folder, name=name: read_blade(folder / name),  # type: ignore[misc]
            ("read_other", "read_blade"),
        )
        for name in ("blade.ply", "blade.obj")
    ),
    HostileReader(
        "arm.urdf",
        "arm.urdf",
        lambda: {"arm.urdf": (ROOT / "docs" / "examples" / "arm.urdf").read_bytes()},
        lambda folder: read_urdf(folder / "arm.urdf"),
        ("read_urdf",),
    ),
    HostileReader("old.src, tolerant", "OLD.src", _old_program, _read_old, ()),
    HostileReader("old.dat, tolerant", "OLD.dat", _old_program, _read_old, ()),
    HostileReader("planned .src, strict", "GOLD_01.src", _program, _read_planned_program, ("read_module",)),
    HostileReader("planned .dat, strict", "GOLD_01.dat", _program, _read_planned_program, ("read_module",)),
    HostileReader(
        "planned .src, virtual controller",
        "GOLD_01.src",
        _program,
        lambda folder: read_program(folder, planned=True),
        ("read_program",),
    ),
    HostileReader(
        "old.src, virtual controller", "OLD.src", _old_program, lambda folder: read_program(folder / "OLD.src"), ("read_program",)
    ),
    HostileReader(
        "a data set's cell.toml",
        "cell.toml",
        lambda: {
            "cell.toml": cell_text(),
            "blade.stl": BLADE.read_bytes(),
            "tracker.csv": tracker_table(False),
            "sealed_tracker.csv": tracker_table(True),
            "force.csv": force_table(False, 2 * LEAST_ROWS),
            "sealed_force.csv": force_table(True),
            "joints.csv": joint_table(),
            "sealed_joints.csv": joint_table(),
        },
        _read_data,
        ("read_data_set", "read_sealed"),
    ),
)

EXTREME = (
    "nan inf -inf 0 -0 -1 1e300 -1e300 1e999 1E999 -1e999 1e-300 1e-320 1e15 -1e9 1e6 0.1e-5".split()
    + "1_0 0x1f 1e 1.2.3 1,5 --1 +-1 1e+ . 1.7976931348623157e308 4.9e-324 9007199254740993".split()
    + [
        "9" * 20,
        "9" * 400,
        "9" * 5000,
        "0." + "3" * 200_000,
        "1" * 200_000,
        "１２",
        "٣.٤",
        "",
        " ",
        "true",
        '"x"',
        "[1]",
        "{}",
        "null",
    ]
)
NUMBER = re.compile(rb"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
TOKENS = (
    b"[" * 1000 + b"]" * 1000, b"{" * 1000, b"{A " * 3000, b"(" * 500, b'{"a":' * 2000, b"a = " + b"[" * 3000 + b"]" * 3000,
    b"{A {B {C 1}}}" * 50, b"a." * 5000 + b"b = 1", b"[[x]]\n" * 500, b"\"\"\"", b"'''", b"\xff\xfe", b"\xed\xa0\x80",
    b"\x00", b"\x1b[2J", b"\x0b", b"\x0c",
    "\u2028".encode(), "\u202e".encode(), "é".encode(), b"A" * 100_000, b";" * 1000, b"," * 5000, b'"', b"'B1111'", b"'H1F'",
    b"'B" + b"1" * 100 + b"'", b"\n" * 1000, b"\r", b"../" * 100, b"/dev/zero", b"%s%n",
    b"PTP_SPLINE\r\n", b"ENDSPLINE\r\n", b"GOLD_01 ( )\r\n",
)  # fmt: skip


def _lines(rng: random.Random, data: bytes) -> list[bytes]:
    return data.splitlines(keepends=True) or [b""]


def _flip(rng: random.Random, data: bytes) -> bytes:
    out = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 2, 5, 50))):
        out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


def _cut(rng: random.Random, data: bytes) -> bytes:
    low, high = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    return rng.choice((data[:low], data[low:], data[:low] + data[high:], data[:low] + data[low:high] * 2 + data[high:]))


def _shuffle_lines(rng: random.Random, data: bytes) -> bytes:
    lines = _lines(rng, data)
    k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
    change = rng.randrange(5)
    if change == 0:
        lines.insert(k, lines[k])
    elif change == 1:
        del lines[k]
    elif change == 2:
        lines[k], lines[m] = lines[m], lines[k]
    elif change == 3:
        lines[k] = lines[k] * rng.choice((10, 300))
    else:
        lines = lines[1:] if rng.random() < 0.5 else [lines[0], *lines]
    return b"".join(lines)


def _number(rng: random.Random, data: bytes) -> bytes:
    found = list(NUMBER.finditer(data))
    if not found:
        return _flip(rng, data)
    for at in sorted(rng.sample(found, min(len(found), rng.choice((1, 1, 1, 2, 5)))), key=lambda m: -m.start()):
        data = data[: at.start()] + rng.choice(EXTREME).encode() + data[at.end() :]
    return data


def _scale(rng: random.Random, data: bytes) -> bytes:
    """A number that is still one: a slip of units or of the decimal point."""
    found = list(NUMBER.finditer(data))
    if not found:
        return _flip(rng, data)
    at = rng.choice(found)
    value = float(at.group()) * rng.choice((-1.0, 1e-3, 1e3, 1e-6, 1e6, 10.0 ** rng.randint(-12, 12)))
    return data[: at.start()] + (f"{value:g}" if rng.random() < 0.5 else f"{value:.6f}").encode() + data[at.end() :]


def _column(rng: random.Random, data: bytes) -> bytes:
    """Every number of a column the same, or two columns exchanged."""
    rows = [line.split(b",") for line in data.split(b"\n")]
    width = len(rows[0])
    k, m = rng.randrange(width), rng.randrange(width)
    word = rng.choice(EXTREME).encode()
    exchange = rng.random() < 0.5
    for row in rows[0 if exchange and rng.random() < 0.5 else 1 :]:
        if len(row) == width:
            row[k], row[m] = (row[m], row[k]) if exchange else (word, row[m])
    return b"\n".join(b",".join(row) for row in rows)


def _token(rng: random.Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    if rng.random() < 0.5:
        at = data.find(b"\n", at) + 1
    return data[:at] + rng.choice(TOKENS) + data[at:]


def _encoding(rng: random.Random, data: bytes) -> bytes:
    return rng.choice(
        (
            lambda: b"",
            lambda: b"\n",
            lambda: b"\xef\xbb\xbf" + data,
            lambda: b"\xef\xbb\xbf" * 2 + data,
            lambda: data.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"),
            lambda: data.replace(b"\r\n", b"\n").replace(b"\n", b"\r"),
            lambda: data.replace(b"\r\n", b"\n"),
            lambda: data.decode("latin-1").encode("utf-16"),
            lambda: data.replace(b",", b";"),
            lambda: data.replace(b",", b"\t"),
            lambda: data.replace(b".", b","),
            lambda: data.upper(),
            lambda: bytes(rng.randrange(256) for _ in range(200)),
            lambda: data * 3,
        )
    )()


def _word(rng: random.Random, data: bytes) -> bytes:
    """A name or word in place of another one of the file."""
    found = list(re.finditer(rb"[A-Za-z_$#][\w.$]*", data))
    if not found:
        return _flip(rng, data)
    at, other = rng.choice(found), rng.choice(found)
    word = rng.choice((other.group(), b"", b"x" * 400, "ß".encode(), at.group() * 2, b"__class__"))
    return data[: at.start()] + word + data[at.end() :]


MUTATORS = (_flip, _cut, _shuffle_lines, _number, _number, _scale, _scale, _column, _token, _encoding, _word)


@cache
def valid(reader: HostileReader) -> dict[str, bytes]:
    return reader.folder()


def mutant(reader: HostileReader, seed: int, number: int) -> bytes:
    """Input `number` of a reader; number 0 is the valid file."""
    rng = random.Random(f"{seed}/{reader.kind}/{number}")
    data = valid(reader)[reader.file]
    for _ in range(0 if number == 0 else rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(MUTATORS)(rng, data)[:4_000_000]
    return data


def lay(reader: HostileReader, folder: Path) -> None:
    """The valid files of a reader in a folder."""
    folder.mkdir(exist_ok=True)
    for name, data in valid(reader).items():
        (folder / name).write_bytes(data)


def outcome(reader: HostileReader, folder: Path, data: bytes) -> str:
    """What came of an input: `worked`, `refused`, or what must not be, in words. Warnings count as exceptions."""
    (folder / reader.file).unlink(missing_ok=True)  # ext4 waits for the disk where a file is written over
    (folder / reader.file).write_bytes(data)
    begun = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            reader.read(folder)
        found = "worked"
    except BadInput as error:
        found = "refused" if sentence(str(error), folder) else f"no sentence: {str(error)[:300]!r}"
    except Infeasible:
        found = "refused"
    except Exception as error:
        trace, last = error.__traceback__, ""
        while trace is not None:
            last, trace = f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}", trace.tb_next
        found = f"{type(error).__name__} in {last}: {str(error)[:120]}"
    took = time.perf_counter() - begun
    return found if took < SECONDS else f"{took:.1f} s: {found}"


def sentence(text: str, folder: Path) -> bool:
    """A refusal is one line that echoes no value whole and holds nothing that a terminal obeys."""
    return text.replace(str(folder), "").isprintable() and len(text.replace(str(folder), "")) < 900


WORDS = st.one_of(st.text(max_size=60), st.floats().map(repr), st.integers().map(str), st.from_regex(r"\A[-+.\deE_]{1,30}\Z"))


def texts(reader: HostileReader, folder: Path, count: int, seed: int, tell: Callable[[str, bytes], None]) -> None:
    """`count` inputs in which hypothesis writes a value or a name of the file anew; `tell` is given what came of each."""
    data = valid(reader)[reader.file]
    places = [m.span() for m in re.finditer(rb"[^\s,=\[\]{}]+", data)]

    @hypothesis_seed(seed)
    @settings(max_examples=count, database=None, deadline=None, suppress_health_check=list(HealthCheck), phases=[Phase.generate])
    @given(st.sampled_from(places), WORDS)
    def run(place: tuple[int, int], word: str) -> None:
        changed = data[: place[0]] + word.encode("utf-8", "surrogatepass") + data[place[1] :]
        tell(outcome(reader, folder, changed), changed)

    run()
