"""Frames for a DLP7000 beside what one would write instead: the same work, side by side.

    python benchmarks/dmd.py
    python benchmarks/dmd.py --quick          # the same in a moment

32 x 32 cells of 24 x 32 mirrors; a frame is 98 304 bytes. "hadamard" is 1024 signed masks, 2047
frames of full and dark cells; "grey" is 92 signed masks, 184 frames with every grey level. Ours is
`deepfsi.patterns.frames.make_frames`, one thread. Beside it, for each frame,

    ordered    the mask enlarged by `numpy.kron`, compared with the order of the mirrors (made
               beforehand), and `numpy.packbits`; the frames are the same, bit by bit
    random     `Generator.choice` of mirrors for each cell, and `numpy.packbits`

Then what the order of the mirrors is for: how far k mirrors of a cell are from k/K of its light, in
mirrors of the brightest light in the cell (root mean square over k, places and angles), where a
scene varies within a cell: gradients, edges, blurred edges, and a photograph that fills the device
(scikit-learn's china.jpg). For random mirrors that is exact; for those in order it is summed.

Then whole exports, with hashes and files, into a temporary folder, and the peak of the memory that
they allocate (by tracemalloc, in a run of its own), for two lengths. Medians over rounds in which
all ways take turns; every figure is wall time, with the machine's noise in it: run it alone.
"""

import argparse
import statistics
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from skimage.transform import resize
from sklearn.datasets import load_sample_image

from deepfsi.camera.device import DEVICES
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.jobs.designs import hadamard_masks
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import make_frames, unpack
from deepfsi.patterns.rails import DesignRails

DEVICE = DEVICES["dlp7000"]
SHAPE = (32, 32)
LAYOUT = DmdLayout(stretch=True)
GRID = find_grid(DEVICE, SHAPE, LAYOUT)


def order_mirrors() -> np.ndarray:
    """Number of each mirror of a cell in the order in which grey levels switch them ON."""
    levels = np.arange(GRID.mirrors + 1)[:, None].repeat(SHAPE[0] * SHAPE[1], axis=1)
    cell = GRID.top, GRID.left
    off = np.zeros((GRID.height, GRID.width), int)
    for frame in make_frames(levels, DEVICE, GRID):
        window = unpack(frame, DEVICE)[cell[0] :, cell[1] :]
        off += ~window[: GRID.height, : GRID.width]
    return off - 1


ORDER = order_mirrors()


def signed(name: str, masks: int) -> np.ndarray:
    """Rails (2, masks, N) that one device can show for equal times."""
    if name == "hadamard":
        matrix = hadamard_masks(SHAPE, masks)
    else:
        matrix = np.random.default_rng(0).uniform(-1, 1, (masks, SHAPE[0] * SHAPE[1]))
    return np.stack([matrix.clip(0), (-matrix).clip(0)]) / (2 * masks)


def count_mirrors(rails: np.ndarray) -> np.ndarray:
    """Mirrors ON in each cell (f, N) of the frames of rails (2, masks, N), without dark ones."""
    parts = rails.swapaxes(0, 1).reshape(-1, rails.shape[-1])
    peaks = parts.max(axis=1, keepdims=True)
    lit = peaks.ravel() > 0
    return np.rint(parts[lit] / (peaks[lit] / GRID.mirrors)).astype(np.uint32)


def plain_ordered(on: np.ndarray) -> Iterator[np.ndarray]:
    """Frames as one would write them, from mirrors in order."""
    order = np.tile(ORDER, SHAPE)
    cell = np.ones((GRID.height, GRID.width), dtype=np.uint32)
    for counts in on:
        yield np.packbits(order < np.kron(counts.reshape(SHAPE), cell), axis=1)


def plain_random(on: np.ndarray) -> Iterator[np.ndarray]:
    """Frames as one would write them, from mirrors drawn at random."""
    rng = np.random.default_rng(0)
    for counts in on:
        mirrors = np.zeros((DEVICE.rows, DEVICE.columns), dtype=bool)
        for cell, count in enumerate(counts):
            row, column = divmod(cell, SHAPE[1])
            lit = rng.choice(GRID.mirrors, count, replace=False)
            down, across = np.divmod(lit, GRID.width)
            mirrors[row * GRID.height + down, column * GRID.width + across] = True
        yield np.packbits(mirrors, axis=1)


def our_ordered(on: np.ndarray) -> Iterator[np.ndarray]:
    return make_frames(on, DEVICE, GRID)


def our_random(on: np.ndarray) -> Iterator[np.ndarray]:
    return make_frames(on, DEVICE, GRID, "random")


def rate(make: Callable[[np.ndarray], Iterator[np.ndarray]], on: np.ndarray) -> float:
    """Frames per second."""
    began = time.perf_counter()
    frames = sum(1 for _ in make(on))
    return frames / (time.perf_counter() - began)


def export(rails: np.ndarray, form: str) -> int:
    """Write a folder; its number of frames."""
    with tempfile.TemporaryDirectory() as folder:
        patterns = Patterns.from_rails(
            DesignRails(rails, "equal-dwell", SHAPE, summed_reflectance=1.0),
            DEVICE,
            1e-3,
            format=form,
            layout=LAYOUT,
        ).write(Path(folder) / "patterns")
    return len(patterns.manifest.frames)


