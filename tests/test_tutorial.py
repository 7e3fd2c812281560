"""The tutorial's commands follow from each other; with GRINDPLAN_TUTORIAL=1 they are run word for word (ten minutes)."""

import os
from pathlib import Path

import pytest

from tests.support.tutorial import PAGE, PICTURES, SHOWN, lacking, run, steps

STEPS = steps(PAGE.read_text(encoding="utf-8"))


def test_every_step_reads_what_an_earlier_one_wrote():
    written: set[str] = set()
    for step in STEPS:
        out = step.command[step.command.index("--out") + 1]
        for word in step.command:
            folder = word.split("/")[0]
            if (
                "/" in word or (Path(word).suffix == "" and word in {"plan", "plan2", "plan3", "later"})
            ) and word != step.command[0]:
                assert folder in written or word == out, step.command
        assert out not in written
        written.add(out)
    assert len(STEPS) == 14 and [s.command[0] for s in STEPS].count("plan") == 3


def test_every_step_quotes_what_its_command_says():
    assert all(step.quoted for step in STEPS)


def test_a_quotation_that_is_not_said_is_found():
    step = STEPS[2]
    assert lacking(step, " 1 .. ".join(step.quoted)) == []
    assert lacking(step, "plan: 29 passes") == list(step.quoted)


def test_every_picture_of_the_page_is_there():
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"pictures/{name}.png" in page and (PICTURES / f"{name}.png").is_file() for name in SHOWN)


@pytest.mark.skipif("GRINDPLAN_TUTORIAL" not in os.environ, reason="ten minutes: set GRINDPLAN_TUTORIAL=1")
@pytest.mark.timeout(3600)
def test_the_tutorial_word_for_word(tmp_path):
    assert run(tmp_path) == []
