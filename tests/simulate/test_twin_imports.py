"""The virtual cell shares no code with the planner's model: its imports are a white list."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TWIN = ROOT / "ocp" / "simulate" / "twin"
PACKAGES = {"numpy", "scipy", "mujoco", "trimesh"} | set(sys.stdlib_module_names)
OWN = {
    "ocp.model.cell",
    "ocp.model.cell_schema",
    "robots.robot",
    "robots.pose",
    "robots.bounds",
    "robots.errors",
    "robots.csv_table",
    "trajectories.blade",
    # The blade's finite elements, held against CalculiX elsewhere, and the mesh parts they need.
    "ocp.contact.blade.compliance",
    "ocp.contact.blade.elasticity",
    "ocp.contact.blade.surface_mesh",
    "ocp.contact.blade.volume_mesh",
    "ocp.contact.blade.mesher",
    "ocp.contact.blade.nested_dissection",
}
FORBIDDEN = (
    "ocp.model.force_balance",
    "ocp.effects",
    "ocp.model.theta",
    "ocp.model.blade_gap",
    "ocp.plan.second_route",
    "robots.compliance",
    "robots.gravity",
    "robots.kinematics",
    "robots.reference_kinematics",
    "robots.inverse",
    "trajectories.krl",
    "trajectories.program",
    "trajectories.dialects",
    "robots.calibration",
    "ocp.contact.wheel.law",
    "ocp.contact.wheel.law_fit",
    "ocp.contact.wheel.cover",
    "ocp.contact.wheel.signorini",
    "casadi",
    "pinocchio",
)


def imported(path: Path) -> set[str]:
    """Modules that a file imports anywhere in it, functions included; for `from a import b` also a.b where that is a module."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            modules = [name for name in inner if is_module(name)]
            names |= set(modules) | ({node.module} if len(modules) < len(inner) else set())
        elif isinstance(node, ast.Call) and called(node) in ("__import__", "import_module"):
            # By a name that the run chooses: then from names that stand in the file, and all of these are looked at.
            constants = [n.value for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Constant)]
            chosen = {text for text in constants if isinstance(text, str) and is_module(text)}
            assert chosen, f"{path}: imports by a name that stands nowhere"
            names |= chosen
    return names


def called(node: ast.Call) -> str:
    return getattr(node.func, "id", getattr(node.func, "attr", ""))


def is_module(name: str) -> bool:
    if not name or not all(part.isidentifier() for part in name.split(".")):
        return False
    place = ROOT.joinpath(*name.split("."))
    return place.with_suffix(".py").exists() or (place / "__init__.py").exists()


def allowed(name: str) -> bool:
    return name.split(".")[0] in PACKAGES or name in OWN or name == "ocp.simulate.twin" or name.startswith("ocp.simulate.twin.")


FILES = sorted(TWIN.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(TWIN)))
def test_the_virtual_cell_imports_only_what_it_may(path: Path) -> None:
    wrong = {name for name in imported(path) if not allowed(name)}
    assert not wrong, f"{path} imports {sorted(wrong)}"


def test_there_is_a_virtual_cell_to_look_at() -> None:
    assert len(FILES) > 15


def test_the_white_list_names_no_part_of_the_model() -> None:
    for name in OWN:
        assert not any(name == f or name.startswith(f + ".") for f in FORBIDDEN), name
        assert is_module(name), name


@pytest.mark.parametrize(
    "line",
    [
        "import ocp.model.force_balance",
        "from ocp.model import theta",
        "from robots.kinematics import forward",
        "from trajectories.krl.reader import read_module",
        "def f():\n    import casadi",
        "import importlib\nimportlib.import_module('ocp.plan.second_route')",
    ],
)
def test_the_test_itself_sees_what_is_forbidden(line: str, tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    file.write_text(line + "\n")
    assert any(not allowed(name) for name in imported(file))
