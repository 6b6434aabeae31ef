"""Rates of information: what masks of one detector tell of the class, over impulse imaging.

    python benchmarks/one_bucket.py --data mnist --photons 1e4 --looks 32 --exposures 64

Exposures of test images with adaptive masks are followed. In the state after some looks it gives
the rate at which a short look would tell of the class: of impulse imaging, of the best mask that
was found, and of the mask that is shown. The best mask is sought from many starts; a better one
may exist. Each rate is a mean over exposures, and ± one standard error of the ratio.
"""

import argparse
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

import deepfsi
from deepfsi.adaptive.posterior import AdaptivePosterior

STARTS = 300
"""Random starts of the search."""

STEPS = 40
"""Steps of the search at most."""

DARKEST = 1e-3
"""Least reflectance of a class's mean scene."""


def information_rate(light: np.ndarray, chances: np.ndarray) -> np.ndarray:
    """Rate (...) at which counts of a short look tell of the class, nats for each unit of light.

    In a time dt a readout counts one photon of a class c with the chance r_c dt, where r_c is its
    mean rate over the scenes of the class, and more than one never. The mutual information is then
    R dt with R = Σ_i Σ_c p_c r_ic ln (r_ic / r_i), r_i = Σ_c p_c r_ic and the chances p_c before.
    Shapes: light (..., k, C); chances (C,).
    """
    rates = np.asarray(light, float)
    mean = rates @ chances
    ratio = np.divide(
        rates, mean[..., None], out=np.ones_like(rates), where=(rates > 0) & (mean[..., None] > 0)
    )
    return np.asarray(((rates * np.log(ratio)) @ chances).sum(axis=-1))


def class_scenes(state: AdaptivePosterior) -> Tensor:
    """Mean scene (b, C, N) of each class in the state of exposures."""
    chances = state.class_probabilities
    sums = state.class_sums
    means = sums / chances.clamp(min=1e-12)[..., None]
    differ = state.times_covariance(means - sums.sum(dim=1, keepdim=True)) @ state.prior.components
    return (state.scene[:, None] + differ).clamp(min=DARKEST)


def best_rate(scenes: np.ndarray, chances: np.ndarray, rng: np.random.Generator) -> float:
    """Highest rate that one mask has, of masks that no step of the search makes better.

    The rate is convex in the mask: the mask that is best for its tangent is at least as good.
    Scenes (C, N), chances (C,).
    """
    weighted = chances[:, None] * scenes
    slopes = rng.normal(size=(STARTS, len(chances)))
    rates = np.zeros(STARTS)
    for _ in range(STEPS):
        masks = (slopes @ weighted > 0).astype(scenes.dtype)
        light = masks @ scenes.T
        before = rates
        rates = information_rate(light[:, None], chances)
        if (rates <= before * (1 + 1e-9)).all():
            break
        mean = np.maximum(light @ chances, 1e-30)
        slopes = np.log(np.maximum(light, 1e-30) / mean[:, None])
    return float(rates.max())


def main(words: Sequence[str] | None = None) -> None:
    """Follow exposures and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="digits")
    parser.add_argument("--photons", type=float, default=1e4)
    parser.add_argument("--looks", type=int, default=16)
    parser.add_argument("--exposures", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0, help="of images, noise and starts")
    parser.add_argument("--clusters", type=int, help="of each class, in place of all scenes")
    given = parser.parse_args(words)
    data = deepfsi.load_dataset(given.data)
    design = deepfsi.learn(
        data,
        design="adaptive",
        masks=given.looks,
        photons=given.photons,
        training={"clusters": given.clusters},
    )
    exposure = design.prior_exposure
    rng = np.random.default_rng(given.seed)
    rows = np.sort(rng.choice(len(data.x_test), given.exposures, replace=False))
    x = torch.from_numpy(np.asarray(data.x_test[rows]))
    generator = torch.Generator().manual_seed(given.seed)
    state = AdaptivePosterior(exposure.prior, len(x), exposure.optics_at(given.photons))
    print("| looks before | best mask over impulse imaging | shown over best | light of the mask |")
    print("| --- | --- | --- | --- |")
    with torch.no_grad():
        for look, share in enumerate(exposure.settings.shares):
            scenes = class_scenes(state).double().numpy()
            chances = state.class_probabilities.double().numpy()
            masks, counts, _ = state.look_at(x, share, generator)
            if look & (look - 1) == 0:
                shown = masks.double().numpy()
                every = np.array([
                    (
                        information_rate(means.T, odds),
                        best_rate(means, odds, rng),
                        information_rate((means @ mask)[None], odds),
                        mask @ (odds @ means) / (odds @ means).sum(),
                    )
                    for means, odds, mask in zip(scenes, chances, shown, strict=True)
                ])  # fmt: skip
                print(
                    f"| {look} | {ratio(every[:, 1], every[:, 0])} "
                    f"| {ratio(every[:, 2], every[:, 1])} | {every[:, 3].mean():.3f} |",
                    flush=True,
                )
            state.update(masks, counts, share)


def ratio(upper: np.ndarray, lower: np.ndarray) -> str:
    """Ratio of two means with its standard error."""
    value = upper.mean() / lower.mean()
    spread = (upper - value * lower).std(ddof=1) / np.sqrt(len(upper)) / lower.mean()
    return f"{value:.3f} ± {spread:.3f}"


if __name__ == "__main__":
    main()
