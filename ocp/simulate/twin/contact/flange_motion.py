"""The force flange as it moves: a carried mass on a spring between rigid stops, stick friction, a force that is set late, and a
contact that only pushes, so that it may bounce and be lost.

With x the stroke (positive gives way to the wheel), b the way of the arm toward the wheel along the flange's axis, a the share of
that axis in the contact's direction, U what the device sets less what it carries,

    m (x'' - b'') = a F(depth - a x) - U - k x - f Sign(x'),   |x| <= stroke / 2,   Sign(0) = [-1, 1]                     (7)

F is the wheel's and the blade's own curve (eq. 4 without the mount) with a loss of the rubber. Steps are backward Euler's: all
forces are taken at the step's end, so the stiffest contact is stable at any step, sticking and the stops are exact (the unknown
speed of a step is the root of an increasing curve, cut at both), and what such steps damp of themselves is taken off the loss.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.simulate.twin.contact import Index
from ocp.simulate.twin.contact.sensor import behind
from robots.pose import Array

GRAVITY = 9.80665  # m/s^2, standard gravity
STEP = 2.5e-4  # s, longest step; a mass of 2 kg on 110 N/mm swings in 27 ms
# Loss factor of the cover at the frequency at which the mass swings on it: soft rubbers have 0.05 to 0.3.
LOSS = 0.15
# Contact loads, as v = (load / process load)^(2/3), at which a curve is known: 0.005 N between them at the process force.
NODES = np.concatenate([np.linspace(0.0, 1.5, 31), np.linspace(1.6, 4.0, 13), np.linspace(4.5, 14.0, 12)])
PRESSED = 0.5  # N from which on a contact counts as lost when it opens
PUSH_RAMP = 0.05  # of v over which a push of the belt comes on, so that touching is no step


@dataclass(frozen=True)
class MovingDevice:
    """What moves. For each of n lanes: mass kg that it carries, friction N. The same for all: stiffness N/m, half the stroke m;
    bandwidth Hz (None: at once) and delay s of the force it sets; whether it sets off the weight it carries; hanging kg beside
    that; loss of the cover."""

    mass: Array
    friction: Array
    stiffness: float
    half: float
    bandwidth: float | None = None
    delay: float = 0.0
    compensated: bool = True
    hanging: float = 0.0
    loss: float = LOSS

    def preload(self, path: "ClosingPath", lane: int) -> Array:
        """U of (7) (n,) N along a path."""
        weight = self.mass[lane] * GRAVITY * path.down
        command = path.told - weight if self.compensated else path.told
        return set_late(command, path.time, self.bandwidth, self.delay) + weight + self.hanging * GRAVITY * path.down


@dataclass(frozen=True)
class ClosingPath:
    """One motion toward the wheel and away, n samples at equal times, SI.

    time (n,); depth: overlap of the undeformed bodies at stroke 0; along (n,): a of (7); driven (n,): b''; told (n,): force that
    is to be set; down (n,): share of gravity along the flange's axis toward the wheel; closed (n, nodes): depth at which the
    cover carries the loads NODES; load (n, nodes): force there; compliance (n,): of blade, clamp and arm; push (n,) N beside the
    cover's force; solids: share and time of each relaxation; start: stroke at the first sample (None: as it stands free).
    """

    time: Array
    depth: Array
    along: Array
    driven: Array
    told: Array
    down: Array
    closed: Array
    load: Array
    compliance: Array
    push: Array
    solids: tuple[tuple[float, float], ...]
    start: float | None


@dataclass(frozen=True)
class MovedLane:
    """What a lane did at the n samples of its path: force N and stroke m then; mean and most N, share of time in contact and
    number of losses of contact from each sample to the next (0 after the last)."""

    force: Array
    stroke: Array
    mean: Array
    most: Array
    touching: Array
    losses: Index


def set_late(command: Array, time: Array, bandwidth: float | None, delay: float) -> Array:
    """What a device sets (n,) that was told `command` (n,): `delay` s late, behind a first-order low-pass of `bandwidth` Hz
    (None: none); before the first sample it had held that command for ever."""
    late = np.interp(time - delay, time, command)
    return late if bandwidth is None else behind(late, time, 1.0 / (2 * np.pi * bandwidth))


def move(paths: list[ClosingPath], lane: Index, device: MovingDevice) -> list[MovedLane]:
    """Drive all lanes side by side; lane (n,): the path of each."""
    return _Lanes(paths, lane, device).moved()


class _Lanes:
    """Paths laid side by side, the shorter ones going on as they ended."""

    def __init__(self, paths: list[ClosingPath], lane: Index, device: MovingDevice) -> None:
        self.lane, self.device, self.paths = lane, device, paths
        self.count = max(len(path.time) for path in paths)
        dt = float(np.median(np.diff(paths[0].time)))
        self.steps = max(1, int(np.ceil(dt / STEP - 1e-9)))
        self.h = dt / self.steps

        def laid(values: list[Array]) -> Array:
            return np.stack([np.concatenate([v, np.repeat(v[-1:], self.count - len(v), axis=0)]) for v in values], axis=1)

        self.curves = laid([np.stack([path.closed, path.load], axis=1) for path in paths])
        self.springs = laid([np.column_stack([path.compliance, path.push]) for path in paths])
        drives = laid([np.column_stack([path.along, path.driven]) for path in paths])[:, lane]
        self.drives = np.concatenate(
            [drives, laid([device.preload(paths[p], k) for k, p in enumerate(lane)])[:, :, None]], axis=2
        )
        longest = (self.count - 1) * self.steps + 1
        fine = [CubicSpline(p.time, p.depth)(p.time[0] + self.h * np.arange((len(p.time) - 1) * self.steps + 1)) for p in paths]
        self.depth = np.stack([np.append(d, np.full(longest - len(d), d[-1])) for d in fine], axis=1)
        self.solids = paths[0].solids

    def moved(self) -> list[MovedLane]:
        """Step through all samples."""
        n = len(self.lane)
        starts = [self.paths[k].start for k in self.lane]
        free = np.clip(-self.drives[0, :, 2] / self.device.stiffness, -self.device.half, self.device.half)
        self.x, self.v = np.array([f if s is None else s for s, f in zip(starts, free, strict=True)]), np.zeros(n)
        self.relaxed, self.rows = np.zeros((len(self.solids), n)), np.arange(n)
        out = {name: np.zeros((self.count, n)) for name in ("force", "stroke", "mean", "most", "touching")}
        losses, pressed = np.zeros((self.count, n), np.int64), np.zeros(n, bool)
        curve = self._curve(0)
        self.before = self.depth[0][self.lane] - self.drives[0, :, 0] * self.x
        force, self.slope = self._on(curve[:, 0], curve[:, 1], self.before)
        out["force"][0], out["stroke"][0] = force, self.x
        for i in range(self.count - 1):
            following = self._curve(i + 1)
            for j in range(1, self.steps + 1):
                share = j / self.steps
                drive = (1 - share) * self.drives[i] + share * self.drives[i + 1]
                depth = self.depth[i * self.steps + j][self.lane]
                force = self._step((1 - share) * curve + share * following, drive.T, depth)
                out["mean"][i] += force / self.steps
                out["most"][i] = np.maximum(out["most"][i], force)
                out["touching"][i] += (force > 0) / self.steps
                losses[i] += pressed & (force <= 0)
                pressed = (pressed & (force > 0)) | (force > PRESSED)
            out["force"][i + 1], out["stroke"][i + 1] = force, self.x
            self._relax(i + 1)
            curve = self._curve(i + 1) if self.solids else following
        found = []
        for k, end in enumerate(len(self.paths[p].time) for p in self.lane):
            parts = {name: values[:end, k].copy() for name, values in out.items()}
            for name in ("mean", "most", "touching"):
                parts[name][-1] = 0.0
            found.append(MovedLane(**parts, losses=np.append(losses[: end - 1, k], 0)))
        return found

    def _curve(self, i: int) -> Array:
        """Depths and forces (n, 2, nodes) of the contact at sample i, relaxed and pushed as it is now."""
        closed, cover = self.curves[i, self.lane, 0], self.curves[i, self.lane, 1]
        compliance, push = self.springs[i, self.lane].T
        for (g, _), q in zip(self.solids, self.relaxed, strict=True):
            cover = np.maximum(cover - (g * q)[:, None], 0.0)
        load = cover + push[:, None] * np.minimum(NODES / PUSH_RAMP, 1.0)
        return np.stack([closed + load * compliance[:, None], load], axis=1)

    def _relax(self, i: int) -> None:
        """The relaxations follow the cover's elastic force over one sample."""
        if self.solids:
            closed, cover = self._curve(i)[:, 0], self.curves[i, self.lane, 1]
            elastic, _ = self._on(closed, cover, self.before)
            for k, (_, tau) in enumerate(self.solids):
                self.relaxed[k] += (elastic - self.relaxed[k]) * -np.expm1(-self.h * self.steps / tau)

    def _step(self, curve: Array, drive: Array, depth: Array) -> Array:
        """Force (n,) at the end of a step, where curve, drive (a, b'', U) and depth are as given."""
        (a, driven, preload), h, device = drive, self.h, self.device
        closed, load, spring = curve[:, 0], curve[:, 1], device.stiffness
        rate = np.maximum(device.loss * np.sqrt(self.slope * device.mass) - 0.5 * self.slope * h, 0.0) / h
        lossy = load + rate[:, None] * (closed - self.before[:, None])  # below zero it lets go
        # Force missing for the step to end at rest, without the contact and with it; friction holds what it can of the latter.
        free = preload + spring * self.x - device.mass * (self.v / h + driven)
        resting = free - a * self._on(closed, lossy, depth - a * self.x)[0]
        free = free - np.minimum(np.maximum(resting, -device.friction), device.friction)
        # The same for the speeds at which the step ends on each node of the curve: it falls from node to node.
        speeds = ((depth / a - self.x)[:, None] - closed / a[:, None]) / h
        heavy = (device.mass / h + spring * h)[:, None]
        missing = free[:, None] + heavy * speeds - a[:, None] * lossy
        k = np.minimum(np.maximum((missing > 0).sum(axis=1) - 1, 0), len(NODES) - 2)
        low, high = missing[self.rows, k], missing[self.rows, k + 1]
        from_, to = speeds[self.rows, k], speeds[self.rows, k + 1]
        share, pulls = low / (low - high), lossy[self.rows, k]
        pulls = pulls + share * (lossy[self.rows, k + 1] - pulls) <= 0
        speed = np.where(pulls | (missing[:, 0] <= 0), -free / heavy[:, 0], from_ + share * (to - from_))
        moved = np.minimum(np.maximum(self.x + h * speed, -device.half), device.half)
        self.v, self.x = (moved - self.x) / h, moved
        opening, rate = depth - a * self.x, rate * (depth - a * self.x - self.before)
        force, self.slope = self._on(closed, load, opening)
        self.before = opening
        return np.where(force > 0, np.maximum(force + rate, 0.0), 0.0)

    def _on(self, closed: Array, load: Array, opening: Array) -> tuple[Array, Array]:
        """Force and its slope (n,) at depths `opening` of curves (n, nodes): none below the first node, on beyond the last."""
        k = np.minimum(np.maximum((closed <= opening[:, None]).sum(axis=1) - 1, 0), len(NODES) - 2)
        low, base = closed[self.rows, k], load[self.rows, k]
        slope = (load[self.rows, k + 1] - base) / (closed[self.rows, k + 1] - low)
        slope = np.where(opening > closed[:, 0], slope, 0.0)
        return np.maximum(np.where(slope > 0, base, 0.0) + slope * (opening - low), 0.0), slope
