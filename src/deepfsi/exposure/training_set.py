"""A data set on a device, what the trainings on it share, and the draws of their steps.

Products are of bfloat16 where its rounding stays under the noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.errors import InputError
from deepfsi.camera.detectors import ONE_DETECTOR, DetectorMap
from deepfsi.camera.light import summed_reflectance
from deepfsi.camera.names import LIGHT_LAWS, LightLawName, find_noise
from deepfsi.datasets.dataset import Dataset
from deepfsi.designfile.provenance import TrainingScenes
from deepfsi.jobs.designs import DESIGNS, check_count, count_allowed, sensing_matrix
from deepfsi.jobs.exposures import Exposure
from deepfsi.jobs.job import Job
from deepfsi.physics.detection import Detection
from deepfsi.physics.surroundings import torch_device

Matrices = dict[tuple[str, int, int, tuple[int, ...] | None], np.ndarray]
"""Sensing matrices (m, N) by design, number of masks, seed and detectors."""


def check_classes(values: object, what: str) -> None:
    """Raise `InputError` where scenes have values and `what` is of classes."""
    if values:
        raise InputError(
            f"{what} is of classes, and these are values: use Design.estimate, or `deepfsi "
            "evaluate`"
        )


@dataclass(frozen=True, eq=False)
class Values:
    """Names of q values, and their mean and standard deviation in the training, (q,) each."""

    names: tuple[str, ...]
    mean: Tensor  # (q,)
    std: Tensor  # (q,)

    @classmethod
    def of(cls, data: Dataset) -> "Values | None":
        """Values of the training scenes of a data set; None if scenes have classes."""
        if not data.values:
            return None
        y = torch.from_numpy(data.y_train)
        return cls(data.values, y.mean(dim=0), y.std(dim=0, correction=0))

    @classmethod
    def restored(cls, names: tuple[str, ...], tensors: Mapping[str, Tensor]) -> "Values":
        """Values of a design file, or an error where its tensors are not of these names."""
        mean = tensors["mean"]
        std = tensors["std"]
        if not mean.shape == std.shape == (len(names),) or not bool((std > 0).all()):
            raise ValueError("scales are not those of the values")
        return cls(names, mean, std)

    def estimated(self, outputs: Tensor) -> Tensor:
        """Values (..., q) in their own units, from outputs of a network."""
        return self.mean + self.std * outputs

    def to(self, device: str | torch.device) -> Self:
        """Move to a device."""
        return replace(self, mean=self.mean.to(device), std=self.std.to(device))


class TrainingSet:
    """A data set on a device, with what several trainings on it share."""

    def __init__(
        self, data: Dataset, device: str | torch.device = "auto", matrices: Matrices | None = None
    ) -> None:
        self.data = data
        self.device = torch_device(device)
        self.summed_reflectance = summed_reflectance(data.x_train)
        self.values = Values.of(data)
        self.labels = self.truth_of(data.y_train)
        # a cluster shares arrays read-only, and torch warns of them: `W` copies them
        scenes = torch.from_numpy(np.require(data.x_train, requirements="W"))
        self.full = scenes.to(self.device)
        self.matrices = {} if matrices is None else matrices
        self._centred: dict[tuple[torch.dtype, bool, bytes], Tensor] = {}
        self._views: dict[Exposure, TrainingSet] = {}

    def truth_of(self, labels: np.ndarray) -> Tensor:
        """Classes (n,) of scenes on the device, or their standardised values (n, q)."""
        truth = torch.from_numpy(np.require(labels, requirements="W"))
        if self.values:
            truth = (truth - self.values.mean) / self.values.std
        return truth.to(self.device)

    def of(self, data: Dataset) -> "TrainingSet":
        """Other scenes on the same device."""
        return TrainingSet(data, self.device)

    def view(self, exposure: Exposure) -> "TrainingSet":
        """The scenes as the masks of an exposure see them."""
        if exposure not in self._views:
            scenes = exposure.view(self.data)
            self._views[exposure] = self if scenes is self.data else self.of(scenes)
        return self._views[exposure]

    @cached_property
    def known(self) -> TrainingScenes:
        """What designs keep of its scenes."""
        return TrainingScenes.of(self.data)

    @cached_property
    def varying(self) -> Tensor:
        """Which pixels (N,) differ anywhere in the training set; the first if none does."""
        varying = self.full.amin(dim=0) != self.full.amax(dim=0)
        varying[0] |= not varying.any()
        return varying

    def pixels(self, light: LightLawName) -> Tensor:
        """Which pixels (N,) learned masks may light."""
        # The light of a pixel that never varies is noise and no information: masks leave it dark,
        # except under a law that lights all pixels
        return torch.ones_like(self.varying) if LIGHT_LAWS[light].lights_all else self.varying

    def centred(self, pixels: Tensor, kind: torch.dtype, detection: Detection) -> Tensor:
        """Pixels (N,) of the training scenes, less their mean, and the mean as the last row."""
        # A mask's product with a scene is the sum of its products with this row and the last one.
        # Centred scenes lose little in bfloat16. A pixel that never varies is exactly 0, so that it
        # moves no mask through rounding
        key = (kind, bool(pixels.all()), detection.key)
        if key not in self._centred:
            mean = torch.where(self.varying, self.full.mean(dim=0), self.full[0])
            seen = detection.of_pixels(pixels)
            centred = torch.cat([self.full - mean, mean.unsqueeze(0)])
            self._centred[key] = seen.arrange(centred[:, pixels]).to(kind)
        return self._centred[key]

    @cached_property
    def class_weights(self) -> Tensor:
        """Weights (C,) of scenes by class that make classes count the same; their mean is 1."""
        sizes = torch.bincount(self.labels, minlength=len(self.data.classes)).float()
        present = (sizes > 0).sum()
        return len(self.labels) / (present * sizes.clamp(min=1))

    def prepare(self, name: str) -> None:
        """Compute the matrix that the trainings of a design share, once for all processes."""
        if DESIGNS[name].is_made_at_once(self.data.pixels):
            self.matrix(name, 1, 0)

    def matrix(
        self, name: str, masks: int, seed: int, detectors: DetectorMap = ONE_DETECTOR
    ) -> np.ndarray:
        """Sensing matrix of a fixed design; principal components are computed once for all m.

        Parameters as for `sensing_matrix`.
        """
        check_count(name, masks, self.data, detectors)
        _, most = count_allowed(name, self.data, detectors)
        facts = DESIGNS[name]
        count = most if facts.is_made_at_once(most) else masks
        key = (name, count, seed if facts.seeded else 0, detectors.cells)
        if key not in self.matrices:
            self.matrices[key] = sensing_matrix(name, count, self.data, seed, detectors=detectors)
        return self.matrices[key][:masks]


BFLOAT16_COUNTS = 2.0**14
"""Largest share of the budget a readout may have for bfloat16 products in training, Φ / readouts.

