"""The tracker's channel and the whole search on campaigns of an arm in NumPy that knows none of the diagnosis' models."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.calibrate.tracker import as_in
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.engine.pool import given
from ocp.diagnose.foresee.anticipated import remaining
from ocp.diagnose.rules import LINES_A_GEAR, QUIET
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.held_out import added, placed_stands, tracker_folds
from ocp.diagnose.tracker.refit import RANK, believed_baseline, reliability, settled
from ocp.diagnose.verdict import diagnosis
from ocp.diagnose.verdict.answer import Remaining
from ocp.diagnose.verdict.diagnosis import _scattering, cancelling, diagnose_channels, implausible
from ocp.diagnose.verdict.location import kernel_tests
from ocp.effects.catalogue import library
from ocp.effects.effect import Active
from ocp.effects.engine.evaluate import arm_shift
from ocp.effects.engine.readings import together
from robots.calibration.layout import moved
from robots.calibration.noise import Noise, reading_covariance
from robots.calibration.solver import Campaign
from robots.calibration.uneven import scatter_by_group, scatter_by_joint
from robots.errors import BadInput
from robots.gravity import link_torques
from robots.tracker_readings import read_readings
from tests.support.simulated_campaign import EXTRA, INSTRUMENT, NESTS, PAYLOADS, campaign_readings, measured, random_truth

LIBRARY = library()
GEAR, BALANCER = Name("gear_1x", 2), Name("gravity_compensator", 2)
RATIO = np.array([256.857, 252.909, 236.368, 198.9, 209.667, 131.151])  # PHYSICS 2.1
ROBOT = replace(EXTRA, gear_ratio=RATIO)


def world(seed, shift=None, moved=None, n=150, outliers=0.0, background=0.0, compliance=None, weights=False):
    """Readings of an arm whose joints are off by shift(readings) (n, 6) rad and whose reflectors by moved(readings) (n, 3) m in
    the tracker's frame; the arm, and a function that says where reflectors of other readings would be. weights: links 4 % off in
    mass, 1 cm in their centres."""
    rng = np.random.default_rng(seed)
    truth = random_truth(rng, background, 2.5e-4)
    if compliance is not None:
        truth = replace(truth, compliance=compliance)
    if weights:
        own, robot = np.random.default_rng(seed + 100), truth.robot
        heavier = robot.link_mass * (1.0 + 0.04 * own.normal(size=7))
        truth = replace(truth, robot=replace(robot, link_mass=heavier, link_com=robot.link_com + 0.01 * own.normal(size=(7, 3))))

    def points(readings, noise=None):
        q = readings.q if shift is None else readings.q + shift(readings)
        there = truth.points(replace(readings, q=q), noise)
        return there if moved is None else there + moved(readings)

    bare = campaign_readings(rng, n)
    bare = bare.timed(np.cumsum(rng.uniform(20, 90, n)))
    bare = replace(bare, temperature=22.0 + 6.0 * (1 - np.exp(-bare.time / 3000.0)))
    # `measured` asks the arm itself: give it the planted places through a stand-in with the same method
    stand_in = type("Arm", (), {"points": staticmethod(points)})()
    return measured(stand_in, bare, rng, outliers), points


def channel(readings, compliant=(2, 3)):
    """The believed arm fitted."""
    return TrackerChannel(*believed_baseline(Campaign(ROBOT, readings, PAYLOADS, INSTRUMENT), compliant, 22.0))


def column(j, values):
    """(n, 6) with values in joint j."""
    out = np.zeros((len(values), 6))
    out[:, j - 1] = values
    return out


def diagnosed(readings, known=LIBRARY, **options):
    """Findings without folds and places, which most tests need not."""
    return diagnose_channels([channel(readings)], known, Options(**({"folds": False, "where": False} | options)))


def without(*names):
    """The library without some of its effects."""
    return {name: effect for name, effect in LIBRARY.items() if name not in names}


PLANTED = {
    "backlash:5": lambda r: column(5, 2e-4 * r.approach[:, 4]),
    "gear_2x:3": lambda r: column(3, 1e-4 * np.cos(2 * r.q[:, 2] + 1.0)),
    "joint_thermal:4": lambda r: column(4, 3e-5 * (r.temperature - 22.0)),
    "motor_harmonic:2": lambda r: column(2, 6e-5 * np.cos(RATIO[1] * r.q[:, 1] + 0.4)),
    "gear_harmonic:1": lambda r: column(1, 5e-5 * np.cos(37 * r.q[:, 0])),
}


@pytest.mark.parametrize("name", PLANTED)
def test_recovers_what_was_planted(name):
    d = diagnosed(world(4, PLANTED[name])[0], where=True)
    assert d.verdict == "explained"
    same = [set(map(str, c)) for c in d.classes if name in map(str, c)]
    assert {str(d.explanations[0].names[0])} <= set().union({name}, *same)
    assert d.location is not None and d.location.joint == int(name[-1])
    if name == "backlash:5":
        assert d.ranking[0].active.parameters["half_width_rad"] == pytest.approx(2e-4, rel=0.1)
        assert d.location.depends_on == ("approach5",)
        assert d.budget[0].where == "approach5" and d.budget[0].share > 0.8


def test_huge_effects_are_named_however_much_they_scatter(monkeypatch):
    """Before they are named all of them is scatter, far more than joints have: for that nothing is selected."""
    monkeypatch.setattr("ocp.diagnose.verdict.diagnosis.select_effects", None)
    readings, _ = world(4, lambda r: column(2, 4e-3 * r.approach[:, 1]) + column(1, 2e-3 * r.approach[:, 0]), n=70)
    assert channel(readings).restless(1.0)
    d = diagnosed(readings)
    assert d.verdict == "explained" and {str(Name(*a.key)) for a in d.active} == {"backlash:1", "backlash:2"}


def test_recovers_a_pair():
    both = lambda r: PLANTED["backlash:5"](r) + PLANTED["gear_harmonic:1"](r)  # noqa: E731
    d = diagnosed(world(8, both, outliers=0.02)[0])
    assert [str(n) for n in d.explanations[0].names] == ["backlash:5", "gear_harmonic:1"]
    assert d.explanations[0].probability > 0.8


@pytest.mark.parametrize("size, classes", [(7e-4, ((GEAR, BALANCER),)), (2.2e-3, ())])
def test_a_balancer_of_no_free_length_is_no_wave_of_a_gear(size, classes):
    """Both are the same sine; a gear's is never so large as the second."""
    found = diagnosed(world(3, lambda r: column(2, -size * np.cos(r.q[:, 1])), n=80)[0])
    assert {Name(*a.key) for a in found.active} == {BALANCER} and found.classes == classes, found.ranking[:2]


