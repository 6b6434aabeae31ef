"""Faults of the view in runs of 40 scenes: which are refused or named, and how often sound ones.

    python benchmarks/view.py                      # the table of docs/notebook/run-checks.md
    python benchmarks/view.py --runs 3 --sound 20  # a short look

Designs are learned on digits at 10^4 photons. The virtual camera shows test scenes with a fault of
its optics: it counts a recorded run frame by frame, and a live run with all that is said to it. A
row says of how many runs the fault is refused, after how many scenes in the median, and how many of
the scenes are right, all of them classified. Sound runs follow.
"""

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import deepfsi
from deepfsi.camera.device import find_device
from deepfsi.counting.acquisition import Scene
from deepfsi.counting.tables import TableSettings
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.devices import virtual_setup
from deepfsi.lab.live import LiveRun
from deepfsi.lab.virtual_optics import VirtualCamera, arrival_rates
from deepfsi.patterns.folder import Patterns

SCENES, PHOTONS, EXPOSURE_S = 40, 1e4, 10e-3

DESIGNS = {
    "recorded, one detector": {"camera": "dmd", "masks": 16},
    "recorded, 2 x 2 detectors": {"camera": "dmd-2x2", "masks": 8},
    "recorded, two arms": {"camera": "two-arm", "masks": 12},
    "live, adaptive masks": {"camera": "dmd", "masks": 16, "design": "adaptive"},
}

FAULTS = (
    "mirrored left to right",
    "turned by 180 degrees",
    "blurred by one cell",
    "stray light as strong as the scene",
    "stray light of three times that",
    "corners with 0.4 of the light",
    "corners with 0.6 of the light",
)
SOUND = "none"


@dataclass(frozen=True)
class Run:
    """Outcome of a run."""

    refused: bool
    named: bool
    after: int  # scenes before it was refused, or all
    likeliest: str
    right: int  # of the scenes, all of which are classified


def learned(words: dict, folder: Path, epochs: int) -> Path:
    """Patterns of a design for digits."""
    data = deepfsi.load_dataset("digits")
    more = {} if "design" in words else {"training": deepfsi.Training(epochs=epochs)}
    file = deepfsi.learn(data, photons=PHOTONS, **words, **more).save(folder / "one.safetensors")
    Patterns.from_rails(design_rails(file), find_device("dlp7000"), 1.5e-3).write(
        folder / "patterns"
    )
    return folder / "patterns"


def camera_with(fault: str, patterns: Path, flux: float) -> VirtualCamera:
    """Virtual camera with a fault of its optics."""
    manifest = Patterns.read(patterns).manifest
    grid = manifest.grid
    side = min(grid.width, grid.height)
    mirrors = manifest.device.columns * manifest.device.rows
    alike = flux * mirrors / (grid.down * grid.across * grid.mirrors)
    optics = {
        "mirrored left to right": {"view": ((-1, 0, 1), (0, 1, 0), (0, 0, 1))},
        "turned by 180 degrees": {"view": ((-1, 0, 1), (0, -1, 1), (0, 0, 1))},
        "blurred by one cell": {"blur": side},
        "stray light as strong as the scene": {"ambient": alike},
        "stray light of three times that": {"ambient": 3 * alike},
        "corners with 0.4 of the light": {"vignetting": 0.6},
        "corners with 0.6 of the light": {"vignetting": 0.4},
    }
    return VirtualCamera.model_validate(optics.get(fault, {}))


def recorded(patterns: Path, camera: VirtualCamera, flux: float, seed: int) -> Run:
    """A recorded run, as a table of the counts of each frame."""
    data, rng = deepfsi.load_dataset("digits"), np.random.default_rng([seed, 44])
    chosen = rng.permutation(len(data.x_test))[:SCENES]
    scenes = data.x_test[chosen].reshape(-1, *data.image_shape)
    read = Patterns.read(patterns)
    manifest = read.manifest
    rates = arrival_rates(read, scenes, camera, flux)
    gates = manifest.picture_s.copy()
    gates[manifest.mask_frames] = manifest.shares * EXPOSURE_S
    counts = rng.poisson(rates * gates[:, None]).reshape(SCENES, -1)
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "counts.npy", counts)
        on = rates[:, 0, : manifest.detector_count].sum(axis=1).mean() * EXPOSURE_S
        settings = TableSettings(photons=float(on))
        masks = np.repeat(np.isin(np.arange(len(gates)), manifest.mask_frames), manifest.inputs)
        np.save(Path(folder) / "counts.npy", counts[:, masks])
        run = deepfsi.classify_table(patterns, Path(folder) / "counts.npy", settings, force=True)
    assert run.view is not None
    right = sum(
        each.predicted == data.classes[label]
        for each, label in zip(run.scenes, data.y_test[chosen], strict=True)
    )
    view = run.view
    return Run(view.refused, view.named, SCENES, view.likeliest, right)


def live(patterns: Path, camera: VirtualCamera, flux: float, seed: int) -> Run:
    """A live run."""
    data, rng = deepfsi.load_dataset("digits"), np.random.default_rng([seed, 45])
    chosen = rng.permutation(len(data.x_test))[:SCENES]
    scenes = tuple(Scene(name=str(k), label=data.classes[data.y_test[k]]) for k in chosen)
    known = {"flux": flux, "seed": seed, "camera": camera.model_dump(mode="json")}
    live_run = LiveRun(Patterns.read(patterns), scenes, EXPOSURE_S, **known)
    shown = data.x_test[chosen].reshape(-1, *data.image_shape)
    devices = virtual_setup(live_run.patterns, shown, live_run.settings)
    views, right = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for each in live_run.steps(Path(folder) / "run", devices):
            if each.final and len(each.probabilities):
                views.append(each.view)
                best = data.classes[each.probabilities.argmax()]
                right += best == scenes[each.scene].label
    after = next((k for k, view in enumerate(views, 1) if view.refused), SCENES)
    return Run(views[-1].refused, views[-1].named, after, views[-1].likeliest, right)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10, help="of each fault")
    parser.add_argument("--sound", type=int, default=200, help="runs without a fault, of a design")
    parser.add_argument("--only", default="", help="designs whose titles hold this")
    parser.add_argument("--epochs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    flux = PHOTONS / EXPOSURE_S
    for title, words in DESIGNS.items():
        if arguments.only not in title:
            continue
        of_looks, start = title.startswith("live"), time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            patterns = learned(words, Path(folder), arguments.epochs)
            print(f"{title}\n| fault | refused or named | after | right | likeliest |", flush=True)
            for row, fault in enumerate((*FAULTS, SOUND)):
                camera = camera_with(fault, patterns, flux)
                count = arguments.sound if fault == SOUND else arguments.runs
                seeds = [arguments.seed + 10_000 * row + k for k in range(count)]
                run_of = live if of_looks else recorded
                runs = [run_of(patterns, camera, flux, seed) for seed in seeds]
                names = [run.likeliest for run in runs]
                most = max(set(names), key=names.count)
                share = np.mean([run.right for run in runs]) / SCENES
                after = f"{np.median([run.after for run in runs]):.0f}" if of_looks else "40"
                print(
                    f"| {fault} | {sum(run.named for run in runs)} of {count} "
                    f"({sum(run.refused for run in runs)} refused) | {after} | {share:.3f} | "
                    f"{most} ({names.count(most)}) |",
                    flush=True,
                )
        print(f"{time.monotonic() - start:.0f} s\n", flush=True)


if __name__ == "__main__":
    main()
