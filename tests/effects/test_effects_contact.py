"""Effects at the contact and on the force reading against formulas of their own, number by number."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ocp.effects.catalogue import library
from ocp.effects.cell_effects import effect_of
from ocp.effects.context import LogRows
from ocp.effects.engine.evaluate import CONTACT_LAYOUT, ContactPlace, added_overlap, contact_columns
from tests.effects.test_effects import PLACES, SEEN, some

PLACE = ContactPlace(0.15, 0.35, (0.0, 0.0, -1.0))
N = 9
KINDS = ("overlap", "push", "sensor", "shear")
ON_CONTACT = sorted({name for name, _ in PLACES if any(getattr(library()[name], kind) for kind in KINDS)})
ALONG = sorted({name for name, _ in PLACES if library()[name].along})


def samples(seed=0):
    """Blocks of N samples with numbers of a grinding cell."""
    rng = np.random.default_rng(seed)

    def unit(n):
        v = rng.normal(size=(n, 3))
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    slopes = np.abs(rng.normal(size=(N, 4))) * np.array([1.8e-4, 1.2e-5, 4e-6, 1.5e-6])
    turns = np.stack([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(N)])
    return {
        "F": rng.uniform(8, 40, N),
        "parts": rng.uniform(1e-5, 3e-4, (N, 4)),
        "slopes": slopes,
        "e": unit(N),
        "n_base": unit(N),
        "curvature": rng.uniform(-20, 400, (N, 3)),
        "R_flange": turns,
        "friction_deflection": rng.normal(size=N) * 1e-5,
        "s": rng.uniform(0, 0.1, N),
        "feed": rng.choice([0.02, 0.04, 0.08], N),
        "belt": rng.choice([-20.0, 0.0, 20.0], N),
        "time": rng.uniform(0, 5, N),
        "clock": np.sort(rng.uniform(0, 3600, N)),
        "ground_before": rng.integers(0, 8, N) * 1.0,
        "wheel_warm": rng.uniform(0, 20, N),
        "line": rng.integers(1, 4, N) * 1.0,
        "lever": rng.uniform(0.01, 0.08, N),
        "push_axis": unit(N),
        "clamp_deflection": np.full(N, 2e-6),
        "belt_direction": unit(N),
        "joint_lever": rng.uniform(-0.4, 0.4, (N, 6)),
        "joint_push": rng.uniform(-10, 10, (N, 6)),
        "tau": rng.uniform(-60, 60, (N, 6)),
    }


def expected(name, v, x):
    """Overlap m, push N, normal reading N and tangential reading N that an effect of values v adds to samples x."""
    F, zero, sign = x["F"], np.zeros(N), np.sign(x["belt"])
    after = x["clock"] >= v.get("at_s", -1)
    wheel_law = 0.7  # exponent of indentation in force
    give = {
        "wheel_wear": -v.get("m_per_s", 0) * x["clock"],
        "clamp_compliance": -v.get("m_per_N", 0) * F * (x["lever"] / 0.06) ** 2,
        "clamp_slip": after * -np.float64(v["m"]) if name == "clamp_slip" else zero,
        "material_removal": -v.get("m_per_pass", 0) * x["ground_before"] * 0.04 / x["feed"],
        "flange_stiffness": x["parts"][:, 0] * (1 - 1 / (1 + v.get("scale", 0))),
        "blade_stiffness": (x["parts"][:, 2] - x["clamp_deflection"]) * (1 - 1 / (1 + v.get("scale", 0))),
        # slopes[1] F = 0.7 d where indentation is a power of the force
        "wheel_stiffness": x["slopes"][:, 1] * F / wheel_law * (1 - (1 + v.get("scale", 0)) ** -wheel_law),
    }
    push = {"flange_gravity": -v.get("kg", 0) * 9.81 * x["push_axis"][:, 2] / np.sum(x["push_axis"] * x["n_base"], axis=1)}
    sensor = {
        "sensor_bias": v.get("N", 0) + zero,
        "sensor_drift": v.get("N_per_h", 0) * x["clock"] / 3600,
        "sensor_gain": np.float64(v.get("scale", 0)) * F,
        "sensor_crosstalk": v.get("share", 0) * 0.35 * sign * F,
        "tangential_force": v.get("leak", 0) * (0.35 + v.get("dmu", 0)) * F * sign,
    }
    if name == "tool_frame_shift":
        give[name] = -1.0 * after * np.einsum("ni,nij,j->n", x["e"], x["R_flange"], v["m"])
    if name == "wheel_frame_shift":
        give[name] = after * (x["e"] @ v["m"])
    if name == "joint_compliance":
        give[name] = -v["rad_per_Nm"] * x["joint_lever"][:, 0] * x["joint_push"][:, 0]
    if name in ("load_backlash", "joint_stiffening"):  # what joint 1 turns when the contact's torque joins the weight's
        turn = {
            "load_backlash": lambda tau: v["half_width_rad"] * np.tanh(tau / v["torque_Nm"]),
            "joint_stiffening": lambda tau: -v["rad_per_Nm3"] * tau**3,
        }[name]
        give[name] = -x["joint_lever"][:, 0] * (turn(x["tau"][:, 0] + x["joint_push"][:, 0]) - turn(x["tau"][:, 0]))
    if name == "tool_flex":  # in the flange's own axes: x and y give, z does not
        felt = x["e"] + 0.35 * sign[:, None] * x["belt_direction"]
        own = [np.einsum("nij,ni->nj", x["R_flange"], direction)[:, :2] for direction in (x["e"], felt)]
        give[name] = -v["m_per_N"] * F * np.sum(own[0] * own[1], axis=1)
    if name == "tangential_force":
        give[name] = -v["dmu"] * x["friction_deflection"]
    if name == "wheel_temperature":
        give[name] = x["wheel_warm"] * (v["per_K"] * F * x["slopes"][:, 1] + v["radius_per_K"])
    if name == "wheel_runout":
        give[name] = v["m"] * np.cos(x["belt"] / 0.15 * (x["clock"] if v["clocked"] else x["time"]) + v["phase_rad"])
    if name == "wheel_law":
        factor = 1 / (1 + v["exponent"]) - 1  # of the exponent of indentation in force, here to first order
        give[name] = -x["slopes"][:, 1] * F * np.log(F / 20.0) * factor
    if name == "stock_profile":
        waves = np.sqrt(2) * np.cos(np.pi * np.outer(x["s"], np.arange(7)) / 0.1)
        waves[:, 0] = 1.0
        own = np.reshape(v["profile_m"], (5, 7))[(x["line"] - 1).astype(int) if v["lines"] else np.zeros(N, int)]
        give[name] = np.sum(own * waves, axis=1)
    if name == "belt_tension":
        k = np.maximum(x["curvature"][:, 0] - 1 / 0.15, 0) + np.maximum(x["curvature"][:, 1], 0)
        push[name] = v["N"] * k / (k + v["half_per_m"])
    if name == "belt_splice":
        turns = v["hz"] * (x["clock"] if v["clocked"] else x["time"]) - v["turn"]
        sensor[name] = v["N"] * np.exp(-0.5 * ((turns - np.round(turns)) / v["length"]) ** 2) * (sign != 0)
    shear = v["dmu"] * F * sign if name == "tangential_force" else zero
    if name == "belt_splice":
        shear = sign * sensor[name] * (0.35 + v["more_ft_N"] / v["N"])
    return give.get(name, zero), push.get(name, zero), sensor.get(name, zero), shear


@pytest.mark.parametrize("name", ON_CONTACT)
@pytest.mark.parametrize("at", [0.0, 1.0])
def test_contact_effects_are_what_they_say(name, at):
    one, x = some(name, library()[name].places[0], size=0.4, at=at), samples()
    v = one.parameters
    rows = CONTACT_LAYOUT.stack(N, x | {"R_flange": x["R_flange"].reshape(N, 9)})
    columns = [contact_columns(one.effect, kind, one.joint, [one.scanned], PLACE, rows)[0] @ one.a for kind in KINDS]
    wanted = expected(name, v, x)
    assert max(np.abs(w).max() for w in wanted) > 0
    for kind, seen, told in zip(KINDS, columns, wanted, strict=True):
        assert seen == pytest.approx(told, rel=1e-9, abs=1e-15), (name, kind)
    whole = added_overlap([one, one], PLACE, rows, rigid=False)
    assert whole == pytest.approx(2 * (columns[0] + columns[1] * x["slopes"][:, 0]), abs=1e-18)
    rigid = added_overlap([one], PLACE, rows, rigid=True)
    assert rigid == pytest.approx(columns[0] + columns[1] * x["slopes"].sum(axis=1), abs=1e-18)


def test_a_profile_as_large_as_its_prior_is_as_large_as_real_ones_get():
    e = library()["stock_profile"]
    drawn = np.random.default_rng(1).normal(size=(400, e.size)) * e.prior_sd
    sizes = [e.values(a, {"from_m": 0.0, "length_m": 0.1, "lines": [1.0, 2.0]})["m"] for a in drawn]
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(2e-4, rel=0.05)


def test_a_profile_is_not_mirrored_where_a_pass_begins():
    """A log that begins at touch has negative s; cosines of s itself are even there and hold no slope."""
    e, s = library()["stock_profile"], np.linspace(-0.02, 0.055, 60)
    scanned = e.scan(0, replace(SEEN, span=(-0.02, 0.075)))[0]
    rows = CONTACT_LAYOUT.stack(len(s), {"s": s, "line": np.ones(len(s))})
    columns = contact_columns(e, "overlap", 0, [scanned], PLACE, rows)[0]
    true = np.sin(s / 9e-3)
    a, *_ = np.linalg.lstsq(columns, true, rcond=None)
    assert np.sqrt(np.mean((columns @ a - true) ** 2)) < 0.1


def test_every_effect_on_forces_is_covered():
    assert set(ON_CONTACT) | set(ALONG) == {name for name, e in library().items() if e.on_contact}
    assert ALONG == ["flange_friction", "path_lag", "time_delay", "wheel_relaxation"]


def test_a_shifted_blade_and_a_shifted_wheel_change_the_overlap_by_what_they_come_nearer():
    """Against the overlap of points and a cylinder, moved for real."""
    rng, axis = np.random.default_rng(4), np.array([0.0, 1.0, 0.0])
    for _ in range(20):
        p, R = rng.normal(size=3) * 0.1 + [0.2, 0, 0], np.linalg.qr(rng.normal(size=(3, 3)))[0]
        shift = rng.normal(size=3) * 1e-6

        def overlap(point, centre):
            v = point - centre
            return 0.15 - np.linalg.norm(v - (v @ axis) * axis)

        v = p - (p @ axis) * axis
        e = v / np.linalg.norm(v)
        row = CONTACT_LAYOUT.stack(1, {"e": e, "R_flange": R.reshape(1, 9), "clock": 5.0})
        for name, moved in (("tool_frame_shift", (p + R @ shift, np.zeros(3))), ("wheel_frame_shift", (p, shift))):
            column = contact_columns(library()[name], "overlap", 0, [{"at_s": 1.0}], PLACE, row)[0, 0]
            assert column @ shift == pytest.approx(overlap(*moved) - overlap(p, np.zeros(3)), rel=1e-4, abs=1e-10)


def log(n=400):
    """Two runs, one each way, the first with a second in the air before it engages."""
    time = np.tile(np.arange(n // 2) * 0.01, 2)
    run = np.repeat([0, 1], n // 2)
    feed = np.where(run == 0, 0.04, 0.02)
    travel = np.where(run == 0, 1.0, -1.0)
    s = np.where(run == 0, 0.04 * time, 0.1 - 0.02 * time)
    contact = (run == 1) | (time >= 1.0)
    fn = 20 + np.sin(60 * s)
    load = np.where(contact, 20.0, 0.0)
    one = np.ones(n)
    shares = 0.1 * one, 0.8 * one
    stroke = 1e-4 * np.cos(0.5 * np.pi * time)
    return LogRows(run, time, s, load, 1e-4 * one, stroke, 5e3 * one, *shares, fn, 0.3 * fn, contact, travel, feed, None, stroke)


def test_a_delay_shows_the_force_of_before_and_a_lag_that_of_behind():
    x = log()
    late = library()["time_delay"]
    for delay in (0.002, 0.04):
        s = x.s - x.travel * x.feed * delay
        # A log does not know what was before its first row.
        known = x.time >= delay
        change = late.along(x, 0, {"size": delay})[:, 0] * delay
        assert change[known] == pytest.approx((20 + np.sin(60 * s) - x.fn)[known], abs=2e-4)
        assert late.along_shear(x, 0, {"size": delay})[:, 0] * delay == pytest.approx(0.3 * change, abs=1e-12)
    behind = library()["path_lag"]
    for lag in (1e-4, 5e-4):
        s = x.s - x.travel * lag
        known = x.time >= lag / 0.02 + 0.02
        change = behind.along(x, 0, {"size": lag})[:, 0] * lag
        assert change[known] == pytest.approx((20 + np.sin(60 * s) - x.fn)[known], abs=2e-4)
        # The same distance at half the speed is twice the time.
        assert np.abs(change[x.run == 1]).max() == pytest.approx(np.abs(change[x.run == 0][120:]).max(), rel=0.1)


def test_rubber_lets_go_as_a_standard_linear_solid():
    x, let_go = log(), library()["wheel_relaxation"].along
    since = np.where(x.run == 0, x.time - 1.0, x.time)
    for g, share in ((0.0, 0.1), (0.3, 0.1), (0.3, 1.0)):
        lost = let_go(replace(x, wheel_share=share * np.ones(len(since))), 0, {"tau": 0.5, "acts_g": g})[:, 0]
        # Behind a spring that is 1 - share of the give, step by step: what the cover lets go, the spring presses in again.
        held, each, step = 0.0, [], 1e-3
        for _ in np.arange(0.0, since.max() + step, step):
            each.append(-share * held)
            held += (20.0 + g * held * (1.0 - share) - held) * step / 0.5
        assert (lost[~x.contact] == 0).all()
        expected = np.interp(since, step * np.arange(len(each)), each)
        assert lost[x.contact] == pytest.approx(expected[x.contact], abs=0.5 * share)  # one sample of the lag
        assert lost[x.run == 1][0] == 0.0 and lost[-1] == pytest.approx(each[-1], rel=0.02)
    # A log of one row, and forces that are no numbers: whoever asked sees it.
    alone = replace(x, **{f.name: getattr(x, f.name)[-1:] for f in fields(x) if f.name != "clock"})
    assert let_go(alone, 0, {"tau": 0.5, "acts_g": 0.1})[:, 0].tolist() == [0.0]
    off = replace(x, F=np.where(x.run == 1, np.nan, x.F))
    assert not np.isfinite(let_go(off, 0, {"tau": 0.5, "acts_g": 0.1})).all()


def test_a_flange_that_sticks_lets_go_at_once_and_is_held_again_over_its_limit():
    x, sticks = log(), library()["flange_friction"]
    held = sticks.along(x, 0, {"turn_N": 0.5})[:, 0] / 0.8
    assert (held[~x.contact] == 0).all() and held[x.run == 1][0] == pytest.approx(1.0)
    push = 5e3 / (0.8 * 0.2) * x.stroke / 0.5  # what it would take to hold it, over the limit
    for own in (x.run == 1, (x.run == 0) & x.contact):
        rest, built = held[own], push[own] - push[own][0]  # from touching, which has pressed it in, it extends
        down = np.flatnonzero(np.diff(built) > 0)[0] + 1 if (np.diff(built) > 0).any() else len(built)
        goes = np.where(built > -1.0, 1.0 + built, -np.tanh(-built - 1.0))[:down]
        assert rest[:down] == pytest.approx(goes, abs=1e-9)
    # Changes are those of small motions of the stroke, whatever its way.
    rng = np.random.default_rng(2)
    ways = np.cumsum(rng.normal(size=(len(x.run), 3)), axis=0) * 1e-6
    told = sticks.along(replace(x, stroke=ways, F=np.zeros_like(ways)), 0, {"turn_N": 0.5})
    for k in range(3):
        ends = [replace(x, d_flange=x.d_flange + h * ways[:, k], stroke=x.stroke + h * ways[:, k]) for h in (1e-5, -1e-5)]
        up, low = (sticks.along(one, 0, {"turn_N": 0.5})[:, 0] for one in ends)
        assert told[:, k] == pytest.approx((up - low) / 2e-5, abs=2e-3 * np.abs(told[:, k]).max())
    # No flange gives, none at a stop: nothing.
    assert not sticks.along(replace(x, flange_share=np.full(len(x.run), 1e-4)), 0, {"turn_N": 0.5}).any()
    a, scanned = sticks.coefficients_of({"N": 0.7})
    assert scanned == {"turn_N": 0.7} and sticks.values(a, scanned) == {"N": 0.7, "turn_N": 0.7}
    assert sticks.coefficients_of({"N": 0.7, "turn_N": 0.2})[1] == {"turn_N": 0.2}
    for wrong in (0.0, -0.4, np.nan):
        with pytest.raises(ValueError, match="turn_N = .* is not above zero; leave it out"):
            effect_of({"effect": "flange_friction", "N": 0.7, "turn_N": wrong})
    with pytest.raises(ValueError, match="not a finite number"):
        effect_of({"effect": "wheel_relaxation", "g": 0.1, "tau": np.nan})


@pytest.mark.parametrize(("clocked", "turn"), [(0.0, 0.3), (1.0, 0.7)])
def test_knocks_of_a_splice_have_the_height_and_the_places_that_are_told(clocked, turn):
    effect, time = library()["belt_splice"], np.arange(0, 4, 1e-3)
    belt = {"F": np.full(len(time), 20.0), "belt": np.full(len(time), -20.0)}
    row = CONTACT_LAYOUT.stack(len(time), {"time": time, "clock": time + 100.3, **belt})  # 802.4 turns
    a, scanned = effect.coefficients_of({"N": 5.0, "hz": 8.0, "turn": turn, "length": 0.02, "clocked": clocked})
    knock = contact_columns(effect, "sensor", 0, [scanned], PLACE, row)[0, :, 0] * a[0]
    tops = time[1:-1][(knock[1:-1] > knock[:-2]) & (knock[1:-1] >= knock[2:])]
    assert len(tops) == 32 and knock.max() == pytest.approx(5.0, rel=0.03)
    assert tops == pytest.approx((np.arange(32) + 0.3) / 8.0, abs=1e-3)
    assert knock.sum() * 1e-3 / 32 == pytest.approx(5.0 * np.sqrt(2 * np.pi) * 0.02 / 8.0, rel=1e-3)
    assert effect.values(a, scanned)["N"] == 5.0
    assert effect.scan(0, replace(SEEN, splice_trains=(scanned,))) == (scanned,)
    rates = [s["hz"] for s in effect.scan(0, SEEN)]
    assert min(rates) == 5.0 and max(rates) == 15.0  # where no readings say which
