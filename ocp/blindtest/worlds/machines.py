"""Machines of blind worlds: drawn from a seed and a number, so that the scorer can draw the very same again.

A machine that a tracker measures has the errors of real ones. A grinding machine has their weights, and its stiffnesses, setpoint
and sensor as their makers leave them: what a cell really shows more of is an effect of the catalogue and would rightly be named.
Small things below the catalogue's low ends make its background, ripple and play among them, as its lines were taught on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ocp.blindtest.worlds.bench import Bench, Log, RunRows, blade_lines, drawn_runs, rows_of_runs, save_store, store_of, taught
from ocp.blindtest.worlds.outside import OutsideArm
from ocp.blindtest.worlds.recipes import OUTSIDE, Recipe, of_arm
from ocp.model.cell import Cell, read_cell
from ocp.simulate.twin.arm import VirtualArm, make_arm
from ocp.simulate.twin.contact.table import make_tables
from ocp.simulate.twin.planting import Planted
from ocp.simulate.twin.tracker import TrackerCampaign, random_design, sealed_design, true_points
from ocp.simulate.twin.truth import PLAY as ARM_PLAY
from ocp.simulate.twin.truth import REPEATABILITY, Truth, draw_truth
from robots.pose import Array

VERSION = 2  # of how machines are drawn: a check of another is not gone on with
STORE = "contact_2.pkl"  # the number goes on where the stored form changes: an older file is not read
# What the makers leave, one sigma: relative stiffness of cover, blade and flange; N of the flange's setpoint and of the sensor's
# zero; gain and zero (N) of the sensor's tangential axis.
STIFF_SD, SETPOINT_SD, ZERO_SD, SHEAR_GAIN_SD, SHEAR_ZERO_SD = 0.01, 0.1, 0.02, 0.02, 0.05
# rad: how well an arm comes back to its path while it runs without a stop, and with the background's unrest.
REPEATS, RESTLESS = 2e-6, 4e-6
# What every real arm has under no name (PHYSICS 6, Masses; DIAGNOSIS, Second method): one sigma of links' masses (relative) and
# centres (m); payloads' masses evenly within (relative); rad of a gear's ripple, root of the squares of all lines, how many,
# waves a turn; degrees of freedom of the noise; K by which the structure warms up.
LINK_MASS, LINK_CENTRE, PAYLOAD_MASS = 0.04, 0.01, 0.01
GEAR_RIPPLE, GEAR_LINES, GEAR_ORDERS = (1e-5, 3e-5), (3, 5), (3, 150)
TAILS, WARM_UP = 4.0, (2.0, 12.0)
# Background of a grinding machine, whose lines were taught on it, below the catalogue's low ends: rad of ripple and play of every
# joint, N/h, m/s.
RIPPLE, PLAY, DRIFT, WEAR = 2e-6, 1e-6, 0.02, 3e-9
WARMING = 4.0  # K by which the hall warms over HOURS in every other machine
HOURS = 1.0
# Streams of random numbers of one world; EFFECTS: that the planted effects are drawn with.
_MACHINE, _CAMPAIGN, _SEALED, EFFECTS, _REAL = range(5)
_RUNS, _TAUGHT, _OWN, _NOISE = range(10, 14)


@dataclass(frozen=True, eq=False)
class TrackerMachine:
    """A machine that a tracker measures: a cell with its hidden numbers, nothing planted, and the campaigns on it, to learn from
    and sealed; play rad: up to which joints are drawn with."""

    cell: Cell
    truth: Truth
    campaign: TrackerCampaign
    sealed: TrackerCampaign
    play: float = 0.0

    def with_effects(self, effects: Sequence[Planted]) -> Truth:
        """The same machine with these effects."""
        return replace(self.truth, effects=tuple(effects))

    def points(self, effects: Sequence[Planted], sealed: bool = False) -> Array:
        """Points (n, 3) m that a tracker without noise would read."""
        campaign, truth = self.sealed if sealed else self.campaign, self.with_effects(effects)
        arm = arm_with_outside(self.cell, truth, campaign.targets)
        return true_points(truth, self.cell, arm, campaign.moments, campaign.targets)


@dataclass(frozen=True, eq=False)
class GrindingMachine:
    """A machine that grinds: its bench and hidden numbers, nothing planted, rows to learn from and sealed ones, whether it has a
    background; gains: of the tangential axis; warming K/h of the hall; arm: its tracker campaign, where one is measured."""

    bench: Bench
    truth: Truth
    rows: RunRows
    sealed: RunRows
    background: bool
    gains: tuple[float, float]
    warming: float
    arm: TrackerMachine | None
    seed: int

    def log(
        self,
        effects: Sequence[Planted],
        sealed: bool = False,
        unrest: bool = False,
        moved: Array | None = None,
        truth: Truth | None = None,
    ) -> Log:
        """Readings without noise with these effects; unrest: the joints come back as badly as they do.

        Sealed rows are driven after the others, for what happened before: a blade slips where it was ground then."""
        rows = self.whole if sealed else self.rows
        truth = replace(self.truth if truth is None else truth, effects=tuple(effects))
        rng = np.random.default_rng([self.seed, int(sealed)]) if unrest else None
        log = self.bench.log(truth, rows, self.hall(rows), rng, moved, self.gains)
        return log.last(self.sealed) if sealed else log

    @cached_property
    def whole(self) -> RunRows:
        """The rows to learn from and then the sealed ones."""
        return self.rows.then(self.sealed)

    def hall(self, rows: RunRows) -> Array:
        """Temperature of the hall (n,) deg C."""
        return np.asarray(self.bench.cell.tables.reference_temperature_C + self.warming * rows.clock / 3600.0)

    def forces(self, effects: Sequence[Planted]) -> Array:
        """Readings (2, n) N without noise."""
        return self.log(effects).both if effects else self.bare.both

    @cached_property
    def bare(self) -> Log:
        """The log without effects."""
        return self.log(())

    @property
    def small(self) -> tuple[Planted, ...]:
        """The background's drift and wear, which no label holds."""
        if not self.background:
            return ()
        rng = np.random.default_rng([self.seed, 5])
        drift, wear = DRIFT * rng.uniform(-1, 1), WEAR * rng.uniform()
        return Planted("sensor_drift", None, {"N_per_h": float(drift)}), Planted("wheel_wear", None, {"m_per_s": float(wear)})

    def tracked(self, effects: Sequence[Planted]) -> Array:
        """Points (n, 3) m that the tracker would read of its arm."""
        assert self.arm is not None
        return self.arm.points(of_arm(effects))


