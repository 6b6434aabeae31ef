"""Classes of new pictures in a simulated exposure."""

import csv
import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.datasets import prepared
from deepfsi.datasets.display import Display
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import camera_for, check_draws, scanner_for
from deepfsi.design.file_content import check_classes
from deepfsi.design.training_data import trained_on
from deepfsi.errors import InputError
from deepfsi.hardware.calibration.view import camera_view
from deepfsi.hardware.recording.calibration_file import load_calibration
from deepfsi.laboratory.light import dim_scenes
from deepfsi.optics.budget import check_budget
from deepfsi.optics.camera import CameraSource
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
    def right(self) -> tuple[int, int]:
        """Number of right labels, and of those that are classes of the design."""
        known = [each for each in self.pictures if each.label in self.classes]
        return sum(each.predicted == each.label for each in known), len(known)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return vars(self) | {"pictures": [each.as_dict() for each in self.pictures]}

    def as_csv(self) -> str:
        """Table with a line for each picture."""
        text = io.StringIO()
        table = csv.DictWriter(text, ("picture", "class", "confidence", "label"))
        table.writeheader()
        table.writerows(each.as_dict() for each in self.pictures)
        return text.getvalue()


@library_defaults()
def predict(
    design: Design,
    pictures: str | os.PathLike[str],
    photons: float,
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
    photons : float
        Budget Φ.
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
        If the design was trained on no pictures that it remembers, or these are of another size.

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
    budget = check_budget(photons)
    check_draws(1, seed)
    tested = camera_for(design, camera, **settings)
    scanner = scanner_for(design, tested)
    shown = _scenes(design, Path(pictures).expanduser(), skip_bad)
    generator = torch.Generator(design.mean.device).manual_seed(seed)
    scenes = torch.from_numpy(np.ascontiguousarray(shown.x.reshape(len(shown.x), -1)))
    chances = []
    with torch.no_grad():
        for some in scenes.split(AT_ONCE):
            *_, seen = design.expose(scanner, design.rates(scanner, some), generator, budget)
            chances.append(design.chances(seen, budget).cpu())
    surest, places = torch.cat(chances).max(dim=-1)
    found = tuple(
        Predicted(name, label, design.classes[place], confidence)
        for name, label, place, confidence in zip(
            shown.names,
            shown.labels or [None] * len(shown.names),
            places.tolist(),
            surest.tolist(),
            strict=True,
        )
    )
    remarks = tuple(fault.detail for fault in dim_scenes(design, np.array([budget])))
    said = shown.preprocessing
    return Predictions(budget, tested.noise_name, said, remarks, design.classes, found)


def _scenes(design: Design, pictures: Path, skip_bad: bool) -> Display:
    """Pictures as scenes of the design's data, as it saw them."""
    known = trained_on(design.info)
    if known is None or known.origin is None:
        raise InputError(
            "this design was trained on data that no file or name holds, such as arrays in memory, "
            "and does not know what to do to pictures: learn it from pictures, or `evaluate` it on "
            "arrays with labels"
        )
    shown = prepared(pictures, known.origin, skip_bad)
    if shown.x.shape[1:] != design.image_shape:
        sides = ("x".join(map(str, shape)) for shape in (shown.x.shape[1:], design.image_shape))
        raise InputError(
            "the pictures are of {} pixels and the design's scenes of {}: bring them to its "
            "size, or learn a design with `size`".format(*sides)
        )
    if known.origin.view is None:
        return shown
    calibration = load_calibration(Path(known.origin.view))
    x = camera_view(shown.x.reshape(len(shown.x), -1), design.image_shape, calibration)
    return shown._replace(x=x, preprocessing=f"{shown.preprocessing}, then as the camera sees it")
