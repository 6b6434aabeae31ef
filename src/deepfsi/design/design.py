"""A finished design: masks, classifier and provenance, in one file that holds no code."""

import os
from dataclasses import dataclass, field, replace
from math import prod
from pathlib import Path
from typing import Any, Self, cast, get_args

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.adaptive.exposure import AdaptiveExposure
from deepfsi.base.errors import InputError
from deepfsi.base.files import DESIGN_ENDINGS, check_ending, write_atomically
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import check_budget
from deepfsi.camera.names import NoiseName
from deepfsi.design.file import fields_of, file_of
from deepfsi.design.networks import Given, OwnClassifier, with_code
from deepfsi.designfile.design_file import DesignFile, Temperatures, find_design
from deepfsi.designfile.misfit import UsualMisfit
from deepfsi.designfile.provenance import TrainingScenes, trained_camera
from deepfsi.designfile.view_test import SceneModel, SceneReadouts
from deepfsi.exposure.kind import (
    EXPOSED_AT_ONCE,
    Answer,
    ExposureKind,
    Exposures,
    MaskExposure,
    temperatures_at,
)
from deepfsi.exposure.training_set import Values, check_classes
from deepfsi.physics.detection import Rails
from deepfsi.physics.noise import NoiseFunction, noise_of
from deepfsi.physics.scanner import Scanner
from deepfsi.physics.surroundings import library_defaults, torch_device


