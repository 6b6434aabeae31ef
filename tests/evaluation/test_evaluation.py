"""Accuracy is counted right, repeats, and goes to its limits in the dark and in bright light."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import PHOTONS, every_optics, generator, light_on, quick, synthetic
from deepfsi import evaluate
from deepfsi.base import InputError
from deepfsi.datasets import from_arrays


@pytest.fixture(scope="module")
def results(good, digits):
    return evaluate(good, digits, [1e2, 1e3, 1e4, 1e6], draws=2)


def test_accuracy_is_the_trace_of_the_confusion_matrix_whose_rows_are_true_classes(results, digits):
    for result in results:
        confusion = np.array(result.confusion)
        assert confusion.sum() == 2 * len(digits.y_test) == result.images * result.draws
        assert result.accuracy == pytest.approx(confusion.trace() / confusion.sum())
        assert (confusion.sum(axis=1) == 2 * np.bincount(digits.y_test)).all()
        assert result.rates == pytest.approx(confusion.diagonal() / confusion.sum(axis=1))


def test_the_interval_of_one_draw_is_wilsons_over_images_and_says_what_it_covers(good, digits):
    for result in evaluate(good, digits, [1e2, 1e4], draws=1):
        n, z = result.images, 1.959964
        p = round(result.accuracy * n) / n
        middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
        half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
        assert (result.low, result.high) == pytest.approx((middle - half, middle + half), abs=1e-5)
        assert 0 <= result.low <= result.accuracy <= result.high <= 1
        assert "images" in result.covers


def test_more_draws_do_not_pretend_to_more_images(good, digits):
    """They leave the spread of images' probabilities p of an answer that is right, var p / n."""
    one, some, many = (evaluate(good, digits, 1e3, draws=draws)[0] for draws in (1, 8, 64))
    assert one.images == many.images == len(digits.y_test)
    p = np.array(many.right)
    noise = np.mean(p * (1 - p)) / (1 - 1 / 64)  # variance of one draw, of an image
    images = p.var() - noise / 64
    for result, draws in ((one, 1), (some, 8), (many, 64)):
        half = 1.96 * math.sqrt((images + noise / draws) / result.images)
        assert (result.high - result.low) / 2 == pytest.approx(half, rel=0.08)


@every_optics
def test_counts_in_the_mean_are_the_budget_times_the_shares(made, digits, light, rails):
    """Of scenes of the training exactly; what detectors draw has Poisson's error beside it."""
    trained = made("deepfsi", light, rails)
    known = replace(digits, x_test=digits.x_train, y_test=digits.y_train)
    [result] = evaluate(trained, known, 300.0, draws=1)
    assert result.counts == pytest.approx(300 * float(trained.shares.sum()), rel=1e-4)
    assert result.counts == pytest.approx(300 * result.throughput, rel=1e-4)
    assert sum(result.photons_per_mask) == pytest.approx(300 * result.throughput)
    n = len(known.y_test)
    counts = trained.scanner().counts(light_on(trained, digits.x_train, 300).float(), generator())
    assert abs(float(counts.sum()) / n - result.counts) < 5 * math.sqrt(result.counts / n)


def test_counts_are_of_the_test_scenes_and_of_light_alone(good, digits):
    """Brighter scenes give more; dark counts and read noise give none."""
    bright = replace(digits, x_test=np.minimum(2 * digits.x_test, 1))
    [usual] = evaluate(good, digits, 1e3, draws=1)
    [more] = evaluate(good, bright, 1e3, draws=1)
    assert more.counts > 1.05 * usual.counts
    [noisy] = evaluate(good, digits, 1e3, draws=2, noise="camera", dark=500.0, sigma=2.0)
    assert noisy.counts == pytest.approx(usual.counts, rel=1e-6)


def test_a_test_is_under_the_designs_camera_unless_another_is_given(digits):
    """Rates are counts of its exposure."""
    camera = {"exposure": "10ms", "dark": 5e4, "sigma": 2.0}
    made = quick(digits, camera=camera)
    own, again, other = (
        evaluate(made, digits, 1e3, draws=1, **settings)[0]
        for settings in (
            {},
            {"noise": "camera", "dark": 500.0, "exposure": 1.0},
            {"camera": "dmd"},
        )
    )
    assert own.confusion == again.confusion
    assert (own.noise, other.noise) == ("camera", "poisson")
    louder = evaluate(made, digits, 1e3, draws=1, camera=camera, exposure="1s")[0]
    assert louder.confusion != own.confusion
    assert louder == evaluate(made, digits, 1e3, draws=1, dark=5e4, exposure="1s")[0]
    with pytest.raises(InputError, match="no keyword 'nois': did you mean 'noise'"):
        evaluate(made, digits, 1e3, nois="poisson")


