"""The section "Noise, repeats and load tests": what scatters and by how much, and the springs that load tests tell."""

import numpy as np

from ocp.calibrate.report.view import ReadingsView, count_of, listed, mm
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Table, table
from ocp.report.section import Part, Section

LINES = 12  # outliers whose lines are listed
BY_CHANCE = 16.3  # chi-square of 3 degrees of freedom, exceeded 1 time in 1000
FEW_PAIRS = 4  # load tests from which their own sigma is believed


def noise_section(c: TrackerCalibration, view: ReadingsView) -> Section:
    """Sources of scatter, load tests, springs."""
    parts: tuple[Part | str, ...] = (noise_table(c, view), load_test_words(c))
    springs = load_test_springs_table(c)
    return Section("Noise, repeats and load tests", (*parts, springs) if springs.rows else parts)


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
