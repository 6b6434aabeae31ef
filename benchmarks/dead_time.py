"""Accuracy at 10⁷ counts/s with a counter's dead time, as it is counted and corrected.

    python benchmarks/dead_time.py  # table of docs/notebook/dead-time.md
    python benchmarks/dead_time.py --figure docs/figures/dead-time.png

Designs for one device are trained on MNIST. Test scenes are counted in exposures of 10 ms by the
virtual detector, with 100 dark counts/s, all-ON and all-OFF frames among them, and classified
through the table of counts: budget, dark counts, checks of the light and correction are those of
`deepfsi camera classify`.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.tables import NumberTable
from deepfsi.camera.dead_time import DeadTime
from deepfsi.camera.device import find_device
from deepfsi.counting.tables import TableSettings, count_table
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.design.design import Design
from deepfsi.designfile.misfit import FALSE_ALARM
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.virtual_detector import Detector
from deepfsi.patterns.folder import Patterns
from deepfsi.training.learning import learn
from deepfsi_paper.camera.gate_counts import draw

RATE = 1e7
"""Arrivals/s of the mean scene with all mirrors ON."""

EXPOSURE_S = 1e-2
"""Of each scene."""

DARK = 100.0
"""Dark counts/s."""

DEAD_TIMES_NS = (0, 10, 20, 30, 50)
"""Dead times of the counter."""

MODELS = {"non-paralysable": False, "paralysable": True}

DESIGNS = {"free dwell": ("free-dwell", "single"), "equal dwell": ("equal-dwell", "dual")}
"""Designs by name: light and rails."""


class Shown(NamedTuple):
    """A design as its patterns show it, the patterns, and arrivals/s in frames (S, F)."""

    design: Design
    patterns: Patterns
    rates: np.ndarray


def show(design: Design, data: Dataset, scenes: int) -> Shown:
    """Patterns of a design on a DLP7000, and what the ideal optics send of test scenes."""
    masks = design.masks * design.rails.count
    with TemporaryDirectory() as folder:
        design.save(Path(folder) / "design.safetensors")
        patterns = Patterns.from_rails(
            design_rails(Path(folder) / "design.safetensors"),
            find_device("dlp7000"),
            EXPOSURE_S / masks,
        ).write(Path(folder) / "patterns")
    manifest, x = patterns.manifest, data.x_test[:scenes].astype(float)
    flux = RATE / manifest.summed_reflectance
    lit = np.zeros((len(manifest.frames), x.shape[1]))
    lit[[0, -2]] = 1
    lit[manifest.mask_frames] = patterns.fractions
    return Shown(design.as_shown(*patterns.realised), patterns, x @ lit.T * flux + DARK)


class Result(NamedTuple):
    """Accuracy, its 95 % interval's half width over scenes, and the share of scenes unlike."""

    accuracy: float
    error: float
    unlike: float
    faults: int

    def __str__(self) -> str:
        faults = f", {self.faults} faults" if self.faults else ""
        return f"{self.accuracy:.3f} ({self.unlike:.0%} unlike{faults})"


def classify(shown: Shown, detector: Detector, dead: DeadTime, labels: np.ndarray) -> Result | None:
    """Classes with a detector, corrected for a dead time; None where that is refused."""
    manifest, made = shown.patterns.manifest, shown.design
    counts = draw(detector, shown.rates, manifest.picture_s, np.random.default_rng(1))
    table, settings = (
        NumberTable(counts.astype(float)),
        TableSettings(dead_time=dead),
    )
    try:
        found, _ = count_table(table, manifest, settings)
    except InputError:
        return None
    read = made.readouts(found.signal()[:, 0])
    background = made.readouts(found.background + found.excess.sum(axis=1))
    right = made.classify(read, found.photons).argmax(axis=-1) == labels
    each = zip(read, found.photons.tolist(), background, strict=True)
    unlike = np.array([made.consistency(*scene) < FALSE_ALARM for scene in each])
    error = 1.96 * np.sqrt(right.var() / len(right))
    return Result(right.mean(), error, unlike.mean(), len(found.faults))


def measure(data: Dataset, masks: int, epochs: int, scenes: int) -> dict[tuple, tuple]:
    """Results as counted and as corrected, by design, model and dead time in ns."""
    labels, out = data.y_test[:scenes], {}
    for name, (light, rails) in DESIGNS.items():
        design = learn(
            data,
            masks=masks,
            photons=RATE * EXPOSURE_S,
            camera={"light": light, "rails": rails},
            training={"epochs": epochs},
            device="cpu",
        )
        shown = show(design, data, scenes)
        for model, paralysable in MODELS.items():
            for tau in DEAD_TIMES_NS:
                detector = Detector(dead_time_s=tau * 1e-9, paralysable=paralysable)
                dead = DeadTime(seconds=tau * 1e-9, paralysable=paralysable)
                each = DeadTime(seconds=0), dead
                found = tuple(classify(shown, detector, dead, labels) for dead in each)
                out[name, model, tau] = found
                words = (str(result or "refused") for result in found)
                print(f"| {name} | {model} | {tau} | {' | '.join(words)} |", flush=True)
    return out


def draw_figure(found: dict[tuple, tuple], path: Path) -> None:
    """Accuracy against dead time, as counted (dashed) and corrected."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots(1, len(MODELS), sharey=True)
    for axis, model in zip(axes, MODELS, strict=True):
        for name, colour in zip(DESIGNS, ("#d55e00", "#0072b2"), strict=True):
            for k, (line, word) in enumerate((("--", "as counted"), ("-", "corrected"))):
                points = [(tau, found[name, model, tau][k]) for tau in DEAD_TIMES_NS]
                points = [(tau, result) for tau, result in points if result]
                taus, results = zip(*points, strict=True)
                means, errors = ([getattr(r, part) for r in results] for part in Result._fields[:2])
                axis.errorbar(
                    taus, means, errors, color=colour, linestyle=line, marker="o", markersize=3,
                    capsize=2, label=f"{name}, {word}",
                )  # fmt: skip
        axis.set(title=model, xlabel="dead time (ns)", ylabel="accuracy (share correct)")
        axis.tick_params(labelleft=True)  # each panel can be read alone
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--masks", type=int, default=16)
    parser.add_argument("--epochs", type=int, default=5)
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    data = load_dataset(given.data)
    print("| design | model | dead time, ns | as counted | corrected |\n" + "| --- " * 5 + "|")
    found = measure(data, given.masks, given.epochs, given.scenes)
    if given.figure:
        draw_figure(found, given.figure)


if __name__ == "__main__":
    main()
