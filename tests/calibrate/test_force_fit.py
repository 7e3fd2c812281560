"""Registration from grinding logs: data come from the verification's route, never from the model that is fitted."""

import csv
import shutil
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import chi2

from ocp.calibrate.force import rows as log_rows
from ocp.calibrate.force.assessment import blocks_of, held_out_blocks
from ocp.calibrate.force.blade import feed_heading, points_on_surface
from ocp.calibrate.force.fit import (
    BIAS,
    FIT_NAMES,
    RULE,
    covariance_left,
    force_prior,
    of_another_cell,
    reading_jacobian,
    reading_of,
    solve_force_log,
    surprise,
)
from ocp.calibrate.force.log import ForceLog, read_force_log
from ocp.calibrate.force.model import CORRECTION, STATE, ForceModel, ForceRows, PlacedRows
from ocp.calibrate.force.registration import ForceFit, fit_force, refuse_other_force
from ocp.calibrate.force.rows import ForceSetup, _model_of, measured_blade, prepare_force
from ocp.calibrate.report.pages import contact_sections
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.data import CELL
from ocp.model.blade_gap import surface_shape
from ocp.model.cell import Cell, read_cell
from ocp.model.theta import believed_theta, registered, wheel_at
from ocp.plan.paths import surface_cloud
from ocp.report.parts import Plot, Table
from ocp.report.plotting import WIDTH, Canvas
from ocp.shell import native
from ocp.shell.cache import flattened
from robots.calibration.store import Calibration, read_calibration, write_calibration
from robots.errors import BadInput, Infeasible
from robots.gauss_newton import minimise
from tests.support.force_world import HEADER, Run, World, arm_posterior, campaign, correlated, make_world, write_log
from trajectories.blade import find_shape, read_blade

pytestmark = pytest.mark.usefixtures("solved_once")
LADDER = [
    Run(0),
    Run(1),
    Run(0, 12.0, turn=0.2, arc=0.1),
    Run(1, 32.0, turn=-0.2, arc=-0.1),
    Run(0, 20.0, -20.0, arc=0.2),
    Run(0, contact=False),
]
FRESH = Run(1, 26.0, 20.0, 0.1, 0.15)


@dataclass(frozen=True)
class Recorded:
    """A world, its log without and with the withheld run, what a noise-free sensor would have shown, setup and fit."""

    world: World
    log: ForceLog
    truth: np.ndarray
    fresh_truth: np.ndarray
    setup: ForceSetup
    fit: ForceFit


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Recorded:
    rng = np.random.default_rng(2)
    folder = tmp_path_factory.mktemp("force")
    world = make_world(folder, rng)
    rows, truth = campaign(world, [*LADDER, FRESH], rng)
    log = read_force_log(write_log(folder / "force.csv", rows))
    fresh = log.run == len(LADDER)
    setup = prepare_force(world.cell, [log.take(~fresh), log.take(fresh)])
    fit = fit_force(world.cell, log.take(~fresh), arm_posterior(world.cell), setup)
    return Recorded(world, log.take(~fresh), truth[~fresh], truth[fresh], setup, fit)


def predict(fit: ForceFit, rows: ForceRows):
    """Reading (n,) N of any rows, sensor's bias in, and one sigma (n,) N of its noise-free value; offsets of runs count."""
    F, reading = reading_of(fit.setup.model, rows, fit.solution.x)
    return reading, fit.sd(reading_jacobian(fit.setup.model, rows, fit.solution.x, F), rows.contact)


def baseline(fit: ForceFit, rows: ForceRows):
    """Reading (n,) N before the fit: at the prior's mean."""
    return reading_of(fit.setup.model, rows, fit.solution.prior.mean)[1]


def true_parameters(recorded: Recorded) -> np.ndarray:
    x = recorded.fit.solution.prior.mean.copy()
    for name, value in recorded.world.injected.items():
        x[FIT_NAMES.index(name)] = value
    x[:30], x[30:36] = recorded.world.arm.robot.mdh.ravel(), recorded.world.arm.compliance
    return x


def misfit(recorded: Recorded, x: np.ndarray) -> float:
    at = recorded.log.contact
    return float(np.sqrt(np.mean((reading_of(recorded.setup.model, recorded.setup.rows[0], x)[1] - recorded.truth)[at] ** 2)))


def test_at_the_true_parameters_the_model_is_the_second_route(recorded):
    assert misfit(recorded, true_parameters(recorded)) < 0.08


