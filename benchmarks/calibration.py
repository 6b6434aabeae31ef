"""Calibration error of designs from a tenth to ten times the light of their training.

    python benchmarks/calibration.py                                   # MNIST, 10 epochs
    python benchmarks/calibration.py --data digits --seeds 21 22 23    # whole trainings

Each design answers the test images once, with exact counts, with the temperatures that its training
gives it and without. Several seeds divide digits, train and draw counts; their answers are taken
together. Of the error that is subtracted which exactly calibrated answers of the same probabilities
would show (200 draws); over-confidence is mean confidence less accuracy. The time of the
calibration is the processor's, and so is that of the training. Adaptive masks get no temperatures
of many scenes, and are tested on the first `--tests` images.
"""

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import softmax

import deepfsi
from deepfsi.datasets.dataset import Dataset
from deepfsi.evaluation.confidence import draw_logits
from deepfsi.evaluation.measures import confidence_error
from deepfsi.exposure.kind import temperatures_at
from deepfsi.jobs.job import Job
from deepfsi.training.characterisation import find_temperatures

KINDS: dict[str, dict[str, Any]] = {
    "fixed, 10⁴": {"masks": 16, "photons": 1e4, "camera": "paper"},
    "range, 10³ to 10⁵": {
        "masks": 16,
        "photons": 1e3,
        "camera": "paper",
        "exposure": {"span": 1e2},
    },
    "clicks, 4 gates, 1500": {
        "masks": 60,
        "photons": 1500,
        "camera": {"light": "free-dwell", "rails": "single", "noise": "click", "gates": 4},
        "training": {"mask_lr": 0.05},
    },
    "adaptive, 10⁴": {"design": "adaptive", "masks": 16, "photons": 1e4, "camera": "dmd"},
}
"""Settings of the designs."""

BELOW, ABOVE = (0.01, 0.1, 0.3, 1.0), (1.0, 3.0, 10.0)
"""Test budgets over the lowest of the training, and over the highest."""

Answers = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Confidence with temperatures (E,), without them (E,), and whether the answers are right (E,)."""


def chance_error(sure: np.ndarray) -> float:
    """Calibration error that exactly calibrated answers of confidence (E,) show, of 200 draws."""
    rng = np.random.default_rng(0)
    draws = (rng.random(len(sure)) < sure for _ in range(200))
    return float(np.mean([confidence_error(sure, right) for right in draws]))


def answers(design: Any, data: Dataset, photons: float, seed: int, tests: int) -> Answers:
    """Answers to the test images at a budget."""
    if design.exposure.makes_masks:
        x, y = data.x_test[:tests], data.y_test[:tests]
        temperature = 1.0
    else:
        x, y = data.x_test, data.y_test
        temperature = float(temperatures_at(design.temperatures, 0, photons))
    logits = draw_logits(design, design.camera, x, photons, 1, seed)
    both = (softmax(logits / each, axis=1).max(axis=1) for each in (temperature, 1.0))
    return *both, logits.argmax(axis=1) == y


def main(words: Sequence[str] | None = None) -> None:
    """Train, test and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--epochs", type=int, help="those of a training unless given, 10 of MNIST")
    parser.add_argument("--hold-out", type=int, default=0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), help="beginnings of names")
    parser.add_argument("--tests", type=int, default=500, help="images for adaptive masks")
    given = parser.parse_args(words)
    epochs = given.epochs or (10 if given.data == "mnist" else None)
    print("| design | photons | accuracy | over-confidence | error beyond chance | error | without "
          "temperatures |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- | --- |")
    times = []
    for name, settings in KINDS.items():
        if not any(name.startswith(kind) for kind in given.kinds):
            continue
        low = settings["photons"]
        high = low * settings.get("exposure", {}).get("span", 1)
        budgets = list(dict.fromkeys([low * r for r in BELOW] + [high * r for r in ABOVE]))
        found: dict[float, list[Answers]] = {budget: [] for budget in budgets}
        for seed in given.seeds:
            data = deepfsi.load_dataset(given.data, seed=seed)
            kept = data.hold_out(given.hold_out) if given.hold_out else data
            own = {**settings.get("training", {}), **({"epochs": epochs} if epochs else {})}
            adaptive = "design" in settings
            began = time.process_time()
            made = settings if adaptive else {**settings, "training": own}
            design = deepfsi.learn(kept, seed=seed, **made)
            trained = time.process_time() - began
            if not adaptive:
                began = time.process_time()
                find_temperatures(design, Job.model_validate(design.info["job"]), kept)
                times.append(f"{name}: {(time.process_time() - began) / trained:.1%}")
            for budget in budgets:
                found[budget].append(answers(design, data, budget, seed, given.tests))
        for budget, several in found.items():
            sure, plain, right = (np.concatenate(each) for each in zip(*several, strict=True))
            error = confidence_error(sure, right)
            words_of = (
                f"{right.mean():.3f}",
                f"{sure.mean() - right.mean():+.3f}",
                f"{error - chance_error(sure):.3f}",
                f"{error:.3f}",
                f"{confidence_error(plain, right):.3f}",
            )
            print(f"| {name} | {budget:g} | {' | '.join(words_of)} |", flush=True)
    print("time of the calibration, a share of the training's:", "; ".join(times))


if __name__ == "__main__":
    main()
