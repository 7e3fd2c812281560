"""What is late in the virtual cell's contact, and what its force sensor shows."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.simulate.twin.contact import ContactMoments, ContactResult
from ocp.simulate.twin.contact.sensor import memory, read_sensor
from ocp.simulate.twin.planting import CONTACT_KINDS
from tests.support.twin_grinding import HERTZ_RATE, Bench, believed, moments, moving

Array = np.ndarray


@pytest.fixture(scope="module")
def soft() -> Bench:
    return Bench(flange=True)


def test_memory_is_the_exact_filter():
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(1e-3, 5e-2, 40))
    signal = 3 * time  # a straight line: q = 3 (t - tau + (tau - t0) exp(-(t - t0) / tau))
    restart = np.arange(40) == 0
    t0, tau = time[0], 0.2
    exact = 3 * (time - tau) - 3 * (t0 - tau) * np.exp(-(time - t0) / tau)
    assert memory(signal, time, restart, tau) == pytest.approx(exact, abs=1e-12)


def test_the_arm_lags_by_a_length_in_either_direction(soft):
    there = np.arange(0, 0.03, 1e-4)
    s = np.concatenate([there, there[::-1]])
    overlap = 6e-4 + 0.01 * s**1
    c = moments(soft.cell, s, overlap, run=np.repeat([0, 1], 300))
    late = soft.force(c, "path_lag=4e-4").overlap
    assert late[10:300] == pytest.approx(overlap[10:300] - 4e-6, abs=1e-9)
    assert late[310:] == pytest.approx(overlap[310:] + 4e-6, abs=1e-9)
    slow = replace(c, time_s=7 * c.time_s)
    assert soft.force(slow, "path_lag=4e-4").overlap == pytest.approx(late)


def reading(bench: Bench, c: ContactMoments, result: ContactResult, *effects: str, quiet: bool = True) -> tuple[Array, Array]:
    sigma = 0.0 if quiet else 0.3
    return read_sensor(believed(bench.cell, *effects, sensor_sigma=sigma, sensor_bias=0.1), result, c, np.random.default_rng(5))


def test_what_the_sensor_adds(soft):
    c = replace(moving(soft), clock_s=3600 + np.arange(250) / HERTZ_RATE)
    result = soft.force(c)
    fn, ft = reading(soft, c, result)
    assert fn == pytest.approx(result.force + 0.1, abs=1e-3) and ft == pytest.approx(result.tangential, abs=1e-3)
    assert reading(soft, c, result, "sensor_bias=0.7")[0] == pytest.approx(fn + 0.7)
    assert reading(soft, c, result, "sensor_drift=2")[0] == pytest.approx(fn + 2 * c.clock_s / 3600)
    assert reading(soft, c, result, "sensor_gain=0.04")[0] == pytest.approx(1.04 * (fn - 0.1) + 0.1)
    assert reading(soft, c, result, "sensor_crosstalk=-0.05")[0] == pytest.approx(fn - 0.05 * ft)
    leaked = reading(soft, c, result, "tangential_force=0.1,leak=0.04")[0]
    assert leaked == pytest.approx(fn + 0.04 * ft)
    back = replace(c, belt=-c.belt)
    turned = soft.force(back)
    assert reading(soft, back, turned, "sensor_crosstalk=0.05")[0] == pytest.approx(
        turned.force + 0.1 - 0.0175 * turned.force, abs=1e-3
    )
    air = replace(c, contact=np.zeros(250, bool))
    assert reading(soft, air, soft.force(air), "sensor_gain=0.04")[0] == pytest.approx(0.1)


def test_the_logger_is_late(soft):
    c = moments(soft.cell, np.arange(0, 0.04, 1.6e-4), 6e-4 + 1e-4 * np.sin(np.arange(250) / 10))
    result = soft.force(c)
    assert reading(soft, c, result, "time_delay=0.02")[0][5:] == pytest.approx(reading(soft, c, result)[0][:-5], abs=5e-3)


def test_noise_is_of_its_size_and_remembers(soft):
    c = moving(soft)
    many = {f: np.concatenate([getattr(c, f)] * 80) for f in c.__dataclass_fields__}
    many["run"] = np.repeat(np.arange(80), 250)
    long = ContactMoments(**many)
    zero = np.zeros(len(long.s))
    fn, ft = reading(soft, long, ContactResult(zero, zero, zero, zero, zero), quiet=False)
    assert fn.std() == pytest.approx(0.3, rel=0.03) and ft.std() == pytest.approx(0.3, rel=0.03)
    lag = np.mean((fn[1:] - 0.1) * (fn[:-1] - 0.1)) / 0.09
    assert lag == pytest.approx(0.4 * np.exp(-0.004 / 0.03), abs=0.03)


def test_every_kind_of_the_table_does_something(soft):
    """No effect of the table is forgotten: each changes forces or readings of a varied log."""
    c = moments(soft.cell, np.arange(0, 0.04, 1.6e-4), 6e-4 + 2e-4 * np.sin(np.arange(250) / 10), wheel_temperature_C=40.0)
    c = replace(c, ground_before=np.ones(250), clock_s=c.time_s + 500, run=np.arange(250) // 125)
    plain = reading(soft, c, soft.force(c))
    for kind in CONTACT_KINDS:
        if kind.name == "flange_gravity":  # the normal is level here; it has a test of its own
            continue
        at = ",at_s=500.3" if any(key.name == "at_s" for key in kind.keys) else ""
        first = kind.keys[0]
        size = f"{first.high}/0/0" if first.length == 3 else str(first.low if first.high < 0 else first.high)
        text = f"{kind.name}={size}{at}"
        got = reading(soft, c, soft.force(c, text), text)
        assert max(np.abs(a - b).max() for a, b in zip(got, plain, strict=True)) > 1e-3, text
