"""Values: designs of one DMD beside each other, on the centre of the light of digits.

    python benchmarks/answers.py

Settings are the package's defaults but for those below, which were not tuned; the test set is read
once. Prints the tables of docs/notebook/values.md.
"""

import argparse

import numpy as np

import deepfsi

BUDGETS = (1e3, 1e4, 1e5)
"""Photon budgets, at each of which a design is trained and tested."""

DESIGNS = {"raster": None, "pca": 16, "deepfsi": 16}
"""Designs and their numbers of masks; a raster scan has one for each pixel."""


def placed_digits() -> deepfsi.Dataset:
    """Digits without grey background, and the centres of their light in pixels."""
    data = deepfsi.load_dataset("digits", rescale=(0.0, 1.0))
    places = np.mgrid[:8, :8].reshape(2, -1)
    parts = []
    for x in (data.x_train, data.x_test):
        parts += [x.reshape(-1, 8, 8), x @ places.T / x.sum(axis=1, keepdims=True)]
    return deepfsi.from_arrays(*parts, values=["row", "column"], name="placed digits")


def table(data: deepfsi.Dataset, seeds: int, epochs: int) -> None:
    """Print what each design reads at each budget, in the mean over seeds with their spread."""
    for photons in BUDGETS:
        for name, masks in DESIGNS.items():
            found = []
            for seed in range(seeds):
                made = deepfsi.learn(
                    data,
                    design=name,
                    camera="dmd",
                    photons=photons,
                    masks=masks or data.pixels,
                    training={"epochs": epochs},
                    seed=seed,
                )
                [result] = deepfsi.evaluate(made, data, photons, seed=seed)
                found.append([result.r2, *result.rmse])
            mean, spread = np.mean(found, axis=0), np.std(found, axis=0, ddof=1)
            cells = " | ".join(f"{m:.3f} ± {s:.3f}" for m, s in zip(mean, spread, strict=True))
            print(f"| {data.name} | {photons:.0e} | {name} | {cells} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=30)
    asked = parser.parse_args()
    table(placed_digits(), asked.seeds, asked.epochs)


if __name__ == "__main__":
    main()
