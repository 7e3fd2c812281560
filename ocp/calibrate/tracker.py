"""The calibration as a function: readings in, a fitted and judged arm out. Writing it is `ocp.calibrate.interface`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np

from ocp.calibrate.moved_stand import moved_stands
from ocp.effects.effect import Active
from ocp.effects.engine.readings import effects_on, has_columns, shown_in, without_effects
from ocp.model.cell import TrackerSetup, read_tracker_setup
from ocp.shell.progress import Phases
from robots.calibration.evidence import Term, choose_terms
from robots.calibration.fit import (
    Fit,
    fit_campaign,
    fit_learned,
    predict_readings,
    predictive_covariance,
    stated_turn_sd,
    with_turn_sd,
)
from robots.calibration.identifiability import Identifiability, described, identify, listed
from robots.calibration.layout import Choice, Layout, State
from robots.calibration.load_tests import LoadTest, load_test
from robots.calibration.methods import METHODS, before, calibrate_by, errors_as_calibrated
from robots.calibration.mistakes import refuse_loads, refuse_mistakes, refuse_units
from robots.calibration.noise import Repeats, repeat_scatter
from robots.calibration.parameters import BASE_NAMES
from robots.calibration.reading_model import ARM_NAMES, PAYLOAD_NAMES
from robots.calibration.residuals import linearise, residuals
from robots.calibration.solver import Campaign, OpenDirection
from robots.calibration.store import Calibration
from robots.calibration.student_t import GROSS
from robots.calibration.validation import FOLDS, LEAST_SWEEP, FoldErrors, by_kind, folds, hold_out, validate
from robots.column_mapping import ColumnMapping
from robots.csv_table import OURS
from robots.errors import BadInput
from robots.pose import Array, abc_by_spin, abc_from_rotation
from robots.robot import left_out_notices
from robots.tracker_readings import WORDS, Readings, read_readings

EFFECTS_TWICE = 2  # rounds: effects that are torques bend the joints through springs, which the first round makes right
LEAST_READINGS = 20
LEAST_POSTURES = 10
LEAST_OF_STATION = 4
LEAST_TRAVEL = np.radians(5.0)  # an axis that moved less did not move
BLOCKS = 10  # of readings left out, that the interval of a gain is told by
SEALED = "sealed_tracker.csv"
CLEARLY = 0.8  # of the mean error: a method below it does clearly better
CAREFUL = 0.4  # the same, of readings drawn blindly, below which they are far too large
SURE = 1.5  # error over prediction of a kind of fold above which the stated uncertainties are doubted
KINDS = {
    "random": "readings drawn blindly",
    "region": "a region of the workspace (axes 1 to 3)",
    "campaign": "a session",
    "payload": "a payload",
    "joint range": "the upper half of an axis' range",
}


@dataclass(frozen=True)
class MethodTable:
    """Absolute error (m,) m of each method on readings left out, in the same order `rows` (m,), and before calibration; both as
    vectors (m, 3) m, measured less predicted in the tracker's frame; earlier: mean m by the calibration that the cell had, on the
    same readings or, if that is more, on those that were left out of it then (None: nothing tells).
    """

    rows: Array
    before: Array
    earlier: float | None
    error: dict[str, Array]
    off_before: Array
    off: dict[str, Array]

    def gained(self, method: str) -> tuple[float, float]:
        """Mean error m before less that of a method, on the same readings left out, and half of its 95 % interval: by blocks of
        neighbouring rows, as errors of one posture or one time are alike."""
        gain = self.before - self.error[method]
        blocks = np.array([part.mean() for part in np.array_split(gain, min(BLOCKS, len(gain)))])
        half = 2.26 * blocks.std(ddof=1) / np.sqrt(len(blocks)) if len(blocks) > 1 else np.inf  # Student's t of 9 degrees
        return float(gain.mean()), float(half)


@dataclass(frozen=True)
class TrackerCalibration:
    """What the readings gave.

    fit of the chosen method; the believed arm with only the tracker placed; identifiability; held-out errors by fold; terms
    tried; repeats; load test; methods side by side; points (m, 3) m of the sealed conditions with their covariance.
    """

    setup: TrackerSetup
    method: str
    fit: Fit
    believed: State
    identifiability: Identifiability
    held_out: list[FoldErrors]
    terms: list[Term]
    repeats: Repeats | None
    load_test: LoadTest | None
    methods: MethodTable
    sealed: Readings | None
    sealed_points: Array | None
    sealed_covariance: Array | None
    notices: tuple[str, ...]

    @property
    def error_before(self) -> Array:
        """Distance (n,) m of each reading from the believed arm."""
        c = self.fit.campaign
        return np.asarray(np.linalg.norm(residuals(c.robot, c.readings, c.instrument, self.believed)[:, :3], axis=1))

    @property
    def error_after(self) -> Array:
        """Distance (n,) m of each reading from the fitted arm (not held out)."""
        return np.asarray(np.linalg.norm(self.fit.residual[:, :3], axis=1))


def calibrate_tracker(
    tracker: Path, cell: Path, method: str, phases: Phases, mapping: ColumnMapping = OURS
) -> TrackerCalibration:
    """Read by `mapping`, check, fit and judge. Raises BadInput of every part."""
    try:
        return _calibrate(tracker, cell, method, phases, mapping)
    except OpenDirection as error:
        what = ", ".join(dict.fromkeys(described(name) for name in error.names))
        raise BadInput(
            f"{tracker}: the readings leave open {what} (unknown{'s' * (len(error.names) > 1)} {', '.join(error.names)}), which "
            "no prior holds; measure more postures that move it, or give the nests' places in [tracker.targets]"
        ) from None


def _calibrate(tracker: Path, cell: Path, method: str, phases: Phases, mapping: ColumnMapping) -> TrackerCalibration:
    if method not in METHODS:
        raise BadInput(f"--method '{method}' is not one of {', '.join(METHODS)}")
    with phases.phase("readings"):
        setup = read_tracker_setup(cell)
        readings = read_readings(tracker, setup.payloads, setup.instrument, mapping=mapping)
        mapping.refuse_idle()  # a force log, where there is one, was read before
        campaign = Campaign(setup.robot, readings, setup.payloads, setup.instrument)
        _refuse_few(readings, campaign)
        refuse_mistakes(campaign)
        sealed = _sealed_beside(tracker, readings, setup, mapping)
    with phases.phase("fit"):
        choice = Choice(joints=tuple(j for j in setup.compliant_joints if setup.robot.stiffness[j - 1] > 0))
        campaign = with_turn_sd(campaign, choice)
        given, readings = readings, campaign.readings
        first = fit_campaign(campaign, choice)
        known = [one.active for one in setup.tables.believed]
        believed, warm = shown_in(known, readings), setup.tables.reference_temperature_C
        for _ in range(EFFECTS_TWICE if believed else 0):
            campaign = without_effects(replace(campaign, readings=readings), first.state, believed, warm)
            first = fit_campaign(campaign, choice, begin=first.state)
        refuse_loads(first)
        first = fit_learned(first)
    with phases.phase("terms"):
        chosen, terms = choose_terms(first) if method == "full" else (choice, [])
        full = first if chosen == choice else fit_campaign(campaign, chosen, first.priors, begin=first.state)
        fit = full if method == "full" else calibrate_by(method, campaign, chosen, first.priors)
    with phases.phase("held out"):
        held = validate(full, _refit(method))
    with phases.phase("methods", len(METHODS)) as advance:
        table = compare_methods(full, advance, held if method == "full" else [], setup.calibration)
    linear = linearise(campaign.robot, replace(readings, turn=None), campaign.instrument, full.layout, full.state)
    repeats = repeat_scatter(readings, campaign.instrument, linear.d_joints)
    on_top: Array | float = 0.0
    if sealed is not None and (seen := [a for a in believed if has_columns(a.effect, sealed)]):
        shift, on_top = effects_on(campaign, sealed, predict_readings(fit, sealed)[0], fit.state, seen, warm)
        sealed = replace(sealed, q=sealed.q + shift)
    return TrackerCalibration(
        setup=setup,
        method=method,
        fit=fit,
        believed=before(campaign, choice),
        identifiability=identify(fit),
        held_out=held,
        terms=terms,
        repeats=repeats,
        load_test=load_test(full),
        methods=table,
        sealed=sealed,
        sealed_points=None if sealed is None else predict_readings(fit, sealed)[0] + on_top,
        sealed_covariance=None if sealed is None else predictive_covariance(fit, sealed, repeats.joints if repeats else 0.0),
        notices=(
            *readings.notices,
            *left_out_notices(setup.robot),
            *_effect_notices(known, believed),
            *_turn_notice(given, readings),
            *(() if sealed is None else sealed.notices),
            *_notices(full),
        ),
    )


def _sealed_beside(tracker: Path, readings: Readings, setup: TrackerSetup, mapping: ColumnMapping) -> Readings | None:
    """Conditions to predict in the folder of the readings; None where it has none. Raises BadInput of the file."""
    beside = tracker.parent / SEALED
    if not lexists(beside) or beside.resolve() == tracker.resolve():  # what is no file is refused by its reader
        return None
    return as_in(read_readings(beside, setup.payloads, setup.instrument, True, mapping), readings)


def as_calibration(
    robot: str,
    layout: Layout,
    state: State,
    covariance: Array,
    station: int | None = None,
    rigid: Sequence[int] = (),
    payload: int | None = None,
    provenance: dict[str, Any] | None = None,
    not_identified: dict[str, str] | None = None,
) -> Calibration:
    """A fit's state as named parameters: the arm's unknowns, joints `rigid` (1..6) without their springs, the payload of an
    index, the base in a station's frame (None: the arm alone). covariance (p, p) begins with the layout's unknowns."""
    fitted = np.flatnonzero(layout.arm >= 0)
    names = [*(ARM_NAMES[i] for i in fitted), *(f"c{j}" for j in rigid)]
    values = [*state.arm[fitted], *np.zeros(len(rigid))]
    columns = [*layout.arm[fitted], *np.full(len(rigid), -1)]
    if payload is not None:
        names += PAYLOAD_NAMES
        values += [*state.payloads[payload]]
        columns += [*layout.payload[payload]]
    known = np.array(columns) >= 0
    to_named = np.zeros((len(names), len(covariance)))
    to_named[np.flatnonzero(known), np.array(columns)[known]] = 1.0
    if station is not None:
        T, base = state.stations[station], np.zeros((6, len(covariance)))
        base[:3, layout.station[station, :3]], base[3:, layout.station[station, 3:]] = np.eye(3), abc_by_spin(T)
        names += BASE_NAMES
        values += [*T[:3, 3], *abc_from_rotation(T[:3, :3])]
        to_named = np.vstack([to_named, base])
    named = to_named @ covariance @ to_named.T
    return Calibration(
        robot=robot,
        names=tuple(names),
        values=np.array(values),
        covariance=0.5 * (named + named.T),
        provenance=provenance or {},
        not_identified=not_identified or {},
    )


def compare_methods(
    fit: Fit, advance: Callable[[], None], held: Sequence[FoldErrors] = (), known: Calibration | None = None
) -> MethodTable:
    """All methods on the same random folds as `fit`: errors of every reading when it was left out. held: what is known of the
    method full already; known: the cell's own calibration."""
    blocks = [f for f in folds(fit.campaign) if f.kind == "random"][:FOLDS]
    off: dict[str, Array] = {}
    rows = np.array([], int)
    for method in METHODS:
        kept = [h for h in held if h.fold.kind == "random"] if method == "full" else []
        kept = kept or [h for h in (hold_out(fit, fold, _refit(method)) for fold in blocks) if h is not None]
        rows = np.concatenate([h.rows for h in kept]) if kept else rows
        off[method] = np.concatenate([h.off for h in kept]) if kept else np.empty((0, 3))
        advance()
    order = np.argsort(rows)
    c = fit.campaign
    off = {method: vectors[order] for method, vectors in off.items()}
    believed = _off(c, before(c, fit.choice))[rows[order]]
    size = {method: np.linalg.norm(vectors, axis=1) for method, vectors in off.items()}
    earlier = None if known is None else _error_of(c, known, rows)
    return MethodTable(rows[order], np.linalg.norm(believed, axis=1), earlier, size, believed, off)


