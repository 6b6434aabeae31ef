"""Numbers behind the figures of Indian Pines, as `indian-pines.json` holds them.

The scene and its parts, and the accuracy of DeepFSI class by class.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.catalog import load_indian_pines
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.design.design import Design
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.sweeps.results import Results
from deepfsi_paper.experiment import best


@dataclass(frozen=True)
class Parts:
    """Numbers of labelled pixels of one split by their use, and of tested classes."""

    train: int
    test: int
    left_out: int
    classes_tested: int


@dataclass(frozen=True)
class Recall:
    """Accuracy (trials, classes) of DeepFSI on the test pixels of each class; None without any."""

    split: str
    photons: float
    rates: Sequence[Sequence[float | None]]


@dataclass(frozen=True)
class Measures:
    """Everything that is measured beyond accuracies; `parts` by split."""

    bands: int
    sizes: Sequence[int]  # labelled pixels of each class
    parts: dict[str, Parts]
    recalls: Sequence[Recall]


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Parts of the scene, and recalls of the trained designs."""
    scene = load_indian_pines()
    splits = list(dict.fromkeys(point.split for point in results.points))
    _, sizes = np.unique(scene.labels[scene.labels != 0], return_counts=True)
    return asdict(
        Measures(
            scene.cube.shape[2],
            sizes.tolist(),
            {split: _parts(scene, split) for split in splits},
            [row for split in splits for row in _recalls(results, scene, split, designs)],
        )
    )


def _parts(scene: SpectralImage, split: str) -> Parts:
    train, test = scene.parts(split)
    labelled = int((scene.labels != 0).sum())
    left_out = labelled - int(train.sum()) - int(test.sum())
    return Parts(int(train.sum()), int(test.sum()), left_out, len(np.unique(scene.labels[test])))


def _recalls(results: Results, scene: SpectralImage, split: str, designs: Path) -> Iterator[Recall]:
    """Accuracy of DeepFSI on the test pixels of each class, under photon noise."""
    data = scene.dataset(split, bands=results.data.image_shape[0])
    for (design, photons), point in best(results, noise="poisson", split=split).items():
        if design == "deepfsi":
            trials = [
                evaluate(
                    Design.load(designs / f"{key}.safetensors"),
                    data,
                    photons,
                    seed=seed,
                    report=SILENT,
                )
                for seed, key in enumerate(point.keys)
            ]
            yield Recall(split, photons, [trial[0].rates for trial in trials])
