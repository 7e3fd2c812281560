"""The blind check: sealing, detectability against brute force, exact signatures, the scorer on hand-made answers."""

import ast
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from ocp.blindtest import answers, figures, scoring
from ocp.blindtest.answers import make_answer
from ocp.blindtest.interface import answer_all, forget_answers, make_all, resume, score_all
from ocp.blindtest.oracle import oracle
from ocp.blindtest.oracle.oracle import detectabilities
from ocp.blindtest.oracle.signatures import tracker_families
from ocp.blindtest.oracle.tracker import TrackerView, point_covariance, scene_of, tracker_nuisance, tracker_view, tracker_whitener
from ocp.blindtest.record import Standing
from ocp.blindtest.report import blindtest_last_line, write_blindtest_report
from ocp.blindtest.scoring import score_path
from ocp.blindtest.worlds import recipes
from ocp.blindtest.worlds.machines import as_real_arms, draw_tracker_machine
from ocp.blindtest.worlds.outside_lists import ON_ARM
from ocp.blindtest.worlds.recipes import KINDS, Recipe, scaled, within_range
from ocp.blindtest.worlds.sealing import SEALED, Check, label_path, read_label, read_seal, write_cell
from ocp.model.cell import read_cell
from ocp.shell.executor import Hands
from ocp.shell.output import add_text_file, reserved, users_file
from ocp.shell.progress import Phases
from ocp.simulate.twin.arm import make_arm
from ocp.simulate.twin.planting import Planted, draw_effect, parse_effect
from ocp.simulate.twin.truth import REPEATABILITY, draw_truth
from robots.errors import BadInput
from tests.support.browser import CHROMIUM, looked_at

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "ocp" / "data" / "cell.toml"
HERE = Hands(1)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory):
    cell = tmp_path_factory.mktemp("cell") / "cell.toml"
    write_cell(CELL, cell)
    return draw_tracker_machine(cell, 3, Recipe(1, "none_background", 0, None), 40, 10)


@pytest.fixture(scope="module")
def scene(machine):
    return scene_of(machine)


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Check:
    """Two worlds, made and sealed."""
    made = Check(tmp_path_factory.mktemp("blind") / "check", 5, 2, ("single", "none"), 60, 12)
    resume(made)
    write_cell(CELL, made.cell)
    make_all(made, recipes.recipes(2, made.kinds), HERE, Phases())
    return made


def test_derivatives_are_those_of_the_machine(machine, scene):
    A, sd = tracker_nuisance(scene)
    bare = machine.points(())

    def moved(**changes):
        return (replace(machine, truth=replace(machine.truth, **changes)).points(()) - bare) / 1e-6

    truth = machine.truth
    for link in (1, 3, 6):
        for k in range(6):
            placement = truth.placement.copy()
            # Both small motions are in the frame's own axes; the derivative is at the drawn placement.
            placement[link - 1, k] += 1e-6
            assert np.allclose(A[:, :, 6 + 6 * (link - 1) + k], moved(placement=placement), atol=5e-3)
    nests = {name: place + (1e-6 * np.eye(3)[0] if name == "T1" else 0) for name, place in truth.nests.items()}
    first = list(dict.fromkeys(scene.campaign.targets)).index("T1")
    assert np.allclose(A[:, :, 42 + 3 * first], moved(nests=nests), atol=1e-4)
    springs = truth.stiffness * [1, 1 / (1 + 1e-6), 1, 1, 1, 1]
    column = 42 + 3 * len(set(scene.campaign.targets)) + 1
    assert np.allclose(A[:, :, column], moved(stiffness=springs), atol=2e-5 + 0.01 * np.abs(A[:, :, column]).max())
    for link in (1, 2, 3, 6):  # the first turns about an upright axis, and moves no joint by its weight
        masses = truth.mass_scale + 1e-6 * np.eye(7)[link]
        assert np.allclose(A[:, :, column + 5 + link], moved(mass_scale=masses), atol=0.01 * np.abs(A[:, :, column + 8]).max())
    name = max(set(scene.campaign.moments.payload), key=lambda name: truth.payloads[name][0])
    mass, centre = truth.payloads[name]
    hung, heavier = list(truth.payloads).index(name), {name: (mass * (1 + 0.01 / np.sqrt(3)), centre)}
    assert np.allclose(A[:, :, column + 12 + 18 + hung], moved(payloads=truth.payloads | heavier) * 1e-6, atol=1e-7)
    shift = truth.mass_shift + 0.01 * np.eye(3)[1] * (np.arange(7) == 3)[:, None]
    assert np.allclose(A[:, :, column + 12 + 6 + 1], moved(mass_shift=shift) * 1e-6, atol=1e-7)
    assert A.shape[2] == len(sd) == column + 12 + 18 + len(truth.payloads) + 6


