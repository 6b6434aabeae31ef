"""Noise and random draws of trainings side by side, in units of the scene.

The unit is a fully reflecting pixel, which gives Φ / s counts, the gain. Budgets then differ only
in their noise, and share the products of scenes and masks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.physics.detection import Detection, Readouts
from deepfsi.physics.laws import LearnedMasks
from deepfsi.physics.noise import Expectation, Noise
from deepfsi.physics.scanner import project, project_rails

Normal = Callable[[int], Tensor]
"""Function from k to standard normal numbers (B, 1, k), the same for all trainings."""


@dataclass
class TrainingNoise:
    """Noise of the features x D of R trainings."""

    kind: Noise  # its numbers are (R, 1)
    gain: Tensor  # (R, 1), counts Φ / s of a fully reflecting pixel
    generators: list[torch.Generator]
    unit: Tensor = field(init=False)  # (R, 1), standard deviation of photon noise at x S = 1

    def __post_init__(self) -> None:
        self.unit = self.gain.rsqrt()
        self._kinds = [self.kind.of_jobs(job) for job in range(len(self.generators))]

    @classmethod
    def of(
        cls,
        noises: Sequence[Noise],
        gains: Sequence[float],
        seeds: Sequence[int],
        device: torch.device,
    ) -> "TrainingNoise":
        """Noise of R trainings of one kind, from the noise, gain and seed of each."""
        # Bit 31 keeps these draws apart from the stream that shuffles scenes
        gain = torch.tensor(gains, device=device).unsqueeze(1)
        generators = [torch.Generator(device).manual_seed(seed ^ 2**31) for seed in seeds]
        return cls(type(noises[0]).side_by_side(noises, device), gain, generators)

    def of_jobs(self, jobs: slice) -> "TrainingNoise":
        """Noise of a slice of the trainings, with the same generators."""
        return replace(
            self,
            kind=self.kind.of_jobs(jobs),
            gain=self.gain[jobs],
            generators=self.generators[jobs],
        )

    def features(self, mean: Tensor, total: Tensor, read: Readouts, normal: Normal) -> Tensor:
        """Noisy features (B, R, k)."""
        if self.kind.draws_rails:
            return self.counted(mean, total, read)
        deviation = self.kind.deviation(Expectation(mean, total, read, self.gain))
        return mean + deviation * normal(mean.shape[-1])

    def counted(self, mean: Tensor, total: Tensor, read: Readouts) -> Tensor:
        """Features (B, R, k) from counts of two rails."""
        # readouts are the same for all B scenes, or each scene has its own: (2, 1 or B, R or 1, k)
        by_scene = [tensor if tensor.ndim == 4 else tensor.unsqueeze(1) for tensor in read]
        counts = []
        # draws of an unbiased noise need no gradient: `Noise.gradient` attaches one to the features
        with torch.set_grad_enabled(not self.kind.unbiased and torch.is_grad_enabled()):
            rates = self._rates(mean, total)
            for job, kind in enumerate(self._kinds):
                of_job = Readouts(*(tensor[:, :, job % tensor.shape[2]] for tensor in by_scene))
                dark = kind.dark_counts(of_job.time)
                generator = self.generators[job]
                counts.append(kind.sample(rates[:, :, job], of_job, dark, generator, rails=0))
            plus, minus = torch.stack(counts, dim=2)
        light = Expectation(mean, total, read, self.gain)
        return self.kind.gradient((plus - minus) / self.gain, light)

    def learned_features(
        self, scenes: Tensor, masks: LearnedMasks, detection: Detection, draws: "Draws"
    ) -> tuple[Tensor, list[tuple[Tensor, Tensor]]]:
        """Centred features (B, R, k) of a step's scenes behind learned masks, and their light.

        Scenes (n + 1, N) are centred and arranged; their mean is the last row. For each seed the
        light holds the products x D and x S (B, R_i, k); it is empty unless rails are drawn.
        """
        count = detection.count
        features: list[Tensor] = []
        light: list[tuple[Tensor, Tensor]] = []
        if self.kind.draws_rails:
            rails = masks()
            read = detection.readouts(rails)
            frames = detection.read_of(rails)
            for seed in draws.streams:
                x = scenes.index_select(0, seed.with_mean)
                mean, total = project_rails(x, frames.map(seed.of_jobs), count)
                light.append((mean[:-1] + mean[-1], total[:-1] + total[-1]))
                counts = seed.noise.counted(*light[-1], seed.readouts(read))
                # the mean of a biased noise is not the rate: its batch centres it
                centre = mean[-1] if self.kind.unbiased else counts.mean(dim=0)
                features.append(counts - centre)
        elif self.kind.depends_on_light:
            # Two disjoint rails are one signed matrix, whose total is its absolute value: half of
            # the memory, and a backward pass by hand
            disjoint = masks.disjoint and detection.readout != "both"
            signed = masks.matrix() if disjoint else detection.read_of(masks()).combined
            for seed in draws.streams:
                x = scenes.index_select(0, seed.with_mean)
                epsilon = seed.normal(signed.shape[-2] * count) * seed.noise.unit
                of_seed = seed.of_jobs(signed, -3)
                features.append(ml_gauss_features(x, of_seed, epsilon, disjoint, detectors=count))
        else:
            rails = masks()
            with torch.no_grad():
                read = detection.readouts(rails)
            difference = detection.read_of(rails).difference
            for seed in draws.streams:
                x = scenes.index_select(0, seed.rows)
                mean = project(x, seed.of_jobs(difference), count)
                features.append(seed.noise.features(mean, mean, seed.readouts(read), seed.normal))
        return side_by_side(features), light

    def expected(self, mean: Tensor, total: Tensor) -> Tensor:
        """Mean counts (R,) of an exposure, over noise and scenes, from products (B, R, k)."""
        return self.kind.mean(self._rates(mean, total)).sum(dim=(0, 3)).mean(dim=0)

    def variance(self, mean: Tensor, total: Tensor, read: Readouts) -> Tensor:
        """Variance of features (..., R, k); a user's noise has none."""
        return self.kind.variance(Expectation(mean, total, read, self.gain)) / self.gain

    def _rates(self, mean: Tensor, total: Tensor) -> Tensor:
        """Expected photons (2, B, R, k) of the rails."""
        return torch.stack([total + mean, total - mean]).mul(self.gain / 2).clamp(min=0)


