"""Accuracy of adaptive masks on test scenes under photon noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from deepfsi.datasets import Dataset, Source, as_dataset
from deepfsi.design.adaptive.posterior import AdaptivePosterior, LookOptics
from deepfsi.design.adaptive.prior import ScenePrior
from deepfsi.design.evaluation import Guess, Result, ResultList, check_draws, test_scenes
from deepfsi.errors import InputError
from deepfsi.frozen import Settings
from deepfsi.memory import check_memory, free_memory
from deepfsi.optics.budget import check_budget
from deepfsi.optics.camera import Camera, CameraSource
from deepfsi.progress import Report, shown

AT_ONCE = 2**22
"""Log-likelihoods that are held at a time."""

COPIES = 6
"""Arrays as large as the log-likelihoods, or as the scenes of the prior, held at a time."""

Reading = Callable[[AdaptivePosterior], Tensor]
"""Gives probabilities (b, C) of the classes from what the counts tell of the scenes."""


class AdaptiveMasks(Settings):
    """Settings of exposures with adaptive masks.

    Examples
    --------
    >>> from deepfsi.design.adaptive.evaluation import AdaptiveMasks
    >>> AdaptiveMasks(looks=3, growth=4).shares
    [0.14285714285714285, 0.2857142857142857, 0.5714285714285714]
    """

    looks: int = Field(
        16, ge=1, le=1024, strict=True, description="masks that are shown one after another"
    )
    growth: float = Field(
        1.0,
        ge=1e-3,
        le=1e3,
        description="share of the exposure that the last look takes, over that of the first",
    )
    until: float = Field(
        1.0,
        gt=0,
        le=1,
        description="probability of a class above which the exposure stops; 1 for never",
    )
    components: int = Field(
        120, ge=1, strict=True, description="principal components of the scenes that are kept"
    )
    spread: float = Field(
        0.7,
        ge=0,
        allow_inf_nan=False,
        description="how far scenes lie from those of the prior, over the distance of neighbours "
        "in it; 0 if they are among them",
    )

    @property
    def shares(self) -> list[float]:
        """Share of the exposure that each look takes; their sum is 1."""
        each = self.growth ** np.linspace(0, 1, self.looks)
        return (each / each.sum()).tolist()


@dataclass(frozen=True)
class AdaptiveResult(Result):
    """Result of adaptive masks.

    Attributes
    ----------
    share : float
        Mean share of the exposure after which it stopped.
    """

    share: float


@dataclass(frozen=True, eq=False)
class Exposed:
    """Answers of exposures, and what was counted.

    Attributes
    ----------
    chances : tensor, shape (b, C)
        Probabilities of the classes.
    shares : tensor, shape (b,)
        Share of the exposure after which each stopped.
    counts : tensor, shape (looks,)
        Sum of the expected counts of all exposures, without dark counts.
    """

    chances: Tensor
    shares: Tensor
    counts: Tensor


def expose(
    state: AdaptivePosterior,
    x: Tensor,
    settings: AdaptiveMasks,
    generator: torch.Generator,
    reading: Reading | None = None,
) -> Exposed:
    """Expose scenes (b, N) look after look until each stops, from the state before all looks."""
    read = reading or (lambda some: some.chances)
    chances, shares = torch.empty(len(x), state.prior.classes), torch.zeros(len(x))
    counts, running = torch.zeros(settings.looks, dtype=torch.double), torch.arange(len(x))
    dark = state.optics.dark
    for look, share in enumerate(settings.shares):
        masks = state.choose(share, generator)
        expected = state.expected(masks, x[running], share)
        state.update(masks, state.optics.draw(expected, generator), share)
        counts[look] = expected.double().sum() - dark * share * expected.numel()
        shares[running] += share
        last = look == settings.looks - 1
        if settings.until < 1 or last:
            found = read(state)
            chances[running] = found
            going = found.amax(dim=1) <= settings.until
            if not last and not bool(going.all()):
                state, running = state.part(going), running[going]
        if not len(running):
            break
    return Exposed(chances, shares, counts)


def adaptive_masks(
    data: Source,
    photons: Sequence[float] | float,
    *,
    camera: CameraSource = None,
    prior: ScenePrior | int | None = None,
    reading: Reading | None = None,
    draws: int = 1,
    seed: int = 0,
    report: Report | None = None,
    **settings: Any,
) -> list[Result]:
    """Accuracy of adaptive masks on test scenes under photon noise: `AdaptiveResult`, one a budget.

    Each look shows one binary mask, made from the counts of all before. Test scenes are exposed.

    Parameters
    ----------
    data : Dataset, str, path or tuple of arrays
    photons : float or sequence of float
        Budgets Φ of whole exposures.
    camera : Camera, str, path or mapping, optional
        With free dwells or two arms, and photon noise; `dmd` unless given.
    prior : ScenePrior or int, optional
        What is known of scenes, or how many training scenes are used for it, the first ones; all
        unless given.
    reading : callable, optional
        Gives probabilities of the classes from the posterior, such as a `Reader`; sums of the
        posterior unless given.
    draws : int
        Noise draws of each scene.
    seed : int
        Of the noise, and of the scenes by which masks are compared.
    report : Report, optional
        Where to say how far it is.
    settings
        Fields of `AdaptiveMasks`, such as ``looks=32``.

    Raises
    ------
    InputError
        If a number is not allowed, or the memory does not hold the prior.

    Examples
    --------
    >>> from deepfsi import load_dataset
    >>> [result] = adaptive_masks(load_dataset("digits"), 1e4, looks=8)
    >>> result.accuracy > 0.85
    True
    """
    budgets = [check_budget(b) for b in np.atleast_1d(np.asarray(photons, dtype=object))]
    scenes, chosen, seen = as_dataset(data), AdaptiveMasks(**settings), Camera.load(camera)
    check_draws(draws, seed)
    optics = {each: LookOptics.of(seen, scenes.image_shape, each) for each in budgets}
    with torch.no_grad(), shown(report, "adaptive masks") as bar:
        held = prior if isinstance(prior, ScenePrior) else prior_of(scenes, chosen, prior)
        trial = _Trial(held, optics, chosen, reading)
        unknown = torch.zeros(chosen.looks)  # each scene has its own masks
        found = test_scenes(scenes, trial.guesses, budgets, draws, seed, "poisson", unknown, bar)
    return ResultList(trial.result(each) for each in found)


class _Trial:
    """Exposures of scenes, of which it keeps what was counted at each budget."""

    def __init__(
        self,
        prior: ScenePrior,
        optics: dict[float, LookOptics],
        settings: AdaptiveMasks,
        reading: Reading | None,
    ) -> None:
        self._prior, self._optics, self._settings = prior, optics, settings
        self._reading = reading
        self._shares = dict.fromkeys(optics, 0.0)
        self._counts = {each: torch.zeros(settings.looks, dtype=torch.double) for each in optics}

    def guesses(self, x: Tensor) -> Guess:
        """Answers to exposures of scenes (n, N)."""

        def guess(generator: torch.Generator, budget: float) -> tuple[Tensor, Tensor, float]:
            chances, counted = [], 0.0
            for some in x.split(max(1, AT_ONCE // len(self._prior))):
                state = AdaptivePosterior(self._prior, len(some), self._optics[budget])
                found = expose(state, some, self._settings, generator, self._reading)
                chances.append(found.chances)
                self._shares[budget] += float(found.shares.sum())
                self._counts[budget] += found.counts
                counted += float(found.counts.sum())
            sure, classes = torch.cat(chances).max(dim=-1)
            return classes, sure, counted

        return guess

    def result(self, result: Result) -> AdaptiveResult:
        """A result with what was counted."""
        exposures = result.draws * result.images
        counts = self._counts[result.photons] / exposures
        known = vars(result) | {"throughput": float(counts.sum()) / result.photons}
        return AdaptiveResult(
            **known | {"photons_per_mask": counts.tolist()},
            share=self._shares[result.photons] / exposures,
        )


def prior_of(data: Dataset, settings: AdaptiveMasks, scenes: int | None = None) -> ScenePrior:
    """Prior of the first training scenes of a data set, all unless a number is given."""
    most = len(data.x_train)
    used = most if scenes is None else scenes
    if type(used) is not int or not 1 <= used <= most:
        raise InputError(f"prior = {scenes!r} is not allowed: give 1 to {most}, or a `ScenePrior`")
    needed = 4 * (used * (3 * data.pixels + settings.components) + COPIES * AT_ONCE)
    check_memory(needed, free_memory(), "the prior of these scenes", "give a smaller `prior`")
    return ScenePrior(
        data.x_train[:used],
        data.y_train[:used],
        len(data.classes),
        settings.components,
        settings.spread,
    )
