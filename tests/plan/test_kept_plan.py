"""The same plan asked for again is the kept one, byte for byte; whatever it depends on, changed, makes it anew."""

import json
from importlib.metadata import distributions
from pathlib import Path
from types import SimpleNamespace

import pytest

from ocp.plan import interface, kept
from ocp.plan.__main__ import app
from ocp.plan.kept import KeptPlan, PlanKey
from ocp.shell.cache import OWN_EFFECTS
from robots.errors import BadInput
from tests.support.small_plan import STEP, called, planned, tree

KEEP, WRITTEN_AGAIN = PlanKey.keep, PlanKey.written_again  # as they are outside the tests (tests/conftest.py)


def test_the_same_command_again_writes_the_same_bytes_and_says_so(small_plan_once, tmp_path, monkeypatch):
    folder, told = small_plan_once
    again = planned(folder, "--cell", "cell.toml", *STEP, "--out", str(tmp_path / "again"))
    assert again.code == 0 and "nothing that it depends on has changed" in again.err
    assert tree(tmp_path / "again") == tree(folder / "plan")
    assert again.out == told.out.replace("plan:", f"{tmp_path / 'again'}:", 1).replace("plan/", f"{tmp_path / 'again'}/")
    monkeypatch.setattr(PlanKey, "written_again", WRITTEN_AGAIN)
    refused = called(app, folder, "--cell", "cell.toml", *STEP, "--out", tmp_path / "again")
    assert refused.code == 2 and "is not empty" in refused.err


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Two files that a plan reads."""
    for name in ("cell.toml", "blade.stl"):
        (tmp_path / name).write_text(name)
    return [tmp_path / "cell.toml", tmp_path / "blade.stl"]


def test_every_input_argument_package_and_own_effect_is_part_of_the_key(files, tmp_path, monkeypatch):
    def key(**arguments: object) -> str:
        found = PlanKey.of(files, {"kind": "axis", "step": 5e-4} | arguments)
        assert found is not None
        return found.key

    keys = [key(), key(kind="lin"), key(step=6e-4)]
    files[1].write_text("blade, scanned anew")
    keys.append(key())
    fewer = [one for one in distributions() if one.name != "coal"]
    monkeypatch.setattr(kept, "distributions", lambda: fewer)
    keys.append(key())
    (tmp_path / "effects").mkdir()
    monkeypatch.setenv(OWN_EFFECTS, str(tmp_path / "effects"))
    keys.append(key())
    (tmp_path / "effects" / "wear.py").write_text("EFFECT = None")
    keys.append(key())
    (tmp_path / "effects" / "wear.py").rename(tmp_path / "effects" / "heat.py")
    keys.append(key())
    assert len(set(keys)) == len(keys) and key() == keys[-1]


def test_what_cannot_be_read_has_no_key_and_is_for_planning_to_refuse(files, tmp_path, monkeypatch):
    assert PlanKey.of(files, {}) is not None
    monkeypatch.setattr(kept, "MOST_READ", 10)
    assert PlanKey.of(files, {}) is None
    monkeypatch.undo()

    def refused(*_: object) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refused)
    assert PlanKey.of(files, {}) is None


def test_a_plan_that_read_another_file_is_not_kept(files, tmp_path, monkeypatch):
    monkeypatch.setenv("GRINDPLAN_CACHE", str(tmp_path / "cache"))
    made = tmp_path / "made"
    made.mkdir()
    (made / "A.src").write_bytes(b"DEF A()\xff")
    (made / "plan.json").write_text(json.dumps({}))
    key = PlanKey.of(files, {})
    assert key is not None
    KEEP(key, made, "1 pass", ("a notice",), [*files, tmp_path / "beside.npz"])
    assert WRITTEN_AGAIN(key, tmp_path / "out", False) is None
    KEEP(key, made, "1 pass", ("a notice",), files)
    found = WRITTEN_AGAIN(key, tmp_path / "out", False)
    assert isinstance(found, KeptPlan) and found.line.startswith(f"{tmp_path / 'out'}: 1 pass Look at")
    assert found.notices[0] == "a notice" and len(found.notices) == 2
    assert (tmp_path / "out" / "A.src").read_bytes() == b"DEF A()\xff" and (tmp_path / "out" / "plan.json").exists()
    (tmp_path / "cache").chmod(0o777)  # another user could have put a program there
    assert WRITTEN_AGAIN(key, tmp_path / "open", False) is None
    (tmp_path / "cache").chmod(0o700)
    with pytest.raises(BadInput, match="input of this run"):
        WRITTEN_AGAIN(key, tmp_path, True)


@pytest.mark.parametrize("rewritten", [True, False])
def test_a_plan_whose_input_changes_meanwhile_is_not_kept(files, tmp_path, monkeypatch, rewritten):
    made = SimpleNamespace(folder=tmp_path, written="", notices=(), plan=SimpleNamespace(inputs=()))

    def planned_meanwhile(*_: object, **__: object) -> SimpleNamespace:
        files[1].write_text("newer" if rewritten else files[1].read_text())
        return made

    kept_now: list[object] = []
    monkeypatch.setattr(PlanKey, "keep", lambda *_: kept_now.append(1))
    monkeypatch.setattr(interface, "_inputs", lambda *_: files)
    monkeypatch.setattr(interface, "plan", planned_meanwhile)
    found = interface.plan_unless_kept(None, out=tmp_path / "out", cell=files[0], overwrite=False, progress=None)
    assert found is made and len(kept_now) == (not rewritten)
