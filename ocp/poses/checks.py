"""What of the cell a measurement uses: nests, payloads and the tracker's place, with every refusal about them."""

import numpy as np

from ocp.model.cell import Cell
from ocp.model.measuring_setup import TrackerSetup
from robots.errors import BadInput
from robots.pose import Array, invert, transform_from_xyzabc
from robots.tracker_readings import Nest

GROUPS = 2  # payloads that are hung on if the user names none
BASE = ("base_x", "base_y", "base_z", "base_a", "base_b", "base_c")


def chosen_targets(setup: TrackerSetup, names: tuple[str, ...]) -> dict[str, Nest]:
    """The nests to be read, all of the cell unless `names` says which. Raises BadInput: none, or an unknown one."""
    nests = setup.instrument.nests or {}
    file = setup.path.name
    if not nests:
        raise BadInput(f"{file}: table [tracker.targets] is missing or empty; say where the nests are, T1 = [x, y, z] in mm")
    for name in names:
        if name not in nests:
            raise BadInput(f"--targets {name} is not in [tracker.targets] of {file} ({', '.join(nests)})")
    return {name: nests[name] for name in nests if name in names or not names}


def chosen_payloads(setup: TrackerSetup, names: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Payloads in the order of mounting, the lightest first, and notices.

    Unless `names` says which: that of the workpiece and the one whose mass is farthest from it. Raises BadInput: none, or an
    unknown one.
    """
    known, file = setup.payloads, setup.path.name
    if not known:
        raise BadInput(f"{file}: table [payloads] is missing; add what hangs on the flange as [payloads.NAME]")
    for name in names:
        if name not in known:
            raise BadInput(f"--payload {name} is not in [payloads] of {file} ({', '.join(known)})")
    chosen = list(dict.fromkeys(names))
    if not chosen:
        mounted = setup.tables.workpiece.payload if setup.tables.workpiece else None
        first = mounted or next(iter(known))
        others = sorted((n for n in known if n != first), key=lambda n: -abs(known[n].mass - known[first].mass))
        chosen = [first, *others[: GROUPS - 1]]
    notices = []
    if np.ptp([known[name].mass for name in chosen]) < 1.0:
        notices.append(
            "all readings carry the same mass: springs show only in how the weight pulls from posture to posture; give a second "
            "payload, or none at all as [payloads.bare] with mass_kg = 0, to tell them apart from the geometry"
        )
    return sorted(chosen, key=lambda n: known[n].mass), notices


def stated_tracker(cell: Cell, given: Array | None) -> tuple[Array | None, str]:
    """The tracker head (3,) m in the base frame from the command line, else from the cell's calibration, else None; and which."""
    if given is not None:
        if not np.isfinite(given).all() or np.abs(given).max() > 100.0:
            raise BadInput("--tracker must be x,y,z in mm in the base frame, at most 100 m away")
        return given, "from --tracker"
    calibration = cell.calibration
    if calibration is not None and set(BASE) <= set(calibration.names):
        values = np.array([calibration.values[calibration.names.index(name)] for name in BASE])
        return invert(transform_from_xyzabc(values[:3], values[3:]))[:3, 3], "as in the cell's calibration"
    return None, "assumed, 3.5 m from axis 1 at 1.5 m height where most readings are seen"
