"""Force worlds of the blind check: exact slopes and signatures, detectability, worlds and files, against the virtual cell."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.blindtest import scoring
from ocp.blindtest.interface import draw_effects
from ocp.blindtest.oracle.force import ForceView, force_nuisance, force_view, noise_roots
from ocp.blindtest.oracle.oracle import detectabilities, name_of
from ocp.blindtest.oracle.signatures import force_families
from ocp.blindtest.scoring import realised_shrinkage, with_small
from ocp.blindtest.worlds.bench import Bench, drawn_runs, rows_of_runs
from ocp.blindtest.worlds.machines import STORE, GrindingMachine, draw_grinding_machine
from ocp.blindtest.worlds.outside_lists import ON_GRINDING
from ocp.blindtest.worlds.recipes import Recipe, kind_of, pool_of, scaled, within_range
from ocp.blindtest.worlds.sealing import Check, log_noise, write_cell, write_world
from ocp.calibrate.force.log import read_force_log
from ocp.data import CELL
from ocp.effects.catalogue import library
from ocp.simulate.twin.planting import Planted, draw_effect, parse_effect
from ocp.simulate.twin.truth import PLACEMENT, SENSOR_SIGMA

ROOT = Path(__file__).resolve().parents[2]
SINGLE = Recipe(1, "single", 2, (50.0, 100.0))
SOLID = np.array([4e-6, 3e-7, -2e-7])  # m/N: a blade that gives way alike everywhere, instead of finite elements


@pytest.fixture(scope="module")
def machine(tmp_path_factory) -> GrindingMachine:
    """A machine with a background, three of its runs, without finite elements."""
    folder = tmp_path_factory.mktemp("check")
    write_cell(CELL, folder / "cell.toml", "force")
    from ocp.simulate.twin.contact.table import Tables

    patch = pytest.MonkeyPatch()
    patch.setattr(Tables, "compliance", lambda self, at, solve: np.tile(SOLID, (len(at.s), 1)))
    patch.setattr("ocp.blindtest.worlds.machines.drawn_runs", few_runs)
    drawn = draw_grinding_machine(folder / "cell.toml", 4, replace(SINGLE, turn=6), 60, 40, False)
    assert drawn.background and (folder / STORE).is_file()
    yield drawn
    patch.undo()


def few_runs(rng, process, speed):
    """Of a whole campaign: two directions on a line, the other side late, another setpoint, the belt backwards, air."""
    runs, sealed = drawn_runs(rng, process, speed)
    air = next(r for r in runs if not r.contact)
    backwards = next(r for r in runs if r.belt < 0)
    other = next(r for r in runs[2:] if r.setpoint != process)
    return (*runs[:2], air, backwards, other, next(r for r in reversed(runs) if r.line == 3 and r.contact)), sealed[:1]


@pytest.fixture(scope="module")
def view(machine) -> ForceView:
    return force_view(machine)


def change(machine, **truth):
    return machine.log((), truth=replace(machine.truth, **truth)).both - machine.bare.both


def test_slopes_hold_what_the_machine_does(machine, view):
    arm, rest = force_nuisance(machine, view.slopes)
    truth, cell = machine.truth, machine.bench.cell
    placed = truth.placement.copy()
    placed[2, 4] += 1e-4  # turn of link 3 about its y axis
    shift = np.array([1e-4, 0.0, 0.0])
    turned = change(machine, blade_turn=truth.blade_turn + 1e-4 * np.eye(3)[1]) / 1e-4 * cell.workpiece.abc_sd
    moved = change(machine, wheel_shift=truth.wheel_shift + shift) / 1e-4 * cell.wheel.centre_sd
    tilted = change(machine, wheel_axis_turn=truth.wheel_axis_turn + 1e-4 * np.eye(3)[2]) / 1e-4 * cell.wheel.axis_sd
    linked = change(machine, placement=placed) / 1e-4 * PLACEMENT[1]
    for column, direct in ((arm[..., 16], linked), (rest[..., 0], moved), (rest[..., 5], tilted), (rest[..., 10], turned)):
        # N for one sigma; where the contact's table changes from one posture to the next (1 um) differences jump.
        assert np.quantile(np.abs(column - direct), 0.97) < 0.03 * np.abs(direct).max() + 2e-3
    # Placement, springs, masses, centres, payloads, play.
    assert arm.shape[2] == 36 + 6 + 7 + 18 + len(truth.payloads) + 6


def test_lambda_is_the_quadratic_form(machine, view):
    """By the lemma of Woodbury with covariances of runs inverted one by one; the whitener has singular values instead."""
    effect = parse_effect("wheel_wear=1e-7")
    A = np.concatenate(force_nuisance(machine, view.slopes), axis=2)
    d = machine.log([effect]).both - machine.bare.both
    rows = machine.rows
    B, q, h = np.eye(A.shape[2]), 0.0, np.zeros(A.shape[2])
    for k in range(len(rows.runs)):
        own = rows.run == k
        lag = np.abs(rows.time[own][:, None] - rows.time[own])
        inverse = np.linalg.inv(SENSOR_SIGMA**2 * (0.6 * np.eye(int(own.sum())) + 0.4 * np.exp(-lag / 0.03)))
        for signal in range(2):
            a, e = A[signal][own], d[signal][own]
            B, h, q = B + a.T @ inverse @ a, h + a.T @ inverse @ e, q + e @ inverse @ e
    brute = q - h @ np.linalg.solve(B, h)
    assert detectabilities(view, [effect])[0] == pytest.approx(brute, rel=1e-5)
    both = detectabilities(view, [effect, parse_effect("sensor_drift=0.5")])
    assert both[0] <= brute * (1 + 1e-9)


def test_noise_has_the_covariance_that_is_believed(machine):
    drawn = np.stack([log_noise(replace(machine, seed=k, background=False), machine.bare) for k in range(60)])
    roots = noise_roots(machine.rows)
    white = [root @ drawn[:, s, machine.rows.run == k].T for k, root in enumerate(roots) for s in range(2)]
    flat = np.concatenate([w.ravel() for w in white])
    assert np.mean(flat**2) == pytest.approx(1.0, abs=0.02)
    assert abs(np.mean([np.mean(w[1:] * w[:-1]) for w in white])) < 0.01


@pytest.mark.parametrize(
    "text",
    [
        "wheel_stiffness=0.05",
        "wheel_law=0.05",
        "wheel_wear=5e-8",
        "wheel_temperature=-0.003,radius_per_K=2e-6",
        "wheel_runout=2e-5,phase_rad=1",
        "belt_splice=1,hz=10.025125628140703",
        "material_removal=5e-6",
        "clamp_compliance=1e-7",
        "tool_frame_shift=5e-5/2e-5/0,at_s=30",
        "wheel_frame_shift=3e-5/0/0,at_s=30",
        "sensor_gain=0.01",
        "sensor_crosstalk=0.02",
        "tangential_force=0.05,leak=0.02",
        "backlash:3=2e-5",
        "joint_thermal:2=2e-6",
        "wrist_coupling:5=5e-4,source_joint=6",
        "base_tilt=0/1e-5/0,at_s=30",
        "joint_coupling:3=5e-5,source_joint=1",
        "tool_flex=1e-7",
        "load_backlash:3=5e-5,torque_Nm=63.9",
        "load_backlash:5=1e-4,torque_Nm=15.637",
        "load_backlash:6=1e-4,torque_Nm=4.991",  # where the contact's torque is larger than the weight's
        "joint_compliance:1=1e-6",
        "joint_compliance:3=5e-7",
        "gear_harmonic:2=2e-5,order=60,phase_rad=1",
    ],
)
def test_exact_signatures_hold_what_the_machine_does(machine, view, families, text):
    effect = parse_effect(text)
    d = (machine.log([effect]).both - machine.bare.both).ravel()
    assert np.abs(d).max() > 0  # all that are named above are seen on this machine
    own = next(f for f in families if f.name == name_of(effect))
    flat = np.moveaxis(own.columns.reshape(len(d), -1, own.columns.shape[3]), 1, 0)
    left = min(np.linalg.norm(d - C @ np.linalg.lstsq(C, d, rcond=None)[0]) for C in flat)
    assert left < 0.06 * np.linalg.norm(d)


@pytest.fixture(scope="module")
def families(machine, view):
    return force_families(machine, view.slopes, True)


def test_whatever_a_log_can_show_is_in_the_exact_catalogue(machine, families):
    """Else a class that holds it would be judged wrong, and an effect outside the catalogue not to be imitated."""
    shown = {name for name, e in library().items() if e.on_arm or e.on_contact}
    hidden = {"payload_com", "gravity_compensator", "joint_stiffening"}  # by teaching on the machine, all but what is tiny
    assert shown - {f.effect for f in families} == hidden
    delayed = next(f.columns[0, :, 0, 0] for f in families if f.name == ("channel_delay", 2))
    gap = next(f.columns[0, :, 0, 0] for f in families if f.name == ("backlash", 2))
    assert np.corrcoef(delayed, gap)[0, 1] < -0.7  # at few feeds a delay goes against the sign of the speed
    # A blade that is pushed back on either side presses less on both; one that shifts as a whole presses more on the other.
    slips = next(f.columns[0, :, :, 0] for f in families if f.effect == "clamp_slip").T
    contact = machine.bare.moments.contact
    ahead = machine.bare.moments.n @ machine.bare.moments.n[contact][0] > 0
    both = [one for one in slips if (np.abs(one[contact & ahead]).max() > 1.0) & (np.abs(one[contact & ~ahead]).max() > 1.0)]
    alike = [one.max() < 1e-6 * np.abs(one).max() for one in both]
    assert any(alike) and not all(alike)


@pytest.mark.parametrize("name", sorted(ON_GRINDING))
def test_effects_outside_the_catalogue_move_readings(machine, name):
    small = scaled(draw_effect(np.random.default_rng(2), ON_GRINDING[name].kind), 0.1)
    log = machine.log([small])
    d = log.both - machine.bare.both
    assert np.array_equal(log.moments.setpoint, machine.bare.moments.setpoint)  # what a flange is told, not what it does
    twice = machine.log([scaled(small, 2.0)]).both - machine.bare.both
    assert 1e-4 < np.abs(d).max() < 5.0
    assert np.allclose(twice, 2 * d, atol=0.05 * np.abs(d).max())
    assert within_range(small) and kind_of(name).part == "outside"


def test_effects_come_at_the_detectability_that_was_asked_for(view):
    effects, lam = draw_effects(4, SINGLE, view, "force")
    low, high = SINGLE.target
    assert len(effects) == 1 and 0.75 * low < lam[0] < 1.25 * high
    assert effects == draw_effects(4, SINGLE, view, "force")[0]
    assert {k.name for k in pool_of(SINGLE, "both")} > {k.name for k in pool_of(SINGLE, "force")}


def test_a_world_is_a_data_set_and_its_sealed_part_shows_no_force(machine, tmp_path):
    effect = parse_effect("sensor_bias=1")
    write_world(tmp_path / "a", machine, (effect,))
    write_world(tmp_path / "b", machine, ())
    shown, bare = (read_force_log(tmp_path / name / "force.csv") for name in "ab")
    assert np.allclose(shown.fn - bare.fn, 1.0, atol=2e-4) and np.allclose(shown.ft, bare.ft)
    assert len(shown) == len(machine.rows.s) and (~shown.contact).any()
    sealed = (tmp_path / "a" / "sealed_force.csv").read_text().splitlines()
    assert "fn_N" not in sealed[0] and "ft_N" not in sealed[0] and len(sealed) > 100
    assert not (tmp_path / "a" / "labels").exists()


def test_sealed_rows_follow_on_the_others(machine):
    effect = parse_effect("clamp_slip=1e-4,at_s=5")  # on the line of the first run, whatever side the sealed one is on
    side = machine.bench.lines[machine.rows.runs[0].line - 1].n(0.03)
    sealed = machine.log([effect], sealed=True)
    change = sealed.fn - machine.log((), sealed=True).fn
    facing = sealed.moments.n @ side
    assert len(change) == len(machine.sealed.s) and np.all(np.sign(change) == -np.sign(facing))


def test_the_truth_is_that_of_the_machine_that_was_measured(machine):
    """Its small drift and wear go on after the log, to 0.04 N: a truth without them is another machine's."""
    truth = machine.log(machine.small, sealed=True).fn
    assert np.abs(truth - machine.log((), sealed=True).fn).max() > 1e-3
    told = {"predictions_force": dict.fromkeys(("baseline", "corrected", "named", "sigma"), truth), "predictions": None}
    assert realised_shrinkage(machine, (), told)["realised"]["before"] < 1e-9


