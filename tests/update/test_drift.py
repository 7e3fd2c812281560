"""The filter from blade to blade on logs that the model itself makes: wear is followed and forecast, a jump is said."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.calibrate.force.fit import BIAS, FIT_NAMES, force_prior
from ocp.model.theta import registered
from ocp.update.drift import SURPRISE, Verdict, carried_on, changed_state, last_state, moved_zero, verdict_on
from ocp.update.history import History, history_of
from ocp.update.interface import Updated, _impossible, _older, _unusual, grown, updated
from robots.errors import BadInput, Infeasible
from tests.support.wearing_cell import NOISE, WearingCell, posterior, wearing_cell

RADIUS = FIT_NAMES.index("wheel_radius")
WEAR, BETWEEN = 4e-7, 600.0  # m/s, s from one blade to the next


@pytest.fixture(scope="module")
def world() -> WearingCell:
    return wearing_cell()


def blades(world: WearingCell, count: int, wear: float = WEAR, seed: int = 1) -> list[tuple[np.ndarray, Updated]]:
    """So many updates one after the other, each with the true parameters at its beginning."""
    rng, made, cell = np.random.default_rng(seed), [], world.cell
    truth = force_prior(cell).mean.copy()
    truth[FIT_NAMES.index("wheel_x")] += 1e-5
    for k in range(count):
        x = truth.copy()
        x[RADIUS] -= wear * BETWEEN * k
        log = world.ground(x, BETWEEN * k, wear, rng)
        made.append((x, updated(cell, log, world.setup, history_of(cell.calibration, cell.path), f"log {k}")))
        cell = replace(cell, calibration=made[-1][1].states[3])
    return made


@pytest.fixture(scope="module")
def worn(world) -> list[tuple[np.ndarray, Updated]]:
    return blades(world, 6)


def test_wear_is_followed_and_its_rate_learnt(worn):
    truth, last = worn[-1]
    latest = last.latest
    middle = 1e6 * (truth[RADIUS] - WEAR * (latest["clock_s"] - 5 * BETWEEN))
    assert middle < -1150 and abs(latest["radius_um"] - middle) < 3 * latest["radius_sd_um"] < 200
    assert latest["wear_um_per_h"] == pytest.approx(3.6e9 * WEAR, rel=0.1)
    assert latest["wear_sd_um_per_h"] < 0.2 * 3.6e9 * 3e-7
    assert len(last.history) == 6 and last.history.logs[-1] == "log 5"


def test_the_forecast_is_met_once_the_rate_is_known(worn):
    for _, made in worn[2:]:
        latest = made.latest
        assert abs(latest["found_N"] - latest["expected_N"]) < 3 * np.hypot(latest["expected_sd_N"], NOISE / 12)
        assert latest["found_sd_N"] < latest["expected_sd_N"] < 0.4 and made.verdict.chance > 1e-3
    ahead = worn[-2][1].forecast[0]
    assert abs(ahead[1] - worn[-1][1].latest["found_N"]) < 3 * ahead[2]
    assert worn[-1][1].latest["found_N"] < worn[0][1].latest["found_N"] - 4.0  # nobody planned anew here


def test_the_next_plan_has_the_wheel_of_the_next_blade(world, worn):
    truth, last = worn[-1]
    cell, _ = registered(replace(world.cell, calibration=last.states[3]))
    coming = world.cell.wheel.radius + truth[RADIUS] - WEAR * (last.clocks[1] - 5 * BETWEEN)
    assert last.clocks[1] - last.clocks[0] == pytest.approx(BETWEEN)
    # Wheel, blade and arm share what is not known apart; the force that comes of them all is the one that counts.
    assert cell.wheel.radius == pytest.approx(coming, abs=6e-5)
    x = force_prior(replace(world.cell, calibration=last.states[3])).mean
    true = truth.copy()
    true[RADIUS] -= WEAR * (last.clocks[1] - 5 * BETWEEN)
    assert np.abs(world.model.force(world.rows, x[:BIAS]) - world.model.force(world.rows, true[:BIAS])).mean() < 0.3


@pytest.mark.parametrize(
    ("name", "size", "part"), [("wheel_x", 6e-4, "wheel"), ("blade_y", 1e-3, "blade"), ("wheel_radius", 6e-4, "belt")]
)
def test_a_jump_is_said_and_taken_only_where_the_user_says_so(world, worn, name, size, part):
    truth, last = worn[-1]
    cell = replace(world.cell, calibration=last.states[3])
    x = truth.copy()
    x[RADIUS] -= WEAR * BETWEEN
    x[FIT_NAMES.index(name)] += size
    log = world.ground(x, 6 * BETWEEN, WEAR, np.random.default_rng(5))
    history = history_of(cell.calibration, cell.path)
    with pytest.raises(Infeasible, match=r"cannot have come from the cell as last known.*--changed"):
        updated(cell, log, world.setup, history, "jump")
    told = updated(cell, log, world.setup, history, "jump", (part,))
    assert told.latest["found_N"] == pytest.approx(told.latest["measured_N"], abs=0.1)


def test_a_small_jump_that_is_taken_for_wear_is_told(world, worn):
    """A wheel moved so little that the log is used."""
    truth, last = worn[-1]
    cell, found = replace(world.cell, calibration=last.states[3]), {}
    for size in (0.0, 1.1e-4):
        x = truth.copy()
        x[RADIUS] += size - WEAR * BETWEEN
        log = world.ground(x, 6 * BETWEEN, WEAR, np.random.default_rng(5))
        found[size] = updated(cell, log, world.setup, history_of(cell.calibration, cell.path), "jump")
    assert not found[0.0].notices
    (told,) = found[1.1e-4].notices
    assert SURPRISE < found[1.1e-4].verdict.chance < 0.02
    assert "is unlike what was forecast" in told and "--changed, of wheel, blade, flange, belt, sensor" in told


def test_a_sensor_set_to_another_zero_is_seen_in_the_air(worn, monkeypatch):
    """Few rows in the air tell it: of what the contact shows it would be wear."""
    fn, contact = np.array([0.1, 0.3, 0.25, 9.0, 20.0]), np.array([False, False, False, False, True])
    sigma = np.array([0.3, 0.3, 0.3, 0.3, 5.0])
    noise = SimpleNamespace(sigma=lambda: sigma, independent=lambda contact: 7.0 if contact else 2.0)
    prior = SimpleNamespace(mean=np.eye(BIAS + 1)[BIAS] * -0.225, covariance=0.04 * np.eye(BIAS + 1))
    log, solution = SimpleNamespace(fn=fn, contact=contact), SimpleNamespace(channel=noise, prior=prior)
    assert moved_zero(solution, log) == pytest.approx(0.5 / np.sqrt(0.04 + 0.09 * np.pi / 4))
    assert moved_zero(solution, SimpleNamespace(fn=fn, contact=fn < 99)) is None
    last = worn[-1][1]
    told = []
    for zero in (None, 2.0, 3.0, -6.0):
        monkeypatch.setattr("ocp.update.drift.moved_zero", lambda *_, zero=zero: zero)
        told.append(verdict_on(last.fit.solution, last.log, 0.1))
    plain, same, unusual, refused = told
    assert same == plain and plain.possible and plain.chance > 0.02
    assert unusual.possible and unusual.chance == pytest.approx(2 * 0.0027, rel=0.01) and not refused.possible
    assert refused.moves[0] == ("sensor_bias", -6.0) and len(refused.moves) == len(plain.moves)


def test_a_log_from_before_the_calibration_is_told():
    calibration = SimpleNamespace(provenance={"force": {"clock_s": 1036.0}})
    cell, path = SimpleNamespace(calibration=calibration), Path("force.csv")
    for begins, holds, count in ((52.0, None, 1), (1036.0, None, 0), (52.0, 2000.0, 0)):
        log = SimpleNamespace(path=path, clock=np.array([begins, begins + 9.0]))
        told = _older(cell, log, SimpleNamespace(holds=holds))
        assert len(told) == count and all("begins at 52 s, before the calibration's force log ended (1036 s)" in t for t in told)
    assert not _older(cell, SimpleNamespace(path=path, clock=None), SimpleNamespace(holds=None))


def test_wear_of_which_the_log_itself_shows_nothing_is_no_wear():
    log, fit = SimpleNamespace(path="force.csv"), SimpleNamespace(figures=SimpleNamespace(mean_before=-1.0, rms_before=1.1))
    before, inside = Verdict(3.0, 1, 0.03, (("wheel_radius", 2.0),)), Verdict(300.0, 1, 1e-40, (("flange_stiffness", 16.0),))
    told = _impossible(log, fit, (before, inside), ("belt",))
    assert "inside the log there is none of it (chance 1e-40)" in told and "(--changed, of wheel, blade, flange, sensor)" in told
    assert "flange_stiffness would have moved by 16.0" in _impossible(log, fit, (inside, inside), ())


def test_chances_of_logs_of_the_cell_itself_are_spread_evenly(world):
    """Truth drawn from the state that is handed in: the verdict must not cry wolf, nor sleep."""
    rng, chances = np.random.default_rng(2), []
    state = carried_on(last_state(world.cell), 0.0, 1)
    root = np.linalg.cholesky(state.covariance + 1e-30 * np.eye(len(state.names)))
    for _ in range(24):
        x = force_prior(world.cell).mean.copy()
        drawn = state.values + root @ rng.normal(size=len(root))
        for i, name in enumerate(state.names):
            if name in FIT_NAMES:
                x[FIT_NAMES.index(name)] = drawn[i]
        log = world.ground(x, 0.0, 1.4e-7, rng)
        try:
            chances.append(updated(world.cell, log, world.setup, History(), "one").verdict.chance)
        except Infeasible:
            chances.append(SURPRISE)
    assert min(chances) > SURPRISE and 0.3 < np.mean(chances) < 0.75 and min(chances) < 0.3


def test_time_only_adds_doubt_and_radius_follows_its_rate(world):
    state = last_state(world.cell)
    later = carried_on(state, 7200.0, 2)
    at, wear = state.names.index("wheel_radius"), state.names.index("wheel_wear")
    assert later.values[at] == pytest.approx(-7200.0 * state.values[wear])
    assert (np.diag(later.covariance) >= np.diag(state.covariance)).all()
    assert later.covariance[at, wear] < 0 < later.covariance[at, at]
    blade = state.names.index("blade_x")
    assert later.covariance[blade, blade] - state.covariance[blade, blade] == pytest.approx(2 * 1e-5**2)


def test_a_cell_whose_effects_hold_wear_begins_at_none(world):
    class Wear:
        name = "wheel_wear"

    assert last_state(world.cell).values[-1] > 0
    assert last_state(replace(world.cell, effects=(Wear(),))).values[-1] == 0.0


def test_changed_parts_are_as_doubtful_as_the_cell_says(world):
    state = last_state(world.cell)
    wider = changed_state(state, world.cell, ("wheel", "belt"))
    sd = dict(zip(wider.names, wider.standard_deviation, strict=True))
    assert sd["wheel_x"] == pytest.approx(np.hypot(2e-5, world.cell.wheel.centre_sd)) and sd["wheel_radius"] == pytest.approx(
        3e-4
    )
    assert sd["blade_y"] == pytest.approx(2e-5)


def test_a_clock_started_anew_counts_no_wear_once_and_is_told(world, worn):
    truth, last = worn[-1]
    cell = replace(world.cell, calibration=last.states[3])
    log = world.ground(truth, 0.0, WEAR, np.random.default_rng(6))
    made = updated(cell, log, world.setup, history_of(cell.calibration, cell.path), "anew")
    assert "started anew" in made.notices[0] and made.history.ends > last.history.ends
    x = truth.copy()
    x[RADIUS] -= WEAR * BETWEEN
    later = world.ground(x, BETWEEN, WEAR, np.random.default_rng(7))
    cell = replace(cell, calibration=made.states[3])
    again = updated(cell, later, world.setup, history_of(cell.calibration, cell.path), "later")
    assert not again.notices  # the new clock goes on
    assert again.latest["clock_s"] - made.latest["clock_s"] == pytest.approx(BETWEEN)


def test_a_night_wears_no_wheel_but_leaves_the_place_in_doubt(world, worn):
    """The controller's clock goes on over the weekend: 60 h at 1440 um an hour would be half of the wheel's radius."""
    truth, last = worn[-1]
    cell = replace(world.cell, calibration=last.states[3])
    history = history_of(cell.calibration, cell.path)
    x = truth.copy()
    x[RADIUS] -= WEAR * BETWEEN
    soon, late = (world.ground(x, 6 * BETWEEN + wait, WEAR, np.random.default_rng(8)) for wait in (0.0, 216_000.0))
    soon, late = (updated(cell, log, world.setup, history, "monday") for log in (soon, late))
    assert not soon.notices and "60.0 h later" in late.notices[0]
    assert late.latest["radius_um"] == pytest.approx(soon.latest["radius_um"], abs=60.0)
    assert late.latest["expected_sd_N"] > 1.5 * soon.latest["expected_sd_N"]
    assert late.history.ends == pytest.approx(soon.history.ends) and late.history.offset == pytest.approx(-216_000.0, abs=1.0)


def test_without_a_clock_contact_time_is_the_clock(world):
    truth = force_prior(world.cell).mean
    log = replace(world.ground(truth, 0.0, 0.0, np.random.default_rng(7)), clock=None)
    made = updated(world.cell, log, world.setup, History(), "one")
    assert made.history.ends == pytest.approx(0.25 * 39 * 4)


@pytest.mark.parametrize("told", ["yes", {"ends_s": 1.0}, {"ends_s": "a", "holds_s": 1.0, "logs": [], "history": {}}])
def test_a_history_that_was_edited_is_refused(world, told):
    edited = replace(posterior(world.cell), provenance={"update": told})
    with pytest.raises(BadInput, match="not as ocp.update wrote it"):
        history_of(edited, world.cell.path)


def test_a_history_is_read_back_as_written(worn):
    last = worn[-1][1]
    read = history_of(last.states[3], last.cell.path)
    assert (read.ends, read.holds, read.offset, read.logs) == (last.history.ends, last.history.holds, 0.0, last.history.logs)
    for name, values in last.history.columns.items():
        np.testing.assert_allclose(read.columns[name], values, atol=1e-8)


def test_the_rate_is_learnt_beside_a_stiffness_that_is_hardly_known(world):
    """Newtons per metre beside metres: the covariance of the state spans twenty orders of magnitude."""
    known = world.cell.calibration
    wide = np.where([n == "flange_stiffness" for n in known.names], 800.0 / known.standard_deviation, 1.0)
    cell = replace(world.cell, calibration=replace(known, covariance=known.covariance * np.outer(wide, wide)))
    made = blades(replace(world, cell=cell), 3)
    sd = [one.latest["wear_sd_um_per_h"] for _, one in made]
    assert sd[-1] < 0.5 * sd[0] and made[-1][1].latest["wear_um_per_h"] == pytest.approx(3.6e9 * WEAR, rel=0.25)


def test_a_rigid_mount_is_updated_too():
    """60 N/mm: 5 um of wear are a third of a newton."""
    rigid = wearing_cell(flange=False)
    rng, truth = np.random.default_rng(9), force_prior(rigid.cell).mean.copy()
    x = truth.copy()
    x[RADIUS] -= 2e-5
    log = rigid.ground(x, 300.0, 2e-8, rng)
    made = updated(rigid.cell, log, rigid.setup, History(), "one")
    assert not {"flange_stiffness", "flange_setpoint_offset"} & set(made.states[3].names)
    assert made.latest["found_N"] == pytest.approx(made.latest["measured_N"], abs=0.1)
    assert made.latest["found_sd_N"] < 0.1 * made.latest["expected_sd_N"]


def test_a_wheel_does_not_grow(world):
    """A rate below zero is noise of a log: nothing is planned for a wheel that grows."""
    state = last_state(world.cell)
    at = state.names.index("wheel_wear")
    grown = replace(state, values=np.where(np.arange(len(state.names)) == at, -6e-7, state.values))
    radius = state.names.index(FIT_NAMES[RADIUS])
    assert carried_on(grown, 3600.0, 0).values[radius] == grown.values[radius]
    worn = replace(state, values=np.where(np.arange(len(state.names)) == at, 6e-7, state.values))
    assert carried_on(worn, 3600.0, 0).values[radius] == pytest.approx(worn.values[radius] - 2.16e-3)


def test_a_wheel_that_would_surely_grow_is_told(world):
    """A sensor's gain that creeps up looks like that."""
    state, log = last_state(world.cell), world.log
    at = np.arange(len(state.names)) == state.names.index("wheel_wear")
    for rate, sd, said in ((-6e-7, 1e-7, True), (-6e-7, 3e-7, False), (6e-7, 1e-7, False)):
        covariance = np.where(np.outer(at, at), sd**2, state.covariance)
        told = grown(log, replace(state, values=np.where(at, rate, state.values), covariance=covariance))
        assert bool(told) == said
        assert not said or "the wheel would grow by 2160 +- 360 um an hour, which no wheel does" in told[0]


def test_a_log_too_rough_to_tell_anything_is_refused_or_told(world, worn):
    """Its chance is one whatever it reads."""
    _, last = worn[-1]
    rng, cell = np.random.default_rng(4), replace(world.cell, calibration=last.states[3])
    log = world.ground(force_prior(world.cell).mean, 6 * BETWEEN, WEAR, rng)
    noise = 60.0 * rng.normal(size=len(log))  # with less, runs differ as no flange cell's do
    with pytest.raises(Infeasible, match="the best fit misses the readings by"):
        updated(cell, replace(log, fn=log.fn + noise), world.setup, history_of(cell.calibration, cell.path), "rough")
    (text,) = _unusual(log, last.fit, replace(last.verdict, directions=0, chance=1.0), ())
    assert "tells nothing that was not known" in text and "N rms off the fit" in text
    assert not any("tells nothing" in text for _, made in worn for text in made.notices)
