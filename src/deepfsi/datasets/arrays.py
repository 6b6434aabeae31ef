"""A `Dataset` of arrays in memory or in an ``.npz`` file; every other source ends here too."""

from collections.abc import Sequence
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import read_npz
from deepfsi.base.errors import InputError, one_line
from deepfsi.base.tables import normal_name
from deepfsi.datasets.alike import Groups, deal, groups_of_alike
from deepfsi.datasets.dataset import Dataset, Ends, Labels, Origin, Reflectance, Truth
from deepfsi.datasets.levels import AnyArray, ValueRange, measure_levels, reflectance

Scenes: TypeAlias = tuple[npt.ArrayLike, npt.ArrayLike]
"""Scenes (n, H, W) or (n, N), and their labels (n,) or values (n, q)."""

TEST_FOLDS = 5
"""A test part that is drawn is one of five equal parts."""


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
    x : array, shape (n, H, W) for images, (n, N) for spectra
        Scenes. Floats are reflectance in [0, 1], truth values 0 and 1; uint8 is divided by 255,
        other integers by the white of their depth, as `deepfsi.datasets.levels` says.
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
    if any(np.ma.is_masked(array) for array in (x, y, x_test, y_test)):
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
    pixels = _array(x, "x")
    if pixels.ndim == 2 and pixels.shape[1] == prod(image_shape):
        x = pixels.reshape(-1, *image_shape)
    words = _array(y, "y").astype(str)
    # Integers 0, 1, … may be the names of classes, and no numbers of theirs
    if set(words.ravel().tolist()) <= set(classes):
        y = words
    pair = x, y
    data = split_arrays(pair, pair, classes=classes or None, values=values or None, name="arrays")
    return replace(data, x_train=data.x_train[:0], y_train=data.y_train[:0])


def split_arrays(
    train: Scenes,
    test: tuple[Any, Any] = (None, None),
    *,
    classes: Sequence[str] | None = None,
    values: Sequence[str] | None = None,
    name: str,
    seed: int = 0,
    rescale: Ends | None = None,
    described: str | None = None,
    white: float | None = None,
    levels: ValueRange | None = None,
    files: Sequence[str] | None = None,
) -> Dataset:
    """Data set of arrays; without a test part a fifth of the scenes is drawn.

    Pictures that are alike are drawn together; `files` names them.
    """
    drawn = all(array is None for array in test)
    pairs = [train] if drawn else [train, test]
    x, words, levels = _scenes([pair[0] for pair in pairs], name, white, levels)
    y = _answers([pair[1] for pair in pairs], x, name)
    n = len(x[0])
    truth: Truth
    if values is not None or (classes is None and y.dtype.kind == "f"):
        truth, values = _read_values(y, n, values, name)
    else:
        truth, classes = _read_classes(y, n, classes, name)
        sizes = np.bincount(truth[:n], minlength=len(classes))
        if drawn and sizes.min() < TEST_FOLDS:  # a fifth of fewer may be none
            fewest = classes[int(sizes.argmin())]
            raise InputError(
                f"{name}: class '{fewest}' has {sizes.min()} scenes; to draw a test part give "
                f"{TEST_FOLDS} or more of each class, or a test part of your own"
            )
    labels = truth if classes else np.zeros(len(truth), dtype=np.int64)
    groups = groups_of_alike(np.concatenate(x), labels)
    words = (described or words) + _alike_words(groups, n, files)
    if drawn:
        order, chosen = draw_fifth(n, truth if classes else None, seed, groups)
        tested = x[0][chosen], truth[chosen]
    else:
        # The last training scenes must be a fair sample to validate on
        order = np.random.default_rng(seed).permutation(n)
        tested = x[1], truth[n:]
    data = assemble(
        name,
        (x[0][order], truth[order]),
        tested,
        described=words,
        rescale=rescale,
        classes=tuple(classes or ()),
        values=tuple(values or ()),
    )
    return replace(data, white=levels.white if levels.chosen else None, drawn=drawn)


def _array(given: Any, what: str) -> AnyArray:
    """Array of what NumPy reads, or of a tensor of torch."""
    try:
        if hasattr(given, "detach"):  # it may need gradients, be sparse or on another device
            given = given.detach().cpu().to_dense()
            if given.element_size() == 2 and given.is_floating_point():
                given = given.float()  # NumPy has no bfloat16
        return np.asarray(given)
    except (TypeError, ValueError, NotImplementedError) as error:
        raise InputError(f"{what} is no array ({one_line(str(error))}): give numbers") from None


