"""Rules from the literature for few detected photons or clicks, beside which designs are compared.

    python benchmarks/few_photons.py FOLDER  # table of docs/notebook/published.md, some minutes
    python benchmarks/few_photons.py FOLDER --data digits --neurons 10

FOLDER holds the published networks as `published.py` reads them. Masks are not trained here.

First photons: n detected photons, each with the pixel that it came from, as a detector for each
pixel sees them. Photons of a scene x land at pixel i with the probability x_i / Σ x. The rule takes
them for independent draws of the class's mean histogram: a multinomial naive Bayes rule, which for
n = 1 is the Bayes rule. Its smoothing is chosen on validation images.

Eigentasks (F. Hu, G. Angelatos, S. A. Khan, M. Vives, E. Türeci, L. Bello, G. E. Rowlands,
G. J. Ribeill, H. E. Türeci, "Tackling sampling noise in physical systems for machine learning
applications: fundamental limits and eigentasks", Physical Review X 13, 041020, 2023): the linear
combinations r of counts that are least noisy, from V r = β² G r with the second moments G of the
mean counts over scenes and the mean V of their noise covariance over scenes. A logistic regression
reads those with the lowest β²; how many is chosen on validation images. With all of them it is the
logistic regression of the counts themselves. Counts are clicks of the
published masks; as many clicks of as many random masks, the share of whose pixels that are open is
chosen on validation images; and as many photons of a detector for each pixel, which are those of a
raster scan that detects as many. The published networks were trained on the validation images, too.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq
from sklearn.linear_model import LogisticRegression
from sklearn.naive_bayes import MultinomialNB
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from published import NEURONS, Network, read_networks, share

PHOTONS = (1, 6, 34, 72, 303)
"""Numbers of detected photons; but for the first those of clicks of the published networks."""

SMOOTHING = (1e-6, 1e-4, 1e-2, 1.0)
"""Photons added to each pixel of a class's histogram, of which validation chooses."""

OPEN = (0.1, 0.02)
"""Shares of open pixels of random masks, of which validation chooses."""

KEPT = (16, 64, 256)
"""Numbers of eigentasks, besides all, of which validation chooses."""


def landing(x: np.ndarray) -> np.ndarray:
    """Where the photons of scenes (n, N) land: shares of pixels that add to one."""
    exact = x.astype(np.float64)
    return exact / exact.sum(axis=1, keepdims=True)


def first_photons(data: Dataset, count: int) -> tuple[np.ndarray, float]:
    """Test scenes (n,) that the rule of so many photons reads right, and its smoothing."""
    rng, part = np.random.default_rng(count), data.hold_out()
    rules = {
        smoothing: MultinomialNB(alpha=smoothing).fit(landing(part.x_train), part.y_train)
        for smoothing in SMOOTHING
    }
    held = rng.multinomial(count, landing(part.x_test))
    best = max(SMOOTHING, key=lambda smoothing: rules[smoothing].score(held, part.y_test))
    photons = rng.multinomial(count, landing(data.x_test))
    return rules[best].predict(photons) == data.y_test, best


