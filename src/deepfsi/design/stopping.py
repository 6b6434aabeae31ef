"""Early stopping: masks in sequence, or looks, and an answer as soon as it is sure enough.

After each mask of a nested design, from the fewest on that do by themselves, or after each look of
a design of several, an exposure is classified with what has been counted so far. It stops where
the confidence of the answer, the probability of the likeliest class, is above a threshold. Photons
that a stopped exposure has taken are the first of those that the whole one takes: nothing is drawn
again.

A network's own probabilities are rarely right, so each number of masks or looks has a temperature
that divides the logits. It is fitted on scenes that were held out of the training. The threshold is
chosen on the same scenes, of which each half has the temperatures of the other; the test scenes are
read once.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, logsumexp
from torch import Tensor

from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import check_data, check_draws
from deepfsi.errors import InputError
from deepfsi.optics.budget import check_budget
from deepfsi.optics.scanner import Scanner, subtract
from deepfsi.statistics.intervals import wilson

THRESHOLDS = 1 - np.geomspace(0.5, 1e-7, 135)
"""Confidences that are tried, and 1, which none is above."""

BINS = 15
"""Groups of answers of like confidence, all of one size, in which calibration is measured."""

SHARES = tuple(k / 20 for k in range(10, 21))
"""Shares of accepted answers at which rejection is shown."""

COVERS = "test images and noise draws, for this one trained design (images as the trials)"


@dataclass(frozen=True)
class StoppingRule:
    """When an exposure stops.

    Attributes
    ----------
    after : tuple of int
        Numbers of masks, or of looks, after which it may, rising; the last is all.
    temperatures : tuple of float
        What the logits are divided by, after each.
    threshold : float
        Confidence above which it stops; 1 for never before the end.
    """

    after: tuple[int, ...]
    temperatures: tuple[float, ...]
    threshold: float

    def classify(
        self, design: Design, counts: ArrayLike, photons: float
    ) -> tuple[np.ndarray, bool]:
        """Classify an exposure of a nested design that goes on, and say whether it may stop.

        Parameters
        ----------
        design : Design
            The one that the rule was made for.
        counts : array, shape (2, k) for dual-rail designs, (k,) for single-rail ones
            Counts of the first k masks.
        photons : float
            Budget of the whole exposure.

        Returns
        -------
        chances : array, shape (C,)
            Calibrated probabilities of the classes.
        stop : bool

        Raises
        ------
        InputError
            If k is not one of `after`.
        """
        read = np.asarray(counts, dtype=np.float32)
        shown = read.shape[-1] if read.ndim else 0
        if shown not in self.after:
            raise InputError(
                f"counts of {shown} masks cannot be judged: give those of {self.after[0]} to "
                f"{self.after[-1]} masks"
            )
        part = design.first(shown)
        return self.decide(shown, part.classify(read, photons * part.used / design.used))

    def decide(self, shown: int, chances: np.ndarray) -> tuple[np.ndarray, bool]:
        """Calibrate probabilities (C,) after so many masks or looks, and say whether to stop.

        For `Design.classify_live`.

        Raises
        ------
        InputError
            If an exposure is not judged after so many.
        """
        if shown not in self.after:
            raise InputError(
                f"an exposure is not judged after {shown}: this rule is for {self.after[0]} to "
                f"{self.after[-1]} masks or looks"
            )
        log = np.log(np.maximum(chances, np.finfo(np.float32).tiny).astype(float))
        calibrated = np.exp(log_softmax(log / self.temperatures[self.after.index(shown)]))
        return calibrated, bool(shown == self.after[-1] or calibrated.max() > self.threshold)


@dataclass(frozen=True)
class Rate:
    """A mean over images and noise draws with its 95 % interval."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Stopped:
    """One design at one budget, its exposures stopped early.

    Attributes
    ----------
    photons : float
        Budget Φ of the whole exposure.
    rule : StoppingRule
    used : Rate
        Share of the budget that exposures take: of looks, share of their time.
    whole, stopped, difference : Rate
        Accuracy of whole exposures, of stopped ones, and the second less the first, paired.
    stops : list of float
        Share of exposures that end after each of `rule.after`.
    confidence : float
        Mean confidence of the answers given.
    calibration_error, uncalibrated_error : float
        Mean distance of confidence and accuracy over `BINS` groups of the answers given, with
        temperatures and without.
    log_loss, uncalibrated_log_loss : float
        Mean −ln of the probability of the true class, over whole exposures and all shorter ones.
    reliability : list of dict
        `confidence` and `accuracy` of each group.
    rejection : list of dict
        `accepted`, the share of answers kept, the surest first, and their accuracy: `stopped`, and
        `whole` where exposures do not stop early.
    curve : list of dict
        `threshold`, `used` and `accuracy` for every threshold tried.
    validation : dict
        `used`, `whole` and `stopped` on the scenes on which the threshold was chosen.
    images, draws : int
        Test scenes, and independent noise draws of each.
    covers : str
        What the intervals cover.
    """

    photons: float
    rule: StoppingRule
    used: Rate
    whole: Rate
    stopped: Rate
    difference: Rate
    stops: list[float]
    confidence: float
    calibration_error: float
    uncalibrated_error: float
    log_loss: float
    uncalibrated_log_loss: float
    reliability: list[dict[str, float]]
    rejection: list[dict[str, float]]
    curve: list[dict[str, float]]
    validation: dict[str, float]
    images: int
    draws: int
    covers: str = COVERS

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return asdict(self)


