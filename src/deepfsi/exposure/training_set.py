"""A data set on a device, what the trainings on it share, and the draws of their steps.

Products are of bfloat16 where its rounding stays under the noise.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import groupby

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.camera import (
    LIGHT_LAWS,
    ONE_DETECTOR,
    DetectorMap,
    LightLawName,
    find_noise,
    summed_reflectance,
)
from deepfsi.datasets import Dataset
from deepfsi.designfile import TrainingScenes
from deepfsi.jobs import (
    DESIGNS,
    Exposure,
    Job,
    check_count,
    count_allowed,
    sensing_matrix,
)
from deepfsi.networks.values import Values
from deepfsi.physics import Detection, Readouts, TrainingNoise, torch_device

Matrices = dict[tuple[str, int, int, tuple[int, ...] | None], np.ndarray]
"""Sensing matrices (m, N) by design, number of masks, seed and detectors."""


class TrainingSet:
    """A data set on a device, with what several trainings on it share.

    Parameters
    ----------
    data : Dataset
    device : str or torch.device
    matrices : dict, optional
        Sensing matrices that were made before, which is added to.
    """

    def __init__(
        self, data: Dataset, device: str | torch.device = "auto", matrices: Matrices | None = None
    ) -> None:
        self.data = data
        self.device = torch_device(device)
        self.summed_reflectance = summed_reflectance(data.x_train)
        self.values = Values.of(data)
        # (n,) classes, or (n, q) standardised values
        truth = torch.from_numpy(np.require(data.y_train, requirements="W"))
        self.labels = (self.values.standardised(truth) if self.values else truth).to(self.device)
        x = np.require(data.x_train, requirements="W")  # a cluster shares arrays read-only
        self.full = torch.from_numpy(x).to(self.device)
        self.matrices = {} if matrices is None else matrices
        self._centred: dict[tuple[torch.dtype, bool, bytes], Tensor] = {}
        self._views: dict[Exposure, TrainingSet] = {}

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
    def scenes(self) -> TrainingScenes:
        """Hashes of its scenes, which designs keep."""
        return TrainingScenes.of(self.data)

    @cached_property
    def varying(self) -> Tensor:
        """Which pixels (N,) differ anywhere in the training set; the first if none does."""
        varying = (self.full != self.full[0]).any(dim=0)
        varying[0] |= not varying.any()
        return varying

    def pixels(self, light: LightLawName) -> Tensor:
        """Which pixels (N,) learned masks may light."""
        # The light of one that never varies is noise and no information, so it stays dark, except
        # on two arms, where what one does not get the other does
        return torch.ones_like(self.varying) if LIGHT_LAWS[light].arms == 2 else self.varying

    def centred(self, pixels: Tensor, kind: torch.dtype, detection: Detection) -> Tensor:
        """Pixels (N,) of the training scenes, less their mean, and the mean as the last row."""
        # The products of the last row with the masks, added to those of a scene, give the scene's
        # own; centred, little is lost in bfloat16. Exactly 0 where a pixel never varies, so that it
        # moves no mask through rounding. Arranged by the detectors that see them
        key = (kind, bool(pixels.all()), detection.key)
        if key not in self._centred:
            mean = torch.where(self.varying, self.full.mean(dim=0), self.full[0])
            centred = torch.cat([self.full - mean, mean.unsqueeze(0)])
            arranged = detection.of_pixels(pixels).arrange(centred[:, pixels])
            self._centred[key] = arranged.to(kind)
        return self._centred[key]

    @cached_property
    def class_weights(self) -> Tensor:
        """Weight (C,) of each class's scenes with which all classes count alike; 1 in the mean."""
        sizes = torch.bincount(self.labels, minlength=len(self.data.classes)).float()
        present = (sizes > 0).sum()
        return len(self.labels) / (present * sizes.clamp(min=1))

    def prepare(self, name: str) -> None:
        """Compute what the trainings of a design share, so that processes need not each do it."""
        if DESIGNS[name].is_made_whole(self.data.pixels):
            self.matrix(name, 1, 0)

    def matrix(
        self, name: str, masks: int, seed: int, detectors: DetectorMap = ONE_DETECTOR
    ) -> np.ndarray:
        """Sensing matrix of a fixed design; principal components are computed once for all m."""
        # Parameters as for `sensing_matrix`
        check_count(name, masks, self.data, detectors)
        _, most = count_allowed(name, self.data, detectors)
        code = DESIGNS[name]
        whole = most if code.is_made_whole(most) else masks
        key = (name, whole, seed if code.seeded else 0, detectors.cells)
        if key not in self.matrices:
            self.matrices[key] = sensing_matrix(name, whole, self.data, seed, detectors=detectors)
        return self.matrices[key][:masks]


