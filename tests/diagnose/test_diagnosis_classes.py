"""Names that data cannot tell apart, on columns of numbers: nested forms, and a background that looks like one of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import Search, Weighed, weigh
from ocp.diagnose.engine.evidence import size_grid
from ocp.diagnose.engine.findings import Name
from ocp.diagnose.engine.linearisation import widths_of
from ocp.diagnose.engine.pool import Family, Member, given, make_pool, most_telling, scan, scan_one
from ocp.diagnose.verdict.probabilities import merged, twins
from ocp.effects.catalogue import library
from robots.gauss_newton import linear_step

N, LONG = 400, 30.0  # rows; length of a column at its prior's upper end, in noises
SIZES = np.array([0.1, 0.3, 1.0])
RNG = np.random.default_rng(4)
SIGN = RNG.choice([-1.0, 1.0], N)
LOAD = SIGN * RNG.uniform(0.2, 1.0, N)
PLAY = np.column_stack([SIGN, *RNG.choice([-1.0, 1.0], (5, N))])
BACKLASH = Name("backlash", 2)


def family(name: str, columns, background: bool = False) -> Family:
    """Columns (N, m) of one variant."""
    m = columns.shape[1]
    scaled = LONG * columns[:, None] / np.sqrt(N)
    effect = None if background else library()["backlash"]
    return Family(Name(name, 2), effect, ({},), scaled, np.ones(m), SIZES, np.zeros(m, bool), -3.0, background=background)


def classes_of(slope: float, play: float = 0.0) -> list[Name]:
    """Twins of a windup of base 0.8 and this slope with the load (shares of the upper end), alone or beside the play of all
    joints, a twelfth of an effect's size."""
    y = LONG / np.sqrt(N) * (0.8 * SIGN + slope * LOAD + play * PLAY[:, 1:].sum(axis=1))
    y = y + np.random.default_rng(0).normal(size=N)
    windup = np.column_stack([SIGN, LOAD])
    others = [family("backlash", SIGN[:, None]), family("~play", PLAY, True), family("other", PLAY[:, 2:3])]
    pool = make_pool(y, N, [family("windup", windup), *others])
    members = [Member(0, 0, 1.0), *([Member(2, 0, 0.08)] if play else [])]
    C = np.hstack([pool.columns(m) for m in members])
    sizes = np.repeat([m.size for m in members], [2, 6][: len(members)])
    a = sizes * linear_step(y, C * sizes, 0.0 * sizes, np.ones(len(sizes))).change
    return twins(SimpleNamespace(pool=pool), Weighed(0.0, tuple(members)), members[0], C[:, :2] @ a[:2])


def test_a_form_and_what_it_holds_are_one_class_until_the_difference_shows():
    assert classes_of(0.0) == [BACKLASH]
    assert classes_of(1.0) == []  # what backlash leaves of the load's share is 30 * 1.0 * 0.23 noises: lambda 48


def test_a_small_background_does_not_take_the_place_of_an_effect():
    assert classes_of(0.35, play=0.08) == [BACKLASH]


def test_likelier_variants_weigh_more_and_picked_ones_as_before():
    y = SIGN * LONG / np.sqrt(N) + np.random.default_rng(1).normal(size=N)
    away, share = RNG.normal(size=(N, 40)), RNG.dirichlet(np.full(41, 0.3))
    columns = LONG / np.sqrt(N) * np.concatenate([SIGN[:, None], away], axis=1)[:, :, None]
    even = replace(family("windup", SIGN[:, None]), columns=columns, scans=tuple({"at_s": k} for k in range(41)))
    own = replace(even, within=np.log(41 * share))
    pools = [make_pool(y, N, [one]) for one in (even, own)]
    there = [given(pool, ()) for pool in pools]
    each = [scan_one(pool, base, 0)[0] for pool, base in zip(pools, there, strict=True)]
    assert each[1] == pytest.approx(each[0] + np.log(41 * share)[:, None])
    whole = [scan(pool, base) for pool, base in zip(pools, there, strict=True)]
    assert whole[1].log[0] == pytest.approx(np.logaddexp.reduce((each[0] + np.log(share)[:, None]).ravel()) - np.log(3))
    assert whole[1].log[0] - whole[0].log[0] == pytest.approx(np.log(41 * share[0]), abs=0.05)  # the first alone fits
    picked = make_pool(y, N, most_telling(pools[1], ()))
    assert len(picked.families[0].scans) < 41
    weight = [scan(p, given(p, ())).log[0] + p.families[0].log_odds for p in (pools[1], picked)]
    assert weight[1] == pytest.approx(weight[0], abs=1e-3)


