"""The report of a calibration as sections: what stands in which order."""

from collections.abc import Sequence

from ocp.calibrate.report.advice import advice, tellable_parameters
from ocp.calibrate.report.circumstances import circumstances_plot
from ocp.calibrate.report.errors import components_plot, folds_plot, methods_plot
from ocp.calibrate.report.maps import joints_plot, map_plot
from ocp.calibrate.report.noise import load_test_words, noise_table
from ocp.calibrate.report.parameters import geometry_table, nests_table, springs_and_payloads_table, stations_table
from ocp.calibrate.report.spectrum import seen_plot, whitened_plot
from ocp.calibrate.report.tables import (
    folds_table,
    hidden_table,
    methods_table,
    springs_table,
    terms_table,
    worst_table,
)
from ocp.calibrate.report.view import ReadingsView
from ocp.calibrate.report.words import terms_note
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Points, made_from
from ocp.report.section import Part, Section


def calibration_sections(
    c: TrackerCalibration, view: ReadingsView, hashes: dict[str, str], extra: Sequence[Section]
) -> list[Section]:
    """All sections after the headline; `extra` stands before what to measure next."""
    tellable = tellable_parameters(c)
    todo = advice(c, view, tellable)
    next_part: Part | str = Points(tuple(todo), numbered=True) if todo else "Nothing is lacking that these rules know of."
    return [
        _before_and_after(c),
        _left_out(c),
        _left_over(c, view),
        Section(
            "Parameters",
            (
                "Absolute values; the change is against the believed robot. Grey: the readings tell it only in company, or it "
                "was held. "
                "One sigma is of the estimate alone; in company many are worth far less than their differences.",
                geometry_table(c), springs_and_payloads_table(c), nests_table(c), stations_table(c),
            ),
        ),
        _told_apart(c, tellable),
        _terms(c),
        _noise(c, view),
        *extra,
        Section("What to measure next", (next_part,)),
        made_from(hashes),
    ]  # fmt: skip


def _before_and_after(c: TrackerCalibration) -> Section:
    title = "Before and after, on readings left out"
    if not len(c.methods.rows):
        words = (
            f"{len(c.fit.campaign.readings)} readings are too few to leave a fifth of them out, fit the rest and judge it. "
            f"Take 40 or more."
        )
        return Section(title, (words,))
    springs = [f"A{j}" for j in range(1, 7) if c.believed.arm[29 + j] > 0]
    held = f"springs of {', '.join(springs)} as believed" if springs else "no springs"
    words = (
        "Every method was fitted five times to four fifths of the readings and had to predict the other fifth; repeats stay "
        "on one side. "
        f"'Before' is the believed robot with {held}, and only tracker and nests placed by the same readings."
    )
    return Section(title, (words, methods_table(c), methods_plot(c), components_plot(c)))


def _left_out(c: TrackerCalibration) -> Section:
    title = "Where it was not fitted"
    if not c.held_out:
        return Section(title, ("No part of the readings could be left out: at least 15 must remain and 5 be predicted.",))
    words = (
        "Errors where a whole part of the readings was left out. Blind draws show how good it is among the poses measured; "
        "regions, payloads "
        "and joint ranges show how far it carries beyond them."
    )
    return Section(title, (words, folds_table(c), folds_plot(c)))


def _left_over(c: TrackerCalibration, view: ReadingsView) -> Section:
    freedom = max(1.0 - c.fit.layout.size / (3.0 * len(view.point)), 0.1)
    words = (
        "What the fitted arm leaves of the readings it was fitted to. A model that has everything leaves noise without a pattern."
    )
    return Section(
        "What is left over",
        (words, map_plot(view), joints_plot(view), circumstances_plot(view), whitened_plot(view, freedom), worst_table(view)),
    )


def _told_apart(c: TrackerCalibration, tellable: dict[str, bool]) -> Section:
    found = c.identifiability
    words = (
        f"The readings determine {found.rank} independent directions of the robot's {found.parameters} parameters. The other "
        f"parameters "
        "are told only together: any split between them gives the same readings, and the believed values decide it."
    )
    if not found.hidden:
        return Section("What cannot be told apart", (words, seen_plot(c), "Every parameter is determined on its own."))
    return Section("What cannot be told apart", (words, seen_plot(c), hidden_table(c, tellable)))


def _terms(c: TrackerCalibration) -> Section:
    given = [f"A{j}" for j in c.fit.choice.joints]
    model = f"The model has the geometry{' and the springs of ' + ', '.join(given) if given else ' without springs'}"
    payloads = [f"'{p}'" for p in c.fit.choice.payloads]
    model += f", and mass and centre of {', '.join(payloads)}." if payloads else "."
    if not c.terms:
        return Section("Terms tried", (f"{model} Method '{c.method}' tries no further terms.",))
    return Section("Terms tried", (f"{model} {terms_note()}", terms_table(c)))


def _noise(c: TrackerCalibration, view: ReadingsView) -> Section:
    parts: tuple[Part | str, ...] = (noise_table(c, view), load_test_words(c))
    springs = springs_table(c)
    return Section("Noise, repeats and load tests", (*parts, springs) if springs.rows else parts)
