"""Designs that estimate values: bounds, units, files, and what is of classes alone."""

import math

import numpy as np
import pytest
import torch

from deepfsi import InputError, evaluate, ideal_observer, learn, predict
from deepfsi.design.onnx import to_onnx
from deepfsi.evaluation.page_data import check_playable
from shared.values import SLOPES, SPREAD, linear_scenes, placed_digits

SIGMA = 4.0
COLUMN = {"light": "column", "rails": "dual"}
READ_NOISE = COLUMN | {"noise": "gaussian", "sigma": SIGMA}


@pytest.fixture(scope="module")
def placed():
    return placed_digits()


@pytest.fixture(scope="module")
def design(placed):
    return learn(placed, camera="dmd", photons=1e4, masks=8, training={"epochs": 15})


@pytest.fixture(scope="module")
def linear():
    """Linear scenes, and a design of random masks with a linear network under read noise."""
    data = linear_scenes(6000, 6000)
    training = {"epochs": 12, "batch": 200, "classifier": torch.nn.Linear(8, 2), "scale": "each"}
    made = learn(data, camera=READ_NOISE, photons=1e3, masks=8, design="random", training=training)
    return data, made


def test_a_linear_network_reaches_the_posterior_of_the_linear_gaussian_model(linear):
    """Of x = 0.5 + θ B + SPREAD ε, y = Φ M x / s + noise, by its formula; none is below it."""
    data, made = linear
    gain = 1e3 / made.summed_reflectance
    mask = made.matrix.astype(float) * gain
    frames = (made.rails.stacked > 0).any(dim=-1).sum().item() / 8  # rails that are read
    noise = SPREAD**2 * mask @ mask.T + SIGMA**2 * frames * np.eye(8)
    inverse = np.eye(2) + (mask @ SLOPES.T).T @ np.linalg.solve(noise, mask @ SLOPES.T)
    bounds = np.sqrt(np.diag(np.linalg.inv(inverse)))
    [result] = evaluate(made, data, 1e3, draws=2)
    error = 5 / math.sqrt(2 * result.images)  # relative, of a root mean square of so many
    for rmse, bound in zip(result.rmse, bounds, strict=True):
        assert bound * (1 - error) < rmse < bound * (1.02 + error)
    assert result.low < result.r2 < result.high < 1


def test_what_is_of_classes_is_refused_in_one_line(placed, design, digits, tmp_path):
    counts = np.ones(design.counts_shape)
    for refused in (
        lambda: design.classify(counts, 1e4),
        lambda: check_playable(design),
        lambda: to_onnx(design),
        lambda: predict(design, tmp_path, 1e4),
        lambda: ideal_observer(design, placed, 1e4),
    ):
        with pytest.raises(InputError, match="is of classes") as error:
            refused()
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="and the design answers row, column"):
        evaluate(design, digits, 1e4)
    with pytest.raises(InputError, match="answers classes and estimates no values"):
        learn(digits, camera="dmd", photons=1e4, masks=2, design="pca",
              training={"epochs": 1}).estimate(np.ones((2, 2)), 1e4)  # fmt: skip
