"""Tables of measured readouts: what a detector read of labelled scenes, in any unit, masks unknown.

A recording is a row of k readouts, signed or not, with a label and, where they are known, the
picture that was shown, its place in the order of recording, and monitors of the light. A folder of
files is one table; a file may hold a class, whose readouts follow one another as they stand.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError, check_choice
from deepfsi.base.numeric import (
    TEXT_ENDINGS,
    VARIABLE_ENDINGS,
    list_variables,
    normal_name,
    read_columns,
    read_npz,
    read_table,
    read_variable,
)
from deepfsi.datasets.arrays import SPLIT_MINIMUM, TEST_SHARE, assemble, check_seed
from deepfsi.datasets.dataset import Dataset, Labels

SPLITS = ("random", "later", "pictures")
"""Ways to divide the recordings for testing."""

LARGEST = 2**27
"""Numbers of a variable at most."""

ARRAYS, TABLES = (*VARIABLE_ENDINGS, ".npz"), (*TEXT_ENDINGS, ".parquet")
"""Ends of the names of files with variables, and with columns."""

Numbers = npt.NDArray[np.float64]


class Variables(NamedTuple):
    """Names of the variables, or of the columns, of a table of readouts."""

    values: str | None = None  # of the readouts; of columns a pattern such as mode*
    label: str | None = None  # of the class; a folder's files are classes unless given
    picture: str | None = None  # of the picture that was shown
    order: str | None = None  # of the place or time of recording, which rises over all files
    monitors: tuple[str, ...] = ()  # of the monitors of the light; of columns patterns


NO_VARIABLES = Variables()


@dataclass(frozen=True, eq=False)
class Readouts:
    """Recordings of labelled scenes, each of k readouts, in the order of their files.

    Attributes
    ----------
    name : str
        Name in tables and records.
    values : array, shape (n, k)
        Readouts in the detector's own unit.
    y : array, shape (n,)
        Class of each, 0 .. C-1.
    classes : tuple of str
        Their C names.
    file, place : array, shape (n,)
        Number of its file, in natural order of names, and its place in that, or in `order`.
    ordered : bool
        True if `place` rises with the time of recording over all files.
    picture : array, shape (n,), or None
        Number of the picture that was shown.
    monitors : dict of array, shape (n, q)
        Monitors of the light, by name.
    """

    name: str
    values: Numbers
    y: Labels
    classes: tuple[str, ...]
    file: Labels
    place: Numbers
    ordered: bool
    picture: Labels | None = None
    monitors: dict[str, Numbers] = field(default_factory=dict)

    @property
    def splits(self) -> tuple[str, ...]:
        """Ways to divide these recordings: by pictures only where some were recorded twice."""
        again = self.picture is not None and len(np.unique(self.picture)) < len(self.y)
        return SPLITS if again else SPLITS[:2]

    @property
    def offset(self) -> Numbers:
        """Value (k,) of each readout that becomes 0."""
        return self.values.min(axis=0)

    @property
    def gain(self) -> Numbers:
        """Span (k,) of each readout, which becomes 1."""
        span = np.ptp(self.values, axis=0)
        return np.where(span > 0, span, 1.0)

    def test_part(self, split: str, seed: int = 0) -> npt.NDArray[np.bool_]:
        """True (n,) for the recordings to test on, about a fifth.

        ``"random"`` draws them, of each class its share; ``"later"`` takes the last of each class,
        ``"pictures"`` whole pictures, so that none is in both parts.
        """
        check_seed(seed)
        check_choice("split", split, self.splits)
        test = np.zeros(len(self.y), bool)
        if split == "later":
            for label in range(len(self.classes)):
                rows = np.flatnonzero(self.y == label)
                rows = rows[np.argsort(self.place[rows], kind="stable")]
                test[rows[-(len(rows) // TEST_SHARE) :]] = True
            return test
        from sklearn.model_selection import StratifiedGroupKFold, train_test_split

        every = np.arange(len(self.y))
        if split == "random":
            _, chosen = train_test_split(
                every, test_size=1 / TEST_SHARE, stratify=self.y, random_state=seed
            )
        else:
            folds = StratifiedGroupKFold(TEST_SHARE, shuffle=True, random_state=seed)
            _, chosen = next(iter(folds.split(every, self.y, self.picture)))
        test[chosen] = True
        return test

    def dataset(self, split: str = "random", seed: int = 0) -> Dataset:
        """Data set whose "pixels" are the readouts, each mapped from its span to [0, 1]."""
        test = np.flatnonzero(self.test_part(split, seed))
        train = np.random.default_rng(seed).permutation(np.setdiff1d(np.arange(len(self.y)), test))
        x = ((self.values - self.offset) / self.gain).astype(np.float32)
        return assemble(
            self.name,
            (x[train], self.y[train]),
            (x[test], self.y[test]),
            classes=self.classes,
            described=f"Readouts, each mapped from its span to [0, 1]; split {split}",
            rescale=None,
        )


class _Block(NamedTuple):
    """Recordings of one file."""

    values: Numbers
    labels: list[str]
    picture: list[str] | None
    order: Numbers | None
    monitors: dict[str, Numbers]


def read_readouts(
    source: str | Path, variables: Variables = NO_VARIABLES, name: str | None = None
) -> Readouts:
    """Recordings of a file (.mat, .npz, .h5, .csv, .parquet), or of all such files of a folder."""
    files = _files(Path(source).expanduser())
    blocks = [_read(file, variables, alone=len(files) == 1) for file in files]
    widths = {block.values.shape[1]: file for file, block in zip(files, blocks, strict=True)}
    if len(widths) > 1:
        told = " and ".join(f"{width} in {file.name}" for width, file in widths.items())
        raise InputError(f"{source}: readouts differ in number, {told}: give files of one kind")
    labels = [label for block in blocks for label in block.labels]
    names = sorted(set(labels), key=_natural)
    counts = [labels.count(each) for each in names]
    if len(names) < 2 or min(counts) < SPLIT_MINIMUM:
        raise InputError(
            f"{source}: classes {', '.join(names)} of {', '.join(map(str, counts))} recordings; "
            f"give two classes or more, and {SPLIT_MINIMUM} recordings or more of each"
        )
    pictures = [each for block in blocks for each in block.picture or ()]
    ordered = variables.order is not None
    sizes = [len(block.values) for block in blocks]
    return Readouts(
        name=name or Path(source).stem,
        values=np.concatenate([block.values for block in blocks]),
        y=np.array([names.index(label) for label in labels], np.int64),
        classes=tuple(names),
        file=np.repeat(np.arange(len(files)), sizes),
        place=np.concatenate(
            [
                np.arange(float(len(block.values))) if block.order is None else block.order
                for block in blocks
            ]
        ),
        ordered=ordered or len(files) == 1,
        picture=np.unique(pictures, return_inverse=True)[1] if pictures else None,
        monitors={
            each: np.concatenate([block.monitors[each] for block in blocks])
            for each in variables.monitors
        },
    )


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Key that sorts digit2 before digit10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part]


def _files(source: Path) -> list[Path]:
    ends = (*ARRAYS, *TABLES)
    if source.is_file() and source.suffix.lower() in ends:
        return [source]
    if not source.is_dir():
        raise InputError(
            f"{source} is no table of readouts: give a file ending in {', '.join(ends)}, or a "
            "folder of such files"
        )
    found = [each for each in source.iterdir() if each.suffix.lower() in ends]
    if not found:
        raise InputError(f"{source} holds no file ending in {', '.join(ends)}: give one that does")
    return sorted(found, key=lambda path: _natural(path.name))


def _read(path: Path, variables: Variables, alone: bool) -> _Block:
    """Recordings of a file, of which each readout, order and monitor is a finite number."""
    if alone and variables.label is None:
        raise InputError(
            "{path} is one file: give {label}, the variable of the classes",
            setting="label",
            path=path,
        )
    read = _of_table if path.suffix.lower() in TABLES else _of_arrays
    block = read(path, variables)
    numbers = {"readouts": block.values, "order": block.order, **block.monitors}
    for what, values in numbers.items():
        if values is not None and not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0]) + 1
            raise InputError(
                f"{path}: {what} of recording {row} are no finite numbers: leave it out"
            )
    return block


def _of_table(path: Path, variables: Variables) -> _Block:
    words = [each for each in (variables.label, variables.picture) if each]
    heads = read_columns(path).names
    for each in (*words, *([variables.order] if variables.order else [])):
        if each not in heads:
            raise _missing(path, each, heads)
    table = read_table(path, words)

    def columns(pattern: str) -> Numbers:
        kept = [place for place, head in enumerate(table.names) if fnmatchcase(head, pattern)]
        if not kept:
            raise _missing(path, pattern, table.names)
        return table.values[:, kept]

    monitors = {each: columns(each) for each in variables.monitors}
    taken = (*([variables.order] if variables.order else []), *variables.monitors)
    rest = [
        place
        for place, head in enumerate(table.names)
        if not any(fnmatchcase(head, each) for each in taken)
    ]
    values = columns(variables.values) if variables.values else table.values[:, rest]
    count = len(values)
    label, picture = variables.label, variables.picture
    return _Block(
        values,
        list(table.words[label]) if label else [path.stem] * count,
        list(table.words[picture]) if picture else None,
        columns(variables.order)[:, 0] if variables.order else None,
        monitors,
    )


def _of_arrays(path: Path, variables: Variables) -> _Block:
    asked = [each for each in (*variables[:4], *variables.monitors) if each]
    shapes: Mapping[str, Any]
    if path.suffix.lower() == ".npz":
        arrays = read_npz(path)
        shapes = {name: values.shape for name, values in arrays.items()}
    else:
        shapes = list_variables(path, (0, 1, 2))
    wide = [name for name, shape in shapes.items() if len(shape) == 2 and min(shape) > 1]
    chosen = variables.values or _only(path, [name for name in wide if name not in asked])
    for each in (chosen, *asked):
        if each not in shapes:
            raise _missing(path, each, shapes)
    if path.suffix.lower() != ".npz":
        names = dict.fromkeys((chosen, *asked))
        arrays = {name: read_variable(path, name, shapes[name], LARGEST) for name in names}
    vectors = [arrays[each].ravel() for each in variables[1:4] if each]
    counts = {len(each) for each in vectors if len(each) > 1} or {len(arrays[chosen])}
    if len(counts) > 1:
        raise InputError(
            f"{path}: label, picture and order are of {', '.join(map(str, sorted(counts)))} "
            "recordings: give as many of each"
        )
    count = counts.pop()

    def words(name: str | None) -> list[str] | None:
        return None if name is None else _words(arrays[name], count)

    return _Block(
        _rows(arrays[chosen], count, f"{path}: {chosen}"),
        words(variables.label) or [path.stem] * count,
        words(variables.picture),
        arrays[variables.order].ravel().astype(np.float64) if variables.order else None,
        {each: _rows(arrays[each], count, f"{path}: {each}") for each in variables.monitors},
    )


def _missing(path: Path, name: str, there: Sequence[str] | Mapping[str, Any]) -> InputError:
    return InputError(f"{path} has no {name!r}, but {', '.join(there) or 'nothing'}: name one")


def _only(path: Path, names: list[str]) -> str:
    if len(names) != 1:
        raise InputError(
            "{path} has {arrays}: give {values}, the variable of the readouts",
            setting="values",
            path=path,
            arrays=", ".join(names) or "no array of rows and columns",
        )
    return names[0]


def _rows(values: npt.NDArray[Any], count: int, what: str) -> Numbers:
    """Values with a row for each of so many recordings, which are columns as often."""
    flat = values.reshape(-1, 1) if values.ndim < 2 else values
    flat = flat if len(flat) == count else flat.T
    if len(flat) != count or values.dtype.kind not in "biuf":
        raise InputError(
            f"{what} has shape {values.shape} for {count} recordings: give numbers, a row or a "
            "column for each"
        )
    return flat.astype(np.float64)


def _words(values: npt.NDArray[Any], count: int) -> list[str]:
    """Names (count,) of labels or pictures, of which a file of one class has one alone."""
    flat = np.broadcast_to(values.ravel(), count) if values.size == 1 else values.ravel()
    return [
        f"{each:.15g}" if isinstance(each, float) else normal_name(str(each))
        for each in flat.tolist()
    ]