def export_rate(rails: np.ndarray, form: str) -> float:
    """Frames per second."""
    began = time.perf_counter()
    frames = export(rails, form)
    return frames / (time.perf_counter() - began)


def peak(rails: np.ndarray) -> tuple[int, int]:
    """Frames of an export and the most bytes that it holds at once, the rails not counted."""
    tracemalloc.start()
    frames = export(rails, "npy")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return frames, most


def scenes() -> dict[str, np.ndarray]:
    """Light on the mirrors of cells, (n, height, width), 0 to 1 in each cell."""
    y, x = ((np.arange(side) + 0.5) / side - 0.5 for side in ORDER.shape)
    turns = np.arange(24) * np.pi / 24
    across = np.stack([np.cos(turn) * x + np.sin(turn) * y[:, None] for turn in turns])
    far = np.concatenate([across - offset for offset in (-0.3, -0.1, 0.05, 0.2)])
    photograph = load_sample_image("china.jpg").mean(axis=2)
    whole = resize(photograph, (DEVICE.rows, DEVICE.columns), order=3)
    patches = whole.reshape(SHAPE[0], GRID.height, SHAPE[1], GRID.width).swapaxes(1, 2)
    patches = patches.reshape(-1, *ORDER.shape)
    return {
        "gradient": across + 0.5,
        "edge": (far > 0).astype(float),
        "blurred edge": 1 / (1 + np.exp(-far / 0.08)),
        "photograph": patches / patches.max(axis=(1, 2), keepdims=True),
    }


def grey_errors(cells: np.ndarray) -> tuple[float, float]:
    """Root mean square error of random and of ordered mirrors, over all grey levels."""
    flat, k = cells.reshape(len(cells), -1), np.arange(1, GRID.mirrors + 1)
    random = flat.var(axis=1).mean() * (k * (GRID.mirrors - k)).mean() / (GRID.mirrors - 1)
    sums = np.cumsum(flat[:, ORDER.argsort(axis=None)], axis=1)
    ordered = np.square(sums - sums[:, -1:] * k / GRID.mirrors).mean()
    return float(random**0.5), float(ordered**0.5)


def main(given: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--part", type=int, default=200, help="frames of the plain ways, at most")
    parser.add_argument("--masks", type=int, nargs=2, default=[1024, 92], help="hadamard, grey")
    parser.add_argument("--quick", action="store_true", help="a moment's run that proves nothing")
    arguments = parser.parse_args(given)
    if arguments.quick:
        arguments.rounds, arguments.part, arguments.masks = 1, 2, [4, 2]

    works = dict(zip(("hadamard", "grey"), arguments.masks, strict=True))
    rails = {name: signed(name, masks) for name, masks in works.items()}
    on = {name: count_mirrors(given) for name, given in rails.items()}
    rates: dict[tuple[str, ...], list[float]] = {}
    for _ in range(arguments.rounds):
        for name, counts in on.items():
            part = counts[: arguments.part]
            for selection, ours, plain in (
                ("ordered", our_ordered, plain_ordered),
                ("random", our_random, plain_random),
            ):
                own = counts if selection == "ordered" else part
                rates.setdefault((name, selection, "ours"), []).append(rate(ours, own))
                rates.setdefault((name, selection, "plain"), []).append(rate(plain, part))
            for form in ("npy", "raw", "png"):
                rates.setdefault((name, form), []).append(export_rate(rails[name], form))
    medians = {key: statistics.median(values) for key, values in rates.items()}

    frames = ", ".join(f"{name} {len(counts)} frames" for name, counts in on.items())
    print(f"{frames}; frames a second, median of {arguments.rounds}, numpy {np.__version__}\n")
    print("| frames | mirrors | plain | ours | ratio |\n| --- | --- | --- | --- | --- |")
    for name in on:
        for selection in ("ordered", "random"):
            plain, ours = (medians[name, selection, way] for way in ("plain", "ours"))
            print(f"| {name} | {selection} | {plain:.0f} | {ours:.0f} | {ours / plain:.1f} |")
    print("\n| scene in a cell | random mirrors | ordered | ratio |\n| --- | --- | --- | --- |")
    for name, cells in scenes().items():
        random, ordered = grey_errors(cells)
        print(f"| {name} | {random:.2f} | {ordered:.2f} | {random / ordered:.1f} |")
    print("\n| export | npy | raw | png |\n| --- | --- | --- | --- |")
    for name in on:
        print(
            f"| {name} | "
            + " | ".join(f"{medians[name, f]:.0f}" for f in ("npy", "raw", "png"))
            + " |"
        )
    print("\n| hadamard, frames | frames, MB | mirror counts, MB | peak of an export, MB |")
    print("| --- | --- | --- | --- |")
    for masks in (works["hadamard"] // 4, works["hadamard"]):
        count, most = peak(rails["hadamard"][:, :masks])
        sizes = count * DEVICE.frame_bytes, 4 * (count - 4) * SHAPE[0] * SHAPE[1], most
        print(f"| {count} | " + " | ".join(f"{size / 1e6:.1f}" for size in sizes) + " |")


if __name__ == "__main__":
    main()