def _off(c: Campaign, state: State) -> Array:
    """Vectors (n, 3) m, measured less predicted by a state."""
    return residuals(c.robot, c.readings, c.instrument, state)[:, :3]


def _error_of(c: Campaign, known: Calibration, rows: Array) -> float | None:
    """`MethodTable.earlier`: readings that a calibration was fitted to it meets too well, so how it met those left out must be
    told too."""
    told = known.held_out_error
    if not len(rows) or told is None:
        return None
    return max(float(errors_as_calibrated(c, known)[rows].mean()), told)


def doubts_about(c: TrackerCalibration) -> list[str]:
    """What speaks against a calibration, in sentences: axes that stood, a tracker that did not, another method that does better,
    errors above what the model states."""
    error, words = c.methods.error, [one.words for one in moved_stands(c.fit)]
    stood = [str(j + 1) for j in np.flatnonzero(np.ptp(c.fit.campaign.readings.q, axis=0) < LEAST_SWEEP)]
    if stood:
        axes = f"Axis {stood[0]}" if len(stood) == 1 else f"Axes {listed(stood)}"
        words.append(f"{axes} hardly moved (under {np.degrees(LEAST_SWEEP):.0f} deg): what is told holds near there only.")
    if len(c.methods.rows):
        after, best = error[c.method], min(error, key=lambda method: float(error[method].mean()))
        if after.max() > c.methods.before.max():
            words.append("The worst reading is further off than before.")
        if error[best].mean() < CLEARLY * after.mean():
            words.append(f"Method '{best}' does better: {1e3 * error[best].mean():.3f} mm on average.")
    found = {kind: figures["over_predicted"] for kind, figures in by_kind(c.held_out).items()}
    if found.get("random", 1.0) < CAREFUL:
        words.append(
            f"Errors left out are {found['random']:.2g} times what it states: many outliers, or a noise stated too large "
            "(sigma_um, [tracker])."
        )
    return words + [
        f"Where {KINDS[kind]} {'are' if kind == 'random' else 'is'} left out, errors are {over:.1f} times what it states."
        for kind, over in found.items()
        if over > SURE
    ]


