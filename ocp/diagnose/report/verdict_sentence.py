"""The sentence of a diagnosis' verdict, and the headline around it: where, what, how sure, how much better, what next.

With it effects, conditions and figures as a person says them.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from ocp.diagnose.engine.findings import Diagnosis, Location, Name
from ocp.diagnose.rules import LEADS
from ocp.diagnose.verdict.answer import Answer, Patched, SignalGap, figures, there_of
from ocp.diagnose.verdict.shrinkage import ANOTHER_DAY, NONE, Shrinkage
from ocp.effects.catalogue import library
from ocp.effects.patch import formula_of
from ocp.report.section import Headline
from robots.calibration.identifiability import listed

SHORT = {"tracker": "tracker", "force": "force", "joint": "link encoders"}
DEPENDS = {
    "approach": "the direction of approach of joint",
    "q": "the angle of joint",
    "motor": "the motor angle of joint",
    "tau": "the load of joint",
    "step": "how far it came from the last reading, of joint",
    "moment": "the weight's moment across the axis of joint",
}
PLAIN = {
    "wait": "the time since the motion to a reading began",
    "range": "the distance from the tracker",
    "target": "the reflector nest",
    "hang": "the side to which the flange hangs",
    "sight": "the side from which a reflector is seen",
    "azimuth": "the tracker's azimuth",
    "elevation": "the tracker's elevation",
}


def effect_words(name: Name) -> str:
    """An effect in words: 'backlash of joint 5'."""
    effect = library().get(name.effect)
    if effect is None:
        return str(name)
    return effect.title.format(joint=name.joint) if name.joint else effect.title.replace("joint {joint}", "all joints")


def effects_words(names: Sequence[Name]) -> str:
    """'backlash of joint 5 and growth of all lengths with temperature'."""
    return listed([effect_words(name) for name in names]) if names else "nothing"


def figure(value: float) -> str:
    """Three significant digits without an exponent."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def percent(share: float) -> str:
    """A share of one in percent; certainty is never claimed."""
    return "over 99.9 %" if share > 0.999 else "below 0.1 %" if share < 0.001 else f"{100 * share:.{1 if share > 0.99 else 0}f} %"


def condition_words(name: str) -> str:
    """A condition in words: 'approach5' is the direction of approach of joint 5."""
    stem, digits = name.rstrip("0123456789"), name[len(name.rstrip("0123456789")) :]
    return f"{DEPENDS[stem]} {digits}" if digits and stem in DEPENDS else PLAIN.get(name, name.replace("_", " "))


def values_words(values: Mapping[str, Any], deviations: Mapping[str, Any]) -> str:
    """'half_width_rad 2.1e-4 ± 4e-6'."""
    parts = []
    for key, value in values.items():
        sd = deviations.get(key)
        shown = _number_words(value)
        if isinstance(sd, float):
            shown += f" ± {sd:.2g}"
        elif isinstance(sd, list | tuple):
            shown = f"({shown}) ± ({', '.join(f'{s:.2g}' for s in sd)})"
        parts.append(f"{key} {shown}")
    return ", ".join(parts)


def _number_words(value: Any) -> str:
    if isinstance(value, str):
        return value
    return ", ".join(f"{v:.3g}" for v in value) if isinstance(value, list | tuple) else f"{value:.4g}"


SIGNALS = {"tracker": "the laser tracker's readings", "force": "the force readings", "joint": "the link-side encoders"}
CERTAIN = 0.95  # marginal probability from which an effect is called certain where the whole is not settled
LEAST_WAVES = 2.5  # a turn: slower ones are no ripple
VERDICTS = {
    "explained": "Explained.",
    "ambiguous": "Narrowed down, not settled.",
    "partly": "Explained in part.",
    "unexplained": "A gap that no known effect explains.",
    "no_gap": "No gap.",
}


