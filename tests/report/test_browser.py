"""The page of a comparison in a browser: nothing cut or blocked, readable.

Needs Chromium and its driver. `.ci/run` sets `DEEPFSI_BROWSER=required`: there, a missing browser
is a failure and no reason to skip.
"""

import numpy as np
import pytest
from selenium.webdriver.common.by import By

from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.comparison_page import write_report
from deepfsi.report.masks import masks_figure
from deepfsi.report.style import DESIGN_COLOURS
from deepfsi.sweeps.results import read_results, write_results
from deepfsi_paper.report.section import Claim, Picture, Section, Table
from deepfsi_paper.report.study_page import write_study
from shared.browser import CONTRASTS, CUT, OVERFLOW, SIZES, look
from shared.results import a_point, make_results, some_results, with_all

WIDTHS = 1280, 400
A4_WIDTH = 680  # CSS pixels between the margins


@pytest.fixture(scope="module")
def page(tmp_path_factory, all_drawn_once):
    """Give the address of the page of a wide comparison."""
    home = tmp_path_factory.mktemp("comparison")
    results = make_results(home, noises=("poisson", "gaussian"))
    widest = with_all(results, light="free-dwell", detectors="16x16", readout="both")
    write_results(home / "results.json", widest)
    return write_report(home).as_uri()


@pytest.fixture
def opened(browser, page):
    """Give the browser with the page, wide."""
    look(browser)
    browser.get_log("browser")
    browser.get(page)
    return browser


def style(element, name):
    return element.value_of_css_property(name)


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut_blocked_or_hard_to_read(opened, width):
    look(opened, width)
    opened.refresh()
    assert opened.execute_script("return window.innerWidth") == width
    assert opened.execute_script(OVERFLOW) <= 0
    assert opened.execute_script("return [...document.images].every(e => e.naturalWidth > 300)")
    assert opened.execute_script(CUT) == []
    contrasts = opened.execute_script(CONTRASTS)
    assert {"H1", "SPAN"} <= {tag for _, tag, _ in contrasts}
    assert contrasts[0][0] >= 4.5, contrasts[:5]
    sizes = opened.execute_script(SIZES)
    assert sizes[0][0] >= 11.2, sizes[:5]  # in tables of a narrow page
    assert opened.get_log("browser") == []


HOSTILE = (
    '<img src=x onerror="window.harmed = true">',
    "</text></svg><script>window.harmed = true</script>",
    f'id="a" url(#b) {DESIGN_COLOURS["deepfsi"]}',
    r"C:\data\1 $\frac$ {{ 7 }} &lt;b&gt;",
)
"""Names of classes, data sets and folders that break careless pages."""


def hostile_pages(home, name):
    """Address of a page of each kind, with a name wherever a user's words may stand."""
    plain = a_point(title=name, label=name, variant=name, covers=name, light=name, rails=name)
    other = a_point(0.8, design="pca", title=name, label=name, variant=f"{name}2")
    results = some_results([plain, other, a_point(noise=name)], recipe={"data": name, name: name})
    data = results.data.model_copy(update={"name": name, "classes": (name, "b")})
    changed = {"data": data, "title": name, "command": name}
    write_results(home / "results.json", results.model_copy(update=changed))
    page, words = write_report(home), 3 * [name]
    matrix = np.random.default_rng(0).normal(size=(2, 16))
    figures = (
        masks_figure(matrix, (4, 4), title=name),
        accuracy_figure(read_results(home / "results.json")),
    )
    section = Section(
        name="one",
        title=name,
        found=name,
        paper=name,
        pictures=tuple(Picture(each, name, name) for each in figures),
        claims=(Claim(name, True, name, name),),
        tables=(Table(name, tuple(words), (tuple(words),)),),
        files=(name,),
        command=name,
        data=name,
    )
    return page.as_uri(), write_study(home / "study", name, [section]).as_uri()


@pytest.mark.parametrize("name", HOSTILE)
def test_names_that_users_give_stay_text_wherever_they_stand(browser, tmp_path, name):
    look(browser)
    for address in hostile_pages(tmp_path, name):
        browser.get_log("browser")
        browser.get(address)
        assert browser.execute_script("return window.harmed === undefined")
        assert browser.execute_script("return document.scripts.length") == 0
        text = browser.execute_script("return document.body.textContent")
        assert text.count(name) > 6
        assert browser.get_log("browser") == []


def test_paper_gets_everything_in_black_on_white(opened):
    look(opened, A4_WIDTH, media="print")
    body = opened.find_element(By.TAG_NAME, "body")
    assert style(body, "background-color") == "rgba(255, 255, 255, 1)"
    assert style(body, "color") == "rgba(0, 0, 0, 1)"
    assert opened.execute_script(OVERFLOW) <= 0
    assert opened.execute_script(CUT) == []
    assert opened.execute_script(CONTRASTS)[0][0] >= 4.5
    for cell in opened.find_elements(By.CSS_SELECTOR, "td:last-child"):
        assert cell.rect["x"] + cell.rect["width"] <= A4_WIDTH + 0.5
    facts = "return [...document.querySelectorAll('dd')].map(fact => fact.checkVisibility())"
    assert set(opened.execute_script(facts)) == {True}
    for figure in opened.find_elements(By.CSS_SELECTOR, "figure:has(img)"):
        assert style(figure, "break-inside") == "avoid"
