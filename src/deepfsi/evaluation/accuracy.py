"""Accuracy of a design over budgets, with intervals that say what they cover."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from html import escape
from math import prod
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor

from deepfsi.base import InputError, Progress, progress_bar
from deepfsi.base.numeric import (
    accuracy_curve,
    auc,
    auc_terms,
    balanced_interval,
    confusion_table,
    worst_class,
)
from deepfsi.base.numeric import accuracy_interval as accuracy_of
from deepfsi.camera import Camera, CameraSource, NoiseName, check_budget, find_noise
from deepfsi.datasets import Dataset, Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.designfile import new_scenes
from deepfsi.evaluation.confidence import confidence_error
from deepfsi.evaluation.estimation import test_values
from deepfsi.physics import library_defaults

MOST_DRAWS = 10_000
"""Noise draws of each scene in one test: enough for any interval, and an end in sight."""

COVERS = "test images and noise draws, of one training"
"""What the interval of a test covers."""

OF_IMAGES = ("right", "area_terms")
"""Fields of a `Result` that hold a number for each image."""


@dataclass(frozen=True)
class Result:
    """Accuracy and counts of one design at one budget.

    Attributes
    ----------
    photons : float
        Budget Φ.
    noise : str
        Of this test.
    accuracy, low, high : float
        Mean over images and noise draws, and its 95 % interval (`statistics.intervals.accuracy`).
    covers : str
        What the interval covers.
    images, draws : int
        Scenes, and independent noise draws of each.
    balanced, balanced_low, balanced_high : float
        Mean of the classes' accuracies, and its 95 % interval over test images
        (`statistics.intervals.balanced`).
    rates : list of float or None
        Accuracy of each class (recall); None where the test has no scene of it.
    confusion : list of list of int
        Rows true classes, columns predicted ones, over all draws.
    calibration_error : float
        Mean distance of confidence, the probability of the answer, and accuracy, over 15 groups of
        answers of like confidence, all of one size.
    log_loss : float
        Mean of −ln p of the true class, in nats; a p below 1.2e-7 is taken for that.
    counts : float
        What the detectors count, in the mean over the test scenes: photons without dark counts,
        or clicks.
    arriving : float
        Photons that reach the detectors, in the same mean: `counts`, but of detectors that click.
    throughput : float
        Share of the budget that reaches the detectors, in the training mean; where dwells are
        chosen, at the training's budget. Of masks that are quantised for a test only, it is that
        of the masks before.
    photons_per_mask : list of float
        Expected photons of each mask's rails together, in the training mean; likewise.
    auc, auc_low, auc_high : float or None
        Of two classes, the probability that an exposure of the second gets more of its probability
        than one of the first, the area under the ROC curve, and its 95 % interval over test images
        (`statistics.roc.auc`).
    right : list of float
        Share of the draws of each test image that is answered right, in the order of the images: to
        compare designs on the same images (`statistics.differences.paired`). Not in `as_dict`.
    area_terms : list of float
        Of two classes, terms of the images whose mean is the area (`statistics.roc.auc_terms`).

    Examples
    --------
    >>> from deepfsi import evaluate, learn, load_dataset
    >>> digits = load_dataset("digits")
    >>> design = learn(digits, photons=1e4, masks=6, design="pca", training={"epochs": 1})
    >>> [result] = evaluate(design, digits, 1e4, draws=2)
    >>> result.images * result.draws == sum(map(sum, result.confusion))
    True
    """

    photons: float
    noise: str
    accuracy: float
    low: float
    high: float
    covers: str
    images: int
    draws: int
    balanced: float
    balanced_low: float
    balanced_high: float
    rates: list[float | None]
    confusion: list[list[int]]
    calibration_error: float
    log_loss: float
    counts: float
    arriving: float
    throughput: float
    photons_per_mask: list[float]
    auc: float | None
    auc_low: float | None
    auc_high: float | None
    right: list[float] = field(default_factory=list, repr=False)
    area_terms: list[float] = field(default_factory=list, repr=False)

    def _repr_html_(self) -> str:
        classes = [str(place) for place in range(len(self.confusion))]
        return (
            f"<p>accuracy {self.accuracy:.3f} ({self.low:.3f} to {self.high:.3f}) at "
            f"{self.photons:.3g} photons, {escape(self.noise)} noise</p>"
            f"{confusion_table(self.confusion, classes)}"
        )

    @property
    def clicks(self) -> bool:
        """True of detectors that click, whose counts are fewer than the photons that arrive."""
        return find_noise(self.noise).gates

    @property
    def worst(self) -> int:
        """Place of the class with the lowest accuracy."""
        return worst_class(self.rates)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only, without the numbers of each image."""
        return {name: value for name, value in asdict(self).items() if name not in OF_IMAGES}


