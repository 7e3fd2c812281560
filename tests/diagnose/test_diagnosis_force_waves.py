"""What is fast in a force log, and fits that are not straight: knocks, waves nobody catalogued, delays beside other effects."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from ocp.diagnose.answering import tracker_channel
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.engine.beam import NOTHING, Search
from ocp.diagnose.engine.channel_system import Wave
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.kernels import kernels
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.engine.search import Diverged, search_and_refit
from ocp.diagnose.force import fit as fitting
from ocp.diagnose.force.channel import ForceChannel
from ocp.diagnose.force.fit import fit_effects, linear
from ocp.diagnose.force.waves import FINE, _gains, _knocks, _scores, likely_trains, picked_squares, telling_waves
from ocp.diagnose.rules import HOPELESS_FITS, OVERTONES, TRAINS_OFFERED
from ocp.diagnose.verdict import diagnosis
from ocp.diagnose.verdict.diagnosis import diagnose_channels, findings
from ocp.diagnose.verdict.probabilities import _variants
from robots.errors import Infeasible
from tests.diagnose.test_diagnosis_force import EFFECTS, Made, _active, _again, _log, _part, made  # noqa: F401
from tests.support.diagnosis_force_world import Planted


def bell(turns, length):
    return np.exp(-0.5 * ((turns - np.round(turns)) / length) ** 2)


@pytest.mark.parametrize(("clock", "hz", "turn", "length"), [("time", 8.37, 0.3, 0.03), ("clock", 11.213, 0.85, 0.05)])
def test_a_train_of_knocks_is_found_by_rate_place_and_length(made: Made, tmp_path, clock, hz, turn, length):  # noqa: F811
    def knock(c, F):
        return 1.2 * (F > 0) * (c["belt"] != 0) * bell(hz * c[clock] - turn, length)

    log, _ = _log(made.base, (Planted(reading=knock),), tmp_path)
    channel = _again(made, log)
    knocks = likely_trains(channel.problem, channel.fit)
    best = knocks.found[0]
    assert best["clocked"] == float(clock == "clock") and knocks.among > 1000
    span = np.ptp(getattr(channel.problem.scene.conditions, clock))
    assert best["hz"] == pytest.approx(hz, abs=0.05 / span)
    at = 0.5 * span + getattr(channel.problem.scene.conditions, clock).min()  # rate and place are told together
    off = (best["hz"] * at - best["turn"]) - (hz * at - turn)
    assert abs(off - np.round(off)) < 0.01 and best["length"] == pytest.approx(length, rel=0.15)
    after = channel.with_active((_active("belt_splice", scanned=best),)).active[0]
    assert after.a == pytest.approx([1.2, -0.42], abs=0.05)  # planted in the normal reading alone


def test_a_train_is_as_sharp_as_the_readings_and_long_after_them_may_be_out_of_step(made: Made, tmp_path):  # noqa: F811
    hz, turn, length = 11.213, 0.85, 0.05

    def knock(c, F):
        return 2.0 * (F > 0) * (c["belt"] != 0) * bell(hz * c["clock"] - turn, length)

    log, _ = _log(made.base, (Planted(reading=knock),), tmp_path)
    channel = _again(made, log)
    best = likely_trains(channel.problem, channel.fit).found[0]
    after = channel.with_active((_active("belt_splice", scanned=best),))
    (one,) = after.active
    clock = channel.problem.scene.conditions.clock
    place = (best["hz"] - hz) * clock[log.contact].mean() - best["turn"] + turn
    assert abs(place) < 2.0 * length * np.sqrt(2.0 * one.covariance[0, 0]) / one.a[0]
    told = _variants(SimpleNamespace(channels=[after]), None, after.active, 0.9)
    first, *others = (a.active[0].scanned for a in told)
    assert first == best and others[0]["hz"] < hz < others[1]["hz"] and {a.probability for a in told} == {0.9 / 3.0}

    def off(train, at):
        shown = [bell(s["hz"] * at - s["turn"], length) for s in (train, first)]
        return 2.0 * (shown[0] - shown[1])

    for other in others:  # as the readings tell them apart, and as they are 300 logs later
        white = after.fit.whiteners[0].whole((log.contact * off(other, clock))[:, None])
        assert 0.5 < np.sum(white**2) < 4.0
        late = clock.max() + 300.0 * np.ptp(clock) + np.linspace(0.0, 2.0, 2000)
        assert np.abs(off(other, late)).max() > 1.5


@pytest.mark.parametrize("rubs", [0.0, 1.0])
def test_knocks_far_above_the_noise_are_no_gross_readings(made: Made, rubs):  # noqa: F811
    """Whether they rub or not: what the tangential reading lacks must not make gross readings of the normal one's knocks. One
    reading of a hundred that is gross stays harmless."""
    channel, rng = made.channel, np.random.default_rng(7)
    log, scene = channel.log, channel.problem.scene
    knocks = 10.0 * log.contact * bell(13.1 * scene.conditions.clock - 0.37, 0.03)
    wild = 5.0 * rng.normal(size=len(log)) * (rng.uniform(size=len(log)) < 0.01)
    channel = _again(made, replace(log, fn=log.fn + knocks + wild, ft=log.ft + rubs * scene.shear * knocks))
    best = likely_trains(channel.problem, channel.fit).found[0]
    after = channel.with_active((_active("belt_splice", scanned=best),))
    (splice,) = after.active
    assert best["hz"] == pytest.approx(13.1, abs=1e-4) and splice.a[0] == pytest.approx(10.0, rel=0.02)
    assert splice.a[1] == pytest.approx(3.5 * (rubs - 1.0), abs=0.1) and splice.deviations["N"] < 0.05
    assert after.fit.whiteners[0].noise.weight[np.abs(wild) > 3.0].max() < 0.2


def test_knocks_are_looked_for_where_a_belt_runs_and_a_clock_is_read(made: Made, tmp_path):  # noqa: F811
    """A standing belt has none; a clock of days would need a transform of gigabytes."""
    log, _ = _log(made.base, (), tmp_path)
    channel = _again(made, log)
    problem, c = channel.problem, channel.problem.scene.conditions

    def trains(**changed):
        scene = replace(problem.scene, conditions=replace(c, **changed))
        return likely_trains(replace(problem, scene=scene), channel.fit).found

    assert 1.0 in {one["clocked"] for one in trains()}
    assert trains(belt=0.0 * c.belt) == ()
    assert {one["clocked"] for one in trains(clock=1e5 * c.clock)} == {0.0}


def test_noise_alone_offers_no_knocks_worth_their_number(made: Made, tmp_path):  # noqa: F811
    log, _ = _log(made.base, (), tmp_path, 21)
    found = diagnose_channels([_again(made, log)], {"belt_splice": EFFECTS["belt_splice"]})
    assert found.p_none > 0.9


def test_the_best_train_of_noise_is_worth_less_than_how_many_there_are(made: Made):  # noqa: F811
    """Noise at its likeliest: as many trains fit into a campaign as its clock and their sharpness tell apart."""
    problem, fit, rng = made.channel.problem, made.channel.fit, np.random.default_rng(3)
    worth = []
    for _ in range(6):
        noise = replace(fit, residual=rng.normal(size=len(fit.residual)))
        trains = likely_trains(problem, noise)
        best, y = trains.found[0], _scores(problem, noise)
        time = problem.scene.conditions.clock if best["clocked"] else problem.scene.conditions.time
        gain = _gains(problem, noise, y, time, [best])[0]
        worth.append(0.5 * gain - np.log(trains.among))
        assert trains.picked / TRAINS_OFFERED == pytest.approx(gain, abs=9.0)
    assert max(worth) < 0.0 and np.mean(worth) > -12.0


@pytest.mark.parametrize("hz", [13.59, 8.2])
def test_knocks_that_the_catalogue_does_not_have_are_told_as_unknown(made: Made, hz):  # noqa: F811
    """Below the noise of one reading, and with tones beyond half the logging rate."""
    log = made.channel.log
    knocks = 0.35 * log.contact * bell(hz * made.channel.problem.scene.conditions.time - 0.2, 0.02)
    channel = _again(made, replace(log, fn=log.fn + knocks))
    found = diagnose_channels([channel], {name: e for name, e in EFFECTS.items() if name != "belt_splice"})
    assert found.p_unknown > 0.9 and not found.active
    assert found.location is not None and found.location.depends_on == ("time",) and found.location.subsystem == "wheel"


def test_a_single_tone_is_no_knock_and_nothing_of_the_catalogue(made: Made, tmp_path):  # noqa: F811
    def tone(c, F):
        return 0.12 * (F > 0) * np.cos(2 * np.pi * 9.4 * c["time"] + 1.0)

    log, _ = _log(made.base, (Planted(reading=tone),), tmp_path)
    found = diagnose_channels([_again(made, log)], EFFECTS)
    assert found.p_unknown > 0.8 and found.verdict == "unexplained"
    assert found.location is not None and found.location.depends_on == ("time",)


@pytest.mark.parametrize(("kind", "hz", "tones"), [("time", 11.7, 1), ("time", 5.9, 3), ("time", 42.44, 1), ("turn", 0.0, 1)])
def test_what_hums_with_a_phase_of_its_own_in_each_run_is_no_knock(made: Made, kind, hz, tones):  # noqa: F811
    """Among so many rates of the campaign's clock the knocks of some fall on what each run shows."""
    log, scene = made.channel.log, made.channel.problem.scene
    c = scene.conditions
    phase = 2 * np.pi * hz * c.time + np.random.default_rng(2).uniform(0.0, 6.28, 20)[log.run]
    if kind == "turn":  # an oval wheel that turned on between runs: its friction shows it too
        phase = 2.0 * c.clock * np.abs(c.belt) / scene.cell.wheel.radius
    hum = 0.25 * log.contact * sum(np.sin(k * phase) / k for k in range(1, tones + 1))
    shear = 0.0 if kind == "time" else scene.shear * hum
    channel = _again(made, replace(log, fn=log.fn + hum, ft=log.ft + shear))
    assert likely_trains(channel.problem, channel.fit).found
    found = diagnose_channels([channel], {"belt_splice": EFFECTS["belt_splice"]})
    assert found.p_unknown > 0.9 and not found.active and found.verdict == "unexplained"
    assert found.location is not None and found.location.depends_on == (kind, "run")
    wave = next(w for w in channel.waves if w.where.startswith(f"{kind} {'period' if tones > 1 else 'wave'} x"))
    assert wave.number == pytest.approx(hz or 2.0, rel=0.01)
    assert wave.columns.shape[1] == 2 * tones * len(np.unique(log.run[log.contact]))