def test_recovers_a_nest_that_moved():
    def moved(r):
        return np.where((r.time > 4000.0) & (r.target == 1), 1.0, 0.0)[:, None] * np.array([2e-4, -1e-4, 1e-4])

    # In the tracker's frame a nest of a turning flange does not move so; a tilted base or a drift would not pick one nest.
    d = diagnosed(world(5, None, moved)[0], where=True)
    assert d.verdict != "no_gap" and max(1.0 - d.p_none, d.p_unknown) > 0.99
    assert d.location is not None and (d.location.subsystem in ("target", "tracker") or d.p_unknown > 0.5)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_effect_is_none(seed):
    d = diagnosed(world(seed, outliers=0.02, background=1e-5)[0])
    assert d.verdict == "no_gap"
    assert d.active == ()


def test_a_scatter_that_no_such_machine_has_is_not_no_gap():
    readings, _ = world(3, n=90)
    scattered = replace(readings, point=readings.point + 1e-3 * np.random.default_rng(1).normal(size=readings.point.shape))
    found = diagnosed(scattered)
    assert found.verdict == "unexplained" and "scatter far more" in found.unknown_reasons[-1]


def test_weights_that_no_catalogue_knows_are_neither_named_nor_left():
    """Links as a catalogue has them, 4 % off in mass and 1 cm in their centres: what they do is learnt, so that the believed cell
    meets new readings with a load that was measured, and nobody is accused of it."""
    readings, points = world(4, weights=True)
    found = diagnosed(readings)
    assert found.verdict == "no_gap", found.ranking[:3]
    new = replace(campaign_readings(np.random.default_rng(9), 60), time=None, temperature=None)
    c = found.channels[0]
    sealed = c.predict(new, ())
    off = (sealed.baseline - points(new)) / sealed.sigma
    assert np.sqrt(np.mean(off**2)) < 1.0


