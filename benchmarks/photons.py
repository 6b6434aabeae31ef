"""Count the photons of a Hadamard run between gates: this package, ptufile, and record by record.

    python benchmarks/photons.py                        # 2048 frames, 70 million records, 280 MB
    python benchmarks/photons.py --records 5e7 --rounds 3 --inputs 2

A T2 file of 1 ps ticks is written, one marker at the start of each frame and Poisson photons all
along at 1e7 a second. From its markers each frame gets a gate; what is timed is file to counts:

- deepfsi: `read_markers`, then `count_gates`.
- ptufile + numpy: `decode_records`, markers and photons selected from it, `searchsorted` of the
  gates' edges.
- a record at a time: a loop in Python over a part of the file that reads, splits and adds up each
  record as PicoQuant's demo does (`PTU/Python/Read_PTU.py` in
  https://github.com/PicoQuant/PicoQuant-Time-Tagged-File-Format-Demos), but keeps counts where the
  demo writes lines of text; its time is scaled to the whole.

All run in turn, on one core, with the file in the system's cache, and must give the same counts.
The memory's bandwidth is that of a sum over the records in memory, best of the rounds. Peak memory
is what numpy and Python ask for, in a run of its own.
"""

import argparse
import statistics
import struct
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import ptufile

from deepfsi.counting.events import PtuWriter
from deepfsi.counting.reader import PtuFile, count_windows, read_markers, summarise

FLUX, FRAMES, TICK_S = 1e7, 2048, 1e-12
PART = 200_000
"""Records that the loop reads."""


def record(path: Path, records: float, inputs: int) -> int:
    """Write a run, and give the ticks of a frame."""
    rng = np.random.default_rng(0)
    # overflows are records too: one for each 2^25 ticks
    photons = records / (1 + 1 / (FLUX * TICK_S * 2**25)) / FRAMES
    frame = round(photons / FLUX / TICK_S)
    with PtuWriter(path, TICK_S) as writer:
        for start in range(0, FRAMES * frame, frame):
            times = start + np.sort(rng.integers(0, frame, rng.poisson(photons)))
            codes = rng.integers(0, inputs, len(times), dtype=np.int16)
            writer.write(np.append(start, times), np.append(np.int16(-1), codes))
    return frame


def gates(markers: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """From a tenth of each frame to its end."""
    return markers + frame // 10, markers + frame


def ours(path: Path, frame: int, inputs: int) -> np.ndarray:
    """Counts, shape (frames, inputs)."""
    markers, _ = read_markers(path)
    return count_windows(path, *gates(markers, frame), range(inputs))


def with_ptufile(path: Path, frame: int, inputs: int) -> np.ndarray:
    """Counts, shape (frames, inputs)."""
    with ptufile.PtuFile(path) as file:
        events = file.decode_records()
    times, channels = events["time"], events["channel"]
    markers = times[(channels < 0) & (events["marker"] > 0)]
    starts, stops = gates(markers, frame)
    counts = []
    for each in range(inputs):
        chosen = times[channels == each]
        counts.append(np.searchsorted(chosen, stops) - np.searchsorted(chosen, starts))
    return np.stack(counts, axis=1)


def loop(path: Path, frame: int, inputs: int, offset: int) -> np.ndarray:
    """Counts of the first records, shape (frames begun, inputs)."""
    wraps, counts, start = 0, [], 0
    with path.open("rb") as file:
        file.seek(offset)
        for _ in range(PART):
            try:
                bits = "{0:0{1}b}".format(struct.unpack("<I", file.read(4))[0], 32)
            except struct.error:
                break
            special = int(bits[0:1], base=2)
            channel = int(bits[1:7], base=2)
            tag = int(bits[7:32], base=2)
            if special == 1:
                if channel == 0x3F:
                    wraps += 2**25 * max(tag, 1)
                elif 1 <= channel <= 15:
                    start = wraps + tag
                    counts.append([0] * inputs)
            elif start + frame // 10 <= wraps + tag < start + frame:
                counts[-1][channel] += 1
    return np.array(counts)


def peak(run: Callable[[], object]) -> float:
    """Bytes that a run holds at most."""
    tracemalloc.start()
    run()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


def seconds(run: Callable[[], object]) -> tuple[float, object]:
    began = time.perf_counter()
    found = run()
    return time.perf_counter() - began, found


def compare(path: Path, frame: int, inputs: int, rounds: int) -> None:
    """Run all in turn and print a table."""
    header = PtuFile(path).header
    share = min(PART, header.records) / header.records
    words = np.fromfile(path, np.uint64, header.records // 2, offset=header.offset)
    ways: dict[str, Callable[[], np.ndarray]] = {
        "deepfsi": lambda: ours(path, frame, inputs),
        "ptufile + numpy": lambda: with_ptufile(path, frame, inputs),
        "a record at a time": lambda: loop(path, frame, inputs, header.offset),
    }
    spent: dict[str, list[float]] = {name: [] for name in ways}
    sums = []
    for _ in range(rounds):
        found = {}
        for name, way in ways.items():
            once, found[name] = seconds(way)
            spent[name].append(once / share if way is ways["a record at a time"] else once)
        sums.append(seconds(words.sum)[0])
        counts, begun = found["deepfsi"], len(found["a record at a time"]) - 1
        assert np.array_equal(counts, found["ptufile + numpy"])
        assert np.array_equal(counts[:begun], found["a record at a time"][:begun])
    bandwidth = words.nbytes / min(sums)
    del words

    contents = summarise(path)
    print(
        f"{header.records:,} records ({header.records * 4 / 1e6:.0f} MB), {len(counts)} frames of "
        f"{frame * TICK_S * 1e3:.2f} ms, {sum(contents.photons.values()):,} photons on {inputs} "
        f"input(s); {counts.sum():,} photons in gates\n"
        f"memory's bandwidth, a sum over the records: {bandwidth / 1e9:.1f} GB/s; {rounds} rounds\n"
    )
    print("| way | seconds, median | lowest to highest | times ours | records/s | of bandwidth |")
    print("| --- | --- | --- | --- | --- | --- |")
    median = {name: statistics.median(times) for name, times in spent.items()}
    for name, times in spent.items():
        speed = header.records / median[name]
        print(
            f"| {name} | {median[name]:.3g} | {min(times):.3g} to {max(times):.3g} | "
            f"{median[name] / median['deepfsi']:.3g} | {speed:.3g} | {4 * speed / bandwidth:.2%} |"
        )
    print()
    for name in ("deepfsi", "ptufile + numpy"):
        print(f"peak memory, {name}: {peak(ways[name]) / 1e6:.1f} MB")


def main(given: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=float, default=7e7)
    parser.add_argument("--inputs", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--folder", type=Path, help="for the file, which is removed at the end")
    arguments = parser.parse_args(given)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        path = Path(folder) / "photons.ptu"
        frame = record(path, arguments.records, arguments.inputs)
        compare(path, frame, arguments.inputs, arguments.rounds)


if __name__ == "__main__":
    main()
