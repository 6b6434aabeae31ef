"""Ideal observer of counts: posterior of the class with the training scenes as prior.

The scene is taken for one of the training scenes, each as likely as another. The log-likelihood of
Poisson counts y under a scene k with rates r_k is Σ y ln r_k − r_k, up to a constant; scenes of a
class add their likelihoods. No network is trained: its accuracy tells whether a low accuracy is the
fault of a network or of the masks.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor

from deepfsi.adaptive.posterior import sum_by_class
from deepfsi.base.arrays import check_memory
from deepfsi.base.progress import Progress, progress_bar
from deepfsi.camera.light import check_budget
from deepfsi.datasets.load import Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.designfile.provenance import new_scenes
from deepfsi.evaluation.accuracy import (
    Expose,
    Exposed,
    check_data,
    expose_scenes,
)
from deepfsi.evaluation.measures import ClassAnswers
from deepfsi.evaluation.results import Result
from deepfsi.exposure.kind import CountedLight
from deepfsi.exposure.training_set import check_classes
from deepfsi.physics.surroundings import library_defaults


class IdealObserver:
    """Posterior of the class of Poisson counts, with given scenes as prior.

    Rates (n, ...) of scenes are for a budget of one photon, their classes `labels` (n,) 0 .. C-1.
    Rates of 0 make counts impossible. If all scenes do, those with the fewest impossible counts
    remain, as in the limit of a vanishing background.
    """

    def __init__(self, rates: Tensor, labels: Tensor, classes: int) -> None:
        self._sizes = torch.bincount(labels, minlength=classes).tolist()
        # sorted by class, as `sum_by_class` takes them
        rates = rates.flatten(1)[labels.argsort().to(rates.device)]
        self._lit = rates.amax(dim=0) > 0
        rates = rates[:, self._lit]
        self._mean = rates.mean(dim=0)
        # relative to the mean scene: differences of likelihoods alone need float32's digits
        dark = rates == 0
        self._logs = torch.where(dark, 1.0, rates).div_(self._mean).log_()
        self._impossible = dark.to(rates.dtype) if bool(dark.any()) else None
        mean = self._mean.double()
        self._offset = torch.cat(
            [
                logs.double() @ mean - (block.double() - mean).sum(dim=1)
                for logs, block in zip(self._logs.split(1024), rates.split(1024), strict=True)
            ]
        )

    def probabilities(self, counts: Tensor, photons: float) -> Tensor:
        """Class probabilities (b, C) of counts (b, ...) of the readouts, at a budget Φ."""
        rows = max(1, 2**24 // len(self._logs))  # likelihoods held at a time
        read = counts.flatten(1)[:, self._lit].to(self._logs.dtype)
        return torch.cat([self._probabilities(block, photons) for block in read.split(rows)])

    def _probabilities(self, read: Tensor, photons: float) -> Tensor:
        offset = (photons * self._offset).to(read.dtype)
        logs = torch.addmm(offset, read - photons * self._mean, self._logs.T)
        if self._impossible is not None:
            faults = read @ self._impossible.T
            logs.masked_fill_(faults > faults.amin(dim=1, keepdim=True), -torch.inf)
        return sum_by_class(logs.softmax(dim=1), self._sizes)


@library_defaults()
def ideal_observer(
    design: Design,
    data: Source,
    photons: Sequence[float] | float,
    *,
    draws: int = 1,
    seed: int = 0,
    report: Progress | None = None,
) -> list[Result]:
    """Accuracy of the ideal observer under photon noise, a `Result` for each budget.

    The training scenes of the data are the prior, and its test scenes are exposed. Compare it with
    `evaluate`: a network far below it can be improved; if it is low itself, the masks are at fault.
    It is a bound for scenes of the training set only. Of new scenes in much light a network may
    tell more.

    Parameters
    ----------
    design : Design
        Of masks that are known before an exposure.
    data : Dataset, str, path or tuple of arrays
    photons : float or sequence of float
        Budgets Φ.
    draws : int
        Noise draws of each scene.
    seed : int
        Seed of the noise.
    report : Progress, optional
        Receives the progress. Default: a bar if a terminal is attached.

    Raises
    ------
    InputError
        If the data does not fit the design, a budget is not finite and above 0, or masks are made
        during the exposure.

    Examples
    --------
    >>> import deepfsi
    >>> few = deepfsi.Training(epochs=1)
    >>> impulse = deepfsi.learn("digits", photons=1e4, design="impulse", training=few)
    >>> [result] = deepfsi.ideal_observer(impulse, "digits", 1e4)
    >>> result.accuracy > 0.9
    True
    """
    budgets = [check_budget(b) for b in np.atleast_1d(np.asarray(photons, dtype=object))]
    scenes, _ = new_scenes(design.training_scenes, as_dataset(data))
    check_classes(scenes.values, "the ideal observer")
    check_data(design, scenes)
    design.exposure.check("ideal observer")
    scanner = design.scanner()
    rates_of = partial(design.mask_exposure.rates, scanner)
    with torch.no_grad(), progress_bar(report, "ideal observer") as bar:
        rates = rates_of(torch.from_numpy(np.asarray(scenes.x_train)))
        # arrays as large as the rates of all training scenes
        needed = 4 * rates.numel() * rates.element_size()
        check_memory(needed, "likelihoods of these scenes", "give fewer scenes")
        observer = IdealObserver(rates, torch.from_numpy(scenes.y_train), len(scenes.classes))
        shares = rates.mean(dim=0).flatten(0, -2).sum(dim=0)
        del rates

        def expose_of(x: Tensor) -> Expose:
            rates = rates_of(x)

            def answer_once(generator: torch.Generator, budget: float) -> Exposed:
                expected = rates * budget
                probabilities = observer.probabilities(scanner.read(expected, generator), budget)
                counted = float(expected.sum())
                return (probabilities.argmax(dim=-1), probabilities), CountedLight(counted, counted)

            return answer_once

        answers = expose_scenes(
            scenes,
            expose_of,
            budgets,
            shares,
            draws=draws,
            seed=seed,
            noise="poisson",
            kind=ClassAnswers,
            report=bar,
        )
        return list(map(Result.of, answers))