class SeedStream:
    """Draws that all jobs of one seed share; labels are (n,) or (n, q)."""

    order: Tensor  # (steps, B), indices of an epoch's scenes
    rows: Tensor  # (B,), indices of a step's scenes
    with_mean: Tensor  # (B + 1,), `rows`, then n, the index of the mean scene

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
        self.set_order(order[: count // self.batch * self.batch].view(-1, self.batch))

    def set_order(self, rows: Tensor) -> None:
        """Take an epoch's scenes in the order of indices (steps, B)."""
        self.order = rows.to(self._labels.device)
        self._with_mean = functional.pad(self.order, (0, 1), value=len(self._labels))
        self._ordered = self._labels[self.order]

    def gather(self, step: int) -> Tensor:
        """Move to the scenes of a step; return their labels (B, R)."""
        self.rows = self.order[step]
        self.with_mean = self._with_mean[step]
        return self.repeated(self._ordered[step].unsqueeze(1))

    def normal(self, count: int) -> Tensor:
        """Normal draws (B, 1, count)."""
        return torch.randn(
            self.batch, 1, count, generator=self.generator, device=self._labels.device
        )

    def budgets(self, span: float) -> Tensor:
        """Draw budgets (B, 1, 1), as multiples of the lowest."""
        device = self._labels.device
        uniform = torch.rand(self.batch, 1, 1, generator=self.generator, device=device)
        # Earlier versions drew how many masks are shown: this draw of one keeps the later numbers
        torch.multinomial(torch.ones(1, device=device), self.batch, True, generator=self.generator)
        return span**uniform

    def repeated(self, shared: Tensor) -> Tensor:
        """Tensor (B, 1, …) repeated for all jobs, (B, R, …)."""
        return shared.expand(-1, self.replicas.stop - self.replicas.start, *shared.shape[2:])

    def of_jobs(self, tensor: Tensor, axis: int = 0) -> Tensor:
        """Slice of a tensor for these jobs; its axis has all jobs, or 1 shared entry."""
        count = self.replicas.stop - self.replicas.start
        if tensor.shape[axis] in (1, count):
            return tensor
        return tensor.narrow(axis, self.replicas.start, count)

    def readouts(self, read: Readouts) -> Readouts:
        """Readouts (2, R_i or 1, m) of these jobs, from all (2, R or 1, m)."""
        return Readouts(*(self.of_jobs(tensor, 1) for tensor in read))

    def products(self, products: Tensor) -> Tensor:
        """Products (B, R_i or 1, m) of a step and these jobs, from all (n, R or 1, m)."""
        return self.of_jobs(products, 1).index_select(0, self.rows)


class Draws:
    """Scenes and random numbers of R jobs; jobs of one seed share them."""

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
        """Draw the order of an epoch's scenes for each seed."""
        for stream in self.streams:
            stream.shuffle()

    def gather(self, step: int) -> Tensor:
        """Move to the scenes of a step; return their labels (B, R) or values (B, R, q)."""
        return side_by_side([stream.gather(step) for stream in self.streams])


def side_by_side(by_seed: list[Tensor]) -> Tensor:
    """Join replicas (B, R_i, …) of several seeds: (B, R, …)."""
    return torch.cat(by_seed, dim=1) if len(by_seed) > 1 else by_seed[0]


def ml_gauss_features(
    scenes: Tensor, masks: Tensor, epsilon: Tensor, disjoint: bool, detectors: int = 1
) -> Tensor:
    """Features (B, *lead, k) of centred scenes under MLGauss noise, in a step of training.

    They are x_c D + √(x S) ε, where x̄ is the mean scene and x_c = x − x̄: the features of `Scanner`
    less the constant x̄ D. Shapes: scenes (B + 1, N), x_c and then x̄; masks (*lead, m, N) or
    (2, *lead, m, N); ε (B, *lead, k).
    """
    form = disjoint, detectors
    return _MlGaussFeatures.apply(scenes, masks, epsilon, form)  # type: ignore[no-untyped-call]


class _MlGaussFeatures(torch.autograd.Function):
    """Written by hand because autograd takes twice the time of the products."""

    @staticmethod
    def forward(
        ctx: Any, scenes: Tensor, masks: Tensor, epsilon: Tensor, form: tuple[bool, int]
    ) -> Tensor:
        ctx.signed, ctx.detectors = form
        low = masks.to(scenes.dtype)
        if ctx.signed:
            ctx.sign = low.sgn()
            low = torch.stack([low, low.abs()])
        products = project(scenes, low, ctx.detectors).to(epsilon.dtype)
        single = products.ndim == epsilon.ndim
        mean, counts = (products, products) if single else products.unbind(1)
        deviation = (counts[:-1] + counts[-1]).clamp_(min=0).sqrt_()
        ctx.save_for_backward(scenes, epsilon, deviation)
        ctx.shape = low.shape
        return torch.addcmul(mean[:-1], deviation, epsilon)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor, Tensor | None, None]:
        scenes, epsilon, deviation = ctx.saved_tensors
        # 0, not infinite, where a mask is dark; a boolean mask would take many times longer
        by_counts = (epsilon / deviation).nan_to_num_(0, 0, 0).mul_(gradient).mul_(0.5)
        back = gradient.new_zeros(len(scenes), *ctx.shape[:-2], gradient.shape[-1])
        mean, counts = (back, back) if back.ndim == epsilon.ndim else back.unbind(1)
        mean[:-1] = gradient
        counts[:-1] += by_counts
        counts[-1] = by_counts.sum(dim=0)
        low = back.flatten(1).to(scenes.dtype)
        if ctx.detectors == 1:
            product = (low.T @ scenes).view(ctx.shape)
        else:
            pieces = (
                low.unflatten(-1, (-1, ctx.detectors)),
                scenes.unflatten(-1, (ctx.detectors, -1)),
            )
            product = torch.einsum("bkd,bdp->kdp", *pieces).reshape(ctx.shape)
        if ctx.signed:
            product = torch.addcmul(product[0], product[1], ctx.sign)
        by_draw = gradient * deviation if ctx.needs_input_grad[2] else None
        return None, product.to(gradient.dtype), by_draw, None
