"""Classes of new pictures in a simulated exposure."""

import csv
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import Table, budget_text
from deepfsi.camera.camera import Camera, CameraSource
from deepfsi.camera.light import check_budget
from deepfsi.designfile.provenance import Score, scene_hashes, was_trained_on
from deepfsi.lab.classify import dim_scenes
from deepfsi.lab.design_data import design_scenes
from deepfsi.lab.results import Classified

if TYPE_CHECKING:  # it imports torch, which those who predict nothing do without
    from deepfsi.design.design import Design


@dataclass(frozen=True, kw_only=True)
class Predicted(Classified):
    """Class of a picture."""

    NAME_KEY = "picture"

    confidence: float  # probability of that class


@dataclass(frozen=True)
class Predictions:
    """Classes of pictures, each from one exposure that was simulated."""

    photons: float
    noise: str
    preprocessing: str  # what was done to the pictures, in words
    remarks: tuple[str, ...]  # on the budget, where it is too little for the design
    classes: tuple[str, ...]  # those that the design tells apart
    pictures: tuple[Predicted, ...]

    @property
    def score(self) -> Score:
        """Right answers to pictures whose label is a class of the design."""
        return Score.of(
            (picture.trained_on, picture.predicted == picture.label, 1)
            for picture in self.pictures
            if picture.label in self.classes
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        pictures = [picture.as_dict() for picture in self.pictures]
        return vars(self) | {"score": self.score.as_dict(), "pictures": pictures}

    def lines(self, design: str) -> Iterator[str | Table]:
        """Lines on the class of each picture, after a text on the design."""
        yield f"pictures: {self.preprocessing}."
        yield Table(
            f"{design}, {budget_text(self.photons)} photons, {self.noise} noise",
            ("picture", "class", "confidence", "labelled"),
            [
                (each.name, str(each.predicted), f"{each.confidence:.3f}", each.label or "")
                for each in self.pictures
            ],
        )
        labelled = sum(each.label is not None for each in self.pictures)
        if foreign := labelled - self.score.answers:
            yield f"{foreign} pictures have labels that are none of the design's classes: left out"
        for remark in self.remarks:
            yield f"note: {remark}"
        yield from self.score.lines("picture")

    def as_csv(self) -> str:
        """Table with a line for each picture."""
        text = io.StringIO()
        table = csv.DictWriter(text, ("picture", "class", "confidence", "label", "trained_on"))
        table.writeheader()
        table.writerows(picture.as_dict() for picture in self.pictures)
        return text.getvalue()


def predict(
    design: "Design",
    pictures: str | os.PathLike[str] | npt.ArrayLike,
    photons: float | None = None,
    *,
    camera: CameraSource = None,
    seed: int = 0,
    **settings: Any,
) -> Predictions:
    """Classes of new pictures, each from one simulated exposure under the camera's noise.

    The pictures are prepared as the data of the training were: size, white, range of reflectance,
    and view of a camera.

    Parameters
    ----------
    design : Design
    pictures : str, path or array, shape (n, H, W) or (n, N)
        A picture, a folder of pictures, or one with a sub-folder for each class. Whole numbers of
        an array are treated as files are; floats are reflectance in [0, 1] and get no
        preprocessing. ``deepfsi data export`` mapped its pictures.
    photons : float, optional
        Budget Φ. Default: the camera's if the training has it, else the training's lowest.
    camera : Camera, str, path or mapping, optional
        Camera whose noise, dark counts and read noise hold. Default: the design's.
    seed : int
        Seed of the noise.
    **settings
        Fields that replace the camera's, such as ``noise="none"``.

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
    >>> from deepfsi.datasets.display import write_display
    >>> few = deepfsi.Training(epochs=5)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=10, training=few)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = write_display(deepfsi.load_dataset("digits"), folder, per_class=1)
    ...     found = deepfsi.predict(design, folder, photons=1e4)
    >>> found.pictures[3].label, len(found.pictures)
    ('3', 10)
    """
    import torch

    from deepfsi.evaluation.accuracy import camera_for, check_draws
    from deepfsi.exposure.kind import EXPOSED_AT_ONCE
    from deepfsi.exposure.training_set import check_classes
    from deepfsi.physics.surroundings import library_defaults

    source: Path | np.ndarray
    if isinstance(pictures, str | os.PathLike):
        source = Path(pictures).expanduser()
    elif (source := np.asarray(pictures)).dtype.kind not in "biuf":
        raise InputError(
            f"pictures were given as {type(pictures).__name__}: give a picture, a folder of "
            "pictures, a .csv file, or an array of numbers"
        )
    check_classes(design.values, "predict")
    check_draws(1, seed)
    with library_defaults(grad=False):
        tested = camera_for(design, camera=camera, **settings)
        budget = check_budget(_budget(design, tested) if photons is None else photons)
        shown = design_scenes(design.info, design.image_shape, source)
        generator = torch.Generator(design.exposure.device).manual_seed(seed)
        scenes = torch.from_numpy(np.ascontiguousarray(shown.x.reshape(len(shown.x), -1)))
        chances = []
        for some in scenes.split(EXPOSED_AT_ONCE):
            answer, _ = design.exposures(some, tested)(budget, generator)
            chances.append(answer.chances.cpu())
        confidence, best = torch.cat(chances).max(dim=-1)
        remarks = [fault.detail for fault in dim_scenes(design, np.array([budget]))]
    labels = shown.labels or [None] * len(shown.names)
    trained = was_trained_on(design.training_scenes, scene_hashes(shown.x, design.image_shape))
    return Predictions(
        photons=budget,
        noise=tested.noise_name,
        preprocessing=shown.preprocessing,
        remarks=tuple(remarks),
        classes=design.classes,
        pictures=tuple(
            Predicted(
                name=name,
                label=labels[index],
                predicted=design.classes[best[index]],
                confidence=float(confidence[index]),
                trained_on=trained[index],
            )
            for index, name in enumerate(shown.names)
        ),
    )


def _budget(design: "Design", camera: Camera) -> float:
    """Budget of the camera's exposure if the training had it, else the lowest of the training."""
    trained = design.trained_budgets
    if trained is None:
        raise InputError("this design does not say what light it was trained for: give `photons`")
    low, high = trained
    return camera.budget if camera.budget and low <= camera.budget <= high else low
