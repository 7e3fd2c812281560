"""No command writes into a folder that holds a file it reads, whichever way the file is named. The folders are of this software
and unchanged: nothing but being an input protects them."""

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ocp.calibrate.__main__ import app as calibrate
from ocp.data import BLADE, CELL
from ocp.diagnose.__main__ import app as diagnose
from ocp.experiments.__main__ import app as experiments
from ocp.plan.__main__ import app as plan
from ocp.poses.__main__ import app as poses
from ocp.shell.output import write_marker
from ocp.simulate.__main__ import app as simulate
from ocp.update.__main__ import app as update
from robots.robot import CATALOGUE


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cell whose blade and robot lie in folders of their own, with readings, a program and a data set."""
    monkeypatch.chdir(tmp_path)
    files = {
        "blades/blade.stl": BLADE.read_bytes(),
        "robots/arm.toml": (CATALOGUE / "kr210_r2700_extra.toml").read_bytes(),
        "measured/tracker.csv": b"",
        "measured/sealed_tracker.csv": b"",
        "logs/force.csv": b"",
        "old/old.src": b"DEF old( )\r\nEND\r\n",
        "paths/path.csv": b"",
        "paths/removal.csv": b"",
    }
    text = CELL.read_text().replace('stl = "blade.stl"', 'stl = "blades/blade.stl"')
    text = text.replace('model = "kr210_r2700_extra"', 'model = "robots/arm.toml"')
    assert "blades/" in text and "robots/" in text
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    (tmp_path / "cell.toml").write_text(text)
    (tmp_path / "run").mkdir()
    shutil.copy(tmp_path / "cell.toml", tmp_path / "run" / "cell.toml")
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "cell.toml").symlink_to("../cell.toml")
    (tmp_path / "linked" / "force.csv").symlink_to("../logs/force.csv")
    for folder in ("linked", "blades", "robots", "measured", "logs", "old", "paths", "run"):
        write_marker(tmp_path / folder)
    return tmp_path


CASES = [
    (plan, ["--cell", "cell.toml", "--out", "robots"], "robots"),
    (plan, ["--cell", "cell.toml", "--out", "blades"], "blades"),
    (plan, ["blades/blade.stl", "--cell", "cell.toml", "--out", "blades"], "blades"),
    (plan, ["--cell", "cell.toml", "--path", "paths/path.csv", "--out", "paths"], "paths"),
    (plan, ["--cell", "cell.toml", "--program", "old/old.src", "--out", "old"], "old"),
    (poses, ["--cell", "cell.toml", "--out", "blades"], "blades"),
    (poses, ["--cell", "cell.toml", "--out", "robots"], "robots"),
    (simulate, ["--cell", "cell.toml", "--poses", "measured", "--out", "measured"], "measured"),
    (simulate, ["--cell", "cell.toml", "--out", "blades"], "blades"),
    (calibrate, ["measured/tracker.csv", "--cell", "cell.toml", "--out", "measured"], "measured"),
    (calibrate, ["measured/tracker.csv", "--cell", "cell.toml", "--force", "logs/force.csv", "--out", "logs"], "logs"),
    (calibrate, ["measured/tracker.csv", "--cell", "cell.toml", "--out", "robots"], "robots"),
    (update, ["logs/force.csv", "--cell", "cell.toml", "--out", "logs"], "logs"),
    (update, ["logs/force.csv", "--cell", "cell.toml", "--removal", "paths/removal.csv", "--out", "paths"], "paths"),
    (update, ["logs/force.csv", "--cell", "cell.toml", "--out", "blades"], "blades"),
    (diagnose, ["run", "--out", "run"], "run"),
    (poses, ["--cell", "linked/cell.toml", "--out", "linked"], "linked"),
    (update, ["linked/force.csv", "--cell", "cell.toml", "--out", "linked"], "linked"),
    (experiments, ["--cell", "cell.toml", "--robots", "1", "--out", "robots"], "robots"),
]


@pytest.mark.parametrize(("app", "arguments", "folder"), CASES)
def test_a_folder_that_holds_an_input_is_no_output(app, arguments, folder, folders):
    before = {p: p.read_bytes() for p in folders.rglob("*") if p.is_file()}
    told = CliRunner().invoke(app, [*arguments, "--overwrite"])
    assert told.exit_code == 2, told.stderr
    assert "an input of this run" in told.stderr and told.stderr.count("\n") == 1 and folder in told.stderr
    assert {p: p.read_bytes() for p in folders.rglob("*") if p.is_file()} == before
