"""A tracker's readings as somebody sees them who knows the machine: where every reflector stands, how it moves, how it is read.

Everything comes from the virtual cell's own frames and torques (`ocp.simulate.twin`); nothing of the diagnosis' model is used, so
that signatures and detectabilities of the blind check are an independent measure. SI and radians; points in the tracker's axes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ocp.blindtest.worlds.machines import LINK_CENTRE, LINK_MASS, PAYLOAD_MASS, TrackerMachine
from ocp.model.cell import Cell
from ocp.simulate.twin.arm import link_weights, make_arm
from ocp.simulate.twin.machine import GRAVITY
from ocp.simulate.twin.planting import Planted
from ocp.simulate.twin.tracker import TrackerCampaign, instrument_noise, nest_links
from ocp.simulate.twin.truth import MASS_SD, PLACEMENT, REPEATABILITY, STIFFNESS, Truth
from robots.pose import Array, apply, skew

FREE = 1.0  # m, rad: the tracker's place is not known at all
# Instants that can be told apart, orders, nests: how many members of a scanned family are looked at.
GEAR_ORDERS, MOTOR_ORDERS = 298, 2
FEW = {"azimuth_harmonic": 12, "joint_coupling": 5, "load_backlash": 4}  # variants of others that are scanned


@dataclass(frozen=True, eq=False)
class ExactWhitener:
    """The symmetric root of (Sigma + A P A^T)^-1: `raw` makes changes of the readings white as to Sigma (N, ...), then U (N, r)
    and what it takes of each direction (r,)."""

    raw: Callable[..., Array]
    U: Array
    take: Array

    def apply(self, *changes: Array) -> Array:
        """White rows (N, ...) of changes of the readings, one array for each signal."""
        rows = self.raw(*changes)
        flat = rows.reshape(len(rows), -1)
        flat = flat - self.U @ (self.take[:, None] * (self.U.T @ flat))
        return np.asarray(flat.reshape(rows.shape))


def exact_whitener(raw: Callable[..., Array], columns: Array) -> ExactWhitener:
    """`columns` (N, p): white derivatives per one sigma of what machines are drawn with."""
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    keep = s > 1e-9
    return ExactWhitener(raw, U[:, keep], 1.0 - 1.0 / np.sqrt(1.0 + s[keep] ** 2))


@dataclass(frozen=True, eq=False)
class TrackerScene:
    """A campaign on a machine without planted effects.

    links (n, 7, 4, 4) base axes; point (n, 3) m reflectors in the tracker's frame; inner (n, 3) m the same in base axes; carrier
    (n,) link that bears the nest; turn (3, 3) rotation from base to tracker axes; D (n, 3, 6) m/rad derivative of the points in
    the joints' angles (robot's signs); tau (n, 6) N m load torques; warmth (n,) K; play rad: up to which joints are drawn with.
    """

    cell: Cell
    truth: Truth
    campaign: TrackerCampaign
    links: Array
    point: Array
    inner: Array
    carrier: Array
    turn: Array
    D: Array
    tau: Array
    warmth: Array
    play: float

    def __len__(self) -> int:
        return len(self.campaign)

    @cached_property
    def nuisance(self) -> tuple[Array, Array]:
        """`tracker_nuisance`."""
        return tracker_nuisance(self)

    def moved(self, link: int, motion: Array) -> Array:
        """Change (n, 3, m) of the points when link `link` and all that follows it make small motions (n, 6, m): m at that link's
        origin and rad, base axes."""
        arms = self.inner - self.links[:, link, :3, 3]
        shift = motion[:, :3] + np.cross(motion[:, 3:], arms[:, :, None], axisa=1, axisb=1, axisc=1)
        return np.einsum("ij,njm->nim", self.turn, shift) * (self.carrier >= link)[:, None, None]


def scene_of(machine: TrackerMachine) -> TrackerScene:
    """The scene of the campaign to learn from."""
    cell, truth, campaign = machine.cell, machine.truth, machine.campaign
    m, n = campaign.moments, len(campaign)
    settled = make_arm(cell, truth).settled(m)
    links = settled.links
    carrier = nest_links(cell, campaign.targets)
    nests = np.array([truth.nests[name] for name in campaign.targets]).reshape(-1, 3)
    inner = apply(links[np.arange(n), carrier], nests)
    turn = truth.T_tracker_base[:3, :3]
    D = np.empty((n, 3, 6))
    for j in range(6):
        # Joint j + 1 turns about the z axis of the frame before it (docs/architecture.md, MD-H), in the robot's sign.
        axis = cell.robot.sign[j] * links[:, j, :3, 2]
        D[:, :, j] = np.cross(axis, inner - links[:, j, :3, 3]) @ turn.T * (carrier > j)[:, None]
    warmth = m.temperature_C - cell.tables.reference_temperature_C
    point, torque = apply(truth.T_tracker_base, inner), settled.load_torque[:, :6]
    return TrackerScene(cell, truth, campaign, links, point, inner, carrier, turn, D, torque, warmth, machine.play)


@dataclass(frozen=True, eq=False)
class TrackerView:
    """A machine that a tracker measures as an oracle sees it."""

    machine: TrackerMachine
    scene: TrackerScene
    white: ExactWhitener

    @property
    def targets(self) -> tuple[str, ...]:
        """Nests of the campaign."""
        return tuple(dict.fromkeys(self.machine.campaign.targets))

    def signature(self, effects: Sequence[Planted], without: Sequence[Planted] = ()) -> Array:
        """White change (3n,) of the readings from `without` to `effects`."""
        return self.white.apply(self.machine.points(effects) - self.machine.points(without))

    def price(self, effect: str, joint: int | None = None) -> float:
        """What a scanned family pays: 2 ln(variants)."""
        return float(2.0 * np.log(variants(effect, self.scene)))

    def instant(self, planted: Planted, rng: np.random.Generator) -> float | None:
        """None: every effect begins when it was drawn to."""
        return None

    def readings(self, effects: Sequence[Planted], rng: np.random.Generator) -> Array:
        """White readings (3n,): the effects, noise and a machine drawn anew."""
        A, sd = self.scene.nuisance
        drawn = A @ (rng.normal(size=len(sd)) * sd) + drawn_noise(self.scene, rng)
        return self.white.apply(self.machine.points(effects) - self.machine.points(()) + drawn)


def tracker_view(machine: TrackerMachine) -> TrackerView:
    """Of a machine."""
    scene = scene_of(machine)
    return TrackerView(machine, scene, tracker_whitener(scene))


def tracker_root(scene: TrackerScene) -> Array:
    """Inverse roots (n, 3, 3) of the covariance of each reading."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(point_covariance(scene))))


