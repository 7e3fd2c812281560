"""The record of answers: a seed is answered once, what comes after says so."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from ocp.blindtest import interface, record
from ocp.blindtest.record import entered, entries, refuse_unrecorded
from ocp.blindtest.worlds.sealing import Check
from ocp.data import BLINDTEST_RECORD
from robots.errors import BadInput


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A record of its own."""
    path = tmp_path / "record.jsonl"
    path.write_text("")
    monkeypatch.setattr(record, "BLINDTEST_RECORD", path)
    monkeypatch.setattr(record, "engine_version", lambda: "engine")
    return path


def answered(folder: Path, words: str, worlds: int = 2, seed: int = 100) -> Check:
    """A check whose answers stand, each with these words."""
    check = Check(folder, seed, worlds, ("single", "none"))
    for k in range(1, worlds + 1):
        check.answer(f"{k:05d}").parent.mkdir(parents=True, exist_ok=True)
        check.answer(f"{k:05d}").write_text(f"{words} {k}")
    return check


def test_a_second_answer_to_a_seed_says_so(kept, tmp_path):
    first = answered(tmp_path / "one", "first")
    assert entered(first).counts and entered(first).brief == "first answer"  # told once more, entered once
    assert [(e.seed, e.worlds, e.engine, e.before) for e in entries()] == [(100, 2, "engine", "")]
    told = entered(answered(tmp_path / "one", "changed"))  # the same folder, answered anew
    assert not told.counts and told.brief == "answer 2" and "2 worlds on 20" in told.sentence
    assert entered(answered(tmp_path / "two", "other")).brief == "answer 3"
    assert entered(answered(tmp_path / "three", "first", seed=101)).counts
    assert len(entries()) == 4


def test_a_run_that_goes_on_is_no_second_answer(kept, tmp_path):
    entered(answered(tmp_path / "one", "first"))
    more = answered(tmp_path / "one", "first", 4)
    assert entered(more).counts and [e.worlds for e in entries()] == [2, 4]
    assert entered(replace(more, worlds=3)).counts
    assert entered(answered(tmp_path / "two", "other", 4)).brief != "first answer"


def test_seeds_for_development_are_not_entered(kept, tmp_path):
    for seed in (1, 99):
        told = entered(answered(tmp_path / str(seed), "any", seed=seed))
        assert not told.counts and told.brief == "for development" and f"Seed {seed}" in told.sentence
    assert kept.read_text() == ""


def test_a_record_that_was_changed_is_refused(kept, tmp_path, monkeypatch):
    for k in range(3):
        entered(answered(tmp_path / str(k), "any", seed=100 + k))
    lines = kept.read_text().splitlines()
    for number, changed in ((1, lines[1:]), (2, [lines[0], lines[2]]), (3, [*lines[:2], "{}"]), (2, [lines[0], "[", lines[2]])):
        kept.write_text("\n".join(changed) + "\n")
        with pytest.raises(BadInput, match=f"line {number}: is not what was entered; take the file from the repository"):
            refuse_unrecorded(Check(tmp_path, 100, 1, ("none",)))
    kept.write_text(lines[0].replace("100", "105") + "\n" + lines[1] + "\n")
    with pytest.raises(BadInput, match="line 2: is not"):
        entries()
    kept.unlink()
    with pytest.raises(BadInput, match="cannot be read"):
        entries()


def test_what_cannot_be_entered_is_not_answered(kept, tmp_path, monkeypatch):
    monkeypatch.setattr(record.os, "access", lambda *a: False)
    with pytest.raises(BadInput, match="--seed 100: answers to seeds above 99 are entered in .*give a seed from 1 to 99"):
        interface.blindtest(out=tmp_path / "out", worlds=1, seed=100, jobs=1)
    assert not (tmp_path / "out").exists()
    refuse_unrecorded(Check(tmp_path, 99, 1, ("none",)))


def test_the_repository_s_record_holds_seeds_that_were_answered_first_once():
    told = [json.loads(line) for line in BLINDTEST_RECORD.read_text(encoding="utf-8").splitlines()]
    assert len(entries()) == len(told) and all(one["seed"] not in record.DEVELOPMENT for one in told)


def test_the_engine_s_version_goes_with_its_sources():
    first = record.engine_version()
    assert len(first) == 64 and first == record.engine_version()


def test_another_source_is_another_engine(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "BLINDTEST_RECORD", tmp_path / "ocp" / "data" / "record.jsonl")
    source = tmp_path / "ocp" / "model" / "one.py"
    source.parent.mkdir(parents=True)
    source.write_text("a = 1\n")
    before = record.engine_version()
    source.write_text("a = 2\n")
    assert record.engine_version() != before
