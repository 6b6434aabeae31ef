"""Time and memory as records, pixels, scenes and classes grow, each by itself.

    python benchmarks/growth.py                     # all four tables
    python benchmarks/growth.py records pixels      # some of them

Times are of the processor, so that other programs do not count; memory is the most that the process
of a row took beyond what it began with. Every row of a training runs in a process of its own.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deepfsi.datasets.arrays import from_arrays
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.report.comparison_page import write_report
from deepfsi.sweeps.plan import plan_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.records import FinishedTrial, Records
from deepfsi.sweeps.results import write_results
from deepfsi.sweeps.run import run_trials
from deepfsi.sweeps.summary import summarise_records
from deepfsi.training.learning import learn

SIZES = {
    "records": (100, 1000, 10_000),
    "pixels": (32, 64, 128, 256),
    "scenes": (1000, 10_000, 100_000, 1_000_000),
    "classes": (2, 10, 100, 1000),
}
"""Records in a folder; pixels of a side; training scenes; classes."""

MASKS = 10


def synthetic(scenes: int, side: int, classes: int) -> Dataset:
    """Noisy patterns, one of each class, as many test scenes as training scenes at most a tenth."""
    rng = np.random.default_rng(0)
    labels = np.arange(scenes + max(classes, scenes // 10)) % classes
    patterns = rng.integers(0, 256, (classes, side, side), dtype=np.uint8)
    x = patterns[labels] // 2 + rng.integers(0, 128, (len(labels), side, side), dtype=np.uint8)
    return from_arrays(x[:scenes], labels[:scenes], x[scenes:], labels[scenes:])


def peak() -> float:
    """Most memory that this process took so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def train_once(scenes: int, side: int, classes: int) -> dict[str, float]:
    """Processor seconds and memory of making a data set, and of one epoch with its set-up."""
    learn(
        synthetic(100, 4, 2), photons=1e3, masks=2, camera="paper", training={"epochs": 1}
    )  # loads what all need
    before, began = peak(), time.process_time()
    data = synthetic(scenes, side, classes)
    made = time.process_time()
    learn(data, photons=1e4, masks=MASKS, camera="paper", training={"epochs": 1, "batch": 100})
    return {
        "made": made - began,
        "seconds": time.process_time() - made,
        "megabytes": peak() - before,
        "scenes": data.x_train.nbytes / 1e6,
    }


def row(scenes: int, side: int, classes: int) -> dict[str, float]:
    """`train_once` in a process of its own."""
    words = [sys.executable, __file__, "--once", *map(str, (scenes, side, classes))]
    found = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    return dict(json.loads(found))


def records(count: int) -> None:
    """Seconds of what a folder of finished trials is asked for; one design stands for all."""
    data = load_dataset("digits")
    seeds = min(count, 1000)
    photons = tuple(float(n) for n in range(100, 100 + count // seeds))
    settings = {"draws": 1, "validation": 200, "training": {"epochs": 1, "hidden": [4]}}
    recipe = Recipe(designs="pca", masks=3, photons=photons, trials=seeds, **settings)
    with tempfile.TemporaryDirectory() as place:
        folder, times = Path(place), [time.process_time()]
        trials = plan_trials(recipe, data)
        times.append(time.process_time())
        (record,) = run_trials(trials[:1], data, folder, device="cpu")
        written, design = Records(folder), (folder / "designs" / f"{record['design']}.safetensors")
        content = design.read_bytes()
        for trial in trials[1:]:
            own = {"key": trial.key, "design": trial.design_key}
            own["trial"] = trial.model_dump(mode="json")
            written.lock([trial])
            written.write([FinishedTrial(trial, {**record, **own}, content)])
        times.append(time.process_time())
        found = run_trials(trials, data, folder, device="cpu")
        times.append(time.process_time())
        results = summarise_records(recipe, data, [data], [found], command="", seconds=0.0)
        write_results(folder / "results.json", results)
        write_report(folder)
        times.append(time.process_time())
    spent = np.diff(times)
    print(f"| {count} | " + " | ".join(f"{seconds:.2f}" for seconds in spent) + " |", flush=True)


def training_table(what: str, sizes: Sequence[int]) -> None:
    """Print a row of a training for each size."""
    print(f"| {what} | scenes, MB | made, s | an epoch, s | memory, MB |")
    print("| --- | --- | --- | --- | --- |")
    for size in sizes:
        shape = {
            "pixels": (500, size, 10),
            "scenes": (size, 8, 10),
            "classes": (max(4000, 4 * size), 16, size),
        }
        found = row(*shape[what])
        name = f"{size}²" if what == "pixels" else size
        print(
            f"| {name} | {found['scenes']:.0f} | {found['made']:.1f} | {found['seconds']:.1f} "
            f"| {found['megabytes']:.0f} |",
            flush=True,
        )


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", default=[*SIZES], help=", ".join(SIZES))
    parser.add_argument("--most", type=int, default=4, help="rows of each table")
    parser.add_argument("--once", type=int, nargs=3, help=argparse.SUPPRESS)
    asked = parser.parse_args(words)
    if asked.once:
        print(json.dumps(train_once(*asked.once)))
        return
    for what in asked.tables:
        sizes = SIZES[what][: asked.most]
        if what == "records":
            print("| records | plan, s | write, s | resume, s | report, s |")
            print("| --- | --- | --- | --- | --- |")
            for count in sizes:
                records(count)
        else:
            training_table(what, sizes)


if __name__ == "__main__":
    main()
