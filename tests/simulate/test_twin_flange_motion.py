"""The force flange in time: touching, ramps, friction, stops and a late force, held against closed forms and PHYSICS 6."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.simulate.twin.contact.flange_motion import LOSS, NODES, ClosingPath, MovedLane, MovingDevice, move, set_late

Array = np.ndarray
SPRING, HALF, FORCE = 5600.0, 4e-3, 20.0  # N/m, m, N: the bundled flange
SUNK = 0.51e-3  # m that wheel and blade give way under FORCE
FREE = -FORCE / SPRING
DT = 0.004


def device(mass: float = 5.0, friction: float = 0.0, lanes: int = 1, **changes) -> MovingDevice:
    return MovingDevice(np.full(lanes, mass), np.full(lanes, friction), SPRING, HALF, **changes)


def path(depth: Array, driven: Array | float = 0.0, stiff: float | None = None, told: Array | float = FORCE) -> ClosingPath:
    """A contact whose force grows with the 1.5th power of the depth, or in proportion (stiff N/m)."""
    n = len(depth)
    closed = SUNK * NODES if stiff is None else FORCE * NODES**1.5 / stiff
    ones = np.ones(n)
    spread = (np.tile(closed, (n, 1)), np.tile(FORCE * NODES**1.5, (n, 1)))
    return ClosingPath(
        DT * np.arange(n), depth, ones, driven * ones, told * ones, 0 * ones, *spread, 0 * ones, 0 * ones, (), None
    )


def moved(one: ClosingPath, with_: MovingDevice) -> MovedLane:
    return move([one], np.array([0]), with_)[0]


def balance(depth: Array) -> Array:
    """Force of (4) and (5) at depths, FORCE at stroke 0."""
    force = np.linspace(0.0, 80.0, 20001)
    return np.interp(depth, (force - FORCE) / SPRING + SUNK * (force / FORCE) ** (2 / 3), force)


def ramp(seconds: float) -> tuple[Array, Array]:
    """From the first touch to FORCE along a fifth-order curve, and the acceleration of whoever drives it."""
    r = np.clip((np.arange(0, seconds + 0.4, DT) - 0.1) / seconds, 0, 1)
    way = SUNK - FREE
    bend = np.where((r > 0) & (r < 1), 60 * r - 180 * r**2 + 120 * r**3, 0.0) / seconds**2
    return way * (10 * r**3 - 15 * r**4 + 6 * r**5) + FREE, way * bend


def test_touching_at_a_speed_is_a_spike_of_mass_and_stiffness():
    """PHYSICS 6: v sqrt(k m), 6, 12, 23, 46 N of 5 kg on 60 N/mm; the loss of the cover takes a tenth."""
    speeds = np.array([0.01, 0.02, 0.04, 0.08])
    paths = [path(v * (DT * np.arange(35) - 0.1) + FREE, stiff=60e3) for v in speeds]
    bare, lossy = (np.array([m.most.max() for m in move(paths, np.arange(4), device(lanes=4, loss=k))]) for k in (0.0, LOSS))
    assert bare == pytest.approx(speeds * np.sqrt(60e3 * 5.0), rel=0.03) and bare == pytest.approx([6, 12, 23, 46], rel=0.15)
    assert (lossy / bare > 0.85).all() and (lossy / bare < 0.95).all()


@pytest.mark.parametrize(("seconds", "off"), [(0.1, 20), (0.15, 9), (0.2, 5), (0.3, 3)])
def test_smooth_ramps_are_off_by_what_physics_says(seconds, off):
    """PHYSICS 6: what is carried stands still and follows the stroke, so the wheel comes to the blade; where the arm brings the
    blade, which the wheel stops, it stands nearly still in the hall and a quarter is left."""
    depth, driven = ramp(seconds)
    comes = moved(path(depth), device(friction=0.3))
    brought = moved(path(depth, driven), device(friction=0.3))
    worst = np.abs(comes.force - balance(depth)).max()
    assert worst == pytest.approx(off, rel=0.3)
    assert np.abs(brought.force - balance(depth)).max() < 0.3 * worst


def test_a_finer_step_gives_the_same_spike(monkeypatch):
    touch = path(0.01 * (DT * np.arange(40) - 0.1) + FREE, stiff=60e3)
    coarse = moved(touch, device())
    monkeypatch.setattr("ocp.simulate.twin.contact.flange_motion.STEP", 3e-5)
    assert moved(touch, device()).most.max() == pytest.approx(coarse.most.max(), rel=0.02)


def test_rubber_never_pulls():
    """The wheel is taken away faster than the cover follows: no force from then on, and the mass goes as its spring sends it."""
    t = DT * np.arange(60)
    gone = 0.1
    found = moved(replace(path(SUNK - 0.5 * np.clip(t - gone, 0, 0.02)), start=0.0), device())
    after = (t > gone + 2 * DT) & (t < gone + 6 * DT)
    assert (found.mean >= 0).all() and (found.force >= 0).all() and (found.mean[after] == 0).all()
    swing = np.sqrt(SPRING / 5.0)
    assert found.stroke[after] == pytest.approx(FREE * (1 - np.cos(swing * (t[after] - gone - 5e-4))), abs=6e-5)


def test_a_short_ramp_without_loss_bounces():
    assert moved(path(ramp(0.1)[0]), device(loss=0.0)).losses.sum() > 0
    assert moved(path(ramp(0.2)[0]), device()).losses.sum() == 0


def test_friction_is_felt_when_the_stroke_turns():
    """1 N of 20 N is 5 %: less while the flange stands out to the wheel, more while it gives way; small ways are held."""
    t = np.arange(0, 3, DT)
    turning = np.sin(np.pi * t / 2)
    large, small = (replace(path(SUNK + size * turning), start=0.0) for size in (1e-3, 5e-6))
    with_ = replace(device(lanes=3), friction=np.array([0.0, 1.0, 1.0]))
    free, stuck, held = move([large, small], np.array([0, 0, 1]), with_)
    rising, falling = (t > 0.3) & (t < 0.8), (t > 1.3) & (t < 2.8)
    assert free.force[t > 0.3] == pytest.approx(balance(large.depth)[t > 0.3], abs=0.1)
    change = stuck.force - free.force
    assert change[rising].mean() == pytest.approx(1.0, abs=0.1) and change[falling].mean() == pytest.approx(-1.0, abs=0.1)
    assert np.abs(change[t > 0.3]).max() < 1.4
    assert np.ptp(held.stroke) < 1e-9 < np.ptp(held.force)


def test_the_stops_are_rigid():
    """Pressed to its stop the flange moves no farther, and the contact's own stiffness is felt."""
    t = np.arange(0, 1.2, DT)
    depth = SUNK + np.minimum(t, 1.0) * 5.5e-3
    found = moved(replace(path(depth), start=0.0), device())
    assert found.stroke.max() == HALF and found.stroke[-1] == HALF
    assert found.force[-1] == pytest.approx(FORCE * ((depth[-1] - HALF) / SUNK) ** 1.5, rel=1e-2)
    out = moved(path(np.full(200, -0.01)), device())
    assert out.stroke == pytest.approx(np.full(200, FREE), abs=1e-6) and (out.force == 0).all()
    weak = moved(path(np.full(200, -0.01), told=30.0), device())
    assert weak.stroke == pytest.approx(np.full(200, -HALF), abs=1e-12)