def stop(
    design: Design,
    data: Dataset,
    photons: float,
    *,
    held_out: int | None = None,
    threshold: float | None = None,
    draws: int = 3,
    seed: int = 0,
) -> Stopped:
    """Choose when to stop on held-out scenes, and test it on the test scenes.

    Parameters
    ----------
    design : Design
        Of several looks, or nested, one whose masks are shown in sequence; trained on
        ``data.hold_out(held_out)``.
    data : Dataset
    photons : float
        Budget Φ of the whole exposure.
    held_out : int, optional
        Last training scenes that the training left out; a sixth unless given.
    threshold : float, optional
        Confidence above which to stop, 0 to 1; chosen unless given.
    draws : int
        Noise draws of each scene.
    seed : int
        Of the noise and the halves; whole exposures are those of `evaluation.evaluate` with this
        seed.

    Returns
    -------
    Stopped

    Raises
    ------
    InputError
        If the design cannot stop early, the data does not fit it, or it was trained on the scenes
        that would be held out.
    """
    budget = check_budget(photons)
    check_draws(draws, seed)
    check_data(design, data)
    after, share = _places(design)
    if threshold is not None and not 0 <= threshold <= 1:
        raise InputError(f"threshold {threshold!r} is not a confidence: give 0 to 1")
    kept = data.hold_out(held_out)
    if kept.hash != design.info.get("data", {}).get("hash"):
        raise InputError(
            f"this design was not trained on {data.name} without its last {len(kept.y_test)} "
            "training scenes, which calibrate its confidence: learn it with "
            f"--hold-out {len(kept.y_test)}"
        )
    seen = _Exposures(design, kept.x_test, kept.y_test, budget, after, draws, seed ^ 2**31)
    # at random: the images of MNIST come from two sources by turns
    half = np.random.default_rng(seed).permutation(len(kept.x_test))[seen.images] % 2 == 0
    halves = np.array(
        [
            [_temperature(logits[part], seen.labels[part]) for part in (half, ~half)]
            for logits in seen.answers()
        ]
    )
    choice = _Answers(seen, [np.where(half, b, a)[:, None] for a, b in halves])
    if threshold is None:
        threshold = choice.least_threshold(share)
    temperatures = np.sqrt(halves.prod(axis=1)).tolist()
    rule = StoppingRule(after, tuple(temperatures), float(threshold))
    test = _Exposures(design, data.x_test, data.y_test, budget, after, draws, seed)
    return _result(rule, _Answers(test, temperatures), choice, share, budget, draws)


def _places(design: Design) -> tuple[tuple[int, ...], np.ndarray]:
    """Numbers of masks or looks after which a design may stop, and the photons used, of all."""
    if design.schedule is not None:
        looks = design.schedule.looks
        return tuple(range(1, looks + 1)), np.arange(1, looks + 1) / looks
    after = tuple(range(fewest_masks(design), design.masks + 1))
    return after, np.array([design.first(k).used for k in after]) / design.used