def _refit(method: str) -> Callable[[Campaign, Fit], Fit] | None:
    """How a method fits what is left without a fold; None: as the fit that is judged."""
    return None if method == "full" else lambda left, near: calibrate_by(method, left, near.choice, near.priors, near.state)


def as_in(sealed: Readings, readings: Readings) -> Readings:
    """`sealed` with its targets, payloads, stations and sessions numbered as in `readings`, by their names; where it names no
    target or station and only one was measured, that one. Raises BadInput for a target or station that was not measured, a
    payload that neither the cell nor the readings know. The motions to them count from the readings, too; its notices are those
    of columns that were ignored, or that `readings` has and it lacks."""
    for kind in WORDS:
        index, names, own = getattr(sealed, kind), getattr(sealed, f"{kind}s"), getattr(readings, f"{kind}s")
        measured = kind in ("target", "station")  # their places come from readings alone
        known = {own[k] for k in np.unique(getattr(readings, kind))} if measured else {*own}
        if measured and names == ("",) and "" not in known:
            if len(known) > 1:
                some = ", ".join(sorted(known))
                raise BadInput(f"{sealed.path}: no column {kind}, or an empty one, and {readings.path.name} has {some}; add it")
            index, names = np.zeros(len(sealed), np.int64), (min(known),)
        if kind == "session":  # a new one is no fault: nothing is fitted to a session
            own = (*own, *(name for name in names if name not in known))
            known = {*own}
        for row, k in enumerate(index):
            if names[k] not in known:
                raise BadInput(
                    f"{sealed.path}, line {sealed.line[row]}, column {kind}: '{names[k]}' was not measured in "
                    f"{readings.path.name}, so {'where it is' if measured else 'what hangs there'} is not known; remove the row "
                    "or measure it"
                )
        numbers = np.array([own.index(name) if name in known else -1 for name in names], np.int64)
        sealed = replace(sealed, **{kind: numbers[index], f"{kind}s": own})
    told = [notice for notice in sealed.notices if "ignored" in notice or "taken to hang" in notice]
    columns = {"approach": "approach1 .. approach6", "temperature": "temperature_C", "time": "time_s"}
    lacking = [c for name, c in columns.items() if getattr(readings, name) is not None and getattr(sealed, name) is None]
    if lacking:
        has = f"without {', '.join(lacking)}, which {readings.path.name} has"
        told.append(f"{sealed.path.name}: {has}, what goes with them is not in what is predicted")
    return replace(sealed, notices=tuple(told)).among(readings)


