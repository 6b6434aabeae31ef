"""Features of learned masks in a step of training: those of the formula, for each seed its own."""

import pytest
import torch

from deepfsi.optics.constraints import fit
from deepfsi.optics.detection import Detection
from deepfsi.optics.features import FeatureNoise
from deepfsi.optics.masks import FixedMasks
from deepfsi.training.draws import SeedStream
from deepfsi.training.features import ReadNoiseFeatures
from deepfsi.training.training_set import TrainingSet

BATCH, MASKS, SIGMAS, GAINS = 50, 4, [2.0, 3.0, 5.0], [40.0, 400.0, 90.0]


@pytest.mark.parametrize("rails", ["single", "dual"])
def test_under_read_noise_they_are_centred_scenes_times_masks_and_the_noise_of_lit_rails(
    digits, rails
):
    """Three jobs of two seeds, each with masks, a gain and a read noise of its own."""
    training_set = TrainingSet(digits, "cpu")
    noise = FeatureNoise.of("gaussian", GAINS, SIGMAS, [0, 1, 1], torch.device("cpu"))
    wild = torch.randn(3, MASKS, 64, generator=torch.Generator().manual_seed(1))
    wild = wild.abs() if rails == "single" else wild
    masks = FixedMasks(torch.stack([fit(each, "column", rails) for each in wild]))
    places = [slice(0, 1), slice(1, 3)]
    streams, again = (
        [
            SeedStream(seed, part, noise, training_set.labels, BATCH)
            for seed, part in enumerate(places)
        ]
        for _ in range(2)
    )
    for stream in streams + again:
        stream.shuffle()
    x = training_set.centred("two-arm", torch.float32, Detection())  # every pixel
    found = ReadNoiseFeatures(streams, masks, x, "each", Detection()).noisy(1)
    scenes = torch.from_numpy(digits.x_train) - torch.from_numpy(digits.x_train).mean(dim=0)
    read_of = 1 if rails == "single" else 2  # each rail is read out
    for features, stream, part in zip(found, again, places, strict=True):
        mean = torch.einsum("bn,rmn->brm", scenes[stream.rows[1]], masks().difference[part])
        scale = torch.tensor(SIGMAS[part])[:, None] / torch.tensor(GAINS[part])[:, None]
        expected = mean + scale * read_of**0.5 * stream.normal(MASKS)
        assert torch.allclose(features, expected, rtol=1e-5, atol=1e-5)