Rounding to 8 bits is wrong by at most 2⁻⁹ of the count, √2¹⁴ · 2⁻⁹ = 1/4 of its photon noise.
"""

BFLOAT16_WIDTH = 512
"""Units of the widest hidden layer from which a processor is faster with bfloat16 networks.

In float32 an epoch with layers of 512 and 256 takes 1.5 times as long, with 256 and 128 as long,
and with 40 and 128 eight tenths as long (`benchmarks/networks.py`).
"""


def product_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of learned masks: bfloat16 where that stays under the readout noise."""
    if job.training.precision == "auto" and not job.exposure.allow_bf16:
        return torch.float32
    return _rounded(job, device)


def network_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of the networks in training: bfloat16 for wide ones on a processor."""
    wide = max(job.training.hidden, default=0) >= BFLOAT16_WIDTH
    if not job.exposure.allow_bf16_networks(device.type, wide) or job.training.is_custom:
        return torch.float32
    return _rounded(job, device)


def _rounded(job: Job, device: torch.device) -> torch.dtype:
    """Type whose rounding stays under the readout noise, or the type that the job asks for."""
    # See `BFLOAT16_COUNTS`. Read noise of σ counts stands in for √count under gaussian noise
    if job.training.precision != "auto":
        return getattr(torch, job.training.precision)
    fast = (
        torch.cuda.is_bf16_supported(including_emulation=False)
        if device.type == "cuda"
        else device.type == "cpu" and torch.cpu.get_capabilities().get("avx512_bf16", False)
    )
    readouts = job.masks * (2 if job.optics.rails == "dual" else 1)
    counts = job.exposure.highest(job.photons) / readouts
    noise = find_noise(job.noise)
    limit = 0.0
    if noise.shot:
        limit = BFLOAT16_COUNTS
    elif noise.read_noise:
        limit = job.optics.sigma * BFLOAT16_COUNTS**0.5
    return torch.bfloat16 if fast and counts <= limit else torch.float32