def test_a_fresh_run_in_a_new_posture_is_predicted(recorded):
    rows = recorded.setup.rows[1]
    reading, sd = predict(recorded.fit, rows)
    error = reading - recorded.fresh_truth
    before = baseline(recorded.fit, rows) - recorded.fresh_truth
    assert np.sqrt(np.mean(before**2)) > 0.5
    assert np.sqrt(np.mean(error**2)) < 0.12
    assert np.abs(error).max() < 4 * np.sqrt(sd.max() ** 2 + 0.05**2)


def test_injected_errors_lie_where_the_posterior_says(recorded):
    solution = recorded.fit.solution
    r = solution.prior.root.shape[1]
    off = np.linalg.lstsq(solution.prior.root, true_parameters(recorded) - solution.x, rcond=None)[0]
    information = np.linalg.inv(np.linalg.inv(solution.information)[:r, :r])
    assert off @ information @ off < chi2.ppf(0.999, r)
    bias = FIT_NAMES.index("sensor_bias")
    assert abs(solution.x[bias] - 0.4) < 4 * np.sqrt(solution.covariance[bias, bias]) < 0.4


def test_figures_tell_before_and_after(recorded):
    figures = recorded.fit.figures
    assert figures.rms_before > 3 * figures.rms_after and figures.gap_after < 0.1
    assert figures.sigma == pytest.approx(0.2, rel=0.15) and figures.run_offset == 0
    assert figures.rows == recorded.log.contact.sum() and 30 < figures.independent < figures.rows / 2


def test_derivatives_are_those_of_the_force(recorded):
    model, rows = recorded.setup.model, recorded.setup.rows[0].take(slice(0, None, 53))
    x = recorded.fit.solution.x
    F, _ = reading_of(model, rows, x)
    J = reading_jacobian(model, rows, x, F)
    sd = np.sqrt(np.diag(recorded.fit.solution.prior.covariance))
    for i in np.flatnonzero(sd > 0):
        step = np.zeros_like(x)
        step[i] = 1e-3 * sd[i]
        difference = (reading_of(model, rows, x + step)[1] - reading_of(model, rows, x - step)[1]) / 2e-3
        np.testing.assert_allclose(J[:, i] * sd[i], difference, rtol=2e-3, atol=1e-6, err_msg=FIT_NAMES[i])


@pytest.mark.skipif(shutil.which("cc") is None, reason="no cc on this machine")
def test_forces_by_machine_code_have_the_same_bits(recorded, tmp_path, monkeypatch):
    """As of a log that is worth compiling; without optimisation, which takes a tenth of the time."""
    monkeypatch.setenv("GRINDPLAN_CACHE", str(tmp_path))
    monkeypatch.setattr("ocp.calibrate.force.model.WORTH_COMPILING", 0)
    monkeypatch.setattr(native, "FLAGS", ("-O0", *native.FLAGS[1:]))
    monkeypatch.setattr(native, "_told", {})
    model, rows, x = recorded.setup.model, recorded.setup.rows[0].take(slice(0, None, 11)), recorded.fit.solution.x
    other = ForceModel(model.cell, model.law)
    F, reading = reading_of(model, rows, x)
    assert np.array_equal(reading_of(other, rows, x)[1], reading)
    assert np.array_equal(reading_jacobian(other, rows, x, F), reading_jacobian(model, rows, x, F))
    assert native.evaluated_by().startswith("machine code")


def test_a_log_and_its_sealed_conditions_have_one_model(recorded):
    """As the law that covers both is one; of another law, or another cell, there is another."""
    cell, law = recorded.setup.model.cell, recorded.setup.model.law
    first = _model_of(cell, law)
    assert _model_of(cell, replace(law, low=law.low.copy())) is first
    wider = replace(law, limits=law.limits | {"force": (1.0, 99.0)})
    assert _model_of(cell, wider).law is wider
    other = replace(cell)
    assert _model_of(other, law).cell is other


