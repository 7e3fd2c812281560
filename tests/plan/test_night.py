"""Several blades in one call: a plan each, the same as alone, and a night that goes on where it ended."""

import json
import os
import shutil
import signal
import time
from concurrent.futures import Future
from pathlib import Path

import pytest

from ocp.plan import night
from ocp.plan.__main__ import app
from ocp.plan.grades import NOT_TO_GRIND
from ocp.plan.night import plan_night
from ocp.plan.report.night import night_page
from ocp.shell.executor import WorkerEnded
from ocp.shell.output import MARKER, reserved, users_file
from tests.support.browser import NEEDED, looked_at
from tests.support.small_plan import STEP, called, started, tree

ASKED = ("--cell", "cell.toml", "--out", "night", *STEP)


def bad_blade(file: Path, word: str = "nothing") -> Path:
    file.write_text(f"solid {word}\nendsolid\n")
    return file


def rows(folder: Path) -> dict[str, dict]:
    return {row["name"]: row for row in json.loads((folder / "night.json").read_text())["blades"]}


@pytest.fixture(scope="module")
def made(small_plan_copy):
    """Folder of the small plan with a night of its blade and of one that is none, and what the command said."""
    folder = small_plan_copy[0]
    bad_blade(folder / "bad #1.stl")
    return folder, called(app, folder, "bad #1.stl", "blade.stl", *ASKED)


@NEEDED
def test_its_page_stands_in_a_browser(made):
    looked_at(made[0] / "night" / "index.html", figure=None)


def test_every_blade_has_the_plan_that_it_has_alone(made):
    """And a second run writes the same bytes."""
    folder, told = made
    assert told.code == 1 and told.out.startswith("night: 1 of 2 blades are safe to move, 1 has no plan.")
    alone = tree(folder / "plan")
    assert len(alone) > 8 and alone == tree(folder / "night" / "blade")
    assert {p.name for p in (folder / "night").iterdir()} == {MARKER, "night.json", "index.html", "blade"}
    assert users_file(folder / "night") is None


def test_one_that_has_no_plan_is_a_row_with_its_reason(made):
    folder, told = made
    reason = "refused: bad #1.stl: holds no facet; export the blade as STL again."
    bad, good = rows(folder / "night").values()
    assert (bad["name"], bad["exit_code"], bad["reason"], bad["link"]) == ("bad #1", 2, reason, None)
    assert f"note: bad #1: {reason}\n" in told.err
    assert (good["exit_code"], good["reason"], good["link"]) == (0, "", "blade/report.html") and good["seconds"] > 0
    assert good["grades"] == {"move": "green", "force": "amber"} and good["process"]["ground_share"] > 0.9
    plan = json.loads((folder / "plan" / "plan.json").read_text())
    assert good["inputs"] == sorted(plan["inputs"], key=lambda one: one["role"]) and good["verdict"] == plan["verdict"]
    page = (folder / "night" / "index.html").read_text()
    assert '<a href="blade/report.html">report</a>' in page and "refused: bad #1.stl" in page and "verdict unsafe" in page


def test_the_same_command_does_nothing_twice_and_another_blade_is_added(made):
    folder, _ = made
    before = tree(folder / "night")
    again = called(app, folder, "bad #1.stl", "blade.stl", *ASKED)
    assert again.code == 1 and {n: b for n, b in tree(folder / "night").items() if n in before} == before
    bad_blade(folder / "bad #1.stl", "mended")  # what has no plan may have changed
    bad_blade(folder / "other.stl")
    assert called(app, folder, "other.stl", "blade.stl", "bad #1.stl", *ASKED).code == 1
    found = rows(folder / "night")
    assert list(found) == ["other", "blade", "bad #1"]
    assert found["blade"] == json.loads(before["night.json"])["blades"][1] and found["bad #1"] != rows_of(before)["bad #1"]
    assert {n: b for n, b in tree(folder / "night").items() if n.startswith("blade/")} == {
        n: b for n, b in before.items() if n.startswith("blade/")
    }


def rows_of(files: dict[str, bytes]) -> dict[str, dict]:
    return {row["name"]: row for row in json.loads(files["night.json"])["blades"]}


def test_a_night_of_other_plans_is_not_gone_on_with(made, tmp_path):
    folder, _ = made
    other = called(app, folder, "bad #1.stl", "blade.stl", *ASKED[:-1], "3")
    assert other.code == 2 and "planned with another step_mm; give the same again" in other.err
    before = (folder / "cell.toml").read_bytes()
    (folder / "cell.toml").write_bytes(before + b"# edited\n")
    other = called(app, folder, "bad #1.stl", "blade.stl", *ASKED)
    (folder / "cell.toml").write_bytes(before)
    assert other.code == 2 and "planned with another cell, or file that it names; give the same again" in other.err
    (tmp_path / "far").mkdir()
    shutil.copy(folder / "blade.stl", tmp_path / "far" / "blade.stl")
    with (tmp_path / "far" / "blade.stl").open("a") as file:
        file.write("\n")
    other = called(app, folder, "bad #1.stl", tmp_path / "far" / "blade.stl", *ASKED)
    assert other.code == 2 and "is not the blade that night/blade was planned for" in other.err
    other = called(app, folder, "bad #1.stl", "other.stl", "--cell", "cell.toml", "--out", "plan", *STEP)
    assert other.code == 2 and "plan: is not empty and holds no night.json" in other.err