def test_weights_bend_what_a_named_effect_lets_give():
    """Where joint 2 gives four times what is believed, so do weights that are a little off there: derivatives of links' and
    payloads' masses are those of the prediction."""
    readings, _ = world(4, n=40)
    c, spring = channel(readings), LIBRARY["joint_compliance"]
    active = (Active(spring, 2, np.array([1.0]), {"unit": 1e-6}, np.eye(1)),)
    state, layout = c.fit.state, c.task.layout
    J = c.task.linearised(state, active)[0].J[:, :3]
    for at in (*layout.links[:2], *layout.payload[:, 0]):
        if at >= 0:
            step = np.zeros(layout.size)
            step[at] = 0.1 * layout.prior_sd[at]
            ends = [c.task.points(moved(layout, state, side * step), active) for side in (1.0, -1.0)]
            slope = (ends[0] - ends[1]) / (2.0 * step[at])
            np.testing.assert_allclose(J[:, :, at], slope, atol=0.01 * np.abs(slope).max())
    bare, torques = c.task.linearised(state, ())[0], link_torques(ROBOT, readings.q)
    more = bare.d_joints[:, :, 1, None] * 1e-6 * torques[:, None, 1]
    found = (J - bare.J[:, :3])[:, :, layout.links]
    np.testing.assert_allclose(found, more, atol=0.01 * np.abs(more).max())  # d_joints are those of another sag


def test_what_one_effect_gives_under_another_counts_once_and_is_in_both_derivatives():
    readings, _ = world(4, n=40)
    spring, mass = LIBRARY["joint_compliance"], LIBRARY["payload_mass"]
    heavier = {"payload": readings.payloads[0]}
    both = (Active(spring, 2, np.array([1.0]), {"unit": 1e-6}, np.eye(1)), Active(mass, 0, np.array([9.0]), heavier, np.eye(1)))
    c = channel(readings)
    seen = c.task.placed(c.fit.state, both)
    parts, shift, _ = together(both, seen)
    for rows, _, arm in seen.bare_groups:
        np.testing.assert_allclose(shift[rows], arm_shift(both, arm).joints[0, :, :, 0], atol=1e-9)
    for k, one in enumerate(both):
        step = 1e-3 * one.a
        ends = []
        for side in (1.0, -1.0):
            near = tuple(replace(a, a=a.a + side * step) if a is one else a for a in both)
            ends.append(together(near, c.task.placed(c.fit.state, near))[1])
        np.testing.assert_allclose(parts[k][:, :6, 0], (ends[0] - ends[1]) / (2.0 * step), rtol=1e-4, atol=1e-9)
    # A name that is not yet accepted is seen as what is accepted lets it bend.
    columns = [one.variants(mass, 0, [heavier])[1] for one in (c, replace(c, fit=replace(c.fit, active=both[:1])))]
    assert np.abs(columns[1]).max() > 2.0 * np.abs(columns[0]).max()


def test_a_fold_without_names_is_that_of_the_believed_arm_refitted():
    """Where a joint that is believed rigid gives, links' weights do not bend it in the arm that the name is held against."""
    rigid = channel(world(4, compliance=np.array([0.0, 2e-7, 0.0, 0.0, 0.0, 0.0]))[0], compliant=())
    named = rigid.with_active((Active(LIBRARY["joint_compliance"], 2, np.array([0.2]), {"unit": 1e-6}, np.eye(1)),))
    for fold in rigid.folds():
        found, expected = named.held_out(fold, named.active), rigid.held_out(fold, ())
        before, after, _ = found.means
        assert 0.75 < np.sqrt(before / expected.means[0]) < 1.3, fold.name
        assert after < 0.1 * before


@pytest.mark.parametrize("seed", [4, 9])
def test_a_soft_joint_under_weights_that_no_catalogue_knows_is_all_that_is_named(seed):
    soft = np.array([0.0, 1.4e-6, 4e-7, 0.0, 0.0, 0.0])
    found = diagnosed(world(seed, compliance=soft, weights=True)[0])
    assert {Name(*a.key) for a in found.active} == {Name("joint_compliance", 2)}, found.ranking[:4]


@pytest.mark.parametrize("quiet, named", [(QUIET, True), (2.0, False)])
def test_a_small_ripple_stands_out_where_all_other_gears_are_quiet(quiet, named, monkeypatch):
    """18 urad, below the usual range, in one gear; for any gear's ripple where the others were not asked."""
    monkeypatch.setattr("ocp.diagnose.rules.QUIET", quiet)
    readings, _ = world(21, lambda r: column(2, 1.8e-5 * np.cos(52 * r.q[:, 1] + 0.5)), n=250)
    found = diagnosed(readings)
    assert ({Name(*a.key) for a in found.active} == {Name("gear_harmonic", 2)}) == named, found.ranking[:2]


def loud(r, size=1.7e-5):
    """Three lines of 17 urad in every gear."""
    rng = np.random.default_rng(8)
    orders, phases = rng.integers(20, 150, (6, 3)), rng.uniform(0.0, 6.28, (6, 3))
    return sum(column(j + 1, size * np.cos(orders[j, k] * r.q[:, j] + phases[j, k])) for j in range(6) for k in range(3))


