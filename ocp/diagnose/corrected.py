"""corrected_cell.toml: the cell with the refitted arm and the named effects, as `ocp.plan` reads it.

The user's own keys stay as they are. Files that the cell names are found from the new folder; the arm of the refit stands beside
the cell as calibration.toml, what force readings moved (wheel, blade frame) in it as well where the channel tells it.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ocp.diagnose.dataset import CELL, DataSet
from ocp.diagnose.engine.channel_system import Channel
from ocp.diagnose.force.prior import posterior_of
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.answer import Answer, known_beside
from ocp.diagnose.verdict.shrinkage import Shrinkage
from ocp.effects.cell_effects import table_of
from ocp.effects.effect import Active, scan_key
from ocp.effects.patch import is_patch, patch_table
from ocp.model.calibrated_for import made_for
from ocp.model.cell import cell_tables_for
from robots.calibration.carried import FORCE, carried_over
from robots.calibration.store import BENDING, Calibration, write_calibration
from robots.pose import Array
from robots.toml_files import toml_text

CALIBRATION = "calibration.toml"


def write_corrected_cell(folder: Path, out: Path, answer: Answer) -> None:
    """Write corrected_cell.toml and its calibration into `folder`, which will stand at `out`."""
    data = answer.data
    tables = cell_tables_for(data.folder / CELL, out, data.cell.workpiece.stl if data.cell is not None else None)
    tables.pop("effects", None)
    tables.pop("patches", None)
    robot = tables["robot"]
    calibration = calibration_of(answer.channels, data, answer.corrections)
    if calibration is not None:
        write_calibration(folder / CALIBRATION, made_for(calibration, data.setup.tables, data.setup.robot))
        robot["calibration"] = CALIBRATION
    elif data.setup.tables.robot.calibration is not None:
        believed = data.folder / data.setup.tables.robot.calibration
        for file in filter(Path.is_file, (believed, believed.with_suffix(".npz"))):
            shutil.copyfile(file, folder / file.name)
        robot["calibration"] = believed.name
    if answer.corrections:
        tables["conditions"] = conditions_at_the_end(data)
    total = summed(data.believed, answer.written)
    if named := [table_of(one) for one in total if not is_patch(one.effect)]:
        tables["effects"] = named
    patches = [patch_table(one, "believed") for one in total if is_patch(one.effect)]
    if answer.patch is not None:
        patches += [patch_table(one, promise_words(answer.patch.shrinkage, bool(answer.written))) for one in answer.patch.patches]
    if patches:
        tables["patches"] = patches
    (folder / "corrected_cell.toml").write_text(f"# {CELL} with what ocp.diagnose found\n{toml_text(tables)}", encoding="utf-8")


def promise_words(told: Shrinkage, named: bool) -> str:
    """A promise as a cell tells it; `named`: with effects beside."""
    share = f"{100 * told.predicted:.0f} % of the gap ({100 * told.low:.0f} to {100 * told.high:.0f} %)"
    return f"{share}, with the effects" if named else share


def summed(believed: Sequence[Active], found: Sequence[Active]) -> list[Active]:
    """Believed effects with what was found on top of them: coefficients of the same effect, joint and scanned values, but those
    that follow from its size, add up, with the covariance of what was fitted."""

    def key(one: Active) -> tuple[object, ...]:
        own = () if one.effect.own_size is None else one.effect.own_size(one.a)
        return one.key, scan_key({k: v for k, v in one.scanned.items() if k not in own})

    total = {key(a): a for a in believed}
    for one in found:
        if (known := total.get(key(one))) is not None:
            a = one.a + known.a
            scanned = one.scanned if one.effect.own_size is None else {**one.scanned, **one.effect.own_size(a)}
            one = replace(one, a=a, scanned=scanned)
        total[key(one)] = one
    return list(total.values())


def conditions_at_the_end(data: DataSet) -> dict[str, float]:
    """What effects depend on when the data end, the next plan's beginning: clocks s, temperatures deg C as far as measured."""
    readings, log = data.readings, data.log
    found = {} if readings is None else _ends(time_s=readings.time, temperature_C=readings.temperature)
    if log is not None:
        found |= _ends(clock_s=log.clock, temperature_C=log.temperature, wheel_temperature_C=log.wheel_temperature)
    return found


def _ends(**columns: Array | None) -> dict[str, float]:
    """Last value of each column that is there; clocks at their latest."""
    last = {name: values for name, values in columns.items() if values is not None and np.isfinite(values).any()}
    return {name: float(np.nanmax(v) if name in ("time_s", "clock_s") else v[np.isfinite(v)][-1]) for name, v in last.items()}


def calibration_of(channels: Mapping[str, Channel], data: DataSet, written: Sequence[Active] = ()) -> Calibration | None:
    """The refitted arm, and contact where a force channel has refitted it, with what the believed calibration knows besides
    (wheel and blade beside an arm, the tracker's frame beside a contact); None where neither was measured."""
    known, channel, arm = data.setup.calibration, channels.get("tracker"), None
    if isinstance(channel, TrackerChannel):
        told, station = _provenance(channel) | {"readings": len(channel.readings)}, int(np.unique(channel.readings.station)[0])
        arm = posterior_of(data.setup.robot.name, channel.task.layout, channel.fit, station, told)
        if "force" not in channels:
            return carried_over(arm, known, channel.one_arm)
    return carried_over(_of_contact(channels, data, written), known if arm is None else arm) if "force" in channels else None


def _of_contact(channels: Mapping[str, Channel], data: DataSet, written: Sequence[Active]) -> Calibration:
    """Arm, wheel, blade frame and stiffnesses as log and arm's prior leave them beside what is written, with their covariance."""
    from ocp.calibrate.force.fit import FIT_NAMES
    from ocp.calibrate.force.registration import told_of
    from ocp.diagnose.force.channel import ForceChannel  # blade and contact: only for those who measured force
    from ocp.diagnose.force.held_out import at_known_sizes

    channel = channels["force"]
    assert isinstance(channel, ForceChannel)
    believed, root = channel.problem.believed, channel.problem.believed.root
    told = known_beside("force", channels.values(), written)  # the log alone leaves their sizes open
    x, _, unknowns = at_known_sizes(channel.problem, channel.fit, told)
    covariance = root @ unknowns[: root.shape[1], : root.shape[1]] @ root.T
    known = np.flatnonzero(np.diag(covariance)[: len(FIT_NAMES)] > 0)
    noise = {} if believed.joint_noise is None else {"noise": {"joints_rad": believed.joint_noise}}
    provenance: dict[str, Any] = _provenance(channel) | {FORCE: told_of(channel.log, data.setup.calibration)} | noise
    provenance |= {"rows": len(channel.log), BENDING: list(channel.problem.scene.cell.compliant_joints)}
    names = tuple(FIT_NAMES[i] for i in known)
    return Calibration(data.setup.robot.name, names, x[known], covariance[np.ix_(known, known)], provenance)


def _provenance(channel: Channel) -> dict[str, Any]:
    effects = [f"{a.effect.name}:{a.joint}" if a.joint else a.effect.name for a in channel.active]
    return {"made_by": "ocp.diagnose, fitted together with the named effects", "effects": effects}
