"""From logs to the model's rows: the blade under every contact point, a wheel law that covers the log, each row's conditions.

Conditions are where along the pass a row stands, which way each axis moves, how long the wheel ran, how warm it is.
`log_conditions` has what the log says; `effect_conditions` completes it by the cell's own, laid out for the effects in the model.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ocp.calibrate.force.blade import Stations, StationsTask, SurfacePoints, points_on_surface, with_indentation_correction
from ocp.calibrate.force.log import Flags, ForceLog, Index
from ocp.calibrate.force.model import CORRECTION, ForceModel, ForceRows
from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.law import WheelLaw
from ocp.contact.wheel.law_fit import FORCE_RANGE, Domain, remembered_law
from ocp.effects.engine.symbolic import CONDITIONS
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell, Workpiece, history_notices
from ocp.model.prepare import typical_patch, wheel_cover
from ocp.model.theta import believed_theta
from ocp.plan.paths import surface_cloud
from ocp.shell.cache import Entry, code_hash, content_key, flattened, rebuilt, remember
from ocp.shell.processes import cores, interrupts_held_back, nothing, workers
from robots.errors import BadInput
from robots.kinematics import forward
from robots.pose import Array, Stacked
from trajectories.blade import AerofoilShape, Blade, find_shape, read_blade

STILL = 1e-4  # rad/s; an axis slower than this stands
# What a log may lack, as `ForceLog` names it.
OPTIONAL = {
    **{"s_mm": "s", "ft_N": "ft", "feed_mm_s": "feed", "belt_m_s": "belt", "line": "line", "ground_before": "ground_before"},
    **{"temperature_C": "temperature", "wheel_temperature_C": "wheel_temperature", "clock_s": "clock"},
}
LEAST_FEED = 1e-3  # m/s; effects divide by the feed


@dataclass(frozen=True)
class LogConditions(Stacked):
    """Of n rows: s m along the pass; travel sign of ds/dt; approach (n, 6) signs of the axes' motion, speed (n, 6) rad/s; feed
    m/s, belt m/s, setpoint N; clock s (contact time so far where the log has none); ground_before; warm, wheel_warm K above the
    cell's reference; run, line; time s in the run. What a log does not say is nan; given: the columns that it has."""

    run: Index
    line: Index
    time: Array
    s: Array
    travel: Array
    approach: Array
    speed: Array
    feed: Array
    belt: Array
    setpoint: Array
    clock: Array
    ground_before: Array
    warm: Array
    wheel_warm: Array
    contact: Flags
    given: frozenset[str]


def log_conditions(cell: Cell, log: ForceLog, used: float = 0.0) -> LogConditions:
    """Conditions of a log's rows; `used` s: how long the wheel ground before it, for logs without a clock."""
    n = len(log)
    s = _along(log) if log.s is None else log.s
    rate_s, rate_q = _rate(log, s[:, None])[:, 0], _rate(log, log.q)
    unknown = np.full(n, np.nan)
    own = cell.flange.setpoint if cell.flange is not None else cell.process.force
    setpoint = log.setpoint if log.setpoint_sd is None else None
    optional = {column: getattr(log, name) for column, name in OPTIONAL.items()} | {"setpoint_N": setpoint}
    given = frozenset({"time_s", "approach", "speed", *(name for name, column in optional.items() if column is not None)})
    if len(log.sessions) > 1:
        given |= {"session"}
    reference = cell.tables.reference_temperature_C
    return LogConditions(
        run=log.run,
        line=np.zeros(n, np.int64) if log.line is None else log.line,
        time=log.time,
        s=s,
        travel=np.where(rate_s < 0, -1.0, 1.0),
        approach=np.where(np.abs(rate_q) > STILL, np.sign(rate_q), 0.0),
        speed=rate_q,
        feed=np.abs(rate_s) if log.feed is None else log.feed,
        belt=np.full(n, cell.wheel.belt_speed) if log.belt is None else log.belt,
        setpoint=np.full(n, own) if log.setpoint is None else log.setpoint,
        clock=used + _contact_time(log) if log.clock is None else log.clock,
        ground_before=unknown if log.ground_before is None else log.ground_before.astype(float),
        warm=unknown if log.temperature is None else log.temperature - reference,
        wheel_warm=unknown if log.wheel_temperature is None else log.wheel_temperature - reference,
        contact=log.contact,
        given=given,
    )


