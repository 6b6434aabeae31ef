"""Designs that the tests of the page play, counts of theirs, and a test of Poisson's law."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from scipy import stats
from selenium.webdriver.common.by import By

from deepfsi.evaluation.page_data import playable
from deepfsi.report.demo import write_page
from shared.browser import look
from shared.waiting import until

ONE_ARM = {"light": "free-dwell", "rails": "single"}
KINDS = {
    "column": {"masks": 7},
    "equal": {"masks": 5, "light": "equal-dwell"},
    "arms": {"masks": 5, "light": "two-arm", "readout": "both"},
    "tiles": {"masks": 3, "light": "free-dwell", "detectors": "2x2"},
    "both": {"masks": 5, "light": "free-dwell", "readout": "both"},
    "range": {"masks": 9, "span": 1e3, "photons": 1e2, **ONE_ARM},
}
"""Settings of the designs that are played."""

DARK = 300.0
"""Dark counts of a detector in an exposure."""

DARK_KINDS = {
    "dark": {"masks": 6, "dark": DARK, "detectors": "2x2", **ONE_ARM},
    "dark-arms": {"masks": 5, "dark": DARK, "light": "two-arm"},
}
"""Settings of designs for cameras with dark counts."""

PARTS = (
    "page", "model", "Exposure", "LookExposure", "Random", "poisson",
    "LookOptics", "Posterior", "candidates", "nextMask",
)  # fmt: skip
"""Parts of a page that a test may ask."""


def page_writer(home: Path, design_of: Callable, data_of: Callable) -> Callable[[str], str]:
    """Address of the page of a kind of design, which is written once it is asked for."""

    @cache
    def address(kind: str) -> str:
        page = write_page(home / f"{kind}.html", playable(design_of(kind), data_of(kind)))
        return page.as_uri()

    return address


def open_playground(browser, address: str, width=1280, **screen):
    """Open a page to play with, and wait for it."""
    look(browser, width, **screen)
    for log in ("browser", "performance"):
        browser.get_log(log)
    browser.get(address)
    until(lambda: browser.execute_script("return window.playground !== undefined"))
    return browser


def outside(browser, *names: str) -> list[str]:
    """Those of some elements, by their ids, that are not wholly in view."""
    script = (
        "return arguments[0].filter(name => { const e = document.getElementById(name);"
        "const box = e.getBoundingClientRect();"
        "return !e.checkVisibility() || box.top < 0 || box.bottom > innerHeight + 0.5; })"
    )
    return browser.execute_script(script, names)


def ask(browser, body, **given):
    """Value of a JavaScript function's body, with the page's parts and values by their names."""
    head = f"const {{{', '.join(PARTS)}}} = window.playground; const given = arguments[0];"
    return browser.execute_script(head + body, given)


def verdict_at(browser, exponent: float) -> str:
    """What the page says at the end of an exposure at a budget of 10 to this power."""
    set_light(browser, exponent)
    ask(browser, "page.time = page.exposure.length; page.draw()")
    return said(browser, "verdict")


def set_light(browser, exponent: float) -> None:
    """Move the slider of light to a budget of 10 to this power."""
    browser.execute_script(
        "const l = document.getElementById('light'); l.value = arguments[0];"
        "l.dispatchEvent(new Event('input'))",
        exponent,
    )


def said(browser, name: str) -> str:
    """Text of the element of an id."""
    return browser.find_element(By.ID, name).text


def press_button(browser, name: str) -> None:
    browser.find_element(By.ID, name).click()


def wait_for_the_end(browser) -> None:
    """Wait until an exposure that is played is finished, from shortly before its end."""
    ask(browser, "page.time = Math.max(page.time, 0.9 * page.exposure.length)")
    until(lambda: "finished" in said(browser, "state"))


def fits(counts: np.ndarray, rate: float) -> float:
    """P-value of counts (n,) under Poisson's law, in some 40 groups of like chance."""
    edges = np.unique(stats.poisson.ppf(np.linspace(0, 1, 41)[1:-1], rate))
    chances = np.diff([0, *stats.poisson.cdf(edges, rate), 1])
    seen = np.bincount(np.searchsorted(edges, counts), minlength=len(chances))
    kept = chances * len(counts) >= 5
    rest = [(seen[~kept].sum(), chances[~kept].sum())] if (~kept).any() else []
    groups = [*zip(seen[kept], chances[kept], strict=True), *rest]
    observed, expected = np.array([each for each in groups if each[1] > 1e-12]).T
    return stats.chisquare(observed, expected * len(counts)).pvalue