def _answers(
    arrays: Sequence[npt.ArrayLike], scenes: Sequence[Reflectance], name: str
) -> npt.NDArray[Any]:
    """Labels (n, 1) or values (n, q) of the training scenes, then of the test scenes."""
    answers = []
    for array, x in zip(arrays, scenes, strict=True):
        y = _array(array, f"{name}: y")
        # pandas keeps strings as objects
        if y.dtype == object and all(isinstance(label, str) for label in y.flat):
            y = y.astype(str)
        if y.shape == (1, len(x)):  # MATLAB's vectors
            y = y.ravel()
        if y.ndim not in (1, 2) or len(y) != len(x) or y.dtype.kind not in "iufU":
            raise InputError(
                f"{name}: y is {y.dtype} of shape {y.shape} for {len(x)} scenes; give each an "
                "integer or a string as its label, or floats that are its values"
            )
        answers.append(y.reshape(len(x), -1))
    if answers[0].shape[1] != answers[-1].shape[1]:
        raise InputError(f"{name}: y and y_test have other numbers of values; give the same")
    return np.concatenate(answers)


def _read_classes(
    y: npt.NDArray[Any], n: int, names: Sequence[str] | None, name: str
) -> tuple[Labels, Sequence[str]]:
    """Class numbers of labels, those of n training scenes first, and names of the classes."""
    labels = y.ravel().tolist()
    if y.dtype.kind == "U":
        labels = [normal_name(label) for label in labels]
    keys = sorted(set(labels[:n]))
    classes = tuple(map(str, keys)) if names is None else tuple(names)
    if y.shape[1] > 1 or len(set(classes)) < max(2, len(classes)):
        raise InputError(
            f"{name}: the classes are {', '.join(classes)}; give one label to a scene, of two "
            "classes or more, each with its own name"
        )
    if names is not None:
        keys = list(classes if y.dtype.kind == "U" else range(len(classes)))
    numbers = {label: number for number, label in enumerate(keys)}
    if unknown := set(labels) - numbers.keys():
        raise InputError(
            f"{name} holds the label {min(unknown)!r}; "
            f"the classes to train on are {', '.join(map(repr, numbers))}"
        )
    return np.array([numbers[label] for label in labels], dtype=np.int64), classes


def _read_values(
    y: npt.NDArray[Any], n: int, names: Sequence[str] | None, name: str
) -> tuple[Truth, Sequence[str]]:
    """Values (scenes, q), those of n training scenes first, and their q names."""
    truth = y.astype(np.float32)
    train = truth[:n]
    width = train.shape[1]
    values = tuple(names or (f"value {k + 1}" for k in range(width)))
    vary = np.isfinite(truth).all() and (np.ptp(train, axis=0) > 0).all()
    if not vary or len(set(values)) != width or n < TEST_FOLDS:
        raise InputError(
            f"{name}: {width} values of {n} training scenes, named {', '.join(values)}; give "
            f"finite ones that differ, each with its own name, of {TEST_FOLDS} scenes or more"
        )
    distinct = np.unique(train)
    integers = width == 1 and len(distinct) <= n / TEST_FOLDS and not (distinct % 1).any()
    one_hot = width > 1 and np.isin(train, (0, 1)).all() and (train.sum(axis=1) == 1).all()
    # As MATLAB or one-hot codes write classes: a design would estimate them without a word
    if names is None and (integers or one_hot):
        raise InputError(
            f"{name}: y holds whole numbers written as floats: if they are classes, give integers "
            "(1 and not 1.0, `y.argmax(axis=1)` of one-hot rows) or strings; if values, name them"
        )
    return truth, values


def _scenes(
    arrays: Sequence[npt.ArrayLike],
    name: str,
    white: float | None = None,
    levels: ValueRange | None = None,
) -> tuple[list[Reflectance], str, ValueRange]:
    """Reflectances (n, H, W) or (n, N) of arrays, a sentence on the changes, and levels."""
    read: dict[str, AnyArray] = {}
    for array, what in zip(arrays, (f"{name}: x", f"{name}: x_test"), strict=False):
        scenes = _array(array, what)
        if scenes.ndim not in (2, 3) or scenes.size == 0:
            raise InputError(
                f"{what} has shape {scenes.shape}; give (n, H, W) for images, (n, N) for spectra, "
                "and turn RGB to grey: x @ [0.299, 0.587, 0.114]"
            )
        read[what] = scenes
    shapes = [scenes.shape[1:] for scenes in read.values()]
    if shapes[0] != shapes[-1]:
        raise InputError(
            f"{name}: a scene has shape {shapes[0]} in x but {shapes[-1]} in x_test; bring both "
            "to one shape"
        )
    levels = levels or measure_levels(read, white)
    words = levels.words[0].upper() + levels.words[1:]
    return [reflectance(scenes, levels) for scenes in read.values()], words, levels


