"""The sections "What is left over" and "Noise, repeats and load tests".

Residuals in the workspace, along the joints, by circumstance, beside their expected size; what scatters and by how much, and
the springs that load tests tell.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.special import gammaincinv

from ocp.calibrate.report.view import ReadingsView, count_of, mm, named, present
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dots, dressed, keys, panels, reach, running_median
from ocp.report.section import Section
from ocp.report.style import AFTER, BAD, BEFORE, INK, RULE, SHADE, SIDE_COLOURS, printable, shorten
from ocp.report.workspace import draw_by_joint, draw_vectors, exaggeration
from robots.calibration.identifiability import listed
from robots.pose import Array
from robots.tracker_readings import Index

AXIS_COLOURS = (SIDE_COLOURS[0], SIDE_COLOURS[1], "#2a8a7a")  # x, y, z
MOST_NAMES = 8  # that stand side by side
_EDGE = 5.0  # sigmas shown of the histogram
WORST = 8  # readings listed


def residuals_section(c: TrackerCalibration, view: ReadingsView) -> Section:
    """Pictures of the residuals, and the readings that fit worst."""
    freedom = max(1.0 - c.fit.layout.size / (3.0 * len(view.point)), 0.1)
    words = (
        "What the fitted arm leaves of the readings it was fitted to. A model that has everything leaves noise without a pattern."
    )
    r = view.readings
    caption = (
        "Residual vectors (measured less predicted) at the reflector, base frame, drawn longer by the factor given. Neighbours "
        "that point the same way are a pattern that the model does not have; arrows without order are noise. Red crosses: "
        "outliers, without arrow."
    )
    vectors = Plot("map", caption, 4.9, lambda canvas: _draw_maps(canvas, view))
    caption = (
        "Residual along the way on which the joint carries the reflector, against the joint's angle. Line: running median. A "
        "wave is a gear or an encoder, a slope a spring or an offset. "
        + ("No approach columns: backlash cannot be seen." if r.approach is None else "Two levels by colour are backlash.")
    )
    along = 1e3 * view.along
    joints = Plot("joints", caption, 3.5, lambda canvas: draw_by_joint(canvas, r.q, along, r.approach, "mm", view.outlier))
    caption = (
        "Left over against what else was different. Where that is a number: x, y, z of the base with running medians. "
        "Where it is a name: distances with their median (bar)."
    )
    drawn = circumstances(view)
    height = 0.25 + 1.85 * ((len(drawn) + 1) // 2)
    different = Plot("circumstances", caption, height, lambda canvas: _draw_circumstances(canvas, view, drawn))
    caption = (
        "Residuals in units of their predicted sigma. Left: x, y, z together beside the bell that the noise model predicts. "
        "Right: distances in order against those expected; on the line the model is right, steeper at the end are outliers "
        "(with their line in the file)."
    )
    whitened = Plot("whitened", caption, 2.5, lambda canvas: _draw_whitened(canvas, view, freedom))
    return Section("What is left over", (words, vectors, joints, different, whitened, worst_readings_table(view)))


def _draw_maps(canvas: Canvas, view: ReadingsView) -> None:
    drawn = (("believed arm", view.before, BEFORE), ("fitted arm", view.residual, AFTER))
    for axes, (when, vectors, colour) in zip(panels(canvas, 2, 2, across=0.55, down=0.6), drawn, strict=True):
        factor = exaggeration(view.point, vectors[~view.outlier])
        draw_vectors(axes, when, view.point, vectors, factor, colour, view.outlier)


@dataclass(frozen=True)
class Circumstance:
    """What may have changed between readings: label, and values (n,) or, where it has names, indices (n,) into them."""

    label: str
    values: NDArray[Any]
    names: tuple[str, ...] = ()


def circumstances(view: ReadingsView) -> list[Circumstance]:
    """What the readings have; but for the payload, what never changes is left out."""
    r = view.readings
    found = []
    for label, values in (("time, min", None if r.time is None else r.time / 60), ("temperature, °C", r.temperature)):
        if values is not None and np.ptp(values) > 0:
            found.append(Circumstance(label, values))
    for label, index, names in (
        ("payload", r.payload, r.payloads),
        ("reflector nest", r.target, r.targets),
        ("session", r.session, r.sessions),
        ("tracker station", r.station, r.stations),
    ):
        if label == "payload" or len(present(index)) > 1:
            found.append(Circumstance(label, index, names))
    return found


def _draw_circumstances(canvas: Canvas, view: ReadingsView, drawn: list[Circumstance]) -> None:
    axes = [ax for row in panels(canvas, (len(drawn) + 1) // 2, 2, top=0.32) for ax in row]
    kept = ~view.outlier
    error, residual = 1e3 * view.error[kept], 1e3 * view.residual[kept]
    limit = reach(residual)
    for ax, one in zip(axes, drawn, strict=False):
        if one.names:
            _strips(ax, error, one.values[kept], one)
            dressed(ax, f"mm, by {one.label}")
            continue
        for i, colour in enumerate(AXIS_COLOURS):
            dots(ax, one.values[kept], residual[:, i], colour, 1.6)
            ax.plot(*running_median(one.values[kept], residual[:, i]), color=colour, lw=1.1)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        ax.set_ylim(-limit, limit)
        dressed(ax, "mm", one.label)
        keys(ax, list(zip("xyz", AXIS_COLOURS, strict=True)))
    for ax in axes[len(drawn) :]:
        ax.set_axis_off()


def _strips(ax: Axes, error: Array, index: Index, one: Circumstance) -> None:
    """Distances by name, spread sideways so that they can be told apart, the median as a bar."""
    used = present(one.values)
    most = max(3, 40 // min(len(used), MOST_NAMES))
    labels = []
    for place, k in enumerate(used):
        rows = np.flatnonzero(index == k)
        # The golden ratio's multiples fill the width evenly, the same every time.
        sideways = 0.5 * ((np.arange(len(rows)) * 0.6180339887) % 1 - 0.5)
        dots(ax, place + sideways, error[rows], AFTER, 1.8)
        if len(rows):
            ax.plot([place - 0.33, place + 0.33], [np.median(error[rows])] * 2, color=BAD, lw=1.4)
        # Dozens of names would run into each other: every so many are written.
        written = place % ((len(used) - 1) // MOST_NAMES + 1) == 0
        labels.append(f"{shorten(printable(one.names[k] or 'no name'), most)} ({len(rows)})" if written else "")
    ax.set_xticks(range(len(used)), labels)
    ax.set_xlim(-0.6, len(used) - 0.4)
    ax.set_ylim(bottom=0)


def _draw_whitened(canvas: Canvas, view: ReadingsView, freedom: float) -> None:
    left, right = panels(canvas, 1, 2, right=0.3)[0]
    values = view.whitened[~view.outlier].ravel()
    edges = np.linspace(-_EDGE, _EDGE, 41 if len(values) > 200 else 21)
    left.hist(np.clip(values, -_EDGE, _EDGE), edges.tolist(), color=SHADE, edgecolor=AFTER, linewidth=0.6)
    x = np.linspace(-_EDGE, _EDGE, 201)
    expected = len(values) * (edges[1] - edges[0]) * np.exp(-0.5 * x**2 / freedom) / np.sqrt(2 * np.pi * freedom)
    left.plot(x, expected, color=INK, lw=1.0)
    wild = np.clip(view.whitened[view.outlier].ravel(), -_EDGE, _EDGE)
    dots(left, wild, np.full(len(wild), -0.03 * left.get_ylim()[1]), BAD, 4, marker="|", markeredgewidth=1.2, clip_on=False)
    dressed(left, "count", "residual over its predicted sigma")
    keys(left, [("found", AFTER), ("expected", INK), *([("outliers", BAD)] if len(wild) else [])])
    _draw_ordered(right, view, freedom)


def _draw_ordered(ax: Axes, view: ReadingsView, freedom: float) -> None:
    distance = np.linalg.norm(view.whitened, axis=1)
    order = np.argsort(distance, kind="stable")
    n = len(order)
    expected = np.sqrt(2 * freedom * gammaincinv(1.5, (np.arange(n) + 0.5) / n))  # chi of three degrees of freedom
    found, out = distance[order], view.outlier[order]
    top = max(1.15 * expected[-1], 1.1 * float(found[~out].max(initial=1.0)))
    ax.plot([0, expected[-1]], [0, expected[-1]], color=INK, lw=0.8)
    dots(ax, expected, np.minimum(found, top), AFTER, 2.2)
    dots(ax, expected[out], np.minimum(found[out], top), BAD, 4, marker="x", markeredgewidth=1, clip_on=False)
    marked = np.flatnonzero(out)[-4:][::-1]
    words = [f"line {view.readings.line[order[k]]}: {found[k]:.0f} sigma" for k in marked]
    more = int(out.sum()) - len(marked)
    words += [f"and {more} more"] if more else []
    ax.text(0.03, 0.97, "\n".join(words), transform=ax.transAxes, va="top", fontsize=6.5, color=BAD)
    ax.set_ylim(0, top)
    ax.set_xlim(left=0)
    dressed(ax, "distance found, in sigmas", "distance expected, in sigmas", grid="both")


def worst_readings_table(view: ReadingsView) -> Table:
    """The readings that fit worst, outliers strong."""
    distance = np.linalg.norm(view.whitened, axis=1)
    order = np.argsort(-distance, kind="stable")[: max(WORST, int(view.outlier.sum()))][:40]
    r = view.readings
    rows = [
        (
            str(r.line[k]),
            named(r.targets[r.target[k]], "nest"),
            named(r.payloads[r.payload[k]], "payload"),
            ", ".join(f"{v:.1f}" for v in np.degrees(r.q[k])),
            mm(view.error[k]),
            f"{distance[k]:.1f}",
            "outlier" if view.outlier[k] else f"counts {view.weight[k]:.2f}",
        )
        for k in order
    ]
    strong = [place for place, k in enumerate(order) if view.outlier[k]]
    columns = ("line", "nest", "payload", "axes, deg", "error, mm", "sigmas", "in the fit")
    return table(columns, rows, text=(1, 2, 3, 6), strong=strong, title="The readings that fit worst")


LINES = 12  # outliers whose lines are listed
BY_CHANCE = 16.3  # chi-square of 3 degrees of freedom, exceeded 1 time in 1000
FEW_PAIRS = 4  # load tests from which their own sigma is believed


def noise_section(c: TrackerCalibration, view: ReadingsView) -> Section:
    """Sources of scatter, load tests, springs."""
    springs = load_test_springs_table(c)
    parts = (noise_table(c, view), load_test_words(c), *((springs,) if springs.rows else ()))
    return Section("Noise, repeats and load tests", parts)


def noise_table(c: TrackerCalibration, view: ReadingsView) -> Table:
    """Sources of scatter, each with its size and what it means."""
    fit, instrument = c.fit, c.fit.campaign.instrument
    distance = np.linalg.norm(view.readings.point, axis=1)
    rows: list[tuple[str, str, str]] = []
    if view.readings.sigma is not None:
        sigma = 1e6 * view.readings.sigma
        rows.append(("tracker, each direction", f"{sigma.min():.1f} to {sigma.max():.1f} µm", "from the file's column sigma_um"))
    else:
        across = 1e6 * (instrument.range_noise + instrument.transverse_noise * np.median(distance))
        rows.append(("tracker, along its beam", f"{1e6 * instrument.range_noise:.1f} µm", "from the cell file"))
        words = f"from the cell file, at the median range of {np.median(distance):.1f} m"
        rows.append(("tracker, across its beam", f"{across:.1f} µm", words))
    words = f"estimated from the residuals, the same for all axes; moves the reflector by {1e6 * view.joint_scatter:.0f} µm (3D)"
    rows.append(("joints", f"{1e6 * fit.noise.joints:.1f} µrad", words))
    rows.append(("residuals over this noise", f"{fit.spread:.2f}", _spread_words(fit.spread)))
    rows.append(("outliers", str(int(view.outlier.sum())), outlier_words(view)))
    return table(("source", "size", "what it says"), [*rows, *_repeat_rows(c)], text=(0, 2))


def _spread_words(spread: float) -> str:
    if spread > 1.3:
        return "the noise model explains only part: something moves the reflector that the model does not have"
    if spread < 0.77:
        return "the readings are better than the noise model says; lower the tracker's noise in the cell file"
    return "1 is as modelled"


def outlier_words(view: ReadingsView) -> str:
    """Which lines of the file are outliers."""
    lines = [str(n) for n in np.sort(view.readings.line[view.outlier])]
    if not lines:
        return "no reading is off the others"
    shown = lines[:LINES] + ([f"{len(lines) - LINES} more"] if len(lines) > LINES else [])
    return f"hardly counted in the fit and left out of the errors: line{'s' if len(lines) > 1 else ''} {listed(shown)}"


def _repeat_rows(c: TrackerCalibration) -> list[tuple[str, str, str]]:
    repeats = c.repeats
    if repeats is None:
        return [("repeats", "none", "no reading was taken twice: scatter and mistakes of the model cannot be told apart")]
    groups = count_of(repeats.groups, "posture")
    size = f"{mm(repeats.rms)} mm (3D)"
    if repeats.joints > 0:
        explained = f"{1e6 * repeats.joints:.1f} µrad of joint noise beside the tracker's"
    else:
        explained = "no more than the tracker's own noise"
    rows = [("repeats", size, f"{groups} read again, {repeats.freedom} degrees of freedom; that is {explained}")]
    if repeats.drift is not None:
        speed = 1e3 * repeats.drift
        sd = 1e3 * drift_sd(c)
        verdict = "beyond chance" if drift_is_real(c) else "no more than chance"
        words = (
            f"x {speed[0]:+.3f}, y {speed[1]:+.3f}, z {speed[2]:+.3f} mm/h in the tracker's frame, each ± {sd:.3f}: "
            f"{verdict}; taken out of the scatter above"
        )
        rows.append(("drift of the repeats", f"{np.linalg.norm(speed):.3f} mm/h", words))
    return rows


def drift_sd(c: TrackerCalibration) -> float:
    """One sigma m/h of a component of the repeats' drift: their scatter over how far apart in time they were taken."""
    repeats, r = c.repeats, c.fit.campaign.readings
    if repeats is None or r.time is None:
        return float("inf")
    group = r.repeats()
    hours = r.time / 3600.0
    mean = np.bincount(group, hours) / np.maximum(np.bincount(group), 1)
    return repeats.rms / np.sqrt(3.0) / max(float(np.sqrt(((hours - mean[group]) ** 2).sum())), 1e-9)


