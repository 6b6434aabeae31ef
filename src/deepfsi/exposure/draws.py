"""Random draws of a training, order of scenes and noise among them; types of its products.

Products are of bfloat16 where its rounding stays under the noise.
"""

from collections.abc import Sequence
from itertools import groupby

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.camera import find_noise
from deepfsi.jobs import Job
from deepfsi.physics import Readouts, TrainingNoise


class SeedStream:
    """Draws of the jobs of one seed, the same for all of them.

    Shapes: labels (n,).
    """

    rows: Tensor
    """Places (steps, B) of an epoch's scenes."""

    with_mean: Tensor
    """The same and n, the place of the mean scene, (steps, B + 1)."""

    def __init__(
        self, seed: int, replicas: slice, noise: TrainingNoise, labels: Tensor, batch: int
    ) -> None:
        self.replicas = replicas
        self.noise = noise.of_jobs(replicas)
        self.generator = torch.Generator(labels.device).manual_seed(seed)
        self._labels, self.batch = labels, batch

    def shuffle(self) -> None:
        """Draw the order of an epoch's scenes."""
        count = len(self._labels)
        order = torch.randperm(count, generator=self.generator, device=self._labels.device)
        self.follow(order[: count // self.batch * self.batch].view(-1, self.batch))

    def follow(self, rows: Tensor) -> None:
        """Take an epoch's scenes from places (steps, B)."""
        self.rows = rows.to(self._labels.device)
        self.with_mean = functional.pad(self.rows, (0, 1), value=len(self._labels))
        self._ordered = self._labels[self.rows]

    def labels(self, step: int) -> Tensor:
        """Labels (B, R) of a step."""
        return self.repeated(self._ordered[step].unsqueeze(1))

    def normal(self, masks: int) -> Tensor:
        """Normal draws (B, 1, m)."""
        return torch.randn(
            self.batch, 1, masks, generator=self.generator, device=self._labels.device
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

    def products(self, every: Tensor, step: int) -> Tensor:
        """A step's part of products of all scenes and jobs, (n, R or 1, m)."""
        return self.of_jobs(every, 1).index_select(0, self.rows[step])


def seed_streams(
    seeds: Sequence[int], noise: TrainingNoise, labels: Tensor, batch: int
) -> list[SeedStream]:
    """Streams of jobs of these seeds, those of one seed together; others as for `SeedStream`."""
    streams, first = [], 0
    for seed, members in groupby(seeds):
        last = first + len(list(members))
        streams.append(SeedStream(seed, slice(first, last), noise, labels, batch))
        first = last
    return streams


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
    """Types of the products of a job's masks and of its networks."""
    return product_dtype(job.mask_job(), device), network_dtype(job, device)


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
    noise, limit = find_noise(job.noise), 0.0
    if noise.shot:
        limit = BFLOAT16_COUNTS
    elif noise.read_noise:
        limit = job.optics.sigma * BFLOAT16_COUNTS**0.5
    return torch.bfloat16 if fast and counts <= limit else torch.float32
