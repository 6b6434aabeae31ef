"""The data that a design was trained on, as it remembers them.

A design keeps the name or path of its data with the options that load it, the hash of what was
trained on, and the number of training scenes that were left out.
"""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict

from deepfsi.datasets import Dataset, Origin
from deepfsi.errors import as_input_error


class TrainedOn(BaseModel):
    """Data of a training, an entry of `Design.info`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str  # of the data set without the scenes that were left out
    hash: str
    held_out: int = 0  # last training scenes that were left out
    origin: Origin | None = None  # none for arrays in memory, and for scenes changed after loading

    @property
    def words(self) -> str:
        """Data, and scenes left out."""
        left = f", its last {self.held_out} training scenes left out" if self.held_out else ""
        return (self.origin.words if self.origin else f"{self.name}, in memory") + left

    @classmethod
    def of(cls, data: Dataset) -> "TrainedOn":
        """The data of a training, as a design remembers it."""
        return cls(name=data.name, hash=data.hash, held_out=data.held_out, origin=data.origin)

    def is_of(self, data: Dataset) -> bool:
        """True if a data set is the one that was trained on, the scenes left out included."""
        if not 0 <= self.held_out < len(data.x_train):
            return False
        kept = data.hold_out(self.held_out) if self.held_out else data
        return kept.hash == self.hash


def trained_on(info: Mapping[str, Any]) -> TrainedOn | None:
    """Data in the `info` of a design; None for one that was made without any."""
    if "data" not in info:
        return None
    with as_input_error("the design's training data", "train it again"):
        return TrainedOn.model_validate(info["data"])
