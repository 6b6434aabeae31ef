"""Random draws of a training: order of scenes, noise, budgets."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.optics.noise import attach_gradient, poisson, root, variance
from deepfsi.training.job import Job
from deepfsi.training.training_set import TrainingSet


class SeedStream:
    """What the jobs of one seed draw, the same for all of them."""

    rows: Tensor
    with_mean: Tensor

    def __init__(
        self, scenes: TrainingSet, jobs: Sequence[Job], places: list[int], steps: int, batch: int
    ) -> None:
        self.jobs = slice(places[0], places[-1] + 1)
        self.noise = FeatureNoise(scenes, jobs[self.jobs])
        self.generator = torch.Generator(scenes.device).manual_seed(jobs[places[0]].seed)
        self.scenes, self.steps, self.batch = scenes, steps, batch

    def shuffle(self) -> None:
        """Draw the order of an epoch's scenes."""
        count = len(self.scenes.labels)
        order = torch.randperm(count, generator=self.generator, device=self.scenes.device)
        self.rows = order[: self.steps * self.batch].view(self.steps, self.batch)
        self.with_mean = functional.pad(self.rows, (0, 1), value=count)
        self._labels = self.scenes.labels[self.rows]

    def labels(self, step: int) -> Tensor:
        """Labels (B, R) of a step."""
        return self._labels[step].unsqueeze(1).expand(-1, self.jobs.stop - self.jobs.start)

    def normal(self, masks: int) -> Tensor:
        """Normal draws (B, 1, m)."""
        return torch.randn(
            self.batch, 1, masks, generator=self.generator, device=self.scenes.device
        )

    def expose(self, span: float, likely: Tensor) -> tuple[Tensor, Tensor]:
        """Draw budgets, over the lowest, and numbers of masks, each (B, 1, 1)."""
        how = {"generator": self.generator, "device": self.scenes.device}
        budget = span ** torch.rand(self.batch, 1, 1, **how)  # type: ignore[call-overload]
        shown = 1 + torch.multinomial(likely, self.batch, True, generator=self.generator)
        return budget, shown.view(-1, 1, 1)

    def part(self, every: Tensor) -> Tensor:
        """What of all jobs, (R or 1, m), is of these."""
        return every[self.jobs] if len(every) > 1 else every

    def of(self, every: Tensor, step: int) -> Tensor:
        """A step's part of what is known of all scenes and jobs, (n, R or 1, m)."""
        own = every[:, self.jobs] if every.shape[1] > 1 else every
        return own.index_select(0, self.rows[step])


class FeatureNoise:
    """Noise of the features x D, whose unit is one fully reflecting pixel: Φ / s counts."""

    def __init__(self, scenes: TrainingSet, jobs: Sequence[Job]) -> None:
        self.kind = jobs[0].noise
        gain = [[job.photons / scenes.light] for job in jobs]
        self.gain = torch.tensor(gain, device=scenes.device)
        self.unit = self.gain.rsqrt()
        self.sigma = torch.tensor([[job.sigma] for job in jobs], device=scenes.device)
        # one for each replica, since what a Poisson draw takes from its generator depends on rates
        self.generators = [
            torch.Generator(scenes.device).manual_seed(job.seed ^ 2**31) for job in jobs
        ]

    def counted(self, mean: Tensor, light: Tensor) -> Tensor:
        """Features (B, R, m) from exact counts of two rails with `mean` = x D and `light` = x S."""
        with torch.no_grad():
            rates = torch.stack([light + mean, light - mean]).mul(self.gain / 2).clamp(min=0)
            drawn = zip(rates.unbind(dim=2), self.generators, strict=True)
            plus, minus = torch.stack([poisson(*each) for each in drawn], dim=2)
        return attach_gradient((plus - minus) / self.gain, mean, light)

    def deviation(self, light: Tensor, shown: Tensor) -> Tensor:
        """Standard deviation where the rails together see `light` = x S, (..., R, m)."""
        if self.kind == "ml_gauss":
            return root(light) * self.unit
        return root(self.variance(light, shown))

    def variance(self, light: Tensor, shown: Tensor) -> Tensor:
        """The same, squared; `shown` (R, m) says how many rails are read out."""
        if self.kind in ("ml_gauss", "poisson"):
            return light / self.gain
        return variance(light, shown, self.kind, self.sigma) / self.gain.square()


def side_by_side(parts: list[Tensor]) -> Tensor:
    """Replicas (B, R_i, …) of several seeds as one (B, R, …)."""
    return torch.cat(parts, dim=1) if len(parts) > 1 else parts[0]
