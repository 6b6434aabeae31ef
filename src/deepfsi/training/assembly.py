"""Designs from the masks and classifiers of a training loop, ours or a user's."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from deepfsi.base.errors import InputError
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import check_budget
from deepfsi.camera.names import LightLawName, find_noise
from deepfsi.datasets.load import Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.design.networks import OwnClassifier, make_custom
from deepfsi.exposure.kind import Clicks, MaskExposure
from deepfsi.exposure.training import ExposureTraining
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.exposures import FixedEntry
from deepfsi.jobs.job import Job
from deepfsi.physics.detection import Rails
from deepfsi.physics.laws import LearnedMasks, light_law
from deepfsi.physics.scanner import Scanner
from deepfsi.physics.surroundings import library_defaults
from deepfsi.training.characterisation import characterise, provenance


@library_defaults(grad=True)
def design_of(
    scanner: Scanner,
    classifier: nn.Module,
    data: Source,
    photons: float,
    *,
    light: LightLawName = "column",
) -> Design:
    """Make a design from a scanner and a network that you have trained together.

    The design scales counts of another budget to the budget of the training. Raises `InputError`
    if scanner, classifier and data do not fit together, or the masks break their law.

    Parameters
    ----------
    scanner : Scanner
        Masks, without replicas, and detectors.
    classifier : nn.Module
        Maps features (batch, k) of the scanner, by default m differences y⁺ − y⁻, to logits
        (batch, C) or standardised values (batch, q). It is copied.
    data : Dataset, str, path or tuple of arrays
        Data of the training: its training scenes give the mean light, and it names the classes.
    photons : float
        Budget Φ of the training, whose light was ``photons_per_pixel(x, photons, s)``.
    light : str
        Light law of the masks, from `LIGHT_LAWS`; `LearnedMasks` bring theirs.

    Examples
    --------
    >>> import deepfsi, torch
    >>> rails = torch.rand(1, 5, 64, generator=torch.Generator().manual_seed(0)) / 5
    >>> scanner, classifier = deepfsi.Scanner.from_rails(rails), torch.nn.Linear(5, 10)
    >>> deepfsi.design_of(scanner, classifier, "digits", photons=1e4).masks
    5
    """
    budget = check_budget(photons)
    scenes = as_dataset(data)
    detection = scanner.detection
    with torch.no_grad():
        rails = Rails.of(scanner.masks().stacked.clone())
    shape = tuple(rails.difference.shape)
    device = rails.difference.device
    if len(shape) != 2 or shape[-1] != scenes.pixels:
        raise InputError(
            f"masks of shape {shape} do not fit {scenes.name}: give (masks, {scenes.pixels})"
        )
    light = scanner.masks.law.name if isinstance(scanner.masks, LearnedMasks) else light
    light_law(light).check(rails.stacked)
    training_set = TrainingSet(scenes, device)
    s = training_set.summed_reflectance
    mean = torch.from_numpy(scenes.x_train.mean(axis=0))
    read = rails.masks * detection.width(rails.count)
    noise = find_noise(scanner.noise.name).stands_for or scanner.noise.name
    optics: dict[str, Any] = {"light": light, "noise": noise, **scanner.noise.settings}
    optics |= {"rails": rails.kind, "readout": detection.readout}
    if detection.labels is not None:
        optics["detectors"] = detection.labels
    camera = Camera.load(**optics)
    job = Job(design="custom", masks=rails.masks, photons=budget, camera=camera)
    front = Scanner.from_rails(rails.stacked, detection=detection)
    counts = detection.totals(front.rates(mean.to(rails.difference)))
    info = provenance(job, scenes, device)
    exposure = MaskExposure(
        entry=FixedEntry(),
        rails=rails,
        light=light,
        image_shape=scenes.image_shape,
        detection=detection,
        summed_reflectance=s,
        # the network was trained on counts: these statistics give it counts again
        mean=torch.zeros(read, device=device),
        std=torch.full((read,), 1 / budget, device=device),
        shares=counts / s,
        clicks=Clicks.of(camera, budget),
    )
    design = Design(
        name="custom",
        classes=scenes.classes,
        exposure=exposure,
        classifier=_copy(classifier, read, scenes.answers).to(device),
        info=info,
        values=training_set.values,
        training_scenes=training_set.known,
    )
    del design.info["job"]["training"], design.info["seconds"]  # unknown for a training elsewhere
    characterise(training_set, [job], [design])
    return design


def designs_of(exposure: ExposureTraining, classifiers: Sequence[nn.Module]) -> list[Design]:
    """Designs of jobs that trained side by side, whose masks are fixed now."""
    training_set = exposure.training_set
    with torch.no_grad():
        trained = exposure.finish()
    return [
        Design(
            name=job.design,
            classes=training_set.data.classes,
            exposure=of_job,
            classifier=classifier,
            values=training_set.values,
        )
        for job, of_job, classifier in zip(exposure.jobs, trained, classifiers, strict=True)
    ]


def _copy(classifier: nn.Module, features: int, classes: int) -> OwnClassifier:
    """Copy of a user's module with its import path."""
    if not isinstance(classifier, OwnClassifier):
        return make_custom(classifier, {}, features, classes)
    copied = make_custom(classifier.loaded, {}, features, classes)
    copied.factory = classifier.factory
    copied.arguments = classifier.arguments
    return copied