def fewest_masks(design: Design) -> int:
    """Fewest masks of a design that do by themselves, shown in sequence, or `InputError`."""
    fewest = int(design.info.get("job", {}).get("training", {}).get("nested", 0))
    if not 0 < fewest < design.masks:
        raise InputError(
            "this design needs all its masks for an answer: learn nested ones with --nested, or "
            "several looks with --looks"
        )
    if design.light == "column":
        raise InputError(
            "under the column constraint all masks see light at once, so that stopping saves "
            "nothing: use a design for one device, --light free-dwell or equal-dwell"
        )
    return fewest


class _Exposures:
    """Whole exposures of scenes, and what a design says after each number of masks or looks."""

    def __init__(
        self,
        design: Design,
        x: np.ndarray,
        labels: np.ndarray,
        photons: float,
        after: Sequence[int],
        draws: int,
        seed: int,
    ) -> None:
        self.design, self.photons, self.after = design, photons, after
        self.images = np.repeat(np.arange(len(x)), draws)
        self.labels = labels[self.images]
        device = design.rails.device
        scanner, generator = design.scanner(), torch.Generator(device).manual_seed(seed)
        drawn = []
        with torch.no_grad():
            for rows in torch.arange(len(x)).split(1024):
                rates = scanner.rates(
                    torch.from_numpy(x[rows]).to(device) / design.summed_reflectance
                )
                several = [self._draw(scanner, rates, generator) for _ in range(draws)]
                drawn.append(torch.stack(several, dim=-2).flatten(-3, -2))
        self.drawn = torch.cat(drawn, dim=-2)

    def _draw(self, scanner: Scanner, rates: Tensor, generator: torch.Generator) -> Tensor:
        """Features (B, m) of one draw, or logits (K, B, C) after each of K looks."""
        if self.design.schedule is None:
            return subtract(scanner.read(rates * self.photons, generator))
        looks = self.design.expose(scanner, rates, generator, self.photons)
        return torch.stack([self.design.adaptive_logits(seen) for seen in looks])

    def answers(self) -> Iterator[np.ndarray]:
        """Logits (E, C) after each number of masks or looks."""
        for place, shown in enumerate(self.after):
            if self.design.schedule is not None:
                logits = self.drawn[place]
            else:
                part = self.design.first(shown)
                so_far = self.photons * part.used / self.design.used
                with torch.no_grad():
                    logits = part.logits(self.drawn[:, :shown], so_far)
            yield logits.double().cpu().numpy()


