"""The data that a design is tested on: those that it remembers, unless it is told otherwise.

A camera's calibration may view them. Where they are not what the design was trained on, that is
noted.
"""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from deepfsi.base import InputError
from deepfsi.datasets import Dataset, Origin, absolute, load_dataset, takes
from deepfsi.designfile import DesignFile, TrainedOn, new_scenes, trained_on
from deepfsi.hardware.calibration import view_dataset

if TYPE_CHECKING:
    from deepfsi.design.evaluation import Tested


class TestData(NamedTuple):
    """Data that a design is tested on, and notes on where it is not what it was trained on."""

    data: Dataset
    notes: tuple[str, ...]


def data_of(
    design: "Tested",
    data: str | None = None,
    size: tuple[int, int] | None = None,
    view: Path | None = None,
) -> TestData:
    """Load the data to test a design on: what is told, else what it was trained on."""
    training = trained_on(design.info)
    known = training.origin if training else None
    if data is None and known is None:
        raise InputError(
            "this design was trained on data that no file or name holds, such as arrays in "
            "memory: give the data to test it on, {data}",
            setting="data",
        )
    asked = _asked(known, data, size, view)
    try:
        loaded = _load(asked)
    except InputError as error:
        if data is None:
            raise InputError(
                "the data that this design was trained on cannot be loaded ({error}): give the "
                "data to test it on, {data}",
                setting="data",
                error=error,
            ) from error
        raise
    notes = _notes(training, asked, loaded)
    _, left = new_scenes(design.training_scenes, loaded)
    if design.training_scenes is None and notes:
        left = "test scenes may be among those it was trained on, which its file does not hold"
    return TestData(loaded, tuple(notes if left is None else [*notes, left]))


def data_of_file(file: Path, size: tuple[int, int] | None = None) -> Dataset:
    """Data that a design file was trained on, without torch."""
    training = trained_on(DesignFile.read(file, ()).header.info)
    if training is None or training.origin is None:
        raise InputError(
            f"{file} was trained on data that no file or name holds, such as arrays in memory: "
            "give a folder of pictures"
        )
    return _load(_asked(training.origin, None, size, None))


def _asked(
    known: Origin | None, data: str | None, size: tuple[int, int] | None, view: Path | None
) -> Origin:
    """Source that is told, the rest of it as the design remembers."""
    name = known.data if data is None and known else absolute(str(data))
    told = {"size": size, "view": absolute(str(view)) if view else None}
    told = {option: value for option, value in told.items() if value is not None}
    if known is None or name == known.data:
        return (known or Origin(data=name)).model_copy(update=told)
    allowed = takes(name)
    same = [
        "rescale",
        "view",
        "normal",
        *(option for option in ("size", "white", "skip_bad") if option in allowed),
    ]
    kept = {option: getattr(known, option) for option in same}
    return Origin(data=name).model_copy(update=kept | told)


def _load(origin: Origin) -> Dataset:
    options = origin.model_dump(exclude={"data", "view", "fold"})
    scenes = load_dataset(origin.data, **options)
    if origin.fold is not None:
        place, count = origin.fold
        scenes = scenes.folds(count)[place]
    return scenes if origin.view is None else view_dataset(scenes, Path(origin.view))


def _notes(training: TrainedOn | None, asked: Origin, data: Dataset) -> list[str]:
    known = training.origin if training else None
    if training is None or training.is_of(data):
        return []
    if known is None:
        return [f"this is not the data that the design was trained on, {training.name}"]
    if known == asked:
        return [f"{known.words} has changed since the design was trained on it"]
    return [f"the design was trained on {known.words}; this is {asked.words}"]
