"""Prior of adaptive masks: training scenes, and how far other scenes lie from them."""

from collections.abc import Mapping
from copy import copy

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from deepfsi.camera import summed_reflectance
from deepfsi.designfile import SceneModel, Temperatures

NEIGHBOURS = 3000
"""Scenes whose nearest neighbours tell how far scenes lie from those of the prior, at most."""

CENTRE_SPREAD = 1.4
"""How far scenes are taken to lie from centres of clusters, over the distance of their members.

Chosen on 1024 validation images of MNIST at 1e4 photons: with 1 the posterior is too sure.
"""

TEMPERATURE = "temperature_"
"""Beginning of the names of their arrays in a file."""

LEAST_VARIANCE = 1e-3
"""Least variance of a component between neighbours, over the mean of all components."""


class ScenePrior:
    """Scenes, each as likely as another, as sums of a mean and of components.

    A scene that is exposed lies near one of these: their difference is normal, with the covariance
    of the differences of nearest neighbours of a class, times the square of `spread`. Components
    are scaled so that this covariance is the identity. With a spread of 0 a scene is one of these,
    and components are principal components.

    With `clusters` the centres of clusters stand for the scenes, each as likely as it has members,
    and the covariance is that of the scenes about their centres, times the square of
    `CENTRE_SPREAD`.

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
        Of the scenes whose neighbours are sought, and of the clusters.
    clusters : int, optional
        Clusters of each class, at most as many as half of its scenes.
    """

    def __init__(
        self,
        x: np.ndarray,
        labels: np.ndarray,
        classes: int,
        components: int = 120,
        spread: float = 0.0,
        seed: int = 0,
        clusters: int | None = None,
    ) -> None:
        self.order = np.argsort(labels, kind="stable")
        """Rows of `x` by class: the scenes of the prior, or those that its centres stand for."""
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
        self.members = torch.ones(len(self))
        """Training scenes that each scene stands for."""
        self.temperatures: Temperatures | None = None
        """Of the classes' probabilities after each look; None where there are many scenes."""
        if clusters is not None:
            self.spread = CENTRE_SPREAD
            self._scale(self._cluster(clusters, seed) * self.spread)
        elif spread:
            self._scale(self._neighbours(torch.Generator().manual_seed(seed)) * spread)

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self.labels)

    @property
    def classes(self) -> int:
        """Number of classes, C."""
        return len(self.sizes)

    @property
    def class_shares(self) -> Tensor:
        """Probabilities (C,) of the classes before any look."""
        shares = [part.sum() for part in (self.members / self.members.sum()).split(self.sizes)]
        return torch.stack(shares)

    def with_temperatures(self, temperatures: Temperatures) -> "ScenePrior":
        """These scenes with the temperatures of a budget."""
        own = copy(self)
        own.temperatures = temperatures
        return own

    def light(self, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Light of the mean scene through masks (..., N), and of each component (..., d)."""
        return masks @ self.mean, masks @ self.components.T

    def mean_classes(self, weights: Tensor) -> Tensor:
        """Sums (b, C, d) of the coefficients of scenes by weights (b, n), over the classes."""
        parts = zip(weights.split(self.sizes, 1), self.coefficients.split(self.sizes), strict=True)
        return torch.stack([some @ own for some, own in parts], dim=1)

    @property
    def model(self) -> SceneModel | None:
        """Normal scenes of each class with the same moments; None of too few scenes."""
        members = self.members.numpy().astype(float)
        labels = self.labels.numpy()
        often = np.bincount(labels, members, minlength=self.classes)
        if not SceneModel.are_enough(often):
            return None
        own = self.coefficients.numpy().astype(float)
        centres = np.stack([
            np.average(own[labels == k], axis=0, weights=members[labels == k])
            for k in range(self.classes)
        ])  # fmt: skip
        away = (own - centres[labels]) * np.sqrt(members / (often.sum() - self.classes))[:, None]
        if members.max() > 1:  # scenes lie about the centres that stand for them
            away = np.concatenate([away, np.eye(own.shape[1])])
        components, mean = (each.numpy().astype(float) for each in (self.components, self.mean))
        square = np.linalg.cholesky(away.T @ away + 1e-9 * np.eye(own.shape[1])).T @ components
        return SceneModel.of(mean + centres @ components, square, often / often.sum())

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that a file needs, coefficients in 8 bits: n · (d + 4) bytes, and N · d · 4."""
        steps = self.coefficients.abs().amax(dim=0).clamp(min=1e-12) / 127
        levels = (self.coefficients / steps).round().to(torch.int8)
        found = {"mean": self.mean, "components": self.components, "steps": steps, "levels": levels}
        numbers = [self.summed_reflectance, self.spread]
        known = self.temperatures and vars(self.temperatures)
        return {
            **{name: each.numpy() for name, each in found.items()},
            "sizes": np.array(self.sizes),
            "members": self.members.numpy().astype(np.int32),
            "numbers": np.array(numbers),
            **{f"{TEMPERATURE}{name}": each for name, each in (known or {}).items()},
        }

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray]) -> "ScenePrior":
        """Prior of its `arrays`, which needs no training data."""
        prior = cls.__new__(cls)
        prior.sizes = arrays["sizes"].tolist()
        prior.labels = torch.arange(len(prior.sizes)).repeat_interleave(torch.tensor(prior.sizes))
        prior.members = torch.from_numpy(arrays["members"]).float()
        prior.summed_reflectance, prior.spread = arrays["numbers"].tolist()
        prior.mean = torch.from_numpy(arrays["mean"])
        prior.components = torch.from_numpy(arrays["components"])
        levels = torch.from_numpy(arrays["levels"]).float()
        prior.coefficients = levels * torch.from_numpy(arrays["steps"])
        held = {
            name: arrays[f"{TEMPERATURE}{name}"]
            for name in ("logs", "budgets")
            if f"{TEMPERATURE}{name}" in arrays
        }
        prior.temperatures = None
        if held:
            prior.temperatures = Temperatures.restored(held, len(held["logs"]))
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
        arrays, chosen = self.arrays, np.concatenate(rows)
        some = {name: arrays[name][chosen] for name in ("levels", "members")}
        return ScenePrior.restored(arrays | some | {"sizes": kept})

    def _cluster(self, clusters: int, seed: int) -> Tensor:
        """Put centres of clusters in the scenes' place; differences (n, d) of scenes from them."""
        from sklearn.cluster import KMeans

        centres, members, found = [], [], []
        for own in self.coefficients.split(self.sizes):
            with threadpool_limits(1):  # threads would add up in any order
                means = KMeans(clusters, n_init=1, random_state=seed).fit(own.numpy())
            cluster = torch.from_numpy(means.labels_).long()
            members.append(torch.bincount(cluster, minlength=clusters).float())
            sums = torch.zeros(clusters, own.shape[1]).index_add_(0, cluster, own)
            centres.append(sums / members[-1][:, None])
            found.append(own - centres[-1][cluster])
        self.sizes = [clusters] * self.classes
        self.labels = torch.arange(self.classes).repeat_interleave(clusters)
        self.coefficients, self.members = torch.cat(centres), torch.cat(members)
        return torch.cat(found)

    def _neighbours(self, generator: torch.Generator) -> Tensor:
        """Differences (n, d) of some scenes from their nearest neighbours of their class."""
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
        return torch.cat(found)

    def _scale(self, differ: Tensor) -> None:
        """Scale components so that the covariance of differences (n, d) is the identity."""
        differ = differ.double()
        covariance = differ.T @ differ / len(differ)
        least = LEAST_VARIANCE * covariance.diagonal().mean()
        covariance += least * torch.eye(len(covariance), dtype=torch.double)
        variances, vectors = torch.linalg.eigh(covariance)
        self.components = (vectors * variances.sqrt()).float().T.contiguous() @ self.components
        self.coefficients = self.coefficients @ (vectors / variances.sqrt()).float()
