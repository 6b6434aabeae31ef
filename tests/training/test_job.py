"""Jobs that are refused, and the precision that they get."""

import math

import numpy as np
import pytest
import torch

from conftest import PHOTONS, RECIPE, quick
from deepfsi.design.evaluation import evaluate
from deepfsi.errors import InputError
from deepfsi.optics import codes, constraints
from deepfsi.optics.rails import Rails
from deepfsi.progress import Report
from deepfsi.training.learning import train
from deepfsi.training.precision import (
    BFLOAT16_COUNTS,
    BFLOAT16_WIDTH,
    network_dtype,
    product_dtype,
)
from deepfsi.training.training_set import TrainingSet
from shared.jobs import job as job_of
from shared.jobs import learn

SETTINGS = {**RECIPE, "epochs": 3, "dropout": 0.1}
CPU = torch.device("cpu")


@pytest.mark.parametrize(
    "change", [{"masks": 7}, {"light": "free-dwell"}, {"epochs": 4}, {"looks": 2}, {"dark": 1.0}]
)
def test_jobs_that_differ_in_more_cannot_share_a_training(digits, change):
    jobs = [job_of(**{"masks": 6, "photons": 1e3, **SETTINGS, **more}) for more in ({}, change)]
    with pytest.raises(ValueError, match="may differ in photons, sigma and seed only"):
        train(TrainingSet(digits, "cpu"), jobs)


@pytest.mark.parametrize(
    "settings",
    [
        *({"photons": bad} for bad in (0, -1, math.nan, math.inf, "abc", None)),
        *({"masks": bad} for bad in (0, -1, 65, 10.5, math.nan, "ten")),
        {"design": "deepfsy"},
        {"light": "colum"},
        {"rails": "triple"},
        {"light": "two-arm", "rails": "single"},
        {"design": "hadamard", "masks": 64, "rails": "single"},
        {"design": "raster", "masks": 64, "light": "two-arm"},
        {"design": "lda", "masks": 10},
        {"noise": "poison"},
        *({"sigma": bad} for bad in (-1, math.nan, math.inf)),
        {"epochs": 0},
        {"batch": 1},
        *({"lr": bad} for bad in (0, -1, math.nan, math.inf)),
        *({"mask_lr": bad} for bad in (0, -1, math.nan, math.inf)),
        {"decay": math.inf},
        *({"dropout": bad} for bad in (-0.1, 1.0, math.nan)),
        *({"hidden": bad} for bad in ((0,), (-3,), (8, 0), (1.5,))),
        {"scale": "none"},
        *({"start": bad} for bad in ("pcaa", "deepfsi", "control", "custom", "hadamard")),
        {"precision": "float16"},
        *({"levels": bad} for bad in (1, -1, 2.5, 2**25)),
        {"seed": 1.5},
        {"seed": 2**70},
        {"design": "random", "seed": -1},
        {"device": "tpu"},
    ],
    ids=str,
)
def test_a_setting_that_is_not_allowed_is_one_clear_line(digits, settings):
    with pytest.raises(InputError) as error:
        learn(digits, **{"photons": 1e4, "masks": 7, "epochs": 1, "device": "cpu", **settings})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("matrix", "match"),
    [
        (np.ones((7, 63)), "shape"),
        (np.ones((6, 64)), "shape"),
        (np.ones(64), "shape"),
        (np.full((7, 64), np.nan), "finite"),
        (np.full((7, 64), "a"), "finite"),
        (np.zeros((7, 64)), "zero everywhere"),
        (np.full((7, 64), 0.2), "breaks the column constraint"),
        (None, "a matrix goes with"),
    ],
)
def test_a_bad_matrix_is_refused_before_training(digits, matrix, match):
    seen = []
    settings = {"photons": 1e4, "masks": 7, "device": "cpu"}
    report = Report(lambda share, what: seen.append(share))
    with pytest.raises(InputError, match=match):
        learn(digits, design="custom", matrix=matrix, report=report, **settings)
    assert not seen


def test_a_matrix_goes_only_with_the_custom_design(digits):
    with pytest.raises(InputError, match="a matrix goes with"):
        learn(digits, design="pca", matrix=np.full((7, 64), 0.1), photons=1e4, masks=7)


