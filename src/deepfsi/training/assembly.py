"""Designs from masks and classifiers that a training loop has made, this one or a user's own."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from deepfsi.base.errors import InputError
from deepfsi.base.keywords import plain_keywords
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import check_budget, summed_reflectance
from deepfsi.camera.names import LightLawName
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.designfile.provenance import TrainingScenes
from deepfsi.exposure.fixed import FixedExposure
from deepfsi.exposure.kind import Clicks, TrainedMasks
from deepfsi.exposure.training import ExposureTraining
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import Job
from deepfsi.networks.classifiers import Values
from deepfsi.networks.custom import OwnClassifier, make_custom
from deepfsi.physics.detection import Rails
from deepfsi.physics.laws import LearnedMasks, light_law
from deepfsi.physics.scanner import Scanner
from deepfsi.physics.surroundings import library_defaults
from deepfsi.training.characterisation import characterise, provenance


@plain_keywords()
@library_defaults(grad=True)
def design_of(
    scanner: Scanner,
    classifier: nn.Module,
    data: Source,
    photons: float,
    *,
    light: LightLawName = "column",
) -> Design:
    """Make a design of a scanner and a network that you have trained together.

    Counts at another budget are scaled to that of the training. Raises `InputError` if scanner,
    classifier and data do not fit together, or the masks break their constraint.

    Parameters
    ----------
    scanner : Scanner
        Its masks, without replicas, and its detectors.
    classifier : nn.Module
        From (batch, k) counts of the scanner, m differences y⁺ − y⁻ unless its `detection` says
        otherwise, to (batch, C) logits or (batch, q) standardised values. Copied.
    data : Dataset, str, path or tuple of arrays
        That the training was on: its training scenes give the mean light, its classes their names.
    photons : float
        Budget Φ of the training: photons were ``photons_per_pixel(x, photons, s)``.
    light : str
        Light law that masks obey, one of `LIGHT_LAWS`; that of `LearnedMasks` is their own.

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
    light = scanner.masks.law.name if isinstance(scanner.masks, LearnedMasks) else light
    rails = _rails(scanner, scenes, light)
    s = summed_reflectance(scenes.x_train)
    mean = torch.from_numpy(scenes.x_train.mean(axis=0))
    read = rails.masks * scanner.detection.width(rails.count)
    job = _job(scanner, rails, budget, light)
    front = Scanner.from_rails(rails.stacked, detection=scanner.detection)
    counts = scanner.detection.totals(front.rates(mean.to(rails.difference)))
    info = provenance(job, scenes, rails.device)
    optics = TrainedMasks(
        rails=rails,
        light=light,
        image_shape=scenes.image_shape,
        detection=scanner.detection,
        summed_reflectance=s,
        mean=torch.zeros(read, device=rails.device),
        std=torch.full((read,), 1 / budget, device=rails.device),
        shares=counts / s,
        clicks=Clicks.of(info),
    )
    design = Design(
        name="custom",
        classes=scenes.classes,
        exposure=FixedExposure(optics=optics),
        classifier=_copy(classifier, read, scenes.answers).to(rails.device),
        info=info,
        values=Values.of(scenes),
        training_scenes=TrainingScenes.of(scenes),
    )
    del design.info["job"]["training"], design.info["seconds"]  # not known of a training elsewhere
    characterise(TrainingSet(scenes, rails.device), [job], [design])
    return design


def designs_of(exposure: ExposureTraining, classifiers: Sequence[nn.Module]) -> list[Design]:
    """Designs of jobs that train side by side, of masks that are fixed."""
    training_set = exposure.training_set
    with torch.no_grad():
        trained = exposure.finish()
    return [
        Design(
            name=job.design,
            classes=training_set.data.classes,
            exposure=own,
            classifier=classifier,
            values=training_set.values,
        )
        for job, own, classifier in zip(exposure.jobs, trained, classifiers, strict=True)
    ]


def _job(scanner: Scanner, rails: Rails, photons: float, light: LightLawName) -> Job:
    """Job of a training elsewhere, as far as it is known."""
    detection = scanner.detection
    noise = scanner.noise.facts.stands_for or scanner.noise.name
    optics: dict[str, Any] = {"light": light, "noise": noise, **scanner.noise.settings}
    optics |= {"rails": rails.kind, "readout": detection.readout}
    if detection.labels is not None:
        optics["detectors"] = detection.labels
    camera = Camera.load(**optics)
    return Job(design="custom", masks=rails.masks, photons=photons, camera=camera)


def _rails(scanner: Scanner, data: Dataset, light: LightLawName) -> Rails:
    """Rails of the masks (m, N) of a scanner, or `InputError` if scenes or law forbid them."""
    with torch.no_grad():
        rails = Rails.of(scanner.masks().stacked.clone())
    shape = tuple(rails.difference.shape)
    if len(shape) != 2 or shape[-1] != data.pixels:
        raise InputError(
            f"masks of shape {shape} do not fit {data.name}: give (masks, {data.pixels})"
        )
    light_law(light).check(rails.stacked)
    return rails


def _copy(classifier: nn.Module, features: int, classes: int) -> OwnClassifier:
    """Copy of a user's module, with the import path that it has."""
    if not isinstance(classifier, OwnClassifier):
        return make_custom(classifier, {}, features, classes)
    if classifier.module is None:
        raise InputError("the classifier's code was not run: give its module")
    own = make_custom(classifier.module, {}, features, classes)
    own.factory = classifier.factory
    own.arguments = classifier.arguments
    return own
