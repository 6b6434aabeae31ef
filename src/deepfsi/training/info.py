"""Provenance of designs: how they were trained, on which data, with which versions."""

from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel

from deepfsi.datasets import Dataset
from deepfsi.designfile import TrainedOn


def provenance(
    job: BaseModel, data: Dataset, device: torch.device, seconds: float
) -> dict[str, Any]:
    """Provenance of a design for `Design.info`, from parameters of its training."""
    return {
        "job": job.model_dump(mode="json"),
        "data": TrainedOn.of(data).model_dump(mode="json"),
        "preprocessing": data.preprocessing,
        "brightness": brightness(data.x_train, data.groups),
        "deepfsi": version("deepfsi"),
        "torch": torch.__version__,
        "device": device.type,
        "seconds": seconds,
    }


def brightness(x: np.ndarray, labels: np.ndarray) -> dict[str, float] | None:
    """By how much scenes differ in summed reflectance; None where a class is all dark.

    Parameters
    ----------
    x : array, shape (n, N)
        Scenes, in [0, 1].
    labels : array, shape (n,)
        Class of each.

    Returns
    -------
    dict
        `low` and `high`, the dimmest and the brightest scene over the mean one; `between`, the
        brightest class over the dimmest; `within`, the largest standard deviation of a class over
        its mean.
    """
    sums = x.sum(axis=1, dtype=np.float64)
    groups = [sums[labels == label] for label in np.unique(labels)]
    means = np.array([group.mean() for group in groups])
    if not means.min() > 0:
        return None
    return {
        "low": float(sums.min() / sums.mean()),
        "high": float(sums.max() / sums.mean()),
        "between": float(means.max() / means.min()),
        "within": max(float(g.std() / mean) for g, mean in zip(groups, means, strict=True)),
    }


def detector_shares(
    x: np.ndarray, labels: np.ndarray, detectors: np.ndarray
) -> dict[str, list[Any]] | None:
    """Share of each detector in the light of each class; None where a class is all dark.

    Parameters
    ----------
    x : array, shape (n, N)
        Scenes, in [0, 1].
    labels : array, shape (n,)
        Class of each.
    detectors : array of int, shape (N,)
        Detector of each pixel, 0 .. D-1.

    Returns
    -------
    dict
        `shares` of classes (C, D), and `spread` (D,), the standard deviation of single scenes
        about them, in the class where it is largest.
    """
    light = np.stack(
        [x[:, detectors == d].sum(axis=1, dtype=np.float64) for d in range(detectors.max() + 1)], 1
    )
    shares = []
    spread = []
    for label in np.unique(labels):
        of_class = light[labels == label]
        whole = of_class.sum(axis=1, keepdims=True)
        if not whole.mean() > 0:
            return None
        share = of_class.sum(axis=0) / whole.sum()
        shares.append(share.tolist())
        spread.append(((of_class - share * whole) / whole.mean()).std(axis=0))
    return {"shares": shares, "spread": np.max(spread, axis=0).tolist()}
