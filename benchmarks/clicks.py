"""Accuracy of adaptive masks where a click has a price, on scenes with a black background.

    python benchmarks/clicks.py --data mnist --counts 5.4 --photons 3000 --looks 96   # hours
    python benchmarks/clicks.py --data mnist --counts 5.4 --images 2000   # half an hour
    python benchmarks/clicks.py --counts 4 --photons 600 --looks 24       # digits: a minute

One DMD and one detector, which clicks at most once a look. The price of a click is found with 512
training images, each left out of the prior, which is all training images. Each test image is
exposed once, in their order. A row is of all images so far: of the first 200, which experiments
have used, and of each thousand.
± is half of the 95 % interval over images. `light`: photons on the device. With `--validation`
training images that are drawn by `--seed` are left out and read in place of the tests.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

import deepfsi
from deepfsi.base.intervals import wilson

ROWS = 200, 1000
"""Test images of the first row, and further ones of each other."""


def main(words: Sequence[str] | None = None) -> None:
    """Make a design, test it and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="digits")
    parser.add_argument("--counts", type=float, help="mean clicks; as many as tell unless given")
    parser.add_argument("--photons", type=float, default=3000.0, help="on the device, at most")
    parser.add_argument("--looks", type=int, default=96)
    parser.add_argument("--images", type=int, help="test images, the first ones; all unless given")
    parser.add_argument("--scenes", type=int, help="images of the prior, the first ones")
    parser.add_argument("--validation", type=int, default=0, help="images, in place of the tests")
    parser.add_argument("--seed", type=int, default=0, help="of the noise and of these images")
    given = parser.parse_args(words)
    data = deepfsi.load_dataset(given.data, rescale=(0.0, 1.0))
    if given.validation:
        # drawn by lot: the last images of MNIST are no fair sample of its writers
        order = np.random.default_rng(given.seed).permutation(len(data.x_train))
        mixed = replace(data, x_train=data.x_train[order], y_train=data.y_train[order])
        data = mixed.hold_out(given.validation)
    known = slice(given.scenes)
    data = replace(data, x_train=data.x_train[known], y_train=data.y_train[known])
    began = time.process_time()
    design = deepfsi.learn(
        data,
        design="adaptive",
        masks=given.looks,
        photons=given.photons,
        counts=given.counts,
        camera={"light": "free-dwell", "rails": "single", "noise": "click"},
    )
    print(
        f"price {design.prior_exposure.settings.price:.4g} nats a click, "
        f"{time.process_time() - began:.0f} s\n"
        "| images | accuracy | log loss | clicks | arriving | light | seconds of the last |"
    )
    print("| --- " * 7 + "|", flush=True)
    images = given.images or len(data.x_test)
    ends = [*range(0, images, ROWS[1]), images]
    ends[1:1] = [ROWS[0]] if images > ROWS[0] else []
    measured = []
    sizes = []
    for start, end in pairwise(ends):
        some = replace(data, x_test=data.x_test[start:end], y_test=data.y_test[start:end])
        began = time.process_time()
        [found] = deepfsi.evaluate(design, some, given.photons, draws=1, seed=given.seed + start)
        seconds = time.process_time() - began
        light = (found.score("mean_light") or 1) * given.photons
        measured.append((found.accuracy, found.log_loss, found.counts, found.arriving, light))
        sizes.append(end - start)
        accuracy, loss, clicks, arriving, light = np.average(measured, axis=0, weights=sizes)
        low, high = wilson(accuracy, end)
        print(
            f"| {end} | {accuracy:.4f} ± {(high - low) / 2:.4f} | {loss:.3f} | {clicks:.2f} "
            f"| {arriving:.1f} | {light:.0f} | {seconds:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
