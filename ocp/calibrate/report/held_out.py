"""The sections "Before and after, on readings left out" and "Where it was not fitted": how good it is on unknown readings."""

import numpy as np

from ocp.calibrate.report.view import held_out_in_base, mm
from ocp.calibrate.tracker import KINDS, TrackerCalibration
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dots, dressed, keys, log_scale, panels
from ocp.report.section import Section
from ocp.report.style import AFTER, BAD, BEFORE, INK, RULE, SIDE_COLOURS, SOFT, printable, shorten
from robots.calibration.validation import FoldErrors, by_kind

SURPRISING = 3.0  # sigmas by which errors are above what was stated, beyond chance
COLOURS = {"full": AFTER, "geometry": SIDE_COLOURS[1], "relative": SIDE_COLOURS[3], "relative-literal": "#2a8a7a"}
HONEST = (0.8, 1.25)  # error over prediction that is drawn as honest
METHOD_WORDS = {
    "full": "full: geometry and springs in one fit",
    "geometry": "geometry: without springs",
    "relative": "relative: differences of readings, springs inside",
    "relative-literal": "relative-literal: the paper's order, springs added afterwards",
}


def before_and_after_section(c: TrackerCalibration) -> Section:
    """All methods on readings that were left out in turn."""
    title = "Before and after, on readings left out"
    if not len(c.methods.rows):
        words = (
            f"{len(c.fit.campaign.readings)} readings are too few to leave a fifth of them out, fit the rest and judge it. "
            "Take 40 or more."
        )
        return Section(title, (words,))
    springs = [f"A{j}" for j in range(1, 7) if c.believed.arm[29 + j] > 0]
    held = f"springs of {', '.join(springs)} as believed" if springs else "no springs"
    words = (
        "Every method was fitted five times to four fifths of the readings and had to predict the other fifth; a posture "
        f"stays on one side. 'Before' is the believed robot with {held}, and only tracker and nests placed by the same readings."
    )
    caption = "Distance between reading and prediction, log scale. Each dot is a reading that the model had not seen."
    methods = Plot("methods", caption, 2.9, lambda canvas: _draw_methods(canvas, c))
    caption = (
        f"The same errors along the axes of the base, before calibration (grey) and after it ('{c.method}', blue). At the right: "
        "mean absolute error."
    )
    components = Plot("components", caption, 3.3, lambda canvas: _draw_components(canvas, c))
    return Section(title, (words, methods_table(c), methods, components))


def withheld_section(c: TrackerCalibration) -> Section:
    """Where whole parts of the readings were left out."""
    title = "Where it was not fitted"
    if not c.held_out:
        return Section(title, ("No part of the readings could be left out: at least 15 must remain and 5 be predicted.",))
    words = (
        "Errors where a whole part of the readings was left out. Blind draws show how good it is among the poses measured; "
        "regions, payloads and joint ranges show how far it carries beyond them."
    )
    caption = (
        "Each row was left out, the model fitted to the rest, and the row predicted. Left: mean (dot) and largest error (end "
        "of the line). Right: error over what the model itself predicts; 1 is honest, beyond the band the model is surer than it "
        "may be (right) or more careful than it need be (left)."
    )
    height = 0.62 + 0.145 * len(c.held_out) + 0.08 * len({h.fold.kind for h in c.held_out})
    folds = Plot("folds", caption, height, lambda canvas: _draw_folds(canvas, c))
    return Section(title, (words, kinds_table(c), folds))


def methods_table(c: TrackerCalibration) -> Table:
    """Maximum, mean and standard deviation of the absolute error and of x, y, z: the paper's Table 2."""
    m = c.methods
    found = [("before: as believed, tracker placed", m.before, m.off_before)]
    found += [(METHOD_WORDS.get(k, k), error, m.off[k]) for k, error in m.error.items()]
    rows = []
    for name, error, off in found:
        sizes = (error.max(), error.mean(), error.std(), *np.abs(held_out_in_base(c, off)).mean(axis=0))
        rows.append((name, *(mm(v) for v in sizes)))
    columns = ("mm", "maximum", "mean", "std. dev.", "mean |x|", "mean |y|", "mean |z|")
    return table(columns, rows, strong=[1 + list(m.error).index(c.method)])


