"""Live runs that the tests share: adaptive masks, their patterns and virtual devices."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi import evaluate, learn
from deepfsi.camera.device import find_device
from deepfsi.counting.acquisition import Scene
from deepfsi.counting.reader import PtuFile, count_windows, read_markers
from deepfsi.counting.recording import Recording
from deepfsi.lab import live as run
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.devices import virtual_setup
from deepfsi.lab.live import LiveRun
from deepfsi.lab.results import Decision, read_log
from deepfsi.lab.virtual_optics import CAMERAS
from deepfsi.patterns.folder import Patterns

LOOKS, FLUX, EXPOSURE_S = 3, 1e6, 10e-3
OPTICS = {"one detector": "dmd", "two arms": "two-arm", "detectors": "dmd-2x2"}
DEVICE = find_device("64x48").model_copy(update={"load_us": 100})


def make_patterns(
    folder: Path, digits, optics: str = "one detector", device=DEVICE, **settings
) -> Path:
    """Folder of patterns of a design of adaptive masks, on a small device."""
    words = {"masks": LOOKS, "photons": 1e4, "camera": OPTICS[optics], **settings}
    path = learn(digits, design="adaptive", **words).save(folder / "adaptive.safetensors")
    Patterns.from_rails(design_rails(path), device, 1e-3).write(folder / "patterns")
    return folder / "patterns"


def planned(
    patterns: Path, scenes: tuple[Scene, ...], exposure_s: float = EXPOSURE_S, flux: float = FLUX,
    camera=CAMERAS["ideal"], **settings: Any,
) -> LiveRun:  # fmt: skip
    """Live run of the patterns in a folder."""
    told = {"flux": flux, "camera": camera.model_dump(mode="json"), "seed": 0, **settings}
    return LiveRun(Patterns.read(patterns), scenes, exposure_s, **told)


def scenes_of(digits, count: int) -> tuple[np.ndarray, tuple[Scene, ...]]:
    """First test scenes as pictures, and their names."""
    x = digits.x_test[:count].reshape(count, *digits.image_shape)
    labels = [digits.classes[y] for y in digits.y_test[:count]]
    return x, tuple(Scene(name=str(k), label=each) for k, each in enumerate(labels))


class Counted:
    """Counts of the lists of a run, as its counter gave them."""

    def __init__(self, monkeypatch) -> None:
        self.lists: list[np.ndarray] = []
        usual = run._DeviceFrames.count
        monkeypatch.setattr(
            run._DeviceFrames,
            "count",
            lambda frames, asked: (counts := usual(frames, asked), self.lists.append(counts))[0],
        )

    def check_file(self, folder: Path) -> None:
        """The photon file of the run has the same counts, by the gates of its log."""
        shown = [each for scene in read_log(folder) for each in scene.lists]
        recorded = Recording.read(folder)
        photons, settings = PtuFile(recorded.photons), recorded.acquisition
        times, bits = read_markers(photons.header.path)
        times = times[bits & settings.marker_bit != 0]
        markers = np.concatenate([each.markers for each in shown])
        first = np.cumsum(markers) - markers
        gated = np.concatenate([[True] * len(each.frames) + [False] for each in shown])
        starts = times[first[gated]] + round(settings.settle_s / photons.header.tick_s)
        gates_s = np.concatenate([each.gate_ns for each in shown]) * 1e-9
        stops = starts + np.rint(gates_s / photons.header.tick_s).astype(np.int64)
        counts = count_windows(photons.header.path, starts, stops, settings.inputs)
        given = np.concatenate(self.lists)
        np.testing.assert_array_equal(counts, given[: len(counts)])


def live(folder: Path, patterns: Path, digits, count: int = 5, **settings) -> list[Decision]:
    """Run a few scenes."""
    x, scenes = scenes_of(digits, count)
    live_run = planned(patterns, scenes, **settings)
    return list(live_run.steps(folder, virtual_setup(live_run.patterns, x, live_run.settings)))


def check_accuracy(decided: list[Decision], design, digits, photons: float) -> float:
    """As many of the first scenes are right as in the design's own exposures; their counts."""
    last = [each.answer for each in decided if each.answer]
    count = len(last)
    right = np.mean([each.predicted == each.label for each in last if each.predicted])
    few = replace(digits, x_test=digits.x_test[:count], y_test=digits.y_test[:count])
    [wanted] = evaluate(design, few, photons, draws=2)
    # of the same scenes, with counts of their own: at most each wrong answer is another one
    spread = np.sqrt(2 * wanted.accuracy * (1 - wanted.accuracy) / count)
    assert abs(right - wanted.accuracy) < 5 * spread
    faults = [fault.kind for each in last for fault in each.faults]
    assert set(faults) <= {"unlike"}
    assert len(faults) <= 4  # 0.01 of 50 at most, at a chance of 1 in 1000
    return wanted.counts
