"""A calibration in words: the verdict, the headline's facts, why terms entered or not, what a fold says."""

import numpy as np

from ocp.calibrate.report.view import ReadingsView, named, present
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.section import Headline
from robots.calibration.evidence import LEAST_GAIN, LEAST_SIGMA, Term
from robots.calibration.validation import HeldOut, by_kind

CLEARLY = 0.8  # of the mean error: a method below it does clearly better
SURPRISING = 3.0  # sigmas by which errors are above what was stated, beyond chance
SURE = 1.5  # error over prediction of a kind of fold above which the stated uncertainties are doubted
KINDS = {
    "random": "readings drawn blindly",
    "region": "a region of the workspace (axes 1 to 3)",
    "campaign": "a session",
    "payload": "a payload",
    "joint range": "the upper half of an axis' range",
}


def headline(c: TrackerCalibration, view: ReadingsView) -> Headline:
    """Verdict and figures. Without readings left out nothing is proven, and it says so."""
    table = c.methods
    after = table.error[c.method]
    doubts = _doubts(c)
    if not len(after):
        inside = view.error[~view.outlier]
        sentence = (
            f"No reading could be left out, so how good it is where it was not fitted is not known; the {len(inside)} "
            f"readings it was "
            f"fitted to are met to {mm(inside.mean())} mm on average and {mm(inside.max())} mm at most, which flatters it."
        )
        return Headline(False, "Not proven.", sentence, _facts(c, view))
    sentence = (
        f"Readings that the fit had not seen are predicted to {mm(after.mean())} mm on average and {mm(after.max())} mm at most; "
        f"before calibration it was {mm(table.before.mean())} mm and {mm(table.before.max())} mm."
    )
    verdict = "Calibrated." if not doubts else "Calibrated, with doubts."
    better = bool(after.mean() < table.before.mean())
    words = " ".join((sentence, *doubts))
    return Headline(better and not doubts, verdict if better else "No better than before.", words, _facts(c, view))


def _doubts(c: TrackerCalibration) -> list[str]:
    """What speaks against the calibration: another method does better, errors above what the model states."""
    error, words = c.methods.error, []
    if len(c.methods.rows):
        after, best = error[c.method], min(error, key=lambda method: float(error[method].mean()))
        if after.max() > c.methods.before.max():
            words.append("The worst reading is further off than before.")
        if error[best].mean() < CLEARLY * after.mean():
            words.append(f"Method '{best}' does better: {mm(error[best].mean())} mm on average.")
    found = {kind: figures["over_predicted"] for kind, figures in by_kind(c.held_out).items()}
    return words + [
        f"Where {KINDS[kind]} is left out, errors are {over:.1f} times what it states."
        for kind, over in found.items()
        if over > SURE
    ]


def _facts(c: TrackerCalibration, view: ReadingsView) -> tuple[tuple[str, str], ...]:
    return (("How many", _how_many(c, view)), ("How sure", _how_sure(c, view)), ("Not seen", _not_seen(c)))


def _how_many(c: TrackerCalibration, view: ReadingsView) -> str:
    r = view.readings
    parts = [f"{len(r)} readings"]
    for kind, index in (("reflector nest", r.target), ("payload", r.payload), ("session", r.session), ("station", r.station)):
        count = len(present(index))
        if count > 1:
            parts.append(f"{count} {kind}s")
    left = f"{len(c.methods.rows)} of them left out in turn" if len(c.methods.rows) else "none of them could be left out"
    gone = int(view.outlier.sum())
    outliers = f"; {count_of(gone, 'outlier')} not counted" if gone else ""
    return f"{', '.join(parts)}; {left}{outliers}"


def _how_sure(c: TrackerCalibration, view: ReadingsView) -> str:
    words = f"the reflector's place is known to {mm(np.median(view.stated))} mm from the parameters (one sigma, 3D, median)"
    random = by_kind(c.held_out).get("random")
    if random is None:
        return f"{words}; not checked on readings left out"
    return f"{words}; errors of readings left out are {random['over_predicted']:.2f} of what was stated for them (1 is honest)"


def _not_seen(c: TrackerCalibration) -> str:
    """What the readings cannot show, shortly."""
    r = c.fit.campaign.readings
    parts = []
    hidden = c.identifiability.hidden
    if hidden:
        parts.append(f"{len(hidden)} of {c.identifiability.parameters} parameters of the robot only together with others")
    for blind, what in ((r.approach, "backlash"), (r.temperature, "growth with temperature"), (r.time, "drift")):
        if blind is None:
            parts.append(what)
    if c.repeats is None:
        parts.append("scatter of repeats")
    unread = [name for k, name in enumerate(r.payloads) if k not in present(r.payload)]
    if unread:
        parts.append(f"payload{'s' if len(unread) > 1 else ''} {', '.join(named(name, 'payload') for name in unread)}")
    return "; ".join(parts) if parts else "nothing of what the model has"


def beyond_chance(h: HeldOut) -> bool:
    """Whether the errors of a fold are above what the model states by more than SURPRISING sigmas of chance."""
    # The mean of m squared errors of 3 components over their variance has a standard error of sqrt(2 / (3 m)).
    chance = SURPRISING * float(np.sqrt(2.0 / (3.0 * len(h.rows))))
    return h.figures()["over_predicted"] ** 2 > 1.0 + chance


def fold_name(c: TrackerCalibration, h: HeldOut) -> str:
    """A fold in words; a region by the middle of its first three axes, which is where the arm is."""
    if h.fold.kind == "joint range":
        return h.fold.name
    if h.fold.kind == "region":
        q = np.degrees(np.median(c.fit.campaign.readings.q[h.rows, :3], axis=0))
        return "around A1 {:.0f}, A2 {:.0f}, A3 {:.0f} deg".format(*q)
    return f"{h.fold.kind} {h.fold.name}"


def term_verdict(term: Term) -> str:
    """Why a term entered the model or not."""
    if term.accepted:
        return "in the model: readings left out are predicted better with it"
    if term.gain > LEAST_GAIN:
        return "not in the model: better on the whole, but not on enough blocks of readings to be more than chance"
    if term.gain > 0:
        return "not in the model: helps too little to be told from chance"
    if term.sigma == 0.0:
        return "not in the model: hardly helps even the readings it was fitted to"
    return "not in the model: readings left out are predicted worse with it"


def terms_note() -> str:
    """How the evidence is weighed."""
    return (
        f"A term enters when the log density of readings left out grows by more than {LEAST_GAIN:g} and by more than "
        f"{LEAST_SIGMA:g} times "
        "the standard error of that growth. A gain of 4 means that the readings are 55 times as likely with the term."
    )


def mm(value: float) -> str:
    """A length m in mm, to 1 um."""
    return f"{1e3 * float(value):.3f}"


def count_of(count: int, what: str) -> str:
    """'1 outlier', '2 outliers'."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def listed(words: list[str]) -> str:
    """'a', 'a and b', 'a, b and c'."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
