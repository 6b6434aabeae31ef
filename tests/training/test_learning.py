"""Designs that training makes: masks, own matrices, grey levels, statistics, shapes of scenes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import deepfsi
from conftest import (
    FLOAT32,
    PHOTONS,
    every_optics,
    generator,
    light_on,
    quick,
    same,
    synthetic,
    two_valued,
)
from deepfsi import Camera, InputError, evaluate
from deepfsi.evaluation.page_data import check_playable
from deepfsi.physics.laws import light_law
from deepfsi.training import characterisation
from shared.jobs import learn


@every_optics
def test_learned_masks_are_dark_where_no_scene_varies(digits, made, light, rails):
    """Light from there is noise alone; on two arms one of them gets it in any case."""
    constant = torch.from_numpy((digits.x_train == digits.x_train[0]).all(axis=0))
    rails_there = made("deepfsi", light, rails).rails.stacked[..., constant]
    assert constant.any()
    assert (rails_there > 0).all() if light == "two-arm" else not rails_there.any()


@pytest.mark.parametrize("design", ["deepfsi", "control", "pca"])
def test_training_reads_no_test_scene(digits, design):
    """Not their light either: the budget is of the mean over training scenes."""
    dark = replace(digits, x_test=0.1 * digits.x_test[::-1], y_test=digits.y_test[::-1])
    found, wanted = quick(dark, design), quick(digits, design)
    assert same(found, wanted)
    summed = digits.x_train.sum(axis=1, dtype=np.float64).mean()
    assert found.summed_reflectance == wanted.summed_reflectance == pytest.approx(summed)


@every_optics
@pytest.mark.parametrize("noise", ["ml_gauss", "poisson", "gaussian"])
def test_a_two_level_design_shows_dark_and_peak_alone(digits, light, rails, noise):
    precision = "bfloat16" if noise == "poisson" else "float32"
    one = quick(digits, levels=2, light=light, rails=rails, noise=noise, precision=precision)
    assert two_valued(one.rails.stacked)
    assert torch.allclose(one.quantised(2).rails.stacked, one.rails.stacked, rtol=FLOAT32, atol=0)
    light_law(light).check(one.rails.stacked)


def test_scenes_that_are_all_alike_can_still_be_trained_on():
    data = synthetic((3, 3))
    alike = replace(data, x_train=np.full_like(data.x_train, 0.5))
    assert quick(alike, masks=2, start="truncated-hadamard").masks == 2


NOISES = {
    "ml_gauss": {},
    "poisson": {},
    "gaussian": {"sigma": 4.0},
    "camera": {"sigma": 50.0, "dark": 2e4},
}


def is_standardised(design, digits, noise, **numbers) -> bool:
    photons = light_on(design, digits.x_train).repeat(20, 1).float()
    features = design.scanner(noise, **numbers)(photons, generator())
    scaled = ((features / PHOTONS - design.exposure.mean) / design.exposure.std).double()
    n, fourth = len(scaled), scaled.pow(4).mean(dim=0)
    off = (scaled.var(dim=0) - 1).abs() <= 5 * ((fourth - 1) / n).sqrt()
    return bool(scaled.mean(dim=0).abs().max() <= 5 / math.sqrt(n) and off.all())


@pytest.mark.parametrize(("light", "rails"), [("column", "dual"), ("free-dwell", "single")])
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_features_are_standardised_over_scenes_and_noise(digits, noise, light, rails, design):
    one = quick(digits, design, noise=noise, light=light, rails=rails, **NOISES[noise])
    assert is_standardised(one, digits, noise, **NOISES[noise])
    if noise == "camera":  # each part is seen, by far more than chance
        assert not is_standardised(one, digits, noise, sigma=50.0, dark=0.0)
        assert not is_standardised(one, digits, noise, sigma=0.01, dark=2e4)


def test_learned_masks_beat_their_start_in_dim_light(digits):
    accuracy = [
        evaluate(quick(digits, design, 6, photons=1e3, epochs=15), digits, 1e3)[0].accuracy
        for design in ("deepfsi", "pca")
    ]
    assert accuracy[0] > accuracy[1]


def test_brightness_tells_scenes_from_classes():
    """Scenes of 1, 3 and 8 pixels' light, classes of 2, 8 and 4 in the mean, all of 4."""
    x = np.array([[1, 0], [2, 1], [4, 4], [1, 3]])
    found = characterisation.brightness(x, np.array([0, 0, 1, 2]))
    assert found == pytest.approx({"low": 1 / 4, "high": 8 / 4, "between": 8 / 2, "within": 1 / 2})
    assert characterisation.brightness(np.array([[1.0], [0.0]]), np.array([0, 1])) is None


def test_a_design_for_unsteady_light_compares_no_counts(digits, tmp_path):
    few = {"epochs": 1}
    camera = Camera(light="two-arm", fluctuation=0.1)
    design = deepfsi.learn(digits, photons=1e4, masks=4, camera=camera, training=few)
    kept = deepfsi.load_design(design.save(tmp_path / "d.safetensors"))
    assert kept.camera.fluctuation == 0.1
    assert kept.usual_misfit is None
    with pytest.raises(InputError, match="a page draws photon and dark counts of steady light"):
        check_playable(kept)


FEW = {"masks": 16, "photons": 200.0, "epochs": 10, "hidden": (32,), "device": "cpu"}


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(
    ("noise", "light", "rails"), [("click", "free-dwell", "single"), ("camera", "column", "dual")]
)
def test_a_training_counts_what_was_asked_for_within_its_light_law(digits, noise, light, rails):
    """A tenth: the counts of test scenes differ by their brightness, and the training is brief."""
    made = learn(digits, counts=6.0, noise=noise, light=light, rails=rails, **FEW)
    [result] = evaluate(made, digits, FEW["photons"], draws=1)
    assert result.counts == pytest.approx(6.0, rel=0.1)
    assert result.photons == made.info["job"]["photons"] == FEW["photons"]
    light_law(light).check(made.rails.stacked)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"design": "pca"}, "are of learned masks"),
        ({"train_noise": "ml_gauss"}, "trained under poisson, camera, click noise"),
        ({"counts": 300.0}, "300 counts are not fewer than 200, the photons"),
        ({"noise": "click", "counts": 40.0}, "not fewer than 32, the clicks of all its gates"),
    ],
)
def test_what_cannot_be_had_is_refused(digits, settings, match):
    with pytest.raises(InputError, match=match):
        learn(digits, **{**FEW, "counts": 6.0, **settings})
