"""Laws of the test of an exposure: 1 sound scene in 200 is unlike the training, others more."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import binom, norm

from deepfsi import InputError, from_arrays
from deepfsi.designfile.misfit import FALSE_ALARM, MISFIT_BUDGETS, SceneLight, UsualMisfit
from deepfsi.designfile.view_test import SceneModel
from shared.jobs import learn

PIXELS, CLASSES, PHOTONS = 36, 2, 1e4
USUAL = SceneLight(np.ones(1), 0.1, 0.0, np.array([0.5, 2.0]))


def scenes_of(rng, count):
    """Normal scenes (n, N) of two classes, which a model holds exactly."""
    labels = np.arange(count) % CLASSES
    means = np.stack([np.linspace(0.3, 0.6, PIXELS), np.linspace(0.6, 0.3, PIXELS)])
    bright = 1 + 0.15 * rng.standard_normal((count, 1))
    x = means[labels] * bright + 0.05 * rng.standard_normal((count, PIXELS))
    return x.clip(0, 1).astype(np.float32), labels


@cache
def make(camera, count=400):
    x, y = scenes_of(np.random.default_rng(count), count)
    square = x.reshape(-1, 6, 6)
    data = from_arrays(square, y, square[:20], y[:20])
    return learn(data, camera=camera, photons=PHOTONS, masks=6, epochs=1)


@pytest.mark.parametrize(
    ("camera", "count"), [("dmd", 400), ("dmd", 20 * CLASSES), ("dmd-2x2", 400), ("two-arm", 400)]
)
@pytest.mark.parametrize("photons", [PHOTONS / 10, PHOTONS, 10 * PHOTONS])
def test_sound_scenes_are_unlike_as_often_as_stated(camera, count, photons):
    x, _ = scenes_of(np.random.default_rng(3), 2000)
    design = make(camera, count)
    p_values = design.consistency(design.expose(x, photons, seed=1), photons)
    # 400 scenes tell a standard deviation to 4 %, 40 to 11 %: three of these
    most = 2 * norm.sf(norm.isf(FALSE_ALARM / 4) * (0.9 if count == 400 else 0.7))
    assert (p_values < FALSE_ALARM).mean() <= binom.ppf(0.999, 2000, most) / 2000
    assert 0.3 < np.median(p_values) <= 1


@pytest.mark.parametrize("levels", [(0.0, 0.0), (1.0, 1.0), (0.9, 0.1)])
def test_black_white_and_striped_scenes_are_unlike(levels):
    design = make("dmd")
    stripes = np.tile(levels, (200, PIXELS // 2))
    counts = design.expose(stripes, 10 * PHOTONS, seed=1)
    assert (design.consistency(counts, 10 * PHOTONS) < FALSE_ALARM).mean() > 0.9


def test_background_is_noise_of_sound_scenes():
    rng = np.random.default_rng(5)
    design = make("dmd")
    x, _ = scenes_of(rng, 2000)
    dark = 3e3
    counts = design.expose(x, PHOTONS, seed=1)
    counts = counts + rng.poisson(dark, counts.shape) - dark
    assert (design.consistency(counts, PHOTONS) < FALSE_ALARM).mean() > 0.5
    assert (design.consistency(counts, PHOTONS, dark) < FALSE_ALARM).mean() < 0.02


def test_p_values_are_those_of_the_measured_law():
    """Half at the median, a sixth one deviation above; between budgets, and the same beyond."""
    logs = np.stack([np.log([[1.0, 2], [1, 2], [4, 8]]), np.full((3, 2), 0.5)])
    usual = UsualMisfit(1e3 * np.array(MISFIT_BUDGETS), logs, USUAL.usual[None])

    def p_value(misfit, looks, photons, light=USUAL):
        return usual.p_values(np.array([misfit]), looks, photons, light)[0]

    assert p_value(2.0 * np.exp(1.0), 2, 1e3) == pytest.approx(2 * norm.sf(2))
    assert p_value(2.0 * np.exp(1.0), 1, 1e3 * 10**0.5) == pytest.approx(2 * norm.sf(2))
    assert p_value(4.0 * np.exp(1.0), 1, 1e9) == pytest.approx(2 * norm.sf(2))
    assert p_value(np.exp(1.0), 1, 1.0) == pytest.approx(2 * norm.sf(2))
    assert p_value(0.0, 1, 1e3) == 1
    # light beyond all training scenes, and beyond a normal law of its logarithm, both ways
    for share in (2.1, 1 / 2.1):
        light = USUAL._replace(share=np.array([share]), spread=0.3)
        deviations = np.log(2.1) / np.sqrt(np.log1p(0.09))
        assert p_value(0.0, 1, 1e3, light) == pytest.approx(4 * norm.sf(deviations))
        assert p_value(0.0, 1, 1e3, light._replace(noise=0.1)) == 1


def test_light_has_the_moments_of_the_scenes():
    """Mean, spread and photon noise of all counts, against 4000 simulated exposures."""
    rng = np.random.default_rng(6)
    x, labels = scenes_of(rng, 4000)
    model = SceneModel.fit(x.astype(float), labels)
    design = make("dmd-2x2")
    bright = design.expose(x, 1e9, seed=1)
    rows = design.mask_exposure.scene_readouts(bright.astype(float), 1e9, 0.0)
    light = model.light(rows, USUAL.usual)
    assert light.share.mean() == pytest.approx(1, abs=5 * light.spread / 4000**0.5)
    assert light.share.std() == pytest.approx(light.spread, rel=0.06)
    one = np.repeat(x[:1], 4000, axis=0)
    again = design.mask_exposure.scene_readouts(design.expose(one, 100.0, seed=2), 100.0, 7.0)
    found = model.light(again, USUAL.usual)
    dark = 7.0 * np.prod(design.counts_shape)
    expected = (again.masks.sum(axis=0) @ model.mean).sum()
    assert found.noise == pytest.approx(np.sqrt(expected + dark) / expected)
    dark_free = model.light(replace(again, noise=np.zeros_like(again.noise)), USUAL.usual)
    mean = found.share.mean()
    assert found.share.std() == pytest.approx(dark_free.noise * mean**0.5, rel=0.06)


@pytest.mark.usefixtures("trained_once")
def test_a_design_that_does_not_know_the_usual_misfit_is_refused():
    few = make("dmd", count=38)
    with pytest.raises(InputError, match="20 training scenes of each class"):
        few.consistency(np.ones(few.counts_shape), 1e3)
