"""`python -m ocp.diagnose`: what it writes, what it refuses, and that its answers are those that were made up."""

import csv
import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ocp.diagnose.__main__ import app
from ocp.diagnose.answering import tracker_channel, write_diagnosis
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.document import Document
from ocp.diagnose.engine.findings import Diagnosis, Explanation, Name, Ranked
from ocp.diagnose.foresee.next_experiment import next_experiments
from ocp.diagnose.foresee.planned_tracker import channel_about, planned_measurements
from ocp.diagnose.foresee.separation import RivalPair, unlike
from ocp.effects.catalogue import effect_list, library
from ocp.effects.effect import Active
from ocp.model.cell import read_tracker_setup
from ocp.shell.command import run
from ocp.shell.progress import Phases
from tests.support.browser import NEEDED, looked_at
from tests.support.diagnosis_folder import CELL, SPRINGS, columns_of, write_csv, write_joint_folder, write_tracker_folder
from tests.support.simulated_campaign import campaign_readings
from tests.support.small_plan import called

pytestmark = pytest.mark.usefixtures("unprinted")

PLAY = 2e-4


def diagnosed(folder: Path, out: Path) -> tuple[str, Document]:
    line = write_diagnosis(folder, out, False, Phases()).line
    return line, Document.model_validate_json((out / "diagnosis.json").read_text())


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets") / "played"
    truth = write_tracker_folder(folder, 3, PLAY)
    line, document = diagnosed(folder, folder.parent / "out")
    return folder, folder.parent / "out", truth, line, document


def rows(path: Path) -> list[dict[str, float]]:
    with path.open() as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(a**2, axis=1))))


@NEEDED
def test_its_page_stands_in_a_browser(played):
    looked_at(played[1] / "report.html")


def test_the_play_is_named_with_its_joint_and_size(played):
    document = played[4]
    assert document.verdict == "explained"
    first = document.ranking[0]
    assert (first.effect, first.joint) == ("backlash", 3) and first.probability > 0.9
    value = first.parameters["half_width_rad"]
    assert value.unit == "rad" and abs(value.value - PLAY) < max(4 * value.sd, 0.05 * PLAY)
    assert (document.location.subsystem, document.location.joint) == ("joint", 3)
    gap = document.gap["tracker"]
    assert gap.unit == "mm" and gap.after.rms < 0.5 * gap.before.rms
    assert gap.shrinkage.low <= gap.shrinkage.predicted <= gap.shrinkage.high <= 1.0


def test_the_file_is_what_the_formats_page_asks_for(played):
    raw = json.loads((played[1] / "diagnosis.json").read_text())
    keys = ["schema", "dataset", "verdict", "p_none", "p_unknown", "ranking", "explanations", "indistinguishable", "location"]
    assert list(raw) == [*keys, "gap", "remaining", "patch", "blind_spots", "next_experiment"]
    assert (
        raw["schema"] == 2
        and raw["patch"] is None
        and list(raw["remaining"]["tracker"]) == ["above_noise", "p_value", "location"]
    )
    assert raw["dataset"] == "played"
    assert abs(raw["p_none"] + sum(e["probability"] for e in raw["explanations"]) - 1) < 1e-9


def test_blind_predictions_stand_in_order_and_shrink_as_promised(played):
    _, out, truth, _, document = played
    found = rows(out / "predictions_tracker.csv")
    kinds = ("baseline", "corrected", "sigma", "patched", "patched_sigma")
    assert list(found[0]) == [*(f"{kind}_{c}_mm" for kind in kinds for c in "xyz"), "inside"]
    assert len(found) == len(truth)
    points = {k: np.array([[row[f"{k}_{c}_mm"] for c in "xyz"] for row in found]) for k in ("baseline", "corrected", "sigma")}
    before, after = (rms(points[k] - 1e3 * truth) for k in ("baseline", "corrected"))
    promised = document.gap["tracker"].shrinkage
    assert after < 0.5 * before
    assert promised.low - 0.1 < 1 - after / before < promised.high + 0.1
    # Sigma is that of the noise-free value: errors are about as large.
    off = (points["corrected"] - 1e3 * truth) / points["sigma"]
    assert 0.4 < np.sqrt(np.mean(off**2)) < 2.0


def test_the_corrected_cell_is_read_back_with_the_effect_and_the_arm(played):
    out = played[1]
    setup = read_tracker_setup(out / "corrected_cell.toml")
    assert [(e.effect, e.joint) for e in setup.tables.effects] == [("backlash", 3)]
    tables = tomllib.loads((out / "corrected_cell.toml").read_text())
    assert tables["robot"]["calibration"] == "calibration.toml" and (out / "calibration.npz").is_file()
    assert abs(tables["effects"][0]["half_width_rad"] - PLAY) < 0.1 * PLAY


