"""A force log as somebody sees it who knows the machine: how readings move with everything that it is drawn with, their noise.

Derivatives are differences of the virtual cell. A small twist of the flange tells most of them: wheel and blade displaced, links
placed otherwise and joints turned are all twists of the flange at its instant, by the machine's own frames. The noise is the
sensor's with its memory, exact for every run. Where a tracker measured the arm too, its readings and the log share placement,
springs, weights and play.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import solve_triangular

from ocp.blindtest.oracle import tracker
from ocp.blindtest.oracle.tracker import FEW, GEAR_ORDERS, MOTOR_ORDERS, ExactWhitener, exact_whitener
from ocp.blindtest.worlds import machines
from ocp.blindtest.worlds.bench import RunRows
from ocp.blindtest.worlds.machines import GrindingMachine
from ocp.blindtest.worlds.recipes import PLANTABLE
from ocp.blindtest.worlds.sealing import log_noise
from ocp.simulate.twin.arm import make_arm
from ocp.simulate.twin.contact.grinder import make_grinder
from ocp.simulate.twin.contact.sensor import SLOW_SHARE, SLOW_TIME
from ocp.simulate.twin.planting import Planted
from ocp.simulate.twin.truth import PLACEMENT, SENSOR_SIGMA, STIFFNESS
from robots.pose import Array

NUDGE, TURN = 2e-5, 4e-5  # m, rad: steps of the differences; the contact is solved to far less
SCALE = 0.01  # relative, of stiffnesses
PUSH = 0.1  # N
SPLICES, RELAXATIONS = 200, 8  # rates of a belt's splice and time constants that a log tells apart
# What each further coefficient of a form costs, of which one is drawn: waves of a profile on every line, harmonics of a splice.
COEFFICIENT, WAVES, HARMONICS = 1.3, 6, 3
FRAME = 6  # columns of the tracker's place, before them
AT = (0.15, 0.9)  # of the campaign's time, when steps happen
WILD = 1.2  # N off beyond which a reading is wild, and left out by the oracle


@dataclass(frozen=True, eq=False)
class ForceSlopes:
    """Derivatives of the readings without noise (2, n, 6): flange per m and rad of its twist about its origin, base axes; joint
    per rad of a joint's angle, robot's sign. frames (n, 7, 4, 4) of the links; torque (n, 6) N m of the
    weight, and `loaded` of weight and contact; compliance (6,) rad/(N m) of
    the joints that weight bends; approach (n, 6)."""

    flange: Array
    joint: Array
    frames: Array
    torque: Array
    loaded: Array
    compliance: Array
    approach: Array

    def of_twists(self, twist: Array) -> Array:
        """Readings (2, n, m) of twists (n, 6, m)."""
        return np.einsum("snk,nkm->snm", self.flange, twist)


def slopes_of(machine: GrindingMachine) -> ForceSlopes:
    """Seven runs of the virtual cell."""
    bare = machine.bare.both
    flange = np.empty((*bare.shape, 6))
    for i in range(6):
        step = NUDGE if i < 3 else TURN
        flange[..., i] = (machine.log((), moved=step * np.eye(6)[i]).both - bare) / step
    still = machine.bench.still(machine.rows, machine.hall(machine.rows))
    settled = make_arm(machine.bench.cell, machine.truth).settled(still)
    frames, sign = settled.links, machine.bench.cell.robot.sign
    axis = sign[:, None] * frames[:, :6, :3, 2]
    arm = frames[:, 6:7, :3, 3] - frames[:, :6, :3, 3]
    turned = np.concatenate([np.cross(axis, arm), axis], axis=2).transpose(0, 2, 1)
    joint = np.einsum("snk,nkm->snm", flange, turned)
    torque = settled.load_torque[:, :6]
    bench, log = machine.bench, machine.bare
    grinder = make_grinder(bench.cell, machine.truth, bench.blade, bench.tables)
    loaded = torque + np.einsum("nij,ni->nj", turned, grinder.wrenches(log.moments, log.result.force))
    return ForceSlopes(flange, joint, frames, torque, loaded, tracker.weight_compliance(machine.truth), still.approach)


def force_nuisance(machine: GrindingMachine, s: ForceSlopes) -> tuple[Array, Array]:
    """Everything that a machine is drawn with, columns (2, n, p) per one sigma: of placement, springs, weights and play of the
    arm, which a tracker sees too, and of all the rest."""
    return _of_arm(machine, s), np.concatenate([*_of_frames(machine, s), *_of_contact(machine, s)], axis=2)


def _of_arm(machine: GrindingMachine, s: ForceSlopes) -> Array:
    n = s.frames.shape[0]
    columns = []
    for link in range(1, 7):
        R = s.frames[:, link, :3, :3]
        lever = s.frames[:, 6, :3, 3] - s.frames[:, link, :3, 3]
        twist = np.zeros((n, 6, 6))
        twist[:, :3, :3] = twist[:, 3:, 3:] = R
        twist[:, :3, 3:] = np.cross(R, lever[:, :, None], axisa=1, axisb=1, axisc=1)
        columns.append(s.of_twists(twist) * np.repeat(PLACEMENT, 3))
    columns.append(s.joint * (s.torque * s.compliance) * STIFFNESS / np.sqrt(3.0))
    still = machine.bench.still(machine.rows, machine.hall(machine.rows))
    torque, sd = tracker.weight_nuisance(machine.bench.cell, machine.truth, s.frames, still.payload)
    columns.append(np.einsum("snj,njk->snk", s.joint * s.compliance, torque) * sd)
    if machine.background:
        columns.append(s.joint * s.approach * machines.PLAY / np.sqrt(3.0))
    return np.concatenate(columns, axis=2)


def _of_frames(machine: GrindingMachine, s: ForceSlopes) -> list[Array]:
    """Wheel and blade displaced and turned."""
    cell = machine.bench.cell
    piece, wheel, n = cell.workpiece, cell.wheel, len(s.frames)
    flange = s.frames[:, 6]
    centre = wheel.centre + machine.truth.wheel_shift
    square = np.eye(3) - np.outer(wheel.axis, wheel.axis)
    lever = flange[:, :3, 3] - centre
    swung = np.cross(square[None], lever[:, :, None], axisa=1, axisb=1, axisc=1)
    turned = np.concatenate([swung, np.broadcast_to(square, (n, 3, 3))], axis=1)
    R = flange[:, :3, :3]
    grip = np.einsum("nij,j->ni", R, piece.T_flange_blade[:3, 3])
    held = np.concatenate([-np.cross(R, grip[:, :, None], axisa=1, axisb=1, axisc=1), R], axis=1)
    return [
        -s.flange[..., :3] * wheel.centre_sd,
        -s.of_twists(turned) * wheel.axis_sd,
        s.of_twists(np.concatenate([R, np.zeros((n, 3, 3))], axis=1)) * piece.xyz_sd,
        s.of_twists(held) * piece.abc_sd,
    ]


def _of_contact(machine: GrindingMachine, s: ForceSlopes) -> list[Array]:
    """Stiffnesses, setpoint, sensor; how the arm comes back in each run; drift and wear of a background."""
    truth, bare, rows = machine.truth, machine.bare, machine.rows
    columns = []
    for name in ("cover_scale", "blade_scale", "flange_scale"):
        changed = replace(truth, **{name: getattr(truth, name) + SCALE})
        columns.append((machine.log((), truth=changed).both - bare.both) / SCALE * machines.STIFF_SD)
    changed = replace(truth, flange_offset=truth.flange_offset + PUSH)
    columns.append((machine.log((), truth=changed).both - bare.both) / PUSH * machines.SETPOINT_SD)
    one, none = np.ones(len(rows.s)), np.zeros(len(rows.s))
    shear = [np.stack([none, bare.ft * machines.SHEAR_GAIN_SD]), np.stack([none, one * machines.SHEAR_ZERO_SD])]
    columns += [np.stack([one * machines.ZERO_SD, none]), *shear]
    if machine.background:
        worn = machine.log([Planted("wheel_wear", None, {"m_per_s": machines.WEAR})]).both - bare.both
        columns += [np.stack([rows.clock / 3600.0 * machines.DRIFT, none]) / np.sqrt(3.0), worn / np.sqrt(3.0)]
    repeats = np.zeros((*bare.both.shape, 6 * len(rows.runs)))
    for k in range(len(rows.runs)):
        repeats[:, rows.run == k, 6 * k : 6 * k + 6] = s.joint[:, rows.run == k] * truth.repeatability
    return [np.stack(columns, axis=2), repeats]


@dataclass(frozen=True, eq=False)
class ForceView:
    """A grinding machine as an oracle sees it: slopes, whitener, the tracker's view of its arm where there is one."""

    machine: GrindingMachine
    slopes: ForceSlopes
    white: ExactWhitener
    scene: tracker.TrackerScene | None

    @property
    def targets(self) -> tuple[str, ...]:
        """Nests of the tracker's campaign."""
        arm = self.machine.arm
        return ("T1",) if arm is None else tuple(dict.fromkeys(arm.campaign.targets))

    def signature(self, effects: Sequence[Planted], without: Sequence[Planted] = ()) -> Array:
        """White change (N,) of all readings from `without` to `effects`."""
        machine = self.machine
        force = machine.forces(effects) - machine.forces(without)
        if machine.arm is None:
            return self.white.apply(force)
        return self.white.apply(force, machine.tracked(effects) - machine.tracked(without))

    def instant(self, planted: Planted, rng: np.random.Generator) -> float | None:
        """Within the log, unless the tracker's campaign has it too."""
        if self.machine.arm is not None and any(kind.name == planted.effect for kind in PLANTABLE):
            return None
        clock = self.machine.rows.clock
        return float(clock[0] + rng.uniform(*AT) * (clock[-1] - clock[0]))

    def readings(self, effects: Sequence[Planted], rng: np.random.Generator) -> Array:
        """White readings (N,): the effects, the log's own noise without wild readings, a tracker's and a machine drawn anew."""
        drawn = rng.normal(size=len(self.white.take))
        noise = log_noise(self.machine, self.machine.bare)
        force = (noise * (np.abs(noise) < WILD))[..., None]
        points = () if self.scene is None else (tracker.drawn_noise(self.scene, rng)[..., None],)
        y = self.signature(effects) + np.asarray(self.white.apply(force, *points)[:, 0])
        return y + self.white.U @ (np.sqrt(1 - (1 - self.white.take) ** 2) * drawn)

    def price(self, effect: str, joint: int | None = None) -> float:
        """2 ln(variants), and the freedom of forms with many coefficients."""
        lines = len({r.line for r in self.machine.rows.runs})
        more = {"stock_profile": WAVES * lines - 1, "belt_splice": 2 * HARMONICS - 1}.get(effect, 0)
        return float(2.0 * np.log(self.variants(effect, joint)) + COEFFICIENT * more)

    def variants(self, effect: str, joint: int | None) -> int:
        """How many members of a scanned family are looked at."""
        if self.scene is not None and effect not in ("base_tilt",):
            there = tracker.variants(effect, self.scene)
            if there > 1:
                return there
        runs = sum(r.contact for r in self.machine.rows.runs)
        span = float(np.ptp(self.machine.bare.q[:, (joint or 1) - 1]))
        orders = max(2, min(GEAR_ORDERS, round(GEAR_ORDERS * span)))
        counts = {"gear_harmonic": orders, "motor_harmonic": MOTOR_ORDERS, "belt_splice": SPLICES} | FEW
        counts |= {
            "wheel_relaxation": RELAXATIONS,
            "clamp_slip": 2 * runs,
            "tool_frame_shift": runs,
            "wheel_frame_shift": runs,
            "base_tilt": runs,
        }
        return counts.get(effect, 1)


