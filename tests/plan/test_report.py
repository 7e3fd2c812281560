"""report.html and report.pdf as a whole: what is in them, that nothing can be smuggled in, equal bytes."""

import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import fields, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup
from scipy.spatial import cKDTree

from ocp.plan.files import write_plan_report
from ocp.plan.grades import Grade, Grades
from ocp.plan.passes.stretches import LeftOut
from ocp.plan.report.pages import plan_pages
from ocp.plan.report.plan_report import LeftOutReport, PlanReport
from ocp.plan.report.quantities import QUANTITIES
from ocp.plan.report.surface import paint_blade, pass_spacing
from ocp.report.parts import Plot, Table
from tests.support.report_example import example_report

ROOT = Path(__file__).resolve().parents[2]
HOSTILE = '</script><script>alert("x")</script><img src=x onerror=alert(1)>&amp;\'$\\frac{$ 叶片 \udcff\x00'
VOID = {"meta", "br", "img", "input", "link", "hr"}


class Page(HTMLParser):
    """Elements, text and attributes of a page; fails where tags do not nest (SVG's self-closing ones allowed)."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts[-1] += data
        elif self.open and self.open[-1] != "style":
            self.words.append(data)


PAGES: list[tuple[PlanReport, str]] = []  # of the reports that several tests look at: most of a page's time is its plots


def page_of(report: PlanReport) -> str:
    known = [text for drawn, text in PAGES if drawn is report]
    if not known:
        known = [plan_pages(report).page()]
        PAGES.append((report, known[0]))
    return known[0]


SHEETS: list[tuple[PlanReport, bytes]] = []  # their PDF


def sheets_of(report: PlanReport, folder: Path) -> Path:
    known = [raw for drawn, raw in SHEETS if drawn is report]
    if not known:
        plan_pages(report).write_pdf(folder / "report.pdf")
        SHEETS.append((report, (folder / "report.pdf").read_bytes()))
    else:
        (folder / "report.pdf").write_bytes(known[0])
    return folder / "report.pdf"


def words_of(report: PlanReport) -> str:
    """Its page without the plots."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Plot, "on_page", lambda plot: Markup(""))
        return plan_pages(report).page()


@pytest.fixture(scope="module")
def report() -> PlanReport:
    return example_report(lines=2, count=40, frames=50)


@pytest.fixture(scope="module")
def hostile(report: PlanReport) -> PlanReport:
    passes = tuple(replace(item, side=HOSTILE) for item in report.passes)
    return replace(
        report,
        title=HOSTILE,
        verdict=HOSTILE,
        notices=(HOSTILE,),
        passes=passes,
        summary=((HOSTILE, f"{HOSTILE} {HOSTILE}"),),
        inputs={f"{HOSTILE}: {HOSTILE}": HOSTILE},
    )


def numbers(packed: dict[str, object]) -> np.ndarray:
    kinds = {"<f4": np.float32, "<u4": np.uint32, "<u2": np.uint16, "<u1": np.uint8}
    raw = base64.b64decode(str(packed["data"]))
    return np.frombuffer(raw, kinds[str(packed["dtype"])]).reshape(packed["shape"])


def test_page_nests_and_tells_what_matters(report):
    page = Page(page_of(report))
    told = " ".join(" ".join(page.words).split())
    for words in (report.verdict, "Safe to use.", *report.notices, *(value for _, value in report.summary)):
        assert words in told
    for name, sha in report.inputs.items():
        assert sha in told and name in told
    unsafe = " ".join(Page(words_of(replace(report, safe=False))).words)
    assert "Do not use." in unsafe and "Safe to use." not in unsafe


def test_page_loads_nothing(report):
    text = page_of(report)
    assert set(re.findall(r"https?://[^\s\"'<]*", text)) <= {"http://www.w3.org/2000/svg"}
    for tag, attributes in Page(text).elements:
        assert tag not in {"link", "iframe", "object", "embed", "base", "img"}
        assert not {"src", "srcset", "action", "style"} & attributes.keys()
        assert not any(name.startswith("on") for name in attributes)
        assert (attributes.get("href") or "#").startswith(("#", "data:image/png;base64,"))
    assert "@import" not in text and "url(" not in text.replace("url(#", "")