class _Answers:
    """Guesses and their confidences, (E, K) for E exposures and K numbers of masks."""

    def __init__(self, seen: _Exposures, temperatures: Sequence[Any]) -> None:
        labels, self.images = seen.labels, seen.images
        sure, raw, right, self.log_loss, self.raw_log_loss = [], [], [], 0.0, 0.0
        for logits, temperature in zip(seen.answers(), temperatures, strict=True):
            calibrated, plain = (
                log_softmax(each, axis=1) for each in (logits / temperature, logits)
            )
            sure.append(np.exp(calibrated.max(axis=1)))
            raw.append(np.exp(plain.max(axis=1)))
            right.append(plain.argmax(axis=1) == labels)
            true = np.arange(len(labels)), labels
            self.log_loss -= float(calibrated[true].mean()) / len(temperatures)
            self.raw_log_loss -= float(plain[true].mean()) / len(temperatures)
        self.sure, self.raw, self.right = (np.stack(part, axis=1) for part in (sure, raw, right))

    def ends(self, threshold: float) -> np.ndarray:
        """Place (E,) of the number of masks after which each exposure ends."""
        enough = self.sure > threshold
        enough[:, -1] = True
        return enough.argmax(axis=1)

    def at(self, values: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Entries (E,) of values (E, K) at the ends."""
        return values[np.arange(len(ends)), ends]

    def least_threshold(self, share: np.ndarray) -> float:
        """The threshold of fewest photons whose accuracy is not below that of whole exposures."""
        whole = self.right[:, -1].mean()
        costs = [(share[-1], 1.0)]
        for threshold in THRESHOLDS:
            ends = self.ends(threshold)
            if self.at(self.right, ends).mean() >= whole:
                costs.append((share[ends].mean(), float(threshold)))
        return min(costs)[1]

    def rate(self, values: np.ndarray, spread: bool = True) -> Rate:
        """Mean of values (E,) over draws and images, the images as the trials."""
        each = np.bincount(self.images, values) / np.bincount(self.images)
        mean, count = float(each.mean()), len(each)
        if not spread:
            return Rate(mean, *wilson(mean, count))
        half = 1.96 * float(each.std(ddof=1)) / count**0.5
        return Rate(mean, mean - half, mean + half)


def _result(
    rule: StoppingRule,
    test: _Answers,
    choice: _Answers,
    share: np.ndarray,
    photons: float,
    draws: int,
) -> Stopped:
    ends, chosen = test.ends(rule.threshold), choice.ends(rule.threshold)
    sure, right = test.at(test.sure, ends), test.at(test.right, ends)
    curve = []
    for threshold in (*THRESHOLDS.tolist(), 1.0):
        stops = test.ends(threshold)
        accuracy = float(test.at(test.right, stops).mean())
        curve.append(
            {"threshold": threshold, "used": float(share[stops].mean()), "accuracy": accuracy}
        )
    groups = _groups(sure, right)
    last = np.full_like(ends, len(share) - 1)
    return Stopped(
        photons=photons,
        rule=rule,
        used=test.rate(share[ends]),
        whole=test.rate(test.right[:, -1], spread=False),
        stopped=test.rate(right, spread=False),
        difference=test.rate(right.astype(float) - test.right[:, -1]),
        stops=(np.bincount(ends, minlength=len(share)) / len(ends)).tolist(),
        confidence=float(sure.mean()),
        calibration_error=_calibration_error(groups),
        uncalibrated_error=_calibration_error(_groups(test.at(test.raw, ends), right)),
        log_loss=test.log_loss,
        uncalibrated_log_loss=test.raw_log_loss,
        reliability=[{"confidence": one, "accuracy": other} for one, other, _ in groups],
        rejection=[
            {
                "accepted": accepted,
                "stopped": _accepted(sure, right, accepted),
                "whole": _accepted(test.at(test.sure, last), test.right[:, -1], accepted),
            }
            for accepted in SHARES
        ],
        curve=curve,
        validation={
            "used": float(share[chosen].mean()),
            "whole": float(choice.right[:, -1].mean()),
            "stopped": float(choice.at(choice.right, chosen).mean()),
        },
        images=int(test.images.max()) + 1,
        draws=draws,
    )


def _log_loss(logits: np.ndarray, labels: np.ndarray) -> float:
    """Mean −ln of the probability of the true class."""
    true = logits[np.arange(len(labels)), labels]
    return float((logsumexp(logits, axis=1) - true).mean())


def _temperature(logits: np.ndarray, labels: np.ndarray) -> float:
    """Temperature from 1/20 to 20 that gives these scenes the least log loss."""
    found = minimize_scalar(
        lambda log: _log_loss(logits / np.exp(log), labels),
        bounds=(-np.log(20), np.log(20)),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(np.exp(found.x))


def _groups(sure: np.ndarray, right: np.ndarray) -> list[tuple[float, float, float]]:
    """Confidence, accuracy and weight of answers in `BINS` groups, the least sure first."""
    order = np.argsort(sure, kind="stable")
    return [
        (float(sure[part].mean()), float(right[part].mean()), len(part) / len(sure))
        for part in np.array_split(order, min(BINS, len(order)))
    ]


def _calibration_error(groups: Sequence[tuple[float, float, float]]) -> float:
    return sum(weight * abs(sure - right) for sure, right, weight in groups)


def _accepted(sure: np.ndarray, right: np.ndarray, share: float) -> float:
    """Accuracy of that share of answers, the surest."""
    kept = np.argsort(-sure, kind="stable")[: max(1, round(share * len(sure)))]
    return float(right[kept].mean())
