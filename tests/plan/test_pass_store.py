"""Solved passes come back from disk as they were, under a key that every input changes."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.contact.wheel.cover import Cover, WheelGeometry
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.theta import believed_theta
from ocp.plan.passes.optimise import Ground, GroundLines, SolvedPass, remembered_passes
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import Evaluation, PassSolution
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.passes.stretches import LeftOut
from ocp.shell.cache import flattened, rebuilt
from tests.support.example_pass import bar_pass, bundled_cell

N = 40
RANDOM = np.random.default_rng(5)


def solved_pass() -> SolvedPass:
    seed = Seed(-1, 3, RANDOM.normal(size=7), -0.2, RANDOM.normal(size=(7, 6)), np.linspace(0, 1, 7), 2.5)
    problem = replace(PassProblem.start(bar_pass(), seed, RANDOM.normal(size=(N, 3))), turn_limit=0.1)
    shapes = {"parts": (N, 4), "tilt": (N, 2), "curvature": (N, 3), "T_base_blade": (N, 4, 4)}
    names = Evaluation.__dataclass_fields__
    evaluation = Evaluation(**{name: RANDOM.normal(size=shapes.get(name, (N,))) for name in names})
    solution = PassSolution(RANDOM.normal(size=(N, 6)), np.ones(N), np.ones(N), np.full(N, 20.0), 12, 3.5)
    return SolvedPass(problem, solution, evaluation)


def ground() -> Ground:
    cell = bundled_cell()
    x, y = np.arange(8.0), np.arange(4.0)
    cover = Cover(WheelGeometry(0.04, 0.015, 0.012, 2e6, 0.47), x, y, 1.0, np.ones(4), np.ones((5, 4, 4)))
    cloud = SurfaceCloud(np.ones((5, 3)), np.ones((5, 3)))
    return Ground(cell, believed_theta(cell), ObjectiveWeights(), None, cover, np.ones((4, 3)), cloud, np.zeros((0, 3)))  # type: ignore[arg-type]


def refuse() -> GroundLines:
    raise AssertionError("solved again")


def test_a_pass_survives_the_disk_bit_by_bit():
    passes = [solved_pass(), solved_pass()]
    give = [p.problem.compliance for p in passes]
    paths = [p.problem.path for p in passes]
    lost = [LeftOut(3, "concave", 0.0, 0.012, "too hollow", "use a wheel at most 12 mm wide")]
    remembered_passes(ground(), paths, give, lambda: GroundLines(passes, lost), False)
    found = remembered_passes(ground(), paths, give, refuse, False)
    assert found.left_out == lost
    again = found.passes
    before, after = flattened(passes), flattened(again)
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert type(again[0].problem.seed.direction) is int and type(again[0].problem.path.side) is str


@pytest.mark.parametrize("change", ["feed", "wheel", "theta", "compliance", "weights", "vertices", "whole"])
def test_any_input_changes_the_key(change):
    one, base = solved_pass(), ground()
    path, give = one.problem.path, one.problem.compliance
    remembered_passes(base, [path], [give], lambda: GroundLines([one], []))
    if change == "feed":
        path = replace(path, feed=path.feed * (1 + 1e-12))
    elif change == "wheel":
        base = replace(base, cell=replace(base.cell, wheel=replace(base.cell.wheel, friction=0.36)))
    elif change == "theta":
        base = replace(base, theta=replace(base.theta, covariance=base.theta.covariance * 1.1))
    elif change == "compliance":
        give = give * 1.001
    elif change == "weights":
        base = replace(base, weights=ObjectiveWeights(force_sd=0.5))
    elif change == "vertices":
        base = replace(base, vertices=base.vertices + 1e-9)
    with pytest.raises(AssertionError, match="solved again"):
        remembered_passes(base, [path], [give], refuse, change != "whole")


def test_what_cannot_be_kept_is_not_left_out_silently():
    with pytest.raises(TypeError, match="inside"):
        flattened({"inside": object()})


def test_a_missing_array_is_an_error_not_a_default():
    entry = flattened(ObjectiveWeights())
    with pytest.raises(KeyError):
        rebuilt(SurfaceCloud, entry)
