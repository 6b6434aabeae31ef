"""Laws of the misfit of adaptive exposures: 1 a readout where scenes are as the prior has them."""

import numpy as np
import pytest
import torch

from conftest import generator
from deepfsi.adaptive import exposure as adaptive
from deepfsi.adaptive import posterior
from deepfsi.adaptive.exposure import AdaptiveExposure
from deepfsi.adaptive.posterior import AdaptivePosterior, ScenePrior
from deepfsi.camera.camera import Camera
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi.physics.noise import Poisson

PIXELS, SCENES, CLASSES, DRAWS, LOOKS = 12, 60, 3, 600, 4
OPTICS = [{}, {"dark": 200.0}, {"arms": 2}, {"detectors": torch.arange(PIXELS) // 4}]
SCENES_KNOWN = 0.5 + np.random.default_rng(0).random((SCENES, PIXELS), np.float32)


def prior_with(spread):
    labels = np.arange(SCENES) % CLASSES
    return ScenePrior(SCENES_KNOWN, labels, CLASSES, PIXELS, spread=spread)


def distances(prior, x, optics):
    """Squared distances (LOOKS, b) of exposures of scenes (b, N), and readouts with light."""
    state, random, found, lit = AdaptivePosterior(prior, len(x), optics), generator(1), [], []
    for _ in range(LOOKS):
        masks = state.next_masks(1 / LOOKS, random)
        counts = Poisson().draw(state.expected(masks, x, 1 / LOOKS), random)
        found.append(state.misfit(masks, counts, 1 / LOOKS))
        state.update(masks, counts, 1 / LOOKS)
        lit.append(optics.readouts(masks).any(dim=2).sum(dim=1).double().mean())
    return torch.stack(found), torch.stack(lit)


def test_a_scene_that_is_left_out_is_further_than_one_that_is_known():
    prior = prior_with(0.0)
    scenes, optics = torch.from_numpy(SCENES_KNOWN), posterior.LookOptics(1e5)
    ordered, rows = scenes[torch.from_numpy(prior.order)], torch.arange(SCENES)
    settings = AdaptiveMasks(looks=LOOKS)
    exposure = AdaptiveExposure(prior, settings, (PIXELS,), torch.zeros(LOOKS), Camera())
    unknown = adaptive.LeftOutScenes(ordered, prior.labels, rows, rows)
    *_, misfits = adaptive.measure(exposure, [optics], unknown, generator(3))
    left_out = misfits[0].sum(dim=0).log().mean()
    away, _ = distances(prior, scenes, optics)
    assert left_out > away.sum(dim=0).log().mean() + 1


@pytest.mark.parametrize("optics", OPTICS)
@pytest.mark.parametrize("photons", [100.0, 1e4])
@pytest.mark.parametrize("spread", [0.0, 0.4])
def test_scenes_of_the_prior_are_as_far_as_their_counts_vary(optics, photons, spread):
    """E[r' V^-1 r] is the number of readouts in each look, whatever was counted before."""
    prior, rows = prior_with(spread), torch.randint(SCENES, (DRAWS,), generator=generator(2))
    scenes = (prior.mean + prior.coefficients @ prior.components)[rows]
    if spread:
        scenes = scenes + torch.randn(DRAWS, PIXELS, generator=generator(3)) @ prior.components
    away, readouts = distances(prior, scenes, posterior.LookOptics(photons, **optics))
    error = away.std(dim=1) / DRAWS**0.5
    assert (abs(away.mean(dim=1) - readouts) < 5 * error).all()