def test_setpoint_and_belt_hold_row_by_row(recorded):
    model, rows = recorded.setup.model, recorded.setup.rows[0].take(np.flatnonzero(recorded.log.contact)[::40])
    x = recorded.fit.solution.x
    mixed = model.force(rows, x[:BIAS])
    assert len(np.unique(rows.setpoint)) == 3 and set(rows.belt) == {-1.0, 1.0}
    for setpoint, belt in sorted(set(zip(rows.setpoint, rows.belt, strict=True))):
        flange = replace(model.cell.flange, setpoint=setpoint)
        own = replace(model.cell, flange=flange, wheel=replace(model.cell.wheel, belt_speed=belt))
        alike = (rows.setpoint == setpoint) & (rows.belt == belt)
        assert ForceModel(own, model.law).force(rows.take(alike), x[:BIAS]) == pytest.approx(mixed[alike], abs=1e-6)
    stopped = model.force(replace(rows, belt=np.zeros(len(rows))), x[:BIAS])
    turned = model.force(replace(rows, belt=-rows.belt), x[:BIAS])
    assert np.abs(turned - mixed).max() > 1e-3
    # Friction is linear and small: without it the force stands in the middle.
    np.testing.assert_allclose(stopped, 0.5 * (mixed + turned), atol=0.02)


def test_the_joint_covariance_goes_into_a_calibration_and_back(recorded, tmp_path):
    robot = arm_posterior(recorded.world.cell)
    names = (*robot.names, "base_x")
    covariance = np.zeros((37, 37))
    covariance[:36, :36] = robot.covariance
    covariance[36, 36] = 1e-8
    covariance[36, 2] = covariance[2, 36] = 0.5e-8  # base_x hangs on a1
    robot = replace(robot, names=names, values=np.append(robot.values, 0.7), covariance=covariance)
    whole = recorded.fit.calibration(robot)
    write_calibration(tmp_path / "calibration.toml", whole)
    back = read_calibration(tmp_path / "calibration.toml")
    assert {"base_x", "wheel_x", "blade_c", "sensor_bias", "th2"} <= set(back.names)
    at = {name: i for i, name in enumerate(back.names)}
    correlation = back.covariance[at["wheel_x"], at["a1"]] / np.sqrt(
        back.covariance[at["wheel_x"], at["wheel_x"]] * back.covariance[at["a1"], at["a1"]]
    )
    # The force sees the wheel against the arm: both moved by the same amount look alike.
    assert correlation > 0.1
    moved = back.values[at["a1"]] - recorded.world.cell.robot.mdh[0, 2]
    assert back.values[at["base_x"]] - 0.7 == pytest.approx(0.5 * moved, rel=1e-6)
    assert "poses" in back.provenance and back.provenance["force"]["rows"] == recorded.fit.figures.rows
    cell, theta = registered(replace(recorded.world.cell, calibration=back))
    law = recorded.fit.setup.model.law
    softer = replace(law, geometry=replace(law.geometry, modulus=cell.wheel.cover_modulus))
    rows = recorded.fit.setup.rows[0].take(slice(0, None, 40))
    give = rows.waypoint.copy()
    give[:, 12:15] /= 1 + recorded.fit.solution.x[FIT_NAMES.index("blade_stiffness_scale")]
    rows = replace(rows, waypoint=give, setpoint=rows.setpoint + cell.flange.setpoint - 20.0)
    plan = ForceModel(cell, softer).force(rows, theta.values)
    np.testing.assert_allclose(plan, recorded.fit.solution.reading[::40] - recorded.fit.solution.x[BIAS], atol=0.02)


def joints(cell: Cell) -> float:
    return believed_theta(replace(cell, calibration=arm_posterior(cell))).joint_noise


def test_folds_are_refits_without_the_block(recorded):
    log, rows = recorded.log, recorded.fit.setup.rows[0]
    fold = held_out_blocks(recorded.fit.solution, log, rows)["run"][3]
    kept = log.run != 3
    prior = force_prior(recorded.world.cell, arm_posterior(recorded.world.cell))
    again = solve_force_log(recorded.setup.model, rows.take(kept), log.take(kept), prior, joints(recorded.world.cell))
    reading = reading_of(recorded.setup.model, rows.take(~kept), again.x)[1]
    error = log.fn[~kept] - reading
    assert fold.rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.05)
    assert fold.mean == pytest.approx(error.mean(), abs=0.03)
    assert set(blocks_of(log, rows)) == {"run", "line", "setpoint", "belt direction"}


def test_what_cannot_be_seen_is_named(recorded):
    told = recorded.fit.not_identified
    assert "wheel_y" in told and "not seen by this log" in told["wheel_y"] and "along y of the base" in told["wheel_y"]
    together = next(key.split() for key in told if " " in key and "wheel_x" in key.split())
    assert "blade_y" in together and "cannot be told from" in told[" ".join(together)]
    assert "sensor_bias" not in told


