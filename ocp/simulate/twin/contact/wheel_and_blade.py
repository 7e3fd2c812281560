"""What happens to wheel and belt: stiffness, law, radius, pushes, friction; and to the blade: its surface, its clamp, where it
sits, and how far it and the arm give way under the contact.

Effects are the catalogue's (docs/effects.md); compliances per newton, along the wheel's direction into the blade.
"""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.contact.blade.compliance import HeldBlade, blade_compliance
from ocp.contact.blade.elasticity import Material
from ocp.model.cell import Cell, Workpiece
from ocp.simulate.twin.contact import ContactMoments, Index
from ocp.simulate.twin.contact.surface import Postures
from ocp.simulate.twin.contact.table import SolvedStations
from ocp.simulate.twin.truth import Truth
from robots.pose import Array, make_transform
from trajectories.blade import Blade

LAW_CENTRE = 20.0  # N, the catalogue's wheel_law turns the curve about this force
SPLICE_SHARE = 0.1  # of the belt's revolution that a splice takes under the wheel, as a raised cosine


def _warmer(cell: Cell, c: ContactMoments) -> Array:
    """Wheel temperature over the reference, K; 0 where none is given."""
    return np.nan_to_num(c.wheel_temperature_C - cell.tables.reference_temperature_C)


def modulus_factor(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """Cover's force over the believed one at the same indentation (n,): truth's scale, wheel_stiffness, wheel_temperature."""
    factor = np.full(len(c.s), truth.cover_scale * (1 + truth.total("wheel_stiffness", "scale")))
    for effect in truth.planted("wheel_temperature"):
        factor *= np.maximum(1 + effect.number("per_K") * _warmer(cell, c), 0.05)
    return factor


def radius_change(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """Radius over the cell's (n,) m: truth's, wear with the clock (contact time where there is none), heat, run-out."""
    worn = np.where(np.isfinite(c.clock_s), c.clock_s, _contact_time(c))
    change = (
        truth.wheel_radius
        + truth.total("wheel_temperature", "radius_per_K") * _warmer(cell, c)
        - truth.total("wheel_wear", "m_per_s") * worn
    )
    for effect in truth.planted("wheel_runout"):
        turned = belt_travel(c) / cell.wheel.radius
        change += effect.number("m") * np.cos(turned + effect.number("phase_rad"))
    return change


def _contact_time(c: ContactMoments) -> Array:
    """Time spent in contact since the first row (n,) s, over all runs."""
    total, spent = 0.0, np.zeros(len(c.s))
    for run in c.runs():
        step = np.diff(c.time_s[run], prepend=c.time_s[run][0]) * c.contact[run]
        spent[run] = total + np.cumsum(step)
        total = float(spent[run][-1])
    return spent


def belt_travel(c: ContactMoments) -> Array:
    """Way of the belt since the run's time zero (n,) m; the speed between two rows is that of the later one."""
    way = np.zeros(len(c.s))
    for run in c.runs():
        time, speed = c.time_s[run], c.belt[run]
        way[run] = speed[0] * time[0] + np.concatenate([[0.0], np.cumsum(speed[1:] * np.diff(time))])
    return way


def friction(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """Signed tangential over normal force (n,) along axis x outward radial; none where the belt stands."""
    size = cell.wheel.friction + truth.total("tangential_force", "dmu")
    return np.asarray(max(size, 0.0) * np.sign(c.belt))


def push(truth: Truth, crowding: Array) -> Array:
    """Force of the tight belt beside the cover's (n,) N wherever there is contact; crowding (n,) is 0..1."""
    return np.asarray(truth.total("belt_tension", "N") * crowding)


def knocked(truth: Truth, c: ContactMoments, force: Array) -> Array:
    """Normal force (n,) N with the splice's knocks on it, N high wherever there is contact.

    A knock lasts a tenth of the belt's turn, some 10 ms: too short for a flange of a few hertz, whose carried mass stands
    still meanwhile, so that all of it is felt.
    """
    total = np.array(force, float)
    for effect in truth.planted("belt_splice"):
        turn = np.mod(effect.number("hz") * c.time_s + 0.5, 1.0) - 0.5
        bump = np.where(np.abs(turn) < 0.5 * SPLICE_SHARE, 0.5 + 0.5 * np.cos(2 * np.pi * turn / SPLICE_SHARE), 0.0)
        total += effect.number("N") * bump * (c.belt != 0) * (force > 0)
    return total


REMOVAL_FEED = 0.04  # m/s, the catalogue's material_removal holds at this feed
SLOWEST = 0.01  # m/s: a slower feed, as where a pass begins, removes no more
LEVER = 0.06  # m from the clamp's plane at which clamp_compliance is given
WAVES, SHORTEST, LONGEST = 3, 0.025, 0.12  # m: waves of the stock's profile
_STOCK_STREAM = 20_419  # keeps the profile's random numbers apart from others of the same seed


def surface_change(truth: Truth, c: ContactMoments) -> Array:
    """How far the ground surface stands out over the nominal one along its normal (n,) m: stock left, less what was removed."""
    feed = np.maximum(np.nan_to_num(c.feed, nan=REMOVAL_FEED), SLOWEST)
    change = -truth.total("material_removal", "m_per_pass") * np.nan_to_num(c.ground_before) * REMOVAL_FEED / feed
    for effect in truth.planted("stock_profile"):
        for line in np.unique(c.line[c.contact]):
            rows = c.contact & (c.line == line)
            change[rows] += effect.number("m") * profile(truth.seed, int(line), c.s[rows])
    return change


def profile(seed: int, line: int, s: Array) -> Array:
    """Smooth random profile of rms 1 along a line, fixed by seed and line: a few waves of random length and phase."""
    rng = np.random.default_rng([_STOCK_STREAM, seed, line])
    length = np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST), WAVES))
    phase = rng.uniform(0, 2 * np.pi, WAVES)
    return np.asarray(np.sqrt(2 / WAVES) * np.cos(2 * np.pi * s[:, None] / length + phase).sum(axis=1))


