"""Live runs that the tests share: a small design, its patterns and a virtual setup."""

from pathlib import Path

import numpy as np

from conftest import quick
from deepfsi.camera.device import find_device
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.drivers.protocols import Setup
from deepfsi.hardware.live import run
from deepfsi.hardware.live.replay import LiveCounts, replay_run
from deepfsi.hardware.live.run import plan_live, run_live
from deepfsi.hardware.patterns.folder import FrameSettings, export_patterns
from deepfsi.hardware.virtual.camera import CAMERAS, arrival_rates
from deepfsi.hardware.virtual.setup import (
    Latencies,
    VirtualCounter,
    VirtualOptics,
    VirtualProjector,
)
from deepfsi.lab.looks import design_rails, open_looks

LOOKS = 3
OPTICS = {
    "single": {"light": "free-dwell", "rails": "single", "levels": 2},
    "dual": {"light": "free-dwell", "rails": "dual", "readout": "both"},
    "two arms": {"light": "two-arm", "readout": "both"},
    "detectors": {"light": "free-dwell", "rails": "single", "detectors": "2x2"},
}
IDEAL = CAMERAS["ideal"]


def make_patterns(folder: Path, digits, optics: str = "single", device=None, **settings) -> Path:
    """Folder of patterns of a design of several looks, on a small device."""
    words = {"masks": 6, "looks": LOOKS, "photons": 1e4, "epochs": 4, **OPTICS[optics], **settings}
    path = quick(digits, **words).save(folder / "looks.safetensors")
    frames = FrameSettings(device or find_device("64x48"), 1e-3)
    export_patterns(design_rails(path), frames, folder / "patterns")
    return folder / "patterns"


def bench(patterns: Path, scenes, flux: float, camera=IDEAL, latencies=None, seed=0) -> Setup:
    every = np.concatenate([scenes, np.zeros_like(scenes[:1])])  # the last one is the darkness
    rates = arrival_rates(patterns, every, camera, flux)
    latencies = latencies or Latencies()
    optics = VirtualOptics(rates, camera, latencies, seed)
    return Setup(
        VirtualProjector(optics),
        VirtualCounter(optics, tuple(range(rates.shape[2]))),
        optics.display,
        lambda: optics.now_s,
        latencies.model_dump(),
    )


def scenes_of(digits, count: int) -> tuple[np.ndarray, tuple[Scene, ...]]:
    """First test scenes as pictures, and their names."""
    x = digits.x_test[:count].reshape(count, *digits.image_shape)
    labels = [digits.classes[y] for y in digits.y_test[:count]]
    return x, tuple(Scene(name=str(k), label=each) for k, each in enumerate(labels))


def replay(folder: Path):
    """Replay a run that was counted."""
    return replay_run(LiveCounts.read(folder), open_looks(folder / "patterns")).scenes


def check_replay(folder: Path, decided: list[run.LiveStep]) -> None:
    """Count a run; its replay comes to the same decisions, bit for bit."""
    LiveCounts.count(folder)
    replayed = replay(folder)
    assert all(each.answer.agrees and each.answer.bit_for_bit for each in replayed)
    again = [one.chances for each in replayed for one in each.decisions]
    assert np.array_equal([each.decision.chances for each in decided], again)


def live(
    folder: Path, patterns: Path, digits, count: int = 5, flux: float = 1e6,
    exposure_s: float = 10e-3, camera=IDEAL, latencies=None, **settings,
) -> list[run.LiveStep]:  # fmt: skip
    """Run a few scenes."""
    x, scenes = scenes_of(digits, count)
    looks = open_looks(patterns)
    acquisition = plan_live(patterns, scenes, exposure_s, looks=looks, **settings)
    devices = bench(patterns, x, flux, camera, latencies)
    return list(run_live(folder, patterns, acquisition, devices, looks))
