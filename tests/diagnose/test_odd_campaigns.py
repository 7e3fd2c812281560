"""Data sets that nobody would recommend end in a diagnosis or in one sentence (all of them: benchmarks/diagnosis_odd.py)."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

from ocp.diagnose.interface import diagnose
from ocp.diagnose.joints.channel import joint_channel
from ocp.diagnose.joints.log import read_joint_log
from ocp.effects.catalogue import library
from ocp.effects.effect import Active
from robots.errors import BadInput
from tests.support.odd_campaigns import LOGS, ODD, write_odd_campaign, write_odd_log
from tests.support.simulated_campaign import EXTRA, PAYLOADS

BY_NAME = {odd.name: odd for odd in ODD}
VERDICTS = ("explained", "partly", "ambiguous", "unexplained", "no_gap")


def test_a_name_that_its_own_refit_hides_is_weighed(tmp_path):
    """A name that the second selection accepts cannot be seen any more in the noise of the fit that holds it."""
    write_odd_campaign(tmp_path, BY_NAME["thirty, 3 mm"], seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        diagnose(tmp_path, out=tmp_path / "out")
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["verdict"] in VERDICTS


def test_one_posture_is_refused_in_one_sentence(tmp_path):
    write_odd_campaign(tmp_path, BY_NAME["one posture repeated"])
    with pytest.raises(BadInput, match=r"tracker\.csv: 1 different postures"):
        diagnose(tmp_path, out=tmp_path / "out")


def test_readings_met_exactly_are_no_gap(tmp_path):
    write_odd_log(tmp_path, **LOGS["motor and link alike, rigid"])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        diagnose(tmp_path, out=tmp_path / "out")
    document = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert document["verdict"] == "no_gap" and all(np.isfinite(b["share"]) for b in document["location"]["budget"])


def test_a_zero_set_anew_is_no_gap_and_leaves_the_delay_where_it_is(tmp_path):
    write_odd_log(tmp_path, **LOGS["zeroed anew"])  # 2 to 6 mrad between the recordings
    log = read_joint_log(tmp_path / "joints.csv")
    delay = library()["channel_delay"]
    channel = joint_channel(log, EXTRA, PAYLOADS["grinder"], True)
    found = channel.with_active((Active(delay, 0, np.zeros(1), {}, np.zeros((1, 1))),))
    assert abs(found.active[0].a[0] - 3e-3) < 2e-5
    for fold in channel.folds():
        if fold.kind == "run":  # the zero of a recording that was left out is not known, and not missed
            judged = channel.held_out(fold, found.active)
            before, after, noise = judged.means
            assert after < 3.0 * noise < 1e-3 * before
    asked = log.take(log.run == 1)  # a recording by its name, not by its place
    asked = replace(asked, run=np.zeros_like(asked.run), runs=(log.runs[1],))
    predicted = channel.predict(asked, found.active).corrected
    off = predicted - asked.link[:: len(asked) // len(predicted), :3][: len(predicted)]
    assert np.abs(off[1:]).max() < 1e-4  # at first the motor's angle a moment ago is not known
