"""Images seen patch by patch: one Scanner for all patches of an image, a transformer behind it.

The image is cut in square patches. One set of masks, of a patch's size, is applied to every patch,
under `column`: a patch has a detector for each readout. The counts are its embedding. The masks are
thus a vision transformer's patch projection, done by light, and noise is added to its outcome.

A budget Φ is of the whole image, and the patches share it as they share its light: λ = Φ x / s, s
the training set's mean summed reflectance of whole images.
"""

import time
from contextlib import nullcontext
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn import functional

from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Vit
from deepfsi.design.exposure import PatchExposure, cut
from deepfsi.errors import InputError
from deepfsi.optics import codes, constraints, tiles
from deepfsi.optics.budget import BUDGETS, summed_reflectance
from deepfsi.optics.detection import ONE
from deepfsi.optics.features import FeatureNoise, Scale, deviation, feature_statistics
from deepfsi.optics.masks import FixedMasks, LearnedMasks
from deepfsi.optics.rails import Rails
from deepfsi.optics.scanner import Scanner, project
from deepfsi.progress import SILENT, Report
from deepfsi.training.draws import SeedStream
from deepfsi.training.job import BFLOAT16_COUNTS, LearningRate, Precision
from deepfsi.training.learning import Diverged, provenance
from deepfsi.training.loop import descend, parameter_group
from deepfsi.training.training_set import find_device

REVISION = 1
"""Raised whenever a change makes the same job end in another design: old records then expire."""

PatchedDesign = Literal["impulse", "raster", "hadamard", "pca", "deepfsi"]
"""Name of a design that patches can be shown with."""


class PatchTraining(BaseModel):
    """Settings of the training of masks and transformer."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    epochs: int = Field(15, ge=1)
    batch: int = Field(100, ge=2)
    lr: LearningRate = Field(2e-3, description="peak of the one-cycle schedule")
    mask_lr: LearningRate = Field(2e-2, description="the same for masks, relative to their rms")
    decay: float = Field(0.05, ge=0, allow_inf_nan=False, description="of the transformer")
    scale: Scale = Field("common", description="standard deviation of features")
    width: int = Field(64, ge=1)
    depth: int = Field(2, ge=1)
    heads: int = Field(4, ge=1)
    hidden: int = Field(128, ge=1)
    precision: Precision = "auto"


class PatchJob(BaseModel):
    """One design to be trained on patches; masks as many as a patch has pixels, under `column`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    design: PatchedDesign = "deepfsi"
    photons: float = Field(ge=BUDGETS[0], le=BUDGETS[1], description="of the whole image")
    patch: int = Field(8, ge=2, description="side of a patch in pixels")
    seed: int = Field(0, ge=0, lt=2**32)
    training: PatchTraining = PatchTraining()


class Patches:
    """Training images cut in patches, on a device, with what the trainings on them share."""

    def __init__(self, data: Dataset, side: int = 8, device: str = "auto") -> None:
        if len(data.image_shape) != 2:
            raise InputError(f"{data.name} holds no images: patches need two sides")
        self.data, self.side = data, side
        self.device = find_device(device)
        self.summed_reflectance = summed_reflectance(data.x_train)
        self.labels = torch.from_numpy(data.y_train).to(self.device)
        images = torch.from_numpy(data.x_train)
        self.x = cut(images, data.image_shape, side).to(self.device)
        self.mean = self.x.mean(dim=(0, 1))
        self._matrices: dict[str, np.ndarray] = {}

    @cached_property
    def as_scenes(self) -> Dataset:
        """Every training patch as a scene of its own."""
        _, count, pixels = self.x.shape
        x = self.x.reshape(-1, pixels).cpu().numpy()
        return replace(
            self.data,
            x_train=x,
            y_train=np.repeat(self.data.y_train, count),
            x_test=x[:0],
            y_test=self.data.y_test[:0],
            image_shape=(self.side, self.side),
        )

    def matrix(self, design: str) -> np.ndarray:
        """Sensing matrix (m, N) of a fixed design, m = N for all."""
        if design not in self._matrices:
            tiles.check_count(design, self.side**2, self.as_scenes)
            self._matrices[design] = codes.sensing_matrix(design, self.side**2, self.as_scenes)
        return self._matrices[design]

    def masks(self, design: str) -> FixedMasks | LearnedMasks:
        """Masks of a design, on the device; learned ones start from principal components."""
        start = torch.from_numpy(self.matrix("pca" if design == "deepfsi" else design)).float()
        if design == "deepfsi":
            return LearnedMasks(start, "column").to(self.device)
        if design == "raster":  # its scale is what defines it
            return FixedMasks(start.unsqueeze(0)).to(self.device)
        single = codes.DESIGNS[design].single_rail
        rails = constraints.fit(start, "column", "single" if single else "dual")
        return FixedMasks(rails).to(self.device)