def tampered(recorded: Recorded, fn: np.ndarray, keep: np.ndarray | None = None) -> ForceFit:
    log, setup = replace(recorded.log, fn=fn), recorded.setup
    if keep is not None:
        log, setup = log.take(keep), setup.take(keep)
    return fit_force(recorded.world.cell, log, arm_posterior(recorded.world.cell), setup)


def test_without_air_the_bias_is_not_told(recorded):
    fit = tampered(recorded, recorded.log.fn, recorded.log.contact)
    i = FIT_NAMES.index("sensor_bias")
    assert fit.solution.covariance[i, i] > 4 * recorded.fit.solution.covariance[i, i]
    assert any("no air run" in notice for notice in fit.notices)


def test_the_sensors_own_sigma_is_the_least_that_is_believed(recorded):
    log = replace(recorded.log, sigma_fn=np.full(len(recorded.log), 0.6))
    prior, rows = recorded.fit.solution.prior, recorded.setup.rows[0]
    shy = solve_force_log(recorded.setup.model, rows, log, prior, 0.0)
    bold = solve_force_log(recorded.setup.model, rows, replace(log, sigma_fn=0.01 * log.sigma_fn), prior, 0.0)
    i = FIT_NAMES.index("sensor_bias")
    assert np.all(shy.channel.sigma() >= 0.6) and np.median(bold.channel.sigma()) == pytest.approx(0.2, rel=0.15)
    assert shy.covariance[i, i] > 4 * bold.covariance[i, i]


def test_outliers_hardly_move_the_fit(recorded):
    rng = np.random.default_rng(5)
    fn = recorded.log.fn.copy()
    wild = rng.random(len(fn)) < 0.03
    fn[wild] += rng.choice([-3.0, 3.0], wild.sum())
    fit = tampered(recorded, fn)
    reading, sd = predict(fit, recorded.setup.rows[1])
    plain, _ = predict(recorded.fit, recorded.setup.rows[1])
    assert np.abs(reading - plain).max() < 2.0 * sd.mean() and fit.figures.outliers > 0
    # Nor are they a gap of the cell; what was left out is judged without them too.
    assert fit.figures.rms_after > 0.5 and fit.figures.gap_after < 0.1
    held = fit.held_out["run"]
    assert max(h.gap for h in held) < 0.2 < min(h.rms for h in held)


def test_runs_that_differ_make_the_fit_less_sure(recorded):
    steps = np.array([0.0, 1.0, -0.7, 0.8, -1.2, 0.0])[recorded.log.run]
    fit = tampered(recorded, recorded.log.fn + steps)
    assert fit.figures.run_offset > 0.3 and any("runs differ by" in notice for notice in fit.notices)
    assert predict(fit, recorded.setup.rows[1])[1].mean() > 3 * predict(recorded.fit, recorded.setup.rows[1])[1].mean()


def test_runs_that_no_flange_cell_has_are_refused(recorded):
    """Twice the force, as in pounds or of another process, is met by nothing that a flange cell may be off by."""
    cell = recorded.setup.model.cell
    refuse_other_force(cell, recorded.fit)
    wild = np.array([0.0, 3.5, -3.0, 3.0, -3.5, 0.0])[recorded.log.run]
    fit = tampered(recorded, recorded.log.fn + wild)
    with pytest.raises(Infeasible, match="where 20 N were asked for, which no flange cell does"):
        refuse_other_force(cell, fit)
    tenfold = replace(fit, log=replace(fit.log, setpoint=np.full(len(fit.log), 200.0)))
    with pytest.raises(Infeasible, match="where 200 N were asked for, which no flange cell does"):
        refuse_other_force(cell, tenfold)
    refuse_other_force(replace(cell, flange=None), fit)
    pressed = float(np.median(fit.log.fn[fit.log.contact]))
    for share, message in ((0.4, None), (0.6, "the best fit misses the readings by .* press: they are not of this cell")):
        rough = replace(recorded.fit, figures=replace(recorded.fit.figures, sigma=share * pressed))
        for one in (cell, replace(cell, flange=None)):
            with pytest.raises(Infeasible, match=message) if message else nullcontext():
                refuse_other_force(one, rough)