def test_what_no_repeatability_scatters_is_in_the_sigma():
    """Errors of 70 urad a joint are the same when a posture comes again: predictions are as unsure."""
    readings, points = world(22, lambda r: loud(r, 6e-5))
    c, new = channel(readings), replace(campaign_readings(np.random.default_rng(9), 60), time=None, temperature=None)
    sealed = c.predict(new, ())
    levers = np.sum(c.fit.linear.d_joints**2, axis=(0, 1))
    assert c.restless(1.0) and c.background.draws.mean(axis=0) @ levers / levers.sum() < c.fit.noise.joints**2
    assert 0.8 < np.sqrt(np.mean(((sealed.baseline - points(new)) / sealed.sigma) ** 2)) < 1.25


def flopping(r):
    """The third nest hangs by 0.2 mm to one side or the other."""
    side = np.random.default_rng(5).choice([-1.0, 1.0], len(r)) * (r.target == 2)
    return 2e-4 * side[:, None] * np.array([0.6, 0.0, 0.8])


def test_a_nest_that_flops_is_no_noise_of_the_joints():
    readings, points = world(27, moved=flopping, n=100)
    found = diagnosed(readings)
    assert found.verdict == "unexplained" and found.unknown_reasons
    again = _scattering(found)  # as where a force log beside it finds no rest
    assert (again.unknown_reasons, again.p_unknown, again.location) == (found.unknown_reasons, found.p_unknown, found.location)
    for place in (found.location, found.remainder):
        assert (place.subsystem, place.depends_on, place.segments) == ("target", ("target",), (readings.targets[2],))
    after = found.channels[0]
    left = remaining(after, ())
    assert left.p_value < 1e-6 and 0.8 < after.uneven.rms / 2e-4 < 1.2
    assert left.above_noise == pytest.approx(after.uneven.rms * np.sqrt(np.mean(readings.target == 2)))
    sealed = after.predict(readings, ())
    off = np.abs(sealed.baseline - points(readings))[readings.target == 2]
    assert off.max() < 3.0 * sealed.sigma[readings.target == 2].max()


def test_a_joint_that_errs_by_what_no_kernel_knows_is_no_noise_of_all():
    """Small beside the first axes' long levers, through which the noise of all joints acts as well."""
    readings, _ = world(31, lambda r: column(5, 9e-5 * np.random.default_rng(3).normal(size=len(r))))
    found = diagnosed(readings)
    assert found.verdict == "unexplained" and not found.active and "at joint 5" in found.unknown_reasons[0]
    assert (found.location.subsystem, found.location.joint, found.location.depends_on) == ("joint", 5, ())


def test_a_joint_that_scatters_as_gears_do_is_no_gap():
    """Several times the others', surely, and no more than a gear's ripple under no name."""
    readings, _ = world(31, lambda r: column(5, 2.6e-5 * np.random.default_rng(3).normal(size=len(r))))
    found = diagnosed(readings)
    assert found.verdict == "no_gap" and found.channels[0].uneven is None


@pytest.mark.parametrize("joint", [None, 5])
def test_an_instrument_worse_than_stated_is_no_joint_of_short_levers(joint):
    rng = np.random.default_rng(4)
    readings = replace(campaign_readings(rng, 200), point=rng.uniform(1.0, 4.0, (200, 3)))
    d_joints, noise = rng.normal(size=(200, 3, 6)) * [2.5, 2.0, 1.5, 0.5, 0.3, 0.2], Noise(1e-5)
    root = np.linalg.cholesky(9.0 * reading_covariance(readings, INSTRUMENT, Noise(0.0), d_joints))
    off = np.einsum("nij,nj->ni", root, rng.normal(size=(200, 3))) + np.einsum(
        "nij,nj->ni", d_joints, noise.joints * rng.normal(size=(200, 6)) * np.where(np.arange(6) == (joint or 0) - 1, 40.0, 1.0)
    )
    found = scatter_by_joint(off, readings, INSTRUMENT, noise, d_joints)
    surest = min(found, key=lambda one: one.p_value)
    if joint is None:
        assert surest.p_value > 0.01
    else:
        assert surest.name == f"{joint}" and surest.p_value < 1e-6 and 0.7 < surest.joints / (40.0 * noise.joints) < 1.4


def test_a_scatter_that_is_even_was_looked_at_all_the_same(monkeypatch):
    monkeypatch.setattr(f"{remaining.__module__}._of_tracker", lambda channel: Remaining(0.0, 1e-3))
    even = channel(world(27)[0])
    assert even.uneven is None and remaining(even, ()).p_value == pytest.approx(2e-3)


