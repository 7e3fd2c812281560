"""Answers to blind worlds: the diagnosis as `python -m ocp.diagnose` makes it, and those of its rivals.

Nothing here reads a label: a world's folder holds measurements and the conditions to predict, and, where an effect's family is
to be left out of the library, its name.
"""

import json
import time
import traceback
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.scoring.rivals import rival_answers
from ocp.blindtest.worlds.sealing import WITHHELD, Check, write_whole
from ocp.diagnose.answering import answer_of, predict_sealed
from ocp.diagnose.document import document_of
from ocp.diagnose.engine.channel_system import Sealed
from ocp.effects.catalogue import library
from ocp.shell.progress import Phases
from robots.errors import BadInput, Infeasible

FAULTS = (BadInput, Infeasible, ArithmeticError, ValueError, TypeError, LookupError, AssertionError, np.linalg.LinAlgError)
"""What makes a world an error of the answer, counted as wrong, instead of ending the check."""


def make_answer(check: Check, name: str) -> str:
    """Answer a world that has none yet; returns its verdict, or what went wrong."""
    path = check.answer(name)
    if not path.is_file():
        write_whole(path, json.dumps(answer_world(check.world(name))) + "\n")
    return str(json.loads(path.read_text(encoding="utf-8")).get("error") or "answered")


def answer_world(folder: Path) -> dict[str, Any]:
    """Everything that is said about a world. A refusal is an answer too; it counts as wrong."""
    withheld = _withheld(folder)
    known = {name: effect for name, effect in library().items() if name not in withheld}
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        answer = answer_of(folder, Phases(), known)
    except FAULTS as error:
        return {"error": _fault(error)}
    predicted: dict[str, Any] = {}
    fault = None
    try:
        predicted = {signal: _rounded(sealed) for signal, sealed in predict_sealed(answer).items()}
    except FAULTS as error:
        fault = _fault(error)
    seconds = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, **answer.seconds}
    d = answer.diagnosis
    named = rival_answers(d.baseline, known)
    return {
        "error": None,
        "document": document_of(answer).model_dump(mode="json", by_alias=True),
        "screened": [[s.name.effect, s.name.joint, s.smallest, s.p_value] for s in d.screened],
        "because": [*d.unknown_reasons],
        "predictions": predicted.get("tracker"),
        **({"predictions_force": predicted["force"]} if "force" in predicted else {}),
        "prediction_error": fault,
        "rivals": {method: asdict(one) for method, one in named.items()},
        "seconds": seconds,
    }


def _rounded(sealed: Sealed) -> dict[str, Any]:
    """Predictions as JSON has them."""
    parts = {"baseline": sealed.baseline, "corrected": sealed.corrected, "sigma": sealed.sigma}
    return {name: values.round(8).tolist() for name, values in parts.items()}


def _fault(error: BaseException) -> str:
    """An error and where it came from."""
    place = traceback.extract_tb(error.__traceback__)
    own = next((f for f in reversed(place) if Path(f.filename).is_file()), place[-1])
    return f"{type(error).__name__}: {error} ({Path(own.filename).name}:{own.lineno})"


def _withheld(folder: Path) -> frozenset[str]:
    """Names of effects that the library may not hold for this world."""
    path = folder / WITHHELD
    return frozenset(path.read_text(encoding="utf-8").split()) if path.is_file() else frozenset()
