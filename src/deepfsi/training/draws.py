"""Random draws of a training: order of scenes, noise, budgets and numbers of masks."""

from collections.abc import Sequence
from itertools import groupby

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.optics.detection import Readouts
from deepfsi.optics.features import FeatureNoise


class SeedStream:
    """Draws of the jobs of one seed, the same for all of them.

    Shapes: labels (n,).
    """

    rows: Tensor
    """Places (steps, B) of an epoch's scenes."""

    with_mean: Tensor
    """The same and n, the place of the mean scene, (steps, B + 1)."""

    def __init__(
        self, seed: int, replicas: slice, noise: FeatureNoise, labels: Tensor, batch: int
    ) -> None:
        self.replicas, self.noise = replicas, noise.part(replicas)
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

    def noisy(self, mean: Tensor, total: Tensor, read: Readouts) -> Tensor:
        """Noisy features (B, R, m) of expected ones, x D and x S."""
        if self.noise.counting:
            known = None if self.noise.kind == "poisson" else read
            return self.noise.counted(mean, total, known)
        return mean + self.noise.deviation(total, read.lit) * self.normal(mean.shape[-1])

    def repeated(self, shared: Tensor) -> Tensor:
        """Tensor (B, R, …) of what is the same for all jobs, (B, 1, …)."""
        return shared.expand(-1, self.replicas.stop - self.replicas.start, *shared.shape[2:])

    def part(self, every: Tensor) -> Tensor:
        """Rows of these jobs in a tensor of all, (R or 1, m)."""
        return every[self.replicas] if len(every) > 1 else every

    def masks(self, every: Tensor) -> Tensor:
        """Masks of these jobs, (..., R_i or 1, m, N), among those of all, (..., R or 1, m, N)."""
        if every.shape[-3] in (1, self.replicas.stop - self.replicas.start):
            return every
        return every[..., self.replicas, :, :]

    def readouts(self, every: Readouts) -> Readouts:
        """Readouts of the masks of these jobs among those of all, (2, R or 1, m)."""
        if every.time.shape[1] == 1:
            return every
        return Readouts(every.shown[:, self.replicas], every.time[:, self.replicas])

    def products(self, every: Tensor, step: int) -> Tensor:
        """A step's part of products of all scenes and jobs, (n, R or 1, m)."""
        own = every[:, self.replicas] if every.shape[1] > 1 else every
        return own.index_select(0, self.rows[step])


def seed_streams(
    seeds: Sequence[int], noise: FeatureNoise, labels: Tensor, batch: int
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
