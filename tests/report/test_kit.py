"""The kit of reports: parts draw themselves on the page and on paper, nothing is smuggled in, nothing runs over an edge."""

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from PIL import Image

from ocp.report.paper import _shown, compiler
from ocp.report.parts import Facts, Plot, Points, made_from, table
from ocp.report.plotting import WIDTH, Canvas, dressed, envelope, finished, inline_svg
from ocp.report.report import Report
from ocp.report.section import Headline, Part, Section
from ocp.report.style import printable, shorten

HOSTILE = '</td><script>alert("x")</script>&amp;'


class Stamp(Part):
    """A part that a command brings itself."""

    def on_page(self) -> Markup:
        return Markup("<b>stamped</b>")

    def on_paper(self) -> dict[str, Any]:
        return {"is": "paragraph", "words": "stamped"}


def report(*parts: Part | str, **changes) -> Report:
    section = Section("One", parts, **changes)
    head = Headline(True, "Good.", "All is well.")
    return Report("Test", "title", head, ("mind this",), (section, made_from({"a.csv": "ab" * 32})))


def line(canvas: Canvas) -> None:
    canvas.subplots().plot([0, 1], [0, 1])


def usual_parts() -> tuple[Part | str, ...]:
    bars = table(("what", "use"), [("A1", "50 %"), ("A2", "over"), ("A3", "none")], (0, 1), bars={1: (0.5, 1.2, np.nan)})
    return ("words", Points(("one", "two"), numbered=True), Facts((("asked", "answered"),)), bars, Plot("p", "seen", 1.0, line))


def words_of(part: Part) -> set[str]:
    """What it says on paper, pictures apart."""

    def words(value: Any, key: str = "") -> list[str]:
        if isinstance(value, dict):
            return [word for name, item in value.items() for word in words(item, name)]
        if isinstance(value, (list, tuple)):
            return [word for item in value for word in words(item, key)]
        return [value] if isinstance(value, str) and key not in ("is", "picture") else []

    return set(words(part.on_paper()))


def rendered(of: Report, tmp_path: Path) -> list[np.ndarray]:
    """Its sheets as grey pixels (h, w), three to a millimetre."""
    seen: list[bytes] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ocp.report.report.sheets", lambda *given: seen.extend(_pictures(*given)) or b"")
        of.write_pdf(tmp_path / "unused.pdf")
    return [np.asarray(Image.open(io.BytesIO(one)).convert("L")) for one in seen]


def _pictures(*given: Any) -> list[bytes]:
    made = compiler(*given).compile(format="png", ppi=76.2)
    return made if isinstance(made, list) else [made]


def margins(sheet: np.ndarray) -> np.ndarray:
    """What of it lies left, right of and above what may be printed on."""
    edge = round(0.68 * 76.2)
    return np.concatenate([sheet[:, :edge].ravel(), sheet[:, -edge:].ravel(), sheet[:edge].ravel()])


def test_every_part_says_the_same_on_page_and_paper():
    for part in (*usual_parts()[1:], Stamp()):
        page = re.sub(r"<svg.*?</svg>", "", str(part.on_page()), flags=re.S)
        told = set(re.sub(r"<[^>]+>", "\n", page).split("\n")) - {""}
        assert told and told <= words_of(part)


def test_nothing_runs_over_an_edge_and_long_words_are_broken(tmp_path):
    long = "averyverylongnamewithoutanyspaceinit" * 9
    wide = table(("a", "b", "c", "d"), [(long, "word " * 90, long, "12.5")] * 3, text=(0, 1, 2))
    parts = (long, Points((long, long)), Facts(((long, long),)), wide, "叶 $x$ #panic() *" + long)
    found = rendered(replace(report(*parts), title=long, head=Headline(False, long, long, ((long, long),))), tmp_path)
    assert len(found) >= 2
    for sheet in found:
        assert sheet.shape[0] > 1.4 * sheet.shape[1] and margins(sheet).min() > 250 and sheet.min() < 120


def test_a_whole_word_is_printed_whole_and_a_hash_can_be_copied():
    assert _shown({"is": "table", "columns": ["file", "SHA-256"], "rows": [["ab" * 32]]})["rows"] == [["ab" * 32]]
    assert _shown({"is": "table", "columns": ["a", "b", "c"], "rows": [["ab" * 32]]})["rows"] != [["ab" * 32]]
    assert _shown("x" * 70).replace("\u200b", "") == "x" * 70 and "\u200b" in _shown("x" * 70)
    assert _shown("叶") == "\u25a1" and _shown({"picture": "叶"}) == {"picture": "叶"}


