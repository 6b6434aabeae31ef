"""What the paper's sweep costs here: 400 trainings, stated from a timed sample.

    python benchmarks/sweep.py                    # sample, one against many, growth, accuracy
    python benchmarks/sweep.py --whole --device cuda -o runs/whole     # really run all 400

The sweep: DeepFSI on MNIST, 10 compression ratios x 4 budgets (1e3 to 1e6) x 2 noises x 5 seeds, 20
epochs of batch 500. The sample is every ratio, both noises and all budgets with one seed, by all
workers at once, once for 1 epoch and once for 3. Their difference gives the seconds of an epoch, so
what 20 take, tests included; the whole is five times that. "bfloat16" is the package's own rule,
which takes float32 where rounding would show above the noise. Every figure is wall time, with the
machine's noise in it: run it alone.
"""

import argparse
import itertools
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from deepfsi.datasets.arrays import from_arrays
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.design.networks import Mlp, Replicas
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Training
from deepfsi.sweeps.plan import PAPER_RATIOS, plan_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.run import run_trials
from deepfsi.sweeps.workers import cores
from deepfsi.training.learning import train
from moments import Moments

BUDGETS, SEEDS, EPOCHS, BATCH = (1e3, 1e4, 1e5, 1e6), 5, 20, 500
PAPER_SECONDS = 2.87e4
SHORT, LONG = 1, 3
PRECISIONS = {"bfloat16": "auto", "float32": "float32"}


def sweep(
    data: Dataset,
    epochs: int,
    seeds: int,
    precision: str,
    device: str,
    workers: int,
    out: Path | None = None,
) -> float:
    """Seconds that a sweep takes."""
    recipe = Recipe(
        data=data.name,
        designs="deepfsi",
        photons=BUDGETS,
        ratios=PAPER_RATIOS,
        camera={"light": "column", "noise": ("poisson", "gaussian")},
        trials=seeds,
        validation=0,
        draws=1,
        training={"epochs": epochs, "batch": BATCH, "precision": PRECISIONS[precision]},
    )
    trials = plan_trials(recipe, data)
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        done = run_trials(trials, data, out or Path(folder), device=device, workers=workers)
        seconds = time.perf_counter() - began
    accuracy = np.mean([record["test"][0]["accuracy"] for record in done])
    print(
        f"  {len(done)} trainings of {epochs} epochs, {precision}: {seconds:.1f} s, "
        f"mean accuracy {accuracy:.3f}",
        flush=True,
    )
    return seconds


def sample(data: Dataset, device: str, workers: int) -> None:
    """Time the sample, and state what the whole costs."""
    for precision in PRECISIONS:
        short, long = (
            sweep(data, epochs, 1, precision, device=device, workers=workers)
            for epochs in (SHORT, LONG)
        )
        epoch = (long - short) / (LONG - SHORT)
        whole = SEEDS * (short + (EPOCHS - SHORT) * epoch)
        print(
            f"{precision}: {epoch:.1f} s an epoch of all 80; 400 runs take {whole / 60:.0f} min "
            f"({whole / 400:.1f} s a run; paper {PAPER_SECONDS / 400:.0f} s a run on its GPU)"
        )


def seconds_an_epoch(scenes: TrainingSet, jobs: list[Job]) -> float:
    """Of jobs trained together; the second epoch of two."""
    moments = Moments()
    train(scenes, jobs, report=moments.report)
    return moments.epochs(2)[1]


def short(masks: int, photons: float = 1e4, epochs: int = 2) -> Job:
    settings = Training(epochs=epochs, batch=BATCH, precision="bfloat16")
    return Job(masks=masks, photons=photons, camera="paper", training=settings)


def one_against_many(scenes: TrainingSet) -> None:
    """Seconds an epoch of a trial alone and of one among eight budgets."""
    print("seconds an epoch and trial, one thread\nmasks  alone  of 2  of 4  of 8")
    for masks in (10, 92, 369, 1024):
        costs = []
        for together in (1, 2, 4, 8):
            jobs = [short(masks, photons) for photons in np.geomspace(1e3, 1e5, together)]
            costs.append(seconds_an_epoch(scenes, jobs) / together)
        print(f"{masks:5d}  " + "  ".join(f"{cost:5.2f}" for cost in costs), flush=True)


