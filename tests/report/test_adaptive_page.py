"""The page of adaptive masks, in Chromium: what it computes is what the package computes."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from selenium.webdriver.common.by import By

from conftest import exposing, generator
from deepfsi import Camera, learn
from deepfsi.adaptive.exposure import prior_of
from deepfsi.adaptive.posterior import AdaptivePosterior, LookOptics
from deepfsi.designfile.misfit import FALSE_ALARM
from deepfsi.designfile.view_test import SceneReadouts
from deepfsi.evaluation import page_data as payload
from deepfsi.evaluation.page_data import of_page, playable
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi.report.demo import write_page
from shared.playground import ask, open_playground

LOOKS, PHOTONS, VECTORS = 6, 1e3, 20
SURE_ENOUGH = 1 - 1 / 128
"""Probability of a class beyond which all scenes drawn by `next_masks` may be of it."""

SURE = 0.2
"""Probability above which a design with a rule stops."""

KINDS = {
    "one": {"camera": "dmd"},
    "arms": {"camera": "two-arm"},
    "dark": {"camera": Camera(dark=3e3, detectors="2x2")},
    "centres": {"camera": "dmd", "training": {"clusters": 8}},
}
"""Cameras; beside them there is `among`, where a scene is one of those of the prior."""

CLOSE = 1e-6
"""Largest difference from the package in 64 bits, of sums of log-likelihoods of 1e6 counts."""


@pytest.fixture(scope="module")
def designs(digits, all_trained_once):
    few, made = replace(digits, x_train=digits.x_train[:700], y_train=digits.y_train[:700]), {}
    for kind, settings in KINDS.items():
        made[kind] = learn(few, design="adaptive", masks=LOOKS, photons=PHOTONS, **settings)
    known = AdaptiveMasks(looks=LOOKS, spread=0.0)
    made["among"] = exposing(made["one"], prior=prior_of(few, known), settings=known)
    rule = {"stopping": {"threshold": SURE, "photons": PHOTONS}}
    made["one"] = replace(made["one"], info=made["one"].info | rule)
    return made


@pytest.fixture(scope="module")
def pages(designs, digits, tmp_path_factory):
    home = tmp_path_factory.mktemp("pages")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            payload, "SLIDER_BUDGETS", payload.SLIDER_BUDGETS[:1]
        )  # no test reads the accuracy here
        for kind, design in designs.items():
            write_page(home / f"{kind}.html", playable(design, digits))
    return {kind: (home / f"{kind}.html").as_uri() for kind in designs}


@pytest.fixture
def opened(browser, pages):
    def open_page(kind, width=1280, **screen):
        return open_playground(browser, pages[kind], width, **screen)

    return open_page


@pytest.fixture
def double():
    """Compute in 64 bits, as a browser does."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.fixture
def exposures(designs, digits, double):
    """Exposures of test scenes with the package in 64 bits: masks, counts, and what is known."""

    def doubled(prior):
        prior = copy(prior)
        for name in ("mean", "components", "coefficients"):
            setattr(prior, name, getattr(prior, name).double())
        return prior

    def expose(kind):
        design, found = of_page(designs[kind]), []
        budgets = np.geomspace(10, 1e6, VECTORS)
        share = design.prior_exposure.settings.shares[0]
        for number, photons in enumerate(budgets):
            optics = LookOptics.of(design.camera, design.image_shape, float(photons))
            prior, x = doubled(design.prior_exposure.prior), digits.x_test[number]
            state = AdaptivePosterior(prior, 1, optics)
            noise, looks = generator(number), []
            for _ in range(LOOKS):
                start = float(torch.rand(1, 1, generator=generator(int(noise.initial_seed()))))
                masks = state.next_masks(share, generator(int(noise.initial_seed())))
                mean = state.expected(masks, torch.from_numpy(x)[None].double(), share)
                counts = torch.poisson(mean, generator=noise)
                before = state.candidates()[0].tolist()
                sure = float(
                    state.class_probabilities.max()
                )  # by which scenes are drawn: not calibrated
                misfit = float(state.misfit(masks, counts, share))
                state.update(masks, counts, share)
                looks.append(
                    {
                        "start": start, "open": sure < SURE_ENOUGH, "candidates": before,
                        "mask": masks[0].tolist(), "expected": mean[0].tolist(),
                        "counts": counts[0].tolist(), "chances": state.probabilities[0].tolist(),
                        "scene": state.scene[0].tolist(), "misfit": misfit,
                    }
                )  # fmt: skip
            found.append({"photons": float(photons), "scene": x.tolist(), "looks": looks})
        return found

    return expose


