import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.diagnose import answering
from ocp.diagnose.answering import grouped, write_diagnosis
from ocp.diagnose.dataset import beyond_log, beyond_measured
from ocp.diagnose.engine.channel_system import Sealed
from ocp.diagnose.engine.findings import Location, Name
from ocp.diagnose.report import verdict_sentence
from ocp.diagnose.verdict.shrinkage import ANOTHER_DAY, NONE, Shrinkage
from ocp.shell.progress import Phases
from robots.robot import load_robot
from tests.support.diagnosis_folder import write_tracker_folder
from tests.support.simulated_campaign import campaign_readings

USUAL = "kr210_r2700_extra"
LATE = ("matplotlib", "jinja2", "trimesh", "networkx")  # seconds of imports that a tracker's diagnosis does not wait for


def test_one_core_draws_the_same_page_as_two(tmp_path, monkeypatch):
    write_tracker_folder(tmp_path / "set", 3, 1e-4, n=40, sealed=3)
    pages = []
    for cores in (1, 2):
        monkeypatch.setattr(answering, "cores", lambda cores=cores: cores)
        write_diagnosis(tmp_path / "set", tmp_path / f"out{cores}", False, Phases())
        pages.append((tmp_path / f"out{cores}" / "report.html").read_bytes())
    assert pages[0] == pages[1] and b"<svg" in pages[0]


@pytest.mark.parametrize(("unknown", "words"), [(0.02, "too small beside it"), (0.98, "what has no name is in that noise")])
def test_a_gap_in_the_noise_is_told_apart_from_one_without_a_name(unknown, words):
    readings = np.full(9, 0.1)
    gap = SimpleNamespace(name="tracker", unit="mm", noise_floor=0.11, before=readings, after=readings, shrinkage=None)
    told = verdict_sentence._better(SimpleNamespace(gaps=(gap,), diagnosis=SimpleNamespace(p_unknown=unknown, active=())))
    assert words in told and "noise 0.11" in told


def test_what_only_the_report_or_a_force_log_needs_is_imported_late():
    code = f"import sys, ocp.diagnose.answering; print([m for m in {LATE} if m in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


def test_effects_hidden_for_one_reason_are_told_together_but_not_those_that_readings_at_rest_never_show():
    told = [
        f"tracker.csv has no column {c}: {name} cannot be seen" for c, name in (("time_s", "a"), ("speed", "b"), ("time_s", "c"))
    ]
    assert grouped(told) == ["tracker.csv has no column time_s: a, c cannot be seen"]


def test_names_that_cannot_be_told_apart_are_both_in_the_sentence():
    play, windup, drift = Name("backlash", 1), Name("friction_windup", 1), Name("tracker_drift", 0)
    told = verdict_sentence._or_what_it_may_be(windup, ((play, windup),))
    assert told == "friction windup of joint 1 or backlash of joint 1"
    assert verdict_sentence._or_what_it_may_be(drift, ((play, windup),)) == verdict_sentence.effect_words(drift)


@pytest.mark.parametrize("second", ["backlash", "friction_windup"])
def test_of_a_cause_with_two_names_it_is_told_that_it_is_certain(second):
    """No name alone has 95 %, their class has; what is not settled is what comes with it."""
    play, windup, gear = Name("backlash", 1), Name("friction_windup", 1), Name("gear_2x", 1)
    sets = (((play,), 0.6), (tuple(sorted((Name(second, 1), gear))), 0.3), ((windup,), 0.08))
    found = SimpleNamespace(
        verdict="ambiguous",
        active=(1,),
        classes=((play, windup),),
        explanations=[SimpleNamespace(names=names, probability=p) for names, p in sets],
        ranking=[SimpleNamespace(name=name, probability=p) for name, p in ((play, 0.7), (windup, 0.28), (gear, 0.3))],
    )
    told = verdict_sentence.verdict_sentence(SimpleNamespace(diagnosis=found, gaps=()))
    assert told.startswith(
        "Backlash of joint 1 or friction windup of joint 1 is there for certain; what comes with it is not settled"
    )
    assert "nothing more (68 %) or error of joint 1 twice per turn (30 %)" in told


