"""The page of a design for a camera with dark counts, in Chromium: drawn, and read without them."""

import numpy as np
import pytest

from conftest import quick
from deepfsi.evaluation import playable
from deepfsi.report.playground import write_page
from shared.playground import DARK, DARK_KINDS, ask, open_playground

AGREES = 1e-5
"""Largest difference from the package's own numbers."""


@pytest.fixture(scope="module")
def designs(digits):
    kept = digits.hold_out(237)
    return {kind: quick(kept, epochs=15, lr=2e-2, **each) for kind, each in DARK_KINDS.items()}


@pytest.fixture(scope="module")
def pages(designs, digits, tmp_path_factory):
    home = tmp_path_factory.mktemp("pages")
    for kind, design in designs.items():
        write_page(home / f"{kind}.html", playable(design, digits))
    return {kind: (home / f"{kind}.html").as_uri() for kind in designs}


@pytest.fixture
def opened(browser, pages):
    return lambda kind: open_playground(browser, pages[kind])


@pytest.mark.parametrize("kind", DARK_KINDS)
def test_dark_counts_are_drawn_for_the_time_of_each_readout(opened, designs, kind):
    """Without light the counts of 400 exposures are Poisson's, of D dark counts of a detector."""
    design, exposures = designs[kind], 400
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
    if kind == "looks":  # its dwells differ from exposure to exposure, but not their sum
        wanted, found = DARK, sum(total) / exposures
    else:
        wanted, found = np.zeros(len(total)), np.array(total) / exposures
        for places, share in frames:
            wanted[places] += DARK * share
        assert wanted.sum() == pytest.approx(
            DARK * (2 if kind == "arms" else 4) * sum(share for _, share in frames), rel=1e-6
        )
        own = design.scanner("camera", 0.0, DARK).dark_counts(design.rails.count)
        np.testing.assert_allclose(wanted, own.flatten(), rtol=1e-5)
    np.testing.assert_array_less(np.abs(found - wanted), 5 * np.sqrt(wanted / exposures))


@pytest.mark.parametrize("kind", ["single", "arms"])
def test_the_answer_is_that_of_the_counts_without_the_dark_ones(opened, designs, kind):
    design = designs[kind]
    counts, chances, seen = ask(
        opened(kind),
        "const e = new Exposure(model, page.scene, 1e4, 3);"
        "const { counts, lit } = e.after(e.frames.length);"
        "return [[...counts], e.answer(e.frames.length).chances, [...lit]]",
    )  # fmt: skip
    dark = design.scanner("camera", 0.0, DARK).dark_counts(design.rails.count).numpy().ravel()
    read = np.array(counts) - dark
    assert all(count == int(count) for count in counts)  # what a counter shows
    np.testing.assert_allclose(seen, read, atol=1e-3)
    wanted = design.classify(read.reshape(design.counts_shape), 1e4)
    np.testing.assert_allclose(chances, wanted, atol=AGREES, rtol=0)


def test_pictures_of_other_cameras_have_dark_counts_of_the_same_detectors(opened):
    """Mean 0 where there is no light, with the variance of 300 dark counts of each detector."""
    raster, impulse, unit = ask(
        opened("single"),
        "const { constructor: Rivals } = page.rivals, black = page.scene.map(() => 0);"
        "const rivals = new Rivals(model, black, 1e4, 1);"
        "return [rivals.rasterAt(1), rivals.impulseAt(1), rivals.scale]",
    )
    for picture, variance in ((raster, DARK * len(raster)), (impulse, DARK)):
        drawn = np.array(picture) / unit
        assert abs(drawn.mean()) < 5 * np.sqrt(variance / len(drawn))
        assert 0.4 < drawn.var() / variance < 1.9  # of 64 values: 5 standard errors


def test_an_exposure_of_looks_is_one_of_classify_live(opened, designs):
    """The package, given the page's counts without the dark ones, asks for the same dwells."""
    design = designs["looks"]
    frames, chances = ask(
        opened("looks"),
        "const e = new Exposure(model, page.scene, 1e3, 5);"
        "return [e.frames.map(f => [f.look, f.mask, f.rails[0], f.share, f.counts[0]]), "
        "e.answer(e.frames.length).chances]",
    )
    told = iter(range(design.exposure.looks))

    def show(dwell):
        counts, shown, look = np.zeros(design.counts_shape), np.zeros(dwell.shape), next(told)
        for at, mask, rail, share, count in frames:
            if at == look:
                counts[rail, mask], shown[rail, mask] = count - DARK * share, share
        np.testing.assert_allclose(shown, dwell, atol=AGREES, rtol=0)
        return counts

    np.testing.assert_allclose(chances, design.classify_live(show, 1e3), atol=AGREES, rtol=0)
