"""Peak memory and time of a training on large uint8 data, by the form in which they are given.

    python benchmarks/memory.py                     # 50 000 scenes of 64 x 64, 0.2 GB
    python benchmarks/memory.py --scenes 25000 --forms mapped --designs deepfsi

Every row is a process of its own. Memory is the most that it took (`RssAnon`, without files),
less what the same process takes for a few scenes.
Seconds are those of the processor, so that other programs do not count: of the whole call, loading
included, and of one epoch of it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np

FORMS = ("array", "mapped")
"""An array in memory, a memory-mapped .npy file."""

MASKS = 20
CLASSES = 10
FEW = 1000
"""Scenes of the process that large ones are compared with: 16 MB as float32."""


def synthetic(scenes: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Noisy patterns (n, H, W), one of each class, and their labels."""
    rng = np.random.default_rng(0)
    labels = np.arange(scenes) % CLASSES
    patterns = rng.integers(0, 128, (CLASSES, side, side), dtype=np.uint8)
    x = rng.integers(0, 128, (scenes, side, side), dtype=np.uint8)
    for label in range(CLASSES):
        x[label::CLASSES] += patterns[label]
    return x, labels


def write(form: str, folder: Path, scenes: int, side: int) -> Path:
    """Scenes in a form, below a folder."""
    x, labels = synthetic(scenes, side)
    made = folder / f"{form}-{scenes}"
    made.mkdir()
    np.save(made / "x.npy", x)
    np.save(made / "y.npy", labels)
    return made


def memory() -> float:
    """Memory that this process takes without files, GB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1.024e-6 for line in lines if line.startswith("RssAnon"))


def train_once(form: str, path: Path, design: str, epochs: int) -> dict[str, float]:
    """Train in this process; memory and seconds."""
    from deepfsi import Training, learn
    from deepfsi.base.progress import Progress

    marks: list[tuple[float, float]] = []
    taken, done = [memory()], Event()

    def watch() -> None:
        while not done.wait(0.005):
            taken.append(memory())

    watching = Thread(target=watch)
    watching.start()
    began = time.process_time()
    source: Any = tuple(
        np.load(path / name, mmap_mode="r" if form == "mapped" else None)
        for name in ("x.npy", "y.npy")
    )
    learn(
        source,
        design=design,
        masks=MASKS,
        photons=1e4,
        camera="dmd",
        training=Training(epochs=epochs, batch=500),
        device="cpu",
        report=Progress(lambda share, what: marks.append((share, time.process_time()))),
    )
    whole = time.process_time() - began
    done.set()
    watching.join()
    first = max(at for share, at in marks if share <= 0)
    last = min(at for share, at in marks if share >= 1)
    return {"peak": max(taken), "seconds": whole, "epoch": (last - first) / epochs}


def measured(form: str, path: Path, design: str, epochs: int) -> dict[str, float]:
    """`train_once` in a process of its own."""
    words = [sys.executable, __file__, "--once", form, str(path), design, str(epochs)]
    done = subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True)
    made: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return made


def main(words: Sequence[str] | None = None) -> None:
    words = sys.argv[1:] if words is None else words
    if words[:1] == ["--once"]:
        _, form, path, design, epochs = words
        print(json.dumps(train_once(form, Path(path), design, int(epochs))))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=50_000)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--forms", nargs="+", default=FORMS, choices=FORMS)
    parser.add_argument("--designs", nargs="+", default=("deepfsi", "pca"))
    given = parser.parse_args(words)
    size = given.scenes * given.side**2 / 1e9
    print(f"{given.scenes} scenes of {given.side} x {given.side}, {size:.2f} GB as uint8\n")
    print("| data | design | peak, GB | whole call, s | an epoch, s |")
    print("| --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for form in given.forms:
            few = write(form, Path(folder), FEW, given.side)
            path = write(form, Path(folder), given.scenes, given.side)
            for design in given.designs:
                least = measured(form, few, design, epochs=1)["peak"]
                row = measured(form, path, design, epochs=given.epochs)
                print(
                    f"| {form} | {design} | {row['peak'] - least:.2f} "
                    f"| {row['seconds']:.1f} | {row['epoch']:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
