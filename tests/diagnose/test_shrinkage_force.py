"""The promise of shrinkage for force readings: on numbers alone, and kept on a wearing wheel ground with by the second route."""

from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.calibrate.force.log import read_force_log
from ocp.diagnose.engine.channel_system import Fold, HeldOut
from ocp.diagnose.engine.findings import Alternative
from ocp.diagnose.force import shrinkage
from ocp.diagnose.force.channel import ForceChannel, force_channel
from ocp.diagnose.force.fit import ForceProblem, fit_effects, linear_normal
from ocp.diagnose.force.held_out import Asked
from ocp.diagnose.force.logged_contact import logged_arm
from ocp.diagnose.force.prediction import LogScene, predict_forces
from ocp.diagnose.force.shrinkage import LaterGrinding, after_log, anticipated_grinding, from_grinding
from ocp.diagnose.foresee.anticipated import anticipated_shrinkage
from ocp.diagnose.verdict.answer import Followed
from ocp.diagnose.verdict.shrinkage import Shrinkage
from ocp.effects.catalogue import library
from ocp.effects.effect import Active
from tests.support.diagnosis_force_world import HEADER, Pass, Planted, believed_world, log_of, record
from tests.support.force_world import arm_posterior, write_log

# A log of eleven minutes, and grinding that comes four minutes after it.
PLAN = (
    Pass(0),
    Pass(1),
    Pass(0, travel=-1),
    Pass(1, setpoint=30.0),
    Pass(0, contact=False),
    Pass(0, setpoint=12.0),
    Pass(1, pause=450.0),
)
LATE = (Pass(1, feed=0.06, setpoint=25.0, pause=240.0), Pass(0, feed=0.03))
WEAR = 3e-7  # m/s
NOISE = 0.04  # N^2
RUN_SD = 0.02  # N


def new(*moved: float, error: float = 0.1, doubt: float = 0.0, runs: int = 40) -> LaterGrinding:
    """As many conditions, alike probable, with this rms N of what the effects move; error: rms N of the unknowns; doubt: the
    probability that nothing is moved."""
    rng, n, p = np.random.default_rng(0), 10 * runs, 50
    errors = error * rng.normal(size=(n, p)) / np.sqrt(p)
    return LaterGrinding(
        np.stack([np.stack([np.full(n, m), np.zeros(n)]) for m in moved]),
        np.stack([errors for _ in moved]),
        np.eye(p),
        np.array([1 - doubt, doubt]),
        np.full(len(moved), 1 / len(moved)),
        np.repeat(np.arange(runs), 10),
    )


def test_new_grinding_has_few_of_a_log_s_settings():
    """A gap that one recording in four shows five times as large as the others: of three drawn alike, 42 % have none of these."""
    told = new(1.0, runs=40)
    large = np.where(told.run % 4 == 0, 5.0, 1.0)
    found = from_grinding(replace(told, moved=told.moved * large), 1e-4)
    few, many = (1 - 0.1 / np.sqrt(0.01 + size) for size in (1.0, 16.0))  # none of them, and nearly two of three
    assert found.low == pytest.approx(few, abs=0.012) and found.high == pytest.approx(many, abs=0.012)


def test_of_what_has_no_name_only_a_share_is_there_again():
    """With half of it sure, the other half of the correction is as large an error as the one that it takes."""
    made = new(1.0, error=0.0)
    whole, half, open_ = (from_grinding(made, NOISE, carried=c) for c in (None, (0.5, 0.0), (0.9, 0.2)))
    assert whole.predicted == pytest.approx(1.0) and half.predicted == pytest.approx(0.0, abs=1e-9)
    assert open_.low < open_.predicted - 0.1 and open_.predicted == pytest.approx(1.0 - 0.1 / 0.9, abs=0.1)


def promise(made: LaterGrinding) -> Shrinkage:
    found = from_grinding(made, NOISE)
    assert found is not None
    return found


def test_what_the_effects_move_and_the_unknowns_errors_make_the_promise():
    """What recordings differ by (0.02 N) is noise: no part of it."""
    for error in (0.1, RUN_SD):
        found = promise(new(0.5, error=error))
        assert found.predicted == pytest.approx(1 - np.sqrt(error**2 / (error**2 + 0.25)), abs=0.02 if error > RUN_SD else 0.005)
        assert found.high - found.low < 0.2
    # Later or sooner, few recordings or many: the promise is as wide as what is not known of them.
    assert promise(new(0.2, 1.0)).low < 0.55 < 0.87 < promise(new(0.2, 1.0)).high
    few, many = promise(new(0.5, runs=3)), promise(new(0.5, runs=40))
    assert few.high - few.low > many.high - many.low
    assert from_grinding(new(0.01, error=0.01), NOISE) is None  # a gap that nobody would notice


