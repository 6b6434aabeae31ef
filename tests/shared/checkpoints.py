"""Trainings of every kind, and such that are ended after one of their checkpoints."""

from pathlib import Path
from typing import Any

from deepfsi.training import checkpoint

TRAININGS: dict[str, dict[str, Any]] = {
    "learned masks": {"dropout": 0.1, "decay": 0.01, "balance": True},
    "fixed masks": {"design": "random", "dropout": 0.1},
    "fixed masks, read noise": {"design": "pca", "noise": "gaussian", "sigma": 2.0},
    "gaussian": {"noise": "gaussian", "sigma": 3.0, "light": "two-arm"},
    "counts that are drawn": {"noise": "poisson", "rails": "single", "light": "free-dwell"},
    "camera noise": {"camera": "dmd", "noise": "camera", "sigma": 1.0, "dark": 5.0, "levels": 4},
    "few counts": {"noise": "poisson", "counts": 50.0, "camera": "dmd"},
    "a range of budgets": {"span": 100.0},
    "patches": {"patch": 4, "masks": 6, "classifier": "vit", "hidden": None},
    "passing scenes": {"camera": "dmd", "bins": 8, "masks": None},
    "a module of one's own": {"classifier": "shared.networks:Cnn", "hidden": None},
    "a noise of one's own": {"noise": "shared.noises:photons", "design": "pca"},
    "the control group": {"design": "control", "sigma": 3.0, "dropout": 0.1},
    "values in bfloat16": {"precision": "bfloat16"},
}
"""Settings by which trainings differ from a usual one; None leaves one out."""


class Stopped(Exception):
    """What a kill is in these tests."""


def write_each_step(monkeypatch) -> dict[str, int]:
    """Write a checkpoint after each step; end the training after the one numbered `last`, from 1.

    The state that is returned counts those that were written.
    """
    monkeypatch.setattr(checkpoint, "CHECKPOINT_SECONDS", 0.0)
    state, write = {"count": 0, "last": 0}, checkpoint.write_atomically

    def written(path: Path, content: bytes) -> Path:
        write(path, content)
        state["count"] += 1
        if state["count"] == state["last"]:
            raise Stopped
        return path

    monkeypatch.setattr(checkpoint, "write_atomically", written)
    return state