def test_so_is_what_is_left_where_nothing_is_planted(machine, monkeypatch):
    truth = machine.log(machine.small, sealed=True).fn[:, None]
    bare = SimpleNamespace(name="force", predict=lambda *_: SimpleNamespace(baseline=truth))
    for name, given in (("write_world", None), ("read_data_set", None), ("read_sealed", None), ("channels_of", [bare])):
        monkeypatch.setattr(scoring, name, lambda *_, given=given: given)
    assert scoring._floor(machine) < 1e-9


def test_a_value_is_judged_by_what_the_machine_has_of_it(machine):
    drift, wear = machine.small
    planted = Planted("wheel_wear", None, {"m_per_s": 1e-8})
    assert with_small(planted, machine.small).number("m_per_s") == pytest.approx(1e-8 + wear.number("m_per_s"))
    assert with_small(planted, ()) == planted and with_small(drift, (wear,)) == drift


def test_a_whole_campaign_has_what_tells_effects_apart(machine):
    runs, sealed = drawn_runs(np.random.default_rng(3), 20.0, 20.0)
    rows = rows_of_runs(machine.bench.lines, runs)
    assert 2000 < len(rows.s) < 4500 and {r.line for r in runs} == {1, 2, 3}
    assert any(not r.contact for r in runs) and any(r.belt < 0 for r in runs) and len({r.setpoint for r in runs}) == 3
    assert {r.travel for r in runs} == {-1, 1} and len({r.feed for r in runs}) == 3
    assert sealed[0].clock > runs[-1].clock and {r.feed for r in sealed}.isdisjoint({r.feed for r in runs} - {0.04})
    ends = {(r.line, round(float(s[-1 if r.travel > 0 else 0]), 6)) for k, r in enumerate(runs) for s in [rows.s[rows.run == k]]}
    assert len(ends) == 3  # every feed ends at the same place, so that all runs share their contacts


def test_a_tracker_check_is_the_same_as_before(tmp_path):
    assert "signals" not in Check(tmp_path, 1, 3, ("single",)).fixed()
    assert Check(tmp_path, 1, 3, ("single",), signals="force").fixed()["signals"] == "force"
    assert isinstance(Bench.__doc__, str)