def _refuse_few(readings: Readings, campaign: Campaign) -> None:
    postures = len(np.unique(np.round(readings.q, 4), axis=0))
    still = [j + 1 for j in range(6) if np.ptp(readings.q[:, j]) < LEAST_TRAVEL]
    if len(readings) < LEAST_READINGS:
        raise BadInput(
            f"{readings.path}: {len(readings)} readings are too few to calibrate an arm, at least {LEAST_READINGS} are needed "
            "(40 are good); `python -m ocp.poses` says where to measure"
        )
    for k in np.unique(readings.station):
        seen = int((readings.station == k).sum())
        if seen < LEAST_OF_STATION:
            raise BadInput(
                f"{readings.path}, line {readings.line[readings.station == k][0]}, column station: '{readings.stations[k]}' has "
                f"few readings ({seen}), {LEAST_OF_STATION} are needed to place it; correct the name or measure more from there"
            )
    if postures < LEAST_POSTURES or len(still) > 2:
        refuse_units(campaign)  # axes in radians hardly move
        what = f"{postures} different postures" if postures < LEAST_POSTURES else f"axes {', '.join(map(str, still))} never moved"
        raise BadInput(
            f"{readings.path}: {what}, so the readings cannot tell the arm's errors apart; spread at least {LEAST_POSTURES} "
            "postures over the axes, `python -m ocp.poses` says where"
        )


