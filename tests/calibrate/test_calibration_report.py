"""The calibration's report: the numbers of the fit in it, nothing smuggled in, equal bytes, what to do next."""

import base64
import hashlib
import pickle
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from ocp.calibrate.interface import _calibrated, _use
from ocp.calibrate.report.advice import advice, extrapolates_badly
from ocp.calibrate.report.pages import calibration_headline, write_calibration_report
from ocp.calibrate.report.parameters import tellable_parameters, term_verdict
from ocp.calibrate.report.residuals import drift_is_real
from ocp.calibrate.report.view import held_out_in_base, look_at
from ocp.calibrate.tracker import MethodTable, TrackerCalibration, doubts_about
from ocp.report.parts import Plot, Points, table
from ocp.report.plotting import Canvas
from ocp.report.section import Section
from robots.calibration.evidence import Term
from robots.calibration.identifiability import Hidden
from robots.calibration.load_tests import LoadTest
from robots.calibration.parameters import MDH_NAMES
from robots.calibration.residuals import residuals
from robots.calibration.validation import FoldErrors, ReadingFold
from robots.errors import Infeasible
from tests.support.browser import NEEDED, looked_at
from tests.support.calibration_example import SIGMA, example_calibration, with_names

HOSTILE = '</td><script>alert("x")</script><img src=x onerror=alert(1)>&amp;\'$\\frac{$ 叶片 \x00'
VOID = {"meta", "br", "img", "input", "link", "hr"}
HASHES = {"tracker.csv": "ab" * 32, "cell.toml": "cd" * 32}


