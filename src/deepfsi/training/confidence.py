"""Scenes that calibrate the confidence of a design at the end of its training."""

from math import prod

from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design
from deepfsi.design.calibration import sample_scenes
from deepfsi.design.confidence import Temperatures, fit_temperatures
from deepfsi.optics.scanner import Scanner


def find_temperatures(
    design: Design, scanner: Scanner, budgets: tuple[float, float], data: Dataset, seed: int
) -> Temperatures:
    """Temperatures of a trained design, by scenes that were held out where there are any."""
    held = data.held_out > 0
    x, labels = (data.x_test, data.y_test) if held else (data.x_train, data.y_train)
    readouts = prod(design.counts_shape) * design.exposure.tokens(design.image_shape)
    rows = sample_scenes(len(x), readouts, seed)
    return fit_temperatures(
        design, scanner, x[rows], labels[rows], budgets, trained_on=not held, seed=seed
    )