def test_play_is_believed_as_wide_as_it_is_drawn(machine):
    """Of a machine that grinds and is measured it is a tenth of a tracker's."""
    for play in (machine.play, 0.1 * machine.play):
        _, sd = tracker_nuisance(scene_of(replace(machine, play=play)))
        np.testing.assert_allclose(sd[-6:], play / np.sqrt(3.0))


def test_lambda_is_the_quadratic_form(machine, scene):
    effect = parse_effect("backlash:5=1e-4")
    d = (machine.points([effect]) - machine.points(())).ravel()
    A, sd = tracker_nuisance(scene)
    A = A.reshape(len(d), -1)
    Sigma = np.zeros((len(d), len(d)))
    for k, S in enumerate(point_covariance(scene)):
        Sigma[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = S
    brute = d @ np.linalg.solve(Sigma + (A * sd**2) @ A.T, d)
    view = TrackerView(machine, scene, tracker_whitener(scene))
    assert detectabilities(view, [effect])[0] == pytest.approx(brute, rel=1e-4)
    # Twice the size, four times the index; two effects never see each other better than alone.
    assert detectabilities(view, [scaled(effect, 2.0)])[0] == pytest.approx(4 * brute, rel=1e-3)
    both = detectabilities(view, [effect, parse_effect("joint_thermal:5=1e-5")])
    assert both[0] <= brute * (1 + 1e-9)


def test_what_the_oracle_reads_is_white_as_a_machine_s_readings_are(machine, scene):
    """Noise, ripple of other orders and a machine drawn anew; tails and weights of all links are in it."""
    assert scene.truth.ripple.any() and np.isfinite(scene.truth.tails)
    view, rng = tracker_view(machine), np.random.default_rng(4)
    squares = [np.mean(view.readings((), rng) ** 2) for _ in range(60)]
    assert np.mean(squares) == pytest.approx(1.0, abs=0.06)
    # Student's noise of a reading tells as much of its place as a normal one of this covariance.
    normal = point_covariance(replace(scene, truth=replace(scene.truth, tails=np.inf, ripple=0.0 * scene.truth.ripple)))
    tailed = point_covariance(replace(scene, truth=replace(scene.truth, ripple=0.0 * scene.truth.ripple)))
    still = REPEATABILITY**2 * scene.D @ np.swapaxes(scene.D, 1, 2)
    np.testing.assert_allclose(tailed - still, 9.0 / 7.0 * (normal - still), rtol=1e-9)


def test_machines_are_as_real_ones_are():
    """But those that ask for none of it: weights, gears, readings (docs/blindtest.md)."""
    cell = read_cell(CELL)
    drawn = [as_real_arms(draw_truth(cell, k), np.random.default_rng(k)) for k in range(200)]
    lines = np.array([one.ripple[:, :, 0] for one in drawn])
    whole = np.sqrt((lines**2).sum(axis=2))
    assert 1e-5 <= whole.min() < 1.1e-5 and 2.9e-5 < whole.max() <= 3e-5
    assert set(np.count_nonzero(lines, axis=2).ravel()) == {3, 4, 5}
    assert np.std([one.mass_scale for one in drawn]) == pytest.approx(0.04, rel=0.1)
    assert np.std([one.mass_shift for one in drawn]) == pytest.approx(0.01, rel=0.1)
    stated = draw_truth(cell, 0).payloads
    off = np.array([[one.payloads[n][0] / mass - 1 for n, (mass, _) in stated.items() if mass] for one in drawn])
    assert np.abs(off).max() <= 0.01 and np.std(off) == pytest.approx(0.01 / np.sqrt(3), rel=0.1)
    clean, other = (draw_tracker_machine(CELL, 3, Recipe(1, kind, 0, None), 30, 5) for kind in ("none", "single"))
    assert not (clean.truth.ripple[..., 0].any() or clean.truth.play.any() or clean.truth.mass_shift.any() or clean.play)
    assert other.truth.ripple[..., 0].any() and other.truth.play.any() and other.truth.mass_shift.any() and other.play
    for one, spread in ((clean, 0.01), (other, 0.04)):
        masses = 42 + 3 * len(set(one.campaign.targets)) + 6
        np.testing.assert_allclose(tracker_nuisance(scene_of(one))[1][masses : masses + 7], spread)
    assert tracker_nuisance(scene_of(clean))[0].shape[2] < tracker_nuisance(scene_of(other))[0].shape[2]


def test_the_noise_is_the_virtual_tracker_s(machine, scene):
    from ocp.simulate.twin.tracker import measure, true_points

    rng = np.random.default_rng(0)
    truth = replace(scene.truth, outliers=0.0, tails=np.inf, ripple=0.0 * scene.truth.ripple)
    arm, m = make_arm(scene.cell, truth), scene.campaign.moments
    quiet = replace(scene, truth=truth)
    exact = true_points(truth, scene.cell, arm, m, scene.campaign.targets)
    off = [measure(truth, scene.cell, arm, m, scene.campaign.targets, rng) - exact for _ in range(40)]
    S = point_covariance(quiet)
    squared = [np.einsum("ni,ni->n", e, np.linalg.solve(S, e[..., None])[..., 0]) for e in off]
    assert np.mean(squared) == pytest.approx(3.0, abs=0.15)


@pytest.mark.parametrize(
    "text",
    [
        "joint_compliance:5=2e-6",
        "joint_stiffening:4=8e-14",
        "link_bending:3=5e-8",
        "payload_mass=3",
        "payload_com=0.01/0.01/-0.02",
        "gear_2x:1=5e-5,phase_rad=1",
        "gear_harmonic:4=8e-5,order=19,phase_rad=2",
        "motor_harmonic:6=8e-5,order=2",
        "backlash:2=5e-5",
        "friction_windup:3=5e-5,per_Nm=5e-8",
        "encoder_scale:6=1e-4",
        "wrist_coupling:4=1e-3,source_joint=6",
        "link_thermal=1e-5",
        "joint_thermal:2=5e-6",
        "base_tilt=3e-5/1e-5/0,at_s=5000",
        "tracker_drift=3e-5/0/1e-5,rad_per_h=1e-5/0/0",
        "target_shift=1e-4/0/-1e-4,target=T2,at_s=4000",
        "gravity_compensator:2=2e4,lever_link1_m=0.2,lever_arm_m=0.2",
        "gear_1x:2=1e-4",
        "tracker_scale=5e-6",
        "joint_coupling:3=2e-4,source_joint=2",
        "load_backlash:3=1e-4,torque_Nm=63.9",
        "tool_flex=5e-8",
        "air_scale=-1e-6",
        "azimuth_harmonic=2e-5,order=2,phase_rad=1",
    ],
)
def test_exact_signatures_hold_what_the_machine_does(machine, scene, text, library):
    effect = parse_effect(text)
    d = machine.points([effect]) - machine.points(())
    own = next(f for f in library if f.name == oracle.name_of(effect))
    flat = own.columns.reshape(3 * len(scene), own.columns.shape[2], -1)
    left = min(np.linalg.norm(d.ravel() - C @ np.linalg.lstsq(C, d.ravel(), rcond=None)[0]) for C in np.moveaxis(flat, 1, 0))
    assert left < 0.02 * np.linalg.norm(d)


@pytest.fixture(scope="module")
def library(machine, scene):
    return tracker_families(machine, scene)


def test_the_oracle_names_what_is_there(machine, scene, library):
    white = tracker_whitener(scene)
    known = oracle.whitened(library, white)
    effects = [parse_effect("backlash:5=3e-4"), parse_effect("gear_2x:1=2e-4,phase_rad=1")]
    d = white.apply(machine.points(effects) - machine.points(()))
    rng = np.random.default_rng(1)
    noise = rng.normal(size=len(d))
    assert set(oracle.chosen(known, d + noise)) == {("backlash", 5), ("gear_2x", 1)}
    assert oracle.chosen(known, noise) == []
    assert "backlash" not in {effect for effect, _ in known.without(["backlash"]).names}
    alone = white.apply(machine.points(effects[:1]) - machine.points(()))
    assert oracle.cannot_be_imitated(known, alone) < 0.02 * (alone @ alone)


def test_the_oracle_sizes_what_is_there_and_says_what_is_like_it(machine, scene, library):
    white = tracker_whitener(scene)
    known = oracle.whitened(library, white)
    rng = np.random.default_rng(4)
    for text in ("backlash:5=3e-4", "gear_2x:1=2e-4,phase_rad=1", "target_shift=3e-4/0/-1e-4,target=T2,at_s=4000"):
        effect = parse_effect(text)
        d = white.apply(machine.points([effect]) - machine.points(()))
        own = oracle.name_of(effect)
        exact, noisy = (oracle.estimated(known, d + noise, own) for noise in (0.0, rng.normal(size=len(d))))
        assert oracle.size_error(exact[0], effect) < 0.03
        assert oracle.size_error(exact[0], effect) < oracle.size_error(noisy[0], effect) < 4 * np.sqrt(3 / (d @ d))
        assert oracle.size_error(exact[0], scaled(effect, 0.5)) == pytest.approx(1.0, abs=0.05)
    assert oracle.estimated(known.without(["backlash"]), d, ("backlash", 5)) is None


def test_classes_of_several_effects_are_those_that_stay_when_the_others_are_free(machine, scene, library):
    white = tracker_whitener(scene)
    known = oracle.whitened(library, white)
    soft, play = parse_effect("joint_compliance:2=1e-8"), parse_effect("backlash:5=3e-4")
    alone = [white.apply(machine.points([p]) - machine.points(())) for p in (soft, play)]
    groups = oracle.classes_among(known, (soft, play), alone)
    # Wind-up holds play; nothing else looks like it.
    assert {("backlash", 5), ("friction_windup", 5)} in groups
    faint = [1e-3 * alone[0], alone[1]]  # nobody sees it: like everything
    group, _ = oracle.classes_among(known, (soft, play), faint)
    assert ("joint_compliance", 2) in group and len(group) > 20 and ("backlash", 5) not in group
    mixed = oracle.classes_among(known, (play, soft), [alone[1] + 5 * alone[0], alone[0]])
    assert {("backlash", 5), ("friction_windup", 5)} in mixed  # what the other could be is nobody's own
    twice = [alone[1], 2 * alone[1]]  # the one is the other: neither has a direction of its own
    assert oracle.classes_among(known, (play, play), twice) == []


@pytest.mark.parametrize("name", sorted(ON_ARM))
def test_effects_outside_the_catalogue_move_readings(machine, name):
    effect = draw_effect(np.random.default_rng(2), ON_ARM[name].kind)
    d = machine.points([effect]) - machine.points(())
    twice = machine.points([scaled(effect, 2.0)]) - machine.points(())
    assert 1e-6 < np.linalg.norm(d, axis=1).max() < 3e-3
    assert np.allclose(twice, 2 * d, atol=0.02 * np.abs(d).max())
    assert within_range(effect)


def test_every_prefix_holds_the_mixture():
    many = recipes.recipes(190)
    assert recipes.recipes(40) == many[:40]
    for kind in KINDS:
        assert sum(r.kind == kind for r in many) == 10 * recipes.ROUND[kind]
    bins = [r.target for r in many if r.kind == "single"]
    assert all(bins.count(b) == 20 for b in recipes.BINS)
    with pytest.raises(BadInput, match="there is no kind 'quadruple'"):
        recipes.check_kinds("single,quadruple")


def test_effects_come_at_the_detectability_that_was_asked_for(check):
    label = read_label(check, recipes.recipes(2, check.kinds)[0], read_seal(check))
    low, high = label.recipe.target
    assert len(label.effects) == 1 and 0.75 * low < label.lam[0] < 1.25 * high
    machine = draw_tracker_machine(check.cell, check.seed, label.recipe, check.readings, check.blind)
    again = detectabilities(tracker_view(machine), label.effects)
    assert again[0] == pytest.approx(label.lam[0])


def test_answers_need_no_labels_and_are_resumed(check, tmp_path):
    planned = recipes.recipes(2, check.kinds)
    away = tmp_path / "labels"
    (check.folder / SEALED).rename(away)
    answer_all(check, planned, HERE, Phases())
    before = [check.answer(r.name).stat().st_mtime_ns for r in planned]
    answer_all(check, planned, HERE, Phases())
    assert before == [check.answer(r.name).stat().st_mtime_ns for r in planned]
    with pytest.raises(BadInput, match="label is missing"):
        score_all(check, planned, HERE, Phases())
    away.rename(check.folder / SEALED)

    rows = score_all(check, planned, HERE, Phases())
    assert [r["kind"] for r in rows] == [r.kind for r in planned] and all(r["error"] is None for r in rows)
    assert figures.all_figures(rows) and figures.worst(rows) is not None
    make_all(check, planned, HERE, Phases())  # worlds that are there stay as they are
    assert before == [check.answer(r.name).stat().st_mtime_ns for r in planned]

    path = label_path(check, planned[0])
    sealed = path.read_text()
    path.write_text(sealed.replace(" ", "  ", 1))
    score_path(check, planned[0].name).unlink()
    with pytest.raises(BadInput, match="is not what was sealed"):
        score_all(check, planned, HERE, Phases())
    with pytest.raises(BadInput, match="is not what was sealed"):
        make_all(check, planned, HERE, Phases())
    path.write_text(sealed)


def test_a_check_with_other_options_is_not_gone_on_with(check):
    resume(check)
    with pytest.raises(BadInput, match="another seed"):
        resume(replace(check, seed=6))
    check.answer("00009").parent.mkdir(exist_ok=True)
    with pytest.raises(BadInput, match="no answer yet"):
        score_all(check, recipes.recipes(3, check.kinds), HERE, Phases())


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_killed_check_leaves_no_file_that_is_not_listed(tmp_path, jobs):
    out = tmp_path / "check"
    command = [sys.executable, "-m", "ocp.blindtest", "--worlds", "3", "--kinds", "none", "--readings", "40", "--jobs", jobs]
    with subprocess.Popen([*command, "--out", str(out)], cwd=ROOT, stderr=subprocess.PIPE) as run:
        until = time.monotonic() + 120
        while not list(out.glob("sealed/*.json")) and run.poll() is None and time.monotonic() < until:
            time.sleep(0.002)
        run.kill()
        run.wait()
        assert run.stderr is not None and run.stderr.read() == b""  # closed: the last of its processes is gone
    assert list(out.glob("worlds/*/tracker.csv")) and users_file(out) is None
    with reserved(out, overwrite=True, grows=True):
        assert [p.name for p in tmp_path.iterdir()] == ["check"]
    mine = next(out.glob("worlds/*/tracker.csv")).with_name("notes.txt")
    mine.write_text("mine")
    with (
        pytest.raises(BadInput, match=rf"worlds/{mine.parent.name}/notes\.txt, which this software did not write"),
        reserved(out, True, grows=True),
    ):
        pass


def test_answers_that_were_changed_by_hand_are_not_forgotten(tmp_path):
    made = Check(tmp_path, 1, 1, ("none",))
    add_text_file(tmp_path, "answers/00001.json", "{}")
    add_text_file(tmp_path, "scores/00001.json", "{}")
    made.answer("00002").write_text("mine")
    with pytest.raises(BadInput, match=r"answers/00002\.json: stands where this run writes"):
        forget_answers(made)
    made.answer("00002").unlink()
    forget_answers(made)
    assert not made.answer("00001").exists() and not score_path(made, "00001").exists()


def test_an_answer_that_fails_is_kept_as_wrong(tmp_path):
    made = Check(tmp_path, 1, 1, ("none",))
    (tmp_path / "worlds" / "00001").mkdir(parents=True)
    (tmp_path / "worlds" / "00001" / "cell.toml").write_text("name = 3\n")
    make_answer(made, Recipe(1, "none", 0, None))
    assert json.loads(made.answer("00001").read_text())["error"].startswith("BadInput: worlds/00001: holds none of")


def test_a_name_is_right_within_its_class_with_the_joint():
    groups = [{("gear_1x", 3), ("encoder_scale", 3)}]
    assert scoring.first_right([("encoder_scale", 3)], [("gear_1x", 3)], groups, 1)
    assert not scoring.first_right([("encoder_scale", 3)], [("gear_1x", 2)], groups, 1)
    assert not scoring.first_right([("encoder_scale", 3)], [("backlash", 3), ("encoder_scale", 3)], [], 1)
    assert scoring.first_right([("encoder_scale", 3)], [("backlash", 3), ("encoder_scale", 3)], [], 3)
    # One name is never taken for two effects.
    assert scoring.matched([("encoder_scale", 3), ("gear_1x", 3)], [("gear_1x", 3)], groups) == 1
    assert scoring.matched([("encoder_scale", 3), ("gear_1x", 3)], [("gear_1x", 3), ("encoder_scale", 3)], groups) == 2


def test_values_are_compared_as_they_are_meant():
    wave = Planted("gear_1x", 2, {"amplitude_rad": 1e-4, "phase_rad": 6.2})
    told = {
        "amplitude_rad": {"value": 1.1e-4, "sd": 5e-6, "unit": "rad"},
        "phase_rad": {"value": 0.0168, "sd": 0.1, "unit": "rad"},
    }
    error, z = scoring.value_errors(wave, told)
    assert error == pytest.approx(0.1) and z == pytest.approx([2.0, 1.0], abs=0.01)
    spring = Planted("gravity_compensator", 2, {"stiffness_N_m": 2e4, "lever_link1_m": 0.2, "lever_arm_m": 0.3})
    other = {
        k: {"value": v, "sd": s, "unit": ""}
        for k, v, s in (("stiffness_N_m", 1e4, 500.0), ("lever_link1_m", 0.4, None), ("lever_arm_m", 0.3, None))
    }
    assert scoring.value_errors(spring, other)[0] == pytest.approx(0.0)
    shift = Planted("payload_com", None, {"shift_m": (0.03, 0.0, 0.04)})
    assert scoring.value_errors(shift, {"shift_m": {"value": [0.03, 0.005, 0.04], "sd": [0.01] * 3, "unit": "m"}})[
        0
    ] == pytest.approx(0.1)


def row(kind: str, lam=(), first=True, **more):
    planted = [["backlash", k + 1, {"half_width_rad": 1e-4}] for k in range(len(lam))]
    part = {"top1": first, "top3": True, "first": ["backlash", 1], "set": [len(lam), len(lam), len(lam)]}
    base = {
        "world": "00001",
        "kind": kind,
        "planted": planted,
        "lam": list(lam),
        "error": None,
        "left": None,
        "diagnosis": part,
        "strict": part,
        "oracle": part,
        "rivals": {m: part for m in answers.METHODS},
        "verdict": "explained",
        "p_none": 0.0,
        "p_unknown": 0.0,
        "said": [["backlash", 1, 0.9]],
        "named": [["backlash", 1]],
        "classes": [],
        "reliability": [[0.9, first]],
        "location": 1,
        "shrinkage": {"predicted": 0.8, "low": 0.7, "high": 0.9},
        "values": [[0.02, [1.0, 2.0]] for _ in lam],
        "smallest": [0.1 for _ in lam],
        "exact_smallest": [0.1 for _ in lam],
        "sure_class": [],
        "possible_class": [],
        "true_classes": [],
        "oracle_error": 0.01,
        "oracle_class": [],
        "seconds": {"cpu": 2.0, "wall": 3.0},
        "realised": {"before": 1.0, "after": 0.25, "named": 0.23, "floor": 0.1, "covered": 0.9},
    }
    return base | more


def test_the_table_of_hand_made_answers():
    three = {"top1": True, "top3": True, "first": ["backlash", 1], "set": [1, 3, 2]}
    rows = [
        row("single", (120.0,)),
        row("single", (150.0,), False),
        row("single", (20.0,)),
        row("none", verdict="no_gap", reliability=[]),
        row("none", verdict="explained", reliability=[[0.9, False]], shrinkage=None),
        row("pair", (60.0, 70.0), diagnosis=three),
        row("single", (40.0,), sure_class=[["gear_1x", 1]], possible_class=[["gear_1x", 1]], oracle_class=[["gear_1x", 1]]),
        row("outside", (200.0,), left=150.0, p_unknown=0.7, reliability=[[0.1, False]], location=1),
        row("outside", (200.0,), left=150.0, p_unknown=0.1, reliability=[[0.1, False]], location=2),
    ]
    found = {f.what: f for f in figures.all_figures(rows)}
    assert found["top-1 effect and joint, lambda >= 100"].estimate.value == 0.5
    assert found["top-1 effect and joint, lambda 15-30"].estimate.value == 1.0
    assert found["top-1 effect and joint, lambda 50-100"].estimate.count == 0
    assert found["false alarms, no effect, clean"].estimate.value == 0.5
    assert found["two effects, each lambda >= 50, F1"].estimate.value == pytest.approx(2 * 1 / (3 + 2))
    assert found["none of these, effect the library cannot imitate"].estimate.value == 0.5
    assert found["joint named right, effect outside the library"].estimate.value == 0.5
    assert found["confident wrong name (p > 0.8)"].estimate.value == pytest.approx(2 / 9)
    best = {what: f.oracle.value for what, f in found.items() if f.oracle.count}
    assert best["two effects, each lambda >= 50, F1"] == 1.0 and best["false alarms, no effect, clean"] == 0.0
    assert best["effect value, median error, lambda >= 100"] == 0.01 and best["joint named right, lambda >= 30"] == 1.0
    assert found["declared 'cannot tell apart', recall"].estimate.value == 0.0
    assert best["declared 'cannot tell apart', recall"] == 1.0
    assert found["effect value, coverage of the 90 % interval"].estimate.value == 0.5
    assert found["shrinkage at new conditions, named right, of what can be explained"].estimate.value == pytest.approx(0.75 / 0.9)
    assert found["harmful corrections"].estimate.value == 0.0
    assert found["predicted against realised shrinkage, median difference"].estimate.value == pytest.approx(0.03)
    assert found["top-1 effect and joint, lambda >= 100"].met is False
    bad = figures.worst(rows)
    assert bad[0]["kind"] == "none" and len(bad) == 4
    assert "false alarm" in figures.why_words(bad[0]) and "backlash:1 (150)" in [figures.planted_words(r) for r in bad]


def test_the_report_shows_figures_and_the_worst_answers(tmp_path):
    rows = [row("single", (120.0,)), row("single", (35.0,), False), row("none", verdict="no_gap", reliability=[], said=[])]
    check = Check(tmp_path, 3, len(rows), ("single", "none"), 60)
    standing = Standing("answer 2", "Seed 3 was answered before.", False)
    write_blindtest_report(check, rows, standing)
    if CHROMIUM:
        looked_at(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in (
        "How often the name is right",
        "The worst answers",
        "best single free parameter",
        f"{len(rows)} worlds",
        standing.sentence,
    ):
        assert words in page
    assert page.count("<svg") == 2 and "## Figures" in (tmp_path / "table.md").read_text(encoding="utf-8")
    assert "seed 3: answer 2" in (tmp_path / "table.md").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))["standing"] == "answer 2"
    assert "seed 3 (answer 2): " in blindtest_last_line(check, rows, standing)


