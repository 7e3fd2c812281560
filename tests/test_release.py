"""What goes with a release: licences of what is installed, entry point, data files of the wheel."""

import re
import tomllib

from packaging.requirements import Requirement

from tests.support.house import ROOT
from tests.support.third_party import needed, page

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_dependency_stands_with_its_licence():
    written = (ROOT / "THIRD_PARTY.md").read_text()
    named = {line.split("|")[1].strip() for line in written.splitlines() if line.startswith("| ")}
    direct = {Requirement(r).name.lower() for r in PROJECT["project"]["dependencies"]}
    assert direct <= named, "run python -m tests.support.third_party"
    assert written.split("| package")[0] == page().split("| package")[0] and direct <= set(needed())


def test_every_data_file_of_the_packages_goes_into_the_wheel():
    patterns = PROJECT["tool"]["setuptools"]["package-data"]
    for package in ("robots", "trajectories", "ocp"):
        root = ROOT / package
        kept = {file for pattern in patterns.get(package, ()) for file in root.glob(pattern)}
        data = {f for f in root.rglob("*") if f.is_file() and f.suffix not in (".py", ".pyc") and "__pycache__" not in f.parts}
        assert data <= kept, sorted(map(str, data - kept))


def test_the_version_is_one_and_stands_first_among_the_changes():
    version = PROJECT["project"]["version"]
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^## (\S+),", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1] == version