@pytest.mark.parametrize(
    ("verdict", "active", "written", "told", "safe", "arm"),
    [
        ("partly", (), (), "unexplained", "Do not rely on the believed cell there", USUAL),
        ("partly", (1,), (1,), "partly", "holds what is known", USUAL),
        ("ambiguous", (1,), (), "ambiguous", "corrects nothing of it; measure what the report asks for", USUAL),
        ("ambiguous", (1,), (1,), "ambiguous", "holds the likeliest", USUAL),
        ("explained", (1,), (1,), "explained", "plans with it", USUAL),
        ("explained", (1,), (1,), "explained", "holds it, which no plan can act on", "ur10"),
    ],
)
def test_nothing_is_said_to_be_held_that_is_not(verdict, active, written, told, safe, arm):
    found, data = SimpleNamespace(verdict=verdict, active=active), SimpleNamespace(setup=SimpleNamespace(robot=load_robot(arm)))
    effects = [SimpleNamespace(effect=SimpleNamespace(along=None)) for _ in written]
    assert verdict_sentence.told_as(found) == told
    assert safe in answering._safe(SimpleNamespace(diagnosis=found, patch=None, written=effects, data=data), Path("out"))


def test_columns_of_sealed_files_that_are_passed_over_are_told(unprinted, tmp_path):
    folder = write_tracker_folder(tmp_path / "set", 3, 1e-4, n=40, sealed=3)
    folder = tmp_path / "set" if folder is None else folder
    file = tmp_path / "set" / "sealed_tracker.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([f"{head},humidity", *(f"{row},50" for row in rows)]) + "\n")
    told = write_diagnosis(tmp_path / "set", tmp_path / "out", False, Phases()).notices
    assert "sealed_tracker.csv: columns humidity were ignored" in told


def test_sealed_conditions_beyond_the_measured_ones_are_told():
    measured = replace(campaign_readings(np.random.default_rng(1), 40), temperature=np.linspace(20.0, 25.0, 40))
    heaviest = int(measured.payload.max())
    seen = measured.take(np.flatnonzero(measured.payload != heaviest))
    none = np.full((6, 3), np.nan)
    like = replace(seen.take(np.arange(6)), path=Path("sealed_tracker.csv"), point=none)
    assert beyond_measured(seen, like) == ()
    q = like.q.copy()
    q[0, 0] = seen.q[:, 0].max() + np.radians(30.5)
    q[1, 0] = seen.q[:, 0].max() + np.radians(29.5)
    odd = replace(like, q=q, temperature=np.array([20.0, 30.5, 29.5, 14.5, 15.5, 25.0]), point=np.zeros((6, 3)))
    odd = replace(odd, payload=np.array([heaviest, heaviest, *odd.payload[2:]]))
    (radians,) = beyond_measured(seen, replace(like, q=np.radians(like.q)))
    assert radians.startswith("sealed_tracker.csv: all axes lie within ") and radians.endswith("; write degrees")
    ignored, heavy, turned, warm = beyond_measured(seen, odd)
    assert "x_mm, y_mm, z_mm were ignored" in ignored
    assert f"2 of 6 rows carry {seen.payloads[heaviest]}, never measured" in heavy
    assert "1 of 6 rows have q1_deg outside" in turned and "2 of 6 rows have temperature_C outside" in warm


def test_what_a_log_never_saw_is_told_of_sealed_grinding():
    rows = {
        "contact": np.ones(4, bool),
        "q": np.zeros((4, 6)),
        "setpoint": np.array([15.0, 20.0, 30.0, 20.0]),
        "setpoint_sd": None,
    }
    rows |= {"feed": np.full(4, 0.04), "belt": np.full(4, -20.0), "clock": np.linspace(0, 600.0, 4)}
    rows |= {"temperature": None, "wheel_temperature": np.full(4, 25.0)}
    log = SimpleNamespace(path=Path("force.csv"), **rows)
    later = {"clock": np.full(4, 1100.0), "setpoint": np.full(4, 40.0), "wheel_temperature": np.full(4, 29.0)}
    assert beyond_log(log, SimpleNamespace(**(rows | later | {"path": Path("sealed_force.csv")}))) == ()
    far = {"clock": np.full(4, 9e5), "setpoint": np.array([20.0, 20.0, 200.0, 200.0]), "feed": np.full(4, 0.06), "belt": None}
    told = beyond_log(log, SimpleNamespace(**(rows | far | {"path": Path("sealed_force.csv")})))
    assert "without belt_m_s, which the log has" in told[0] and "2 of 4 rows have setpoint_N" in told[1]
    assert "feed_mm_s outside of what was measured (40 to 40)" in told[2] and "4 of 4 rows have clock_s" in told[3]


