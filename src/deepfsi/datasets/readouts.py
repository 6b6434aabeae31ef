"""Tables of measured readouts: what a detector read of labelled scenes, in any unit, masks unknown.

A recording is a row of k readouts, signed or not, with a label and, where they are known, the
picture that was shown, its place in the order of recording, and monitors of the light. A folder of
files is one table; a file may hold a class, whose readouts follow one another as they stand.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.numeric.arrays import VARIABLE_ENDINGS, list_variables, read_npz, read_variable
from deepfsi.base.numeric.tables import TEXT_ENDINGS, normal_name, read_columns, read_table
from deepfsi.datasets.arrays import SPLIT_MINIMUM, TEST_SHARE, assemble, check_seed, draw_fifth
from deepfsi.datasets.dataset import Dataset, Labels

RECORDING_SPLITS = ("random", "later", "pictures")
"""Ways to divide the recordings for testing."""

MAX_NUMBERS = 2**27
"""Numbers of a variable at most."""

ARRAY_ENDINGS = (*VARIABLE_ENDINGS, ".npz")
"""Ends of the names of files with variables."""

COLUMN_ENDINGS = (*TEXT_ENDINGS, ".parquet")
"""Ends of the names of files with columns."""

Numbers = npt.NDArray[np.float64]


class Variables(NamedTuple):
    """Names of the variables, or of the columns, of a table of readouts."""

    values: str | None = None
    label: str | None = None
    picture: str | None = None  # of the picture that was shown
    order: str | None = None  # of the place or time of recording, which rises over all files
    monitors: tuple[str, ...] = ()  # of the monitors of the light


NO_VARIABLES = Variables()


@dataclass(frozen=True, eq=False)
class MeasuredReadouts:
    """Recordings of labelled scenes, each of k readouts, in the order of their files."""

    name: str  # name in tables and records
    values: Numbers  # (n, k), readouts in the detector's own unit
    y: Labels  # (n,), class of each, 0 .. C-1
    classes: tuple[str, ...]  # their C names
    file: Labels  # (n,)
    position: Numbers  # (n,)
    ordered: bool  # True if `position` rises with the time of recording over all files
    picture: Labels | None = None  # (n,), number of the picture that was shown
    monitors: dict[str, Numbers] = field(default_factory=dict)  # (n, q)

    @property
    def splits(self) -> tuple[str, ...]:
        """Ways to divide these recordings: by pictures only where some were recorded twice."""
        again = self.picture is not None and len(np.unique(self.picture)) < len(self.y)
        return RECORDING_SPLITS if again else RECORDING_SPLITS[:2]

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
                rows = rows[np.argsort(self.position[rows], kind="stable")]
                test[rows[-(len(rows) // TEST_SHARE) :]] = True
            return test
        if split == "random":
            _, drawn = draw_fifth(len(self.y), self.y, seed)
        else:
            from sklearn.model_selection import StratifiedGroupKFold

            folds = StratifiedGroupKFold(TEST_SHARE, shuffle=True, random_state=seed)
            _, drawn = next(iter(folds.split(self.y, self.y, self.picture)))
        test[drawn] = True
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
    pictures: list[str] | None
    order: Numbers | None
    monitors: dict[str, Numbers]


def read_readouts(
    source: str | Path, variables: Variables = NO_VARIABLES, name: str | None = None
) -> MeasuredReadouts:
    """Recordings of a file (.mat, .npz, .h5, .csv, .parquet), or of all such files of a folder."""
    files = _files(Path(source).expanduser())
    blocks = [_read(file, variables, alone=len(files) == 1) for file in files]
    widths = {block.values.shape[1]: file for file, block in zip(files, blocks, strict=True)}
    if len(widths) > 1:
        words = " and ".join(f"{width} in {file.name}" for width, file in widths.items())
        raise InputError(f"{source}: readouts differ in number, {words}: give files of one kind")
    labels = [label for block in blocks for label in block.labels]
    classes = sorted(set(labels), key=_natural)
    counts = [labels.count(label) for label in classes]
    if len(classes) < 2 or min(counts) < SPLIT_MINIMUM:
        raise InputError(
            f"{source}: classes {', '.join(classes)} of {', '.join(map(str, counts))} recordings; "
            f"give two classes or more, and {SPLIT_MINIMUM} recordings or more of each"
        )
    pictures = [picture for block in blocks for picture in block.pictures or ()]
    positions = [
        np.arange(float(len(block.values))) if block.order is None else block.order
        for block in blocks
    ]
    return MeasuredReadouts(
        name=name or Path(source).stem,
        values=np.concatenate([block.values for block in blocks]),
        y=np.array([classes.index(label) for label in labels], np.int64),
        classes=tuple(classes),
        file=np.repeat(np.arange(len(files)), [len(block.values) for block in blocks]),
        position=np.concatenate(positions),
        ordered=variables.order is not None or len(files) == 1,
        picture=np.unique(pictures, return_inverse=True)[1] if pictures else None,
        monitors={
            monitor: np.concatenate([block.monitors[monitor] for block in blocks])
            for monitor in variables.monitors
        },
    )


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Key that sorts digit2 before digit10."""
    words = re.split(r"(\d+)", name)
    return [(0, int(word), "") if word.isdecimal() else (1, 0, word) for word in words if word]