def test_a_run_with_a_standing_belt_has_no_waves_of_the_wheels_turn(made: Made):  # noqa: F811
    """What it reads beside the others is an offset, which is what a stopped belt is there to show."""
    problem, log = made.channel.problem, made.channel.log
    at = log.run == np.unique(log.run[log.contact])[2]
    conditions = replace(problem.scene.conditions, belt=np.where(at, 0.0, problem.scene.conditions.belt))
    still = replace(log, fn=log.fn + 0.5 * at * log.contact, ft=np.where(at, 0.0, log.ft))
    problem = replace(problem, scene=replace(problem.scene, conditions=conditions), log=still)
    assert not [w for w in telling_waves(problem, fit_effects(problem, (), made.channel.fit)) if w.where.startswith("turn wave")]


def test_a_log_of_one_run_has_no_waves_of_single_runs(made: Made):  # noqa: F811
    log = made.channel.log
    problem = _part(made.channel.problem, np.flatnonzero(log.run == log.run[0]))
    waves = telling_waves(problem, fit_effects(problem))
    assert waves and not any(w.where.endswith("run") for w in waves)


def test_a_saw_along_the_path_is_one_unknown_with_its_overtones(made: Made, tmp_path):  # noqa: F811
    def saw(c, F):
        return 0.16 * (F > 0) * np.where(c["run"] == 1, -1.0, 1.0) * (2.0 * np.mod(c["s"] / 0.014, 1.0) - 1.0)

    log, _ = _log(made.base, (Planted(reading=saw),), tmp_path)
    channel = _again(made, log)
    period = next(w for w in channel.waves if w.where == "s period x travel")
    assert period.number == pytest.approx(1 / 0.014, rel=0.02) and period.columns.shape[1] == 2 * OVERTONES
    assert picked_squares([period]) == pytest.approx(chi2.isf(1.0 / period.among, 6) - 6.0)
    found = diagnose_channels([channel], EFFECTS)
    assert found.p_unknown > 0.9 and not found.active
    assert found.location is not None and found.location.depends_on == ("s", "travel")
    (patch,) = found.patches[0].active
    orders = [float(name.split()[3]) * 0.014 / (2 * np.pi) for name in patch.scanned["features"]]
    assert orders == pytest.approx([1, 1, 2, 2, 3, 3], rel=0.02)
    fitted = channel.with_active((patch,)).active[0].a[1::2]  # sines of a saw: -2 / (pi k) each
    assert fitted / fitted[0] == pytest.approx([1.0, 0.5, 1 / 3], abs=0.12)


