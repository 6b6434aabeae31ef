"""Worth of training under stray light, on displaced scenes and with grey levels.

    python benchmarks/conditions.py                     # MNIST, 20 000 training images
    python benchmarks/conditions.py --data digits --scenes 600 --epochs 2 --masks 4

Each row is a design, each column what it is tested under: nothing, stray light as bright as the
scene with its mean subtracted from the counts, scenes displaced by one pixel to a side, and masks
of 2 grey levels. One device (free-dwell, single rail), one seed, tests on held-out scenes.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy import ndimage

from deepfsi.camera.light import summed_reflectance
from deepfsi.datasets.dataset import Dataset, Reflectance
from deepfsi.datasets.load import load_dataset
from deepfsi.design.design import Design
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.training.learning import learn

STRAY = 1.0
"""Stray light over the scenes' mean light."""


def ambient(data: Dataset, share: float) -> Dataset:
    """Scenes under stray light, the same on every pixel.

    A feature's mean over scenes is subtracted before it is classified, and stray light changes
    nothing else but its noise: so this is light whose mean is known and subtracted. Every scene is
    dimmed by one factor, so that reflectance stays in [0, 1]. A budget is then of all the light:
    (1 + share) times that of the scene.
    """
    stray = share * float(data.x_train.mean(dtype=np.float64))
    x_train, x_test = (
        ((x + stray) / (1 + stray)).astype(np.float32)
        for x in map(np.asarray, (data.x_train, data.x_test))
    )
    words = f"{data.preprocessing}; ambient light of {share:g} times the scenes' mean"
    return replace(data, x_train=x_train, x_test=x_test, preprocessing=words, origin=None)


def jitter(data: Dataset, shift: float, turn: float = 0.0, *, seed: int = 0) -> Dataset:
    """Scenes displaced at random, each by itself, training and test scenes alike."""
    rng = np.random.default_rng(seed)
    x_train, x_test = (
        moved(x.reshape(-1, *data.image_shape), shift, turn, rng)
        for x in map(np.asarray, (data.x_train, data.x_test))
    )
    words = f"{data.preprocessing}; displaced at random by {shift:g} pixels and {turn:g}° (1 σ)"
    return replace(data, x_train=x_train, x_test=x_test, preprocessing=words, origin=None)


def moved(scenes: Reflectance, shift: float, turn: float, rng: np.random.Generator) -> Reflectance:
    centre = (np.array(scenes.shape[1:]) - 1) / 2
    shifts = rng.normal(0, shift, (len(scenes), 2))
    angles = np.deg2rad(rng.normal(0, turn, len(scenes)))
    out = np.empty_like(scenes)
    for scene, by, angle, target in zip(scenes, shifts, angles, out, strict=True):
        cos = math.cos(angle)
        sin = math.sin(angle)
        matrix = np.array([[cos, -sin], [sin, cos]])
        offset = centre - matrix @ (centre + by)
        target[:] = ndimage.affine_transform(scene, matrix, offset, order=1, mode="nearest")
    return out.reshape(len(scenes), -1)


def under(design: Design, data: Dataset, learned: float, share: float) -> Design:
    """A design that learned with one share of stray light, where there is another.

    The mean of the stray light is known and subtracted: it moves the centres of the features.
    """
    stray = design.rails.difference.mean(dim=-1)
    shown = design.mask_exposure
    mean = shown.mean * (1 + learned) + (share - learned) * stray
    exposure = replace(
        shown,
        summed_reflectance=summed_reflectance(ambient(data, share).x_train),
        mean=mean / (1 + share),
        std=shown.std * (1 + learned) / (1 + share),
    )
    return replace(design, exposure=exposure)


def displaced(data: Dataset) -> Dataset:
    """Test scenes by one pixel up, down, left or right, each a quarter of them."""
    images = data.x_test.reshape(-1, *data.image_shape).copy()
    for part, (by, axis) in enumerate([(1, 1), (-1, 1), (1, 2), (-1, 2)]):
        images[part::4] = np.roll(images[part::4], by, axis=axis)
    return replace(data, x_test=images.reshape(data.x_test.shape))


def main(words: Sequence[str] | None = None) -> dict[str, list[float]]:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--scenes", type=int, default=20_000)
    parser.add_argument("--photons", type=float, default=1e4)
    parser.add_argument("--masks", type=int, default=16)
    parser.add_argument("--epochs", type=int, default=15)
    given = parser.parse_args(words)
    torch.set_num_threads(1)
    data = load_dataset(given.data).hold_out()
    data = replace(data, x_train=data.x_train[: given.scenes], y_train=data.y_train[: given.scenes])
    designs = {
        "plain": (data, 0.0, 0),
        "stray light": (ambient(data, STRAY), STRAY, 0),
        "jitter 0.5": (jitter(data, 0.5, seed=1), 0.0, 0),
        "jitter 1": (jitter(data, 1.0, seed=1), 0.0, 0),
        "2 levels": (data, 0.0, 2),
        "all, jitter 0.5": (ambient(jitter(data, 0.5, seed=1), STRAY), STRAY, 2),
    }
    heads = ("clean", "stray light", "displaced", "2 levels", "all")
    print(f"{'trained with':18}" + "".join(f"{head:>13}" for head in heads))
    found = {}
    for name, (scenes, learned, levels) in designs.items():
        design = learn(
            scenes,
            photons=given.photons * (1 + learned),
            masks=given.masks,
            camera={"levels": levels},
            training={"epochs": given.epochs},
            device="cpu",
        )
        moved = displaced(data)
        found[name] = [
            evaluate(
                under(design.quantised(2) if binary else design, data, learned, share),
                ambient(tested, share),
                given.photons * (1 + share),
                draws=1,
            )[0].accuracy
            for tested, share, binary in (
                (data, 0.0, False),
                (data, STRAY, False),
                (moved, 0.0, False),
                (data, 0.0, True),
                (moved, STRAY, True),
            )
        ]
        print(f"{name:18}" + "".join(f"{value:13.4f}" for value in found[name]), flush=True)
    return found


if __name__ == "__main__":
    main()
