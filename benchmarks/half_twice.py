"""What half and twice each rule of the diagnosis do to its answers: `ocp/diagnose/rules.py`, one number at a time.

    PYTHONPATH=. python benchmarks/half_twice.py OUT.json FOLDER [FOLDER ...] [--only RULE,RULE]

A probability is moved by half and twice its odds, a tuple or array as a whole. OUT.json keeps what was answered: the command goes
on where it ended. Printed are the rules that change a verdict, a name or what is written, and how many changed nothing. Figures:
docs/diagnosis.md, "Which rules".
"""

import argparse
import json
import multiprocessing
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.leave_out import labels_of, said
from ocp.diagnose import rules

TOLD = ("verdict", "named", "written", "error")


def numbers() -> list[str]:
    """Names of the rules that are numbers, in the order of their file."""
    return [name for name, value in vars(rules).items() if name.isupper() and not isinstance(value, dict | str)]


def moved(value: Any, factor: float) -> Any:
    """A rule's value times `factor`; a number between 0 and 1 by its odds, a count at least 1."""
    if isinstance(value, tuple):
        return tuple(moved(one, factor) for one in value)
    if isinstance(value, int):
        return max(1, round(value * factor))
    if isinstance(value, float) and 0.01 <= value < 1.0:
        odds = factor * value / (1.0 - value)
        return odds / (1.0 + odds)
    return value * factor


def answers(name: str, factor: float, folders: list[Path]) -> dict[str, Any]:
    """What is said of every folder with one rule moved, wherever it was imported to."""
    value = getattr(rules, name)
    for module in [m for key, m in list(sys.modules.items()) if key.startswith("ocp.diagnose")]:
        if getattr(module, name, None) is value:
            setattr(module, name, moved(value, factor))
    told = {}
    for folder in folders:
        try:
            answer = said(folder)
        except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError) as error:  # a rule may be moved out of its sense
            answer = {"error": f"{type(error).__name__}: {error}"}
        told[folder.name] = {key: answer[key] for key in TOLD if key in answer}
    return told


def main() -> None:
    """Answer as it is, then with each rule moved, and print what changed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--only", default=",".join(numbers()), help="these rules, by their names")
    given = parser.parse_args()
    out, folders, asked = given.out, given.folders, given.only.split(",")
    if unknown := set(asked) - set(numbers()):
        parser.error(f"no rules: {', '.join(sorted(unknown))}")
    kept: dict[str, dict[str, Any]] = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    variants = [("QUIET", 1.0)] + [(name, factor) for name in asked for factor in (0.5, 2.0)]
    for name, factor in variants:
        key = "as it is" if factor == 1.0 else f"{name} x {factor:g}"
        have = kept.setdefault(key, {})
        lacking = [f for f in folders if f.name not in have]
        if lacking:
            with multiprocessing.get_context("fork").Pool(1) as pool:  # a process each: nothing remembered with another value
                have |= pool.apply(answers, (name, factor, lacking))
            out.write_text(json.dumps(kept, indent=1), encoding="utf-8")
        for folder in folders:
            before, after = kept["as it is"][folder.name], have[folder.name]
            if before != after:
                print(f"{key} | {folder.name} ({labels_of(folder)}): {before} -> {after}", flush=True)
    names = [f.name for f in folders]
    still = {n for n in asked if all(kept[f"{n} x {f}"][w] == kept["as it is"][w] for f in ("0.5", "2") for w in names)}
    print(f"{len(still)} of {len(asked)} rules change nothing in {len(folders)} data sets")


if __name__ == "__main__":
    main()