def assemble(
    name: str,
    train: tuple[Reflectance, Truth],
    test: tuple[Reflectance, Truth],
    *,
    described: str,
    rescale: Ends | None,
    classes: tuple[str, ...] = (),
    values: tuple[str, ...] = (),
) -> Dataset:
    """Data set of scenes in [0, 1], which are rescaled in place."""
    low, high = (0.0, 1.0) if rescale is None else rescale
    if not 0 <= low < high <= 1:
        raise InputError(f"rescale ({low}, {high}): give low and high with 0 <= low < high <= 1")
    if not train[0].any():
        raise InputError(f"{name}: every training scene is dark, all 0; give scenes with light")
    for x, _ in (train, test):
        x *= high - low
        x += low
        np.clip(x, low, high, out=x)  # rounding
    ends = "" if (low, high) == (0, 1) else f", then mapped from [0, 1] to [{low:g}, {high:g}]"
    return Dataset(
        name=name,
        x_train=train[0].reshape(len(train[0]), -1),
        y_train=train[1],
        x_test=test[0].reshape(len(test[0]), -1),
        y_test=test[1],
        image_shape=train[0].shape[1:],
        classes=classes,
        values=values,
        preprocessing=f"{described}{ends}.",
    )


def draw_fifth(
    count: int,
    classes: npt.NDArray[np.integer] | None,
    seed: int,
    groups: Groups | None = None,
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Indices to train on, in random order, and of a fifth to test on, drawn by classes (n,)."""
    from sklearn.model_selection import train_test_split

    if groups is not None and len(np.unique(groups)) < count:
        labels = np.zeros(count, dtype=np.int64) if classes is None else classes
        tested = deal(groups, labels, TEST_FOLDS, seed) == 0
        if tested.any():  # else each class is one group, of which some are tested all the same
            order = np.random.default_rng(seed).permutation(count)
            return order[~tested[order]], order[tested[order]]
    train, test = train_test_split(
        np.arange(count), test_size=1 / TEST_FOLDS, stratify=classes, random_state=seed
    )
    return train, test


def _alike_words(groups: Groups, training: int, files: Sequence[str] | None) -> str:
    """Words on pictures that are alike, the training ones first; none if each is a group."""
    names, sizes = np.unique(groups, return_counts=True)
    if len(names) == len(groups):
        return ""
    largest = np.flatnonzero(groups == names[sizes.argmax()])[:3].tolist()
    such = ", ".join(files[row] if files else f"number {row}" for row in largest)
    words = f"; {len(groups)} pictures are {len(names)} groups of alike ones (one of {such}, …)"
    leaked = int(np.isin(groups[training:], groups[:training]).sum())
    if leaked:
        return f"{words}, and {leaked} test pictures are alike training ones: they measure nothing"
    return f"{words}: they are split and left out together"


def draw_stratified(
    labels: npt.ArrayLike, count: int | None, seed: int, name: str
) -> tuple[npt.NDArray[np.intp], str]:
    """Sorted indices of `count` scenes (None: all), by labels (n,), and words on the draw."""
    if count is None:
        return np.arange(np.size(labels)), ""
    labels = np.asarray(labels)
    classes, numbers, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    if not len(classes) <= count <= len(labels):
        raise InputError(
            f"{name}: {count} of {len(labels)} training images were asked for; give "
            f"{len(classes)} (one of each class) to {len(labels)}"
        )
    order = np.random.default_rng(seed).permutation(len(labels))
    order = order[np.argsort(numbers[order], kind="stable")]
    # The scenes of a class are spread evenly over ranks 0 to 1: the lowest hold its share
    rank = np.concatenate([np.arange(size) for size in sizes]) / np.repeat(sizes, sizes)
    drawn = np.sort(order[np.argsort(rank, kind="stable")[:count]])
    return drawn, f"{count} training images drawn by class; "


def load_arrays(options: Origin) -> Dataset:
    """Data set of the arrays x and y of a file, and of its test part if it has one."""
    path = Path(options.data)
    arrays = read_npz(path)
    if not {"x", "y"} <= arrays.keys() <= {"x", "y", "x_test", "y_test", "values"}:
        raise InputError(
            f"{path} holds {', '.join(arrays) or 'nothing'}; "
            "give x and y, optionally x_test, y_test and names of values, and no other names"
        )
    values = arrays.get("values")
    return split_arrays(
        (arrays["x"], arrays["y"]),
        (arrays.get("x_test"), arrays.get("y_test")),
        values=None if values is None else np.atleast_1d(values).astype(str).tolist(),
        name=path.stem,
        seed=options.seed,
        rescale=options.rescale,
        white=options.white,
    )
