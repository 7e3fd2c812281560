"""What `ocp.simulate` was asked for, checked: numbers, effects, the cell that a plan belongs to."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ocp.data import CELL
from ocp.effects.patch import PATCH
from ocp.model.cell import Cell
from ocp.simulate.twin.plan_knowledge import cell_of_plan, file_hash, recorded_input, with_hash
from ocp.simulate.twin.planting import EFFECT_KINDS, EffectKind, Planted, draw_effect, parse_effect
from ocp.simulate.twin.run import CampaignPlan
from robots.bounds import refuse_outside
from robots.errors import BadInput, shown

MOST_EFFECTS = 6
MOST_LEVELS = 20  # setpoints and belt speeds: for each the whole plan is ground once more
# Shares of the process force whose setpoints tell stiffness from place; of a rigid mount nearer together.
LADDER, RIGID_LADDER = (0.6, 1.0, 1.4), (0.75, 1.0, 1.25)
MOVING_HZ = 100.0  # 1/s: a mass of 2 kg on a stiff contact swings in 27 ms
MACHINES = {
    "drawn": "virtual cell {seed}, drawn with the errors of a real one",
    "believed": "a virtual cell that is just as believed",
    "sampled": "virtual cell {seed}, drawn from what the calibration leaves open",
}
# Effects that need what a run without a plan, without a flange, without joints.csv does not have.
_ARM_ONLY = ("arm", "tracker")


@dataclass(frozen=True)
class AskedRun:
    """The command's arguments as they were given; see `ocp.simulate`."""

    plan: Path | None
    cell: Path | None
    blade: Path | None
    effects: tuple[str, ...]
    random: str | None
    sealed: bool
    machine: str
    seed: int
    size: float
    poses: str
    ladder: tuple[float, ...] | None
    belts: tuple[float, ...]
    air: bool
    joints: bool
    hz: float
    log_hz: float
    clock: float = 0.0


def check_numbers(wanted: AskedRun) -> None:
    """Raises BadInput: what needs no file to be seen wrong."""
    if wanted.machine not in MACHINES:
        raise BadInput(f"--machine '{wanted.machine}' is not one of {', '.join(MACHINES)}")
    refuse_outside(("--seed", wanted.seed, 0, 2**32, ""), ("--size", wanted.size, 0.0, 5.0, ""))
    refuse_outside(("--hz", wanted.hz, 20.0, 2000.0, "1/s"), ("--clock", wanted.clock, 0.0, 1e7, "s"))
    refuse_outside(("--log-hz", wanted.log_hz, 1.0, 2000.0, "1/s"))
    if wanted.machine != "drawn" and wanted.size != 1.0:
        raise BadInput(
            f"--size {wanted.size:g}: is of the errors of a drawn machine, --machine {wanted.machine} has none; leave it out"
        )
    if wanted.joints and wanted.plan is None:
        raise BadInput("--joints needs a plan to drive; name the plan's folder")
    if (wanted.ladder or wanted.belts) and wanted.plan is None:
        raise BadInput("--ladder and --belt need a plan to grind; name the plan's folder")


def check_rate(wanted: AskedRun, cell: Cell) -> None:
    """Raises BadInput: samples too far apart for a flange that moves between them."""
    if wanted.plan is not None and cell.flange is not None and cell.flange.moves_in_time and wanted.hz < MOVING_HZ:
        raise BadInput(
            f"--hz {wanted.hz:g}: {cell.path} has a force flange that moves in time, which takes {MOVING_HZ:g} at least; "
            "leave --hz out"
        )


def plan_folder(plan: Path) -> Path:
    """Of a plan that is a folder or its main program."""
    return plan if plan.is_dir() else plan.parent


def _near(plan: Path) -> tuple[Path, ...]:
    return plan_folder(plan), plan_folder(plan).resolve().parent, Path.cwd()


def cell_file(wanted: AskedRun, summary: dict[str, Any]) -> Path:
    """The cell: the one given, else the plan's own by its hash, without a plan the bundled one. Raises BadInput."""
    if wanted.cell is not None:
        return wanted.cell
    if wanted.plan is None:
        return CELL
    return cell_of_plan(summary, plan_folder(wanted.plan), _near(wanted.plan), CELL)


def blade_file(wanted: AskedRun, summary: dict[str, Any], own: Path | None) -> Path | None:
    """A blade that replaces the cell's own: the one given, or, for a cell that was found, one near the plan by its hash."""
    known = recorded_input(summary, "blade")
    if wanted.blade is not None or wanted.cell is not None or known is None or wanted.plan is None:
        return wanted.blade
    if own is not None and own.is_file() and file_hash(own) == known[1]:
        return None
    return with_hash([place / known[0] for place in _near(wanted.plan)], known[1])