class SeedStream:
    """Draws of the jobs of one seed, the same for all of them.

    Shapes: labels (n,).
    """

    order: Tensor
    """Places (steps, B) of an epoch's scenes."""

    rows: Tensor
    """Those of a step, (B,)."""

    with_mean: Tensor
    """The same and n, the place of the mean scene, (B + 1,)."""

    def __init__(
        self, seed: int, replicas: slice, noise: TrainingNoise, labels: Tensor, batch: int
    ) -> None:
        self.replicas = replicas
        self.noise = noise
        self.generator = torch.Generator(labels.device).manual_seed(seed)
        self._labels = labels
        self.batch = batch

    def shuffle(self) -> None:
        """Draw the order of an epoch's scenes."""
        count = len(self._labels)
        order = torch.randperm(count, generator=self.generator, device=self._labels.device)
        self.follow(order[: count // self.batch * self.batch].view(-1, self.batch))

    def follow(self, rows: Tensor) -> None:
        """Take an epoch's scenes from places (steps, B)."""
        self.order = rows.to(self._labels.device)
        self._with_mean = functional.pad(self.order, (0, 1), value=len(self._labels))
        self._ordered = self._labels[self.order]

    def gather(self, step: int) -> Tensor:
        """Go to the scenes of a step: their labels (B, R)."""
        self.rows = self.order[step]
        self.with_mean = self._with_mean[step]
        return self.repeated(self._ordered[step].unsqueeze(1))

    def normal(self, count: int) -> Tensor:
        """Normal draws (B, 1, count)."""
        return torch.randn(
            self.batch, 1, count, generator=self.generator, device=self._labels.device
        )

    def exposures(self, span: float, chances: Tensor) -> tuple[Tensor, Tensor]:
        """Draw budgets, over the lowest, and numbers of masks shown, each (B, 1, 1)."""
        uniform = torch.rand(self.batch, 1, 1, generator=self.generator, device=self._labels.device)
        shown = 1 + torch.multinomial(chances, self.batch, True, generator=self.generator)
        return span**uniform, shown.view(-1, 1, 1)

    def repeated(self, shared: Tensor) -> Tensor:
        """Tensor (B, R, …) of what is the same for all jobs, (B, 1, …)."""
        return shared.expand(-1, self.replicas.stop - self.replicas.start, *shared.shape[2:])

    def of_jobs(self, every: Tensor, axis: int = 0) -> Tensor:
        """Part of these jobs in a tensor of all, which has R or 1 of them along an axis."""
        count = self.replicas.stop - self.replicas.start
        if every.shape[axis] in (1, count):
            return every
        return every.narrow(axis, self.replicas.start, count)

    def readouts(self, every: Readouts) -> Readouts:
        """Readouts of the masks of these jobs among those of all, (2, R or 1, m)."""
        return Readouts(*(self.of_jobs(one, 1) for one in every))

    def products(self, every: Tensor) -> Tensor:
        """The step's part of products of all scenes and jobs, (n, R or 1, m)."""
        return self.of_jobs(every, 1).index_select(0, self.rows)


class Draws:
    """Scenes and random numbers of the steps of R jobs; those of one seed share theirs.

    Parameters
    ----------
    seeds : sequence of int
        Of each job, those of one seed one after another.
    noise : TrainingNoise
        Of all jobs.
    labels : tensor, shape (n,) or (n, q)
    batch : int
        B, scenes of a step.
    """

    def __init__(
        self, seeds: Sequence[int], noise: TrainingNoise, labels: Tensor, batch: int
    ) -> None:
        self.steps = len(labels) // batch
        self.batch = batch
        self.streams: list[SeedStream] = []
        first = 0
        for seed, members in groupby(seeds):
            jobs = slice(first, first + len(list(members)))
            self.streams.append(
                SeedStream(seed, jobs, noise=noise.of_jobs(jobs), labels=labels, batch=batch)
            )
            first = jobs.stop

    def shuffle(self) -> None:
        """Draw the order of an epoch's scenes, for each seed."""
        for stream in self.streams:
            stream.shuffle()

    def gather(self, step: int) -> Tensor:
        """Go to the scenes of a step of the epoch: their labels (B, R) or values (B, R, q)."""
        return self.side_by_side(lambda stream: stream.gather(step))

    def side_by_side(self, of_seed: Callable[[SeedStream], Tensor]) -> Tensor:
        """Tensor (B, R, …) of all jobs, of those (B, R_i, …) of each seed."""
        return side_by_side([of_seed(stream) for stream in self.streams])


def side_by_side(parts: list[Tensor]) -> Tensor:
    """Replicas (B, R_i, …) of several seeds as one (B, R, …)."""
    return torch.cat(parts, dim=1) if len(parts) > 1 else parts[0]


BFLOAT16_COUNTS = 2.0**14
"""Largest share of the budget a readout may have for bfloat16 products in training, Φ / readouts.

Rounding to 8 bits is wrong by at most 2⁻⁹ of the count, √2¹⁴ · 2⁻⁹ = 1/4 of its photon noise.
"""

BFLOAT16_WIDTH = 512
"""Units of the widest hidden layer from which a processor is faster with bfloat16 networks.

In float32 an epoch with layers of 512 and 256 takes 1.5 times as long, with 256 and 128 as long,
and with 40 and 128 eight tenths as long (`benchmarks/networks.py`).
"""


def dtypes(job: Job, device: torch.device) -> tuple[torch.dtype, torch.dtype]:
    """Types of the products of a job's masks and of its networks.

    Parameters
    ----------
    job : Job
    device : torch.device
    """
    return product_dtype(job.mask_job(), device), network_dtype(job, device)


def product_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of learned masks: bfloat16 where that stays under the readout noise."""
    if job.training.precision == "auto" and not job.exposure.allow_bf16:
        return torch.float32
    return _rounded(job, device)


def network_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of the networks in training: bfloat16 for wide ones on a processor.

    Parameters
    ----------
    job : Job
    device : torch.device
    """
    wide = max(job.training.hidden, default=0) >= BFLOAT16_WIDTH
    if not job.exposure.allow_bf16_networks(device.type, wide) or job.training.is_custom:
        return torch.float32
    return _rounded(job, device)


def _rounded(job: Job, device: torch.device) -> torch.dtype:
    """Type whose rounding stays under the readout noise, unless one was asked for."""
    # See `BFLOAT16_COUNTS`. Read noise of σ counts stands in for √count under gaussian noise. The
    # light of all masks may come to the first of nested ones, and with looks to a single readout
    if job.training.precision != "auto":
        return getattr(torch, job.training.precision)
    fast = (
        torch.cuda.is_bf16_supported(including_emulation=False)
        if device.type == "cuda"
        else device.type == "cpu" and torch.cpu.get_capabilities().get("avx512_bf16", False)
    )
    readouts = job.exposure.min_lit_masks(job.masks) * (2 if job.optics.rails == "dual" else 1)
    counts = job.exposure.highest(job.photons) / readouts
    noise = find_noise(job.noise)
    limit = 0.0
    if noise.shot:
        limit = BFLOAT16_COUNTS
    elif noise.read_noise:
        limit = job.optics.sigma * BFLOAT16_COUNTS**0.5
    return torch.bfloat16 if fast and counts <= limit else torch.float32