def drift_is_real(c: TrackerCalibration) -> bool:
    """Whether the drift is beyond what scatter alone gives 1 time in 1000 (chi-square of 3 degrees of freedom)."""
    if c.repeats is None or c.repeats.drift is None:
        return False
    return float((c.repeats.drift**2).sum()) > BY_CHANCE * drift_sd(c) ** 2


def load_test_words(c: TrackerCalibration) -> str:
    """What load tests are, or that there were none."""
    test = c.load_test
    if test is None:
        return "No posture was read under two loads, so the springs are told by the fit alone."
    joints = listed([f"A{j}" for j in test.joints])
    size = "one pair of readings shares a posture" if test.pairs == 1 else f"{test.pairs} pairs of readings share their postures"
    return (
        f"Load tests: {size} under different loads. There the reflector moved by {mm(test.before)} mm (median); with the "
        f"springs of {joints} from these pairs alone {mm(test.after)} mm are left. Fit and load test should agree within 3 "
        "sigmas."
    )


def load_test_springs_table(c: TrackerCalibration) -> Table:
    """Springs of the fit beside those of load tests alone, in compliance and as stiffness."""
    fit, test = c.fit, c.load_test
    fitted = {j: (fit.state.arm[29 + j], fit.sd[fit.layout.arm[29 + j]]) for j in range(1, 7) if fit.layout.arm[29 + j] >= 0}
    held = {} if test is None else dict(zip(test.joints, zip(test.compliance, test.sd, strict=True), strict=True))
    rows: list[tuple[str, ...]] = []
    for j in sorted({*fitted, *held}):
        value, sd = fitted.get(j, (np.nan, np.nan))
        other, other_sd = held.get(j, (np.nan, np.nan))
        row: tuple[str, ...] = (f"A{j}", _spring(c.believed.arm[29 + j]), _spring(value, sd), _stiffness(value))
        if test is not None:
            apart = _apart(other - value, float(np.hypot(sd, other_sd)), test.pairs)
            row = (*row, _spring(other, other_sd), _stiffness(other), apart)
        rows.append(row)
    columns: tuple[str, ...] = ("joint", "believed", "fitted", "as stiffness")
    if test is not None:
        columns = (*columns, "load test alone", "as stiffness", "apart, sigmas")
    return table(columns, rows, title="Springs: compliance in µrad/(N m), stiffness in 10^6 N m/rad")


def _apart(difference: float, sd: float, pairs: int) -> str:
    """Difference in sigmas; the scatter of very few pairs says nothing of their own sigma."""
    if not np.isfinite(difference):
        return ""
    return f"{difference / sd:+.1f}" if pairs >= FEW_PAIRS else "too few pairs"


def _spring(value: float, sd: float | None = None) -> str:
    if not np.isfinite(value):
        return ""
    if sd is None:
        return f"{1e6 * value:.4f}" if value > 0 else "rigid"
    return f"{1e6 * value:.4f} ± {1e6 * sd:.4f}"


def _stiffness(value: float) -> str:
    return f"{1e-6 / value:.3f}" if np.isfinite(value) and value > 0 else ""