def _along(log: ForceLog) -> Array:
    """Arc length (n,) m from the end of the pass that lies lowest along the blade's longest direction."""
    centred = log.p - log.p.mean(axis=0)
    span = np.linalg.svd(centred[:: max(1, len(centred) // 500)], full_matrices=False)[2][0]
    span = span * np.sign(span[int(np.argmax(np.abs(span)))])
    s = np.zeros(len(log))
    for run in np.unique(log.run):
        at = np.flatnonzero(log.run == run)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(log.p[at], axis=0), axis=1))])
        up = (log.p[at[-1]] - log.p[at[0]]) @ span >= 0
        s[at] = length if up else length[-1] - length
    return s


def _rate(log: ForceLog, values: Array) -> Array:
    """Time derivative (n, k) inside each run, by central differences."""
    out = np.zeros_like(values)
    for run in np.unique(log.run):
        at = np.flatnonzero(log.run == run)
        if len(at) > 1 and np.all(np.diff(log.time[at]) > 0):
            out[at] = np.gradient(values[at], log.time[at], axis=0)
    return out


def _contact_time(log: ForceLog) -> Array:
    """Seconds (n,) in contact since the log's start."""
    step = np.zeros(len(log))
    same = log.run[1:] == log.run[:-1]
    step[1:][same] = np.diff(log.time)[same]
    return np.asarray(np.cumsum(step * log.contact))


def effect_conditions(cell: Cell, log: ForceLog) -> Array:
    """Columns (n, 24) for the model's effects (`ocp.effects.engine.symbolic.CONDITIONS`); (n, 0) for a cell without effects.

    What the log does not say is the cell's `[conditions]`. The stroke rate of the flange is not logged: its friction is left
    out.
    """
    if not cell.effects:
        return np.zeros((len(log), 0))
    own, c = cell.conditions, log_conditions(cell, log, cell.conditions.clock)
    blocks = vars(c) | {
        "time": c.clock,
        "feed": np.maximum(c.feed, LEAST_FEED) if log.feed is None else c.feed,
        "ground_before": float(own.ground_before) if log.ground_before is None else c.ground_before,
        "warm": own.warm if log.temperature is None else c.warm,
        "wheel_warm": own.wheel_warm if log.wheel_temperature is None else c.wheel_warm,
    }
    return CONDITIONS.stack(len(log), blocks)


FAR = 10e-3  # m of overlap or gap between wheel and blade at a row in contact, beyond which cell and log do not belong together
ROOM = (2e-3, 0.01, np.radians(4.0))  # lateral m, tilt, turn rad that the law covers beyond the log's own postures
SAMPLES, HELD_OUT = 700, 120  # direct solutions: a log asks for a narrower law than a plan
KINDS = 400  # curvatures handed to the fit


@dataclass(frozen=True)
class PressedSurface:
    """The cover and the surface of the blade that presses into it; the force (n,) N about which all rows of a setup stand, and by
    how much (n,) m the wheel was larger there."""

    cover: Cover
    cloud: SurfaceCloud
    about: Array
    larger: Array