def test_intervals_cover(recorded):
    """Parameters drawn from the prior, readings from the model with correlated noise: 90 % intervals hold 90 %."""
    rng = np.random.default_rng(7)
    log, model = recorded.log, recorded.setup.model
    thin = np.arange(0, len(log), 3)
    log, rows = log.take(thin), recorded.setup.rows[0].take(thin)
    prior = recorded.fit.solution.prior
    seen = ["wheel_x", "blade_y", "blade_c", "cover_stiffness_scale", "sensor_bias"]
    at = [FIT_NAMES.index(name) for name in seen]
    fresh = recorded.setup.rows[1].take(slice(0, None, 40))
    inside = []
    for _ in range(24):
        x = prior.mean + prior.root @ rng.normal(size=prior.root.shape[1])
        noise = np.concatenate([correlated(rng, int((log.run == i).sum())) for i in np.unique(log.run)])
        solution = solve_force_log(model, rows, replace(log, fn=reading_of(model, rows, x)[1] + noise), prior, 0.0)
        sd = np.sqrt(np.diag(solution.covariance))
        F, reading = reading_of(model, fresh, solution.x)
        J = reading_jacobian(model, fresh, solution.x, F)
        spread = np.sqrt(np.einsum("ni,ij,nj->n", J, solution.covariance, J) + solution.offset**2)
        z = np.concatenate([(x - solution.x)[at] / sd[at], (reading_of(model, fresh, x)[1] - reading) / spread])
        inside.append(np.abs(z) < 1.645)
    share = np.mean(inside, axis=0)
    # 24 campaigns: one figure may lie between 0.70 and 1, all together have little left to chance.
    assert (share >= 0.7).all() and 0.83 < share.mean() < 0.97, share


def test_a_rigid_contact_departs_from_the_law_where_the_blade_sits(recorded):
    """With the wheel 0.2 mm aside and the blade turned by a milliradian: what was differenced about the first place, and what is
    solved anew there, which is the contact of the blade's surface with the wheel where it is."""
    model, surface = ForceModel(replace(recorded.world.cell, flange=None), recorded.setup.model.law), recorded.setup.surface
    assert surface is not None
    touching = np.flatnonzero(recorded.setup.rows[0].contact)
    beside = np.argsort(np.abs(recorded.setup.rows[0].waypoint[touching, CORRECTION]))
    rows = recorded.setup.rows[0].take(touching[np.r_[beside[-400::40], beside[::200]]])
    about = replace(surface, about=np.full(len(rows), 20.0), larger=np.zeros(len(rows)))
    setup, x = ForceSetup(model, (rows,), (), about), recorded.fit.solution.x[:BIAS]
    moved = x.copy()
    for name, by in {"wheel_y": 2e-4, "blade_c": 1e-3, "blade_a": 1e-3}.items():
        moved[FIT_NAMES.index(name)] += by

    def wheel(made: ForceSetup, theta: np.ndarray) -> np.ndarray:
        return model.evaluate("state", PlacedRows.of(model.cell, made.rows[0], theta), about.about)

    here, anew = setup.at(x), setup.at(moved)
    at = wheel(here, x)
    posture, fixed = np.column_stack([at[:, STATE["lateral"]], at[:, STATE["tilt"]]]), here.rows[0].waypoint.copy()
    fixed[:, CORRECTION] += np.sum(here.rows[0].sway * posture, axis=1)
    plain = ForceSetup(model, (replace(here.rows[0], waypoint=fixed, sway=np.zeros((len(rows), 3))),), ())
    told, still, state = (wheel(made, moved) for made in (here, plain, anew))
    left, without = (np.abs(one[:, STATE["parts"]] - state[:, STATE["parts"]])[:, 1] for one in (told, still))
    assert np.linalg.norm(left) < 0.5 * np.linalg.norm(without) and without.max() > 3e-6, (left, without)
    for k in range(0, len(rows), 5):
        kxx, kyy, kxy = state[k, STATE["curvature"]]
        T, one = state[k, STATE["T"]].reshape(4, 4), wheel_at(model.cell.wheel, moved)
        flat = LocalShape(kxx, kyy, kxy, state[k, STATE["lateral"]][0], *state[k, STATE["tilt"]])
        flat = replace(flat, heading=feed_heading(one, T, rows.waypoint[k]))
        found = solve_force(about.cover, 20.0, surface_shape(one, about.cloud, flat, T, rows.waypoint[k, :3]))
        assert state[k, STATE["parts"]][1] == pytest.approx(found.indentation, abs=3e-6)