BlindMachine = TrackerMachine | GrindingMachine
"""A machine of any signals."""


def arm_with_outside(cell: Cell, truth: Truth, targets: Sequence[str]) -> VirtualArm:
    """The arm of a cell, able to carry effects outside the catalogue where the truth holds any; targets: nest of each instant
    that it will be asked for."""
    arm = make_arm(cell, truth)
    if not any(p.effect in OUTSIDE for p in truth.effects):
        return arm
    wrapped = OutsideArm(arm.robot, arm.truth, arm.hardware, arm.reference_C)
    wrapped.cell, wrapped.targets, wrapped.known = cell, tuple(targets), OUTSIDE
    return wrapped


def stream(seed: int, recipe: Recipe, part: int) -> np.random.Generator:
    """Random numbers of a part of a world."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(recipe.index, part)))


def draw_tracker_machine(cell_path: Path, seed: int, recipe: Recipe, readings: int, blind: int) -> TrackerMachine:
    """The machine of a world: `as_real_arms`, but where the recipe asks for one without ripple, play and gross readings."""
    cell = read_cell(cell_path)
    truth = draw_truth(cell, int(stream(seed, recipe, _MACHINE).integers(2**31)), weight_bends="believed")
    own, of_campaign = stream(seed, recipe, _REAL), stream(seed, recipe, _CAMPAIGN)
    if has_background(recipe):
        truth = as_real_arms(truth, own)
        campaign = random_design(cell, of_campaign, readings, warm_up=float(own.uniform(*WARM_UP)))
    else:
        truth = replace(truth, ripple=truth.ripple * [0.0, 1.0, 1.0], play=np.zeros(6), outliers=0.0)
        campaign = random_design(cell, of_campaign, readings)
    sealed = sealed_design(cell, stream(seed, recipe, _SEALED), blind)
    return TrackerMachine(cell, truth, campaign, sealed, ARM_PLAY if has_background(recipe) else 0.0)


def as_real_arms(truth: Truth, rng: np.random.Generator) -> Truth:
    """The machine with weights off as a maker's and a shop's are, several lines of ripple a gear, and readings with tails; play
    and gross readings are drawn."""
    z = np.clip(rng.normal(size=(7, 4)), -2.5, 2.5)
    ripple = np.zeros((6, GEAR_LINES[1], 3))
    for gear in ripple:
        lines = int(rng.integers(GEAR_LINES[0], GEAR_LINES[1] + 1))
        gear[:lines, 0] = rng.uniform(*GEAR_RIPPLE) * np.sqrt(rng.dirichlet(np.ones(lines)))
        gear[:lines, 1] = rng.choice(np.arange(*GEAR_ORDERS), lines, replace=False)
        gear[:lines, 2] = rng.uniform(0, 2 * np.pi, lines)
    payloads = {name: (mass * (1 + PAYLOAD_MASS * rng.uniform(-1, 1)), centre) for name, (mass, centre) in truth.payloads.items()}
    return replace(
        truth,
        mass_scale=1 + LINK_MASS * z[:, 0],
        mass_shift=LINK_CENTRE * z[:, 1:],
        payloads=payloads,
        ripple=ripple,
        tails=TAILS,
    )


def has_background(recipe: Recipe) -> bool:
    """Whether a machine has what real ones have under no name."""
    return recipe.kind != "none"


def draw_grinding_machine(
    cell_path: Path, seed: int, recipe: Recipe, readings: int, blind: int, tracker: bool
) -> GrindingMachine:
    """The machine of a force world; `tracker`: measured by a tracker too. Contacts that it meets first are kept in the check's
    folder."""
    cell = read_cell(cell_path)
    arm = draw_tracker_machine(cell_path, seed, recipe, readings, blind)
    piece = cell.workpiece
    assert piece.stl is not None
    blade, lines = blade_lines(piece.stl, piece.stl_unit, cell_path)
    file = cell_path.parent / STORE
    tables = store_of(file, lambda: make_tables(cell, blade))
    before = len(tables.nodes)
    restless = has_background(recipe)
    truth = _own(arm.truth, stream(seed, recipe, _OWN), restless)
    joints = taught(lines, cell, truth, make_arm(cell, truth), stream(seed, recipe, _TAUGHT))
    rng = stream(seed, recipe, _RUNS)
    runs, sealed = drawn_runs(rng, cell.process.force, cell.wheel.belt_speed)
    own = stream(seed, recipe, _NOISE)
    made = GrindingMachine(
        bench=Bench(cell, blade, lines, joints, tables),
        truth=truth,
        rows=rows_of_runs(lines, runs),
        sealed=rows_of_runs(lines, sealed),
        background=restless,
        gains=(SHEAR_GAIN_SD * own.normal(), SHEAR_ZERO_SD * own.normal()),
        warming=WARMING / HOURS * float(own.uniform()) * (recipe.index % 2),
        # At the stops of a tracker's campaign the same arm repeats as it does there.
        arm=replace(arm, truth=replace(truth, repeatability=REPEATABILITY), play=PLAY * restless) if tracker else None,
        seed=int(own.integers(2**31)),
    )
    made.bare  # noqa: B018 (fills the store)
    made.log((), sealed=True)
    save_store(file, tables, before)
    return made


def _own(truth: Truth, rng: np.random.Generator, restless: bool) -> Truth:
    """The arm's truth with the contact as its makers leave it."""
    z = np.clip(rng.normal(size=5), -2.5, 2.5)
    return replace(
        truth,
        effects=(),
        cover_scale=1 + STIFF_SD * z[0],
        blade_scale=1 + STIFF_SD * z[1],
        flange_scale=1 + STIFF_SD * z[2],
        flange_offset=SETPOINT_SD * z[3],
        sensor_bias=ZERO_SD * z[4],
        repeatability=RESTLESS if restless else REPEATS,
        play=rng.uniform(0, PLAY, 6) * restless,
        ripple=truth.ripple[:, :1] * [0.0, 1.0, 1.0] + [RIPPLE * restless, 0.0, 0.0] * rng.uniform(0, 1, (6, 1, 1)),
    )
