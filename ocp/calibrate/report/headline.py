"""The verdict of a calibration: its headline's sentence, what speaks against it, and the facts below."""

import numpy as np

from ocp.calibrate.report.held_out import KINDS
from ocp.calibrate.report.view import ReadingsView, count_of, mm, named, present
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.section import Headline
from robots.calibration.validation import by_kind

CLEARLY = 0.8  # of the mean error: a method below it does clearly better
SURE = 1.5  # error over prediction of a kind of fold above which the stated uncertainties are doubted


def calibration_headline(c: TrackerCalibration, view: ReadingsView) -> Headline:
    """Verdict and figures. Without readings left out nothing is proven, and it says so."""
    methods = c.methods
    after = methods.error[c.method]
    doubts = _doubts(c)
    if not len(after):
        inside = view.error[~view.outlier]
        sentence = (
            f"No reading could be left out, so how good it is where it was not fitted is not known; the {len(inside)} readings "
            f"it was fitted to are met to {mm(inside.mean())} mm on average and {mm(inside.max())} mm at most, which flatters it."
        )
        return Headline(False, "Not proven.", sentence, _facts(c, view))
    sentence = (
        f"Readings that the fit had not seen are predicted to {mm(after.mean())} mm on average and {mm(after.max())} mm at most; "
        f"before calibration it was {mm(methods.before.mean())} mm and {mm(methods.before.max())} mm."
    )
    verdict = "Calibrated." if not doubts else "Calibrated, with doubts."
    better = bool(after.mean() < methods.before.mean())
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
