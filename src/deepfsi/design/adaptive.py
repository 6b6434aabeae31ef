"""Adaptive masks: each next mask is made from the posterior over the training scenes.

A mirror device can show any binary mask next. After each look the posterior of the scene is known
from all counts so far, with the training scenes as prior. The next mask separates the likeliest
classes in two groups: its mirrors are ON where the mean scenes of the groups differ most for the
photon noise that they bring. Of all such masks that one is shown whose counts are expected to vary
most between the classes, over their variance within a class, on the scale of 2 √counts, where
photon noise is the same for all. The answer is the posterior of the class: no network is trained.

The choice is greedy, a look at a time, and all looks are of one length. Sources: sequential design
by expected information (Lindley 1956); 2 √counts is Anscombe's (1948).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepfsi.datasets import Dataset, Source, as_dataset
from deepfsi.design.evaluation import Guess, Result, check_draws, test_scenes
from deepfsi.errors import InputError
from deepfsi.memory import check_memory, free_memory
from deepfsi.optics.budget import check_budget, summed_reflectance
from deepfsi.progress import Report, shown

LIKELIEST = 5
"""Classes that the next mask is to separate at most."""

SAMPLES = 128
"""Scenes drawn of the posterior by which masks are compared; all where there are no more."""

HALVINGS = 4
"""Steps by which the best threshold of a mask is found."""

AT_ONCE = 2**23
"""Log-likelihoods that are held at a time."""

MOST_LOOKS = 1024
"""Looks of an exposure at most."""


class ScenePrior:
    """Training scenes, each as likely as another, as sums of a mean and of components.

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
    """

    def __init__(
        self, x: np.ndarray, labels: np.ndarray, classes: int, components: int = 120
    ) -> None:
        order = np.argsort(labels, kind="stable")
        scenes = torch.from_numpy(np.ascontiguousarray(x[order], np.float32))
        self.labels = torch.from_numpy(labels[order].astype(np.int64))
        self.summed_reflectance = summed_reflectance(x)
        ends = torch.bincount(self.labels, minlength=classes).cumsum(0).tolist()
        self.parts = [slice(*each) for each in zip([0, *ends[:-1]], ends, strict=True)]
        self.mean = scenes.mean(dim=0)  # (N,)
        away = scenes - self.mean
        vectors = torch.linalg.eigh(away.double().T @ away.double())[1]
        kept = vectors[:, -min(components, scenes.shape[1]) :].float()
        self.components = kept.T.contiguous()  # (d, N)
        self.coefficients = away @ kept  # (n, d)

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self.labels)

    def rates(self, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Light of the mean scene through masks (..., N), and of each component (..., d)."""
        return masks @ self.mean, masks @ self.components.T

    def sum_classes(self, weights: Tensor) -> Tensor:
        """Sums (b, C) of weights (b, n) of scenes over the classes."""
        return torch.stack([weights[:, part].sum(dim=1) for part in self.parts], dim=1)

    def mean_classes(self, weights: Tensor) -> Tensor:
        """Sums (b, C, d) of the components of scenes by weights (b, n), over the classes."""
        each = [weights[:, part] @ self.coefficients[part] for part in self.parts]
        return torch.stack(each, dim=1)