def test_recordings_are_free_by_what_joints_do(recorded):
    """Rms over the rows in contact of joint noise times the force's change by each joint, differenced; no log shows it here."""
    solution, model, step = recorded.fit.solution, recorded.fit.setup.model, 1e-7
    rows = recorded.fit.setup.rows[0].take(np.flatnonzero(recorded.log.contact))
    moved = [
        model.force(replace(rows, q=rows.q + step * axis), solution.x[:BIAS])
        - model.force(replace(rows, q=rows.q - step * axis), solution.x[:BIAS])
        for axis in np.eye(6)
    ]
    slopes = np.array(moved) / (2.0 * step)
    expected = joints(recorded.world.cell) * np.sqrt(np.mean(np.sum(slopes**2, axis=0)))
    assert solution.allowed == pytest.approx(expected, rel=0.01) and solution.offset == 0 == recorded.fit.figures.run_offset


def test_a_wheel_that_was_larger_stays_so_where_rows_are_placed_anew(recorded):
    setup, x = recorded.setup.take(np.arange(len(recorded.log)) % 40 == 0), recorded.fit.solution.x[:BIAS]
    depth = np.linspace(0.0, 1e-4, len(setup.rows[0])) * setup.rows[0].contact
    plain, larger = setup.at(x), setup.with_larger(depth).at(x).at(x)
    assert len(setup.rows) == 1 and len(setup.surface.about) == len(depth)
    change = plain.rows[0].waypoint[:, CORRECTION] - larger.rows[0].waypoint[:, CORRECTION]
    np.testing.assert_allclose(change, depth, atol=1e-12)


def test_without_a_flange_force_ends_where_the_overlap_ends(recorded):
    model = ForceModel(replace(recorded.world.cell, flange=None), recorded.setup.model.law)
    rows = recorded.setup.rows[0].take(np.full(60, 30))
    x = recorded.fit.solution.x[:BIAS]
    # The wheel is drawn back along x step by step, row by row through the blade's points.
    back = np.linspace(-2e-4, 6e-4, 60)
    waypoint = rows.waypoint.copy()
    T = model.evaluate("state", PlacedRows.of(model.cell, rows, x), np.full(60, 20.0))[0, STATE["T"]].reshape(4, 4)
    waypoint[:, :3] -= back[:, None] * (T[:3, :3].T @ [1.0, 0.0, 0.0])
    rows = replace(rows, waypoint=waypoint)
    F = model.force(rows, x)
    delta = model.evaluate("state", PlacedRows.of(model.cell, rows, x), np.maximum(F, 1.0))[:, STATE["overlap"]][:, 0]
    assert (np.diff(F) <= 1e-9).all() and F[0] > 10 and F[-1] == 0 and (F[delta <= 0] == 0).all()
    assert np.abs(np.diff(F)).max() < 2.0
    J = model.sensitivity(rows, x, F)
    assert not J[F == 0].any() and not J[:, FIT_NAMES.index("flange_stiffness")].any()
    i, step = FIT_NAMES.index("wheel_x"), 1e-7
    up, down = (model.force(rows, x + sign * step * np.eye(BIAS)[i]) for sign in (1, -1))
    steady = (F > 0.2) & (F < F[0])
    np.testing.assert_allclose(J[steady, i], ((up - down) / (2 * step))[steady], rtol=1e-4)


def changed(recorded: Recorded, folder, change) -> ForceLog:
    """The log's file with one change to its rows, read again."""
    rows = []
    with recorded.log.path.open() as file:
        for row in csv.DictReader(file):
            rows.append(row)
    rows = rows[: 3 * 30]
    change(rows)
    return read_force_log(write_log(folder / "force.csv", [[row[name] for name in HEADER] for row in rows]))


def far(rows):
    rows[5]["q3_deg"] = str(float(rows[5]["q3_deg"]) + 3.0)


def lifted(rows):
    rows[5]["py_mm"] = str(float(rows[5]["py_mm"]) + 0.5)


def metres(rows):
    for row in rows:
        row.update({name: str(float(row[name]) / 1e3) for name in ("px_mm", "py_mm", "pz_mm")})


