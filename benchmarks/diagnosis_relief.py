"""How much of what the named effects take comes from readings, and how much from the registration, in worlds of a blind check.

    OPENBLAS_NUM_THREADS=1 PYTHONPATH=. python benchmarks/diagnosis_relief.py force25 35 46

A row a world: what was planted, what the force channel was said to hold, squares taken from readings and from the registration's
unknowns, and the readings' share (docs/diagnosis_force.md, "Relief").
"""

import json
import sys
from pathlib import Path

from ocp.blindtest.worlds.sealing import SEALED, WORLDS
from ocp.diagnose.answering import channels_of
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.engine.findings import Options
from ocp.diagnose.engine.linearisation import linearised
from ocp.diagnose.engine.search import search_and_refit
from ocp.diagnose.force.channel import ForceChannel
from ocp.effects.catalogue import library
from ocp.shell.progress import Phases


def main(check: Path, worlds: list[str]) -> None:
    """One line a world."""
    print("| world | planted | fitted | readings | registration | share |\n|---|---|---|---|---|---|")
    for world in worlds:
        label = json.loads((check / SEALED / f"{int(world):05d}.json").read_text(encoding="utf-8"))
        known = {n: e for n, e in library().items() if n not in label["withheld"]}
        options = Options(folds=False, where=False)
        channels = channels_of(read_data_set(check / WORLDS / f"{int(world):05d}"), Phases())
        problem, _ = search_and_refit(linearised(channels, known, options), known, options)
        (force,) = (c for c in problem.channels if isinstance(c, ForceChannel))
        readings, registration = force.gained()
        planted, said = ", ".join(e["effect"] for e in label["labels"]), ", ".join(a.effect.name for a in force.active)
        share = readings / (readings + registration) if said else float("nan")
        print(f"| {int(world)} | {planted} | {said} | {readings:.0f} | {registration:.0f} | {share:.2f} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
