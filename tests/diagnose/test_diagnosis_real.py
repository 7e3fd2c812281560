"""Measured robots: the loader of the UR campaigns, what holds where conditions are left out, and what the data must show."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from ocp.diagnose import rules
from ocp.diagnose.answering import tracker_channel
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.engine.channel_system import Fold, System
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.linearisation import Candidate, candidates
from ocp.diagnose.engine.selection import select_on_held_out
from ocp.diagnose.verdict import diagnosis
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import library
from robots.errors import BadInput
from tests.support.published_campaigns import TARGET, held_rows, read_campaign, write_data_set

LIBRARY = library()
SLOW = ("joint_compliance", "gear_1x", "gear_2x", "encoder_scale")
UR5_HEAD = "step_order,x_t,y_t,z_t,x_dif,y_dif,z_dif,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6"
UR5 = "ur5_tracker/3D_UR5_uncalibrated_grid_cleaned.csv"
UR10 = "ur10_tracker/measurements_grid.csv"


@pytest.fixture
def real(shared_data):
    return shared_data / "real"


def small_ur5(path, orders=(0, 1, 3), head=UR5_HEAD):
    """Three postures of a UR5 file; the target, a difference of 1, 2, 3 mm, and axes that all turn forward by a degree a row."""
    rows = [[k, -400, -10, 50 + k, 1, 2, 3, *(np.array([-20, -60, 100, -40, 90, 5]) + k)] for k in orders]
    path.write_text("\n".join([head, *(",".join(map(str, r)) for r in rows)]) + "\n")
    return path


def columns_of(path):
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {name: [r[name] for r in rows] for name in rows[0]}


def test_points_of_the_ur5_are_on_either_side_of_the_target(tmp_path):
    path = small_ur5(tmp_path / "a.csv")
    one, other = read_campaign(path).columns, read_campaign(path, TARGET).columns
    assert one["x_mm"][0] == -399 and other["x_mm"][0] == -401
    assert one["z_mm"][0] == 53 and other["z_mm"][0] == 47


def test_an_axis_has_a_sign_only_where_the_row_before_is_there(tmp_path):
    signs = read_campaign(small_ur5(tmp_path / "a.csv")).columns["approach3"]
    assert list(signs) == [0, 1, 0]  # the first has none before it, the third follows a row that is missing


def test_what_is_held_out_is_not_in_the_folder_for_the_diagnosis(tmp_path):
    campaign = read_campaign(small_ur5(tmp_path / "a.csv"))
    write_data_set(campaign, tmp_path, np.array([1]))
    kept, sealed, withheld = (columns_of(tmp_path / n) for n in ("tracker.csv", "sealed_tracker.csv", "withheld_tracker.csv"))
    assert len(kept["q1_deg"]) == 2 and "-19.000000" not in kept["q1_deg"]
    assert not {"x_mm", "y_mm", "z_mm", "sigma_um"} & set(sealed)
    assert sealed["q1_deg"] == withheld["q1_deg"] == ["-19.000000"] and withheld["z_mm"] == ["54.00000"]


def test_splits_are_those_of_the_calibration_benchmark():
    rng = np.random.default_rng(3)
    assert (held_rows(1001, 0.2, 3) == np.sort(rng.permutation(1001)[:200])).all()


@pytest.mark.parametrize("head", ["a,b,c", UR5_HEAD.replace("joint_4", "q4")])
def test_another_file_is_refused_by_its_name(tmp_path, head):
    with pytest.raises(BadInput, match=r"a\.csv.*neither the UR5's nor the UR10's"):
        read_campaign(small_ur5(tmp_path / "a.csv", head=head))


def test_a_row_that_is_not_numbers_is_refused(tmp_path):
    path = small_ur5(tmp_path / "a.csv")
    path.write_text(path.read_text().replace("-400", "left", 1))
    with pytest.raises(BadInput, match="not all numbers"):
        read_campaign(path)


def line_of(n=300, seed=1):
    """A linear world: readings at x in 0..1 with a curve exp(2 x) and a wave that nobody offers, a constant as nuisance. Offered
    are the curve, and a polynomial that follows both together better on all readings and runs away where x was not seen."""
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0, 1, n))
    curve, wave = np.exp(2 * x), np.sin(9 * x)
    y = 4 * curve + 3 * wave + rng.normal(size=n)
    system = System(y, np.ones((n, 1)), np.array([np.inf]), np.zeros(1), np.arange(n))
    halves = [Fold(f"x {side}", "joint range", m) for side, m in (("above", x > 0.5), ("below", x <= 0.5))]
    steep = 1e5 * np.column_stack([x, x**4])[:, None]  # per unit of the coefficients, so that values are usual ones
    springs, gear = LIBRARY["joint_compliance"], LIBRARY["gear_1x"]
    return system, [Candidate(springs, 2, ({},), 10 * curve[:, None, None]), Candidate(gear, 2, ({},), steep)], halves


def test_the_form_that_holds_where_nobody_measured_is_accepted_and_the_other_is_an_impostor():
    system, offers, halves = line_of()
    found = select_on_held_out(system, offers, halves)
    assert [a.key for a in found.active] == [("joint_compliance", 2)]
    assert found.active[0].a[0] == pytest.approx(0.4, rel=0.15)
    (impostor,) = found.refused
    assert impostor.name == Name("gear_1x", 2) and impostor.ratio > 1.25


def test_noise_selects_nothing():
    rng = np.random.default_rng(0)
    system, offers, halves = line_of()
    quiet = replace(system, residual=rng.normal(size=300))
    assert select_on_held_out(quiet, offers, halves).active == ()


@pytest.mark.parametrize(("size", "named"), [(0.1, True), (-0.1, False), (-4.0, True)])
def test_a_spring_that_rises_against_its_load_must_explain_more(size, named):
    rng = np.random.default_rng(2)
    system, (spring, _), halves = line_of()
    y = np.sign(size) * (abs(size) * spring.columns[:, 0, 0] / 10 + 0.7 * rng.normal(size=300))
    found = select_on_held_out(replace(system, residual=y), [spring], halves)
    assert [np.sign(one.a[0]) for one in found.active] == ([np.sign(size)] if named else [])


def test_springs_that_mask_each_other_are_accepted_together():
    rng = np.random.default_rng(4)
    system, (spring, _), halves = line_of()
    x = np.linspace(0, 1, 300)
    one, other = 40 * (x + 0.4 * np.sin(14 * x)), 40 * (-x + 0.4 * np.sin(14 * x))
    offers = [replace(spring, joint=j, columns=c[:, None, None]) for j, c in ((2, one), (3, other))]
    found = select_on_held_out(replace(system, residual=0.2 * (one + other) + rng.normal(size=300)), offers, halves)
    assert {one.joint for one in found.active} == {2, 3}
    assert [one.a[0] for one in found.active] == pytest.approx([0.2, 0.2], rel=0.1)
    assert found.scores[0] == found.scores[1]  # in one round


def few(path, tmp_path, rows):
    """A campaign's channel of so many readings, evenly taken."""
    campaign = read_campaign(path)
    every = np.unique(np.linspace(0, len(campaign) - 1, rows).astype(int))
    write_data_set(replace(campaign, columns={n: v[every] for n, v in campaign.columns.items()}), tmp_path)
    return tracker_channel(read_data_set(tmp_path))