@pytest.mark.parametrize("kind", [*KINDS, "among"])
def test_posterior_and_masks_are_those_of_the_package(opened, designs, exposures, kind):
    """Each look of the package, told to the page: what it counts, knows, and would show next."""
    vectors = exposures(kind)
    sent = [
        {**each, "looks": [{n: v for n, v in look.items() if n != "chances"} for look in looks]}
        for each in vectors
        for looks in [each["looks"]]
    ]
    found = ask(
        opened(kind),
        "return given.vectors.map(({ photons, scene, looks }) => {"
        "  const optics = new LookOptics(model, photons);"
        "  const state = new Posterior(model.prior, optics);"
        "  return looks.map(({ start, mask, counts }) => {"
        "    const share = model.shares[0], before = candidates(state);"
        "    const shown = nextMask(state, share, start);"
        "    const expected = optics.expected(mask, scene, share);"
        "    const misfit = state.misfit(mask, counts, share);"
        "    state.update(mask, counts, share);"
        "    return { candidates: before.map(each => [...each]), mask: [...shown], expected,"
        "      misfit, chances: [...state.chances], scene: [...state.scene] };"
        "  }); });",
        vectors=sent,
    )
    pairs = [
        (mine, theirs)
        for each, own in zip(vectors, found, strict=True)
        for mine, theirs in zip(each["looks"], own, strict=True)
    ]
    wanted, told = ({name: [p[i][name] for p in pairs] for name in pairs[0][1]} for i in (0, 1))
    np.testing.assert_allclose(told["expected"], wanted["expected"], rtol=CLOSE)
    np.testing.assert_allclose(told["misfit"], wanted["misfit"], rtol=1e-4)
    np.testing.assert_allclose(told["chances"], wanted["chances"], atol=CLOSE, rtol=0)
    np.testing.assert_allclose(told["scene"], wanted["scene"], atol=CLOSE, rtol=0)
    assert np.ptp(wanted["chances"], axis=0).max() > 0.5  # answers differ
    # where all drawn scenes are of one class no mask tells more than another
    undecided = [pair for pair in pairs if pair[0]["open"]]
    assert len(undecided) > 40
    for mine, theirs in undecided:
        assert sorted(mine["candidates"]) == sorted(theirs["candidates"])
        ways = [mine["mask"]]
        if kind == "arms":  # the arms changed over tell as much
            ways.append([1 - on for on in mine["mask"]])
        assert theirs["mask"] in ways


def test_looks_are_tested_as_by_the_package(opened, designs, digits):
    """Verdicts of misfits and of light, after few looks and all, at budgets around its own."""
    design = designs["dark"]
    exposure = design.prior_exposure
    rng = np.random.default_rng(0)
    told, wanted = [], []
    for photons in np.geomspace(PHOTONS / 100, PHOTONS * 100, 40):
        gain, looks = photons / exposure.summed_reflectance, int(rng.integers(1, LOOKS + 1))
        light = photons * float(rng.lognormal(0, 1))
        misfit = float(rng.lognormal(np.log(4 * looks), 1))
        sums = [{"light": light, "dark": 0}]
        told.append({"misfit": misfit, "looks": looks, "photons": photons, "sums": sums})
        rows = SceneReadouts.all_on(np.array([light]), gain, 0.0, digits.pixels)
        share = exposure.prior.model.light(rows, exposure.usual_misfit.light[0])
        p_values = exposure.usual_misfit.p_values(np.array([misfit]), looks, photons, share)
        wanted.append(bool(p_values[0] < FALSE_ALARM))
    found = ask(opened("dark"), "return given.told.map(each => model.unlike(each))", told=told)
    assert found == wanted
    assert 5 < sum(wanted) < 35


def test_a_sound_exposure_gets_an_answer_and_an_inverted_one_none(opened):
    browser = opened("arms")
    ask(browser, "page.time = page.exposure.length; page.draw()")
    assert browser.find_element(By.ID, "verdict").text.startswith("Answer: ")
    ask(
        browser,
        "const { high } = model.scenes; page.scene = page.scene.map(x => high - x); page.renew();"
        "page.time = page.exposure.length; page.draw()",
    )
    assert browser.find_element(By.ID, "verdict").text.startswith("No answer: these counts")


def test_an_exposure_is_watched_look_by_look(opened):
    browser = opened("arms")
    said, states, scenes = [], [], []
    for look in range(LOOKS):
        ask(browser, "page.time = page.exposure.frames[given.look].end; page.draw()", look=look)
        said.append(int(browser.find_element(By.ID, "count-words").text.replace("\u202f", "")))
        states.append(browser.find_element(By.ID, "state").text)
        scenes.append(browser.execute_script("return through.toDataURL()"))
    wanted = ask(browser, "return page.exposure.frames.map(f => f.counts.reduce((a, b) => a + b))")
    assert said == np.cumsum(wanted).tolist()
    assert states[0].endswith(f"look 2 of {LOOKS}")
    assert states[-1].endswith("finished")
    assert len(set(scenes)) == LOOKS
    assert browser.find_element(By.ID, "verdict").text.startswith("Answer: ")


def test_an_exposure_ends_where_the_rule_of_the_design_stops_it(opened):
    stop, chances, said, state = ask(
        opened("one", still=True),
        "document.getElementById('expose').click(); const { exposure } = page;"
        "const sure = [...exposure.answers.values()].map(chances => Math.max(...chances));"
        "const said = ['verdict', 'state'].map(id => document.getElementById(id).textContent);"
        "return [exposure.stop, sure, ...said]",
    )
    early = [number for number, sure in enumerate(chances, start=1) if sure > SURE]
    assert [stop["count"]] == early == [len(chances)]
    assert early[0] < LOOKS
    assert f"It stopped after look {early[0]} of {LOOKS}" in said
    assert state.endswith("finished")


def test_who_asks_for_less_motion_sees_the_end_at_once(opened):
    browser = opened("one", still=True)
    browser.find_element(By.ID, "expose").click()
    assert "finished" in browser.find_element(By.ID, "state").text
    assert not ask(browser, "return page.playing")
