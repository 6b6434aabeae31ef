"""Collections of published designs: how each is made, tested and written, with its card.

A card says what a design is, how well it does and whose data it knows (`card.md`). The package's
own list is `collection.toml` beside this module; others may write one of their own.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import Field, model_validator

from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.files import hash_file, read_toml, write_atomically
from deepfsi.base.interrupts import note_saved_work
from deepfsi.base.models.strict import StrictModel
from deepfsi.base.progress import Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.designfile.provenance import trained_on
from deepfsi.designfile.published import (
    INDEX_NAME,
    CollectionIndex,
    DesignName,
    PublishedDesign,
    ShortText,
)
from deepfsi.jobs.job import REVISION, Job, find_job, sorted_settings
from deepfsi.measures.results import Result

if TYPE_CHECKING:
    from deepfsi.design.design import Design

_LEARNING_SHARE = 0.7
"""Share of the progress that the training of a design takes; the rest is its test."""


class DataTerms(StrictModel):
    """Whose data a design was trained on."""

    citation: str  # what to cite
    licence: str  # terms of use, in words


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
        from deepfsi.networks.values import check_classes

        data = load_dataset(self.data, rescale=self.rescale, split=self.split, size=self.size)
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
        shipped = files(__package__) / "collection.toml"
        with as_file(shipped) as file, as_input_error(str(path or shipped), "correct the list"):
            return cls.model_validate(read_toml(path or file))


class CollectionEntry(NamedTuple):
    """A design of a collection that is in its folder."""

    name: str
    entry: PublishedDesign
    there: bool  # whether it was there already


def make_collection(
    collection: Collection,
    folder: Path,
    names: list[str] | None = None,
    *,
    command: str,
    bar: Callable[[str], AbstractContextManager[Progress]],
) -> Iterator[CollectionEntry]:
    """Make what a folder lacks of a collection, design by design, each whole or not at all.

    A design is made again where its recipe has changed, or its file is not the one of the index.
    """
    names = list(collection.designs) if names is None else names
    if not names:
        raise InputError(f"no design was named: give one of {', '.join(collection.designs)}")
    for name in names:
        check_choice("published design", name, collection.designs)
    for name in names:
        if entry := _entry_there(folder, name, collection.designs[name]):
            yield CollectionEntry(name, entry, True)
        else:
            with bar(name) as report:
                entry = _make(collection, name, folder, command, report=report)
            yield CollectionEntry(name, entry, False)
        note_saved_work("finished designs are kept, run again to go on")


def _entry_there(folder: Path, name: str, recipe: DesignRecipe) -> PublishedDesign | None:
    """Entry of a design that is in a folder as the recipe asks for it, with its card."""
    entry = _index(folder).designs.get(name)
    file = folder / f"{name}.safetensors"
    if entry is None or entry.recipe != recipe.hash:
        return None
    if not (file.is_file() and (folder / f"{name}.md").is_file()):
        return None
    return entry if hash_file(file) == entry.sha256 else None


def _index(folder: Path) -> CollectionIndex:
    return CollectionIndex.read(folder) if (folder / INDEX_NAME).exists() else CollectionIndex()


def _make(
    collection: Collection, name: str, folder: Path, command: str, *, report: Progress
) -> PublishedDesign:
    """Train, test and write a design, its card and its entry in the index."""
    from deepfsi.evaluation.accuracy import evaluate
    from deepfsi.training.learning import learn

    recipe = collection.designs[name]
    data = recipe.load()
    job = recipe.job
    learning = report.between(0.0, _LEARNING_SHARE)
    design = learn(data, report=learning, **sorted_settings(recipe.settings))
    testing = report.between(_LEARNING_SHARE, 1.0)
    [result] = evaluate(design, data, job.photons, draws=job.draws, report=testing)
    content = design.to_bytes()
    entry = PublishedDesign(
        sha256=hashlib.sha256(content).hexdigest(),
        recognises=recipe.recognises,
        data=recipe.data,
        photons=result.photons,
        accuracy=result.accuracy,
        low=result.low,
        high=result.high,
        recipe=recipe.hash,
    )
    template = (files(__package__) / "card.md").read_text("utf-8")
    card = template.format(
        name=name,
        recipe=recipe,
        terms=collection.data[recipe.data],
        data=data,
        design=design,
        result=result,
        entry=entry,
        command=f"{command} --only {name} -o FOLDER",
        **_card_words(recipe, data, design, result),
    )
    write_atomically(folder / f"{name}.safetensors", content)
    write_atomically(folder / f"{name}.md", card.encode())
    index = _index(folder)  # as it is now: another process may have made another design
    changed = CollectionIndex(designs={**index.designs, name: entry})
    write_atomically(folder / INDEX_NAME, (changed.model_dump_json(indent=1) + "\n").encode())
    return entry


def _card_words(
    recipe: DesignRecipe, data: Dataset, design: "Design", result: Result
) -> dict[str, str]:
    """Words of a card that are made of several values."""
    job = recipe.job
    kind = {None: "continuous", 0: "continuous", 2: "ON and OFF"}
    masks = f"{job.masks}, {kind.get(job.optics.levels, f'{job.optics.levels} levels')}"
    if job.code.adaptive:
        masks = f"made while it looks, one for each of {job.masks} looks"
    counts = f"{result.counts:.4g} of them counted in the mean"
    if result.clicks:
        counts = f"{result.counts:.4g} clicks of {result.arriving:.4g} photons that arrive, mean"
    source = trained_on(design.info)
    return {
        "note": f"\n\n{recipe.note}" if recipe.note else "",
        "classes": ", ".join(data.classes),
        "camera": job.optics.describe().replace("\n", "; "),
        "masks": masks,
        "counts": counts,
        "worst": f"{data.classes[result.worst]}, {result.rates[result.worst]:.3f}",
        "draws": "one noise draw" if result.draws == 1 else f"{result.draws} noise draws",
        "scenes": f"{source.words if source else data.name}, {len(data.x_train)} training scenes "
        f"of {' x '.join(map(str, data.image_shape))}, sha256 of scenes and labels {data.hash}",
        "settings": "\n    ".join(f"{key} = {json.dumps(v)}" for key, v in recipe.settings.items()),
    }
