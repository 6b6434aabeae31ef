"""Provenance of designs: how they were trained, on which data, with which versions."""

from importlib.metadata import version
from typing import Any

import torch
from pydantic import BaseModel

from deepfsi.camera import brightness
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
