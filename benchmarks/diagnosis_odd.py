"""Odd tracker campaigns through the diagnosis: each ends in a diagnosis or in one sentence, never in a traceback.

    python benchmarks/diagnosis_odd.py [seeds]

Prints a line a campaign: seconds, how it ended, what was said. Ends with 1 where one of them ended in a traceback.
"""

import sys
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from ocp.diagnose.interface import diagnose
from robots.errors import BadInput, Infeasible
from tests.support.odd_campaigns import written


def main() -> int:
    """The number of campaigns that ended in a traceback or a warning, at most 1."""
    warnings.simplefilter("error", RuntimeWarning)
    counts: Counter[str] = Counter()
    for seed in range(int(sys.argv[1]) if len(sys.argv) > 1 else 1):
        with TemporaryDirectory() as scratch:
            for name, folder in written(Path(scratch), seed=seed):
                begin = time.time()
                try:
                    result = diagnose(folder, out=folder / "out")
                    how, said = "diagnosed", f"{result.answer.diagnosis.verdict}: {result.line.split(': ', 1)[1]}"
                except (BadInput, Infeasible) as error:
                    how, said = "sentence", str(error)
                except Exception:
                    how, said = "TRACEBACK", traceback.format_exc()
                counts[how] += 1
                shown = said if how == "TRACEBACK" else said[:150]
                print(f"{seed} {name:36s} {time.time() - begin:5.1f} s  {how:10s} {shown}", flush=True)
    print(", ".join(f"{n} {how}" for how, n in counts.items()))
    return int(counts["TRACEBACK"] > 0)


if __name__ == "__main__":
    sys.exit(main())
