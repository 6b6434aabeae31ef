"""Images seen patch by patch: the physics of the masks, and the training behind them."""

import pytest
import torch

from conftest import FLOAT32, assert_moments, generator, synthetic
from deepfsi import Scanner
from deepfsi.base import InputError
from deepfsi.camera import photons_per_pixel
from deepfsi.exposure import JobGroup, TrainingSet, build_training
from deepfsi.jobs import DESIGNS as CODES
from deepfsi.jobs import cut_patches
from deepfsi.physics import FixedMasks, LearnedMasks
from shared.design_files import refused, rewrite
from shared.jobs import job, learn

DESIGNS = ("impulse", "raster", "hadamard", "pca", "deepfsi")
BUDGET = 1e4
SMALL = {
    "camera": "paper",
    "patch": 4,
    "masks": 16,
    "photons": BUDGET,
    "epochs": 2,
    "batch": 30,
    "classifier_arguments": {"width": 16, "heads": 2, "depth": 1, "hidden": 16},
}

every_design = pytest.mark.parametrize("design", DESIGNS)
pytestmark = pytest.mark.usefixtures("all_trained_once")


@pytest.fixture(scope="module")
def data():
    return synthetic((16, 8))


class Cut:
    """Training images cut in patches (n, P, N), and what masks of a design start from."""

    def __init__(self, data) -> None:
        self.training_set = TrainingSet(data, "cpu")
        self.summed_reflectance = self.training_set.summed_reflectance
        self.x = cut_patches(self.training_set.full, data.image_shape, 4)

    def masks(self, design: str) -> FixedMasks | LearnedMasks:
        return build_training(JobGroup.of(self.training_set, [job(**SMALL, design=design)])).masks

    def counts(self, design: str, photons: torch.Tensor, noise: str = "poisson") -> torch.Tensor:
        """Features (..., m) of photons (..., N)."""
        return Scanner(self.masks(design), noise)(photons).squeeze(-2)


@pytest.fixture(scope="module")
def patches(data):
    return Cut(data)


@pytest.fixture(scope="module")
def learned(data):
    """A learned design, trained for a moment."""
    return learn(data, **SMALL)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"camera": "dmd"}, "give the light law column"),
        ({"design": "random"}, "random is not for patches"),
        ({"design": "control"}, "control is not for patches"),
        ({"levels": 2}, "with continuous masks"),
        ({"train_noise": "poisson"}, "trained under photon noise"),
        ({"classifier": "mlp", "classifier_arguments": {}}, "give classifier vit"),
        ({"hidden": (8,)}, "are of the usual classifier"),
        ({"patch": 0, "classifier": "vit"}, "vit reads patches, and nothing else does"),
        ({"patch": 3, "masks": 9}, "cannot be cut in patches of 3x3"),
        ({"patch": 4, "span": 10.0}, "of different exposures"),
        ({"classifier_arguments": {"breadth": 3}}, "whole numbers of width, depth, heads, hidden"),
        ({"classifier_arguments": {"width": 0}}, "whole numbers of width, depth, heads, hidden"),
        ({"classifier_arguments": {"width": 16, "heads": 5}}, "5 heads cannot share a width of 16"),
    ],
)
def test_what_patches_cannot_have_is_one_clear_line(data, settings, match):
    with pytest.raises(InputError, match=match) as error:
        learn(data, **{**SMALL, **settings})
    assert "\n" not in str(error.value)


@every_design
def test_all_readouts_together_count_at_most_the_images_light(patches, design):
    masks = patches.masks(design)
    rates = Scanner(masks).rates(photons_per_pixel(patches.x, BUDGET, patches.summed_reflectance))
    counted = rates.flatten(1).sum(dim=1)
    light = photons_per_pixel(patches.x, BUDGET, patches.summed_reflectance).sum(dim=(1, 2))
    assert (counted <= light * (1 + FLOAT32)).all()
    assert light.mean() == pytest.approx(BUDGET, rel=1e-5)
    whole = 1 / 16 if design == "raster" else 1.0
    if not CODES[design].specific:
        assert torch.allclose(counted, whole * light, rtol=1e-5)


@every_design
@pytest.mark.parametrize("noise", ["poisson", "ml_gauss"])
def test_noise_of_a_patchs_readout_is_its_light(patches, design, noise):
    draws, place = 20_000, (5, 3)
    x = photons_per_pixel(patches.x[place[0] : place[0] + 1], BUDGET, patches.summed_reflectance)
    scanner = Scanner(patches.masks(design), noise)
    with torch.no_grad():
        rates = scanner.rates(x)[0, place[1], 0].double()
        patch = x[:, place[1] : place[1] + 1]
        counts = scanner(patch.expand(draws, 1, -1), generator(2))[:, 0, 0]
    plus, minus = rates[0], rates[1] if len(rates) == 2 else torch.zeros_like(rates[0])
    for mask in (0, 1, 7):
        mean, variance = float(plus[mask] - minus[mask]), float(plus[mask] + minus[mask])
        assert_moments(
            counts[:, mask], mean, variance, poisson=noise == "poisson", rounding=FLOAT32 * BUDGET
        )


@pytest.mark.parametrize(
    "change",
    [
        lambda header: header.pop("exposure"),
        lambda header: header["classifier"].update(width=32),
        lambda header: header["classifier"].update(heads=5),
        lambda header: header["classifier"].update(patches=4),
        lambda header: header["exposure"].update(side=2),
        lambda header: header.update(exposure={"kind": "fixed"}),
        lambda header: header.update(light="sunlight"),
    ],
)
def test_a_damaged_file_is_one_clear_line(learned, tmp_path, change):
    path = learned.save(tmp_path / "made.safetensors")
    rewrite(path, lambda header, _: change(header))
    refused(path)


def test_diverging_is_said(data):
    with pytest.raises(InputError, match="diverged"):
        learn(data, **SMALL, mask_lr=1e38, lr=1e38)
