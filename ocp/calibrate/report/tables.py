"""Tables of how good the calibration is and of what it found besides the parameters."""

import numpy as np

from ocp.calibrate.report.parameters import signed
from ocp.calibrate.report.view import ReadingsView, held_out_in_base, named
from ocp.calibrate.report.words import KINDS, mm, term_verdict
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Table, table
from robots.calibration.identifiability import Hidden, described
from robots.calibration.validation import by_kind
from robots.pose import Array

WORST = 8  # readings listed
FEW_PAIRS = 4  # load tests from which their own sigma is believed
METHOD_WORDS = {
    "full": "full: geometry and springs in one fit",
    "geometry": "geometry: without springs",
    "relative": "relative: differences of readings, springs inside",
    "relative-literal": "relative-literal: the paper's order, springs added afterwards",
}


def methods_table(c: TrackerCalibration) -> Table:
    """Maximum, mean and standard deviation of the absolute error and of x, y, z: the paper's Table 2."""
    m = c.methods
    rows = [_method_row("before: as believed, tracker placed", m.before, held_out_in_base(c, m.off_before))]
    rows += [_method_row(METHOD_WORDS.get(k, k), e, held_out_in_base(c, m.off[k])) for k, e in m.error.items()]
    columns = ("mm", "maximum", "mean", "std. dev.", "mean |x|", "mean |y|", "mean |z|")
    return table(columns, rows, strong=[1 + list(m.error).index(c.method)])


def _method_row(name: str, error: Array, off: Array) -> tuple[str, ...]:
    return (name, *(mm(v) for v in (error.max(), error.mean(), error.std(), *np.abs(off).mean(axis=0))))


def folds_table(c: TrackerCalibration) -> Table:
    """Errors by what was left out."""
    rows = [
        (
            KINDS.get(kind, kind), f"{f['folds']:.0f}", f"{f['readings']:.0f}", *(mm(f[k]) for k in ("max", "mean", "sd", "rms")),
            f"{f['over_predicted']:.2f}",
        )
        for kind, f in by_kind(c.held_out).items()
    ]  # fmt: skip
    columns = ("left out", "folds", "readings", "max, mm", "mean, mm", "std. dev., mm", "rms, mm", "error / prediction")
    return table(columns, rows)


def worst_table(view: ReadingsView) -> Table:
    """The readings that fit worst, outliers strong."""
    distance = np.linalg.norm(view.whitened, axis=1)
    order = np.argsort(-distance, kind="stable")[: max(WORST, int(view.outlier.sum()))][:40]
    r = view.readings
    rows = [
        (
            str(r.line[k]), named(r.targets[r.target[k]], "nest"), named(r.payloads[r.payload[k]], "payload"),
            ", ".join(f"{v:.1f}" for v in np.degrees(r.q[k])), mm(view.error[k]), f"{distance[k]:.1f}",
            "outlier" if view.outlier[k] else f"counts {view.weight[k]:.2f}",
        )
        for k in order
    ]  # fmt: skip
    strong = [place for place, k in enumerate(order) if view.outlier[k]]
    columns = ("line", "nest", "payload", "axes, deg", "error, mm", "sigmas", "in the fit")
    return table(columns, rows, text=(1, 2, 3, 6), strong=strong, title="The readings that fit worst")


def hidden_table(c: TrackerCalibration, tellable: dict[str, bool]) -> Table:
    """What the readings do not determine, and whether other poses could."""
    rows = [
        (
            h.name, described(h.name).removeprefix(f"{h.name} "
            f"(").removesuffix(")"), f"{min(h.ratio, 1.0):.2f}", h.sentence().removesuffix("; the believed values share it out"),
            _how_to_tell(h, tellable.get(h.name, False)),
        )
        for h in c.identifiability.hidden
    ]  # fmt: skip
    columns = ("parameter", "what it is", "sigma left of prior", "what the readings say", "would be told by")
    return table(columns, rows, text=(0, 1, 3, 4))


def _how_to_tell(hidden: Hidden, by_poses: bool) -> str:
    """What would determine a parameter."""
    if by_poses:
        return "other poses"
    if any(name.startswith("nest") for name in hidden.company):
        return "measuring the nests on the flange"
    return "no pose"


def terms_table(c: TrackerCalibration) -> Table:
    """Candidates with their gain."""
    rows = [(t.name, signed(t.gain, 1), f"{t.sigma:.1f}" if t.sigma else "not tried", term_verdict(t)) for t in c.terms]
    strong = [k for k, t in enumerate(c.terms) if t.accepted]
    return table(("term", "gain", "over its error", "verdict"), rows, text=(0, 3), strong=strong)


def springs_table(c: TrackerCalibration) -> Table:
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