def test_what_is_there_under_no_name_is_there_afterwards_too():
    rows = np.random.default_rng(0).chisquare(1, 400)
    fold = Fold("x", "random", np.ones(400, bool))

    def told(after: float, unknown: float = 1.0) -> Shrinkage:
        left_out = HeldOut(fold, np.stack([0.29 * rows, after * rows, np.full(400, NOISE)]))
        found = from_grinding(new(0.5), NOISE, [left_out], unknown)
        assert found is not None
        return found

    assert told(NOISE).predicted == pytest.approx(promise(new(0.5)).predicted, abs=0.05)
    assert told(NOISE + 0.25, 0.0).predicted == pytest.approx(promise(new(0.5)).predicted, abs=0.05)
    left = 0.1**2 + RUN_SD**2 + 0.25
    assert told(NOISE + 0.25).predicted == pytest.approx(1 - np.sqrt(left / (left + 0.25)), abs=0.05)


def test_of_rows_that_are_asked_for_nothing_is_drawn():
    """It is no matter which recording a row belongs to, as it is where recordings are drawn."""
    made = new(0.5)
    uneven = replace(made, moved=made.moved * np.where(made.run % 4, 0.1, 1.0))
    one = np.arange(len(made.run)) % 3
    asked, drawn = ([promise(replace(uneven, whole=whole, run=run)) for run in (made.run, one)] for whole in (True, False))
    assert asked[0] == asked[1] and drawn[0] != drawn[1]


def test_intervals_hold_what_they_say():
    """Worlds drawn from the anticipation itself, three recordings in each."""
    rng, made = np.random.default_rng(1), new(0.15, 0.25, 0.35)
    found, inside = promise(made), []
    for _ in range(300):
        rows = np.isin(made.run, rng.choice(40, 3, replace=False))
        off = made.errors[0][rows] @ rng.normal(size=50) + 0.02 * rng.normal(size=40)[made.run[rows]]
        moved = made.moved[rng.integers(3), 0][rows]
        inside.append(found.low <= 1 - np.sqrt(np.mean(off**2) / np.mean((off - moved) ** 2)) <= found.high)
    assert 0.8 < np.mean(inside) < 0.97


def test_doubt_about_the_name_is_in_the_promise():
    assert promise(new(0.5, doubt=0.3)).low < -0.5 < 0.7 < promise(new(0.5)).low


@dataclass(frozen=True)
class Made:
    """The log's channel without effects; scene of grinding that comes later, its true readings (n,) N."""

    channel: ForceChannel
    later: LogScene
    truth: np.ndarray


class Stiff:
    """A blade that hardly gives way, in the world and in the fit: finite elements are tested elsewhere."""

    def at(self, p, *frames) -> np.ndarray:
        return np.tile([2e-6, 0.0, 0.0], (len(p), 1))


@pytest.fixture(scope="module")
def worn(tmp_path_factory) -> Made:
    folder: Path = tmp_path_factory.mktemp("worn")
    with pytest.MonkeyPatch.context() as patch:
        give = Stiff()
        patch.setattr(
            "tests.support.force_world.blade_compliance",
            lambda *asked: SimpleNamespace(per_pass=[give.at(x.p) for x in asked[1]]),
        )
        patch.setattr("ocp.calibrate.force.blade.StationsTask.solve", lambda task: give)
        patch.setattr("ocp.calibrate.force.blade.StationsTask.known", True)
        rng = np.random.default_rng(7)
        base = record(believed_world(folder, rng, every=6), (*PLAN, *LATE), rng)
        rows, truth = log_of(base, (Planted(overlap=lambda b: -WEAR * b.columns["clock"]),))
        whole = force_channel(
            base.world.cell, read_force_log(write_log(folder / "force.csv", rows, HEADER)), arm=arm_posterior(base.world.cell)
        ).problem
    late = base.columns["run"] >= len(PLAN)
    problem = ForceProblem(whole.log.take(~late), _taken(whole.scene, ~late), whole.believed)
    return Made(ForceChannel(problem, fit_effects(problem)), _taken(whole.scene, late), truth[late])


def _taken(scene: LogScene, rows: np.ndarray) -> LogScene:
    """Some rows (not for effects of the arm)."""
    conditions, pressed = scene.conditions.take(rows), scene.pressed[rows]
    arm = logged_arm(scene.cell, scene.theta, scene.rows.take(rows).q, conditions)
    return replace(scene, rows=scene.rows.take(rows), conditions=conditions, arm=arm, pressed=pressed)


def _wear() -> Active:
    effect = library()["wheel_wear"]
    return Active(effect, 0, np.zeros(effect.size), {}, np.zeros((effect.size, effect.size)))


def test_later_grinding_goes_on_where_the_log_ended(worn):
    told = worn.channel.problem.scene.conditions
    soon, far = after_log(told, 0.0), after_log(told, 1.0)
    assert soon.clock.min() == pytest.approx(told.clock.max()) and far.clock.min() == pytest.approx(2 * told.clock.max(), rel=0.1)
    at = told.contact
    for line in np.unique(told.line):
        times = len(np.unique(told.run[at & (told.line == line)]))
        here = at & (told.line == line)
        assert set(soon.ground_before[here]) == {times} and set(far.ground_before[here]) == {2 * times}
    assert np.all(soon.wheel_warm == told.wheel_warm[np.argmax(told.clock)])
    cold = after_log(replace(told, warm=told.clock / 100.0), 0.5, changing=True)
    assert np.all(cold.wheel_warm == told.wheel_warm[np.argmin(told.clock)])
    assert cold.warm == pytest.approx((told.clock.max() + 0.5 * np.ptp(told.clock)) / 100.0)
    # Within a recording time runs as it did.
    assert np.allclose(np.diff(soon.clock)[np.diff(told.run) == 0], np.diff(told.clock)[np.diff(told.run) == 0])


