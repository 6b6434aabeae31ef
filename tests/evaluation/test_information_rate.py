"""What one detector can at best tell of the class: laws of the short look."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.benchmarks import benchmark

information_rate = benchmark("one_bucket").information_rate
SEEDS = st.integers(0, 2**32 - 1)
laws = settings(max_examples=50, deadline=None)


def scenes_of(seed: int, pixels: int = 9, dark: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """Mean scenes (C, N) of two to five classes, some pixels of some dark, and their chances."""
    rng = np.random.default_rng(seed)
    scenes = rng.random((rng.integers(2, 6), pixels))
    scenes[rng.random(scenes.shape) < dark] = 0
    chances = rng.dirichlet(np.ones(len(scenes)))
    return scenes, chances


def rate_of(masks: np.ndarray, scenes: np.ndarray, chances: np.ndarray) -> np.ndarray:
    """Rates (...) of masks (..., N) behind which one detector counts."""
    return information_rate((masks @ scenes.T)[..., None, :], chances)


def impulse(scenes: np.ndarray, chances: np.ndarray) -> float:
    """Rate of a detector for each pixel."""
    return float(information_rate(scenes.T, chances))


@laws
@given(seed=SEEDS)
def test_it_is_the_mutual_information_of_a_short_look(seed):
    """Of Poisson counts, whose distribution is written out, over the time of the look."""
    scenes, chances = scenes_of(seed)
    light = scenes @ (np.random.default_rng(seed).random(9) < 0.5)
    short = 1e-6
    counts = np.arange(3)[:, None]
    factorial = np.array([1, 1, 2])[:, None]
    likelihood = np.exp(-light * short) * (light * short) ** counts / factorial  # (3, C)
    joint = likelihood * chances
    apart = joint.sum(axis=1, keepdims=True) * chances
    nats = (joint[joint > 0] * np.log(joint[joint > 0] / apart[joint > 0])).sum()
    rate = float(information_rate(light[None], chances))
    assert nats / short == pytest.approx(rate, rel=1e-4, abs=1e-5)


@laws
@given(seed=SEEDS)
def test_one_detector_tells_at_most_what_its_pixels_tell_and_these_at_most_impulse_imaging(seed):
    scenes, chances = scenes_of(seed)
    mask = np.random.default_rng(seed).random(9)
    pixels = sum(
        share * float(information_rate(scenes[None, :, place], chances))
        for place, share in enumerate(mask)
    )
    assert rate_of(mask, scenes, chances) <= pixels + 1e-12
    assert pixels <= impulse(scenes, chances) + 1e-12
    arms = np.stack([mask, 1 - mask]) @ scenes.T
    assert information_rate(arms, chances) <= impulse(scenes, chances) + 1e-12
    assert information_rate(arms, chances) >= rate_of(mask, scenes, chances) - 1e-12