def test_what_a_kernel_would_take_is_its_share_of_the_gap(monkeypatch):
    """A frame that swings by 0.1 mm, all over time; noise of joints that stands for it is no measure of its size."""
    monkeypatch.setattr(f"{remaining.__module__}._of_tracker", lambda channel: Remaining(0.0, 1.0))

    def swing(r):
        return 1.2e-4 * np.stack([np.sin(r.time / 1200), np.cos(r.time / 900), np.sin(r.time / 1700 + 1)], axis=1)

    c = channel(world(4, moved=swing)[0])
    problem = linearised([c], {}, Options())
    tests = kernel_tests(problem, given(problem.pool, ()))
    left = remaining(c, tests)
    gap = float(np.sqrt(np.mean(np.sum(c.gap() ** 2, axis=1))))
    assert 0.8 * gap < left.above_noise < gap and left.p_value < 1e-20
    best = min(tests, key=lambda t: t.p_value)
    half = remaining(c, [replace(best, gained=0.49 * float(np.sum(c.system.residual**2)))])
    assert half.above_noise == pytest.approx(0.7 * gap, rel=0.01)  # but for gross readings


@pytest.mark.parametrize("far", [1.0, 4.0])
def test_readings_scatter_alike_whatever_their_levers_and_the_faults_among_them(far):
    """Of a nest four times as far out, two gross ones; the tracker's own noise in it."""
    rng = np.random.default_rng(3)
    readings = replace(campaign_readings(rng, 300), point=rng.uniform(1.0, 4.0, (300, 3)))
    d_joints = rng.normal(size=(300, 3, 6)) * np.where(readings.target == 1, far, 1.0)[:, None, None]
    noise = Noise(2e-5)
    root = np.linalg.cholesky(reading_covariance(readings, INSTRUMENT, noise, d_joints))
    off = np.einsum("nij,nj->ni", root, rng.normal(size=(300, 3)))
    off[np.flatnonzero(readings.target == 1)[:2]] = 3e-3
    groups = scatter_by_group(off, readings, INSTRUMENT, noise, d_joints, 8)
    assert len(groups) > 4 and min(one.p_value for one in groups) > 0.01
    loose = np.where(readings.target == 1, 2.0, 1.0)[:, None] * off
    worst = min(scatter_by_group(loose, readings, INSTRUMENT, noise, d_joints, 8), key=lambda one: one.p_value)
    assert worst.name == readings.targets[1] and worst.p_value < 1e-6 and 1.5 < worst.ratio < 3.0


@pytest.mark.parametrize("lines, named", [(LINES_A_GEAR, False), (1, True)])
def test_the_ripple_of_a_gear_among_loud_ones_is_no_effect(lines, named, monkeypatch):
    """With one line a gear in the background the names of others are its second and third."""
    monkeypatch.setattr("ocp.diagnose.rules.LINES_A_GEAR", lines)
    found = diagnosed(world(22, loud)[0])
    assert bool(found.active) == named, found.ranking[:3]


def test_an_effect_outside_the_catalogue_is_placed_but_not_named():
    d = diagnosed(world(6, lambda r: column(3, 3e-4 * np.sin(2 * r.q[:, 2]) * np.cos(2 * r.q[:, 0])))[0], where=True)
    assert d.verdict == "unexplained"
    assert d.location is not None and d.location.joint == 3
    assert set(d.location.depends_on) == {"q3", "q1"}


def test_what_is_withheld_from_the_library_is_not_named():
    readings, _ = world(4, PLANTED["backlash:5"])
    d = diagnosed(readings, without("backlash", "friction_windup"), where=True)
    assert d.verdict == "unexplained"
    assert d.location is not None and d.location.joint == 5


def test_fitting_effects_and_taking_them_out_again_comes_back():
    first = channel(world(4, PLANTED["backlash:5"])[0])
    e = LIBRARY["backlash"]
    with_it = first.with_active((Active(e, 5, np.array([1e-4]), {}, np.eye(1)),))
    assert with_it.active[0].a[0] == pytest.approx(2e-4, rel=0.1)
    assert with_it.noise_floor < first.noise_floor
    again = with_it.with_active(())
    np.testing.assert_allclose(again.gap(), first.gap(), atol=4e-6)