def test_what_is_named_and_not_corrected_is_told_with_its_reason():
    def active(name, joint):
        return SimpleNamespace(key=(name, joint))

    def told(written, high, shrinkage=NONE, elsewhere=()):
        shown = (("backlash", 3), ("wheel_wear", 0))
        harmed = ("another setpoint",) if high < 0 else ()
        gap = SimpleNamespace(harmed=harmed, shown=shown, shrinkage=shrinkage, elsewhere=0 in elsewhere)
        other = SimpleNamespace(harmed=(), shown=(), shrinkage=NONE, elsewhere=1 in elsewhere)  # shows none of them: says nothing
        found = SimpleNamespace(active=both)
        return verdict_sentence.not_written(SimpleNamespace(diagnosis=found, written=written, gaps=(gap, other)))

    both = (active("backlash", 3), active("wheel_wear", 0))
    assert told(both, -1.0) == ""
    assert (
        told((), -1.0) == "The named effects are not in the corrected cell: another setpoint, when left out, said that they harm."
    )
    assert told((), 0.5) == "The named effects are not in the corrected cell: what they promise may be nothing, or harm."
    assert told((), -1.0, elsewhere=(0,)).endswith("what they rest on is not what the cell says; calibrate it anew first.")
    assert told((), -1.0, elsewhere=(1,)) == told((), -1.0)
    assert told((), 0.5, None).endswith("fitted without them, the cell's own parameters follow the readings as well.")
    assert told(both[1:], 0.5, None).endswith("fitted without it, the cell's own parameters follow the readings as well.")
    assert told(both[1:], -1.0).startswith(
        "Backlash of joint 3 is not in the corrected cell: another setpoint, when left out, said"
    )


def test_a_promise_of_what_is_not_written_says_so():
    play, wear = (SimpleNamespace(key=key, effect=None, joint=key[1], scanned={}) for key in (("backlash", 3), ("wheel_wear", 0)))
    told = Shrinkage(0.6, 0.4, 0.7)
    figures = {"name": "tracker", "unit": "mm", "noise_floor": 0.02, "before": np.ones(3), "after": np.ones(3)}
    gap = SimpleNamespace(**figures, shown=(play.key,), shrinkage=told, promise={ANOTHER_DAY: told}, there="there")
    found = SimpleNamespace(active=(play, wear), p_unknown=0.0)

    def words(*written):
        answer = SimpleNamespace(gaps=(gap,), written=written, diagnosis=found)
        return verdict_sentence._promise(answer), verdict_sentence._better(answer)

    assert all("should be gone" in one and "would" not in one for one in words(play))
    assert all("would be gone if that were corrected" in one for one in words())


def test_what_stays_above_the_instruments_noise_is_told_though_it_has_no_name():
    at = Location("tracker", "joint", 2, ("approach2",))
    gap = SimpleNamespace(name="tracker", unit="mm", remaining=SimpleNamespace(above_noise=0.015))
    quiet = SimpleNamespace(name="force", unit="N", remaining=SimpleNamespace(above_noise=0.0))
    found = SimpleNamespace(remainder=at)
    told = verdict_sentence._still(SimpleNamespace(gaps=(gap, quiet), diagnosis=found))
    assert told.startswith(
        "; 0.015 mm of the tracker gap stay above the instrument's noise, mostly in joint 2, with the direction"
    )
    assert verdict_sentence._still(SimpleNamespace(gaps=(quiet,), diagnosis=found)) == ""


@pytest.mark.parametrize(("name", "unit", "expected"), [("tracker", "mm", 1.2e-4), ("force", "N", 0.5)])
def test_predictions_are_as_unsure_as_what_no_patch_can_hold(name, unit, expected):
    """A joint that slips between two states; of a tracker's sigma the joints' lasting noise holds a part already."""
    k, left = (3, 0.12 * np.sqrt(3)) if name == "tracker" else (1, 0.4)
    told = Sealed(np.zeros((5, k)), np.zeros((5, k)), np.full((5, k), 5e-5 if name == "tracker" else 0.3))
    gap = SimpleNamespace(name=name, unit=unit, remaining=SimpleNamespace(above_noise=left))
    np.testing.assert_allclose(answering.as_wide_as_left(told, gap).sigma, expected)
    gap.remaining.above_noise = 0.0
    np.testing.assert_allclose(answering.as_wide_as_left(told, gap).sigma, told.sigma)