def _draw_methods(canvas: Canvas, c: TrackerCalibration) -> None:
    methods, rows = c.methods, np.arange(1, len(c.methods.rows) + 1)
    ax = panels(canvas, 1, 1, right=0.5)[0][0]
    dots(ax, rows, 1e3 * methods.before, BEFORE)
    for method in [m for m in methods.error if m != c.method] + [c.method]:
        dots(ax, rows, 1e3 * methods.error[method], COLOURS[method], 3.0 if method == c.method else 2.0)
    log_scale(ax)
    dressed(ax, "absolute error, mm", "reading that was left out, in the order of the file")
    keys(ax, [("before", BEFORE), *((m, COLOURS[m]) for m in methods.error)])
    ax.set_xlim(0, len(rows) + 1)


def _draw_components(canvas: Canvas, c: TrackerCalibration) -> None:
    methods, rows = c.methods, np.arange(1, len(c.methods.rows) + 1)
    axes = [row[0] for row in panels(canvas, 3, 1, sharex=True, down=0.3, right=0.5)]
    before, after = (1e3 * held_out_in_base(c, off) for off in (methods.off_before, methods.off[c.method]))
    limit = float(np.abs(np.vstack([before, after])).max()) * 1.05
    for i, ax in enumerate(axes):
        dots(ax, rows, before[:, i], BEFORE)
        dots(ax, rows, after[:, i], AFTER)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        ax.set_ylim(-limit, limit)
        dressed(ax, f"{'xyz'[i]} of the base, measured less predicted, mm")
        for place, values, colour in ((0.66, before[:, i], SOFT), (0.34, after[:, i], AFTER)):
            words = f"{np.abs(values).mean():.3f}"
            ax.text(1.012, place, words, transform=ax.transAxes, fontsize=7, color=colour, va="center")
    dressed(axes[-1], x="reading that was left out, in the order of the file")
    axes[-1].set_xlim(0, len(rows) + 1)


def kinds_table(c: TrackerCalibration) -> Table:
    """Errors by what was left out."""
    rows = []
    for kind, f in by_kind(c.held_out).items():
        errors = (mm(f[k]) for k in ("max", "mean", "sd", "rms"))
        rows.append((KINDS.get(kind, kind), f"{f['folds']:.0f}", f"{f['readings']:.0f}", *errors, f"{f['over_predicted']:.2f}"))
    columns = ("left out", "folds", "readings", "max, mm", "mean, mm", "std. dev., mm", "rms, mm", "error / prediction")
    return table(columns, rows)


def _draw_folds(canvas: Canvas, c: TrackerCalibration) -> None:
    error, ratio = panels(canvas, 1, 2, left=2.1, across=0.25, sharey=True, widths=(3, 2))[0]
    y, places, labels, kind = 0.0, [], [], ""
    for h in c.held_out:
        y += 1.0 if h.fold.kind == kind else 1.5
        kind = h.fold.kind
        figures = h.figures()
        error.plot([1e3 * figures["mean"], 1e3 * figures["max"]], [y, y], color=BEFORE, lw=1.0)
        dots(error, np.array([1e3 * figures["mean"]]), np.array([y]), AFTER, 4.0)
        over = figures["over_predicted"]
        dots(ratio, np.array([over]), np.array([y]), BAD if beyond_chance(h) and over > HONEST[1] else AFTER, 4.0)
        places.append(y)
        labels.append(f"{shorten(printable(fold_name(c, h)), 34)} ({len(h.rows)})")
    ratio.axvspan(*HONEST, color="#e6edf3", lw=0, zorder=0)
    ratio.axvline(1.0, color=INK, lw=0.6)
    error.set_yticks(places, labels)
    error.set_ylim(y + 0.8, 0.7)
    error.set_xlim(left=0)
    low, high = ratio.get_xlim()
    ratio.set_xlim(min(low, 0.6), max(high, 1.4))
    dressed(error, "error, mm (readings)", grid="x")
    dressed(ratio, "error over prediction", grid="x")


def beyond_chance(h: FoldErrors) -> bool:
    """Whether the errors of a fold are above what the model states by more than SURPRISING sigmas of chance."""
    # The mean of m squared errors of 3 components over their variance has a standard error of sqrt(2 / (3 m)).
    chance = SURPRISING * float(np.sqrt(2.0 / (3.0 * len(h.rows))))
    return h.figures()["over_predicted"] ** 2 > 1.0 + chance


def fold_name(c: TrackerCalibration, h: FoldErrors) -> str:
    """A fold in words; a region by the middle of its first three axes, which is where the arm is."""
    if h.fold.kind == "joint range":
        return h.fold.name
    if h.fold.kind == "region":
        q = np.degrees(np.median(c.fit.campaign.readings.q[h.rows, :3], axis=0))
        return "around A1 {:.0f}, A2 {:.0f}, A3 {:.0f} deg".format(*q)
    return f"{h.fold.kind} {h.fold.name}"