def test_the_page_says_it_in_words_and_loads_nothing(played):
    page = (played[1] / "report.html").read_text()
    told = r"acklash of joint 3( or friction windup of joint 3)? explains the gap"
    assert re.search(told, page) and re.search(told, played[3])
    assert "<script" not in page and "http://" not in page and "https://" not in page
    for heading in ("Which effect", "How far the gap shrinks", "Where it lies", "What these data cannot show", "Evidence"):
        assert heading in page


@pytest.mark.drawn
def test_equal_data_give_equal_bytes(played, tmp_path):
    folder, out = played[:2]
    write_diagnosis(folder, tmp_path / "again", False, Phases())
    for name in ("diagnosis.json", "predictions_tracker.csv", "report.html", "corrected_cell.toml"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes(), name


def test_data_without_an_effect_have_no_gap(tmp_path):
    write_tracker_folder(tmp_path / "set", 11, 0.0)
    line, document = diagnosed(tmp_path / "set", tmp_path / "out")
    assert document.verdict == "no_gap" and document.p_none > 0.5
    assert "No gap." in line
    shrinkage = document.gap["tracker"].shrinkage
    assert shrinkage is None or shrinkage.predicted == shrinkage.high == 0.0
    found = rows(tmp_path / "out" / "predictions_tracker.csv")
    assert all(row[f"baseline_{c}_mm"] == row[f"corrected_{c}_mm"] for row in found for c in "xyz")


def test_missing_columns_blind_and_it_says_so(tmp_path):
    write_tracker_folder(tmp_path / "set", 3, PLAY, n=60, sealed=5)
    table = rows_of_text(tmp_path / "set" / "tracker.csv")
    write_csv(tmp_path / "set" / "tracker.csv", {k: v for k, v in table.items() if not k.startswith("approach")})
    _, document = diagnosed(tmp_path / "set", tmp_path / "out")
    assert any("approach" in words and "backlash" in words for words in document.blind_spots)
    assert all(r.effect not in ("backlash", "friction_windup") for r in document.ranking)


def rows_of_text(path: Path) -> dict[str, list[str]]:
    with path.open() as file:
        table = list(csv.DictReader(file))
    return {key: [row[key] for row in table] for key in table[0]}


def test_a_late_channel_and_a_spring_are_told_apart(tmp_path):
    # The cell has joint 2 rigid; it gives, and all links are recorded 4 ms late.
    write_joint_folder(tmp_path / "set", 5, "2.0e6, 0, 2.46e6, 0, 0, 0", delay=4e-3, compliance=6e-7)
    _, document = diagnosed(tmp_path / "set", tmp_path / "out")
    found = {(r.effect, r.joint): r for r in document.ranking if r.probability > 0.9}
    assert set(found) == {("channel_delay", None), ("joint_compliance", 2)}
    delay = found["channel_delay", None].parameters["s"]
    assert abs(delay.value - 4e-3) < max(4 * delay.sd, 2e-4)
    spring = found["joint_compliance", 2].parameters["rad_per_Nm"]
    assert abs(spring.value - 1 / 3.3e6 - 6e-7) < max(4 * spring.sd, 1e-7)
    gap = document.gap["joint"]
    assert gap.unit == "arcsec" and gap.shrinkage.predicted > 0.85


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda f: (f / "cell.toml").unlink(), "holds no cell.toml"),
        (lambda f: (f / "tracker.csv").unlink(), "holds none of tracker.csv"),
        (lambda f: swap(f / "tracker.csv", 4, ",T", ",X"), "line 5, column target: X"),
        (lambda f: swap(f / "tracker.csv", 2, ",1,", ",x,"), "line 3, column approach"),
        (lambda f: (f / "tracker.csv").write_text("a,b\n1,2\n"), "missing"),
        (lambda f: shorten(f / "tracker.csv", 15), "14 readings are too few"),
        (lambda f: swap(f / "sealed_tracker.csv", 0, "q3_deg", "q9_deg"), "q3_deg missing"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence_and_nothing_is_written(tmp_path, capsys, spoil, words):
    folder = tmp_path / "set"
    write_tracker_folder(folder, 3, 0.0, n=24, sealed=3)
    spoil(folder)
    assert run(lambda: write_diagnosis(folder, tmp_path / "out", False, Phases()).line) == 2
    told = capsys.readouterr().err.strip()
    assert words in told and len(told.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def swap(path: Path, line: int, old: str, new: str) -> None:
    lines = path.read_text().splitlines()
    lines[line] = lines[line].replace(old, new, 1)
    path.write_text("\n".join(lines) + "\n")


def shorten(path: Path, lines: int) -> None:
    path.write_text("\n".join(path.read_text().splitlines()[:lines]) + "\n")


def test_the_command_line_refuses_with_code_two(tmp_path):
    found = called(app, tmp_path, "nowhere")
    assert found.code == 2 and "is no folder" in found.err and not found.out
    assert called(app, tmp_path).code == 2


def test_what_is_there_but_no_file_is_not_taken_for_absent(tmp_path):
    write_tracker_folder(tmp_path / "set", 3, 0.0, n=24)
    (tmp_path / "set" / "joints.csv").symlink_to(tmp_path / "moved.csv")
    found = called(app, tmp_path, "set")
    assert found.code == 2 and "joints.csv: cannot be read" in found.err


def test_a_mapping_is_of_a_data_set(tmp_path):
    (tmp_path / "cell.toml").write_text(CELL.format(stiffness=SPRINGS))
    found = called(app, tmp_path, "--design", "cell.toml", "--columns", "m.toml")
    assert found.code == 2 and "m.toml: --design looks at a plan" in found.err


def test_a_design_writes_nothing_and_says_so(tmp_path):
    (tmp_path / "cell.toml").write_text(CELL.format(stiffness=SPRINGS))
    found = called(app, tmp_path, "--design", "cell.toml", "--out", "table")
    assert found.code == 2 and "--out table: --design prints a table" in found.err and not (tmp_path / "table").exists()


def test_a_folder_in_use_is_not_overwritten(tmp_path, capsys):
    write_tracker_folder(tmp_path / "set", 3, 0.0, n=24, sealed=3)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("kept")
    assert run(lambda: write_diagnosis(tmp_path / "set", tmp_path / "out", False, Phases()).line) == 2
    assert run(lambda: write_diagnosis(tmp_path / "set", tmp_path / "set", True, Phases()).line) == 2
    assert (tmp_path / "out" / "mine.txt").read_text() == "kept" and (tmp_path / "set" / "tracker.csv").is_file()


def test_the_design_table_says_what_a_plan_cannot_see(tmp_path):
    (tmp_path / "cell.toml").write_text(CELL.format(stiffness=SPRINGS))
    found = called(app, tmp_path, "--design", "cell.toml")
    assert found.code == 0
    assert any("50 unidirectional poses" in line and "backlash" in line for line in found.out.splitlines()[-12:])
    planned = campaign_readings(np.random.default_rng(1), 60)
    write_csv(tmp_path / "poses.csv", columns_of(planned))
    line = next(
        x
        for x in called(app, tmp_path, "--design", "cell.toml", "--poses", "poses.csv").out.splitlines()
        if x.startswith("backlash")
    )
    assert "cannot be seen" not in line


WINDUP, PLAYED = Name("friction_windup", 3), Name("backlash", 3)


def windup(per_Nm: float) -> Ranked:
    """Windup that grows with the load: play is the same without the load."""
    effect = library()["friction_windup"]
    return Ranked(WINDUP, 0.6, 1.0, Active(effect, 3, np.array([0.0, per_Nm]), {}, np.eye(2) * 1e-20), 20.0)


def test_more_readings_never_tell_less(played):
    channel = tracker_channel(read_data_set(played[0]))
    pair = RivalPair(windup(2e-8), library()["backlash"], 3, 0.5)
    alone = replace(pair, rival=None)
    now = unlike([channel], pair)
    assert 0 < now < unlike([channel], alone)
    for candidate in planned_measurements(channel, (3,)):
        there = channel_about(channel, candidate.readings)
        assert unlike([channel, there], pair) >= now - 1e-6
        assert unlike([channel, there], alone) >= unlike([channel], alone) - 1e-6


def test_what_remains_is_asked_for_and_nothing_else(played):
    channel = tracker_channel(read_data_set(played[0]))
    first = windup(2e-8)

    def diagnosis(*explanations):
        empty = ((),) * 7
        return Diagnosis(explanations, (first,), (first.active,), 0.0, 0.0, (), None, None, *empty, (), (channel,), (channel,))

    found = next_experiments(diagnosis(Explanation((WINDUP,), 0.6, 9.0), Explanation((PLAYED,), 0.4, 8.6)), library())
    assert found and all(e.tells_apart == ("friction_windup:3", "backlash:3") and 0.6 < e.expected <= 1.0 for e in found)
    worth = [(e.expected - 0.6) / e.minutes for e in found]
    assert worth == sorted(worth, reverse=True)
    assert next_experiments(diagnosis(Explanation((WINDUP,), 1.0, 9.0)), library()) == ()


def test_a_new_effect_is_listed_without_another_change(monkeypatch):
    effects = library()
    added = dict(effects) | {"wobble": replace(effects["backlash"], name="wobble", title="wobble of joint {joint}")}
    monkeypatch.setattr("ocp.effects.catalogue.library", lambda: added)
    assert any(line.startswith("wobble:1-6") and "half_width_rad" in line for line in effect_list().splitlines())
