"""Area under the ROC curve and its interval."""

import numpy as np
import pytest
from scipy import stats
from sklearn.metrics import roc_auc_score

from deepfsi.base.numeric import auc as auc_of
from deepfsi.base.numeric import auc_terms


def auc(scores, positive):
    return auc_of(auc_terms(scores, positive), positive)


def normal_scores(seed, images=120, draws=2, distance=1.0):
    rng = np.random.default_rng(seed)
    positive = np.arange(images) % 3 == 0
    own = rng.normal(size=(images, 1)) + distance * positive[:, None]
    return own + 0.5 * rng.normal(size=(images, draws)), positive


def test_it_is_the_area_of_scikit_learn_ties_half():
    scores, positive = normal_scores(0)
    rough = scores.round(0)  # many ties
    assert auc(rough, positive)[0] == pytest.approx(
        roc_auc_score(np.repeat(positive, 2), rough.ravel())
    )


def test_the_interval_covers_the_true_area_in_95_of_100_samples():
    """One observation an image: the area is Φ(distance / √(2 · variance))."""
    truth = stats.norm.cdf(1.0 / np.sqrt(2 * (1 + 0.25)))
    covered = [
        low <= truth <= high
        for _, low, high in (auc(*normal_scores(seed, draws=2)) for seed in range(400))
    ]
    assert stats.binomtest(sum(covered), 400, 0.95).pvalue > 1e-3


def test_draws_of_one_image_are_no_images():
    scores, positive = normal_scores(1, draws=1)
    _, low, high = auc(scores, positive)
    again = auc(np.repeat(scores, 5, axis=1), positive)
    assert again[1:] == pytest.approx((low, high), rel=1e-9)


def test_an_area_of_one_has_an_interval():
    area, low, high = auc(np.array([[0.0], [0.1], [0.9], [1.0]]), np.array([0, 0, 1, 1], bool))
    assert (area, high) == (1.0, 1.0)
    assert low < 1


def test_it_covers_training_seeds_too():
    """Three trainings that look at the same images, each with a distance of its own."""
    covered, runs = 0, 300
    truth = stats.norm.cdf(1.0 / np.sqrt(2 * (1 + 0.25) + 0.3**2))
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        image, positive = rng.normal(size=(200, 1)), np.arange(200) % 3 == 0
        rows = []
        for _ in range(3):
            apart = (1.0 + 0.3 * rng.normal()) * positive[:, None]
            scores = image + apart + 0.5 * rng.normal(size=(200, 1))
            rows.append(auc_terms(scores, positive))
        _, low, high = auc_of(np.array(rows), positive)
        covered += low <= truth <= high
    assert covered >= stats.binom.ppf(3e-5, runs, 0.95)
