"""Time an epoch with networks in bfloat16 against the same in float32, and compare the accuracies.

    python benchmarks/networks.py                        # widths, in turn
    python benchmarks/networks.py --accuracy             # three seeds, 20 epochs: ten minutes

Only the type of the classifier's products changes: scenes, masks, noise, order and start are the
same. The two train in turn, and the ratio is of the medians of their epochs. Accuracies are of test
images under exact Poisson noise.
"""

import argparse
import statistics
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from deepfsi.camera.camera import Camera
from deepfsi.datasets.load import load_dataset
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.exposure import training_set as rules
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Training
from deepfsi.training.learning import train
from moments import Moments

TYPES = {"float32": 10**9, "bfloat16": 0}
"""Units from which networks are in bfloat16: for none, and for all."""

TIMED = (
    ("free-dwell", 24, "1x1", (40, 128)),
    ("free-dwell", 24, "1x1", (128, 128)),
    ("free-dwell", 24, "1x1", (256, 128)),
    ("free-dwell", 24, "1x1", (512, 256)),
    ("free-dwell", 12, "4x4", (512, 256)),
)
COMPARED = (("free-dwell", 24, "2x2", (512, 256)),)
BUDGETS, SEEDS, EPOCHS = (1e3, 1e4, 1e5), 3, 20


def jobs_of(kind: tuple, budgets: tuple[float, ...], seeds: int, epochs: int) -> list[Job]:
    light, masks, detectors, hidden = kind
    training = Training(epochs=epochs, batch=500, hidden=hidden)
    camera = Camera(light=light, rails="single", detectors=detectors, levels=2)
    return [
        Job(
            masks=masks,
            photons=photons,
            camera=camera,
            training=training,
            seed=seed,
        )
        for photons in budgets
        for seed in range(seeds)
    ]


@contextmanager
def networks_in(name: str) -> Iterator[None]:
    """Let all networks have products of one of the `TYPES`."""
    width, rules.BFLOAT16_WIDTH = rules.BFLOAT16_WIDTH, TYPES[name]
    try:
        (job,) = jobs_of(TIMED[0], (1e4,), 1, 1)
        if rules.network_dtype(job, torch.device("cpu")) != getattr(torch, name):
            raise SystemExit("this processor has no AVX512-BF16: there is nothing to compare")
        yield
    finally:
        rules.BFLOAT16_WIDTH = width


def timed(scenes: TrainingSet, kind: tuple, rounds: int) -> dict[str, float]:
    """Median seconds of an epoch with each type."""
    seconds: dict[str, list[float]] = {name: [] for name in TYPES}
    for _ in range(rounds):
        for name in TYPES:
            moments = Moments()
            with networks_in(name):
                train(scenes, jobs_of(kind, (1e4,), 1, 2), report=moments.report)
            seconds[name] += moments.epochs(2)
    return {name: statistics.median(values) for name, values in seconds.items()}


def accuracies(scenes: TrainingSet, kind: tuple, photons: float) -> dict[str, list[float]]:
    """Test accuracy of each seed with each type."""
    found = {}
    for name in TYPES:
        with networks_in(name):
            designs = [train(scenes, [job])[0] for job in jobs_of(kind, (photons,), SEEDS, EPOCHS)]
        found[name] = [
            evaluate(each, scenes.data, photons, draws=1, seed=seed)[0].accuracy
            for seed, each in enumerate(designs)
        ]
    return found


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--accuracy", action="store_true")
    given = parser.parse_args(words)
    torch.set_num_threads(1)
    scenes = TrainingSet(load_dataset(given.data), "cpu")
    print(f"{scenes.data.name}, {len(scenes.labels)} scenes, one thread, torch {torch.__version__}")
    if given.accuracy:
        print("masks detectors photons  float32  bfloat16, mean of seeds    differences")
        for kind in COMPARED:
            for photons in BUDGETS:
                found = accuracies(scenes, kind, photons)
                means = {name: statistics.mean(values) for name, values in found.items()}
                apart = [b - a for a, b in zip(*found.values(), strict=True)]
                print(
                    f"{kind[1]:5d} {kind[2]:>9} {photons:7.0e}  "
                    f"{means['float32']:.4f}   {means['bfloat16']:.4f}             "
                    + " ".join(f"{each:+.4f}" for each in apart),
                    flush=True,
                )
        return
    print("masks detectors   hidden  float32 s/epoch  bfloat16  ratio")
    for kind in TIMED:
        found = timed(scenes, kind, given.rounds)
        hidden = "-".join(map(str, kind[3]))
        print(
            f"{kind[1]:5d} {kind[2]:>9} {hidden:>8} {found['float32']:16.2f} "
            f"{found['bfloat16']:9.2f} {found['float32'] / found['bfloat16']:6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