@dataclass(frozen=True)
class ForceSetup:
    """The model of a cell and its blade that covers some logs, with the rows of each; notices in sentences; None: the model's law
    is the surface."""

    model: ForceModel
    rows: tuple[ForceRows, ...]
    notices: tuple[str, ...]
    surface: PressedSurface | None = field(default=None, repr=False)

    def take(self, kept: Flags) -> "ForceSetup":
        """The first log's rows alone, of them those `kept` (n,)."""
        surface = self.surface
        if surface is not None:
            surface = replace(surface, about=surface.about[: len(kept)][kept], larger=surface.larger[: len(kept)][kept])
        return replace(self, rows=(self.rows[0].take(kept),), surface=surface)

    def with_larger(self, depth: Array) -> "ForceSetup":
        """One log's rows in contact with a wheel that was larger by `depth` (n,) m: as if it gave so much less."""
        waypoint, surface = self.rows[0].waypoint.copy(), self.surface
        waypoint[:, CORRECTION] -= depth
        if surface is not None:
            surface = replace(surface, larger=surface.larger + depth)
        return replace(self, rows=(replace(self.rows[0], waypoint=waypoint),), surface=surface)

    def at(self, theta: Array) -> "ForceSetup":
        """The same where parameters theta (M,) put arm, blade and wheel."""
        if self.surface is None:
            return self
        s, joined = self.surface, ForceRows.joined(list(self.rows))
        plain = joined.waypoint.copy()
        plain[:, CORRECTION] = 0.0
        joined = replace(joined, waypoint=plain)
        whole = with_indentation_correction(self.model, s.cover, s.cloud, joined, s.about, theta)
        waypoint = whole.waypoint.copy()
        waypoint[:, CORRECTION] -= s.larger
        whole = replace(whole, waypoint=waypoint)
        edges = np.cumsum([0, *map(len, self.rows)]).tolist()
        return replace(self, rows=tuple(whole.take(slice(i, j)) for i, j in pairwise(edges)))


def prepare_force(cell: Cell, logs: Sequence[ForceLog]) -> ForceSetup:
    """Model and rows of `logs`, all of one cell (measured and sealed ones together).

    Raises BadInput: no blade, points off its surface, joints that do not bring the blade to the wheel; Infeasible: the
    blade is too hollow for the wheel.
    """
    if cell.workpiece.stl is None:
        raise BadInput(f"{cell.path}: no blade; name it as workpiece.stl, a force log needs the blade's shape")
    blade, shape, cloud = measured_blade(cell.workpiece.stl, cell.workpiece)
    points = [points_on_surface(blade, shape, log) for log in logs]
    poses = [_posture(cell, log, point) for log, point in zip(logs, points, strict=True)]
    touching = np.concatenate([log.contact for log in logs])
    turned, lateral, tilt = (np.concatenate([pose[k] for pose in poses])[touching] for k in range(3))
    cover = wheel_cover(cell)
    p, n, t, curvature = (np.concatenate([getattr(point, k) for point in points])[touching] for k in ("p", "n", "t", "curvature"))
    patch = _rounded(typical_patch(cell, cover, curvature))
    task = StationsTask.of(cell, blade, p, n, t, patch)
    law, stations = _side_by_side(task, lambda: _law(cell, cover, logs, turned, lateral, tilt))
    model = _model_of(cell, law)
    compliance = np.zeros((len(touching), 3))
    compliance[touching] = stations.at(p, n, t)
    parts = np.split(compliance, _cuts(logs))
    rows = tuple(_rows(cell, log, point, c) for log, point, c in zip(logs, points, parts, strict=True))
    told = history_notices(cell, "not taken out of the log")
    notices = (*told, *blade.notices, *shape.notices, *(text for point in points for text in point.notices))
    setup = ForceSetup(model, rows, notices, PressedSurface(cover, cloud, _about(cell, logs, law), np.zeros(len(touching))))
    return setup.at(believed_theta(cell).values)


Measured = tuple[Blade, AerofoilShape, SurfaceCloud]
_LAST: dict[tuple[str, ...], Measured] = {}