def test_policy_allows_exactly_this_script_and_style(report):
    text = page_of(report)
    page = Page(text)
    policy = next(a["content"] for tag, a in page.elements if tag == "meta" and "http-equiv" in a)
    style = re.search(r"<style>(.*?)</style>", text, re.S)
    for kind, source in (("script-src", page.scripts[1]), ("style-src", style.group(1))):
        digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
        assert f"{kind} 'sha256-{digest}'" in policy
    assert "default-src 'none'" in policy and "unsafe" not in policy


def test_page_gives_the_arrays_back(report):
    data = json.loads(Page(page_of(report)).scripts[0])
    for name in ("p", "n", "t", "s"):
        expected = np.concatenate([getattr(item, name) for item in report.passes])
        np.testing.assert_array_equal(numbers(data["passes"][name]), expected.astype(np.float32))
    for item, sent in zip(QUANTITIES, data["quantities"], strict=True):
        expected = np.concatenate([getattr(one, item.key) for one in report.passes]) * item.factor
        np.testing.assert_array_equal(numbers(sent["values"]), expected.astype(np.float32))
        assert sent["range"][0] <= expected.min() and expected.max() <= sent["range"][1]
    assert data["passes"]["first"] == [0, 40, 80, 120, 160]
    animation = report.animation
    np.testing.assert_array_equal(numbers(data["cell"]["links"]), animation.T_base_link[:, :, :3].astype(np.float32))
    np.testing.assert_array_equal(numbers(data["cell"]["time"]), animation.time.astype(np.float32))
    sent = numbers(data["blade"]["vertices"])[: len(report.vertices)]
    np.testing.assert_array_equal(sent, report.vertices.astype(np.float32))
    motion = report.motion
    assert numbers(data["motion"]["time"])[-1] == np.float32(motion.time[-1])
    np.testing.assert_allclose(numbers(data["motion"]["q_deg"])[0], np.degrees(motion.q[0]), rtol=1e-6)


def test_nothing_can_be_smuggled_into_the_page(report, hostile):
    clean, dirty = Page(page_of(report)), Page(page_of(hostile))
    count = [tag for tag, _ in clean.elements].count
    # The same scripts, no image, no handler.
    assert [tag for tag, _ in dirty.elements].count("script") == count("script") == 2
    assert "img" not in [tag for tag, _ in dirty.elements]
    assert not any(name.startswith("on") for _, a in dirty.elements for name in a)
    assert dirty.scripts[1] == clean.scripts[1]
    assert json.loads(dirty.scripts[0])["passes"]["side"][0] == HOSTILE
    assert "<" not in dirty.scripts[0] and "&" not in dirty.scripts[0]


def test_equal_reports_give_equal_bytes_whatever_the_hash_seed(tmp_path, hostile, report):
    code = (
        "import sys; from pathlib import Path; from tests.support.report_example import example_report\n"
        "from ocp.plan.files import write_plan_report\n"
        "write_plan_report(example_report(lines=2, count=40, frames=50), Path(sys.argv[1]))\n"
    )
    other = tmp_path / "other"
    other.mkdir()
    environment = os.environ | {"PYTHONHASHSEED": "77", "PYTHONPATH": str(ROOT), "TZ": "Asia/Tokyo", "LC_ALL": "C"}
    subprocess.run([sys.executable, "-c", code, str(other)], check=True, env=environment, timeout=120)
    assert sheets_of(report, tmp_path).read_bytes() == (other / "report.pdf").read_bytes()
    assert page_of(report).encode("utf-8") == (other / "report.html").read_bytes()


def test_every_picture_is_drawn_once(tmp_path, report, monkeypatch):
    drawn: list[str] = []

    def draw(key, *_):
        drawn.append(key)
        return '<svg viewBox="0 0 9 1"></svg>'

    monkeypatch.setattr("ocp.report.parts.inline_svg", draw)
    write_plan_report(report, tmp_path)
    assert sorted(drawn) == sorted(plot.key for plot in plan_pages(report).plots()) and len(drawn) > 5


