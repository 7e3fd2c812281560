"""diagnosis.json: its schema, to the letter of FORMATS.md, and how an answer is put into it."""

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Verdict = Literal["explained", "ambiguous", "unexplained", "no_gap"]
Subsystem = Literal[
    "joint", "link", "base", "payload", "tool", "tracker", "target", "wheel", "blade", "flange", "sensor", "timing"
]  # fmt: skip
SUM_TOLERANCE = 1e-6


class Model(BaseModel):
    """A JSON object: nothing but what the schema names."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Named(Model):
    """An effect at a joint."""

    effect: str
    joint: Annotated[int, Field(ge=1, le=6)] | None


class Parameter(Model):
    """A value with its standard deviation; what is scanned or a name has none."""

    value: Number | list[Number] | str
    sd: Number | list[Number] | None
    unit: str


class Rank(Named):
    """An effect with its marginal probability, evidence, values and detectability index."""

    probability: Share
    log_evidence: Number
    parameters: dict[str, Parameter]
    detectability: Number


class Explanation(Model):
    """A set of effects with its probability."""

    effects: list[Named]
    probability: Share


class Budget(Model):
    """Share of the gap's mean square beyond noise that goes with a condition."""

    where: str
    share: Share
    p_value: Share


class Location(Model):
    """Where the gap lies."""

    signal: Literal["tracker", "force", "joint"] | None
    subsystem: Subsystem | None
    joint: Annotated[int, Field(ge=1, le=6)] | None
    depends_on: list[str]
    segments: list[str]
    budget: list[Budget]


class Figures(Model):
    """Of the sizes of the errors of readings."""

    rms: Number
    mean: Number
    max: Number


class Shrinkage(Model):
    """1 - G_after / G_before on data not used, with a 90 % interval."""

    predicted: Number
    low: Number
    high: Number


class Extrapolation(Model):
    """Shrinkage where a condition was left out of the fit; null where the gap there is below a fifth of the noise."""

    withheld: str
    shrinkage: Number | None


class Gap(Model):
    """The gap of one signal, before and after the named effects, in its unit."""

    unit: Literal["mm", "N", "arcsec"]
    noise_floor: Number
    before: Figures
    after: Figures
    shrinkage: Shrinkage | None
    extrapolation: list[Extrapolation]


class Experiment(Model):
    """A measurement that would tell apart what these data do not."""

    do: str
    minutes: Number
    tells_apart: list[str]
    expected_probability: Share


class Document(Model):
    """The whole of diagnosis.json."""

    schema_: Literal[1] = Field(1, alias="schema")
    dataset: str
    verdict: Verdict
    p_none: Share
    p_unknown: Share
    ranking: list[Rank]
    explanations: list[Explanation]
    indistinguishable: list[list[str]]
    location: Location
    gap: dict[Literal["tracker", "force", "joint"], Gap]
    blind_spots: list[str]
    next_experiment: list[Experiment]

    @model_validator(mode="after")
    def _sums_to_one(self) -> Self:
        total = self.p_none + self.p_unknown + sum(e.probability for e in self.explanations)
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"explanations, p_none and p_unknown sum to {total}")
        return self


def json_text(document: Document) -> str:
    """The file's text, the same for the same document."""
    return document.model_dump_json(by_alias=True, indent=1) + "\n"


def rounded(value: Any, digits: int = 6) -> Any:
    """Numbers to so many significant digits, inside lists too: files differ only where answers do."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, list | tuple):
        return [rounded(v, digits) for v in value]
    return value