def precision(job: PatchJob, patches: Patches) -> torch.dtype:
    """Type of the transformer's products in training; the masks' own are float32 always.

    bfloat16 only on a GPU (a processor is slower with it at this size) and, as everywhere, only
    where its rounding of a patch's counts stays under their noise.
    """
    if job.training.precision != "auto":
        return getattr(torch, job.training.precision)
    gpu = patches.device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    dim = job.photons / patches.x.shape[1] <= BFLOAT16_COUNTS
    return torch.bfloat16 if gpu and dim else torch.float32


def train(patches: Patches, job: PatchJob, report: Report = SILENT) -> Design:
    """Train the transformer of one design, and its masks where they learn.

    Training noise is MLGauss. A seed fixes the order of images, the initial weights and the noise,
    the same for all designs. Parameters as for `learning.train`, of one job.
    """
    began = time.perf_counter()
    settings, labels = job.training, patches.labels
    masks = patches.masks(job.design)
    photons = job.photons / patches.summed_reflectance
    noise = FeatureNoise.of("ml_gauss", [photons], [1.0], [job.seed], labels.device)
    batch = min(settings.batch, len(labels))
    stream = SeedStream(job.seed, slice(0, 1), noise, labels, batch)
    scanner, vit = Scanner(masks, "ml_gauss"), _transformer(patches, job)
    kind = precision(job, patches)
    over = (0, 1) if settings.scale == "each" else (0, 1, 2)

    def loss(step: int) -> Tensor:
        scenes = patches.x[stream.rows[step]] * photons
        counts = scanner(scenes, stream.generator) / photons
        features = counts - project(patches.mean, masks().difference)
        std = deviation(features.square().mean(dim=over), "each")
        with nullcontext() if kind == torch.float32 else torch.autocast(labels.device.type, kind):
            logits = vit(features / std)
        return functional.cross_entropy(logits.float(), stream.labels(step).squeeze(1))

    groups = [parameter_group(vit, settings.lr, settings.decay)]
    if isinstance(masks, LearnedMasks):
        groups.append(parameter_group(masks, settings.mask_lr))
    descend(groups, settings.epochs, len(labels) // batch, stream.shuffle, loss, report)
    numbers = [masks().combined, *vit.parameters()]
    if not all(bool(torch.isfinite(part).all()) for part in numbers):
        raise Diverged(f"training of {job.design} on patches diverged: lower lr and mask_lr")
    design = _design(patches, job, masks, noise, vit.eval())
    seconds = time.perf_counter() - began
    design.info = provenance(job, patches.data, labels.device, seconds)
    return design


def _transformer(patches: Patches, job: PatchJob) -> Vit:
    """Transformer of a job, untrained."""
    _, tokens, pixels = patches.x.shape
    size = job.training.model_dump(include={"width", "depth", "heads", "hidden"})
    generator = torch.Generator(patches.device).manual_seed(job.seed)
    return Vit(pixels, tokens, len(patches.data.classes), **size, generator=generator)


def _design(
    patches: Patches, job: PatchJob, masks: FixedMasks | LearnedMasks, noise: FeatureNoise, vit: Vit
) -> Design:
    """Design of trained masks and transformer, with the statistics of its features."""
    s = patches.summed_reflectance
    with torch.no_grad():
        rails = masks().stacked
        scenes = patches.x.flatten(0, 1)
        statistics = feature_statistics(scenes, masks, noise, job.training.scale, ONE)
    mean, std, counts = (each.squeeze(0) / s for each in statistics)
    return Design(
        name=job.design,
        rails=Rails.of(constraints.check(rails, "column")),
        classifier=vit,
        mean=mean,
        std=std,
        shares=counts * patches.x.shape[1],
        summed_reflectance=s,
        light="column",
        image_shape=patches.data.image_shape,
        classes=patches.data.classes,
        exposure=PatchExposure(patches.side),
    )
