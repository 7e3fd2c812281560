"""Pages in a real browser: no error of a script, views switch, sliders move the arm, printing gives pages."""

from pathlib import Path

import pytest

from ocp.plan.report.pages import plan_pages
from tests.support.browser import CONTRAST, FAINT, GROUND, NEEDED, SPILT, browser
from tests.support.report_example import example_report

pytestmark = NEEDED
PICTURE = "(() => { const c = document.getElementById('canvas'); return c.toDataURL().length + c.toDataURL().slice(-4000); })()"


@pytest.fixture(scope="module")
def plan_page(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("page") / "report.html"
    plan_pages(example_report()).write_page(file)
    return file


@pytest.fixture(scope="module")
def page():
    with browser() as one:
        yield one


@pytest.fixture(autouse=True)
def without_errors(page):
    page.faults.clear()
    yield
    assert page.faults == []


@pytest.mark.parametrize(("width", "dark"), [(400, False), (1280, True), (1920, False)])
def test_a_page_fits_its_window_and_shows_verdict_and_picture_first(page, plan_page, width, dark):
    page.open(plan_page, width, dark=dark)
    assert page.run(SPILT) <= 0
    top = page.run("document.getElementById('canvas').getBoundingClientRect().top")
    assert top < 900 and page.run("document.querySelector('.verdict').getBoundingClientRect().bottom") < top
    assert page.run(GROUND) == ("rgb(20, 25, 31)" if dark else "rgb(255, 255, 255)")
    assert page.run(f"{FAINT}({CONTRAST})") == []
    stage = page.run("getComputedStyle(document.querySelector('.stage')).getPropertyValue('--panel')")
    assert stage.strip() == "#f5f7f9"  # the scene's colours mean numbers: its ground is light always


def test_views_switch_the_slider_moves_the_arm_and_the_address_keeps_them(page, plan_page):
    page.open(plan_page, 1280)
    pictures = []
    for view in ("blade", "cell", "wheel"):
        page.run(f"document.querySelector('[name=view][value={view}]').click()")
        page.drawn()
        pictures.append(page.run(PICTURE))
    assert len(set(pictures)) == 3
    page.run("document.querySelector('[name=view][value=cell]').click()")
    page.drawn()
    before = page.run(PICTURE)
    page.run("(() => { const t = document.getElementById('time'); t.value = 700; t.dispatchEvent(new Event('input')); })()")
    page.drawn()
    assert page.run(PICTURE) != before
    page.run("document.getElementById('time').dispatchEvent(new Event('change'))")
    assert "view=cell" in page.run("location.hash")


def test_keys_turn_the_scene_and_step_through_waypoints(page, plan_page):
    page.open(plan_page, 1280)
    before = page.run(PICTURE)
    for key in ("ArrowLeft", "+", "n"):
        page.run(f"document.getElementById('canvas').dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")
        page.drawn()
        after = page.run(PICTURE)
        assert after != before
        before = after
    assert page.run("document.getElementById('hover').hidden") in (False, True)


def test_every_link_of_the_page_leads_to_a_section(page, plan_page):
    page.open(plan_page, 1280)
    missing = page.run(
        "[...document.querySelectorAll('nav a')].filter(a => !document.querySelector(a.getAttribute('href'))).length"
    )
    assert missing == 0 and page.run("document.querySelectorAll('nav a').length") >= 8


def test_printing_gives_pages(page, plan_page):
    page.open(plan_page, 1280)
    paper = page.printed()
    assert paper.startswith(b"%PDF") and paper.count(b"/Type /Page\n") + paper.count(b"/Type /Page ") >= 2
