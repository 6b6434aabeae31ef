"""Where a step of training goes: shares of its operations, as torch's profiler counts them.

    python benchmarks/step.py                        # 92 masks, bfloat16
    python benchmarks/step.py --masks 1024 --precision float32
    python benchmarks/step.py --data digits --masks 8

DeepFSI with one thread under torch.profiler, three epochs more less one: what is done once falls
out. The profiler makes small operations dearer than they are: these are shares, not times. Each
operation's own time, without those that it calls.
"""

import argparse

import torch
from torch.profiler import ProfilerActivity, profile

from deepfsi.datasets.load import load_dataset
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Training
from deepfsi.training.learning import train

SHOWN = 14


def job(masks: int, precision: str, epochs: int) -> Job:
    settings = Training.model_validate({"precision": precision, "epochs": epochs})
    return Job(masks=masks, photons=1e4, camera="paper", training=settings)


def profiled(scenes: TrainingSet, job: Job) -> dict[str, float]:
    """Own processor time of each operation of a training."""
    with profile(activities=[ProfilerActivity.CPU]) as profiler:
        train(scenes, [job])
    return {each.key: each.self_cpu_time_total for each in profiler.key_averages()}


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--masks", type=int, default=92)
    parser.add_argument("--precision", choices=("bfloat16", "float32"), default="bfloat16")
    given = parser.parse_args(words)
    torch.set_num_threads(1)
    scenes = TrainingSet(load_dataset(given.data), "cpu")
    short, long = (job(given.masks, given.precision, epochs) for epochs in (1, 4))
    train(scenes, [short])  # what is made once is made
    one, four = (profiled(scenes, each) for each in (short, long))
    steps = {name: four[name] - one.get(name, 0.0) for name in four}
    whole = sum(steps.values())
    print(f"{scenes.data.name}, {given.masks} masks, {given.precision}, torch {torch.__version__}")
    for name in sorted(steps, key=lambda name: -steps[name])[:SHOWN]:
        print(f"{steps[name] / whole:6.1%}  {name}")


if __name__ == "__main__":
    main()
