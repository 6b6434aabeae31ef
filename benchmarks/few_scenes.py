"""Confidence of designs that few scenes trained: accuracy, log loss and calibration error.

    python benchmarks/few_scenes.py                      # MNIST, a quarter of an hour
    python benchmarks/few_scenes.py --data digits --classes 3 8 9 --pictures 20 40

Of so many pictures of each class, four fifths are trained on, as `deepfsi design` does with a
folder. Other pictures, of the data's test part, are answered once each, at the light of the
training. Numbers are means over seeds, which draw the pictures and train. Of the calibration error
that is subtracted which an exactly calibrated answer of the same probabilities would show with as
many pictures (200 draws). ± is the standard error over seeds.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import softmax

import deepfsi
from calibration import chance_error
from deepfsi.datasets.dataset import Dataset
from deepfsi.evaluation.confidence import draw_logits
from deepfsi.evaluation.measures import confidence_error
from deepfsi.exposure.kind import temperatures_at

DESIGNS: dict[str, dict[str, Any]] = {
    "adaptive masks": {"design": "adaptive", "masks": 16},
    "learned masks": {"masks": 16},
}
"""Settings of the designs."""


def drawn(data: Dataset, classes: Sequence[int], each: int, tests: int, seed: int) -> Dataset:
    """Some pictures of each of some classes, and others of the test part."""
    rng = np.random.default_rng(seed)

    def rows(labels: np.ndarray, count: int) -> np.ndarray:
        own = [np.flatnonzero(labels == label) for label in classes]
        return np.concatenate([rng.permutation(part)[:count] for part in own])

    kept, others = rows(data.y_train, each * 4 // 5), rows(data.y_test, tests)
    place = {label: k for k, label in enumerate(classes)}
    known, truth = (
        np.array([place[label] for label in labels])
        for labels in (data.y_train[kept], data.y_test[others])
    )
    return replace(
        data,
        x_train=data.x_train[kept],
        y_train=known,
        x_test=data.x_test[others],
        y_test=truth,
        classes=tuple(data.classes[label] for label in classes),
        origin=None,
    )


def answers(design: Any, data: Dataset, photons: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities (E, C) of the test pictures, with temperatures and without."""
    found = []
    if design.exposure.makes_masks:
        plain = replace(
            design,
            exposure=replace(
                design.exposure, prior=design.prior_exposure.prior.with_temperatures(None)
            ),
        )
        for each in (design, plain):
            found.append(np.exp(draw_logits(each, each.camera, data.x_test, photons, 1, seed)))
        return found[0], found[1]
    logits = draw_logits(design, design.camera, data.x_test, photons, 1, seed)
    temperature = float(temperatures_at(design.temperatures, 0, photons))
    return softmax(logits / temperature, axis=1), softmax(logits, axis=1)


def measures(chances: np.ndarray, truth: np.ndarray) -> list[float]:
    """Accuracy, mean confidence, calibration error beyond chance and log loss."""
    sure, right = chances.max(axis=1), chances.argmax(axis=1) == truth
    beyond = confidence_error(sure, right) - chance_error(sure)
    loss = -np.log(chances[np.arange(len(truth)), truth].clip(1e-30))
    return [float(right.mean()), float(sure.mean()), beyond, float(loss.mean())]


def main(words: Sequence[str] | None = None) -> None:
    """Draw pictures, train, test and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--classes", type=int, nargs="+", default=[3, 5, 8])
    parser.add_argument("--pictures", type=int, nargs="+", default=[20, 40, 100, 400])
    parser.add_argument("--tests", type=int, default=200, help="pictures of a class in the test")
    parser.add_argument("--photons", type=float, default=1e4)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12, 13, 14])
    parser.add_argument("--designs", nargs="+", default=list(DESIGNS), help="some of them")
    given = parser.parse_args(words)
    data = deepfsi.load_dataset(given.data)
    print("| design | pictures a class | accuracy | mean confidence | error beyond chance | "
          "log loss | without folds: error | log loss |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name in given.designs:
        settings = DESIGNS[name]
        for each in given.pictures:
            rows = []
            for seed in given.seeds:
                some = drawn(data, given.classes, each, given.tests, seed)
                design = deepfsi.learn(
                    some, camera="dmd", photons=given.photons, seed=seed, **settings
                )
                both = answers(design, some, given.photons, seed)
                rows.append([measures(chances, some.y_test) for chances in both])
            mean = np.mean(rows, axis=0)
            error = np.std(rows, axis=0, ddof=1) / len(rows) ** 0.5 if len(rows) > 1 else 0 * mean
            (right, sure, beyond, loss), (_, _, raw, raw_loss) = mean
            print(
                f"| {name} | {each} | {right:.3f} ± {error[0, 0]:.3f} | {sure:.3f} "
                f"| {beyond:.3f} ± {error[0, 2]:.3f} | {loss:.2f} | {raw:.3f} | {raw_loss:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
