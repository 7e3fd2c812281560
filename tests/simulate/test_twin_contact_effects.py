"""What every planted effect of contact, reading and timing does to a bar pressed into the virtual wheel."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.contact.grinder import Chain, CoverForce, Mount, solve_chain
from ocp.simulate.twin.contact.sensor import memory
from ocp.simulate.twin.contact.table import LEVELS
from ocp.simulate.twin.contact.wheel_and_blade import profile
from tests.support.twin_grinding import HERTZ_RATE, Bench, moments, moving

Array = np.ndarray
LADDER = np.linspace(1e-4, 1.2e-3, 60)


@pytest.fixture(scope="module")
def soft() -> Bench:
    return Bench(flange=True)


@pytest.fixture(scope="module")
def rigid() -> Bench:
    return Bench(flange=False)


def standing(bench: Bench, overlap: Array, **changes) -> ContactMoments:
    """The same place at growing overlaps, one row a run so that nothing remembers."""
    n = len(overlap)
    return moments(bench.cell, np.full(n, 0.02), overlap, run=np.arange(n), **changes)


def cover_curve(bench: Bench) -> PchipInterpolator:
    """Believed force of the cover over its indentation, from a ladder on a rigid mount."""
    result = bench.force(standing(bench, LADDER))
    return PchipInterpolator(result.indentation, result.force)


def mixed_chain(mount: Mount, depth: Array, give: float = 0.0, solid_wheel: bool = False) -> Chain:
    n = len(depth)
    levels = np.zeros(len(LEVELS)) if solid_wheel else 6e-4 * LEVELS ** (2 / 3)
    none = np.zeros(n)
    return Chain(depth, np.tile(levels, (n, 1)), np.full(n, give), CoverForce(np.full(n, 20.0), 20.0, 1.0, none, none), mount)


def test_a_flange_alone_in_closed_form():
    """A wheel that does not give: depth = stroke n.a + F give inside the stroke, stops beyond."""
    depth = np.array([-1e-3, 0.0, 1e-3, 5e-3, -5e-3])
    along, k, give, preload = 0.9, 5600.0, 2e-5, 20.0
    mount = Mount(np.full(5, along), np.full(5, preload), k, 4e-3, np.zeros(5))
    found = solve_chain(mixed_chain(mount, depth, give, solid_wheel=True))
    free = (depth + preload * along / k) / (along**2 / k + give)
    stopped = (5e-3 - 4e-3 * along) / give
    assert found.force == pytest.approx([*free[:3], stopped, 0.0], rel=1e-9)
    assert found.stroke[:4] == pytest.approx([*((free[:3] * along - preload) / k), 4e-3], rel=1e-9)


def test_the_chain_adds_up(soft):
    """On a flange: overlap = stroke + indentation + F give, and F = setpoint + k stroke."""
    setpoint = np.where(np.arange(60) % 2, 20.0, 31.0)
    result = soft.force(standing(soft, LADDER, setpoint=setpoint), flange_offset=0.2, flange_scale=1.05)
    give = soft.solid[0] + 0.35 * soft.solid[1] * -1  # friction along x, x = -t
    assert result.force == pytest.approx(setpoint + 0.2 + 1.05 * 5600 * result.stroke, abs=1e-6)
    assert result.stroke + result.indentation + give * result.force == pytest.approx(LADDER, abs=1e-9)
    assert result.overlap == pytest.approx(LADDER, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "factor", "power"),
    [("wheel_stiffness=0.2", 1.2, 1.0), ("wheel_law=0.3", 1.0, 1.3), ("wheel_temperature=-0.005", 1 - 0.005 * 18, 1.0)],
)
def test_cover_effects_act_on_the_covers_own_curve(rigid, text, factor, power):
    c = standing(rigid, LADDER, wheel_temperature_C=40.0)
    result = rigid.force(c, text)
    expected = 20 * (factor * cover_curve(rigid)(result.indentation) / 20) ** power
    # The reference curve's own interpolation is the limit at small loads.
    assert result.force[4:-4] == pytest.approx(expected[4:-4], rel=5e-3)
    assert np.abs(result.force - rigid.force(c).force).max() > 1.0


def test_cover_scale_is_exact_in_the_modulus(rigid):
    c = standing(rigid, LADDER)
    softer = rigid.force(c, "wheel_stiffness=-0.2")
    assert softer.force == pytest.approx(rigid.force(c, cover_scale=0.8).force, rel=1e-12)


def shifted_overlap(bench: Bench, c: ContactMoments, text: str, shift: Array | float) -> None:
    """The effect is as if the overlap had grown by `shift`."""
    n = len(c.s)
    R = c.T_base_flange[:, :3, :3]
    into = bench.cell.wheel.contact_direction
    T = c.T_base_flange.copy()
    T[:, :3, 3] -= np.broadcast_to(shift, (n,))[:, None] * into
    expected = bench.force(replace(c, T_base_flange=T))
    result = bench.force(c, text)
    assert np.abs(expected.force - bench.force(c).force).max() > 0.05, "an effect too small to see"
    assert result.force == pytest.approx(expected.force, abs=2e-3)
    assert (R == c.T_base_flange[:, :3, :3]).all()


def test_wear_follows_the_clock_or_the_time_in_contact(soft):
    c = moving(soft)
    clock = 900.0 + c.time_s
    shifted_overlap(soft, replace(c, clock_s=clock), "wheel_wear=3e-7", -3e-7 * clock)
    touching = c.time_s > 0.3
    without = replace(c, contact=touching, time_s=100 * c.time_s)
    spent = np.where(touching, without.time_s - without.time_s[touching][0] + 0.4, 0.0)
    worn = soft.force(without, "wheel_wear=1e-6").overlap[touching]
    assert worn == pytest.approx(6e-4 - 1e-6 * spent[touching], abs=1e-12)


def test_heat_grows_the_radius(soft):
    c = moving(soft, wheel_temperature_C=52.0)
    shifted_overlap(soft, c, "wheel_temperature=0,radius_per_K=5e-6", 30 * 5e-6)


def test_run_out_turns_with_the_wheel(soft):
    c = moving(soft)
    turn = 20.0 * c.time_s / soft.cell.wheel.radius
    shifted_overlap(soft, c, "wheel_runout=5e-5,phase_rad=0.7", 5e-5 * np.cos(turn + 0.7))
    back = replace(c, belt=np.full(len(c.s), -10.0))
    shifted_overlap(soft, back, "wheel_runout=5e-5,phase_rad=0.7", 5e-5 * np.cos(-turn / 2 + 0.7))


def test_removal_counts_grindings_and_feed(soft):
    before = np.repeat([0.0, 1.0, 2.0, 3.0], 15)
    c = replace(standing(soft, np.full(60, 6e-4)), ground_before=before, feed=np.tile([0.02, 0.04, 0.08], 20))
    shifted_overlap(soft, c, "material_removal=4e-5", -4e-5 * before * 0.04 / c.feed)


def test_stock_is_smooth_and_repeats_with_the_blade(soft):
    c = moving(soft)
    shifted_overlap(soft, c, "stock_profile=1e-4", 1e-4 * profile(7, 1, c.s))
    s = np.arange(0, 30, 1e-3)
    assert np.sqrt(np.mean(profile(7, 1, s) ** 2)) == pytest.approx(1.0, abs=0.02)
    assert np.abs(np.diff(profile(7, 1, s))).max() < 0.45
    assert np.abs(profile(7, 1, s) - profile(7, 2, s)).max() > 0.5 and np.abs(profile(8, 1, s) - profile(7, 1, s)).max() > 0.5


def test_frames_move_between_runs(soft):
    run = np.repeat([0, 1, 2], 50)
    c = replace(
        moments(soft.cell, np.tile(np.arange(50) * 1.6e-4, 3), 6e-4, run=run), clock_s=run * 100.0 + np.arange(150) * 0.004
    )
    inside = np.where(run == 2, 2e-4, 0.0)
    # The wheel toward the robot by 0.2 mm, then the flange's z likewise: its frame here is turned against the base's.
    shifted_overlap(soft, c, "wheel_frame_shift=-2e-4/0/0,at_s=100.3", inside)
    R = c.T_base_flange[0, :3, :3]
    m = R.T @ [2e-4, 0, 0]
    shifted_overlap(soft, c, f"tool_frame_shift={m[0]}/{m[1]}/{m[2]},at_s=100.3", inside)


def test_the_blade_slips_away_from_the_wheel_at_a_time(soft):
    c = replace(moving(soft), clock_s=50 + np.arange(250) / HERTZ_RATE)
    shifted_overlap(soft, c, "clamp_slip=1e-4,at_s=50.5", np.where(c.clock_s >= 50.5, -1e-4, 0.0))


def test_registration_turns_are_rotation_vectors(soft):
    """Overlap of a contact beside the wheel's middle, with the wheel's axis and the blade's frame turned."""
    wheel, piece = soft.cell.wheel, soft.cell.workpiece
    c = standing(soft, LADDER)
    T = c.T_base_flange.copy()
    T[:, :3, 3] += 5e-3 * wheel.axis
    c = replace(c, T_base_flange=T)
    turn, held = np.array([2e-3, 0.0, -3e-3]), np.array([1e-3, 2e-3, -1e-3])
    shift, moved = np.array([1e-4, 2e-4, -1e-4]), np.array([2e-4, 1e-4, 3e-4])
    got = soft.force(c, wheel_axis_turn=turn, blade_turn=held, wheel_shift=shift, blade_shift=moved).overlap
    on_flange = Rotation.from_rotvec(held).apply(c.p @ piece.T_flange_blade[:3, :3].T) + piece.T_flange_blade[:3, 3] + moved
    v = np.einsum("kij,kj->ki", T[:, :3, :3], on_flange) + T[:, :3, 3] - wheel.centre - shift
    axis = Rotation.from_rotvec(turn).apply(wheel.axis)
    assert got == pytest.approx(wheel.radius - np.linalg.norm(np.cross(v, axis), axis=1), abs=1e-12)
    assert np.abs(got - soft.force(c, wheel_axis_turn=-turn, blade_turn=held).overlap).max() > 1e-5


