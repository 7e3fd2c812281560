"""The path of an old program: which feed its passes are given, and what is said where that is not the program's own."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.plan import paths
from robots.errors import BadInput
from tests.support.invented_motion import cell
from trajectories.program.old_program import OldPass


@pytest.mark.parametrize(
    ("told", "times", "feed"),
    [
        (np.full(20, 0.05), None, 0.05),
        (np.r_[0.001, 0.01, 0.03, np.full(15, 0.06), 0.02, 0.004], None, 0.06),  # a chain whose ends are driven slowly
        (np.full(20, np.nan), None, 0.04),  # neither: the cell's own
        (np.full(20, np.nan), np.linspace(0.0, 1.0, 20), 0.05),  # a block with times
    ],
)
def test_a_pass_has_the_feed_of_most_of_its_points(told, times, feed, monkeypatch):
    """Not that of its first motion, which may be a way through the air or the slow begin of a ramp."""
    n = len(told)
    old = OldPass(np.tile(np.eye(4), (n, 1, 1)), np.tile(np.eye(4), (n, 1, 1)), None, told, "old.src", np.arange(n), times)
    along = iter(np.linspace(0.0, 0.05, n))
    found = {}
    monkeypatch.setattr(paths, "dialect_named", lambda name: SimpleNamespace(read=lambda source: None))
    monkeypatch.setattr(paths, "contact_frames_from_program", lambda *_: ((old,), ()))
    monkeypatch.setattr(paths, "_contact", lambda *_: (np.array([next(along), 0.0, 0.0]), np.array([0.0, 0.0, 1.0])))
    monkeypatch.setattr(paths, "paths_from_points", lambda *given: found.update(feed=given[6]) or ([], []))
    notices = paths.paths_from_program(cell(), None, None, None, Path("old.src"), 1e-3)[1]
    assert any("neither times nor $VEL.CP are known" in text for text in notices) == bool(feed == 0.04)
    assert any("the feed changes inside" in text for text in notices) == bool(np.ptp(told) > 0)
    assert cell().process.feed == 0.04 and len(found["feed"]) > 40 and np.allclose(found["feed"], feed, rtol=1e-12)


def test_a_path_of_two_points_is_told_from_one_that_does_not_touch(monkeypatch):
    """A way of two points touches the wheel, but does not say how it lies on the blade between them."""
    told = np.full(2, 0.05)
    old = OldPass(np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(4), (2, 1, 1)), None, told, "old.src", np.arange(2))
    along = iter((0.0, 0.05) * 2)
    monkeypatch.setattr(paths, "dialect_named", lambda name: SimpleNamespace(read=lambda source: None))
    monkeypatch.setattr(paths, "contact_frames_from_program", lambda *_: ((old,), ()))
    monkeypatch.setattr(paths, "_contact", lambda *_: (np.array([next(along), 0.0, 0.0]), np.array([0.0, 0.0, 1.0])))
    with pytest.raises(BadInput, match="touch the wheel at 2 points at most, 3 are needed"):
        paths.paths_from_program(cell(), None, None, None, Path("old.src"), 1e-3)
