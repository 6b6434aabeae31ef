"""A live run replayed from its files: photons counted again, and the decisions that follow.

The photon file and `shown.jsonl` hold all that the loop knew. `count_live` finds each frame by the
number of its marker and counts its gate; `replay_run` hands the counts to the code that decided,
asks of every list whether it is the one that was shown, and gives the decisions.
"""

import io
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from deepfsi.base import SILENT, InputError, Progress, hash_file, write_atomically
from deepfsi.base.numeric import read_npz
from deepfsi.designfile import SceneReadouts
from deepfsi.hardware.counting import Acquisition, FrameCounts, read_run
from deepfsi.hardware.light import PARTS
from deepfsi.hardware.live import shown
from deepfsi.hardware.live.decisions import Decision, Observer
from deepfsi.hardware.live.looks import FrameList, LiveLooks
from deepfsi.hardware.live.shown import DARK, ShownList, ShownScene, read_shown
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.photons import (
    PhotonSource,
    count_windows,
    cut_windows,
    read_markers,
)
from deepfsi.lab.results import LiveScene

PHOTONS, COUNTS = "photons.ptu", "counts.npz"
"""Files of the recording and its counts."""

COUNTED = ("acquisition.json", shown.NAME, PHOTONS)
"""Files whose hashes the counts hold."""


def is_live(folder: Path) -> bool:
    """True for the folder of a live run, which has a record of its frames."""
    return (folder / shown.NAME).exists()


@dataclass(frozen=True)
class LiveCounts:
    """Counts of the finished scenes of a live run."""

    acquisition: Acquisition
    manifest: Manifest
    scenes: tuple[ShownScene, ...]  # with their frames and gates
    found: FrameCounts  # scene by scene, list by list, frame by frame

    @property
    def by_scene(self) -> Iterator[tuple[ShownScene, list[FrameCounts]]]:
        """Scenes with the counts of their lists."""
        stop = 0
        for scene in self.scenes:
            lists = []
            for each in scene.lists:
                start, stop = stop, stop + len(each.frames)
                lists.append(self.found[start:stop])
            yield scene, lists


def count_live(folder: Path, report: Progress = SILENT) -> LiveCounts:
    """Count the photons of a live run and write counts.npz."""
    run, scenes = read_run(folder), read_shown(folder)
    acquisition, header = run.acquisition, run.open_photons()
    markers, starts, stops = _find_gates(header, scenes, acquisition, report.between(0.0, 0.4))
    parts = cut_windows(starts, stops, PARTS)
    counts = count_windows(header.path, *parts, acquisition.inputs, report.between(0.4, 1.0))
    found = FrameCounts(
        markers.astype(np.float64) * header.tick_s, counts.reshape(len(markers), PARTS, -1)
    )
    about = json.dumps({name: hash_file(folder / name) for name in COUNTED}).encode()
    file = io.BytesIO()
    np.savez(
        file, counts=found.parts, starts_s=found.starts_s, about=np.frombuffer(about, np.uint8)
    )
    write_atomically(folder / COUNTS, file.getvalue())
    return LiveCounts(acquisition, run.manifest, scenes, found)


def _find_gates(
    header: PhotonSource, scenes: tuple[ShownScene, ...], acquisition: Acquisition, report: Progress
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Markers, starts and stops of all gates, ticks, as the counter had them while it ran."""
    times, bits = read_markers(header.path, report)
    times = times[bits & acquisition.marker_bit != 0]
    places = np.concatenate([np.concatenate(each.first_markers) for each in scenes])
    if places.max() >= len(times):
        raise InputError(
            f"{header.path} has {len(times)} frame markers, and {shown.NAME} says at least "
            f"{places.max() + 1}: give the photon file of this run"
        )
    gate_ns = np.concatenate([part.gate_ns for each in scenes for part in each.lists])
    starts = times[places] + round(acquisition.settle_s / header.tick_s)
    lengths = np.rint(gate_ns * 1e-9 / header.tick_s).astype(np.int64)
    return times[places], starts, starts + lengths


def read_live_counts(folder: Path) -> LiveCounts:
    """Counts of a live run as `count_live` wrote them."""
    path, again = folder / COUNTS, "count again with `deepfsi camera count`"
    scenes = read_shown(folder)
    run = read_run(folder)
    acquisition, patterns = run.acquisition, run.patterns
    held = read_npz(path, again)
    try:
        counts, starts = held["counts"], held["starts_s"]
        about = json.loads(held["about"].tobytes())
    except (KeyError, ValueError, RecursionError):
        raise InputError(f"{path} is not a whole file of counts: {again}") from None
    frames = sum(len(each.frames) for scene in scenes for each in scene.lists)
    wanted = frames, PARTS, len(acquisition.inputs)
    hashes = {name: hash_file(folder / name) for name in COUNTED}
    whole = counts.shape == wanted and counts.dtype == np.int64
    whole &= starts.shape == (frames,) and starts.dtype == np.float64
    if not whole or about != hashes:
        raise InputError(f"{path} is of other files than those beside it: {again}")
    return LiveCounts(acquisition, patterns.manifest, scenes, FrameCounts(starts, counts))


@dataclass(frozen=True)
class Replayed:
    """A scene of a run replayed."""

    shown: ShownScene  # as the run has it
    decisions: tuple[Decision, ...]  # after each look, from its counts; none without light
    answer: LiveScene
    rows: SceneReadouts | None = None  # its counts behind its masks; none without light


def replay_run(run: LiveCounts, looks: LiveLooks) -> tuple[Replayed, ...]:
    """Decisions of a live run from its counts, or `InputError` where they lead to other looks."""
    observer = Observer(looks, run.manifest, run.acquisition)
    out = []
    for scene, counts in run.by_scene:
        left = list(zip(scene.lists, counts, strict=True))
        if scene.scene == DARK:
            observer.measure_background(partial(_recall, left))
            continue
        decisions = tuple(observer.observe(scene.scene, partial(_recall, left)))
        last = decisions[-1] if decisions else None
        found = () if last is None else tuple(last.chances.tolist())
        faults = () if last is None else last.faults
        agrees = not left and (found, faults) == (scene.chances, scene.faults)
        named = run.acquisition.scenes[scene.scene]
        answer = LiveScene.of(named, last, looks, scene.clock_s, agrees)
        out.append(Replayed(scene, decisions, answer, observer.rows if decisions else None))
    return tuple(out)


def check_as_it_was(given: Iterable[object]) -> None:
    """Raise `InputError` if a live run is to be counted or classified otherwise than it was."""
    if any(each is not None for each in given):
        raise InputError(
            "a live run is counted and classified as it was: its looks followed from these counts; "
            "leave the options out"
        )


def _recall(left: list[tuple[ShownList, FrameCounts]], asked: FrameList) -> FrameCounts:
    """Counts of the next list that was shown, in place of devices."""
    if not left or not left[0][0].matches(asked):
        raise InputError(
            "a look of this run is not the one that follows from its counts: it was made with "
            "another version of the design, of deepfsi or of NumPy"
        )
    return left.pop(0)[1]
