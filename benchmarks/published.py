"""Designs beside published masks of a single-photon-detection neural network, on the same light.

    python benchmarks/published.py FOLDER -o runs/published  # table of docs/notebook/published.md
    python benchmarks/published.py FOLDER --neurons 10 --epochs 1 -o runs/short
    python benchmarks/published.py FOLDER --few --seeds 0 1 2  # the table for clicks alone

FOLDER holds `incoherent_nK.npz` with `masks` (K, 784), `readout` (10, K) and `bias` (10,), K = 10,
50, 100 and 400: weights of the incoherent networks for MNIST of S.-Y. Ma, T. Wang, J. Laydevant,
L. G. Wright, P. L. McMahon, "Quantum-limited stochastic optical neural networks operating at a few
quanta per activation", Nature Communications 16 (2025), doi 10.1038/s41467-024-55220-y. They are
public at github.com/mcmahon-lab/Single-Photon-Detection-Neural-Networks under the licence Creative
Commons Attribution 4.0, as PyTorch models: save those arrays with `numpy.savez`.

A scene x in [0, 1]^784 gives a neuron the rate u = masks · x; it clicks with the probability
1 − exp(−u), once, and the classes are readout · clicks + bias. In K shots, exposures of one scene,
the mean output decides. K shots are one exposure of K gates: the sums of clicks are
Binomial(K, 1 − exp(−u)), and all that the network needs, as it is linear. Ours is not: it reads
each shot, and the mean of the logits decides. The mean of the log probabilities would decide alike,
as in each shot they differ from the logits by one number for all classes. Accuracies of one shot
are means over as many shots.

Masks M that see λ = Φ x / s are these at M = masks · s / Φ, so that there is a smallest budget Φ at
which they obey a constraint. Designs of ours are trained under that constraint at that budget, with
rails and number of masks chosen on validation images, and tested once on exact counts; then for
detectors that click at most once, as the network's do: masks learn to click no more than the
network, at no more than its budget. `--few` prints that table alone, with the mean and the standard
deviation over the training seeds.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.base.intervals import wilson
from deepfsi.camera.light import summed_reflectance
from deepfsi.camera.names import LightLawName
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.design.design import Design
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.physics.laws import light_law
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.results import Point
from deepfsi.sweeps.run import compare
from deepfsi.training.learning import learn

NEURONS = (10, 50, 100, 400)
"""Sizes of the published networks."""

LAWS: tuple[LightLawName, ...] = ("column", "free-dwell")
"""Constraints that the masks are brought to."""

MASKS = {"column": (64,), "free-dwell": (32,)}
"""Numbers of masks that ours are chosen from."""

CLICKING: dict[int, dict[str, Any]] = {
    10: {"masks": 30, "training": {"epochs": 40}},
    50: {"masks": 80, "training": {"epochs": 40}},
    100: {"masks": 150, "training": {"epochs": 40, "mask_lr": 0.2}},
    400: {"masks": 500, "training": {"epochs": 24, "mask_lr": 0.2, "dropout": 0.1}},
}
"""Masks and settings beside each network, for clicks; chosen on validation images."""

FEWER = 0.95
"""Clicks that ours are trained for over those of the network, so that they are no more."""

SHOTS = 10
"""Exposures of a scene that are averaged, beside one alone."""

HIDDEN = (512, 256)
"""Hidden layers of our classifier."""

SOURCE = "github.com/mcmahon-lab/Single-Photon-Detection-Neural-Networks (CC BY 4.0)"
"""Where the published weights are."""


@dataclass(frozen=True)
class Network:
    """Published network: masks (K, N), readout (C, K) and bias (C,)."""

    masks: np.ndarray
    readout: np.ndarray
    bias: np.ndarray

    @classmethod
    def read(cls, path: Path, pixels: int) -> "Network":
        """Network of a file, its masks padded with dark pixels to scenes of so many."""
        with np.load(path) as file:
            parts = {name: file[name].astype(np.float64) for name in ("masks", "readout", "bias")}
        side, wide = (round(count**0.5) for count in (parts["masks"].shape[1], pixels))
        edge = (wide - side) // 2
        images = parts["masks"].reshape(-1, side, side)
        padded = np.pad(images, ((0, 0), (edge, edge), (edge, edge)))
        return cls(padded.reshape(len(images), -1), parts["readout"], parts["bias"])

    def arriving(self, x: np.ndarray) -> float:
        """Photons that arrive at the detectors, in the mean over scenes (n, N)."""
        return float((x @ self.masks.T).sum(axis=1).mean())

    def clicks(self, x: np.ndarray, seed: int = 0) -> np.ndarray:
        """Clicks (n, K) of scenes (n, N), one shot."""
        rates = x @ self.masks.T
        return np.random.default_rng(seed).random(rates.shape) < -np.expm1(-rates)

    def classes(self, clicks: np.ndarray, shots: int = 1) -> np.ndarray:
        """Classes (n,) of the clicks (n, K) in so many shots, by the mean output."""
        return (clicks @ self.readout.T / shots + self.bias).argmax(axis=1)

    def least_photons(self, light: LightLawName, s: float) -> float:
        """Smallest budget at which the masks obey a constraint, for a summed reflectance s."""
        rails = torch.from_numpy(self.masks)[None]
        return s * (1 + light_law(light).excess(rails))


def read_networks(
    folder: Path, sizes: Sequence[int], pixels: int, parser: argparse.ArgumentParser
) -> dict[int, Network]:
    """Networks of a folder by their numbers of neurons; the parser says what is missing."""
    files = {size: folder / f"incoherent_n{size}.npz" for size in sizes}
    if missing := [str(path) for path in files.values() if not path.is_file()]:
        parser.error(
            f"{', '.join(missing)} missing: `published.py --help` names the source, {SOURCE}"
        )
    return {size: Network.read(path, pixels) for size, path in files.items()}


def recipe(
    light: LightLawName, photons: Sequence[float], epochs: int, data: str = "mnist"
) -> Recipe:
    """Recipe of ours under a constraint."""
    return Recipe(
        data=data,
        designs="deepfsi",
        photons=tuple(photons),
        masks=MASKS[light],
        camera={"light": light, "rails": ("dual", "single")},
        draws=1,
        training={"epochs": epochs, "hidden": HIDDEN},
    )


def chosen(points: Sequence[Point], photons: float) -> Point:
    """Of the points at a budget, the one that validation chooses."""
    here = [point for point in points if np.isclose(point.photons, photons)]
    return max(here, key=lambda point: point.validation or 0)


def share(right: np.ndarray) -> str:
    """Mean of scenes that are right (n,), or their shares, with its 95 % interval over them."""
    low, high = wilson(float(right.mean()), len(right))
    return f"{right.mean():.4f} [{low:.4f}, {high:.4f}]"


def print_networks(networks: dict[int, Network], data: Dataset) -> None:
    """Table of the published networks: accuracy, clicks, and budgets at which their masks fit."""
    heads = ("neurons", "1 shot", f"{SHOTS} shots", "clicks", "arriving")
    heads += tuple(f"Φ, {light}" for light in LAWS)
    print(f"| {' | '.join(heads)} |")
    print("| --- " * len(heads) + "|")
    s = summed_reflectance(data.x_train)
    for size, network in networks.items():
        clicks = [network.clicks(data.x_test, seed) for seed in range(SHOTS)]
        once = np.mean([network.classes(each) == data.y_test for each in clicks], axis=0)
        several = network.classes(np.sum(clicks, axis=0), SHOTS) == data.y_test
        budgets = " | ".join(f"{network.least_photons(light, s):.0f}" for light in LAWS)
        seen = f"{share(once)} | {share(several)} | {np.mean(clicks) * size:.1f}"
        seen += f" | {network.arriving(data.x_test):.1f}"
        print(f"| {size} | {seen} | {budgets} |", flush=True)


def print_ours(
    networks: dict[int, Network], data: Dataset, light: LightLawName, epochs: int, folder: Path
) -> None:
    """Table of ours at the budgets of the networks."""
    s = summed_reflectance(data.x_train)
    budgets = [network.least_photons(light, s) for network in networks.values()]
    wanted = recipe(light, budgets, epochs, data.name)
    results, _ = compare(wanted, data, folder, command="benchmarks/published.py")
    best = [chosen(results.points, photons) for photons in budgets]
    print(f"\n| {light}, Φ of | Φ | ours | rails, masks | counts |")
    print("| --- | --- | --- | --- | --- |")
    for size, point in zip(networks, best, strict=True):
        seen = f"{point.accuracy:.4f} [{point.low:.4f}, {point.high:.4f}]"
        kind = f"{point.rails}, {point.masks}"
        print(
            f"| {size} | {point.photons:.0f} | {seen} | {kind} | {point.counts:.0f} |", flush=True
        )


def right_in(made: Design, data: Dataset, photons: float, shots: int, seed: int = 0) -> np.ndarray:
    """Whether the mean of a design's logits over shots is right, for each test scene (n,)."""
    generator = torch.Generator().manual_seed(shots + 1000 * seed)
    right = []
    with torch.no_grad():
        for rows in torch.arange(len(data.x_test)).split(1024):
            expose = made.exposures(torch.from_numpy(data.x_test[rows]), made.camera)
            logits = torch.zeros(len(rows), len(data.classes))
            for _ in range(shots):
                logits += expose(photons, generator)[0].logits
            right.append(logits.argmax(dim=1).numpy() == data.y_test[rows])
    return np.concatenate(right)


