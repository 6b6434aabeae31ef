"""The paper's experiments on digits, small."""

import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from deepfsi.camera.device import find_device
from deepfsi.datasets import catalog
from deepfsi.sweeps.recipe import Recipe
from deepfsi.training import learning
from deepfsi_paper import bootstrap, experiment, studies
from deepfsi_paper.camera import laboratory
from deepfsi_paper.indian_pines import claims as indian_pines
from deepfsi_paper.ovit import claims as ovit

ALL = [each for members in studies.STUDIES.values() for each in members]
OVIT = (ovit.EXPERIMENT, ovit.IMAGES, ovit.FULL)
# They need data of their own
APART = (indian_pines.EXPERIMENT, *OVIT)
EVERY = [each for each in ALL if each not in APART]
TWICE = ("masks", "compression")
SMALL_DEVICE = find_device("256x192")
"""A sixteenth of the laboratory's mirrors."""

DRAWS = 2
"""Of ten digits, that the laboratory shows."""

HELD_OUT = 200
"""Scenes for validation, of the few that there are."""

TINY = {"data": "digits", "ratios": (0.05, 0.1), "photons": (1e2, 1e4), "training": {"epochs": 1}}


def tiny(experiment, trials: int):
    """Recipes of the experiment on digits, of a moment; what makes them themselves is kept."""
    recipes = experiment.recipes(quick=True)
    return {part: shrunk(experiment, trials, quick) for part, quick in recipes.items()}


def shrunk(experiment, trials: int, quick: Recipe):
    kept = quick.model_dump(exclude={"masks"}, exclude_unset=True)
    training = {**kept.pop("training", {}), **TINY["training"], "batch": 200}
    changes = {**TINY, "training": training, "trials": trials}
    if kept.get("validation", 0) > HELD_OUT:
        changes["validation"] = HELD_OUT
    if kept.get("gaussian_photons"):
        changes["gaussian_photons"] = (80, 800)
    if kept.get("test_photons"):
        changes |= {"photons": 1e4, "test_photons": (1e2, 1e4, 1e6)}
    if experiment.name == "masks":
        changes |= {"photons": (1e3, 1e5), "ratios": 0.1}
    return type(quick)(**{**kept, **changes})


def here(work, shared, tasks, count):
    """Results of tasks as worker processes give them, from this one, which torch is in already."""
    work, shared = pickle.loads(pickle.dumps((work, shared)))
    for task in tasks:
        yield pickle.loads(pickle.dumps(work(shared, pickle.loads(pickle.dumps(task)))))


_load = catalog.Digits.load


def few_digits(self, options):
    """Digits with 700 scenes to train on and 50 to test."""
    digits = _load(self, options)
    few, tested = slice(700), slice(50)
    return replace(
        digits,
        x_train=digits.x_train[few],
        y_train=digits.y_train[few],
        x_test=digits.x_test[tested],
        y_test=digits.y_test[tested],
    )


def run_all(folder: Path) -> Path:
    """Run experiments on digits into a folder, some with two trials and the others with one."""
    recipes = {each.name: tiny(each, 1 + (each.name in TWICE)) for each in EVERY}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning, "characterise", lambda *_: None)
        patch.setattr(learning, "folds_of", lambda _: [])
        patch.setattr(experiment.Experiment, "recipes", lambda self, *_: recipes[self.name])
        patch.setattr(bootstrap, "RESAMPLES", 99)
        patch.setattr(laboratory, "DRAWS", DRAWS)
        patch.setattr(catalog.Digits, "load", few_digits)
        patch.setattr(laboratory, "DEVICE", SMALL_DEVICE)
        patch.setattr(laboratory, "LAB", laboratory.LAB.model_copy(update={"blur": 2.0}))
        patch.setattr(laboratory, "calibrate", cache(laboratory.calibrate.__wrapped__))
        patch.setattr(laboratory, "processes", here)
        for each in EVERY:
            each.run(folder, command=f"deepfsi reproduce {each.name}")
    return folder
