"""Collections of published designs: which there are, and how each is made, tested and written.

The package's own list is `collection.toml` beside this module; others may write one of their own.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, model_validator

from deepfsi.base import (
    InputError,
    Progress,
    as_input_error,
    check_choice,
    hash_file,
    note_saved_work,
    read_toml,
    write_atomically,
)
from deepfsi.base.models import StrictModel
from deepfsi.datasets import Dataset, load_dataset
from deepfsi.designfile import INDEX_NAME, CollectionIndex, DesignName, PublishedDesign, ShortText
from deepfsi.evaluation import evaluate
from deepfsi.jobs import REVISION, Job, find_job, sorted_settings
from deepfsi.measures import Result
from deepfsi.networks import check_classes
from deepfsi.sweeps.cards import card
from deepfsi.training import learn

TRAINING_SHARE = 0.7
"""Share of the progress that the training of a design takes; the rest is its test."""


class DataTerms(StrictModel):
    """Whose data a design was trained on.

    Attributes
    ----------
    citation : str
        What to cite.
    licence : str
        Terms of use, in words.
    """

    citation: str
    licence: str


class DesignRecipe(StrictModel):
    """A published design before it is made.

    Attributes
    ----------
    recognises : str
        What it tells apart, in words.
    data : str
        Name or path of the data set.
    rescale, split, size : optional
        As `load_dataset` takes them.
    note : str
        What its card says besides.
    settings : dict
        Single settings of a job, as options of `deepfsi design` are.
    """

    recognises: ShortText
    data: ShortText
    rescale: tuple[float, float] | None = None
    split: str | None = None
    size: tuple[int, int] | None = None
    note: str = ""
    settings: dict[str, Any]

    @property
    def job(self) -> Job:
        """The job, or `InputError` for settings that it has not."""
        return find_job(sorted_settings(self.settings))

    @property
    def hash(self) -> str:
        """SHA-256 of all that the design follows from, in hex."""
        words = json.dumps([REVISION, self.model_dump(mode="json")], sort_keys=True)
        return hashlib.sha256(words.encode()).hexdigest()

    def load(self) -> Dataset:
        """The data set, or `InputError` where it is not at hand or the job cannot be had on it."""
        options = {"rescale": self.rescale, "split": self.split, "size": self.size}
        data = load_dataset(self.data, **options)  # type: ignore[arg-type]
        check_classes(data.values, "a published design")
        self.job.check(data)
        return data


class Collection(StrictModel):
    """Designs to be made, and whose data they are trained on: a list in a TOML file.

    Attributes
    ----------
    designs : dict of str to DesignRecipe
        By name.
    data : dict of str to DataTerms
        By the data of the designs.
    """

    designs: dict[DesignName, DesignRecipe] = Field(min_length=1)
    data: dict[str, DataTerms]

    @model_validator(mode="after")
    def _sound(self) -> "Collection":
        for name, recipe in self.designs.items():
            if recipe.data not in self.data:
                raise ValueError(
                    f"nothing says whose data {name} is trained on: give a table "
                    f'[data."{recipe.data}"] with citation and licence'
                )
            try:
                recipe.job  # noqa: B018 - it raises
            except InputError as error:
                raise InputError("settings of {name}: {error}", name=name, error=error) from None
        return self

    @classmethod
    def read(cls, path: str | os.PathLike[str] | None = None) -> "Collection":
        """List of a TOML file; the package's own unless given."""
        own = files(__package__) / "collection.toml"
        with as_file(own) as shipped, as_input_error(str(path or own), "correct the list"):
            return cls.model_validate(read_toml(path or shipped))


class Made(NamedTuple):
    """A design of a collection, and whether it was there already."""

    name: str
    entry: PublishedDesign
    there: bool


Bar = Callable[[str], AbstractContextManager[Progress]]
"""Gives the progress of a design by its name."""


def make(
    collection: Collection, folder: Path, names: list[str] | None, command: str, bar: Bar
) -> Iterator[Made]:
    """Make what a folder lacks of a collection, design by design, each whole or not at all.

    A design is made again where its recipe has changed, or its file is not the one of the index.

    Parameters
    ----------
    collection : Collection
    folder : path
        Made if need be.
    names : list of str, optional
        Designs to be made; all unless given.
    command : str
        Command that makes the list, for the cards.
    bar : callable
        Gives the progress of a design by its name.

    Raises
    ------
    InputError
        If a name is unknown, or a data set is not at hand. Designs made before remain.
    """
    wanted = list(collection.designs) if names is None else names
    if not wanted:
        raise InputError(f"no design was named: give one of {', '.join(collection.designs)}")
    for name in wanted:
        check_choice("published design", name, collection.designs)
    for name in wanted:
        recipe = collection.designs[name]
        if (known := _there(folder, name, recipe)) is not None:
            yield Made(name, known, True)
        else:
            with bar(name) as report:
                yield Made(name, _make(collection, folder, name, command, report), False)
        note_saved_work("finished designs are kept, run again to go on")


def _there(folder: Path, name: str, recipe: DesignRecipe) -> PublishedDesign | None:
    """Entry of a design that is in a folder as the recipe asks for it, with its card."""
    known = _index(folder).designs.get(name)
    file, words = folder / f"{name}.safetensors", folder / f"{name}.md"
    if known is None or known.recipe != recipe.hash or not (file.is_file() and words.is_file()):
        return None
    return known if hash_file(file) == known.sha256 else None


def _index(folder: Path) -> CollectionIndex:
    return CollectionIndex.read(folder) if (folder / INDEX_NAME).exists() else CollectionIndex()


def _make(
    collection: Collection, folder: Path, name: str, command: str, report: Progress
) -> PublishedDesign:
    """Train, test and write a design, its card and its entry in the index."""
    recipe = collection.designs[name]
    data, job = recipe.load(), recipe.job
    design = learn(
        data, report=report.between(0.0, TRAINING_SHARE), **sorted_settings(recipe.settings)
    )
    [result] = evaluate(
        design, data, job.photons, draws=job.draws, report=report.between(TRAINING_SHARE, 1.0)
    )
    content = design.to_bytes()
    sha256 = hashlib.sha256(content).hexdigest()
    entry, terms = _entry(recipe, result, sha256), collection.data[recipe.data]
    command = f"{command} --only {name} -o FOLDER"
    words = card(name, recipe, terms, data, design, result, sha256, command)
    write_atomically(folder / f"{name}.safetensors", content)
    write_atomically(folder / f"{name}.md", words.encode())
    index = _index(folder)  # as it is now: another process may have made another design
    changed = CollectionIndex(designs={**index.designs, name: entry})
    write_atomically(folder / INDEX_NAME, (changed.model_dump_json(indent=1) + "\n").encode())
    return entry


def _entry(recipe: DesignRecipe, result: Result, sha256: str) -> PublishedDesign:
    return PublishedDesign(
        sha256=sha256,
        recognises=recipe.recognises,
        data=recipe.data,
        photons=result.photons,
        accuracy=result.accuracy,
        low=result.low,
        high=result.high,
        recipe=recipe.hash,
    )
