"""A `Dataset` of arrays in memory or in an ``.npz`` file; every other source ends here too."""

from collections.abc import Sequence
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import check_memory, free_memory, read_npz
from deepfsi.base.errors import InputError
from deepfsi.base.tables import normal_name
from deepfsi.datasets.dataset import Dataset, Ends, Labels, Origin, Reflectance, Truth
from deepfsi.datasets.levels import (
    AnyArray,
    ValueRange,
    grey,
    mapped,
    measure_levels,
    reflectance,
)

Scenes: TypeAlias = tuple[npt.ArrayLike, npt.ArrayLike]
"""Scenes (n, H, W), (n, H, W, 3) or (n, N), and their labels (n,) or values (n, q)."""

TEST_SHARE = 5
"""One scene in so many is for testing, wherever this package draws a test part."""

SPLIT_MINIMUM = 5
"""Scenes of a class at least where a test part is drawn: a fifth of fewer may be none."""

SCENE_BYTES = 8
"""Bytes for each value of a scene while a data set is made: two copies of 32 bits."""

COLOUR_CHANNELS = (1, 3, 4)
"""Values of a pixel in an array of colours: grey, RGB, RGB with transparency."""


def from_arrays(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    x_test: npt.ArrayLike | None = None,
    y_test: npt.ArrayLike | None = None,
    *,
    classes: Sequence[str] | None = None,
    values: Sequence[str] | None = None,
    name: str = "arrays",
    seed: int = 0,
    rescale: Ends | None = None,
) -> Dataset:
    """Make a data set of arrays in memory. The training scenes are shuffled with the seed.

    Integers and strings are classes. Floats are values, such as a position or an abundance, which a
    design then learns to estimate.

    Parameters
    ----------
    x : array, shape (n, H, W) or (n, H, W, 3) for images, (n, N) for spectra
        Scenes. Floats are reflectance in [0, 1], truth values 0 and 1; uint8 is divided by 255,
        other integers by the white of their depth, as `deepfsi.datasets.levels` says. Colours
        are turned to grey.
    y : array, shape (n,) or (n, q)
        Labels (n,), integers or strings, whose sorted values become the classes 0 .. C-1. Or
        floats, q values of each scene in units of your own.
    x_test, y_test : array, optional
        The test part, kept in its order. Without it, a fifth is drawn with the seed, of each class
        its share.
    classes : sequence of str, optional
        Class names. Integer labels then count into them from 0; string labels are among them.
    values : sequence of str, optional
        Names of the q values. Default: value 1, value 2, … .
    name : str
        Name of the data set in tables and records.
    seed : int
        Draws the test part and the order of the training scenes, 0 .. 2**32 - 1.
    rescale : (float, float), optional
        Low and high, to which [0, 1] is mapped.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If the arrays do not fit each other or the rules above, or a class has too few scenes.

    Examples
    --------
    >>> import deepfsi
    >>> x, y = [[0.1, 0.9], [0.8, 0.3]] * 10, ["dark", "bright"] * 10
    >>> data = deepfsi.from_arrays(x, y)
    >>> data.classes, data.x_train.shape, data.x_test.shape
    (('bright', 'dark'), (16, 2), (4, 2))
    >>> deepfsi.from_arrays(x, [0.1, 0.8] * 10, values=["left pixel"]).values
    ('left pixel',)
    """
    if any(np.ma.is_masked(given) for given in (x, y, x_test, y_test)):
        raise InputError(f"{name} hides values under a mask: leave out those scenes")
    return split_arrays(
        (x, y),
        (x_test, y_test),
        classes=classes,
        values=values,
        name=name,
        seed=seed,
        rescale=rescale,
    )


def as_test_part(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    image_shape: tuple[int, ...],
    classes: Sequence[str] = (),
    values: Sequence[str] = (),
) -> Dataset:
    """Data set of test scenes (n, H, W) or (n, N) alone, for a design trained on others."""
    name = "arrays"
    pixels = np.asarray(x)
    if pixels.ndim == 2 and pixels.shape[1] == prod(image_shape):
        x = pixels.reshape(-1, *image_shape)
    [scenes], described, levels = _scenes([x], name)
    if values:
        targets = _values((y, None), values, [len(scenes)], name)
    else:
        labels = _labels(y, len(scenes), f"{name}: y")
        words = labels.astype(str)
        labels = words if set(words.tolist()) <= set(classes) else labels
        names, numbers = _class_names(labels, classes, name)
        targets = _Targets(_class_numbers(labels, numbers, f"{name}: y"), None, names)
    part = scenes, targets.y
    data = assemble(
        name,
        part,
        part,
        described=described,
        rescale=None,
        classes=targets.classes,
        values=targets.values,
    )
    white = levels.chosen_white
    return replace(data, x_train=data.x_train[:0], y_train=targets.y[:0], white=white)