def test_the_blades_stiffness_and_its_clamp(rigid):
    c = standing(rigid, LADDER)
    give = rigid.solid[0] - 0.35 * rigid.solid[1]
    stiff = rigid.force(c, "blade_stiffness=0.3", blade_scale=1.1)
    assert stiff.indentation + stiff.force * give / 1.43 == pytest.approx(LADDER, abs=1e-9)
    clamp = rigid.force(c, "clamp_compliance=1e-6")
    lever = 0.04 - rigid.cell.workpiece.clamp_offset  # the contact lies at z = 20 mm + s
    assert clamp.indentation + clamp.force * (give + 1e-6 * (lever / 0.06) ** 2) == pytest.approx(LADDER, abs=1e-9)


def test_the_arm_gives_way_with_its_lever(rigid):
    c = standing(rigid, LADDER)
    spring = np.zeros((6, 6))
    spring[0, 0], spring[4, 4] = 1e-6, 2e-6  # m/N along base x; rad/(N m) about base y
    arm = replace(c, arm_compliance=np.broadcast_to(spring, (60, 6, 6)))
    e = rigid.cell.wheel.contact_direction
    f = e + 0.35 * np.cross(rigid.cell.wheel.axis, e)
    contact = rigid.cell.wheel.centre + (rigid.cell.wheel.radius - LADDER)[:, None] * e
    r = contact - c.T_base_flange[:, :3, 3]
    turn = 2e-6 * (r[:, 2] * f[0] - r[:, 0] * f[2])
    moved = 1e-6 * f[0] * e[0] + turn * r[:, 2] * e[0]
    result = rigid.force(arm)
    give = rigid.solid[0] - 0.35 * rigid.solid[1]
    assert result.indentation + result.force * (give + moved) == pytest.approx(LADDER, abs=1e-9)


