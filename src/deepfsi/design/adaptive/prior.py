"""Prior of adaptive masks: training scenes, and how far other scenes lie from them."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from deepfsi.optics.budget import summed_reflectance

NEIGHBOURS = 3000
"""Scenes whose nearest neighbours tell how far scenes lie from those of the prior, at most."""

LEAST_VARIANCE = 1e-3
"""Least variance of a component between neighbours, over the mean of all components."""


class ScenePrior:
    """Scenes, each as likely as another, as sums of a mean and of components.

    A scene that is exposed lies near one of these: their difference is normal, with the covariance
    of the differences of nearest neighbours of a class, times `spread`². Components are scaled so
    that this covariance is the identity. With a spread of 0 a scene is one of these, and components
    are principal components.

    Parameters
    ----------
    x : array, shape (n, N)
        Reflectance of the scenes.
    labels : array, shape (n,)
        Classes, 0 .. C-1.
    classes : int
        C.
    components : int
        Principal components that are kept, d at most N.
    spread : float
        0 or more.
    seed : int
        Of the scenes whose neighbours are sought.
    """

    def __init__(
        self,
        x: np.ndarray,
        labels: np.ndarray,
        classes: int,
        components: int = 120,
        spread: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.order = np.argsort(labels, kind="stable")
        """Rows of `x` in the order of the prior."""
        scenes = torch.from_numpy(np.ascontiguousarray(x[self.order], np.float32))
        self.labels = torch.from_numpy(labels[self.order].astype(np.int64))
        self.sizes: list[int] = torch.bincount(self.labels, minlength=classes).tolist()
        self.summed_reflectance = summed_reflectance(x)
        self.spread = float(spread)
        self.mean = scenes.mean(dim=0)  # (N,)
        away = scenes - self.mean
        vectors = torch.linalg.eigh(away.double().T @ away.double())[1]
        kept = vectors[:, -min(components, scenes.shape[1]) :].float()
        self.components = kept.T.contiguous()  # (d, N)
        self.coefficients = away @ kept  # (n, d)
        if spread:
            self._scale(torch.Generator().manual_seed(seed))

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self.labels)

    @property
    def classes(self) -> int:
        """Number of classes, C."""
        return len(self.sizes)

    def light(self, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Light of the mean scene through masks (..., N), and of each component (..., d)."""
        return masks @ self.mean, masks @ self.components.T

    def mean_classes(self, weights: Tensor) -> Tensor:
        """Sums (b, C, d) of the coefficients of scenes by weights (b, n), over the classes."""
        parts = zip(weights.split(self.sizes, 1), self.coefficients.split(self.sizes), strict=True)
        return torch.stack([some @ own for some, own in parts], dim=1)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that a file needs, coefficients in 8 bits: n · d bytes, and N · d · 4."""
        steps = self.coefficients.abs().amax(dim=0).clamp(min=1e-12) / 127
        levels = (self.coefficients / steps).round().to(torch.int8)
        found = {"mean": self.mean, "components": self.components, "steps": steps, "levels": levels}
        numbers = [self.summed_reflectance, self.spread]
        return {
            **{name: each.numpy() for name, each in found.items()},
            "sizes": np.array(self.sizes),
            "numbers": np.array(numbers),
        }

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray]) -> "ScenePrior":
        """Prior of its `arrays`, which needs no training data."""
        prior = cls.__new__(cls)
        prior.sizes = arrays["sizes"].tolist()
        prior.labels = torch.arange(len(prior.sizes)).repeat_interleave(torch.tensor(prior.sizes))
        prior.summed_reflectance, prior.spread = arrays["numbers"].tolist()
        prior.mean = torch.from_numpy(arrays["mean"])
        prior.components = torch.from_numpy(arrays["components"])
        levels = torch.from_numpy(arrays["levels"]).float()
        prior.coefficients = levels * torch.from_numpy(arrays["steps"])
        return prior

    def few(self, count: int, seed: int = 0) -> "ScenePrior":
        """Prior of at most so many scenes, but one of each class, as a file would keep them."""
        rng, own = np.random.default_rng(seed), np.array(self.sizes)
        kept = np.minimum(own, np.maximum(own * count // len(self), 1))
        starts = np.cumsum([0, *own[:-1]])
        rows = [
            start + np.sort(rng.choice(size, some, replace=False))
            for start, size, some in zip(starts, own, kept, strict=True)
        ]
        arrays = self.arrays
        levels = arrays["levels"][np.concatenate(rows)]
        return ScenePrior.restored(arrays | {"levels": levels, "sizes": kept})

    def _scale(self, generator: torch.Generator) -> None:
        """Scale components by the differences of scenes from their nearest neighbours."""
        chosen = torch.randperm(len(self), generator=generator)[:NEIGHBOURS].sort().values
        starts = np.cumsum([0, *self.sizes[:-1]])
        found = []
        for start, own in zip(starts.tolist(), self.coefficients.split(self.sizes), strict=True):
            rows = chosen[(chosen >= start) & (chosen < start + len(own))] - start
            if len(own) < 2 or not len(rows):
                continue
            far = torch.cdist(own[rows], own)
            far[torch.arange(len(rows)), rows] = torch.inf
            found.append(own[rows] - own[far.argmin(dim=1)])
        differ = torch.cat(found).double() * self.spread
        covariance = differ.T @ differ / len(differ)
        least = LEAST_VARIANCE * covariance.diagonal().mean()
        covariance += least * torch.eye(len(covariance), dtype=torch.double)
        variances, vectors = torch.linalg.eigh(covariance)
        self.components = (vectors * variances.sqrt()).float().T.contiguous() @ self.components
        self.coefficients = self.coefficients @ (vectors / variances.sqrt()).float()
