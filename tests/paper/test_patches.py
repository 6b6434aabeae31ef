"""Images seen patch by patch: the physics of the masks behind their training."""

import numpy as np
import pytest
import torch

from conftest import FLOAT32, assert_moments, generator, synthetic
from deepfsi import Scanner, learn, photons_per_pixel
from deepfsi.exposure.training import JobGroup
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.designs import DESIGNS as CODES
from deepfsi_paper.patches.settings import cut_patches
from shared.jobs import job

BUDGET = 1e4
SMALL = {"camera": "paper", "patch": 4, "masks": 16, "photons": BUDGET, "classifier": "vit"}

every_design = pytest.mark.parametrize(
    "design", ["impulse", "raster", "hadamard", "pca", "deepfsi"]
)


@pytest.fixture(scope="module")
def training_set():
    return TrainingSet(synthetic((16, 8)), "cpu")


@pytest.fixture(scope="module")
def photons(training_set):
    """Light of training images cut in patches (n, P, N)."""
    x = cut_patches(training_set.full, (16, 8), 4)
    return photons_per_pixel(x, BUDGET, training_set.summed_reflectance)


def masks_of(training_set, design):
    return JobGroup(training_set, [job(**SMALL, design=design)]).training().masks


@every_design
def test_all_readouts_together_count_at_most_the_images_light(training_set, photons, design):
    counted = Scanner(masks_of(training_set, design)).rates(photons).flatten(1).sum(dim=1)
    light = photons.sum(dim=(1, 2))
    assert (counted <= light * (1 + FLOAT32)).all()
    assert light.mean() == pytest.approx(BUDGET, rel=1e-5)
    if not CODES[design].specific:
        share = 1 / 16 if design == "raster" else 1.0
        assert torch.allclose(counted, share * light, rtol=1e-5)


@pytest.mark.usefixtures("uncharacterised", "trained_once")
def test_each_exposure_has_its_own_budget(training_set):
    """As many exposures as an image has patches: a budget is of an exposure, not of a patch."""
    settings = {"exposure": {"patch": 4}, "training": {"classifier": "vit", "epochs": 1}}
    design = learn(training_set.data, camera="paper", masks=16, photons=BUDGET, **settings)
    scenes = training_set.data.x_test[:8]
    counts, budgets = design.expose(scenes, BUDGET), BUDGET * np.arange(1, 9)
    alone = [design.classify(one, budget) for one, budget in zip(counts, budgets, strict=True)]
    np.testing.assert_allclose(design.classify(counts, budgets), alone, rtol=1e-4, atol=1e-6)


@every_design
@pytest.mark.parametrize("noise", ["poisson", "ml_gauss"])
def test_noise_of_a_patchs_readout_is_its_light(training_set, photons, design, noise):
    patch = photons[5:6, 3:4]
    scanner = Scanner(masks_of(training_set, design), noise)
    with torch.no_grad():
        rates = scanner.rates(patch)[0, 0, 0].double()
        counts = scanner(patch.expand(20_000, 1, -1), generator(2))[:, 0, 0]
    mean = rates[0] - rates[1] if len(rates) == 2 else rates[0]
    some, rounding = [0, 1, 7], FLOAT32 * BUDGET
    power, poisson = rates.sum(dim=0)[some], noise == "poisson"
    assert_moments(counts[:, some], mean[some], power, poisson=poisson, rounding=rounding)