@dataclass(repr=False)
class Design:
    """Masks and the classifier that reads them, or the prior of scenes that makes masks.

    Attributes
    ----------
    name : str
        Name of the kind of design, a key of `jobs.designs.DESIGNS`.
    classes : tuple of str
        Class names; empty for a design that estimates values.
    exposure : ExposureKind
        Masks with their light law, detectors and statistics, or the prior of adaptive masks.
    classifier : nn.Module or None
        Maps the inputs that the exposure makes from features (..., m) to logits (..., C). None for
        adaptive masks, whose posterior answers.
    info : dict
        Provenance in JSON types: training, data and versions.
    usual_misfit, scene_model : UsualMisfit and SceneModel, optional
        Misfit and model of the training's scenes, against which `consistency` and the view of a
        camera's runs are tested; those of adaptive masks are in `exposure`.
    temperatures : Temperatures, optional
        Divisors of the logits at each budget, which calibrate the probabilities.
    values : Values, optional
        Names, mean and spread of the values that a design estimates in place of classes.
    training_scenes : TrainingScenes, optional
        What tells the training scenes from new ones. None in files of older versions.

    Examples
    --------
    >>> import deepfsi
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn("digits", camera="paper", photons=1e4, masks=6, training=few)
    >>> design.classify(np.full((2, 6), 50), photons=1e4).shape  # counts of both rails
    (10,)
    """

    name: str
    classes: tuple[str, ...]
    exposure: ExposureKind
    classifier: nn.Module | None = None
    info: dict[str, Any] = field(default_factory=dict)
    usual_misfit: UsualMisfit | None = None
    scene_model: SceneModel | None = None
    temperatures: Temperatures | None = None
    values: Values | None = None
    training_scenes: TrainingScenes | None = None

    def __repr__(self) -> str:
        budget = self.info.get("job", {}).get("photons")
        trained = f", learned at {budget:g} photons" if budget else ""
        answers = ", ".join(self.values.names) if self.values else f"{len(self.classes)} classes"
        words = [f"<Design {self.name}: {self.exposure.title}"]
        if self.classifier is not None:
            words.append(getattr(self.classifier, "title", type(self.classifier).__name__))
        return f"{', '.join([*words, answers])}{trained}>"

    # What it shows

    @property
    def mask_exposure(self) -> MaskExposure:
        """The exposure, or `InputError` for adaptive masks."""
        self.exposure.check("masks")
        return cast(MaskExposure, self.exposure)

    @property
    def prior_exposure(self) -> AdaptiveExposure:
        """The exposure of a design of adaptive masks."""
        assert isinstance(self.exposure, AdaptiveExposure), "its masks are known before"
        return self.exposure

    @property
    def rails(self) -> Rails:
        """Rails of the masks; `stacked` (2 or 1, m, N) has the positive ones first."""
        return self.mask_exposure.rails

    @property
    def summed_reflectance(self) -> float:
        """s, the training scenes' mean summed reflectance; λ = Φ x / s."""
        return self.exposure.summed_reflectance

    @property
    def image_shape(self) -> tuple[int, ...]:
        """Shape of a scene."""
        return self.exposure.image_shape

    @property
    def matrix(self) -> np.ndarray:
        """Sensing matrix M (m, N), float32: the share of each pixel's photons, signed by rail."""
        return self.rails.difference.cpu().numpy()

    @property
    def masks(self) -> int:
        """m, number of masks; adaptive masks have one for each look."""
        return self.exposure.count

    @property
    def counts_shape(self) -> tuple[int, ...]:
        """Shape ([2,] m [, D]) of the counts that `classify` takes for one exposure."""
        return self.mask_exposure.counts_shape

    @property
    def camera(self) -> Camera:
        """The camera of the training, as the file keeps it."""
        camera = trained_camera(self.info)
        if camera is None:
            raise InputError("this design does not say its camera: train it again")
        return camera

    # Exposing

    def scanner(
        self, noise: str | NoiseFunction = "poisson", sigma: float = 1.0, dark: float = 0.0
    ) -> Scanner:
        """Optical front end with your noise; parameters as for `Scanner.from_rails`."""
        return self.mask_exposure.scanner(noise, sigma, dark)

    @library_defaults()
    def exposures(self, scenes: Tensor, camera: Camera) -> Exposures:
        """Exposures of scenes (n, N) by a camera: a function from a budget to answers and light.

        Raises `InputError` if the design cannot be tested under the camera's noise.
        """
        return self.exposure.exposures(scenes, camera, self.answer)

    @library_defaults(grad=False)
    def expose(
        self, x: Any, photons: float, seed: int = 0, camera: Camera | None = None
    ) -> np.ndarray:
        """Counts (..., [P,] [2,] m [, D]) of a simulated exposure of each scene, for `classify`.

        Raises `InputError` for adaptive masks, which `deepfsi.predict` exposes.

        Parameters
        ----------
        x : array or tensor, shape (..., H, W) or (..., N)
            Reflectance, in [0, 1].
        photons : float
            Budget Φ.
        seed : int
            Seed of the noise.
        camera : Camera, optional
            Camera whose noise it is. Default: the design's.
        """
        exposure = self.mask_exposure
        scenes, lead = self._scenes(x)
        budget = check_budget(photons)
        if camera is None and self.camera.noise_name not in get_args(NoiseName):
            raise InputError(
                f"this design is for {self.camera.noise_name} noise, code of its maker's that a "
                "file does not run: use deepfsi.predict or evaluate with `noise`"
            )
        scanner = exposure.scanner(noise_of(camera or self.camera))
        generator = torch.Generator(exposure.device).manual_seed(seed)
        batches = []
        for batch in scenes.split(EXPOSED_AT_ONCE):
            rates = exposure.placed(exposure.rates(scanner, batch), generator)
            batches.append(scanner.read(rates * budget, generator))
        counts = torch.cat(batches)
        return counts.view(*lead, *exposure.part_axis, *self.counts_shape).cpu().numpy()

    def _scenes(self, x: Any) -> tuple[Tensor, tuple[int, ...]]:
        """Reflectances (n, N) of scenes (..., H, W) or (..., N), checked, and their lead (...)."""
        scenes = torch.as_tensor(x).detach().cpu()
        shape = self.image_shape
        pixels = prod(shape)
        axes = len(shape) if tuple(scenes.shape[-len(shape) :]) == shape else 1
        if scenes.numel() == 0 or prod(scenes.shape[-axes:]) != pixels:
            raise InputError(
                f"scenes of shape {tuple(scenes.shape)} do not fit the design: give (..., "
                f"{', '.join(map(str, shape))}) or (..., {pixels})"
            )
        scenes = scenes.float()
        if not bool(((scenes >= 0) & (scenes <= 1)).all()):
            raise InputError("scenes are reflectance: give numbers in [0, 1]")
        return scenes.reshape(-1, pixels), tuple(scenes.shape[:-axes])

    # Answering

    @library_defaults()
    def answer(self, features: Tensor, photons: Tensor | float) -> Answer:
        """Answer to features (..., k) over the budget, at budgets (..., 1) or one for all."""
        exposure = self.mask_exposure
        assert self.classifier is not None
        logits = self.classifier(exposure.inputs(features, photons))
        temperature: Tensor | float = 1.0
        if self.temperatures is not None:
            budget = torch.as_tensor(photons).to(features)
            if exposure.part_axis and budget.ndim > 1:  # all parts have the budget of their scene
                budget = budget[..., 0, :]
            temperature = temperatures_at(self.temperatures, 0, budget)
        return Answer(logits, (logits / temperature).softmax(dim=-1), logits.argmax(dim=-1))

    @library_defaults(grad=False)
    def classify(self, counts: Any, photons: Any) -> np.ndarray:
        """Class probabilities (..., C) of exposures.

        Parameters
        ----------
        counts : array, shape (..., 2, m) for dual-rail designs, (..., m) for single-rail ones
            Counts of each readout, positive rails first. A dark rail reads 0. D detectors add a
            last axis, (..., 2, m, D) or (..., m, D). P parts of a scene that have their own
            detectors add an axis before, (..., P, 2, m).
        photons : float or array, shape (...)
            Budget Φ of each exposure, or an estimate, for instance from an all-ON frame.

        Raises
        ------
        InputError
            If shapes do not match the design, counts are not finite or the budget is not above 0.
        """
        check_classes(self.values, "classify")
        return self.answer(*self._observed(counts, photons)).probabilities.cpu().numpy()

    @library_defaults(grad=False)
    def estimate(self, counts: Any, photons: Any) -> np.ndarray:
        """Values (..., q) of exposures, in the units of the training data.

        Parameters and errors as for `classify`; a design that answers classes is refused, too.
        """
        if self.values is None:
            raise InputError("this design answers classes and estimates no values: use classify")
        answer = self.answer(*self._observed(counts, photons))
        return self.values.estimated(answer.logits).cpu().numpy()

    def _observed(self, counts: Any, photons: Any) -> tuple[Tensor, Tensor]:
        """Features over the budget, and budgets, checked; parameters of `classify`."""
        exposure = self.mask_exposure
        read, budget = _check_readouts(counts, photons, self.counts_shape, exposure.part_axis)
        clicks = exposure.clicks
        if clicks is not None and bool((read > clicks.gates).any() | (read < 0).any()):
            raise InputError(
                f"this design reads detectors that click at most {clicks.gates} times in a frame, "
                f"and a readout has {float(read.max()):g} counts: give clicks from 0 to "
                f"{clicks.gates}"
            )
        device = exposure.device
        budget = budget.to(device)
        return exposure.features(read.to(device), budget), budget

    @library_defaults()
    def consistency(
        self, counts: Any, photons: float, background: Any = 0.0, all_on: Any = None
    ) -> np.ndarray:
        """p-values (...) of exposures: small where counts do not look like the training's.

        1 sound scene in 200 has less than 0.005.

        Parameters
        ----------
        counts : array
            As for `classify`, less the background.
        photons : float
            Budget Φ of each exposure.
        background : float or array, broadcastable to the counts of an exposure
            Counts that were subtracted from each readout, or their variance beyond that of the
            scene's photons. Default: 0.
        all_on : array, shape (...), optional
            Counts of an all-ON frame as long as the exposure, less its background.

        Raises
        ------
        InputError
            If shapes do not match, or the design has no usual misfit: it had fewer than 20 training
            scenes of a class, or counts other than photons of steady light.
        """
        self.exposure.check("comparison")
        if self.usual_misfit is None or self.scene_model is None:
            raise InputError(
                "no usual misfit is held: it takes photons of steady light that are counted, and "
                "20 training scenes of each class"
            )
        read, _ = _check_readouts(counts, check_budget(photons), self.counts_shape)
        exposures = read.shape[: -len(self.counts_shape)]
        noise = np.broadcast_to(np.asarray(background, dtype=float), self.counts_shape)
        flat = read.double().numpy().reshape(-1, *self.counts_shape)
        rows = self.mask_exposure.scene_readouts(flat, photons, noise)
        model = self.scene_model
        lights = [model.light(rows, self.usual_misfit.light[-1])]
        if all_on is not None:
            gain = photons / self.summed_reflectance
            frame = SceneReadouts.all_on(np.ravel(all_on), gain, 0.0, model.means.shape[1])
            lights.append(model.light(frame, self.usual_misfit.light[0]))
        p_values = self.usual_misfit.p_values(model.misfit(rows), 1, photons, *lights)
        return p_values.reshape(exposures)

    def readouts(self, rails: np.ndarray) -> np.ndarray:
        """Counts (..., rails, m [, D]) of every rail, in the shape that `classify` takes."""
        return rails if self.rails.count == 2 else rails.squeeze(-1 - len(self.counts_shape))

    def to(self, device: str | torch.device) -> Self:
        """Move to a device, such as ``"cuda:1"``; returns self."""
        device = torch_device(device)
        self.exposure = self.exposure.to(device)
        self.classifier = self.classifier and self.classifier.to(device)
        self.values = self.values and self.values.to(device)
        return self  # the models hold NumPy arrays, and stay

    def quantised(self, levels: int) -> "Design":
        """The design as a device with these grey levels shows it, dark included (paper: 769).

        Classifier and statistics stay. Train with the camera's `levels` to learn for the device.
        """
        return replace(self, exposure=self.exposure.quantised(levels), usual_misfit=None)

    def as_shown(self, rails: np.ndarray, image_shape: tuple[int, ...], dimmed: float) -> "Design":
        """The design as a device's patterns realise it, with rails (2 or 1, m, N) and cells.

        A device that passes only the share `dimmed` of the light makes features smaller; the
        statistics that scale them follow. Parameters as for `Patterns.realised`.
        """
        self.exposure.check("frames")
        if self.mask_exposure.clicks is not None and dimmed != 1:
            raise InputError(
                f"the patterns pass {dimmed:.3g} of the design's light, and clicks are not in "
                "proportion to it: learn a design under a light law of the device"
            )
        shape = tuple(self.rails.stacked.shape)
        if (rails.shape, image_shape) != (shape, self.image_shape):
            raise InputError(
                f"patterns of shape {rails.shape} and cells {image_shape} are not of this design, "
                f"of shape {shape} and cells {self.image_shape}: export it with `deepfsi dmd "
                "export`"
            )
        realised = Rails.of(torch.from_numpy(rails).to(self.rails.difference))
        return replace(
            self,
            exposure=self.mask_exposure.as_shown(realised, dimmed),
            temperatures=self.temperatures and self.temperatures.scaled(1 / dimmed),
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write one safetensors file, all or nothing; its name ends in ``.safetensors``.

        Raises `InputError` if the classifier cannot be described.
        """
        check_ending(path, DESIGN_ENDINGS)
        return write_atomically(path, file_of(self).to_bytes())

    @classmethod
    @library_defaults()
    def load(
        cls,
        path: str | os.PathLike[str],
        device: str | torch.device = "cpu",
        *,
        trust: bool = False,
        classifier: Given | None = None,
    ) -> "Design":
        """Read a design file. Code that its maker wrote runs only if you say so.

        Without `trust` or `classifier`, a design with a classifier of its maker's has masks only.

        Parameters
        ----------
        trust : bool
            Import and run the factory that the file names, if its classifier has one.
        classifier : nn.Module, callable or str, optional
            A module, factory or import path that makes the classifier instead.

        Raises
        ------
        InputError
            If the file is no whole design of this schema, or its classifier cannot be imported or
            is not the one given.
        """
        design = cls(**fields_of(DesignFile.read(path)))
        network = design.classifier
        if classifier is not None and not isinstance(network, OwnClassifier):
            raise InputError(f"{path} holds its classifier: leave `classifier` out")
        if isinstance(network, OwnClassifier) and (trust or classifier is not None):
            inputs = design.mask_exposure.input_count
            answers = len(design.values.names if design.values else design.classes)
            code = classifier or network.factory
            design.classifier = with_code(network, code, inputs, answers)
        return design.to(device)


def load_design(
    path: str | os.PathLike[str], device: str | torch.device = "cpu", *, trust: bool = False
) -> Design:
    """Open a design file, or a published design by its name, ``"dmd-mnist"`` for example.

    Other parameters as for `Design.load`. Adaptive masks are computed on the processor.

    Examples
    --------
    >>> import deepfsi, tempfile
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=6, training=few)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     deepfsi.load_design(design.save(f"{folder}/d.safetensors")).masks
    6
    """
    return Design.load(find_design(path), device, trust=trust)


def _check_readouts(
    counts: Any, photons: Any, readouts: tuple[int, ...], parts: tuple[int, ...] = ()
) -> tuple[Tensor, Tensor]:
    """Counts (..., *parts, *readouts) and budgets (..., 1), checked."""
    # copied: torch warns of arrays that are read-only
    arrays = [np.asarray(values, np.float32).copy() for values in (counts, photons)]
    read, budget = map(torch.from_numpy, arrays)
    shape = (*parts, *readouts)
    if tuple(read.shape[-len(shape) :]) != shape:
        raise InputError(
            f"counts of shape {tuple(read.shape)} do not fit this design: give (..., "
            f"{', '.join(map(str, shape))})"
        )
    if not bool(read.isfinite().all() and (budget.isfinite() & (budget > 0)).all()):
        raise InputError("counts must be finite, and photons finite and above 0")
    if budget.ndim:
        budget = budget.reshape(*budget.shape, *(1 for _ in parts))
    exposures = read.shape[: -len(readouts)]
    try:
        return read, budget.expand(exposures).unsqueeze(-1)
    except RuntimeError:
        raise InputError(
            f"photons of shape {np.shape(photons)} do not fit counts of {tuple(exposures)} "
            "exposures: give one budget, or one for each"
        ) from None
