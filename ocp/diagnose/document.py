"""diagnosis.json: its schema, to the letter of FORMATS.md, and how an answer is put into it."""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, AliasChoices, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from ocp.diagnose.engine.findings import Diagnosis, Location, Ranked
from ocp.diagnose.rules import LEAST_BUDGET, LISTED, MOST_BUDGET, MOST_LISTED
from ocp.diagnose.verdict.answer import Answer, Patched, SignalGap, figures
from ocp.effects.patch import formula_of


def rounded(value: float, digits: int = 6) -> float:
    """A number to so many significant digits: files differ only where answers do."""
    return float(f"{value:.{digits}g}")


Share = Annotated[float, Field(ge=0.0, le=1.0), AfterValidator(partial(round, ndigits=6))]
Number = Annotated[float, Field(allow_inf_nan=False), AfterValidator(rounded)]
Minutes = Annotated[float, Field(allow_inf_nan=False), AfterValidator(partial(rounded, digits=3))]
Joint = Annotated[Annotated[int, Field(ge=1, le=6)] | None, BeforeValidator(lambda joint: joint or None)]
Verdict = Literal["explained", "partly", "ambiguous", "unexplained", "no_gap"]
Subsystem = Literal[
    "joint", "link", "base", "payload", "tool", "tracker", "target", "wheel", "blade", "flange", "sensor", "timing"
]
SUM_TOLERANCE = 1e-6


class JsonObject(BaseModel):
    """A JSON object: nothing but what the schema names; numbers as the file rounds them."""

    model_config = ConfigDict(extra="forbid", frozen=True, from_attributes=True, use_attribute_docstrings=True)


class NamedJson(JsonObject):
    """An effect at a joint."""

    effect: str
    """Name in the catalogue."""
    joint: Joint
    """Joint that it acts on; null for one of no joint."""


class ParameterJson(JsonObject):
    """A value with its standard deviation; what is scanned or a name has none."""

    value: Number | list[Number] | str
    """In the key's unit; a name for a payload or target."""
    sd: Number | list[Number] | None
    """One sigma; null of what is scanned or a name."""
    unit: str
    """SI."""


class RankJson(NamedJson):
    """An effect with its marginal probability, evidence, values and detectability index."""

    probability: Share
    """That it is there, whatever else is."""
    log_evidence: Number
    """Of the best set with it over the best without."""
    parameters: dict[str, ParameterJson]
    """Values by the effect's keys."""
    detectability: Number
    """Lambda, signal over noise squared, of this size in these data."""


class ExplanationJson(JsonObject):
    """A set of effects with its probability."""

    effects: list[NamedJson]
    """What is there together."""
    probability: Share
    """Of just this set."""


class BudgetJson(JsonObject):
    """Share of the gap's mean square beyond noise that goes with a condition."""

    where: str
    """The condition."""
    share: Share
    """Of the mean square beyond noise."""
    p_value: Share
    """Of as much by chance."""


class LocationJson(JsonObject):
    """Where the gap lies."""

    signal: Literal["tracker", "force", "joint"] | None
    """In which readings; null where nothing can be told."""
    subsystem: Subsystem | None
    """Part of the cell."""
    joint: Joint
    """The joint, where it is one."""
    depends_on: list[str]
    """Conditions that the gap varies with."""
    segments: list[str]
    """Parts of the data that have most of it."""
    budget: list[BudgetJson]
    """Shares by condition, the largest first."""


class FiguresJson(JsonObject):
    """Of the sizes of the errors of readings."""

    rms: Number
    """Root of the mean square."""
    mean: Number
    """Mean."""
    max: Number
    """Largest."""


class ShrinkageJson(JsonObject):
    """1 - G_after / G_before on data not used, with a 90 % interval."""

    predicted: Number
    """Median."""
    low: Number
    """5 % point."""
    high: Number
    """95 % point."""


class ExtrapolationJson(JsonObject):
    """Shrinkage where a condition was left out of the fit; null where the gap there is below a fifth of the noise."""

    withheld: str
    """What was left out."""
    shrinkage: Number | None
    """That came there."""


class GapJson(JsonObject):
    """The gap of one signal, before and after the named effects, in its unit; promise: shrinkage by what is new in new data."""

    unit: Literal["mm", "N", "arcsec"]
    """Of the numbers of this signal."""
    noise_floor: Number
    """Rms of the noise."""
    before: FiguresJson
    """By the baseline, refitted."""
    after: FiguresJson
    """With the named effects."""
    shrinkage: ShrinkageJson | None
    """Promised; null where the gap is below a fifth of the noise."""
    asked: bool
    """Under the sealed conditions; else on new data like the campaign's."""
    promise: dict[str, ShrinkageJson]
    """The same by what is new: day, region, payload, session."""
    extrapolation: list[ExtrapolationJson]
    """What came where a condition was left out."""


class RemainingJson(JsonObject):
    """What remains of a signal's gap after the names: rms above the instrument's noise in its unit, the probability of its being
    noise, and where it lies (null: nowhere that can be told)."""

    above_noise: Number
    """Rms that stays above the instrument's noise, in the signal's unit."""
    p_value: Share
    """Of its being noise."""
    location: LocationJson | None
    """Where it lies; null: nowhere that can be told."""


class ExperimentJson(JsonObject):
    """A measurement that would tell apart what these data do not."""

    do: str
    """What to measure."""
    minutes: Minutes
    """That it takes."""
    tells_apart: list[str]
    """Explanations between which it decides."""
    expected_probability: Share = Field(validation_alias=AliasChoices("expected_probability", "expected"))
    """Of the true one afterwards."""