def test_a_bar_on_paper_is_as_long_as_its_share(tmp_path):
    """Beside the words, up to its whole length; a share over one in the colour of what is bad."""

    def lengths(*shares: float) -> list[int]:
        rows = [(f"A{k}", "") for k in range(len(shares))]
        shown = table(("what", "use"), rows, (0, 1), bars={1: shares})
        (sheet,) = rendered(Report("Test", "t", Headline(True, "v", "s"), (), (Section("One", (shown,)),)), tmp_path)
        dark = sheet[int(2.2 * 76.2) :] < 150  # bars, not the grey that they lie on
        runs = [max((len(run) for run in "".join("x" if d else " " for d in row).split()), default=0) for row in dark]
        return [length for k, length in enumerate(runs) if length > 8 and runs[k - 1] != length]

    half, whole = lengths(0.5), lengths(1.0)
    assert len(half) == len(whole) == 1 and abs(half[0] - 0.25 * 76.2) < 2.5 and abs(whole[0] - 0.5 * 76.2) < 2.5
    assert lengths(1.7) == whole and lengths(np.nan) == []


def test_a_page_runs_the_scripts_of_its_sections_and_no_other():
    quiet, loud = report(*usual_parts()).page(), report("x", script="let a = 1;", style=".a { top: 0 }").page()
    assert "<script" not in quiet and "script-src" not in quiet
    assert loud.count("<script>let a = 1;</script>") == 1 and "script-src 'sha256-" in loud and ".a { top: 0 }" in loud


def test_words_stay_words():
    parts = (HOSTILE, Points((HOSTILE,)), Facts(((HOSTILE, HOSTILE),)), table((HOSTILE,), [(HOSTILE,)]))
    hostile = replace(report(*parts), title=HOSTILE)
    assert "<script" not in hostile.page() and hostile.page().count("&lt;script&gt;") == 8


def test_no_word_breaks_a_picture_or_a_sheet(tmp_path):
    odd = "a\udcffb\x00c\fd\u202ee <b> href=f"

    def draw(canvas: Canvas) -> None:
        dressed(canvas.subplots(), odd)

    nothing = (Facts(()), table((), []), Points(()), "")
    made = replace(report(Plot("p", odd, 1.0, draw), odd, *nothing), title=odd, kind=odd)
    made.write(tmp_path)
    (shown,) = made.plots()
    assert ElementTree.fromstring(shown.on_paper()["picture"]).get("aria-label") == "a b c d e <b> href=f"
    assert "xlink" not in "".join(ElementTree.fromstring(shown.on_paper()["picture"]).itertext())
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF-")


def test_a_font_that_is_lacking_is_said(tmp_path, monkeypatch):
    """Sheets without it would be blank."""
    monkeypatch.setattr("ocp.report.paper.FontProperties", lambda **_: FontProperties(family="no such font"))
    with pytest.raises(ValueError, match="no such font"):
        report("words").write_pdf(tmp_path / "report.pdf")


def test_a_bar_is_as_long_as_its_share_and_never_longer_than_all():
    page = str(usual_parts()[3].on_page())
    assert re.findall(r'<rect width="([\d.]+)" height="8" class="(part|full)"', page) == [("50.0", "part"), ("100.0", "full")]


def test_equal_reports_are_equal_bytes_without_a_date(tmp_path):
    for name in ("a.pdf", "b.pdf"):
        report(*usual_parts()).write_pdf(tmp_path / name)
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes() and b"CreationDate" not in content


def alone(part: Part, tmp_path: Path) -> np.ndarray:
    """Ink (h, w), 0 to 1, of the sheet that has this part and no other, below its heading."""
    (sheet,) = rendered(Report("Test", "t", Headline(True, "v", "s"), (), (Section("One", (part,)),)), tmp_path)
    return 1.0 - sheet[int(2.2 * 76.2) : -60] / 255.0