class _Targets(NamedTuple):
    """Classes or values of the training part and, if there is one, of the test part."""

    y: Truth  # classes (n,) int64, or values (n, q) float32
    y_test: Truth | None  # those of the test part
    classes: tuple[str, ...] = ()
    values: tuple[str, ...] = ()


def split_arrays(
    train: Scenes,
    test: Sequence[npt.ArrayLike | None] = (None, None),
    *,
    classes: Sequence[str] | None = None,
    values: Sequence[str] | None = None,
    name: str,
    seed: int,
    rescale: Ends | None,
    described: str | None = None,
    white: float | None = None,
    levels: ValueRange | None = None,
) -> Dataset:
    """Data set of arrays, whose test part is drawn where there is none."""
    check_seed(seed)
    x_test, y_test = test
    if (x_test is None) != (y_test is None):
        raise InputError(f"{name}: only one of x_test and y_test is there; give both or neither")
    parts = [train[0]] if x_test is None else [train[0], x_test]
    scenes, words, levels = _scenes(parts, name, white, levels)
    counts = [len(part) for part in scenes]
    if np.asarray(train[1]).dtype.kind != "f":
        if values is not None:
            raise InputError(
                f"{name}: names of values go with y of floats; give `classes`, or floats"
            )
        targets = _classes((train[1], y_test), classes, counts, name)
    elif classes is not None:
        raise InputError(f"{name}: names of classes go with labels; y is of floats, give `values`")
    else:
        targets = _values((train[1], y_test), values, counts, name)
    y = targets.y
    if targets.y_test is None:
        order, drawn = draw_fifth(len(y), y if targets.classes else None, seed)
        tested = scenes[0][drawn], y[drawn]
    else:
        order = np.random.default_rng(seed).permutation(len(y))
        tested = scenes[1], targets.y_test
    data = assemble(
        name,
        (scenes[0][order], y[order]),
        tested,
        described=described or words,
        rescale=rescale,
        classes=targets.classes,
        values=targets.values,
    )
    return replace(data, white=levels.chosen_white, drawn=targets.y_test is None)


Parts: TypeAlias = tuple[npt.ArrayLike, npt.ArrayLike | None]
"""Labels or values of the training and of the test part."""


def _classes(parts: Parts, names: Sequence[str] | None, counts: list[int], name: str) -> _Targets:
    """Class numbers of labels, which are integers or strings, one for each of so many scenes."""
    y, y_test = parts
    labels = _labels(y, counts[0], f"{name}: y")
    classes, numbers = _class_names(labels, names, name)
    truth = _class_numbers(labels, numbers, f"{name}: y")
    sizes = np.bincount(truth, minlength=len(classes))
    fewest = classes[sizes.argmin()]
    count = sizes.min()
    if y_test is None and count < SPLIT_MINIMUM:
        raise InputError(
            f"{name}: class '{fewest}' has {count} scenes; to draw a test part give "
            f"{SPLIT_MINIMUM} or more of each class, or a test part of your own"
        )
    if count == 0:
        raise InputError(f"{name}: class '{fewest}' has no training scenes; give some")
    if y_test is None:
        return _Targets(truth, None, classes)
    what = f"{name}: y_test"
    return _Targets(truth, _class_numbers(_labels(y_test, counts[1], what), numbers, what), classes)


def _values(parts: Parts, names: Sequence[str] | None, counts: list[int], name: str) -> _Targets:
    """Values of so many scenes, which are floats."""
    truths = []
    for part, count, what in zip(parts, counts, ("y", "y_test"), strict=False):
        if part is None:
            continue
        truth = np.asarray(part, dtype=np.float32)
        truth = truth[:, None] if truth.ndim == 1 else truth
        if truth.ndim != 2 or len(truth) != count or not np.isfinite(truth).all():
            raise InputError(
                f"{name}: {what} of shape {np.shape(part)} for {count} scenes; give (scenes,) or "
                "(scenes, values) finite numbers"
            )
        truths.append(truth)
    train = truths[0]
    if names is None:
        _check_no_classes(train, f"{name}: y")
    width = train.shape[1]
    values = tuple(names or (f"value {k + 1}" for k in range(width)))
    if len(set(values)) != width or truths[-1].shape[1] != width:
        raise InputError(
            f"{name}: {width} values of a training scene, {truths[-1].shape[1]} of a test scene, "
            f"named {', '.join(values)}; give each value one name of its own, in both parts"
        )
    if len(train) < SPLIT_MINIMUM or not (np.ptp(train, axis=0) > 0).all():
        raise InputError(
            f"{name}: a value is the same of all training scenes, or they are fewer than "
            f"{SPLIT_MINIMUM}; give values that differ"
        )
    return _Targets(train, truths[1] if len(truths) > 1 else None, values=values)


