"""Fixed masks for the clicks of a published experiment with structured light, on MNIST on black.

    python benchmarks/few_clicks.py -o runs/few-clicks  # table of docs/notebook/published.md, hours
    python benchmarks/few_clicks.py --clicks 8.6 --seeds 0 --laws free-dwell
    python benchmarks/few_clicks.py --clicks 8.6 --masks 40 --epochs 10 --seeds 0 --validation

The experiment: S.-Y. Ma, J. Laydevant, M. M. Sohoni, L. G. Wright, T. Wang, P. L. McMahon, "Machine
vision with small numbers of detected photons per inference", arXiv 2603.23974 (2026). A network
with one hidden layer of 512 units reads the clicks of fixed patterns.

Ours have the same network and no more clicks in the mean; a detector clicks at most once for each
mask. Masks, light, epochs and learning rates were chosen on the last 10 000 training images; the
designs are trained on the others. A test image is exposed ten times, and an accuracy is the mean
over exposures of one training; its interval is over images (Wilson). With `--validation` no test
image is read.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from deepfsi.base.intervals import wilson
from deepfsi.camera.names import LightLawName
from deepfsi.datasets.load import load_dataset
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.training.learning import learn

EXPERIMENT = {5.0: 0.765, 8.6: 0.857, 13.0: 0.919, 18.0: 0.951, 29.3: 0.972}
"""Mean clicks of the experiment, and its accuracy."""

LAWS: tuple[LightLawName, ...] = ("free-dwell", "column")
"""One DMD with one detector, and optics that split the light of each pixel."""

MASKS = {5.0: 40, 8.6: 60, 13.0: 80, 18.0: 100, 29.3: 120}
"""Numbers of masks by clicks; chosen on validation images."""

PHOTONS = 1e5
"""Φ; chosen on validation images."""

TRAINING: dict[str, Any] = {"hidden": (512,), "lr": 3e-3, "start_counts": 2.0, "epochs": 30}
"""Network of the experiment, and settings chosen on validation images."""

FEWER = 0.98
"""Clicks that ours are trained for over the experiment's: test images are a little brighter."""

FIRST, DRAWS = 200, 10
"""Test images that such experiments read, the first ones, and exposures of each image."""


def interval(accuracy: float, images: int) -> str:
    """Accuracy with half of its 95 % interval over so many images."""
    low, high = wilson(accuracy, images)
    return f"{accuracy:.4f} ± {(high - low) / 2:.4f}"


def main(words: Sequence[str] | None = None) -> None:
    """Train, test and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--clicks", type=float, nargs="+", default=list(EXPERIMENT))
    parser.add_argument("--laws", nargs="+", default=list(LAWS), choices=LAWS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--masks", type=int, help="those chosen unless given")
    parser.add_argument("--photons", type=float, default=PHOTONS)
    parser.add_argument("--epochs", type=int, default=TRAINING["epochs"])
    parser.add_argument("--validation", action="store_true", help="read no test images")
    parser.add_argument("-o", "--out", type=Path, help="folder for the designs")
    asked = parser.parse_args(words)
    data = load_dataset(asked.data, rescale=(0.0, 1.0))
    part = data.hold_out()
    first = replace(data, x_test=data.x_test[:FIRST], y_test=data.y_test[:FIRST])
    scenes = {"validation": part}
    if not asked.validation:
        scenes |= {"test": data, f"first {FIRST}": first}
    heads = ("clicks asked", "law", "Φ", "masks", "seed", *scenes, "clicks", "arriving", "theirs")
    print(f"| {' | '.join(heads)} |\n" + "| --- " * len(heads) + "|", flush=True)
    for light, seed, clicks in product(asked.laws, asked.seeds, asked.clicks):
        masks = asked.masks or MASKS[min(MASKS, key=lambda known: abs(known - clicks))]
        design = learn(
            part,
            counts=FEWER * clicks,
            photons=asked.photons,
            masks=masks,
            camera={"light": light, "rails": "single", "noise": "click"},
            training=TRAINING | {"epochs": asked.epochs},
            seed=seed,
        )
        if asked.out:
            asked.out.mkdir(parents=True, exist_ok=True)
            design.save(asked.out / f"{light}-{clicks:g}-{seed}.safetensors")
        results = {
            name: evaluate(design, some, asked.photons, draws=DRAWS, seed=seed)[0]
            for name, some in scenes.items()
        }
        read = [
            interval(result.accuracy, len(scenes[name].x_test)) for name, result in results.items()
        ]
        result = results.get("test", results["validation"])
        cells = [f"{clicks:g}", light, f"{asked.photons:.0f}", str(masks), str(seed), *read]
        cells += [
            f"{result.counts:.2f}",
            f"{result.arriving:.1f}",
            f"{EXPERIMENT.get(clicks, '–') if asked.data == 'mnist' else '–'}",
        ]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