def blade_stiffness(truth: Truth) -> float:
    """Stiffness of the blade's solid over the believed one."""
    return truth.blade_scale * (1 + truth.total("blade_stiffness", "scale"))


def clamp_compliance(truth: Truth, cell: Cell, p: Array) -> Array:
    """Of the clamp (n,) m/N at contacts p (n, 3): the fixture's spring, and the planted lever with the distance squared."""
    piece = cell.workpiece
    height = np.maximum(p @ piece.clamp_normal - piece.clamp_offset, 0.0)
    return 1.0 / piece.clamp_stiffness + truth.total("clamp_compliance", "m_per_N") * (height / LEVER) ** 2


def blade_poses(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """T_base_blade (n, 4, 4): registration as it is, grips changed between runs, slips in the clamp."""
    nominal = cell.workpiece.T_flange_blade
    R = Rotation.from_rotvec(truth.blade_turn).as_matrix() @ nominal[:3, :3]
    shift = np.tile(nominal[:3, 3] + truth.blade_shift, (len(c.s), 1))
    for effect in truth.planted("tool_frame_shift"):
        shift[begun_after(c, effect.number("at_s"))] += effect.vector("m")
    for effect in truth.planted("clamp_slip"):
        direction = _pushed(c, effect.number("at_s"))
        shift[c.campaign_time() >= effect.number("at_s")] += effect.number("m") * (R @ direction)
    return np.asarray(c.T_base_flange @ make_transform(np.broadcast_to(R, (len(c.s), 3, 3)), shift))


def wheel_frames(truth: Truth, cell: Cell, c: ContactMoments) -> tuple[Array, Array]:
    """Centre (n, 3) m and unit axis (n, 3) of the wheel as it is, in the base frame."""
    centre = np.tile(cell.wheel.centre + truth.wheel_shift, (len(c.s), 1))
    for effect in truth.planted("wheel_frame_shift"):
        centre[begun_after(c, effect.number("at_s"))] += effect.vector("m")
    axis = Rotation.from_rotvec(truth.wheel_axis_turn).apply(cell.wheel.axis)
    return centre, np.tile(axis, (len(c.s), 1))


def begun_after(c: ContactMoments, at_s: float) -> Array:
    """Rows (n,) of runs that begin at or after a time of the campaign: frames change between runs, not inside one."""
    late = np.zeros(len(c.s), bool)
    clock = c.campaign_time()
    for run in c.runs():
        late[run] = clock[run][0] >= at_s
    return late


def _pushed(c: ContactMoments, at_s: float) -> Array:
    """Direction (3,) in the blade frame in which the wheel pushes at a time: against the normal of the last contact before it, or
    the first after it."""
    touching = np.flatnonzero(c.contact)
    if not len(touching):
        return np.zeros(3)
    earlier = touching[c.campaign_time()[touching] <= at_s]
    return np.asarray(-c.n[earlier[-1] if len(earlier) else touching[0]])


# Elements larger than the planner's: 0.1 um under 20 N on the bundled blade, and three times faster.
ELEMENT_FACTOR = 1.6
DIGITS_PLACE, DIGITS_DIRECTION = 7, 6  # of what the blade's finite elements are asked: the same line finds its answer on disk


@dataclass(frozen=True)
class SolidLine:
    """Places of one line at which the blade's finite elements are asked: p, n, t (k, 3), s (k,) m."""

    p: Array
    n: Array
    t: Array
    s: Array


def solid_compliance(piece: Workpiece, blade: Blade, stations: SolvedStations, patch: tuple[float, float]) -> Array:
    """c_nn, c_nt, c_nb (stations, 3) m/N of the clamped solid under a patch of semi-axes (along the feed, across) m, as in
    `ocp.contact.blade.compliance`. Raises BadInput as that does."""
    lines = [np.flatnonzero(stations.line == k) for k in np.unique(stations.line)]
    p, s = np.round(stations.p, DIGITS_PLACE), np.round(stations.s, DIGITS_PLACE)
    n, t = np.round(stations.n, DIGITS_DIRECTION), np.round(stations.t, DIGITS_DIRECTION)
    asked = [SolidLine(p[k], n[k], t[k], s[k]) for k in lines]
    material = Material(piece.youngs_modulus, piece.poisson, piece.density)
    held = HeldBlade(blade.vertices, blade.faces, piece.clamp_normal, piece.clamp_offset, material)
    answer = blade_compliance(held, cast(Any, asked), patch, ELEMENT_FACTOR * held.element_size(patch))
    out = np.zeros((len(stations.s), 3))
    for k, values in zip(lines, answer.per_pass, strict=True):
        out[k] = values
    return out


def blade_compliance_along(
    solid: Array, stations: SolvedStations, R: Array, n: Array, t: Array, at: Postures, friction: Array
) -> Array:
    """Displacement (n,) of the contact along -n per newton under the force e + friction x, of the solid's c (stations, 3).

    R (n, 3, 3) turns the blade into the base; by reciprocity a unit force along t moves the contact along -n by c_nt.
    """
    c = (1 - stations.share)[:, None] * solid[stations.left] + stations.share[:, None] * solid[stations.right]
    force = at.e + friction[:, None] * at.x
    normal, feed = np.einsum("kij,kj->ki", R, n), np.einsum("kij,kj->ki", R, t)
    along_n, along_t, along_b = (np.sum(force * axis, axis=1) for axis in (normal, feed, np.cross(normal, feed)))
    return np.asarray(-c[:, 0] * along_n + c[:, 1] * along_t + c[:, 2] * along_b)


def contact_wrench(c: ContactMoments, rows: Index, T_base_blade: Array, at: Postures, friction: Array) -> tuple[Array, Array]:
    """What a newton of normal force does to the flange at its origin, with friction: wrench (n, 6) N, N m, base axes; and the
    lever (n, 3) m from there to the contact."""
    lever = np.einsum("kij,kj->ki", T_base_blade[:, :3, :3], c.p[rows]) + T_base_blade[:, :3, 3] - c.T_base_flange[rows, :3, 3]
    force = at.e + friction[:, None] * at.x
    return np.concatenate([force, np.cross(lever, force)], axis=1), lever


def arm_compliance_along(c: ContactMoments, rows: Index, T_base_blade: Array, at: Postures, friction: Array) -> Array:
    """Displacement (n,) of the contact along e per newton, from the flange's compliance and the lever to the contact."""
    wrench, lever = contact_wrench(c, rows, T_base_blade, at, friction)
    twist = np.einsum("kij,kj->ki", c.arm_compliance[rows], wrench)
    moved = twist[:, :3] + np.cross(twist[:, 3:], lever)
    return np.asarray(np.sum(moved * at.e, axis=1))