def drawn_noise(scene: TrackerScene, rng: np.random.Generator) -> Array:
    """Noise (n, 3) m of a campaign, none of its readings gross."""
    return np.asarray(np.einsum("nij,nj->ni", np.linalg.cholesky(point_covariance(scene)), rng.normal(size=(len(scene), 3))))


def white_points(W: Array, changes: Array) -> Array:
    """White rows (3n, ...) of changes (n, 3, ...) m."""
    n = len(changes)
    return np.asarray((W @ changes.reshape(n, 3, -1)).reshape(3 * n, *changes.shape[2:]))


def tracker_whitener(scene: TrackerScene) -> ExactWhitener:
    """With the variances that machines are drawn with."""
    A, sd = scene.nuisance
    W = tracker_root(scene)
    return exact_whitener(partial(white_points, W), white_points(W, A) * sd)


def point_covariance(scene: TrackerScene) -> Array:
    """Covariance (n, 3, 3) m^2 of the readings: the instrument's directions, for noise with tails as wide as the normal one that
    says as much of a place (Lange et al. 1989); repeatability through the Jacobian; ripples of a gear, each of an order nobody
    knows, scatter like joint noise."""
    along, per_metre = instrument_noise(scene.cell)
    distance = np.linalg.norm(scene.point, axis=1)
    beam = scene.point / distance[:, None]
    across = (along + per_metre * distance) ** 2
    own = across[:, None, None] * np.eye(3) + (along**2 - across)[:, None, None] * beam[:, :, None] * beam[:, None, :]
    tails = scene.truth.tails
    own *= 1.0 if np.isinf(tails) else (tails + 5.0) / (tails + 3.0)
    joints = REPEATABILITY**2 + 0.5 * (scene.truth.ripple[:, :, 0] ** 2).sum(axis=1)
    return np.asarray(own + (scene.D * joints) @ np.swapaxes(scene.D, 1, 2))


