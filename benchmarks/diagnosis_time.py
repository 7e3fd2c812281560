"""How long `python -m ocp.diagnose` takes: wall clock and processor of the whole command, and its phases.

    python benchmarks/diagnosis_time.py DATA_SET [DATA_SET ..] [-n 5]

On a shared machine the least of several runs is told: nothing makes a run faster than it is, much makes it slower. Phases are
processor seconds of the main process; the report is drawn by another one meanwhile, `report` is the wall clock waited for it.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PHASES = "import sys; sys.path.insert(0, sys.argv[3]); import diagnosis_time; diagnosis_time.phases(sys.argv[1], sys.argv[2])"


def phases(folder: str, out: str) -> None:
    """Print seconds by phase of one diagnosis in this process as JSON."""
    from ocp.diagnose.answering import write_diagnosis
    from ocp.shell.progress import Phases

    seconds = {"start and imports": time.process_time()}

    class Timed(Phases):
        @contextmanager
        def phase(self, name: str, total: int | None = None) -> Iterator:
            clock = time.perf_counter if name == "report" else time.process_time
            before = clock()
            with super().phase(name, total) as advance:
                yield advance
            seconds[name] = clock() - before

    write_diagnosis(Path(folder), Path(out), True, Timed())
    print(json.dumps(seconds))


def once(folder: Path, out: str) -> tuple[float, float]:
    """Wall clock and processor seconds of one command, all its processes."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "ocp.diagnose", str(folder), "--out", out, "--overwrite"]
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter() - start, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("-n", type=int, default=5, help="runs of each")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out, here = str(Path(temporary) / "out"), str(Path(__file__).parent)
        for folder in asked.folders:
            runs = [once(folder, out) for _ in range(asked.n)]
            command = [sys.executable, "-c", PHASES, str(folder), out, here]
            told = [json.loads(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(asked.n)]
            parts = ", ".join(f"{name} {min(t[name] for t in told):.2f}" for name in told[0])
            wall, processor = (min(figures) for figures in zip(*runs, strict=True))
            print(f"{folder.name}: wall {wall:.1f} s, processor {processor:.1f} s; {parts}", flush=True)


if __name__ == "__main__":
    main()