def test_columns_are_derivatives_of_the_nonlinear_prediction():
    """Finite differences of the fit's residual in the coefficient, geometry held."""
    c = channel(world(4)[0])
    for name, joint in (("backlash", 5), ("payload_mass", 0), ("link_thermal", 0), ("tracker_drift", 0), ("base_tilt", 0)):
        e = LIBRARY[name]
        scans, columns = c.variants(e, joint)
        step = 1e-2 * np.asarray(e.prior_sd)

        one = Active(e, joint, step, scans[-1], np.eye(len(step)))
        there, _ = c.task.linearised(c.fit.state, (one,))
        moved = np.einsum("nij,nj->ni", c.fit.W, c.fit.linear.residual - there.residual).ravel()
        np.testing.assert_allclose(moved, columns[:, -1] @ step, atol=2e-3 * max(np.abs(moved).max(), 1e-3))


def test_linear_folds_are_as_good_as_nonlinear_refits():
    readings, _ = world(4, PLANTED["gear_2x:3"])
    e = LIBRARY["gear_2x"]
    c = channel(readings).with_active((Active(e, 3, np.zeros(2), {}, np.eye(2)),))
    fold = next(f for f in tracker_folds(readings) if f.kind == "payload")
    quick = c.held_out(fold, c.active)
    left = replace(c.task, campaign=replace(c.task.campaign, readings=readings.take(~fold.held)))
    fit = settled(left, c.fit)

    there, _ = c.task.linearised(fit.state, fit.active)
    slow = np.mean(np.sum(there.residual[fold.held] ** 2, axis=1))
    assert quick is not None and np.sqrt(quick.means[1]) == pytest.approx(np.sqrt(slow), abs=2e-6)
    assert quick.means[0] > 2 * quick.means[1]


@pytest.mark.parametrize("kind", ["payload", "station"])
def test_what_the_believed_arm_is_off_by_in_a_fold_meets_both_errors(kind):
    """One sd of what it does to the means apart: the left-out readings moved along each direction that the rest leaves open. A
    stand that is left out is placed anew by them, which takes its own part of that away."""
    readings = world(4, PLANTED["gear_2x:3"])[0]
    late = np.arange(len(readings)) >= 2 * len(readings) // 3
    if kind == "station":
        readings = replace(readings, station=late.astype(np.int64), stations=("S1", "S2"))
    c = channel(readings).with_active((Active(LIBRARY["gear_2x"], 3, np.zeros(2), {}, np.eye(2)),))
    fold = [f for f in tracker_folds(readings) if f.kind == kind][-1]
    sd, linear, rest = c.task.layout.prior_sd, c.fit.linear, ~np.asarray(fold.held)
    scale = np.where(np.isfinite(sd), sd, c.task.layout.scale)
    A = (c.fit.W[rest] @ linear.J[rest]).reshape(-1, len(sd)) * scale
    open_ = scale[:, None] * np.linalg.pinv(np.vstack([A, np.diag(np.isfinite(sd).astype(float))]), rcond=RANK)

    def difference(u):
        moved = replace(linear, residual=linear.residual + np.where(rest[:, None], 0.0, linear.J @ u))
        before, after, _ = replace(c, fit=replace(c.fit, linear=moved)).held_out(fold, c.active).means
        return before - after

    found = c.held_out(fold, c.active)
    U, s, _ = np.linalg.svd(open_, full_matrices=False)
    slopes = [difference(u) - difference(0.0 * u) for u in (U * s).T[s > 1e-12 * s[0]]]
    assert found.shared == pytest.approx(np.linalg.norm(slopes), rel=1e-3) and found.shared > 0.0
    assert c.held_out(fold, ()).shared < 1e-3 * found.shared  # nothing differs
    # What the effect's coefficients add to the errors of all unknowns, of which they take some back.
    columns = np.concatenate([linear.J, added(c.active, c.seen, c.fit)[0]], axis=2)
    prior, size = np.append(sd, [1.0, 1.0]), np.append(scale, [1.0, 1.0])
    A = (c.fit.W[rest] @ columns[rest]).reshape(-1, len(prior)) * size
    every = columns @ (size[:, None] * np.linalg.pinv(np.vstack([A, np.diag(np.isfinite(prior).astype(float))]), rcond=RANK))
    own = [] if kind == "payload" else [np.flatnonzero(fold.held)]
    placed = [placed_stands(c.task, c.fit, one, own)[~rest] for one in (every, linear.J @ open_)]
    more, less = (float(np.sum(one**2)) / len(one) for one in placed)
    assert found.estimation == pytest.approx(more - less, rel=0.02)


def ripple(r):
    """(n, 6) rad, twice per turn of joint 3."""
    return column(3, 2e-4 * np.cos(2 * r.q[:, 2]))