def diagnosis_headline(answer: Answer) -> Headline:
    """Verdict, sentence and facts."""
    d = answer.diagnosis
    sd = {(r.name.effect, r.name.joint): r.deviations for r in d.ranking}
    named = [f"{effect_words(Name(*a.key))}: {values_words(a.parameters, sd.get(a.key, a.deviations))}" for a in d.active]
    facts = [("Where", _where(answer)), ("What", "; ".join(named) or "no effect is named"), ("How sure", _how_sure(answer))]
    facts.append(("How much better", _better(answer)))
    if kept := not_written(answer):
        facts.append(("Not corrected", kept))
    if answer.patch is not None:
        facts.append(("Patch", _patch(answer.patch, bool(answer.written))))
    if answer.next:
        first = answer.next[0]
        facts.append(("What next", f"{_capital(first.do)} ({first.minutes:.0f} min). It tells {_apart(first.tells_apart)}."))
    if answer.blind:
        facts.append(("Not seen", "; ".join(answer.blind[:3]) + ("; …" if len(answer.blind) > 3 else "")))
    return Headline(d.verdict in ("explained", "no_gap"), VERDICTS[told_as(d)], verdict_sentence(answer), tuple(facts))


def told_as(d: Diagnosis) -> str:
    """The verdict as it is told: "partly" with no accepted name explains no part."""
    return "unexplained" if d.verdict == "partly" and not d.active else d.verdict


def _patch(patch: Patched, beside: bool) -> str:
    """What is corrected without a name, `beside` names or alone, and what that promises."""
    told = f"{shrinkage_words(patch.shrinkage)} of the {patch.channel.name} gap should be gone {there_of(patch.asked)}"
    told += f", {shrinkage_words(patch.promise[ANOTHER_DAY])} on another day" if patch.promise else ""
    what = "; ".join(formula_of(one) for one in patch.patches)
    alone = "as well" if beside else "alone, and no name"
    return f"With what has no name corrected {alone}, {told}. It explains nothing, and fades outside what was measured: {what}"


def not_written(answer: Answer) -> str:
    """Which named effects the corrected cell does not hold, and why; empty where it holds all."""
    held = {a.key for a in answer.written}
    kept = [Name(*a.key) for a in answer.diagnosis.active if a.key not in held]
    if not kept:
        return ""
    harmed = dict.fromkeys(kind for g in answer.gaps for kind in g.harmed)
    one = bool(held) and len(kept) == 1
    which = f"{_capital(effects_words(kept))} {'is' if one else 'are'}" if held else "The named effects are"
    why = f"what {'it promises' if one else 'they promise'} may be nothing, or harm"
    if any(g.elsewhere and {*kept} & {Name(*key) for key in g.shown} for g in answer.gaps):
        why = "what they rest on is not what the cell says; calibrate it anew first"
    elif harmed:
        why = f"{', '.join(harmed)}, when left out, said that {'it harms' if one else 'they harm'}"
    elif {g.shrinkage for g in answer.gaps if {*kept} & {Name(*key) for key in g.shown}} == {None}:
        why = f"fitted without {'it' if one else 'them'}, the cell's own parameters follow the readings as well"
    return f"{which} not in the corrected cell: {why}."