def _files(source: Path) -> list[Path]:
    ends = (*ARRAY_ENDINGS, *COLUMN_ENDINGS)
    if source.is_file() and source.suffix.lower() in ends:
        return [source]
    if not source.is_dir():
        raise InputError(
            f"{source} is no table of readouts: give a file ending in {', '.join(ends)}, or a "
            "folder of such files"
        )
    files = [file for file in source.iterdir() if file.suffix.lower() in ends]
    if not files:
        raise InputError(f"{source} holds no file ending in {', '.join(ends)}: give one that does")
    return sorted(files, key=lambda path: _natural(path.name))


def _read(path: Path, variables: Variables, alone: bool) -> _Block:
    """Recordings of a file, of which each readout, order and monitor is a finite number."""
    if alone and variables.label is None:
        raise InputError(
            "{path} is one file: give {label}, the variable of the classes",
            setting="label",
            path=path,
        )
    read = _of_table if path.suffix.lower() in COLUMN_ENDINGS else _of_arrays
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
    label, picture, order = variables[1:4]
    words = [name for name in (label, picture) if name]
    heads = read_columns(path).names
    for name in (*words, *([order] if order else [])):
        if name not in heads:
            raise _missing(path, name, heads)
    table = read_table(path, words)

    def columns(pattern: str) -> Numbers:
        columns = [column for column, head in enumerate(table.names) if fnmatchcase(head, pattern)]
        if not columns:
            raise _missing(path, pattern, table.names)
        return table.values[:, columns]

    monitors = {pattern: columns(pattern) for pattern in variables.monitors}
    if variables.values:
        values = columns(variables.values)
    else:
        other = (*([order] if order else []), *variables.monitors)
        rest = [not any(fnmatchcase(head, each) for each in other) for head in table.names]
        values = table.values[:, np.flatnonzero(rest)]
    return _Block(
        values=values,
        labels=list(table.words[label]) if label else [path.stem] * len(values),
        pictures=list(table.words[picture]) if picture else None,
        order=columns(order)[:, 0] if order else None,
        monitors=monitors,
    )


def _of_arrays(path: Path, variables: Variables) -> _Block:
    label, picture, order = variables[1:4]
    names = [name for name in (*variables[:4], *variables.monitors) if name]
    arrays: dict[str, npt.NDArray[Any]] = {}
    if path.suffix.lower() == ".npz":
        arrays = read_npz(path)
        shapes = {name: values.shape for name, values in arrays.items()}
    else:
        shapes = list_variables(path, (0, 1, 2))
    readouts = variables.values
    if not readouts:
        tables = [name for name, shape in shapes.items() if len(shape) == 2 and min(shape) > 1]
        tables = [name for name in tables if name not in names]
        if len(tables) != 1:
            raise InputError(
                "{path} has {arrays}: give {values}, the variable of the readouts",
                setting="values",
                path=path,
                arrays=", ".join(tables) or "no array of rows and columns",
            )
        readouts = tables[0]
    for name in dict.fromkeys((readouts, *names)):
        if name not in shapes:
            raise _missing(path, name, shapes)
        if name not in arrays:
            arrays[name] = read_variable(path, name, shapes[name], MAX_NUMBERS)
    lengths = {arrays[name].size for name in (label, picture, order) if name}
    counts = lengths - {0, 1} or {len(arrays[readouts])}
    if len(counts) > 1:
        raise InputError(
            f"{path}: label, picture and order are of {', '.join(map(str, sorted(counts)))} "
            "recordings: give as many of each"
        )
    count = counts.pop()

    def rows(name: str) -> Numbers:
        """Values with a row for each recording, which are columns as often."""
        values = arrays[name]
        table = values.reshape(-1, 1) if values.ndim < 2 else values
        table = table if len(table) == count else table.T
        if len(table) != count or values.dtype.kind not in "biuf":
            raise InputError(
                f"{path}: {name} has shape {values.shape} for {count} recordings: give numbers, a "
                "row or a column for each"
            )
        return table.astype(np.float64)

    def words(name: str) -> list[str]:
        """Names of labels or pictures, of which a file of one class has one alone."""
        flat = arrays[name].ravel()
        flat = np.broadcast_to(flat, count) if flat.size == 1 else flat
        return [
            f"{word:.15g}" if isinstance(word, float) else normal_name(str(word))
            for word in flat.tolist()
        ]

    return _Block(
        values=rows(readouts),
        labels=words(label) if label else [path.stem] * count,
        pictures=words(picture) if picture else None,
        order=arrays[order].ravel().astype(np.float64) if order else None,
        monitors={monitor: rows(monitor) for monitor in variables.monitors},
    )


def _missing(path: Path, name: str, names: Iterable[str]) -> InputError:
    return InputError(f"{path} has no {name!r}, but {', '.join(names) or 'nothing'}: name one")
