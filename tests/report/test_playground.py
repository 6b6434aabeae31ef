"""The page to play with, in Chromium: its numbers are the package's, and everyone can use it."""

import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By

from conftest import quick
from deepfsi.designfile.misfit import FALSE_ALARM
from deepfsi.evaluation.page_data import playable
from deepfsi.report.demo import write_page
from shared.playground import (
    DARK,
    DARK_KINDS,
    KINDS,
    ask,
    fits,
    open_playground,
    page_writer,
    press_button,
    said,
    verdict_at,
)

AGREES = 1e-5
"""Largest difference from the package's own numbers."""

CLOSE = 1e-7
"""Of float32 sums of some tens of shares."""


@pytest.fixture(scope="module")
def designs(digits, all_trained_once):
    """Give designs by their kind, trained until they know something."""
    kept = digits.hold_out(237)

    @cache
    def design(kind):
        settings = {**KINDS, **DARK_KINDS}[kind]
        return quick(kept, epochs=15, lr=2e-2, **settings)

    return design


@pytest.fixture(scope="module")
def pages(designs, digits, tmp_path_factory):
    few = replace(digits, x_test=digits.x_test[:100], y_test=digits.y_test[:100])
    return page_writer(tmp_path_factory.mktemp("pages"), designs, lambda _: few)