def tracker_nuisance(scene: TrackerScene) -> tuple[Array, Array]:
    """Derivatives (n, 3, p) of the points and one sigma (p,) of what a machine is drawn with: the tracker's place, the placement
    of every link, nests, springs, masses; where weights are as real ones are, their centres and payloads; play."""
    n = len(scene)
    frame = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), -skew(scene.point)], axis=2)
    parts = [(frame, [FREE] * 6)]
    for link in range(1, 7):
        R = scene.links[:, link, :3, :3]
        motion = np.zeros((n, 6, 6))
        motion[:, :3, :3] = motion[:, 3:, 3:] = R
        parts.append((scene.moved(link, motion), np.repeat(PLACEMENT, 3).tolist()))
    table = scene.cell.tables.tracker
    for name in dict.fromkeys(scene.campaign.targets):
        own = np.array([t == name for t in scene.campaign.targets])
        R = scene.links[np.arange(n), scene.carrier, :3, :3]
        parts.append((scene.turn @ R * own[:, None, None], [1e-3 * (table.target_sd_mm if table is not None else 1.0)] * 3))
    truth, moments = scene.truth, scene.campaign.moments
    compliance = weight_compliance(truth)
    parts.append((scene.D * (scene.tau * compliance)[:, None, :], [STIFFNESS / np.sqrt(3.0)] * 6))
    torque, sds = weight_nuisance(scene.cell, truth, scene.links, moments.payload)
    parts.append((np.einsum("nij,njk->nik", scene.D * compliance, torque), sds))
    if scene.play:
        parts.append((scene.D * moments.approach[:, None, :], [scene.play / np.sqrt(3.0)] * 6))
    return np.concatenate([block for block, _ in parts], axis=2), np.concatenate([sd for _, sd in parts])


def weight_nuisance(cell: Cell, truth: Truth, links: Array, payload: tuple[str, ...]) -> tuple[Array, list[float]]:
    """Torques (n, 6, p) N m about the joints, along +q, of what may weigh otherwise in frames links (n, 7, 4, 4), and one sigma
    of each: masses of base and links, relative; where weights are as real ones are, links' centres and payloads, in sigmas."""
    n, robot, real = len(links), cell.robot, bool(truth.mass_shift.any())
    axis = robot.sign[:, None] * links[:, :6, :3, 2]
    pull, (mass, centre) = GRAVITY * robot.gravity_direction, link_weights(robot, truth)

    def turned(link: int, arm: Array, kg: float) -> Array:
        """By kg on link `link`, arm (n, 6 or 1, 3) m from the joints' axes."""
        return np.einsum("nji,nji->nj", axis, np.cross(arm, kg * pull)) * (np.arange(6) < link)

    def from_axes(link: int, place: Array) -> Array:
        return apply(links[:, link], np.tile(place, (n, 1)))[:, None] - links[:, :6, :3, 3]

    columns = [turned(link, from_axes(link, centre[link]), robot.link_mass[link]) for link in range(7)]
    sd = [LINK_MASS if real else MASS_SD] * 7
    if real:
        shift = LINK_CENTRE * links[:, :, None, :3, :3]
        columns += [turned(link, shift[:, link, :, :, k], mass[link]) for link in range(1, 7) for k in range(3)]
        label = np.array(payload)
        for name, (kg, place) in truth.payloads.items():
            heavier = turned(6, from_axes(6, place), kg * PAYLOAD_MASS / np.sqrt(3.0))
            columns.append(heavier * (label == name)[:, None])
        sd += [1.0] * (len(columns) - 7)
    return np.stack(columns, axis=2), sd


def weight_compliance(truth: Truth) -> Array:
    """rad/(N m) (6,) of the joints that weight bends."""
    k = truth.stiffness
    return np.asarray(np.divide(1.0, k, out=np.zeros(6), where=k > 0) * truth.bends)


def variants(effect: str, scene: TrackerScene) -> int:
    """How many members of a scanned family are looked at: orders, instants, nests; 1 for effects of one form."""
    nests = len(set(scene.campaign.targets))
    counts = {"gear_harmonic": GEAR_ORDERS, "motor_harmonic": MOTOR_ORDERS} | FEW
    return (counts | {"base_tilt": len(scene), "target_shift": nests * len(scene)}).get(effect, 1)
