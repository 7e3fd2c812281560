"""The section "What to measure next": plain rules over what the readings lack, the most useful first.

docs/calibrate.md lists them.
"""

import numpy as np

from ocp.calibrate.report.held_out import beyond_chance, fold_name
from ocp.calibrate.report.residuals import drift_is_real
from ocp.calibrate.report.view import ReadingsView, count_of, mm, present
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Points
from ocp.report.section import Section
from robots.calibration.identifiability import listed
from robots.calibration.parameters import SYMBOLS
from robots.calibration.validation import FoldErrors
from robots.pose import Array

ENOUGH = 40  # readings, three nests, five repeated postures, five load tests: what a good afternoon gives
NESTS, REPEATED, LOADED = 3, 5, 5
ONE_SIDED = 0.2  # least share of approaches from either side
COVERED = 0.4  # of an axis' range that readings should span
WORSE = 1.5  # error over prediction of a fold that extrapolates badly


def advice_section(c: TrackerCalibration, view: ReadingsView, tellable: dict[str, bool]) -> Section:
    """A numbered list."""
    todo = advice(c, view, tellable)
    part = Points(tuple(todo), numbered=True) if todo else "Nothing is lacking that these rules know of."
    return Section("What to measure next", (part,))


def advice(c: TrackerCalibration, view: ReadingsView, tellable: dict[str, bool]) -> list[str]:
    """Sentences, the most useful first; empty where nothing is lacking."""
    found = [*_enough(c, view), *_folds(c), *_payloads(c), *_poses(c, tellable), *_nests(c), *_repeats(c, view), *_columns(c)]
    return list(dict.fromkeys(found))


def _enough(c: TrackerCalibration, view: ReadingsView) -> list[str]:
    n = len(c.fit.campaign.readings)
    if n < ENOUGH:
        return [f"Take more readings: {n} are few, {ENOUGH} are good (`python -m ocp.poses` says where)."]
    gone = int(view.outlier.sum())
    if gone > 0.1 * n:
        return [f"Look for the reason of the outliers: {gone} of {n} readings is more than a loose reflector now and then."]
    return []


def _folds(c: TrackerCalibration) -> list[str]:
    """Folds whose errors are worse than stated by more than chance."""
    found = []
    for h in sorted(c.held_out, key=lambda h: -_over(h)):
        if h.fold.kind == "random" or not extrapolates_badly(h):
            continue
        figures = h.figures()
        size = f"left out, it is predicted {_over(h):.1f} times worse than stated ({mm(figures['mean'])} mm on average)"
        if h.fold.kind == "payload":
            found.append(f"Measure more with payload '{h.fold.name}': {size}; how it pulls is not in the model yet.")
        elif h.fold.kind == "joint range":
            found.append(f"Measure more with {h.fold.name}: {size}; the model does not carry over from the rest of the range.")
        elif h.fold.kind == "region":
            found.append(f"Measure more {fold_name(c, h)}: {size}.")
        else:
            found.append(
                f"Find out what changed in {h.fold.kind} '{h.fold.name}': {size}; read a few postures of another one again."
            )
    return found


def _over(h: FoldErrors) -> float:
    return h.figures()["over_predicted"]


def extrapolates_badly(h: FoldErrors) -> bool:
    """Whether a fold's errors are above WORSE times the prediction and beyond chance."""
    return _over(h) > WORSE and beyond_chance(h)


def _payloads(c: TrackerCalibration) -> list[str]:
    r, payloads = c.fit.campaign.readings, c.fit.campaign.payloads
    read = {r.payloads[k] for k in present(r.payload)}
    work = c.setup.tables.workpiece
    found = []
    if work is not None and work.payload is not None and work.payload not in read:
        found.append(f"Measure with payload '{work.payload}', which hangs there while grinding: it was never read.")
    if len(read) == 1 and len(payloads) < 2 and not np.abs(r.load).any():
        found.append(
            "Measure with a second, heavier payload: with one alone the springs show only in how the arm's weight shifts, and "
            "a wrong mass cannot be told from a soft joint."
        )
    elif len(read) == 1 and not np.abs(r.load).any():
        others = listed([f"'{name}'" for name in payloads if name not in read])
        found.append(
            f"Measure with another payload too ({others}): all readings have one and the same, so a wrong mass looks "
            "like a spring."
        )
    missing = [p for p in payloads if p not in read and (work is None or p != work.payload)]
    if missing and len(read) > 1:
        names = listed([f"'{name}'" for name in missing])
        found.append(f"Where the robot is to carry {names}: measure with it; the cell lists it and it was never read.")
    test = c.load_test
    if test is None or test.pairs < LOADED:
        have = "no posture was" if test is None else "one pair was" if test.pairs == 1 else f"{test.pairs} pairs were"
        found.append(
            f"Hold {LOADED} postures and read each without and with a load: {have} read so, and geometry drops out of these."
        )
    return found