def test_a_set_force_comes_late():
    t = np.arange(0, 0.5, 1e-3)
    step = np.where(t >= 0.1, 20.0, 8.0)
    late = set_late(step, t, 10.0, 0.01)
    assert (late[t < 0.11 - 1e-9] == 8.0).all()
    tau = 1 / (2 * np.pi * 10.0)
    after = t > 0.115
    assert late[after] == pytest.approx(20 - 12 * np.exp(-(t[after] - 0.11) / tau), abs=0.4)
    assert (set_late(step, t, None, 0.0) == step).all()
    # And so does the force on the blade, and the weight that is set off: both flanges turn upside down at 0.1 s.
    n = 100
    one = replace(path(np.full(n, SUNK), told=np.where(DT * np.arange(n) >= 0.1, 20.0, 16.0)), start=-4.0 / SPRING)
    turned = replace(path(np.full(n, SUNK)), down=np.where(DT * np.arange(n) >= 0.1, -0.04, 0.04), start=0.0)
    still = balance(SUNK * np.ones(1))[0]
    for each, least in ((one, 2.0), (turned, 1.0)):
        quick, slow = (moved(each, device(bandwidth=b, delay=d)).force for b, d in ((None, 0.0), (5.0, 0.02)))
        early = slice(int(0.108 / DT), int(0.128 / DT))
        assert np.abs(quick - slow)[early].max() > least and slow[-1] == pytest.approx(still, abs=0.5)


def test_any_mass_on_any_contact_settles():
    mass, stiff = np.array([2.0, 0.2, 0.0, 10.0, 100.0]), np.array([110e3, 110e3, 110e3, 40e3, 1e6])
    depth = np.concatenate([np.linspace(FREE - 1e-3, 2e-4, 60), np.full(300, 2e-4)])
    lanes = move([path(depth, stiff=k) for k in stiff], np.arange(5), replace(device(0.0, 0.3, 5), mass=mass))
    end = np.array([lane.force[-30:] for lane in lanes])
    assert np.isfinite(end).all() and (np.ptp(end, axis=1) < 0.05).all()
    assert end.mean(axis=1) == pytest.approx((2e-4 + FORCE / SPRING) / (1 / SPRING + 1 / stiff), abs=0.35)


def test_lanes_do_not_touch_each_other():
    a, b = path(ramp(0.1)[0]), path(ramp(0.2)[0])
    both = move([a, b], np.array([0, 1, 0]), replace(device(5.0, 0.3, 3), mass=np.array([5.0, 5.0, 2.0])))
    alone = moved(b, device(5.0, 0.3))
    assert both[1].force == pytest.approx(alone.force, abs=1e-12) and len(both[1].force) == len(b.time)
    assert np.abs(both[0].force - both[2].force).max() > 1


def test_half_the_step_changes_little(monkeypatch):
    coarse = moved(path(ramp(0.15)[0]), device(friction=0.3)).force
    monkeypatch.setattr("ocp.simulate.twin.contact.flange_motion.STEP", 6e-5)
    assert moved(path(ramp(0.15)[0]), device(friction=0.3)).force == pytest.approx(coarse, abs=0.6)