def verdict_sentence(answer: Answer) -> str:
    """What the gap is explained by, how far that is settled, how much of the gap goes with it."""
    d = answer.diagnosis
    if d.verdict == "no_gap":
        besides = "; encoders wander, and recorded torques hold friction" if any(g.name == "joint" for g in answer.gaps) else ""
        left = _still(answer) or f": what is left is what instruments and repeatability make{besides}"
        return f"{_levels(answer)}{left}. Sure to {percent(d.p_none)}."
    if told_as(d) == "unexplained":
        chance = f"the chance that it is one outside is {percent(d.p_unknown)}"
        where = f"{_place(d.location)}{_ripple(answer)}{_size(answer)}"
        return f"It lies in {where}. No effect of the catalogue is likely enough; {chance}."
    best = d.explanations[0]
    what = _capital(listed([_or_what_it_may_be(name, d.classes) for name in best.names]))
    verb = "explain" if len(best.names) > 1 else "explains"
    if d.verdict == "partly":
        first = f"{what} {verb} a part of the gap (sure to {percent(best.probability)})"
        return f"{first}; something outside the catalogue remains{_remainder(answer)}. {_levels(answer)}{_promise(answer)}."
    if d.verdict == "explained":
        told = f"{what} {verb} the gap (sure to {percent(best.probability)})"
        return f"{told}. {_levels(answer)}{_still(answer)}{_promise(answer)}."
    of = {name: _same(name, d.classes) for name in best.names}
    certain = [n for n, same in of.items() if sum(e.probability for e in d.explanations if same & {*e.names}) >= CERTAIN]
    if certain:
        sure = _capital(listed([_or_what_it_may_be(name, d.classes) for name in certain]))
        first = f"{sure} {'is' if len(certain) == 1 else 'are'} there for certain; what comes with it is not settled"
    else:
        first = f"{what} is the likeliest cause, with {percent(best.probability)}, but not settled"
    return f"{first}{_alternatives(answer, set().union(*(of[name] for name in certain)))}. {_levels(answer)}{_promise(answer)}."


def _same(name: Name, classes: Sequence[tuple[Name, ...]]) -> set[Name]:
    """A name and what the data cannot tell from it."""
    return {name}.union(*(group for group in classes if name in group))


def _or_what_it_may_be(name: Name, classes: Sequence[tuple[Name, ...]]) -> str:
    """'backlash of joint 1 or friction windup of joint 1', where the data cannot tell them apart."""
    return " or ".join(effect_words(one) for one in (name, *sorted(_same(name, classes) - {name})))


def _remainder(answer: Answer) -> str:
    """' in joint 1, and goes with the angle of joint 1 (0.012 mm above noise, sure to 97 %)'."""
    d = answer.diagnosis
    at = d.remainder
    gap = next((g for g in answer.gaps if at is not None and g.name == at.signal), answer.gaps[0])
    size = f"{figure(gap.remaining.above_noise)} {gap.unit} above the instrument's noise, " if gap.remaining.above_noise else ""
    return f"{'' if at is None else f' in {_place(at)}'} ({size}sure to {percent(d.p_unknown)})"


def _still(answer: Answer) -> str:
    """What is left above the instrument's noise, though none of it is told: usual play and ripple, or what is too small."""
    at, left = answer.diagnosis.remainder, [g for g in answer.gaps if g.remaining.above_noise]
    if not left:
        return ""
    told = listed([f"{figure(g.remaining.above_noise)} {g.unit} of the {SHORT[g.name]} gap" for g in left])
    there = at is not None and at.signal in [g.name for g in left]
    where = f", mostly in {_place(at).replace(', and goes with', ', with')}" if there else ""
    return f"; {told} stay above the instrument's noise{where}: too little to name, or what every gear makes"


def _size(answer: Answer) -> str:
    """' (0.07 mm above the instrument's noise, p 4e-24)', where one group of readings has it."""
    at = answer.diagnosis.location
    gap = next((g for g in answer.gaps if at is not None and at.segments and g.name == at.signal), None)
    if gap is None:
        return ""
    return f" ({figure(gap.remaining.above_noise)} {gap.unit} above the instrument's noise, p {gap.remaining.p_value:.1g})"


def _ripple(answer: Answer) -> str:
    """' (a ripple near 13.5 waves a turn)', where the spectrum of the joint that the gap lies in has a peak."""
    d = answer.diagnosis
    joint = d.location.joint if d.location else 0
    peak = next((p for p in d.spectrum if p.joint == joint and p.p_value < 0.01), None)
    goes = d.location is not None and d.location.depends_on == (f"q{joint}",)
    return f" (a ripple near {peak.order:g} waves a turn)" if goes and peak is not None and peak.order >= LEAST_WAVES else ""