def _check_no_classes(values: npt.NDArray[Any], what: str) -> None:
    """Raise `InputError` for values (n, 1) that are whole numbers, each of many scenes.

    They are classes as MATLAB saves them, or a table with a gap. A design would estimate them
    without a word.
    """
    if values.shape[1] > 1 and np.isin(values, (0, 1)).all() and (values.sum(axis=1) == 1).all():
        raise InputError(
            f"{what} holds rows with a single 1, which are classes: give their numbers, "
            "y.argmax(axis=1)"
        )
    distinct = np.unique(values)
    many = 1 < len(distinct) <= len(values) / SPLIT_MINIMUM
    if values.shape[1] == 1 and many and not (distinct % 1).any():
        raise InputError(
            f"{what} holds whole numbers written as floats: if they are classes, give integers "
            "(1 and not 1.0) or strings; if they are values, name them"
        )


def check_seed(seed: object) -> None:
    """Raise `InputError` for what scikit-learn cannot take as a seed."""
    if not (isinstance(seed, int | np.integer) and 0 <= seed < 2**32):
        raise InputError(f"seed {seed!r}: give an integer from 0 to 2**32 - 1")


def _scenes(
    parts: Sequence[npt.ArrayLike],
    name: str,
    white: float | None = None,
    levels: ValueRange | None = None,
) -> tuple[list[Reflectance], str, ValueRange]:
    """Reflectance (n, H, W) or (n, N) of each part, changes in words, levels."""
    read: dict[str, AnyArray] = {}
    colours = ""
    for part, what in zip(parts, (f"{name}: x", f"{name}: x_test"), strict=False):
        scenes = np.asarray(part)
        if scenes.ndim == 4 and scenes.shape[3] in COLOUR_CHANNELS and scenes.size:
            colours = "; colours turned to grey" if scenes.shape[3] > 1 else ""
            scenes = grey(scenes, what)
        if scenes.ndim not in (2, 3) or scenes.size == 0:
            raise InputError(
                f"{what} has shape {scenes.shape}; give (n, H, W) for grey images, (n, H, W, 3) "
                "for RGB, (n, N) for spectra"
            )
        read[what] = scenes
    shapes = [part.shape[1:] for part in read.values()]
    if shapes[0] != shapes[-1]:
        raise InputError(
            f"{name}: a scene has shape {shapes[0]} in x but {shapes[-1]} in x_test; bring both "
            "to one shape"
        )
    levels = levels or measure_levels(read, white)
    words = levels.words[0].upper() + levels.words[1:]
    size = sum(part.size for part in read.values())
    count = sum(len(part) for part in read.values())
    check_memory(
        SCENE_BYTES * size,
        free_memory(),
        f"{name}: {count} scenes of {shapes[0]} values",
        "give fewer or smaller ones",
    )
    return [reflectance(part, levels) for part in read.values()], words + colours, levels


def _labels(y: npt.ArrayLike, count: int, what: str) -> npt.NDArray[Any]:
    """Labels (n,), integers or strings, one for each of so many scenes."""
    labels = np.asarray(y)
    if labels.dtype == object and all(isinstance(label, str) for label in labels.flat):
        labels = labels.astype(str)
    if labels.shape in ((count, 1), (1, count)):  # MATLAB's vectors
        labels = labels.ravel()
    if labels.shape != (count,):
        raise InputError(
            f"{what} has shape {labels.shape} for {count} scenes; give one label for each"
        )
    if labels.dtype.kind == "U":
        labels = np.array(list(map(normal_name, labels.tolist())))
    if labels.dtype.kind not in "iuU":
        raise InputError(
            f"{what} is {labels.dtype}; give labels that are integers or strings, or values that "
            "are floats"
        )
    return labels