class Page(HTMLParser):
    """Elements, words and table rows of a page; fails where tags do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.rows: list[list[str]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] == "style":
            return
        self.words.append(data)
        if self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data

    @property
    def told(self) -> str:
        return " ".join(" ".join(self.words).split())

    def row(self, name: str) -> list[str]:
        return next(row for row in self.rows if name in row[:2])


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> TrackerCalibration:
    return example_calibration(tmp_path_factory.mktemp("campaign"))


@pytest.fixture(scope="module")
def written(made, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write_calibration_report(made, folder, HASHES, [extra_section()])
    return folder


def extra_section() -> Section:
    def draw(canvas: Canvas) -> None:
        canvas.subplots(1, 1).plot([0, 1], [0, 1])

    parts = ("A paragraph of the force side.", table(("what", "N"), [("force", "20.125")]), Points(("one",)))
    return Section("Contact", (*parts, Plot("contact", "A line.", 1.5, draw)))


def page_of(c: TrackerCalibration, folder: Path, **options) -> Page:
    write_calibration_report(c, folder, HASHES, **options)
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def bare(c: TrackerCalibration) -> TrackerCalibration:
    """The calibration as if the campaign had been too small for everything that can be absent."""
    none = np.empty((0, 3))
    empty = dict.fromkeys(c.methods.error, np.array([]))
    methods = MethodTable(np.array([], int), np.array([]), None, empty, none, dict.fromkeys(empty, none))
    readings = replace(c.fit.campaign.readings, time=None, temperature=None, approach=None)
    fit = replace(c.fit, campaign=replace(c.fit.campaign, readings=readings))
    seen = replace(c.identifiability, hidden=())
    return replace(
        c, fit=fit, methods=methods, held_out=[], terms=[], repeats=None, load_test=None, notices=(), identifiability=seen
    )


@NEEDED
def test_the_page_stands_in_a_browser(written):
    looked_at(written / "report.html")


def test_the_page_has_the_numbers_of_the_fit(made, written):
    page = Page((written / "report.html").read_text(encoding="utf-8"))
    for method, error in made.methods.error.items():
        row = next(r for r in page.rows if r[0].startswith(f"{method}:"))
        assert row[1:4] == [f"{1e3 * v:.3f}" for v in (error.max(), error.mean(), error.std())]
    before = next(r for r in page.rows if r[0].startswith("before"))
    np.testing.assert_allclose(float(before[2]), 1e3 * made.methods.before.mean(), atol=5.1e-4)
    for k, name in enumerate(MDH_NAMES):
        believed, estimate, change, sd = (float(v) for v in page.row(name)[3:7])
        value = 1e3 * made.fit.state.arm[k]
        assert abs(estimate - value) < 5.1e-5 and abs(believed + change - value) < 1.1e-4
        assert abs(sd - 1e3 * made.fit.sd[made.fit.layout.index(name)]) < 5.1e-5
    assert abs(float(page.row("c3")[4]) - 1e6 * made.fit.state.arm[32]) < 5.1e-5
    for words in (*made.notices, *HASHES.values(), f"rank {made.identifiability.rank} of {made.identifiability.parameters}"):
        assert words in page.told
    assert f"{1e3 * made.methods.error['full'].mean():.3f} mm on average" in page.told


def test_page_stands_alone_and_runs_nothing(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert "http" not in text.replace("http-equiv", "") and "@import" not in text
    for tag, attributes in page.elements:
        assert tag not in {"script", "link", "iframe", "object", "embed", "base", "img"}
        assert not {"src", "srcset", "action", "style"} & attributes.keys()
        assert not any(name.startswith("on") for name in attributes)
        assert (attributes.get("href") or "#").startswith(("#", "data:image/png;base64,"))
    policy = next(a["content"] for tag, a in page.elements if tag == "meta" and "http-equiv" in a)
    style = re.search(r"<style>(.*?)</style>", text, re.S)
    digest = base64.b64encode(hashlib.sha256(style.group(1).encode()).digest()).decode()
    assert f"style-src 'sha256-{digest}'" in policy and "default-src 'none'" in policy and "unsafe" not in policy
    assert len(text) < 1_000_000


def test_names_inside_the_page_are_unique_and_found(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    names = re.findall(r'\sid="([^"]*)"', text)
    assert len(names) == len(set(names)) and len(text.split("<svg")) > 8
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', text)) <= set(names)


def test_equal_calibrations_give_equal_bytes(made, written, tmp_path):
    again = pickle.loads(pickle.dumps(made))
    write_calibration_report(again, tmp_path, dict(HASHES), [extra_section()])
    for name in ("report.html", "report.pdf"):
        assert (tmp_path / name).read_bytes() == (written / name).read_bytes()
    assert b"CreationDate" not in (written / "report.pdf").read_bytes()


def test_extra_sections_stand_before_what_to_do_next(written):
    page = Page((written / "report.html").read_text(encoding="utf-8"))
    assert page.row("force") == ["force", "20.125"]
    told = page.told
    assert told.index("Noise, repeats and load tests") < told.rindex("Contact A paragraph") < told.rindex("What to measure next")


def test_pdf_has_all_sheets_and_their_words(made, written):
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext is not installed")
    told = subprocess.run(
        ["pdftotext", "-layout", written / "report.pdf", "-"], capture_output=True, text=True, check=True
    ).stdout
    pages = told.count("\f")
    assert 6 <= pages <= 12 and f"page {pages} of {pages}" in told
    for title in (
        "Before and after",
        "Where it was not fitted",
        "What is left over",
        "Parameters",
        "What cannot be told apart",
        "Terms tried",
        "Noise, repeats",
        "Contact",
        "What to measure next",
        "Made from",
    ):
        assert title in told
    assert f"{1e3 * made.methods.error['full'].max():.3f}" in told and HASHES["tracker.csv"] in told


def test_odd_names_stay_words(made, tmp_path):
    c = with_names(made, HOSTILE)
    write_calibration_report(c, tmp_path, {HOSTILE: HOSTILE}, [Section(HOSTILE, (HOSTILE, table((HOSTILE,), [(HOSTILE,)])))])
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert not {"script", "img"} & {tag for tag, _ in page.elements}
    assert not any(name.startswith("on") for _, attributes in page.elements for name in attributes)
    assert page.told.count('alert("x")') > 5
    assert (tmp_path / "report.pdf").stat().st_size > 50_000


def test_what_is_absent_is_told_in_words(made, tmp_path):
    page = page_of(bare(made), tmp_path)
    for words in (
        "Not proven.",
        "too few to leave a fifth of them out",
        "No part of the readings could be left out",
        "tries no further terms",
        "no reading was taken twice",
        "No posture was read under two loads",
        "Every parameter is determined",
        "drift; scatter of repeats",
    ):
        assert words in page.told
    assert "nan" not in page.told.split()


def test_a_bad_calibration_is_not_praised(made):
    view = look_at(made)
    assert calibration_headline(made, view).good and calibration_headline(made, view).verdict == "Calibrated."
    m = made.methods
    worse = replace(m, error=m.error | {"full": 1.1 * m.before})
    assert calibration_headline(replace(made, methods=worse), view).verdict == "No better than before."
    wild = replace(m, error=m.error | {"full": np.where(np.arange(len(m.rows)) == 0, 2 * m.before.max(), m.error["full"])})
    assert "further off than before" in calibration_headline(replace(made, methods=wild), view).sentence
    double = replace(m, error={"full": m.error["full"], "geometry": 2 * m.error["full"]})
    assert "Method 'full' does better" in calibration_headline(replace(made, method="geometry", methods=double), view).sentence


def test_an_axis_that_hardly_moved_is_a_doubt(made):
    """Its readings are met as well as any, left out or not; elsewhere the arm is off by a millimetre."""
    c, told = made.fit.campaign, "hardly moved (under 20 deg): what is told holds near there only."
    assert not any(told in words for words in doubts_about(made))
    for columns, axes in (([0], "Axis 1"), ([1, 4], "Axes 2 and 5")):
        q = c.readings.q.copy()
        q[:, columns] = 0.3 + 0.01 * q[:, columns]
        fit = replace(made.fit, campaign=replace(c, readings=replace(c.readings, q=q)))
        assert f"{axes} {told}" in doubts_about(replace(made, fit=fit))


def test_a_noise_stated_too_large_is_a_doubt(made):
    """As micrometres that were nanometres make it: nothing is predicted badly then, nothing is known well either."""
    told = "times what it states: many outliers, or a noise stated too large"
    for size, doubted in ((1.0, False), (0.2, True)):
        held = [replace(h, squared=size**2 * h.squared) for h in made.held_out]
        assert any(told in words for words in doubts_about(replace(made, held_out=held))) == doubted


def test_a_calibration_is_weighed_against_the_arm_as_believed(made):
    m, rng = made.methods, np.random.default_rng(0)

    def with_error(error):
        return replace(made, methods=replace(m, error=m.error | {"full": error}))

    assert (
        "is the cell with it" in _use(made, Path("out")) and made.methods.gained("full")[0] > 5 * made.methods.gained("full")[1]
    )
    equal = with_error(m.before + rng.normal(0, 1e-4, len(m.before)))
    assert "Nothing gained" in _use(equal, Path("out"))
    worse = with_error(m.before * 1.3)
    with pytest.raises(Infeasible, match="worse than by the arm as believed"):
        _calibrated(worse, None, [], None, None)


def test_residuals_turn_into_the_base_without_changing_their_length(made):
    view = look_at(made)
    np.testing.assert_allclose(view.error, made.error_after, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(view.before, axis=1), made.error_before, rtol=1e-9)
    turned = held_out_in_base(made, made.methods.off["full"])
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), made.methods.error["full"], rtol=1e-9)
    # By hand: the station's rotation takes a base vector to the tracker.
    row = made.methods.rows[3]
    R = made.fit.state.stations[made.fit.campaign.readings.station[row], :3, :3]
    np.testing.assert_allclose(R @ turned[3], made.methods.off["full"][3], atol=1e-15)


def test_residual_along_a_joint_is_what_the_joint_moves(made):
    """A joint that stands 20 urad further than commanded shows as that much way along its own motion."""
    fit, view, eps = made.fit, look_at(made), 2e-5
    for joint in (0, 2, 4):
        campaign = fit.campaign
        q = campaign.readings.q.copy()
        q[:, joint] += eps
        moved = residuals(campaign.robot, replace(campaign.readings, q=q), campaign.instrument, fit.state)
        shift = fit.residual - moved
        back = replace(campaign, readings=replace(campaign.readings, point=campaign.readings.point + shift))
        along = look_at(replace(made, fit=replace(fit, campaign=back))).along[:, joint]
        np.testing.assert_allclose(along - view.along[:, joint], np.linalg.norm(shift, axis=1), rtol=1e-3)


def test_whitened_residuals_of_a_right_model_are_as_expected(made):
    view = look_at(made)
    assert (
        view.outlier.sum() == 1 and view.readings.line[view.outlier][0] == 9
    )  # the reading that was put off, line 1 is the head
    freedom = 1 - made.fit.layout.size / (3 * len(view.point))
    found = view.whitened[~view.outlier].std()
    assert 0.75 < found / np.sqrt(freedom) < 1.25
    assert 0.6 < view.error[~view.outlier].mean() / (SIGMA * np.sqrt(8 / np.pi) * np.sqrt(freedom)) < 1.6


def test_other_poses_are_only_blamed_where_they_would_help(made):
    tellable = tellable_parameters(made)
    assert not any(tellable[name] for name in ("th1", "d1", "th3", "d2", "d3", "th6"))
    doubted = replace(made, identifiability=replace(made.identifiability, hidden=(Hidden("a4", (), 1.0), Hidden("al2", (), 1.0))))
    assert tellable_parameters(doubted) == {"a4": True, "al2": True}
    assert any("other poses would" in words for words in advice(doubted, look_at(made), {"a4": True}))


def has(found: list[str], words: str) -> bool:
    return any(words in sentence for sentence in found)


def test_advice_follows_from_what_is_lacking(made):
    view = look_at(made)

    def given(**changes) -> list[str]:
        readings = replace(made.fit.campaign.readings, **changes)
        c = replace(made, fit=replace(made.fit, campaign=replace(made.fit.campaign, readings=readings)))
        return advice(c, replace(view, readings=readings), {})

    n = len(view.point)
    now = given()
    assert (
        has(now, "payload 'blade', which hangs there while grinding")
        and has(now, "only one was read again")
        and has(now, "approach1")
    )
    assert has(now, "Read 3 nests") and not has(now, "time_s") and not has(now, "Take more readings")
    assert has(given(time=None), "time_s")
    assert has(given(payload=np.zeros(n, np.int64)), "another payload too ('plate' and 'blade')")
    assert not has(given(temperature=np.linspace(20, 25, n)), "temperature_C")
    both = np.where(np.arange(n)[:, None] % 2 == 0, 1.0, -1.0) * np.ones(6)
    assert not has(given(approach=both), "approach") and not has(given(approach=both), "other side")
    one_sided = both.copy()
    one_sided[:, 3] = 1.0
    assert has(given(approach=one_sided), "other side too on A4")
    q = view.readings.q.copy()
    q[:, 1] = np.linspace(-1.0, -0.9, n)
    assert has(given(q=q), "Move A2 further")
    assert not has(
        advice(replace(made, load_test=LoadTest((2,), np.ones(1), np.ones(1), 5, 1e-3, 1e-4)), view, {}), "Hold 5 postures"
    )


def test_folds_that_extrapolate_badly_are_told_but_chance_is_not(made):
    def fold(ratio: float, m: int) -> FoldErrors:
        rows = np.arange(m)
        return FoldErrors(
            ReadingFold("payload", "plate", rows), rows, np.full(m, 1e-4), np.zeros(m), np.full(m, 3 * ratio**2), np.zeros((m, 3))
        )

    assert extrapolates_badly(fold(1.7, 30)) and not extrapolates_badly(fold(1.3, 300)) and not extrapolates_badly(fold(1.55, 2))
    assert has(
        advice(replace(made, held_out=[fold(2.0, 30)]), look_at(made), {}),
        "Measure more with payload 'plate': left out, it is predicted 2.0",
    )


def test_drift_is_told_from_chance(made):
    assert not drift_is_real(made)
    assert drift_is_real(replace(made, repeats=replace(made.repeats, drift=np.array([0.0, 0.0, 0.05]))))


@pytest.mark.parametrize(
    ("term", "words"),
    [
        (Term("t", 30.0, 5.0, True), "in the model: readings left out are predicted better"),
        (Term("t", 30.0, 1.0, False), "not on enough blocks"),
        (Term("t", 1.0, 1.0, False), "too little to be told from chance"),
        (Term("t", 0.0, 0.0, False), "hardly helps even the readings"),
        (Term("t", -3.0, -2.0, False), "predicted worse"),
    ],
)
def test_terms_are_judged_in_words(term, words):
    assert words in term_verdict(term)