class PatchJson(JsonObject):
    """What a patch is in words, what names and patch promise together, where each condition that it varies with was measured."""

    shrinkage: ShrinkageJson
    """That names and patch promise together."""
    asked: bool
    """Under the sealed conditions."""
    formula: str
    """The patch in words."""
    range: dict[str, tuple[Number, Number]]
    """Least and most measured of every condition; beyond, the patch fades out."""


class Document(JsonObject):
    """The whole of diagnosis.json."""

    schema_: Literal[2] = Field(2, alias="schema")
    """Version of the format."""
    dataset: str
    """Name of the folder."""
    verdict: Verdict
    """The answer in a word (docs/diagnose.md)."""
    p_none: Share
    """That no named effect is there; with the explanations it sums to 1."""
    p_unknown: Share
    """That something outside the catalogue is there, beside names or without."""
    ranking: list[RankJson]
    """Effects by probability."""
    explanations: list[ExplanationJson]
    """Sets of effects by probability."""
    indistinguishable: list[list[str]]
    """Classes of effects that these data cannot tell apart."""
    location: LocationJson
    """Where the gap of the baseline lies."""
    gap: dict[Literal["tracker", "force", "joint"], GapJson]
    """By signal."""
    remaining: dict[Literal["tracker", "force", "joint"], RemainingJson]
    """What names leave, by signal."""
    patch: dict[Literal["tracker", "force"], PatchJson] | None = None
    """A correction without a name, by signal."""
    blind_spots: list[str]
    """What these data cannot show, in sentences."""
    next_experiment: list[ExperimentJson]
    """What would tell most, the best first."""

    @model_validator(mode="after")
    def _sums_to_one(self) -> Self:
        total = self.p_none + sum(e.probability for e in self.explanations)
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"explanations and p_none sum to {total}")
        return self


def json_text(document: Document) -> str:
    """The file's text, the same for the same document."""
    return document.model_dump_json(by_alias=True, indent=1) + "\n"


def document_of(answer: Answer) -> Document:
    """The document; probabilities sum to one to the last digit that is written."""
    d = answer.diagnosis
    content = {
        "dataset": answer.data.folder.resolve().name,
        "verdict": d.verdict,
        "ranking": [_rank(r) for k, r in enumerate(d.ranking[:MOST_LISTED]) if k == 0 or r.probability >= LISTED],
        "indistinguishable": [[str(name) for name in group] for group in d.classes],
        "location": _location(d),
        "gap": {gap.name: _gap(gap) for gap in answer.gaps},
        "remaining": {gap.name: _remaining(gap, d.remainder) for gap in answer.gaps},
        "patch": None if answer.patch is None else {answer.patch.channel.name: _patch(answer.patch)},
        "blind_spots": answer.blind,
        "next_experiment": answer.next,
    }
    return Document.model_validate(content | _probabilities(d))


def _probabilities(d: Diagnosis) -> dict[str, Any]:
    """p_unknown; p_none and explanations, rounded so that they still sum to one."""
    kept = [e for k, e in enumerate(d.explanations) if k == 0 or e.probability >= LISTED]
    shares = np.array([d.p_none, *(e.probability for e in kept)], float)
    whole = np.round(np.maximum(shares, 0.0) / max(shares.sum(), 1e-300), 6)
    whole[int(np.argmax(whole))] += 1.0 - whole.sum()
    none, *each = np.round(whole, 6)
    explained = [{"effects": e.names, "probability": p} for e, p in zip(kept, each, strict=True)]
    return {"p_none": none, "p_unknown": d.p_unknown, "explanations": explained}


def _rank(r: Ranked) -> dict[str, Any]:
    known = {p.key: p.unit for p in r.active.effect.parameters}
    sd, values = r.deviations, r.active.parameters.items()
    parameters = {key: {"value": _plain(v), "sd": _plain(sd.get(key)), "unit": known.get(key, "")} for key, v in values}
    figures_of = {"probability": r.probability, "log_evidence": r.log_evidence, "detectability": r.detectability}
    return asdict(r.name) | figures_of | {"parameters": parameters}


def _plain(value: Any) -> Any:
    """A value that JSON can hold: floats, texts, lists of floats, None."""
    if value is None or isinstance(value, str):
        return value
    return [float(v) for v in np.asarray(value).ravel()] if isinstance(value, Sequence | np.ndarray) else float(value)


def _location(d: Diagnosis) -> dict[str, Any]:
    empty = {"signal": None, "subsystem": None, "joint": None, "depends_on": (), "segments": ()}
    at = empty if d.location is None else asdict(d.location)
    return at | {"budget": [b for k, b in enumerate(d.budget) if k < LEAST_BUDGET or b.share > 0][:MOST_BUDGET]}


def _remaining(gap: SignalGap, at: Location | None) -> dict[str, Any]:
    where = None if at is None or at.signal != gap.name else asdict(at) | {"budget": []}
    return {"above_noise": gap.remaining.above_noise, "p_value": gap.remaining.p_value, "location": where}


def _gap(gap: SignalGap) -> dict[str, Any]:
    told = {name: getattr(gap, name) for name in ("unit", "noise_floor", "shrinkage", "promise", "asked")}
    told |= {"before": figures(gap.before), "after": figures(gap.after)}
    return told | {"extrapolation": [{"withheld": name, "shrinkage": value} for name, value in gap.extrapolation]}


def _patch(patch: Patched) -> dict[str, Any]:
    formula = "; ".join(formula_of(one) for one in patch.patches)
    measured = {name: (low, high) for one in patch.patches for name, low, high in one.scanned["range"]}
    return {"shrinkage": patch.shrinkage, "asked": patch.asked, "formula": formula, "range": measured}
