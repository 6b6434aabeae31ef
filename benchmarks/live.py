"""How fast photons are counted while their bytes arrive, and how soon a look is decided upon.

    python benchmarks/live.py decision                    # a minute, one core

A decision is the class and the next look's dwells, from counts to gates, in NumPy on one core. From
marker to decision is from the block of bytes that ends a look until the next list of frames has
been told to the counter, in the process that reads all photons. Times of the processor are those
that one core needs; on the clock other programs' work counts too.

    python benchmarks/live.py reader                      # 100 million records, 400 MB
    python benchmarks/live.py reader --records 5e7 --frame 1e-4 --inputs 2 --blocks 4096 65536

A T2 file of 1 ps ticks is written, one marker at the start of each frame and Poisson photons all
along at 1e7 a second. Each frame has a gate, and all counts must agree. What is timed is file to
counts:

- stream: `FrameCounter`, fed with the file's bytes block after block; all gates are told first.
- whole file: `read_markers`, then `count_gates`.
- numpy: the whole file in memory, times from a cumulative sum of the overflows, markers and
  photons selected from them, `searchsorted` of the gates' edges.

Each runs in a process of its own, in turn, with the file in the system's cache. Times are those of
the processor, on one core; the least of the rounds, beside their median. Memory is the most that
the process held (Linux's `VmHWM`), less what it held when everything was imported.
"""

import argparse
import itertools
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deepfsi.camera.device import find_device
from deepfsi.designfile.design_file import DesignFile
from deepfsi.designfile.header import MaskHeader
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.counting.streaming import FrameCounter, FrameCounts, FrameGates
from deepfsi.hardware.drivers.protocols import Setup
from deepfsi.hardware.live.looks import FixedMaskLooks, FrameList
from deepfsi.hardware.live.observer import SceneObserver
from deepfsi.hardware.live.run import plan_live, run_live
from deepfsi.hardware.patterns.folder import FrameSettings, export_patterns, read_patterns
from deepfsi.hardware.patterns.manifest import DesignRails
from deepfsi.hardware.photons.ptu import PtuWriter
from deepfsi.hardware.photons.reader import PtuFile, count_windows, read_markers
from deepfsi.hardware.virtual.camera import VirtualCamera, arrival_rates
from deepfsi.hardware.virtual.setup import (
    Latencies,
    VirtualCounter,
    VirtualOptics,
    VirtualProjector,
)

FLUX, TICK_S, SETTLE_S = 1e7, 1e-12, 1e-5
GATE = 0.8
"""Share of a frame, after settling, in which photons are counted."""


def record(path: Path, records: float, frame_s: float, inputs: int) -> int:
    """Write a recording, and give the number of its frames."""
    rng = np.random.default_rng(0)
    # overflows are records too: one for each 2^25 ticks
    photons = frame_s * FLUX
    frames = round(records / (photons * (1 + 1 / (FLUX * TICK_S * 2**25)) + 1))
    frame, at_once = round(frame_s / TICK_S), max(1, round(1e6 / photons))
    with PtuWriter(path, TICK_S) as writer:
        for first in range(0, frames, at_once):
            last = min(first + at_once, frames)
            some = rng.integers(first * frame, last * frame, rng.poisson((last - first) * photons))
            times = np.concatenate([np.arange(first, last) * frame, np.sort(some)])
            codes = rng.integers(0, inputs, len(times), dtype=np.int16)
            codes[: last - first] = -1
            order = np.argsort(times, kind="stable")
            writer.write(times[order], codes[order])
        writer.write(np.array([frames * frame]), np.array([-2]))
    return frames


def stream(path: Path, frames: int, frame_s: float, inputs: int, block: int) -> np.ndarray:
    """Counts, shape (frames, inputs)."""
    counter, found = FrameCounter(range(inputs), stream=path), []
    counter.expect(FrameGates.of(SETTLE_S, np.full(frames, GATE * (frame_s - SETTLE_S))))
    with path.open("rb", buffering=0) as file:
        while data := file.read(block):
            found.append(counter.feed(data).counts)
    return np.concatenate(found)