def test_intervals():
    assert figures.share_of_hits([True] * 9 + [False]).low == pytest.approx(0.5958, abs=1e-3)  # Wilson, 9 of 10
    assert figures.share_of_hits([True] * 9 + [False]).high == pytest.approx(0.9821, abs=1e-3)
    assert figures.share_of_hits([]).count == 0
    assert figures.f1([(2, 2, 2), (0, 1, 2)]).value == pytest.approx(2 * 2 / 7)
    drawn = figures.median(np.random.default_rng(0).normal(size=200))
    assert drawn.low < 0.0 < drawn.high and drawn.high - drawn.low < 0.6


def test_chance_is_found_by_dealing_labels_anew():
    effects = ["a", "b", "c", "d"]
    rows = [row("single", (100.0,), planted=[[effects[k % 4], 1, {}]], said=[[effects[k % 4], 1, 1.0]]) for k in range(80)]
    assert figures.chance(rows).value == pytest.approx(0.25, abs=0.03)


def test_rivals_find_a_strong_effect():
    rng = np.random.default_rng(4)
    columns = [rng.normal(size=(90, V, m)) for V, m in ((1, 1), (20, 2), (1, 3), (1, 1))]
    y = 2.5 * columns[1][:, 7, 0] + rng.normal(size=90)
    names = (("a", 1), ("b", 2), ("c", 0), ("d", 3))
    made = answers.RivalColumns(names, tuple(columns), y, tuple(columns), y, 90)
    for method in (answers.single, answers.stepwise, answers.sparse, answers.unprojected):
        answer = method(made)
        assert answer.ranking[0] == ("b", 2) and answer.named[0] == ("b", 2), method
    quiet = replace(made, y=rng.normal(size=90), residual=rng.normal(size=90))
    assert answers.single(quiet).named == () and answers.unprojected(quiet).named == ()