def measured_blade(stl: Path, piece: Workpiece) -> Measured:
    """Blade, shape and surface of an STL, kept on disk as long as no code changes; the last one is at hand, for a log and its
    sealed conditions ask one after the other."""
    try:
        read = hashlib.sha256(stl.read_bytes()).hexdigest()
    except OSError:
        read = ""  # the reader says what is wrong with it
    key = (read, stl.name, piece.stl_unit, str(piece.aerofoil))

    def compute() -> Entry:
        blade = read_blade(stl, piece.stl_unit)
        shape = find_shape(blade, piece.aerofoil)
        return flattened((blade, shape, surface_cloud(shape, blade)))

    if key not in _LAST:
        entry = remember("measured-blade", content_key("measured blade 1", code_hash(), *key), compute)
        _LAST.clear()
        _LAST[key] = rebuilt(Measured, entry)
    return _LAST[key]


_LAST_MODEL: list[ForceModel] = []


def _model_of(cell: Cell, law: WheelLaw) -> ForceModel:
    """The model of a cell and a law; the last one is at hand: its functions take a second to write, and sealed conditions ask for
    those of their log wherever its law covers them too."""
    if not (_LAST_MODEL and _LAST_MODEL[0].cell is cell and _content(_LAST_MODEL[0].law) == _content(law)):
        _LAST_MODEL[:] = [ForceModel(cell, law)]
    return _LAST_MODEL[0]


def _content(law: WheelLaw) -> str:
    return content_key(*(part for pair in sorted(flattened(law).items()) for part in pair))


def _cuts(logs: Sequence[ForceLog]) -> NDArray[np.int64]:
    return np.asarray(np.cumsum([len(log) for log in logs])[:-1], np.int64)


def _side_by_side(task: StationsTask, law: Callable[[], WheelLaw]) -> tuple[WheelLaw, Stations]:
    """The wheel's law and the blade's stations, in two processes unless the stations are on disk or there is one core."""
    if task.known or cores() == 1:
        return law(), task.solve()
    with workers(1, nothing) as pool:
        with interrupts_held_back():
            waiting = pool.submit(task.solve)
        made = law()
        return made, waiting.result()


def _rounded(axes: tuple[float, float]) -> tuple[float, float]:
    """Semi-axes of the patch to a quarter of a millimetre: logs of one blade then share its mesh on disk."""
    return max(round(axes[0] / 2.5e-4), 1) * 2.5e-4, max(round(axes[1] / 2.5e-4), 1) * 2.5e-4


def _about(cell: Cell, logs: Sequence[ForceLog], law: WheelLaw) -> Array:
    """Force (n,) N about which rows stand: the setpoint with a flange, else as measured, else as usual in the logs."""
    low, high = law.limits["force"]
    if cell.flange is not None:
        force = np.concatenate([np.full(len(x), cell.flange.setpoint) if x.setpoint is None else x.setpoint for x in logs])
        return np.asarray(np.clip(force, low, high))
    measured = np.concatenate([x.fn for x in logs])
    touching = np.concatenate([x.contact for x in logs]) & np.isfinite(measured)
    usual = float(np.median(measured[touching])) if touching.any() else cell.process.force
    # Steps of 2 N: noise of single readings is no reason to solve another contact.
    return np.asarray(np.clip(2.0 * np.round(np.where(np.isfinite(measured), measured, usual) / 2.0), low, high))


def _rows(cell: Cell, log: ForceLog, point: SurfacePoints, compliance: Array) -> ForceRows:
    own = cell.flange.setpoint if cell.flange is not None else 0.0
    n = len(log)
    setpoint = np.full(n, own) if log.setpoint is None else log.setpoint
    belt = np.sign(np.full(n, cell.wheel.belt_speed) if log.belt is None else log.belt)
    waypoint = np.hstack([point.p, point.n, point.t, point.curvature, compliance, np.zeros((n, 1)), effect_conditions(cell, log)])
    return ForceRows(log.q, waypoint, setpoint, belt, log.contact)