def _class_names(
    labels: npt.NDArray[Any], classes: Sequence[str] | None, name: str
) -> tuple[tuple[str, ...], dict[int | str, int]]:
    """Class names, and the class number of each label."""
    keys = np.unique(labels).tolist()
    names = tuple(str(label) for label in keys) if classes is None else tuple(classes)
    if len(names) < 2:
        raise InputError(f"{name}: only one class, {', '.join(names)}; give two or more")
    if len(set(names)) < len(names):
        raise InputError(f"{name}: classes {', '.join(names)}; give each its own name")
    if classes is not None:
        keys = list(names if labels.dtype.kind == "U" else range(len(names)))
    return names, {label: number for number, label in enumerate(keys)}


def _class_numbers(labels: npt.NDArray[Any], numbers: dict[int | str, int], what: str) -> Labels:
    unknown = set(labels.tolist()) - numbers.keys()
    if unknown:
        raise InputError(
            f"{what} holds the label {min(unknown)!r}; "
            f"the classes to train on are {', '.join(map(repr, numbers))}"
        )
    return np.array([numbers[label] for label in labels.tolist()], dtype=np.int64)


def assemble(
    name: str,
    train: tuple[Reflectance, Truth],
    test: tuple[Reflectance, Truth],
    *,
    described: str,
    rescale: Ends | None,
    classes: tuple[str, ...] = (),
    values: tuple[str, ...] = (),
    wavelengths: npt.NDArray[np.float64] | None = None,
) -> Dataset:
    """Data set of scenes that are ready but for rescaling, which is done in place."""
    low, high = (0.0, 1.0) if rescale is None else rescale
    if not 0 <= low < high <= 1:
        raise InputError(f"rescale ({low}, {high}): give low and high with 0 <= low < high <= 1")
    if not train[0].any():
        raise InputError(f"{name}: every training scene is dark, all 0; give scenes with light")
    x_train, x_test = (mapped(x, low, high).reshape(len(x), -1) for x, _ in (train, test))
    ends = "" if (low, high) == (0, 1) else f", then mapped from [0, 1] to [{low:g}, {high:g}]"
    return Dataset(
        name=name,
        x_train=x_train,
        y_train=train[1],
        x_test=x_test,
        y_test=test[1],
        image_shape=train[0].shape[1:],
        classes=classes,
        values=values,
        preprocessing=f"{described}{ends}.",
        wavelengths=wavelengths,
    )


def draw_fifth(
    count: int, classes: npt.NDArray[np.integer] | None, seed: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Indices to train on, in random order, and of a fifth to test on; of each of classes (n,)."""
    from sklearn.model_selection import train_test_split

    train, test = train_test_split(
        np.arange(count), test_size=1 / TEST_SHARE, stratify=classes, random_state=seed
    )
    return train, test


def draw_stratified(
    labels: npt.ArrayLike, count: int, seed: int, name: str
) -> npt.NDArray[np.intp]:
    """Sorted indices of scenes; each class of labels (n,) has as nearly its share as can be."""
    check_seed(seed)
    labels = np.asarray(labels)
    values, numbers, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    if not len(values) <= count <= len(labels):
        raise InputError(
            f"{name}: {count} of {len(labels)} training images were asked for; give "
            f"{len(values)} (one of each class) to {len(labels)}"
        )
    order = np.random.default_rng(seed).permutation(len(labels))
    order = order[np.argsort(numbers[order], kind="stable")]
    rank = np.concatenate([np.arange(size) for size in sizes]) / np.repeat(sizes, sizes)
    return np.sort(order[np.argsort(rank, kind="stable")[:count]])


def load_arrays(source: Path | tuple[Any, ...], options: Origin) -> Dataset:
    """Data set of arrays x and y, and of a test part where it is there, in a tuple or a file."""
    if isinstance(source, Path):
        name = source.stem
        arrays = read_npz(source)
        if not {"x", "y"} <= arrays.keys() <= {"x", "y", "x_test", "y_test", "values"}:
            raise InputError(
                f"{source} holds {', '.join(arrays) or 'nothing'}; "
                "give x and y, optionally x_test, y_test and names of values, and no other names"
            )
    elif len(source) in (2, 4):
        name = "arrays"
        arrays = dict(zip(("x", "y", "x_test", "y_test"), source, strict=False))
    else:
        raise InputError(
            f"a tuple of {len(source)} arrays was given; give (x, y) or (x, y, x_test, y_test)"
        )
    values = arrays.get("values")
    return split_arrays(
        (arrays["x"], arrays["y"]),
        (arrays.get("x_test"), arrays.get("y_test")),
        values=None if values is None else np.atleast_1d(values).astype(str).tolist(),
        name=name,
        seed=options.seed,
        rescale=options.rescale,
        white=options.white,
    )