def test_pdf_has_its_sheets_and_words(tmp_path, report):
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext (poppler-utils) is not installed: the words of the PDF cannot be read back")
    file = sheets_of(report, tmp_path)
    text = subprocess.run(["pdftotext", "-layout", str(file), "-"], capture_output=True, check=True, timeout=60).stdout.decode()
    sheets = text.split("\f")[:-1]
    assert len(sheets) >= 6
    joined = " ".join(text.split())
    assert report.verdict in joined and f"page {len(sheets)} of {len(sheets)}" in joined
    for words in (
        "Line 4, concave",
        "A6 torque",
        "Tilt 2",
        "Removal",
        "Blade compliance",
        "Largest use of a limit",
        "rad/s²",
        *report.notices,
    ):
        assert words in joined
    for sha in report.inputs.values():
        assert sha in joined
    raw = file.read_bytes()
    assert b"/CreationDate" not in raw and b"/Type3" not in raw  # Type 3 fonts print badly and cannot be searched


def test_awkward_words_and_missing_values_are_printed(tmp_path, hostile):
    first = hostile.passes[0]
    gaps = np.where(np.arange(len(first.s)) % 7 == 3, np.nan, first.force)
    unknown = np.full(len(first.s), np.nan)
    passes = (replace(first, force=gaps, removal=unknown, compliance_nn=unknown), *hostile.passes[1:])
    robot = replace(hostile.robot, torque_max=np.full(6, np.inf))
    awkward = replace(hostile, passes=passes, robot=robot, notices=("long " * 60,) * 30)
    plan_pages(awkward).write_pdf(tmp_path / "a.pdf")
    plan_pages(awkward).write_page(tmp_path / "a.html")
    assert (tmp_path / "a.pdf").stat().st_size > 50_000
    assert "not limited" in (tmp_path / "a.html").read_text()


