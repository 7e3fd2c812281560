"""Which rules of the diagnosis data sets need: each is answered as it is, then without every rule that did something there.

    PYTHONPATH=. python benchmarks/leave_out.py OUT.json FOLDER [FOLDER ...]

A rule that did nothing in a data set cannot have changed its answer, so most need no second answer. Printed is what was said, and
without each rule that did something where that differs. Figures: docs/diagnosis.md, "Which rules".
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from ocp.blindtest.answers import FAULTS
from ocp.blindtest.scoring import decided_names
from ocp.blindtest.worlds.sealing import WITHHELD
from ocp.diagnose.answering import answer_of
from ocp.diagnose.document import document_of
from ocp.diagnose.engine import search
from ocp.diagnose.verdict import diagnosis
from ocp.effects.catalogue import library
from ocp.shell.progress import Phases

Did = Callable[[Any, tuple[Any, ...]], bool]
# Rule: the module and the function that is it, what it is without the rule, whether a result of it did something.
RULES: dict[str, tuple[Any, str, Callable[..., Any], Did]] = {
    "outliers": (search, "outliers_rechecked", lambda *a: None, lambda found, a: found is not None),
    "suspects": (diagnosis, "suspected", lambda *a: (), lambda found, a: bool(found)),
    "held-out names": (diagnosis, "misses_far_more_than_noise", lambda *a: False, lambda found, a: bool(found)),
}
ORIGINAL = {rule: getattr(module, name) for rule, (module, name, _, _) in RULES.items()}


@contextmanager
def watched(did: set[str]) -> Iterator[None]:
    """Rules that do something are noted in `did`."""

    def watching(rule: str, original: Callable[..., Any], acted: Did) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            found = original(*arguments)
            if acted(found, arguments):
                did.add(rule)
            return found

        return call

    patches = []
    for rule, (module, name, _, acted) in RULES.items():
        patches.append(patch.object(module, name, watching(rule, ORIGINAL[rule], acted)))
    for one in patches:
        one.start()
    try:
        yield
    finally:
        for one in patches:
            one.stop()


def said(folder: Path) -> dict[str, Any]:
    """What an answer says, rounded to what matters."""
    withheld = (folder / WITHHELD).read_text(encoding="utf-8").split() if (folder / WITHHELD).is_file() else []
    try:
        answer = answer_of(folder, Phases(), {n: e for n, e in library().items() if n not in withheld})
    except FAULTS as error:
        return {"error": str(error)}
    document = document_of(answer).model_dump(mode="json", by_alias=True)
    gaps = {name: gap["shrinkage"] for name, gap in document["gap"].items()}
    return {
        "verdict": document["verdict"],
        "named": sorted(map(str, decided_names(document))),
        "likely": {
            f"{r['effect']}:{r['joint'] or 0}": round(r["probability"], 1) for r in document["ranking"] if r["probability"] > 0.15
        },
        "p_unknown": round(document["p_unknown"], 1),
        "written": sorted(f"{a.effect.name}:{a.joint}" for a in answer.written),
        "classes": sorted(sorted(map(str, c)) for c in answer.diagnosis.classes),
        "promised": {name: s and round(s["predicted"], 2) for name, s in gaps.items()},
    }


def labels_of(folder: Path) -> str:
    """What was planted, where that stands beside."""
    file = folder / "labels" / "labels.json"
    told = json.loads(file.read_text(encoding="utf-8"))["labels"] if file.is_file() else None
    return "?" if told is None else " ".join(f"{one['effect']}:{one.get('joint') or 0}" for one in told) or "nothing"


def main() -> None:
    """Answer, leave out, print."""
    out, folders = Path(sys.argv[1]), [Path(a) for a in sys.argv[2:]]
    rows: list[dict[str, Any]] = []
    for folder in folders:
        did: set[str] = set()
        begin = time.process_time()
        with watched(did):
            whole = said(folder)
        row: dict[str, Any] = {"folder": folder.name, "planted": labels_of(folder), "whole": whole, "without": {}}
        row["seconds"] = round(time.process_time() - begin, 1)
        for rule in sorted(did):
            module, name, without, _ = RULES[rule]
            with patch.object(module, name, without):
                row["without"][rule] = said(folder)
        rows.append(row)
        changed = [rule for rule, other in row["without"].items() if other != whole]
        print(
            f"{row['folder']} {row['seconds']} s | {row['planted']} | {whole} | did: {', '.join(sorted(did)) or 'none'}",
            flush=True,
        )
        for rule in changed:
            print(f"    without {rule}: " + str({k: v for k, v in row["without"][rule].items() if whole.get(k) != v}), flush=True)
        out.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
