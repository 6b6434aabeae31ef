"""Early stopping: an exposure ends as soon as the classifier is confident enough.

After each mask of a nested design, from the smallest number that can be classified alone, an
exposure is classified from the counts so far. It stops when
the confidence, the probability of the most probable class, exceeds a threshold. A stopped exposure
and the whole one share their random draws: the counts of the first are the first counts of the
second.

The probabilities are calibrated (`confidence`). The threshold is chosen on scenes that were held
out of the training, at one budget, and holds near that one only. The test scenes are used once.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from pydantic import model_serializer
from scipy.special import log_softmax

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.numeric.intervals import accuracy_interval
from deepfsi.base.quantities import Table, budget_text, confidence_text
from deepfsi.camera.light import check_budget
from deepfsi.camera.stop_rule import StopRule
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.designfile.provenance import new_scenes, trained_on
from deepfsi.evaluation.accuracy import check_data, check_draws, coverage_text
from deepfsi.evaluation.confidence import CalibrationScenes, logits_at_stops
from deepfsi.exposure.kind import Stops
from deepfsi.measures.reliability import calibration_error, confidence_error, confidence_groups
from deepfsi.networks.temperatures import stop_temperatures
from deepfsi.networks.values import check_classes
from deepfsi.physics.surroundings import library_defaults

THRESHOLDS = 1 - np.geomspace(0.5, 1e-7, 135)
"""Confidences that are tried, and 1, which none is above."""

ACCEPTED_SHARES = tuple(k / 20 for k in range(10, 21))
"""Shares of accepted answers at which rejection is shown."""

STOPPED_COVER = "test images and noise draws, for this one trained design (images as the trials)"


@dataclass(frozen=True)
class MeanEstimate:
    """Mean over images and noise draws with its 95 % interval."""

    mean: float
    low: float
    high: float


class StoppingRule(StopRule):
    """When an exposure stops, and where it may."""

    after: tuple[int, ...]
    """Numbers of masks after which it may, rising; the last is all."""

    @model_serializer
    def as_dict(self) -> dict[str, Any]:
        """JSON types only, in the order that files and pages have."""
        return {"after": list(self.after), "threshold": self.threshold, "photons": self.photons}

    def classify(
        self, design: Design, counts: ArrayLike, photons: float
    ) -> tuple[np.ndarray, bool]:
        """Classify the counts (2, k) or (k,) of the first k masks, and say if it may stop."""
        read = np.asarray(counts, dtype=np.float32)
        shown = read.shape[-1] if read.ndim else 0
        if shown not in self.after:
            raise InputError(
                f"counts of {shown} masks cannot be judged: give those of {self.after[0]} to "
                f"{self.after[-1]} masks"
            )
        part = design.first(shown)
        chances = part.classify(read, photons * part.mask_exposure.used / design.mask_exposure.used)
        return chances, shown == self.after[-1] or bool(self.stops(chances.max(), photons))


def with_rule(design: Design, rule: StoppingRule) -> Design:
    """The design with a rule of when an exposure stops."""
    # the design says after what
    numbers = {"threshold": rule.threshold, "photons": rule.photons}
    exposure = design.exposure.stopping_at(rule.threshold)
    return replace(design, exposure=exposure, info={**design.info, "stopping": numbers})


def share_light(design: Design, scenes: CalibrationScenes, photons: float, *, seed: int) -> Design:
    """The design whose exposures end so that scenes take the budget in the mean."""
    exposures = []
    with torch.no_grad():
        for part in scenes.parts:
            reader = replace(part.design, temperatures=design.temperatures)
            kind = reader.mask_exposure
            generator = torch.Generator(kind.device).manual_seed(seed)
            for x in torch.from_numpy(part.x).split(kind.exposed_at_once):
                rates = reader.rates(part.front, x)
                exposures += [
                    kind.at_stops(part.front, rates, photons, generator, network=reader)
                    for _ in range(scenes.draws)
                ]
        stops = design.exposure.stops
        confidence = np.concatenate([each.confidence for each in exposures])
        threshold = stops.threshold(confidence, 1.0)
        counted = torch.zeros_like(design.shares)
        whole = torch.zeros_like(design.shares)
        for each in exposures:
            ends = stops.ends(each.confidence, threshold)
            counted += each.counted(ends)
            whole += each.counted(np.full_like(ends, len(stops.after) - 1))
    share = torch.where(whole > 0, counted / whole, 0.0)
    rule = StoppingRule(after=stops.after, threshold=threshold, photons=photons)
    shared = with_rule(design, rule)
    exposure = shared.mask_exposure
    return replace(shared, exposure=exposure.with_optics(shares=exposure.shares * share))


def rule_of(design: Design) -> StoppingRule | None:
    """Rule that a design holds, if it holds one."""
    numbers = design.info.get("stopping")
    if numbers is None:
        return None
    after = design.exposure.stops.after
    with as_input_error("the design's stopping rule", "make it again with `deepfsi stop`"):
        return StoppingRule.model_validate({"after": after, **numbers})


@dataclass(frozen=True)
class Stopped:
    """One design at one budget, its exposures stopped early."""

    photons: float  # budget Φ of the whole exposure
    rule: StoppingRule
    used: MeanEstimate  # share of the budget that exposures take
    whole: MeanEstimate
    stopped: MeanEstimate
    difference: MeanEstimate
    stops: list[float]  # share of exposures that end after each of `rule.after`
    confidence: float  # mean confidence of the answers given
    calibration_error: float
    uncalibrated_error: float
    log_loss: float
    uncalibrated_log_loss: float
    reliability: list[dict[str, float]]  # `confidence` and `accuracy` of each group
    rejection: list[dict[str, float]]
    curve: list[dict[str, float]]  # `threshold`, `used` and `accuracy` for every threshold tried
    validation: dict[str, float]
    images: int
    draws: int
    covers: str = STOPPED_COVER  # what the intervals cover

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return asdict(self) | {"rule": self.rule.as_dict()}

    def lines(self, size: str) -> Iterator[str | Table]:
        """Say what stopping saves and costs, of a design whose size is said in words."""
        rates = {
            "share of photons used": self.used,
            "accuracy, whole exposures": self.whole,
            "accuracy, stopped": self.stopped,
            "difference, paired": self.difference,
        }
        yield Table(
            f"{size}, {budget_text(self.photons)} photons, stopped above "
            f"{confidence_text(self.rule.threshold)}",
            ("", "mean", "95 % interval"),
            [
                (head, f"{rate.mean:.4f}", f"[{rate.low:.4f}, {rate.high:.4f}]")
                for head, rate in rates.items()
            ],
        )
        yield (
            f"calibration error of the answers: {self.calibration_error:.4f} "
            f"({self.uncalibrated_error:.4f} without temperatures)"
        )
        surest = {round(each["accepted"], 2): each["stopped"] for each in self.rejection}
        yield (
            f"the surest 90 % of the answers: {surest[0.9]:.4f} right; the surest half: "
            f"{surest[0.5]:.4f}"
        )
        yield f"interval: {self.covers}"


class _Confidence:
    """Confidence (E, K) of answers after each of K stops, whether they are right, and log loss.

    Logits (K, E, C) are those of `logits_at_stops`, classes (E,) the true ones, and temperatures
    (K,) divide the logits at each stop.
    """

    def __init__(self, logits: np.ndarray, classes: np.ndarray, temperatures: np.ndarray) -> None:
        shape = logits.shape[1::-1]
        self.values = np.empty(shape)
        self.right = np.empty(shape, dtype=bool)
        self.log_loss = 0.0
        for stop, temperature in enumerate(temperatures):
            logs = log_softmax(logits[stop].astype(float) / temperature, axis=1)
            self.values[:, stop] = np.exp(logs.max(axis=1))
            self.right[:, stop] = logs.argmax(axis=1) == classes
            true = logs[np.arange(len(classes)), classes]
            self.log_loss -= float(true.mean()) / len(temperatures)


class _Answers:
    """Answers of E exposures at K stops, with temperatures and without; labels (n,) of scenes."""

    def __init__(self, logits: np.ndarray, labels: np.ndarray, temperatures: np.ndarray) -> None:
        self.images = np.repeat(np.arange(len(labels)), logits.shape[1] // len(labels))
        self.calibrated = _Confidence(logits, labels[self.images], temperatures)
        self.plain = _Confidence(logits, labels[self.images], np.ones(len(temperatures)))
        self.right = self.plain.right

    def ends(self, threshold: float) -> np.ndarray:
        """Stop (E,), from 0, at which each exposure ends."""
        return Stops.ends(self.calibrated.values, threshold)

    def curve(self, used: np.ndarray) -> list[dict[str, float]]:
        """Share of the light and accuracy at each threshold; stops take shares (K,)."""
        points = []
        for threshold in (*THRESHOLDS.tolist(), 1.0):
            ends = self.ends(threshold)
            accuracy = float(_at(self.right, ends).mean())
            light = float(used[ends].mean())
            points.append({"threshold": threshold, "used": light, "accuracy": accuracy})
        return points

    def estimate(self, values: np.ndarray) -> MeanEstimate:
        """Mean of values (E,), normal over the images; of true or false `accuracy`'s."""
        each = np.bincount(self.images, values) / np.bincount(self.images)
        if values.dtype == bool:
            return MeanEstimate(*accuracy_interval(each))
        mean = float(each.mean())
        half = 1.96 * float(each.std(ddof=1)) / len(each) ** 0.5
        return MeanEstimate(mean, mean - half, mean + half)


