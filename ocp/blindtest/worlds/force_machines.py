"""Machines of force worlds: drawn from a seed and a number, so that the scorer can draw the very same again.

Stiffnesses, setpoint and sensor are as their makers leave them; what a cell really shows more of is an effect of the catalogue
and would rightly be named. Small things below the catalogue's low ends make the background of every other machine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ocp.blindtest.worlds.course import course_of, taught
from ocp.blindtest.worlds.grinder import Bench, Log, keep, store_of
from ocp.blindtest.worlds.machines import Machine, background, draw_machine, stream
from ocp.blindtest.worlds.recipes import Recipe
from ocp.blindtest.worlds.runs import Rows, drawn_runs, rows_of
from ocp.model.cell import read_cell
from ocp.simulate.twin.arm.arm import make_arm
from ocp.simulate.twin.contact.table import make_tables
from ocp.simulate.twin.truth.machine import Truth
from ocp.simulate.twin.truth.planting import Planted
from ocp.simulate.twin.truth.truth import REPEATABILITY
from robots.pose import Array

STORE = "contact.pkl"
# What the makers leave, one sigma: relative stiffness of cover, blade and flange; N of the flange's setpoint and of the sensor's
# zero; gain and zero (N) of the sensor's tangential axis.
STIFF_SD, SETPOINT_SD, ZERO_SD, SHEAR_GAIN_SD, SHEAR_ZERO_SD = 0.01, 0.1, 0.02, 0.02, 0.05
# rad: how well an arm comes back to its path while it runs without a stop, and with the background's unrest.
REPEATS, RESTLESS = 2e-6, 4e-6
# Background, below the catalogue's low ends: rad of ripple and play of every joint, N/h, m/s; share of wild rows, their size N.
RIPPLE, PLAY, DRIFT, WEAR, WILD, WILD_N = 2e-6, 1e-6, 0.02, 3e-9, 0.01, (1.5, 8.0)
WARMING = 4.0  # K by which the hall warms over HOURS in every other machine
HOURS = 1.0
_RUNS, _TAUGHT, _OWN, _NOISE = range(10, 14)  # streams of one world, beside those of `ocp.blindtest.worlds.machines`


@dataclass(frozen=True, eq=False)
class GrindingMachine:
    """A cell with its hidden numbers and nothing planted: its bench, rows to learn from and sealed ones, whether it has a
    background; gains: of the tangential axis; warming K/h of the hall; arm: its tracker campaign, where one is measured."""

    bench: Bench
    truth: Truth
    rows: Rows
    sealed: Rows
    background: bool
    gains: tuple[float, float]
    warming: float
    arm: Machine | None
    seed: int

    def log(self, effects: Sequence[Planted], sealed: bool = False, unrest: bool = False, moved: Array | None = None,
            truth: Truth | None = None, gains: tuple[float, float] | None = None) -> Log:  # fmt: skip
        """Readings without noise with these effects; unrest: the joints come back as badly as they do.

        Sealed rows are driven after the others, for what happened before: a blade slips where it was ground then."""
        rows = self.whole if sealed else self.rows
        truth = replace(self.truth if truth is None else truth, effects=tuple(effects))
        rng = np.random.default_rng([self.seed, int(sealed)]) if unrest else None
        log = self.bench.log(truth, rows, self.hall(rows), rng, moved, self.gains if gains is None else gains)
        return log.last(self.sealed) if sealed else log

    @cached_property
    def whole(self) -> Rows:
        """The rows to learn from and then the sealed ones."""
        return self.rows.then(self.sealed)

    def hall(self, rows: Rows) -> Array:
        """Temperature of the hall (n,) deg C."""
        clock = rows.clock
        return np.asarray(self.bench.cell.tables.reference_temperature_C + self.warming * clock / 3600.0)

    @cached_property
    def bare(self) -> Log:
        """The log without effects."""
        return self.log(())


def draw_grinding(cell_path: Path, seed: int, recipe: Recipe, readings: int, blind: int, tracker: bool) -> GrindingMachine:
    """The machine of a force world; `tracker`: measured by a tracker too. Contacts that it meets first are kept in the check's
    folder."""
    cell = read_cell(cell_path)
    arm = draw_machine(cell_path, seed, recipe, readings, blind)
    piece = cell.workpiece
    assert piece.stl is not None
    course = course_of(piece.stl, piece.stl_unit, cell_path)
    file = cell_path.parent / STORE
    tables = store_of(file, lambda: make_tables(cell, course.blade))
    before = len(tables.nodes)
    restless = background(recipe)
    truth = _own(arm.truth, stream(seed, recipe, _OWN), restless)
    joints = taught(course, cell, truth, make_arm(cell, truth), stream(seed, recipe, _TAUGHT))
    rng = stream(seed, recipe, _RUNS)
    runs, sealed = drawn_runs(rng, cell.process.force, cell.wheel.belt_speed)
    own = stream(seed, recipe, _NOISE)
    made = GrindingMachine(
        bench=Bench(cell, course, joints, tables), truth=truth, rows=rows_of(course, runs), sealed=rows_of(course, sealed),
        background=restless, gains=(SHEAR_GAIN_SD * own.normal(), SHEAR_ZERO_SD * own.normal()),
        warming=WARMING / HOURS * float(own.uniform()) * (recipe.index % 2),
        # At the stops of a tracker's campaign the same arm repeats as it does there.
        arm=replace(arm, truth=replace(truth, repeatability=REPEATABILITY, outliers=arm.truth.outliers)) if tracker else None,
        seed=int(own.integers(2**31)),
    )  # fmt: skip
    made.bare  # noqa: B018 (fills the store)
    made.log((), sealed=True)
    keep(file, tables, before)
    return made


def _own(truth: Truth, rng: np.random.Generator, restless: bool) -> Truth:
    """The arm's truth with the contact as its makers leave it."""
    z = np.clip(rng.normal(size=5), -2.5, 2.5)
    effects: tuple[Planted, ...] = ()
    return replace(
        truth, effects=effects, cover_scale=1 + STIFF_SD * z[0], blade_scale=1 + STIFF_SD * z[1],
        flange_scale=1 + STIFF_SD * z[2], flange_offset=SETPOINT_SD * z[3], sensor_bias=ZERO_SD * z[4],
        repeatability=RESTLESS if restless else REPEATS, play=rng.uniform(0, PLAY, 6) * restless,
        ripple=truth.ripple * [0.0, 1.0, 1.0] + [RIPPLE * restless, 0.0, 0.0] * rng.uniform(0, 1, (6, 1)),
    )  # fmt: skip


def small(machine: GrindingMachine) -> tuple[Planted, ...]:
    """The background's drift and wear, which no label holds."""
    if not machine.background:
        return ()
    rng = np.random.default_rng([machine.seed, 5])
    drift, wear = DRIFT * rng.uniform(-1, 1), WEAR * rng.uniform()
    return Planted("sensor_drift", None, {"N_per_h": float(drift)}), Planted("wheel_wear", None, {"m_per_s": float(wear)})