@pytest.fixture
def fast_processor(monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})


@pytest.mark.parametrize(
    ("limit", "settings"),
    [
        (20 * BFLOAT16_COUNTS, {}),
        (20 * BFLOAT16_COUNTS, {"noise": "poisson"}),
        (10 * BFLOAT16_COUNTS, {"rails": "single"}),
        (20 * 128, {"noise": "gaussian"}),
        (20 * 128 * 5, {"noise": "gaussian", "sigma": 5.0}),
    ],
)
def test_bfloat16_only_where_rounding_stays_under_the_noise(fast_processor, limit, settings):
    assert product_dtype(job_of(masks=10, photons=limit, **settings), CPU) == torch.bfloat16
    assert product_dtype(job_of(masks=10, photons=limit * 1.01, **settings), CPU) == torch.float32


def test_rounding_is_that_of_the_readout_with_most_light(fast_processor):
    """Nested masks may give all light to the first, looks to one, and raster has one rail."""

    def limit(design="deepfsi", **settings) -> float:
        alike = {"design": design, "masks": 8, "hidden": (BFLOAT16_WIDTH,), **settings}
        jobs = {
            masks: job_of(photons=masks * BFLOAT16_COUNTS, **alike) for masks in (1, 2, 4, 8, 16)
        }
        return max(masks for masks in jobs if network_dtype(jobs[masks], CPU) == torch.bfloat16)

    assert limit() == 16
    assert limit(nested=2) == 4
    assert limit(looks=4) == 2
    assert limit("raster") == 8


def test_no_noise_or_no_fast_processor_means_float32(fast_processor, monkeypatch):
    assert product_dtype(job_of(masks=10, photons=1e2, noise="none"), CPU) == torch.float32
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    assert product_dtype(job_of(masks=10, photons=1e2), CPU) == torch.float32


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_precision_asked_for_is_used(precision):
    one = job_of(masks=2, photons=1e8, precision=precision)
    assert product_dtype(one, CPU) == getattr(torch, precision)


def test_networks_are_in_bfloat16_where_they_are_wide_and_not_a_users_own(fast_processor):
    def kind(photons=1e4, device=CPU, **settings) -> torch.dtype:
        settings = {"hidden": (BFLOAT16_WIDTH, 40), **settings}
        return network_dtype(job_of(masks=10, photons=photons, **settings), device)

    assert kind() == torch.bfloat16
    assert kind(hidden=(BFLOAT16_WIDTH - 1, 40)) == kind(hidden=()) == torch.float32
    assert kind(photons=20.01 * BFLOAT16_COUNTS) == torch.float32
    assert kind(photons=1e8, precision="bfloat16") == torch.bfloat16
    assert kind(precision="float32") == kind(device=torch.device("cuda")) == torch.float32
    assert kind(classifier="module:factory") == torch.float32


def rounding(digits, masks: int, photons: float) -> float:
    """RMS error of bfloat16 products over photon noise, for the worst mask."""
    matrix = torch.from_numpy(codes.sensing_matrix("pca", masks, digits)).float()
    rails = Rails.of(constraints.fit(matrix, "column"))
    difference, total = rails.difference, rails.total
    x = torch.from_numpy(digits.x_train)
    light = photons * x.double() / x.double().sum(dim=1).mean()
    exact, noise = light @ difference.double().T, (light @ total.double().T).sqrt()
    half = (x.bfloat16() @ difference.bfloat16().T).double() * photons / x.double().sum(1).mean()
    return float(((half - exact) / noise).square().mean(dim=0).sqrt().max())


def test_bfloat16_error_is_under_the_photon_noise_where_allowed(digits):
    assert rounding(digits, 10, 20 * BFLOAT16_COUNTS) < 0.5
    assert rounding(digits, 2, 1e8) > 1  # and would not be here


def test_training_in_bfloat16_reads_as_well(digits):
    designs = (
        quick(digits, masks=10, epochs=8, precision=each) for each in ("float32", "bfloat16")
    )
    accuracy = [evaluate(design, digits, PHOTONS)[0].accuracy for design in designs]
    assert accuracy[0] == pytest.approx(accuracy[1], abs=0.05)