class ResultList(list[Result]):
    """Results at several budgets, which a notebook shows as a curve."""

    def _repr_html_(self) -> str:
        points = [(each.photons, each.accuracy, each.low, each.high) for each in self]
        return accuracy_curve(points) if points else ""


@library_defaults()
def evaluate(
    design: Design,
    data: Source,
    photons: Sequence[float] | float,
    *,
    camera: CameraSource = None,
    draws: int = 3,
    seed: int = 0,
    report: Progress | None = None,
    **settings: Any,
) -> list[Any]:
    """Test a design on a data set under noise: a `Result`, or `Estimates`, for each budget.

    Parameters
    ----------
    design : Design
    data : Dataset, str, path or tuple of arrays
        Its test part is used, less what was trained on; its pixels and classes are the design's.
    photons : float or sequence of float
        Budgets Φ.
    camera : Camera, str, path or mapping, optional
        Whose noise, dark counts and read noise are in force; the design's own unless given.
    draws : int
        Noise draws of each scene (1 is enough without noise).
    seed : int
        Of the noise.
    report : Report, optional
        Where to say how far it is; a bar where a terminal is attached unless given.
    settings
        Fields of the camera in place of its own, such as ``noise="gaussian", sigma=2``.

    Raises
    ------
    InputError
        If the data does not fit the design, or a budget is not finite and above 0.

    Examples
    --------
    >>> import deepfsi
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=6, training=few)
    >>> [result] = deepfsi.evaluate(design, "digits", 1e4, draws=1)
    >>> result.low < result.accuracy < result.high
    True
    """
    budgets = [check_budget(b) for b in np.atleast_1d(np.asarray(photons, dtype=object))]
    scenes, left = new_scenes(design.training_scenes, as_dataset(data))
    check_data(design, scenes)
    check_draws(draws, seed)
    known = camera_for(design, camera, **settings)
    title = f"{design.name}, {design.masks} masks"
    front = design.front_end(known)
    if design.values:
        with progress_bar(report, title) as bar:
            values = test_values(design, front, scenes, budgets, draws, seed, bar)
        return [replace(each, covers=covered(each.covers, left)) for each in values]
    shares = design.shares.view(design.masks, -1).sum(dim=1)
    guess_of = guesses(design, front)
    with progress_bar(report, title) as bar:
        results = test_scenes(scenes, guess_of, budgets, draws, seed, known.noise_name, shares, bar)
    return ResultList(replace(each, covers=covered(each.covers, left)) for each in results)


def covered(covers: str, left: str | None) -> str:
    """Words on what an interval covers, with the scenes that were left out."""
    return covers if left is None else f"{covers}; {left}"


TINY = torch.finfo(torch.float32).tiny
"""Least probability that the log-odds are taken of."""

LEAST_CHANCE = torch.finfo(torch.float32).eps
"""Least probability of a true class that the log loss is taken of."""

Guess = Callable[[torch.Generator, float], tuple[Tensor, Tensor, float, float]]
"""Exposes scenes once at a budget: classes (b,), which rounded probabilities may not tell apart,
probabilities (b, C), and the sums of expected counts and of the photons that arrive."""


def guesses(design: Design, front: Any) -> Callable[[Tensor], Guess]:
    """Answers of a design to exposures of scenes (b, N)."""

    def guess_of(x: Tensor) -> Guess:
        rates = design.rates(front, x)

        def guess(generator: torch.Generator, budget: float) -> tuple[Tensor, Tensor, float, float]:
            seen = design.exposure.expose(front, rates, budget, generator)
            answer = design.answer(seen, budget)
            light = design.exposure.light(front, rates, seen, budget)
            return answer.classes, answer.chances, light.counts, light.photons

        return guess

    return guess_of


def camera_for(design: Design, camera: CameraSource = None, **settings: Any) -> Camera:
    """Camera of a test, the design's own unless given, with other settings such as the noise."""
    # A noise of its maker's own is code, which a file must not run: it is to be given
    found = design.camera if camera is None else Camera.load(camera)
    if "noise" not in settings and camera is None and found.noise_name not in get_args(NoiseName):
        raise InputError(
            "this design is for {noise_name} noise, code of its maker's that a file does not run: "
            "give {noise}, it or another",
            setting="noise",
            noise_name=found.noise_name,
        )
    return Camera.load(found, **settings)


