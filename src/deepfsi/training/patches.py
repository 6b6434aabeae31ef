"""Images seen patch by patch: one Scanner for all patches of an image, a transformer behind it.

The image is cut in square patches. One set of masks, of a patch's size, is shown on every patch, in
sequence, with one detector for each patch; the counts are the patches' embeddings. The masks are
thus a vision transformer's patch projection, done by light, and noise is added to its outcome.

A budget Φ is of the whole image, and the patches share it as they share its light: λ = Φ x / s, s
the training set's mean summed reflectance of whole images.
"""

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn import functional

from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design, provenance
from deepfsi.design.classifiers import Vit
from deepfsi.design.patchwise import PatchExposure, cut
from deepfsi.errors import InputError
from deepfsi.optics import codes, constraints
from deepfsi.optics.budget import BUDGETS, summed_reflectance
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.optics.noise import variance
from deepfsi.optics.scanner import Scanner, lit, project
from deepfsi.training.job import BFLOAT16_COUNTS, LearningRate, Precision
from deepfsi.training.training_set import find_device

REVISION = 1
"""Raised whenever a change makes the same job end in another design: old records then expire."""

CHUNK = 1024
"""Images whose patches are multiplied at once outside the steps."""

PatchedDesign = Literal["impulse", "raster", "hadamard", "pca", "deepfsi"]


class PatchTraining(BaseModel):
    """How masks and transformer are trained."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    epochs: int = Field(15, ge=1)
    batch: int = Field(100, ge=2)
    lr: LearningRate = Field(2e-3, description="peak of the one-cycle schedule")
    mask_lr: LearningRate = Field(2e-2, description="the same for masks, relative to their rms")
    decay: float = Field(0.05, ge=0, allow_inf_nan=False, description="of the transformer")
    scale: Literal["each", "common"] = Field("common", description="spread of features")
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
    """Training images cut in patches, on a device, with what the trainings on them share.

    Parameters
    ----------
    data : Dataset
        Images.
    side : int
        Of a patch, pixels.
    device : str
        "auto" (a GPU if there is one), "cpu" or "cuda".

    Raises
    ------
    InputError
        If the data is no images, or these cannot be cut so.
    """

    def __init__(self, data: Dataset, side: int = 8, device: str = "auto") -> None:
        if len(data.image_shape) != 2:
            raise InputError(f"{data.name} holds no images: patches need two sides")
        self.data, self.side = data, side
        self.device = find_device(device)
        self.light = summed_reflectance(data.x_train)
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
            pixels = self.side**2
            codes.check_count(design, pixels, self.as_scenes)
            self._matrices[design] = codes.sensing_matrix(design, pixels, self.as_scenes)
        return self._matrices[design]

    def masks(self, design: str) -> Fixed | Learned:
        """Masks of a design, on the device; learned ones start from principal components."""
        start = torch.from_numpy(self.matrix("pca" if design == "deepfsi" else design)).float()
        masks: Fixed | Learned
        if design == "deepfsi":
            masks = Learned(start, "column")
        elif design == "raster":  # its scale is what defines it
            masks = Fixed(start.unsqueeze(0))
        else:
            single = codes.DESIGNS[design].single_rail
            rails = constraints.fit(start, "column", "single" if single else "dual")
            masks = Fixed(rails)
        return masks.to(self.device)


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


def train(
    patches: Patches, job: PatchJob, progress: Callable[[float], None] | None = None
) -> Design:
    """Train the transformer of one design, and its masks where they learn.

    Training noise is MLGauss. A seed fixes the order of images, the initial weights and the noise,
    the same for all designs.

    Parameters
    ----------
    patches : Patches
    job : PatchJob
    progress : callable, optional
        Called with the share of the work that is done.

    Raises
    ------
    InputError
        If training diverged.
    """
    began = time.perf_counter()
    how, device = job.training, patches.device
    count, tokens, pixels = patches.x.shape
    masks = patches.masks(job.design)
    scanner = Scanner(masks, "ml_gauss")
    vit = Vit(
        pixels,
        tokens,
        len(patches.data.classes),
        how.width,
        how.depth,
        how.heads,
        how.hidden,
        torch.Generator(device).manual_seed(job.seed),
    )
    generator = torch.Generator(device).manual_seed(job.seed)
    groups: list[dict[str, Any]] = [
        {"params": list(vit.parameters()), "lr": how.lr, "weight_decay": how.decay}
    ]
    if isinstance(masks, Learned):
        groups.append({"params": list(masks.parameters()), "lr": how.mask_lr, "weight_decay": 0.0})
    optimiser = torch.optim.AdamW(groups, fused=True)
    batch = min(how.batch, count)
    steps = count // batch
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [group["lr"] for group in groups], total_steps=how.epochs * steps
    )
    photons = job.photons / patches.light
    kind = precision(job, patches)
    tell = progress or (lambda share: None)
    tell(0.0)
    for epoch in range(how.epochs):
        order = torch.randperm(count, generator=generator, device=device)
        for rows in order[: steps * batch].view(steps, batch):
            counts = scanner(patches.x[rows] * photons, generator) / photons
            features = standardise(counts - project(patches.mean, masks()[0]), how.scale)
            with nullcontext() if kind == torch.float32 else torch.autocast(device.type, kind):
                logits = vit(features)
            functional.cross_entropy(logits.float(), patches.labels[rows]).backward()
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
            schedule.step()
        tell((epoch + 1) / how.epochs)
    with torch.no_grad():
        rails = constraints.separate(*masks())
        centre, spread, shares = statistics(patches, masks, photons, how.scale)
    if not all(bool(torch.isfinite(part).all()) for part in [rails, *vit.parameters()]):
        raise InputError(f"training of {job.design} on patches diverged: lower lr and mask_lr")
    return Design(
        name=job.design,
        rails=constraints.check(rails, "column"),
        classifier=vit.eval(),
        mean=centre / patches.light,
        std=spread / patches.light,
        shares=shares * tokens / patches.light,
        summed_reflectance=patches.light,
        light="column",
        image_shape=patches.data.image_shape,
        classes=patches.data.classes,
        exposure=PatchExposure(patches.side),
        info=provenance(job, patches.data, device, time.perf_counter() - began),
    )


def standardise(features: Tensor, scale: str) -> Tensor:
    """Scale centred features (B, P, m) with the spread of their batch."""
    over = (0, 1) if scale == "each" else (0, 1, 2)
    power = features.square().mean(dim=over)
    return features / torch.where(power > 0, power, 1.0).sqrt()


def statistics(
    patches: Patches,
    masks: Fixed | Learned,
    photons: float,
    scale: str,
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and spread of the features over all training patches and their noise, and mean light.

    Each (m,), in units of one fully reflecting pixel's photons, `photons` of them.
    """
    difference, total = masks()
    centre, light = project(patches.mean, difference), project(patches.mean, total)
    power = torch.zeros_like(centre)
    for x in patches.x.split(CHUNK):
        power += (project(x, difference) - centre).square().sum(dim=(0, 1))
    noise = variance(light * photons, lit(difference, total), "ml_gauss") / photons**2
    power = power / (len(patches.x) * patches.x.shape[1]) + noise
    if scale == "common":
        power = power.mean().expand_as(power)
    return centre, torch.where(power > 0, power, 1.0).sqrt(), light
