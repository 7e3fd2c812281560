"""`python benchmarks/record_hashes.py CHECKOUT OUT`: hashes of what every command writes, so that moves are seen to be moves.

Runs plan, poses, simulate, calibrate and diagnose of the checkout on the same inputs, and writes OUT/hashes.json. Inputs that the
commands make themselves (a path, a program, a calibrated cell) stand in OUT/inputs; `--inputs OLD/inputs` takes those of an
earlier run. plan.json tells the versions of packages; text of no other file changes from run to run.
"""

import argparse
import concurrent.futures
import csv
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
WORLDS = (
    "force_no_effect",
    "force_two_effects",
    "force_wheel_wear",
    "tracker_backlash",
    "tracker_gravity_compensator",
    "tracker_no_effect",
    "tracker_outside_catalogue",
    "tracker_two_effects",
)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("checkout", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--inputs", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="*", help="beginnings of the commands' labels, as plan_lin or diagnose")
    parser.add_argument("--against", type=Path, help="hashes.json of an earlier run: tell the files that differ")
    options = parser.parse_args()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    runner = Runner(options.checkout.resolve(), out)
    inputs = (options.inputs or out / "inputs").resolve()
    if not inputs.is_dir():
        make_inputs(runner, inputs)
    jobs = [job for job in commands(inputs) if not options.only or job[0].startswith(tuple(options.only))]
    with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(lambda job: runner.run(job[0], *job[1], "--out", job[0]), jobs))
    found = {job: hashes(out / job) for job, _ in jobs}
    (out / "hashes.json").write_text(json.dumps(found, indent=1) + "\n")
    print(f"{out / 'hashes.json'}: {sum(map(len, found.values()))} files of {len(found)} commands")
    if options.against:
        tell_differences(json.loads(options.against.read_text()), found)


class Runner:
    """Runs modules of a checkout in the folder `out`, with a cache of their own."""

    def __init__(self, checkout: Path, out: Path) -> None:
        self.checkout, self.out = checkout, out

    def run(self, label: str, module: str, *arguments: str | Path) -> None:
        environment = os.environ | {"PYTHONPATH": str(self.checkout), "GRINDPLAN_CACHE": str(self.out / "cache")}
        command = [sys.executable, "-m", module, *map(str, arguments)]
        done = subprocess.run(command, cwd=self.out, env=environment, capture_output=True, text=True)
        (self.out / f"{label.replace('/', '_')}.txt").write_text(f"{done.returncode}\n{done.stdout}\n{done.stderr}")
        print(label, done.returncode, done.stdout.strip()[:100] or done.stderr.strip()[-200:], flush=True)


def make_inputs(runner: Runner, inputs: Path) -> None:
    """A plan, its contact points as path.csv, its LIN program, a calibrated cell, and the data sets of two real robots."""
    inputs.mkdir(parents=True)
    real = SHARED / "real"
    ur5 = real / "ur5_tracker" / "3D_UR5_uncalibrated_grid_cleaned.csv"
    kr300 = real / "kr300_secondary_encoder" / "FF_A.mat"
    runner.run("inputs/ur5", "tests.support.published_campaigns", "ur", ur5, "--out", inputs / "ur5")
    runner.run("inputs/kr300", "tests.support.published_campaigns", "kr300", kr300, "--out", inputs / "kr300")
    runner.run("inputs/plan", "ocp.plan", "--out", inputs / "plan")
    runner.run("inputs/lin", "ocp.plan", "--kind", "lin", "--out", inputs / "lin")
    runner.run("inputs/run", "ocp.simulate", inputs / "plan", "--seed", "1", "--out", inputs / "run")
    runner.run(
        "inputs/calibration",
        "ocp.calibrate",
        inputs / "run" / "tracker.csv",
        "--force",
        inputs / "run" / "force.csv",
        "--cell",
        inputs / "run" / "cell.toml",
        "--out",
        inputs / "calibration",
    )
    columns = ["line", "px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz"]
    with (inputs / "plan" / "plan.csv").open() as source, (inputs / "path.csv").open("w", newline="") as target:
        rows = [row for row in csv.DictReader(source) if row["contact"] == "1" and int(row["line"]) > 8]
        table = csv.DictWriter(target, columns, extrasaction="ignore", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def commands(inputs: Path) -> list[tuple[str, tuple[str | Path, ...]]]:
    """Folder to write and command, the long ones first."""
    worlds = SHARED / "worlds"
    tracker, force = worlds / "tracker_two_effects", worlds / "force_wheel_wear"
    readings = (force / "tracker.csv", "--force", force / "force.csv")
    programs = sorted((inputs / "lin").glob("*.src"), key=lambda path: len(path.name))
    return [
        ("plan_axis", ("ocp.plan",)),
        ("plan_calibrated", ("ocp.plan", "--cell", inputs / "calibration" / "cell.toml")),
        ("diagnose_force_two_effects", ("ocp.diagnose", worlds / "force_two_effects")),
        ("plan_cartesian", ("ocp.plan", "--kind", "cartesian")),
        ("plan_lin", ("ocp.plan", "--kind", "lin")),
        ("plan_path", ("ocp.plan", "--path", inputs / "path.csv")),
        ("plan_program", ("ocp.plan", "--program", programs[0])),
        ("poses", ("ocp.poses", "-n", "40")),
        ("simulate", ("ocp.simulate", inputs / "plan", "--seed", "3")),
        ("calibrate_ur5", ("ocp.calibrate", inputs / "ur5" / "tracker.csv", "--cell", inputs / "ur5" / "cell.toml")),
        ("calibrate_tracker", ("ocp.calibrate", tracker / "tracker.csv", "--cell", tracker / "cell.toml")),
        ("calibrate_force", ("ocp.calibrate", *readings, "--cell", force / "cell.toml")),
        ("diagnose_kr300", ("ocp.diagnose", inputs / "kr300")),
        *[(f"diagnose_{w}", ("ocp.diagnose", worlds / w)) for w in WORLDS if w != "force_two_effects"],
    ]


def tell_differences(before: dict[str, dict[str, str]], after: dict[str, dict[str, str]]) -> None:
    """Files of the same commands that differ, plan.json with its versions among them."""
    for job, files in after.items():
        names = sorted(set(files) | set(before[job]))
        differ = [name for name in names if files.get(name) != before[job].get(name)]
        print(f"{job}: {'the same bytes' if not differ else ', '.join(differ)}")


def hashes(folder: Path) -> dict[str, str]:
    """Hash of every file of a folder by its path in it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


if __name__ == "__main__":
    main()