def test_scenes(
    data: Dataset,
    guess_of: Callable[[Tensor], Guess],
    budgets: Sequence[float],
    draws: int,
    seed: int,
    noise: str,
    shares: Tensor,
    report: Progress,
) -> list[Result]:
    """Results of the answers of a rule to the test scenes of a data set, at each budget."""
    # shares (m,) of the budget that each mask counts
    generators = [torch.Generator(shares.device).manual_seed(seed) for _ in budgets]
    confusions = np.zeros((len(budgets), len(data.classes), len(data.classes)), dtype=np.int64)
    # confidence, if the answer is right, probability of the true class, log-odds of the last class
    # over the first, and place of the scene
    answers: list[list[np.ndarray]] = [[] for _ in budgets]
    light = np.zeros((len(budgets), 2))  # counts and photons
    chunks = torch.arange(len(data.x_test)).split(1024)
    with torch.no_grad():
        for done, rows in enumerate(chunks, start=1):
            some = rows.numpy()  # NumPy takes a tensor of one number for the number itself
            guess, truth = guess_of(torch.from_numpy(data.x_test[some])), data.y_test[some]
            for place, (budget, generator) in enumerate(zip(budgets, generators, strict=True)):
                for _ in range(draws):
                    classes, given, *sums = guess(generator, budget)
                    found, chances = classes.cpu().numpy(), given.cpu().numpy()
                    true = chances[np.arange(len(truth)), truth]
                    np.add.at(confusions[place], (truth, found), 1)
                    odds = np.subtract(*np.log(chances[:, [-1, 0]].clip(min=TINY).T))
                    told = chances.max(axis=1), found == truth, true, odds, rows.numpy()
                    answers[place].append(np.stack(told))
                    light[place] += sums
            report(done / len(chunks))
    means = (light / (draws * len(data.x_test))).tolist()
    return ResultList(
        _result(
            budget,
            noise,
            confusion,
            np.concatenate(told, axis=1),
            mean,
            shares.tolist(),
            data.y_test,
        )
        for budget, confusion, told, mean in zip(budgets, confusions, answers, means, strict=True)
    )


def check_data(design: Design, data: Dataset) -> None:
    """Raise `InputError` unless a design can classify the scenes of a data set."""
    pixels = prod(design.image_shape)
    if data.pixels != pixels:
        raise InputError(
            "{name} has {pixels} pixels and the design {expected}: use the data (and {size}) that "
            "it was made for",
            setting="size",
            name=data.name,
            pixels=data.pixels,
            expected=pixels,
        )
    values = design.values.names if design.values else ()
    if data.values != values:
        here, there = (", ".join(names) or "classes" for names in (data.values, values))
        raise InputError(f"{data.name} has {here}, and the design answers {there}: use such data")
    if data.classes != design.classes:
        raise InputError(
            f"{data.name} has other classes than the design ({', '.join(design.classes[:12])})"
        )
    if data.image_shape != design.image_shape:
        raise InputError(
            f"{data.name} has scenes of shape {data.image_shape} and the design "
            f"{design.image_shape}: use the data that it was made for"
        )


def check_draws(draws: object, seed: int) -> None:
    """Raise `InputError` unless so many noise draws can be had from that seed."""
    if not 0 <= seed < 2**63:
        raise InputError(f"seed {seed} is not allowed: give a whole number from 0 to 2⁶³ − 1")
    if not isinstance(draws, int) or not 1 <= draws <= MOST_DRAWS:
        raise InputError(f"{draws} noise draws are not allowed: give 1 to {MOST_DRAWS}")


def _result(
    budget: float,
    noise: str,
    confusion: np.ndarray,
    answers: np.ndarray,
    light: list[float],
    share: list[float],
    labels: np.ndarray,
) -> Result:
    """`Result` of a confusion matrix (C, C) and answers (5, E) of all draws; labels (n,)."""
    images = len(labels)
    draws = answers.shape[1] // images
    sure, right, true, odds, places = answers
    order = np.argsort(places, kind="stable")
    each = right[order].reshape(images, draws).mean(axis=1, dtype=float)
    terms: np.ndarray = np.zeros(0)
    area: tuple[float, float, float] | tuple[None, None, None] = (None, None, None)
    if len(confusion) == 2 and confusion.any(axis=1).all():
        terms = auc_terms(odds[order].reshape(images, draws), labels == 1)
        area = auc(terms, labels == 1)
    _, low, high = accuracy_of(each)
    rates = [float(row[k] / row.sum()) if row.any() else None for k, row in enumerate(confusion)]
    counts, arriving = light
    mean, lower, upper = balanced_interval(each, labels)
    return Result(
        photons=budget,
        noise=noise,
        accuracy=float(confusion.trace() / confusion.sum()),
        low=low,
        high=high,
        covers=COVERS,
        images=images,
        draws=draws,
        balanced=mean,
        balanced_low=lower,
        balanced_high=upper,
        rates=rates,
        confusion=confusion.tolist(),
        calibration_error=confidence_error(sure, right),
        log_loss=float(-np.log(true.clip(min=LEAST_CHANCE)).mean(dtype=float)),
        counts=counts,
        arriving=arriving,
        throughput=sum(share),
        photons_per_mask=[budget * part for part in share],
        **dict(zip(("auc", "auc_low", "auc_high"), area, strict=True)),
        right=each.tolist(),
        area_terms=terms.tolist(),
    )