def _effect_notices(known: Sequence[Active], taken: Sequence[Active]) -> list[str]:
    """What became of the effects that the cell believes."""
    words = [f"{a.effect.name}{f' of joint {a.joint}' if a.joint else ''}" for a in taken]
    found = [f"the cell's effects were taken out of the readings first: {', '.join(words)}"] if words else []
    return found + [
        f"the cell's effect {a.effect.name} stays in the readings: they lack a column ({', '.join(a.effect.needs)})"
        for a in known
        if a.effect.on_arm and not any(a is one for one in taken)
    ]


def _turn_notice(given: Readings, used: Readings) -> list[str]:
    """How sure orientations are taken to be where the file does not say, or says far too much or too little."""
    if used.sigma_turn is None or used.sigma_turn is given.sigma_turn:
        return []
    stated = stated_turn_sd(given)
    told = "no column sigma_rot_deg" if stated is None else f"sigma_rot_deg, in degrees, states {np.degrees(stated):.2g}"
    sd = f"{np.degrees(used.sigma_turn[0]):.2g} deg"
    return [f"{told}: the 6D target's orientation is taken as good to {sd}, as it scatters about the arm"]


def _notices(fit: Fit) -> list[str]:
    """What the user should know of the readings."""
    readings, found = fit.campaign.readings, []
    gross = np.flatnonzero(fit.weight < GROSS)
    if len(gross):
        lines = ", ".join(str(readings.line[i]) for i in gross[:8]) + (", .." if len(gross) > 8 else "")
        word = "is an outlier" if len(gross) == 1 else "are outliers"
        found.append(f"{len(gross)} of {len(readings)} readings {word} and hardly counted (line{'s' * (len(gross) > 1)} {lines})")
    for j in fit.choice.joints:
        column = fit.layout.arm[29 + j]
        if fit.state.arm[29 + j] < -2 * fit.sd[column]:
            found.append(
                f"the spring of joint {j} comes out negative ({fit.state.arm[29 + j]:.2g} rad/(N m)): it stands for something "
                "else, as a payload, a mounting that is not upright or a sign; it predicts, but it is no stiffness"
            )
    return found
