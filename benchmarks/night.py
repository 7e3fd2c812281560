"""`python benchmarks/night.py [BLADES] [--jobs N] [--whole-blade] [--out FOLDER]`: a shop's night, with what goes wrong in one.

Blades of one kind as a scanner would give them, each bent, twisted and thickened a little of its own, and every tenth one broken.
After a fifth of them the process that works is killed, after two fifths the command is interrupted and called again. Prints the
figures of docs/night.md: seconds a blade, memory of the command and of its workers in the first and the last third, what handing
out and writing cost, and whether anything was done twice or lost.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from ocp.data import BLADE, CELL
from ocp.shell.cache import sha256
from tests.support.blade_samples import write_stl
from tests.support.small_plan import small_cell
from trajectories.blade import read_blade


def scans(folder: Path, count: int) -> list[Path]:
    """The bundled blade bent by 0.2 mm at its tip, twisted by 0.3 deg and thickened by half a percent, one standard deviation."""
    blade, rng, files = read_blade(BLADE), np.random.default_rng(0), []
    top = float(blade.vertices[:, 2].max())
    for k in range(count):
        file = folder / f"blade_{k:03d}.stl"
        bend, twist, thick = rng.normal(size=3) * [2e-4, np.radians(0.3), 5e-3]
        x, y, z = blade.vertices.T
        up = np.clip(z / top, 0.0, 1.0)
        c, s = np.cos(twist * up), np.sin(twist * up)
        y = y * (1 + thick * up) + bend * up**2
        write_stl(file, np.column_stack([c * x - s * y, s * x + c * y, z]), blade.faces)
        if k % 10 == 9:
            file.write_text("solid lost\nendsolid\n")
        files.append(file)
    return files


def processes(session: int) -> dict[int, tuple[bool, float]]:
    """By number: whether it is a worker, and the MB that it holds."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and int((entry / "stat").read_text().rpartition(")")[2].split()[3]) == session:
                size = next(line.split()[1] for line in (entry / "status").read_text().splitlines() if "VmRSS" in line)
                found[int(entry.name)] = b"spawn_main" in (entry / "cmdline").read_bytes(), int(size) / 1e3
        except (OSError, StopIteration):
            pass
    return found


def rows(out: Path) -> list[dict]:
    table = out / "night.json"
    return json.loads(table.read_text())["blades"] if table.is_file() else []


def night(command: list[str], out: Path, blades: int, killed_at: int, told_at: int) -> tuple[int, list[tuple[int, float, float]]]:
    """Run the command; kill a worker and interrupt it where it has so many rows. Its exit code and (rows, MB, MB) seen."""
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    seen = []
    while process.poll() is None:
        time.sleep(1.0)
        done = len(rows(out))
        running = processes(process.pid)
        seen.append(
            (done, *(max((mb for works, mb in running.values() if works is kind), default=0.0) for kind in (False, True)))
        )
        working = [number for number, (works, _) in running.items() if works]
        if 0 <= killed_at <= done and working:
            os.kill(working[0], signal.SIGKILL)
            killed_at = blades + 1
        if 0 <= told_at <= done:
            os.kill(process.pid, signal.SIGINT)
            told_at = blades + 1
    return process.returncode, seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("blades", type=int, nargs="?", default=50)
    parser.add_argument("--jobs", default="0")
    parser.add_argument("--whole-blade", action="store_true", help="all lines of both sides instead of three")
    parser.add_argument("--out", type=Path, default=Path("shop"))
    asked = parser.parse_args()
    asked.out.mkdir(parents=True)
    files = scans(asked.out, asked.blades)
    cell = CELL if asked.whole_blade else small_cell(asked.out / "cell")
    out = asked.out / "night"
    command = [sys.executable, "-m", "ocp.plan", *map(str, files), "--cell", str(cell), "--step", "2", "--jobs", asked.jobs]
    command += ["--out", str(out)]
    os.environ["PYTHONPATH"] = sys.path[0]
    began = time.monotonic()
    first, seen = night(command, out, asked.blades, asked.blades // 5, 2 * asked.blades // 5)
    before = {row["name"]: row for row in rows(out)}
    hashes = {name: sha256(out / name / "plan.json") for name, row in before.items() if row["link"]}
    code, more = night(command, out, asked.blades, -1, -1)
    seconds = time.monotonic() - began
    found = {row["name"]: row for row in rows(out)}
    took = [row["seconds"] for row in found.values() if row["link"]]
    print(f"exit {first} when interrupted with {len(before)} rows, then {code}; {len(found)} rows, {len(took)} plans")
    print(f"rows of before unchanged: {all(found[name] == row for name, row in before.items())}, their plans", end=" ")
    print(all(sha256(out / name / "plan.json") == value for name, value in hashes.items()))
    print(f"in all {seconds:.0f} s; a plan {np.median(took):.1f} s median, {min(took):.1f} to {max(took):.1f}", end="; ")
    print(f"sum of rows {sum(row['seconds'] for row in found.values()):.0f} s")
    for name, part in (("first third", [s for s in seen if s[0] <= asked.blades / 3]), ("last third", more[len(more) // 2 :])):
        print(f"{name}: command {max(s[1] for s in part):.0f} MB, a worker {max(s[2] for s in part):.0f} MB")
    print(f"folder {sum(f.stat().st_size for f in out.rglob('*') if f.is_file()) / 1e6:.0f} MB")
    began = time.monotonic()
    code = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False).returncode
    print(f"called once more: exit {code} after {time.monotonic() - began:.1f} s")


if __name__ == "__main__":
    main()
