"""Preston's coefficient from measured depths: the fit, the doubt that grows without it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ocp.update.removal import (
    DEPTH_MODEL,
    HOURLY,
    UNIT,
    MeasuredDepths,
    Preston,
    ground_by_then,
    joined_preston,
    less_sure,
    preston_from,
    read_removal,
    with_shared_errors,
)
from robots.errors import BadInput, Infeasible


def measured(depth: np.ndarray, sd: float = 1e-6) -> MeasuredDepths:
    n = len(depth)
    return MeasuredDepths(Path("removal.csv"), np.zeros((n, 3)), depth, np.full(n, sd), tuple(range(2, n + 2)))


def test_the_coefficient_comes_back_with_its_doubt():
    rng, off = np.random.default_rng(3), []
    h = rng.uniform(1e6, 3e6, 30)
    for _ in range(60):
        depth = 1e-11 * h * (1 + DEPTH_MODEL * rng.normal(size=30)) + 1e-6 * rng.normal(size=30)
        found = preston_from(measured(depth), h)
        off.append((found.value - 1e-11) / found.sd)
    assert np.std(off) == pytest.approx(1.0, abs=0.35) and abs(np.mean(off)) < 0.5
    assert found.points == 30 and found.sd < 0.02 * found.value


def test_points_beside_the_lines_are_left_out():
    h = np.array([2e6, 2e6, 2e6, 1e5, 0.0])
    found = preston_from(measured(1e-11 * h + np.array([0, 0, 0, 5e-6, 5e-6])), h)
    assert found.value == pytest.approx(1e-11) and (found.points, found.left_out) == (3, 2)
    with pytest.raises(Infeasible, match="2 points lie where the force log ground, at least 3 are needed"):
        preston_from(measured(1e-11 * h[1:]), h[1:])


@pytest.mark.parametrize(("depth", "h", "said"), [(2e-5, 0.0, "no point lies where"), (1e-7, 1e6, "do not differ from zero")])
def test_what_tells_no_coefficient_is_said(depth, h, said):
    with pytest.raises(Infeasible, match=said):
        preston_from(measured(np.full(3, depth)), np.full(3, h))


def test_without_a_measurement_doubt_grows_with_contact():
    known = Preston(1e-11, 2e-13)
    assert less_sure(known, 0.0, False).sd == pytest.approx(known.sd)
    hour, four = (less_sure(known, s, False).sd / known.value for s in (3600.0, 4 * 3600.0))
    assert hour == pytest.approx(np.hypot(0.02, HOURLY)) and four == pytest.approx(np.hypot(0.02, 2 * HOURLY))
    assert less_sure(known, 0.0, True).sd > 0.4 * known.value


def test_measurements_are_weighed_and_contradictions_said():
    known = Preston(1.0e-11, 0.1e-11)
    both = joined_preston(known, Preston(1.1e-11, 0.1e-11, 12))
    assert both.value == pytest.approx(1.05e-11) and both.sd == pytest.approx(0.1e-11 / np.sqrt(2)) and both.points == 12
    assert joined_preston(None, known) == known
    with pytest.raises(Infeasible, match=r"16 by the measured removal, which cannot come from the last, 10 .*--changed belt"):
        joined_preston(known, Preston(16 * UNIT, 0.05e-11))


def test_what_many_depths_share_does_not_average_out():
    """A footprint that is off is so all along a line, a force everywhere."""
    found = with_shared_errors(measured(np.zeros(3)), Preston(1e-11, 1e-14, 500), 2, 0.01)
    assert found.sd / found.value == pytest.approx(np.linalg.norm([1e-3, DEPTH_MODEL / np.sqrt(2), 0.01]))
    for other in (1e-3, 1e3):  # depths in millimetres, in nanometres
        with pytest.raises(Infeasible, match="give removal_um and sd_um in micrometres"):
            with_shared_errors(measured(np.zeros(3)), Preston(1e-11 * other, 1e-14 * other, 500), 2, 0.01)


class Log(SimpleNamespace):
    def __len__(self) -> int:
        return len(self.contact)


def test_what_is_ground_after_the_measurement_is_not_in_it():
    log: Any = Log(path=Path("force.csv"), clock=np.array([0.0, 10.0, 20.0, 250.0]), contact=np.ones(4, bool))
    then = replace(measured(np.full(3, 2e-5)), clock=20.0)
    assert ground_by_then(then, log).tolist() == [True, True, True, False]
    assert ground_by_then(replace(then, clock=None), log).all()
    log.clock = log.clock + 100.0
    with pytest.raises(BadInput, match=r"column clock_s: measured at 20 s, before force.csv grinds"):
        ground_by_then(then, log)
    log.clock = None
    with pytest.raises(BadInput, match="no column clock_s"):
        ground_by_then(then, log)


HEAD = "px_mm,py_mm,pz_mm,removal_um,sd_um\n"


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "no "),
        ("1,2,3,20,0\n", "line 2, column sd_um: 0 must be above 0"),
        ("1,2,3,20,1\n1,2,3,-20,1\n", "line 3, column removal_um: .*negative by more than its error"),
        ("1,2,3,deep,1\n", "line 2, column removal_um: 'deep'"),
        ("1,2,3,nan,1\n", "line 2, column removal_um"),
        ("1,2,3,9,1\n1,2,4,9,1\n1,2,4,9,1\n", "line 3, column removal_um: .*one of 2 copies of a row"),
    ],
)
def test_faulty_depths_are_refused_in_one_sentence(tmp_path, rows, said):
    (tmp_path / "removal.csv").write_text(HEAD + rows)
    with pytest.raises(BadInput, match=said):
        read_removal(tmp_path / "removal.csv")


def test_depths_have_one_clock(tmp_path):
    path, head = tmp_path / "removal.csv", HEAD.replace("sd_um", "sd_um,clock_s")
    path.write_text(head + "1,2,3,9,1,620\n1,2,4,9,1,620\n")
    assert read_removal(path).clock == 620.0
    path.write_text(head + "1,2,3,9,1,620\n1,2,4,9,1,630\n")
    with pytest.raises(BadInput, match="line 3, column clock_s: 630 must be zero or above and the same in all rows"):
        read_removal(path)