@pytest.mark.parametrize(
    ("design", "light", "throughput"),
    [("impulse", "column", 1), ("raster", "column", 1 / 64), ("hadamard", "column", 1),
     ("truncated-hadamard", "column", 1), ("pca", "two-arm", 1), ("hadamard", "equal-dwell", None)],
)  # fmt: skip
def test_throughput_of_known_designs(made, digits, design, light, throughput):
    result = evaluate(made(design, light, "dual"), digits, PHOTONS, draws=1)[0]
    if throughput is None:  # ±1 in 127 frames: all light in the first, half in each other
        assert result.throughput == pytest.approx(64 / 127, rel=1e-5)
    else:
        assert result.throughput == pytest.approx(throughput, rel=1e-5)


@pytest.mark.parametrize("rails", ["dual", "single"])
def test_classify_agrees_with_evaluate(made, digits, rails):
    """The same counts, drawn here and given to classify as a camera would."""
    design = made("deepfsi", "free-dwell", rails)
    result = evaluate(design, digits, PHOTONS, draws=1, seed=5)[0]
    scanner = design.scanner()
    shares = scanner.rates(torch.from_numpy(digits.x_test) / design.summed_reflectance)
    counts = scanner.read(shares * PHOTONS, generator(5)).numpy()
    given = counts if rails == "dual" else counts[..., 0, :]
    chances = design.classify(given, PHOTONS)
    assert (chances.argmax(axis=-1) == digits.y_test).mean() == pytest.approx(result.accuracy)
    true = chances[np.arange(len(chances)), digits.y_test]
    assert result.log_loss == pytest.approx(-np.log(true.clip(min=2**-23)).mean(), rel=1e-5)


def test_data_that_is_not_the_designs_is_refused(good, digits):
    x = digits.x_train.reshape(-1, 4, 16)
    flat = from_arrays(x, digits.y_train, classes=digits.classes, name="flat")
    for data, words in (
        (synthetic((12, 10)), "pixels"), (synthetic((8, 8)), "other classes"), (flat, "of shape")
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            evaluate(good, data, 1e3)


@pytest.mark.parametrize(
    "settings",
    [*({"draws": bad} for bad in (0, -1, 1.5)),
     *({"noise": "gaussian", "sigma": bad} for bad in (-1.0, math.nan, math.inf))],
    ids=str,
)  # fmt: skip
def test_draws_and_read_noise_that_cannot_be_are_refused(good, digits, settings):
    with pytest.raises(InputError):
        evaluate(good, digits, 1e3, **settings)


def test_a_pair_of_arrays_is_all_test(digits):
    """Labels are the names of the design's classes, or their numbers; not all need be there."""
    design = quick(digits)
    x, y = digits.x_test, digits.y_test
    [whole] = evaluate(design, digits, 1e4, draws=1)
    assert evaluate(design, (x.reshape(-1, 8, 8), y), 1e4, draws=1) == [whole]
    assert evaluate(design, (x, y.astype(str)), 1e4, draws=1) == [whole]
    two = np.isin(y, (3, 7))
    [few] = evaluate(design, (x[two], y[two]), 1e4, draws=1)
    assert (few.images, few.rates[0]) == (two.sum(), None)
    [left] = evaluate(design, (digits.x_train[:9], digits.y_train[:9]), 1e4, draws=1)
    assert "all 9 test scenes were trained on" in left.covers
    for wrong, match in [
        ((x, y + 1), "y holds the label 10"),
        ((x, y[:-1]), "give one label for each"),
        ((x, y.astype(float)), "give labels that are integers or strings"),
        ((x[:, :-1], y), "has 63 pixels and the design 64"),
    ]:
        with pytest.raises(InputError, match=match):
            evaluate(design, wrong, 1e4)


def test_counts_of_chosen_dwells_are_those_that_were_drawn(digits):
    """Sum of single counts of every look, within the Poisson error of all."""
    looks = quick(digits, light="free-dwell", rails="single", looks=3, noise="poisson")
    scanner, bright = looks.scanner(), looks.shares.argmax()
    with torch.no_grad():
        list(looks.exposure.network.parameters())[-1][bright] += (
            3.0  # of the scores: far from equal
        )
    [result] = evaluate(looks, digits, 300.0, draws=1)
    rates = looks.rates(scanner, torch.from_numpy(digits.x_test))
    with torch.no_grad():
        *_, seen = looks.observe(scanner, rates, generator(4), 300.0)
    drawn, n = float(seen.features.sum()) * 300 / len(rates), len(rates)
    # dwells differ between draws: the counts of a scene vary by more than photon noise
    spread = 300 * float(seen.features.sum(dim=1).std()) / math.sqrt(n)
    assert abs(drawn - result.counts) < 5 * math.sqrt(2) * spread