def test_report_of_sixteen_passes_stays_small(tmp_path):
    full = example_report(lines=8, count=188)
    plan_pages(full).write_page(tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 3_000_000


def in_browser(folder: Path, report: PlanReport, view: str) -> "subprocess.CompletedProcess[bytes]":
    """The page's elements after its script has run, on stdout."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no chromium: the page's script is not run here")
    (folder / "report.html").write_text(words_of(report), encoding="utf-8")  # its script moves no plot
    flags = "--headless --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --no-first-run"
    flags += " --disable-background-networking --disable-component-update --disable-sync"
    address = f"file://{folder}/report.html#{view}"
    return subprocess.run(
        [browser, *flags.split(), f"--user-data-dir={folder}/profile", "--virtual-time-budget=3000", "--dump-dom", address],
        capture_output=True,
        timeout=120,
    )


def test_numbers_of_lines_do_not_cover_each_other(tmp_path):
    shown = in_browser(tmp_path, example_report(lines=40, count=20, frames=50), "view=blade").stdout.decode()
    labels = re.search(r'<div id="labels"[^>]*>(.*?)</div>', shown, re.S).group(1)
    at = re.findall(r'<span style="left: ([\d.]+)px; top: ([\d.]+)px;">\d+</span>', labels)
    across, down = (np.abs(np.subtract.outer(x, x)) for x in np.array(at, float).T)
    far = (across > 8) | (down > 14)  # a label is about 15 px wide and high
    assert 5 < len(at) < 40 and far[np.triu_indices(len(at), 1)].all()


def test_page_comes_alive_in_a_browser(tmp_path, report):
    shown = in_browser(tmp_path, report, "view=cell&time=2.0&quantity=force_sd&waypoint=45")
    told = " ".join(Page(shown.stdout.decode()).words)
    at = int(np.argmin(np.abs(report.motion.time - 2.0)))
    assert "2.00 s" in told, shown.stderr.decode()[-2000:]
    assert abs(float(re.search(r"A2\s+(-?[\d.]+) deg", told).group(1)) - np.degrees(report.motion.q[at, 1])) < 0.2
    assert re.search(r"Line 2 \(convex\), [\d.]+ mm along", told)
    assert "Standard deviation of the force, N" in told


def test_what_is_left_out_is_named_and_coloured(report):
    """The middle of the second pass is left out: in words, as red triangles of the scene and in no quantity's colour."""
    cut = report.passes[1]
    piece = {name: getattr(cut, name)[10:30] for name in "pn"} | {"s": cut.s[10:30] - cut.s[10]}
    lost = LeftOut(cut.line, cut.side, float(cut.s[10]), float(cut.s[29]), "it is too hollow <b>", "use a narrower wheel")
    names = [field.name for field in fields(cut) if isinstance(getattr(cut, field.name), np.ndarray)]
    ends = [replace(cut, **{name: getattr(cut, name)[part] for name in names}) for part in (slice(0, 10), slice(30, 40))]
    ends[1] = replace(ends[1], s=ends[1].s - ends[1].s[0])
    without = replace(report, passes=(report.passes[0], *ends, *report.passes[2:]))
    told = replace(without, left_out=(LeftOutReport(cut.side, **piece, lost=lost),))
    text = " ".join(Page(words_of(told)).words)
    assert "it is too hollow <b>" in text and "use a narrower wheel" in text and "left out" in text
    assert "left out" not in " ".join(Page(words_of(without)).words)
    painted = paint_blade(told.vertices, told.faces, told.passes, told.pass_spacing, told.left_out)
    middles = painted.vertices[painted.faces].mean(axis=1)
    assert painted.left.any() and cKDTree(piece["p"]).query(middles[painted.left])[0].max() < pass_spacing(told.passes)
    grey = paint_blade(told.vertices, told.faces, told.passes, told.pass_spacing)
    assert not grey.left.any() and painted.waypoint.max() < sum(len(one.s) for one in told.passes)


def test_what_many_lines_have_in_common_is_one_row_after_the_scene(report):
    """Both ends of lines 3 to 5 (4 is driven from its far end), line 6 for another reason, line 7 again, 8 on the other side."""
    lost = [LeftOut(k, "convex", 0.0, 0.004 + 0.001 * k, "no room", "a smaller wheel", 0.1 * (k == 4)) for k in (3, 4, 5, 7)]
    lost += [LeftOut(k, "convex", 0.09, 0.1, "no room", "a smaller wheel", 0.1 * (k == 4)) for k in (3, 4, 5)]
    lost += [
        LeftOut(6, "convex", 0.0, 0.1, "too hollow", "a narrower wheel"),
        LeftOut(8, "concave", 0.0, 0.01, "no room", "a smaller wheel"),
    ]
    at = {"p": np.zeros((0, 3)), "n": np.zeros((0, 3)), "s": np.zeros(0)}
    told = plan_pages(replace(report, left_out=tuple(LeftOutReport(one.side, **at, lost=one) for one in lost)))
    titles = [section.title for section in told.sections]
    assert titles.index("Left out") > titles.index("Blade and cell")
    rows = next(
        part for section in told.sections if section.title == "Left out" for part in section.parts if isinstance(part, Table)
    ).rows
    assert [row[:6] for row in rows] == [
        ("3 to 5", "convex", "0.0 .. 92.0", "7.0 .. 100.0", "24.0", "no room"),
        ("3 to 5", "convex", "0.0 .. 90.0", "10.0 .. 100.0", "30.0", "no room"),
        ("6", "convex", "0.0", "100.0", "100.0", "too hollow"),
        ("7", "convex", "0.0", "11.0", "11.0", "no room"),
        ("8", "concave", "0.0", "10.0", "10.0", "no room"),
    ]
    assert sum(float(row[4]) for row in rows) == pytest.approx(1e3 * sum(one.length for one in lost))


@pytest.mark.parametrize(
    "grade, words", [("green", "Safe to use."), ("amber", "Safe to use, with care."), ("red", "not to grind")]
)
def test_the_headline_has_the_colour_of_its_grade(report, grade, words):
    grades = Grades(Grade("green", "it moves"), Grade(grade, "as measured"), "20 N")
    page = words_of(replace(report, verdict=grades.sentences(), headline=grades.headline))
    tones = {"green": "safe", "amber": "doubtful", "red": "unsafe"}
    assert words in page and [tone for tone in tones.values() if f"verdict {tone}" in page] == [tones[grade]]
    assert f"({grade}): as measured." in page and "safe to move (green): it moves." in page
    assert "shared with the planner" in page and "the blade&#39;s compliance" in page
