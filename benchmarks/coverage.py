"""Coverage of the 95 % intervals over images and training seeds, in simulated studies.

    python benchmarks/coverage.py                # the table of docs/notebook/intervals.md
    python benchmarks/coverage.py --studies 200  # a quick look

Each study draws n images, S trainings and three noise draws. The chance that a training answers an
image right is Φ(a + image + seed + both), whose three parts are normal with standard deviations of
1.5, 0.1 or 0.3, and 0.5. The truth is the mean over all images, seeds and draws, for one training
that over all images. The last column is the share of studies in which two alike designs, tested on
the same images, are told apart.
"""

import argparse

import numpy as np
from scipy import stats

from deepfsi.base.intervals import accuracy_interval, mean_of_trials, paired_difference

IMAGES, SEEDS, RATES, SPREADS = (24, 100, 1000), (1, 3, 5), (0.6, 0.9, 0.98), (0.1, 0.3)
IMAGE, BOTH, DRAWS = 1.5, 0.5, 3


def study(
    rng: np.random.Generator, images: int, seeds: int, rate: float, spread: float
) -> list[np.ndarray]:
    """Shares of draws right (S, n) of two alike designs on the same images."""
    spread = spread if seeds > 1 else 0.0
    place = stats.norm.ppf(rate) * np.sqrt(1 + IMAGE**2 + spread**2 + BOTH**2)
    image = place + IMAGE * rng.standard_normal(images)
    designs = []
    for _ in range(2):
        seed = spread * rng.standard_normal((seeds, 1))
        chance = stats.norm.cdf(image + seed + BOTH * rng.standard_normal((seeds, images)))
        designs.append(rng.binomial(DRAWS, chance) / DRAWS)
    return designs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=7)
    asked = parser.parse_args()
    print("| accuracy | images | seeds | spread of seeds | covered | by seeds alone | alike told |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for rate in RATES:
        for images in IMAGES:
            for seeds in SEEDS:
                for spread in SPREADS if seeds > 1 else (0.0,):
                    rng = np.random.default_rng([asked.seed, images, seeds, round(1000 * spread)])
                    held = alone = told = 0
                    for _ in range(asked.studies):
                        one, other = study(rng, images, seeds, rate, spread)
                        _, low, high = accuracy_interval(one)
                        held += low <= rate <= high
                        if seeds > 1:
                            low, high = mean_of_trials(one.mean(axis=1).tolist()).interval()
                            alone += low <= rate <= high
                        apart = paired_difference(one, other)
                        told += apart.low > 0 or apart.high < 0
                    shares = [count / asked.studies for count in (held, alone, told)]
                    before = f"{shares[1]:.3f}" if seeds > 1 else "–"
                    print(
                        f"| {rate} | {images} | {seeds} | {spread or '–'} | {shares[0]:.3f} | "
                        f"{before} | {shares[2]:.3f} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
