"""Calibration error of three kinds of designs at a tenth to ten times the light of their training.

    python benchmarks/calibration.py [--data mnist] [--epochs 10] [--hold-out 0]

Each is tested on the test images with exact counts, with the temperatures that its training gives
it and without. The time of the calibration is the processor's, and so is that of the training.
"""

import argparse
import time
from dataclasses import replace
from typing import Any

import deepfsi
from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import Result
from deepfsi.training.characterisation import find_temperatures
from deepfsi.training.job import Job

KINDS: dict[str, dict[str, Any]] = {
    "fixed, 10⁴": {"masks": 16, "photons": 1e4, "camera": "paper"},
    "range, 10³ to 10⁵": {
        "masks": 16,
        "photons": 1e3,
        "camera": "paper",
        "exposure": {"span": 1e2},
    },
    "4 looks, 10⁴": {"masks": 32, "photons": 1e4, "camera": "dmd", "exposure": {"looks": 4}},
}
"""Settings of the designs."""

BELOW, ABOVE = (0.01, 0.1, 0.3, 1.0), (1.0, 3.0, 10.0)
"""Test budgets over the lowest of the training, and over the highest."""


def tests(design: Design, data: Dataset, low: float, high: float) -> list[Result]:
    """Results at budgets below, in and above those of the training."""
    budgets = dict.fromkeys([low * each for each in BELOW] + [high * each for each in ABOVE])
    return deepfsi.evaluate(design, data, list(budgets), draws=1)


def main() -> None:
    """Train, test and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--hold-out", type=int, default=0)
    given = parser.parse_args()
    data = deepfsi.load_dataset(given.data)
    kept = data.hold_out(given.hold_out) if given.hold_out else data
    print("| design | photons | accuracy | calibration error | without temperatures |")
    print("| --- | --- | --- | --- | --- |")
    times = []
    for name, settings in KINDS.items():
        began = time.process_time()
        design = deepfsi.learn(kept, training={"epochs": given.epochs}, **settings)
        trained = time.process_time() - began
        low = settings["photons"]
        high = low * settings.get("exposure", {}).get("span", 1)
        began = time.process_time()
        find_temperatures(design, Job.model_validate(design.info["job"]), kept)
        times.append(f"{name}: {(time.process_time() - began) / trained:.1%}")
        plain = replace(design, temperatures=None)
        pairs = zip(*(tests(each, data, low, high) for each in (design, plain)), strict=True)
        for found, raw in pairs:
            errors = found.calibration_error, raw.calibration_error
            words = (f"{found.accuracy:.3f}", *(f"{each:.3f}" for each in errors))
            print(f"| {name} | {found.photons:g} | {' | '.join(words)} |", flush=True)
    print("time of the calibration, a share of the training's:", "; ".join(times))


if __name__ == "__main__":
    main()
