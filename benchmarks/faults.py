"""Ctrl-C at random moments of every command, and what is left: `python benchmarks/faults.py [RUNS] [SEED] [COMMAND]`.

Each command runs RUNS times on small inputs; SIGINT comes at a moment drawn between its start and its usual end, for every third
run twice. Counted: exit code 130 within two seconds (or 0 where it had ended), the folder whole or absent, nothing beside it, no
process of it left. Prints a table and the seed; exit code 1 where anything else happened.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from ocp.data import CELL  # noqa: E402
from tests.support.small_plan import STEP, planned, small_cell  # noqa: E402

HEAD = """seed {seed}, {runs} runs a command

| command | runs | interrupted | ended before | faults | slowest end, s |
|---|---|---|---|---|---|"""


def commands(folder: Path) -> dict[str, list[str]]:
    """Arguments of every command, each on small inputs in `folder`."""
    small_cell(folder)
    told = planned(folder, "--cell", "cell.toml", "--out", "plan", *STEP)
    assert told.code == 0, told.err
    run("ocp.simulate", folder, "--poses", "60", "--out", "measured")
    run("ocp.simulate", folder, "plan", "--poses", "0", "--ladder", "none", "--out", "ground")
    return {
        "ocp.plan": ["--cell", "cell.toml", *STEP],
        "ocp.poses": ["--cell", str(CELL), "-n", "20"],
        "ocp.simulate": ["plan", "--poses", "0", "--ladder", "none"],
        "ocp.calibrate": ["measured/tracker.csv", "--cell", "measured/cell.toml"],
        "ocp.update": ["ground/force.csv", "--cell", "ground/cell.toml"],
        "ocp.diagnose": ["measured"],
        "ocp.experiments": ["--robots", "2", "--mount", "flange"],
    }


def run(module: str, folder: Path, *arguments: str) -> float:
    begin = time.monotonic()
    subprocess.run([sys.executable, "-m", module, *arguments], cwd=folder, env=environment(), check=True, capture_output=True)
    return time.monotonic() - begin


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def processes(session: int) -> int:
    count = 0
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        count += int(fields[3]) == session and fields[0] != "Z"
    return count


def interrupted(module: str, arguments: list[str], folder: Path, after: float, twice: bool) -> tuple[str, float]:
    """What came of one run, `as it should` or the fault in words, and the seconds from the interrupt to the end."""
    out = folder / "out" / "result"
    process = subprocess.Popen(
        [sys.executable, "-m", module, *arguments, "--out", str(out)],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    time.sleep(after)
    begin = time.monotonic()
    ended = process.poll() is not None
    if not ended:
        os.kill(process.pid, signal.SIGINT)
        if twice:
            time.sleep(0.05)
            os.kill(process.pid, signal.SIGINT) if process.poll() is None else None
    try:
        _, err = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        return "did not end", 30.0
    took = time.monotonic() - begin
    left = sorted(p.name for p in (folder / "out").iterdir()) if (folder / "out").exists() else []
    whole = (out / ".written.json").exists()
    fault = ""
    if process.returncode not in (0, 130) or (process.returncode == 130 and "interrupted" not in err):
        fault = f"exit code {process.returncode}: {err.strip()[-200:]}"
    elif process.returncode == 130 and took > 2.0:
        fault = f"took {took:.1f} s"
    elif left != (["result"] if process.returncode == 0 else []) or whole != (process.returncode == 0):
        fault = f"left {left}"
    elif processes(process.pid):
        fault = "left a process"
    subprocess.run(["rm", "-rf", str(folder / "out")], check=True)
    return fault or ("ended before" if process.returncode == 0 else "as it should"), took


def main() -> int:
    runs, seed, only = (*sys.argv[1:4], *("20", "1", "ocp.")[len(sys.argv) - 1 :])
    return tried(int(runs), int(seed), only)


def tried(runs: int, seed: int, only: str) -> int:
    """Try the commands whose name begins with `only`; print the table, return the exit code."""
    rng, faults = np.random.default_rng(seed), 0
    print(HEAD.format(seed=seed, runs=runs))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for module, arguments in commands(folder).items():
            if not module.startswith(only):
                continue
            for _ in range(2):  # once to fill the cache
                usual = run(module, folder, *arguments, "--out", "out/result", "--overwrite")
            subprocess.run(["rm", "-rf", str(folder / "out")], check=True)
            told = [interrupted(module, arguments, folder, rng.uniform(0.0, usual), k % 3 == 2) for k in range(runs)]
            good, early = sum(t == "as it should" for t, _ in told), sum(t == "ended before" for t, _ in told)
            bad = [t for t, _ in told if t not in ("as it should", "ended before")]
            slowest = max((s for t, s in told if t == "as it should"), default=0.0)
            print(
                f"| {module} | {runs} | {good} | {early} | {len(bad)} | {slowest:.2f} |",
                *bad[:3],
                sep="\n" if bad else "",
                flush=True,
            )
            faults += len(bad)
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
