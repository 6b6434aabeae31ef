"""Accuracy of adaptive masks: every test image once, and what the time of a decision costs.

    python benchmarks/adaptive.py --data mnist --photons 1e4 --looks 32     # a quarter of an hour
    python benchmarks/adaptive.py --data mnist --photons 1e3 --looks 16 --camera dmd-2x2
    python benchmarks/adaptive.py --data mnist --photons 1e4 --looks 64 --cap 2 --draws 3
    python benchmarks/adaptive.py --data mnist --photons 1e4 --looks 128 --cap 4
    python benchmarks/adaptive.py --data mnist --photons 1e4 --looks 96 --dictionary 2000
    python benchmarks/adaptive.py --data mnist --latency                    # time of one decision

Noise draws of each test image; ± is half of the 95 % interval over images. With `--cap` the budget
is the mean of exposures that end when a class is sure: `light` is what test images take of it. With
`--until` they end above that probability, whatever light they take. The prior is all training
images. With `--validation` training images that are drawn by `--seed` are left out and read in
place of the tests: settings are to be chosen there. `--scenes` keeps the first images of the prior
alone, `--page` those that the page of the design knows; with `--clusters` the centres of as many
clusters of each class stand for them. `--dictionary` chooses among so many masks that stay on the
device. `--latency` is the median from the counts of a look to the next mask.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

import deepfsi
from deepfsi.evaluation.page_data import of_page


def decision_time(design: deepfsi.Design, photons: float, exposures: int = 4) -> float:
    """Median time in s from the counts of a look to the next mask, one exposure alone."""
    generator, times = torch.Generator().manual_seed(0), []
    exposure = design.prior_exposure
    optics = exposure.optics_at(photons)
    with torch.no_grad():
        for scene in exposure.prior.mean.expand(exposures, -1):
            state = exposure.posterior(1, optics)
            masks = state.next_masks(exposure.settings.shares[0], generator)
            for share in exposure.settings.shares:
                counts = torch.poisson(state.expected(masks, scene[None], share), generator)
                began = time.perf_counter()
                state.update(masks, counts, share)
                masks = state.next_masks(share, generator)
                times.append(time.perf_counter() - began)
    return float(np.median(times))


def main(words: Sequence[str] | None = None) -> None:
    """Make designs, test them and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="digits")
    parser.add_argument("--camera", default="dmd")
    parser.add_argument("--photons", type=float, nargs="+", default=[1e4])
    parser.add_argument("--looks", type=int, nargs="+", default=[16])
    parser.add_argument("--cap", type=float, default=1, help="most light, over the mean of all")
    parser.add_argument("--until", type=float, help="threshold, in place of that of the mean light")
    parser.add_argument("--draws", type=int, default=1, help="noise draws of each image")
    parser.add_argument("--validation", type=int, default=0, help="images, in place of the tests")
    parser.add_argument("--seed", type=int, default=0, help="of the validation images")
    parser.add_argument("--scenes", type=int, help="images of the prior, the first ones")
    parser.add_argument("--clusters", type=int, help="of each class, in place of all scenes")
    parser.add_argument("--dictionary", type=int, help="masks that stay on the device")
    parser.add_argument("--page", action="store_true", help="the images that a page knows")
    parser.add_argument("--latency", action="store_true", help="time of one decision, alone")
    given = parser.parse_args(words)
    data = deepfsi.load_dataset(given.data)
    if given.validation:
        # the last images of MNIST are no fair sample of its writers
        order = np.random.default_rng(given.seed).permutation(len(data.x_train))
        mixed = replace(data, x_train=data.x_train[order], y_train=data.y_train[order])
        data = mixed.hold_out(given.validation)
    known = slice(given.scenes)
    data = replace(data, x_train=data.x_train[known], y_train=data.y_train[known])
    exposure = {"cap": 1 if given.until else given.cap}
    print(
        "| photons | looks | accuracy | log loss | counts | calibration error | light | seconds |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for looks in given.looks:
        for photons in given.photons:
            design = deepfsi.learn(
                data,
                design="adaptive",
                masks=looks,
                photons=photons,
                camera=given.camera,
                exposure=exposure,
                training={"clusters": given.clusters, "dictionary": given.dictionary},
            )
            if given.until:
                changes = {"cap": given.cap, "until": given.until}
                settings = design.prior_exposure.settings.model_copy(update=changes)
                design.exposure = replace(design.prior_exposure, settings=settings)
            if given.page:
                design = of_page(design)
            if given.latency:
                print(f"one decision: {decision_time(design, photons) * 1e3:.3f} ms", flush=True)
                continue
            began = time.process_time()
            [found] = deepfsi.evaluate(design, data, photons, draws=given.draws)
            half = (found.high - found.low) / 2
            print(
                f"| {photons:g} | {looks} | {found.accuracy:.4f} ± {half:.4f} "
                f"| {found.log_loss:.3f} | {found.counts:.4g} "
                f"| {found.calibration_error:.3f} | {found.score('mean_light') or 1:.4f} "
                f"| {time.process_time() - began:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
