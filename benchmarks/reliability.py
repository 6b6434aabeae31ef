"""Reliability of shared light: wrong answers that the probabilities state, and those seen.

    python benchmarks/reliability.py --data mnist --photons 1e4 --looks 96 --cap 3   # an hour

Each test image is exposed once. Exposures that stop early state a probability above the threshold.
The first column of expected errors is of the posterior itself, the second of its probabilities
after the temperature that scenes left out of the prior give. ± is the binomial standard deviation
of the errors expected.
"""

import argparse
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch

import deepfsi


def main(words: Sequence[str] | None = None) -> None:
    """Make a design, expose the test images and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="digits")
    parser.add_argument("--photons", type=float, default=1e4)
    parser.add_argument("--looks", type=int, default=32)
    parser.add_argument("--cap", type=float, default=2)
    given = parser.parse_args(words)
    data = deepfsi.load_dataset(given.data)
    shared = deepfsi.SharedLight(cap=given.cap)
    design = deepfsi.learn(
        data, design="adaptive", masks=given.looks, photons=given.photons, exposure=shared
    )
    kind = design.prior_exposure
    with torch.no_grad():
        scenes = torch.from_numpy(data.x_test)
        generator = torch.Generator().manual_seed(0)
        answer, taken = design.exposures(scenes, design.camera)(given.photons, generator)
    temperature = float(np.exp(kind.prior.temperatures.logs[0, 0]))
    shares = kind.prior.class_shares.log()
    raw = ((answer.logits - shares) * temperature + shares).softmax(dim=1)
    stated, before = (
        chances.double().amax(dim=1).numpy() for chances in (answer.probabilities, raw)
    )
    wrong = answer.classes.numpy() != data.y_test
    threshold = kind.settings.until
    light = taken.used / given.photons / len(wrong)
    print(f"temperature {temperature:.3f}, threshold {threshold:.6f}, light {light:.4f}")
    print(
        "| exposures | number | wrong expected, posterior | wrong expected, stated | wrong seen |"
    )
    print("| --- | --- | --- | --- | --- |")
    early = stated > threshold
    groups = {"all": stated > 0, "that stop early": early}
    edges = [0, 0.5, 0.8, 0.9, 0.95, threshold]
    for low, high in pairwise(edges):
        groups[f"at the cap, {low:.3g} to {high:.3g}"] = (stated > low) & (stated <= high)
    for name, rows in groups.items():
        doubt = 1 - stated[rows]
        spread = (doubt * (1 - doubt)).sum() ** 0.5
        print(
            f"| {name} | {rows.sum()} | {(1 - before[rows]).sum():.1f} | "
            f"{doubt.sum():.1f} ± {spread:.1f} | {wrong[rows].sum()} |"
        )
    for name, chances in (("posterior", raw), ("stated", answer.probabilities)):
        true = chances[torch.arange(len(wrong)), torch.from_numpy(data.y_test).long()]
        print(f"log loss, {name}: {-true.double().clamp(min=1e-12).log().mean():.4f}")


if __name__ == "__main__":
    main()
