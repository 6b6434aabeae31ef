"""Values of scenes as a network answers them: less their mean, over their standard deviation."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from deepfsi.base.errors import InputError
from deepfsi.datasets.dataset import Dataset


def check_classes(values: "Values | tuple[str, ...] | None", what: str) -> None:
    """Raise `InputError` where a design estimates values and `what` is of classes."""
    if values:
        names = values if isinstance(values, tuple) else values.names
        raise InputError(
            f"{what} is of classes, and this design estimates {', '.join(names)}: use "
            "Design.estimate, or `deepfsi evaluate`"
        )


@dataclass(frozen=True, eq=False)
class Values:
    """Names of q values, and their mean and standard deviation in the training, (q,) each."""

    names: tuple[str, ...]
    mean: Tensor  # (q,)
    std: Tensor  # (q,)

    @classmethod
    def of(cls, data: Dataset) -> "Values | None":
        """Those of the training scenes of a data set; None where scenes have classes."""
        if not data.values:
            return None
        y = torch.from_numpy(data.y_train)
        return cls(data.values, y.mean(dim=0), y.std(dim=0, correction=0))

    @classmethod
    def restored(cls, names: tuple[str, ...], tensors: Mapping[str, Tensor]) -> "Values":
        """Values of a design file, or an error where its tensors are not of these names."""
        mean = tensors["mean"]
        std = tensors["std"]
        if not mean.shape == std.shape == (len(names),) or not bool((std > 0).all()):
            raise ValueError("scales are not those of the values")
        return cls(names, mean, std)

    def standardised(self, values: Tensor) -> Tensor:
        """Truth for a network of values (..., q)."""
        return (values - self.mean) / self.std

    def estimated(self, outputs: Tensor) -> Tensor:
        """Values (..., q) of answers of a network, in their own units."""
        return self.mean + self.std * outputs

    def to(self, device: str | torch.device) -> Self:
        """Move to a device."""
        return replace(self, mean=self.mean.to(device), std=self.std.to(device))

    @property
    def tensors(self) -> dict[str, Tensor]:
        """Tensors of a design file."""
        return {"mean": self.mean, "std": self.std}
