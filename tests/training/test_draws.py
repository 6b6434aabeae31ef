"""Each seed has an order of scenes, a noise and initial weights of its own."""

import pytest
import torch
from torch import Tensor

from conftest import quick
from deepfsi.optics.detection import Readouts
from deepfsi.optics.features import FeatureNoise
from deepfsi.training.draws import SeedStream

LABELS = torch.arange(300)


def stream(seed: int, kind: str = "ml_gauss") -> SeedStream:
    noise = FeatureNoise.of(kind, [5.0], [1.0], [seed], LABELS.device)
    made = SeedStream(seed, slice(0, 1), noise, LABELS, batch=100)
    made.shuffle()
    return made


def drawn(seed: int, kind: str) -> Tensor:
    read = Readouts(torch.ones(2, 1, 3, dtype=torch.bool), torch.ones(2, 1, 3) / 6)
    return stream(seed, kind).noisy(torch.zeros(100, 1, 3), torch.ones(100, 1, 3), read)


def test_each_seed_has_its_own_order_of_all_scenes():
    first, again, other = (stream(seed).rows for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert sorted(other.flatten().tolist()) == LABELS.tolist()


@pytest.mark.parametrize("kind", ["ml_gauss", "gaussian", "poisson"])
def test_each_seed_has_its_own_noise(kind):
    first, again, other = (drawn(seed, kind) for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("rails", [1, 2])
def test_readouts_of_a_seed_are_those_of_its_jobs_and_of_masks_that_all_share(rails):
    noise = FeatureNoise.of("poisson", [5.0] * 3, [1.0] * 3, [0, 1, 1], LABELS.device)
    second = SeedStream(1, slice(1, 3), noise, LABELS, batch=100)
    time = torch.rand(rails, 3, 4, generator=torch.Generator().manual_seed(2))
    own = second.readouts(Readouts(time > 0.5, time))
    assert torch.equal(own.time, time[:, 1:])
    assert torch.equal(own.shown, time[:, 1:] > 0.5)
    shared = Readouts(time[:, :1] > 0.5, time[:, :1])
    assert second.readouts(shared) is shared


def test_each_seed_has_its_own_initial_weights(digits):
    """A training that does not move keeps them."""
    still = {"lr": 1e-30, "decay": 0.0}
    first, again, other = (
        quick(digits, "pca", seed=seed, **still).classifier.state_dict() for seed in (0, 0, 1)
    )
    matrices = [name for name, held in first.items() if held.ndim == 2]
    assert matrices
    for name in matrices:
        assert torch.equal(first[name], again[name])
        assert not torch.equal(first[name], other[name])
