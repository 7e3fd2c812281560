"""Answers to blind worlds: the diagnosis as `python -m ocp.diagnose` makes it, and those of its rivals.

Nothing here reads a label: a world's folder holds measurements and the conditions to predict, and, where an effect's family is
to be left out of the library, its name.

The rivals are what the diagnosis has to beat, on the same data and the same library: four usual ways to name an effect. All work
on the linear system of the believed cell refitted: white residual y (N,) and columns of every effect. Projected means after the
refitted parameters were taken out of both, y = M r and C = M c (docs/diagnosis.md, eq. 2).

* single: the one number that, freed, takes away most of y^T y.
* stepwise: forward choice of effects while N ln(|y - C a|^2 / N) + m ln N falls (Schwarz 1978).
* sparse: least squares with a penalty on the sum of |a| (Tibshirani 1996), its weight by the same criterion.
* unprojected: score test of each effect on the residual as it stands, columns not projected.
"""

import json
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc  # scipy.stats has it too, and takes a third of what this command imports

from ocp.blindtest.worlds.recipes import Recipe
from ocp.blindtest.worlds.sealing import WITHHELD, Check
from ocp.diagnose.answering import answer_of, predict_sealed
from ocp.diagnose.document import document_of
from ocp.diagnose.engine.channel_system import Channel
from ocp.diagnose.engine.evidence import stack
from ocp.diagnose.engine.linearisation import stacked_columns
from ocp.effects.catalogue import library
from ocp.effects.effect import Effect
from ocp.shell.executor import named_below
from ocp.shell.progress import Phases
from robots.errors import BadInput, Infeasible
from robots.pose import Array
from robots.tracker_readings import Index

LEVEL = 0.01  # false alarms that a score test allows itself over all it tries
MOST_STEPS, MOST_NONZERO, SCREENED, PATH, SWEEPS = 6, 12, 600, 24, 120
RANKED = 10  # names that are reported
Name = tuple[str, int]


@dataclass(frozen=True)
class RivalAnswer:
    """An answer: names in order of belief, and those it decides for (none: no effect)."""

    ranking: tuple[Name, ...]
    named: tuple[Name, ...]


@dataclass(frozen=True, eq=False)
class RivalColumns:
    """Names of all families, their white columns (N, V, m) and white residual (N,), raw and with the nuisance projected out;
    freedom of the rows."""

    names: tuple[Name, ...]
    raw: tuple[Array, ...]
    residual: Array
    columns: tuple[Array, ...]
    y: Array
    freedom: int


def rival_columns(channels: Sequence[Channel], library: Mapping[str, Effect]) -> RivalColumns:
    """Everything of the library that any of the channels sees."""
    stacked = stack(tuple(channels), np.zeros(sum(len(c.system.residual) for c in channels)))
    names, raw, columns = [], [], []
    for effect in library.values():
        for joint in effect.places:
            C, scans = stacked_columns(channels, effect, joint, None)
            if not scans:
                continue
            C = C * np.asarray(effect.prior_sd, float)
            names.append((effect.name, joint))
            raw.append(C)
            columns.append(stacked.apply(C.reshape(len(C), -1)).reshape(C.shape))
    residual = np.concatenate([c.system.residual for c in channels])
    return RivalColumns(tuple(names), tuple(raw), residual, tuple(columns), stacked.y, stacked.freedom)


def single(c: RivalColumns) -> RivalAnswer:
    """The one coefficient that takes away most."""
    each = [np.einsum("nvi,n->vi", C, c.y) ** 2 / np.maximum(np.einsum("nvi,nvi->vi", C, C), 1e-12) for C in c.columns]
    gained = np.array([one.max() for one in each])
    tried = sum(C.shape[1] * C.shape[2] for C in c.columns)
    order = np.argsort(-gained)
    sure = chdtrc(1, gained[order[0]]) * tried < LEVEL
    return _named(c, order, order[:1] if sure else ())


def unprojected(c: RivalColumns) -> RivalAnswer:
    """Smallest p-value of all variants, the price of trying them paid."""
    with np.errstate(divide="ignore"):  # below what a number can be: the first of several such wins
        logs = [float(np.log(chdtrc(C.shape[2], gains(C, c.residual).max())) + np.log(C.shape[1])) for C in c.raw]
    order = np.argsort(logs)
    sure = logs[order[0]] + np.log(len(c.names)) < np.log(LEVEL)
    return _named(c, order, order[:1] if sure else ())


def stepwise(c: RivalColumns) -> RivalAnswer:
    """Forward choice by the Bayesian information criterion."""
    y, columns = c.y, list(c.columns)
    chosen: list[int] = []
    order: list[int] = []
    for _ in range(MOST_STEPS):
        left = float(y @ y)
        fall = np.full(len(columns), -np.inf)
        best = np.zeros(len(columns), int)
        for k, C in enumerate(columns):
            gained = gains(C, y)
            best[k] = int(np.argmax(gained))
            rest = max(left - float(gained.max()), 1e-9)
            fall[k] = c.freedom * np.log(left / rest) - C.shape[2] * np.log(c.freedom)
        fall[chosen] = -np.inf
        order = [int(k) for k in np.argsort(-fall)]
        pick = order[0]
        if fall[pick] <= 0:
            break
        chosen.append(pick)
        Q, _ = np.linalg.qr(columns[pick][:, best[pick]])
        y = y - Q @ (Q.T @ y)
        columns = [C - np.tensordot(Q, np.tensordot(Q.T, C, 1), 1) for C in columns]
    return _named(c, list(dict.fromkeys(chosen + order)), chosen)


