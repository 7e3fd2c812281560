"""Grinding logs with planted effects, by formulas of their own: contacts solved directly, elementary kinematics,
plain arithmetic.

The contact force of every row is tabulated over an extra overlap by the verification's route (`force_world`), so that an effect
costs an interpolation. Nothing here imports the diagnosis or its effects.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from ocp.model.prepare import wheel_cover
from ocp.plan.second_route import verify_pass
from robots.reference_kinematics import elementary_forward
from tests.support.force_world import FINE, OVERLAP, World, correlated, make_world, taught_joints, true_cell

Array = np.ndarray
OFFSETS = np.array([-0.35e-3, 0.0, 0.15e-3])  # m of extra overlap in the table
SHEAR_NOISE = 0.3  # N, white


@dataclass(frozen=True)
class Pass:
    """A recording: line (index), setpoint N, belt m/s, feed m/s, travel +1 or -1 along s, in contact or in the air, seconds of
    pause before it."""

    line: int
    setpoint: float = 20.0
    belt: float = 20.0
    feed: float = 0.04
    travel: int = 1
    contact: bool = True
    pause: float = 30.0


PLAN = (
    Pass(0),
    Pass(0, travel=-1),
    Pass(1),
    Pass(0, contact=False),
    Pass(1, feed=0.02),
    Pass(0, setpoint=12.0),
    Pass(1, setpoint=30.0),
    Pass(1, belt=-20.0),
    Pass(0, pause=1200.0),
    Pass(1, contact=False),
)


@dataclass(frozen=True)
class Base:
    """Rows of a campaign without any effect: columns by name (SI), and the force table (n, offsets) N."""

    world: World
    columns: dict[str, Array]
    table: Array
    rng: np.random.Generator = field(repr=False)

    def __len__(self) -> int:
        return len(self.table)

    def force(self, extra: Array) -> Array:
        """Contact force (n,) N with extra overlap (n,) m, zero in the air."""
        at = np.clip(np.searchsorted(OFFSETS, extra, "right") - 1, 0, len(OFFSETS) - 2)
        a, b, c, d = PchipInterpolator(OFFSETS, self.table, axis=1).c[:, at, np.arange(len(self))]
        x = extra - OFFSETS[at]
        out = ((a * x + b) * x + c) * x + d
        return np.where(self.columns["contact"] > 0, out, 0.0)


@dataclass(frozen=True)
class Planted:
    """What an effect does, as functions of the columns: overlap m, reading (columns, F) -> N of fn, late s, dmu (ft alone)."""

    overlap: Callable[[Base], Array] | None = None
    reading: Callable[[dict[str, Array], Array], Array] | None = None
    late: float = 0.0


def believed_world(folder: Path, rng: np.random.Generator, changes: dict[str, str] | None = None, every: int = 2) -> World:
    """A world whose registration and arm are off as their priors say, and whose stiffnesses, setpoint and sensor are as the cell
    believes: what they are off by is an effect. Every other waypoint: the force is smooth."""
    drawn = make_world(folder, rng, changes)
    stiffness = drawn.injected["blade_stiffness_scale"]
    kept = {k: v for k, v in drawn.injected.items() if k.startswith(("wheel_", "blade_")) and "scale" not in k}
    own = {"cover_stiffness_scale": 0.0, "blade_stiffness_scale": 0.0, "sensor_bias": 0.0, "flange_setpoint_offset": 0.0}
    flange = drawn.cell.flange.stiffness if drawn.cell.flange is not None else 1.0
    truth = true_cell(drawn.cell, kept | own | {"flange_stiffness": flange})
    give = [c * (1.0 + stiffness) for c in drawn.give]
    return _thinned(replace(drawn, truth=truth, cover=wheel_cover(truth, FINE), give=give, injected=kept), every)


def _thinned(world: World, every: int) -> World:
    paths, give = [], []
    for path, c in zip(world.paths, world.give, strict=True):
        at = np.arange(0, len(path.s), every)
        along = {k: v[at] for k, v in vars(path).items() if isinstance(v, np.ndarray) and len(v) == len(path.s)}
        paths.append(replace(path, **along))
        give.append(c[at])
    return replace(world, paths=paths, give=give)


def record(world: World, plan: tuple[Pass, ...], rng: np.random.Generator, step: float = 0.01) -> Base:
    """The campaign: joints taught on the machine with 0.05 mm scatter a run, forces tabulated."""
    parts: list[dict[str, Array]] = []
    tables, clock = [], 0.0
    ground: dict[int, int] = {}
    for number, run in enumerate(plan):
        clock += run.pause
        columns, table = _recorded(world, run, rng, step)
        n = len(table)
        columns |= {
            "run": np.full(n, number),
            "clock": clock + columns["time"],
            "ground_before": np.full(n, ground.get(run.line, 0)),
            "setpoint": np.full(n, run.setpoint),
            "feed": np.full(n, run.feed),
            "belt": np.full(n, run.belt),
            "line": np.full(n, world.paths[run.line].line),
            "contact": np.full(n, int(run.contact)),
        }
        columns["wheel_temperature"] = 35.0 - 12.0 * np.exp(-columns["clock"] / 500.0)
        clock = float(columns["clock"][-1])
        if run.contact:
            ground[run.line] = ground.get(run.line, 0) + 1
        parts.append(columns)
        tables.append(table)
    return Base(world, {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}, np.concatenate(tables), rng)


def _recorded(world: World, run: Pass, rng: np.random.Generator, step: float) -> tuple[dict[str, Array], Array]:
    path, truth = world.paths[run.line], replace(world.truth, wheel=replace(world.truth.wheel, belt_speed=run.belt))
    q = taught_joints(world, path, OVERLAP * (run.setpoint / 20.0) ** 0.7 + 5e-5 * rng.normal())
    if truth.flange is not None:
        wanted = truth.flange.setpoint + run.setpoint - world.cell.flange.setpoint
        truth = replace(truth, flange=replace(truth.flange, setpoint=wanted))
    forces = np.zeros((len(path.s), len(OFFSETS)))
    if run.contact:
        given = replace(path, force=np.full(len(path.s), run.setpoint))
        for k, x in enumerate(OFFSETS):
            larger = replace(truth, wheel=replace(truth.wheel, radius=truth.wheel.radius + x))
            args = (world.cover, world.cloud, given, world.give[run.line], 0.01 * np.arange(len(q)), q, path.s)
            forces[:, k] = verify_pass(larger, world.arm, *args).force
    length = path.s[-1] - path.s[0]
    time = np.arange(0.0, length / run.feed, step)
    s = path.s[0] + run.feed * time if run.travel > 0 else path.s[-1] - run.feed * time
    along = {k: CubicSpline(path.s, v)(s) for k, v in (("q", q), ("p", path.p), ("n", path.n), ("t", path.t), ("F", forces))}
    table = along.pop("F")
    for k in ("n", "t"):
        along[k] /= np.linalg.norm(along[k], axis=1, keepdims=True)
    along["t"] = along["t"] * run.travel
    return along | {"time": time, "s": s}, table


def log_of(base: Base, planted: tuple[Planted, ...] = (), outliers: float = 0.0) -> tuple[list[list[object]], Array]:
    """Rows of a force.csv (HEADER) with the effects planted, and the noise-free normal readings (n,) N."""
    c, rng = base.columns, base.rng
    extra = np.zeros(len(base))
    for one in planted:
        extra += 0.0 if one.overlap is None else one.overlap(base)
    F = base.force(extra)
    fn = F.copy()
    for one in planted:
        fn += 0.0 if one.reading is None else one.reading(c, F)
    ft = base.world.truth.wheel.friction * np.sign(c["belt"]) * F
    for one in planted:
        if one.late:
            for r in np.unique(c["run"]):
                at = np.flatnonzero(c["run"] == r)
                fn[at], ft[at] = (np.interp(c["time"][at] - one.late, c["time"][at], x[at]) for x in (fn, ft))
    noise = np.concatenate([correlated(rng, int((c["run"] == r).sum()), 0.2) for r in np.unique(c["run"])])
    wild = rng.uniform(size=len(base)) < outliers
    noise = noise + wild * rng.normal(size=len(base)) * 3.0
    shear = ft + SHEAR_NOISE * rng.normal(size=len(base))
    rows = [
        [
            int(c["run"][k]),
            f"{c['time'][k]:.3f}",
            f"{c['clock'][k]:.3f}",
            *(f"{a:.6f}" for a in np.degrees(c["q"][k])),
            *(f"{1e3 * a:.4f}" for a in c["p"][k]),
            *(f"{a:.6f}" for a in c["n"][k]),
            *(f"{a:.6f}" for a in c["t"][k]),
            f"{1e3 * c['s'][k]:.3f}",
            c["setpoint"][k],
            1e3 * c["feed"][k],
            c["belt"][k],
            int(c["line"][k]),
            int(c["ground_before"][k]),
            int(c["contact"][k]),
            f"{c['wheel_temperature'][k]:.2f}",
            f"{fn[k] + noise[k]:.4f}",
            f"{shear[k]:.4f}",
        ]
        for k in range(len(base))
    ]
    return rows, fn


JOINTS = [f"q{i}_deg" for i in range(1, 7)]
POINT = ["px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz", "s_mm"]
GIVEN = ["setpoint_N", "feed_mm_s", "belt_m_s", "line", "ground_before", "contact", "wheel_temperature_C"]
HEADER = ["run", "time_s", "clock_s", *JOINTS, *POINT, *GIVEN, "fn_N", "ft_N"]


def moved_joints(base: Base, change: Array) -> Array:
    """Extra overlap (n,) m when the joints stand `change` (n, 6) rad elsewhere, by elementary kinematics."""
    truth, robot = base.world.truth, base.world.arm.robot
    distance = []
    for q in (base.columns["q"], base.columns["q"] + change):
        T = elementary_forward(robot, q) @ truth.workpiece.T_flange_blade
        v = np.einsum("nij,nj->ni", T[:, :3, :3], base.columns["p"]) + T[:, :3, 3] - truth.wheel.centre
        distance.append(np.linalg.norm(v - np.outer(v @ truth.wheel.axis, truth.wheel.axis), axis=1))
    return distance[0] - distance[1]
