"""The report of `python -m ocp.calibrate`: report.html and report.pdf of one calibration, from the same sections.

Here: the sections' order; the verdict with its headline's sentence, what speaks against it and the facts below; what a force log
says of the contact (parameters, what is not seen, errors).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ocp.calibrate.force.assessment import pooled_blocks
from ocp.calibrate.force.fit import FIT_NAMES
from ocp.calibrate.force.registration import ForceFit
from ocp.calibrate.report.advice import advice_section
from ocp.calibrate.report.held_out import before_and_after_section, withheld_section
from ocp.calibrate.report.parameters import identifiability_section, parameters_section, tellable_parameters, terms_section
from ocp.calibrate.report.residuals import noise_section, residuals_section
from ocp.calibrate.report.view import ReadingsView, count_of, look_at, mm, named, present
from ocp.calibrate.tracker import TrackerCalibration, doubts_about
from ocp.report.parts import Plot, Points, Table, made_from, table
from ocp.report.plotting import Canvas, Draw, dressed, keys, panels
from ocp.report.report import Report
from ocp.report.section import Headline, Part, Section
from ocp.report.style import CURVE, SOFT, TARGET
from robots.calibration.parameters import SYMBOLS
from robots.calibration.reading_model import ARM_NAMES, PAYLOAD_NAMES
from robots.calibration.validation import by_kind


def write_calibration_report(c: TrackerCalibration, folder: Path, hashes: dict[str, str], extra: Sequence[Section] = ()) -> None:
    """Write report.html and report.pdf into `folder`; equal calibrations give equal bytes.

    hashes: SHA-256 by file name of what it was made from. extra: sections of other measurements, shown before what to measure
    next. Raises OSError where a file cannot be written.
    """
    view, tellable = look_at(c), tellable_parameters(c)
    title = f"{c.fit.campaign.robot.title} from {c.fit.campaign.readings.path.name}"
    sections = [
        before_and_after_section(c),
        withheld_section(c),
        residuals_section(c, view),
        parameters_section(c),
        identifiability_section(c, tellable),
        terms_section(c),
        noise_section(c, view),
        *extra,
        advice_section(c, view, tellable),
        made_from(hashes),
    ]
    report = Report("Calibration of a robot", title, calibration_headline(c, view), c.notices, sections)
    report.write(folder)


def calibration_headline(c: TrackerCalibration, view: ReadingsView) -> Headline:
    """Verdict and figures. Without readings left out nothing is proven, and it says so."""
    methods = c.methods
    after = methods.error[c.method]
    doubts = doubts_about(c)
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


SHOWN = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "N/m": (1e-3, "N/mm"), "1": (100.0, "%"), "N": (1.0, "N")}


def contact_sections(fit: ForceFit) -> list[Section]:
    """Sections for wheel, blade, flange and sensor."""
    f = fit.figures
    words = (
        f"{f.rows} readings in contact, worth {f.independent:.0f} independent ones, and {f.air_rows} in the air. Measured less "
        f"predicted force: {f.rms_before:.2f} N rms (mean {f.mean_before:+.2f} N) with the cell as believed, {f.rms_after:.2f} N "
        f"rms (mean {f.mean_after:+.2f} N) after the fit; one reading scatters by {f.sigma:.2f} N, so {f.gap_after:.2f} N are "
        "left unexplained."
    )
    caption = (
        "Measured less predicted force by recording and against the predicted force: grey with the cell as believed, blue after "
        "the fit."
    )
    parts: tuple[Part | str, ...] = (words, _parameters(fit), _held_out(fit), Plot("contact-force", caption, 2.6, _draw(fit)))
    hidden = tuple(f"{key.replace(' ', ', ')}: {reason}" for key, reason in fit.not_identified.items())
    unseen: tuple[Part | str, ...] = (Points(hidden),) if hidden else ("Everything that the cell leaves open was seen.",)
    return [Section("Blade, wheel and flange, from the force log", parts), Section("What the force log cannot separate", unseen)]


def _parameters(fit: ForceFit) -> Table:
    rows = []
    prior = fit.solution.prior
    known = np.sqrt(np.diag(prior.covariance))
    for name, value, variance in zip(fit.names, fit.values, np.diag(fit.covariance), strict=True):
        symbol = SYMBOLS[name]
        if symbol.unit not in SHOWN or name in ARM_NAMES or name in PAYLOAD_NAMES:
            continue
        factor, unit = SHOWN[symbol.unit]
        sds = (factor * np.sqrt(variance), factor * known[FIT_NAMES.index(name)])
        rows.append((symbol.meaning, f"{factor * value:.3f}", *(f"{sd:.3f}" for sd in sds), unit))
    columns = ("parameter", "estimate", "one sigma", "one sigma before", "unit")
    return table(columns, rows, text=(0, 4))


def _held_out(fit: ForceFit) -> Table:
    rows = []
    for way, folds in fit.held_out.items():
        together = pooled_blocks(folds)
        rows.append((way, str(len(folds)), f"{together.rms:.3f}", f"{together.mean:+.3f}", f"{together.gap:.3f}"))
    return table(("left out by", "blocks", "rms N", "mean N", "without the noise N"), rows)


def _draw(fit: ForceFit) -> Draw:
    contact = fit.log.contact
    before = fit.log.fn[contact] - fit.solution.before[contact]
    after = fit.log.fn[contact] - fit.predicted[0][contact]

    def draw(canvas: Canvas) -> None:
        left, right = panels(canvas, 1, 2, sharey=True)[0]
        for axes, x, label in (
            (left, np.arange(len(after)), "reading in contact"),
            (right, fit.predicted[0][contact], "predicted force N"),
        ):
            axes.plot(x, before, ".", color=SOFT, ms=1.5, alpha=0.35, rasterized=True)
            axes.plot(x, after, ".", color=CURVE, ms=1.5, alpha=0.5, rasterized=True)
            axes.axhline(0.0, color=TARGET, lw=0.6)
            dressed(axes, x=label, y="measured less predicted N" if axes is left else "")
        keys(right, [("as believed", SOFT), ("fitted", CURVE)])
        run = fit.log.run[contact]
        for k in np.flatnonzero(np.diff(run)):
            left.axvline(k + 0.5, color=SOFT, lw=0.3)

    return draw