def edges(markers: np.ndarray, frame_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Starts and stops of the gates, ticks."""
    starts = markers + round(SETTLE_S / TICK_S)
    return starts, starts + round(GATE * (frame_s - SETTLE_S) / TICK_S)


def whole(path: Path, frames: int, frame_s: float, inputs: int, block: int) -> np.ndarray:
    """Counts, shape (frames, inputs)."""
    times, bits = read_markers(path)
    return count_windows(path, *edges(times[bits == 1], frame_s), range(inputs))


def plain(path: Path, frames: int, frame_s: float, inputs: int, block: int) -> np.ndarray:
    """Counts, shape (frames, inputs)."""
    words = np.fromfile(path, "<u4", offset=PtuFile(path).header.offset)
    special, channel = words >> 31 != 0, words >> 25 & 63
    overflow = special & (channel == 63)
    wraps = np.cumsum(np.where(overflow, np.maximum(words & (1 << 25) - 1, 1), 0), dtype=np.int64)
    times = (wraps << 25) + (words & (1 << 25) - 1)
    starts, stops = edges(times[special & (channel == 1)], frame_s)
    counts = []
    for each in range(inputs):
        chosen = times[~special & (channel == each)]
        counts.append(np.searchsorted(chosen, stops) - np.searchsorted(chosen, starts))
    return np.stack(counts, axis=1)


WAYS = {"stream": stream, "whole file": whole, "numpy": plain}


def held() -> int:
    """Bytes that this process has held at most (Linux)."""
    (kibibytes,) = re.findall(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return 1024 * int(kibibytes)


def work(way: str, path: Path, *settings: float) -> None:
    """Count once, and print how long it took, in how much memory, and the sum of the counts."""
    frames, frame_s, inputs, block = settings
    Path("/proc/self/clear_refs").write_text("5")  # the most held so far is forgotten
    before = held()
    began = time.process_time()
    counts = WAYS[way](path, int(frames), frame_s, int(inputs), int(block))
    took = time.process_time() - began
    most = held() - before
    weights = np.arange(1, counts.size + 1).reshape(counts.shape)
    digest = [len(counts), int(counts.sum()), int((counts * weights).sum())]
    print(json.dumps({"seconds": took, "memory": most, "counts": digest}))


def reader(arguments: argparse.Namespace) -> None:
    """Run all ways in turn and print a table."""
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        path = Path(folder) / "photons.ptu"
        frames = record(path, arguments.records, arguments.frame, arguments.inputs)
        records, size = PtuFile(path).header.records, path.stat().st_size
        ways = [("stream", block) for block in arguments.blocks]
        ways += [("whole file", 0), ("numpy", 0)]
        found: dict[tuple[str, int], list[dict]] = {each: [] for each in ways}
        for _ in range(arguments.rounds):
            for way, block in ways:
                settings = (frames, arguments.frame, arguments.inputs, block)
                command = [sys.executable, __file__, "work", way, path, *settings]
                answer = subprocess.run([*map(str, command)], check=True, capture_output=True)
                found[way, block].append(json.loads(answer.stdout))
    assert len({tuple(each["counts"]) for every in found.values() for each in every}) == 1
    print(
        f"{records:,} records ({size / 1e6:.0f} MB), {frames:,} frames of "
        f"{arguments.frame * 1e3:g} ms on {arguments.inputs} input(s); {arguments.rounds} rounds\n"
    )
    print("| way | Mrec/s, best | median | times the first's time | memory, MB | of the file |")
    print("| --- | --- | --- | --- | --- | --- |")
    first = min(each["seconds"] for each in found[ways[0]])
    for (way, block), every in found.items():
        seconds = [each["seconds"] for each in every]
        best, median = min(seconds), statistics.median(seconds)
        memory = max(each["memory"] for each in every)
        name = f"{way}, {block:,} bytes at once" if block else way
        print(
            f"| {name} | {records / best / 1e6:.0f} | {records / median / 1e6:.0f} | "
            f"{best / first:.2f} | {memory / 1e6:.0f} | {memory / size:.1%} |"
        )


LOOKS, MASKS, EXPOSURE_S = 4, 60, 10e-3
"""Of the loop that is timed: those of the README's design."""


def made_design(masks: int, hidden: Sequence[int]) -> DesignFile:
    """A design of several looks of some size, whose masks and weights are drawn."""
    rng = np.random.default_rng(0)
    header = MaskHeader(
        name="deepfsi", light="free-dwell", readout="difference", summed_reflectance=32.0,
        image_shape=(8, 8), classes=tuple("0123456789"), info={},
        exposure={"kind": "adaptive", "looks": LOOKS, "hidden": hidden, "shortest": 0.0},
        classifier={"kind": "mlp", "hidden": hidden, "dropout": 0.0},
    )  # fmt: skip
    mean = np.full(masks, 0.5 / masks, np.float32)
    arrays = {"mean": mean, "std": mean / 5, "shares": mean}
    widths = {"classifier": (2 * masks, *hidden, 10), "exposure": (2 * masks + 1, *hidden, masks)}
    for network, sizes in widths.items():
        for place, (before, after) in enumerate(itertools.pairwise(sizes)):
            weight = rng.normal(size=(before, after)).astype(np.float32) / before**0.5
            arrays[f"{network}.layers.{place}.weight"] = weight.T
            arrays[f"{network}.layers.{place}.bias"] = np.zeros(after, np.float32)
    arrays["temperatures.logs"] = np.zeros((LOOKS, 9))
    arrays["temperatures.budgets"] = np.geomspace(1e2, 1e6, 9)
    drawn = np.random.default_rng(2).integers(0, 2, (1, masks, 64)) / masks
    return DesignFile(header, arrays | {"rails": drawn.astype(np.float32)})


def decide(design: DesignFile, features: np.ndarray, dwell: np.ndarray) -> None:
    """Probabilities of the classes, and the dwells of the next look."""
    inputs = design.inputs(features, dwell)
    design.chances(inputs, 1e4)
    design.next_dwell(inputs, 1, 0.003)


def now() -> np.ndarray:
    """Time of the processor, and on the clock, seconds."""
    return np.array([time.process_time(), time.perf_counter()])


def print_times(name: str, seconds: list[np.ndarray]) -> None:
    middle, most = np.percentile(np.array(seconds) * 1e6, [50, 99], axis=0)
    print(f"| {name} | {middle[0]:.0f} | {most[0]:.0f} | {middle[1]:.0f} | {most[1]:.0f} |")


def decision(arguments: argparse.Namespace) -> None:
    """Time a decision alone, and from the bytes of a look's last marker to the next list."""
    print("processor and clock: µs, median and 99th percentile\n")
    print("| what | processor | 99 % | clock | 99 % |\n| --- | --- | --- | --- | --- |")
    rng = np.random.default_rng(1)
    for masks, hidden in ((MASKS, (40, 128)), (96, (512, 256))):
        design, seconds = made_design(masks, hidden), []
        for _ in range(arguments.times):
            features, dwell = rng.random(masks) / masks, rng.dirichlet(np.ones(masks)) / LOOKS
            began = now()
            decide(design, features, dwell)
            seconds.append(now() - began)
        widths = " and ".join(map(str, hidden))
        print_times(f"a decision, {masks} masks, hidden layers of {widths}", seconds)
    for flux in arguments.flux:
        for hidden in ((40, 128), (512, 256)):
            widths = " and ".join(map(str, hidden))
            name = f"marker to decision, {MASKS} masks, {widths}, {flux:.0e} photons/s"
            with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
                print_times(name, marker_to_decision(Path(folder), hidden, flux, arguments))


def marker_to_decision(
    folder: Path, hidden: Sequence[int], flux: float, arguments: argparse.Namespace
) -> list[np.ndarray]:
    """Times from the block of bytes that ends a look until the next list has been told, seconds.

    A virtual run is recorded; its file is then read as it came, look by look, in blocks. Reading
    the last block is part of the time, and so are counts, class, dwells and gates.
    """
    design = made_design(MASKS, hidden)
    rails = DesignRails.of(design, design.to_bytes())
    export_patterns(rails, FrameSettings(find_device("64x48"), 1e-3), folder / "patterns")
    x = np.random.default_rng(3).random((arguments.scenes, 8, 8))
    rates = arrival_rates(folder / "patterns", x, VirtualCamera(), flux)
    setup = VirtualOptics(rates, VirtualCamera(), Latencies())
    devices = Setup(VirtualProjector(setup), VirtualCounter(setup, (0,)), setup.display)
    scenes = tuple(Scene(name=str(k)) for k in range(len(x)))
    acquisition = plan_live(folder / "patterns", scenes, EXPOSURE_S)
    wanted = [
        each.decision.chances
        for each in run_live(folder / "run", folder / "patterns", acquisition, devices)
    ]
    stream = _Replayed(folder / "run" / "photons.ptu", arguments.block)
    patterns = read_patterns(folder / "patterns")
    observer = SceneObserver(FixedMaskLooks(design, patterns), patterns.manifest, acquisition)
    found = []
    for k in range(len(scenes)):
        found += [each.chances for each in observer.observe(k, stream)]
    assert np.array_equal(found, wanted)
    return stream.seconds


class _Replayed:
    """Recording fed look by look, and how long each took from its last block to the next list."""

    def __init__(self, path: Path, block: int) -> None:
        header, self.content = PtuFile(path).header, path.read_bytes()
        words = np.frombuffer(self.content, "<u4", offset=header.offset)
        markers = np.flatnonzero((words >> 31 != 0) & (words >> 25 & 63 != 63))
        self.ends = header.offset + 4 * (markers + 1)  # bytes up to each marker's
        self.counter, self.block = FrameCounter((0,), 1, path), block
        self.seconds: list[np.ndarray] = []
        self.began: np.ndarray | None = None
        self.at = self.markers = self.rests = 0

    def count(self, asked: FrameList) -> FrameCounts:
        gates = np.append(asked.gate_ns, 0) * 1e-9
        self.counter.expect(FrameGates.of(SETTLE_S, gates))
        if self.began is not None:  # all-ON frames follow the last look
            self.seconds.append(now() - self.began)
            self.began = None
        self.markers += len(gates)
        end = int(self.ends[self.markers - 1])
        parts = []
        while self.at < end:
            size = min(self.block, end - self.at)
            if self.at + size == end and asked.look >= 0:
                self.began = now()
            parts.append(self.counter.feed(self.content[self.at : self.at + size]))
            self.at += size
        found = FrameCounts.join(parts, 1)[self.rests :]
        self.rests = len(gates) - len(found.starts_s)
        return found[: len(asked.frames)]


def main(given: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = parser.add_subparsers(required=True)
    part = parts.add_parser("reader", help=reader.__doc__)
    part.add_argument("--records", type=float, default=1e8)
    part.add_argument("--frame", type=float, default=1e-3, help="seconds of a frame")
    part.add_argument("--inputs", type=int, default=2)
    part.add_argument("--blocks", type=int, nargs="+", default=[2**21, 2**18, 2**16])
    part.add_argument("--rounds", type=int, default=3)
    part.add_argument("--folder", type=Path, help="for the file, which is removed at the end")
    part.set_defaults(run=reader)
    part = parts.add_parser("decision", help=decision.__doc__)
    part.add_argument("--times", type=int, default=5000)
    part.add_argument("--scenes", type=int, default=250)
    part.add_argument("--flux", type=float, nargs="+", default=[1e6, 1e7])
    part.add_argument("--block", type=int, default=40_000, help="bytes that arrive at once")
    part.add_argument("--folder", type=Path, help="for the files, which are removed at the end")
    part.set_defaults(run=decision)
    part = parts.add_parser("work", help=work.__doc__)
    part.add_argument("way", choices=WAYS)
    part.add_argument("path", type=Path)
    part.add_argument("settings", type=float, nargs=4)
    part.set_defaults(run=lambda given: work(given.way, given.path, *given.settings))
    arguments = parser.parse_args(given)
    arguments.run(arguments)


if __name__ == "__main__":
    main()
