"""Laws of several detectors and of reading both rails: where they are known cases, they agree."""

import numpy as np
import pytest
import torch

from conftest import FLOAT32, every_optics, generator
from deepfsi import Scanner
from deepfsi.camera.detectors import DetectorMap
from deepfsi.physics.detection import Detection
from deepfsi.physics.laws import LearnedMasks, light_law
from deepfsi.physics.noise import root
from deepfsi.physics.scanner import project, project_rails
from deepfsi.physics.training_noise import ml_gauss_features

SHAPE = (6, 8)
ARBITRARY = np.random.default_rng(0).permutation(np.arange(48) % 5)
MAPS = ["1x1", "2x2", "4x3", "6x8", ARBITRARY]
every_map = pytest.mark.parametrize("detectors", MAPS, ids=str)
every_readout = pytest.mark.parametrize("readout", ["difference", "both"])


def detection_by(detectors: str | np.ndarray, readout: str = "difference") -> Detection:
    return Detection.by(DetectorMap.of(detectors, SHAPE), readout)


def rails_for(light: str, rails: str) -> torch.Tensor:
    matrix = torch.randn(5, 48, generator=generator(1))
    return light_law(light).fit(matrix if rails == "dual" else matrix.abs(), rails)


def dense(rails: torch.Tensor, detection: Detection) -> torch.Tensor:
    """Rails (.., m · D, N) of one detector each, dark beyond its part: the plain definition."""
    if detection.labels is None:
        return rails
    parts = torch.stack([detection.labels == d for d in range(detection.count)]).to(rails)
    return (rails.unsqueeze(-2) * parts).flatten(-3, -2)


def photons(count: int = 7) -> torch.Tensor:
    return 900 * torch.rand(count, 48, generator=generator(2))


@every_optics
@every_map
def test_each_detector_counts_what_its_part_of_the_mask_passes(detectors, light, rails):
    frames, seen = rails_for(light, rails), detection_by(detectors)
    wanted = project(photons(), dense(frames, seen))
    found = Scanner.from_rails(frames, "none", detection=seen).rates(photons())
    assert torch.allclose(found, wanted, rtol=10 * FLOAT32, atol=1e-3)
    whole = found.unflatten(-1, (5, -1)).sum(dim=-1)
    assert torch.allclose(whole, Scanner.from_rails(frames).rates(photons()), rtol=10 * FLOAT32)


@every_optics
@every_readout
@pytest.mark.parametrize("noise", ["poisson", "gaussian", "ml_gauss", "camera", "none"])
def test_features_have_the_mean_and_variance_of_their_readouts(light, rails, readout, noise):
    frames, seen = rails_for(light, rails), detection_by("2x2", readout)
    scanner = Scanner.from_rails(frames, noise, 3.0, 40.0 if noise == "camera" else 0.0, seen)
    x, draws = photons(1), 4000
    features = scanner(x.expand(draws, -1), generator())
    rates = scanner.rates(x)[0]
    counts = scanner.counts(x.expand(draws, -1), generator(5))
    wanted = seen.features(rates)
    other = seen.features(counts)
    for found in (features, other):
        assert found.shape == (draws, 5 * seen.width(len(frames)))
        error = found.std(dim=0) / draws**0.5
        assert ((found.mean(dim=0) - wanted).abs() <= 5 * error + 1e-3).all()
    spread = 5 * (2 / draws) ** 0.5 * 1.5  # of a variance; Poisson counts of tens are nearly normal
    some = other.var(dim=0) > 1
    assert torch.allclose(features.var(dim=0)[some], other.var(dim=0)[some], rtol=2 * spread)


@every_optics
@pytest.mark.parametrize(("detectors", "levels"), [*((each, 0) for each in MAPS), ("1x1", 2)])
@every_readout
def test_a_step_of_training_is_the_scanners_forward_and_its_gradient(
    light, rails, detectors, readout, levels
):
    """Of two replicas, one of whose masks is dark, against autograd's own graph."""
    draw, seen = generator(3), detection_by(detectors, readout)
    scenes = torch.rand(7, 48, generator=draw, dtype=torch.float64)
    middle = scenes.mean(dim=0)
    if light == "column" and seen.count > 1:
        return
    start = torch.randn(2, 5, 48, generator=draw, dtype=torch.float64)
    start[0, 2] = 0
    arranged = seen.arrange(start.abs() if rails == "single" else start)
    masks = LearnedMasks(arranged, light, rails, levels)
    width = 5 * seen.width(2 if rails == "dual" else 1)
    epsilon = torch.randn(7, 2, width, generator=draw, dtype=torch.float64)
    weight = torch.randn(epsilon.shape, generator=draw, dtype=torch.float64)
    disjoint = masks.disjoint and readout == "difference"

    def ours() -> torch.Tensor:
        given = masks().difference if disjoint else seen.read_of(masks()).combined
        x = seen.arrange(torch.cat([scenes - middle, middle[None]]))
        return ml_gauss_features(x, given, epsilon, disjoint, seen.count)

    def plain() -> torch.Tensor:
        every = seen.read_of(masks())
        mean, total = project_rails(seen.arrange(scenes), every, seen.count)
        centre = project(seen.arrange(middle), every.difference, seen.count)
        return mean - centre + root(total) * epsilon

    found = []
    for features in (ours(), plain()):
        masks.zero_grad()
        (features * weight).sum().backward()
        found.append((features.detach(), [p.grad.clone() for p in masks.parameters()]))
    assert torch.allclose(found[0][0], found[1][0], rtol=0, atol=1e-12)
    for one, other in zip(found[0][1], found[1][1], strict=True):
        assert torch.isfinite(one).all()
        assert torch.allclose(one, other, rtol=0, atol=1e-11)
