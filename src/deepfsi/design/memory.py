"""The data that a design was trained on, and the data that it is tested on.

A design keeps the name or path of its data with the options that load it, the hash of what was
trained on, and the number of training scenes that were left out. A test need not be told them
again, and where it is told otherwise that is noted.
"""

from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict

from deepfsi.datasets import Dataset, Origin, absolute, load_dataset, takes
from deepfsi.design.artifact import Design
from deepfsi.errors import InputError, as_input_error
from deepfsi.hardware.calibration.view import view_from


class Memory(BaseModel):
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
    def of(cls, data: Dataset) -> "Memory":
        """Memory of the data that is trained on."""
        return cls(name=data.name, hash=data.hash, held_out=data.held_out, origin=data.origin)

    def is_of(self, data: Dataset) -> bool:
        """True if a data set is the one that was trained on, the scenes left out included."""
        if not 0 <= self.held_out < len(data.x_train):
            return False
        kept = data.hold_out(self.held_out) if self.held_out else data
        return kept.hash == self.hash


class Told(NamedTuple):
    """Data that a design is tested on, and notes on where it is not what it was trained on."""

    data: Dataset
    notes: tuple[str, ...]


def memory_of(design: Design) -> Memory | None:
    """Memory of a design of its data; None for one that was made without any."""
    if "data" not in design.info:
        return None
    with as_input_error("the design's memory of its data", "train it again"):
        return Memory.model_validate(design.info["data"])


def data_of(
    design: Design,
    data: str | None = None,
    size: tuple[int, int] | None = None,
    view: Path | None = None,
) -> Told:
    """Load the data to test a design on: what is told, else what it was trained on."""
    memory = memory_of(design)
    known = memory.origin if memory else None
    if data is None and known is None:
        raise InputError(
            "this design was trained on data that no file or name holds, such as arrays in memory: "
            "give the data to test it on, `data`"
        )
    asked = _asked(known, data, size, view)
    try:
        loaded = _load(asked)
    except InputError as error:
        if data is None:
            raise InputError(
                f"the data that this design was trained on cannot be loaded ({error}): give "
                "the data to test it on, `data`"
            ) from error
        raise
    return Told(loaded, tuple(_notes(memory, asked, loaded)))


def _asked(
    known: Origin | None, data: str | None, size: tuple[int, int] | None, view: Path | None
) -> Origin:
    """Source that is told, the rest of it as the design remembers."""
    name = known.data if data is None and known else absolute(str(data))
    told = {"size": size, "view": absolute(str(view)) if view else None}
    told = {option: value for option, value in told.items() if value is not None}
    if known is None:
        return Origin(data=name).model_copy(update=told)
    if name == known.data:
        return known.model_copy(update=told)
    allowed = takes(name)
    same = ["rescale", "view", *(option for option in ("size", "white") if option in allowed)]
    kept = {option: getattr(known, option) for option in same}
    return Origin(data=name).model_copy(update=kept | told)


def _load(origin: Origin) -> Dataset:
    options = origin.model_dump(exclude={"data", "view"})
    scenes = load_dataset(origin.data, **options)
    return scenes if origin.view is None else view_from(scenes, Path(origin.view))


def _notes(memory: Memory | None, asked: Origin, data: Dataset) -> list[str]:
    known = memory.origin if memory else None
    if memory is None or memory.is_of(data):
        return []
    if known is None:
        return [f"this is not the data that the design was trained on, {memory.name}"]
    if known == asked:
        return [
            f"{known.words} has changed since the design was trained on it: test scenes may be "
            "among those it was trained on"
        ]
    return [f"the design was trained on {known.words}; this is {asked.words}"]