def believed_effects(wanted: AskedRun, cell: Cell) -> tuple[list[Planted], list[str]]:
    """The cell's own effects as a machine has them that is as believed, of those that show in this run; a sentence on what it
    does not have."""
    own, lacking = list[Planted](), list[str]()
    for one in cell.effects:
        kind, values = EFFECT_KINDS.get(one.name), one.active.parameters
        if wanted.machine != "drawn" and kind is not None and {key.name for key in kind.keys} == values.keys():
            same = {k: v if isinstance(v, str) else v if np.ndim(v) == 0 else tuple(map(float, v)) for k, v in values.items()}
            own += [Planted(one.name, one.joint or None, same)] if _shows(kind, wanted, cell) else []
        else:
            lacking.append(one.active.effect.title if one.name.startswith(PATCH) else one.name)
    names = ", ".join(dict.fromkeys(lacking))
    drawn = "a drawn machine has what --effect plants alone"
    why = drawn if wanted.machine == "drawn" else "it knows that in another form, which --effect plants, or not at all"
    return own, [f"{cell.path.name} believes in {names}, and the virtual cell has nothing of it: {why}"] if lacking else []


def planted_effects(wanted: AskedRun, cell: Cell, own: Sequence[Planted] = ()) -> tuple[Planted, ...]:
    """What is planted: what was named, then what is drawn at random, on top of the cell's `own`. Raises BadInput in one
    sentence."""
    found = [parse_effect(text) for text in wanted.effects]
    if wanted.random is not None:
        word, _, number = wanted.random.partition(":")
        if word != "random" or not re.fullmatch(r"\d{1,9}", number, re.ASCII) or not 0 <= int(number) <= MOST_EFFECTS:
            raise BadInput(
                f"--effects '{shown(wanted.random)}': write random:N with N from 0 to {MOST_EFFECTS}; --effect names single ones"
            )
        found += _drawn(wanted, cell, int(number))
    names = [(one.effect, one.joint) for one in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise BadInput(f"effect '{twice[0]}' is planted twice in the same place; give it once with the whole size")
    for one in found:
        if one.effect.startswith("flange_") and cell.flange is None:
            raise BadInput(f"effect '{one.effect}': the cell has no [force_flange]; choose another effect")
        if wanted.plan is None and EFFECT_KINDS[one.effect].part not in _ARM_ONLY:
            raise BadInput(
                f"effect '{one.effect}' shows only while grinding; name a plan's folder, or choose an effect of the arm"
            )
    return (*own, *found)


def _drawn(wanted: AskedRun, cell: Cell, count: int) -> list[Planted]:
    """Different effects at random, among those that this run can show."""
    rng = np.random.default_rng([wanted.seed, 0xEF])
    usable = [kind for _, kind in sorted(EFFECT_KINDS.items()) if _shows(kind, wanted, cell)]
    chosen = rng.choice(len(usable), size=min(count, len(usable)), replace=False)
    targets = list(cell.tables.tracker.targets) if cell.tables.tracker is not None else ["T1"]
    return [draw_effect(rng, usable[int(k)], targets=targets) for k in chosen]


def _shows(kind: EffectKind, wanted: AskedRun, cell: Cell) -> bool:
    if kind.part in _ARM_ONLY:
        return kind.part == "arm" or cell.tables.tracker is not None
    return wanted.plan is not None and (cell.flange is not None or not kind.name.startswith("flange_"))


def campaign_plan(wanted: AskedRun, cell: Cell) -> CampaignPlan:
    """What is to be ground and logged. Raises BadInput: levels, speeds or rates out of range."""
    force, ladder = cell.process.force, wanted.ladder
    if ladder is None:
        ladder = tuple(round(force * share, 3) for share in (RIGID_LADDER if cell.flange is None else LADDER))
    refuse_outside(*(("--ladder", level, 0.1 * force, 3 * force, "N, about the process force") for level in ladder))
    refuse_outside(("--log-hz", wanted.log_hz, 1.0, wanted.hz, "1/s, the control rate"))
    if len(ladder) + len(wanted.belts) > MOST_LEVELS:
        raise BadInput(f"--ladder and --belt ask for {len(ladder) + len(wanted.belts)} campaigns, the limit is {MOST_LEVELS}")
    refuse_outside(*(("--belt", belt, -60.0, 60.0, "m/s") for belt in wanted.belts))
    return CampaignPlan(ladder, wanted.belts, wanted.air, wanted.log_hz, wanted.sealed, wanted.clock)


def in_words(planted: Sequence[Planted]) -> str:
    """What was planted, as the last line tells it."""
    if not planted:
        return "nothing planted"
    words = []
    for one in planted:
        place = "" if one.joint is None else f":{one.joint}"
        values = []
        for name, value in one.values.items():
            numbers_ = value if isinstance(value, tuple) else (value,)
            values.append(f"{name}=" + "/".join(v if isinstance(v, str) else f"{v:.3g}" for v in numbers_))
        words.append(f"{one.effect}{place} ({', '.join(values)})")
    return "planted " + ", ".join(words)
