"""The house: imports run ocp -> trajectories -> robots, matplotlib stays in the report."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ABOVE = {"robots": {"trajectories", "ocp"}, "trajectories": {"ocp"}, "ocp": set()}


def modules() -> list[tuple[Path, set[str]]]:
    found = []
    for wing in ABOVE:
        for path in sorted((ROOT / wing).rglob("*.py")):
            names: set[str] = set()
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    names |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module:
                    assert node.level == 0, f"{path}: relative import"
                    names.add(node.module)
            found.append((path, names))
    return found


def test_imports_never_run_back():
    for path, names in modules():
        wing = path.relative_to(ROOT).parts[0]
        wrong = {n for n in names if n.split(".")[0] in ABOVE[wing]}
        assert not wrong, f"{path} imports {wrong}"


def test_only_the_report_draws():
    for path, names in modules():
        if "report" not in path.parts:
            assert not {n for n in names if n.split(".")[0] in {"matplotlib", "plotly"}}, path


def test_the_krl_reader_shares_nothing_with_the_writer():
    reader = dict(modules())[ROOT / "trajectories" / "krl" / "reader.py"]
    assert not {n for n in reader if "krl.writer" in n or "krl.program" in n}


def test_the_verification_uses_neither_the_model_nor_casadi():
    names = dict(modules())[ROOT / "ocp" / "plan" / "verify" / "second_route.py"]
    forbidden = {
        "casadi",
        "ocp.model.force_balance",
        "ocp.plan.passes.stage",
        "ocp.plan.passes.solve",
        "ocp.contact.wheel.law",
        "robots.kinematics",
    }
    assert not names & forbidden


@pytest.mark.parametrize("wing", sorted(ABOVE))
def test_files_are_short_enough_to_hold_one_idea(wing):
    for path in (ROOT / wing).rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 300, path
