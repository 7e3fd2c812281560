"""Which of the cell's own numbers a calibration was made with, and what of it holds in a cell that was edited since.

What a force log told of wheel, blade frame, flange and payload is a correction to these numbers, or stands in their place: beside
another wheel or load it says nothing, and its small doubt would be another thing's. Beside another arm nothing of it holds: its
geometry would stand in that arm's place, its springs gave under the weights then given, and wheel and blade were found by it.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ocp.effects.context import LOADED
from ocp.model.cell_schema import CellTables
from robots.calibration.store import Calibration
from robots.errors import BadInput
from robots.robot import Robot

KEY, ARM = "cell", "robot"  # of a calibration's provenance, and the arm's numbers there
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


SUBSYSTEMS = {"wheel": ("wheel",), "workpiece": ("blade", "tool"), "force_flange": ("flange",), "payload": ("payload",)}
"""Of effects that come on top of a table's numbers."""


def made_for(calibration: Calibration, tables: CellTables, robot: Robot) -> Calibration:
    """The calibration with the numbers of the cell and its robot in its provenance, as it is written."""
    return replace(calibration, provenance=calibration.provenance | {KEY: _numbers(tables) | {ARM: _arm(robot)}})


def held_in(calibration: Calibration, tables: CellTables, robot: Robot, file: Path) -> Calibration:
    """What of a calibration holds in the cell `file` with its `robot`: without the parameters of a table that has other numbers
    than when it was made, with a notice of each. One that does not tell its cell's numbers holds whole.

    Raises BadInput: it was made with another arm of that name.
    """
    told, now = calibration.provenance.get(KEY), _numbers(tables)
    if not isinstance(told, dict):
        return calibration
    _refuse_other_arm(told.get(ARM), _arm(robot), f"{file}, robot.model '{tables.robot.model}'")
    gone, notices = set[str](), list[str]()
    for table, (_, names) in RESTS_ON.items():
        then = told.get(table)
        lost = [name for name in names if name in calibration.names]
        on_top = [e for e in tables.believed if e.active.effect.subsystem in SUBSYSTEMS[table]]
        added = ", ".join(e.word for e in on_top if e.active.scanned.get("payload", LOADED) in (LOADED, tables.hanging))
        if not (lost or added) or not isinstance(then, dict):
            continue
        if changed := _changed(now.get(table, {}), then):
            key, at = changed[0], f"payloads.{tables.hanging}" if table == "payload" else table
            what = f"{at}.{key} is {_shown(now[table][key])}, the calibration was made with {_shown(then[key])}"
        elif table not in now and tables.workpiece is not None and tables.wheel is not None:  # a cell that grinds without it
            what = f"there is no {table}, the calibration was made with one"
        else:
            continue
        gone |= set(lost)
        if lost:
            notices.append(
                f"{file.name}: {what}: what it knew of {', '.join(lost)} is not used, the cell's own numbers are, as surely as "
                "it gives them; calibrate with this one"
            )
        if added:
            notices.append(
                f"{file.name}: {what}: still on top of that come the cell's effects {added}; take out those that the new number "
                "has in it"
            )
    kept = [i for i, name in enumerate(calibration.names) if name not in gone]
    return replace(
        calibration,
        names=tuple(calibration.names[i] for i in kept),
        values=calibration.values[kept],
        covariance=calibration.covariance[np.ix_(kept, kept)],
        notices=(*calibration.notices, *notices),
    )


def _refuse_other_arm(then: object, now: dict[str, Any], where: str) -> None:
    changed = _changed(now, then) if isinstance(then, dict) else []
    if isinstance(then, dict) and changed:
        key = changed[0]
        raise BadInput(
            f"{where}: {key} is {_shown(now[key])}, the calibration was made with {_shown(then[key])}, so it is of another arm "
            "or mounting; take robot.calibration out of the cell and calibrate this one, or restore the number"
        )


def _changed(now: dict[str, Any], then: dict[str, Any]) -> list[str]:
    return [key for key, value in now.items() if key in then and not _same(value, then[key])]


def _arm(robot: Robot) -> dict[str, Any]:
    """What decides where an arm stands and how its weight pulls, by the keys of its file; of the base nothing does."""
    theta, d, a, alpha, beta = robot.mdh.T * np.array([180 / np.pi, 1e3, 1e3, 180 / np.pi, 180 / np.pi])[:, None]
    rows = {"sign": robot.sign, "theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha, "beta_deg": beta}
    numbers = {f"geometry.{key}": row.tolist() for key, row in rows.items()}
    for i in range(1, 7):
        numbers |= {
            f"links.link{i}.mass_kg": float(robot.link_mass[i]),
            f"links.link{i}.com_mm": (1e3 * robot.link_com[i]).tolist(),
        }
    return numbers | {"gravity_direction": robot.gravity_direction.tolist()}


def _numbers(tables: CellTables) -> dict[str, dict[str, Any]]:
    """The cell's numbers by table and key."""
    parts = {
        "wheel": tables.wheel,
        "workpiece": tables.workpiece,
        "force_flange": tables.force_flange,
        "payload": tables.payloads.get(tables.hanging or "") if tables.workpiece is not None else None,
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