@pytest.mark.parametrize("kind", KINDS)
def test_rates_are_those_of_the_design(opened, designs, digits, kind):
    scenes = digits.x_test[:20]
    design = designs(kind)
    rates = design.exposure.rates(design.scanner(), torch.from_numpy(scenes)).numpy()
    found = ask(
        opened(kind), "return given.scenes.map(x => [...model.rates(x)])", scenes=scenes.tolist()
    )
    np.testing.assert_allclose(found, rates.reshape(len(scenes), -1), atol=CLOSE, rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_answers_as_the_design_does(opened, designs, kind):
    """Counts at budgets from far below those of its calibration to far above."""
    design, rng = designs(kind), np.random.default_rng(0)
    shape = (design.rails.count, design.masks, design.exposure.detection.count)
    width = design.exposure.detection.width(design.rails.count)
    share = float(design.exposure.shares.mean()) / width
    budgets = np.geomspace(3, 3e6, 6)
    counts = [rng.poisson(each * share * rng.uniform(0.5, 1.5, shape)) for each in budgets]
    found = ask(
        opened(kind),
        "return given.counts.map((each, k) => [...model.classify(each, given.budgets[k])])",
        counts=[each.ravel().tolist() for each in counts],
        budgets=budgets.tolist(),
    )
    for answer, each, photons in zip(found, counts, budgets, strict=True):
        wanted = design.classify(each.reshape(design.counts_shape), photons)
        np.testing.assert_allclose(answer, wanted, atol=AGREES, rtol=0)


@pytest.mark.parametrize("kind", [*KINDS, "dark", "dark-arms"])
def test_counts_are_tested_as_by_the_design(opened, designs, digits, kind):
    """Misfit and verdict of sound, dim, bright and inverted scenes, at budgets to both sides."""
    design, rng = designs(kind), np.random.default_rng(1)
    sound = digits.x_test[:30]
    scenes = np.concatenate([sound, 0.1 * sound, 8 * sound, sound.max() - sound])
    noise = "camera" if kind in DARK_KINDS else "poisson"
    dark = DARK if kind in DARK_KINDS else 0.0
    dark = design.scanner(noise, 0.0, dark).dark_counts(design.rails.count).numpy().ravel()
    trained = design.usual_misfit.budgets[1]
    for photons in (trained / 100, trained / 3, trained, 30 * trained):
        rates = design.exposure.rates(design.scanner(), torch.from_numpy(scenes)).double().numpy()
        lit = rng.poisson(rates.reshape(len(scenes), -1) * photons + dark) - dark
        shaped = lit.reshape(-1, *design.counts_shape)
        background = dark.reshape(design.counts_shape)
        all_on = rng.poisson(scenes.sum(axis=1) * (photons / design.summed_reflectance))
        rows = design.mask_exposure.scene_readouts(shaped, photons, background)
        found = ask(
            opened(kind),
            "const { photons, dark } = given; return given.counts.map((lit, i) => {"
            "  const misfit = model.misfit(lit, photons), light = lit.reduce((a, b) => a + b, 0);"
            "  const sums = [{ light: given.allOn[i], dark: 0 }, { light, dark }];"
            "  return [misfit, model.unlike({ misfit, looks: 1, photons, sums })]; })",
            counts=lit.tolist(),
            allOn=all_on.tolist(),
            photons=photons,
            dark=float(dark.sum()),
        )
        misfits, unlike = zip(*found, strict=True)
        np.testing.assert_allclose(misfits, design.scene_model.misfit(rows), rtol=1e-4)
        wanted = design.consistency(shaped, photons, background, all_on) < FALSE_ALARM
        assert wanted.tolist() == list(unlike)
    assert wanted[30:].mean() > 0.9
    assert wanted[:30].mean() < 0.1


def test_counts_unlike_those_of_the_training_get_no_answer(opened):
    browser = opened("column")
    assert verdict_at(browser, 4).startswith("Answer: ")
    ask(
        browser,
        "const { high } = model.scenes; page.scene = page.scene.map(x => high - x); page.renew()",
    )
    none = "No answer: these counts do not look like those of the training."
    assert verdict_at(browser, 4) == none
    assert "%" not in said(browser, "answer")
    assert not browser.find_elements(By.CSS_SELECTOR, "#answer .top, #answer .fill, .class-line")
    assert "No probabilities" in said(browser, "answer-words")


def test_a_page_of_a_design_that_knows_no_usual_counts_says_so(browser, designs, digits, tmp_path):
    design = replace(designs("column"), usual_misfit=None)
    page = write_page(tmp_path / "page.html", playable(design, digits))
    open_playground(browser, page.as_uri())
    ask(browser, "page.scene = page.scene.map(() => 0); page.renew()")
    assert verdict_at(browser, 4).startswith("Answer: ")
    assert "is not tested" in said(browser, "answer-words")


@pytest.mark.parametrize("rate", [0.01, 1, 10, 1e3, 1e6])
def test_counts_have_poissons_law(opened, browser, rate):
    if not browser.execute_script("return window.playground !== undefined"):
        opened("column")
    body = (
        "const random = new Random(7);"
        "return Array.from({ length: 40000 }, () => poisson(given.rate, random))"
    )
    counts = np.array(ask(browser, body, rate=rate))
    assert fits(counts, rate) > 1e-3
    wrong = rate + 15 * (rate / counts.size) ** 0.5
    drawn = np.random.default_rng(0).poisson(wrong, counts.size)
    assert fits(drawn, rate) < 1e-6  # the test sees a mean that is 15 standard errors off


def test_each_exposure_has_other_counts_and_a_seed_repeats_them(opened):
    browser = opened("column")
    body = "return given.seeds.map(s => new Exposure(model, page.scene, 1e3, s).frames[5].counts)"
    first, again, other = ask(browser, body, seeds=[3, 3, 4])
    assert first == again != other
    counts = "return page.exposure.frames.map(f => f.counts)"
    before = ask(browser, counts)
    press_button(browser, "expose")
    assert ask(browser, counts) != before


def scene(browser):
    return np.array(ask(browser, "return [...page.scene]"))


def test_drawing_with_the_mouse_changes_scene_and_answer(opened):
    browser = opened("column")
    press_button(browser, "clear")
    blank = scene(browser)
    assert np.ptp(blank) == 0
    pad = browser.find_element(By.ID, "scene")
    before = ask(browser, "return page.exposure.answer(48)")
    chain = ActionChains(browser, duration=20).move_to_element_with_offset(pad, 0, -80)
    chain.click_and_hold().move_by_offset(0, 80).move_by_offset(0, 80).release().perform()
    time.sleep(0.1)
    drawn = scene(browser).reshape(8, 8)
    assert drawn[2:6, 3:5].mean() > blank.max() + 0.2
    np.testing.assert_allclose(drawn[:, :2], blank.max(), atol=1e-6)
    low, high = ask(browser, "return [model.scenes.low, model.scenes.high]")
    assert low - 1e-6 <= drawn.min() < drawn.max() <= high + 1e-6
    assert ask(browser, "return page.exposure.answer(48)") != before
    assert said(browser, "scene-words") == "Your own scene."


def test_all_but_drawing_is_done_with_the_keyboard_alone(opened):
    browser = opened("column")

    def press(*keys):
        ActionChains(browser).send_keys(*keys).perform()

    def go(name):
        for _ in range(80):
            press(Keys.TAB)
            active = browser.switch_to.active_element
            at = active.get_attribute("id") or active.get_attribute("aria-label")
            assert active.value_of_css_property("outline-style") != "none", at
            if at == name:
                return
        raise AssertionError(name)

    go("Test scene 2, class 0")
    press(Keys.ENTER)
    assert ask(browser, "return page.chosen") == 1
    go("expose")
    press(Keys.SPACE)
    assert ask(browser, "return page.playing")
    go("time")
    press(Keys.END)
    assert "finished" in said(browser, "state")
    assert said(browser, "verdict").startswith("Answer: ")


@pytest.mark.parametrize("kind", ["column", "range"])
def test_an_exposure_is_watched_frame_by_frame(opened, kind):
    browser = opened(kind)
    assert said(browser, "verdict").startswith("Nothing is exposed yet")
    looks = ask(
        browser,
        "return page.exposure.frames.map(({ end }) => {"
        "  page.time = end; page.draw();"
        "  return ['count-words', 'answer'].map(n => document.getElementById(n).textContent) })",
    )
    counted, answers = zip(*looks, strict=True)
    counts = [int("".join(filter(str.isdigit, words))) for words in counted]
    assert counts == sorted(counts)
    assert counts[-1] == ask(
        browser, "return page.exposure.frames.flatMap(f => f.counts).reduce((a, b) => a + b)"
    )
    drawn = ask(browser, "return [...page.exposure.answers.keys()].filter(at => at > 0)")
    assert len(drawn) == {"column": 48, "range": 1}[kind]
    before = min(drawn) - 1  # no probability is shown where the network did not learn to answer
    assert ["%" in words for words in answers] == [False] * before + [True] * (len(looks) - before)
    assert said(browser, "verdict").startswith("Answer: ")


def test_names_that_users_give_stay_text(browser, designs, digits, tmp_path):
    name = "</script><img src=x onerror='window.harmed = true'>{{ 7 }}"
    classes = (name, *designs("column").classes[1:])
    data = replace(digits, name=name, preprocessing=name, classes=classes)
    design = replace(designs("column"), classes=classes)
    page = write_page(tmp_path / "page.html", playable(design, data))
    open_playground(browser, page.as_uri())
    assert browser.execute_script("return window.harmed === undefined")
    assert browser.execute_script("return document.images.length") == 0
    assert name in browser.find_element(By.TAG_NAME, "h1").text
    assert name in said(browser, "answer")
    assert browser.get_log("browser") == []


@pytest.mark.parametrize("kind", DARK_KINDS)
def test_dark_counts_are_drawn_for_the_time_of_each_readout(opened, designs, kind):
    """Without light the counts of 400 exposures are Poisson's, of D dark counts of a detector."""
    design, exposures = designs(kind), 400
    frames, total = ask(
        opened(kind),
        "const black = page.scene.map(() => 0), total = new Float64Array(model.readouts);"
        "let frames;"
        "for (let seed = 1; seed <= given.exposures; seed++) {"
        "  const e = new Exposure(model, black, 1, seed);"
        "  e.after(e.frames.length).counts.forEach((count, i) => (total[i] += count));"
        "  frames = e.frames.map(f => [f.places, f.share]);"
        "} return [frames, [...total]]",
        exposures=exposures,
    )
    wanted, found = np.zeros(len(total)), np.array(total) / exposures
    for places, share in frames:
        wanted[places] += DARK * share
    assert wanted.sum() == pytest.approx(
        DARK * (2 if kind == "dark-arms" else 4) * sum(share for _, share in frames), rel=1e-6
    )
    own = design.scanner("camera", 0.0, DARK).dark_counts(design.rails.count)
    np.testing.assert_allclose(wanted, own.flatten(), rtol=1e-5)
    np.testing.assert_array_less(np.abs(found - wanted), 5 * np.sqrt(wanted / exposures))


@pytest.mark.parametrize("kind", ["dark", "dark-arms"])
def test_the_answer_is_that_of_the_counts_without_the_dark_ones(opened, designs, kind):
    design = designs(kind)
    counts, chances, seen = ask(
        opened(kind),
        "const e = new Exposure(model, page.scene, 1e4, 3);"
        "const { counts, lit } = e.after(e.frames.length);"
        "return [[...counts], e.answer(e.frames.length), [...lit]]",
    )  # fmt: skip
    dark = design.scanner("camera", 0.0, DARK).dark_counts(design.rails.count).numpy().ravel()
    read = np.array(counts) - dark
    assert all(count == int(count) for count in counts)  # what a counter shows
    np.testing.assert_allclose(seen, read, atol=1e-3)
    wanted = design.classify(read.reshape(design.counts_shape), 1e4)
    np.testing.assert_allclose(chances, wanted, atol=AGREES, rtol=0)
