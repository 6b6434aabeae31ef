"""Time from the counts of one exposure to its class probabilities: onnxruntime and torch.

    python benchmarks/inference.py                      # MNIST's size: 10 classes; 10 and 92 masks
    python benchmarks/inference.py --masks 10 --exposures 5000 --rounds 9

Both do the same work on one core, in turn, one exposure a call, from numpy counts to numpy
probabilities: `Design.classify`, and the graph that `deepfsi export` writes of that design
in onnxruntime. What they give is compared before. Weights do not matter to the time, so that the
designs are trained for one epoch. A frame of a fast DMD takes 50 µs, an exposure as many as it has
frames.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import onnxruntime
import torch

from deepfsi import learn, load_dataset
from deepfsi.design.design import Design
from deepfsi.design.onnx import to_onnx

PHOTONS = 1e4

Classify = Callable[[np.ndarray, np.ndarray], np.ndarray]


def exported(design: Design) -> Classify:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        to_onnx(design), options, providers=["CPUExecutionProvider"]
    )
    return lambda counts, photons: session.run(None, {"counts": counts, "photons": photons})[0]


def microseconds(classify: Classify, counts: np.ndarray, photons: np.ndarray) -> list[float]:
    """Time of each exposure by itself."""
    times = []
    for place in range(len(counts)):
        began = time.perf_counter_ns()
        classify(counts[place : place + 1], photons)
        times.append((time.perf_counter_ns() - began) / 1e3)
    return times


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--masks", type=int, nargs="+", default=[10, 92])
    parser.add_argument("--hidden", type=int, nargs="+", default=[40, 128])
    parser.add_argument("--exposures", type=int, default=2000, help="of each round")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args(words)

    torch.set_num_threads(1)
    data = load_dataset(arguments.data)
    photons = np.array([PHOTONS], dtype=np.float32)
    print(f"onnxruntime {onnxruntime.__version__}, torch {torch.__version__}, one core")
    print("| masks | hidden | onnxruntime µs | 99 % under | torch µs | 99 % under | ratio |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for masks in arguments.masks:
        hidden = tuple(arguments.hidden)
        design = learn(
            data,
            design="truncated-hadamard",
            photons=PHOTONS,
            masks=masks,
            camera="paper",
            training={"hidden": hidden, "epochs": 1},
        )
        rows = np.arange(arguments.exposures) % len(data.x_test)
        scenes = torch.from_numpy(data.x_test[rows]) * (PHOTONS / design.summed_reflectance)
        counts = design.scanner().counts(scenes, torch.Generator().manual_seed(0)).numpy()
        ways = {"onnxruntime": exported(design), "torch": design.classify}
        np.testing.assert_allclose(
            *(way(counts, np.full(len(counts), *photons)) for way in ways.values()), atol=1e-4
        )
        times: dict[str, list[float]] = {name: [] for name in ways}
        for classify in ways.values():
            microseconds(classify, counts[:100], photons)
        for _ in range(arguments.rounds):
            for name, classify in ways.items():
                times[name] += microseconds(classify, counts, photons)
        medians = {name: statistics.median(found) for name, found in times.items()}
        most = {name: np.quantile(found, 0.99) for name, found in times.items()}
        print(
            f"| {masks} | {' '.join(map(str, hidden))} | {medians['onnxruntime']:.1f} "
            f"| {most['onnxruntime']:.1f} | {medians['torch']:.1f} | {most['torch']:.1f} "
            f"| {medians['torch'] / medians['onnxruntime']:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
