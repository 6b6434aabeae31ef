"""Trials of a sweep, trained."""

from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file

from deepfsi.datasets.dataset import Dataset
from deepfsi.sweeps.plan import Trial, plan_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.run import run_trials
from shared.jobs import table_of


def train_trials(
    trials: list[Trial],
    data: Dataset,
    folder: Path,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    **workers: Any,
) -> list[dict[str, Any]]:
    """Records of trials of one data set."""
    return run_trials(trials, data, folder, matrix=matrix, device=device, **workers)


def small(**changes: Any) -> Recipe:
    """Recipe of a moment on digits; single settings of a job are sorted into its tables.

    Light law and rails are the paper's unless others, or a camera, are given.
    """
    optics = {} if "camera" in changes else {"light": "column", "rails": "dual"}
    settings = {
        "designs": ("pca", "deepfsi"),
        "photons": (1e2, 1e3),
        "masks": (3, 6),
        "draws": 1,
        "folds": 1,
        "training": {"epochs": 2},
        **optics,
        **changes,
    }
    fields = {name: value for name, value in settings.items() if name in Recipe.model_fields}
    for name in settings.keys() - fields.keys():
        table, key = table_of(name)
        fields[table] = {**fields.get(table, {}), key: settings[name]}
    return Recipe(**fields)


def planned(data: Dataset, **changes: Any) -> list[Trial]:
    """Trials of `small` with these changes."""
    return plan_trials(small(**changes), data)


def tensors(folder: Path) -> dict[str, dict[str, bytes]]:
    """Bits of all tensors of each design, by the name of its file."""
    return {
        path.name: {name: tensor.tobytes() for name, tensor in load_file(path).items()}
        for path in folder.glob("designs/*")
    }


def left_over(folder: Path) -> list[Path]:
    """Drafts, locks, checkpoints, and what is not where it belongs yet."""
    names = (".*", "locks*", "finished*", "*checkpoint*")
    return [path for name in names for path in folder.rglob(name)]