def turning(r):
    """(n, 3) m: the tracker turns about its head with time; about 4 m away; nominal places are good enough."""
    c = NOMINAL.points(r)
    return np.cross([3e-5, -2e-5, 3e-5], c) * r.time[:, None] / 3600.0


NOMINAL = random_truth(np.random.default_rng(9), 0.0, 2.5e-4)  # the arm of world(9)


@pytest.mark.parametrize("shift, moved", [(ripple, None), (None, turning)])
def test_predictions_of_readings_nobody_has_seen(shift, moved):
    readings, points = world(9, shift, moved)
    d = diagnosed(readings)
    fresh = campaign_readings(np.random.default_rng(99), 200)
    fresh = replace(fresh, time=np.linspace(0, 8000, 200), temperature=np.full(200, 25.0))
    there = points(fresh)
    told = d.channels[0].predict(fresh, d.active)
    before, after = (np.sqrt(np.mean(np.sum((p - there) ** 2, axis=1))) for p in (told.baseline, told.corrected))
    assert after < 0.4 * before
    covered = np.mean(np.abs(told.corrected - there) < 1.645 * told.sigma)
    assert 0.75 < covered <= 1.0


def test_an_effect_that_conditions_say_nothing_of_is_in_the_sigma():
    readings, points = world(4, PLANTED["backlash:5"])
    c = channel(readings).with_active((Active(LIBRARY["backlash"], 5, np.zeros(1), {}, np.eye(1)),))
    fresh = replace(campaign_readings(np.random.default_rng(99), 200), time=None, temperature=None)
    there, untold = points(fresh), replace(fresh, approach=None)
    full, without = (c.predict(r, c.active) for r in (fresh, untold))
    assert not full.lacking and without.lacking == ("backlash",)
    off = without.corrected - there
    assert np.std(full.corrected - there) < 0.5 * np.std(off) and without.sigma.mean() > 2 * full.sigma.mean()
    assert 0.75 < np.mean(np.abs(off) < 1.645 * without.sigma)


def test_payloads_that_hang_in_sealed_conditions_alone_are_those_of_the_cell(tmp_path):
    axes = ",".join(f"q{i}_deg" for i in range(1, 7))
    path = tmp_path / "tracker.csv"
    path.write_text(f"{axes},x_mm,y_mm,z_mm\n0,-90,90,0,20,30,1,2,3\n", encoding="utf-8")
    plain = read_readings(path, PAYLOADS, INSTRUMENT)
    readings, points = world(2)
    light = replace(readings.take(readings.payload == 0), payloads=plain.payloads)
    fresh = campaign_readings(np.random.default_rng(99), 100)
    assert len(np.unique(fresh.payload)) > 1 and plain.payloads == fresh.payloads
    told = channel(light).predict(replace(fresh, time=None, temperature=None), ())
    assert np.median(np.linalg.norm(told.baseline - points(fresh), axis=1)) < 3e-4


def test_sealed_conditions_without_a_nest_have_the_only_one_that_was_measured():
    readings, _ = world(2)
    fresh = replace(campaign_readings(np.random.default_rng(99), 30), targets=("",), target=np.zeros(30, np.int64))
    with pytest.raises(BadInput, match=r"no column target, or an empty one, and .* has T1, T2.*; add it"):
        as_in(fresh, readings)
    second = readings.take(readings.target == 1)
    found = as_in(fresh, second)
    assert found.targets == readings.targets and np.all(found.target == 1)
    told = channel(second).predict(replace(found, time=None, temperature=None), ())
    assert np.isfinite(told.baseline).all() and np.abs(told.baseline).max() < 10.0


@pytest.mark.parametrize("bends", [True, False])
def test_listed_springs_bend_where_the_readings_say_so(bends):
    listed = 1.0 / EXTRA.stiffness
    compliance = listed * [0, 1, 1, bends * 1.1, bends * 0.9, bends * 1.0]
    readings, _ = world(3, compliance=compliance)
    c = channel(readings)
    assert ("c5" in c.task.layout.names) == bends
    # A joint that gives where all others are rigid is an effect.
    if not bends:
        readings, _ = world(3, compliance=listed * [0, 1, 1, 0, 0.9, 0])
        d = diagnosed(readings)
        assert str(d.explanations[0].names[0]) == "joint_compliance:5"


def test_blind_without_the_columns():
    readings = replace(world(1)[0], approach=None, temperature=None)
    c = channel(readings)
    assert "approach" in c.blind(LIBRARY["backlash"]) and not c.variants(LIBRARY["backlash"], 5)[0]
    assert "temperature_C" in c.blind(LIBRARY["link_thermal"])
    assert c.blind(LIBRARY["gear_1x"]) == ""
    assert c.blind(LIBRARY["wheel_wear"])


