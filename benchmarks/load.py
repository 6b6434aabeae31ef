"""Time a training alone and beside busy processes, with threads that spin, sleep, or are one.

    python benchmarks/load.py                       # MNIST, 41 masks, alone and beside two
    python benchmarks/load.py --busy 0 4 --rounds 5

The package lets torch's threads sleep while they wait for one another (`OMP_WAIT_POLICY=passive`);
"spinning" is what torch does by itself. Every training runs in a process of its own, the ways in
turn, and the table has the medians. Processor time counts all threads of the training, and stays
comparable where other programs load the machine; wall time does not.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

WAYS = {
    "one thread": {"OMP_NUM_THREADS": "1"},
    "sleeping (ours)": {},
    "spinning (torch's own)": {"GOMP_SPINCOUNT": "300000"},
}
"""Environment of each way; 300 000 turns are what GNU OpenMP takes where nothing is said."""

CHOSEN_HERE = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "OMP_NUM_THREADS")
"""Variables that decide it, of which a training sees those of its way alone."""


def train_once(data: str, scenes: int, masks: int, epochs: int) -> tuple[float, float]:
    """Wall and processor seconds of a training in this process."""
    from deepfsi.datasets.load import load_dataset
    from deepfsi.exposure.training_set import TrainingSet
    from deepfsi.jobs.job import Job
    from deepfsi.jobs.training import Training
    from deepfsi.training.learning import train

    whole = load_dataset(data)
    few = replace(whole, x_train=whole.x_train[:scenes], y_train=whole.y_train[:scenes])
    training_set = TrainingSet(few, "cpu")
    training_set.prepare("pca")
    settings = Training(epochs=epochs, batch=min(500, len(few.y_train)))
    wall, used = time.perf_counter(), time.process_time()
    train(training_set, [Job(masks=masks, photons=1e4, camera="paper", training=settings)])
    return time.perf_counter() - wall, time.process_time() - used


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Run processes that do nothing but use a core."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def measured(way: str, words: Sequence[str]) -> tuple[float, float]:
    """Wall and processor seconds of a training in a process of its own."""
    environment = {name: value for name, value in os.environ.items() if name not in CHOSEN_HERE}
    command = [sys.executable, __file__, "--once", *words]
    done = subprocess.run(
        command, env={**environment, **WAYS[way]}, check=True, capture_output=True, text=True
    )
    wall, used = map(float, done.stdout.split())
    return wall, used


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--scenes", type=int, default=20000, help="that are trained on")
    parser.add_argument("--masks", type=int, default=41)
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--busy", type=int, nargs="+", default=[0, 2], help="processes beside it")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args(words)
    if asked.once:
        print(*train_once(asked.data, asked.scenes, asked.masks, asked.epochs))
        return
    each = [f"--data={asked.data}", f"--scenes={asked.scenes}"]
    each += [f"--masks={asked.masks}", f"--epochs={asked.epochs}"]
    print(f"{os.cpu_count()} cores, load of other programs {os.getloadavg()[0]:.1f}")
    print("| busy beside it | threads | wall s | processor s | processor time / one thread |")
    print("| --- | --- | --- | --- | --- |")
    for count in asked.busy:
        with busy(count):
            rounds = [{way: measured(way, each) for way in WAYS} for _ in range(asked.rounds)]
        alone = statistics.median(times["one thread"][1] for times in rounds)
        for way in WAYS:
            wall, used = (statistics.median(times[way][i] for times in rounds) for i in (0, 1))
            print(f"| {count} | {way} | {wall:.1f} | {used:.1f} | {used / alone:.2f} |", flush=True)


if __name__ == "__main__":
    main()
