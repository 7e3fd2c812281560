"""The kit of reports: parts draw themselves on the page and on paper, nothing is smuggled in, nothing runs over an edge."""

import re
from dataclasses import replace

import numpy as np
import pytest
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ocp.report.parts import Facts, Plot, Points, column_widths, made_from, table
from ocp.report.plotting import WIDTH, Canvas, dressed, envelope, finished, inline_svg
from ocp.report.report import Report
from ocp.report.section import Headline, Part, Section
from ocp.report.sheets import Sheets, new_sheet, width_of, wrapped
from ocp.report.style import printable, shorten

HOSTILE = '</td><script>alert("x")</script>&amp;'


class Stamp(Part):
    """A part that a command brings itself."""

    def on_page(self) -> Markup:
        return Markup("<b>stamped</b>")

    def on_sheets(self, sheets: Sheets) -> None:
        sheets.paragraph("stamped")

    def beginning(self) -> float:
        return 0.2


def report(*parts: Part | str, **changes) -> Report:
    section = Section("One", parts, **changes)
    head = Headline(True, "Good.", "All is well.")
    return Report("Test", "title", head, ("mind this",), (section, made_from({"a.csv": "ab" * 32})))


def line(canvas: Canvas) -> None:
    canvas.subplots().plot([0, 1], [0, 1])


def usual_parts() -> tuple[Part | str, ...]:
    bars = table(("what", "use"), [("A1", "50 %"), ("A2", "over"), ("A3", "none")], (0, 1), bars={1: (0.5, 1.2, np.nan)})
    return ("words", Points(("one", "two"), numbered=True), Facts((("asked", "answered"),)), bars, Plot("p", "seen", 1.0, line))


def words_of(sheets: Sheets) -> list[str]:
    return [text.get_text() for sheet in sheets.all for text in sheet.figure.texts]


def test_every_part_says_the_same_on_page_and_paper():
    for part in (*usual_parts()[1:], Stamp()):
        sheets = Sheets([new_sheet()], 1.0)
        part.on_sheets(sheets)
        page = re.sub(r"<svg.*?</svg>", "", str(part.on_page()), flags=re.S)
        told = set(re.sub(r"<[^>]+>", "\n", page).split("\n")) - {""}
        assert told and told <= set(words_of(sheets)) and sheets.y > 1.0


def test_a_page_runs_the_scripts_of_its_sections_and_no_other():
    quiet, loud = report(*usual_parts()).page(), report("x", script="let a = 1;", style=".a { top: 0 }").page()
    assert "<script" not in quiet and "script-src" not in quiet
    assert loud.count("<script>let a = 1;</script>") == 1 and "script-src 'sha256-" in loud and ".a { top: 0 }" in loud


def test_words_stay_words():
    parts = (HOSTILE, Points((HOSTILE,)), Facts(((HOSTILE, HOSTILE),)), table((HOSTILE,), [(HOSTILE,)]))
    hostile = replace(report(*parts), title=HOSTILE)
    assert "<script" not in hostile.page() and hostile.page().count("&lt;script&gt;") == 8


def test_a_bar_is_as_long_as_its_share_and_never_longer_than_all():
    page = str(usual_parts()[3].on_page())
    assert re.findall(r'<rect width="([\d.]+)" height="8" class="(part|full)"', page) == [("50.0", "part"), ("100.0", "full")]


def test_equal_reports_are_equal_bytes_without_a_date(tmp_path):
    for name in ("a.pdf", "b.pdf"):
        report(*usual_parts()).write_pdf(tmp_path / name)
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes() and b"CreationDate" not in content


def test_long_tables_go_on_with_their_head_on_the_next_sheet():
    sheets = Sheets([new_sheet()], 1.0)
    table(("key", "value"), [(f"k{i}", "1") for i in range(100)]).on_sheets(sheets)
    assert len(sheets.all) == 2 and words_of(sheets).count("key") == 2
    assert all(f"k{i}" in words_of(sheets) for i in range(100))


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


def test_wrapped_lines_fit_and_lose_nothing():
    words = "Neighbours that point the same way are a pattern " * 3 + "averyveryveryverylongnamewithoutanyspaceinit" * 2
    lines = wrapped(words, 2.0, 8.0)
    assert all(width_of(line, 8.0) <= 2.0 for line in lines)
    assert "".join(lines).replace(" ", "") == words.replace(" ", "")
    wide = table(("a", "b", "c"), [("x", "word " * 60, "12.5")], text=(0, 1))
    assert sum(column_widths(wide)) <= WIDTH and column_widths(wide)[2] >= width_of("12.5", 7.0)


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


def test_words_are_made_printable():
    assert printable("a\nb\x00c µ ✓") == "a b c µ ✓"
    assert printable("叶") == "\u25a1"
    assert shorten("abcdefghij", 5) == "ab…ij" and shorten("abc", 5) == "abc"
