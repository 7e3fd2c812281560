"""Every number that changes a verdict of the diagnosis stands in ocp/diagnose/rules.py with its unit and its reason."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from ocp.diagnose import rules
from tests.support.house import ROOT

ROOM = ROOT / "ocp" / "diagnose"
FILE = ROOM / "rules.py"
# Constants with broken numbers that decide nothing: tolerances of solvers, shapes of features, imagined measurements, formats.
ELSEWHERE = {
    "answering.py": {"PREDICTED"},
    "engine/channel_system.py": {"SCALE"},
    "engine/evidence.py": {"RANK", "_LAMBDA"},
    "engine/kernels.py": {"SOFT", "LOADED", "RIPPLES"},
    "force/prediction.py": {"TOLERANCE"},
    "force/waves.py": {"HIGHEST", "SHORTEST"},
    "force/fit.py": {"CHANGED"},
    "foresee/design.py": {"FREE_LIMIT"},
    "foresee/next_experiment.py": {"BAR_SD", "BY_SIGNAL"},
    "foresee/planned_grinding.py": {
        "SIGMA",
        "SHARE",
        "LASTS",
        "EACH",
        "BEGIN",
        "READINGS",
        "SWAP",
        "SET",
        "IDLE",
        "LADDER",
        "HELD",
        "STEP",
    },
    "foresee/planned_tracker.py": {"PER_READING", "SETTLING", "PULL", "WARM", "WARMED", "DURATION", "TRACKER_AT", "LOW"},
    "document.py": {"SUM_TOLERANCE"},
    "verdict/location.py": {"ORDERS"},
    "joints/channel.py": {"RANK"},
    "joints/log.py": {"MOVED", "APART", "OTHER_SPEED", "SLOW", "FAR", "ALIKE", "SHARED", "WILD", "OTHER_TORQUE", "HEAVY"},
    "tracker/channel.py": {"LEVERAGE"},
    "tracker/refit.py": {"SETTLED", "RANK"},
}
FOLDERS_ELSEWHERE = {"report"}  # drawing


def assigned(path: Path) -> list[tuple[str, ast.expr, str]]:
    """All-caps names assigned at a module's top level, their values, and the text that follows each."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    found = []
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        text = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        for target in targets:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            value = node.value  # type: ignore[union-attr]
            found += [
                (n.id, value, str(text)) for n in names if isinstance(n, ast.Name) and re.fullmatch("_?[A-Z][A-Z0-9_]*", n.id)
            ]
    return found


def modules() -> list[Path]:
    return [p for p in sorted(ROOM.rglob("*.py")) if p != FILE]


@cache
def words(path: Path) -> frozenset[str]:
    """Names that a module reads, as they are or as `rules.NAME`."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    plain = {n.id for n in nodes if isinstance(n, ast.Name)}
    return frozenset(plain | {n.attr for n in nodes if isinstance(n, ast.Attribute) and ast.unparse(n.value) == "rules"})


def is_broken(value: ast.expr) -> bool:
    """Whether numbers that are no whole ones stand in a value; objects of a class are none."""
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id[0].isupper():
        return False
    return any(isinstance(c, ast.Constant) and isinstance(c.value, float) for c in ast.walk(value))


RULES = assigned(FILE)


@pytest.mark.parametrize(("name", "text"), [(n, t) for n, _, t in RULES])
def test_a_rule_says_its_unit_and_its_reason_and_is_used(name: str, text: str):
    assert re.match(r"\[[^\]]+\] \S", text), f"{name}: no unit"
    assert re.search(r"Reason:\s+\S", text), f"{name}: no reason"
    assert any(name in words(path) for path in modules()), f"{name} guards nothing"


def test_rules_are_numbers_and_stand_once():
    assert len({n for n, _, _ in RULES}) == len(RULES) > 60
    for name, _, _ in RULES:
        assert not isinstance(getattr(rules, name), str | bool), name


def test_no_threshold_stands_elsewhere():
    for path in modules():
        place = path.relative_to(ROOM)
        if place.parts[0] in FOLDERS_ELSEWHERE:
            continue
        broken = {name for name, value, _ in assigned(path) if is_broken(value)}
        assert broken == ELSEWHERE.get(str(place), set()), place