@pytest.mark.parametrize("share", [1 / 3, 1 / 4, 2 / 5, 3 / 7])
def test_a_tone_at_a_share_of_the_logging_rate_is_no_knock(share):
    """Many of the tones of such a rate have one image: they say once what they say."""
    time, half = 0.01 * np.arange(1500), 50.0
    numbers = np.arange(0.1, 0.8 * half, 1.0 / (FINE * time[-1]))
    gain = np.where(np.abs(numbers - 2 * half * share) < 1.0 / time[-1], 12.0, 2.0)  # the largest of noise alone
    assert not list(_knocks(numbers, gain, half, time, np.ones(len(time))))


def test_a_log_too_slow_for_knocks_has_waves_all_the_same(made: Made):  # noqa: F811
    """Half its logging rate lies below the slowest belt."""
    log = made.channel.log
    step = float(np.median(np.diff(log.time)[np.diff(log.run) == 0]))
    problem = _part(made.channel.problem, np.arange(0, len(log), round(0.125 / step)))
    waves = telling_waves(problem, fit_effects(problem))
    assert "time wave" in {w.where for w in waves} and "time knocks" not in {w.where for w in waves}


def test_recordings_of_a_few_rows_have_no_period(made: Made):  # noqa: F811
    channel = made.channel
    few = np.flatnonzero(made.channel.log.contact)[:9]
    problem = _part(channel.problem, few)
    waves = telling_waves(problem, fit_effects(problem))
    assert not [w for w in waves if "period" in w.where]


