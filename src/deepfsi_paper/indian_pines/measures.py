"""Numbers behind the figures of Indian Pines, as `indian-pines.json` holds them.

The scene and its parts, classes that DeepFSI gives to every labelled pixel, and its accuracy class
by class.
"""

import base64
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.catalog import load_indian_pines
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.design.design import Design
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import best

MAPPED = (1e2, 1e4, 1e6)
"""Budgets of the class maps, photons."""

TRAINED, TESTED, LEFT_OUT = 1, 2, 3
"""Use of a labelled pixel; 0 has no label."""


@dataclass(frozen=True)
class Packed:
    """Small whole numbers 0 to 255 in base64."""

    shape: tuple[int, ...]
    bytes: str

    @property
    def values(self) -> np.ndarray:
        """The array that was packed."""
        return np.frombuffer(base64.b64decode(self.bytes), np.uint8).reshape(self.shape)


def pack(values: np.ndarray) -> Packed:
    """Small whole numbers 0 to 255 as JSON can hold them."""
    return Packed(values.shape, base64.b64encode(values.astype(np.uint8).tobytes()).decode())


@dataclass(frozen=True)
class Overview:
    """Hyperspectral scene: its classes and bands."""

    classes: Sequence[str]
    labels: Packed  # class of each pixel from 1, 0 for none
    bands: int


@dataclass(frozen=True)
class Parts:
    """Pixels of one split: the use of each, and the numbers of each use and of tested classes."""

    uses: Packed
    train: int
    test: int
    left_out: int
    classes_tested: int


@dataclass(frozen=True)
class ClassMap:
    """Classes given to every pixel, and their accuracy on training and on test pixels."""

    split: str
    photons: float
    map: Packed
    train: float
    test: float


@dataclass(frozen=True)
class Recall:
    """Accuracy (trials, classes) of DeepFSI on the test pixels of each class; None without any."""

    split: str
    photons: float
    rates: Sequence[Sequence[float | None]]


@dataclass(frozen=True)
class Measures:
    """Everything that is measured beyond accuracies; `parts` by split."""

    scene: Overview
    parts: dict[str, Parts]
    maps: Sequence[ClassMap]
    recalls: Sequence[Recall]


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Overview, parts, class maps and recalls of the trained designs."""
    scene = load_indian_pines()
    splits = list(dict.fromkeys(point.split for point in results.points))
    parts: dict[str, Parts] = {}
    maps: list[ClassMap] = []
    for number, split in enumerate(splits):
        report(number / len(splits), f"class maps, {split} split")
        uses = _uses(scene, split)
        parts[split] = _parts(scene, uses)
        chosen = best(results, noise="poisson", split=split)
        for photons in MAPPED:
            if ("deepfsi", photons) in chosen:
                design = _load(designs, chosen[("deepfsi", photons)])
                seen = _classify_pixels(design, scene, data.pixels, photons)
                right = seen == _ranks(scene)
                train, test = (float(right[uses == use].mean()) for use in (TRAINED, TESTED))
                maps.append(ClassMap(split, photons, pack(seen), train, test))
    recalls = [row for split in splits for row in _recalls(results, scene, split, designs)]
    overview = Overview(list(scene.class_names), pack(_ranks(scene)), scene.cube.shape[2])
    return asdict(Measures(overview, parts, maps, recalls))


def _load(designs: Path, point: Point, trial: int = 0) -> Design:
    return Design.load(designs / f"{point.keys[trial]}.safetensors")


def _ranks(scene: SpectralImage) -> np.ndarray:
    """Place of each pixel's class among those present, from 1, (H, W); 0 where it has none."""
    present = np.unique(scene.labels[scene.labels != 0])
    return np.where(scene.labels != 0, np.searchsorted(present, scene.labels) + 1, 0)


def _uses(scene: SpectralImage, split: str) -> np.ndarray:
    train, test = scene.parts(split)
    return np.select([train, test, scene.labels != 0], [TRAINED, TESTED, LEFT_OUT], 0)


def _parts(scene: SpectralImage, uses: np.ndarray) -> Parts:
    train, test, left_out = (int((uses == use).sum()) for use in (TRAINED, TESTED, LEFT_OUT))
    tested = len(np.unique(scene.labels[uses == TESTED]))
    return Parts(pack(uses), train, test, left_out, tested)


def _classify_pixels(
    design: Design, scene: SpectralImage, bands: int, photons: float
) -> np.ndarray:
    """Class of each labelled pixel after one exposure with photon noise, from 1; 0 elsewhere."""
    known = scene.labels != 0
    spectra = torch.from_numpy(scene.scenes(bands)[known.ravel()])
    scanner = design.scanner("poisson")
    with torch.no_grad():
        rates = scanner.rates(spectra / design.summed_reflectance) * photons
        counts = scanner.read(rates, torch.Generator().manual_seed(0))
        guess = design.answer(scanner.detection.features(counts) / photons, photons).classes
    seen = np.zeros(known.shape, int)
    seen[known] = guess.numpy() + 1
    return seen


def _recalls(results: Results, scene: SpectralImage, split: str, designs: Path) -> Iterator[Recall]:
    """Accuracy of DeepFSI on the test pixels of each class, under photon noise."""
    data = scene.dataset(split, bands=results.data.image_shape[0])
    for (design, photons), point in best(results, noise="poisson", split=split).items():
        if design == "deepfsi":
            trials = [
                evaluate(_load(designs, point, seed), data, photons, seed=seed, report=SILENT)
                for seed in range(len(point.keys))
            ]
            yield Recall(split, photons, [trial[0].rates for trial in trials])