def force_view(machine: GrindingMachine) -> ForceView:
    """Everything that detectabilities on a machine need."""
    slopes = slopes_of(machine)
    scene = None if machine.arm is None else tracker.scene_of(machine.arm)
    found = force_nuisance(machine, slopes)
    raw = partial(white_log, noise_roots(machine.rows), machine.rows, None if scene is None else tracker.tracker_root(scene))
    columns = (np.concatenate(found, axis=2),) if scene is None else _shared(scene, *found)
    return ForceView(machine, slopes, exact_whitener(raw, raw(*columns)), scene)


def white_log(roots: Sequence[Array], rows: RunRows, W: Array | None, force: Array, points: Array | None = None) -> Array:
    """White noise rows (N, ...) of changes (2, n, ...) N and (m, 3, ...) m, the tracker's before the log's."""
    parts = []
    if W is not None:
        assert points is not None
        white = tracker.white_points(W, points)
        parts.append(white.reshape(len(white), -1))
    for signal in force:
        flat = signal.reshape(len(signal), -1)
        parts += [root @ flat[rows.run == k] for k, root in enumerate(roots)]
    found = np.concatenate(parts)
    return np.asarray(found.reshape(len(found), *force.shape[2:]))


def noise_roots(rows: RunRows) -> tuple[Array, ...]:
    """Inverse roots (k, k) of the covariance of each run's noise."""
    made: dict[int, Array] = {}
    found = []
    for k in range(len(rows.runs)):
        time = rows.time[rows.run == k]
        if len(time) not in made:
            lag = np.abs(time[:, None] - time[None])
            S = SENSOR_SIGMA**2 * ((1 - SLOW_SHARE) * np.eye(len(time)) + SLOW_SHARE * np.exp(-lag / SLOW_TIME))
            made[len(time)] = solve_triangular(np.linalg.cholesky(S), np.eye(len(time)), lower=True)
        found.append(made[len(time)])
    return tuple(found)


def _shared(scene: tracker.TrackerScene, arm: Array, rest: Array) -> tuple[Array, Array]:
    """Columns (2, n, p) N and (m, 3, p) m of both signals per one sigma: what a tracker sees alone, what both see, what the
    log sees alone."""
    A, sd = scene.nuisance
    A = A * sd
    nests = 3 * len(dict.fromkeys(scene.campaign.targets))
    both = [*range(FRAME, FRAME + 36), *range(FRAME + 36 + nests, A.shape[2])]
    alone = [i for i in range(A.shape[2]) if i not in both]
    n, m = arm.shape[1], len(A)
    points = np.concatenate([A[:, :, alone], A[:, :, both], np.zeros((m, 3, rest.shape[2]))], axis=2)
    return np.concatenate([np.zeros((2, n, len(alone))), arm, rest], axis=2), points