def sparse(c: RivalColumns) -> RivalAnswer:
    """Penalised least squares on all columns at once, down a path of weights; the weight with the least criterion decides."""
    family = np.concatenate([np.full(C.shape[1] * C.shape[2], k) for k, C in enumerate(c.columns)])
    X = np.concatenate([C.reshape(len(c.y), -1) for C in c.columns], axis=1)
    size = np.linalg.norm(X, axis=0)
    X = X / np.where(size > 1e-9, size, np.inf)
    first = np.abs(X.T @ c.y)
    keep = np.argsort(-first)[:SCREENED]
    X, family = X[:, keep], family[keep]
    a, best = np.zeros(X.shape[1]), (c.freedom * np.log(c.y @ c.y), np.zeros(X.shape[1]))
    entered: list[int] = []
    rate = float(1.0 / np.linalg.norm(X, 2) ** 2)
    for weight in first.max() * np.geomspace(0.95, 0.08, PATH):
        a = _penalised(X, c.y, weight, a, rate)
        there = np.flatnonzero(a)
        entered += family[there[np.argsort(-np.abs(a[there]))]].tolist()
        if len(there) > MOST_NONZERO:
            break
        # The criterion of the least-squares fit on what entered: the penalty shrinks values, which is no matter here.
        rest = c.y - X[:, there] @ np.linalg.lstsq(X[:, there], c.y, rcond=None)[0] if len(there) else c.y
        criterion = c.freedom * np.log(rest @ rest) + len(there) * np.log(c.freedom)
        if criterion < best[0]:
            best = (criterion, a.copy())
    strength = {int(k): float(np.abs(best[1][family == k]).max()) for k in np.unique(family)}
    named = sorted((k for k, s in strength.items() if s > 0), key=lambda k: -strength[k])
    return _named(c, list(dict.fromkeys([*named, *entered, *family.tolist()])), named)


def _penalised(X: Array, y: Array, weight: float, a: Array, rate: float) -> Array:
    """Minimum of |y - X a|^2 / 2 + weight |a|_1 from `a` on (Beck and Teboulle 2009, eqs. 4.1 to 4.3)."""
    z, t = a, 1.0
    for _ in range(SWEEPS):
        step = z + rate * (X.T @ (y - X @ z))
        new = np.sign(step) * np.maximum(np.abs(step) - rate * weight, 0.0)
        after = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
        z, moved = new + (t - 1.0) / after * (new - a), float(np.abs(new - a).max())
        a, t = new, after
        if moved < 1e-4:
            break
    return a


def gains(C: Array, y: Array) -> Array:
    """What each variant's columns (N, V, m) take from y^T y (V,)."""
    G = np.einsum("nvi,nvj->vij", C, C)
    b = np.einsum("nvi,n->vi", C, y)
    trace = np.trace(G, axis1=1, axis2=2)[:, None, None]
    a = np.linalg.solve(G + (1e-10 * trace + 1e-12) * np.eye(C.shape[2]), b[..., None])[..., 0]
    return np.asarray(np.einsum("vi,vi->v", a, b))


def _named(c: RivalColumns, order: Sequence[int] | Index, chosen: Sequence[int] | Index) -> RivalAnswer:
    return RivalAnswer(tuple(c.names[k] for k in order[:RANKED]), tuple(c.names[k] for k in chosen))


METHODS = {"single": single, "stepwise": stepwise, "sparse": sparse, "unprojected": unprojected}
FAULTS = (BadInput, Infeasible, ArithmeticError, ValueError, TypeError, LookupError, AssertionError, np.linalg.LinAlgError)
"""What makes a world an error of the answer, counted as wrong, instead of ending the check."""


def make_answer(check: Check, recipe: Recipe) -> None:
    """Answer a world from its folder; what went wrong is an answer too."""
    answer = answer_world(check.world(recipe.name))
    if answer["error"]:
        answer["error"] = named_below(check.folder, answer["error"])
    path = check.answer(recipe.name)
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(answer) + "\n", encoding="utf-8")


def answer_world(folder: Path) -> dict[str, Any]:
    """Everything that is said about a world. A refusal is an answer too; it counts as wrong."""
    withheld = (folder / WITHHELD).read_text(encoding="utf-8").split() if (folder / WITHHELD).is_file() else ()
    known = {name: effect for name, effect in library().items() if name not in withheld}
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        answer = answer_of(folder, Phases(), known)
    except FAULTS as error:
        return {"error": _fault(error)}
    predicted: dict[str, Any] = {}
    fault = None
    try:
        for signal, sealed in predict_sealed(answer).items():
            values = {name: getattr(sealed, name) for name in ("baseline", "corrected", "named", "sigma")}
            predicted[signal] = {name: array.round(8).tolist() for name, array in values.items()}
    except FAULTS as error:
        fault = _fault(error)
    seconds = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, **answer.seconds}
    d = answer.diagnosis
    columns = rival_columns(d.baseline, known)
    return {
        "error": None,
        "document": document_of(answer).model_dump(mode="json", by_alias=True),
        "screened": [[s.name.effect, s.name.joint, s.smallest, s.p_value] for s in d.screened],
        "because": [*d.unknown_reasons],
        "predictions": predicted.get("tracker"),
        **({"predictions_force": predicted["force"]} if "force" in predicted else {}),
        "prediction_error": fault,
        "rivals": {method: asdict(rival(columns)) for method, rival in METHODS.items()},
        "seconds": seconds,
    }


def _fault(error: BaseException) -> str:
    """An error and where it came from."""
    place = traceback.extract_tb(error.__traceback__)
    own = next((f for f in reversed(place) if Path(f.filename).is_file()), place[-1])
    return f"{type(error).__name__}: {error} ({Path(own.filename).name}:{own.lineno})"
