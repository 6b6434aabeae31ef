"""Designs that the tests of the page play, counts of theirs, and a test of Poisson's law."""

import time

import numpy as np
import torch
from scipy import stats
from selenium.webdriver.common.by import By

from conftest import synthetic
from deepfsi import Design
from deepfsi.datasets import Dataset
from shared.browser import look

VECTORS = 100
ONE_ARM = {"light": "free-dwell", "rails": "single"}
KINDS = {
    "column": {"masks": 7},
    "equal": {"masks": 5, "light": "equal-dwell"},
    "arms": {"masks": 5, "light": "two-arm", "readout": "both"},
    "tiles": {"masks": 3, "light": "free-dwell", "detectors": "2x2"},
    "looks": {"masks": 8, "looks": 4, "shortest_dwell": 0.01, **ONE_ARM},
    "looks-both": {"masks": 5, "looks": 3, "light": "free-dwell", "readout": "both"},
    "nested": {"masks": 9, "nested": 3, "span": 1e3, "photons": 1e2, **ONE_ARM},
    "spectra": {"masks": 5, "light": "free-dwell"},
}
"""Settings of the designs that are played."""

DARK = 300.0
"""Dark counts of a detector in an exposure."""

DARK_KINDS = {
    "single": {"masks": 6, "dark": DARK, "detectors": "2x2", **ONE_ARM},
    "arms": {"masks": 5, "dark": DARK, "light": "two-arm"},
    "looks": {"masks": 5, "looks": 3, "dark": DARK, "light": "free-dwell", "readout": "both"},
}
"""Settings of designs for cameras with dark counts."""

PARTS = (
    "page", "model", "Exposure", "LookExposure", "LeastSquares", "Random", "poisson",
    "LookOptics", "Posterior", "candidates", "information", "nextMask", "sample",
)  # fmt: skip
"""Parts of a page that a test may ask."""


def read_counts(design: Design, digits: Dataset, kind: str):
    """Scenes, budgets, expected counts for one photon, and counts (V, rails · m · D)."""
    rng = np.random.default_rng(0)
    scenes = synthetic((24,), scenes=600).x_test if kind == "spectra" else digits.x_test
    photons = 10 ** rng.uniform(1, 7, VECTORS)
    rates = design.rates(design.scanner(), torch.from_numpy(scenes[:VECTORS])).numpy()
    counts = rng.poisson(rates * photons[:, None, None]).astype(np.float32)
    return scenes[:VECTORS], photons, rates, counts.reshape(VECTORS, -1)


def open_playground(browser, address: str, width=1280, scheme="light", **screen):
    """Open a page to play with, and wait for it."""
    look(browser, width, scheme, **screen)
    for log in ("browser", "performance"):
        browser.get_log(log)
    browser.get(address)
    for _ in range(200):
        if browser.execute_script("return window.playground !== undefined"):
            break
        time.sleep(0.05)
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
    browser.execute_script(
        "const l = document.getElementById('light'); l.value = arguments[0];"
        "l.dispatchEvent(new Event('input'));"
        "const { page } = window.playground; page.time = page.exposure.length; page.draw()",
        exponent,
    )  # fmt: skip
    return browser.find_element(By.ID, "verdict").text


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
