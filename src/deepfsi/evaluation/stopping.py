"""Early stopping: an exposure ends as soon as the classifier is confident enough.

After each mask of a nested design, from the smallest number that can be classified alone, or after
each look of a design of several, an exposure is classified from the counts so far. It stops when
the confidence, the probability of the most probable class, exceeds a threshold. A stopped exposure
and the whole one share their random draws: the counts of the first are the first counts of the
second.

The probabilities are calibrated (`confidence`). The threshold is chosen on scenes that were held
out of the training, at one budget, and holds near that one only. The test scenes are used once.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_serializer
from scipy.special import log_softmax

from deepfsi.base import InputError, as_input_error
from deepfsi.base.numeric import accuracy_interval
from deepfsi.camera import StopRule, check_budget
from deepfsi.datasets import Dataset, Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.designfile import new_scenes, trained_on
from deepfsi.evaluation.accuracy import check_data, check_draws, covered
from deepfsi.evaluation.confidence import logits_at_stops
from deepfsi.exposure.temperatures import stop_temperatures
from deepfsi.measures import calibration_error, confidence_groups
from deepfsi.networks.values import check_classes
from deepfsi.physics import library_defaults

THRESHOLDS = 1 - np.geomspace(0.5, 1e-7, 135)
"""Confidences that are tried, and 1, which none is above."""

ACCEPTED_SHARES = tuple(k / 20 for k in range(10, 21))
"""Shares of accepted answers at which rejection is shown."""

COVERS = "test images and noise draws, for this one trained design (images as the trials)"


@dataclass(frozen=True)
class Estimate:
    """Mean over images and noise draws with its 95 % interval."""

    mean: float
    low: float
    high: float


class StoppingRule(StopRule):
    """When an exposure stops, and where it may."""

    # Numbers of masks, or of looks, after which it may, rising; the last is all
    after: tuple[int, ...]

    @model_serializer
    def as_dict(self) -> dict[str, Any]:
        """JSON types only, in the order that files and pages have."""
        return {"after": list(self.after), "threshold": self.threshold, "photons": self.photons}

    def classify(
        self, design: Design, counts: ArrayLike, photons: float
    ) -> tuple[np.ndarray, bool]:
        """Classify an exposure of a nested design that goes on, and say whether it may stop."""
        # counts (2, k) for dual-rail designs, (k,)
        read = np.asarray(counts, dtype=np.float32)
        shown = read.shape[-1] if read.ndim else 0
        if shown not in self.after:
            raise InputError(
                f"counts of {shown} masks cannot be judged: give those of {self.after[0]} to "
                f"{self.after[-1]} masks"
            )
        part = design.first(shown)
        chances = part.classify(read, photons * part.mask_exposure.used / design.mask_exposure.used)
        return chances, self.decide(shown, chances, photons)

    def decide(self, shown: int, chances: np.ndarray, photons: float) -> bool:
        """True if an exposure of a budget stops, by its probabilities (C,) so far."""
        # For `Design.classify_live`; `InputError` if an exposure is not judged after so many
        if shown not in self.after:
            raise InputError(
                f"an exposure is not judged after {shown}: this rule is for {self.after[0]} to "
                f"{self.after[-1]} masks or looks"
            )
        return shown == self.after[-1] or bool(self.stops(chances.max(), photons))


def with_rule(design: Design, rule: StoppingRule) -> Design:
    """The design with a rule of when an exposure stops, or `InputError` if it is of one look."""
    held = {"threshold": rule.threshold, "photons": rule.photons}  # the design says after what
    exposure = design.exposure.stopping_at(rule.threshold)
    return replace(design, exposure=exposure, info={**design.info, "stopping": held})


def rule_of(design: Design) -> StoppingRule | None:
    """Rule that a design holds, if it holds one."""
    held = design.info.get("stopping")
    if held is None:
        return None
    after = design.exposure.stops.after
    with as_input_error("the design's stopping rule", "make it again with `deepfsi stop`"):
        return StoppingRule.model_validate({"after": after, **held})


@dataclass(frozen=True)
class Stopped:
    """One design at one budget, its exposures stopped early."""

    photons: float  # budget Φ of the whole exposure
    rule: StoppingRule
    used: Estimate  # share of the budget that exposures take: of looks, share of their time
    # Accuracy of whole exposures, of stopped ones, and the second less the first, paired
    whole: Estimate
    stopped: Estimate
    difference: Estimate
    stops: list[float]  # share of exposures that end after each of `rule.after`
    confidence: float  # mean confidence of the answers given
    # Mean distance of confidence and accuracy over groups of the answers given, with temperatures
    # and without
    calibration_error: float
    uncalibrated_error: float
    # Mean −ln of the probability of the true class, over whole exposures and all shorter ones
    log_loss: float
    uncalibrated_log_loss: float
    reliability: list[dict[str, float]]  # `confidence` and `accuracy` of each group
    # `accepted`, the share of answers kept, the surest first, and their accuracy: `stopped`, and
    # `whole` where exposures do not stop early
    rejection: list[dict[str, float]]
    curve: list[dict[str, float]]  # `threshold`, `used` and `accuracy` for every threshold tried
    # `used`, `whole` and `stopped` on the scenes on which the threshold was chosen
    validation: dict[str, float]
    images: int  # test scenes, and independent noise draws of each
    draws: int
    covers: str = COVERS  # what the intervals cover

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return asdict(self) | {"rule": self.rule.as_dict()}


class _Answers:
    """Answers of E exposures at K stops, right or wrong, and their confidences.

    Logits (K, E, C) are those of `logits_at_stops`, labels (n,) those of the scenes; temperatures
    (K,) divide the logits at each stop.
    """

    def __init__(self, logits: np.ndarray, labels: np.ndarray, temperatures: np.ndarray) -> None:
        draws = logits.shape[1] // len(labels)
        self.images = np.repeat(np.arange(len(labels)), draws)
        labels = labels[self.images]
        true = np.arange(len(labels)), labels
        confidence, raw, right, self.log_loss, self.raw_log_loss = [], [], [], 0.0, 0.0
        for each, temperature in zip(logits, temperatures, strict=True):
            wide = each.astype(float)
            calibrated, plain = (log_softmax(z, axis=1) for z in (wide / temperature, wide))
            confidence.append(np.exp(calibrated.max(axis=1)))
            raw.append(np.exp(plain.max(axis=1)))
            right.append(plain.argmax(axis=1) == labels)
            self.log_loss -= float(calibrated[true].mean()) / len(temperatures)
            self.raw_log_loss -= float(plain[true].mean()) / len(temperatures)
        self.confidence, self.raw_confidence, self.right = (
            np.stack(part, axis=1) for part in (confidence, raw, right)
        )

    def ends(self, threshold: float) -> np.ndarray:
        """Stop (E,), from 0, at which each exposure ends."""
        enough = self.confidence > threshold
        enough[:, -1] = True
        return enough.argmax(axis=1)

    def least_threshold(self, used: np.ndarray) -> float:
        """Threshold of fewest photons whose accuracy is not below that of whole exposures."""
        whole = self.right[:, -1].mean()
        costs = [(used[-1], 1.0)]
        for threshold in THRESHOLDS:
            ends = self.ends(threshold)
            if _at(self.right, ends).mean() >= whole:
                costs.append((used[ends].mean(), float(threshold)))
        return min(costs)[1]

    def estimate(self, values: np.ndarray) -> Estimate:
        """Mean of values (E,), normal over the images; of true or false `accuracy`'s."""
        each = np.bincount(self.images, values) / np.bincount(self.images)
        mean, count = float(each.mean()), len(each)
        if values.dtype == bool:
            return Estimate(*accuracy_interval(each))
        half = 1.96 * float(each.std(ddof=1)) / count**0.5
        return Estimate(mean, mean - half, mean + half)


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
    draws: int = 3,
    seed: int = 0,
) -> Stopped:
    """Choose when to stop on held-out scenes, and test it on the test scenes."""
    check_classes(design.values, "a stopping rule")
    budget = check_budget(photons)
    check_draws(draws, seed)
    scenes = as_dataset(data)
    check_data(design, scenes)
    after, used = design.exposure.stops
    if threshold is not None and not 0 <= threshold <= 1:
        raise InputError(f"threshold {threshold!r} is not a confidence: give 0 to 1")
    kept = _held_out(design, scenes, held_out)
    front = design.front_end()
    temperatures = np.ones(len(after))
    if design.temperatures is not None:
        temperatures = stop_temperatures(design.temperatures, budget)
    logits = logits_at_stops(design, front, kept.x_test, budget, draws, seed ^ 2**31)
    choice = _Answers(logits, kept.y_test, temperatures)
    if threshold is None:
        threshold = choice.least_threshold(used)
    rule = StoppingRule(after=after, threshold=float(threshold), photons=budget)
    new, left = new_scenes(design.training_scenes, scenes)
    tested = logits_at_stops(design, front, new.x_test, budget, draws, seed)
    found = _stopped(rule, _Answers(tested, new.y_test, temperatures), choice, used, budget)
    return replace(found, covers=covered(found.covers, left))