def _poses(c: TrackerCalibration, tellable: dict[str, bool]) -> list[str]:
    robot, r = c.fit.campaign.robot, c.fit.campaign.readings
    found = []
    names = [name for name, can in tellable.items() if can]
    if names:
        shown = listed([f"{n} ({SYMBOLS[n].meaning})" for n in names[:6]])
        found.append(f"Choose poses that tell {shown}: other poses would (`python -m ocp.poses`).")
    share = np.ptp(r.q, axis=0) / np.minimum(robot.q_max - robot.q_min, 2 * np.pi)  # a turn repeats itself
    for j in np.flatnonzero(share < COVERED):
        low, high = np.degrees([r.q[:, j].min(), r.q[:, j].max()])
        found.append(
            f"Move A{j + 1} further: it was read from {low:.0f} to {high:.0f} deg, {100 * share[j]:.0f} % of its range; "
            "beyond is extrapolation."
        )
    if c.sealed is not None:
        found += _asked_outside(c.sealed.q, r.q)
    return found


def _asked_outside(asked: Array, read: Array) -> list[str]:
    """Axes on which the conditions to predict lie outside of what was read."""
    low, high = read.min(axis=0), read.max(axis=0)
    count = ((asked < low) | (asked > high)).sum(axis=0)
    far = ((asked < low - np.radians(5)) | (asked > high + np.radians(5))).any(axis=0)
    outside = [f"A{j + 1} ({count_of(int(count[j]), 'pose')})" for j in np.flatnonzero(far)]
    what = "The poses to predict go beyond what was read by more than 5 deg on"
    return [f"{what} {listed(outside)}: read there too."] if outside else []


def _nests(c: TrackerCalibration) -> list[str]:
    r = c.fit.campaign.readings
    count = len(present(r.target))
    found = []
    if count < NESTS:
        how = "one reflector nest" if count == 1 else f"{count} reflector nests"
        found.append(
            f"Read {NESTS} nests that are not on a line: with {how} the flange's turn about {'them' if count > 1 else 'it'} "
            "is not seen, and the blade is bolted to the flange."
        )
    inside = [h.name for h in c.identifiability.hidden if any(n.startswith("nest") for n in h.company)]
    if inside:
        found.append(
            f"Measure the places of the nests on the flange and give them in the cell ([tracker.targets], target_sd_mm): "
            f"{listed(inside)} {'hide' if len(inside) > 1 else 'hides'} in them. For these nests that spoils nothing, for what "
            "is bolted to the flange it is an offset."
        )
    return found


def _repeats(c: TrackerCalibration, view: ReadingsView) -> list[str]:
    repeats = c.repeats
    if repeats is None or repeats.groups < REPEATED:
        have = "none was" if repeats is None else "only one was" if repeats.groups == 1 else f"only {repeats.groups} were"
        found = [
            f"Read {REPEATED} postures three times, spread over the day: {have} read again, and only repeats tell "
            f"scatter from what the model lacks."
        ]
    else:
        found = []
    time = view.readings.time
    if repeats is not None and repeats.drift is not None and time is not None and drift_is_real(c):
        moved = float(np.linalg.norm(repeats.drift)) * np.ptp(time) / 3600.0
        if moved > repeats.rms:
            found.append(
                f"Let the robot warm up or read a nest on the base now and then: repeats wandered by {mm(moved)} mm "
                f"while measuring."
            )
    return found


def _columns(c: TrackerCalibration) -> list[str]:
    r, found = c.fit.campaign.readings, []
    if r.approach is None:
        found.append(
            "Write the sign of each axis' last motion (approach1 to approach6) and come from both sides: backlash needs it."
        )
    else:
        share = np.minimum((r.approach > 0).mean(axis=0), (r.approach < 0).mean(axis=0))
        sides = [f"A{j + 1}" for j in np.flatnonzero(share < ONE_SIDED)]
        if sides:
            found.append(f"Come from the other side too on {listed(sides)}: backlash there cannot be told from an offset.")
    if r.temperature is None:
        found.append("Write temperature_C: growth of the arm with temperature cannot be seen without it.")
    if r.time is None:
        found.append("Write time_s: drift of tracker and robot cannot be seen without it.")
    return found
