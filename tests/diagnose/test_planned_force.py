"""Planned grinding: the smallest sizes told before any data, and which grinding would tell rivals apart."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import ocp.diagnose.foresee.planned_grinding as planned_module
from ocp.calibrate.force.log import ForceLog, read_force_log
from ocp.calibrate.force.noise import CorrelatedNoise
from ocp.diagnose.engine.evidence import Rival, project, size_grid, visible_lambda
from ocp.diagnose.engine.findings import Diagnosis, Name, Options, Ranked, Screened
from ocp.diagnose.force.channel import ForceChannel, force_channel
from ocp.diagnose.force.fit import fit_effects
from ocp.diagnose.foresee.design import design_text, energy_of, smallest_visible, visible_in
from ocp.diagnose.foresee.next_experiment import next_experiments
from ocp.diagnose.foresee.planned_grinding import (
    Shared,
    foreseen_force,
    grindings,
    more_grinding,
    noise_of_means,
    planned_force_channel,
    tracker_beside,
    unseen,
    usual_recordings,
)
from ocp.diagnose.foresee.planned_tracker import arm_expected, default_poses, planned_channel
from ocp.diagnose.foresee.separation import RivalPair, unlike
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import library
from ocp.effects.effect import Active, Effect
from ocp.model.cell import read_tracker_setup
from robots.errors import BadInput
from robots.kinematics import link_frames
from tests.support.diagnosis_force_world import HEADER, Base, Planted, log_of
from tests.support.force_world import arm_posterior, write_log

EFFECTS = library()
SLOW = ("sensor_bias", "wheel_wear", "wheel_law", "tangential_force", "material_removal", "flange_friction", "sensor_gain")
SIGMA = 0.2  # N, of the made log


@dataclass(frozen=True)
class Made:
    base: Base
    channel: ForceChannel


@pytest.fixture(scope="module")
def made(tmp_path_factory, solved_once, force_campaign_once):
    base = force_campaign_once
    log = logged(base, (), tmp_path_factory.mktemp("world"))
    return Made(base, force_channel(base.world.cell, log, arm=arm_posterior(base.world.cell)))


def logged(base: Base, planted: tuple[Planted, ...], folder: Path) -> ForceLog:
    base.rng.bit_generator.state = np.random.default_rng(3).bit_generator.state
    return read_force_log(write_log(folder / "force.csv", log_of(base, planted)[0], HEADER))


def as_planned(made: Made, sigma: float = SIGMA) -> ForceLog:
    log, n = made.channel.log, len(made.channel.log)
    return replace(log, fn=np.full(n, np.nan), sigma_fn=np.full(n, sigma), sigma_ft=np.full(n, 0.3))


def planned_of(made: Made, log: ForceLog, effects: tuple[Effect, ...] | None = None) -> ForceChannel:
    cell = made.base.world.cell
    return planned_force_channel(cell, log, EFFECTS.values() if effects is None else effects, arm_posterior(cell))


@pytest.fixture(scope="module")
def plan(made) -> ForceChannel:
    return planned_of(made, as_planned(made))


def sizes(channel: ForceChannel, names: tuple[str, ...]) -> np.ndarray:
    system = channel.system
    free = project(system.nuisance, system.prior_sd).apply
    found = []
    for name in names:
        effect = EFFECTS[name]
        found.append(smallest_visible(channel, effect, 0, {0: energy_of(channel, free, effect, 0)}, 40))
    return np.array(found)


def ranked(name: str, a: list[float], scanned: dict | None = None, joint: int = 0) -> Ranked:
    effect = EFFECTS[name]
    active = Active(effect, joint, np.array(a), scanned or {}, np.eye(effect.size) * 1e-20)
    return Ranked(Name(name, joint), 0.5, 1.0, active, 30.0)


# -- smallest sizes --------------------------------------------------------------------------------------------------


def test_a_plan_tells_the_sizes_that_its_measured_log_shows(made, plan):
    told, shown = sizes(plan, SLOW), sizes(made.channel, SLOW)
    assert np.isfinite(told).all() and np.allclose(told / shown, 1.0, atol=0.3), told / shown
    system = plan.system
    energy = energy_of(plan, project(system.nuisance, system.prior_sd).apply, EFFECTS["wheel_wear"], 0)
    assert 20 < told[SLOW.index("wheel_wear")] ** 2 * energy < 60  # lambda at which one variant is named nine times of ten


def test_noise_makes_sizes_larger_in_proportion(made, plan):
    loud = planned_of(made, as_planned(made, 3 * SIGMA), tuple(EFFECTS[n] for n in SLOW))
    ratio = sizes(loud, ("wheel_wear", "material_removal")) / sizes(plan, ("wheel_wear", "material_removal"))
    assert (1.2 < ratio).all() and (ratio < 3.3).all()


def test_every_fourth_row_with_the_noise_of_four_tells_the_same(made, plan, monkeypatch):
    monkeypatch.setattr(planned_module, "MOST", len(made.channel.log) // 4 + 20)
    thin = planned_of(made, as_planned(made))
    assert len(thin.log) < 0.3 * len(plan.log)
    ratio = sizes(thin, SLOW) / sizes(plan, SLOW)
    assert np.allclose(ratio, 1.0, atol=0.06), ratio


def test_means_keep_what_lasts():
    noise = noise_of_means(CorrelatedNoise(0.3, 0.5, 0.05), 4)
    assert noise.sigma**2 * noise.share == pytest.approx(0.5 * 0.09)
    assert noise.sigma**2 * (1 - noise.share) == pytest.approx(0.5 * 0.09 / 4)


@pytest.mark.parametrize(("factor", "named"), [(1.1, True), (0.4, False)])
def test_an_effect_above_the_size_told_is_named_and_one_below_is_not(made, plan, tmp_path, factor, named):
    size = factor * sizes(plan, ("wheel_wear",))[0] * 1e-6
    log = logged(made.base, (Planted(overlap=lambda b: -size * b.columns["clock"]),), tmp_path)
    problem = replace(made.channel.problem, log=log)
    channel = ForceChannel(problem, fit_effects(problem, (), made.channel.fit), made.channel.effects)
    found = diagnose_channels([channel], EFFECTS, Options(where=False, folds=False))
    assert (found.p_none < 0.5) == named, (found.p_none, found.explanations[:3])


def test_a_rival_pays_for_what_the_readings_show_of_it():
    rival = Rival(np.array([0.005, 0.01]), np.log(0.09), 5)
    alone, felt, hidden = (
        visible_lambda(1e5, 1, size_grid(0.03), np.log(2e-3), *more) for more in ((None,), (rival,), (rival, np.zeros(5)))
    )
    assert 15 < alone < 60 and alone <= felt < 0.8 * hidden
    assert visible_lambda(1e5, 1, size_grid(0.03), np.log(2e-3), rival, np.full(5, 1e5)) == felt


def test_a_plan_without_clock_or_shear_is_blind_to_what_needs_them(made, plan):
    log = replace(as_planned(made), clock=None, ft=None)
    known = [EFFECTS[n] for n in ("sensor_drift", "tangential_force", "wheel_runout", "tracker_scale")]
    lines = {line.effect.name: line for line in visible_in(planned_of(made, log, tuple(known)), known)}
    assert "clock_s" in lines["sensor_drift"].blind and "tracker_scale" not in lines
    assert lines["tangential_force"].smallest > 1.1 * sizes(plan, ("tangential_force",))[0]


def test_the_table_says_what_shows_each_effect(made, tmp_path):
    log, cell = made.channel.log, made.base.world.cell.path
    keep = [k for k, name in enumerate(HEADER) if name not in ("fn_N", "ft_N")]
    lines = log.path.read_text().splitlines()
    path = tmp_path / "planned.csv"
    path.write_text("\n".join(",".join(line.split(",")[k] for k in keep) for line in lines))
    told = design_text(cell, None, path)
    rows = {line.split()[0]: line for line in told.splitlines() if line}
    assert "needs the tracker (--poses)" in rows["tracker_scale"] and "cannot be seen" in rows["flange_gravity"]
    assert float(rows["wheel_wear"].split()[-1]) < 3e-7
    assert f"the {len(log)} rows of planned.csv (10 recordings)" in told and "no column ft_N" in told and "0.3 N" in told
    without = {line.split()[0]: line for line in design_text(cell, None).splitlines() if line}
    assert "needs a force log (--log)" in without["wheel_wear"] and "needs" not in without["backlash"]


@pytest.mark.parametrize(("down", "z_mm"), [((0, 0, -1), 600.0), ((0, 0, 1), -1500.0)])
def test_proposed_postures_keep_above_the_floor(tmp_path, down, z_mm):
    text = 'name = "c"\n[robot]\nmodel = "kr210_r2700_extra"\ngravity_direction = [{:g}, {:g}, {:g}]\n'.format(*down)
    cell = tmp_path / "cell.toml"
    cell.write_text(text)
    up = -np.array(down, float)

    def lowest(readings):
        setup = read_tracker_setup(cell)
        return (link_frames(setup.robot, readings.q)[:, 2:, :3, 3] @ up).min()

    assert lowest(default_poses(read_tracker_setup(cell), 40, full=False)) < 1e-3 * z_mm  # or the floor is no floor
    cell.write_text(f"{text}[floor]\nz_mm = {z_mm}\n")
    told = default_poses(read_tracker_setup(cell), 40, full=False)
    assert len(told.q) == 40 and lowest(told) > 1e-3 * z_mm
    cell.write_text(f"{text}[floor]\nz_mm = 9000\n")
    with pytest.raises(BadInput, match="no posture of the arm stands above floor.z_mm = 9000"):
        default_poses(read_tracker_setup(cell), 40, full=False)


def test_the_arm_of_a_plan_is_known_as_its_readings_leave_it(made):
    setup = read_tracker_setup(made.base.world.cell.path)
    few, many = (planned_channel(setup, default_poses(setup, n, full=True)) for n in (40, 160))
    J = (few.fit.W @ few.fit.linear.J).reshape(-1, few.task.layout.size)
    size = np.linalg.norm(J, axis=0) + 1e-12
    prior = np.where(np.isfinite(few.task.layout.prior_sd), few.task.layout.prior_sd, np.inf) ** -2.0
    direct = np.linalg.inv(J.T @ J / np.outer(size, size) + np.diag(prior / size**2)) / np.outer(size, size)
    known, more = arm_expected(few), arm_expected(many)
    columns = [few.task.layout.index(n) for n in known.names if n in few.task.layout.names]
    inside = [k for k, n in enumerate(known.names) if n in few.task.layout.names]
    assert len(inside) > 20
    assert np.sqrt(np.diag(known.covariance))[inside] == pytest.approx(np.sqrt(np.diag(direct))[columns], rel=1e-3)
    assert np.diag(more.covariance).sum() < np.diag(known.covariance).sum()


# -- what to grind next ----------------------------------------------------------------------------------------------


WEAR = ranked("wheel_wear", [5e-8])


def test_recordings_share_the_nuisance_and_nothing_else(made):
    channel, pair = made.channel, RivalPair(WEAR, EFFECTS["sensor_drift"], 0, 0.5)
    log, rows = channel.log, channel.problem.scene.rows
    halves = [log.run <= 4, log.run > 4]
    effects = (EFFECTS["wheel_wear"], EFFECTS["sensor_drift"])
    whole = Shared(foreseen_force(channel, log, rows, effects))
    parts = [Shared(foreseen_force(channel, log.take(h), rows.take(h), effects)) for h in halves]
    for one in (pair, replace(pair, rival=None)):
        together = unlike(parts, one)
        assert together == pytest.approx(unlike([whole], one), rel=0.05)
        # With a wheel and a blade of their own each half would tell less.
        assert unlike([], one, parts) < 0.9 * together


def test_more_grinding_never_tells_less(made):
    for rival in (None, EFFECTS["sensor_drift"], EFFECTS["wheel_runout"]):
        pair = RivalPair(WEAR, rival, 0, 0.5)
        own, planned = more_grinding(made.channel, [pair])
        now = unlike([own], pair)
        assert len(planned) >= 9 and now > 0
        for _, there in planned:
            assert unlike([own, there], pair) >= now - 1e-6
        _, known, readings = tracker_beside(own)
        assert unlike([known], pair, [readings]) >= now - 1e-6


def test_recordings_come_after_the_log_as_they_are_described(made):
    channel = made.channel
    old = channel.log
    found = {g.do.split(":")[0]: g for g in grindings(channel)}
    last = float(old.clock.max())
    assert all(np.all(g.log.clock > last) and np.isnan(g.log.fn).all() and g.minutes > 2 for g in found.values())
    pause, again, feed = found["pause"], found["repeat"], found["feed ladder"]
    assert pause.log.clock.min() - last > 1200 and pause.minutes > 20
    assert np.all(pause.log.wheel_temperature == old.wheel_temperature.min())
    assert np.all(again.log.wheel_temperature == old.wheel_temperature[int(np.argmax(old.clock))])
    for line in np.unique(again.log.line):
        before = old.ground_before[(old.line == line) & old.contact].max()
        assert list(np.unique(again.log.ground_before[again.log.line == line])) == [before + 1, before + 2]
    assert set(np.unique(feed.log.feed)) == {0.02, 0.08}
    for run in np.unique(feed.log.run):
        at = feed.log.run == run
        s, time = feed.log.s[at], feed.log.time[at]
        assert abs(np.ptp(s) / np.ptp(time)) == pytest.approx(feed.log.feed[at][0], rel=0.03)
    air = found["air run"]
    assert np.array_equal(air.rows.contact, air.log.contact) and 0 < air.log.contact.mean() < 0.5
    assert np.all(found["belt reversed"].rows.belt == -1) and np.all(found["hold"].rows.belt == 0)
    ladder = found["force ladder"]
    assert np.array_equal(ladder.rows.setpoint, ladder.log.setpoint) and len(np.unique(ladder.log.setpoint)) >= 3
    turned, own = found["other direction"], usual_recordings(channel)[0]
    assert np.array_equal(turned.log.q[: len(own.rows)], old.q[own.rows][::-1])


def diagnosis(channel: ForceChannel, first: Ranked, *rivals: str) -> Diagnosis:
    empty = ((),) * 7
    names = tuple((first.name, Name(r)) for r in rivals)
    told = Diagnosis((), (first,), (first.active,), 0.0, 0.0, (), None, None, *empty, (), (channel,), (channel,))
    return replace(told, classes=tuple(tuple(sorted(n)) for n in names))


def told(found) -> dict[str, object]:
    return {e.do.split(":")[0]: e for e in found}


def test_an_air_run_tells_a_drifting_sensor_and_a_pause_a_warm_wheel(made):
    found = next_experiments(diagnosis(made.channel, WEAR, "sensor_drift"), EFFECTS)
    assert all(e.tells_apart == ("wheel_wear", "sensor_drift") and 0.5 < e.expected <= 1.0 for e in found)
    worth = [(e.expected - 0.5) / e.minutes for e in found]
    assert worth == sorted(worth, reverse=True)
    gained = {}
    for rival in ("sensor_drift", "wheel_temperature"):
        pair = RivalPair(WEAR, EFFECTS[rival], 0, 0.5)
        own, planned = more_grinding(made.channel, [pair])
        gained[rival] = {g.do.split(":")[0]: unlike([own, there], pair) - unlike([own], pair) for g, there in planned}
    drift, heat = gained["sensor_drift"], gained["wheel_temperature"]
    assert drift["air run"] > 5 * heat["air run"], (drift, heat)
    assert heat["pause"] > 2 * heat["repeat"] and heat["pause"] > 5 * heat["air run"], (drift, heat)


def test_one_experiment_is_told_once_for_all_it_settles(made):
    found = next_experiments(diagnosis(made.channel, WEAR, "wheel_temperature", "sensor_drift"), EFFECTS)
    assert len({e.do for e in found}) == len(found)
    assert any(set(e.tells_apart) == {"wheel_wear", "wheel_temperature", "sensor_drift"} for e in found)


def test_what_a_log_leaves_unseen_is_asked_for(made):
    channel, rows = made.channel, made.channel.log.setpoint == 20.0
    log = channel.log.take(rows)
    one_level = foreseen_force(channel, log, channel.problem.scene.rows.take(rows), (EFFECTS["wheel_law"],))
    seen = tuple(Screened(Name(n), 0.0, 1, 1, 1.0, 3.0 if n == "wheel_law" else 0.1, 1.0) for n in EFFECTS)
    empty = ((),) * 4
    d = Diagnosis((), (), (), 1.0, 0.0, (), None, None, *empty, seen, (), (), (), (one_level,), (one_level,))
    assert [p.first.name.effect for p in unseen(d, one_level, EFFECTS)] == ["wheel_law"]
    found = next_experiments(replace(d, screened=seen), EFFECTS)
    assert found and found[0].do.startswith("force ladder") and found[0].tells_apart == ("wheel_law", "none")
    none = tuple(replace(s, smallest=0.1) for s in seen)
    assert next_experiments(replace(d, screened=none), EFFECTS) == ()
