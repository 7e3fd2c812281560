"""Which of the cell's own numbers a calibration was made with, and what of it holds in a cell that was edited since.

What a force log told of wheel, blade frame, flange and payload is a correction to these numbers, or stands in their place: beside
another wheel or load it says nothing, and its small doubt would be another thing's.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from ocp.model.cell_schema import CellTables
from robots.calibration.store import Calibration

KEY = "cell"  # of a calibration's provenance
SAME = 1e-9  # relative; a number written and read again
RESTS_ON: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "wheel": (
        ("centre_mm", "axis", "radius_mm", "width_mm", "cover_thickness_mm", "modulus_MPa", "cover_poisson"),
        ("wheel_x", "wheel_y", "wheel_z", "wheel_axis_u", "wheel_axis_v", "wheel_radius", "cover_stiffness_scale", "wheel_wear"),
    ),
    "workpiece": (("xyz_mm", "abc_deg"), ("blade_x", "blade_y", "blade_z", "blade_a", "blade_b", "blade_c")),
    "force_flange": (
        ("stiffness_N_per_mm", "carried_mass_kg", "gravity_compensated"),
        ("flange_stiffness", "flange_setpoint_offset"),
    ),
    "payload": (("mass_kg", "com_mm"), ("payload_mass", "payload_com_x", "payload_com_y", "payload_com_z")),
}
"""Keys of a cell's table, and the parameters that rest on them; `payload`: what hangs on the flange while grinding."""


def made_for(calibration: Calibration, tables: CellTables) -> Calibration:
    """The calibration with the cell's numbers in its provenance, as it is written."""
    return replace(calibration, provenance=calibration.provenance | {KEY: _numbers(tables)})


def held_in(calibration: Calibration, tables: CellTables, file: str) -> Calibration:
    """What of a calibration holds in the cell `file`: without the parameters of a table that has other numbers than when it was
    made, with a notice of each. One that does not tell its cell's numbers holds whole."""
    told, now = calibration.provenance.get(KEY), _numbers(tables)
    if not isinstance(told, dict):
        return calibration
    gone, notices = set[str](), list[str]()
    for table, (_, names) in RESTS_ON.items():
        then = told.get(table)
        lost = [name for name in names if name in calibration.names]
        if not lost or not isinstance(then, dict):
            continue
        changed = [key for key, value in now.get(table, {}).items() if key in then and not _same(value, then[key])]
        if changed:
            gone |= set(lost)
            notices.append(
                f"{file}: {table}.{changed[0]} is {_shown(now[table][changed[0]])}, the calibration was made with "
                f"{_shown(then[changed[0]])}: what it knew of {', '.join(lost)} is not used, the cell's own numbers are, "
                "as surely as it gives them; calibrate with this one"
            )
    if not gone:
        return calibration
    kept = [i for i, name in enumerate(calibration.names) if name not in gone]
    return replace(
        calibration,
        names=tuple(calibration.names[i] for i in kept),
        values=calibration.values[kept],
        covariance=calibration.covariance[np.ix_(kept, kept)],
        notices=(*calibration.notices, *notices),
    )


def _numbers(tables: CellTables) -> dict[str, dict[str, Any]]:
    """The cell's numbers by table and key."""
    piece = tables.workpiece
    hanging = None if piece is None else piece.payload or next(iter(tables.payloads), None)
    parts = {
        "wheel": tables.wheel,
        "workpiece": piece,
        "force_flange": tables.force_flange,
        "payload": None if hanging is None else tables.payloads[hanging],
    }
    return {
        name: {key: list(value) if isinstance(value := getattr(part, key), tuple) else value for key in RESTS_ON[name][0]}
        for name, part in parts.items()
        if part is not None
    }


def _same(one: Any, other: Any) -> bool:
    try:
        return bool(np.shape(one) == np.shape(other) and np.allclose(one, other, rtol=SAME, atol=SAME))
    except TypeError:
        return False


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_shown(one) for one in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)[:40]
