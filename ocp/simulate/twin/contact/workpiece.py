"""What happens to the blade: its surface, its stiffness, its clamp and where it sits (docs/virtual_grinding.md, Effects)."""

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.contact.moments import ContactMoments
from ocp.simulate.twin.truth.machine import Truth
from robots.pose import Array, make_transform

REMOVAL_FEED = 0.04  # m/s, the catalogue's material_removal holds at this feed
SLOWEST = 0.01  # m/s: a slower feed, as where a pass begins, removes no more
LEVER = 0.06  # m from the clamp's plane at which clamp_compliance is given
WAVES, SHORTEST, LONGEST = 3, 0.025, 0.12  # m: waves of the stock's profile
_STOCK_STREAM = 20_419  # keeps the profile's random numbers apart from others of the same seed


def surface_change(truth: Truth, c: ContactMoments) -> Array:
    """How far the ground surface stands out over the nominal one along its normal (n,) m: stock left, less what was removed."""
    change = np.zeros(len(c.s))
    for effect in truth.planted("material_removal"):
        before = np.nan_to_num(c.ground_before)
        change -= (
            effect.number("m_per_pass") * before * REMOVAL_FEED / np.maximum(np.nan_to_num(c.feed, nan=REMOVAL_FEED), SLOWEST)
        )
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
    return float(truth.blade_scale * np.prod([1 + effect.number("scale") for effect in truth.planted("blade_stiffness")]))


def clamp_give(truth: Truth, cell: Cell, p: Array) -> Array:
    """Give of the clamp (n,) m/N at contacts p (n, 3): the fixture's spring, and the planted lever with the distance squared."""
    piece = cell.workpiece
    height = np.maximum(p @ piece.clamp_normal - piece.clamp_offset, 0.0)
    give = np.full(len(p), 1.0 / piece.clamp_stiffness)
    for effect in truth.planted("clamp_compliance"):
        give += effect.number("m_per_N") * (height / LEVER) ** 2
    return give


def blade_poses(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """T_base_blade (n, 4, 4): registration as it is, grips changed between runs, slips in the clamp."""
    nominal = cell.workpiece.T_flange_blade
    R = Rotation.from_rotvec(truth.blade_turn).as_matrix() @ nominal[:3, :3]
    shift = np.tile(nominal[:3, 3] + truth.blade_shift, (len(c.s), 1))
    for effect in truth.planted("tool_frame_shift"):
        shift[after(c, effect.number("at_s"))] += effect.vector("m")
    for effect in truth.planted("clamp_slip"):
        direction = _pushed(c, effect.number("at_s"))
        shift[c.campaign_time() >= effect.number("at_s")] += effect.number("m") * (R @ direction)
    return np.asarray(c.T_base_flange @ make_transform(np.broadcast_to(R, (len(c.s), 3, 3)), shift))


def wheel_frames(truth: Truth, cell: Cell, c: ContactMoments) -> tuple[Array, Array]:
    """Centre (n, 3) m and unit axis (n, 3) of the wheel as it is, in the base frame."""
    centre = np.tile(cell.wheel.centre + truth.wheel_shift, (len(c.s), 1))
    for effect in truth.planted("wheel_frame_shift"):
        centre[after(c, effect.number("at_s"))] += effect.vector("m")
    axis = Rotation.from_rotvec(truth.wheel_axis_turn).apply(cell.wheel.axis)
    return centre, np.tile(axis, (len(c.s), 1))


def after(c: ContactMoments, at_s: float) -> Array:
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