def inward(rows):
    for name in ("nx", "ny", "nz"):
        rows[5][name] = str(-float(rows[5][name]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (far, r"line 7, columns q1_deg to q6_deg: the axes bring the contact point .* mm (off the wheel|along)"),
        (lifted, r"line 7, columns px_mm, py_mm, pz_mm: the point .* is 0\.\d+ mm off the surface of .*, the limit is 0.2 mm"),
        (metres, r"line 2, columns px_mm, py_mm, pz_mm: all .* points lie within .* if they are in metres, give millimetres"),
        (inward, r"line 7, columns nx, ny, nz: the normal .* points into the blade"),
    ],
)
def test_logs_of_another_cell_or_blade_are_refused(recorded, tmp_path, change, message):
    with pytest.raises(BadInput, match=message):
        prepare_force(recorded.world.cell, [changed(recorded, tmp_path, change)])


def test_points_a_little_off_the_surface_are_put_onto_it_and_told(recorded, tmp_path):
    def off(rows):
        rows[5]["py_mm"] = str(float(rows[5]["py_mm"]) + 0.1)

    log = changed(recorded, tmp_path, off)
    blade = read_blade(recorded.world.cell.workpiece.stl)
    foot = points_on_surface(blade, find_shape(blade), log)
    assert "1 points were put onto the blade's surface" in foot.notices[0]
    # A shift along y is one along the normal and one along the surface.
    shift = 1e-4 * np.array([0.0, 1.0, 0.0])
    wanted = recorded.log.p[5] + shift - (shift @ recorded.log.n[5]) * recorded.log.n[5]
    np.testing.assert_allclose(foot.p[5], wanted, atol=2e-6)
    untouched = np.delete(np.arange(len(log)), 5)
    np.testing.assert_array_equal(foot.p[untouched], log.p[untouched])


def test_a_measured_blade_is_kept_as_it_was_found(shared_data, tmp_path, monkeypatch):
    """Mesh, shape, surface and notices; another file's name, or other bytes, are another blade."""
    monkeypatch.setenv("GRINDPLAN_CACHE", str(tmp_path))
    stl, piece = shared_data / "blades" / "holes.stl", read_cell(CELL).workpiece
    log_rows._LAST.clear()
    measured_blade(stl, piece)
    log_rows._LAST.clear()
    with monkeypatch.context() as closed:
        closed.setattr(log_rows, "read_blade", None)  # nothing is read again
        kept = measured_blade(stl, piece)
    blade = read_blade(stl, piece.stl_unit)
    shape = find_shape(blade, piece.aerofoil)
    assert blade.notices and (kept[0].notices, kept[1].notices) == (blade.notices, shape.notices)
    assert list(kept[1].sides) == list(shape.sides) and kept[1].frame.block == shape.frame.block
    wanted, found = flattened([blade, shape, surface_cloud(shape, blade)]), flattened(list(kept))
    assert list(found) == list(wanted)
    for name, array in wanted.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)
    other = shutil.copy(stl, tmp_path / "other.stl")
    assert measured_blade(other, piece)[0].name != blade.name


def test_a_cell_without_a_blade_is_refused(recorded):
    bare = replace(recorded.world.cell, workpiece=replace(recorded.world.cell.workpiece, stl=None))
    with pytest.raises(BadInput, match=r"no blade; name it as workpiece\.stl"):
        prepare_force(bare, [recorded.log])


def test_an_earlier_calibration_of_the_contact_is_the_prior(recorded):
    cell = recorded.world.cell
    covariance = np.array([[0.04, 1e-6], [1e-6, 1e-8]])
    known = Calibration(cell.robot.name, ("sensor_bias", "wheel_x"), np.array([0.7, 1e-4]), covariance)
    prior = force_prior(cell, known)
    i, j = FIT_NAMES.index("sensor_bias"), FIT_NAMES.index("wheel_x")
    assert (prior.mean[i], prior.mean[j]) == (0.7, 1e-4) and prior.covariance[i, j] == 1e-6
    np.testing.assert_allclose(prior.root @ prior.root.T, prior.covariance, atol=1e-12 * prior.covariance.max())


def test_a_world_made_by_others_is_predicted(shared_data):
    folder = shared_data / "worlds" / "force_no_effect"
    cell = read_cell(folder / "cell.toml")
    log, sealed = read_force_log(folder / "force.csv"), read_force_log(folder / "sealed_force.csv", sealed=True)
    truth = read_force_log(folder / "labels" / "sealed_force_truth.csv").fn
    setup = prepare_force(cell, [log, sealed])
    fit = fit_force(cell, log, arm_posterior(cell), setup)
    rows: ForceRows = setup.rows[1]
    before, after = baseline(fit, rows) - truth, predict(fit, rows)[0] - truth
    assert np.sqrt(np.mean(before**2)) > 0.5 and np.sqrt(np.mean(after**2)) < 0.08
    assert fit.figures.run_offset == 0


