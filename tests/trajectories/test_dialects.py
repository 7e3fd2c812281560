"""A dialect is its own files and two edits: what is asked of KRL is asked of a made-up language by the same calls."""

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from ocp.model.cell_schema import ControllerTable
from robots.errors import BadInput
from tests.support.krl_example import ROBOT, T_FLANGE_BLADE, elementary_forward, legs, setup
from tests.support.toy_dialect import TOY
from trajectories.dialects import DIALECTS, dialect_named
from trajectories.krl.dialect import KRL
from trajectories.program.build import build_program
from trajectories.program.driven import reinterpolate
from trajectories.program.old_program import contact_frames_from_program
from trajectories.program.program import PointMotion, Program, SubProgram, Wait

ROOT = Path(__file__).resolve().parents[2]
BOTH = pytest.mark.parametrize("dialect", [KRL, TOY], ids=lambda d: d.name)


def built(dialect, kind="axis", passes=2):
    labels = [f"line {i + 1}" for i in range(passes)]
    return build_program(dialect, "blade 1.stl", setup(kind), [legs()] * passes, labels, elementary_forward)


@BOTH
def test_a_program_is_written_checked_and_drives_the_plan(dialect, tmp_path):
    files = dialect.write(built(dialect), tmp_path)
    assert sorted(files) == sorted(tmp_path.iterdir())
    execution = dialect.check(files[0], ROBOT)
    assert execution.source == files[0] and [s.kind for s in execution.segments] == (["point"] + ["axis spline"] * 4) * 2
    np.testing.assert_allclose(execution.segments[0].frames.tool, T_FLANGE_BLADE, atol=1e-6)
    motion = reinterpolate(execution, ROBOT)
    assert len(motion.pieces) == 4 + 1 + 4
    for start, leg in zip(motion.starts, legs(), strict=False):
        t = np.arange(0, leg.trajectory.duration, 1e-3)
        assert np.abs(motion.q(start + t) - leg.trajectory.q(t)).max() < 2.5e-5


@BOTH
def test_it_can_be_the_old_program_of_a_new_plan(dialect, tmp_path):
    execution = dialect.read(dialect.write(built(dialect), tmp_path)[0])
    passes, _ = contact_frames_from_program(execution, elementary_forward, T_FLANGE_BLADE, setup().T_base_wheel)
    assert len(passes) == 8 and np.abs(passes[2].q[0] - legs()[2].trajectory.q(0.0)).max() < 1e-6


@BOTH
def test_it_stands_still_only_where_it_may(dialect, tmp_path):
    q = np.radians([[0.0, -80, 90, 0, 10, 0], [5.0, -80, 90, 0, 10, 0]])
    main, names = dialect.program_names("stops", 1)
    blocks = (PointMotion(q[0]), PointMotion(q[1]), Wait(0.5), PointMotion(q[0]), Wait())
    files = dialect.write(Program(main, setup(), (SubProgram(names[0][0], blocks),)), tmp_path)
    assert dialect.check(files[0], ROBOT, pauses=True).stops == (1, 2)
    with pytest.raises(BadInput, match="may not"):
        dialect.check(files[0], ROBOT)


@BOTH
def test_an_axis_outside_its_range_and_a_file_cut_off_are_refused(dialect, tmp_path):
    main, names = dialect.program_names("far", 1)
    program = Program(main, setup(), (SubProgram(names[0][0], (PointMotion(ROBOT.q_max + 0.1),)),))
    files = dialect.write(program, tmp_path)
    with pytest.raises(BadInput, match=r"line \d+: .*outside"):
        dialect.check(files[0], ROBOT)
    files[-1].write_bytes(files[-1].read_bytes()[:-5])
    with pytest.raises(BadInput, match="cut off"):
        dialect.check(files[0], ROBOT)


@BOTH
def test_names_that_are_taken_are_not_taken_again(dialect, tmp_path):
    files = {file.name for file in dialect.write(built(dialect), tmp_path)}
    main, _ = dialect.program_names("blade 1.stl", 2, taken=files)
    assert main != built(dialect).name


def test_what_a_dialect_cannot_say_it_refuses(tmp_path):
    with pytest.raises(BadInput, match="knows no poses"):
        TOY.write(built(TOY, "cartesian"), tmp_path)


def test_the_choices_of_the_cell_file_are_the_dialects():
    """The two places that a new dialect is entered in."""
    assert set(get_args(ControllerTable.model_fields["dialect"].annotation)) == set(DIALECTS)
    assert all(dialect_named(name).name == name for name in DIALECTS)
    with pytest.raises(BadInput, match="is not one of krl"):
        dialect_named("toy")


def test_what_a_program_is_says_no_word_of_one_controller():
    for file in sorted((ROOT / "trajectories" / "program").glob("*.py")):
        text = file.read_text()
        assert not re.search(r"KUKA|KRL|\bPTP\b|\bS?LIN\b|\bSPL\b|\bSPTP\b|TIME_BLOCK|\$[A-Z]|KSS", text), file
        assert not re.search(r"^\s*(from|import) trajectories\.krl", text, re.M), file