def _posture(cell: Cell, log: ForceLog, point: SurfacePoints) -> tuple[Array, Array, Array]:
    """Blade curvature (n, 3) in the wheel's axes, lateral (n,) m and tilts (n, 2) of the nominal, unbent arm.

    Good to some millimetres and milliradians: enough to say what the law must cover and whether log and cell agree.
    """
    T = forward(cell.robot, log.q) @ cell.workpiece.T_flange_blade
    n, t = (np.einsum("kij,kj->ki", T[:, :3, :3], v) for v in (point.n, point.t))
    v = np.einsum("kij,kj->ki", T[:, :3, :3], point.p) + T[:, :3, 3] - cell.wheel.centre
    axis = cell.wheel.axis
    lateral = v @ axis
    radial = v - lateral[:, None] * axis
    rho = np.linalg.norm(radial, axis=1)
    e = radial / rho[:, None]
    _refuse_far(cell, log, rho, lateral, np.sum(n * e, axis=1))
    belt = np.cross(axis, e)
    b = np.cross(n, t)
    A = np.stack([np.stack([np.sum(t * belt, 1), np.sum(b * belt, 1)], 1), np.stack([t @ axis, b @ axis], 1)], 1)
    k = point.curvature
    K = A @ np.stack([k[:, [0, 2]], k[:, [2, 1]]], 1) @ A.transpose(0, 2, 1)
    tilt = -np.stack([np.sum(n * belt, 1), n @ axis], 1) / np.sum(n * e, axis=1)[:, None]
    return np.stack([K[:, 0, 0], K[:, 1, 1], K[:, 0, 1]], 1), lateral, tilt


def _refuse_far(cell: Cell, log: ForceLog, rho: Array, lateral: Array, facing: Array) -> None:
    """BadInput where rows in contact are nowhere near the wheel."""
    gap = np.abs(rho - cell.wheel.radius)
    wide = np.abs(lateral) > 0.5 * cell.wheel.width + FAR
    bad = log.contact & ((gap > FAR) | wide | (facing > -0.5))
    if not bad.any():
        return
    k = int(np.argmax(bad))
    if gap[k] > FAR:
        how = f"{1e3 * (rho[k] - cell.wheel.radius):.1f} mm off the wheel's surface"
    elif wide[k]:
        how = f"{1e3 * lateral[k]:.1f} mm along the axis from the wheel's middle"
    else:
        how = "with the blade's back to the wheel"
    raise BadInput(
        f"{log.path}, line {log.row[k]}, columns q1_deg to q6_deg: the axes bring the contact point {how} ({int(bad.sum())} such "
        f"rows in contact); give the log that belongs to {cell.path.name}, axes in degrees"
    )


def _law(cell: Cell, cover: Cover, logs: Sequence[ForceLog], turned: Array, lateral: Array, tilt: Array) -> WheelLaw:
    """The wheel's law over the log's postures and forces."""
    forces = np.concatenate([np.concatenate([x[log.contact] for x in (log.setpoint, log.fn) if x is not None]) for log in logs])
    forces = forces[np.isfinite(forces) & (forces > 0)]
    low, high = np.percentile(forces, [5, 99.5]) if len(forces) else (cell.process.force, cell.process.force)
    force = float(np.clip(cell.process.force, high / (0.9 * FORCE_RANGE[1]), max(low, 1.0) / FORCE_RANGE[0]))
    force = max(force, high / FORCE_RANGE[1])
    kinds = np.unique(np.round(turned, 2), axis=0)
    kinds = kinds[:: max(1, len(kinds) // KINDS)]
    # Rounded up, so that logs of one campaign find the same law on disk.
    side = float(np.ceil((np.abs(lateral).max() + ROOM[0]) / 1e-3) * 1e-3)
    slope = float(np.ceil((np.abs(tilt).max() + ROOM[1]) / 0.01) * 0.01)
    domain = Domain(kinds, ROOM[2], min(side, 0.75 * cell.wheel.width), slope, force)
    return remembered_law(cover, domain, SAMPLES, HELD_OUT)