def test_rows_and_lists_look_as_they_are_meant(tmp_path):
    rows = [("many words of a row", "1"), ("many words of a row", "100000")]
    plain, quiet, strong = (
        alone(table(("what", "count"), rows, **by), tmp_path) for by in ({}, {"quiet": (1,)}, {"strong": (1,)})
    )
    assert quiet.sum() < 0.97 * plain.sum() and strong.sum() > 1.03 * plain.sum()
    assert not np.array_equal(alone(Points(("one",)), tmp_path), alone(Points(("one",), numbered=True), tmp_path))

    def ends(text: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        dark = alone(table(("a wide head",), [("1",), ("100000",)], text), tmp_path) > 0.4
        lines = [np.flatnonzero(line.any(axis=0)) for line in np.split(dark, np.flatnonzero(~dark.any(axis=1))) if line.any()]
        return np.array([line[0] for line in lines]), np.array([line[-1] for line in lines])

    (left, right), (words_left, words_right) = ends(()), ends((0,))
    assert len(left) == 3 and np.ptp(right) < 3 < np.ptp(left) and np.ptp(words_left) < 3 < np.ptp(words_right)


def test_long_tables_go_on_on_the_next_sheet(tmp_path):
    rows = [(f"k{i}", "1") for i in range(100)]
    found = rendered(report(table(("key", "value"), rows)), tmp_path)
    assert len(found) == 2 and all(sheet[100:200].min() < 200 for sheet in found)


def test_a_picture_is_drawn_once_for_page_and_paper(tmp_path):
    times: list[int] = []

    def draw(canvas: Canvas) -> None:
        times.append(1)
        line(canvas)

    made = report("words", Plot("p", "seen", 1.0, draw), Plot("q", "too", 1.0, draw))
    made.write(tmp_path)
    assert len(times) == 2 and (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF-")
    known = made.with_plots({"q": "<svg>q</svg>"})
    assert [plot.svg for plot in known.plots()] == ["", "<svg>q</svg>"] and "<svg>q</svg>" in known.page()


def test_labels_stand_beside_the_numbers():
    figure = Figure(figsize=(WIDTH, 2.0))
    ax = dressed(Canvas(figure, 2.0).subplots(), x="distance, mm")
    canvas = FigureCanvasAgg(finished(figure))
    canvas.draw()
    numbers = [text.get_window_extent() for text in ax.get_xticklabels() if text.get_text()]
    assert numbers and ax.xaxis.label.get_window_extent().y1 < min(box.y0 for box in numbers)


def test_a_label_that_is_set_late_stands_where_an_early_one_does():
    """Below the numbers: room is found for labels when all are there."""

    def drawn(late: bool) -> str:
        def draw(canvas: Canvas) -> None:
            ax = canvas.subplots()
            if late:
                dressed(ax)
            dressed(ax, x="distance, mm")

        return inline_svg("one", "caption", 2.0, draw)

    assert "distance, mm" in drawn(False) and drawn(True) == drawn(False)


def test_labels_keep_their_decimals():
    def draw(canvas: Canvas) -> None:
        ax = canvas.subplots(1, 1)
        ax.plot([0, 1, 2], [1, 2, 3], "o")
        ax.set_title("0.0375 < 1 & more")

    text = inline_svg("one", 'a "caption"', 2.0, draw)
    assert "0.0375 &lt; 1 &amp; more" in text and "style=" not in text and 'aria-label="a &quot;caption&quot;"' in text
    assert text.count("<use href=") >= 3 and f'viewBox="0 0 {72 * WIDTH:.2f}' in text


def test_a_table_with_a_short_row_is_refused():
    with pytest.raises(ValueError, match="2 entries for 3 columns"):
        table(("a", "b", "c"), [("1", "2")])


def test_thinned_curves_keep_their_peaks():
    x = np.linspace(0, 1, 20_000)
    y = np.sin(9 * x)
    y[[777, 12_345]] = 5.0, -7.0
    thin_x, thin_y = envelope(x, y, bins=200)
    assert len(thin_x) <= 400 and (np.diff(thin_x) > 0).all()
    assert thin_y.max() == 5.0 and thin_y.min() == -7.0
    y[[775, 12_344]] = np.nan
    y[4000:5000] = np.nan
    thin_x, thin_y = envelope(x, 30.0 + y, bins=200)
    assert np.nanmax(thin_y) == 35.0 and np.nanmin(thin_y) == 23.0
    assert np.isnan(thin_y[(thin_x > 0.205) & (thin_x < 0.245)]).all() and np.isnan(thin_y).sum() == 10


def test_words_are_made_printable():
    assert printable("a\nb\x00c µ ✓") == "a b c µ ✓"
    assert printable("叶") == "\u25a1"
    assert shorten("abcdefghij", 5) == "ab…ij" and shorten("abc", 5) == "abc"
