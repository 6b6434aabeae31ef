"""Products of several detectors: a step of training part by part, and with masks dark elsewhere.

    python benchmarks/detectors.py
    python benchmarks/detectors.py --side 8 --repeats 3

Ours arranges scenes and frames by detector and multiplies each detector's part. What one would
write instead gives each detector a mask of its own, dark beyond its part, and multiplies the whole
scene: F · D masks of N pixels. Both take the noisy features of a batch and the gradient of the
frames, in turn on the same numbers; medians, and the ratio of plain to ours.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import torch

from deepfsi.camera.detectors import DetectorMap
from deepfsi.physics.detection import Detection
from deepfsi.physics.training_noise import ml_gauss_features

FRAMES = 8
BATCH = 500


def seconds(step: Callable[[], None]) -> float:
    start = time.perf_counter()
    step()
    return time.perf_counter() - start


def steps(side: int, tiles: int) -> tuple[Callable[[], None], Callable[[], None]]:
    """A step part by part, and one with the masks of all detectors."""
    draw, detection = (
        torch.Generator().manual_seed(0),
        Detection.by(DetectorMap.of(f"{tiles}x{tiles}", (side,) * 2)),
    )
    scenes = torch.rand(BATCH + 1, side**2, generator=draw)
    frames = torch.rand(1, FRAMES, side**2, generator=draw) / FRAMES
    epsilon = torch.randn(BATCH, 1, FRAMES * detection.count, generator=draw)
    labels = (
        torch.zeros(side**2, dtype=torch.long) if detection.labels is None else detection.labels
    )
    own = torch.nn.functional.one_hot(labels).T.float()
    arranged = detection.arrange(scenes)
    ours = detection.arrange(frames).requires_grad_()
    plain = frames.clone().requires_grad_()
    found = []

    def by_part() -> None:
        features = ml_gauss_features(arranged, ours, epsilon, False, detection.count)
        (gradient,) = torch.autograd.grad(features.sum(), ours)
        found[:1] = [detection.restore(gradient)]

    def whole() -> None:
        every = (plain.unsqueeze(2) * own).flatten(1, 2)
        features = ml_gauss_features(scenes, every, epsilon, False)
        (gradient,) = torch.autograd.grad(features.sum(), plain)
        found[1:] = [gradient]

    by_part()
    whole()
    torch.testing.assert_close(found[0], found[1], rtol=1e-3, atol=1e-3)
    return by_part, whole


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=15)
    given = parser.parse_args(words)
    print(
        f"{BATCH} scenes of {given.side}x{given.side}, {FRAMES} frames, torch {torch.__version__}"
    )
    print("detectors  ours ms  plain ms  ratio")
    for tiles in (1, 2, 4, 8):
        both = steps(given.side, tiles)
        taken = [[seconds(each) for each in both] for _ in range(given.repeats)]
        ours, plain = (1e3 * statistics.median(each) for each in zip(*taken, strict=True))
        ratio = statistics.median(other / one for one, other in taken)
        print(f"{tiles}x{tiles:<7}  {ours:7.2f}  {plain:8.2f}  {ratio:5.1f}")


if __name__ == "__main__":
    main()