def _alternatives(answer: Answer, certain: set[Name]) -> str:
    """': A (33 %), B (16 %) or nothing more (12 %)', the explanations less what is certain."""
    shares = defaultdict[tuple[Name, ...], float](float)
    for e in answer.diagnosis.explanations:
        shares[tuple(name for name in e.names if name not in certain)] += e.probability
    told = [f"{effects_words(r) if r else 'nothing more'} ({percent(p)})" for r, p in list(shares.items())[:4] if p > 0.05]
    return f": {', '.join(told[:-1])} or {told[-1]}" if len(told) > 1 else "".join(f": {one}" for one in told)


def _levels(answer: Answer) -> str:
    """'Tracker 0.19 → 0.03 mm (noise 0.02)'."""
    return _capital(", ".join(_level(answer, gap) for gap in answer.gaps))


def _level(answer: Answer, gap: SignalGap) -> str:
    before, after = (figure(figures(sizes)["rms"]) for sizes in (gap.before, gap.after))
    told = f"{before} → {after}" if answer.diagnosis.active else before
    return f"{SHORT[gap.name]} {told} {gap.unit} (noise {figure(gap.noise_floor)})"


def _promise(answer: Answer) -> str:
    told = [
        f"{shrinkage_words(gap.shrinkage)} of the {SHORT[gap.name]} gap {_gone(answer, gap)} {gap.there}, "
        f"{shrinkage_words(gap.promise[ANOTHER_DAY])} on another day"
        for gap in answer.gaps
        if gap.shrinkage is not None and gap.shrinkage != NONE
    ]
    return "".join(f"; {one}" for one in told)


def _gone(answer: Answer, gap: SignalGap) -> str:
    """That it 'should be gone', or would be if what it is promised of were corrected, which it is not."""
    return "would be gone if that were corrected," if {*gap.shown} - {a.key for a in answer.written} else "should be gone"


def shrinkage_words(s: Shrinkage) -> str:
    """'80 % (70 to 85 %)'."""
    return f"{100 * s.predicted:.0f} % ({100 * s.low:.0f} to {100 * s.high:.0f} %)"


def _where(answer: Answer) -> str:
    d = answer.diagnosis
    if d.verdict == "no_gap" or d.location is None:
        return "nowhere beyond noise"
    return f"in {_place(d.location)}, seen by {SIGNALS.get(d.location.signal, d.location.signal)}"


def _place(at: Location | None) -> str:
    """'joint 1, and goes with the angle of joint 1'."""
    if at is None:
        return "no part that can be told"
    if at.segments:
        return f"{condition_words(at.depends_on[0])} {listed(at.segments)}"
    words = {"timing": "the timing of the recordings", "target": "a reflector nest", "link": "the links"}
    place = f"joint {at.joint}" if at.joint else words.get(at.subsystem, f"the {at.subsystem}")
    return place + (f", and goes with {listed([condition_words(c) for c in at.depends_on])}" if at.depends_on else "")


def _how_sure(answer: Answer) -> str:
    d = answer.diagnosis
    parts = [f"{percent(e.probability)} {effects_words(e.names)}" for e in d.explanations[:3] if e.probability > 0.005]
    parts += [f"{percent(d.p_none)} no name of the catalogue", f"{percent(d.p_unknown)} something outside the catalogue"]
    accepted = {Name(*a.key) for a in d.active}
    together = [" = ".join(effect_words(n) for n in group) for group in d.classes if accepted & set(group)]
    return "; ".join(parts) + (f". These data cannot tell apart: {'; '.join(together)}" if together else "")


def _better(answer: Answer) -> str:
    parts = []
    for gap in answer.gaps:
        words = _level(answer, gap)
        if gap.shrinkage is None and answer.diagnosis.p_unknown > LEADS:
            words += "; what has no name is in that noise"
        elif gap.shrinkage is None:
            words += "; the gap is too small beside it to speak of shrinking"
        elif gap.shrinkage != NONE:
            words += f"; {gap.there} {shrinkage_words(gap.shrinkage)} of the gap beyond noise {_gone(answer, gap).rstrip(',')}"
        parts.append(words)
    return "; ".join(parts)


def _apart(names: Sequence[str]) -> str:
    return f"{names[0]} from {listed(list(names[1:]))}" if len(names) > 1 else names[0]


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