@pytest.mark.parametrize("seed", [1, 31, 37, 53, 60])
def test_a_set_weighs_the_same_wherever_it_is_begun(seed):
    """Steps of one and of three coefficients beside a slow growth, begun anew or from members at a wrong instant and size."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 1.0, N)
    step = (t[:, None] > np.linspace(0.1, 0.9, 8)) * 1.0
    uneven, more = 1.0 + 0.3 * rng.normal(size=N), rng.normal(size=(N, 2))
    three = np.stack([np.column_stack([one, one[:, None] * more]) for one in step.T], axis=1)
    slow = np.cos(np.pi * np.outer(t, [1.0, 2.0]))[:, None]
    y = (40.0 * step[:, 3] * uneven + 20.0 * slow[:, 0, 0]) / np.sqrt(N) + rng.normal(size=N)
    columns = 300.0 * (step * uneven[:, None])[:, :, None], 300.0 * three, 100.0 * slow
    scans = [tuple({"at_s": k} for k in range(c.shape[1])) for c in columns]
    made = [replace(family("any", c[:, 0]), columns=c / np.sqrt(N), sizes=size_grid(0.02)) for c in columns]
    pool = make_pool(y, N, [replace(f, scans=s) for f, s in zip(made, scans, strict=True)])
    anew, begun = weigh(pool, [0, 1, 2]), weigh(pool, [0, 1, 2], [Member(0, 5, 0.02), Member(1, 5, 0.02), Member(2, 0, 0.02)])
    assert begun.log == pytest.approx(anew.log, abs=0.01)
    one, *rest = anew.members  # and none of them has a better variant or size beside the others
    each = scan_one(pool, given(pool, rest), 0)[0]
    assert each[one.variant, np.searchsorted(pool.families[0].sizes, one.size)] == each.max()


@pytest.mark.parametrize("others", [0, 60])
def test_two_that_nearly_cancel_are_found_whichever_comes_first(others):
    """Neither shows alone, and with 60 others there are more pairs than are weighed exactly."""
    found = 0
    for seed in (*range(6), 46, 58):
        rng = np.random.default_rng(seed)
        a = rng.normal(size=N)
        b = a + 0.15 * rng.normal(size=N)
        y = 2.5 * (a - b) + rng.normal(size=N)
        columns = [a, b, *rng.normal(size=(others, N))]
        made = [replace(family(f"e{k}", x[:, None]), columns=x[:, None, None]) for k, x in enumerate(columns)]
        pool = make_pool(y, N, [replace(one, sizes=size_grid(0.02)) for one in made])
        anew = weigh(pool, [0, 1])
        for near in (Member(0, 0, 0.02), Member(1, 0, 0.02)):
            assert weigh(pool, [0, 1], [near]).log == pytest.approx(anew.log, abs=0.01)
        search = Search(pool, 3, 6)
        search.begin()
        found += frozenset([0, 1]) in search.sets
    assert found >= 6


def test_what_is_smaller_than_usual_is_weighed_where_readings_show_it():
    runout, play = library()["wheel_runout"], library()["backlash"]
    least = runout.lower_end([{}])
    for energy, begin in ((10.0, least), (4.0 / (0.5 * least) ** 2, 0.5 * least), (1e9, rules.SMALLER * least)):
        assert widths_of(runout, 0, [{}], energy) == pytest.approx(size_grid(begin))
    assert widths_of(play, 2, [{}], 1e9) == pytest.approx(size_grid(play.lower_end([{}])))  # every gear has a little


def test_a_twin_may_lean_on_what_else_is_in_the_set():
    """A drift beside the effect is free: what looks like the effect less the drift is another word for it (lambda 33 alone)."""
    drift = np.linspace(-1.7, 1.7, N)[:, None]
    leaning = SIGN[:, None] - 0.6 * drift
    pool = make_pool(np.zeros(N), N, [family("windup", SIGN[:, None]), family("backlash", leaning), family("drift", drift)])
    one, beside = Member(0, 0, 1.0), Member(2, 0, 1.0)
    for members, told in (((one,), []), ((one, beside), [BACKLASH])):
        assert twins(SimpleNamespace(pool=pool), Weighed(0.0, members), one, pool.columns(one)[:, 0] * 0.4) == told


def test_variants_are_chosen_for_the_place_of_what_is_held():
    """Two families step at the same instants; a drift and a step of the first are held. Over nothing steps stand for the drift,
    beside both what is left is a small later step, in the step's place the other family needs just its instant."""
    steps = 1.0 * (np.arange(N)[:, None] >= np.linspace(10, N - 10, 60))
    columns = LONG * steps[:, :, None] / np.sqrt(N)
    scans = tuple({"at_s": float(k)} for k in range(60))
    one, other = (replace(family(name, SIGN[:, None]), scans=scans, columns=columns) for name in ("backlash", "other"))
    drift = np.linspace(-1.7, 1.7, N)[:, None]
    y = np.random.default_rng(1).normal(size=N) + 3.0 * LONG * drift[:, 0] / np.sqrt(N) + columns[:, [4, 40], 0] @ [1.0, 0.3]
    families = most_telling(make_pool(y, N, [one, other, family("drift", drift)]), (Member(0, 4, 1.0), Member(2, 0, 1.0)))
    assert 4.0 in [s["at_s"] for s in families[1].scans] and len(families[1].scans) < len(scans)


def test_classes_that_share_a_name_are_one():
    a, b, c, d = (Name(n) for n in "abcd")
    assert merged([(a, b), (c, d), (b, c)]) == ((a, b, c, d),)
    assert merged([(a,), (c, d)]) == ((c, d),)


def test_a_flange_stiffer_than_rigid_is_no_twin_of_wear():
    """Both go with the same column of numbers; of a stiffness's share of the give nothing above one is left."""
    stiffness, wear = library()["flange_stiffness"], library()["wheel_wear"]
    upper = stiffness.prior_sd[0]
    for share, told in ((0.7, [Name("flange_stiffness")]), (1.3, [])):
        column = LONG * SIGN[:, None, None] / np.sqrt(N)
        pool = make_pool(
            column[:, 0, 0] * share / upper,
            N,
            [
                Family(Name(e.name), e, ({},), column, np.array([scale]), SIZES, np.zeros(1, bool), -3.0)
                for e, scale in ((wear, 1e-6), (stiffness, upper))
            ],
        )
        member = Member(0, 0, 1.0)
        d = pool.columns(member)[:, 0] * share / upper
        assert twins(SimpleNamespace(pool=pool), Weighed(0.0, (member,)), member, d) == told
