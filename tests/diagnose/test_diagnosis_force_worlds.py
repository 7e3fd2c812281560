"""The open force worlds made by others, whose labels are known: what was right once stays right."""

import pytest

from ocp.diagnose.answering import channels_of
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import library
from ocp.shell.progress import Phases


@pytest.mark.parametrize(("name", "wanted"), [("force_two_effects", {"sensor_bias", "tangential_force"})])
def test_what_is_planted_is_named(shared_data, solved_once, name, wanted):
    found = diagnose_channels(channels_of(read_data_set(shared_data / "worlds" / name), Phases()), library())
    assert found.verdict == "explained"
    assert {n.effect for n in found.explanations[0].names} == wanted