def test_joint_2_of_the_ur5_bends_and_slow_gear_terms_are_impostors(real, tmp_path):
    channel = few(real / UR5, tmp_path, 600)
    slow = {n: LIBRARY[n] for n in SLOW}
    found = select_on_held_out(channel.system, candidates((channel,), slow, Options()), channel.folds())
    first = found.active[0]
    assert first.key == ("joint_compliance", 2)
    c = LIBRARY["joint_compliance"].values(first.a, first.scanned)["rad_per_Nm"]
    assert 2e-5 < c < 5e-5
    assert Name("gear_1x", 2) in {r.name for r in found.refused}


def test_gravity_bends_joints_2_and_3_of_the_ur10(real, tmp_path):
    channel = few(real / UR10, tmp_path, 1000)
    slow = {n: LIBRARY[n] for n in SLOW}
    found = select_on_held_out(channel.system, candidates((channel,), slow, Options()), channel.folds(), most=2)
    assert {one.key for one in found.active} == {("joint_compliance", 2), ("joint_compliance", 3)}
    for step in found.active:
        assert 0.8e-5 < LIBRARY["joint_compliance"].values(step.a, step.scanned)["rad_per_Nm"] < 1.3e-5


def test_the_ur5_has_a_ripple_of_joint_1_that_no_one_catalogued(real, tmp_path, monkeypatch):
    channel = few(real / UR5, tmp_path, 400)
    searched = []
    whole = diagnosis.search_and_refit
    monkeypatch.setattr(diagnosis, "search_and_refit", lambda *a: searched.append(whole(*a)) or searched[0])
    found = diagnose_channels([channel], LIBRARY, Options(folds=False))
    assert found.verdict in ("partly", "unexplained")
    assert found.remainder is not None and found.remainder.joint == 1 and "q1" in found.remainder.depends_on
    peak = next(p for p in found.spectrum if p.joint == 1)
    assert 12.5 <= peak.order <= 14.5 and peak.p_value < 0.01
    # With three names the arm still misses far more than noise: they are selected anew, on held-out errors.
    assert len(searched[0][0].channels[0].active) == rules.SEARCHED_IN_VAIN < len(found.active)