@dataclass(frozen=True)
class Detectors:
    """Masks (K, N) whose counts are photons, or one click of each at most."""

    masks: np.ndarray
    click: bool

    def mean(self, x: np.ndarray) -> np.ndarray:
        """Expected counts (n, K) of scenes (n, N), which have this variance if they are photons."""
        rates = x @ self.masks.T
        return -np.expm1(-rates) if self.click else rates

    def scaled(self, x: np.ndarray, counts: float) -> "Detectors":
        """Masks that count so many in the mean over scenes (n, N)."""

        def excess(log: float) -> float:
            return self.brighter(np.exp(log)).mean(x).sum(axis=1).mean() - counts

        return self.brighter(np.exp(brentq(excess, -20, 20, xtol=1e-6)))

    def brighter(self, factor: float) -> "Detectors":
        """Masks that pass so many times the light."""
        return replace(self, masks=factor * self.masks)

    def counts(self, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Counts (n, K) of scenes (n, N), one exposure."""
        mean = self.mean(x)
        return rng.binomial(1, mean) if self.click else rng.poisson(mean)


def eigentasks(detectors: Detectors, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigentasks (K, k) in columns, and their 1 / β² (k,) from the highest, over scenes (n, N)."""
    mean = detectors.mean(x)
    noise = (mean * (1 - mean) if detectors.click else mean).mean(axis=0)
    seen = noise > 0  # what never counts tells nothing
    signal, found = eigh(mean[:, seen].T @ mean[:, seen] / len(x), np.diag(noise[seen]))
    tasks = np.zeros((len(seen), seen.sum()))
    tasks[seen] = found[:, ::-1]
    return tasks, signal[::-1]


@dataclass(frozen=True)
class Reader:
    """Eigentasks (K, k) of detectors, the classifier that reads them, and what was found."""

    detectors: Detectors
    tasks: np.ndarray
    classifier: Pipeline
    validation: float
    clear: int  # eigentasks with β² < 1

    def right(self, data: Dataset) -> np.ndarray:
        """Test scenes (n,) that it reads right, one exposure each."""
        counts = self.detectors.counts(data.x_test, np.random.default_rng(1))
        return self.classifier.predict(counts @ self.tasks) == data.y_test


def fitted(detectors: Detectors, data: Dataset) -> Reader:
    """Reader of the number of eigentasks that is best on validation scenes."""
    rng, part = np.random.default_rng(0), data.hold_out()
    tasks, signal = eigentasks(detectors, part.x_train)
    counts, held = (detectors.counts(x, rng) @ tasks for x in (part.x_train, part.x_test))
    readers = []
    for kept in (*(each for each in KEPT if each < len(signal)), len(signal)):
        classifier = make_pipeline(StandardScaler(), LogisticRegression(tol=1e-3, max_iter=1000))
        classifier.fit(counts[:, :kept], part.y_train)
        found = float(classifier.score(held[:, :kept], part.y_test))
        readers.append(
            Reader(detectors, tasks[:, :kept], classifier, found, int((signal > 1).sum()))
        )
    return max(readers, key=lambda reader: reader.validation)


def print_photons(data: Dataset) -> None:
    """Table of the rule of the first photons."""
    print("\n| photons detected | accuracy | smoothing |\n| --- | --- | --- |")
    for count in PHOTONS:
        right, smoothing = first_photons(data, count)
        print(f"| {count} | {share(right)} | {smoothing:g} |", flush=True)


def print_eigentasks(networks: dict[int, Network], data: Dataset) -> None:
    """Table of eigentasks of published masks, random masks and pixels, at the same counts."""
    heads = ("neurons", "counts", "masks", "accuracy", "eigentasks read", "β² < 1")
    print(f"\n| {' | '.join(heads)} |")
    print("| --- " * len(heads) + "|")
    rng, x = np.random.default_rng(1), data.hold_out().x_train
    for size, network in networks.items():
        counts = float(Detectors(network.masks, click=True).mean(x).sum(axis=1).mean())
        places = rng.random((size, data.pixels))
        random = {
            f"random, {part:.1%} open, clicks": Detectors((places < part).astype(float), click=True)
            for part in OPEN
        }
        for kinds in (
            {"published, clicks": Detectors(network.masks, click=True)},
            random,
            {"pixels, photons": Detectors(np.eye(data.pixels), click=False)},
        ):
            readers = {name: fitted(kind.scaled(x, counts), data) for name, kind in kinds.items()}
            name, reader = max(readers.items(), key=lambda each: each[1].validation)
            row = f"{counts:.1f} | {name} | {share(reader.right(data))}"
            print(f"| {size} | {row} | {reader.tasks.shape[1]} | {reader.clear} |", flush=True)


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the published networks")
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--neurons", type=int, nargs="+", default=list(NEURONS))
    asked = parser.parse_args(words)
    data = load_dataset(asked.data, rescale=(0.0, 1.0))
    networks = read_networks(asked.folder, asked.neurons, data.pixels, parser)
    print_photons(data)
    print_eigentasks(networks, data)


if __name__ == "__main__":
    main()
