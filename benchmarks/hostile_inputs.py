"""Ten thousand hostile inputs for every reader, each within 10 s and 1 GB, in child processes that may die of it.

    python -m benchmarks.hostile_inputs [--count 10000] [--seed 1] [--reader cell.toml] [--out DIR]

Every input is made from seed, reader and number (tests/support/hostile_inputs.py), so that one that was neither read nor refused
in a sentence can be made again: its number is printed, its bytes are kept in DIR.
"""

import argparse
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.support.hostile_inputs import BYTES, READERS, SECONDS, HostileReader, lay, mutant, outcome, texts

TEXT_SHARE = 10  # one input of ten is hypothesis'


def kept(out: Path, reader: HostileReader, number: int) -> Path:
    return out / f"{reader.kind.replace('/', '_')}.{number}"


def child(reader: HostileReader, seed: int, first: int, count: int, folder: Path, out: Path) -> None:
    """Inputs `first` .. `count` - 1, a line each: number, how it went. The alarm's default ends the process, foreign code too."""
    lay(reader, folder)
    outcome(reader, folder, mutant(reader, seed, 0))  # what is loaded late is loaded now
    used = int(next(line for line in Path("/proc/self/status").open() if line.startswith("VmSize")).split()[1]) * 1024
    resource.setrlimit(resource.RLIMIT_AS, (used + BYTES, used + BYTES))

    def tell(number: int, came: str, data: bytes) -> None:
        signal.alarm(0)
        if came not in ("worked", "refused"):
            kept(out, reader, number).write_bytes(data)
        print(f"{number}\t{came}", flush=True)

    mutants = count - count // TEXT_SHARE
    for number in range(first, mutants):
        print(f"{number}\t", flush=True)
        signal.alarm(int(SECONDS) + 5)
        data = mutant(reader, seed, number)
        tell(number, outcome(reader, folder, data), data)
    numbers = iter(range(max(first, mutants), 10 * count))
    texts(reader, folder, count - max(first, mutants), seed + first, lambda came, data: tell(next(numbers), came, data))


def tried(reader: HostileReader, seed: int, count: int, out: Path) -> tuple[Counter[str], list[str]]:
    """Counts of worked, refused and anything else; what else came, in words."""
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    first = 0
    while first < count:
        with tempfile.TemporaryDirectory() as folder:
            asked = [
                "--child",
                folder,
                "--reader",
                reader.kind,
                "--seed",
                str(seed),
                "--count",
                str(count),
                "--first",
                str(first),
            ]
            asked += ["--out", str(out)]
            command = [sys.executable, "-m", "benchmarks.hostile_inputs", *asked]
            with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
                assert process.stdout is not None
                number, came = first, ""
                for line in process.stdout:
                    word, _, came = line.rstrip("\n").partition("\t")
                    number = int(word)
                    if came:
                        counts[came if came in ("worked", "refused") else "anything else"] += 1
                        if came not in ("worked", "refused"):
                            wrong.append(f"{reader.kind}, number {number}: {came}")
            if process.returncode != 0 or number + 1 < count:
                counts["anything else"] += 1
                wrong.append(f"{reader.kind}, number {number}: the process ended with {process.returncode}")
                kept(out, reader, number).write_bytes(mutant(reader, seed, number))
        first = number + 1
    return counts, wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--reader", help="only this kind of file")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--child", type=Path)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "hostile_inputs")
    asked = parser.parse_args()
    chosen = [reader for reader in READERS if asked.reader in (None, reader.kind)]
    if asked.child is not None:
        child(chosen[0], asked.seed, asked.first, asked.count, asked.child, asked.out)
        return
    asked.out.mkdir(exist_ok=True)
    print("| file and reader | inputs | worked | refused | anything else | s |\n|---|---|---|---|---|---|")
    failed: list[str] = []
    for reader in chosen:
        begun = time.perf_counter()
        counts, wrong = tried(reader, asked.seed, asked.count, asked.out)
        row = [reader.kind, counts.total(), counts["worked"], counts["refused"], counts["anything else"]]
        print(f"| {' | '.join(map(str, row))} | {time.perf_counter() - begun:.0f} |", flush=True)
        failed += wrong
    for line in failed:
        print(line)
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
