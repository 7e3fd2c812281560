"""The house: imports run ocp -> trajectories -> robots and inside ocp down the declared order of rooms; names stand once."""

import pytest

from tests.support.house import ROOT, WINGS, declared, described, floors, imported, room_of, sources, uses, with_table

HOUSE = declared()


def test_imports_never_run_back_between_the_wings():
    for path in sources():
        wing = path.relative_to(ROOT).parts[0]
        above = set(WINGS[WINGS.index(wing) + 1 :])
        wrong = [(line, name) for line, name in imported(path) if name.split(".")[0] in above]
        assert not wrong, f"{path} imports {wrong}"


def test_rooms_are_those_that_are_declared():
    assert set(uses()) == set(HOUSE.rooms)
    assert len(HOUSE.rooms) <= HOUSE.most_rooms


def test_no_module_stands_outside_a_room():
    assert [path.name for path in (ROOT / "ocp").glob("*.py")] == ["__init__.py"]
    assert {name for _, name in imported(ROOT / "ocp" / "__init__.py")} <= {"os"}


@pytest.mark.parametrize("room", HOUSE.rooms)
def test_a_room_imports_only_rooms_below_it(room):
    below = set(HOUSE.rooms[: HOUSE.rooms.index(room)])
    for path in sources("ocp"):
        if path.parent != ROOT / "ocp" and room_of(path) == room:
            for line, name in imported(path):
                parts = name.split(".")
                assert parts[0] != "ocp" or len(parts) == 1 or parts[1] in below | {room}, f"{path}:{line} imports {name}"


def test_the_house_has_few_floors():
    assert max(floors().values()) <= HOUSE.most_floors


def test_folders_are_small_enough_to_be_looked_over():
    for wing in WINGS:
        for folder in [ROOT / wing, *(p for p in (ROOT / wing).rglob("*") if p.is_dir() and p.name != "__pycache__")]:
            entries = [p.name for p in folder.iterdir() if p.name != "__pycache__"]
            most = HOUSE.most_entries if str(folder.relative_to(ROOT)) not in HOUSE.many else 100
            assert len(entries) <= most, f"{folder}: {len(entries)} entries"


def test_every_room_says_what_lives_there_and_what_does_not():
    for room in HOUSE.rooms:
        first, rest = described(room)
        assert first.endswith((".", "out.")) and "Here:" in rest and "Not here:" in rest, room


def test_only_reports_draw():
    for path in sources():
        if "report" not in "/".join(path.relative_to(ROOT).parts[1:]):
            assert not [n for _, n in imported(path) if n.split(".")[0] in {"matplotlib", "plotly"}], path


@pytest.mark.parametrize("file", ["lexer", "syntax", "reader", "interpreter", "checks_structure", "checks"])
def test_the_krl_reader_shares_nothing_with_the_writer(file):
    names = {name for _, name in imported(ROOT / "trajectories" / "krl" / f"{file}.py")}
    writing = ("krl.writer", "krl.values", "program.program", "program.build", "program.interpolation")
    assert not {name for name in names if any(part in name for part in writing)}
    assert "trajectories.program" not in names


def test_the_verification_uses_neither_the_model_nor_casadi():
    names = {name for _, name in imported(ROOT / "ocp" / "plan" / "second_route.py")}
    forbidden = {
        "casadi",
        "ocp.model.force_balance",
        "ocp.plan.passes.stage",
        "ocp.plan.passes.solve",
        "ocp.contact.wheel.law",
        "robots.kinematics",
    }
    assert not names & forbidden


def test_the_table_of_rooms_is_the_sources():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert with_table(page) == page, "run: python -m tests.support.house docs/architecture.md"
