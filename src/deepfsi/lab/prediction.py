"""Classes of new pictures in a simulated exposure."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import budget_text
from deepfsi.camera.camera import CameraSource
from deepfsi.camera.light import check_budget
from deepfsi.designfile.misfit import FALSE_ALARM
from deepfsi.designfile.provenance import known_hashes, trained_budgets, was_trained_on
from deepfsi.lab.count_test import CountTest
from deepfsi.lab.design_data import design_scenes
from deepfsi.lab.results import ClassifiedRun, ClassifiedScene

if TYPE_CHECKING:  # it imports torch, which those who predict nothing do without
    from deepfsi.design.design import Design


@dataclass(frozen=True, kw_only=True)
class Predictions(ClassifiedRun):
    """Classes of pictures, each from one simulated exposure."""

    photons: float
    noise: str
    preprocessing: str  # what was done to the pictures, in words

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        names = {"picture": "name", "class": "predicted", "confidence": "probability"}
        names |= {name: name for name in ("label", "trained_on", "unlike")}
        alike = ("photons", "noise", "preprocessing", "remarks", "classes", "score")
        content = {name: getattr(self, name) for name in alike}
        content["pictures"] = [
            {key: getattr(scene, name) for key, name in names.items()} for scene in self.scenes
        ]
        return content


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
        `scenes`, one for each picture, with its `predicted` class and the `probability` of it.

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
    ...     answers = deepfsi.predict(design, folder, photons=1e4)
    >>> answers.scenes[3].label, len(answers.scenes)
    ('3', 10)
    """
    import torch

    from deepfsi.evaluation.accuracy import camera_for
    from deepfsi.exposure.kind import EXPOSED_AT_ONCE
    from deepfsi.exposure.training_set import check_classes
    from deepfsi.physics.noise import noise_of
    from deepfsi.physics.surroundings import library_defaults

    source: Path | np.ndarray
    if isinstance(pictures, str | os.PathLike):
        source = Path(pictures).expanduser()
    else:
        source = np.asarray(pictures)
    check_classes(design.values, "predict")
    with library_defaults(grad=False):
        tested = camera_for(design, camera=camera, **settings)
        if photons is None:
            if not (budgets := trained_budgets(design.info)):
                raise InputError("this design does not say its training's light: give `photons`")
            low, high = budgets
            # a budget outside the training's would be answered beyond what was learned
            photons = tested.budget if tested.budget and low <= tested.budget <= high else low
        budget = check_budget(photons)
        shown = design_scenes(design.info, design.image_shape, source)
        scenes = np.ascontiguousarray(shown.x.reshape(len(shown.x), -1))
        light = scenes.sum(axis=1, dtype=float) / design.summed_reflectance
        all_on = np.random.default_rng([seed, 1]).poisson(budget * light)
        test = CountTest(design)
        p_values = None
        if test.usual is None or not tested.noise_facts.steady:
            generator = torch.Generator(design.exposure.device).manual_seed(seed)
            answers = [
                design.exposures(block, tested)(budget, generator)[0].probabilities.cpu()
                for block in torch.from_numpy(scenes).split(EXPOSED_AT_ONCE)
            ]
            probabilities = torch.cat(answers).numpy()
        elif design.exposure.makes_masks:
            probabilities, p_values = design.prior_exposure.tested(
                torch.from_numpy(scenes), budget, tested, seed, all_on
            )
        else:
            counts = design.expose(scenes, budget, seed, tested)
            probabilities = design.classify(counts, budget)
            scanner = design.mask_exposure.scanner(noise_of(tested))
            dark = scanner.dark_counts(design.rails.count).cpu().numpy()
            read_noise = tested.noise_facts.read_noise * tested.sigma**2
            noise = dark.reshape(design.counts_shape) + read_noise
            p_values = design.consistency(counts, budget, noise, all_on)
        dim = test.find_dim(np.array([budget]))
    best = probabilities.argmax(axis=1)
    labels = shown.labels or [None] * len(shown.names)
    hashes = known_hashes(design.training_scenes, shown.x, design.image_shape)
    trained = was_trained_on(design.training_scenes, hashes)
    size = f"{design.name}, {design.exposure.title}"
    return Predictions(
        title=f"{size}, {budget_text(budget)} photons, {tested.noise_name} noise",
        noun="picture",
        photons=budget,
        noise=tested.noise_name,
        preprocessing=shown.preprocessing,
        remarks=tuple(fault.detail for fault in dim),
        classes=design.classes,
        scenes=tuple(
            ClassifiedScene(
                name=name,
                label=labels[index],
                predicted=design.classes[best[index]],
                probability=float(probabilities[index].max()),
                unlike=None if p_values is None else bool(p_values[index] < FALSE_ALARM),
                trained_on=trained[index],
            )
            for index, name in enumerate(shown.names)
        ),
    )
