"""Classes of new pictures in a simulated exposure."""

import csv
import io
import os
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.base import InputError
from deepfsi.camera import Camera, CameraSource, check_budget
from deepfsi.design.artifact import Design
from deepfsi.design.clicks import full_gates
from deepfsi.design.evaluation import camera_for, check_draws, scanner_for
from deepfsi.design.values import check_classes
from deepfsi.designfile import Score, scene_hashes, was_trained_on
from deepfsi.lab.light import dim_scenes
from deepfsi.lab.scenes import design_scenes
from deepfsi.optics.surroundings import library_defaults

AT_ONCE = 1024
"""Pictures that are exposed together."""


@dataclass(frozen=True)
class Predicted:
    """Class of a picture."""

    name: str  # of its file
    label: str | None  # class that it is known to be of
    predicted: str
    confidence: float  # probability of that class
    trained_on: bool | None  # true if the design was; none where its file does not say

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        names = {"name": "picture", "predicted": "class"}
        return {names.get(name, name): value for name, value in vars(self).items()}


@dataclass(frozen=True)
class Predictions:
    """Classes of pictures, each from one exposure that was simulated."""

    photons: float  # budget
    noise: str
    preprocessing: str  # what was done to the pictures, in words
    remarks: tuple[str, ...]  # on the budget, where it is too little for the design
    classes: tuple[str, ...]  # those that the design tells apart
    pictures: tuple[Predicted, ...]

    @property
    def score(self) -> Score:
        """Right answers to pictures whose label is a class of the design."""
        known = [each for each in self.pictures if each.label in self.classes]
        return Score.of((each.trained_on, each.predicted == each.label, 1) for each in known)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        pictures = [each.as_dict() for each in self.pictures]
        return vars(self) | {"score": self.score.as_dict(), "pictures": pictures}

    def as_csv(self) -> str:
        """Table with a line for each picture."""
        text = io.StringIO()
        table = csv.DictWriter(text, ("picture", "class", "confidence", "label", "trained_on"))
        table.writeheader()
        table.writerows(each.as_dict() for each in self.pictures)
        return text.getvalue()


@library_defaults()
def predict(
    design: Design,
    pictures: str | os.PathLike[str],
    photons: float | None = None,
    *,
    camera: CameraSource = None,
    seed: int = 0,
    skip_bad: bool = False,
    **settings: Any,
) -> Predictions:
    """Classes of new pictures, each from one simulated exposure under the camera's noise.

    The pictures get the preprocessing of the data that the design remembers: size, white, the range
    to which reflectance is mapped, and the view of a camera.

    Parameters
    ----------
    design : Design
    pictures : str or path
        A picture, a folder of pictures, one with a sub-folder for each class, or a ``.csv`` file of
        file names and labels. Those that ``deepfsi data export`` wrote are mapped already.
    photons : float, optional
        Budget Φ; that of the camera unless given, within the budgets of the training, else the
        lowest of these.
    camera : Camera, str, path or mapping, optional
        Whose noise, dark counts and read noise are in force; the design's own unless given.
    seed : int
        Of the noise.
    skip_bad : bool
        Leave pictures that cannot be read out, which `preprocessing` then names.
    settings
        Fields of the camera in place of its own, such as ``noise="none"``.

    Returns
    -------
    Predictions

    Raises
    ------
    InputError
        If the design was trained on no pictures that it remembers, these are of another size, or
        no budget is known.

    Examples
    --------
    >>> import deepfsi, tempfile
    >>> from deepfsi.datasets import write_display
    >>> few = deepfsi.Training(epochs=5)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=10, training=few)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = write_display(deepfsi.load_dataset("digits"), folder, per_class=1)
    ...     found = deepfsi.predict(design, folder, photons=1e4)
    >>> found.pictures[3].label, len(found.pictures)
    ('3', 10)
    """
    check_classes(design.values, "predict")
    check_draws(1, seed)
    tested = camera_for(design, camera, **settings)
    budget = check_budget(_budget(design, tested) if photons is None else photons)
    scanner = scanner_for(design, tested)
    source = Path(pictures).expanduser()
    shown = design_scenes(design.info, design.image_shape, source, skip_bad)
    generator = torch.Generator(design.mean.device).manual_seed(seed)
    scenes = torch.from_numpy(np.ascontiguousarray(shown.x.reshape(len(shown.x), -1)))
    chances, clicks = [], 0.0
    with torch.no_grad():
        for some in scenes.split(AT_ONCE):
            rates = design.rates(scanner, some)
            *_, seen = design.expose(scanner, rates, generator, budget)
            chances.append(design.chances(seen, budget).cpu())
            if design.gates is not None:
                clicks += float(scanner.expected(budget * rates).sum())
    surest, places = torch.cat(chances).max(dim=-1)
    hashes = scene_hashes(shown.x, design.image_shape)
    found = tuple(
        Predicted(name, label, design.classes[place], confidence, trained)
        for name, label, place, confidence, trained in zip(
            shown.names,
            shown.labels or [None] * len(shown.names),
            places.tolist(),
            surest.tolist(),
            was_trained_on(design.training_scenes, hashes),
            strict=True,
        )
    )
    remarks = [fault.detail for fault in dim_scenes(design, np.array([budget]))]
    if design.gates is not None:
        share = clicks / (len(scenes) * prod(design.counts_shape) * design.gates)
        remarks += filter(None, [full_gates(share, budget)])
    said = shown.preprocessing
    return Predictions(budget, tested.noise_name, said, tuple(remarks), design.classes, found)


def _budget(design: Design, camera: Camera) -> float:
    """Budget of the camera's exposure if the training had it, else the lowest of the training."""
    trained = design.trained_budgets
    if trained is None:
        raise InputError(
            "this design does not say what light it was trained for: give {photons}",
            setting="photons",
        )
    low, high = trained
    return camera.budget if camera.budget and low <= camera.budget <= high else low