FORBIDDEN = (
    "ocp.diagnose",
    "ocp.effects",
    "ocp.model.force_balance",
    "ocp.model.theta",
    "robots.calibration",
    "robots.kinematics",
    "robots.gravity",
    "casadi",
)
MAKERS = [path for room in ("worlds", "oracle") for path in sorted((ROOT / "ocp" / "blindtest" / room).glob("*.py"))]


@pytest.mark.parametrize("path", MAKERS, ids=lambda p: p.stem)
def test_worlds_and_the_oracle_use_nothing_of_the_diagnosis(path: Path) -> None:
    tree = ast.parse(path.read_text())
    imported = {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    imported |= {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    assert not {i for i in imported if i.startswith(FORBIDDEN)}


def test_the_answering_step_opens_no_label() -> None:
    text = (ROOT / "ocp" / "blindtest" / "answers.py").read_text()
    assert "label_path" not in text and "read_label" not in text and "SEALED" not in text


def test_the_size_that_is_seen_is_that_of_a_fitted_logistic_curve():
    """Against a search that knows no derivative, of tables in which many are seen, few, all, or none."""
    rng = np.random.default_rng(4)
    tables = [
        np.column_stack([x, rng.random(60) < expit(4.0 * (x - at))])
        for at in (0.2, 1.5, -9.0, 99.0)
        for x in [rng.normal(size=60)]
    ]
    for table, found in zip(tables, figures._at_power(np.array(tables)), strict=True):

        def unlikely(p, x=table[:, 0], hit=table[:, 1]):
            level = np.exp(p[1]) * (x - p[0])
            return -(hit * log_expit(level) + (1 - hit) * log_expit(-level)).sum() + 0.5 * p[0] ** 2 + 0.5 * (p[1] - 1.5) ** 2

        middle, slope = minimize(unlikely, [0.0, 1.5], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9}).x
        assert found == pytest.approx(np.exp(middle + np.log(9.0) / np.exp(slope)), rel=1e-4)


def test_a_size_of_which_none_is_seen_is_no_size():
    """A ripple that the other gears drown is told to be seen at no size: it says nothing of the sizes that are."""
    values = {"amplitude_rad": 4e-5, "order": 40.0, "phase_rad": 0.0}

    def row(smallest):
        return {
            "kind": "single",
            "planted": [["gear_harmonic", 2, values]],
            "smallest": [smallest],
            "exact_smallest": [0.01],
            "p_none": 0.1,
        }

    seen = [row(0.05 + 0.01 * k) for k in range(30)]
    assert figures.found_over_predicted([*seen, row(float("inf"))]) == figures.found_over_predicted(seen)
    assert figures.found_over_predicted(seen).count == 30
