"""An answer as the document of diagnosis.json."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ocp.diagnose.answer import Answer, SignalGap, figures
from ocp.diagnose.engine.findings import Diagnosis, Name, Ranked
from ocp.diagnose.json_out import (
    Budget,
    Document,
    Experiment,
    Explanation,
    Extrapolation,
    Figures,
    Gap,
    Location,
    Named,
    Parameter,
    Rank,
    Shrinkage,
    rounded,
)
from ocp.diagnose.rules import LEAST_BUDGET, LISTED, MOST_BUDGET, MOST_LISTED


def document_of(answer: Answer) -> Document:
    """The document; probabilities sum to one to the last digit that is written."""
    d = answer.diagnosis
    return Document(
        dataset=answer.data.folder.resolve().name,
        verdict=d.verdict,  # type: ignore[arg-type]
        **_probabilities(d),
        ranking=[_rank(r) for k, r in enumerate(d.ranking[:MOST_LISTED]) if k == 0 or r.probability >= LISTED],
        indistinguishable=[[str(name) for name in group] for group in d.classes],
        location=_location(d),
        gap={gap.name: _gap(gap) for gap in answer.gaps},  # type: ignore[misc]
        blind_spots=list(answer.blind),
        next_experiment=[
            Experiment(
                do=e.do, minutes=rounded(e.minutes, 3), tells_apart=list(e.tells_apart), expected_probability=_share(e.expected)
            )
            for e in answer.next
        ],
    )  # fmt: skip


def _probabilities(d: Diagnosis) -> dict[str, Any]:
    """p_none, p_unknown and explanations, rounded so that they still sum to one."""
    kept = [e for k, e in enumerate(d.explanations) if k == 0 or e.probability >= LISTED]
    shares = np.array([d.p_none, d.p_unknown, *(e.probability for e in kept)], float)
    whole = np.round(np.maximum(shares, 0.0) / max(shares.sum(), 1e-300), 6)
    whole[int(np.argmax(whole))] += 1.0 - whole.sum()
    whole = np.round(whole, 6)
    explained = [
        Explanation(effects=[_named(n) for n in e.names], probability=_share(p)) for e, p in zip(kept, whole[2:], strict=True)
    ]
    return {"p_none": _share(whole[0]), "p_unknown": _share(whole[1]), "explanations": explained}


def _named(name: Name) -> Named:
    return Named(effect=name.effect, joint=name.joint or None)


def _share(value: float) -> float:
    return float(round(min(max(float(value), 0.0), 1.0), 6))


def _rank(r: Ranked) -> Rank:
    known = {p.key: p for p in r.active.effect.parameters}
    deviations = r.active.deviations
    parameters = {
        key: Parameter(value=_plain(value), sd=_plain(deviations.get(key)), unit=known[key].unit if key in known else "")
        for key, value in r.active.parameters.items()
    }
    return Rank(
        effect=r.name.effect, joint=r.name.joint or None, probability=_share(r.probability),
        log_evidence=rounded(float(r.log_evidence)), parameters=parameters, detectability=rounded(float(r.detectability)),
    )  # fmt: skip


def _plain(value: Any) -> Any:
    """A value that JSON can hold: floats, texts, lists of floats, None."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Sequence | np.ndarray):
        return rounded([float(v) for v in np.asarray(value).ravel()])
    return rounded(float(value))


def _location(d: Diagnosis) -> Location:
    at = d.location
    told = [b for k, b in enumerate(d.budget) if k < LEAST_BUDGET or b.share > 0][:MOST_BUDGET]
    budget = [Budget(where=b.where, share=_share(b.share), p_value=_share(b.p_value)) for b in told]
    if at is None:
        return Location(signal=None, subsystem=None, joint=None, depends_on=[], segments=[], budget=budget)
    return Location(
        signal=at.signal, subsystem=at.subsystem, joint=at.joint or None,  # type: ignore[arg-type]
        depends_on=list(at.depends_on), segments=list(at.segments), budget=budget,
    )  # fmt: skip


def _gap(gap: SignalGap) -> Gap:
    before, after = (Figures(**{k: rounded(v) for k, v in figures(sizes).items()}) for sizes in (gap.before, gap.after))
    s = gap.shrinkage
    return Gap(
        unit=gap.unit,  # type: ignore[arg-type]
        noise_floor=rounded(gap.noise_floor), before=before, after=after,
        shrinkage=None if s is None else Shrinkage(predicted=rounded(s.predicted), low=rounded(s.low), high=rounded(s.high)),
        extrapolation=[Extrapolation(withheld=n, shrinkage=None if v is None else rounded(v)) for n, v in gap.extrapolation],
    )  # fmt: skip