def test_a_lost_plan_is_made_again_and_a_changed_one_refused(made, tmp_path):
    """Both stood as safe to move in table and page."""
    shutil.copytree(made[0], tmp_path / "copy")
    copy = tmp_path / "copy"
    program = copy / "night" / "blade" / "BLADE_01.src"
    program.write_text(program.read_text().replace("A1", "A2", 1))
    before = tree(copy / "night")
    told = called(app, copy, "bad #1.stl", "blade.stl", *ASKED)
    assert told.code == 2 and "blade/BLADE_01.src: is gone or was changed since it was written; put it back, or move" in told.err
    assert tree(copy / "night") == before
    shutil.rmtree(copy / "night" / "blade")
    assert called(app, copy, "bad #1.stl", "blade.stl", *ASKED).code == 1
    assert tree(copy / "night" / "blade") == tree(made[0] / "night" / "blade")


def test_an_interrupted_night_keeps_what_is_done_and_goes_on(made, tmp_path):
    folder, _ = made
    for name in ("cell.toml", "blade.stl"):
        shutil.copy(folder / name, tmp_path / name)
    with (tmp_path / "blade.stl").open("a") as file:
        file.write("\n")  # other bytes: its plan is made, not taken whole from the cache before the interrupt comes
    bad_blade(tmp_path / "first.stl")
    process = started(tmp_path, "first.stl", "blade.stl", *ASKED, "--jobs", "1")
    until = time.monotonic() + 60
    while not ((tmp_path / "night" / "night.json").exists() and rows(tmp_path / "night")) and time.monotonic() < until:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGINT)
    told = process.communicate(timeout=20)[1]
    assert process.returncode == 130 and told == "interrupted, what is done is kept, the same command goes on from there\n"
    done = rows(tmp_path / "night")
    assert list(done) == ["first"] and users_file(tmp_path / "night") is None
    bad_blade(tmp_path / "blade.stl")
    assert called(app, tmp_path, "first.stl", "blade.stl", *ASKED).code == 1
    assert rows(tmp_path / "night")["first"] == done["first"] and list(rows(tmp_path / "night")) == ["first", "blade"]
    with reserved(tmp_path / "night", overwrite=True, grows=True):
        assert [p.name for p in tmp_path.glob(".*")] == []


def test_a_blade_whose_process_was_lost_is_tried_again(tmp_path, monkeypatch):
    blades = [bad_blade(tmp_path / "a.stl")]

    def lost(work, tasks, hands, **kind):
        for place, _ in enumerate(tasks):
            future: Future = Future()
            future.set_exception(WorkerEnded("ended by the system"))
            yield place, future

    monkeypatch.setattr(night, "carried_out", lost)
    made = plan_night(blades, out=tmp_path / "night")
    assert [row["reason"] for row in made.rows] == ["no safe plan: ended by the system"] and len(made.failed) == 1
    monkeypatch.undo()
    assert all("holds no facet" in row["reason"] for row in plan_night(blades, out=tmp_path / "night", jobs=1).rows)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["a.stl", "far/A.stl"], "far/A.stl: would be planned into the same folder as a.stl"),
        (["a.stl", "a.stl"], "a.stl: would be planned into the same folder as a.stl; name it once"),
        (["a 1.stl", "a_1.stl"], "a_1.stl: its program would be called A_1 as that of a 1.stl; rename one of them"),
        (["a.stl", "night.json.stl"], "would be planned into a folder named night.json"),
        (["a.stl", "nowhere.stl"], "nowhere.stl: there is no such file"),
        (["a.stl", "b.stl", "--path", "path.csv"], "--path is of one blade and 2 are named"),
        (["a.stl", "b.stl", "--program", "old.src"], "--program is of one blade"),
        (["a.stl", "b.stl", "--name", "X"], "--name is of one blade"),
        (["a.stl", "b.stl", "--kind", "spline"], "--kind 'spline' is not axis"),
        (["a.stl", "b.stl", "--jobs", "-1"], "--jobs -1 must lie between 0 and 256"),
        (["a.stl", "b.stl", "--cell", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["a.stl", "b.stl", "--scheduler", "foo"], "--scheduler 'foo' is no address"),
        (["a.stl", "--jobs", "2"], "--jobs and --scheduler spread several blades"),
    ],
)
def test_what_several_blades_cannot_have_is_one_sentence(tmp_path, arguments, says):
    (tmp_path / "far").mkdir()
    for name in ("a.stl", "b.stl", "a 1.stl", "a_1.stl", "far/A.stl", "night.json.stl"):
        bad_blade(tmp_path / name)
    before = tree(tmp_path)
    told = called(app, tmp_path, *arguments, "--out", "night")
    assert told.code == 2 and says in told.err and told.err.count("\n") == 1 and told.out == ""
    assert tree(tmp_path) == before and not (tmp_path / "night").exists()


@pytest.mark.parametrize(
    ("headline", "tone"), [("Safe to use.", "safe"), ("Safe to use, with care.", "doubtful"), (NOT_TO_GRIND, "unsafe")]
)
def test_the_head_has_the_colour_of_its_worst_blade(headline, tone):
    told = {
        "name": "A",
        "exit_code": 0,
        "force_error_N": 0.1,
        "force_sd_max_N": 1.0,
        "duration_s": 60.0,
        "seconds": 1.0,
        "link": "a",
    }
    shares = dict.fromkeys(("ground_share", "core_within_5", "core_within_10"), 1.0)
    rows = [told | {"headline": one, "process": shares} for one in ("Safe to use.", headline)]
    assert night_page(rows, 2, "cell.toml").head.tone == tone


def test_a_page_of_an_unfinished_night_says_what_is_still_to_come():
    head = night_page([], 3, "cell.toml").head
    assert head.tone == "unsafe" and head.verdict == "Not done yet." and "3 are still to be planned" in head.sentence