def test_a_tone_that_a_period_holds_is_picked_once(made: Made):  # noqa: F811
    x = np.linspace(0.0, 3.0, 500)
    tones = np.column_stack([f(2 * np.pi * k * x) for k in (1, 2, 3) for f in (np.cos, np.sin)])
    period = Wave("s period", 1.0, tones, 200)
    for columns, alone in ((tones[:, 2:4], False), (np.cos(2 * np.pi * 4.2 * x)[:, None] * [1.0, 1.0], True)):
        wave = Wave("s wave", 0.0, columns, 200)
        more = 2.0 * np.log(200) - 2.0 if alone else 0.0
        assert picked_squares([wave, period]) == pytest.approx(picked_squares([period]) + more)
        assert picked_squares([replace(wave, where="time wave"), period]) > picked_squares([period]) + 1.0
        knocks, held = replace(period, where="time knocks"), replace(period, where="time period", columns=tones[:, :4])
        assert picked_squares([replace(wave, where="time wave"), held, knocks]) == pytest.approx(picked_squares([knocks]) + more)


def test_what_presses_shows_in_both_readings_and_not_in_the_air(made: Made, tmp_path):  # noqa: F811
    """A belt that wanders on a clock: no steps of wheel and blade that happen to fit, as its friction says where it acts."""
    clock = made.base.columns["clock"]
    wave = np.sin(5.0 * np.pi * (clock - clock.min()) / np.ptp(clock) + 1.0)
    log, _ = _log(made.base, (Planted(overlap=lambda base: 6e-5 * wave),), tmp_path)
    channel = _again(made, log)
    kernel = next(k for k in kernels(channel.conditions) if k.where == "clock wave")
    own, reading = kernel.changes[:, :, 0], kernel.changes[:, :, kernel.changes.shape[2] // 2]
    assert np.allclose(own, channel.conditions.pressed[:, :, None] * reading[:, :1])
    touching = log.contact
    assert np.abs(own[~touching]).max() == 0.0 < np.abs(own[touching, 1]).max() and np.abs(reading[:, 1]).max() == 0.0
    found = diagnose_channels([channel], EFFECTS)
    assert found.p_unknown > 0.9 and not found.active


def test_columns_beside_a_delay_are_what_the_prediction_does(made: Made):  # noqa: F811
    active = tuple(
        replace(_active(name, scanned=scanned), a=np.array(a))
        for name, scanned, a in (
            ("time_delay", {"size": 0.01}, [0.04]),
            ("wheel_relaxation", {"tau": 0.5, "acts_g": 0.2}, [0.2]),
            ("sensor_gain", {}, [0.03]),
            ("wheel_wear", {}, [2e-7]),
        )
    )
    problem = made.channel.problem
    fit = fit_effects(problem, active, made.channel.fit)
    z = fit.z + 0.3
    at = fitting._at(problem, z, fit.active, fit.at)
    at = fitting._at(problem, z, fit.active, at)
    made_columns = linear(problem, z, at, fit.whiteners)
    rng = np.random.default_rng(4)
    for _ in range(4):
        direction = rng.normal(size=len(z))
        direction /= np.linalg.norm(direction)
        moved = [z - 1e-3 * direction, z + 1e-3 * direction]
        ends = [problem.residuals(fitting._at(problem, to, fit.active, at), to) for to in moved]
        slope = np.concatenate([w.whole((b - a)[:, None])[:, 0] for w, a, b in zip(fit.whiteners, *ends, strict=True)]) / 2e-3
        wanted = -made_columns.sensitivity @ direction
        assert np.linalg.norm(slope - wanted) < 0.02 * np.linalg.norm(wanted)


def test_names_without_a_fit_are_left_out_of_the_search(made: Made, tmp_path, monkeypatch):  # noqa: F811
    log, _ = _log(made.base, (Planted(reading=lambda c, F: 0.8 + 0.0 * F),), tmp_path)
    channel = _again(made, log)
    known = {n: EFFECTS[n] for n in ("sensor_bias", "sensor_drift", "wheel_wear")}
    assert diagnose_channels([channel], known).explanations[0].names[0].effect == "sensor_bias"
    original = type(channel).with_active

    def restless(self, active):
        if any(a.effect.name == "sensor_bias" for a in active):
            raise Infeasible("no rest")
        return original(self, active)

    bias = _active("sensor_bias")
    monkeypatch.setattr(type(channel), "with_active", restless)
    problem, search = search_and_refit(linearised([channel], known, Options()), known, Options())
    chosen = {problem.pool.families[f].name.effect for key in search.sets for f in key}
    assert search.sets[frozenset()] is NOTHING and not any(a.effect.name == "sensor_bias" for a in problem.channels[0].active)
    assert chosen  # others are still weighed
    diverged = Diverged()
    for names in (["sensor_bias", "wheel_wear"], ["sensor_bias"]):
        diverged.add(Name(n, 0) for n in names)
    assert diverged.names() == [Name("sensor_bias", 0)]
    # What a fit holds may fail for others' sake; and without effects nothing failed.
    held = Diverged()
    held.converged([Name("wheel_wear", 0)])
    for other in ("sensor_bias", "sensor_drift"):
        held.add([Name("wheel_wear", 0), Name(other, 0)])
    held.add([])
    assert not held.names() and len(held.sets) == 2 and not held.hopeless
    held.converged([])
    held.add([Name("sensor_bias", 0)])
    assert held.names() == [Name("sensor_bias", 0)]
    held.converged([Name("wheel_wear", 0), Name("sensor_bias", 0)])
    assert not held.names() and len(held.sets) == 2
    search = Search(problem.pool, 3, 4)
    search.begin()
    search.grow()
    assert any("sensor_bias" in {problem.pool.families[f].name.effect for f in key} for key in search.sets)
    diverged.strike(search, problem)
    left = {frozenset(problem.pool.families[f].name.effect for f in key) for key in search.sets}
    assert frozenset() in left and frozenset({"sensor_drift"}) in left and not any("sensor_bias" in names for names in left)
    # Where one fit after another diverges, what no fit has held is given up with them.
    last = Search(problem.pool, 3, 4)
    last.begin()
    last.grow()
    lost = Diverged(fitted={Name("wheel_wear", 0)})
    for name in ("sensor_bias", "sensor_gain", "belt_tension"):
        assert not lost.hopeless
        lost.add([Name(name, 0)], "force")
    assert lost.hopeless and len(lost.names()) == 3 and lost.channels == {"force"}
    lost.strike(last, problem)
    named = {problem.pool.families[f].name.effect for key in last.sets for f in key if not (last.kernel | last.background)[f]}
    assert named <= {"wheel_wear"} and frozenset() in last.sets
    lost.converged([Name("wheel_wear", 0)])
    assert not lost.hopeless and not lost.channels
    # Nothing fits with the name that the readings ask for: it is not told, and what is told says why.
    found = diagnose_channels([channel], known)
    assert not any(n.effect == "sensor_bias" for e in found.explanations for n in e.names)
    assert not found.active or all(a.effect.name != "sensor_bias" for a in found.active)
    # Nothing fits with any name: a log on its own is told as such.
    monkeypatch.setattr(type(channel), "with_active", lambda self, active: restless(self, [bias] if active else active))
    found = diagnose_channels([channel], known)
    assert not found.active and "force: 3 fits in a row come to no rest, so no other name was tried" in found.unknown_reasons


def test_a_name_that_no_fit_of_all_readings_takes_is_not_told(made: Made, tmp_path, monkeypatch):  # noqa: F811
    log, _ = _log(made.base, (Planted(reading=lambda c, F: 0.8 + 0.0 * F),), tmp_path)
    channel = _again(made, log)
    known = {n: EFFECTS[n] for n in ("sensor_bias", "sensor_drift", "wheel_wear")}
    problem, search = search_and_refit(linearised([channel], known, Options()), known, Options())
    fits, sets = diagnosis.refitted, dict(search.sets)
    monkeypatch.setattr(
        diagnosis,
        "refitted",
        lambda b, p, active: None if "sensor_bias" in {a.effect.name for a in active} else fits(b, p, active),
    )
    found = findings((channel,), problem, problem, search, known, Options())
    assert not any(n.effect == "sensor_bias" for e in found.explanations for n in e.names)
    assert "sensor_bias" not in {a.effect.name for a in found.active} and found.verdict != "no_gap"
    assert any("sensor_bias: no fit with it comes to rest" in why for why in found.unknown_reasons)
    tried: list[object] = []
    search.sets = sets
    monkeypatch.setattr(diagnosis, "refitted", lambda b, p, active: tried.append(active) if active else fits(b, p, active))
    found = findings((channel,), problem, problem, search, known, Options())
    assert 1 <= len(tried) <= HOPELESS_FITS and not found.active


@pytest.mark.parametrize("halvings, level, most", [(10, 1e3, 2), (10, 0.0, 5), (8, 1e3, 6)])
def test_a_fit_that_cannot_rest_is_refused_before_long(made: Made, monkeypatch, halvings, level, most):  # noqa: F811
    calls = []

    def never(at, change, precision, now, rule):
        calls.append(1)
        return replace(at, z=at.z + 1e-3 * change), np.full(2 * len(at.problem.log), level), halvings

    monkeypatch.setattr("robots.gauss_newton._shortened", never)
    monkeypatch.setattr(fitting, "RULE", replace(fitting.RULE, valley=replace(fitting.RULE.valley, still=-1.0)))
    start = made.channel.fit
    with pytest.raises(Infeasible, match="does not come to rest"):
        fit_effects(made.channel.problem, (_active("sensor_bias"),), replace(start, z=start.z + 0.5))
    assert len(calls) <= most
    assert most != fitting.RULE.valley.lost or len(calls) == most  # no way down is told at once


def test_folds_that_leave_little_are_not_asked(made: Made):  # noqa: F811
    contact = made.channel.log.contact
    for fold in made.channel.folds():
        assert (~fold.held & contact).sum() >= contact.sum() / 3


def test_left_out_readings_are_the_same_ones_with_and_without_a_name(made, tmp_path):  # noqa: F811
    """Without the splice its knocks are gross readings: errors of the two could not be compared row by row."""
    log, _ = _log(made.base, (Planted(reading=lambda c, F: 9.0 * (F > 0) * bell(8.37 * c["time"], 0.02)),), tmp_path)
    channel = _again(made, log)
    after = channel.with_active((_active("belt_splice", scanned=channel.surroundings.splice_trains[0]),))
    weights = [c.fit.whiteners[0].noise.weight > 0.1 for c in (channel, after)]
    assert weights[0].sum() < weights[1].sum()
    for fold in after.folds():
        without, named = after.held_out(fold, ()), after.held_out(fold, after.active)
        assert (without is None) == (named is None)
        assert without is None or without.rows.shape == named.rows.shape


def test_a_fit_that_leaves_what_can_be_computed_is_said_so(made):  # noqa: F811
    active, fit = replace(_active("flange_stiffness"), a=np.array([np.nan])), made.channel.fit  # stops and cover bound any number
    with pytest.raises(Infeasible, match="the fit of the force log"):
        fit_effects(made.channel.problem, (active,), replace(fit, at=replace(fit.at, active=(active,))))


@pytest.mark.parametrize("noise, said", [(4.9, ""), (5.1, "by more than a contact that holds can")])
def test_scatter_with_which_no_contact_holds_is_told(noise, said):
    log = SimpleNamespace(fn=np.array([0.0, 20.0, 20.0]), contact=np.array([False, True, True]))
    fit = SimpleNamespace(rested=True)
    channel = SimpleNamespace(log=log, noise_floor=noise, baseline=SimpleNamespace(fit=fit))
    assert ForceChannel.scatters.fget(channel) == said


def test_a_log_near_which_no_believed_contact_comes_is_unexplained(made: Made, monkeypatch, shared_data, tmp_path):  # noqa: F811
    """Three newtons everywhere, in the air too: a name that a search beside a minimum would take at once."""
    log, _ = _log(made.base, (Planted(reading=lambda c, F: np.full_like(F, 3.0)),), tmp_path)
    again = _again(made, log)
    monkeypatch.setattr(fitting, "RULE", replace(fitting.RULE, steps=1))
    channel = replace(again, fit=fit_effects(again.problem), before=None)
    assert not channel.fit.rested

    def forbidden(*_: object) -> None:
        raise AssertionError("a name was fitted beside no minimum")

    monkeypatch.setattr(fitting, "units_of", lambda active: forbidden() if active else np.zeros(0))
    found = diagnose_channels([channel], {"sensor_bias": EFFECTS["sensor_bias"]})
    assert found.p_unknown > 0.5 and not found.active
    assert any("finds no rest" in why for why in found.unknown_reasons)
    # What the tracker read is judged on its own.
    arm = tracker_channel(read_data_set(shared_data / "worlds" / "tracker_no_effect", None))
    both = diagnose_channels([arm, channel], {name: EFFECTS[name] for name in ("sensor_bias", "encoder_scale")})
    assert [c.name for c in both.channels] == [c.name for c in both.baseline] == [arm.name, channel.name]
    assert both.p_unknown > 0.5 and any("finds no rest" in why for why in both.unknown_reasons)
    assert not both.active
