"""What a force log says of the contact, as sections of the calibration report: parameters, what is not seen, errors."""

import numpy as np

from ocp.calibrate.force.fit import FIT_NAMES
from ocp.calibrate.force.folds import pooled_blocks
from ocp.calibrate.force.registration import ForceFit
from ocp.report.parts import Plot, Points, Table, table
from ocp.report.plotting import Canvas, Draw, dressed, keys, panels
from ocp.report.section import Part, Section
from ocp.report.style import CURVE, SOFT, TARGET
from robots.calibration.parameters import SYMBOLS
from robots.calibration.reading_model import ARM_NAMES, PAYLOAD_NAMES

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