def classifiers() -> None:
    """Milliseconds of a step of R classifiers: one after another, by vmap, and stacked."""
    print("ms a step and classifier, batch 500, one thread\nmasks   R  loop  vmap  stacked")
    for masks, count in itertools.product((92, 1024), (1, 4, 20)):
        networks = [Mlp(masks, 10, generator=torch.Generator()) for _ in range(count)]
        features = torch.randn(BATCH, count, masks, requires_grad=True)
        labels = torch.randint(10, (BATCH * count,))
        stacked, _ = torch.func.stack_module_state(networks)
        mapped = {name: value.detach().requires_grad_() for name, value in stacked.items()}

        def one(parameters: dict[str, torch.Tensor], own: torch.Tensor) -> torch.Tensor:
            return torch.func.functional_call(networks[0], parameters, own)  # noqa: B023

        ways = {
            "loop": Replicas(networks, stacked=False),
            "vmap": lambda x: torch.func.vmap(one, (0, 1), 1)(mapped, x),  # noqa: B023
            "stacked": Replicas(networks, stacked=True),
        }
        costs = []
        for way in ways.values():
            seconds = []
            for _ in range(30):
                began = time.perf_counter()
                nn.functional.cross_entropy(way(features).flatten(0, 1), labels).backward()
                seconds.append(time.perf_counter() - began)
            costs.append(statistics.median(seconds) * 1e3 / count)
        print(f"{masks:5d}  {count:2d}  " + "  ".join(f"{cost:4.2f}" for cost in costs), flush=True)


def growth(data: Dataset, device: str) -> None:
    """How an epoch grows with masks, pixels, trials and images."""
    print("seconds an epoch, times those of the first, at 1, 2, 4 and 8 times as many")
    rng = np.random.default_rng(0)
    images = {
        n: TrainingSet(replace(data, x_train=data.x_train[:n], y_train=data.y_train[:n]), device)
        for n in (7500, 15000, 30000, 60000)
    }
    scenes = images[15000]
    y = np.arange(15000) % 10
    pixels = {
        n: TrainingSet(
            from_arrays(rng.random((15000, n), dtype=np.float32), y, name="random"), device
        )
        for n in (256, 512, 1024, 2048)
    }
    rows = {
        "masks 64 to 512": [seconds_an_epoch(scenes, [short(m)]) for m in (64, 128, 256, 512)],
        "pixels 256 to 2048": [seconds_an_epoch(own, [short(64)]) for own in pixels.values()],
        "trials 1 to 8": [
            seconds_an_epoch(scenes, [short(64, b) for b in np.geomspace(1e3, 1e5, n)])
            for n in (1, 2, 4, 8)
        ],
        "images 7500 to 60000": [seconds_an_epoch(own, [short(64)]) for own in images.values()],
    }
    for name, seconds in rows.items():
        ratios = "  ".join(f"{each / seconds[0]:5.2f}" for each in seconds)
        print(f"{name:22s} {ratios}   ({seconds[0]:.3f} s)", flush=True)


def accuracy(data: Dataset, device: str) -> None:
    """Test accuracies: float32 alone against bfloat16 with all budgets together."""
    scenes = TrainingSet(data, device)
    print("accuracy after 20 epochs\nmasks  photons  float32 alone  bfloat16 together  difference")
    differences = []
    for masks in (10, 92):
        budgets = BUDGETS[:3]
        settings = Training(epochs=EPOCHS, batch=BATCH, precision="float32")
        fast = settings.model_copy(update={"precision": "bfloat16"})
        together = train(
            scenes, [Job(masks=masks, photons=b, camera="paper", training=fast) for b in budgets]
        )
        for photons, design in zip(budgets, together, strict=True):
            (alone,) = train(
                scenes, [Job(masks=masks, photons=photons, camera="paper", training=settings)]
            )
            one, other = (evaluate(d, data, photons, draws=1)[0].accuracy for d in (alone, design))
            differences.append(other - one)
            print(f"{masks:5d}  {photons:7g}  {one:13.4f}  {other:17.4f}  {other - one:+10.4f}")
    print(f"mean difference {np.mean(differences):+.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--workers", type=int)
    parser.add_argument(
        "--parts",
        nargs="+",
        default=["sample", "many", "growth", "accuracy"],
        choices=["sample", "many", "growth", "accuracy"],
    )
    parser.add_argument("--whole", action="store_true", help="run all 400, in bfloat16")
    parser.add_argument("-o", "--out", type=Path, help="folder for --whole")
    arguments = parser.parse_args()

    data = load_dataset(arguments.data)
    scenes = TrainingSet(data, arguments.device)
    device = scenes.device.type
    workers = arguments.workers or (1 if device == "cuda" else cores())
    print(
        f"{data.name}, {len(data.x_train)} images of {data.pixels} pixels, {device}, "
        f"{workers} workers, torch {torch.__version__}"
    )
    if arguments.whole:
        seconds = sweep(data, EPOCHS, SEEDS, "bfloat16", device, workers, arguments.out)
        print(f"whole sweep: {seconds / 60:.1f} min")
        return
    if "sample" in arguments.parts:
        sample(data, device, workers)
    if "accuracy" in arguments.parts:
        accuracy(data, device)
    if device == "cpu":
        torch.set_num_threads(1)
    if "many" in arguments.parts:
        one_against_many(scenes)
        classifiers()
    if "growth" in arguments.parts:
        growth(data, device)


if __name__ == "__main__":
    main()
