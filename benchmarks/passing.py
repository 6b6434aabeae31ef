"""Scenes that pass a static pattern: learned grey and binary patterns beside a random one.

    python benchmarks/passing.py                        # MNIST without background, 1e4 and 1e3
    python benchmarks/passing.py --data digits --epochs 2 --trial-epochs 1 --seeds 1
    python benchmarks/passing.py --record 2000          # test images in a simulated photon file

Each of the three is tuned in the same way: speeds are tried first, then classifiers at the best of
them, by the accuracy on 10 000 training images drawn by lot (a sixth of other data). The chosen
setting is trained on all training images, and its accuracy on test images under exact counts read
once. Place jitters in training and test. The interval is of the test images, for one seed; where
there are several the last column is the standard deviation over seeds.

With `--record` a binary pattern is learned that scenes enter and leave within the bins, and test
images pass it, one after the other, in a photon file with background. Their transits are found,
placed and classified from that file alone. `--write DESIGN FILE` writes such a file for a design.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import torch

from deepfsi import Camera, Design, Training, evaluate, learn, load_dataset
from deepfsi.base.intervals import wilson
from deepfsi.base.progress import SILENT
from deepfsi.counting.events import PtuWriter
from deepfsi.datasets.dataset import Dataset
from deepfsi.physics.surroundings import library_defaults
from deepfsi_flow.settings import Passing
from deepfsi_flow.transits import FINE, classify_transits

KINDS: dict[str, dict[str, Any]] = {
    "learned, grey": {"design": "deepfsi", "camera": Camera()},
    "learned, binary": {"design": "deepfsi", "camera": Camera(levels=2)},
    "random, binary": {"design": "random", "camera": Camera()},
}
"""Patterns that are compared."""

SPEEDS = (1.0, 2.0, 3.0, 4.0, 6.0)
"""Pixels a bin, of which the pattern is as wide as the path."""

NETWORKS: tuple[dict[str, Any], ...] = (
    {"hidden": (256, 128), "lr": 1e-2},
    {"hidden": (512, 256), "lr": 5e-3},
)
"""Classifiers, the first of them while speeds are tried."""

MASK_LR = 0.2
"""Learning rate of patterns: at 1 pixel a bin and 4 epochs 0.03, 0.1 and 0.3 read 0.784, 0.819 and
0.839 of validation images."""


BIN_S = 1e-4
"""Length of a bin of a photon file, seconds."""

RECORD = (
    *("photons", "evaluated", "scenes", "found", "others", "threshold", "off, pixels", "rms"),
    *("accuracy", "95 %, scenes"),
)
"""Columns of the table of a photon file."""


class Setting(NamedTuple):
    """Speed and classifier of a training."""

    speed: float
    network: dict[str, Any]


class Bench(NamedTuple):
    """What all trainings share."""

    bins: int
    jitter: float
    speed_jitter: float


def accuracy(
    data: Dataset, kind: str, photons: float, bench: Bench, setting: Setting, epochs: int, seed: int
) -> tuple[float, float]:
    """Accuracy on the test scenes under exact counts, and mean counts."""
    design = learn(
        data,
        photons=photons,
        exposure=Passing(speed=setting.speed, **bench._asdict()),
        training=Training(epochs=epochs, mask_lr=MASK_LR, start="random", **setting.network)
        if KINDS[kind]["design"] == "deepfsi"
        else Training(epochs=epochs, **setting.network),
        seed=seed,
        report=SILENT,
        **KINDS[kind],
    )
    [result] = evaluate(design, data, photons, draws=3, seed=seed, report=SILENT)
    return result.accuracy, result.counts


def chosen(held: Dataset, kind: str, photons: float, bench: Bench, epochs: int) -> Setting:
    """Setting that does best on held-out scenes, one choice after the other."""

    def best(settings: Sequence[Setting]) -> Setting:
        tried = {}
        for place, each in enumerate(settings):
            tried[place] = accuracy(held, kind, photons, bench, each, epochs, 0)[0]
            print(f"  {kind}, {photons:g}: {each.speed:g}, {each.network}: {tried[place]:.4f}")
        return settings[max(tried, key=tried.__getitem__)]

    first = best([Setting(speed, NETWORKS[0]) for speed in SPEEDS])
    return best([Setting(first.speed, network) for network in NETWORKS])


def simulate_transits(
    design: Design,
    scenes: np.ndarray,
    file: Path,
    bin_s: float,
    *,
    photons: float,
    background: float,
    gaps: tuple[float, float] = (2.0, 5.0),
    seed: int = 0,
) -> np.ndarray:
    """Write a photon file of scenes (n, N) that pass in turn; give the starts (n,) of their bins.

    Starts are seconds, for scenes in their mean places; gaps between transits are in transits.
    Scenes are seen from where they enter the pattern to where they leave it.
    """
    path = design.exposure.transit
    step = path.speed / FINE  # pixels
    steps = int(np.ceil((path.shifts - 1) / step))

    @library_defaults(grad=False)
    def expect() -> np.ndarray:
        x = torch.from_numpy(np.ascontiguousarray(scenes, dtype=np.float32))
        edges = (path.shifts - 1) / 2 + step * (torch.arange(steps + 1) - steps / 2)
        rates = design.exposure.rates(design.scanner(), x)
        traces = path.means(rates[:, 0], edges).double().numpy()
        return np.asarray(traces * photons / FINE)

    rng = np.random.default_rng(seed)
    passage = steps / FINE * bin_s
    window = path.bins * bin_s
    between = rng.uniform(*gaps, size=len(scenes)) * window
    enters = np.cumsum(between + passage) - passage
    seconds = float(enters[-1] + passage + gaps[1] * window)
    write_transits(
        file,
        expect(),
        enters,
        step_s=bin_s / FINE,
        background=background,
        seconds=seconds,
        rng=rng,
    )
    return enters + (passage - window) / 2


def write_transits(
    path: Path, traces: np.ndarray, starts_s: np.ndarray, *,
    step_s: float, background: float, seconds: float, rng: np.random.Generator,
) -> None:  # fmt: skip
    """Write photons of transits, counts (n, S) expected in steps from starts (n,), and background.

    The background is counts/s in all seconds.
    """
    counts = rng.poisson(traces)
    at = starts_s[:, None] + step_s * np.arange(traces.shape[1])
    passing = np.repeat(at.ravel(), counts.ravel())
    passing = passing + step_s * rng.random(len(passing))
    dark = seconds * rng.random(rng.poisson(background * seconds))
    times = np.sort(np.concatenate([passing, dark]))
    tick_s = 1e-9
    ticks = np.rint(times[(times >= 0) & (times < seconds)] / tick_s).astype(np.int64)
    with PtuWriter(path, tick_s) as writer:
        writer.write(ticks, np.zeros(len(ticks), np.int64))


def recorded(data: Dataset, photons: float, bench: Bench, epochs: int, scenes: int) -> str:
    """Row on scenes that pass in a photon file."""
    speed = 4.0 if data.image_shape[1] == 32 else 2.0
    width = int(speed * bench.bins) - data.image_shape[1]
    design = learn(
        data,
        photons=photons,
        camera=Camera(levels=2),
        exposure=Passing(speed=speed, pattern_width=width, **bench._asdict()),
        training=Training(epochs=epochs, mask_lr=MASK_LR, start="random", **NETWORKS[1]),
        report=SILENT,
    )
    [result] = evaluate(design, data, photons, draws=1, report=SILENT)
    x, y = data.x_test[:scenes], data.y_test[:scenes]
    background = 0.02 * photons / (bench.bins * BIN_S)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "photons.ptu"
        starts = simulate_transits(
            design, x, file, BIN_S, photons=photons, background=background, gaps=(1.0, 4.0)
        )
        found = classify_transits(design, file, BIN_S)
    at = np.array([each.start_s for each in found.transits])
    answers = np.array([each.predicted for each in found.transits])
    nearest = abs(at[:, None] - starts).argmin(axis=0)  # transit of each scene
    off = (at[nearest] - starts) / BIN_S * speed
    seen = abs(off) < data.image_shape[1]
    right = seen & (answers[nearest] == np.array(data.classes)[y])
    low, high = wilson(float(right.mean()), len(x))
    return (
        f"| {photons:g} | {result.accuracy:.4f} | {len(x)} | {int(seen.sum())} | "
        f"{len(at) - int(seen.sum())} | {found.threshold.photons} | {off[seen].mean():.2f} | "
        f"{off[seen].std():.2f} | {right.mean():.4f} | {low:.4f} to {high:.4f} |"
    )


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--photons", type=float, nargs="+", default=[1e4, 1e3])
    parser.add_argument("--bins", type=int, default=32)
    parser.add_argument("--jitter", type=float, default=2.0)
    parser.add_argument("--speed-jitter", type=float, default=0.0)
    parser.add_argument("--epochs", type=int, default=24)
    parser.add_argument("--trial-epochs", type=int, default=4)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--record", type=int, metavar="SCENES")
    parser.add_argument("--write", type=Path, nargs=2, metavar=("DESIGN", "FILE"))
    arguments = parser.parse_args(words)

    if arguments.write:
        design, file = arguments.write
        scenes = load_dataset(arguments.data).x_test[: arguments.record]
        photons = arguments.photons[0]
        simulate_transits(
            Design.load(design), scenes, file, BIN_S, photons=photons, background=photons
        )
        return
    data = load_dataset(arguments.data, rescale=(0.0, 1.0))
    lot = np.random.default_rng(0).permutation(len(data.x_train))
    held = replace(data, x_train=data.x_train[lot], y_train=data.y_train[lot]).hold_out()
    bench = Bench(arguments.bins, arguments.jitter, arguments.speed_jitter)
    if arguments.record:
        print(f"| {' | '.join(RECORD)} |\n|{' --- |' * len(RECORD)}")
        for photons in arguments.photons:
            row = recorded(data, photons, bench, arguments.epochs, arguments.record)
            print(row, flush=True)
        return
    rows = []
    for photons in arguments.photons:
        for kind in KINDS:
            setting = chosen(held, kind, photons, bench, arguments.trial_epochs)
            several = [
                accuracy(data, kind, photons, bench, setting, arguments.epochs, seed)
                for seed in range(arguments.seeds)
            ]
            found, counts = np.array(several).T
            low, high = wilson(float(found.mean()), len(data.x_test))
            spread = f"{found.std(ddof=1):.4f}" if len(found) > 1 else ""
            rows.append(
                f"| {photons:g} | {kind} | {setting.speed:g} | {setting.network['hidden']} | "
                f"{found.mean():.4f} | {low:.4f} to {high:.4f} | {counts.mean():.0f} | {spread} |"
            )
            print(rows[-1], flush=True)
    print("| photons | pattern | speed | hidden | accuracy | 95 %, test images | counts | seeds |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