class AdaptivePosterior:
    """Posterior of the scene in b exposures that see masks of their own, look after look.

    Parameters
    ----------
    prior : ScenePrior
    exposures : int
        b.
    photons : float
        Budget Φ of a whole exposure.
    dark : float
        Dark counts of the detector in a whole exposure.
    mismatch : float
        Standard deviation by which light through a mask differs from that of any training scene,
        over that light: counts are then of a negative binomial law. 0 for Poisson's.
    """

    def __init__(
        self,
        prior: ScenePrior,
        exposures: int,
        photons: float,
        *,
        dark: float = 0.0,
        mismatch: float = 0.0,
    ) -> None:
        self.prior, self.photons, self.dark, self.mismatch = prior, photons, dark, mismatch
        self.logs = torch.zeros(exposures, len(prior))  # log-likelihoods

    def expected(self, masks: Tensor, x: Tensor, share: float) -> Tensor:
        """Expected counts (b,) of scenes (b, N) behind masks (b, N) for a share of the exposure."""
        return (masks * x).sum(dim=1) * self._gain(share) + self.dark * share

    def update(self, masks: Tensor, counts: Tensor, share: float) -> None:
        """Take in counts (b,) behind masks (b, N) that were shown for a share of the exposure."""
        mean, parts = self.prior.rates(masks)
        least = 1e-6 * float(self.prior.mean.sum())
        light = torch.addmm(mean[:, None], parts, self.prior.coefficients.T).clamp_(min=least)
        rates = light.mul_(self._gain(share)).add_(self.dark * share)
        # relative to the mean scene: differences of likelihoods alone need float32's digits
        usual = mean[:, None].clamp(min=least) * self._gain(share) + self.dark * share
        self.logs += counts[:, None] * (rates / usual).log_()
        if self.mismatch:
            spread = self.mismatch**-2
            more = rates.sub_(usual).div_(usual + spread).log1p_()
            self.logs -= (counts[:, None] + spread) * more
        else:
            self.logs -= rates.sub_(usual)

    @property
    def weights(self) -> Tensor:
        """Probabilities (b, n) of the scenes."""
        return self.logs.softmax(dim=1)

    @property
    def chances(self) -> Tensor:
        """Probabilities (b, C) of the classes."""
        return self.prior.sum_classes(self.weights)

    def choose(self, share: float, generator: torch.Generator) -> Tensor:
        """Masks (b, N) of 0 and 1 to be shown next, for a share of the exposure."""
        weights = self.weights
        masks = self._candidates(weights)
        places, drawn = _sample(weights, generator)
        mean, parts = self.prior.rates(masks)
        light = mean[..., None] + parts @ self.prior.coefficients[places].transpose(1, 2)
        counts = light.clamp(min=0) * self._gain(share) + self.dark * share
        classes = len(self.prior.parts)
        labels = torch.nn.functional.one_hot(self.prior.labels[places], classes).float()
        best = separation(counts, labels * drawn[..., None]).argmax(dim=1)
        return masks[torch.arange(len(masks)), best]

    def _gain(self, share: float) -> float:
        return self.photons * share / self.prior.summed_reflectance

    def _candidates(self, weights: Tensor) -> Tensor:
        """Masks (b, P, N) that separate the likeliest classes in two groups."""
        chances, sums = self.prior.sum_classes(weights), self.prior.mean_classes(weights)
        count = min(LIKELIEST, chances.shape[1])
        likely, top = chances.topk(count, dim=1)
        own = sums.gather(1, top[..., None].expand(-1, -1, sums.shape[-1]))
        groups = _groups(count)
        means = [
            torch.einsum("pk,bkd->bpd", group, own) / (likely @ group.T).clamp(min=1e-9)[..., None]
            for group in (groups, 1 - groups)
        ]
        differ = (means[0] - means[1]) @ self.prior.components
        scene = self.prior.mean + sums.sum(dim=1) @ self.prior.components
        differ = torch.cat([differ, -differ], dim=1)
        return brightest(differ, scene.clamp(min=1e-6)[:, None].expand_as(differ))


def brightest(differ: Tensor, scene: Tensor) -> Tensor:
    """Masks (..., N) of 0 and 1 with the largest difference over its photon noise.

    Of pixels with differences d (..., N) and light μ (..., N) these are those of a mask F that
    maximises (Σ F d)² / Σ F μ: d / μ of each is above half of that of all together. Found in steps
    from all pixels with d above 0, it may be a local maximum.
    """
    ratio, threshold = differ / scene, torch.zeros_like(differ[..., :1])
    for _ in range(HALVINGS):
        on = (ratio > threshold).to(differ.dtype)
        lit = (on * scene).sum(dim=-1, keepdim=True).clamp(min=1e-12)
        threshold = (on * differ).sum(dim=-1, keepdim=True) / lit / 2
    return (ratio > threshold).to(differ.dtype)


def separation(counts: Tensor, members: Tensor) -> Tensor:
    """Variance (b, P) of 2 √counts between classes, over that within a class and photon noise.

    Expected counts are (b, P, S) of S scenes, whose weights in each class are (b, S, C).
    """
    scale = 2 * (counts + 3 / 8).sqrt()
    scale = scale - scale.mean(dim=-1, keepdim=True)
    size = members.sum(dim=1)[:, None]  # (b, 1, C)
    sums = scale @ members
    mean = sums.sum(dim=-1, keepdim=True)
    between = (sums**2 / size.clamp(min=1e-12)).sum(dim=-1) - mean.squeeze(-1) ** 2
    total = (scale**2 @ members.sum(dim=-1, keepdim=True)).squeeze(-1) - mean.squeeze(-1) ** 2
    return between / ((total - between).clamp(min=0) + 1)


def _groups(count: int) -> Tensor:
    """All ways (P, count) to part classes in two groups: 1 for one of them, the last in neither."""
    numbers = torch.arange(1, 2 ** (count - 1))
    return (numbers[:, None] >> torch.arange(count) & 1).float()