def test_who_may_be_fooled_by_warmth_is_shown_two_kinds_of_it(worn):
    warm = library()["wheel_temperature"]
    grown = Active(warm, 0, np.zeros(warm.size), {}, np.zeros((warm.size, warm.size)))
    cold, hot = (anticipated_grinding(worn.channel, worn.channel.with_active((one,))) for one in (_wear(), grown))
    assert cold.share.sum() == pytest.approx(1.0) == hot.share.sum()
    assert len(hot.share) - 1 == 2 * (len(cold.share) - 1)


def test_the_promise_is_kept_after_the_log(worn):
    before = worn.channel
    after = before.with_active((_wear(),))
    found = from_grinding(anticipated_grinding(before, after), after.noise_floor**2)
    there = [predict_forces(worn.later, c.fit.at.x, c.active) for c in (before, after)]
    e, f = (float(np.sqrt(np.mean((told.fn - worn.truth) ** 2))) for told in there)
    assert e > 0.3 and found is not None, (found, e, f)
    assert found.low <= 1 - f / e <= found.high
    assert found.predicted == pytest.approx(1 - f / e, abs=0.12)
    # One who is not sure of the name promises less.
    unsure = from_grinding(
        anticipated_grinding(before, after, (Alternative(0.6, after.active), Alternative(0.4, ()))), after.noise_floor**2
    )
    assert unsure is not None and unsure.predicted < found.predicted and unsure.low < found.low - 0.5


def test_a_promise_for_the_conditions_asked_for_is_of_these_rows_and_no_others(worn):
    before, after = worn.channel, worn.channel.with_active((_wear(),))
    clocked = replace(worn.later.conditions, given=frozenset({"clock_s"}))
    asked = Asked(before.log, before.problem.scene.rows, replace(worn.later, conditions=clocked))
    made = anticipated_grinding(before, after, (), asked)
    at = worn.later.touching
    assert made.share.tolist() == [1.0] and made.whole and made.moved.shape == (1, 1, len(at))
    told = from_grinding(made, after.noise_floor**2)
    there = [predict_forces(worn.later, c.fit.at.x, c.active).fn[at] for c in (before, after)]
    e, f = (float(np.sqrt(np.mean((fn - worn.truth[at]) ** 2))) for fn in there)
    assert told.predicted == pytest.approx(1 - f / e, abs=0.06) and told.low <= 1 - f / e <= told.high
    # Twice the same rows promise the same, and a recording's rows count as they are asked for.
    twice = replace(made, moved=np.tile(made.moved, 2), errors=np.tile(made.errors, (1, 2, 1)), run=np.tile(made.run, 2))
    assert from_grinding(twice, after.noise_floor**2).predicted == pytest.approx(told.predicted, rel=1e-9)
    assert asked.says(_wear().effect) and not asked.says(library()["wheel_temperature"])


def test_conditions_wholly_in_the_air_are_predicted_and_promise_as_new_data_do(worn):
    after, scene = worn.channel.with_active((_wear(),)), worn.later
    air = replace(scene.rows, contact=np.zeros(len(scene.rows), bool))
    there = replace(scene, rows=air, pressed=None)
    asked = Asked(worn.channel.log, worn.channel.problem.scene.rows, there)
    after.made["asked"] = asked
    followed = Followed(worn.channel, after, (Alternative(1.0, after.active),))
    told = [anticipated_shrinkage(followed, (), 0.0, None, one) for one in (asked.sealed, None)]
    assert not told[0][1] and told[0][0] == told[1][0]
    found = predict_forces(there, after.fit.at.x, after.active)
    assert not found.F.any() and linear_normal(after.problem, there, found).shape[0] == len(air)
    after.made.clear()


@pytest.mark.parametrize("lost", [1, 2])
def test_what_cannot_be_computed_later_is_no_alternative_and_promises_nothing(worn, monkeypatch, lost):
    """Of three predictions under each of the later conditions: the baseline's, the accepted one's, the other's."""
    after, calls = worn.channel.with_active((_wear(),)), count()

    def made(*given):
        told = predict_forces(*given)
        return replace(told, read=np.full_like(told.read, np.nan)) if next(calls) % 3 == lost else told

    monkeypatch.setattr(shrinkage, "predict_forces", made)
    others = (Alternative(0.6, after.active), Alternative(0.4, ()))
    found = anticipated_grinding(worn.channel, after, others)
    assert (found is None) == (lost == 1)
    assert found is None or (len(found.probability) == 1 and np.isfinite(found.moved).all())