def print_few(
    networks: dict[int, Network],
    data: Dataset,
    light: LightLawName,
    seeds: Sequence[int],
    epochs: int | None,
) -> None:
    """Table of ours, for detectors that click, at no more clicks and Φ than the networks."""
    s, part = summed_reflectance(data.x_train), data.hold_out()
    heads = (f"{light}, clicks of", "Φ", "seed", "validation", "1 shot", f"{SHOTS} shots")
    print(f"\n| {' | '.join((*heads, 'clicks', 'arriving'))} |")
    print("| --- " * (len(heads) + 2) + "|")
    for size, network in networks.items():
        photons = network.least_photons(light, s)
        clicks = float(network.clicks(part.x_train).sum(axis=1).mean())
        usual = CLICKING.get(size, CLICKING[10])
        training = {"hidden": HIDDEN, "lr": 3e-3, **usual["training"]}
        if epochs is not None:
            training["epochs"] = epochs
        found = []
        for seed in seeds:
            made = learn(
                part,
                counts=FEWER * clicks,
                photons=photons,
                masks=usual["masks"],
                camera={"light": light, "rails": "single", "noise": "click"},
                training=training,
                seed=seed,
            )
            [held] = evaluate(made, part, photons, draws=1, seed=seed)
            [seen] = evaluate(made, data, photons, draws=SHOTS, seed=seed)
            several = right_in(made, data, photons, SHOTS, seed)
            found.append((held.accuracy, seen.accuracy, several.mean(), seen.counts, seen.arriving))
            shares = f"{held.accuracy:.4f} | {seen.accuracy:.4f} [{seen.low:.4f}, {seen.high:.4f}]"
            shares += f" | {share(several)} | {seen.counts:.1f} | {seen.arriving:.1f}"
            print(f"| {size} | {photons:.0f} | {seed} | {shares} |", flush=True)
        if len(seeds) > 1:
            print(f"| {size} | {photons:.0f} | mean ± SD | {over_seeds(found)} |", flush=True)