@pytest.mark.parametrize("power", [1, 6])
def test_an_arm_that_gives_by_its_load_stands_in_balance_with_the_contact(rigid, power):
    """A spring along base x that yields by 1e-5 m/N, twice that under 20 N; plain rounds swing without end at power 6."""
    c = standing(rigid, LADDER)

    def give_of(force):
        return 1e-5 * (1 + np.abs(force / 20.0) ** power)

    def compliance(wrench):
        found = np.zeros((len(wrench), 6, 6))
        found[:, 0, 0] = give_of(wrench[:, 0])
        return found

    grinder = rigid.grinder()
    borne = grinder.borne(c, compliance)
    result = grinder.force(borne)
    e = rigid.cell.wheel.contact_direction
    f = e + 0.35 * np.cross(rigid.cell.wheel.axis, e)
    moved = give_of(result.force * f[0]) * f[0] * e[0]
    give = rigid.solid[0] - 0.35 * rigid.solid[1]
    assert result.force.max() > 20.0
    assert result.indentation + result.force * (give + moved) == pytest.approx(LADDER, rel=1e-3)


def test_friction_turns_with_the_belt(rigid):
    c = standing(rigid, LADDER)
    forward, backward = rigid.force(c), rigid.force(replace(c, belt=-c.belt))
    assert forward.tangential == pytest.approx(0.35 * forward.force)
    assert backward.tangential == pytest.approx(-0.35 * backward.force)
    still = rigid.force(replace(c, belt=0 * c.belt))
    assert (still.tangential == 0).all()
    more = rigid.force(c, "tangential_force=0.2,leak=0")
    assert more.tangential == pytest.approx(0.55 * more.force)
    # By the blade's c_nt the belt changes the give itself.
    assert backward.indentation + backward.force * (rigid.solid[0] + 0.35 * rigid.solid[1]) == pytest.approx(LADDER, abs=1e-9)