def test_a_large_campaign_is_searched_in_part_and_fitted_whole(monkeypatch):
    searched = []
    monkeypatch.setattr("ocp.diagnose.rules.MOST_SEARCHED", 300)
    monkeypatch.setattr(diagnosis, "linearised", lambda few, *told: searched.append(len(few[0].gap())) or linearised(few, *told))
    readings, _ = world(4, PLANTED["backlash:5"], n=420)
    d = diagnosed(readings)
    assert 300 <= max(searched) < 320 and len(readings) == 420
    assert str(d.explanations[0].names[0]) == "backlash:5"
    assert len(d.channels[0].gap()) == 420 and d.channels[0].active


def test_good_readings_weigh_one_and_gross_ones_nothing():
    w = reliability(np.array([0.0, 3.0, 9.0, 200.0]))
    assert w[0] > 0.999 and w[2] > 0.99 and w[3] < 1e-6


def test_doubts():
    e = LIBRARY["backlash"]
    sure = Active(e, 5, np.array([4 * 8e-4]), {}, np.array([[1e-12]]))
    assert implausible([sure]) and not implausible([replace(sure, a=np.array([5e-4]))])
    assert implausible([replace(sure, a=np.array([-1e-4]))])
    v = np.random.default_rng(0).normal(size=50)
    assert cancelling([Name("a"), Name("b")], [v, -1.1 * v]) and not cancelling([Name("a"), Name("b")], [v, v])
    assert NESTS


def test_a_posture_is_left_out_with_all_of_its_readings():
    """Read from both sides: what the arm lacks there is alike in both, and none of them may tell of the other."""
    readings, _ = world(4)
    both = readings.take(np.repeat(np.arange(len(readings)), 2))
    both = replace(both, approach=both.approach * np.tile([1, -1], len(readings))[:, None])
    assert len(np.unique(both.repeats())) == 2 * len(readings)
    for fold in tracker_folds(both):
        if fold.kind == "random":
            assert (fold.held[::2] == fold.held[1::2]).all()


def test_a_stand_that_is_left_out_is_placed_by_its_own_readings():
    readings, _ = world(4, PLANTED["gear_2x:3"])
    n = len(readings)
    late = np.arange(n) >= 2 * n // 3
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    point = np.where(late[:, None], readings.point @ turn.T + [0.5, -0.3, 0.1], readings.point)
    moved = replace(readings, point=point, station=late.astype(np.int64), stations=("S1", "S2"))
    e = LIBRARY["gear_2x"]
    c = channel(moved).with_active((Active(e, 3, np.zeros(2), {}, np.eye(2)),))
    stands = {f.name: f for f in tracker_folds(moved) if f.kind == "station"}
    assert set(stands) == {"station=S1", "station=S2"}
    found = c.held_out(stands["station=S2"], c.active)
    assert found is not None and found.rows.shape[1] > 0.9 * late.sum()
    before, after, noise = found.means
    assert after < 1.5 * noise and before > 1.5 * after  # placed, and the name holds there
    random = next(f for f in tracker_folds(moved) if f.kind == "random")
    assert c.held_out(replace(random, held=late), c.active) is None  # other folds know nothing of that stand
    few = replace(moved, station=(np.arange(n) >= n // 5).astype(np.int64))
    assert [f.name for f in tracker_folds(few) if f.kind == "station"] == ["station=S1"]  # what remains is too little
    # Where the left-out stand is set up does not matter, and its own readings' placing takes no share of their errors.
    rows, rng = np.flatnonzero(late)[:12], np.random.default_rng(8)
    J, W = c.fit.linear.J[rows][:, :, c.task.layout.station[1]], c.fit.W[rows]
    white = rng.normal(size=(400, 12, 3))
    errors = np.zeros((400, n, 3))
    errors[:, rows] = np.linalg.solve(W, white[..., None])[..., 0]
    alone = np.array([placed_stands(c.task, c.fit, one, [rows])[rows] for one in errors])
    elsewhere = errors[0].copy()
    elsewhere[rows] += J @ [1e-3, -2e-3, 5e-4, 1e-4, 2e-4, -3e-4]
    assert np.allclose(placed_stands(c.task, c.fit, elsewhere, [rows])[rows], alone[0], atol=1e-9)
    assert np.mean((W @ alone[..., None]) ** 2) == pytest.approx(1.0, abs=0.04)
