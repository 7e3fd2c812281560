"""Does a program belong to a cell? Its frames, its plan's hashes, and which cell file a plan was made with."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.controller.krl_program import KrlProgram, Motion
from robots.errors import BadInput
from robots.pose import Array, abc_from_rotation, invert

PRINTED = (2e-5, np.radians(2e-3))  # m, rad: what printing a frame may round
REGISTERED = (5e-4, np.radians(0.2))  # m, rad, on top of 5 sd: what a calibration may have moved a frame by
SDS = 5.0


def sha256(path: Path) -> str:
    """Hash of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def recorded(summary: dict[str, Any], role: str) -> tuple[str, str] | None:
    """Name and hash of an input of the plan, None where plan.json does not tell it."""
    for item in summary.get("inputs", []):
        if isinstance(item, dict) and item.get("role") == role:
            return str(item.get("name")), str(item.get("sha256"))
    return None


def cell_of_plan(summary: dict[str, Any], folder: Path, places: Iterable[Path], bundled: Path) -> Path:
    """The cell file that a plan was made with, by its hash: in `places`, the bundled one, or one folder below `places`.

    Raises BadInput: plan.json names a cell that is nowhere; another one is never taken in its place.
    """
    known = recorded(summary, "cell")
    if known is None:
        raise BadInput(f"{folder}: plan.json does not tell which cell the plan was made with; give it with --cell")
    name, digest = known
    near = list(places)
    looked = [*(place / name for place in near), bundled, *(file for place in near for file in sorted(place.glob(f"*/{name}")))]
    for candidate in looked:
        if candidate.is_file() and sha256(candidate) == digest:
            return candidate
    raise BadInput(f"{folder}: was made with a cell '{name}' that is not found near it; give that file with --cell")


def refuse_stranger(program: KrlProgram, cell: Cell, summary: dict[str, Any], folder: Path) -> tuple[str, ...]:
    """Notices about a program that belongs to the cell.

    Raises BadInput: tool or base frame differ from the cell's by more than printing, or where a calibration moved them by more
    than that can; another blade.
    """
    blade, stl = recorded(summary, "blade"), cell.workpiece.stl
    if stl is not None and not stl.is_file():
        raise BadInput(f"{cell.path}: its blade {stl} cannot be read; put the file there or give another with --blade")
    if blade is not None and stl is not None and sha256(stl) != blade[1]:
        raise BadInput(f"{folder}: was planned for another blade '{blade[0]}' than {stl}; give that with --blade, or plan anew")
    moved = cell.calibration is not None or recorded(summary, "calibration") is not None
    piece, wheel = cell.workpiece, cell.wheel
    for motion in program.motions:
        if motion.kind == "PTP" and not motion.frames.held:
            continue
        _compare(motion, "$TOOL", motion.frames.tool, piece.T_flange_blade, (piece.xyz_sd, piece.abc_sd) if moved else None, cell)
        _compare(
            motion, "$BASE", motion.frames.base, wheel_place(cell), (wheel.centre_sd, wheel.axis_sd) if moved else None, cell
        )
        if not motion.frames.held:
            raise BadInput(f"{motion.file}, line {motion.line}: $IPO_MODE is #BASE, but in {cell.path} the robot holds the blade")
    known = recorded(summary, "cell")
    if known is not None and sha256(cell.path) != known[1]:
        return (f"the plan was made with another version of {known[0]} than {cell.path}; tool, wheel and blade agree",)
    return ()


def wheel_place(cell: Cell) -> Array:
    """T_base_wheel (4, 4): where the wheel touches at arc zero, x along the belt, y along the axis (docs/krl.md)."""
    w = cell.wheel
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cross(w.axis, w.contact_direction), w.axis, w.contact_direction], axis=1)
    T[:3, 3] = w.centre + w.radius * w.contact_direction
    return T


def _compare(motion: Motion, name: str, found: Array, expected: Array, sd: tuple[float, float] | None, cell: Cell) -> None:
    off = invert(expected) @ found
    way, turn = float(np.linalg.norm(off[:3, 3])), float(np.linalg.norm(Rotation.from_matrix(off[:3, :3]).as_rotvec()))
    most = PRINTED if sd is None else (REGISTERED[0] + SDS * sd[0] * 3**0.5, REGISTERED[1] + SDS * sd[1] * 3**0.5)
    if way > most[0] or turn > most[1]:
        x, y, z = 1e3 * expected[:3, 3]
        a, b, c = np.degrees(abc_from_rotation(expected[:3, :3]))
        raise BadInput(
            f"{motion.file}, line {motion.line}: {name} lies {1e3 * way:.3f} mm and {np.degrees(turn):.4f} deg from that of "
            f"{cell.path} (X {x:.2f}, Y {y:.2f}, Z {z:.2f}, A {a:.3f}, B {b:.3f}, C {c:.3f}); the program belongs to another cell"
        )
