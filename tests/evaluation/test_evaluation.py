"""Accuracy is counted right, repeats, and goes to its limits in the dark and in bright light."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import PHOTONS, every_optics, generator, light_on, quick
from deepfsi import InputError, evaluate, from_arrays
from deepfsi.evaluation.results import results_lines


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
    assert result.counts == pytest.approx(300 * float(trained.exposure.shares.sum()), rel=1e-4)
    assert result.counts == pytest.approx(300 * result.throughput, rel=1e-4)
    assert sum(result.photons_per_mask) == pytest.approx(300 * result.throughput)
    n = len(known.y_test)
    counts = trained.scanner().counts(light_on(trained, digits.x_train, 300).float(), generator())
    assert abs(float(counts.sum()) / n - result.counts) < 5 * math.sqrt(result.counts / n)


def test_a_test_is_under_the_designs_camera_unless_another_is_given(digits):
    """Rates are counts of its exposure."""
    camera = {"exposure": "10ms", "dark": 5e4, "sigma": 2.0}
    made = quick(digits, camera=camera)

    def tested(**settings):
        return evaluate(made, digits, 1e3, draws=1, **settings)[0]

    own, other = tested(), tested(camera="dmd")
    assert own.confusion == tested(noise="camera", dark=500.0, exposure=1.0).confusion
    assert (own.noise, other.noise) == ("camera", "poisson")
    louder = tested(camera=camera, exposure="1s")
    assert louder.confusion != own.confusion
    assert louder == tested(dark=5e4, exposure="1s")


@pytest.mark.parametrize(
    ("design", "light", "throughput"),
    [
        ("impulse", "column", 1),
        ("raster", "column", 1 / 64),
        ("hadamard", "column", 1),
        ("truncated-hadamard", "column", 1),
        ("pca", "two-arm", 1),
        ("hadamard", "equal-dwell", 64 / 127),  # all light in the first frame, half in the others
    ],
)
def test_throughput_of_known_designs(made, digits, design, light, throughput):
    [result] = evaluate(made(design, light, "dual"), digits, PHOTONS, draws=1)
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


def test_what_is_not_the_designs_is_refused(good, digits):
    x, y = digits.x_test, digits.y_test
    flat = from_arrays(digits.x_train.reshape(-1, 4, 16), digits.y_train, classes=digits.classes)
    for match, data in {
        " 11, and the design answers 0, 1": from_arrays(x.reshape(-1, 8, 8), np.arange(360) % 20),
        "of shape .*4, 16": flat,
        "holds the label 10": (x, y + 1),
        "359,. for 360 scenes": (x, y[:-1]),
        "holds the label 0.5": (x, y + 0.5),
        "of shape": (x[:, :-1], y),
    }.items():
        with pytest.raises(InputError, match=match):
            evaluate(good, data, 1e3)
    for sigma in (-1.0, math.nan, math.inf):
        with pytest.raises(InputError):
            evaluate(good, digits, 1e3, noise="gaussian", sigma=sigma)
    with pytest.raises(InputError, match="no such setting: did you mean 'noise'"):
        evaluate(good, digits, 1e3, nois="poisson")


def test_a_pair_of_arrays_is_all_test(good, digits):
    """Labels are the names of the design's classes, or their numbers; not all need be there."""
    x, y = digits.x_test, digits.y_test
    whole = evaluate(good, digits, 1e4, draws=1)
    assert evaluate(good, (x.reshape(-1, 8, 8), y), 1e4, draws=1) == whole
    assert evaluate(good, (x, y.astype(str)), 1e4, draws=1) == whole
    two = np.isin(y, (3, 7))
    [few] = evaluate(good, (x[two], y[two]), 1e4, draws=1)
    assert (few.images, few.rates[0]) == (two.sum(), None)
    said = [line for line in results_lines([few], title="", classes=good.classes)
            if str(line).startswith("never tested")]  # fmt: skip
    assert said == ["never tested, as the test has no scene of it: 0, 1, 2, 4, 5, 6, 8, 9"]
    [left] = evaluate(good, (digits.x_train[:9], digits.y_train[:9]), 1e4, draws=1)
    assert "all 9 test scenes were trained on" in left.covers