def _sample(weights: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Places (b, S) of scenes drawn by their weights (b, n), and weights (b, S) of the drawn."""
    exposures, scenes = weights.shape
    if scenes <= SAMPLES:
        return torch.arange(scenes).expand(exposures, -1), weights
    start = torch.rand(exposures, 1, generator=generator)
    points = (torch.arange(SAMPLES) + start) / SAMPLES
    places = torch.searchsorted(weights.double().cumsum(dim=1), points.double())
    return places.clamp(max=scenes - 1), torch.full_like(points, 1 / SAMPLES)


def adaptive_masks(
    data: Source,
    photons: Sequence[float] | float,
    *,
    looks: int = 16,
    prior: int | None = None,
    components: int = 120,
    dark: float = 0.0,
    mismatch: float = 0.0,
    draws: int = 1,
    seed: int = 0,
    report: Report | None = None,
) -> list[Result]:
    """Accuracy of adaptive masks on test scenes under photon noise, a `Result` for each budget.

    One mirror device and one detector: each look shows one binary mask for an equal share of the
    exposure, made from the counts of all looks before. Training scenes are the prior; test scenes
    are exposed.

    Parameters
    ----------
    data : Dataset, str, path or tuple of arrays
    photons : float or sequence of float
        Budgets Φ of whole exposures.
    looks : int
        Masks that are shown one after another.
    prior : int, optional
        Training scenes that are used, the first ones; all unless given.
    components : int
        Principal components of the scenes that are kept.
    dark : float
        Dark counts of the detector in a whole exposure.
    mismatch : float
        Standard deviation by which light through a mask differs from that of any training scene,
        over that light: above 0 where test scenes are not among the training scenes.
    draws : int
        Noise draws of each scene.
    seed : int
        Of the noise, and of the scenes by which masks are compared.
    report : Report, optional
        Where to say how far it is; a bar where a terminal is attached unless given.

    Raises
    ------
    InputError
        If a number is not allowed, or the memory does not hold the prior.

    Examples
    --------
    >>> from deepfsi import load_dataset
    >>> from deepfsi.design.adaptive import adaptive_masks
    >>> [result] = adaptive_masks(load_dataset("digits"), 1e4, looks=8)
    >>> result.accuracy > 0.85
    True
    """
    budgets = [check_budget(b) for b in np.atleast_1d(np.asarray(photons, dtype=object))]
    scenes = as_dataset(data)
    check_draws(draws, seed)
    _check(scenes, looks, prior, components, dark, mismatch)
    known = slice(None, prior)
    with torch.no_grad(), shown(report, "adaptive masks") as bar:
        held = ScenePrior(
            scenes.x_train[known], scenes.y_train[known], len(scenes.classes), components
        )

        counts = {budget: torch.zeros(looks, dtype=torch.double) for budget in budgets}

        def guess_of(x: Tensor) -> Guess:
            def guess(generator: torch.Generator, budget: float) -> tuple[Tensor, Tensor, float]:
                chances, before = [], float(counts[budget].sum())
                for some in x.split(max(1, AT_ONCE // len(held))):
                    state = AdaptivePosterior(held, len(some), budget, dark=dark, mismatch=mismatch)
                    for look in range(looks):
                        masks = state.choose(1 / looks, generator)
                        expected = state.expected(masks, some, 1 / looks)
                        state.update(masks, torch.poisson(expected, generator=generator), 1 / looks)
                        counts[budget][look] += expected.sum()
                    chances.append(state.chances)
                sure, classes = torch.cat(chances).max(dim=-1)
                return classes, sure, float(counts[budget].sum()) - before

            return guess

        unknown = torch.zeros(looks)  # each scene has its own masks
        found = test_scenes(scenes, guess_of, budgets, draws, seed, "poisson", unknown, bar)
    exposures = draws * len(scenes.x_test)
    for place, result in enumerate(found):
        each = (counts[result.photons] / exposures).tolist()
        share = sum(each) / result.photons
        found[place] = replace(result, throughput=share, photons_per_mask=each)
    return found


def _check(
    data: Dataset,
    looks: int,
    prior: int | None,
    components: int,
    dark: float,
    mismatch: float,
) -> None:
    """Raise `InputError` unless these settings can be."""
    scenes = len(data.x_train)
    used = scenes if prior is None else prior
    for name, number, most in (
        ("looks", looks, MOST_LOOKS),
        ("prior", used, scenes),
        ("components", components, 10**6),
    ):
        if type(number) is not int or not 1 <= number <= most:
            raise InputError(f"{name} = {number!r} is not allowed: give 1 to {most}")
    for name, share in (("dark", dark), ("mismatch", mismatch)):
        if not (math.isfinite(share) and share >= 0):
            raise InputError(f"{name} = {share!r} is not allowed: give 0 or more")
    needed = 4 * used * (3 * data.pixels + components) + 16 * AT_ONCE
    check_memory(needed, free_memory(), "the prior of these scenes", "give a smaller `prior`")
