"""How fast photons are counted while their bytes arrive.

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

from deepfsi.counting.events import PtuWriter
from deepfsi.counting.reader import PtuFile, count_windows, read_markers
from deepfsi.counting.streaming import FrameCounter, FrameGates

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
            found.append(counter.feed(data))
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
    part = parts.add_parser("work", help=work.__doc__)
    part.add_argument("way", choices=WAYS)
    part.add_argument("path", type=Path)
    part.add_argument("settings", type=float, nargs=4)
    part.set_defaults(run=lambda given: work(given.way, given.path, *given.settings))
    arguments = parser.parse_args(given)
    arguments.run(arguments)


if __name__ == "__main__":
    main()
