"""Spectra of the gap in the angles of the joints: the picture in which gears, encoders and motors show."""

import numpy as np
from matplotlib.ticker import FuncFormatter, NullLocator

from ocp.diagnose.engine.findings import SpectrumPeak
from ocp.diagnose.report.words import SHORT
from ocp.diagnose.verdict.answer import SCALE
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dressed, panels
from ocp.report.style import AFTER, BEFORE, INK, LIMIT, SOFT

CERTAIN = 0.01  # p-value up to which a peak is marked as found


def spectrum_plot(peaks: tuple[SpectrumPeak, ...]) -> Plot:
    """Power over orders per turn of every joint."""
    caption = (
        "Ripple of the gap in each joint's angle: power over waves per turn of the axis, weighed by how the joint moves what is "
        "measured. A peak marked in red would come by chance in fewer than one of a hundred data sets; amplitude in brackets."
        + (" The six most telling." if len(peaks) > 6 else "")
    )
    rows = 2 if len(peaks) > 3 else 1
    return Plot("spectrum", caption, 0.35 + 1.6 * rows, lambda canvas: _draw_spectra(canvas, peaks, rows))


def _draw_spectra(canvas: Canvas, peaks: tuple[SpectrumPeak, ...], rows: int) -> None:
    axes = [ax for row in panels(canvas, rows, 3, sharey=True, across=0.2, down=0.55) for ax in row]
    top = max((float(np.max(p.power)) for p in peaks), default=1.0) or 1.0
    several = len({p.signal for p in peaks}) > 1
    for ax, peak in zip(axes, peaks, strict=False):
        found = peak.p_value <= CERTAIN
        ax.plot(peak.orders, peak.power / top, color=AFTER if found else BEFORE, lw=0.8)
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_locator(NullLocator())  # small ticks would take half of the drawing
        ax.set_ylim(0, 1.12)
        name = f"A{peak.joint} {SHORT[peak.signal]}:" if several else f"A{peak.joint}: order"  # no room for both
        words = f"{name} {peak.order:g} ({SCALE['arcsec'] * peak.amplitude:.1f} arcsec), p {peak.p_value:.2g}"
        ax.axvline(peak.order, color=LIMIT if found else SOFT, lw=0.7, ls="--")
        dressed(ax, words, "waves per turn" if ax in axes[-3:] else "", "power" if ax in axes[::3] else "")
        ax.title.set_color(INK if found else SOFT)
        ax.title.set_fontsize(6.5)
    for ax in axes[len(peaks) :]:
        ax.set_visible(False)
