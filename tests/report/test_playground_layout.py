"""Layout of the page to play with, for designs of both kinds, in Chromium at two widths."""

from pathlib import Path

import pytest
from selenium.webdriver.common.by import By

from conftest import quick
from deepfsi import learn
from deepfsi.evaluation import page_data
from shared.browser import CONTRASTS, CUT, OVERFLOW, look, requests_of
from shared.playground import KINDS, ask, outside, page_writer, press_button, said, wait_for_the_end
from shared.waiting import until

WIDTHS = 1280, 400
ADAPTIVE = {"adaptive": "dmd", "adaptive-arms": "two-arm"}
LOOKS = 8
"""Of adaptive masks: an exposure lasts five seconds."""

every_kind = pytest.mark.parametrize("kind", ["column", "range", *ADAPTIVE])


@pytest.fixture(scope="module")
def pages(digits, tmp_path_factory):
    def design(kind):
        if kind not in ADAPTIVE:
            return quick(digits, **KINDS[kind])
        settings = {"camera": ADAPTIVE[kind], "masks": LOOKS, "photons": 1e3}
        return learn(digits, design="adaptive", **settings)

    with pytest.MonkeyPatch.context() as patch:  # no test reads the accuracy here
        patch.setattr(page_data, "SLIDER_BUDGETS", page_data.SLIDER_BUDGETS[:1])
        yield page_writer(tmp_path_factory.mktemp("pages"), design, lambda _: digits)


@every_kind
@pytest.mark.parametrize("width", WIDTHS)
def test_expose_exposure_and_answer_are_in_view_together(opened, kind, width):
    browser, adaptive = opened(kind, width, height=800), kind in ADAPTIVE
    assert outside(browser, "expose", "scene", "light") == []  # before anything is scrolled
    assert said(browser, "verdict") == "Nothing is exposed yet: press Expose."
    assert said(browser, "count-words") == "0"
    if adaptive:
        assert ask(browser, "return page.exposure.taken") == 1  # the first mask needs no counts
    press_button(browser, "expose")
    seen = ["expose", "state", "mask", "verdict", "answer", *(["through"] if adaptive else [])]
    until(lambda: not outside(browser, *seen))  # the page goes to the exposure smoothly
    if adaptive:  # masks are made while one watches
        until(lambda: ask(browser, "return page.exposure.taken") > 1)
        assert ask(browser, "return page.exposure.taken") < LOOKS
    wait_for_the_end(browser)
    assert outside(browser, *seen) == []
    assert said(browser, "play") == "Play"
    assert said(browser, "verdict").startswith("Answer: ")


@every_kind
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut_hard_to_read_or_asked_for(opened, kind, width):
    browser = opened(kind, width)
    ask(browser, "page.time = 0.4 * page.exposure.length; page.draw()")
    assert browser.execute_script("return window.innerWidth") == width
    assert browser.execute_script(OVERFLOW) <= 0
    assert browser.execute_script(CUT) == []
    contrasts = browser.execute_script(CONTRASTS)
    assert {"H1", "text", "BUTTON", "FIGCAPTION", "SPAN"} <= {tag for _, tag, _ in contrasts}
    assert contrasts[0][0] >= 4.5, contrasts[:5]
    assert browser.get_log("browser") == []
    assert [url for url in requests_of(browser) if not url.startswith("file:")] == []


@pytest.mark.parametrize("width", WIDTHS)
def test_an_embedded_page_stands_whole_and_shows_its_exposure(browser, pages, tmp_path, width):
    script = (Path(__file__).parents[2] / "docs/static/site.js").read_text()
    frame = f'<iframe class="playable" src="{pages("range")}" style="width: 100%; border: 0">'
    home = tmp_path / "home.html"
    home.write_text(f"<!doctype html><script>{script}</script><p>Above</p>{frame}</iframe>")
    look(browser, width, height=800)
    browser.get(home.as_uri())
    embedded = browser.find_element(By.CSS_SELECTOR, "iframe")
    size = "const e = document.documentElement; return [e.scrollHeight, innerHeight]"

    def whole():
        browser.switch_to.default_content()
        browser.switch_to.frame(embedded)
        height, seen = browser.execute_script(size)
        return height == seen > 1000

    until(whole)
    press_button(browser, "expose")
    ends = "return [expose, answer].map((each) => each.getBoundingClientRect())"
    first, last = browser.execute_script(ends)
    browser.switch_to.default_content()

    def in_view():  # the page goes to the exposure smoothly
        top = browser.execute_script("return arguments[0].getBoundingClientRect().top", embedded)
        return top + first["top"] >= 0 and top + last["bottom"] <= 800

    until(in_view)


OVERPRINT = """
const texts = [...document.querySelectorAll('.chart svg text')].filter(e => e.checkVisibility());
const boxes = texts.map(e => e.getBoundingClientRect());
return texts.flatMap((a, i) => texts.slice(i + 1).filter((b, k) => {
  const [p, q] = [boxes[i], boxes[i + 1 + k]];
  return Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1
    && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 3;
}).map(b => `${a.textContent} | ${b.textContent}`));
"""
"""Words of charts that stand on each other; lines of text touch by up to 3 pixels."""


@pytest.mark.parametrize("width", WIDTHS)
def test_no_words_of_a_chart_stand_on_others(opened, width):
    """Of few and of many classes."""
    browser = opened("range", width)
    for chance in (0.5, 1 / 5, 1 / 100):
        ask(
            browser,
            "model.test.commonest = given.chance;"
            "page.time = 0.7 * page.exposure.length; page.sayLight(); page.draw()",
            chance=chance,
        )
        assert browser.execute_script(OVERPRINT) == [], chance