def test_the_report_tells_of_the_contact(recorded):
    sections = contact_sections(recorded.fit)
    tables = [part for section in sections for part in section.parts if isinstance(part, Table)]
    rows = {row[0]: row for row in tables[0].rows}
    k = recorded.fit.names.index("sensor_bias")
    sd = np.sqrt(recorded.fit.covariance[k, k])
    assert rows["force reading in the air"][1:3] == (f"{recorded.fit.values[k]:.3f}", f"{sd:.3f}")
    assert not any("joint" in name for name in rows) and len(tables[1].rows) == len(recorded.fit.held_out)
    for part in (part for section in sections for part in section.parts if isinstance(part, Plot)):
        part.draw(Canvas(Figure(figsize=(WIDTH, part.height)), part.height))


def test_what_is_left_unknown_is_that_of_all_unknowns_together():
    """Against the covariance of the first of them by elimination of the others (Schur's complement)."""
    rng = np.random.default_rng(3)
    half, root = rng.normal(size=(12, 9)), rng.normal(size=(7, 4))
    whole = np.eye(9) + half.T @ half
    first, between, others = whole[:4, :4], whole[:4, 4:], whole[4:, 4:]
    alone = np.linalg.inv(first - between @ np.linalg.solve(others, between.T))
    assert covariance_left(root, whole) == pytest.approx(root @ alone @ root.T, rel=1e-9)


@dataclass(frozen=True)
class JustBearing:
    """A search whose second row bears from z = 0.5 on and reads less than nothing, while the first one pulls beyond."""

    z: np.ndarray

    def reweighted(self):
        return self

    def residual(self):
        return np.array([3.0 - self.z[0], -1.0 - 3.0 * max(self.z[0] - 0.5, 0.0)])

    def linearised(self):
        return self.residual(), np.array([[1.0], [3.0 * (self.z[0] > 0.5)]])

    def moved(self, change):
        return JustBearing(self.z + change)


def test_a_fit_on_a_kink_is_at_rest():
    """In a rigid cell the rows of ramps count: the best fit may lie where one just bears, and every step points across."""
    found = minimise(JustBearing(np.zeros(1)), np.ones(1), RULE)
    assert found.rested and found.at.z[0] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("weak", [0.0, 3.0])
def test_how_unlike_its_cell_a_log_is(weak, monkeypatch):
    """Of the cell itself every chance is as likely, whatever else is fitted and whatever the log hardly sees."""
    rng, log = np.random.default_rng(5), SimpleNamespace(path=Path("force.csv"))
    A = rng.normal(size=(12, 7)) * [1.0, 0.6, 0.8, 0.01, 1.2, 1.0, 1.0]
    A[:, 5] += weak * A[:, 0]  # a run and an effect beside five of the cell's
    information, chances = np.eye(7) + A.T @ A, []
    others = information[5:, 5:]
    seen = information[:5, :5] - information[:5, 5:] @ np.linalg.solve(others, information[5:, :5]) - np.eye(5)
    for _ in range(3000):
        z = np.linalg.solve(information, A.T @ (A @ rng.normal(size=7) + rng.normal(size=12)))
        chances.append(surprise(seen, z[:5])[2])
        assert of_another_cell(log, information, z, 5) == ()
        with monkeypatch.context() as usual:
            usual.setattr("ocp.calibrate.force.fit.OTHER_CELL", 0.1)
            assert bool(of_another_cell(log, information, z, 5)) == (chances[-1] <= 0.1)
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.02)
    assert surprise(seen, z[:5])[1] == np.sum(np.linalg.eigvalsh(seen) > 1.0) < 5  # one is hardly seen
    far = np.linalg.solve(information, A.T @ (A @ [0.0, 12.0, 0.0, 0.0, 0.0, 0.0, 0.0] + rng.normal(size=12)))
    assert of_another_cell(log, information, far, 5)[0].startswith(
        "force.csv: the fit needs wheel, blade, arm, stiffnesses or sensor farther"
    )
    beside = np.linalg.solve(information, A.T @ (A @ [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 12.0] + rng.normal(size=12)))
    assert of_another_cell(log, information, beside, 5) == ()  # what an effect may be off by is none of the cell's