def _held_out(design: Design, data: Dataset, count: int | None) -> Dataset:
    """Data with the held-out scenes as its test part, or `InputError` if they were trained on."""
    known = trained_on(design.info)
    if count is None and known:
        count = known.held_out or None
    kept = data.hold_out(count)
    if known is None or kept.hash != known.hash:
        raise InputError(
            "this design was not trained on {name} without its last {count} training scenes, "
            "which calibrate its confidence: learn it with {hold_out:{count}}",
            setting="hold_out",
            name=data.name,
            count=len(kept.y_test),
        )
    return kept


def _stopped(
    rule: StoppingRule, test: _Answers, choice: _Answers, used: np.ndarray, photons: float
) -> Stopped:
    ends, chosen = test.ends(rule.threshold), choice.ends(rule.threshold)
    confidence, right = _at(test.confidence, ends), _at(test.right, ends)
    whole = test.right[:, -1]
    curve = []
    for threshold in (*THRESHOLDS.tolist(), 1.0):
        stops = test.ends(threshold)
        accuracy = float(_at(test.right, stops).mean())
        curve.append(
            {"threshold": threshold, "used": float(used[stops].mean()), "accuracy": accuracy}
        )
    groups = confidence_groups(confidence, right)
    raw_groups = confidence_groups(_at(test.raw_confidence, ends), right)
    images = int(test.images.max()) + 1
    return Stopped(
        photons=photons,
        rule=rule,
        used=test.estimate(used[ends]),
        whole=test.estimate(whole),
        stopped=test.estimate(right),
        difference=test.estimate(right.astype(float) - whole),
        stops=(np.bincount(ends, minlength=len(used)) / len(ends)).tolist(),
        confidence=float(confidence.mean()),
        calibration_error=calibration_error(groups),
        uncalibrated_error=calibration_error(raw_groups),
        log_loss=test.log_loss,
        uncalibrated_log_loss=test.raw_log_loss,
        reliability=[{"confidence": one, "accuracy": other} for one, other, _ in groups],
        rejection=[
            {"accepted": accepted, "stopped": early, "whole": late}
            for accepted, early, late in zip(
                ACCEPTED_SHARES,
                _surest(confidence, right),
                _surest(test.confidence[:, -1], whole),
                strict=True,
            )
        ],
        curve=curve,
        validation={
            "used": float(used[chosen].mean()),
            "whole": float(choice.right[:, -1].mean()),
            "stopped": float(_at(choice.right, chosen).mean()),
        },
        images=images,
        draws=len(test.images) // images,
    )