def _at(values: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Entries (E,) of values (E, K) at the stops (E,) at which exposures end."""
    return values[np.arange(len(ends)), ends]


def _surest(confidence: np.ndarray, right: np.ndarray) -> list[float]:
    """Accuracy of each of `ACCEPTED_SHARES` of the answers, the surest."""
    sorted_right = right[np.argsort(-confidence, kind="stable")]
    kept = (max(1, round(share * len(right))) for share in ACCEPTED_SHARES)
    return [float(sorted_right[:count].mean()) for count in kept]


@library_defaults()
def stop(
    design: Design,
    data: Source,
    photons: float,
    *,
    held_out: int | None = None,
    threshold: float | None = None,
    mean_light: float | None = None,
    draws: int = 3,
    seed: int = 0,
) -> Stopped:
    """Choose when to stop on held-out scenes, and test it on the test scenes.

    The threshold is that of the fewest photons whose accuracy is not below that of whole exposures;
    or that at which the held-out scenes take `mean_light` in the mean, so that scenes share it.

    Parameters
    ----------
    design : Design
        Nested, or of adaptive masks.
    data : Dataset, str, path or tuple of arrays
        Of its training. Test scenes that were trained on are left out.
    photons : float
        Budget Φ of whole exposures.
    held_out : int, optional
        Last training scenes that the training left out; those that the design names unless given.
    threshold : float, optional
        Confidence above which to stop, from 0 to 1, in place of the choice.
    mean_light : float, optional
        Photons that exposures are to take in the mean, in place of the choice, at most `photons`.
    draws : int
        Noise draws of each scene.
    seed : int
        Of the noise.

    Raises
    ------
    InputError
        If the design has one stop or was trained on the held-out scenes, or a value is not allowed.
    """
    check_classes(design.values, "a stopping rule")
    budget = check_budget(photons)
    check_draws(draws, seed)
    scenes = as_dataset(data)
    check_data(design, scenes)
    stops = design.exposure.stops
    after, used = stops
    if threshold is not None and not 0 <= threshold <= 1:
        raise InputError(f"threshold {threshold!r} is not a confidence: give 0 to 1")
    if mean_light is not None and not 0 < mean_light <= budget:
        raise InputError(
            "{given:g} photons in the mean are not of exposures of {budget:g}: give {mean_light} "
            "above 0 and at most that",
            setting="mean_light",
            given=mean_light,
            budget=budget,
        )
    if mean_light is not None and threshold is not None:
        raise InputError(
            "a threshold is given, or found for a mean light: leave {threshold} or {mean_light} "
            "out",
            setting=("threshold", "mean_light"),
        )
    kept = _held_out(design, scenes, held_out)
    front = design.front_end()
    temperatures = np.ones(len(after))
    if design.temperatures is not None:
        temperatures = stop_temperatures(design.temperatures, budget)

    def answers(part: Dataset, seed: int) -> _Answers:
        logits = logits_at_stops(design, front, part.x_test, budget, draws=draws, seed=seed)
        return _Answers(logits, part.y_test, temperatures)

    choice = answers(kept, seed ^ 2**31)
    if mean_light is not None:
        threshold = stops.threshold(choice.calibrated.values, mean_light / budget)
    elif threshold is None:
        accuracy = choice.right[:, -1].mean()
        curve = choice.curve(used)[:-1]
        costs = [(p["used"], p["threshold"]) for p in curve if p["accuracy"] >= accuracy]
        threshold = min([(float(used[-1]), 1.0), *costs])[1]
    fresh, left = new_scenes(design.training_scenes, scenes)
    test = answers(fresh, seed)
    ends = test.ends(threshold)
    chosen = choice.ends(threshold)
    right = _at(test.right, ends)
    whole = test.right[:, -1]
    confidence = _at(test.calibrated.values, ends)
    groups = confidence_groups(confidence, right)
    kept_early = _surest(confidence, right)
    kept_whole = _surest(test.calibrated.values[:, -1], whole)
    return Stopped(
        photons=budget,
        rule=StoppingRule(after=after, threshold=float(threshold), photons=budget),
        used=test.estimate(used[ends]),
        whole=test.estimate(whole),
        stopped=test.estimate(right),
        difference=test.estimate(right.astype(float) - whole),
        stops=(np.bincount(ends, minlength=len(used)) / len(ends)).tolist(),
        confidence=float(confidence.mean()),
        calibration_error=calibration_error(groups),
        uncalibrated_error=confidence_error(_at(test.plain.values, ends), right),
        log_loss=test.calibrated.log_loss,
        uncalibrated_log_loss=test.plain.log_loss,
        reliability=[{"confidence": one, "accuracy": other} for one, other, _ in groups],
        rejection=[
            {"accepted": accepted, "stopped": early, "whole": late}
            for accepted, early, late in zip(ACCEPTED_SHARES, kept_early, kept_whole, strict=True)
        ],
        curve=test.curve(used),
        validation={
            "used": float(used[chosen].mean()),
            "whole": float(choice.right[:, -1].mean()),
            "stopped": float(_at(choice.right, chosen).mean()),
        },
        images=len(fresh.y_test),
        draws=draws,
        covers=coverage_text(STOPPED_COVER, left),
    )


def _held_out(design: Design, data: Dataset, count: int | None) -> Dataset:
    """Data with the held-out scenes as its test part, or `InputError` if they were trained on."""
    training = trained_on(design.info)
    if count is None and training:
        count = training.held_out or None
    kept = data.hold_out(count)
    if training is None or kept.hash != training.hash:
        raise InputError(
            "this design was not trained on {name} without its last {count} training scenes, "
            "which calibrate its confidence: learn it with {hold_out:{count}}",
            setting="hold_out",
            name=data.name,
            count=len(kept.y_test),
        )
    return kept