def over_seeds(found: Sequence[tuple[float, ...]]) -> str:
    """Means and standard deviations over seeds: three accuracies, clicks and photons."""
    mean, spread = np.mean(found, axis=0), np.std(found, axis=0, ddof=1)
    digits = (4, 4, 4, 1, 1)
    cells = zip(mean, spread, digits, strict=True)
    return " | ".join(f"{value:.{n}f} ± {off:.{n}f}" for value, off, n in cells)


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of incoherent_nK.npz, as the text above says")
    parser.add_argument("-o", "--out", type=Path, default=Path("runs/published"))
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--neurons", type=int, nargs="+", default=list(NEURONS))
    parser.add_argument("--epochs", type=int, help="15, and for clicks those chosen, unless given")
    parser.add_argument("--few", action="store_true", help="the tables for clicks alone")
    parser.add_argument("--laws", nargs="+", default=list(LAWS), choices=LAWS)
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0, 1, 2], help="of the designs for clicks"
    )
    asked = parser.parse_args(words)
    data = load_dataset(asked.data, rescale=(0.0, 1.0))
    networks = read_networks(asked.folder, asked.neurons, data.pixels, parser)
    print_networks(networks, data)
    for light in () if asked.few else asked.laws:
        print_ours(networks, data, light, asked.epochs or 15, asked.out)
    for light in asked.laws:
        print_few(networks, data, light, asked.seeds, asked.epochs)


if __name__ == "__main__":
    main()
