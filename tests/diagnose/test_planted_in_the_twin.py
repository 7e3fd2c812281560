"""Effects planted in the virtual arm, whose laws are not the library's, are found again, and not without their file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ocp.blindtest.worlds.sealing import write_cell
from ocp.data import CELL
from ocp.diagnose.answering import tracker_channel
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.diagnosis import Diagnosis, diagnose_channels
from ocp.effects.catalogue import library
from ocp.model.cell import read_cell
from ocp.simulate.twin.arm import make_arm
from ocp.simulate.twin.planting import parse_effect
from ocp.simulate.twin.tracker import TrackerLog, random_design, tracker_world
from ocp.simulate.twin.truth import Truth, draw_truth

RIVALS = ("backlash", "friction_windup", "joint_compliance", "encoder_scale", "gear_1x", "payload_mass", "link_thermal")
OTHERS = ("tracker_scale", "tracker_drift", "wrist_coupling", "joint_stiffening")
NEW = ("load_backlash", "joint_coupling", "tool_flex", "air_scale", "azimuth_harmonic")
SQUARE, ASIDE = "com_mm = [0, 20, 200]", "com_mm = [0, 150, 200]"  # of a payload: one that hangs aside loads joint 6
ALL = (*RIVALS, *OTHERS, *NEW)
# Of each its key and the size that is planted.
PLANTED = {
    "load_backlash:3=1e-4,torque_Nm=60": ("half_width_rad", 1e-4),
    "joint_coupling:3=2e-4,source_joint=2": ("ratio_rad", 2e-4),
    "tool_flex=3e-7": ("m_per_N", 3e-7),
    "air_scale=-2e-6": ("per_K", -2e-6),
    "azimuth_harmonic=3e-5,order=3,phase_rad=1": ("rad", 3e-5),
    "joint_compliance:6=5e-6": ("rad_per_Nm", 5e-6),
}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory):
    path = tmp_path_factory.mktemp("cell") / "cell.toml"
    write_cell(Path(CELL), path)
    held = path.read_text(encoding="utf-8")
    path.write_text(held.replace(SQUARE, ASIDE), encoding="utf-8")
    assert SQUARE in held
    return read_cell(path)


@pytest.fixture(scope="module")
def design(cell):
    return random_design(cell, np.random.default_rng(3), 110)


def drawn(cell, *texts: str) -> Truth:
    """A machine with springs, geometry and weights of its own, and these effects."""
    truth = draw_truth(cell, 4, [parse_effect(text) for text in texts], weight_bends="believed")
    return replace(truth, ripple=truth.ripple * [0.0, 1.0, 1.0], play=np.zeros(6), outliers=0.0)


def measured(cell, design, folder: Path, text: str) -> TrackerChannel:
    """The campaign of that machine, the believed arm fitted."""
    tracker_world(folder, cell, drawn(cell, text), TrackerLog(design, None))
    return tracker_channel(read_data_set(folder))


def found(channel: TrackerChannel, names: tuple[str, ...]) -> Diagnosis:
    """What is said of it with these effects in the library."""
    known = {name: library()[name] for name in names}
    return diagnose_channels([channel], known, Options(folds=False, where=False))


@pytest.mark.parametrize("text", PLANTED)
def test_is_found_with_its_size_and_missed_without_its_file(cell, design, tmp_path, text):
    planted = parse_effect(text)
    own = Name(planted.effect, planted.joint or 0)
    key, size = PLANTED[text]
    channel = measured(cell, design, tmp_path, text)
    there = found(channel, ALL)
    assert there.verdict == "explained"
    (named,) = there.explanations[0].names
    same = next((c for c in there.classes if named in c), (named,))
    assert own in same
    if named == own:
        assert there.active[0].parameters[key] == pytest.approx(size, rel=0.15)
    left = found(channel, tuple(n for n in ALL if n not in {o.effect for o in same}))
    assert left.verdict != "explained"


@pytest.mark.parametrize("text", ["backlash:3=1e-4", "load_backlash:3=1e-4,torque_Nm=5"])
def test_plays_that_the_data_cannot_tell_are_one_class(cell, design, tmp_path, text):
    """Every reading is approached in the direction of the load: both plays lie on the same side then."""
    m = design.moments
    load = make_arm(cell, drawn(cell)).settled(m).load_torque[:, 2]
    m = replace(m, approach=np.column_stack([m.approach[:, :2], np.sign(load), m.approach[:, 3:]]))
    there = found(measured(cell, replace(design, moments=m), tmp_path, text), ALL)
    assert {Name("backlash", 3), Name("load_backlash", 3)} <= set().union(*there.classes)
    assert there.explanations[0].names[0].effect in ("backlash", "load_backlash", "friction_windup")