@pytest.mark.parametrize("mount", ["rigid", "soft"])
def test_the_splice_knocks_once_a_revolution_as_hard_as_is_told(mount, request):
    bench = request.getfixturevalue(mount)
    c = moving(bench)
    bump = np.where(np.abs(np.mod(10 * c.time_s + 0.5, 1) - 0.5) < 0.05, 2.5 + 2.5 * np.cos(2 * np.pi * 100 * c.time_s), 0.0)
    assert bump.max() > 4
    assert bench.force(c, "belt_splice=5,hz=10").force - bench.force(c).force == pytest.approx(bump, abs=1e-9)
    still = replace(c, belt=0 * c.belt)
    assert (bench.force(still, "belt_splice=5,hz=10").force == bench.force(still).force).all()
    assert not bench.force(replace(c, contact=np.zeros(len(c.s), bool)), "belt_splice=5,hz=10").force.any()


def test_the_belt_pushes_at_curvature(rigid):
    c = moving(rigid)
    tension = rigid.force(c, "belt_tension=4")
    share = (tension.force - cover_curve(rigid)(tension.indentation)) / 4
    assert share == pytest.approx(np.full(len(share), (1 / 0.03) / (1 / 0.03 + 50)), abs=0.01)


def test_the_belt_alone_may_carry_a_light_contact():
    """Before the cover is loaded, the belt pushes only as hard as the blade gives way."""
    bench = Bench(flange=False, solid=np.array([4e-5, 0.0, 0.0]))
    light = standing(bench, np.array([1e-5, 3e-5, 5e-5]))
    result = bench.force(light, "belt_tension=10")
    assert np.diff(result.force) == pytest.approx(2e-5 / 4e-5, rel=1e-6)
    assert (result.force < 0.4 * 10).all() and (result.force > bench.force(light).force).all()


def test_the_cover_relaxes_with_a_memory(rigid):
    c = moving(rigid, length=0.08)
    result, elastic = rigid.force(c, "wheel_relaxation=0.2,tau=0.4"), cover_curve(rigid)
    F = elastic(result.indentation)
    expected = F - 0.2 * memory(F, c.time_s, np.arange(len(F)) == 0, 0.4)
    assert result.force == pytest.approx(expected, abs=0.01)
    plain = rigid.force(c).force
    assert result.force[0] == pytest.approx(plain[0]) and result.force[-1] < 0.9 * plain[-1]
    twice = replace(c, run=np.where(c.s > 0.04, 1, 0), time_s=np.where(c.s > 0.04, c.time_s - 1.0, c.time_s))
    second = np.flatnonzero(twice.run == 1)[0]
    assert rigid.force(twice, "wheel_relaxation=0.2,tau=0.4").force[second] == pytest.approx(plain[second], abs=0.01)


def test_the_flange_sticks_and_slides(soft):
    """Up and down: F = setpoint + k stroke + friction going up, - friction going down, and the stroke stands between."""
    wave = 6e-4 + 4e-4 * np.sin(np.linspace(0, 4 * np.pi, 500))
    result = soft.force(moments(soft.cell, np.full(500, 0.02), wave), "flange_friction=0.8")
    spring = result.force - 20.0 - 5600 * result.stroke
    rate = np.diff(result.stroke)
    assert (np.abs(spring) < 0.8 + 1e-6).all()
    assert spring[1:][rate > 1e-8] == pytest.approx(0.8, abs=1e-6)
    assert spring[1:][rate < -1e-8] == pytest.approx(-0.8, abs=1e-6)
    assert np.sum(np.abs(rate) < 1e-12) > 20


def test_the_flanges_spring_and_weight(soft):
    c = standing(soft, LADDER)
    stiff = soft.force(c, "flange_stiffness=0.3")
    assert stiff.force == pytest.approx(20 + 1.3 * 5600 * stiff.stroke, abs=1e-6)
    turned = c.T_base_flange.copy()
    # The whole cell lies on its back: the normal looks up where the wheel stands above.
    level = soft.force(c, "flange_gravity=0.5").force
    assert level == pytest.approx(soft.force(c).force, abs=1e-9)
    up = np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])  # base x to z: the blade's normal, +x, comes to look up
    wheel = soft.cell.wheel
    lying = replace(wheel, centre=up @ wheel.centre, axis=up @ wheel.axis, contact_direction=up @ wheel.contact_direction)
    turned[:, :3, :3], turned[:, :3, 3] = up @ turned[:, :3, :3], turned[:, :3, 3] @ up.T
    bench = Bench()
    bench.cell = replace(soft.cell, wheel=lying)
    heavy = bench.force(replace(c, T_base_flange=turned), "flange_gravity=0.5")
    assert heavy.force == pytest.approx(20 - 0.5 * 9.80665 + 5600 * heavy.stroke, abs=1e-6)
